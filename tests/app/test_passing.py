"""A flaw that is dragged through the last second: what it shows is what the sensor model says of it."""

import numpy as np
import pytest

from agents.app.runs.frames import Shape
from agents.app.runs.passing import passed
from probe_env.inspection.detection import threshold
from probe_env.inspection.meter import FREQUENCY
from probe_env.inspection.sensor import GROOVE, Sensor

PERIOD = 1e-3


def still(feed=0.2, seconds=1.0):
    """A probe that does not vibrate."""
    none, count = np.zeros(0), round(seconds / PERIOD)
    return Shape(
        place=none, axial=none, radial=none, tension=none, lever=none, outer_gap=none, sensor=0, bore=0.0242,
        helix_length=60.0, helix_diameter=1.4, friction=0.17,
        signal_time=PERIOD * (np.arange(count) + 1 - count), signal_radial=np.zeros(count),
        spectrum=np.zeros(len(FREQUENCY)), feed_speed=feed, seen={},
    )  # fmt: skip


def test_in_a_quiet_tube_a_groove_has_the_anchor_s_signal_to_noise():
    """7.5 at 0.2 m/s, in proportion to the depth, and as the root of the time that the flaw takes (closed form)."""
    sensor = Sensor()
    assert passed(sensor, still(), 0.5, GROOVE).snr == pytest.approx(7.5, rel=2e-3)
    assert passed(sensor, still(), 0.5, 2.0 * GROOVE).snr == pytest.approx(15.0, rel=2e-3)
    assert passed(sensor, still(feed=0.1), 0.5, GROOVE).snr == pytest.approx(7.5 * 2.0**0.5, rel=2e-3)


@pytest.mark.parametrize("before", [0.3, 0.5, 0.7])
def test_behind_the_filter_it_stands_as_high_as_that(before):
    """Noise of deviation 1 is added, and the highest of a few samples is taken: -4 to +5 but for a chance of 1e-4."""
    seen = passed(Sensor(), still(), before, 2.0 * GROOVE)
    assert -4.0 < seen.shown - seen.snr < 5.0
    assert seen.called
    assert seen.time[seen.near] == pytest.approx(-before, abs=0.051)  # half a width of 20 mm at 0.2 m/s
    assert seen.threshold == threshold(Sensor(), 60.0)
    assert not passed(Sensor(), still(), before, 0.01).called


def test_nothing_is_shown_of_a_probe_that_stands_or_has_just_begun():
    assert passed(Sensor(), still(feed=0.0), 0.5, GROOVE) is None
    assert passed(Sensor(), still(seconds=0.05), 0.5, GROOVE) is None
