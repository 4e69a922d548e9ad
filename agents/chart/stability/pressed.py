"""Two hundred scenes with pressure, drawn at random: fed against the air, drawn back, turned round, fed in hard.

A scene is drawn from its number alone, so that any of them can be run again by itself. Ways and probes are balanced: of
every way there are as many scenes, and of every probe as many within a way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from agents.records.shipped import shipped_folder
from probe_env import Design, Scene
from probe_env.envs.contexts import STIFFNESS
from probe_env.physics.closed_forms import buckling_load, steady_root_tension
from probe_env.scene import Probe, whole_pitches

SCENES: Final = 200
SEED: Final = 21
FRICTION: Final = (0.10, 0.35)
HELIX_DIAMETER: Final = (1.0, 2.5)  # [m]
INSERTED: Final = (5.0, 55.0)  # [m]
SHORTEST_CARRIER: Final = 1.5  # [m]; what is drawn back gets 1 m shorter at most before it is turned
WEAK: Final = (2e-3, 2.5e-2)
"""Flexural rigidity of weak cables [N m2], drawn evenly in its logarithm: up to the least of the design space."""
PROBES: Final = ("original", "improved", "random design", "weak cable")
RAMP: Final = 0.5  # [m/s2], of the tasks
AIR_LAG: Final = 1.0  # [s], of the tasks
BEFORE: Final = 2.0  # [s] with the first targets
AFTER: Final = 3.0  # [s] with the second


class Targets(NamedTuple):
    """What is asked of the feed device."""

    feed_speed: float  # [m/s]
    air_supply_rate: float  # [m3/s]


Span = tuple[float, float]
WAYS: Final[dict[str, tuple[tuple[Span, Span], tuple[Span, Span]]]] = {
    "fed against the air": (((0.05, 0.4), (0.0, 10.0)), ((0.05, 0.4), (-130.0, 0.0))),
    "drawn back": (((-0.4, -0.05), (-130.0, -10.0)), ((-0.4, -0.05), (-130.0, -10.0))),
    "in, then back": (((0.05, 0.4), (30.0, 130.0)), ((-0.4, -0.05), (-130.0, -30.0))),
    "back, then in": (((-0.4, -0.05), (-130.0, -30.0)), ((0.05, 0.4), (30.0, 130.0))),
    "fed in hard": (((0.3, 0.4), (90.0, 130.0)), ((0.3, 0.4), (90.0, 130.0))),
}
"""Way -> feed [m/s] and air [m3/h] that are drawn, of the first and of the second targets."""


@dataclass(frozen=True)
class Pressed:
    """One of the scenes.

    Attributes:
        number: of it.
        way, probe: of ``WAYS`` and ``PROBES``.
        scene: with the first targets; floats alone touch the walls.
        turned: the second targets.
        growing: whether the length changes with the feed, or is held.
    """

    number: int
    way: str
    probe: str
    scene: Scene
    turned: Targets
    growing: bool

    @property
    def start(self) -> Literal["inner", "outer"]:
        """Wall that it lies on at rest: air towards the feed device presses it against the outer one."""
        return "outer" if self.scene.air_supply_rate < 0.0 else "inner"

    def with_cable(self, cable: bool) -> Scene:
        """The scene in which the cable touches the walls too, or not."""
        return self.scene.model_copy(update={"contact": {"cable": cable}})

    def sliding_tensions(self) -> tuple[float, float]:
        """Closed form of the root tension [N] if it came to slide steadily with the first and the second targets."""
        turned = self.scene.model_copy(update=self.turned._asdict())
        return steady_root_tension(self.scene), steady_root_tension(turned)

    def over_euler(self) -> float:
        """The greater pressure of these over Euler's load between two floats; 0 where it is pulled."""
        return max(-min(self.sliding_tensions()), 0.0) / buckling_load(self.scene.probe)

    def bending_force(self, nodes_per_pitch: int) -> float:
        """EI / h^2 [N]: an axial force beyond it bends the cable within an element, finer than the mesh knows."""
        return self.scene.probe.flexural_rigidity * (nodes_per_pitch / self.scene.probe.float_pitch) ** 2


@cache
def pressed_scene(number: int) -> Pressed:
    """The scene of a number."""
    rng = np.random.default_rng([SEED, number])
    way, name = list(WAYS)[number % len(WAYS)], PROBES[number // len(WAYS) % len(PROBES)]
    probe = _probe(name, rng)
    carrier = max(rng.uniform(*INSERTED) - probe.guide_length, SHORTEST_CARRIER)
    contact: dict[str, Any] = {"friction": rng.uniform(*FRICTION), "stiffness": rng.uniform(*STIFFNESS)}
    helix = rng.uniform(*HELIX_DIAMETER)
    first, second = (Targets(rng.uniform(*feed), rng.uniform(*air) / 3600.0) for feed, air in WAYS[way])
    scene = Scene.model_validate(
        {
            "tube": {"helix_diameter": helix},
            "probe": probe.model_dump(),
            "contact": contact,
            "couple": "tangent",
            "carrier_length": whole_pitches(carrier, probe),
            **first._asdict(),
        }
    )
    return Pressed(number, way, name, scene, second, bool(rng.integers(2)))


def _probe(name: str, rng: np.random.Generator) -> Probe:
    """Table 2's, the study's improved one, or one that is drawn."""
    if name == "original":
        return Probe()
    if name == "improved":
        return Design.from_toml(shipped_folder("design") / "improved.toml").probe()
    probe = Design.random(rng).probe()
    if name == "weak cable":
        rigidity = math.exp(rng.uniform(*np.log(WEAK)))
        probe = probe.model_copy(update={"flexural_rigidity": float(f"{rigidity:.4g}")})
    return probe
