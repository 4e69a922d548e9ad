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
ACTING: Final = (*BESIDE[:3], STUDENT)
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
    """The student and others acting with the study's scheme, and its lead there and at other fidelities."""
    folder = RESULTS / "study-scheme"
    scheme = read_episodes(folder / "finer-acting" / "episodes.csv")
    finely = pd.concat(
        [read_episodes(one / "finer-acting" / "episodes.csv") for one in (RESULTS / "student-finely", LAWS_FINELY)]
    ).replace({"policy": {f"{STUDENT}@0": STUDENT}})
    tubes = scheme.drop_duplicates("context").sort_values("context")
    at = {"`fast`": read_episodes(folder / "episodes.csv"), "`reference`": finely, "the study's scheme": scheme}
    of = scheme.pivot(index="context", columns="policy", values="reward")
    rewards = markdown(
        ("helix [m]", *(f"`{one}`" for one in ACTING)),
        [
            (f"{tube['helix_diameter']:g}", *(f"{of.loc[tube['context'], one]:.1f}" for one in ACTING))
            for tube in tubes.to_dict("records")
        ],
    )
    leads = markdown(
        (f"`{STUDENT}` less", *at),
        [
            (f"`{other}`", *(_lead(table[table["context"].isin(tubes["context"])], other) for table in at.values()))
            for other in ACTING[:-1]
        ],
    )
    note = (
        f"`{STUDENT}` is its seed 0; differences of reward are paired, with 95 % intervals over these {len(tubes)}"
        f" tubes. {source(folder / 'provenance.json')}"
    )
    orders = "; ".join(f"at {name} {_order(at[name])}" for name in ("`fast`", "the study's scheme"))
    return f"Reward with the study's scheme:\n\n{rewards}\n\nMeans, {orders}.\n\n{leads}\n\n{note}"


def _order(table: pd.DataFrame) -> str:
    """Policies by their mean reward."""
    means = table.groupby("policy")["reward"].mean().sort_values(ascending=False)
    return ", ".join(f"`{policy}` {mean:.1f}" for policy, mean in means.items())


def _lead(table: pd.DataFrame, other: str) -> str:
    """The student's reward less another's in the same tubes; empty where that one did not act."""
    if other not in set(table["policy"]):
        return ""
    once = table[table["policy"].isin((STUDENT, other))].drop_duplicates(["policy", "context", "seed"])
    return paired_difference(once, STUDENT, other, "reward").text()


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
