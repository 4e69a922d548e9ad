"""Which log was recorded in which tube, as a user says it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from agents.calibration.calibration import Recorded
from agents.logs.log import read_log
from agents.records.shipped import file_or_shipped
from agents.terminal.names import name_of, name_problem
from probe_env import Plant
from probe_env.settings import within


def recorded_of(
    paths: Sequence[Path], plant: Plant, helix_diameters: Sequence[float], tubes: Sequence[str], columns: Sequence[str]
) -> list[Recorded]:
    """The logs with their tubes; everything that is said is checked before the first is read.

    Raises:
        FileNotFoundError: no such file.
        ValueError: a log that cannot be read, or as many diameters or names as there are no logs; names them.
    """
    if not paths:
        raise ValueError("logs: give one log at least")
    diameters = list(helix_diameters) or list(plant.diameters)
    if len(diameters) == 1:
        diameters *= len(paths)
    if len(diameters) != len(paths):
        what = "--helix-diameters" if helix_diameters else "tube.helix_diameter"
        raise ValueError(
            f"{what}: {len(diameters)} for {len(paths)} logs: give --helix-diameters, one for all or one each [m]"
        )
    check_diameters(diameters, plant)
    names = list(tubes) or [f"{diameter:g} m" for diameter in diameters]
    if len(names) != len(paths):
        raise ValueError(f"--tubes: {len(names)} names for {len(paths)} logs: give one for each log")
    for name in names:
        if problem := name_problem(name):
            raise ValueError(f"--tubes: {name[:100]!r} {problem}")
    for name in dict.fromkeys(names):
        distinct = {diameter for diameter, other in zip(diameters, names, strict=True) if other == name}
        if len(distinct) > 1:
            listed = " and ".join(f"{d:g}" for d in sorted(distinct))
            raise ValueError(f"--tubes: {name!r} has helix diameters of {listed} m: a tube has one")
    files = [file_or_shipped("logs", path) for path in paths]
    labels = [name_of(file) for file in files]
    if len(set(labels)) < len(labels):
        labels = [str(path) for path in paths]
    return [
        Recorded(label, read_log(file, columns), name, diameter)
        for label, file, name, diameter in zip(labels, files, names, diameters, strict=True)
    ]


def check_diameters(diameters: Sequence[float], plant: Plant) -> None:
    """Raise ValueError if a helix diameter [m] is none of the plant's, where it lists several, or cannot be one."""
    for diameter in diameters:
        within("helix_diameter", diameter, 0.3, 1e4, "m")
        if len(plant.diameters) > 1 and not any(abs(diameter - known) < 1e-6 for known in plant.diameters):
            listed = ", ".join(f"{known:g}" for known in plant.diameters)
            raise ValueError(f"--helix-diameters: {diameter:g} m is none of the plant's: {listed} m")
