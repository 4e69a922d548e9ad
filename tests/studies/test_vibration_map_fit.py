"""Making vibration maps: of the noise in a flaw's band, and of a tube of your own."""

import numpy as np
import pandas as pd
import pytest

from probe_agents.cli import main
from probe_agents.policies.cases import map_file, read_case
from probe_agents.studies import vibration_map as maker
from probe_agents.studies.vibration_map import SEGMENT, SMEARED, fit_map
from probe_env import Plant, Scene
from probe_env.envs.vibration_map import VibrationMap, stored_map
from probe_env.schedule import Schedule

TUBES = 14


def wandered(heard_before):
    """Metres of wandering insertions whose noise is 0.1 mm times feed / (0.1 m/s), of the segment before at first.

    ``heard_before``: length [m] over which a segment hears the feed before it.
    """
    rng, segment, rows = np.random.default_rng(0), SEGMENT["snr"], []
    for tube in range(TUBES):
        feeds = 0.04 * 10.0 ** rng.uniform(size=11)
        context = {"friction": 0.1 + 0.005 * tube, "contact_stiffness": 1e5, "drag_factor": 1.0, "helix_diameter": 1.5}
        for length in np.arange(5.5, 60.0):
            k, into = int(length / segment), length % segment
            heard = feeds[k - 1] if k and into < heard_before else feeds[k]
            rows.append(
                {"inserted_length": length, "feed_speed": feeds[k], "air_supply_rate": 0.02, "context": tube,
                 "noise_rms_m": 1e-3 * heard, **context}
            )  # fmt: skip
    return pd.DataFrame(rows)


def error(smeared):
    """Mean absolute error [decades] of the map on the tubes that were left out."""
    return fit_map(wandered(smeared), scene=Scene(), measure="snr")[1]["mean_absolute_error_decades"]


def test_start_of_each_segment_is_not_fitted(monkeypatch):
    """Metres that hear another feed change nothing, not a digit; one metre more of them does."""
    monkeypatch.setattr(maker, "EPOCHS", 20)
    assert error(SMEARED["snr"]) == error(0.0)
    assert error(SMEARED["snr"] + 1.0) > error(0.0)


@pytest.mark.slow
def test_a_tube_of_your_own_has_its_map_and_schedules(tmp_path, monkeypatch):
    """Of a helix of 7 m, by 16 insertions of two metres: the map lies beside the file, and the search takes it."""
    monkeypatch.setitem(maker.SPLIT_SIZES, "train", maker.HELD_OUT + 4)  # type: ignore[misc]
    file = tmp_path / "small.toml"
    file.write_text("[tube]\nhelix_diameter = 0.8\nhelix_length = 7.0\ninner_diameter = 23e-3\n")
    assert maker.run(tmp_path / "map", trials=1, tube=file) == map_file(file)
    case, loaded = read_case(file, "test", 6), VibrationMap.load(map_file(file))
    assert case.vibration == loaded
    assert loaded.scene == Plant.from_toml(file).scene
    assert loaded.digest != stored_map().digest
    where = (np.array([6.0]), np.array([0.1]), np.array([0.02]), np.array([[0.15, 1e5, 1.0, 0.8]]))
    mean, deviation = loaded.predict(*where, loaded.scene)
    # a probe of 7 m hardly vibrates: micrometres, between the floor of 0.1 um and 0.1 mm
    assert -3.0 <= mean[0] <= 0.0
    assert 0.0 < deviation[0] < 1.0
    output = tmp_path / "schedules"
    assert main(["study", "best-schedules", "--tube", str(file), "--trials", "32", "--output", str(output)]) == 0
    assert 0.04 <= Schedule.read(output / "best-constant.csv").feed_speed[0] <= 0.4
