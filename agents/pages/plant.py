"""What plants' users read in words: calibrations, recommendations, robustness, the app."""

from __future__ import annotations

from agents.calibration.simulated.study import SETS, SHIFT, WORLDS
from agents.pages.sources import RESULTS, command, markdown, source, stored_table
from agents.plant.prior import UNKNOWNS
from agents.recommendation import plants as plants_study
from agents.records.models import Figures, Record
from agents.records.reading import read_csv, read_json
from agents.robustness import study as robustness_study

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


def robustness() -> str:
    """What policies lose along the axes."""
    folder = RESULTS / "robustness"
    if not folder.exists():
        return "Nothing is stored yet: `probe-env results robustness` makes it."
    summary = read_csv(folder / "robustness.csv", robustness_study.COLUMNS)
    header = robustness_study.header(tuple(dict.fromkeys(summary["policy"])))
    worst = "; ".join(
        f"`{policy}` {loss.mean:+.1f} [{loss.low:.1f}, {loss.high:.1f}] with {name}"
        for policy, (name, loss) in robustness_study.worst_of(summary).items()
    )
    record = read_json(folder / "provenance.json", Record).model_dump()
    return (
        f"What each loses at worst: {worst}.\n\n"
        f"{markdown(header, robustness_study.cells(summary))}\n\n"
        f"Mean reward over {record['limit']} tubes in the task itself, and how it changes, paired tube by tube, with"
        " 95 % intervals; ! where insertions diverged.\n\n"
        "![What every policy loses along every axis](../../results/robustness/robustness.png)\n\n"
        "Control periods of an insertion that were unsafe, and how many of the insertions lost their drive:\n\n"
        f"{markdown(header, robustness_study.cost_cells(summary))}\n\n"
        f"Simulated with `{record['fidelity']}`. {source(folder / 'provenance.json')}"
    )


def answers() -> str:
    """How long what takes, median and longest."""
    folder = RESULTS / "app"
    measured, rows = stored_table(folder / "answers.csv", "wait", "seconds").groupby("wait")["seconds"], []
    for name, (what, factor, unit) in WAITS.items():
        values = factor * measured.get_group(name)
        rows.append((what, f"{values.median():.3g} {unit}", f"{values.max():.3g} {unit}", len(values)))
    return f"{markdown(('', 'median', 'longest', 'of'), rows)}\n\n{source(folder / 'provenance.json')}"


def _cell(what: str, value: float) -> str:
    return f"{100.0 * value:.0f} %" if what == "covered" else f"{value:.2g}"


def _source(figures: Figures) -> str:
    record = figures.provenance.model_dump()
    return f"Made by `{command(record)}` at commit {record['commit']}, {record['machine']['processor']}."
