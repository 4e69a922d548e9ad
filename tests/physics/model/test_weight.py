"""Weight of the cable across the plane, friction mu sqrt(N^2 + w^2): closed forms, time steps, methods, batches."""

import math

import numpy as np
import pytest
from oracles.chains import tip_equation, uniform_chain

from probe_env import Fidelity, Scene, Simulator, SimulatorBatch
from probe_env.envs.episodes.limits import check_fidelity
from probe_env.envs.episodes.predicted import check_task
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.vibration_map import stored_map
from probe_env.physics.closed_forms import steady_tensions
from probe_env.physics.methods import METHODS
from probe_env.physics.model.chain import build_chain
from probe_env.physics.model.state import at_rest
from probe_env.physics.simulation.batch import groups_of

SHORT = {"carrier_length": 2.5, "probe": {"guide_length": 0.5}, "feed_speed": 0.05}
WEIGHING = [name for name, method in METHODS.items() if method.simulates_weight]


def scene_of(weight, **changes):
    return Scene.model_validate(SHORT | {"contact": {"weight": weight}} | changes)


def mean_tension(scene, method, factor=1.0):
    """Mean root tension from 1.0 s to 1.5 s [N], at a factor of the usual step."""
    simulator = Simulator(scene, method, factor * METHODS[method].usual_step)
    simulator.advance(duration=1.0)
    return simulator.advance(duration=0.5, points=("root",)).tension[1:, 0].mean()


def test_weight_of_a_float():
    """A pitch of cable: 0.111 kg/m times 0.1 m times g, on any mesh."""
    for nodes_per_pitch in (1, 4, 8):
        assert build_chain(scene_of(True), nodes_per_pitch).float_weight == pytest.approx(0.108854, rel=1e-5)
    assert build_chain(scene_of(False)).float_weight == 0.0


@pytest.mark.parametrize(("y", "depth"), [(-2e-6, 2e-6), (1e-3, 0.0), (5.2e-3 + 1e-6, 1e-6)])
@pytest.mark.parametrize(("v_x", "direction"), [(0.1, 1.0), (-0.2, 1.0), (-0.3, -1.0)])
def test_force_on_one_float(y, depth, v_x, direction):
    """At the inner wall, lifted off and at the outer wall, added to the force without weight; feed 0.2 m/s."""
    k, mu, w = 1e5, 0.15, 0.11
    chain = uniform_chain(1, contact_stiffness=np.array([k, 0.0]), outer_gap=np.full(2, 5.2e-3))._replace(friction=mu)
    state = at_rest(2)
    state.d[0, 1], state.v[0, 0] = y, v_x
    inputs = (0.2, 0.0, 0.0)
    (P, q), (P_weight, q_weight) = (tip_equation(one, inputs, state) for one in (chain, chain._replace(float_weight=w)))
    normal = k * depth
    assert (P_weight == P).all()
    added = -direction * mu * (math.sqrt(normal**2 + w**2) - normal)
    assert q_weight - q == pytest.approx([added, 0.0, 0.0], abs=1e-12)
    assert abs(added) > 0.001


@pytest.mark.parametrize("method", WEIGHING)
def test_steady_sliding_in_the_helix(method):
    """Root tension over that without weight, which cancels the ends; at half the step, too."""
    heavy, light = scene_of(True), scene_of(False)
    expected = steady_tensions(heavy)[-1] / steady_tensions(light)[-1]
    assert expected == pytest.approx(0.9453, rel=1e-4)
    without = mean_tension(light, method)
    for factor in (1.0, 0.5):
        assert mean_tension(heavy, method, factor) / without == pytest.approx(expected, rel=3e-4)
    assert without == pytest.approx(steady_tensions(light)[-1], rel=2.5e-3)
    both = scene_of(True, air={"compressible": True})
    expected_both = steady_tensions(both)[-1] / steady_tensions(light)[-1]
    assert expected_both == pytest.approx(0.9079, rel=1e-4)
    assert mean_tension(both, method) / without == pytest.approx(expected_both, rel=1e-3)


