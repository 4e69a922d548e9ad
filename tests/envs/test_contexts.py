"""The shipped lists of tubes: their sizes, their hash, and limits."""

import pytest

from probe_env import load_contexts, spread_contexts
from probe_env.envs.contexts import SPLIT_SIZES


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


def test_every_limit_is_a_prefix():
    for split, size in SPLIT_SIZES.items():
        for limit in (1, 7, size):
            assert spread_contexts(split, limit) == load_contexts(split)[:limit]
    assert spread_contexts("test") == load_contexts("test")
    with pytest.raises(ValueError, match="limit = 49 is outside the accepted range 0 \\(all\\) to 48"):
        spread_contexts("test", 49)
