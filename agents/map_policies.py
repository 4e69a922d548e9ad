"""Policies that look up the best schedule of a tube in the map: told the tube, or guessing it from tension."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from agents.policies import FixedPolicy
from agents.vibration_map import CONTEXT, FEEDS, STORED, features_of, stored_map
from probe_env import Context, Scene
from probe_env.chain import FloatArray, air_speed, build_chain
from probe_env.contexts import HELIX_DIAMETERS
from probe_env.schedule import Schedule
from probe_env.task import TaskConfig

KNOTS: Final = np.arange(5.0, 61.0, 2.5)  # [m]
FEED_GRID: Final = np.geomspace(*FEEDS, 32)
LEAST_AIR: Final = 45.0 / 3600.0
"""[m3/s]; below it the root tension of a training tube came near the 0.8 N that the rising straight part needs."""
FRICTIONS: Final = (0.08, 0.27)
FRICTION_STEP: Final = 0.005


def grid(config: TaskConfig) -> tuple[FloatArray, FloatArray]:
    """(g,) feed speeds [m/s] and air supplies [m3/s] that a best schedule is picked from."""
    air = np.linspace(LEAST_AIR, config.air_supply_rates[1], 12)
    feed, blown = np.meshgrid(FEED_GRID, air, indexing="ij")
    return feed.ravel(), blown.ravel()


def metre_costs(contexts: FloatArray, config: TaskConfig) -> FloatArray:
    """(contexts, knots, g) expected cost of a metre at every knot, for every feed and air of the grid."""
    feed, air = grid(config)
    costs = np.empty((len(contexts), len(KNOTS), len(feed)))
    one = np.ones_like(feed)
    for j, context in enumerate(contexts):
        for k, length in enumerate(KNOTS):
            features = features_of(length * one, feed, air, np.tile(context, (len(feed), 1)))
            costs[j, k] = stored_map().metre_cost(features, feed, air, config)
    return costs


@lru_cache(maxsize=4096)
def best_schedule_for(context: Context, config: TaskConfig) -> Schedule:
    """Schedule over inserted length with the least expected cost on one tube: the best of the grid at every knot."""
    values = np.array([[getattr(context, name) for name in CONTEXT]])
    best = metre_costs(values, config)[0].argmin(axis=1)
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
        if "root_tension" not in seen:
            raise ValueError("the tension-scheduled policy needs a task that shows the root tension")
        estimate = friction_from_tension(
            seen["root_tension"], seen["inserted_length"], seen["feed_speed"], seen["air_supply_rate"],
            seen["helix_diameter"],
        )  # fmt: skip
        gain = 1.0 - np.exp(-self.config.period / self.average)
        memory[:, 0] += gain * (np.clip(estimate, *FRICTIONS) - memory[:, 0])
        rounded = np.round(memory[:, 0] / FRICTION_STEP) * FRICTION_STEP
        pairs = zip(rounded, seen["helix_diameter"], strict=True)
        tubes = [Context(friction=round(float(mu), 4), helix_diameter=round(float(d), 3)) for mu, d in pairs]
        return _looked_up(tubes, seen["inserted_length"], _weighted(self.config, self.vibration_weight))


@lru_cache
def _weighted(config: TaskConfig, vibration_weight: float | None) -> TaskConfig:
    return config if vibration_weight is None else config.model_copy(update={"vibration_weight": vibration_weight})


def _looked_up(tubes: list[Context], length: FloatArray, config: TaskConfig) -> tuple[FloatArray, FloatArray]:
    pairs = [best_schedule_for(tube, config).at(place) for tube, place in zip(tubes, length, strict=True)]
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


def friction_from_tension(
    tension: FloatArray, length: FloatArray, feed: FloatArray, air: FloatArray, helix_diameter: FloatArray
) -> FloatArray:
    """Friction coefficient (n,) at which steady sliding has a root tension [N], by bisection.

    T = (q r / mu') (1 - exp(-mu' L / r)), mu' = mu (1 - d_f / d_h), with table 2's drag q per metre; tension falls as
    friction rises.

    Args:
        tension: at the root [N].
        length: inserted [m].
        feed: speed [m/s].
        air: supply [m3/s].
        helix_diameter: [m].
    """
    scene, drag = Scene(), _drag_per_metre()
    wind = np.array([air_speed(scene, float(q)) for q in air]) - feed
    force, radius = drag * wind * np.abs(wind), helix_diameter / 2.0
    low, high = np.zeros_like(tension), np.full_like(tension, 2.0)
    for _ in range(30):
        middle = 0.5 * (low + high)
        at_middle = force * radius / middle * -np.expm1(-middle * length / radius)
        low, high = np.where(at_middle > tension, middle, low), np.where(at_middle > tension, high, middle)
    return np.asarray(0.5 * (low + high) / (1.0 - scene.probe.carrier_float_diameter / helix_diameter))


@lru_cache
def _drag_per_metre() -> float:
    """Drag force a metre over the square of the wind [N s2/m3], table 2's floats."""
    scene = Scene()
    drag = build_chain(scene).drag
    return float(drag[drag > 0.0].mean() / scene.probe.float_pitch)


MAP_POLICIES: Final[dict[str, tuple[type[FixedPolicy], dict[str, Any]]]] = {
    "tension-scheduled": (TensionScheduled, {}),
    "privileged": (Privileged, {}),
}
