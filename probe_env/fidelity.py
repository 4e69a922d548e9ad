"""How closely an environment simulates: presets, the choice that "auto" makes, and settings of method, step and mesh.

Time-lapse takes ringing for steady: metres are left out, and the motion has a fraction of the time in which the probe
passes them. Where the feed is fast or changing, the ringing is about to change, and a schedule looks better than it is;
``steady_feed`` limits time-lapse to slower, steady feeds.

"auto" goes by the errors that the accuracy study measured against the converged mesh with a fine step, each the largest
that a 95 % interval leaves room for: at constant lengths of 10, 30, 40 and 50 m with contact stiffnesses of 1e4, 1e5
and 1e6 N/m, and over whole insertions, where time-lapse comes in. They are errors in time and mesh; the error of the
model (walls, contact stiffness) is larger (docs/accuracy.md).
"""

from __future__ import annotations

import csv
import logging
import math
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib.resources import files
from typing import Annotated, Any, Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt
from pydantic import AfterValidator, Field, SerializerFunctionWrapHandler, model_serializer, model_validator
from pydantic_core import PydanticCustomError

from probe_env.arrays import FloatArray
from probe_env.physics.methods import METHODS, ON_NODES, check_step, names_of
from probe_env.physics.methods.method import Method
from probe_env.scene import Scene
from probe_env.settings import Model, in_one_line, quantity

SURROGATE: Final = "surrogate"
"""Method of the fidelity that predicts from a vibration map and simulates no motion."""
STEADY_CHANGE: Final = 0.05
"""[m/s] Largest change of the feed that counts as steady: it mistakes (time-lapse - 1) change^2 / (2 ramp) of the
length, 7.5 mm with a ramp of 0.5 m/s2 and a time-lapse of 4."""
ROUNDING: Final = 1e-6
"""[m/s] What an action's single precision may add to a feed."""
TOLERANCE: Final = 0.25
"""Relative error of "auto"."""
NEAR: Final = 2.0
"""A measured stiffness stands for those within this factor of it."""
MOST_TIME_LAPSE: Final = 4.0
"""Errors of time-lapse were measured at a steady feed; a controller at 8 already outran its vibration."""
AUTO: Final = re.compile(r"auto(?::(?P<tolerance>[^:]+))?")
ON_MESH: Final = {"superelement": "imex", "superelement32": "imex32"}
"""Replacements of superelements where the cable is more than elastic between floats, in the same precision."""
MESH_NODES, MESH_STEP = 8, 1.25e-4
"""Nodes a pitch, and longest step [s] there: all scenes drawn under pressure hold on them (simulation/return.md)."""
LOGGER: Final = logging.getLogger(__name__)


def _known(method: str) -> str:
    if method not in (*METHODS, SURROGATE):
        raise PydanticCustomError("method", "{text}", {"text": f"not one of {', '.join((*METHODS, SURROGATE))}"})
    return method


