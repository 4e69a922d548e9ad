"""What the bench of environments measures."""

import time

import pytest

from agents.bench.environments import clocked


class Sleeper:
    def sleep(self, seconds, *, fails=False):
        time.sleep(seconds)
        if fails:
            raise ValueError("fails")
        return seconds


def test_calls_are_clocked_and_return_what_they_did():
    """Also a call that fails; a sleep is never shorter than it says."""
    plain = Sleeper.sleep
    with clocked(Sleeper, "sleep") as spent:
        assert Sleeper().sleep(0.02) == 0.02
        with pytest.raises(ValueError, match="fails"):
            Sleeper().sleep(0.01, fails=True)
    assert Sleeper.sleep is plain
    assert len(spent) == 2
    assert spent[0] >= 0.02
    assert spent[1] >= 0.01


def test_a_method_is_given_back_when_the_context_fails():
    plain = Sleeper.sleep
    with pytest.raises(RuntimeError), clocked(Sleeper, "sleep"):
        raise RuntimeError
    assert Sleeper.sleep is plain
