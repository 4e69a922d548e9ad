"""Headroom: shares of the planner's lead, and the tables of planners beside policies."""

import json

import numpy as np
import pandas as pd
import pytest

from agents.evaluation import headroom
from agents.evaluation.headroom import ALWAYS, SETTINGS, run_headroom, run_settings, shipped_setting
from agents.policies.places import place_of
from agents.policies.planning.planner import PLANNERS
from agents.processes.workers import HERE
from agents.rollouts.statistics import sentences, share_of_lead

MADE_AT = ("0123456789ab", "cdef01234567")
"""Commits of an evaluation that was gone on with."""


def table(rewards: dict[str, list[float]]) -> pd.DataFrame:
    """Episodes with these rewards, a tube each."""
    rows = [
        {
            "policy": policy, "context": k, "seed": 0, "reward": value, "inspection_time_s": 300.0 + k,
            "share_within_limit": 0.9, "lost_drive": False, "diverged": k == 0 and policy == "pi",
            "commit": MADE_AT[k % 2],
        }
        for policy, values in rewards.items() for k, value in enumerate(values)
    ]  # fmt: skip
    return pd.DataFrame(rows)


def test_a_share_of_the_lead_is_of_means_and_its_interval_of_tubes() -> None:
    played = table({"best-schedule": [0.0, 1.0, 2.0], "planner": [10.0, 12.0, 14.0], "pi": [5.0, 6.0, 8.0]})
    share = share_of_lead(played, "pi")
    assert share.mean == pytest.approx(np.mean([5.0, 5.0, 6.0]) / np.mean([10.0, 11.0, 12.0]))
    # of every draw of tubes the share lies between the least and the most of any single tube
    assert 5.0 / 11.0 <= share.low <= share.mean <= share.high <= 0.5
    assert share_of_lead(played, "planner").text() == "1 [1, 1]"
    assert share_of_lead(played, "best-schedule").text() == "0 [0, 0]"
    with pytest.raises(ValueError, match="not run on the same contexts"):
        share_of_lead(played[~((played["policy"] == "pi") & (played["context"] == 2))], "pi")


def test_evaluations_with_a_planner_tell_the_share() -> None:
    played = table({"best-schedule": [0.0, 1.0], "planner": [10.0, 12.0], "pi": [5.0, 6.0]})
    lines = sentences(played, "best-schedule")
    assert "of the lead" not in lines[0]
    assert lines[1].endswith("% of the lead of planner over best-schedule.")
    assert not any("of the lead" in line for line in sentences(played[played["policy"] != "planner"], "best-schedule"))


@pytest.fixture
def plans(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, object]]:
    """What is played: every policy earns its number, and a little more in every tube."""
    seen: list[dict[str, object]] = []

    def run_plan(plan, output, workers):  # type: ignore[no-untyped-def]
        seen.append(dict(plan.policies))
        output.mkdir(parents=True, exist_ok=True)
        tubes = range(len(plan.contexts))
        return table({name: [n + 0.1 * n * k for k in tubes] for n, name in enumerate(plan.policies, 1)})

    monkeypatch.setattr(headroom, "run_plan", run_plan)
    return seen


def test_planners_are_played_beside_what_is_named(plans, tmp_path, capsys) -> None:  # type: ignore[no-untyped-def]
    summary = run_headroom(("pi", "best-schedule"), place_of(None, "test", 3), "fast", tmp_path / "out", HERE)
    assert list(plans[0]) == list(summary["policy"]) == [*ALWAYS, "pi"]
    rows = summary.set_index("policy")
    assert rows.loc["planner", "share"] == 1.0
    assert rows.loc["best-schedule", "gain"] == 0.0
    assert rows.loc["pi", "gain"] == pytest.approx(1.1)
    assert rows.loc["pi", "diverged"] == 1
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"headroom.csv", "headroom.png", "provenance.json"}
    record = json.loads((tmp_path / "out" / "provenance.json").read_text())
    assert record["fidelity"]["time_lapse"] == 4.0
    assert record["commit"] == ", ".join(MADE_AT)
    assert "Headroom, 3 tubes" in capsys.readouterr().out


def test_settings_go_around_the_one_that_ships(plans, tmp_path) -> None:  # type: ignore[no-untyped-def]
    summary = run_settings(place_of(None, "train", 2), "fast", tmp_path, HERE)
    assert shipped_setting() in SETTINGS
    assert summary.loc[summary["gain"] == 0.0, "copies"].tolist() == [shipped_setting().copies]
    assert len({setting.name for setting in SETTINGS}) == len(SETTINGS) == len(summary)
    changed = [sum(a != b for a, b in zip(s, shipped_setting(), strict=True)) for s in SETTINGS]
    assert sorted(changed) == [0] + [1] * (len(SETTINGS) - 1)  # one thing at a time
    assert (tmp_path / "settings.png").stat().st_size > 10_000
    assert json.loads((tmp_path / "settings-provenance.json").read_text())["commit"] == ", ".join(MADE_AT)
    assert PLANNERS["planner"] == {}  # as the class has it
