"""Evaluates policies on the same tubes: means, paired differences, tables and a report."""

import errno
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import pandas as pd

from probe_agents.evaluation import statistics
from probe_agents.evaluation.advice import Rows, choose, compare_passes
from probe_agents.evaluation.folder import EPISODE_RECORDS, ReportSettings, is_evaluation, read_evaluation
from probe_agents.evaluation.kpis import SCORED_PASSES, displayed_kpis, goal_of, heading
from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.evaluation.repeat import verdict_text
from probe_agents.evaluation.report import FEW_TUBES, ended, oracle_policies, verdicts
from probe_agents.evaluation.report import write_report as write_report
from probe_agents.evaluation.statistics import Interval, method_and_seed
from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.policies.cases import EvaluationCase, read_case
from probe_agents.policies.catalogue import domains_of, is_schedule_file, name_and_spec, named_policies, user_policies
from probe_agents.policies.policy import check_domains
from probe_agents.policies.wrappers import RoundTripPolicy, SpeedLimited
from probe_agents.records.manifest import write_json
from probe_agents.terminal.tables import print_line, print_table
from probe_env.envs.contexts import Split
from probe_env.envs.episodes import Episodes
from probe_env.envs.episodes.starts import Probes
from probe_env.envs.task.config import ScoredPass
from probe_env.envs.trials import PlanningPolicy
from probe_env.fidelity import Fidelity
from probe_env.settings import explain


def evaluate(
    policies: Sequence[str],
    output: Path | None = None,
    *,
    tube: Path | None = None,
    contexts: Split = "test",
    limit: int = 0,
    seeds: int = 1,
    fidelity: str | Fidelity = "fast",
    probes: Probes = "scene",
    passes: Literal["in", "both"] | None = None,
    scored_pass: ScoredPass | None = None,
    against: str | None = None,
    strict: bool = False,
    workers: Workers = HERE,
) -> pd.DataFrame:
    """Evaluate policies on the same tubes and seeds; returns KPIs with one row per episode.

    Args:
        policies: names, schedule files, feedback laws or agents' bundles, see ``catalogue.make_policy``.
        output: folder of the tables and the report; stored episodes are not run again; None: no files.
        tube: file or name of a plant; None: the shipped lists of tubes.
        contexts: shipped list of tubes.
        limit: number of tubes, the first of the list; 0: all.
        seeds: number of seeds of sensor noise and start for every tube.
        fidelity: preset or settings of the simulation.
        probes: "scene", or "random" for a random probe in every tube and seed.
        passes: "in", or "both" for insertion and withdrawal; default: as in the tube's file.
        scored_pass: the pass that is scored with both passes; default: the better one in each metre.
        against: reference policy of the comparison; default: the first.
        strict: raise if a policy was not made for these tubes, instead of a warning.
        workers: workers that run the episodes.
    """
    case = read_case(tube, contexts, limit, passes, scored_pass)
    plan = plan_of(policies, case, seeds, fidelity, probes, strict)
    if output is None:
        return run_plan(plan, None, workers=workers)
    users = user_policies(policies)
    report_settings(plan, against, users)  # an unknown reference is refused before the folder is made
    plan.folder(output).check(EPISODE_RECORDS)
    output.mkdir(parents=True, exist_ok=True)
    tubes = len(plan.contexts)
    print_line(f"evaluation of {', '.join(plan.policies)} in {tubes} {'tubes' if tubes > 1 else 'tube'}")
    return evaluate_plan(plan, output, against, workers, users)


def plan_of(
    specs: Sequence[str],
    case: EvaluationCase,
    seeds: int,
    fidelity: str | Fidelity,
    probes: Probes = "scene",
    strict: bool = False,
) -> Plan:
    """The plan of named policies on the tubes of a case; warns about policies that were not made for them."""
    if not 1 <= seeds <= 1000:
        raise ValueError(f"seeds = {seeds!r} is outside the accepted range 1 to 1000")
    config = case.config.full_observation
    policies = named_policies(specs, config, case.vibration, classes=True)
    inner = {name: p.insertion if isinstance(p, RoundTripPolicy) else p for name, p in policies.items()}
    check_domains(domains_of(specs, inner), config, case.contexts, strict)
    if config.permitted_feed < config.feed_speeds[1]:  # schedule files are played as written, and judged
        as_written = {name_and_spec(spec)[0] for spec in specs if is_schedule_file(spec)}
        policies = {
            name: policy if name in as_written or isinstance(policy, PlanningPolicy) else SpeedLimited(config, policy)
            for name, policy in policies.items()
        }
    try:
        episodes = Episodes(
            1, config, contexts=case.contexts, probes=probes, fidelity=fidelity, surrogate_map=case.vibration
        )
        episodes.check(case.contexts if probes == "scene" else ())  # others are drawn when an episode starts
    except ValueError as error:
        raise ValueError(f"{case.plant_label.name}: {explain(error)}") from error
    bundle = case.plant.bundle_for(config) if case.plant else None
    plant = case.plant_label.name if case.plant_label.title else None
    return Plan(policies, case.contexts, range(seeds), config, episodes.fidelity, probes, case.vibration, bundle, plant)


