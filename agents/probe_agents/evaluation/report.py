"""The report of an evaluation: one HTML file that works offline."""

from __future__ import annotations

import base64
from collections.abc import Collection, Iterable, Mapping, Sequence
from datetime import date
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, NamedTuple

import pandas as pd
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from probe_agents.evaluation import figures, profiles, repeat, statistics
from probe_agents.evaluation.advice import Rows, choose, compare_passes
from probe_agents.evaluation.folder import Evaluation, read_evaluation
from probe_agents.evaluation.kpis import GOALS, HIGH, SCORED_PASSES, displayed_kpis, goal_of, heading, kpis_of, label_of
from probe_agents.evaluation.statistics import broken_limits, by_context, endings, ranking, short
from probe_agents.policies.fixed import Replayed, Scheduled
from probe_agents.policies.on_map import Privileged
from probe_agents.policies.planner import InsertionPlanner
from probe_agents.records.atomic import write_atomically
from probe_agents.records.drawing import MM
from probe_agents.records.store import write_tables
from probe_env.envs.task.config import Measure, TaskConfig
from probe_env.envs.task.rules import FAILURES
from probe_env.envs.vibration_map import PROFILED, rms_limit
from probe_env.fidelity import PRESETS, ROUND_TRIP_PRESETS

MEASURES: Final[dict[Measure, tuple[str, float, str]]] = {
    "displacement": ("radial rms", 1e3, "mm"),
    "velocity": ("radial velocity rms", 1e3, "mm/s"),
    "acceleration": ("radial acceleration rms", 1.0, "m/s²"),
    "snr": ("noise in the band of a flaw", 1.0, "of a 20 % groove's signal"),
}
"""Vibration measure -> name, factor and unit."""
TUBE: Final = {
    "helix diameter [m]": ("helix_diameter", 1.0, 2, " m"),
    "friction": ("friction", 1.0, 3, ""),
    "contact stiffness [kN/m]": ("contact_stiffness", 1e-3, 0, " kN/m"),
    "drag factor": ("drag_factor", 1.0, 2, ""),
}
"""Header -> column of a tube, factor, digits and unit."""
ORACLES: Final = frozenset(["Planner", "InspectionPlanner", Privileged.__name__, InsertionPlanner.__name__])
"""Policies that use the true tube parameters, which a rig cannot measure; the first two in older results."""
SCHEDULES: Final = frozenset([Scheduled.__name__, Replayed.__name__])
FEW_TUBES: Final = 10
"""Number of tubes below which a bootstrap interval is rough."""
MAX_DIAMETERS: Final = 12
"""Number of helix diameters beyond which there is no table by diameter."""
DRAWN_AT_FIRST: Final = 4
"""Policies whose traces are visible when the page opens."""
RANKED: Final = (
    *GOALS, "reward", "inspection_time_s", "share_within_limit", "inspected_share", "air_m3", "a90_percent_wall",
    "length_to_repeat_m",
)  # fmt: skip
"""KPIs in the ranking and in comparisons, the first decides; others are in a second table, so that both fit on A4."""


def write_report(folder: Path) -> Path:
    """Write report.html from the files of a folder; if the evaluation is finished, summary.csv and bundle.csv."""
    done = read_evaluation(folder)
    summary, hours = statistics.summarise(done.table), statistics.bundle_table(done.table, done.report.bundle)
    if done.missing is None:
        write_tables(folder, {"summary": summary} | ({"bundle": hours} if done.report.bundle else {}))
    environment = Environment(undefined=StrictUndefined, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":")}
    environment.filters["g"] = lambda value, digits=6: f"{value:.{digits}g}"
    environment.globals["part"] = lambda name: Markup(_read(name))
    page = environment.from_string(_read("report.html"))
    write_atomically(folder / "report.html", page.render(**_content(done, summary, hours)))
    return folder / "report.html"


def _read(name: str) -> str:
    return files("probe_agents.evaluation").joinpath("templates", name).read_text(encoding="utf-8")


