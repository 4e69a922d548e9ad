"""An insertion as inspection software shows it: channels, strip chart, Lissajous figures, calls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from scipy.stats import spearmanr

from agents.evaluation import figures, statistics
from agents.evaluation.folder import read_episodes
from agents.evaluation.recording import Chart, Insertion, insert
from agents.evaluation.statistics import grouped
from agents.policies.catalogue import make_policy
from agents.policies.places import Place
from agents.records.atomic import write_atomically
from agents.records.manifest import write_json, write_manifest
from agents.terminal.tables import print_table
from probe_env.envs.task import TaskConfig
from probe_env.fidelity import resolve_fidelity
from probe_env.inspection.channels import (
    Flaw,
    along,
    calls,
    channels,
    filtered,
    smoothed,
    support_places,
    support_signal,
)
from probe_env.inspection.detection import snr_at
from probe_env.inspection.sensor import GROOVE
from probe_env.settings import within

SPACING: Final = 1.0
"""Distance of the supports [m] by default; an assumption."""
DRAWN: Final = 6
"""Greatest number of flaws in flaws.png."""
ROWS: Final = ("place_m", "depth_percent_wall", "snr", "behind_filter", "called")


def flaws_of(texts: Sequence[str], length: float) -> tuple[Flaw, ...]:
    """Flaws written as PLACE:DEPTH, metres and % of the wall; none: 20 % every 5 m.

    Raises:
        ValueError: not so written, or out of range.
    """
    if not texts:
        return tuple(Flaw(float(place), GROOVE) for place in np.arange(5.0, length, 5.0))
    flaws = []
    for text in texts:
        place, _, depth = text.partition(":")
        try:
            flaw = Flaw(float(place), float(depth) / 100.0)
        except ValueError:
            raise ValueError(f"flaws: {text!r} is not PLACE:DEPTH, metres and % of the wall, such as 30:20") from None
        within(f"flaws: place of {text!r}", flaw.place, 0.0, length, "m")
        within(f"flaws: depth of {text!r}", 100.0 * flaw.depth, 0.1, 100.0, "%")
        flaws.append(flaw)
    return tuple(sorted(flaws, key=lambda flaw: flaw.place))


@dataclass(frozen=True)
class Look:
    """What is recorded.

    Attributes:
        context: number of the tube in the list.
        flaws: PLACE:DEPTH each, see ``flaws_of``.
        support_spacing: distance of the supports [m]; None: ``SPACING``.
        until: inserted length at which to stop [m]; None: the end of the helix.
        seed: of sensor noise, start and electronic noise.
    """

    context: int = 0
    flaws: Sequence[str] = ()
    support_spacing: float | None = None
    until: float | None = None
    seed: int = 0


def run_signal(spec: str, place: Place, fidelity: str, look: Look, output: Path) -> pd.DataFrame:
    """Simulate an insertion; prints its flaws, writes channels, flaws and periods.csv, signal.json and two figures.

    Returns:
        a row for each flaw that the sensor passed.

    Raises:
        ValueError: an argument is not valid; nothing was written.
        RuntimeError: the simulation diverged; nothing was written.
    """
    config = place.config.full_observation
    spacing = SPACING if look.support_spacing is None else look.support_spacing
    within("context", look.context, 0, len(place.contexts) - 1, "")
    within("support_spacing", spacing, 0.05, 100.0, "m")
    flaws = flaws_of(look.flaws, config.scene.tube.helix_length)
    policy = make_policy(spec, config, place.vibration, classes=True)
    settings = resolve_fidelity(fidelity, config.scene)
    run = insert(policy, config, place.contexts[look.context], settings, look.seed, look.until)
    chart = chart_of(run, config, flaws, spacing, np.random.default_rng([look.seed, look.context]))
    _write(run, chart, f"{spec}, tube {look.context}, {fidelity}", output)
    record = {
        "sensor": config.sensor.model_dump(), "threshold": chart.threshold, "false_calls": chart.false_calls,
        "noise_and_vibration_correlation": correlation(run, chart), "found": run.detection,
    }  # fmt: skip
    write_json(output / "signal.json", record)
    files = ("channels.csv", "flaws.csv", "periods.csv", "signal.json")
    write_manifest(output, files, seeds=(look.seed,))
    first, last = run.passage.place[[0, -1]]
    for flaw in flaws:
        if flaw not in chart.flaws:
            print(f"not passed: the flaw at {flaw.place:g} m; the sensor was from {first:.2f} to {last:.2f} m")
    header = ("flaw at [m]", "depth [% wall]", "S/N", "behind the filter", "called")
    rows = [
        (f"{place_:g}", f"{depth:g}", f"{snr:.1f}", f"{behind:.1f}", "yes" if called else "no")
        for place_, depth, snr, behind, called in chart.table[list(ROWS)].itertuples(index=False)
    ]
    print_table("Flaws that were put into the tube", header, rows, left=0)
    print(f"called: {int(chart.table['called'].sum())} of the {len(chart.table)} flaws that were passed")
    print(f"written: {output}/ (strip.png, flaws.png, channels.csv, flaws.csv, periods.csv, signal.json)")
    return chart.table


def chart_of(
    run: Insertion, config: TaskConfig, put: Sequence[Flaw], spacing: float, rng: np.random.Generator
) -> Chart:
    """Signals of an insertion with flaws in its tube; the known supports are subtracted before the filter."""
    passage, sensor, tube = run.passage, config.sensor, config.scene.tube
    first, last = float(passage.place[0]) + sensor.flaw_width, float(passage.place[-1]) - sensor.flaw_width
    flaws = tuple(flaw for flaw in put if first < flaw.place < last)
    supports = support_places(spacing, last)
    voltages = channels(sensor, passage, tube.inner_diameter, flaws, supports, rng)
    seen = along(sensor, voltages - support_signal(sensor, passage.place, supports)[:, None])
    place, values = passage.place, filtered(sensor, passage, seen)
    z = run.detection["call_threshold"]
    called = calls(values, place, z, sensor.flaw_width)
    ends = np.array([period["inserted_length"] for period in run.periods])
    ends += passage.place[-1] - ends[-1]
    rows = []
    for flaw in flaws:
        near = np.abs(place - flaw.place) < 0.5 * sensor.flaw_width
        groove = run.periods[int(np.searchsorted(ends, flaw.place).clip(0, len(ends) - 1))]["snr"]
        shown = float(values[near].max()) if near.any() else 0.0
        snr = float(snr_at(sensor, np.array([groove]), np.array([flaw.depth]))[0, 0])
        rows.append((flaw.place, 100.0 * flaw.depth, snr, shown, shown > z))
    false = sum(all(abs(call - flaw.place) > sensor.flaw_width for flaw in flaws) for call in called)
    table = pd.DataFrame(rows, columns=list(ROWS))
    return Chart(voltages, values, flaws, supports, called, z, table, false)


def _write(run: Insertion, chart: Chart, title: str, output: Path) -> None:
    output.mkdir(parents=True, exist_ok=True)
    passage = run.passage
    columns = {
        "time_s": passage.time, "place_m": passage.place, "feed_speed_m_per_s": passage.feed,
        "x_v": chart.voltages[:, 0], "y_v": chart.voltages[:, 1],
    }  # fmt: skip
    write_atomically(output / "channels.csv", pd.DataFrame(columns).to_csv(index=False, float_format="%.6g"))
    write_atomically(output / "flaws.csv", chart.table.to_csv(index=False, float_format="%.5g"))
    write_atomically(output / "periods.csv", by_period(run, chart).to_csv(index=False, float_format="%.5g"))
    figures.strip_chart(run, chart, title, output / "strip.png")
    if chart.flaws:
        kept = np.unique(np.linspace(0, len(chart.flaws) - 1, DRAWN).astype(int))
        figures.grooves(run, chart.voltages, [chart.flaws[k] for k in kept], output / "flaws.png")


def correlation(run: Insertion, chart: Chart) -> float:
    """Spearman correlation of the deviation of X with the radial rms by control period; NaN if one is constant."""
    table = by_period(run, chart)
    noise, vibration = table["x_deviation_v"], table["radial_rms_m"]
    if min(np.ptp(noise), np.ptp(vibration)) == 0.0 or len(noise) < 3:
        return float("nan")
    return float(spearmanr(noise, vibration).statistic)


def by_period(run: Insertion, chart: Chart) -> pd.DataFrame:
    """A row for each control period: position of the sensor at its end, deviation of X and Y, vibration, S/N."""
    each = run.period
    shown = smoothed(run.passage, chart.voltages)[: len(run.periods) * each].reshape(-1, each, 2).std(axis=1)
    return pd.DataFrame(
        {
            "place_m": run.passage.place[each - 1 :: each], "x_deviation_v": shown[:, 0], "y_deviation_v": shown[:, 1],
            **{name: [period[name] for period in run.periods] for name in ("radial_rms_m", "snr")},
        }
    )  # fmt: skip


def draw_curves(evaluation: Path, output: Path) -> None:
    """Detection curves of a stored evaluation: writes pod.csv and pod.png, prints the depths found.

    Raises:
        FileNotFoundError: there is no such evaluation.
        ValueError: its episodes have no detection curves.
    """
    table = grouped(read_episodes(evaluation / "episodes.parquet"))
    if not statistics.has_curves(table):
        raise ValueError(f"{evaluation}: its episodes have no curves of detection: run the evaluation again")
    curves = statistics.bands(table)
    output.mkdir(parents=True, exist_ok=True)
    write_atomically(output / "pod.csv", curves.to_csv(index=False, float_format="%.5g"))
    figures.curves(curves, output / "pod.png")
    header = ("policy", "a50 [% wall]", "a90 [% wall]", "a90/95 [% wall]")
    rows = [
        (str(row[0]), *(f"{value:.1f}" for value in row[1:])) for row in statistics.depths_of(table).to_numpy().tolist()
    ]
    print_table(f"Depths found, over {table['context'].nunique()} tubes", header, rows)
    print(f"written: {output}/ (pod.png, pod.csv)")
