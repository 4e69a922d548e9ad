"""Probes at constant length, the sensor at some positions along the stretch, and checks that probes can be tried."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from probe_env.design import RANGES, Design
from probe_env.envs.contexts import Context
from probe_env.envs.episodes.limits import check_simulable
from probe_env.envs.episodes.starts import EpisodeSampler, settling
from probe_env.envs.task import FAILURES, TaskConfig, drive_counts, slack
from probe_env.envs.trials.candidates import LEAST_SNR, Candidate, Trial, seeds_of, stretch_of
from probe_env.fidelity import Fidelity
from probe_env.inspection.meter import SPAN, Meter
from probe_env.physics.simulation.batch import SimulatorBatch
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.scene import Scene
from probe_env.schedule import Schedule

SETTLE, MEASURE, PERTURBATION = 1.0, 2.0, 1e-7  # [s], [s], [m]
GENTLE, AIR_LAG = 20.0 / 3600.0, 0.2
"""[m3/s] a probe at rest starts with at most, and [s] with which the rest follows; as it settles, 99 % has come. All of
it at once sends a wave through the probe that is twice as high as its tension in the end."""


def try_sections(
    candidates: Sequence[Candidate], config: TaskConfig, fidelity: Fidelity | None = None, threads: int | None = None
) -> Trial:
    """N probes at constant length, the sensor at the positions of the task's stretch, all in one batch.

    From the first section on that diverges or has less than the required tension, nothing counts as inspected.

    Args:
        candidates: N.
        config: the task, with the scene that designs and contexts change; its ranges are those of the feed and the air.
        fidelity: method, step and mesh; there is no time-lapse at constant length.
        threads: at most so many; default: all cores.

    Raises:
        ValueError: a policy, or a schedule over time; or a helix that is too short.
    """
    fidelity, stretch = fidelity or Fidelity(), stretch_of(config)
    shape = (len(candidates), len(stretch.positions))
    scenes, blown = [], []
    for candidate in candidates:
        if not isinstance(candidate.feed, Schedule) or candidate.feed.over != "inserted_length":
            raise ValueError(
                "feed: a policy or a schedule over time has no meaning at constant length; give one over inserted"
                " length"
            )
        for start, supply in sections_of(candidate.design, candidate.context, candidate.feed, config):
            scenes.append(start)
            blown.append(supply)
    air = np.array(blown)
    inserted, speed = (
        np.array([getattr(scene, name) for scene in scenes]).reshape(shape)
        for name in ("inserted_length", "feed_speed")
    )
    batch = SimulatorBatch(
        scenes, fidelity.method, fidelity.time_step, fidelity.nodes_per_pitch, threads=threads,
        seeds=[seed for seed in seeds_of(candidates) for _ in stretch.positions], perturbation=PERTURBATION,
        air_lag=AIR_LAG,
    )  # fmt: skip
    settled = batch.advance(None, air, SETTLE, SAMPLE_PERIOD)
    heard = config.vibration_measure == "snr"
    window = batch.advance(None, None, MEASURE, SAMPLE_PERIOD, ~settled.diverged, keep_samples=heard)
    diverged = (settled.diverged | window.diverged).reshape(shape)
    rms, tension = (window.statistics[name].reshape(shape) for name in ("radial_rms_m", "tension_mean_n"))
    is_slack = slack(config, tension, inserted) & ~diverged
    reached = np.cumsum(diverged | is_slack, axis=1) == 0
    widths = np.where(reached, stretch.widths, 0.0)
    failed = dict.fromkeys(FAILURES, np.zeros(len(candidates), dtype=bool))  # at constant length in two ways alone
    failed |= {"lost_drive": np.asarray(is_slack.any(axis=1)), "diverged": np.asarray(diverged.any(axis=1))}
    noise = None
    if heard:
        assert window.radial is not None
        meter, every = Meter(config.sensor, len(scenes), SAMPLE_PERIOD), np.arange(len(scenes))
        for second in np.split(window.radial, round(MEASURE / SPAN)):
            reading = meter.listen(every, second, speed.ravel())
        noise = np.asarray(1.0 / np.maximum(reading.snr, LEAST_SNR)).reshape(shape)
    deep = drive_counts(config, inserted) & ~diverged
    return Trial(widths, speed, air.reshape(shape), rms, tension, deep, failed, noise=noise)


def sections_of(design: Design, context: Context, feed: Schedule, config: TaskConfig) -> list[tuple[Scene, float]]:
    """Scene at the start and air supply [m3/s] of a design in a tube, for each position of the task's stretch."""
    base = config.scene
    probe, tube, sections = design.probe(base.probe), context.apply(base), []
    for position in stretch_of(config).positions:
        carrier = round(round(position / probe.float_pitch) * probe.float_pitch, 6)
        inserted = carrier + probe.guide_length
        fed, blown = config.given(*feed.at(inserted))[0].tolist()
        room = max(base.tube.helix_length, inserted)  # rounding to the pitch may go some cm beyond
        update = {"probe": probe, "carrier_length": carrier, "feed_speed": fed, "air_supply_rate": min(blown, GENTLE)}
        start = tube.model_copy(update={"tube": {"helix_length": room}, **update})
        sections.append((start, blown))
    return sections


HARDEST: Final = tuple(
    Design.from_unit([float(name in high) for name in RANGES])
    for high in (
        ("tensile_rigidity", "flexural_rigidity"),
        ("guide_length", "guide_float_diameter", "carrier_float_diameter"),
    )
)
"""The stiff, light design that asks for the shortest step and the hardest wall; the one that drag stretches most."""


def check_candidate(
    design: Design, context: Context, config: TaskConfig, fidelity: Fidelity, feed: Schedule | None = None
) -> None:
    """Raise ValueError if a design does not fit a tube, or cannot be simulated in it.

    ``feed`` is that of sections of constant length; None: whole insertions.
    """
    if feed is None:
        starts = EpisodeSampler(config, (context,), "scene", *settling(config, {}))
        scene = starts.build(context, {"probe": design.built.model_dump()})
        check_simulable(scene, fidelity, scene.tube.helix_length, config.air_supply_rates[1])
    else:
        for start, air in sections_of(design, context, feed, config):
            check_simulable(start, fidelity, start.inserted_length, air)
