"""Feedback law as a file: a schedule for each of several frictions, interpolated at the estimated friction.

A controller can store it as a table: helix diameter, friction and inserted length in, feed and air out.
"""

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from probe_agents.policies.fixed import FixedPolicy, gain
from probe_agents.policies.policy import Domain, RangesOfTubes, read_model
from probe_env import Scene
from probe_env.arrays import FloatArray
from probe_env.physics.closed_forms import MEASURED, friction_from_tension
from probe_env.schedule import AIR, FEED, RANGES
from probe_env.settings import Model

Row = Annotated[tuple[FiniteFloat, ...], Field(min_length=2, max_length=1000)]
Table = Annotated[tuple[Row, ...], Field(min_length=1, max_length=100)]


class OfDiameter(Model):
    """Feed and air for one helix diameter; one row per friction, one column per length."""

    helix_diameter: Annotated[FiniteFloat, Field(gt=0.0)]
    """[m]."""
    feed_speed: Table
    """[m/s]."""
    air_supply_rate: Table
    """[m3/s]."""


class Law(Model):
    """Tables of feed and air over friction, helix diameter and inserted length, SI units."""

    scene: Scene
    """Scene that it was made for."""
    ranges: RangesOfTubes
    """Smallest and largest value of the fields of ``Context`` that it was made for."""
    friction: Annotated[tuple[FiniteFloat, ...], Field(min_length=1, max_length=100)]
    inserted_length: Row
    """[m]."""
    tables: Annotated[tuple[OfDiameter, ...], Field(min_length=1, max_length=100)]

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        for name in ("friction", "inserted_length"):
            if not all(np.diff(getattr(self, name)) > 0.0):
                raise ValueError(f"{name} must ascend")
        shape = len(self.friction), len(self.inserted_length)
        for k, table in enumerate(self.tables):
            for name, column in (("feed_speed", FEED), ("air_supply_rate", AIR)):
                rows = getattr(table, name)
                if len(rows) != shape[0] or any(len(row) != shape[1] for row in rows):
                    text = f"tables.{k}.{name}: must have {shape[0]} rows (frictions) of {shape[1]} values (lengths)"
                    raise ValueError(text)
                low, high = RANGES[column][:2]
                high = high / 3600.0 if column == AIR else high
                if not all(low <= value <= high for row in rows for value in row):
                    text = f"tables.{k}.{name}: a value is outside the accepted range {low:g} to {high:g}"
                    raise ValueError(text)
        return self

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a law's file (JSON), see ``read_model``."""
        return read_model(path, cls, "JSON")

    def at(self, friction: FloatArray, length: FloatArray, diameter: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Feed speed [m/s] and air supply [m3/s] (n,), linear in friction and length, at the nearest diameter.

        Args:
            friction: (n,).
            length: (n,) inserted [m].
            diameter: (n,) of the helix [m].
        """
        diameters = np.array([table.helix_diameter for table in self.tables])
        targets = np.empty((2, len(friction)))
        for k, (mu, inserted, d) in enumerate(zip(friction, length, diameter, strict=True)):
            table = self.tables[int(np.abs(diameters - d).argmin())]
            for row, values in enumerate((table.feed_speed, table.air_supply_rate)):
                column = [np.interp(inserted, self.inserted_length, line) for line in values]
                targets[row, k] = np.interp(mu, self.friction, column)
        return targets[0], targets[1]


@dataclass
class LawPolicy(FixedPolicy):
    """Applies a law at the friction estimated from the root tension (closed form of steady sliding)."""

    law: Law = field(kw_only=True)
    average: float = 15.0
    """Time constant of the average of the friction [s]."""
    memory: ClassVar[int] = 1
    needs: ClassVar[tuple[str, ...]] = ("root_tension",)

    @property
    def domain(self) -> Domain:
        """Tubes that the law was made for."""
        tube = self.law.scene.tube
        return Domain(dict(self.law.ranges), tube.inner_diameter, tube.helix_length, self.law.scene.probe)

    def start(self, memory: FloatArray) -> None:
        """Memory: average of the friction."""
        memory[:, 0] = np.median(self.law.friction)

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Feed and air at the averaged friction."""
        friction = friction_from_tension({name: measured[name] for name in MEASURED}, self.config.scene)
        credible = np.clip(friction, self.law.friction[0], self.law.friction[-1])
        memory[:, 0] += gain(self.config, self.average) * (credible - memory[:, 0])
        return self.law.at(memory[:, 0], measured["inserted_length"], measured["helix_diameter"])

    def describe(self) -> dict[str, Any]:
        """With a hash of the law."""
        digest = hashlib.sha256(self.law.model_dump_json().encode()).hexdigest()[:16]
        return {"policy": type(self).__name__, "law": digest, "average": self.average}
