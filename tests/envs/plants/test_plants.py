"""Plants: files of custom tubes, their errors, and the same plant in every environment."""

import tomllib
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import tomli_w
from scipy.stats import ks_1samp, norm, uniform

from probe_agents.vec_env import ProbeVecEnv
from probe_env import Plant, Scene, TaskConfig
from probe_env.envs.contexts import HELIX_DIAMETERS, Context
from probe_env.envs.plants import Bundle, Normal, middle, quantiles, supply_in_si, supply_per_hour, unusual
from probe_env.physics.closed_forms.route import min_air, required_root_tension, route_forces

TEXT = """
[tube]
helix_diameter = [1.0, 1.4, 2.0]
inner_diameter = 22.1e-3
helix_length = 40.0
[contact]
friction = {low = 0.12, high = 0.22}
stiffness = {mean = 1e5, std = 2e4}
[air]
density = 1.1
drag_coefficient = {mean = 0.5, std = 0.02}
air_lag = 2.0
[feed]
feed_speeds = [0.02, 0.15]
[task]
vibration_limit = 2e-4
"""
SETTINGS = {"fidelity": "fast"}
TEST = {"tube": {"tube": {"inner_diameter": 0.023}}, "contexts": "test"}


@pytest.fixture
def file(tmp_path):
    (tmp_path / "tube.toml").write_text(TEXT)
    return tmp_path / "tube.toml"


def test_a_plant_is_a_scene_a_task_and_tubes(file):
    plant = Plant.from_toml(file)
    scene, task = plant.scene, plant.configured()
    assert (scene.tube.inner_diameter, scene.tube.helix_length, scene.carrier_length) == (22.1e-3, 40.0, 37.5)
    assert scene.contact.friction == pytest.approx(0.17)
    assert (scene.air.density, scene.air.drag_coefficient) == (1.1, pytest.approx(0.5))
    assert (task.feed_speeds, task.air_lag, task.vibration_limit) == ((0.02, 0.15), 2.0, 2e-4)
    assert task.scene == scene
    assert task.time_limit == TaskConfig().time_limit
    long = Plant(tube={"helix_length": 80.0}).configured()
    assert long.time_limit == pytest.approx(TaskConfig().time_limit * 80.0 / 60.0)
    assert Plant(tube={"helix_length": 80.0}, task={"time_limit": 700.0}).configured().time_limit == 700.0
    assert Plant().configured() == TaskConfig()
    contexts = [{"friction": 0.3, "helix_diameter": 1.1}]  # of one's own
    env = gym.make("probe_env/Insertion-v1", tube=file, contexts=contexts, **SETTINGS)
    assert env.reset(seed=0)[1]["context"] == Context.model_validate(contexts[0]).model_dump()
    assert env.unwrapped.config.scene.tube.inner_diameter == 22.1e-3


@pytest.mark.parametrize("form", [Path, str, Plant.from_toml, lambda path: Plant.from_toml(path).model_dump()])
def test_every_environment_accepts_every_form_of_a_plant(file, form):
    tube, plant = form(file), Plant.from_toml(file)
    single = gym.make("probe_env/Insertion-v1", tube=tube, **SETTINGS)
    assert single.unwrapped.config == plant.configured() == single.unwrapped.episodes.config
    batch = gym.make_vec("probe_env/Insertion-v1", 2, tube=tube, **SETTINGS)
    native = ProbeVecEnv("probe_env/Insertion-v1", 2, tube=tube, **SETTINGS)
    first, info = single.reset(seed=5)
    assert (batch.reset(seed=5)[0][0] == first).all()
    native.seed(5)
    assert (native.reset()[0] == first).all()
    assert info["feed_speed"] == pytest.approx(0.15)  # the default of 0.2 m/s is out of range
    assert info["context"] in [context.model_dump() for context in plant.contexts(1024)]
    assert gym.make("probe_env/Snapshot-v1", tube=tube).unwrapped.config.period == 0.1


def test_an_insertion_ends_where_the_helix_does():
    """The default carrier length of 50 m is cut to the tube."""
    for arguments in ({"tube": {"tube": {"helix_length": 8.0}}}, {"scene": {"tube": {"helix_length": 8.0}}}):
        env = gym.make("probe_env/Insertion-v1", **arguments, **SETTINGS)
        env.reset(seed=0)
        ended = False
        while not ended:
            *_, ended, _, info = env.step(np.array([1.0, 0.0], dtype=np.float32))
        assert info["inserted_length"] == pytest.approx(8.0)
        assert info["episode_kpis"]["complete"] == 1.0


