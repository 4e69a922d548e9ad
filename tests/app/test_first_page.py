"""The first page of the report and the app's screen, for insertions made by hand: verdict, metres to repeat, hours."""

import re
from html import unescape

import numpy as np
import pytest

from probe_agents.app.runs import Run, RunRequest
from probe_agents.app.screens.page import Page
from probe_agents.evaluation.folder import ReportSettings
from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.evaluation.report import write_report
from probe_agents.policies.fixed import Constant, Scheduled
from probe_env import Context, TaskConfig
from probe_env.envs.plants import Bundle
from probe_env.fidelity import resolve_fidelity
from probe_env.schedule import Schedule

CONFIG = TaskConfig(instrument={"test_frequency": 100.0})
"""Permits 100 Hz / 4 x 20 mm / 2 = 0.25 m/s; the vibration limit is 0.1 mm, the helix ends at 60 m."""
BUNDLE = Bundle(tubes=60, setup_time=100.0, withdrawal_time=225.0)
METRE = np.arange(5.5, 60.0)
QUIET, LOUD = np.full(55, 5e-5), np.where(METRE > 35.0, 1.5e-4, 5e-5)
SLOW, FAST = np.full(55, 0.2), np.where((METRE > 10.0) & (METRE < 20.0), 0.3, 0.2)


def store(folder, insertions, config=CONFIG, bundle=BUNDLE, policies=None, users=("mine",), others=275.0, rows=None):
    """Store an evaluation and its report; insertions (feed, vibration) of every tube, 275 s or ``others`` of "other".

    ``rows`` are of the sensitivity of a recommendation.
    """
    schedule = Schedule("inserted_length", "linear", (5.0, 20.0, 60.0), (0.4, 0.2, 0.1), (0.02, 0.02, 0.03))
    policies = policies or {"mine": Scheduled(config, schedule), "other": Constant(config)}
    tubes = [Context(helix_diameter=1.0 + 0.1 * k) for k in range(len(insertions))]
    plan = Plan(policies, tubes, config=config, fidelity=resolve_fidelity("fast"), bundle=bundle)

    def lines(plan, missing):
        for unit in missing:
            feed, vibration = insertions[unit[1]]
            kpis = {
                "reward": 1.0, "inspection_time_s": 275.0 if unit[0] == "mine" else others,
                "share_within_limit": float((vibration < 1e-4).mean()),
                "inspected_share": 1.0, "radial_rms_m": 5e-5, "complete": 1.0, "lost_drive": 0.0, "diverged": 0.0,
            }  # fmt: skip
            columns = {"time": 5.0 * METRE, "inserted_length": METRE, "feed_speed": feed, "radial_rms_m": vibration}
            constants = {"air_supply_rate": 0.02, "tension_mean_n": 5.0, "noise_rms_m": 0.0}
            if config.instrument:
                kpis |= {
                    "length_too_fast_m": float((feed > 0.25).sum()),
                    "speed_excess_m_per_s": float(max(feed.max() - 0.25, 0.0)),
                    "length_to_repeat_m": float(((feed > 0.25) | (vibration > 1e-4)).sum()),
                }
                columns["highest_feed"] = feed
                constants |= {"axial_velocity_rms": np.nan, "permitted_speed": 0.25}
            columns |= {name: np.full(55, value) for name, value in constants.items()}
            profile = {name: values.tolist() for name, values in columns.items()}
            yield {"key": plan.key(unit), "episode": unit, "commit": "", "kpis": kpis, "profile": profile}

    report = ReportSettings(against="other", user_policies=users, bundle=bundle, sensitivity=rows)
    run_plan(plan, folder, progress=False, source=lines, report=report)
    return write_report(folder).read_text()


def screen_of(folder, app):
    """Text of the insertion screen when the run has finished."""
    page = Page(app)
    page.session.run = Run(RunRequest(policies=("mine",), output=folder), "running")
    page.insertion.refresh()
    assert page.insertion.verdict.text == ""
    page.session.run.state = "finished"
    page.insertion.refresh()
    assert page.insertion.problem.text == ""
    return page.insertion.verdict.text


def texts(html):
    """Texts between the tags."""
    return [text for part in re.split(r"<[^>]*>", unescape(html)) if (text := " ".join(part.split()))]


def front(report):
    """Texts of the first page of a report."""
    return texts(re.search(r'<section class="first">.*?<section class="verdict">', report, re.DOTALL)[0])


TOO_FAST = "not allowed: 10.0 m above 0.25 m/s (test_frequency), by up to 0.05 m/s; at 10.0 to 20.0 m"
ALLOWED = "allowed: at most 0.25 m/s (test_frequency) everywhere"
STILL = "quiet: vibration within 0.1 mm in every metre"


