"""A replay of a log follows it, standstills included: on the feed device alone, and in an episode."""

import gymnasium as gym
import numpy as np
import openpyxl
import pytest

from probe_agents.plant.logs import read_log
from probe_agents.policies.catalogue import make_policy
from probe_agents.policies.fixed import Replayed, Scheduled
from probe_agents.records.reader import read_withdrawal
from probe_agents.records.shipped import file_or_shipped
from probe_env import Context, TaskConfig
from probe_env.envs.episodes import Episodes
from probe_env.envs.trials import PolicyBatch
from probe_env.fidelity import PRESETS
from probe_env.files import FileError
from probe_env.inspection.instrument import Instrument
from probe_env.schedule import Schedule

ROUNDING = 1e-4  # [m]: lengths are observed as float32 shares of 60 m, thousands of them


def replay_of(tmp_path, config, speeds, seconds, start=5.0):
    """The policy of a log that holds each speed [m/s] for some seconds."""
    times = np.concatenate([[0.0], np.cumsum(np.broadcast_to(seconds, len(speeds)))])
    lengths = start + np.concatenate([[0.0], np.cumsum(np.diff(times) * speeds)])
    head = ["# interpolation: steps", "time_s,inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h"]
    rows = [f"{t:g},{x:.6f},{u:g},63\n" for t, x, u in zip(times, lengths, [*speeds, speeds[-1]], strict=True)]
    (tmp_path / "log.csv").write_text("\n".join([*head, ""]) + "".join(rows))
    policy = make_policy(str(tmp_path / "log.csv"), config)
    assert isinstance(policy, Replayed)
    return policy


def fed_by_device(policy, config, seconds, start=5.0, speed=0.2):
    """(k,) what a feed with the task's ramp has in at the end of every period [m], and the (k,) targets."""
    names, late = list(config.observations), config.delay_periods
    lengths, targets, state = [start], [], None
    for _ in range(int(seconds / config.period)):
        row = np.zeros(len(names), dtype=np.float32)
        row[names.index("inserted_length")] = lengths[max(len(lengths) - 1 - late, 0)] / 60.0
        action, state = policy.predict(row, state)
        target = config.targets(action[None], allow_standstill=True)[0, 0]
        ramping = min(abs(target - speed) / config.ramp, config.period)
        reached = speed + np.sign(target - speed) * config.ramp * ramping
        lengths.append(lengths[-1] + 0.5 * (speed + reached) * ramping + reached * (config.period - ramping))
        targets.append(target)
        speed = reached
    return np.array(lengths[1:]), np.array(targets)


@pytest.mark.parametrize("fields", [{}, {"period": 0.5}, {"feed_speeds": (0.05, 0.4)}, {"ramp": 0.4, "period": 2.0}])
def test_the_length_of_a_log_is_followed_for_any_speeds_in_range(tmp_path, fields):
    """What a period is off is made good in the next; left are its own ramp and half of the slowest feed.

    A ramp between speeds u and v loses or gains (u - v)^2 / (2 ramp). What is made good adds at most that over a period
    to the change of the speed.
    """
    config = TaskConfig(**fields)
    slow, fast = config.feed_speeds
    for seed in range(4):
        rng = np.random.default_rng(seed)
        speeds = np.where(rng.random(40) < 0.3, 0.0, rng.uniform(0.001, 0.75 * fast, 40))
        policy = replay_of(tmp_path, config, speeds, rng.uniform(2.0, 8.0, 40).round(1))
        lengths, targets = fed_by_device(policy, config, policy.schedule.position[-1] - config.period)
        wanted = 5.0 + policy.schedule.fed_length(config.period * np.arange(1, len(lengths) + 1))
        change = np.abs(np.diff(targets, prepend=0.2)).max()
        bound = change**2 / (2.0 * config.ramp) + 0.5 * slow * config.period + ROUNDING
        assert np.abs(lengths - wanted).max() <= bound, seed
        assert set(np.sign(targets)) == {0.0, 1.0}
        assert targets[targets > 0.0].min() >= slow * (1.0 - 1e-5)
        assert targets.max() <= fast * (1.0 + 1e-6)


