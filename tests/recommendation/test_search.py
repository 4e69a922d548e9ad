"""The recommended schedule: the cheapest path by any other way, within the device's ranges and steps, taut enough."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from agents.plant.recommendation import MARGIN, beyond, cheapest_path, expected_reward, recommended
from agents.plant.response import stored_response
from agents.policies.catalogue import DATA
from probe_env import Context, Plant
from probe_env.envs.plants.tables import FeedDevice, Supply, Tubes
from probe_env.scene import Probe
from probe_env.schedule import Schedule

PLANT = Plant(
    tube=Tubes(inner_diameter=23e-3, helix_length=45.0),
    air=Supply(air_supply_rates=(0.0084, 0.034), air_supply_step=0.001),
    feed=FeedDevice(feed_speeds=(0.03, 0.35), feed_speed_step=0.005),
)
TUBES = [Context(friction=mu, helix_diameter=1.3) for mu in (0.12, 0.16, 0.2)]


def test_the_cheapest_path_is_that_of_all_paths() -> None:
    """Of 4 points at 6 places all 4096 paths were tried; a place may forbid some points."""
    rng = np.random.default_rng(0)
    staged, change = rng.random((6, 4)), rng.random((4, 4))
    staged[3, :3] = np.inf
    paths = list(itertools.product(range(4), repeat=6))
    costs = [
        sum(staged[k, p] for k, p in enumerate(path)) + sum(change[a, b] for a, b in itertools.pairwise(path))
        for path in paths
    ]
    assert cheapest_path(staged, change) == list(paths[int(np.argmin(costs))])


def test_it_is_what_the_device_can_do_and_keeps_the_drive() -> None:
    """Whole steps within the ranges, to the end of the helix, with the margin of the root tension."""
    config = PLANT.configured()
    recommendation = recommended(TUBES, stored_response(), config)
    feed, air = np.array(recommendation.schedule.feed_speed), np.array(recommendation.schedule.air_supply_rate)
    assert recommendation.schedule.position[-1] == 45.0
    assert ((feed >= 0.03) & (feed <= 0.35)).all()
    assert ((air >= 0.0084) & (air <= 0.034)).all()
    np.testing.assert_allclose(feed / 0.005, np.round(feed / 0.005), atol=1e-9)
    np.testing.assert_allclose(air / 0.001, np.round(air / 0.001), atol=1e-9)
    assert recommendation.tension >= MARGIN * config.required_tension


def test_it_is_expected_to_beat_what_ships_and_what_is_near() -> None:
    """No constant change of its feed or air is expected to be better by more than the price on change could hide."""
    config, response = Plant().configured(), stored_response()
    recommendation = recommended(TUBES, response, config)
    own = expected_reward(recommendation.schedule, TUBES, response, config)
    best = Schedule.read(DATA / "best-schedule.csv")
    assert own > expected_reward(best, TUBES, response, config)
    low, high = config.feed_speeds
    for factor in (0.7, 1.4):
        feed = tuple(float(np.clip(factor * v, low, high)) for v in recommendation.schedule.feed_speed)
        other = Schedule(
            "inserted_length", "linear", recommendation.schedule.position, feed, recommendation.schedule.air_supply_rate
        )
        assert own > expected_reward(other, TUBES, response, config)


def test_more_friction_is_fed_more_slowly() -> None:
    """At 40 m the probe rings with a friction of 0.25 and not with 0.08."""
    config, response = Plant().configured(), stored_response()
    slippery, rough = (
        recommended([Context(friction=mu)], response, config).schedule.at(40.0)[0] for mu in (0.08, 0.25)
    )
    assert rough < 0.7 * slippery


def test_air_that_cannot_keep_the_drive_is_refused() -> None:
    """In one line with the field, the tension and what is needed."""
    weak = Plant(air=Supply(air_supply_rates=(0.002, 0.004)), task={"required_tension": 5.0})
    with pytest.raises(ValueError, match=r"air_supply_rates = .*root tension at .* and 7.5 N are needed"):
        recommended([Context(friction=0.3)], stored_response(), weak.configured())


def test_what_was_not_learnt_is_said() -> None:
    """Bore, length, friction and probe beyond those of the bank, each with value and range; nothing within it."""
    response = stored_response()
    assert beyond(TUBES, response, PLANT.configured()) == []
    odd = Plant(tube=Tubes(inner_diameter=28e-3), probe=Probe(line_density=0.13)).configured()
    sentences = "; ".join(beyond([Context(friction=0.4)], response, odd))
    assert "radial room of the floats 0.009 to 0.009 m, beyond" in sentences
    assert "a probe of another line_density" in sentences
    assert "friction 0.4 to 0.4, beyond 0.05 to 0.35" in sentences


def test_another_measure_is_known_or_refused() -> None:
    """Acceleration is a channel of the response; velocity is none."""
    response = stored_response()
    loud = Plant(task={"vibration_measure": "acceleration"}).configured()
    assert recommended(TUBES, response, loud).schedule.position[-1] == 60.0
    with pytest.raises(ValueError, match=r"task.vibration_measure = 'velocity'"):
        recommended(TUBES, response, Plant(task={"vibration_measure": "velocity"}).configured())
