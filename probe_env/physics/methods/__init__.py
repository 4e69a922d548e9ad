"""Methods that advance a chain in time; ``METHODS`` lists them all."""

from __future__ import annotations

from typing import Final

from probe_env.physics.methods import banded, transfer_matrix
from probe_env.physics.methods.explicit import EXPLICIT
from probe_env.physics.methods.imex import IMEX, IMEX32
from probe_env.physics.methods.implicit import IMPLICIT
from probe_env.physics.methods.method import Method
from probe_env.physics.methods.newmark import NEWMARK, WILSON, Solver
from probe_env.physics.methods.superelement import SUPERELEMENT, SUPERELEMENT32

METHODS: Final = {m.name: m for m in (NEWMARK, WILSON, IMEX, IMEX32, IMPLICIT, EXPLICIT, SUPERELEMENT, SUPERELEMENT32)}
ON_NODES: Final = {name: method for name, method in METHODS.items() if method.start is None}
"""Those whose mesh has ``nodes_per_pitch`` nodes: on the same mesh they have the same solution."""
SOLVERS: Final[dict[str, Solver | None]] = {
    "ticm": None, "banded": banded.stepper, "transfer-matrix": transfer_matrix.stepper
}  # fmt: skip
"""Solvers of the linear system of Newmark and Wilson; None: the method's own."""


def method_named(name: str) -> Method:
    """A method by its name.

    Raises:
        ValueError: there is none.
    """
    if name not in METHODS:
        raise ValueError(f"method = {name!r} is not one of {', '.join(METHODS)}")
    return METHODS[name]


def solver_named(name: str) -> Solver | None:
    """A solver by its name; None is the method's own.

    Raises:
        ValueError: there is none.
    """
    if name not in SOLVERS:
        raise ValueError(f"solver = {name!r} is not one of {', '.join(SOLVERS)}")
    return SOLVERS[name]
