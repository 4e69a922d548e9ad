"""Estimates of the unknowns from logs: posterior (emcee), gauge errors, and friction from the tension alone."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares, minimize
from tqdm import tqdm

from probe_agents.plant.prior import UNKNOWNS, Prior
from probe_agents.plant.response import CHANNELS, DRAG, FLOORS, Metres, Response, observed, steady_tension
from probe_env import Scene
from probe_env.arrays import FloatArray
from probe_env.physics.model.chain import air_pressure, air_speed

MIN_METRES: Final = 8
SENSOR: Final = np.array([0.005, 0.05, 0.05, 0.05])
"""Smallest scatter of the measurements of a metre [decades]: sensors and error of the network."""
GAUGES: Final = np.array([0.01, 0.0, 0.0, 0.0])
"""Additional scatter [decades], not used in the fit of a gain: a noisy gauge is no misspecification."""
FEED_NOISE: Final = np.array([0.0, 0.5, 0.5, 0.5])
"""Additional scatter of each channel as a share of ``FLOORS``: vibration from feeding, which lowers the weight of
metres without ringing."""
TENSION, VIBRATION = (0,), (1, 2, 3)
LIKELIHOOD_POWER: Final = 0.7
"""Power of the likelihood: the network's error in a log is correlated over many metres. It and ``FEED_NOISE`` were
found on 48 simulated logs at ``standard`` that are not used elsewhere."""
WALKERS: Final = 32
BURN_IN, STEPS, DRAWS = 300, 400, 512
SETTLED, FIRST, MINIMUM = 3, 2048, 256
"""Rounds that fix the scatter of the vibration, draws per round, and draws used of each."""

BOX: Final = 2.33
"""Gains: bound of the standard normal coordinates (98 % of the prior), uniform within it."""
MAXIMUM: Final = 1.5
"""Largest logarithm of a gain."""
CORRELATION: Final = 15.0, 0.8
"""Correlation of the deviations of the tension in gains: length [m], and share of independent noise. The likelihood of
32 logs at ``standard`` is largest at 15 m and 0.4; the rest allows for gauges."""
LIMIT: Final = 4.5
"""Limit of twice the logarithm of the likelihood ratio: exceeded by one log in thirty (Wilks), by none of the 32 logs
of ``CORRELATION`` (largest: 4.3), and by 30 of them with 1.5 times the tension (measured once, no stored run)."""
DRAWN, STARTS, STEP = 2048, 4, 1e-4

PRESSURE_SCATTER: Final = 0.03
"""Relative standard deviation of the drag by the pressure over a whole log: 2 % for the acceleration of the air and 1 %
for the change of u / w, which ``air_pressure`` neglects, and 2 % for the gauges of pressure and air."""
SLIDING_SCATTER: Final = 0.02
"""Relative standard deviation of the simulated mean tension from the closed form, over a whole log."""
Z90: Final = 1.645


class LogCase(NamedTuple):
    """A log to fit: name, name of its tube (logs of one tube share a friction), scene, metres, and texts about it."""

    name: str
    tube: str
    scene: Scene
    metres: Metres
    faults: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()  # of the file, and what was left out of it
    heads: Mapping[str, str] = MappingProxyType({})  # channel -> heading, for --columns


class Posterior(NamedTuple):
    """Draws (tubes, n, 4) in the order of ``UNKNOWNS``; all except the friction are shared by the tubes.

    ``misfit`` is the ``Likelihood.misfit`` of each case at the best draw.
    """

    draws: FloatArray
    misfit: list[FloatArray]
    likelihood: Likelihood


class Likelihood:
    """Likelihood of cases under a response; ``tube_indices`` are the indices of the cases in ``tubes``, the names."""

    def __init__(self, response: Response, cases: Sequence[LogCase]) -> None:
        self.response, self.cases = response, cases
        self.tubes = tuple(dict.fromkeys(case.tube for case in cases))
        self.tube_indices = [self.tubes.index(case.tube) for case in cases]
        self.chosen = [[k for k, name in enumerate(CHANNELS) if name in case.metres.measured] for case in cases]
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
        self.drags = [drag_of_pressure(case) for case in cases]
        self.settled: list[FloatArray] = []

    def deviations(self, number: int, table: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Deviations (n, m, c) of a case at (n, 4) in standard deviations, and the standard deviations [decades]."""
        case, chosen = self.cases[number], self.chosen[number]
        mean, spread = self.response.predict(table, case.metres, case.scene)
        quiet = FEED_NOISE * np.minimum(FLOORS / 10.0**mean, 1.0)
        spread = np.hypot(np.hypot(spread, SENSOR), quiet)[..., chosen]
        return (self.observed[number] - mean[..., chosen]) / spread, spread

    def settle(self, draws: FloatArray) -> None:
        """Fix the scatter of every metre at its geometric mean over draws (tubes, n, 4).

        The predicted scatter is then only a weight. A free scatter would favour unknowns with little scatter, since
        logs deviate less than the insertions of the training, which vary feed and air at random.
        """
        self.settled = [
            np.exp(np.log(self.deviations(number, draws[tube])[1]).mean(axis=0))
            for number, tube in enumerate(self.tube_indices)
        ]

    def logarithm(self, draws: FloatArray) -> FloatArray:
        """(n,) logarithm of the likelihood at draws (tubes, n, 4), up to a constant; call ``settle`` before."""
        total = np.zeros(draws.shape[1])
        for number, tube in enumerate(self.tube_indices):
            deviations, spread = self.deviations(number, draws[tube])
            total += sum(self.block(number, channels, deviations, spread) for channels in self.blocks[number])
            total += self.pressure(number, draws[tube])
        return total

    def pressure(self, number: int, table: FloatArray) -> FloatArray:
        """(n,) contribution of the inlet pressure of a case at (n, 4), which measures the drag; 0 without it."""
        mean, deviation = self.drags[number] or (1.0, np.inf)
        return np.asarray(-0.5 * (np.log(table[:, DRAG] / mean) / deviation) ** 2)

    def block(self, number: int, channels: tuple[int, ...], deviations: FloatArray, spread: FloatArray) -> FloatArray:
        """(n,) contribution of some channels of a case; 0 where the log has none of them."""
        if channels not in self.blocks[number]:
            return np.zeros(len(deviations))
        columns, factor = self.blocks[number][channels]
        fixed = channels == VIBRATION
        scatter = self.settled[number] if fixed else np.hypot(spread, GAUGES[self.chosen[number]])
        flat = (deviations * spread / scatter)[..., columns].reshape(len(deviations), -1)
        white = solve_triangular(factor, flat.T, lower=True, check_finite=False)
        density = -0.5 * (white**2).sum(axis=0)
        return np.asarray(
            LIKELIHOOD_POWER * (density if fixed else density - np.log(scatter[..., columns]).sum(axis=(1, 2)))
        )

    def misfit(self, number: int, table: FloatArray) -> FloatArray:
        """(c + 1,) of a case at (4,), see ``Response.misfit_of``."""
        deviations, spread = (values[0] for values in self.deviations(number, table[None]))
        deviations = deviations * spread / np.hypot(spread, GAUGES[self.chosen[number]])
        return self.response.misfit_of(deviations, self.cases[number].metres.length, self.chosen[number])


