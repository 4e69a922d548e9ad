"""Verdict on the speed of an inspection, and the metres to repeat: from metres of an evaluation or rows of a log."""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from probe_agents.policies.on_map import FIRST
from probe_env import Context
from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.rules import slack
from probe_env.envs.vibration_map import CONTEXT, PROFILED, VibrationMap, feeds, rms_limit
from probe_env.schedule import Schedule

CASE: Final = ["policy", "context", "seed"]
INTERVAL: Final = ["from_m", "to_m", "reason"]
SPEED, NOISE, DRIVE, SAMPLES = REASONS = ("speed", "noise", "lost drive", "samples")
"""Reasons to repeat: above the permitted speed; vibration above its limit; root tension below the required one; no
samples: not reached, or a gap in a log."""
AND: Final = " and "
TOLERANCE: Final = 1e-3
"""Share by which a feed may exceed the permitted speed: actions and profiles are rounded."""
QUIET_FEEDS: Final = 40
"""Feeds among which the quiet speed is searched."""
SETTLING: Final = 2.0
"""Time in which the vibration follows a change of the feed [s], see ``probe_env.envs.vibration_map``."""
GRID: Final = 0.1
"""Spacing of the points of a repeated pass [m]."""
BIN: Final = 5.0
"""Length of a bin of ``repeat_overview`` [m], or a multiple."""
MAX_ROWS: Final = 8
"""Number of intervals in an overview or a sentence."""


@dataclass(frozen=True, eq=False)
class Segments:
    """Consecutive pieces of an insertion and what was measured in them, (n,) each in SI units; NaN: not measured.

    Attributes:
        begin, end: inserted length.
        feed: highest feed.
        axial: rms of the sensor's axial velocity about its mean.
        air: air supply rate.
        vibration: rms in the measure of the task: radial, or noise in the band of a flaw.
        tension: mean root tension.
        missing: whether samples are missing.
    """

    begin: FloatArray
    end: FloatArray
    feed: FloatArray
    axial: FloatArray
    air: FloatArray
    vibration: FloatArray
    tension: FloatArray
    missing: BoolArray

    def reasons(self, config: TaskConfig) -> dict[str, BoolArray]:
        """Reason -> (n,) whether it applies; vibration is compared for the measures in ``PROFILED`` only."""
        loud = np.zeros(len(self.begin), dtype=bool)
        if config.vibration_measure in PROFILED:
            loud = self.vibration > rms_limit(config)
        return {
            SPEED: self.feed > config.permitted_speed[0] * (1.0 + TOLERANCE),
            NOISE: loud,
            DRIVE: slack(config, self.tension, self.end),
            SAMPLES: self.missing,
        }


def segments_of(
    metres: Mapping[str, FloatArray], config: TaskConfig, complete: bool = True, lost_drive: bool = False
) -> Segments:
    """Segments of an episode from its profile (columns (m,), see ``plan.per_metre``) up to the end of the helix.

    A metre without a row was passed within the period of the next one. Beyond the last row no metre was reached, and
    that of the last row not to its end if the episode is not complete. Drive that was lost counts for the last metre.
    """
    rows, helix = np.flatnonzero(np.isfinite(metres["inserted_length"])), config.scene.tube.helix_length
    ends = np.minimum(np.asarray(metres["inserted_length"], dtype=float)[rows] + 0.5, helix)
    reached = len(ends)
    first = float(ends[0]) - 1.0 if reached else FIRST
    if not reached or ends[-1] < helix:
        ends = np.append(ends, helix)

    def column(name: str) -> FloatArray:
        values = np.full(len(ends), np.nan)
        if name in metres:
            values[:reached] = np.asarray(metres[name], dtype=float)[rows]
        return values

    tension = column("tension_mean_n")
    if lost_drive and reached:
        tension[reached - 1] = 0.0
    return Segments(
        begin=np.concatenate([[first], ends[:-1]]),
        end=ends,
        feed=column("highest_feed"),
        axial=column("axial_velocity_rms"),
        air=column("air_supply_rate"),
        vibration=column(PROFILED.get(config.vibration_measure, "")),
        tension=tension,
        missing=np.arange(len(ends)) >= reached - (not complete),
    )


