"""Probes at constant length, the sensor at some positions along the stretch, and checks that probes can be tried."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.design import RANGES, Design
from probe_env.envs.contexts import Context
from probe_env.envs.episodes.limits import check_simulable
from probe_env.envs.episodes.starts import Starts, settling
from probe_env.envs.task import FAILURES, TaskConfig, drive_counts, slack
from probe_env.envs.trials.candidates import LEAST_SNR, Candidate, Trial, seeds_of, stretch_of
from probe_env.envs.trials.players import Controller
from probe_env.fidelity import Fidelity
from probe_env.inspection.meter import SPAN, Meter
from probe_env.inspection.sensor import Sensor
from probe_env.physics.simulation.batch import SimulatorBatch
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.scene import Scene
from probe_env.schedule import Schedule

SETTLE, MEASURE, PERTURBATION = 1.0, 2.0, 1e-7  # [s], [s], [m]
GENTLE, AIR_LAG = 20.0 / 3600.0, 0.2
"""[m3/s] a probe at rest starts with at most, and [s] with which the rest follows; as it settles, 99 % has come. All of
it at once sends a wave through the probe that is twice as high as its tension in the end."""


class Section(NamedTuple):
    """A probe at constant length: its scene at the start, and the air supply it is tried with [m3/s]."""

    start: Scene
    air_supply_rate: float


def try_sections(
    candidates: Sequence[Candidate],
    config: TaskConfig,
    fidelity: Fidelity | None = None,
    threads: int | None = None,
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
    sections = [
        section
        for candidate in candidates
        for section in sections_of(candidate.design, candidate.context, over_length(candidate.feed), config)
    ]
    scenes, air = [section.start for section in sections], np.array([section.air_supply_rate for section in sections])
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
    hanging = slack(config, tension, inserted) & ~diverged
    reached = np.cumsum(diverged | hanging, axis=1) == 0
    widths = np.where(reached, stretch.widths, 0.0)
    failed = dict.fromkeys(FAILURES, np.zeros(len(candidates), dtype=bool))  # at constant length in two ways alone
    failed |= {"lost_drive": np.asarray(hanging.any(axis=1)), "diverged": np.asarray(diverged.any(axis=1))}
    noise = None
    if heard:
        assert window.radial is not None
        noise = _noise(config.sensor, window.radial, speed.ravel()).reshape(shape)
    deep = drive_counts(config, inserted) & ~diverged
    return Trial(widths, speed, air.reshape(shape), rms, tension, deep, failed, noise=noise)


def _noise(sensor: Sensor, radial: FloatArray, feed: FloatArray) -> FloatArray:
    """(n,) noise over the signal of a 20 % groove, of motions (samples, n) [m] passed at ``feed`` (n,) [m/s]."""
    meter, every = Meter(sensor, len(feed), SAMPLE_PERIOD), np.arange(len(feed))
    for second in np.split(radial, round(MEASURE / SPAN)):
        reading = meter.listen(every, second, feed)
    return np.asarray(1.0 / np.maximum(reading.snr, LEAST_SNR))


def over_length(feed: Schedule | Controller) -> Schedule:
    """A feed as a schedule over inserted length; raises ValueError if it is none."""
    if not isinstance(feed, Schedule) or feed.over != "inserted_length":
        raise ValueError(
            "feed: a policy or a schedule over time has no meaning at constant length; give one over inserted length"
        )
    return feed


def sections_of(design: Design, context: Context, feed: Schedule, config: TaskConfig) -> list[Section]:
    """What is simulated of a design in a tube, for each position of the task's stretch."""
    base = config.scene
    probe, tube, sections = design.probe(base.probe), context.apply(base), []
    for position in stretch_of(config).positions:
        carrier = round(round(position / probe.float_pitch) * probe.float_pitch, 6)
        inserted = carrier + probe.guide_length
        fed, blown = config.given(*feed.at(inserted))[0].tolist()
        room = max(base.tube.helix_length, inserted)  # rounding to the pitch may go some cm beyond
        update = {"probe": probe, "carrier_length": carrier, "feed_speed": fed, "air_supply_rate": min(blown, GENTLE)}
        start = tube.model_copy(update={"tube": {"helix_length": room}, **update})
        sections.append(Section(start, blown))
    return sections


def _corner(*high: str) -> Design:
    return Design.from_unit([1.0 if name in high else 0.0 for name in RANGES])


HARDEST: Final = (
    _corner("tensile_rigidity", "flexural_rigidity"),
    _corner("guide_length", "guide_float_diameter", "carrier_float_diameter"),
)
"""The stiff, light design that asks for the shortest step and the hardest wall; the one that drag stretches most."""


def check_space(
    contexts: Sequence[Context], config: TaskConfig, fidelity: Fidelity, feed: Schedule | None = None
) -> None:
    """Raise ValueError if not all of the design space, cut to the bore, can be tried in these tubes.

    Args:
        contexts: the tubes.
        config: the task.
        fidelity: of the simulation.
        feed: for sections of constant length; None: whole insertions.
    """
    for design in HARDEST:
        for context in contexts:
            check_candidate(design.cut_to(config.scene), context, config, fidelity, feed)


def check_candidate(
    design: Design, context: Context, config: TaskConfig, fidelity: Fidelity, feed: Schedule | None = None
) -> None:
    """Raise ValueError if a design does not fit a tube, or cannot be simulated in it; arguments as ``check_space``."""
    if feed is None:
        starts = Starts(config, (context,), "scene", *settling(config, {}))
        scene = starts.build(context, {"probe": design.built.model_dump()})
        check_simulable(scene, fidelity, scene.tube.helix_length, config.air_supply_rates[1])
    else:
        for start, air in sections_of(design, context, feed, config):
            check_simulable(start, fidelity, start.inserted_length, air)
