"""Spectra of a vibration in numbers that can be stored: its densities, and how much of it is in its highest peak."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.signal import welch

from probe_env.arrays import FloatArray
from probe_env.physics.simulation.signals import LOWEST_FREQUENCY

HIGHEST_FREQUENCY: Final = 100.0  # [Hz]
SHOWN: Final = tuple(range(2, 61))  # [Hz]
WINDOW, REACH = 2.0, 1.0
"""Length of a Hann window [s]; the band on either side of a peak [Hz] is the width of the window's main lobe."""


def highest_peak(signal: FloatArray, sample_period: float) -> tuple[float, float]:
    """Frequency [Hz] and amplitude of what stands out most between 2 and 100 Hz in a signal (k,) of any unit.

    The amplitude is that of a sine with the power within 1 Hz of the highest value of the Welch spectrum (Hann windows
    of 2 s, half overlapping): A = sqrt(2 P). A spectrum without a peak has a highest value too.
    """
    frequency, density = _welch(signal, sample_period, WINDOW)
    chosen = (frequency >= LOWEST_FREQUENCY) & (frequency <= HIGHEST_FREQUENCY)
    place = float(frequency[chosen][np.argmax(density[chosen])])
    near = np.abs(frequency - place) <= REACH + 1e-9
    return place, float(np.sqrt(2.0 * density[near].sum() * frequency[1]))


def densities(signal: FloatArray, sample_period: float) -> FloatArray:
    """Amplitude spectral density at the frequencies ``SHOWN``, in the signal's unit per sqrt(Hz)."""
    frequency, density = _welch(signal, sample_period, WINDOW / 2.0)
    shown: FloatArray = np.interp(SHOWN, frequency, np.sqrt(density))
    return shown


def _welch(signal: FloatArray, sample_period: float, window: float) -> tuple[FloatArray, FloatArray]:
    segment = min(len(signal), round(window / sample_period))
    frequency, density = welch(signal, 1.0 / sample_period, nperseg=segment)
    return frequency, density
