"""The page without a browser: it is built, its screens take in a run, and it loads nothing from elsewhere."""

import asyncio
import gc
import json
import shutil
import weakref
from collections import deque
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from bokeh.document import Document
from bokeh.models import ColumnDataSource

from agents.app.desk import Office
from agents.app.page.comparisons import Detection
from agents.app.page.document import PATIENCE, page_of
from agents.app.page.style import Live
from agents.app.runs.frames import Frame, row_of, shape_of
from agents.app.runs.queue import Run
from agents.app.runs.wanted import Wanted
from agents.app.server import server_of
from agents.design.compare import cells, read_comparison, summarise
from agents.evaluation.kpis import DETECTION
from agents.evaluation.plan import Plan, Playing
from agents.evaluation.statistics import a90_95, bands, grouped
from agents.policies.catalogue import named_policies
from agents.policies.places import place_of
from probe_env.fidelity import resolve_fidelity
from probe_env.inspection.tally import POD_NAMES


class Idle:
    """A line of runs without a worker."""

    runs: tuple[()] = ()
    changes = 0


@pytest.fixture
def office(tmp_path):
    return Office(Idle(), tmp_path)


def test_every_screen_is_built_and_drawn_for_ones_own_tube(office):
    page, document = page_of(office, "example"), Document()
    page.add_to(document)
    for number in range(len(page.screens)):
        page.chosen.active = number
        page.tick()
        assert [screen.layout.visible for screen in page.screens].count(True) == 1
    text = json.dumps(document.to_json(), default=str)
    assert "http" not in text.replace("http://www.w3.org", "")  # nothing to be asked of anybody
    assert "whether the cable" in page.tube.inputs["contact.cable"].description.content.html.lower()
    page.tube.inputs["tube.helix_length"].value = "30"
    assert page.schedule.along.end == pytest.approx(30.3)
    page.tube.inputs["tube.helix_length"].value = "never"
    assert "tube.helix_length: Input should be a valid number" in page.tube.errors["tube.helix_length"].text
    assert page.desk.tube.plant.tube.helix_length == 30.0


def test_the_next_picture_waits_until_the_last_one_is_drawn(office, monkeypatch):
    """By a browser that says so, or for as long as patience lasts: what happened meanwhile is in the next one."""
    page, pictures = page_of(office), []
    page.add_to(Document())
    monkeypatch.setattr(page.screens[page.chosen.active], "refresh", lambda: pictures.append(office.queue.changes))
    page.tick()
    assert (pictures, page.sent.value) == ([0], 1)
    for changes in (1, 2):
        monkeypatch.setattr(office.queue, "changes", changes, raising=False)
        page.tick()
    assert pictures == [0]
    page.drawn.value = page.sent.value  # as the browser does
    page.tick()
    page.tick()
    assert pictures == [0, 2]
    page.drawn.value = page.sent.value
    page.tick()
    assert pictures == [0, 2]  # nothing has happened
    monkeypatch.setattr(office.queue, "changes", 3, raising=False)
    page.drawn.value = 0  # a browser that is lost
    page._sent_at -= PATIENCE
    page.tick()
    assert pictures == [0, 2, 3]
    page.desk.run = Run(Wanted((), office.output), "running")
    for state, changes in (("running", 4), ("running", 5), ("finished", 6), ("finished", 7)):
        page.desk.run.state = state
        monkeypatch.setattr(office.queue, "changes", changes, raising=False)
        page.tick()
    assert pictures == [0, 2, 3, 4, 6]  # that a run begins or ends waits for nothing


def test_words_that_change_often_do_not_go_through_a_div():
    """Before there is a page they do; then the browser is given them beside it."""
    words, document = Live(name="words"), Document()
    words.text = "<p>one</p>"
    assert words.div.text == "<p>one</p>"
    document.add_root(words.div)
    assert any(isinstance(model, ColumnDataSource) for model in document.models)
    words.text = "<p>two</p>"
    assert (words.text, words.div.text) == ("<p>two</p>", "<p>one</p>")


def test_text_from_files_is_shown_as_text(office, tmp_path):
    page = page_of(office)
    page.compare.open.value = str(tmp_path / "<script>alert(1)</script>")
    assert "<script>" not in page.compare.wrong.text
    assert "&lt;script&gt;" in page.compare.wrong.text


def test_only_this_machine_is_let_in(office):
    asyncio.set_event_loop(asyncio.new_event_loop())  # since 3.12 Python says so where none was made
    server = server_of(office, None, 0)
    try:
        origins = server._tornado.websocket_origins
        assert origins == {f"localhost:{server.port}", f"127.0.0.1:{server.port}"}
        assert [sock.getsockname()[0] for sock in server._http._sockets.values()] == ["127.0.0.1"]
    finally:
        server.stop()
        server.io_loop.close()


