"""The fidelity of both passes by its name, one without time-lapse among them, and what time-lapse does there."""

from __future__ import annotations

import warnings
from typing import Final

from probe_env.fidelity import BOTH_WAYS, Fidelity, resolve_fidelity

UNLAPSED: Final = "unlapsed"
"""Nodes and step of ``fast`` without its time-lapse, which spreads the shaking of the turn over four times as much."""


def fidelity_of(name: str) -> Fidelity:
    """A fidelity of both ways by its name, or ``UNLAPSED``.

    Raises:
        ValueError: no such fidelity, or one that does not simulate the way back.
    """
    if name == UNLAPSED:
        return BOTH_WAYS["fast"].model_copy(update={"time_lapse": 1.0})
    return resolve_fidelity(name, both_ways=True)


def warn_of_time_lapse(fidelity: Fidelity) -> None:
    """Say what time-lapse does to what is found on the way back."""
    if fidelity.time_lapse > 1.0:
        warnings.warn(
            f"time_lapse = {fidelity.time_lapse:g}: the turn shakes the probe over so many times as many metres, and"
            f" less is found on the way back than would be; {UNLAPSED} and standard have none",
            stacklevel=2,
        )
