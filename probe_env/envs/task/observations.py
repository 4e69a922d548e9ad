"""Sensor model: observations of N probes with noise and delay, and observations in SI units."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray, FloatArray
from probe_env.design import RANGES
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.scales import (
    ACCELEROMETER_FLOOR,
    LOAD_CELL,
    LOGARITHMIC,
    RF_FLOOR,
    UNITS,
    fraction_between,
    value_at,
)

DROPPING_OUT: Final = ("rf_noise", "root_tension")
"""Observations that keep their last value when they drop out."""


def observe(config: TaskConfig, measured: dict[str, FloatArray], noise: FloatArray) -> npt.NDArray[np.float32]:
    """(N, d) observation of measured values, with standard normal ``noise`` (N, 2) for RF noise and tension.

    Args:
        config: the task.
        measured: (N,) each in SI units: statistics of the motion, and the other observations by name.
        noise: (N, 2).
    """
    tension = measured["tension_mean_n"] * (1.0 + config.tension_noise * noise[:, 1])
    values: dict[str, FloatArray] = measured | {
        "radial_acceleration": np.hypot(measured["radial_acceleration_rms_m_per_s2"], ACCELEROMETER_FLOOR),
        "axial_acceleration": np.hypot(measured["axial_acceleration_rms_m_per_s2"], ACCELEROMETER_FLOOR),
        "rf_noise": np.hypot(measured["radial_rms_m"], RF_FLOOR) * np.exp(config.rf_noise * noise[:, 0]),
        "root_tension": np.clip(tension, -LOAD_CELL, LOAD_CELL),
    }

    def column(name: str) -> FloatArray:
        if name in RANGES:
            return fraction_between(values[name], RANGES[name][:2])
        value = values[name] / UNITS.get(name, 1.0)
        return np.asarray(np.log10(value) if name in LOGARITHMIC else value)

    return np.column_stack([column(name) for name in config.observations]).astype(np.float32)


def in_si_units(config: TaskConfig, observation: npt.NDArray[np.floating[Any]]) -> dict[str, FloatArray]:
    """Observations (N, d) by name and in SI units (N,): the inverse of ``observe``.

    ``rf_noise`` is the equivalent radial rms [m], accelerations are rms [m/s2], actions are not converted.
    """
    if observation.ndim != 2 or observation.shape[1] != len(config.observations):
        raise ValueError(
            f"observation of shape {observation.shape} is not (N, {len(config.observations)}), the shape of this task"
        )

    def value(name: str, column: FloatArray) -> FloatArray:
        if name in RANGES:
            return value_at(column, RANGES[name][:2])
        return UNITS.get(name, 1.0) * (10.0**column if name in LOGARITHMIC else column)

    columns = zip(config.observations, observation.astype(float).T, strict=True)
    return {name: value(name, column) for name, column in columns}


def normal_draws(rngs: Sequence[np.random.Generator], which: BoolArray, count: int) -> FloatArray:
    """(N, count) standard normal draws from the generator of each probe; 0 for probes not in ``which`` (N,)."""
    draws = np.zeros((len(which), count))
    for rng, chosen, row in zip(rngs, which.tolist(), draws, strict=True):
        if chosen:
            rng.standard_normal(out=row)
    return draws


class SensorModel:
    """Observations of N probes, with noise and delay.

    Attributes:
        observed: (N, delay + 1, d) last observations, oldest first; the first is the current output.
    """

    def __init__(self, config: TaskConfig, count: int) -> None:
        self.config = config
        self.observed = np.zeros((count, config.delay_periods + 1, len(config.observations)), dtype=np.float32)

    @property
    def observation(self) -> npt.NDArray[np.float32]:
        """(N, d) current observation."""
        return self.observed[:, 0]

    def begin(self, measured: dict[str, FloatArray], which: BoolArray, noise: FloatArray) -> None:
        """Set the first observation of some probes; a delayed sensor outputs it until the next one arrives."""
        self.observed[which] = observe(self.config, measured, noise)[which, None]

    def update(
        self, measured: dict[str, FloatArray], which: BoolArray, noise: FloatArray, rngs: Sequence[np.random.Generator]
    ) -> None:
        """Add an observation of some probes; the others keep their last one.

        Args:
            measured: see ``observe``.
            which: (N,) whether the probe has a new observation.
            noise: (N, 2) standard normal draws.
            rngs: the generator of each probe, for drop-outs.
        """
        new = observe(self.config, measured, noise)
        if self.config.sensor_dropout > 0.0:
            columns = [k for k, name in enumerate(self.config.observations) if name in DROPPING_OUT]
            for k in np.flatnonzero(which).tolist():
                if rngs[k].random() < self.config.sensor_dropout:
                    new[k, columns] = self.observed[k, -1, columns]
        self.observed[which] = np.concatenate([self.observed[:, 1:], new[:, None]], axis=1)[which]
