"""A trained agent as one safetensors file: weights, and a description of its network, view and task in the metadata.

Loading builds the network from the validated description and fills in the weights; nothing in the file is executed. A
zip file of Stable-Baselines3 holds a pickle, which can run any code, so commands take bundles alone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
import numpy.typing as npt
import safetensors.numpy
import torch
from pydantic import Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.vec_env import VecNormalize

from agents.policies.policy import Domain, RangesOfTubes
from agents.policies.trained import RESTORE, read_weights
from agents.policies.view import View
from agents.records.atomic import write_atomically
from probe_env.envs.task import TaskConfig, action_in
from probe_env.envs.task.scales import PROBE
from probe_env.envs.vibration_map import stored_map
from probe_env.files import FileError
from probe_env.settings import Model, explain, quantity

Algorithm = Literal["ppo", "sac", "recurrent-ppo"]
ALGORITHMS: Final[dict[Algorithm, tuple[Any, str]]] = {
    "ppo": (PPO, "MlpPolicy"),
    "sac": (SAC, "MlpPolicy"),
    "recurrent-ppo": (RecurrentPPO, "MlpLstmPolicy"),
}
KNOWN: Final = ("net_arch", "log_std_init", "lstm_hidden_size", "ortho_init", "use_sde")
"""Arguments of a policy that a bundle describes, or that change nothing after training."""
MOST_WEIGHTS: Final = 1 << 24
"""Weights between the hidden layers, so that what a file describes cannot fill the memory."""
LARGEST_WEIGHT: Final = 1e6
SAME: Final = ("growing", "period")
"""Fields of the task that must be those of training."""
PREVIOUS: Final = {"feed_speeds": "previous_feed_action", "air_supply_rates": "previous_air_action"}
"""Ranges that may be others, and the observation that is in their terms."""


class Network(Model):
    """Size of the policy's networks; ``lstm_hidden_size`` is for recurrent-ppo alone."""

    net_arch: Annotated[tuple[Annotated[int, Field(ge=1, le=4096)], ...], Field(max_length=8)] = (64, 64)
    lstm_hidden_size: int = Field(default=64, ge=1, le=2048)
    log_std_init: Annotated[float, quantity(-20.0, 5.0, "")] = -1.0
    noise_interval: int = Field(default=0, ge=0, le=10_000)
    """Steps for which exploration is one function of the features (gSDE: Raffin et al. 2022); 0: new noise each."""

    @model_validator(mode="after")
    def _fits_in_memory(self) -> Self:
        weights = sum(a * b for a, b in pairwise(self.net_arch))
        if weights > MOST_WEIGHTS:
            raise PydanticCustomError("weights", f"net_arch: {weights} weights are more than {MOST_WEIGHTS}")
        return self

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
    tubes: RangesOfTubes | None = None
    """Ranges of the fields of ``Context`` that it was trained in; default: those of the shipped lists."""
    trained: dict[str, Any]
    """Run that made it: config, seed, steps, versions, commit, machine."""


