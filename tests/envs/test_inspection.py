"""In and back: what a metre counts for, when the probe turns and ends, and policies of both passes."""

import gymnasium as gym
import numpy as np
import pytest
from pydantic import ValidationError

from agents.policies.catalogue import make_policy
from probe_env import Context, TaskConfig
from probe_env.envs.episodes import Episodes
from probe_env.envs.episodes.scoring import RoundTripScorer, StepRecord
from probe_env.envs.task import uninspected_weight
from probe_env.envs.task.observations import in_si_units
from probe_env.fidelity import resolve_fidelity
from probe_env.files import FileError
from probe_env.inspection.metrics import POD_NAMES, TURN
from probe_env.schedule import Schedule

SHORT = {"tube": {"helix_length": 8.0}}
BOTH = TaskConfig(passes="both", time_limit=1800.0)
LOOKS = ("in", "back", "best")
HARD = Context(friction=0.2, helix_diameter=1.0)


ONE = np.ones(1, dtype=bool)


def at(end):
    """A period of one probe that ends at an inserted length."""
    zero = np.zeros(1)
    return StepRecord(
        stepped=ONE, good=ONE, before=ONE, after=np.array([end]), helix_length=np.array([9.0]), air=zero, seconds=zero,
        action_change=zero, buckling_load=zero, window=None, signals={},
    )  # fmt: skip


def begun(inspects="best"):
    """Scorer of an inspection of 4 m from 5 m on."""
    scorer = RoundTripScorer(1, TaskConfig(passes="both", inspects=inspects))
    scorer.begin(0, 5.0, 9.0)
    return scorer


def counted(scorer, end, squares):
    """Sums that a period adds: length, squares, within the limit, and a signal's squares, here the same ones."""
    return scorer.count(at(end), np.array([[1.0, squares, squares <= 1.0, squares, squares]]))[0, :4]


def shown(inspects, way_in, way_back):
    """Sums of an inspection in half metres, with squares for each metre of both ways."""
    scorer, total = begun(inspects), np.zeros(4)
    for end in np.arange(5.5, 9.01, 0.5):
        total += counted(scorer, end, way_in[int(end - 5.25)])
    assert not scorer.complete(ONE, at(9.0)).any()
    for end in (*np.arange(8.5, 4.99, -0.5), 4.9):  # a little too far
        total += counted(scorer, end, way_back[max(int(end - 4.75), 0)])
    assert scorer.complete(~ONE, at(5.0)).all()
    return total.tolist()


def test_a_metre_counts_for_what_the_task_says():
    for inspects, expected in (
        ("in", [4.0, 0.5 + 2.0 + 4.0 + 9.0, 1.0, 15.5]),
        ("back", [4.0, 0.2 + 3.0 + 0.6 + 9.0, 2.0, 12.8]),
        ("best", [4.0, 0.2 + 2.0 + 0.6 + 9.0, 2.0, 11.8]),
    ):
        assert shown(inspects, (0.5, 2.0, 4.0, 9.0), (0.2, 3.0, 0.6, 9.0)) == pytest.approx(expected), inspects


def test_a_metre_may_be_cut_anywhere():
    """The better of both, metre by metre, does not depend on the periods' lengths."""
    totals = []
    for steps in (8, 37):
        scorer, places = begun(), np.linspace(5.0, 9.0, steps + 1)[1:]
        total = sum(counted(scorer, end, 2.0)[1] for end in places)
        scorer.complete(ONE, at(9.0))
        totals.append(total + sum(counted(scorer, end, 0.5)[1] for end in (*places[-2::-1], 5.0)))
    assert totals == pytest.approx([2.0, 2.0])


def test_a_probe_owes_both_ways_until_it_is_back():
    """In 9 m from 5 m on: what is left to feed in and to draw back, whatever counts."""
    for inspects in LOOKS:
        scorer, owed = begun(inspects), []
        for end in (7.0, 8.9, 9.0, 8.0, 8.5, 6.0, 4.9):  # drawn back, some of the way in again, and a little too far
            counted(scorer, end, 1.0)
            scorer.complete(ONE & (end == 9.0), at(end))
            owed.append(float(scorer.uninspected(at(end))[0]))
        assert owed == pytest.approx([2.0 + 4.0, 0.1 + 4.0, 4.0, 3.0, 3.0, 1.0, 0.0])


