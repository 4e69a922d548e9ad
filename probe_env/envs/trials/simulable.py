"""Whether a probe can be tried in a tube at all, asked before anything is simulated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from probe_env.design import RANGES, Design
from probe_env.envs.contexts import Context
from probe_env.envs.episodes.limits import check_simulable
from probe_env.envs.episodes.starts import Starts, settling
from probe_env.envs.task import TaskConfig
from probe_env.envs.trials.sections import sections_of
from probe_env.fidelity import Fidelity
from probe_env.schedule import Schedule


def _corner(*high: str) -> Design:
    return Design.from_unit([1.0 if name in high else 0.0 for name in RANGES])


HARDEST: Final = (
    _corner("tensile_rigidity", "flexural_rigidity"),
    _corner("guide_length", "guide_float_diameter", "carrier_float_diameter"),
)
"""The stiff, light design that asks for the shortest step and the hardest wall; the one that drag stretches most."""


def check_space(
    contexts: Sequence[Context], config: TaskConfig, fidelity: Fidelity, feed: Schedule | None = None
) -> None:
    """Raise ValueError if not all of the design space, cut to the bore, can be tried in these tubes.

    Args:
        contexts: the tubes.
        config: the task.
        fidelity: of the simulation.
        feed: for sections of constant length; None: whole insertions.
    """
    for design in HARDEST:
        for context in contexts:
            check_candidate(design.cut_to(config.scene), context, config, fidelity, feed)


def check_candidate(
    design: Design, context: Context, config: TaskConfig, fidelity: Fidelity, feed: Schedule | None = None
) -> None:
    """Raise ValueError if a design does not fit a tube, or cannot be simulated in it; arguments as ``check_space``."""
    if feed is None:
        starts = Starts(config, (context,), "scene", *settling(config, {}))
        scene = starts.build(context, {"probe": design.built.model_dump()})
        check_simulable(scene, fidelity, scene.tube.helix_length, config.air_supply_rates[1])
    else:
        for start, air in sections_of(design, context, feed, config):
            check_simulable(start, fidelity, start.inserted_length, air)
