"""Recommended schedules: optimal, within the device's ranges and steps, taut enough; the command and its refusals."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from probe_agents.cli import main
from probe_agents.evaluation.statistics import MAX_SECOND
from probe_agents.plant import recommendation
from probe_agents.plant.plc_export import recipe_of
from probe_agents.plant.recommendation import expected_costs, optimal_schedule
from probe_agents.plant.response import CHANNELS, Metres, stored_response
from probe_agents.policies.cases import load_case
from probe_agents.policies.catalogue import DATA
from probe_agents.policies.on_map import MARGIN, root_tensions
from probe_agents.policies.plc_law import PlantData
from probe_agents.records.tables import read_csv
from probe_env import Context, Plant
from probe_env.envs.plants import Bundle, FeedDevice, Supply, Tubes
from probe_env.scene import Probe
from probe_env.schedule import Schedule

RESPONSE = stored_response()
PLANT = Plant(
    tube=Tubes(inner_diameter=23e-3, helix_length=45.0),
    air=Supply(air_supply_rates=(0.0084, 0.034), air_supply_step=0.001),
    feed=FeedDevice(feed_speeds=(0.03, 0.35), feed_speed_step=0.005),
)
TUBES = [Context(friction=mu, helix_diameter=1.3) for mu in (0.12, 0.16, 0.2)]
TRAIN = load_case(None, "train")
CONFIG = TRAIN.config
TUBE = "[tube]\nhelix_length = 24.0\n[contact]\nfriction = { low = 0.1, high = 0.2 }\n"


def test_the_cheapest_path_is_that_of_all_paths():
    """Of 4 points at 6 places all 4096 paths were tried; a place may forbid some points."""
    rng = np.random.default_rng(0)
    staged, change = rng.random((6, 4)), rng.random((4, 4))
    staged[3, :3] = np.inf

    def cost(path):
        return sum(staged[k, p] for k, p in enumerate(path)) + sum(change[a, b] for a, b in itertools.pairwise(path))

    assert recommendation.cheapest_path(staged, change) == list(min(itertools.product(range(4), repeat=6), key=cost))


def test_recommended_schedule_fits_the_device():
    """Whole steps within the ranges, to the end of the helix, with the margin of the root tension."""
    config = PLANT.configured()
    optimum = optimal_schedule(TUBES, RESPONSE, config)
    schedule = optimum.schedule
    assert schedule.position[-1] == 45.0
    for values, low, high, step in ((schedule.feed_speed, 0.03, 0.35, 0.005),
                                    (schedule.air_supply_rate, 0.0084, 0.034, 0.001)):  # fmt: skip
        assert low <= min(values) <= max(values) <= high
        np.testing.assert_allclose(np.array(values) / step, np.round(np.array(values) / step), atol=1e-9)
    assert optimum.tension >= MARGIN * config.required_tension


def test_recommended_air_changes_no_faster_than_the_compressor():
    """Between two points at most the ramp times the time at the faster feed; without the limit the air is faster."""

    def most(config):
        schedule = optimal_schedule(TUBES, RESPONSE, config).schedule
        length, feed, air = map(np.array, (schedule.position, schedule.feed_speed, schedule.air_supply_rate))
        seconds = np.diff(length) / np.maximum(feed[1:], feed[:-1])
        return (np.abs(np.diff(air)) / seconds).max()

    free, ramp = Plant().config, 2.0 / 3600.0
    assert most(free) > ramp >= most(free.model_copy(update={"air_ramp": ramp})) - 1e-9


def test_recommended_schedule_beats_shipped_and_near_ones():
    """No constant change of its feed is expected to be better by more than the price on change could hide."""
    config = Plant().configured()
    schedule = optimal_schedule(TUBES, RESPONSE, config).schedule
    lengths = np.arange(5.5, 60.0)

    def cost(feed, air):
        return expected_costs(TUBES, RESPONSE, config, Metres(lengths, feed, air, {})).mean()

    feed, air = schedule.at(lengths)
    changed = [cost(np.clip(factor * feed, *config.feed_speeds), air) for factor in (0.7, 1.4)]
    assert cost(feed, air) < min(cost(*Schedule.read(DATA / "best-schedule.csv").at(lengths)), *changed)
    # at 40 m the probe rings with a friction of 0.25 and not with 0.08
    slippery, rough = (
        optimal_schedule([Context(friction=mu)], RESPONSE, config).schedule.at(40.0)[0] for mu in (0.08, 0.25)
    )
    assert rough < 0.7 * slippery


def test_search_by_hours_finds_less_than_the_search_by_reward():
    """Total times by their definition, from the response: (time and what is added) (1 + fraction of second passes).

    The more a pass costs, the fewer second passes; half of the tubes at most, as in the ranking.
    """
    config = PLANT.config
    column = CHANNELS.index("rf_noise_rms")

    def total(schedule, added):
        lengths, spacing = np.array(schedule.position), np.array([1.25, *[2.5] * 15, 1.25])
        metres, quiet = Metres(lengths, *schedule.at(lengths), {}), []
        for tube in TUBES:
            scene = config.scene.model_copy(update={"tube": {"helix_diameter": tube.helix_diameter}})
            row = [[tube.friction, tube.contact_stiffness, scene.air.drag_coefficient, scene.probe.damping_time]]
            mean, spread = (values[0, :, column] for values in RESPONSE.predict(np.array(row), metres, scene))
            quiet.append(np.prod(norm.cdf((np.log10(config.limit) - mean) / spread) ** spacing))
        return (added + (spacing / metres.feed).sum()) * (2.0 - np.mean(quiet))

    by_reward = optimal_schedule(TUBES, RESPONSE, config)
    assert np.isnan(by_reward.total)
    fractions = []
    for setup_time in (0.0, 3000.0):
        bundle = Bundle(tubes=9, setup_time=setup_time, withdrawal_time=100.0)
        optimum = optimal_schedule(TUBES, RESPONSE, config, bundle=bundle)
        assert optimum.total == pytest.approx(total(optimum.schedule, setup_time + 100.0), rel=1e-6)
        assert optimum.total < total(by_reward.schedule, setup_time + 100.0)
        fractions.append(optimum.again)
    assert MAX_SECOND > fractions[0] > fractions[1]


def test_interval_of_the_expected_reward():
    """That of two equal tubes is their reward; of different ones it holds the mean."""
    config = Plant().configured()
    alone, twice, different = (optimal_schedule(tubes, RESPONSE, config) for tubes in (TUBES[:1], TUBES[:1] * 2, TUBES))
    assert alone.interval == pytest.approx((alone.reward, alone.reward))
    assert (twice.reward, *twice.interval) == pytest.approx((alone.reward,) * 3)
    low, high = different.interval
    assert low < different.reward < high
    lengths = np.array(different.schedule.position)
    feed, air = (np.array(v) for v in (different.schedule.feed_speed, different.schedule.air_supply_rate))
    costs = expected_costs(TUBES, RESPONSE, config, Metres(lengths, feed, air, {}))
    spacing = np.diff(lengths, prepend=lengths[0], append=lengths[-1])
    rewards = (config.progress_weight - costs) @ (0.5 * (spacing[1:] + spacing[:-1]))
    assert (low, high) == pytest.approx(np.quantile(rewards, [0.05, 0.95]))


def test_sensitivity_of_values_that_are_not_measured():
    """Friction and stiffness of the default plant; more friction and a softer contact vibrate more, see the response.

    At 0.2 m/s and 63 m3/h the vibration at 30 m is that of the response; what is in the file or calibrated is left out.
    """
    config, schedule = Plant().config, Schedule("inserted_length", "linear", (5.0, 60.0), (0.2, 0.2), (0.0175, 0.0175))
    header, *rows = recommendation.sensitivity(None, TUBES, schedule, RESPONSE, config)
    assert header[1] == "vibration at 30 m over its limit"
    for row in rows:
        for cell in row[1:]:
            low, high = map(float, cell.split(" to "))
            assert low < high
    scene, place = config.scene, Metres(np.array([30.0]), np.array([0.2]), np.array([0.0175]), {})
    stiff = np.array([[0.15, 2e5, scene.air.drag_coefficient, scene.probe.damping_time]])
    level = 10.0 ** RESPONSE.predict(stiff, place, scene)[0][0, 0, CHANNELS.index("rf_noise_rms")] / config.limit
    tube = Context(friction=0.15, helix_diameter=scene.tube.helix_diameter)
    alone = recommendation.sensitivity(None, [tube], schedule, RESPONSE, config)[2]
    assert alone[1].startswith(f"{level:.2g} to ")
    measured = Plant(contact={"friction": 0.15})
    assert [row[0] for row in recommendation.sensitivity(measured, TUBES, schedule, RESPONSE, config)] == [
        "not measured",
        "contact stiffness x2 to /2",
    ]
    both = Plant(contact={"friction": 0.15}, posterior={"contact_stiffness": (1e5, 1.1e5)})
    assert recommendation.sensitivity(both, TUBES, schedule, RESPONSE, config) == ()


def test_plants_without_an_answer_are_refused():
    """In one line with the field and its value: too little air, or a vibration that the response does not have."""
    weak = Plant(air=Supply(air_supply_rates=(0.002, 0.004)), task={"required_tension": 5.0})
    with pytest.raises(ValueError, match=r"air_supply_rates: the max, 14.4 m3/h, gives .* 7.5 N are needed"):
        optimal_schedule([Context(friction=0.3)], RESPONSE, weak.configured())
    loud = Plant(task={"vibration_measure": "acceleration"}).configured()
    assert optimal_schedule(TUBES, RESPONSE, loud).schedule.position[-1] == 60.0
    with pytest.raises(ValueError, match=r"task.vibration_measure = 'velocity': recommendations support displacement"):
        optimal_schedule(TUBES, RESPONSE, Plant(task={"vibration_measure": "velocity"}).configured())


def test_feeds_end_at_the_speed_that_the_instrument_permits():
    """54 Hz / 4 x 20 mm / 2 = 0.135 m/s; without it the first metres are faster. In the PLC's law, too."""
    limited = Plant.model_validate(PLANT.model_dump() | {"instrument": {"test_frequency": 54.0}}).config
    best, held = (optimal_schedule(TUBES, RESPONSE, config) for config in (PLANT.config, limited))
    assert max(best.schedule.feed_speed) > 0.3
    assert max(held.schedule.feed_speed) == pytest.approx(0.135)
    assert held.reward < best.reward
    assert PlantData.of(limited).feed_speeds == pytest.approx((0.03, 0.135))


