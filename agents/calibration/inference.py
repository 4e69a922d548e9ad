"""The posterior of what is not known, from logs: response, scatter and prior together, sampled by emcee."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from tqdm import tqdm

from agents.calibration.metres import CHANNELS, Metres
from agents.calibration.response import FLOORS, Response, observed
from agents.calibration.unknowns import Prior
from probe_env import Scene
from probe_env.arrays import FloatArray

LEAST_METRES: Final = 8
SENSOR: Final = np.array([0.005, 0.05, 0.05, 0.05])
"""Least scatter of a metre's figures [decades]: the sensors' and what a small network leaves."""
GAUGES: Final = np.array([0.01, 0.0, 0.0, 0.0])
"""More of it [decades], but where a gain is looked for: a rough gauge makes no other world."""
UNREST: Final = np.array([0.0, 0.5, 0.5, 0.5])
"""Scatter of each channel that comes on top, as a share of ``FLOORS``: the unrest of feeding, so that a quiet metre is
told less well than one that rings."""
TENSION, VIBRATION = (0,), (1, 2, 3)
TRUST: Final = 0.7
"""Power of the likelihood (it and ``UNREST`` were found on 48 simulated logs at ``standard`` that serve nothing else):
what the network tells of a log is off alike over many metres."""
WALKERS: Final = 32
BURN, STEPS, KEPT = 300, 400, 512
SETTLED, FIRST, LEAST = 3, 2048, 256
"""Rounds in which the scatter of the vibration is settled, draws in each, and how many of them tell it."""


class Case(NamedTuple):
    """A log that is looked at.

    Attributes:
        name: of it.
        tube: number of the tube, which logs may share.
        scene: tube, probe and air it was recorded in.
        metres: of it.
    """

    name: str
    tube: int
    scene: Scene
    metres: Metres


@dataclass(frozen=True, eq=False)
class Posterior:
    """Draws of what is not known.

    Attributes:
        draws: (tubes, n, 4) in the order of ``UNKNOWNS``; all but the friction are the same for all tubes.
        misfit: of each case the mean square of the strays of every channel and of all (c + 1,), NaN where the log has
            no such channel; at the draw that fits it best.
        likelihood: that they were drawn by.
    """

    draws: FloatArray
    misfit: tuple[FloatArray, ...]
    likelihood: Likelihood


class Likelihood:
    """Of some cases under a response; what does not depend on the unknowns is worked out once."""

    def __init__(self, response: Response, cases: Sequence[Case]) -> None:
        self.response, self.cases = response, cases
        self.chosen = [[k for k, name in enumerate(CHANNELS) if name in case.metres.felt] for case in cases]
        self.seen = [observed(case.metres, chosen) for case, chosen in zip(cases, self.chosen, strict=True)]
        self.blocks = [
            {
                channels: (columns, np.linalg.cholesky(response.covariance(case.metres.length, part)))
                for channels in (TENSION, VIBRATION)
                if (part := [k for k in chosen if k in channels])
                for columns in [[chosen.index(k) for k in part]]
            }
            for case, chosen in zip(cases, self.chosen, strict=True)
        ]
        self.settled: list[FloatArray] = []

    def strays(self, number: int, table: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of a case at (n, 4): what it strays (n, m, c) in standard deviations, and those [decades]."""
        case, chosen = self.cases[number], self.chosen[number]
        mean, spread = self.response.tells(table, case.metres, case.scene)
        quiet = UNREST * np.minimum(FLOORS / 10.0**mean, 1.0)
        spread = np.hypot(np.hypot(spread, SENSOR), quiet)[..., chosen]
        return (self.seen[number] - mean[..., chosen]) / spread, spread

    def settle(self, draws: FloatArray) -> None:
        """Hold the scatter of every metre at its (geometric) mean over draws (tubes, n, 4).

        What the network tells of it serves as a weight. Were it free, unknowns for which little scatter is told would
        be held likely for that alone: logs stray less than the wandering insertions that it was learnt from.
        """
        self.settled = [
            np.exp(np.log(self.strays(number, draws[case.tube])[1]).mean(axis=0))
            for number, case in enumerate(self.cases)
        ]

    def logarithm(self, draws: FloatArray) -> FloatArray:
        """(n,) of the likelihood at draws (tubes, n, 4), up to a constant; the scatter is settled before."""
        total = np.zeros(draws.shape[1])
        for number, case in enumerate(self.cases):
            strays, spread = self.strays(number, draws[case.tube])
            total += sum(self.block(number, channels, strays, spread) for channels in self.blocks[number])
        return total

    def block(self, number: int, channels: tuple[int, ...], strays: FloatArray, spread: FloatArray) -> FloatArray:
        """(n,) what some channels of a case add to that, none where the log has none of them."""
        if channels not in self.blocks[number]:
            return np.zeros(len(strays))
        columns, factor = self.blocks[number][channels]
        held = channels == VIBRATION
        scatter = self.settled[number] if held else np.hypot(spread, GAUGES[self.chosen[number]])
        flat = (strays * spread / scatter)[..., columns].reshape(len(strays), -1)
        white = solve_triangular(factor, flat.T, lower=True, check_finite=False)
        density = -0.5 * (white**2).sum(axis=0)
        return np.asarray(TRUST * (density if held else density - np.log(scatter[..., columns]).sum(axis=(1, 2))))

    def misfit(self, number: int, table: FloatArray) -> FloatArray:
        """(c + 1,) of a case at (4,), see ``Response.misfit_of``."""
        strays, spread = (values[0] for values in self.strays(number, table[None]))
        strays = strays * spread / np.hypot(spread, GAUGES[self.chosen[number]])
        return self.response.misfit_of(strays, self.cases[number].metres.length, self.chosen[number])


