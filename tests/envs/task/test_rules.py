"""Cost of a metre, conversion of actions, lost drive, and costs of unsafe events."""

import numpy as np
import pytest

from probe_env import Context, Scene, TaskConfig
from probe_env.envs.episodes import Episodes
from probe_env.envs.task import rules, scales
from probe_env.physics.closed_forms import buckling_load

FULL = (0.4, 30.0 / 3600.0)
MILD = Context(friction=0.10, contact_stiffness=1.4e5, drag_factor=0.9, helix_diameter=2.5)


def test_skipping_a_metre_never_pays():
    """At any feed and air, with the greatest vibration and the greatest change of action."""
    config = TaskConfig(vibration_weight=1.7, time_weight=0.13, air_weight=0.31, progress_weight=0.9)
    rng = np.random.default_rng(7)
    ratio = rng.uniform(0.0, 2.0 * config.ratio_cap, 200)
    feed, air = rng.uniform(*config.feed_speeds, 200), rng.uniform(*config.air_supply_rates, 200)
    squares = rules.capped_square(config, ratio)
    inspected = rules.metre_reward(config, rules.metre_cost(config, squares, feed, air))
    terms = rules.reward_terms(config, inspected=np.ones(200), squares=squares, seconds=1.0 / feed, air=air / feed)
    assert inspected == pytest.approx(sum(terms.values()), rel=1e-13)
    jerk = config.jerk_weight * 8.0 / config.period  # both actions from one end to the other: 2^2 + 2^2
    assert (inspected - jerk / feed > -rules.uninspected_weight(config)).all()
    slowest = config.feed_speeds[0]
    worst = rules.metre_cost(config, config.ratio_cap**2, slowest, config.air_supply_rates[1]) + jerk / slowest
    assert rules.uninspected_weight(config) == pytest.approx(float(worst) + config.progress_weight, rel=1e-14)


def test_actions_convert_to_another_range_also_beyond_its_ends():
    own, other = (0.02, 0.4), (0.05, 0.25)
    values = np.linspace(*own, 7)
    fractions = scales.fraction_between(values, own)
    assert scales.value_at(fractions, own) == pytest.approx(values, rel=1e-15)
    assert scales.fraction_of(scales.action_of(fractions)) == pytest.approx(fractions, abs=1e-15)
    assert (scales.fraction_of(np.array([-1.5, 1.5])) == [0.0, 1.0]).all()
    geometric = scales.geometric_at(fractions, own)
    assert scales.geometric_fraction(geometric, own) == pytest.approx(fractions, abs=1e-15)
    assert geometric[[0, 3, 6]] == pytest.approx([own[0], (own[0] * own[1]) ** 0.5, own[1]], rel=1e-15)
    here, there = TaskConfig(feed_speeds=own), TaskConfig(feed_speeds=other)
    actions = np.array([-1.0, -0.5, 0.0, 1.0])
    targets = here.targets(np.column_stack([actions, actions]))[:, 0]
    translated = scales.action_in(actions, own, other)
    assert scales.value_at(0.5 * (translated + 1.0), other) == pytest.approx(targets, rel=1e-14)
    assert translated[0] < -1.0
    assert translated[-1] > 1.0
    standstill = scales.action_in(np.array([float(here.standstill)]), own, other)
    assert standstill == pytest.approx(float(there.standstill), abs=2.0**-22)  # both are float32


def play(config, feed, air, fidelity="fast"):
    episodes, infos = Episodes(1, config, threads=1, fidelity=fidelity), []
    episodes.reset([0], {0: np.random.default_rng(0)}, {0: {"context": MILD}})
    while episodes.running.any():
        infos.append(episodes.step(config.action(feed, air)[None]).infos[0])
    return infos


def test_a_cost_term_is_one_beyond_its_limit():
    config, load = TaskConfig(tension_limit=20.0), np.full(6, 47.0)
    mean = np.array([5.0, 0.5, 19.0, 21.0, -46.9, -47.1])
    maximum = np.array([20.0, 1.0, 20.1, 25.0, -40.0, -45.0])
    is_slack = np.array([False, True, False, False, True, False])
    costs = rules.cost_terms(config, is_slack, mean, maximum, load)
    assert tuple(costs) == tuple(rules.COSTS)
    assert costs["lost_drive"].tolist() == [0.0, 1.0, 0.0, 0.0, 1.0, 0.0]
    assert costs["tension"].tolist() == [0.0, 0.0, 1.0, 1.0, 0.0, 0.0]
    assert costs["buckling"].tolist() == [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]


