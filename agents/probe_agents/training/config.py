"""Training file (TOML) with all settings of a run, validated before it starts."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from probe_agents.policies.bundle import Network
from probe_agents.policies.cases import load_case
from probe_agents.policies.catalogue import make_policy
from probe_agents.policies.policy import Policy
from probe_agents.policies.view import View
from probe_agents.vec_env import ENVIRONMENTS, EnvId
from probe_env.envs.contexts import Context, Split
from probe_env.envs.episodes.limits import check_fidelity
from probe_env.envs.episodes.starts import RANDOM_TUBES, Contexts, NamedContexts, Probes, resolve_settings
from probe_env.envs.plants import Plant, map_file, plant_of
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.vibration_map import VibrationMap, load_for
from probe_env.fidelity import Fidelity, is_surrogate, resolve_fidelity
from probe_env.settings import Model, explain, quantity, tuples

Count = Annotated[int, Field(ge=1)]
Fraction = Annotated[float, quantity(0.0, 1.0, "")]
Coefficient = Annotated[float, quantity(0.0, 100.0, "")]


class Environments(Model):
    """Environments of the training."""

    env_id: EnvId = "probe_env/Insertion-v1"
    tube: Annotated[Plant | None, BeforeValidator(plant_of)] = None
    """Your plant: path of its ``tube.toml``, or its fields."""
    surrogate_map: str | None = None
    """File of the vibration map, for the teacher and for fidelity "surrogate"; default: NAME-map.npz next to the file
    of the ``tube`` if it exists, else the shipped map."""
    num_envs: Annotated[int, Field(ge=1, le=1024)] = 16
    contexts: NamedContexts = "train"
    probes: Probes = "scene"
    """"random": every episode has another probe."""
    fidelity: str | Fidelity = "fast"
    """Fidelity of the simulation; "surrogate" replaces it by the vibration map."""
    task: Annotated[dict[str, Any], AfterValidator(tuples)] = Field(default_factory=dict)
    reward_scale: Annotated[float, quantity(1e-6, 1e6, "")] = 1.0

    @model_validator(mode="before")
    @classmethod
    def _with_map_of_tube(cls, fields: Any) -> Any:
        tube = fields.get("tube") if isinstance(fields, Mapping) else None
        if isinstance(tube, str | Path) and not fields.get("surrogate_map") and map_file(Path(tube)).exists():
            return {**fields, "surrogate_map": str(map_file(Path(tube)))}
        return fields


class Learning(Model):
    """Arguments of SB3's PPO; default: PPO's own."""

    learning_rate: Fraction | None = None
    n_steps: Annotated[int, Field(ge=1, le=1 << 20)] | None = None
    """Steps of each environment between two updates."""
    batch_size: Annotated[int, Field(ge=2, le=1 << 20)] | None = None
    n_epochs: Annotated[int, Field(ge=1, le=1000)] | None = None
    gamma: Fraction | None = None
    gae_lambda: Fraction | None = None
    clip_range: Coefficient | None = None
    clip_range_vf: Coefficient | None = None
    normalize_advantage: bool | None = None
    ent_coef: Coefficient | None = None
    vf_coef: Coefficient | None = None
    max_grad_norm: Coefficient | None = None
    target_kl: Coefficient | None = None


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
    """A training run of PPO; a phase begins with new episodes and ends with validation and a checkpoint."""

    algorithm: Literal["ppo"] = "ppo"
    seeds: tuple[Annotated[int, Field(ge=0)], ...] = (0,)
    environment: Environments = Environments()
    network: Network = Network()
    averages: tuple[float, ...] = (5.0, 20.0)
    friction_estimate: bool = False
    least_air_supply_rate: Annotated[float, quantity(0.0, 0.2, "m3/s")] = 0.0
    """Least air of the agent; 0: that of the task."""
    learning: Learning = Learning()
    imitation: Imitation | None = None
    pretraining_steps: Annotated[int, Field(ge=0)] = 0
    """Environment steps in the surrogate before the first phase."""
    validation: Validation = Validation()
    phases: Annotated[int, Field(ge=0, le=100_000)] = 8
    phase_steps: Count = 16_384

    @model_validator(mode="after")
    def _fits(self) -> Self:
        """Build what the training uses, so that an error names the file before any work."""
        with _refused("environment.task"):
            task = self.task
        targets = [name for name in ("least_air_supply_rate", "imitation") if getattr(self, name)]
        problems = {
            "pretraining_steps and [imitation] exclude each other": self.pretraining_steps and self.imitation,
            "phases = 0 without [imitation] or pretraining_steps means no training": not (
                self.phases or self.warm_start
            ),
            f"seeds = {list(self.seeds)!r} must be one or more different numbers": not self.seeds
            or len(set(self.seeds)) < len(self.seeds),
            "validation.fidelity = 'surrogate': agents must be validated by simulation": is_surrogate(
                self.validation.fidelity
            ),
            f"{''.join(targets[:1])} needs actions that are targets for one control period: probe_env/Insertion-v1": (
                task.custom_actions and targets
            ),
        }
        with _refused():
            for text, found in problems.items():
                if found:
                    raise ValueError(text)
            trained = resolve_fidelity(self.environment.fidelity, task.scene, round_trip=task.returns)
            for fidelity in (trained, self.validation_fidelity):
                if fidelity.simulates:
                    check_fidelity(fidelity, task)
            self.view.columns(task)
            assert self.validated_in
        with _refused("imitation.teacher"):
            assert self.teacher or not self.imitation
        return self

    @cached_property
    def task(self) -> TaskConfig:
        """Task of the training."""
        defaults = ENVIRONMENTS[self.environment.env_id].single.defaults
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
        """Vibration map for the teacher and for fidelity "surrogate"; None: the shipped one."""
        file = self.environment.surrogate_map
        return None if file is None else load_for(Path(file), "the training file", self.task.scene)

    @property
    def warm_start(self) -> bool:
        """Whether phase 0 is an imitation or a training in the surrogate."""
        return self.imitation is not None or self.pretraining_steps > 0

    @cached_property
    def teacher(self) -> Policy | None:
        """Policy that is imitated; None: none. It may use more observations than the agent."""
        if self.imitation is None:
            return None
        return make_policy(self.imitation.teacher, self.task.full_observation, self.vibration)

    @cached_property
    def view(self) -> View:
        """Features and actions of the agent."""
        return View(
            observations=tuple(self.task.observations),
            averages=self.averages,
            friction_estimate=self.friction_estimate,
            least_air_supply_rate=self.least_air_supply_rate,
            logarithmic_feed=self.task.change_per_action == 0.0,
        )


@contextmanager
def _refused(field: str = "") -> Iterator[None]:
    """Raise errors as those of a model; pydantic would report fields of another model as fields of this one."""
    try:
        yield
    except (ValueError, FileNotFoundError) as error:
        raise ValueError(explain(error, field)) from error
