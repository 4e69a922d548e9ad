"""Agents that were trained after the evaluation's, in words: what PPO reaches alone, and the student of a law."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import pandas as pd

from agents.learning import results as agent_results
from agents.pages.control import checked
from agents.pages.headroom import BAR, BLURRED, STUDENT, with_planner
from agents.pages.plc import FINELY as LAWS_FINELY
from agents.pages.sources import RESULTS, markdown, source, ways_to_fail
from agents.records.models import Record
from agents.records.reading import read_json
from agents.records.tables import read_episodes
from agents.rollouts.comparison import probability_of_improvement
from agents.rollouts.statistics import failures, grouped, paired_difference

ALONE: Final = "ppo-scratch"
METHODS: Final = ("constant", "best-constant", "best-schedule", ALONE)
BESIDE: Final = ("best-schedule-by-diameter", "tension-scheduled", "adaptive", "plc-law", "trimmed-law")
"""What the student is compared with; the last is its teacher."""
FINELY_BESIDE: Final = BESIDE[1:]
PAIR: Final = (BAR, STUDENT)
"""Who acts with the study's scheme."""


def scratch() -> str:
    """The agents that learnt alone beside schedules, and what their training took."""
    folder = RESULTS / "scratch"
    table, curves = _episodes(folder), agent_results.load_curves(RESULTS / "agents" / ALONE)
    best = _kept(curves)
    lines = "\n".join(f"* {line}" for line in _differences(table, ALONE, METHODS[:-1]))
    training = (
        f"Training: {curves['steps'].max():,} steps and {_minutes(curves):.0f} minutes a seed (median),"
        f" validation by simulation included; kept is what was best there, after {best['steps'].min():,} to"
        f" {best['steps'].max():,} steps."
    )
    return f"{agent_results.markdown(table, METHODS)}\n\n{lines}\n\n{_note(table, ALONE, training)} {_made(folder)}"


def student() -> str:
    """The student on the held-out tubes, and what its training took."""
    folder = RESULTS / "student"
    table, curves = _episodes(folder), agent_results.load_curves(RESULTS / "agents" / STUDENT)
    closed = agent_results.gain_fraction(with_planner(table, BLURRED), STUDENT, BAR, BLURRED)
    best, imitation = _kept(curves), _run(STUDENT)["config"]["imitation"]
    improved, means = int((best["phase"] > 0).sum()), curves.groupby("phase")["reward"].mean()
    after = ", ".join(f"{mean:.1f}" for mean in means.iloc[1:])
    training = (
        f"Training: {imitation['rounds'] * imitation['steps']:,} steps of imitation, {curves['steps'].max():,} of PPO"
        f" and {_minutes(curves):.0f} minutes a seed (median), validation by simulation included; kept is what"
        f" was best on the validation tubes, a phase of PPO in {improved} of {len(best)} seeds, else the imitation."
        f" There the mean over seeds is {means.iloc[0]:.1f} after the imitation and {after} after the phases of PPO."
    )
    return (
        f"**`{STUDENT}` closes {closed.text(100.0)} % of the gap between `{BAR}` and `{BLURRED}`.**\n\n"
        f"{_beside(table)}\n\n{_note(table, STUDENT, training)} {_made(folder)}"
    )


def student_fresh() -> str:
    """The student on tubes on which nothing was trained, searched or chosen."""
    folder = RESULTS / "student-fresh"
    table = _episodes(folder)
    return f"{_beside(table)}\n\n{_over(table, 'fresh')} {_made(folder)}"


def student_finely() -> str:
    """The student acting at `reference`, and what moves there and at half the step."""
    folder = RESULTS / "student-finely"
    own, laws = (grouped(read_episodes(one / "finer-acting" / "episodes.csv")) for one in (folder, LAWS_FINELY))
    table = pd.concat([own[own["policy"] == STUDENT], laws], ignore_index=True)
    leads = (f"`{one}` {agent_results.difference(table, STUDENT, one, 'reward').text()}" for one in FINELY_BESIDE)
    return (
        f"**At `reference` the reward of `{STUDENT}` less that of others is: {', '.join(leads)}**"
        f" ({table['context'].nunique()} tubes, 95 % intervals over seeds and tubes; the others are of"
        f" `probe-env results laws-finely`).\n\n{checked(folder)}"
    )


