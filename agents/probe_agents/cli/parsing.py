"""Parses the arguments of a command with tyro; an error is one line."""

import ast
import inspect
import io
import os
import re
import shutil
from collections.abc import Sequence
from contextlib import redirect_stderr
from pathlib import Path
from typing import Annotated, Any, Final

import tyro
from pydantic import ValidationError

from probe_env.fidelity import Fidelity
from probe_env.settings import explain

OPTIONS: Final = {"Scene": "--scene", "Tube": "--scene.tube", "Probe": "--scene.probe", "Contact": "--scene.contact",
                  "Air": "--scene.air"}  # fmt: skip
"""Model -> prefix of its options."""
NARROWEST: Final = 40
"""Least width of the help [characters]."""


def hide_default(metavar: str | None = None) -> Any:
    """Settings of an option whose description states the default."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint="")


File = Annotated[Path | None, hide_default()]
"""An optional file or folder."""


def parse(name: str, kind: type[Any], arguments: Sequence[str], default: Any = None) -> Any:
    """The command, a dataclass, with the options of its arguments; ``default`` has other defaults of the options."""
    settings: dict[str, Any] = {} if default is None else {"default": default}
    settings |= {"prog": f"probe-env {name}", "description": inspect.getdoc(kind), "config": (tyro.conf.DisallowNone,)}
    printed = io.StringIO()
    if shutil.get_terminal_size().columns < NARROWEST:
        os.environ["COLUMNS"] = str(NARROWEST)  # tyro takes minutes to fit its help into fewer
    try:
        with redirect_stderr(printed):
            return tyro.cli(kind, args=arguments, **settings)
    except SystemExit as stop:
        if not stop.code:
            raise
        error: BaseException | None = stop
        while error is not None:
            if isinstance(error, ValidationError):
                raise ValueError(explain(error, OPTIONS.get(error.title, error.title))) from error
            error = error.__cause__ or error.__context__
        raise ValueError(_message(printed.getvalue())) from None


def _message(text: str) -> str:
    """The error in tyro's box as one line, without title and help texts."""
    lines = "\n".join(line.strip("│ ") for line in text.splitlines())
    _, *parts = re.split(r"^(?:[╭╰].*|[─-]{3,})$", lines, flags=re.MULTILINE)
    sentences = [" ".join(part.split()) for part in parts]
    message = "; ".join(s for s in sentences if s and not s.startswith(("Argument helptext", "For full helptext")))
    message = re.sub(r"no type matching .* Got errors: - <class '\w+'>: ", "", message)
    message = re.sub(r"invalid literal for int\(\) with base 10: (.*)", r"\1 is not a whole number", message)
    return re.sub(r"could not convert string to float: (.*)", r"\1 is not a number", message)


def positional(arguments: Sequence[str]) -> str | None:
    """The first argument that is neither an option nor its value, if every option has one value."""
    rest = iter(arguments)
    for argument in rest:
        if argument == "--":
            return next(rest, None)
        if not argument.startswith("-"):
            return argument
        if "=" not in argument and argument not in ("-h", "--help"):
            next(rest, None)
    return None


def parse_fidelity(text: str) -> str | Fidelity:
    """Value of the option ``--fidelity``: settings in braces as a ``Fidelity``; any other text is a name."""
    if not text.lstrip().startswith("{"):
        return text
    try:
        return Fidelity.model_validate(ast.literal_eval(text.strip()))
    except ValidationError as error:
        raise ValueError(explain(error, "fidelity")) from error
    except (ValueError, SyntaxError, RecursionError, MemoryError) as error:
        raise ValueError(
            f"fidelity = {text[:80]!r} is neither a name nor settings such as {{'method': 'imex'}}"
        ) from error