class Fidelity(Model):
    """Settings of the simulator behind an environment; ``time_lapse`` needs a growing probe, and is for the way in.

    With ``steady_feed`` only periods have time-lapse whose feed is no faster than that, and changes by no more than
    ``STEADY_CHANGE``. The method "surrogate" has no other settings.
    """

    method: Annotated[str, AfterValidator(_known)] = "superelement32"
    time_step: Annotated[float, quantity(1e-7, 1e-2, "s")] = 2e-4
    nodes_per_pitch: Annotated[int, Field(ge=1, le=64)] = 4
    time_lapse: Annotated[float, quantity(1.0, 1000.0, "")] = 1.0
    steady_feed: Annotated[float, quantity(1e-3, 2.0, "m/s")] | None = None

    @model_validator(mode="after")
    def _fields_fit_together(self) -> Self:
        if self.steady_feed is not None and self.time_lapse == 1.0:
            raise PydanticCustomError("time_lapse", "steady_feed needs a time_lapse above 1 (here it is 1)")
        if self.simulates:
            try:
                check_step(METHODS[self.method], self.time_step)
            except ValueError as error:
                raise PydanticCustomError("rounding", "{text}", {"text": str(error)}) from error
            return self
        for name, info in type(self).model_fields.items():
            if name != "method" and getattr(self, name) != info.default:
                raise PydanticCustomError("surrogate", f"{name}: method = 'surrogate' simulates no motion and has none")
        return self

    @model_serializer(mode="wrap")
    def _without_absent_steady_feed(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Settings without ``steady_feed`` are written without it: stored rows are identified by their settings."""
        return {name: value for name, value in write(self).items() if name != "steady_feed" or value is not None}

    @property
    def simulates(self) -> bool:
        """Whether motion is simulated, rather than predicted from a vibration map."""
        return self.method != SURROGATE

    @property
    def numerics(self) -> tuple[Method, float, int]:
        """Method, time step [s] and nodes a pitch, as ``Simulator`` takes them."""
        return METHODS[self.method], self.time_step, self.nodes_per_pitch

    def time_lapse_of(self, feed_speed: npt.ArrayLike, target: npt.ArrayLike) -> FloatArray:
        """(N,) how many times faster than the motion's clock the length changes in a period on the way in.

        ``feed_speed`` (N,) is that at its beginning, ``target`` (N,) that of the period [m/s].
        """
        now, aim = np.asarray(feed_speed, dtype=float), np.asarray(target, dtype=float)
        if self.steady_feed is None:
            return np.full(aim.shape, self.time_lapse)
        steady = np.maximum(now, aim) <= self.steady_feed + ROUNDING
        steady &= np.abs(aim - now) <= STEADY_CHANGE + ROUNDING
        return np.where(steady, self.time_lapse, 1.0)


PRESETS: Final[dict[str, Fidelity]] = {
    "study": Fidelity(method="newmark", time_step=1e-4),
    "reference": Fidelity(method="superelement", time_step=5e-5),
    "standard": Fidelity(),
    "fast": Fidelity(time_lapse=4.0),
    SURROGATE: Fidelity(method=SURROGATE),
}
ALIASES: Final = {"map": SURROGATE}
"""Other accepted names of presets."""
BOTH_WAYS: Final[dict[str, Fidelity]] = {
    "standard": Fidelity(method="imex", time_step=1.25e-4, nodes_per_pitch=8),
    "fast": Fidelity(method="imex", time_lapse=4.0),
}
"""Presets of round trips: under pressure the cable meets the walls between its floats, which takes nodes there, and
displacements of 0.4 m, which take double precision. "fast" has four nodes a pitch, and time-lapse on the way in."""


def lapse_in_words(fidelity: Fidelity) -> str:
    """The time-lapse; empty where there is none."""
    if fidelity.time_lapse == 1.0:
        return ""
    steady = f" up to {fidelity.steady_feed:g} m/s" if fidelity.steady_feed is not None else ""
    return f"time-lapse {fidelity.time_lapse:g}{steady}"


def in_words(fidelity: Fidelity) -> str:
    """All settings, in a line."""
    if not fidelity.simulates:
        return fidelity.method
    mesh = f"{fidelity.nodes_per_pitch} nodes a pitch" if fidelity.nodes_per_pitch != 4 else ""
    return ", ".join(filter(None, (f"{fidelity.method} at {fidelity.time_step:g} s", mesh, lapse_in_words(fidelity))))


def resolve_fidelity(
    fidelity: str | Fidelity | Mapping[str, Any],
    scene: Scene | None = None,
    growing: bool = True,
    both_ways: bool = False,
) -> Fidelity:
    """The settings of a preset by name, of "auto" or "auto:TOLERANCE", or custom ones.

    Args:
        fidelity: name, settings, or a mapping of them.
        scene: that "auto" chooses for; where its cable meets the walls between floats, or its couple counts from the
            tangent, superelements give way to a mesh of nodes. Default: table 2's.
        growing: whether the probe is fed in, for "auto".
        both_ways: whether it is drawn back, too.

    Raises:
        ValueError: no such preset, settings that are not valid, a tolerance that nothing measured keeps, or a method
            that does not simulate the way back.
    """
    if both_ways:
        return _both_ways(fidelity)
    scene = scene or Scene()
    return _with_nodes(_named(fidelity, scene, growing), scene)


def _with_nodes(fidelity: Fidelity, scene: Scene) -> Fidelity:
    """The settings, with nodes between the floats if the scene needs some and they have none; logged once.

    Between floats, a superelement's cable bends and stretches, no more: where it meets the walls itself, or its couple
    counts from the tangent, the method of ``ON_MESH`` is taken with ``MESH_NODES`` a pitch, at the same time-lapse and
    the same step, or ``MESH_STEP``.
    """
    needs_nodes = scene.contact.cable or scene.couple == "tangent"
    if not needs_nodes or fidelity.method in ON_NODES or not fidelity.simulates:
        return fidelity
    step = min(fidelity.time_step, MESH_STEP)
    update = {"method": ON_MESH[fidelity.method], "nodes_per_pitch": MESH_NODES, "time_step": step}
    taken = fidelity.model_copy(update=update)
    _log_nodes(fidelity.method, in_words(taken))
    return taken


@lru_cache
def _log_nodes(method: str, taken: str) -> None:
    LOGGER.warning(
        "fidelity: %s has no nodes between floats, which contact.cable and couple = 'tangent' ask for: %s is taken",
        method, taken,
    )  # fmt: skip


def _named(fidelity: str | Fidelity | Mapping[str, Any], scene: Scene, growing: bool) -> Fidelity:
    """``resolve_fidelity`` for the way in, without the nodes that the scene may need."""
    if isinstance(fidelity, Fidelity):
        return fidelity
    if not isinstance(fidelity, str):
        with in_one_line():
            return Fidelity.model_validate(dict(fidelity))
    name = ALIASES.get(fidelity, fidelity)
    if name in PRESETS:
        return PRESETS[name]
    auto = AUTO.fullmatch(fidelity)
    if auto is None:
        known = ", ".join((*PRESETS, "auto", "auto:TOLERANCE"))
        raise ValueError(f"fidelity = {fidelity!r} is not one of {known}, nor a mapping of settings")
    try:
        tolerance = float(auto["tolerance"] or TOLERANCE)
    except ValueError:
        raise ValueError(
            f"fidelity = {fidelity!r}: {auto['tolerance']!r} is not a number; a tolerance is a relative error, such as"
            f" auto:{TOLERANCE:g}"
        ) from None
    return choose_fidelity(scene, tolerance, growing=growing).fidelity


def _both_ways(fidelity: str | Fidelity | Mapping[str, Any]) -> Fidelity:
    """``resolve_fidelity`` for a probe that is drawn back."""
    if isinstance(fidelity, str) and fidelity in BOTH_WAYS:
        return BOTH_WAYS[fidelity]
    known = ", ".join((*BOTH_WAYS, "study"))
    if isinstance(fidelity, str) and AUTO.fullmatch(fidelity):
        raise ValueError(f"fidelity = {fidelity!r}: nothing was measured on the way back; give one of {known}")
    chosen = _named(fidelity, Scene(), growing=True)
    if not (chosen.simulates and METHODS[chosen.method].draws_back):
        raise ValueError(
            f"fidelity = {fidelity!r}: {chosen.method} does not simulate the way back; give one of {known}, or settings"
            f" with one of {names_of(lambda method: method.draws_back)}"
        )
    return chosen


def is_surrogate(fidelity: str | Fidelity | Mapping[str, Any]) -> bool:
    """Whether a fidelity, as ``resolve_fidelity`` takes it, is that of the vibration map."""
    if isinstance(fidelity, str):
        return ALIASES.get(fidelity, fidelity) == SURROGATE
    return (fidelity.method if isinstance(fidelity, Fidelity) else fidelity.get("method")) == SURROGATE


class Measured(NamedTuple):
    """Error of one output for one setting; ``length`` is None for a whole insertion."""

    fidelity: Fidelity
    length: float | None
    stiffness: float
    output: str
    error: float
    cost: float


class Choice(NamedTuple):
    """A chosen setting and why; ``error`` bounds the worst of the outputs, ``cost`` is in s per pitch and second."""

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
    scene: Scene, tolerance: float = TOLERANCE, needed: Sequence[str] = ("radial_rms_m",), growing: bool = False
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
    places = {(row.length, row.stiffness, row.output) for row in relevant if row.length is not None}
    rated = []
    for fidelity in dict.fromkeys(row.fidelity for row in measured() if row.fidelity.time_lapse <= most):
        try:
            holds = fidelity.time_step <= METHODS[fidelity.method].stable_step(scene, fidelity.nodes_per_pitch)
        except ValueError:  # its contact asks for more modes than a superelement has room for
            continue
        own = [row for row in relevant if row.fidelity in (fidelity, fidelity.model_copy(update={"time_lapse": 1.0}))]
        # measured wherever any was; with time-lapse also in the insertions
        complete = places <= {(row.length, row.stiffness, row.output) for row in own}
        inserted = any(row.length is None and row.fidelity == fidelity for row in own)
        if holds and complete and (fidelity.time_lapse == 1.0 or inserted):
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


def _stiffnesses(scene: Scene) -> list[float]:
    """Measured contact stiffnesses to go by: one within ``NEAR`` of the scene's, or the two around it."""
    known = sorted({row.stiffness for row in measured()})
    stiffness = scene.contact.stiffness
    near = [value for value in known if max(value / stiffness, stiffness / value) <= NEAR]
    if not near and not known[0] <= stiffness <= known[-1]:
        raise ValueError(
            f"contact.stiffness = {stiffness:g} is outside what was measured, {known[0]:g} to {known[-1]:g}"
        )
    return near or _around(known, stiffness)


def _lengths(scene: Scene, growing: bool, stiffnesses: Sequence[float]) -> list[float | None]:
    """Carrier lengths measured with all these stiffnesses to go by.

    Of a growing probe all up to its end, and the insertions (None).
    """
    of = [{row.length for row in measured() if row.stiffness == value} - {None} for value in stiffnesses]
    known = sorted(value for value in set.intersection(*of) if value is not None)
    if growing:
        end = scene.tube.helix_length - scene.probe.guide_length
        return [*(value for value in known if value <= _around(known, end)[-1]), None]
    return list(_around(known, scene.carrier_length))


def _around(known: Sequence[float], value: float) -> list[float]:
    """The measured value itself or the two around it; beyond the ends the nearest."""
    value = min(max(value, known[0]), known[-1])
    return sorted({max(v for v in known if v <= value), min(v for v in known if v >= value)})
