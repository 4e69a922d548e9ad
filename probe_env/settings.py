"""Base class of all validated settings, and checks of arguments.

Models are frozen, have strict types and accept no unknown keys. Errors name field, value and accepted range.
"""

import difflib
import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, get_args

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, ValidationError
from pydantic_core import CoreSchema, core_schema

from probe_env.files import FileError, read_toml

MAX_ERRORS = 8
"""Most errors in one message."""


@dataclass(frozen=True)
class Range:
    """Metadata of a field for ``range_of``: accepted range, not validated."""

    low: float
    high: float
    unit: str


class Quantity(Range):
    """Metadata of a physical quantity that is validated: finite and within [low, high] ``unit``."""

    def check(self, value: Any) -> Any:
        """The value, if it is in the range; else raises ValueError with value, range and unit."""
        within("", value, self.low, self.high, self.unit)
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self.check, handler(source))


quantity = Quantity
"""Metadata of a field: ``Annotated[float, quantity(low, high, unit)]``."""


class Model(BaseModel):
    """Base class of settings: frozen, strict types, no unknown keys."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, validate_default=True, use_attribute_docstrings=True
    )

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a TOML file; paths in it are relative to its folder, the "folder" of the validation's context.

        Raises:
            FileNotFoundError: no such file.
            ValueError: not TOML, or not valid; names the file and all invalid fields.
        """
        data = read_toml(path)
        with errors_in(path):
            return cls.model_validate(tuples(data), context={"folder": Path(path).parent})

    __str__ = BaseModel.__repr__

    def __repr_args__(self) -> Iterator[tuple[str, Any]]:
        """The fields that differ from their defaults."""
        for name, field in type(self).model_fields.items():
            if getattr(self, name) != field.get_default(call_default_factory=True):
                yield name, getattr(self, name)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Copy with changed fields, validated (unlike in pydantic); mappings update sub-models."""
        fields = {name: getattr(self, name) for name in type(self).model_fields}
        for name, value in (update or {}).items():
            inner = fields.get(name)
            if isinstance(inner, Model) and isinstance(value, Mapping):
                value = inner.model_copy(update=value)
            fields[name] = value
        return type(self).model_validate(fields)


def range_of(model: type[Model], field: str) -> Range | None:
    """Accepted range of a field, such as "contact.friction", from its metadata; None if it has none."""
    *parts, name = field.split(".")
    for part in parts:
        model = next(kind for kind in _parts(model.model_fields[part].annotation) if isinstance(kind, type))
    info = model.model_fields[name]
    metadata = [*info.metadata]
    for part in _parts(info.annotation):
        metadata += getattr(part, "__metadata__", ())
    for entry in metadata:
        if isinstance(entry, Range):
            return Range(entry.low, entry.high, entry.unit)
    low, high = (next((getattr(entry, end) for entry in metadata if hasattr(entry, end)), None) for end in ("ge", "le"))
    return None if low is None or high is None else Range(low, high, "")


def _parts(annotation: Any) -> Iterator[Any]:
    """A type and the members of a union."""
    yield annotation
    yield from get_args(annotation)


def explain(error: Exception, within: str = "") -> str:
    """An error as text; pydantic's in one line: fields with the prefix ``within``, problems and values."""
    if not isinstance(error, ValidationError):
        return f"{within}: {error}" if within else str(error)
    lines, problems = [], error.errors(include_url=False, include_context=False)
    for item in problems[:MAX_ERRORS]:
        field = ".".join(str(part) for part in (*filter(None, [within]), *item["loc"]))
        value = "" if isinstance(item["input"], dict | Model) else f" (given: {_short(item['input'])})"
        message = item["msg"].removeprefix("Value error, ")
        if item["type"] == "extra_forbidden":
            message = _no_such_field(error.title, item["loc"])
        lines.append(f"{field}: {message}{value}" if field else message)
    more = [f"and {len(problems) - MAX_ERRORS} more"] if len(problems) > MAX_ERRORS else []
    return "; ".join(lines + more)


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Context manager and decorator that raises pydantic's errors as a ValueError of one line, see ``explain``."""
    try:
        yield
    except ValidationError as error:
        raise ValueError(explain(error)) from error


@contextmanager
def errors_in(path: str | Path, within: str = "") -> Iterator[None]:
    """Context manager that raises errors of the content of a file as its FileError, see ``explain``."""
    try:
        yield
    except FileError:
        raise
    except (ValueError, OverflowError) as error:
        raise FileError(path, explain(error, within)) from error


def _no_such_field(title: str, location: tuple[int | str, ...]) -> str:
    """Message for an unknown field at a location in the model named ``title``, with the accepted fields."""
    model = next((kind for kind in _models(Model) if kind.__name__ == title), None)
    for part in location[:-1]:
        inner = model.model_fields[str(part)].annotation if model and part in model.model_fields else None
        model = next((kind for kind in _parts(inner) if isinstance(kind, type) and issubclass(kind, Model)), None)
    fields = model.model_fields if model else {}
    return "there is no such field" + (
        f"; accepted: {', '.join(fields)}{closest(location[-1], fields)}" if model else ""
    )


def _models(kind: type[Model]) -> Iterator[type[Model]]:
    for model in kind.__subclasses__():
        yield model
        yield from _models(model)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 100 else f"{text[:100]} ..."


def tuples(value: Any) -> Any:
    """TOML lists converted to tuples, recursively."""
    if isinstance(value, dict):
        return {key: tuples(entry) for key, entry in value.items()}
    return tuple(tuples(entry) for entry in value) if isinstance(value, list) else value


def is_number(value: object) -> bool:
    """Whether a value is a number; Python counts booleans as integers."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def within(name: str, value: float, low: float, high: float, unit: str, exclude_low: bool = False) -> None:
    """Raise ValueError unless ``value`` is in [low, high], or in (low, high] with ``exclude_low``; NaN is not."""
    if not low <= value <= high or (exclude_low and value == low):  # also catches NaN
        excluded = " (excluded)" if exclude_low else ""
        unit = unit and f" {unit}"
        given = f"{name} = {value!r}" if name else repr(value)
        raise ValueError(f"{given}{unit} is outside the accepted range {low:g}{excluded} to {high:g}{unit}")


def closest(name: object, known: Iterable[str]) -> str:
    """End of an error message: the name among the known ones that was probably meant, or nothing."""
    similar = difflib.get_close_matches(str(name), known, 1)
    return f"; the closest: {similar[0]}" if similar else ""


def check_keywords(what: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Raise TypeError if a keyword argument is unknown; libraries look for Python's words in the message."""
    unknown = sorted(set(given) - set(known))
    if unknown:
        accepted = f"accepted are {', '.join(known)}{closest(unknown[0], known)}"
        raise TypeError(f"{what}() got an unexpected keyword argument {unknown[0]!r}; {accepted}")


def whole_steps(name: str, value: float | None, time_step: float) -> int:
    """Number of time steps in a duration; ValueError unless it is whole, to 1e-9 of its value, and at least 1."""
    ratio = math.nan if value is None else value / time_step
    if not (math.isfinite(ratio) and round(ratio) >= 1 and abs(ratio - round(ratio)) <= 1e-9 * ratio):
        raise ValueError(f"{name} = {value!r} s is not a whole number (1 or more) of time steps of {time_step:g} s")
    return round(ratio)
