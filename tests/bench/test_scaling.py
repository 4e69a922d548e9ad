"""Projection onto more cores: its closed form, and where it stops."""

import pandas as pd
import pytest

from agents.bench.scaling import CORES, EPISODES, project

PORTIONS = pd.DataFrame({"size": [1, 2, 4, 8, 16], "seconds_an_insertion": [4.0, 2.0, 1.0, 1.0, 1.0]})


def test_whole_portions_scale_and_single_ones_do_not():
    table = project(PORTIONS, 0.0).set_index("cores")
    assert list(table.index) == list(CORES)
    assert table["wall_s"][2] == pytest.approx(EPISODES / 2, rel=0.03)  # 63 portions of 16 in 32 rounds
    assert table["efficiency"][16] > 0.9
    assert table["portion"][256] == 1
    assert table["wall_s"][256] == pytest.approx(4 * 4.0)  # 1,000 portions in four rounds, registers empty
    assert table["wall_s"][1024] == pytest.approx(4.0)
    assert (table["efficiency"] <= 1.01).all()


def test_the_start_of_a_worker_counts_once():
    plain, started = project(PORTIONS, 0.0), project(PORTIONS, 5.0)
    assert (started["wall_s"] - plain["wall_s"]).to_numpy() == pytest.approx(5.0)
