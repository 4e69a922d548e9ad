"""Damping of the contact, and friction that depends on the sliding speed."""

import math

import numpy as np
import pytest

from probe_env import Scene, Simulator
from probe_env.physics.closed_forms import steady_root_tension
from probe_env.physics.closed_forms.bare_chains import DrivenChain, run_chain, uniform_chain
from probe_env.physics.methods import METHODS
from probe_env.physics.model.state import at_rest

DAMPED = [name for name, method in METHODS.items() if method.simulates_damping]
K = 1e5


@pytest.mark.parametrize("gap", [math.inf, -3e-3])
@pytest.mark.parametrize("ratio", [0.05, 0.3])
def test_restitution_of_a_damped_contact(ratio, gap):
    """A mass on a dashpot and spring that never pull (Schwager and Poeschel 2007), on the inner or the outer wall.

    It leaves at omega t = pi - atan(2 b w / (w^2 - b^2)) with b = z omega, w^2 = omega^2 - b^2, at exp(-b t) of its
    speed. The force is of order one in the time step: the error is below omega dt.
    """
    none = dict.fromkeys(("axial_compliance", "shear_compliance", "bending_compliance"), 1e9)
    walls = {"contact_stiffness": np.array([K, 0.0]), "outer_gap": np.array([abs(gap), np.inf])}
    chain = uniform_chain(1, damping_time=0.0, coupling_compliance=0.0, **none, **walls)
    omega = math.sqrt(K / chain.mass)
    chain = chain._replace(contact_damping=2.0 * ratio * math.sqrt(K * chain.mass))
    b, w = ratio * omega, omega * math.sqrt(1.0 - ratio**2)
    restitution = math.exp(-b / w * (math.pi - math.atan2(2.0 * b * w, w * w - b * b)))
    state, time_step, speed = at_rest(2), 1e-6, math.copysign(0.1, gap)
    state.d[0, 1], state.v[0, 1] = (1e-5, -0.1) if gap > 0.0 else (-gap - 1e-5, 0.1)
    run_chain("imex", DrivenChain(chain), time_step, state, 1500, 1500)
    assert state.v[0, 1] == pytest.approx(speed * restitution, rel=omega * time_step)


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("method", ["imex", "superelement32"])
def test_sliding_friction_is_that_of_the_speed(method, whole):
    """At 0.4 m/s and a slope of 0.2 s/m friction is 0.12 instead of 0.08; the contact's damping does no work."""
    tensions = []
    for slope in (0.0, 0.2):
        contact = {"friction": 0.08, "friction_slope": slope, "damping": 5.0}
        scene = Scene(carrier_length=9.5, probe={"guide_length": 0.5}, feed_speed=0.4, contact=contact)
        scene = scene.whole() if whole else scene
        run = Simulator(scene, method, 1e-4).run(1.5, points=("root",))
        tensions.append(run.tension[run.time > 0.5, 0].mean())
        assert tensions[-1] == pytest.approx(steady_root_tension(scene), rel=1e-2)  # floats are discrete
    assert tensions[1] < 0.8 * tensions[0]
    assert scene.contact.friction_at(-0.4) == pytest.approx(0.12)
    assert scene.model_copy(update={"contact": {"friction_slope": -0.5}}).contact.friction_at(1.0) == 0.0


@pytest.mark.parametrize("method", DAMPED)
def test_stable_step_with_a_damped_contact(method):
    """A lagging dashpot: (omega dt)^2 + 4 z omega dt < 4, with the margin of the undamped limit omega dt = 1.8."""
    kind, scene = METHODS[method], Scene(carrier_length=5.0)
    plain = kind.stable_step(scene, 4)
    fraction = kind.stable_step(scene.model_copy(update={"contact": {"damping": 7.5}}), 4) / plain
    ratio = 7.5 * (1.8 / plain) / (2.0 * K)
    assert fraction**2 + 2.0 * ratio * fraction == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("field", ["damping", "friction_slope"])
def test_methods_without_damping_refuse_it(field):
    with pytest.raises(
        ValueError, match=rf"^contact.{field} = 0.1: newmark does not simulate it; use imex, imex32, sup"
    ):
        Simulator(Scene(contact={field: 0.1}))