def test_recommended_air_carries_the_probe_through_the_route():
    """With 1.5 times the drag that 12 m of rising tube need where lost drive is not scored yet, then by the tension."""
    tables = PLANT.model_dump() | {"assumptions": "study", "route": ({"length": 12.0, "slope": 90.0}, {"helix": True})}
    plant = Plant.model_validate(tables)
    config = plant.config
    air = recommendation.route_air(plant, TUBES)
    assert air**2 / plant.check_route(TUBES) ** 2 == pytest.approx(MARGIN)
    free = optimal_schedule(TUBES, RESPONSE, config).schedule
    optimum = optimal_schedule(TUBES, RESPONSE, config, air)
    early = np.array(optimum.schedule.position) < config.lost_drive_from
    assert min(free.air_supply_rate) < air <= min(np.array(optimum.schedule.air_supply_rate)[early])
    assert optimum.tension >= MARGIN * config.required_tension > 1.5 * 3.0
    assert recipe_of(plant).air_supply_rate[0] >= air
    assert recommendation.route_air(None, TUBES) == recommendation.route_air(PLANT, TUBES) == 0.0
    # at the median friction of 0.5 the air carries the probe through a level part, q > mu w; at 0.86 it does not
    rough, level = {"friction": {"low": 0.1, "high": 0.9}}, ({"length": 3.0}, {"helix": True})
    limited = {"assumptions": "study", "air": {"air_supply_rates": (0.008, 0.0145)}}
    hard = Plant.model_validate(limited | {"contact": rough, "route": level})
    assert "route.0: the probe stops with its tip 0.5 m" in str(recipe_of(hard))


