"""Policies on the vibration map: with the true tube, with friction from the tension, or with a shifted map."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from agents.policies.fixed import FixedPolicy
from agents.policies.lookup import LEAST_AIR, looked_up
from agents.policies.policy import Domain
from probe_env import Context
from probe_env.arrays import FloatArray
from probe_env.envs.contexts import HELIX_DIAMETERS
from probe_env.envs.task import TaskConfig
from probe_env.envs.task.scales import RF_FLOOR
from probe_env.envs.vibration_map import CONTEXT, VibrationMap, stored_map
from probe_env.physics.closed_forms import MEASURED, friction_from_tension
from probe_env.physics.model.chain import air_speed
from probe_env.schedule import Schedule

FRICTIONS: Final = (0.08, 0.27)
FRICTION_STEP: Final = 0.005
SHIFTS: Final = (-1.5, 1.0)
SHIFT_STEP: Final = 0.1


@dataclass
class ByDiameter(FixedPolicy):
    """One schedule for each helix diameter [m]; the nearest one is taken."""

    schedules: dict[float, Schedule] = field(default_factory=dict)

    def targets(self, seen: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What the schedule of the diameter says for the inserted length."""
        known = np.array(list(self.schedules))
        nearest = [known[np.abs(known - d).argmin()] for d in seen["helix_diameter"]]
        pairs = [self.schedules[d].at(place) for d, place in zip(nearest, seen["inserted_length"], strict=True)]
        return np.array([float(feed) for feed, _ in pairs]), np.array([float(air) for _, air in pairs])

    @classmethod
    def read(cls, config: TaskConfig, folder: Path) -> ByDiameter:
        """Read ``best-schedule-dDIAMETER.csv`` of all of ``HELIX_DIAMETERS``."""
        return cls(config, {d: Schedule.read(folder / f"best-schedule-d{d:g}.csv") for d in HELIX_DIAMETERS})


@dataclass
class MapPolicy(FixedPolicy):
    """Base: what it does depends on the stored map as well."""

    vibration: VibrationMap = field(default_factory=stored_map)
    """The map that it looks things up in; default: the shipped one."""

    @property
    def domain(self) -> Domain:
        """Tubes of the map."""
        return Domain.of_map(self.vibration)

    def describe(self) -> dict[str, Any]:
        """With a hash of the map."""
        own = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("config", "vibration")}
        return {"policy": type(self).__name__, **own, "map": self.vibration.digest, "least_air": LEAST_AIR}


