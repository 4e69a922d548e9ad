"""A gain of the root tension: the best one is exact, found where the plant does not allow it, and not where it does."""

from __future__ import annotations

import numpy as np
import pytest

from agents.plant.inference import LIMIT, Case, GainLikelihood, Likelihood, gain_of
from agents.plant.prior import Prior, prior_of
from agents.plant.response import CHANNELS, Metres, Response, stored_response
from probe_env import Plant, Scene
from probe_env.arrays import FloatArray

LENGTH = np.arange(6.5, 50.0)
TRUTH = np.array([0.12, 9e4, 0.44, 7e-5])


@pytest.fixture(scope="module")
def response() -> Response:
    """The shipped one."""
    return stored_response()


@pytest.fixture(scope="module")
def prior() -> Prior:
    """Nothing said."""
    return prior_of(Plant())


def likelihood_of(response: Response, gain: float, channels: tuple[str, ...] = CHANNELS) -> Likelihood:
    """Of a log just as the response tells it at ``TRUTH``, its tension read with a gain; the scatter is that there."""
    scene = Scene.fitted({"tube": {"helix_diameter": 1.6}})
    feed, air = np.full(len(LENGTH), 0.2), np.full(len(LENGTH), 0.025)
    blank = Metres(LENGTH, feed, air, {name: np.ones(len(LENGTH)) for name in CHANNELS})
    felt = 10.0 ** response.tells(TRUTH[None], blank, scene)[0][0]
    felt[:, 0] *= gain
    measured = {name: felt[:, CHANNELS.index(name)] for name in channels}
    likelihood = Likelihood(response, [Case("log", 0, scene, Metres(LENGTH, feed, air, measured))])
    likelihood.settle(TRUTH[None, None])
    return likelihood


def test_the_best_gain_is_exact(response: Response, prior: Prior) -> None:
    """It is as likely as no gain of the same log with its tension divided by it, and likelier than any other."""
    normal = np.array([[0.3, -0.5, 0.2, 0.1]])
    log, best = GainLikelihood(likelihood_of(response, 1.3), 0, prior, True).logarithm(normal)
    by_hand = {
        k: GainLikelihood(likelihood_of(response, 1.3 / np.exp(best[0] + k)), 0, prior, False).logarithm(normal)[0][0]
        for k in (-0.02, 0.0, 0.02)
    }
    assert log[0] == pytest.approx(by_hand[0.0], rel=1e-9)
    assert by_hand[0.0] > max(by_hand[-0.02], by_hand[0.02])


def test_a_gauge_that_reads_too_much_is_found(response: Response, prior: Prior) -> None:
    """Half as much again is beyond the 15 % that drag may be, and the tension's bend holds the friction fast."""
    true, scaled = (gain_of(likelihood_of(response, gain), 0, prior) for gain in (1.0, 1.5))
    assert true is not None
    assert scaled is not None
    assert true.ratio < LIMIT < scaled.ratio
    assert scaled.gain > 1.5 / 1.15 / 1.15  # drag may be at either edge of what was held possible


def test_what_drag_may_be_is_no_gain(response: Response, prior: Prior) -> None:
    """A tenth more is within the 15 %: told by the bend alone, it is nobody's fault."""
    gain = gain_of(likelihood_of(response, 1.1), 0, prior)
    assert gain is not None
    assert gain.ratio < LIMIT


def test_without_a_tension_there_is_none(response: Response, prior: Prior) -> None:
    """Nothing to look at."""
    assert gain_of(likelihood_of(response, 1.0, CHANNELS[1:]), 0, prior) is None


def test_the_scatter_is_settled_as_a_geometric_mean(response: Response) -> None:
    """Of draws that are alike it is their own; of two, the root of their product."""
    likelihood = likelihood_of(response, 1.0)
    draws: FloatArray = np.array([TRUTH, TRUTH * [2.0, 1.0, 1.0, 1.0]])
    spread = likelihood.strays(0, draws)[1]
    likelihood.settle(draws[None, :1])
    np.testing.assert_allclose(likelihood.settled[0], spread[0])
    likelihood.settle(draws[None])
    np.testing.assert_allclose(likelihood.settled[0], np.sqrt(spread[0] * spread[1]))
