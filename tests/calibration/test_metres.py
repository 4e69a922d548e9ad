"""A log by metres: means over time, standstills and what follows them left out."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np
import pytest

from agents.plant.logs import Log
from agents.plant.response import metres_of


def log_of(feed: list[float], tension: list[float], noise: list[float]) -> Log:
    """A row a second from 5 m on."""
    fed = np.array(feed)
    length = 5.0 + np.concatenate([[0.0], np.cumsum(fed)[:-1]])
    measured = {"root_tension": np.array(tension), "rf_noise_rms": np.array(noise)}
    return Log(np.arange(float(len(feed))), length, fed, np.full(len(feed), 0.02), MappingProxyType(measured))


def test_means_over_time_and_squares() -> None:
    """Tension is averaged, an rms channel by its squares."""
    averaged = metres_of(log_of([0.25] * 8, [1, 2, 3, 4, 5, 5, 5, 5], [3e-5, 4e-5, 3e-5, 4e-5, 1e-5, 1e-5, 1e-5, 1e-5]))
    np.testing.assert_allclose(averaged.length, [5.5, 6.5])
    np.testing.assert_allclose(averaged.feed, 0.25)
    np.testing.assert_allclose(averaged.felt["root_tension"], [2.5, 5.0])
    np.testing.assert_allclose(averaged.felt["rf_noise_rms"], [np.sqrt(12.5) * 1e-5, 1e-5])


def test_a_standstill_and_its_restart_do_not_count() -> None:
    """Ten seconds of rest change nothing but the metre that they interrupt, of which half is left out."""
    moving = metres_of(log_of([0.25] * 16, [2.0] * 16, [1e-5] * 16))
    stood = metres_of(log_of([0.25] * 4 + [0.0] * 10 + [0.25] * 12, [2.0] * 4 + [9.0] * 13 + [2.0] * 9, [1e-5] * 26))
    np.testing.assert_allclose(moving.felt["root_tension"], 2.0)
    np.testing.assert_allclose(stood.felt["root_tension"], 2.0)
    assert len(moving) == 4
    np.testing.assert_allclose(stood.length, [5.5, 7.5, 8.5])  # of the second metre a quarter is left


def test_nothing_fed_is_no_metre() -> None:
    """A log of a standstill alone has none."""
    assert len(metres_of(log_of([0.0] * 5, [1.0] * 5, [1e-5] * 5))) == 0


@pytest.mark.parametrize("parts", [2, 5])
def test_how_finely_it_was_logged_does_not_matter(parts: int) -> None:
    """The same insertion in more rows gives the same metres, but for rows that cross a metre's end."""
    coarse = log_of([0.25] * 12, list(range(12)), [1e-5] * 12)
    time = np.arange(0.0, 12.0, 1.0 / parts)
    fine = Log(
        time, 5.0 + 0.25 * time, np.full(len(time), 0.25), np.full(len(time), 0.02),
        MappingProxyType({name: np.repeat(values, parts) for name, values in coarse.measured.items()}),
    )  # fmt: skip
    np.testing.assert_allclose(metres_of(fine).felt["root_tension"], metres_of(coarse).felt["root_tension"])