def play(back=0.4, **config):
    """An inspection of 8 m of helix at full feed in; the environment, all observations, infos and rewards."""
    env = gym.make("probe_env/Inspection-v0", fidelity="fast", scene=SHORT, config=config).unwrapped
    observation, info = env.reset(seed=3, options=HARD.model_dump())
    seen, infos, rewards, way, over = [observation], [info], [], 1.0, False
    while not over:
        observation, reward, terminated, truncated, info = env.step(
            env.config.action(0.4 if way > 0.0 else back, 63.0 / 3600.0)
        )
        assert env.observation_space.contains(observation)
        seen.append(observation)
        infos.append(info)
        rewards.append(reward)
        way, over = info["way"], terminated or truncated
    return env, np.array(seen), infos, rewards


@pytest.fixture(scope="module")
def played():
    return play()


def test_a_probe_that_is_left_in_the_tube_earns_less_than_one_that_comes_back():
    """Time is up just before the turn, and after it: what it saves is less than what it owes."""
    for inspects in LOOKS:
        whole = play(inspects=inspects)[2][-1]["episode_kpis"]["reward"]
        for seconds in (7.0, 12.0):
            env, _, infos, _ = play(inspects=inspects, time_limit=seconds)
            info, forth = infos[-1], seconds < 7.5
            assert info["way"] == (1.0 if forth else -1.0)
            assert info["episode_kpis"]["complete"] == info["episode_kpis"]["lost_drive"] == 0.0
            owed = (8.0 - info["inserted_length"]) + 3.0 if forth else info["inserted_length"] - 5.0
            expected = -uninspected_weight(env.config) * owed
            assert info["reward_terms"]["uninspected"] == pytest.approx(expected, rel=1e-5), (inspects, seconds)
            assert info["episode_kpis"]["reward"] < whole - 5.0, (inspects, seconds)


def test_the_probe_turns_at_the_end_and_ends_where_it_began(played):
    env, seen, infos, rewards = played
    values = in_si_units(env.config, seen)
    lengths, way = values["inserted_length"], values["way"]
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
    assert kpis["air_m3"] > 0.5 * 63.0 / 3600.0 * kpis["inspection_time_s"]  # blown both ways
    assert kpis["reward"] == pytest.approx(sum(rewards))
    assert kpis["radial_max_m"] < 5.5e-3  # where it rests does not count as vibration
    steady = np.abs(np.diff(values["feed_speed"], prepend=0.0)) < 1e-6
    assert (values["root_tension"][(way > 0.0) & steady] > 1.0).all()  # pulled in
    assert (values["root_tension"][(way < 0.0) & steady][2:] < -1.0).all()  # pressed out


@pytest.mark.slow
def test_both_ways_find_what_either_finds():
    """With half of the false calls for each alone: at least what the better one finds, at most the sum of both."""
    curves = {}
    for inspects, calls in (("in", 0.05), ("back", 0.05), ("best", 0.1)):
        env, _, infos, _ = play(back=0.1, inspects=inspects, sensor={"false_calls": calls})
        curves[inspects] = np.array([infos[-1]["episode_kpis"][name] for name in POD_NAMES])
    detection = env.episodes.scorer.metrics[0].detection
    back = [info["inserted_length"] for info in infos[1:] if info["way"] < 0.0]
    better, sum_ = np.maximum(curves["in"], curves["back"]), curves["in"] + curves["back"]
    assert ((curves["best"] >= better - 1e-9) & (curves["best"] <= sum_ + 1e-9)).all()
    assert (curves["best"] > better + 1e-3).any()
    metres = {stretch: sum(tally.lengths) for stretch, tally in detection.tallies.items()}
    assert metres["in"] == pytest.approx(3.0)
    assert metres["turn"] + metres["back"] == pytest.approx(3.0)
    assert metres["turn"] == pytest.approx(8.0 - back[round(TURN)], abs=1e-6)  # periods of a second, without time-lapse


