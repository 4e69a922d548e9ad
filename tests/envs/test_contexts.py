"""The shipped lists of tubes: every prefix, and so every limit, stands for the whole list."""

from collections import Counter

import numpy as np
import pytest
from scipy.stats import ks_1samp, rankdata, uniform

from agents.studies.shipped.vibration_map import HELD_OUT
from probe_env import load_contexts, spread_contexts
from probe_env.envs.contexts import FILE, HELIX_DIAMETERS, SPLIT_SIZES, make_file

LIMITS = [(split, limit) for split, size in SPLIT_SIZES.items() for limit in range(1, size + 1)]


def test_shipped_contexts_are_what_made_them_and_lists_do_not_overlap(monkeypatch):
    assert FILE.read_text() == make_file()
    lists = {split: load_contexts(split) for split in SPLIT_SIZES}
    assert {split: len(contexts) for split, contexts in lists.items()} == SPLIT_SIZES
    every = [context for contexts in lists.values() for context in contexts]
    assert len(set(every)) == len(every)
    with pytest.raises(ValueError, match="split = 'exam'"):
        load_contexts("exam")
    load_contexts.cache_clear()
    monkeypatch.setattr("probe_env.envs.contexts.FILE_HASH", "0123")
    with pytest.raises(ValueError, match="was changed"):
        load_contexts("test")


def test_there_are_168_limits():
    assert len(LIMITS) == 168


@pytest.mark.parametrize(("split", "limit"), LIMITS)
def test_every_limit_has_all_helix_diameters_equally_often(split, limit):
    counts = Counter(context.helix_diameter for context in spread_contexts(split, limit))
    each = [counts[d] for d in HELIX_DIAMETERS]
    assert sum(each) == limit
    assert max(each) - min(each) <= 1


@pytest.mark.parametrize(("split", "limit"), LIMITS)
def test_every_limit_is_spread_over_friction(split, limit):
    """Like van der Corput's sequence, whose star discrepancy is at most (log2(n) / 3 + 1) / n (Bejian and Faure).

    Taken of the ranks, that is against the list's own frictions; a random choice of n has some 0.9 / sqrt(n), and the
    strided one of a list sorted by diameter had none of this. The largest gap a prefix may leave follows.
    """
    listed = load_contexts(split)
    places = (rankdata([context.friction for context in listed]) - 0.5) / len(listed)
    discrepancy = ks_1samp(places[:limit], uniform.cdf).statistic
    assert discrepancy <= (np.log2(limit) / 3.0 + 1.0) / limit


def test_a_limit_is_a_prefix_so_that_a_context_keeps_its_place():
    listed = load_contexts("test")
    assert spread_contexts("test") == listed
    assert all(spread_contexts("test", n) == listed[:n] for n in range(1, len(listed) + 1))
    with pytest.raises(ValueError, match="limit = 49 is outside the accepted range 0 \\(all\\) to 48"):
        spread_contexts("test", 49)


def test_the_tubes_that_the_map_is_tested_on_and_those_it_is_fitted_to_are_balanced():
    listed = load_contexts("train")
    for part, each in ((listed[:HELD_OUT], 2), (listed[HELD_OUT:], 14)):
        assert Counter(context.helix_diameter for context in part) == dict.fromkeys(HELIX_DIAMETERS, each)
