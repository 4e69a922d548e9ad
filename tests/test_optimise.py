"""The searched schedules: what a point means, and that what is stored is what the trials say."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from agents import optimise
from agents.optimise import AIR_KNOTS, FAMILIES, KNOTS, run_search
from agents.policies import STORED, make_policy
from probe_env.schedule import Schedule
from probe_env.task import TaskConfig

CONFIG = TaskConfig()
DATA = Path(optimise.__file__).parent / "data"


def test_a_point_of_the_search_is_a_schedule():
    low = FAMILIES["best-constant"].schedule([0.0, 0.0], CONFIG)
    assert (low.feed_speed[0], low.air_supply_rate[0]) == pytest.approx((0.02, 30.0 / 3600.0))
    high = FAMILIES["best-schedule"].schedule([1.0] * len(KNOTS) + [0.0, 1.0], CONFIG)
    assert high.feed_speed == pytest.approx([0.4] * len(KNOTS))
    assert high.position == KNOTS
    assert high.air_supply_rate[0] == pytest.approx(30.0 / 3600.0)
    assert high.air_supply_rate[-1] == pytest.approx(130.0 / 3600.0)
    assert (KNOTS[0], KNOTS[-1]) == AIR_KNOTS


@pytest.mark.parametrize("name", STORED)
def test_stored_schedules_are_the_best_of_their_trials(name):
    trials, made = pd.read_csv(DATA / f"{name}-trials.csv"), json.loads((DATA / f"{name}.json").read_text())
    assert len(trials) == made["trials"]
    best = trials.loc[trials["reward"].idxmax()]
    assert best["reward"] == pytest.approx(made["reward"], rel=1e-3)
    point = [best[f"x{k}"] for k in range(len(FAMILIES[name].start))]
    expected, stored = FAMILIES[name].schedule(point, CONFIG), Schedule.read(DATA / f"{name}.csv")
    assert stored.feed_speed == pytest.approx(expected.feed_speed, rel=1e-3)
    assert stored.air_supply_rate == pytest.approx(expected.air_supply_rate, rel=1e-3)
    action, _ = make_policy(name, CONFIG).predict(np.zeros(len(CONFIG.observations), dtype=np.float32))
    assert np.abs(action).max() <= 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("best", 8, 8), "family = 'best'"),
        (("best-constant", 0, 8), "trials = 0"),
        (("best-constant", 8, 0), "contexts = 0"),
    ],
)
def test_bad_budgets_are_named(arguments, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        run_search(*arguments, tmp_path / "out", tmp_path / "work")
    assert not list(tmp_path.iterdir())
