"""Compares probe designs in the same tubes under one feed, with intervals and paired differences."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from pydantic import ValidationError
from tqdm import tqdm

from agents.policies.catalogue import domains_of, make_policy, name_and_spec
from agents.policies.domain import check_domains
from agents.policies.fixed import Scheduled
from agents.policies.maps.vibration_map import VibrationMap
from agents.policies.places import TABLE_2, Named
from agents.records.columns import CORE, OF_DESIGNS, kpis_of
from agents.records.journal import Journal
from agents.records.models import Stored, Trial, read_json
from agents.records.provenance import commit, provenance, write_atomically, write_json
from agents.records.searches import JOURNAL
from agents.records.tables import Columns, read_csv
from agents.rollouts.bootstrap import Interval, short
from agents.rollouts.plan import Policy
from agents.rollouts.statistics import failures, in_words, mean_interval
from agents.terminal.tables import print_table
from agents.terminal.work import Work, announce
from probe_env import Context, Design, Fidelity
from probe_env.envs.task import TaskConfig
from probe_env.envs.trials import (
    Candidate,
    check_candidate,
    check_measure,
    judge,
    stretch_of,
    try_insertions,
    try_sections,
)
from probe_env.fidelity import with_nodes
from probe_env.schedule import Schedule
from probe_env.settings import explain

STORED: Final = "designs.csv"
COLUMNS: Final[Columns] = {"design": "name", "context": "count", **dict.fromkeys(CORE, "number")}
NEWER: Final[Columns] = dict.fromkeys(OF_DESIGNS, "number")
"""Columns of the stored table that a summary needs, and those that it shows where they are there."""
BATCH = 16
TUBE_FILE: Final = "tube.json"


class Tube(Stored):
    """``tube.json``: the plant that the trials in a folder are of."""

    name: str
    digest: str


@dataclass(frozen=True)
class Comparison:
    """Every design on every context under one feed.

    Attributes:
        designs: by name.
        contexts: tubes.
        feed: a policy by its spec; for sections it must be a schedule over inserted length.
        full: whole insertions instead of sections of constant length.
        fidelity: of the simulation.
        config: the task, with the scene that designs and contexts change.
        vibration: the map that some policies look things up in; default: the shipped one.
        tube: what the plant is called.
    """

    designs: Mapping[str, Design]
    contexts: Sequence[Context]
    feed: str = "constant"
    full: bool = False
    fidelity: Fidelity = field(default_factory=Fidelity)
    config: TaskConfig = field(default_factory=lambda: TaskConfig().all_shown)
    vibration: VibrationMap | None = None
    tube: Named = TABLE_2

    def __post_init__(self) -> None:
        object.__setattr__(self, "fidelity", with_nodes(self.fidelity, self.config.scene))

    def policy(self) -> Policy:
        """The feed as a policy.

        Raises:
            ValueError: there is no such policy.
        """
        return make_policy(self.feed, self.config, self.vibration)

    def schedule(self) -> Schedule:
        """The feed as a schedule.

        Raises:
            ValueError: it is none over inserted length.
        """
        policy = self.policy()
        if self.feed == "constant":
            return Schedule("inserted_length", "linear", (5.0,), (0.2,), (63.0 / 3600.0,))
        if not isinstance(policy, Scheduled) or policy.schedule.over != "inserted_length":
            raise ValueError(
                f"feed = {self.feed!r} is not a schedule over inserted length: give --full for policies and agents"
            )
        return policy.schedule

    def key(self, design: Design, context: Context, index: int = 0) -> str:
        """Identity of one result; the index of the context seeds the start."""
        parts = [
            index, design.built.model_dump(), context.model_dump(), self.policy().describe(), self.full,
            self.fidelity.model_dump(), self.config.model_dump(mode="json"), version("probe-env"), commit(),
        ]  # fmt: skip
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]

    def run(
        self, pairs: Sequence[tuple[Design, Context]], seeds: Sequence[int], threads: int | None = None
    ) -> list[dict[str, float]]:
        """KPIs and reward of some pairs, in one batch."""
        candidates = [
            Candidate(design, context, self.policy() if self.full else self.schedule(), seed)
            for (design, context), seed in zip(pairs, seeds, strict=True)
        ]
        tried = try_insertions if self.full else try_sections
        trial = tried(candidates, self.config, self.fidelity, threads=threads)
        terms, kpis = judge([design for design, _ in pairs], trial, self.config)
        rewards = np.sum(list(terms.values()), axis=0)
        return [
            {"reward": float(rewards[k])} | {name: float(values[k]) for name, values in kpis.items()}
            for k in range(len(pairs))
        ]


def compare(comparison: Comparison, output: Path) -> pd.DataFrame:
    """Run what is missing in ``output``, store designs.csv and summary.csv; one row per design and context.

    Raises:
        ValueError: no designs, or the feed does not fit; nothing was run.
    """
    if not comparison.designs:
        raise ValueError("designs = none: give at least one design file (TOML) or the name of one that ships")
    check_comparison(comparison)
    journal = Journal(output / "designs.jsonl", Trial)
    claim(output, comparison.tube)
    units = [(name, k) for name in comparison.designs for k in range(len(comparison.contexts))]
    keys = {u: comparison.key(comparison.designs[u[0]], comparison.contexts[u[1]], u[1]) for u in units}
    every, done = set(keys.values()), journal.read()
    missing = [unit for unit in units if keys[unit] not in done]
    announce(Work("trial", len(every), lambda: len(every & journal.read().keys()), output))
    if missing:
        with journal.appending() as append, tqdm(total=len(missing), desc="designs", unit="trial") as bar:
            for begin in range(0, len(missing), BATCH):
                part = missing[begin : begin + BATCH]
                pairs = [(comparison.designs[name], comparison.contexts[k]) for name, k in part]
                rows = zip(part, comparison.run(pairs, [k for _, k in part]), strict=True)
                lines = [{"key": keys[unit], "commit": commit(), "kpis": kpis} for unit, kpis in rows]
                append("".join(f"{json.dumps(line)}\n" for line in lines))
                bar.update(len(part))
        done = journal.read()
    column = tube_column(comparison.tube)
    table = pd.DataFrame(
        {"design": name, "context": k} | column | comparison.contexts[k].model_dump() | done[keys[name, k]]["kpis"]
        | {"commit": done[keys[name, k]].get("commit", "unknown")}
        for name, k in units
    )  # fmt: skip
    write_atomically(output / STORED, table.to_csv(index=False, float_format="%.6g"))
    write_atomically(output / "summary.csv", summarise(table).to_csv(index=False, float_format="%.6g"))
    setting: dict[str, Any] = {"designs": {name: d.built.model_dump() for name, d in comparison.designs.items()}}
    setting |= {"feed": comparison.feed, "full": comparison.full, "fidelity": comparison.fidelity.model_dump()} | column
    write_json(output / "provenance.json", provenance(commits=table["commit"]) | setting)
    return table


def claim(output: Path, tube: Named) -> None:
    """Write down which plant the trials in a folder are of; a folder with trials that does not say is of table 2.

    Raises:
        ValueError: it holds trials of another plant; nothing is changed.
    """
    path = output / TUBE_FILE
    before = read_json(path, Tube) if path.exists() else Tube(name=TABLE_2.name, digest=TABLE_2.digest)
    in_use = path.exists() or any((output / name).exists() for name in ("designs.jsonl", JOURNAL, "trials.csv"))
    if in_use and before.digest != tube.digest:
        other = "" if before.name != tube.name else ", as its file was then"
        problem = f"holds trials in the tubes of {before.name}{other}, not of {tube.name}: choose another folder"
        raise ValueError(f"output = {str(output)!r} {problem}")
    if tube != TABLE_2:
        write_json(path, {"name": tube.name, "digest": tube.digest})


def check_comparison(comparison: Comparison) -> None:
    """Raise ValueError if a design cannot be tried in a tube, or the task's measure is none of designs."""
    check_measure(comparison.config)
    stretch_of(comparison.config)
    feed = None if comparison.full else comparison.schedule()
    if comparison.tube == TABLE_2:
        return  # of the design space none is refused there
    name = name_and_spec(comparison.feed)[0]
    domains = domains_of([comparison.feed], {name: comparison.policy()})
    check_domains(domains, comparison.config, comparison.contexts, strict=False)
    for name, design in comparison.designs.items():
        for context in comparison.contexts:
            try:
                check_candidate(design, context, comparison.config, comparison.fidelity, feed)
            except ValueError as error:
                reason = explain(error) if isinstance(error, ValidationError) else error
                raise ValueError(f"design {name!r} in {comparison.tube.name}: {reason}") from error


