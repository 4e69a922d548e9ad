"""Probes at constant length, the sensor at some positions along the stretch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.design import Design
from probe_env.envs.contexts import Context
from probe_env.envs.task import FAILURES, TaskConfig
from probe_env.envs.trials.candidates import LEAST_SNR, Candidate, Trial, seeds_of
from probe_env.envs.trials.players import Controller
from probe_env.envs.trials.stretch import stretch_of
from probe_env.fidelity import Fidelity
from probe_env.inspection.meter import Meter
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.spectrum import SPAN
from probe_env.physics.signals import SAMPLE_PERIOD
from probe_env.physics.simulation.batch import SimulatorBatch
from probe_env.scene import Scene
from probe_env.schedule import Schedule

SETTLE, MEASURE, PERTURBATION = 1.0, 2.0, 1e-7  # [s], [s], [m]


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
    scenes = [
        scene
        for candidate in candidates
        for scene in section_scenes(candidate.design, candidate.context, over_length(candidate.feed), config)
    ]
    inserted, speed, air = (
        np.array([getattr(scene, name) for scene in scenes]).reshape(shape)
        for name in ("inserted_length", "feed_speed", "air_supply_rate")
    )
    batch = SimulatorBatch(
        scenes, fidelity.method, fidelity.time_step, fidelity.nodes_per_pitch, threads=threads,
        seeds=[seed for seed in seeds_of(candidates) for _ in stretch.positions], perturbation=PERTURBATION,
    )  # fmt: skip
    settled = batch.advance(None, None, SETTLE, SAMPLE_PERIOD)
    heard = config.vibration_measure == "snr"
    window = batch.advance(None, None, MEASURE, SAMPLE_PERIOD, ~settled.diverged, keep_samples=heard)
    diverged = (settled.diverged | window.diverged).reshape(shape)
    rms, tension = (window.statistics[name].reshape(shape) for name in ("radial_rms_m", "tension_mean_n"))
    deep = inserted >= config.lost_drive_from
    slack = deep & ~diverged & (tension < config.required_tension)
    reached = np.cumsum(diverged | slack, axis=1) == 0
    widths = np.where(reached, stretch.widths, 0.0)
    failed = dict.fromkeys(FAILURES, np.zeros(len(candidates), dtype=bool))  # at constant length in two ways alone
    failed |= {"lost_drive": np.asarray(slack.any(axis=1)), "diverged": np.asarray(diverged.any(axis=1))}
    noise = None
    if heard:
        assert window.radial is not None
        noise = _noise(config.sensor, window.radial, speed.ravel()).reshape(shape)
    return Trial(widths, speed, air, rms, tension, deep & ~diverged, failed, noise=noise)


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


def section_scenes(design: Design, context: Context, feed: Schedule, config: TaskConfig) -> list[Scene]:
    """What is simulated of a design in a tube, for each position of the task's stretch."""
    base = config.scene
    probe, tube, scenes = design.probe(base.probe), context.apply(base), []
    for position in stretch_of(config).positions:
        carrier = round(round(position / probe.float_pitch) * probe.float_pitch, 6)
        inserted = carrier + probe.guide_length
        fed, blown = config.given(*feed.at(inserted))[0].tolist()
        room = max(base.tube.helix_length, inserted)  # rounding to the pitch may go some cm beyond
        update = {"probe": probe, "carrier_length": carrier, "feed_speed": fed, "air_supply_rate": blown}
        scenes.append(tube.model_copy(update={"tube": {"helix_length": room}, **update}))
    return scenes