def check_cases(cases: Sequence[Case]) -> None:
    """Raise ValueError if a log tells too little: too few metres, or no channel."""
    for case in cases:
        if not case.metres.felt:
            raise ValueError(f"{case.name}: measures none of {', '.join(CHANNELS)}, so it tells nothing")
        if len(case.metres) < LEAST_METRES:
            raise ValueError(f"{case.name}: {len(case.metres)} metres were fed, and at least {LEAST_METRES} are needed")


def sampled(
    response: Response, cases: Sequence[Case], prior: Prior, seed: int = 0, progress: bool = False
) -> Posterior:
    """Posterior of all tubes' frictions and of what they share.

    Args:
        response: what is felt.
        cases: the logs.
        prior: what is held possible.
        seed: of the walkers.
        progress: whether a bar is shown.

    Raises:
        ValueError: a log tells too little.
    """
    import emcee

    check_cases(cases)
    likelihood, tubes = Likelihood(response, cases), 1 + max(case.tube for case in cases)
    size = tubes + len(prior.shared)
    rng = np.random.default_rng([seed, size])

    def density(normal: FloatArray) -> FloatArray:
        return np.asarray(likelihood.logarithm(prior.values(normal, tubes)) - 0.5 * (normal**2).sum(axis=1))

    walkers = max(WALKERS, 4 * size)
    _settle(likelihood, prior, rng, tubes)
    start = _start(density, rng, walkers, size)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)]
        sampler = emcee.EnsembleSampler(walkers, size, density, moves=moves, vectorize=True)
    sampler.random_state = np.random.RandomState(int(rng.integers(2**31))).get_state()
    steps = sampler.sample(start, iterations=BURN + STEPS)
    for _ in tqdm(steps, total=BURN + STEPS, desc="posterior", unit="step", disable=not progress):
        pass
    chain, density_of = sampler.get_chain(discard=BURN, flat=True), sampler.get_log_prob(discard=BURN, flat=True)
    rows = np.linspace(0, len(chain) - 1, KEPT).round().astype(int)
    best = prior.values(chain[[int(np.argmax(density_of))]], tubes)[:, 0]
    misfit = tuple(likelihood.misfit(k, best[case.tube]) for k, case in enumerate(cases))
    return Posterior(prior.values(chain[rows], tubes), misfit, likelihood)


def _start(density: object, rng: np.random.Generator, walkers: int, size: int) -> FloatArray:
    """Walkers (w, d) drawn from the prior by their likelihood, tempered so that many are different."""
    drawn = rng.normal(size=(256 * walkers, size))
    logarithm = np.concatenate([density(part) for part in np.array_split(drawn, 256)])  # type: ignore[operator]
    return np.asarray(drawn[rng.choice(len(drawn), walkers, replace=False, p=_shares(logarithm, walkers))])


def _settle(likelihood: Likelihood, prior: Prior, rng: np.random.Generator, tubes: int) -> None:
    """Settle the scatter where draws from the prior are likely, beginning with all of them."""
    drawn = prior.values(rng.normal(size=(FIRST, tubes + len(prior.shared))), tubes)
    chosen = np.arange(LEAST)
    for _ in range(SETTLED):
        likelihood.settle(drawn[:, chosen])
        parts = np.array_split(drawn, FIRST // 32, axis=1)
        logarithm = np.concatenate([likelihood.logarithm(part) for part in parts])
        chosen = rng.choice(FIRST, LEAST, p=_shares(logarithm, WALKERS))
    likelihood.settle(drawn[:, chosen])


def _shares(logarithm: FloatArray, least: int) -> FloatArray:
    """Weights by a likelihood, tempered so that as many draws as ``least`` count."""
    cold = 1.0
    for _ in range(20):
        weights = np.exp(cold * (logarithm - logarithm.max()))
        if weights.sum() ** 2 / (weights**2).sum() >= least:
            break
        cold *= 0.5
    return np.asarray(weights / weights.sum())
