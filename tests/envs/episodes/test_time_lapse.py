"""Time-lapse at slow and steady feed only: there equal to `fast`, elsewhere to `standard`, bit for bit."""

import numpy as np
import pytest

from probe_env.envs.episodes import Episodes
from probe_env.envs.task.config import TaskConfig
from probe_env.fidelity import Fidelity, resolve_fidelity

CONFIG = TaskConfig()
STEADY = Fidelity(time_lapse=4.0, steady_feed=0.2)


def inserted(fidelity, feeds, first=0):
    """Inserted lengths (periods + 1, N) [m] and observations (periods, N, d) with feeds (periods, N) [m/s]."""
    count = len(feeds[0])
    episodes = Episodes(count, CONFIG, threads=1, fidelity=fidelity, feed_speed=0.2)
    episodes.reset(range(count), {k: np.random.default_rng(first + k) for k in range(count)})
    lengths, observations = [episodes.inserted_length], []
    for row in feeds:
        step = episodes.step(CONFIG.actions(np.array(row), np.full(count, 0.02)).astype(np.float32))
        lengths.append(episodes.inserted_length)
        observations.append(step.observation)
    return np.array(lengths), np.array(observations)


def test_steady_feed_equals_fast_and_any_other_standard():
    for fidelity, feeds in (("fast", [[0.2], [0.16], [0.12], [0.12]]), ("standard", [[0.4], [0.4], [0.3], [0.1]])):
        for one, other in zip(inserted(STEADY, feeds), inserted(fidelity, feeds), strict=True):
            np.testing.assert_array_equal(one, other)


def test_probes_of_a_batch_have_their_own_time_lapse():
    feeds = np.array([[0.4, 0.1, 0.2], [0.4, 0.1, 0.2], [0.1, 0.4, 0.2], [0.1, 0.4, 0.2]])
    together = inserted(STEADY, feeds)[0]
    for k in range(3):
        assert inserted(STEADY, feeds[:, [k]], first=k)[0][-1, 0] == together[-1, k]


def test_invalid_settings_are_named():
    for settings, message in (
        ({"steady_feed": 0.2}, "^steady_feed needs a time_lapse above 1"),
        ({"time_lapse": 4.0, "steady_feed": 0.0}, "^steady_feed: 0.0 m/s is outside the accepted range 0.001 to 2 m/s"),
        ({"time_lapse": 4.0, "steady_feed": float("nan")}, "^steady_feed: nan m/s is outside"),
    ):
        with pytest.raises(ValueError, match=message):
            resolve_fidelity(settings)


def test_a_period_without_time_lapse_is_a_whole_number_of_steps():
    for config, settings in (
        (TaskConfig(period=1.0001), {"time_lapse": 1.0001 / 0.25, "steady_feed": 0.2}),
        (TaskConfig(period=0.0125, passes="both"), {"method": "imex", "time_step": 2e-4, "time_lapse": 2.5}),
    ):
        with pytest.raises(ValueError, match=rf"config\.period = {config.period} s is not a whole number"):
            Episodes(1, config, threads=1, fidelity=settings)
