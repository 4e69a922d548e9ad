"""Logs of known values, and damaged ones: read right, or refused in one line within 10 s, never a wrong number."""

import csv
import io
import os
import re
import time
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path
from typing import NamedTuple

import numpy as np
import openpyxl
import pytest

from probe_agents.plant import logs
from probe_agents.records.reader import Channels
from probe_env.files import FileError

MUTANTS = int(os.environ.get("LOG_MUTANTS", "390"))
"""Number of mutants in all; 3000 take about a minute."""
FOLDER = Path(__file__).parent / "field"
FILES = (
    "quality-columns.csv", "normal-cubic-metres.csv", "catman.txt", "epoch-nanoseconds.csv", "header-again.csv",
    "zone-names.csv", "zone-in-brackets.csv", "javascript-dates.csv", "iec-durations.csv", "ignition.csv",
    "summary-rows.csv", "values-with-units.csv",
)  # fmt: skip
ROWS = 30
UNITS = {  # unit -> SI value of one, decimals
    "inserted_length": {"m": (1.0, 3), "mm": (1e-3, 1), "cm": (1e-2, 2), "ft": (0.3048, 4)},
    "feed_speed": {"m/s": (1.0, 4), "mm/s": (1e-3, 1), "m/min": (1 / 60, 4), "ft/min": (0.3048 / 60, 2)},
    "air_supply": {"m3/h": (1 / 3600, 1), "l/min": (1 / 60_000, 1), "m³/h": (1 / 3600, 1)},
    "root_tension": {"N": (1.0, 3), "kN": (1e3, 5), "lbf": (4.4482216152605, 4)},
}
HEADS = {
    "time": ("time", "Time", "Timestamp", "Zeit", "TIME"),
    "inserted_length": ("position", "Length", "Weg", "Einschublänge", "Encoder"),
    "feed_speed": ("speed", "Feed", "Vorschub", "VELOCITY"),
    "air_supply": ("air", "Air flow", "Luft", "Volumenstrom"),
    "root_tension": ("tension", "Zugkraft", "Root tension"),
    "date": ("Date", "Datum"),
    "": ("Pressure [bar]", "Note", "Temp", "RECORD"),
}
FORMS: dict[str, float | str] = {  # of time: units in a second, or for ``strftime``
    "s": 1.0, "ms": 1e3, "min": 1 / 60, "epoch": 1.0, "ns": 1e9,
    "iso": "%Y-%m-%d %H:%M:%S", "zone": "%Y-%m-%dT%H:%M:%S+01:00", "German": "%d.%m.%Y %H:%M:%S",
    "American": "%m/%d/%Y %I:%M:%S %p", "clock": "%H:%M:%S", "date": "%H:%M:%S",
}  # fmt: skip


class Source(NamedTuple):
    """A log that is read right, as lines of text."""

    lines: list[str]
    first: int  # index of the first row
    separator: str
    sign: str
    encoding: str = "utf-8"
    newline: str = "\n"
    sheet: bool = False

    def encoded(self, lines: list[str]) -> bytes:
        """Content of a file with other lines."""
        if not self.sheet:
            return self.newline.join([*lines, ""]).encode(self.encoding, "replace")
        book, buffer = openpyxl.Workbook(), io.BytesIO()
        for line in lines:
            book.active.append([float(c) if re.fullmatch(r"-?\d+\.?\d*", c) else c for c in line.split("\t")])
        book.save(buffer)
        return buffer.getvalue()

    def decoded(self, content: bytes) -> list[str]:
        """Lines of a damaged file."""
        first = "utf-16" if content[:2] == b"\xff\xfe" else self.encoding.replace("cp1252", "utf-8")
        for encoding in (first, "cp1252"):
            try:
                text = content.decode(encoding).rstrip("\x1a\0").replace("\u2212", "-").lstrip("\ufeff")
                return re.split("\r\n|\r|\n", text)
            except UnicodeDecodeError:
                continue
        return []


