"""Arguments as a command; what a model refuses is one line, as all errors are."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from typing import Any, Final

import tyro
from pydantic import ValidationError

from probe_env.settings import explain

OPTIONS: Final = {"Scene": "--scene", "Tube": "--scene.tube", "Probe": "--scene.probe", "Contact": "--scene.contact",
                  "Air": "--scene.air"}  # fmt: skip
"""Model -> the options that fill it."""


def parsed(name: str, kind: type[Any], arguments: Sequence[str], example: str, default: Any = None) -> Any:
    """The command that the arguments ask for.

    Args:
        name: of the command.
        kind: its dataclass.
        arguments: behind the name.
        example: of its use, for the help.
        default: command whose fields are the options' defaults.

    Raises:
        ValueError: an option of a scene is not valid.
        SystemExit: what tyro does not understand, which it has told; and help.
    """
    given: dict[str, Any] = {
        "args": arguments, "prog": f"probe-env {name}", "description": f"{kind.__doc__}\n\nExample: {example}"
    }  # fmt: skip
    given |= {"default": default} if default is not None else {}
    try:
        with redirect_stderr(io.StringIO()), redirect_stdout(io.StringIO()):
            return tyro.cli(kind, **given)
    except SystemExit as stop:
        for error in _causes(stop):
            if isinstance(error, ValidationError):
                raise ValueError(explain(error, OPTIONS.get(error.title, error.title))) from error
    return tyro.cli(kind, **given)  # once more, aloud


def positional(arguments: Sequence[str]) -> str | None:
    """The first argument that is neither an option nor the value of one, where every option has one value."""
    rest = iter(arguments)
    for argument in rest:
        if argument == "--":
            return next(rest, None)
        if not argument.startswith("-"):
            return argument
        if "=" not in argument and argument not in ("-h", "--help"):
            next(rest, None)
    return None


def _causes(error: BaseException) -> Iterator[BaseException]:
    cause: BaseException | None = error
    while cause is not None:
        yield cause
        cause = cause.__cause__ or cause.__context__
