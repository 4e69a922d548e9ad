"""Depths found over tubes, from tables of episodes."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

from agents.detection import pictures
from agents.detection.signal import draw_curves
from agents.records.columns import KPIS
from agents.rollouts.depths import bands, depths_of, tells
from probe_env import Context
from probe_env.envs.task import ENDINGS
from probe_env.inspection.detection import DEPTHS, depth_found, pod_gaussian, snr_at
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.tally import POD_NAMES


def table(**snr):
    """A policy a keyword: the signal-to-noise of the 20 % groove in each of its tubes."""
    rows = []
    for policy, values in snr.items():
        for context, groove in enumerate(values):
            curve = pod_gaussian(snr_at(Sensor(), np.array([groove])), 4.6)[0]
            rows.append({"policy": policy, "context": context, "seed": 0} | dict(zip(POD_NAMES, curve, strict=True)))
    return pd.DataFrame(rows)


def test_equal_tubes_leave_nothing_to_chance():
    depths = depths_of(table(one=[7.5] * 6)).iloc[0]
    assert depths["a90_95_percent_wall"] == pytest.approx(depths["a90_percent_wall"], rel=1e-12)
    assert depths["a90_percent_wall"] == pytest.approx(20.0 * (4.6 + 1.2816) / 7.5, rel=2e-3)
    assert depths["a50_percent_wall"] == pytest.approx(20.0 * 4.6 / 7.5, rel=2e-3)


def test_the_bound_is_above_and_narrows_with_tubes():
    """Drawn with replacement: the bound of 4 n tubes is half as far away, as of any mean; to a quarter of it."""
    rng = np.random.default_rng(0)
    some = rng.uniform(4.0, 9.0, 12)
    few, many = (depths_of(table(p=np.tile(some, n))).iloc[0] for n in (1, 4))
    assert few["a90_percent_wall"] == pytest.approx(many["a90_percent_wall"], rel=1e-12)
    away = [row["a90_95_percent_wall"] - row["a90_percent_wall"] for row in (few, many)]
    assert away[0] > away[1] > 0.0
    assert away[1] / away[0] == pytest.approx(0.5, abs=0.125)


def test_the_bound_is_the_95th_percentile_in_closed_form():
    """12 tubes of either of two kinds: of 24 that are drawn anew a binomial number is good, and few of them are deep.

    Fewer than 8 good ones are drawn with a chance of 3.2 %, at most 8 with 7.6 %: of 2,000 draws the 5 % in between are
    4.4 deviations from both, a chance of 1e-5. Bounds of 90 and 97.5 % would be those of 9 and 7 good ones.
    """
    tubes, kinds = 24, np.array([9.0, 5.0])
    bound = depths_of(table(p=np.repeat(kinds, tubes // 2))).iloc[0]["a90_95_percent_wall"]
    good, bad = pod_gaussian(snr_at(Sensor(), kinds), 4.6)

    def drawn(count):
        return 100.0 * depth_found((count * good + (tubes - count) * bad) / tubes, 0.9)

    assert binom.ppf([0.025, 0.05, 0.1], tubes, 0.5).tolist() == [7.0, 8.0, 9.0]
    assert bound == pytest.approx(drawn(8), rel=1e-9)
    assert drawn(7) > 1.005 * bound > 1.01 * drawn(9)


def test_the_mean_curve_counts_and_not_the_mean_depth():
    """One tube in five where nothing is found: no depth is found with 90 % over all of them."""
    both = table(p=[8.0, 8.0, 8.0, 8.0, 1e-3])
    assert depths_of(both).iloc[0]["a90_percent_wall"] == 100.0
    curve = 0.8 * pod_gaussian(snr_at(Sensor(), np.array([8.0])), 4.6)[0]
    assert depths_of(both).iloc[0]["a50_percent_wall"] == pytest.approx(100 * depth_found(curve, 0.5), rel=1e-3)


def test_bands_and_their_picture(tmp_path):
    both = table(good=[7.0, 8.0, 9.0], bad=[2.0, 3.0, 4.0])
    drawn = bands(both)
    assert (drawn["low"] <= drawn["pod"] + 1e-12).all()
    assert (drawn["pod"] <= drawn["high"] + 1e-12).all()
    assert len(drawn) == 2 * len(DEPTHS)
    assert pictures.curves(drawn, tmp_path / "pod.png").stat().st_size > 5000
    assert tells(both)
    assert not tells(both.drop(columns=POD_NAMES[0]))


def test_curves_of_a_stored_evaluation(tmp_path, capsys):
    """What older episodes lack is said; what newer ones have is read from their file."""
    whole = table(good=[7.0, 8.0, 9.0]).assign(**dict.fromkeys((*KPIS, *Context.model_fields), 1.0))
    whole = whole.assign(**dict.fromkeys(ENDINGS, 0.0))
    whole.drop(columns=list(POD_NAMES)).to_parquet(tmp_path / "episodes.parquet", index=False)
    with pytest.raises(ValueError, match="its episodes have no curves of detection: run the evaluation again"):
        draw_curves(tmp_path, tmp_path / "out")
    whole.to_parquet(tmp_path / "episodes.parquet", index=False)
    draw_curves(tmp_path, tmp_path / "out")
    assert "over 3 tubes" in capsys.readouterr().out
    assert len(pd.read_csv(tmp_path / "out" / "pod.csv")) == len(DEPTHS)
    assert (tmp_path / "out" / "pod.png").exists()
