"""The trim's two constants: a grid of aims and times, played in training tubes beside the law without a trim."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any, Final

import pandas as pd

from agents.evaluation.plan import Plan, Policy, run_plan
from agents.evaluation.statistics import paired_difference
from agents.policies.places import place_of
from agents.policies.plc_law import PlcLaw, Trim, TrimmedLaw
from agents.processes.workers import Workers
from agents.records.provenance import provenance, write_atomically, write_json
from agents.terminal.tables import print_table
from probe_env.envs.contexts import SPLIT_SIZES
from probe_env.fidelity import resolve_fidelity

AIMS: Final = (2.5e-5, 3e-5, 3.5e-5, 4.2e-5, 5e-5)
"""Noise that is aimed at, as radial rms [m]."""
TIMES: Final = (40.0, 80.0, 160.0)
"""Of the trim [s]."""
UNTRIMMED: Final = "plc-law"
HEADER: Final = ("aim [µm]", *(f"{time:g} s" for time in TIMES))


def run_trim_search(limit: int, output: Path, workers: Workers) -> Trim:
    """Find the constants; writes trimmed-law.json and trimmed-law-trials.csv.

    Args:
        limit: training tubes, the first, which are balanced.
        output: folder; ``output/episodes`` keeps what was simulated.
        workers: that simulate.

    Raises:
        ValueError: the limit is out of range.
    """
    if not 0 < limit <= SPLIT_SIZES["train"]:
        raise ValueError(f"limit = {limit!r} is outside the accepted range 1 to {SPLIT_SIZES['train']}")
    place = place_of(None, "train", limit)
    config = place.config.all_shown
    trims = {f"trim-{k}": Trim(aim=aim, time=time) for k, (aim, time) in enumerate(product(AIMS, TIMES))}
    policies: dict[str, Policy] = {UNTRIMMED: PlcLaw(config)}
    policies |= {name: TrimmedLaw(config, trim=trim) for name, trim in trims.items()}
    plan = Plan(policies, place.contexts, config=config, fidelity=resolve_fidelity("fast"))
    table = run_plan(plan, output / "episodes", workers=workers)
    rows: list[dict[str, Any]] = []
    for name, trim in trims.items():
        gain = paired_difference(table, name, UNTRIMMED, "reward")
        row = trim.model_dump() | {"reward": table[table["policy"] == name]["reward"].mean()}
        rows.append(row | {"gain": gain.mean, "gain_low": gain.low, "gain_high": gain.high})
    trials = pd.DataFrame(rows)
    best = rows[int(trials["reward"].to_numpy().argmax())]
    chosen = Trim(aim=best["aim"], time=best["time"])
    write_atomically(output / "trimmed-law-trials.csv", trials.to_csv(index=False, float_format="%.6g"))
    record = {"trim": chosen.model_dump(), "reward": best["reward"], "gain": best["gain"], "tubes": limit}
    write_json(output / "trimmed-law.json", record | {"provenance": provenance(commits=table["commit"])})
    print_table(f"Reward less that of {UNTRIMMED}, {limit} tubes, by the trim's time", HEADER, cells(trials), left=0)
    return chosen


def cells(trials: pd.DataFrame) -> list[tuple[str, ...]]:
    """A row an aim, a column a time: reward less the law's, with its 95 % interval."""
    by_place = {(row["aim"], row["time"]): row for row in trials.to_dict("records")}
    rows = []
    for aim in trials["aim"].unique():
        gains = [by_place[aim, time] for time in trials["time"].unique()]
        shown = [f"{row['gain']:+.2f} [{row['gain_low']:.2f}, {row['gain_high']:.2f}]" for row in gains]
        rows.append((f"{1e6 * aim:.3g}", *shown))
    return rows
