"""A recording: one insertion under a policy with every sample of the sensor."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd
from tqdm import tqdm

from agents.policies.policy import Policy
from probe_env import Context, Fidelity
from probe_env.arrays import FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.envs.task import END_TOLERANCE, TaskConfig
from probe_env.envs.trials import periods_of
from probe_env.inspection.channels import Flaw, Passage
from probe_env.inspection.meter import SPAN, Meter
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.tally import DetectionTally, EitherTally
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.settings import within

STRETCH: Final = round(0.25 * SPAN / SAMPLE_PERIOD)
"""Samples that the filter weighs by one spectrum: as many as a tally counts of every second."""


@dataclass(frozen=True)
class Insertion:
    """Samples and control periods of an insertion.

    Attributes:
        passage: time, place, feed and motion of every sample.
        periods: info of every control period, SI units.
        detection: detection figures by name of the inspected length, see ``inspection.tally``.
        tally: from which these figures follow.
    """

    passage: Passage
    periods: tuple[dict[str, Any], ...]
    detection: dict[str, float]
    tally: DetectionTally | EitherTally

    @property
    def period(self) -> int:
        """Samples in a control period."""
        return len(self.passage.radial) // len(self.periods)


@dataclass(frozen=True)
class Chart:
    """The signals of an insertion.

    Attributes:
        voltages: (k, 2) X and Y [V].
        values: (k,) filtered signal along the flaw, over the deviation of its noise.
        flaws: that the sensor passed.
        supports: positions [m].
        called: positions of calls [m].
        threshold: of calls, in deviations.
        table: a row for each flaw: position, depth, S/N, filtered signal, whether it was called.
        false_calls: number of calls without a flaw.
    """

    voltages: FloatArray
    values: FloatArray
    flaws: tuple[Flaw, ...]
    supports: FloatArray
    called: FloatArray
    threshold: float
    table: pd.DataFrame
    false_calls: int


def insert(
    policy: Policy,
    config: TaskConfig,
    context: Context,
    fidelity: Fidelity,
    seed: int | Sequence[int],
    until: float | None = None,
    progress: bool = True,
) -> Insertion:
    """Record an insertion under a policy until the episode ends or a length is inserted.

    Args:
        policy: that feeds the probe.
        config: the task.
        context: the tube.
        fidelity: without time-lapse.
        seed: of sensor noise and start.
        until: inserted length at which to stop [m]; None: the end.
        progress: whether to show a progress bar.

    Raises:
        ValueError: a length outside the helix, or a fidelity with time-lapse.
        RuntimeError: the simulation diverged.
    """
    if fidelity.time_lapse != 1.0:
        raise ValueError(
            f"fidelity.time_lapse = {fidelity.time_lapse:g} leaves out metres that a chart shows: take standard,"
            " reference or other settings with a time-lapse of 1"
        )
    length = config.scene.tube.helix_length
    if until is not None:
        within("until", until, 5.0, length, "m")
    episodes = Episodes(1, config, threads=1, allow_standstill=True, fidelity=fidelity)
    observation, started = episodes.reset([0], {0: np.random.default_rng(seed)}, {0: {"context": context}})
    guide = episodes.batch.simulators[0].scene.probe.guide_length
    places, periods, radial = [started[0]["inserted_length"] - guide], list[dict[str, Any]](), []
    shown = "{desc} {n:.1f} {unit} [{elapsed}]"
    with tqdm(desc="sensor at", initial=places[0], unit="m", bar_format=shown, disable=not progress) as bar:
        for step, _ in periods_of(episodes, [policy], observation):
            info = step.infos[0]
            if info["diverged"]:
                raise RuntimeError(f"the simulation diverged at {info['inserted_length']:.4g} m: nothing is shown")
            assert episodes.window is not None
            assert episodes.window.radial is not None
            radial.append(episodes.window.radial[:, 0])
            bar.update(info["inserted_length"] - guide - places[-1])
            places.append(info["inserted_length"] - guide)
            periods.append(info)
            if until is not None and info["inserted_length"] >= until - END_TOLERANCE:
                break
    tally = episodes.scorer.metrics[0].detection
    detection = tally.kpis(episodes.scorer.metrics[0].inspected, length)
    return Insertion(_passage(config.sensor, places, periods, radial), tuple(periods), detection, tally)


def _passage(sensor: Sensor, places: list[float], periods: list[dict[str, Any]], radial: list[np.ndarray]) -> Passage:
    each = len(radial[0])
    share = np.arange(1, each + 1) / each
    motion, feed = np.concatenate(radial), np.repeat([period["feed_speed"] for period in periods], each)
    return Passage(
        time=SAMPLE_PERIOD * np.arange(1, each * len(radial) + 1),
        place=np.concatenate([begin + share * (end - begin) for begin, end in itertools.pairwise(places)]),
        feed=feed,
        radial=motion,
        spectrum=centred_spectra(sensor, motion, feed),
        stretch=STRETCH,
    )


def listened(sensor: Sensor, radial: FloatArray, feed: FloatArray) -> Iterator[tuple[int, int, Meter]]:
    """First and last sample of each ``STRETCH``, and a meter that has processed all samples up to there.

    The first piece is half a stretch, so that each second ends half a stretch after a piece.

    Args:
        sensor: its constants.
        radial: (k,) motion [m].
        feed: (k,) feed speed [m/s].
    """
    meter, one = Meter(sensor, 1, SAMPLE_PERIOD), np.zeros(1, dtype=np.int64)
    ends = list(range(STRETCH // 2, len(radial) + 1, STRETCH)) or [len(radial)]
    for begin, end in itertools.pairwise([0, *ends]):
        meter.listen(one, radial[begin:end, None], feed[begin : begin + 1])
        yield begin, end, meter


def centred_spectra(sensor: Sensor, radial: FloatArray, feed: FloatArray) -> FloatArray:
    """(p, m) noise densities for the filter of each ``STRETCH``, of the second that has it in its middle.

    So does an episode's tally. A filter that knows only the past would let a burst that sets in stand out.

    Args:
        sensor: its constants.
        radial: (k,) motion [m].
        feed: (k,) feed speed [m/s].
    """
    spectra = [meter.of_filter(0) for _, _, meter in listened(sensor, radial, feed)]
    # of a second that ends half a stretch after the next one; the last ones have what there is
    last = np.minimum(np.arange(math.ceil(len(radial) / STRETCH)) + 2, len(spectra) - 1)
    return np.array(spectra)[last]
