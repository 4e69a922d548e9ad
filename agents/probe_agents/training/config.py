"""Training file (TOML) with all settings of a run, validated before it starts, and the search space of ``tune``."""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final, Self

import tomli_w
from pydantic import AfterValidator, BeforeValidator, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from probe_agents.policies.bundle import ALGORITHMS, Algorithm, Network
from probe_agents.policies.cases import load_case, map_of
from probe_agents.policies.catalogue import make_policy
from probe_agents.policies.plc_law import Constants
from probe_agents.policies.policy import Policy
from probe_agents.policies.view import View, guide_of
from probe_agents.vec_env import ENVIRONMENTS, EnvId
from probe_env.envs.contexts import Context, Split
from probe_env.envs.episodes.starts import RANDOM_TUBES, Contexts, NamedContexts, Probes, resolve_settings
from probe_env.envs.plants import Plant, plant_of
from probe_env.envs.task import TaskConfig
from probe_env.envs.vibration_map import VibrationMap
from probe_env.fidelity import Fidelity, is_surrogate, resolve_fidelity
from probe_env.settings import Model, explain, quantity, tuples, whole_steps

LIMITS: Final[dict[str, tuple[float, float]]] = {
    **dict.fromkeys(("learning_rate", "gamma", "gae_lambda", "tau"), (0.0, 1.0)),
    **dict.fromkeys(("clip_range", "clip_range_vf", "ent_coef", "vf_coef", "max_grad_norm", "target_kl"), (0.0, 100.0)),
    "n_steps": (1, 1 << 20), "batch_size": (2, 1 << 20), "n_epochs": (1, 1000), "buffer_size": (1, 1 << 26),
    "learning_starts": (0, 1 << 26), "train_freq": (1, 1 << 20), "gradient_steps": (-1, 1 << 20),
    "target_update_interval": (1, 1 << 20),
}  # fmt: skip
"""Accepted values of ``learning``, both included; integers only where the bounds are."""
UNLIMITED: Final = ("normalize_advantage", "target_entropy")
"""Other accepted names of ``learning``; all other arguments of an algorithm are set by other fields."""
Count = Annotated[int, Field(ge=1)]


class Environments(Model):
    """Environments of the training."""

    env_id: EnvId = "probe_env/Insertion-v1"
    tube: Annotated[Plant | None, BeforeValidator(plant_of)] = None
    """Your plant: path of its ``tube.toml``, or its fields."""
    map_beside: str | None = None
    """Plant file, or name of a shipped one, next to which the vibration map of the teacher is (set by
    ``train --tube``); default: the shipped map."""
    num_envs: Annotated[int, Field(ge=1, le=1024)] = 16
    contexts: NamedContexts = "train"
    probes: Probes = "scene"
    """"random": every episode has another probe."""
    fidelity: str | Fidelity = "fast"
    """Fidelity of the simulation; "surrogate" replaces it by the vibration map."""
    task: Annotated[dict[str, Any], AfterValidator(tuples)] = Field(default_factory=dict)
    reward_scale: Annotated[float, quantity(1e-6, 1e6, "")] = 1.0


class Imitation(Model):
    """Warm start: the agent imitates a teacher in the states that the agent visits (DAgger)."""

    teacher: str = "privileged"
    rounds: Count = 3
    steps: Count = 8192
    """Environment steps per round."""
    epochs: Count = 20
    learning_rate: Annotated[float, quantity(1e-8, 1.0, "")] = 1e-3


class Validation(Model):
    """Tubes and fidelity in which the best model is selected."""

    contexts: Split = "validation"
    limit: Annotated[int, Field(ge=0)] = 12
    """Number of tubes, from the start of the list; 0: all."""
    fidelity: str | Fidelity = "fast"


