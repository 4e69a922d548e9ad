"""Surrogate episodes of N probes: a vibration map, closed forms and measured noise predict each period.

The surrogate is quasi-steady: vibration has no transients except its noise, and no probe diverges. Actions, feed and
air dynamics, observations, rewards and endings are those of the simulated task. Training takes minutes instead of
hours; evaluate agents by simulation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, NoReturn, Unpack

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray, FloatArray
from probe_env.design import RANGES
from probe_env.envs.contexts import Context
from probe_env.envs.episodes import Step
from probe_env.envs.episodes.episodes import check_running
from probe_env.envs.episodes.scoring import EpisodeMetrics
from probe_env.envs.episodes.starts import (
    DEFAULTS,
    EpisodeSampler,
    EpisodeSettings,
    Probes,
    resolve_settings,
    restored_on_error,
    settling,
)
from probe_env.envs.task import COSTS, FAILURES, Score, TaskConfig, as_actions, rules
from probe_env.envs.task.observations import SensorModel, normal_draws
from probe_env.envs.vibration_map import CONTEXT, VibrationMap, check_measure, load_for, rms_limit, stored_map
from probe_env.fidelity import PRESETS, SURROGATE
from probe_env.physics.closed_forms import buckling_load, sliding_tension
from probe_env.physics.model.drive import drives_after
from probe_env.scene import Scene
from probe_env.settings import check_keywords

DRAWS: Final = 7
"""Normal draws per probe and period: slow and quick vibration, tension, two accelerations, two sensors."""
IN_INFO: Final = (
    "inserted_length", "feed_speed", "air_supply_rate",
    "radial_rms_m", "radial_acceleration_rms_m_per_s2", "tension_mean_n",
)  # fmt: skip
"""Predicted values in ``info``."""
WAVES: Final = 32
"""Number of cosines of a random field."""
DRIVE_STEP: Final = 5e-3
"""Time step of the feed and air dynamics [s]: the length error is 0.5 mm for a change of feed by 0.2 m/s."""


class Scatter(NamedTuple):
    """Stationary Gaussian AR(1) process: standard deviation, and correlation from one second to the next."""

    deviation: float = 0.0
    correlation: float = 0.0

    def next(self, value: FloatArray, normal: FloatArray) -> FloatArray:
        """The next second's values (n,), by standard normal draws (n,)."""
        return np.asarray(self.correlation * value + self.deviation * np.sqrt(1.0 - self.correlation**2) * normal)


class RandomField(NamedTuple):
    """What the map misses in a tube: a smooth random function of feed, air and length, Gaussian with these scales."""

    deviation: float = 0.0
    feed: float = 1.0  # in the natural logarithm of the feed
    air: float = 1.0  # [m3/s]
    length: float = 1.0  # [m]

    def waves(self, rng: np.random.Generator) -> FloatArray:
        """A random function as the sum of (``WAVES``, 4) cosines: a phase, and factors of the three variables."""
        scales = 1.0 / np.array([self.feed, self.air, self.length])
        return np.column_stack([rng.uniform(0.0, 2.0 * np.pi, WAVES), rng.normal(0.0, scales, (WAVES, 3))])

    def at(self, waves: FloatArray, feed: FloatArray, air: FloatArray, length: FloatArray) -> FloatArray:
        """Values (n,) of the functions ``waves`` (n, ``WAVES``, 4)."""
        variables = np.column_stack([np.ones_like(feed), np.log(feed), air, length])
        cosines = np.cos(np.einsum("nwv,nv->nw", waves, variables))
        return np.asarray(self.deviation * np.sqrt(2.0 / WAVES) * cosines.sum(axis=1))


class Noise(NamedTuple):
    """Scatter of a second of insertion about the map, in decades."""

    bias: float = 0.0  # rms of a second relative to that of a metre, which the map predicts
    field: RandomField = RandomField()  # deviation of a tube from the map, which persists while feed and air are kept
    slow: Scatter = Scatter()  # deviation from both, of some seconds
    quick: float = 0.0  # standard deviation of the radial rms from one second to the next
    tension: Scatter = Scatter()  # natural logarithm of the root tension over that of steady sliding
    radial: tuple[float, ...] = (1.0, 0.7, 0.0, 0.0, 0.0, 0.0)  # of log10 of the rms acceleration, see ``features``
    radial_scatter: Scatter = Scatter()
    axial: tuple[float, ...] = (1.0, 0.4, 0.0, 0.0, 0.0, 0.0)
    axial_scatter: Scatter = Scatter()


