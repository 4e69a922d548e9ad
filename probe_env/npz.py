"""Reads arrays from NumPy's .npz files without pickles."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from probe_env.files import MEBI, FileError, open_regular

MOST_BYTES: Final = 512 * MEBI
KINDS: Final = {"f": "numbers", "U": "text"}
Array = npt.NDArray[Any]


def read_arrays(path: Path, expected: Callable[[str], str]) -> dict[str, Array]:
    """The arrays of a .npz file by name.

    Args:
        path: of the file.
        expected: kind ("f": float32 or float64, "U": text) of the array of a name; "" if there must be none.

    Raises:
        FileNotFoundError: no such file.
        FileError: not such an archive, too large, or an array that is unexpected, of another kind or not finite.
    """
    try:
        with open_regular(path, MOST_BYTES) as file:
            with zipfile.ZipFile(file) as archive:
                members = archive.infolist()
            total = sum(member.file_size for member in members)
            if total > MOST_BYTES or len({member.filename for member in members}) < len(members):
                raise ValueError(f"{total} bytes when unpacked, or an array twice")
            with np.load(file, allow_pickle=False) as arrays:
                content = {name: arrays[name] for name in arrays.files}
    except (FileError, FileNotFoundError):
        raise
    except (
        zipfile.BadZipFile,
        zlib.error,
        ValueError,
        KeyError,
        OSError,
        EOFError,
        RuntimeError,
        MemoryError,
    ) as error:
        raise FileError(path, "not a whole archive of plain arrays (.npz); nothing in it was run") from error
    for name, values in content.items():
        kind = expected(name)
        if not isinstance(values, np.ndarray) or values.dtype.kind != kind or values.dtype.itemsize == 2:
            problem = f"of another kind than {KINDS[kind]}" if kind else "no such array is expected"
            raise FileError(path, f"array {name!r}: {problem}")
        if kind == "f" and not np.isfinite(values).all():
            raise FileError(path, f"array {name!r}: holds values that are not finite (NaN or infinite)")
    return content
