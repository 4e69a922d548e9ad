"""The evaluation as a command: run it, print it, and write one self-contained HTML page."""

from __future__ import annotations

import base64
import errno
import json
import tempfile
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Final

import pandas as pd
from jinja2 import Environment, StrictUndefined

from agents.evaluation import figures
from agents.evaluation.fidelity_check import Checks, run_checks
from agents.policies.catalogue import domains_of, named_policies
from agents.policies.domain import check_domains
from agents.policies.places import Place
from agents.processes.workers import HERE, Workers
from agents.records.columns import KPIS
from agents.records.models import Compared, Evaluated, Setting
from agents.records.provenance import write_atomically, write_json
from agents.records.reading import FileError, read_csv, read_json, read_parquet
from agents.records.tables import EPISODES, FRONT, PROFILE
from agents.rollouts.plan import Plan, run_plan
from agents.rollouts.statistics import Interval, endings, grouped, method_and_seed, sentences, summarise
from agents.terminal.tables import print_table
from probe_env.envs.starts import Probes
from probe_env.fidelity import resolve_fidelity


def plan_of(
    specs: Sequence[str], place: Place, seeds: int, fidelity: str, probes: Probes = "scene", strict: bool = False
) -> Plan:
    """Named policies in a place, so many seeds each; those that were not made for its tubes are told, or refused.

    Raises:
        ValueError: an argument is not valid, or ``strict`` and a policy was not made for these tubes.
    """
    if not 1 <= seeds <= 1000:
        raise ValueError(f"seeds = {seeds!r} is outside the accepted range 1 to 1000")
    config = place.config.all_shown
    policies = named_policies(specs, config, place.vibration)
    check_domains(domains_of(specs, policies), config, place.contexts, strict)
    return Plan(policies, place.contexts, range(seeds), config, resolve_fidelity(fidelity), probes)


NO_CHECKS: Final = Checks()


def evaluate(
    plan: Plan, output: Path, checks: Checks = NO_CHECKS, against: str | None = None, workers: Workers = HERE
) -> pd.DataFrame:
    """Evaluate policies; writes the tables, summary.csv and report.html.

    Policies named NAME@K are training seeds of one method and are gathered in what is printed. ``against`` is the
    policy that the others are compared with; default: the first.

    Raises:
        ValueError: an argument is not valid; nothing was run.
    """
    if plan.probes == "random" and checks.level in ("replayed", "all"):
        raise ValueError(
            f"check_fidelity = {checks.level!r} replays tube by tube, for which other probes are drawn:"
            " with probes = 'random' it must be no, half-step or acting"
        )
    methods = [method_and_seed(name)[0] for name in plan.policies]
    reference = method_and_seed(against)[0] if against and against in plan.policies else against or methods[0]
    if reference not in methods:
        raise ValueError(f"against = {reference!r} is not one of the policies: {', '.join(plan.policies)}")
    table = run_plan(plan, output, workers=workers)
    write_json(output / "report.json", {"against": reference})
    write_report(output)
    print_summary(grouped(table), reference)
    run_checks(checks, plan, table, output, workers)
    print(f"written: {output}/ (report.html, episodes.csv, episodes.parquet, profile.parquet, summary.csv)")
    return table


def print_summary(table: pd.DataFrame, against: str) -> None:
    """KPIs with intervals and the comparison in words, on the terminal."""
    header = ("policy", *(f"{name} [{unit}]" if unit else name for name, _, unit in KPIS.values()))
    rows = ((policy, *cells) for policy, cells in kpi_cells(table))
    print_table("Means with 95 % intervals over the contexts", header, rows)
    for name, row in endings(table).iterrows():
        print(
            f"{name}: {row['complete']} of {row['episodes']} complete, {row['lost_drive']} lost drive,"
            f" {row['diverged']} diverged"
        )
    for line in sentences(table, against):
        print(line)


def kpi_cells(table: pd.DataFrame) -> list[tuple[str, list[str]]]:
    """For every policy its KPIs as text, in the units for people."""
    summary, rows = summarise(table), []
    for policy in dict.fromkeys(summary["policy"]):
        part = summary[summary["policy"] == policy].set_index("kpi")
        cells = []
        for kpi, (_, factor, _) in KPIS.items():
            row = part.loc[kpi]
            cells.append(Interval(row["mean"], row["low"], row["high"]).text(factor))
        rows.append((str(policy), cells))
    return rows


