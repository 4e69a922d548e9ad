"""Figures that are not known exactly: a number, a range, or a mean with its standard deviation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Self

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, Field, FiniteFloat, model_validator
from pydantic_core import PydanticCustomError
from scipy.stats import truncnorm

from probe_env.arrays import FloatArray
from probe_env.settings import Model, within


class Between(Model):
    """Anything from ``low`` to ``high``, all equally likely."""

    low: FiniteFloat
    high: FiniteFloat

    @model_validator(mode="after")
    def _ascends(self) -> Self:
        if not self.low <= self.high:
            raise PydanticCustomError("range", f"low = {self.low!r} must not exceed high = {self.high!r}")
        return self


class Normal(Model):
    """Normal with a standard deviation, cut off where the figure's accepted range ends."""

    mean: FiniteFloat
    std: Annotated[FiniteFloat, Field(gt=0.0)]


def _described(value: Any) -> Any:
    """A table as the model whose keys it has: pydantic would tell what is wrong with it for each of them."""
    if isinstance(value, Between | Normal) or (isinstance(value, int | float) and not isinstance(value, bool)):
        return value
    for kind in (Between, Normal):
        if isinstance(value, Mapping) and set(value) & set(kind.model_fields):
            return kind.model_validate(dict(value))
    raise PydanticCustomError("figure", "must be a number, a table of low and high, or one of mean and std")


Figure = Annotated[float | Between | Normal, BeforeValidator(_described)]


def checked(figure: Figure, low: float, high: float, unit: str) -> Figure:
    """The figure, if all its values (the mean of a normal one) are within [low, high] ``unit``.

    Raises:
        ValueError: they are not; names the value and the range.
    """
    values = (
        {name: value for name, value in figure.model_dump().items() if name != "std"}
        if isinstance(figure, Between | Normal)
        else {"": figure}
    )
    for name, value in values.items():
        try:
            within(name or "value", value, low, high, unit)
        except ValueError as error:
            raise PydanticCustomError("out_of_range", "{text}", {"text": str(error)}) from None
    return figure


def quantiles(figure: Figure, shares: npt.ArrayLike, low: float, high: float) -> FloatArray:
    """Values of a figure at shares in (0, 1), of their shape; ``low`` and ``high`` are what is accepted of it."""
    shares = np.asarray(shares, dtype=float)
    match figure:
        case Between():
            return figure.low + shares * (figure.high - figure.low)
        case Normal():
            ends = (low - figure.mean) / figure.std, (high - figure.mean) / figure.std
            return np.asarray(truncnorm.ppf(shares, *ends, loc=figure.mean, scale=figure.std))
        case _:
            return np.full(shares.shape, figure)


def middle(figure: Figure, low: float, high: float) -> float:
    """Median of a figure: what is taken where one value is needed."""
    return float(quantiles(figure, 0.5, low, high))
