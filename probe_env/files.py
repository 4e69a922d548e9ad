"""Reads untrusted files: regular files of bounded size, text in UTF-8, TOML and NumPy archives of expected arrays.

Every error is one line, ``FILE: location: problem``, whatever the content or the name of the file.
"""

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
"""Flags of opening, if the system has them; without ``O_NONBLOCK`` opening a pipe would wait for its other end."""
MAX_LINE: Final = 2000
"""Most characters of an error."""
DEEPEST_KEY: Final = 16
"""Most parts of a dotted key in TOML; the parser's time is quadratic in their number."""
DEEP_KEY: Final = re.compile(
    r"""(?<![\w-])(?:(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){%d}""" % DEEPEST_KEY  # noqa: UP031
)
ENDLESS_NUMBER: Final = re.compile(r"(?<![0-9])[0-9]{4301}")
"""More digits than Python accepts in an integer; Python's error has no file name."""


class FileError(ValueError):
    """Raised for an invalid file; ``problem`` is location and reason. Nothing in the file was run or changed."""

    def __init__(self, path: str | Path, problem: str) -> None:
        self.path, self.problem = str(path), problem
        super().__init__(one_line(f"{escaped(str(path))}: {problem}"))

    def __reduce__(self) -> tuple[object, ...]:
        """Make the error picklable, for worker processes."""
        return type(self), (self.path, self.problem)


def one_line(text: str) -> str:
    """A text of bounded length for a terminal, with characters that are not printable replaced by escapes."""
    joined = "; ".join(part.strip() for part in text.splitlines() if part.strip()) if "\n" in text else text
    line = escaped(joined)
    half = MAX_LINE // 2  # an error begins with the file and ends with the reason
    return line if len(line) <= MAX_LINE else f"{line[:half]} ... {line[-half:]}"


def escaped(text: str) -> str:
    """A text with all characters that are not printable, also newlines, replaced by escapes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def open_regular(path: str | Path, max_bytes: int) -> BinaryIO:
    """Open a regular file of at most ``max_bytes`` bytes for reading.

    Raises:
        FileNotFoundError: no such file.
        FileError: a folder, pipe or device, too large, or not readable.
    """
    try:
        handle = os.open(path, FLAGS)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror}") from error
    except ValueError as error:  # such as a NUL character
        raise FileError(path, f"not the name of a file: {error}") from error
    file = os.fdopen(handle, "rb") if stat.S_ISREG(os.fstat(handle).st_mode) else None
    if file is None:
        kind = "a folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else "a pipe or a device"
        os.close(handle)
        raise FileError(path, f"{kind}, not a file")
    size = os.fstat(handle).st_size
    if size > max_bytes:
        file.close()
        raise FileError(path, f"{size} bytes are more than the {max_bytes} that such a file may have")
    return file


def read_bytes(path: str | Path, max_bytes: int) -> bytes:
    """The content of a regular file of at most ``max_bytes`` bytes; raises as ``open_regular``."""
    with open_regular(path, max_bytes) as file:
        try:
            size = os.fstat(file.fileno()).st_size
            content = file.read(size + 1)  # a longer request would take the memory for it
            if len(content) > size:
                content += file.read(max_bytes + 1 - len(content))
        except OSError as error:
            raise FileError(path, f"cannot be read: {error.strerror}") from error
    if len(content) > max_bytes:
        raise FileError(path, f"more than the {max_bytes} bytes that such a file may have")
    return content


def read_text(path: str | Path, max_bytes: int = MEBI) -> str:
    """The text of a file in UTF-8, with or without a byte order mark; raises as ``open_regular``."""
    return as_text(path, read_bytes(path, max_bytes))


def as_text(path: str | Path, content: bytes, first: int = 1) -> str:
    """Bytes of a file as text; ``first`` is the number of their first line.

    Raises:
        FileError: not UTF-8, a NUL character, or a number of thousands of digits.
    """
    try:
        text = content.decode("utf-8-sig")
        nul = text.find("\0")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + first
        problem = f"line {line}: not a text file in UTF-8 (byte 0x{content[error.start]:02x}): save it as UTF-8"
        raise FileError(path, problem) from error
    if nul >= 0:
        raise FileError(path, f"line {text.count(chr(10), 0, nul) + first}: not a text file: a NUL character")
    endless = ENDLESS_NUMBER.search(text)
    if endless:
        line = text.count("\n", 0, endless.start()) + first
        raise FileError(path, f"line {line}: a number of more than {endless.end() - endless.start() - 1} digits")
    return text


def read_toml(path: str | Path, max_bytes: int = MEBI) -> dict[str, Any]:
    """A TOML file as a dictionary."""
    text = read_text(path, max_bytes).replace("\r\n", "\n")
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


MAX_BYTES: Final = 512 * MEBI
KINDS: Final = {"f": "numbers", "U": "text"}
Array = npt.NDArray[Any]
_BROKEN = (zipfile.BadZipFile, zlib.error, ValueError, KeyError, OSError, EOFError, RuntimeError, MemoryError)


def read_arrays(path: Path, expected: Callable[[str], str]) -> dict[str, Array]:
    """The arrays of a .npz file by name.

    ``expected`` returns the kind of the array of a name ("f": float32 or float64, "U": text), "" if it is unexpected.

    Raises:
        FileNotFoundError: no such file.
        FileError: not an archive, too large, or an array that is unexpected, of another kind or not finite.
    """
    try:
        with open_regular(path, MAX_BYTES) as file:
            with zipfile.ZipFile(file) as archive:
                members = archive.infolist()
            total = sum(member.file_size for member in members)
            if total > MAX_BYTES or len({member.filename for member in members}) < len(members):
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
