"""Contexts beyond the limits of step or model are refused at reset; all others stay finite and in the spaces."""

import ast
import math
import re
from contextlib import nullcontext

import gymnasium as gym
import numpy as np
import pytest

from probe_env import Context, Design, Fidelity, Probe, Scene, SimulatorBatch, load_contexts
from probe_env.design import MIN_RANDOM_PITCH
from probe_env.envs.design_env import DesignEnv
from probe_env.envs.episodes.limits import check_simulable, softest_wall, steady_sliding
from probe_env.envs.episodes.starts import EpisodeSampler
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.trials import HARDEST, check_candidate, sections_of
from probe_env.fidelity import PRESETS
from probe_env.physics.methods.stability import FULL
from probe_env.schedule import Schedule

MAX_AIR = TaskConfig().air_supply_rates[1]
STANDARD = PRESETS["standard"]
NODES = {"standard": Fidelity(method="imex32"), "reference": Fidelity(method="imex", time_step=5e-5)}
FIDELITIES = {name: PRESETS[name] for name in ("study", "reference", "standard")} | {
    f"{name} on nodes": fidelity for name, fidelity in NODES.items()
}
IDS = ("probe_env/Insertion-v1", "probe_env/Snapshot-v1")
REFUSED = {
    "contact_stiffness = 1e+06 N/m: superelement32 needs a time step of at most 7.62e-05 s, and that of this"
    " fidelity is 0.0002 s: give fidelity = {'method': 'superelement32', 'time_step': 5e-05,": {
        "contact_stiffness": 1e6
    },
    "contact_stiffness = 1e+08 N/m: contact.stiffness asks for modes up to": {"contact_stiffness": 1e8},
    "contact_stiffness = 1000 N/m is below 1169 N/m (pi^4 EI / (4 p^3)): ": {"contact_stiffness": 1e3},
    "helix_diameter = 0.5 m with contact_stiffness = 3000 N/m and a drag coefficient of 4.4: at 130 m3/h and": {
        "contact_stiffness": 3e3, "drag_factor": 10.0, "friction": 0.1, "helix_diameter": 0.5
    },
}  # fmt: skip


@pytest.mark.parametrize("message", REFUSED)
def test_every_environment_refuses_by_name(message):
    make = {"Insertion-v1": gym.make, "Snapshot-v1": lambda env_id: gym.make_vec(env_id, 2), "Design-v1": gym.make}
    for name, function in make.items():
        # Design-v1 has shorter pitches, which need a stiffer wall
        stated = re.search(r"contact_stiffness = \S+ N/m", message)[0] if "Des" in name else message
        with pytest.raises(ValueError, match=re.escape(stated)) as error:
            function(f"probe_env/{name}").reset(seed=0, options=dict(REFUSED[message]))
        assert "\n" not in str(error.value)


TURNED = {"contact_stiffness": 3e3, "drag_factor": 5.0, "helix_diameter": 0.45, "friction": 0.9}
REST, SLIDING = "as it starts from rest", "as it slides"
PULLED = [
    ({"contact_stiffness": 1e5, "drag_factor": 5.0, "helix_diameter": 1000.0, "friction": 0.3}, REST),
    ({"contact_stiffness": 1e5, "drag_factor": 4.0, "helix_diameter": 0.7, "friction": 0.2}, REST),
    ({"contact_stiffness": 5e4, "drag_factor": 2.1, "helix_diameter": 3000.0, "friction": 0.5}, SLIDING),
]
"""Contexts in which superelements diverge at 2e-4 s, the last one only once much cable is in a straight tube, in air
that does not expand."""


@pytest.mark.parametrize(("context", "how"), PULLED)
@pytest.mark.parametrize("method", ["superelement32", "superelement"])
def test_unstable_step_is_refused_with_a_stable_one(context, how, method):
    env_id, scene = IDS[how == REST], None if how == REST else Scene()
    fidelity = {"method": method, "time_step": 2e-4}
    with pytest.raises(ValueError, match=rf"drag pulls the probe with \S+ N {how}: \w+ needs a") as error:
        gym.make(env_id, fidelity=fidelity, scene=scene).reset(seed=0, options=context)
    fidelity = ast.literal_eval(str(error.value).split("give fidelity = ")[1])
    assert fidelity["time_step"] < 2e-4
    env = gym.make(env_id, fidelity=fidelity, scene=scene)
    for seed in range(3):
        env.reset(seed=seed, options=context)
        assert not env.step(np.zeros(2, dtype=np.float32))[-1]["diverged"]


