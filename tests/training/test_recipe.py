"""The recipe of the README runs as printed and reproduces its table."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from oracles.scatter import CHANCE
from scipy.stats import t

from probe_env import load_contexts

ROOT = Path(__file__).parents[2]
STORED = ROOT / "results" / "learning" / "curve.csv"


@pytest.mark.slow
@pytest.mark.long
def test_recipe_of_the_readme_reproduces_its_table(monkeypatch, tmp_path, capsys):
    """Another processor gives another sample: the bound is Student's t for one more training seed beside the five."""
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    names = {"__name__": "example"}
    exec(compile(example, "README.md", "exec"), names)
    table, rows = names["table"], pd.read_csv(STORED)
    tubes = [tube.friction for tube in load_contexts("test")[:24]]
    for policy in ("mine", "best-schedule"):
        assert table.loc[table["policy"] == policy, "friction"].tolist() == tubes
    seeds = rows.loc[(rows["recipe"] == "ppo") & (rows["steps"] == 50_000), "reward"]
    reward = table.groupby("policy")["reward"].mean()
    spread = seeds.std(ddof=1) * np.sqrt(1.0 + 1.0 / len(seeds))
    assert abs(reward["mine"] - seeds.mean()) < t.isf(0.5 * CHANCE, len(seeds) - 1) * spread
    assert reward["mine"] > reward["best-schedule"]
    assert re.search(r"mine - best-schedule: \S+ \[\S+, \S+\]", capsys.readouterr().out)
