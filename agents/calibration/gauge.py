"""Whether the root tension was read as large as it was: its shape over the length against what the plant allows.

The level of the tension tells friction and pull of the air only together; how it bends at first tells the friction
whatever the gain of the gauge, and so, through the vibration, do the accelerations. A gain is what is left over.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from agents.calibration.inference import TENSION, VIBRATION, Likelihood
from agents.calibration.unknowns import Prior
from probe_env.arrays import FloatArray

BOX: Final = 2.33
"""Standard normal coordinate within which 98 of 100 of what is held possible lie: there all are held alike."""
MOST: Final = 1.5
"""Greatest logarithm of a gain that is looked for."""
ALIKE: Final = 15.0, 0.8
"""How the tension of 32 logs at ``standard`` strays, in the scatter that the network tells: alike over so many metres,
and each by itself so much as a share. Their likelihood is greatest at 15 m and 0.4; the rest is left to gauges."""
LIMIT: Final = 4.5
"""Of twice the logarithm of the likelihoods' ratio: one in thirty by Wilks, and none of the 32 logs that the likelihood
was found on (greatest: 4.3); of these with 1.5 times the tension all but two were beyond. Taken before the posterior's
own tension block got its present form, which moves the settled scatter a little, and not taken again."""
DRAWN, STARTS, STEP = 2048, 4, 1e-4


class Gain(NamedTuple):
    """How a gauge seems to read.

    Attributes:
        ratio: twice the logarithm of how much likelier the best gain makes the log than none.
        gain: that gain: what was read over what was.
    """

    ratio: float
    gain: float


def gain_of(likelihood: Likelihood, number: int, prior: Prior) -> Gain | None:
    """Best gain of one log's tension, its unknowns free within what is held possible; None without a tension."""
    if TENSION not in likelihood.blocks[number]:
        return None
    best = []
    for free in (False, True):
        objective = _Objective(likelihood, number, prior, free)
        drawn = np.random.default_rng(0).normal(size=(DRAWN, 1 + len(prior.shared))).clip(-BOX, BOX)
        parts = np.array_split(drawn, DRAWN // 32)
        order = np.argsort(np.concatenate([objective.logarithm(part)[0] for part in parts]))[::-1]
        results = [
            minimize(objective, drawn[k], jac=True, method="L-BFGS-B", bounds=[(-BOX, BOX)] * drawn.shape[1])
            for k in order[:STARTS]
        ]
        best.append((objective, min(results, key=lambda result: result.fun)))
    (_, without), (objective, with_gain) = best
    gain = float(np.exp(objective.logarithm(with_gain.x[None])[1][0]))
    return Gain(max(2.0 * float(without.fun - with_gain.fun), 0.0), gain)


class _Objective:
    """Minus the logarithm of a log's likelihood over coordinates of the prior, the gain at its best or none."""

    def __init__(self, likelihood: Likelihood, number: int, prior: Prior, free: bool) -> None:
        self.likelihood, self.number, self.prior, self.free = likelihood, number, prior, free
        self.column = likelihood.chosen[number].index(TENSION[0])
        length = likelihood.cases[number].metres.length
        alike = np.exp(-np.abs(length[:, None] - length) / ALIKE[0])
        self.factor = np.linalg.cholesky(alike + ALIKE[1] ** 2 * np.eye(len(length)))

    def logarithm(self, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n,) of the likelihood at (n, d), and logarithm of the gain there; in it the likelihood is a parabola."""
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
        """Value and gradient at (d,), by differences on both sides."""
        steps = STEP * np.eye(len(normal))
        values = -self.logarithm(np.vstack([normal, normal + steps, normal - steps]))[0]
        ahead, behind = np.split(values[1:], 2)
        return float(values[0]), (ahead - behind) / (2.0 * STEP)
