"""The files of an evaluation: the journal of episodes, its tables, and the reader of both.

``setting.json`` holds the common settings, ``unfinished.json`` the planned episodes until the tables are written,
``report.json`` the reference policy of the report and the bundle of tubes.
"""

import errno
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

import numpy as np
import pandas as pd
from pydantic import FiniteFloat, NonNegativeInt, model_validator

from probe_agents.evaluation.kpis import (
    CORE,
    CORE_FAILURES,
    COST_KPIS,
    KPIS,
    OF_INSTRUMENT,
    PROFILE_COLUMNS,
    PROFILE_COLUMNS_INSTRUMENT,
)
from probe_agents.evaluation.statistics import grouped, with_goal
from probe_agents.records.models import Key, Record, Stored, read_json, require
from probe_agents.records.result_folder import SETTING, Journal, check_hashes
from probe_agents.records.tables import Columns, Kind, check_table, read_csv, read_parquet
from probe_agents.terminal.names import name_problem
from probe_env import Context
from probe_env.design import RANGES
from probe_env.envs.episodes.starts import Probes
from probe_env.envs.plants import Bundle
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.rules import ENDINGS
from probe_env.files import FileError
from probe_env.inspection.metrics import POD_NAMES

UNFINISHED: Final = "unfinished.json"
EPISODE_RECORDS: Final = "episodes.jsonl"
FILES: Final = ("episodes.csv", "episodes.parquet", "profile.parquet")
CASE: Final[dict[str, Kind]] = {"policy": "name", "context": "count", "seed": "count"}
EPISODES: Final[Columns] = {
    **CASE,
    **dict.fromkeys((*KPIS, *OF_INSTRUMENT, *COST_KPIS, *POD_NAMES, *ENDINGS), "number?"),
    **dict.fromkeys((*Context.model_fields, *CORE, "complete", *CORE_FAILURES), "number"),
}
"""Columns of ``episodes.csv`` and ``episodes.parquet``; some depend on task and fidelity."""
PROFILE: Final[Columns] = {
    **dict.fromkeys(PROFILE_COLUMNS, "maybe"), **dict.fromkeys(PROFILE_COLUMNS_INSTRUMENT, "maybe?"), **CASE
}  # fmt: skip
"""Columns of ``profile.parquet``, one row per metre; NaN where a probe diverged."""
EpisodeId = tuple[str, int, int]
"""Policy name, context number and seed of an episode."""
Planned = tuple[str, str, int, int]
"""Key, policy name, context number and seed of an episode."""


class Episode(Stored):
    """A line of ``episodes.jsonl``. Profiles hold NaN for the period in which a probe diverged."""

    key: Key
    episode: EpisodeId
    kpis: dict[str, FiniteFloat]
    profile: dict[str, list[float]]
    probe: dict[str, FiniteFloat] | None = None

    @model_validator(mode="after")
    def _complete(self) -> Self:
        require("kpis", self.kpis, (*CORE, "complete", *CORE_FAILURES))
        require("profile", self.profile, PROFILE_COLUMNS)
        require("probe", self.probe or RANGES, RANGES)
        if len({len(values) for values in self.profile.values()}) > 1:
            raise ValueError("profile: the columns differ in length")
        return self


class Setting(Stored):
    """``setting.json``: common settings of all episodes of a folder."""

    task: TaskConfig
    fidelity: dict[str, Any]
    probes: Probes


class Manifest(Record):
    """``manifest.json`` of an evaluation."""

    policies: dict[str, dict[str, Any]]


class Unfinished(Manifest):
    """``unfinished.json``: the planned episodes, until the tables are written."""

    contexts: tuple[Context, ...]
    episodes: tuple[tuple[Key, str, NonNegativeInt, NonNegativeInt], ...]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for _, policy, context, _ in self.episodes:
            problem = name_problem(policy)
            if not problem and (context >= len(self.contexts) or policy not in self.policies):
                problem = f"in tube {context}: no such policy or tube"
            if problem:
                raise ValueError(f"episodes: {policy!r} {problem}")
        return self


class ReportSettings(Stored):
    """``report.json``: the reference policy, the policies that are files of the user, bundle and name of the plant.

    ``sensitivity`` is of a recommendation, whose report begins with the best policy: rows under its header, or none.
    """

    against: str
    user_policies: tuple[str, ...] = ()
    bundle: Bundle | None = None
    plant: str | None = None
    sensitivity: tuple[tuple[str, ...], ...] | None = None

    def to_json(self) -> dict[str, Any]:
        """Content of the file."""
        return self.model_dump(mode="json", exclude_none=True)


def episodes_of(output: Path) -> Journal[Episode]:
    """The journal of an evaluation's episodes."""
    return Journal(output / EPISODE_RECORDS, Episode)


def read_episodes(path: Path) -> pd.DataFrame:
    """A table of episodes, CSV or Parquet."""
    check_hashes(path.parent, path.name)
    return (read_csv if path.suffix == ".csv" else read_parquet)(path, EPISODES)


