"""Actions that change the targets and last for several control periods."""

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO

from probe_agents.policies.bundle import from_sb3, load_bundle, save_bundle
from probe_agents.vec_env import ProbeVecEnv
from probe_env import TaskConfig
from probe_env.envs import IncrementalInsertionEnv
from probe_env.envs.episodes.actions import AVERAGED, changed_targets

CONFIG = TaskConfig(**IncrementalInsertionEnv.defaults)
PERIODS = CONFIG.periods_per_action
AIR = {"air_supply_rates": CONFIG.air_supply_rates}
TUBE = {"friction": 0.2, "helix_diameter": 1.5}


def periods_of(actions, fidelity="surrogate"):
    """Steps of Insertion-v1 with the targets that these changes give, one for each period of an action."""
    env = gym.make("probe_env/Insertion-v1", fidelity=fidelity, config=AIR)
    env.reset(seed=3, options=TUBE)
    targets = env.unwrapped.episodes.actions
    for action in actions:
        targets = changed_targets(CONFIG, targets, np.array([action]))
        yield [env.step(targets[0]) for _ in range(PERIODS)]


def test_feed_changes_by_ratios_and_decreases_faster():
    """Air changes by a fraction of its range, and so does the feed of agents that were trained that way."""
    actions = np.array([[1.0, 1.0], [0.5, -1.0], [-1.0, 0.5], [0.0, 0.0]])
    config = TaskConfig(change_per_action=0.1, feed_decrease_per_action=0.2, logarithmic_change=True)
    start = config.actions(np.full(4, 0.1), np.full(4, 0.02)).astype(np.float32)
    changed = changed_targets(config, start, actions)
    feed, air = config.targets(changed).T
    assert feed == pytest.approx(0.1 * (0.4 / 0.02) ** np.array([0.1, 0.05, -0.2, 0.0]), rel=1e-6)
    assert air == pytest.approx(0.02 + 0.1 * actions[:, 1] * 100.0 / 3600.0, rel=1e-6)
    assert (changed[3] == start[3]).all()
    linear = changed_targets(TaskConfig(change_per_action=0.125), start, actions)
    assert linear == pytest.approx(start + 0.25 * actions, rel=1e-6)


@pytest.mark.parametrize("fidelity", ["surrogate", "fast"])
def test_an_action_is_some_periods_of_a_changed_target(fidelity):
    actions = [(1.0, -1.0), (0.5, 0.0), (1.0, 1.0)]
    env = gym.make("probe_env/IncrementalInsertion-v1", fidelity=fidelity)
    before = env.reset(seed=3, options=TUBE)[1]["inserted_length"]
    names = list(TaskConfig().observations)
    for action, periods in zip(actions, periods_of(actions, fidelity), strict=True):
        observation, reward, _, _, info = env.step(np.array(action, dtype=np.float32))
        observations, rewards, _, _, infos = zip(*periods, strict=True)
        terms, metres = info["reward_terms"], infos[-1]["inserted_length"] - before
        before = infos[-1]["inserted_length"]
        assert terms.pop("shaping") == pytest.approx(2.0 * metres, abs=1e-9)
        assert reward == pytest.approx(sum(rewards) + 2.0 * metres, rel=1e-9)
        for k, name in enumerate(names):
            single = np.mean([each[k] for each in observations]) if name in AVERAGED else observations[-1][k]
            assert observation[k] == pytest.approx(single, rel=1e-6)
        for name, value in terms.items():
            assert value == pytest.approx(sum(each["reward_terms"][name] for each in infos), rel=1e-12)
        assert info["time"] == infos[-1]["time"]


def test_targets_are_clipped_and_actions_outside_refused():
    env = gym.make("probe_env/IncrementalInsertion-v1", fidelity="surrogate")
    env.reset(seed=3, options=TUBE)
    for _ in range(9):
        *_, info = env.step(np.array([1.0, -1.0], dtype=np.float32))
    assert (info["target_feed_speed"], info["target_air_supply_rate"]) == pytest.approx((0.4, 72.5 / 3600.0))
    with pytest.raises(ValueError, match=r"action\[0\] = 1.5 is outside the accepted range -1 to 1"):
        env.unwrapped.step(np.array([1.5, 0.0], dtype=np.float32))


@pytest.mark.parametrize("air", [0.5, -1.0])
def test_every_episode_of_a_tube_is_paid_the_same_shaping(air):
    """2 per metre from 5 to 60 m, whether the probe arrives or loses its drive."""
    config = {
        "periods_per_action": 90,
        "change_per_action": 1.0,
        "air_supply_rates": (0.008, 0.036),
    }  # at once at an end
    env = gym.make("probe_env/IncrementalInsertion-v1", fidelity="surrogate", config=config)
    env.reset(seed=3, options=TUBE)
    total, ended = 0.0, False
    while not ended:
        _, reward, terminated, truncated, info = env.step(np.array([1.0, air], dtype=np.float32))
        total, ended = total + reward, terminated or truncated
    assert info["lost_drive"] == (air < 0.0)
    assert total == pytest.approx(info["episode_kpis"]["reward"] + 110.0, rel=1e-9)
    assert info["time"] % 90.0 != 0.0  # it ended within an action


def test_shaping_alone_leaves_actions_and_observations():
    envs = [gym.make("probe_env/Insertion-v1", fidelity="surrogate", config={"shaping_weight": w}) for w in (0.0, 2.0)]
    begun = [env.reset(seed=3, options=TUBE)[1]["inserted_length"] for env in envs]
    action = np.array([0.2, 0.1], dtype=np.float32)
    (plain, reward, *_), (same, shaped, *_, info) = (env.step(action) for env in envs)
    assert np.array_equal(plain, same)
    assert shaped == pytest.approx(reward + 2.0 * (info["inserted_length"] - begun[1]), rel=1e-9)


def test_agent_acts_in_evaluations_as_in_its_environment(tmp_path):
    """Bit for bit: the evaluation has a target for each control period, the environment an action for some."""
    train = ProbeVecEnv("probe_env/IncrementalInsertion-v1", 2, fidelity="surrogate")
    model = PPO("MlpPolicy", train, n_steps=16, batch_size=16, n_epochs=1, device="cpu", seed=0).learn(32)
    save_bundle(tmp_path / "a.safetensors", model, train.config)
    env = gym.make("probe_env/IncrementalInsertion-v1", fidelity="surrogate")
    single = gym.make("probe_env/Insertion-v1", fidelity="surrogate", config=AIR)
    task = single.unwrapped.config
    for agent in (from_sb3(model, train.config), load_bundle(tmp_path / "a.safetensors", task)):
        (observation, _), (row, _) = (each.reset(seed=3, options=TUBE) for each in (env, single))
        state = None
        for _ in range(40):
            action, _ = model.predict(observation, deterministic=True)
            observation, reward, *_, info = env.step(action)
            total = info["reward_terms"]["shaping"]
            for _ in range(PERIODS):
                target, state = agent.predict(row, state, deterministic=True)
                row, earned, *_ = single.step(target)
                total += earned
            assert total == pytest.approx(reward, rel=1e-12)


def test_models_with_other_weights_are_other_policies():
    train = ProbeVecEnv("probe_env/IncrementalInsertion-v1", 1, fidelity="surrogate")
    models = [PPO("MlpPolicy", train, device="cpu", seed=seed) for seed in (0, 1, 0)]
    first, second, again = (from_sb3(model, train.config).describe() for model in models)
    assert first != second
    assert first == again
