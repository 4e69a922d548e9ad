"""Chart of accuracy against cost: methods before and in the chaotic regime, mesh and model choices, time-lapse.

Where the probe vibrates trajectories diverge, so statistics of runs with a start perturbation of 0.1 um are compared:
ratios of means to a reference with 95 % bootstrap intervals. All runs of a setting share a batch.
"""

import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from itertools import cycle, product
from pathlib import Path
from typing import Any, ClassVar

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from tqdm import tqdm

from probe_agents.evaluation.statistics import ratio_interval
from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.records.drawing import GREY, save
from probe_agents.records.manifest import CHECKOUT, write_manifest
from probe_agents.records.store import Store, stored_rows, write_tables
from probe_agents.records.tables import Columns, read_csv
from probe_agents.studies.builtin import print_frame
from probe_agents.studies.claims import CASES, PERTURBATION, load_rows
from probe_agents.studies.smooth import SMOOTH_KEYS, cases, orders, resolved, run_smooth
from probe_agents.terminal.tables import print_line
from probe_env import Scene, SimulatorBatch, StabilityWarning, Window
from probe_env.fidelity import PRESETS
from probe_env.physics.methods import METHODS, ON_NODES
from probe_env.physics.simulation.signals import SAMPLE_PERIOD, dominant_frequencies

SETTLE, DURATION = 2.0, 6.0  # [s]
STATISTICS = (
    *("radial_rms_m", "radial_p99_m", "lift_off_share", "axial_rms_m", "axial_mean_m"),
    *("radial_acceleration_rms_m_per_s2", "tension_mean_n"),
)
PEAK = "axial_peak_hz"
UNITS = {"time_step": "time_step_s", "length": "carrier_length_m", "stiffness": "contact_stiffness_n_per_m"}
"""Field -> column with unit."""
FEED_SPEED, START, END = 0.2, 5.0, 60.0  # [m/s], [m], [m], of an insertion
SEGMENT = 5.0  # [m], of a row of an insertion


class Run:
    """Members of one setting in a batch."""

    members: int
    last_row: ClassVar[tuple[Any, ...]] = ()
    """End of the key of the last row."""

    @property
    def key(self) -> dict[str, Any]:
        """All fields except the number of members and ``whole``, as columns."""
        fields = asdict(self)  # type: ignore[call-overload]
        return {UNITS.get(name, name): value for name, value in fields.items() if name not in ("members", "whole")}

    @property
    def last(self) -> tuple[Any, ...]:
        """Key of the last row in the table."""
        return (*self.key.values(), self.members - 1, *self.last_row)


@dataclass(frozen=True)
class Setting(Run):
    """Method, mesh and scene of runs with table 2's probe at constant length."""

    method: str = "imex"
    time_step: float = 2e-4
    nodes_per_pitch: int = 4
    length: float = 50.0
    """Carrier length [m]."""
    stiffness: float = 1e5
    """Contact stiffness [N/m]."""
    friction: float = 0.15
    walls: str = "both"
    members: int = 16
    whole: bool = False
    """Whether the scene has all that the study leaves out; stored in a folder of its own."""

    def batch(self, count: int, threads: int | None = None) -> SimulatorBatch:
        """``count`` runs with perturbed starts."""
        contact = {"stiffness": self.stiffness, "friction": self.friction, "walls": self.walls}
        scene = Scene.model_validate({"carrier_length": self.length, "contact": contact})
        scene = scene.whole() if self.whole else scene
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StabilityWarning)  # steps beyond the limit are tested on purpose
            numerics = self.method, self.time_step, self.nodes_per_pitch
            return SimulatorBatch([scene] * count, *numerics, threads=threads, perturbation=PERTURBATION)

    def rows(self) -> list[dict[str, Any]]:
        """One row per member: its statistics, missing if it diverged."""
        batch = self.batch(self.members)
        batch.advance(None, None, SETTLE, SAMPLE_PERIOD)
        window = batch.advance(None, None, DURATION, SAMPLE_PERIOD, keep_samples=True)
        rows = []
        for member, diverged in enumerate(window.diverged.tolist()):
            row = self.key | {"member": member, "diverged": diverged}
            rows.append(row | ({} if diverged else _statistics(window, member)))
        return rows


