"""Slow motion near the tip: recording changes nothing, and pictures equal the state of the simulator."""

import copy

import gymnasium as gym
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from scipy.ndimage import label

from probe_env import Fidelity, Scene, Simulator
from probe_env.envs.pictures.plate import GREEN, ORANGE, RED
from probe_env.envs.pictures.strip import AXIAL, FRAME_PERIOD, FRAMES_PER_SECOND, SLOWED, Strip, Watch
from probe_env.physics.simulation.signals import SAMPLE_PERIOD, dominant_frequencies

NOTHING = np.zeros(0)


def record(simulator, duration, length=10.0):
    watch = Watch(simulator, length, NOTHING, NOTHING)
    watch.follow(simulator, None, None, duration)
    return watch.motion()


@pytest.fixture(scope="module")
def ringing():
    """Table 2's probe in sliding motion at 32.5 m, where the axial motion has a peak of its signal_."""
    scene = Scene(carrier_length=30.0, probe={"carrier_float_diameter": 0.0185})
    simulator = Simulator(scene, method="superelement32", time_step=2e-4, perturbation=1e-7)
    simulator.advance(duration=2.0)
    return simulator


@pytest.fixture(scope="module")
def motion(ringing):
    return record(ringing, 0.2)


def mask(picture, colour):
    return np.abs(picture - 255.0 * np.array(to_rgb(colour))).max(axis=-1) < 35.0


def walls_of(inside):
    """Rows of the outer and the inner wall in the tube's part of a picture: black, where no float lies over them."""
    rows = np.flatnonzero((inside < 60).all(axis=-1).mean(axis=1) > 0.4)
    half = len(inside) / 2
    return rows[rows < half].mean(), rows[rows > half].mean()


def tube_of(picture, strip):
    box = strip._tube.get_window_extent()
    rows = slice(round(600 - box.y1) + 2, round(600 - box.y0) - 2)
    return picture[rows, round(box.x0) + 2 : round(box.x1) - 2]


@pytest.mark.parametrize(
    ("env_id", "fidelity"),
    [
        ("probe_env/Insertion-v1", "standard"),
        ("probe_env/Insertion-v1", "fast"),
        ("probe_env/Snapshot-v1", "study"),
        ("probe_env/Insertion-v1", Fidelity(time_lapse=125.0)),  # 8 ms per period: not whole frames
        ("probe_env/Snapshot-v1", "standard"),
    ],
)
def test_recording_changes_nothing_and_equals_the_environment(env_id, fidelity):
    """The environment continues bit for bit, and the recorded copy ends a period in the environment's state."""
    env, other = (gym.make(env_id, fidelity=fidelity, scene={"carrier_length": 5.0}).unwrapped for _ in range(2))
    for each in (env, other):
        each.reset(seed=5)
    episodes = env.episodes
    period = episodes.config.period / episodes.fidelity.time_lapse
    watch = Watch(episodes.simulated().simulators[0], 2.0, NOTHING, NOTHING)
    for k in range(4):
        action = np.array([0.5, -0.1 * k], dtype=np.float32)
        targets = episodes.config.targets(action[None])[0]
        ahead = watch.follow(episodes.simulated().simulators[0], *targets, period)
        one, two = env.step(action), other.step(action)
        assert (one[0] == two[0]).all()
        assert one[1:] == two[1:]
        for here, there in zip(ahead.state, episodes.simulated().simulators[0].state, strict=True):
            assert (here == there).all()
        assert ahead.inserted_length == episodes.simulated().simulators[0].inserted_length
    motion = watch.motion()
    assert len(motion.time) == int(4 * period / FRAME_PERIOD + 1e-9) + 1
    window = episodes.window
    for signal, samples in ((motion.signal_axial, window.axial), (motion.signal_radial, window.radial)):
        assert (signal[-len(samples) :] == samples[:, 0]).all()
    every = round(FRAME_PERIOD / SAMPLE_PERIOD)
    for shape, signal in ((motion.axial, motion.signal_axial), (motion.radial, motion.signal_radial)):
        assert (shape[1:, motion.sensor] == signal[every - 1 :: every]).all()


