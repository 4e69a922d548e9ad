"""Theory of the methods on one mass, found on their own kernels."""

import math
from itertools import product

import pytest

from agents.studies.stability import amplification, bounce


def test_newmark_keeps_amplitude_and_lengthens_the_period():
    """A step turns a mode by 2 atan(omega dt / 2), on either spring."""
    for spring, omega_dt in product(("elastic", "contact"), (0.1, 0.9, 2.5)):
        radius, damping, period = amplification("newmark", spring, omega_dt)
        assert radius == pytest.approx(1.0, abs=1e-6)
        assert damping == pytest.approx(0.0, abs=1e-6)
        assert period == pytest.approx(omega_dt / (2.0 * math.atan(omega_dt / 2.0)) - 1.0, rel=1e-4, abs=1e-6)


def test_wilson_damps_as_the_books_say():
    """Theta 1.4 at omega dt = 0.9: 3.1 % of critical, an 11 % longer period (Bathe and Wilson 1973)."""
    for spring in ("elastic", "contact"):
        _, damping, period = amplification("wilson", spring, 0.9)
        assert damping == pytest.approx(0.031, abs=0.001)
        assert period == pytest.approx(0.11, abs=0.01)


@pytest.mark.parametrize(("method", "spring"), [("imex", "contact"), ("explicit", "contact"), ("explicit", "elastic")])
def test_explicit_springs_hold_up_to_two(method, spring):
    """z^2 - (2 - a^2) z + 1 = 0, a = omega dt: on the unit circle up to a = 2, then (a^2 - 2 + a sqrt(a^2 - 4)) / 2."""
    for a in (0.5, 1.9, 2.1, 3.0):
        radius, *_ = amplification(method, spring, a)
        expected = 1.0 if a < 2.0 else 0.5 * (a * a - 2.0 + a * math.sqrt(a * a - 4.0))
        assert radius == pytest.approx(expected, rel=1e-5)


def test_imex_and_implicit_take_an_elastic_spring_at_any_step():
    for omega_dt in (0.5, 3.0, 6.0):
        assert amplification("imex", "elastic", omega_dt)[0] <= 1.0 + 1e-9
        assert amplification("implicit", "elastic", omega_dt)[0] <= 1.0 + 1e-9
        assert amplification("implicit", "contact", omega_dt)[0] < 1.0


def test_the_iterated_flag_never_gains_the_lagged_one_does():
    """Sixty bounces between walls: implicit loses, Newmark's flag of the step before gains or loses by the step."""
    steps = (0.1, 0.3, 0.6, 0.9, 1.2, 1.5, 1.8)
    lagged = [bounce("newmark", omega_dt)[0] for omega_dt in steps]
    iterated = [bounce("implicit", omega_dt)[0] for omega_dt in steps]
    assert max(iterated) <= 1.0 + 1e-9
    assert max(lagged) > 1.05
    assert lagged[0] == pytest.approx(1.0, abs=0.01)
    assert iterated == sorted(iterated, reverse=True) or iterated[0] > 0.98


def test_a_broken_method_is_noticed():
    """Beyond its limit a contact spring throws the mass out of the tube: no restitution is claimed."""
    assert math.isnan(bounce("explicit", 2.5)[0])
