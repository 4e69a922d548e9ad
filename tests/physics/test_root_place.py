"""Why a root between two floats rings more than one at a float's place: the first float's turn makes the arc longer.

See docs/simulation/root.md for the derivation.
"""

import math

import numpy as np
import pytest
from oracles.chains import bent, matrices, plain_chain
from oracles.root_waves import MIDDLE, arc_of_rotation, conversion, far_stiffness, lengthening, near_stiffness
from oracles.scatter import apart, reach
from oracles.sliding import growth_rates, sliding_system

from probe_env import Scene, SimulatorBatch
from probe_env.physics.model.chain import build_chain

SCENE = Scene()
WIDE = Scene(tube={"helix_diameter": 12.0})
"""Ten times as wide: a closed form of first order in p / r is off by (p / r)^2, 3e-4, here."""
PITCH, EI = SCENE.probe.float_pitch, SCENE.probe.flexural_rigidity
SECOND_ORDER = (2.0 * PITCH / WIDE.tube.helix_diameter) ** 2
NODES = 4
LIVE = 16
STORED = {0.0: 1.25975e-4, 0.25: 2.07538e-4, 0.5: 1.90821e-4, 1.0: 1.29347e-4}
"""Place of the root in a pitch: mean radial rms [m] of 16 runs, from 2 to 8 s (results/study/root.csv)."""
DEVIATION = 0.16
"""Relative, of the radial rms of one run of 6 s at 30 m by superelement32 at 2e-4 s: pooled over the 5 places of 16
members each in results/study/root.csv, rounded up."""


def held_floats(place):
    """Ten pitches of bent cable that does not stretch, floats held radially without friction.

    Returns its stiffness, and where in it are the first float's rotation and the tip's x.
    """
    chain = bent(plain_chain(10 * NODES + round(place * NODES)), WIDE.tube.helix_diameter)
    _, stiffness = matrices(chain._replace(axial_compliance=1e-5 * chain.axial_compliance))
    free = np.ones(len(stiffness), dtype=bool)
    free[1 :: 3 * NODES] = False
    kept = np.flatnonzero(free)
    return stiffness[np.ix_(free, free)], int(np.searchsorted(kept, 3 * 10 * NODES + 2)), 0


@pytest.mark.parametrize("place", [0.25, 0.5, 0.75])
def test_the_first_floats_turn_makes_the_arc_longer(place):
    """At rest: the tip moves by (p^2 - a^2) / 12 r of the first float's turn, on any mesh.

    Elements are exact for loads at nodes, and of the trapezoids over y what is too little in the root's piece is too
    much in the first pitch. Left is what the arc's length turns by itself, x / r: of second order in p / r.
    """
    stiffness, first, tip = held_floats(place)
    load = np.zeros(len(stiffness))
    load[first] = 1.0
    moved = np.linalg.solve(stiffness, load)
    assert abs(moved[tip] / moved[first]) == pytest.approx(arc_of_rotation(WIDE, place), rel=SECOND_ORDER)


@pytest.mark.parametrize("place", [0.25, 0.5, 0.75])
def test_tension_turns_the_first_float(place):
    """The other way round: T / r presses evenly, so T (p^2 - a^2) / 12 r turns against 4 EI / a and 2 sqrt(3) EI / p.

    The latter is what an endless row of pitches resists with; each pitch more leaves 0.07 of what is missing.
    """
    stiffness, first, tip = held_floats(place)
    load = np.zeros(len(stiffness))
    load[tip] = 1.0
    resistance = 4.0 * EI / (place * PITCH) + 2.0 * math.sqrt(3.0) * EI / PITCH
    turned = abs(np.linalg.solve(stiffness, load)[first])
    assert turned == pytest.approx(arc_of_rotation(WIDE, place) / resistance, rel=SECOND_ORDER)


def test_at_a_floats_place_nothing_is_converted():
    """The piece at the root mirrors the first pitch: what one takes in the other brings, at any frequency."""
    assert [arc_of_rotation(SCENE, 1.0, z) for z in (0.0, 1.0, MIDDLE)] == [0.0, 0.0, 0.0]
    assert conversion(SCENE, 1.0) == 0.0
    shares = [conversion(SCENE, place) for place in (0.9375, 0.75, 0.5)]
    assert 0.0 < shares[0] < min(shares[1:])