def _content(done: Evaluation, summary: pd.DataFrame, bundle: pd.DataFrame) -> dict[str, Any]:
    """Variables of the template."""
    table, task, oracles, order = done.table, done.setting.task, oracle_policies(done), ranking(done.table)
    advised, sentence, choice = choose(table, oracles)
    first, schedules, users = first_page(done), _of_kind(done, SCHEDULES), done.report.user_policies
    driven = done.profile[done.profile["policy"] == first.policy]
    recommends = done.report.sensitivity is not None
    pages = [first, *(first_page(done, name) for name in users if recommends and name != first.policy)]
    comparisons = [compare_with_best(table, policy, oracles) for policy in users or (done.report.against,)]
    best = [name for name in order if name not in oracles]
    ranked_table, more_figures = ranked(table, summary, users, oracles)
    visible = list(dict.fromkeys([*(v.policy for v in comparisons), *best[:2], done.report.against, *best]))[
        :DRAWN_AT_FIRST
    ]
    limit_mm = task.limit * MM if task.vibration_measure == "displacement" else None
    measured = PROFILED.get(task.vibration_measure, "") in driven  # else displacement is drawn
    presets = PRESETS | ROUND_TRIP_PRESETS if task.returns else PRESETS
    stored = done.setting.fidelity
    hours = [_row(texts) for texts in statistics.bundle_rows(bundle) if texts[0] != first.policy]
    return {
        "done": done,
        "date": f"{date.today():%Y-%m-%d}",
        "task": task,
        "probe": task.scene.probe,
        "limit": limit_of(task),
        "measure": MEASURES[task.vibration_measure][0],
        "scored_pass": SCORED_PASSES[task.scored_pass],
        "tube_ranges": _tube_ranges(table),
        "judged": repeat.is_judged(task),
        "preset": next((name for name, preset in presets.items() if preset.model_dump() == stored), str(stored)),
        "few_tubes": FEW_TUBES,
        "goal": displayed_kpis(table.columns)[goal_of(table.columns)][0],
        "choice": _table(choice),
        "sentence": sentence[0].upper() + sentence[1:],
        "first": first,
        "pages": [(page, *_feed_and_air(done, page.policy)) for page in pages],
        "recommends": recommends,
        "passes": _table(compare_passes(table, advised, task, done.report.bundle)),
        "sensitivity": _table(done.report.sensitivity),
        "comparisons": comparisons,
        "own": {name: f"Your {'schedule' if name in schedules else 'policy'}" for name in users},
        "ranked": ranked_table,
        "more_figures": more_figures,
        "oracles": [name for name in order if name in oracles],
        "verdicts": {name: verdict for name, (verdict, _) in verdicts(done).items() if name != first.policy},
        "verdict_text": repeat.verdict_text,
        "strain_lines": statistics.strain_lines(table),
        "comparison_lines": statistics.comparison_lines(table, done.report.against),
        "by_diameter": by_diameter(table, oracles),
        "by_tube": by_tube(table, oracles),
        "other_hours": (statistics.BUNDLE_HEADER, hours),
        "downloads": profiles.downloads(table, done.profile),
        "traces": profiles.traces(table, done.profile, visible, limit_mm),
        "driven_measure": MEASURES[task.vibration_measure if measured else "displacement"][0],
        "several_driven": len(driven.drop_duplicates(["context", "seed", "training_seed"])) > 1,
        "pictures": _pictures(done, summary, driven, measured, limit_mm),
    }


def _feed_and_air(done: Evaluation, policy: str) -> tuple[str, Table]:
    """Note and rows of a policy's feed and air."""
    driven = done.profile[done.profile["policy"] == policy]
    note, schedule = profiles.short_schedule(descriptions(done).get(policy, {}), driven)
    points = ((f"{x:g}", f"{u:.3f}", f"{3600.0 * air:.0f}") for x, u, air in schedule.itertuples(index=False))
    return note, (["length [m]", "feed [m/s]", "air [m³/h]"], list(map(_row, points)))


def _tube_ranges(table: pd.DataFrame) -> list[tuple[str, float, float, str]]:
    """Name, lowest and highest value and unit of the parameters of the tubes."""
    tubes = table.drop_duplicates("context")
    return [
        (header.partition(" [")[0], tubes[name].min() * factor, tubes[name].max() * factor, unit)
        for header, (name, factor, _, unit) in (TUBE.items() if (tubes["helix_diameter"] > 0.0).all() else ())
    ]


