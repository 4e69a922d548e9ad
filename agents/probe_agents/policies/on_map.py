"""Policies on the vibration map: the best schedule for a tube, from a grid of feed and air at every few metres.

The tube is the true one, or has the friction estimated from the root tension; ``Adaptive`` also shifts the map.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from probe_agents.policies.fixed import FixedPolicy, gain
from probe_agents.policies.policy import Domain
from probe_env import Context
from probe_env.arrays import FloatArray
from probe_env.envs.contexts import DRAG_FACTOR, FRICTION, HELIX_DIAMETERS
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.scales import RF_FLOOR
from probe_env.envs.vibration_map import CONTEXT, VibrationMap, check_measure, expected_cost, feeds, stored_map
from probe_env.physics.closed_forms import MEASURED, entrance_tension, friction_from_tension, sliding_tension
from probe_env.physics.model.chain import air_speed
from probe_env.schedule import Schedule

SPACING: Final = 2.5  # [m] between knots
FIRST: Final = 5.0  # [m], the length at which an insertion begins
MARGIN: Final = 1.5
"""Least ratio of the root tension of steady sliding to the task's required tension.

Simulated tensions are 3 to 10 % lower, and friction is known by an estimate.
"""
WORST_MARGIN: Final = 1.1
"""The same for the air that is enough in all tubes: few are near ``WORST``."""
SLACK_COST: Final = 1e3
"""Cost of a metre with less, far above all other costs."""
WORST: Final = Context(friction=FRICTION[1], drag_factor=DRAG_FACTOR[0], helix_diameter=HELIX_DIAMETERS[0])
"""The training tube with the least root tension."""
FRICTIONS: Final = (0.08, 0.27)
FRICTION_STEP: Final = 0.005
SHIFTS: Final = (-1.5, 1.0)
SHIFT_STEP: Final = 0.1


def knots(config: TaskConfig) -> FloatArray:
    """(k,) inserted lengths [m] of the points of a schedule."""
    return np.arange(FIRST, config.scene.tube.helix_length + 1.0, SPACING)


def root_tensions(
    tubes: Sequence[Context], config: TaskConfig, length: FloatArray, feed: FloatArray, air: FloatArray
) -> FloatArray:
    """(tubes, n) root tension of steady sliding [N] at inserted lengths [m], feeds [m/s] and air supplies [m3/s]."""
    tensions = []
    for tube in tubes:
        diameter, friction = np.full(len(length), tube.helix_diameter), np.array(max(tube.friction, 1e-6))
        measured = dict(zip(MEASURED[1:], (length, feed, air, diameter), strict=True))
        sliding = sliding_tension(friction, measured, config.scene, tube.drag_factor)
        tensions.append(sliding - entrance_tension(config.scene, diameter))
    return np.array(tensions)


def lacking_tension(
    tube: Context, config: TaskConfig, length: FloatArray, feed: FloatArray, air: FloatArray, margin: float
) -> FloatArray:
    """(n,) root tension [N] that is lacking to ``margin`` times the required one.

    Nearer the entrance than lost drive is scored, the air must be enough where scoring begins.
    """
    scored = np.maximum(length, config.lost_drive_from)
    return np.asarray(margin * config.required_tension - root_tensions([tube], config, scored, feed, air)[0])


@lru_cache(maxsize=4096)
def min_air(config: TaskConfig, tube: Context = WORST, margin: float = WORST_MARGIN) -> float:
    """Smallest air supply [m3/s] that pulls enough in a tube at every length and the fastest feed; default: in all."""
    length = knots(config)
    air = np.linspace(*config.air_supply_rates, 201)
    pairs = np.tile(length, len(air)), np.full(len(air) * len(length), config.permitted_feed), air.repeat(len(length))
    enough = (lacking_tension(tube, config, *pairs, margin).reshape(len(air), -1) <= 0.0).all(axis=1)
    return float(air[enough.argmax()] if enough.any() else air[-1])


@lru_cache(maxsize=64)
def grid(config: TaskConfig) -> tuple[FloatArray, FloatArray]:
    """(g,) feed speeds [m/s] and air supplies [m3/s] of the search grid."""
    air = np.linspace(*config.air_supply_rates, 16)
    feed, blown = np.meshgrid(np.geomspace(*feeds(config), 32), air, indexing="ij")
    return feed.ravel(), blown.ravel()


def expected_costs(
    contexts: FloatArray, config: TaskConfig, shift: float = 0.0, vibration: VibrationMap | None = None
) -> FloatArray:
    """(contexts, knots, g) expected cost per metre at every knot, for every feed and air of the grid.

    Settings with too little root tension cost ``SLACK_COST`` and more, the less tension the more. ``shift`` [decades]
    is added to the logarithm of the vibration of the map; default: the shipped map.
    """
    vibration = vibration or stored_map()
    check_measure(vibration, config)
    count = len(knots(config))
    feed, air = (np.tile(column, count) for column in grid(config))
    costs = []
    for context in contexts:
        mean, deviation, slack = _on_grid(tuple(map(float, context)), config, vibration)
        cost = expected_cost(mean + shift, deviation, feed, air, config)
        costs.append(np.where(slack > 0.0, SLACK_COST * (1.0 + slack), cost).reshape(count, -1))
    return np.array(costs)


@lru_cache(maxsize=256)
def _on_grid(
    context: tuple[float, ...], config: TaskConfig, vibration: VibrationMap
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean and deviation of log10 of the vibration, and the lacking tension [N], (knots * g,) each, in one tube."""
    feed, air = grid(config)
    lengths, count = np.repeat(knots(config), len(feed)), len(knots(config))
    setting = lengths, np.tile(feed, count), np.tile(air, count)
    mean, deviation = vibration.predict(*setting, np.tile(context, (len(lengths), 1)), config.scene)
    return mean, deviation, lacking_tension(_context(*context), config, *setting, MARGIN)


