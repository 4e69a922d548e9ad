"""The bounds of the statistical tests keep their promise on members that are stored."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from agents.studies.chart.ensembles import Setting
from oracles.scatter import CHANCE, DEVIATIONS, deviation, hits_within, of_another, reach

MEMBERS = pd.read_csv(Path(__file__).parents[2] / "results" / "chart" / "ensembles.csv")
DRAWS = 200_000


def relative(statistic, length):
    """Members of the 13 settings that the deviations were pooled over, each over the mean of its setting.

    One setting alone will not do: of 32 members a deviation is known to an eighth, and one of them lies 30 % higher.
    """
    plain = Setting(length=length).key
    del plain["method"], plain["time_step_s"]
    rows = MEMBERS[(MEMBERS[list(plain)] == list(plain.values())).all(axis=1) & (MEMBERS["time_step_s"] <= 2e-4)]
    settings = rows[rows["method"].isin(["imex", "imex32"])].groupby(["method", "time_step_s"])[statistic]
    assert settings.size().tolist() == [32] * 13
    deviations = (settings.transform(lambda v: v / v.mean()) - 1.0) * np.sqrt(32 / 31)
    return 1.0 + deviations.to_numpy()


@pytest.mark.parametrize("length", [30.0, 50.0])
@pytest.mark.parametrize("statistic", DEVIATIONS)
def test_means_of_stored_members_go_beyond_their_bound_no_more_often_than_promised(statistic, length):
    """16 against 32, both drawn with replacement from the same members: with them in place of the truth."""
    values = relative(statistic, length)
    rng = np.random.default_rng(0)
    first, second = (values[rng.integers(len(values), size=(DRAWS, count))].mean(axis=1) for count in (16, 32))
    own = deviation(statistic, length)
    beyond = int((np.abs(np.log(first / second)) > reach((own, 16), (own, 32))).sum())
    assert beyond <= hits_within(DRAWS, 0.0, CHANCE)[1]


def test_bounds_by_hand():
    """Students's t of 31 degrees goes beyond 4.45 with a chance of 1e-4; of 100 coins 32 to 68 heads, but for 1e-4."""
    assert reach((0.3, 9)) == pytest.approx(4.45 * 0.1, rel=1e-2)
    assert reach((0.1, 8), (0.1, 8)) == pytest.approx(4.45 * 0.05, rel=1e-2)
    assert reach((0.3, 9), measured=8) == pytest.approx(7.89 * 0.1, rel=1e-2)  # of 7 degrees
    assert of_another(0.1, members=8) == pytest.approx(4.45 * 0.1 * np.sqrt(1 / 8 + 1 / 32), rel=1e-2)
    assert hits_within(100, 0.5, 0.5) == (32, 68)
