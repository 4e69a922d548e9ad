"""Contexts: friction, contact stiffness, drag and helix diameter of a tube. Controllers observe the diameter only.

The study names no list of helix diameters; six from 1.0 to 2.5 m represent the tubes of one heat exchanger. Fixed lists
of contexts for training, validation and test ship in ``data/contexts.csv``. Every prefix of a list is balanced over
helix diameters and spread over friction. The script that made the file is in the history, at commit 8c1cf8d.
"""

import csv
import hashlib
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self, get_args

import numpy as np
from pydantic import Field, ValidationError, model_validator

from probe_env.scene import Scene
from probe_env.settings import Model, explain, quantity

Split = Literal["train", "validation", "test"]
Values = float | Annotated[tuple[float, ...], Field(min_length=1, max_length=1000)]
SPLIT_SIZES: Final[dict[Split, int]] = {"train": 96, "validation": 24, "test": 48}
HELIX_DIAMETERS: Final = (1.0, 1.2, 1.4, 1.7, 2.0, 2.5)  # [m]
FRICTION: Final = (0.10, 0.25)
STIFFNESS: Final = (0.7e5, 1.4e5)  # [N/m]
DRAG_FACTOR: Final = (0.9, 1.1)
FILE: Final = Path(__file__).parents[1] / "data" / "contexts.csv"
FILE_HASH: Final = "909d5a5f69dcc121"


class Context(Model):
    """Properties of one tube that differ between episodes."""

    friction: Annotated[float, quantity(0.0, 1.0, "")] = 0.15
    contact_stiffness: Annotated[float, quantity(1e2, 1e8, "N/m")] = 1e5
    drag_factor: Annotated[float, quantity(0.1, 10.0, "")] = 1.0
    helix_diameter: Annotated[float, quantity(0.3, 1e4, "m")] = 1.2

    def apply(self, scene: Scene) -> Scene:
        """The scene in this context."""
        return scene.model_copy(
            update={
                "tube": {"helix_diameter": self.helix_diameter},
                "contact": {"friction": self.friction, "stiffness": self.contact_stiffness},
                "air": {"drag_coefficient": scene.air.drag_coefficient * self.drag_factor},
            }
        )


class Ranges(Model):
    """Distribution of random contexts: a number, a range (low, high), or a list of three or more values."""

    friction: Values = FRICTION
    contact_stiffness: Values = STIFFNESS
    drag_factor: Values = DRAG_FACTOR
    helix_diameter: Values = HELIX_DIAMETERS

    @model_validator(mode="after")
    def _all_are_contexts(self) -> Self:
        for name in Context.model_fields:
            values = _values(getattr(self, name))
            if len(values) == 2 and values[0] > values[1]:
                raise ValueError(f"{name} = {list(values)} must ascend")
            for value in values:
                try:
                    Context.model_validate({name: value})
                except ValidationError as error:
                    raise ValueError(explain(error)) from error
        return self

    @property
    def stiffest(self) -> float:
        """Largest contact stiffness in the ranges [N/m]."""
        return max(_values(self.contact_stiffness))


def _values(values: Values) -> tuple[float, ...]:
    return values if isinstance(values, tuple) else (values,)


def draw_context(
    rng: np.random.Generator, fixed: dict[str, Any] | None = None, ranges: Ranges | None = None
) -> Context:
    """A random context; ``fixed`` sets fields by name and does not change the random numbers of the others."""
    ranges, sample = ranges or Ranges(), {}
    for name in Context.model_fields:
        values = _values(getattr(ranges, name))
        sample[name] = float(rng.choice(values) if len(values) > 2 else rng.uniform(values[0], values[-1]))
    return Context.model_validate(sample | (fixed or {}))


@lru_cache
def load_contexts(split: Split) -> tuple[Context, ...]:
    """A shipped list of contexts."""
    if split not in get_args(Split):
        raise ValueError(f"split = {split!r} is not one of {', '.join(get_args(Split))}")
    text = FILE.read_text()
    if hashlib.sha256(text.encode()).hexdigest()[:16] != FILE_HASH:
        raise ValueError(f"{FILE.name} was changed: results would not be comparable; its hash must be {FILE_HASH}")
    names = tuple(Context.model_fields)
    return tuple(
        Context.model_validate({name: float(row[name]) for name in names})
        for row in csv.DictReader(text.splitlines())
        if row["split"] == split
    )


def spread_contexts(split: Split, limit: int = 0) -> tuple[Context, ...]:
    """The first ``limit`` contexts of a shipped list; 0: all. The index of a context does not depend on the limit."""
    listed = load_contexts(split)
    if not 0 <= limit <= len(listed):
        raise ValueError(f"limit = {limit!r} is outside the accepted range 0 (all) to {len(listed)}")
    return listed[: limit or None]
