"""A file as lines of text: any encoding, compressed files, sheets of workbooks, tables of pandas.

Libraries for binary files run in a process of their own, with bounded memory and time: damaged files can need any.
"""

import bz2
import codecs
import gzip
import io
import json
import lzma
import os
import re
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Final, NamedTuple

from probe_env.files import MEBI, FileError, read_bytes

MAX_BYTES: Final = 256 * MEBI
"""Size of a file, also unpacked."""
MAX_SECONDS, MAX_MEMORY = 60.0, 4 << 30
"""Time [s] and memory [bytes] of the process that reads binary files."""
_PACKED: Final = {b"\x1f\x8b": gzip, b"BZh": bz2, b"\xfd7zXZ": lzma}
_BROKEN: Final = (OSError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error, lzma.LZMAError)
_ZIP: Final = b"PK\x03\x04"
_BINARY: Final = {
    "workbook": rb"PK\x03\x04|\xd0\xcf\x11\xe0",
    "read_parquet": b"PAR1",
    "read_feather": b"ARROW1",
    "read_json": rb"(?:\xef\xbb\xbf)?\s*(?:\[\s*)?\{\s*\"",
}
"""Reader (of pandas, but for workbooks) -> how its files begin."""
_OTHER: Final = {b"MATLAB": "a MATLAB file", b"\x89HDF": "an HDF5 file", b"TDSm": "a TDMS file of LabVIEW"}
_CONTROL: Final = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")
_WRAPPED: Final = re.compile(r"""(?m)(?:^|[;,\t|]) *"(?:[^"\n]|"")*(?:\n(?:[^"\n]|"")*){1,5}"(?= *(?:[;,\t|]|$))""")
"""A quoted cell with up to five line breaks."""
WORKBOOKS: Final = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")
_WITH_SHEET: Final = re.compile(rf"(.+(?:{'|'.join(map(re.escape, WORKBOOKS))}))#(.+)", re.IGNORECASE)


def with_sheet(argument: str, sheet: str) -> str:
    """The argument of a workbook with the name of a sheet, for ``file_and_sheet``; others unchanged."""
    return f"{argument}#{sheet}" if argument.lower().endswith(WORKBOOKS) else argument


def file_and_sheet(path: str | Path) -> tuple[Path, str | None]:
    """A file and, of "plan.xlsx#Messung", the sheet of a workbook; an existing file has priority."""
    match = _WITH_SHEET.fullmatch(str(path))
    return (Path(match[1]), match[2]) if match and not Path(path).exists() else (Path(path), None)


class Source(NamedTuple):
    """Lines of a text, or rows of a sheet with cells separated by tabs."""

    lines: list[str]
    word: str = "row"  # word for a line in errors
    encoding: str = ""
    null: tuple[str, ...] = ()  # what marks missing values by a LAS header
    notes: tuple[str, ...] = ()  # repairs of the file


def read_sources(path: Path, sheet: str | None, encoding: str) -> dict[str, Source]:
    """The sheets of a file by name, or its only content by an empty name.

    Args:
        path: file.
        sheet: the sheet that is read of a workbook; None: all.
        encoding: of a text; empty: UTF-8 or UTF-16, else Windows' Western European.

    Raises:
        FileError: not a text or workbook; no such sheet; too large.
        ModuleNotFoundError: python-calamine is not installed.
    """
    content = _unpacked(path, read_bytes(path, MAX_BYTES))
    for begin, kind in _OTHER.items():
        if content.startswith(begin):
            raise FileError(path, f"{kind}: export it as CSV")
    reader = next((name for name, begin in _BINARY.items() if re.match(begin, content)), None)
    if sheet is not None and reader != "workbook":
        raise FileError(path, f"not a workbook, so it has no sheet {sheet[:80]!r}: leave --sheet out")
    if reader:
        return {name: Source(lines) for name, lines in _by_library(path, content, reader, sheet).items()}
    filled, cut = content.rstrip(b"\0"), 0
    if b"\0" not in filled:  # else UTF-16 or not a text
        content, cut = filled, len(content) - len(filled)
    text, encoding = _decoded(path, content, encoding)
    text = _WRAPPED.sub(lambda cell: cell[0].replace("\n", "\v"), text)
    lines, null = text.split("\n"), tuple[str, ...]()
    if "\v" in text:  # each line keeps its number
        lines = [part for line in lines for part in (line.replace("\v", " "), *[""] * line.count("\v"))]
    if lines[0].upper().startswith("~V"):
        lines, null = _las_lines(path, lines)
    if lines[0].startswith("Name\t") and any(line.startswith("SymbolComment") for line in lines[:40]):
        raise FileError(path, "a file of TwinCAT Scope: export it with one time column and the header 'Name' only")
    notes = (f"{cut} NUL bytes behind the last line, as of a power cut, were cut off.",) if cut else ()
    return {"": Source(lines, "line", encoding, null, notes)}


