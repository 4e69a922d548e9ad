"""Files that somebody else may have made: regular ones only, of bounded size, text where text is due.

Every error is one line, ``FILE: place: what is wrong``, whatever stands in the file or in its name. Of NumPy's archives
nothing is unpacked that is not expected.
"""

from __future__ import annotations

import io
import math
import os
import re
import stat
import tomllib
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import numpy.typing as npt

MEBI: Final = 1 << 20
FLAGS: Final = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_CLOEXEC", "O_BINARY"))
"""Of opening, where the system has them: a pipe would wait for its other end, between a look and its opening too."""
LONGEST_LINE: Final = 2000
"""Characters of an error."""
DEEPEST_KEY: Final = 16
"""Parts of a dotted key in TOML; the parser takes a time that grows with the square of them."""
DEEP_KEY: Final = re.compile(
    r"""(?<![\w-])(?:(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){%d}""" % DEEPEST_KEY  # noqa: UP031
)


ENDLESS_NUMBER: Final = re.compile(r"(?<![0-9])[0-9]{4301}")
"""More digits than Python reads of a whole number, which it says without the file's name; looked for where a number
begins alone, or long ones would be read over and over."""


class FileError(ValueError):
    """A file is not what it should be; nothing in it was run or changed.

    Args:
        path: the file.
        problem: place in it and what is wrong there.
    """

    def __init__(self, path: str | Path, problem: str) -> None:
        self.path, self.problem = str(path), problem
        super().__init__(one_line(f"{path}: {problem}"))

    def __reduce__(self) -> tuple[object, ...]:
        """Keep the error picklable, so that it can leave a worker process."""
        return type(self), (self.path, self.problem)


def one_line(text: str) -> str:
    """A text for a terminal: what is not printable (line ends, escape sequences) as escapes, and not endless."""
    joined = "; ".join(part.strip() for part in text.splitlines() if part.strip()) if "\n" in text else text
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in joined)
    return shown if len(shown) <= LONGEST_LINE else f"{shown[:LONGEST_LINE]} ..."


def open_regular(path: str | Path, most: int) -> BinaryIO:
    """Open a file for reading if it is a regular one of at most so many bytes.

    Raises:
        FileNotFoundError: no such file.
        FileError: a folder, pipe or device, too large, or not to be read.
    """
    try:
        handle = os.open(path, FLAGS)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror}") from error
    file = os.fdopen(handle, "rb") if stat.S_ISREG(os.fstat(handle).st_mode) else None
    if file is None:
        kind = "a folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else "a pipe or a device"
        os.close(handle)
        raise FileError(path, f"{kind}, not a file")
    size = os.fstat(handle).st_size
    if size > most:
        file.close()
        raise FileError(path, f"{size} bytes are more than the {most} that such a file may have")
    return file


def read_bytes(path: str | Path, most: int) -> bytes:
    """The content of a regular file of at most so many bytes; raises as ``open_regular``."""
    with open_regular(path, most) as file:
        try:
            content = file.read(most + 1)
        except OSError as error:
            raise FileError(path, f"cannot be read: {error.strerror}") from error
    if len(content) > most:  # it grew, or its kind of file system does not tell sizes
        raise FileError(path, f"more than the {most} bytes that such a file may have")
    return content


def read_text(path: str | Path, most: int = MEBI) -> str:
    """The text of a file in UTF-8, with or without a byte order mark; raises as ``open_regular``."""
    return as_text(path, read_bytes(path, most))


def as_text(path: str | Path, content: bytes, first: int = 1) -> str:
    """Bytes of a file as text; ``first`` is the number of their first line.

    Raises:
        FileError: not UTF-8, or with a NUL character or a number of thousands of digits, which no text has.
    """
    try:
        text = content.decode("utf-8-sig")
        place = text.find("\0")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + first
        problem = f"line {line}: not a text file in UTF-8 (byte 0x{content[error.start]:02x}): save it as UTF-8"
        raise FileError(path, problem) from error
    if place >= 0:
        raise FileError(path, f"line {text.count(chr(10), 0, place) + first}: not a text file: a NUL character")
    endless = ENDLESS_NUMBER.search(text)
    if endless:
        line = text.count("\n", 0, endless.start()) + first
        raise FileError(path, f"line {line}: a number of more than {endless.end() - endless.start() - 1} digits")
    return text


def read_toml(path: str | Path, most: int = MEBI) -> dict[str, Any]:
    """A TOML file as a dictionary.

    Raises:
        FileNotFoundError: no such file.
        FileError: as ``read_text``, not TOML, or nested beyond any use.
    """
    text = read_text(path, most).replace("\r\n", "\n")
    deep = DEEP_KEY.search(text)
    if deep:
        line = text.count("\n", 0, deep.start()) + 1
        raise FileError(path, f"line {line}: not a TOML file of this kind: a key of {DEEPEST_KEY} parts or more")
    try:
        return tomllib.loads(text)
    except ValueError as error:  # also whole numbers of thousands of digits
        raise FileError(path, f"not a TOML file: {error}") from error
    except RecursionError:
        raise FileError(path, "not a TOML file of this kind: nested too deeply") from None


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
