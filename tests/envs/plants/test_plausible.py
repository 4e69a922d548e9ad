"""What a plant's file cannot mean is refused before any work, with file, field, value and what is possible."""

import gymnasium as gym
import pytest

import probe_env
from agents.vec_env import ProbeVecEnv
from probe_env.envs.plants import Plant
from probe_env.files import FileError


@pytest.mark.parametrize(
    ("table", "text", "message"),
    [
        (
            "feed",
            "feed_speed_step = 0.5",
            "feed.feed_speed_step = 0.5 m/s: no whole step lies within feed_speeds, 0.02 to",
        ),
        ("feed", "feed_speeds = [0.11, 0.19]\nfeed_speed_step = 0.1", "no whole step lies within feed_speeds, 0.11 to"),
        (
            "air",
            "air_supply_step = 0.05",
            "air.air_supply_step = 0.05 m3/s: no whole step lies within air",
        ),
        ("tube", "helix_diameter = 1400", "helix_diameter = 1400.0 m is outside the accepted range 0.3 to 50 m"),
        (
            "task",
            "vibration_limit = 0.1",
            "task.vibration_limit = 0.1 m is more than the 0.0052 m that the floats",
        ),
        ("contact", "friction = { mean = 0.15, std = 0.5 }", "contact.friction.std = 0.5 is more than the mean, 0.15"),
        (
            "contact",
            "stiffness = { mean = 1e5, std = 2e5 }",
            "contact.stiffness.std = 200000 is more than the mean, 100000",
        ),
    ],
)
def test_it_is_refused_by_file_and_field(table, text, message, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(f"[{table}]\n{text}\n")
    with pytest.raises(FileError, match=r"mine\.toml") as caught:
        Plant.from_toml(path)
    assert message in str(caught.value)


def test_what_can_be_meant_is_taken():
    Plant(feed={"feed_speed_step": 0.4}, air={"air_supply_step": 130.0 / 3600.0})  # one step, the range's end
    Plant(task={"vibration_measure": "acceleration", "vibration_limit": 20.0})
    Plant(contact={"friction": {"mean": 0.15, "std": 0.15}})


@pytest.mark.parametrize("make", [lambda **given: gym.make("probe_env/Insertion-v1", **given), ProbeVecEnv])
def test_shipped_lists_are_no_tubes_of_a_plant(make):
    with pytest.raises(ValueError, match="contexts = 'test' are table 2's tubes: beside a tube leave it out"):
        make(tube={"tube": {"inner_diameter": 0.023}}, contexts="test")


def test_a_field_of_the_task_is_named_as_one():
    with pytest.raises(TypeError, match=r"inspects is a field of the task: give config=\{'inspects': ...\}"):
        gym.make("probe_env/Inspection-v0", inspects="back")
    env = gym.make("probe_env/Inspection-v0", config={"inspects": "back"}, scene=probe_env.Scene(), fidelity="fast")
    assert env.unwrapped.config.inspects == "back"
