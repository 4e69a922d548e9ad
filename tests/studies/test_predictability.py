"""Predictability: growth rates of maps with closed forms, decay of a damped chain, and the stored table."""

import math

import numpy as np
import pytest

from probe_agents.studies.predictability import FRICTIONS, Setting, growth
from probe_env.physics.closed_forms.bare_chains import AXIAL, DrivenChain, run_chain, uniform_chain
from probe_env.physics.model.state import at_rest

TINY = 1e-9


def separations_of(step, first, second, distance, count):
    """(count, m) distances of the orbits of two starts."""
    rows = []
    for _ in range(count):
        first, second = step(first), step(second)
        rows.append(distance(second - first))
    return np.array(rows)


def test_growth_rate_of_the_cat_map():
    start = np.random.default_rng(0).uniform(size=(2, 8))
    matrix = np.array([[2.0, 1.0], [1.0, 1.0]])
    near = start + np.array([[TINY], [0.0]])
    values = separations_of(lambda x: matrix @ x % 1.0, start, near, lambda d: np.hypot(*(d - np.round(d))), count=40)
    row = growth(0.5 * np.arange(1, 41), values, 0.4, TINY)  # two steps a second
    rate = 2.0 * math.log((3.0 + math.sqrt(5.0)) / 2.0)
    # relative rounding 1e-16 / 1e-8 at the start of the window; the other eigenvalue's part is 2e-6 there
    assert row["result"] == "grows"
    assert row["rate_per_s"] == pytest.approx(rate, rel=1e-5)
    assert [row["doubling_s"], row["doubling_s:low"]] == pytest.approx([math.log(2.0) / rate] * 2, rel=1e-5)
    assert row["r2"] == pytest.approx(1.0, abs=1e-6)
    # 0.85 of the perturbation is along the growing eigenvector: steps until it is a tenth of 0.4
    steps = math.ceil(math.log(0.04 / (0.85 * TINY)) / (0.5 * rate))
    assert row["separated_after_s"] == pytest.approx(0.5 * steps)
    assert row["separated"] == 8


def test_the_interval_holds_the_exponent_of_the_logistic_map():
    """ln 2 a step, with steps that scatter by pi / sqrt(12): 0.9."""
    start = np.random.default_rng(1).uniform(0.1, 0.9, size=200)
    values = separations_of(lambda x: 4.0 * x * (1.0 - x), start, start + TINY, np.abs, count=80)
    row = growth(np.arange(1.0, 81.0), values, 0.5, TINY)
    assert row["result"] == "grows"
    assert row["rate_per_s:low"] < math.log(2.0) < row["rate_per_s:high"]
    assert row["rate_per_s:high"] - row["rate_per_s:low"] < 0.1 * math.log(2.0)
    assert row["doubling_s:low"] == pytest.approx(math.log(2.0) / row["rate_per_s:high"])
    assert 0.9 < row["r2"] < 0.99


@pytest.mark.parametrize(("damping_time", "result"), [(1e-3, "decays"), (0.0, "irregular")])
def test_a_damped_chain_decays(damping_time, result):
    """A mass on an elastic element: amplitude exp(-omega^2 tau t / 2); without damping neither growth nor decay."""
    stiffness, time_step, steps = 1e3, 1e-5, 5000
    chain = uniform_chain(1, axial_compliance=1.0 / stiffness, damping_time=damping_time, coupling_compliance=0.0)
    omega = math.sqrt(stiffness / chain.mass)
    twins = []
    for offset in (0.0, TINY):
        state = at_rest(2)
        state.d[0, AXIAL] = 1e-6 + offset
        state.memory[0, AXIAL] = -(omega**2) * state.d[0, AXIAL]  # acceleration
        twins.append(run_chain("newmark", DrivenChain(chain), time_step, state, steps, 1).samples[:, AXIAL])
    times = time_step * np.arange(1, steps + 1)
    row = growth(times, np.abs(twins[1] - twins[0])[:, None], 1e-7, TINY)
    assert row["result"] == result
    assert row["separated"] == 0
    assert math.isnan(row["doubling_s"])


def test_a_burst_has_no_doubling_time():
    """Jumps from below the window and from within it, and two pairs of which one does not separate."""
    times = np.arange(1.0, 101.0)
    for before in (1.0, 15.0):
        values = TINY * np.where(times < 50, before, 1e6)
        row = growth(times, values[:, None], 1e-3, TINY)
        assert (row["result"], row["separated"], row["separated_after_s"]) == ("irregular", 1, 50.0)
        assert math.isnan(row["doubling_s"])
    rising = TINY * np.exp(0.2 * times)
    row = growth(times, np.column_stack([rising, np.full(100, TINY)]), 1e-3, TINY)
    assert (row["result"], row["separated"]) == ("irregular", 1)
    assert growth(times, rising[:, None], 1e-3, TINY)["rate_per_s"] == pytest.approx(0.2)


def test_a_short_probe_of_low_friction_forgets_its_perturbation():
    (row,) = Setting(10.0, FRICTIONS[0], members=2).rows()
    assert (row["result"], row["separated"], row["inserted_length_m"]) == ("decays", 0, 10.0)