@dataclass(frozen=True)
class Insertion(Run):
    """Method and mesh of insertions from 5 to 60 m at 0.2 m/s."""

    method: str = "imex"
    time_step: float = 2e-4
    time_lapse: float = 1.0
    nodes_per_pitch: int = 4
    members: int = 8
    last_row = (END - SEGMENT,)

    def rows(self, end: float = END) -> list[dict[str, Any]]:
        """One row per segment of length and member."""
        scenes = [Scene(carrier_length=START - 2.5, feed_speed=FEED_SPEED)] * self.members
        options = {"growing": True, "time_lapse": self.time_lapse, "perturbation": PERTURBATION}
        batch = SimulatorBatch(scenes, self.method, self.time_step, self.nodes_per_pitch, **options)  # type: ignore[arg-type]
        rows: list[dict[str, Any]] = []
        for start in tqdm(np.arange(START, end, SEGMENT), desc=str(self), unit="segment"):
            window = batch.advance(None, None, SEGMENT / FEED_SPEED / self.time_lapse, SAMPLE_PERIOD, keep_samples=True)
            if window.diverged.any():
                raise RuntimeError(f"{self}: {window.diverged.sum()} probes diverged beyond {start:g} m")
            for member in range(self.members):
                rows.append(self.key | {"member": member, "from_m": float(start)} | _statistics(window, member))
        return rows


LENGTHS = (10.0, 30.0, 50.0)  # [m]
STIFFNESSES = (1e4, 1e5, 1e6)  # [N/m]
STEPS = (5e-5, 1e-4, 1.25e-4, 1e-3 / 7, 1e-3 / 6, 2e-4, 2.5e-4, 5e-4)  # whole parts of the sampling period
MODEL_STEP = 1e-4  # [s], at which model choices are compared with each other
CHOICES: dict[str, dict[str, Any]] = {
    **{f"{n} node{'s' * (n > 1)} a pitch": {"nodes_per_pitch": n} for n in (1, 2, 8, 16)},
    "inner wall only": {"walls": "inner"},
    "contact half as stiff": {"stiffness": 5e4},
    "contact twice as stiff": {"stiffness": 2e5},
    "friction 0.14": {"friction": 0.14},
    "friction 0.16": {"friction": 0.16},
}
"""Single changes of table 2's mesh and model."""
CONVERGED_STEP, CONVERGED_NODES = 5e-5, 16  # [s], of imex: the reference
CONVERGED_LENGTHS = {10.0: 8, 30.0: 48, 40.0: 32, 50.0: 32}
"""Length [m] -> members of the converged reference at table 2's stiffness; 8 at others."""
SUPERELEMENT_STEPS = {1e4: (1e-4, 2e-4, 2.5e-4, 5e-4), 1e5: (5e-5, 1e-4, 2e-4, 2.5e-4), 1e6: (5e-5,)}
"""Contact stiffness [N/m] -> steps [s]: the longest stable one, and shorter ones."""
CONVERGED = Insertion("imex32", 5e-5, nodes_per_pitch=16)
"""The reference insertion."""
INSERTIONS = (
    *(Insertion("imex32", time_lapse=factor) for factor in (20.0, 10.0, 4.0, 2.0, 1.0)),
    *(Insertion("imex32", 1e-4, factor) for factor in (4.0, 1.0)),
    *(Insertion(time_lapse=factor) for factor in (4.0, 1.0)),
    Insertion(time_step=5e-5),
    *(Insertion("superelement32", time_lapse=factor, members=16) for factor in (20.0, 10.0, 4.0, 2.0, 1.0)),
    Insertion("superelement32", 1e-4),
    Insertion("superelement", 5e-5),
    Insertion("newmark", 1e-4, 4.0, members=4),
    CONVERGED,
)


