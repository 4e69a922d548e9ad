"""The matched filter against closed forms and against noise whose spectrum is known."""

import numpy as np
import pytest
from oracles.scatter import of_another
from scipy.integrate import quad
from scipy.signal import lfilter

from probe_env.inspection import sensor as flaw
from probe_env.inspection import snr as matched
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.snr import COUNT, FREQUENCY, STEP, SnrEstimator, density, detrended, snr_of_groove
from probe_env.physics.simulation.batch import SimulatorBatch
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.scene import Contact, Scene

FEEDS = np.array([0.02, 0.05, 0.08, 0.2, 0.4, 1.0])
NONE = np.zeros((len(FEEDS), len(FREQUENCY)))


def test_the_flaw_in_closed_form():
    """Quadrature is good to 1e-8; the spectrum is that of the shape (Parseval), and highest at f = u/w."""
    assert quad(lambda x: float(flaw.shape(x)) ** 2, -3, 3)[0] == pytest.approx(flaw.ENERGY, rel=1e-8)
    assert 2.0 * quad(lambda v: float(flaw.power(v)), 0, 8)[0] == pytest.approx(flaw.ENERGY, rel=1e-8)
    assert quad(lambda v: float(flaw.power(v) / flaw.power(1.0)), 0, 8)[0] == pytest.approx(flaw.BAND, rel=1e-8)
    assert quad(lambda v: float(flaw.power(v)), 1.3, 8)[0] == pytest.approx(float(flaw.energy_above(1.3)), rel=1e-8)
    mean_square = quad(lambda v: float(v**2 * flaw.power(v)), 0, 8)[0] / (0.5 * flaw.ENERGY)
    assert np.sqrt(mean_square) == pytest.approx(flaw.UPCROSSINGS, rel=1e-8)
    x = np.linspace(-1, 1, 2001)
    assert flaw.shape(x).max() == pytest.approx(1.0, abs=1e-5)
    v = np.linspace(0.1, 3, 2901)
    assert v[flaw.power(v).argmax()] == pytest.approx(1.0, abs=1e-3)
    spectrum = quad(lambda s: float(flaw.shape(s)) * np.sin(2 * np.pi * 0.7 * s), -3, 3)[0]
    assert spectrum**2 == pytest.approx(float(flaw.power(0.7)), rel=1e-8)


@pytest.mark.parametrize("width", [0.01, 0.02, 0.04])
def test_a_flat_spectrum_has_the_closed_form(width):
    """SNR^2 = 2 A^2 (w/u) integral g^2 dx / S, one-sided.

    The sum over lines 1 Hz apart is exact but for what is below the first line: the integrand is analytic. The worst is
    u/w = 0.5 Hz, where the terms at 0.5, 1.5, ... are missed: Poisson's sum says by 2 (2 pi^2 - 1) exp(-pi^2) times.
    """
    sensor = Sensor(flaw_width=width)
    feeds = FEEDS[width <= FEEDS]
    closed = sensor.groove_signal * np.sqrt(2.0 * flaw.ENERGY * width / feeds / sensor.noise_density)
    for way in (1.0, -1.0):
        assert snr_of_groove(sensor, way * feeds, NONE[: len(feeds)]) == pytest.approx(closed, rel=1.1e-3)
    white = np.full((len(feeds), len(FREQUENCY)), 3.0 * sensor.noise_density / sensor.gain**2)
    low = feeds / width < 25.0  # the motion's band is the flaw's
    assert snr_of_groove(sensor, feeds, white)[low] == pytest.approx(0.5 * closed[low], rel=1.1e-3)


