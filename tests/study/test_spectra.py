"""A spectrum's numbers on signals whose spectra are known."""

import numpy as np
import pytest
from scipy.signal import get_window

from agents.study.spectra import SHOWN, densities, highest_peak

PERIOD = 1e-3
TIME = PERIOD * np.arange(6001)


@pytest.mark.parametrize("hertz", [3.0, 14.0, 14.2, 55.25])
@pytest.mark.parametrize("amplitude", [1.0, 1e-7])
def test_a_sine_s_amplitude_is_found(hertz, amplitude):
    """Within 1 Hz of the highest bin a Hann window of 2 s has all but 0.4 % of a sine's power: that share is found."""
    place, height = highest_peak(amplitude * np.sin(2.0 * np.pi * hertz * TIME + 0.3), PERIOD)
    assert abs(place - hertz) <= 0.25
    window = get_window("hann", 2000)
    offset = hertz - place
    bins = np.arange(-2, 3) * 0.5
    lines = [abs(window @ np.exp(2j * np.pi * (offset - b) * PERIOD * np.arange(2000))) ** 2 for b in bins]
    share = sum(lines) / (2000 * (window**2).sum())
    assert share > 0.99
    assert height == pytest.approx(amplitude * np.sqrt(share), rel=1e-3)  # its mirror at -f is left


def test_of_two_sines_the_greater_and_only_it():
    signal = 1e-3 * np.sin(2.0 * np.pi * 9.0 * TIME) + 3e-3 * np.sin(2.0 * np.pi * 20.0 * TIME)
    place, height = highest_peak(signal + 5.0 * TIME, PERIOD)  # a drift is no peak: each window's mean is taken off
    assert place in (2.0, 20.0)
    place, height = highest_peak(signal, PERIOD)
    assert place == 20.0
    assert height == pytest.approx(3e-3, rel=1e-3)


def test_densities_of_white_noise():
    """One-sided density of noise of variance 1 at 1 kHz: sqrt(2 / 1000); the mean over 59 bins of 11 windows is it.

    A bin's power scatters as 2 x 6 degrees of freedom at most (windows overlap by half), the mean of 59 bins, of which
    every other one is independent, by less than sqrt(2 / (12 x 29)) = 8 %.
    """
    values = densities(np.random.default_rng(5).normal(size=6001), PERIOD)
    assert values.shape == (len(SHOWN),)
    assert np.mean(values**2) == pytest.approx(2e-3, rel=4.0 * 0.08)


def test_a_short_signal_has_numbers():
    place, height = highest_peak(np.sin(2.0 * np.pi * 20.0 * TIME[:500]), PERIOD)
    assert place == pytest.approx(20.0, abs=2.0)
    assert 0.0 < height < 2.0
