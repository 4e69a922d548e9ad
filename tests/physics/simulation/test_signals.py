"""Statistics of signals against values known in advance."""

import numpy as np
import pytest

from probe_env.physics.simulation.run import Run
from probe_env.physics.simulation.signals import common_frequency, dominant_frequencies, point_statistics

TIME = np.arange(8001) * 1e-3


def sine_run(frequency=14.0, amplitude=2e-4):
    zero = np.zeros((len(TIME), 1))
    wave = amplitude * np.sin(2 * np.pi * frequency * TIME)[:, None]
    return Run(TIME, wave + 1e-3, wave, zero, zero + 3.0, ("sensor",), np.zeros(1), np.zeros(1), np.zeros(1))


def test_a_sine_has_the_statistics_of_a_sine():
    values = point_statistics(sine_run(), "sensor", 0.0)
    assert values["axial_mean_m"] == pytest.approx(1e-3, rel=1e-3)
    assert values["radial_rms_m"] == pytest.approx(2e-4 / np.sqrt(2), rel=1e-3)
    velocity = 2e-4 * 2 * np.sin(np.pi * 14.0 * 1e-3) / 1e-3 / np.sqrt(2)
    assert values["radial_velocity_rms_m_per_s"] == pytest.approx(velocity, rel=1e-3)
    assert values["radial_max_m"] == pytest.approx(2e-4, rel=1e-3)
    assert values["radial_p99_m"] == pytest.approx(2e-4 * np.sin(np.pi * 0.49), rel=1e-3)
    # the second difference of a sine: amplitude (2 sin(omega T / 2) / T)^2
    factor = (2 * np.sin(np.pi * 14.0 * 1e-3) / 1e-3) ** 2
    assert values["radial_acceleration_rms_m_per_s2"] == pytest.approx(2e-4 * factor / np.sqrt(2), rel=1e-3)
    assert values["lift_off_share"] == pytest.approx(0.5, abs=0.01)
    assert values["axial_peak_hz"] == values["radial_peak_hz"] == values["common_peak_hz"] == 14.0
    assert values["tension_mean_n"] == 3.0
    with pytest.raises(ValueError, match=r"start = 7\.99 s leaves 11 samples"):
        point_statistics(sine_run(), "sensor", 7.99)


def test_frequencies_are_sorted_by_strength_and_none_at_rest():
    signal = 1e-3 * np.sin(2 * np.pi * 20 * TIME) + 3e-3 * np.sin(2 * np.pi * 35 * TIME)
    assert dominant_frequencies(signal, 1e-3, 2) == (35.0, 20.0)
    assert common_frequency(signal, np.sin(2 * np.pi * 20 * TIME), 1e-3) == 20.0
    assert dominant_frequencies(np.full(1000, 0.015), 1e-3) == ()
    assert np.isnan(common_frequency(np.zeros(1000), np.zeros(1000), 1e-3))
