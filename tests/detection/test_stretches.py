"""A threshold that has heard all of the motion: against what was heard, exceedance by exceedance."""

import numpy as np
import pytest
from scipy.special import ndtr

from agents.detection.stretches import STRETCH, listened, threshold_of_all
from probe_env.inspection.detection import EDGES, LEAST_GAUSSIAN, threshold, threshold_as_seen
from probe_env.inspection.meter import Meter
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.tally import MIDDLE, DetectionTally

SENSOR = Sensor()
GAUSSIAN = threshold(SENSOR, 60.0)


def bursts(begin, every, rng, seconds=240):
    """White motion of 10 um and, from ``begin`` [s] on in one second of so many, a quarter of a second of 14 Hz."""
    motion = 1e-5 * rng.normal(size=1000 * seconds)
    tone = np.sin(2.0 * np.pi * 14.0 * 1e-3 * np.arange(STRETCH))
    for second in range(every, seconds, every):
        start = round(1000 * (second + begin))
        motion[start : start + STRETCH] += 4e-4 * tone
    return motion


def feeds(motion):
    return np.full(len(motion), 0.2)


def of_all(motion):
    return threshold_of_all(SENSOR, motion, feeds(motion), 60.0)


def of_a_quarter(motion):
    """The threshold of an episode in periods of a second that does not take its motion for Gaussian."""
    tally, meter = DetectionTally(SENSOR), Meter(SENSOR, 1, 1e-3)
    for begin in range(0, len(motion), 1000):
        meter.listen(np.arange(1), motion[begin : begin + 1000, None], np.array([0.2]))
        tally.add(0.2, *meter.of(0))
    return threshold_as_seen(GAUSSIAN, np.array(tally.lengths), np.array(tally.shares), tally.counts)


def heard_in(motion):
    """Shares (n,) and excursions (n, m) of every quarter of a second, once a second is known."""
    readings = [meter.of(0) for _, end, meter in listened(SENSOR, motion, feeds(motion)) if end >= 1000]
    return np.array([share for _, share, *_ in readings]), np.array([excursions[MIDDLE] for *_, excursions in readings])


def exceeded(shares, excursions, z):
    """How often noise exceeds z, place by place with its own share and excursions, over how often it should."""
    share = np.minimum(shares, 1.0 - LEAST_GAUSSIAN)[:, None]
    return ndtr((np.sqrt(share) * excursions - z) / np.sqrt(1.0 - share)).mean() / ndtr(-GAUSSIAN)


@pytest.mark.parametrize("seed", range(3))
def test_noise_exceeds_it_as_often_as_gaussian_noise_its_own(seed):
    """Half of the places shake alike, half are still: counted are those that shake.

    A histogram's bins are 0.25 wide, within which a tail that falls by exp(a e) is 1 + (0.25 a)^2 / 24 times its
    middle: up to 15 % for a = sqrt(s) z / (1 - s), z = 5.4 and the largest share s = 0.49.
    """
    motion = bursts(0.0, 2, np.random.default_rng(seed))
    z = of_all(motion)
    assert z > GAUSSIAN + 0.5
    assert exceeded(*heard_in(motion), z) == pytest.approx(1.0, abs=0.15)


def test_excursions_weigh_by_the_motion_that_is_in_the_noise():
    """Where one second of four shakes, spikes come in noise that is mostly motion: plain counts do not tell."""
    motion = bursts(0.0, 4, np.random.default_rng(0))
    shares, excursions = heard_in(motion)
    plain = np.histogram(excursions, EDGES)[0].astype(float)
    too_low = threshold_as_seen(GAUSSIAN, np.ones(len(shares)), shares, plain)
    assert GAUSSIAN < too_low < of_all(motion)
    assert 1.0 < exceeded(shares, excursions, of_all(motion)) < exceeded(shares, excursions, too_low)


def test_it_does_not_matter_where_in_a_second_a_burst_comes():
    """An episode counts one quarter of each second: it misses bursts in the next but one, or counts each for four."""
    missed, counted = (bursts(begin, 3, np.random.default_rng(0)) for begin in (0.0, 0.5))
    assert of_a_quarter(missed) < GAUSSIAN + 0.1
    assert of_a_quarter(counted) > of_all(counted)
    # the same bursts, half a second later: of 80 one could be cut off at the end
    assert of_all(missed) == pytest.approx(of_all(counted), abs=0.05)


def test_still_or_short_motion_leaves_the_gaussian_threshold():
    assert of_all(np.zeros(3000)) == GAUSSIAN
    assert of_all(4e-4 * np.sin(np.arange(800))) == GAUSSIAN  # less than a second: nothing is counted
