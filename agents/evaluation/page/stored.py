"""What a page is made of: the tables of a finished evaluation, or the episodes that an interrupted one has stored."""

from __future__ import annotations

import errno
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from agents.records.models import Compared, Evaluated, Setting, Unfinished
from agents.records.reading import FileError, check_table, read_json, read_parquet
from agents.records.tables import EPISODES, EPISODES_NEWER, PROFILE, read_episodes
from agents.rollouts.folder import UNFINISHED, episodes_of, gathered
from agents.rollouts.statistics import grouped
from probe_env import Context

PLACE = ["context", "seed"]


@dataclass(frozen=True)
class Missing:
    """What an interrupted evaluation has not run yet.

    Attributes:
        stored: episodes that are stored.
        planned: episodes of the whole evaluation; 0: nobody knows.
        gaps: policy and what of it is missing, in words.
        left_out: policies that are stored in part and not compared, as too few tubes are common to all.
        command: that goes on; empty: not known.
    """

    stored: int
    planned: int
    gaps: tuple[tuple[str, str], ...]
    left_out: tuple[str, ...]
    command: str


@dataclass(frozen=True)
class Evaluation:
    """An evaluation as it is stored.

    Attributes:
        table: KPIs, a row an episode, training seeds of a method gathered (``grouped``).
        profile: metres of these episodes, alike.
        setting: what all episodes share.
        record: what made them; None: not known.
        against: policy that the others are compared with.
        own: policies that are the user's.
        missing: of an interrupted one; None: it is whole.
    """

    table: pd.DataFrame
    profile: pd.DataFrame
    setting: Setting
    record: Evaluated | None
    against: str
    own: tuple[str, ...]
    missing: Missing | None


def read_evaluation(folder: Path) -> Evaluation:
    """The tables of a folder; of an interrupted evaluation what can be compared of the episodes that it has stored.

    Raises:
        FileNotFoundError: no evaluation is stored there.
        FileError: a file is damaged, or no episode is stored yet.
    """
    journal = episodes_of(folder).path
    finished = [folder / name for name in ("episodes.parquet", "profile.parquet", "provenance.json")]
    if (folder / UNFINISHED).exists() or (journal.exists() and not all(path.exists() for path in finished)):
        return _interrupted(folder)
    for path in finished:
        if not path.exists():
            raise FileNotFoundError(errno.ENOENT, "no evaluation is stored there", str(path))
    table, profile = (
        grouped(read_episodes(finished[0])),
        grouped(read_parquet(finished[1], PROFILE)),
    )
    if not set(profile["policy"]) <= set(table["policy"]):
        raise FileError(finished[1], "of policies that are not in episodes.parquet: evaluate again into this folder")
    setting, compared = read_json(folder / "setting.json", Setting), _compared(folder)
    against = compared_with(folder, table)
    record, own = read_json(finished[2], Evaluated), _own(compared, table)
    return Evaluation(table, profile, setting, record, against, own, None)


def compared_with(folder: Path, table: pd.DataFrame) -> str:
    """The policy that a stored evaluation compares the others with; the first, if it does not say."""
    against = _compared(folder).against or str(table["policy"].iloc[0])
    if against not in set(table["policy"]):
        raise FileError(
            folder / "report.json",
            f"against = {against!r} is not one of the policies: {', '.join(dict.fromkeys(table['policy']))}",
        )
    return against


def _compared(folder: Path) -> Compared:
    path = folder / "report.json"
    return read_json(path, Compared) if path.exists() else Compared(against="")


def _own(compared: Compared, table: pd.DataFrame) -> tuple[str, ...]:
    return tuple(name for name in compared.own if name in set(table["policy"]))


def _interrupted(folder: Path) -> Evaluation:
    setting, journal = read_json(folder / "setting.json", Setting), episodes_of(folder)
    done = journal.read()
    plan = read_json(folder / UNFINISHED, Unfinished) if (folder / UNFINISHED).exists() else None
    # a version before this one said nothing of what there was to be, nor of the tubes
    planned: Sequence[tuple[str, str, int, int]] = (
        plan.episodes if plan else tuple((key, *record["unit"]) for key, record in _latest(done).items())
    )
    stored = [episode for episode in planned if episode[0] in done]
    if not stored:
        go_on = f": `{plan.command}` goes on" if plan else ""
        raise FileError(journal.path, f"no episode of the evaluation is stored yet{go_on}")
    contexts = plan.contexts if plan else (Context(),) * (1 + max(k for _, _, k, _ in stored))
    chosen = comparable(stored)
    table, profile = gathered(chosen, contexts, done)
    if plan is None:
        table = table.assign(**dict.fromkeys(Context.model_fields, 0.0))
    check_table(journal.path, table, EPISODES, EPISODES_NEWER)
    check_table(journal.path, profile, PROFILE)
    table, profile, compared = grouped(table), grouped(profile), _compared(folder)
    left_out = dict.fromkeys(name for _, name, _, _ in stored if name not in {name for _, name, _, _ in chosen})
    missing = Missing(
        len(stored),
        len(planned) if plan else 0,
        tuple(_gaps(planned, done)),
        tuple(left_out),
        plan.command if plan else "",
    )
    against = compared.against if compared.against in set(table["policy"]) else str(table["policy"].iloc[0])
    return Evaluation(table, profile, setting, plan, against, _own(compared, table), missing)


def _latest(done: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Of episodes with the same policy, tube and seed the last: a policy may have been changed in between."""
    by_unit = {tuple(record["unit"]): key for key, record in done.items()}
    return {key: done[key] for key in by_unit.values()}


def comparable(stored: Sequence[tuple[str, str, int, int]]) -> list[tuple[str, str, int, int]]:
    """Episodes of policies on the tubes and seeds that all of these policies have, as many episodes as there can be."""
    places: dict[str, set[tuple[int, int]]] = {}
    for _, name, k, seed in stored:
        places.setdefault(name, set()).add((k, seed))
    names = sorted(places, key=lambda name: -len(places[name]))  # keeps the order of equals
    groups = [names[: number + 1] for number in range(len(names))]
    shared = [set.intersection(*(places[name] for name in group)) for group in groups]
    best = max(range(len(groups)), key=lambda number: (len(groups[number]) * len(shared[number]), number))
    return [e for e in stored if e[1] in groups[best] and (e[2], e[3]) in shared[best]]


def _gaps(planned: Iterable[tuple[str, str, int, int]], done: dict[str, Any]) -> Iterable[tuple[str, str]]:
    """Every policy that is not whole, and what of it is missing."""
    units: dict[str, list[tuple[int, bool]]] = {}
    for key, name, k, _ in planned:
        units.setdefault(name, []).append((k, key in done))
    for name, episodes in units.items():
        missing = [k for k, there in episodes if not there]
        if len(missing) == len(episodes):
            yield name, f"all of its {len(episodes)} insertions"
        elif missing:
            tubes = "tubes" if len(set(missing)) > 1 else "tube"
            yield name, f"{len(missing)} of {len(episodes)} insertions: {tubes} {spans(missing)}"


def spans(numbers: Iterable[int]) -> str:
    """Whole numbers in words: "0 to 3, 7"."""
    runs: list[list[int]] = []
    for number in sorted(set(numbers)):
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return ", ".join(f"{low}" if low == high else f"{low} to {high}" for low, high in runs)
