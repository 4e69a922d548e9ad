"""The table [sensor]: refused by name, and one for tasks and plants."""

import re

import pytest

from probe_env import Plant, TaskConfig
from probe_env.inspection.sensor import Sensor


def test_what_is_out_of_range_is_named(tmp_path):
    path = tmp_path / "tube.toml"
    for text, message in (
        ("flaw_width = 0.0", "sensor.flaw_width: 0.0 m is outside the accepted range 0.001 to 0.5 m"),
        ("shaken_snr = 8.0", "shaken_snr = 8.0 must be below quiet_snr = 7.5"),
        ("gain = 3.0", "sensor.gain: there is no such field; accepted: flaw_width, groove_signal"),
    ):
        path.write_text(f"[sensor]\n{text}\n")
        with pytest.raises(ValueError, match=re.escape(str(path)) + ": .*" + re.escape(message)):
            Plant.from_toml(path)


def test_a_plant_carries_its_sensor_to_the_task():
    plant = Plant(sensor={"quiet_snr": 6.0, "flaw_width": 0.03})
    assert plant.configured().sensor == Sensor(quiet_snr=6.0, flaw_width=0.03)
    assert plant.configured(changes={"sensor": Sensor()}).sensor == Sensor()
    assert Plant().configured().sensor == TaskConfig().sensor == Sensor()
    with pytest.raises(ValueError, match=r"task.sensor: stands in \[sensor\]"):
        Plant(task={"sensor": {}})


def test_gains_follow_the_anchors_unless_one_was_measured():
    assert Sensor(groove_signal=3.0).gain == pytest.approx(3.0 * Sensor().gain)
    assert Sensor(motion_gain=1e3, shaken_snr=9.0).gain == 1e3  # then the second anchor is not asked
    assert Sensor(quiet_snr=15.0).noise_density == pytest.approx(0.25 * Sensor().noise_density)
    assert Sensor(quiet_snr=15.0, shaken_snr=6.0).gain == pytest.approx(0.5 * Sensor().gain)
