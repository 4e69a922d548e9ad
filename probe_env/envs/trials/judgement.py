"""Reward terms and KPIs of probes that were tried."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.design import Design
from probe_env.envs.task import FAILURES, Outcome, TaskConfig, capped_square, reward_terms
from probe_env.envs.trials.candidates import Trial
from probe_env.envs.trials.stretch import SENSOR_START, stretch_of

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
    terms = reward_terms(config, Outcome(inspected, squares, time, air, missed, trial.failed["diverged"]))
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
