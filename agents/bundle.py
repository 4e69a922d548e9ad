"""A trained agent as one file of plain arrays: weights, what it sees, the task, versions and a hash.

Loading builds the network from the validated description and fills in the weights; nothing in the file is executed.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
import numpy.typing as npt
import torch
from pydantic import Field, ValidationError
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.policies import BasePolicy

from agents.provenance import write_atomically
from agents.view import View
from probe_env.scene import Model, explain
from probe_env.task import TaskConfig

Algorithm = Literal["ppo", "sac", "recurrent-ppo"]
ALGORITHMS: Final[dict[str, tuple[Any, str]]] = {
    "ppo": (PPO, "MlpPolicy"),
    "sac": (SAC, "MlpPolicy"),
    "recurrent-ppo": (RecurrentPPO, "MlpLstmPolicy"),
}
UNREADABLE: Final = (
    ValueError, OSError, EOFError, KeyError, TypeError, NotImplementedError, zipfile.BadZipFile, zlib.error
)  # fmt: skip
"""What numpy raises on files that are no archive of plain arrays."""
ACTED: Final = ("growing", "period", "feed_speeds", "air_supply_rates")
"""Fields of the task that give an action its meaning: an agent runs in no task where they differ."""


class Network(Model):
    """Size of the policy's networks; ``lstm_hidden_size`` is for recurrent-ppo alone."""

    net_arch: Annotated[tuple[Annotated[int, Field(ge=1, le=4096)], ...], Field(max_length=8)] = (64, 64)
    lstm_hidden_size: int = Field(default=64, ge=1, le=4096)
    log_std_init: float = -1.0

    def arguments(self, algorithm: Algorithm) -> dict[str, Any]:
        """SB3's ``policy_kwargs``."""
        if algorithm == "sac":
            return {"net_arch": list(self.net_arch)}
        arguments = {"net_arch": list(self.net_arch), "log_std_init": self.log_std_init}
        if algorithm == "recurrent-ppo":
            arguments["lstm_hidden_size"] = self.lstm_hidden_size
        return arguments


class Description(Model):
    """What a bundle says of itself."""

    format: Literal[1] = 1
    algorithm: Algorithm
    network: Network
    view: View
    task: TaskConfig
    trained: dict[str, Any]
    """Run that made it: config, seed, steps, versions, commit, machine."""


class Agent:
    """A trained policy with SB3's ``predict`` on the task's own observations; memory is in the state that it returns.

    Args:
        description: what it is.
        policy: SB3's policy with its weights.
        config: the task that it acts in; may show more than the agent looks at.
        hash: of the bundle, for ``describe``.

    Raises:
        ValueError: the task does not show what the agent needs, or its actions mean something else there.
    """

    def __init__(self, description: Description, policy: BasePolicy, config: TaskConfig, hash: str = "") -> None:
        description.view.columns(config)
        for name in ACTED:
            trained, here = getattr(description.task, name), getattr(config, name)
            if trained != here:
                raise ValueError(f"{name} = {here!r} differs from {trained!r}, which the agent was trained with")
        self.description, self.policy, self.config, self.hash = description, policy, config, hash
        policy.set_training_mode(False)

    def predict(
        self,
        observation: npt.NDArray[np.floating[Any]],
        state: tuple[Any, ...] | None = None,
        episode_start: npt.NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[npt.NDArray[np.float32], tuple[Any, ...]]:
        """Actions of the environment for observations (d,) or (N, d), and the state to give back next time."""
        rows = np.atleast_2d(observation)
        new = np.zeros(len(rows), dtype=bool) if episode_start is None else np.asarray(episode_start, dtype=bool)
        averages, inner = state if state is not None else (None, None)
        features, averages = self.description.view.features(self.config, rows, averages, new)
        start = np.ones(len(rows), dtype=bool) if state is None else new
        actions, inner = self.policy.predict(features, inner, start, deterministic)
        acted = self.description.view.env_actions(self.config, actions)
        return (acted[0] if np.ndim(observation) == 1 else acted), (averages, inner)

    def describe(self) -> dict[str, Any]:
        """Equal for equal agents."""
        return {"policy": "Agent", "algorithm": self.description.algorithm, "bundle": self.hash}


def save_bundle(path: Path, description: Description, policy: BasePolicy) -> str:
    """Write a bundle atomically; returns its hash."""
    weights = {name: value.detach().cpu().numpy() for name, value in policy.state_dict().items()}
    text = description.model_dump_json()
    arrays = {f"weight:{name}": value for name, value in weights.items()}
    digest = _hash(text, weights)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, description=np.array(text), hash=np.array(digest), **arrays)
    write_atomically(path, buffer.getvalue())
    return digest


def load_bundle(path: str | Path, config: TaskConfig | None = None) -> Agent:
    """Read a bundle for a task (default: the one that it was trained in).

    Raises:
        FileNotFoundError: no such file.
        ValueError: not a bundle, changed since it was written, of another format, or for another task. Pickles, such
            as SB3's zip files hold, are refused and never executed.
    """
    path = Path(path)
    try:
        with path.open("rb") as stored, np.load(stored, allow_pickle=False) as file:  # numpy leaves a cut-off file open
            arrays = {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise
    except UNREADABLE as error:
        raise ValueError(f"{path}: not a bundle of plain arrays; nothing in it was run") from error
    if not {"description", "hash"} <= set(arrays) or not _plain(arrays):
        raise ValueError(f"{path}: not a bundle: it must hold a description, a hash and weights, all plain arrays")
    text, digest = str(arrays["description"]), str(arrays["hash"])
    weights = {name.removeprefix("weight:"): value for name, value in arrays.items() if name.startswith("weight:")}
    if _hash(text, weights) != digest:
        raise ValueError(f"{path}: changed or cut off since it was written: its hash does not match")
    try:
        description = Description.model_validate_json(text)
    except ValidationError as error:
        raise ValueError(f"{path}: description: {explain(error)}") from error
    policy = build_policy(description)
    try:
        policy.load_state_dict({name: torch.as_tensor(value) for name, value in weights.items()})
    except (RuntimeError, TypeError) as error:
        raise ValueError(f"{path}: weights do not fit the described network: {error}") from error
    try:
        return Agent(description, policy, config or description.task, digest)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def build_policy(description: Description) -> BasePolicy:
    """SB3's policy of a description, with new weights."""
    algorithm, name = ALGORITHMS[description.algorithm]
    arguments = description.network.arguments(description.algorithm)
    policy: BasePolicy = algorithm.policy_aliases[name](*description.view.spaces, lambda _: 0.0, **arguments)
    return policy


def _plain(arrays: Mapping[str, Any]) -> bool:
    return all(isinstance(value, np.ndarray) and value.dtype != object for value in arrays.values())


def _hash(text: str, weights: Mapping[str, npt.NDArray[Any]]) -> str:
    digest = hashlib.sha256(text.encode())
    for name in sorted(weights):
        digest.update(f"{name}{weights[name].dtype}{weights[name].shape}".encode() + weights[name].tobytes())
    return digest.hexdigest()[:32]