def _settings() -> Iterator[Setting]:
    for stiffness, length in product(STIFFNESSES, LENGTHS):  # steps on table 2's mesh; slow methods: those of `claims`
        members = 32 if stiffness == Setting.stiffness else 16
        for method, steps in (("imex", (2.5e-5, *STEPS)), ("imex32", STEPS)):
            yield from (Setting(method, dt, length=length, stiffness=stiffness, members=members) for dt in steps)
    for length in LENGTHS[1:]:
        yield Setting("implicit", MODEL_STEP, length=length, members=8)
        yield from (Setting(**({"time_step": MODEL_STEP, "length": length} | change)) for change in CHOICES.values())
    for length, members in CONVERGED_LENGTHS.items():
        yield converged(length, Setting.stiffness, members)
        for dt in SUPERELEMENT_STEPS[Setting.stiffness]:
            many = length != 10.0 and dt >= 1e-4  # candidates of a preset
            yield Setting("superelement32", dt, length=length, members=128 if many else 16)
    for stiffness, length in product((1e4, 1e6), LENGTHS):
        yield converged(length, stiffness)
        for dt in SUPERELEMENT_STEPS[stiffness]:
            yield Setting("superelement32", dt, length=length, stiffness=stiffness)
    for length in (30.0, 40.0, 50.0):
        yield Setting("superelement", 2e-4, length=length, members=32)
        yield Setting("superelement", 5e-5, length=length)
        yield from (Setting("imex32", 2e-4, nodes, length, members=32) for nodes in (4, 8, 16))
    yield Setting("imex32", CONVERGED_STEP, CONVERGED_NODES, length=30.0, members=32)


def converged(length: float, stiffness: float, members: int = 8) -> Setting:
    """The reference of a length [m] and contact stiffness [N/m]."""
    return Setting("imex", CONVERGED_STEP, CONVERGED_NODES, length, stiffness, members=members)


SETTINGS = tuple(dict.fromkeys(_settings()))
WHOLE = tuple(
    replace(setting, length=length, whole=True)
    for length in LENGTHS[1:]
    for setting in (
        *(converged(length, Setting.stiffness, 16), Setting("superelement", 5e-5), Setting("imex32", members=32)),
        *(Setting("superelement32", members=64), Setting("implicit", MODEL_STEP, members=2)),
    )
)
"""Settings with the whole model: the converged mesh, the presets and independent methods."""


def _statistics(window: Window, member: int) -> dict[str, float]:
    """``STATISTICS`` and ``PEAK`` (NaN for one at rest) of one run of a batch; the window must hold the samples."""
    assert window.axial is not None
    peaks = dominant_frequencies(window.axial[:, member], SAMPLE_PERIOD, 1)
    values = {name: float(window.statistics[name][member]) for name in STATISTICS}
    return values | {PEAK: peaks[0] if peaks else float("nan")}


FLOORS = {"radial_rms_m": 1e-5, "radial_p99_m": 5e-5, "lift_off_share": 0.01, PEAK: 1.0, "axial_rms_m": 1e-5}
FLOORS["radial_acceleration_rms_m_per_s2"] = 0.1
"""Output -> smallest reference of a relative error; for the radial rms a tenth of the vibration limit."""
OUTPUTS = tuple(FLOORS)
RADIAL = ("radial_rms_m:ratio", "radial_rms_m:low", "radial_rms_m:high")
KEYS = list(Setting().key)
Row = Mapping[Any, Any]
NO_TIME_LAPSE = Insertion("superelement32")
"""Reference of insertions with time-lapse: method and step of ``fast``."""
_SEGMENTS = np.arange(START, END, SEGMENT) + 0.5 * SEGMENT
PITCH_SECONDS = float((_SEGMENTS / 0.1).sum() * SEGMENT / FEED_SPEED)
"""Sum of inserted pitches over the seconds of an insertion."""
TIMED_NODES = {"imex": (1, 2, 4, 8, 16), "imex32": (4, 8, 16)}
"""Nodes per pitch that are timed; 4 for other methods."""
TIMED_LENGTHS = (10.0, 30.0, 40.0, 50.0)  # [m]
MAX_TIMED = 1e-4  # [s], time step
REPEATS = 5
COST_COLUMNS: Columns = {
    "method": "text", "nodes_per_pitch": "count", "carrier_length_m": "number", "ns_per_node_step": "number",
}  # fmt: skip


