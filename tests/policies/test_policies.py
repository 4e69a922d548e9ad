"""Fixed policies: SB3's protocol, and each does what its name says."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from probe_agents.policies.catalogue import NAMES, REPLACED, make_policy, name_and_spec, named_policies, user_policies
from probe_agents.policies.fixed import PI, Constant, OnOff, SlowDown
from probe_agents.training.config import Training
from probe_env.envs.task.config import TaskConfig

CONFIG = TaskConfig(privileged=True)


def observation(length=20.0, rms=1e-5):
    values = {
        "inserted_length": length / 60.0, "rf_noise": np.log10(rms / 1e-4), "helix_diameter": 1.2 / 2.5,
        "root_tension": 4.0 / 20.0, "feed_speed": 0.5, "air_supply_rate": 63.0 / 130.0, "friction": 0.6,
        "contact_stiffness": 1.0, "drag_factor": 1.0,
    }  # fmt: skip
    return np.array([values.get(name, 0.0) for name in CONFIG.observations], dtype=np.float32)


def feed_of(action):
    return CONFIG.targets(np.atleast_2d(action))[0, 0]


def feeds_of(policy, *noises):
    """Feeds of one run that sees this noise [m] after another."""
    feeds, state = [], None
    for rms in noises:
        action, state = policy.predict(observation(rms=rms)[None], state)
        feeds.append(feed_of(action))
    return feeds


ROOT = Path(__file__).parents[2]
OBSERVING = [name for name in NAMES if not name.startswith("planner")]


@pytest.mark.parametrize("name", [*OBSERVING, "example", f"{ROOT}/configs/schedules/shift.toml"])
def test_predict_follows_sb3_s_protocol(name):
    policy = make_policy(name, CONFIG)
    one, _ = policy.predict(observation(), deterministic=True)
    assert (one.shape, one.dtype) == ((2,), np.float32)
    rows = np.array([observation(), observation(50.0, 2e-4)])
    many, states = policy.predict(rows)
    assert many.shape == (2, 2)
    assert (many[0] == one).all()
    assert (np.abs(many) <= 1.0).all()
    second, _ = policy.predict(rows, states, np.array([False, True]))
    fresh, _ = policy.predict(rows[1])
    assert (second[1] == fresh).all()  # a new episode starts without memory
    assert policy.describe() == make_policy(name, CONFIG).describe()


def test_policies_name_what_their_task_does_not_show():
    for name, config, message in (
        ("privileged", TaskConfig(), r"Privileged needs a task that shows the tube \(privileged = true\)"),
        ("adaptive", TaskConfig(observe_root_tension=False), "Adaptive needs a task that shows the root tension"),
        ("plc-proportional", TaskConfig(observe_root_tension=False), "PlcProportional needs a task that shows the"),
    ):
        with pytest.raises(ValueError, match=message):
            make_policy(name, config)


def test_agents_and_schedules_that_ship_go_by_name():
    by_name = named_policies(["ppo", "ppo@2", "mine@3=student@3", "example"], CONFIG)
    assert list(by_name) == ["ppo", "ppo@2", "mine@3", "example"]
    files = [f"results/agents/{place}/agent.safetensors" for place in ("ppo/seed-0", "ppo/seed-2", "student/seed-3")]
    by_path = [make_policy(f"{ROOT}/{file}", CONFIG) for file in (*files, "configs/schedules/example.csv")]
    assert [policy.describe() for policy in by_name.values()] == [policy.describe() for policy in by_path]
    assert name_and_spec("a=b=ppo@1") == ("a=b", "ppo@1")
    with pytest.raises(ValueError, match=r"policy = 'ppo@9': the training seeds of ppo are 0, 1, 2, 3, 4"):
        make_policy("ppo@9", CONFIG)
    with pytest.raises(ValueError, match=r"unknown policy 'pppo'. Did you mean ppo\? `probe-env agents` lists all"):
        make_policy("pppo", CONFIG)
    for removed, successor in REPLACED.items():
        with pytest.raises(ValueError, match=f"unknown policy '{removed}@1'. It was removed: use {successor}. `probe"):
            make_policy(f"{removed}@1", CONFIG)


def test_fixed_laws_do_what_they_are_called():
    """The study's constant; slow down by length; on and off with hysteresis; PI that does not wind up."""
    action, _ = Constant(CONFIG).predict(observation())
    assert CONFIG.targets(action[None])[0] == pytest.approx([0.2, 63.0 / 3600.0])
    policy = SlowDown(CONFIG, fast=0.4, slow=0.1, begin=10.0, end=40.0)
    speeds = [feed_of(policy.predict(observation(length))[0]) for length in (5.0, 10.0, 25.0, 40.0, 60.0)]
    assert speeds == pytest.approx([0.4, 0.4, 0.25, 0.1, 0.1], rel=1e-5)
    feeds = feeds_of(OnOff(CONFIG, fast=0.3, slow=0.1, level=1e-4), 1e-5, 2e-4, 0.8e-4, 0.4e-4, 0.8e-4)
    assert feeds == pytest.approx([0.3, 0.1, 0.1, 0.3, 0.3], rel=1e-5)
    feeds = feeds_of(PI(CONFIG), *[1e-3] * 200, *[1e-6] * 60)
    assert (np.diff(feeds[:200]) <= 1e-6).all()
    assert feeds[199] == pytest.approx(0.02, rel=1e-4)
    assert feeds[-1] > 0.2