def test_contradicting_arguments_are_refused():
    for env_id, arguments, message in (
        ("Insertion-v1", {"tube": {}, "scene": {}}, "tube and scene: give one of them"),
        ("Insertion-v1", {"tube": {}, "config": TaskConfig()}, "config with a tube must be a mapping"),
        ("Insertion-v1", {"tube": "none.toml"}, "none.toml"),
        ("Insertion-v1", TEST, "contexts = 'test' cannot be combined with tube"),
        ("Design-v1", {"tube": {"tube": {"helix_length": 20.0}}}, "helix_length = 20 m: designs are compared as far"),
        ("Inspection-v0", {"scored_pass": "withdrawal"}, r"scored_pass is a field of the task: give config=\{'score"),
    ):
        with pytest.raises((ValueError, FileNotFoundError, TypeError), match=message):
            gym.make(f"probe_env/{env_id}", **arguments)
    with pytest.raises(ValueError, match="contexts = 'test' cannot be combined with tube"):
        ProbeVecEnv(**TEST)


BROKEN = {
    "tubes: there is no such field; accepted: assumptions, tube, probe, contact": {"tubes": {}},
    "air.compressible: is set for all terms by assumptions = 'whole'": {"air": {"compressible": True}},
    "contact.weight: is set for all terms by assumptions": {"contact": {"weight": True}},
    "tube.helix_diameter: 0.1 m is outside the accepted": {"tube": {"helix_diameter": [0.1]}},
    "tube.helix_diameter.*at least 1": {"tube": {"helix_diameter": []}},
    "contact.friction.high: Field required": {"contact": {"friction": {"low": 0.1}}},
    "contact.friction.* low = 0.3 must not exceed high = 0.2": {"contact": {"friction": {"low": 0.3, "high": 0.2}}},
    "contact.friction: high = 1.3 .* range 0 to 1": {"contact": {"friction": {"low": 0.3, "high": 1.3}}},
    "contact.friction: .* a table of low and high, or one of mean and std": {"contact": {"friction": {"lo": 0.1}}},
    "contact.stiffness.*must be a number": {"contact": {"stiffness": "stiff"}},
    "contact.stiffness.std.*greater than 0": {"contact": {"stiffness": {"mean": 1e5, "std": 0.0}}},
    "air.drag_coefficient: nan": {"air": {"drag_coefficient": float("nan")}},
    "air.drag_coefficient: 2e-06 to 2 times .* 0.1 to 10 times": {"air": {"drag_coefficient": {"low": 0, "high": 0.5}}},
    r"task.ramp: belongs in \[feed\]": {"task": {"ramp": 1.0}},
    r"task.air_lag: belongs in \[air\]": {"task": {"air_lag": 1.0}},
    r"task.scene: belongs in \[tube\]": {"task": {"scene": {}}},
    "task.privileged: is set by the policy": {"task": {"privileged": True}},
    "task.perod: there is no such field; accepted: ": {"task": {"perod": 1.0}},
    "feed.ramp: .*outside the accepted range": {"feed": {"ramp": -1.0}},
    r"feed_speeds = \(0.3, 0.1\) must ascend": {"feed": {"feed_speeds": [0.3, 0.1]}},
    r"feed_speeds = \(0.0, 0.4\) must ascend within the accepted range 1e-06": {"feed": {"feed_speeds": [0.0, 0.4]}},
    "probe.carrier_float_diameter = 0.019 m must be less than tube.inner_diameter": {"tube": {"inner_diameter": 0.018}},
    "float_pitch = 0.6 m must not exceed half of tube.helix_diameter = 1 m": {
        "tube": {"helix_diameter": [2.0, 1.0]}, "probe": {"float_pitch": 0.6, "guide_length": 2.4}
    },
    "feed.feed_speed_step = 0.5 m/s: no whole step lies within feed_speeds, 0.02": {"feed": {"feed_speed_step": 0.5}},
    "no whole step lies within feed_speeds, 0.11 to": {"feed": {"feed_speeds": [0.11, 0.19], "feed_speed_step": 0.1}},
    "air.air_supply_step = 180 m3/h: no whole step lies within air": {"air": {"air_supply_step": 0.05}},
    r"air: .*per_h = \(30, 1000\): must be within 0 to 720 m3/h": {"air": {"air_supply_rates_m3_per_h": [30, 1000]}},
    "_per_h = 5: air_supply_step is given, too": {"air": {"air_supply_step_m3_per_h": 5, "air_supply_step": 0.001}},
    "tube.helix_diameter: 1400.0 m is outside the accepted range 0.3 to 50 m": {"tube": {"helix_diameter": 1400}},
    "task.vibration_limit = 0.1 m is more than the 0.0052 m that": {"task": {"vibration_limit": 0.1}},
    r"route.0.slope: 120.0 degrees .* -90 to 90 degrees": {"route": [{"length": 3.0, "slope": 120.0}, {"helix": True}]},
    "route.0: length is missing: 0.001 to 1000 m": {"route": [{"slope": 90.0}, {"helix": True}]},
    r"route.0: helix = true has the length .* of \[tube\]": {"route": [{"helix": True, "length": 9.0}]},
    "route: 0 segments have helix = true; the accepted number is 1": {"route": [{"length": 3.0}]},
    "route.2: the route needs over 4000 steps": {"route": [{"length": 1e3}, {"length": 999.0}, {"helix": True}]},
    # q = 0.870 N/m in uniform air: (q - 0.163) 3 m carry (1.089 - q) 9.7 m; less where it expands
    r"route.1: the probe stops with its tip 10 m from .* is 60 m3/h, and 88.14 m3/h is enough for the whole": {
        "route": [{"length": 3.0}, {"length": 12.0, "slope": 90.0}, {"helix": True}],
        "air": {"air_supply_rates": [0.01, 60.0 / 3600.0]},
    },
    "contact.friction.std = 0.5 is more than the mean, 0.15": {"contact": {"friction": {"mean": 0.15, "std": 0.5}}},
    "contact.stiffness.std = 200000 is more than": {"contact": {"stiffness": {"mean": 1e5, "std": 2e5}}},
    "bundle.tubes: .*greater than or equal to 1": {"bundle": {"tubes": 0, "withdrawal_time": 60.0}},
    "bundle.tubes: Field required": {"bundle": {"withdrawal_time": 60.0}},
    r"bundle: give withdrawal_time \[s\] or withdrawal_speed \[m/s\], one of them": {"bundle": {"tubes": 9}},
    "bundle: give withdrawal_time": {"bundle": {"tubes": 9, "withdrawal_time": 60.0, "withdrawal_speed": 1.0}},
    "bundle.withdrawal_speed: 0.0 m/s is outside the accepted range": {"bundle": {"tubes": 9, "withdrawal_speed": 0.0}},
}  # fmt: skip


