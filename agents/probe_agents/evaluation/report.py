"""The report of an evaluation: one HTML file that works offline."""

from __future__ import annotations

import base64
import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, NamedTuple

import pandas as pd
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from probe_agents.evaluation import figures
from probe_agents.evaluation.folder import Evaluation, read_evaluation
from probe_agents.evaluation.kpis import KPIS, SCORED_PASSES, displayed_kpis, label_of
from probe_agents.evaluation.profiles import Description, downloads, inner_policy, short_schedule, traces
from probe_agents.evaluation.repeat import (
    RepeatCase,
    by_policy,
    cases_of,
    is_judged,
    quiet_text,
    repeat_overview,
    verdict_of,
    verdict_text,
)
from probe_agents.evaluation.statistics import (
    BUNDLE_HEADER,
    bands,
    bundle_rows,
    bundle_table,
    by_context,
    comparison_lines,
    endings,
    has_curves,
    method_and_seed,
    paired_difference,
    ranking,
    short,
    strain_lines,
    summarise,
)
from probe_agents.policies.fixed import Replayed, Scheduled
from probe_agents.policies.on_map import Privileged
from probe_agents.policies.planner import InsertionPlanner, InspectionPlanner
from probe_agents.records.atomic import write_atomically
from probe_agents.records.drawing import MM
from probe_env.envs.task import FAILURES, Measure, TaskConfig
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
ORACLES: Final = frozenset(["Planner", *(kind.__name__ for kind in (Privileged, InsertionPlanner, InspectionPlanner))])
"""Policies that use the true tube parameters, which a rig cannot measure; "Planner" in results before version 0.1.0."""
SCHEDULES: Final = (Scheduled.__name__, Replayed.__name__)
FEW_TUBES: Final = 10
"""Number of tubes below which a bootstrap interval is rough."""
MAX_DIAMETERS: Final = 12
"""Number of helix diameters beyond which there is no table by diameter."""
DRAWN_AT_FIRST: Final = 4
"""Policies whose traces are visible when the page opens."""
RANKED: Final = (
    "reward", "inspection_time_s", "share_within_limit", "inspected_share", "air_m3", "a90_percent_wall"
)  # fmt: skip
"""KPIs in the ranking; the others are in a second table, so that both fit on A4."""


def write_report(folder: Path) -> Path:
    """Write report.html from the files of a folder; if the evaluation is finished, summary.csv and bundle.csv."""
    done = read_evaluation(folder)
    summary = summarise(done.table)
    if done.missing is None:
        write_atomically(folder / "summary.csv", summary.to_csv(index=False, float_format="%.6g"))
        if done.bundle:
            hours = bundle_table(done.table, done.bundle)
            write_atomically(folder / "bundle.csv", hours.to_csv(index=False, float_format="%.6g"))
    environment = Environment(undefined=StrictUndefined, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":")}
    environment.globals["part"] = lambda name: Markup(_read(name))
    page = environment.from_string(_read("report.html"))
    write_atomically(folder / "report.html", page.render(**_content(done, summary)))
    return folder / "report.html"


def _read(name: str) -> str:
    return files("probe_agents.evaluation").joinpath("templates", name).read_text(encoding="utf-8")