@lru_cache(maxsize=4096)
def best_schedule_for(
    context: Context, config: TaskConfig, shift: float = 0.0, vibration: VibrationMap | None = None
) -> Schedule:
    """Schedule over inserted length with the least expected cost in one tube: the best grid point at every knot.

    ``shift`` [decades] is added to the logarithm of the vibration of the map; default: the shipped map.
    """
    values = np.array([[getattr(context, name) for name in CONTEXT]])
    best = expected_costs(values, config, shift, vibration)[0].argmin(axis=1)
    feed, air = (column[best] for column in grid(config))
    length = tuple(map(float, knots(config)))
    return Schedule("inserted_length", "linear", length, tuple(map(float, feed)), tuple(map(float, air)))


def targets_on_map(
    tubes: Sequence[Context],
    length: FloatArray,
    config: TaskConfig,
    vibration: VibrationMap,
    shifts: Sequence[float] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Feed speed [m/s] and air supply [m3/s], (N,) each, of the best schedules for tubes at inserted lengths [m]."""
    rows = zip(tubes, shifts or [0.0] * len(tubes), length, strict=True)
    pairs = [best_schedule_for(tube, config, shift, vibration).at(at) for tube, shift, at in rows]
    return np.array([float(feed) for feed, _ in pairs]), np.array([float(air) for _, air in pairs])


@dataclass
class ByDiameter(FixedPolicy):
    """One schedule for each helix diameter [m]; uses that of the nearest diameter."""

    schedules: dict[float, Schedule] = field(default_factory=dict)

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Feed and air of the schedule of the nearest diameter."""
        diameters = np.array(list(self.schedules))
        nearest = [diameters[np.abs(diameters - d).argmin()] for d in measured["helix_diameter"]]
        pairs = [
            self.schedules[d].at(inserted) for d, inserted in zip(nearest, measured["inserted_length"], strict=True)
        ]
        return np.array([float(feed) for feed, _ in pairs]), np.array([float(air) for _, air in pairs])

    @classmethod
    def read(cls, config: TaskConfig, folder: Path) -> ByDiameter:
        """Read ``best-schedule-dDIAMETER.csv`` of all of ``HELIX_DIAMETERS``."""
        return cls(config, {d: Schedule.read(folder / f"best-schedule-d{d:g}.csv") for d in HELIX_DIAMETERS})


@dataclass
class MapPolicy(FixedPolicy):
    """Base class of policies on a vibration map."""

    vibration: VibrationMap = field(default_factory=stored_map)
    """Vibration map; default: the shipped one."""

    @property
    def domain(self) -> Domain:
        """Tubes of the map."""
        return Domain.of_map(self.vibration)

    def describe(self) -> dict[str, Any]:
        """With a hash of the map."""
        settings = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("config", "vibration")}
        return {"policy": type(self).__name__, **settings, "map": self.vibration.digest, "margin": MARGIN}


