"""Sensor noise, delay and drop-outs, and contexts from custom lists and ranges."""

import gymnasium as gym
import numpy as np
import pytest

import probe_env
from probe_agents.policies.view import View
from probe_env import Context, Plant, TaskConfig
from probe_env.envs.contexts import Ranges, draw_context
from probe_env.envs.episodes.starts import checked_contexts, sample_context
from probe_env.envs.task.observations import observe
from probe_env.envs.task.scales import LOAD_CELL, OBSERVATIONS

SHORT = {"growing": False, "period": 0.05, "time_limit": 1.0, "settle_time": 0.05}
ACTIONS = np.random.default_rng(0).uniform(-1.0, 1.0, (8, 2)).astype(np.float32)


def observations(**config):
    env = gym.make("probe_env/Insertion-v1", config=SHORT | config, scene=probe_env.Scene(carrier_length=2.0))
    rows = [env.reset(seed=3)[0]]
    return np.array(rows + [env.step(action)[0] for action in ACTIONS])


def test_noise_has_the_standard_deviation_of_the_task():
    """4,000 draws: the deviation is within 6 standard errors of 1.1 % each (probability 2e-9)."""
    count = 4000
    names = ("radial_acceleration_rms_m_per_s2", "axial_acceleration_rms_m_per_s2", "radial_rms_m", "tension_mean_n")
    measured = {name: np.full(count, 2.0) for name in (*names, *OBSERVATIONS)}
    noise = np.random.default_rng(1).normal(size=(count, 2))
    columns = list(TaskConfig().observations)
    for rf, tension in ((0.05, 0.02), (0.2, 0.1), (0.0, 0.0)):
        rows = observe(TaskConfig(rf_noise=rf, tension_noise=tension), measured, noise).astype(float)
        spread = rows.std(axis=0)
        assert spread[columns.index("rf_noise")] == pytest.approx(rf / np.log(10.0), rel=6 * 0.0112, abs=1e-6)
        assert spread[columns.index("root_tension")] == pytest.approx(0.1 * tension, rel=6 * 0.0112, abs=1e-6)
    for tension, observed in ((2e4, LOAD_CELL / 20.0), (-2e4, -LOAD_CELL / 20.0)):  # it saturates
        clipped = observe(TaskConfig(), measured | {"tension_mean_n": np.full(count, tension)}, noise)
        assert (clipped[:, columns.index("root_tension")] == observed).all()


def test_contexts_are_sampled_from_lists_and_ranges():
    listed = [Context(friction=0.2), {"friction": 0.3, "helix_diameter": 1.9}]
    env = gym.make("probe_env/Insertion-v1", config=SHORT, contexts=listed)
    samples = {env.reset(seed=seed)[1]["context"]["friction"] for seed in range(12)}
    assert samples == {0.2, 0.3}  # a chance of 2^-11 to miss one, with these seeds it does not
    assert checked_contexts(listed)[1].helix_diameter == 1.9
    rng, same = np.random.default_rng(5), np.random.default_rng(5)
    ranges = {"friction": (0.3, 0.35), "helix_diameter": 1.9, "drag_factor": [0.8, 1.0, 1.2]}
    plain, sample = draw_context(same), sample_context(checked_contexts(ranges), rng, {})
    assert 0.3 <= sample.friction <= 0.35
    assert sample.helix_diameter == 1.9
    assert sample.drag_factor in (0.8, 1.0, 1.2)
    assert sample.contact_stiffness == plain.contact_stiffness
    assert (sample.friction - 0.3) / 0.05 == pytest.approx((plain.friction - 0.1) / 0.15)
    assert Ranges(contact_stiffness=(1e5, 3e6)).stiffest == 3e6
    for contexts in ({"contact_stiffness": (1e5, 1.8e5)}, [{"contact_stiffness": 1.8e5}, {"friction": 0.2}]):
        env = gym.make("probe_env/Insertion-v1", contexts=contexts).unwrapped
        assert env.episodes.sampler.stiffest.contact.stiffness == 1.8e5


