"""Header, units and cells of a file: lines with any separator, or rows of a sheet, as columns of texts."""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import tyro

from probe_agents.records.quantities import (
    DATE,
    NAMES,
    ColumnOption,
    looks_like_unit,
    normalized,
    parse_columns,
    quantity_of,
    split_head,
)
from probe_agents.records.sources import Source, guessed_encoding, read_sources
from probe_agents.records.times import MISSING, matches
from probe_env.files import FileError
from probe_env.schedule import AIR, CSV_COMMENT, RANGES
from probe_env.settings import within

IntArray = npt.NDArray[np.integer]
Repeated = tyro.conf.UseAppendAction[tuple[str, ...]]
MAX_ROWS, MAX_COLUMNS = 5_000_000, 256
HEAD_WITHIN: Final = 200
"""Number of non-empty lines within which the header must be."""
HEADS_SHOWN: Final = 12
SEPARATORS: Final = {";": "';'", "\t": "tabs", "|": "'|'", ",": "','", " ": "spaces"}
_COMMENT: Final = r"^\s*[#%!]|^[\s|:;,+=-]*$"
"""Comments, empty lines, also of separators, and lines of dashes between header and rows."""
_TOO_NARROW: Final = r"^\s*#{2,}\s*[;,\t|]"
"""A cell of ####, as Excel writes a time in a narrow column."""
_SUMMARY: Final = (
    r'(?i)^[\s"]*(?:min|max|mean|average|avg|median|std|stdev|sum|total|rms|mittel|mittelwert|summe)'
    r'(?:imum)?[.:]?"?\s*(?:[;,\t| ].*)?[;,\t| ]\s*"?[+-]?\d'
)
"""A row of statistics."""
_SPACED_TIME: Final = (
    r"(\d{1,4}[-/.]\w{1,3}[-/.]\d{1,4})[ \t]+(\d{1,2}:\d\d)", r"\1T\2"
), (r"(?i)(:\d\d(?:[.,]\d+)?)[ \t]+([ap]\.?m)\b", r"\1\2")  # fmt: skip
"""Date and clock, and clock and AM, which belong together in a file of spaces."""
NUMBER_OR_TIME: Final = re.compile(r"[+-]?[.,'  ]*\d[\d.,'  ]*(?:[eE][+-]?\d+)?|\d[\d.,TZ +-]*:[\d:.,TZ +-]*")
"""The parts do not overlap, so that the time is linear in the length of a text."""
_SERIES: Final = ("field", "series", "variable", "channel", "kanal", "tag", "tagname", "signal", "measurement", "name")
_VALUE: Final = ("value", "wert")
"""Heads of a file in long form: a row for each value."""