def intervals_to_repeat(segments: Segments, config: TaskConfig) -> pd.DataFrame:
    """Disjoint intervals in ascending order, columns ``INTERVAL`` [m]; reasons of one interval are joined by "and".

    For each reason, gaps shorter than ``repeat_length`` of the instrument are closed and shorter intervals extended to
    it on both sides, within the insertion.
    """
    shortest = config.instrument.repeat_length if config.instrument else 0.0
    low, high = float(segments.begin[0]), float(segments.end[-1])
    by_reason = {
        reason: _extended(segments.begin[bad], segments.end[bad], shortest, low, high)
        for reason, bad in segments.reasons(config).items()
    }
    edges = np.unique([edge for intervals in by_reason.values() for interval in intervals for edge in interval])
    rows: list[tuple[float, float, str]] = []
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        reasons = (r for r, intervals in by_reason.items() if any(a <= begin and end <= b for a, b in intervals))
        reason = AND.join(reasons)
        if reason and rows and rows[-1][1:] == (begin, reason):
            rows[-1] = rows[-1][0], end, reason
        elif reason:
            rows.append((begin, end, reason))
    return pd.DataFrame(rows, columns=INTERVAL).astype({"from_m": float, "to_m": float})


def _extended(
    begin: FloatArray, end: FloatArray, shortest: float, low: float, high: float
) -> list[tuple[float, float]]:
    """Ascending intervals without gaps shorter than ``shortest``, none shorter than it, in [low, high]."""
    extended = []
    for a, b in _merged(zip(begin.tolist(), end.tolist(), strict=True), shortest):
        if b - a < shortest:
            a = max(min(0.5 * (a + b - shortest), high - shortest), low)
            b = min(a + shortest, high)
        extended.append((a, b))
    return _merged(extended, shortest)


def _merged(intervals: Iterable[tuple[float, float]], gap: float) -> list[tuple[float, float]]:
    """Ascending intervals, those closer than ``gap`` joined."""
    merged: list[tuple[float, float]] = []
    for a, b in intervals:
        if merged and a - merged[-1][1] < max(gap, 1e-9):
            merged[-1] = merged[-1][0], max(b, merged[-1][1])
        else:
            merged.append((a, b))
    return merged


RepeatCase = tuple[Segments, pd.DataFrame]
"""Segments of an insertion, and its intervals to repeat."""
Key = tuple[str | int, ...]
"""Values of ``CASE`` and, if training seeds are grouped, the training seed."""


def is_judged(config: TaskConfig) -> bool:
    """Whether insertions are judged: there is an instrument, the probe is fed in, and the insertion is scored."""
    return (
        config.instrument is not None and config.growing and not (config.returns and config.scored_pass == "withdrawal")
    )


def instrument_kpis(segments: Segments, config: TaskConfig) -> dict[str, float]:
    """Length driven too fast [m], most speed above the permitted one [m/s], and length to repeat [m].

    Unless the axial velocity is unknown, also the length [m] in which the sum of feed and its rms is too fast.
    """
    too_fast, intervals = segments.reasons(config)[SPEED], intervals_to_repeat(segments, config)
    length, limit = segments.end - segments.begin, config.permitted_speed[0] * (1.0 + TOLERANCE)
    kpis = {
        "length_too_fast_m": float(length[too_fast].sum()),
        "speed_excess_m_per_s": float((segments.feed[too_fast] - config.permitted_speed[0]).max(initial=0.0)),
        "length_to_repeat_m": float((intervals["to_m"] - intervals["from_m"]).sum()),
    }
    if np.isfinite(segments.axial).any() or not np.isfinite(segments.feed).any():
        kpis["length_sensor_too_fast_m"] = float(length[segments.feed + segments.axial > limit].sum())
    return kpis


