"""Round trips: score of a metre, turn and end of an episode, and policies of both passes."""

import gymnasium as gym
import numpy as np
import pytest
from pydantic import ValidationError

from probe_agents.policies.catalogue import make_policy
from probe_env import Context, TaskConfig
from probe_env.envs.episodes import Episodes
from probe_env.envs.episodes.backend import StepRecord
from probe_env.envs.episodes.scoring import RoundTripScorer
from probe_env.envs.task.observations import in_si_units
from probe_env.envs.task.rules import uninspected_weight
from probe_env.fidelity import resolve_fidelity
from probe_env.files import FileError
from probe_env.inspection.metrics import TURN
from probe_env.physics.methods import METHODS
from probe_env.schedule import Schedule

SHORT = {"tube": {"helix_length": 8.0}}
BOTH = TaskConfig(passes="both", time_limit=1800.0)
SCORED = ("insertion", "withdrawal", "best")
HEAD = "inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h,return_feed_speed_m_per_s"
HARD = Context(friction=0.2, helix_diameter=1.0)


ONE = np.ones(1, dtype=bool)


def period_to(end):
    """A period of one probe that ends at an inserted length."""
    zero = np.zeros(1)
    return StepRecord(
        stepped=ONE, finite=ONE, length_before=ONE, length_after=np.array([end]), helix_length=np.array([9.0]),
        air=zero, seconds=zero, max_tension=zero, buckling_load=zero, window=None, signals={}, sensor_noise=zero,
    )  # fmt: skip


def started(scored_pass="best"):
    """Scorer of an inspection of 4 m from 5 m on."""
    scorer = RoundTripScorer(1, TaskConfig(passes="both", scored_pass=scored_pass), samples=False)
    scorer.begin(0, 5.0, 9.0, None)
    return scorer


def sums_of(scorer, end, squares):
    """Sums of a period: length, squares, within the limit, and the squares of a signal, here the same."""
    return scorer.sums_over_length(period_to(end), np.array([[1.0, squares, squares <= 1.0, squares, squares]]))[0, :4]


def round_trip(scored_pass, insertion, withdrawal):
    """Sums of a round trip in half metres, with squares for each metre of both passes."""
    scorer, total = started(scored_pass), np.zeros(4)
    for end in np.arange(5.5, 9.01, 0.5):
        total += sums_of(scorer, end, insertion[int(end - 5.25)])
    assert not scorer.complete(ONE, period_to(9.0)).any()
    for end in (*np.arange(8.5, 4.99, -0.5), 4.9):  # a little too far
        total += sums_of(scorer, end, withdrawal[max(int(end - 4.75), 0)])
    assert scorer.complete(~ONE, period_to(5.0)).all()
    return total.tolist()


def test_a_metre_is_scored_by_the_selected_pass():
    for scored_pass, expected in (
        ("insertion", [4.0, 0.5 + 0.9 + 4.0 + 9.0, 2.0, 14.4]),
        ("withdrawal", [4.0, 0.2 + 3.0 + 0.6 + 9.0, 2.0, 12.8]),
        ("best", [4.0, 0.2 + 0.9 + 0.6 + 9.0, 3.0, 10.7]),
    ):
        found = round_trip(scored_pass, (0.5, 0.9, 4.0, 9.0), (0.2, 3.0, 0.6, 9.0))
        assert found == pytest.approx(expected), scored_pass


def test_the_score_does_not_depend_on_the_division_into_periods():
    totals = []
    for steps in (8, 37):
        scorer, places = started(), np.linspace(5.0, 9.0, steps + 1)[1:]
        total = sum(sums_of(scorer, end, 2.0)[1] for end in places)
        scorer.complete(ONE, period_to(9.0))
        totals.append(total + sum(sums_of(scorer, end, 0.5)[1] for end in (*places[-2::-1], 5.0)))
    assert totals == pytest.approx([2.0, 2.0])


def test_uninspected_is_the_remaining_length_of_both_passes():
    """In 9 m from 5 m on, for every scored pass."""
    for scored_pass in SCORED:
        scorer, uninspected = started(scored_pass), []
        for end in (7.0, 8.9, 9.0, 8.0, 8.5, 6.0, 4.9):  # withdrawn, inserted again, and a little too far
            sums_of(scorer, end, 1.0)
            scorer.complete(ONE & (end == 9.0), period_to(end))
            uninspected.append(float(scorer.uninspected(period_to(end))[0]))
        assert uninspected == pytest.approx([2.0 + 4.0, 0.1 + 4.0, 4.0, 3.0, 3.0, 1.0, 0.0])