def random_log(rng: np.random.Generator) -> tuple[Source, dict[str, np.ndarray]]:
    """A log that needs no option, and the values of its rows (rows,) in SI units."""
    seconds = np.arange(ROWS) * float(rng.choice([0.5, 1.0, 2.0]))
    form = str(rng.choice(list(FORMS)))
    if not isinstance(FORMS[form], float):
        seconds = np.arange(ROWS) * float(rng.choice([1.0, 2.0]))
    speed = 0.2 + 0.05 * np.sin(np.arange(ROWS) / 4.0)
    length = 5.0 + np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(seconds)))
    truth = {
        "inserted_length": length, "feed_speed": speed,
        "air_supply": (63.3 + np.arange(ROWS) % 4) / 3600.0, "root_tension": 12.3 + 0.17 * np.arange(ROWS),
    }  # fmt: skip
    for name in ("root_tension", str(rng.choice(["feed_speed", "inserted_length"]))):
        if rng.random() < 0.3:
            del truth[name]
    columns = [("date",)] * (form == "date") + [("time",)]
    columns += [(name,) for name in truth] + [("",)] * int(rng.integers(0, 2))
    columns = [columns[k][0] for k in rng.permutation(len(columns))]
    style = str(rng.choice(["[]", "()", "below", "_"]))
    separator, sign = ((",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), ("|", "."))[rng.integers(6)]
    sheet = rng.random() < 0.08
    if sheet:
        separator, sign = "\t", "."
    start = datetime(2025, 3, 12, 23, 59, 50) if rng.random() < 0.5 else datetime(2025, 11, 4, 9, 59, 40)
    heads, units, texts = list[str](), list[str](), list[list[str]]()
    for name in columns:
        words, unit = str(rng.choice(HEADS[name])), ""
        if name == "time":
            per_second = FORMS[form]
            if isinstance(per_second, float):
                origin, unit = (1.7e9, "s") if form == "epoch" else (1.7e9 if form == "ns" else 0.0, form)
                decimals = {"min": 5, "ns": 0}.get(form, 1)
                texts.append([f"{per_second * (origin + t):.{decimals}f}" for t in seconds])
            else:
                texts.append([(start + timedelta(seconds=t)).strftime(per_second) for t in seconds])
        elif name == "date":
            texts.append([(start + timedelta(seconds=t)).strftime("%Y-%m-%d") for t in seconds])
        elif not name:
            texts.append([str(rng.choice(["ok", "1.013", "x"]))] * ROWS)
        else:
            unit = str(rng.choice(list(UNITS[name])))
            scale, decimals = UNITS[name][unit]
            texts.append([f"{value / scale:.{decimals}f}" for value in truth[name]])
            truth[name] = scale * np.array(texts[-1], dtype=float)
        units.append(unit)
        if unit and style in ("[]", "()"):
            words += f" {style[0]}{unit}{style[1]}"
        elif unit and style == "_":
            words = words.replace(" ", "_") + "_" + unit.replace("/", "_per_").replace("³", "3")
        heads.append(words)
    truth["time"] = seconds

    def line(cells: tuple[str, ...]) -> str:
        texts = [c if re.search(r"\d\.\d+\.", c) else c.replace(".", sign) for c in cells]  # dates keep their points
        return separator.join(f'"{text}"' if quoted else text for text in texts)

    quoted = rng.random() < 0.15 and not sheet
    above = ["Rig 7", "Operator: N. N.", ""][: int(rng.integers(0, 4))]
    above += [line(tuple(heads)), *[separator.join(units)] * (style == "below")]
    source = Source(
        [*above, *map(line, zip(*texts, strict=True))], len(above), separator, sign,
        str(rng.choice(["utf-8", "utf-8-sig", "utf-16", "cp1252", "utf-16-le"])),
        str(rng.choice(["\n", "\r\n", "\r"])), sheet,
    )  # fmt: skip
    return source, truth


Change = Callable[[np.random.Generator, Source, list[str], int], list[str]]
"""Lines of a file with row k changed."""


def changed_cell(change: Callable[[np.random.Generator, str], str]) -> Change:
    """Change one cell of a row."""

    def mutate(rng: np.random.Generator, source: Source, lines: list[str], k: int) -> list[str]:
        cells = lines[k].split(source.separator)
        j = int(rng.integers(len(cells)))
        cells[j] = change(rng, cells[j])
        return [*lines[:k], source.separator.join(cells), *lines[k + 1 :]]

    return mutate


def changed_column(change: Callable[[str], str]) -> Change:
    """Change the cells of a column from a row on."""

    def mutate(rng: np.random.Generator, source: Source, lines: list[str], k: int) -> list[str]:
        rows = [line.split(source.separator) for line in lines[k:]]
        j = int(rng.integers(len(rows[0])))
        for row in rows:
            row[j:] = [*map(change, row[j : j + 1]), *row[j + 1 :]]
        return [*lines[:k], *(source.separator.join(row) for row in rows)]

    return mutate


def changed_head(change: Callable[[np.random.Generator, str], str]) -> Change:
    def mutate(rng: np.random.Generator, source: Source, lines: list[str], k: int) -> list[str]:
        at = int(rng.integers(max(source.first - 2, 0), source.first))
        return [*lines[:at], change(rng, lines[at]), *lines[at + 1 :]]

    return mutate


def other_unit(rng: np.random.Generator, text: str) -> str:
    """A head or a row of units in which one is another of its dimension, or missing."""
    kinds = [("s", "ms", "min", "h"), *map(tuple, UNITS.values())]
    units = [(unit, kind) for kind in kinds for unit in kind]
    for k in rng.permutation(len(units)):
        unit, kind = units[k]
        pattern = rf"(?<=[\[(]){re.escape(unit)}(?=[\])])|(?<=_){re.escape(unit.replace('/', '_per_'))}\b"
        if found := re.search(pattern, text):
            new = str(rng.choice([other for other in ("", *kind) if other != unit]))
            return text[: found.start()] + new.replace("/", "_per_" if "_" in text else "/") + text[found.end() :]
    return text


def without_character(rng: np.random.Generator, text: str) -> str:
    k = int(rng.integers(max(len(text), 1)))
    return text[:k] + text[k + 1 :]


def with_character(rng: np.random.Generator, text: str) -> str:
    k = int(rng.integers(len(text) + 1))
    return text[:k] + str(rng.choice(list("0179.,-+eE :;\t|'\"#%xN°\u00a0\u2212/"))) + text[k:]


def other_sign(text: str) -> str:
    return text.translate(str.maketrans(".,", ",."))


WORDS = (
    "",
    "Bad",
    "N/A",
    "---",
    "#REF!",
    "NaN",
    "1e999",
    "-9999",
    "9999",
    "0",
    "OVER",
    "0x1F",
    "1 234",
    "5.2 m",
    "12:5",
)
CHANGES: dict[str, Change] = {
    "cut line": lambda rng, source, lines, k: [*lines[:k], *lines[k + 1 :]],
    "cut lines": lambda rng, source, lines, k: [*lines[:k], *lines[k + 9 :]],
    "doubled line": lambda rng, source, lines, k: [*lines[: k + 1], *lines[k:]],
    "swapped lines": lambda rng, source, lines, k: [*lines[: k - 1], lines[k], lines[k - 1], *lines[k + 1 :]],
    "moved line": lambda rng, source, lines, k: [*lines[:k], *lines[k + 1 :], lines[k]],
    "end first": lambda rng, source, lines, k: [*lines[: source.first], *lines[k:], *lines[source.first : k]],
    "file again": lambda rng, source, lines, k: lines + lines,
    "header again": lambda rng, source, lines, k: [*lines[:k], *lines[: source.first], *lines[k:]],
    "no header": lambda rng, source, lines, k: lines[source.first :],
    "no line break": lambda rng, source, lines, k: [*lines[: k - 1], lines[k - 1] + lines[k], *lines[k + 1 :]],
    "line break": lambda rng, source, lines, k: [
        *lines[:k], lines[k][: len(lines[k]) // 2], lines[k][len(lines[k]) // 2 :], *lines[k + 1 :]
    ],
    "cut row": lambda rng, source, lines, k: [*lines[:k], lines[k][: rng.integers(len(lines[k]) + 1)], *lines[k + 1 :]],
    "truncated": lambda rng, source, lines, k: [*lines[:k], lines[k][: rng.integers(len(lines[k]) + 1)]],
    "comment": lambda rng, source, lines, k: [*lines[:k], "# stopped by hand", *lines[k:]],
    "remark": lambda rng, source, lines, k: [*lines[:k], "stopped by hand", *lines[k:]],
    "summary": lambda rng, source, lines, k: [
        *lines, "", source.separator.join(["Mean", *["5.0"] * lines[k].count(source.separator)])
    ],
    "long line": lambda rng, source, lines, k: [*lines[:k], lines[k] + "9" * 100_000, *lines[k + 1 :]],
    "long text": lambda rng, source, lines, k: [*lines[:k], "x" * 100_000, *lines[k:]],
    "word": changed_cell(lambda rng, text: str(rng.choice(WORDS))),
    "character less": changed_cell(without_character),
    "character more": changed_cell(with_character),
    "sign of one number": changed_cell(lambda rng, text: other_sign(text)),
    "sign from here on": changed_column(other_sign),
    "empty from here on": changed_column(lambda text: ""),
    "stuck from here on": lambda rng, source, lines, k: [*lines[:k], *[lines[k]] * (len(lines) - k)],
    "quotes from here on": changed_column(lambda text: f'"{text}"'),
    "a quote": changed_cell(lambda rng, text: '"' + text),
    "head: character less": changed_head(without_character),
    "head: character more": changed_head(with_character),
    "head: other unit": changed_head(other_unit),
    "head: empty": changed_head(lambda rng, text: ""),
    "head: cut": changed_head(lambda rng, text: text[: len(text) // 2]),
    "a separator more": lambda rng, source, lines, k: [*lines[:k], lines[k] + source.separator, *lines[k + 1 :]],
    "another separator": lambda rng, source, lines, k: [
        *lines[:k], *(line.replace(source.separator, str(rng.choice([";", "\t", " "]))) for line in lines[k:])
    ],
}  # fmt: skip


def flipped(rng: np.random.Generator, content: bytes) -> bytes:
    k = int(rng.integers(len(content)))
    return content[:k] + bytes([content[k] ^ (1 << int(rng.integers(8)))]) + content[k + 1 :]


def inserted(rng: np.random.Generator, content: bytes, new: bytes) -> bytes:
    k = int(rng.integers(len(content)))
    return content[:k] + new + content[k:]


DAMAGE: dict[str, Callable[[np.random.Generator, bytes], bytes]] = {
    "flipped bit": flipped,
    "flipped bits": lambda rng, content: flipped(rng, flipped(rng, flipped(rng, content))),
    "cut": lambda rng, content: content[: rng.integers(len(content))],
    "cut at the begin": lambda rng, content: content[rng.integers(len(content)) :],
    "a byte less": lambda rng, content: content[: (k := int(rng.integers(len(content))))] + content[k + 1 :],
    "NUL": lambda rng, content: inserted(rng, content, b"\0"),
    "NULs": lambda rng, content: inserted(rng, content, bytes(512)),
    "NULs at the end": lambda rng, content: content + bytes(512),
    "byte order mark": lambda rng, content: inserted(rng, content, b"\xef\xbb\xbf"),
    "zeroed": lambda rng, content: content[: (k := int(rng.integers(len(content))))] + bytes(100) + content[k + 100 :],
    "line ends": lambda rng, content: content.replace(b"\n", b"\r\n", int(rng.integers(1, 9))),
    "no line ends": lambda rng, content: content.replace(b"\n", b"").replace(b"\r", b""),
}


def mutant(source: Source, rng: np.random.Generator) -> tuple[str, bytes, list[str]]:
    """Names of one or two changes, content and lines of a changed file; those of a workbook before damage to bytes."""
    names = [str(name) for name in rng.choice([*CHANGES, *DAMAGE], int(rng.integers(1, 3)))]
    lines = list(source.lines)
    for name in names:
        if name in CHANGES:
            k = int(rng.integers(min(source.first + 1, len(lines) - 1), len(lines)))
            lines = CHANGES[name](rng, source, lines, k)
    content = source.encoded(lines)
    for name in names:
        if name in DAMAGE and content:
            content = DAMAGE[name](rng, content)
    return " + ".join(names), content, lines if source.sheet else source.decoded(content)


def number(cell: str, sign: str) -> float:
    """The number that a cell plainly says, NaN if it says none; groups of thousands are separated by spaces."""
    text = re.sub(r"(?<=\d)[ \u00a0](?=\d{3}\b)", "", cell.strip(' "\t\u00a0\ufeff').replace("\u2212", "-"))
    text = text.replace(".", "x").replace(",", ".") if sign == "," else text
    return (
        float(text.replace(" ", "")) if re.fullmatch(r"[+-]? *(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", text) else np.nan
    )


def wrong_numbers(source: Source, lines: list[str], good: Channels, read: Channels) -> list[str]:
    """What is wrong in a changed file that is read.

    Unchanged lines have their values, but for a factor if the head changed, which may declare another unit; other lines
    have the numbers that their cells say, or none.
    """
    rows = {source.lines[number - 1]: k for k, number in enumerate(good.table.lines)}
    used = [lines[number - 1] if number <= len(lines) else "" for number in read.table.lines]
    row = np.array([rows.get(line, -1) for line in used])
    same, problems, ratios = row >= 0, list[str](), dict[str, float]()
    if not same.any():
        return []  # nothing to compare with
    for name, values in (("time", read.time), *read.values.items()):
        if name not in good.indices and name != "time":
            problems.append(f"{name} is not in the file")
            continue
        place, column = good.indices[name], read.indices[name]
        expected = (good.time if name == "time" else good.values[name])[row]
        tolerance = 1e-9 + 1e-6 * float(np.nan_to_num(np.abs(expected[same])).max())
        if name == "time":
            begin = int(same.argmax())
            values, expected, tolerance = values - values[begin], expected - expected[begin], 1e-3
        heads = [(table.heads[k], table.units[k]) for table, k in ((good.table, place), (read.table, column))]
        if heads[0] != heads[1] and (large := same & (np.abs(expected) > 1e3 * tolerance)).any():
            ratios[name] = float(np.median(values[large] / expected[large]))
        ratio = ratios.get(name, 1.0)
        equal = np.isclose(values, ratio * expected, rtol=1e-9, atol=tolerance * abs(ratio), equal_nan=True)
        if (wrong := same & ~equal).any():
            k = int(wrong.argmax())
            problems.append(f"{name} of {used[k][:200]!r} is {values[k]:.9g}, not {expected[k]:.9g}")
        if name == "time":
            continue
        largest = int(np.nan_to_num(np.abs(good.values[name])).argmax())
        cell, unit = cell_and_unit(source, source.lines[good.table.lines[largest] - 1], place)
        factor = ratio * good.values[name][largest] / number(cell, source.sign)
        for k in np.flatnonzero(~same & ~np.isnan(values)):
            if used[k].count('"') % 2:
                continue  # a cell with a line break
            cell, other = cell_and_unit(source, used[k], place)
            says = number(cell, source.sign) * factor if other == unit else np.nan
            if not np.isclose(values[k], says, rtol=1e-6, atol=1e-9):
                problems.append(f"{name} of {used[k][:200]!r} is {values[k]:.9g}, but its cell says {says:.9g}")
                break
    if {"feed_speed", "inserted_length"} <= set(read.values):
        way = ratios.get("feed_speed", 1.0) * ratios.get("time", 1.0) / ratios.get("inserted_length", 1.0)
        if not 0.1 < way < 10.0:
            problems.append(f"speed times time is {way:.3g} times the way of the encoder")
    dropped = [line for line in rows if line in lines and line not in used]
    if dropped and set(read.notes) <= set(good.notes):
        problems.append(f"a row is left out without a note: {dropped[0][:200]!r}")
    return problems


def cell_and_unit(source: Source, line: str, place: int) -> tuple[str, str]:
    """Cell of a line without the unit behind the number, and that unit."""
    cells = next(csv.reader([line], delimiter=source.separator)) if '"' in line else line.split(source.separator)
    cells += [""] * (place + 1)
    found = re.fullmatch(r"(.*?\d) ?([A-Za-zµ°]\S*)", cells[place].strip(' "'))
    return (found[1], found[2]) if found and np.isnan(number(cells[place], source.sign)) else (cells[place], "")


@pytest.fixture
def read(tmp_path, monkeypatch):
    """Read a log of this content; gives its channels before repairs."""
    path, found, read_channels = tmp_path / "rig.log", [], logs.read_channels

    def recorded(*arguments, **settings):
        found.append(read_channels(*arguments, **settings))
        return found[-1]

    def run(content: bytes) -> Channels:
        path.write_bytes(content)
        begin = time.monotonic()
        try:
            logs.read_log(path)
        except FileError as error:
            if not str(error).startswith(str(path)) or not str(error).isprintable():
                raise AssertionError(f"not a line about the file: {error!s:.300}") from error
            raise
        finally:
            assert time.monotonic() - begin < 10.0
        return found[-1]

    monkeypatch.setattr(logs, "read_channels", recorded)
    return run


def random_good_log(seed: int, read) -> tuple[Source, Channels]:
    """A log and its channels, which equal what it was made from."""
    source, truth = random_log(np.random.default_rng(seed))
    channels = read(source.encoded(source.lines))
    assert channels.time - channels.time[0] == pytest.approx(truth.pop("time"), abs=1e-3)
    assert set(channels.values) == set(truth)
    for name, values in truth.items():
        assert channels.values[name] == pytest.approx(values, rel=1e-9)
    return source, channels


def test_random_logs_are_read(read):
    for seed in range(60):
        random_good_log(seed, read)


TENSION = "time [s];length [m];air [m3/h];tension [N]\n"
SPEED = "time [s];length [m];feed [{}];air [m3/h]\n"
FOUND = {  # by mutants: content -> whether it may be read; then there is a note
    "a decimal comma that looks like thousands": (TENSION + "0;5.0;63;2.25\n1;5.2;63;2,360\n2;5.4;63;2.47\n", False),
    "a decimal point that looks like thousands": (TENSION + "0;5,0;63;2,25\n1;5,2;63;2.360\n2;5,4;63;2,47\n", False),
    "an exponent alone": (TENSION + "0;5.0;63;2.25\n1;5.2;63;e5\n2;5.4;63;2.47\n", False),
    "a speed 1000 times the encoder's": (SPEED.format("m/s") + "0;5;0.2;63\n1;5.0002;0.2;63\n2;5.0004;0.2;63\n", False),
    "a speed 1000 times as slow": (SPEED.format("mm/s") + "0;5.0;0.2;63\n1;5.2;0.2;63\n2;5.4;0.2;63\n", False),
    "rows above the header": (TENSION.replace("m]", "") + "0;5.0;63;2\n" + TENSION + "1;5.2;63;2\n2;5.4;63;2\n", True),
    "a row that begins like a comment": (TENSION + "0;5.0;63;2\n!1;5.2;63;2\n2;5.4;63;2\n3;5.6;63;2\n", True),
    "no unit of the first column": ("Time|Length|Air\n|m|m3/h\n9:59:01|5|63\n9:59:02|5.2|63\n9:59:03|5.4|63\n", None),
    "a long word above the header": ("9" * 30_000 + "x\n" + TENSION + "0;5.0;63;2\n1;5.2;63;2\n2;5.4;63;2\n", None),
    "many spaces in a heading": (
        f"{TENSION[:-1]};a{' ' * 20_000}b\n0;5.0;63;2;1\n1;5.2;63;2;1\n2;5.4;63;2;1\n", True
    ),
    "many spaces in a cell": (TENSION + f"0;5.0;63;2{' ' * 60_000}!\n1;5.2;63;2\n2;5.4;63;2\n", False),
}  # fmt: skip


@pytest.mark.parametrize("name", FOUND)
def test_what_mutants_found(name, read):
    content, with_note = FOUND[name]
    if with_note is False:
        with pytest.raises(FileError):
            read(content.encode())
        return
    channels = read(content.encode())
    assert channels.values["inserted_length"][-1] in (5.4, 5.6)
    assert bool(channels.notes) == bool(with_note)


def check_mutants(sources: Callable[[int], tuple[Source, Channels]], seeds: range, read) -> None:
    failures = []
    for seed in seeds:
        source, good = sources(seed)
        name, content, lines = mutant(source, np.random.default_rng(seed))
        try:
            failures += [(seed, name, problem) for problem in wrong_numbers(source, lines, good, read(content))]
        except FileError:
            continue
        except Exception as error:  # refused by another error, or not in one line
            failures.append((seed, name, repr(error)))
    assert failures == []


@pytest.mark.slow
def test_mutants_of_random_logs(read):
    check_mutants(lambda seed: random_good_log(seed, read), range(MUTANTS // 2), read)


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_mutants_of_files(name, read):
    content = (FOLDER / name).read_bytes()
    text = content.decode().replace("\r\n", "\n")
    good = read(text.encode())
    separator, lines = good.table.separator, text.split("\n")[:-1]
    sign = "," if separator == "\t" else "."
    source = Source(lines, int(good.table.lines[0]) - 1, separator, sign)
    count = MUTANTS // 2 // len(FILES)
    check_mutants(lambda _: (source, good), range(begin := count * FILES.index(name), begin + count), read)
