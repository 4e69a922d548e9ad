"""Arguments as commands; what a model refuses is one line, as all errors are."""

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


def parsed(commands: Any, arguments: Sequence[str], description: str | None) -> Any:
    """The command that the arguments ask for.

    Raises:
        ValueError: an option of a scene is not valid.
        SystemExit: what tyro does not understand, which it has told; and help.
    """
    given: dict[str, Any] = {"args": arguments, "prog": "probe-env", "description": description}
    try:
        with redirect_stderr(io.StringIO()), redirect_stdout(io.StringIO()):
            return tyro.cli(commands, **given)
    except SystemExit as stop:
        for error in _causes(stop):
            if isinstance(error, ValidationError):
                raise ValueError(explain(error, OPTIONS.get(error.title, error.title))) from error
    return tyro.cli(commands, **given)  # once more, aloud


def _causes(error: BaseException) -> Iterator[BaseException]:
    cause: BaseException | None = error
    while cause is not None:
        yield cause
        cause = cause.__cause__ or cause.__context__