def cases_of(table: pd.DataFrame, profile: pd.DataFrame, config: TaskConfig) -> dict[Key, RepeatCase]:
    """Segments and intervals of every episode of a table; ``profile`` has a row for each metre of these episodes."""
    case = [name for name in (*CASE, "training_seed") if name in table]
    profiles = dict(list(profile.groupby(case)))
    cases = {}
    for key, complete, lost in table.set_index(case)[["complete", "lost_drive"]].itertuples():
        rows = profiles.get(key, profile.iloc[:0])
        metres = {str(name): rows[name].to_numpy() for name in rows.columns.difference(case)}
        segments = segments_of(metres, config, complete > 0.0, lost > 0.0)
        cases[key] = segments, intervals_to_repeat(segments, config)
    return cases


def repeat_table(cases: Mapping[Key, RepeatCase]) -> pd.DataFrame:
    """Intervals of all episodes, columns ``CASE`` and ``INTERVAL``."""
    parts = [part.assign(**dict(zip(CASE, key, strict=False))) for key, (_, part) in cases.items()]
    return pd.concat([pd.DataFrame(columns=[*CASE, *INTERVAL]), *filter(len, parts)], ignore_index=True)


def by_policy(cases: Mapping[Key, RepeatCase]) -> dict[str, list[RepeatCase]]:
    """The cases of every policy."""
    policies: dict[str, list[RepeatCase]] = {}
    for key, case in cases.items():
        policies.setdefault(str(key[0]), []).append(case)
    return policies


@dataclass(frozen=True)
class Verdict:
    """Whether a feed is allowed with the instrument, over all tubes.

    Attributes:
        permitted: permitted speed [m/s]; infinite without a limit.
        requirement: field of the instrument that sets it; "" without a limit.
        too_fast: intervals in which some tube was passed too fast [m]; none: the feed is allowed.
        length: mean length driven too fast [m].
        excess: most speed above the permitted one [m/s].
        repeat: mean length to repeat, for all reasons [m].
        sensor_length: mean length in which the sum of feed and rms of the axial velocity is above the permitted speed
            [m]; NaN: not known.
        loud: intervals in which vibration was above its limit in some tube [m]; none for measures not in ``PROFILED``.
        loud_length: mean length with vibration above its limit [m].
        insertions: number of insertions.
    """

    permitted: float
    requirement: str
    too_fast: tuple[tuple[float, float], ...]
    length: float
    excess: float
    repeat: float
    sensor_length: float
    loud: tuple[tuple[float, float], ...]
    loud_length: float
    insertions: int = 1

    @property
    def on_average(self) -> str:
        """What follows a mean length in a sentence."""
        return " on average" if self.insertions > 1 else ""

    @property
    def allowed(self) -> bool:
        """Whether no metre was driven too fast."""
        return not self.too_fast


def verdict_of(cases: Sequence[RepeatCase], config: TaskConfig) -> Verdict:
    """The verdict on the episodes of a policy, or on a log."""
    kpis = pd.DataFrame([instrument_kpis(segments, config) for segments, _ in cases])
    intervals: dict[str, tuple[tuple[float, float], ...]] = {}
    lengths: dict[str, float] = {}
    for reason in (SPEED, NOISE):
        bad = [(part.begin[where], part.end[where]) for part, _ in cases for where in (part.reasons(config)[reason],)]
        begin, end = (np.concatenate(side) for side in zip(*bad, strict=True))
        order = np.argsort(begin, kind="stable")
        intervals[reason] = tuple(_merged(zip(begin[order].tolist(), end[order].tolist(), strict=True), 0.0))
        lengths[reason] = float((end - begin).sum()) / len(cases)
    mean = kpis.mean()
    return Verdict(
        *config.permitted_speed, intervals[SPEED], lengths[SPEED], float(kpis["speed_excess_m_per_s"].max()),
        float(mean["length_to_repeat_m"]), float(mean.get("length_sensor_too_fast_m", math.nan)),
        intervals[NOISE], lengths[NOISE], len(cases),
    )  # fmt: skip


