"""Planners of a whole inspection: copies do as the episodes would, the rest is worth no less than what comes."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from agents.policies.catalogue import make_policy
from agents.policies.planner import (
    InspectionPlanner,
    earned,
    tried_both_ways,
    worth_of_rest,
)
from agents.policies.planner import BLUR
from agents.evaluation.plan import Plan, run_plan
from probe_env import Context
from probe_env.arrays import FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.envs.task import Inspects, TaskConfig
from probe_env.fidelity import BOTH_WAYS

TUBES = (Context(friction=0.2, helix_diameter=1.0), Context(friction=0.12, helix_diameter=2.0))
LENGTH = 8.0


def task(inspects: Inspects = "best", measure: str = "displacement", **changes: object) -> TaskConfig:
    """Both ways in a short helix."""
    scene = {"carrier_length": 2.5, "tube": {"helix_length": LENGTH}}
    return TaskConfig(passes="both", inspects=inspects, vibration_measure=measure, scene=scene, **changes)


def begun(config: TaskConfig) -> Episodes:
    """Two episodes, one a tube."""
    episodes = Episodes(2, config, threads=1, fidelity="fast")
    rngs = {k: np.random.default_rng(k) for k in range(2)}
    episodes.reset(range(2), rngs, {k: {"context": TUBES[k]} for k in range(2)})
    return episodes


def held(config: TaskConfig, feed: float, air: float) -> FloatArray:
    """Actions of both episodes."""
    return np.tile(config.action(feed, air), (2, 1))


def rest(episodes: Episodes, feed: float = 0.4, air: float = 30.0 / 3600.0) -> FloatArray:
    """Worth with the same feed and air held in all episodes: by default the fastest and the least."""
    return worth_of_rest(episodes, np.tile([feed, air], (len(episodes), 1)))


@pytest.mark.parametrize(("inspects", "measure"), [("best", "displacement"), ("back", "snr")])
def test_copies_of_an_episode_do_as_it_does(inspects: Inspects, measure: str) -> None:
    """From the way in over the turn to the end: every observation, reward and ending, to the last bit."""
    config = task(inspects, measure, sensor_dropout=0.3, delay_periods=1)
    episodes = begun(config)
    for _ in range(3):
        episodes.step(held(config, 0.4, 0.02))
    aside = copy.deepcopy(episodes)
    forked = episodes.fork([1, 0, 1])
    assert forked.context == [TUBES[1], TUBES[0], TUBES[1]]
    while forked.running.any():
        running, actions = forked.running.copy(), held(config, 0.35, 0.025)
        one, other = forked.step(np.vstack([actions, actions[:1]]), running), aside.step(actions, aside.running.copy())
        for name in ("observation", "reward", "terminated", "truncated"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name)[[1, 0, 1]])
    assert (forked.passes.way < 0.0).all()
    assert not aside.running.any()
    alone = begun(config)
    for _ in range(3):
        alone.step(held(config, 0.4, 0.02))
    steps = [each.step(held(config, 0.3, 0.02)) for each in (episodes, alone)]
    np.testing.assert_array_equal(steps[0].observation, steps[1].observation)
    np.testing.assert_array_equal(steps[0].reward, steps[1].reward)


@pytest.mark.parametrize("inspects", ["best", "back"])
def test_no_episode_earns_more_than_the_rest_is_worth(inspects: Inspects) -> None:
    """At every period of inspections that are fast and quiet, slow, and shaken by their feed."""
    config = task(inspects)
    rng = np.random.default_rng(5)
    for feed in (0.4, 0.15, None):
        episodes = begun(config)
        worth, rewards = [rest(episodes)], []
        while episodes.running.any():
            drawn = float(rng.uniform(0.1, 0.4)) if feed is None else feed
            rewards.append(episodes.step(held(config, drawn, 0.02), episodes.running.copy()).reward)
            worth.append(rest(episodes))
        to_come = np.cumsum(rewards[::-1], axis=0)[::-1]
        assert (to_come <= np.array(worth[:-1]) + 1e-9).all()
        np.testing.assert_array_equal(worth[-1], 0.0)
        if feed == 0.4 and inspects == "best":  # and by little: the ramps, the air, what the turn shakes
            assert (to_come[0] > worth[0] - 0.6).all()


def test_the_rest_is_what_is_left_of_both_ways() -> None:
    config = task()
    episodes = begun(config)
    per_metre = config.time_weight / 0.4 + config.air_weight * config.air_supply_rates[0] / 0.4
    np.testing.assert_allclose(rest(episodes), 3.0 * config.progress_weight - 6.0 * per_metre)
    slower = (config.time_weight + config.air_weight * 0.02) / 0.1  # a metre of the way in
    np.testing.assert_allclose(rest(episodes, 0.1, 0.02), 3.0 * (config.progress_weight - per_metre - slower))
    while episodes.gauges.inserted().min() < 6.9:
        episodes.step(held(config, 0.4, 0.02))
    passes = episodes.passes
    known = [passes._shown[k][:, 1].sum() for k in range(2)]
    left = LENGTH - episodes.gauges.inserted()
    expected = left * config.progress_weight - (left + 3.0) * per_metre + config.vibration_weight * np.array(known)
    np.testing.assert_allclose(rest(episodes), expected)
    assert min(known) > 0.0
    hanging = episodes.fork([0])
    hanging.tally[0].slack_periods = 1
    assert rest(hanging)[0] == pytest.approx(-config.uninspected_weight * (left[0] + 3.0))


def test_what_is_earned_ends_with_the_episode() -> None:
    """A copy that is back stays at what it earned; others go on."""
    config = task()
    episodes = begun(config)
    actions = np.array([[0.4, 0.02], [0.1, 0.02]])
    whole = earned(episodes.fork([0, 1]), actions, 1000)
    np.testing.assert_allclose(earned(episodes.fork([0, 1]), actions, 24)[0], whole[0])
    rewards = np.zeros(2)
    while episodes.running.any():
        given = config.actions(*actions.T).astype(np.float32)
        rewards += episodes.step(given, episodes.running.copy()).reward
    np.testing.assert_array_equal(whole, rewards)


def test_what_is_held_and_any_air_at_the_fastest_feed_are_tried() -> None:
    config = task(feed_speed_step=0.01, air_supply_step=5.0 / 3600.0)
    kept = np.array([[0.2, 0.02], [0.1, 0.03]])
    tried = tried_both_ways(kept, 41, config, [0, 3])
    np.testing.assert_allclose(tried[:, 0], config.given(*kept.T), rtol=1e-6)
    np.testing.assert_allclose(tried[:, 1], config.given(np.full(2, 0.4), kept[:, 1]), rtol=1e-6)
    np.testing.assert_allclose(tried[:, 3::2, 0], 0.4)
    least, most = config.air_supply_rates
    for lowest in np.linspace(least, most, 5)[:-1]:  # 19 draws: each quarter is missed once in 240 sets
        assert ((tried[0, 3::2, 1] >= lowest) & (tried[0, 3::2, 1] <= lowest + 0.25 * (most - least))).any()
    assert (np.abs(tried[0, 2::2, 0] / 0.2 - 1.0) < 0.5).all()
    np.testing.assert_array_equal(tried_both_ways(kept[1:], 41, config, [0, 3])[0], tried[1])
    assert not np.array_equal(tried_both_ways(kept, 41, config, [0, 4]), tried)
    assert tried_both_ways(kept, 1, config, [0, 3]).shape == (2, 1, 2)


def test_planning_leaves_the_episodes_alone_and_needs_no_company() -> None:
    config = task()
    looked, alone = begun(config), begun(config)
    planner = InspectionPlanner(config, periods=2, candidates=4, blur=BLUR)
    both, states = planner.decide(looked, [0, 1], looked.observation, [None, None])
    one, _ = planner.decide(alone, [1], alone.observation[1:], [None])
    np.testing.assert_array_equal(one[0], both[1])
    assert [state[0] for state in states] == [1, 1]
    kept, _ = planner.decide(looked, [0, 1], looked.observation, states)
    np.testing.assert_array_equal(kept, both)  # until the next plan
    steps = [each.step(np.zeros((2, 2))) for each in (looked, alone)]
    np.testing.assert_array_equal(steps[0].observation, steps[1].observation)
    np.testing.assert_array_equal(steps[0].reward, steps[1].reward)


def test_a_planned_inspection_is_fast_and_comes_back() -> None:
    """It begins at 0.2 m/s, and of the 1.5 that lie between that and the best there is it finds all but a third.

    The third is more than ramps and turn take from a probe that is fed at full speed.
    """
    config = task()
    plan = Plan({"planner": make_policy("planner", config)}, TUBES, config=config, fidelity=BOTH_WAYS["fast"])
    table = run_plan(plan, None, threads=1)
    assert table["complete"].all()
    most = rest(begun(config))[0]
    slow = 3.0 - 6.0 * (config.time_weight + config.air_weight * config.air_supply_rates[0]) / 0.2
    assert (table["reward"] > slow + 2.0 / 3.0 * (most - slow)).all()
    assert (table["reward"] <= most).all()


def test_planners_of_both_ways_go_by_the_names_of_the_way_in() -> None:
    config = task()
    assert make_policy("planner", config).describe()["blur"] == 0.0
    assert make_policy("planner-blurred", config).describe()["blur"] == BLUR
    with pytest.raises(ValueError, match="'planner-estimated' looks ahead on the way in alone; planners of both ways"):
        make_policy("planner-estimated", config)
    with pytest.raises(ValueError, match="inspects = 'in': the way back counts for nothing"):
        make_policy("planner", task("in"))
    with pytest.raises(ValueError, match="candidates = 0 is outside the accepted range 1 to 1000"):
        InspectionPlanner(config, candidates=0)
    with pytest.raises(ValueError, match="a planner tries things out on the simulator itself"):
        make_policy("planner", config).predict(np.zeros(len(config.observations)))
