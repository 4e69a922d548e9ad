"""What plants' users read in words: calibrations, recommendations, both passes, the app."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from agents.calibration.simulated.study import SETS, SHIFT, WORLDS
from agents.calibration.unknowns import UNKNOWNS
from agents.evaluation import passes as passes_study
from agents.pages.sources import RESULTS, command, markdown, source, stored_table
from agents.recommendation import plants as plants_study
from agents.records.models import Figures, Record
from agents.records.reading import read_json
from agents.records.tables import read_episodes
from agents.rollouts.statistics import paired_difference
from probe_env.schedule import Schedule

PASSES = (
    "probe", "policy", "inspects", "tubes", "reward", "inspection_time_s", "share_within_limit", "gain",
    passes_study.DEPTH,
)  # fmt: skip

BACK = ("fast-in", "steady-back", "slow-back")
"""Schedules that look on the way back."""
FORTH = ("tension-scheduled", "best-schedule")
"""Policies that look on the way in."""
PAIRED = (("steady-back", "tension-scheduled"), ("slow-back", "best-schedule"))
"""Looking on the way back, and the policy of the way in that takes about as long with table 2's probe."""

WAITS = {
    "page": ("from the command to a page that can be used", 1.0, "s"),
    "first_run": ("from the command to the first finished run, at `fast`", 1.0, "s"),
    "run": ("a run that the page offers: the example beside `best-schedule`, at `fast`", 1.0, "s"),
    "insertion": ("one insertion alone, the study's 0.2 m/s, at `fast`", 1.0, "s"),
    "insertion_without_page": ("the same without a page", 1.0, "s"),
    "best_schedule": ("one insertion alone by `best-schedule`, at `fast`", 1.0, "s"),
    "best_schedule_without_page": ("the same without a page", 1.0, "s"),
    "drag": ("from a move of a point to another expectation", 1e3, "ms"),
}
"""What is waited for, and in which unit it is shown."""


def calibrations() -> str:
    """How well calibrations of simulated logs find their truths."""
    figures = read_json(RESULTS / "calibrations" / "summary.json", Figures)
    extra = figures.model_extra or {}
    header = ("", *(unknown.text for unknown in UNKNOWNS.values()))
    rows = [
        (f"{what}, {name}", *(_cell(what, extra[f"{name}: {unknown} {what}"]) for unknown in UNKNOWNS))
        for what in ("covered", "ranks uniform, p")
        for name in SETS
    ]
    errors = ", ".join(f"{extra[f'{name}: friction, median error']:.3f} {name}" for name in SETS)
    wrong = ", ".join(
        f"{100.0 * extra[f'{name}: wrongly misspecified']:.0f} % and {100.0 * extra[f'{name}: wrongly doubtful']:.0f} %"
        f" {name}"
        for name in SETS
    )
    caught = "; ".join(
        f"{world} {100.0 * extra[f'{world}: called misspecified']:.0f} % misspecified,"
        f" {100.0 * extra[f'{world}: called misspecified or doubtful']:.0f} % that or doubtful"
        for world in WORLDS
    )
    alone = f"{extra['tension alone: friction, median error']:.3f}"
    covered = f"{100.0 * extra['tension alone: friction covered']:.0f} %"
    return (
        f"{extra['logs']} simulated logs at `standard` with friction, stiffness, drag, damping, bore, length, helix"
        f" diameter and schedule drawn at random:\n\n{markdown(header, rows)}\n\n"
        f"The median error of the friction is {errors}; by the tension alone {alone}; its intervals cover {covered}."
        f" Called misspecified and doubtful although the model made them: {wrong}."
        f" Of {extra[f'{WORLDS[0]}: logs']} logs of each other world: {caught} (the tension times 1.5; what was felt"
        f" {SHIFT:g} s late; numbers drawn at random). {_source(figures)}"
    )


def recommendations() -> str:
    """What recommendations gain."""
    figures = read_json(RESULTS / "recommendations" / "summary.json", Figures)
    extra = figures.model_extra or {}
    return (
        f"On {extra['tubes']} simulated tubes of bores, lengths and frictions of their own, each calibrated on one log"
        f" (another schedule than what is compared), the recommended schedule has {extra['gain']:+.1f}"
        f" [{extra['gain, low']:.1f}, {extra['gain, high']:.1f}] of reward against the shipped `best-schedule`:"
        f" {100.0 * extra['share of what knowing brings']:.0f} % of the {extra['gain by knowing the tube']:+.1f} that"
        f" knowing the tube would bring. {_source(figures)}"
    )


def plants() -> str:
    """Policies in plants of other bores and lengths."""
    folder = RESULTS / "plants"
    summary, figures = (
        stored_table(folder / "gains.csv", "plant", "policy", "gain", "low", "high"),
        read_json(folder / "provenance.json", Record),
    )
    by_tension = summary[summary["policy"] == "tension-scheduled"]
    worse = by_tension[by_tension["high"] < 0.0]["plant"].tolist()
    verdict = (
        f"`tension-scheduled` is worse by more than scatter in {', '.join(worse)}"
        if worse
        else "`tension-scheduled` is nowhere worse by more than scatter"
    )
    record = figures.model_dump()
    return (
        f"{markdown(plants_study.HEADER, plants_study.cells(summary))}\n\n"
        f"Reward less that of the best fixed schedule for the plant, simulated at `{record['fidelity']}` in"
        f" {record['limit']} tubes of each, paired, with 95 % intervals: {verdict}; an interval around zero shows"
        " nothing either way. `recommended-law` is the law that `probe-env recommend --policy` makes for the plant."
        f" Made by `{command(record)}` at commit {record['commit']}."
    )


