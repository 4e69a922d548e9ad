"""Methods that advance a chain in time; ``METHODS`` lists them all."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from probe_env.physics.methods import banded, transfer_matrix
from probe_env.physics.methods.explicit import Explicit
from probe_env.physics.methods.imex import Imex, Imex32
from probe_env.physics.methods.implicit import Implicit
from probe_env.physics.methods.method import Method
from probe_env.physics.methods.newmark import Newmark, Solver, Wilson
from probe_env.physics.methods.superelement.group import Superelement, Superelement32

METHODS: Final[dict[str, Method]] = {
    method.name: method
    for method in (
        Newmark(), Wilson(), Imex(), Imex32(), Implicit(), Explicit(), Superelement(), Superelement32()
    )
}  # fmt: skip
ON_NODES: Final = {name: method for name, method in METHODS.items() if method.on_nodes}
SOLVERS: Final[dict[str, Solver | None]] = {
    "ticm": None, "banded": banded.stepper, "transfer-matrix": transfer_matrix.stepper
}  # fmt: skip
"""Solvers of the linear system of Newmark and Wilson; None: the method's own."""


def method_named(method: str | Method, solver: str = "ticm") -> Method:
    """A method by its name, with a solver of its linear system by its name; a method itself is taken as it is.

    Raises:
        ValueError: there is no such method or solver, or the method has no such system.
    """
    if isinstance(method, str):
        if method not in METHODS:
            raise ValueError(f"method = {method!r} is not one of {', '.join(METHODS)}")
        method = METHODS[method]
    if solver not in SOLVERS:
        raise ValueError(f"solver = {solver!r} is not one of {', '.join(SOLVERS)}")
    if isinstance(method, Newmark):
        return type(method)(SOLVERS[solver])
    if SOLVERS[solver] is not None:
        able = names_of(lambda known: isinstance(known, Newmark))
        raise ValueError(f"solver: {method.name} has its own; {able} take another")
    return method


def check_step(method: Method, time_step: float) -> None:
    """Raise ValueError if a step [s] is so small that rounding shows."""
    if time_step < method.least_step:
        raise ValueError(
            f"time_step = {time_step!r} s is below {method.least_step:g} s, where the rounding of {method.name} shows:"
            f" {names_of(lambda known: known.least_step == 0.0)} have no such limit"
        )


def names_of(which: Callable[[Method], bool]) -> str:
    """Names of those methods, for an error that says which ones can do what another cannot."""
    return ", ".join(name for name, method in METHODS.items() if which(method))
