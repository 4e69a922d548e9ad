"""How gently feed has to turn round: what is played, and the table that is made of it."""

import json

import numpy as np
import pandas as pd
import pytest

from agents.evaluation import turning
from agents.evaluation.turning import DEPTH, FIDELITIES, HEADER, POLICIES, RAMPS, cells, run_study
from agents.processes.workers import HERE
from probe_env.inspection.detection import DEPTHS, depth_found, pod_gaussian
from probe_env.inspection.tally import POD_NAMES


def curve(policy: str, ramp: float, fidelity: str, tube: int) -> np.ndarray:
    """What is found: the more, the gentler, the less time-lapse, the later the policy and the tube."""
    snr = (2.0 + POLICIES.index(policy)) * (2.0 - ramp) * (1.0 + 0.5 * FIDELITIES.index(fidelity)) * (1.0 + 0.1 * tube)
    return pod_gaussian(snr * DEPTHS / 0.2, 4.6)


@pytest.fixture
def plans(monkeypatch: pytest.MonkeyPatch) -> list[tuple[float, str]]:
    """Ramp and fidelity of each plan."""
    seen: list[tuple[float, str]] = []

    def run_plan(plan, output, workers):  # type: ignore[no-untyped-def]
        assert (plan.config.passes, plan.config.inspects) == ("both", "back")
        key = (plan.config.ramp, {4.0: "fast", 1.0: "unlapsed"}[plan.fidelity.time_lapse])
        seen.append(key)
        output.mkdir(parents=True)  # a folder of its own
        rows = []
        for name in plan.policies:
            for tube in range(len(plan.contexts)):
                pod = curve(name, *key, tube)
                row = {"policy": name, "context": tube, "seed": 0, "commit": "0123456789ab", "reward": 1.0}
                row |= {"inspection_time_s": 300.0 / key[0], "share_within_limit": 0.9}
                row["a90_percent_wall"] = 100.0 * depth_found(pod, 0.9)
                rows.append(row | dict(zip(POD_NAMES, pod, strict=True)))
        return pd.DataFrame(rows)

    monkeypatch.setattr(turning, "run_plan", run_plan)
    return seen


def test_every_ramp_is_played_with_and_without_time_lapse(plans, tmp_path):
    summary = run_study(3, tmp_path, HERE)
    assert plans == [(ramp, fidelity) for fidelity in FIDELITIES for ramp in RAMPS]
    assert len(summary) == len(POLICIES) * len(RAMPS) * len(FIDELITIES)
    for row in summary.to_dict("records"):

        def depths(ramp, fidelity, row=row):
            return np.array([100.0 * depth_found(curve(row["policy"], ramp, fidelity, k), 0.9) for k in range(3)])

        here = depths(row["ramp"], row["fidelity"])
        assert here.min() <= row[DEPTH] <= here.max()
        assert row["a90_percent_wall"] == pytest.approx(here.mean())
        assert row["by_ramp"] == pytest.approx((here - depths(RAMPS[0], row["fidelity"])).mean())
        lapsed = here - depths(row["ramp"], "unlapsed")
        assert row["by_time_lapse"] == pytest.approx(lapsed.mean())
        assert lapsed.min() - 1e-9 <= row["by_time_lapse_low"] <= row["by_time_lapse_high"] <= lapsed.max() + 1e-9
    stored = pd.read_csv(tmp_path / "turning.csv")
    assert cells(stored) == cells(summary)
    assert [row[:2] for row in cells(summary)] == [(policy, f"{ramp:g}") for policy in POLICIES for ramp in RAMPS]
    assert {len(row) for row in cells(summary)} == {len(HEADER)}
    assert json.loads((tmp_path / "provenance.json").read_text())["limit"] == 3
