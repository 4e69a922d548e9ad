"""Published results of other authors against the simulator; docs/notes/published.md has the table.

Each target is written from the source before the simulation. Bounds follow from the discretisation or from what the
published formula neglects, as each comment derives.
"""

import math

import numpy as np
import pytest
from oracles.scatter import reach

from probe_env import Scene, Simulator, SimulatorBatch
from probe_env.physics.closed_forms.bare_chains import DrivenChain, run_chain, uniform_chain
from probe_env.physics.methods import METHODS
from probe_env.physics.methods.method import KernelArguments
from probe_env.physics.model.chain import entrance_force, max_pressure
from probe_env.physics.model.drive import Drive
from probe_env.physics.model.state import at_rest

pytestmark = pytest.mark.slow

EA, EI, DENSITY, DIAMETER = 1.1e5, 4.8e-2, 0.111, 8.35e-3  # the cable of table 2


def cable(elements, length, rigidity=EA, **changes):
    """Straight cable of table 2 of a length [m]; uniform_chain has elements of 25 mm."""
    h = length / elements
    mesh = {
        "element_length": h, "axial_compliance": h / rigidity, "shear_compliance": h**3 / (3.0 * EI),
        "bending_compliance": h / EI, "coupling_compliance": h**2 / (2.0 * EI), "mass": DENSITY * h,
        "inertia": DENSITY * h * (h**2 / 12.0 + DIAMETER**2 / 16.0), "damping_time": 0.0,
    }  # fmt: skip
    return uniform_chain(elements, **(mesh | changes))


def nodal(elements, tip, y=0.0):
    """(n + 1, 3) array with y at all free nodes, and (x, y, t) more at the tip."""
    array = np.zeros((elements + 1, 3))
    array[:-1, 1] = y
    array[0] += tip
    return array


def test_capstan_of_the_soft_string():
    """Johancsik, Friesen and Dawson, SPE 11380 (1984), without weight: T2 / T1 = exp(mu theta).

    A guide with floats pulls a carrier without drag. Friction acts at the surface of the cable, d_c / 2 from its axis,
    so the exponent is (1 - d_c / d_h) mu theta, and mu theta for a thin string. Floats make the curve a polygon of
    turns phi: 2 atanh(mu tan(phi / 2)) for mu phi is (1 + mu^2) phi^2 / 12 more; the published formula neglects the
    centrifugal force, m u^2 of the tension. Bending, over sqrt(EI / T), changes the tension near the sensor and the
    root: four pitches at either end do not count.
    """
    target, mu, helix, pitch, feed = 1.0, 0.25, 1.2, 0.1, 0.05
    diameters, spans, end, exponents = (8.35e-3, 4e-3, 2e-3), 24, 4, []
    for diameter in diameters:
        probe = {"cable_diameter": diameter, "carrier_float_diameter": diameter * 1.0001, "guide_length": 1.0}
        scene = Scene(
            tube={"helix_diameter": helix}, probe=probe | {"float_pitch": pitch}, contact={"friction": mu},
            feed_speed=feed, carrier_length=spans * pitch,
        )  # fmt: skip
        simulator = Simulator(scene, "newmark", 1e-4)
        simulator.advance(duration=2.0)
        tension = simulator.advance(duration=1.0).mean_tension
        theta = (spans - 2 * end - 1) * 2.0 * pitch / helix  # of the floats between the two elements
        exponents.append(math.log(tension[4 * (spans - end) - 1] / tension[4 * end]) / (mu * theta))
    bound = (1.0 + mu**2) * (2.0 * pitch / helix) ** 2 / 12.0 + DENSITY * feed**2 / tension[0]
    thin = float(np.polyfit(diameters, exponents, 1)[1])
    assert exponents == pytest.approx([1.0 - d / helix for d in diameters], abs=bound)
    assert thin == pytest.approx(target, abs=bound)


