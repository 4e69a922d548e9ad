"""Wandering insertions in tubes spread over what may be: what the response to friction and the rest is learnt from."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from scipy.stats import qmc

from agents.calibration.simulated.insertions import Program, Specimen, insert
from agents.plant.prior import FRICTION, STIFFNESS
from agents.plant.response import CHANNELS, metres_of
from agents.records.atomic import write_atomically
from agents.terminal.work import Work, announce
from probe_env import Context, Plant
from probe_env.arrays import FloatArray
from probe_env.envs.plants.tables import Tubes
from probe_env.envs.task import value_at
from probe_env.errors import StabilityWarning
from probe_env.fidelity import PRESETS
from probe_env.npz import read_arrays

SIZE: Final = 32
"""Insertions side by side, in one bore."""
BORES: Final = (22.0e-3, 26.5e-3)
"""Inner diameter [m]: 3 to 7.5 mm of room for table 2's floats."""
LENGTHS: Final = (60.0, 45.0, 80.0)
"""Helix length [m], in turn."""
DIAMETERS: Final = (0.8, 3.0)
"""Of the helix [m]."""
DRAG_FACTORS: Final = (0.7, 1.4)
"""Drag over table 2's: also stands for other air and other float pitches."""
DAMPING: Final = (3e-5, 1.2e-4)
"""[s]; an insertion that diverges, as some of little damping do, is learnt from as far as it went."""
FEEDS: Final = (0.045, 0.4)  # [m/s]
AIRS: Final = (30.0 / 3600.0, 130.0 / 3600.0)  # [m3/s]
SEGMENT: Final = 6.0
"""[m] over which feed and air go straight from one drawn value to the next: a step would make a vibration of its own,
which ``fast`` draws out over metres."""
SEED: Final = 20


def tubes_of(group: int) -> tuple[Plant, list[Specimen]]:
    """Plant and specimens of a group; together they fill what may be evenly."""
    spread = qmc.Sobol(5, rng=np.random.default_rng(SEED))
    shares = spread.fast_forward(group * SIZE).random(SIZE) if group else spread.random(SIZE)
    bore = BORES[0] + float(qmc.Halton(1, scramble=False).fast_forward(group + 1).random(1)[0, 0]) * (
        BORES[1] - BORES[0]
    )
    plant = Plant(
        tube=Tubes(inner_diameter=round(float(bore), 6), helix_length=LENGTHS[group % len(LENGTHS)]),
        task={"lost_drive_periods": 1000, "time_limit": 1e4},
    )
    specimens = [
        Specimen(
            Context(
                friction=float(value_at(a, FRICTION)),
                contact_stiffness=float(_geometric(STIFFNESS, b)),
                drag_factor=float(value_at(c, DRAG_FACTORS)),
                helix_diameter=float(_geometric(DIAMETERS, d)),
            ),
            float(_geometric(DAMPING, e)),
        )
        for a, b, c, d, e in shares
    ]
    return plant, specimens


def wandering(group: int) -> Program:
    """Feed and air drawn anew every ``SEGMENT``, straight between; slow feeds are rarer, for they take the time."""
    knots = np.arange(0.0, max(LENGTHS) + SEGMENT, SEGMENT)
    shares = np.random.default_rng([SEED, group]).random((2, SIZE, len(knots)))

    def program(length: FloatArray, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        del time
        feed, air = (
            np.array([np.interp(place, knots, row) for place, row in zip(length, share, strict=True)])
            for share in shares
        )
        return _geometric(FEEDS, feed**0.7), value_at(air, AIRS)

    return program


def simulated(group: int, fidelity: str) -> dict[str, FloatArray]:
    """Metres of all insertions of a group, one row each: ``FIELDS`` by name, and which specimen."""
    plant, specimens = tubes_of(group)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)  # of little damping nobody measured the limit
        insertions = insert(specimens, wandering(group), plant.configured(), PRESETS[fidelity], [SEED, group])
    parts = [(k, metres_of(insertion.log)) for k, insertion in enumerate(insertions)]
    return {
        "specimen": np.concatenate([np.full(len(m), float(group * SIZE + k)) for k, m in parts]),
        "inner_diameter": np.concatenate([np.full(len(m), plant.tube.inner_diameter) for _, m in parts]),
        **{
            name: np.concatenate([np.full(len(m), getattr(specimens[k].context, name)) for k, m in parts])
            for name in Context.model_fields
        },
        "damping_time": np.concatenate([np.full(len(m), specimens[k].damping_time) for k, m in parts]),
        **{name: np.concatenate([getattr(m, name) for _, m in parts]) for name in ("length", "feed", "air")},
        **{name: np.concatenate([m.felt[name] for _, m in parts]) for name in CHANNELS},
    }


def make_bank(groups: int, fidelity: str, output: Path) -> Iterator[dict[str, FloatArray]]:
    """The groups, simulated where they are not in ``output`` yet; one that was interrupted goes on."""
    files = [output / f"{fidelity}-{group:03d}.npz" for group in range(groups)]
    announce(Work("group", groups, lambda: sum(file.exists() for file in files), output))
    output.mkdir(parents=True, exist_ok=True)
    for group, file in enumerate(files):
        if not file.exists():
            buffer = io.BytesIO()
            np.savez_compressed(buffer, **simulated(group, fidelity))  # type: ignore[arg-type]
            write_atomically(file, buffer.getvalue())
        yield read_arrays(file, lambda _: "f")


def _geometric(range_: tuple[float, float], share: FloatArray | float) -> FloatArray:
    return np.asarray(range_[0] * (range_[1] / range_[0]) ** share)
