"""What is found at finer fidelities, in words: figures of whole tubes; see ``along`` for where they differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Final, NamedTuple

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
Rows = dict[str, tuple[float, Interval]]
"""KPI -> its mean at the coarser fidelity, and the change at the finer one."""
STEADY: Final = "fast-steady"
"""The fidelity of the stages ``steady`` and ``steady-fresh``."""
TRIAL_HEADER: Final = ("policy", "what", "at", "at `{}`", "change", "standard deviation between tubes at `{}`", "p")


class Trial(NamedTuple):
    """Episodes that are compared: folders of those at the coarser fidelity and at the finer one, whose name it is."""

    coarse: Path
    fine: Path
    finer: str


def hearing() -> str:
    """What is found at ``standard`` beside ``fast``."""
    return _found("hearing", "acting", "standard")


def hearing_fresh() -> str:
    """Whether what is found is the same at ``fast``, ``standard`` and ``reference``, by what was said beforehand."""
    trials = [Trial(RESULTS / name, RESULTS / name / "finer-acting", finer) for name, finer in TRIALS.items()]
    sources = " ".join(source(RESULTS / name / "provenance.json") for name in TRIALS)
    return f"{_judged('fast', trials)} {sources}"


def hearing_steady() -> str:
    """Whether what is found is the same at ``fast-steady`` and ``standard``, by what was said beforehand; of all."""
    trial = Trial(RESULTS / "steady", RESULTS / "hearing" / "finer-acting", "standard")
    coarse, fine = (read_episodes(folder / "episodes.csv") for folder in trial[:2])
    rows: dict[str, Rows] = {}
    for policy, kpi in product(map(str, coarse["policy"].unique()), HEARING):
        before, after = (by_context(table, policy, kpi) for table in (coarse, fine))
        rows.setdefault(policy, {})[kpi] = before.mean(), mean_interval((after - before).to_numpy())
    return (
        f"{_judged(STEADY, [trial])}\n\n{_beside(STEADY, trial.finer, rows)}"
        f" {source(RESULTS / 'steady' / 'provenance.json')}"
    )


def _judged(coarse: str, trials: Sequence[Trial]) -> str:
    """Which of the figures of whole tubes differ between a fidelity and finer ones by more than chance."""
    # together the trials go wrong by luck in one of twenty cases (Bonferroni)
    least = 0.05 / (len(HEARD) * len(UNHEARING) * len(trials))
    rows, differ, undecided = [], [], []
    for trial in trials:
        tables = [read_episodes(path / "episodes.csv") for path in (trial.coarse, trial.fine)]
        for policy, kpi in product(UNHEARING, HEARD):
            title, factor, unit = KPIS[kpi]
            before, after = (by_context(table, policy, kpi) for table in tables)
            change = after - before
            chance = chance_of_mean(change.to_numpy())
            rows.append(
                (
                    policy, f"{title} [{unit}]", f"`{trial.finer}`", f"{factor * before.mean():.3g}",
                    mean_interval(change.to_numpy()).text(factor), f"{factor * before.std():.2g}", f"{chance:.2g}",
                )
            )  # fmt: skip
            compared = f"{title} of `{policy}` at `{trial.finer}`"
            if chance < least:
                differ.append(compared)
            elif 2.0 ** (1 - np.count_nonzero(change)) >= least:  # though all signs were one way
                undecided.append(compared)
    said = f"differ: {'; '.join(differ)}" if differ else "none differs by more than chance"
    said += f"; too few tubes change to tell: {'; '.join(undecided)}" if undecided else ""
    header = tuple(title.format(coarse) for title in TRIAL_HEADER)
    return (
        f"**Of {len(rows)}, {said}.**\n\n{markdown(header, rows)}\n\nMeans over"
        f" {tables[0]['context'].nunique()} tubes; changes with 95 % intervals."
    )


def replays() -> str:
    """What is found where that is replayed which was fed and blown at ``fast``."""
    return _found("replays-standard", "replayed", "standard")


def _found(name: str, check: str, finer: str) -> str:
    """A stored check of a finer fidelity: a row a policy, each KPI at ``fast`` and its change."""
    folder = RESULTS / name
    checks = stored_table(folder / "fidelity.csv", "check", "policy", "kpi", "before", "mean", "low", "high")
    chosen = checks[checks["check"].str.startswith(check)]
    rows: dict[str, Rows] = {}
    for entry in chosen.to_dict("records"):
        change = Interval(entry["mean"], entry["low"], entry["high"])
        rows.setdefault(str(entry["policy"]), {})[str(entry["kpi"])] = entry["before"], change
    tubes = read_episodes(folder / "episodes.csv")["context"].nunique()
    return f"{_beside('fast', finer, rows)} Means over {tubes} held-out tubes. {source(folder / 'provenance.json')}"


def _beside(coarse: str, finer: str, of_policies: Mapping[str, Rows]) -> str:
    """A row a policy, each KPI at the coarser fidelity and its change."""
    rows = []
    clear: dict[str, list[str]] = {kpi: [] for kpi in HEARING}
    for policy, of_kpi in of_policies.items():
        cells = []
        for kpi in HEARING:
            (before, change), factor = of_kpi[kpi], KPIS[kpi][1]
            cells += [f"{factor * before:.3g}", change.text(factor)]
            if change.low > 0.0 or change.high < 0.0:
                clear[kpi].append(f"`{policy}`")
        rows.append((policy, *cells))
    header = ["policy"]
    for title, _, unit in (KPIS[kpi] for kpi in HEARING):
        header += [f"{title} [{unit}] at `{coarse}`", f"change at `{finer}`"]
    changed = [f"{KPIS[kpi][0]} of {' and '.join(names)}" for kpi, names in clear.items() if names]
    return (
        f"{markdown(header, rows)}\n\nChanges are paired, with 95 % intervals. Clear of zero:"
        f" {', '.join(changed) if changed else 'none'}."
    )
