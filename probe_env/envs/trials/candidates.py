"""Probes to be tried: candidates, the stretch of tube they are compared over, and their reward terms and KPIs.

The stretch follows from the length of the helix: where the sensor gets with the longest guide. What a long guide cannot
inspect beyond it counts as lost progress.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from probe_env.arrays import BoolArray, FloatArray
from probe_env.design import RANGES, Design
from probe_env.envs.contexts import Context
from probe_env.envs.task import FAILURES, TaskConfig, capped_square, reward_terms
from probe_env.envs.trials.players import Controller
from probe_env.schedule import Schedule

SENSOR_START: Final = 2.5
"""[m] of the sensor from the entrance, where an insertion begins."""
SPACING: Final = 10.0
"""[m] between sections, or the nearest that divides the stretch."""
LEAST_SECTIONS: Final = 3


class Stretch(NamedTuple):
    """Where probes are compared [m]."""

    end: float  # greatest distance of the sensor from the entrance
    positions: tuple[float, ...]  # of the sensor, simulated at constant length
    widths: tuple[float, ...]  # of the tube that each position stands for

    @property
    def span(self) -> float:
        """Length of the stretch [m]."""
        return self.end - SENSOR_START


def stretch_of(config: TaskConfig) -> Stretch:
    """The stretch of a task's helix.

    Raises:
        ValueError: the helix is too short to compare the probes of the design space.
    """
    return _stretch(config.scene.tube.helix_length, config.lost_drive_from)


@lru_cache
def _stretch(helix_length: float, lost_drive_from: float) -> Stretch:
    shortest, longest, _ = RANGES["guide_length"]
    end = helix_length - longest
    least = longest + max(lost_drive_from - shortest, SENSOR_START + SPACING)  # so that every probe has a drive margin
    if helix_length < least:
        raise ValueError(
            f"helix_length = {helix_length:g} m: designs are compared as far as the sensor gets with a guide of"
            f" {longest:g} m, and where drive may be lost (lost_drive_from = {lost_drive_from:g} m): it must be at"
            f" least {least:g} m"
        )
    count = max(round(end / SPACING), LEAST_SECTIONS)
    positions = tuple(end * k / count for k in range(1, count + 1))
    middles = [0.5 * (one + other) for one, other in pairwise(positions)]
    edges = (SENSOR_START, *middles, end)
    widths = tuple(high - low for low, high in pairwise(edges))
    return Stretch(end, positions, widths)


FOUND_KPIS: Final = ("a50_percent_wall", "a90_percent_wall", "length_with_snr_over_3_m", "noise_peak_to_peak_v")
"""What whole insertions are told by of what would be found, see ``inspection.tally``."""
LEAST_SNR: Final = 1e-3
"""What no signal at all counts as, so that its inverse is finite."""


@dataclass(frozen=True)
class Candidate:
    """A probe that is tried in a tube."""

    design: Design
    context: Context
    feed: Schedule | Controller
    """A schedule over inserted length, or for whole insertions a policy."""
    seed: int | None = None
    """Of the start's perturbation; default: its place among the candidates."""


@dataclass(frozen=True)
class Trial:
    """What N probes did in p places, (N, p) unless it says otherwise; SI units."""

    widths: FloatArray  # length of tube that was inspected there; 0 where the probe did not get to
    feed_speed: FloatArray
    air_supply_rate: FloatArray
    radial_rms: FloatArray
    root_tension: FloatArray
    deep: BoolArray  # whether so much is inserted that lost drive counts
    failed: Mapping[str, BoolArray]  # (N,) whether it ended so, by each of ``FAILURES``
    inspected: FloatArray | None = None  # (N,) to the end, where that was simulated
    noise: FloatArray | None = None  # over the signal of a 20 % groove, where the task is judged by that
    detection: Mapping[str, FloatArray] = field(default_factory=dict)  # (N,) of each of ``FOUND_KPIS``


def seeds_of(candidates: Sequence[Candidate]) -> list[int]:
    """Of the starts."""
    return [k if candidate.seed is None else int(candidate.seed) for k, candidate in enumerate(candidates)]


JUDGED: Final = ("displacement", "snr")
"""Vibration measures that designs are judged by."""


def check_measure(config: TaskConfig) -> None:
    """Raise ValueError unless designs can be judged by the task's vibration measure."""
    if config.vibration_measure not in JUDGED:
        raise ValueError(
            f"vibration_measure = {config.vibration_measure!r}: designs are judged by {' or '.join(JUDGED)}"
        )


def judge(
    designs: Sequence[Design], trial: Trial, config: TaskConfig
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Reward terms and KPIs (N,) of designs, by the weights of the insertion task.

    Progress is the length that the sensor sees until the guide's tip is at the end of the helix: a long guide inspects
    less. Vibration, time and air are of the span that all designs share; what would be found, of what its guide lets a
    probe inspect.

    Raises:
        ValueError: the task's vibration measure is not one of ``JUDGED``.
    """
    check_measure(config)
    span = stretch_of(config).span
    guides = np.array([design.built.guide_length for design in designs])
    covered = trial.widths.sum(axis=1)
    missed = np.maximum(span - covered, 0.0)
    ratio = (trial.radial_rms if trial.noise is None else trial.noise) / config.limit
    seconds = trial.widths / np.maximum(trial.feed_speed, 1e-9)
    squares = (trial.widths * capped_square(config, ratio)).sum(axis=1)
    time, air = seconds.sum(axis=1), (seconds * trial.air_supply_rate).sum(axis=1)
    inspected = trial.inspected
    if inspected is None:
        inspected = np.maximum(config.scene.tube.helix_length - guides - SENSOR_START - missed, 0.0)
    terms = reward_terms(config, inspected, squares, time, air, missed, trial.failed["diverged"])
    length = np.maximum(covered, 1e-9)
    margin = np.where(trial.deep, trial.root_tension, np.inf).min(axis=1) - config.required_tension
    kpis = {
        "radial_rms_m": np.sqrt((trial.widths * trial.radial_rms**2).sum(axis=1) / length),
        "mean_square_ratio": squares / length,
        "share_within_limit": np.where(ratio <= 1.0, trial.widths, 0.0).sum(axis=1) / span,
        "inspection_time_s": time,
        "air_m3": air,
        "inspected_m": inspected,
        "missed_m": missed,
        "drive_margin_n": np.where(np.isfinite(margin), margin, -config.required_tension),
        **trial.detection,
        **{name: trial.failed[name].astype(float) for name in FAILURES},
    }
    return terms, kpis
