"""Where along the tube finer fidelities hear something else, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from agents.pages.signal.hearing import STEADY, TRIALS, UNHEARING
from agents.pages.sources import RESULTS, markdown
from agents.records.tables import PROFILE, PROFILE_HEARD, read_parquet
from agents.rollouts.bootstrap import Interval, chance_of_mean
from agents.rollouts.statistics import mean_interval
from probe_env.inspection.sensor import Sensor

STRETCH: Final = 5.0
"""[m] of the tube, over which means are taken."""
QUANTITIES: Final = {"snr": ("S/N", 1.0, 2), "radial_rms_m": ("radial rms [µm]", 1e6, 1)}
"""What is compared -> its name, factor and decimals for people."""


class Change(NamedTuple):
    """What a finer fidelity changes in a stretch.

    Attributes:
        quantity: of ``QUANTITIES``.
        finer: the fidelity.
        coarse: mean over the tubes at the coarser one.
        scatter: standard deviation between the tubes there.
        interval: of the change, paired by tube.
        chance: of so large a mean change, see ``chance_of_mean``.
    """

    quantity: str
    finer: str
    coarse: float
    scatter: float
    interval: Interval
    chance: float


Changes = dict[tuple[str, float], list[Change]]
"""Policy and where the stretch begins [m] -> what finer fidelities change there."""


def hearing_along() -> str:
    """Where along the tube S/N and vibration differ between ``fast``, ``standard`` and ``reference``."""
    return _along_at("fast", next(iter(TRIALS)), UNHEARING)


def steady_along() -> str:
    """The same for ``fast-steady``; a table of the policy that feeds faster than that takes for steady."""
    return _along_at(STEADY, "steady-fresh", UNHEARING[1:])


def _along_at(fidelity: str, name: str, shown: Sequence[str]) -> str:
    """Metres of a stage at a coarse fidelity beside those at the finer ones, the same for all.

    Args:
        fidelity: the coarse one.
        name: of the stage.
        shown: policies that have a table; all are judged.
    """
    coarse, fine = _profile(name), {finer: _profile(f"{of}/finer-acting") for of, finer in TRIALS.items()}
    starts = np.unique(_start(coarse)).tolist()
    changes = {place: _changes(coarse, fine, *place) for place in product(UNHEARING, starts)}
    count = sum(map(len, changes.values()))
    least = 0.05 / count  # Bonferroni
    differ = [
        f"{QUANTITIES[change.quantity][0].partition(' [')[0]} of `{policy}` at `{change.finer}` from {start:.0f} m on"
        for (policy, start), row in changes.items()
        for change in row
        if change.chance < least
    ]
    heard = [(place, change) for place, row in changes.items() for change in row if change.quantity == "snr"]
    (policy, start), most = max(heard, key=lambda entry: abs(entry[1].interval.mean) / entry[1].coarse)
    said = f"these differ by more than chance: {'; '.join(differ)}" if differ else "none differs by more than chance"
    tables = (f"`{policy}`:\n\n{_table(fidelity, coarse, changes, policy, least)}" for policy in shown)
    return "\n\n".join(
        (
            f"**S/N changes the most with `{policy}` at `{most.finer}` from {start:.0f} m on, by"
            f" {100.0 * most.interval.mean / most.coarse:.2g} %, where the tubes' standard deviation is"
            f" {100.0 * most.scatter / most.coarse:.2g} %. Of {count} changes {said}.**",
            *tables,
            f"The tubes and stages above, a row for {STRETCH:.0f} m; scatter is the standard deviation between tubes,"
            f" changes have 95 % intervals and are bold where p is under 0.05 / {count}.",
        )
    )


def _profile(folder: str) -> pd.DataFrame:
    return read_parquet(RESULTS / folder / "profile.parquet", {**PROFILE, **PROFILE_HEARD})


def _start(profile: pd.DataFrame) -> pd.Series:
    """Where the stretch begins in which a metre is [m]."""
    return STRETCH * (profile["inserted_length"] // STRETCH)


def _along(profile: pd.DataFrame, policy: str, start: float, quantity: str) -> pd.Series:
    """A mean over a stretch, by tube: of noise and vibration that of their squares."""
    part = profile[(profile["policy"] == policy) & (_start(profile) == start)]
    values = part["noise_rms_m" if quantity == "snr" else quantity]
    mean = (values**2).groupby(part["context"]).mean() ** 0.5
    return Sensor().equivalent_rms(np.array(1.0)) / mean if quantity == "snr" else mean


def _changes(coarse: pd.DataFrame, fine: Mapping[str, pd.DataFrame], policy: str, start: float) -> list[Change]:
    changes = []
    for quantity, (finer, profile) in product(QUANTITIES, fine.items()):
        before = _along(coarse, policy, start, quantity)
        change = (_along(profile, policy, start, quantity) - before).to_numpy()
        changes.append(
            Change(quantity, finer, before.mean(), before.std(), mean_interval(change), chance_of_mean(change))
        )
    return changes


def _table(fidelity: str, coarse: pd.DataFrame, changes: Changes, policy: str, least: float) -> str:
    """A row a stretch of a policy."""
    header, rows = ["from [m]", "feed [m/s]"], []
    for title, _, _ in QUANTITIES.values():
        header += [f"{title} at `{fidelity}`", "scatter", *(f"change at `{finer}`" for finer in TRIALS.values())]
    for start in (start for of, start in changes if of == policy):
        feed = _along(coarse, policy, start, "feed_speed").mean()
        cells = [f"{start:.0f}", f"{feed:.2f}"]
        for quantity, (_, factor, decimals) in QUANTITIES.items():
            row = [change for change in changes[policy, start] if change.quantity == quantity]
            cells += [f"{factor * value:.{decimals}f}" for value in (row[0].coarse, row[0].scatter)]
            for change in row:
                ends = change.interval.mean, change.interval.low, change.interval.high
                mean, low, high = (_fixed(factor * end, decimals) for end in ends)
                text = f"{mean} [{low}, {high}]"
                cells.append(f"**{text}**" if change.chance < least else text)
        rows.append(cells)
    return markdown(header, rows)


def _fixed(value: float, decimals: int) -> str:
    """A number with so many decimals, and no minus at a zero."""
    return f"{round(value, decimals) + 0.0:.{decimals}f}"
