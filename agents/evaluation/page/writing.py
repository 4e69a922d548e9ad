"""Writing the page: one HTML file that needs no network, and no JavaScript but for the interactive pictures."""

from __future__ import annotations

import base64
import json
import tempfile
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import pandas as pd
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from agents.detection.pictures import curves
from agents.evaluation import figures
from agents.evaluation.page.described import descriptions, informed, within
from agents.evaluation.page.schedules import downloads
from agents.evaluation.page.stored import Evaluation, read_evaluation
from agents.evaluation.page.tables import by_diameter, by_tube, ranked
from agents.evaluation.page.traces import traces
from agents.evaluation.page.verdict import MEASURES, Verdict, limit_of, ranking, verdict
from agents.evaluation.passes import LOOKS
from agents.policies.fixed import Replayed, Scheduled
from agents.records.drawing import MM
from agents.records.provenance import write_atomically
from agents.records.reading import read_csv
from agents.records.tables import FRONT
from agents.rollouts import depths
from agents.rollouts.statistics import sentences, summarise
from agents.rollouts.strain import strained
from probe_env.fidelity import BOTH_WAYS, PRESETS

SHOWN: Final = 4
"""Policies that the interactive pictures begin with."""
SCHEDULES: Final = (Scheduled.__name__, Replayed.__name__)
MOST_LISTED: Final = 60
"""Numbers of a list in the settings of a policy; of a longer one the first are shown."""


def write_report(folder: Path) -> Path:
    """Write report.html from what is stored in a folder, and summary.csv if the evaluation is finished.

    Raises:
        FileNotFoundError: no evaluation is stored there.
        FileError: a file is damaged.
    """
    done = read_evaluation(folder)
    swept = folder.parent / "tradeoff" / "front.csv"
    fronts = read_csv(swept, FRONT) if swept.exists() else None
    summary = summarise(done.table)
    if done.missing is None:
        write_atomically(folder / "summary.csv", summary.to_csv(index=False, float_format="%.6g"))
    page = _template().render(**_content(done, summary), pictures=_pictures(done, summary, fronts))
    path = folder / "report.html"
    write_atomically(path, page)
    return path


def _template() -> Any:
    environment = Environment(undefined=StrictUndefined, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    parts = {name: Markup(_read(name)) for name in ("report.css", "report.js", "uPlot.iife.min.js", "uPlot.min.css")}
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":")}
    environment.globals["part"] = parts.__getitem__
    return environment.from_string(_read("report.html"))


def _read(name: str) -> str:
    return files("agents.evaluation.page").joinpath("templates", name).read_text(encoding="utf-8")


def _content(done: Evaluation, summary: pd.DataFrame) -> dict[str, Any]:
    """What stands in the template, but the pictures."""
    table, task = done.table, done.setting.task
    described, knowing = descriptions(done), informed(done)
    kinds = {name: within(given).get("policy") for name, given in described.items()}
    order = ranking(table)
    verdicts = [verdict(table, policy, knowing, limit_of(task)) for policy in done.own or (done.against,)]
    offered, without = downloads(described, table, done.profile, task.returns)
    return {
        "title": "Feed policies compared",
        "verdicts": verdicts,
        "own": {name: f"Your {'schedule' if kinds.get(name) in SCHEDULES else 'policy'}" for name in done.own},
        "missing": done.missing,
        "facts": _facts(done),
        "ranked": ranked(table, summary, done.own, knowing),
        "told": sorted(knowing & set(order), key=order.index),
        "strained": strained(table),
        "against": done.against,
        "sentences": sentences(table, done.against),
        "by_diameter": by_diameter(table, knowing),
        "by_tube": by_tube(table, knowing),
        "downloads": offered,
        "without": without,
        "traces": traces(table, done.profile, _shown(done, verdicts, knowing), _limit_mm(done)),
        "record": _record(done),
        "settings": json.dumps(_shortened(done.record.policies if done.record else {}), indent=1),
    }


def _shown(done: Evaluation, verdicts: list[Verdict], knowing: set[str]) -> list[str]:
    """The policies that are judged, what they are compared with, and the best."""
    best = [name for name in ranking(done.table) if name not in knowing]
    return list(dict.fromkeys([*(v.policy for v in verdicts), *best[:2], done.against, *best]))[:SHOWN]


