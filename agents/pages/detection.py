"""What is found, in words: which policy, searched for millimetres or for S/N, finds smaller flaws in less time."""

from __future__ import annotations

from itertools import product
from typing import Any, Final

import numpy as np

from agents.detection import anchors as anchor_runs
from agents.pages.sources import RESULTS, command, markdown, source, stored_table, ways_to_fail
from agents.policies.catalogue import DATA
from agents.records.columns import KPIS
from agents.records.models import Record
from agents.records.reading import read_json
from agents.records.tables import read_episodes
from agents.rollouts.bootstrap import Interval, chance_of_mean
from agents.rollouts.depths import depths_of
from agents.rollouts.statistics import by_context, failures, grouped, mean_interval, paired_difference
from probe_env.schedule import Schedule

FOLDER: Final = RESULTS / "snr"
REFERENCE: Final = "millimetre-schedule"
OWN: Final = "snr-schedule"
HEARING: Final = ("a90_percent_wall", "length_with_snr_over_3_m", "noise_peak_to_peak_v", "radial_rms_m")
"""What is compared at two fidelities."""
HEARD, UNHEARING = HEARING[:3], ("best-constant", "best-schedule")
TRIALS: Final = {"hearing-fresh": "standard", "hearing-fresh-finely": "reference"}
"""Stages in fresh tubes, and what they compare with ``fast``."""
LEAST_CHANCE: Final = 0.05 / (len(HEARD) * len(UNHEARING) * len(TRIALS))
"""Below which a change is taken for one: together the trials go wrong by luck in one of twenty cases (Bonferroni)."""
TRIAL_HEADER: Final = (
    "policy", "what", "at", "at `fast`", "change", "standard deviation between tubes at `fast`", "p",
)  # fmt: skip
AGENT: Final = "ppo-snr"
TEACHER: Final = "tension-scheduled"
HEADER: Final = (
    "policy", "reward in S/N", "against millimetre-schedule", "time [s]", "a90/95 [%]", "S/N over 3 [m]",
    "radial rms [mm]", "air [m³]",
)  # fmt: skip
PLACES: Final = (5.0, 12.0, 19.0, 26.0, 33.0, 42.0, 60.0)
"""Lengths [m] at which both schedules are shown: the searches' own."""


def snr() -> str:
    """Policies in the task that is judged by what is found."""
    table = grouped(read_episodes(FOLDER / "episodes.csv"))
    depths = depths_of(table).set_index("policy")["a90_95_percent_wall"]
    means = table.groupby("policy").mean(numeric_only=True).sort_values("reward", ascending=False)
    rows = []
    for policy in map(str, means.index):
        mean, gain = means.loc[policy], paired_difference(table, policy, REFERENCE, "reward")
        rows.append(
            (
                policy, f"{mean['reward']:.1f}", "" if policy == REFERENCE else gain.text(),
                f"{mean['inspection_time_s']:.0f}", f"{depths.loc[policy]:.1f}",
                f"{mean['length_with_snr_over_3_m']:.1f}", f"{1e3 * mean['radial_rms_m']:.3f}", f"{mean['air_m3']:.1f}",
            )
        )  # fmt: skip
    own = paired_difference(table, OWN, REFERENCE, "reward")
    clear = "more" if own.low > 0.0 else "less" if own.high < 0.0 else "not clearly more or less"
    tubes, lost = table["context"].nunique(), int(failures(table).sum())
    return (
        f"**Judged by what is found, the schedule searched for S/N earns {clear} than the one searched for"
        f" millimetres ({own.text()}); the most has `{means.index[0]}`.**\n\n"
        f"{markdown(HEADER, rows)}\n\n"
        f"Means over {tubes} held-out tubes of `--tube snr`, differences paired, 95 % intervals; {lost} insertions"
        f" {ways_to_fail()}. {source(FOLDER / 'provenance.json')}\n\n{_schedules()}"
    )


def hearing() -> str:
    """What is found at ``standard`` beside ``fast``."""
    return _found("hearing", "acting", "standard")


def hearing_fresh() -> str:
    """Whether what is found is the same at ``fast``, ``standard`` and ``reference``, by what was said beforehand."""
    rows, differ, undecided = [], [], []
    for name, finer in TRIALS.items():
        folder = RESULTS / name
        tables = [read_episodes(path / "episodes.csv") for path in (folder, folder / "finer-acting")]
        for policy, kpi in product(UNHEARING, HEARD):
            title, factor, unit = KPIS[kpi]
            before, after = (by_context(table, policy, kpi) for table in tables)
            change = after - before
            chance = chance_of_mean(change.to_numpy())
            rows.append(
                (
                    policy, f"{title} [{unit}]", f"`{finer}`", f"{factor * before.mean():.3g}",
                    mean_interval(change.to_numpy()).text(factor), f"{factor * before.std():.2g}", f"{chance:.2g}",
                )
            )  # fmt: skip
            compared = f"{title} of `{policy}` at `{finer}`"
            if chance < LEAST_CHANCE:
                differ.append(compared)
            elif 2.0 ** (1 - np.count_nonzero(change)) >= LEAST_CHANCE:  # though all signs were one way
                undecided.append(compared)
    said = f"differ: {'; '.join(differ)}" if differ else "none differs by more than chance"
    said += f"; too few tubes change to tell: {'; '.join(undecided)}" if undecided else ""
    sources = " ".join(source(RESULTS / name / "provenance.json") for name in TRIALS)
    return (
        f"**Of {len(rows)}, {said}.**\n\n{markdown(TRIAL_HEADER, rows)}\n\nMeans over"
        f" {tables[0]['context'].nunique()} tubes; changes with 95 % intervals. {sources}"
    )


