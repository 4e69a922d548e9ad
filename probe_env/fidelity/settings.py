"""Method, step, mesh and time-lapse, and the presets of them.

Time-lapse takes what rings for steady: metres are left out, and the motion has a fraction of the time in which the
probe passes them. Where the feed is fast, or on its way to another, the ringing is about to change, and a schedule
looks better than it is; ``steady_feed`` says up to which feed metres are left out at all.

Presets whose name ends in -v0 are those of the environments' version 0: four nodes a pitch, which ring too little.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, Self

import numpy as np
import numpy.typing as npt
from pydantic import AfterValidator, Field, SerializerFunctionWrapHandler, model_serializer, model_validator
from pydantic_core import PydanticCustomError

from probe_env.arrays import FloatArray
from probe_env.physics.methods import METHODS, method_named
from probe_env.settings import Model, quantity

STEADY_CHANGE: Final = 0.05
"""[m/s] Change of the feed that is steady still: it mistakes (time-lapse - 1) change^2 / (2 ramp) of the length, 7.5 mm
with a ramp of 0.5 m/s2 and a time-lapse of 4."""
ROUNDING: Final = 1e-6
"""[m/s] What an action's single precision may add to a feed."""


def _known(method: str) -> str:
    try:
        return method_named(method).name
    except ValueError as error:
        raise PydanticCustomError("method", "{text}", {"text": f"not one of {', '.join(METHODS)}"}) from error


class Fidelity(Model):
    """Settings of the simulator behind an environment; ``time_lapse`` needs a growing probe, and is for the way in.

    With ``steady_feed`` only periods have time-lapse whose feed is no faster than that, and changes by no more than
    ``STEADY_CHANGE``.
    """

    method: Annotated[str, AfterValidator(_known)] = "superelement32"
    time_step: Annotated[float, quantity(1e-7, 1e-2, "s")] = 2e-4
    nodes_per_pitch: Annotated[int, Field(ge=1, le=64)] = 4
    time_lapse: Annotated[float, quantity(1.0, 1000.0, "")] = 1.0
    steady_feed: Annotated[float, quantity(1e-3, 2.0, "m/s")] | None = None

    @model_validator(mode="after")
    def _step_is_above_rounding(self) -> Self:
        try:
            METHODS[self.method].check_step(self.time_step)
        except ValueError as error:
            raise PydanticCustomError("rounding", "{text}", {"text": str(error)}) from error
        return self

    @model_validator(mode="after")
    def _has_time_lapse_to_limit(self) -> Self:
        if self.steady_feed is not None and self.time_lapse == 1.0:
            raise PydanticCustomError("time_lapse", "steady_feed needs a time_lapse above 1 (here it is 1)")
        return self

    @model_serializer(mode="wrap")
    def _as_before(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Settings without ``steady_feed`` are written as before there was one: stores know their rows by them."""
        return {name: value for name, value in write(self).items() if name != "steady_feed" or value is not None}

    def time_lapse_of(self, feed_speed: npt.ArrayLike, target: npt.ArrayLike) -> FloatArray:
        """How many times faster than the motion's clock the length changes in a period on the way in.

        Args:
            feed_speed: (N,) at its beginning [m/s].
            target: (N,) of the period [m/s].

        Returns:
            (N,), 1 or more.
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
    "fast-steady": Fidelity(time_lapse=4.0, steady_feed=0.2),
    "reference-v0": Fidelity(method="imex", time_step=5e-5),
    "standard-v0": Fidelity(method="imex32"),
    "fast-v0": Fidelity(method="imex32", time_lapse=4.0),
}
BOTH_WAYS: Final[dict[str, Fidelity]] = {
    "standard": Fidelity(method="imex", time_step=1.25e-4, nodes_per_pitch=8),
    "unlapsed": Fidelity(method="imex"),
    "fast": Fidelity(method="imex", time_lapse=4.0),
}
"""What presets are where the probe is drawn back, too: the cable then meets the walls between its floats, which takes
nodes there, and displacements of 0.4 m, which take double precision. "fast" has four nodes a pitch, and time-lapse on
the way in; "unlapsed" has none on either way."""


def lapse_in_words(fidelity: Fidelity) -> str:
    """The time-lapse; empty where there is none."""
    if fidelity.time_lapse == 1.0:
        return ""
    steady = f" up to {fidelity.steady_feed:g} m/s" if fidelity.steady_feed is not None else ""
    return f"time-lapse {fidelity.time_lapse:g}{steady}"


def in_words(fidelity: Fidelity) -> str:
    """All settings, in a line."""
    mesh = f"{fidelity.nodes_per_pitch} nodes a pitch" if fidelity.nodes_per_pitch != 4 else ""
    return ", ".join(filter(None, (f"{fidelity.method} at {fidelity.time_step:g} s", mesh, lapse_in_words(fidelity))))
