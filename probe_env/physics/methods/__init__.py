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
from probe_env.scene import Scene

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
"""Solvers of the linear system of Newmark and Wilson; None: the built-in one."""


def method_named(method: str | Method, solver: str = "ticm") -> Method:
    """A method by its name, or the given one, with a solver of its linear system by name.

    Raises:
        ValueError: unknown method or solver, or a method without a choice of solvers.
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
        able = names_of(lambda other: isinstance(other, Newmark))
        raise ValueError(f"solver: {method.name} has its own; {able} take another")
    return method


def check_step(method: Method, time_step: float) -> None:
    """Raise ValueError if a step [s] is below the least step of the method."""
    if time_step < method.least_step:
        raise ValueError(
            f"time_step = {time_step!r} s is below {method.least_step:g} s, where the rounding of {method.name} shows:"
            f" {names_of(lambda other: other.least_step == 0.0)} have no such limit"
        )


def check_scene(method: Method, scene: Scene) -> None:
    """Raise ValueError if a method does not simulate an option of a scene."""
    options: tuple[tuple[str, bool, Callable[[Method], bool]], ...] = (
        ("air.compressible", scene.air.compressible, lambda other: other.simulates_expansion),
        ("contact.weight", scene.contact.weight, lambda other: other.simulates_weight),
    )
    for option, used, able in options:
        if used and not able(method):
            raise ValueError(f"{option} = true: {method.name} does not simulate it; use {names_of(able)}")


def names_of(which: Callable[[Method], bool]) -> str:
    """Names of the methods with a property, for error messages."""
    return ", ".join(name for name, method in METHODS.items() if which(method))
