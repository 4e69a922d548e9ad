"""Verdicts on the speed and metres to repeat: cases worked by hand, and the pass that repeats them."""

from urllib.parse import unquote

import numpy as np
import pandas as pd
import pytest

from probe_agents.cli import main
from probe_agents.evaluation.folder import read_evaluation
from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.evaluation.profiles import downloads
from probe_agents.evaluation.repeat import (
    CASE,
    INTERVAL,
    instrument_kpis,
    intervals_to_repeat,
    is_judged,
    quiet_feeds,
    quiet_text,
    repeat_overview,
    repeat_schedule,
    segments_of,
    verdict_of,
    verdict_text,
)
from probe_agents.evaluation.report import verdicts
from probe_agents.evaluation.run import evaluate_plan, plan_of
from probe_agents.policies.cases import read_case
from probe_agents.policies.fixed import Scheduled
from probe_agents.policies.wrappers import SpeedLimited
from probe_env import Context, TaskConfig
from probe_env.envs.vibration_map import CONTEXT, stored_map
from probe_env.fidelity import resolve_fidelity
from probe_env.schedule import Schedule

CONFIG = TaskConfig(instrument={"test_frequency": 100.0})
"""Permits 100 Hz / 4 x 20 mm / 2 = 0.25 m/s; the vibration limit is 0.1 mm."""
END = 60.0


def insertion(feed=0.2, vibration=5e-5, last=END, **columns):
    """A profile from 5 m on, as constants or as functions of the middles of the metres."""
    metre = np.arange(5.5, last)
    values = {"highest_feed": feed, "radial_rms_m": vibration, "tension_mean_n": 5.0, "air_supply_rate": 0.02} | columns
    return {"inserted_length": metre} | {
        name: value(metre) if callable(value) else np.full(len(metre), value) for name, value in values.items()
    }


def above(place, value, other):
    """A value beyond a place [m], and another before."""
    return lambda metre: np.where(metre > place, value, other)


def judged(metres, config=CONFIG, **ended):
    """Verdict and intervals."""
    segments = segments_of(metres, config, **ended)
    intervals = intervals_to_repeat(segments, config)
    return verdict_of([(segments, intervals)], config), list(intervals.itertuples(index=False, name=None))


def test_too_fast_too_loud_and_good():
    fast = insertion(feed=lambda metre: np.where((metre > 10.0) & (metre < 20.0), 0.3, 0.2))
    verdict, intervals = judged(fast)
    assert (verdict.allowed, verdict.too_fast, verdict.requirement) == (False, ((10.0, 20.0),), "test_frequency")
    assert (verdict.length, verdict.excess, verdict.repeat) == (10.0, pytest.approx(0.05), 10.0)
    assert intervals == [(10.0, 20.0, "speed")]
    assert verdict_text(verdict) == (
        "not allowed: 10.0 m above 0.25 m/s (test_frequency), by up to 0.05 m/s; at 10.0 to 20.0 m"
    )
    verdict, intervals = judged(insertion(vibration=above(35.0, 1.5e-4, 5e-5)))
    assert (verdict.allowed, verdict.length, verdict.excess, verdict.repeat) == (True, 0.0, 0.0, 25.0)
    assert intervals == [(35.0, 60.0, "noise")]
    verdict, intervals = judged(insertion(feed=0.25))
    assert (verdict.allowed, verdict.repeat, intervals) == (True, 0.0, [])
    assert verdict_text(verdict) == "allowed: at most 0.25 m/s (test_frequency) everywhere"
    verdict, _ = judged(fast, CONFIG.model_copy(update={"instrument": {"test_frequency": None}}))
    assert (verdict.allowed, verdict_text(verdict)) == (True, "no speed limit of the instrument is set")


def test_reasons_are_named_where_they_apply():
    """Drive is lost in metre 41 to 42, extended to 2 m; samples are missing from there to the end of the helix."""
    metres = insertion(feed=above(40.0, 0.2, 0.4), vibration=above(35.0, 2e-4, 0.0))
    assert judged(metres)[1] == [(5.0, 35.0, "speed"), (35.0, 40.0, "speed and noise"), (40.0, 60.0, "noise")]
    lost, both = (40.5, 41.0, "lost drive"), (41.0, 42.5, "lost drive and samples")
    assert judged(insertion(last=42.0), complete=False, lost_drive=True)[1] == [lost, both, (42.5, 60.0, "samples")]
    slack = insertion(tension_mean_n=lambda metre: np.where((metre < 12.0) | (metre > 50.0), 0.5, 5.0))
    assert judged(slack)[1] == [(50.0, 60.0, "lost drive")]  # it is not scored in the first 15 m
    assert judged(insertion(last=5.0), complete=False)[1] == [(5.0, 60.0, "samples")]