def test_schedule_beyond_the_device_warns(tmp_path):
    path = tmp_path / "fast.csv"
    path.write_text("inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n5,1.5,63\n60,0.1,63\n")
    with pytest.warns(UserWarning, match=r"fast.csv: feed speed of 0.1 to 1.5 m/s is outside .* 0.02 to 0.4 m/s"):
        policy = make_policy(str(path), CONFIG)
    assert feed_of(policy.predict(observation(5.0))[0]) == pytest.approx(0.4)

    with pytest.raises(ValueError, match=r"observation of shape \(1, 5\) is not \(N, 14\)"):
        policy.predict(np.zeros(5, dtype=np.float32))


MODULE = """
from probe_agents.policies.fixed import Constant

class Mine(Constant):
    def __init__(self, config):
        super().__init__(config, feed_speed=0.1)

class Picky(Mine):
    def __init__(self, config):
        raise TypeError("two\\nlines")

class Mute:
    def predict(self):
        pass

mine = 1
"""


def test_a_class_of_the_user_is_a_policy_where_it_is_asked_for(tmp_path, monkeypatch):
    """By module and name, in one pass and in both; a spec from a file may not import code."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "own_policies_here.py").write_text(MODULE)
    (tmp_path / "broken_here.py").write_text("import nowhere_at_all")
    spec = "own_policies_here:Mine"
    specs = [spec, f"slow={spec}", f"shielded:{spec}", "pi"]
    policies = named_policies(specs, CONFIG, classes=True)
    assert list(policies) == ["Mine", "slow", "shielded-Mine", "pi"]
    assert user_policies(specs) == ["Mine", "slow", "shielded-Mine"]
    assert feed_of(policies["Mine"].predict(observation())[0]) == pytest.approx(0.1)
    both = make_policy(spec, TaskConfig(passes="both").full_observation, classes=True)
    assert both.insertion.describe() == policies["Mine"].describe()
    for given, message in (
        ("nowhere_at_all:Mine", "cannot be imported (ModuleNotFoundError: No module named 'nowhere_at_all'): install"),
        ("broken_here:Mine", "cannot be imported (ModuleNotFoundError"),
        ("own_policies_here:Other", "own_policies_here has no class Other"),
        ("own_policies_here:mine", "own_policies_here has no class mine"),
        ("own_policies_here:Mute", "the class has no method describe"),
        ("own_policies_here:Picky", "cannot be created for the task (TypeError: two; lines)"),
    ):
        with pytest.raises(ValueError, match=rf"^policy = '{given}'.*{re.escape(message)}"):
            make_policy(given, CONFIG, classes=True)
    sys.modules.pop("own_policies_here")
    with pytest.raises(ValueError, match="specs from a file must not do"):
        make_policy(spec, CONFIG)
    with pytest.raises(ValueError, match=r"imitation\.teacher: policy = 'own_.*:Mine': a class imports code"):
        Training.model_validate({"imitation": {"teacher": spec}})
    assert "own_policies_here" not in sys.modules
