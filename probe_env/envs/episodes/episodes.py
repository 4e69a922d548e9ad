"""Episodes of N probes: task and backend together.

Environments wrap this class. A single environment is a batch of one, so N environments equal N single ones.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, Unpack

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray, FloatArray, rows_of
from probe_env.design import RANGES
from probe_env.envs.contexts import Context
from probe_env.envs.episodes.backend import Backend, Simulated
from probe_env.envs.episodes.predicted import Predicted, check_task
from probe_env.envs.episodes.scoring import RoundTripScorer, Scorer
from probe_env.envs.episodes.starts import (
    DEFAULTS,
    EpisodeSampler,
    EpisodeSettings,
    resolve_settings,
    restored_on_error,
)
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.observations import SensorModel, normal_draws
from probe_env.envs.task.rules import FAILURES
from probe_env.envs.task.scales import as_actions
from probe_env.envs.vibration_map import VibrationMap, load_for, stored_map
from probe_env.fidelity import resolve_fidelity
from probe_env.physics.simulation.window import Window
from probe_env.scene import Scene
from probe_env.settings import check_keywords

IN_INFO: Final = (
    "radial_rms_m", "radial_acceleration_rms_m_per_s2", "axial_rms_m", "tension_mean_n", "lift_off_share",
)  # fmt: skip
"""Statistics of the period in ``info``, as far as the backend has them."""


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
        num_envs: N.
        config: the task, or changed fields.
        defaults: fields of the task that the environment changes.
        threads: maximum number of threads; default: all cores.
        allow_standstill: whether the feed action may be the task's ``standstill``, for replays of logs.
        caller: what errors about unknown settings name.
        settings: see ``EpisodeSettings``; "surrogate" predicts, every other fidelity simulates.

    Attributes:
        backend: what advances the probes.
        window: motion in the last period; None before the first.
        running: (N,) whether the episode has begun and not ended.
    """

    def __init__(
        self,
        num_envs: int,
        config: TaskConfig | Mapping[str, Any] | None = None,
        *,
        defaults: Mapping[str, Any] | None = None,
        threads: int | None = None,
        allow_standstill: bool = False,
        caller: str = "Episodes",
        **settings: Unpack[EpisodeSettings],
    ) -> None:
        self.config, settings = resolve_settings(defaults or {}, config, settings)
        check_keywords(caller, settings, ("config", *DEFAULTS))
        arguments, self.allow_standstill = DEFAULTS | settings, allow_standstill
        if num_envs < 1:
            raise ValueError(f"num_envs = {num_envs!r} is outside the accepted range 1 and more")
        self.sampler = EpisodeSampler(
            self.config, arguments["contexts"], arguments["probes"],
            arguments["feed_speed"], arguments["air_supply_rate"], arguments["in_turn"],
        )  # fmt: skip
        self.fidelity = resolve_fidelity(
            arguments["fidelity"], self.sampler.stiffest, self.config.growing, self.config.returns
        )
        self.start_action = self.config.action(self.sampler.feed_speed, self.sampler.air_supply_rate)
        self.backend: Backend
        if self.fidelity.simulates:
            scene = self.sampler.build(Context(), {})
            self.backend = Simulated(num_envs, self.config, self.fidelity, scene, threads)
        else:
            vibration = map_of(arguments["surrogate_map"], self.config.scene)
            check_task(self.config, arguments["probes"], vibration)
            self.backend = Predicted(num_envs, self.config, vibration)
        kind = RoundTripScorer if self.config.returns else Scorer
        self.scorer = kind(num_envs, self.config, self.backend.samples)
        self.sensors = SensorModel(self.config, num_envs)
        self.context = [Context()] * num_envs
        self.constants = {name: np.zeros(num_envs) for name in (*Context.model_fields, *RANGES)}
        self.rng = [np.random.default_rng(k) for k in range(num_envs)]
        self.episode = np.zeros(num_envs, dtype=int)
        self.actions = np.tile(self.start_action, (num_envs, 1))
        self.air = np.full(num_envs, self.sampler.air_supply_rate)  # (N,) target of the last period [m3/s]
        self.running = np.zeros(num_envs, dtype=bool)
        self.window: Window | None = None

    def __len__(self) -> int:
        return len(self.context)

    def __repr__(self) -> str:
        return f"{len(self)} x {self.config!r}, {self.fidelity!r}"

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
        return self.backend.inserted_length

    @property
    def helix_length(self) -> FloatArray:
        """(N,) [m]."""
        return self.backend.helix_length

    def simulated(self) -> Simulated:
        """The backend, if it simulates."""
        if not isinstance(self.backend, Simulated):
            raise ValueError("fidelity = 'surrogate' simulates no motion, which is needed here: use fast or finer")
        return self.backend

    def check(self, tubes: Iterable[Context]) -> None:
        """Raise ValueError if an episode of the scene's probe cannot begin in one of the tubes; nothing is changed."""
        for context in tubes:
            self.backend.check(context, self.sampler.build(context, {}))

    def branch(self, which: Sequence[int]) -> Episodes:
        """Copies of the episodes ``which`` in their current state, for planning; an index may occur more than once.

        Rewards and endings are those of the originals; metrics start from zero.
        """
        new, index = copy.copy(self), list(which)
        new.backend = self.backend.branch(which)
        new.scorer, new.sensors = self.scorer.branch(which), rows_of(self.sensors, which)
        new.context, new.rng = [self.context[k] for k in which], [copy.deepcopy(self.rng[k]) for k in which]
        new.constants = {name: values[index] for name, values in self.constants.items()}
        new.air = self.air[index]
        new.episode, new.actions, new.running = self.episode[index], self.actions[index], self.running[index]
        new.window = None
        return new

    def set_tube(self, k: int, context: Context, scene: Scene) -> None:
        """Set what is observed of the tube and the probe of episode ``k``."""
        self.context[k] = context
        for name, values in self.constants.items():
            values[k] = getattr(scene.probe if name in RANGES else context, name)

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
                    self.backend.check(*prepared[k])
                except ValueError as error:
                    raise ValueError(f"environment {k}: {error}" if len(self) > 1 else str(error)) from error
        begun = np.zeros(len(self), dtype=bool)
        begun[list(which)] = True
        for k, (context, scene) in prepared.items():
            self.rng[k], self.episode[k], self.actions[k] = rngs[k], episodes[k], self.start_action
            self.air[k] = self.sampler.air_supply_rate
            self.set_tube(k, context, scene)
            self.backend.begin(k, context, scene, rngs[k])
        start, window = self.inserted_length, self.backend.settle(begun, self.rng)
        for k in which:
            self.scorer.begin(k, float(start[k]), float(self.helix_length[k]), window)
            self.running[k] = True  # if it diverged while settling, it ends in its first step
        self.sensors.begin(self._measured(window), begun, normal_draws(self.rng, begun, 2))
        infos = _rows(self._info(window) | {"diverged": window.diverged})
        return self.observation.copy(), {
            k: infos[k] | {"context": context.model_dump(), "probe": scene.probe.model_dump()}
            for k, (context, scene) in prepared.items()
        }

    def targets(self, actions: npt.ArrayLike) -> FloatArray:
        """(N, 2) targets of feed [m/s] and air [m3/s] of the next period, negative on withdrawal; see ``air_ramp``."""
        targets = self.config.targets(actions, self.allow_standstill)
        if self.config.air_ramp is not None:
            reach = self.config.air_ramp * self.config.period
            targets[:, 1] = np.clip(targets[:, 1], self.air - reach, self.air + reach)
        return targets * self.direction[:, None]

    def step(self, actions: npt.ArrayLike, active: BoolArray | None = None) -> Step:
        """One control period of the active probes (default: all) towards the targets of actions (N, 2).

        Raises:
            ValueError: an action is not valid; nothing has been advanced.
            RuntimeError: an active episode has ended and was not reset.
        """
        stepped = np.ones(len(self), dtype=bool) if active is None else np.asarray(active, dtype=bool)
        given = as_actions(actions, (len(self), 2)).astype(np.float32)
        given = np.where(stepped[:, None], given, self.actions)  # the others keep their last action
        targets = self.targets(given)
        if (stepped & ~self.running).any():
            raise RuntimeError(
                f"episode {np.flatnonzero(stepped & ~self.running)[0]} has ended: call reset before step"
            )
        change, self.actions = given.astype(float) - self.actions, given
        self.air = np.where(stepped, np.abs(targets[:, 1]), self.air)
        record = self.backend.advance(stepped, targets, self.direction, self.rng)
        self.window = window = record.window
        scored = self.scorer.score(record, change)
        self.sensors.update(self._measured(window), record.finite, record.sensor_noise, self.rng)
        terminated, truncated = scored.terminated, scored.truncated
        self.running &= ~(terminated | truncated)
        info = self._info(window) | {
            "cost": np.sum(list(scored.costs.values()), axis=0),
            "target_feed_speed": targets[:, 0],
            "target_air_supply_rate": targets[:, 1],
            **{name: scored.endings[name] for name in FAILURES},
        }
        infos = _rows(info)
        for k, (rewards, costs) in enumerate(zip(_rows(scored.rewards), _rows(scored.costs), strict=True)):
            infos[k]["reward_terms"], infos[k]["cost_terms"] = rewards, costs
            if not stepped[k]:
                infos[k] = {}
            elif not self.running[k]:
                infos[k]["episode_kpis"] = self.scorer.kpis(k, scored)
        return Step(self.observation.copy(), scored.reward, terminated, truncated, infos)

    def _measured(self, window: Window) -> dict[str, FloatArray]:
        """Sensor values before noise, (N,) each in SI units, see ``observe``."""
        inserted, statistics = self.inserted_length, window.statistics
        if self.config.vibration_measure == "snr":  # then it is the noise in the band of the flaw
            statistics = statistics | {"radial_rms_m": self.config.sensor.equivalent_rms(statistics["noise_to_signal"])}
        return {
            **statistics,
            **self.constants,
            "inserted_length": inserted,
            "remaining_length": self.helix_length - inserted,
            "feed_speed": window.feed_speed,
            "air_supply_rate": window.air_supply_rate,
            "previous_feed_action": self.actions[:, 0].astype(float),
            "previous_air_action": self.actions[:, 1].astype(float),
            "direction": self.direction,
        }

    def _info(self, window: Window) -> dict[str, npt.NDArray[Any]]:
        """Physical values (N,) for ``info``, SI units."""
        info: dict[str, npt.NDArray[Any]] = {
            "time": self.scorer.totals["time"],
            "inspected_length": self.scorer.totals["inspected"],
            **({"direction": self.direction} if self.config.returns else {}),
            "inserted_length": self.inserted_length,
            "feed_speed": window.feed_speed,
            "air_supply_rate": window.air_supply_rate,
            **{name: window.statistics[name] for name in IN_INFO if name in window.statistics},
        }
        if "noise_to_signal" in window.statistics:
            noise = window.statistics["noise_to_signal"]
            info["snr"] = np.divide(1.0, noise, out=np.zeros_like(noise), where=noise > 0.0)
            info["noise_rms_m"] = self.config.sensor.equivalent_rms(noise)
        return info


def map_of(vibration: VibrationMap | str | Path | None, scene: Scene) -> VibrationMap:
    """A map, or that of a file, for the tubes and probe of a scene; None: the shipped one."""
    return (
        load_for(Path(vibration), "the scene", scene)
        if isinstance(vibration, str | Path)
        else vibration or stored_map()
    )


def _rows(columns: Mapping[str, npt.NDArray[Any]]) -> list[dict[str, Any]]:
    """Columns (N,) by name as one dictionary per probe."""
    names = tuple(columns)
    rows = zip(*[column.tolist() for column in columns.values()], strict=True)
    return [dict(zip(names, row, strict=False)) for row in rows]  # strict=True takes 10 % of a step