def sample_posterior(
    response: Response, cases: Sequence[LogCase], prior: Prior, seed: int = 0, progress: bool = False
) -> Posterior:
    """Sample the posterior of the frictions of all tubes and of the shared unknowns; ``seed``: of the walkers."""
    import emcee

    for case in cases:
        if not case.metres.measured:
            raise ValueError(f"{case.name}: has none of the channels {', '.join(CHANNELS)}")
        if len(case.metres) < MIN_METRES:
            raise ValueError(f"{case.name}: {len(case.metres)} metres of insertion, at least {MIN_METRES} are needed")
    likelihood = Likelihood(response, cases)
    size = (tubes := len(likelihood.tubes)) + len(prior.shared)
    rng = np.random.default_rng([seed, size])

    def density(normal: FloatArray) -> FloatArray:
        return np.asarray(likelihood.logarithm(prior.values(normal, tubes)) - 0.5 * (normal**2).sum(axis=1))

    walkers = max(WALKERS, 4 * size)
    # the scatter is fixed at likely draws from the prior, starting with all draws
    drawn, chosen = prior.values(rng.normal(size=(FIRST, size)), tubes), np.arange(MINIMUM)
    for _ in range(SETTLED):
        likelihood.settle(drawn[:, chosen])
        logarithm = np.concatenate([likelihood.logarithm(p) for p in np.array_split(drawn, FIRST // 32, axis=1)])
        chosen = rng.choice(FIRST, MINIMUM, p=_fractions(logarithm, WALKERS))
    likelihood.settle(drawn[:, chosen])
    normal = rng.normal(size=(256 * walkers, size))
    logarithm = np.concatenate([density(part) for part in np.array_split(normal, 256)])
    start = normal[rng.choice(len(normal), walkers, replace=False, p=_fractions(logarithm, walkers))]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)]
        sampler = emcee.EnsembleSampler(walkers, size, density, moves=moves, vectorize=True)
    sampler.log_prob_fn = density  # emcee's wrapper of it would print a traceback at Ctrl-C
    sampler.random_state = np.random.RandomState(int(rng.integers(2**31))).get_state()
    steps = sampler.sample(start, iterations=BURN_IN + STEPS)
    for _ in tqdm(steps, total=BURN_IN + STEPS, desc="posterior", unit="step", disable=not progress):
        pass
    chain, density_of = sampler.get_chain(discard=BURN_IN, flat=True), sampler.get_log_prob(discard=BURN_IN, flat=True)
    rows = np.linspace(0, len(chain) - 1, DRAWS).round().astype(int)
    best = prior.values(chain[[int(np.argmax(density_of))]], tubes)[:, 0]
    misfit = [likelihood.misfit(k, best[tube]) for k, tube in enumerate(likelihood.tube_indices)]
    return Posterior(prior.values(chain[rows], tubes), misfit, likelihood)


def _fractions(logarithm: FloatArray, minimum: int) -> FloatArray:
    """Weights from a likelihood, tempered so that the effective number of draws is at least ``minimum``."""
    cold = 1.0
    for _ in range(20):
        weights = np.exp(cold * (logarithm - logarithm.max()))
        if weights.sum() ** 2 / (weights**2).sum() >= minimum:
            break
        cold *= 0.5
    return np.asarray(weights / weights.sum())


class Gain(NamedTuple):
    """Gain (reading over true value) of a tension gauge; twice the log of its likelihood ratio to no gain."""

    ratio: float
    gain: float


def fit_gain(likelihood: Likelihood, number: int, prior: Prior) -> Gain | None:
    """Fit the gain of one log's tension gauge, with its unknowns free within the prior; None without a tension.

    The initial curvature of the tension and the accelerations give the friction for any gain; the level, the gain.
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
    """Negative log-likelihood of a log over coordinates of the prior, at the best gain or without a gain."""

    def __init__(self, likelihood: Likelihood, number: int, prior: Prior, free: bool) -> None:
        self.likelihood, self.number, self.prior, self.free = likelihood, number, prior, free
        self.column = likelihood.chosen[number].index(TENSION[0])
        length = likelihood.cases[number].metres.length
        correlation = np.exp(-np.abs(length[:, None] - length) / CORRELATION[0])
        self.factor = np.linalg.cholesky(correlation + CORRELATION[1] ** 2 * np.eye(len(length)))

    def logarithm(self, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n,) log-likelihood at (n, d), and the best logarithm of the gain; the likelihood is quadratic in it."""
        table = self.prior.values(normal, 1)[0]
        deviations, spread = self.likelihood.deviations(self.number, table)
        total = self.likelihood.block(self.number, VIBRATION, deviations, spread)
        total += self.likelihood.pressure(self.number, table)
        scatter = spread[..., self.column].T
        white, of_gain = (
            solve_triangular(self.factor, values, lower=True, check_finite=False)
            for values in (deviations[..., self.column].T, 1.0 / (scatter * np.log(10.0)))
        )
        slope, bend = (white * of_gain).sum(axis=0), (of_gain**2).sum(axis=0)
        gain = np.clip(slope / bend, -MAXIMUM, MAXIMUM) * self.free
        square = (white**2).sum(axis=0) - 2.0 * gain * slope + gain**2 * bend
        return total - 0.5 * square - np.log(scatter).sum(axis=0), gain

    def __call__(self, normal: FloatArray) -> tuple[float, FloatArray]:
        """Value and gradient at (d,), by central differences."""
        steps = STEP * np.eye(len(normal))
        values = -self.logarithm(np.vstack([normal, normal + steps, normal - steps]))[0]
        ahead, behind = np.split(values[1:], 2)
        return float(values[0]), (ahead - behind) / (2.0 * STEP)


def drag_of_pressure(case: LogCase) -> tuple[float, float] | None:
    """Drag coefficient by the inlet pressure p of a log, and its relative standard deviation; None without a pressure.

    In ``air_pressure`` p^2 is linear: (p^2 - p_e^2) / (2 p_e) = c D + W + k Q^2, with the drag D of the inserted cable
    over the free cross-section for a coefficient of 1, the losses W at the wall, and those of hose and tube between
    gauge and helix at an air supply Q, k Q^2. D grows with the inserted length and k Q^2 does not, so least squares of
    both sides, relative to the expected pressure, give c and k.
    """
    metres, air = case.metres, case.scene.air
    if "inlet_pressure" not in metres.measured:
        return None

    def head(pressure: FloatArray) -> FloatArray:
        return np.asarray((pressure**2 - air.exit_pressure**2) / (2.0 * air.exit_pressure))

    def expected(coefficient: float) -> FloatArray:
        scene = case.scene.model_copy(update={"air": {"drag_coefficient": coefficient}})
        inserted, speed = metres.length, metres.air * air_speed(scene, 1.0)
        feed: Any = metres.feed  # (m,), as the other arguments
        return head(air_pressure(scene, inserted, inserted, feed, speed))

    drag = expected(2.0) - expected(1.0)
    total, lost = expected(air.drag_coefficient), metres.air**2
    values = head(air.exit_pressure + metres.measured["inlet_pressure"]) - (expected(1.0) - drag)
    columns = np.column_stack([drag, lost]) / total[:, None]
    (mean, loss), *_ = np.linalg.lstsq(columns, values / total, rcond=None)
    left = values / total - columns @ [mean, loss]
    correlation = _correlation(left)
    variance = np.linalg.inv(columns.T @ columns)[0, 0] * left.var() * (1.0 + correlation) / (1.0 - correlation)
    mean = max(float(mean), 1e-3 * air.drag_coefficient)
    return mean, float(np.hypot(np.sqrt(variance) / mean, PRESSURE_SCATTER))


def _correlation(left: FloatArray) -> float:
    """Correlation of neighbouring residuals (m,)."""
    return float(np.clip(np.corrcoef(left[:-1], left[1:])[0, 1], 0.0, 0.95)) if len(left) > 3 else 0.95


class Sliding(NamedTuple):
    """Friction and drag coefficient of a tube with 90 % intervals, (mean, low, high) each.

    ``scatter`` is the standard deviation of the tension from the closed form, relative.
    """

    friction: tuple[float, float, float]
    drag_coefficient: tuple[float, float, float]
    scatter: float


def fit_sliding(cases: Sequence[LogCase], prior: Prior) -> Sliding | None:
    """Fit friction and drag of one tube by the closed form of steady sliding; None without a tension.

    Least squares of the logarithm of the tension over the metres of the tube's logs, with drag near its prior. The
    interval includes the correlation of neighbouring metres and ``SLIDING_SCATTER``, since the motion is not quite
    steady.
    """
    with_tension = [case for case in cases if "root_tension" in case.metres.measured]
    if not with_tension:
        return None
    middle = float(prior.values(np.zeros((1, 1 + len(prior.shared))), 1)[0, 0, DRAG])
    low, high = prior.ranges.get("drag_coefficient", (middle, middle))
    spread = max((high - low) / middle / 4.0, 1e-6)

    def deviations(x: FloatArray) -> FloatArray:
        parts = []
        for case in with_tension:
            drag = np.exp(x[1]) * middle / case.scene.air.drag_coefficient
            predicted = steady_tension(np.full((1, 1), np.exp(x[0])), case.metres, case.scene, drag)[0]
            parts.append(np.log(np.maximum(case.metres.measured["root_tension"], 1e-2) / np.maximum(predicted, 1e-2)))
        return np.concatenate(parts)

    def weighted(weight: float) -> Callable[[FloatArray], FloatArray]:
        return lambda x: np.append(deviations(x) * weight, x[1] / spread)

    bounds = ([np.log(UNKNOWNS["friction"].low / 2.0), -1.0], [np.log(1.0), 1.0])
    fit = least_squares(weighted(10.0), [np.log(0.15), 0.0], bounds=bounds, loss="soft_l1")
    left = deviations(fit.x)
    correlation = _correlation(left)
    weight = 1.0 / np.sqrt(max(left.var(), 1e-6) * (1.0 + correlation) / (1.0 - correlation))
    fit = least_squares(weighted(float(weight)), fit.x, bounds=bounds, loss="soft_l1")
    jacobian = np.asarray(fit.jac)
    covariance = np.linalg.inv(jacobian.T @ jacobian + 1e-12 * np.eye(2))
    deviation = np.sqrt(np.diag(covariance) + SLIDING_SCATTER**2)

    centres = np.exp(fit.x) * (1.0, middle)
    rows = np.column_stack([centres, centres * np.exp(-Z90 * deviation), centres * np.exp(Z90 * deviation)])
    friction, drag = (tuple(row) for row in rows.tolist())
    return Sliding(friction, drag, float(left.std()))
