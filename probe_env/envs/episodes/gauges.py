"""Sensor model: observations of N probes with noise and delay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray, FloatArray
from probe_env.design import RANGES
from probe_env.envs.contexts import Context
from probe_env.envs.task import TaskConfig
from probe_env.envs.task.observations import observe
from probe_env.inspection.snr import SnrEstimator
from probe_env.physics.simulation.batch import SimulatorBatch
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.physics.simulation.window import Window

DROPPING_OUT: Final = ("rf_noise", "root_tension")
"""What keeps its last value in a period in which it drops out."""
SHOWN: Final = (
    "radial_rms_m", "radial_acceleration_rms_m_per_s2", "axial_rms_m", "tension_mean_n", "lift_off_share",
)  # fmt: skip
"""Statistics of a period that an info has."""


class Gauges:
    """Sensor model: observations of the N probes of a batch, with noise and delay.

    Attributes:
        meter: estimates their signal-to-noise.
        observed: (N, delay + 1, d) last observations, the one that is shown first.
    """

    def __init__(self, config: TaskConfig, batch: SimulatorBatch) -> None:
        self.config, self.batch = config, batch
        self.meter = SnrEstimator(config.sensor, len(batch), SAMPLE_PERIOD)
        self.observed = np.zeros((len(batch), config.delay_periods + 1, len(config.observations)), dtype=np.float32)

    def fork(self, which: Sequence[int], batch: SimulatorBatch) -> Gauges:
        """Instruments of a ``batch`` of copies of some of the probes, with what they have heard and shown."""
        new = Gauges(self.config, batch)
        new.meter, new.observed = self.meter.fork(which), self.observed[list(which)]
        return new

    @property
    def observation(self) -> npt.NDArray[np.float32]:
        """(N, d) what is shown."""
        return self.observed[:, 0]

    def inserted(self) -> FloatArray:
        """(N,) cable in the helix, not more than it is long [m]."""
        return np.array([s.length_in_helix for s in self.batch.simulators])

    def helix_length(self) -> FloatArray:
        """(N,) [m]."""
        return np.array([s.scene.tube.helix_length for s in self.batch.simulators])

    def air_supply_rate(self) -> FloatArray:
        """(N,) [m3/s]."""
        return np.array([s.air_supply_rate for s in self.batch.simulators])

    def listen(self, window: Window, good: BoolArray) -> Window:
        """The window with what its motion leaves of the signal-to-noise; 0 for probes that were not advanced."""
        assert window.radial is not None
        noise = np.zeros(len(good))
        which = np.flatnonzero(good)
        if len(which):
            noise[which] = 1.0 / self.meter.update(which, window.radial[:, which], window.feed_speed[which]).snr
        return replace(window, statistics=window.statistics | {"noise_to_signal": noise})

    def measured(self, window: Window, contexts: Sequence[Context], actions: FloatArray) -> dict[str, FloatArray]:
        """What is so, (N,) each in SI units, before sensors add their noise: see ``observe``."""
        inserted = self.inserted()
        fields = {name: np.array([getattr(c, name) for c in contexts]) for name in Context.model_fields}
        probes = [s.scene.probe for s in self.batch.simulators]
        felt = dict(window.statistics)
        if self.config.vibration_measure == "snr":  # then the eddy-current noise is that of the flaw's band
            felt["radial_rms_m"] = self.config.sensor.equivalent_rms(felt["noise_to_signal"])
        return {
            **felt,
            **fields,
            **{name: np.array([getattr(probe, name) for probe in probes]) for name in RANGES},
            "inserted_length": inserted,
            "remaining_length": self.helix_length() - inserted,
            "feed_speed": window.feed_speed,
            "air_supply_rate": window.air_supply_rate,
            "feed_action": actions[:, 0].astype(float),
            "air_action": actions[:, 1].astype(float),
        }

    def shows(self, k: int, window: Window) -> dict[str, float]:
        """What is so at one probe, SI units: the physical part of its info."""
        simulator = self.batch.simulators[k]
        noise = float(window.statistics["noise_to_signal"][k])
        return {
            "inserted_length": float(simulator.length_in_helix),
            "feed_speed": float(window.feed_speed[k]),
            "air_supply_rate": float(window.air_supply_rate[k]),
            **{name: float(window.statistics[name][k]) for name in SHOWN},
            "snr": 1.0 / noise if noise > 0.0 else 0.0,
            "noise_rms_m": float(self.config.sensor.equivalent_rms(np.array(noise))),
        }

    def begin(self, measured: dict[str, FloatArray], which: BoolArray, rngs: Sequence[np.random.Generator]) -> None:
        """First readings of some probes' episodes: what is late shows these at first."""
        self.observed[which] = self._noisy(measured, which, rngs)[which, None]

    def read(self, measured: dict[str, FloatArray], which: BoolArray, rngs: Sequence[np.random.Generator]) -> None:
        """New readings of some probes, with noise of their generators; the others keep their last ones."""
        new = self._noisy(measured, which, rngs)
        self._drop_out(new, which, rngs)
        self.observed[which] = np.concatenate([self.observed[:, 1:], new[:, None]], axis=1)[which]

    def _noisy(
        self, measured: dict[str, FloatArray], which: BoolArray, rngs: Sequence[np.random.Generator]
    ) -> npt.NDArray[np.float32]:
        """Observation (N, d) with new sensor noise for some probes; of the others the rows mean nothing."""
        noise = np.zeros((len(which), 2))
        for k in np.flatnonzero(which).tolist():
            noise[k] = rngs[k].normal(size=2)
        return observe(self.config, measured, noise)

    def _drop_out(self, new: npt.NDArray[Any], which: BoolArray, rngs: Sequence[np.random.Generator]) -> None:
        """Hold what drops out in new readings (N, d) of some probes at what was measured before."""
        if self.config.sensor_dropout == 0.0:
            return
        columns = [k for k, name in enumerate(self.config.observations) if name in DROPPING_OUT]
        for k in np.flatnonzero(which).tolist():
            if rngs[k].random() < self.config.sensor_dropout:
                new[k, columns] = self.observed[k, -1, columns]
