"""What a search for probes varies and how it judges a point: the mean over tubes of the task's figures."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Final

import numpy as np

from agents.design.compare import CODE, Comparison
from agents.policies.catalogue import make_policy
from agents.policies.maps.lookup import LEAST_AIR
from agents.policies.maps.vibration_map import FEEDS
from agents.processes.workers import HERE, Workers
from agents.records.code_hash import code_hash
from probe_env import Context, Design
from probe_env.design import RANGES
from probe_env.envs.contexts import spread_contexts
from probe_env.envs.task import TaskConfig
from probe_env.envs.trials import SPAN, Candidate, judge, try_sections
from probe_env.fidelity import Fidelity, resolve_fidelity
from probe_env.schedule import Schedule

OBJECTIVES: Final = ("mean_square_ratio", "inspection_time_s", "drive_margin_n")
DIRECTIONS: Final = ("minimize", "minimize", "maximize")
FEED_AXES: Final = {"feed_speed": (*FEEDS, "m/s"), "air_supply_rate": (LEAST_AIR, 130.0 / 3600.0, "m3/s")}
Values = tuple[float, float, float]
STUDY_PROBES: Final = {
    "the study's original": Design(),
    "the study's improved": Design(guide_length=10.0, guide_float_diameter=0.020, carrier_float_diameter=0.016),
}


@dataclass(frozen=True)
class DesignProblem:
    """What is searched and how a point is judged.

    Attributes:
        contexts: tubes that every design is tried in.
        feed: "best-constant": feed speed and air are searched together with the probe; else the spec of a schedule,
            or with ``full`` of an agent.
        full: whole insertions.
        fidelity: of the simulation; time-lapse counts in whole insertions only.
    """

    contexts: tuple[Context, ...]
    feed: str = "best-constant"
    full: bool = False
    fidelity: Fidelity = field(default_factory=Fidelity)
    config: TaskConfig = field(default_factory=lambda: TaskConfig().all_shown)

    @property
    def axes(self) -> dict[str, tuple[float, float, str]]:
        """Name -> lowest, highest, unit of everything that is searched."""
        return RANGES | (FEED_AXES if self.feed == "best-constant" else {})

    def starts(self) -> list[dict[str, float]]:
        """The study's two probes, at several feeds where feed is searched: what a search is to beat."""
        return [probe.model_dump() | feed for probe in STUDY_PROBES.values() for feed in self.reference_feeds()]

    def reference_feeds(self) -> list[dict[str, float]]:
        """Feeds that the study's probes are tried at."""
        if self.feed != "best-constant":
            return [{}]
        return [{"feed_speed": u, "air_supply_rate": q / 3600.0} for u in (0.08, 0.12, 0.2, 0.3) for q in (63.0, 110.0)]

    def identity(self) -> str:
        """Short hash of all that the objectives depend on: trials of another problem must not be mixed in.

        Raises:
            ValueError: the feed is no policy.
        """
        feed = None if self.feed == "best-constant" else make_policy(self.feed, self.config).describe()
        tubes = [context.model_dump() for context in self.contexts]
        parts = [
            self.axes, tubes, feed, self.full, self.fidelity.model_dump(), self.config.model_dump(mode="json"),
            code_hash(CODE, self.fidelity.method),
        ]  # fmt: skip
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:12]

    def value(self, point: dict[str, float], workers: Workers = HERE) -> Values:
        """The objectives: mean over the tubes, but the least drive margin; lost drive and divergence count in full.

        What a probe does not get to has the ratio's cap and the slowest time.
        """
        everywhere = list(enumerate(self.contexts))
        if workers.here:
            kpis = self.kpis(point, everywhere)
        else:
            portions = [everywhere[k :: workers.jobs] for k in range(min(workers.jobs, len(everywhere)))]
            kpis = [row for _, rows in workers.map(partial(self.kpis, point, threads=1), portions) for row in rows]
        kpis.sort(key=lambda row: row["place"])  # sums do not depend on who was first
        slowest, cap = 1.0 / self.config.feed_speeds[0], self.config.ratio_cap**2
        squares = [(k["mean_square_ratio"] * (SPAN - k["missed_m"]) + cap * k["missed_m"]) / SPAN for k in kpis]
        times = [k["inspection_time_s"] + slowest * k["missed_m"] for k in kpis]
        return float(np.mean(squares)), float(np.mean(times)), min(k["drive_margin_n"] for k in kpis)

    def kpis(
        self, point: dict[str, float], tubes: Sequence[tuple[int, Context]], threads: int | None = None
    ) -> list[dict[str, float]]:
        """KPIs of a point in some of the tubes, given with their places."""
        design = Design(**{name: point[name] for name in RANGES})
        seeds, contexts = [place for place, _ in tubes], [context for _, context in tubes]
        if self.feed == "best-constant":
            feed = Schedule("inserted_length", "linear", (5.0,), (point["feed_speed"],), (point["air_supply_rate"],))
            candidates = [Candidate(design, context, feed, place) for place, context in tubes]
            trial = try_sections(candidates, self.config, self.fidelity, threads=threads)
            _, figures = judge([design] * len(tubes), trial, self.config)
            rows = [{name: float(values[k]) for name, values in figures.items()} for k in range(len(tubes))]
        else:
            comparison = Comparison({"": design}, contexts, self.feed, self.full, self.fidelity, self.config)
            rows = comparison.run([(design, context) for context in contexts], seeds, threads)
        return [row | {"place": float(place)} for row, place in zip(rows, seeds, strict=True)]


def design_problem(feed: str, full: bool, contexts: int, fidelity: str) -> DesignProblem:
    """The problem that a command names, on training tubes.

    Args:
        feed: "best-constant", a schedule, or with ``full`` any policy.
        full: whole insertions.
        contexts: so many tubes, the first of the training list.
        fidelity: preset, or "auto".

    Raises:
        ValueError: an argument is not valid, or the feed does not fit.
    """
    if full and feed == "best-constant":
        raise ValueError("feed = 'best-constant' is searched in sections; with full give a schedule or an agent")
    if contexts < 1:
        raise ValueError(f"contexts = {contexts!r} is outside the accepted range 1 and more")
    chosen = spread_contexts("train", contexts)
    if feed != "best-constant" and not full:
        Comparison({}, chosen, feed).schedule()
    return DesignProblem(chosen, feed, full, resolve_fidelity(fidelity))
