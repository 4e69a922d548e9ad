"""The world of the map: the task's own numbers, equal alone and in company, and as loud as the map says."""

import json
from collections.abc import Callable, Sequence

import gymnasium as gym
import numpy as np
import pytest
from oracles.scatter import CHANCE, of_another, reach

from agents.policies.maps.vibration_map import stored_map
from agents.training.config import Training
from agents.vec_env import ProbeVecEnv
from agents.worlds import measure
from agents.worlds.map_episodes import MapEpisodes
from agents.worlds.measure import compared, noise_of, rewards_in_the_map
from agents.worlds.noise import Noise, Scatter, stored_noise
from agents.worlds.vec_env import MapVecEnv, vec_env
from probe_env import Context
from probe_env.envs.task import TaskConfig
from probe_env.files import FileError
from probe_env.physics.closed_forms import sliding_tension

CONFIG = TaskConfig().all_shown
QUIET = Noise()
Seeds = Callable[[int], Sequence[int]]
TUBE = Context(friction=0.18, helix_diameter=1.4)


def begun(count: int, noise: Noise | None = None, config: TaskConfig = CONFIG) -> MapEpisodes:
    episodes = MapEpisodes(count, config, noise=noise)
    rngs = {k: np.random.default_rng(k) for k in range(count)}
    episodes.reset(range(count), rngs, {k: {"context": TUBE} for k in range(count)})
    return episodes


def test_it_has_the_spaces_and_habits_of_the_simulated_one() -> None:
    simulated = ProbeVecEnv("probe_env/Insertion-v1", 2, contexts="train", fidelity="fast")
    world = vec_env("probe_env/Insertion-v1", 2, TaskConfig(), fidelity="map", contexts="train")
    assert isinstance(world, MapVecEnv)
    assert type(vec_env("probe_env/Insertion-v1", 1, TaskConfig(), fidelity="fast")) is ProbeVecEnv
    for space in ("observation_space", "action_space"):
        assert getattr(world, space) == getattr(simulated, space)
    world.seed(3)
    observation = world.reset()
    assert world.observation_space.contains(observation[0])
    rng, ended = np.random.default_rng(0), 0
    for _ in range(700):
        observation, reward, done, infos = world.step(rng.uniform(-1.0, 1.0, (2, 2)).astype(np.float32))
        assert np.isfinite(observation).all()
        assert np.isfinite(reward).all()
        for k in np.flatnonzero(done):
            ended += 1
            assert infos[k]["terminal_observation"].shape == observation[k].shape
            assert infos[k]["episode_kpis"]["complete"] in (0.0, 1.0)
    assert ended >= 2
    assert gym.spaces.utils.flatdim(world.observation_space) == len(TaskConfig().observations)


def test_probes_are_alike_alone_and_in_company() -> None:
    many, actions = begun(3), np.random.default_rng(1).uniform(-1.0, 1.0, (40, 3, 2))
    alone = MapEpisodes(1, CONFIG)
    alone.reset([0], {0: np.random.default_rng(2)}, {0: {"context": TUBE}})
    for action in actions:
        together, single = many.step(action), alone.step(action[2:])
        # a matrix product of three rows rounds otherwise than one of one, and nothing here makes more of that
        np.testing.assert_allclose(together.observation[2], single.observation[0], rtol=1e-6)
        assert together.reward[2] == pytest.approx(single.reward[0], rel=1e-9, abs=1e-12)


def test_without_noise_it_is_the_map_and_the_closed_form() -> None:
    episodes = begun(1, QUIET)
    action = CONFIG.actions(np.array([0.2]), np.array([0.02]))
    for _ in range(60):
        step = episodes.step(action)
    info = step.infos[0]
    assert info["feed_speed"] == pytest.approx(0.2)
    tubes = np.array([[TUBE.friction, TUBE.contact_stiffness, TUBE.drag_factor, TUBE.helix_diameter]])
    place = [np.array([info[name]]) for name in ("inserted_length", "feed_speed", "air_supply_rate")]
    mean = stored_map().tells(*place, tubes, CONFIG.scene)[0][0]
    assert info["radial_rms_m"] == pytest.approx(1e-4 * 10.0**mean)
    seen = dict(zip(("inserted_length", "feed_speed", "air_supply_rate"), place, strict=True))
    pulled = sliding_tension(np.array([TUBE.friction]), seen | {"helix_diameter": tubes[:, 3]}, CONFIG.scene)
    assert info["tension_mean_n"] == pytest.approx(pulled[0] * TUBE.drag_factor)


