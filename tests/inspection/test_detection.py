"""Threshold, curves and depths, against closed forms, against counts, and against 10,000 flaws in simulated traces."""

import math

import numpy as np
import pytest
from oracles.scatter import hits_within, of_another
from scipy.special import logit
from scipy.stats import multivariate_t, norm, poisson
from statsmodels.discrete.discrete_model import Logit

from probe_env import Scene, SimulatorBatch
from probe_env.inspection import detection as curves
from probe_env.inspection import sensor as flaw
from probe_env.inspection.detection import DEPTHS, MIDDLES, depth_found, pod_empirical, pod_gaussian, snr_at, threshold
from probe_env.inspection.metrics import DetectionMetrics
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.snr import COUNT, FREQUENCY, FilteredSignal, SnrEstimator

SENSOR = Sensor()
CHANCE = 1e-4


def test_false_calls_have_the_nominal_rate():
    """White noise behind the filter over 2,000 m at a threshold for 0.1 calls in 2 m: a Poisson number around 100."""
    length, per_metre = 2000.0, 2000
    noise = np.random.default_rng(0).normal(size=round(length * per_metre))
    x = np.arange(-0.04, 0.04, 1.0 / per_metre) / SENSOR.flaw_width
    out = np.convolve(noise, flaw.shape(x), "same") / np.sqrt((flaw.shape(x) ** 2).sum())
    z = threshold(SENSOR, 2.0)
    calls = int(((out[1:] > z) & (out[:-1] <= z)).sum())
    assert poisson.ppf(0.5 * CHANCE, 100.0) <= calls <= poisson.isf(0.5 * CHANCE, 100.0)


def test_one_interval_in_closed_form():
    """One signal-to-noise everywhere: a50 at z, a90 at z + 1.2816, over the groove's; between depths to 1e-3."""
    z = threshold(SENSOR, 60.0)
    for groove, exponent in ((7.5, 1.0), (20.0, 1.0), (7.5, 1.6)):
        sensor = Sensor(depth_exponent=exponent)
        curve = pod_gaussian(snr_at(sensor, np.array([groove])), z)[0]
        for level in (0.5, 0.9):
            expected = 0.2 * ((z + norm.ppf(level)) / groove) ** (1.0 / exponent)
            assert depth_found(curve, level) == pytest.approx(expected, rel=2e-3)
    assert depth_found(np.full(len(DEPTHS), 0.85), 0.9) == 1.0
    assert depth_found(np.ones(len(DEPTHS)), 0.9) == DEPTHS[0]


def test_gaussian_excursions_give_the_gaussian_curve():
    """Counts of the normal distribution; what remains is their bins of 0.25: a variance too large by 0.25^2 / 12."""
    counts = np.diff(norm.cdf(curves.EDGES)) * 1e9
    z = threshold(SENSOR, 60.0)
    snr = snr_at(SENSOR, np.array([2.0, 4.0, 12.0]))
    fraction = np.array([0.0, 0.5, 0.9])
    steepest = norm.pdf(1.0) * 0.5 * 0.25**2 / 12.0  # of a change of variance: phi'(x) / 2, the most at x = 1
    assert pod_empirical(snr, z, fraction, counts) == pytest.approx(pod_gaussian(snr, z), abs=2.0 * steepest)


def test_spiky_excursions_hide_flaws():
    """Noise that is a spike of five deviations in one sample of 25: simulated and predicted."""
    counts = np.zeros(len(MIDDLES))
    counts[np.abs(MIDDLES - 0.125) < 0.01] = 48.0
    counts[np.abs(np.abs(MIDDLES) - 4.875) < 0.01] = 1.0  # one of each sign
    fraction, snr, z, draws = 0.8, 6.0, 4.585, 200_000
    predicted = float(pod_empirical(np.array([[snr]]), z, np.array([fraction]), counts)[0, 0])
    rng = np.random.default_rng(0)
    spikes = rng.choice(MIDDLES, size=draws, p=counts / counts.sum())
    hits = int((snr + np.sqrt(fraction) * spikes + np.sqrt(1.0 - fraction) * rng.normal(size=draws) > z).sum())
    minimum, maximum = hits_within(draws, predicted, predicted)
    assert minimum <= hits <= maximum
    assert predicted < float(pod_gaussian(np.array(snr), z)) + 0.06


def test_an_episode_is_averaged_over_its_length():
    """Half at one signal-to-noise, half at another, and a tenth of the tube not inspected."""
    z = threshold(SENSOR, 60.0)
    detection = DetectionMetrics(SENSOR)
    for snr in (2.0, 8.0):
        detection.add(27.0, FilteredSignal(*map(np.asarray, (snr, 0.0, 0.5, np.zeros(COUNT)))))
    kpis = detection.kpis(60.0, 60.0)
    curve = 0.45 * sum(pod_gaussian(snr_at(SENSOR, np.array([snr])), z)[0] for snr in (2.0, 8.0))
    assert kpis["pod"] == pytest.approx(curve, rel=1e-12)
    assert kpis["length_with_snr_over_3_m"] == 27.0
    assert kpis["noise_peak_to_peak_v"] == 0.5
    assert kpis["a90_percent_wall"] == pytest.approx(100.0, abs=0.2)  # of what was inspected all: a hole
    assert kpis["a50_percent_wall"] == pytest.approx(100.0 * depth_found(curve, 0.5), rel=1e-12)
    assert DetectionMetrics(SENSOR).kpis(60.0, 60.0)["a90_percent_wall"] == 100.0  # nothing was inspected