def test_the_example_plant_keeps_its_drive():
    """At its most air and permitted feed, with the margin in all of 96 tubes."""
    plant = Plant.from_toml(Path(__file__).parents[2] / "configs/tubes/example.toml")
    config, lengths = plant.config, np.arange(plant.config.lost_drive_from, 45.5)
    (feed, air), shape = config.feasible(config.permitted_feed, config.air_supply_rates[1])[0], len(lengths)
    pulls = root_tensions(plant.contexts(96), config, lengths, np.full(shape, feed), np.full(shape, air))
    assert pulls.min() > MARGIN * config.required_tension


def test_values_outside_the_training_ranges_are_reported():
    """Bore, friction and probe, each with value and range; nothing within them."""
    assert recommendation.outside_training(TUBES, RESPONSE, PLANT.configured()) == []
    odd = Plant(tube=Tubes(inner_diameter=28e-3), probe=Probe(line_density=0.13)).configured()
    texts = "; ".join(recommendation.outside_training([Context(friction=0.4)], RESPONSE, odd))
    for text in ("floats 0.009 to 0.009 m, beyond", "probe with different line_density", "friction 0.4 to 0.4, beyond"):
        assert text in texts


@pytest.fixture
def written(tmp_path, monkeypatch):
    """The command for a tube's file in the working folder."""
    monkeypatch.chdir(tmp_path)
    Path("tube.toml").write_text(TUBE)
    return ["recommend", "--tube", "tube.toml", "--output", "my.csv"]