def test_no_search_for_garbage_stops_an_open_page_and_a_closed_one_is_forgotten(office):
    asyncio.set_event_loop(asyncio.new_event_loop())
    server = server_of(office, None, 0)
    try:
        document = server._tornado.applications["/"].application.create_document()
        assert gc.get_freeze_count() > 0
        page, (closed,) = weakref.ref(document), document.session_destroyed_callbacks
        del document
        gc.collect()
        assert page() is not None  # an open page is not looked through: circles of references hold it
        closed(None)
        assert page() is None
    finally:
        gc.unfreeze()
        server.stop()
        server.io_loop.close()


def test_names_in_the_chart_of_time_and_vibration_stay_within_it(office):
    page = page_of(office)
    page.compare.open.value = "results/evaluation"
    data = page.compare.front.source.data
    at = dict(zip(data["x"], zip(data["align"], data["offset"], strict=True), strict=True))
    assert at[min(at)] == ("left", 8)
    assert at[max(at)] == ("right", -8)


def test_curves_of_detection_are_those_of_the_report(office, tmp_path):
    table = grouped(pd.read_csv("results/control/episodes.csv"))
    policies, shown = ["adaptive", "plc-law", "best-schedule"], Detection()
    shown.show(table, policies)
    assert shown.lines.data["name"] == policies
    expected = bands(table)
    for name, pod in zip(policies, shown.lines.data["pod"], strict=True):
        assert pod == expected.loc[expected["policy"] == name, "pod"].to_list()
    least = min(a90_95(table, name) for name in policies)
    assert f"<b>{least:.1f} %</b>" in shown.caption.text
    page = page_of(office)
    older = shutil.copytree("results/evaluation", tmp_path / "of-before-there-was-a-sensor")
    stored = pd.read_parquet(older / "episodes.parquet")
    stored.drop(columns=[*DETECTION, *POD_NAMES]).to_parquet(older / "episodes.parquet")
    page.compare.open.value = str(older)
    assert page.compare.wrong.text == ""
    assert "No curves of detection" in page.compare.detection.caption.text
    page.compare.open.value = "results/evaluation"
    assert "No curves of detection" not in page.compare.detection.caption.text


def test_what_is_around_the_tube_is_drawn_less_often_while_the_probe_moves(office, monkeypatch):
    """So that the browser leaves the simulation its core; with everything as it is once the probe stands still."""
    place = place_of(None, "test", 1)
    config = place.config.all_shown
    plan = Plan(named_policies(["constant"], config), place.contexts, config=config, fidelity=resolve_fidelity("fast"))
    playing, page = Playing(plan, deque(plan.units()), 1, 1), page_of(office)
    screen, clock = page.insertion, SimpleNamespace(monotonic=iter((10.0, 10.1, 10.5, 10.55)).__next__)
    monkeypatch.setattr("agents.app.page.insertion.time", clock)
    run = Run(Wanted((), office.output), "running")
    page.desk.run = run

    def drawn(paused: bool = False) -> tuple[float, float]:
        """Tips in the tube and in the charts around it after another second."""
        list(playing.step())
        rows = ((playing.unit(0), np.array([row_of(playing, 0)])),)
        run.note(Frame((playing.unit(0),), 0, rows, shape_of(playing, 0), 0, 1, paused))
        screen.refresh()
        return max(screen.unrolled.floats.data["place"]), max(screen.unrolled.along.data["place"])

    first, second, third, fourth = drawn(), drawn(), drawn(), drawn(paused=True)
    assert first[0] == first[1] == second[1] < second[0]
    assert third[0] == third[1] < fourth[0] == fourth[1]
    assert screen.unrolled.axial.x_range is screen.unrolled.tube.x_range  # whoever moves one moves both


def test_a_dragged_flaw_stays_within_the_second_and_comes_back(office):
    page = page_of(office)
    flaw = page.insertion.flaw
    flaw.flaw.data = {"time": [-0.3], "at": [2.0]}
    assert flaw.before.value == pytest.approx(0.3)
    assert flaw.flaw.data == {"time": [-0.3], "at": [0.0]}
    flaw.flaw.data = {"time": [0.4], "at": [0.0]}
    assert flaw.flaw.data["time"] == [0.0]
    flaw.flaw.data = {"time": [], "at": []}
    assert flaw.flaw.data["at"] == [0.0]


def test_a_comparison_of_designs_is_shown_as_the_command_prints_it(office):
    page = page_of(office)
    page.compare.open.value = "results/design/confirmed"
    assert page.compare.wrong.text == ""
    assert not page.compare.pictures.visible
    for _, *texts in cells(summarise(read_comparison(Path("results/design/confirmed")))):
        for text in texts:
            assert f"<td>{text}<small>" in page.compare.tables.text
    page.compare.open.value = "results/evaluation"
    assert page.compare.pictures.visible
