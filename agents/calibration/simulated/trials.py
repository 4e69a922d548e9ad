"""Simulated logs whose truth is known, of tubes and schedules drawn at random: what a calibration is tested on."""

from __future__ import annotations

import warnings
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from scipy.special import ndtri

from agents.calibration.simulated.insertions import Program, Specimen, insert
from agents.plant.logs import Log
from agents.plant.prior import UNKNOWNS, Prior, prior_of
from probe_env import Context, Plant, Scene, StabilityWarning
from probe_env.arrays import FloatArray
from probe_env.envs.plants.tables import Tubes
from probe_env.fidelity import PRESETS

TUBES: Final = 8
"""Of one bore and length, simulated side by side."""
BORES, LENGTHS, DIAMETERS = (22.5e-3, 26e-3), (40.0, 80.0), (0.9, 2.6)  # [m]
FEEDS, AIRS = (0.05, 0.35), (45.0 / 3600.0, 125.0 / 3600.0)  # [m/s], [m3/s]
KNOTS: Final = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
"""Of a schedule, as shares of the helix."""
NOISE: Final = {
    "root_tension": 0.02,
    "radial_acceleration_rms": 0.03,
    "axial_acceleration_rms": 0.03,
    "rf_noise_rms": 0.05,
}
"""Relative scatter of what a sensor shows in a second."""


class Trial(NamedTuple):
    """A log and what is true of it.

    Attributes:
        truth: (4,) in the order of ``UNKNOWNS``.
        specimen: the same as a simulation takes it.
        scene: bore, helix, probe and air; friction and the rest are those of the specimen.
        log: with sensor noise.
    """

    truth: FloatArray
    specimen: Specimen
    scene: Scene
    log: Log


def usual_prior() -> Prior:
    """What is held possible where a file says nothing: truths are drawn from it."""
    return prior_of(Plant())


def trials(group: int, fidelity: str, seed: int) -> list[Trial]:
    """Logs of the ``TUBES`` of a group, which have bore and length in common."""
    rng = np.random.default_rng([seed, group])
    bore, length = (round(float(rng.uniform(*range_)), 4) for range_ in (BORES, LENGTHS))
    plant = Plant(
        tube=Tubes(inner_diameter=bore, helix_length=length),
        task={"lost_drive_periods": 1000, "time_limit": 1e4},
    )
    truth = usual_prior().values(ndtri(rng.random((TUBES, len(UNKNOWNS)))), 1)[0]
    diameters = rng.uniform(*DIAMETERS, TUBES)
    usual = plant.scene.air.drag_coefficient
    specimens = [
        Specimen(
            Context(friction=mu, contact_stiffness=k, drag_factor=drag / usual, helix_diameter=float(diameter)), delta
        )
        for (mu, k, drag, delta), diameter in zip(truth.tolist(), diameters, strict=True)
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)
        insertions = insert(specimens, schedules(rng, length), plant.configured(), PRESETS[fidelity], [seed, group])
    scenes = [plant.scene.model_copy(update={"tube": {"helix_diameter": float(d)}}) for d in diameters]
    return [
        Trial(*parts)
        for parts in zip(truth, specimens, scenes, (noisy(insertion.log, rng) for insertion in insertions), strict=True)
    ]


def schedules(rng: np.random.Generator, length: float) -> Program:
    """Feeds that fall with length and airs that change, at random, straight between ``KNOTS``."""
    low, high = np.log(FEEDS)
    feeds = np.exp(-np.sort(-rng.uniform(low, high, (TUBES, len(KNOTS))), axis=1))
    airs = rng.uniform(*AIRS, (TUBES, len(KNOTS)))

    def program(inserted: FloatArray, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        del time
        shares = inserted / length
        feed, air = (
            np.array([np.interp(share, KNOTS, row) for share, row in zip(shares, table, strict=True)])
            for table in (feeds, airs)
        )
        return feed, air

    return program


def noisy(log: Log, rng: np.random.Generator) -> Log:
    """The log as sensors show it."""
    measured = {
        name: values * (1.0 + NOISE[name] * rng.normal(size=len(values))) for name, values in log.measured.items()
    }
    return Log(log.time, log.inserted_length, log.feed_speed, log.air_supply_rate, MappingProxyType(measured))
