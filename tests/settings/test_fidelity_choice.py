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
    assert loose.cost < tight.cost
    for choice, most in ((loose, 0.3), (tight, tolerance)):
        assert choice.error <= most
        assert f"{choice.fidelity.time_step:g} s" in choice.reason
        assert "measured error of radial_rms_m at most" in choice.reason
        assert choice.fidelity.time_step <= choice.fidelity.method.stable_step(scene, choice.fidelity.nodes_per_pitch)
    cheaper = [r for r in measured_errors() if r.length == 30.0 and r.stiffness == 1e5 and r.output == "radial_rms_m"]
    assert all(r.error > tolerance for r in cheaper if r.cost < 0.99 * tight.cost)


def test_errors_of_superelements_and_meshes():
    """A default and its double by name; the converged mesh itself where nothing cheaper is near enough."""
    kinds = {(row.fidelity.method.name, row.fidelity.nodes_per_pitch) for row in measured_errors()}
    assert len(measured_errors()) > 200
    assert all(row.error >= 0.0 and row.cost > 0.0 for row in measured_errors())
    assert {("superelement32", 4), ("superelement", 4), ("imex32", 8), ("imex", 16)} <= kinds
    assert set(outputs()) >= {"radial_rms_m", "radial_p99_m", "lift_off_share", "axial_peak_hz"}
    assert choose_fidelity(Scene()).fidelity.method.name == "superelement32"
    probe = {"float_pitch": 0.15, "guide_length": 1.2}
    hard = Scene.model_validate({"contact": {"stiffness": 5e5}, "probe": probe, "carrier_length": 12.0})
    with pytest.raises(ValueError, match="asks for modes"):
        METHODS["superelement32"].stable_step(hard, 4)
    assert choose_fidelity(hard, 1.0).fidelity.method.name.startswith("imex")


def test_length_stiffness_and_outputs():
    for length, measured in ((10.0, (10.0,)), (45.0, (40.0, 50.0)), (50.0, (50.0,))):
        choice = choose_fidelity(Scene(carrier_length=length), 0.3)
        assert choice.error == max(stated_error(choice.fidelity, end) for end in measured)
    more = choose_fidelity(Scene(carrier_length=50.0), 0.3, ("radial_rms_m", "lift_off_share"))
    assert more.error >= choice.error - 1e-12
    soft, stiff = (Scene(carrier_length=30.0, contact={"stiffness": k}) for k in (1e4, 1e5))
    assert choose_fidelity(soft, 0.2).fidelity.time_step > choose_fidelity(stiff, 0.2).fidelity.time_step
    assert choose_fidelity(Scene(), 0.5).fidelity.time_lapse == 1.0
    assert choose_fidelity(Scene(), 0.5, growing=True).fidelity.time_lapse == MAX_TIME_LAPSE


def test_errors_of_the_choice():
    stiff = Scene(contact={"stiffness": 1e7})
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
    assert resolve_fidelity({"method": "imex", "time_step": 2e-5}).time_step == 2e-5


def test_environments_take_fidelities():
    env = gym.make("probe_env/Insertion-v1", fidelity="auto:0.5", config={"settle_time": 0.5})
    assert env.unwrapped.episodes.fidelity.time_lapse > 1.0
    env.reset(seed=0)
    assert np.isfinite(env.step(env.action_space.sample())[1])
    short = "time_step = 2e-05 s is below 5e-05 s, where the rounding of superelement32 shows"
    for wrong, message in (("auto:0.001", r"tolerance = 0\.001 is not met"), ({"time_step": 2e-5}, short)):
        with pytest.raises(ValueError, match=message):
            gym.make("probe_env/Snapshot-v1", fidelity=wrong)


# scenes that are in no ensemble of the chart
UNSEEN = Scene(carrier_length=40.0, tube={"helix_diameter": 1.4}, contact={"friction": 0.18, "stiffness": 1.3e5})


def radial_rms(fidelity, seeds, growing):
    """At a constant length, or from 33 to 36 m of insertion."""
    scene = UNSEEN.model_copy(update={"carrier_length": 30.5}) if growing else UNSEEN
    options = {"perturbation": 1e-7, "seeds": seeds, "growing": growing}
    options |= {"time_lapse": fidelity.time_lapse} if growing else {}
    batch = SimulatorBatch([scene] * len(seeds), fidelity.method, fidelity.time_step, **options)
    batch.advance(None, None, 2.0 / batch.simulators[0].time_lapse)
    duration = 15.0 / fidelity.time_lapse if growing else 5.0
    return batch.advance(None, None, duration).statistics["radial_rms_m"]


@pytest.mark.slow
@pytest.mark.processor
@pytest.mark.parametrize(
    ("name", "lengths", "growing", "samples"),
    [
        ("standard", (30.0, 50.0), False, ((0.12, 16), (0.133, 12))),
        ("fast", (None,), True, ((0.21, 32), (0.062, 8))),
    ],
)
def test_the_stated_error_holds_on_an_unseen_scene(name, lengths, growing, samples, seeds):
    """Between the chart's lengths, in another tube, with other friction and stiffness.

    Of standard 11 % are stated (a member +- 12 and 13 %). With 16 against 12 chance is another 21 %: a third is
    noticed. Of fast 4 % are stated (+- 21 and 6 %). With 32 against 8 chance is another 19 %: 23 % are noticed.
    """
    error = max(stated_error(PRESETS[name], length) for length in lengths)
    assert error < 0.15
    both = zip((name, "reference"), samples, strict=True)
    difference = apart(*(radial_rms(PRESETS[preset], seeds(count), growing) for preset, (_, count) in both))
    assert abs(difference) <= -np.log(1.0 - error) + reach(*samples)
