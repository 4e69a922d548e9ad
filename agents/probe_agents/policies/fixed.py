"""Fixed policies with SB3's ``predict``: constants, schedules, simple feedback.

The memory of an episode is the ``state`` that ``predict`` returns and takes, as with SB3's recurrent policies: a row
for each environment, the time first.
"""

from abc import abstractmethod
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from probe_agents.policies.policy import ObservationPolicy
from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.observations import in_si_units
from probe_env.envs.task.scales import value_at
from probe_env.schedule import Schedule

STUDY_FEED, STUDY_AIR = 0.2, 63.0 / 3600.0
NEEDED: Final = {
    "root_tension": "the root tension (observe_root_tension = true)",
    "friction": "the tube (privileged = true)",
}
"""Observations that a task may lack -> text for errors."""


def gain(config: TaskConfig, seconds: float) -> float:
    """Share of the newest value in an average with a time constant [s], for one control period."""
    return float(1.0 - np.exp(-config.period / seconds))


@dataclass
class FixedPolicy(ObservationPolicy):
    """Base class: decodes the observation, updates time and memory, encodes the action.

    Attributes:
        config: the task that it acts in.
        memory: size of the memory for each environment, besides the time.
        allow_standstill: whether a feed of 0 is a standstill instead of the slowest feed.
        needs: required observations, keys of ``NEEDED``.
    """

    config: TaskConfig
    memory: ClassVar[int] = 0
    allow_standstill: ClassVar[bool] = False
    needs: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        for name in self.needs:
            if name not in self.config.observations:
                raise ValueError(f"{type(self).__name__} needs a task that shows {NEEDED[name]}")

    @abstractmethod
    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Target feed speed [m/s] and air supply [m3/s], (N,) each.

        Args:
            measured: time [s] since the episode began, and the observations in SI units, see ``in_si_units``.
            memory: (N, m), updated in place.
        """

    def start(self, memory: FloatArray) -> None:
        """Initialise the memory (rows of new episodes)."""

    def _act(
        self, rows: npt.NDArray[np.floating], state: Any, start: BoolArray, deterministic: bool
    ) -> tuple[npt.NDArray[np.float32], Any]:
        memory = np.zeros((len(rows), self.memory + 1)) if state is None else state[0].copy()
        fresh = np.zeros((int(start.sum()), self.memory + 1))
        self.start(fresh[:, 1:])
        memory[start] = fresh
        feed, air = self.targets({"time": memory[:, 0], **in_si_units(self.config, rows)}, memory[:, 1:])
        memory[:, 0] += self.config.period
        action = self.config.actions(feed, air).astype(np.float32)
        if self.allow_standstill:
            action[np.asarray(feed) == 0.0, 0] = self.config.standstill
        return action, (memory,)

    def describe(self) -> dict[str, Any]:
        """With all settings."""
        values = {name: value for name, value in asdict(self).items() if name != "config"}
        return {"policy": type(self).__name__, **values}


@dataclass
class Constant(FixedPolicy):
    """Constant feed [m/s] and air supply rate [m3/s]; by default the study's."""

    feed_speed: float = STUDY_FEED
    air_supply_rate: float = STUDY_AIR

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Constant."""
        one = np.ones_like(measured["time"])
        return self.feed_speed * one, self.air_supply_rate * one


@dataclass
class Scheduled(FixedPolicy):
    """Feed and air of a ``Schedule`` at the time [s] or the inserted length [m]."""

    schedule: Schedule = field(default_factory=lambda: Schedule("time", "steps", (0.0,), (STUDY_FEED,), (STUDY_AIR,)))

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Feed and air of the schedule at the time or the inserted length."""
        return self.schedule.at(measured[self.schedule.over])


