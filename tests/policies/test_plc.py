"""The laws for a PLC: friction, form, trim, their text run by an interpreter, table and warnings."""

import json
import re
import warnings

import numpy as np
import pytest

from probe_agents.cli import main
from probe_agents.plant.plc_export import recipe_of, structured_text, table, write_law
from probe_agents.policies import plc_law
from probe_agents.policies.cases import read_case
from probe_agents.policies.catalogue import make_policy
from probe_agents.policies.plc_law import TRIM, Constants, PlantData, PlcIntegral, PlcProportional, read_constants
from probe_agents.policies.policy import OutsideDomain
from probe_env import Plant, Scene
from probe_env.envs.plants import Posterior, Supply, Tubes
from probe_env.envs.task.config import TaskConfig
from probe_env.files import FileError
from probe_env.inspection.sensor import BAND, ENERGY, Sensor
from probe_env.physics.closed_forms import sliding_tension
from probe_env.schedule import Schedule
from tests.oracles.structured_text import FunctionBlock, block_inputs

CONFIG = TaskConfig(scene=Scene()).full_observation  # the laws read friction by the closed form of the study
PLANT = PlantData.of(CONFIG)
TRIMMED = read_constants().model_copy(update={"aim": 4e-5, "trim_time": 60.0})
OTHER = {
    "noise_average": 5.0, "margin": 2.5, "fast_feed": 0.8, "fast_air": 0.2, "slow_air": 0.7, "max_shift": 0.3,
    "trim_average": 2.0, "max_excess": 2.0, "max_deficit": 0.2, "max_decrease": 0.9, "max_increase": 0.1,
}  # fmt: skip
"""Constants that have their defaults in the stored laws."""


def measured(noise, length, diameter=1.2, friction=0.2, feed=0.15, air=130.0 / 3600.0):
    """What a rig measures over periods (n,) in one tube, with steady feed, air and friction."""
    rest = {"feed_speed": feed, "air_supply_rate": air, "helix_diameter": diameter, "time": 0.0}
    rows = {name: np.full(len(length), value) for name, value in rest.items()}
    rows |= {"inserted_length": length, "rf_noise": noise * np.ones(len(length))}
    return rows | {"root_tension": sliding_tension(np.full(len(length), friction), rows, CONFIG.scene)}


def acted(law, rows):
    """Feed and air of each period of one run."""
    memory = np.zeros((1, law.memory))
    law.start(memory)
    pairs = [law.targets({n: v[k : k + 1] for n, v in rows.items()}, memory) for k in range(len(rows["time"]))]
    return np.array([feed[0] for feed, _ in pairs]), np.array([air[0] for _, air in pairs])


def test_friction_is_that_of_steady_sliding():
    """Table 2's guide floats are those of its carrier: the same closed form, solved by Newton."""
    rng = np.random.default_rng(0)
    limits = {"inserted_length": (5.0, 60.0), "feed_speed": (0.02, 0.4), "air_supply_rate": (45 / 3600, 130 / 3600)}
    rows = {name: rng.uniform(*ends, 50) for name, ends in limits.items()}
    rows["helix_diameter"] = rng.choice([1.0, 1.4, 2.5], 50)
    for friction in (0.1, 0.175, 0.25):
        tension = sliding_tension(np.full(50, friction), rows, CONFIG.scene)
        np.testing.assert_allclose(plc_law.friction_of(tension, rows, PLANT), friction, rtol=1e-6)
    for tension, length, limit in zip((1e9, -5.0), (50.0, 5.0), plc_law.APPARENT, strict=True):
        beyond = rows | {"inserted_length": np.full(50, length)}
        assert plc_law.friction_of(np.full(50, tension), beyond, PLANT) == pytest.approx(limit)
    still = rows | {name: np.zeros(50) for name in ("air_supply_rate", "feed_speed", "inserted_length")}
    assert np.isfinite(plc_law.friction_of(np.ones(50), still, PLANT)).all()