def _pictures(
    done: Evaluation, summary: pd.DataFrame, driven: pd.DataFrame, measured: bool, limit_mm: float | None
) -> dict[str, str]:
    """Figures by name, base64; ``driven`` is the profile of the first page, ``measured`` whether it has the measure."""
    task = done.setting.task
    column, bound = (PROFILED[task.vibration_measure], rms_limit(task)) if measured else ("radial_rms_m", None)
    pictures = {
        "speed": figures.speed_and_vibration(driven, task.permitted_speed[0], column, bound),
        "trade_off": figures.trade_off(summary),
        "performance": figures.performance_profiles(done.table),
        "profiles": figures.policy_profiles(done.profile, limit_mm),
    }
    if statistics.has_curves(done.table):
        pictures["curves"] = figures.curves(statistics.bands(done.table))
    return {name: base64.b64encode(picture).decode() for name, picture in pictures.items()}


def descriptions(done: Evaluation) -> dict[str, profiles.Description]:
    """The description of every method, for its first training seed."""
    methods: dict[str, profiles.Description] = {}
    for name, description in done.record.policies.items():
        methods.setdefault(statistics.method_and_seed(name)[0], description)
    return methods


def _of_kind(done: Evaluation, kinds: Collection[str]) -> set[str]:
    """Names of the methods whose policy, without its wrappers, is one of these classes."""
    return {name for name, d in descriptions(done).items() if profiles.inner_policy(d).get("policy") in kinds}


def oracle_policies(done: Evaluation) -> set[str]:
    """Names of the oracles: policies that use the true tube parameters, which a rig cannot measure."""
    return _of_kind(done, ORACLES)


def limit_of(task: TaskConfig) -> str:
    """The vibration limit with its unit."""
    _, factor, unit = MEASURES[task.vibration_measure]
    return f"{task.limit * factor:.4g} {unit}"


def verdicts(done: Evaluation) -> dict[str, tuple[repeat.Verdict, list[repeat.RepeatCase]]]:
    """Policy -> verdict with the instrument, and the cases that it is about; empty without an instrument."""
    task = done.setting.task
    if not repeat.is_judged(task):
        return {}
    cases = repeat.by_policy(repeat.cases_of(done.table, done.profile, task))
    return {policy: (repeat.verdict_of(own, task), own) for policy, own in cases.items()}


class FirstPage(NamedTuple):
    """What the first page of the report, and the app, say of one policy.

    Attributes:
        policy: its name.
        verdict: sentences without their subject: allowed or not (with an instrument only), quiet or not.
        to_repeat: length to repeat; "" without an instrument.
        repeat: intervals to repeat; no rows without an instrument.
        hours: quantity -> hours of the bundle; empty without one.
    """

    policy: str
    verdict: tuple[str, ...]
    to_repeat: str
    repeat: Table
    hours: dict[str, str]


def first_page(done: Evaluation, policy: str = "") -> FirstPage:
    """The first page: of a policy, by default the user's schedule, else another one of the user, else the best.

    The report of a recommendation begins with the best, see ``choose``.
    """
    task, limit, schedules = done.setting.task, limit_of(done.setting.task), _of_kind(done, SCHEDULES)
    mine = [*(name for name in done.report.user_policies if name in schedules), *done.report.user_policies]
    if done.report.sensitivity is not None or not mine:
        mine = [choose(done.table, oracle_policies(done))[0]]
    policy = policy or mine[0]
    table = done.table[done.table["policy"] == policy]
    below = table["share_within_limit"] < table.get("inspected_share", 1.0) - 1e-9
    sentences, to_repeat = [f"quiet: vibration within {limit} wherever it was inspected"], ""
    if below.any():
        fraction = by_context(table, policy, "share_within_limit").mean()
        sentences = [f"not quiet: vibration within {limit} in {short(100.0 * fraction)} % of the length"]
    header: list[str] = []
    rows: list[Row] = []
    if judged := verdicts(done):
        verdict, own = judged[policy]
        if verdict.requirement:
            sentences.insert(0, repeat.verdict_text(verdict))
        if task.vibration_measure in PROFILED:
            sentences[-1] = repeat.quiet_text(verdict, limit)
        to_repeat = f"{verdict.repeat:.1f} m{verdict.on_average}"
        overview = repeat.repeat_overview([intervals for _, intervals in own], task.scene.tube.helix_length)
        header = ["from [m]", "to [m]", "reason", *["insertions [%]"] * (len(own) > 1)]
        rows = [
            _row((f"{begin:.1f}", f"{end:.1f}", reason, f"{100.0 * fraction:.0f}"))[: len(header)]
            for begin, end, reason, fraction in overview.itertuples(index=False)
        ]
    ends = dict(endings(table).iterrows())[policy]
    if missing := ends["episodes"] - ends["complete"]:
        sentences[-1] += f"; it did not complete {missing} of {ends['episodes']} insertions"
    hours = statistics.bundle_rows(statistics.bundle_table(table, done.report.bundle))
    of_bundle = dict(zip(statistics.BUNDLE_HEADER[1:], hours[0][1:], strict=True)) if hours else {}
    return FirstPage(policy, tuple(sentences), to_repeat, (header, rows), of_bundle)