def write_report(folder: Path) -> Path:
    """Write summary.csv and report.html from the tables stored in a folder.

    Raises:
        FileNotFoundError: no evaluation is stored there.
    """
    stored = [folder / f"{name}.parquet" for name in ("episodes", "profile")]
    for path in stored:
        if not path.exists():
            raise FileNotFoundError(errno.ENOENT, "no evaluation is stored there", str(path))
    table, profile = grouped(read_parquet(stored[0], EPISODES)), grouped(read_parquet(stored[1], PROFILE))
    if not set(profile["policy"]) <= set(table["policy"]):
        raise FileError(stored[1], "of policies that are not in episodes.parquet: evaluate again into this folder")
    against = compared_with(folder, table)
    record = read_json(folder / "provenance.json", Evaluated).model_dump()
    setting = read_json(folder / "setting.json", Setting)
    swept = folder.parent / "tradeoff" / "front.csv"
    fronts = read_csv(swept, FRONT) if swept.exists() else None
    write_atomically(folder / "summary.csv", summarise(table).to_csv(index=False, float_format="%.6g"))
    ends = endings(table)
    template = Environment(undefined=StrictUndefined, autoescape=True).from_string(
        files("agents.evaluation").joinpath("templates/report.html").read_text()
    )
    page = template.render(
        title="Feed policies compared",
        episodes=len(table),
        policies=table["policy"].nunique(),
        contexts=table["context"].nunique(),
        seeds=table["seed"].nunique(),
        sentences=sentences(table, against),
        kpi_names=["policy", *(f"{name} [{unit}]" if unit else name for name, _, unit in KPIS.values())],
        kpi_rows=[[policy, *cells] for policy, cells in kpi_cells(table)],
        endings=[[policy, *row[["episodes", "complete", "lost_drive", "diverged"]]] for policy, row in ends.iterrows()],
        pictures=_pictures(table, profile, fronts),
        record=(
            f"Command: {record['command']}. Commit {record['commit']}, {record['machine']['cores']} cores"
            f" ({record['machine']['processor']}), {', '.join(f'{k} {v}' for k, v in record['packages'].items())}."
            f" Fidelity: {setting.fidelity}."
        ),
        settings=json.dumps(record["policies"], indent=1),
    )
    path = folder / "report.html"
    write_atomically(path, page)
    return path


def compared_with(folder: Path, table: pd.DataFrame) -> str:
    """The policy that a stored evaluation compares the others with; the first, if it does not say."""
    path = folder / "report.json"
    if not path.exists():
        return str(table["policy"].iloc[0])
    against = read_json(path, Compared).against
    if against not in set(table["policy"]):
        raise FileError(path, f"against = {against!r} is not one of the policies: {', '.join(set(table['policy']))}")
    return against


def _pictures(table: pd.DataFrame, profile: pd.DataFrame, fronts: pd.DataFrame | None) -> list[tuple[str, str, str]]:
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        drawn = [
            (
                "Time against vibration",
                "Each policy's mean over the tubes, bars are 95 % intervals. Down and left is better.",
                figures.trade_off(summarise(table), folder / "trade-off.png"),
            ),
            (
                "Over the inserted length",
                "Feed speed, air supply and radial vibration by policy: mean over the tubes; for vibration also the"
                " loudest tenth (thin lines).",
                figures.policy_profiles(profile, folder / "profiles.png"),
            ),
            (
                "Worst episodes",
                "Of each policy the episode with the lowest reward: what it did and felt.",
                figures.worst_episodes(table, profile, folder / "worst.png"),
            ),
        ]
        if fronts is not None:
            text = "What families of policies reach when one of their parameters is swept (probe-env tradeoff)."
            drawn.insert(1, ("Fronts", text, figures.front(fronts, folder / "front.png")))
        return [(name, text, base64.b64encode(path.read_bytes()).decode()) for name, text, path in drawn]