def run_costs(output: Path) -> None:
    """Processor time of a node-step with full lanes on one thread, the minimum of ``REPEATS``; writes costs.csv.

    All costs are measured in one run: only ratios within a run are comparable.
    """
    cells = [(m, nodes, length) for m in METHODS for nodes in TIMED_NODES.get(m, (4,)) for length in TIMED_LENGTHS]
    rows = []
    for method, nodes, length in tqdm(cells, desc="costs", unit="setting"):
        kind = METHODS[method]
        setting = Setting(method, min(kind.usual_step, MAX_TIMED), nodes, length)
        batch, steps, seconds = setting.batch(kind.width, threads=1), 4000 if kind.width > 1 else 500, []
        for _ in range(1 + REPEATS):  # the first is a warm-up
            begin = time.process_time()
            batch.advance(None, None, steps * setting.time_step, steps * setting.time_step)
            seconds.append(time.process_time() - begin)
        node_steps = kind.width * steps * (length + 2.5) / 0.1 * nodes
        rows.append((method, nodes, length, min(seconds[1:]) / node_steps * 1e9))
    write_tables(output, {"costs": pd.DataFrame(rows, columns=list(COST_COLUMNS))}, 5)


def cpu_seconds(costs: pd.DataFrame, settings: pd.DataFrame) -> pd.Series:
    """Processor time [s] per probe and simulated second, for rows with the columns of a ``Setting``."""
    keys = list(COST_COLUMNS)[:3]
    node_step = settings[keys].merge(costs, how="left", on=keys)["ns_per_node_step"].to_numpy()
    nodes = (settings["carrier_length_m"] + 2.5) / 0.1 * settings["nodes_per_pitch"]
    seconds: pd.Series = nodes / settings["time_step_s"] * node_step * 1e-9
    return seconds


def insertion_cost(row: Row, costs: pd.DataFrame) -> float:
    """Processor time of an insertion of one probe [s], from the cost of a node-step."""
    same = (costs["method"] == row["method"]) & (costs["nodes_per_pitch"] == row["nodes_per_pitch"])
    node_step = costs[same]["ns_per_node_step"].mean()
    steps = PITCH_SECONDS / row["time_lapse"] / row["time_step_s"]
    return float(row["nodes_per_pitch"] * steps * node_step * 1e-9)


def study_members(ensemble: pd.DataFrame) -> pd.DataFrame:
    """The ensemble of ``claims`` at l = 10, 30 and 50 m, all methods, in the columns of ensembles.csv."""
    parts = []
    for case in CASES:
        length = float(case.scene.removeprefix("fig11_l")) if case.scene.startswith("fig11_l") else 0.0
        if length in LENGTHS and case.is_plain and case.method not in ("imex", "imex32"):
            setting = Setting(case.method, case.time_step, length=length)
            rows = ensemble[ensemble["case"] == case.name]
            part = rows[["member", *STATISTICS, PEAK]].assign(diverged=rows["diverged_at_s"].notna(), **setting.key)
            parts.append(part)
    return pd.concat(parts, ignore_index=True)


