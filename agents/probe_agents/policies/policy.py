"""Protocol of policies, and the domain of a policy: the tubes that it was made for."""

from __future__ import annotations

import json
import math
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import AfterValidator, FiniteFloat, ValidationError

from probe_env import Context
from probe_env.arrays import BoolArray
from probe_env.envs.contexts import Ranges
from probe_env.envs.episodes.starts import Contexts, checked_contexts
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.trials import Controller
from probe_env.envs.vibration_map import CONTEXT, VibrationMap
from probe_env.files import MEBI, FileError, read_text
from probe_env.scene import Probe
from probe_env.settings import Model, explain, tuples

TOLERANCE = 0.01
"""Share of a range of tubes by which others may exceed it without a warning."""
UNITS = dict(zip(CONTEXT, ("", " N/m", "", " m"), strict=True))


class Policy(Controller, Protocol):
    """``predict`` of Stable-Baselines3: observations (N, n) to actions (N, 2), both scaled; and a description.

    Descriptions are equal for equal policies.
    """

    def describe(self) -> dict[str, Any]:
        """JSON-ready description."""


class ObservationPolicy(ABC):
    """Base class of policies that act on observations: SB3's ``predict`` from the method ``_act``."""

    def predict(
        self,
        observation: npt.NDArray[np.floating],
        state: Any = None,
        episode_start: npt.NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """Actions for observations (d,) or (N, d), and the state for the next call."""
        rows = np.atleast_2d(observation)
        start = np.full(len(rows), state is None)
        if episode_start is not None:
            start |= np.asarray(episode_start, dtype=bool)
        actions, state = self._act(rows, state, start, deterministic)
        return (actions[0] if np.ndim(observation) == 1 else actions), state

    @abstractmethod
    def _act(
        self, rows: npt.NDArray[np.floating], state: Any, start: BoolArray, deterministic: bool
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """(N, 2) actions for observations (N, d) and the next state; ``start`` (N,): whether an episode begins."""

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """JSON-ready description, equal for equal policies."""


def _checked(ranges: dict[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    for name, (low, high) in ranges.items():
        if name not in CONTEXT:
            text = f"{name!r} is none of {', '.join(CONTEXT)}"
        elif low > high:
            text = f"{name}: low = {low:g} is above high = {high:g}"
        else:
            continue
        raise ValueError(text)
    return ranges


RangesOfTubes = Annotated[dict[str, tuple[FiniteFloat, FiniteFloat]], AfterValidator(_checked)]
"""Ranges of fields of ``Context`` in a file."""


M = TypeVar("M", bound=Model)
MAX_JSON: Final = 8 * MEBI


def read_model(path: str | Path, model: type[M], what: str, key: str | None = None) -> M:
    """Read a JSON file, or the value of one key in it, as a model; ``what`` names the content in errors."""
    try:
        content = tuples(json.loads(read_text(Path(path), MAX_JSON)))
        return model.model_validate(content if key is None else content[key])
    except ValidationError as error:
        raise FileError(path, explain(error)) from error
    except (json.JSONDecodeError, RecursionError, KeyError, TypeError) as error:
        raise FileError(path, f"not {what}: {error}") from error


class OutsideDomain(UserWarning):
    """Warns when a policy runs outside its domain."""


@dataclass(frozen=True)
class Domain:
    """The tubes that a policy was made for.

    Attributes:
        ranges: smallest and largest value of each field of ``Context``.
        inner_diameter: bore of the tubes [m].
        helix_length: largest helix length [m].
        probe: probe; None: any probe.
    """

    ranges: dict[str, tuple[float, float]]
    inner_diameter: float
    helix_length: float
    probe: Probe | None

    @classmethod
    def of_map(cls, vibration: VibrationMap, any_probe: bool = False) -> Domain:
        """The domain of a vibration map."""
        low, high = vibration.ranges.tolist()
        ranges = {name: (low[k], high[k]) for k, name in enumerate(CONTEXT)}
        tube = vibration.scene.tube
        return cls(ranges, tube.inner_diameter, tube.helix_length, None if any_probe else vibration.scene.probe)

    def outside(self, config: TaskConfig, contexts: Iterable[Context]) -> list[str]:
        """Texts with field, value and range of everything in a task and its tubes that is outside the domain."""
        scene, deviations = config.scene, []
        if not math.isclose(scene.tube.inner_diameter, self.inner_diameter, rel_tol=1e-3):
            deviations.append(f"inner_diameter {scene.tube.inner_diameter:g} m ({self.inner_diameter:g} m)")
        if scene.tube.helix_length > self.helix_length * (1.0 + 1e-9):
            deviations.append(f"helix_length {scene.tube.helix_length:g} m (up to {self.helix_length:g} m)")
        if self.probe is not None and scene.probe != self.probe:
            names = (name for name in Probe.model_fields if getattr(scene.probe, name) != getattr(self.probe, name))
            deviations.append(f"probe: different {', '.join(names)}")
        tubes = list(contexts)
        for name, (low, high) in self.ranges.items():
            values, unit = [getattr(tube, name) for tube in tubes], UNITS[name]
            minimum, maximum = min(values), max(values)
            slack = max(TOLERANCE * (high - low), 1e-3 * high)
            if minimum < low - slack or maximum > high + slack:
                values_text = f"{minimum:g}" if minimum == maximum else f"{minimum:g} to {maximum:g}"
                deviations.append(f"{name} {values_text}{unit} ({low:g} to {high:g}{unit})")
        return deviations


def ranges_of(contexts: Contexts) -> dict[str, tuple[float, float]]:
    """Smallest and largest value of each field over tubes, or over ranges of tubes."""
    tubes = checked_contexts(contexts)
    parts = [tubes] if isinstance(tubes, Ranges) else tubes
    values = {name: np.hstack([getattr(part, name) for part in parts]) for name in CONTEXT}
    return {name: (float(column.min()), float(column.max())) for name, column in values.items()}


def check_domains(
    domains: dict[str, Domain | None], config: TaskConfig, contexts: Sequence[Context], strict: bool
) -> None:
    """Warn about every policy that runs outside its domain.

    Raises:
        ValueError: ``strict`` is set and a policy is outside its domain.
    """
    for name, domain in domains.items():
        deviations = domain.outside(config, contexts) if domain else []
        if deviations:
            text = f"{name} runs outside its range: {'; '.join(deviations)}"
            if strict:
                raise ValueError(f"{text}. Leave out --strict to run it")
            warnings.warn(text, OutsideDomain, stacklevel=2)
