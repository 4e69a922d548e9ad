"""Evaluation cases: what policies take from a plant, what they were made for, and maps of its tubes."""

from pathlib import Path

import numpy as np
import pytest

from probe_agents.evaluation.run import plan_of
from probe_agents.policies.bundle import Agent
from probe_agents.policies.cases import load_case, map_of, plant_at, read_case, with_probe
from probe_agents.policies.catalogue import make_policy
from probe_agents.policies.on_map import MARGIN, WORST, WORST_MARGIN, best_schedule_for, knots, min_air, root_tensions
from probe_agents.policies.policy import Domain, OutsideDomain, ranges_of
from probe_env import Context, Plant, Scene
from probe_env.envs import IncrementalInsertionEnv
from probe_env.envs.contexts import HELIX_DIAMETERS
from probe_env.envs.plants import map_file
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.scales import PROBE
from probe_env.envs.vibration_map import VibrationMap, equivalent_air, stored_map
from probe_env.physics.closed_forms import steady_root_tension

NARROW = Plant(tube={"inner_diameter": 22.1e-3})
OTHER = Plant(
    tube={"inner_diameter": 26e-3, "helix_length": 80.0},
    air={"density": 1.2, "drag_coefficient": 0.5},
    probe={"carrier_float_diameter": 20e-3, "guide_float_diameter": 20e-3},
)


def test_unusual_values_of_a_tube_file_give_a_warning(tmp_path):
    (tmp_path / "mine.toml").write_text("[contact]\nstiffness = 1e8\n")
    with pytest.warns(UserWarning, match=r"mine.toml: contact.stiffness = 1e\+08 is far from"):
        plant_at(tmp_path / "mine.toml")


def test_equivalent_air_pulls_as_strongly():
    """The root tension of steady sliding without friction is the drag of all floats: equal a metre, to rounding.

    In uniform air, as that of the exit; expanding air drags less near the entrance.
    """
    air, feed = np.array([0.012, 0.02, 0.03]), np.array([0.05, 0.2, 0.4])
    for plant in (one.model_copy(update={"assumptions": "study"}) for one in (NARROW, OTHER)):
        equal = equivalent_air(air, feed, plant.scene, Scene())
        for k in range(3):
            pulls = []
            for scene, blown in ((plant.scene, air[k]), (Scene(), equal[k])):
                still = {"contact": {"friction": 0.0}, "feed_speed": float(feed[k]), "air_supply_rate": float(blown)}
                pulls.append(steady_root_tension(scene.model_copy(update=still)) / scene.inserted_length)
            assert pulls[0] == pytest.approx(pulls[1], rel=1e-9)
        assert equivalent_air(equal, feed, Scene(), plant.scene) == pytest.approx(air)


def test_schedules_fit_the_helix_and_ranges_of_the_plant():
    ranges = {"feed": {"feed_speeds": [0.05, 0.2]}, "air": {"air_supply_rates": [0.01, 0.03]}}
    config = Plant(tube={"helix_length": 80.0}, **ranges).configured()
    schedule = best_schedule_for(Context(), config)
    assert knots(config)[-1] == 80.0 == schedule.position[-1]
    assert 0.05 <= min(schedule.feed_speed) <= max(schedule.feed_speed) <= 0.2
    assert 0.01 <= min(schedule.air_supply_rate) <= max(schedule.air_supply_rate) <= 0.03
    assert min_air(NARROW.configured()) < min_air(TaskConfig())  # the drag of a narrow gap is larger
    strong = NARROW.model_copy(update={"air": {"air_supply_rates": (0.02, 0.03)}}).configured()
    assert min_air(strong) == 0.02


@pytest.mark.parametrize("scene", [Scene(), Scene().whole()])
def test_schedules_pull_enough_by_closed_form(scene):
    """The smallest air of all tubes, and the best schedule of one, leave the required tension with the margin.

    Before lost drive is scored, the schedule supplies what is needed from there on, so the cable is not slack either.
    """
    config = TaskConfig(scene=scene)
    step, lengths = np.ptp(config.air_supply_rates) / 200, knots(config)
    needed = np.where(lengths >= config.lost_drive_from, config.required_tension, 0.0)
    for air, enough in ((min_air(config), True), (min_air(config) - 1.01 * step, False)):
        pull = root_tensions([WORST], config, lengths, np.full_like(lengths, 0.4), np.full_like(lengths, air))
        assert (pull >= WORST_MARGIN * needed).all() == enough
    for tube in (WORST, Context(friction=0.12, helix_diameter=2.5)):
        feed, air = best_schedule_for(tube, config).at(lengths)
        scored = np.maximum(lengths, config.lost_drive_from)
        assert (root_tensions([tube], config, scored, feed, air) >= MARGIN * config.required_tension).all()
        assert root_tensions([tube], config, lengths, feed, air).min() > 0.5 * config.required_tension


