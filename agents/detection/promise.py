"""Calls promised and counted, the ``false_calls`` that keeps the promise, and what depths would be with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
import pandas as pd

from agents.rollouts.bootstrap import PERCENTILES, redrawn
from agents.rollouts.depths import a90_95
from agents.rollouts.statistics import mean_interval
from probe_env.arrays import FloatArray
from probe_env.envs.task import TaskConfig
from probe_env.inspection.detection import threshold
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.tally import POD_NAMES, DetectionTally, curve

DRAWS: Final = 40
"""Of the electronic noise over one and the same motion."""
FIELDS: Final = ("lengths", "snr", "shares", "peaks", "singles", "counts")
"""Of ``DetectionTally``."""
SHARES: Final = 10.0 ** np.linspace(0.0, -3.0, 31)
"""Of the calls that are promised, what thresholds are set for until no more are counted than were promised."""
DEPTH: Final = "inspected_a90_95_percent_wall"
KEPT_DEPTH: Final = f"kept_{DEPTH}"


def tally_of(sensor: Sensor, heard: Mapping[str, Sequence[float]]) -> DetectionTally:
    """The tally whose fields were stored."""
    lists = {name: list(values) for name, values in heard.items() if name != "counts"}
    return DetectionTally(sensor, **lists, counts=np.array(heard["counts"]))


def set_for(tally: DetectionTally, length: float) -> FloatArray:
    """Its thresholds [deviations], set for each of ``SHARES`` of the calls promised; the first is its own."""
    fewer = (tally.sensor.model_copy(update={"false_calls": share * tally.sensor.false_calls}) for share in SHARES)
    return np.array([replace(tally, sensor=sensor).threshold(length) for sensor in fewer])


def keeping(calls: FloatArray, promised: float) -> int:
    """Index of the largest of ``SHARES`` with no more calls than promised, in the mean over tubes (n, shares).

    The least where all have more.
    """
    few = calls.mean(axis=0) <= promised
    return int(few.argmax()) if few.any() else len(SHARES) - 1


def summarise(config: TaskConfig, counted: Mapping[str, Sequence[Mapping[str, Any]]]) -> pd.DataFrame:
    """A row a policy: calls a tube, promised and counted, the ``false_calls`` that keeps the promise, depths.

    All have 95 % intervals over tubes. Depths are those with the thresholds as they are, and as that setting has them.

    Args:
        config: the task.
        counted: fields of ``false_calls.Count`` of each insertion, by policy.

    Raises:
        RuntimeError: there is no insertion of a policy.
    """
    rows = []
    for name, records in counted.items():
        if not records:
            raise RuntimeError(f"policy {name}: all insertions diverged")
        rows.append({"policy": name, "tubes": len(records)} | _row(config, records))
    return pd.DataFrame(rows)


def _row(config: TaskConfig, records: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    sensor, length = config.sensor, config.scene.tube.helix_length
    tallies = [tally_of(sensor, record["heard"]) for record in records]
    heights = [np.array(record["heights"], dtype=float) for record in records]
    z = np.array([set_for(tally, length) for tally in tallies])
    calls = np.array([(own[:, None] > levels).sum(axis=0) for own, levels in zip(heights, z, strict=True)]) / DRAWS
    of_all = np.array([record["threshold_of_all"] for record in records])
    calls_of_all = np.array([(own > level).sum() for own, level in zip(heights, of_all, strict=True)]) / DRAWS
    inspected = float(np.mean([sum(tally.lengths) for tally in tallies]))
    promised = sensor.false_calls * inspected / length
    redrawn_kept = [keeping(calls[drawn], promised) for (drawn,) in redrawn(len(calls))]
    kept, first, last = (keeping(calls, promised), *np.percentile(redrawn_kept, PERCENTILES, method="nearest"))
    return {
        "call_threshold": z[:, 0].mean(),
        "gaussian_threshold": threshold(sensor, length),
        "threshold_of_all": of_all.mean(),
        "promised": promised,
        **_interval("calls", calls[:, 0]),
        **_interval("calls_of_all", calls_of_all),
        # the later a share, the fewer calls and the greater the depth
        **dict(zip(_ends("kept_false_calls"), sensor.false_calls * SHARES[[kept, last, first]], strict=True)),
        DEPTH: _depth(tallies, z[:, 0]),
        **{name: _depth(tallies, z[:, k]) for name, k in zip(_ends(KEPT_DEPTH), (kept, first, last), strict=True)},
    }


def _ends(name: str) -> tuple[str, str, str]:
    """Columns of a figure and of its interval's ends."""
    return name, f"{name}_low", f"{name}_high"


def _interval(name: str, values: FloatArray) -> dict[str, float]:
    interval = mean_interval(values)
    return dict(zip(_ends(name), (interval.mean, interval.low, interval.high), strict=True))


def _depth(tallies: Sequence[DetectionTally], z: FloatArray) -> float:
    """a90/95 over the tubes with these thresholds, in what each inspected [% of the wall]."""
    rows = []
    for k, (tally, own) in enumerate(zip(tallies, z, strict=True)):
        mean = curve(np.array(tally.lengths), tally.pod(float(own)), sum(tally.lengths))
        rows.append({"policy": "", "context": k, "seed": 0} | dict(zip(POD_NAMES, mean, strict=True)))
    return a90_95(pd.DataFrame(rows), "")


HEADER: Final = (
    "policy", "mean threshold", "calls a tube promised", "counted", "counted, had it heard all", "`false_calls` that"
    " keeps the promise", "a90/95 [%]", "a90/95 with it [%]",
)  # fmt: skip


def cells(summary: pd.DataFrame) -> list[tuple[str, ...]]:
    """A row a policy."""
    return [
        (
            str(row["policy"]), f"{row['call_threshold']:.2f}", f"{row['promised']:.2g}",
            *(_text([row[end] for end in _ends(name)], ".2f") for name in ("calls", "calls_of_all")),
            _text([row[end] for end in _ends("kept_false_calls")], ".2g"),
            f"{row[DEPTH]:.1f}", _text([row[end] for end in _ends(KEPT_DEPTH)], ".1f"),
        )
        for row in summary.to_dict("records")
    ]  # fmt: skip


def _text(values: Sequence[float], style: str) -> str:
    """A figure with its interval, which one tube has not."""
    mean, low, high = (f"{value:{style}}" for value in values)
    return mean if values[1] == values[2] else f"{mean} [{low}, {high}]"
