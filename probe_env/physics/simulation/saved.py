"""Saved states, and that one fits where it is put back: an error names field, what was found and what is accepted."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Final

FORMAT: Final = 5
"""Of snapshots and pickles; goes up whenever what a simulator, its drive or a batch holds changes."""


def check_format(what: str, saved: object) -> Mapping[str, Any]:
    """What was saved, as a mapping.

    Raises:
        ValueError: of another version, or nothing of the kind.
    """
    given = saved.get("format") if isinstance(saved, Mapping) else None
    if not isinstance(saved, Mapping) or given != FORMAT or isinstance(given, bool):
        description = (
            f"format = {given!r}" if isinstance(saved, Mapping) else f"a {type(saved).__name__} without a format"
        )
        raise ValueError(f"{what}: {description} cannot be read; this version reads format {FORMAT}: save it anew")
    return saved


def check_names(what: str, given: object, expected: Collection[str]) -> Mapping[str, Any]:
    """A mapping with exactly the expected names.

    Raises:
        ValueError: names one that is missing or unknown.
    """
    if not isinstance(given, Mapping):
        raise ValueError(f"{what} is a {type(given).__name__}, not a mapping of {', '.join(sorted(expected))}")
    for description, names in (
        ("is missing", set(expected) - set(given)),
        ("is not known", set(given) - set(expected)),
    ):
        if names:
            raise ValueError(f"{what}: {min(names, key=str)!r} {description}; it has {', '.join(sorted(expected))}")
    return given


def check_same(what: str, given: object, expected: Mapping[str, Any], path: str = "") -> None:
    """Raise ValueError, with the dotted name, at the first field in which nested mappings differ."""
    given = check_names(f"{what}: {path.rstrip('.') or 'built'}", given, expected)
    for name, wanted in expected.items():
        if isinstance(wanted, Mapping):
            check_same(what, given[name], wanted, f"{path}{name}.")
        elif type(given[name]) is not type(wanted) or given[name] != wanted:
            raise ValueError(f"{what}: {path}{name} = {given[name]!r}; here it is {wanted!r}")


def check_types(what: str, given: Mapping[str, Any], expected: Mapping[str, type]) -> None:
    """Raise ValueError at the first field that is of another type; whole numbers must not be negative."""
    for name, wanted in expected.items():
        value = given[name]
        if type(value) is not wanted or (isinstance(value, int) and value < 0):
            least = " of 0 or more" if wanted is int else ""
            description = f"= {value!r}" if isinstance(value, int | float | str | None) else f"({type(value).__name__})"
            raise ValueError(f"{what}: {name} {description} is not {wanted.__name__}{least}")
