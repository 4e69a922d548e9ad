"""What the map leaves out of a second of an insertion, as a few numbers found on recorded ones."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Self

import numpy as np
from pydantic import Field, ValidationError

from agents.records.models import Figures
from agents.records.reading import FileError, read_json
from probe_env.arrays import FloatArray
from probe_env.settings import Model, explain, tuples

STORED: Final = Path(__file__).parents[1] / "policies" / "data" / "map-world.json"
Coefficients = Annotated[tuple[float, ...], Field(min_length=6, max_length=6)]


class Scatter(Model):
    """A stationary Gaussian process of order one: standard deviation, and correlation from one second to the next."""

    deviation: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    correlation: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0

    def moved(self, value: FloatArray, normal: FloatArray) -> FloatArray:
        """The next second's values (n,), by standard normal draws (n,)."""
        return np.asarray(self.correlation * value + self.deviation * np.sqrt(1.0 - self.correlation**2) * normal)

    @classmethod
    def of(cls, series: list[FloatArray], far: int = 1) -> Self:
        """Of the part of several series, means taken away, that lasts: by autocovariances 1 and ``far`` steps apart."""
        near, later = (np.mean([np.mean(x[:-lag] * x[lag:]) for x in series]) for lag in (1, far))
        if far == 1:
            variance = float(np.mean([np.mean(x * x) for x in series]))
            return cls(deviation=float(np.sqrt(variance)), correlation=float(np.clip(near / variance, 0.0, 0.999)))
        correlation = float(np.clip((later / near) ** (1.0 / (far - 1)), 0.0, 0.999))
        return cls(deviation=float(np.sqrt(near / correlation)), correlation=correlation)


class Noise(Model):
    """All of it. Decades are of the radial rms; the others of natural logarithms."""

    bias: float = 0.0
    """Of a second's rms against that of a metre, which the map tells [decades]."""
    slow: Scatter = Scatter()
    """Vibration that lasts: tubes and stretches that are louder or quieter than the map says [decades]."""
    quick: float = 0.0
    """Standard deviation from one second to the next [decades]."""
    tension: Scatter = Scatter()
    """Of the root tension's logarithm around that of steady sliding."""
    radial: Coefficients = (1.0, 0.7, 0.0, 0.0, 0.0, 0.0)
    """Of log10 of the radial acceleration's rms [m/s2], by ``features``."""
    radial_scatter: Scatter = Scatter()
    """[decades]."""
    axial: Coefficients = (1.0, 0.4, 0.0, 0.0, 0.0, 0.0)
    """Of the axial acceleration, alike."""
    axial_scatter: Scatter = Scatter()
    """[decades]."""


def features(vibration: FloatArray, feed: FloatArray, length: FloatArray, tubes: FloatArray) -> FloatArray:
    """(n, 6) what accelerations go by.

    Args:
        vibration: (n,) log10(radial rms / 0.1 mm).
        feed: (n,) [m/s].
        length: (n,) inserted [m].
        tubes: (n, 4) in the order of ``CONTEXT``.
    """
    one = np.ones_like(vibration)
    friction, diameter = tubes[:, 0] / 0.175, 1.0 / tubes[:, 3]
    return np.column_stack([one, vibration, np.log10(np.maximum(feed, 1e-3)), length / 60.0, friction, diameter])


def stored_noise(path: Path = STORED) -> Noise:
    """The noise that ships.

    Raises:
        FileNotFoundError: no such file.
        FileError: not such a file; names every offending field.
    """
    try:
        return Noise.model_validate(tuples((read_json(path, Figures).model_extra or {}).get("noise", {})))
    except ValidationError as error:
        raise FileError(path, f"noise: {explain(error)}") from error
