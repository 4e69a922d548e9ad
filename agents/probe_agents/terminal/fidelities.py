"""Parses the option --fidelity: a name or settings."""

from __future__ import annotations

import ast

from pydantic import ValidationError

from probe_env.fidelity import Fidelity
from probe_env.settings import explain


def parse_fidelity(text: str, field: str = "fidelity") -> str | Fidelity:
    """Settings in braces as a ``Fidelity``; any other text is a name.

    Args:
        text: value of the option.
        field: name of the option, for the error.

    Raises:
        ValueError: invalid settings.
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
