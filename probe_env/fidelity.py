"""How closely an environment simulates: method, step, mesh and time-lapse under one name."""

from __future__ import annotations

from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from probe_env.scene import Model, quantity
from probe_env.stability import check_rounding


class Fidelity(Model):
    """Settings of the simulator behind an environment; ``time_lapse`` needs a growing probe."""

    method: Literal["newmark", "wilson", "imex", "imex32", "implicit", "explicit"] = "imex32"
    time_step: Annotated[float, quantity(1e-7, 1e-2, "s")] = 2e-4
    nodes_per_pitch: Annotated[int, Field(ge=1, le=64)] = 4
    time_lapse: Annotated[float, quantity(1.0, 1000.0, "")] = 1.0

    @model_validator(mode="after")
    def _step_is_above_rounding(self) -> Self:
        try:
            check_rounding(self.method, self.time_step)
        except ValueError as error:
            raise PydanticCustomError("rounding", "{text}", {"text": str(error)}) from error
        return self


PRESETS: Final[dict[str, Fidelity]] = {
    "study": Fidelity(method="newmark", time_step=1e-4),
    "reference": Fidelity(method="imex", time_step=5e-5),
    "standard": Fidelity(),
    "fast": Fidelity(time_lapse=4.0),
}
