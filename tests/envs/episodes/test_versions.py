"""A version of the environments is its physics: by make, make_vec, Stable-Baselines3's batch and for designs."""

from typing import get_args, get_type_hints

import gymnasium as gym
import pytest

import probe_env
from agents.commands.feed import Render
from agents.vec_env import ENVIRONMENTS, EnvId, ProbeVecEnv
from probe_env.envs.env import InspectionEnv
from probe_env.envs.episodes.starts import VERSIONS
from probe_env.fidelity import BOTH_WAYS, PRESETS

PHYSICS = {"v0": PRESETS["standard-v0"], "v1": PRESETS["standard"]}
INSPECTION = "probe_env/Inspection-v0"
OLD = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")
EACH = [pytest.param("v0", marks=OLD), "v1"]


def test_every_version_is_registered_and_the_newest_is_the_classes_own():
    ids = {key for key in gym.registry if key.startswith("probe_env/")}
    kinds = ("Insertion", "Snapshot", "Design")
    assert ids == {f"probe_env/{kind}-{version}" for kind in kinds for version in VERSIONS} | {INSPECTION}
    assert set(PHYSICS) == set(VERSIONS)
    assert set(ENVIRONMENTS) == {key for key in ids if "Design" not in key}
    assert set(get_args(EnvId)) == set(get_args(get_type_hints(Render)["env_id"])) == set(ENVIRONMENTS)
    assert ENVIRONMENTS[INSPECTION] == (InspectionEnv, {})
    for env_id, (kind, settings) in ENVIRONMENTS.items():
        if env_id == INSPECTION:  # its first version, and no other physics than its own
            continue
        assert env_id == f"probe_env/{kind.__name__.removesuffix('Env')}-{_version_of(settings)}"
    assert probe_env.Fidelity() == PHYSICS[max(VERSIONS)]


def _version_of(settings):
    return next(version for version, of_version in VERSIONS.items() if of_version is settings)


@pytest.mark.parametrize("version", EACH)
@pytest.mark.parametrize("kind", ["Insertion", "Snapshot"])
def test_the_version_sets_the_physics(kind, version):
    env_id = f"probe_env/{kind}-{version}"
    assert gym.make(env_id).unwrapped.episodes.fidelity == PHYSICS[version]
    assert gym.make_vec(env_id, num_envs=2).unwrapped.episodes.fidelity == PHYSICS[version]
    assert ProbeVecEnv(env_id, 2).episodes.fidelity == PHYSICS[version]


@pytest.mark.parametrize("name", list(BOTH_WAYS))
def test_the_way_back_has_presets_of_its_own(name):
    for env in (gym.make(INSPECTION, fidelity=name), gym.make_vec(INSPECTION, num_envs=2, fidelity=name)):
        assert env.unwrapped.episodes.fidelity == BOTH_WAYS[name]


@pytest.mark.parametrize("version", EACH)
def test_designs_too(version):
    assert gym.make(f"probe_env/Design-{version}").unwrapped.fidelity == PHYSICS[version]


@OLD
def test_a_fidelity_that_is_given_counts():
    own = probe_env.Fidelity(time_step=1e-4)
    assert gym.make("probe_env/Snapshot-v0", fidelity=own).unwrapped.episodes.fidelity == own
    assert ProbeVecEnv("probe_env/Snapshot-v0", 1, fidelity=own).episodes.fidelity == own


def test_the_old_version_says_that_there_is_a_newer_one():
    with pytest.warns(DeprecationWarning, match="Snapshot-v0 is out of date"):
        gym.make("probe_env/Snapshot-v0")
