"""Figures of evaluations, as PNG."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from probe_agents.evaluation.statistics import performance_profile
from probe_agents.records.drawing import BLUE, GREY, MM, RED, escape_dollars, picture, policy_colours


def trade_off(summary: pd.DataFrame) -> bytes:
    """Share of the length out of the limit over inspection time, with both intervals, one point per policy."""
    figure, axis = plt.subplots(figsize=(9, 5), layout="constrained")
    rows: Any = summary.set_index(["policy", "kpi"])
    for policy, colour in policy_colours(summary["policy"]).items():
        time, fraction = rows.loc[(policy, "inspection_time_s")], rows.loc[(policy, "share_within_limit")]
        x, y = time["mean"], 100.0 * (1.0 - fraction["mean"])
        across = [[x - time["low"]], [time["high"] - x]]
        along = [[100.0 * (fraction["high"] - fraction["mean"])], [100.0 * (fraction["mean"] - fraction["low"])]]
        axis.errorbar(x, y, xerr=across, yerr=along, fmt="o", capsize=3, color=colour, label=escape_dollars(policy))
    axis.set(xlabel="inspection time [s]", ylabel="length out of the limit [%]", ylim=(0.0, None))
    axis.legend(frameon=False)
    return picture(figure)


def policy_profiles(profile: pd.DataFrame, limit_mm: float | None) -> bytes:
    """Feed, air and vibration over the inserted length, in bins of two metres, one line per policy."""
    figure, axes = plt.subplots(3, 1, figsize=(9, 8), sharex=True, layout="constrained")
    binned = profile.assign(bin=(profile["inserted_length"] // 2.0) * 2.0 + 1.0)
    fields = (
        ("feed_speed", 1.0, "feed [m/s]"),
        ("air_supply_rate", 3600.0, "air [m3/h]"),
        ("radial_rms_m", MM, "radial rms [mm]"),
    )
    for policy, colour in policy_colours(profile["policy"]).items():
        groups = binned[binned["policy"] == policy].groupby("bin")
        for axis, (name, factor, label) in zip(axes, fields, strict=True):
            mean = groups[name].mean() * factor
            axis.plot(mean.index, mean, color=colour, label=escape_dollars(policy))
            axis.set_ylabel(label)
        loud = groups["radial_rms_m"].quantile(0.9) * MM
        axes[2].plot(loud.index, loud, color=colour, linewidth=0.7)
    for axis in axes:
        axis.set_ylim(bottom=0.0)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", frameon=False, ncols=3)
    if limit_mm is not None:
        axes[2].axhline(limit_mm, color=GREY, linestyle=":")
    axes[2].set_xlabel("inserted length [m]")
    return picture(figure)


def performance_profiles(table: pd.DataFrame) -> bytes:
    """Fraction of the tubes with a higher reward over the reward, one line per policy."""
    figure, axis = plt.subplots(figsize=(8, 4), layout="constrained")
    rewards = np.unique(table["reward"])
    thresholds = np.append(rewards[0] - 1.0, rewards)
    for policy, colour in policy_colours(table["policy"]).items():
        fraction = performance_profile(table, policy, thresholds)
        axis.step(thresholds, fraction, where="post", color=colour, label=escape_dollars(policy))
    axis.set(ylim=(0.0, None), xlabel="reward", ylabel="fraction of tubes above it")
    axis.set_xscale("symlog", linthresh=30.0)  # lost drives cost hundreds
    axis.legend(frameon=False, fontsize=8)
    return picture(figure)


def speed_and_vibration(profile: pd.DataFrame, permitted: float, vibration: str, limit: float | None) -> bytes:
    """Driven and permitted speed above the vibration over the inserted length: mean and range over the insertions.

    Args:
        profile: a row for each metre of the episodes of one policy.
        permitted: permitted speed [m/s]; infinite: none.
        vibration: column of the vibration [m].
        limit: its limit [m]; None: not drawn.
    """
    figure, axes = plt.subplots(2, 1, figsize=(7, 3.8), sharex=True, layout="constrained")
    feed = "highest_feed" if "highest_feed" in profile else "feed_speed"
    fields = (
        (feed, 1.0, "feed [m/s]", permitted, "permitted", "right"),
        (vibration, MM, "vibration [mm]", limit, "limit", "left"),  # where it is quiet
    )
    for axis, (name, factor, label, bound, bound_name, side) in zip(axes, fields, strict=True):
        of_metre = profile.dropna(subset=["inserted_length", name]).groupby("inserted_length")[name]
        low, mean, high = (
            values.astype(float) * factor for values in (of_metre.min(), of_metre.mean(), of_metre.max())
        )
        axis.fill_between(mean.index, low, high, color=BLUE, alpha=0.2, linewidth=0)
        axis.plot(mean.index, mean, color=BLUE)
        top = high.max()
        if bound is not None and np.isfinite(bound):
            top = np.fmax(top, bound * factor)
            axis.axhline(bound * factor, color=RED, linestyle="--")
            at = {"xycoords": ("axes fraction", "data"), "ha": side, "va": "bottom"}
            axis.annotate(bound_name, (0.995 if side == "right" else 0.005, bound * factor), color=RED, **at)
        axis.set_ylabel(label)
        axis.set_ylim(0.0, 1.2 * top if top > 0.0 else 1.0)
    axes[1].set_xlabel("inserted length [m]")
    return picture(figure, dpi=150)


def curves(bands: pd.DataFrame) -> bytes:
    """Probability of detection over the depth of a flaw, one curve per policy, with 95 % bands over the tubes."""
    figure, axis = plt.subplots(figsize=(8, 5), layout="constrained")
    for policy, colour in policy_colours(bands["policy"]).items():
        part = bands[bands["policy"] == policy]
        axis.plot(part["depth_percent_wall"], part["pod"], color=colour, label=escape_dollars(policy))
        axis.fill_between(part["depth_percent_wall"], part["low"], part["high"], color=colour, alpha=0.15, linewidth=0)
    axis.axhline(0.9, color=GREY, linewidth=0.8, linestyle=":")
    axis.set(xscale="log", ylim=(0.0, 1.0), xlabel="depth [% of the wall]", ylabel="probability of detection")
    axis.set_xticks([2, 5, 10, 20, 50, 100], ["2", "5", "10", "20", "50", "100"])
    axis.minorticks_off()
    axis.legend(frameon=False, fontsize=8)
    return picture(figure)
