"""Statistics of evaluations: bootstrap intervals, paired differences over tubes, detection curves, summaries."""

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
import pandas as pd
from scipy.stats import DegenerateDataWarning, beta, bootstrap, trim_mean

from probe_agents.evaluation.kpis import GOALS, HIGH, OVER_TUBES, goal_of, kpis_of
from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.plants import Bundle
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.rules import ENDINGS
from probe_env.inspection.detection import DEPTHS, depths_found
from probe_env.inspection.metrics import POD_NAMES

CONFIDENCE: Final = 0.95
PERCENTILES: Final = (50.0 * (1.0 - CONFIDENCE), 50.0 * (1.0 + CONFIDENCE))
"""Percentiles of the ends of an interval."""
RESAMPLES: Final = 2000
"""Number of bootstrap samples of ``bootstrap_means``."""
TIE: Final = 1e-9
"""Difference of two equal statistics, over the range of all resamples: rounding only."""
A90_BOUND: Final = 95.0
"""Percentile of the resampled a90: a90/95."""
DEPTH_COLUMNS: Final = ("policy", "a50_percent_wall", "a90_percent_wall", "a90_95_percent_wall")
BUNDLE_COLUMNS: Final = (
    "policy", "tubes", *(f"{name}{end}" for name in ("hours", "second_pass_share", "second_pass_hours", "total_hours")
                         for end in ("", "_low", "_high"))
)  # fmt: skip
"""Columns of ``bundle.csv``."""
BUNDLE_HEADER: Final = ("policy", "first passes [h]", "second pass [% of tubes]", "second passes [h]", "all passes [h]")
MAX_SECOND: Final = 0.5
"""Largest fraction of the tubes with a second pass: a schedule that fails in most tubes would fail in it again."""
BEST: Final = "planner"
BAR: Final = "best-schedule"
"""The difference in reward between these two policies is the planner's lead."""
STRAINS: Final[Mapping[str, str]] = {
    "cost_tension": "over the tension limit",
    "cost_buckling": "compressed beyond the buckling load",
}
"""Column of a cost, in control periods -> its text."""


@dataclass(frozen=True)
class Interval:
    """A mean with its confidence interval; the ends of the interval of a single value are NaN."""

    mean: float
    low: float
    high: float

    def text(self, factor: float = 1.0) -> str:
        """Mean and interval, three digits; the mean alone without an interval or with one of no width."""
        if not self.low < self.high:
            return short(self.mean * factor)
        return f"{short(self.mean * factor)} [{short(self.low * factor)}, {short(self.high * factor)}]"


def short(value: float, sign: str = "") -> str:
    """Three digits; ``sign`` "+": with a sign, unless it is 0. NaN is "-"."""
    if math.isnan(value):
        return "-"
    sign = sign if value else ""
    return f"{value:{sign}.0f}" if abs(value) >= 100.0 else f"{value:{sign}.3g}"


def bootstrap_ends(
    statistic: Callable[..., Any], *samples: np.ndarray, method: Literal["BCa", "percentile"] = "BCa", **options: Any
) -> tuple[Any, Any]:
    """Ends of a statistic's 95 % bootstrap interval with a fixed seed; BCa falls back to percentiles.

    In small samples many resamples are permutations of the sample. Their statistic equals that of the sample up to
    rounding, and BCa counts how many are below it: they are made equal, so that the last bit changes no interval.

    The arguments are those of ``scipy.stats.bootstrap``.
    """

    def without_rounding(*resamples: np.ndarray, axis: int) -> Any:
        values = np.asarray(statistic(*resamples, axis=axis))
        ties = np.abs(values - observed) <= TIE * np.ptp(values)
        return np.where(ties, observed, values)

    observed: Any = statistic(*samples, axis=-1) if method == "BCa" else None
    function = without_rounding if method == "BCa" else statistic
    for kind in dict.fromkeys((method, "percentile")):
        rng = np.random.default_rng(0)
        with warnings.catch_warnings(), np.errstate(divide="ignore", invalid="ignore"):
            warnings.simplefilter("ignore", DegenerateDataWarning)
            result = bootstrap(samples, function, confidence_level=CONFIDENCE, method=kind, rng=rng, **options)
        low, high = result.confidence_interval
        if np.isfinite([low, high]).all():
            break
    return low, high