def student_scheme() -> str:
    """The student and its bar acting with the study's scheme, beside the fidelities of the same tubes."""
    folder = RESULTS / "study-scheme"
    acting, finely = (
        read_episodes(one / "finer-acting" / "episodes.csv") for one in (folder, RESULTS / "student-finely")
    )
    at = {
        "`fast`": read_episodes(folder / "episodes.csv"),
        "`reference`": finely.replace({"policy": {f"{STUDENT}@0": STUDENT}}),
        "the study's scheme": acting,
    }
    tubes = acting.drop_duplicates("context").sort_values("context")
    at = {name: table[table["context"].isin(tubes["context"])] for name, table in at.items()}
    of = {name: table.pivot(index="context", columns="policy", values="reward") for name, table in at.items()}
    rows = [
        (f"{tube['helix_diameter']:g}", *(f"{of[name].loc[tube['context'], one]:.1f}" for one in PAIR for name in at))
        for tube in tubes.to_dict("records")
    ]
    header = ("helix [m]", *(f"`{one}`, {name}" for one in PAIR for name in at))
    leads = ", ".join(
        f"{paired_difference(part, STUDENT, BAR, 'reward').text()} at {name}" for name, part in at.items()
    )
    note = (
        f"Reward tube by tube; `{STUDENT}` is its seed 0. Less that of `{BAR}`, paired, 95 % intervals over these"
        f" {len(tubes)} tubes: {leads}. {source(folder / 'provenance.json')}"
    )
    return f"{markdown(header, rows)}\n\n{note}"


def _beside(table: pd.DataFrame) -> str:
    """The student's table, and its differences from others in words."""
    lines = [f"* {line}" for line in _differences(table, STUDENT, BESIDE)]
    parts = (f"`{one}` {probability_of_improvement(table, STUDENT, one).text(100.0)} %" for one in BESIDE)
    lines.append(f"* A run earns more in the same tube than {', than '.join(parts)} (probability of improvement).")
    own = table[table["policy"] == STUDENT]
    lines.append(f"* {int(failures(own).sum())} of its {len(own)} insertions {ways_to_fail()}.")
    return f"{agent_results.markdown(table, (*BESIDE, STUDENT))}\n\n" + "\n".join(lines)


def _differences(table: pd.DataFrame, agent: str, others: Sequence[str]) -> list[str]:
    rewards = ((other, agent_results.difference(table, agent, other, "reward").text()) for other in others)
    return [f"`{agent}` against `{other}`: reward {reward}." for other, reward in rewards]


def _note(table: pd.DataFrame, agent: str, training: str) -> str:
    run = _run(agent)
    return f"{_over(table, 'held-out')} {training} Trained by `{run['command']}` at commit {run['commit']}."


def _over(table: pd.DataFrame, tubes: str) -> str:
    return (
        f"Interquartile means over training seeds, 95 % intervals over seeds and {table['context'].nunique()} {tubes}"
        " tubes."
    )


def _episodes(folder: Path) -> pd.DataFrame:
    return grouped(read_episodes(folder / "episodes.csv"))


def _run(agent: str) -> dict[str, Any]:
    """How the last of its seeds was trained."""
    last = sorted((RESULTS / "agents" / agent).glob("seed-*/run.json"))[-1]
    return read_json(last, Record).model_dump()


def _kept(curves: pd.DataFrame) -> pd.DataFrame:
    """The phase of each seed that is kept: the best by the validation tubes."""
    return curves.loc[curves.groupby("seed")["reward"].idxmax()]


def _minutes(curves: pd.DataFrame) -> float:
    return agent_results.throughput(curves, 0)["minutes_a_seed"]


def _made(folder: Path) -> str:
    return source(folder / "provenance.json")
