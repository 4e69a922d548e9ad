"""Registered environments, and their fidelity by name, by default and as settings."""

from typing import get_args, get_type_hints

import gymnasium as gym

import probe_env
from probe_agents.cli.evaluation import Render
from probe_agents.vec_env import ENVIRONMENTS, EnvId, ProbeVecEnv
from probe_env.fidelity import PRESETS, ROUND_TRIP_PRESETS

INSPECTION, INCREMENTAL = "probe_env/Inspection-v0", "probe_env/IncrementalInsertion-v1"
NAMES = ("Insertion-v1", "IncrementalInsertion-v1", "Snapshot-v1", "Inspection-v0")


def fidelities(env_id, **options):
    envs = gym.make(env_id, **options), gym.make_vec(env_id, 2, **options), ProbeVecEnv(env_id, 2, **options)
    return [env.unwrapped.episodes.fidelity for env in envs]


def test_every_environment_is_in_every_list_of_them():
    ids = {key for key in gym.registry if key.startswith("probe_env/")}
    assert ids == {f"probe_env/{name}" for name in (*NAMES, "Design-v1")}
    assert set(ENVIRONMENTS) == set(get_args(EnvId)) == ids - {"probe_env/Design-v1"}
    # policies by name give targets
    assert set(get_args(get_type_hints(Render)["env_id"])) == ids - {"probe_env/Design-v1", INCREMENTAL}


def test_fidelity_by_default_by_name_and_by_settings():
    """At constant length the default has no time-lapse: there it is ``standard``."""
    own = probe_env.Fidelity(time_step=1e-4)
    for env_id, name in (("probe_env/Insertion-v1", "fast"), ("probe_env/Snapshot-v1", "standard")):
        assert fidelities(env_id) == fidelities(env_id, fidelity="fast") == [PRESETS[name]] * 3
        assert fidelities(env_id, fidelity=own) == [own] * 3
    assert gym.make("probe_env/Design-v1").unwrapped.fidelity == PRESETS["standard"]
    for name, preset in ROUND_TRIP_PRESETS.items():
        assert fidelities(INSPECTION, fidelity=name) == [preset] * 3