@pytest.mark.parametrize("angle", [0.0, 1.0, -2.5])
def test_equivalent_rms_is_the_rms_of_the_motion(angle):
    """White motion over the flaw's band, with electronics that add 1e-5 of it to the square at most."""
    sensor, rms = Sensor(quiet_snr=1000.0, motion_gain=2900.0, flaw_angle=angle), 1e-4
    white = np.full((1, len(FREQUENCY)), rms**2 / (flaw.BAND * 0.2 / 0.02))
    feed = np.array([0.2])
    assert sensor.equivalent_rms(1.0 / snr_of_groove(sensor, feed, white)) == pytest.approx(rms, rel=2e-5)
    # the reference points
    assert snr_of_groove(Sensor(), feed, NONE[:1]) == pytest.approx(7.5, rel=1e-5)
    assert snr_of_groove(Sensor(), feed, white) == pytest.approx(3.0, rel=1e-5)


def ringing(rng, count, seconds, level):
    """(samples, count) of an oscillator at 14 Hz, 5 % damped, in white noise."""
    pole = np.exp((-0.05 + 1j * np.sqrt(1 - 0.05**2)) * 2 * np.pi * 14.0 * 1e-3)
    drive = level * rng.normal(size=(seconds * 1000 + 1000, count))
    return lfilter([1.0], [1.0, -2 * pole.real, abs(pole) ** 2], drive, axis=0)[1000:]


@pytest.mark.parametrize("frequency", [9.0, 14.3, 30.0])
def test_a_tone_keeps_its_power_and_frequency(frequency):
    """By Parseval the lines hold all of its power but what the straight line took, 1 % at 9 Hz and more than 5 cycles.

    Sine tapers fall off with the square of the distance: six lines from the tone, past their band of 2.5, the sum of
    the four has fallen by 100 and more.
    """
    time = np.arange(1000) * 1e-3
    phases = np.linspace(0.0, np.pi, 8, endpoint=False)[:, None]
    spectrum = density(detrended(np.sin(2 * np.pi * frequency * time + phases), 1e-3)).mean(axis=0)
    assert spectrum.sum() == pytest.approx(0.5, rel=0.02)
    assert abs(FREQUENCY[spectrum.argmax()] - frequency) <= 2.5
    assert spectrum[np.abs(FREQUENCY - frequency) > 6.0].max() < 0.01 * spectrum.max()


def test_white_noise_is_flat():
    """Means of 400 estimates, 8 degrees of freedom each: 2.5 % at a line. Of steps, so that nothing folds down."""
    rng = np.random.default_rng(1)
    means = rng.normal(size=(400, COUNT)).repeat(5, axis=1)  # steps of 5 ms: white to 100 Hz but for their means
    spectrum = density(detrended(means, 1e-3)).mean(axis=0) * np.sinc(FREQUENCY * STEP) ** 2
    inner = FREQUENCY >= 4  # below, the straight line has been taken away
    assert spectrum[inner] == pytest.approx(np.full(inner.sum(), 2.0 * STEP), rel=5.5 * 0.025)
    assert spectrum[inner].mean() == pytest.approx(2.0 * STEP, rel=5 * 0.025 / np.sqrt(inner.sum() / 5))


@pytest.mark.processor
@pytest.mark.parametrize(
    ("periods", "left", "scatter", "variance"),
    [
        (1, (1.0037, 0.0034), (0.0389, 0.0018), (0.842, 0.0175)),
        (4, (1.0010, 0.0038), (0.0443, 0.0017), (0.847, 0.0184)),
    ],
)
def test_the_mean_of_estimates_is_that_of_the_true_spectrum(periods, left, scatter, variance, seeds):
    """SNR^2 of ringing noise by the estimator, against that of its true spectrum at the estimator's resolution.

    400 probes run for 8 s, ``periods`` in each. Of 24 such draws are the means and deviations above: of what is
    left of the bias of 1/S (uncorrected 6 and 8 % where motion is all the noise), of SNR's scatter, and of the variance
    that the middle of the excursions has over what the spectrum of the same seconds says.
    """
    sensor, feed, rng = Sensor(), np.full(400, 0.2), np.random.default_rng(seeds(1)[0])
    y = ringing(rng, 400, 8, 2e-6)
    long = density(detrended(y.reshape(8, 1000, 400).transpose(2, 0, 1).reshape(3200, 1000), 1e-3)).mean(axis=0)
    estimator = SnrEstimator(sensor, 400, 1e-3)
    for period in y.reshape(8 * periods, -1, 400):
        reading = estimator.update(np.arange(400), period, feed)
    truth = float(snr_of_groove(sensor, feed[:1], long[None])[0])
    assert 1.0 < truth < 4.0  # motion is most of the noise
    middle = reading.excursions[:, 75:125]
    figures = ((reading.snr**2).mean() / truth**2, reading.snr.std() / reading.snr.mean(), (middle**2).mean())
    for value, (mean, deviation) in zip(figures, (left, scatter, variance), strict=True):
        assert value == pytest.approx(mean, abs=of_another(deviation, 24, among=6))


