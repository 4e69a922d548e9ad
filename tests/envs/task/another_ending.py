"""Edits the rules as a newcomer would: probes jam after two seconds. Looks for that wherever there are endings."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pandas as pd

RULES = "probe_env.envs.task.rules"
sys.path.insert(0, str(Path.cwd()))


class Edited:
    """Finds and loads the one module that is edited."""

    def find_spec(self, name, path=None, target=None):
        return importlib.util.spec_from_loader(name, self) if name == RULES else None

    def create_module(self, spec):
        return None

    def exec_module(self, module):
        source = Path(*RULES.split(".")).with_suffix(".py").read_text(encoding="utf-8")
        for old, new in (
            ("    out_of_time: BoolArray", "    jammed: BoolArray\n    out_of_time: BoolArray"),
            ("diverged & stepped, stepped &", "diverged & stepped, stepped & (time >= 2.0), stepped &"),
        ):
            assert source.count(old) == 1, old
            source = source.replace(old, new)
        exec(source, module.__dict__)


def episodes_end(kind, **settings):
    """Played to the end, it is in the KPIs; the last info."""
    episodes = kind(1, TaskConfig(), **settings)
    episodes.reset([0], {0: np.random.default_rng(0)})
    while episodes.running.any():
        step = episodes.step(np.zeros((1, 2)))
    assert step.terminated[0]
    kpis = step.infos[0]["episode_kpis"]
    assert [kpis[name] for name in (*FAILURES, "complete")] == [0.0, 0.0, 1.0, 0.0], kind
    return step.infos[0]


def trials_are_judged():
    row = np.ones((1, 2))
    failed = {name: np.array([name == "jammed"]) for name in FAILURES}
    trial = Trial(20.0 * row, 0.2 * row, 0.02 * row, 1e-5 * row, 4.0 * row, row > 0.0, failed)
    assert judge([Design()], trial, TaskConfig())[1]["jammed"].tolist() == [1.0]


def tables_count():
    """In a table that has it, and in one that was stored before there was this ending."""
    stored = read_episodes(Path("results/evaluation/episodes.csv"))
    stored = stored[stored["policy"] == stored["policy"].iloc[0]].reset_index(drop=True)
    assert "jammed" not in stored
    assert "jammed" in EPISODES_NEWER
    assert endings(stored)["jammed"].tolist() == [0]
    jammed = (stored.index == 0).astype(float)
    table = stored.assign(jammed=jammed, complete=1.0 - jammed)
    (counts,) = endings(table).to_dict("records")
    assert ended(counts) == f"{len(table) - 1} of {len(table)} complete, 1 jammed"
    print_summary(table, table["policy"].iloc[0])
    disturbed = table.assign(axis=NOMINAL, value="", **dict.fromkeys(COST_KPIS, 0.0))
    assert summary_of(disturbed)["jammed"].tolist() == [1.0 / len(table)]


def comparisons_count():
    for name in ("summarise", "header", "cells"):  # means of KPIs, which are not looked at here
        setattr(compare, name, lambda table: [])
    flags = dict.fromkeys(FAILURES, 0.0) | {"jammed": 1.0}
    compare.print_comparison(pd.DataFrame({"design": ["bent"], "context": [0], **flags}))


sys.meta_path.insert(0, Edited())
from agents.design import compare  # noqa: E402
from agents.evaluation.page.tables import ended  # noqa: E402
from agents.evaluation.report import print_summary  # noqa: E402
from agents.records.columns import COST_KPIS  # noqa: E402
from agents.records.tables import EPISODES_NEWER, read_episodes  # noqa: E402
from agents.robustness.axes import NOMINAL  # noqa: E402
from agents.robustness.study import summary_of  # noqa: E402
from agents.rollouts.statistics import endings  # noqa: E402
from agents.worlds.map_episodes import MapEpisodes  # noqa: E402
from probe_env import Design  # noqa: E402
from probe_env.envs.episodes import Episodes  # noqa: E402
from probe_env.envs.task import FAILURES, TaskConfig  # noqa: E402
from probe_env.envs.trials import Trial, judge  # noqa: E402

assert FAILURES[-1] == "jammed"
last = episodes_end(Episodes, fidelity="fast")
assert [name for name in FAILURES if last[name]] == ["jammed"]
episodes_end(MapEpisodes)
trials_are_judged()
tables_count()
comparisons_count()