def test_errors_are_one_line_with_file_and_field(tmp_path):
    path = tmp_path / "mine.toml"
    for message, tables in BROKEN.items():
        path.write_text(tomli_w.dumps(tables))
        with pytest.raises(ValueError, match=message) as error:
            Plant.from_toml(path)
        assert str(error.value).startswith(str(path))
        assert "\n" not in str(error.value)


def test_values_in_a_thousandfold_unit_are_noted():
    """Those of every shipped plant are not."""
    files = sorted((Path(__file__).parents[3] / "configs" / "tubes").glob("*.toml"))
    assert [unusual(Plant.from_toml(file)) for file in files] == [[]] * 5
    (text,) = [file.read_text() for file in files if file.stem == "example"]
    for usual, wrong in (
        ("length = 6.0", "length = 0.006"), ("slope = 30.0", "slope = 0.52"), ("low = 0.12", "low = 1.2e-4"),
        ("mean = 1.0e5", "mean = 1e8"), ("[30.0, 122.0]", "[0.03, 122.0]"), ("air_lag = 1.5", "air_lag = 1.5e-3"),
        ("[0.03, 0.35]", "[3e-5, 0.35]"), ("ramp = 0.4", "ramp = 400.0"), ("sample_rate = 500.0", "sample_rate = 5e5"),
        ("test_frequency = 160.0", "test_frequency = 1.6e5"), ("support_spacing = 1.5", "support_spacing = 1.5e-3"),
        ("vibration_limit = 1e-4", "vibration_limit = 1e-7"),
    ):  # fmt: skip
        assert text.count(usual) == 1
        text = text.replace(usual, wrong)
    notes = unusual(Plant.model_validate(tomllib.loads(text)))
    assert [note.split(" = ")[0] for note in notes] == [
        "route.0.length", "route.0.slope", "tube.support_spacing", "contact.friction", "contact.stiffness",
        "air.air_supply_rates", "air.air_lag", "feed.feed_speeds", "feed.ramp", "instrument.sample_rate",
        "instrument.test_frequency", "task.vibration_limit",
    ]  # fmt: skip
    assert notes[4] == "contact.stiffness = 1e+08 is far from a usual 100000 N/m: is the unit right?"