def test_feed_follows_its_ramp_and_air_its_lag() -> None:
    config = TaskConfig(ramp=0.1, air_lag=2.0)
    episodes = MapEpisodes(1, config, noise=QUIET)
    episodes.reset([0], {0: np.random.default_rng(0)}, {0: {"context": TUBE}})
    air, length = episodes.air[0], episodes.length[0]
    episodes.step(config.actions(np.array([0.35]), np.array([0.03])))
    assert episodes.feed[0] == pytest.approx(0.3)
    assert episodes.length[0] - length == pytest.approx(0.25)
    assert episodes.air[0] == pytest.approx(0.03 + (air - 0.03) * np.exp(-0.5))
    length = episodes.length[0]
    episodes.step(config.actions(np.array([0.35]), np.array([0.03])))
    assert episodes.length[0] - length == pytest.approx(0.35 - 0.5 * 0.05**2 / 0.1)


def test_a_whole_insertion_earns_the_task_s_terms() -> None:
    episodes, total = begun(1, QUIET), 0.0
    action = CONFIG.actions(np.array([0.4]), np.array([0.02])).astype(np.float32)
    while episodes.running.any():
        step = episodes.step(action)
        total += float(step.reward[0])
    kpis = step.infos[0]["episode_kpis"]
    assert kpis["reward"] == pytest.approx(total)
    assert kpis["inspected_m"] == pytest.approx(55.0)
    assert kpis["complete"] == 1.0
    assert kpis["inspection_time_s"] == pytest.approx(55.0 / 0.4, abs=2.0)
    with pytest.raises(RuntimeError, match="episode 0 has ended"):
        episodes.step(action)


@pytest.mark.parametrize(
    ("settings", "options", "message"),
    [
        ({"probes": "random"}, {}, "probes = 'random'"),
        ({}, {"friction": 0.5}, "friction = 0.5 is outside the map's range 0.1 to 0.25"),
        ({}, {"probe": {"line_density": 0.09}}, "probe: the map is of another one"),
        ({"config": {"growing": False}}, {}, "growing = False"),
        ({"config": {"vibration_measure": "velocity"}}, {}, "vibration_measure = 'velocity'"),
        ({"config": {"friction_drift": 0.1}}, {}, "friction_drift"),
    ],
)
def test_what_the_map_does_not_tell_is_refused_by_name(settings, options, message) -> None:  # type: ignore[no-untyped-def]
    given = dict(settings)
    config = TaskConfig.model_validate(given.pop("config", {}))
    with pytest.raises(ValueError, match=message):
        MapEpisodes(1, config, **given).reset([0], {0: np.random.default_rng(0)}, {0: options})


@pytest.mark.processor
def test_scatter_is_found_again(seeds: Seeds) -> None:
    """200 series of 300 seconds. The scatter of such estimates is Bartlett's, for an autocorrelation r and n seconds.

    It is sqrt((1 + r^2) / (1 - r^2) / 2n) = 0.9 % of the deviation and sqrt((1 - r^2) / n) = 0.0018 of the correlation;
    64 draws scattered by as much, and under noise by 0.9 % and 0.003. With 1e-4 in all, a bias of 4 % or 0.01 shows.
    """
    rng, true, count = np.random.default_rng(seeds(1)[0]), Scatter(deviation=0.2, correlation=0.9), 200
    value, values = true.deviation * rng.normal(size=count), []
    for _ in range(300):
        value = true.moved(value, rng.normal(size=count))
        values.append(value)
    series = list(np.array(values).T)
    r, seconds = true.correlation, 300 * count
    deviation, correlation = np.sqrt((1.0 + r**2) / (1.0 - r**2) / 2.0 / seconds), np.sqrt((1.0 - r**2) / seconds)
    estimate = Scatter.of(series)
    assert estimate.deviation == pytest.approx(0.2, rel=reach((deviation, 1), chance=CHANCE / 4))
    assert estimate.correlation == pytest.approx(0.9, abs=reach((correlation, 1), chance=CHANCE / 4))
    lasting = Scatter.of([x + 0.1 * rng.normal(size=300) for x in series], 8)
    assert lasting.deviation == pytest.approx(0.2, rel=reach((0.009, 1), chance=CHANCE / 4, measured=64))
    assert lasting.correlation == pytest.approx(0.9, abs=reach((0.003, 1), chance=CHANCE / 4, measured=64))


