"""Evaluation, agents, fronts and the solver's check in words."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from agents.evaluation import tradeoff as fronts
from agents.evaluation.fidelity_check import words
from agents.evaluation.report import compared_with, kpi_cells
from agents.learning import results as agent_results
from agents.pages.headroom import SHARE, lead_of, with_law, with_planner, with_student
from agents.pages.sources import RESULTS, command, markdown, source
from agents.policies.catalogue import DATA
from agents.records.columns import KPIS, sentence_of, shown_of
from agents.records.models import Quality, Record, Setting
from agents.records.reading import read_csv, read_json
from agents.records.tables import read_episodes
from agents.rollouts.bootstrap import Interval
from agents.rollouts.comparison import probability_of_improvement, profiles
from agents.rollouts.statistics import failures, grouped, sentences, summarise
from probe_env.envs.task import FAILURES, TaskConfig
from probe_env.fidelity import PRESETS

BARS = ("best-schedule", "best-schedule-by-diameter", "tension-scheduled", "adaptive", "ppo-no-tension")
METHODS = ("constant", "best-constant", "best-schedule", "best-schedule-by-diameter", "pi", "tension-scheduled",
           "adaptive", "ppo-no-tension", "ppo-any-probe", "ppo", "privileged")  # fmt: skip
PROFILED: Final = ("best-schedule", "tension-scheduled", "ppo", "ppo-no-tension", "plc-law", "planner")

HEADLINE: Final = {
    "constant": "0.2 m/s and 63 m³/h, as in the study",
    "example": "a schedule file, `configs/schedules/example.csv`",
    "pi": "PI control of the measured vibration",
    "best-schedule": "the best schedule over length for all training tubes",
    "tension-scheduled": "reads friction from the root tension, follows the best schedule for it",
    "adaptive": "the same, corrected by the vibration that is measured",
    "ppo": "trained agents, the mean of five training seeds",
    "plc-law": "ten constants that a PLC can hold: length, root tension and noise in, feed and air out",
    "trimmed-law": "`plc-law` with integral action: past the onset its feed is trimmed by the noise",
    "student": "networks that learnt from `trimmed-law`, with what a rig sees: the mean of five training seeds",
    "privileged": "is told the tube, which no rig knows, and follows the best schedule for it",
    "planner": "tries things out on the simulator itself: the measure of what feedback could win",
}
"""Policies that a newcomer should know, in words."""
SHORT: Final = {
    "reward": ("reward", ".1f"),
    "inspection_time_s": ("time [s]", ".0f"),
    "share_within_limit": ("within the limit [%]", ".1f"),
    "radial_rms_m": ("radial rms [mm]", ".3f"),
    "air_m3": ("air [m³]", ".1f"),
}
"""KPI -> heading and format of the short table."""


def _simulated(folder: Path) -> str:
    """How an evaluation was simulated, by the name of a preset where it has one."""
    stored = read_json(folder / "setting.json", Setting).fidelity
    name = next((f"`{name}`" for name, preset in PRESETS.items() if preset.model_dump() == stored), str(stored))
    return f"Simulated with {name}."


def headline() -> str:
    """The policies that a newcomer should know by five means each."""
    folder = RESULTS / "evaluation"
    table, config = with_planner(grouped(read_episodes(folder / "episodes.csv"))), TaskConfig()
    table = with_student(with_law(table))
    means = summarise(table).set_index(["policy", "kpi"])["mean"].to_dict()
    lines = [f"| policy | what it does | {' | '.join(name for name, _ in SHORT.values())} |"]
    lines += ["|---" * 2 + "|---:" * len(SHORT) + "|"]
    for policy, what in HEADLINE.items():
        cells = (f"{means[policy, kpi] * KPIS[kpi][1]:{form}}" for kpi, (_, form) in SHORT.items())
        lines.append(f"| `{policy}` | {what} | {' | '.join(cells)} |")
    shown = table[table["policy"].isin(HEADLINE)]
    note = (
        f"Means over {table['context'].nunique()} held-out tubes. The limit is a radial rms of"
        f" {1e3 * config.limit:g} mm at the sensor, {config.period:g} s at a time; `radial rms` is over the length."
        f" {_failed(shown, f' of {len(shown)} insertions')}."
        " `plc-law`, `trimmed-law`, `student` and `planner` are of `probe-env results control student headroom`."
    )
    return "\n".join(lines) + f"\n\n{note} {_simulated(folder)} {source(folder / 'provenance.json')}"


def evaluation() -> str:
    """KPIs of every policy on the held-out tubes, and the differences in words."""
    return _evaluated(RESULTS / "evaluation", ("inspected_share", "radial_p99_m"), lead=True)


def any_probe() -> str:
    """The same where every tube has a probe of its own, drawn from the design space."""
    return _evaluated(RESULTS / "any-probe", ("radial_p99_m", "radial_acceleration_rms_m_per_s2", "air_m3"))


def _evaluated(folder: Path, left_out: tuple[str, ...], lead: bool = False) -> str:
    table = grouped(read_episodes(folder / "episodes.csv"))
    against = compared_with(folder, table)
    known = shown_of(table.columns)
    shown = [kpi for kpi in known if kpi not in left_out]
    names = [f"{known[kpi][0]} [{known[kpi][2]}]" if known[kpi][2] else known[kpi][0] for kpi in shown]
    names += [SHARE] * lead
    lines, beside = [f"| policy | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"], with_planner(table)
    for policy, cells in kpi_cells(table):
        by_kpi = dict(zip(known, cells, strict=True))
        share = [lead_of(beside, policy)] * lead
        lines.append(f"| `{policy}` | " + " | ".join([*(by_kpi[kpi] for kpi in shown), *share]) + " |")
    words = "\n".join(f"* {line}" for line in sentences(table, against))
    note = (
        f"{len(table)} insertions on {table['context'].nunique()} held-out tubes, means with 95 % bootstrap intervals;"
        f" {_failed(table)}."
    )
    return "\n".join(lines) + f"\n\n{words}\n\n{note} {_simulated(folder)} {source(folder / 'provenance.json')}"


def _failed(table: pd.DataFrame, of: str = "") -> str:
    """How many insertions failed, and how; ``of`` stands behind the first number."""
    counts = failures(table)
    first, *others = [(counts[name], sentence_of(name)) for name in reversed(FAILURES)]
    return ", ".join([f"{first[0]}{of} {first[1]}", *(f"{count} {said}" for count, said in others)])


def agents() -> str:
    """The agents against the other policies with the differences in words; what training took."""
    table = grouped(read_episodes(RESULTS / "evaluation" / "episodes.csv"))
    lines = [_improvement(table)]
    lines += [f"* {line}" for line in agent_results.verdicts(with_planner(table), "ppo", BARS, "planner")]
    curves = agent_results.load_curves(RESULTS / "agents" / "ppo")
    run = read_json(RESULTS / "agents" / "ppo" / f"seed-{curves['seed'].max()}" / "run.json", Record).model_dump()
    imitation = run["config"]["imitation"]
    speed = agent_results.throughput(curves, imitation["rounds"] * imitation["steps"])
    best = curves.loc[curves.groupby("seed")["reward"].idxmax()]
    lines.append(
        f"* PPO improved on the warm start in {int((best['phase'] > 0).sum())} of {len(best)} seeds by the validation"
        " tubes; in the others the warm start itself was kept."
    )
    note = (
        "Interquartile means over training seeds, 95 % intervals over seeds and tubes. Training:"
        f" {speed['minutes_a_seed']:.0f} minutes a seed (median) with one thread"
        f" ({run['machine']['cores']} cores shared by two seeds), {speed['steps_per_second']:.0f} environment steps/s,"
        f" {100.0 * speed['kernel_share']:.0f} % of the time in the simulation kernel. Made by `{run['command']}` at"
        f" commit {run['commit']}; weights, learning curves and settings are stored in `results/agents/`."
    )
    methods = [name for name in METHODS if name in set(table["policy"])]
    return f"{agent_results.markdown(table, methods)}\n\n" + "\n".join(lines) + f"\n\n{note}"


def _improvement(table: pd.DataFrame) -> str:
    """How often an agent earns more than the policies that set the bar, in the same tube."""
    parts = [f"`{bar}` {probability_of_improvement(table, 'ppo', bar).text(100.0)} %" for bar in BARS]
    return f"* A run of `ppo` earns more in the same tube than {', than '.join(parts)} (probability of improvement)."


def reward_profiles() -> pd.DataFrame:
    """Performance profiles of the agents, what sets the bar, and the planner."""
    table = with_law(with_planner(grouped(read_episodes(RESULTS / "evaluation" / "episodes.csv"))))
    shown = [name for name in PROFILED if name in set(table["policy"])]
    return profiles(table, shown, np.arange(-40.0, 41.0, 1.0))


def map_quality() -> str:
    """What the vibration map is fitted to and explains."""
    quality = read_json(DATA / "vibration-map.json", Quality).model_dump()
    share = 100.0 * quality["explained_variance"]
    return (
        f"The map is fitted to {quality['episodes']} wandering insertions on the training tubes. Of"
        f" {quality['held_out_tubes']} of these tubes, two of each helix diameter and left out of the fit, it tells"
        f" {share:.0f} % of the variance of log rms. Made by `{command(quality)}` at commit {quality['commit']};"
        " stored in `agents/policies/data/`."
    )


def tradeoff() -> str:
    """Hypervolume of every family of policies."""
    folder = RESULTS / "tradeoff"
    volumes = read_csv(folder / "hypervolume.csv")
    contexts = read_episodes(folder / "episodes.csv")["context"].nunique()
    parts = [
        f"`{row['family']}` {Interval(row['hypervolume'], row['low'], row['high']).text()}"
        for row in volumes.to_dict("records")
    ]
    return (
        f"Hypervolume (share of the box from nothing to 900 s and all of the length out of the limit that a front"
        f" dominates): {', '.join(parts)}; {contexts} tubes. {_simulated(folder)} {source(folder / 'provenance.json')}"
    )


def tradeoff_found() -> str:
    """Which feeds no other one beats both in time and in what is found."""
    folder = RESULTS / "tradeoff"
    table, stored = grouped(read_episodes(folder / "episodes.csv")), read_csv(folder / "front.csv")
    families = [name for name in dict.fromkeys(stored["family"]) if name in fronts.FAMILIES]
    singles = [name for name in dict.fromkeys(stored["family"]) if name not in fronts.FAMILIES]
    front = fronts.front_of(table, families, singles)
    best, in_millimetres = fronts.unbeaten(front), fronts.unbeaten(front, by="out_share")
    rows = [
        (
            f"`{fronts.member_of(row)}`", f"{row['time_s']:.0f}", f"{row[fronts.DEPTH]:.1f}",
            f"{100.0 * row['out_share']:.1f}", "yes" if index in in_millimetres.index else "no",
        )
        for index, row in zip(best.index, best.to_dict("records"), strict=True)
    ]  # fmt: skip
    header = ("feed", "time [s]", "a90/95 [% wall]", "out of the limit [%]", "unbeaten in millimetres")
    return (
        f"**Of {len(front)} feeds {len(best)} are beaten by no other one both in time and in a90/95;"
        f" {len(set(best.index) & set(in_millimetres.index))} of them are among the {len(in_millimetres)} that are"
        f" unbeaten in millimetres, in time and length out of the limit.**\n\n{markdown(header, rows)}\n\n"
        f"The episodes above; no intervals. {source(folder / 'provenance.json')}"
    )


def fidelity() -> str:
    """What moves at half the step and with a finer fidelity."""
    return checked(RESULTS / "fidelity")


def checked(folder: Path) -> str:
    """What moved in the checks of a stored evaluation."""
    lines = [f"* {line}" for line in words(read_csv(folder / "fidelity.csv"))]
    return "\n".join(lines) + f"\n\n{_simulated(folder)} {source(folder / 'provenance.json')}"
