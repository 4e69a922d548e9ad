"""The TICM recursion (17)-(29), and the study's scheme stepped with it.

A chain, a state and a step's inputs enter, the state after the step leaves. ``implicit`` builds on its parts too.
Imports the inputs of a step only.
"""

from probe_env.physics.methods.ticm.after_step import DIVERGED, OK, move_root, record
from probe_env.physics.methods.ticm.equations import apply_solution, node_equations
from probe_env.physics.methods.ticm.sweep import advance, ticm_step

__all__ = ["DIVERGED", "OK", "advance", "apply_solution", "move_root", "node_equations", "record", "ticm_step"]
