"""In how many episodes the cable was strained: pulled harder than it should bear, or pressed until it may buckle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import pandas as pd

STRAINS: Final[Mapping[str, str]] = {
    "cost_tension": "over the tension limit",
    "cost_buckling": "pressed beyond the buckling load",
}
"""Cost of an episode, in control periods -> what happened in them, in words."""


def strained(table: pd.DataFrame) -> list[str]:
    """A line for every policy and strain that there was in one of its episodes; empty for tables without costs.

    Args:
        table: of episodes, with "policy" and what there is of ``STRAINS``, in control periods.
    """
    lines = []
    for policy in dict.fromkeys(table["policy"]):
        part = table[table["policy"] == policy]
        for name, words in STRAINS.items():
            periods = part.get(name, pd.Series(dtype=float))
            if count := int((periods > 0.0).sum()):
                most = f"{periods.max():.0f} control period{'s' if periods.max() > 1.0 else ''}"
                lines.append(f"{policy}: the root {words} in {count} of {len(part)} episodes, for {most} at most")
    return lines