def _content(done: Evaluation, summary: pd.DataFrame) -> dict[str, Any]:
    table, task, oracles, order = done.table, done.setting.task, oracle_policies(done), ranking(done.table)
    described = descriptions(done)
    kinds = {name: inner_policy(policy).get("policy") in SCHEDULES for name, policy in described.items()}
    subjects, hours = done.user_policies or (done.against,), bundle_table(table, done.bundle)
    first = first_page(done)
    driven = done.profile[done.profile["policy"] == first.policy]
    note, schedule = short_schedule(described.get(first.policy, {}), driven)
    first_picture, *pictures = _pictures(done, summary, driven)
    others = [name for name in order if name != first.policy]
    comparisons = [compare_with_best(table, policy, oracles) for policy in subjects]
    best = [name for name in order if name not in oracles]
    ranked_table, more_figures = ranked(table, summary, done.user_policies, oracles)
    visible = list(dict.fromkeys([*(v.policy for v in comparisons), *best[:2], done.against, *best]))[:DRAWN_AT_FIRST]
    return {
        "title": "Feed policies compared",
        "few_tubes": 1 < table["context"].nunique() < FEW_TUBES,
        "done": done,
        "first": first,
        "note": note,
        "schedule": (
            ["length [m]", "feed [m/s]", "air [m³/h]"],
            [
                Row(f"{length:g}", "", (Cell(f"{feed:.3f}"), Cell(f"{3600.0 * air:.0f}")))
                for length, feed, air in schedule.itertuples(index=False)
            ],
        ),
        "first_picture": first_picture,
        "comparisons": comparisons,
        "own": {name: f"Your {'schedule' if kinds.get(name) else 'policy'}" for name in done.user_policies},
        "facts": _facts(done),
        "ranked": ranked_table,
        "more_figures": more_figures,
        "oracles": [name for name in order if name in oracles],
        "other_verdicts": other_verdicts(done, others),
        "strain_lines": strain_lines(table),
        "comparison_lines": comparison_lines(table, done.against),
        "by_diameter": by_diameter(table, oracles),
        "by_tube": by_tube(table, oracles),
        "other_hours": (
            BUNDLE_HEADER,
            [Row(name, "", tuple(map(Cell, texts))) for name, *texts in bundle_rows(hours) if name in others],
        ),
        "downloads": downloads(table, done.profile),
        "traces": traces(table, done.profile, visible, _limit_mm(task)),
        "pictures": pictures,
    }


def _limit_mm(task: TaskConfig) -> float | None:
    return task.limit * MM if task.vibration_measure == "displacement" else None


def _facts(done: Evaluation) -> dict[str, str]:
    table, task, scene = done.table, done.setting.task, done.setting.task.scene
    tubes = table.drop_duplicates("context")
    ranges = [f"bore {scene.tube.inner_diameter * MM:g} mm, helix {scene.tube.helix_length:g} m"]
    for header_, (name, factor, _, unit) in TUBE.items() if (tubes["helix_diameter"] > 0.0).all() else ():
        low, high = tubes[name].min() * factor, tubes[name].max() * factor
        ranges.append(f"{header_.partition(' [')[0]} {low:.3g}{f' to {high:.3g}' if low < high else ''}{unit}")
    probe = scene.probe
    design = (
        f"cable {probe.cable_diameter * MM:g} mm, floats {probe.carrier_float_diameter * MM:g} mm every"
        f" {probe.float_pitch * MM:g} mm, guide cable {probe.guide_length:g} m"
    )
    presets = PRESETS | ROUND_TRIP_PRESETS if task.returns else PRESETS
    stored, measure = done.setting.fidelity, MEASURES[task.vibration_measure][0]
    policies = table["policy"].nunique()
    instrument, bundle = {}, {}
    if is_judged(task):
        assert task.instrument
        speed, requirement = task.permitted_speed
        permits = f"permits {speed:.3g} m/s ({requirement}); " if requirement else ""
        instrument["instrument"] = f"{permits}shortest interval to repeat {task.instrument.repeat_length:g} m"
    if done.bundle:
        withdrawal = f" and {done.bundle.withdrawal_time:.3g} s of withdrawal" if done.bundle.withdrawal_time else ""
        why = "with metres to repeat" if is_judged(task) else "over the vibration limit somewhere, or not complete"
        bundle["bundle"] = (
            f"{done.bundle.tubes} tubes; per tube {done.bundle.setup_time:.3g} s of setup{withdrawal} are added; a"
            f" second pass is another whole insertion, for a tube {why}"
        )
    return {
        **({"passes": f"in and back; scored is {SCORED_PASSES[task.scored_pass]}"} if task.returns else {}),
        "limit": f"{measure} of {limit_of(task)} at the sensor, {task.period:g} s at a time",
        "insertions": f"{len(table)}, of {policies} {'policies' if policies > 1 else 'policy'} in"
        f" {f'the same {len(tubes)} tubes' if len(tubes) > 1 else '1 tube'}",
        "tubes": "; ".join(ranges),
        "probe": "a random one for every tube and seed" if done.setting.probes == "random" else design,
        **instrument,
        **bundle,
        "simulated with": next((name for name, v in presets.items() if v.model_dump() == stored), str(stored)),
    }