@pytest.mark.processor
def test_noise_is_found_in_the_world_that_it_makes(monkeypatch, seeds: Seeds) -> None:  # type: ignore[no-untyped-def]
    """24 insertions: what was put in comes out, but for what is known to be lost of it and the scatter of so many.

    Mean and deviation are of 16 other draws. All eleven hold but for 1e-4: a deviation that is a quarter off would
    show, a correlation of 0.96 for 0.9, or a bias left out.
    """
    true = Noise(
        bias=-0.1, slow=Scatter(deviation=0.2, correlation=0.9), quick=0.15,
        tension=Scatter(deviation=0.08, correlation=0.9), radial=(1.2, 0.7, -0.1, 0.1, 0.1, 0.1),
        radial_scatter=Scatter(deviation=0.2, correlation=0.9), axial=(0.8, 0.4, 0.0, 0.2, 0.0, 0.3),
        axial_scatter=Scatter(deviation=0.2, correlation=0.9),
    )  # fmt: skip
    seed = seeds(1)[0]
    monkeypatch.setattr(measure, "Episodes", lambda count, config, fidelity: _Recorded(count, config, true, seed))
    estimate = noise_of(measure.record_insertions(24), stored_map())
    drawn = {
        "bias": (estimate.bias, -0.095, 0.008), "quick": (estimate.quick, 0.148, 0.0025),
        "slow": (estimate.slow.deviation, 0.199, 0.005),
        "slow, correlation": (estimate.slow.correlation, 0.902, 0.0065),
        "tension": (estimate.tension.deviation, 0.080, 0.0025),
        "tension, correlation": (estimate.tension.correlation, 0.899, 0.0075),
        "radial": (estimate.radial_scatter.deviation, 0.1975, 0.0055),
        "radial, correlation": (estimate.radial_scatter.correlation, 0.891, 0.0055),
        "axial": (estimate.axial_scatter.deviation, 0.199, 0.003),
        "axial, correlation": (estimate.axial_scatter.correlation, 0.8965, 0.004),
        "radial by vibration": (estimate.radial[1], 0.708, 0.015),
    }  # fmt: skip
    for name, (value, mean, deviation) in drawn.items():
        assert value == pytest.approx(mean, abs=of_another(deviation, 16, among=len(drawn))), name


class _Recorded(MapEpisodes):
    """The world where simulated episodes are expected."""

    def __init__(self, count, config, noise, seed):  # type: ignore[no-untyped-def]
        super().__init__(count, config, noise=noise)
        self.window, self.seed = self, seed

    def reset(self, which, rngs, options=None):  # type: ignore[no-untyped-def]
        """With seeds of the test's own."""
        return super().reset(which, {k: np.random.default_rng([self.seed, k]) for k in which}, options)

    @property
    def statistics(self):  # type: ignore[no-untyped-def]
        return {"axial_acceleration_rms_m_per_s2": self.felt["axial_acceleration_rms_m_per_s2"]}

    def _felt(self, which, normal, move=True):  # type: ignore[no-untyped-def]
        self.felt = super()._felt(which, normal, move)
        return self.felt

    def _info(self, k, measured):  # type: ignore[no-untyped-def]
        name = "radial_acceleration_rms_m_per_s2"
        return super()._info(k, measured) | {name: float(measured[name][k])}


def test_policies_keep_their_order_and_differences_are_paired() -> None:
    table = rewards_in_the_map(("constant", "best-schedule", "privileged"), limit=6)
    means = table.groupby("policy")["reward"].mean()
    assert means["constant"] < means["best-schedule"] - 50.0
    assert means["best-schedule"] < means["privileged"]
    simulated = table.assign(reward=table["reward"] - 1.0)
    comparison, agreement = compared(table, simulated)
    assert agreement == {"tau": 1.0, "tubes": 6.0}
    np.testing.assert_allclose(comparison[["error", "error_low", "error_high"]], 1.0)


def test_the_noise_that_ships_is_read_and_a_damaged_one_refused(tmp_path) -> None:  # type: ignore[no-untyped-def]
    noise = stored_noise()
    assert 0.05 < noise.quick < 0.5
    assert 0.5 < noise.slow.correlation < 1.0
    path = tmp_path / "map-world.json"
    record = json.loads(measure.STORED.read_text())
    path.write_text(json.dumps(record | {"noise": {"slow": {"deviation": -1.0}}}))
    with pytest.raises(FileError, match=r"slow\.deviation"):
        stored_noise(path)


def test_agents_train_in_it_and_are_validated_by_simulation() -> None:
    assert Training.model_validate({"environment": {"fidelity": "map"}}).environment.fidelity == "map"
    with pytest.raises(ValueError, match="agents are chosen by simulation"):
        Training.model_validate({"validation": {"fidelity": "map"}})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("policy,context\npi,0\n", "column 'reward' is missing"),
        ("policy,context,reward\npi,0,loud\n", "line 2: reward = 'loud' is not a number"),
        ("\x00", "episodes.csv"),
    ],
)
def test_what_it_is_compared_with_is_read_before_any_work(tmp_path, monkeypatch, text, said):
    monkeypatch.setattr(measure, "record_insertions", lambda limit: pytest.fail("insertions were recorded"))
    path = tmp_path / "episodes.csv"
    path.write_text(text)
    with pytest.raises(FileError, match=said):
        measure.run_world(6, path, tmp_path / "world")
    assert not (tmp_path / "world").exists()
