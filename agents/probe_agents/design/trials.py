"""Trials of probe designs, and the search space and objectives of a search for designs."""

import hashlib
import json
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal, Self

import numpy as np

from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.policies.cases import TABLE_2, EvaluationCase, PlantLabel
from probe_agents.policies.catalogue import make_policy
from probe_agents.policies.fixed import Scheduled
from probe_agents.policies.on_map import min_air
from probe_agents.policies.policy import Policy
from probe_agents.records.result_folder import ResultFolder
from probe_env import Context, Design, Fidelity
from probe_env.arrays import FloatArray
from probe_env.design import RANGES, ranges_in
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.trials import (
    SENSOR_START,
    Candidate,
    Trial,
    check_candidate,
    check_measure,
    score_designs,
    segment_of,
    try_insertions,
    try_sections,
)
from probe_env.envs.vibration_map import VibrationMap, feeds
from probe_env.fidelity import resolve_fidelity
from probe_env.scene import Probe
from probe_env.schedule import Schedule
from probe_env.settings import errors_in

OBJECTIVES: Final = ("mean_square_ratio", "inspection_time_s", "drive_margin_n")
DIRECTIONS: Final[tuple[Literal["minimize", "maximize"], ...]] = ("minimize", "minimize", "maximize")
RMS_AT, PEAK_AT = "radial_rms_m_at_", "radial_peak_hz_at_"
"""Columns of rms and of the frequency of the highest peak over the sensor's position: the end is the position [m]."""
EULER_MARGIN: Final = "euler_margin"
"""Constraint, and the KPI that it is of."""
Values = tuple[float, float, float, float]
"""Objectives and Euler margin."""
IMPROVED: Final = Design(guide_length=10.0, guide_float_diameter=0.020, carrier_float_diameter=0.016)


def read_design(path: Path, probe: Probe) -> Design:
    """The design of a file; missing fields are those of the plant's probe. It must be buildable as it is."""
    with errors_in(path):
        design = Design.from_toml(path).completed(probe)
        design.check_whole_pitches()
    return design


def constant_schedule(feed_speed: float, air_supply_rate: float) -> Schedule:
    """The same feed speed [m/s] and air supply [m3/s] at every inserted length."""
    return Schedule("inserted_length", "linear", (5.0,), (feed_speed,), (air_supply_rate,))


