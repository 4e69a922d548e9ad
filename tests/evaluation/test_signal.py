"""The channels of a run: what is put in comes out, and what is asked for wrongly is named."""

import json

import numpy as np
import pandas as pd
import pytest

from probe_agents.cli import main
from probe_agents.evaluation.signal import FILTER_SAMPLES, Insertion, by_period, centred_spectra, correlation
from probe_env.inspection.channels import (
    SMOOTHING,
    Flaw,
    Recording,
    along_flaw,
    calls,
    channels,
    filtered,
    support_positions,
)
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.snr import FREQUENCY

NONE = np.zeros(0)


def recorded(feed, seconds=100, motion=np.zeros_like):
    """At constant feed, with a motion [m] by the time."""
    time = np.arange(1, 1000 * seconds + 1) * 1e-3
    silent = np.zeros((seconds, len(FREQUENCY)))
    return Recording(time, 2.5 + feed * time, np.full(len(time), feed), motion(time), silent, 1000)


def sine(time):
    return np.sin(2 * np.pi * 14.0 * time)


def voltages_of(sensor, recording, flaws=(), supports=NONE, seed=0):
    return channels(sensor, recording, 0.0242, flaws, supports, np.random.default_rng(seed))


@pytest.mark.parametrize("feed", [0.08, 0.2, 0.4])
def test_filtered_flaw_has_the_height_of_the_formula(feed):
    """Mean of n flaws: within 4 deviations of 1 / sqrt(n) (a chance of 6e-5), and 0.5 % for the bends of a peak."""
    sensor, recording = Sensor(), recorded(feed)
    flaws = [Flaw(place, 0.2) for place in np.arange(3.0, recording.position[-1] - 0.2, 0.2)]
    values = filtered(sensor, recording, along_flaw(sensor, voltages_of(sensor, recording, flaws)))
    shown = np.interp([flaw.position for flaw in flaws], recording.position, values)
    snr = 7.5 * np.sqrt(0.2 / feed)
    assert shown.mean() == pytest.approx(snr, abs=4.0 / np.sqrt(len(flaws)) + 5e-3 * snr)
    empty = filtered(sensor, recording, along_flaw(sensor, voltages_of(sensor, recording, seed=1)))
    free = 1.2 * feed / sensor.flaw_width * 100.0  # independent samples, u/w per second: scatter 1/sqrt(2n)
    assert empty.std() == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * free))


def test_motion_is_opposite_and_unequal_in_both_channels():
    sensor = Sensor(square_gain=0.0, quiet_snr=1000.0, motion_gain=2900.0)
    x, y = voltages_of(sensor, recorded(0.2, 2, lambda time: 1e-4 * sine(time))).T
    assert np.polyfit(x, y, 1)[0] == pytest.approx(-np.tan(sensor.angle), rel=0.02)
    assert np.ptp(x) == pytest.approx(2 * 2900.0 * 1e-4 * np.cos(sensor.angle), rel=0.1)


def test_squared_motion_is_equal_in_both_channels():
    """The same noise with and without it: what differs is k2 (y/R)^2 without its mean, to rounding."""
    moved = recorded(0.2, 2, lambda time: 2e-3 * sine(time))
    both = [voltages_of(Sensor(square_gain=gain), moved) for gain in (35.5, 0.0)]
    motion = 2e-3 * sine(moved.time)
    square = ((motion - motion.mean()) / (0.5 * 0.0242)) ** 2
    wanted = 35.5 * (square - square.mean())
    assert np.ptp(wanted) > 0.9
    assert both[0] - both[1] == pytest.approx(np.column_stack([wanted, wanted]), abs=1e-11)


def test_supports_are_where_they_were_put():
    sensor, recording = Sensor(quiet_snr=1000.0), recorded(0.2, 20)
    supports = support_positions(0.8, recording.position[-1])
    assert supports[0] == 0.4
    x, y = voltages_of(sensor, recording, supports=supports).T
    inside = supports[(supports > 2.6) & (supports < 6.3)]
    loud = recording.position[np.abs(x) > 0.5 * sensor.support_signal]
    assert (np.abs(loud[:, None] - inside).min(axis=1) < sensor.support_width).all()
    assert len({int(np.abs(place - inside).argmin()) for place in loud}) == len(inside)
    assert np.abs(x - y).max() < 0.05 * sensor.support_signal


