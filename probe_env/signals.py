"""Statistics of sampled signals: one definition for reports, environments and tests."""

from __future__ import annotations

import numpy as np
from scipy.signal import csd, find_peaks, welch

from probe_env.chain import FloatArray
from probe_env.run import Run

LOWEST_FREQUENCY = 2.0  # [Hz]; slower is drift of the mean, not ringing
QUIET = 1e-9  # [m]; below a nanometre a spectrum shows rounding, not motion


def rms(signal: FloatArray) -> float:
    """Standard deviation about the window's own mean."""
    return float(np.std(signal))


def dominant_frequencies(signal: FloatArray, sample_period: float, count: int = 3) -> tuple[float, ...]:
    """Frequencies [Hz] of the highest peaks of the Welch spectrum above 2 Hz, strongest first.

    Hann windows of 2 s (or the whole signal, if shorter), half overlapping, so 0.5 Hz apart. Empty for a
    signal at rest.
    """
    if np.ptp(signal) < QUIET:
        return ()
    frequency, power = welch(signal, 1.0 / sample_period, nperseg=min(len(signal), round(2.0 / sample_period)))
    peaks, _ = find_peaks(power)
    peaks = peaks[frequency[peaks] >= LOWEST_FREQUENCY]
    strongest = peaks[np.argsort(power[peaks])[::-1][:count]]
    return tuple(float(f) for f in frequency[strongest])


def common_frequency(first: FloatArray, second: FloatArray, sample_period: float) -> float:
    """Frequency [Hz] above 2 Hz at which two signals share most power: peak of their cross-spectrum."""
    if min(np.ptp(first), np.ptp(second)) < QUIET:
        return float("nan")
    segment = min(len(first), round(2.0 / sample_period))
    frequency, power = csd(first, second, 1.0 / sample_period, nperseg=segment)
    chosen = frequency >= LOWEST_FREQUENCY
    return float(frequency[chosen][np.argmax(np.abs(power[chosen]))])


def point_statistics(run: Run, point: str | float = "sensor", start: float = 2.0) -> dict[str, float]:
    """Statistics of one point from time ``start`` [s] on, in SI units; NaN where there is no peak.

    Displacement p99 and max are of y itself (positive: off the inner wall); of the acceleration (second
    difference of the samples, band below half the sample rate) they are of its magnitude.

    Raises:
        ValueError: fewer than 16 samples after ``start``, or the point was not recorded.
    """
    column = run.column(point)
    chosen = run.time >= start - 1e-9
    if chosen.sum() < 16:
        raise ValueError(
            f"start = {start!r} s leaves {chosen.sum()} samples of a run that ends at {run.time[-1]:g} s;"
            " at least 16 are needed"
        )
    axial, radial = run.axial[chosen, column], run.radial[chosen, column]
    radial_acceleration = run.acceleration(radial)
    axial_acceleration = run.acceleration(axial)
    axial_peaks = dominant_frequencies(axial, run.sample_period)
    radial_peaks = dominant_frequencies(radial, run.sample_period)
    return {
        "axial_mean_m": float(axial.mean()),
        "axial_rms_m": rms(axial),
        "axial_drift_m_per_s": float((axial[-1] - axial[0]) / (run.sample_period * (len(axial) - 1))),
        "radial_mean_m": float(radial.mean()),
        "radial_rms_m": rms(radial),
        "radial_p99_m": float(np.percentile(radial, 99.0)),
        "radial_max_m": float(radial.max()),
        "radial_acceleration_mean_m_per_s2": float(radial_acceleration.mean()),
        "radial_acceleration_rms_m_per_s2": rms(radial_acceleration),
        "radial_acceleration_p99_m_per_s2": float(np.percentile(np.abs(radial_acceleration), 99.0)),
        "radial_acceleration_max_m_per_s2": float(np.abs(radial_acceleration).max()),
        "axial_acceleration_rms_m_per_s2": rms(axial_acceleration),
        "lift_off_share": float((radial > 0.0).mean()),
        "axial_peak_hz": axial_peaks[0] if axial_peaks else float("nan"),
        "radial_peak_hz": radial_peaks[0] if radial_peaks else float("nan"),
        "common_peak_hz": common_frequency(axial, radial, run.sample_period),
        "tension_mean_n": float(run.tension[chosen, column].mean()),
        "tension_rms_n": rms(run.tension[chosen, column]),
    }