class Comparison(NamedTuple):
    """A policy compared with the best other one; ``best`` and ``result`` are empty without another one.

    Attributes:
        policy: its name.
        best: the best other policy.
        result: "better than", "worse than" or "no clear difference from", and before it the limits that it breaks.
        first: whether the policy itself is the best of all.
        table: a row for each KPI: means of both, and paired difference with its interval.
    """

    policy: str
    best: str
    result: str
    first: bool
    table: Table


def compare_with_best(table: pd.DataFrame, policy: str, oracles: Collection[str]) -> Comparison:
    """A policy compared with the best of the others, oracles excluded, all on the same tubes.

    One within the limits of the plant is better than one outside; of equals the first KPI decides.
    """
    order = [name for name in ranking(table) if name == policy or name not in oracles]
    best = next((name for name in order if name != policy), "")
    names, rows, result, ends = [policy, *filter(None, [best])], [], "", dict(endings(table).iterrows())
    broken = [broken_limits(table, name) for name in names]
    if best and bool(broken[0]) != bool(broken[1]):
        result = f"{broken[0]}: worse than" if broken[0] else "better than"
    for kpi, label in kpis_of(set(RANKED).intersection(table.columns)).items():
        factor = label[1]
        cells = _row([heading(label), *(short(by_context(table, name, kpi).mean() * factor) for name in names)])
        if best:
            difference = statistics.paired_difference(table, policy, best, kpi)
            mean, low, high = (factor * v for v in (difference.mean, difference.low, difference.high))
            cells.append(_with_ends(mean, low, high, "+"))
            clear = "better than" if (difference.mean > 0.0) == (kpi in HIGH) else "worse than"
            result = result or ("no clear difference from" if difference.low <= 0.0 <= difference.high else clear)
        rows.append(cells)
    complete = (f"{ends[name]['complete']} of {ends[name]['episodes']}" for name in names)
    rows.append(_row(["complete", *complete, *[""] * bool(best)]))
    return Comparison(policy, best, result, order[0] == policy, (["mean", *names, *["difference"] * bool(best)], rows))


class Cell(NamedTuple):
    """A value, a second line, and whether it is the best of its column."""

    text: str
    below: str = ""
    best: bool = False


Row = list[Cell]
"""A row of a table; the first cell is its head."""
Table = tuple[Sequence[str], list[Row]]
"""Header and rows."""


def _row(texts: Iterable[str]) -> Row:
    return list(map(Cell, texts))


def _table(texts: Rows | None) -> Table:
    header, *rows = texts or ((),)
    return header, list(map(_row, rows))