def guessed_encoding(path: Path) -> str:
    """The encoding of a text by charset-normalizer, from its first 64 KiB; empty if there is none."""
    from charset_normalizer import from_bytes

    best = from_bytes(_unpacked(path, read_bytes(path, MAX_BYTES))[: 1 << 16]).best()
    return best.encoding if best else ""


def _unpacked(path: Path, content: bytes) -> bytes:
    """Content of a compressed file, or of an archive of one file that is no workbook."""
    try:
        for begin, module in _PACKED.items():
            if content.startswith(begin):
                content = module.open(io.BytesIO(content)).read(MAX_BYTES + 1)
        if content.startswith(_ZIP):
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                names = [name for name in archive.namelist() if not name.endswith("/")]
                if not {"[Content_Types].xml", "mimetype"} & set(names):
                    if len(names) != 1:
                        listed = ", ".join(name[:60] for name in names[:5])
                        raise FileError(path, f"an archive of {len(names)} files, {listed}: unpack it, and name one")
                    content = archive.open(names[0]).read(MAX_BYTES + 1)
    except _BROKEN as error:
        problem = f"a compressed file or a workbook that is damaged ({type(error).__name__})"
        raise FileError(path, f"{problem}: copy or save it again") from error
    if len(content) > MAX_BYTES:
        raise FileError(path, f"more than the {MAX_BYTES} bytes that a log may have unpacked: cut it")
    return content


def _decoded(path: Path, content: bytes, encoding: str) -> tuple[str, str]:
    """Text and encoding of a file."""
    names, zeros = [encoding] if encoding else ["utf-8-sig", "cp1252"], [content[k:1000:2].count(0) for k in (0, 1)]
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        names = ["utf-16"]
    elif not encoding and max(zeros) > max(1.0, 0.4 * len(content[:1000])):
        names = ["utf-16-be" if zeros[0] > zeros[1] else "utf-16-le"]
    for name in names:
        try:
            text = content.decode(name)
            break
        except LookupError as error:
            raise ValueError(f"encoding = {encoding!r} is not known, unlike utf-8, cp1252, cp932 or cp1251") from error
        except UnicodeError as error:
            start = getattr(error, "start", 0)
            line, byte = content.count(b"\n", 0, start) + 1, content[start]
    else:
        hint = f"not a text in {encoding}" if encoding else "not a text file"
        raise FileError(
            path, f"line {line}: {hint} (byte 0x{byte:02x}): export it as text in UTF-8, or --encoding NAME"
        )
    text = text.rstrip("\x1a").replace("\r\n", "\n").replace("\r", "\n")  # end of file in DOS: Ctrl-Z
    text = text.replace("\u2212", "-").replace("\u2013", "-")
    if control := _CONTROL.search(text):
        line = text.count("\n", 0, control.start()) + 1
        problem = f"not a text file: a control character (0x{ord(control[0]):02x})"
        raise FileError(path, f"line {line}: {problem} - export it as text")
    return text, name


def _las_lines(path: Path, lines: Sequence[str]) -> tuple[list[str], tuple[str, ...]]:
    """Lines of a LAS 2.0 file (a log of a well) with its curves as heads and the other sections empty; its NULL."""
    section, heads, null = "", list[str](), tuple[str, ...]()
    for k, line in enumerate(lines):
        entry = re.match(r"\s*([^\s#.~][^.]*?)\s*\.(\S*)\s*(.*?)\s*:", line)
        name, unit, value = entry.groups() if entry else ("", "", "")
        if line.upper().startswith("~A") and heads:
            separator = "," if "," in "".join(lines[k + 1 : k + 2]) else " "
            return [*[""] * k, separator.join(heads), *lines[k + 1 :]], null
        if line.startswith("~"):
            section = line[1:2].upper()
        elif entry and section == "C":
            heads.append(name.replace(" ", "_") + f"[{unit}]" * bool(unit))
        elif name.upper() == "NULL":
            null = (value,)
        elif (name + value).upper() == "WRAPYES":
            raise FileError(path, f"line {k + 1}: a LAS file with wrapped rows: export it without WRAP, or as CSV")
    raise FileError(path, "a LAS file without the sections ~Curve and ~ASCII: export it again, or as CSV")


def _by_library(path: Path, content: bytes, reader: str, sheet: str | None) -> dict[str, list[str]]:
    """Sheets of a binary file, read in a process of its own."""
    if reader == "workbook":
        import_module("python_calamine")
    command = [sys.executable, "-P", "-m", "probe_agents.records.binary", reader, str(MAX_MEMORY)]
    threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}  # each has its own memory
    try:
        done = subprocess.run(
            command if sheet is None else [*command, sheet],
            input=content,
            capture_output=True,
            timeout=MAX_SECONDS,
            check=False,
            env=os.environ | threads,
        )
        answer = json.loads(done.stdout)
    except (subprocess.TimeoutExpired, ValueError) as error:
        problem = f"cannot be read within {MAX_SECONDS:g} s and {MAX_MEMORY >> 30} GiB of memory"
        raise FileError(path, f"{problem}: save it again, or export it as CSV") from error
    if isinstance(answer, str):
        raise FileError(path, answer)
    return dict(answer)
