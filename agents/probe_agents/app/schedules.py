"""Schedules over inserted length: points to edit, prediction of the vibration map, and overlays."""

import tempfile
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

import numpy as np
import pandas as pd
from scipy.special import ndtr

from probe_agents.plant.logs import read_log
from probe_agents.policies.cases import EvaluationCase
from probe_agents.policies.catalogue import BY_DIAMETER, STORED, is_schedule_file, make_policy
from probe_agents.policies.fixed import FixedPolicy, Replayed
from probe_agents.policies.on_map import FIRST
from probe_env.arrays import FloatArray
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.rules import metre_reward
from probe_env.envs.vibration_map import CONTEXT, expected_cost
from probe_env.files import FileError
from probe_env.schedule import AIR, CSV_COMMENT, FEED, Interpolation, Schedule

HOUR: Final = 3600.0
LENGTH: Final = "inserted_length_m"
NAMES: Final = (LENGTH, FEED, AIR)
"""Columns of the points, in the units of schedule files."""
MISSING: Final = -1.0
"""Value of a new point in the column of the other chart; it is interpolated."""
MIN_GAP, LINE_STEP = 0.01, 0.25  # between two points, and points of the lines of policies [m]
MAP_UNIT: Final = 1e-4  # unit of the vibration map [m]
BAND: Final = 1.2816  # standard deviations on each side of the 80 % band of a normal distribution
BY_LENGTH: Final = ("constant", "slow-down", *STORED, BY_DIAMETER, "privileged")
"""Policies that depend on the inserted length and the tube alone; these and shipped schedules can be overlaid."""
Points = dict[str, list[float]]
T = TypeVar("T")


def points_of(schedule: Schedule) -> Points:
    """The points of a schedule over inserted length."""
    if schedule.over != "inserted_length":
        raise ValueError("a schedule over time cannot be edited here: add it as an overlay, or run it unchanged")
    air = [float(f"{value * HOUR:.6g}") for value in schedule.air_supply_rate]
    return {LENGTH: list(schedule.position), FEED: list(schedule.feed_speed), AIR: air}


def sorted_points(points: Mapping[str, Sequence[float]], config: TaskConfig) -> Points:
    """Points sorted by length and clipped to the ranges of feed and air; ``MISSING`` values are interpolated."""
    columns = np.array([pd.to_numeric(pd.Series(points[name]), errors="coerce") for name in NAMES], dtype=float)
    columns[~np.isfinite(columns)] = MISSING
    columns = columns[:, np.argsort(columns[0], kind="stable")]
    length = np.maximum(columns[0], 0.0)
    for k in range(1, len(length)):
        length[k] = max(length[k], length[k - 1] + MIN_GAP)
    ranges = (config.feed_speeds, tuple(HOUR * value for value in config.air_supply_rates))
    tidy = [[round(float(value), 3) for value in length]]
    for values, (low, high), digits in zip(columns[1:], ranges, (4, 2), strict=True):
        valid = values != MISSING
        if valid.any():
            values = np.where(valid, values, np.interp(length, length[valid], values[valid]))
        tidy.append([round(float(value), digits) for value in np.clip(values, low, high)])
    return dict(zip(NAMES, tidy, strict=True))


