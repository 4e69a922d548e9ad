"""Compares the rows of a study: means, intervals and paired differences over tubes, as CSV, table and figure."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any, Final

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from probe_agents.evaluation import statistics
from probe_agents.evaluation.kpis import HIGH, KPIS, OVER_TUBES, heading
from probe_agents.evaluation.statistics import Interval, by_context, curves_by_tube, mean_interval, short
from probe_agents.records.drawing import BLUE, GREY, colours, escape_dollars, save
from probe_agents.records.manifest import write_manifest
from probe_agents.records.store import write_tables
from probe_agents.studies.run import Setting
from probe_agents.studies.spec import Changes, Study
from probe_agents.terminal.tables import print_table
from probe_env.inspection.metrics import POD_NAMES

LINEAR_FRACTION: Final = 0.02
"""Ratio of median to largest difference below which the axis is logarithmic."""


def compare(study: Study, settings: Sequence[Setting], episodes: pd.DataFrame) -> pd.DataFrame:
    """One row per policy, setting, metric and baseline.

    Columns: those of policy and setting, then tubes, metric, mean, low, high, rank (among the policies of a setting, 1:
    the best), baseline, difference, difference_low and difference_high. ``a90_95_percent_wall`` has no interval; its
    difference is that of a90; both are NaN in the surrogate, which has no signal. With ``compare.upper`` also
    share_of_lead, share_low and share_high of the reward.
    """
    columns, metrics, upper = key_columns(settings), study.compare.metrics, study.compare.upper
    parts = episodes.groupby(columns, sort=False, dropna=False)
    groups = {tuple(None if value != value else value for value in key): part for key, part in parts}
    names = {key: str(number) for number, key in enumerate(groups)}
    # the statistics compare policies: each group gets the name of one
    labelled = pd.concat([part.assign(policy=names[key]) for key, part in groups.items()])
    if not {*POD_NAMES} <= {*labelled}:  # the surrogate has no signal
        labelled = labelled.assign(**dict.fromkeys(POD_NAMES, np.nan))
    has_pod = labelled.groupby("policy")[POD_NAMES[0]].count() > 0
    missing = [metric for metric in metrics if metric not in (*episodes.columns, *OVER_TUBES)]
    if missing:
        raise ValueError(f"compare.metrics: {', '.join(missing)} is not measured in this task")
    chosen, rows = baselines(study, settings), []
    first_setting = bool(study.varied) and not study.compare.baseline
    for (key, name), metric in product(names.items(), metrics):
        over_tubes = metric in OVER_TUBES
        mean = mean_interval(by_context(labelled, name, metric).to_numpy()) if not over_tubes else None
        row = dict(zip(columns, key, strict=True)) | {"tubes": groups[key]["context"].nunique(), "metric": metric}
        depth = statistics.a90_95(labelled, name) if over_tubes and has_pod[name] else np.nan
        row |= asdict(mean) if mean else {"mean": depth, "low": np.nan, "high": np.nan}
        for baseline in chosen:
            other = names[_replaced(columns, key, baseline, groups)]
            if over_tubes and not (has_pod[name] and has_pod[other]):
                change = Interval(*(math.nan,) * 3)
            elif over_tubes:
                change = statistics.difference_of_a90(*(curves_by_tube(labelled, one) for one in (name, other)))
            else:
                change = statistics.paired_difference(labelled, name, other, metric)
            label = "the first setting" if first_setting else ", ".join(f"{c} = {v}" for c, v in baseline.items())
            changes = {"rank": None, "baseline": label, "difference": change.mean}
            changes |= {"difference_low": change.low, "difference_high": change.high}
            if upper and metric == "reward":
                best = names[_replaced(columns, key, upper, groups)]
                fraction = statistics.fraction_of_lead(labelled, name, best, other)
                changes |= {"share_of_lead": fraction.mean, "share_low": fraction.low, "share_high": fraction.high}
            rows.append(row | changes)
    table = pd.DataFrame(rows)
    settings_columns = [column for column in columns if not column.startswith("policy")]
    for metric in metrics:
        part = table[table["metric"] == metric]
        good = part["mean"] if metric in HIGH else -part["mean"]
        same = [part[column].astype(str) for column in (*settings_columns, "baseline")]
        table.loc[part.index, "rank"] = good.groupby(same).rank(ascending=False, method="min")
    return table


def baselines(study: Study, settings: Sequence[Setting]) -> list[Changes]:
    """The baselines: columns and values."""
    chosen = list(study.compare.baseline)
    if not chosen:
        first = settings[0]
        varied = {name: first.values[name] for name in study.varied}
        chosen = [varied or next(iter(first.members.values()))]
    columns = key_columns(settings)
    members = (member | setting.values for setting in settings for member in setting.members.values())
    keys = dict.fromkeys(tuple(_method(name, member.get(name)) for name in columns) for member in members)
    for baseline in (*chosen, *([study.compare.upper] if study.compare.upper else ())):
        for column, value in baseline.items():
            if column not in columns:
                raise ValueError(f"compare.baseline: {column!r} is not one of {', '.join(columns)}")
            values = dict.fromkeys(key[columns.index(column)] for key in keys)
            if value not in values:
                raise ValueError(f"compare.baseline: {column} = {value!r} is not one of {', '.join(map(str, values))}")
        for key in keys:
            _replaced(columns, key, baseline, keys)
    return chosen


def key_columns(settings: Sequence[Setting]) -> list[str]:
    """Columns that identify a row: policy, its parameters, fidelity, varied fields."""
    members = [columns for setting in settings for columns in setting.members.values()]
    return list(dict.fromkeys(name for columns in (*members, settings[0].values) for name in columns))


def _method(column: str, value: Any) -> Any:
    """Policy NAME@SEED as NAME."""
    return value.rpartition("@")[0] or value if column == "policy" and value.rpartition("@")[2].isdecimal() else value


def _replaced(columns: Sequence[str], key: tuple[Any, ...], values: Changes, keys: Any) -> tuple[Any, ...]:
    """The key with other values in some columns; another policy has no parameters of this one."""
    row = dict(zip(columns, key, strict=True))
    if "policy" in values:
        row |= {name: None for name in columns if name.startswith("policy.")}
    found = tuple((row | values).values())
    if found not in keys:
        text = ", ".join(f"{name} = {value}" for name, value in zip(columns, found, strict=True) if value is not None)
        raise ValueError(f"compare.baseline: the study has no row of {text}")
    return found


def write_comparison(study: Study, settings: Sequence[Setting], episodes: pd.DataFrame, output: Path) -> pd.DataFrame:
    """Write episodes.csv, comparison.csv, comparison.png and manifest.json, and print the comparison."""
    table = compare(study, settings, episodes)
    files = write_tables(output, {"episodes": episodes, "comparison": table})
    write_manifest(output, files, commits=episodes["commit"], study=study.model_dump(mode="json"))
    rows, columns = _displayed(study, settings, table)
    (_across if study.figure else _forest)(study, rows, columns, output / "comparison.png")
    for baseline, part in rows.groupby("baseline", sort=False):
        by_row = part.groupby([*columns, *key_columns(settings)], sort=False, dropna=False)
        cells = [[*map(_text, key[: len(columns)]), *map(_cell, metrics.to_dict("records"))] for key, metrics in by_row]
        print_table(
            f"{study.question} Differences to {baseline}, 95 % intervals",
            (*columns, *(_label_and_factor(metric)[0] for metric in study.compare.metrics)), cells, left=len(columns),
        )  # fmt: skip
    return table


def _displayed(study: Study, settings: Sequence[Setting], table: pd.DataFrame) -> tuple[pd.DataFrame, list[str]]:
    """The comparison in the order of policies, and the columns to display.

    If a study lists its settings, their changes are in one column.
    """
    order = {policy: number for number, policy in enumerate(dict.fromkeys(table["policy"]))}
    table = table.sort_values("policy", key=lambda names: names.map(order), kind="stable")
    columns = [name for name in key_columns(settings) if table[name].astype(str).nunique() > 1]
    if isinstance(study.vary, Mapping):
        return table, columns or ["policy"]
    changed, first = [], settings[0].values
    for row in table.to_dict("records"):
        others = [name for name in study.varied if row[name] != first[name]]
        changed.append(", ".join(f"{name.rpartition('.')[2]} = {_text(row[name])}" for name in others) or "-")
    return table.assign(setting=changed), [*(name for name in columns if name not in study.varied), "setting"]


def _text(value: Any) -> str:
    return "" if value is None or value != value else f"{value:g}" if isinstance(value, float) else str(value)


def _label_and_factor(metric: str) -> tuple[str, float]:
    """Name with unit, and factor of a value."""
    label = (KPIS | OVER_TUBES).get(metric, (metric.replace("_", " "), 1.0, ""))
    return heading(label), label[1]


def _cell(row: Mapping[Any, Any]) -> str:
    """Mean, difference and its interval, in the units of ``_label_and_factor``."""
    factor = _label_and_factor(row["metric"])[1]
    if math.isnan(row["mean"]):
        return "-"
    mean = short(factor * row["mean"])
    change = Interval(row["difference"], row["difference_low"], row["difference_high"])
    if change.mean == 0.0 and not change.low < change.high:  # the baseline itself
        return mean
    low, high = short(factor * change.low), short(factor * change.high)
    ends = "" if math.isnan(change.low) else f" [{low}, {high}]"
    fraction = row.get("share_of_lead")
    lead = "" if fraction is None or fraction != fraction else f", {100.0 * fraction:.0f} % of the lead"
    return f"{mean} ({short(factor * change.mean, '+')}{ends}{lead})"


def _forest(study: Study, table: pd.DataFrame, columns: Sequence[str], path: Path) -> None:
    """Differences of the first metric with intervals: one panel per baseline, one line per row."""
    part = table[table["metric"] == study.compare.metrics[0]]
    panels = [rows for _, rows in part.groupby("baseline", sort=False)]
    size = (4.0 + 4.5 * len(panels), 1.2 + 0.28 * len(panels[0]))
    figure, axes = plt.subplots(1, len(panels), figsize=size, squeeze=False, sharey=True, layout="constrained")
    for axis, rows in zip(axes[0], panels, strict=True):
        values = rows[["difference", "difference_low", "difference_high"]].to_numpy(float)
        for y, (mean, low, high) in enumerate(values):
            axis.plot([low, high], [y, y], color=BLUE, linewidth=1.5)
            axis.plot([mean], [y], "o", color=BLUE, markersize=4)
        sizes = np.abs(values[:, 0][values[:, 0] != 0.0])
        if len(sizes) and np.median(sizes) < LINEAR_FRACTION * sizes.max():
            axis.set_xscale("symlog", linthresh=float(max(np.median(sizes), LINEAR_FRACTION**2 * sizes.max())))
        axis.axvline(0.0, color=GREY, linewidth=0.8)
        axis.set_title(f"minus {escape_dollars(str(rows['baseline'].iloc[0]))}", fontsize="medium")
        names = [", ".join(filter(None, map(_text, row))) for row in rows[list(columns)].itertuples(index=False)]
        axis.set_yticks(range(len(rows)), map(escape_dollars, names), fontsize="small")
    axes[0, 0].set_ylim(len(panels[0]) - 0.5, -0.5)
    figure.supxlabel(
        f"difference of {_label_and_factor(study.compare.metrics[0])[0]}, 95 % intervals", fontsize="medium"
    )
    save(figure, path)


def _across(study: Study, table: pd.DataFrame, columns: Sequence[str], path: Path) -> None:
    """One metric over another with both intervals: one point per row, one line per policy and setting."""
    assert study.figure is not None
    figure, axis = plt.subplots(figsize=(9, 5), layout="constrained")
    first = table[table["baseline"] == table["baseline"].iloc[0]]
    lines = [name for name in columns if not name.startswith("policy.")]
    for colour, (name, rows) in zip(colours(), first.groupby(lines, sort=False, dropna=False), strict=False):
        points = [
            _label_and_factor(metric)[1] * rows.loc[rows["metric"] == metric, ["mean", "low", "high"]].to_numpy(float)
            for metric in study.figure
        ]
        x, y = (values[points[0][:, 0].argsort()].T for values in points)
        errors = (np.nan_to_num([mean - low, high - mean]) for mean, low, high in (x, y))
        label = escape_dollars(", ".join(map(_text, name)))
        axis.errorbar(x[0], y[0], xerr=next(errors), yerr=next(errors), fmt="o-", capsize=3, color=colour, label=label)
    axis.set(xlabel=_label_and_factor(study.figure[0])[0], ylabel=_label_and_factor(study.figure[1])[0])
    axis.legend(frameon=False)
    save(figure, path)