def ranked(
    table: pd.DataFrame, summary: pd.DataFrame, users: Collection[str], oracles: Collection[str]
) -> tuple[Table, Table]:
    """Two tables with a row per policy, best first: the ranking by the goal, and the other KPIs; with intervals."""
    values: dict[tuple[str, str], dict[Any, Any]] = {(r["policy"], r["kpi"]): r for r in summary.to_dict("records")}
    ranking_rows, more_rows, ends, order = [], [], dict(endings(table).iterrows()), ranking(table)
    best = next((name for name in order if name not in oracles), order[0])
    labels, goal = displayed_kpis(table.columns), goal_of(table.columns)
    for policy in order:
        cells = {}
        for kpi, (_, factor, _) in labels.items():
            row = values[policy, kpi]
            cells[kpi] = _with_ends(row["mean"] * factor, row["low"] * factor, row["high"] * factor)
        against, improvement = Cell("best"), Cell("")
        if policy != best:
            difference = statistics.paired_difference(table, policy, best, goal)
            against = _with_ends(difference.mean, difference.low, difference.high, "+")
            if difference.low < 0.0 < difference.high:
                against = against._replace(text=f"{against.text} (unclear)")
            over = statistics.probability_of_improvement(table, policy, best)
            improvement = _with_ends(100.0 * over.mean, 100.0 * over.low, 100.0 * over.high)
        complete, _, reasons = ended(ends[policy]).partition(", ")
        first, *main = (cells.pop(kpi) for kpi in RANKED if kpi in labels)
        kind = "yours" if policy in users else "oracle" if policy in oracles else ""
        head = Cell(policy, "; ".join(filter(None, (kind, broken_limits(table, policy)))))
        ranking_rows.append([head, first, against, improvement, *main, Cell(complete, reasons)])
        more_rows.append([head, *cells.values()])
    names = {kpi: heading(label) for kpi, label in labels.items()}
    first_name, *main_names = (names.pop(kpi) for kpi in RANKED if kpi in labels)
    header = [
        "policy",
        first_name,
        f"{labels[goal][0]} against {best}",
        "probability of a higher reward [%]",
        *main_names,
        "how it ended",
    ]
    return (header, ranking_rows), (["policy", *names.values()], more_rows)


def _with_ends(mean: float, low: float, high: float, sign: str = "") -> Cell:
    return Cell(short(mean, sign), f"{short(low, sign)} to {short(high, sign)}" if low < high else "")


def ended(row: Mapping[str, int] | pd.Series) -> str:
    """Number of complete insertions, and reasons of the others, for a row of ``endings``."""
    reasons = {label_of(name): row[name] for name in FAILURES}
    reasons["out of time"] = row["episodes"] - row["complete"] - sum(reasons.values())
    parts = [f"{count} {reason}" for reason, count in reasons.items() if count]
    return ", ".join([f"{row['complete']} of {row['episodes']} complete", *parts])


def by_diameter(table: pd.DataFrame, oracles: Collection[str]) -> Table:
    """Mean time and length within the limit: one row per policy, one column per helix diameter."""
    groups = list(table.groupby("helix_diameter"))
    if len(groups) > MAX_DIAMETERS or table["helix_diameter"].min() <= 0.0:
        return [], []
    counts = [(diameter, part["context"].nunique()) for diameter, part in groups]
    names = [f"{diameter:g} m ({count} tube{'s' if count > 1 else ''})" for diameter, count in counts]
    columns = [_best_marked(part, oracles) for _, part in groups]
    return ["policy", *names], [[Cell(policy), *(c[policy] for c in columns)] for policy in ranking(table)]


def by_tube(table: pd.DataFrame, oracles: Collection[str]) -> Table:
    """One row per tube: its parameters, then time and length within the limit of every policy."""
    order, rows = ranking(table), []
    parameters = TUBE if (table["helix_diameter"] > 0.0).all() else {}
    for number, part in table.groupby("context"):
        values = (f"{part[name].iloc[0] * factor:.{digits}f}" for name, factor, digits, _ in parameters.values())
        column = _best_marked(part, oracles)
        rows.append([*_row([f"{number}", *values]), *(column[policy] for policy in order)])
    return ["tube", *parameters, *order], rows


def _best_marked(part: pd.DataFrame, oracles: Collection[str]) -> dict[str, Cell]:
    cells, ends, order = {}, dict(endings(part).iterrows()), ranking(part)
    best = next((name for name in order if name not in oracles), "")
    for policy in order:
        time, fraction = (by_context(part, policy, kpi).mean() for kpi in ("inspection_time_s", "share_within_limit"))
        count, complete = ends[policy]["episodes"], ends[policy]["complete"]
        failed = f", {f'{count - complete} ' if count > 1 else ''}not complete" if complete < count else ""
        cells[policy] = Cell(f"{short(time)} s", f"{short(100.0 * fraction)} %{failed}", policy == best)
    return cells
