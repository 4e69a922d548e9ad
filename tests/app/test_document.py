"""The page without a browser: its screens are built, show a run, and load nothing from other hosts."""

import base64
import json
import os
import re
import time
from collections import deque
from html import unescape
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import openpyxl
import pytest
from bokeh.core.validation import check_integrity
from bokeh.document import Document
from bokeh.events import ButtonClick

from probe_agents.app.runs import Frame, Run, RunRequest
from probe_agents.app.screens.page import PATIENCE, Page
from probe_agents.app.worker import row_of, shape_of
from probe_agents.design.compare import read_comparison, summarise, texts_of
from probe_agents.evaluation.plan import Plan, RolloutRunner
from probe_agents.policies.cases import load_case
from probe_agents.policies.catalogue import named_policies
from probe_agents.records.drawing import PALETTE, policy_colours
from probe_env import Plant
from probe_env.fidelity import resolve_fidelity
from probe_env.schedule import AIR, FEED, Schedule


def end_process(path):
    """As the system does where a process takes too much memory."""
    os._exit(1)


@pytest.fixture
def page(app):
    return Page(app)


def runner_of(names, batch, tube=None):
    """Insertions into the first tube of a plant."""
    case = load_case(tube, "test", 1)
    config = case.config.full_observation
    plan = Plan(named_policies(names, config), case.contexts, config=config, fidelity=resolve_fidelity("fast"))
    return RolloutRunner(plan, deque(plan.episode_ids()), batch, 1)


def test_every_screen_is_built_for_an_own_tube(app):
    page, document = Page(app, "example"), Document()
    page.add_to(document)
    for number in range(len(page.screens)):
        page.chosen.active = number
        page.tick()
        assert [screen.layout.visible for screen in page.screens].count(True) == 1
        assert check_integrity(document.models).warning == []
    text = json.dumps(document.to_json(), default=repr)
    assert "http" not in text.replace("http://www.w3.org", "")  # no request to another host
    assert "whether the cable" in page.tube.inputs["contact.cable"].description.content.html.lower()
    page.tube.inputs["tube.helix_length"].value = "30"
    assert page.schedule.length_range.end == pytest.approx(30.9)
    assert page.schedule.charts[0].center[-1].top == 0.3  # m/s, permitted by the instrument
    page.tube.inputs["tube.helix_length"].value = "never"
    assert "tube.helix_length: Input should be a valid number" in page.tube.errors["tube.helix_length"].text
    assert page.session.tube.plant.tube.helix_length == 30.0


def test_an_empty_field_shows_the_value_of_the_calibration(app, page, tmp_path):
    """Its quantiles 0.05 and 0.95; the list of tubes names what is open."""
    draws = {"friction": np.linspace(0.1, 0.2, 101).tolist()}
    (tmp_path / "c.json").write_text(json.dumps({"misspecified": False, "draws": draws}))
    (tmp_path / "mine.toml").write_text('posterior = "c.json"\n')
    friction, names = page.tube.inputs["contact.friction"], [page.tube.shipped.value]
    study = friction.placeholder
    for name in (str(tmp_path / "mine.toml"), "example"):
        page.tube.open.value = name
        names.append(page.tube.shipped.value)
        if name != "example":
            assert (friction.value, friction.placeholder) == ("", "0.105 to 0.195")
    assert names == ["study tubes", "your tube", "example"]
    page.tube.shipped.value = "study tubes"
    assert friction.placeholder == study
    assert page.session.tube.is_study


