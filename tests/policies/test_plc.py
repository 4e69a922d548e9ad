"""The law for a PLC: its friction, its form, its text run by an interpreter, its table, its search."""

import json
import warnings

import numpy as np
import pytest

from agents.plant.plc_export import structured_text, table, write_law
from agents.policies.catalogue import make_policy
from agents.policies.places import place_at
from agents.policies.plc_law import (
    CREDIBLE,
    FRICTION,
    Constants,
    PlantData,
    PlcLaw,
    friction_of,
    law_at,
    read_constants,
)
from agents.policies.policy import OutsideDomain
from probe_env.envs.task import TaskConfig
from probe_env.envs.task.observations import in_si_units, observe
from probe_env.files import FileError
from probe_env.physics.closed_forms import sliding_tension
from tests.oracles.structured_text import FunctionBlock, block_inputs

CONFIG = TaskConfig().all_shown
PLANT = PlantData.of(CONFIG)


def seen(count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """What a rig could measure in tubes of all kinds."""
    rng = np.random.default_rng(seed)
    return {
        "inserted_length": rng.uniform(5.0, 60.0, count), "feed_speed": rng.uniform(0.02, 0.4, count),
        "air_supply_rate": rng.uniform(45.0, 130.0, count) / 3600.0, "rf_noise": 10.0 ** rng.uniform(-6.0, -3.0, count),
        "helix_diameter": rng.choice([1.0, 1.4, 2.5], count), "root_tension": rng.uniform(0.5, 20.0, count),
        "time": np.zeros(count),
    }  # fmt: skip


@pytest.mark.parametrize("friction", [0.1, 0.175, 0.25])
def test_friction_is_that_of_steady_sliding(friction: float) -> None:
    measured = seen(50)
    tension = sliding_tension(np.full(50, friction), measured, CONFIG.scene)
    # the guide's floats are those of the carrier in table 2's probe: the same closed form, solved by Newton
    np.testing.assert_allclose(friction_of(tension, measured, PLANT), friction, rtol=1e-6)


def test_friction_beyond_belief_is_cut_off_and_nothing_divides_by_zero() -> None:
    measured = seen(3)
    for tension, wanted in ((1e9, CREDIBLE[0]), (-5.0, CREDIBLE[1])):
        assert friction_of(np.full(3, tension), measured | {"inserted_length": np.full(3, 50.0)}, PLANT) == (
            pytest.approx(wanted)
        )
    still = measured | {"air_supply_rate": np.zeros(3), "feed_speed": np.zeros(3), "inserted_length": np.zeros(3)}
    assert np.isfinite(friction_of(np.ones(3), still, PLANT)).all()


def test_fast_with_little_air_up_to_the_onset_then_slow_with_all_of_it() -> None:
    law = PlcLaw(CONFIG, Constants(shift=0.0))
    lengths = np.linspace(5.0, 60.0, 111)
    measured = {name: np.full(111, values[0]) for name, values in seen(1).items()} | {"inserted_length": lengths}
    measured["helix_diameter"] = np.full(111, 1.5)
    measured["root_tension"] = sliding_tension(np.full(111, FRICTION), measured, CONFIG.scene)
    memory = np.zeros((111, 2))
    law.start(memory)
    feed, air = law.targets(measured, memory)
    fast = lengths < law.constants.onset_length
    assert (feed[fast] == CONFIG.feed_speeds[1]).all()
    assert (air[fast] == PLANT.air_supply_rates[0]).all()
    assert (air[~fast] == CONFIG.air_supply_rates[1]).all()
    slow = law.constants.slow_feed * (lengths[~fast] / 30.0) ** -law.constants.slow_length
    np.testing.assert_allclose(feed[~fast], slow, rtol=1e-6)
    louder = PlcLaw(CONFIG, Constants(shift=0.3))
    loud = memory.copy()
    loud[:, 1] = np.log(1e-3)
    assert (louder.targets(measured | {"rf_noise": np.full(111, 1e-3)}, loud)[0] <= feed).all()
    with pytest.raises(ValueError, match="shows the root tension"):
        PlcLaw(TaskConfig(observe_root_tension=False)).predict(np.zeros(10, dtype=np.float32))


def test_structured_text_does_what_the_policy_does() -> None:
    """Over an insertion's worth of measurements: the interpreter rounds every operation to a REAL's 24 bits."""
    law, count = PlcLaw(CONFIG), 400
    assert len(law.constants.model_dump()) == 10
    block = FunctionBlock(structured_text(law.constants, PLANT))
    assert block.fixed == {name.upper() for name in Constants.model_fields} | {
        "AIR_SPEED", "DRAG", "FLOAT_DIAMETER", "LEAST_FEED", "MOST_FEED", "LEAST_AIR", "MOST_AIR"
    }  # fmt: skip
    measured = seen(count, 1) | {"inserted_length": np.linspace(5.0, 60.0, count)}
    measured["helix_diameter"] = np.full(count, 1.4)
    measured["root_tension"] = sliding_tension(np.full(count, 0.18), measured, CONFIG.scene)
    memory, switched = np.zeros((1, 2)), 0
    law.start(memory)
    for k in range(count):
        row = {name: values[k : k + 1] for name, values in measured.items()}
        feed, air = law.targets(row, memory)
        outputs = block(**block_inputs(row, CONFIG.period, start=k == 0))
        # some fifty roundings of 6e-8 each, with exponents up to 2 and Newton's division by differences of 0.05
        np.testing.assert_allclose([outputs["Friction"], outputs["LogNoise"]], memory[0], rtol=1e-4)
        if abs(float(outputs["Length"]) / float(outputs["Onset"]) - 1.0) > 1e-3:  # at the switch rounding decides
            np.testing.assert_allclose([outputs["Feed"], outputs["Air"]], [feed[0], air[0]], rtol=1e-3)
            switched += air[0] == CONFIG.air_supply_rates[1]
    assert 50 < switched < 350  # both branches were run


@pytest.mark.parametrize(
    "broken",
    ["Feed := MOST_FEED", "Feed := UNKNOWN;", "QUIET := 1.0;", "WHILE TRUE DO END_WHILE;", "Feed := SQRT(2.0);"],
)
def test_the_interpreter_refuses_what_it_does_not_know(broken: str) -> None:
    text = structured_text(Constants(), PLANT)
    with pytest.raises((SyntaxError, KeyError)):
        FunctionBlock(text.replace("END_FUNCTION_BLOCK", f"{broken}\nEND_FUNCTION_BLOCK"))


def test_structured_text_has_no_exponents_and_stays_within_a_line() -> None:
    text = structured_text(Constants(quiet=1e-7, slow_feed=2.0), PLANT)
    assert "e-" not in text.split("*)", 1)[1]
    assert "QUIET : REAL := 0.0000001;" in text
    assert max(map(len, text.splitlines())) <= 110
    assert text.isascii()


def test_a_table_says_what_the_law_does() -> None:
    constants = read_constants()
    tabulated = table(constants, PLANT, [1.0, 2.5], 60.0)
    assert list(tabulated.columns) == [
        "helix_diameter_m", "friction", "inserted_length_m", "feed_speed_m_per_s", "air_supply_m3_per_h",
    ]  # fmt: skip
    assert len(tabulated) == 2 * 11 * 23
    diameter, friction, length, feed, air = tabulated.to_numpy().T
    quiet = np.full(len(tabulated), np.log(constants.quiet))
    expected = law_at(constants, PLANT, (length, friction, quiet, diameter))
    assert (feed, air / 3600.0) == (pytest.approx(expected[0], rel=1e-12), pytest.approx(expected[1], rel=1e-12))
    assert set(tabulated["air_supply_m3_per_h"].round(6)) == {45.0, 130.0}


def test_a_damaged_file_is_refused_by_name(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "law.json"
    for text, message in (
        ("{", "not the constants"), ("{}", "not the constants"), ("[]", "not the constants"),
        (json.dumps({"constants": {"average": -1.0}}), "average"),
        (json.dumps({"constants": {"averag": 1.0}}), "averag"),
    ):  # fmt: skip
        path.write_text(text)
        with pytest.raises(FileError, match=message):
            read_constants(path)


def test_it_goes_by_name_and_follows_what_is_observed() -> None:
    policy = make_policy("plc-law", CONFIG)
    assert policy.describe()["policy"] == "PlcLaw"
    measured = {"tension_mean_n": np.array([4.0]), "radial_rms_m": np.array([2e-5])}
    felt = {name: np.array([1.0]) for name in ("radial_acceleration_rms_m_per_s2", "axial_acceleration_rms_m_per_s2")}
    rest = {
        "inserted_length": np.array([40.0]), "remaining_length": np.array([20.0]), "feed_speed": np.array([0.1]),
        "air_supply_rate": np.array([0.02]), "feed_action": np.zeros(1), "air_action": np.zeros(1),
        "helix_diameter": np.array([1.4]), "friction": np.array([0.2]), "contact_stiffness": np.array([1e5]),
        "drag_factor": np.ones(1), "float_pitch": np.ones(1),
    }  # fmt: skip
    row = observe(TaskConfig(), measured | felt | rest, np.zeros((1, 2)))
    feed, air = TaskConfig().targets(make_policy("plc-law", TaskConfig()).predict(row)[0])[0]
    assert in_si_units(TaskConfig(), row)["root_tension"][0] == pytest.approx(4.0)
    assert 0.02 <= feed <= 0.4
    assert air in (pytest.approx(45.0 / 3600.0), pytest.approx(130.0 / 3600.0))


@pytest.mark.parametrize(("needed", "warned"), [(0.8, False), (2.5, True)])
def test_a_plant_that_asks_for_more_tension_is_told_that_the_least_air_is_a_fixed_one(needed, warned, tmp_path) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "mine.toml"
    file.write_text(f"[task]\nrequired_tension = {needed}\n")
    place = place_at(file, "test")
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        write_law(read_constants(), PlantData.of(place.config), place, tmp_path / "law.st", None)
    assert len(heard) == warned
    for warning in heard:
        assert "required_tension = 2.5 N: the law's least air, 45 m3/h, was chosen for 0.8 N" in str(warning.message)


def test_a_plant_that_the_law_was_not_made_for_is_told_so(tmp_path) -> None:  # type: ignore[no-untyped-def]
    tube = tmp_path / "mine.toml"
    tube.write_text("[tube]\ninner_diameter = 22.5e-3\n")
    place = place_at(tube, "test")
    with pytest.warns(OutsideDomain, match=r"the law was not made for these tubes: inner_diameter = 0\.0225 m"):
        write_law(read_constants(), PlantData.of(place.config), place, tmp_path / "law.st", None)
