"""Ranges and units of fields are metadata, and errors tell the same ones."""

import math

import pytest
from pydantic import ValidationError

from probe_env import Context, Design, Fidelity, Plant, Scene, TaskConfig
from probe_env.inspection.sensor import Sensor
from probe_env.settings import Model, Range, explain, range_of


def fields(model):
    """Paths of all fields of a model and those of its sub-models."""
    for name, info in model.model_fields.items():
        if isinstance(info.annotation, type) and issubclass(info.annotation, Model):
            yield from (f"{name}.{inner}" for inner in info.annotation.model_fields)
        else:
            yield name


def test_errors_have_the_range_of_the_metadata():
    """NaN is out of every range: the error names range and unit."""
    count = 0
    for model in (Scene, TaskConfig, Plant, Context, Design, Fidelity, Sensor):
        for path in fields(model):
            accepted = range_of(model, path)
            if accepted is None or (model.model_fields.get(path, None) and model.model_fields[path].annotation is int):
                continue
            count += 1
            value = (math.nan, math.nan) if path.split(".")[-1] in ("feed_speeds", "air_supply_rates") else math.nan
            for part in reversed(path.split(".")):
                value = {part: value}
            with pytest.raises(ValidationError) as caught:
                model.model_validate(value)
            expected = f"accepted range {accepted.low:g} to {accepted.high:g} {accepted.unit}".strip()
            assert expected in explain(caught.value), (model, path)
    assert count >= 120


def test_ranges_are_found_by_path():
    assert range_of(Scene, "contact.stiffness") == Range(1e2, 1e8, "N/m")
    assert range_of(Fidelity, "steady_feed") == Range(1e-3, 2.0, "m/s")
    assert range_of(TaskConfig, "delay_periods") == Range(0, 100, "")
    assert range_of(Plant, "tube.helix_diameter") == Range(0.3, 50.0, "m")
    assert range_of(Scene, "contact.walls") is None
    with pytest.raises(KeyError):
        range_of(Scene, "contact.wall")
