"""Checks of snapshots and pickles before they are restored; errors name the field, its value and the accepted one."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Final

FORMAT: Final = 5
"""Version of snapshots and pickles; increase it when the attributes of a simulator, its drive or a batch change."""


def check_format(what: str, saved: object) -> Mapping[str, Any]:
    """The saved mapping, if its format is ``FORMAT``.

    Raises:
        ValueError: another format, or not a mapping.
    """
    version = saved.get("format") if isinstance(saved, Mapping) else None
    if not isinstance(saved, Mapping) or version != FORMAT or isinstance(version, bool):
        kind = f"format = {version!r}" if isinstance(saved, Mapping) else f"a {type(saved).__name__} without a format"
        raise ValueError(f"{what}: {kind} cannot be read; this version reads format {FORMAT}: save it again")
    return saved


def check_names(what: str, saved: object, expected: Collection[str]) -> Mapping[str, Any]:
    """The saved mapping, if it has exactly the expected names.

    Raises:
        ValueError: a name is missing or unknown.
    """
    if not isinstance(saved, Mapping):
        raise ValueError(f"{what} is a {type(saved).__name__}, not a mapping of {', '.join(sorted(expected))}")
    for problem, names in (("missing", set(expected) - set(saved)), ("unknown", set(saved) - set(expected))):
        if names:
            raise ValueError(f"{what}: {min(names, key=str)!r} is {problem}; it has {', '.join(sorted(expected))}")
    return saved


def check_same(what: str, saved: object, expected: Mapping[str, Any], path: str = "") -> None:
    """Raise ValueError with the dotted name of the first field in which nested mappings differ."""
    saved = check_names(f"{what}: {path.rstrip('.') or 'built'}", saved, expected)
    for name, required in expected.items():
        if isinstance(required, Mapping):
            check_same(what, saved[name], required, f"{path}{name}.")
        elif type(saved[name]) is not type(required) or saved[name] != required:
            raise ValueError(f"{what}: {path}{name} = {saved[name]!r}; here it is {required!r}")


def check_types(what: str, saved: Mapping[str, Any], expected: Mapping[str, type]) -> None:
    """Raise ValueError with the first field of another type; whole numbers must not be negative."""
    for name, required in expected.items():
        value = saved[name]
        if type(value) is not required or (isinstance(value, int) and value < 0):
            least = " of 0 or more" if required is int else ""
            description = f"= {value!r}" if isinstance(value, int | float | str | None) else f"({type(value).__name__})"
            raise ValueError(f"{what}: {name} {description} is not {required.__name__}{least}")
