"""The shipped lists of tubes: their sizes, their hash, and limits."""

import gymnasium as gym
import numpy as np
import pytest

from probe_agents.vec_env import ProbeVecEnv
from probe_env import Context, load_contexts, spread_contexts
from probe_env.envs.contexts import SPLIT_SIZES


def test_shipped_lists_have_their_sizes_and_no_overlap(monkeypatch):
    lists = {split: load_contexts(split) for split in SPLIT_SIZES}
    assert {split: len(contexts) for split, contexts in lists.items()} == SPLIT_SIZES
    every = [context for contexts in lists.values() for context in contexts]
    assert len(set(every)) == len(every)
    for split, size in SPLIT_SIZES.items():  # every limit is a prefix
        for limit in (1, 7, size):
            assert spread_contexts(split, limit) == lists[split][:limit]
    assert spread_contexts("test") == lists["test"]
    with pytest.raises(ValueError, match="limit = 49 is outside the accepted range 0 \\(all\\) to 48"):
        spread_contexts("test", 49)
    with pytest.raises(ValueError, match="split = 'exam'"):
        load_contexts("exam")
    load_contexts.cache_clear()
    monkeypatch.setattr("probe_env.envs.contexts.FILE_HASH", "0123")
    with pytest.raises(ValueError, match="was changed"):
        load_contexts("test")


def test_list_in_turn_gives_every_tube_once():
    env, tubes = gym.make("probe_env/Insertion-v1", fidelity="surrogate", contexts="validation", in_turn=True), []
    for k in range(25):
        tubes.append(Context(**env.reset(seed=3 if k == 0 else None)[1]["context"]))
    assert tubes[:24] == list(load_contexts("validation"))
    assert tubes[24] == tubes[0]
    assert Context(**env.reset(seed=3)[1]["context"]) == tubes[0]
    fixed = env.reset(options={"friction": 0.2})[1]["context"]
    assert Context(**fixed) == tubes[1].model_copy(update={"friction": 0.2})


@pytest.mark.parametrize("fidelity", ["fast", "surrogate"])
def test_batch_shares_a_list_in_turn(fidelity):
    """Episodes end at their own times: environment 1 plays tubes 1, 3 and 5, whatever environment 0 does."""
    own = [{"friction": 0.1 + 0.01 * k} for k in range(6)]
    settings = {"fidelity": fidelity, "contexts": own, "in_turn": True, "config": {"settle_time": 1.0}}
    env = gym.make_vec("probe_env/Insertion-v1", num_envs=2, autoreset_mode="Disabled", **settings)

    def frictions(mask, **arguments):
        _, info = env.reset(options={"reset_mask": mask}, **arguments)
        return info["context"]["friction"].round(6).tolist()

    both, second = np.array([True, True]), np.array([False, True])
    assert frictions(both, seed=0) == [0.1, 0.11]
    assert frictions(second)[1] == 0.13
    assert frictions(both) == [0.12, 0.15]
    assert frictions(both) == [0.14, 0.11]
    assert frictions(second, seed=0)[1] == 0.11
    assert frictions(both) == [0.1, 0.13]
    batch = ProbeVecEnv(num_envs=2, **settings)
    batch.seed(1)
    for expected in ([0.1, 0.11], [0.12, 0.13]):
        batch.reset()
        assert [round(info["context"]["friction"], 6) for info in batch.reset_infos] == expected