def test_spikes_are_not_gaussian():
    rng = np.random.default_rng(0)
    for draw, gaussian in ((rng.normal, True), (lambda size: rng.standard_t(3, size), False)):
        detection = DetectionMetrics(SENSOR)
        for _ in range(300):
            detection.add(0.2, FilteredSignal(*map(np.asarray, (5.0, 0.5, 0.1, draw(size=COUNT)))))
        assert detection.gaussian is gaussian


@pytest.mark.slow
@pytest.mark.processor
def test_the_formula_agrees_with_10000_flaws(seeds):
    """Flaws of random depth in simulated traces with electronic noise, called by the filter, fitted by a logit.

    The regressor is the logit of the formula's curve (calibration after Cox): the shape of a logit costs nothing.
    Noise of one second is shared by many flaws: the fit's intervals are those of clusters, one a probe and second.
    """
    members, seconds, feed, flaws = 8, 9, 0.2, 10_000
    scenes = [Scene(carrier_length=35.0, feed_speed=feed)] * members
    batch = SimulatorBatch(scenes, "superelement32", seeds=seeds(members), threads=1, perturbation=1e-6)
    batch.advance(None, None, 3.0)
    estimator, detection, traces, spectra = SnrEstimator(SENSOR, members, 1e-3), DetectionMetrics(SENSOR), [], []
    for second in range(seconds):
        trace = batch.advance(None, None, 1.0, keep_samples=True).radial
        estimator.update(np.arange(members), trace, np.full(members, feed))
        if second:  # the first fills the estimator
            traces.append(trace.T)
            spectra.append([estimator.filter_spectrum(k) for k in range(members)])
            for k in range(members):
                detection.add(1.0, estimator.last(k))
    kpis, z = detection.kpis(float(sum(detection.lengths)), 60.0), detection.threshold(60.0)
    motion, spectrum = np.concatenate(traces), np.concatenate(spectra)
    rng = np.random.default_rng(seeds(1)[0])
    second, depth = rng.integers(len(motion), size=flaws), np.exp(rng.uniform(math.log(0.05), 0.0, flaws))
    called = np.array([_called(motion[k], spectrum[k], a, feed, z, rng) for k, a in zip(second, depth, strict=True)])
    predicted = np.interp(np.log(depth), np.log(DEPTHS), logit(np.clip(kpis["pod"], 1e-6, 1.0 - 1e-6)))
    regression = Logit(called.astype(float), np.column_stack([np.ones(flaws), predicted]))
    fit = regression.fit(disp=0, cov_type="cluster", cov_kwds={"groups": second})
    law = multivariate_t(fit.params, fit.cov_params(), df=len(motion) - 1)  # t: the variance is that of the clusters
    draws = law.rvs(40_000, random_state=rng)
    logits = (math.log(9.0) - draws[:, 0]) / draws[:, 1]  # of the formula's curve where the fit says 90 %
    low, high = np.quantile(logits, [0.5 * CHANCE, 1.0 - 0.5 * CHANCE])
    assert low <= math.log(9.0) <= high
    a90 = [depth_found(kpis["pod"], 1.0 / (1.0 + math.exp(-end))) for end in np.quantile(logits, [0.025, 0.975])]
    # so the interval says something: log a90 is 0.105 wide, and the logarithm of that scatters by 0.22 over 16 sets of
    # seeds, which leaves 0.32 to chance
    assert a90[1] / a90[0] < math.exp(0.105 * math.exp(of_another(0.22, 16)))


def _called(motion, spectrum, depth, feed, z, rng):
    """Whether a flaw somewhere in a second of motion is called, by a filter at the full sampling rate."""
    time = np.arange(len(motion)) * 1e-3
    template = flaw.shape(feed * (time - rng.uniform(0.35, 0.65)) / SENSOR.flaw_width)
    level = motion - np.polyval(np.polyfit(time, motion, 1), time)
    noise = rng.normal(size=len(time)) * math.sqrt(SENSOR.noise_density * 500.0)
    lines = slice(1, len(FREQUENCY) + 1)
    signal, template = (np.fft.rfft(values)[lines] for values in (
        SENSOR.flaw_gain * level + float(SENSOR.amplitude(depth)) * template + noise, template
    ))  # fmt: skip
    density = SENSOR.flaw_gain**2 * spectrum + SENSOR.noise_density
    # a line holds S * 500 Hz * samples, half of it in phase with the flaw
    deviation = math.sqrt((np.abs(template) ** 2 / density).sum() * 250.0 * len(time))
    return (signal * template.conj() / density).real.sum() / deviation > z