def bootstrap_means(values: FloatArray) -> FloatArray:
    """(RESAMPLES, d) bootstrap means of the rows of values (n, d), with a fixed seed."""
    rng, count = np.random.default_rng(0), len(values)
    weights = rng.multinomial(count, np.full(count, 1.0 / count), size=RESAMPLES)
    return np.asarray(weights @ values / count)


def ratio_interval(values: np.ndarray, reference: np.ndarray) -> Interval:
    """Ratio of the means of two independent samples with its interval; NaN with fewer than two values of either."""
    values, reference = values[np.isfinite(values)], reference[np.isfinite(reference)]
    if min(len(values), len(reference)) < 2 or reference.mean() == 0.0:
        return Interval(*(float("nan"),) * 3)
    ratio = float(values.mean() / reference.mean())
    if np.ptp(values) == 0.0 and np.ptp(reference) == 0.0:
        return Interval(ratio, ratio, ratio)
    return Interval(ratio, *map(float, bootstrap_ends(_ratio_of_means, values, reference)))


def _ratio_of_means(a: np.ndarray, b: np.ndarray, axis: int = -1) -> np.ndarray:
    return np.asarray(a.mean(axis=axis) / b.mean(axis=axis))


def mean_interval(values: np.ndarray) -> Interval:
    """Mean of independent values with a bootstrap interval (BCa): NaN for one value, no width if all are equal."""
    values = np.asarray(values, dtype=float)
    if len(values) == 0 or not np.isfinite(values).all():
        raise ValueError(f"values = {values!r} must be one or more finite numbers")
    mean = float(values.mean())
    if len(values) == 1:
        return Interval(mean, math.nan, math.nan)
    if np.ptp(values) == 0.0:
        return Interval(mean, mean, mean)
    return Interval(mean, *map(float, bootstrap_ends(np.mean, values)))


def grouped(table: pd.DataFrame) -> pd.DataFrame:
    """The table with the training seeds of a method under one name: NAME@K becomes NAME and ``training_seed`` K."""
    parts = {name: method_and_seed(name) for name in table["policy"].unique()}
    names, seeds = (table["policy"].map({name: part[k] for name, part in parts.items()}) for k in (0, 1))
    return table.assign(training_seed=seeds, policy=names)


def method_and_seed(policy: str) -> tuple[str, int]:
    """NAME@K as (NAME, K), anything else as (NAME, 0)."""
    name, mark, seed = policy.rpartition("@")
    return (name, int(seed)) if mark and seed.isdecimal() else (policy, 0)


def by_context(table: pd.DataFrame, policy: str, kpi: str) -> pd.Series:
    """Mean of a KPI over the seeds for each context: the independent values of a policy."""
    return table[table["policy"] == policy].groupby("context")[kpi].mean()


def ranking(table: pd.DataFrame) -> list[str]:
    """Policies from the best to the worst by ``goal_of`` the table, those outside the limits last."""
    goal = goal_of(table.columns)
    means = table.groupby(["policy", "context"], sort=False)[goal].mean().groupby("policy", sort=False).mean()
    order = [str(name) for name in means.sort_values(ascending=goal not in HIGH, kind="stable").index]
    return sorted(order, key=lambda policy: bool(broken_limits(table, policy)))


def broken_limits(table: pd.DataFrame, policy: str) -> str:
    """Limits of the plant that a policy does not keep, see ``with_goal``; "" if it keeps all, or there are none."""
    return str(table.loc[table["policy"] == policy, "broken_limits"].iloc[0]) if "broken_limits" in table else ""