MEASURED: Final = Noise(
    bias=-0.0682,
    field=RandomField(deviation=0.123, feed=0.244, air=9.73 / 3600.0, length=8.7),
    slow=Scatter(0.122, 0.850),
    quick=0.144,
    tension=Scatter(0.08186281974990066, 0.8967350009110485),
    radial=(1.285, 0.7304, -0.1902, 0.02426, 0.0693, 0.02863),
    radial_scatter=Scatter(0.2573665162036093, 0.8908851651815758),
    axial=(0.8155, 0.3837, -0.04155, 0.1829, 0.0414, 0.3907),
    axial_scatter=Scatter(0.26028889503501884, 0.9369185350655408),
)
"""Measured on insertions with random feed and air in training tubes at ``fast``, the vibration on 21,120 seconds, the
others on 12,303. ``docs/surrogate.py`` at commit 5d808b5f fits the vibration: these values are
within 2 of its greatest log-likelihood."""


def features(vibration: FloatArray, feed: FloatArray, length: FloatArray, tubes: FloatArray) -> FloatArray:
    """(n, 6) inputs of the accelerations from log10(radial rms / 0.1 mm), feed [m/s], inserted length [m] and tubes."""
    one = np.ones_like(vibration)
    friction, diameter = tubes[:, 0] / 0.175, 1.0 / tubes[:, 3]
    return np.column_stack([one, vibration, np.log10(np.maximum(feed, 1e-3)), length / 60.0, friction, diameter])