@dataclass(frozen=True)
class ReadOptions:
    """What a file does not say itself; by default everything is detected.

    Attributes:
        columns: Quantities of columns with unrecognised headings: "Vorschub [mm/s]=feed_speed", "v=feed_speed[mm/s]",
            with sign and factor "encoder=inserted_length[-m/4096]". Repeatable.
            Quantities: time, date and fraction (of a clock in another column), inserted_length, feed_speed, air_supply,
            root_tension, radial_acceleration_rms, axial_acceleration_rms, rf_noise_rms, inlet_pressure (above the
            exit's); none: leave the column out.
        missing: Text or number that marks a missing value, in addition to NaN, -999.25, 9999 and the like. Repeatable.
        time_format: Form of the times for strptime, like "%d.%m.%y %H:%M:%S"; default: detected.
        rate: Rows per second of a file without a column of time [Hz].
        sheet: Sheet of a workbook; default: the first with known headings.
        encoding: Encoding of a text, like cp1252 or cp932; default: detected.
        decimal: Decimal sign; auto: from the file.
        air_supply: Air supply, for a log without this column [m3/h].
        passage: Pass of a log that has several: in (insertion), out (withdrawal, read from its end), or its number.
    """

    columns: Annotated[Repeated, tyro.conf.arg(metavar="HEAD=QUANTITY[UNIT]")] = ()
    missing: Annotated[Repeated, tyro.conf.arg(metavar="VALUE")] = ()
    time_format: str = ""
    rate: Annotated[float | None, tyro.conf.arg(help_behavior_hint="")] = None
    sheet: Annotated[str | None, tyro.conf.arg(help_behavior_hint="")] = None
    encoding: str = ""
    decimal: Literal["auto", "point", "comma"] = "auto"
    air_supply: Annotated[float | None, tyro.conf.arg(help_behavior_hint="")] = None
    passage: Annotated[str, tyro.conf.arg(name="pass", metavar="in|out|NUMBER")] = ""

    def __post_init__(self) -> None:
        if self.decimal not in ("auto", "point", "comma"):
            raise ValueError(f"decimal = {self.decimal!r} is not one of auto, point, comma")
        if self.air_supply is not None:
            within("air_supply", self.air_supply, 0.0, RANGES[AIR][1], "m3/h")
        if self.rate is not None:
            within("rate", self.rate, 1e-3, 1e6, "Hz")
        if not re.fullmatch(r"in|out|[1-9]\d{0,3}|", self.passage):
            raise ValueError(f"pass = {self.passage!r} is not in, out or the number of a pass")
        _ = self.named

    @cached_property
    def named(self) -> tuple[ColumnOption, ...]:
        """The columns that are named."""
        return parse_columns(self.columns)


@dataclass(frozen=True)
class Table:
    """Cells of a file as texts."""

    path: Path
    heads: tuple[str, ...]
    units: tuple[str, ...]  # from the row below the headings; empty texts without such a row
    columns: tuple[Any, ...]  # arrow arrays of trimmed texts (rows,)
    lines: IntArray  # (rows,) line number, or row number of a sheet
    row_word: str  # word for a row in errors: line or row
    separator: str
    steps: bool  # whether values are constant until the next row
    null: tuple[str, ...] = ()  # what marks missing values by a LAS header
    notes: tuple[str, ...] = ()  # repairs of the file

    def error(self, row: int, problem: str, column: int | None = None) -> FileError:
        """An error at a row and column."""
        position = f", column {self.heads[column]!r}" if column is not None else ""
        return FileError(self.path, f"{self.row_word} {self.lines[row]}{position}: {problem}")

    def error_between(self, first: int, last: int, problem: str) -> FileError:
        """An error from one row to another."""
        return FileError(self.path, f"{self.row_word}s {self.lines[first]} to {self.lines[last]}: {problem}")

    def written_unit(self, column: int) -> str:
        """Unit of a column by its heading or the row below; empty without."""
        return split_head(self.heads[column])[1] or self.units[column]

    def name(self, column: int) -> str:
        """Heading of a column as written, without a unit in brackets and quotes, for ``--columns``."""
        return re.sub(r"(?<=\S)\s*[\[(].*$|'", "", self.heads[column])

    def option(self, column: int, quantity: str, unit: str = "") -> str:
        """The option that declares a column, for an error."""
        return f"--columns '{self.name(column)}={quantity}{f'[{unit}]' * bool(unit)}'"


class NoHeaderError(FileError):
    """A text or a sheet without a header."""


def read_table(path: Path, options: ReadOptions) -> Table:
    """Read the cells of a file: of a workbook, those of the first sheet with a header."""
    tables, problems = dict[str, Table](), list[NoHeaderError]()
    sources = read_sources(path, options.sheet, options.encoding)
    for name, source in sources.items():
        try:
            tables[name] = _table_of(path, source, options.named)
        except NoHeaderError as error:
            problems.append(error)
    first = next(iter(sources))
    if not tables and len(sources) > 1:
        names = listed(list(sources))
        raise FileError(path, f"no sheet has a header with two known quantities; there are {names}: --sheet NAME")
    if not tables:
        guess = guessed_encoding(path) if sources[first].encoding == "cp1252" and not options.encoding else ""
        if guess in ("", "cp1252"):
            raise problems[0]
        hint = f"read as {guess}; --encoding NAME names another"
        try:
            table = _table_of(path, read_sources(path, None, guess)[""], options.named)
        except FileError as error:
            raise FileError(path, f"{error.problem} ({hint})") from None
        return replace(table, notes=(*table.notes, f"The text is {hint}."))
    name, *others = tables
    table = tables[name]
    if name != first or others:
        more = f"; {others[0]!r} has, too" if others else ""
        table = replace(table, notes=(*table.notes, f"The sheet {name!r} is read, which has known headings{more}."))
    return table