@pytest.mark.parametrize(("method", "rigidity"), [("newmark", EA), ("implicit", EA / 10.0)])
def test_stop_of_a_wave_in_a_rod_with_coulomb_friction(method, rigidity):
    """Motion of an Elastic Rod With External Coulomb Friction, J. Eng. Ind. 90 (1968) 526; Nikitin and Tyurekhodgaev,
    Wave Motion 12 (1990) 513: a force P is applied suddenly to the end of a rod with the friction q per length.

    By characteristics the wave stops at X = 2 P / q, whatever the material, and leaves the displacement
    q (X - x)^2 / (4 EA). The jump at the front converges with an order below one, so the end displacement is
    extrapolated from its differences (Aitken); its error is less than the last difference.
    """
    force, q, mu, stiffness = 5.0, 2.0, 0.2, 1e5
    reach_m = 2.0 * force / q
    end = q * reach_m**2 / (4.0 * rigidity)
    speed, length = math.sqrt(rigidity / DENSITY), 1.6 * reach_m
    ends, distances, beyond = [], [], []
    for elements in (100, 200, 400):
        h = length / elements
        load = nodal(elements, (-force, 0.0, 0.0), -q * h / mu)
        contact = np.full(elements + 1, stiffness)
        chain = cable(elements, length, rigidity, friction=mu, contact_stiffness=contact, load=load)
        state = at_rest(elements + 1, METHODS[method].memory)
        state.d[:-1, 1] = load[:-1, 1] / stiffness
        time_step = 0.25 * h / speed
        steps = round(1.3 * reach_m / speed / time_step)
        assert run_chain(method, DrivenChain(chain), time_step, state, steps, steps).stable
        s, moved = h * np.arange(elements + 1), -state.d[:, 0]
        inside = s < 0.8 * reach_m
        slope, intercept = np.polyfit(s[inside], np.sqrt(np.maximum(moved[inside], 0.0)), 1)
        ends.append(moved[0] / end)
        distances.append(-intercept / slope / reach_m)
        beyond.append(np.abs(moved[s > 1.2 * reach_m]).max() / end)
    first, last = np.diff(ends)
    extrapolated = ends[-1] + last**2 / (first - last)
    assert abs(ends[-1] - 1.0) < abs(ends[-2] - 1.0) < abs(ends[-3] - 1.0)
    assert extrapolated == pytest.approx(1.0, abs=last)
    assert distances[-1] == pytest.approx(1.0, abs=1.0 - ends[-1])  # displacement goes with the square of X
    assert max(beyond) < 1e-3  # nodes at rest change the sign of their friction every step, but do not creep


def test_mean_friction_under_axial_vibration():
    """Shock and Vibration (2018) 4179312: a sliding u with a vibration v > u has (2 / pi) asin(u / v) of the friction.

    u / v = 1/2 leaves one third. A probe in the helix is fed with u + v sin(w t). Its friction is the root tension
    without friction minus that with it; mu L / r is small only for a short probe, hence the extrapolation to L = 0.
    The formula neglects that the drag falls with the speed, 2 (2 / pi) v cos(asin(u / v)) / 43 m/s, and the centrifugal
    force, at most 2 m (u^2 + v^2 / 2) / (q L).
    """
    target, feed, swing, frequency, lengths, segments = 1.0 / 3.0, 0.05, 0.1, 1.0, (2.0, 1.0, 0.5), 100
    fraction = []
    for length in lengths:
        means = []
        for friction, amplitude in ((0.0, 0.0), (0.15, 0.0), (0.15, swing)):
            scene = Scene(
                probe={"guide_length": length - 0.1}, contact={"friction": friction}, couple="tangent",
                carrier_length=0.1, feed_speed=feed,
            )  # fmt: skip
            simulator = Simulator(scene, "newmark", 2e-4, ramp=2.0 * math.pi * frequency * swing)
            tension = []
            for k in range(2 * segments):
                speed = feed + amplitude * math.sin(2.0 * math.pi * (k + 1) / segments)
                run = simulator.advance(speed, None, 1.0 / frequency / segments, points=("root",))
                tension.append(run.tension[1:, 0].mean())
            means.append(np.mean(tension[segments:]))
        free, sliding, vibrating = means
        fraction.append((free - vibrating) / (free - sliding))
    short = (8.0 * fraction[2] - 6.0 * fraction[1] + fraction[0]) / 3.0  # quadratic in L, halved twice
    bound = 4.0 / math.pi * swing * math.cos(math.asin(feed / swing)) / 43.0
    bound += 2.0 * DENSITY * (feed**2 + swing**2 / 2.0) / free
    assert short == pytest.approx(target, abs=bound)


HALF_SPAN, WALL_GAP, WALL = 0.05, 1e-3, 1e8  # [m], [m], [N/m]


def pressed_strut(elements, ratio, **changes):
    """Contact forces and tip moment of half of a clamped strut under ratio pi^2 EI / L^2; its tip is the middle."""
    h = HALF_SPAN / elements
    load = ratio * math.pi**2 * EI / (2.0 * HALF_SPAN) ** 2
    clamp = 1e6  # [N m/rad]
    chain = cable(
        elements, HALF_SPAN, couple_length=h, damping_time=1e-3, cable_stiffness=WALL, cable_radius=DIAMETER / 2.0,
        lever=np.full(elements + 1, DIAMETER / 2.0), outer_gap=np.full(elements + 1, WALL_GAP),
        load=nodal(elements, (-load, 1e-4, 0.0)), support_stiffness=nodal(elements, (0.0, 0.0, clamp)),
    )._replace(**changes)  # fmt: skip
    state = at_rest(elements + 1)
    run_chain("newmark", DrivenChain(chain), 1.5e-6, state, 20_000, 20_000)
    return load, WALL * np.maximum(state.d[:-1, 1] - WALL_GAP, 0.0), clamp * abs(state.d[0, 2])