def _pictures(done: Evaluation, summary: pd.DataFrame, driven: pd.DataFrame) -> list[tuple[str, str, str]]:
    """Title, caption and base64 data of every figure; the first is of the profile ``driven``, of the first page."""
    task, tubes, pictures = done.setting.task, done.table["context"].nunique(), []
    limit, vibration = _limit_mm(task), PROFILED.get(task.vibration_measure, "")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "figure.png")

        def draw(title: str, caption: str, function: Callable[..., Path], *data: Any) -> None:
            pictures.append((title, caption, base64.b64encode(function(*data, path).read_bytes()).decode()))

        known = vibration in driven
        column, bound = (vibration, rms_limit(task)) if known else ("radial_rms_m", None)
        measure = MEASURES[task.vibration_measure if known else "displacement"][0]
        several = len(driven.drop_duplicates(["context", "seed", "training_seed"])) > 1
        many = "; line: mean, band: all insertions" if several else ""
        caption = f"Highest feed of each metre, and its vibration ({measure}){many}."
        picture = partial(figures.speed_and_vibration, permitted=task.permitted_speed[0], vibration=column, limit=bound)
        draw("Speed and vibration", caption, picture, driven)
        intervals, confidence = (" with 95 % intervals", ", 95 % bands over the tubes") if tubes > 1 else ("", "")
        caption = f"Mean over the tubes of each policy{intervals}. Down and left is better."
        draw("Time against vibration", caption, figures.trade_off, summary)
        caption = "Feed speed, air supply and radial rms over the inserted length; thin lines: 90th percentile."
        draw("Mean over the tubes", caption, partial(figures.policy_profiles, limit_mm=limit), done.profile)
        if has_curves(done.table):
            caption = (
                f"Probability of detection over the depth of a flaw, mean over the tubes{confidence}."
                " Depths are relative to the two reference points of the sensor model."
            )
            draw("Probability of detection", caption, figures.curves, bands(done.table))
    return pictures


def descriptions(done: Evaluation) -> dict[str, Description]:
    """The description of every method, for its first training seed."""
    methods: dict[str, Description] = {}
    for name, description in done.record.policies.items():
        methods.setdefault(method_and_seed(name)[0], description)
    return methods


def oracle_policies(done: Evaluation) -> set[str]:
    """Names of the oracles: policies that use the true tube parameters, which a rig cannot measure."""
    return {name for name, policy in descriptions(done).items() if inner_policy(policy).get("policy") in ORACLES}


def limit_of(task: TaskConfig) -> str:
    """The vibration limit with its unit."""
    _, factor, unit = MEASURES[task.vibration_measure]
    return f"{task.limit * factor:.4g} {unit}"


def verdict_lines(cases: Mapping[str, Sequence[RepeatCase]], task: TaskConfig) -> dict[str, str]:
    """Policy -> whether its feed is allowed with the instrument."""
    return {policy: verdict_text(verdict_of(policy, own, task), len(own)) for policy, own in cases.items()}


def other_verdicts(done: Evaluation, policies: Collection[str]) -> dict[str, str]:
    """Policy -> verdict and mean length to repeat of some policies; empty without an instrument."""
    task = done.setting.task
    if not is_judged(task):
        return {}
    cases = by_policy(cases_of(done.table[done.table["policy"].isin(policies)], done.profile, task))
    return {
        policy: f"{verdict_text(verdict, len(own))}; {verdict.repeat:.1f} m to repeat{_on_average(own)}"
        for policy, own in cases.items()
        for verdict in (verdict_of(policy, own, task),)
    }


def _on_average(cases: Sequence[RepeatCase]) -> str:
    return " on average" if len(cases) > 1 else ""


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


