"""Interface of methods that advance probes in time, with their order of convergence and stability limit."""

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
class KernelArguments:
    """One probe, argument of ``Method.run``; all but ``constants``, ``inputs`` and ``points`` change in place.

    Attributes:
        constants: result of ``Method.constants``.
        state, root: of the probe.
        inputs: (steps, 4) of the next steps, see model/drive.py.
        points: (p,) sampled nodes, -1 for the root.
        samples: (k, p, 4) x, y, theta and V of the points, one row per sample.
        tension_sum: (n + 1,) sum of the axial forces of all samples; empty if not requested.
        failed: step at which the probe diverged, counted from 1, or 0.
        iterations, unconverged: iterations of ``implicit`` and its steps that did not converge.
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
    """A method that advances chains in time; subclasses set the attributes.

    Attributes:
        name: value of the argument ``method``.
        order: order of convergence for smooth motion.
        usual_step: time step for the probe of table 2 [s].
        min_step: step below which rounding errors are significant [s].
        precision: floating-point type of its kernel.
        single_fraction: run time of a single probe divided by that of a full group.
        memory: numbers per node that it stores between steps.
        on_nodes: whether its mesh has ``nodes_per_pitch`` nodes; equal meshes give equal solutions.
        simulates_withdrawal: whether it simulates compression on the outer wall, and nodes that leave at the root.
        simulates_expansion: whether the drag may differ between equal floats, as in compressible air.
        simulates_weight: whether weight adds to friction.
        simulates_terms: whether bending may shorten the cable and friction hold at rest, see ``scene.Terms``.
        simulates_damping: whether contact may be damped, and friction depend on the sliding speed.
    """

    name: str
    order: int
    usual_step: float
    min_step: float = 0.0
    precision: npt.DTypeLike = np.float64
    single_fraction: float = 1.0
    memory: int = 5
    on_nodes: bool = True
    simulates_withdrawal: bool = True
    simulates_expansion: bool = True
    simulates_weight: bool = True
    simulates_terms: bool = True
    simulates_damping: bool = False

    @property
    def width(self) -> int:
        """Largest number of probes in a group."""
        return 1

    @property
    def in_double(self) -> Method:
        """The same method in double precision."""
        return self

    @property
    def on_nodes_as(self) -> Method:
        """The method with nodes between floats, in the same precision, that replaces this one."""
        return self

    def stable_step(self, scene: Scene, nodes_per_pitch: int) -> float:
        """Largest step [s] known to be stable; 0 if none is known, as for methods that were not measured."""
        known = stability.known_step(scene, nodes_per_pitch) if self.name in stability.MEASURED else 0.0
        return stability.damped_step(known, scene)

    def contact_step(self, scene: Scene, nodes_per_pitch: int) -> float:
        """Largest step [s] that contact allows for any damping and mesh; larger steps diverge."""
        return stability.damped_step(stability.contact_step(scene, nodes_per_pitch), scene)

    def at_rest(self, chain: Chain, nodes_per_pitch: int, time_step: float, root: int, d: FloatArray) -> State:
        """A state at rest with displacements d (n + 1, 3) [m, rad] of a chain held at ``root``."""
        return at_rest(len(d), self.memory)._replace(d=d.copy())

    @abstractmethod
    def constants(self, chain: Chain, sensor: int, nodes_per_pitch: int, time_step: float) -> Any:
        """Constants of the kernel for a chain.

        Args:
            chain: the chain.
            sensor: node of the sensor; floats from the tip to it are those of the guide.
            nodes_per_pitch: nodes in a float pitch.
            time_step: [s].
        """

    def with_drag(self, constants: Any, chain: Chain, sensor: int, nodes_per_pitch: int, time_step: float) -> Any:
        """Constants for a chain that differs in drag only from that of ``constants``; arguments as there."""
        return self.constants(chain, sensor, nodes_per_pitch, time_step)

    def kind(self, constants: Any) -> Hashable:
        """Key of probes that can share a group."""
        return None

    @abstractmethod
    def run(
        self, lanes: Sequence[KernelArguments], time_step: float, per_pitch: int, first_sample: int, sample_every: int
    ) -> float:
        """Advance up to ``width`` probes of one kind by the rows of their inputs.

        Arrays are not checked here; see ``model.state``.

        Args:
            lanes: the probes, with equal numbers of steps, points and samples.
            time_step: [s].
            per_pitch: nodes in a float pitch.
            first_sample: steps until the first sample.
            sample_every: steps between samples.

        Returns:
            run time of the kernel [s].
        """

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Method) and self.name == other.name

    def __hash__(self) -> int:
        return hash(self.name)

    def __repr__(self) -> str:
        return f"<Method {self.name}>"
