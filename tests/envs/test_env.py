"""The environments as users and their checkers see them."""

import copy
import pickle
import re
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import (
    FlattenObservation,
    RecordEpisodeStatistics,
    RenderCollection,
    TimeAwareObservation,
    TimeLimit,
)

import probe_env
from probe_env.envs.contexts import Ranges
from probe_env.inspection.detection import DEPTHS

SHORT = {
    "probe_env/Insertion-v1": {"fidelity": "fast"},
    "probe_env/Snapshot-v1": {},
    "probe_env/Inspection-v0": {"fidelity": "fast"},
}
SNAPSHOT = {"scene": {"carrier_length": 8.0}}
CHECKED = [
    pytest.param("probe_env/Insertion-v1", {"fidelity": "fast"}, marks=pytest.mark.slow),
    pytest.param("probe_env/Inspection-v0", {"fidelity": "fast"}, marks=pytest.mark.slow),
    pytest.param("probe_env/Design-v1", {}, marks=pytest.mark.slow),
    pytest.param("probe_env/Design-v1", {"config": {"privileged": True}}, marks=pytest.mark.slow),
    ("probe_env/Snapshot-v1", SNAPSHOT),
    ("probe_env/Snapshot-v1", SNAPSHOT | {"config": {"observe_root_tension": False, "privileged": True}}),
    ("probe_env/Snapshot-v1", SNAPSHOT | {"config": {"observe_probe": True}}),
]


@pytest.mark.parametrize(("env_id", "arguments"), CHECKED)
def test_the_checkers_of_gymnasium_and_sb3_find_nothing(env_id, arguments):
    from stable_baselines3.common.env_checker import check_env as sb3_check_env

    drawn = {} if "Design" in env_id else {"render_mode": "rgb_array"}
    check_env(gym.make(env_id, **drawn, **arguments).unwrapped)
    sb3_check_env(gym.make(env_id, **arguments).unwrapped)


MODELS = {
    "config": probe_env.TaskConfig(time_limit=20.0, vibration_measure="snr"),
    "scene": probe_env.Scene(feed_speed=0.1),
    "fidelity": probe_env.Fidelity(time_step=1e-4),
}
PLAIN = {  # JSON turns tuples into lists
    "config": {"feed_speeds": (0.05, 0.3)},
    "scene": {"tube": {"helix_diameter": 2.0}, "contact": {"friction": 0.2}},
    "fidelity": {"time_step": 2e-4, "method": "imex"},
}
TUBE = {"tube": {"helix_length": 70.0}, "contact": {"friction": {"low": 0.12, "high": 0.22}}}
SPECS = [
    *((env_id, PLAIN) for env_id in SHORT),
    ("probe_env/Insertion-v1", MODELS | {"contexts": [probe_env.Context(friction=0.2), {"friction": 0.11}]}),
    ("probe_env/Insertion-v1", MODELS | {"contexts": Ranges(friction=(0.12, 0.18))}),
    ("probe_env/Insertion-v1", MODELS | {"contexts": {"helix_diameter": [1.0, 1.5, 2.0]}}),
    ("probe_env/Insertion-v1", MODELS | {"contexts": "train"}),
    ("probe_env/Insertion-v1", {"tube": probe_env.Plant.model_validate(TUBE)}),
]


@pytest.mark.parametrize(("env_id", "settings"), SPECS)
def test_a_spec_goes_through_json(env_id, settings):
    for make in (gym.make, gym.make_vec):
        env = make(env_id, **settings)
        episodes, restored = (one.unwrapped.episodes for one in (env, make(EnvSpec.from_json(env.spec.to_json()))))
        assert (restored.fidelity, vars(restored.sampler)) == (episodes.fidelity, vars(episodes.sampler))
        assert restored.sampler.scene.tube.helix_diameter == (2.0 if settings is PLAIN else 1.2)


