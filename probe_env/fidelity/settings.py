"""Method, step, mesh and time-lapse, and the presets of them.

Presets whose name ends in -v0 are those of the environments' version 0: four nodes a pitch, which ring too little.
"""

from __future__ import annotations

from typing import Annotated, Final, Self

from pydantic import AfterValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from probe_env.physics.methods import METHODS, method_named
from probe_env.settings import Model, quantity


def _known(method: str) -> str:
    try:
        return method_named(method).name
    except ValueError as error:
        raise PydanticCustomError("method", "{text}", {"text": f"not one of {', '.join(METHODS)}"}) from error


class Fidelity(Model):
    """Settings of the simulator behind an environment; ``time_lapse`` needs a growing probe, and is for the way in."""

    method: Annotated[str, AfterValidator(_known)] = "superelement32"
    time_step: Annotated[float, quantity(1e-7, 1e-2, "s")] = 2e-4
    nodes_per_pitch: Annotated[int, Field(ge=1, le=64)] = 4
    time_lapse: Annotated[float, quantity(1.0, 1000.0, "")] = 1.0

    @model_validator(mode="after")
    def _step_is_above_rounding(self) -> Self:
        try:
            METHODS[self.method].check_step(self.time_step)
        except ValueError as error:
            raise PydanticCustomError("rounding", "{text}", {"text": str(error)}) from error
        return self


PRESETS: Final[dict[str, Fidelity]] = {
    "study": Fidelity(method="newmark", time_step=1e-4),
    "reference": Fidelity(method="superelement", time_step=5e-5),
    "standard": Fidelity(),
    "fast": Fidelity(time_lapse=4.0),
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


def _words(fidelity: Fidelity) -> str:
    lapse = f", time-lapse {fidelity.time_lapse:g}" if fidelity.time_lapse > 1.0 else ""
    mesh = f", {fidelity.nodes_per_pitch} nodes a pitch" if fidelity.nodes_per_pitch != 4 else ""
    return f"{fidelity.method} at {fidelity.time_step:g} s{mesh}{lapse}"
