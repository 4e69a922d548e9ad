"""Episodes of N probes where vibration, tension and accelerations are what the map and a few closed forms say.

Quasi-steady: nothing rings up or dies away but by noise, no probe diverges. Actions, observations, rewards and endings
are the task's own. Ten thousand seconds and more of insertion in a second, for learning that is confirmed elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, Unpack

import numpy as np
import numpy.typing as npt

from agents.policies.maps.vibration_map import CONTEXT, VibrationMap, stored_map
from agents.worlds.noise import Noise, features, stored_noise
from probe_env.arrays import BoolArray, FloatArray
from probe_env.design import RANGES
from probe_env.envs.contexts import Context
from probe_env.envs.episodes import Step
from probe_env.envs.episodes.starts import DEFAULTS, EpisodeSettings, Starts, placed, settling
from probe_env.envs.task import (
    Ending,
    Outcome,
    TaskConfig,
    air_used,
    capped_square,
    ending,
    reward_terms,
    slack,
    slack_in_a_row,
)
from probe_env.envs.task.observations import observe
from probe_env.physics.closed_forms import sliding_tension
from probe_env.settings import check_known

DRAWS: Final = 7
"""Normal draws a probe and period: vibration slow and quick, tension, two accelerations, two sensors."""


class MapEpisodes:
    """N episodes side by side; the counterpart of ``Episodes``, with less in their infos.

    Args:
        count: N.
        config: the task.
        noise: what the map leaves out; default: as it was measured.
        settings: see ``EpisodeSettings``; fidelity is not looked at.

    Raises:
        ValueError: an argument is not valid, or asks for what the map does not tell of.
        TypeError: there is no such setting.
    """

    def __init__(
        self, count: int, config: TaskConfig, *, noise: Noise | None = None, **settings: Unpack[EpisodeSettings]
    ) -> None:
        check_known(type(self).__name__, settings, DEFAULTS)
        config, settings = placed({}, config, settings)
        given = DEFAULTS | settings
        self.config, self.map, self.noise = config, stored_map(), noise or stored_noise()
        _check(config, given, self.map)
        if count < 1:
            raise ValueError(f"num_envs = {count!r} is outside the accepted range 1 and more")
        feed, air = settling(config, settings)
        self.starts = Starts(config, given["contexts"], given["probes"], feed, air)
        self.start_feed, self.start_air = feed, air
        self.start_action = config.action(feed, air)
        self.context = [Context()] * count
        self.rng = [np.random.default_rng(k) for k in range(count)]
        self.tubes = np.ones((count, len(CONTEXT)))
        zeros = np.zeros(count)
        self.length, self.feed, self.air, self.time = zeros.copy(), zeros.copy(), zeros.copy(), zeros.copy()
        self.scatter = {name: zeros.copy() for name in ("slow", "tension", "radial", "axial")}
        self.slack_periods, self.running = np.zeros(count, dtype=int), np.zeros(count, dtype=bool)
        self.actions = np.tile(self.start_action, (count, 1))
        self.tally = {name: zeros.copy() for name in ("reward", "inspected", "within", "air")}
        self.observed = np.zeros((count, config.delay_periods + 1, len(config.observations)), dtype=np.float32)

    def __len__(self) -> int:
        return len(self.context)

    def reset(
        self,
        which: Sequence[int],
        rngs: Mapping[int, np.random.Generator],
        options: Mapping[int, Mapping[str, Any] | None] | None = None,
    ) -> tuple[npt.NDArray[np.float32], dict[int, dict[str, Any]]]:
        """Start new episodes of some probes; (N, d) observation and their infos. Options as of ``Episodes.reset``.

        Raises:
            ValueError: an option is not known or not valid, or a tube is none of the map's.
        """
        chosen = list(which)
        drawn = {k: self.starts.draw(rngs[k], (options or {}).get(k) or {}) for k in chosen}
        for context, scene in drawn.values():
            if scene.probe != self.map.scene.probe:
                raise ValueError("probe: the map is of another one; simulate with fidelity fast or finer")
            self._check_tube(context)
        for k, (context, scene) in drawn.items():
            self.rng[k], self.context[k] = rngs[k], context
            self.tubes[k] = [getattr(context, name) for name in CONTEXT]
            self.length[k], self.feed[k], self.air[k] = scene.inserted_length, self.start_feed, self.start_air
            self.time[k], self.slack_periods[k], self.running[k] = 0.0, 0, True
            for values in self.tally.values():
                values[k] = 0.0
            self.actions[k] = self.start_action
        every = np.zeros(len(self), dtype=bool)
        every[chosen] = True
        normal = self._drawn(every)
        for name, row in (("slow", 0), ("tension", 2), ("radial", 3), ("axial", 4)):
            scatter = getattr(self.noise, f"{name}_scatter" if name.endswith("ial") else name)
            self.scatter[name] = np.where(every, scatter.deviation * normal[:, row], self.scatter[name])
        measured = self._felt(every, normal, move=False)
        self.observed[every] = observe(self.config, measured, normal[:, 5:])[every, None]
        infos = {k: self._info(k, measured) | {"context": self.context[k].model_dump()} for k in chosen}
        return self.observed[:, 0].copy(), infos

    def step(self, actions: npt.ArrayLike, active: BoolArray | None = None) -> Step:
        """One control period of the active probes (default: all).

        Raises:
            ValueError: an action is not valid.
            RuntimeError: an active episode has ended and was not reset.
        """
        config, dt = self.config, self.config.period
        chosen = np.ones(len(self), dtype=bool) if active is None else np.asarray(active, dtype=bool)
        if (chosen & ~self.running).any():
            raise RuntimeError(f"episode {np.flatnonzero(chosen & ~self.running)[0]} has ended: call reset before step")
        given = np.where(chosen[:, None], np.asarray(actions, dtype=np.float32), self.actions)
        targets = config.targets(given)
        change = given.astype(float) - self.actions
        self.actions = given
        air_before = self.air.copy()
        travel = self._drive(targets, chosen)
        normal = self._drawn(chosen)
        measured = self._felt(chosen, normal)
        ratio = measured["radial_rms_m"] / config.limit
        used = np.where(chosen, air_used(config, air_before, self.air), 0.0)
        hanging = slack(config, measured["tension_mean_n"], self.length)
        self.time = np.where(chosen, self.time + dt, self.time)
        self.slack_periods = np.where(chosen, slack_in_a_row(self.slack_periods, hanging), self.slack_periods)
        end, never = config.scene.tube.helix_length, np.zeros(len(self), dtype=bool)
        ended = ending(config, self.length, np.full(len(self), end), self.slack_periods, self.time, chosen, never)
        over = ended.over
        left = np.where(over, end - self.length, 0.0)
        outcome = Outcome(travel, travel * capped_square(config, ratio), np.full(len(self), dt), used, left, never)
        terms = reward_terms(config, outcome, change)
        reward = np.where(chosen, sum(terms.values()), 0.0)
        self.running &= ~over
        parts = (
            ("reward", reward),
            ("inspected", travel),
            ("within", np.where(ratio <= 1.0, travel, 0.0)),
            ("air", used),
        )
        for name, values in parts:
            self.tally[name] += np.where(chosen, values, 0.0)
        row = observe(config, measured, normal[:, 5:])[:, None]
        self.observed[chosen] = np.concatenate([self.observed[:, 1:], row], axis=1)[chosen]
        infos = [self._info(k, measured) | self._kpis(k, over, ended) if chosen[k] else {} for k in range(len(self))]
        return Step(self.observed[:, 0].copy(), reward, ended.terminated, ended.truncated, infos)

    def _drive(self, targets: FloatArray, chosen: BoolArray) -> FloatArray:
        """Feed within its ramp and air with its lag towards targets (N, 2); (N,) length fed [m]."""
        config, dt = self.config, self.config.period
        gap = targets[:, 0] - self.feed
        most = config.ramp * dt
        feed = self.feed + np.clip(gap, -most, most)
        ramped = np.minimum(np.abs(gap) / config.ramp, dt)
        fed = feed * dt - 0.5 * np.sign(gap) * config.ramp * ramped**2
        gain = 1.0 - np.exp(-dt / config.air_lag) if config.air_lag > 0.0 else 1.0
        travel = np.where(chosen, np.minimum(fed, config.scene.tube.helix_length - self.length), 0.0)
        self.feed = np.where(chosen, feed, self.feed)
        self.air = np.where(chosen, self.air + gain * (targets[:, 1] - self.air), self.air)
        self.length = self.length + travel
        return travel

    def _drawn(self, which: BoolArray) -> FloatArray:
        """(N, DRAWS) standard normal draws of each probe's own generator; 0 for the others."""
        normal = np.zeros((len(self), DRAWS))
        for k in np.flatnonzero(which).tolist():
            normal[k] = self.rng[k].normal(size=DRAWS)
        return normal

    def _felt(self, which: BoolArray, normal: FloatArray, move: bool = True) -> dict[str, FloatArray]:
        """What is measured where the probes are, (N,) each, see ``observe``; ``move`` goes on with the scatter."""
        noise, scene = self.noise, self.config.scene
        if move:
            for name, scatter, row in (
                ("slow", noise.slow, 0), ("tension", noise.tension, 2), ("radial", noise.radial_scatter, 3),
                ("axial", noise.axial_scatter, 4),
            ):  # fmt: skip
                moved = scatter.moved(self.scatter[name], normal[:, row])
                self.scatter[name] = np.where(which, moved, self.scatter[name])
        mean = self.map.tells(np.maximum(self.length, 1.0), np.maximum(self.feed, 1e-3), self.air, self.tubes, scene)[0]
        vibration = mean + noise.bias + self.scatter["slow"] + noise.quick * normal[:, 1]
        seen = {
            "inserted_length": np.maximum(self.length, 1.0), "feed_speed": self.feed, "air_supply_rate": self.air,
            "helix_diameter": self.tubes[:, 3],
        }  # fmt: skip
        pulled = sliding_tension(self.tubes[:, 0], seen, scene) * self.tubes[:, 2] * np.exp(self.scatter["tension"])
        inputs = features(vibration, self.feed, self.length, self.tubes)
        probe = {name: np.full(len(self), getattr(scene.probe, name)) for name in RANGES}
        return {
            **{name: self.tubes[:, k] for k, name in enumerate(CONTEXT)}, **probe,
            "radial_rms_m": 10.0**vibration * 1e-4, "tension_mean_n": pulled,
            "radial_acceleration_rms_m_per_s2": 10.0 ** (inputs @ np.array(noise.radial) + self.scatter["radial"]),
            "axial_acceleration_rms_m_per_s2": 10.0 ** (inputs @ np.array(noise.axial) + self.scatter["axial"]),
            "inserted_length": self.length, "remaining_length": scene.tube.helix_length - self.length,
            "feed_speed": self.feed, "air_supply_rate": self.air,
            "feed_action": self.actions[:, 0].astype(float), "air_action": self.actions[:, 1].astype(float),
        }  # fmt: skip

    def _check_tube(self, context: Context) -> None:
        low, high = self.map.ranges
        for k, name in enumerate(CONTEXT):
            if not low[k] - 1e-9 <= getattr(context, name) <= high[k] + 1e-9:
                raise ValueError(
                    f"{name} = {getattr(context, name):g} is outside the map's range {low[k]:g} to {high[k]:g}:"
                    " simulate with fidelity fast or finer"
                )

    def _info(self, k: int, measured: Mapping[str, FloatArray]) -> dict[str, Any]:
        names = ("inserted_length", "feed_speed", "air_supply_rate", "radial_rms_m", "tension_mean_n")
        return {"time": float(self.time[k]), **{name: float(measured[name][k]) for name in names}}

    def _kpis(self, k: int, over: BoolArray, ended: Ending) -> dict[str, Any]:
        """Of an episode that ends, the task's rewards and lengths."""
        if not over[k]:
            return {}
        inspected = self.tally["inspected"][k]
        kpis = {
            "reward": self.tally["reward"][k], "inspection_time_s": self.time[k], "inspected_m": inspected,
            "share_within_limit": self.tally["within"][k] / max(inspected + self._left(k), 1e-9),
            "air_m3": self.tally["air"][k], **ended.kpis(k),
        }  # fmt: skip
        return {"episode_kpis": {name: float(value) for name, value in kpis.items()}}

    def _left(self, k: int) -> float:
        return float(self.config.scene.tube.helix_length - self.length[k])


def _check(config: TaskConfig, given: Mapping[str, Any], vibration: VibrationMap) -> None:
    """Raise ValueError where the map does not tell of a task."""
    refused = {
        "growing = False": not config.growing, "passes = 'both'": config.returns,
        f"probes = {given['probes']!r}": given["probes"] != "scene",
        f"vibration_measure = {config.vibration_measure!r}": config.vibration_measure != vibration.measure,
        "sensor_dropout": config.sensor_dropout > 0.0, "friction_drift": config.friction_drift != 0.0,
    }  # fmt: skip
    wrong = [name for name, is_so in refused.items() if is_so]
    if wrong:
        raise ValueError(f"{', '.join(wrong)}: the world of the map does not have that; simulate with fidelity fast")