def constant_length(members: pd.DataFrame, outputs: Sequence[str] = OUTPUTS) -> pd.DataFrame:
    """Errors of mesh and step together, of every setting whose length and stiffness have a converged reference.

    Columns: those of ``Setting``, members, diverged (share), and for every output reference, ratio, low, high.
    """
    groups = dict(list(members.groupby(KEYS)))
    rows = []
    for key, part in groups.items():
        setting: dict[str, Any] = dict(zip(KEYS, key, strict=True))
        reference = converged(setting["carrier_length_m"], setting["contact_stiffness_n_per_m"])
        base = groups.get(tuple(reference.key.values()))
        row: dict[str, Any] = setting | {"members": len(part), "diverged": float(part["diverged"].astype(bool).mean())}
        if base is not None:
            rows.append(row | _compared(part, base, outputs))
    return pd.DataFrame(rows)


def insertion(
    members: pd.DataFrame,
    costs: pd.DataFrame,
    reference: Insertion = CONVERGED,
    bands: tuple[tuple[float, float], ...] = ((20.0, 40.0), (40.0, 60.0)),
) -> pd.DataFrame:
    """Errors of whole insertions in bands of length [m] beyond the silent 20 m, and ``cpu_s`` of one insertion.

    A member's value in a band is the root mean square (of an rms) or the mean over its stretches.
    """

    def pooled(values: pd.Series) -> float:
        return float(np.sqrt((values**2).mean())) if str(values.name).endswith("rms_m") else float(values.mean())

    rows, keys = [], list(reference.key)
    for low, high in bands:
        band = members[members["from_m"].between(low, high, inclusive="left")]
        of_member = band.groupby([*keys, "member"])[list(OUTPUTS)].agg(pooled).reset_index()
        chosen = _rows(of_member, reference.key)
        for key, part in of_member.groupby(keys):
            row = dict(zip(keys, key, strict=True)) | {"from_m": low, "to_m": high, "members": len(part)}
            rows.append(row | _compared(part, chosen))
    table = pd.DataFrame(rows)
    return table.assign(cpu_s=[insertion_cost(row, costs) for row in table.to_dict("records")])


def time_lapse(members: pd.DataFrame, costs: pd.DataFrame) -> pd.DataFrame:
    """Bias of time-lapse: ratios of insertions to ``NO_TIME_LAPSE``, in bands of 10 m.

    Columns as those of ``insertion``.
    """
    same = {name: value for name, value in NO_TIME_LAPSE.key.items() if name != "time_lapse"}
    bands = tuple((start, start + 10.0) for start in (20.0, 30.0, 40.0, 50.0))
    table = insertion(_rows(members, same), costs, NO_TIME_LAPSE, bands)
    return table[table["time_lapse"] > 1.0].reset_index(drop=True)


def _compared(part: pd.DataFrame, reference: pd.DataFrame, outputs: Sequence[str] = OUTPUTS) -> dict[str, float]:
    """For every output the mean of the reference, and ratio of means with interval."""
    row: dict[str, float] = {}
    for output in outputs:
        values, base = (frame[output].to_numpy(dtype=float) for frame in (part, reference))
        row[f"{output}:reference"] = float(np.nanmean(base)) if np.isfinite(base).any() else float("nan")
        interval = astuple(ratio_interval(values, base))
        row |= {f"{output}:{name}": value for name, value in zip(("ratio", "low", "high"), interval, strict=True)}
    return row


def _rows(table: pd.DataFrame, key: Row) -> pd.DataFrame:
    return table[(table[list(key)] == list(key.values())).all(axis=1)]


def bound(row: Row, output: str) -> float:
    """Largest error within the 95 % interval, relative to the mean of the reference, at least ``FLOORS``."""
    reference = abs(row[f"{output}:reference"])  # pressed on the wall, even a 99th percentile is negative
    relative = max(abs(row[f"{output}:low"] - 1.0), abs(row[f"{output}:high"] - 1.0))
    return float(relative * reference / max(reference, FLOORS[output]))