def test_replay_of_slow_feeds_and_beyond_the_log(tmp_path):
    """Rigs stop at last; an episode that stood still with them would never end."""
    config = TaskConfig()
    _, targets = fed_by_device(replay_of(tmp_path, config, [0.3, 0.0], [20.0, 10.0]), config, 60.0)
    assert (targets[21:30] == 0.0).all()
    assert targets[30:] == pytest.approx(0.02)
    lengths, targets = fed_by_device(replay_of(tmp_path, config, [0.005], 400.0), config, 399.0)
    assert lengths[-1] - 5.0 == pytest.approx(2.0, abs=0.02 + ROUNDING)
    assert (targets == 0.0).mean() == pytest.approx(0.75, abs=0.02)  # a quarter of the slowest feed


def test_late_observations_are_followed_without_swinging(tmp_path):
    """With a steady speed behind a standstill the length settles on the log's, less half of the slowest feed."""
    for delay in (1, 2, 5):
        config = TaskConfig(delay_periods=delay)
        policy = replay_of(tmp_path, config, [0.3, 0.0, 0.1], [20.0, 20.0, 200.0])
        lengths, _ = fed_by_device(policy, config, 239.0)
        wanted = 5.0 + policy.schedule.fed_length(np.arange(1.0, len(lengths) + 1.0))
        assert np.abs(lengths - wanted)[-60:].max() <= 0.01 + ROUNDING, delay
        assert np.ptp(lengths[30:40]) == 0.0  # in the standstill


def test_a_log_is_followed_from_where_the_episode_begins(tmp_path):
    """What lies before is left out; a log that begins further in is caught up with, at most at the permitted feed."""
    config = TaskConfig()
    for start, skipped in ((5.0, 0.0), (3.0, 10.0), (6.0, 0.0)):
        lengths, targets = fed_by_device(replay_of(tmp_path, config, [0.2], 150.0, start), config, 100.0)
        wanted = start + 0.2 * (skipped + np.arange(1.0, 101.0))
        assert np.abs(lengths - wanted)[20:].max() <= 0.01 + ROUNDING, start
        assert targets[0] == pytest.approx(0.4 if start > 5.0 else 0.2, rel=1e-4)
    slower = config.model_copy(update={"instrument": Instrument(highest_speed=0.3)})
    _, targets = fed_by_device(replay_of(tmp_path, slower, [0.2], 150.0, 6.0), slower, 100.0)
    assert targets.max() == pytest.approx(0.3, rel=1e-4)
    without = Schedule("time", "steps", (0.0, 150.0), (0.2, 0.2), (0.02, 0.02))
    free, _ = fed_by_device(Replayed(config, without), config, 100.0)
    assert free == pytest.approx(5.0 + 0.2 * np.arange(1.0, 101.0), abs=ROUNDING)


def test_fed_length_is_the_integral_of_a_schedule():
    fine = np.linspace(2.0, 12.0, 1_000_001)
    for interpolation, times in (("linear", 0.5 * (fine[1:] + fine[:-1])), ("steps", fine[:-1])):
        schedule = Schedule("time", interpolation, (2.0, 4.0, 9.0), (0.1, 0.3, 0.0), (0.02,) * 3)
        whole = np.concatenate([[0.0], np.cumsum(schedule.at(times)[0] * np.diff(fine))])
        # steps look 1e-5 s ahead (``at``), at two steps of 0.2 and 0.3 m/s
        assert schedule.fed_length(fine[::1000]) == pytest.approx(whole[::1000], abs=1e-5), interpolation
        assert schedule.fed_length(0.0) == pytest.approx(-0.2)


