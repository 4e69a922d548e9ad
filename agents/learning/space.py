"""What a search for hyperparameters tries: the choices and ranges of a training file, or its algorithm's usual ones."""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, Self

from pydantic import ValidationError, model_validator
from pydantic_core import PydanticCustomError

from agents.policies.bundle import ALGORITHMS
from probe_env.settings import Model, explain

if TYPE_CHECKING:
    from agents.learning.config import Training

TABLES: Final = ("learning", "network", "imitation")
"""Tables of a training file whose fields can be searched."""
ROLLOUT: Final = "learning.n_steps"
"""Steps of each environment between two updates; SAC has something else of this name."""
ROLLOUTS: Final = (32, 64, 128, 256, 512)


class Range(Model):
    """Numbers between two, both included: whole ones where both are. ``log``: every factor is as likely as another."""

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
"""What a field may be: a range, or one of some choices."""
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
"""What is searched of an algorithm where the file does not say, with those ``ROLLOUTS`` that fill phases."""


def axes_of(training: Training) -> dict[str, Axis]:
    """What is searched: field, such as "learning.gamma" -> its choices or range.

    Raises:
        PydanticCustomError: ``search`` names what is not there, or values that a training does not accept.
    """
    if training.search is None:
        on_policy = training.algorithm != "sac"
        rollouts = tuple(steps for steps in ROLLOUTS if on_policy and _whole_phases(training, steps))
        return USUAL[training.algorithm] | ({ROLLOUT: rollouts} if len(rollouts) > 1 else {})
    tables = [name for name in TABLES if getattr(training, name) is not None]
    axes: dict[str, Axis] = {}
    for table, fields in training.search.items():
        if table not in tables:
            raise _wrong(table, f"is nothing of this file that can be searched; accepted: {', '.join(tables)}")
        axes |= {f"{table}.{field}": _axis(f"{table}.{field}", given) for field, given in fields.items()}
    if not axes:
        raise PydanticCustomError("search", "search: names nothing to search")
    plain = training.model_copy(update={"search": None})
    for name, axis in axes.items():
        _check_values(plain, name, axis)
    return axes


def with_values(training: Training, point: Mapping[str, Any]) -> Training:
    """The training with these values of fields, such as "learning.gamma".

    Raises:
        ValidationError: it does not accept them.
    """
    update: dict[str, dict[str, Any]] = {"learning": dict(training.learning)}
    for name, value in point.items():
        table, _, field = name.partition(".")
        update.setdefault(table, {})[field] = value
    return training.model_copy(update=update)


def value_in(training: Training, name: str) -> Any:
    """The value that a field has in a training: the algorithm's own where the file does not say."""
    table, _, field = name.partition(".")
    if table != "learning":
        return getattr(getattr(training, table), field)
    arguments = inspect.signature(ALGORITHMS[training.algorithm][0].__init__).parameters
    return training.learning.get(field, arguments[field].default)


def _axis(name: str, given: Any) -> Axis:
    if isinstance(given, dict):
        try:
            return Range.model_validate(given)
        except ValidationError as error:
            raise _wrong(name, explain(error)) from error
    if not isinstance(given, tuple) or len(given) < 2 or any(given.count(value) > 1 for value in given):
        raise _wrong(name, f"{given!r} is neither two or more choices, none twice, nor a range {{ low, high }}")
    return given


def _check_values(training: Training, name: str, axis: Axis) -> None:
    """Raise unless the training accepts every choice or both ends, and so what is between them."""
    table, _, field = name.partition(".")
    sizes = training.network.arguments(training.algorithm)
    if table == "network" and field not in sizes:
        raise _wrong(name, f"is not one of {training.algorithm}'s: {', '.join(sizes)}")
    for value in (axis.low, axis.high) if isinstance(axis, Range) else axis:
        try:
            with_values(training, {name: value})
        except ValidationError as error:
            raise _wrong(name, explain(error)) from error
    if name != ROLLOUT or training.algorithm == "sac":
        return
    if isinstance(axis, Range):
        raise _wrong(name, "must be a list of choices, as rollouts have to fill phases")
    for steps in axis:
        if not _whole_phases(training, steps):
            filled = f"{training.phase_steps} steps of a phase in {training.environment.num_envs} environments"
            raise _wrong(name, f"{steps}: the {filled} are no whole number of such rollouts")


def _whole_phases(training: Training, steps: int) -> bool:
    """Whether rollouts of so many steps fill the phases: only then all trainings of a search have equally many."""
    return training.phase_steps % (steps * training.environment.num_envs) == 0


def _wrong(name: str, problem: str) -> PydanticCustomError:
    return PydanticCustomError("search", "{text}", {"text": f"search.{name}: {problem}"})
