"""The checks of the solver on short insertions, and their words on tables whose answer is known."""

from dataclasses import replace

import pandas as pd
import pytest

from agents.evaluation.fidelity_check import (
    check_acting,
    check_half_step,
    check_replayed,
    differences,
    replayed,
    report_checks,
)
from agents.policies.fixed import Constant
from agents.records.columns import kpis_of
from agents.rollouts.plan import Plan, run_plan
from probe_env import Fidelity, load_contexts
from probe_env.envs.task import TaskConfig

CONFIG = TaskConfig(time_limit=3.0, settle_time=0.5)


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory):
    policies = {"slow": Constant(CONFIG, feed_speed=0.1), "fast": Constant(CONFIG, feed_speed=0.4)}
    plan = Plan(policies, load_contexts("validation")[:2], (0,), CONFIG, Fidelity(time_lapse=4.0))
    output = tmp_path_factory.mktemp("evaluation")
    return plan, run_plan(plan, output, progress=False), output


def test_half_the_step_changes_little_before_the_probe_rings(evaluated):
    plan, table, output = evaluated
    checks = check_half_step(plan, table, output).set_index(["policy", "kpi"])
    assert (checks["rank"] == checks["rank_before"]).all()
    assert abs(checks.loc[("fast", "inspected_share"), "mean"]) < 1e-6
    assert abs(checks.loc[("fast", "radial_rms_m"), "mean"]) < 1e-6
    assert (output / "half-step" / "episodes.csv").exists()


def finer(plan):
    return replace(plan, fidelity=Fidelity(method="superelement", time_step=1e-4, time_lapse=4.0))


def test_a_finer_fidelity_replays_feed_and_air_over_length(evaluated):
    plan, table, output = evaluated
    profile = pd.read_parquet(output / "profile.parquet")
    schedule = replayed(profile, "fast", 1, 0)
    assert schedule.position == (5.5, 6.5)
    assert schedule.at(5.5)[0] == pytest.approx(0.4, rel=0.2)
    checks = check_replayed(finer(plan), table, profile, output).set_index(["policy", "kpi"])
    assert (checks["rank"] == checks["rank_before"]).all()
    assert abs(checks.loc[("fast", "inspected_share"), "mean"]) < 0.02
    with pytest.raises(ValueError, match="no profile of fast on context 7"):
        replayed(profile, "fast", 7, 0)


def test_with_a_finer_fidelity_the_policies_act_themselves(evaluated, tmp_path, monkeypatch):
    """The policies are asked when they act, and not when what they did is replayed."""
    plan, table, stored = evaluated
    asked = []
    act = Constant.predict
    monkeypatch.setattr(Constant, "predict", lambda self, *given, **more: asked.append(1) or act(self, *given, **more))
    check_replayed(finer(plan), table, pd.read_parquet(stored / "profile.parquet"), tmp_path)
    assert not asked
    checks = check_acting(finer(plan), table, tmp_path).set_index(["policy", "kpi"])
    assert len(asked) == 2 * 2 * 3  # policies, contexts, periods
    assert (checks["rank"] == checks["rank_before"]).all()
    assert checks.loc[("fast", "air_m3"), "mean"] == pytest.approx(0.0, abs=1e-9)
    episodes = pd.read_csv(tmp_path / "finer-acting" / "episodes.csv")
    assert set(episodes["policy"]) == {"slow", "fast"}
    assert set(episodes["context"]) == {0, 1}


def test_words_name_what_moved_and_whether_the_ranking_stays(evaluated, tmp_path, capsys):
    _, table, _ = evaluated
    best = table.groupby("policy")["reward"].mean().idxmax()
    same = differences("same", table, table)
    assert set(same["kpi"]) == set(kpis_of(table.columns))
    moved = table.assign(reward=-table["reward"] - 5.0)
    report_checks([same, differences("moved", moved, table)], tmp_path)
    printed = capsys.readouterr().out
    assert f"same: the ranking of 2 policies by reward stays (Kendall's tau 1.00): {best} " in printed
    assert "moved: the ranking of 2 policies by reward changes (Kendall's tau -1.00)" in printed
    assert "changes by" in printed
    assert len(pd.read_csv(tmp_path / "fidelity.csv")) == 2 * 2 * len(kpis_of(table.columns))
