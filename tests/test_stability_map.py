"""The stored stability map says what theory says, and its edges are run again."""

from pathlib import Path

import pandas as pd
import pytest

from agents.stability_map import LENGTHS, METHODS, RATIOS, STIFFNESSES, run_cell

MAP = pd.read_csv(Path(__file__).parents[1] / "results" / "stability" / "map.csv")
HELD = MAP.assign(held=MAP["diverged_at_s"].isna())


def test_the_map_is_complete_and_every_named_limit_holds():
    assert len(MAP) == len(METHODS) * len(RATIOS) * len(STIFFNESSES) * len(LENGTHS)
    assert HELD[HELD["ratio"] <= 1.0]["held"].all()
    assert HELD[HELD["method"] == "implicit"]["held"].all()


def test_explicit_contact_breaks_where_theory_says():
    """imex: omega dt < 2 holds, beyond 3 nothing does; explicit: nothing beyond its computed limit."""
    imex = HELD[HELD["method"] == "imex"]
    assert imex[imex["omega_dt"] < 2.0]["held"].all()
    assert not imex[imex["omega_dt"] > 3.0]["held"].any()
    explicit = HELD[HELD["method"] == "explicit"]
    assert not explicit[explicit["ratio"] > 1.0]["held"].any()


@pytest.mark.parametrize("method", METHODS)
def test_edges_are_repeated(method):
    """The largest step that held and the smallest that did not, at l = 10 m, for two stiffnesses."""
    for stiffness in (1e5, 1e6):
        row = HELD[(HELD["method"] == method) & (HELD["stiffness_n_per_m"] == stiffness) & (HELD["length_m"] == 10.0)]
        last = row[row["held"]]["ratio"].max()
        assert pd.isna(run_cell(method, stiffness, 10.0, last)["diverged_at_s"])
        broken = row[~row["held"]]["ratio"].min()
        if pd.notna(broken):
            assert run_cell(method, stiffness, 10.0, broken)["diverged_at_s"] < 0.5
