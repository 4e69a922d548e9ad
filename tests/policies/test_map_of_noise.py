"""A map of the noise in the band of a flaw: kept with its measure, and asked for nothing else."""

import numpy as np
import pandas as pd
import pytest

from agents.evaluation.plan import per_metre
from agents.policies.lookup import expected_costs
from agents.policies.places import plant_at
from agents.records.reading import FileError
from agents.studies.builtin import Request
from agents.studies.shipped.best_schedules import run_search
from probe_env import Context, Scene
from probe_env.envs.task import TaskConfig
from probe_env.envs.vibration_map import (
    CONTEXT,
    SHIPPED_RANGES,
    VibrationMap,
    expected_cost,
    rms_limit,
    stored_map,
)

CONFIG = TaskConfig(vibration_measure="snr")


def noise_map(mean, measure="snr"):
    """A map that says the same everywhere."""
    layers = [(np.zeros((7, 2)), np.zeros(2)), (np.zeros((2, 2)), np.zeros(2))]
    layers.append((np.zeros((2, 2)), np.array([mean, -5.0])))
    return VibrationMap(tuple(layers), Scene(), SHIPPED_RANGES, np.array([np.zeros(7), np.ones(7)]), "", measure)


def test_the_limit_in_metres_costs_what_the_limit_in_signal_to_noise_does():
    """At S/N 3 a metre costs the weight of vibration: in the units of the map 0.109 mm, electronics included."""
    assert rms_limit(CONFIG) == pytest.approx(1.09e-4, rel=5e-3)
    assert rms_limit(TaskConfig()) == 1e-4
    still = CONFIG.model_copy(update={"time_weight": 0.0, "air_weight": 0.0, "vibration_weight": 3.0})
    feed = air = np.array([0.1])
    mean = np.log10([rms_limit(CONFIG) / 1e-4])
    assert expected_cost(mean, np.array([1e-6]), feed, air, still) == pytest.approx([3.0], rel=1e-4)
    half = mean - np.log10(2.0)  # S/N 6
    assert expected_cost(half, np.array([1e-6]), feed, air, still) == pytest.approx([0.75], rel=1e-4)


def test_a_map_keeps_its_measure(tmp_path):
    path = tmp_path / "mine-map.npz"
    noise_map(-0.3).save(path)
    assert VibrationMap.load(path).measure == "snr"
    noise_map(-0.3, "displacement").save(path)
    assert VibrationMap.load(path).measure == "displacement"
    noise_map(-0.3, "loudness").save(path)
    with pytest.raises(FileError, match="measure = 'loudness' is not one of displacement, snr"):
        VibrationMap.load(path)


def test_a_map_of_millimetres_is_not_asked_for_noise(tmp_path):
    tube = np.array([[getattr(Context(), name) for name in CONTEXT]])
    with pytest.raises(ValueError, match="but the map is of displacement: make one of these"):
        expected_costs(tube, CONFIG, vibration=stored_map())
    assert np.isfinite(expected_costs(tube, CONFIG, vibration=noise_map(-0.3))).all()
    with pytest.raises(ValueError, match="but the map is of displacement"):
        run_search("best-constant", 16, Request(tmp_path), stored_map(), plant_at("snr"))
    with pytest.raises(ValueError, match="vibration_measure = 'velocity': maps know displacement and snr only"):
        expected_costs(tube, TaskConfig(vibration_measure="velocity"), vibration=stored_map())


def test_a_metre_has_its_noise():
    periods = [(t, length, 0.2, 0.02, 1e-4, 4.0, noise) for t, length, noise in ((1, 5.4, 3e-4), (2, 5.8, 4e-4))]
    assert pd.DataFrame(per_metre(periods))["noise_rms_m"].tolist() == pytest.approx([np.sqrt(12.5) * 1e-4])