def first_page(done: Evaluation) -> FirstPage:
    """The first page: of the user's schedule, else of another policy of the user, else of the best without oracles."""
    task, described, order = done.setting.task, descriptions(done), ranking(done.table)
    schedules = [
        name for name in done.user_policies if inner_policy(described.get(name, {})).get("policy") in SCHEDULES
    ]
    best = [name for name in order if name not in oracle_policies(done)]
    policy = next(iter([*schedules, *done.user_policies, *best, *order]))
    table = done.table[done.table["policy"] == policy]
    fraction = by_context(table, policy, "share_within_limit").mean()
    loud = f"not quiet: vibration within {limit_of(task)} in {short(100.0 * fraction)} % of the length"
    quiet = f"quiet: vibration within {limit_of(task)} wherever it was inspected"
    below = table["share_within_limit"] < table.get("inspected_share", 1.0) - 1e-9
    sentences, to_repeat = [loud if below.any() else quiet], ""
    header: list[str] = []
    rows: list[Row] = []
    if is_judged(task):
        (own,) = by_policy(cases_of(table, done.profile, task)).values()
        judged = verdict_of(policy, own, task)
        if judged.requirement:
            sentences.insert(0, verdict_text(judged, len(own)))
        if task.vibration_measure in PROFILED:
            sentences[-1] = quiet_text(judged, limit_of(task), len(own))
        to_repeat = f"{judged.repeat:.1f} m{_on_average(own)}"
        overview = repeat_overview([intervals for _, intervals in own], task.scene.tube.helix_length)
        header = ["from [m]", "to [m]", "reason", *["insertions [%]"] * (len(own) > 1)]
        rows = [
            Row(
                f"{begin:.1f}",
                "",
                (Cell(f"{end:.1f}"), Cell(reason), Cell(f"{100.0 * fraction:.0f}"))[: len(header) - 1],
            )
            for begin, end, reason, fraction in overview.itertuples(index=False)
        ]
    sentences[-1] += _not_complete(table, policy)
    hours = [texts for _, *texts in bundle_rows(bundle_table(table, done.bundle))]
    return FirstPage(
        policy,
        tuple(sentences),
        to_repeat,
        (header, rows),
        dict(zip(BUNDLE_HEADER[1:], hours[0], strict=True)) if hours else {},
    )


class Comparison(NamedTuple):
    """A policy compared with the best other one; ``best`` and ``result`` are empty without another one.

    Attributes:
        policy: its name.
        best: the best other policy.
        result: "better than", "worse than" or "no clear difference from".
        first: whether the policy itself is the best of all.
        table: a row for each KPI: means of both, and paired difference with its interval.
    """

    policy: str
    best: str
    result: str
    first: bool
    table: Table


def compare_with_best(table: pd.DataFrame, policy: str, oracles: Collection[str]) -> Comparison:
    """A policy compared with the best of the others, oracles excluded, all on the same tubes."""
    order = [name for name in ranking(table) if name == policy or name not in oracles]
    best = next((name for name in order if name != policy), "")
    names, rows, result, ends = [policy, *filter(None, [best])], [], "", dict(endings(table).iterrows())
    for kpi in ("reward", "inspection_time_s", "share_within_limit"):
        label, factor, unit = KPIS[kpi]
        cells = [Cell(short(by_context(table, name, kpi).mean() * factor)) for name in names]
        if best:
            difference = paired_difference(table, policy, best, kpi)
            mean, low, high = (factor * v for v in (difference.mean, difference.low, difference.high))
            cells.append(_with_ends(mean, low, high, "+"))
            clear = "better than" if difference.mean > 0.0 else "worse than"
            result = result or ("no clear difference from" if difference.low <= 0.0 <= difference.high else clear)
        rows.append(Row(f"{label} [{unit}]" if unit else label, "", tuple(cells)))
    complete = (Cell(f"{ends[name]['complete']} of {ends[name]['episodes']}") for name in names)
    rows.append(Row("complete", "", (*complete, *[Cell("")] * bool(best))))
    return Comparison(policy, best, result, order[0] == policy, (["mean", *names, *["difference"] * bool(best)], rows))