def measured_errors(constant: pd.DataFrame, inserted: pd.DataFrame) -> pd.DataFrame:
    """Table of ``probe_env.fidelity``: error ``bound`` of mesh and step, and cost, of every setting and output.

    Length NaN is an insertion (stiffness of table 2); cost is processor time per pitch and simulated second [s].
    """
    plain = (constant["walls"] == "both") & (constant["friction"] == 0.15)
    stable = constant["contact_stiffness_n_per_m"].isin(STIFFNESSES) & (constant["diverged"] == 0.0)
    at_length = constant[plain & stable].assign(time_lapse=1.0)
    at_length["cost_s"] = at_length["cpu_s"] / ((at_length["carrier_length_m"] + 2.5) / 0.1)
    whole = inserted.assign(carrier_length_m=np.nan, contact_stiffness_n_per_m=1e5)
    whole["cost_s"] = whole["cpu_s"] / PITCH_SECONDS
    keys = ["method", "time_step_s", "nodes_per_pitch", "time_lapse", "carrier_length_m", "contact_stiffness_n_per_m"]
    rows = [
        {name: row[name] for name in (*keys, "cost_s")} | {"output": output, "error": bound(row, output)}
        for row in (*at_length.to_dict("records"), *whole.to_dict("records"))
        for output in OUTPUTS
        if np.isfinite(row[f"{output}:ratio"])
    ]
    groups = pd.DataFrame(rows).groupby([*keys, "output"], dropna=False, as_index=False)
    return groups.agg({"error": "max", "cost_s": "mean"})


def choices(members: pd.DataFrame, costs: pd.DataFrame) -> pd.DataFrame:
    """Ratio of radial rms with each mesh and model choice to that of table 2, at 30 and 50 m.

    Columns choice, carrier_length_m, cost (relative to table 2's mesh), ratio, low, high.
    """
    rows = []
    for length in (30.0, 50.0):
        plain = Setting(time_step=MODEL_STEP, length=length)
        settings = [plain, *(replace(plain, **change) for change in CHOICES.values())]
        parts = [_rows(members, setting.key) for setting in settings]
        cpu = cpu_seconds(costs, pd.DataFrame([setting.key for setting in settings])).to_numpy()
        for choice, part, cost in zip(CHOICES, parts[1:], cpu[1:] / cpu[0], strict=True):
            compared = _compared(part, parts[0])
            rows.append((choice, length, cost, *(compared[name] for name in RADIAL)))
    return pd.DataFrame(rows, columns=["choice", "carrier_length_m", "cost", "ratio", "low", "high"])


def presets(constant: pd.DataFrame, costs: pd.DataFrame) -> pd.DataFrame:
    """Ratio of radial rms of every preset to the converged mesh at 30 and 50 m, and cost of an insertion.

    Columns preset, method, time_step_s, time_lapse, carrier_length_m, ratio, low, high, insertion_cpu_s.
    """
    rows = []
    for name, preset in PRESETS.items():
        method, step, lapse, nodes = preset.method_name, preset.time_step, preset.time_lapse, preset.nodes_per_pitch
        cost = insertion_cost(Insertion(method, step, lapse, nodes).key, costs)
        for length in (30.0, 50.0):
            for row in _rows(constant, Setting(method, step, nodes, length).key).to_dict("records"):
                rows.append((name, method, step, lapse, length, *(row[column] for column in RADIAL), cost))
    columns = ["preset", "method", "time_step_s", "time_lapse", "carrier_length_m", "ratio", "low", "high"]
    return pd.DataFrame(rows, columns=[*columns, "insertion_cpu_s"])


STUDY = CHECKOUT / "results" / "study"
"""Stored runs of the slow methods by the study ``claims``."""
PALETTE = ("#1f5fa8", "#7d3c98", "#c0392b", "#ec7aa5", "#d68910", "#1e8449", "#5dade2", "#7e5109", "#283747", "#a6acaf")
BANDED = "newmark (LAPACK)"
"""Method of stored rows: Newmark with LAPACK's banded solver, which was removed."""
COLOURS = dict(zip((*ON_NODES, BANDED, *(m for m in METHODS if m not in ON_NODES)), cycle(PALETTE), strict=False))
MARKERS = {4: "o", 8: "s", 16: "^"}
"""Nodes per pitch -> marker."""
PANELS = {"radial_rms_m": "radial rms", "radial_p99_m": "radial p99", "lift_off_share": "lift-off share"}
PANELS["axial_peak_hz"] = "axial peak frequency"