def test_strut_between_walls():
    """Domokos, Holmes and Royce, J. Nonlinear Sci. 7 (1997) 281; Judah and Givli, J. Appl. Mech. 91 (2024) 061004.

    A clamped strut buckles at 4 pi^2 EI / L^2. Its middle then presses on the wall at the gap g with
    N = 2 P k g / (k l - 2 tan(k l / 2)), k^2 = P / EI, l = L / 2, until its curvature there vanishes, k l = 2 pi, at
    16 pi^2 EI / L^2, whatever the stiffness of the wall: from there on it lies along the wall. The small-slope solution
    is derived here from EI w'''' + P w'' = 0. The chain is of second order in h.
    """
    line_contact = 16.0
    errors, loads = [], []
    for elements in (10, 20, 40):
        load, contact, _ = pressed_strut(elements, 12.0)
        kl = math.sqrt(load / EI) * HALF_SPAN
        target = load * kl / HALF_SPAN * WALL_GAP / (kl - 2.0 * math.tan(kl / 2.0))
        errors.append(contact.sum() / target - 1.0)
        ratios = np.array([14.0, 15.0, 15.5])
        moments = [moment / contact.sum() for _, contact, moment in (pressed_strut(elements, r) for r in ratios)]
        roots = np.roots(np.polyfit(ratios - line_contact, moments, 2)).real
        loads.append(line_contact + roots[np.abs(roots).argmin()])
    order = math.log2((errors[0] - errors[1]) / (errors[1] - errors[2]))
    finest = (4.0 * loads[2] - loads[1]) / 3.0
    assert order == pytest.approx(2.0, abs=0.1)
    assert (4.0 * errors[2] - errors[1]) / 3.0 == pytest.approx(0.0, abs=errors[2] / 4.0)
    assert finest == pytest.approx(line_contact, rel=errors[2])
    assert pressed_strut(20, 3.9)[1].sum() < 0.01 * contact.sum()  # not buckled: only its small side load
    # contact.cable limits the couple at the load of a hinged pitch: it keeps the cable in, without this force
    limited = pressed_strut(20, 12.0, max_pressure=max_pressure(EI, HALF_SPAN / 20, 2.0 * HALF_SPAN))
    assert limited[1].sum() < 0.01 * target
    # not if the bent span shortens, as with terms.shortening
    whole = pressed_strut(20, 12.0, span=20, max_pressure=max_pressure(EI, HALF_SPAN / 20, None))
    unlimited = pressed_strut(20, 12.0)
    assert whole[1].sum() == pytest.approx(unlimited[1].sum(), rel=1e-6)


def test_buckled_strut_carries_the_load_of_euler():
    """Elastica of small slope, the first branch of Domokos, Holmes and Royce before the wall: a clamped strut of length
    L that is shortened by X carries P = 4 pi^2 EI / L^2 and has the amplitude a of X = P L / EA + pi^2 a^2 / (4 L).

    The elastica's load is (pi a / L)^2 / 2 larger, 3e-6 here, which the model neglects. Order 2 in h.
    """
    target, shortening, stiffness = 4.0 * math.pi**2 * EI / (2.0 * HALF_SPAN) ** 2, 4e-4, 1e8
    errors, amplitudes = [], []
    for elements in (10, 20, 40):
        chain = cable(
            elements, HALF_SPAN, couple_length=HALF_SPAN / elements, span=elements, damping_time=1e-3,
            load=nodal(elements, (-shortening * stiffness, 1e-4, 0.0)),
            support_stiffness=nodal(elements, (stiffness, 0.0, 1e6)),
        )  # fmt: skip
        state = at_rest(elements + 1)
        run_chain("newmark", DrivenChain(chain), 2e-6, state, 60_000, 60_000)
        errors.append(-state.tension[0] / target - 1.0)
        bending = -state.d[0, 0] - target * HALF_SPAN / EA  # of half the strut
        amplitudes.append(state.d[0, 1] / (4.0 / math.pi * math.sqrt(HALF_SPAN * bending)) - 1.0)
    for differences in (errors, amplitudes):
        order = math.log2((differences[0] - differences[1]) / (differences[1] - differences[2]))
        assert order == pytest.approx(2.0, abs=0.1)
        assert (4.0 * differences[2] - differences[1]) / 3.0 == pytest.approx(0.0, abs=abs(differences[2]) / 4.0)


