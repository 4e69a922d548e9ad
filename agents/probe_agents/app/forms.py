"""Form of a tube file: fields with ranges, units and texts, and the file during editing."""

import hashlib
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, Literal, get_args, get_origin

import tomli_w
from pydantic import ValidationError

from probe_agents.records.atomic import write_atomically
from probe_agents.records.shipped import file_or_shipped, ships
from probe_agents.terminal.names import checked_name
from probe_env import Plant
from probe_env.envs.plants import OF_AIR, OF_FEED, Between, supply_in_si, supply_per_hour
from probe_env.envs.task.config import VISIBLE_FIELDS, TaskConfig
from probe_env.files import FileError, read_toml
from probe_env.settings import Model, Range, explain, is_number, range_of

Kind = Literal["number", "integer", "figure", "pair", "list", "choice"]
NOT_IN_FORM: Final = frozenset(
    [*OF_FEED, *OF_AIR, *VISIBLE_FIELDS, "scene", "sensor", "instrument", "passes", "scored_pass", "growing",
     "vibration_measure"]
)  # fmt: skip
"""Task fields of other tables, and those that change the task as a whole."""
SIGNS: Final = ("±", "+-")
BOOLEANS: Final = {"no": False, "yes": True}
POSTERIOR: Final = "posterior"
HINTS: Final[dict[Kind, str]] = {
    "figure": "a number, LOW to HIGH, or MEAN ± STANDARD DEVIATION",
    "pair": "LOW to HIGH",
    "list": "a number, or several separated by commas",
}


@dataclass(frozen=True)
class Field:
    """A field of a tube file."""

    table: str
    name: str
    description: str
    kind: Kind
    default: str  # text of the default
    range: Range | None  # accepted range, SI units
    choices: tuple[str, ...] = ()
    unit: str = ""  # displayed unit
    factor: float = 1.0  # displayed value / SI value

    @property
    def path(self) -> str:
        """Table and name, "table.name"."""
        return f"{self.table}.{self.name}"

    @property
    def title(self) -> str:
        """Name and unit."""
        return self.name.replace("_", " ") + (f" [{self.unit}]" if self.unit else "")

    @property
    def hint(self) -> str:
        """Help text."""
        ends = (self.range.low * self.factor, self.range.high * self.factor) if self.range else ()
        accepted = f"accepted: {' to '.join(f'{end:g}' for end in ends)} {self.unit}" if ends else ""
        return "; ".join(filter(None, (self.description, accepted.strip(), HINTS.get(self.kind)))) or self.title


@lru_cache
def tube_fields() -> dict[str, tuple[Field, ...]]:
    """All fields of a tube file by table."""
    tables = {name: kind.annotation for name, kind in Plant.model_fields.items()}
    models = {name: kind for name, kind in tables.items() if isinstance(kind, type) and issubclass(kind, Model)}
    names = {name: list(model.model_fields) for name, model in models.items()}
    names["task"] = [name for name in TaskConfig.model_fields if name not in NOT_IN_FORM]
    models["task"] = TaskConfig
    return {table: tuple(_field(table, name, models[table]) for name in names[table]) for table in models}