def test_short_intervals_are_extended_and_short_gaps_closed():
    """Shortest 2 m: 20 to 21 and 22 to 23 join, 30 to 31 becomes 29.5 to 31.5, those at the ends extend inwards."""
    bad = (5.5, 20.5, 22.5, 30.5, 40.5, 43.5, 59.5)
    metres = insertion(vibration=lambda metre: np.where(np.isin(metre, bad), 2e-4, 0.0))
    expected = [(5.0, 7.0), (20.0, 23.0), (29.5, 31.5), (39.5, 44.5), (58.0, 60.0)]  # 39.5 to 41.5, 42.5 to 44.5
    assert judged(metres)[1] == [(*interval, "noise") for interval in expected]
    exact = CONFIG.model_copy(update={"instrument": {"repeat_length": 0.5}})
    assert judged(metres, exact)[1] == [(metre - 0.5, metre + 0.5, "noise") for metre in bad]
    # at 2 m/s and a period of 1 s every second metre has no row
    verdict, intervals = judged({name: values[::2] for name, values in insertion(feed=2.0).items()})
    assert (verdict.length, intervals) == (55.0, [(5.0, 60.0, "speed")])


def test_noise_is_compared_in_the_measure_of_the_task():
    snr = CONFIG.model_copy(update={"vibration_measure": "snr"})
    limit = float(snr.sensor.equivalent_rms(np.array(1.0 / 3.0)))
    metres = insertion(vibration=1.0, noise_rms_m=above(35.0, 1.01 * limit, 0.99 * limit))
    assert judged(metres, snr)[1] == [(35.0, 60.0, "noise")]
    assert judged(metres, CONFIG.model_copy(update={"vibration_measure": "velocity"}))[1] == []


def test_axial_vibration_is_reported_beside_the_feed():
    """0.2 m/s and 0.06 m/s rms are above 0.25 m/s, from 40 m on; the list of metres is by the feed alone."""
    verdict, intervals = judged(insertion(axial_velocity_rms=above(40.0, 0.06, 0.04)))
    assert (verdict.allowed, verdict.sensor_length, intervals) == (True, 20.0, [])
    assert verdict_text(verdict).endswith(
        "everywhere; for information: feed and axial vibration (rms) exceed it in 20.0 m"
    )


def test_withdrawals_and_constant_lengths_are_not_judged():
    changes = {}, {"growing": False}, {"instrument": None}
    assert [is_judged(CONFIG.model_copy(update=change)) for change in changes] == [True, False, False]
    for scored, judges in (("withdrawal", False), ("best", True)):
        both = {"passes": "both", "time_limit": 1e3, "scored_pass": scored}
        assert is_judged(CONFIG.model_copy(update=both)) == judges


def test_a_sentence_names_eight_intervals_at_most():
    """Five of every six metres are quiet, from 5 m on: ten loud metres, the last from 59 m on."""
    verdict, _ = judged(insertion(vibration=lambda metre: np.where((metre - 5.5) % 6 == 0.0, 2e-4, 5e-5)))
    text = quiet_text(verdict, "0.1 mm")
    assert text.startswith("not quiet: vibration above 0.1 mm in 10.0 m; at 5.0 to 6.0, 11.0 to 12.0, ")
    assert text.endswith(", 47.0 to 48.0 m and 2 more")


def test_an_overview_has_few_rows():
    """Exact as long as it fits; ten intervals in 2 m become a bin of 5 m; one every 10 m, bins of 20 m, joined."""
    two = [(6.0, 10.0, "noise"), (10.0, 12.0, "speed")]
    near = [(6.0 + 0.2 * k, 6.1 + 0.2 * k, "noise") for k in range(10)]
    far = [(10.0 * k + 1.0, 10.0 * k + 2.0, "noise" if k % 2 else "speed") for k in range(10)]
    for lists, end, expected in (
        ((two, []), 60.0, [[6.0, 10.0, "noise", 0.5], [10.0, 12.0, "speed", 0.5]]),
        ((two[:1], [(9.0, 11.0, "speed")], []), 60.0, [
            [6.0, 9.0, "noise", 1 / 3], [9.0, 10.0, "speed and noise", 2 / 3], [10.0, 11.0, "speed", 1 / 3],
        ]),
        (([],), 60.0, []),
        ((near,), 60.0, [[5.0, 10.0, "noise", 1.0]]),
        ((far,), 97.0, [[0.0, 97.0, "speed and noise", 1.0]]),
    ):  # fmt: skip
        overview = repeat_overview([pd.DataFrame(rows, columns=INTERVAL) for rows in lists], end)
        assert list(overview) == [*INTERVAL, "share"]
        assert overview.to_numpy().tolist() == expected