class Agent:
    """A trained policy with SB3's ``predict`` on the task's own observations; memory is in the state that it returns.

    Where a probe is drawn back, too, its feed is in the steps of the device that it was trained with.

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
        for name in SAME:
            trained, here = getattr(description.task, name), getattr(config, name)
            if trained != here:
                raise ValueError(f"{name} = {here!r} differs from {trained!r}, which the agent was trained with")
        others = [name for name in PREVIOUS if getattr(description.task, name) != getattr(config, name)]
        step = description.task.feed_speed_step
        self._feed_speed_step = step if config.returns and step != config.feed_speed_step else 0.0
        if others and description.view.guide is not None:
            trained, here = getattr(description.task, others[0]), getattr(config, others[0])
            raise ValueError(f"{others[0]} = {here!r} differs from {trained!r}, in which the agent's guide acts")
        self._other_ranges = bool(others)
        self.description, self.policy, self.config, self.hash = description, policy, config, hash
        policy.set_training_mode(False)

    @property
    def domain(self) -> Domain:
        """Tubes that it was trained in; an agent that sees which probe it feeds knows any."""
        made, scene = self.description, self.description.task.scene
        ranges = made.tubes or Domain.of_map(stored_map()).ranges
        any_probe = set(PROBE) <= set(made.view.observations)
        return Domain(ranges, scene.tube.inner_diameter, scene.tube.helix_length, None if any_probe else scene.probe)

    def predict(
        self,
        observation: npt.NDArray[np.floating[Any]],
        state: tuple[Any, ...] | None = None,
        episode_start: npt.NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[npt.NDArray[np.float32], tuple[Any, ...]]:
        """Actions of the environment for observations (d,) or (N, d), and the state to give back next time."""
        rows = np.atleast_2d(observation)
        if self._other_ranges:  # previous actions as the task of the training says them
            rows, names = rows.copy(), list(self.config.observations)
            for name, column in PREVIOUS.items():
                here, trained = getattr(self.config, name), getattr(self.description.task, name)
                rows[:, names.index(column)] = action_in(rows[:, names.index(column)], here, trained)
        new = np.zeros(len(rows), dtype=bool) if episode_start is None else np.asarray(episode_start, dtype=bool)
        memory, inner = state if state is not None else (None, None)
        view = self.description.view
        features, memory = view.features(self.config, rows, memory, new)
        start = np.ones(len(rows), dtype=bool) if state is None else new
        actions, inner = self.policy.predict(features, inner, start, deterministic)
        applied = view.env_actions(self.description.task, actions, view.guided(features))
        if not np.isfinite(applied).all():
            raise ValueError(f"the agent of bundle {self.hash or '(unsaved)'} acts with numbers that are not finite")
        if self._other_ranges:
            applied = self.config.actions(*self.description.task.targets(applied).T).astype(np.float32)
        if self._feed_speed_step:  # a network's output varies all the time, and every change shakes a withdrawn probe
            feed, air = self.config.targets(applied).T
            feed = self._feed_speed_step * np.round(feed / self._feed_speed_step)
            applied = self.config.actions(feed, air).astype(np.float32)
        return (applied[0] if np.ndim(observation) == 1 else applied), (memory, inner)

    def describe(self) -> dict[str, Any]:
        """Equal for equal agents."""
        return {"policy": "Agent", "algorithm": self.description.algorithm, "bundle": self.hash}


def write_bundle(path: Path, description: Description, policy: BasePolicy) -> str:
    """Write a bundle atomically; returns its hash."""
    weights = {name: value.detach().cpu().numpy() for name, value in policy.state_dict().items()}
    text = description.model_dump_json()
    metadata = {"description": text, "hash": _hash(text, weights)}
    write_atomically(path, safetensors.numpy.save(weights, metadata))
    return metadata["hash"]


def load_bundle(path: str | Path, config: TaskConfig | None = None) -> Agent:
    """Read a bundle for a task (default: the one that it was trained in).

    Raises:
        FileNotFoundError: no such file.
        FileError: not a bundle, changed since it was written, of another format, or for another task. Pickles, such
            as SB3's zip files hold, are refused and never executed.
    """
    path = Path(path)
    text, digest, weights = read_weights(path)
    try:
        description = Description.model_validate_json(text)
    except ValidationError as error:
        raise FileError(path, f"description: {explain(error)}") from error
    if _hash(text, weights) != digest:
        raise FileError(path, f"changed or cut off since it was written: its hash does not match - {RESTORE}")
    policy = build_policy(description, initialised=False)
    network = {name: value.numpy() for name, value in policy.state_dict().items()}
    for name in sorted(network.keys() | weights.keys()):
        needed, found = (
            f"{part[name].dtype} {part[name].shape}" if name in part else "missing" for part in (network, weights)
        )
        if found != needed:
            raise FileError(path, f"weights do not fit the described network: {name!r} is {found}, not {needed}")
        if not np.abs(weights[name]).max(initial=0.0) <= LARGEST_WEIGHT:
            raise FileError(path, f"weights: {name!r} holds values that are not finite or beyond {LARGEST_WEIGHT:g}")
    policy.load_state_dict({name: torch.as_tensor(value) for name, value in weights.items()})
    try:
        return Agent(description, policy, config or description.task, digest)
    except ValueError as error:
        raise FileError(path, str(error)) from error


def build_policy(description: Description, initialised: bool = True) -> BasePolicy:
    """SB3's policy of a description, with new weights; ``initialised``: with those that training begins from."""
    algorithm, name = ALGORITHMS[description.algorithm]
    arguments = description.network.arguments(description.algorithm)
    if not initialised and description.algorithm != "sac":
        arguments["ortho_init"] = False  # which takes long for large networks
    if description.network.noise_interval:
        arguments["use_sde"] = True
    policy: BasePolicy = algorithm.policy_aliases[name](*description.view.spaces, lambda _: 0.0, **arguments)
    return policy


