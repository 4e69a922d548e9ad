"""Heads of stored tables: a quantity is what a scene or a simulator calls it, which is SI, or its name has the unit."""

import csv
import re
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import pandas as pd
import pytest

from agents.plant.prior import UNKNOWNS
from agents.policies.plc.law import Constants
from probe_env import Context, Design, Fidelity, Plant, Scene, Simulator
from probe_env.settings import Model

ROOT = Path(__file__).parents[2]
TABLES = sorted(
    path for folder in ("results", "probe_env", "agents") for path in (ROOT / folder).rglob("*")
    if path.suffix in (".csv", ".parquet") and "logs" not in path.parts
)  # fmt: skip
OF_A_QUANTITY = re.compile(r"_(high|low|mean|max|rank|ratio|error|share)$")
"""What of a quantity: a mean of a field keeps the field's name."""
QUANTITIES = frozenset({
    "length", "diameter", "speed", "rate", "stiffness", "time", "step", "tension", "pitch", "rigidity", "density",
    "pressure", "frequency", "force", "mass", "distance", "duration", "acceleration", "depth", "gap", "feed", "air",
})  # fmt: skip
"""Last words of names that have a dimension."""
PLAIN = frozenset({
    "time_low", "time_high",  # ends of an inspection time [s] in the front of the trade-off
    "time_error",  # relative
    "ns_per_node_step",  # begins with it
    "cost_tension",  # a cost by its cause: periods
    "misfit_root_tension",  # by its channel: a mean square of strays
})  # fmt: skip


def fields(model: type[Model]) -> Iterator[str]:
    """Of a model and of the models in it."""
    for name, field in model.model_fields.items():
        yield name
        for inner in (field.annotation, *get_args(field.annotation)):
            if isinstance(inner, type) and issubclass(inner, Model):
                yield from fields(inner)


MODELS = (Plant, Scene, Design, Context, Fidelity, Constants)
OWN = frozenset({*(name for model in MODELS for name in fields(model)), *UNKNOWNS})
STATES = frozenset(name for name, value in vars(Simulator).items() if isinstance(value, property))


def heads(path: Path) -> list[str]:
    if path.suffix == ".parquet":
        return list(pd.read_parquet(path).columns)
    with path.open(encoding="utf-8") as lines:
        return next(csv.reader(lines))


def lacks_its_unit(name: str) -> bool:
    quantity = OF_A_QUANTITY.sub("", name)
    return quantity.split("_")[-1] in QUANTITIES and not {name, quantity} & (OWN | STATES | PLAIN)


@pytest.mark.parametrize("folder", ["results", "probe_env", "agents"])
def test_every_quantity_is_a_field_or_names_its_unit(folder: str) -> None:
    tables = [path for path in TABLES if path.relative_to(ROOT).parts[0] == folder]
    assert tables
    assert [
        f"{path.relative_to(ROOT)}: {name}" for path in tables for name in heads(path) if lacks_its_unit(name)
    ] == []


def test_a_head_without_its_unit_is_seen() -> None:
    names = ("sensor_height_m", "sensor_depth", "feed_speed", "friction_mean", "travel_distance_mean")
    assert [name for name in names if lacks_its_unit(name)] == ["sensor_depth", "travel_distance_mean"]
