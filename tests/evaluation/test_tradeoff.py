"""Fronts and their hypervolume on tables whose answer is known, and the command in small."""

import numpy as np
import pandas as pd
import pytest

from agents.evaluation.tradeoff import FAMILIES, front_of, hypervolumes, run_tradeoff
from agents.policies.places import place_of


def table_of(points, contexts=6, scatter=0.0):
    """Family "constant" with given (time, share out of limit) of its members."""
    rng, rows = np.random.default_rng(0), []
    for value, (time, out) in zip(FAMILIES["constant"].values, points, strict=True):
        for context in range(contexts):
            shift = scatter * rng.normal()
            row = {"policy": f"constant {value:g}", "context": context, "seed": 0}
            rows.append(
                row | {"inspection_time_s": time + 100.0 * shift, "share_within_limit": 1.0 - out - 0.05 * shift}
            )
    return pd.DataFrame(rows)


def test_hypervolume_of_a_front_is_the_area_it_dominates():
    """(90 s, 0.5) and (450 s, 0.2) of 900 s: 0.9 x 0.5 + 0.5 x 0.3; what they dominate adds nothing."""
    table = table_of([(90.0, 0.5), (450.0, 0.2), (450.0, 0.6), (800.0, 0.5), (450.0, 0.2)])
    (row,) = hypervolumes(table, ["constant"]).itertuples()
    assert row.hypervolume == pytest.approx(0.9 * 0.5 + 0.5 * 0.3)
    assert (row.low, row.high) == pytest.approx((row.hypervolume, row.hypervolume))


def test_scatter_widens_the_intervals():
    points = [(90.0, 0.5), (450.0, 0.2), (450.0, 0.6), (800.0, 0.5), (450.0, 0.3)]
    table = table_of(points, 12, 1.0)
    (row,) = hypervolumes(table, ["constant"]).itertuples()
    assert row.low < row.hypervolume < row.high
    rows = front_of(table, ["constant"])
    assert (rows["time_low"] < rows["time_s"]).all()
    assert (rows["out_share"] < rows["out_high"]).all()


@pytest.mark.parametrize(
    ("names", "limit", "message"), [(["constant"], 99, "limit = 99"), (["best"], 1, "family = 'best' is not one of")]
)
def test_bad_arguments_are_named(names, limit, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        run_tradeoff(names, tmp_path / "out", place_of(None, "test", limit), "fast")
    assert not (tmp_path / "out").exists()