class Training(Model):
    """A training run.

    ``learning`` holds arguments of SB3's algorithm (``n_steps``, ``gamma``, ...). A phase begins with
    a reset of all environments and ends with validation and a checkpoint. ``search`` is used by ``probe-env tune``
    only: table -> field -> choices or a range, see ``axes_of``.
    """

    algorithm: Algorithm = "ppo"
    seeds: tuple[Annotated[int, Field(ge=0)], ...] = (0,)
    environment: Environments = Environments()
    network: Network = Network()
    averages: tuple[float, ...] = (5.0, 20.0)
    friction_estimate: bool = False
    least_air_supply_rate: Annotated[float, quantity(0.0, 0.2, "m3/s")] = 0.0
    """Least air of the agent; 0: that of the task."""
    guide: Annotated[Constants | None, BeforeValidator(guide_of)] = None
    """Law to which the agent's actions are added: "plc-proportional" or its ten constants; see ``View``."""
    learning: dict[str, int | float | bool] = Field(default_factory=dict)
    imitation: Imitation | None = None
    pretraining_steps: Annotated[int, Field(ge=0)] = 0
    """Environment steps in the surrogate before the first phase."""
    validation: Validation = Validation()
    phases: Annotated[int, Field(ge=0, le=100_000)] = 8
    phase_steps: Count = 16_384
    search: Annotated[dict[str, dict[str, Any]], AfterValidator(tuples)] | None = None

    @model_validator(mode="after")
    def _fits(self) -> Self:
        try:
            assert self.task
        except ValidationError as error:  # pydantic would report its fields as fields of this model
            raise PydanticCustomError("task", "{text}", {"text": explain(error, "environment.task")}) from error
        arguments = inspect.signature(ALGORITHMS[self.algorithm][0].__init__).parameters
        accepted = [name for name in arguments if name in LIMITS or name in UNLIMITED]
        for name, value in self.learning.items():
            if name not in accepted:
                text = f"learning.{name} is not one of {self.algorithm}'s: {', '.join(accepted)}"
                raise PydanticCustomError("learning", text)
            low, high = LIMITS.get(name, (-math.inf, math.inf))
            kinds, note = ((int,), ", whole numbers") if isinstance(low, int) else ((int, float), "")
            number = isinstance(value, kinds) and not isinstance(value, bool)
            if name in LIMITS and not (number and low <= value <= high):
                text = f"learning.{name} = {value!r} is outside the accepted range {low:.16g} to {high:.16g}{note}"
                raise PydanticCustomError("limits", "{text}", {"text": text})
        if self.imitation is not None and self.algorithm != "ppo":
            raise PydanticCustomError("imitation", f"imitation needs algorithm = 'ppo' (not {self.algorithm!r})")
        targets = "guide", "least_air_supply_rate", "imitation"
        refused = [name for name in targets if getattr(self, name)]
        if self.task.custom_actions and refused:
            text = f"{refused[0]} needs actions that are targets for one control period: probe_env/Insertion-v1"
            raise PydanticCustomError("actions", text)
        if self.pretraining_steps and self.imitation is not None:
            raise PydanticCustomError("pretraining", "pretraining_steps and [imitation] exclude each other")
        if len(set(self.seeds)) != len(self.seeds) or not self.seeds:
            raise PydanticCustomError("seeds", f"seeds = {list(self.seeds)!r} must be one or more different numbers")
        if self.phases == 0 and not self.warm_start:
            text = "phases = 0 without [imitation] or pretraining_steps means no training"
            raise PydanticCustomError("phases", text)
        if is_surrogate(self.validation.fidelity):
            raise PydanticCustomError(
                "fidelity", "validation.fidelity = 'surrogate': agents must be validated by simulation"
            )
        task = self.task
        trained = resolve_fidelity(self.environment.fidelity, task.scene, round_trip=task.returns)
        for fidelity in (trained, self.validation_fidelity):
            if fidelity.time_lapse > 1.0 and not task.growing:
                raise PydanticCustomError(
                    "fidelity", "fidelity with time-lapse needs a growing probe: use standard, or Insertion-v1"
                )
            whole_steps("task.period / fidelity.time_lapse", task.period / fidelity.time_lapse, fidelity.time_step)
        self.view.columns(task)
        assert self.validated_in
        if self.imitation is not None:
            try:
                assert self.teacher
            except (ValueError, FileNotFoundError) as error:
                raise PydanticCustomError("teacher", "{text}", {"text": f"imitation.teacher: {error}"}) from error
        axes_of(self)
        return self

    def to_toml(self) -> str:
        """The training as TOML text, with all settings except the search."""
        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True, exclude={"search"}))

    @cached_property
    def task(self) -> TaskConfig:
        """Task of the training."""
        defaults = ENVIRONMENTS[self.environment.env_id].defaults
        return resolve_settings(defaults, self.environment.task, {"tube": self.environment.tube})[0]

    @cached_property
    def trained_in(self) -> Contexts:
        """Tubes of the training: a shipped list, ranges, or those of the plant."""
        plant, named = self.environment.tube, self.environment.contexts
        if plant is None:
            return named
        return plant.contexts(RANDOM_TUBES) if named == "random" else load_case(plant, named).contexts

    @cached_property
    def validated_in(self) -> tuple[Context, ...]:
        """Tubes in which the best model is selected."""
        return load_case(self.environment.tube, self.validation.contexts, self.validation.limit).contexts

    @cached_property
    def validation_fidelity(self) -> Fidelity:
        """Simulation settings of the validation."""
        return resolve_fidelity(self.validation.fidelity, self.task.scene, round_trip=self.task.returns)

    @cached_property
    def vibration(self) -> VibrationMap | None:
        """Vibration map of the plant, for the teacher and for fidelity "surrogate"; None: the shipped one."""
        file = self.environment.map_beside
        return None if file is None else map_of(Path(file), self.environment.tube)

    @property
    def warm_start(self) -> bool:
        """Whether phase 0 is an imitation or a training in the surrogate."""
        return self.imitation is not None or self.pretraining_steps > 0

    @property
    def teacher(self) -> Policy | None:
        """Policy that is imitated; None: none."""
        if self.imitation is None:
            return None
        return make_policy(
            self.imitation.teacher, self.task.full_observation, self.vibration
        )  # may use more observations than the agent

    @cached_property
    def view(self) -> View:
        """Features and actions of the agent."""
        return View(
            observations=tuple(self.task.observations),
            averages=self.averages,
            friction_estimate=self.friction_estimate,
            least_air_supply_rate=self.least_air_supply_rate,
            logarithmic_feed=self.task.change_per_action == 0.0,
            guide=self.guide,
        )


