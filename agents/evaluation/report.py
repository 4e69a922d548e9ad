"""The evaluation as a command: run it, print it, and write its page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import pandas as pd
from pydantic import ValidationError

from agents.evaluation.fidelity_check import Checks, run_checks
from agents.evaluation.page.stored import compared_with as compared_with
from agents.evaluation.page.writing import write_report as write_report
from agents.evaluation.passes import LOOKS
from agents.policies.both_ways import BothWays
from agents.policies.catalogue import domains_of, named_policies
from agents.policies.domain import check_domains
from agents.policies.places import Place
from agents.processes.workers import HERE, Workers
from agents.records.columns import shown_of
from agents.records.provenance import write_json
from agents.rollouts.bootstrap import Interval, short
from agents.rollouts.plan import Plan, run_plan, stored_episodes
from agents.rollouts.statistics import endings, grouped, in_words, method_and_seed, sentences, summarise
from agents.rollouts.strain import strained
from agents.terminal.tables import print_table
from probe_env.envs.episodes.starts import Probes, Starts, settling
from probe_env.envs.surrogate import make_episodes
from probe_env.fidelity import Fidelity, resolve_fidelity
from probe_env.settings import explain


def plan_of(
    specs: Sequence[str],
    place: Place,
    seeds: int,
    fidelity: str | Fidelity,
    probes: Probes = "scene",
    strict: bool = False,
) -> Plan:
    """Named policies in a place, so many seeds each; those that were not made for its tubes are told, or refused.

    Raises:
        ValueError: an argument is not valid, or ``strict`` and a policy was not made for these tubes.
    """
    if not 1 <= seeds <= 1000:
        raise ValueError(f"seeds = {seeds!r} is outside the accepted range 1 to 1000")
    config = place.config.all_shown
    policies = named_policies(specs, config, place.vibration)
    forth = {name: policy.forth if isinstance(policy, BothWays) else policy for name, policy in policies.items()}
    check_domains(domains_of(specs, forth), config, place.contexts, strict)
    hardest = Starts(config, place.contexts, probes, *settling(config, {})).stiffest
    chosen = resolve_fidelity(fidelity, hardest, config.growing, config.returns)
    plan = Plan(policies, place.contexts, range(seeds), config, chosen, probes, place.vibration)
    check_begins(plan, place.tube.name)
    return plan


def check_begins(plan: Plan, tubes: str) -> None:
    """Raise ValueError if an episode could not even begin, before anything is run or written; ``tubes`` is whose.

    Probes that are drawn anew for every tube and seed are as they come.
    """
    if plan.probes == "random":
        return
    try:
        episodes = make_episodes(1, plan.config, threads=1, fidelity=plan.fidelity, surrogate_map=plan.vibration)
        for context in plan.contexts:
            episodes.check_tube(context)
    except ValidationError as error:
        raise ValueError(f"{tubes}: {explain(error)}") from error
    except ValueError as error:
        raise ValueError(f"{tubes}: {error}") from error


NO_CHECKS: Final = Checks()


def evaluate(
    plan: Plan, output: Path, checks: Checks = NO_CHECKS, against: str | None = None, workers: Workers = HERE,
    own: Sequence[str] = (),
) -> pd.DataFrame:  # fmt: skip
    """Evaluate policies; writes the tables, summary.csv and report.html.

    Policies named NAME@K are training seeds of one method and are gathered in what is printed. ``against`` is the
    policy that the others are compared with; default: the first. ``own`` are those that the report judges first;
    default: ``against``.

    Raises:
        ValueError: an argument is not valid; nothing was run.
    """
    if plan.probes == "random" and checks.level in ("replayed", "all"):
        raise ValueError(
            f"check_fidelity = {checks.level!r} replays tube by tube, for which other probes are drawn:"
            " with probes = 'random' it must be no, half-step or acting"
        )
    if plan.config.returns and checks.level in ("replayed", "all"):
        raise ValueError(
            f"check_fidelity = {checks.level!r} replays what was fed over the inserted length, which is kept for the"
            " way in alone: with --passes both it must be no, half-step or acting"
        )
    reference = claim_folder(plan, output, against, own)
    table = run_plan(plan, output, workers=workers)
    write_report(output)
    if plan.config.returns:
        print(f"Fed in and drawn back; what counts is {LOOKS[plan.config.inspects]}")
    print_summary(grouped(table), reference)
    run_checks(checks, plan, table, output, workers)
    print(f"written: {output}/ (report.html, episodes.csv, episodes.parquet, profile.parquet, summary.csv)")
    return table


def claim_folder(plan: Plan, output: Path, against: str | None, own: Sequence[str]) -> str:
    """Note in a folder what its report is to compare; gives the policy that the others are compared with.

    Raises:
        ValueError: there is no such policy, or the folder holds another evaluation; nothing was written.
    """
    methods = [method_and_seed(name)[0] for name in plan.policies]
    reference = method_and_seed(against)[0] if against and against in plan.policies else against or methods[0]
    if reference not in methods:
        raise ValueError(f"against = {reference!r} is not one of the policies: {', '.join(plan.policies)}")
    stored_episodes(plan, output)  # refuses a folder before anything is written to it
    mine = list(dict.fromkeys(method_and_seed(name)[0] for name in own))
    write_json(output / "report.json", {"against": reference, "own": mine})
    return reference


def print_summary(table: pd.DataFrame, against: str) -> None:
    """KPIs with intervals and the comparison in words, on the terminal."""
    header = ("policy", *(f"{name} [{unit}]" if unit else name for name, _, unit in shown_of(table.columns).values()))
    rows = ((policy, *cells) for policy, cells in kpi_cells(table))
    print_table("Means with 95 % intervals over the contexts", header, rows)
    for name, row in endings(table).iterrows():
        print(f"{name}: {row['complete']} of {row['episodes']} complete, {', '.join(in_words(row))}")
    for line in (*strained(table), *sentences(table, against)):
        print(line)


def kpi_cells(table: pd.DataFrame) -> list[tuple[str, list[str]]]:
    """For every policy its KPIs as text, in the units for people."""
    summary, rows = summarise(table), []
    for policy in dict.fromkeys(summary["policy"]):
        part = summary[summary["policy"] == policy].set_index("kpi")
        cells = []
        for kpi, (_, factor, _) in shown_of(table.columns).items():
            row = part.loc[kpi]
            mean, low, high = row["mean"], row["low"], row["high"]
            # of no width, as of one tube, an interval says nothing
            cells.append(Interval(mean, low, high).text(factor) if low < high else short(mean * factor))
        rows.append((str(policy), cells))
    return rows