def with_goal(table: pd.DataFrame, task: TaskConfig, bundle: Bundle | None) -> pd.DataFrame:
    """The table with the columns of ``GOALS`` and "broken_limits", if the plant has a bundle or an instrument.

    The mean of ``total_hours`` is that of ``bundle_table``: every tube takes its time, and the mean time of the policy
    once more if it needs a second pass. ``total_time_s`` is the same for a tube, without setup and withdrawal.
    """
    if bundle is None and task.instrument is None:
        return table
    added, tubes = (bundle.setup_time + (bundle.withdrawal_time or 0.0), bundle.tubes) if bundle else (0.0, 0)
    case = [table["policy"], table["context"]]
    times, again = table["inspection_time_s"] + added, needs_second_pass(table).groupby(case).transform("any")
    mean = times.groupby(case).mean().groupby("policy").mean()
    total, broken = times + again * table["policy"].map(mean), {}
    highest = (task.instrument and task.instrument.highest_a90) or math.inf
    for policy, part in table.assign(again=again).groupby("policy"):
        limited = part.reindex(columns=["length_too_fast_m", "a90_percent_wall"], fill_value=0.0)  # some have none
        problems = {
            "too fast": limited["length_too_fast_m"].max() > 0.0,
            f"a90 above {highest:g} %": limited["a90_percent_wall"].mean() > highest,
            "second pass in most tubes": part.groupby("context")["again"].any().mean() > MAX_SECOND,
        }
        broken[policy] = ", ".join(name for name, applies in problems.items() if applies)
    goal = {"total_hours": total * tubes / 3600.0} if bundle else {"total_time_s": total}
    return table.assign(**goal, broken_limits=table["policy"].map(broken))


def paired_difference(table: pd.DataFrame, first: str, second: str, kpi: str) -> Interval:
    """Mean of first minus second on the same contexts, with its interval, in the unit of the column ``kpi``.

    Raises:
        ValueError: the policies were not run on the same contexts and seeds.
    """
    cases = [set(map(tuple, table.loc[table["policy"] == p, ["context", "seed"]].to_numpy())) for p in (first, second)]
    if cases[0] != cases[1] or not cases[0]:
        raise ValueError(f"{first} and {second} cannot be paired: they were not run on the same contexts and seeds")
    return mean_interval((by_context(table, first, kpi) - by_context(table, second, kpi)).to_numpy())


def probability_of_improvement(table: pd.DataFrame, first: str, second: str) -> Interval:
    """Probability that a run of the first policy earns more than one of the second in the same tube, with its interval.

    As Agarwal et al. 2021 (rliable): the mean over the tubes of P(X > Y) + P(X = Y) / 2 over all pairs of runs X of the
    first and Y of the second. The bootstrap draws tubes and, in strata, the runs of each policy; a training seed plays
    all tubes, so a run is drawn for all of them together.

    Raises:
        ValueError: the policies were not run in the same tubes, or not equally often in each.
    """
    (tubes, runs), (others, against) = (_rewards_of_runs(table, policy) for policy in (first, second))
    if not tubes or tubes != others:
        raise ValueError(f"{first} and {second} cannot be compared: they were not run in the same tubes")
    wins = 0.5 * (1.0 + np.sign(runs[:, :, None] - against[:, None]))
    rng, low, high = np.random.default_rng(0), math.nan, math.nan
    if len(tubes) > 1:
        weights = [rng.multinomial(count, np.full(count, 1.0 / count), RESAMPLES) / count for count in wins.shape]
        means = np.einsum("tij,bt,bi,bj->b", wins, *weights, optimize=True)
        low, high = np.percentile(means, PERCENTILES).tolist()
    return Interval(float(wins.mean()), low, high)


def performance_profile(table: pd.DataFrame, policy: str, thresholds: FloatArray) -> FloatArray:
    """(k,) fraction of the tubes in which a policy earns more than each of ``thresholds`` (k,), mean over its runs."""
    _, runs = _rewards_of_runs(table, policy)
    return np.asarray((runs[:, :, None] > thresholds).mean(axis=(0, 1)))


