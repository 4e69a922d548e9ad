"""Sensor signals of an insertion: channels, strip chart, Lissajous figures, calls."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from scipy.stats import spearmanr
from tqdm import tqdm

from probe_agents.evaluation import figures, statistics
from probe_agents.evaluation.folder import read_episodes
from probe_agents.policies.cases import EvaluationCase
from probe_agents.policies.catalogue import make_policy
from probe_agents.policies.policy import Policy
from probe_agents.records.atomic import write_atomically
from probe_agents.records.drawing import BLUE, GREY, MM, RED, escape_dollars, save
from probe_agents.records.manifest import write_json, write_manifest
from probe_agents.terminal.tables import print_line, print_table
from probe_env import Context, Fidelity
from probe_env.arrays import FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.rules import END_TOLERANCE
from probe_env.envs.trials import rollout
from probe_env.fidelity import resolve_fidelity
from probe_env.inspection.channels import (
    Flaw,
    Recording,
    along_flaw,
    calls,
    channels,
    filtered,
    smoothed,
    support_positions,
    support_signal,
)
from probe_env.inspection.detection import snr_at
from probe_env.inspection.metrics import with_pod_columns
from probe_env.inspection.sensor import GROOVE, Sensor
from probe_env.inspection.snr import SPAN, SnrEstimator
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.settings import within

FILTER_SAMPLES: Final = round(0.25 * SPAN / SAMPLE_PERIOD)
"""Samples with one spectrum of the filter: a quarter of the second that the spectrum is estimated from."""
SPACING: Final = 1.0
"""Default distance of the supports [m]; an assumption."""
DRAWN: Final = 6
"""Maximum number of flaws in flaws.png."""
AROUND: Final = 0.025
"""Half the length along the tube in a flaw's figure [m]."""
ROWS: Final = ("place_m", "depth_percent_wall", "snr", "behind_filter", "called")


@dataclass(frozen=True)
class Insertion:
    """Samples and control periods of an insertion.

    Attributes:
        recording: time, position, feed and motion of every sample.
        periods: info of every control period, SI units.
        detection: detection figures by name of the inspected length, see ``inspection.metrics``.
    """

    recording: Recording
    periods: tuple[dict[str, Any], ...]
    detection: dict[str, float]


@dataclass(frozen=True)
class Chart:
    """The signals of an insertion.

    Attributes:
        voltages: (k, 2) X and Y [V].
        values: (k,) filtered signal, in standard deviations of its noise.
        flaws: flaws that the sensor passed.
        supports: positions of the supports [m].
        called: positions of the calls [m].
        table: one row per flaw: position, depth, S/N, filtered signal, whether it was called.
    """

    voltages: FloatArray
    values: FloatArray
    flaws: tuple[Flaw, ...]
    supports: FloatArray
    called: FloatArray
    table: pd.DataFrame


def run_signal(
    spec: str,
    case: EvaluationCase,
    fidelity: str,
    output: Path,
    *,
    context: int = 0,
    flaws: Sequence[str] = (),
    support_spacing: float | None = None,
    until: float | None = None,
    seed: int = 0,
) -> pd.DataFrame:
    """Simulate an insertion, print its flaws, and write channels.csv, flaws.csv, periods.csv, signal.json and figures.

    Args:
        spec: spec of the policy, see ``catalogue.make_policy``.
        case: task, tubes and map.
        fidelity: preset; its time-lapse is not used.
        output: folder.
        context: index of the tube in the list.
        flaws: POSITION:DEPTH, see ``flaws_of``.
        support_spacing: distance of the supports [m]; None: ``SPACING``.
        until: inserted length at the end [m]; None: the end of the helix.
        seed: seed of sensor noise, start and electronic noise.

    Returns:
        one row per flaw that the sensor passed.

    Raises:
        RuntimeError: the simulation diverged; nothing was written.
    """
    config, spacing = case.config.full_observation, SPACING if support_spacing is None else support_spacing
    within("context", context, 0, len(case.contexts) - 1, "")
    within("support_spacing", spacing, 0.05, 100.0, "m")
    all_flaws = flaws_of(flaws, config.scene.tube.helix_length)
    policy = make_policy(spec, config, case.vibration, classes=True)
    run = insert(policy, config, case.contexts[context], resolve_fidelity(fidelity, config.scene), seed, until)
    chart = chart_of(run, config, all_flaws, spacing, np.random.default_rng([seed, context]))
    _write(run, chart, config.sensor, f"{spec}, tube {context}, {fidelity}", output, seed)
    first, last = run.recording.position[[0, -1]]
    for flaw in all_flaws:
        if flaw not in chart.flaws:
            print(f"not passed: the flaw at {flaw.position:g} m; the sensor moved from {first:.2f} to {last:.2f} m")
    header = ("flaw at [m]", "depth [% wall]", "S/N", "after the filter", "detected")
    rows = [
        (f"{position:g}", f"{depth:g}", f"{snr:.1f}", f"{behind:.1f}", "yes" if called else "no")
        for position, depth, snr, behind, called in chart.table[list(ROWS)].itertuples(index=False)
    ]
    print_table("Flaws", header, rows, left=0)
    print(f"detected: {int(chart.table['called'].sum())} of the {len(chart.table)} flaws that the sensor reached")
    print_line(f"written: {output}/ (strip.png, flaws.png, channels.csv, flaws.csv, periods.csv, signal.json)")
    return chart.table


