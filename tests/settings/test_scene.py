"""Scenes: defaults of table 2, TOML in and out, and errors that name field, value and range."""

import math
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from pydantic import ValidationError

from probe_env import Plant, Scene, TaskConfig, Terms
from probe_env.physics.model.chain import build_chain

SCENES = sorted((Path(__file__).parents[2] / "configs" / "scenes").glob("*.toml"))


def test_defaults_are_table_2():
    scene = Scene()
    assert scene.inserted_length == 52.5
    chain = build_chain(scene)
    assert chain.node_count == 2101
    assert chain.mass == pytest.approx(0.111 * 0.025)
    assert chain.inertia == pytest.approx(chain.mass * (0.025**2 / 12 + 0.00835**2 / 16))
    assert math.asin(chain.sin_phi) == pytest.approx(math.asin(0.1 / (4 * 1.2)))
    assert (chain.contact_stiffness > 0).sum() == 526  # every fourth node from the tip, tip and root included
    assert chain.contact_stiffness[0] == chain.contact_stiffness[100] == 1e5
    assert chain.contact_stiffness[1] == 0.0


def test_the_whole_model_has_every_term_and_keeps_the_rest():
    scene = Scene(carrier_length=10.0, contact={"friction": 0.2}, air={"density": 1.2})
    changed = {"couple": "tangent", "contact": {"weight": True}, "air": {"compressible": True}}
    changed["terms"] = dict.fromkeys(Terms.model_fields, True)
    assert scene.whole() == scene.model_copy(update=changed)


def test_tasks_and_plants_default_to_the_whole_model():
    assert TaskConfig().scene == Scene().whole()
    assert Plant().scene == Plant(assumptions="study").scene.whole()
    changed = {"carrier_length": 10.0, "contact": {"friction": 0.2, "weight": False}}
    assert TaskConfig(scene=changed).scene == Scene().whole().model_copy(update=changed)
    for stored in (Scene(carrier_length=10.0), Scene(carrier_length=10.0).whole()):  # with all fields: as stored
        assert TaskConfig(scene=stored.model_dump()).scene == TaskConfig(scene=stored).scene == stored
    before_terms = Scene().model_dump(exclude={"terms"})
    assert TaskConfig(scene=before_terms).scene == Scene()


def test_guide_floats_reach_up_to_the_sensor():
    chain = build_chain(Scene(probe={"guide_float_diameter": 0.02, "carrier_float_diameter": 0.016}))
    assert chain.lever[0] == chain.lever[100] == 0.01
    assert chain.lever[104] == 0.008
    assert chain.outer_gap[100] == pytest.approx(4.2e-3)
    assert chain.outer_gap[104] == pytest.approx(8.2e-3)
    assert np.isinf(build_chain(Scene(contact={"walls": "inner"})).outer_gap).all()


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_every_shipped_scene_is_valid_and_equal_after_toml(path, tmp_path):
    scene = Scene.from_toml(path)
    scene.to_toml(tmp_path / "copy.toml")
    assert Scene.from_toml(tmp_path / "copy.toml") == scene


BROKEN = [
    ({"feed_sped": 0.2}, "feed_sped", "there is no such field"),
    ({"contact": {"stiffness": 1e9}}, "contact.stiffness", "100 to 1e+08 N/m"),
    ({"contact": {"walls": "outer"}}, "contact.walls", "'both' or 'inner'"),
    ({"feed_speed": -2.1}, "feed_speed", "-2 to 2 m/s"),
    ({"feed_speed": "0.2"}, "feed_speed", "valid number"),
    ({"probe": {"tensile_rigidity": math.inf}}, "probe.tensile_rigidity", "inf"),
    (
        {"probe": {"guide_float_diameter": 0.0242}},
        "probe.guide_float_diameter = 0.0242",
        "tube.inner_diameter = 0.0242",
    ),
    (
        {"probe": {"carrier_float_diameter": 0.008}},
        "probe.carrier_float_diameter = 0.008",
        "probe.cable_diameter = 0.00835",
    ),
    ({"probe": {"guide_length": 70.0}}, "carrier_length + probe.guide_length = 50 + 70", "tube.helix_length = 60"),
    ({"probe": {"guide_length": 2.55}}, "probe.guide_length = 2.55", "multiple of probe.float_pitch = 0.1"),
    ({"carrier_length": 50.05}, "carrier_length = 50.05", "multiple of probe.float_pitch"),
    ({"carrier_length": 0.0}, "carrier_length = 0", "at least one probe.float_pitch"),
    ({"carrier_length": 57.6}, "57.6 + 2.5", "tube.helix_length = 60"),
    (
        {"tube": {"helix_diameter": 0.3}, "probe": {"float_pitch": 0.5}},
        "probe.float_pitch = 0.5",
        "tube.helix_diameter",
    ),
]


def test_broken_scenes_name_field_value_and_range(tmp_path):
    path = tmp_path / "broken.toml"
    for data, field, reason in BROKEN:
        path.write_text(tomli_w.dumps(data))
        with pytest.raises(ValueError, match=r"broken\.toml") as caught:
            Scene.from_toml(path)
        assert field in str(caught.value)
        assert reason in str(caught.value)


def test_copies_are_validated_and_keep_the_other_fields():
    scene = Scene(contact={"stiffness": 2e5})
    changed = scene.model_copy(update={"contact": {"friction": 0.2}, "feed_speed": 0.1})
    assert (changed.contact.stiffness, changed.contact.friction, changed.feed_speed) == (2e5, 0.2, 0.1)
    for wrong in ({"feed_speed": -3.0}, {"carrier_length": 59.0}):
        with pytest.raises(ValidationError):
            scene.model_copy(update=wrong)
    with pytest.raises(ValidationError):
        scene.feed_speed = 0.1  # frozen