def test_only_who_replays_may_stand_still():
    """The action is beyond the space of every environment; a schedule over length that stops would never go on."""
    config = TaskConfig()
    action = np.array([[config.standstill, 0.0]], dtype=np.float32)
    assert config.targets(action, allow_standstill=True)[0, 0] == 0.0
    with pytest.raises(ValueError, match=r"action\[0\] = -1.1052\d* is outside the accepted range -1 to 1"):
        config.targets(action)
    with pytest.raises(ValueError, match=r"action\[0\] = -1.2"):
        config.targets([[-1.2, 0.0]], allow_standstill=True)
    with pytest.raises(ValueError, match=r"action\[1\]"):
        config.targets([[config.standstill, config.standstill]], allow_standstill=True)
    env = gym.make("probe_env/Insertion-v1", fidelity="fast", config={"settle_time": 0.1})
    env.reset(seed=0)
    with pytest.raises(ValueError, match="outside the accepted range"):
        env.step(action[0])
    over_length = Scheduled(config, Schedule("inserted_length", "steps", (5.0,), (0.0,), (0.02,)))
    row = np.zeros(len(config.observations), dtype=np.float32)
    assert over_length.predict(row)[0][0] == -1.0


@pytest.mark.slow
def test_the_example_log_is_followed_in_an_episode(tmp_path):
    """Within 1 % and 0.1 m behind the first 5 s, as it begins 0.12 m further in: 0.054 m were measured.

    A change of the feed by 0.117 m/s is lost or gained over its ramp, as often as time-lapse says, because ramps run on
    the clock of the dynamics: 4 x 0.117^2 / (2 x 0.5) m. The standstill is one, and as long.
    """
    log, path = read_log(file_or_shipped("logs", "example-rig")), tmp_path / "rig.csv"
    path.write_text(log.to_csv())
    config = TaskConfig()
    policy = make_policy(str(path), config)
    episodes, players = Episodes(1, config, fidelity="fast", threads=1, allow_standstill=True), PolicyBatch(1)
    observation, _ = episodes.reset([0], {0: np.random.default_rng(0)}, {0: {"context": Context(friction=0.2)}})
    players.begin(0, policy)
    infos = []
    while episodes.running.any():
        step = episodes.step(players.act(observation, np.array([True])))
        observation, info = step.observation, step.infos[0]
        infos.append((info["time"], info["inserted_length"], info["target_feed_speed"]))
    time, length, speed = np.array(infos).T
    lost = PRESETS["fast"].time_lapse * np.abs(np.diff(speed))[5:].max() ** 2 / (2.0 * config.ramp)
    off = np.abs(length - np.interp(time, log.time, log.inserted_length))
    assert off[5:].max() <= min(lost + 0.5 * config.feed_speeds[0] + 1e-3, 0.1)  # 1 mm: the clean log's tolerance
    assert (off < 0.01 * length)[5:].all()
    (dwell,) = log.dwells
    standing = time[speed == 0.0]
    assert np.ptp(standing) + 1.0 == pytest.approx(dwell.duration, abs=2.0)
    assert abs(standing[0] - dwell.time) <= 2.0
    assert time[-1] == pytest.approx(log.time[-1], abs=2.0)
    assert info["episode_kpis"]["complete"] == 1.0
    assert info["reward_terms"]["uninspected"] == 0.0


OTHER_SCHEDULES = {
    "decimal commas": "Länge [m];Vorschub [mm/s];Luft [m³/h]\n5,0;200,0;63,0\n25,5;150,0;108,0\n;;\n",
    "the columns of a schedule": "inserted_length_m;feed_speed_m_per_s;air_supply_m3_per_h\n5;0,2;63\n25,5;0,15;108\n",
    "tabs and words": "Inserted Length m\tFeed Speed m/s\tAir Flow m3/h\tNote\n5\t0.2\t63\ta\n25.5\t0.15\t108\tb\n",
    "commas and words": 'Length [mm],"Feed\n[m/min]",Air [l/min],\n5000,12,1050,\n25500,9,1800,\n',
}


