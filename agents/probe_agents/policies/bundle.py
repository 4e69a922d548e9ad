"""A trained agent as one safetensors file: weights, and metadata that describe its network, view and task.

Loading runs no code of the file. A zip file of Stable-Baselines3 holds a pickle, which can run any code.
"""

import hashlib
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
import numpy.typing as npt
import safetensors.numpy
import torch
from pydantic import Field, FiniteFloat, model_validator
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.policies import BasePolicy

from probe_agents.policies.policy import Domain, ObservationPolicy, RangesOfTubes
from probe_agents.policies.trained import RESTORE, read_weights
from probe_agents.policies.view import View
from probe_agents.records.atomic import write_atomically
from probe_env.arrays import BoolArray
from probe_env.envs.episodes.actions import averaged_columns, changed_targets
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.scales import PROBE, action_in
from probe_env.envs.vibration_map import stored_map
from probe_env.files import FileError
from probe_env.settings import Model, errors_in, quantity

Floats = npt.NDArray[np.floating[Any]]
Algorithm = Literal["ppo", "sac", "recurrent-ppo", "td3", "tqc"]
POLICIES: Final[dict[Algorithm, tuple[Any, str]]] = {
    "ppo": (PPO, "MlpPolicy"),
    "sac": (SAC, "MlpPolicy"),
    "recurrent-ppo": (RecurrentPPO, "MlpLstmPolicy"),
    "td3": (TD3, "MlpPolicy"),
    "tqc": (TQC, "MlpPolicy"),
}
"""Algorithms whose models can be policies; training files know PPO only."""
ACTIVATIONS: Final = {
    kind.__name__: kind
    for kind in (torch.nn.ReLU, torch.nn.Tanh, torch.nn.ELU, torch.nn.LeakyReLU, torch.nn.SiLU, torch.nn.GELU)
}
KNOWN: Final = (
    "net_arch", "activation_fn", "log_std_init", "lstm_hidden_size", "ortho_init",
    "optimizer_class", "optimizer_kwargs",
)  # fmt: skip
"""Policy arguments that a bundle describes, or that have no effect after training."""
OFF_POLICY: Final = ("sac", "td3", "tqc")
MAX_WEIGHTS: Final = 1 << 24
"""Limit of the weights between the hidden layers, so that a file cannot exhaust the memory."""
LARGEST_WEIGHT: Final = 1e6
SAME: Final = ("growing", "period")
"""Task fields that must equal those of the training."""
DECISIONS: Final = ("periods_per_action", "change_per_action", "feed_decrease_per_action", "logarithmic_change")
"""Task fields of the meaning of an action; the agent converts its actions to one target per control period."""
PREVIOUS: Final = {"feed_speeds": "previous_feed_action", "air_supply_rates": "previous_air_action"}
"""Ranges that may differ from the training -> observation that is scaled by them."""


class Network(Model):
    """Hidden layers of the networks of actor and critic, and the initial standard deviation of PPO's actions."""

    net_arch: Annotated[tuple[Annotated[int, Field(ge=1, le=4096)], ...], Field(max_length=8)] = (64, 64)
    log_std_init: Annotated[float, quantity(-20.0, 5.0, "")] = -1.0

    @model_validator(mode="after")
    def _fits_in_memory(self) -> Self:
        weights = sum(a * b for a, b in pairwise(self.net_arch))
        if weights > MAX_WEIGHTS:
            raise ValueError(f"net_arch: {weights} weights are more than {MAX_WEIGHTS}")
        return self


class StoredNetwork(Network):
    """Network of a bundle; ``lstm_hidden_size`` applies to recurrent-ppo only."""

    lstm_hidden_size: int = Field(default=64, ge=1, le=2048)
    activation: Literal["ReLU", "Tanh", "ELU", "LeakyReLU", "SiLU", "GELU"] | None = None
    """Class of torch.nn; default: that of the algorithm."""

    def arguments(self, algorithm: Algorithm) -> dict[str, Any]:
        """SB3's ``policy_kwargs``."""
        arguments: dict[str, Any] = {"net_arch": list(self.net_arch)}
        if self.activation:
            arguments["activation_fn"] = ACTIVATIONS[self.activation]
        if algorithm in OFF_POLICY:
            return arguments
        arguments["log_std_init"] = self.log_std_init
        if algorithm == "recurrent-ppo":
            arguments["lstm_hidden_size"] = self.lstm_hidden_size
        return arguments


