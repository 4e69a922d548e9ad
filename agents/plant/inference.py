"""Estimates of the unknowns from logs: the posterior by emcee, gauge errors, and friction from the tension alone."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares, minimize
from tqdm import tqdm

from agents.plant.prior import UNKNOWNS, Prior
from agents.plant.response import CHANNELS, DRAG, FLOORS, Metres, Response, observed, steady_tension
from probe_env import Scene
from probe_env.arrays import FloatArray

LEAST_METRES: Final = 8
SENSOR: Final = np.array([0.005, 0.05, 0.05, 0.05])
"""Smallest scatter of a metre's measurements [decades]: the sensors' and the error of a small network."""
GAUGES: Final = np.array([0.01, 0.0, 0.0, 0.0])
"""Additional scatter [decades], except where a gain is looked for: a rough gauge is no misspecification."""
UNREST: Final = np.array([0.0, 0.5, 0.5, 0.5])
"""Additional scatter of each channel as a share of ``FLOORS``: the unrest of feeding, so that quiet metres weigh less
than those that ring."""
TENSION, VIBRATION = (0,), (1, 2, 3)
TRUST: Final = 0.7
"""Power of the likelihood: the network's error in a log is correlated over many metres. It and ``UNREST`` were found on
48 simulated logs at ``standard`` that serve nothing else."""
WALKERS: Final = 32
BURN, STEPS, KEPT = 300, 400, 512
SETTLED, FIRST, LEAST = 3, 2048, 256
"""Rounds in which the scatter of the vibration is settled, draws in each, and how many of them are used."""

BOX: Final = 2.33
"""Gains: bound of the standard normal coordinates (98 % of the prior), within which all are held equally possible."""
MOST: Final = 1.5
"""Largest logarithm of a gain."""
ALIKE: Final = 15.0, 0.8
"""Correlation of the tension's deviations in gains: length [m], and the share of each metre alone. The likelihood of 32
logs at ``standard`` is largest at 15 m and 0.4; the rest is left to gauges."""
LIMIT: Final = 4.5
"""Of twice the logarithm of the likelihood ratio: one in thirty by Wilks, and none of the 32 logs that ``ALIKE`` was
found on (largest: 4.3); of these with 1.5 times the tension all but two exceeded it. Measured before the tension block
of the posterior got its present form, which moves the settled scatter a little."""
DRAWN, STARTS, STEP = 2048, 4, 1e-4

SLIDING_TRUST: Final = 0.02
"""Relative standard deviation of the simulated mean tension from the closed form, over a whole log."""
Z90: Final = 1.645


class Case(NamedTuple):
    """A log to fit: its name, that of its tube (logs of one tube share a friction), scene and metres."""

    name: str
    tube: str
    scene: Scene
    metres: Metres


class Posterior(NamedTuple):
    """Draws (tubes, n, 4) in the order of ``UNKNOWNS``; all but the friction are the same for all tubes.

    ``misfit`` is each case's ``Likelihood.misfit`` at the draw that fits best.
    """

    draws: FloatArray
    misfit: list[FloatArray]
    likelihood: Likelihood


class Likelihood:
    """Likelihood of some cases under a response; ``tube_indices`` are each case's in ``tubes``, the names."""

    def __init__(self, response: Response, cases: Sequence[Case]) -> None:
        self.response, self.cases = response, cases
        self.tubes = tuple(dict.fromkeys(case.tube for case in cases))
        self.tube_indices = [self.tubes.index(case.tube) for case in cases]
        self.chosen = [[k for k, name in enumerate(CHANNELS) if name in case.metres.felt] for case in cases]
        self.observed = [observed(case.metres, chosen) for case, chosen in zip(cases, self.chosen, strict=True)]
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
        """Deviations (n, m, c) of a case at (n, 4) in standard deviations, and those [decades]."""
        case, chosen = self.cases[number], self.chosen[number]
        mean, spread = self.response.predict(table, case.metres, case.scene)
        quiet = UNREST * np.minimum(FLOORS / 10.0**mean, 1.0)
        spread = np.hypot(np.hypot(spread, SENSOR), quiet)[..., chosen]
        return (self.observed[number] - mean[..., chosen]) / spread, spread

    def settle(self, draws: FloatArray) -> None:
        """Fix the scatter of every metre at its geometric mean over draws (tubes, n, 4).

        The predicted scatter is then only a weight. If it were free, unknowns with little scatter would be likely for
        that alone: logs deviate less than the wandering insertions of the training.
        """
        self.settled = [
            np.exp(np.log(self.strays(number, draws[tube])[1]).mean(axis=0))
            for number, tube in enumerate(self.tube_indices)
        ]

    def logarithm(self, draws: FloatArray) -> FloatArray:
        """(n,) logarithm of the likelihood at draws (tubes, n, 4), up to a constant; call ``settle`` before."""
        total = np.zeros(draws.shape[1])
        for number, tube in enumerate(self.tube_indices):
            strays, spread = self.strays(number, draws[tube])
            total += sum(self.block(number, channels, strays, spread) for channels in self.blocks[number])
        return total

    def block(self, number: int, channels: tuple[int, ...], strays: FloatArray, spread: FloatArray) -> FloatArray:
        """(n,) contribution of some channels of a case; 0 where the log has none of them."""
        if channels not in self.blocks[number]:
            return np.zeros(len(strays))
        columns, factor = self.blocks[number][channels]
        fixed = channels == VIBRATION
        scatter = self.settled[number] if fixed else np.hypot(spread, GAUGES[self.chosen[number]])
        flat = (strays * spread / scatter)[..., columns].reshape(len(strays), -1)
        white = solve_triangular(factor, flat.T, lower=True, check_finite=False)
        density = -0.5 * (white**2).sum(axis=0)
        return np.asarray(TRUST * (density if fixed else density - np.log(scatter[..., columns]).sum(axis=(1, 2))))

    def misfit(self, number: int, table: FloatArray) -> FloatArray:
        """(c + 1,) of a case at (4,), see ``Response.misfit_of``."""
        strays, spread = (values[0] for values in self.strays(number, table[None]))
        strays = strays * spread / np.hypot(spread, GAUGES[self.chosen[number]])
        return self.response.misfit_of(strays, self.cases[number].metres.length, self.chosen[number])