class _Header(NamedTuple):
    """Names of columns in the lines ``first`` to ``end`` (counted from 0, without the end)."""

    first: int
    end: int
    separator: str
    cells: list[str]


def _table_of(path: Path, source: Source, options: Sequence[ColumnOption]) -> Table:
    lines, word, is_text = source.lines, source.word, source.word == "line"
    if len(lines) > MAX_ROWS:
        raise FileError(path, f"{len(lines)} {word}s are more than the {MAX_ROWS} accepted in a log: cut it")
    if not any(map(str.strip, lines)):
        hint = "" if is_text else "; --sheet names another"
        raise NoHeaderError(path, f"empty: a header and rows of numbers are needed{hint}")
    first, end, separator, heads = _header(path, source, options)
    if len(heads) > MAX_COLUMNS:
        raise FileError(path, f"{word} {first + 1}: {len(heads)} columns are more than {MAX_COLUMNS}")
    steps = any(line.startswith(CSV_COMMENT) and line.partition(":")[2].strip() == "steps" for line in lines[:first])
    rows = pa.array(lines[end:], pa.large_string())
    repeated = np.asarray(pc.is_in(rows, pa.array([line for line in lines[first:end] if line], pa.large_string())))
    summary, notes = matches(rows, _SUMMARY), [*source.notes]
    skipped = repeated | summary | matches(rows, _COMMENT if is_text else r"^\s*$") & ~matches(rows, _TOO_NARROW)
    wide = np.asarray(pc.count_substring(rows, separator)) >= len(heads) - 1
    comment = skipped & wide & matches(rows, r"^\s*[#%!].*\d") & (separator != " ")
    above = np.array(
        [sum(NUMBER_OR_TIME.fullmatch(c) is not None for c in _split(r, separator)) for r in lines[:first]]
    )
    for left_out, what, start in (
        (above > 1, "is above the header", 1),
        (repeated, "repeats the header", end + 1),
        (summary, "is of statistics (Min, Max, Mean)", end + 1),
        (comment, "is a comment", end + 1),
    ):
        if left_out.any():
            number, more = int(left_out.argmax()) + start, int(left_out.sum()) - 1
            notes.append(f"Left out: {word} {number} {what}" + f", and {more} more" * bool(more) + ".")
    numbers = np.flatnonzero(~skipped) + end + 1
    labels = next((line for line in lines[:end] if line.startswith("Y_Unit_Label")), "")  # of LabVIEW
    units = ["", *_split(labels, separator)[1:]] if labels else []
    below, third = ([*(_split(lines[number - 1], separator) for number in numbers[:2]), [], []])[:2]
    if any(below) and all(looks_like_unit(cell) and not NUMBER_OR_TIME.fullmatch(cell) for cell in below if cell):
        # a row of units, and in some files one of names of objects, or of "Smp" and "Avg"
        values = (cell for cell in third if cell and (re.search(r"^[\d+.,-]|\d:\d", cell) or re.match(MISSING, cell)))
        is_third = any(third) and not any(values)
        units, numbers = [cell.strip("[]() ") for cell in below], numbers[1 + is_third :]
    units = [*units, *[""] * len(heads)][: len(heads)]
    if not len(numbers):
        raise FileError(path, f"{word} {first + 1}: a header without rows below it: at least two are needed")
    columns = _columns(path, rows.take(pa.array(numbers - end - 1)), numbers, separator, heads, word)
    separator = separator if is_text else ""
    table = Table(path, tuple(heads), tuple(units), columns, numbers, word, separator, steps, source.null, tuple(notes))
    long_form = _long_form(heads)
    return _pivoted(table, *long_form) if long_form else table