def verdict_text(verdict: Verdict) -> str:
    """The verdict on the speed in a sentence."""
    if not verdict.requirement:
        return "no speed limit of the instrument is set"
    limit, mean = f"{verdict.permitted:.3g} m/s ({verdict.requirement})", verdict.on_average
    sensor = f"; for information: feed and axial vibration (rms) exceed it in {verdict.sensor_length:.1f} m{mean}"
    sensor = sensor if verdict.sensor_length > verdict.length else ""
    if verdict.allowed:
        return f"allowed: at most {limit} everywhere{sensor}"
    length, excess = f"{verdict.length:.1f} m{mean}", f"{verdict.excess:.3g} m/s"
    return f"not allowed: {length} above {limit}, by up to {excess}; {_where(verdict, verdict.too_fast)}{sensor}"


def quiet_text(verdict: Verdict, limit: str) -> str:
    """Whether the vibration is within its limit in every metre, in a sentence; ``limit`` with its unit."""
    if not verdict.loud:
        return f"quiet: vibration within {limit} in every metre"
    length = f"{verdict.loud_length:.1f} m{verdict.on_average}"
    return f"not quiet: vibration above {limit} in {length}; {_where(verdict, verdict.loud)}"


def _where(verdict: Verdict, intervals: Sequence[tuple[float, float]]) -> str:
    where = ", ".join(f"{begin:.1f} to {end:.1f}" for begin, end in intervals[:MAX_ROWS])
    more = f" and {len(intervals) - MAX_ROWS} more" if len(intervals) > MAX_ROWS else ""
    return f"{'in some tube ' if verdict.insertions > 1 else ''}at {where} m{more}"


def repeat_overview(intervals: Sequence[pd.DataFrame], length: float) -> pd.DataFrame:
    """What is to be repeated in some insertion, in at most ``MAX_ROWS`` rows with columns ``INTERVAL`` and "share".

    The intervals of all insertions if they fit, else bins of ``BIN`` or a multiple of it up to the length of the helix
    [m]; neighbours with the same reasons and share of the insertions are joined.
    """
    parts, width = pd.concat(list(intervals), keys=range(len(intervals))), BIN
    rows = _overview_rows(parts, len(intervals), np.unique(parts[INTERVAL[:2]].to_numpy(dtype=float)))
    while len(rows) > MAX_ROWS:
        rows = _overview_rows(parts, len(intervals), np.append(np.arange(0.0, length - 1e-9, width), length))
        width *= 2.0
    return pd.DataFrame(rows, columns=[*INTERVAL, "share"])


def _overview_rows(parts: pd.DataFrame, insertions: int, edges: FloatArray) -> list[tuple[float, float, str, float]]:
    rows: list[tuple[float, float, str, float]] = []
    for begin, end in itertools.pairwise(edges.tolist()):
        inside = parts[(parts["from_m"] < end) & (parts["to_m"] > begin)]
        reason = AND.join(name for name in REASONS if inside["reason"].str.contains(name).any())
        fraction = inside.index.get_level_values(0).nunique() / insertions
        if rows and rows[-1][1:] == (begin, reason, fraction):
            rows[-1] = rows[-1][0], end, reason, fraction
        elif fraction > 0.0:
            rows.append((begin, end, reason, fraction))
    return rows


def quiet_feeds(segments: Segments, context: Context, config: TaskConfig, vibration: VibrationMap) -> FloatArray:
    """(n,) fastest feed [m/s] at which each segment is expected within the vibration limit in a tube.

    log10 of the expected vibration is the mean of the map, raised by its standard deviation or by what was measured
    above its mean, if that is more. Feeds above the driven one are not considered. Where no feed is quiet it is the
    slowest of the map; so it is where vibration was above the limit, if the map predicts another vibration measure.
    """
    (slowest, fastest), count = feeds(config), len(segments.begin)
    if vibration.measure != config.vibration_measure:
        return np.where(segments.reasons(config)[NOISE], slowest, fastest)
    grid, middle = np.geomspace(slowest, fastest, QUIET_FEEDS), 0.5 * (segments.begin + segments.end)
    driven = np.where(np.isfinite(segments.feed), segments.feed, fastest)
    length, air = (np.repeat(values, QUIET_FEEDS + 1) for values in (middle, _air_of(segments, config)))
    feed = np.column_stack([np.tile(grid, (count, 1)), driven]).ravel()
    tubes = np.tile([getattr(context, name) for name in CONTEXT], (len(feed), 1))
    prediction = vibration.predict(length, feed, air, tubes, config.scene)
    mean, deviation = (values.reshape(count, -1) for values in prediction)
    with np.errstate(divide="ignore"):
        measured = np.log10(segments.vibration / 1e-4) - mean[:, -1]
    level = mean[:, :-1] + np.fmax(measured[:, None], deviation[:, :-1])
    quiet = (level <= np.log10(rms_limit(config) / 1e-4)) & (grid <= driven[:, None])
    return np.asarray(np.where(quiet, grid, slowest).max(axis=1))


