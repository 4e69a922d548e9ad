"""The page in a real browser: drag, type, run, compare, and errors."""

import io
import json
import os
import re
from pathlib import Path

import pandas as pd
import pytest
from conftest import opened, served
from PIL import Image

from probe_agents.cli import main
from probe_agents.evaluation.kpis import kpis_of
from probe_agents.evaluation.statistics import short

PLACE = """([chart, source, x, y]) => {
    const document = Bokeh.documents[0];
    const data = document.get_model_by_name(source).data;
    const view = Bokeh.index.find_one(document.get_model_by_name(chart));
    const box = view.canvas_view.el.getBoundingClientRect();
    return [box.left + view.frame.x_scale.compute(data[x][0]), box.top + view.frame.y_scale.compute(data[y][0])];
}"""
POINTS = "Bokeh.documents[0].get_model_by_name('points').data"
FEED = "feed_speed_m_per_s"
FIRST_POINT = (FEED, "points", "inserted_length_m", FEED)


def screen(page, number):
    page.get_by_role("button", name=re.compile(f"^{number} [A-Z]")).click()


def expected(page):
    """Predicted duration [s]."""
    return int(re.search(r"Expected: (\d+) s", page.get_by_text("Expected:").inner_text())[1])


def points(page):
    return page.evaluate(f"Object.fromEntries(Object.entries({POINTS}).map(([name, values]) => [name, [...values]]))")


def seconds(status):
    """Simulated time of the insertion [s]."""
    match = re.search(r"after (\d+) s", status.inner_text())
    return int(match[1]) if match else 0


def fill(page, label, text):
    box = page.get_by_label(label, exact=True).locator("visible=true")
    box.fill(text)
    box.press("Enter")


def start(page):
    """Start a run; returns where its state is shown."""
    screen(page, 3)
    status = page.locator("[data-run]")
    status.or_(page.get_by_text("No run yet")).wait_for()
    earlier = status.get_attribute("data-run") if status.count() else ""
    page.get_by_role("button", name="Run", exact=True).click()
    status = page.locator(f"[data-run]:not([data-run='{earlier}'])")
    status.wait_for()
    return status


def finish(page, status):
    status.and_(page.locator("[data-state=finished]")).wait_for()


def drag(page, x, y, dx, dy):
    """Begin a drag; the mouse stays down. The pause before it is longer than what Bokeh takes for a long press."""
    page.mouse.move(x, y)
    page.mouse.down()
    page.wait_for_timeout(400)
    page.mouse.move(x + dx, y + dy, steps=4)


def opened_report(page):
    with page.context.expect_page() as report:
        page.get_by_role("link", name="open the report").click()
    return report.value


def position(page, *names):
    """Position of the first point of a chart in the window, once the layout has settled."""
    last = None
    while (now := page.evaluate(PLACE, names)) != last:
        last = now
        page.wait_for_timeout(300)
    return now


def test_dragging_a_point_changes_the_prediction_while_it_moves(page):
    before, at = expected(page), points(page)
    x, y = position(page, *FIRST_POINT)
    drag(page, x, y, 0, 30)
    page.get_by_text("Expected:").filter(has_not_text=f"{before} s").wait_for()
    during = expected(page)
    assert during > before  # slower takes longer, and the button is still down
    page.mouse.move(x, y + 45, steps=2)
    page.mouse.up()
    page.wait_for_function(f"(feed) => {POINTS}.{FEED}[0] < feed", arg=at[FEED][0] - 1e-3)
    moved = points(page)
    assert moved[FEED][1:] == at[FEED][1:]
    assert moved["air_supply_m3_per_h"] == at["air_supply_m3_per_h"]
    assert expected(page) >= during


def test_a_tap_adds_a_point_to_both_charts(page):
    before = points(page)
    x, y = position(page, *FIRST_POINT)
    page.mouse.click(x + 60, y + 40)
    page.wait_for_function(f"(n) => {POINTS}.inserted_length_m.length == n", arg=len(before[FEED]) + 1)
    page.wait_for_function(f"() => Math.min(...{POINTS}.air_supply_m3_per_h) > 0")
    after = points(page)
    assert after["inserted_length_m"] == sorted(after["inserted_length_m"])