def test_schedules_are_read_as_logs_are(tmp_path):
    path, config = tmp_path / "mine.csv", TaskConfig()
    expected = ((5.0, 25.5), pytest.approx((0.2, 0.15)), pytest.approx((63.0 / 3600.0, 0.03)))
    for name, text in OTHER_SCHEDULES.items():
        path.write_text(text, encoding="utf-8")
        schedule = make_policy(str(path), config).schedule
        assert (schedule.position, schedule.feed_speed, schedule.air_supply_rate) == expected, name
        assert (schedule.over, schedule.interpolation) == ("inserted_length", "linear")
    book = openpyxl.Workbook()
    for row in (["Länge", "Vorschub", "Luft"], ["m", "mm/s", "m³/h"], [5, 200, 63], [25.5, 150, 108]):
        book.active.append(row)
    book.save(tmp_path / "mine.xlsx")
    schedule = make_policy(str(tmp_path / "mine.xlsx"), config).schedule
    assert (schedule.position, schedule.feed_speed, schedule.air_supply_rate) == expected
    path.write_text(
        "# interpolation: steps\nZeit;Weg [m];Vorschub [m/s];Luft [m3/h]\n9:59:50;5;0,2;63\n10:00:00;7;0,1;63"
    )
    schedule = make_policy(str(path), config).schedule
    assert (schedule.over, schedule.interpolation, schedule.start_length) == ("time", "steps", 5.0)
    assert (schedule.position, schedule.feed_speed) == ((0.0, 10.0), (0.2, 0.1))


def test_a_withdrawal_is_read_as_logs_are(tmp_path):
    path = tmp_path / "mine.csv"
    head = "Length [m];Feed [m/s];Air [m3/h];Return feed [mm/s];Return air [m3/h]"
    path.write_text(f"{head}\n5;0,2;63;300;36\n25;0,2;63;400;54\n")
    back = read_withdrawal(path)
    assert (back.position, back.feed_speed) == ((5.0, 25.0), pytest.approx((0.3, 0.4)))
    assert back.air_supply_rate == pytest.approx((0.01, 0.015))
    path.write_text("Length [m];Feed [m/s];Air [m3/h];Return feed [mm/s]\n5;0,2;63;300\n")
    with pytest.raises(FileError, match="go together"):
        read_withdrawal(path)
    path.write_text(OTHER_SCHEDULES["decimal commas"], encoding="utf-8")
    assert read_withdrawal(path) is None


def test_errors_in_schedules_name_their_cause(tmp_path):
    path, heads = tmp_path / "mine.csv", "correct the file: a schedule has heads like 'length [m]'"
    for text, problem in {
        "length;feed;air\n5;0,2;63": f"column 'length' has no unit - {heads}",
        "length [m];feed [m/s]\n5;0,2": f"no column for air_supply; found: 'length [m]', 'feed [m/s]' - {heads}",
        "length [m];feed [kg];air [m3/h]\n5;1;1": "'kg' is not a unit of feed_speed - convert the column to m/s",
        "length [m];feed [m/s];air [m3/h]\n5;;63": "line 2, column 'feed [m/s]': no value",
        "length [m];feed [m/s];air [m3/h]\n5;0,2;63\n5;1,0;63": "line 3, inserted_length_m = 5.0 must be greater than",
        "length [m];feed [m/s];air [m3/h]\n5;-0,2;63": "line 2, feed_speed_m_per_s = -0.2 is outside the accepted",
        "length [m];feed [m/s];air [m3/h]\n5,000;1;63": "'5,000' is ambiguous: decimal sign or thousands separator -",
        "hello\nworld": "line 1: no header with two known quantities",
        "inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n5,0,2,63": "4 values for 3 columns - semicolons or",
    }.items():
        path.write_text(text)
        with pytest.raises(FileError) as caught:
            make_policy(str(path), TaskConfig())
        assert problem in str(caught.value)
        assert "--" not in str(caught.value)
