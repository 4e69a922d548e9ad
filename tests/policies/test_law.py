"""A feedback law: what its table says between its rows, made for a plant, read from a file or refused."""

import json
from typing import Any

import numpy as np
import pytest

from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.plant.recommendation import optimal_law, optimal_schedule
from probe_agents.plant.response import stored_response
from probe_agents.policies.catalogue import named_policies
from probe_agents.policies.law import Law, LawPolicy
from probe_env import Context, Plant, Scene, TaskConfig
from probe_env.fidelity import PRESETS
from probe_env.physics.closed_forms import entrance_tension, sliding_tension

GIVEN: dict[str, Any] = {
    "scene": {},
    "ranges": {"friction": [0.1, 0.2], "contact_stiffness": [1e5, 1e5], "drag_factor": [1.0, 1.0],
               "helix_diameter": [1.0, 1.4]},
    "friction": [0.1, 0.2],
    "inserted_length": [5.0, 60.0],
    "tables": [
        {"helix_diameter": 1.0,
         "feed_speed": [[0.4, 0.2], [0.3, 0.1]], "air_supply_rate": [[0.02, 0.02], [0.03, 0.03]]},
        {"helix_diameter": 1.4,
         "feed_speed": [[0.4, 0.4], [0.4, 0.4]], "air_supply_rate": [[0.01, 0.01], [0.01, 0.01]]},
    ],
}  # fmt: skip


def test_law_is_linear_between_frictions_and_lengths(tmp_path):
    """Half-way in both is the mean of four; beyond its ends it is constant; the nearest diameter counts."""
    (tmp_path / "law.json").write_text(json.dumps(GIVEN))
    places = np.array([[0.15, 0.1, 0.5, 0.15], [32.5, 5.0, 70.0, 32.5], [1.0, 1.1, 1.15, 1.3]])
    feed, air = Law.read(tmp_path / "law.json").at(*places)
    np.testing.assert_allclose(feed, [0.25, 0.4, 0.1, 0.4])
    np.testing.assert_allclose(air, [0.025, 0.02, 0.03, 0.01])


def test_invalid_laws_are_refused(tmp_path):
    path, failures = tmp_path / "law.json", []
    for change, problem in (
        ({"friction": [0.2, 0.1]}, "friction must ascend"),
        ({"friction": [0.1, 0.15, 0.2]}, "tables.0.feed_speed: must have 3 rows"),
        ({"inserted_length": [5.0]}, "inserted_length"),
        ({"tables": []}, "tables"),
        ({"extra": 1}, "extra"),
        ({"ranges": GIVEN["ranges"] | {"foo": [1.0, 2.0]}}, "foo"),
        ({"ranges": GIVEN["ranges"] | {"friction": [0.3, 0.1]}}, "friction"),
        ({"friction": [float("nan"), 0.3]}, "friction"),
        ({"tables": [GIVEN["tables"][0] | {"feed_speed": [[float("nan"), 0.2], [0.3, 0.1]]}]}, "feed_speed"),
        ({"tables": [GIVEN["tables"][0] | {"feed_speed": [[0.4, 9.0], [0.3, 0.1]]}]}, "a value is outside"),
        (None, "not JSON"),
    ):
        path.write_text(json.dumps(GIVEN | change) if change else "feed = 1")
        with pytest.raises(ValueError, match=r"law\.json") as error:
            named_policies([f"mine={path}"], TaskConfig().full_observation)
        failures += [] if problem in str(error.value) and "\n" not in str(error.value) else [problem]
    assert failures == []


def test_its_rows_are_recommendations():
    """A row is what is recommended for draws with its friction; the frictions reach around those of the draws."""
    config, response = Plant().configured(), stored_response()
    tubes = [Context(friction=mu) for mu in (0.13, 0.17)]
    law = optimal_law(tubes, response, config)
    assert law.friction == (0.12, 0.14, 0.16, 0.18)
    alike = [tube.model_copy(update={"friction": 0.14}) for tube in tubes]
    assert law.tables[0].feed_speed[1] == optimal_schedule(alike, response, config).schedule.feed_speed
    assert law.scene == config.scene
    assert Law.model_validate_json(law.model_dump_json()) == law


CONFIG = TaskConfig().full_observation
FLAT: dict[str, Any] = {
    "scene": Scene(), "ranges": {}, "inserted_length": (5.0, 60.0), "friction": (0.1, 0.2),
    "tables": ({"helix_diameter": 1.2, "feed_speed": ((0.3, 0.3), (0.1, 0.1)),
                "air_supply_rate": ((0.0175, 0.0175),) * 2},),
}  # fmt: skip
POLICY = LawPolicy(CONFIG, law=Law.model_validate(FLAT))
"""0.3 m/s at a friction of 0.1, 0.1 m/s at 0.2."""


def test_law_settles_on_the_friction_of_steady_sliding():
    """From the middle of its rows with its time constant: after 15 s 1 - 1/e of the way."""
    memory = np.zeros((2, 1))
    POLICY.start(memory)
    rest = {"inserted_length": 40.0, "feed_speed": 0.2, "air_supply_rate": 0.0175, "helix_diameter": 1.2}
    seen = {name: np.full(2, value) for name, value in rest.items()}
    entrance = entrance_tension(CONFIG.scene, seen["helix_diameter"])
    seen["root_tension"] = sliding_tension(np.array([0.1, 0.2]), seen, CONFIG.scene) - entrance
    feeds = [POLICY.targets(seen, memory)[0] for _ in range(200)]
    assert feeds[14] == pytest.approx([0.3 - 0.1 / np.e, 0.1 + 0.1 / np.e], rel=1e-2)
    assert feeds[-1] == pytest.approx([0.3, 0.1], rel=1e-2)


@pytest.mark.slow
@pytest.mark.processor
def test_law_feeds_by_the_friction_from_tension():
    """In a slippery and in a rough tube the law ends near what its rows for these frictions say.

    The law is fed at 5 m by its middle row and has 60 s and more to learn; steady sliding tells friction within 10 %
    (a fifth of the distance between the two rows).
    """
    tubes = [Context(friction=0.1), Context(friction=0.2)]
    plan = Plan({"law": POLICY}, tubes, config=CONFIG, fidelity=PRESETS["fast"])
    times = run_plan(plan, None, progress=False)["inspection_time_s"].to_numpy()
    assert times == pytest.approx([55.0 / 0.3, 55.0 / 0.1], rel=0.15)
