"""Policies around a policy: the shield keeps the drive and leaves alone what is safe."""

from collections import defaultdict, deque
from types import SimpleNamespace

import numpy as np
import pytest

from probe_agents.evaluation.plan import Plan, RolloutRunner
from probe_agents.policies.catalogue import domains_of, make_policy, name_and_spec, named_policies, user_policies
from probe_agents.policies.fixed import Constant
from probe_agents.policies.wrappers import Shielded, SpeedLimited, fastest_withdrawal
from probe_env import Context, Plant, Scene, TaskConfig
from probe_env.envs.task.observations import observe
from probe_env.fidelity import ROUND_TRIP_PRESETS, resolve_fidelity
from probe_env.physics.closed_forms import entrance_tension, sliding_tension

CONFIG = TaskConfig(scene=Scene.fitted({"tube": {"helix_length": 30.0}})).full_observation
HARD = (
    Context(friction=0.25, drag_factor=0.9, helix_diameter=1.0, contact_stiffness=0.7e5),
    Context(friction=0.35, drag_factor=0.7, helix_diameter=1.0),
)


def measured(friction, config=CONFIG):
    """Observations (N, d) of steady sliding without noise at 40 m with 0.2 m/s and 63 m3/h, with frictions (N,)."""
    one, scene = np.ones(len(friction)), config.scene
    sliding = {"inserted_length": 40.0, "feed_speed": 0.2, "air_supply_rate": 63.0 / 3600.0, "helix_diameter": 1.2}
    sliding = {name: value * one for name, value in sliding.items()}
    probe = {name: getattr(scene.probe, name) * one for name in config.observations if hasattr(scene.probe, name)}
    tension = sliding_tension(np.asarray(friction), sliding, scene) - entrance_tension(scene, 1.2 * one)
    known = sliding | probe | {"tension_mean_n": tension, "radial_rms_m": 1e-4 * one}
    return observe(config, defaultdict(lambda: one, known), np.zeros((len(friction), 2)))


def given(actions):
    """A policy that does what it is told."""
    return SimpleNamespace(predict=lambda *_, **__: (np.array(actions, dtype=np.float32), None))


def acted(actions, friction, config=CONFIG, **options):
    """Actions behind a shield that already knows the friction."""
    shield = Shielded(config, given(actions), **options)
    return shield.predict(measured(friction, config=config), (None, np.asarray(friction)))[0]


def tensions(actions, friction, scene=CONFIG.scene):
    """Steady root tension of actions (N, 2), as the feed device feels it."""
    feed, air = CONFIG.targets(actions).T
    one = np.ones(len(feed))
    seen = {"inserted_length": 40.0 * one, "feed_speed": feed, "air_supply_rate": air, "helix_diameter": 1.2 * one}
    return sliding_tension(friction * one, seen, scene) - entrance_tension(scene, 1.2 * one)


def test_shield_changes_only_targets_below_the_margin():
    rng = np.random.default_rng(0)
    told, friction = rng.uniform(-1.0, 1.0, (500, 2)).astype(np.float32), rng.uniform(0.1, 0.5, 500)
    wanted, shielded = tensions(told, friction), acted(told, friction)
    safe = wanted >= 1.5 * 0.8
    assert 50 < safe.sum() < 450
    assert (shielded[safe] == told[safe]).all()
    # float32 actions and observations: 1e-5 of the friction that is read
    assert tensions(shielded[~safe], friction[~safe]) == pytest.approx(1.2, rel=1e-4)
    assert (shielded[~safe, 0] == told[~safe, 0]).all()  # there is air enough


def test_the_margin_is_that_of_the_route():
    """12 m of rising tube before the helix need 3.1 N or so at this friction, not the 0.8 N of the task."""
    tube, route = {"helix_length": 30.0}, [{"length": 12.0, "slope": 90.0}, {"helix": True}]
    config = Plant.model_validate({"assumptions": "study", "tube": tube, "route": route}).config.full_observation
    assert config.required_tension == pytest.approx(3.2, abs=0.1)
    shielded = acted([[0.0, -1.0]], np.array([0.15]), config)
    assert tensions(shielded, 0.15) == pytest.approx(1.5 * config.required_tension, rel=1e-4)


def test_margin_holds_with_weight_in_expanding_air():
    """The tension is not proportional to the square of the wind; that of the action is within float32 of the margin."""
    config = CONFIG.model_copy(update={"scene": CONFIG.scene.whole()})
    friction = np.array([0.1, 0.2, 0.3])
    shielded = acted([[0.0, -1.0]] * 3, friction, config)
    assert tensions(shielded, friction, config.scene) == pytest.approx(1.2, rel=1e-4)


def test_shield_takes_the_nearest_safe_action():
    """Of a grid of 201 x 201; blowing more alone is off the nearest point by (0.19 / 34)^2 / 2 = 2e-5 of the way."""
    axis = np.linspace(-1.0, 1.0, 201)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    told = np.array([[0.3, -0.98]], dtype=np.float32)
    for friction in (0.25, 0.4, 0.7):
        kept = grid[tensions(grid, friction) >= 1.2]
        nearest = np.hypot(*(kept - told).T).min()
        assert 0.0 < np.hypot(*(acted(told, np.array([friction])) - told)[0]) <= nearest * (1.0 + 3e-5) + 1e-6