def test_a_run_pauses_steps_continues_and_equals_the_command(page, app, tmp_path):
    """Bit for bit in the folder; the comparison shows its report."""
    screen(page, 3)
    page.get_by_text("1 ×", exact=True).first.click()
    status = start(page)
    page.get_by_role("button", name="pause", exact=True).click()
    status.filter(has_text="paused").wait_for()
    before = seconds(status)
    page.get_by_role("button", name="step", exact=True).click()
    status.filter(has_text="paused").filter(has_text=f"after {before + 1} s").wait_for()
    page.get_by_role("button", name="slow motion").click()
    page.get_by_text("Radial rms of the sensor in this time").wait_for()
    page.get_by_text("no limit").click()
    page.get_by_role("button", name="continue", exact=True).first.click()
    finish(page, status)
    folder = max(path for path in app.output.glob("*-my-schedule"))
    command = json.loads((folder / "manifest.json").read_text())["command"].split()[1:]
    command[command.index("--output") + 1] = str(tmp_path / "again")
    assert main(command) == 0
    for name in ("episodes.parquet", "profile.parquet"):
        pd.testing.assert_frame_equal(
            *(pd.read_parquet(place / name) for place in (folder, tmp_path / "again")), check_exact=True
        )
    screen(page, 4)
    report = page.frame_locator("iframe")
    report.get_by_role("heading", name="Feed policies compared").wait_for()
    table = pd.read_parquet(folder / "episodes.parquet").set_index("policy")
    row = " ".join(report.locator(".ranking tr", has=page.locator("th", has_text="my-schedule")).all_inner_texts())
    for kpi, (_, factor, _) in kpis_of(table.columns).items():
        assert short(table.loc["my-schedule", kpi].mean() * factor) in row
    assert opened_report(page).get_by_role("heading", name="Feed policies compared").is_visible()


def test_a_dragged_flaw_moves_in_x_and_y(page):
    finish(page, start(page))
    page.get_by_text("A flaw of 20 %").wait_for()
    page.get_by_text("A flaw of 20 %").evaluate("(words) => words.scrollIntoView(false)")  # the chart stands above it
    signals = "() => Array.from(Bokeh.documents[0].get_model_by_name('signals').data.x)"
    loop = "() => Array.from(Bokeh.documents[0].get_model_by_name('loop').data.x).length"
    x_y, before = position(page, "strip", "flaw", "time", "at"), page.evaluate(signals)
    drag(page, *x_y, 40, 10)
    page.mouse.up()
    page.wait_for_function("() => Bokeh.documents[0].get_model_by_name('flaw-before').value < 0.49")
    changed = "(old) => Bokeh.documents[0].get_model_by_name('signals').data.x.some((value, k) => value != old[k])"
    page.wait_for_function(changed, arg=before)
    after = page.evaluate(signals)
    assert len(after) == len(before) > 0
    assert page.evaluate(loop) > 0
    page.wait_for_function("() => Bokeh.documents[0].get_model_by_name('flaw').data.at[0] == 0")  # it stays on its line
    page.locator(".noUi-handle >> visible=true").last.focus()  # of the depth
    page.keyboard.press("ArrowRight")
    page.get_by_text("A flaw of 21 %").wait_for()


def test_runs_are_listed_and_resumed_after_a_killed_server(browser, tube, tmp_path):
    with served(tmp_path / "runs", tube) as app:
        with opened(browser, app) as page:
            finish(page, start(page))
            page.get_by_text("1 ×", exact=True).first.click()
            start(page).filter(has_text="m after").wait_for()
        app.kill()
        app.start()
        with opened(browser, app) as page:
            screen(page, 3)
            runs = page.get_by_role("row")
            runs.filter(has_text="001-my-schedule").filter(has_text="6 of 6 complete").wait_for()
            runs.filter(has_text="002-my-schedule").filter(has_text="interrupted: 0 of 12").wait_for()
            page.get_by_label("run", exact=True).locator("visible=true").select_option("002-my-schedule")
            page.get_by_role("button", name="watch or resume").click()
            page.locator("[data-state=finished]").wait_for()
            runs.filter(has_text="002-my-schedule").filter(has_text="6 of 6 complete").wait_for()


def downloaded(page):
    """Name and text of the file that the button of the screen gives."""
    with page.expect_download() as download:
        page.get_by_role("button", name="download").locator("visible=true").click()
    return download.value.suggested_filename, Path(download.value.path()).read_text()


def test_files_of_the_computer_are_opened_and_downloaded(page, tmp_path):
    text = "# interpolation: steps\ninserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n5.0,0.125,75.0\n"
    (tmp_path / "chosen.csv").write_text(text)
    page.locator("input[accept='.csv,.toml,.xlsx']").set_input_files(tmp_path / "chosen.csv")
    page.wait_for_function(f"{POINTS}.{FEED}[0] == 0.125")
    assert downloaded(page) == ("chosen.csv", text)
    screen(page, 1)
    (tmp_path / "plant.toml").write_text("[tube]\ninner_diameter = 0.0231\nhelix_length = 7.0\n")
    page.locator("input[accept='.toml']").set_input_files(tmp_path / "plant.toml")
    page.get_by_text("uploads/").first.wait_for()
    assert page.get_by_label("inner diameter [mm]", exact=True).input_value() == "23.1"
    assert downloaded(page) == ("plant.toml", (tmp_path / "plant.toml").read_text())
    (tmp_path / "large.toml").write_bytes(b"#" * 15_000_000)
    page.locator("input[accept='.toml']").set_input_files(tmp_path / "large.toml")
    page.get_by_text("large.toml: empty, or more than the 14 MB").wait_for()
    assert page.get_by_label("inner diameter [mm]", exact=True).input_value() == "23.1"


