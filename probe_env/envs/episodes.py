"""Episodes of N probes: simulator and task put together, once for single environments and for batches.

Environments only wrap this: a single one is a batch of one, so N environments equal N single ones.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Unpack

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray, FloatArray
from probe_env.design import RANGES
from probe_env.envs.contexts import Context
from probe_env.envs.kpis import SIGNALS, Tally
from probe_env.envs.limits import check_simulable
from probe_env.envs.starts import DEFAULTS, EpisodeSettings, Starts, placed, settling
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
    travel,
)
from probe_env.envs.task.observations import observe
from probe_env.envs.task.passes import Counted, Passes
from probe_env.envs.task.safety import cost_terms
from probe_env.fidelity import resolve_fidelity
from probe_env.inspection.found import Found
from probe_env.inspection.meter import Meter
from probe_env.physics.batch import SimulatorBatch, Window
from probe_env.physics.closed_forms import buckling_load
from probe_env.physics.simulator import Simulator
from probe_env.scene import Scene
from probe_env.settings import check_known, whole_steps

SAMPLE_PERIOD: Final = 1e-3  # [s]
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
        self.meter = Meter(config.sensor, count, SAMPLE_PERIOD)
        self.rng = [np.random.default_rng(k) for k in range(count)]
        self.actions = np.tile(self.start_action, (count, 1))
        self.observation = np.zeros((count, len(config.observations)), dtype=np.float32)
        self.observed = np.zeros((count, config.delay_periods + 1, len(config.observations)), dtype=np.float32)
        self.start = np.zeros(count)
        self.running = np.zeros(count, dtype=bool)
        self.window: Window | None = None
        self.passes = Passes(count, config, len(SIGNALS)) if config.returns else None

    def __len__(self) -> int:
        return len(self.tally)

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
            if self.passes is not None:
                self.passes.begin(k, simulator.inserted_length, scene.tube.helix_length)
            self.tally[k] = Tally(found=Found(self.config.sensor))
            self.meter.forget(k)
            self.actions[k] = self.start_action
            simulator.hold_length()  # settling is not inspection
        self._set_friction(which)
        active = np.zeros(len(self), dtype=bool)
        active[list(which)] = True
        window = self.batch.advance(None, None, self.config.settle_time, SAMPLE_PERIOD, active, keep_samples=True)
        window = self._listen(window, active & ~window.diverged)
        infos = {}
        for k in which:
            self.batch.simulators[k].feed_length()
            assert window.radial is not None
            self.tally[k].last_radial = window.radial[-2:, k].copy()
            self.running[k] = True  # one that diverged while settling ends in its first step
        self.observed[active] = self._observe(window, active)[active, None]
        self.observation[active] = self.observed[active, 0]
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
        targets = self.config.targets(actions, self.may_stand)
        if self.passes is not None:
            targets *= self.passes.way[:, None]
        ended = np.flatnonzero(chosen & ~self.running)
        if len(ended):
            raise RuntimeError(f"episode {ended[0]} has ended: call reset before step")
        change = np.where(chosen[:, None], actions.astype(float) - self.actions, 0.0)
        self.actions = actions
        before, air_before = self._inserted(), self._air_supply()
        self._set_friction(np.flatnonzero(chosen).tolist())
        window = self.batch.advance(
            targets[:, 0], targets[:, 1], self._dynamic_period, SAMPLE_PERIOD, chosen, keep_samples=True
        )
        good = chosen & ~window.diverged
        window = self._listen(window, good)
        after, length = self._inserted(), self._helix_length()
        air = np.where(good, air_used(self.config, air_before, window.air_supply_rate), 0.0)
        counted = self._counted(good, window, before, after)
        hanging = self._hanging(window)
        self._count(chosen, good, window, counted, air, hanging)
        slack_periods, time = (np.array([getattr(t, name) for t in self.tally]) for name in ("slack_periods", "time"))
        end = ending(self.config, after, length, slack_periods, time, chosen, window.diverged)
        if self.passes is not None:
            self.passes.turn(end.complete)
            end = end._replace(complete=self.passes.is_back(after, self.start) & good)
        over = end.terminated | end.truncated
        left = np.where(over & self.config.growing, self._uninspected(before, after, good), 0.0)
        seconds = np.full(len(self), self.config.period)
        outcome = Outcome(counted.inspected, counted.squares, seconds, air, left, end.diverged)
        terms = reward_terms(self.config, outcome, change)
        reward = np.where(chosen, sum(terms.values()), 0.0)
        costs = self._costs(good, window, hanging)
        observation = self._observe(window, good)[:, None]
        self._drop_out(observation[:, 0], good)
        late = np.concatenate([self.observed[:, 1:], observation], axis=1)
        self.observed[good] = late[good]  # a diverged probe keeps its last one
        self.observation[good] = late[good, 0]
        self.running &= ~over
        self.window = window
        for k in np.flatnonzero(chosen):
            self.tally[k].reward += float(reward[k])
        infos = [
            self._step_info(k, window, (terms, costs), targets, end) if chosen[k] else {} for k in range(len(self))
        ]
        return Step(self.observation.copy(), reward, end.terminated, end.truncated, infos)

    def _decided(self, actions: npt.ArrayLike, active: BoolArray | None) -> tuple[BoolArray, npt.NDArray[np.float32]]:
        """Which probes are stepped, and the actions (N, 2); of those that are not, the last ones."""
        count = len(self)
        chosen = np.ones(count, dtype=bool) if active is None else np.asarray(active, dtype=bool)
        given = np.asarray(actions, dtype=np.float32)
        if given.shape != (count, 2):
            raise ValueError(f"actions have shape {given.shape}; accepted is ({count}, 2): feed speed, air supply")
        return chosen, np.where(chosen[:, None], given, self.actions).astype(np.float32)

    def _observe(self, window: Window, which: BoolArray) -> npt.NDArray[np.float32]:
        """Observation (N, d), with new sensor noise for some probes; of the others the rows mean nothing."""
        noise = np.zeros((len(self), 2))
        for k in np.flatnonzero(which):
            noise[k] = self.rng[k].normal(size=2)
        return observe(self.config, self._measured(window), noise)

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
            "diverged": bool(end.diverged[k]),
            "lost_drive": bool(end.lost_drive[k]),
        }
        if not self.running[k]:
            tally = self.tally[k]
            length = self._helix_length()[k] - self.start[k] if self.config.growing else tally.inspected
            tube = float(self._helix_length()[k])
            how = (bool(end.diverged[k]), bool(end.lost_drive[k]), bool(end.complete[k]))
            info["episode_kpis"] = tally.kpis(float(length), tube, *how)
        return info

    def _check_simulable(self, k: int, scene: Scene) -> None:
        longest = scene.tube.helix_length if self.config.growing else scene.inserted_length
        try:
            check_simulable(scene, self.fidelity, longest, self.config.air_supply_rates[1])
        except ValueError as error:
            raise ValueError(f"environment {k}: {error}" if len(self) > 1 else str(error)) from error

    def _counted(self, good: BoolArray, window: Window, before: FloatArray, after: FloatArray) -> Counted:
        """What a period adds to what is inspected."""
        statistics = window.statistics
        ratio = statistics[MEASURES[self.config.vibration_measure][0]] / self.config.limit
        rms = np.column_stack([statistics["radial_rms_m"], statistics["radial_acceleration_rms_m_per_s2"]])
        squares = capped_square(self.config, ratio)
        if self.passes is not None:
            return self.passes.count(good, after, squares, ratio <= 1.0, rms**2)
        inspected = np.where(good, travel(self.config, before, after, window.feed_speed), 0.0)
        within = np.where(ratio <= 1.0, inspected, 0.0)
        return Counted(inspected, inspected * squares, within, inspected[:, None] * rms**2)

    def _uninspected(self, before: FloatArray, after: FloatArray, good: BoolArray) -> FloatArray:
        """(N,) what is left to inspect [m], where the length grows."""
        length = self._helix_length()
        if self.passes is not None and self.config.inspects == "back":
            return np.asarray(length - self.start - np.array([tally.inspected for tally in self.tally]))
        if self.passes is not None:
            return np.asarray(length - self.passes.reached)
        return length - np.where(good, after, before)  # what passed in a period that diverged was not inspected

    def _hanging(self, window: Window) -> BoolArray:
        """(N,) whether too little tension drives a probe."""
        hanging = slack(self.config, window.statistics["tension_mean_n"], self._inserted())
        if self.passes is not None:
            hanging &= self.passes.way > 0.0  # the air drives it out as well, but it is drawn
        return hanging

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

    def _drop_out(self, observation: npt.NDArray[np.float32], which: BoolArray) -> None:
        """Hold what drops out in observations (N, d) of some probes at what was measured before."""
        if self.config.sensor_dropout == 0.0:
            return
        columns = [k for k, name in enumerate(self.config.observations) if name in ("rf_noise", "root_tension")]
        for k in np.flatnonzero(which):
            if self.rng[k].random() < self.config.sensor_dropout:
                observation[k, columns] = self.observed[k, -1, columns]

    def _set_friction(self, which: Sequence[int]) -> None:
        """Give some probes the mean friction of the tube that they are in, where it drifts along it."""
        if self.config.friction_drift == 0.0:
            return
        share = self._inserted() / self._helix_length()
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
            tally.inspected += float(counted.inspected[k])
            tally.within_limit += float(counted.within[k])
            tally.air += float(air[k])
            tally.slack_periods = tally.slack_periods + 1 if hanging[k] else 0
            tally.lost_drive_events += tally.slack_periods == self.config.lost_drive_periods
            back = self.passes is not None and self.passes.way[k] < 0.0
            rest = float(window.radial[:, k].mean()) if back else 0.0  # on the outer wall, or on its way there
            tally.add_signals(counted.measures[k].tolist(), window.radial[:, k], SAMPLE_PERIOD, rest)
            tally.found.add(float(counted.inspected[k]), *self.meter.of(int(k)))

    def _listen(self, window: Window, good: BoolArray) -> Window:
        """The window with what its motion leaves of the signal-to-noise; 0 for probes that were not advanced."""
        assert window.radial is not None
        noise = np.zeros(len(self))
        which = np.flatnonzero(good)
        if len(which):
            noise[which] = 1.0 / self.meter.listen(which, window.radial[:, which], window.feed_speed[which]).snr
        return replace(window, statistics=window.statistics | {"noise_to_signal": noise})

    def _options(self) -> dict[str, Any]:
        return {
            "growing": self.config.growing,
            "time_lapse": self.fidelity.time_lapse if self.config.growing else 1.0,
            "ramp": self.config.ramp,
            "air_lag": self.config.air_lag,
            "perturbation": START_PERTURBATION,
        }

    def _inserted(self) -> FloatArray:
        """(N,) cable in the helix, not more than it is long [m]."""
        return np.array([min(s.inserted_length, s.scene.tube.helix_length) for s in self.batch.simulators])

    def _helix_length(self) -> FloatArray:
        """(N,) [m]."""
        return np.array([s.scene.tube.helix_length for s in self.batch.simulators])

    def _air_supply(self) -> FloatArray:
        """(N,) [m3/s]."""
        return np.array([s.air_supply_rate for s in self.batch.simulators])

    def _measured(self, window: Window) -> dict[str, FloatArray]:
        inserted = self._inserted()
        fields = {name: np.array([getattr(c, name) for c in self.context]) for name in Context.model_fields}
        probes = [s.scene.probe for s in self.batch.simulators]
        felt = dict(window.statistics)
        if self.config.vibration_measure == "snr":  # then the eddy-current noise is that of the flaw's band
            felt["radial_rms_m"] = self.config.sensor.equivalent_rms(felt["noise_to_signal"])
        return {
            **felt,
            **fields,
            **{name: np.array([getattr(probe, name) for probe in probes]) for name in RANGES},
            "inserted_length": inserted,
            "remaining_length": self._helix_length() - inserted,
            "feed_speed": window.feed_speed,
            "air_supply_rate": window.air_supply_rate,
            "feed_action": self.actions[:, 0].astype(float),
            "air_action": self.actions[:, 1].astype(float),
            **({} if self.passes is None else {"way": self.passes.way.copy()}),
        }

    def _info(self, k: int | np.integer[Any], window: Window) -> dict[str, Any]:
        """Physical values of one probe, SI units."""
        inserted = min(self.batch.simulators[k].inserted_length, self.batch.simulators[k].scene.tube.helix_length)
        names = ("radial_rms_m", "radial_acceleration_rms_m_per_s2", "axial_rms_m", "tension_mean_n", "lift_off_share")
        noise = float(window.statistics["noise_to_signal"][k])
        return {
            "time": self.tally[k].time,
            "inserted_length": float(inserted),
            "inspected_length": self.tally[k].inspected,
            "feed_speed": float(window.feed_speed[k]),
            "air_supply_rate": float(window.air_supply_rate[k]),
            **{name: float(window.statistics[name][k]) for name in names},
            **({} if self.passes is None else {"way": float(self.passes.way[k])}),
            "snr": 1.0 / noise if noise > 0.0 else 0.0,
            "noise_rms_m": float(self.config.sensor.equivalent_rms(np.array(noise))),
        }