def test_withdrawal_of_a_bundle_takes_a_given_time():
    """60 m of helix and 12 m of route at 0.5 m/s; nothing where the withdrawal is simulated."""
    tables = {"bundle": {"tubes": 9, "setup_time": 60.0, "withdrawal_speed": 0.5}}
    plant = Plant.model_validate(tables | {"route": [{"length": 12.0, "slope": 90.0}, {"helix": True}]})
    assert plant.bundle_for(plant.config) == Bundle(tubes=9, setup_time=60.0, withdrawal_time=144.0)
    both = plant.configured(changes={"passes": "both"})
    assert plant.bundle_for(both) == Bundle(tubes=9, setup_time=60.0, withdrawal_time=0.0)
    assert Plant(bundle=plant.bundle_for(plant.config)).bundle_for(plant.config) == plant.bundle_for(plant.config)
    assert Plant().bundle_for(plant.config) is None


def test_required_tension_follows_from_the_route():
    """In the largest helix at the median friction; friction, not drag, decides what the worst tube needs."""
    tables = {
        "tube": {"helix_diameter": [1.0, 1.6]},
        "contact": {"friction": {"low": 0.1, "high": 0.2}},
        "route": [{"length": 12, "slope": 90}, {"helix": True}],
    }
    plant = Plant.model_validate(tables)
    largest = Scene(tube={"helix_diameter": 1.6}).whole()
    assert plant.config.required_tension == pytest.approx(required_root_tension(plant.route, largest), rel=1e-9)
    assert Plant.model_validate(plant.model_dump()) == plant
    assert Plant.model_validate(tables | {"task": {"required_tension": 2.0}}).config.required_tension == 2.0
    assert plant.configured(changes={"limits": {"required_tension": 2.0}}).required_tension == 2.0
    hard = [Context(friction=0.4, drag_factor=0.5, helix_diameter=1.0)]
    # in the rising part only the drag counts, so in uniform air twice the square of its speed past the probe
    uniform = Plant.model_validate(tables | {"assumptions": "study"})
    assert uniform.check_route(hard) / uniform.check_route() == pytest.approx(2.0**0.5, rel=1e-3)
    assert Plant().check_route(hard) == 0.0
    bend = {"length": 0.8, "bend_radius": 0.5, "slope": 45.0}  # the example of docs/plant.md
    bent = Plant.model_validate({"route": [tables["route"][0], bend, {"helix": True}]})
    assert bent.config.required_tension == pytest.approx(3.84, abs=5e-3)
    air, tip = 3600.0 * min_air(bent.route, bent.scene), route_forces(bent.route, bent.scene).tip
    assert air.max() == pytest.approx(103.5, abs=0.1)
    # at the slowest feed, 0.18 m/s less
    assert 3600.0 * bent.check_route() == pytest.approx(air[tip < 12.8 + 15.0 + 0.5].max(), abs=1.0)
    assert route_forces(bent.route, bent.scene, 0.03).feed.min() == pytest.approx(0.66, abs=5e-3)
    weak = uniform.model_copy(update={"air": {"air_supply_rates": (0.01, 80.0 / 3600.0)}})
    with pytest.raises(ValueError, match=r"route.0: the probe stops with its tip 0.5 m .* push with .* N"):
        weak.check_route(hard)