def test_measured_noise_follows_the_vibration():
    """A tone of 14 Hz, louder every second: X has it times k1 cos(angle), less what means over 10 ms take, 3.2 %."""
    sensor, amplitude = Sensor(square_gain=0.0, quiet_snr=1000.0, motion_gain=2900.0), 1e-5 * np.arange(1, 21)
    recording = recorded(0.2, 20, lambda time: np.repeat(amplitude, 1000) * sine(time))
    periods = tuple({"radial_rms_m": value / np.sqrt(2.0), "snr": 7.5} for value in amplitude)
    table = by_period(Insertion(recording, periods, {}), voltages_of(sensor, recording))
    assert table["place_m"].tolist() == pytest.approx((2.5 + 0.2 * np.arange(1, 21)).tolist())
    wanted = np.sinc(14.0 * SMOOTHING) * 2900.0 * amplitude / np.sqrt(2.0)
    loud = slice(9, None)  # there electronics, 1 % of a groove's signal a second, add less than 1 %
    for name, part in (("x_deviation_v", np.cos(0.6)), ("y_deviation_v", np.sin(0.6))):
        assert table[name][loud].tolist() == pytest.approx(wanted[loud] * part, rel=0.02)
    assert correlation(table) == 1.0
    assert np.isnan(correlation(table.assign(radial_rms_m=1e-5)))


def test_one_call_a_flaw():
    place = np.linspace(0.0, 1.0, 1001)
    values = 6.0 * np.exp(-(((place - 0.3) / 0.01) ** 2)) + 5.0 * np.exp(-(((place - 0.309) / 0.002) ** 2))
    values += 7.0 * np.exp(-(((place - 0.8) / 0.01) ** 2))
    assert calls(values, place, 4.5, 0.02) == pytest.approx([0.309, 0.8], abs=0.011)
    assert len(calls(values, place, 20.0, 0.02)) == 0


def test_the_command_writes_what_the_rig_would(tmp_path, capsys):
    output = tmp_path / "signal"
    asked = ["signal", "constant", "--until", "7", "--flaws", "3:80", "4:80", "4.2:2", "30:80", "--output", str(output)]
    assert main(asked) == 0
    table = pd.read_csv(output / "channels.csv")
    assert list(table.columns) == ["time_s", "place_m", "feed_speed_m_per_s", "x_v", "y_v"]
    assert np.diff(table["time_s"]) == pytest.approx(1e-3, abs=1e-6)
    assert table["place_m"].iloc[-1] == pytest.approx(4.5, abs=0.01)  # the sensor follows 2.5 m behind the tip
    flaws = pd.read_csv(output / "flaws.csv")
    assert flaws["place_m"].tolist() == [3.0, 4.0, 4.2]
    assert flaws["called"].tolist() == [True, True, False]  # 30 deviations, and less than one
    record = json.loads((output / "signal.json").read_text())
    assert len(pd.read_csv(output / "periods.csv")) == 10  # of a second, 0.2 m each
    assert record["found"]["length_with_snr_over_3_m"] == pytest.approx(2.0, abs=0.01)
    assert record["found"]["a50_percent_wall"] == pytest.approx(20.0 * record["threshold"] / 7.5, rel=0.02)
    assert {path.name for path in output.iterdir()} >= {"strip.png", "flaws.png"}
    said = capsys.readouterr().out
    assert "detected: 2 of the 3 flaws that the sensor reached" in said
    assert "not passed: the flaw at 30 m; the sensor moved from 2.50 to 4.5" in said


def test_filter_uses_the_noise_of_its_own_segment():
    """Silence but for a quarter of a second of 14 Hz: the second with the burst in its middle is that of its stretch.

    Seconds that end before the burst tell nothing of it; one that has it in its middle tells the most that any can.
    """
    motion, feed = np.zeros(6000), np.full(6000, 0.2)
    motion[3000:3250] = 1e-4 * np.sin(2 * np.pi * 14.0 * 1e-3 * np.arange(250))
    power = centred_spectra(Sensor(), motion, feed).sum(axis=1)
    assert len(power) == 24
    assert (power[:10] == 0.0).all()  # the last of these is of the second to 2.875 s
    assert power[12] > 0.5 * power.max()
    assert (np.diff(power[9:13]) > 0.0).all()

    for samples in (100, 125, 250, 1001):
        motion = 1e-4 * np.random.default_rng(0).normal(size=samples)
        assert len(centred_spectra(Sensor(), motion, np.full(samples, 0.2))) == -(-samples // FILTER_SAMPLES)
