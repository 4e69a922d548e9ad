"""How long a user of the app waits: `make time-app` stores it in results/app; the machine must do nothing else."""

import argparse
import tempfile
import time
from pathlib import Path

import pandas as pd
from conftest import CHROMIUM, App, opened, served
from playwright.sync_api import sync_playwright
from test_page import FEED, PLACE, fill, screen

from agents.evaluation.plan import Plan, run_plan
from agents.policies.catalogue import named_policies
from agents.policies.places import place_of
from agents.records.provenance import provenance, write_atomically, write_json
from probe_env.fidelity import resolve_fidelity

COMMAND = "make time-app"
COLUMNS = ["wait", "seconds"]
EACH = 3
"""Insertions for every repeat: they are short and scatter with what else the machine does."""
MOVES = 20
"""Of the point that is dragged, each some pixels from the one before."""


RUN = """(element) => {
    const root = element.getRootNode();
    window.ended = new Promise((done) => {
        document.addEventListener("click", () => { window.clicked = performance.now(); }, {capture: true, once: true});
        let begun = false;
        new MutationObserver(() => {
            const state = root.querySelector("[data-state]")?.dataset.state;
            if (state != "finished") begun = true;
            else if (begun) requestAnimationFrame(() => done(performance.now() - window.clicked));
        }).observe(root, {childList: true, subtree: true, attributes: true});
    });
}"""
"""In the page: milliseconds from the next click to the picture that says that a run is finished. Playwright would look
only every half second."""


def until_finished(page) -> float:
    """Seconds from Run to the end of what is to be run."""
    screen(page, 3)
    page.locator("[data-state], p:has-text('Nothing has been run yet')").first.evaluate(RUN)
    page.get_by_role("button", name="Run", exact=True).hover()  # which is there then, and stands still
    page.get_by_role("button", name="Run", exact=True).click()
    return 1e-3 * page.evaluate("window.ended")


def first_run(browser, folder: Path) -> tuple[float, float]:
    """Seconds from the command to a page that can be used, and to the first finished run of what it offers."""
    begin = time.perf_counter()
    with served(folder) as app, opened(browser, app) as page:
        shown = time.perf_counter()
        until_finished(page)
        return shown - begin, time.perf_counter() - begin


def used_run(browser, app: App) -> float:
    """Seconds from Run to the end of what the page offers, in a server that has been used."""
    with opened(browser, app) as page:
        return until_finished(page)


def insertion(browser, app: App, schedule: str) -> float:
    """Seconds from Run to the end of one insertion, with no other policy beside it."""
    with opened(browser, app) as page:
        fill(page, "open a schedule file", schedule)
        named = "(names) => names.includes(Bokeh.documents[0].get_model_by_name('save-schedule').value)"
        page.wait_for_function(named, arg=[schedule, f"my-{schedule}"])
        page.evaluate("() => { Bokeh.documents[0].get_model_by_name('policies').value = []; }")
        return until_finished(page)


def simulated(policy: str) -> float:
    """Seconds of the same insertion without a page: what the machine gives today."""
    place = place_of(None, "test", 1)
    config = place.config.all_shown
    plan = Plan(named_policies([policy], config), place.contexts, config=config, fidelity=resolve_fidelity("fast"))
    begin = time.perf_counter()
    run_plan(plan, None, progress=False)
    return time.perf_counter() - begin


WATCH = """(element) => {
    window.answers = [];
    document.addEventListener("mousemove", () => { window.moved = performance.now(); }, true);
    new MutationObserver(() => requestAnimationFrame(() => window.answers.push(performance.now() - window.moved)))
        .observe(element.getRootNode(), {childList: true, characterData: true, subtree: true});
}"""
"""In the page: milliseconds from the last move of the mouse to the picture with other words."""


def drags(browser, app: App) -> list[float]:
    """Seconds from each move of a point to another expectation on the page."""
    with opened(browser, app) as page:
        x, y = page.evaluate(PLACE, [FEED, 0])
        page.mouse.move(x, y)
        page.get_by_text("Expected:").evaluate(WATCH)
        page.mouse.down()
        for k in range(MOVES):
            page.mouse.move(x, y + 40 + 25 * (-1) ** k)
            page.wait_for_function("(count) => window.answers.length > count", arg=k)
            page.wait_for_timeout(200)
        page.mouse.up()
        return [1e-3 * milliseconds for milliseconds in page.evaluate("window.answers")[:MOVES]]


def measure(repeats: int, output: Path) -> None:
    """Measure all of them, print and store them."""
    with sync_playwright() as play, tempfile.TemporaryDirectory() as folder:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        starts = [first_run(browser, Path(folder) / str(k)) for k in range(repeats + 1)][1:]  # caches are warm
        with served(Path(folder) / "used") as app:
            runs = [used_run(browser, app) for _ in range(repeats + 1)][1:]
            studied = [insertion(browser, app, "constant") for _ in range(EACH * repeats)]
            best = [insertion(browser, app, "best-schedule") for _ in range(EACH * repeats)]
            moves = drags(browser, app)
        browser.close()
    plain = {name: [simulated(name) for _ in range(repeats + 1)][1:] for name in ("constant", "best-schedule")}
    waits = {
        "page": [shown for shown, _ in starts],
        "first_run": [finished for _, finished in starts],
        "run": runs,
        "insertion": studied,
        "insertion_without_page": plain["constant"],
        "best_schedule": best,
        "best_schedule_without_page": plain["best-schedule"],
        "drag": moves,
    }
    table = pd.DataFrame([(name, value) for name, values in waits.items() for value in values], columns=COLUMNS)
    write_atomically(output / "answers.csv", table.to_csv(index=False, float_format="%.3f"))
    write_json(output / "provenance.json", provenance(COMMAND))
    print(table.groupby("wait", sort=False)["seconds"].describe()[["count", "min", "50%", "max"]])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--output", type=Path, default=Path("results/app"))
    given = parser.parse_args()
    measure(given.repeats, given.output)
