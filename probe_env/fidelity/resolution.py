"""The settings that a name stands for in a scene: of a preset, or of "auto"; with nodes where the scene needs some."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final

from probe_env.fidelity.choice import LOGGER, TOLERANCE, choose_fidelity
from probe_env.fidelity.settings import BOTH_WAYS, PRESETS, Fidelity, in_words
from probe_env.physics.methods import METHODS, ON_NODES
from probe_env.scene import Scene
from probe_env.settings import in_one_line

AUTO: Final = re.compile(r"auto(?::(?P<tolerance>[^:]+))?")
ON_MESH: Final = {"superelement": "imex", "superelement32": "imex32"}
"""What takes the place of superelements where the cable is more than elastic between floats, in the same precision."""
MESH_NODES, MESH_STEP = 8, 1.25e-4
"""Nodes a pitch, and longest step [s] there: all scenes drawn under pressure hold on them (simulation/return.md)."""


def resolve_fidelity(
    fidelity: str | Fidelity | Mapping[str, Any],
    scene: Scene | None = None,
    growing: bool = True,
    both_ways: bool = False,
) -> Fidelity:
    """A preset by name, settings of one's own, or "auto" or "auto:TOLERANCE".

    Args:
        fidelity: name, settings, or a mapping of them.
        scene: that is simulated; default: table 2's. "auto" chooses for it, and superelements give way to nodes where
            it needs them, see ``with_nodes``.
        growing: whether the probe is fed in, for "auto".
        both_ways: whether it is drawn back, too.

    Raises:
        ValueError: no such preset, settings that are not valid, a tolerance that nothing measured keeps, or a method
            that does not simulate the way back.
    """
    if both_ways:
        return _both_ways(fidelity)
    scene = scene or Scene()
    return with_nodes(_named(fidelity, scene, growing), scene)


def with_nodes(fidelity: Fidelity, scene: Scene) -> Fidelity:
    """The settings, with nodes between the floats if the scene needs some and they have none; says so, once.

    Between floats, a superelement's cable bends and stretches, no more: where it meets the walls itself, or its couple
    counts from the tangent, the method of ``ON_MESH`` is taken with ``MESH_NODES`` a pitch, at the same time-lapse and
    the same step, or ``MESH_STEP``.
    """
    if fidelity.method in ON_NODES or not _needs_nodes(scene):
        return fidelity
    taken = fidelity.model_copy(
        update={
            "method": ON_MESH[fidelity.method], "nodes_per_pitch": MESH_NODES,
            "time_step": min(fidelity.time_step, MESH_STEP),
        }
    )  # fmt: skip
    _say_nodes(fidelity.method, in_words(taken))
    return taken


def _needs_nodes(scene: Scene) -> bool:
    return scene.contact.cable or scene.couple == "tangent"


@lru_cache
def _say_nodes(method: str, taken: str) -> None:
    LOGGER.warning(
        "fidelity: %s has no nodes between floats, which contact.cable and couple = 'tangent' ask for: %s is taken",
        method, taken,
    )  # fmt: skip


def _named(fidelity: str | Fidelity | Mapping[str, Any], scene: Scene, growing: bool) -> Fidelity:
    """``resolve_fidelity`` for the way in, whatever the scene needs."""
    if isinstance(fidelity, Fidelity):
        return fidelity
    if not isinstance(fidelity, str):
        with in_one_line():
            return Fidelity.model_validate(dict(fidelity))
    if fidelity in PRESETS:
        return PRESETS[fidelity]
    auto = AUTO.fullmatch(fidelity)
    if auto is None:
        known = ", ".join((*PRESETS, "auto", "auto:TOLERANCE"))
        raise ValueError(f"fidelity = {fidelity!r} is not one of {known}, nor a mapping of settings")
    try:
        tolerance = float(auto["tolerance"] or TOLERANCE)
    except ValueError:
        raise ValueError(
            f"fidelity = {fidelity!r}: {auto['tolerance']!r} is not a number; a tolerance is a relative error, such as"
            f" auto:{TOLERANCE:g}"
        ) from None
    return choose_fidelity(scene, tolerance, growing=growing).fidelity


def _both_ways(fidelity: str | Fidelity | Mapping[str, Any]) -> Fidelity:
    """``resolve_fidelity`` for a probe that is drawn back."""
    if isinstance(fidelity, str) and fidelity in BOTH_WAYS:
        return BOTH_WAYS[fidelity]
    known = ", ".join((*BOTH_WAYS, "study"))
    if isinstance(fidelity, str) and AUTO.fullmatch(fidelity):
        raise ValueError(f"fidelity = {fidelity!r}: nothing was measured on the way back; give one of {known}")
    chosen = _named(fidelity, Scene(), growing=True)
    if not METHODS[chosen.method].draws_back:
        raise ValueError(
            f"fidelity = {fidelity!r}: {chosen.method} does not simulate the way back; give one of {known}, or settings"
            f" with one of {', '.join(name for name, method in METHODS.items() if method.draws_back)}"
        )
    return chosen
