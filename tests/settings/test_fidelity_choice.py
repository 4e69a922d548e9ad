"""Fidelities by name, and "auto" with its reasons."""

import gymnasium as gym
import numpy as np
import pytest
from oracles.scatter import apart, reach

from probe_env import Fidelity, Scene, SimulatorBatch
from probe_env.fidelity import MAX_TIME_LAPSE, PRESETS, choose_fidelity, measured_errors, outputs, resolve_fidelity
from probe_env.physics.methods import METHODS


def stated_error(fidelity, length):
    """The stated error of the radial rms on table 2's stiffness."""
    (row,) = [
        r for r in measured_errors()
        if (r.fidelity, r.length, r.stiffness, r.output) == (fidelity, length, 1e5, "radial_rms_m")
    ]  # fmt: skip
    return row.error


def test_the_cheapest_settings_within_the_tolerance():
    scene = Scene(carrier_length=30.0)
    loose = choose_fidelity(scene, 0.3)
    tolerance = 0.99 * loose.error
    tight = choose_fidelity(scene, tolerance)
    assert loose.error <= 0.3
    assert tight.error <= tolerance
    assert loose.cost < tight.cost
    for choice in (loose, tight):
        assert f"{choice.fidelity.time_step:g} s" in choice.reason
        assert "measured error of radial_rms_m at most" in choice.reason
        fidelity = choice.fidelity
        limit = fidelity.method.stable_step(scene, fidelity.nodes_per_pitch)
        assert fidelity.time_step <= limit
    cheaper = [r for r in measured_errors() if r.length == 30.0 and r.stiffness == 1e5 and r.output == "radial_rms_m"]
    assert all(r.error > tolerance for r in cheaper if r.cost < 0.99 * tight.cost)


def test_errors_of_superelements_and_meshes():
    """A default and its double by name; the converged mesh itself where nothing cheaper is near enough."""
    kinds = {(row.fidelity.method.name, row.fidelity.nodes_per_pitch) for row in measured_errors()}
    assert len(measured_errors()) > 200
    assert all(row.error >= 0.0 and row.cost > 0.0 for row in measured_errors())
    assert {("superelement32", 4), ("superelement", 4), ("imex32", 8), ("imex", 16)} <= kinds
    assert choose_fidelity(Scene()).fidelity.method.name == "superelement32"
    probe = {"float_pitch": 0.15, "guide_length": 1.2}
    hard = Scene.model_validate({"contact": {"stiffness": 5e5}, "probe": probe, "carrier_length": 12.0})
    with pytest.raises(ValueError, match="asks for modes"):
        METHODS["superelement32"].stable_step(hard, 4)
    assert choose_fidelity(hard, 1.0).fidelity.method.name.startswith("imex")


def test_length_stiffness_and_outputs():
    short, long = (choose_fidelity(Scene(carrier_length=length), 0.3) for length in (10.0, 50.0))
    assert (short.error, long.error) == (stated_error(short.fidelity, 10.0), stated_error(long.fidelity, 50.0))
    between = choose_fidelity(Scene(carrier_length=45.0), 0.3)
    assert between.error == max(stated_error(between.fidelity, 40.0), stated_error(between.fidelity, 50.0))
    soft = Scene.model_validate({"carrier_length": 30.0, "contact": {"stiffness": 1e4}})
    assert (
        choose_fidelity(soft, 0.2).fidelity.time_step
        > choose_fidelity(Scene(carrier_length=30.0), 0.2).fidelity.time_step
    )
    more = choose_fidelity(Scene(carrier_length=50.0), 0.3, ("radial_rms_m", "lift_off_share"))
    assert more.error >= choose_fidelity(Scene(carrier_length=50.0), 0.3).error - 1e-12


def test_time_lapse_is_for_growing_probes():
    assert choose_fidelity(Scene(), 0.5).fidelity.time_lapse == 1.0
    assert choose_fidelity(Scene(), 0.5, growing=True).fidelity.time_lapse == MAX_TIME_LAPSE


def test_errors_of_the_choice():
    stiff = Scene.model_validate({"contact": {"stiffness": 1e7}})
    for arguments, message in (
        ({"tolerance": 1e-6}, "tolerance = 1e-06 is not met by any settings for this scene: the least error is"),
        ({"tolerance": -1.0}, "tolerance = -1.0 is outside the accepted range above 0"),
        ({"needed": ("colour",)}, "must be some of axial_peak_hz, axial_rms_m"),
        ({"needed": ()}, "must be some of axial_peak_hz, axial_rms_m"),
        ({"scene": stiff}, "contact.stiffness = 1e\\+07 is outside the measured range 10000 to 1e\\+06"),
    ):
        with pytest.raises(ValueError, match=message):
            choose_fidelity(**({"scene": Scene()} | arguments))


