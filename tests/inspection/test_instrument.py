"""The tables [sensor] and [instrument] of a plant: permitted speeds worked by hand, and filters behind the formulas."""

import math
import re

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import butter, freqs

from probe_env import Plant, TaskConfig
from probe_env.inspection.instrument import CARRIER_FRACTION, FLAW_BAND, Instrument
from probe_env.inspection.sensor import ENERGY, Sensor, power


def test_each_requirement_gives_its_speed_and_the_lowest_holds():
    """Flaws of 20 mm, 400 samples/s at 2 per mm: 0.2 m/s. 30 Hz x 20 mm / 2 = 0.3 m/s. 88 Hz / 4 = 22 Hz: 0.22 m/s."""
    fields = {"sample_rate": 400.0, "samples_per_mm": 2.0, "bandwidth": 30.0, "test_frequency": 88.0}
    instrument = Instrument(**fields, highest_speed=0.25)
    speeds = {"sample_rate": 0.2, "bandwidth": 0.3, "test_frequency": 0.22, "highest_speed": 0.25}
    assert instrument.speeds(0.02) == pytest.approx(speeds)
    assert instrument.permitted(0.02) == (pytest.approx(0.2), "sample_rate")
    assert instrument.permitted(0.01) == (pytest.approx(0.11), "test_frequency")  # of flaws half as long
    assert instrument.model_copy(update={"highest_speed": 0.05}).permitted(0.02) == (0.05, "highest_speed")
    assert Instrument().permitted(0.02) == (math.inf, "")


def test_a_filter_at_the_end_of_the_band_keeps_the_flaw():
    """95 % of its energy; of its amplitude 87, 90 and 98 % behind Butterworth filters of order 1, 2 and 4."""
    assert quad(power, 0.0, FLAW_BAND)[0] == pytest.approx(0.5 * 0.954 * ENERGY, rel=1e-3)
    v, x = np.linspace(0.0, 12.0, 6001), np.linspace(-0.6, 1.2, 901)
    waves = np.exp(2j * np.pi * v * x[:, None]) * np.sqrt(power(v))
    peaks = [np.abs((waves * freqs(*butter(order, FLAW_BAND, analog=True), v)[1]).sum(axis=1).imag).max()
             for order in (1, 2, 4)]  # fmt: skip
    assert peaks / np.abs(waves.sum(axis=1).imag).max() == pytest.approx([0.866, 0.896, 0.976], abs=2e-3)
    # demodulation of the sidebands f +- B leaves an image at 2 f - B, seven times the bandwidth: 2 % of it
    image = 2.0 / CARRIER_FRACTION - 1.0
    assert abs(freqs(*butter(2, 1.0, analog=True), [image])[1][0]) == pytest.approx(1.0 / 49.0, rel=1e-3)


def test_the_permitted_feed_is_a_step_of_the_device():
    """23 Hz x 20 mm / 2 = 0.23 m/s; 15 Hz: 0.15 m/s, which is three whole steps of 0.05 m/s."""

    def permitted(bandwidth, **changes):
        return TaskConfig(instrument=Instrument(bandwidth=bandwidth), **changes).permitted_feed

    assert permitted(23.0) == pytest.approx(0.23)
    assert permitted(23.0, feed_speed_step=0.05) == pytest.approx(0.2)
    assert permitted(15.0, feed_speed_step=0.05) == pytest.approx(0.15)
    assert permitted(50.0) == TaskConfig().permitted_feed == 0.4  # the device's
    longer = TaskConfig(instrument=Instrument(bandwidth=23.0), sensor={"flaw_width": 0.03})
    assert longer.permitted_feed == pytest.approx(0.345)


def test_errors_name_field_value_and_cause(tmp_path):
    path = tmp_path / "tube.toml"
    for text, message in (
        ("sensor.flaw_width = 0.0", "sensor.flaw_width: 0.0 m is outside the accepted range 0.001 to 0.5 m"),
        ("sensor.shaken_snr = 8.0", "shaken_snr = 8.0 must be below quiet_snr = 7.5"),
        ("sensor.gain = 3.0", "sensor.gain: there is no such field; accepted: flaw_width, groove_signal"),
        ("instrument.bandwidth = 0.0", "instrument.bandwidth: 0.0 Hz is outside the accepted range 0.1 to 1e+06 Hz"),
        ("instrument.sample_rate = 1e3", "sample_rate and samples_per_mm go together: samples_per_mm is missing"),
        (
            "instrument.band = 3.0",
            "instrument.band: there is no such field; accepted: sample_rate, samples_per_mm, ban",
        ),
        ("instrument.bandwidth = 1.0", "instrument.bandwidth permits at most 0.01 m/s, and feed_speeds begin at 0.02"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=re.escape(str(path)) + ": .*" + re.escape(message)):
            Plant.from_toml(path)


@pytest.mark.parametrize(
    ("name", "own", "usual"),
    [("sensor", Sensor(quiet_snr=6.0, flaw_width=0.03), Sensor()), ("instrument", Instrument(bandwidth=20.0), None)],
)
def test_a_plant_carries_its_tables_to_the_task(name, own, usual):
    plant = Plant(**{name: own.model_dump(exclude_unset=True)})
    assert getattr(plant.config, name) == own
    assert getattr(plant.configured(changes={name: usual}), name) == usual
    assert getattr(Plant().config, name) == getattr(TaskConfig(), name) == usual
    assert Plant.model_validate(plant.model_dump()).config == plant.config
    assert TaskConfig.model_validate_json(plant.config.model_dump_json()) == plant.config
    with pytest.raises(ValueError, match=rf"task.{name}: belongs in \[{name}\]"):
        Plant(task={name: {}})