def play(back=0.4, **config):
    """An inspection of 8 m of helix at full feed in; the environment, all observations, infos and rewards."""
    env = gym.make("probe_env/Inspection-v0", fidelity="fast", scene=SHORT, config=config).unwrapped
    observation, info = env.reset(seed=3, options=HARD.model_dump())
    observations, infos, rewards, way, over = [observation], [info], [], 1.0, False
    while not over:
        action = env.config.action(0.4 if way > 0.0 else back, 63.0 / 3600.0)
        observation, reward, terminated, truncated, info = env.step(action)
        assert env.observation_space.contains(observation)
        observations.append(observation)
        infos.append(info)
        rewards.append(reward)
        way, over = info["direction"], terminated or truncated
    return env, np.array(observations), infos, rewards


def test_probe_that_stays_earns_less_than_one_that_returns():
    """With the time limit just before the turn, and after it."""
    for scored_pass in SCORED:
        whole = play(scored_pass=scored_pass)[2][-1]["episode_kpis"]["reward"]
        for seconds in (7.0, 12.0):
            env, _, infos, _ = play(scored_pass=scored_pass, time_limit=seconds)
            info, inserting = infos[-1], seconds < 7.5
            assert info["direction"] == (1.0 if inserting else -1.0)
            assert info["episode_kpis"]["complete"] == info["episode_kpis"]["lost_drive"] == 0.0
            uninspected = (8.0 - info["inserted_length"]) + 3.0 if inserting else info["inserted_length"] - 5.0
            expected = -uninspected_weight(env.config) * uninspected
            assert info["reward_terms"]["uninspected"] == pytest.approx(expected, rel=1e-5), (scored_pass, seconds)
            assert info["episode_kpis"]["reward"] < whole - 5.0, (scored_pass, seconds)


def test_probe_turns_at_the_end_and_returns():
    env, observations, infos, rewards = play()
    values = in_si_units(env.config, observations)
    lengths, way, speed = values["inserted_length"], values["direction"], np.abs(values["feed_speed"])
    assert way[0] == 1.0
    assert way[-1] == -1.0
    assert lengths.max() == pytest.approx(8.0)
    assert lengths[np.argmax(way < 0.0)] == pytest.approx(8.0)
    assert lengths[-1] <= 5.0 + 1e-5
    assert values["feed_speed"].max() == pytest.approx(0.4)
    assert values["feed_speed"].min() == pytest.approx(-0.4)
    assert values["air_supply_rate"].min() < -55.0 / 3600.0  # it lags
    kpis = infos[-1]["episode_kpis"]
    assert kpis["complete"] == 1.0
    assert kpis["inspected_m"] == pytest.approx(3.0)
    assert kpis["air_m3"] > 0.5 * 63.0 / 3600.0 * kpis["inspection_time_s"]  # in both directions
    assert kpis["reward"] == pytest.approx(sum(rewards))
    assert kpis["radial_max_m"] < 5.5e-3  # its rest position does not count as vibration
    steady = np.abs(np.diff(values["feed_speed"], prepend=0.0)) < 1e-6
    assert (values["root_tension"][(way > 0.0) & steady] > 1.0).all()  # tension on insertion
    assert (values["root_tension"][(way < 0.0) & steady][2:] < -1.0).all()  # compression on withdrawal
    # time-lapse is on insertion only
    steady = np.flatnonzero((speed[1:] == speed[:-1]) & (way[1:] == way[:-1])) + 1
    travelled = np.abs(np.diff(lengths))[steady[:-1] - 1]
    assert travelled == pytest.approx(0.4 * env.config.period, rel=1e-5)  # in either direction
    turned = sum(info["direction"] < 0.0 for info in infos[:-1])  # periods that began on withdrawal
    inserting = (len(infos) - 1 - turned) * env.config.period / 4.0
    time = env.config.settle_time + inserting + turned * env.config.period
    assert env.episodes.simulated().simulators[0].time == pytest.approx(time)