def test_shield_slows_the_feed_or_adds_air_in_whole_steps():
    assert acted([[1.0, 0.9]], np.array([0.5]), margin=40.0)[0].tolist() == [-1.0, 1.0]
    config = CONFIG.model_copy(update={"air_supply_step": 10.0 / 3600.0})
    shielded = acted([[config.standstill, -1.0]], np.array([0.6]), config)
    assert shielded[0, 0] == config.standstill
    air = config.targets(shielded, allow_standstill=True)[0, 1] * 360.0
    assert air == pytest.approx(round(air), abs=1e-5)
    assert tensions(np.array([[-1.0, shielded[0, 1]]]), 0.6)[0] >= 1.2


def outcomes(policy, tubes):
    """Pairs of KPIs and profile without and with the shield, by tube."""
    policies = {"bare": policy, "shielded": Shielded(CONFIG, policy)}
    plan = Plan(policies, tubes, config=CONFIG, fidelity=resolve_fidelity("fast"))
    runner, ended = RolloutRunner(plan, deque(plan.episode_ids()), 12, 1), []
    while not runner.over:
        ended += runner.step()
    found = {tuple(record["episode"][:2]): (record["kpis"], record["profile"]) for record in ended}
    return [(found["bare", k], found["shielded", k]) for k in range(len(tubes))]


def test_shield_keeps_the_drive_in_hard_tubes():
    for (without, _), (with_it, _) in outcomes(Constant(CONFIG, feed_speed=0.4, air_supply_rate=30.0 / 3600.0), HARD):
        assert without["lost_drive"] == 1.0
        assert (with_it["complete"], with_it["cost_lost_drive"]) == (1.0, 0.0)


@pytest.mark.slow
def test_shield_does_not_change_the_best_schedule():
    for without, with_it in outcomes(make_policy("best-schedule", CONFIG), (*HARD, Context(friction=0.15))):
        assert without == with_it


def test_it_goes_by_a_prefix(tmp_path):
    assert name_and_spec("shielded:ppo@1") == ("shielded-ppo@1", "shielded:ppo@1")
    assert name_and_spec("mine=shielded:pi") == ("mine", "shielded:pi")
    assert name_and_spec("shielded:mine=pi") == ("shielded-mine", "shielded:pi")
    file = tmp_path / "own.csv"
    file.write_text("inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n0,0.2,60\n")
    specs = [f"shielded:{file}", "shielded:best-schedule", "best-schedule"]
    policies = named_policies(specs, CONFIG)
    assert list(policies) == ["shielded-own", "shielded-best-schedule", "best-schedule"]
    assert user_policies(specs) == ["shielded-own"]
    domains = domains_of(specs, policies)
    assert domains["shielded-best-schedule"] == domains["best-schedule"]
    both = make_policy("shielded:fast-in", TaskConfig(passes="both").full_observation)
    assert isinstance(both.insertion, Shielded)
    assert make_policy("shielded:pi", CONFIG).describe() == make_policy("shielded:pi", CONFIG).describe()


INSTRUMENT = {"instrument": {"test_frequency": 100.0}}  # permits 100 Hz / 4 x 20 mm / 2 = 0.25 m/s


def test_feed_is_limited_to_the_permitted_speed():
    config = CONFIG.model_copy(update=INSTRUMENT)
    actions = config.actions(np.array([0.4, 0.26, 0.25, 0.1]), np.full(4, 0.02)).astype(np.float32)
    limited = SpeedLimited(config, given(actions)).predict(measured(np.full(4, 0.2)))[0]
    assert config.targets(limited)[:, 0] == pytest.approx([0.25, 0.25, 0.25, 0.1], abs=1e-7)
    assert (limited[:, 1] == actions[:, 1]).all()
    assert (limited[3] == actions[3]).all()
    steps = config.model_copy(update={"feed_speed_step": 0.1})  # not the nearest step, which is faster than permitted
    limited = SpeedLimited(steps, given(actions)).predict(measured(np.full(4, 0.2)))[0]
    assert steps.targets(limited)[:, 0] == pytest.approx([0.2, 0.2, 0.2, 0.1])


@pytest.mark.parametrize(
    ("scored_pass", "feeds"), [("insertion", [0.25, 0.4]), ("withdrawal", [0.4, 0.25]), ("best", [0.25, 0.25])]
)
def test_permitted_speed_applies_to_scored_passes_only(scored_pass, feeds):
    config = CONFIG.model_copy(update=INSTRUMENT | {"passes": "both", "scored_pass": scored_pass})
    rows = np.zeros((2, len(config.observations)), dtype=np.float32)
    rows[:, list(config.observations).index("direction")] = 1.0, -1.0
    limited = SpeedLimited(config, given([[1.0, 0.0], [1.0, 0.0]])).predict(rows)[0]
    assert config.targets(limited)[:, 0] == pytest.approx(feeds)
    assert fastest_withdrawal(config).feed_speed == pytest.approx((feeds[1],))


def test_what_it_cannot_do_is_refused():
    with pytest.raises(ValueError, match=r"margin = 0.5 is outside the accepted range 1 to 100"):
        Shielded(CONFIG, given([[0.0, 0.0]]), margin=0.5)
    with pytest.raises(ValueError, match="the shield needs the root tension"):
        make_policy("shielded:pi", TaskConfig(observe_root_tension=False))
    for passes in ("in", "both"):
        with pytest.raises(ValueError, match="'shielded:planner': the shield needs a policy that acts on observations"):
            make_policy("shielded:planner", TaskConfig(passes=passes).full_observation)
    assert resolve_fidelity("fast", round_trip=True) == ROUND_TRIP_PRESETS["fast"]