def _rewards_of_runs(table: pd.DataFrame, policy: str) -> tuple[list[int], FloatArray]:
    """Tubes and rewards (tubes, runs) of a policy; a run is a training seed and a seed of the sensor noise."""
    part = table[table["policy"] == policy]
    part = part.sort_values([name for name in ("training_seed", "seed") if name in part], kind="stable")
    numbered = part.assign(run=part.groupby("context").cumcount())
    runs = numbered.pivot(index="context", columns="run", values="reward")
    if runs.isna().any(axis=None):
        raise ValueError(f"{policy} was not run equally often in all tubes")
    return list(runs.index), runs.to_numpy()


def fraction_of_lead(table: pd.DataFrame, policy: str, best: str = BEST, bar: str = BAR) -> Interval:
    """Reward of a policy on the scale from ``bar`` (0) to ``best`` (1), with its interval over their contexts."""
    columns = [by_context(table, name, "reward") for name in (policy, best, bar)]
    if not len(columns[0]) or any(not column.index.equals(columns[0].index) for column in columns):
        raise ValueError(f"{policy}, {best} and {bar} cannot be paired: they were not run on the same contexts")
    values, maximum, minimum = (column.to_numpy() for column in columns)
    gains = values - minimum, maximum - minimum
    fraction = float(_ratio_of_means(*gains))
    if len(values) < 2:
        return Interval(fraction, math.nan, math.nan)
    if np.ptp(values - maximum) == 0.0 or np.ptp(values - minimum) == 0.0:
        return Interval(fraction, fraction, fraction)
    return Interval(fraction, *map(float, bootstrap_ends(_ratio_of_means, *gains, paired=True)))


def summarise(table: pd.DataFrame) -> pd.DataFrame:
    """Rows for every policy and KPI: mean, interval, interquartile mean and worst value, in the unit of its column."""
    rows = []
    for policy in dict.fromkeys(table["policy"]):
        part = table[table["policy"] == policy]
        for kpi in kpis_of(table.columns):
            values = by_context(table, policy, kpi).to_numpy()
            interval = mean_interval(values)
            worst = part[kpi].min() if kpi in HIGH else part[kpi].max()
            iqm = float(trim_mean(values, 0.25))
            rows.append((policy, kpi, interval.mean, interval.low, interval.high, iqm, worst))
        if has_curves(table):
            rows.append((policy, *OVER_TUBES, *[a90_95(table, policy)] * 4, part["a90_percent_wall"].max()))
    return pd.DataFrame(rows, columns=["policy", "kpi", "mean", "low", "high", "iqm", "worst"])


def needs_second_pass(table: pd.DataFrame) -> pd.Series:
    """Whether each episode has metres to repeat; without an instrument: over the vibration limit or not reached."""
    if "length_to_repeat_m" in table:
        return table["length_to_repeat_m"] > 0.0
    return (table["share_within_limit"] < table["inspected_share"] - 1e-9) | (table["complete"] == 0.0)


def bundle_hours(
    times: FloatArray, second_pass: BoolArray, tubes: int
) -> tuple[Interval, Interval, Interval, Interval]:
    """Hours of first passes, share of tubes with a second pass, hours of these and of all passes, with 95 % intervals.

    The n simulated tubes and the N of the bundle are treated as independent draws of one distribution of mean m and
    deviation s. The total of N times, for a given m, has mean N m and variance N s^2; the mean of the simulated tubes
    estimates m with variance s^2 / n. So N times this mean predicts the total with variance N^2 s^2 (1/n + 1/N): the
    interval is that of a bootstrap of the mean, with normal scatter of deviation s / sqrt(N) added. If part of s is
    common to all tubes of a plant, such as the drag, the true interval is wider.

    With k of n tubes to repeat the share p has the posterior Beta(k + 1/2, n - k + 1/2) (Jeffreys; its interval
    extends to 0 for k = 0 and to 1 for k = n), the bundle has Binomial(N, p) such tubes, and each takes the mean
    time once more.

    Args:
        times: (n,) time per tube, all included [s].
        second_pass: (n,) whether a tube needs a second pass.
        tubes: N.

    Returns:
        hours, share, hours of second passes and of all; the ends of all but the share are NaN for one simulated tube.
    """
    count, k, mean = len(times), int(second_pass.sum()), float(times.mean())
    low, high = beta.ppf(np.array(PERCENTILES) / 100.0, k + 0.5, count - k + 0.5).tolist()
    fraction = Interval(k / count, low if k else 0.0, high if k < count else 1.0)
    totals = repeats = np.full(RESAMPLES, np.nan)
    if count > 1:
        rng, means = np.random.default_rng(0), bootstrap_means(times[:, None])[:, 0]
        totals = tubes * (means + rng.normal(0.0, times.std(ddof=1) / math.sqrt(tubes), RESAMPLES))
        repeats = rng.binomial(tubes, rng.beta(k + 0.5, count - k + 0.5, RESAMPLES)) * means
    hours, added, every = (
        Interval(tubes * value / 3600.0, *(np.percentile(drawn, PERCENTILES) / 3600.0).tolist())
        for value, drawn in (
            (mean, totals), (fraction.mean * mean, repeats), ((1.0 + fraction.mean) * mean, totals + repeats)
        )
    )  # fmt: skip
    return hours, fraction, added, every