def test_the_spec_has_the_number_of_steps_of_the_time_limit():
    tube = {"tube": {"helix_length": 120.0}}  # twice the study's, and so is the time limit
    for name, settings, expected in (
        ("Insertion-v1", {}, 900),
        ("Insertion-v1", {"config": {"time_limit": 300}}, 300),
        ("Insertion-v1", {"config": {"time_limit": 2.1, "period": 0.7}}, 3),  # 2.1 / 0.7 is more than 3
        ("Insertion-v1", {"config": {"time_limit": 0.35, "period": 0.1}}, 4),
        ("Insertion-v1", {"tube": tube}, 1800),
        ("Insertion-v1", {"max_episode_steps": 50}, 50),
        ("Insertion-v1", {"max_episode_steps": -1}, 900),
        ("IncrementalInsertion-v1", {}, 450),
        ("IncrementalInsertion-v1", {"config": {"time_limit": 5}}, 3),  # actions of 2, 2 and 1 periods
        ("Snapshot-v1", {}, 80),
        ("Inspection-v0", {"fidelity": "fast"}, 1800),
        ("Design-v1", {}, 1),
    ):
        env = gym.make(f"probe_env/{name}", **settings)
        assert env.spec.max_episode_steps == TimeAwareObservation(env).max_timesteps == expected
        if name != "Design-v1" and expected > 0 and settings.get("max_episode_steps") != -1:
            assert gym.make_vec(f"probe_env/{name}", 1, **settings).spec.max_episode_steps == expected


def test_an_environment_made_from_its_spec_ends_with_its_figures():
    """Gymnasium adds a TimeLimit of the number in the spec, which ends no episode before the environment does."""
    made = gym.make("probe_env/Snapshot-v1", config={"time_limit": 0.3}, **SNAPSHOT)
    env = made.spec.make()
    assert isinstance(env, TimeLimit)
    env.reset(seed=0)
    steps = [env.step(env.action_space.sample()) for _ in range(3)]
    assert [truncated for *_, truncated, _ in steps] == [False, False, True]
    assert steps[-1][-1]["episode_kpis"]["inspection_time_s"] == pytest.approx(0.3)
    with pytest.raises(RuntimeError, match="call reset before step"):
        env.unwrapped.step(np.zeros(2, dtype=np.float32))


@pytest.mark.parametrize("env_id", SHORT)
def test_a_copy_continues_bit_for_bit(env_id):
    env = gym.make(env_id, **SHORT[env_id])
    env.reset(seed=4)
    action = np.array([0.3, -0.2], dtype=np.float32)
    env.step(action)
    others = copy.deepcopy(env), pickle.loads(pickle.dumps(env))
    for _ in range(2):
        a = env.step(action)
        for b in (other.step(action) for other in others):
            assert (a[0] == b[0]).all()
            assert a[1:4] == b[1:4]
    begun = env.reset()[0]
    assert all((begun == other.reset()[0]).all() for other in others)  # the generator was copied too


def test_wrappers_work():
    env = frames = RenderCollection(gym.make("probe_env/Insertion-v1", render_mode="rgb_array", fidelity="fast"))
    env = RecordEpisodeStatistics(TimeLimit(FlattenObservation(env), 3))
    env.reset(seed=1)
    for _ in range(3):
        *_, truncated, info = env.step(env.action_space.sample())
    assert truncated
    assert info["episode"]["l"] == 3
    assert [(frame.ndim, frame.dtype) for frame in frames.render()] == [(3, np.uint8)] * 4
    env.close()


def test_the_page_lists_what_info_holds():
    text = (Path(__file__).parents[2] / "docs" / "environments.md").read_text().split("## What info holds")[1]
    listed = [
        {name for row in re.findall(r"^\| (`[^|]+) \|", table, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)}
        for table in text.split("\n## ")[0].split("| KPI |")
    ]
    env = gym.make("probe_env/Snapshot-v1", config={"time_limit": 0.2}, **SNAPSHOT)
    _, begun = env.reset(seed=0)
    for _ in range(2):
        *_, truncated, info = env.step(env.action_space.sample())
    assert truncated
    assert [set(begun | info), set(info["episode_kpis"])] == listed
    assert all(type(value) is float for name, value in info["episode_kpis"].items() if name != "pod")
    assert info["episode_kpis"]["pod"].shape == DEPTHS.shape
    batch = gym.make_vec("probe_env/Snapshot-v1", 2, autoreset_mode="SameStep", config={"time_limit": 0.1}, **SNAPSHOT)
    batch.reset(seed=0)
    infos = batch.step(batch.action_space.sample())[4]
    assert infos["final_info"]["episode_kpis"]["pod"].shape == (2, *DEPTHS.shape)