def test_updates_wait_until_the_browser_has_drawn_the_last(app, page, monkeypatch):
    """Changes meanwhile are in the next one; it waits for ``PATIENCE`` at most."""
    updates, problems = [], []
    page.add_to(Document())

    def refresh():
        if problems:
            raise problems.pop()
        updates.append(app.queue.changes)

    monkeypatch.setattr(page.screens[page.chosen.active], "refresh", refresh)

    def change(changes):
        monkeypatch.setattr(app.queue, "changes", changes, raising=False)
        page.tick()

    page.tick()
    assert (updates, page.sent.value) == ([0], 1)
    change(1)
    change(2)
    assert updates == [0]
    page.painted.value = page.sent.value  # as the browser does
    page.tick()
    page.tick()
    assert updates == [0, 2]
    page.painted.value = page.sent.value
    page.tick()
    assert updates == [0, 2]  # nothing has changed
    problems.append(OSError("gone"))
    with pytest.raises(OSError, match="gone"):
        change(2.5)
    page.tick()
    assert updates == [0, 2, 2.5]  # not lost
    page.painted.value = page.sent.value
    page.tick()
    page.painted.value = 0  # a browser that does not answer
    page._sent_at -= PATIENCE
    change(3)
    assert updates == [0, 2, 2.5, 3]
    page.session.run = Run(RunRequest(policies=(), output=app.output), "running")
    for state, changes in (("running", 4), ("running", 5), ("finished", 6), ("finished", 7)):
        page.session.run.state = state
        change(changes)
    assert updates == [0, 2, 2.5, 3, 4, 6]  # begin and end of a run are shown at once


def test_side_charts_refresh_less_often_than_the_tube(app, page, monkeypatch):
    runner, screen = runner_of(["constant"], 1), page.insertion
    clock = SimpleNamespace(monotonic=iter((10.0, 10.1, 10.5, 10.55)).__next__)
    monkeypatch.setattr("probe_agents.app.screens.insertion.time", clock)
    run = page.session.run = Run(RunRequest(policies=("constant",), output=app.output), "running")

    def positions(paused=False):
        """Tips in the tube and in the charts around it after another period."""
        list(runner.step())
        rows = ((runner.episode_id(0), np.array([row_of(runner, 0)])),)
        run.update(Frame((runner.episode_id(0),), 0, runner.episode_id(0), rows, shape_of(runner, 0), 0, paused))
        screen.refresh()
        return max(screen.probe.tube.floats.data["position"]), max(screen.probe.forces.data["position"])

    first, second, third, fourth = positions(), positions(), positions(), positions(paused=True)
    assert first[0] == first[1] == second[1] < second[0]
    assert third[0] == third[1] < fourth[0] == fourth[1]
    assert len(screen.charts.source.data["inserted_length"][0]) == 4


def test_charts_switch_together_to_the_next_insertion(app, page, monkeypatch):
    """The slow one is watched next, though the charts were drawn a moment ago."""
    names, screen = ["constant", "slow"], page.insertion
    runner = runner_of(names, 2, Plant(tube={"helix_length": 7.0}))
    monkeypatch.setattr("probe_agents.app.screens.insertion.time", SimpleNamespace(monotonic=lambda: 10.0))
    run = page.session.run = Run(RunRequest(policies=tuple(names), output=app.output), "running")
    for k in (0, 1):
        while runner.episodes.running[0] or not runner.last:
            list(runner.step())
        rows = ((runner.episode_id(k), np.array([row_of(runner, k)])),)
        run.update(Frame(tuple(runner.ids), k, runner.episode_id(k), rows, shape_of(runner, k), k, False))
        screen.refresh()
        assert f"Probe of {names[k]}, tube 0" in screen.probe.title.text
        assert f"<b>{names[k]}, tube 0</b>" in screen.status.text
        assert f"Observation of {names[k]}<" in screen.observation.text
        length = float(re.search(r"inserted length</td><td>([\d.]+)", screen.observation.text)[1])
        trace = run.trace(runner.episode_id(k))
        assert length == pytest.approx(trace["inserted_length"][-1], rel=1e-3)
        assert f"It requests <b>{trace['target_feed_speed'][-1]:.3f} m/s" in screen.observation.text
    assert screen.charts.source.data["colour"] == list(policy_colours(names).values())