def tube_column(tube: Named) -> dict[str, str]:
    """Column of a table that names its plant; none for the tubes of table 2."""
    return {"tube": tube.title} if tube.title else {}


def summarise(table: pd.DataFrame) -> pd.DataFrame:
    """Mean of every KPI of every design with its interval over the contexts, and paired with the first design's."""
    first, rows = str(table["design"].iloc[0]), []
    by_design = {name: part.set_index("context") for name, part in table.groupby("design", sort=False)}
    for name, part in by_design.items():
        for kpi in kpis_of(part.columns, OF_DESIGNS):
            mean = mean_interval(part[kpi].to_numpy())
            change = mean_interval((part[kpi] - by_design[first][kpi]).to_numpy())
            rows.append((name, kpi, mean.mean, mean.low, mean.high, change.mean, change.low, change.high))
    columns = ["design", "kpi", "mean", "low", "high", "change", "change_low", "change_high"]
    return pd.DataFrame(rows, columns=columns)


def cells(summary: pd.DataFrame) -> list[list[str]]:
    """Rows of text: a design, its KPIs with intervals, and the change of the reward against the first design."""
    rows, kpis = [], kpis_of(summary["kpi"], OF_DESIGNS)
    for name in dict.fromkeys(summary["design"]):
        part = summary[summary["design"] == name].set_index("kpi")
        texts = [
            _text(Interval(*part.loc[kpi, ["mean", "low", "high"]]), factor) for kpi, (_, factor, _) in kpis.items()
        ]
        change = _text(Interval(*part.loc["reward", ["change", "change_low", "change_high"]]))
        rows.append([str(name), *texts, change])
    return rows


