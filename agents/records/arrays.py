"""Reads the safetensors file of an agent."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import numpy.typing as npt
import safetensors.numpy
from safetensors import SafetensorError

from probe_env.files import MEBI, FileError, read_bytes

MOST_BYTES: Final = 512 * MEBI
RESTORE: Final = "restore the file, or train again"
Array = npt.NDArray[Any]


def read_weights(path: Path) -> tuple[str, str, dict[str, Array]]:
    """Description (JSON text), hash and weights of an agent's bundle.

    Raises:
        FileNotFoundError: no such file.
        FileError: not a safetensors file with such a description.
    """
    content = read_bytes(path, MOST_BYTES)
    try:
        weights = safetensors.numpy.load(content)  # checks the header, which begins with its length
        metadata = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])["__metadata__"]
        return metadata["description"], metadata["hash"], weights
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        raise FileError(path, f"not an agent's bundle (.safetensors): {error} - {RESTORE}") from error
