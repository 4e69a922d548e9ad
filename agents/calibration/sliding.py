"""Friction from the root tension alone, by the closed form of steady sliding: a first answer within a second."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from agents.calibration.inference import Case
from agents.calibration.unknowns import UNKNOWNS, Prior
from probe_env.arrays import FloatArray
from probe_env.physics.closed_forms import sliding_tension

TRUST: Final = 0.02
"""Standard deviation of the simulated mean tension from the closed form, relative, over a whole log."""
Z90: Final = 1.645


class Sliding(NamedTuple):
    """Friction and drag coefficient of a tube with 90 % intervals, (mean, low, high) each."""

    friction: tuple[float, float, float]
    drag_coefficient: tuple[float, float, float]


def by_sliding(cases: Sequence[Case], prior: Prior) -> Sliding | None:
    """Least squares of the logarithm of the tension over the metres of one tube's logs; None without a tension.

    Drag is held near what the prior says. The interval counts how alike the strays of neighbouring metres are, and
    ``TRUST``, for the motion is not quite steady sliding.
    """
    with_tension = [case for case in cases if "root_tension" in case.metres.felt]
    if not with_tension:
        return None
    middle = float(prior.values(np.zeros((1, 1 + len(prior.shared))), 1)[0, 0, 2])
    low, high = prior.ranges.get("drag_coefficient", (middle, middle))
    spread = max((high - low) / middle / 4.0, 1e-6)

    def strays(x: FloatArray) -> FloatArray:
        parts = []
        for case in with_tension:
            m = case.metres
            seen = {
                "inserted_length": m.length, "feed_speed": m.feed, "air_supply_rate": m.air,
                "helix_diameter": np.full(len(m), case.scene.tube.helix_diameter),
            }  # fmt: skip
            predicted = sliding_tension(np.full((1, 1), np.exp(x[0])), seen, case.scene)[0] * np.exp(x[1])
            scale = middle / case.scene.air.drag_coefficient
            parts.append(np.log(np.maximum(m.felt["root_tension"], 1e-2) / (predicted * scale)))
        return np.concatenate(parts)

    def held(x: FloatArray, weight: float) -> FloatArray:
        return np.append(strays(x) * weight, x[1] / spread)

    low_mu, high_mu = UNKNOWNS["friction"].low / 2.0, 1.0
    bounds = ([np.log(low_mu), -1.0], [np.log(high_mu), 1.0])
    fit = least_squares(held, [np.log(0.15), 0.0], bounds=bounds, loss="soft_l1", args=(10.0,))
    left = strays(fit.x)
    alike = float(np.clip(np.corrcoef(left[:-1], left[1:])[0, 1], 0.0, 0.95)) if len(left) > 3 else 0.95
    weight = 1.0 / np.sqrt(max(left.var(), 1e-6) * (1.0 + alike) / (1.0 - alike))
    fit = least_squares(held, fit.x, bounds=bounds, loss="soft_l1", args=(float(weight),))
    jacobian = np.asarray(fit.jac)
    covariance = np.linalg.inv(jacobian.T @ jacobian + 1e-12 * np.eye(2))
    deviation = np.sqrt(np.diag(covariance) + TRUST**2)

    def interval(centre: float, relative: float) -> tuple[float, float, float]:
        return centre, centre * float(np.exp(-Z90 * relative)), centre * float(np.exp(Z90 * relative))

    return Sliding(
        interval(float(np.exp(fit.x[0])), float(deviation[0])),
        interval(middle * float(np.exp(fit.x[1])), float(deviation[1])),
    )