def test_air_of_training_is_enough_in_all_tubes():
    assert IncrementalInsertionEnv.defaults["air_supply_rates"][0] == pytest.approx(min_air(TaskConfig()))


@pytest.mark.parametrize("passes", ["in", "both"])
def test_policies_outside_their_domain_warn_or_are_refused(passes):
    rough = Plant(contact={"friction": {"low": 0.2, "high": 0.4}}, tube={"inner_diameter": 22.1e-3})
    case = load_case(rough, "test", 4, passes)
    with pytest.warns(OutsideDomain) as caught:
        plan_of(["best-schedule", "tension-scheduled", "pi"], case, 1, "fast")
    assert [str(w.message).split(" runs")[0] for w in caught] == ["best-schedule", "tension-scheduled"]
    for warning in caught:
        assert "inner_diameter 0.0221 m (0.0242 m)" in str(warning.message)
        assert "(0.1 to 0.25)" in str(warning.message)
    with pytest.raises(ValueError, match=r"tension-scheduled runs outside its range: .*Leave out --strict to run it"):
        plan_of(["tension-scheduled"], case, 1, "fast", strict=True)
    fitting = ["best-schedule", "tension-scheduled", "adaptive", "ppo"]
    plan_of(fitting, load_case(None, "test"), 1, "fast", strict=True)  # no warning: in tests it is an error


def test_domains_cover_probes_and_the_range_of_the_map():
    config = OTHER.configured().full_observation
    ppo = make_policy("ppo", config)
    view = ppo.description.view.model_copy(update={"observations": (*ppo.description.view.observations, *PROBE)})
    informed = Agent(ppo.description.model_copy(update={"view": view}), ppo.policy, config)
    laws = ((make_policy("adaptive", config), True), (make_policy("tension-scheduled", config), False))
    for policy, sees in ((ppo, False), (informed, True), *laws):
        deviations = policy.domain.outside(config, [Context()])
        assert any("probe: different" in line for line in deviations) == (not sees)
        assert any("helix_length 80 m (up to 60 m)" in line for line in deviations)
    whole = Domain.of_map(stored_map()).ranges
    assert ranges_of("random") == whole
    for name, (low, high) in ranges_of("train").items():
        assert whole[name][0] <= low < high <= whole[name][1]


def test_difficulties_are_within_what_policies_were_made_for():
    wide, disturbed = (read_case(Path(name), "test", 6) for name in ("easy", "hard"))
    for case in (wide, disturbed):
        plan_of(["best-schedule", "adaptive", "ppo"], case, 1, "fast", strict=True)  # no error and no warning
    assert {tube.helix_diameter for tube in wide.contexts} == {1.7, 2.0, 2.5}
    assert {tube.helix_diameter for tube in disturbed.contexts} == set(HELIX_DIAMETERS)
    usual = wide.config.model_dump(exclude={"scene", "sensor"})
    changed = {name: value for name, value in disturbed.config.model_dump().items() if usual.get(name, value) != value}
    assert changed == {
        "rf_noise": 0.1, "tension_noise": 0.04, "delay_periods": 1, "sensor_dropout": 0.2, "friction_drift": -0.3,
        "air_lag": 2.0,
    }  # fmt: skip


def test_a_hundredth_of_the_range_is_no_other_tube():
    """Friction up to 0.25, a range of 0.15, and one helix diameter only."""
    domain = Domain({"friction": (0.1, 0.25), "helix_diameter": (2.0, 2.0)}, 0.0242, 60.0, None)
    for friction, diameter, deviations in ((0.2514, 2.0, 0), (0.2516, 2.0, 1), (0.0986, 2.001, 0), (0.0984, 2.01, 2)):
        tube = Context(friction=friction, helix_diameter=diameter)
        assert len(domain.outside(TaskConfig(), [tube])) == deviations


def test_an_agent_acts_the_same_in_wider_ranges():
    """What it asks for is in SI units the same, and so is what it sees of its last action."""
    usual = TaskConfig().full_observation
    wide = TaskConfig(feed_speeds=(0.01, 0.5), air_supply_rates=(0.005, 0.04)).full_observation
    names, rng = list(usual.observations), np.random.default_rng(3)
    rows = rng.uniform(0.2, 0.8, (16, len(names))).astype(np.float32)
    columns = [names.index("previous_feed_action"), names.index("previous_air_action")]
    other = rows.copy()
    for column, (low, high), (minimum, maximum) in zip(
        columns, (usual.feed_speeds, usual.air_supply_rates), ((0.01, 0.5), (0.005, 0.04)), strict=True
    ):
        value = low + 0.5 * (rows[:, column] + 1.0) * (high - low)
        other[:, column] = 2.0 * (value - minimum) / (maximum - minimum) - 1.0
    acted, _ = make_policy("ppo", usual).predict(rows, deterministic=True)
    acted_wide, _ = make_policy("ppo", wide).predict(other, deterministic=True)
    # float32 observations differ by rounding, 1e-7 of an action of order one through weights of order ten
    assert wide.targets(acted_wide) == pytest.approx(usual.targets(acted), rel=1e-3)
    with pytest.raises(ValueError, match=r"period = 2\.0 differs from 1\.0"):
        make_policy("ppo", TaskConfig(period=2.0).full_observation)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """The file of a plant of 7 m of helix, and a map beside it: the shipped one's layers with the plant's scene."""
    file = tmp_path_factory.mktemp("plant") / "small.toml"
    file.write_text("[tube]\nhelix_diameter = 0.8\nhelix_length = 7.0\ninner_diameter = 23e-3\n")
    plant, known = Plant.from_toml(file), stored_map()
    ranges = np.array([[0.1, 7e4, 0.9, 0.8], [0.25, 1.4e5, 1.1, 0.8]])
    scaling = np.array([np.zeros(7), np.ones(7)])
    map_file(file).write_bytes(VibrationMap(known.layers, plant.scene, ranges, scaling).to_bytes())
    return file