@pytest.mark.slow
def test_the_frequency_of_the_probe_is_in_the_pictures(ringing):
    """The sensor's mark, found by its colour in 2 s of pictures, moves as the simulator's signal, within a pixel.

    Pictures 5 ms apart hold 100 Hz, and the bins of 0.5 Hz are those of the signal at 1 kHz. The probe vibrates at
    15.0 to 15.5 Hz there (twelve members, both precisions).
    """
    simulated = copy.deepcopy(ringing).advance(duration=2.0, points=("sensor",)).axial[:, 0]
    motion = record(copy.deepcopy(ringing), 2.0)
    strip = Strip(motion, "constant")
    columns = []
    for k in range(len(motion.time)):
        green = mask(tube_of(strip.picture(k), strip), GREEN).sum(axis=0)
        columns.append((np.arange(len(green)) * green).sum() / green.sum())
    pixel = 1.0 / strip.axial_scale / AXIAL
    positions = np.array(columns) * pixel
    assert np.ptp(positions) > 4.0 * pixel  # the mark moves
    (frequency,), (expected,) = (
        dominant_frequencies(signal, period, 1)
        for signal, period in ((positions, FRAME_PERIOD), (simulated, SAMPLE_PERIOD))
    )
    assert frequency == pytest.approx(expected, abs=0.51)
    assert 13.0 < expected < 17.0
    assert positions - positions.mean() == pytest.approx(simulated[::5] - simulated[::5].mean(), abs=pixel)


def test_walls_and_floats_are_drawn_to_scale(motion):
    strip = Strip(motion, "constant")
    inside = tube_of(strip.picture(0), strip)
    outer, inner = walls_of(inside)
    assert inner - outer == pytest.approx(24.2e-3 * strip.radial_scale, abs=1.0)  # pixels
    edge, floats = strip.edge(0), motion.floats
    assert (edge[:, 1] == 1e3 * motion.radial[0]).all()
    assert np.abs(edge[:, 0] + motion.distance - AXIAL * motion.axial[0]).max() < 1e-12
    bars = np.array(strip._floats.get_segments())
    assert bars[:, 1, 1] - bars[:, 0, 1] == pytest.approx(np.where(motion.distance[floats] <= 2.5, 19.0, 18.5))
    assert np.flatnonzero(floats).tolist() == list(range(0, 401, 4))
    texts = " ".join(text.get_text() for text in strip._now.figure.texts)
    assert f"stretched x {strip.radial_scale / strip.axial_scale:.0f}" in texts
    assert "last 10 m" in texts
    assert "slowed down 8 times" in texts
    assert pytest.approx(1.0) == SLOWED * FRAMES_PER_SECOND * FRAME_PERIOD
    assert "bore 24.2 mm, floats 18.5 and 19 mm" in texts


def test_contacts_are_those_of_the_model(ringing, motion):
    """Flags by the gaps of the chain, and one mark per contact at each wall."""
    chain, n = ringing.chain, len(motion.distance)
    stiff = chain.contact_stiffness[:n] > 0.0
    assert (motion.on_inner_wall == (stiff & (motion.radial < 0.0))).all()
    assert (motion.on_outer_wall == (stiff & (motion.radial > 0.0242 - 2.0 * chain.lever[:n]))).all()
    k = int(np.argmax(motion.on_outer_wall.sum(axis=1)))
    assert motion.on_inner_wall[k].any()
    strip = Strip(motion, "constant")
    inside = tube_of(strip.picture(k), strip)
    outer, inner = (round(row) for row in walls_of(inside))
    beyond = ((RED, inside[inner + 4 :], motion.on_inner_wall), (ORANGE, inside[: outer - 3], motion.on_outer_wall))
    for colour, part, flags in beyond:
        _, marks = label(mask(part, colour))
        assert marks == flags[k].sum()


def test_without_an_outer_wall_there_is_no_contact(ringing):
    scene = ringing.scene.model_copy(update={"contact": {"walls": "inner"}})
    motion = record(Simulator(scene, method="imex", time_step=2e-4), 0.02, length=100.0)
    assert not motion.on_outer_wall.any()
    assert motion.distance[-1] == pytest.approx(32.5 - 0.025)  # what is inserted, without the held root
    assert Strip(motion, "constant").picture(1).shape == (600, 1000, 3)


def test_a_fed_probe_stays_in_the_picture():
    """Nodes are numbered from the tip: new nodes at the entrance do not move the others."""
    simulator = Simulator(Scene(carrier_length=5.0, feed_speed=1.0), method="imex", time_step=2e-4, growing=True)
    motion = record(simulator, 0.2, length=3.0)
    assert motion.inserted_length[-1] == pytest.approx(7.7, abs=1e-9)
    assert motion.axial.shape == (41, 121)
    assert simulator.inserted_length == 7.5
    assert simulator.time == 0.0
