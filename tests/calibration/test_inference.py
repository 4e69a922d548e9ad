"""Posteriors of logs that the response itself has made: ranks, sharing, and what is told of another world."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import Seeds
from oracles.scatter import CHANCE, of_another
from scipy.stats import chi2, norm

from agents.plant import inference
from agents.plant.inference import Case, Likelihood, sampled
from agents.plant.prior import Prior, prior_of
from agents.plant.response import CHANNELS, Metres, Response, observed, stored_response
from probe_env import Plant, Scene
from probe_env.arrays import FloatArray

LENGTH = np.arange(6.5, 50.0)


@pytest.fixture(scope="module")
def response() -> Response:
    """The shipped one."""
    return stored_response()


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few steps: enough for a mean and an interval."""
    monkeypatch.setattr(inference, "BURN", 200)
    monkeypatch.setattr(inference, "STEPS", 200)


def drawn_log(
    response: Response,
    truth: FloatArray,
    rng: np.random.Generator,
    diameter: float = 1.3,
    tube: int = 0,
    length: FloatArray = LENGTH,
) -> Case:
    """A log drawn from the response at a truth (4,)."""
    scene = Scene.fitted({"tube": {"helix_diameter": diameter}})
    feed = np.interp(length, [5.0, 20.0, 50.0], [0.3, 0.2, 0.1])
    air = np.interp(length, [5.0, 30.0, 50.0], [0.018, 0.025, 0.03])
    blank = Metres(length, feed, air, {name: np.ones(len(length)) for name in CHANNELS})
    mean, spread = response.tells(truth[None], blank, scene)
    factor = np.linalg.cholesky(response.covariance(length, list(range(len(CHANNELS)))))
    strays = (factor @ rng.normal(size=len(factor))).reshape(len(length), -1)
    felt = 10.0 ** (mean[0] + spread[0] * strays)
    return Case("log", tube, scene, Metres(length, feed, air, {n: felt[:, k] for k, n in enumerate(CHANNELS)}))


def truths(prior: Prior, count: int, seed: int) -> FloatArray:
    """(count, 4) drawn from the prior."""
    return prior.values(np.random.default_rng(seed).normal(size=(count, 1 + len(prior.shared))), 1)[0]


@pytest.mark.processor
def test_truths_are_where_the_posterior_says(response: Response, short: None, seeds: Seeds) -> None:
    """Ten logs of the response's own making, of truths from the prior: the rank of each among its draws is uniform.

    So are the ranks of one unknown over logs, which have nothing in common, but not those of four in one log: each
    unknown has bounds of its own, eight in all. As normal scores the ranks have a mean of 0 and a square of 1. Every
    other metre of a log is enough.
    """
    prior, logs = prior_of(Plant()), 10
    ranks = np.empty((logs, 4))
    for k, (truth, seed) in enumerate(zip(truths(prior, logs, seeds(1)[0]), seeds(logs), strict=True)):
        case = drawn_log(response, truth, np.random.default_rng([4, seed]), length=LENGTH[::2])
        draws = sampled(response, [case], prior, seed=seed).draws[0]
        ranks[k] = ((draws < truth).sum(axis=0) + 0.5) / (len(draws) + 1)
    scores = norm.ppf(ranks)
    assert (np.abs(scores.mean(axis=0)) < norm.isf(CHANCE / 16) / np.sqrt(logs)).all()
    low, high = chi2.ppf([CHANCE / 16, 1.0 - CHANCE / 16], logs)
    squares = (scores**2).sum(axis=0)
    assert ((low < squares) & (squares < high)).all()