def text_of(value: Any) -> str:
    """Text of a value in a file; empty for None."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Model):
        value = value.model_dump()
    if isinstance(value, Mapping):
        return f"{value['low']} to {value['high']}" if "low" in value else f"{value.get('mean')} ± {value.get('std')}"
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def scaled(value: Any, factor: float) -> Any:
    """Numbers of a value in another unit."""
    if isinstance(value, Mapping):
        return {name: scaled(number, factor) for name, number in value.items()}
    if isinstance(value, list | tuple):
        return [scaled(number, factor) for number in value]
    return float(f"{value * factor:.12g}") if is_number(value) and factor != 1.0 else value


def value_of(field: Field, text: str) -> Any:
    """Value of a text, SI units; text that is not a number is returned unchanged, and the model refuses it."""
    return scaled(_parsed(field, text.strip()), 1.0 / field.factor)


def _parsed(field: Field, text: str) -> Any:
    if field.kind == "choice":
        return BOOLEANS.get(text, text) if field.choices == tuple(BOOLEANS) else text
    sign = next((sign for sign in SIGNS if sign in text), None)
    if field.kind == "figure" and sign:
        mean, _, std = text.partition(sign)
        return {"mean": _number(mean), "std": _number(std)}
    if re.search(r"\bto\b", text) or (field.kind == "pair" and "," in text):
        ends = [_number(part) for part in re.split(r"\bto\b|,", text)]
        return {"low": ends[0], "high": ends[-1]} if field.kind == "figure" and len(ends) == 2 else ends
    if field.kind == "list" and "," in text:
        return [_number(part) for part in text.split(",") if part.strip()]
    return int(text) if field.kind == "integer" and re.fullmatch(r"[+-]?\d+", text) else _number(text)


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text.strip()


def _field(table: str, name: str, model: type[Model]) -> Field:
    info = model.model_fields[name]
    kind, choices = _kind(info.annotation)
    default = info.default
    if default is None and table in ("feed", "air"):
        default = getattr(TaskConfig(), name, None)  # the task's
    description = " ".join((info.description or "").replace("`", "").split())
    accepted = range_of(model, name)
    unit, factor = accepted.unit if accepted else "", 1.0
    if per_hour := {"m3/s": "m³/h", "m3/s2": "m³/h/s"}.get(unit):
        unit, factor = per_hour, 3600.0
    elif accepted and unit == "m" and accepted.high <= 1.0:
        unit, factor = "mm", 1e3
    default = scaled(default, factor)
    if isinstance(default, tuple | list):
        text = " to ".join(f"{value:.4g}" for value in default)
    else:
        text = f"{default:.6g}" if isinstance(default, float) else text_of(default)
    return Field(table, name, description, kind, text, accepted, choices, unit, factor)


def _kind(annotation: Any) -> tuple[Kind, tuple[str, ...]]:
    """Kind of a field from its type, and its choices."""
    if annotation is bool:
        return "choice", tuple(BOOLEANS)
    if get_origin(annotation) is Literal:
        return "choice", get_args(annotation)
    text = str(annotation)  # contains the types
    if Between.__name__ in text:
        return "figure", ()
    if "tuple[" in text:
        return ("list" if "..." in text else "pair"), ()
    return ("integer" if annotation is int else "number"), ()


class ReplaceError(FileError):
    """Raised before a file is replaced."""


def check_target(path: Path, read: Callable[[Path], object], replace: bool) -> None:
    """Check that a file can be written: it does not exist, or ``read`` accepts it and ``replace`` is set.

    Raises:
        ReplaceError: ``replace`` is not set.
        FileError: the existing file is of another kind.
    """
    if not os.path.lexists(path):
        return
    try:
        read(path)
    except (ValueError, OSError) as error:
        raise FileError(path, "exists and is a file of another kind: choose another name") from error
    if not replace:
        raise ReplaceError(path, "exists: press replace to write over it, or choose another name")


def _file(tables: Mapping[str, Any]) -> str:
    """Text of a tube file, with air in m3/h."""
    return tomli_w.dumps({name: supply_per_hour(table) if name == "air" else table for name, table in tables.items()})


class TubeForm:
    """A tube file during editing.

    Attributes:
        path: file; None: the study's tubes.
        tables: contents of the file with the changes.
        plant: the last valid contents.
    """

    def __init__(self) -> None:
        self.close()

    def close(self) -> None:
        """Return to the study's tubes."""
        self.path: Path | None = None
        self.tables: dict[str, Any] = {}
        self.plant = Plant()
        self._opened: dict[str, Any] = {}

    @property
    def changed(self) -> bool:
        """Whether it differs from the file."""
        return self.tables != self._opened

    @property
    def is_study(self) -> bool:
        """Whether it is the study's tubes, which have shipped lists."""
        return self.path is None and not self.tables

    def open(self, name: Path) -> None:
        """Read a file by its path, or a shipped one by its name."""
        path = file_or_shipped("tubes", name)
        self.plant, self.path = Plant.from_toml(path), path
        self.tables = read_toml(path)
        if "air" in self.tables:
            self.tables["air"] = supply_in_si(self.tables["air"])
        self._opened = self.tables

    def text(self, field: Field) -> str:
        """Text of a field; empty: not in the file."""
        return text_of(scaled(self.tables.get(field.table, {}).get(field.name), field.factor))

    @property
    def toml(self) -> str:
        """Text of the file with the changes."""
        return _file(self.tables)

    @property
    def posterior(self) -> str:
        """File of the calibration; empty: none."""
        return str(self.tables.get(POSTERIOR, ""))

    def change(self, field: Field, text: str) -> None:
        """Set a field; an empty text removes it."""
        table = {name: value for name, value in self.tables.get(field.table, {}).items() if name != field.name}
        if text.strip():
            table[field.name] = value_of(field, text)
        self._replace(field.table, table)

    def change_posterior(self, text: str) -> None:
        """Set the file of the calibration; raises as ``change``."""
        self._replace(POSTERIOR, text.strip())

    def save(self, path: Path, folder: Path, replace: bool = False) -> None:
        """Write the file next to the opened one, which is where a name without a folder goes, or into ``folder``.

        Args:
            path: the file, or its name.
            folder: folder of the app for tubes; for names if no file of the user is open.
            replace: whether an existing tube file is replaced.

        Raises:
            ReplaceError: there is such a tube file, and ``replace`` is not set.
            FileError: another folder, or an existing file of another kind.
        """
        checked_name(path.name, "tube")
        if path.suffix != ".toml":
            raise FileError(path, "a tube file must end with .toml")
        if ships("tubes", path):
            raise FileError(path, "this file ships with the project: choose another name")
        folders = [folder] if self.path is None or ships("tubes", self.path) else [self.path.parent, folder]
        if path.parent == Path():
            path = folders[0] / path
        accepted = {folder.resolve(): str(folder) for folder in folders}
        if path.parent.resolve() not in accepted:
            raise FileError(path, f"a tube file is saved in {' or '.join(accepted.values())}: give a name alone")
        check_target(path, Plant.from_toml, replace)
        self._write(path)
        self.open(path)

    def file_for_run(self, folder: Path) -> Path | None:
        """File for a run: the opened file, or a copy with the changes in ``folder``; None: the study's tubes."""
        if self.is_study or not self.changed:
            return self.path
        digest = hashlib.sha256(self.plant.model_dump_json().encode()).hexdigest()[:6]
        path = folder / f"{self.path.stem if self.path else 'tube'}-{digest}.toml"
        self._write(path)
        return path

    @property
    def _folder(self) -> Path:
        return self.path.parent if self.path else Path()

    def _write(self, path: Path) -> None:
        tables = dict(self.tables)
        if self.posterior:
            tables[POSTERIOR] = os.path.relpath((self._folder / self.posterior).resolve(), path.resolve().parent)
        write_atomically(path, _file(tables))

    def _replace(self, name: str, content: Any) -> None:
        """Replace a table or the posterior if the result is valid; without content it is removed."""
        tables = {key: value for key, value in self.tables.items() if key != name}
        tables |= {name: content} if content else {}
        try:
            self.plant = Plant.model_validate(tables, context={"folder": self._folder})
        except ValidationError as error:
            raise ValueError(explain(error)) from error
        self.tables = tables