@dataclass(frozen=True)
class DesignTrials:
    """Settings of trials: tubes, feed, task and fidelity.

    Attributes:
        contexts: tubes.
        feed: policy spec; for sections a schedule over inserted length.
        full: simulate whole insertions instead of sections of constant length.
        fidelity: simulation settings, resolved for the scene.
        config: task; designs and contexts replace parts of its scene.
        vibration: vibration map of policies; default: the shipped one.
        plant_label: name of the plant.
    """

    contexts: Sequence[Context]
    feed: str = "constant"
    full: bool = False
    fidelity: Fidelity = field(default_factory=Fidelity)
    config: TaskConfig = field(default_factory=lambda: TaskConfig().full_observation)
    vibration: VibrationMap | None = None
    plant_label: PlantLabel = TABLE_2

    @classmethod
    def of_case(cls, case: EvaluationCase, feed: str, full: bool, fidelity: str) -> Self:
        """Trials in the tubes of a case; ``fidelity`` is a preset, or "auto"."""
        config = case.config.full_observation
        chosen = resolve_fidelity(fidelity, config.scene, full)
        return cls(case.contexts, feed, full, chosen, config, case.vibration, case.plant_label)

    def check(self) -> None:
        """Raise ValueError if designs cannot be scored in the task, or the feed is not valid."""
        check_measure(self.config)
        segment_of(self.config)
        if self.full:
            self.policy()
        else:
            self.schedule()

    def policy(self) -> Policy:
        """Make the policy of ``feed``."""
        return make_policy(self.feed, self.config, self.vibration)

    def schedule(self) -> Schedule | None:
        """Make the schedule of ``feed``, which must be over inserted length; None for whole insertions."""
        if self.full:
            return None
        policy = self.policy()
        if self.feed == "constant":
            return constant_schedule(0.2, 63.0 / 3600.0)
        if not isinstance(policy, Scheduled) or policy.schedule.over != "inserted_length":
            raise ValueError(
                f"feed = {self.feed!r} is not a schedule over inserted length: use --full for policies and agents"
            )
        return policy.schedule

    def key(self, design: Design, context: Context, index: int = 0) -> str:
        """Identity of one result; the index of the context is the seed of its initial state."""
        parts = [index, design.built.model_dump(), context.model_dump(), self.policy().describe()]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]

    def folder(self, path: Path, **settings: Any) -> ResultFolder:
        """The folder of trials with these settings of all trials and further ones."""
        name, digest, _ = self.plant_label
        common = {"tube": {"name": name, "digest": digest}, "full": self.full, "fidelity": self.fidelity.model_dump()}
        identity = common | settings | {"task": self.config.model_dump(mode="json")}
        return ResultFolder(path, identity, "these trials were simulated")

    @property
    def setting(self) -> dict[str, Any]:
        """Settings for the manifest."""
        return {"feed": self.feed, "full": self.full, "fidelity": self.fidelity.model_dump()} | self.tube_column

    @property
    def tube_column(self) -> dict[str, str]:
        """Column of a table that names its plant; none for the tubes of table 2."""
        return {"tube": self.plant_label.title} if self.plant_label.title else {}

    def run(
        self,
        pairs: Sequence[tuple[Design, Context]],
        seeds: Sequence[int],
        threads: int | None = None,
        feed: Schedule | None = None,
    ) -> list[dict[str, float]]:
        """KPIs and reward of (design, tube) pairs, simulated in one batch; ``feed`` replaces the schedule."""
        candidates = [
            Candidate(design, context, feed or self.schedule() or self.policy(), seed)
            for (design, context), seed in zip(pairs, seeds, strict=True)
        ]
        simulate = try_insertions if self.full else try_sections
        trial = simulate(candidates, self.config, self.fidelity, threads=threads)
        terms, kpis = score_designs([design for design, _ in pairs], trial, self.config)
        kpis = {"reward": np.sum(list(terms.values()), axis=0)} | kpis | self._vibration_at_positions(trial)
        rows = [{name: float(values[k]) for name, values in kpis.items()} for k in range(len(pairs))]
        return [{name: value for name, value in row.items() if not math.isnan(value)} for row in rows]

    def _vibration_at_positions(self, trial: Trial) -> dict[str, FloatArray]:
        """Columns ``RMS_AT`` and ``PEAK_AT`` (n,) of each position, NaN where the probe did not arrive."""
        positions = np.array(segment_of(self.config).positions)
        middles = SENSOR_START + np.arange(trial.widths.shape[1]) + 0.5 if self.full else positions
        nearest = np.abs(middles[:, None] - positions).argmin(axis=1)
        columns = {}
        for k, position in enumerate(positions.tolist()):
            width = np.where(nearest == k, trial.widths, 0.0)
            total = width.sum(axis=1)
            square = (width * trial.radial_rms**2).sum(axis=1)
            columns[f"{RMS_AT}{position:.4g}"] = np.where(
                total > 0.0, np.sqrt(square / np.maximum(total, 1e-9)), np.nan
            )
            if trial.frequency is not None:
                columns[f"{PEAK_AT}{position:.4g}"] = np.where(total > 0.0, trial.frequency[:, k], np.nan)
        return columns


