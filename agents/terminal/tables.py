"""Tables on the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table


def print_table(
    title: str,
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    left: int = 1,
    least_width: int = 0,
    lines: bool = False,
) -> None:
    """Print a table; texts are shown as they are, also "[s]", which rich would take for markup.

    Args:
        title: above it.
        header: one text a column.
        rows: of texts.
        left: how many of the first columns stand to the left; the others stand to the right.
        least_width: characters that it may take even if the terminal is narrower or no terminal.
        lines: between the rows.
    """
    table = Table(title=escape(title), show_lines=lines)
    for k, column in enumerate(header):
        table.add_column(escape(column), justify="left" if k < left else "right", overflow="fold")
    for row in rows:
        table.add_row(*map(escape, row))
    Console(width=max(Console().width, least_width)).print(table)