@pytest.mark.processor
@pytest.mark.parametrize(("passed", "deviation"), [(1.0, 7.2e-4), (0.25, 1.03e-3)])
def test_freedom_of_a_mean_of_spectra(passed, deviation, seeds):
    """Relative variance 2/nu of the estimator's mean in white noise, with the nu of ``inverse_bias``.

    Of 24 draws of 400 probes the mean lay within 0.25 % of the closed form, with the deviations given.
    """
    rng = np.random.default_rng(seeds(1)[0])
    estimator, steps = SnrEstimator(Sensor(), 400, STEP), round(passed / STEP)
    for _ in range(round(12.0 / passed)):
        estimator.update(np.arange(400), rng.normal(size=(steps, 400)), np.full(400, 0.2))
    estimates = estimator.spectrum[:, 4:90]
    variance = (estimates.var(axis=0) / estimates.mean(axis=0) ** 2).mean()
    c = matched.inverse_bias(passed)
    assert variance == pytest.approx((c - 1.0) / c, abs=of_another(deviation, 24, among=3) + 0.0025 * variance)


@pytest.mark.parametrize("passed", [2.0, 1.0, 0.5, 0.25, 0.1, 0.05, 0.005])
def test_last_second_has_its_fraction_of_the_mean(passed):
    """Weights of all spectra times their share of the last second; spectra without end fall off as exp(-t/m)."""
    r, j = matched.retained_weight(passed), np.arange(round(40.0 / passed))
    assert ((1.0 - r) * r**j * np.maximum(1.0 - j * passed, 0.0)).sum() == pytest.approx(
        matched.NEWEST_FRACTION, abs=1e-12
    )
    if passed == 0.005:
        m = -passed / np.log(r)
        fraction = 1.0 - m * (1.0 - np.exp(-1.0 / m))
        assert fraction == pytest.approx(matched.NEWEST_FRACTION, rel=passed)  # the error of the sum is of first order


@pytest.mark.slow
@pytest.mark.processor
@pytest.mark.parametrize(("passed", "mean", "deviation"), [(0.25, 0.119, 0.045), (0.05, 0.175, 0.047)])
def test_bursts_exceed_the_noise_equally_at_any_period(passed, mean, deviation, seeds):
    """Share of excursions beyond 3 deviations, noise amplitude varying within a second, over those of 1 s.

    Means and deviations of the logarithm of the ratio are of 24 draws. Means over 2 s of the motion would have made
    0.4 and more of it, means over 2 s on the tube -0.4 and less.
    """
    rng, number, fade = np.random.default_rng(seeds(1)[0]), 400, np.exp(-STEP)
    drive, start = rng.normal(size=(2400, number)), fade * rng.normal(size=(1, number))
    drift = lfilter([np.sqrt(1.0 - fade**2)], [1.0, -fade], drive, axis=0, zi=start)[0]
    motion, fractions = 1e-4 * np.exp(0.5 * drift) * rng.normal(size=drift.shape), []
    for each in (1.0, passed):
        estimator, steps, excursions = SnrEstimator(Sensor(), number, STEP), round(each / STEP), []
        for begin in range(0, len(motion), steps):
            reading = estimator.update(np.arange(number), motion[begin : begin + steps], np.full(number, 0.2))
            if begin >= 800:
                excursions.append(reading.excursions[:, 75:125])
        fractions.append((np.abs(excursions) > 3.0).mean())
    assert np.log(fractions[1] / fractions[0]) == pytest.approx(mean, abs=of_another(deviation, 24, among=2))