def flaws_of(texts: Sequence[str], length: float) -> tuple[Flaw, ...]:
    """Flaws from texts POSITION:DEPTH, in metres and % of the wall; default: 20 % every 5 m."""
    if not texts:
        return tuple(Flaw(float(position), GROOVE) for position in np.arange(5.0, length, 5.0))
    flaws = []
    for text in texts:
        position, _, depth = text.partition(":")
        try:
            flaw = Flaw(float(position), float(depth) / 100.0)
        except ValueError:
            raise ValueError(
                f"flaws: {text!r} is not POSITION:DEPTH, metres and % of the wall, such as 30:20"
            ) from None
        within(f"flaws: position of {text!r}", flaw.position, 0.0, length, "m")
        within(f"flaws: depth of {text!r}", 100.0 * flaw.depth, 0.1, 100.0, "%")
        flaws.append(flaw)
    return tuple(sorted(flaws, key=lambda flaw: flaw.position))


def insert(
    policy: Policy, config: TaskConfig, context: Context, fidelity: Fidelity, seed: int, until: float | None = None
) -> Insertion:
    """Record an insertion up to an inserted length [m] (default: the end of the helix), or until the episode ends.

    The time-lapse of the fidelity is not used: it would skip metres of the tube. The seed is that of sensor noise and
    start.

    Raises:
        RuntimeError: the simulation diverged.
    """
    length = config.scene.tube.helix_length
    if until is not None:
        within("until", until, 5.0, length, "m")
    every_metre = fidelity.model_copy(update={"time_lapse": 1.0, "steady_feed": None})
    episodes = Episodes(1, config, threads=1, allow_standstill=True, fidelity=every_metre)
    observation, started = episodes.reset([0], {0: np.random.default_rng(seed)}, {0: {"context": context}})
    guide = episodes.simulated().simulators[0].scene.probe.guide_length
    positions, periods, radial = [started[0]["inserted_length"] - guide], list[dict[str, Any]](), []
    with tqdm(desc="sensor at", initial=positions[0], unit="m", bar_format="{desc} {n:.1f} {unit} [{elapsed}]") as bar:
        for step, _ in rollout(episodes, [policy], observation):
            info = step.infos[0]
            if info["diverged"]:
                raise RuntimeError(f"the simulation diverged at {info['inserted_length']:.4g} m; nothing was written")
            assert episodes.window is not None
            assert episodes.window.radial is not None
            radial.append(episodes.window.radial[:, 0])
            bar.update(info["inserted_length"] - guide - positions[-1])
            positions.append(info["inserted_length"] - guide)
            periods.append(info)
            if until is not None and info["inserted_length"] >= until - END_TOLERANCE:
                break
    each = len(radial[0])
    fraction = np.arange(1, each + 1) / each
    motion, feed = np.concatenate(radial), np.repeat([period["feed_speed"] for period in periods], each)
    recording = Recording(
        time=SAMPLE_PERIOD * np.arange(1, each * len(radial) + 1),
        position=np.concatenate([begin + fraction * (end - begin) for begin, end in itertools.pairwise(positions)]),
        feed=feed,
        radial=motion,
        spectrum=centred_spectra(config.sensor, motion, feed),
        segment=FILTER_SAMPLES,
    )
    inspected = float(episodes.scorer.totals["inspected"][0])
    found = episodes.scorer.signals[0].detection.kpis(inspected, length)
    return Insertion(recording, tuple(periods), with_pod_columns(found))