@pytest.mark.processor
def test_logs_of_one_tube_share_its_friction(response: Response, short: None, seeds: Seeds) -> None:
    """Three logs tell a friction more closely than one; of two tubes each has its own, and stiffness is shared.

    Every other metre is enough for the first.
    """
    prior, truth = prior_of(Plant()), np.array([0.18, 9e4, 0.44, 6e-5])
    ratios, worlds = [], 4
    for seed in seeds(worlds):
        rng = np.random.default_rng([2, seed])
        logs = [drawn_log(response, truth, rng, length=LENGTH[::2]) for _ in range(3)]
        one, three = (sampled(response, logs[:n], prior, seed).draws[0, :, 0].std() for n in (1, 3))
        ratios.append(np.log(three / one))
    # exp(-0.274), for drag, which acts alike, is known no better; scatters by 0.069 over 16 worlds
    assert np.mean(ratios) < -0.274 + of_another(0.069, 16, members=worlds) < 0.0
    others = [drawn_log(response, np.array([own, 9e4, 0.44, 6e-5]), rng, tube=k) for k, own in enumerate((0.18, 0.12))]
    draws = sampled(response, others, prior).draws
    assert draws.shape[0] == 2
    np.testing.assert_array_equal(draws[0, :, 1:], draws[1, :, 1:])
    # 0.183 +- 0.0051 and 0.122 +- 0.0032 over 16 worlds
    assert np.median(draws[0, :, 0]) > 0.183 - of_another(0.0051, 16, among=2) > 0.15
    assert np.median(draws[1, :, 0]) < 0.122 + of_another(0.0032, 16, among=2) < 0.15


def test_the_same_logs_give_the_same_draws(response: Response, short: None) -> None:
    """By the seed."""
    case = drawn_log(response, np.array([0.2, 1e5, 0.44, 5e-5]), np.random.default_rng(0), length=LENGTH[::4])
    first, second = (sampled(response, [case], prior_of(Plant())).draws for _ in range(2))
    np.testing.assert_array_equal(first, second)


@pytest.mark.processor
def test_misfit_is_small_for_its_own_logs_and_large_for_random_numbers(response: Response, seeds: Seeds) -> None:
    """The mean square of its own strays is 1 within its scatter; numbers that follow nothing are far beyond."""
    truth, rng = np.array([0.2, 1e5, 0.44, 6e-5]), np.random.default_rng(seeds(1)[0])
    case = drawn_log(response, truth, rng)
    own = Likelihood(response, [case]).misfit(0, truth)
    # mean squares of 44 numbers each; the sensors' scatter, which was not drawn, makes them smaller
    assert (own[:4] < chi2.isf(CHANCE / 4, len(LENGTH)) / len(LENGTH)).all()
    felt = {name: values * np.exp(rng.normal(size=len(values))) for name, values in case.metres.felt.items()}
    noisy = case._replace(metres=Metres(case.metres.length, case.metres.feed, case.metres.air, felt))
    assert (Likelihood(response, [noisy]).misfit(0, truth) > response.misfit).any()


def test_too_short_or_silent_a_log_is_refused(response: Response) -> None:
    """Before anything is sampled, by its name."""
    case = drawn_log(response, np.array([0.2, 1e5, 0.44, 6e-5]), np.random.default_rng(1))
    few = drawn_log(response, np.array([0.2, 1e5, 0.44, 6e-5]), np.random.default_rng(1), length=LENGTH[:5])
    with pytest.raises(ValueError, match="log: 5 metres were fed, and at least 8"):
        sampled(response, [few], prior_of(Plant()))
    m = case.metres
    with pytest.raises(ValueError, match="log: measures none of root_tension"):
        sampled(response, [case._replace(metres=Metres(m.length, m.feed, m.air, {}))], prior_of(Plant()))


def test_a_missing_channel_is_left_out(response: Response) -> None:
    """The likelihood of some channels is that of the others integrated out: their block of the covariance."""
    case = drawn_log(response, np.array([0.2, 1e5, 0.44, 6e-5]), np.random.default_rng(1))
    m = case.metres
    part = case._replace(metres=Metres(m.length, m.feed, m.air, {n: m.felt[n] for n in CHANNELS[1:]}))
    assert Likelihood(response, [part]).chosen == [[1, 2, 3]]
    np.testing.assert_array_equal(observed(part.metres, [1, 2, 3]), observed(m, [0, 1, 2, 3])[:, 1:])
    whole = response.covariance(LENGTH, [0, 1, 2, 3]).reshape(len(LENGTH), 4, len(LENGTH), 4)
    block = response.covariance(LENGTH, [1, 2, 3]).reshape(len(LENGTH), 3, len(LENGTH), 3)
    np.testing.assert_allclose(whole[:, 1:, :, 1:], block)
