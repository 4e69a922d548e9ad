"""What a calibration found of a plant: joint draws of friction and the rest, read from ``calibration.json``."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Self

import numpy as np
from pydantic import Field, FiniteFloat, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from probe_env.arrays import FloatArray
from probe_env.envs.plants.tables import DRAG, FRICTION, STIFFNESS
from probe_env.files import MEBI, FileError, read_bytes
from probe_env.settings import Model, explain, tuples, within

MOST_FILE: Final = 16 * MEBI
MOST_DRAWS: Final = 4096
Draws = Annotated[tuple[FiniteFloat, ...], Field(min_length=1, max_length=MOST_DRAWS)]


class Posterior(Model):
    """Equally likely draws; the k-th of all belong together."""

    friction: Draws | None = None
    """[-]."""
    contact_stiffness: Draws | None = None
    """[N/m]."""
    drag_coefficient: Draws | None = None
    """[-]."""
    damping_time: Draws | None = None
    """[s]."""

    @model_validator(mode="after")
    def _belong_together(self) -> Self:
        counts = {len(draws) for draws in self.draws.values()}
        if len(counts) != 1:
            raise PydanticCustomError("draws", "must be as many draws of each quantity, and of one at least")
        return self

    @property
    def draws(self) -> dict[str, FloatArray]:
        """What it tells of, (n,) each."""
        listed = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: np.array(values) for name, values in listed.items() if values is not None}

    @classmethod
    def read(cls, path: Path) -> Self:
        """The draws of a calibration.

        Raises:
            FileNotFoundError: no such file.
            FileError: not a calibration.
        """
        try:
            content = json.loads(read_bytes(path, MOST_FILE))
        except (ValueError, RecursionError) as error:
            if isinstance(error, FileError):
                raise
            raise FileError(path, f"not JSON: {error}") from error
        draws = content.get("draws") if isinstance(content, dict) else None
        if not isinstance(draws, dict):
            raise FileError(path, "draws: missing, so it is not a calibration (probe-env calibrate writes one)")
        if content.get("misspecified") is True:
            warnings.warn(
                f"{path}: the calibration is misspecified: the model cannot have made its logs, whatever friction, and"
                " what is computed with its figures means nothing",
                stacklevel=5,
            )
        try:
            return cls.model_validate(tuples(draws))
        except ValidationError as error:
            raise FileError(path, explain(error, "draws")) from error

    def rows(self, shares: FloatArray) -> dict[str, FloatArray]:
        """Draws (n,) at shares (n,) in (0, 1) of their order by the first quantity; those of a row belong together."""
        draws = self.draws
        order = np.argsort(next(iter(draws.values())), kind="stable")
        rows = order[np.minimum((np.asarray(shares) * len(order)).astype(int), len(order) - 1)]
        return {name: values[rows] for name, values in draws.items()}

    def middle(self, name: str) -> float:
        """Median of a quantity."""
        return float(np.median(self.draws[name]))


def check_draws(posterior: Posterior | None, file: Path | None = None) -> None:
    """Raise ValueError, with a file FileError, if draws are not values that the plant's own fields accept."""
    ranges = {"friction": FRICTION, "contact_stiffness": STIFFNESS, "drag_coefficient": DRAG}
    for name, draws in posterior.draws.items() if posterior else ():
        low, high = ranges.get(name, (0.0, 1.0))
        for value in (draws.min(), draws.max()):
            try:
                within(f"draws.{name}" if file else f"posterior.draws.{name}", float(value), low, high, "")
            except ValueError as error:
                if file:
                    raise FileError(file, str(error)) from None
                raise PydanticCustomError("out_of_range", "{text}", {"text": str(error)}) from None


def with_posterior(given: Mapping[str, Any], folder: Path | None = None) -> dict[str, Any]:
    """A plant's tables with the draws that ``posterior = "calibration.json"`` names, relative to ``folder`` or here.

    Raises:
        FileNotFoundError, FileError: see ``Posterior.read``.
    """
    tables, named = dict(given), given.get("posterior")
    if isinstance(named, str | Path):
        path = (folder or Path()) / named
        tables["posterior"] = Posterior.read(path)
        check_draws(tables["posterior"], path)
    return tables
