"""Superelements give way to nodes where the cable between floats is more than elastic, and say so."""

import gymnasium as gym
import numpy as np
import pytest

from agents.evaluation.run import plan_of
from agents.policies.cases import case_of
from probe_env import Fidelity, Plant, Scene
from probe_env.envs.episodes import Episodes
from probe_env.fidelity import PRESETS, resolve_fidelity
from probe_env.physics.methods import METHODS, ON_NODES

CABLE = {"contact": {"cable": True}}
NEEDING = {"cable": CABLE, "tangent": {"couple": "tangent"}}
SHORT = {"tube": {"helix_length": 8.0}}


@pytest.mark.parametrize("needing", NEEDING)
@pytest.mark.parametrize("name", [name for name, fidelity in PRESETS.items() if fidelity.simulates])
def test_presets_have_nodes_where_the_scene_needs_some(name, needing):
    scene, preset = Scene.model_validate(NEEDING[needing]), PRESETS[name]
    assert resolve_fidelity(name) == resolve_fidelity(name, Scene()) == preset
    taken, method = resolve_fidelity(name, scene), METHODS[preset.method]
    if preset.method in ON_NODES:
        assert taken == preset
        return
    assert taken.method in ON_NODES
    assert method.precision == METHODS[taken.method].precision
    assert taken.time_lapse == preset.time_lapse
    assert taken.nodes_per_pitch == 8  # the converged mesh
    limit = METHODS[taken.method].stable_step(scene, taken.nodes_per_pitch)
    assert METHODS[taken.method].least_step <= taken.time_step <= min(preset.time_step, limit)
    assert resolve_fidelity(taken, scene) == taken


def test_auto_and_settings_of_ones_own_give_way_as_well():
    scene = Scene.model_validate(CABLE)
    for given in ("auto", {"method": "superelement", "time_step": 1e-4}):
        elastic, taken = resolve_fidelity(given), resolve_fidelity(given, scene)
        assert elastic.method not in ON_NODES
        assert (taken.method, taken.nodes_per_pitch) == (elastic.method.replace("superelement", "imex"), 8)
        assert taken.time_step <= elastic.time_step
    own = Fidelity(method="imex", time_step=1e-4, nodes_per_pitch=4)
    assert resolve_fidelity(own, scene) == own


@pytest.mark.parametrize("env_id", ["Insertion", pytest.param("Design", marks=pytest.mark.slow)])
def test_environments_simulate_such_a_scene_by_default(env_id):
    """Digit by digit as with the settings that are taken."""
    taken, tube = resolve_fidelity("standard", Scene.model_validate(CABLE)), SHORT | CABLE
    if env_id == "Design":
        tube = tube | {"tube": {"helix_length": 60.0}}
    envs = [gym.make(f"probe_env/{env_id}-v1", tube=tube, **given) for given in ({}, {"fidelity": taken})]
    for env in envs:
        assert env.unwrapped.config.scene.contact.cable
        env.reset(seed=3)
        env.action_space.seed(3)
    for _ in range(1 if env_id == "Design" else 3):
        one, other = (env.step(env.action_space.sample()) for env in envs)
        np.testing.assert_array_equal(one[0], other[0])
        assert one[1] == other[1]


def test_an_evaluation_by_auto_goes_by_its_own_tubes():
    """As its episodes do; a contact that is harder than table 2's takes another setting."""
    hard = Plant.model_validate({"contact": {"stiffness": 5e5}})
    place = case_of(hard, "test", 2)
    plan = plan_of(["constant"], place, 1, "auto:0.5")
    episodes = Episodes(1, plan.config, threads=1, fidelity="auto:0.5", contexts=place.contexts)
    assert plan.fidelity == episodes.fidelity != resolve_fidelity("auto:0.5")


def test_an_evaluation_keeps_what_it_was_simulated_with():
    """In the plan, so in setting and manifest, also at half the step and where a finer fidelity checks it."""
    place = case_of(Plant.model_validate(SHORT | CABLE), "test", 1)
    plan = plan_of(["constant"], place, 1, "fast")
    assert plan.fidelity == resolve_fidelity("fast", Scene.model_validate(CABLE))
    assert plan.setting()["fidelity"] == plan.fidelity.model_dump()
    episodes = Episodes(1, plan.config, threads=1, fidelity=PRESETS["fast"])
    assert episodes.fidelity == plan.fidelity
