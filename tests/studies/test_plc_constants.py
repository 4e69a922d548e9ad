"""The searches for the constants of the PLC laws, on the map and in simulation."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from probe_agents.policies.catalogue import make_policy
from probe_agents.policies.plc_law import PlcProportional, Trim, read_constants, read_trim
from probe_agents.records.manifest import commit
from probe_agents.studies.builtin import Request
from probe_agents.studies.shipped import plc_constants as search
from probe_agents.studies.shipped.best_schedules import MapCost
from probe_agents.studies.shipped.plc_constants import (
    AIMS,
    TIMES,
    UNTRIMMED,
    constants_at,
    point_of,
    quasi_steady_rewards,
    search_law,
    search_trim,
)
from probe_env import Context, spread_contexts
from probe_env.envs.task import TaskConfig
from probe_env.envs.vibration_map import stored_map
from probe_env.schedule import Schedule

CONFIG = TaskConfig().full_observation


def test_a_quasi_steady_world_earns_what_the_map_expects_of_a_schedule() -> None:
    """A fixed feed: the sum over seconds against that over the middles of metres, which the searches go by."""
    tubes = (Context(friction=0.1, helix_diameter=2.5), Context(friction=0.25, helix_diameter=1.0))
    fixed = Schedule("inserted_length", "linear", (5.0, 60.0), (0.1, 0.1), (100.0 / 3600.0, 100.0 / 3600.0))
    rewards = quasi_steady_rewards(make_policy("slow", CONFIG), tubes, stored_map())
    for reward, tube in zip(rewards, tubes, strict=True):
        expected = MapCost((tube,), CONFIG, stored_map()).reward(fixed)
        assert reward == pytest.approx(expected, abs=0.05)  # a metre is ten of its seconds: order two, 55 metres
    assert rewards[0] > rewards[1]


def test_the_law_keeps_the_reward_of_tension_scheduled_on_training_tubes_by_the_map() -> None:
    tubes, vibration = spread_contexts("train", 12), stored_map()
    law = quasi_steady_rewards(PlcProportional(CONFIG), tubes, vibration).mean()
    schedule = quasi_steady_rewards(make_policy("best-schedule", CONFIG), tubes, vibration).mean()
    assert law > schedule + 5.0  # no dice in this world


def test_points_and_constants_are_inverses() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        x = rng.random(10)
        np.testing.assert_allclose(point_of(constants_at(x)), x, atol=2e-3)  # four digits are kept


def test_a_search_goes_from_the_map_to_the_simulation(tmp_path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    """With rewards that are best at a known place."""
    goal = constants_at(np.full(10, 0.4))

    def by_map(policy, tubes, vibration):  # type: ignore[no-untyped-def]
        return np.full(len(tubes), -np.abs(point_of(policy.constants) - 0.4).sum())

    def run_plan(plan, folder, progress, workers):  # type: ignore[no-untyped-def]
        rewards = {name: float(by_map(policy, plan.contexts, None)[0]) for name, policy in plan.policies.items()}
        return pd.DataFrame({"policy": list(rewards), "reward": list(rewards.values()), "commit": "0123456789ab"})

    monkeypatch.setattr(search, "quasi_steady_rewards", by_map)
    monkeypatch.setattr(search, "run_plan", run_plan)
    optimum = search_law(300, 5, 6, Request(tmp_path))
    trials = pd.read_csv(tmp_path / "plc-law-trials.csv")
    assert trials["where"].value_counts().to_dict() == {"map": 301, "simulated": 51}
    assert trials["reward"].iloc[-1] > trials["reward"].iloc[0]
    assert np.abs(point_of(optimum) - point_of(goal)).max() < 0.2
    assert read_constants(tmp_path / "plc-law.json") == optimum
    record = json.loads((tmp_path / "plc-law.json").read_text())
    assert record["provenance"]["commit"].split(", ") == [commit(), "0123456789ab"]


def test_the_grid_takes_the_best_and_says_by_how_much(tmp_path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    def run_plan(plan, folder, workers):  # type: ignore[no-untyped-def]
        assert plan.policies[UNTRIMMED].describe()["policy"] == "PlcProportional"
        rows = []
        for name, policy in plan.policies.items():
            trim = getattr(policy, "trim", None)
            worth = 5.0 - abs(np.log(trim.aim / AIMS[1])) - abs(np.log(trim.time / TIMES[2])) if trim else 0.0
            rows += [
                {"policy": name, "context": k, "seed": 0, "reward": worth + k, "commit": "0123456789ab"}
                for k in range(len(plan.contexts))
            ]
        return pd.DataFrame(rows)

    monkeypatch.setattr(search, "run_plan", run_plan)
    assert search_trim(6, Request(tmp_path)) == Trim(aim=AIMS[1], time=TIMES[2])
    assert read_trim(tmp_path / "trimmed-law.json") == Trim(aim=AIMS[1], time=TIMES[2])
    trials = pd.read_csv(tmp_path / "trimmed-law-trials.csv")
    assert len(trials) == len(AIMS) * len(TIMES)
    assert trials.loc[trials["gain"].idxmax(), ["gain", "gain_low", "gain_high"]].tolist() == pytest.approx([5.0] * 3)
