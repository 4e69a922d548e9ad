"""What is unsafe is counted beside the reward: too little tension, too much, and pressure that buckles the cable."""

import gymnasium as gym
import numpy as np
import pytest
from probe_env.envs.task.safety import COSTS, cost_terms

import probe_env
from probe_env import Scene, TaskConfig
from probe_env.envs.episodes import Episodes
from probe_env.physics.closed_forms import buckling_load

FULL = (0.4, 30.0 / 3600.0)
MILD = probe_env.Context(friction=0.10, contact_stiffness=1.4e5, drag_factor=0.9, helix_diameter=2.5)


def played(config, feed, air, fidelity="fast"):
    """Infos of an episode under constant feed and air."""
    episodes, infos = Episodes(1, config, threads=1, fidelity=fidelity), []
    episodes.reset([0], {0: np.random.default_rng(0)}, {0: {"context": MILD}})
    while episodes.running.any():
        infos.append(episodes.step(config.action(feed, air)[None]).infos[0])
    return infos


def test_every_part_is_one_just_beyond_its_limit():
    config, load = TaskConfig(tension_limit=20.0), np.full(6, 47.0)
    mean = np.array([5.0, 0.5, 19.0, 21.0, -46.9, -47.1])
    greatest = np.array([20.0, 1.0, 20.1, 25.0, -40.0, -45.0])
    hanging = np.array([False, True, False, False, True, False])
    costs = cost_terms(config, hanging, mean, greatest, load)
    assert tuple(costs) == tuple(COSTS)
    assert costs["lost_drive"].tolist() == [0.0, 1.0, 0.0, 0.0, 1.0, 0.0]
    assert costs["tension"].tolist() == [0.0, 0.0, 1.0, 1.0, 0.0, 0.0]
    assert costs["buckling"].tolist() == [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]


def test_an_episode_adds_up_what_its_periods_cost():
    """Fed fast with the least air it loses the drive: every period from 6 m on below 3 N counts, three end it."""
    config = TaskConfig(required_tension=3.0, lost_drive_from=6.0, tension_limit=1.0)
    infos = played(config, *FULL)
    for info in infos:
        assert info["cost"] == sum(info["cost_terms"].values())
        slack = info["tension_mean_n"] < 3.0 and info["inserted_length"] >= 6.0
        assert info["cost_terms"]["lost_drive"] == float(slack)
        if info["tension_mean_n"] > 1.0:  # then its peak is
            assert info["cost_terms"]["tension"] == 1.0
    kpis = infos[-1]["episode_kpis"]
    assert kpis["lost_drive"] == 1.0
    assert kpis["cost_lost_drive"] == 3.0
    assert kpis["cost_tension"] == sum(info["cost_terms"]["tension"] for info in infos) > 0.0
    assert kpis["cost_buckling"] == 0.0
    assert kpis["cost"] == sum(info["cost"] for info in infos)


def test_no_limit_changes_a_reward():
    rewards = []
    for limit in (0.0, 110.0):
        infos = played(TaskConfig(tension_limit=limit, required_tension=3.0, lost_drive_from=6.0), *FULL)
        rewards.append(infos[-1]["episode_kpis"]["reward"])
    assert rewards[0] == rewards[1]


def test_a_cable_that_is_pressed_beyond_its_load_costs_on_the_way_back():
    """With the load of a cable between floats 0.5 N, and 8 m of it drawn back against the wind."""
    probe = {"flexural_rigidity": 5e-4, "guide_length": 0.5}
    scene = Scene.fitted({"tube": {"helix_length": 8.0}, "probe": probe, "contact": {"friction": 0.1}})
    load = buckling_load(scene.probe)
    assert load == pytest.approx(0.493, abs=1e-3)
    config = TaskConfig(scene=scene, passes="both", time_limit=200.0)
    infos = played(config, 0.2, 63.0 / 3600.0)
    pressed = [info["tension_mean_n"] < -load for info in infos if not info["diverged"]]
    assert [info["cost_terms"]["buckling"] == 1.0 for info in infos if not info["diverged"]] == pressed
    assert infos[-1]["episode_kpis"]["cost_buckling"] == sum(pressed) > 0
    assert infos[-1]["episode_kpis"]["cost_lost_drive"] == 0.0  # drawn, it needs no drive


def test_batches_tell_the_same_costs_as_single_environments():
    short = {"growing": False, "period": 0.05, "time_limit": 0.5, "settle_time": 0.05, "tension_limit": 0.3}
    scene, action = Scene(carrier_length=2.0), np.zeros(2, dtype=np.float32)
    batch = gym.make_vec("probe_env/Insertion-v1", num_envs=2, config=short, scene=scene)
    batch.reset(seed=[7, 8])
    singles = [gym.make("probe_env/Insertion-v1", config=short, scene=scene) for _ in range(2)]
    for seed, env in zip((7, 8), singles, strict=True):
        env.reset(seed=seed)
    for _ in range(5):
        together = batch.step(np.tile(action, (2, 1)))[4]
        apart = [env.step(action)[4] for env in singles]
        assert together["cost"].tolist() == [info["cost"] for info in apart]
        for name in COSTS:
            assert together["cost_terms"][name].tolist() == [info["cost_terms"][name] for info in apart]


def test_the_load_between_floats_is_that_of_a_bar_on_many_hinged_supports():
    """Least eigenvalue of stiffness against pressure for six spans of eight cubic elements, which is 2e-5 above."""
    probe, spans, pieces = Scene().probe, 6, 8
    h, nodes = probe.float_pitch / pieces, spans * pieces + 1
    bending = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2]])
    bending = np.vstack([bending, -bending[0], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]) * probe.flexural_rigidity / h**3
    pressing = np.array([[36, 3 * h, -36, 3 * h], [3 * h, 4 * h**2, -3 * h, -(h**2)]])
    pressing = np.vstack([pressing, -pressing[0], [3 * h, -(h**2), -3 * h, 4 * h**2]]) / (30.0 * h)
    stiff, pressed = np.zeros((2 * nodes, 2 * nodes)), np.zeros((2 * nodes, 2 * nodes))
    for k in range(nodes - 1):
        part = slice(2 * k, 2 * k + 4)
        stiff[part, part] += bending
        pressed[part, part] += pressing
    free = [k for k in range(2 * nodes) if k % (2 * pieces)]  # no deflection at a float
    values = np.linalg.eigvals(np.linalg.solve(stiff[np.ix_(free, free)], pressed[np.ix_(free, free)]))
    assert 1.0 / values.real.max() == pytest.approx(buckling_load(probe), rel=1e-4)
