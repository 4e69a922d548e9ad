"""Statistics of sampled signals, for reports, environments and tests."""

import numpy as np
from scipy.signal import csd, find_peaks, welch

from probe_env.arrays import FloatArray
from probe_env.physics.simulation.run import Run

SAMPLE_PERIOD = 1e-3  # [s], of the sensor signals in detection, plots and scores
LOWEST_FREQUENCY = 2.0  # [Hz]; slower motion is drift of the mean, not vibration
QUIET = 1e-9  # [m]; the spectrum of a smaller signal is rounding


def dominant_frequencies(signal: FloatArray, sample_period: float, count: int = 3) -> tuple[float, ...]:
    """Frequencies [Hz] of the highest peaks of the Welch spectrum above 2 Hz, strongest first.

    Hann windows of 2 s (or the whole signal, if shorter) with half overlap; the resolution is 0.5 Hz. Empty for a
    constant signal.
    """
    if np.ptp(signal) < QUIET:
        return ()
    frequency, power = welch(signal, 1.0 / sample_period, nperseg=min(len(signal), round(2.0 / sample_period)))
    peaks, _ = find_peaks(power)
    peaks = peaks[frequency[peaks] >= LOWEST_FREQUENCY]
    strongest = peaks[np.argsort(power[peaks])[::-1][:count]]
    return tuple(float(f) for f in frequency[strongest])


def common_frequency(first: FloatArray, second: FloatArray, sample_period: float) -> float:
    """Frequency [Hz] of the highest peak of the cross-spectrum of two signals above 2 Hz."""
    if min(np.ptp(first), np.ptp(second)) < QUIET:
        return float("nan")
    segment = min(len(first), round(2.0 / sample_period))
    frequency, power = csd(first, second, 1.0 / sample_period, nperseg=segment)
    chosen = frequency >= LOWEST_FREQUENCY
    return float(frequency[chosen][np.argmax(np.abs(power[chosen]))])


def window_statistics(
    axial: FloatArray, radial: FloatArray, tension: FloatArray, sample_period: float
) -> dict[str, FloatArray]:
    """Statistics of N probes over a window of k samples, each (N,), in SI units.

    Args:
        axial: (k + 2, N) displacement [m]; the first two samples are those before the window. Velocity is the
            first, acceleration the second difference of the samples.
        radial: (k + 2, N) displacement [m].
        tension: (k + 2, N) [N].
        sample_period: [s]; velocity and acceleration are limited to frequencies up to half its inverse.

    rms is the standard deviation about the mean of the window; p99 and max of displacement are of the signed value
    (positive: off the inner wall), those of acceleration are of its magnitude.
    """
    values: dict[str, FloatArray] = {}
    for name, signal in (("axial", axial), ("radial", radial)):
        window = signal[2:]
        velocity = np.diff(signal[1:], axis=0) / sample_period
        acceleration = np.diff(signal, n=2, axis=0) / sample_period**2
        values[f"{name}_mean_m"] = window.mean(axis=0)
        values[f"{name}_rms_m"] = window.std(axis=0)
        values[f"{name}_p99_m"] = np.percentile(window, 99.0, axis=0)
        values[f"{name}_max_m"] = window.max(axis=0)
        values[f"{name}_velocity_rms_m_per_s"] = velocity.std(axis=0)
        values[f"{name}_acceleration_mean_m_per_s2"] = acceleration.mean(axis=0)
        values[f"{name}_acceleration_rms_m_per_s2"] = acceleration.std(axis=0)
        values[f"{name}_acceleration_p99_m_per_s2"] = np.percentile(np.abs(acceleration), 99.0, axis=0)
        values[f"{name}_acceleration_max_m_per_s2"] = np.abs(acceleration).max(axis=0)
    values["lift_off_share"] = (radial[2:] > 0.0).mean(axis=0)
    values["tension_mean_n"] = tension[2:].mean(axis=0)
    values["tension_rms_n"] = tension[2:].std(axis=0)
    return values


def point_statistics(run: Run, point: str | float = "sensor", start: float = 2.0) -> dict[str, float]:
    """Statistics of one point of a run from time ``start`` [s] on; NaN if there is no spectral peak.

    They are those of ``window_statistics`` (the first two samples are used for differences only), the drift of the
    axial mean, and the highest peaks above 2 Hz of the axial and radial spectrum and of their cross-spectrum.

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
    axial, radial, tension = (signal[chosen, column] for signal in (run.axial, run.radial, run.tension))
    window = window_statistics(axial[:, None], radial[:, None], tension[:, None], run.sample_period)
    axial_peaks = dominant_frequencies(axial, run.sample_period)
    radial_peaks = dominant_frequencies(radial, run.sample_period)
    return {
        **{name: float(value[0]) for name, value in window.items()},
        "axial_drift_m_per_s": float((axial[-1] - axial[0]) / (run.sample_period * (len(axial) - 1))),
        "axial_peak_hz": axial_peaks[0] if axial_peaks else float("nan"),
        "radial_peak_hz": radial_peaks[0] if radial_peaks else float("nan"),
        "common_peak_hz": common_frequency(axial, radial, run.sample_period),
    }