def driven(schedule, config, begin, end, start):
    """Highest feed in an interval, of a device that takes a target every period and follows it with its ramp."""
    length, feed, highest, step = start, config.feed_speeds[1], 0.0, 0.01
    while length < end:
        target = float(schedule.at(length)[0])
        for _ in range(round(config.period / step)):
            feed += min(max(target - feed, -config.ramp * step), config.ramp * step)
            length += feed * step
            highest = max(highest, feed) if begin < length < end else highest
    return highest


def scheduled(metres, config, context, **ended):
    segments = segments_of(metres, config, **ended)
    return repeat_schedule([(segments, intervals_to_repeat(segments, config), context)], config, stored_map())


def test_repeated_pass_is_slow_or_has_max_air_only_where_it_must():
    metres = insertion(feed=lambda metre: np.where((metre > 20.0) & (metre < 30.0), 0.4, 0.2), air_supply_rate=0.03)
    schedule = scheduled(metres, CONFIG, Context())
    assert schedule.at([6.0, 18.0, 20.0, 25.0, 29.9, 30.2, 59.0])[0] == pytest.approx(
        [0.4, 0.4, 0.25, 0.25, 0.25, 0.4, 0.4]
    )
    assert schedule.at([6.0, 25.0])[1] == pytest.approx([0.03, 0.03])
    for start in np.arange(16.0, 16.4, 0.02):
        assert driven(schedule, CONFIG, 20.0, 22.0, start) <= 0.25 * (1.0 + 1e-6)
    steps = CONFIG.model_copy(update={"feed_speed_step": 0.1})
    assert scheduled(metres, steps, Context()).at(25.0)[0] == pytest.approx(0.2)
    after_loss = scheduled(insertion(last=42.0), CONFIG, Context(), complete=False, lost_drive=True)
    maximum = CONFIG.air_supply_rates[1]
    assert after_loss.at([30.0, 40.6, 59.0])[1] == pytest.approx([0.02, maximum, maximum])


def test_a_repeated_pass_is_quiet_where_it_was_loud():
    """By the map: the fastest of its feeds whose mean, raised by the scatter, is below the limit."""
    context, vibration = Context(friction=0.2, helix_diameter=1.2), stored_map()
    metres = insertion(feed=0.25, vibration=above(40.0, 1.01e-4, 5e-5))
    schedule = scheduled(metres, CONFIG, context)
    grid, ones = np.geomspace(0.04, 0.25, 2000), np.ones(2000)
    tube = [getattr(context, name) for name in CONTEXT] * ones[:, None]
    for length in (42.4, 50.4):
        feed = float(schedule.at(length)[0])
        mean, deviation = vibration.predict(length * ones, grid, 0.02 * ones, tube, CONFIG.scene)
        quiet = grid[mean + deviation <= 0.0].max()
        assert 0.04 < feed <= quiet < 0.25
        assert feed > 0.95 * quiet  # a step of 40 from 0.04 to 0.25 m/s is 4.8 %
    quiet = float(schedule.at(40.5)[0])
    for start in np.arange(36.0, 36.4, 0.02):  # vibration takes 2 s to decay
        assert driven(schedule, CONFIG, 40.0 - 1.9 * quiet, 40.5, start) <= quiet * (1.0 + 1e-6)
    louder = metres | {"radial_rms_m": 2.0 * metres["radial_rms_m"]}
    slower, before = (quiet_feeds(segments_of(m, CONFIG), context, CONFIG, vibration) for m in (louder, metres))
    assert (slower[40:] <= before[40:]).all()


