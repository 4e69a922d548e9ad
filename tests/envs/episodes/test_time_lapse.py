"""Time-lapse where the feed is slow and steady: there it is `fast`, elsewhere `standard`, to the last bit."""

import numpy as np
import pytest

from probe_env.envs.episodes import Episodes
from probe_env.envs.task import TaskConfig
from probe_env.fidelity import Fidelity, resolve_fidelity

CONFIG = TaskConfig()
STEADY = Fidelity(time_lapse=4.0, steady_feed=0.2)
AIR = 0.02


def inserted(fidelity, feeds, config=CONFIG):
    """Inserted lengths (periods + 1, N) [m] and observations (periods, N, d) with feeds (periods, N) [m/s]."""
    count = len(feeds[0])
    episodes = Episodes(count, config, threads=1, fidelity=fidelity, feed_speed=0.2)
    episodes.reset(range(count), {k: np.random.default_rng(k) for k in range(count)})
    lengths, seen = [episodes.inserted_length], []
    for row in feeds:
        step = episodes.step(config.actions(np.array(row), np.full(count, AIR)).astype(np.float32))
        lengths.append(episodes.inserted_length)
        seen.append(step.observation)
    return np.array(lengths), np.array(seen)


def test_where_the_feed_is_slow_and_steady_it_is_fast_to_the_last_bit():
    feeds = [[0.2], [0.16], [0.12], [0.12]]
    for one, other in zip(inserted(STEADY, feeds), inserted("fast", feeds), strict=True):
        np.testing.assert_array_equal(one, other)


def test_where_it_is_fast_or_changes_it_is_standard_to_the_last_bit():
    feeds = [[0.4], [0.4], [0.3], [0.1]]
    for one, other in zip(inserted(STEADY, feeds), inserted("standard", feeds), strict=True):
        np.testing.assert_array_equal(one, other)


def test_probes_side_by_side_have_each_their_own():
    feeds = np.array([[0.4, 0.1, 0.2], [0.4, 0.1, 0.2], [0.1, 0.4, 0.2], [0.1, 0.4, 0.2]])
    together = inserted(STEADY, feeds)[0]
    for k in range(3):
        episodes = Episodes(1, CONFIG, threads=1, fidelity=STEADY, feed_speed=0.2)
        episodes.reset([0], {0: np.random.default_rng(k)})
        for row in feeds[:, k]:
            episodes.step(CONFIG.actions(np.array([row]), np.array([AIR])).astype(np.float32))
        assert episodes.inserted_length[0] == together[-1, k]


def test_what_is_not_valid_is_refused_by_name():
    for given, message in (
        ({"steady_feed": 0.2}, "^steady_feed needs a time_lapse above 1"),
        ({"time_lapse": 4.0, "steady_feed": 0.0}, "^steady_feed: 0.0 m/s is outside the accepted range 0.001 to 2 m/s"),
        ({"time_lapse": 4.0, "steady_feed": float("nan")}, "^steady_feed: nan m/s is outside"),
    ):
        with pytest.raises(ValueError, match=message):
            resolve_fidelity(given)


def test_a_period_without_time_lapse_is_a_whole_number_of_steps():
    config = TaskConfig(period=1.0001)
    given = {"time_lapse": 1.0001 / 0.25, "steady_feed": 0.2}
    with pytest.raises(ValueError, match=r"config\.period = 1\.0001"):
        Episodes(1, config, threads=1, fidelity=given)