def schedule_of(points: Mapping[str, Sequence[object]], interpolation: Interpolation = "linear") -> Schedule:
    """Schedule of points, validated like a file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "schedule.csv"
        path.write_text(csv_text(points, interpolation), encoding="utf-8")
        try:
            return Schedule.read(path)
        except FileError as error:
            raise FileError("schedule", error.problem) from None


def csv_text(points: Mapping[str, Sequence[object]], interpolation: Interpolation = "linear") -> str:
    """Contents of the schedule file."""
    rows = zip(*(points[name] for name in NAMES), strict=True)
    lines = [f"{CSV_COMMENT} {interpolation}", ",".join(NAMES), *(",".join(map(str, row)) for row in rows)]
    return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class Prediction:
    """Prediction of the vibration map for a schedule in several tubes."""

    length: FloatArray  # (m,) middles of the metres [m]
    low: FloatArray  # (m,) lower end of the 80 % band over tubes and scatter, radial rms [m]
    middle: FloatArray  # (m,) median [m]
    high: FloatArray  # (m,) upper end of the band [m]
    within: float  # share of the length within the limit
    seconds: float  # duration of the insertion [s]
    air: float  # volume of air [m3]
    reward: float  # mean reward of an insertion, without jerk and lost drive, which the map does not predict


def predict(schedule: Schedule, case: EvaluationCase) -> Prediction:
    """Prediction of the vibration map for a schedule in the tubes of a case."""
    if schedule.over != "inserted_length":
        raise ValueError("the vibration map needs a schedule over inserted length: this one is over time")
    config = case.config
    tubes = np.array([[getattr(context, name) for name in CONTEXT] for context in case.contexts])
    length = np.arange(FIRST + 0.5, config.scene.tube.helix_length, 1.0)
    lengths, contexts = np.tile(length, len(tubes)), np.repeat(tubes, len(length), axis=0)
    feed, air = config.feasible(*schedule.at(lengths)).T
    mean, deviation = case.vibration.predict(lengths, feed, air, contexts, config.scene)
    cost = expected_cost(mean, deviation, feed, air, config)
    by_tube = mean.reshape(len(tubes), -1)
    middle = by_tube.mean(axis=0)
    spread = BAND * np.sqrt(by_tube.var(axis=0) + (deviation.reshape(by_tube.shape) ** 2).mean(axis=0))
    one = slice(0, len(length))
    return Prediction(
        length=length,
        low=MAP_UNIT * 10.0 ** (middle - spread),
        middle=MAP_UNIT * 10.0**middle,
        high=MAP_UNIT * 10.0 ** (middle + spread),
        within=float(ndtr((np.log10(config.limit / MAP_UNIT) - mean) / deviation).mean()),
        seconds=float((1.0 / feed[one]).sum()),
        air=float((air[one] / feed[one]).sum()),
        reward=float(len(length) * metre_reward(config, cost.mean())),
    )


class Line(NamedTuple):
    """Feed [m/s] and air [m3/s] over inserted length [m], (n,) each."""

    length: FloatArray
    feed: FloatArray
    air: FloatArray


def policy_line(spec: str, case: EvaluationCase) -> Line:
    """Feed and air of a policy or a schedule file in the first tube of a case."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the line shows values within the range of the device
        policy = make_policy(spec, case.config.full_observation, case.vibration)
    if isinstance(policy, Replayed):  # over time
        schedule = policy.schedule
        length = (schedule.start_length or 0.0) + schedule.fed_length(schedule.position)
        return Line(length, np.array(schedule.feed_speed), np.array(schedule.air_supply_rate))
    if not isinstance(policy, FixedPolicy) or (spec not in BY_LENGTH and not hasattr(policy, "schedule")):
        raise ValueError(f"policy = {spec!r} depends on measurements: run it to see its feed")
    length = np.arange(FIRST, case.config.scene.tube.helix_length + 0.5 * LINE_STEP, LINE_STEP)
    tube = {name: np.full(len(length), value) for name, value in case.contexts[0].model_dump().items()}
    observation = tube | {"time": np.zeros(len(length)), "inserted_length": length}
    feed, air = case.config.feasible(*policy.targets(observation, np.zeros((len(length), policy.memory)))).T
    if not is_schedule_file(spec):
        feed = np.minimum(feed, case.config.permitted_feed)
    return Line(length, feed, air)


def log_line(path: Path) -> Line:
    """Feed and air of a rig log."""
    log = read_log(path)
    for note in (*log.notes, *(f"The column {fault.text}." for fault in log.faults)):
        warnings.warn(note, stacklevel=2)
    return Line(log.inserted_length, log.feed_speed, log.air_supply_rate)


def _with_warnings(read: Callable[[Path], T], path: Path) -> tuple[T, list[str]]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        return read(path), [str(warning.message) for warning in caught]


def read_in_child(read: Callable[[Path], T], path: Path) -> Future[tuple[T, list[str]]]:
    """Read a file in a process of its own: the server goes on, whatever time and memory it takes. Also its warnings."""
    pool = ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1)
    future = pool.submit(_with_warnings, read, path)
    pool.shutdown(wait=False)  # after this file
    return future
