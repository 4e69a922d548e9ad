"""The motion of the chain near its tip, looked at in steps of milliseconds; what is looked at does not notice.

A control period shows the sensor alone. To see the whole chain in between, a copy of the simulator runs ahead in short
pieces, towards the targets that the period is about to have: a run does not depend on how it is cut, so the copy moves
as the probe then does, bit for bit.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Final

import numpy as np

from probe_env.arrays import BoolArray, FloatArray
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.physics.simulation.simulator import Simulator
from probe_env.scene import Scene

FRAME_PERIOD: Final = 5e-3
"""Of the dynamics, between two looks at the chain [s]."""
EVERY: Final = round(FRAME_PERIOD / SAMPLE_PERIOD)


@dataclass(frozen=True)
class Motion:
    """The n nodes nearest to the tip at k times on the dynamics clock; the tip first.

    Attributes:
        scene: tube and probe.
        sensor: its node.
        distance: (n,) of the unstretched probe from the tip [m].
        lever: (n,) half the diameter of a float there [m].
        outer_gap: (n,) radial displacement at which a float touches the outer wall [m]; infinite without that wall.
        floats: (n,) which nodes are floats.
        time: (k,) since the first look, ``FRAME_PERIOD`` apart [s].
        inserted_length: (k,) [m].
        axial, radial: (k, n) displacement [m]; radial 0 touches the inner wall, less presses on it.
        signal_time: (m,) of the sensor's signals, ``SAMPLE_PERIOD`` apart [s]; less than 0 before the first look.
        signal_axial, signal_radial: (m,) displacement of the sensor [m].
    """

    scene: Scene
    sensor: int
    distance: FloatArray
    lever: FloatArray
    outer_gap: FloatArray
    floats: BoolArray
    time: FloatArray
    inserted_length: FloatArray
    axial: FloatArray
    radial: FloatArray
    signal_time: FloatArray
    signal_axial: FloatArray
    signal_radial: FloatArray

    @property
    def on_inner_wall(self) -> BoolArray:
        """(k, n) floats that press on the inner wall: the contact of the model."""
        return self.floats & (self.radial < 0.0)

    @property
    def on_outer_wall(self) -> BoolArray:
        """(k, n) floats that press on the outer wall."""
        return self.floats & (self.radial > self.outer_gap)


class Watch:
    """Looks at a probe near its tip, at once and then every ``FRAME_PERIOD``.

    Args:
        simulator: the probe now; its time step fits into ``SAMPLE_PERIOD``.
        length: how far behind the tip to look [m]: at least to the sensor, at most what is inserted.
        axial, radial: (m,) what the sensor felt up to now, ``SAMPLE_PERIOD`` apart [m].
    """

    def __init__(self, simulator: Simulator, length: float, axial: FloatArray, radial: FloatArray) -> None:
        h = simulator.chain.element_length
        self._scene, self._sensor, self._chain = simulator.scene, simulator.sensor, simulator.chain
        self._nodes = np.arange(min(max(round(length / h), simulator.sensor), simulator.root - 1) + 1)
        self._before, self._samples = len(axial), 0
        self._axial, self._radial = [axial], [radial]
        self._looks: list[tuple[float, FloatArray]] = []
        self._look(simulator)

    def follow(self, simulator: Simulator, feed_speed: float, air_supply_rate: float, duration: float) -> Simulator:
        """Look at what the probe does in ``duration`` [s] towards targets [m/s], [m3/s]; it stays as it is.

        Returns:
            a probe as it is then.

        Raises:
            ValueError: a duration that is no whole number of sample periods, or a target out of range.
            SimulationError: the state diverges.
        """
        ahead, left = copy.deepcopy(simulator), round(duration / SAMPLE_PERIOD)
        while left > 0:
            samples = min(left, EVERY - self._samples % EVERY)
            run = ahead.advance(feed_speed, air_supply_rate, samples * SAMPLE_PERIOD, SAMPLE_PERIOD, points=("sensor",))
            self._axial.append(run.axial[1:, 0])
            self._radial.append(run.radial[1:, 0])
            self._samples, left = self._samples + samples, left - samples
            if self._samples % EVERY == 0:
                self._look(ahead)
        return ahead

    def motion(self) -> Motion:
        """Everything seen up to now."""
        chain, nodes = self._chain, self._nodes
        axial, radial = np.concatenate(self._axial), np.concatenate(self._radial)
        shapes = np.array([d for _, d in self._looks])
        return Motion(
            scene=self._scene,
            sensor=self._sensor,
            distance=nodes * chain.element_length,
            lever=chain.lever[nodes],
            outer_gap=chain.outer_gap[nodes],
            floats=chain.contact_stiffness[nodes] > 0.0,
            time=FRAME_PERIOD * np.arange(len(self._looks)),
            inserted_length=np.array([length for length, _ in self._looks]),
            axial=shapes[:, :, 0],
            radial=shapes[:, :, 1],
            signal_time=SAMPLE_PERIOD * (np.arange(len(axial)) + 1 - self._before),
            signal_axial=axial,
            signal_radial=radial,
        )

    def _look(self, simulator: Simulator) -> None:
        length = simulator.length_in_helix
        self._looks.append((length, simulator.state.d[self._nodes].copy()))
