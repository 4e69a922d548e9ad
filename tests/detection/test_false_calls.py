"""Calls where there is no flaw: counted in noise whose calls are known, and over insertions that are stored."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.stats import poisson

from agents.cli import main
from agents.detection import false_calls
from agents.detection.false_calls import (
    DEPTH,
    DEPTH_OF,
    DRAWS,
    Count,
    cells,
    heights,
    raised,
    run_false_calls,
    summarise,
    tally_of,
)
from agents.detection.passage import insert
from agents.policies.catalogue import make_policy
from agents.policies.places import place_of
from agents.processes.workers import HERE
from agents.records.journal import Journal
from agents.rollouts.plan import Plan
from probe_env import TaskConfig
from probe_env.inspection.channels import Passage
from probe_env.inspection.detection import threshold
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.spectrum import COUNT, FREQUENCY
from probe_env.inspection.tally import DetectionTally

CHANCE = 1e-4
PLACE = place_of(None, "test", 2)


def still(radial):
    """60 m at 0.2 m/s with a motion of which the meter heard nothing."""
    time = np.arange(1, len(radial) + 1) * 1e-3
    silent = np.zeros((len(radial) // 1000, len(FREQUENCY)))
    return Passage(time, 0.2 * time, np.full(len(time), 0.2), radial, silent, 1000)


def test_electronics_alone_are_called_as_often_as_was_promised():
    """Five calls a tube in 20 draws: a Poisson number around 100, less those that share a width with another.

    Within a width of a call there is another with a chance of 5 x 0.02 / 60, 0.2 %.
    """
    sensor, draws = Sensor(false_calls=5.0), 20
    z, rng = threshold(sensor, 60.0), np.random.default_rng(0)
    called = len(heights(sensor, still(np.zeros(300_000)), 0.0242, z, draws, rng))
    assert poisson.ppf(0.5 * CHANCE, 0.99 * 100.0) <= called <= poisson.isf(0.5 * CHANCE, 100.0)


def test_a_spike_that_the_meter_missed_is_called_in_every_draw():
    """A flaw's shape of 1 mm at 30 m, 22 deviations high: none of the noise's hides it, nor reaches 15."""
    sensor, radial = Sensor(), np.zeros(300_000)
    x = 2.0 * np.pi * (0.2e-3 * np.arange(-200, 200)) / sensor.flaw_width
    radial[149_800:150_200] = -1e-3 * x * np.exp(0.5 - 0.5 * x**2)
    seen = np.array(heights(sensor, still(radial), 0.0242, 4.0, 5, np.random.default_rng(0)))
    assert 1e-3 * sensor.seen_gain * sensor.quiet_snr == pytest.approx(22.0, abs=0.1)
    assert (seen > 15.0).sum() == 5


def test_the_rise_that_keeps_a_promise():
    """Two tubes of ten draws: 0.25 calls a tube are five, so the sixth highest of those above must not be called."""
    above = [np.array([0.9, 0.8, 0.7, -0.5]), np.array([0.6, 0.5, 0.4, 0.3])]
    rise = raised(above, 0.25, 10)
    assert rise == 0.4
    assert sum((part > rise).sum() for part in above) == 5
    assert raised(above, 1.0, 10) == 0.0  # fewer were counted than promised
    assert raised([np.array([-0.2, 0.1]), np.array([])], 0.05, 10) == 0.0  # the second is below its threshold anyway


def test_a_tally_is_that_which_was_stored():
    rng, tally = np.random.default_rng(0), DetectionTally(Sensor())
    for _ in range(200):
        tally.add(0.2, rng.uniform(2.0, 9.0), 0.6, 0.1, rng.standard_t(3, COUNT))
    stored = {name: list(map(float, getattr(tally, name))) for name in false_calls.FIELDS}
    same = tally_of(Sensor(), json.loads(json.dumps(stored)))
    assert not same.gaussian
    assert same.kpis(60.0, 60.0) == tally.kpis(60.0, 60.0)


def record_of(spikes, rng, snr=6.0):
    """A tube of 200 places with spiky motion, and spikes that rise above its own threshold in every draw."""
    tally = DetectionTally(Sensor())
    for _ in range(200):
        tally.add(0.25, snr, 0.6, 0.1, rng.standard_t(3, COUNT))
    z = tally.threshold(60.0)
    heard = {name: list(map(float, getattr(tally, name))) for name in false_calls.FIELDS}
    return z, {"heights": [z + spike for spike in spikes for _ in range(DRAWS)], "heard": heard}


def test_a_summary_of_spiky_tubes():
    """Four tubes of 50 m, of which two have a spike in every draw: half a call a tube, where 1 / 12 were promised.

    So both must go: the rise is that of the higher one, and depths grow with the thresholds: a90 of one place is
    (z + what the spikes hide), of which z goes up by the rise.
    """
    config, rng = TaskConfig(), np.random.default_rng(0)
    plan = Plan({"slow": make_policy("slow", config)}, PLACE.contexts * 2, config=config)
    tubes = [record_of(spikes, rng) for spikes in ((0.5,), (1.5,), (), ())]
    (row,) = summarise(plan, {("slow", k, 0): record for k, (_, record) in enumerate(tubes)}).to_dict("records")
    assert row["promised"] == pytest.approx(0.1 * 50.0 / 60.0)
    assert row["calls"] == 0.5
    assert row["calls_low"] < 0.5 < row["calls_high"]
    assert row["call_threshold"] == pytest.approx(np.mean([z for z, _ in tubes]))
    assert row["call_threshold"] > row["gaussian_threshold"]
    assert row["rise"] == pytest.approx(1.5)
    assert row["rise_low"] == 0.0
    assert row["rise_high"] == pytest.approx(1.5)
    grown = row[DEPTH_OF["risen"]] - row[DEPTH]
    assert grown == pytest.approx(100.0 * 0.2 * 1.5 / 6.0, rel=0.1)  # the interpolation between depths


def test_insertions_that_diverge_are_left_out_and_counted(monkeypatch, tmp_path, capsys):
    def diverging(policy, config, context, *left, **named):
        if context == PLACE.contexts[1]:
            raise RuntimeError("the simulation diverged at 12 m")
        return insert(policy, config, context, *left, **named, until=5.6)

    monkeypatch.setattr(false_calls, "insert", diverging)
    summary = run_false_calls(("constant",), PLACE, "standard", tmp_path, HERE)
    assert summary["tubes"].tolist() == [1]
    assert json.loads((tmp_path / "provenance.json").read_text())["diverged"] == 1
    assert "1 of 2 insertions diverged and are left out" in capsys.readouterr().out
    monkeypatch.setattr(
        false_calls, "insert", lambda *_, **__: (_ for _ in ()).throw(RuntimeError("the simulation diverged"))
    )
    with pytest.raises(RuntimeError, match="policy constant: all insertions diverged"):
        run_false_calls(("constant",), PLACE, "standard", tmp_path / "none", HERE)


@pytest.fixture
def short(monkeypatch):
    """Insertions that end at 5.6 m; how many were simulated."""
    played = []

    def counted(*args, **named):
        played.append(args)
        return insert(*args, **named, until=5.6)

    monkeypatch.setattr(false_calls, "insert", counted)
    return played


def test_insertions_are_stored_and_not_simulated_again(short, tmp_path, capsys):
    first = run_false_calls(("constant", "slow"), PLACE, "standard", tmp_path, HERE)
    assert len(short) == 4
    assert len({seed for *_, seed in short}) == 2  # a tube has its own start, whatever the policy
    counts = pd.read_csv(tmp_path / "counts.csv")
    assert counts.groupby("policy")["context"].apply(list).to_dict() == {"constant": [0, 1], "slow": [0, 1]}
    assert len(Journal(tmp_path / "counts.jsonl", Count).read()) == 4
    second = run_false_calls(("constant", "slow"), PLACE, "standard", tmp_path, HERE)
    assert len(short) == 4
    pd.testing.assert_frame_equal(first, second)
    said = capsys.readouterr().out
    for row, shown in zip(first.to_dict("records"), cells(first), strict=True):
        own = counts[counts["policy"] == row["policy"]]
        assert row["promised"] == pytest.approx(0.1 * own["inspected_m"].mean() / 60.0, rel=1e-4)
        assert row["calls"] == pytest.approx(own["calls"].mean(), abs=1e-4)
        assert row["call_threshold"] == pytest.approx(threshold(Sensor(), 60.0))  # too short to be told from Gaussian
        assert said.count(shown[0]) >= 2
    run_false_calls(("constant", "pi"), PLACE, "standard", tmp_path, HERE)
    assert len(short) == 6  # those of another policy alone
    record = json.loads((tmp_path / "provenance.json").read_text())
    assert (record["tubes"], record["draws"], record["diverged"]) == (2, DRAWS, 0)


def test_both_ways_are_refused_before_anything_is_done(tmp_path):
    both = PLACE._replace(config=TaskConfig(passes="both"))
    with pytest.raises(ValueError, match=r"task\.passes = 'both': false calls are counted on the way in"):
        run_false_calls(("constant",), both, "standard", tmp_path / "out", HERE)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (["constant", "--fidelity", "fast"], "fidelity.time_lapse = 4 leaves out metres in which calls are counted"),
        (["no-such-policy"], "policy = 'no-such-policy'"),
        (["constant", "--limit", "100"], "limit = 100"),
    ],
)
def test_what_is_wrong_is_named_before_anything_is_done(asked, message, tmp_path, capsys):
    assert main(["false-calls", *asked, "--output", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
