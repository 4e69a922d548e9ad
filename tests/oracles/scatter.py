"""How far means of chaotic runs lie apart by chance alone: the bounds of the statistical tests follow from it.

Beyond about 30 m of carrier two runs that differ in the last digit soon have nothing in common but their statistics,
so another processor is another draw. A bound is the quantile of Student's t that the logarithm of a ratio of means
goes beyond with ``CHANCE``; t and not normal, for the deviations themselves were measured on ``MEASURED`` members.
Members are skewed a little, means of eight hardly.

A shift of a truth by the bound is noticed half of the time, one by twice the bound with all but ``CHANCE``.
"""

import math

import numpy as np
from scipy.stats import binom, t

CHANCE = 1e-4
MEASURED = 32
"""Least number of fresh members from which a relative deviation below was taken."""

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
    """Of one member of table 2's probe, relative to the mean."""
    return DEVIATIONS[statistic][(30.0, 50.0).index(length)]


def reach(*samples: tuple[float, int], chance: float = CHANCE, measured: int = MEASURED) -> float:
    """Largest distance of the logarithms of two means that is left to chance.

    Args:
        samples: relative deviation of one member, and number of members, of each mean; or deviations of what the means
            are of, in its own unit: then the distance is of the means.
        chance: that equal truths are further apart, in either direction.
        measured: members that the deviation was taken from.
    """
    spread = math.sqrt(sum(relative**2 / members for relative, members in samples))
    return float(t.isf(0.5 * chance, measured - 1)) * spread


def of_another(deviation: float, measured: int = MEASURED, among: int = 1, members: int = 1) -> float:
    """How far the mean of new members lies from the mean of the measured ones by chance.

    Args:
        deviation: of one member, taken from those measured.
        measured: how many they were.
        among: so many such bounds are in one test, which all hold but for ``CHANCE``.
        members: new ones.
    """
    return reach((deviation, members), (deviation, measured), chance=CHANCE / among, measured=measured)


def apart(first: np.ndarray, second: np.ndarray) -> float:
    """Logarithm of the ratio of two means."""
    return math.log(first.mean() / second.mean())


def hits_within(trials: int, least: float, most: float, chance: float = CHANCE) -> tuple[int, int]:
    """Fewest and most successes of trials with a probability between two bounds, but for ``chance`` on either side."""
    return int(binom.ppf(chance, trials, least)), int(binom.isf(chance, trials, most))