def test_law_is_fast_before_the_onset_and_slow_after():
    law = PlcProportional(CONFIG, Constants(shift=0.0))
    lengths = np.linspace(5.0, 60.0, 111)
    rows, memory = measured(1e-5, lengths, 1.5, plc_law.FRICTION), np.zeros((111, 2))
    law.start(memory)
    memory[:, 0] = plc_law.FRICTION
    feed, air = law.targets(rows, memory)
    fast = lengths < law.constants.onset_length
    assert (feed[fast] == CONFIG.feed_speeds[1]).all()
    applied = {
        "feed_speed": feed,
        "air_supply_rate": air,
        "inserted_length": lengths,
        "helix_diameter": np.full(111, 1.5),
    }
    tension = sliding_tension(np.full(111, plc_law.FRICTION), applied, CONFIG.scene)
    assert tension[fast] == pytest.approx(law.constants.margin * CONFIG.required_tension, rel=1e-6)
    assert (air[~fast] == CONFIG.air_supply_rates[1]).all()
    slow = law.constants.slow_feed * (lengths[~fast] / 30.0) ** -law.constants.slow_length
    np.testing.assert_allclose(feed[~fast], slow, rtol=1e-6)
    memory[:, 1] = np.log(1e-3)
    louder = PlcProportional(CONFIG, Constants(shift=0.3)).targets(rows | {"rf_noise": np.full(111, 1e-3)}, memory)
    assert (louder[0] <= feed).all()


def test_trimmed_feed_follows_its_time_constant():
    """With noise far from the aim the trim is linear in time, by the least and the greatest error, up to its limit."""
    slow = Constants(slow_feed=0.1, trim_time=60.0, max_decrease=0.4)  # far from both ends of the device's range
    law, trimmed = PlcProportional(CONFIG, slow), PlcIntegral(CONFIG, slow)
    settled = 10  # 2.5 time constants of the noise's average: what is left of the start is less than is cut off
    assert settled == 2.5 * slow.trim_average / CONFIG.period
    for noise, rate in ((1e-3, -slow.max_excess), (1e-6, slow.max_deficit)):
        rows = measured(noise, np.full(settled + 10, 40.0))
        (by_law, air), (by_trim, same_air) = acted(law, rows), acted(trimmed, rows)
        assert (air == same_air).all()
        assert np.diff(np.log(by_trim / by_law)[settled:]) == pytest.approx(rate * CONFIG.period / slow.trim_time)
    for noise, limit in ((1e-3, -slow.max_decrease), (1e-6, slow.max_increase)):
        long = measured(noise, np.full(400, 40.0))
        assert np.log(acted(trimmed, long)[0] / acted(law, long)[0])[-1] == pytest.approx(limit)
    at_aim = acted(PlcIntegral(CONFIG, TRIMMED), measured(TRIMMED.aim, np.full(200, 40.0)))[0]
    assert at_aim[100:] == pytest.approx(at_aim[100], rel=1e-3)
    feed, air = acted(PlcIntegral(CONFIG, Constants(shift=0.0)), measured(1e-3, np.full(200, 5.0)))
    assert (feed == CONFIG.feed_speeds[1]).all()  # before the onset
    assert (air < 0.5 * CONFIG.air_supply_rates[1]).all()


def test_many_act_as_one():
    rng, law, memory = np.random.default_rng(0), PlcIntegral(CONFIG, TRIMMED), np.zeros((3, 4))
    tubes = [measured(10.0 ** rng.uniform(-5.5, -3.5, 60), np.linspace(8.0, 50.0, 60)) for _ in range(3)]
    law.start(memory)
    for k in range(60):
        feed, _ = law.targets({name: np.array([tube[name][k] for tube in tubes]) for name in tubes[0]}, memory)
    assert feed == pytest.approx([acted(law, tube)[0][-1] for tube in tubes])