def collect_tables(
    planned: Sequence[Planned], contexts: Sequence[Context], done: Mapping[str, dict[str, Any]]
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """KPIs with one row per episode, and profiles with one row per metre, of planned episodes, all ``done`` by key."""
    rows, profiles = [], []
    for key, name, k, seed in planned:
        record = done[key]
        case: dict[str, Any] = {"policy": name, "context": k, "seed": seed}
        origin = {"commit": record.get("commit", "unknown")}
        rows.append(case | contexts[k].model_dump() | record.get("probe", {}) | record["kpis"] | origin)
        profiles.append(pd.DataFrame(record["profile"]).astype(np.float32).assign(**case))
    return pd.DataFrame(rows), pd.concat(profiles, ignore_index=True)


class Missing(NamedTuple):
    """Numbers of stored and planned episodes of an interrupted evaluation; policies and their missing episodes."""

    stored: int
    planned: int
    gaps: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Evaluation:
    """A stored evaluation.

    Attributes:
        table: KPIs with one row per episode, training seeds under one name (``grouped``), and goal (``with_goal``).
        profile: one row per metre of these episodes, grouped too.
        setting: common settings of all episodes.
        record: command, commit, machine, descriptions of the policies.
        report: settings of the report, of policies in the table.
        missing: episodes that an interrupted evaluation lacks; None: it is finished.
    """

    table: pd.DataFrame
    profile: pd.DataFrame
    setting: Setting
    record: Manifest
    report: ReportSettings
    missing: Missing | None


def is_evaluation(folder: Path) -> bool:
    """Whether a path is the folder of an evaluation, finished or not."""
    return folder.is_dir() and any((folder / name).exists() for name in (SETTING, UNFINISHED))


def read_evaluation(folder: Path) -> Evaluation:
    """The tables of a folder; for an interrupted evaluation, the stored episodes that can be compared."""
    if (folder / UNFINISHED).exists():
        return _interrupted(folder)
    paths = [folder / name for name in ("episodes.parquet", "profile.parquet", "manifest.json", SETTING)]
    if missing := [path for path in paths if not path.exists()]:
        raise FileNotFoundError(errno.ENOENT, "no evaluation is stored there", str(missing[0]))
    check_hashes(folder, "profile.parquet", SETTING)
    table, profile = grouped(read_episodes(paths[0])), grouped(read_parquet(paths[1], PROFILE))
    if not set(profile["policy"]) <= set(table["policy"]):
        raise FileError(paths[1], "has policies that are not in episodes.parquet: evaluate again into this folder")
    report = _report_settings(folder, table, strict=True)
    setting, record = read_json(paths[3], Setting), read_json(paths[2], Manifest)
    return Evaluation(with_goal(table, setting.task, report.bundle), profile, setting, record, report, None)


def _report_settings(folder: Path, table: pd.DataFrame, strict: bool) -> ReportSettings:
    path, policies = folder / "report.json", list(dict.fromkeys(table["policy"]))
    settings = read_json(path, ReportSettings) if path.exists() else ReportSettings(against="")
    users = tuple(name for name in settings.user_policies if name in policies)
    against = settings.against
    if against not in policies:
        if strict and against:
            raise FileError(path, f"against = {against!r} is not one of the policies: {', '.join(policies)}")
        against = str(policies[0])
    return settings.model_copy(update={"against": against, "user_policies": users})


def _interrupted(folder: Path) -> Evaluation:
    plan, setting = read_json(folder / UNFINISHED, Unfinished), read_json(folder / SETTING, Setting)
    journal = episodes_of(folder)
    done = journal.read()
    stored = [episode for episode in plan.episodes if episode[0] in done]
    if not stored:
        raise FileError(journal.path, f"no episode is stored yet: `{plan.command}` continues the evaluation")
    chosen = comparable(stored)
    table, profile = collect_tables(chosen, plan.contexts, done)
    check_table(journal.path, table, EPISODES)
    check_table(journal.path, profile, PROFILE)
    table, profile = grouped(table), grouped(profile)
    total = Counter(name for _, name, _, _ in plan.episodes)
    absent = Counter(name for key, name, _, _ in plan.episodes if key not in done)
    gaps = tuple((name, f"{absent[name]} of {total[name]} insertions") for name in total if absent[name])
    missing = Missing(len(stored), len(plan.episodes), gaps)
    report = _report_settings(folder, table, strict=False)
    return Evaluation(with_goal(table, setting.task, report.bundle), profile, setting, plan, report, missing)


def comparable(stored: Sequence[Planned]) -> list[Planned]:
    """The largest set of episodes with every chosen policy on the same cases."""
    cases: dict[str, set[tuple[int, int]]] = {}
    for _, name, k, seed in stored:
        cases.setdefault(name, set()).add((k, seed))
    names = sorted(cases, key=lambda name: -len(cases[name]))
    groups = [names[: number + 1] for number in range(len(names))]
    shared = [set.intersection(*(cases[name] for name in group)) for group in groups]
    best = max(range(len(groups)), key=lambda number: (len(groups[number]) * len(shared[number]), number))
    return [e for e in stored if e[1] in groups[best] and (e[2], e[3]) in shared[best]]