def run(output: Path, assumptions: str = "study", workers: Workers = HERE) -> None:
    """Run what is not stored in the output folder, then the timing; writes tables and figures.

    With ``assumptions="whole"`` the settings ``WHOLE`` alone, and the table of their errors.

    Raises:
        FileError: a stored file is damaged or of another commit; nothing was run.
    """
    ensembles = Store(output / "ensembles.csv", (*Setting().key, "member"))
    if assumptions == "whole":
        table = ensembles.fill({setting.last: setting for setting in WHOLE}, Setting.rows, "setting")
        files = write_tables(output, {"errors": constant_length(table, ("radial_rms_m", PEAK, "tension_mean_n"))}, 4)
        return write_manifest(output, ["ensembles.csv", *files], commits=table["commit"])
    insertions = Store(output / "insertions.csv", (*CONVERGED.key, "member", "from_m"))
    smooth = Store(output / "smooth.csv", SMOOTH_KEYS)
    ensembles.fill({setting.last: setting for setting in SETTINGS}, Setting.rows, "setting")
    insertions.fill({insertion.last: insertion for insertion in INSERTIONS}, Insertion.rows, "insertion")
    run_smooth(smooth)
    run_costs(output)
    draw_chart(output)


def draw_chart(output: Path) -> None:
    """Write tables and figures of the stored runs of a folder, and print the tables.

    measured_errors.csv is the table of ``fidelity="auto"``.
    """
    stored = {name: stored_rows(output / f"{name}.csv") for name in ("ensembles", "insertions", "smooth")}
    (ensembles, insertions, smooth), costs = stored.values(), read_csv(output / "costs.csv", COST_COLUMNS)
    slow = load_rows(STUDY)
    if slow.empty:
        warnings.warn(f"{STUDY} has no runs of the slow methods: the chart lacks them", stacklevel=2)
    else:
        ensembles = pd.concat([ensembles, study_members(slow)], ignore_index=True)
    constant, inserted = constant_length(ensembles), insertion(insertions, costs)
    constant = constant.assign(cpu_s=cpu_seconds(costs, constant))  # of a simulated second
    tables = {
        "errors": constant,
        "insertion-errors": inserted,
        "time-lapse-errors": time_lapse(insertions, costs),
        "orders": orders(smooth),
        "choices": choices(ensembles, costs),
        "presets": presets(constant, costs),
    }
    write_tables(output, tables | {"measured_errors": measured_errors(constant, inserted)}, 4)
    commits = pd.concat([table["commit"].dropna() for table in (smooth, ensembles, insertions)])
    write_manifest(output, [f"{name}.csv" for name in (*stored, "costs", *tables)], commits=commits)
    draw_smooth(smooth, output / "smooth.png")
    draw_chaos(constant, inserted, output / "chaos.png")
    print_frame("Order and error before chaos", tables["orders"], texts=2)
    print_frame("Radial rms by choice", tables["choices"])
    print_frame("Radial rms by preset", tables["presets"], texts=2)
    print_line(f"written: {output}/ ({', '.join(tables)} as .csv, smooth.png, chaos.png)")


