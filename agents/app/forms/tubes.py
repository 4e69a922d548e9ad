"""A plant's file in the making: read, changed field by field, checked as a whole, written."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError

from agents.app.forms.fields import Field, plant_fields, text_of, value_of
from agents.policies.places import plant_at
from agents.records.provenance import write_atomically
from agents.records.shipped import file_or_shipped
from agents.terminal.refusals import refusal
from probe_env import Plant
from probe_env.envs.plants.posterior import with_posterior
from probe_env.files import FileError, read_toml
from probe_env.settings import explain

POSTERIOR = "posterior"


class TubeForm:
    """A plant's file and the changes that were made to it.

    Attributes:
        path: of the file; None: nothing was opened, the study's tubes.
        given: the file's tables with the changes.
        plant: of the last tables that were valid.
    """

    def __init__(self) -> None:
        self.path: Path | None = None
        self.given: dict[str, Any] = {}
        self.plant = Plant()
        self._opened: dict[str, Any] = {}

    @property
    def changed(self) -> bool:
        """Whether it differs from the file."""
        return self.given != self._opened

    @property
    def is_study(self) -> bool:
        """Whether it is the study's tubes, which the shipped lists are of."""
        return self.path is None and not self.given

    def open(self, given: Path) -> None:
        """Read a file by its path, or one that ships by its name.

        Raises:
            FileNotFoundError: neither.
            ValueError: not valid; nothing has changed then.
        """
        path = file_or_shipped("tubes", given)
        plant = plant_at(path)
        assert plant is not None
        self.path, self.plant, self.given = path, plant, read_toml(path)
        self._opened = _copied(self.given)

    def close(self) -> None:
        """Back to the study's tubes."""
        self.__init__()  # type: ignore[misc]

    def text(self, field: Field) -> str:
        """What stands in a field; empty: it is left out."""
        table = self.given.get(field.table, {})
        return text_of(table.get(field.name)) if isinstance(table, Mapping) else ""

    @property
    def posterior(self) -> str:
        """The calibration that is named above all tables; empty: none."""
        named = self.given.get(POSTERIOR, "")
        return named if isinstance(named, str) else ""

    def change(self, field: Field, text: str) -> None:
        """Set a field; an empty text leaves it out.

        Raises:
            ValueError: what the file would be refused for, in one line; nothing has changed then.
        """
        tables = _copied(self.given)
        table = dict(tables.get(field.table, {}))
        table.pop(field.name, None)
        if text.strip():
            table[field.name] = value_of(field, text)
        tables[field.table] = table
        if not table:
            del tables[field.table]
        self._take(tables)

    def change_posterior(self, text: str) -> None:
        """Name the calibration that friction and the rest are taken from; raises as ``change``."""
        tables = _copied(self.given)
        tables.pop(POSTERIOR, None)
        self._take(({POSTERIOR: text.strip()} if text.strip() else {}) | tables)

    def save(self, path: Path) -> None:
        """Write the file, as a whole.

        Raises:
            ValueError: it is not named as a plant's file is, or is one that ships.
        """
        if path.suffix != ".toml":
            raise FileError(path, "a plant's file must be named NAME.toml")
        if self.path is not None and path.resolve() == self.path.resolve() and "configs" in path.resolve().parts:
            raise FileError(path, "this file ships with the project: choose another name")
        tables = _copied(self.given)
        if self.posterior:
            where = (self._folder / self.posterior).resolve()
            tables[POSTERIOR] = os.path.relpath(where, path.resolve().parent)
        write_atomically(path, tomli_w.dumps(tables))
        self.open(path)

    def kept(self, folder: Path) -> Path | None:
        """The file for a run: the one that was opened, or a copy of what was changed; None: the study's tubes."""
        if self.is_study or not self.changed:
            return self.path
        copy = TubeForm()
        copy.path, copy.given, copy.plant = self.path, self.given, self.plant
        digest = hashlib.sha256(self.plant.model_dump_json().encode()).hexdigest()[:6]
        path = folder / f"{self.path.stem if self.path else 'tube'}-{digest}.toml"
        copy.save(path)
        return path

    @property
    def _folder(self) -> Path:
        return self.path.parent if self.path else Path()

    def _take(self, tables: dict[str, Any]) -> None:
        try:
            plant = Plant.model_validate(with_posterior(tables, self._folder))
        except ValidationError as error:
            raise ValueError(explain(error)) from error
        except FileNotFoundError as error:
            raise ValueError(refusal(error)) from error
        self.given, self.plant = tables, plant


def field_named(path: str) -> Field:
    """The field of a table and name, "table.name".

    Raises:
        KeyError: there is none.
    """
    table, _, name = path.partition(".")
    return {field.name: field for field in plant_fields()[table]}[name]


def _copied(tables: Mapping[str, Any]) -> dict[str, Any]:
    return {name: dict(value) if isinstance(value, Mapping) else value for name, value in tables.items()}