class Normalisation(Model):
    """Statistics of SB3's ``VecNormalize``, one value per observation."""

    mean: tuple[FiniteFloat, ...]
    var: tuple[Annotated[FiniteFloat, Field(ge=0.0)], ...]
    clip_obs: Annotated[float, Field(gt=0.0)]
    epsilon: Annotated[FiniteFloat, Field(gt=0.0)]

    def apply(self, features: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.float32]:
        """Features (N, d) as ``VecNormalize`` returns them: (x - mean) / sqrt(var + epsilon), clipped."""
        scaled = (features - np.array(self.mean)) / np.sqrt(np.array(self.var) + self.epsilon)
        clipped: npt.NDArray[np.float32] = np.clip(scaled, -self.clip_obs, self.clip_obs).astype(np.float32)
        return clipped


class Description(Model):
    """Metadata of a bundle: what the agent observes, for which task and tubes it was trained, and how."""

    format: Literal[1] = 1
    algorithm: Algorithm
    network: StoredNetwork
    view: View
    task: TaskConfig
    normalisation: Normalisation | None = None
    tubes: RangesOfTubes | None = None
    """Ranges of the fields of ``Context`` in training; default: those of the shipped lists."""
    trained: dict[str, Any]
    """Training run: config, seed, steps, versions, commit, machine."""

    @model_validator(mode="after")
    def _one_statistic_per_feature(self) -> Self:
        if self.normalisation and not len(self.normalisation.mean) == len(self.normalisation.var) == self.view.size:
            raise ValueError(f"normalisation: mean and var must have {self.view.size} values each")
        return self


class Agent(ObservationPolicy):
    """A trained policy with SB3's ``predict`` on the observations of a task; memory is in the returned state.

    Args:
        description: metadata of the bundle.
        policy: SB3's policy with its weights.
        config: task that it acts in; it may have more observations than the agent uses.
        hash: hash of the bundle, for ``describe``.
    """

    def __init__(self, description: Description, policy: BasePolicy, config: TaskConfig, hash: str = "") -> None:
        description.view.columns(config)
        for name in SAME:
            trained, here = getattr(description.task, name), getattr(config, name)
            if trained != here:
                raise ValueError(f"{name} = {here!r} differs from {trained!r}, the value in training")
        others = [name for name in PREVIOUS if getattr(description.task, name) != getattr(config, name)]
        self._other_ranges = bool(others)
        timing = {name: getattr(description.task, name) for name in DECISIONS}
        self._config = config.model_copy(update=timing)  # whose decision period is that of the training
        self.description, self.policy, self.config, self.hash = description, policy, config, hash
        policy.set_training_mode(False)

    @property
    def domain(self) -> Domain:
        """Tubes of the training; any probe if the agent observes the probe."""
        made, scene = self.description, self.description.task.scene
        ranges = made.tubes or Domain.of_map(stored_map()).ranges
        any_probe = set(PROBE) <= set(made.view.observations)
        return Domain(ranges, scene.tube.inner_diameter, scene.tube.helix_length, None if any_probe else scene.probe)

    def _act(
        self, rows: Floats, state: Any, start: BoolArray, deterministic: bool
    ) -> tuple[npt.NDArray[np.float32], tuple[Any, ...]]:
        """(N, 2) targets of the control period for observations (N, d), and the next state."""
        if self._other_ranges:  # previous actions in the ranges of the training
            rows, names = rows.copy(), list(self.config.observations)
            for name, column in PREVIOUS.items():
                here, trained = getattr(self.config, name), getattr(self.description.task, name)
                rows[:, names.index(column)] = action_in(rows[:, names.index(column)], here, trained)
        act = self._hold if self.description.task.custom_actions else self._infer
        applied, state = act(rows, state, start, deterministic)
        if self._other_ranges:
            applied = self.config.actions(*self.description.task.targets(applied).T).astype(np.float32)
        return applied, state

    def _infer(self, rows: Floats, state: Any, start: BoolArray, deterministic: bool) -> tuple[Floats, tuple[Any, ...]]:
        """(N, 2) actions of the environment of the training for observations (N, d), and the next state."""
        memory, inner = state if state is not None else (None, None)
        view = self.description.view
        features, memory = view.features(self._config, rows, memory, start)
        normalisation = self.description.normalisation
        inputs = normalisation.apply(features) if normalisation else features
        actions, inner = self.policy.predict(inputs, inner, start, deterministic)
        applied = view.env_actions(self.description.task, actions)
        if not np.isfinite(applied).all():
            raise ValueError(f"the agent of bundle {self.hash or '(unsaved)'} returned actions that are not finite")
        return applied, (memory, inner)

    def _hold(self, rows: Floats, state: Any, start: BoolArray, deterministic: bool) -> tuple[Floats, tuple[Any, ...]]:
        """(N, 2) targets of this control period: an action is applied for some periods, see ``step_action``."""
        names, columns = list(self.config.observations), averaged_columns(self.config)
        task, first = self.description.task, rows[:, [names.index(name) for name in PREVIOUS.values()]]
        periods, targets, sums, inner = state or (0, first, 0.0, None)
        targets = np.where(start[:, None], first, targets).astype(np.float32)
        periods, sums = np.where(start, 1, periods + 1), np.where(start[:, None], 0.0, sums) + rows[:, columns]
        due = start | (periods == task.periods_per_action)
        if due.any():
            means = rows.copy()
            means[:, columns] = sums / periods[:, None]
            actions, new = self._infer(means, inner, start, deterministic)
            targets = np.where(due[:, None], changed_targets(task, targets, actions), targets)
            inner = new if inner is None else _selected(due, new, inner)
            periods, sums = np.where(due, 0, periods), np.where(due[:, None], 0.0, sums)
        return targets, (periods, targets, sums, inner)

    def describe(self) -> dict[str, Any]:
        """With the hash of the bundle."""
        return {"policy": "Agent", "algorithm": self.description.algorithm, "bundle": self.hash}