@pytest.mark.parametrize("terms", [{}, {"shortening": True}])
def test_starts_that_superelements_do_not_survive_are_refused(terms):
    """T dt / (rho p) = 1.2 m/s is below ``START_LIMIT``, but the couple of the study diverges within 0.15 s."""
    probe = {"float_pitch": 0.15, "flexural_rigidity": 0.03, "guide_length": 2.55}
    scene = Scene(probe=probe, air_supply_rate=130 / 3600, carrier_length=35.1, terms=terms)
    refusal = pytest.raises(
        ValueError, match=r"as it starts from rest: superelement32 needs a time step of at most 0.0001"
    )
    with nullcontext() if terms else refusal:
        check_simulable(scene, STANDARD, scene.inserted_length, scene.air_supply_rate)
    batch = SimulatorBatch([scene], STANDARD.method, STANDARD.time_step, perturbation=1e-7)
    assert batch.advance(None, None, 0.2).diverged.any() == (not terms)


def test_a_refused_reset_changes_nothing():
    env = gym.make_vec("probe_env/Snapshot-v1", 2, vectorization_mode="vector_entry_point")
    runs = []
    for refused in (False, True):
        env.reset(seed=3)
        if refused:
            with pytest.raises(ValueError, match="environment 0: contact_stiffness"):
                env.reset(options={"contact_stiffness": 1e7})
            with pytest.raises(ValueError, match=r"so that it turns by [0-9.]+ rad along the helix, .* up to 1 rad"):
                env.reset(options=TURNED)
        runs.append([env.step(np.zeros((2, 2), dtype=np.float32))[0], env.reset()[0]])
    assert (np.array(runs[0]) == np.array(runs[1])).all()


def test_shipped_tubes_and_designs_are_accepted():
    """With a margin of two in the rotation."""
    rng = np.random.default_rng(0)
    tubes = [context for split in ("train", "validation", "test") for context in load_contexts(split)]
    starts = EpisodeSampler(TaskConfig(), "random", "random", 0.2, MAX_AIR)
    hard = Schedule("inserted_length", "linear", (5.0,), (0.02,), (MAX_AIR,))
    for k, context in enumerate(tubes):
        # superelements look for modes and mass of every probe: every seventh tube, of all diameters
        fidelity = STANDARD if k % 7 == 0 else NODES["standard"]
        for design in HARDEST if k % 7 == 0 else ():  # expanding air pulls less than the limit of the step
            for feed in (hard, None):
                check_candidate(design, context, TaskConfig(), fidelity, feed)
        random = [design.model_copy(update={"float_pitch": MIN_RANDOM_PITCH}) for design in HARDEST]
        for design in (*random, Design(), Design.random(rng)):
            scene = starts.build(context, {"probe": design.built.model_dump()})
            check_simulable(scene, fidelity, 60.0, MAX_AIR)
            for start, air in sections_of(design, context, hard, TaskConfig())[::4]:
                check_simulable(start, fidelity, start.inserted_length, air)
                sliding = steady_sliding(start, start.inserted_length, MAX_AIR, 0.0)
                assert sliding.slide * 2.0 / context.helix_diameter < 0.5


@pytest.mark.parametrize("stiffness", [1e5, 1e6, 1e7, 1e8])
@pytest.mark.parametrize("preset", FIDELITIES.values(), ids=FIDELITIES)
def test_fidelity_in_the_error_message_is_stable(stiffness, preset):
    fidelity, scene = preset, Scene(carrier_length=5.0, contact={"stiffness": stiffness})
    limit = FULL / math.sqrt(stiffness / (0.111 * 0.025))
    if fidelity.method.on_nodes:
        assert fidelity.method.contact_step(scene, 4) == pytest.approx(limit)
    if fidelity.time_step > limit:
        with pytest.raises(ValueError, match="give fidelity = ") as error:
            check_simulable(scene, fidelity, 7.5, MAX_AIR)
        fidelity = Fidelity.model_validate(ast.literal_eval(str(error.value).split("give fidelity = ")[1]))
    check_simulable(scene, fidelity, 7.5, MAX_AIR)
    # warnings are errors here
    batch = SimulatorBatch([scene], fidelity.method, fidelity.time_step, perturbation=1e-5, ramp=0.5, air_lag=1.0)
    assert not batch.advance(0.4, MAX_AIR, 0.1).diverged.any()


def test_auto_selects_a_step_that_is_stable_for_all_samples():
    for env_id, probes in ((i, p) for i in IDS for p in ("scene", "random")):
        episodes = gym.make(env_id, fidelity="auto", probes=probes).unwrapped.episodes
        stiffest = Context(contact_stiffness=1.4e5)
        scene = episodes.sampler.build(stiffest, {"probe": HARDEST[0].built.model_dump()} if probes == "random" else {})
        assert episodes.fidelity.time_step <= episodes.fidelity.method.contact_step(scene, 4)
    soft = gym.make("probe_env/Snapshot-v1", fidelity="auto", scene=Scene(contact={"stiffness": 1e4}))
    soft.reset(seed=0)  # contexts set the stiffness: the scene's own 1e4 N/m would have allowed 5e-4 s
    hardest = Scene(probe=HARDEST[0].probe(), contact={"stiffness": 1.4e5})
    fidelity = DesignEnv(fidelity="auto").fidelity
    assert fidelity.time_step <= fidelity.method.stable_step(hardest, 4)