def test_evaluate_applies_the_permitted_speed(tmp_path, capsys):
    tube, file, folder = tmp_path / "tube.toml", tmp_path / "mine.csv", tmp_path / "out"
    tube.write_text("[tube]\nhelix_diameter = 1.2\nhelix_length = 30.0\n[instrument]\ntest_frequency = 100.0\n")
    head = "# interpolation: steps\ninserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n"
    file.write_text(f"{head}5,0.2,63\n10,0.4,63\n20,0.2,63\n")
    options = ["--tube", str(tube), "--limit", "2", "--fidelity", "surrogate", "--output"]
    assert main(["evaluate", "slow-down", str(file), *options, str(folder)]) == 0
    printed = capsys.readouterr().out
    assert "slow-down: allowed: at most 0.25 m/s (test_frequency) everywhere\n" in printed
    done = read_evaluation(folder)
    table, profile = (frame.groupby("policy") for frame in (done.table, done.profile))
    assert profile["highest_feed"].max().to_dict() == pytest.approx({"slow-down": 0.25, "mine": 0.4})
    assert (done.profile["permitted_speed"] == 0.25).all()
    kpis = table[["length_too_fast_m", "speed_excess_m_per_s"]].max()
    assert kpis.loc["slow-down"].tolist() == [0.0, 0.0]
    assert kpis.loc["mine"].tolist() == pytest.approx([11.0, 0.15])  # a period of 1 s may end 0.4 m behind 20 m
    listed = pd.read_csv(folder / "repeat.csv")
    speed = listed[listed["reason"].str.contains("speed")]
    assert speed["policy"].unique().tolist() == ["mine"]
    assert speed.groupby("context").agg({"from_m": "min", "to_m": "max"}).to_numpy().tolist() == [[10.0, 21.0]] * 2
    lengths = (listed["to_m"] - listed["from_m"]).groupby(listed["policy"]).sum() / 2.0
    assert lengths["mine"] == pytest.approx(table["length_to_repeat_m"].mean()["mine"])
    page = (folder / "report.html").read_text()
    assert "<b>mine</b> is not allowed: 11.0 m on average above 0.25 m/s (test_frequency), by up to 0.15 m/s;" in page

    plan = plan_of([str(folder / "repeat-mine.csv")], read_case(tube, "test", 2), 1, "surrogate")
    assert plan.plant == tube.stem
    run_plan(plan, tmp_path / "again", progress=False)
    again = read_evaluation(tmp_path / "again").profile
    inside = again["inserted_length"].between(10.0, 21.0)
    assert again["highest_feed"][inside].max() <= 0.25 * (1.0 + 1e-3)
    assert again["highest_feed"][again["inserted_length"].between(6.0, 8.5)].min() == pytest.approx(0.4)


def test_kpis_of_an_insertion_that_diverged_at_once():
    kpis = instrument_kpis(segments_of({"inserted_length": np.array([np.nan])}, CONFIG, complete=False), CONFIG)
    nothing = ("length_too_fast_m", "speed_excess_m_per_s", "length_sensor_too_fast_m")
    assert kpis == dict.fromkeys(nothing, 0.0) | {"length_to_repeat_m": 55.0}


def test_report_of_one_tube_lists_metres_to_repeat(tmp_path):
    """At 0.3 m/s in a helix of 8 m: 3 m are above 0.25 m/s, unless the speed is limited."""
    config = CONFIG.model_copy(update={"scene": {"carrier_length": 2.5, "tube": {"helix_length": 8.0}}})
    constant = Scheduled(config, Schedule("inserted_length", "steps", (5.0,), (0.3,), (0.02,)))
    policies = {"mine": constant, "held": SpeedLimited(config, constant)}
    plan = Plan(policies, [Context()], config=config, fidelity=resolve_fidelity("fast", config.scene))
    evaluate_plan(plan, tmp_path)
    done = read_evaluation(tmp_path)
    highest = done.profile.groupby("policy")["highest_feed"].max().to_dict()
    assert highest == pytest.approx({"mine": 0.3, "held": 0.25})
    assert (done.profile["axial_velocity_rms"] > 0.0).all()
    expected = pd.DataFrame([("mine", 0, 0, 5.0, 8.0, "speed")], columns=[*CASE, *INTERVAL])
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "repeat.csv"), expected)
    assert [file.name for file in tmp_path.glob("repeat-*.csv")] == ["repeat-mine.csv"]
    sensor = "; for information: feed and axial vibration (rms) exceed it in 3.0 m"
    held, _ = verdicts(done)["held"]
    assert verdict_text(held) == f"allowed: at most 0.25 m/s (test_frequency) everywhere{sensor}"
    page = (tmp_path / "report.html").read_text()
    assert f"<b>held</b>, is {verdict_text(held)}. It is" in page  # the best, as it keeps the limit
    assert f"{verdict_text(verdicts(done)['mine'][0])}; 3.0 m to repeat</li>" in page
    offered = {item.policy: unquote(item.address) for item in downloads(done.table, done.profile)}
    assert [content.splitlines()[-1].split(",")[1] for content in offered.values()] == ["0.25", "0.3"]  # by rank