def _selected(which: BoolArray, new: Any, old: Any) -> Any:
    """State of the probes ``which`` (N,) from ``new`` and of the others from ``old``; N is the last axis but one."""
    if isinstance(new, tuple):
        return tuple(_selected(which, a, b) for a, b in zip(new, old, strict=True))
    return new if new is None else np.where(which[:, None], new, old)


def write_bundle(path: Path, description: Description, policy: BasePolicy) -> str:
    """Write a bundle atomically; returns its hash."""
    weights, text = _weights(policy), description.model_dump_json()
    metadata = {"description": text, "hash": _hash(text, weights)}
    write_atomically(path, safetensors.numpy.save(weights, metadata))
    return metadata["hash"]


def load_bundle(path: str | Path, config: TaskConfig | None = None) -> Agent:
    """Read a bundle for a task (default: the task of the training).

    Raises:
        FileNotFoundError: no such file.
        FileError: not a bundle, changed since it was written, of another format, or for another task. Pickles, such
            as SB3's zip files, are refused and never executed.
    """
    path = Path(path)
    text, digest, weights = read_weights(path)
    with errors_in(path, "description"):
        description = Description.model_validate_json(text)
    if _hash(text, weights) != digest:
        raise FileError(path, f"changed or cut off since it was written: its hash does not match - {RESTORE}")
    with errors_in(path):
        description.view.columns(config or description.task)  # before the weights: their number depends on it
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
    with errors_in(path):
        return Agent(description, policy, config or description.task, digest)


def build_policy(description: Description, initialised: bool = True) -> BasePolicy:
    """Build SB3's policy of a description; ``initialised``: with the initial weights of training."""
    algorithm, name = POLICIES[description.algorithm]
    arguments = description.network.arguments(description.algorithm)
    if not initialised and description.algorithm not in OFF_POLICY:
        arguments["ortho_init"] = False  # slow for large networks
    policy: BasePolicy = algorithm.policy_aliases[name](*description.view.spaces, lambda _: 0.0, **arguments)
    return policy


def _weights(policy: BasePolicy) -> dict[str, npt.NDArray[Any]]:
    return {name: value.detach().cpu().numpy() for name, value in policy.state_dict().items()}


def _hash(text: str, weights: Mapping[str, npt.NDArray[Any]]) -> str:
    digest = hashlib.sha256(text.encode())
    for name in sorted(weights):
        digest.update(f"{name}{weights[name].dtype}{weights[name].shape}".encode() + weights[name].tobytes())
    return digest.hexdigest()[:32]


def from_sb3(model: BaseAlgorithm, config: TaskConfig) -> Agent:
    """Make a policy of a Stable-Baselines3 model, for every task with the observations of its training.

    Args:
        model: trained on ``ProbeVecEnv(config=config)`` or an environment of that task, without wrappers that change
            observations or actions, except ``VecNormalize``, whose statistics are copied. A loaded model needs it:
            ``PPO.load(path, env=VecNormalize.load(statistics, env))``.
        config: task of the training.

    Raises:
        ValueError: another algorithm, spaces that differ from the task's, or unknown statistics of ``VecNormalize``.
    """
    description = _described(model, config)
    digest = _hash(description.model_dump_json(), _weights(model.policy))  # equal agents are simulated once
    return Agent(description, model.policy, config.full_observation, digest)