ROLLOUT: Final = "learning.n_steps"
"""Steps of each environment between two updates; SAC has no rollouts."""


class Range(Model):
    """Numbers from ``low`` to ``high``, both included, integers if both are; ``log``: uniform in the logarithm."""

    low: int | float
    high: int | float
    log: bool = False

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if not -math.inf < self.low < self.high < math.inf:
            raise PydanticCustomError("order", f"low = {self.low!r} is not below high = {self.high!r}")
        if self.log and self.low <= 0:
            raise PydanticCustomError("log", f"low = {self.low!r} is not above 0, as log = true needs")
        return self


Axis = Range | tuple[Any, ...]
"""Search range of a field, or its choices."""
_ANY: Final[dict[str, Axis]] = {
    "learning.gamma": (0.98, 0.99, 0.995, 0.998, 0.999, 0.9995),
    "learning.batch_size": (64, 128, 256, 512),
    "network.net_arch": ((32, 32), (64, 64), (128, 128)),
}
_PPO: Final[dict[str, Axis]] = _ANY | {
    "learning.learning_rate": Range(low=1e-5, high=1e-3, log=True),
    "learning.n_epochs": Range(low=2, high=12),
    "learning.gae_lambda": Range(low=0.9, high=1.0),
    "learning.clip_range": Range(low=0.05, high=0.3),
    "learning.ent_coef": Range(low=1e-6, high=1e-2, log=True),
    "network.log_std_init": Range(low=-4.0, high=-1.0),
}
USUAL: Final[dict[str, dict[str, Axis]]] = {
    "ppo": _PPO,
    "recurrent-ppo": _PPO | {"network.lstm_hidden_size": (32, 64, 128)},
    "sac": _ANY | {
        "learning.learning_rate": Range(low=1e-4, high=3e-3, log=True),
        "learning.tau": Range(low=0.002, high=0.05, log=True),
        "learning.gradient_steps": (1, 2, 4, 8),
    },
}  # fmt: skip
"""Search space of an algorithm for files without ``[search]``; rollouts that fill phases are added."""