def test_a_batch_equals_single_estimators():
    y, feeds = ringing(np.random.default_rng(3), 5, 2, 1e-6), np.array([0.05, 0.1, 0.2, 0.3, 0.0])
    together = SnrEstimator(Sensor(), 5, 1e-3)
    alone = [SnrEstimator(Sensor(), 1, 1e-3) for _ in range(5)]
    for begin in range(0, 2000, 250):
        part = y[begin : begin + 250]
        reading = together.update(np.arange(5), part, feeds)
        for k, estimator in enumerate(alone):
            single = estimator.update(np.arange(1), part[:, [k]], feeds[[k]])
            assert [values[0] for values in single[:3]] == [values[k] for values in reading[:3]]  # to the last digit
            assert (single.excursions[0] == reading.excursions[k]).all()
            assert together.last(k)[:3] == estimator.last(0)[:3]
    before = reading.snr[2]
    together.reset(2)
    quiet = together.update(np.array([2]), np.zeros((2000, 1)), feeds[[2]])
    assert quiet.snr[0] == pytest.approx(7.5, rel=1e-5)
    assert quiet.snr[0] > before


def test_a_filter_weighs_by_the_period_of_its_own_probe():
    """Two probes in one estimator, in periods of a second and of a quarter: each as if it were alone."""
    motion = 1e-4 * np.random.default_rng(0).normal(size=(2000, 2))
    together, alone = SnrEstimator(Sensor(), 2, 1e-3), [SnrEstimator(Sensor(), 1, 1e-3) for _ in range(2)]
    for k, periods in enumerate((2, 8)):
        for part in motion[:, k : k + 1].reshape(periods, -1, 1):
            together.update(np.array([k]), part, np.array([0.2]))
            alone[k].update(np.array([0]), part, np.array([0.2]))
    copies = together.branch([1, 0])
    for k in range(2):
        assert (together.filter_spectrum(k) == alone[k].filter_spectrum(0)).all()
        assert (copies.filter_spectrum(1 - k) == alone[k].filter_spectrum(0)).all()


@pytest.mark.slow
@pytest.mark.processor
def test_time_lapse_does_not_change_what_is_measured(seeds):
    """In seconds, as ``standard`` and ``reference`` take it, and in quarters, as ``fast`` does; table 2's probe rings.

    The logarithm of the ratio, 0.0118, and its deviation from probe to probe are of 32 others; 16 each at 35 and 50 m
    gave 0.010 and 0.004. It is not 0, for the bias of 1/S is taken back as if the motion were Gaussian.
    """
    count, feed, snr = 8, 0.2, []
    scene = Scene(carrier_length=20.0, feed_speed=feed, contact=Contact(friction=0.2))
    batch = SimulatorBatch([scene] * count, "superelement32", 2e-4, seeds=seeds(count), perturbation=1e-5)
    batch.advance(None, None, 6.0, SAMPLE_PERIOD)
    radial = batch.advance(None, None, 40.0, SAMPLE_PERIOD, keep_samples=True).radial
    for passed in (1.0, 0.25):
        estimator = SnrEstimator(Sensor(), count, SAMPLE_PERIOD)
        periods = np.split(radial, round(40.0 / passed))
        each = [estimator.update(np.arange(count), period, np.full(count, feed)).snr for period in periods]
        snr.append(np.mean(each[round(5.0 / passed) :], axis=0))  # once the mean spectrum has filled
    seconds, quarters = snr
    assert seconds.mean() < 0.5 * Sensor().quiet_snr  # motion is most of the noise
    ratio = np.log(quarters / seconds)
    assert ratio.mean() == pytest.approx(0.0118, abs=of_another(0.013, 32, members=count))