def test_lost_drive_ends_an_episode():
    """Fast feed with the least air loses the drive: periods below 3 N count from 6 m on, three end the episode."""
    config = TaskConfig(required_tension=3.0, lost_drive_from=6.0, tension_limit=1.0)
    infos = play(config, *FULL)
    for info in infos:
        assert info["cost"] == sum(info["cost_terms"].values())
        slack = info["tension_mean_n"] < 3.0 and info["inserted_length"] >= 6.0
        assert info["cost_terms"]["lost_drive"] == float(slack)
        if info["tension_mean_n"] > 1.0:  # then its peak is
            assert info["cost_terms"]["tension"] == 1.0
    kpis = infos[-1]["episode_kpis"]
    assert (kpis["lost_drive"], kpis["lost_drive_events"], kpis["complete"]) == (1.0, 1.0, 0.0)
    uninspected = -rules.uninspected_weight(config) * (55.0 - kpis["inspected_m"])
    assert infos[-1]["reward_terms"]["uninspected"] == pytest.approx(uninspected)
    assert kpis["cost_lost_drive"] == 3.0
    assert kpis["cost_tension"] == sum(info["cost_terms"]["tension"] for info in infos) > 0.0
    assert kpis["cost_buckling"] == 0.0
    assert kpis["cost"] == sum(info["cost"] for info in infos)
    without_limit = play(TaskConfig(required_tension=3.0, lost_drive_from=6.0, tension_limit=0.0), *FULL)
    assert without_limit[-1]["episode_kpis"]["reward"] == kpis["reward"]


def test_buckling_has_a_cost_on_withdrawal():
    """With a buckling load of 0.5 N and 8 m of cable withdrawn against the air."""
    probe = {"flexural_rigidity": 5e-4, "guide_length": 0.5}
    scene = Scene.fitted({"tube": {"helix_length": 8.0}, "probe": probe, "contact": {"friction": 0.1}})
    load = buckling_load(scene.probe)
    assert load == pytest.approx(0.493, abs=1e-3)
    config = TaskConfig(scene=scene, passes="both", time_limit=200.0)
    infos = play(config, 0.2, 63.0 / 3600.0)
    finite = [info for info in infos if not info["diverged"]]
    buckled = [info["tension_mean_n"] < -load for info in finite]
    assert [info["cost_terms"]["buckling"] == 1.0 for info in finite] == buckled
    assert infos[-1]["episode_kpis"]["cost_buckling"] == sum(buckled) > 0
    assert infos[-1]["episode_kpis"]["cost_lost_drive"] == 0.0  # withdrawal needs no drive


def test_buckling_load_of_a_bar_on_hinged_supports():
    """Least eigenvalue of six spans with eight cubic elements each, which is 2e-5 above."""
    probe, spans, pieces = Scene().probe, 6, 8
    h, nodes = probe.float_pitch / pieces, spans * pieces + 1
    bending = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2]])
    bending = np.vstack([bending, -bending[0], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]) * probe.flexural_rigidity / h**3
    compression = np.array([[36, 3 * h, -36, 3 * h], [3 * h, 4 * h**2, -3 * h, -(h**2)]])
    compression = np.vstack([compression, -compression[0], [3 * h, -(h**2), -3 * h, 4 * h**2]]) / (30.0 * h)
    stiff, geometric = np.zeros((2 * nodes, 2 * nodes)), np.zeros((2 * nodes, 2 * nodes))
    for k in range(nodes - 1):
        part = slice(2 * k, 2 * k + 4)
        stiff[part, part] += bending
        geometric[part, part] += compression
    free = [k for k in range(2 * nodes) if k % (2 * pieces)]  # no deflection at a float
    values = np.linalg.eigvals(np.linalg.solve(stiff[np.ix_(free, free)], geometric[np.ix_(free, free)]))
    assert 1.0 / values.real.max() == pytest.approx(buckling_load(probe), rel=1e-4)


def test_only_the_time_limit_alone_truncates():
    """Cases: none, late, complete and late, drive lost and late, diverged and late, late but not stepped."""
    config, length = TaskConfig(time_limit=10.0, lost_drive_periods=3), np.full(6, 60.0)
    inserted, slack_steps = np.array([30.0, 30.0, 60.0, 30.0, 30.0, 30.0]), np.array([2, 2, 0, 3, 0, 0])
    time, stepped = np.array([9.0, 10.0, 10.0, 10.0, 10.0, 10.0]), np.array([True] * 5 + [False])
    diverged = np.array([False] * 4 + [True, False])
    ends = rules.ending(config, rules.Situation(inserted, length, slack_steps, stepped, diverged), time)
    score = rules.Score({}, {}, ends, np.zeros(6))
    assert score.truncated.tolist() == [False, True, False, False, False, False]
    assert score.terminated.tolist() == [False, False, True, True, True, False]
    assert rules.any_ending(ends).tolist() == [False, True, True, True, True, False]


def test_slack_periods_are_counted_consecutively():
    slack = np.array([[1, 1, 0, 1, 1, 1, 1], [0, 1, 1, 1, 0, 0, 1]], dtype=bool)
    counts = [np.zeros(2, dtype=int)]
    for is_slack in slack.T:
        counts.append(rules.consecutive_slack(counts[-1], is_slack))
    assert np.array(counts[1:]).T.tolist() == [[1, 2, 0, 1, 2, 3, 4], [0, 1, 2, 3, 0, 0, 1]]