@dataclass
class Privileged(MapPolicy):
    """Oracle: the best schedule for the true tube, which a rig cannot measure; feedback can earn more."""

    vibration_weight: float | None = None
    """Weight that the schedule is best for; default: the task's."""

    def targets(self, seen: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Looked up in the map.

        Raises:
            ValueError: the task does not show friction, contact stiffness and drag.
        """
        if "friction" not in seen:
            raise ValueError("the privileged policy needs a task with privileged = true")
        tubes = np.column_stack([seen[name] for name in CONTEXT]).astype(np.float32)
        contexts = [_context(*map(float, tube)) for tube in tubes]
        config = _weighted(self.config, self.vibration_weight)
        return looked_up(contexts, seen["inserted_length"], config, self.vibration)


@dataclass
class TensionScheduled(MapPolicy):
    """Friction estimated from the root tension of steady sliding, then the best schedule for a tube with it."""

    average: float = 15.0
    """Time constant of the estimate's average [s]."""
    prior: float = 0.175
    vibration_weight: float | None = None
    """Weight that the schedule is best for; default: the task's."""
    memory: ClassVar[int] = 1

    def start(self, memory: FloatArray) -> None:
        """Memory: the estimate."""
        memory[:, 0] = self.prior

    def targets(self, seen: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Stiffness and drag are taken as the scene's.

        Raises:
            ValueError: the task does not show the root tension.
        """
        self.check(seen)
        known = {name: seen[name] for name in MEASURED}  # the probe is taken as the scene's
        tubes = self.tubes(friction_from_tension(known, self.config.scene), seen["helix_diameter"], memory)
        config = _weighted(self.config, self.vibration_weight)
        return looked_up(tubes, seen["inserted_length"], config, self.vibration)

    def check(self, seen: dict[str, FloatArray]) -> None:
        """Whether the task shows what it looks at."""
        if "root_tension" not in seen:
            raise ValueError("the tension-scheduled and adaptive policies need a task that shows the root tension")

    def tubes(self, friction: FloatArray, helix_diameter: FloatArray, memory: FloatArray) -> list[Context]:
        """Tubes (N,) of the averaged friction, which ``memory`` keeps; rounded so that few schedules are searched."""
        gain = 1.0 - np.exp(-self.config.period / self.average)
        memory[:, 0] += gain * (np.clip(friction, *FRICTIONS) - memory[:, 0])
        rounded = np.round(memory[:, 0] / FRICTION_STEP) * FRICTION_STEP
        pairs = zip(rounded, helix_diameter, strict=True)
        return [Context(friction=round(float(mu), 4), helix_diameter=round(float(d), 3)) for mu, d in pairs]


@dataclass
class Adaptive(TensionScheduled):
    """``TensionScheduled`` with the map shifted by the measured vibration, for probes that the map does not know.

    The shift in decades is averaged over the run. Where the task shows the probe, its floats enter the friction.
    """

    shift_average: float = 15.0
    """Time constant of the average of the shift [s]."""
    smoothing: float = 6.0
    """Time constant of feed and air [s]: a leap between two schedules could buckle a weak cable."""
    least_tension: float = 2.0
    """Air is blown so that steady sliding keeps this root tension [N], with floats of any size."""
    memory: ClassVar[int] = 4

    @property
    def domain(self) -> Domain:
        """Tubes of the map, with any probe."""
        return Domain.of_map(self.vibration, any_probe=True)

    def targets(self, seen: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Looked up in the shifted map. Memory: the friction estimate, the shift [decades], feed and air.

        Raises:
            ValueError: the task does not show the root tension.
        """
        self.check(seen)
        tubes = self.tubes(friction_from_tension(seen, self.config.scene), seen["helix_diameter"], memory)
        gain = 1.0 - np.exp(-self.config.period / self.shift_average)
        memory[:, 1] += gain * (np.clip(self._louder(seen, tubes), *SHIFTS) - memory[:, 1])
        rounded = np.round(memory[:, 1] / SHIFT_STEP) * SHIFT_STEP
        shifts = [round(float(decades), 4) for decades in rounded]
        config = _weighted(self.config, self.vibration_weight)
        feed, air = looked_up(tubes, seen["inserted_length"], config, self.vibration, shifts)
        wanted = np.column_stack([feed, np.clip(self._taut(seen), air, self.config.air_supply_rates[1])])
        applied = np.column_stack([seen["feed_speed"], seen["air_supply_rate"]])
        acted = np.where(memory[:, 2:] > 0.0, memory[:, 2:], applied)
        memory[:, 2:] = acted + (1.0 - np.exp(-self.config.period / self.smoothing)) * (wanted - acted)
        return memory[:, 2], memory[:, 3]

    def _louder(self, seen: dict[str, FloatArray], tubes: list[Context]) -> FloatArray:
        """Measured vibration (N,) over the map's, in decades."""
        values = np.array([[getattr(tube, name) for name in CONTEXT] for tube in tubes])
        length, feed, air = (seen[name] for name in ("inserted_length", "feed_speed", "air_supply_rate"))
        expected = 10.0 ** self.vibration.predict(length, feed, air, values, self.config.scene)[0] * 1e-4
        return np.asarray(np.log10(seen["rf_noise"] / np.hypot(expected, RF_FLOOR)))

    def _taut(self, seen: dict[str, FloatArray]) -> FloatArray:
        """Air supply (N,) [m3/s] for the least tension, which goes with the square of the wind."""
        no_wind = seen["feed_speed"] / air_speed(self.config.scene, 1.0)
        tension = np.maximum(seen["root_tension"], 0.1 * self.least_tension)
        return np.asarray(no_wind + (seen["air_supply_rate"] - no_wind) * np.sqrt(self.least_tension / tension))


@lru_cache
def _weighted(config: TaskConfig, vibration_weight: float | None) -> TaskConfig:
    return config if vibration_weight is None else config.model_copy(update={"vibration_weight": vibration_weight})


@lru_cache(maxsize=4096)
def _context(friction: float, stiffness: float, drag: float, diameter: float) -> Context:
    return Context(  # rounded so that it is the same in every step
        friction=round(friction, 5),
        contact_stiffness=round(stiffness, -1),
        drag_factor=round(drag, 4),
        helix_diameter=round(diameter, 4),
    )


MAP_POLICIES: Final[dict[str, tuple[type[MapPolicy], dict[str, Any]]]] = {
    "tension-scheduled": (TensionScheduled, {}),
    "adaptive": (Adaptive, {}),
    "privileged": (Privileged, {}),
}
