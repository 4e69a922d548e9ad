"""Fronts and their hypervolume on tables whose answer is known, and the command in small."""

import numpy as np
import pandas as pd
import pytest

from agents.evaluation.tradeoff import FAMILIES, front_of, hypervolumes, member_of, run_tradeoff, unbeaten
from agents.policies.places import place_of
from probe_env.inspection.detection import pod_gaussian, snr_at
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.tally import POD_NAMES


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


def test_a_feed_that_is_beaten_in_time_and_depth_is_left_out():
    """One signal-to-noise in every tube: a90 in closed form, the bound the same. The third is slower and finds less."""
    table = table_of([(100.0, 0.5), (200.0, 0.4), (300.0, 0.1), (400.0, 0.6), (400.0, 0.6)])
    assert "a90_95_percent_wall" not in front_of(table, ["constant"])  # of episodes before there was a sensor
    grooves = dict(zip((f"constant {value:g}" for value in FAMILIES["constant"].values), (5, 8, 7, 12, 9), strict=True))
    curves = [pod_gaussian(snr_at(Sensor(), np.array([grooves[name]])), 4.6)[0] for name in table["policy"]]
    front = front_of(table.assign(**dict(zip(POD_NAMES, np.array(curves).T, strict=True))), ["constant"])
    wanted = [20.0 * (4.6 + 1.2816) / groove for groove in grooves.values()]
    assert front["a90_95_percent_wall"].tolist() == pytest.approx(wanted, rel=5e-3)
    best = [member_of(row) for row in unbeaten(front).to_dict("records")]
    assert best == ["constant 0.07", "constant 0.1", "constant 0.2"]
    assert member_of({"family": "ppo", "value": float("nan")}) == "ppo"


@pytest.mark.parametrize(
    ("names", "limit", "message"), [(["constant"], 99, "limit = 99"), (["best"], 1, "family = 'best' is not one of")]
)
def test_bad_arguments_are_named(names, limit, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        run_tradeoff(names, tmp_path / "out", place_of(None, "test", limit), "fast")
    assert not (tmp_path / "out").exists()
