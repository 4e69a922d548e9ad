"""The shipped lists of tubes: every prefix, and so every limit, represents the whole list."""

from collections import Counter

import numpy as np
import pytest
from scipy.stats import ks_1samp, rankdata, uniform

from agents.studies.shipped.vibration_map import HELD_OUT
from probe_env import load_contexts, spread_contexts
from probe_env.envs.contexts import HELIX_DIAMETERS, SPLIT_SIZES


def test_lists_have_their_sizes_do_not_overlap_and_are_those_that_ship(monkeypatch):
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


def test_every_limit_is_a_prefix_balanced_over_diameters_and_spread_over_friction():
    """As van der Corput's sequence, whose star discrepancy is at most (log2(n) / 3 + 1) / n (Bejian and Faure).

    Of the ranks, that is against the list's own frictions; a random choice of n has some 0.9 / sqrt(n).
    """
    failures = []
    for split, size in SPLIT_SIZES.items():
        listed = load_contexts(split)
        places = (rankdata([context.friction for context in listed]) - 0.5) / size
        for limit in range(1, size + 1):
            contexts = spread_contexts(split, limit)
            each = [sum(context.helix_diameter == d for context in contexts) for d in HELIX_DIAMETERS]
            discrepancy = ks_1samp(places[:limit], uniform.cdf).statistic
            is_prefix = contexts == listed[:limit] and sum(each) == limit
            if not is_prefix or max(each) - min(each) > 1 or discrepancy > (np.log2(limit) / 3.0 + 1.0) / limit:
                failures.append((split, limit, each, discrepancy))
    assert not failures
    assert spread_contexts("test") == load_contexts("test")
    with pytest.raises(ValueError, match="limit = 49 is outside the accepted range 0 \\(all\\) to 48"):
        spread_contexts("test", 49)


def test_the_tubes_that_the_map_is_tested_on_and_those_it_is_fitted_to_are_balanced():
    listed = load_contexts("train")
    for part, each in ((listed[:HELD_OUT], 2), (listed[HELD_OUT:], 14)):
        assert Counter(context.helix_diameter for context in part) == dict.fromkeys(HELIX_DIAMETERS, each)
