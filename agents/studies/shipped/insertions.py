"""Simulated insertions with varying feed and air, in tubes over wide ranges: training data of the response."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from scipy.stats import qmc

from agents.plant.logs import Log
from agents.plant.prior import FRICTION, STIFFNESS
from agents.plant.response import CHANNELS, metres_of
from agents.records.atomic import write_atomically
from agents.terminal.work import Work, announce
from probe_env import Context, Fidelity, Plant
from probe_env.arrays import FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.envs.plants import Tubes
from probe_env.envs.task import TaskConfig, value_at
from probe_env.envs.task.scales import ACCELEROMETER_FLOOR, RF_FLOOR
from probe_env.errors import StabilityWarning
from probe_env.fidelity import PRESETS
from probe_env.files import read_arrays

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
FIDELITY: Final = "standard"
RECORDED: Final = {
    "root_tension": ("tension_mean_n", 0.0),
    "radial_acceleration_rms": ("radial_acceleration_rms_m_per_s2", ACCELEROMETER_FLOOR),
    "axial_acceleration_rms": ("axial_acceleration_rms_m_per_s2", ACCELEROMETER_FLOOR),
    "rf_noise_rms": ("radial_rms_m", RF_FLOOR),
}
"""Channel of a log -> statistic of a window, and the sensor's own noise that adds to it (root of the squares)."""
Program = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Feed speeds [m/s] and air supplies [m3/s] of N insertions at inserted lengths [m], (N,) each."""


class Specimen(NamedTuple):
    """A tube with a probe in it: context, and the damping time of the cable [s]."""

    context: Context
    damping_time: float


def tubes_of(group: int) -> tuple[Plant, list[Specimen]]:
    """Plant and specimens of a group; together they fill what may be evenly."""
    spread = qmc.Sobol(5, rng=np.random.default_rng(SEED))
    shares = spread.fast_forward(group * SIZE).random(SIZE) if group else spread.random(SIZE)
    bore = float(value_at(qmc.Halton(1, scramble=False).fast_forward(group + 1).random(1)[0, 0], BORES))
    plant = Plant(
        tube=Tubes(inner_diameter=round(bore, 6), helix_length=LENGTHS[group % len(LENGTHS)]),
        task={"lost_drive_periods": 1000, "time_limit": 1e4},
    )

    def specimen(a: float, b: float, c: float, d: float, e: float) -> Specimen:
        tube = {"friction": value_at(np.asarray(a), FRICTION), "contact_stiffness": _geometric(STIFFNESS, b)}
        tube |= {"drag_factor": value_at(np.asarray(c), DRAG_FACTORS), "helix_diameter": _geometric(DIAMETERS, d)}
        return Specimen(Context(**{name: float(v) for name, v in tube.items()}), float(_geometric(DAMPING, e)))

    return plant, [specimen(*row) for row in shares]


def wandering(group: int) -> Program:
    """Feed and air drawn anew every ``SEGMENT``, straight between; slow feeds are rarer, for they take the time."""
    knots = np.arange(0.0, max(LENGTHS) + SEGMENT, SEGMENT)
    shares = np.random.default_rng([SEED, group]).random((2, SIZE, len(knots)))

    def program(length: FloatArray) -> tuple[FloatArray, FloatArray]:
        feed, air = (
            np.array([np.interp(place, knots, row) for place, row in zip(length, share, strict=True)])
            for share in shares
        )
        return _geometric(FEEDS, feed**0.7), value_at(air, AIRS)

    return program


def insert(
    specimens: Sequence[Specimen], program: Program, config: TaskConfig, fidelity: Fidelity, seed: Sequence[int]
) -> list[Log]:
    """Logs of insertions side by side, to the end of the helix, the time limit or a period that diverges.

    They are without sensor noise but for the floors of ``RECORDED``.
    """
    count = len(specimens)
    episodes = Episodes(count, config, fidelity=fidelity)
    options = {k: {"context": s.context, "probe": {"damping_time": s.damping_time}} for k, s in enumerate(specimens)}
    rngs = {k: np.random.default_rng([*seed, k]) for k in range(count)}
    _, infos = episodes.reset(range(count), rngs, options)
    length, time = np.array([infos[k]["inserted_length"] for k in range(count)]), np.zeros(count)
    rows: list[list[tuple[float, ...]]] = [[] for _ in range(count)]
    while episodes.running.any():
        active = episodes.running.copy()
        episodes.step(config.actions(*program(length)), active)
        window = episodes.window
        assert window is not None
        after = np.minimum(window.inserted_length, config.scene.tube.helix_length)
        felt = [np.hypot(window.statistics[name], floor) for name, floor in RECORDED.values()]
        felt[0] = window.statistics["tension_mean_n"]  # which may push
        for k in np.flatnonzero(active & ~window.diverged).tolist():
            fed = (after[k] - length[k]) / config.period
            rows[k].append((time[k], length[k], fed, window.air_supply_rate[k], *(column[k] for column in felt)))
        length, time = np.where(active, after, length), time + config.period * active
    tables = (np.array(listed, dtype=float).reshape(-1, 4 + len(RECORDED)) for listed in rows)
    return [
        Log(t[:, 0], t[:, 1], t[:, 2], t[:, 3], MappingProxyType(dict(zip(RECORDED, t[:, 4:].T, strict=True))))
        for t in tables
    ]


def simulated(group: int) -> dict[str, FloatArray]:
    """Metres of all insertions of a group, one row each: ``FIELDS`` by name, and which specimen."""
    plant, specimens = tubes_of(group)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)  # of little damping nobody measured the limit
        logs = insert(specimens, wandering(group), plant.configured(), PRESETS[FIDELITY], [SEED, group])
    parts = [(k, metres_of(log)) for k, log in enumerate(logs)]

    def repeated(value: Callable[[int], float]) -> FloatArray:
        return np.concatenate([np.full(len(m), value(k)) for k, m in parts])

    return {
        "specimen": repeated(lambda k: float(group * SIZE + k)),
        "inner_diameter": repeated(lambda _: plant.tube.inner_diameter),
        **{name: repeated(lambda k, n=name: getattr(specimens[k].context, n)) for name in Context.model_fields},  # type: ignore[misc]
        "damping_time": repeated(lambda k: specimens[k].damping_time),
        **{name: np.concatenate([getattr(m, name) for _, m in parts]) for name in ("length", "feed", "air")},
        **{name: np.concatenate([m.felt[name] for _, m in parts]) for name in CHANNELS},
    }


def make_bank(groups: int, output: Path) -> Iterator[dict[str, FloatArray]]:
    """The groups, simulated where they are not in ``output`` yet; one that was interrupted goes on."""
    files = [output / f"{FIDELITY}-{group:03d}.npz" for group in range(groups)]
    announce(Work("group", groups, lambda: sum(file.exists() for file in files), output))
    output.mkdir(parents=True, exist_ok=True)
    for group, file in enumerate(files):
        if not file.exists():
            buffer = io.BytesIO()
            np.savez_compressed(buffer, **simulated(group))  # type: ignore[arg-type]
            write_atomically(file, buffer.getvalue())
        yield read_arrays(file, lambda _: "f")


def _geometric(range_: tuple[float, float], share: FloatArray | float) -> FloatArray:
    return np.asarray(range_[0] * (range_[1] / range_[0]) ** share)
