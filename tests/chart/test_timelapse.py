"""The bias of time-lapse, on the stored insertions."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from oracles.scatter import CHANCE, reach
from scipy.stats import norm

from agents.chart.timelapse import BINS, FACTORS, summarise

FOLDER = Path(__file__).parents[2] / "results" / "timelapse"


def test_the_summary_follows_from_the_profile():
    profile, summary = pd.read_csv(FOLDER / "profile.csv"), pd.read_csv(FOLDER / "summary.csv")
    assert set(profile["factor"]) == set(FACTORS)
    assert profile.groupby("factor")["probe"].nunique().eq(8).all()
    np.testing.assert_allclose(summarise(profile).to_numpy(), summary.to_numpy(), rtol=2e-3)


@pytest.mark.processor
def test_a_known_ratio_is_found(seeds):
    """Metres of +- 10 %, ten of eight probes in a stretch: a ratio of 1.5 is found within 9 % in all 12 stretches."""
    lengths = np.arange(20.5, 60.0)
    rng = np.random.default_rng(seeds(1))
    rows = [
        (factor, probe, length, 1e-4 * (1.5 if factor == 10 else 1.0) * rng.lognormal(0.0, 0.1))
        for factor in FACTORS
        for probe in range(8)
        for length in lengths
    ]
    summary = summarise(pd.DataFrame(rows, columns=["factor", "probe", "inserted_length_m", "radial_rms_m"]))
    assert len(summary) == 3 * (len(BINS) - 1)
    for row in summary.itertuples():
        expected = 1.5 if row.factor == 10 else 1.0
        assert row.low < row.ratio < row.high
        assert abs(np.log(row.ratio / expected)) <= reach((0.1, 80), (0.1, 80), chance=CHANCE / len(summary))


def test_factor_4_is_usable_beyond_30_m():
    """A bias of less than a quarter in each stretch but for chance, and over all of them, where a probe is one value.

    The interval of a stretch tells its scatter. Over all the bias is 2 %, of 16 values
    that leave 2.7 % to chance: others, as scattered, go beyond by 6 in 100,000.
    """
    summary = pd.read_csv(FOLDER / "summary.csv")
    far = summary[(summary["factor"] == 4) & (summary["from_m"] >= 30.0)]
    scatter = np.log(far["high"] / far["low"]) / (2.0 * norm.isf(0.025))
    assert (np.abs(np.log(far["ratio"])) < np.log(1.25) + norm.isf(CHANCE / len(far)) * scatter).all()
    profile = pd.read_csv(FOLDER / "profile.csv")
    rows = profile[(profile["inserted_length_m"] >= 30.0) & profile["factor"].isin([1, 4])]
    square = (rows["radial_rms_m"] ** 2).groupby([rows["factor"], rows["probe"]]).mean()
    truth, usual = (np.sqrt(square[factor]).mean() for factor in (1, 4))
    assert 0.8 < usual / truth < 1.25