def draw_smooth(table: pd.DataFrame, path: Path) -> None:
    """Error over processor time (above) and over sweeps (below), one column per scene; crosses: diverged."""
    names = ("linear", "step-load", "impact", "contact")
    figure, axes = plt.subplots(2, len(names), figsize=(15, 7.5), layout="constrained", sharey="col")
    for column, name in enumerate(names):
        rows = resolved(table, name)
        top = 3.0 * float(rows["error"].max())
        for axis, cost in zip(axes[:, column], ("cpu_s", "sweeps"), strict=True):
            for method, part in rows.groupby("method"):
                _curve(axis, part.sort_values("time_step_s"), cost, top, str(method))
            axis.set(xscale="log", yscale="log")
        axes[0, column].set_title(cases()[name].title, fontsize=10)
        axes[0, column].set_xlabel("processor time for a simulated second [s]")
        axes[1, column].set_xlabel("sweeps over the chain for a simulated second")
    for axis in axes[:, 0]:
        axis.set_ylabel("largest error over largest value")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    save(figure, path, dpi=100)


def _curve(axis: Axes, part: pd.DataFrame, cost: str, top: float, method: str) -> None:
    style: dict[str, Any] = {"color": COLOURS[method]}
    stable = part[part["error"].notna()]
    axis.plot(stable[cost], stable["error"], "o-", ms=4, linewidth=1.2, label=method, **style)
    failed = part[part["error"].isna()]
    if failed.empty:
        return
    # cost of a diverged run, extrapolated from the cost of a step
    rate = float((stable[cost] * stable["time_step_s"]).median()) if len(stable) else float("nan")
    axis.plot(rate / failed["time_step_s"], [top] * len(failed), "x", ms=6, clip_on=False, **style)


def draw_chaos(constant: pd.DataFrame, inserted: pd.DataFrame, path: Path) -> None:
    """Ratio of ensemble means to those of the converged mesh over cost: 30 m, 50 m, two bands of the insertion."""
    table2 = constant[(constant["contact_stiffness_n_per_m"] == 1e5) & constant["nodes_per_pitch"].isin(MARKERS)]
    table2 = table2[(table2["walls"] == "both") & (table2["friction"] == 0.15)]
    panels = {f"l = {length:g} m": table2[table2["carrier_length_m"] == length] for length in (30.0, 50.0)}
    bands = inserted.groupby(["from_m", "to_m"])
    panels |= {f"insertion, {low:g} to {high:g} m": part for (low, high), part in bands}
    shape = len(PANELS), len(panels)
    figure, axes = plt.subplots(*shape, figsize=(15, 11), layout="constrained", sharey="row", sharex="col")
    for column, (title, part) in enumerate(panels.items()):
        stable = part[part["radial_rms_m:ratio"].notna()]
        for axis, (output, label) in zip(axes[:, column], PANELS.items(), strict=True):
            axis.axhline(1.0, color=GREY, linewidth=0.8)
            for (name, mesh), rows in stable.groupby(["method", "nodes_per_pitch"]):
                nodes, ratio = int(str(mesh)), rows[f"{output}:ratio"]
                spread = np.abs([ratio - rows[f"{output}:low"], rows[f"{output}:high"] - ratio])
                style = {"fmt": MARKERS[nodes], "ms": 4, "capsize": 2, "linewidth": 1, "color": COLOURS[str(name)]}
                style["label"] = str(name) if nodes == 4 else f"{name}, {nodes} nodes per pitch"
                axis.errorbar(rows["cpu_s"], ratio, yerr=spread, **style)
            axis.set_xscale("log")
            if column == 0:
                axis.set_ylabel(f"{label}\nover converged mesh")
        for method, rows in part[part["radial_rms_m:ratio"].isna()].groupby("method"):
            style = {"ms": 7, "color": COLOURS[str(method)], "label": f"{method}, diverged"}
            axes[0, column].plot(rows["cpu_s"], [1.0] * len(rows), "x", **style)
        axes[0, column].set_title(title, fontsize=10)
        unit = "an insertion" if "insertion" in title else "a simulated second"
        axes[-1, column].set_xlabel(f"processor time for {unit} [s]")
    handles: dict[str, Any] = {}
    for axis in axes.ravel():
        handles |= dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
    figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=6, frameon=False)
    save(figure, path, dpi=90)
