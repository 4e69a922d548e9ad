"""What the bench of environments measures."""

import pytest

from agents.bench import environments
from agents.bench.environments import Episode, clocked


class Sleeper:
    """It moves the clock on, instead of waiting."""

    now = 0.0

    def sleep(self, seconds, *, fails=False):
        Sleeper.now += seconds
        if fails:
            raise ValueError("fails")
        return seconds


def test_calls_are_clocked_and_return_what_they_did(monkeypatch):
    """Also a call that fails."""
    monkeypatch.setattr(environments.time, "perf_counter", lambda: Sleeper.now)
    plain = Sleeper.sleep
    with clocked(Sleeper, "sleep") as spent:
        assert Sleeper().sleep(2.0) == 2.0
        with pytest.raises(ValueError, match="fails"):
            Sleeper().sleep(1.0, fails=True)
    assert Sleeper.sleep is plain
    assert spent == [2.0, 1.0]


def test_a_method_is_given_back_when_the_context_fails():
    plain = Sleeper.sleep
    with pytest.raises(RuntimeError), clocked(Sleeper, "sleep"):
        raise RuntimeError
    assert Sleeper.sleep is plain


def test_an_episode_is_the_middle_one_of_its_rounds(monkeypatch):
    """One that was held up, and one that was not listened to, do not count."""
    rounds = iter([Episode(9.0, 0.02), Episode(2.0, 0.0), Episode(2.5, 0.03)])
    monkeypatch.setattr(environments, "_insertion", lambda *_: next(rounds))
    assert environments._episode("fast", 1) == Episode(2.5, 0.03)
    assert next(rounds, None) is None


def test_a_share_of_an_insertion_is_heard():
    """Settling included, which is not nothing and not most of it."""
    episode = environments._insertion("fast", 1)
    assert episode.seconds > 0.0
    assert 0.0 < episode.listening < 0.5
