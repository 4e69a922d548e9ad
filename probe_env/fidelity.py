"""How closely an environment simulates: method, step, mesh and time-lapse under one name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from probe_env.scene import Model, quantity


class Fidelity(Model):
    """Settings of the simulator behind an environment; ``time_lapse`` needs a growing probe."""

    method: Literal["newmark", "wilson", "imex", "implicit", "explicit"] = "imex"
    time_step: Annotated[float, quantity(1e-7, 1e-2, "s")] = 2e-4
    nodes_per_pitch: Annotated[int, Field(ge=1, le=64)] = 4
    time_lapse: Annotated[float, quantity(1.0, 1000.0, "")] = 1.0


PRESETS: Final[dict[str, Fidelity]] = {
    "study": Fidelity(method="newmark", time_step=1e-4),
    "standard": Fidelity(),
    "fast": Fidelity(time_lapse=4.0),
}


def resolve_fidelity(fidelity: str | Fidelity | Mapping[str, Any]) -> Fidelity:
    """A preset by name, or settings of one's own.

    Raises:
        ValueError: no such preset, or settings that are not valid.
    """
    if isinstance(fidelity, Fidelity):
        return fidelity
    if isinstance(fidelity, str):
        if fidelity not in PRESETS:
            raise ValueError(f"fidelity = {fidelity!r} is not one of {', '.join(PRESETS)}, nor a mapping of settings")
        return PRESETS[fidelity]
    return Fidelity.model_validate(dict(fidelity))