class SurrogateEpisodes:
    """N surrogate episodes; same methods as ``Episodes``, fewer infos and KPIs.

    Args:
        count: N.
        config: the task.
        allow_standstill: whether the feed action may be the task's ``standstill``.
        noise: scatter about the map; default: as measured.
        settings: see ``EpisodeSettings``; ``surrogate_map`` defaults to the shipped map.

    Raises:
        ValueError: an argument is not valid, or the map does not predict the task.
        TypeError: unknown setting.
    """

    kernel_seconds: Final = 0.0
    window: Final = None

    def __init__(
        self,
        count: int,
        config: TaskConfig,
        *,
        allow_standstill: bool = False,
        noise: Noise = MEASURED,
        **settings: Unpack[EpisodeSettings],
    ) -> None:
        check_keywords(type(self).__name__, settings, DEFAULTS)
        config, settings = resolve_settings({}, config, settings)
        arguments = DEFAULTS | settings
        vibration = arguments["surrogate_map"]
        if isinstance(vibration, str | Path):
            vibration = load_for(Path(vibration), "the scene", config.scene)
        self.map = vibration or stored_map()
        self.config, self.noise, self.fidelity = config, noise, PRESETS[SURROGATE]
        self.allow_standstill = allow_standstill
        check_task(config, arguments["probes"], self.map)
        if count < 1:
            raise ValueError(f"num_envs = {count!r} is outside the accepted range 1 and more")
        feed, air = settling(config, settings)
        self.sampler = EpisodeSampler(
            config, arguments["contexts"], arguments["probes"], feed, air, arguments["in_turn"]
        )
        self.start_action = config.action(feed, air)
        self.limit, self.buckling = rms_limit(config), np.full(count, buckling_load(config.scene.probe))
        self.helix_length = np.full(count, config.scene.tube.helix_length)
        self.probe = {name: np.full(count, getattr(config.scene.probe, name)) for name in RANGES}
        self.direction = np.ones(count)
        self.context = [Context()] * count
        self.rng = [np.random.default_rng(k) for k in range(count)]
        self.episode = np.zeros(count, dtype=int)
        self.tubes = np.ones((count, len(CONTEXT)))
        self.waves = np.zeros((count, WAVES, 4))
        self.inserted_length, self.start, self.time = np.zeros(count), np.zeros(count), np.zeros(count)
        self.feed, self.air = np.zeros(count), np.zeros(count)
        self.processes = {
            "slow": (0, noise.slow), "tension": (2, noise.tension),
            "radial": (3, noise.radial_scatter), "axial": (4, noise.axial_scatter),
        }  # fmt: skip
        self.scatter = {name: np.zeros(count) for name in self.processes}
        self.slack_steps, self.running = np.zeros(count, dtype=int), np.zeros(count, dtype=bool)
        self.actions = np.tile(self.start_action, (count, 1))
        self.sums: dict[str, FloatArray] = {}
        self.sensors = SensorModel(config, count)

    def __len__(self) -> int:
        return len(self.context)

    def __repr__(self) -> str:
        return f"{len(self)} x {self.config!r}, {self.fidelity!r}"

    @property
    def observation(self) -> npt.NDArray[np.float32]:
        """(N, d) current observation."""
        return self.sensors.observation

    @property
    def batch(self) -> NoReturn:
        """Not available: planning needs a simulator.

        Raises:
            ValueError: always.
        """
        raise ValueError("fidelity = 'surrogate' has no simulator for planning: use fast or finer")

    def reset(
        self,
        which: Sequence[int],
        rngs: Mapping[int, np.random.Generator],
        options: Mapping[int, Mapping[str, Any] | None] | None = None,
    ) -> tuple[npt.NDArray[np.float32], dict[int, dict[str, Any]]]:
        """Start new episodes of some probes; (N, d) observation and their infos. Options: see ``Episodes.reset``.

        Raises:
            ValueError: an option is unknown or not valid, or the map does not cover a tube or probe; nothing has
                been changed.
        """
        prepared: dict[int, tuple[Context, Scene]] = {}
        # a new generator, of a reset with a seed, begins at the first tube again
        episodes = {k: self.episode[k] + 1 if rngs[k] is self.rng[k] else 0 for k in which}
        with restored_on_error(rngs[k] for k in which):
            for k in which:
                prepared[k] = self.sampler.draw(rngs[k], (options or {}).get(k) or {}, k + episodes[k] * len(self))
                check_tube(*prepared[k], self.map)
        for k, (context, scene) in prepared.items():
            self.rng[k], self.episode[k], self.context[k] = rngs[k], episodes[k], context
            self.tubes[k] = [getattr(context, name) for name in CONTEXT]
            self.inserted_length[k] = self.start[k] = scene.inserted_length
            self.feed[k], self.air[k] = self.sampler.feed_speed, self.sampler.air_supply_rate
            self.time[k], self.slack_steps[k], self.running[k] = 0.0, 0, True
            for values in self.sums.values():
                values[k] = 0.0
            self.actions[k] = self.start_action
            self.waves[k] = self.noise.field.waves(self.rng[k])
        started = np.zeros(len(self), dtype=bool)
        started[list(which)] = True
        normal = normal_draws(self.rng, started, DRAWS)
        for name, (row, process) in self.processes.items():
            self.scatter[name] = np.where(started, process.deviation * normal[:, row], self.scatter[name])
        measured = self._measured(normal)
        self.sensors.begin(measured, started, normal[:, 5:])
        infos, probe = _rows(self._info_columns(measured)), self.config.scene.probe.model_dump()
        return self.observation.copy(), {
            k: infos[k] | {"context": self.context[k].model_dump(), "probe": probe, "diverged": False} for k in which
        }

    def step(self, actions: npt.ArrayLike, active: BoolArray | None = None) -> Step:
        """One control period of the active probes (default: all).

        Raises:
            ValueError: an action is not valid.
            RuntimeError: an active episode has ended and was not reset.
        """
        config = self.config
        stepped = np.ones(len(self), dtype=bool) if active is None else np.asarray(active, dtype=bool)
        check_running(self.running, stepped)
        requested = as_actions(actions, (len(self), 2)).astype(np.float32)
        actions = np.where(stepped[:, None], requested, self.actions)
        targets = config.targets(actions, self.allow_standstill)
        change = actions.astype(float) - self.actions
        self.actions = actions
        before, air_before = self.inserted_length, self.air
        self._drive(stepped, targets)
        normal = normal_draws(self.rng, stepped, DRAWS)
        for name, (row, process) in self.processes.items():
            self.scatter[name] = np.where(stepped, process.next(self.scatter[name], normal[:, row]), self.scatter[name])
        measured = self._measured(normal)
        scored = self._score(stepped, self.inserted_length - before, air_before, change, measured)
        self.sensors.update(measured, stepped, normal[:, 5:], self.rng)
        ended = rules.any_ending(scored.endings)
        self.running &= ~ended
        infos = self._infos(stepped, measured, scored, targets)
        for k in np.flatnonzero(ended).tolist():
            infos[k]["episode_kpis"] = self._kpis(k, scored)
        return Step(self.observation.copy(), scored.reward, scored.terminated, scored.truncated, infos)

    def _drive(self, stepped: BoolArray, targets: FloatArray) -> None:
        """Feed, air and inserted length at the end of a control period towards targets (N, 2) [m/s], [m3/s]."""
        config, now = self.config, (self.feed, self.air, self.inserted_length)
        steps = max(round(config.period / DRIVE_STEP), 1)
        after = drives_after(steps, config.period / steps, config.ramp, config.air_lag, *now[:2], targets, now[2])
        self.feed, self.air, length = (np.where(stepped, new, old) for new, old in zip(after, now, strict=True))
        self.inserted_length = np.minimum(length, self.helix_length)

    def _score(
        self,
        stepped: BoolArray,
        travel: FloatArray,
        air_before: FloatArray,
        change: FloatArray,
        measured: Mapping[str, FloatArray],
    ) -> Score:
        """Score a control period and add it to the episodes' sums."""
        config, tension = self.config, measured["tension_mean_n"]
        ratio = measured["radial_rms_m"] / self.limit
        air = np.where(stepped, rules.air_used(config, air_before, self.air), 0.0)
        is_slack = rules.slack(config, tension, self.inserted_length)
        costs = rules.cost_terms(config, is_slack, tension, tension, self.buckling)
        self.time = np.where(stepped, self.time + config.period, self.time)
        self.slack_steps = np.where(stepped, rules.consecutive_slack(self.slack_steps, is_slack), self.slack_steps)
        length, never = self.inserted_length, np.zeros(len(self), dtype=bool)
        endings = rules.ending(config, length, self.helix_length, self.slack_steps, self.time, stepped, never)
        squares = travel * rules.capped_square(config, ratio)
        uninspected = np.where(rules.any_ending(endings) & config.growing, self.helix_length - length, 0.0)
        rewards = rules.reward_terms(
            config, travel, squares, np.full(len(self), config.period), air, uninspected, never, action_change=change
        )
        scored = Score(rewards, costs, endings, np.where(stepped, sum(rewards.values()), 0.0))
        added = {
            "reward": scored.reward,
            "inspected": travel,
            "within_limit": np.where(ratio <= 1.0, travel, 0.0),
            "air": air,
            "lost_drive_events": self.slack_steps == config.lost_drive_periods,
            **{f"cost_{name}": values for name, values in costs.items()},
            "radial": travel * measured["radial_rms_m"] ** 2,
            "acceleration": travel * measured["radial_acceleration_rms_m_per_s2"] ** 2,
        }
        for name, values in added.items():
            self.sums.setdefault(name, np.zeros(len(self)))[stepped] += values[stepped]
        return scored

    def _measured(self, normal: FloatArray) -> dict[str, FloatArray]:
        """Predicted sensor values (N,), SI units, see ``observe``."""
        noise, scene = self.noise, self.config.scene
        length = np.maximum(self.inserted_length, 1.0)
        feed = np.maximum(self.feed, 1e-3)
        mean = self.map.predict(length, feed, self.air, self.tubes, scene)[0]
        field = noise.field.at(self.waves, feed, self.air, length)
        vibration = mean + noise.bias + field + self.scatter["slow"] + noise.quick * normal[:, 1]
        drive = {"inserted_length": length, "feed_speed": self.feed, "air_supply_rate": self.air}
        steady = sliding_tension(self.tubes[:, 0], drive | {"helix_diameter": self.tubes[:, 3]}, scene)
        inputs = features(vibration, self.feed, length, self.tubes)
        return {
            **{name: self.tubes[:, k] for k, name in enumerate(CONTEXT)},
            **self.probe,
            "radial_rms_m": 10.0**vibration * 1e-4,
            "tension_mean_n": steady * self.tubes[:, 2] * np.exp(self.scatter["tension"]),
            "radial_acceleration_rms_m_per_s2": 10.0 ** (inputs @ np.array(noise.radial) + self.scatter["radial"]),
            "axial_acceleration_rms_m_per_s2": 10.0 ** (inputs @ np.array(noise.axial) + self.scatter["axial"]),
            "inserted_length": self.inserted_length,
            "remaining_length": self.helix_length - self.inserted_length,
            "feed_speed": self.feed,
            "air_supply_rate": self.air,
            "previous_feed_action": self.actions[:, 0].astype(float),
            "previous_air_action": self.actions[:, 1].astype(float),
        }

    def _info_columns(self, measured: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Physical values (N,) for ``info``, SI units; noise in the band of a flaw only if the map predicts it."""
        noise = {"noise_rms_m": measured["radial_rms_m"]} if self.map.measure == "snr" else {}
        inspected = {"time": self.time, "inspected_length": self.inserted_length - self.start}
        return inspected | {name: measured[name] for name in IN_INFO} | noise

    def _infos(
        self, stepped: BoolArray, measured: Mapping[str, FloatArray], scored: Score, targets: FloatArray
    ) -> list[dict[str, Any]]:
        columns = self._info_columns(measured) | {
            "cost": np.sum(list(scored.costs.values()), axis=0),
            "target_feed_speed": targets[:, 0],
            "target_air_supply_rate": targets[:, 1],
            **{name: scored.endings[name] for name in FAILURES},
        }
        infos = _rows(columns)
        for k, (rewards, costs) in enumerate(zip(_rows(scored.rewards), _rows(scored.costs), strict=True)):
            infos[k]["reward_terms"], infos[k]["cost_terms"] = rewards, costs
            if not stepped[k]:
                infos[k] = {}
        return infos

    def _kpis(self, k: int, scored: Score) -> dict[str, float]:
        """KPIs of a finished episode: those of ``Episodes`` that need no samples of the motion."""
        sums = {name: float(values[k]) for name, values in self.sums.items()}
        radial, acceleration = sums.pop("radial"), sums.pop("acceleration")
        costs = {name: sums.pop(f"cost_{name}") for name in COSTS}
        values: dict[str, Any] = sums | {"time": float(self.time[k]), "costs": costs}
        metrics = EpisodeMetrics(**values)
        length, inspected = float(self.helix_length[k] - self.start[k]), max(metrics.inspected, 1e-9)
        return metrics.totals(length, scored.kpis(k)) | {
            "radial_rms_m": float(np.sqrt(radial / inspected)),
            "radial_acceleration_rms_m_per_s2": float(np.sqrt(acceleration / inspected)),
        }


def _rows(columns: Mapping[str, npt.NDArray[Any]]) -> list[dict[str, Any]]:
    """Columns (N,) by name as one dictionary per probe."""
    names = tuple(columns)
    rows = zip(*[column.tolist() for column in columns.values()], strict=True)
    return [dict(zip(names, row, strict=False)) for row in rows]  # strict=True takes 10 % of a step


def check_tube(context: Context, scene: Scene, vibration: VibrationMap) -> None:
    """Raise ValueError if a map does not cover the tube and probe of an episode."""
    if scene.probe != vibration.scene.probe:
        raise ValueError("probe: the map is of another probe; simulate with fidelity fast or finer")
    low, high = vibration.ranges
    for k, name in enumerate(CONTEXT):
        if not low[k] - 1e-9 <= getattr(context, name) <= high[k] + 1e-9:
            raise ValueError(
                f"{name} = {getattr(context, name):g} is outside the map's range {low[k]:g} to {high[k]:g}:"
                " simulate with fidelity fast or finer"
            )


def check_task(config: TaskConfig, probes: Probes, vibration: VibrationMap) -> None:
    """Raise ValueError if the map does not predict a task."""
    length, longest = config.scene.tube.helix_length, vibration.scene.tube.helix_length
    refused = {
        "growing = False": not config.growing,
        "passes = 'both'": config.returns,
        f"probes = {probes!r}": probes != "scene",
        "sensor_dropout": config.sensor_dropout > 0.0,
        "friction_drift": config.friction_drift != 0.0,
        "air.compressible = true": config.scene.air.compressible,
        "contact.weight = true": config.scene.contact.weight,
        f"helix_length = {length:g} m (the map ends at {longest:g} m)": length > longest * (1.0 + 1e-9),
    }
    wrong = [name for name, is_so in refused.items() if is_so]
    if wrong:
        raise ValueError(
            f"fidelity = 'surrogate' is for insertions of the vibration map (Insertion-v1), without"
            f" {', '.join(wrong)}: simulate with standard"
        )
    rms_limit(config)  # refuses a vibration measure that no map predicts
    check_measure(vibration, config)
