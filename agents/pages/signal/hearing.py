"""What is found at finer fidelities, in words: figures of whole tubes; see ``along`` for where they differ."""

from __future__ import annotations

from itertools import product
from typing import Any, Final

import numpy as np

from agents.pages.sources import RESULTS, markdown, source, stored_table
from agents.records.columns import KPIS
from agents.records.tables import read_episodes
from agents.rollouts.bootstrap import Interval, chance_of_mean
from agents.rollouts.statistics import by_context, mean_interval

HEARING: Final = ("a90_percent_wall", "length_with_snr_over_3_m", "noise_peak_to_peak_v", "radial_rms_m")
"""What is compared at two fidelities."""
HEARD, UNHEARING = HEARING[:3], ("best-constant", "best-schedule")
TRIALS: Final = {"hearing-fresh": "standard", "hearing-fresh-finely": "reference"}
"""Stages in fresh tubes, and what they compare with ``fast``."""
LEAST_CHANCE: Final = 0.05 / (len(HEARD) * len(UNHEARING) * len(TRIALS))
"""Below which a change is taken for one: together the trials go wrong by luck in one of twenty cases (Bonferroni)."""
TRIAL_HEADER: Final = (
    "policy", "what", "at", "at `fast`", "change", "standard deviation between tubes at `fast`", "p",
)  # fmt: skip


def hearing() -> str:
    """What is found at ``standard`` beside ``fast``."""
    return _found("hearing", "acting", "standard")


def hearing_fresh() -> str:
    """Whether what is found is the same at ``fast``, ``standard`` and ``reference``, by what was said beforehand."""
    rows, differ, undecided = [], [], []
    for name, finer in TRIALS.items():
        folder = RESULTS / name
        tables = [read_episodes(path / "episodes.csv") for path in (folder, folder / "finer-acting")]
        for policy, kpi in product(UNHEARING, HEARD):
            title, factor, unit = KPIS[kpi]
            before, after = (by_context(table, policy, kpi) for table in tables)
            change = after - before
            chance = chance_of_mean(change.to_numpy())
            rows.append(
                (
                    policy, f"{title} [{unit}]", f"`{finer}`", f"{factor * before.mean():.3g}",
                    mean_interval(change.to_numpy()).text(factor), f"{factor * before.std():.2g}", f"{chance:.2g}",
                )
            )  # fmt: skip
            compared = f"{title} of `{policy}` at `{finer}`"
            if chance < LEAST_CHANCE:
                differ.append(compared)
            elif 2.0 ** (1 - np.count_nonzero(change)) >= LEAST_CHANCE:  # though all signs were one way
                undecided.append(compared)
    said = f"differ: {'; '.join(differ)}" if differ else "none differs by more than chance"
    said += f"; too few tubes change to tell: {'; '.join(undecided)}" if undecided else ""
    sources = " ".join(source(RESULTS / name / "provenance.json") for name in TRIALS)
    return (
        f"**Of {len(rows)}, {said}.**\n\n{markdown(TRIAL_HEADER, rows)}\n\nMeans over"
        f" {tables[0]['context'].nunique()} tubes; changes with 95 % intervals. {sources}"
    )


def replays() -> str:
    """What is found where that is replayed which was fed and blown at ``fast``."""
    return _found("replays-standard", "replayed", "standard")


def _found(name: str, check: str, finer: str) -> str:
    """A stored check of a finer fidelity: a row a policy, each KPI at ``fast`` and its change."""
    folder = RESULTS / name
    checks = stored_table(folder / "fidelity.csv", "check", "policy", "kpi", "before", "mean", "low", "high")
    chosen, rows = checks[checks["check"].str.startswith(check)], []
    clear: dict[str, list[str]] = {kpi: [] for kpi in HEARING}
    for policy, part in chosen.groupby("policy", sort=False):
        of_kpi: dict[Any, dict[Any, Any]] = {entry["kpi"]: entry for entry in part.to_dict("records")}
        cells = []
        for kpi in HEARING:
            entry, factor = of_kpi[kpi], KPIS[kpi][1]
            change = Interval(entry["mean"], entry["low"], entry["high"])
            cells += [f"{factor * entry['before']:.3g}", change.text(factor)]
            if change.low > 0.0 or change.high < 0.0:
                clear[kpi].append(f"`{policy}`")
        rows.append((str(policy), *cells))
    header = ["policy"]
    for title, _, unit in (KPIS[kpi] for kpi in HEARING):
        header += [f"{title} [{unit}] at `fast`", f"change at `{finer}`"]
    changed = [f"{KPIS[kpi][0]} of {' and '.join(names)}" for kpi, names in clear.items() if names]
    tubes = read_episodes(folder / "episodes.csv")["context"].nunique()
    return (
        f"{markdown(header, rows)}\n\nMeans over {tubes} held-out tubes; changes are paired, with 95 % intervals."
        f" Clear of zero: {', '.join(changed) if changed else 'none'}."
        f" {source(folder / 'provenance.json')}"
    )