def test_steady_sliding_equals_numerical_integration():
    scene = Scene(probe={"guide_float_diameter": 0.02, "carrier_float_diameter": 0.016, "guide_length": 10.0})
    pieces = 500_000
    ds, r = 60.0 / pieces, 0.6
    wind = MAX_AIR / (math.pi / 4.0 * (0.0242**2 - 0.00835**2))
    tension = slide = 0.0
    for k in range(pieces):
        d = 0.02 if k * ds < 10.0 else 0.016
        drag = 0.5 * 0.44 * 1.023 * math.pi / 4.0 * (d**2 - 0.00835**2) / 0.1 * wind**2
        slide += tension * (1.0 / 1.1e5 + 0.1 / (1e5 * r**2)) * ds
        tension += (drag - 0.15 * (1.0 - d / 1.2) * tension / r) * ds
    closed_form = steady_sliding(scene, 60.0, MAX_AIR, 0.15)
    # the sums are of first order in ds mu / r, and a piece may be on the wrong side of the guide's end
    assert closed_form.slide == pytest.approx(slide, rel=1e-4)
    assert closed_form.tension >= tension
    plain = steady_sliding(scene.model_copy(update={"probe": Probe()}), 60.0, MAX_AIR, 0.0)
    drag = 0.5 * 0.44 * 1.023 * math.pi / 4.0 * (0.019**2 - 0.00835**2) / 0.1 * wind**2
    assert plain.tension == pytest.approx(60.0 * drag, rel=1e-12)
    nearly, none = (steady_sliding(scene, 60.0, MAX_AIR, friction) for friction in (1e-8, 0.0))
    assert nearly.slide == pytest.approx(none.slide, rel=1e-5)  # both forms meet


def test_softest_wall_buckles_with_the_cable():
    probe = Probe()
    foundation = softest_wall(probe) / probe.float_pitch
    euler = math.pi**2 * probe.flexural_rigidity / probe.float_pitch**2
    assert 2.0 * math.sqrt(probe.flexural_rigidity * foundation) == pytest.approx(euler, rel=1e-12)


@pytest.mark.parametrize("stiffness", [1.5e5, 1.9e5, 2.05e5, 2.2e5, 2.4e5, 3e5])
@pytest.mark.parametrize("fidelity", FIDELITIES.values(), ids=FIDELITIES)
def test_an_accepted_step_is_known_to_be_stable(fidelity, stiffness):
    """No warning between the longest step known to be stable and the limit of contact."""
    env = gym.make("probe_env/Snapshot-v1", fidelity=fidelity)
    known = fidelity.method.stable_step(Scene(contact={"stiffness": stiffness}), 4)
    message = f"contact_stiffness = {stiffness:g} N/m: .* time step of at most"
    with pytest.raises(ValueError, match=message) if fidelity.time_step > known else nullcontext():
        env.reset(seed=0, options={"contact_stiffness": stiffness})  # warnings are errors here


@pytest.mark.parametrize(("env_id", "periods"), [(IDS[0], 4), (IDS[1], 12)])
def test_extreme_contexts_are_refused_or_finite(env_id, periods):
    """An unstable step diverges within 0.2 s; other divergence is of a probe under compression and is reported."""
    rng, count = np.random.default_rng(5), 8
    env = gym.make_vec(env_id, count, vectorization_mode="vector_entry_point", config={"privileged": True})
    episodes, space, accepted, refused = env.episodes, env.single_observation_space, [], 0
    while len(accepted) < count:
        context = {  # far from the tubes of the task, log-uniform
            "friction": float(rng.uniform(0.0, 1.0)),
            "contact_stiffness": float(10.0 ** rng.uniform(2.0, 8.0)),
            "drag_factor": float(10.0 ** rng.uniform(-1.0, 1.0)),
            "helix_diameter": float(10.0 ** rng.uniform(math.log10(0.3), 4.0)),
        }
        try:
            episodes.reset([0], {0: np.random.default_rng(0)}, {0: context})
            accepted.append(context)
        except ValueError as error:
            assert re.match(r"environment 0: (contact_stiffness|helix_diameter) = ", str(error))  # noqa: PT017
            refused += 1
    assert refused > 0
    episodes.reset(range(count), {k: np.random.default_rng(k) for k in range(count)}, dict(enumerate(accepted)))
    for _ in range(periods):
        compressed = [s.state.axial_force[: s.root].min() < 0.0 for s in episodes.simulated().simulators]
        active = episodes.running.copy()
        step = episodes.step(rng.uniform(-1.0, 1.0, (count, 2)).astype(np.float32), active)
        assert all(space.contains(row) for row in step.observation)
        assert np.isfinite(step.reward).all()
        for k in np.flatnonzero(active):
            info = step.infos[k]
            assert all(np.isfinite(value) for value in info.values() if isinstance(value, float))
            assert not info["diverged"] or (step.terminated[k] and compressed[k])
            assert info["diverged"] == episodes.simulated().simulators[k].diverged
