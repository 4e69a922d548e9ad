"""Tables that fit the terminal: columns without room continue in a table below, with the names repeated."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, Literal

from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from probe_env.files import escaped

FRAME: Final = 3
"""Characters of a column in addition to its text."""
WIDEST_TEXT: Final = 100
"""Maximum characters of a line of text."""


def print_line(text: str) -> None:
    """Print a line with paths or names; their escapes and newlines are shown, not sent to the terminal."""
    print(escaped(text))


def print_table(
    title: str, header: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1, lines: bool = False
) -> None:
    """Print a table; texts are printed literally, also "[s]", which rich would read as markup.

    The first ``left`` columns are text, aligned left, folded and repeated where there is no room; the other columns are
    numbers, aligned right. ``lines`` are between the rows.
    """
    console, cells = Console(), [[escaped(text) for text in row] for row in rows]
    for number, part in enumerate(parts_of(header, cells, left, console.width)):
        table = Table(title=None if number else escape(escaped(title)), title_justify="left", show_lines=lines)
        for k, width in part.items():
            justify: Literal["left", "right"] = "left" if k < left else "right"
            table.add_column(escape(header[k]), justify=justify, overflow="fold", width=width)
        for row in cells:
            table.add_row(*(escape(row[k]) for k in part))
        console.print(table)


def parts_of(
    header: Sequence[str], cells: Sequence[Sequence[str]], left: int, width: int
) -> list[dict[int, int | None]]:
    """Split a table into tables whose numbers fit the terminal without folding.

    The first ``left`` columns are text; ``width`` is that of the terminal [characters].

    Returns:
        for each table its columns and their widths [characters]; None: no limit.
    """
    widest = [max((cell_len(row[k]) for row in cells), default=0) for k in range(len(header))]
    natural = [max(cell_len(name), widest[k]) for k, name in enumerate(header)]
    if left == len(header) or sum(natural) + FRAME * len(header) < width:
        return [dict.fromkeys(range(len(header)))]
    text_columns = {k: min(natural[k], width // 3) for k in range(left)}
    parts: list[dict[int, int]] = []
    for k in range(left, len(header)):
        minimum = max(widest[k], *map(cell_len, header[k].split() or [""]))  # a header is folded
        if not parts or sum(parts[-1].values()) + minimum + FRAME * (len(parts[-1]) + 1) >= width:
            parts.append(dict(text_columns))
        parts[-1][k] = minimum
    for part in parts:
        for k in part:  # headers unfolded where there is room
            room = width - 1 - sum(part.values()) - FRAME * len(part)
            part[k] = natural[k] if k >= left and natural[k] - part[k] <= room else part[k]
    return [dict(part) for part in parts]


def print_terms(terms: Mapping[str, str]) -> None:
    """Print terms with descriptions, in lines that fit the terminal."""
    width = max(map(len, terms), default=0) + 4
    for term, text in terms.items():
        first = f"  {term}".ljust(width)
        print(
            textwrap.fill(
                escaped(text), min(Console().width, WIDEST_TEXT), initial_indent=first, subsequent_indent=" " * width,
                break_on_hyphens=False,
            )
        )  # fmt: skip
