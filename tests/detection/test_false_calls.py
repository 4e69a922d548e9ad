"""Calls where there is no flaw: counted in noise whose calls are known, and over insertions that are stored."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.stats import poisson

from agents.cli import main
from agents.detection import false_calls
from agents.detection.false_calls import Count, heights, run_false_calls
from agents.detection.passage import insert
from agents.detection.promise import (
    DEPTH,
    DRAWS,
    FIELDS,
    KEPT_DEPTH,
    SHARES,
    cells,
    keeping,
    set_for,
    summarise,
    tally_of,
)
from agents.policies.places import place_of
from agents.processes.workers import HERE
from agents.records.journal import Journal
from probe_env import TaskConfig
from probe_env.inspection.channels import Passage
from probe_env.inspection.detection import threshold
from probe_env.inspection.meter import COUNT, FREQUENCY
from probe_env.inspection.sensor import Sensor
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


def test_the_share_that_keeps_a_promise():
    """The first share with no more calls than were promised, in the mean over tubes; the last where none has so few."""
    falling = np.linspace(1.0, 0.0, len(SHARES))
    calls = np.array([falling, 3.0 * falling])  # 2 falling in the mean
    assert keeping(calls, 2.0) == 0
    index = keeping(calls, 0.5)
    assert 2.0 * falling[index] <= 0.5 < 2.0 * falling[index - 1]
    assert keeping(calls + 1.0, 0.5) == len(SHARES) - 1


def test_a_tally_set_for_fewer_calls_has_the_threshold_for_them():
    """Of still sensors it is the closed form; of spiky ones it rises, from the tally's own on."""
    still_one = DetectionTally(Sensor(), [0.2] * 30, [5.0] * 30, [0.0] * 30, [0.0] * 30, [0.0] * 30)
    expected = [threshold(Sensor(false_calls=0.1 * share), 60.0) for share in SHARES]
    np.testing.assert_allclose(set_for(still_one, 60.0), expected)
    spiky = tally_of(Sensor(), record_of((), np.random.default_rng(0), 0.6)["heard"])
    own = set_for(spiky, 60.0)
    assert own[0] == spiky.threshold(60.0)
    assert (np.diff(own) > 0.0).all()
    assert (own > expected).all()


def test_a_tally_is_that_which_was_stored():
    rng, tally = np.random.default_rng(0), DetectionTally(Sensor())
    for _ in range(200):
        tally.add(0.2, rng.uniform(2.0, 9.0), 0.6, 0.1, rng.standard_t(3, COUNT))
    stored = {name: list(map(float, getattr(tally, name))) for name in FIELDS}
    same = tally_of(Sensor(), json.loads(json.dumps(stored)))
    assert not same.gaussian
    assert same.kpis(60.0, 60.0) == tally.kpis(60.0, 60.0)


def record_of(spikes, rng, share):
    """A tube of 200 places with spiky motion as a share of the noise.

    In every draw spikes lie between the thresholds for these of ``SHARES`` and the next.
    """
    tally = DetectionTally(Sensor())
    for _ in range(200):
        tally.add(0.25, 6.0, share, 0.1, rng.standard_t(3, COUNT))
    z = set_for(tally, 60.0)
    heard = {name: list(map(float, getattr(tally, name))) for name in FIELDS}
    seen = [0.5 * (z[index] + z[index + 1]) for index in spikes for _ in range(DRAWS)]
    return {"heights": seen, "heard": heard, "threshold_of_all": z[20]}


def test_a_summary_of_spiky_tubes():
    """Four tubes of 50 m, of which two have a spike in every draw: half a call a tube, where 1 / 12 were promised.

    So both must go: the share that keeps the promise is the first whose threshold is above the higher of them, and
    depths grow with the thresholds. Spikes of no share leave the noise Gaussian: a90 is 0.2 (z + 1.28) / 6.
    """
    config, rng = TaskConfig(), np.random.default_rng(0)
    tubes = [record_of(spikes, rng, 0.0) for spikes in ((5,), (15,), (), ())]
    z = np.array([set_for(tally_of(config.sensor, tube["heard"]), 60.0) for tube in tubes])
    (row,) = summarise(config, {"slow": tubes}).to_dict("records")
    assert row["promised"] == pytest.approx(0.1 * 50.0 / 60.0)
    assert row["calls"] == 0.5
    assert row["calls_low"] < 0.5 < row["calls_high"]
    assert row["call_threshold"] == pytest.approx(z[:, 0].mean())
    assert row["gaussian_threshold"] == threshold(config.sensor, 60.0)
    assert row["threshold_of_all"] == pytest.approx(z[:, 20].mean())
    assert row["calls_of_all"] == row["calls_of_all_low"] == row["calls_of_all_high"] == 0.0
    assert row["kept_false_calls"] == pytest.approx(0.1 * SHARES[16])
    assert row["kept_false_calls_low"] == pytest.approx(0.1 * SHARES[16])
    assert row["kept_false_calls_high"] == pytest.approx(0.1)  # tubes without a spike alone: 1 draw of 16
    for figure, index in ((DEPTH, 0), (KEPT_DEPTH, 16)):
        assert row[figure] == pytest.approx(100.0 * 0.2 * (z[0, index] + 1.2816) / 6.0, rel=1e-4)
    assert row[f"{KEPT_DEPTH}_low"] == row[DEPTH]
    assert row[f"{KEPT_DEPTH}_high"] == row[KEPT_DEPTH]


def test_one_tube_has_no_intervals():
    config, rng = TaskConfig(), np.random.default_rng(0)
    tubes = [record_of(spikes, rng, 0.0) for spikes in ((5,), ())]
    assert "[" not in "".join(cells(summarise(config, {"slow": tubes[:1]}))[0])
    assert "0.50 [0.00, 1.00]" in cells(summarise(config, {"slow": tubes}))[0]


def test_what_summaries_are_of_must_be_there():
    with pytest.raises(RuntimeError, match="policy slow: all insertions diverged"):
        summarise(TaskConfig(), {"slow": []})


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
        assert row["threshold_of_all"] == pytest.approx(own["threshold_of_all"].mean(), rel=1e-4)
        assert row["threshold_of_all"] >= row["call_threshold"]
        assert row["calls_of_all"] == pytest.approx(own["calls_of_all"].mean(), abs=1e-4)
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
