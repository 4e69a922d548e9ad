"""Compares probe designs in the same tubes under one feed, with intervals and paired differences."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Final, Self

import numpy as np
import pandas as pd
from pydantic import FiniteFloat, model_validator
from tqdm import tqdm

from probe_agents.design.trials import DesignTrials
from probe_agents.evaluation.kpis import CORE, CORE_FAILURES, OF_DESIGNS, heading, kpis_of, label_of
from probe_agents.evaluation.statistics import Interval, mean_interval
from probe_agents.policies.cases import TABLE_2
from probe_agents.policies.catalogue import domains_of, name_and_spec
from probe_agents.policies.policy import check_domains
from probe_agents.records.manifest import commit
from probe_agents.records.models import Key, Stored, require
from probe_agents.records.result_folder import Journal, ResultFolder, check_hashes
from probe_agents.records.store import write_tables
from probe_agents.records.tables import Columns, read_csv
from probe_agents.terminal.tables import print_table
from probe_agents.terminal.work import Work, announce
from probe_env import Design
from probe_env.envs.task.rules import FAILURES
from probe_env.envs.trials import check_candidate
from probe_env.settings import explain

STORED: Final = "designs.csv"
COLUMNS: Final[Columns] = {
    "design": "name", "context": "count", **dict.fromkeys(OF_DESIGNS, "number?"), **dict.fromkeys(CORE, "number")
}  # fmt: skip
"""Columns of the stored table; some depend on the task."""
BATCH = 16
MIN_TUBES: Final = 6
"""Fewest tubes for an interval: the bootstrap of fewer is too narrow."""


class Trial(Stored):
    """A line of ``designs.jsonl``."""

    key: Key
    kpis: dict[str, FiniteFloat]

    @model_validator(mode="after")
    def _complete(self) -> Self:
        require("kpis", self.kpis, (*CORE, *CORE_FAILURES))
        return self


def compare(designs: Mapping[str, Design], trials: DesignTrials, output: Path) -> pd.DataFrame:
    """Run missing trials, store designs.csv and summary.csv in a folder; returns one row per design and context.

    Nothing is run if the feed, the task or one of the designs, by name, is not valid.
    """
    if not designs:
        raise ValueError("designs = none: give at least one design file (TOML) or the name of a shipped design")
    trials.check()
    if trials.plant_label != TABLE_2:
        name = name_and_spec(trials.feed)[0]
        check_domains(domains_of([trials.feed], {name: trials.policy()}), trials.config, trials.contexts, strict=False)
    for name, design in designs.items():
        if design.deviations:
            warnings.warn(f"design {name!r} is outside the design space: {'; '.join(design.deviations)}", stacklevel=2)
        if design.deviations or trials.plant_label != TABLE_2:  # table 2 accepts the whole design space
            for context in trials.contexts:
                try:
                    check_candidate(design, context, trials.config, trials.fidelity, trials.schedule())
                except ValueError as error:
                    where = f"design {name!r} in {trials.plant_label.name}"
                    raise ValueError(f"{where}: {explain(error)}") from error
    journal = Journal(output / "designs.jsonl", Trial)
    with trials.folder(output).open(journal.path.name) as folder:
        return _compared(designs, trials, folder, journal)


def _compared(
    designs: Mapping[str, Design], trials: DesignTrials, folder: ResultFolder, journal: Journal[Trial]
) -> pd.DataFrame:
    """Run missing trials and write the tables, in a locked folder."""
    output = folder.path
    named_trials = [(name, k) for name in designs for k in range(len(trials.contexts))]
    keys = {u: trials.key(designs[u[0]], trials.contexts[u[1]], u[1]) for u in named_trials}
    planned, done = set(keys.values()), journal.read()
    new = {keys[trial]: trial for trial in named_trials if keys[trial] not in done}
    missing = list(new.values())  # equal designs run once
    announce(Work("trial", len(planned), lambda: len(planned & journal.read().keys()), output))
    if missing:
        with journal.appending() as append, tqdm(total=len(missing), desc="designs", unit="trial") as bar:
            for begin in range(0, len(missing), BATCH):
                part = missing[begin : begin + BATCH]
                pairs = [(designs[name], trials.contexts[k]) for name, k in part]
                rows = zip(part, trials.run(pairs, [k for _, k in part]), strict=True)
                append(*({"key": keys[trial], "commit": commit(), "kpis": kpis} for trial, kpis in rows))
                bar.update(len(part))
        done = journal.read()
    table = pd.DataFrame(
        {"design": name, "context": k} | trials.tube_column | trials.contexts[k].model_dump()
        | done[keys[name, k]]["kpis"] | {"commit": done[keys[name, k]].get("commit", "unknown")}
        for name, k in named_trials
    )  # fmt: skip
    files = write_tables(output, {"designs": table, "summary": summarise(table)})
    built = {name: design.built.model_dump() for name, design in designs.items()}
    folder.write_manifest(*files, commits=table["commit"], designs=built, **trials.setting)
    return table


def summarise(table: pd.DataFrame) -> pd.DataFrame:
    """Mean and interval of every KPI of every design over the contexts, and paired difference from the first design.

    The ends of the intervals are NaN for fewer than ``MIN_TUBES`` contexts.
    """
    first, rows = str(table["design"].iloc[0]), []
    by_design = {name: part.set_index("context") for name, part in table.groupby("design", sort=False)}
    for name, part in by_design.items():
        for kpi in kpis_of(part.columns, OF_DESIGNS):
            mean, change = (
                mean_interval(values) if len(values) >= MIN_TUBES else Interval(float(values.mean()), np.nan, np.nan)
                for values in (part[kpi].to_numpy(), (part[kpi] - by_design[first][kpi]).to_numpy())
            )
            rows.append((name, kpi, mean.mean, mean.low, mean.high, change.mean, change.low, change.high))
    columns = ["design", "kpi", "mean", "low", "high", "change", "change_low", "change_high"]
    return pd.DataFrame(rows, columns=columns)


def texts_of(summary: pd.DataFrame) -> tuple[list[str], list[list[str]]]:
    """Header and rows: a design, its KPIs with intervals, and the change of the reward against the first design."""
    rows, kpis = [], kpis_of(summary["kpi"], OF_DESIGNS)
    for name, part in summary.groupby("design", sort=False):
        figures = part.set_index("kpi")
        means = (Interval(*figures.loc[kpi, ["mean", "low", "high"]]).text(kpis[kpi][1]) for kpi in kpis)
        change = Interval(*figures.loc["reward", ["change", "change_low", "change_high"]])
        rows.append([str(name), *means, change.text()])
    return ["design", *map(heading, kpis.values()), "reward, change"], rows


def read_comparison(folder: Path) -> pd.DataFrame:
    """Read the rows of a comparison, one per design and context; a damaged or changed file is refused."""
    check_hashes(folder, STORED)
    return read_csv(folder / STORED, COLUMNS)


def print_comparison(table: pd.DataFrame) -> None:
    """Print the summary."""
    where = f" of {table['tube'].iloc[0]}" if "tube" in table else ""
    number, summary = table["context"].nunique(), summarise(table)
    intervals = " with 95 % intervals" if number >= MIN_TUBES else f", too few for intervals (at least {MIN_TUBES})"
    means = f"Means over {number} tubes{where}{intervals}" if number > 1 else f"One tube{where}"
    print_table(f"{means}; change against the first", *texts_of(summary))
    for name, part in table.groupby("design", sort=False):
        counts = part.reindex(columns=list(FAILURES), fill_value=0.0).sum().astype(int)
        print(f"{name}: {', '.join(f'{counts[reason]} {label_of(reason)}' for reason in FAILURES)}")
