"""Files that somebody else may have made: regular ones only, of bounded size, text where text is due.

Every error is one line, ``FILE: place: what is wrong``, whatever stands in the file or in its name. Of NumPy's archives
nothing is unpacked that is not expected.
"""

from __future__ import annotations

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
"""More digits than Python reads of a whole number; Python's own error has no file name."""


class FileError(ValueError):
    """A file is not what it should be: ``problem`` says where in it and why; nothing in it was run or changed."""

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


MOST_BYTES: Final = 512 * MEBI
KINDS: Final = {"f": "numbers", "U": "text"}
Array = npt.NDArray[Any]
_BROKEN = (zipfile.BadZipFile, zlib.error, ValueError, KeyError, OSError, EOFError, RuntimeError, MemoryError)


def read_arrays(path: Path, expected: Callable[[str], str]) -> dict[str, Array]:
    """The arrays of a .npz file by name.

    ``expected`` is the kind of the array of a name ("f": float32 or float64, "U": text), "" if there must be none.

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
    except _BROKEN as error:
        raise FileError(path, "not a whole archive of plain arrays (.npz); nothing in it was run") from error
    for name, values in content.items():
        kind = expected(name)
        if not isinstance(values, np.ndarray) or values.dtype.kind != kind or values.dtype.itemsize == 2:
            problem = f"of another kind than {KINDS[kind]}" if kind else "no such array is expected"
            raise FileError(path, f"array {name!r}: {problem}")
        if kind == "f" and not np.isfinite(values).all():
            raise FileError(path, f"array {name!r}: holds values that are not finite (NaN or infinite)")
    return content