def evaluate_plan(
    plan: Plan,
    output: Path,
    against: str | None = None,
    workers: Workers = HERE,
    users: Sequence[str] = (),
    sensitivity: Rows | None = None,
) -> pd.DataFrame:
    """Run a plan in a folder, write tables, summary.csv, bundle.csv and report.html, and print the means.

    Args:
        plan: the evaluation; policies named NAME@K are training seeds of one method.
        output: the folder.
        against: reference policy of the comparison; default: the first.
        workers: workers that run the episodes.
        users: policies of the user, for the headline of the report; default: ``against``.
        sensitivity: of a recommendation, see ``ReportSettings``.
    """
    report = report_settings(plan, against, users).model_copy(update={"sensitivity": sensitivity})
    table = run_plan(plan, output, workers=workers, report=report)
    write_report(output)
    if plan.config.returns:
        print(f"Insertion and withdrawal; scored is {SCORED_PASSES[plan.config.scored_pass]}")
    done = read_evaluation(output)
    print_summary(done.table, report.against)
    for policy, (verdict, _) in verdicts(done).items():
        print(f"{policy}: {verdict_text(verdict)}")
    if plan.bundle:
        hours = statistics.bundle_rows(statistics.bundle_table(done.table, plan.bundle))
        print_table(f"Hours for {plan.bundle.tubes} tubes with 95 % intervals", statistics.BUNDLE_HEADER, hours)
    if goal_of(done.table.columns) != "reward":
        policy, sentence, choice = choose(done.table, oracle_policies(done))
        title = "Which schedule, of those within the limits; second row on: difference to the first"
        print_table(title, choice[0], choice[1:], left=2)
        print_line(sentence)
        if passes := compare_passes(done.table, policy, plan.config, plan.bundle):
            print_table("Way in or way out; the way out as calculated, see the report", passes[0], passes[1:])
    files = "report.html, episodes.csv, episodes.parquet, profile.parquet, summary.csv"
    print_line(f"written: {output}/ ({files}{', bundle.csv' if plan.bundle else ''})")
    return table


def report_settings(plan: Plan, against: str | None, users: Sequence[str]) -> ReportSettings:
    """Reference policy and the user's policies for the report, by the names of methods."""
    methods = [method_and_seed(name)[0] for name in plan.policies]
    reference = method_and_seed(against)[0] if against and against in plan.policies else against or methods[0]
    if reference not in methods:
        raise ValueError(f"against = {against!r} is not one of the policies: {', '.join(plan.policies)}")
    names = tuple(dict.fromkeys(method_and_seed(name)[0] for name in users))
    return ReportSettings(against=reference, user_policies=names, bundle=plan.bundle, plant=plan.plant)


def report_again(folder: Path, against: str | None = None) -> Path:
    """Write the report of a stored or interrupted evaluation again; returns its path."""
    if not is_evaluation(folder):
        raise FileNotFoundError(errno.ENOENT, "no evaluation is stored there", str(folder / "setting.json"))
    if against is not None:
        done = read_evaluation(folder)
        policies = list(dict.fromkeys(done.table["policy"]))
        if against not in policies:
            raise ValueError(f"against = {against!r} is not one of the policies: {', '.join(policies)}")
        write_json(folder / "report.json", done.report.model_copy(update={"against": against}).to_json())
    return write_report(folder)


def print_summary(table: pd.DataFrame, against: str) -> None:
    """Print KPIs with intervals, how episodes ended and differences to a policy."""
    labels, rows = displayed_kpis(table.columns), []
    for policy, part in statistics.summarise(table).groupby("policy", sort=False):
        figures = part.set_index("kpi")[["mean", "low", "high"]]
        rows.append([str(policy), *(Interval(*figures.loc[kpi]).text(label[1]) for kpi, label in labels.items())])
    header = ("policy", *map(heading, labels.values()))
    tubes = table["context"].nunique()
    title = f"Means over {tubes} tubes with 95 % intervals{', too few for exact ones' if tubes < FEW_TUBES else ''}"
    title = title if tubes > 1 else "Means in one tube"
    print_table(title, header, rows)
    for name, row in statistics.endings(table).iterrows():
        print(f"{name}: {ended(row)}")
    for line in (*statistics.strain_lines(table), *statistics.comparison_lines(table, against)):
        print(line)