@pytest.mark.slow
def test_recommended_schedule_is_compared_in_simulation(written):
    """With one of the user's own, on tubes of the plant."""
    own = "inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n5,0.3,63\n24,0.2,63\n"
    Path("own.csv").write_text(own)
    assert main([*written, "own.csv", "--limit", "2", "--policy", "law.json", "--fidelity", "fast"]) == 0
    assert Schedule.read("my.csv").position[-1] == 24.0
    episodes = read_csv(Path("my-confirmed/episodes.csv"))
    assert set(episodes["policy"]) == {"recommended", "recommended-law", "own", "best-schedule", "tension-scheduled"}
    assert (episodes.groupby("policy").size() == 2).all()
    assert "recommended" in Path("my-confirmed/report.html").read_text()


def test_recommendation_without_simulation(written, capsys):
    """The schedule and how it was found, and no folder of episodes."""
    arguments = [*written, "--no-simulated"]
    assert main(arguments) == 0
    assert Schedule.read("my.csv").position[-1] == 24.0
    record = json.loads(Path("my.json").read_text())
    assert record["least_root_tension_n"] >= 1.2
    assert record["expected_reward_low"] < record["expected_reward"] < record["expected_reward_high"]
    assert not record["calibrated"]
    assert sorted(map(str, Path().iterdir())) == ["my.csv", "my.json", "tube.toml"]
    printed = capsys.readouterr().out
    interval = "90 % of 96 samples: {expected_reward_low:.1f} to {expected_reward_high:.1f})".format(**record)
    assert f"expected reward {record['expected_reward']:.1f} ({interval}; searched by reward; drive safe" in printed
    assert "withdrawal" not in printed
    Path("tube.toml").write_text(TUBE + '[task]\npasses = "both"\n')
    assert main(arguments) == 0
    assert "my is for the insertion; the withdrawal is at the fastest feed" in capsys.readouterr().out


@pytest.mark.filterwarnings("ignore:.*the calibration is misspecified")
@pytest.mark.parametrize("misspecified", [False, True])
def test_misspecified_calibration_needs_the_option_anyway(misspecified, written, capsys):
    Path("c.json").write_text(json.dumps({"misspecified": misspecified, "draws": {"friction": [0.12, 0.15]}}))
    Path("tube.toml").write_text(f'posterior = "c.json"\n{TUBE}')
    assert (main([*written, "--no-simulated"]) == 0) == Path("my.csv").exists() == (not misspecified)
    assert ("tube.toml: posterior: the calibration is misspecified" in capsys.readouterr().err) == misspecified
    assert main([*written, "--no-simulated", "--anyway"]) == 0
