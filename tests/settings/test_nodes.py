"""A mesh of nodes replaces superelements if the scene needs nodes between floats."""

import gymnasium as gym
import numpy as np
import pytest

from probe_agents.evaluation.run import plan_of
from probe_agents.policies.cases import load_case
from probe_env import Fidelity, Plant, Scene
from probe_env.envs.episodes import Episodes
from probe_env.fidelity import PRESETS, resolve_fidelity

CABLE = {"contact": {"cable": True}}
SHORT = {"tube": {"helix_length": 8.0}}


@pytest.mark.parametrize("name", [name for name, fidelity in PRESETS.items() if fidelity.simulates])
def test_presets_have_nodes_if_the_scene_needs_them(name):
    scene, preset = Scene.model_validate(CABLE), PRESETS[name]
    assert resolve_fidelity(name) == resolve_fidelity(name, Scene(couple="tangent")) == preset
    chosen = resolve_fidelity(name, scene)
    if preset.method.on_nodes:
        assert chosen == preset
        return
    assert chosen.method.on_nodes
    assert chosen.method.precision == preset.method.precision
    assert chosen.time_lapse == preset.time_lapse
    assert chosen.nodes_per_pitch == 8  # the converged mesh
    limit = chosen.method.stable_step(scene, chosen.nodes_per_pitch)
    assert chosen.method.min_step <= chosen.time_step <= min(preset.time_step, limit)
    assert resolve_fidelity(chosen, scene) == chosen


def test_auto_and_custom_settings():
    scene = Scene.model_validate(CABLE)
    for fidelity in ("auto", {"method": "superelement", "time_step": 1e-4}):
        elastic, chosen = resolve_fidelity(fidelity), resolve_fidelity(fidelity, scene)
        assert not elastic.method.on_nodes
        assert (chosen.method, chosen.nodes_per_pitch) == (elastic.method.on_nodes_as, 8)
        assert chosen.time_step <= elastic.time_step
    custom = Fidelity(method="imex", time_step=1e-4, nodes_per_pitch=4)
    assert resolve_fidelity(custom, scene) == custom


@pytest.mark.parametrize("env_id", ["Insertion", pytest.param("Design", marks=pytest.mark.slow)])
def test_environments_replace_superelements_by_default(env_id):
    """Equal bits as with explicit settings."""
    chosen = resolve_fidelity("fast", Scene.model_validate(CABLE), growing=env_id == "Insertion")
    tube = CABLE | ({"tube": {"helix_length": 60.0}} if env_id == "Design" else SHORT)
    envs = [gym.make(f"probe_env/{env_id}-v1", tube=tube, **options) for options in ({}, {"fidelity": chosen})]
    for env in envs:
        assert env.unwrapped.config.scene.contact.cable
        env.reset(seed=3)
        env.action_space.seed(3)
    for _ in range(1 if env_id == "Design" else 3):
        one, other = (env.step(env.action_space.sample()) for env in envs)
        np.testing.assert_array_equal(one[0], other[0])
        assert one[1] == other[1]


def test_an_evaluation_by_auto_uses_its_tubes():
    """As its episodes do; stiffer contact than that of table 2 needs other settings."""
    hard = Plant.model_validate({"contact": {"stiffness": 5e5}})
    case = load_case(hard, "test", 2)
    plan = plan_of(["constant"], case, 1, "auto:0.5")
    episodes = Episodes(1, plan.config, threads=1, fidelity="auto:0.5", contexts=case.contexts)
    assert plan.fidelity == episodes.fidelity != resolve_fidelity("auto:0.5")


def test_an_evaluation_keeps_what_it_was_simulated_with(tmp_path):
    """In the plan, so in setting and manifest, also at half the step and where a finer fidelity checks it."""
    case = load_case(Plant.model_validate(SHORT | CABLE), "test", 1)
    plan = plan_of(["constant"], case, 1, "fast")
    assert plan.fidelity == resolve_fidelity("fast", Scene.model_validate(CABLE))
    assert plan.folder(tmp_path).identity["fidelity"] == plan.fidelity.model_dump()
    episodes = Episodes(1, plan.config, threads=1, fidelity=PRESETS["fast"])
    assert episodes.fidelity == plan.fidelity
