"""Samples drawn anew: intervals of means, ratios, curves and whatever else is reckoned from a few tubes or seeds."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
from scipy.stats import DegenerateDataWarning, bootstrap, permutation_test

from probe_env.arrays import FloatArray

CONFIDENCE: Final = 0.95
PERCENTILES: Final = (50.0 * (1.0 - CONFIDENCE), 50.0 * (1.0 + CONFIDENCE))
"""Of what was drawn anew: ends of an interval."""
RESAMPLES: Final = 2000
"""How often samples are drawn anew where SciPy does not do it."""
FLIPS: Final = 99_999
"""At most so many signs are drawn where chance is asked for."""


@dataclass(frozen=True)
class Interval:
    """A mean with its confidence interval."""

    mean: float
    low: float
    high: float

    def text(self, factor: float = 1.0) -> str:
        """Mean and interval, three digits."""
        return f"{short(self.mean * factor)} [{short(self.low * factor)}, {short(self.high * factor)}]"


def short(value: float, sign: str = "") -> str:
    """Three digits; ``sign`` "+": with a sign, unless it is 0."""
    sign = sign if value else ""
    return f"{value:{sign}.0f}" if abs(value) >= 100.0 else f"{value:{sign}.3g}"


def bootstrap_ends(
    statistic: Callable[..., Any], *samples: np.ndarray, method: Literal["BCa", "percentile"] = "BCa", **options: Any
) -> tuple[Any, Any]:
    """Ends of a statistic's 95 % interval, drawn with a fixed seed.

    BCa fails on nearly equal values: there plain percentiles serve.

    Args:
        statistic: of the samples, with ``axis`` unless ``vectorized=False``.
        samples: independent ones (paired with ``paired=True``).
        method: of ``scipy.stats.bootstrap``.
        options: of it.
    """
    for kind in dict.fromkeys((method, "percentile")):
        rng = np.random.default_rng(0)
        with warnings.catch_warnings(), np.errstate(divide="ignore", invalid="ignore"):
            warnings.simplefilter("ignore", DegenerateDataWarning)
            drawn = bootstrap(samples, statistic, confidence_level=CONFIDENCE, method=kind, rng=rng, **options)
        low, high = drawn.confidence_interval
        if np.isfinite([low, high]).all():
            break
    return low, high


def redrawn(*counts: int) -> Iterator[tuple[npt.NDArray[np.int64], ...]]:
    """Places drawn anew with a fixed seed: ``RESAMPLES`` times one array (n,) of each of the counts n."""
    rng = np.random.default_rng(0)
    for _ in range(RESAMPLES):
        yield tuple(rng.integers(count, size=count) for count in counts)


def redrawn_means(values: FloatArray) -> FloatArray:
    """(RESAMPLES, d) means of values (n, d) over rows that are drawn anew, with a fixed seed."""
    rng, count = np.random.default_rng(0), len(values)
    weights = rng.multinomial(count, np.full(count, 1.0 / count), size=RESAMPLES)
    return np.asarray(weights @ values / count)


def chance_of_mean(differences: np.ndarray) -> float:
    """How likely paired differences are to have so large a mean, either way, if each might as well have the other sign.

    That is so where both of a pair were drawn from one distribution. All signs are tried, or 99,999 drawn ones.

    Raises:
        ValueError: no differences, or some that are not finite.
    """
    differences = np.asarray(differences, dtype=float)
    if len(differences) == 0 or not np.isfinite(differences).all():
        raise ValueError(f"differences = {differences!r} must be finite and at least one")
    differences = differences[differences != 0.0]  # which have no sign
    if len(differences) < 2:
        return 1.0
    tried = permutation_test(
        (differences,), np.mean, permutation_type="samples", vectorized=True,
        n_resamples=FLIPS, batch=10_000, rng=np.random.default_rng(0),
    )  # fmt: skip
    return float(tried.pvalue)
