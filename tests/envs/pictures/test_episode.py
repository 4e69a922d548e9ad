"""Pictures of an episode: equal with and without a stored background."""

import copy

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np
import pytest

import probe_env
from probe_env.envs.pictures.episode import Renderer
from probe_env.envs.pictures.plate import outward

LOUD = {"friction": 0.25, "helix_diameter": 1.0}


def started(env_id="probe_env/Insertion-v1", **arguments):
    env = gym.make(env_id, render_mode="rgb_array", **arguments).unwrapped
    env.reset(seed=0)
    return env


def from_scratch(env):
    fresh = Renderer(env.episodes)
    fresh.history, fresh._last_window = env._renderer.history, env._renderer._last_window
    return fresh.picture()


@pytest.mark.parametrize(
    ("env_id", "arguments"),
    [("probe_env/Insertion-v1", {"fidelity": "fast"}), ("probe_env/Snapshot-v1", {"scene": {"carrier_length": 30.0}})],
)
def test_pictures_equal_those_of_a_new_renderer(env_id, arguments):
    """Pixel by pixel, while axis limits change."""
    env = started(env_id, **arguments)
    env.reset(seed=0, options=LOUD)
    limits = set()
    for k in range(25):
        env.step(np.ones(2, dtype=np.float32))
        picture = env.render()
        limits.add(tuple(axes.get_ylim() for axes in env._renderer._artists[2]._axes))
        if k % 6 == 0:
            assert (picture == from_scratch(env)).all()
    assert len(limits) >= 3  # axes were redrawn in the background
    assert (copy.deepcopy(env).render() == picture).all()
    assert (env.render() == picture).all()


def test_a_custom_tube_is_drawn():
    """Axis limits, bore, floats and turns are those of the tube."""
    tube = {"tube": {"helix_length": 20.0, "inner_diameter": 0.023, "helix_diameter": 1.3}}
    env = started(tube=probe_env.Plant.model_validate(tube | {"probe": {"carrier_float_diameter": 0.0185}}))
    env.render()
    plate, helix, traces = env._renderer._artists
    assert [axes.get_xlim()[1] for axes in traces._axes[1:]] == [20.0] * 4
    texts = [text.get_text() for text in helix._title.axes.texts]
    assert "bore 23 mm, floats 18.5 and 19 mm, pitch 100 mm, guide 2.5 m" in texts
    assert "of 20 m in a helix of 1.3 m" in helix._title.get_text()
    spiral = helix._title.axes.lines[0].get_xydata()
    turned = np.unwrap(np.arctan2(spiral[:, 1], spiral[:, 0]))[-1] / (2.0 * np.pi)
    assert turned == pytest.approx(20.0 / (np.pi * 1.3), rel=1e-9)
    assert plate.picture().shape == (600, 1000, 3)


def test_human_mode_has_one_window_for_all_episodes(monkeypatch):
    """Without a display: the calls of matplotlib are checked."""
    monkeypatch.setattr(plt, "pause", lambda seconds: None)
    before = plt.get_fignums()
    env = gym.make("probe_env/Insertion-v1", fidelity="fast", render_mode="human").unwrapped
    for seed in range(2):
        env.reset(seed=seed)
        env.step(np.zeros(2, dtype=np.float32))
        (number,) = set(plt.get_fignums()) - set(before)
        (image,) = plt.figure(number).axes[0].images
        assert (image.get_array() == env._renderer.picture()).all()
        assert env.render() is None
    plt.close(number)  # as a user does
    env.render()
    assert len(set(plt.get_fignums()) - set(before)) == 1
    env.close()
    assert plt.get_fignums() == before


def test_limits_are_round_and_include_the_value():
    values = [0.0, 0.011, -3.0, 10.0, 0.2, -51.0]
    assert [outward(value) for value in values] == pytest.approx([0.0, 0.02, -5.0, 10.0, 0.2, -100.0], rel=1e-12)
