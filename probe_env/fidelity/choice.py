"""The cheapest setting whose measured error is within a tolerance for a scene.

The errors that it goes by are those that ``probe-env chart`` measured against the converged mesh with a fine step, each
the largest that a 95 % interval leaves room for: at constant lengths of 10, 30, 40 and 50 m with contact stiffnesses of
1e4, 1e5 and 1e6 N/m, and over whole insertions, where time-lapse comes in. They are errors in time and mesh; what the
walls and the contact stiffness change is a matter of the model, and larger (docs/accuracy.md).
"""

from __future__ import annotations

import csv
import logging
import math
from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import files
from typing import Final, NamedTuple

from probe_env.fidelity.settings import Fidelity, in_words
from probe_env.physics.methods import METHODS
from probe_env.scene import Scene

TOLERANCE: Final = 0.25
NEAR: Final = 2.0
"""A measured stiffness stands for those within this factor of it."""
MOST_TIME_LAPSE: Final = 4.0
"""Errors of time-lapse were measured at a steady feed; a controller at 8 already outran its vibration."""
LOGGER: Final = logging.getLogger(__name__)


class Measured(NamedTuple):
    """Error of one output for one setting; ``length`` is None for a whole insertion."""

    fidelity: Fidelity
    length: float | None
    stiffness: float
    output: str
    error: float
    cost: float


class Choice(NamedTuple):
    """What was chosen and why; ``error`` is the bound for the worst of the outputs, ``cost`` s per pitch and second."""

    fidelity: Fidelity
    error: float
    cost: float
    reason: str


@lru_cache
def measured() -> tuple[Measured, ...]:
    """The shipped table of measured errors."""
    text = files("probe_env").joinpath("data/measured_errors.csv").read_text()
    return tuple(
        Measured(
            Fidelity(
                method=row["method"],
                time_step=float(row["time_step_s"]),
                nodes_per_pitch=int(row["nodes_per_pitch"]),
                time_lapse=float(row["time_lapse"]),
            ),
            float(row["carrier_length_m"]) if row["carrier_length_m"] else None,
            float(row["contact_stiffness_n_per_m"]), row["output"], float(row["error"]), float(row["cost_s"]),
        )
        for row in csv.DictReader(text.splitlines())
    )  # fmt: skip


def outputs() -> tuple[str, ...]:
    """Outputs with measured errors, by the names of ``signals.point_statistics``."""
    return tuple(dict.fromkeys(row.output for row in measured()))


def choose_fidelity(
    scene: Scene,
    tolerance: float = TOLERANCE,
    needed: Sequence[str] = ("radial_rms_m",),
    growing: bool = False,
) -> Choice:
    """The cheapest setting whose measured error is within the tolerance for all needed outputs.

    Lengths and stiffnesses between measured ones take the worse of both neighbours; a growing probe takes all lengths
    up to the helix's, and the insertions' errors if its stiffness is near table 2's.

    Args:
        scene: length and contact stiffness count.
        tolerance: largest relative error of an ensemble mean.
        needed: some of ``outputs``.
        growing: whether the probe is fed in; only then time-lapse is considered.

    Raises:
        ValueError: an unknown output, a stiffness outside what was measured, or no setting is within the tolerance.
    """
    unknown = [name for name in needed if name not in outputs()]
    if unknown or not needed:
        raise ValueError(f"needed = {list(needed)!r}: must be some of {', '.join(outputs())}")
    if not 0.0 < tolerance < math.inf:
        raise ValueError(f"tolerance = {tolerance!r} is outside the accepted range above 0")
    stiffnesses = _stiffnesses(scene)
    lengths = _lengths(scene, growing, stiffnesses)
    relevant = [
        row for row in measured() if row.output in needed and row.stiffness in stiffnesses and row.length in lengths
    ]
    most = MOST_TIME_LAPSE if growing else 1.0
    candidates = dict.fromkeys(row.fidelity for row in measured() if row.fidelity.time_lapse <= most)
    rated = []
    for fidelity in candidates:
        own = [row for row in relevant if row.fidelity in (fidelity, fidelity.model_copy(update={"time_lapse": 1.0}))]
        if _holds(fidelity, scene) and _complete(own, relevant, fidelity):
            rated.append((max(row.error for row in own), max(row.cost for row in own) / fidelity.time_lapse, fidelity))
    within = [entry for entry in rated if entry[0] <= tolerance]
    if not within:
        least = min(rated, default=None)
        known = f"the least measured is {least[0]:.2g} ({in_words(least[2])})" if least else "nothing measured fits it"
        raise ValueError(f"tolerance = {tolerance:g} is not kept by any setting for this scene: {known}")
    error, cost, chosen = min(within, key=lambda entry: (entry[1], entry[0]))
    reason = (
        f"{in_words(chosen)}: {', '.join(needed)} within {error:.2g} where measured (tolerance {tolerance:g}),"
        f" the cheapest of {len(within)} of {len(rated)} settings"
    )
    LOGGER.info("fidelity auto: %s", reason)
    return Choice(chosen, error, cost, reason)


def _holds(fidelity: Fidelity, scene: Scene) -> bool:
    """Whether a setting's step is known to hold, and its method can take the scene at all."""
    try:
        return fidelity.time_step <= METHODS[fidelity.method].stable_step(scene, fidelity.nodes_per_pitch)
    except ValueError:  # its contact asks for more modes than a superelement has room for
        return False


def _stiffnesses(scene: Scene) -> list[float]:
    """Measured contact stiffnesses that tell of the scene's: one within ``NEAR``, or the two around it."""
    known = sorted({row.stiffness for row in measured()})
    wanted = scene.contact.stiffness
    near = [value for value in known if max(value / wanted, wanted / value) <= NEAR]
    if not near and not known[0] <= wanted <= known[-1]:
        raise ValueError(f"contact.stiffness = {wanted:g} is outside what was measured, {known[0]:g} to {known[-1]:g}")
    return near or _around(known, wanted)


def _lengths(scene: Scene, growing: bool, stiffnesses: Sequence[float]) -> list[float | None]:
    """Carrier lengths measured with all these stiffnesses that tell of the scene's.

    Of a growing probe's all up to its end, and the insertions (None).
    """
    of = [{row.length for row in measured() if row.stiffness == value} - {None} for value in stiffnesses]
    known = sorted(value for value in set.intersection(*of) if value is not None)
    if growing:
        return [*(value for value in known if value <= _around(known, _end(scene))[-1]), None]
    return list(_around(known, scene.carrier_length))


def _end(scene: Scene) -> float:
    return scene.tube.helix_length - scene.probe.guide_length


def _around(known: Sequence[float], wanted: float) -> list[float]:
    """The measured value itself or the two around it; beyond the ends the nearest."""
    wanted = min(max(wanted, known[0]), known[-1])
    return sorted({max(v for v in known if v <= wanted), min(v for v in known if v >= wanted)})


def _complete(own: Sequence[Measured], relevant: Sequence[Measured], fidelity: Fidelity) -> bool:
    """Whether a setting was measured wherever any was; with time-lapse also in the insertions."""
    places = {(row.length, row.stiffness, row.output) for row in relevant if row.length is not None}
    covered = places <= {(row.length, row.stiffness, row.output) for row in own}
    inserted = any(row.length is None and row.fidelity == fidelity for row in own)
    return covered and (fidelity.time_lapse == 1.0 or inserted)
