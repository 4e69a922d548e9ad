"""Logs of inspection rigs: read, repaired and thinned to a clean file that commands accept as a schedule."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from probe_agents.evaluation.repeat import Segments, intervals_to_repeat, repeat_schedule, verdict_of, verdict_text
from probe_agents.plant.cleaning import (
    DIGITS,
    DWELL,
    NOISE,
    Bounds,
    Fault,
    Repairs,
    clean,
    group_means,
    outside,
    standstills_of,
    thin_rows,
)
from probe_agents.policies.cases import EvaluationCase
from probe_agents.records.atomic import write_atomically
from probe_agents.records.cells import IntArray, ReadOptions
from probe_agents.records.quantities import HOUR, MEASURED, QUANTITIES
from probe_agents.records.reader import read_channels
from probe_agents.records.sources import file_and_sheet
from probe_agents.terminal.tables import print_table, print_terms
from probe_env.arrays import FloatArray
from probe_env.envs.task.config import TaskConfig
from probe_env.files import FileError, one_line
from probe_env.schedule import CSV_COMMENT, FEED, MAX_POINTS, RANGES

DETECTED: Final = ReadOptions()
USUAL: Final = Bounds()
PICTURES: Final = (".png", ".pdf", ".svg")
DWELLS_SHOWN: Final = 10
NEAR_END: Final = 0.05
"""Distance of the end of a log from that of the helix which counts as none [m], the accepted error of an encoder."""


class Dwell(NamedTuple):
    """A standstill: start [s], inserted length [m] and duration [s]."""

    time: float
    inserted_length: float
    duration: float


@dataclass(frozen=True, eq=False)
class Log:
    """Feed, air and measurements of a rig in SI units; each row is valid until the next one.

    Attributes:
        time: (n,) seconds from the start, strictly increasing.
        inserted_length: (n,) at that time [m], non-decreasing.
        feed_speed: (n,) mean until the next row [m/s], 0 in standstills; its integral is the inserted length.
        air_supply_rate: (n,) mean until the next row [m3/s].
        measured: some of ``MEASURED`` -> (n,) mean or root mean square until the next row [SI].
        repairs: counts of the repairs.
        notes: messages about contradictions in the log.
        deviation: largest distance of the interpolated length from the band of ``CleanLog`` [m].
        gaps: (g, 2) inserted lengths between which rows or eddy-current noise are missing [m].
        faults: what is wrong with measured channels.
        heads: quantity -> heading of its column, as ``--columns`` names it.
    """

    time: FloatArray
    inserted_length: FloatArray
    feed_speed: FloatArray
    air_supply_rate: FloatArray
    measured: Mapping[str, FloatArray] = field(default_factory=lambda: MappingProxyType({}))
    repairs: Repairs = field(default_factory=lambda: Repairs(0))
    notes: tuple[str, ...] = ()
    deviation: float = 0.0
    gaps: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    faults: tuple[Fault, ...] = ()
    heads: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def dwells(self) -> tuple[Dwell, ...]:
        """Standstills of at least one second."""
        edges = np.flatnonzero(np.diff((self.feed_speed[:-1] == 0.0).astype(np.int8), prepend=0, append=0))
        begin, end = edges[::2], edges[1::2]
        rows = np.column_stack([self.time[begin], self.inserted_length[begin], self.time[end] - self.time[begin]])
        return tuple(Dwell(*row) for row in rows.tolist() if row[2] >= DWELL)

    @property
    def channels(self) -> dict[str, FloatArray]:
        """Quantity -> column (n,) of the clean file, in the unit of that column."""
        values = {"inserted_length": self.inserted_length, "feed_speed": self.feed_speed}
        values |= {"air_supply": self.air_supply_rate} | {n: self.measured[n] for n in MEASURED if n in self.measured}
        return {name: column / QUANTITIES[name].scale for name, column in values.items()}

    def to_csv(self) -> str:
        """CSV text in the units of the column names, for ``Schedule.read`` and ``read_log``."""
        columns = {"time": self.time, **self.channels, "air_supply": self.air_supply_rate * HOUR}
        digits = {"time": 12, "inserted_length": 10, "feed_speed": 9}
        texts = {
            QUANTITIES[name].column: [f"{value:.{digits.get(name, 6)}g}" for value in column]
            for name, column in columns.items()
        }
        return f"{CSV_COMMENT} steps\n" + pd.DataFrame(texts).to_csv(index=False, lineterminator="\n")


def read_log(path: str | Path, options: ReadOptions = DETECTED, bounds: Bounds = USUAL) -> Log:
    """Read the log of an inspection rig: text with any separator, a workbook, or a table of pandas.

    Args:
        path: file; "FILE#SHEET" names a sheet of a workbook.
        options: what the file does not say itself.
        bounds: limits of repairs and thinning.

    Raises:
        FileError: the log cannot be read or repaired; names line, column, value and remedy.
    """
    path, sheet = file_and_sheet(path)
    options = options if sheet is None else replace(options, sheet=sheet)
    channels = read_channels(path, options)
    table, whole = channels.table, clean(channels, bounds, options.passage)
    fraction = 0.49 * bounds.tolerance  # for standstills and for interpolation; the rest is for rounding
    rows: IntArray
    if table.steps:  # already a clean file
        length, rows = whole.length.copy(), np.arange(len(whole.time))
    else:
        length, ends = standstills_of(whole.time, whole.length, whole.band, fraction)
        band = np.minimum(whole.band[0], length), np.maximum(whole.band[1], length)
        rows = thin_rows(whole.time, length, band, ends, fraction, bounds.every)
    if len(rows) > MAX_POINTS:
        raise FileError(table.path, f"{len(rows)} rows remain, more than {MAX_POINTS}: raise --every or --tolerance")
    time, rounded = whole.time[rows], np.round(length[rows], DIGITS)
    speed = np.diff(rounded) / np.diff(time)
    if speed.max() > RANGES[FEED][1]:
        k = int(speed.argmax())
        problem = f"the inserted length jumps from {rounded[k]:.6g} to {rounded[k + 1]:.6g} m, at {speed[k]:.4g} m/s"
        hint = "correct the file, or raise --tolerance for a noisy encoder"
        if np.median(speed) > RANGES[FEED][1]:
            hint = "are the units of time and length right? --columns 'HEAD=time[UNIT]' declares one"
            hint = next((note.rstrip(".") for note in channels.notes if "mm:ss" in note), hint)
        first, last = whole.rows[rows[k : k + 2]]
        limit = f"the fastest feed is {RANGES[FEED][1]:g} m/s"
        raise table.error_between(first, last, f"{problem}, but {limit} - {hint}")
    values = {name: group_means(column, rows, QUANTITIES[name].rms) for name, column in whole.values.items()}
    length[rows] = rounded
    deviation = float(outside(whole.time, rows, length, whole.band).max())
    speed, air, measured = np.append(speed, speed[-1]), values.pop("air_supply"), MappingProxyType(values)
    gaps = np.interp(whole.gaps, time, rounded)
    heads = {name: table.name(k) for name, k in channels.indices.items()}
    return Log(time, rounded, speed, air, measured, whole.repairs, whole.notes, deviation, gaps, whole.faults, heads)


def log_segments(log: Log, config: TaskConfig) -> Segments:
    """The metres of a log from its start on, and what is missing to the end of the helix of a task."""
    moving = np.flatnonzero(np.diff(log.inserted_length) > 0.0)
    if not len(moving):
        raise ValueError(f"the log has no metre to judge: the probe stays at {log.inserted_length[0]:g} m")
    begin, end, helix = log.inserted_length[moving], log.inserted_length[moving + 1], config.scene.tube.helix_length
    edges = np.unique([begin[0], *np.arange(math.ceil(begin[0]), end[-1]), end[-1]])
    if helix - end[-1] >= NEAR_END:
        edges = np.append(edges, helix)
    first, last = np.searchsorted(end, edges[:-1], side="right"), np.searchsorted(begin, edges[1:])
    rows = [moving[a:b] for a, b in zip(first, last, strict=True)]  # rows that overlap each metre, none at the end

    def column(values: FloatArray, statistic: Callable[[FloatArray], Any] = np.mean) -> FloatArray:
        return np.array([statistic(values[part]) if len(part) else np.nan for part in rows])

    unknown = np.full(len(log.time), np.nan)
    gaps = (edges[:-1, None] < log.gaps[:, 1]) & (edges[1:, None] > log.gaps[:, 0])
    return Segments(
        begin=edges[:-1],
        end=edges[1:],
        feed=column(log.feed_speed, np.max),
        axial=column(unknown),
        air=column(log.air_supply_rate),
        vibration=column(log.measured.get(NOISE, unknown), lambda values: np.sqrt(np.mean(values**2))),
        tension=column(log.measured.get("root_tension", unknown)),
        missing=gaps.any(axis=1) | (edges[1:] > end[-1]),
    )


def write_repeat(log: Log, name: str, case: EvaluationCase, folder: Path) -> list[Path]:
    """Judge a log by the instrument of a case, whose tubes stand for that of the log; the written files.

    NAME-to-repeat.csv lists the metres to repeat, and repeat-NAME.csv, if there are any, is a schedule of them.
    """
    segments = log_segments(log, case.config)
    intervals = intervals_to_repeat(segments, case.config)
    print_terms({"speed": verdict_text(verdict_of([(segments, intervals)], case.config))})
    texts = {f"{name}-to-repeat.csv": intervals.to_csv(index=False, float_format="%.6g")}
    if len(intervals):
        rows = [(f"{begin:.1f}", f"{end:.1f}", reason) for begin, end, reason in intervals.itertuples(index=False)]
        print_table("Metres to repeat", ("from [m]", "to [m]", "reason"), rows, left=0)
        parts = [(segments, intervals, context) for context in case.contexts]
        texts[f"repeat-{name}.csv"] = repeat_schedule(parts, case.config, case.vibration).to_csv()
    else:
        print_terms({"to repeat": "nothing"})
    for file, text in texts.items():
        write_atomically(folder / file, text)
    return [folder / file for file in texts]


def print_log(log: Log, path: Path) -> None:
    """Print the ranges of the channels, the repairs and the standstills."""
    repairs, dwells = log.repairs, log.dwells
    rows = [
        (name.replace("_", " "), QUANTITIES[name].unit, f"{v.min():.4g}", f"{v.max():.4g}")
        for name, v in log.channels.items()
    ]
    print_table(one_line(path.name), ("channel", "unit", "least", "most"), rows, left=2)
    start, end = log.inserted_length[[0, -1]]
    terms = {
        "rows": f"{repairs.rows} in the log, {len(log.time)} in the clean file",
        "duration": f"{log.time[-1]:.6g} s",
        "length": f"{start:.4f} m to {end:.4f} m, within {1e3 * log.deviation:.2f} mm at every row",
        "gaps": f"{repairs.gaps} interpolated, the longest {repairs.max_gap:.3g} s",
        "missing": f"{repairs.missing} values interpolated",
        "no time": f"{repairs.untimed} rows dropped",
        "duplicates": f"{repairs.duplicates} rows averaged with the row of equal time",
        "backward": f"{repairs.backward} rows smoothed, by at most {1e3 * repairs.max_backward:.2g} mm",
        "dwells": str(len(dwells)),
    }
    print_terms({name: "none" if text.split()[0] == "0" else text for name, text in terms.items()})
    if dwells:
        title = f"standstills, the first {DWELLS_SHOWN}" if len(dwells) > DWELLS_SHOWN else "standstills"
        rows_of_dwells = [(f"{d.inserted_length:.3f}", f"{d.time:.2f}", f"{d.duration:.2f}") for d in dwells]
        print_table(title, ("at [m]", "from [s]", "lasting [s]"), rows_of_dwells[:DWELLS_SHOWN], left=0)
    for text in (*log.notes, *(f"The column {fault.text}." for fault in log.faults)):
        print_terms({"note": text})
    config = TaskConfig()
    for name, limits, effect in (
        ("feed_speed", config.feed_speeds, "alternates stops and starts below it, and lags above it"),
        ("air_supply", config.air_supply_rates, "clips it"),
    ):
        values, unit, scale = log.channels[name], QUANTITIES[name].unit, QUANTITIES[name].scale
        low, high = (limit / scale for limit in limits)
        below, above = (values < low * (1.0 - 1e-6)).sum(), (values > high * (1.0 + 1e-6)).sum()
        if below or above:
            text = f"The {name.replace('_', ' ')} is outside the task's range {low:g} to {high:g} {unit}"
            print_terms({"note": f"{text}: {below} rows are below and {above} above it. A replay {effect}."})


def check_picture(path: Path) -> None:
    """Raise ValueError unless the file name ends with a supported figure format."""
    if path.suffix not in PICTURES:
        raise ValueError(f"plot = {str(path)!r} is not a picture: its name must end with one of {', '.join(PICTURES)}")


def draw_log(log: Log, path: Path) -> Path:
    """Draw a log: one row per channel, over time on the left and over inserted length on the right."""
    from matplotlib.figure import Figure

    from probe_agents.records.drawing import BLUE, save

    figure = Figure(figsize=(10.0, 1.0 + 1.6 * len(log.channels)), layout="constrained")
    axes = figure.subplots(len(log.channels), 2, sharex="col", sharey="row", squeeze=False)
    for (left, right), (name, column) in zip(axes, log.channels.items(), strict=True):
        left.set_ylabel(f"{name.replace('_', ' ')}\n[{QUANTITIES[name].unit}]", fontsize=8)
        style = "default" if name == "inserted_length" else "steps-post"
        for axis, where in ((left, log.time), (right, log.inserted_length)):
            axis.plot(where, column, color=BLUE, linewidth=1.0, drawstyle=style)
    axes[-1][0].set_xlabel("time [s]")
    axes[-1][1].set_xlabel("inserted length [m]")
    return save(figure, path)