def test_configurational_force_of_a_growing_cable():
    """Bigoni, Dal Corso, Bosi and Misseroni, Mech. Mater. 80 (2015) 368: a sleeve feels the axial force M^2 / (2 EI).

    A cantilever with a load F at its tip grows from L1 to L2. Its energy decreases by the integral of M^2 / (2 EI),
    M = F L. The simulated energy, -F w / 2 at rest, does so as well. The chain itself feels no axial force, because the
    sleeve is held; ``entrance_force`` is that force, at either length. In between the energy goes into vibration.
    """
    force, start, per_pitch, time_step = 1e-3, 0.4, 32, 1e-3
    h = 0.1 / per_pitch
    first, last = round(start / h), round(0.5 / h)
    chain = cable(last, last * h, couple_length=h, damping_time=0.1, load=nodal(last, (0.0, force, 0.0)))
    method = METHODS["newmark"]
    state, root, deflections, axial, sleeve = at_rest(last + 1), first, [], [], []
    for feed, duration in ((0.0, 4.0), (0.05, 2.2), (0.0, 4.0)):
        steps = round(duration / time_step)
        inputs = Drive(feed, 0.0, growth=1.0).inputs_of_steps(steps, time_step, h, last - root)
        samples = np.zeros((steps, 2, 4))
        constants = method.constants(chain, 0, per_pitch, time_step)
        lane = KernelArguments(constants, state, root, inputs, np.array([-1, -2]), samples, np.zeros(0))
        method.run([lane], time_step, per_pitch, 1, 1)
        root = lane.root
        deflections.append(state.d[0, 1])
        axial.append(np.abs(samples[:, 0, 3]).max())
        sleeve.append(entrance_force(chain, samples[-1, 1, :3], samples[-1, 0, :3]))
    assert root == last
    grown = (last - first) * h
    target = force**2 * ((last * h) ** 3 - start**3) / (6.0 * EI) / grown
    released = 0.5 * force * (deflections[2] - deflections[0]) / grown
    assert released == pytest.approx(target, rel=1e-6)  # the slowest mode has decayed by exp(-17)
    assert max(axial) < 1e-6 * target
    ends = [(force * length) ** 2 / (2.0 * EI) for length in (start, last * h)]
    assert [sleeve[0], sleeve[2]] == pytest.approx(ends, rel=1e-6)


def test_force_of_a_sudden_stop():
    """The classical impact of a bar, F = u sqrt(EA m); Griffioen, IWCS 2019, treats the sudden stop of a blown cable.

    In a straight tube without friction and air; the force lasts 2 L / c, then it is reversed. The front is one element
    wide: h / L of the momentum.
    """
    feed, length = 0.2, 20.0
    target = feed * math.sqrt(EA * DENSITY)
    scene = Scene(
        tube={"helix_diameter": 1e4}, probe={"guide_length": 0.0}, contact={"friction": 0.0}, feed_speed=feed,
        air_supply_rate=0.0, carrier_length=length,
    )  # fmt: skip
    simulator = Simulator(scene, "newmark", 2.5e-5)
    run = simulator.advance(0.0, duration=0.08, sample_period=1e-4, points=("root",))
    fraction = run.time / (2.0 * length / math.sqrt(EA / DENSITY))
    force = run.tension[:, 0]
    plateau, after = (force[(fraction > start) & (fraction < start + 0.8)].mean() for start in (0.1, 1.1))
    assert plateau == pytest.approx(target, rel=0.025 / length)
    assert after == pytest.approx(-target, rel=0.05)  # the front is wider after a round trip


def test_reels_shake_and_straight_ducts_do_not():
    """Griffioen and Jonker, IWCS 2021: cables blown into a duct with bends only resonate, those on a reel extremely.

    A trend only: the same cable and air in a straight duct and on reels, by diameter and length. The bound is the
    scatter of the logarithm of a ratio of two rms.
    """
    diameters, lengths = (1.2, 1.8, 2.4, 1e4), (20.0, 30.0, 40.0)
    rms = []
    for length in lengths:
        scenes = [Scene(tube={"helix_diameter": d}, carrier_length=length) for d in diameters]
        batch = SimulatorBatch(scenes, method="superelement32", time_step=2e-4)
        batch.advance(duration=2.0)
        rms.append(batch.advance(duration=3.0).statistics["radial_rms_m"])
    table = np.log(np.array(rms) * 1e3)
    scatter = reach((0.13, 1), (0.13, 1))
    assert (table[1:, 0] - table[1:, 2] > scatter).all()  # a wider reel shakes less
    assert table[2, 0] - table[0, 0] > scatter  # a longer cable shakes more
    assert (table[:, 3] < table[:, 0] - 10.0 * scatter).all()  # a straight duct does not shake