def test_delays_and_drop_outs_repeat_observations():
    usual, late = observations(), observations(delay_periods=3)
    assert (late[:4] == usual[0]).all()  # the episode begins with its first observation
    assert (late[3:] == usual[:-3]).all()
    names = list(TaskConfig().observations)
    dropping = [names.index(name) for name in ("rf_noise", "root_tension")]
    none, all_repeated = observations(sensor_dropout=0.0), observations(sensor_dropout=1.0)
    assert (usual == none).all()  # no random number is used
    assert (all_repeated[:, dropping] == all_repeated[0, dropping]).all()
    assert (np.delete(all_repeated, dropping, axis=1) == np.delete(usual, dropping, axis=1)).all()
    # eight periods with probability 0.5: none or all has a probability of 2^-7, and not with this seed
    some = observations(sensor_dropout=0.5)
    repeated = (some[1:, dropping] == some[:-1, dropping]).all(axis=1)
    assert 0 < repeated.sum() < len(repeated)


@pytest.mark.parametrize("fidelity", ["fast", {"method": "imex32"}])
def test_friction_drifts_along_the_tube(fidelity):
    """Friction is the mean over the inserted length: less near the entrance, the context's at the end."""
    tensions = []
    for drift in (0.3, 0.0, -0.3):
        env = gym.make("probe_env/Insertion-v1", fidelity=fidelity, config={"friction_drift": drift}).unwrapped
        before = env.reset(seed=1, options={"friction": 0.2})[1]["inserted_length"]
        tensions.append(env.step(np.ones(2, dtype=np.float32))[4]["tension_mean_n"])
        expected = 0.2 * (1.0 - drift * (1.0 - before / 60.0))
        assert env.episodes.simulated().simulators[0].chain.friction == pytest.approx(expected)
    assert tensions[0] > tensions[1] > tensions[2]


def test_oval_tube_has_less_clearance_in_plane():
    oval = probe_env.Scene.fitted({"tube": {"ovality": 0.1}})
    gaps = [probe_env.Simulator(scene).chain.outer_gap[0] for scene in (probe_env.Scene(), oval)]
    assert gaps[0] - gaps[1] == pytest.approx(0.05 * 24.2e-3)
    with pytest.raises(ValueError, match=r"must be less than tube.inner_diameter = 0.0242 m less half of tube.ovality"):
        probe_env.Scene.fitted({"tube": {"ovality": 0.45}})


def test_settings_are_accepted_in_groups_and_by_themselves():
    """In Python, by ``gym.make`` and in a plant's file; the stored form is flat."""
    grouped = {"reward": {"time_weight": 0.3}, "limits": {"tension_limit": 5.0}, "period": 0.5}
    flat = {"time_weight": 0.3, "tension_limit": 5.0, "period": 0.5}
    expected = TaskConfig(**flat)
    assert TaskConfig(**grouped) == TaskConfig().model_copy(update=grouped) == expected
    assert TaskConfig.model_validate_json(expected.model_dump_json()) == expected
    assert Plant(task=grouped).configured().model_dump() == Plant(task=flat).configured().model_dump()
    env = gym.make("probe_env/Inspection-v0", config=grouped | {"round_trip": {"passes": "in"}}, fidelity="fast")
    own = {"time_limit": 1800.0}  # the environment keeps its defaults
    assert env.unwrapped.config == expected.model_copy(update=own)
    assert all(info.description for info in TaskConfig.model_fields.values())
    for old in ({"inspects": "back"}, {"round_trip": {"inspects": "back"}}, {"scored_pass": "back"}):
        assert TaskConfig(passes="both", **old) == TaskConfig(passes="both", scored_pass="withdrawal")
    assert View(observations=("feed_speed", "way")).observations == ("feed_speed", "direction")
    for wrong, message in (
        ({"inspects": "back", "scored_pass": "best"}, "inspects"),
        ({"reward": {"tension_limit": 5.0}}, "reward = .* must be a table of vibration_measure, "),
        ({"reward": {"time_weight": 0.3}, "time_weight": 0.3}, "reward.time_weight: given twice"),
        ({"reward": {"time_weight": -1.0}}, "time_weight"),
        ({"rewards": {}}, "rewards"),
    ):
        with pytest.raises(ValueError, match=message):
            TaskConfig(**wrong)