def test_tubes_cover_their_distributions(file):
    """300 tubes; Kolmogorov's test at 1e-4, which a low-discrepancy sequence passes by far."""
    plant = Plant.from_toml(file)
    tubes = plant.contexts(300)
    assert tubes[:7] == plant.contexts(7)
    assert plant.contexts(7, seed=1) != tubes[:7]
    for k in range(0, 300, 3):
        assert sorted(c.helix_diameter for c in tubes[k : k + 3]) == [1.0, 1.4, 2.0]
    for values, distribution in (
        ([c.friction for c in tubes], uniform(0.12, 0.10)),
        ([c.contact_stiffness for c in tubes], norm(1e5, 2e4)),
        ([c.drag_factor for c in tubes], norm(1.0, 0.04)),
    ):
        assert ks_1samp(values, distribution.cdf).pvalue > 1e-4
    for count in (3, 12, 48):
        assert abs(np.mean([c.friction for c in tubes[:count]]) - 0.17) < 0.10 / count**0.5
    with pytest.raises(ValueError, match="tubes = 0 is outside the accepted range 1 to 4096"):
        plant.contexts(0)


@pytest.mark.parametrize(("diameters", "seed"), [((1.0,), 0), ((1.0, 2.5), 1), (HELIX_DIAMETERS, 2)])
def test_every_diameter_has_tubes_over_the_whole_distribution(diameters, seed):
    """In every prefix of whole blocks, means of the shares differ by at most 2 / n between diameters.

    Without the assignment, Halton's sequence gave every second diameter one half of the friction range.
    """
    tube = {"helix_diameter": list(diameters)}
    contact = {"friction": {"low": 0.1, "high": 0.2}, "stiffness": {"low": 0.9e5, "high": 1.1e5}}
    tubes = Plant.model_validate({"tube": tube, "contact": contact}).contexts(48, seed)
    for count in (24, 48):
        of_diameter = [[c for c in tubes[:count] if c.helix_diameter == d] for d in diameters]
        assert {len(some) for some in of_diameter} == {count // len(diameters)}
        for name, low, width in (("friction", 0.1, 0.1), ("contact_stiffness", 0.9e5, 0.2e5)):
            fractions = [[(getattr(c, name) - low) / width for c in some] for some in of_diameter]
            assert np.ptp([np.mean(values) for values in fractions]) <= 2.0 * len(diameters) / count
            assert all(np.ptp(values) > 0.5 for values in fractions) or count == 24


def test_a_normal_figure_is_truncated_to_its_range():
    figure = Normal(mean=0.05, std=0.1)
    values = quantiles(figure, np.linspace(1e-6, 1.0 - 1e-6, 1001), 0.0, 1.0)
    assert values.min() >= 0.0
    assert (np.diff(values) > 0.0).all()
    # median of a normal distribution truncated at 0, by definition
    whole = norm(0.05, 0.1)
    assert whole.cdf(middle(figure, 0.0, 1.0)) == pytest.approx(0.5 * (whole.cdf(0.0) + whole.cdf(1.0)))
    assert middle(0.2, 0.0, 1.0) == 0.2


def test_targets_are_rounded_to_the_resolution_of_the_devices():
    task = Plant(feed={"feed_speed_step": 0.05}, air={"air_supply_step": 10.0 / 3600.0}).configured()
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (200, 2))
    targets = task.targets(actions)
    feed, air = targets[:, 0], targets[:, 1] * 360.0
    steps = feed[(feed > 0.02) & (feed < 0.4)] / 0.05
    assert np.allclose(steps, np.round(steps), atol=1e-9)
    assert np.allclose(air, np.round(air), atol=1e-9)
    assert feed.min() >= 0.02
    assert np.abs(targets - TaskConfig().targets(actions)).max() <= 0.025


def test_air_supply_in_m3_per_h():
    fields = {
        "air_supply_rates_m3_per_h": [30.0, 122.0], "air_supply_step_m3_per_h": 5.0, "air_lag": 1.5,
        "air_ramp_m3_per_h_per_s": 18.0,
    }  # fmt: skip
    supply = Plant.model_validate({"air": fields}).air
    assert (supply.air_supply_rates, supply.air_supply_step) == ((30.0 / 3600.0, 122.0 / 3600.0), 5.0 / 3600.0)
    assert Plant.model_validate({"air": fields}).config.air_ramp == 18.0 / 3600.0
    assert supply_per_hour(supply_in_si(fields)) == fields
    for name, value in (("air_supply_step_m3_per_h", True), ("air_supply_rates_m3_per_h", [False, 122.0])):
        with pytest.raises(ValueError, match=f"{name} = .*: must be within 0 to 720 m3/h"):
            Plant.model_validate({"air": {name: value}})