@pytest.mark.parametrize(("method", "direction"), [*((method, 1.0) for method in WEIGHING), ("newmark", -1.0)])
def test_steady_sliding_off_the_walls(method, direction):
    """In a straight tube no float touches a wall: T = (q - mu w) s; backwards friction pulls with the air."""
    couple = "frame" if direction > 0.0 else "tangent"
    scene = scene_of(True, tube={"helix_diameter": 1e4}, feed_speed=0.05 * direction, couple=couple)
    expected = steady_tensions(scene, 0.0)[-1] - direction * 0.15 * 0.111 * 9.80665 * 3.0
    assert steady_tensions(scene)[-1] == pytest.approx(expected, rel=1e-4)
    # without weight, imex is 1.5e-4 too high as well
    assert mean_tension(scene, method) == pytest.approx(expected, rel=2e-4 if method.startswith("imex") else 1e-4)


def test_start_with_weight_converges_with_the_time_step():
    """Axial motion of the tip in the first 0.1 s."""

    def start(method, time_step):
        simulator = Simulator(scene_of(True, feed_speed=0.2), method, time_step)
        return simulator.run(0.1, points=("tip",)).axial[:, 0]

    exact = start("newmark", 2.5e-5)
    size = np.abs(exact).max()
    errors = [np.abs(start("newmark", step) - exact).max() / size for step in (2e-4, 5e-5)]
    assert errors[1] < 0.2 * errors[0] < 0.02
    assert np.abs(start("implicit", 2.5e-5) - exact).max() < 5e-3 * size


@pytest.mark.parametrize("method", ["superelement32", "imex", pytest.param("superelement", marks=pytest.mark.slow)])
def test_batches_equal_single_probes(method):
    """With and without weight and the terms, in uniform and in expanding air, while growing, by calls of any length."""
    scenes = [
        scene_of(
            k < 4,
            carrier_length=1.5,
            feed_speed=0.2,
            air={"compressible": k % 2 == 1},
            air_supply_rate=0.017 + 1e-3 * k,
            terms={"shortening": k < 4, "stiction": k < 4, "entrance": k < 4},
        )
        for k in range(5)
    ]
    options = {"growing": True, "time_lapse": 20.0, "perturbation": 1e-6}
    batch = SimulatorBatch(scenes, method, threads=1, **options)
    assert [len(group) for group in groups_of(batch.simulators, range(5))] == [4, 1]
    batch.advance(duration=0.1)
    for seed, (scene, grouped) in enumerate(zip(scenes, batch.simulators, strict=True)):
        alone = Simulator(scene, method, 2e-4, seed=seed, **options)
        for duration in (0.03, 0.07):
            alone.advance(duration=duration)
        assert alone.root == grouped.root > 90
        assert all(map(np.array_equal, alone.state, grouped.state))


def test_methods_without_weight_refuse_it():
    scene = scene_of(True)
    for method in set(METHODS) - set(WEIGHING):
        with pytest.raises(ValueError, match=f"^contact.weight = true: {method} does not simulate it; use newmark, "):
            Simulator(scene, method, METHODS[method].usual_step)
        with pytest.raises(ValueError, match=f"^chain.float_weight is not zero: {method} does not simulate it"):
            METHODS[method].constants(build_chain(scene), 20, 4, METHODS[method].usual_step)


@pytest.mark.parametrize(("section", "field"), [("contact", "weight"), ("air", "compressible")])
def test_tasks_need_a_method_for_weight_and_expansion(section, field):
    config = TaskConfig(scene=Scene(carrier_length=0.5, **{section: {field: True}}))
    check_fidelity(Fidelity(), config)
    with pytest.raises(ValueError, match=rf"^{section}\.{field} = true: explicit does not simulate it; use newmark, "):
        check_fidelity(Fidelity(method="explicit"), config)
    with pytest.raises(ValueError, match=r"without .*couple = 'frame', .*: simulate with standard"):
        check_task(config, "scene", stored_map())  # which is of the whole model
