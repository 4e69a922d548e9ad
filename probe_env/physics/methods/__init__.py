"""Methods that advance a chain in time; ``METHODS`` lists them all."""

from collections.abc import Callable
from typing import Final

from probe_env.physics.methods.explicit import Explicit
from probe_env.physics.methods.imex import Imex, Imex32
from probe_env.physics.methods.implicit import Implicit
from probe_env.physics.methods.method import Method
from probe_env.physics.methods.newmark import Newmark, Wilson
from probe_env.physics.methods.superelement.group import Superelement, Superelement32
from probe_env.scene import Scene

METHODS: Final[dict[str, Method]] = {
    method.name: method
    for method in (
        Newmark(), Wilson(), Imex(), Imex32(), Implicit(), Explicit(), Superelement(), Superelement32()
    )
}  # fmt: skip
ON_NODES: Final = {name: method for name, method in METHODS.items() if method.on_nodes}


def method_named(method: str | Method) -> Method:
    """A method by its name, or the given one."""
    if isinstance(method, Method):
        return method
    if method not in METHODS:
        raise ValueError(f"method = {method!r} is not one of {', '.join(METHODS)}")
    return METHODS[method]


def check_step(method: Method, time_step: float) -> None:
    """Raise ValueError if a step [s] is below the least step of the method."""
    if time_step < method.min_step:
        raise ValueError(
            f"time_step = {time_step!r} s is below {method.min_step:g} s, where the rounding of {method.name} shows:"
            f" {method_names(lambda other: other.min_step == 0.0)} have no such limit"
        )


def check_scene(method: Method, scene: Scene) -> None:
    """Raise ValueError if a method does not simulate an option of a scene."""
    options: tuple[tuple[str, float, Callable[[Method], bool]], ...] = (
        ("air.compressible", scene.air.compressible, lambda other: other.simulates_expansion),
        ("contact.damping", scene.contact.damping, lambda other: other.simulates_damping),
        ("contact.friction_slope", scene.contact.friction_slope, lambda other: other.simulates_damping),
        ("contact.weight", scene.contact.weight, lambda other: other.simulates_weight),
        ("terms.shortening", scene.terms.shortening, lambda other: other.simulates_terms),
        ("terms.stiction", scene.terms.stiction, lambda other: other.simulates_terms),
    )
    for option, used, able in options:
        if used and not able(method):
            value = str(used).lower()
            raise ValueError(f"{option} = {value}: {method.name} does not simulate it; use {method_names(able)}")


def method_names(condition: Callable[[Method], bool]) -> str:
    """Names of the methods with a property, for error messages."""
    return ", ".join(name for name, method in METHODS.items() if condition(method))
