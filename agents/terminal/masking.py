"""Passwords out of what is printed or stored: database and cluster addresses carry them."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from typing import Final

HIDDEN: Final = "***"
_USER: Final = re.compile(r"(://[^:/?#@]*):.*@", re.DOTALL)
"""From the colon behind the user to the last @: passwords are often written without escapes."""
_ARGUMENT: Final = re.compile(r"([?&][^=&]*(?:pass|pwd|secret|token|key)[^=&]*=)[^&\s]*", re.IGNORECASE)


def masked(text: str) -> str:
    """An address, or an argument with one in it, with ``user:***@`` for ``user:password@``."""
    return _ARGUMENT.sub(rf"\1{HIDDEN}", _USER.sub(rf"\1:{HIDDEN}@", text)) if "://" in text else text


def masked_command(arguments: Sequence[str]) -> str:
    """Arguments of a command as one line for a shell, without passwords."""
    return shlex.join(map(masked, arguments))