def _header(path: Path, source: Source, options: Sequence[ColumnOption]) -> _Header:
    """The line that names most quantities, or two: some names of channels are below the name of the time."""
    is_text, headers = source.word == "line", list[_Header]()
    filled = [k for k, line in enumerate(source.lines[: 10 * HEAD_WITHIN]) if line.strip()][:HEAD_WITHIN]
    for k, below in zip(filled, [*filled[1:], 0], strict=False):
        # patterns of headings need a time that is quadratic in spaces
        line, next_line = (re.sub(r"[^\S\t]{3,}", "  ", source.lines[n][: 100 * MAX_COLUMNS]) for n in (k, below))
        for separator in SEPARATORS if is_text else ("\t",):
            if separator == " " and max(map(line.count, ";|,\t")) > 1:
                continue  # a file of commas is not one of spaces
            cells, lower = _split(re.sub(r"^\s*[#%!]", "", line), separator), _split(next_line, separator)
            headers.append(_Header(k, k + 1, separator, cells))
            if below and len(lower) == len(cells) and not any(map(NUMBER_OR_TIME.fullmatch, lower)):
                both = [low or high for low, high in zip(lower, cells, strict=True)]
                headers.append(_Header(k, below + 1, separator, both))
    head = max(headers, key=lambda h: (_named(h.cells, options), h.first - h.end), default=_Header(0, 1, "", []))
    if _named(head.cells, options) >= 2:
        return head

    def words(header: _Header) -> tuple[bool, bool, int, int]:
        number = sum(1 for cell in header.cells if cell and not NUMBER_OR_TIME.fullmatch(cell))
        return header.separator != " ", len(header.cells) > is_text, number, header.first - header.end

    best = max(headers, key=words, default=head)
    hint = f"declare each by --columns '{unknown_head(best.cells)}=QUANTITY[UNIT]', with QUANTITY one of "
    hint += ", ".join(NAMES)
    if best.cells and not words(best)[2]:
        hint = "is the header missing? Write one above the rows, like 'time [s]', 'length [m]', 'air [m3/h]'"
    problem = f"no header with two known quantities; found: {listed(best.cells) or 'none'}"
    raise NoHeaderError(path, f"{source.word} {best.first + 1}: {problem} - {hint}")


def _named(cells: Sequence[str], options: Sequence[ColumnOption]) -> int:
    """Number of quantities that a row names."""
    named = {option.quantity for cell in cells if cell for option in options if option.means(cell)}
    return max(len(named | {name for cell in cells if (name := quantity_of(cell))}), 2 * bool(_long_form(cells)))


def _long_form(heads: Sequence[str]) -> tuple[int, int, int] | None:
    """Columns of the time, the series and the value in a file with a row for each value; None for other files."""
    words = [normalized(split_head(head)[0]) for head in heads]
    times = [k for k, head in enumerate(heads) if quantity_of(head) == "time"]
    series, values = ([words.index(word) for word in known if word in words] for known in (_SERIES, _VALUE))
    return (times[0], series[0], values[0]) if times and series and values else None


def _pivoted(table: Table, time: int, series: int, value: int) -> Table:
    """A table in long form with a column for each series; all must have the same times."""
    names = pc.unique(table.columns[series]).to_pylist()
    parts = [pc.equal(table.columns[series], name) for name in names]
    times = [table.columns[time].filter(part) for part in parts]
    if not all(other.equals(times[0]) for other in times):
        problem = f"long form, a row for each value of {listed(names)}, with different times"
        raise FileError(table.path, f"{problem}: pivot it, one time and a column for each")
    return replace(
        table,
        heads=(table.heads[time], *names),
        units=("",) * (1 + len(names)),
        columns=(times[0], *(table.columns[value].filter(part) for part in parts)),
        lines=table.lines[np.asarray(parts[0])],
        notes=(*table.notes, f"Long form: {listed(names)} are columns of {table.heads[value]!r}."),
    )


