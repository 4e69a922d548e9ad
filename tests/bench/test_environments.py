"""What the bench of environments measures."""

import pytest

from agents.bench import environments
from agents.bench.environments import clocked


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
