"""Policies on the vibration map: told the tube, guessing it from tension, or shifting the map to what is felt."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from agents.policies.fixed import FixedPolicy
from agents.policies.vibration_map import CONTEXT, FEEDS, STORED, expected_cost, features_of, stored_map
from probe_env import Context, Scene
from probe_env.arrays import FloatArray
from probe_env.envs.contexts import HELIX_DIAMETERS
from probe_env.envs.observations import RF_FLOOR
from probe_env.envs.task import TaskConfig
from probe_env.physics.chain import air_speed
from probe_env.physics.closed_forms import MEASURED, friction_from_tension
from probe_env.schedule import Schedule

KNOTS: Final = np.arange(5.0, 61.0, 2.5)  # [m]
FEED_GRID: Final = np.geomspace(*FEEDS, 32)
LEAST_AIR: Final = 45.0 / 3600.0
"""[m3/s]; below it the root tension of a training tube came near the 0.8 N that the rising straight part needs."""
FRICTIONS: Final = (0.08, 0.27)
FRICTION_STEP: Final = 0.005
SHIFTS: Final = (-1.5, 1.0)
SHIFT_STEP: Final = 0.1
AREA: Final = 1.0 / air_speed(Scene(), 1.0)
"""[m2] between cable and tube."""


def grid(config: TaskConfig) -> tuple[FloatArray, FloatArray]:
    """(g,) feed speeds [m/s] and air supplies [m3/s] that a best schedule is picked from."""
    air = np.linspace(LEAST_AIR, config.air_supply_rates[1], 12)
    feed, blown = np.meshgrid(FEED_GRID, air, indexing="ij")
    return feed.ravel(), blown.ravel()


def expected_costs(contexts: FloatArray, config: TaskConfig, shift: float = 0.0) -> FloatArray:
    """(contexts, knots, g) expected cost of a metre at every knot, for every feed and air of the grid.

    ``shift`` [decades] is by how much more the probe vibrates than the map says.
    """
    feed, air = (np.tile(column, len(KNOTS)) for column in grid(config))
    costs = []
    for context in contexts:
        mean, deviation = _grid_vibration(tuple(map(float, context)), config)
        costs.append(expected_cost(mean + shift, deviation, feed, air, config).reshape(len(KNOTS), -1))
    return np.array(costs)


@lru_cache(maxsize=256)
def _grid_vibration(context: tuple[float, ...], config: TaskConfig) -> tuple[FloatArray, FloatArray]:
    """Mean and deviation (knots * g,) of the decadic logarithm of the vibration in one tube."""
    feed, air = grid(config)
    lengths, count = np.repeat(KNOTS, len(feed)), len(KNOTS)
    tube = np.tile(context, (len(lengths), 1))
    return stored_map().distribution(features_of(lengths, np.tile(feed, count), np.tile(air, count), tube))


@lru_cache(maxsize=4096)
def best_schedule_for(context: Context, config: TaskConfig, shift: float = 0.0) -> Schedule:
    """Schedule over inserted length with the least expected cost on one tube: the best of the grid at every knot.

    ``shift`` [decades] is by how much more the probe vibrates than the map says.
    """
    values = np.array([[getattr(context, name) for name in CONTEXT]])
    best = expected_costs(values, config, shift)[0].argmin(axis=1)
    feed, air = (column[best] for column in grid(config))
    return Schedule("inserted_length", "linear", tuple(KNOTS), tuple(map(float, feed)), tuple(map(float, air)))


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


class MapPolicy(FixedPolicy):
    """Base: what it does depends on the stored map as well."""

    def describe(self) -> dict[str, Any]:
        """With a hash of the map."""
        return super().describe() | {"map": _map_hash(), "least_air": LEAST_AIR}


@lru_cache
def _map_hash() -> str:
    return hashlib.sha256(STORED.read_bytes()).hexdigest()[:16]


@dataclass
class Privileged(MapPolicy):
    """The best schedule for the true tube, which no rig knows: what a controller can reach at best."""

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
        return _looked_up(contexts, seen["inserted_length"], _weighted(self.config, self.vibration_weight))


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
        """Stiffness and drag are taken as table 2's.

        Raises:
            ValueError: the task does not show the root tension.
        """
        self.check(seen)
        known = {name: seen[name] for name in MEASURED}  # the probe is taken as table 2's
        tubes = self.tubes(friction_from_tension(known), seen["helix_diameter"], memory)
        return _looked_up(tubes, seen["inserted_length"], _weighted(self.config, self.vibration_weight))

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
    """As ``TensionScheduled``, with the map shifted to what is measured: for probes that the map does not know.

    How much louder or quieter than the map this probe is in this tube, in decades, is averaged over the run. Where the
    task shows the probe, the friction estimate knows its floats.
    """

    shift_average: float = 15.0
    """Time constant of the average of the shift [s]."""
    smoothing: float = 6.0
    """Time constant of feed and air [s]: a leap between two schedules could buckle a weak cable."""
    least_tension: float = 2.0
    """Air is blown so that steady sliding keeps this root tension [N], with floats of any size."""
    memory: ClassVar[int] = 4

    def targets(self, seen: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Looked up in the shifted map. Memory: the friction estimate, the shift [decades], feed and air.

        Raises:
            ValueError: the task does not show the root tension.
        """
        self.check(seen)
        tubes = self.tubes(friction_from_tension(seen), seen["helix_diameter"], memory)
        gain = 1.0 - np.exp(-self.config.period / self.shift_average)
        memory[:, 1] += gain * (np.clip(self._louder(seen, tubes), *SHIFTS) - memory[:, 1])
        rounded = np.round(memory[:, 1] / SHIFT_STEP) * SHIFT_STEP
        shifts = [round(float(decades), 4) for decades in rounded]
        config = _weighted(self.config, self.vibration_weight)
        feed, air = _looked_up(tubes, seen["inserted_length"], config, shifts)
        wanted = np.column_stack([feed, np.clip(self._taut(seen), air, self.config.air_supply_rates[1])])
        applied = np.column_stack([seen["feed_speed"], seen["air_supply_rate"]])
        acted = np.where(memory[:, 2:] > 0.0, memory[:, 2:], applied)
        memory[:, 2:] = acted + (1.0 - np.exp(-self.config.period / self.smoothing)) * (wanted - acted)
        return memory[:, 2], memory[:, 3]

    def _louder(self, seen: dict[str, FloatArray], tubes: list[Context]) -> FloatArray:
        """Measured vibration (N,) over the map's, in decades."""
        values = np.array([[getattr(tube, name) for name in CONTEXT] for tube in tubes])
        features = features_of(seen["inserted_length"], seen["feed_speed"], seen["air_supply_rate"], values)
        expected = 10.0 ** stored_map().distribution(features)[0] * 1e-4
        return np.asarray(np.log10(seen["rf_noise"] / np.hypot(expected, RF_FLOOR)))

    def _taut(self, seen: dict[str, FloatArray]) -> FloatArray:
        """Air supply (N,) [m3/s] for the least tension, which goes with the square of the wind."""
        no_wind = seen["feed_speed"] * AREA
        tension = np.maximum(seen["root_tension"], 0.1 * self.least_tension)
        return np.asarray(no_wind + (seen["air_supply_rate"] - no_wind) * np.sqrt(self.least_tension / tension))