def of_mesh(elements, z):
    """S, D in EI / l and g of a clamped piece of lumped masses whose other end is turned, at beta l = z."""
    scene = Scene(tube={"helix_diameter": 1e4, "helix_length": 1000.0}, carrier_length=0.1)
    chain = build_chain(scene, elements, 2.0 * PITCH)._replace(
        cos_phi=1.0, sin_phi=0.0, inertia=0.0, damping_time=0.0, support_stiffness=np.zeros((2 * elements + 1, 3))
    )
    mass, stiffness = matrices(chain)
    square = (z / PITCH) ** 4 * EI / SCENE.probe.line_density
    dynamic = stiffness - square * mass
    inner = np.array([3 * k + j for k in range(1, elements) for j in (1, 2)])
    near, far = 2, 3 * elements + 2
    moved = np.linalg.solve(dynamic[np.ix_(inner, inner)], -dynamic[inner, near])
    height = chain.element_length * moved[::2].sum()
    turned = [row[near] + row[inner] @ moved for row in (dynamic[near], dynamic[far])]
    return np.array(turned) * PITCH / EI, abs(height) * 12.0 / PITCH**2


@pytest.mark.parametrize("z", [1.0, MIDDLE])
def test_the_pieces_stiffness_against_a_fine_mesh(z):
    """S, D and g in closed form: lumped masses and trapezoids are of second order in the element."""
    exact = np.array([near_stiffness(z), far_stiffness(z), lengthening(z)])
    errors = []
    for elements in (16, 32):
        (near, far), height = of_mesh(elements, z)
        errors.append(np.abs(np.array([near, abs(far), height]) - exact).max())
    assert errors[1] < errors[0] / 3.5  # 4 of second order, less what is of higher order
    assert errors[1] < 0.02


def test_small_vibrations_grow_faster_when_the_root_is_between_floats():
    """Linear, deterministic: waves of bending go to the root, axial ones come back, and both grow on their way.

    Once round takes T = L dq / d omega / p at least, in the middle of the band, so that a conversion c times as large
    adds ln c / T to the growth. Places between floats differ by no more than their conversions; the float's place,
    whose conversion is none in the closed form, lies further off than that.
    """
    scene = Scene(carrier_length=10.0)
    rates = {}
    for offset in range(NODES):
        system = sliding_system(scene, NODES, offset)
        rates[offset] = np.array([growth_rates(system, hertz)[0][0] for hertz in (130.0, 160.0)])
    shares = [conversion(SCENE, offset / NODES) for offset in (1, 2, 3)]
    z = MIDDLE + np.array([-1e-4, 1e-4])
    turns = np.arccos([-near_stiffness(v) / far_stiffness(v) for v in z])
    omega = (z / PITCH) ** 2 * math.sqrt(EI / SCENE.probe.line_density)
    once_round = scene.inserted_length / PITCH * abs(np.diff(turns)[0] / np.diff(omega)[0])
    bound = math.log(max(shares) / min(shares)) / once_round
    between = np.array([rates[offset] for offset in (1, 2, 3)])
    assert (np.ptp(between, axis=0) < bound).all()
    assert (between.min(axis=0) - rates[0] > bound).all()


@pytest.mark.slow
@pytest.mark.processor
def test_a_root_between_floats_rings_more(seeds):
    """At 30 m: as much more as the stored ensemble says but for chance, and more than chance alone could make.

    The floats' places before and after it are alike.
    """
    rms = {}
    for place in STORED:
        batch = SimulatorBatch(
            [Scene(carrier_length=30.0)] * LIVE, "superelement32", 2e-4, seeds=seeds(LIVE), growing=True,
            perturbation=1e-7,
        )  # fmt: skip
        for simulator in batch.simulators:
            simulator.root += round(place * NODES)
            simulator.hold_length()
        batch.advance(duration=2.0)
        rms[place] = batch.advance(duration=6.0).statistics["radial_rms_m"]
    stored, fresh = (
        [np.mean([table[p] for p in places]) for places in ((0.0, 1.0), (0.25, 0.5))] for table in (STORED, rms)
    )
    least = math.log(stored[1] / stored[0]) - reach(*[(DEVIATION, 2 * members) for members in (LIVE, LIVE, 16, 16)])
    assert least > 0.0
    assert math.log(fresh[1] / fresh[0]) > least
    assert abs(apart(rms[0.0], rms[1.0])) < reach((DEVIATION, LIVE), (DEVIATION, LIVE))