@dataclass
class Replayed(FixedPolicy):
    """A schedule over time, such as a log: the inserted length follows that of the schedule.

    Feeds below half of the slowest feed are standstills. Deviations are corrected in the next period, with the
    permitted feed at most. The schedule begins at its start length, or at the length at the start of the episode.
    After its end the last feed continues.
    """

    schedule: Schedule
    memory: ClassVar[int] = 2
    allow_standstill: ClassVar[bool] = True

    def start(self, memory: FloatArray) -> None:
        """Memory: time of the schedule at the start, and inserted length minus fed length."""
        memory[:] = np.nan

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Feed by the difference between the schedule's length and the (delayed) inserted length."""
        schedule, period, late = self.schedule, self.config.period, self.config.delay_periods
        new, inserted = np.isnan(memory[:, 0]), measured["inserted_length"]
        memory[new, 0] = schedule.time_at(inserted[new])
        start = inserted[new] - schedule.fed_length(memory[new, 0])
        memory[new, 1] = start if schedule.start_length is None else schedule.start_length
        now = memory[:, 0] + measured["time"]
        measured_at = np.maximum(now - late * period, memory[:, 0])
        lag = memory[:, 1] + schedule.fed_length(measured_at) - inserted
        fraction = 1.0 / (1.0 + 2.0 * late)  # stable for every delay: below 2 sin(pi / (4 late + 2))
        planned = (schedule.fed_length(now + period) - schedule.fed_length(now)) / period
        target = planned + fraction * lag / period
        slow, fast = self.config.feed_speeds
        fastest = np.clip(planned, self.config.permitted_feed, fast)
        feed = np.where(target < 0.5 * slow, 0.0, np.clip(target, slow, fastest))
        last, air = schedule.at(now)
        return np.where(now < schedule.position[-1], feed, np.clip(last, slow, fast)), air


@dataclass
class SlowDown(FixedPolicy):
    """Fast feed up to one length, slow feed beyond another, linear in between."""

    fast: float = 0.4
    slow: float = 0.08
    air_supply_rate: float = 100.0 / 3600.0
    begin: float = 10.0
    end: float = 45.0

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Linear between the two lengths."""
        feed = np.interp(measured["inserted_length"], (self.begin, self.end), (self.fast, self.slow))
        return np.asarray(feed), np.full_like(measured["time"], self.air_supply_rate)


@dataclass
class OnOff(FixedPolicy):
    """Slow when the measured vibration exceeds a level, fast again when it is below half of it."""

    fast: float = 0.3
    slow: float = 0.08
    level: float = 8e-5
    air_supply_rate: float = 100.0 / 3600.0
    memory: ClassVar[int] = 1

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Memory: 1 while slow."""
        loud, quiet = measured["rf_noise"] > self.level, measured["rf_noise"] < 0.5 * self.level
        memory[:, 0] = np.where(loud, 1.0, np.where(quiet, 0.0, memory[:, 0]))
        feed = np.where(memory[:, 0] > 0.5, self.slow, self.fast)
        return feed, np.full_like(feed, self.air_supply_rate)


@dataclass
class PI(FixedPolicy):
    """Feed speed by proportional-integral control of the measured vibration, on logarithms of both."""

    level: float = 6e-5
    proportional: float = 0.15
    integral: float = 0.05
    air_supply_rate: float = 100.0 / 3600.0
    memory: ClassVar[int] = 1

    def start(self, memory: FloatArray) -> None:
        """Memory: logarithm of the integral part of the feed speed."""
        memory[:, 0] = np.log(STUDY_FEED)

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The integral is clipped to the feed range (no wind-up)."""
        error = np.clip(np.log(self.level / measured["rf_noise"]), -2.0, 1.0)
        low, high = np.log(self.config.feed_speeds)
        memory[:, 0] = np.clip(memory[:, 0] + self.integral * self.config.period * error, low, high)
        feed = np.exp(memory[:, 0] + self.proportional * error)
        return feed, np.full_like(feed, self.air_supply_rate)


@dataclass
class Random(FixedPolicy):
    """Uniformly random feed and air in every period, a function of seed, time and measured vibration."""

    seed: int = 0

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Seeded by time and measurement, so they depend neither on other environments nor on history."""
        fractions = np.empty((2, len(measured["time"])))
        for k, (time, noise) in enumerate(zip(measured["time"], measured["rf_noise"], strict=True)):
            entropy = [self.seed, round(time * 1e3), int(np.float64(noise).view(np.uint64))]
            fractions[:, k] = np.random.default_rng(entropy).uniform(size=2)
        return value_at(fractions[0], self.config.feed_speeds), value_at(fractions[1], self.config.air_supply_rates)


BUILT_IN: Final[dict[str, tuple[type[FixedPolicy], dict[str, Any]]]] = {
    "constant": (Constant, {}),
    "slow": (Constant, {"feed_speed": 0.1, "air_supply_rate": 100.0 / 3600.0}),
    "slow-down": (SlowDown, {}),
    "on-off": (OnOff, {}),
    "pi": (PI, {}),
    "random": (Random, {}),
}
