"""NumPy's .npz files, read from their declared shapes and types on: nothing is unpacked that is not expected."""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from probe_env.files import MEBI, FileError, read_bytes

MOST_FILE: Final = 512 * MEBI
MOST_UNPACKED: Final = 512 * MEBI
MOST_MEMBERS: Final = 1000
MOST_HEADER: Final = 10_000
KINDS: Final = {"f": "numbers", "U": "text"}
Array = npt.NDArray[Any]


def read_arrays(path: Path, expected: Callable[[str], str]) -> dict[str, Array]:
    """The arrays of a file by their names.

    Args:
        path: of the file.
        expected: kind ("f": float32 or float64, "U": text) of the array of a name; "" if there is to be none.

    Raises:
        FileNotFoundError: no such file.
        FileError: no such archive, or an array twice, unexpected, of another kind, or larger than any; numbers that
            are not finite.
    """
    content = read_bytes(path, MOST_FILE)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            names = [member.filename for member in members]
            twice = [name for name in names if names.count(name) > 1] if len(names) <= MOST_MEMBERS else ["too many"]
            if twice:
                raise FileError(path, f"array {_named(twice[0])!r} is there more than once, or there are too many")
            total = sum(member.file_size for member in members)
            if total > MOST_UNPACKED:
                raise FileError(path, f"{total} bytes when unpacked are more than the {MOST_UNPACKED} of any such file")
            return {_named(member.filename): _array(path, archive, member, expected) for member in members}
    except FileError:
        raise
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, KeyError, NotImplementedError, RuntimeError):
        raise FileError(path, "not a whole archive of plain arrays (.npz); nothing in it was run") from None


def _named(member: str) -> str:
    return member.removesuffix(".npy")


def _array(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo, expected: Callable[[str], str]) -> Array:
    name = _named(member.filename)
    kind = expected(name) if member.filename.endswith(".npy") else ""
    if not kind:
        raise FileError(path, f"array {name!r}: no such array is expected")
    with archive.open(member) as file:
        shape, fortran, dtype = _header(path, name, file)
        if dtype.kind != kind or (kind == "f" and dtype.itemsize not in (4, 8)):
            raise FileError(path, f"array {name!r}: {dtype} where {KINDS[kind]} are expected")
        size = math.prod(shape) * dtype.itemsize
        if any(length < 0 for length in shape) or size > member.file_size:
            raise FileError(path, f"array {name!r}: its shape {shape} is more than the file holds")
        data = file.read(size + 1)
        if len(data) != size or file.read(1):
            raise FileError(path, f"array {name!r}: not as long as its shape {shape} says")
    values: Array = np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C").copy()
    if kind == "f" and not np.isfinite(values).all():
        raise FileError(path, f"array {name!r}: holds values that are not finite (NaN or infinite)")
    if kind == "U":
        "".join(values.ravel().tolist()).encode()  # raises where these are no characters
    return values


def _header(path: Path, name: str, file: Any) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    try:
        return readers[np.lib.format.read_magic(file)](file, max_header_size=MOST_HEADER)
    except (ValueError, KeyError, SyntaxError, TypeError, MemoryError, RecursionError):
        raise FileError(path, f"array {name!r}: not a plain array in NumPy's format") from None
