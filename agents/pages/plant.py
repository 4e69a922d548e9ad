"""Calibrations and recommendations in words."""

from __future__ import annotations

from agents.calibration.simulated.study import SETS, SHIFT, WORLDS
from agents.calibration.unknowns import UNKNOWNS
from agents.pages.sources import RESULTS, command
from agents.records.models import Figures
from agents.records.reading import read_json


def calibrations() -> str:
    """How well calibrations of simulated logs find their truths."""
    figures = read_json(RESULTS / "calibrations" / "summary.json", Figures)
    told = figures.model_extra or {}
    header = ("", *(unknown.text for unknown in UNKNOWNS.values()))
    rows = [
        (f"{what}, {name}", *(_cell(what, told[f"{name}: {unknown} {what}"]) for unknown in UNKNOWNS))
        for what in ("covered", "ranks uniform, p")
        for name in SETS
    ]
    lines = [f"| {' | '.join(header)} |", "|---" * len(header) + "|", *(f"| {' | '.join(row)} |" for row in rows)]
    errors = ", ".join(f"{told[f'{name}: friction, median error']:.3f} {name}" for name in SETS)
    wrong = ", ".join(
        f"{100.0 * told[f'{name}: wrongly misspecified']:.0f} % and {100.0 * told[f'{name}: wrongly doubtful']:.0f} %"
        f" {name}"
        for name in SETS
    )
    caught = "; ".join(
        f"{world} {100.0 * told[f'{world}: called misspecified']:.0f} % misspecified,"
        f" {100.0 * told[f'{world}: called misspecified or doubtful']:.0f} % that or doubtful"
        for world in WORLDS
    )
    alone = f"{told['tension alone: friction, median error']:.3f}"
    covered = f"{100.0 * told['tension alone: friction covered']:.0f} %"
    return (
        f"{told['logs']} simulated logs at `standard` with friction, stiffness, drag, damping, bore, length, helix"
        f" diameter and schedule drawn at random:\n\n" + "\n".join(lines) + "\n\n"
        f"The median error of the friction is {errors}; by the tension alone {alone}; its intervals cover {covered}."
        f" Called misspecified and doubtful although the model made them: {wrong}."
        f" Of {told[f'{WORLDS[0]}: logs']} logs of each other world: {caught} (the tension times 1.5; what was felt"
        f" {SHIFT:g} s late; numbers drawn at random). {_source(figures)}"
    )


def recommendations() -> str:
    """What recommendations gain."""
    figures = read_json(RESULTS / "recommendations" / "summary.json", Figures)
    told = figures.model_extra or {}
    return (
        f"On {told['tubes']} simulated tubes of bores, lengths and frictions of their own, each calibrated on one log"
        f" (another schedule than what is compared), the recommended schedule has {told['gain']:+.1f}"
        f" [{told['gain, low']:.1f}, {told['gain, high']:.1f}] of reward against the shipped `best-schedule`:"
        f" {100.0 * told['share of what knowing brings']:.0f} % of the {told['gain by knowing the tube']:+.1f} that"
        f" knowing the tube would bring. {_source(figures)}"
    )


def _cell(what: str, value: float) -> str:
    return f"{100.0 * value:.0f} %" if what == "covered" else f"{value:.2g}"


def _source(figures: Figures) -> str:
    record = figures.provenance.model_dump()
    return f"Made by `{command(record)}` at commit {record['commit']}, {record['machine']['processor']}."