def test_policies_of_the_way_in_come_back_as_fast_as_they_can(tmp_path):
    path = tmp_path / "mine.csv"
    path.write_text(
        "inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h,return_feed_speed_m_per_s,return_air_supply_m3_per_h\n"
        "5,0.4,63,0.1,40\n60,0.2,100,0.3,90\n"
    )
    config = BOTH.full_observation
    episodes = Episodes(1, config, fidelity="fast")
    observation, _ = episodes.reset([0], {0: np.random.default_rng(0)}, {0: {"context": HARD}})
    back = observation.copy()
    names = list(config.observations)
    back[:, names.index("way")] = -1.0
    for name in ("feed_speed", "air_supply_rate", "root_tension"):
        back[:, names.index(name)] *= -1.0
    for spec, speed, air in (("pi", 0.4, 63.0), (str(path), 0.1, 40.0), ("tension-scheduled", 0.4, 63.0)):
        policy = make_policy(spec, config)
        both, _ = policy.predict(np.concatenate([observation, back]))
        alone, _ = policy.forth.predict(np.delete(observation, names.index("way"), axis=1))
        assert both[0] == pytest.approx(alone[0])
        feed, supply = config.targets(both)[1]
        assert feed == pytest.approx(speed, rel=1e-5)
        assert 3600.0 * supply == pytest.approx(air, rel=1e-5)
        assert policy.describe()["back"]["feed_speed"][0] == pytest.approx(speed)


def test_columns_of_the_way_back_go_together(tmp_path):
    path = tmp_path / "half.csv"
    head = "inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h,return_feed_speed_m_per_s"
    path.write_text(f"{head}\n5,0.4,63,0.1\n60,0.2,100,0.3\n")
    with pytest.raises(FileError, match=r"half\.csv: return_feed_speed_m_per_s and return_air_supply_m3_per_h go"):
        Schedule.read_back(path)
    assert Schedule.read_back("configs/schedules/example.csv") is None
    path.write_text(f"{head},return_air_supply_m3_per_h\n5,0.4,63,9,63\n")
    with pytest.raises(FileError, match=r"line 2, return_feed_speed_m_per_s = 9\.0 is outside the accepted"):
        Schedule.read_back(path)


def test_what_does_not_simulate_the_way_back_is_refused():
    for fidelity, message in (
        ("reference", "superelement does not simulate the way back; give one of standard, fast, study"),
        ("auto", "nothing was measured on the way back"),
        ({"method": "imex32"}, "imex32 does not simulate the way back"),
    ):
        with pytest.raises(ValueError, match=message):
            gym.make("probe_env/Inspection-v0", fidelity=fidelity)
    assert resolve_fidelity("study", both_ways=True).method == "newmark"
    with pytest.raises(ValidationError, match="needs growing = true"):
        TaskConfig(passes="both", growing=False)


class TestTimeLapse:
    """On the way in alone."""

    def test_way_back_has_none(self, played):
        env, seen, infos, _ = played
        values = in_si_units(env.config, seen)
        speed = np.abs(values["feed_speed"])
        steady = np.flatnonzero((speed[1:] == speed[:-1]) & (values["way"][1:] == values["way"][:-1])) + 1
        travelled = np.abs(np.diff(values["inserted_length"]))[steady[:-1] - 1]
        assert travelled == pytest.approx(0.4 * env.config.period, rel=1e-5)  # a clock of the shift's own either way
        simulator = env.episodes.batch.simulators[0]
        turned = sum(info["way"] < 0.0 for info in infos[:-1])  # periods that began on the way back
        settled = env.config.settle_time
        forth = (len(infos) - 1 - turned) * env.config.period / 4.0
        assert simulator.time == pytest.approx(settled + forth + turned * env.config.period)

    def test_side_by_side_as_alone(self):
        """Bit for bit, where some probes are on the way back and others on the way in, for other times of motion."""
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
            assert single.infos[0] == step.infos[1]
            assert np.array_equal(alone.window.radial_of(0), many.window.radial_of(1))
        assert mixed

    def test_period_must_fit_both_ways(self):
        fidelity = {"method": "imex", "time_step": 2e-4, "time_lapse": 2.5}
        with pytest.raises(ValueError, match=r"config\.period = 0\.0125 s is not a whole number"):
            Episodes(1, TaskConfig(passes="both", period=0.0125), fidelity=fidelity)
