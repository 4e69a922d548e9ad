"""The trained agents that ship, read from their bundles and training files without torch."""

from __future__ import annotations

import json
from typing import Any, NamedTuple

from agents.policies.view import View
from agents.records.arrays import read_weights
from agents.records.shipped import AGENT_FILE, DEFAULT_SEED, file_or_shipped, shipped_agents, shipped_folder
from agents.terminal.tables import print_terms
from probe_env.envs.task import TaskConfig
from probe_env.envs.task.observations import PROBE
from probe_env.files import FileError, read_toml
from probe_env.settings import tuples

TENSION = "root_tension"


class Trained(NamedTuple):
    """A trained agent that ships.

    Attributes:
        name: in commands.
        seeds: training seeds, NAME@SEED each.
        sees: its observations, in words.
        trained: task, tubes and probes of the training, in words.
        teacher: policy that it imitated first; empty if none.
    """

    name: str
    seeds: tuple[int, ...]
    sees: str
    trained: str
    teacher: str


def trained_agents() -> list[Trained]:
    """All agents that ship.

    Raises:
        FileError: a bundle or a training file is not valid.
    """
    return [_trained(name, seeds) for name, seeds in shipped_agents().items()]


def print_agents() -> None:
    """Print all agents that ship, a paragraph each."""
    for agent in trained_agents():
        print(agent.name)
        seeds = (
            f"{', '.join(map(str, agent.seeds))} of training, as {agent.name}@{agent.seeds[-1]};"
            f" {agent.name} alone is {agent.name}@{DEFAULT_SEED}"
        )
        imitated = f"{agent.teacher} first, then learnt by itself" if agent.teacher else "nothing"
        print_terms({"seeds": seeds, "sees": agent.sees, "trained for": agent.trained, "imitated": imitated})


def _trained(name: str, seeds: tuple[int, ...]) -> Trained:
    path = shipped_folder("agents") / name / f"seed-{DEFAULT_SEED}" / AGENT_FILE
    text, _, _ = read_weights(path)
    try:
        said: dict[str, Any] = tuples(json.loads(text))
        view, task = View.model_validate(said["view"]), TaskConfig.model_validate(said["task"])
    except (ValueError, KeyError, TypeError) as error:
        raise FileError(path, f"not a bundle of this version: {error}") from error
    training = read_toml(file_or_shipped("train", name))
    place, (slow, fast) = training.get("environment", {}), task.feed_speeds
    probes = "any probe of the design space" if place.get("probes") == "random" else "the study's probe"
    least, most = (3600.0 * max(rate, view.least_air_supply_rate) for rate in task.air_supply_rates)
    return Trained(
        name, seeds, _sees(view),
        f"{place.get('env_id', 'probe_env/Insertion-v1')} with {probes} in the {place.get('contexts', 'train')} tubes;"
        f" feeds {slow:g} to {fast:g} m/s, blows {least:g} to {most:g} m3/h",
        str(training.get("imitation", {}).get("teacher", "")),
    )  # fmt: skip


def _sees(view: View) -> str:
    """The observations that tell agents apart, in words."""
    averages = " and ".join(f"{seconds:g}" for seconds in view.averages)
    tension = "the root tension" + (" and the friction that it suggests" if view.friction_estimate else "")
    parts = [
        "lengths, feed, air, accelerations, eddy-current noise, helix diameter",
        tension if TENSION in view.observations else "not the root tension",
        "which probe was built" if set(PROBE) <= set(view.observations) else "not which probe was built",
        "whether it is drawn back" if "way" in view.observations else "",
        f"averages of all that over {averages} s" if averages else "",
    ]
    return "; ".join(filter(None, parts))