def test_map_beside_the_tube_file_must_be_of_that_tube(small, tmp_path):
    case = read_case(small, "test", 6)
    assert map_file(small).name == "small-map.npz"
    assert case.vibration.scene == Plant.from_toml(small).scene
    assert case.vibration == VibrationMap.load(map_file(small)) != stored_map()
    policy = make_policy("tension-scheduled", case.config.full_observation, case.vibration)
    assert policy.domain.outside(case.config, case.contexts) == []
    file, text = tmp_path / "small.toml", small.read_text()
    map_file(file).write_bytes(map_file(small).read_bytes())
    for changed, message in (
        (text.replace("23e-3", "24e-3"), r"small-map.npz: inner_diameter = 0.023 m, and small.toml has 0.024 m"),
        (text.replace("7.0", "7.5"), r"helix_length = 7.0 m, and small.toml has 7.5 m: make it again"),
        (text + "[air]\ndensity = 1.3\n", "air of the map and of small.toml differ"),
        (text + "[probe]\nline_density = 0.12\n", "probe of the map and of small.toml differ"),
        ('assumptions = "study"\n' + text, "assumptions of the map and of small.toml differ: make it again"),
    ):
        file.write_text(changed)
        with pytest.raises(ValueError, match=message):
            map_of(file, Plant.from_toml(file))
    file.write_text(text + "[contact]\nfriction = 0.3\n")
    assert map_of(file, Plant.from_toml(file)).scene == Plant.from_toml(small).scene


def test_results_of_different_plants_never_mix(small, tmp_path):
    plant = Plant.from_toml(small)
    other = plant.model_copy(update={"tube": {"inner_diameter": 23.5e-3}})
    first, second = (plan_of(["constant"], load_case(each, "test", 1), 1, "fast") for each in (plant, other))
    with first.folder(tmp_path).open(), pytest.raises(ValueError, match="other settings"):
        second.folder(tmp_path).check()


def test_passes_and_what_is_scored():
    """As the plant's file says, or as they are asked for."""
    usual = load_case(None, "test", 1).config
    assert (usual.passes, usual.time_limit) == ("in", TaskConfig().time_limit)
    both = load_case(None, "test", 1, "both").config
    assert (both.passes, both.scored_pass, both.time_limit) == ("both", "best", 2.0 * usual.time_limit)
    assert load_case(None, "test", 1, "both", "withdrawal").config.scored_pass == "withdrawal"
    with pytest.raises(ValueError, match="scored_pass = 'withdrawal' needs --passes both"):
        load_case(None, "test", 1, "in", "withdrawal")


def test_a_file_that_is_not_valid_or_not_there_is_named(tmp_path, refused):
    (tmp_path / "broken.toml").write_text("[contact]\nfriction = 2.0\n")
    message = "broken.toml: contact.friction: 2.0 is outside the accepted range 0 to 1"
    refused(["evaluate", "constant", "--tube", "broken.toml"], message)
    assert read_case(Path("example"), "test", 3).config.scene.tube.helix_length == 45.0
    with pytest.raises(FileNotFoundError) as missing:
        read_case(Path("nowhere.toml"), "test")
    assert "shipped tubes: easy, example" in missing.value.hint


def test_probe_with_a_longer_guide_fits_a_full_helix():
    """The improved probe has 10 m of guide cable, the plant's own 2.5 m; table 2's helix has room for it."""
    config = load_case(Plant(tube={"helix_length": 28.0}), "test", 1).config
    own, improved = config.scene, with_probe(config, "improved").scene
    assert own.inserted_length == pytest.approx(28.0)
    assert improved.probe.guide_length == pytest.approx(10.0)
    assert 28.0 - improved.probe.float_pitch < improved.inserted_length <= 28.0
    assert with_probe(TaskConfig(), "improved").scene.carrier_length == TaskConfig().scene.carrier_length
