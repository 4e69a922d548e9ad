"""Bounds of statistical tests: distance of means of chaotic runs by chance.

At more than about 30 m of carrier, runs that differ in the last digit soon agree in their statistics only, so that
another processor gives another random sample. A bound is the quantile of Student's t that the logarithm of a ratio of
means exceeds with probability ``CHANCE``; t, because deviations were measured on ``MEASURED`` members.

A true shift by the bound is detected with probability 0.5, by twice the bound with probability 1 - ``CHANCE``.
"""

import math

import numpy as np
from scipy.stats import binom, t

CHANCE = 1e-4
MEASURED = 32
"""Least number of members from which a relative deviation below was measured."""

DEVIATIONS = {
    "radial_rms_m": (0.13, 0.12),
    "radial_p99_m": (0.17, 0.145),
    "axial_rms_m": (0.03, 0.068),
    "lift_off_share": (0.026, 0.017),
    "radial_acceleration_rms_m_per_s2": (0.061, 0.053),
    "axial_mean_m": (0.0055, 0.073),
    "tension_mean_n": (4e-5, 7e-5),
}
"""Relative standard deviation of one run of 6 s at l = 30 and 50 m: pooled over the 13 settings (imex and imex32,
2.5e-5 to 2e-4 s) of 32 members each in results/chart/ensembles.csv, rounded up."""


def deviation(statistic: str, length: float) -> float:
    """Relative standard deviation of one run of the probe of table 2."""
    return DEVIATIONS[statistic][(30.0, 50.0).index(length)]


def reach(*samples: tuple[float, int], chance: float = CHANCE, measured: int = MEASURED) -> float:
    """Largest distance by chance of the logarithms of two means, or for absolute deviations of the means themselves.

    ``samples``: of each mean the relative deviation of one member, measured from ``measured``, and its members.
    """
    spread = math.sqrt(sum(relative**2 / members for relative, members in samples))
    return float(t.isf(0.5 * chance, measured - 1)) * spread


def of_another(deviation: float, measured: int = MEASURED, among: int = 1, members: int = 1) -> float:
    """Largest distance by chance of the mean of new members from the mean of the measured ones.

    ``among``: number of such bounds in one test; together they fail with probability ``CHANCE``.
    """
    return reach((deviation, members), (deviation, measured), chance=CHANCE / among, measured=measured)


def apart(first: np.ndarray, second: np.ndarray) -> float:
    """Logarithm of the ratio of two means."""
    return math.log(first.mean() / second.mean())


def hits_within(trials: int, minimum: float, maximum: float, chance: float = CHANCE) -> tuple[int, int]:
    """Fewest and most successes of trials with a probability between two bounds; ``chance``: error on each side."""
    return int(binom.ppf(chance, trials, minimum)), int(binom.isf(chance, trials, maximum))
