"""Episodes of N probes: simulator and task put together, once for single environments and for batches.

Environments only wrap this: a single one is a batch of one, so N environments equal N single ones.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray, FloatArray
from probe_env.design import RANGES
from probe_env.envs.contexts import Context
from probe_env.envs.kpis import Tally
from probe_env.envs.limits import check_simulable
from probe_env.envs.starts import SETTLING, Contexts, Probes, Starts
from probe_env.envs.task import MEASURES, TaskConfig, observe, reward_terms
from probe_env.fidelity import Fidelity, resolve_fidelity
from probe_env.physics.batch import SimulatorBatch, Window
from probe_env.physics.simulator import Simulator
from probe_env.scene import Scene
from probe_env.settings import whole_steps

SAMPLE_PERIOD: Final = 1e-3  # [s]
START_PERTURBATION: Final = 1e-7  # [m]
END_TOLERANCE: Final = 1e-6  # [m]; actions are float32


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
        scene: what contexts and options change; default ``Scene()`` (table 2).
        fidelity: preset name, settings or a mapping of them, see ``fidelity.PRESETS``.
        contexts: "random", or the shipped list ("train", "validation", "test") that every reset draws from.
        feed_speed, air_supply_rate: of the settling before an episode [m/s], [m3/s].
        probes: "scene", or "random": every reset draws a ``Design``.
        threads: at most so many; default: all cores.

    Raises:
        ValueError: an argument is not valid.
    """

    def __init__(
        self,
        count: int,
        config: TaskConfig,
        scene: Scene | None = None,
        fidelity: str | Fidelity | Mapping[str, Any] = "standard",
        contexts: Contexts = "random",
        feed_speed: float = SETTLING[0],
        air_supply_rate: float = SETTLING[1],
        probes: Probes = "scene",
        threads: int | None = None,
    ) -> None:
        if count < 1:
            raise ValueError(f"num_envs = {count!r} is outside the accepted range 1 and more")
        self.config = config
        self.starts = Starts(config, scene or Scene(), contexts, probes, feed_speed, air_supply_rate)
        self.fidelity = resolve_fidelity(fidelity, self.starts.stiffest, config.growing)
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
        self.rng = [np.random.default_rng(k) for k in range(count)]
        self.actions = np.tile(self.start_action, (count, 1))
        self.observation = np.zeros((count, len(config.observations)), dtype=np.float32)
        self.start = np.zeros(count)
        self.running = np.zeros(count, dtype=bool)
        self.window: Window | None = None

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
            self.tally[k] = Tally()
            self.actions[k] = self.start_action
            simulator.drive.growth = 0.0  # settling is not inspection
        active = np.zeros(len(self), dtype=bool)
        active[list(which)] = True
        window = self.batch.advance(None, None, self.config.settle_time, SAMPLE_PERIOD, active, keep_samples=True)
        assert window.radial is not None
        noise = np.zeros((len(self), 2))
        infos = {}
        for k in which:
            simulator = self.batch.simulators[k]
            simulator.drive.growth = self.fidelity.time_lapse if self.config.growing else 0.0
            self.tally[k].last_radial = window.radial[-2:, k].copy()
            noise[k] = self.rng[k].normal(size=2)
            self.running[k] = True  # one that diverged while settling ends in its first step
        observation = observe(self.config, self._measured(window), noise)
        for k in which:
            self.observation[k] = observation[k]
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
        count, config = len(self), self.config
        chosen = np.ones(count, dtype=bool) if active is None else np.asarray(active, dtype=bool)
        actions = np.asarray(actions, dtype=np.float32)
        if actions.shape != (count, 2):
            raise ValueError(f"actions have shape {actions.shape}; accepted is ({count}, 2): feed speed, air supply")
        actions = np.where(chosen[:, None], actions, self.actions)
        targets = config.targets(actions)
        ended = np.flatnonzero(chosen & ~self.running)
        if len(ended):
            raise RuntimeError(f"episode {ended[0]} has ended: call reset before step")
        change = np.where(chosen[:, None], actions.astype(float) - self.actions, 0.0)
        self.actions = np.where(chosen[:, None], actions, self.actions).astype(np.float32)
        before, air_before = self._inserted(), np.array([s.air_supply_rate for s in self.batch.simulators])
        window = self.batch.advance(
            targets[:, 0], targets[:, 1], self._dynamic_period, SAMPLE_PERIOD, chosen, keep_samples=True
        )
        diverged = window.diverged & chosen
        good = chosen & ~diverged
        after = self._inserted()
        length = np.array([s.scene.tube.helix_length for s in self.batch.simulators])
        travel = np.where(good, after - before, 0.0)
        if not config.growing:
            travel = np.where(good, window.feed_speed * config.period, 0.0)
        air = np.where(good, 0.5 * (air_before + window.air_supply_rate) * config.period, 0.0)
        ratio = window.statistics[MEASURES[config.vibration_measure][0]] / config.limit
        self._count(chosen, good, window, travel, ratio, air)
        complete = good & (after >= length - END_TOLERANCE) & config.growing
        lost = np.array([t.lost_drive_run >= config.lost_drive_periods for t in self.tally]) & good & ~complete
        terminated = complete | lost | diverged
        out_of_time = np.array([t.time >= config.time_limit - 1e-9 for t in self.tally])
        truncated = chosen & out_of_time & ~terminated
        reached = np.where(good, after, before)  # what passed in a period that diverged was not inspected
        left = np.where(terminated | truncated, length - reached, 0.0) if config.growing else np.zeros(count)
        terms = reward_terms(config, travel, ratio, air, change, left, diverged)
        reward = np.where(chosen, sum(terms.values()), 0.0)
        noise = np.zeros((count, 2))
        for k in np.flatnonzero(good):
            noise[k] = self.rng[k].normal(size=2)
        observation = observe(config, self._measured(window), noise)
        self.observation[good] = observation[good]  # a diverged probe keeps its last one
        infos: list[dict[str, Any]] = [{} for _ in range(count)]
        self.running &= ~(terminated | truncated)
        for k in np.flatnonzero(chosen):
            self.tally[k].reward += float(reward[k])
            infos[k] = self._info(k, window) | {
                "reward_terms": {name: float(values[k]) for name, values in terms.items()},
                "target_feed_speed": float(targets[k, 0]),
                "target_air_supply_rate": float(targets[k, 1]),
                "diverged": bool(diverged[k]),
                "lost_drive": bool(lost[k]),
            }
            if terminated[k] or truncated[k]:
                total = float(length[k] - self.start[k]) if config.growing else self.tally[k].inspected
                infos[k]["episode_kpis"] = self.tally[k].kpis(
                    total, bool(diverged[k]), bool(lost[k]), bool(complete[k])
                )
        self.window = window
        return Step(self.observation.copy(), reward, terminated, truncated, infos)

    def _check_simulable(self, k: int, scene: Scene) -> None:
        longest = scene.tube.helix_length if self.config.growing else scene.inserted_length
        try:
            check_simulable(scene, self.fidelity, longest, self.config.air_supply_rates[1])
        except ValueError as error:
            raise ValueError(f"environment {k}: {error}" if len(self) > 1 else str(error)) from error

    def _count(
        self, chosen: BoolArray, good: BoolArray, window: Window, travel: FloatArray, ratio: FloatArray, air: FloatArray
    ) -> None:
        """Add a period to the tallies."""
        assert window.radial is not None
        tension, inserted = window.statistics["tension_mean_n"], self._inserted()
        for k in np.flatnonzero(chosen):
            tally = self.tally[k]
            tally.time += self.config.period
            if not good[k]:
                continue
            tally.inspected += float(travel[k])
            tally.within_limit += float(travel[k]) if ratio[k] <= 1.0 else 0.0
            tally.air += float(air[k])
            slack = tension[k] < self.config.required_tension and inserted[k] >= self.config.lost_drive_from
            tally.lost_drive_run = tally.lost_drive_run + 1 if slack else 0
            tally.lost_drive_events += tally.lost_drive_run == self.config.lost_drive_periods
            rms = {
                "radial": float(window.statistics["radial_rms_m"][k]),
                "radial_acceleration": float(window.statistics["radial_acceleration_rms_m_per_s2"][k]),
            }
            tally.add_signals(float(travel[k]), rms, window.radial[:, k], SAMPLE_PERIOD)

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

    def _measured(self, window: Window) -> dict[str, FloatArray]:
        inserted = self._inserted()
        length = np.array([s.scene.tube.helix_length for s in self.batch.simulators])
        fields = {name: np.array([getattr(c, name) for c in self.context]) for name in Context.model_fields}
        probes = [s.scene.probe for s in self.batch.simulators]
        return {
            **window.statistics,
            **fields,
            **{name: np.array([getattr(probe, name) for probe in probes]) for name in RANGES},
            "inserted_length": inserted,
            "remaining_length": length - inserted,
            "feed_speed": window.feed_speed,
            "air_supply_rate": window.air_supply_rate,
            "feed_action": self.actions[:, 0].astype(float),
            "air_action": self.actions[:, 1].astype(float),
        }

    def _info(self, k: int | np.integer[Any], window: Window) -> dict[str, Any]:
        """Physical values of one probe, SI units."""
        inserted = min(self.batch.simulators[k].inserted_length, self.batch.simulators[k].scene.tube.helix_length)
        names = ("radial_rms_m", "radial_acceleration_rms_m_per_s2", "axial_rms_m", "tension_mean_n", "lift_off_share")
        return {
            "time": self.tally[k].time,
            "inserted_length": float(inserted),
            "inspected_length": self.tally[k].inspected,
            "feed_speed": float(window.feed_speed[k]),
            "air_supply_rate": float(window.air_supply_rate[k]),
            **{name: float(window.statistics[name][k]) for name in names},
        }