def _limit_mm(done: Evaluation) -> float | None:
    task = done.setting.task
    return task.limit * MM if task.vibration_measure == "displacement" else None


def _facts(done: Evaluation) -> list[tuple[str, str]]:
    """What the figures hold for: limit, tubes, policies, simulation."""
    table, task, scene = done.table, done.setting.task, done.setting.task.scene
    tubes = table.drop_duplicates("context")
    measure = MEASURES[task.vibration_measure][0]
    drawn = [f"bore {scene.tube.inner_diameter * MM:g} mm, helix {scene.tube.helix_length:g} m"]
    if (tubes["helix_diameter"] > 0.0).all():
        for name, what, factor, unit in (
            ("helix_diameter", "helix diameter", 1.0, " m"), ("friction", "friction", 1.0, ""),
            ("contact_stiffness", "contact stiffness", 1e-3, " kN/m"), ("drag_factor", "drag factor", 1.0, ""),
        ):  # fmt: skip
            low, high = tubes[name].min() * factor, tubes[name].max() * factor
            drawn.append(f"{what} {low:.3g}{f' to {high:.3g}' if low < high else ''}{unit}")
    probe = "one for every tube and seed, drawn" if done.setting.probes == "random" else (
        f"cable {scene.probe.cable_diameter * MM:g} mm, floats {scene.probe.carrier_float_diameter * MM:g} mm every"
        f" {scene.probe.float_pitch * MM:g} mm, guide cable {scene.probe.guide_length:g} m"
    )  # fmt: skip
    stored = done.setting.fidelity
    presets = PRESETS | BOTH_WAYS if task.returns else PRESETS
    preset = next((name for name, value in presets.items() if value.model_dump() == stored), str(stored))
    both = [("passes", f"in and back; counted is {LOOKS[task.inspects]}")] if task.returns else []
    return [
        *both,
        ("limit", f"{measure} of {limit_of(task)} at the sensor, {task.period:g} s at a time"),
        ("insertions", f"{len(table)}: {_count(table['policy'].nunique(), 'policy', 'policies')}, each on"
         f" {'the same ' if len(tubes) > 1 else ''}{_count(len(tubes), 'tube', 'tubes')}"),
        ("tubes", "; ".join(drawn)),
        ("probe", probe),
        ("simulated with", preset),
    ]  # fmt: skip


def _count(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"


def _record(done: Evaluation) -> str:
    if done.record is None:
        return "Not known: the evaluation was interrupted."
    record = done.record
    packages = ", ".join(f"{name} {version}" for name, version in record.packages.items())
    return (
        f"Command: {record.command}. Commit {record.commit}, {record.machine.cores} cores"
        f" ({record.machine.processor}), {packages}. Fidelity: {done.setting.fidelity}."
    )


def _shortened(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _shortened(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        rest = [f"and {len(data) - MOST_LISTED} more"] if len(data) > MOST_LISTED else []
        return [*map(_shortened, data[:MOST_LISTED]), *rest]
    return data


def _pictures(done: Evaluation, summary: pd.DataFrame, fronts: pd.DataFrame | None) -> list[tuple[str, str, str]]:
    """Name, text and PNG in base64 of each."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        drawn = [
            (
                "Time against vibration",
                "Each policy's mean over the tubes, bars are 95 % intervals. Down and left is better.",
                figures.trade_off(summary, folder / "trade-off.png"),
            ),
            (
                "Mean over the tubes",
                "Feed speed, air supply and radial vibration over the inserted length by policy; for vibration also the"
                " loudest tenth (thin lines).",
                figures.policy_profiles(done.profile, folder / "profiles.png", _limit_mm(done)),
            ),
        ]
        if depths.tells(done.table):
            text = (
                "Probability that a flaw is called over its depth, mean over the tubes' length, with 95 % bands over"
                " the tubes. Depths are relative to the two anchors of the sensor (docs/inspection/signal.md)."
            )
            drawn.append(("What is found", text, curves(depths.bands(done.table), folder / "pod.png")))
        if fronts is not None:
            text = "What families of policies reach when one of their parameters is swept (probe-env tradeoff)."
            drawn.insert(1, ("Fronts", text, figures.front(fronts, folder / "front.png")))
        return [(name, text, base64.b64encode(path.read_bytes()).decode()) for name, text, path in drawn]