def passes() -> str:
    """Where it is worth to look."""
    folder = RESULTS / "passes"
    summary, figures = stored_table(folder / "passes.csv", *PASSES), read_json(folder / "provenance.json", Record)
    entries: list[dict[str, Any]] = summary.to_dict("records")  # type: ignore[assignment]
    of_original = {(entry["policy"], entry["inspects"]): entry for entry in entries if entry["probe"] == "original"}
    improved = next(e for e in entries if (e["probe"], e["policy"], e["inspects"]) == ("improved", "fast-in", "best"))
    way_back = ", ".join(_way_back(name, of_original[name, "back"]) for name in BACK)
    way_in = " and ".join(_way_in(name, of_original[name, "in"]) for name in FORTH)
    either = " and ".join(_depth(of_original[name, "best"]) for name in FORTH)
    best = {
        probe: max((entry for entry in entries if entry["probe"] == probe), key=lambda entry: float(entry["reward"]))
        for probe in passes_study.PROBES
    }
    record, speeds = figures.model_dump(), {name: _speeds(name) for name in BACK}
    fed = ", ".join(f"`{name}` {forth:g} and {back:g} m/s" for name, (forth, back) in speeds.items())
    return (
        f"**With table 2's probe, fed in fast, flaws are found on the way back {way_back}. On the way in they are found"
        f" {way_in}; from {either} on where the way back, at full speed, is looked at as well.**"
        f" With the improved probe {_depth(improved)} takes {improved['inspection_time_s']:.0f} s, at full speed and"
        " looking both ways. Shares are of the wall, times of both ways. The most reward in millimetres has"
        f" {_best(best['original'])} with table 2's probe, and {_best(best['improved'])} with the study's improved"
        f" one.\n\n{_paired()}\n\n"
        f"{markdown(passes_study.FOUND, passes_study.found_cells(summary))}\n\n"
        "Reward, and in brackets what it is more than that of looking on the way in by"
        f" `{passes_study.BESIDE}`, paired, with 95 % intervals:\n\n"
        f"{markdown(passes_study.REWARDS, passes_study.reward_cells(summary))}\n\n"
        f"Simulated at `{record['fidelity']}`, means over {record['limit']} test tubes, which are balanced over the"
        " diameters. Policies of the way in come back as fast as the device can. `original` is table 2's probe,"
        f" `improved` the study's. Fed in and drawn back: {fed}. a90/95 is the depth that is found with 90 % over the"
        " tubes, with 95 % confidence; `either` is what is found where either way calls it, each with half of the false"
        f" calls. Made by `{command(record)}` at commit {record['commit']}."
    )


def _paired() -> str:
    """What looking on the way back finds beside policies of the way in, tube by tube."""
    table, lines = read_episodes(RESULTS / "passes" / "episodes.csv"), []
    for probe in passes_study.PROBES:
        part = table[table["probe"] == probe]
        seconds = part.groupby("policy")["inspection_time_s"].mean()
        part = part.assign(policy=part["policy"] + "/" + part["inspects"])
        for back, forth in PAIRED:
            alone, either = (
                paired_difference(part, f"{back}/back", f"{forth}/{looks}", "a90_percent_wall").text()
                for looks in ("in", "best")
            )
            lines.append(
                f"`{back}` ({probe}, {seconds[back]:.0f} s) {alone} beside `{forth}` ({seconds[forth]:.0f} s), {either}"
                " where its way back counts too"
            )
    return f"a90 of the way back less that of the way in, paired, with 95 % intervals [% wall]: {'; '.join(lines)}."


def _speeds(name: str) -> tuple[float, float]:
    """Feed of a shipped schedule on the way in and on the way back [m/s]."""
    path = Path("configs") / "schedules" / f"{name}.csv"
    forth, back = Schedule.read(path), Schedule.read_back(path)
    assert back is not None
    return forth.feed_speed[0], back.feed_speed[0]


def _way_back(name: str, entry: dict[str, Any]) -> str:
    return f"from {_depth(entry)} on at {_speeds(name)[1]:g} m/s ({entry['inspection_time_s']:.0f} s)"


def _way_in(name: str, entry: dict[str, Any]) -> str:
    return f"from {_depth(entry)} on by `{name}` ({entry['inspection_time_s']:.0f} s)"


def _depth(entry: dict[str, Any]) -> str:
    return f"{entry[passes_study.DEPTH]:.0f} %"


def answers() -> str:
    """How long what takes, median and longest."""
    folder = RESULTS / "app"
    measured, rows = stored_table(folder / "answers.csv", "wait", "seconds").groupby("wait")["seconds"], []
    for name, (what, factor, unit) in WAITS.items():
        values = factor * measured.get_group(name)
        rows.append((what, f"{values.median():.3g} {unit}", f"{values.max():.3g} {unit}", len(values)))
    return f"{markdown(('', 'median', 'longest', 'of'), rows)}\n\n{source(folder / 'provenance.json')}"


def _best(entry: dict[str, Any]) -> str:
    return f"`{entry['policy']}` looking at {passes_study.LOOKS[entry['inspects']]}"


def _cell(what: str, value: float) -> str:
    return f"{100.0 * value:.0f} %" if what == "covered" else f"{value:.2g}"


def _source(figures: Figures) -> str:
    record = figures.provenance.model_dump()
    return f"Made by `{command(record)}` at commit {record['commit']}, {record['machine']['processor']}."
