"""The anchors of the sensor: what a ranking by what is found hangs on."""

import json

import numpy as np
import pandas as pd
import pytest

from agents.detection import anchors
from agents.detection.anchors import A90, ANCHORS, USUAL, agreement, cells, run_anchors, scaled, sentences
from agents.policies.places import place_of
from agents.processes.workers import HERE
from probe_env.inspection.detection import DEPTHS, depths_found
from probe_env.inspection.meter import FREQUENCY, snr_of_groove
from probe_env.inspection.sensor import Sensor


def snr(sensor: Sensor, rms: float, feed: float = 0.2) -> float:
    """With motion that is white to 50 Hz."""
    density = np.where(FREQUENCY <= 50.0, rms**2 / 50.0, 0.0)[None]
    return float(snr_of_groove(sensor, np.array([feed]), density)[0])


@pytest.mark.parametrize("rms", [0.0, 2e-5, 2e-4])
def test_both_anchors_together_are_a_scale(rms: float) -> None:
    sensor = Sensor()
    for factor in (0.5, 2.0):
        assert snr(scaled(sensor, factor, factor), rms) == pytest.approx(factor * snr(sensor, rms), rel=1e-12)


def test_each_anchor_moves_its_own_end() -> None:
    sensor = Sensor()
    quiet, shaken = scaled(sensor, 2.0, 1.0), scaled(sensor, 1.0, 0.5)
    assert snr(quiet, 0.0) / snr(sensor, 0.0) == pytest.approx(2.0)
    assert snr(shaken, 0.0) == snr(sensor, 0.0)
    assert snr(shaken, 1e-3) / snr(sensor, 1e-3) == pytest.approx(0.5, rel=0.1)  # electronics are a rest of it
    for factors in ANCHORS.values():
        scaled(sensor, *factors)
    with pytest.raises(ValueError, match="must be below quiet_snr"):
        scaled(sensor, 0.3, 1.0)


MADE_AT = ("0123456789ab", "cdef01234567")


def episodes(policy: str, noise: float, sensor: Sensor) -> pd.DataFrame:
    """Two tubes whose curve of detection is a step at what is found at this noise."""
    depth = 0.2 * noise / sensor.quiet_snr
    row = {f"pod_at_{100 * d:.3g}_percent_wall": float(d >= depth) for d in DEPTHS}
    assert depths_found(np.array([list(row.values())]), 0.9)[0] <= 1.0
    kpis = {"reward": -noise, "inspection_time_s": 100.0, "share_within_limit": 1.0, "length_with_snr_over_3_m": 55.0}
    return pd.DataFrame(
        [{"policy": policy, "context": k, "seed": 0, "commit": MADE_AT[k]} | kpis | row for k in range(2)]
    )


def test_a_table_has_every_policy_with_every_anchor(tmp_path, monkeypatch, capsys) -> None:  # type: ignore[no-untyped-def]
    noises, seen = {"constant": 9.0, "pi": 3.0, "slow": 5.0}, []

    def run_plan(plan, output, workers):  # type: ignore[no-untyped-def]
        seen.append((output.name, plan.config.sensor.quiet_snr, plan.config.sensor.shaken_snr))
        return pd.concat([episodes(name, noises[name], plan.config.sensor) for name in plan.policies])

    monkeypatch.setattr(anchors, "run_plan", run_plan)
    summary = run_anchors(tuple(noises), place_of(None, "test", 2), "fast", tmp_path, HERE)
    assert [entry[1:] for entry in seen] == [(7.5 * quiet, 3.0 * shaken) for quiet, shaken in ANCHORS.values()]
    assert len({name for name, _, _ in seen}) == len(ANCHORS)
    assert json.loads((tmp_path / "provenance.json").read_text())["commit"] == ", ".join(MADE_AT)
    by_policy = summary.set_index("policy")
    assert by_policy[f"{A90}, {USUAL}"].idxmin() == "pi"
    assert (by_policy[f"{A90}, quiet doubled"] < by_policy[f"{A90}, {USUAL}"]).all()
    assert [row[0] for row in cells(summary)] == ["pi", "slow", "constant"]
    others = (*list(ANCHORS)[1:], "reward in millimetres")
    assert agreement(summary) == {what: pytest.approx(1.0) for what in others}
    pairs = pd.read_csv(tmp_path / "pairs.csv")
    assert len(pairs) == 3 * len(ANCHORS)
    assert "none stand two places" in sentences(summary, pairs)[0]
    assert "3 are clearly apart" in sentences(summary, pairs)[2]
    assert "pi" in capsys.readouterr().out
    with pytest.raises(ValueError, match="a ranking needs two"):
        run_anchors(("pi",), place_of(None, "test", 2), "fast", tmp_path / "other", HERE)
    assert not (tmp_path / "other").exists()
