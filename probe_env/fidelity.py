"""Fidelity of the simulation: presets, automatic choice with "auto", and settings of method, time step and mesh.

Time-lapse shortens the time that the motion has per metre of feed, which is valid for steady vibration. If the feed is
fast or changes, the vibration is underestimated; ``steady_feed`` limits time-lapse to slow, steady feeds.

"auto" uses the errors of the accuracy study relative to a converged mesh with a fine step, upper ends of 95 %
intervals: at constant lengths of 10, 30, 40 and 50 m with contact stiffnesses of 1e4, 1e5 and 1e6 N/m, and over whole
insertions with time-lapse. They are errors in time and mesh; the error of the model (walls, contact stiffness) is
larger (docs/fidelity.md).
"""

import csv
import logging
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from importlib.resources import files
from typing import Annotated, Any, Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt
from pydantic import (
    BeforeValidator,
    Field,
    InstanceOf,
    PlainSerializer,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from probe_env.arrays import FloatArray
from probe_env.physics.methods import METHODS, check_step, method_names
from probe_env.physics.methods.method import Method
from probe_env.scene import Scene
from probe_env.settings import Model, closest, one_line_errors, quantity

SURROGATE: Final = "surrogate"
"""Method of the fidelity that predicts vibration from a map instead of a simulation."""
STEADY_CHANGE: Final = 0.05
"""Largest change of a steady feed [m/s]. The error in length is (time-lapse - 1) change^2 / (2 ramp), 7.5 mm with a
ramp of 0.5 m/s2 and a time-lapse of 4."""
ROUNDING: Final = 1e-6
"""Rounding of a feed by the single precision of an action [m/s]."""
TOLERANCE: Final = 0.25
"""Default tolerance of "auto", a relative error."""
NEAR: Final = 2.0
"""Errors measured at one stiffness are used for stiffnesses within this factor."""
MAX_TIME_LAPSE: Final = 4.0
"""Errors of time-lapse were measured at steady feeds; at 8, a controller feeds faster than the vibration develops."""
AUTO: Final = re.compile(r"auto(?::(?P<tolerance>[^:]+))?")
MESH_NODES, MESH_STEP = 8, 1.25e-4
"""Nodes per pitch and longest step [s] of replacements; all random scenes under compression are stable with them."""
LOGGER: Final = logging.getLogger(__name__)


def _method_of(method: object) -> object:
    """A method from its name; None for "surrogate"."""
    if not isinstance(method, str):
        return method
    if method not in (*METHODS, SURROGATE):
        raise ValueError(f"not one of {', '.join((*METHODS, SURROGATE))}")
    return METHODS.get(method)


class Fidelity(Model):
    """Settings of the simulator of an environment; ``time_lapse`` needs a growing probe and applies to insertion only.

    With ``steady_feed``, time-lapse applies only to periods with a feed of at most ``steady_feed`` that changes by at
    most ``STEADY_CHANGE``. The method "surrogate" has no other settings.
    """

    method: Annotated[
        InstanceOf[Method] | None,
        BeforeValidator(_method_of),
        PlainSerializer(lambda method: method.name if method else SURROGATE, str),
    ] = METHODS["superelement32"]
    """Method, or its name; None, "surrogate" in files, for the vibration map."""
    time_step: Annotated[float, quantity(1e-7, 1e-2, "s")] = 2e-4
    nodes_per_pitch: Annotated[int, Field(ge=1, le=64)] = 4
    time_lapse: Annotated[float, quantity(1.0, 1000.0, "")] = 1.0
    steady_feed: Annotated[float, quantity(1e-3, 2.0, "m/s")] | None = None

    @model_validator(mode="after")
    def _fields_fit_together(self) -> Self:
        if self.steady_feed is not None and self.time_lapse == 1.0:
            raise ValueError("steady_feed needs a time_lapse above 1, but time_lapse is 1")
        if self.method is not None:
            check_step(self.method, self.time_step)
            return self
        for name, info in type(self).model_fields.items():
            if name != "method" and getattr(self, name) != info.default:
                raise ValueError(f"{name}: not accepted, method = 'surrogate' does not simulate")
        return self

    @model_serializer(mode="wrap")
    def _without_absent_steady_feed(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Omit ``steady_feed`` if it is None: stored rows are identified by their settings."""
        return {name: value for name, value in write(self).items() if name != "steady_feed" or value is not None}

    def __repr_args__(self) -> Iterator[tuple[str, Any]]:
        """The fields that differ from their defaults, the method by its name."""
        for name, value in super().__repr_args__():
            yield name, self.method_name if name == "method" else value

    @property
    def simulates(self) -> bool:
        """Whether motion is simulated instead of predicted from a vibration map."""
        return self.method is not None

    @property
    def numerics(self) -> tuple[Method, float, int]:
        """Method, time step [s] and nodes per pitch, the arguments of ``Simulator``."""
        return self.simulated_method, self.time_step, self.nodes_per_pitch

    @property
    def method_name(self) -> str:
        """Name of the method, or "surrogate"."""
        return self.method.name if self.method else SURROGATE

    @property
    def simulated_method(self) -> Method:
        """The method of a fidelity that simulates."""
        if self.method is None:
            raise ValueError("fidelity = 'surrogate' simulates no motion, which is needed here: use fast or finer")
        return self.method

    def time_lapse_of(self, feed_speed: npt.ArrayLike, target: npt.ArrayLike) -> FloatArray:
        """(N,) time-lapse of a control period of insertion: change of length over the motion's feed.

        ``feed_speed`` (N,) is the present one, ``target`` (N,) that of the period [m/s].
        """
        feed, targets = np.asarray(feed_speed, dtype=float), np.asarray(target, dtype=float)
        if self.steady_feed is None:
            return np.full(targets.shape, self.time_lapse)
        steady = np.maximum(feed, targets) <= self.steady_feed + ROUNDING
        steady &= np.abs(targets - feed) <= STEADY_CHANGE + ROUNDING
        return np.where(steady, self.time_lapse, 1.0)


PRESETS: Final[dict[str, Fidelity]] = {
    "study": Fidelity(method=METHODS["newmark"], time_step=1e-4),
    "reference": Fidelity(method=METHODS["superelement"], time_step=5e-5),
    "standard": Fidelity(),
    "fast": Fidelity(time_lapse=4.0),
    SURROGATE: Fidelity(method=None),
}
ROUND_TRIP_PRESETS: Final[dict[str, Fidelity]] = {
    "standard": Fidelity(method=METHODS["imex"], time_step=1.25e-4, nodes_per_pitch=8),
    "fast": Fidelity(method=METHODS["imex"], time_lapse=4.0),
}
"""Presets of round trips. Compression presses the cable against the walls between floats, which needs nodes there, and
displaces it by 0.4 m, which needs double precision. "fast" has 4 nodes per pitch, and time-lapse during insertion."""


def summary_text(fidelity: Fidelity) -> str:
    """All settings in one line."""
    if not fidelity.simulates:
        return fidelity.method_name
    mesh = f"{fidelity.nodes_per_pitch} nodes a pitch" if fidelity.nodes_per_pitch != 4 else ""
    step = f"{fidelity.method_name} at {fidelity.time_step:g} s"
    steady = f" up to {fidelity.steady_feed:g} m/s" if fidelity.steady_feed is not None else ""
    lapse = f"time-lapse {fidelity.time_lapse:g}{steady}" if fidelity.time_lapse != 1.0 else ""
    return ", ".join(filter(None, (step, mesh, lapse)))


def resolve_fidelity(
    fidelity: str | Fidelity | Mapping[str, Any],
    scene: Scene | None = None,
    growing: bool = True,
    round_trip: bool = False,
) -> Fidelity:
    """Settings of a preset, of "auto" or "auto:TOLERANCE", or custom settings.

    Args:
        fidelity: name, settings, or a mapping of settings.
        scene: scene for "auto"; default: table 2. If its cable touches the walls between floats, a mesh of nodes
            replaces superelements: the method is its ``on_nodes_as`` with ``MESH_NODES`` per pitch, equal time-lapse,
            and a step of at most ``MESH_STEP``. Logged once.
        growing: whether the probe is inserted; time-lapse is not used at constant length.
        round_trip: whether the probe is also withdrawn.

    Raises:
        ValueError: unknown preset, invalid settings, a tolerance below all measured errors, or a method that does not
            simulate withdrawal.
    """
    if round_trip:
        return _round_trip(fidelity)
    scene = scene or Scene()
    chosen = _preset_or_settings(fidelity, scene, growing)
    if not growing:
        chosen = chosen.model_copy(update={"time_lapse": 1.0, "steady_feed": None})
    if chosen.method is None or chosen.method.on_nodes or not scene.contact.cable:
        return chosen
    step = min(chosen.time_step, MESH_STEP)
    update = {"method": chosen.method.on_nodes_as, "nodes_per_pitch": MESH_NODES, "time_step": step}
    replacement = chosen.model_copy(update=update)
    _log_nodes(chosen.method_name, summary_text(replacement))
    return replacement


@lru_cache
def _log_nodes(method: str, replacement: str) -> None:
    LOGGER.warning(
        "fidelity: %s has no nodes between floats, which contact.cable needs; using %s",
        method, replacement,
    )  # fmt: skip


def _preset_or_settings(fidelity: str | Fidelity | Mapping[str, Any], scene: Scene, growing: bool) -> Fidelity:
    """``resolve_fidelity`` for insertion, without replacing superelements."""
    if isinstance(fidelity, Fidelity):
        return fidelity
    if not isinstance(fidelity, str):
        with one_line_errors():
            return Fidelity.model_validate(dict(fidelity))
    if fidelity in PRESETS:
        return PRESETS[fidelity]
    auto = AUTO.fullmatch(fidelity)
    if auto is None:
        known = ", ".join((*PRESETS, "auto", "auto:TOLERANCE"))
        hint = closest(fidelity, PRESETS)
        raise ValueError(f"fidelity = {fidelity!r} is not one of {known}, nor a mapping of settings{hint}")
    try:
        tolerance = float(auto["tolerance"] or TOLERANCE)
    except ValueError:
        raise ValueError(
            f"fidelity = {fidelity!r}: the tolerance {auto['tolerance']!r} is not a number; give a relative error, such"
            f" as auto:{TOLERANCE:g}"
        ) from None
    return choose_fidelity(scene, tolerance, growing=growing).fidelity


def _round_trip(fidelity: str | Fidelity | Mapping[str, Any]) -> Fidelity:
    """``resolve_fidelity`` for a round trip."""
    if isinstance(fidelity, str) and fidelity in ROUND_TRIP_PRESETS:
        return ROUND_TRIP_PRESETS[fidelity]
    known = ", ".join((*ROUND_TRIP_PRESETS, "study"))
    if isinstance(fidelity, str) and AUTO.fullmatch(fidelity):
        raise ValueError(f"fidelity = {fidelity!r}: no errors are known for withdrawal; give one of {known}")
    chosen = _preset_or_settings(fidelity, Scene(), growing=True)
    if chosen.method is None or not chosen.method.simulates_withdrawal:
        raise ValueError(
            f"fidelity = {fidelity!r}: {chosen.method_name} does not simulate withdrawal; give one of {known}, or"
            f" settings with one of {method_names(lambda method: method.simulates_withdrawal)}"
        )
    return chosen


def is_surrogate(fidelity: str | Fidelity | Mapping[str, Any]) -> bool:
    """Whether a fidelity, an argument of ``resolve_fidelity``, is that of the vibration map."""
    if isinstance(fidelity, Fidelity):
        return not fidelity.simulates
    return (fidelity if isinstance(fidelity, str) else fidelity.get("method")) == SURROGATE


class MeasuredError(NamedTuple):
    """Measured error of one output for one setting; ``length`` is None for a whole insertion."""

    fidelity: Fidelity
    length: float | None
    stiffness: float
    output: str
    error: float
    cost: float


class FidelityChoice(NamedTuple):
    """Chosen settings and the reason; ``error`` bounds that of all outputs, ``cost`` is in s per pitch and second."""

    fidelity: Fidelity
    error: float
    cost: float
    reason: str


@lru_cache
def measured_errors() -> tuple[MeasuredError, ...]:
    """Shipped table of measured errors."""
    text = files("probe_env").joinpath("data/measured_errors.csv").read_text()
    return tuple(
        MeasuredError(
            Fidelity(
                method=METHODS[row["method"]],
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
    """Outputs with measured errors, names as in ``signals.point_statistics``."""
    return tuple(dict.fromkeys(row.output for row in measured_errors()))


def choose_fidelity(
    scene: Scene, tolerance: float = TOLERANCE, needed: Sequence[str] = ("radial_rms_m",), growing: bool = False
) -> FidelityChoice:
    """The cheapest settings whose measured error is within the tolerance for all needed outputs.

    Between measured lengths and stiffnesses, the larger error of both neighbours counts. For a growing probe, all
    lengths up to that of the helix count, and the errors of insertions if its stiffness is near that of table 2.

    Args:
        scene: its length and contact stiffness are used.
        tolerance: largest relative error of an ensemble mean.
        needed: measured outputs, named as in ``point_statistics``.
        growing: whether the probe is inserted; time-lapse is considered only then.

    Raises:
        ValueError: an unknown output, a stiffness outside the measured range, or no settings within the tolerance.
    """
    unknown = [name for name in needed if name not in outputs()]
    if unknown or not needed:
        raise ValueError(f"needed = {list(needed)!r}: must be some of {', '.join(outputs())}")
    if not 0.0 < tolerance < math.inf:
        raise ValueError(f"tolerance = {tolerance!r} is outside the accepted range above 0")
    stiffnesses = _stiffnesses(scene)
    lengths = _lengths(scene, growing, stiffnesses)
    relevant = [
        row
        for row in measured_errors()
        if row.output in needed and row.stiffness in stiffnesses and row.length in lengths
    ]
    maximum = MAX_TIME_LAPSE if growing else 1.0
    cases = {(row.length, row.stiffness, row.output) for row in relevant if row.length is not None}
    rated = []
    for fidelity in dict.fromkeys(row.fidelity for row in measured_errors() if row.fidelity.time_lapse <= maximum):
        try:
            stable = fidelity.time_step <= fidelity.simulated_method.stable_step(scene, fidelity.nodes_per_pitch)
        except ValueError:  # the contact stiffness needs more modes than a superelement supports
            continue
        rows = [row for row in relevant if row.fidelity in (fidelity, fidelity.model_copy(update={"time_lapse": 1.0}))]
        # measured in all cases; with time-lapse also in insertions
        complete = cases <= {(row.length, row.stiffness, row.output) for row in rows}
        inserted = any(row.length is None and row.fidelity == fidelity for row in rows)
        if stable and complete and (fidelity.time_lapse == 1.0 or inserted):
            error, cost = max(row.error for row in rows), max(row.cost for row in rows)
            rated.append((error, cost / fidelity.time_lapse, fidelity))
    within = [entry for entry in rated if entry[0] <= tolerance]
    if not within:
        minimum = min(rated, default=None)
        best = (
            f"the least error is {minimum[0]:.2g} ({summary_text(minimum[2])})"
            if minimum
            else "no errors were measured"
        )
        raise ValueError(f"tolerance = {tolerance:g} is not met by any settings for this scene: {best}")
    error, cost, chosen = min(within, key=lambda entry: (entry[1], entry[0]))
    reason = (
        f"{summary_text(chosen)}: measured error of {', '.join(needed)} at most {error:.2g} (tolerance {tolerance:g}),"
        f" the cheapest of {len(within)} of {len(rated)} settings"
    )
    LOGGER.info("fidelity auto: %s", reason)
    return FidelityChoice(chosen, error, cost, reason)


def _stiffnesses(scene: Scene) -> list[float]:
    """Measured contact stiffnesses to use: one within the factor ``NEAR`` of the scene's, or the two around it."""
    measured = sorted({row.stiffness for row in measured_errors()})
    stiffness = scene.contact.stiffness
    near = [value for value in measured if max(value / stiffness, stiffness / value) <= NEAR]
    if not near and not measured[0] <= stiffness <= measured[-1]:
        raise ValueError(
            f"contact.stiffness = {stiffness:g} is outside the measured range {measured[0]:g} to {measured[-1]:g}"
        )
    return near or _around(measured, stiffness)


def _lengths(scene: Scene, growing: bool, stiffnesses: Sequence[float]) -> list[float | None]:
    """Carrier lengths measured at all these stiffnesses; of a growing probe all up to its end, and None (insertion)."""
    lengths = [{row.length for row in measured_errors() if row.stiffness == value} - {None} for value in stiffnesses]
    measured = sorted(value for value in set.intersection(*lengths) if value is not None)
    if growing:
        end = scene.tube.helix_length - scene.probe.guide_length
        return [*(value for value in measured if value <= _around(measured, end)[-1]), None]
    return list(_around(measured, scene.carrier_length))


def _around(measured: Sequence[float], value: float) -> list[float]:
    """The measured values around a value, or the nearest one if it is equal or beyond the ends."""
    value = min(max(value, measured[0]), measured[-1])
    return sorted({max(v for v in measured if v <= value), min(v for v in measured if v >= value)})
