"""Which of two policies finds smaller flaws, over the same tubes, and whether that hangs on the anchors."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import pandas as pd

from agents.rollouts.depths import curves_by_tube, difference_of_a90


def pairs_of(tables: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """A row a pair of policies and anchors: a90 of the first less that of the second [% of the wall], its interval.

    Args:
        tables: episodes by what was done to the anchors, of the same policies in the same tubes.
    """
    rows = []
    for what, table in tables.items():
        curves = {policy: curves_by_tube(table, policy) for policy in dict.fromkeys(table["policy"])}
        for first, second in itertools.combinations(curves, 2):
            apart = difference_of_a90(curves[first], curves[second])
            rows.append((first, second, what, apart.mean, apart.low, apart.high))
    return pd.DataFrame(rows, columns=["first", "second", "anchors", "difference", "low", "high"])


def signs(pairs: pd.DataFrame) -> pd.DataFrame:
    """A row a pair, a column an anchor: 1 or -1 where the first's depth is clearly the larger or smaller, else 0."""
    table = pairs.assign(sign=(pairs["low"] > 0.0).astype(int) - (pairs["high"] < 0.0).astype(int))
    return table.pivot_table(index=["first", "second"], columns="anchors", values="sign", sort=False, aggfunc="first")


def survival(pairs: pd.DataFrame, usual: str) -> str:
    """Of the pairs that are clearly apart with the anchors ``usual``, how many stay so, and which turn round."""
    table = signs(pairs)
    apart = table[table[usual] != 0]
    product = apart.mul(apart[usual], axis=0)
    turned = [
        f"{' and '.join(pair)} ({', '.join(product.columns[row < 0])})"
        for pair, row in zip(product.index, product.to_numpy(), strict=True)
        if (row < 0).any()
    ]
    return (
        f"Of {len(table)} pairs of policies {len(apart)} are clearly apart with the anchors {usual} (95 % intervals,"
        f" paired over tubes). Of these {int((product > 0).all(axis=1).sum())} are so with every one of them,"
        f" {int(((product >= 0).all(axis=1) & (product == 0).any(axis=1)).sum())} are not told apart with some;"
        f" {len(turned)} turn round{': ' if turned else ''}{'; '.join(turned)}."
    )