def _text(interval: Interval, factor: float = 1.0) -> str:
    """Mean with its interval; an interval of no width, as of one tube, is left out."""
    return interval.text(factor) if interval.low < interval.high else short(interval.mean * factor)


def header(summary: pd.DataFrame) -> list[str]:
    """Headers of ``cells``."""
    shown = kpis_of(summary["kpi"], OF_DESIGNS).values()
    return ["design", *(f"{name} [{unit}]" if unit else name for name, _, unit in shown), "reward, change"]


def read_comparison(folder: Path) -> pd.DataFrame:
    """The stored rows of a comparison, one per design and context.

    Raises:
        FileNotFoundError: none is stored there.
        FileError: the file is damaged.
    """
    return read_csv(folder / STORED, COLUMNS, NEWER)


def print_comparison(table: pd.DataFrame) -> None:
    """Print the summary."""
    where = f" of {table['tube'].iloc[0]}" if "tube" in table else ""
    number = table["context"].nunique()
    means = f"Means over {number} tubes{where} with 95 % intervals" if number > 1 else f"One tube{where}"
    title = f"{means}; change against the first"
    summary = summarise(table)
    print_table(title, header(summary), cells(summary))
    for name, part in table.groupby("design", sort=False):
        print(f"{name}: {', '.join(in_words(failures(part)))}")
