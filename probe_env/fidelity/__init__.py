"""How closely an environment simulates: a name and a scene enter, method, step, mesh and time-lapse leave.

From the bottom: settings and their presets; the choice that "auto" makes by measured errors; what a name stands for in
a scene. Imports the physics and the scene.
"""

from probe_env.fidelity.choice import MOST_TIME_LAPSE, Choice, choose_fidelity, measured, outputs
from probe_env.fidelity.resolution import MESH_NODES, resolve_fidelity, with_nodes
from probe_env.fidelity.settings import BOTH_WAYS, PRESETS, Fidelity, lapse_in_words

__all__ = [
    "BOTH_WAYS", "MESH_NODES", "MOST_TIME_LAPSE", "PRESETS", "Choice", "Fidelity", "choose_fidelity",
    "lapse_in_words", "measured", "outputs", "resolve_fidelity", "with_nodes",
]  # fmt: skip
