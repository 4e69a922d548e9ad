"""Episodes of N probes: simulator and task together.

Environments wrap this class. A single environment is a batch of one, so N environments equal N single ones.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple, Unpack

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray, FloatArray
from probe_env.design import RANGES
from probe_env.envs.contexts import Context
from probe_env.envs.episodes.limits import check_fidelity, check_start
from probe_env.envs.episodes.scoring import RoundTripScorer, Scorer, StepRecord
from probe_env.envs.episodes.starts import (
    DEFAULTS,
    EpisodeSampler,
    EpisodeSettings,
    resolve_settings,
    restored_on_error,
    settling,
)
from probe_env.envs.task import FAILURES, Score, TaskConfig, air_used, as_actions
from probe_env.envs.task.observations import SensorModel, normal_draws
from probe_env.fidelity import resolve_fidelity
from probe_env.inspection.snr import SnrEstimator
from probe_env.physics.closed_forms import buckling_load
from probe_env.physics.simulation.batch import SimulatorBatch
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.physics.simulation.simulator import Simulator
from probe_env.physics.simulation.window import Window, joined
from probe_env.scene import Scene
from probe_env.settings import check_keywords

START_PERTURBATION: Final = 1e-7  # [m]
IN_INFO: Final = (
    "radial_rms_m", "radial_acceleration_rms_m_per_s2", "axial_rms_m", "tension_mean_n", "lift_off_share",
)  # fmt: skip
"""Statistics of the period in ``info``."""


class Step(NamedTuple):
    """Result of a step of N probes; the info of a probe that was not stepped is empty."""

    observation: npt.NDArray[np.float32]
    reward: FloatArray
    terminated: BoolArray
    truncated: BoolArray
    infos: list[dict[str, Any]]


class Episodes:
    """N episodes side by side.

    Args:
        count: N.
        config: the task.
        threads: maximum number of threads; default: all cores.
        allow_standstill: whether the feed action may be the task's ``standstill``, for replays of logs.
        settings: see ``EpisodeSettings``.

    Attributes:
        window: motion in the last period; None before the first.
        running: (N,) whether the episode has begun and not ended.
        meter: estimator of the signal-to-noise.

    Raises:
        ValueError: an argument is not valid.
        TypeError: unknown setting.
    """

    def __init__(
        self,
        count: int,
        config: TaskConfig,
        *,
        threads: int | None = None,
        allow_standstill: bool = False,
        **settings: Unpack[EpisodeSettings],
    ) -> None:
        check_keywords(type(self).__name__, settings, DEFAULTS)
        config, settings = resolve_settings({}, config, settings)
        arguments = DEFAULTS | settings
        if count < 1:
            raise ValueError(f"num_envs = {count!r} is outside the accepted range 1 and more")
        self.config, self.allow_standstill = config, allow_standstill
        feed_speed, air_supply_rate = settling(config, settings)
        self.sampler = EpisodeSampler(
            config, arguments["contexts"], arguments["probes"], feed_speed, air_supply_rate, arguments["in_turn"]
        )
        self.fidelity = resolve_fidelity(arguments["fidelity"], self.sampler.stiffest, config.growing, config.returns)
        check_fidelity(self.fidelity, config)
        self.start_action = config.action(feed_speed, air_supply_rate)
        scenes = [self.sampler.build(Context(), {})] * count
        self.batch = SimulatorBatch(scenes, *self.fidelity.numerics, threads=threads, **self._options())
        self.scorer = (RoundTripScorer if config.returns else Scorer)(count, config)
        self.meter, self.sensors = SnrEstimator(config.sensor, count, SAMPLE_PERIOD), SensorModel(config, count)
        self.context = [Context()] * count
        self.rng = [np.random.default_rng(k) for k in range(count)]
        self.episode = np.zeros(count, dtype=int)
        self.actions = np.tile(self.start_action, (count, 1))
        self.running = np.zeros(count, dtype=bool)
        self.window: Window | None = None

    def __len__(self) -> int:
        return len(self.context)

    def __repr__(self) -> str:
        return f"{len(self)} x {self.config!r}, {self.fidelity!r}"

    @property
    def kernel_seconds(self) -> float:
        """Time spent in the kernels so far [s], over all threads."""
        return self.batch.kernel_seconds

    @property
    def observation(self) -> npt.NDArray[np.float32]:
        """(N, d) current observation; of a diverged episode the last one before the divergence."""
        return self.sensors.observation

    @property
    def direction(self) -> FloatArray:
        """(N,) 1 on insertion, -1 on withdrawal."""
        return self.scorer.direction

    @property
    def inserted_length(self) -> FloatArray:
        """(N,) length of cable in the helix, at most the helix length [m]."""
        return np.array([s.length_in_helix for s in self.batch.simulators])

    @property
    def helix_length(self) -> FloatArray:
        """(N,) [m]."""
        return np.array([s.scene.tube.helix_length for s in self.batch.simulators])

    def time_lapse(self, targets: FloatArray) -> FloatArray:
        """(N,) time-lapse factor of a period with targets (N, 2): only period / factor of the motion is simulated.

        Vibration on insertion is nearly steady, so metres may be skipped. On withdrawal the motion is a transient of
        the turn or of a change of feed, which time-lapse would spread over more metres.
        """
        now = [simulator.feed_speed for simulator in self.batch.simulators]
        return np.where(self.direction > 0.0, self.fidelity.time_lapse_of(now, targets[:, 0]), 1.0)

    def fork(self, which: Sequence[int]) -> Episodes:
        """Copies of the episodes ``which`` in their current state, for planning; an index may occur more than once.

        Rewards and endings are those of the originals; metrics start from zero.

        Raises:
            ValueError: ``which`` is empty or has an index out of range.
        """
        new = copy.copy(self)
        new.batch = self.batch.branch(which)
        new.scorer, new.meter, new.sensors = self.scorer.fork(which), self.meter.fork(which), self.sensors.fork(which)
        new.context, new.rng = [self.context[k] for k in which], [copy.deepcopy(self.rng[k]) for k in which]
        new.actions, new.running, new.window = self.actions[list(which)], self.running[list(which)], None
        new.episode = self.episode[list(which)]
        return new

    def reset(
        self,
        which: Sequence[int],
        rngs: Mapping[int, np.random.Generator],
        options: Mapping[int, Mapping[str, Any] | None] | None = None,
    ) -> tuple[npt.NDArray[np.float32], dict[int, dict[str, Any]]]:
        """Start new episodes of some probes, settled for ``config.settle_time``; (N, d) observation and their infos.

        Options of a probe: any field of ``Context``; "context": a whole context; "probe": changed fields of
        ``scene.Probe``; "carrier_length" [m] if the length is constant.

        Raises:
            ValueError: an option is unknown or not valid, or this fidelity or the model cannot simulate it, see
                ``limits``; nothing has been changed.
        """
        prepared: dict[int, tuple[Context, Scene]] = {}
        # a new generator, of a reset with a seed, begins at the first tube again
        episodes = {k: self.episode[k] + 1 if rngs[k] is self.rng[k] else 0 for k in which}
        with restored_on_error(rngs[k] for k in which):
            for k in which:
                prepared[k] = self.sampler.draw(rngs[k], (options or {}).get(k) or {}, k + episodes[k] * len(self))
                try:
                    check_start(prepared[k][1], self.fidelity, self.config)
                except ValueError as error:
                    raise ValueError(f"environment {k}: {error}" if len(self) > 1 else str(error)) from error
        for k, (context, scene) in prepared.items():
            self.rng[k], self.episode[k], self.context[k] = rngs[k], episodes[k], context
            seed = int(rngs[k].integers(2**31))
            simulator = Simulator(scene, *self.fidelity.numerics, seed=seed, **self._options())
            self.batch.replace(k, simulator)
            self.scorer.begin(k, simulator.inserted_length, scene.tube.helix_length)
            self.meter.reset(k)
            self.actions[k] = self.start_action
            simulator.hold_length()  # settling does not count as inspection
        self._set_friction(which)
        active = np.zeros(len(self), dtype=bool)
        active[list(which)] = True
        settled = self.batch.advance(None, None, self.config.settle_time, SAMPLE_PERIOD, active, keep_samples=True)
        window = self._with_noise(settled, active)
        infos = {}
        for k in which:
            self.batch.simulators[k].feed_length()
            self.scorer.metrics[k].last_radial = window.radial_of(k)[-2:].copy()
            self.running[k] = True  # if it diverged while settling, it ends in its first step
        self.sensors.begin(self._measured(window), active, normal_draws(self.rng, active, 2))
        for k in which:
            infos[k] = self._info(k, window) | {
                "context": self.context[k].model_dump(),
                "probe": self.batch.simulators[k].scene.probe.model_dump(),
                "diverged": bool(window.diverged[k]),
            }
        return self.observation.copy(), infos

    def step(self, actions: npt.ArrayLike, active: BoolArray | None = None) -> Step:
        """One control period of the active probes (default: all).

        Raises:
            ValueError: an action is not valid; nothing has been advanced.
            RuntimeError: an active episode has ended and was not reset.
        """
        stepped = np.ones(len(self), dtype=bool) if active is None else np.asarray(active, dtype=bool)
        requested = as_actions(actions, (len(self), 2)).astype(np.float32)
        # probes that are not stepped keep their last action
        requested = np.where(stepped[:, None], requested, self.actions).astype(np.float32)
        targets = self.config.targets(requested, self.allow_standstill) * self.direction[:, None]
        check_running(self.running, stepped)
        record = self._simulate(stepped, requested, targets)
        scored = self.scorer.score(record)
        noise = normal_draws(self.rng, record.good, 2)
        self.sensors.update(self._measured(record.window), record.good, noise, self.rng)
        self.running &= ~(scored.terminated | scored.truncated)
        infos = [self._step_info(k, record, scored, targets) if stepped[k] else {} for k in range(len(self))]
        return Step(self.observation.copy(), scored.reward, scored.terminated, scored.truncated, infos)

    def _simulate(self, stepped: BoolArray, actions: npt.NDArray[np.float32], targets: FloatArray) -> StepRecord:
        """Advance some probes by a control period towards targets (N, 2) [m/s], [m3/s]."""
        change = np.where(stepped[:, None], actions.astype(float) - self.actions, 0.0)
        self.actions = actions
        before, air_before = self.inserted_length, np.array([s.air_supply_rate for s in self.batch.simulators])
        self._set_friction(np.flatnonzero(stepped).tolist())
        lapse = self.time_lapse(targets)
        for k in np.flatnonzero(stepped):
            simulator = self.batch.simulators[k]
            if lapse[k] > 1.0:
                simulator.feed_length()  # the length grows by time-lapse times what is fed
            else:
                simulator.follow_length()  # by what is fed
        seconds, parts = self.config.period / lapse, []
        for duration in np.unique(seconds[stepped]) if stepped.any() else seconds[:1]:
            part = stepped & (seconds == duration)
            feed, air = targets.T
            window = self.batch.advance(feed, air, float(duration), SAMPLE_PERIOD, part, keep_samples=True)
            parts.append((part, self._with_noise(window, part)))
        self.window = window = joined(parts)
        good = stepped & ~window.diverged
        return StepRecord(
            stepped=stepped,
            good=good,
            before=before,
            after=self.inserted_length,
            helix_length=self.helix_length,
            air=np.where(good, air_used(self.config, air_before, window.air_supply_rate), 0.0),
            seconds=seconds,
            action_change=change,
            buckling_load=np.array([buckling_load(s.scene.probe) for s in self.batch.simulators]),
            window=window,
            signals={k: self.meter.last(k) for k in np.flatnonzero(good).tolist()},
        )

    def _with_noise(self, window: Window, which: BoolArray) -> Window:
        """The window of probes ``which`` (N,), with "noise_to_signal" among its statistics."""
        assert window.radial is not None
        noise, good = np.zeros(len(self)), np.flatnonzero(which & ~window.diverged)
        if len(good):
            noise[good] = 1.0 / self.meter.update(good, window.radial[:, good], window.feed_speed[good]).snr
        return replace(window, statistics=window.statistics | {"noise_to_signal": noise})

    def _measured(self, window: Window) -> dict[str, FloatArray]:
        """Sensor values before noise, (N,) each in SI units, see ``observe``."""
        inserted, statistics = self.inserted_length, dict(window.statistics)
        if self.config.vibration_measure == "snr":  # then it is the noise in the band of the flaw
            statistics["radial_rms_m"] = self.config.sensor.equivalent_rms(statistics["noise_to_signal"])
        probes = [s.scene.probe for s in self.batch.simulators]
        return {
            **statistics,
            **{name: np.array([getattr(c, name) for c in self.context]) for name in Context.model_fields},
            **{name: np.array([getattr(probe, name) for probe in probes]) for name in RANGES},
            "inserted_length": inserted,
            "remaining_length": self.helix_length - inserted,
            "feed_speed": window.feed_speed,
            "air_supply_rate": window.air_supply_rate,
            "previous_feed_action": self.actions[:, 0].astype(float),
            "previous_air_action": self.actions[:, 1].astype(float),
            "way": self.direction,
        }

    def _info(self, k: int, window: Window) -> dict[str, Any]:
        """Physical values of one probe for ``info``, SI units."""
        metrics, noise = self.scorer.metrics[k], float(window.statistics["noise_to_signal"][k])
        return {
            "time": metrics.time,
            "inspected_length": metrics.inspected,
            **({"way": float(self.direction[k])} if self.config.returns else {}),
            "inserted_length": float(self.batch.simulators[k].length_in_helix),
            "feed_speed": float(window.feed_speed[k]),
            "air_supply_rate": float(window.air_supply_rate[k]),
            **{name: float(window.statistics[name][k]) for name in IN_INFO},
            "snr": 1.0 / noise if noise > 0.0 else 0.0,
            "noise_rms_m": float(self.config.sensor.equivalent_rms(np.array(noise))),
        }

    def _step_info(self, k: int, record: StepRecord, scored: Score, targets: FloatArray) -> dict[str, Any]:
        costs = {name: float(values[k]) for name, values in scored.costs.items()}
        info = self._info(k, record.window) | {
            "reward_terms": {name: float(values[k]) for name, values in scored.rewards.items()},
            "cost": sum(costs.values()),
            "cost_terms": costs,
            "target_feed_speed": float(targets[k, 0]),
            "target_air_supply_rate": float(targets[k, 1]),
            **{name: bool(scored.endings[name][k]) for name in FAILURES},
        }
        if not self.running[k]:
            info["episode_kpis"] = self.scorer.kpis(k, float(record.helix_length[k]), scored)
        return info

    def _set_friction(self, which: Sequence[int]) -> None:
        """Set the mean friction over the inserted length, if friction drifts along the tube."""
        if self.config.friction_drift == 0.0:
            return
        share = self.inserted_length / self.helix_length
        for k in which:
            mean = self.context[k].friction * (1.0 + self.config.friction_drift * (float(share[k]) - 1.0))
            self.batch.simulators[k].set_friction(min(mean, 1.0))

    def _options(self) -> dict[str, Any]:
        return {
            "growing": self.config.growing,
            "time_lapse": self.fidelity.time_lapse if self.config.growing else 1.0,
            "ramp": self.config.ramp,
            "air_lag": self.config.air_lag,
            "perturbation": START_PERTURBATION,
        }


def check_running(running: BoolArray, stepped: BoolArray) -> None:
    """Raise RuntimeError if an episode (N,) to be stepped has ended."""
    if (stepped & ~running).any():
        raise RuntimeError(f"episode {np.flatnonzero(stepped & ~running)[0]} has ended: call reset before step")
