"""A log on the terminal: ranges of its channels, what was mended, where the probe stood still."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from agents.logs.log import Log
from agents.logs.quantities import MEASURED, QUANTITIES
from agents.terminal.tables import print_table, print_terms
from probe_env.arrays import FloatArray
from probe_env.envs.task import TaskConfig
from probe_env.files import one_line

DWELLS_SHOWN: Final = 10
HOUR: Final = 3600.0


def channels(log: Log) -> dict[str, FloatArray]:
    """Quantity -> its column (n,) of the clean file, in that column's unit."""
    values = {
        "inserted_length": log.inserted_length, "feed_speed": log.feed_speed, "air_supply": log.air_supply_rate,
        **{name: log.measured[name] for name in MEASURED if name in log.measured},
    }  # fmt: skip
    return {name: column / QUANTITIES[name].scale for name, column in values.items()}


def print_log(log: Log, path: Path) -> None:
    """Print what a log holds and what was mended."""
    mended = log.mended
    rows = [
        (name.replace("_", " "), QUANTITIES[name].unit, f"{v.min():.4g}", f"{v.max():.4g}")
        for name, v in channels(log).items()
    ]
    print_table(one_line(path.name), ("channel", "unit", "least", "most"), rows, left=2)
    start, end = log.inserted_length[[0, -1]]
    terms = {
        "rows": f"{mended.rows}, of which {len(log.time)} are written",
        "duration": f"{log.time[-1]:.6g} s",
        "length": f"{start:.4f} m to {end:.4f} m, within {1e3 * log.deviation:.2f} mm at every row",
        "gaps": _counted(mended.gaps, f"bridged, the longest of {mended.longest_gap:.3g} s"),
        "missing": _counted(mended.missing, "values interpolated"),
        "no time": _counted(mended.untimed, "rows left out"),
        "duplicates": _counted(mended.duplicates, "rows averaged with the one of the same time"),
        "backward": _counted(mended.backward, f"rows smoothed, by {1e3 * mended.most_backward:.2g} mm at most"),
        "dwells": str(len(log.dwells) or "none"),
    }
    print_terms(terms)
    if log.dwells:
        print_table(
            f"standstills, the first {DWELLS_SHOWN}" if len(log.dwells) > DWELLS_SHOWN else "standstills",
            ("at [m]", "from [s]", "lasting [s]"),
            [(f"{d.inserted_length:.3f}", f"{d.time:.2f}", f"{d.duration:.2f}") for d in log.dwells[:DWELLS_SHOWN]],
            left=0,
        )
    for text in (*log.notes, *beyond_task(log)):
        print_terms({"note": text})


def beyond_task(log: Log, config: TaskConfig | None = None) -> tuple[str, ...]:
    """Sentences about what the task's feed device and air supply do not give."""
    config = config or TaskConfig()
    sentences = []
    for name, values, (low, high) in (
        ("feed speed", log.feed_speed, config.feed_speeds),
        ("air supply", log.air_supply_rate, config.air_supply_rates),
    ):
        unit, scale = ("m/s", 1.0) if name == "feed speed" else ("m3/h", HOUR)
        below, above = (values < low * (1.0 - 1e-6)).sum(), (values > high * (1.0 + 1e-6)).sum()
        if below or above:
            sentences.append(
                f"The {name} leaves the task's range of {low * scale:g} to {high * scale:g} {unit}: {below} rows are"
                f" below and {above} above it. "
                + (
                    "A replay stops and starts below it, and falls behind above it."
                    if name == "feed speed"
                    else "A replay takes the nearest of these."
                )
            )
    return tuple(sentences)


def _counted(count: int, text: str) -> str:
    return f"{count} {text}" if count else "none"
