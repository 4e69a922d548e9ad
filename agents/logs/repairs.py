"""Repairs of a log's columns, each with its bound: means of rows, missing values, the encoder's noise."""

from __future__ import annotations

from typing import Final

import numpy as np

from agents.logs.channels import Channels
from agents.logs.tables.table import IntArray, Table
from probe_env.arrays import FloatArray
from probe_env.files import FileError
from probe_env.schedule import POSITIONS

AGREEMENT: Final = 0.05, 0.02
"""What the speed's integral may differ from the encoder [m], and as a share of the length that was fed."""


def portion_means(values: FloatArray, first: IntArray, rms: bool) -> FloatArray:
    """Means, or for ``rms`` roots of mean squares, of portions that begin at the rows ``first``; NaN where none is."""
    if len(first) == len(values):
        return values
    there = ~np.isnan(values)
    powers = np.where(there, values**2 if rms else values, 0.0)
    with np.errstate(invalid="ignore"):
        means = np.add.reduceat(powers, first) / np.add.reduceat(there.astype(float), first)
    return np.asarray(np.sqrt(means) if rms else means)


def bridged(
    channels: Channels, name: str, time: FloatArray, column: FloatArray, rows: IntArray, gap: float
) -> FloatArray:
    """A column (n,) with what is missing on straight lines; raises FileError where it lasts longer than ``gap`` [s]."""
    there = np.flatnonzero(~np.isnan(column))
    if len(there) == len(column):
        return column
    table, k = channels.table, channels.places[name]
    if not len(there):
        raise table.error(0, "no value in the whole column", k)
    edges = np.concatenate([[0], there, [len(column) - 1]])  # the ends hold the nearest value
    holes = np.diff(edges) > 1
    lasting = np.where(holes, np.diff(time[edges]), 0.0)
    if lasting.max() > gap:
        j = int(lasting.argmax())
        problem = f"column {table.heads[k]!r} has no values for {lasting[j]:.6g} s"
        raise between(table, rows[edges[j]], rows[edges[j + 1]], problem, gap)
    return np.asarray(np.interp(time, time[there], column[there]))


def between(table: Table, first: int, last: int, problem: str, gap: float) -> FileError:
    """What is wrong between two rows, for a line of text."""
    place = f"{table.row_word}s {table.lines[first]} to {table.lines[last]}"
    return FileError(
        table.path, f"{place}: {problem}, more than the {gap:g} s that are bridged - cut the file there, or --gap"
    )


def integral(time: FloatArray, speed: FloatArray, steps: bool) -> FloatArray:
    """Length (n,) that a speed has fed [m]."""
    means = speed[:-1] if steps else 0.5 * (speed[1:] + speed[:-1])
    return np.concatenate([[0.0], np.cumsum(means * np.diff(time))])


def disagreement(time: FloatArray, by_encoder: FloatArray, by_speed: FloatArray) -> tuple[str, ...]:
    """A sentence, if lengths (n,) by encoder and by speed [m] are further apart than ``AGREEMENT``."""
    allowed = AGREEMENT[0] + AGREEMENT[1] * np.abs(by_encoder)
    excess = np.abs(by_speed - by_encoder) - allowed
    k = int(excess.argmax())
    if excess[k] <= 0.0:
        return ()
    return (
        f"The speed column and the encoder disagree: {by_speed[k]:.4g} m and {by_encoder[k]:.4g} m are fed up to"
        f" {time[k]:.4g} s, more than {AGREEMENT[0]:g} m and {100 * AGREEMENT[1]:g} % apart; the encoder is taken.",
    )


def band(
    channels: Channels, length: FloatArray, rows: IntArray, backward: float, encoder: bool
) -> tuple[FloatArray, FloatArray]:
    """Least length (n,) from each row on, and greatest up to it [m]: neither falls."""
    before = np.maximum.accumulate(length)
    behind = before - length
    table = channels.table
    if behind.max() > backward:
        row = int((behind > backward).argmax())
        k = channels.places["inserted_length" if encoder else "feed_speed"]
        raise table.error(
            rows[row],
            f"the probe moves back to {length[row]:.6g} m from {before[row]:.6g} m, more than the {backward:g} m that"
            " are taken for noise - a log is of the way in: cut the file there, or --backward",
            k,
        )
    most = POSITIONS["inserted_length_m"][1]
    if length.max() > most:
        raise table.error(rows[int(length.argmax())], f"a length of {length.max():.6g} m is more than {most:g} m")
    return np.minimum.accumulate(length[::-1])[::-1], before