def test_a_policy_has_one_colour_everywhere(page):
    page.schedule.overlay.value = ["constant", "best-schedule"]
    colours = dict(zip(page.schedule.lines.data["name"], page.schedule.lines.data["colour"], strict=True))
    assert colours == {"constant": PALETTE[2], "best-schedule": PALETTE[1]}
    run = policy_colours(["my-schedule", "best-schedule", "constant"])
    assert run == colours | {"my-schedule": PALETTE[0]}
    assert len(set(policy_colours(map(str, range(21))).values())) == 21


def test_uploads_of_equal_name_are_both_stored(app, page):
    text = "inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n5,{},60\n"
    coded = [base64.b64encode(text.format(feed).encode()).decode() for feed in (0.1, 0.2)]
    stored = [page.session.store_upload("../mine.csv", upload) for upload in coded]
    assert {path.parents[1] for path in stored} == {app.output / "uploads"}
    page.schedule._take(stored[0], Schedule.read(stored[0]))
    assert page.session.points == {"inserted_length_m": [5.0], FEED: [0.1], AIR: [60.0]}
    assert page.session.name == "mine"
    assert page.schedule.file.text == "# interpolation: linear\n" + text.format(0.1).replace("5,0.1,60", "5.0,0.1,60.0")
    with pytest.raises(ValueError, match="is a folder"):
        page.session.store_upload("..", coded[0])
    with pytest.raises(ValueError, match=r"big.toml: empty, or more than"):
        page.session.store_upload("big.toml", "")


def test_null_and_nan_of_a_forged_message_change_nothing(page):
    field, flaw = page.tube.inputs["contact.walls"], page.insertion.flaw
    before = [page.tube.summary.text, page.tube.file.text, dict(flaw.flaw.data)]
    page.tube.shipped.value = field.value = None
    flaw.before.value = float("nan")
    assert [page.tube.summary.text, page.tube.file.text, dict(flaw.flaw.data)] == before


def test_unusual_values_of_the_tube_are_noted(page):
    page.tube.inputs["contact.stiffness"].value = "1e8"
    assert "contact.stiffness = 1e+08 is far from a usual 100000 N/m" in page.tube.summary.text


def test_a_dragged_flaw_stays_within_the_last_second(page):
    flaw = page.insertion.flaw
    flaw.flaw.data = {"time": [-0.3], "at": [2.0]}
    assert flaw.before.value == pytest.approx(0.3)
    assert flaw.flaw.data == {"time": [-0.3], "at": [0.0]}
    for forged, name in (({"time": [0.4], "at": [0.0]}, "time"), ({"time": [], "at": []}, "at")):
        flaw.flaw.data = forged
        assert flaw.flaw.data[name] == [0.0]


def test_design_comparison_equals_that_of_the_command(page, tmp_path):
    page.compare.open.value = str(tmp_path / "<script>alert(1)</script>")
    assert "<script>" not in page.compare.problem.text
    assert "&lt;script&gt;" in page.compare.problem.text
    page.compare.open.value = "results/design/confirmed"
    assert page.compare.problem.text == ""
    _, rows = texts_of(summarise(read_comparison(Path("results/design/confirmed"))))
    assert all(f"<td>{text}</td>" in page.compare.content.text for _, *texts in rows for text in texts)