def bundle_table(table: pd.DataFrame, bundle: Bundle | None) -> pd.DataFrame:
    """``bundle_hours`` of every policy, a row each, columns ``BUNDLE_COLUMNS``; no rows without a bundle.

    A tube needs a second pass if one of its episodes does. The bundle has its withdrawal as a time, see
    ``Plant.bundle_for``.
    """
    rows: list[tuple[object, ...]] = []
    if bundle is None:
        return pd.DataFrame(rows, columns=list(BUNDLE_COLUMNS))
    again = table.assign(second_pass=needs_second_pass(table))
    for policy in dict.fromkeys(table["policy"]):
        times = by_context(table, policy, "inspection_time_s").to_numpy()
        times = times + bundle.setup_time + (bundle.withdrawal_time or 0.0)
        intervals = bundle_hours(times, by_context(again, policy, "second_pass").to_numpy() > 0.0, bundle.tubes)
        rows.append((policy, bundle.tubes, *(v for i in intervals for v in (i.mean, i.low, i.high))))
    return pd.DataFrame(rows, columns=list(BUNDLE_COLUMNS))


def bundle_rows(hours: pd.DataFrame) -> list[tuple[str, ...]]:
    """Texts of a ``bundle_table`` under ``BUNDLE_HEADER``."""
    rows = []
    for policy, _, *values in hours.itertuples(index=False):
        intervals = (Interval(*values[k : k + 3]) for k in (0, 3, 6, 9))
        rows.append((str(policy), *(i.text(f) for i, f in zip(intervals, (1.0, 100.0, 1.0, 1.0), strict=True))))
    return rows


def endings(table: pd.DataFrame) -> pd.DataFrame:
    """Number of complete episodes of each policy, and of those that ended with each of ``FAILURES``."""
    ended = table.reindex(columns=["policy", *ENDINGS], fill_value=0.0)
    counts = ended.groupby("policy", sort=False).sum().astype(int)
    return counts.assign(episodes=table.groupby("policy").size())


def comparison_lines(table: pd.DataFrame, reference: str) -> list[str]:
    """A line for every other policy: paired differences in goal, time and length within the limit to the reference."""
    lines, has_lead = [], {BEST, BAR} <= set(table["policy"])
    goals = kpis_of(table.columns, GOALS)
    for policy in dict.fromkeys(table["policy"]):
        if policy == reference:
            continue
        time = signed(paired_difference(table, policy, reference, "inspection_time_s"), 1.0, " s")
        fraction = signed(paired_difference(table, policy, reference, "share_within_limit"), 100.0, " %")
        lead, total = "", ""
        for goal, (name, _, unit) in goals.items():
            total = f"{name} {signed(paired_difference(table, policy, reference, goal), 1.0, f' {unit}')}, "
        if has_lead and policy not in (BEST, BAR):
            lead = f", share of the lead of {BEST} over {BAR} {fraction_of_lead(table, policy).text(100.0)} %"
        lines.append(f"{policy} against {reference}: {total}time {time}, length within the limit {fraction}{lead}")
    return lines


