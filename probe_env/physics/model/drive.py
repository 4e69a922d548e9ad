"""Drive of a probe: feed speed with a ramp limit, air with a first-order lag, and inserted length.

``inputs_of_steps`` converts targets to the inputs of every step, for the kernels of all methods.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from probe_env.arrays import FloatArray

SPEED, SLOPE, AIR, APPEND = range(4)
INPUTS = 4
"""Columns of the inputs of a step: u and du/dt [m/s], [m/s2], Q / (a - A_c) [m/s] at its start, nodes appended after it
(-1: one node is removed)."""


@dataclass
class Drive:
    """Feed speed, air speed and inserted cable, with targets.

    Attributes:
        feed_speed, feed_speed_target: [m/s].
        air_speed, air_speed_target: in the tube [m/s].
        ramp: largest change of the feed speed [m/s2].
        air_lag: time constant of the air [s]; 0: no lag.
        phase: of the ripple of the feed [rad].
        travel: distance of the held root from the entrance, 0 to the length of an element [m].
        growth: change of length per length fed: 0 constant length, 1 insertion, more is time-lapse.
    """

    feed_speed: float
    air_speed: float
    ramp: float = math.inf
    air_lag: float = 0.0
    growth: float = 0.0
    travel: float = 0.0
    phase: float = 0.0

    def __post_init__(self) -> None:
        self.feed_speed_target, self.air_speed_target = self.feed_speed, self.air_speed

    def inputs_of_steps(
        self,
        steps: int,
        time_step: float,
        element_length: float,
        room: int,
        spare: int = 0,
        ripple: tuple[float, float] = (0.0, 1.0),
    ) -> FloatArray:
        """Inputs (steps, 4) of the next steps; advances the drive to their end.

        Args:
            steps: number of steps.
            time_step: [s].
            element_length: [m].
            room: nodes that can be appended.
            spare: nodes that can be removed.
            ripple: amplitude of the ripple over the feed speed, and cable fed in a period [m].
        """
        inputs = np.empty((steps, INPUTS))
        gain = _gain(time_step, self.air_lag)
        self.feed_speed, self.air_speed, self.travel, self.phase = _inputs(
            inputs, self.feed_speed, self.feed_speed_target, self.ramp * time_step, self.air_speed,
            self.air_speed_target, gain, self.travel, self.growth, time_step, element_length, room, spare,
            self.phase, ripple[0], 2.0 * math.pi / ripple[1],
        )  # fmt: skip
        return inputs


def drives_after(
    steps: int,
    time_step: float,
    ramp: float,
    air_lag: float,
    speed: FloatArray,
    air: FloatArray,
    targets: FloatArray,
    length: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Feed speed, air and fed length (N,) of N drives after some steps, without a mesh.

    Args:
        steps: number of steps.
        time_step: [s].
        ramp: largest change of the feed speed [m/s2].
        air_lag: time constant of the air [s]; 0: no lag.
        speed: (N,) present feed speed [m/s].
        air: (N,) present air, in the units of its targets.
        targets: (N, 2) of feed speed and air.
        length: (N,) present fed length [m].
    """
    rows = np.column_stack([speed, air, length])
    speed, air, length = _drives_after(rows, targets, steps, ramp * time_step, _gain(time_step, air_lag), time_step).T
    return speed, air, length


def _gain(time_step: float, air_lag: float) -> float:
    return -math.expm1(-time_step / air_lag) if air_lag > 0.0 else 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def _drives_after(rows, targets, steps, ramp_step, gain, dt):
    inputs = np.empty((steps, INPUTS))
    for row, (speed, air) in zip(rows, targets):  # noqa: B905
        row[:] = _inputs(
            inputs, row[0], speed, ramp_step, row[1], air, gain, row[2], 1.0, dt, np.inf, 0, 0, 0.0, 0.0, 0.0
        )[:3]
    return rows


@njit(cache=True, nogil=True, error_model="numpy")
def _inputs(
    inputs, speed, speed_target, ramp_step, air, air_target, gain, travel, growth, dt, h, room, spare, phase, ripple,
    wave_number,
):  # fmt: skip
    """One step at a time, so that the result does not depend on the division of a run into calls."""
    for k in range(len(inputs)):
        change = min(max(speed_target - speed, -ramp_step), ramp_step)
        inputs[k, SPEED] = speed
        inputs[k, SLOPE] = change / dt
        inputs[k, AIR] = air
        inputs[k, APPEND] = 0.0
        speed = speed_target if abs(speed_target - speed) <= ramp_step else speed + change
        air = air_target if gain == 1.0 else air + gain * (air_target - air)
        if ripple > 0.0:
            inputs[k, SPEED] *= 1.0 + ripple * math.sin(phase)
            phase += wave_number * speed * dt
            inputs[k, SLOPE] = (speed * (1.0 + ripple * math.sin(phase)) - inputs[k, SPEED]) / dt
        travel += growth * speed * dt
        if travel >= h and room > 0:
            travel -= h
            room, spare = room - 1, spare + 1
            inputs[k, APPEND] = 1.0
        elif travel < 0.0:
            if spare > 0:
                travel += h
                room, spare = room + 1, spare - 1
                inputs[k, APPEND] = -1.0
            else:
                travel = 0.0
    return speed, air, travel, phase