def test_reset_options_set_fields_of_the_context():
    env = gym.make("probe_env/Insertion-v1")
    free = env.reset(seed=3)[1]["context"]
    fixed = env.reset(seed=3, options={"friction": 0.21})[1]["context"]
    assert fixed == free | {"friction": 0.21}
    whole = probe_env.Context(friction=0.12, helix_diameter=2.0)
    assert env.reset(seed=3, options={"context": whole})[1]["context"] == whole.model_dump()
    _, info = env.reset(seed=3, options={"probe": {"guide_length": 4.0}})
    assert info["inserted_length"] == pytest.approx(6.5)
    assert env.unwrapped.episodes.simulated().simulators[0].sensor == 160


@pytest.mark.parametrize(
    ("env_id", "fidelity"),
    [
        *(("probe_env/Insertion-v1", fidelity) for fidelity in ("study", "reference", "standard", "fast")),
        pytest.param("probe_env/Inspection-v0", "study", marks=pytest.mark.slow),
        *(("probe_env/Inspection-v0", fidelity) for fidelity in ("standard", "fast")),
    ],
)
def test_every_preset_simulates_the_whole_model(env_id, fidelity):
    """From 5 m to the end of the helix, and back."""
    short = {"tube": {"helix_length": 5.5}, "carrier_length": 2.5}
    env = gym.make(env_id, fidelity=fidelity, scene=short, config={"settle_time": 0.5}).unwrapped
    env.reset(seed=0)
    ended = False
    while not ended:
        *_, ended, _, info = env.step(np.array([1.0, 0.0], dtype=np.float32))
    assert info["episode_kpis"]["complete"] == 1.0
    assert env.episodes.simulated().simulators[0].scene.assumptions == probe_env.Scene().whole().assumptions


def test_explicit_is_refused_for_the_whole_model():
    settings = {"method": "explicit", "time_step": 5e-6}
    with pytest.raises(ValueError, match=r"air.compressible = true: explicit does not simulate it; use newmark"):
        gym.make("probe_env/Insertion-v1", fidelity=settings)
    gym.make("probe_env/Insertion-v1", fidelity=settings, scene=probe_env.Scene())


