"""Both passes: what is played, and the table that is made of it."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from agents.evaluation import passes
from agents.evaluation.passes import (
    BESIDE,
    DEPTH,
    FOUND,
    PLAYED,
    POLICIES,
    PROBES,
    REWARDS,
    found_cells,
    most_reward,
    reward_cells,
    run_study,
)
from agents.policies.places import both_ways, place_of
from agents.processes.workers import HERE
from agents.records.tables import read_episodes
from probe_env.envs.episodes.judge import judged_beside
from probe_env.inspection.detection import DEPTHS, depth_found, pod_gaussian
from probe_env.inspection.tally import POD_NAMES

COUNTS = {"in": 2.0, "back": 3.0, "best": 4.0}
"""S/N of a 20 % groove, for what counts."""


def curve(policy: str, inspects: str, tube: int) -> np.ndarray:
    """What a policy finds in a tube: more of them the later in the list."""
    return pod_gaussian(COUNTS[inspects] * (1.0 + 0.1 * POLICIES.index(policy) + 0.05 * tube) * DEPTHS / 0.2, 4.6)


@pytest.fixture
def plans(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, float]]:
    """Probe and guide float's diameter of each plan; a policy earns its number and tube by what counts."""
    seen: list[tuple[str, float]] = []

    def run_plan(plan, output, workers):  # type: ignore[no-untyped-def]
        assert (plan.config.passes, plan.config.inspects) == ("both", PLAYED)
        seen.append((output.name, plan.config.scene.probe.guide_float_diameter))
        output.mkdir(parents=True, exist_ok=True)
        rows = []
        for k, name in enumerate(plan.policies):
            for tube in range(len(plan.contexts)):
                row = {"policy": name, "context": tube, "seed": 0, "commit": "0123456789ab", "share_within_limit": 0.9}
                row |= {"inspection_time_s": 300.0}
                for look in COUNTS:
                    judged = {"reward": COUNTS[look] * (k + tube)}
                    judged |= dict(zip(POD_NAMES, curve(name, look, tube), strict=True))
                    row |= judged if look == PLAYED else judged_beside(look, judged)
                rows.append(row)
        return pd.DataFrame(rows)

    monkeypatch.setattr(passes, "run_plan", run_plan)
    return seen


def test_every_policy_is_judged_by_every_way_with_both_probes(plans, tmp_path):
    summary = run_study(3, "fast", tmp_path, HERE)
    assert [probe for probe, _ in plans] == list(PROBES)  # each is played once, and judged by every look
    assert len({diameter for _, diameter in plans}) == 2
    assert len(summary) == len(PROBES) * len(POLICIES) * 3
    for row in summary.to_dict("records"):
        curves = np.array([curve(row["policy"], row["inspects"], tube) for tube in range(3)])
        single = [100.0 * depth_found(one, 0.9) for one in curves]
        assert min(single) <= row[DEPTH] <= max(single)
        assert row[DEPTH] >= 100.0 * depth_found(curves.mean(axis=0), 0.9)
        gains = [
            COUNTS[row["inspects"]] * (POLICIES.index(row["policy"]) + k) - 2.0 * (POLICIES.index(BESIDE) + k)
            for k in range(3)
        ]
        assert row["gain"] == pytest.approx(np.mean(gains))
        assert min(gains) - 1e-9 <= row["gain_low"] <= row["gain_high"] <= max(gains) + 1e-9
    by_way = summary[(summary["probe"] == "original") & (summary["policy"] == BESIDE)].set_index("inspects")[DEPTH]
    assert by_way["best"] < by_way["back"] < by_way["in"]
    assert json.loads((tmp_path / "provenance.json").read_text())["limit"] == 3
    stored = pd.read_csv(tmp_path / "passes.csv")
    depths, rewards = found_cells(stored), reward_cells(stored)
    assert depths == found_cells(summary)
    assert rewards == reward_cells(summary)
    assert len(depths) == len(rewards) == len(PROBES) * len(POLICIES)
    assert {len(row) for row in depths} == {len(FOUND)}
    assert {len(row) for row in rewards} == {len(REWARDS)}
    for row in depths:
        assert [float(cell) for cell in row[3:6]] == sorted((float(cell) for cell in row[3:6]), reverse=True)
    beside = rewards[POLICIES.index(BESIDE)]
    assert beside[:2] == (PROBES[0], BESIDE)
    assert beside[2].endswith("(+0.0 [0.0, 0.0])")
    assert beside[4].startswith(f"{COUNTS['best'] * (POLICIES.index(BESIDE) + 1.0):.1f} (")


def test_nothing_that_was_played_earns_more_than_the_most():
    """55 m for 27 = 55 - 0.1 * 275 s - 0.2 * 2.3 m3, by hand; and above every stored episode."""
    config = both_ways(place_of(None, "test", 1), PLAYED).config
    assert most_reward(config, 55.0) == pytest.approx(55.0 - 0.1 * 275.0 - 0.2 * 275.0 / 120.0)
    for metres, earned in (
        read_episodes(Path("results/passes/episodes.csv")).groupby("inspected_m")["reward"].max().items()
    ):
        assert earned < most_reward(config, float(metres))