def listed(heads: Sequence[str]) -> str:
    """The first headings, for an error."""
    return ", ".join(repr(head[:60]) for head in heads[:HEADS_SHOWN]) + (" ..." if len(heads) > HEADS_SHOWN else "")


def unknown_head(heads: Sequence[str]) -> str:
    """The first unknown heading, for ``--columns`` in an error."""
    return next((head for head in heads if head and quantity_of(head) is None), "HEAD").replace("'", "")[:60]


def _split(line: str, separator: str, strict: bool = False) -> list[str]:
    """Trimmed cells of a line; if ``strict``, a csv.Error for quotes in wrong places."""
    if '"' in line and (strict or separator != " "):
        try:
            reader = csv.reader([line], delimiter=separator, skipinitialspace=True, strict=strict)
            return [cell.strip() for cell in next(reader)]
        except csv.Error:
            if strict:
                raise
    if separator == " ":
        return re.split(r"\s+(?![\[(])", line.strip())  # a unit belongs to its word
    return [cell.strip() for cell in line.split(separator)]


def _columns(
    path: Path, lines: Any, numbers: IntArray, separator: str, heads: Sequence[str], word: str
) -> tuple[Any, ...]:
    """Trimmed texts (rows,) of every column; empty where a row may have no cell."""
    count, is_text = len(heads), word == "line"
    if separator == " ":
        for pattern, joined in _SPACED_TIME[any(quantity_of(head) == DATE for head in heads) :]:
            lines = pc.replace_substring_regex(lines, pattern, joined)
    if is_text and pc.any(pc.match_substring(lines, '"')).as_py():
        rows = list[list[str]]()
        try:
            rows.extend(_split(line, separator, strict=True) for line in lines.to_pylist())
        except csv.Error as error:
            raise FileError(path, f"line {numbers[len(rows)]}: not CSV: {error}") from error
        cells = pa.array(rows, pa.list_(pa.large_string()))
    elif separator == " ":
        cells = pc.utf8_split_whitespace(pc.utf8_trim_whitespace(lines))
    else:
        cells = pc.split_pattern(lines, separator)
    flat = pc.utf8_trim(pc.list_flatten(cells), " \t\u00a0\u2009\u202f\ufeff")
    flat = pa.concat_arrays([flat, pa.array([""], flat.type)])
    lengths = np.asarray(pc.list_value_length(cells))
    starts = np.cumsum(lengths) - lengths

    def column(k: int) -> Any:
        return flat.take(pa.array(np.where(k < lengths, starts + k, len(flat) - 1)))

    closed = (lengths == count + 1) & np.asarray(pc.equal(column(count), ""))  # a separator after the last cell
    short = lengths < count
    if is_text and ((lengths != lengths[0]).any() or any(map(quantity_of, heads[lengths[0] :]))):
        # LabVIEW writes a comment in some rows only; behind commas, decimal commas would look like one
        short &= (lengths == count - 1) & (heads[-1].casefold() == "comment" and separator != ",")
    good = (lengths == count) | closed | short
    if good.all():
        return tuple(map(column, range(count)))
    k = int(good.argmin())
    hint = f"correct that {word} or delete it"
    if not good.any() and len(good) > 1 and lengths[k] < count:
        hint = "the header has more names than the rows have values: correct it"
    elif k == len(good) - 1 and lengths[k] < count:
        hint = "the file ends within it: delete that line"
    elif not good.any() and separator == "," and lengths[k] > count:
        hint = "decimal commas and separating commas are ambiguous: export it with semicolons"
    values = f"{lengths[k]} values for {count} columns" + f", separated by {SEPARATORS[separator]}" * is_text
    raise FileError(path, f"{word} {numbers[k]}: {values} - {hint}")
