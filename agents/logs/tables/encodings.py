"""The text of a file, whatever it is encoded in."""

from __future__ import annotations

import codecs
import re
from pathlib import Path
from typing import Final

from probe_env.files import MEBI, FileError

MOST_BYTES: Final = 256 * MEBI
_CONTROL: Final = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")


def decoded(path: Path, content: bytes) -> str:
    """The text of a file: UTF-8, UTF-16, or else what Windows writes in Western Europe.

    Raises:
        FileError: not a text.
    """
    utf16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    begin = content[:1000]
    if content.startswith(utf16):
        names = ["utf-16"]
    elif len(begin) > 3 and begin[1::2].count(0) > 0.4 * len(begin):
        names = ["utf-16-le"]
    elif len(begin) > 3 and begin[::2].count(0) > 0.4 * len(begin):
        names = ["utf-16-be"]
    else:
        names = ["utf-8-sig", "cp1252"]
    text = None
    for name in names:
        try:
            text = content.decode(name)
            break
        except UnicodeDecodeError as error:
            place, byte = content.count(b"\n", 0, error.start) + 1, content[error.start]
    if text is None:
        raise FileError(path, f"line {place}: not a text file (byte 0x{byte:02x}): export it as text in UTF-8")
    text = text.rstrip("\x1a").replace("\r\n", "\n").replace("\r", "\n")  # DOS ended files with Ctrl-Z
    control = _CONTROL.search(text)
    if control:
        line = text.count("\n", 0, control.start()) + 1
        raise FileError(
            path, f"line {line}: not a text file: a control character (0x{ord(control[0]):02x}) - export it as text"
        )
    return text
