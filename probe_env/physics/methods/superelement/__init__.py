"""The superelement methods: pieces of cable condensed to their floats and a few modes."""

from __future__ import annotations

from functools import partial

import numpy as np

from probe_env.physics.methods.method import lane_method
from probe_env.physics.methods.stability import TABLE_2_DAMPING
from probe_env.physics.methods.superelement.group import MEMORY, PieceKernel, released
from probe_env.physics.methods.superelement.kernel import superelement_advance
from probe_env.physics.methods.superelement.single_probe import superelement_advance_single
from probe_env.physics.methods.superelement.tables import longest_step
from probe_env.physics.model.chain import build_chain
from probe_env.scene import Scene

STABLE, UNSTABLE = 1.65, 1.8
"""Omega dt of a float on its contact spring: up to which runs held (96 random probes and tubes of 10 to 50 m among
them), and from which they diverge."""
LONGEST_STEP = 5e-4
"""[s] Soft contact would allow more; at 1e-3 s runs of 1e4 N/m diverge."""


def superelement_step(scene: Scene, nodes_per_pitch: int) -> float:
    """Largest step [s] known to hold; 0 where none is known: a cable with less damping than in the study's ensemble."""
    damped = scene.probe.damping_time >= TABLE_2_DAMPING
    step = longest_step(build_chain(scene, nodes_per_pitch), nodes_per_pitch, STABLE)
    return min(step, LONGEST_STEP) if damped else 0.0


def superelement_contact_step(scene: Scene, nodes_per_pitch: int) -> float:
    """Largest step [s] that explicit contact allows."""
    return longest_step(build_chain(scene, nodes_per_pitch), nodes_per_pitch, UNSTABLE)


_kernel = partial(PieceKernel, superelement_advance, None, single=superelement_advance_single)
_named = partial(
    lane_method, order=2, usual_step=2e-4, stable_step=superelement_step, contact_step=superelement_contact_step,
    memory=MEMORY, start=released, draws_back=False,
)  # fmt: skip
SUPERELEMENT = _named("superelement", _kernel(np.float64, alone_share=0.5))
SUPERELEMENT32 = _named("superelement32", _kernel(np.float32, alone_share=0.33), least_step=5e-5)
