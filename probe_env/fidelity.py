"""How closely an environment simulates: method, step, mesh and time-lapse under one name."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field

from probe_env.scene import Model, quantity


class Fidelity(Model):
    """Settings of the simulator behind an environment; ``time_lapse`` needs a growing probe."""

    method: Literal["newmark", "wilson", "imex", "imex32", "implicit", "explicit"] = "imex32"
    time_step: Annotated[float, quantity(1e-7, 1e-2, "s")] = 2e-4
    nodes_per_pitch: Annotated[int, Field(ge=1, le=64)] = 4
    time_lapse: Annotated[float, quantity(1.0, 1000.0, "")] = 1.0


PRESETS: Final[dict[str, Fidelity]] = {
    "study": Fidelity(method="newmark", time_step=1e-4),
    "reference": Fidelity(method="imex", time_step=5e-5),
    "standard": Fidelity(),
    "fast": Fidelity(time_lapse=4.0),
}
