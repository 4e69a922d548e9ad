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
from agents.calibration.response import Response, observed
from agents.calibration.unknowns import Prior
from probe_env import Scene
from probe_env.arrays import FloatArray

LEAST_METRES: Final = 8
SENSOR: Final = np.array([0.01, 0.05, 0.05, 0.05])
"""Least scatter of a metre's figures [decades]: the sensors' and what a small network leaves."""
TRUSTED: Final = (((0,), 0.7), ((1, 2, 3), 0.06))
"""Channels and the power of their likelihood: the tension has a closed form; what the network tells of vibration is off
by much the same over a whole log, so its metres count for less (found on 16 simulated logs that serve nothing else)."""
WALKERS: Final = 32
BURN, STEPS, KEPT = 300, 400, 512


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
    """

    draws: FloatArray
    misfit: tuple[FloatArray, ...]


class Likelihood:
    """Of some cases under a response; what does not depend on the unknowns is worked out once."""

    def __init__(self, response: Response, cases: Sequence[Case]) -> None:
        self.response, self.cases = response, cases
        self.chosen = [[k for k, name in enumerate(CHANNELS) if name in case.metres.felt] for case in cases]
        self.seen = [observed(case.metres, chosen) for case, chosen in zip(cases, self.chosen, strict=True)]
        self.blocks = [
            [
                (columns, trust, np.linalg.cholesky(response.covariance(case.metres.length, part)))
                for channels, trust in TRUSTED
                if (part := [k for k in chosen if k in channels])
                for columns in [[chosen.index(k) for k in part]]
            ]
            for case, chosen in zip(cases, self.chosen, strict=True)
        ]

    def strays(self, number: int, table: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of a case at (n, 4): what it strays (n, m, c) in standard deviations, and those [decades]."""
        case, chosen = self.cases[number], self.chosen[number]
        mean, spread = self.response.tells(table, case.metres, case.scene)
        spread = np.hypot(spread, SENSOR)[..., chosen]
        return (self.seen[number] - mean[..., chosen]) / spread, spread

    def logarithm(self, draws: FloatArray) -> FloatArray:
        """(n,) of the likelihood at draws (tubes, n, 4), up to a constant."""
        total = np.zeros(draws.shape[1])
        for number, case in enumerate(self.cases):
            strays, spread = self.strays(number, draws[case.tube])
            for columns, trust, factor in self.blocks[number]:
                flat = strays[..., columns].reshape(len(strays), -1)
                white = solve_triangular(factor, flat.T, lower=True, check_finite=False)
                density = -0.5 * (white**2).sum(axis=0) - np.log(spread[..., columns]).sum(axis=(1, 2))
                total += trust * density
        return total

    def misfit(self, number: int, table: FloatArray) -> FloatArray:
        """(c + 1,) of a case at (4,), see ``Response.misfit_of``."""
        strays = self.strays(number, table[None])[0][0]
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
    return Posterior(prior.values(chain[rows], tubes), misfit)


def _start(density: object, rng: np.random.Generator, walkers: int, size: int) -> FloatArray:
    """Walkers (w, d) drawn from the prior by their likelihood, tempered so that many are different."""
    drawn = rng.normal(size=(256 * walkers, size))
    logarithm = np.concatenate([density(part) for part in np.array_split(drawn, 256)])  # type: ignore[operator]
    cold = 1.0
    for _ in range(20):
        weights = np.exp(cold * (logarithm - logarithm.max()))
        if weights.sum() ** 2 / (weights**2).sum() >= walkers:
            break
        cold *= 0.5
    chosen = rng.choice(len(drawn), walkers, replace=False, p=weights / weights.sum())
    return np.asarray(drawn[chosen])