def _air_of(segments: Segments, config: TaskConfig) -> FloatArray:
    """Air supply (n,) [m3/s]; where there is none, the last before it or the most."""
    return pd.Series(segments.air).ffill().fillna(config.air_supply_rates[1]).to_numpy()


def repeat_schedule(
    cases: Sequence[tuple[Segments, pd.DataFrame, Context]],
    config: TaskConfig,
    vibration: VibrationMap,
    time_lapse: float = 1.0,
) -> Schedule:
    """Schedule of a pass that inspects only the intervals to repeat of some tubes, at least one interval.

    Elsewhere it has the fastest feed. Inside, it has the permitted feed; where the reason is not only the speed, at
    most the slowest of the tubes' ``quiet_feeds``, from ``SETTLING`` before the interval on. It brakes before that, by
    the ramp and within one control period. The air is the mean of the tubes', and the most from the first metre with
    lost drive on.

    ``cases`` are segments, intervals and tube of each insertion; the schedule is played with ``time_lapse``.
    """
    (slowest, fastest), step = config.feed_speeds, config.feed_speed_step
    first, end = min(part[0].begin[0] for part in cases), max(part[0].end[-1] for part in cases)
    at = GRID * np.arange(math.floor(first / GRID), math.ceil(end / GRID - 1e-9))  # each is valid up to the next one
    feed, airs, lost = np.full(len(at), fastest), [], np.zeros(len(at), dtype=bool)
    for segments, intervals, context in cases:
        piece = np.searchsorted(segments.end, at + 0.5 * GRID).clip(max=len(segments.end) - 1)
        quiet = np.minimum(quiet_feeds(segments, context, config, vibration), config.permitted_feed)[piece]
        for begin, to, reason in intervals.itertuples(index=False):
            slow = np.full(len(at), config.permitted_feed) if reason == SPEED else quiet
            at_begin = slow[max(np.searchsorted(at, begin + 1e-9) - 1, 0)]
            ahead = 0.0 if reason == SPEED else SETTLING * time_lapse * at_begin
            inside = (at > begin - ahead - GRID) & (at < to - 1e-9)
            slow = np.where(at < begin - 1e-9, np.minimum(slow, at_begin), slow)
            feed[inside] = np.minimum(feed, slow)[inside]
            lost |= inside & (DRIVE in reason)
        airs.append(_air_of(segments, config)[piece])
    if step > 0.0:
        feed = np.maximum(step * np.floor(feed / step * (1.0 + 1e-9)), slowest)
    # a target holds for a period, which may begin just before the next point
    points = 1 + math.ceil(fastest * config.period * (1 + config.delay_periods) / GRID)
    feed = np.array([feed[k : k + points + 1].min() for k in range(len(feed))])
    for k in range(len(feed) - 2, -1, -1):
        feed[k] = min(feed[k], math.sqrt(feed[k + 1] ** 2 + 2.0 * config.ramp * GRID / time_lapse))
    air = np.where(np.maximum.accumulate(lost), config.air_supply_rates[1], np.mean(airs, axis=0))
    changed = (np.diff(feed, prepend=np.nan) != 0.0) | (np.diff(air, prepend=np.nan) != 0.0)
    position, feeds_of, airs_of = (tuple(values[changed].tolist()) for values in (np.round(at, 6), feed, air))
    return Schedule("inserted_length", "steps", position, feeds_of, airs_of)