@pytest.mark.parametrize(
    ("insertion", "verdict", "length", "rows", "hours"),
    [
        ((FAST, QUIET), f"is {TOO_FAST}. It is {STILL}.", "10.0 m", ["10.0", "20.0", "speed"], ("100", "10")),
        (
            (SLOW, LOUD),
            f"is {ALLOWED}. It is not quiet: vibration above 0.1 mm in 25.0 m; at 35.0 to 60.0 m.",
            "25.0 m", ["35.0", "60.0", "noise"], ("100", "10"),
        ),
        ((SLOW, QUIET), f"is {ALLOWED}. It is {STILL}.", "0.0 m", [], ("0", "0")),
    ],
)  # fmt: skip
def test_verdicts_of_the_first_page_and_the_app(insertion, verdict, length, rows, hours, tmp_path, app):
    """275 s of insertion, 100 s of setup and 225 s of withdrawal: 60 tubes take 10 h, and as long again if repeated."""
    page = front(store(tmp_path / "run", [insertion]))
    assert page[:3] == ["Your schedule", "mine", verdict]
    at = page.index(f"Metres to repeat: {length}")
    head = ["from [m]", "to [m]", "reason"]
    listed = page[at + 1 : page.index("Hours for 60 tubes")]
    assert listed == (head + rows if rows else ["No metre to repeat."])
    at = page.index("first passes [h]")
    assert page[at : at + 2] == ["first passes [h]", "10"]
    assert page[at + 3].startswith(hours[0])  # with the interval of one tube of one
    both = "20" if rows else "10"
    assert page[at + 4 : at + 8] == ["second passes [h]", hours[1], "all passes [h]", both]
    assert page[page.index("Feed and air") :][1:14] == [
        "linear between rows", "length [m]", "feed [m/s]", "air [m³/h]",
        "5", "0.400", "72", "20", "0.200", "72", "60", "0.100", "108",
    ]  # fmt: skip

    screen = texts(screen_of(tmp_path / "run", app))
    assert screen[:3] == ["mine", verdict, f"Metres to repeat: {length}"]
    assert screen[3:-1] == (head + rows if rows else [])
    assert screen[-1].startswith(f"Hours for 60 tubes: first passes [h]: 10; second pass [% of tubes]: {hours[0]}")
    assert screen[-1].endswith(f"; second passes [h]: {hours[1]}; all passes [h]: {both}")


def test_list_over_several_tubes_has_fractions(tmp_path):
    """Two of four tubes are too loud from 35 m on, and one of these too fast from 10 to 20 m."""
    report = store(tmp_path / "run", [(SLOW, QUIET), (SLOW, LOUD), (FAST, LOUD), (SLOW, QUIET)])
    page = front(report)
    assert page[2] == (
        "is not allowed: 2.5 m on average above 0.25 m/s (test_frequency), by up to 0.05 m/s; in some tube at 10.0 to"
        " 20.0 m. It is not quiet: vibration above 0.1 mm in 12.5 m on average; in some tube at 35.0 to 60.0 m."
    )
    table = page[page.index("Metres to repeat: 15.0 m on average") :][1:13]
    assert table == ["from [m]", "to [m]", "reason", "insertions [%]",
                     "10.0", "20.0", "speed", "25", "35.0", "60.0", "noise", "50"]  # fmt: skip
    assert "<li><b>other</b>: not allowed: 2.5 m on average above" in report
    assert "; 15.0 m to repeat on average</li>" in report


def test_without_instrument_and_bundle_their_parts_are_left_out(tmp_path, app):
    config = CONFIG.model_copy(update={"instrument": None})
    report = store(tmp_path / "run", [(FAST, LOUD)], config, None)
    page = front(report)
    assert page[2] == "is not quiet: vibration within 0.1 mm in 54.5 % of the length."  # 30 of 55 m
    for text in ("repeat", "Hours", "nstrument"):
        assert text not in " ".join(page)
        assert f"{text}: the other" not in report
    assert screen_of(tmp_path / "run", app) == ""


def test_first_page_shows_the_best_policy_by_default(tmp_path):
    """A constant has no schedule file: its feed and air are as driven."""
    page = front(store(tmp_path / "run", [(SLOW, QUIET)], policies={"other": Constant(CONFIG)}, users=()))
    assert page[:2] == ["The best policy,", "other"]
    assert page[2].startswith(", is allowed: ")
    rows = page[page.index("2 of 55 rows; as driven, mean over the insertions") :][4:]
    assert rows[:7] == ["5.5", "0.200", "72", "59.5", "0.200", "72", "Metres to repeat: 0.0 m"]


def test_report_of_a_recommendation_begins_with_the_best(tmp_path, app):
    """60 tubes take 60 (225 + 100 + 225) s, 9.17 h, with "other" and 10 h with the user's; the way out takes longer.

    60 m at 0.25 m/s are 240 s, after 55 m at 0.4 m/s, 137.5 s: 60 (137.5 + 100 + 240) s.
    """
    rows = ("not measured", "vibration"), ("friction -0.01 to +0.01", "0.5 to 2")
    page = front(store(tmp_path / "run", [(SLOW, QUIET)] * 2, others=225.0, rows=rows) + '<section class="verdict">')
    assert page[:3] == ["Best for your plant:", "other", f". It is {ALLOWED}. It is {STILL}."]
    at = page.index("Which schedule")
    assert page[at + 1] == "Best by hours of all passes and reward is other."
    at = page.index("Your schedule")
    assert page[at : at + 3] == ["Your schedule", "mine", ": worse than the best here, other."]
    at = page.index("hours of all passes [h]", at)
    assert page[at : at + 4] == ["hours of all passes [h]", "10", "9.17", "+0.833"]
    assert page.count("Feed and air") == 2
    at = page.index("on the way in, other")
    assert page[at : at + 12] == [
        "on the way in, other",
        "550",
        "9.17",
        "-",
        "on the way out, \u03bcl/r up to 18",
        "478",
        "7.96",
        "17.5",
        "on both ways",
        "565",
        "9.42",
        "-",
    ]
    assert page[page.index("friction -0.01 to +0.01") + 1] == "0.5 to 2"
    assert texts(screen_of(tmp_path / "run", app))[0] == "other"