def _hash(text: str, weights: Mapping[str, npt.NDArray[Any]]) -> str:
    digest = hashlib.sha256(text.encode())
    for name in sorted(weights):
        digest.update(f"{name}{weights[name].dtype}{weights[name].shape}".encode() + weights[name].tobytes())
    return digest.hexdigest()[:32]


def from_sb3(model: BaseAlgorithm, config: TaskConfig) -> Agent:
    """A model of Stable-Baselines3 as a policy, in every task that shows what it was trained on.

    Args:
        model: trained on ``ProbeVecEnv(config=config)`` or an environment of that task, without wrappers that change
            observations or actions.
        config: the task that it was trained in.

    Raises:
        ValueError: the model is of another kind, or of other spaces than the task.
    """
    return Agent(_described(model, config), model.policy, config.full_observation)


def save_bundle(path: str | Path, model: BaseAlgorithm, config: TaskConfig) -> str:
    """Write a model as a bundle (.safetensors), which every command takes; returns its hash. See ``from_sb3``.

    Raises:
        ValueError: as ``from_sb3``, or the policy has arguments that a bundle does not describe.
    """
    unknown = sorted(set(model.policy_kwargs) - set(KNOWN))
    if unknown or isinstance(model.policy_kwargs.get("net_arch"), dict):
        what = ", ".join(unknown) or "net_arch with different networks"
        raise ValueError(f"policy_kwargs: a bundle does not describe {what}")
    return write_bundle(Path(path), _described(model, config), model.policy)


def _described(model: BaseAlgorithm, config: TaskConfig) -> Description:
    algorithm = next((name for name, (kind, _) in ALGORITHMS.items() if isinstance(model, kind)), None)
    if algorithm is None:
        kinds = ", ".join(kind.__name__ for kind, _ in ALGORITHMS.values())
        raise ValueError(f"model is a {type(model).__name__}; {kinds} are accepted")
    view = View(observations=tuple(config.observations), averages=(), logarithmic_feed=False)
    for name, needed in zip(("observation_space", "action_space"), view.spaces, strict=True):
        shape = getattr(model, name).shape
        if shape != needed.shape:
            raise ValueError(f"{name} of the model has shape {shape}; that of the task is {needed.shape}")
    if isinstance(model.get_env(), VecNormalize):
        raise ValueError("model was trained with VecNormalize, whose statistics a policy alone does not have")
    sizes = {name: value for name, value in model.policy_kwargs.items() if name == "log_std_init"}
    memory = getattr(model.policy, "lstm_actor", None)
    if memory is not None:
        sizes["lstm_hidden_size"] = memory.hidden_size
    shape = getattr(model.policy, "net_arch", None)
    if isinstance(shape, dict):  # equal networks of actor and critic
        shape = shape.get("pi", shape.get("vf"))
    network = Network(net_arch=tuple(shape or ()), **sizes)
    trained = {"by": "stable_baselines3", "steps": int(model.num_timesteps), "seed": model.seed}
    return Description(algorithm=algorithm, network=network, view=view, task=config, trained=trained)
