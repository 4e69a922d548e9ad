"""The best feed and air in and back: what is searched, that it is found, and what is stored of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from probe_agents.plant.recommendation import safe_air
from probe_agents.policies.cases import load_case
from probe_agents.policies.catalogue import make_policy
from probe_agents.studies.builtin import Request
from probe_agents.studies.shipped import best_round_trip as searched
from probe_agents.studies.shipped.best_round_trip import COLUMNS, NAME, ranges, rounded_numbers, run, starts
from probe_env import Plant
from probe_env.envs.plants import FeedDevice, Supply, Tubes
from probe_env.inspection.metrics import POD_NAMES
from probe_env.schedule import INSERTION, WITHDRAWAL, Schedule

CONFIG = load_case(None, "train", 1, "both").config
TUBES = load_case(None, "train").contexts
SPACE = ranges(CONFIG, TUBES)
PLANT = Plant(
    tube=Tubes(inner_diameter=23e-3, helix_length=45.0),
    air=Supply(air_supply_rates=(0.0084, 0.015), air_supply_step=0.001),
    feed=FeedDevice(feed_speeds=(0.03, 0.35), feed_speed_step=0.005),
)
BEST = dict(zip(COLUMNS, (0.3, 70.0, 0.15, 90.0), strict=True))


def reward(numbers: dict[str, float], tube: int) -> float:
    """Greatest at ``BEST``; feeds count by their logarithm, air by its range."""
    total = float(tube)
    for name, (low, high) in SPACE.items():
        feed = name in (INSERTION["feed_speed_m_per_s"], WITHDRAWAL["feed_speed_m_per_s"])
        scale = np.log(high / low) if feed else high - low
        away = np.log(numbers[name] / BEST[name]) if feed else numbers[name] - BEST[name]
        total -= 40.0 * float(away / scale) ** 2
    return total


@pytest.fixture
def folders(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the folders that were played into, by a simulator with a known best."""
    seen: list[str] = []

    def run_plan(plan: Any, output: Path, **_: Any) -> pd.DataFrame:
        assert (plan.config.passes, plan.config.inspects) == ("both", "best")
        seen.append(output.name)
        rows = []
        for name, policy in plan.policies.items():
            ways = [way.at(20.0) for way in (policy.insertion.schedule, policy.withdrawal)]
            values = [value for feed, air in ways for value in (float(feed), 3600.0 * float(air))]
            numbers = dict(zip(COLUMNS, values, strict=True))
            for tube in range(len(plan.contexts)):
                row = {"policy": name, "context": tube, "seed": 0, "commit": "0123456789ab"}
                row |= {"reward": reward(numbers, tube), "inspection_time_s": 300.0, "a90_percent_wall": 20.0}
                rows.append(row | dict(zip(POD_NAMES, np.linspace(0.0, 1.0, len(POD_NAMES)), strict=True)))
        return pd.DataFrame(rows)

    monkeypatch.setattr(searched, "run_plan", run_plan)
    return seen


@pytest.mark.slow
def test_the_search_finds_what_is_best(folders: list[str], tmp_path: Path) -> None:
    """In 30 trials to within 0.2 of the most, where the reward falls by 40 over each range.

    Six other seeds of the process came to within 0.013; of 2,000 sets of 30 random points one in a hundred to 0.34.
    """
    best = run(Request(tmp_path, limit=2, trials=30))
    assert folders == [*(f"{k:03d}" for k in range(30)), "validation"]
    most = reward(BEST, 0)
    assert reward(dict(best), 0) > most - 0.2
    trials = pd.read_csv(tmp_path / f"{NAME}-trials.csv")
    assert trials.iloc[int(trials["reward"].argmax())][list(COLUMNS)].to_dict() == pytest.approx(dict(best))
    for name, (low, high) in SPACE.items():
        assert trials[name].between(low - 0.5, high + 0.5).all()
    record = json.loads((tmp_path / f"{NAME}.json").read_text())
    assert record["schedule"] == dict(best)
    assert {name: tuple(range_) for name, range_ in record["ranges"].items()} == SPACE
    fast = starts(CONFIG, SPACE)[0]
    gain = reward(dict(best), 0) - reward(dict(fast), 0)
    assert record["gain"] == pytest.approx({"mean": gain, "low": gain, "high": gain})
    assert set(record["validated"]) == {NAME, searched.BASELINE}
    policy = make_policy(str(tmp_path / f"{NAME}.csv"), CONFIG)
    assert policy.describe()["back"]["feed_speed"][0] == best[COLUMNS[2]]


def test_a_search_goes_on_where_it_was(folders: list[str], tmp_path: Path) -> None:
    """A longer one begins as a shorter one did, so what was played is asked for again."""
    tables = []
    for trials in (7, 8):
        run(Request(tmp_path, limit=1, trials=trials))
        tables.append(pd.read_csv(tmp_path / f"{NAME}-trials.csv"))
    pd.testing.assert_frame_equal(tables[0], tables[1].iloc[:7])
    assert folders.count("000") == 2


def test_the_file_says_both_ways(tmp_path: Path) -> None:
    path = tmp_path / "both.csv"
    path.write_text(searched.csv_of(CONFIG, BEST))
    forth, back = Schedule.read(path), Schedule.read_withdrawal(path)
    assert back is not None
    played = searched.policy_of(CONFIG, BEST)
    for length in (5.0, 33.0, 60.0):
        for schedule, numbers in ((forth, (0.3, 70.0)), (back, (0.15, 90.0))):
            assert [float(v) for v in schedule.at(length)] == pytest.approx([numbers[0], numbers[1] / 3600.0])
        assert np.allclose(played.withdrawal.at(length), back.at(length), rtol=1e-12)


def test_what_is_tried_is_what_the_device_can_do() -> None:
    """Of a plant with steps, whose air is less than the study's: starts are moved into its range.

    Steps [m3/h] of a coarse supply do not round air out of what is safe.
    """
    case = load_case(PLANT, "train", 6, "both")
    config, space = case.config, ranges(case.config, case.contexts)
    rounded = rounded_numbers(config, dict(zip(COLUMNS, (0.1337, 40.0, 0.2, 53.0), strict=True)))
    assert [rounded[name] for name in COLUMNS] == pytest.approx([0.135, 39.6, 0.2, 54.0])
    first = starts(config, space)
    assert all(low - 1e-9 <= one[name] <= high + 1e-9 for one in first for name, (low, high) in space.items())
    assert first[0][COLUMNS[0]] == pytest.approx(0.35)
    assert first[0][COLUMNS[1]] == pytest.approx(54.0)  # the study's 63 are out of its range
    safe_in, safe_back = safe_air(CONFIG, TUBES[:6], SPACE[COLUMNS[0]])
    for step in (5.0, 7.0, 12.0):
        config = CONFIG.model_copy(update={"air_supply_step": step / 3600.0})
        space = ranges(config, TUBES[:6])
        for share in np.linspace(0.0, 1.0, 41):
            rounded = rounded_numbers(config, {name: low + share * (high - low) for name, (low, high) in space.items()})
            assert rounded[COLUMNS[1]] >= safe_in
            assert rounded[COLUMNS[3]] <= safe_back