def signed(difference: Interval, factor: float = 1.0, unit: str = "") -> str:
    """A difference such as "-41 s [-44, -38]"; without an interval where there is none."""
    mean, low, high = (f"{value * factor:+.3g}" for value in (difference.mean, difference.low, difference.high))
    return f"{mean}{unit}" + (f" [{low}, {high}]" if difference.low < difference.high else "")


def strain_lines(table: pd.DataFrame) -> list[str]:
    """A line for every policy and cost of ``STRAINS`` above zero in one of its episodes."""
    lines = []
    for policy in dict.fromkeys(table["policy"]):
        part = table[table["policy"] == policy]
        for name, words in STRAINS.items():
            periods = part.get(name, pd.Series(dtype=float))
            if count := int((periods > 0.0).sum()):
                maximum = f"{periods.max():.0f} control period{'s' if periods.max() > 1.0 else ''}"
                lines.append(
                    f"{policy}: the root was {words} in {count} of {len(part)} episodes, for {maximum} at most"
                )
    return lines


def has_curves(table: pd.DataFrame) -> bool:
    """Whether a table of episodes has detection curves; tables of older versions have none."""
    return set(POD_NAMES) <= set(table.columns)


def curves_by_tube(table: pd.DataFrame, policy: str) -> FloatArray:
    """(tubes, d) probability of detection at ``DEPTHS``, mean over the seeds of each tube."""
    part = table[table["policy"] == policy]
    return part.groupby("context")[list(POD_NAMES)].mean().to_numpy()


def a90_95(table: pd.DataFrame, policy: str) -> float:
    """Depth [% of the wall] detected with probability 90 % at 95 % confidence (bootstrap over tubes); NaN for one."""
    curves = curves_by_tube(table, policy)
    if len(curves) < 2:
        return math.nan
    return float(100.0 * np.percentile(depths_found(bootstrap_means(curves), 0.9), A90_BOUND))


def depths_of(table: pd.DataFrame) -> pd.DataFrame:
    """a50, a90 and a90/95 [% of the wall] of every policy, from the mean curve over the tubes."""
    rows = []
    for policy in dict.fromkeys(table["policy"]):
        mean = _mean(curves_by_tube(table, policy))
        half, maximum = (100.0 * float(depths_found(mean, level)[0]) for level in (0.5, 0.9))
        rows.append((policy, half, maximum, a90_95(table, policy)))
    return pd.DataFrame(rows, columns=list(DEPTH_COLUMNS))


def difference_of_a90(first: FloatArray, second: FloatArray) -> Interval:
    """Paired difference in a90 [% of the wall], first minus second; the ends are NaN for one tube.

    Both are (tubes, d) curves at ``DEPTHS`` in the same tubes, see ``curves_by_tube``.
    """
    mean, resampled = (
        100.0 * (depths_found(of(first), 0.9) - depths_found(of(second), 0.9)) for of in (_mean, bootstrap_means)
    )
    low, high = np.percentile(resampled, PERCENTILES) if len(first) > 1 else (np.nan, np.nan)
    return Interval(float(mean[0]), float(low), float(high))


def _mean(curves: FloatArray) -> FloatArray:
    return np.asarray(curves.mean(axis=0, keepdims=True))


def bands(table: pd.DataFrame) -> pd.DataFrame:
    """Mean probability of detection over the tubes with its 95 % band (NaN for one), for every policy and depth."""
    parts = []
    for policy in dict.fromkeys(table["policy"]):
        curves = curves_by_tube(table, policy)
        ends = np.percentile(bootstrap_means(curves), PERCENTILES, axis=0)
        low, high = ends if len(curves) > 1 else np.full_like(ends, np.nan)
        columns = {"depth_percent_wall": 100.0 * DEPTHS, "pod": curves.mean(axis=0), "low": low, "high": high}
        parts.append(pd.DataFrame({"policy": policy, **columns}))
    return pd.concat(parts, ignore_index=True)
