"""One insertion under a policy with every sample of the sensor kept."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from tqdm import tqdm

from agents.detection.stretches import STRETCH, centred_spectra
from agents.rollouts.plan import Policy
from probe_env import Context, Fidelity
from probe_env.envs.episodes import Episodes
from probe_env.envs.task import END_TOLERANCE, TaskConfig
from probe_env.envs.trials import periods_of
from probe_env.inspection.channels import Passage
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.tally import DetectionTally, EitherTally
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.settings import within


@dataclass(frozen=True)
class Insertion:
    """A run, samples and control periods.

    Attributes:
        passage: what the sensor went through.
        periods: a mapping of a period each: what ``Episodes`` tells of it, SI units.
        detection: figures by name of what would be found in the length that was inspected, see ``inspection.tally``.
        tally: what they follow from.
    """

    passage: Passage
    periods: tuple[dict[str, Any], ...]
    detection: dict[str, float]
    tally: DetectionTally | EitherTally

    @property
    def period(self) -> int:
        """Samples in a control period."""
        return len(self.passage.radial) // len(self.periods)


def insert(
    policy: Policy,
    config: TaskConfig,
    context: Context,
    fidelity: Fidelity,
    seed: int | Sequence[int],
    until: float | None = None,
    progress: bool = True,
) -> Insertion:
    """Feed a probe in until the episode ends or a length [m] is inserted; the settling before is not kept.

    ``progress`` shows where the sensor is.

    Raises:
        ValueError: a length that is not in the helix, or time-lapse, which leaves three of four metres out.
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
    episodes = Episodes(1, config, threads=1, may_stand=True, fidelity=fidelity)
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
    tally = episodes.tally[0].detection
    detection = tally.kpis(episodes.tally[0].inspected, length)
    return Insertion(_passage(config.sensor, places, periods, radial), tuple(periods), detection, tally)


def _passage(sensor: Sensor, places: list[float], periods: list[dict[str, Any]], radial: list[np.ndarray]) -> Passage:
    """Samples of all periods; the sensor goes evenly within one."""
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
