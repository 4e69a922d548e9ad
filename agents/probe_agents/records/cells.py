"""Header, units and cells of a file: lines with any separator, or rows of a sheet, as columns of texts."""

import csv
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
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
_END_PIPES: Final = r"^\s*\||\|\s*$"
NUMBER_OR_TIME: Final = re.compile(r"[+-]?[\d.,'  ]*\d[\d.,'  ]*(?:[eE][+-]?\d+)?|\d[\d:.,TZ +-]*:[\d:.,TZ +-]*")
_SERIES: Final = ("field", "series", "variable", "channel", "kanal", "tag", "tagname", "signal", "measurement", "name")
_VALUE: Final = {"value", "wert"}
"""Heads of a file in long form: a row for each value."""


@dataclass(frozen=True)
class ReadOptions:
    """What a file does not say itself; by default everything is detected.

    Attributes:
        columns: Quantities of columns with unrecognised headings: "Vorschub [mm/s]=feed_speed", "v=feed_speed[mm/s]",
            with sign and factor "encoder=inserted_length[-m/4096]". Repeatable.
            Quantities: time, date and fraction (of a clock in another column), inserted_length, feed_speed, air_supply,
            root_tension, radial_acceleration_rms, axial_acceleration_rms, rf_noise_rms; none: leave the column out.
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
    if not tables:
        encoding = next(source.encoding for source in sources.values()) if "" in sources else ""
        if encoding == "cp1252" and not options.encoding and (guess := guessed_encoding(path)) not in ("", "cp1252"):
            hint = f"read as {guess}; --encoding NAME names another"
            try:
                table = _table_of(path, read_sources(path, None, guess)[""], options.named)
            except FileError as error:
                raise FileError(path, f"{error.problem} ({hint})") from None
            return replace(table, notes=(*table.notes, f"The text is {hint}."))
        if len(sources) > 1:
            listed = ", ".join(repr(name[:60]) for name in list(sources)[:20])
            raise FileError(path, f"no sheet has a header with two known quantities; there are {listed}: --sheet NAME")
        raise problems[0]
    name, table = next(iter(tables.items()))
    if len(sources) > 1 and (name != next(iter(sources)) or len(tables) > 1):
        more = "".join(f"; {other!r} has, too" for other in list(tables)[1:2])
        table = replace(table, notes=(*table.notes, f"The sheet {name!r} is read, which has known headings{more}."))
    return table


class _Header(NamedTuple):
    """Names of columns in the lines ``first`` to ``end`` (counted from 0, without the end)."""

    first: int
    end: int
    separator: str
    cells: list[str]


def _table_of(path: Path, source: Source, options: Sequence[ColumnOption]) -> Table:
    lines, word = source.lines, source.word
    text = word == "line"
    if len(lines) > MAX_ROWS:
        raise FileError(path, f"{len(lines)} {word}s are more than the {MAX_ROWS} accepted in a log: cut it")
    if not any(map(str.strip, lines)):
        hint = "" if text else "; --sheet names another"
        raise NoHeaderError(path, f"empty: a header and rows of numbers are needed{hint}")
    headers = list(_headers(lines, text, options))
    head = max(headers, key=lambda header: _named(header.cells, options), default=_Header(0, 1, "", []))
    if _named(head.cells, options) < 2:
        several = [h for h in headers if len(h.cells) > text and h.separator != " "] or headers[:1] or [head]
        best = max(several, key=lambda h: sum(1 for cell in h.cells if cell and not NUMBER_OR_TIME.fullmatch(cell)))
        problem = f"no header with two known quantities; found: {listed(best.cells) or 'none'}"
        unknown = next((cell for cell in best.cells if cell and quantity_of(cell) is None), "HEAD").replace("'", "")
        hint = f"declare them: --columns '{unknown[:60]}=QUANTITY[UNIT]', with QUANTITY one of {', '.join(NAMES)}"
        if best.cells and all(not cell or NUMBER_OR_TIME.fullmatch(cell) for cell in best.cells):
            hint = "is the header missing? Write one above the rows, like 'time [s]', 'length [m]', 'air [m3/h]'"
        raise NoHeaderError(path, f"{word} {best.first + 1}: {problem} - {hint}")
    first, end, separator, heads = head
    if separator == "|" and lines[first].lstrip().startswith("|"):
        lines = [re.sub(_END_PIPES, "", line) for line in lines]
    if len(heads) > MAX_COLUMNS:
        raise FileError(path, f"{word} {first + 1}: {len(heads)} columns are more than {MAX_COLUMNS}")
    remarks = (line for line in lines[:first] if line.startswith(CSV_COMMENT))
    steps = any(line.partition(":")[2].strip() == "steps" for line in remarks)
    body = lines[end:]
    if not text:  # cells at the end of a row may be empty
        body = [line + "\t" * (len(heads) - 1 - line.count("\t")) for line in body]
    rows = pa.array(body, pa.large_string())
    labels = next((line for line in lines[:end] if line.startswith("Y_Unit_Label")), "")  # of LabVIEW
    repeated = np.asarray(pc.is_in(rows, pa.array([line for line in lines[first:end] if line], pa.large_string())))
    summary = matches(rows, _SUMMARY)
    wide = np.asarray(pc.count_substring(rows, separator)) >= len(heads) - 1
    comment = matches(rows, r"^\s*[#%!].*\d") & wide if separator != " " else np.zeros_like(summary)
    skipped = repeated | summary | matches(rows, _COMMENT if text else r"^\s*$") & ~matches(rows, _TOO_NARROW)
    notes = [*source.notes]
    above = np.array(
        [sum(map(bool, map(NUMBER_OR_TIME.fullmatch, _split(line, separator)))) > 1 for line in lines[:first]]
    )
    for left_out, what, start in (
        (above, "is above the header", 1),
        (repeated, "repeats the header", end + 1),
        (summary, "is of statistics (Min, Max, Mean)", end + 1),
        (comment, "is a comment", end + 1),
    ):
        if left_out.any():
            number, more = int(left_out.argmax()) + start, int(left_out.sum()) - 1
            notes.append(f"Left out: {word} {number} {what}" + f", and {more} more" * bool(more) + ".")
    numbers = np.flatnonzero(~skipped) + end + 1
    below = _split(lines[numbers[0] - 1], separator) if len(numbers) else []
    filled_below = [cell for cell in below if cell]
    units = [*["", *_split(labels, separator)[1:]][: len(heads)], *[""] * len(heads)][: len(heads)]
    if filled_below and all(looks_like_unit(cell) and not NUMBER_OR_TIME.fullmatch(cell) for cell in filled_below):
        units = [*(cell.strip("[]() ") for cell in below), *units][: len(heads)]
        numbers = numbers[1:]
        third = [cell for cell in _split(lines[numbers[0] - 1], separator) if cell] if len(numbers) else []
        if third and not any(re.search(r"^[\d+.,-]|\d:\d", cell) or re.match(MISSING, cell) for cell in third):
            numbers = numbers[1:]  # names of objects, or "Smp" and "Avg"
    if not len(numbers):
        raise FileError(path, f"{word} {first + 1}: a header without rows below it: at least two are needed")
    columns = _columns(path, rows.take(pa.array(numbers - end - 1)), numbers, separator, heads, word)
    separator = separator if text else ""
    table = Table(path, tuple(heads), tuple(units), columns, numbers, word, separator, steps, source.null, tuple(notes))
    return _pivoted(table) if _is_long(heads) else table


def _headers(lines: Sequence[str], text: bool, options: Sequence[ColumnOption]) -> Iterator[_Header]:
    """Lines that may be the header, also with names of channels in the line below the name of the time."""
    filled = [k for k, line in enumerate(lines[: 10 * HEAD_WITHIN]) if line.strip()][:HEAD_WITHIN]
    for k, below in zip(filled, [*filled[1:], 0], strict=False):
        for separator in SEPARATORS if text else ("\t",):
            if separator == " " and max(map(lines[k].count, ";|,\t")) > 1:
                continue  # a file of commas is not one of spaces
            line = _uncommented(lines[k])[: 100 * MAX_COLUMNS]
            if separator == "|" and line.lstrip().startswith("|"):
                line = re.sub(_END_PIPES, "", line)
            cells = _split(line, separator)
            yield _Header(k, k + 1, separator, cells)
            lower = _split(lines[below][: 100 * MAX_COLUMNS], separator)
            if below and len(lower) == len(cells) and not any(map(NUMBER_OR_TIME.fullmatch, lower)):
                both = [low or high for low, high in zip(lower, cells, strict=True)]
                if _named(both, options) > max(_named(cells, options), _named(lower, options)):
                    yield _Header(k, below + 1, separator, both)


def _named(cells: Sequence[str], options: Sequence[ColumnOption]) -> int:
    """Number of quantities that a row names."""
    named = {option.quantity for cell in cells if cell for option in options if option.means(cell)}
    return max(len(named | {name for cell in cells if (name := quantity_of(cell))}), 2 * _is_long(cells))


def _is_long(heads: Sequence[str]) -> bool:
    words = {normalized(split_head(head)[0]) for head in heads}
    return bool(words.intersection(_SERIES) and words & _VALUE) and any(quantity_of(head) == "time" for head in heads)


def _pivoted(table: Table) -> Table:
    """A table in long form with a column for each series; all must have the same times."""
    words = [normalized(split_head(head)[0]) for head in table.heads]
    time = next(k for k, head in enumerate(table.heads) if quantity_of(head) == "time")
    value = next(k for k, word in enumerate(words) if word in _VALUE)
    series = next(words.index(word) for word in _SERIES if word in words)
    names = pc.unique(table.columns[series]).to_pylist()
    parts = [np.flatnonzero(np.asarray(pc.equal(table.columns[series], name))) for name in names]
    times = [table.columns[time].take(pa.array(part)) for part in parts]
    if not all(other.equals(times[0]) for other in times):
        problem = f"long form, a row for each value of {listed(names)}, with different times"
        raise FileError(table.path, f"{problem}: pivot it, one time and a column for each")
    columns = (times[0], *(table.columns[value].take(pa.array(part)) for part in parts))
    heads = (table.heads[time], *names)
    notes = (*table.notes, f"Long form: {listed(names)} are columns of {table.heads[value]!r}.")
    return replace(
        table, heads=heads, units=("",) * len(heads), columns=columns, lines=table.lines[parts[0]], notes=notes
    )


def listed(heads: Sequence[str]) -> str:
    """The first headings, for an error."""
    return ", ".join(repr(head[:60]) for head in heads[:HEADS_SHOWN]) + (" ..." if len(heads) > HEADS_SHOWN else "")


def _uncommented(line: str) -> str:
    return re.sub(r"^\s*[#%!]", "", line)


def _split(line: str, separator: str) -> list[str]:
    """Cells of a header or a row of units."""
    if separator == " ":
        for pattern, joined in _SPACED_TIME:
            line = re.sub(pattern, joined, line)
        return re.split(r"\s+(?![\[(])", line.strip())  # a unit belongs to its word
    cells = line.split(separator)
    if '"' in line:
        with suppress(csv.Error):
            cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    return [cell.strip() for cell in cells]


def _columns(
    path: Path, lines: Any, numbers: IntArray, separator: str, heads: Sequence[str], word: str
) -> tuple[Any, ...]:
    """Trimmed texts (rows,) of every column; empty below last heads that no row fills."""
    count = len(heads)
    if word == "line" and pc.any(pc.match_substring(lines, '"')).as_py():
        cells = pa.array(_quoted_rows(path, lines.to_pylist(), numbers, separator, count), pa.list_(pa.large_string()))
    elif separator == " ":
        for pattern, joined in _SPACED_TIME[any(quantity_of(head) == DATE for head in heads) :]:
            lines = pc.replace_substring_regex(lines, pattern, joined)
        cells = pc.utf8_split_whitespace(pc.utf8_trim_whitespace(lines))
    else:
        end = re.escape(separator) + r"[ ]*$"
        counts = np.asarray(pc.count_substring(lines, separator))
        # LabVIEW writes a comment in some rows only; behind commas, decimal commas would look like one
        if heads[-1].casefold() == "comment" and separator != "," and (counts == count - 2).any():
            lines = pc.if_else(pa.array(counts == count - 2), pc.replace_substring_regex(lines, "$", separator), lines)
        closed = counts == count  # a separator after the last cell
        if (closed & matches(lines, end)).any():
            lines = pc.if_else(pa.array(closed), pc.replace_substring_regex(lines, end, ""), lines)
        cells = pc.split_pattern(lines, separator)
    lengths = np.asarray(pc.list_value_length(cells))
    filled = count
    if (lengths == lengths[0]).all() and not any(map(quantity_of, heads[lengths[0] :])):
        filled = min(count, int(lengths[0]))
    wrong = np.flatnonzero(lengths != filled)
    if len(wrong):
        k = int(wrong[0])
        hint = f"correct that {word} or delete it"
        if k == len(lengths) - 1 and lengths[k] < count:
            hint = "the file ends within it: delete that line"
        if len(wrong) == len(lengths) > 1 and lengths[k] < count:
            hint = "the header has more names than the rows have values: correct it"
        elif separator == "," and len(wrong) == len(lengths) and lengths[k] > count:
            hint = "decimal commas and separating commas are ambiguous: export it with semicolons"
        values = f"{lengths[k]} values for {count} columns" + f", separated by {SEPARATORS[separator]}" * (
            word == "line"
        )
        raise FileError(path, f"{word} {numbers[k]}: {values} - {hint}")
    flat = pc.utf8_trim(pc.list_flatten(cells), " \t\u00a0\u2009\u202f\ufeff")
    empty = pa.array([""], pa.large_string()).take(pa.array(np.zeros(len(lengths), dtype=int)))
    columns = (flat.take(pa.array(np.arange(k, len(flat), filled))) for k in range(filled))
    return (*columns, *[empty] * (count - filled))


def _quoted_rows(path: Path, lines: list[str], numbers: IntArray, separator: str, count: int) -> list[list[str]]:
    reader = csv.reader(lines, delimiter=separator, strict=True, skipinitialspace=True)
    rows: list[list[str]] = []
    try:
        for row in reader:
            rows.append(row[:-1] if len(row) == count + 1 and not row[-1].strip() else row)
            if reader.line_num != len(rows):
                raise FileError(path, f"line {numbers[len(rows) - 1]}: a quote is not closed")
    except csv.Error as error:
        raise FileError(path, f"line {numbers[len(rows)]}: not CSV: {error}") from error
    return rows