MAPPED = {"fidelity": "surrogate"}
REFUSED = [
    ({"fidelity": "best"}, None, "fidelity = 'best'"),
    ({"feed_speed": 3.0}, None, "feed_speed = 3.0"),
    ({"config": {"bogus": 1}}, None, "bogus: there is no such field; accepted"),
    ({"scene": {"tubes": {}}}, None, "tubes"),
    ({"config": {"ratio_cap": 0.0}}, None, "0.0 is outside"),
    ({"probes": "all"}, None, "probes = 'all' is not one of scene, random"),
    ({}, {"fricton": 0.1}, "fricton: there is no such field"),
    ({}, {"friction": 7.0}, "7.0 is outside"),
    ({}, {"carrier_length": 7.0}, "carrier_length is not"),
    ({}, {"context": 3}, r"options\['context'\] = 3 is neither a Context nor a mapping"),
    ({}, {"context": "x"}, r"options\['context'\] = 'x' is neither"),
    ({}, {"context": [1.0]}, r"options\['context'\] = \[1.0\] is neither"),
    ({}, 3, "options = 3 is not a mapping"),
    ({}, {"probe": 3}, r"options\['probe'\] = 3 is not a mapping"),
    ({"contexts": "mine"}, None, "contexts = 'mine' is not one of random, train, validation, test"),
    ({"contexts": []}, None, r"contexts = \[\] is empty"),
    ({"contexts": [{"friction": 0.1}, {"friction": 7.0}]}, None, r"contexts\[1\].friction: 7.0 .* range 0 to 1"),
    ({"contexts": [{"fiction": 0.1}]}, None, r"contexts\[0\].fiction: there is no such field"),
    ({"contexts": {"friction": (0.3, 0.1)}}, None, r"contexts: friction = \[0.3, 0.1\] must ascend"),
    ({"contexts": {"helix_diameter": (0.1, 2.0)}}, None, "contexts: helix_diameter: 0.1 m is outside the accepted"),
    ({"contexts": 3}, None, "contexts = 3 is no name, list of contexts or mapping of ranges"),
    ({"in_turn": True}, None, "in_turn = True needs a list of tubes: contexts = 'train', 'validation'"),
    (MAPPED | {"probes": "random"}, None, "without probes = 'random'"),
    (MAPPED, {"friction": 0.5}, "friction = 0.5 is outside the map's range 0.1 to 0.25"),
    (MAPPED, {"probe": {"line_density": 0.09}}, "probe: the map is of another probe"),
    (MAPPED | {"config": {"growing": False}}, None, "without growing = False"),
    (MAPPED | {"config": {"vibration_measure": "velocity"}}, None, "vibration_measure = 'velocity': maps are of"),
    (MAPPED | {"config": {"vibration_measure": "snr"}}, None, "= 'snr', but the map is of displacement"),
    (MAPPED | {"config": {"friction_drift": 0.1}}, None, "without friction_drift"),
    (MAPPED | {"config": {"sensor_dropout": 0.1}}, None, "without sensor_dropout"),
    (MAPPED | {"scene": {"tube": {"helix_length": 80.0}}}, None, "helix_length = 80 m \\(the map ends at 60 m\\)"),
    (MAPPED | {"scene": probe_env.Scene()}, None, "without contact.weight = False, air.compressible = False, couple"),
    (MAPPED | {"surrogate_map": "configs/tubes/snr-map.npz"}, None, "but the map is of snr"),
]


def test_bad_arguments_and_options_are_named_in_one_line():
    for make in (gym.make, gym.make_vec):
        for arguments, options, message in REFUSED:
            with pytest.raises(ValueError, match=message) as caught:
                make("probe_env/Insertion-v1", **arguments).reset(options=options)
            assert "\n" not in str(caught.value)
            assert "pydantic" not in str(caught.value)


def test_bad_actions_are_named_and_nothing_is_advanced():
    env = gym.make("probe_env/Snapshot-v1").unwrapped
    env.reset(seed=0)
    before = env.episodes.simulated().simulators[0].steps_done
    for action, message in (
        (np.array([np.nan, 0.0]), "action[0] = nan"),
        (np.array([0.0, 1.5]), "action[1] = 1.5"),
        (np.zeros(1), "action has shape (1,); the accepted shape is (2,)"),
        ("0.5", "action = '0.5' is not an array of numbers of the accepted shape (2,)"),
        (["0.5", "0"], "action = ['0.5', '0'] is not an array of numbers of the accepted shape (2,)"),
        ({"feed": 0.5}, "action = {'feed': 0.5} is not"),
        ([[0.0], [0.0, 0.0]], "action = [[0.0], [0.0, 0.0]] is not"),
        (None, "action = None is not"),
        (np.full((2, 1), "0"), "action = array([['0'], ['0']], dtype='<U1') is not"),
    ):
        with pytest.raises(ValueError, match=re.escape(message)):
            env.step(action)
    assert env.episodes.simulated().simulators[0].steps_done == before
    for fidelity in ("fast", "surrogate"):
        envs = gym.make_vec("probe_env/Insertion-v1", 2, vectorization_mode="vector_entry_point", fidelity=fidelity)
        envs.reset(seed=0)
        for actions, message in ((["0", "0"], "is not an array of num"), (np.zeros((1, 2)), "action has shape (1, 2)")):
            with pytest.raises(ValueError, match=f"{re.escape(message)}.* accepted shape .*{re.escape('(2, 2)')}"):
                envs.step(actions)