def test_a_log_and_a_schedule_are_read_in_another_process(page, tmp_path, monkeypatch):
    screen = page.schedule
    for path, text in {
        "rig.csv": "time;length [m];feed [m/s];air [m3/h]\n0;5,0;0,2;63\n1;5,2;0,2;63\n2;5,4;0,2;63\n",
        "mine.csv": "Länge [m];Vorschub [mm/s];Luft [m3/h]\n5;200;63\n25;150;100\n",
        "bad.csv": "Länge [m];Vorschub [kg];Luft [m3/h]\n5;200;63\n",
    }.items():
        (tmp_path / path).write_text(text, encoding="utf-8")

    def read(box, name):
        box.value = str(tmp_path / name)
        assert "reading" in screen.problem.text
        for _ in range(600):
            if not screen._reading:
                return
            time.sleep(0.1)
            page.tick()

    read(screen.log, "rig.csv")
    assert screen.lines.data["name"] == ["constant", "log"]
    assert screen.lines.data["length"][1] == pytest.approx([5.0, 5.2, 5.4])
    assert "The column 'time' has no unit and is read as seconds." in unescape(screen.problem.text)
    book = openpyxl.Workbook()
    book.create_sheet("Messung").append(["time [s]", "length [m]", "air [m3/h]"])
    for row in ((0, 5.0, 63), (1, 5.1, 63), (2, 5.2, 63)):
        book["Messung"].append(row)
    book.save(tmp_path / "rig.xlsx")
    read(screen.log, "rig.xlsx#Messung")
    assert screen.lines.data["length"][1] == pytest.approx([5.0, 5.1, 5.2])
    read(screen.log, "rig.xlsx#Messwerte")
    assert "no sheet 'Messwerte'; there are 'Sheet', 'Messung'" in unescape(screen.problem.text)
    read(screen.open, "mine.csv")
    assert page.session.points == {"inserted_length_m": [5.0, 25.0], FEED: [0.2, 0.15], AIR: [63.0, 100.0]}
    assert page.session.name == "mine"
    read(screen.open, "bad.csv")
    assert "bad.csv: column 'Vorschub [kg]': 'kg' is not a unit of feed_speed" in unescape(screen.problem.text)
    monkeypatch.setattr("probe_agents.app.screens.schedule.read_schedule", end_process)
    read(screen.open, "rig.csv")
    assert "the process that read the file was killed" in screen.problem.text


@pytest.mark.parametrize("number", [0, 1])
def test_saving_asks_before_it_replaces_a_file(page, tmp_path, number):
    """A tube and a schedule; opening one saves nothing."""
    screen, name, folder = page.screens[number], ("b.toml", "b")[number], tmp_path / ("tubes", "schedules")[number]
    screen.open.value = ("example", "best-schedule")[number]
    assert not folder.exists()
    for save in (lambda: setattr(screen.save.name, "value", name), lambda: press(screen.save.button)):
        save()
        assert screen.problem.text == ""
        (path,) = folder.iterdir()
        path.write_bytes(before := path.read_bytes() + b"\n")
        press(screen.save.button)
        assert f"{path}: exists: press replace" in screen.problem.text
        assert (screen.save.button.label, path.read_bytes()) == ("replace", before)
    screen.save.name.value = f"c{name}"
    assert screen.save.button.label == "save"
    assert len(list(folder.iterdir())) == 2
    path.write_text("[something else]\n")
    screen.save.name.value = name
    assert f"{path}: exists and is a file of another kind" in screen.problem.text
    press(screen.save.button)
    assert path.read_text() == "[something else]\n"


def press(button):
    button._trigger_event(ButtonClick(button))


def test_forged_values_are_refused_at_their_field(page, tmp_path):
    for screen, field, value, message in (
        (page.insertion, "limit", 1e9, "tubes = 1000000000.0 is outside the accepted range 1 to 48"),
        (page.insertion, "policies", ["pi", "<b>"], "compare with = &#x27;&lt;b&gt;&#x27; is not offered; accepted: "),
        (page.insertion, "fidelity", "best", "fidelity = &#x27;best&#x27; is not offered; accepted: "),
        (page.manual, "rival", "slow-dwon", "; the closest: slow-down"),
        (page.compare, "open", "x" * 5000, "File name too long"),
        (page.tube, "open", "x" * 5000, "File name too long"),
        (page.tube, "save", f"{'x' * 5000}.toml", "is not a name of 1 to 80 characters"),
        (page.schedule, "open", f"{'x' * 5000}.csv", "File name too long"),
    ):
        widget = getattr(screen, field)
        widget = getattr(widget, "name", widget) if field == "save" else widget
        before, widget.value = widget.value, value
        assert message in screen.problem.text
        if screen in (page.insertion, page.manual):
            screen.guarded(screen._start)()
            assert message in screen.problem.text
        widget.value = before
    assert list(tmp_path.iterdir()) == []