def centred_spectra(sensor: Sensor, radial: FloatArray, feed: FloatArray) -> FloatArray:
    """(p, m) noise densities for each ``FILTER_SAMPLES`` of motion (k,) [m] and feed speed (k,) [m/s].

    They are estimated from the second around it, as in the KPIs. With an estimate from the past alone, the start of a
    burst would exceed the threshold.
    """
    estimator, spectra = SnrEstimator(sensor, 1, SAMPLE_PERIOD), []
    # the first piece is half as long, so that each second ends half a piece after one
    ends = list(range(FILTER_SAMPLES // 2, len(radial) + 1, FILTER_SAMPLES)) or [len(radial)]
    for begin, end in itertools.pairwise([0, *ends]):
        estimator.update(np.zeros(1, dtype=np.int64), radial[begin:end, None], feed[begin : begin + 1])
        spectra.append(estimator.filter_spectrum(0))
    # the second ends half a piece after the next one; the last pieces use the last estimate
    last = np.minimum(np.arange(math.ceil(len(radial) / FILTER_SAMPLES)) + 2, len(spectra) - 1)
    return np.array(spectra)[last]


def chart_of(
    run: Insertion, config: TaskConfig, flaws: Sequence[Flaw], spacing: float, rng: np.random.Generator
) -> Chart:
    """Signals of an insertion with flaws; the signals of the supports are subtracted before the filter."""
    recording, sensor, tube = run.recording, config.sensor, config.scene.tube
    first, last = float(recording.position[0]) + sensor.flaw_width, float(recording.position[-1]) - sensor.flaw_width
    flaws = tuple(flaw for flaw in flaws if first < flaw.position < last)
    supports = support_positions(spacing, last)
    voltages = channels(sensor, recording, tube.inner_diameter, flaws, supports, rng)
    signal = along_flaw(sensor, voltages - support_signal(sensor, recording.position, supports)[:, None])
    values, threshold = filtered(sensor, recording, signal), run.detection["call_threshold"]
    ends = np.array([period["inserted_length"] for period in run.periods])
    ends += recording.position[-1] - ends[-1]
    rows = []
    for flaw in flaws:
        near = np.abs(recording.position - flaw.position) < 0.5 * sensor.flaw_width
        groove = run.periods[int(np.searchsorted(ends, flaw.position).clip(0, len(ends) - 1))]["snr"]
        peak = float(values[near].max()) if near.any() else 0.0
        snr = float(snr_at(sensor, np.array([groove]), np.array([flaw.depth]))[0, 0])
        rows.append((flaw.position, 100.0 * flaw.depth, snr, peak, peak > threshold))
    called = calls(values, recording.position, threshold, sensor.flaw_width)
    return Chart(voltages, values, flaws, supports, called, pd.DataFrame(rows, columns=list(ROWS)))


def by_period(run: Insertion, voltages: FloatArray) -> pd.DataFrame:
    """One row per control period: position of the sensor at its end, standard deviations of X and Y, rms, S/N."""
    each = len(run.recording.radial) // len(run.periods)
    deviation = smoothed(run.recording, voltages)[: len(run.periods) * each].reshape(-1, each, 2).std(axis=1)
    return pd.DataFrame(
        {
            "place_m": run.recording.position[each - 1 :: each],
            "x_deviation_v": deviation[:, 0],
            "y_deviation_v": deviation[:, 1],
            **{name: [period[name] for period in run.periods] for name in ("radial_rms_m", "snr")},
        }
    )


def correlation(periods: pd.DataFrame) -> float:
    """Spearman correlation of the deviation of X with the radial rms by control period; NaN if one is constant."""
    noise, vibration = periods["x_deviation_v"], periods["radial_rms_m"]
    if min(np.ptp(noise), np.ptp(vibration)) == 0.0 or len(noise) < 3:
        return float("nan")
    return float(spearmanr(noise, vibration).statistic)


def _write(run: Insertion, chart: Chart, sensor: Sensor, title: str, output: Path, seed: int) -> None:
    output.mkdir(parents=True, exist_ok=True)
    recording, periods = run.recording, by_period(run, chart.voltages)
    samples = pd.DataFrame(
        {"time_s": recording.time, "place_m": recording.position, "feed_speed_m_per_s": recording.feed,
         "x_v": chart.voltages[:, 0], "y_v": chart.voltages[:, 1]}
    )  # fmt: skip
    tables = {"channels.csv": (samples, "%.6g"), "flaws.csv": (chart.table, "%.5g"), "periods.csv": (periods, "%.5g")}
    for name, (table, digits) in tables.items():
        write_atomically(output / name, table.to_csv(index=False, float_format=digits))
    record = {
        "sensor": sensor.model_dump(),
        "threshold": run.detection["call_threshold"],
        "false_calls": sum(all(abs(c - f.position) > sensor.flaw_width for f in chart.flaws) for c in chart.called),
        "noise_and_vibration_correlation": correlation(periods),
        "found": run.detection,
    }
    write_json(output / "signal.json", record)
    _draw_strip(run, chart, periods, title, output / "strip.png")
    if chart.flaws:
        _draw_flaws(recording, chart, output / "flaws.png")
    write_manifest(output, (*tables, "signal.json"), seeds=(seed,))


def _draw_strip(run: Insertion, chart: Chart, periods: pd.DataFrame, title: str, path: Path) -> None:
    """X and Y, the filtered signal with calls, and the vibration over the position of the sensor.

    Supports are ticks at the top, flaws lines.
    """
    figure, axes = plt.subplots(4, 1, figsize=(12, 9), sharex=True, layout="constrained")
    recording, threshold = run.recording, run.detection["call_threshold"]
    for axis, values, name in zip(axes, smoothed(recording, chart.voltages).T, "XY", strict=False):
        axis.plot(recording.position, values, color=BLUE, linewidth=0.4)
        axis.set_ylabel(f"{name} [V]")
    axes[2].plot(recording.position, chart.values, color="0.2", linewidth=0.4)
    axes[2].axhline(threshold, color=RED, linewidth=0.8)
    axes[2].plot(chart.called, np.full(len(chart.called), threshold), "v", color=RED, markersize=6)
    axes[2].set_ylabel("filtered signal\n[standard deviations of noise]")
    axes[3].plot(periods["place_m"], MM * periods["radial_rms_m"], color=GREY, label="radial rms [mm]")
    axes[3].plot(periods["place_m"], 0.1 * periods["snr"], color=BLUE, label="S/N of a 20 % groove / 10")
    axes[3].set(xlabel="sensor from the entrance of the helix [m]", ylim=(0.0, None))
    axes[3].legend(frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
    for axis in axes:
        for position in chart.supports:
            axis.axvline(position, ymin=0.95, color=GREY, linewidth=0.8)
        for flaw in chart.flaws:
            axis.axvline(flaw.position, color=RED, linewidth=0.6, linestyle=":")
    figure.suptitle(escape_dollars(title))
    save(figure, path)


def _draw_flaws(recording: Recording, chart: Chart, path: Path) -> None:
    """X and Y over time and as a Lissajous figure while the sensor passes each flaw, or ``DRAWN`` of them."""
    chosen = np.unique(np.linspace(0, len(chart.flaws) - 1, DRAWN).astype(int))
    size = (9, 3.2 * len(chosen))
    figure, axes = plt.subplots(len(chosen), 2, figsize=size, layout="constrained", squeeze=False)
    voltages = smoothed(recording, chart.voltages)
    for (left, right), k in zip(axes, chosen, strict=True):
        flaw = chart.flaws[k]
        near = np.abs(recording.position - flaw.position) < AROUND
        time = recording.time[near] - (recording.time[near].mean() if near.any() else 0.0)
        for values, name, colour in zip(voltages[near].T, "XY", (BLUE, RED), strict=True):
            left.plot(time, values, color=colour, linewidth=1.0, label=name)
        right.plot(voltages[near, 0], voltages[near, 1], color="0.2", linewidth=1.0)
        left.set(xlabel="time [s]", ylabel="[V]", title=f"{100.0 * flaw.depth:g} % at {flaw.position:g} m")
        right.set(xlabel="X [V]", ylabel="Y [V]", aspect="equal", adjustable="datalim")
        left.legend(frameon=False, ncols=2)
    save(figure, path)


def draw_curves(evaluation: Path, output: Path) -> None:
    """Write the detection curves of a stored evaluation as pod.csv and pod.png, and print the detected depths."""
    table = statistics.grouped(read_episodes(evaluation / "episodes.parquet"))
    if not statistics.has_curves(table):
        raise ValueError(f"{evaluation}: its episodes have no detection curves; run the evaluation again")
    curves = statistics.bands(table)
    output.mkdir(parents=True, exist_ok=True)
    write_atomically(output / "pod.csv", curves.to_csv(index=False, float_format="%.5g"))
    write_atomically(output / "pod.png", figures.curves(curves))
    header = ("policy", "a50 [% wall]", "a90 [% wall]", "a90/95 [% wall]")
    rows = [
        (str(row[0]), *(f"{value:.1f}" if value == value else "-" for value in row[1:]))
        for row in statistics.depths_of(table).to_numpy().tolist()
    ]
    tubes = table["context"].nunique()
    print_table(f"Detected depths, {f'over {tubes} tubes' if tubes > 1 else 'in one tube'}", header, rows)
    print_line(f"written: {output}/ (pod.png, pod.csv)")
