"""Probe designs compared: the same tubes, the same feed, the same metres, with intervals and paired differences."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import pandas as pd
from pydantic import FiniteFloat, ValidationError, model_validator
from tqdm import tqdm

from agents.design.folders import claim
from agents.evaluation.kpis import CORE, CORE_FAILURES, OF_DESIGNS, kpis_of
from agents.evaluation.statistics import Interval, failures, in_words, mean_interval, short
from agents.policies.catalogue import domains_of, make_policy, name_and_spec
from agents.policies.fixed import Scheduled
from agents.policies.places import TABLE_2, Named
from agents.policies.policy import Policy, check_domains
from agents.records.code_hash import class_hash, code_hash
from agents.records.journal import Journal
from agents.records.models import Key, Stored, require
from agents.records.provenance import commit, provenance, write_atomically, write_json
from agents.records.tables import Columns, read_csv
from agents.terminal.tables import print_table
from agents.terminal.work import Work, announce
from probe_env import Context, Design, Fidelity
from probe_env.envs.surrogate.vibration_map import VibrationMap
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
"""Of the stored table, as far as a summary takes them: what it needs, and what it shows where it is there."""
BATCH = 16
CODE = ("probe_env.envs.trials:try_insertions", "probe_env.envs.trials:try_sections", "probe_env.envs.trials:judge")
"""What a result depends on, besides the feed."""


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

    def key(self, design: Design, context: Context, place: int = 0) -> str:
        """Identity of one result; the context's place seeds the start."""
        policy = self.policy()
        parts = [
            place,
            design.built.model_dump(), context.model_dump(), policy.describe(), class_hash(type(policy), "predict"),
            self.full, self.fidelity.model_dump(), self.config.model_dump(mode="json"),
            code_hash(CODE, self.fidelity.method),
        ]  # fmt: skip
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]

    def run(
        self, pairs: Sequence[tuple[Design, Context]], seeds: Sequence[int], threads: int | None = None
    ) -> list[dict[str, float]]:
        """KPIs and reward of some pairs, side by side."""
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
    """Run what is missing in ``output``, store designs.csv and summary.csv; one row a design and context.

    Raises:
        ValueError: no designs, or the feed does not fit; nothing was run.
    """
    if not comparison.designs:
        raise ValueError("designs = none: give at least one design file (TOML) or the name of one that ships")
    check_comparison(comparison)
    journal = trials_of(output)
    claim(output, comparison.tube)
    done = journal.read()
    units = [(name, k) for name in comparison.designs for k in range(len(comparison.contexts))]
    keys = {u: comparison.key(comparison.designs[u[0]], comparison.contexts[u[1]], u[1]) for u in units}
    missing = [unit for unit in units if keys[unit] not in done]
    every = set(keys.values())
    announce(Work("trial", len(every), lambda: len(every & journal.read().keys()), output))
    if missing:
        with journal.appending() as append, tqdm(total=len(missing), desc="designs", unit="trial") as bar:
            for begin in range(0, len(missing), BATCH):
                part = missing[begin : begin + BATCH]
                pairs = [(comparison.designs[name], comparison.contexts[k]) for name, k in part]
                kpis = comparison.run(pairs, [k for _, k in part])
                append("".join(_line(keys[unit], values) for unit, values in zip(part, kpis, strict=True)))
                bar.update(len(part))
        done = journal.read()
    rows: list[dict[str, Any]] = []
    for name, k in units:
        place, record = {"design": name, "context": k}, done[keys[name, k]]
        origin = {"commit": record.get("commit", "unknown")}
        rows.append(
            place | tube_column(comparison.tube) | comparison.contexts[k].model_dump() | record["kpis"] | origin
        )
    table = pd.DataFrame(rows)
    write_atomically(output / STORED, table.to_csv(index=False, float_format="%.6g"))
    write_atomically(output / "summary.csv", summarise(table).to_csv(index=False, float_format="%.6g"))
    setting: dict[str, Any] = {"designs": {name: d.built.model_dump() for name, d in comparison.designs.items()}}
    setting |= {"feed": comparison.feed, "full": comparison.full, "fidelity": comparison.fidelity.model_dump()}
    setting |= tube_column(comparison.tube)
    write_json(output / "provenance.json", provenance(commits=table["commit"]) | setting)
    return table


def check_comparison(comparison: Comparison) -> None:
    """Raise ValueError if there is a design that cannot be tried, and name it, or a measure that none is judged by."""
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
    """What a table says of its plant; of table 2's tubes nothing, as before there were others."""
    return {"tube": tube.title} if tube.title else {}


def _line(key: str, kpis: dict[str, float]) -> str:
    return json.dumps({"key": key, "commit": commit(), "kpis": kpis}) + "\n"


class Trial(Stored):
    """A line of ``designs.jsonl``."""

    key: Key
    kpis: dict[str, FiniteFloat]

    @model_validator(mode="after")
    def _complete(self) -> Self:
        require("kpis", self.kpis, (*CORE, *CORE_FAILURES))
        return self


def trials_of(output: Path) -> Journal[Trial]:
    """The stored trials of a comparison."""
    return Journal(output / "designs.jsonl", Trial)


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
    """Rows for people: a design, its KPIs with intervals, and the change of the reward against the first design."""
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
    """Of no width, as of one tube, an interval says nothing."""
    return interval.text(factor) if interval.low < interval.high else short(interval.mean * factor)


def header(summary: pd.DataFrame) -> list[str]:
    """What the cells of a row are."""
    shown = kpis_of(summary["kpi"], OF_DESIGNS).values()
    return ["design", *(f"{name} [{unit}]" if unit else name for name, _, unit in shown), "reward, change"]


def read_comparison(folder: Path) -> pd.DataFrame:
    """The stored rows of a comparison, one a design and context.

    Raises:
        FileNotFoundError: none is stored there.
        FileError: the file is damaged.
    """
    return read_csv(folder / STORED, COLUMNS, NEWER)


def print_comparison(table: pd.DataFrame) -> None:
    """The summary on the terminal."""
    where = f" of {table['tube'].iloc[0]}" if "tube" in table else ""
    number = table["context"].nunique()
    means = f"Means over {number} tubes{where} with 95 % intervals" if number > 1 else f"One tube{where}"
    title = f"{means}; change against the first"
    summary = summarise(table)
    print_table(title, header(summary), cells(summary))
    for name, part in table.groupby("design", sort=False):
        print(f"{name}: {', '.join(in_words(failures(part)))}")
