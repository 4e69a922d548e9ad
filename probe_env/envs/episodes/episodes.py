"""Episodes of N probes: simulator and task put together, once for single environments and for batches.

Environments only wrap this: a single one is a batch of one, so N environments equal N single ones.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Unpack

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.contexts import Context
from probe_env.envs.episodes.gauges import Gauges
from probe_env.envs.episodes.judge import Judge, Score
from probe_env.envs.episodes.limits import check_simulable
from probe_env.envs.episodes.starts import DEFAULTS, EpisodeSettings, Starts, placed, settling
from probe_env.envs.task import FAILURES, MEASURES, TaskConfig, air_used, capped_square
from probe_env.envs.task.passes import StepRecord
from probe_env.fidelity import resolve_fidelity
from probe_env.physics.closed_forms import buckling_load
from probe_env.physics.simulation.batch import SimulatorBatch
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.physics.simulation.simulator import Simulator
from probe_env.physics.simulation.window import Window, joined
from probe_env.scene import Scene
from probe_env.settings import check_known, whole_steps

START_PERTURBATION: Final = 1e-7  # [m]


@dataclass(frozen=True)
class Step:
    """Outcome of one period for N probes; ``infos`` has a dictionary for each that was stepped, else an empty one."""

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
        threads: at most so many; default: all cores.
        may_stand: whether the feed action may be the task's ``standing``, which replays of logs choose.
        settings: see ``EpisodeSettings``.

    Raises:
        ValueError: an argument is not valid.
        TypeError: there is no such setting.
    """

    def __init__(
        self,
        count: int,
        config: TaskConfig,
        *,
        threads: int | None = None,
        may_stand: bool = False,
        **settings: Unpack[EpisodeSettings],
    ) -> None:
        self.may_stand = may_stand
        check_known(type(self).__name__, settings, DEFAULTS)
        config, settings = placed({}, config, settings)
        given = DEFAULTS | settings
        if count < 1:
            raise ValueError(f"num_envs = {count!r} is outside the accepted range 1 and more")
        self.config = config
        feed_speed, air_supply_rate = settling(config, settings)
        self.starts = Starts(config, given["contexts"], given["probes"], feed_speed, air_supply_rate)
        self.fidelity = resolve_fidelity(given["fidelity"], self.starts.stiffest, config.growing, config.returns)
        if not self.fidelity.simulates:
            raise ValueError("fidelity = 'surrogate' simulates no motion, which is asked for here: give fast or finer")
        self.start_action = config.action(feed_speed, air_supply_rate)
        if self.fidelity.time_lapse > 1.0 and not config.growing:
            raise ValueError(f"fidelity.time_lapse = {self.fidelity.time_lapse:g} needs a growing probe; here it is 1")
        whole_steps(
            "config.period / fidelity.time_lapse", config.period / self.fidelity.time_lapse, self.fidelity.time_step
        )
        if config.returns or self.fidelity.steady_feed is not None:
            whole_steps("config.period", config.period, self.fidelity.time_step)
        scenes = [self.starts.build(Context(), {})] * count
        self.batch = SimulatorBatch(scenes, *self.fidelity.numerics, threads=threads, **self._options())
        self.context = [Context()] * count
        self.gauges = Gauges(config, self.batch)
        self.judge = Judge(count, config)
        self.tally, self.passes = self.judge.tally, self.judge.passes
        self.rng = [np.random.default_rng(k) for k in range(count)]
        self.actions = np.tile(self.start_action, (count, 1))
        self.running = np.zeros(count, dtype=bool)
        self.window: Window | None = None

    def __len__(self) -> int:
        return len(self.tally)

    @property
    def kernel_seconds(self) -> float:
        """Time spent in the kernels so far [s], over all threads."""
        return self.batch.kernel_seconds

    @property
    def observation(self) -> npt.NDArray[np.float32]:
        """(N, d) what is observed now; of episodes that diverged what was before."""
        return self.gauges.observation

    def time_lapse(self, targets: FloatArray) -> FloatArray:
        """(N,) how many times faster than the motion's clock the length changes in a period with targets (N, 2).

        What rings on the way in is nearly steady, so metres may be left out. On the way back the motion is what the
        turn or a change of the feed has left; time-lapse would spread it over so many times as many metres.
        """
        now = [simulator.feed_speed for simulator in self.batch.simulators]
        return np.where(self.passes.way > 0.0, self.fidelity.time_lapse_of(now, targets[:, 0]), 1.0)

    def fork(self, which: Sequence[int]) -> Episodes:
        """Copies of some episodes in their present state, each as often as it is named: what a controller tries out.

        They are rewarded and end as the episodes themselves would; their figures count from here on.

        Raises:
            ValueError: ``which`` is empty or names no episode of these.
        """
        new = copy.copy(self)
        new.batch = self.batch.branch(which)
        new.gauges, new.judge = self.gauges.fork(which, new.batch), self.judge.fork(which)
        new.tally, new.passes = new.judge.tally, new.judge.passes
        new.context, new.rng = [self.context[k] for k in which], [copy.deepcopy(self.rng[k]) for k in which]
        new.actions, new.running, new.window = self.actions[list(which)], self.running[list(which)], None
        return new

    def reset(
        self,
        which: Sequence[int],
        rngs: Mapping[int, np.random.Generator],
        options: Mapping[int, Mapping[str, Any] | None] | None = None,
    ) -> tuple[npt.NDArray[np.float32], dict[int, dict[str, Any]]]:
        """Start new episodes of some probes, settled for ``config.settle_time``; (N, d) observation and their infos.

        Options of a probe: any field of ``Context``; "context": a whole one; "probe": fields of ``scene.Probe``
        to change; "carrier_length" [m] where the length is constant.

        Raises:
            ValueError: an option is not known or not valid, or asks for what this fidelity or the model cannot
                simulate, see ``limits``; nothing has been changed then.
        """
        prepared = {}
        for k in which:
            trial = copy.deepcopy(rngs[k])  # the generator itself moves on only if all is valid
            prepared[k] = self.starts.draw(trial, (options or {}).get(k) or {})
            self._check_simulable(k, prepared[k][1])
        for k, (context, scene) in prepared.items():
            rng = rngs[k]
            self.starts.draw(rng, {})
            seed = int(rng.integers(2**31))
            self.rng[k], self.context[k] = rng, context
            simulator = Simulator(scene, *self.fidelity.numerics, seed=seed, **self._options())
            self.batch.replace(k, simulator)
            self.judge.begin(k, simulator.inserted_length, scene.tube.helix_length)
            self.gauges.meter.reset(k)
            self.actions[k] = self.start_action
            simulator.hold_length()  # settling is not inspection
        self._set_friction(which)
        active = np.zeros(len(self), dtype=bool)
        active[list(which)] = True
        window = self._advance(None, np.full(len(self), self.config.settle_time), active)
        infos = {}
        for k in which:
            self.batch.simulators[k].feed_length()
            self.tally[k].last_radial = window.radial_of(k)[-2:].copy()
            self.running[k] = True  # one that diverged while settling ends in its first step
        self.gauges.begin(self._measured(window), active, self.rng)
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
            ValueError: an action is not valid; nothing has been advanced then.
            RuntimeError: an active episode has ended and was not reset.
        """
        count = len(self)
        chosen = np.ones(count, dtype=bool) if active is None else np.asarray(active, dtype=bool)
        given = np.asarray(actions, dtype=np.float32)
        if given.shape != (count, 2):
            raise ValueError(f"actions have shape {given.shape}; accepted is ({count}, 2): feed speed, air supply")
        actions = np.where(chosen[:, None], given, self.actions).astype(np.float32)
        targets = self.config.targets(actions, self.may_stand) * self.passes.way[:, None]
        if (chosen & ~self.running).any():
            raise RuntimeError(f"episode {np.flatnonzero(chosen & ~self.running)[0]} has ended: call reset before step")
        change = np.where(chosen[:, None], actions.astype(float) - self.actions, 0.0)
        self.actions = actions
        before, air_before = self.gauges.inserted(), self.gauges.air_supply_rate()
        self._set_friction(np.flatnonzero(chosen).tolist())
        lapse = self.time_lapse(targets)
        for k in np.flatnonzero(chosen):
            simulator = self.batch.simulators[k]
            (simulator.feed_length if lapse[k] > 1.0 else simulator.follow_length)()
        seconds = self.config.period / lapse
        self.window = window = self._advance(targets, seconds, chosen)
        record = self._record(chosen, before, air_before, seconds, change, window)
        load = np.array([buckling_load(s.scene.probe) for s in self.batch.simulators])
        score = self.judge.judge(record, window, self.gauges.meter, load)
        self.gauges.read(self._measured(window), record.good, self.rng)
        self.running &= ~score.end.over
        infos = [self._step_info(k, window, score, targets) if chosen[k] else {} for k in range(count)]
        return Step(self.observation.copy(), score.reward, score.end.terminated, score.end.truncated, infos)

    def _advance(self, targets: FloatArray | None, seconds: FloatArray, which: BoolArray) -> Window:
        """Advance some probes by (N,) seconds towards targets (N, 2), or on as they are, and hear their motion."""
        feed, air = (None, None) if targets is None else (targets[:, 0], targets[:, 1])
        parts = []
        for duration in np.unique(seconds[which]) if which.any() else seconds[:1]:
            part = which & (seconds == duration)
            window = self.batch.advance(feed, air, float(duration), SAMPLE_PERIOD, part, keep_samples=True)
            parts.append((part, self.gauges.listen(window, part & ~window.diverged)))
        return joined(parts)

    def _record(
        self,
        chosen: BoolArray,
        before: FloatArray,
        air_before: FloatArray,
        seconds: FloatArray,
        change: FloatArray,
        window: Window,
    ) -> StepRecord:
        config, statistics, good = self.config, window.statistics, chosen & ~window.diverged
        ratio = statistics[MEASURES[config.vibration_measure][0]] / config.limit
        rms = np.column_stack([statistics["radial_rms_m"], statistics["radial_acceleration_rms_m_per_s2"]])
        air = np.where(good, air_used(config, air_before, window.air_supply_rate), 0.0)
        return StepRecord(
            chosen, good, before, self.gauges.inserted(), self.gauges.helix_length(), window.feed_speed, air, seconds,
            change, capped_square(config, ratio), ratio <= 1.0, rms**2,
        )  # fmt: skip

    def _measured(self, window: Window) -> dict[str, FloatArray]:
        return self.gauges.measured(window, self.context, self.actions) | {"way": self.passes.way.copy()}

    def _step_info(self, k: int, window: Window, score: Score, targets: FloatArray) -> dict[str, Any]:
        terms, costs = (
            {name: float(values[k]) for name, values in part.items()} for part in (score.rewards, score.costs)
        )
        info = self._info(k, window) | {
            "reward_terms": terms,
            "cost": sum(costs.values()),
            "cost_terms": costs,
            "target_feed_speed": float(targets[k, 0]),
            "target_air_supply_rate": float(targets[k, 1]),
            **{name: bool(getattr(score.end, name)[k]) for name in FAILURES},
        }
        if not self.running[k]:
            info["episode_kpis"] = self.judge.kpis(k, float(self.gauges.helix_length()[k]), score.end)
        return info

    def check_tube(self, context: Context) -> None:
        """Raise ValueError if an episode in this tube with the scene's probe could not begin; nothing is simulated."""
        self._check_simulable(0, self.starts.build(context, {}))

    def _check_simulable(self, k: int, scene: Scene) -> None:
        longest = scene.tube.helix_length if self.config.growing else scene.inserted_length
        try:
            check_simulable(scene, self.fidelity, longest, self.config.air_supply_rates[1])
        except ValueError as error:
            raise ValueError(f"environment {k}: {error}" if len(self) > 1 else str(error)) from error

    def _set_friction(self, which: Sequence[int]) -> None:
        """Give some probes the mean friction of the tube that they are in, where it drifts along it."""
        if self.config.friction_drift == 0.0:
            return
        share = self.gauges.inserted() / self.gauges.helix_length()
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

    def _info(self, k: int | np.integer[Any], window: Window) -> dict[str, Any]:
        """Physical values of one probe, SI units."""
        way = {"way": float(self.passes.way[k])} if self.config.returns else {}
        tally = self.tally[k]
        return {"time": tally.time, "inspected_length": tally.inspected} | way | self.gauges.shows(int(k), window)