@dataclass(frozen=True)
class DesignProblem(DesignTrials):
    """Search space and objectives; every design is simulated in all contexts.

    ``feed``: "best-constant" searches feed speed and air together with the probe; else a schedule, or with ``full`` any
    policy. ``min_euler_margin``: constraint, see docs/designs.md.
    """

    feed: str = "best-constant"
    min_euler_margin: float = 4.0

    def check(self) -> None:
        """Raise ValueError as for trials, or if no reference probe can be simulated in the tubes."""
        if self.full and self.feed == "best-constant":
            raise ValueError("feed = 'best-constant' needs sections; with --full give a schedule or an agent")
        super().check()
        if not any(self.can_be_tried(start, context) for start in self.starts() for context in self.contexts):
            probes = ", ".join(self.probes)
            raise ValueError(f"tube = {self.plant_label.name}: {probes} can be simulated in none of its tubes")

    @property
    def axes(self) -> dict[str, tuple[float, float, str]]:
        """Name -> lowest, highest, unit of each variable, within the bore and the ranges of the task."""
        probe, config = ranges_in(self.config.scene), self.config
        if self.feed != "best-constant":
            return probe
        air = (min_air(config), config.air_supply_rates[1], "m3/s")
        return probe | {"feed_speed": (*feeds(config), "m/s"), "air_supply_rate": air}

    @property
    def cuts(self) -> tuple[str, ...]:
        """Messages about parts of the design space that do not fit the plant and are not searched."""
        return tuple(
            f"{name} is searched from {low:g} to {high:g} {unit}, not from {RANGES[name][0]:g} to {RANGES[name][1]:g}"
            f" {unit}: the rest does not fit the bore and the cable of {self.plant_label.name}"
            for name, (low, high, unit) in ranges_in(self.config.scene).items()
            if (low, high, unit) != RANGES[name]
        )

    @property
    def probes(self) -> dict[str, Design]:
        """Reference probes of a search: the plant's (or the study's original) and the study's improved one."""
        probe = Design()
        with suppress(ValueError):  # a longer guide
            own = Design().completed(self.config.scene.probe)
            probe = Design() if own.deviations else own
        first = "the study's original" if probe == Design() else "the plant's own"
        designs = {first: probe, "the study's improved": IMPROVED}
        return {name: design.cut_to(self.config.scene) for name, design in designs.items()}

    def starts(self) -> list[dict[str, float]]:
        """First points: the reference probes, at several feeds if the feed is searched."""
        return [probe.model_dump() | feed for probe in self.probes.values() for feed in self.reference_feeds()]

    def reference_feeds(self) -> list[dict[str, float]]:
        """Feeds of the reference probes, clipped to the ranges of the task."""
        if self.feed != "best-constant":
            return [{}]
        (slow, fast, _), (minimum, maximum, _) = (self.axes[name] for name in ("feed_speed", "air_supply_rate"))
        pairs = ((u, q / 3600.0) for u in (0.08, 0.12, 0.2, 0.3) for q in (63.0, 110.0))
        clipped = dict.fromkeys((min(max(u, slow), fast), min(max(q, minimum), maximum)) for u, q in pairs)
        return [{"feed_speed": u, "air_supply_rate": q} for u, q in clipped]

    def search_folder(self, path: Path, seed: int) -> ResultFolder:
        """The folder of a search for this problem."""
        feed = self.feed if self.feed == "best-constant" else self.policy().describe()
        tubes = [context.model_dump() for context in self.contexts]
        return self.folder(path, feed=feed, seed=seed, variables=self.axes, tubes=tubes, least=self.min_euler_margin)

    def value(self, point: dict[str, float], workers: Workers = HERE) -> Values:
        """The objectives: means over the tubes, and the smallest drive margin; and the smallest Euler margin.

        Length that a probe does not inspect, after lost drive, divergence, or if it cannot be simulated in a tube (see
        ``probe_env.envs.episodes.limits``), has the cap of the ratio and the slowest feed.
        """
        tubes = list(enumerate(self.contexts))
        if workers.here:
            kpis = self.kpis(point, tubes)
        else:
            portions = [tubes[k :: workers.jobs] for k in range(min(workers.jobs, len(tubes)))]
            kpis = [row for _, rows in workers.map(partial(self.kpis, point, threads=1), portions) for row in rows]
        kpis.sort(key=lambda row: row["tube"])  # so that sums do not depend on the order of the workers
        slowest, cap = 1.0 / self.config.feed_speeds[0], self.config.ratio_cap**2
        span = segment_of(self.config).span
        squares = [(k["mean_square_ratio"] * (span - k["missed_m"]) + cap * k["missed_m"]) / span for k in kpis]
        times = [k["inspection_time_s"] + slowest * k["missed_m"] for k in kpis]
        drive, euler = (min(k[name] for k in kpis) for name in ("drive_margin_n", EULER_MARGIN))
        return float(np.mean(squares)), float(np.mean(times)), drive, euler

    def kpis(
        self, point: dict[str, float], tubes: Sequence[tuple[int, Context]], threads: int | None = None
    ) -> list[dict[str, float]]:
        """KPIs of a point in some tubes, (index, tube) each."""
        design, feed = self._probe(point)
        fit = {k: (design, context) for k, context in tubes if self.can_be_tried(point, context)}
        rows = dict(zip(fit, self.run([*fit.values()], [*fit], threads, feed) if fit else [], strict=True))
        nothing = {"mean_square_ratio": 0.0, "inspection_time_s": 0.0, "missed_m": segment_of(self.config).span}
        nothing[EULER_MARGIN] = 0.0
        nothing["drive_margin_n"] = -self.config.required_tension
        return [rows.get(k, nothing) | {"tube": float(k)} for k, _ in tubes]

    def _probe(self, point: dict[str, float]) -> tuple[Design, Schedule | None]:
        """The probe of a point, and its feed if the feed is searched."""
        searched = self.feed == "best-constant"
        feed = constant_schedule(point["feed_speed"], point["air_supply_rate"]) if searched else None
        return Design(**{name: point[name] for name in RANGES}), feed

    def can_be_tried(self, point: dict[str, float], context: Context) -> bool:
        """Whether a probe can be simulated in a tube; always true in table 2."""
        if self.plant_label == TABLE_2:
            return True
        design, feed = self._probe(point)
        schedule = feed or self.schedule()
        with suppress(ValueError):
            check_candidate(design, context, self.config, self.fidelity, schedule)
            return True
        return False