@pytest.mark.slow
def test_both_passes_detect_what_either_detects():
    """With half of the false calls each: at least the better pass, at most the sum of both."""
    curves = {}
    for scored_pass, calls in (("insertion", 0.05), ("withdrawal", 0.05), ("best", 0.1)):
        env, _, infos, _ = play(back=0.1, scored_pass=scored_pass, sensor={"false_calls": calls})
        curves[scored_pass] = infos[-1]["episode_kpis"]["pod"]
    detection = env.episodes.scorer.signals[0].detection
    back = [info["inserted_length"] for info in infos[1:] if info["direction"] < 0.0]
    better, sum_ = np.maximum(*(curves[name] for name in SCORED[:2])), sum(curves[name] for name in SCORED[:2])
    assert ((curves["best"] >= better - 1e-9) & (curves["best"] <= sum_ + 1e-9)).all()
    assert (curves["best"] > better + 1e-3).any()
    metres = {segment: sum(metrics.lengths) for segment, metrics in detection.segments.items()}
    assert metres["in"] == pytest.approx(3.0)
    assert metres["turn"] + metres["back"] == pytest.approx(3.0)
    assert metres["turn"] == pytest.approx(8.0 - back[round(TURN)], abs=1e-6)  # periods of a second, without time-lapse


def test_insertion_policies_withdraw_as_fast_as_possible(tmp_path):
    path = tmp_path / "mine.csv"
    path.write_text(f"{HEAD},return_air_supply_m3_per_h\n5,0.4,63,0.1,40\n60,0.2,100,0.3,90\n")
    config = BOTH.full_observation
    episodes = Episodes(1, config, fidelity="fast")
    observation, _ = episodes.reset([0], {0: np.random.default_rng(0)}, {0: {"context": HARD}})
    back = observation.copy()
    names = list(config.observations)
    back[:, names.index("direction")] = -1.0
    for name in ("feed_speed", "air_supply_rate", "root_tension"):
        back[:, names.index(name)] *= -1.0
    for spec, speed, air in (("pi", 0.4, 63.0), (str(path), 0.1, 40.0), ("tension-scheduled", 0.4, 63.0)):
        policy = make_policy(spec, config)
        both, _ = policy.predict(np.concatenate([observation, back]))
        alone, _ = policy.insertion.predict(np.delete(observation, names.index("direction"), axis=1))
        assert both[0] == pytest.approx(alone[0])
        feed, supply = config.targets(both)[1]
        assert feed == pytest.approx(speed, rel=1e-5)
        assert 3600.0 * supply == pytest.approx(air, rel=1e-5)
        assert policy.describe()["back"]["feed_speed"][0] == pytest.approx(speed)


def test_columns_of_withdrawal_go_together(tmp_path):
    path = tmp_path / "half.csv"
    path.write_text(f"{HEAD}\n5,0.4,63,0.1\n60,0.2,100,0.3\n")
    with pytest.raises(FileError, match=r"half\.csv: return_feed_speed_m_per_s and return_air_supply_m3_per_h go"):
        Schedule.read_withdrawal(path)
    assert Schedule.read_withdrawal("configs/schedules/example.csv") is None
    path.write_text(f"{HEAD},return_air_supply_m3_per_h\n5,0.4,63,9,63\n")
    with pytest.raises(FileError, match=r"line 2, return_feed_speed_m_per_s = 9\.0 is outside the accepted"):
        Schedule.read_withdrawal(path)


def test_methods_without_withdrawal_are_refused():
    for fidelity, message in (
        ("reference", "superelement does not simulate withdrawal; give one of standard, fast, study"),
        ("auto", "no errors are known for withdrawal"),
        ({"method": "imex32"}, "imex32 does not simulate withdrawal"),
    ):
        with pytest.raises(ValueError, match=message):
            gym.make("probe_env/Inspection-v0", fidelity=fidelity)
    assert resolve_fidelity("study", round_trip=True).method is METHODS["newmark"]
    with pytest.raises(ValidationError, match="needs growing = true"):
        TaskConfig(passes="both", growing=False)


def test_a_batch_equals_single_probes():
    """Bit for bit, with probes on insertion and on withdrawal in one batch."""
    config = TaskConfig(passes="both", scene=SHORT, time_limit=1800.0)
    actions = config.actions(np.array([0.4, 0.15]), np.full(2, 63.0 / 3600.0))
    many, alone, mixed = Episodes(2, config, fidelity="fast"), Episodes(1, config, fidelity="fast"), 0
    options = {0: {"context": HARD}, 1: {"context": HARD.model_copy(update={"friction": 0.1})}}
    many.reset([0, 1], {k: np.random.default_rng(k) for k in range(2)}, options)
    alone.reset([0], {0: np.random.default_rng(1)}, {0: options[1]})
    while many.running[1]:
        active = many.running.copy()
        step, single = many.step(actions, active), alone.step(actions[1:])
        mixed += bool(active.all() and np.ptp(many.direction))
        assert np.array_equal(single.observation[0], step.observation[1])
        np.testing.assert_equal(single.infos[0], step.infos[1])
        assert np.array_equal(alone.window.radial_of(0), many.window.radial_of(1))
    assert mixed