def replays() -> str:
    """What is found where that is replayed which was fed and blown at ``fast``."""
    return _found("replays-standard", "replayed", "standard")


def _found(name: str, check: str, finer: str) -> str:
    """A stored check of a finer fidelity: a row a policy, each KPI at ``fast`` and its change."""
    folder = RESULTS / name
    checks = stored_table(folder / "fidelity.csv", "check", "policy", "kpi", "before", "mean", "low", "high")
    chosen, rows = checks[checks["check"].str.startswith(check)], []
    clear: dict[str, list[str]] = {kpi: [] for kpi in HEARING}
    for policy, part in chosen.groupby("policy", sort=False):
        of_kpi: dict[Any, dict[Any, Any]] = {entry["kpi"]: entry for entry in part.to_dict("records")}
        cells = []
        for kpi in HEARING:
            entry, factor = of_kpi[kpi], KPIS[kpi][1]
            change = Interval(entry["mean"], entry["low"], entry["high"])
            cells += [f"{factor * entry['before']:.3g}", change.text(factor)]
            if change.low > 0.0 or change.high < 0.0:
                clear[kpi].append(f"`{policy}`")
        rows.append((str(policy), *cells))
    header = ["policy"]
    for title, _, unit in (KPIS[kpi] for kpi in HEARING):
        header += [f"{title} [{unit}] at `fast`", f"change at `{finer}`"]
    changed = [f"{KPIS[kpi][0]} of {' and '.join(names)}" for kpi, names in clear.items() if names]
    tubes = read_episodes(folder / "episodes.csv")["context"].nunique()
    return (
        f"{markdown(header, rows)}\n\nMeans over {tubes} held-out tubes; changes are paired, with 95 % intervals."
        f" Clear of zero: {', '.join(changed) if changed else 'none'}."
        f" {source(folder / 'provenance.json')}"
    )


def snr_agent() -> str:
    """The agent that was trained for what is found."""
    folder = RESULTS / "snr-agent"
    table = grouped(read_episodes(folder / "episodes.csv"))
    mean = table[table["policy"] == AGENT].mean(numeric_only=True)
    depth = depths_of(table).set_index("policy")["a90_95_percent_wall"].loc[AGENT]
    against = ", ".join(
        f"{paired_difference(table, AGENT, other, 'reward').text()} against `{other}`" for other in (TEACHER, OWN)
    )
    return (
        f"The agent `{AGENT}` (`probe-env train {AGENT} --tube snr`, seed 0) imitates `{TEACHER}`, then learns by"
        f" PPO. It earns {mean['reward']:.1f} in {mean['inspection_time_s']:.0f} s with an a90/95 of {depth:.1f} %:"
        f" {against}."
        f" {source(folder / 'provenance.json')}"
    )


def anchors() -> str:
    """Which policy finds smaller flaws in less time."""
    folder = RESULTS / "detection"
    summary, record = (
        stored_table(folder / "anchors.csv", "policy", "reward", "inspection_time_s", "share_within_limit"),
        read_json(folder / "provenance.json", Record).model_dump(),
    )
    lines = "\n".join(f"* {line}" for line in anchor_runs.sentences(summary))
    return (
        f"{markdown(anchor_runs.HEADER, anchor_runs.cells(summary))}\n\n{lines}\n\n"
        f"Over {record['tubes']} held-out tubes at `fast`; a90/95 is the depth found with 90 % over the tubes, with"
        f" 95 % confidence. Made by `{command(record)}` at commit {record['commit']}."
    )


def _schedules() -> str:
    """Both searched schedules side by side."""
    read = {
        "millimetres": Schedule.read(DATA / "best-schedule.csv"),
        "S/N": Schedule.read(FOLDER / "best-schedule.csv"),
    }
    rows = []
    for length in PLACES:
        cells = [f"{length:g}"]
        for schedule in read.values():
            feed, air = schedule.at(np.array([length]))
            cells += [f"{feed[0]:.3f}", f"{3600.0 * air[0]:.0f}"]
        rows.append(cells)
    header = ["length [m]", *(f"{name}: {what}" for name in read for what in ("feed [m/s]", "air [m³/h]"))]
    return f"{markdown(header, rows)}\n\n{_by_map()}"


def _by_map() -> str:
    """What the map of the noise expects of what was searched on it, beside what the simulation has."""
    schedule, constant = (
        read_json(FOLDER / f"best-{name}.json", Record).model_dump() for name in ("schedule", "constant")
    )
    return (
        f"On {schedule['validation_tubes']} tubes for validation the map of the noise expects"
        f" {schedule['reward_by_map']:.1f} of this schedule and {constant['reward_by_map']:.1f} of the constant that"
        f" was searched on it; simulated they earn {schedule['reward_simulated']:.1f} and"
        f" {constant['reward_simulated']:.1f}."
    )
