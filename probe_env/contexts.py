"""What a controller is not told: friction, contact stiffness and drag of a tube, and its helix diameter.

The study names no list of helix diameters; six from 1.0 to 2.5 m stand for the tubes of one heat exchanger.
Fixed lists of contexts for training, validation and test ship in ``data/contexts.csv``.
"""

from __future__ import annotations

import csv
import hashlib
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args

import numpy as np

from probe_env.scene import Model, Scene, quantity

Split = Literal["train", "validation", "test"]
SPLIT_SIZES: Final[dict[Split, int]] = {"train": 96, "validation": 24, "test": 48}
HELIX_DIAMETERS: Final = (1.0, 1.2, 1.4, 1.7, 2.0, 2.5)  # [m]
FRICTION: Final = (0.10, 0.25)
STIFFNESS: Final = (0.7e5, 1.4e5)  # [N/m]
DRAG_FACTOR: Final = (0.9, 1.1)
FILE: Final = Path(__file__).parent / "data" / "contexts.csv"
FILE_HASH: Final = "234699da193f1de7"


class Context(Model):
    """One tube with one probe in it: what differs between episodes."""

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


def draw_context(rng: np.random.Generator, fixed: dict[str, Any] | None = None) -> Context:
    """A random context; ``fixed`` sets fields by name, and drawing goes on alike whatever is fixed.

    Raises:
        ValueError: an unknown field or a value out of range (pydantic's ValidationError).
    """
    drawn = {
        "friction": float(rng.uniform(*FRICTION)),
        "contact_stiffness": float(rng.uniform(*STIFFNESS)),
        "drag_factor": float(rng.uniform(*DRAG_FACTOR)),
        "helix_diameter": float(rng.choice(HELIX_DIAMETERS)),
    }
    return Context.model_validate(drawn | (fixed or {}))


@lru_cache
def load_contexts(split: Split) -> tuple[Context, ...]:
    """A shipped list of contexts.

    Raises:
        ValueError: no such split, or the file is not the one that this version ships.
    """
    if split not in get_args(Split):
        raise ValueError(f"split = {split!r} is not one of {', '.join(get_args(Split))}")
    text = FILE.read_text()
    if hashlib.sha256(text.encode()).hexdigest()[:16] != FILE_HASH:
        raise ValueError(f"{FILE.name} was changed, so results would not compare; its hash must be {FILE_HASH}")
    names = tuple(Context.model_fields)
    return tuple(
        Context.model_validate({name: float(row[name]) for name in names})
        for row in csv.DictReader(text.splitlines())
        if row["split"] == split
    )


def spread_contexts(split: Split, limit: int) -> tuple[Context, ...]:
    """So many contexts of a shipped list, evenly spread; 0: all.

    Raises:
        ValueError: no such split, or more than there are.
    """
    listed = load_contexts(split)
    if not 0 <= limit <= len(listed):
        raise ValueError(f"limit = {limit!r} is outside the accepted range 0 (all) to {len(listed)}")
    return tuple(listed[k * len(listed) // limit] for k in range(limit)) if limit else listed


def make_file() -> str:
    """The text of the shipped file: helix diameters in turn, the rest drawn, rounded to what is written."""
    lines = ["split,friction,contact_stiffness,drag_factor,helix_diameter"]
    for number, (split, size) in enumerate(SPLIT_SIZES.items()):
        rng = np.random.default_rng([2026, number])
        for k in range(size):
            c = draw_context(rng, {"helix_diameter": HELIX_DIAMETERS[k % len(HELIX_DIAMETERS)]})
            stiffness = round(c.contact_stiffness, -2)
            lines.append(f"{split},{c.friction:.4f},{stiffness:.0f},{c.drag_factor:.4f},{c.helix_diameter}")
    return "\n".join(lines) + "\n"
