"""Reads bundles of trained agents without torch, and prints the shipped agents."""

import json
from pathlib import Path
from typing import Any, Final

import numpy.typing as npt
import safetensors.numpy
from safetensors import SafetensorError

from probe_agents.policies.view import View
from probe_agents.records.shipped import DEFAULT_SEED, file_or_shipped, policy_file, shipped_agents
from probe_agents.terminal.tables import print_terms
from probe_env.envs.task.config import TaskConfig
from probe_env.files import MEBI, FileError, read_bytes, read_toml
from probe_env.settings import tuples

MAX_BYTES: Final = 512 * MEBI
RESTORE: Final = "restore the file, or train again"


def read_weights(path: Path) -> tuple[str, str, dict[str, npt.NDArray[Any]]]:
    """Read description (JSON text), hash and weights of a bundle."""
    content = read_bytes(path, MAX_BYTES)
    try:
        weights = safetensors.numpy.load(content)  # checks the header, which begins with its length
        metadata = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])["__metadata__"]
        return metadata["description"], metadata["hash"], weights
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        raise FileError(path, f"not an agent's bundle (.safetensors): {error} - {RESTORE}") from error


def print_agents() -> None:
    """Print a paragraph for each shipped agent."""
    for name, seeds in shipped_agents().items():
        path = Path(policy_file(name))
        text, _, _ = read_weights(path)
        try:
            description = tuples(json.loads(text))
            view, task = View.model_validate(description["view"]), TaskConfig.model_validate(description["task"])
        except (ValueError, KeyError, TypeError) as error:
            raise FileError(path, f"not a bundle of this version: {error}") from error
        training = read_toml(file_or_shipped("train", name))
        environment, (slow, fast) = training.get("environment", {}), task.feed_speeds
        low, high = (3600.0 * max(rate, view.least_air_supply_rate) for rate in task.air_supply_rates)
        extra = {
            "friction estimated from the root tension": view.friction_estimate,
            f"averages over {', '.join(f'{seconds:g}' for seconds in view.averages)} s": bool(view.averages),
        }
        teacher = training.get("imitation", {}).get("teacher", "")
        print(name)
        print_terms({
            "seeds": f"{', '.join(map(str, seeds))}: {name}@{seeds[-1]}; {name} is {name}@{DEFAULT_SEED}",
            "observes": ", ".join(["what a rig measures", *(text for text, used in extra.items() if used)]),
            "environment": f"{environment.get('env_id', 'probe_env/Insertion-v1')}, tubes of"
            f" {environment.get('contexts', 'train')}; feed {slow:g} to {fast:g} m/s, air {low:g} to {high:g} m3/h",
            "training": f"imitation of {teacher}, then PPO" if teacher else "PPO",
        })  # fmt: skip
