"""Calls where there is no flaw: counted in noise whose calls are known, and over insertions that are stored."""

import json
from functools import partial

import numpy as np
import pandas as pd
import pytest
from scipy.stats import poisson

from agents.cli import main
from agents.detection import false_calls
from agents.detection.false_calls import DRAWS, Count, cells, heights, raised, run_false_calls, tally_of
from agents.detection.passage import insert
from agents.policies.places import place_of
from agents.processes.workers import HERE
from agents.records.journal import Journal
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


@pytest.fixture
def short(monkeypatch):
    """Insertions that end at 5.6 m; how many were simulated."""
    played = []

    def counted(*args):
        played.append(args)
        return insert(*args, until=5.6)

    monkeypatch.setattr(false_calls, "insert", counted)
    return played


def test_insertions_are_stored_and_not_simulated_again(short, tmp_path, capsys):
    first = run_false_calls(("constant", "slow"), PLACE, "standard", tmp_path, HERE)
    assert len(short) == 4
    counts = pd.read_csv(tmp_path / "counts.csv")
    assert counts.groupby("policy")["context"].apply(list).to_dict() == {"constant": [0, 1], "slow": [0, 1]}
    journal = Journal(tmp_path / "counts.jsonl", Count).read()
    assert len(journal) == 4
    second = run_false_calls(("constant", "slow"), PLACE, "standard", tmp_path, HERE)
    assert len(short) == 4
    pd.testing.assert_frame_equal(first, second)
    quiet = threshold(TaskConfig().sensor, 60.0)
    for row, shown in zip(first.to_dict("records"), cells(first), strict=True):
        own = counts[counts["policy"] == row["policy"]]
        assert row["promised"] == pytest.approx(0.1 * own["inspected_m"].mean() / 60.0, rel=1e-4)
        assert row["calls"] == pytest.approx(own["calls"].mean(), abs=1e-4)
        assert row["call_threshold"] >= quiet * (1.0 - 1e-9)
        assert row["a90_risen_percent_wall"] >= row["a90_percent_wall"]
        assert shown[0] in capsys.readouterr().out or shown[0] == "slow"
    rerun = partial(run_false_calls, ("constant", "pi"), PLACE, "standard", tmp_path, HERE)
    rerun()
    assert len(short) == 6  # those of another policy alone
    record = json.loads((tmp_path / "provenance.json").read_text())
    assert (record["tubes"], record["draws"]) == (2, DRAWS)


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
