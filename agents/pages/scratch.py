"""What PPO reaches without a teacher, in words."""

from __future__ import annotations

from typing import Final

from agents.learning import results as agent_results
from agents.pages.sources import RESULTS, source
from agents.records.models import Record
from agents.records.reading import read_json
from agents.records.tables import read_episodes
from agents.rollouts.statistics import grouped

AGENT: Final = "ppo-scratch"
METHODS: Final = ("constant", "best-constant", "best-schedule", AGENT)


def scratch() -> str:
    """The agents beside schedules, and what their training took."""
    folder, runs = RESULTS / "scratch", RESULTS / "agents" / AGENT
    table, curves = grouped(read_episodes(folder / "episodes.csv")), agent_results.load_curves(runs)
    run = read_json(runs / f"seed-{curves['seed'].max()}" / "run.json", Record).model_dump()
    differences = (
        f"`{AGENT}` against `{other}`: reward {agent_results.difference(table, AGENT, other, 'reward').text()}"
        for other in METHODS[:-1]
    )
    speed = agent_results.throughput(curves, 0)
    best = curves.loc[curves.groupby("seed")["reward"].idxmax()]
    note = (
        f"Interquartile means over training seeds, 95 % intervals over seeds and {table['context'].nunique()} held-out"
        f" tubes. Training: {curves['steps'].max():,} steps and {speed['minutes_a_seed']:.0f} minutes a seed (median),"
        f" validation by simulation included; kept is what was best there, after {best['steps'].min():,} to"
        f" {best['steps'].max():,} steps. Trained by `{run['command']}` at commit {run['commit']}."
    )
    lines = "\n".join(f"* {difference}." for difference in differences)
    made_by = source(folder / "provenance.json")
    return f"{agent_results.markdown(table, METHODS)}\n\n{lines}\n\n{note} {made_by}"
