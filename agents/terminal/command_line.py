"""Arguments as a command; what tyro or a model refuses is one line, as all errors are."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, Final

import tyro
from pydantic import ValidationError
from tyro import _strings

from agents.terminal.tyro_texts import joined_lines, laid_out, message_of, option_problem, options_of
from probe_env.settings import explain

OPTIONS: Final = {"Scene": "--scene", "Tube": "--scene.tube", "Probe": "--scene.probe", "Contact": "--scene.contact",
                  "Air": "--scene.air"}  # fmt: skip
"""Model -> the options that fill it."""

if hasattr(_strings, "remove_single_line_breaks"):  # tyro's own keeps breaks before what begins with no letter
    _strings.remove_single_line_breaks = joined_lines


def parsed(name: str, kind: type[Any], arguments: Sequence[str], example: str, default: Any = None) -> Any:
    """The command that the arguments ask for.

    Args:
        name: of the command.
        kind: its dataclass.
        arguments: behind the name.
        example: of its use, for the help.
        default: command whose fields are the options' defaults.

    Raises:
        ValueError: an option is not known, or its value is not valid.
        SystemExit: help was asked for, and printed.
    """
    given: dict[str, Any] = {
        "prog": f"probe-env {name}", "description": laid_out(f"{kind.__doc__}\n\nExample: {example}")
    }  # fmt: skip
    given |= {"default": default} if default is not None else {}
    arguments = [_as_path(argument) for argument in arguments]
    command, stop, text = _silently(kind, given | {"args": arguments})
    if stop is None:
        return command
    for error in _causes(stop):
        if isinstance(error, ValidationError):
            raise ValueError(explain(error, OPTIONS.get(error.title, error.title))) from error
    if not stop.code:
        return tyro.cli(kind, args=arguments, **given)  # once more, aloud: help
    known = options_of(_silently(kind, given | {"args": ["--help"]})[2])
    unknown = [argument for argument in _flags(arguments) if argument not in known]
    raise ValueError(option_problem(unknown[0], known, name) if unknown else message_of(text)) from None


def _silently(kind: type[Any], given: dict[str, Any]) -> tuple[Any, SystemExit | None, str]:
    """The command or what tyro ended with, and all that it printed."""
    printed = io.StringIO()
    try:
        with redirect_stderr(printed), redirect_stdout(printed):
            return tyro.cli(kind, **given), None, printed.getvalue()
    except SystemExit as stop:
        return None, stop, printed.getvalue()


def _as_path(argument: str) -> str:
    """A file whose name begins with a dash, so that it does not read as an option; negative numbers do not."""
    dashed = argument.startswith("-") and not argument.startswith("--") and len(argument) > 2
    try:
        float(argument)
    except ValueError:
        return f"./{argument}" if dashed and Path(argument).is_file() else argument
    return argument


def _flags(arguments: Sequence[str]) -> list[str]:
    """What is written as an option, without its value, as tyro spells it; negative numbers are values."""
    before = list(arguments[: arguments.index("--")] if "--" in arguments else arguments)
    names = [argument.partition("=")[0] for argument in before if argument.startswith("--")]
    return [name.replace("_", "-") for name in names]


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
