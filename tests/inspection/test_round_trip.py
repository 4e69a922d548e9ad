"""Detection in round trips: one scored pass equals an insertion, two passes follow the closed form."""

from itertools import pairwise

import numpy as np
import pytest

from probe_env.inspection.detection import pod_gaussian, snr_at, threshold
from probe_env.inspection.metrics import DetectionMetrics, RoundTripMetrics, with_pod_columns
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.snr import COUNT, FilteredSignal

SENSOR = Sensor()
HALF = threshold(Sensor(false_calls=0.5 * SENSOR.false_calls), 60.0)
SILENT = np.zeros(COUNT)


def signal(snr, fraction=0.0, peak_to_peak=0.5, excursions=SILENT):
    return FilteredSignal(*map(np.asarray, (snr, fraction, peak_to_peak, excursions)))


def pod(snr, z=HALF):
    return pod_gaussian(snr_at(SENSOR, np.array([snr])), z)[0]


@pytest.mark.parametrize(
    ("scored_pass", "segment", "step"),
    [("insertion", "in", 1.0), ("withdrawal", "back", -1.0), ("withdrawal", "turn", -1.0)],
)
def test_one_pass_has_the_metrics_of_an_insertion(scored_pass, segment, step):
    """Spiky noise in intervals of different lengths, in the order of the pass."""
    rng = np.random.default_rng(0)
    alone, either = DetectionMetrics(SENSOR), RoundTripMetrics(SENSOR, scored_pass)
    ends = np.cumsum(rng.uniform(0.1, 2.0, 200))[:: int(step)]
    for one, other in pairwise(ends):
        low, high = sorted((float(one), float(other)))
        reading = signal(rng.uniform(1.0, 9.0), 0.5, rng.uniform(), rng.standard_t(2, COUNT))
        alone.add(high - low, reading)
        either.add(segment, low, high, reading)
        either.add("in" if segment != "in" else "back", low, high, signal(99.0))  # not scored
    assert not alone.gaussian
    expected = pytest.approx(with_pod_columns(alone.kpis(60.0, 60.0)), rel=1e-9)
    assert with_pod_columns(either.kpis(60.0, 60.0)) == expected


def test_flaw_is_detected_if_either_pass_detects_it():
    """In over 0 to 40 m at S/N 2 and 6, back over 10 to 60 m at 8 and 3: half of the false calls each."""
    either = RoundTripMetrics(SENSOR, "best")
    nothing, expected = (metrics.kpis(55.0, 60.0) for metrics in (either, DetectionMetrics(SENSOR)))
    assert with_pod_columns(nothing) == with_pod_columns(expected) | {"call_threshold": HALF}
    either.add("in", 0.0, 30.0, signal(2.0, peak_to_peak=0.1))
    either.add("in", 30.0, 40.0, signal(6.0, peak_to_peak=0.2))
    either.add("turn", 45.0, 60.0, signal(8.0, peak_to_peak=0.3))
    either.add("back", 10.0, 45.0, signal(3.0, peak_to_peak=0.4))
    kpis = either.kpis(80.0, 60.0)
    pieces = [(10.0, 2.0, 0.0), (20.0, 2.0, 3.0), (10.0, 6.0, 3.0), (5.0, 0.0, 3.0), (15.0, 0.0, 8.0)]
    called = sum(length * (1.0 - np.prod([1.0 - pod(x) for x in both if x > 0.0], axis=0)) for length, *both in pieces)
    assert kpis["pod"] == pytest.approx(called / 80.0, rel=1e-12)
    assert kpis["length_with_snr_over_3_m"] == 50.0
    peak_to_peak = 10.0 * 0.1 + 20.0 * 0.4 + 10.0 * 0.2 + 5.0 * 0.4 + 15.0 * 0.3
    assert kpis["noise_peak_to_peak_v"] == pytest.approx(peak_to_peak / 60.0)
    assert kpis["call_threshold"] == pytest.approx(HALF)
    assert kpis["noise_gaussian"] == 1.0


def test_intervals_may_end_anywhere():
    """The same passes in one piece, and in pieces whose ends are not those of the other pass."""
    both = RoundTripMetrics(SENSOR, "best"), RoundTripMetrics(SENSOR, "best")
    both[0].add("in", 5.0, 60.0, signal(4.0))
    both[0].add("back", 5.0, 60.0, signal(5.0))
    for segment, count, snr in (("in", 37, 4.0), ("back", 23, 5.0)):
        for low, high in pairwise(np.linspace(5.0, 60.0, count).tolist()):
            both[1].add(segment, low, high, signal(snr))
    whole, cut = (with_pod_columns(metrics.kpis(55.0, 60.0)) for metrics in both)
    assert cut == pytest.approx(whole, rel=1e-9)


def test_vibration_of_the_turn_raises_no_threshold_elsewhere():
    """Spikes in the metres after the turn, silence in the others, which have the threshold without a turn."""
    rng = np.random.default_rng(0)
    shaken, alone = RoundTripMetrics(SENSOR, "withdrawal"), RoundTripMetrics(SENSOR, "withdrawal")
    for metre in range(30):
        shaken.add("turn", 30.0 + metre, 31.0 + metre, signal(1e-9, 0.9, excursions=4.0 * rng.standard_t(3, COUNT)))
    for metre in range(25):
        for metrics in (shaken, alone):
            metrics.add("back", 5.0 + metre, 6.0 + metre, signal(4.0, 0.5))
    segments = shaken.segments
    assert segments["turn"].threshold(60.0) > segments["back"].threshold(60.0) == alone.segments["back"].threshold(60.0)
    kpis, silent = shaken.kpis(55.0, 60.0), alone.kpis(55.0, 60.0)
    assert (kpis["pod"] >= silent["pod"] - 1e-12).all()
    assert kpis["noise_gaussian"] == 0.0
    assert kpis["call_threshold"] > silent["call_threshold"] == threshold(SENSOR, 60.0)