def test_names():
    assert resolve_fidelity("reference") == PRESETS["reference"]
    assert resolve_fidelity({"time_step": 1e-4}) == Fidelity(time_step=1e-4)
    assert resolve_fidelity("auto:0.3", Scene(), growing=False) == choose_fidelity(Scene(), 0.3).fidelity
    for wrong, message in (("best", "not one of study, reference.*settings$"), ("auto:much", "'much' is not a number")):
        with pytest.raises(ValueError, match=message):
            resolve_fidelity(wrong)
    assert set(outputs()) >= {"radial_rms_m", "radial_p99_m", "lift_off_share", "axial_peak_hz"}


def test_a_step_below_rounding_is_refused_before_anything_runs():
    with pytest.raises(
        ValueError, match=r"time_step = 2e-05 s is below 5e-05 s, where the rounding of superelement32 shows"
    ):
        gym.make("probe_env/Snapshot-v1", fidelity={"time_step": 2e-5})
    assert resolve_fidelity({"method": "imex", "time_step": 2e-5}).time_step == 2e-5


def test_environments_take_auto():
    env = gym.make("probe_env/Insertion-v1", fidelity="auto:0.5", config={"settle_time": 0.5})
    assert env.unwrapped.episodes.fidelity.time_lapse > 1.0
    env.reset(seed=0)
    assert np.isfinite(env.step(env.action_space.sample())[1])
    with pytest.raises(ValueError, match=r"tolerance = 0\.001 is not met"):
        gym.make("probe_env/Snapshot-v1", fidelity="auto:0.001")


# scenes that are in no ensemble of the chart
UNSEEN = Scene.model_validate(
    {"carrier_length": 40.0, "tube": {"helix_diameter": 1.4}, "contact": {"friction": 0.18, "stiffness": 1.3e5}}
)


def rms_at_constant_length(fidelity, seeds):
    scenes = [UNSEEN] * len(seeds)
    batch = SimulatorBatch(scenes, fidelity.method, fidelity.time_step, perturbation=1e-7, seeds=seeds)
    batch.advance(None, None, 2.0)
    return batch.advance(None, None, 5.0).statistics["radial_rms_m"]


@pytest.mark.slow
@pytest.mark.processor
def test_the_stated_error_of_standard_holds_on_an_unseen_scene(seeds):
    """l = 40 m between the chart's lengths, another tube, friction and stiffness.

    11 % are stated (a member +- 12 and 13 %). With 16 against 12 chance is another 21 %: a third is noticed.
    """
    error = max(stated_error(PRESETS["standard"], 30.0), stated_error(PRESETS["standard"], 50.0))
    assert error < 0.15
    difference = apart(
        *(rms_at_constant_length(PRESETS[n], seeds(k)) for n, k in (("standard", 16), ("reference", 12)))
    )
    assert abs(difference) <= -np.log(1.0 - error) + reach((0.12, 16), (0.133, 12))


def rms_of_insertion(fidelity, seeds):
    """From 33 to 36 m in an unseen tube."""
    scene = UNSEEN.model_copy(update={"carrier_length": 30.5})
    options = {"growing": True, "time_lapse": fidelity.time_lapse, "perturbation": 1e-7, "seeds": seeds}
    batch = SimulatorBatch([scene] * len(seeds), fidelity.method, fidelity.time_step, **options)
    batch.advance(None, None, 2.0 / fidelity.time_lapse)
    return batch.advance(None, None, 15.0 / fidelity.time_lapse).statistics["radial_rms_m"]


@pytest.mark.slow
@pytest.mark.processor
def test_the_stated_error_of_fast_holds_on_an_unseen_insertion(seeds):
    """4 % are stated (a member +- 21 and 6 %). With 32 against 8 chance is another 19 %: 23 % are noticed."""
    (error,) = {r.error for r in measured_errors() if r.fidelity == PRESETS["fast"] and r.output == "radial_rms_m"}
    assert error < 0.15
    difference = apart(*(rms_of_insertion(PRESETS[n], seeds(k)) for n, k in (("fast", 32), ("reference", 8))))
    assert abs(difference) <= -np.log(1.0 - error) + reach((0.21, 32), (0.062, 8))