def test_two_browsers_share_runs_but_not_schedules(browser, app):
    with opened(browser, app) as one, opened(browser, app) as other:
        before = points(other)
        fill(one, "open a schedule", "best-schedule")
        one.wait_for_function(f"() => {POINTS}.inserted_length_m.length > 8")
        assert points(other) == before
        finish(one, start(one))
        newest = max(path.name for path in app.output.glob("*-my-*"))
        screen(other, 3)
        other.get_by_role("row").filter(has_text=newest).filter(has_text="complete").wait_for()


def test_manual_drive_with_the_keyboard(page, app):
    page.keyboard.press("5")
    page.get_by_role("button", name="Start", exact=True).click()
    page.get_by_text("by hand: reward").wait_for()
    feed = 'Bokeh.documents[0].get_model_by_name("hand-feed").value'
    before = page.evaluate(feed)
    page.keyboard.press("ArrowRight")
    assert page.evaluate(feed) > before
    page.keyboard.press(" ")
    page.get_by_role("button", name="continue", exact=True).last.wait_for()
    page.keyboard.press(" ")
    page.get_by_text("Finished and stored").wait_for()
    folder = max(path for path in app.output.glob("*-by-hand"))
    table = pd.read_parquet(folder / "episodes.parquet")
    assert set(table["policy"]) == {"by hand", "tension-scheduled"}
    described = json.loads((folder / "manifest.json").read_text())["policies"]["by hand"]
    assert len(set(described["schedule"]["feed_speed"])) == 2  # before and after the key


PICTURES = os.environ.get("PROBE_ENV_PICTURES")
TITLES = ("tube", "schedule", "insertion", "compare", "manual")


@pytest.mark.parametrize("width", [1280, 420])
def test_every_screen_fits_and_its_picture_is_taken(browser, tmp_path, width):
    """Pictures of the docs, in the study's tubes: PROBE_ENV_PICTURES=docs/app."""
    folder = Path(PICTURES or tmp_path)
    folder.mkdir(parents=True, exist_ok=True)
    with served(Path("output/app"), folder=tmp_path) as app, opened(browser, app, width) as page:
        for number, title in enumerate(TITLES, start=1):
            screen(page, number)
            if title == "insertion":
                page.get_by_text("20 ×", exact=True).first.click()  # so that the pause comes before the end
                status = start(page)
                page.get_by_text(re.compile(r"[34]\d\.\d m after")).first.wait_for()
                page.get_by_role("button", name="pause", exact=True).click()
                page.get_by_role("button", name="slow motion").click()
                page.get_by_text("Radial rms of the sensor in this time").wait_for()
                page.wait_for_timeout(1500)  # of slow motion
            if title == "compare":
                page.frame_locator("iframe").locator("canvas").first.wait_for()
                page.wait_for_timeout(2000)  # until the report is painted
            if title == "manual":
                page.get_by_text("8 ×", exact=True).click()
                page.get_by_role("button", name="Start", exact=True).click()
                page.get_by_text(re.compile(r"by hand: reward .* 1\d\.\d m")).wait_for()
            page.wait_for_timeout(500)  # layout
            page.wait_for_function("document.documentElement.scrollWidth <= innerWidth")
            taken = Image.open(io.BytesIO(page.screenshot(full_page=True)))
            few = taken.convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
            few.save(folder / f"{title}-{width}.png", optimize=True)  # a third of the bytes; rare colours stay
            if title == "insertion":
                page.get_by_text("no limit").click()
                page.get_by_role("button", name="continue", exact=True).first.click()
                finish(page, status)


def test_scripts_of_a_report_have_another_origin(page, tmp_path):
    (tmp_path / "report.html").write_text("<p>foreign</p><script>document.title = origin</script>")
    screen(page, 4)
    fill(page, "open an evaluation folder", str(tmp_path))
    page.frame_locator("iframe").get_by_text("foreign").wait_for()
    report = opened_report(page)
    report.get_by_text("foreign").wait_for()
    assert report.title() == "null"