@lru_cache
def _weighted(config: TaskConfig, vibration_weight: float | None) -> TaskConfig:
    return config if vibration_weight is None else config.model_copy(update={"vibration_weight": vibration_weight})


def _looked_up(
    tubes: list[Context], length: FloatArray, config: TaskConfig, shifts: Sequence[float] | None = None
) -> tuple[FloatArray, FloatArray]:
    louder = shifts or [0.0] * len(tubes)
    known = zip(tubes, louder, length, strict=True)
    pairs = [best_schedule_for(tube, config, decades).at(place) for tube, decades, place in known]
    return np.array([float(feed) for feed, _ in pairs]), np.array([float(air) for _, air in pairs])


@lru_cache(maxsize=4096)
def _context(friction: float, stiffness: float, drag: float, diameter: float) -> Context:
    """A tube from float32 observations, rounded so that it is the same in every step."""
    return Context(
        friction=round(friction, 5),
        contact_stiffness=round(stiffness, -1),
        drag_factor=round(drag, 4),
        helix_diameter=round(diameter, 4),
    )


MAP_POLICIES: Final[dict[str, tuple[type[FixedPolicy], dict[str, Any]]]] = {
    "tension-scheduled": (TensionScheduled, {}),
    "adaptive": (Adaptive, {}),
    "privileged": (Privileged, {}),
}
