"""A teacher that looks things up does so in the map of the plant, not in table 2's."""

from pathlib import Path

import pytest

from agents.learning.config import Training
from agents.policies.places import own_map, place_at, plant_at

SNR = Path("snr")


def test_a_shipped_tube_finds_its_map_by_name_and_by_path() -> None:
    assert place_at(SNR, "test", 6).vibration.measure == "snr"
    assert own_map(SNR) == own_map(Path(__file__).parents[2] / "configs" / "tubes" / "snr.toml")
    assert own_map(Path("example")) is None


def test_a_teacher_in_another_measure_needs_the_map_of_it() -> None:
    plant = plant_at(SNR)
    imitation = {"teacher": "tension-scheduled"}
    with pytest.raises(ValueError, match="the map is of displacement"):
        Training.model_validate({"environment": {"tube": plant}, "imitation": imitation})
    environment = {"tube": plant, "map_beside": "snr"}
    training = Training.model_validate({"environment": environment, "imitation": imitation})
    assert training.teacher is not None
    assert training.teacher.describe()["policy"]
    assert training.task.vibration_measure == "snr"


def test_what_is_run_is_noted_and_read_again() -> None:
    environment = {"tube": plant_at(SNR), "map_beside": "snr"}
    training = Training.model_validate({"environment": environment, "imitation": {"teacher": "tension-scheduled"}})
    assert Training.model_validate_json(training.model_dump_json()) == training
