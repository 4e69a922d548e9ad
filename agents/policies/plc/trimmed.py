"""The law with integral action: past the onset its feed is trimmed until the noise is what is aimed at.

How fast a probe may be fed before it rings is a sharp limit, some ten percent of feed wide, and another in every tube.
The law goes by what it knows of the tube, and is beyond the limit in some and needlessly slow in others; what it is off
by stays much the same along a tube, so it can be learnt there. It is lowered faster than raised, for a probe that rings
costs more than one that is late.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final

import numpy as np
from pydantic import ValidationError

from agents.policies.plc.law import PlcLaw
from probe_env.arrays import FloatArray
from probe_env.files import MEBI, FileError, read_text
from probe_env.settings import Model, explain, quantity

NOISE_AVERAGE: Final = 4.0
"""Time constant of the average of the logarithm of the noise that is compared [s]."""
UNKNOWN_NOISE: Final = 1e-5
"""What it begins with [m]."""
LOWERED, RAISED = 1.0, 0.5
"""Greatest logarithm of the ratio of noise and aim that counts, for less feed and for more."""
MOST_TRIM: Final = 0.5
"""Greatest logarithm of the factor on the feed, either way."""
STORED: Final = Path(__file__).parents[1] / "data" / "trimmed-law.json"


class Trim(Model):
    """Its two constants, beside the law's ten."""

    aim: Annotated[float, quantity(1e-6, 1e-3, "m")] = 3.5e-5
    """Noise, as radial rms, at which the feed stays as it is."""
    time: Annotated[float, quantity(1.0, 10000.0, "s")] = 80.0
    """In which feed changes by a factor of e where the noise is off by a factor of e."""


def read_trim(path: str | Path = STORED) -> Trim:
    """Constants from a file (JSON).

    Raises:
        FileNotFoundError: no such file.
        FileError: not such constants; names every offending field.
    """
    try:
        return Trim.model_validate(json.loads(read_text(Path(path), MEBI))["trim"])
    except ValidationError as error:
        raise FileError(path, explain(error)) from error
    except (json.JSONDecodeError, RecursionError, KeyError, TypeError) as error:
        raise FileError(path, f"not the constants of a trim: {error}") from error


@dataclass
class TrimmedLaw(PlcLaw):
    """Acts by the law with its feed trimmed. Memory: the law's, average of the logarithm of the noise, trim."""

    trim: Trim = field(default_factory=read_trim)
    memory: ClassVar[int] = PlcLaw.memory + 2

    def start(self, memory: FloatArray) -> None:
        """Memory: the law's, little noise, and no trim."""
        super().start(memory[:, : PlcLaw.memory])
        memory[:, PlcLaw.memory :] = np.log(UNKNOWN_NOISE), 0.0

    def targets(self, seen: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """By length, tension, noise and helix diameter.

        Raises:
            ValueError: the task does not show the root tension.
        """
        feed, air = super().targets(seen, memory[:, : PlcLaw.memory])
        noise, trim = memory[:, -2], memory[:, -1]
        period = self.config.period
        gain = 1.0 - np.exp(-period / NOISE_AVERAGE)
        noise += gain * (np.log(np.maximum(seen["rf_noise"], 1e-7)) - noise)
        past = air > self._plant.air_supply_rates[0]  # the onset
        short = np.clip(np.log(self.trim.aim) - noise, -LOWERED, RAISED)
        trim += np.where(past, period / self.trim.time * short, 0.0)
        np.clip(trim, -MOST_TRIM, MOST_TRIM, out=trim)
        trimmed = np.clip(feed * np.exp(trim), *self._plant.feed_speeds)
        return np.where(past, trimmed, feed), air

    def describe(self) -> dict[str, Any]:
        """With its constants."""
        return super().describe() | self.trim.model_dump()
