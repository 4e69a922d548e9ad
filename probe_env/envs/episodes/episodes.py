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
from probe_env.envs.episodes.kpis import SIGNALS, Tally
from probe_env.envs.episodes.limits import check_simulable
from probe_env.envs.episodes.starts import DEFAULTS, EpisodeSettings, Starts, placed, settling
from probe_env.envs.task import (
    MEASURES,
    Ending,
    Outcome,
    TaskConfig,
    air_used,
    capped_square,
    ending,
    reward_terms,
    slack,
)
from probe_env.envs.task.passes import Counted, Period, passes_of
from probe_env.envs.task.safety import cost_terms
from probe_env.fidelity import resolve_fidelity
from probe_env.physics.closed_forms import buckling_load
from probe_env.physics.simulation.batch import SimulatorBatch
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.physics.simulation.simulator import Simulator
from probe_env.physics.simulation.window import Window
from probe_env.scene import Scene
from probe_env.settings import check_known, whole_steps

START_PERTURBATION: Final = 1e-7  # [m]
Terms = Mapping[str, FloatArray]


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
        self.start_action = config.action(feed_speed, air_supply_rate)
        if self.fidelity.time_lapse > 1.0 and not config.growing:
            raise ValueError(f"fidelity.time_lapse = {self.fidelity.time_lapse:g} needs a growing probe; here it is 1")
        self._dynamic_period = config.period / self.fidelity.time_lapse
        whole_steps("config.period / fidelity.time_lapse", self._dynamic_period, self.fidelity.time_step)
        scenes = [self.starts.build(Context(), {})] * count
        self.batch = SimulatorBatch(
            scenes, self.fidelity.method, self.fidelity.time_step, self.fidelity.nodes_per_pitch,
            threads=threads, **self._options(),
        )  # fmt: skip
        self.context = [Context()] * count
        self.tally = [Tally() for _ in range(count)]
        self.gauges = Gauges(config, self.batch)
        self.passes = passes_of(count, config, len(SIGNALS))
        self.rng = [np.random.default_rng(k) for k in range(count)]
        self.actions = np.tile(self.start_action, (count, 1))
        self.start = np.zeros(count)
        self.running = np.zeros(count, dtype=bool)
        self.window: Window | None = None

    def __len__(self) -> int:
        return len(self.tally)

    @property
    def observation(self) -> npt.NDArray[np.float32]:
        """(N, d) what is observed now; of episodes that diverged what was before."""
        return self.gauges.observation

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
            simulator = Simulator(
                scene, self.fidelity.method, self.fidelity.time_step, self.fidelity.nodes_per_pitch,
                seed=seed, **self._options(),
            )  # fmt: skip
            self.batch.replace(k, simulator)
            self.start[k] = simulator.inserted_length
            self.passes.begin(k, simulator.inserted_length, scene.tube.helix_length)
            self.tally[k] = Tally(detection=self.passes.detection[k])
            self.gauges.meter.forget(k)
            self.actions[k] = self.start_action
            simulator.hold_length()  # settling is not inspection
        self._set_friction(which)
        active = np.zeros(len(self), dtype=bool)
        active[list(which)] = True
        window = self._advance(None, self.config.settle_time, active)
        infos = {}
        for k in which:
            self.batch.simulators[k].feed_length()
            assert window.radial is not None
            self.tally[k].last_radial = window.radial[-2:, k].copy()
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
        chosen, actions = self._decided(actions, active)
        targets = self.config.targets(actions, self.may_stand) * self.passes.way[:, None]
        self._check_running(chosen)
        change = np.where(chosen[:, None], actions.astype(float) - self.actions, 0.0)
        self.actions = actions
        before, air_before = self.gauges.inserted(), self.gauges.air_supply_rate()
        self._set_friction(np.flatnonzero(chosen).tolist())
        window = self._advance(targets, self._dynamic_period, chosen)
        good = chosen & ~window.diverged
        period = self._period(good, window, before)
        counted = self.passes.count(period)
        air = np.where(good, air_used(self.config, air_before, window.air_supply_rate), 0.0)
        hanging = slack(self.config, window.statistics["tension_mean_n"], period.after) & (self.passes.way > 0.0)
        costs = self._costs(good, window, hanging)
        self._count(chosen, good, window, counted, air, hanging)
        end = self._ending(chosen, window, period)
        terms = reward_terms(self.config, self._outcome(period, counted, air, end), change)
        reward = np.where(chosen, sum(terms.values()), 0.0)
        self.gauges.read(self._measured(window), good, self.rng)
        self.running &= ~end.over
        self.window = window
        for k in np.flatnonzero(chosen):
            self.tally[k].reward += float(reward[k])
        parts = (terms, costs)
        infos = [self._step_info(k, window, parts, targets, end) if chosen[k] else {} for k in range(len(self))]
        return Step(self.observation.copy(), reward, end.terminated, end.truncated, infos)

    def _decided(self, actions: npt.ArrayLike, active: BoolArray | None) -> tuple[BoolArray, npt.NDArray[np.float32]]:
        """Which probes are stepped, and the actions (N, 2); of those that are not, the last ones."""
        count = len(self)
        chosen = np.ones(count, dtype=bool) if active is None else np.asarray(active, dtype=bool)
        given = np.asarray(actions, dtype=np.float32)
        if given.shape != (count, 2):
            raise ValueError(f"actions have shape {given.shape}; accepted is ({count}, 2): feed speed, air supply")
        return chosen, np.where(chosen[:, None], given, self.actions).astype(np.float32)

    def _check_running(self, chosen: BoolArray) -> None:
        ended = np.flatnonzero(chosen & ~self.running)
        if len(ended):
            raise RuntimeError(f"episode {ended[0]} has ended: call reset before step")

    def _advance(self, targets: FloatArray | None, duration: float, which: BoolArray) -> Window:
        """Advance some probes towards targets (N, 2), or on as they are, and hear what their motion leaves."""
        feed, air = (None, None) if targets is None else (targets[:, 0], targets[:, 1])
        window = self.batch.advance(feed, air, duration, SAMPLE_PERIOD, which, keep_samples=True)
        return self.gauges.listen(window, which & ~window.diverged)

    def _period(self, good: BoolArray, window: Window, before: FloatArray) -> Period:
        """What a period of the simulation is to the task."""
        statistics = window.statistics
        ratio = statistics[MEASURES[self.config.vibration_measure][0]] / self.config.limit
        rms = np.column_stack([statistics["radial_rms_m"], statistics["radial_acceleration_rms_m_per_s2"]])
        squares = capped_square(self.config, ratio)
        return Period(good, before, self.gauges.inserted(), window.feed_speed, squares, ratio <= 1.0, rms**2)

    def _ending(self, chosen: BoolArray, window: Window, period: Period) -> Ending:
        """How episodes end with a period."""
        slack_periods, time = (np.array([getattr(t, name) for t in self.tally]) for name in ("slack_periods", "time"))
        helix = self.gauges.helix_length()
        end = ending(self.config, period.after, helix, slack_periods, time, chosen, window.diverged)
        return self.passes.ended(end, period)

    def _outcome(self, period: Period, counted: Counted, air: FloatArray, end: Ending) -> Outcome:
        """What a period came to."""
        inspected = np.array([tally.inspected for tally in self.tally])
        left = self.passes.uninspected(period, self.gauges.helix_length(), inspected)
        left = np.where(end.over & self.config.growing, left, 0.0)
        seconds = np.full(len(self), self.config.period)
        return Outcome(counted.inspected, counted.squares, seconds, air, left, end.diverged)

    def _measured(self, window: Window) -> dict[str, FloatArray]:
        return self.gauges.measured(window, self.context, self.actions) | {"way": self.passes.way.copy()}

    def _step_info(
        self, k: int, window: Window, parts: tuple[Terms, Terms], targets: FloatArray, end: Ending
    ) -> dict[str, Any]:
        terms, costs = ({name: float(values[k]) for name, values in part.items()} for part in parts)
        info = self._info(k, window) | {
            "reward_terms": terms,
            "cost": sum(costs.values()),
            "cost_terms": costs,
            "target_feed_speed": float(targets[k, 0]),
            "target_air_supply_rate": float(targets[k, 1]),
            **end.failed(k),
        }
        if not self.running[k]:
            tube = float(self.gauges.helix_length()[k])
            length = tube - self.start[k] if self.config.growing else self.tally[k].inspected
            info["episode_kpis"] = self.tally[k].kpis(float(length), tube, end.kpis(k))
        return info

    def _check_simulable(self, k: int, scene: Scene) -> None:
        longest = scene.tube.helix_length if self.config.growing else scene.inserted_length
        try:
            check_simulable(scene, self.fidelity, longest, self.config.air_supply_rates[1])
        except ValueError as error:
            raise ValueError(f"environment {k}: {error}" if len(self) > 1 else str(error)) from error

    def _costs(self, good: BoolArray, window: Window, hanging: BoolArray) -> dict[str, FloatArray]:
        """Parts (N,) of the period's cost, which are tallied as well; 0 for probes that were not advanced."""
        assert window.tension is not None
        load = np.array([buckling_load(s.scene.probe) for s in self.batch.simulators])
        mean, greatest = window.statistics["tension_mean_n"], window.tension.max(axis=0)
        costs = {n: np.where(good, c, 0.0) for n, c in cost_terms(self.config, hanging, mean, greatest, load).items()}
        for k in np.flatnonzero(good):
            for name, values in costs.items():
                self.tally[k].costs[name] += float(values[k])
        return costs

    def _set_friction(self, which: Sequence[int]) -> None:
        """Give some probes the mean friction of the tube that they are in, where it drifts along it."""
        if self.config.friction_drift == 0.0:
            return
        share = self.gauges.inserted() / self.gauges.helix_length()
        for k in which:
            mean = self.context[k].friction * (1.0 + self.config.friction_drift * (float(share[k]) - 1.0))
            self.batch.simulators[k].set_friction(min(mean, 1.0))

    def _count(
        self, chosen: BoolArray, good: BoolArray, window: Window, counted: Counted, air: FloatArray, hanging: BoolArray
    ) -> None:
        """Add a period to the tallies."""
        assert window.radial is not None
        for k in np.flatnonzero(chosen):
            tally = self.tally[k]
            tally.time += self.config.period
            if not good[k]:
                continue
            inspected = float(counted.inspected[k])
            tally.add_period(inspected, float(counted.within[k]), float(air[k]))
            tally.add_drive(bool(hanging[k]), self.config.lost_drive_periods)
            back = self.passes.way[k] < 0.0
            rest = float(window.radial[:, k].mean()) if back else 0.0  # on the outer wall, or on its way there
            tally.add_signals(counted.measures[k].tolist(), window.radial[:, k], SAMPLE_PERIOD, rest)
            self.passes.hear(int(k), inspected, self._dynamic_period, self.gauges.meter.of(int(k)))

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
