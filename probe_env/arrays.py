"""Types of arrays, and rows of the arrays of an object."""

import copy
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.floating]
BoolArray = npt.NDArray[np.bool_]


T = TypeVar("T")


def rows_of(thing: T, which: Sequence[int]) -> T:
    """A shallow copy of an object whose arrays, also those in its dictionaries, have the rows ``which`` only."""
    new, index = copy.copy(thing), list(which)

    def chosen(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: chosen(entry) for name, entry in value.items()}
        return value[index] if isinstance(value, np.ndarray) else value

    new.__dict__.update({name: chosen(value) for name, value in vars(thing).items()})
    return new
