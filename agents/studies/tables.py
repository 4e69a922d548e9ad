"""Tables of a study on the terminal."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from agents.terminal.tables import print_table


def print_frame(title: str, table: pd.DataFrame, columns: Sequence[str] = (), texts: int = 1) -> None:
    """Print columns (default: all) of a table, numbers with three digits; the first ``texts`` stand to the left."""
    chosen = list(columns or table.columns)
    rows = [
        [cell if isinstance(cell, str) else "-" if cell != cell else f"{cell:.3g}" for cell in row]
        for row in table[chosen].to_numpy(dtype=object)
    ]
    print_table(title, chosen, rows, left=texts)
