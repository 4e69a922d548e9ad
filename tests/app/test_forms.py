"""Forms: every field of the models, files, schedules, predictions and overlays, with the errors of the commands."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from probe_agents.app import schedules
from probe_agents.app.forms import TubeForm, text_of, tube_fields, value_of
from probe_agents.app.schedules import AIR, FEED, LENGTH, MISSING
from probe_agents.cli import main
from probe_agents.policies.cases import load_case, read_case
from probe_agents.policies.catalogue import DATA
from probe_agents.records.shipped import file_or_shipped, shipped_names
from probe_agents.studies.searches import MapCost
from probe_env import Plant
from probe_env.envs.task.config import TaskConfig
from probe_env.files import FileError
from probe_env.schedule import Schedule

EXAMPLE = Path("configs/tubes/example.toml")
FIELDS = {field.path: field for fields in tube_fields().values() for field in fields}


def opened(file):
    form = TubeForm()
    form.open(file)
    return form


def test_form_has_every_field_with_unit_and_range():
    for path, unit in (("tube.helix_length", "m"), ("air.air_lag", "s"), ("task.period", "s")):
        form, field = TubeForm(), FIELDS[path]
        accepted = field.range
        assert accepted.unit == unit
        assert f"accepted: {accepted.low:g} to {accepted.high:g} {unit}" in field.hint
        for value in (accepted.low, accepted.high):
            try:
                form.change(field, repr(value))
            except ValueError as error:  # for another reason
                assert "outside the accepted range" not in str(error)  # noqa: PT017
        with pytest.raises(ValueError, match=f"accepted range {accepted.low:g} to {accepted.high:g} {unit}"):
            form.change(field, repr(1.01 * accepted.high))
    assert (FIELDS["air.air_ramp"].unit, FIELDS["air.air_ramp"].factor) == ("m³/h/s", 3600.0)
    assert all(field.description for field in FIELDS.values() if field.table != "task")
    models = {table: getattr(info.annotation, "model_fields", ()) for table, info in Plant.model_fields.items()}
    names = {f"{table}.{name}" for table, fields in models.items() for name in fields}
    assert {field.path for field in FIELDS.values() if field.table != "task"} == names


def test_a_default_can_be_typed_and_changes_nothing():
    """Defaults are shown with few digits."""
    usual = Plant().configured()
    numbers = [name for name, value in usual if isinstance(value, int | float | tuple)]
    assert len(numbers) > 20
    for field in FIELDS.values():
        form = TubeForm()
        if field.default:
            form.change(field, field.default)
            configured = form.plant.configured()
            assert set(form.tables) == {field.table}, field.path
            for name in numbers:
                assert getattr(configured, name) == pytest.approx(getattr(usual, name), rel=1e-3), field.path
        form.change(field, "")
        assert not form.tables, field.path


def test_the_value_of_a_text():
    for path, text, value in (
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
    ):
        assert value_of(FIELDS[path], text) == value, path
        assert value_of(FIELDS[path], text_of(value)) == value, path


def test_small_lengths_are_in_mm_and_air_is_in_m3_per_h():
    form = opened(EXAMPLE)
    for path, title, shown, typed, value in (
        ("tube.inner_diameter", "inner diameter [mm]", "23.0", "22.1", 0.0221),
        ("tube.helix_length", "helix length [m]", "45.0", "30", 30.0),
        ("air.air_supply_rates", "air supply rates [m³/h]", "30.0, 122.0", "36 to 90", [0.01, 0.025]),
        ("air.air_supply_step", "air supply step [m³/h]", "5.0", "7.2", 0.002),
    ):
        field = FIELDS[path]
        assert (field.title, form.text(field)) == (title, shown)
        form.change(field, typed)
        assert form.tables[field.table][field.name] == value
    assert "accepted: 5 to 100 mm" in FIELDS["tube.inner_diameter"].hint
    assert "accepted: 0 to 720 m³/h" in FIELDS["air.air_supply_rates"].hint
    assert FIELDS["air.air_supply_rates"].default == "30 to 130"


def test_a_changed_tube_is_saved_as_a_file_of_the_command(tmp_path):
    form = opened(EXAMPLE)
    assert not form.changed
    assert form.file_for_run(tmp_path) == EXAMPLE
    form.change(FIELDS["tube.helix_length"], "30")
    stored = form.file_for_run(tmp_path)
    assert Plant.from_toml(stored) == form.plant
    assert form.file_for_run(tmp_path) == stored  # the same tube, the same file
    form.save(Path("mine.toml"), tmp_path)  # not next to the opened file, which ships with the project
    example, saved = (tomllib.loads(file.read_text()) for file in (EXAMPLE, tmp_path / "mine.toml"))
    assert saved == example | {"tube": example["tube"] | {"helix_length": 30.0}}
    form.open(EXAMPLE)
    with pytest.raises(ValueError, match="ships with the project"):
        form.save(EXAMPLE, tmp_path)
    with pytest.raises(ValueError, match="invisible characters"):
        form.save(Path("a\nb.toml"), tmp_path)


def test_folders_in_which_a_tube_can_be_saved(tmp_path):
    app, rigs = tmp_path / "app" / "tubes", tmp_path / "rigs"
    rigs.mkdir()
    (rigs / "mine.toml").write_text("[contact]\nfriction = 0.2\n")
    (rigs / "pyproject.toml").write_text("[project]\n")
    (rigs / "link.toml").symlink_to(tmp_path / "elsewhere.toml")
    form = opened(rigs / "mine.toml")
    before = {path.name: path.read_bytes() for path in rigs.glob("m*.toml")}
    form.change(FIELDS["contact.friction"], "0.3")
    for name, message in (
        (tmp_path / "mine.toml", f"a tube file is saved in {rigs} or {app}: give a name alone"),
        (rigs / "new" / "mine.toml", "is saved in"),
        (Path("../mine.toml"), "is saved in"),
        (Path("pyproject.toml"), f"{rigs / 'pyproject.toml'}: exists and is a file of another kind"),
        (Path("link.toml"), f"{rigs / 'link.toml'}: exists and is a file of another kind"),
        (Path("mine.toml"), f"{rigs / 'mine.toml'}: exists: press replace"),
    ):
        with pytest.raises(FileError, match=re.escape(message)):
            form.save(name, app)
    assert {path.name: path.read_bytes() for path in rigs.glob("m*.toml")} == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rigs"]
    form.save(Path("mine.toml"), app, replace=True)
    assert Plant.from_toml(rigs / "mine.toml").contact.friction == 0.3
    form.save(app / "other.toml", app)
    with pytest.raises(FileError, match=re.escape(f"a tube file is saved in {app}: give a name alone")):
        form.save(rigs / "mine.toml", app)
    with pytest.raises(ValueError, match="invisible characters"):
        form.save(Path("a\nb.toml"), app)
    assert Plant.from_toml(app / "other.toml").contact.friction == 0.3


def test_refused_change_has_the_message_of_the_command(tmp_path, capsys):
    form = opened(EXAMPLE)
    before = form.tables, form.plant
    with pytest.raises(ValueError, match="accepted range 0 to 1") as error:
        form.change(FIELDS["contact.friction"], "1.5")
    assert (form.tables, form.plant) == before
    path = tmp_path / "bad.toml"
    path.write_text(EXAMPLE.read_text().replace("friction = { low = 0.12, high = 0.22 }", "friction = 1.5"))
    assert main(["evaluate", "pi", "--tube", str(path), "--output", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err == f"probe-env: error: {path}: {error.value}\n"


def test_points_are_a_schedule_file_and_refused_as_one():
    schedule = Schedule.read("configs/schedules/example.csv")
    points = schedules.points_of(schedule)
    restored = schedules.schedule_of(points)
    assert schedules.points_of(restored) == points
    assert (restored.position, restored.feed_speed) == (schedule.position, schedule.feed_speed)
    assert restored.air_supply_rate == pytest.approx(schedule.air_supply_rate, rel=1e-6)  # six digits
    assert schedules.csv_text(points).startswith("# interpolation: linear\n")
    points[FEED][0] = 9.0
    with pytest.raises(ValueError, match=r"line 3, feed_speed_m_per_s = 9\.0 is outside the accepted range 0 to 2 m/s"):
        schedules.schedule_of(points)


def test_points_are_tidied_after_a_drag():
    config = TaskConfig()
    points = {LENGTH: [20.0, 5.0, 12.5], FEED: [0.1, 9.0, MISSING], AIR: [100.0, float("nan"), 90.0]}
    tidy = schedules.sorted_points(points, config)
    assert tidy[LENGTH] == [5.0, 12.5, 20.0]
    assert tidy[FEED][1] == config.feed_speeds[1]  # the middle of 9 and 0.1 is out of range
    assert tidy[AIR] == [90.0, 90.0, 100.0]
    tidy = schedules.sorted_points({LENGTH: [5.0, 5.0], FEED: [0.1, 0.2], AIR: [60.0, 60.0]}, config)
    assert np.diff(tidy[LENGTH]).min() > 0.0


def test_prediction_equals_the_objective_of_the_search():
    case, schedule = load_case(None, "test", 6), Schedule.read(DATA / "best-schedule.csv")
    prediction = schedules.predict(schedule, case)
    cost = MapCost(case.contexts, case.config, case.vibration)
    assert prediction.reward == pytest.approx(cost.reward(schedule), rel=1e-9)  # sums in another order
    assert (np.diff([prediction.low, prediction.middle, prediction.high], axis=0) > 0.0).all()
    assert prediction.length[0] == 5.5
    with pytest.raises(ValueError, match="over time"):
        schedules.predict(Schedule("time", "steps", (0.0,), (0.2,), (0.02,)), case)


def test_every_offered_overlay_is_a_line():
    case = read_case(EXAMPLE, "test", 1)
    for name in (*schedules.BY_LENGTH, *shipped_names("schedules")):
        line = schedules.policy_line(name, case)
        assert len(line.length) == len(line.feed) == len(line.air) > 1, name
        assert np.isfinite(np.concatenate(line)).all(), name
    with pytest.warns(UserWarning, match="Not read: 'Bemerkung'"):
        line = schedules.log_line(file_or_shipped("logs", "example-rig"))
    assert (np.diff(line.length) >= 0.0).all()
    with pytest.raises(ValueError, match="depends on measurements"):
        schedules.policy_line("pi", case)


def test_overlays_respect_the_permitted_speed(tmp_path):
    """40 Hz / 4 x 20 mm / 2 = 0.1 m/s."""
    case, file = load_case(Plant(instrument={"test_frequency": 40.0}), "test", 1), tmp_path / "mine.csv"
    file.write_text("inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n5,0.3,63\n")
    assert schedules.policy_line("best-schedule", case).feed.max() == pytest.approx(0.1)
    assert schedules.policy_line(str(file), case).feed.max() == pytest.approx(0.3)