def sampled(
    response: Response, cases: Sequence[Case], prior: Prior, seed: int = 0, progress: bool = False
) -> Posterior:
    """Posterior of the frictions of all tubes and of the unknowns that they share; ``seed`` is that of the walkers.

    Raises:
        ValueError: a log has too few metres, or no channel.
    """
    import emcee

    for case in cases:
        if not case.metres.felt:
            raise ValueError(f"{case.name}: measures none of {', '.join(CHANNELS)}, so it tells nothing")
        if len(case.metres) < LEAST_METRES:
            raise ValueError(f"{case.name}: {len(case.metres)} metres were fed, and at least {LEAST_METRES} are needed")
    likelihood = Likelihood(response, cases)
    size = (tubes := len(likelihood.tubes)) + len(prior.shared)
    rng = np.random.default_rng([seed, size])

    def density(normal: FloatArray) -> FloatArray:
        return np.asarray(likelihood.logarithm(prior.values(normal, tubes)) - 0.5 * (normal**2).sum(axis=1))

    walkers = max(WALKERS, 4 * size)
    # the scatter is settled where draws from the prior are likely, beginning with all of them
    drawn, chosen = prior.values(rng.normal(size=(FIRST, size)), tubes), np.arange(LEAST)
    for _ in range(SETTLED):
        likelihood.settle(drawn[:, chosen])
        logarithm = np.concatenate([likelihood.logarithm(p) for p in np.array_split(drawn, FIRST // 32, axis=1)])
        chosen = rng.choice(FIRST, LEAST, p=_shares(logarithm, WALKERS))
    likelihood.settle(drawn[:, chosen])
    normal = rng.normal(size=(256 * walkers, size))
    logarithm = np.concatenate([density(part) for part in np.array_split(normal, 256)])
    start = normal[rng.choice(len(normal), walkers, replace=False, p=_shares(logarithm, walkers))]
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
    misfit = [likelihood.misfit(k, best[tube]) for k, tube in enumerate(likelihood.tube_indices)]
    return Posterior(prior.values(chain[rows], tubes), misfit, likelihood)


def _shares(logarithm: FloatArray, least: int) -> FloatArray:
    """Weights by a likelihood, tempered so that the effective number of draws is at least ``least``."""
    cold = 1.0
    for _ in range(20):
        weights = np.exp(cold * (logarithm - logarithm.max()))
        if weights.sum() ** 2 / (weights**2).sum() >= least:
            break
        cold *= 0.5
    return np.asarray(weights / weights.sum())


class Gain(NamedTuple):
    """Gain (reading over true value) of a tension gauge; twice the log of its likelihood ratio to no gain."""

    ratio: float
    gain: float


def gain_of(likelihood: Likelihood, number: int, prior: Prior) -> Gain | None:
    """Best gain of one log's tension gauge, with its unknowns free within the prior; None without a tension.

    The level of the tension gives only friction and pull of the air together. Its initial bend gives the friction
    whatever the gain is, and so, through the vibration, do the accelerations. A gain is what is left over.
    """
    if TENSION not in likelihood.blocks[number]:
        return None
    drawn = np.random.default_rng(0).normal(size=(DRAWN, 1 + len(prior.shared))).clip(-BOX, BOX)
    best = []
    for free in (False, True):
        objective = GainLikelihood(likelihood, number, prior, free)
        order = np.argsort(np.concatenate([objective.logarithm(p)[0] for p in np.array_split(drawn, DRAWN // 32)]))
        results = [
            minimize(objective, drawn[k], jac=True, method="L-BFGS-B", bounds=[(-BOX, BOX)] * drawn.shape[1])
            for k in order[::-1][:STARTS]
        ]
        best.append(min(results, key=lambda result: result.fun))
    without, with_gain = best
    gain = float(np.exp(objective.logarithm(with_gain.x[None])[1][0]))
    return Gain(max(2.0 * float(without.fun - with_gain.fun), 0.0), gain)


class GainLikelihood:
    """Negative log-likelihood of a log over coordinates of the prior, at the best gain or at none."""

    def __init__(self, likelihood: Likelihood, number: int, prior: Prior, free: bool) -> None:
        self.likelihood, self.number, self.prior, self.free = likelihood, number, prior, free
        self.column = likelihood.chosen[number].index(TENSION[0])
        length = likelihood.cases[number].metres.length
        alike = np.exp(-np.abs(length[:, None] - length) / ALIKE[0])
        self.factor = np.linalg.cholesky(alike + ALIKE[1] ** 2 * np.eye(len(length)))

    def logarithm(self, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n,) log-likelihood at (n, d), and logarithm of the gain there; the likelihood is a parabola in it."""
        table = self.prior.values(normal, 1)[0]
        strays, spread = self.likelihood.strays(self.number, table)
        total = self.likelihood.block(self.number, VIBRATION, strays, spread)
        own = spread[..., self.column].T
        white, of_gain = (
            solve_triangular(self.factor, values, lower=True, check_finite=False)
            for values in (strays[..., self.column].T, 1.0 / (own * np.log(10.0)))
        )
        slope, bend = (white * of_gain).sum(axis=0), (of_gain**2).sum(axis=0)
        gain = np.clip(slope / bend, -MOST, MOST) * self.free
        square = (white**2).sum(axis=0) - 2.0 * gain * slope + gain**2 * bend
        return total - 0.5 * square - np.log(own).sum(axis=0), gain

    def __call__(self, normal: FloatArray) -> tuple[float, FloatArray]:
        """Value and gradient at (d,), by central differences."""
        steps = STEP * np.eye(len(normal))
        values = -self.logarithm(np.vstack([normal, normal + steps, normal - steps]))[0]
        ahead, behind = np.split(values[1:], 2)
        return float(values[0]), (ahead - behind) / (2.0 * STEP)


class Sliding(NamedTuple):
    """Friction and drag coefficient of a tube with 90 % intervals, (mean, low, high) each."""

    friction: tuple[float, float, float]
    drag_coefficient: tuple[float, float, float]


def by_sliding(cases: Sequence[Case], prior: Prior) -> Sliding | None:
    """Friction and drag of one tube by the closed form of steady sliding; None without a tension.

    Least squares of the logarithm of the tension over the metres of the tube's logs, with drag near its prior. The
    interval includes the correlation of neighbouring metres and ``SLIDING_TRUST``, for the motion is not quite steady.
    """
    with_tension = [case for case in cases if "root_tension" in case.metres.felt]
    if not with_tension:
        return None
    middle = float(prior.values(np.zeros((1, 1 + len(prior.shared))), 1)[0, 0, DRAG])
    low, high = prior.ranges.get("drag_coefficient", (middle, middle))
    spread = max((high - low) / middle / 4.0, 1e-6)

    def strays(x: FloatArray) -> FloatArray:
        parts = []
        for case in with_tension:
            predicted = steady_tension(np.full((1, 1), np.exp(x[0])), case.metres, case.scene)[0] * np.exp(x[1])
            scale = middle / case.scene.air.drag_coefficient
            parts.append(np.log(np.maximum(case.metres.felt["root_tension"], 1e-2) / (predicted * scale)))
        return np.concatenate(parts)

    def weighted(weight: float) -> Callable[[FloatArray], FloatArray]:
        return lambda x: np.append(strays(x) * weight, x[1] / spread)

    bounds = ([np.log(UNKNOWNS["friction"].low / 2.0), -1.0], [np.log(1.0), 1.0])
    fit = least_squares(weighted(10.0), [np.log(0.15), 0.0], bounds=bounds, loss="soft_l1")
    left = strays(fit.x)
    alike = float(np.clip(np.corrcoef(left[:-1], left[1:])[0, 1], 0.0, 0.95)) if len(left) > 3 else 0.95
    weight = 1.0 / np.sqrt(max(left.var(), 1e-6) * (1.0 + alike) / (1.0 - alike))
    fit = least_squares(weighted(float(weight)), fit.x, bounds=bounds, loss="soft_l1")
    jacobian = np.asarray(fit.jac)
    covariance = np.linalg.inv(jacobian.T @ jacobian + 1e-12 * np.eye(2))
    deviation = np.sqrt(np.diag(covariance) + SLIDING_TRUST**2)

    centres = np.exp(fit.x) * (1.0, middle)
    rows = np.column_stack([centres, centres * np.exp(-Z90 * deviation), centres * np.exp(Z90 * deviation)])
    return Sliding(*rows.tolist())
