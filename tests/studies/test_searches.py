"""Searches of schedules and PLC constants: known optima are found, resuming, and what is stored."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest

from probe_agents.policies.cases import load_case
from probe_agents.policies.catalogue import BY_DIAMETER, DATA, make_policy
from probe_agents.policies.on_map import min_air
from probe_agents.policies.plc_law import STORED_INTEGRAL, Constants, read_constants
from probe_agents.records.manifest import commit
from probe_agents.studies import searches
from probe_agents.studies.searches import MapCost
from probe_env.envs.contexts import HELIX_DIAMETERS
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.vibration_map import stored_map
from probe_env.files import FileError
from probe_env.inspection.metrics import POD_NAMES
from probe_env.schedule import Schedule

CONFIG = TaskConfig().full_observation
TUBES = load_case(None, "train").contexts
SIMULATED_AT = "0123456789ab"
Fake = Callable[[Callable[[Any], float]], list[str]]


@pytest.fixture
def simulate(monkeypatch):
    """Replaces simulations by a reward of the policy plus the number of the tube; returns the folders used."""

    def replace(reward):
        folders: list[str] = []

        def run_plan(plan, output, **_):
            folders.append(output.name)
            figures = {"inspection_time_s": 300.0, "a90_percent_wall": 20.0, "commit": SIMULATED_AT}
            figures |= dict(zip(POD_NAMES, np.linspace(0.0, 1.0, len(POD_NAMES)), strict=True))
            return pd.DataFrame(
                {"policy": name, "context": tube, "seed": seed, "reward": reward(policy) + tube} | figures
                for name, policy in plan.policies.items()
                for seed in plan.seeds
                for tube in range(len(plan.contexts))
            )

        monkeypatch.setattr(searches, "run_plan", run_plan)
        return folders

    return replace


def commits_of(path):
    record = json.loads(path.read_text())
    return str(record.get("provenance", record)["commit"]).split(", ")


def test_point_of_search_is_a_schedule():
    low = searches.FAMILIES["best-constant"].schedule([0.0, 0.0], CONFIG)
    assert (low.feed_speed[0], low.air_supply_rate[0]) == pytest.approx((0.04, min_air(CONFIG)))
    point = [1.0] * len(searches.KNOTS) + [0.0] * (len(searches.AIR_KNOTS) - 1) + [1.0]
    high = searches.FAMILIES["best-schedule"].schedule(point, CONFIG)
    assert high.feed_speed == pytest.approx([0.4] * len(high.position))
    assert set(high.position) == {*searches.KNOTS, *searches.AIR_KNOTS}
    assert [high.air_supply_rate[k] for k in (0, -1)] == pytest.approx([min_air(CONFIG), 130.0 / 3600.0])


def test_schedule_of_the_nearest_diameter_is_taken():
    policy = make_policy(BY_DIAMETER, CONFIG)
    names, observation = list(CONFIG.observations), np.zeros((len(HELIX_DIAMETERS), len(CONFIG.observations)))
    observation[:, names.index("helix_diameter")] = (np.array(HELIX_DIAMETERS) + 0.04) / 2.5
    observation[:, names.index("inserted_length")] = 40.0 / 60.0
    feed = CONFIG.targets(policy.predict(observation.astype(np.float32))[0])[:, 0]
    expected = [float(Schedule.read(DATA / f"best-schedule-d{d:g}.csv").at(40.0)[0]) for d in HELIX_DIAMETERS]
    assert feed == pytest.approx(expected, rel=1e-4)


def test_schedule_search_finds_a_known_optimum(simulate, tmp_path, monkeypatch):
    """Reward -100 (u - 0.1)^2 - (3600 Q - 80)^2 / 1000: 0.1 m/s and 80 m3/h, by equal trials in each search."""

    def reward(_, schedule):
        return -100.0 * (schedule.feed_speed[0] - 0.1) ** 2 - (schedule.air_supply_rate[0] * 3600.0 - 80.0) ** 2 / 1e3

    monkeypatch.setattr(MapCost, "reward", reward)
    simulate(lambda policy: 0.0)
    folders = [tmp_path / name for name in ("once", "again")]
    for folder in folders:
        best = searches.search_schedule("best-constant", folder, 250, stored_map(), None)
    trials = [pd.read_csv(folder / "best-constant-trials.csv") for folder in folders]
    pd.testing.assert_frame_equal(*trials, check_exact=True)
    assert commits_of(folders[0] / "best-constant.json") == [SIMULATED_AT, commit()]
    assert len(trials[0]) == 256  # whole generations of 16
    assert best.feed_speed[0] == pytest.approx(0.1, rel=0.02)
    assert best.air_supply_rate[0] * 3600.0 == pytest.approx(80.0, rel=0.02)


@pytest.mark.parametrize("name", ["setting.json", "episodes.jsonl"])
def test_damaged_episodes_are_refused_before_the_search(name, tmp_path, monkeypatch):
    monkeypatch.setattr(MapCost, "reward", lambda *_: pytest.fail("a schedule was tried"))
    file = tmp_path / "simulated" / "best-constant" / name
    file.parent.mkdir(parents=True)
    file.write_text("seven\n")
    with pytest.raises(FileError, match=name):
        searches.search_schedule("best-constant", tmp_path, 16, stored_map(), None)
    assert [path.name for path in file.parent.iterdir()] == [name]


def test_shorter_search_begins_as_a_longer_one():
    """So an interrupted search needs nothing of the first one to go on."""

    def rewards_of(x):
        return list(-((x[:, 0] - 0.3) ** 2) - x[:, 1] ** 2)

    both = [searches.search(rewards_of, (0.5, 0.5), generations, "test")[0] for generations in (3, 6)]
    assert (both[0] == both[1][:48]).all()


def test_points_and_constants_are_inverses():
    rng = np.random.default_rng(0)
    for _ in range(20):
        x = rng.uniform(0.3, 0.7, len(searches.SEARCH_RANGES))  # within the accepted ranges
        np.testing.assert_allclose(searches.point_of(searches.constants_at(x)), x, atol=2e-3)  # four digits are kept
    assert set(searches.SEARCH_RANGES) == set(Constants.model_fields)
    for end in (0.0, 1.0):
        searches.constants_at(np.full(len(searches.SEARCH_RANGES), end))  # valid


def test_law_search_finds_an_optimum_in_new_tubes(simulate, tmp_path, monkeypatch):
    """With rewards that are best at a known point; a longer search begins with the shorter one."""

    def distance(constants):
        return float(np.abs(searches.point_of(constants) - 0.4).sum())

    def recorded(plan, output, **_):
        tubes[output.name] = plan.contexts
        return fake(plan, output)

    folders, tubes = simulate(lambda policy: -distance(policy.constants)), {}
    fake = searches.run_plan
    monkeypatch.setattr(searches, "run_plan", recorded)
    per_generation = 2 * searches.LAWS
    searches.search_plc(tmp_path, limit=2, trials=2 * per_generation)
    short = pd.read_csv(tmp_path / "plc-integral-trials.csv")
    found = searches.search_plc(tmp_path, limit=2, trials=100 * per_generation)
    trials = pd.read_csv(tmp_path / "plc-integral-trials.csv")
    pd.testing.assert_frame_equal(short, trials.iloc[: len(short)])
    assert trials["generation"].value_counts().eq(searches.LAWS).all()
    assert distance(found) < 0.2 * distance(read_constants(STORED_INTEGRAL))
    assert read_constants(tmp_path / "plc-integral.json") == found
    assert commits_of(tmp_path / "plc-integral.json") == [SIMULATED_AT]
    assert folders[-1] == "validation"
    drawn = [*tubes.pop("validation"), *(tube for pair in tubes.values() for tube in pair)]
    assert len(set(drawn)) == len(drawn) == 24 + 2 * 100


def test_law_search_keeps_a_start_that_nothing_beats(simulate, tmp_path):
    start = read_constants(STORED_INTEGRAL)
    simulate(lambda policy: -float(policy.constants != start))
    assert searches.search_plc(tmp_path, limit=1, trials=1) == start


def test_laws_of_single_tubes_are_compared_at_seeds_that_were_not_searched(simulate, tmp_path, monkeypatch):
    def distance(constants):
        return float(np.abs(searches.point_of(constants) - 0.4).sum())

    def recorded(plan, output, **_):
        plans.setdefault(plan.contexts, []).append(plan)
        return fake(plan, output)

    simulate(lambda policy: -distance(policy.constants))
    plans, fake = {}, searches.run_plan
    monkeypatch.setattr(searches, "run_plan", recorded)
    table = searches.search_plc_by_tube(tmp_path, limit=2, trials=30 * searches.LAWS)
    assert len(plans) == 2
    for tube in plans.values():
        *searched, compared = [list(plan.seeds) for plan in tube]
        assert searched == [[seed] for seed in range(30)]
        assert compared == [30, 31, 32, 33]
        own, start = (distance(tube[-1].policies[name].constants) for name in ("own", "start"))
        assert own < 0.5 * start
    assert table.groupby(["policy", "context"]).size().eq(4).all()
    gain = json.loads((tmp_path / "plc-by-tube.json").read_text())["gain"]
    assert gain["low"] == pytest.approx(gain["mean"]) == pytest.approx(start - own)
