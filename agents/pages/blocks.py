"""What the README and docs say of the stored results: a maker a block, named after it."""

from __future__ import annotations

from collections.abc import Callable

from agents.pages import control, designs, headroom, passes, plant, plc, simulator, trained
from agents.pages.signal import along, detection, hearing
from agents.pages.sources import RESULTS

__all__ = ["MAKERS", "RESULTS"]

MAKERS: dict[str, Callable[[], str]] = {
    maker.__name__: maker
    for maker in (
        control.agents, control.any_probe, control.evaluation, control.fidelity, control.headline,
        control.map_quality, control.tradeoff, control.tradeoff_found,
        headroom.headroom, headroom.headroom_finely, headroom.planner_settings, headroom.world,
        plc.plc_constants, plc.plc_finely, plc.plc_fresh, plc.plc_reached, plc.plc_text, plc.trim,
        detection.anchors, detection.as_seen, detection.false_calls, detection.snr, detection.snr_agent,
        along.hearing_along, along.steady_along, hearing.hearing, hearing.hearing_fresh, hearing.hearing_steady,
        hearing.replays,
        passes.feed_changes, passes.passes, passes.passes_acting, passes.passes_search, passes.turning,
        plant.answers, plant.calibrations, plant.plants, plant.recommendations,
        designs.codesign, designs.designs, designs.search, plant.robustness,
        trained.scratch, trained.student, trained.student_finely, trained.student_fresh,
        trained.student_scheme,
        simulator.back, simulator.bench, simulator.choices, simulator.energy, simulator.environments,
        simulator.idle_cable, simulator.other_probes, simulator.outputs, simulator.peers, simulator.presets,
        simulator.root, simulator.scaling, simulator.smooth, simulator.stability,
        simulator.study, simulator.superelement, simulator.timelapse,
        simulator.lost_insertions, simulator.pressed_scenes,
    )
}  # fmt: skip
