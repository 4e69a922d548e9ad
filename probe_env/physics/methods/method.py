"""What a method is: how it advances probes in time, how accurate it is and up to which step it holds."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
from probe_env.physics.methods import stability
from probe_env.physics.model.chain import Chain
from probe_env.physics.model.state import State, at_rest
from probe_env.scene import Scene


@dataclass
class Lane:
    """One probe as ``Method.run`` takes it; all but ``constants``, ``inputs`` and ``points`` change in place.

    Attributes:
        constants: of ``Method.constants``.
        state, root: of the probe.
        inputs: (steps, 4) of the coming steps, see model/drive.py.
        points: (p,) nodes that are sampled, -1 for the root.
        samples: (k, p, 4) x, y, theta and V of the points, a row for every sample that falls due.
        tension_sum: (n + 1,), gains the axial force of every sample; empty: not asked for.
        failed: step at which the probe diverged, counted from 1, or 0.
        iterations, unconverged: of ``implicit``, and its steps that did not converge.
    """

    constants: Any
    state: State
    root: int
    inputs: FloatArray
    points: npt.NDArray[np.int64]
    samples: FloatArray
    tension_sum: FloatArray
    failed: int = 0
    iterations: int = 0
    unconverged: int = 0


class Method(ABC):
    """A method that advances chains in time; a subclass declares what holds for it.

    Attributes:
        name: by which it is asked for.
        order: of convergence where the motion is smooth.
        usual_step: that table 2's probe is simulated with [s].
        least_step: below which rounding shows [s].
        precision: of the numbers in its kernel.
        alone_share: time that a probe by itself takes, of that of a full group.
        memory: numbers a node that it keeps of its last step.
        on_nodes: whether its mesh has ``nodes_per_pitch`` nodes: on the same mesh such methods have the same solution.
        draws_back: whether it simulates the return: pressed on the outer wall, and drawn out at the root.
    """

    name: str
    order: int
    usual_step: float
    least_step: float = 0.0
    precision: npt.DTypeLike = np.float64
    alone_share: float = 1.0
    memory: int = 3
    on_nodes: bool = True
    draws_back: bool = True

    @property
    def width(self) -> int:
        """Probes side by side in a group."""
        return 1

    def stable_step(self, scene: Scene, nodes_per_pitch: int) -> float:
        """Largest step [s] known to hold; 0 where none is known."""
        return stability.known_step(scene, nodes_per_pitch)

    def contact_step(self, scene: Scene, nodes_per_pitch: int) -> float:
        """Largest step [s] that contact allows, whatever damping and mesh: beyond it a run diverges."""
        return stability.contact_step(scene, nodes_per_pitch)

    def at_rest(self, chain: Chain, nodes_per_pitch: int, time_step: float, root: int, d: FloatArray) -> State:
        """A state at rest with displacements d (n + 1, 3) [m, rad] of a chain held at ``root``."""
        return at_rest(len(d), self.memory)._replace(d=d.copy())

    @abstractmethod
    def constants(self, chain: Chain, sensor: int, nodes_per_pitch: int, time_step: float) -> Any:
        """What its kernel needs of a chain and keeps from step to step; nothing changes it.

        Args:
            chain: what is advanced.
            sensor: its node; guide floats reach from the tip up to it.
            nodes_per_pitch: nodes in a float pitch.
            time_step: [s].

        Raises:
            ValueError: a chain with what the method does not simulate.
        """

    def kind(self, constants: Any) -> Hashable:
        """Probes with the same can share a group."""
        return None

    @abstractmethod
    def run(
        self, lanes: Sequence[Lane], time_step: float, nodes_per_pitch: int, first_sample: int, sample_every: int
    ) -> float:
        """Advance up to ``width`` probes of a kind by the rows of their inputs.

        No array is checked: those of a caller are, see ``model.state``.

        Args:
            lanes: the probes, with equally many steps, points and samples.
            time_step: [s].
            nodes_per_pitch: nodes in a float pitch.
            first_sample: steps until the first sample.
            sample_every: steps between samples.

        Returns:
            seconds that the kernel took.
        """

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Method) and self.name == other.name

    def __hash__(self) -> int:
        return hash(self.name)

    def __repr__(self) -> str:
        return f"<Method {self.name}>"
