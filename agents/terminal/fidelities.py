"""A fidelity as a command takes it: a name, or the settings that an error advises."""

from __future__ import annotations

import ast

from pydantic import ValidationError

from probe_env.fidelity import Fidelity
from probe_env.settings import explain


def parse_fidelity(text: str, field: str = "fidelity") -> str | Fidelity:
    """The settings in braces, as errors write them; anything else is a name.

    Args:
        text: as on the command line.
        field: whose value it is, for the error.

    Raises:
        ValueError: not settings, or not valid ones.
    """
    if not text.lstrip().startswith("{"):
        return text
    try:
        return Fidelity.model_validate(ast.literal_eval(text.strip()))
    except ValidationError as error:
        raise ValueError(explain(error, field)) from error
    except (ValueError, SyntaxError, RecursionError, MemoryError) as error:
        raise ValueError(
            f"{field} = {text[:80]!r} is neither a name nor settings such as {{'method': 'imex'}}"
        ) from error