@pytest.mark.parametrize(
    ("trimmed", "changed", "max_air"),
    [(False, {}, 130.0), (True, {}, 130.0), (True, {}, 40.0), (False, OTHER, 130.0), (True, OTHER, 130.0)],
)
def test_structured_text_does_what_the_policy_does(trimmed, changed, max_air):
    """Over an insertion's worth of measurements: the interpreter rounds every operation to a REAL's 24 bits."""
    rng, count = np.random.default_rng(1), 400
    config = CONFIG.model_copy(update={"air_supply_rates": (CONFIG.air_supply_rates[0], max_air / 3600.0)})
    law = (PlcIntegral if trimmed else PlcProportional)(config, TRIMMED.model_copy(update=changed))
    block = FunctionBlock(structured_text(law.constants, PlantData.of(config), trimmed))
    plant = {
        "AIR_SPEED",
        "DRAG",
        "FLOAT_DIAMETER",
        "LEAST_FEED",
        "MOST_FEED",
        "LEAST_AIR",
        "MOST_AIR",
        "REQUIRED_TENSION",
    }
    assert block.fixed == {name.upper() for name in Constants.model_fields if trimmed or name not in TRIM} | plant
    rows = measured(10.0 ** rng.uniform(-5.5, -3.5, count), np.linspace(5.0, 60.0, count), 1.4, 0.18)
    memory, trims, strong = np.zeros((1, law.memory)), [0.0], 0
    law.start(memory)
    for k in range(count):
        row = {name: values[k : k + 1] for name, values in rows.items()}
        feed, air = law.targets(row, memory)
        outputs = block(**block_inputs(row, CONFIG.period, start=k == 0))
        # some fifty roundings of 6e-8 each, with exponents up to 2 and Newton's division by differences of 0.05
        np.testing.assert_allclose([outputs["Friction"], outputs["LogNoise"]], memory[0, :2], rtol=1e-4)
        if trimmed:  # 400 additions of at most 2/60, each rounded to 6e-8 of a trim of at most 0.9
            np.testing.assert_allclose(outputs["NoiseNow"], memory[0, 2], rtol=1e-4)
            np.testing.assert_allclose(outputs["Trim"], memory[0, 3], atol=1e-4)
            trims.append(memory[0, 3])
        if abs(float(outputs["Length"]) / float(outputs["Onset"]) - 1.0) > 1e-3:  # at the switch rounding decides
            np.testing.assert_allclose([outputs["Feed"], outputs["Air"]], [feed[0], air[0]], rtol=1e-3)
            strong += feed[0] < law.constants.fast_feed * CONFIG.feed_speeds[1]
    assert 50 < strong < 350  # both branches were run
    assert (np.ptp(trims) > 0.05) == trimmed


def test_structured_text_and_table_of_the_law():
    text = structured_text(Constants(quiet=1e-7, slow_feed=2.0), PLANT)
    assert "e-" not in text.split("*)", 1)[1]
    assert "QUIET : REAL := 0.0000001;" in text
    assert text.isascii()
    constants = read_constants()
    tabulated = table(constants, PLANT, [1.0, 2.5], 60.0)
    assert list(tabulated.columns) == [
        "helix_diameter_m", "friction", "inserted_length_m", "feed_speed_m_per_s", "air_supply_m3_per_h",
    ]  # fmt: skip
    assert len(tabulated) == 2 * 18 * 23
    diameter, friction, length, feed, air = tabulated.to_numpy().T
    quiet = np.full(len(tabulated), np.log(constants.quiet))
    expected = plc_law.law_at(constants, PLANT, (length, friction, quiet, diameter))
    assert (feed, air / 3600.0) == (pytest.approx(expected[0], rel=1e-12), pytest.approx(expected[1], rel=1e-12))
    assert 30.0 <= air.min() < air.max() == pytest.approx(130.0)


def test_structured_text_has_recipe_and_noise_scaling():
    """Plant units in the recipe; 0.1 mm of motion are volts of the channel by the sensor's gain."""
    schedule = Schedule("inserted_length", "linear", (5.0, 60.0), (0.4, 0.08519), (0.0125, 130.0 / 3600.0))
    sensor = Sensor(motion_gain=2500.0)
    text = structured_text(read_constants(), PLANT, recipe=schedule, sensor=sensor)
    recipe, _, rest = text.partition("FUNCTION_BLOCK")
    rows = [line.split() for line in recipe.splitlines()]
    assert ["5", "400.0", "45.0"] in rows
    assert ["60", "85.2", "130.0"] in rows
    assert "length [m]   feed [mm/s]   air [m3/h]" in recipe
    scaling = rest.partition("END_FUNCTION_BLOCK")[2]
    assert "Noise := NoiseV / 2500.0," in scaling
    assert "It is motion_gain in [sensor]" in scaling
    assert FunctionBlock(text).fixed == FunctionBlock(structured_text(read_constants(), PLANT)).fixed
    # with shaken_snr, white motion of 0.1 mm rms in the flaw's band and the noise at rest leave this ratio
    volts = float(re.search(r"NoiseV / ([\d.]+)", structured_text(read_constants(), PLANT))[1])
    motion = 2.0 * ENERGY * BAND * Sensor().groove_signal ** 2 / (volts * 1e-4) ** 2
    assert (1.0 / motion + Sensor().quiet_snr ** -2) ** -0.5 == pytest.approx(Sensor().shaken_snr, rel=1e-5)
    refused = structured_text(read_constants(), PLANT, recipe="too little (air*)")
    assert refused.startswith("(* No recommended schedule: too little (air) *)")