def save_bundle(path: str | Path, model: BaseAlgorithm, config: TaskConfig) -> str:
    """Write a model as a bundle (.safetensors), which every command accepts; returns its hash. See ``from_sb3``."""
    net_arch, activation = (model.policy_kwargs.get(name) for name in ("net_arch", "activation_fn"))
    unknown = sorted(set(model.policy_kwargs) - {"use_sde", *KNOWN}) + ["use_sde"] * model.use_sde
    if isinstance(net_arch, dict) and net_arch.get("pi") != net_arch.get("vf", net_arch.get("qf")):
        unknown.append("net_arch with different networks")
    if activation is not None and activation not in ACTIVATIONS.values():
        unknown.append(f"activation_fn = {activation.__name__} (only {', '.join(ACTIVATIONS)})")
    if unknown:
        raise ValueError(f"policy_kwargs: a bundle cannot store {', '.join(unknown)}")
    return write_bundle(Path(path), _described(model, config), model.policy)


def _described(model: BaseAlgorithm, config: TaskConfig) -> Description:
    algorithm = next((name for name, (kind, _) in POLICIES.items() if isinstance(model, kind)), None)
    if algorithm is None:
        kinds = ", ".join(kind.__name__ for kind, _ in POLICIES.values())
        raise ValueError(f"model is a {type(model).__name__}; {kinds} are accepted")
    low, high = np.array([bounds[:2] for bounds in config.observations.values()], dtype=np.float32).T
    _check_bounds("observation", model.observation_space, low, high)
    _check_bounds("action", model.action_space, np.full(2, -1.0), np.full(2, 1.0))
    sizes = {name: value for name, value in model.policy_kwargs.items() if name == "log_std_init"}
    memory = getattr(model.policy, "lstm_actor", None)
    if memory is not None:
        sizes["lstm_hidden_size"] = memory.hidden_size
    shape = getattr(model.policy, "net_arch", None)
    if isinstance(shape, dict):  # networks of actor and critic, which are equal in a bundle
        shape = shape.get("pi")
    activation = getattr(model.policy, "activation_fn", None)
    sizes["activation"] = next((name for name, kind in ACTIVATIONS.items() if kind is activation), None)
    network = StoredNetwork(net_arch=tuple(shape or ()), **sizes)
    trained = {"by": "stable_baselines3", "steps": int(model.num_timesteps), "seed": model.seed}
    view = View(observations=tuple(config.observations), averages=(), logarithmic_feed=False)
    return Description(
        algorithm=algorithm, network=network, view=view, task=config, normalisation=_normalisation(model, config),
        trained=trained,
    )  # fmt: skip


def _check_bounds(
    kind: str, space: Any, low: npt.NDArray[np.floating[Any]], high: npt.NDArray[np.floating[Any]]
) -> None:
    """Raise ValueError if the space of a model is not the task's."""
    if space.shape != low.shape:
        raise ValueError(f"{kind}_space of the model has shape {space.shape}; that of the task is {low.shape}")
    for end, found, needed in (("low", space.low, low), ("high", space.high, high)):
        for k in np.flatnonzero(found != needed)[:1]:
            raise ValueError(
                f"{kind}_space.{end}[{k}] of the model is {found[k]:g}; that of the task is {needed[k]:g}:"
                f" train without wrappers that rescale {kind}s"
            )


def _normalisation(model: BaseAlgorithm, config: TaskConfig) -> Normalisation | None:
    """Statistics of the model's ``VecNormalize``; None if it normalises no observations."""
    normalise = model.get_vec_normalize_env()
    if normalise is None:
        if _was_normalised(model, config):  # SB3's file has its observations, but not the statistics
            raise ValueError(
                "model was trained with VecNormalize, whose statistics are not in its file: load it with"
                " env=VecNormalize.load(statistics, env)"
            )
        return None
    if not normalise.norm_obs:
        return None
    statistics: Any = normalise.obs_rms
    mean, var = tuple(statistics.mean.tolist()), tuple(statistics.var.tolist())
    return Normalisation(mean=mean, var=var, clip_obs=normalise.clip_obs, epsilon=normalise.epsilon)


def _was_normalised(model: BaseAlgorithm, config: TaskConfig) -> bool:
    """Whether a model was trained with a ``VecNormalize`` that it no longer has, as far as its file tells.

    Original observations are stored by on-policy algorithms only with ``VecNormalize``, by the others always. The sum
    of inserted and remaining length is constant, and differs in normalised observations.
    """
    last, original = model._last_obs, model._last_original_obs
    if original is None or last is None:  # without the last observations, after loading with another environment
        return original is not None and isinstance(model, OnPolicyAlgorithm)
    columns = [list(config.observations).index(name) for name in ("inserted_length", "remaining_length")]
    now, before = (np.asarray(rows)[:, columns].sum(axis=1) for rows in (last, original))
    return not np.allclose(now, before, atol=1e-3)