def axes_of(training: Training) -> dict[str, Axis]:
    """Search space: field, such as "learning.gamma" -> its choices or range.

    Raises:
        PydanticCustomError: ``search`` names an unknown field, or values that a training does not accept.
    """
    if training.search is None:
        steps = (32, 64, 128, 256, 512) if training.algorithm != "sac" else ()
        rollouts = tuple(number for number in steps if _fills_phases(training, number))
        return USUAL[training.algorithm] | ({ROLLOUT: rollouts} if len(rollouts) > 1 else {})
    tables = [name for name in ("learning", "network", "imitation") if getattr(training, name) is not None]
    axes: dict[str, Axis] = {}
    for table, fields in training.search.items():
        if table not in tables:
            accepted = ", ".join(tables)
            raise _search_error(f".{table}", f"cannot be searched in this file; accepted: {accepted}")
        for field, value in fields.items():
            try:
                axes[f"{table}.{field}"] = _axis(training.model_copy(update={"search": None}), table, field, value)
            except ValueError as error:
                problem = explain(error) if isinstance(error, ValidationError) else str(error)
                raise _search_error(f".{table}.{field}", problem) from error
    if not axes:
        raise _search_error("", "is empty")
    return axes


def with_values(training: Training, point: Mapping[str, Any]) -> Training:
    """The training with other values of fields, such as "learning.gamma".

    Raises:
        ValidationError: a value is not accepted.
    """
    update: dict[str, dict[str, Any]] = {"learning": dict(training.learning)}
    for name, value in point.items():
        table, _, field = name.partition(".")
        update.setdefault(table, {})[field] = value
    return training.model_copy(update=update)


def value_in(training: Training, name: str) -> Any:
    """Value of a field; for ``learning`` the default is that of the algorithm."""
    table, _, field = name.partition(".")
    if table != "learning":
        return getattr(getattr(training, table), field)
    arguments = inspect.signature(ALGORITHMS[training.algorithm][0].__init__).parameters
    return training.learning.get(field, arguments[field].default)


def _axis(training: Training, table: str, field: str, value: Any) -> Axis:
    """Choices or a range; the training must accept each choice, or both ends."""
    axis: Axis = Range.model_validate(value) if isinstance(value, dict) else value
    ends = (axis.low, axis.high) if isinstance(axis, Range) else axis
    if not (isinstance(ends, tuple) and len(ends) > 1 and all(ends.count(choice) == 1 for choice in ends)):
        raise ValueError(f"{value!r} is neither two or more different choices nor a range {{ low, high }}")
    sizes = training.network.arguments(training.algorithm)
    if table == "network" and field not in sizes:
        raise ValueError(f"is not one of {training.algorithm}'s: {', '.join(sizes)}")
    for choice in ends:
        with_values(training, {f"{table}.{field}": choice})
    if f"{table}.{field}" == ROLLOUT and training.algorithm != "sac":
        if isinstance(axis, Range):
            raise ValueError("must be a list of choices, since rollouts must fill phases")
        for steps in axis:
            if not _fills_phases(training, steps):
                environments = training.environment.num_envs
                raise ValueError(
                    f"{steps}: the {training.phase_steps} steps of a phase in {environments} environments are not a"
                    " whole number of such rollouts"
                )
    return axis


def _fills_phases(training: Training, steps: int) -> bool:
    """Whether rollouts of this length fill the phases; else the trainings of a search would differ in length."""
    return training.phase_steps % (steps * training.environment.num_envs) == 0


def _search_error(field: str, problem: str) -> PydanticCustomError:
    return PydanticCustomError("search", "{text}", {"text": f"search{field}: {problem}"})