@dataclass
class Privileged(MapPolicy):
    """Oracle: the best schedule for the true tube, which a rig cannot measure; feedback can earn more."""

    vibration_weight: float | None = None
    """Vibration weight of the schedule's objective; default: the task's."""
    needs: ClassVar[tuple[str, ...]] = ("friction",)

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Feed and air of the best schedule for the true tube."""
        tubes = np.column_stack([measured[name] for name in CONTEXT]).astype(np.float32)
        contexts = [_context(*map(float, tube)) for tube in tubes]
        config = _weighted(self.config, self.vibration_weight)
        return targets_on_map(contexts, measured["inserted_length"], config, self.vibration)


@dataclass
class TensionScheduled(MapPolicy):
    """Estimates friction from the root tension (steady sliding) and follows the best schedule for it."""

    average: float = 15.0
    """Time constant of the estimate's average [s]."""
    prior: float = 0.175
    vibration_weight: float | None = None
    """Vibration weight of the schedule's objective; default: the task's."""
    memory: ClassVar[int] = 1
    needs: ClassVar[tuple[str, ...]] = ("root_tension",)

    def start(self, memory: FloatArray) -> None:
        """Memory: the estimate."""
        memory[:, 0] = self.prior

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Feed and air of the best schedule; stiffness, drag and probe are those of the scene."""
        without_probe = {name: measured[name] for name in MEASURED}
        tubes = self.tubes(friction_from_tension(without_probe, self.config.scene), measured["helix_diameter"], memory)
        config = _weighted(self.config, self.vibration_weight)
        return targets_on_map(tubes, measured["inserted_length"], config, self.vibration)

    def tubes(self, friction: FloatArray, helix_diameter: FloatArray, memory: FloatArray) -> list[Context]:
        """Tubes (N,) with the averaged friction in ``memory``, rounded so that few schedules are searched."""
        memory[:, 0] += gain(self.config, self.average) * (np.clip(friction, *FRICTIONS) - memory[:, 0])
        rounded = np.round(memory[:, 0] / FRICTION_STEP) * FRICTION_STEP
        pairs = zip(rounded, helix_diameter, strict=True)
        return [Context(friction=round(float(mu), 4), helix_diameter=round(float(d), 3)) for mu, d in pairs]


@dataclass
class Adaptive(TensionScheduled):
    """``TensionScheduled`` with the map shifted by the measured vibration, for probes other than the map's.

    The shift in decades is averaged over the run. If the task observes the probe, its floats enter the friction.
    """

    shift_average: float = 15.0
    """Time constant of the average of the shift [s]."""
    smoothing: float = 6.0
    """Time constant of feed and air [s]: a jump between two schedules could buckle a weak cable."""
    least_tension: float = 2.0
    """Root tension of steady sliding that the air maintains, for floats of any size [N]."""
    memory: ClassVar[int] = 4

    @property
    def domain(self) -> Domain:
        """Tubes of the map, with any probe."""
        return Domain.of_map(self.vibration, any_probe=True)

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Feed and air from the shifted map. Memory: friction estimate, shift [decades], feed, air."""
        tubes = self.tubes(friction_from_tension(measured, self.config.scene), measured["helix_diameter"], memory)
        memory[:, 1] += gain(self.config, self.shift_average) * (
            np.clip(self._shift(measured, tubes), *SHIFTS) - memory[:, 1]
        )
        rounded = np.round(memory[:, 1] / SHIFT_STEP) * SHIFT_STEP
        shifts = [round(float(decades), 4) for decades in rounded]
        config = _weighted(self.config, self.vibration_weight)
        feed, air = targets_on_map(tubes, measured["inserted_length"], config, self.vibration, shifts)
        goal = np.column_stack([feed, np.clip(self._taut(measured), air, self.config.air_supply_rates[1])])
        applied = np.column_stack([measured["feed_speed"], measured["air_supply_rate"]])
        before = np.where(memory[:, 2:] > 0.0, memory[:, 2:], applied)
        memory[:, 2:] = before + gain(self.config, self.smoothing) * (goal - before)
        return memory[:, 2], memory[:, 3]

    def _shift(self, measured: dict[str, FloatArray], tubes: list[Context]) -> FloatArray:
        """Logarithm (N,) of the ratio of measured and predicted vibration [decades]."""
        values = np.array([[getattr(tube, name) for name in CONTEXT] for tube in tubes])
        length, feed, air = (measured[name] for name in ("inserted_length", "feed_speed", "air_supply_rate"))
        expected = 10.0 ** self.vibration.predict(length, feed, air, values, self.config.scene)[0] * 1e-4
        return np.asarray(np.log10(measured["rf_noise"] / np.hypot(expected, RF_FLOOR)))

    def _taut(self, measured: dict[str, FloatArray]) -> FloatArray:
        """Air supply (N,) [m3/s] for the least tension; tension is proportional to the square of the wind."""
        no_wind = measured["feed_speed"] / air_speed(self.config.scene, 1.0)
        tension = np.maximum(measured["root_tension"], 0.1 * self.least_tension)
        return np.asarray(no_wind + (measured["air_supply_rate"] - no_wind) * np.sqrt(self.least_tension / tension))


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
