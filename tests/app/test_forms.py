"""What is typed and dragged: every field of the models is there, files stay what they are, errors are the command's."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from agents.app.forms.expected import expected
from agents.app.forms.fields import plant_fields, text_of, value_of
from agents.app.forms.overlays import line_of, line_of_log, overlay_names
from agents.app.forms.points import AIR, FEED, LENGTH, MISSING, csv_of, points_of, schedule_of, tidied, with_point
from agents.app.forms.tubes import TubeForm, field_named
from agents.cli import main
from agents.policies.catalogue import DATA
from agents.policies.places import place_at
from agents.studies.shipped.best_schedules import MapCost
from probe_env import Plant
from probe_env.envs.task import TaskConfig
from probe_env.schedule import Schedule

EXAMPLE = Path("configs/tubes/example.toml")
ALL = [field for fields in plant_fields().values() for field in fields]


def test_the_form_has_every_field_of_the_file_with_its_unit_and_range():
    for table, name in (("tube", "helix_length"), ("probe", "float_pitch"), ("air", "air_lag"), ("task", "time_limit")):
        field = field_named(f"{table}.{name}")
        low, high = map(float, field.accepted.split()[0:3:2])
        for value, fits in ((low, True), (high, True), (1.01 * high, False)):
            form = TubeForm()
            try:
                form.change(field, repr(value))
                refused = ""
            except ValueError as error:
                refused = str(error)
            assert f"{value!r} {field.unit} is outside the accepted range" not in refused or not fits
            assert fits or f"range {field.accepted}" in refused
    assert {field.path for field in ALL if field.table != "task"} == {
        f"{table}.{name}"
        for table, info in Plant.model_fields.items() if hasattr(info.annotation, "model_fields")
        for name in info.annotation.model_fields
    }  # fmt: skip
    assert all(field.what for field in ALL if field.table != "task")


@pytest.mark.parametrize("field", ALL, ids=lambda field: field.path)
def test_a_default_can_be_typed_and_changes_nothing(field):
    """Defaults are shown in few digits, which stand for what they are, within these digits."""
    form = TubeForm()
    if field.default:
        form.change(field, field.default)
        assert set(form.given) == {field.table}
        configured, usual = form.plant.configured(), Plant().configured()
        numbers = [name for name, value in usual if isinstance(value, int | float | tuple)]
        assert len(numbers) > 20
        for name in numbers:
            assert getattr(configured, name) == pytest.approx(getattr(usual, name), rel=1e-3)
    form.change(field, "")
    assert form.given == {}


@pytest.mark.parametrize(
    ("path", "text", "value"),
    [
        ("contact.friction", "0.12 to 0.22", {"low": 0.12, "high": 0.22}),
        ("contact.friction", "0.15 ± 0.02", {"mean": 0.15, "std": 0.02}),
        ("contact.friction", "0.15 +- 0.02", {"mean": 0.15, "std": 0.02}),
        ("contact.friction", "0.15", 0.15),
        ("tube.helix_diameter", "1, 1.3,1.6", [1.0, 1.3, 1.6]),
        ("feed.feed_speeds", "0.03 to 0.35", [0.03, 0.35]),
        ("feed.feed_speeds", "0.03, 0.35", [0.03, 0.35]),
        ("task.delay_periods", "2", 2),
        ("tube.helix_length", "long", "long"),
        ("contact.walls", "inner", "inner"),
        ("contact.cable", "yes", True),
        ("contact.cable", "no", False),
    ],
)
def test_a_text_is_what_a_file_would_say(path, text, value):
    assert value_of(field_named(path), text) == value
    assert value_of(field_named(path), text_of(value)) == value


def test_a_tube_that_was_changed_is_saved_as_the_file_that_the_command_reads(tmp_path):
    form = TubeForm()
    form.open(EXAMPLE)
    assert not form.changed
    assert form.kept(tmp_path) == EXAMPLE
    form.change(field_named("tube.helix_length"), "30")
    kept = form.kept(tmp_path)
    assert Plant.from_toml(kept) == form.plant
    assert form.kept(tmp_path) == kept  # the same tube, the same file
    form.save(tmp_path / "mine.toml")
    assert tomllib.loads((tmp_path / "mine.toml").read_text()) == tomllib.loads(EXAMPLE.read_text()) | {
        "tube": tomllib.loads(EXAMPLE.read_text())["tube"] | {"helix_length": 30.0}
    }
    form.open(EXAMPLE)
    with pytest.raises(ValueError, match="ships with the project"):
        form.save(EXAMPLE)


def test_a_refused_change_is_told_in_the_words_of_the_command_and_changes_nothing(tmp_path, capsys):
    form = TubeForm()
    form.open(EXAMPLE)
    before = form.given, form.plant
    with pytest.raises(ValueError, match="accepted range 0 to 1") as error:
        form.change(field_named("contact.friction"), "1.5")
    assert (form.given, form.plant) == before
    path = tmp_path / "bad.toml"
    path.write_text(EXAMPLE.read_text().replace("friction = { low = 0.12, high = 0.22 }", "friction = 1.5"))
    assert main(["evaluate", "pi", "--tube", str(path), "--output", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err == f"probe-env: error: {path}: {error.value}\n"


def test_points_are_a_schedule_file_and_come_back():
    schedule = Schedule.read("configs/schedules/example.csv")
    points = points_of(schedule)
    restored = schedule_of(points)
    assert points_of(restored) == points
    assert restored.position == schedule.position
    assert restored.feed_speed == schedule.feed_speed
    assert restored.air_supply_rate == pytest.approx(schedule.air_supply_rate, rel=1e-6)  # six digits
    assert csv_of(points).startswith("# interpolation: linear\n")


def test_points_are_tidied_after_a_drag():
    config = TaskConfig()
    given = {LENGTH: [20.0, 5.0, 12.5], FEED: [0.1, 9.0, MISSING], AIR: [100.0, float("nan"), 90.0]}
    tidy = tidied(given, config)
    assert tidy[LENGTH] == [5.0, 12.5, 20.0]
    assert tidy[FEED][1] == config.feed_speeds[1]  # half-way between 9 and 0.1 is more than the device gives
    assert tidy[AIR] == [90.0, 90.0, 100.0]
    assert np.diff(tidied({LENGTH: [5.0, 5.0], FEED: [0.1, 0.2], AIR: [60.0, 60.0]}, config)[LENGTH]).min() > 0.0
    more = with_point(tidy, config)
    assert more[LENGTH] == [5.0, 12.5, 20.0, 40.0]
    schedule_of(more)


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        (FEED, 9.0, "schedule: line 3, feed_speed_m_per_s = 9.0 is outside the accepted range 0 to 2 m/s"),
        (AIR, "much", "schedule: line 3, air_supply_m3_per_h = 'much' is not a number"),
        (LENGTH, -1.0, "schedule: line 3, inserted_length_m = -1.0 is outside the accepted range 0 to 1000 m"),
    ],
)
def test_points_that_are_no_schedule_are_refused_as_their_file_is(column, value, message):
    points = points_of(Schedule.read("configs/schedules/example.csv"))
    points[column][0] = value
    with pytest.raises(ValueError, match="line 3") as refused:
        schedule_of(points)
    assert str(refused.value) == message


def test_what_is_expected_is_what_the_search_for_schedules_goes_by():
    place, schedule = place_at(None, "test", 6), Schedule.read(DATA / "best-schedule.csv")
    prediction = expected(schedule, place)
    by_search = MapCost(place.contexts, place.config, place.vibration).reward(schedule)
    assert prediction.reward == pytest.approx(by_search, rel=1e-9)  # sums in another order
    assert (prediction.low < prediction.middle).all()
    assert (prediction.middle < prediction.high).all()
    assert prediction.length[0] == 5.5
    with pytest.raises(ValueError, match="goes by time"):
        expected(Schedule("time", "steps", (0.0,), (0.2,), (0.02,)), place)


@pytest.mark.parametrize("name", overlay_names())
def test_everything_that_is_offered_can_be_laid_over(name):
    place = place_at(EXAMPLE, "test", 1)
    line = line_of(name, place)
    assert len(line.length) == len(line.feed) == len(line.air) > 1
    assert np.isfinite(np.concatenate(line)).all()


def test_a_log_can_be_laid_over_and_what_feels_cannot():
    assert (np.diff(line_of_log(Path("example-rig")).length) >= 0.0).all()
    with pytest.raises(ValueError, match="decides by what it feels"):
        line_of("pi", place_at(None, "test", 1))
