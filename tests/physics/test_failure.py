"""Errors: divergence, the stable step, arguments; results are never NaN."""

import pickle
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from probe_env import Scene, SimulationError, Simulator, StabilityWarning
from probe_env.physics.methods import METHODS
from probe_env.physics.methods.newmark import Newmark

SHORT = Scene(carrier_length=10.0)


@pytest.mark.parametrize(("method", "time_step"), [("newmark", 1e-3), ("wilson", 1e-3), ("newmark", 6.5e-4)])
def test_divergence_is_an_error_with_location_and_stable_step(method, time_step):
    with pytest.warns(StabilityWarning, match="beyond the known stable limit"):
        simulator = Simulator(SHORT, method, time_step)
    duration = round(2.0 / time_step) * time_step
    message = rf"{method}.*diverged at t = .*node \d+.*3e-04 s or less|0\.0003"
    with pytest.raises(SimulationError, match=message) as caught:
        simulator.run(duration, time_step)
    error = caught.value
    assert (error.method, error.time_step) == (method, time_step)
    assert 0.0 < error.time < duration
    assert 0 <= error.node < simulator.chain.node_count
    assert error.stable_time_step == simulator.stable_time_step < time_step
    with pytest.raises(SimulationError):
        simulator.advance(duration=time_step, sample_period=time_step)  # a diverged state is not continued
    copy = pickle.loads(pickle.dumps(error))
    assert str(copy) == str(error)
    assert copy.node == error.node


@pytest.mark.parametrize("method", ["imex", "imex32"])
def test_limit_of_the_shortening_holds_in_soft_contact(method):
    """Contact alone permits 0.95 ms at 1e4 N/m, which diverges within 0.22 s; at 0.25 ms no run diverged in 3 s."""
    study = Scene(carrier_length=10.0, contact={"stiffness": 1e4})
    step, contact = (METHODS[method].stable_step(scene, 4) for scene in (study.whole(), study))
    assert step < 3e-4 < contact
    Simulator(study.whole(), method, step).run(2400 * step, step)
    with pytest.warns(StabilityWarning), pytest.raises(SimulationError):
        Simulator(study.whole(), method, contact).run(600 * contact, contact)


def test_without_damping_or_a_measured_limit_no_stable_step_is_known():
    """Neither by its divergence: an explanation by buckling would need a limit that it keeps to."""

    class Unmeasured(Newmark):
        name = "unmeasured"

    with pytest.warns(StabilityWarning):
        assert Simulator(SHORT.model_copy(update={"probe": {"damping_time": 0.0}})).stable_time_step == 0.0
    assert METHODS["newmark"].stable_step(SHORT, 4) == pytest.approx(1.8 / np.sqrt(1e5 / (0.111 * 0.1 / 4)))
    assert Unmeasured().stable_step(SHORT, 4) == 0.0
    with pytest.warns(StabilityWarning, match="time_step = 0.001 s has no known limit with unmeasured for this scene"):
        simulator = Simulator(SHORT, Unmeasured(), 1e-3)
    with pytest.raises(SimulationError, match=r"no time step is known to be stable with unmeasured .* a shorter one"):
        simulator.run(2.0, 1e-3)


def test_bad_constructor_arguments():
    for arguments, message in (
        ({"method": "euler"}, "method = 'euler'"),
        ({"time_step": 0.0}, "time_step = 0.0"),
        ({"time_step": float("nan")}, "time_step = nan"),
        ({"time_step": -1e-4}, "time_step = -0.0001"),
        ({"nodes_per_pitch": 0}, "nodes_per_pitch = 0"),
        ({"nodes_per_pitch": 2.5}, "nodes_per_pitch = 2.5"),
        ({"perturbation": -1.0}, "perturbation = -1.0"),
        ({"start": "left"}, "start = 'left' is not one of inner, outer"),
    ):
        with pytest.raises(ValueError, match=message):
            Simulator(SHORT, **arguments)
    message = r"Simulator\(\) got an unexpected keyword argument 'grown'; accepted are growing"
    with pytest.raises(TypeError, match=message):
        Simulator(SHORT, grown=True)


def test_bad_run_arguments_are_errors_before_any_step():
    simulator = Simulator(SHORT)
    for arguments, message in (
        ({"duration": 0.00015}, "duration = 0.00015"),
        ({"duration": 0.0}, "duration = 0.0"),
        ({"duration": float("nan")}, "duration = nan"),
        ({"duration": 0.1, "sample_period": 2.5e-4}, "sample_period = 0.00025"),
        ({"duration": 0.1, "points": ("nose",)}, "'nose'"),
        ({"duration": 0.1, "points": (99.0,)}, "99.0 m"),
        ({"duration": 0.1, "snapshots": (0.2,)}, "snapshots: 0.2"),
        ({"duration": 0.1, "snapshots": (0.05, 0.02)}, "must ascend"),
    ):
        with pytest.raises(ValueError, match=message):
            simulator.run(**arguments)
        assert simulator.steps_done == 0
    with pytest.raises(ValueError, match="growing"):
        Simulator(SHORT, growing=True).run(0.1, snapshots=(0.05,))


PROBES = st.fixed_dictionaries(
    {
        "line_density": st.floats(0.02, 1.0),
        "tensile_rigidity": st.floats(1e3, 1e6),
        "flexural_rigidity": st.floats(1e-3, 1.0),
        "damping_time": st.floats(0.0, 1e-2),
        "carrier_float_diameter": st.floats(10e-3, 22e-3),
        "guide_length": st.integers(0, 5).map(lambda k: k / 10),
    }
)
CONTACTS = st.fixed_dictionaries(
    {
        "stiffness": st.floats(2.0, 8.0).map(lambda e: min(10.0**e, 1e8)),
        "friction": st.floats(0.0, 1.0),
        "walls": st.sampled_from(["both", "inner"]),
    }
)
SCENES = st.builds(
    Scene,
    tube=st.fixed_dictionaries({"helix_diameter": st.floats(0.4, 20.0)}),
    probe=PROBES,
    contact=CONTACTS,
    feed_speed=st.floats(0.0, 2.0),
    air_supply_rate=st.floats(0.0, 0.2),
    carrier_length=st.integers(10, 30).map(lambda k: k / 10),
)
"""Valid scenes far from table 2, 1 to 3 m long."""


@settings(max_examples=60, deadline=None)
@given(
    scene=SCENES,
    method=st.sampled_from(["newmark", "wilson", "imex", "imex32", "explicit", "implicit"]),
    time_step=st.sampled_from([1e-5, 1e-4, 1e-3]),
)
def test_no_valid_scene_gives_nan_without_an_error(scene, method, time_step):
    time_step = max(time_step, METHODS[method].min_step)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)
        simulator = Simulator(scene, method, time_step)
    try:
        run = simulator.run(0.05, 1e-3, points=("sensor", "tip", "root"))
    except SimulationError:
        return
    for array in (run.axial, run.radial, run.rotation, run.tension, run.mean_tension, *simulator.state):
        assert np.isfinite(array).all()
