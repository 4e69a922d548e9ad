"""The fields of a plant's file as a form has them: what each is, in which unit, what is accepted, and its text."""

from __future__ import annotations

import ast
import inspect
import math
import re
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import UnionType
from typing import Any, Final, Literal, Union, get_args, get_origin, get_type_hints

from pydantic import ValidationError

from probe_env import Plant
from probe_env.envs.plants import Between
from probe_env.envs.plants.plant import OF_AIR, OF_FEED
from probe_env.envs.task import SHOWN, TaskConfig
from probe_env.settings import Model, explain

Kind = Literal["number", "figure", "pair", "list", "choice"]
ELSEWHERE: Final = frozenset(
    {*OF_FEED, *OF_AIR, *SHOWN, "scene", "sensor", "passes", "inspects", "growing", "vibration_measure"}
)
"""Fields of the task that stand in other tables, are nobody's to set, or change what is rewarded as a whole."""
SIGNS: Final = ("±", "+-")
TRUTH: Final = {"no": False, "yes": True}
"""What a choice of the two stands for in a file."""
HINTS: Final[dict[Kind, str]] = {
    "number": "",
    "figure": "a number, LOW to HIGH, or MEAN ± STANDARD DEVIATION",
    "pair": "LOW to HIGH",
    "list": "a number, or some with commas between them",
    "choice": "",
}


@dataclass(frozen=True)
class Field:
    """A field of a plant's file.

    Attributes:
        table: it stands in.
        name: of it.
        what: it is, with its unit where the model says it.
        kind: how it is written.
        default: what is taken where it is left out, as text.
        accepted: its range and unit, as its error tells them; empty where there is none.
        choices: of a choice.
    """

    table: str
    name: str
    what: str
    kind: Kind
    default: str
    accepted: str
    choices: tuple[str, ...] = ()

    @property
    def path(self) -> str:
        """Table and name."""
        return f"{self.table}.{self.name}"

    @property
    def unit(self) -> str:
        """Of its range, "LOW to HIGH UNIT"; empty if it has none."""
        return " ".join(self.accepted.split()[3:])

    @property
    def hint(self) -> str:
        """What may stand there, in words."""
        unit = f"accepted: {self.accepted}" if self.accepted else ""
        return "; ".join(filter(None, (self.what, unit, HINTS[self.kind])))


@lru_cache
def plant_fields() -> dict[str, tuple[Field, ...]]:
    """All fields by table, in the order of the models."""
    tables: dict[str, type[Model]] = {
        name: info.annotation
        for name, info in Plant.model_fields.items()
        if isinstance(info.annotation, type) and issubclass(info.annotation, Model)
    }
    fields = {
        table: tuple(_field(table, name, model) for name in model.model_fields) for table, model in tables.items()
    }
    of_task = (name for name in TaskConfig.model_fields if name not in ELSEWHERE)
    return fields | {"task": tuple(_field("task", name, TaskConfig) for name in of_task)}


def text_of(value: Any) -> str:
    """A value of a file as the text of its field; empty for none."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        low, high = value.get("low"), value.get("high")
        return f"{value.get('mean')} ± {value.get('std')}" if low is None else f"{low} to {high}"
    if isinstance(value, Model):
        return text_of(value.model_dump())
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def value_of(field: Field, text: str) -> Any:
    """What a text stands for, as a file would have it; what is no number stays a text, which the model refuses."""
    text = text.strip()
    if field.kind == "choice":
        return TRUTH.get(text, text) if field.choices == tuple(TRUTH) else text
    sign = next((sign for sign in SIGNS if sign in text), None)
    if field.kind == "figure" and sign:
        mean, _, std = text.partition(sign)
        return {"mean": _number(mean), "std": _number(std)}
    if re.search(r"\bto\b", text) or (field.kind == "pair" and "," in text):
        ends = [_number(part) for part in re.split(r"\bto\b|,", text)]
        return {"low": ends[0], "high": ends[-1]} if field.kind == "figure" and len(ends) == 2 else ends
    if field.kind == "list" and "," in text:
        return [_number(part) for part in text.split(",") if part.strip()]
    whole = _whole(field)
    return int(text) if whole and re.fullmatch(r"[+-]?\d+", text) else _number(text)


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text.strip()


def _whole(field: Field) -> bool:
    return field.table == "task" and TaskConfig.model_fields[field.name].annotation is int


def _field(table: str, name: str, model: type[Model]) -> Field:
    kind, choices = _kind(get_type_hints(model, include_extras=True)[name])
    default = model.model_fields[name].default
    if default is None and table in ("feed", "air"):
        default = getattr(TaskConfig(), name, None)  # the task's
    return Field(
        table, name, _descriptions(model).get(name, ""), kind, _shown(default), _accepted(table, name, kind), choices
    )


def _shown(default: Any) -> str:
    """A default in few digits."""
    if isinstance(default, tuple):
        return " to ".join(f"{value:.4g}" for value in default)
    return f"{default:.6g}" if isinstance(default, float) else text_of(default)


def _kind(annotation: Any) -> tuple[Kind, tuple[str, ...]]:
    """How a field of a type is written, and the choices where there are some."""
    if annotation is bool:
        return "choice", tuple(TRUTH)
    if get_origin(annotation) is Literal:
        return "choice", get_args(annotation)
    parts = list(_parts(annotation))
    if Between in parts:
        return "figure", ()
    tuples = [part for part in parts if get_origin(part) is tuple]
    if tuples:
        return ("list" if Ellipsis in get_args(tuples[0]) else "pair"), ()
    return "number", ()


def _parts(annotation: Any) -> Any:
    """A type, and those that it is made of."""
    yield annotation
    if get_origin(annotation) in (Union, UnionType) or hasattr(annotation, "__metadata__"):
        for part in get_args(annotation)[: 1 if hasattr(annotation, "__metadata__") else None]:
            yield from _parts(part)


def _accepted(table: str, name: str, kind: Kind) -> str:
    """The accepted range with its unit, as the error of a value that is in no range tells it."""
    if kind == "choice":
        return ""
    nowhere = [math.nan, math.nan] if kind == "pair" else math.nan
    try:
        Plant.model_validate({table: {name: nowhere}})
    except ValidationError as error:
        match = re.search(r"accepted range (.+?)(?= \(given|;|$)", explain(error))
        return match[1] if match else ""
    return ""


@lru_cache
def _descriptions(model: type[Model]) -> dict[str, str]:
    """What the docstrings below its fields say."""
    descriptions: dict[str, str] = {}
    for kind in reversed(model.__mro__):
        if not issubclass(kind, Model) or kind is Model:
            continue
        (body,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
        assert isinstance(body, ast.ClassDef)
        for field, after in zip(body.body, body.body[1:], strict=False):
            if isinstance(field, ast.AnnAssign) and isinstance(after, ast.Expr) and isinstance(field.target, ast.Name):
                descriptions[field.target.id] = " ".join(str(ast.literal_eval(after.value)).replace("`", "").split())
    return descriptions
