"""Design problem: search space of probes, and the objectives of a point over tubes."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, Literal

import numpy as np

from probe_agents.design.trials import DesignTrials
from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.policies.cases import TABLE_2, EvaluationCase
from probe_agents.policies.on_map import least_air
from probe_agents.records.result_folder import ResultFolder
from probe_env import Context, Design
from probe_env.design import RANGES, ranges_in
from probe_env.envs.trials import check_candidate, check_measure, segment_of
from probe_env.envs.vibration_map import feeds
from probe_env.fidelity import resolve_fidelity
from probe_env.schedule import Schedule

OBJECTIVES: Final = ("mean_square_ratio", "inspection_time_s", "drive_margin_n")
DIRECTIONS: Final[tuple[Literal["minimize", "maximize"], ...]] = ("minimize", "minimize", "maximize")
Values = tuple[float, float, float]
IMPROVED: Final = Design(guide_length=10.0, guide_float_diameter=0.020, carrier_float_diameter=0.016)


@dataclass(frozen=True)
class DesignProblem(DesignTrials):
    """Search space and objectives; every design is simulated in all contexts.

    ``feed``: "best-constant" searches feed speed and air together with the probe; else a schedule, or with ``full`` any
    policy.
    """

    feed: str = "best-constant"

    @property
    def axes(self) -> dict[str, tuple[float, float, str]]:
        """Name -> lowest, highest, unit of each variable, within the bore and the ranges of the task."""
        probe, config = ranges_in(self.config.scene), self.config
        if self.feed != "best-constant":
            return probe
        air = (least_air(config), config.air_supply_rates[1], "m3/s")
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
        try:
            probe = Design().completed(self.config.scene.probe)
        except ValueError:  # outside the design space
            probe = Design()
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
        (slow, fast, _), (least, most, _) = (self.axes[name] for name in ("feed_speed", "air_supply_rate"))
        pairs = ((u, q / 3600.0) for u in (0.08, 0.12, 0.2, 0.3) for q in (63.0, 110.0))
        clipped = dict.fromkeys((min(max(u, slow), fast), min(max(q, least), most)) for u, q in pairs)
        return [{"feed_speed": u, "air_supply_rate": q} for u, q in clipped]

    def search_folder(self, path: Path, seed: int) -> ResultFolder:
        """The folder of a search for this problem."""
        feed = self.feed if self.feed == "best-constant" else self.policy().describe()
        tubes = [context.model_dump() for context in self.contexts]
        return self.folder(path, feed=feed, seed=seed, variables=self.axes, tubes=tubes)

    def value(self, point: dict[str, float], workers: Workers = HERE) -> Values:
        """The objectives: means over the tubes, and the smallest drive margin.

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
        return float(np.mean(squares)), float(np.mean(times)), min(k["drive_margin_n"] for k in kpis)

    def kpis(
        self, point: dict[str, float], tubes: Sequence[tuple[int, Context]], threads: int | None = None
    ) -> list[dict[str, float]]:
        """KPIs of a point in some tubes, (index, tube) each."""
        design, feed = self._probe(point)
        fit = {k: (design, context) for k, context in tubes if self.can_be_tried(point, context)}
        rows = dict(zip(fit, self.run([*fit.values()], [*fit], threads, feed) if fit else [], strict=True))
        nothing = {"mean_square_ratio": 0.0, "inspection_time_s": 0.0, "missed_m": segment_of(self.config).span}
        nothing["drive_margin_n"] = -self.config.required_tension
        return [rows.get(k, nothing) | {"tube": float(k)} for k, _ in tubes]

    def _probe(self, point: dict[str, float]) -> tuple[Design, Schedule | None]:
        """The probe of a point, and its feed if the feed is searched."""
        design = Design(**{name: point[name] for name in RANGES})
        if self.feed != "best-constant":
            return design, None
        feed, air = (point["feed_speed"],), (point["air_supply_rate"],)
        return design, Schedule("inserted_length", "linear", (5.0,), feed, air)

    def can_be_tried(self, point: dict[str, float], context: Context) -> bool:
        """Whether a probe can be simulated in a tube; always true in table 2."""
        if self.plant_label == TABLE_2:
            return True
        design, feed = self._probe(point)
        schedule = feed or (None if self.full else self.schedule())
        with suppress(ValueError):
            check_candidate(design, context, self.config, self.fidelity, schedule)
            return True
        return False


def design_problem(feed: str, full: bool, case: EvaluationCase, fidelity: str) -> DesignProblem:
    """Make the problem of the command ``design``.

    Args:
        feed: "best-constant", a schedule, or with ``full`` any policy.
        full: simulate whole insertions.
        case: task and tubes.
        fidelity: preset, or "auto".
    """
    if full and feed == "best-constant":
        raise ValueError("feed = 'best-constant' needs sections; with --full give a schedule or an agent")
    config = case.config.full_observation
    chosen = resolve_fidelity(fidelity, config.scene, full)
    problem = DesignProblem(case.contexts, feed, full, chosen, config, case.vibration, case.plant_label)
    check_measure(config)
    segment_of(config)
    if feed != "best-constant" and not full:
        problem.schedule()
    if not any(problem.can_be_tried(start, context) for start in problem.starts() for context in problem.contexts):
        probes = ", ".join(problem.probes)
        raise ValueError(f"tube = {problem.plant_label.name}: {probes} can be simulated in none of its tubes")
    return problem