def _time_and_fraction(part: pd.DataFrame, policy: str) -> tuple[str, str]:
    time, fraction = (by_context(part, policy, kpi).mean() for kpi in ("inspection_time_s", "share_within_limit"))
    return f"{short(time)} s", f"{short(100.0 * fraction)} %"


def _not_complete(table: pd.DataFrame, policy: str) -> str:
    row = dict(endings(table).iterrows())[policy]
    missing = row["episodes"] - row["complete"]
    return f"; it did not complete {missing} of {row['episodes']} insertions" if missing else ""


class Cell(NamedTuple):
    """A value, a second line, and whether it is the best of its column."""

    text: str
    below: str = ""
    best: bool = False


class Row(NamedTuple):
    """A row of a table: head, note and cells."""

    head: str
    below: str
    cells: tuple[Cell, ...]


Table = tuple[list[str], list[Row]]
"""Header and rows."""


def ranked(
    table: pd.DataFrame, summary: pd.DataFrame, users: Collection[str], oracles: Collection[str]
) -> tuple[Table, Table]:
    """Two tables with a row per policy, best first: the ranking by reward, and the other KPIs; with intervals."""
    values: dict[tuple[str, str], dict[Any, Any]] = {(r["policy"], r["kpi"]): r for r in summary.to_dict("records")}
    ranking_rows, more_rows, ends, order = [], [], dict(endings(table).iterrows()), ranking(table)
    best = next((name for name in order if name not in oracles), order[0])
    labels = displayed_kpis(table.columns)
    for policy in order:
        cells = {}
        for kpi, (_, factor, _) in labels.items():
            row = values[policy, kpi]
            cells[kpi] = _with_ends(row["mean"] * factor, row["low"] * factor, row["high"] * factor)
        against = Cell("best")
        if policy != best:
            difference = paired_difference(table, policy, best, "reward")
            against = _with_ends(difference.mean, difference.low, difference.high, "+")
            if difference.low < 0.0 < difference.high:
                against = against._replace(text=f"{against.text} (unclear)")
        complete, _, reasons = ended(ends[policy]).partition(", ")
        reward, *main = (cells.pop(kpi) for kpi in RANKED if kpi in labels)
        note = "yours" if policy in users else "oracle" if policy in oracles else ""
        ranking_rows.append(Row(policy, note, (reward, against, *main, Cell(complete, reasons))))
        more_rows.append(Row(policy, note, tuple(cells.values())))
    names = {kpi: f"{name} [{unit}]" if unit else name for kpi, (name, _, unit) in labels.items()}
    reward_name, *main_names = (names.pop(kpi) for kpi in RANKED if kpi in labels)
    header = ["policy", reward_name, f"reward against {best}", *main_names, "how it ended"]
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
    return ["policy", *names], [Row(policy, "", tuple(c[policy] for c in columns)) for policy in ranking(table)]


def by_tube(table: pd.DataFrame, oracles: Collection[str]) -> Table:
    """One row per tube: its parameters, then time and length within the limit of every policy."""
    order, rows = ranking(table), []
    parameters = TUBE if (table["helix_diameter"] > 0.0).all() else {}
    for number, part in table.groupby("context"):
        cells = [Cell(f"{part[name].iloc[0] * factor:.{digits}f}") for name, factor, digits, _ in parameters.values()]
        column = _best_marked(part, oracles)
        rows.append(Row(f"{number}", "", (*cells, *(column[policy] for policy in order))))
    return ["tube", *parameters, *order], rows


def _best_marked(part: pd.DataFrame, oracles: Collection[str]) -> dict[str, Cell]:
    cells, ends, order = {}, dict(endings(part).iterrows()), ranking(part)
    best = next((name for name in order if name not in oracles), "")
    for policy in order:
        time, fraction = _time_and_fraction(part, policy)
        count, complete = ends[policy]["episodes"], ends[policy]["complete"]
        failed = f", {f'{count - complete} ' if count > 1 else ''}not complete" if complete < count else ""
        cells[policy] = Cell(time, fraction + failed, policy == best)
    return cells
