"""Backends of episodes: what advances N probes by a control period, by simulation or by prediction."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Final, NamedTuple, Self

import numpy as np

from probe_env.arrays import BoolArray, FloatArray, rows_of
from probe_env.envs.contexts import Context
from probe_env.envs.episodes.limits import check_fidelity, check_simulable
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.observations import normal_draws
from probe_env.envs.task.rules import air_used
from probe_env.fidelity import Fidelity
from probe_env.inspection.snr import FilteredSignal, SnrEstimator
from probe_env.physics.closed_forms import buckling_load
from probe_env.physics.simulation.batch import SimulatorBatch
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.physics.simulation.simulator import Simulator
from probe_env.physics.simulation.window import Window, joined
from probe_env.scene import Scene

START_PERTURBATION: Final = 1e-7  # [m]


class StepRecord(NamedTuple):
    """What happened to N probes in a control period, (N,) each; SI units."""

    stepped: BoolArray
    finite: BoolArray  # stepped, and did not diverge
    length_before: FloatArray  # inserted length at the start
    length_after: FloatArray  # inserted length at the end
    helix_length: FloatArray
    air: FloatArray  # used [m3]
    seconds: FloatArray  # of motion
    max_tension: FloatArray  # at the root [N]
    buckling_load: FloatArray  # of the cable between two floats [N]
    window: Window  # statistics of the sensor's motion and root tension, with samples if they are simulated
    signals: Mapping[int, FilteredSignal]  # finite probes with samples, see ``SnrEstimator.last``
    sensor_noise: FloatArray  # (N, 2) standard normal draws, see ``observe``


class Backend(ABC):
    """Advances N probes.

    Attributes:
        samples: whether windows have samples of the motion.
        helix_length: (N,) [m].
        buckling_load: (N,) of the cable between two floats [N].
    """

    samples: ClassVar[bool]

    def __init__(self, count: int, config: TaskConfig) -> None:
        self.config = config
        self.helix_length = np.full(count, config.scene.tube.helix_length)
        self.buckling_load = np.full(count, buckling_load(config.scene.probe))

    @property
    @abstractmethod
    def kernel_seconds(self) -> float:
        """Time spent in the kernels so far [s], over all threads."""

    @property
    @abstractmethod
    def inserted_length(self) -> FloatArray:
        """(N,) length of cable in the helix, at most the helix length [m]."""

    @abstractmethod
    def check(self, context: Context, scene: Scene) -> None:
        """Raise ValueError if an episode cannot begin in a tube."""

    def begin(self, k: int, context: Context, scene: Scene, rng: np.random.Generator) -> None:
        """Replace probe ``k`` by one at the start of an episode."""
        self.helix_length[k], self.buckling_load[k] = scene.tube.helix_length, buckling_load(scene.probe)

    @abstractmethod
    def settle(self, which: BoolArray, rngs: Sequence[np.random.Generator]) -> Window:
        """Let the probes ``which`` (N,) that have begun settle for ``config.settle_time``."""

    @abstractmethod
    def advance(
        self, stepped: BoolArray, targets: FloatArray, direction: FloatArray, rngs: Sequence[np.random.Generator]
    ) -> StepRecord:
        """Advance some probes by a control period.

        Args:
            stepped: (N,) which.
            targets: (N, 2) target feed speed [m/s] and air supply [m3/s], negative on withdrawal.
            direction: (N,) 1 on insertion, -1 on withdrawal.
            rngs: generator of each probe.
        """

    def branch(self, which: Sequence[int]) -> Self:
        """Independent copies of the probes ``which`` in their current state."""
        return rows_of(self, which)


class Simulated(Backend):
    """Simulates N probes in a batch.

    Attributes:
        batch: the simulators.
        meter: estimator of the signal-to-noise.
    """

    samples = True

    def __init__(
        self, count: int, config: TaskConfig, fidelity: Fidelity, scene: Scene, threads: int | None = None
    ) -> None:
        super().__init__(count, config)
        check_fidelity(fidelity, config)
        self.fidelity = fidelity
        self.batch = SimulatorBatch([scene] * count, *fidelity.numerics, threads=threads, **self._options())
        self.meter = SnrEstimator(config.sensor, count, SAMPLE_PERIOD)

    def _options(self) -> dict[str, Any]:
        return {
            "growing": self.config.growing,
            "time_lapse": self.fidelity.time_lapse if self.config.growing else 1.0,
            "ramp": self.config.ramp,
            "air_lag": self.config.air_lag,
            "perturbation": START_PERTURBATION,
        }

    @property
    def simulators(self) -> list[Simulator]:
        """The simulator of each probe."""
        return self.batch.simulators

    @property
    def kernel_seconds(self) -> float:
        """See ``Backend.kernel_seconds``."""
        return self.batch.kernel_seconds

    @property
    def inserted_length(self) -> FloatArray:
        """See ``Backend.inserted_length``."""
        return np.array([s.length_in_helix for s in self.simulators])

    def check(self, context: Context, scene: Scene) -> None:
        """See ``Backend.check``."""
        max_length = scene.tube.helix_length if self.config.growing else scene.inserted_length
        check_simulable(scene, self.fidelity, max_length, self.config.air_supply_rates[1])

    def begin(self, k: int, context: Context, scene: Scene, rng: np.random.Generator) -> None:
        """See ``Backend.begin``."""
        super().begin(k, context, scene, rng)
        simulator = Simulator(scene, *self.fidelity.numerics, seed=int(rng.integers(2**31)), **self._options())
        simulator.hold_length()  # settling does not count as inspection
        self.batch.replace(k, simulator)
        self.meter.reset(k)

    def settle(self, which: BoolArray, rngs: Sequence[np.random.Generator]) -> Window:
        """See ``Backend.settle``."""
        self._set_friction(which)
        window = self.batch.advance(None, None, self.config.settle_time, SAMPLE_PERIOD, which, keep_samples=True)
        for k in np.flatnonzero(which).tolist():
            self.simulators[k].feed_length()
        return self._with_noise(window, which)

    def time_lapse(self, targets: FloatArray, direction: FloatArray) -> FloatArray:
        """(N,) time-lapse factor of a period with targets (N, 2): only period / factor of the motion is simulated.

        Vibration on insertion is nearly steady, so metres may be skipped. On withdrawal the motion is a transient of
        the turn or of a change of feed, which time-lapse would spread over more metres.
        """
        now = [simulator.feed_speed for simulator in self.simulators]
        return np.where(direction > 0.0, self.fidelity.time_lapse_of(now, targets[:, 0]), 1.0)

    def advance(
        self, stepped: BoolArray, targets: FloatArray, direction: FloatArray, rngs: Sequence[np.random.Generator]
    ) -> StepRecord:
        """See ``Backend.advance``."""
        before, air_before = self.inserted_length, np.array([s.air_supply_rate for s in self.simulators])
        self._set_friction(stepped)
        lapse = self.time_lapse(targets, direction)
        for k in np.flatnonzero(stepped).tolist():
            if lapse[k] > 1.0:
                self.simulators[k].feed_length()  # the length grows by time-lapse times what is fed
            else:
                self.simulators[k].follow_length()  # by what is fed
        (feed, air), seconds, parts = targets.T, self.config.period / lapse, []
        for duration in np.unique(seconds[stepped]) if stepped.any() else seconds[:1]:
            part = stepped & (seconds == duration)
            window = self.batch.advance(feed, air, float(duration), SAMPLE_PERIOD, part, keep_samples=True)
            parts.append((part, self._with_noise(window, part)))
        window = joined(parts)
        assert window.tension is not None
        finite = stepped & ~window.diverged
        return StepRecord(
            stepped=stepped,
            finite=finite,
            length_before=before,
            length_after=self.inserted_length,
            helix_length=self.helix_length,
            air=np.where(finite, air_used(self.config, air_before, window.air_supply_rate), 0.0),
            seconds=seconds,
            max_tension=np.nanmax(window.tension, axis=0),
            buckling_load=self.buckling_load,
            window=window,
            signals={k: self.meter.last(k) for k in np.flatnonzero(finite).tolist()},
            sensor_noise=normal_draws(rngs, finite, 2),
        )

    def branch(self, which: Sequence[int]) -> Self:
        """See ``Backend.branch``."""
        batch = self.batch.branch(which)  # checks the indices
        new = super().branch(which)
        new.batch, new.meter = batch, self.meter.branch(which)
        return new

    def _with_noise(self, window: Window, which: BoolArray) -> Window:
        """The window of probes ``which`` (N,), with "noise_to_signal" among its statistics."""
        assert window.radial is not None
        noise, finite = np.zeros(len(which)), np.flatnonzero(which & ~window.diverged)
        if len(finite):
            noise[finite] = 1.0 / self.meter.update(finite, window.radial[:, finite], window.feed_speed[finite]).snr
        return replace(window, statistics=window.statistics | {"noise_to_signal": noise})

    def _set_friction(self, which: BoolArray) -> None:
        """Set the mean friction over the inserted length, if friction drifts along the tube."""
        if self.config.friction_drift == 0.0:
            return
        fraction = self.inserted_length / self.helix_length
        for k in np.flatnonzero(which).tolist():
            friction = self.simulators[k].scene.contact.friction
            mean = friction * (1.0 + self.config.friction_drift * (float(fraction[k]) - 1.0))
            self.simulators[k].set_friction(min(mean, 1.0))
