"""What is found, in words: which policy, searched for millimetres or for S/N, finds smaller flaws in less time."""

from __future__ import annotations

from typing import Final

import numpy as np
from probe_env.fidelity.settings import in_words
from scipy.stats import kendalltau

from agents.detection import anchors as anchor_runs
from agents.detection import promise
from agents.pages.sources import RESULTS, command, markdown, source, stored_table, ways_to_fail
from agents.policies.catalogue import DATA
from agents.records.models import Record
from agents.records.reading import read_csv, read_json
from agents.records.tables import read_episodes
from agents.rollouts.depths import depths_of
from agents.rollouts.statistics import failures, grouped, paired_difference
from probe_env import Fidelity
from probe_env.schedule import Schedule

FOLDER: Final = RESULTS / "snr"
REFERENCE: Final = "millimetre-schedule"
OWN: Final = "snr-schedule"
AGENT: Final = "ppo-snr"
TEACHER: Final = "tension-scheduled"
HEADER: Final = (
    "policy", "reward in S/N", "against millimetre-schedule", "time [s]", "a90/95 [%]", "S/N over 3 [m]",
    "radial rms [mm]", "air [m³]",
)  # fmt: skip
NOISE: Final = "x_deviation_v"
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
    pairs = stored_table(folder / "pairs.csv", "first", "second", "anchors", "low", "high")
    lines = "\n".join(f"* {line}" for line in anchor_runs.sentences(summary, pairs))
    return (
        f"{markdown(anchor_runs.HEADER, anchor_runs.cells(summary))}\n\n{lines}\n\n"
        f"Over {record['tubes']} held-out tubes at `fast`; a90/95 is the depth found with 90 % over the tubes, with"
        f" 95 % confidence. Made by `{command(record)}` at commit {record['commit']}."
    )


def as_seen() -> str:
    """Noise and vibration along one insertion, beside what the study says of its figure 4."""
    folder = RESULTS / "signal"
    periods, flaws = read_csv(folder / "periods.csv"), read_csv(folder / "flaws.csv")
    record = read_json(folder / "signal.json", Record).model_dump()
    middle = 0.5 * periods["place_m"].max()
    half, quiet = periods["place_m"] > middle, flaws[flaws["place_m"] < middle]
    noise, vibration = (periods[name][half].mean() / periods[name][~half].mean() for name in (NOISE, "radial_rms_m"))
    return (
        f"Past the middle of the helix the noise in X is {noise:.1f} times what it is before, the radial rms"
        f" {vibration:.1f} times; their rank correlation over {len(periods)} s is"
        f" {record['noise_and_vibration_correlation']:.2f}. Called are {flaws['called'].sum()} of {len(flaws)} flaws,"
        f" in the first half {quiet['called'].sum()} of {len(quiet)}; {record['false_calls']} calls are false."
        f" {source(folder / 'signal.json')}"
    )


def false_calls() -> str:
    """Calls where there is no flaw, counted on whole traces."""
    folder = RESULTS / "false-calls"
    summary = stored_table(folder / "false-calls.csv", "policy", "calls", "promised", "calls_of_all")
    record = read_json(folder / "provenance.json", Record).model_dump()
    kept = [f"`{row['policy']}`" for row in summary.to_dict("records") if row["calls_low"] <= row["promised"]]
    deeper = summary[promise.KEPT_DEPTH]
    more = 100.0 * (deeper / summary[promise.DEPTH] - 1.0)
    tau = kendalltau(summary[promise.DEPTH], deeper).statistic
    return (
        f"**In noise alone {summary['calls'].mean():.2f} calls a tube are counted where"
        f" {summary['promised'].mean():.2f} were promised; not clearly more by {', '.join(kept) or 'none'}. With"
        f" thresholds that had heard all of the motion it is {summary['calls_of_all'].mean():.2f}. With the"
        f" `false_calls` that keeps the promise depths are {more.min():.0f} to {more.max():.0f} % larger, and the"
        f" ranking by a90/95 has Kendall's tau {tau:.2f} with the one as it is.**\n\n"
        f"{markdown(promise.HEADER, promise.cells(summary))}\n\n"
        f"Means over {record['tubes']} held-out tubes ({in_words(Fidelity(**record['fidelity']))}) with 95 % intervals"
        f" over tubes, {record['draws']} draws of the electronic noise over each motion; {record['diverged']}"
        f" insertions diverged. Depths are of what was inspected. {source(folder / 'provenance.json')}"
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