def test_recipe_is_the_recommended_schedule_or_a_reason():
    recipe = recipe_of(Plant(tube=Tubes(helix_length=24.0)))
    assert recipe.position[-1] == 24.0
    weak = Plant(air=Supply(air_supply_rates=(0.002, 0.004)), task={"required_tension": 5.0})
    assert "gives a root tension of only" in recipe_of(weak)
    assert "misspecified" in recipe_of(Plant(posterior=Posterior(friction=(0.1, 0.2), misspecified=True)))


def test_constants_are_read_by_name_or_refused(tmp_path):
    described = {"policy": "PlcProportional"} | read_constants().model_dump()
    assert make_policy("plc-proportional", CONFIG).describe() == described
    assert make_policy("plc-integral", CONFIG).describe()["aim"] == read_constants(plc_law.STORED_INTEGRAL).aim
    path = tmp_path / "law.json"
    for text, message in (
        ("{", "not the constants"), ("{}", "not the constants"), ("[]", "not the constants"),
        ('{"constants": {"average": -1.0}}', "average"), ('{"constants": {"a": 1.0}}', "a: "),
    ):  # fmt: skip
        path.write_text(text)
        with pytest.raises(FileError, match=message):
            read_constants(path)


def test_file_of_ten_constants_is_a_policy(tmp_path):
    """Both noises had one average; the rest has its defaults."""
    ten = {"average": 9.0, "onset_length": 29.0, "slow_feed": 0.27}
    path = tmp_path / "reference.json"
    path.write_text(json.dumps({"constants": ten, "tubes": 12}))
    policy = make_policy(str(path), CONFIG)
    assert isinstance(policy, PlcIntegral)
    assert policy.constants == Constants(**ten)
    assert policy.constants.noise_average == 9.0
    assert Constants(average=9.0, noise_average=5.0).noise_average == 5.0


def test_all_constants_act():
    """Each changes feed or air of an insertion through noise around the target."""
    noise = 10.0 ** (-4.5 + 0.7 * np.sin(np.arange(600) / 40.0))  # both limits of the trim are reached
    rows = measured(noise, np.linspace(5.0, 60.0, 600), 1.4, 0.18)
    base = acted(PlcIntegral(CONFIG, TRIMMED), rows)
    for name, value in OTHER.items():
        changed = acted(PlcIntegral(CONFIG, TRIMMED.model_copy(update={name: value})), rows)
        assert np.abs(np.array(changed) / base - 1.0).max() > 1e-3, name


def test_law_warns_of_a_plant_outside_its_range(tmp_path):
    file = tmp_path / "mine.toml"
    for text, warned in (
        ("[task]\nrequired_tension = 0.8\n", None),
        (
            "[[route]]\nlength = 12\nslope = 90\n[[route]]\nhelix = true\n",
            "3.59 N: the most air, 130 m3/h, can lose",
        ),
        ("[task]\nrequired_tension = 2.5\n", "2.5 N: the most air, 130 m3/h, can lose"),
        ("[tube]\ninner_diameter = 22.5e-3\n", "the law runs outside its range: inner_diameter 0.0225 m (0.0242 m)"),
    ):
        file.write_text(text)
        case = read_case(file, "test")
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            write_law(read_constants(), PlantData.of(case.config), case, tmp_path / "law.st", None)
        assert len(caught) == (warned is not None), text
        assert all(warned in str(warning.message) for warning in caught)
    assert caught[0].category is OutsideDomain


@pytest.mark.parametrize("option", ["--st", "--csv"])
def test_a_law_is_printed_alone_if_its_file_is_standard_output(tmp_path, capsys, option):
    assert main(["plc", option, str(tmp_path / "law")]) == 0
    assert "written: " in capsys.readouterr().out
    for name in ("-", "/dev/stdout"):
        assert main(["plc", option, name]) == 0
        assert capsys.readouterr().out == (tmp_path / "law").read_text()
