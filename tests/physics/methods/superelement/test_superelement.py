"""The kernel of condensed pieces against the mesh that they come from, dense matrices, and itself."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.chains import row_of_pieces

from probe_env import Scene, Simulator, SimulatorBatch
from probe_env.envs.trials import HARDEST
from probe_env.physics.closed_forms.bare_chains import DrivenChain, bent_chain, run_chain
from probe_env.physics.methods import METHODS
from probe_env.physics.methods.factors import linear_weights
from probe_env.physics.methods.superelement import contact, tables
from probe_env.physics.methods.superelement.pitch import ENDS, refined
from probe_env.physics.model.chain import build_chain, linear_part
from probe_env.physics.model.state import SHORTENING

STEP = 2e-4


@pytest.mark.parametrize("per_pitch", [1, 2, 3, 4])
def test_the_sweeps_solve_the_chain(per_pitch):
    """(M + theta dt tau K) v = r of six whole pitches and a part of one: factors and modes against a dense solution."""
    chain = build_chain(Scene(), 4)._replace(frame_inertia=0.0)
    theta, tau = linear_weights(chain.damping_time, STEP)
    weight = theta * STEP * tau
    own = tables.tables(chain, 4, STEP)
    whole = [tables._piece(linear_part(chain), 4, tables.ELEMENTS, n) for n in (4, per_pitch)]
    cut = [tables._chosen(piece, own.even, own.odd, weight) for piece in whole]
    pieces = [cut[0]] * 6 + [cut[1]]
    fine = refined(chain, 4, tables.ELEMENTS, 4)
    A = row_of_pieces(pieces[0].modes, [p.mass + weight * p.stiffness for p in pieces])
    A[:3, :3] += 0.5 * np.diag([fine.mass, fine.mass, fine.inertia])
    r = np.random.default_rng(1).normal(size=len(A))
    exact = np.linalg.solve(A, r).reshape(7, -1)
    rows = r.reshape(7, -1)
    left = [p.mass[:ENDS, ENDS:] @ row[3:] for p, row in zip(pieces, rows, strict=True)]  # modes of A are one
    u, before, carried = [], np.zeros(3), np.zeros(3)
    for i in range(7):
        table = own.root_factors[per_pitch - 1] if i == 6 else own.factors
        E, F, _ = table[min(i, len(own.factors) - 1)].reshape(3, 3, 3)
        before = E @ (rows[i, :3] - left[i][:3] - carried) - F @ before
        carried = left[i][3:]
        u.append(before)
    v = np.zeros(3)
    for i in reversed(range(7)):
        v = u[i] - own.factors[min(i, len(own.factors) - 1)].reshape(3, 3, 3)[2] @ v
        # rounding of a system whose angles and lengths differ by some hundred
        assert_allclose(v, exact[i, :3], rtol=1e-9, atol=1e-9 * np.abs(exact).max())


@pytest.mark.parametrize("shortened", [False, True])
def test_with_all_modes_it_is_the_mesh(monkeypatch, shortened):
    """A free, bent chain let go from a shape: pitches of two elements with all their modes are imex with two nodes.

    Also where its bending shortens it: imex differs by its linearly implicit couple, 1.5e-4 of it at 40 N.
    """
    pitches, steps = 6, 200
    STEP = 1e-5 if shortened else 2e-4
    mesh = bent_chain(2 * pitches)
    if shortened:
        mesh = mesh._replace(couple_length=mesh.element_length, couple_turn=1.0 / 0.6, span=2)
    coarse = refined(mesh, 2, 1, 2 * pitches)
    monkeypatch.setattr(tables, "contact_frequency", lambda *_: 1e9)
    monkeypatch.setattr(tables, "ELEMENTS", 2)
    tables._tables.cache_clear()
    chains = {"imex": (mesh, 2), "superelement": (coarse, 1)}
    d = np.zeros((2 * pitches + 1, 3))
    own = tables.tables(coarse, 1, STEP)
    assert (own.even, own.odd) == (1, 2)
    place = np.arange(pitches + 1) / pitches
    ends = np.stack(
        [0.0 * place, (5e-3 if shortened else 1e-3) * np.cos(0.5 * np.pi * place) ** 4, 0.0 * place], axis=1
    )
    ends[-1] = 0.0
    shape = tables._chosen(tables._piece(linear_part(coarse), 1, 2, 1), 1, 2, 0.0).shape[3:6, :ENDS]
    d[::2] = ends
    d[1::2] = np.hstack([ends[:-1], ends[1:]]) @ shape.T  # no mode is in it
    ended = {}
    for name, (chain, per_pitch) in chains.items():
        start = METHODS[name].at_rest(chain, per_pitch, STEP, chain.node_count - 1, d[:: 3 - per_pitch])
        run_chain(name, DrivenChain(chain, nodes_per_pitch=per_pitch), STEP, start, steps, steps)
        ended[name] = start.d[::per_pitch]
    scale = np.abs(ended["imex"]).max(axis=0)
    assert (scale > 1e-5).all()
    tolerance = 1e-3 if shortened else 1e-8  # rounding of 200 steps
    assert_allclose(ended["superelement"] / scale, ended["imex"] / scale, atol=tolerance)
    assert (start.memory[:, SHORTENING].max() > 10.0) == shortened
    tables._tables.cache_clear()


def test_the_compliance_in_steps_is_that_of_the_steps():
    """A ring of pieces with turned ends, marched under a turning force until it follows it.

    Springs to the ground at its floats, 1e5 N/m, keep slow motions, which hardly decay, out of the answer.
    """
    chain = build_chain(Scene(), 4)._replace(frame_inertia=0.0)
    theta, tau = linear_weights(chain.damping_time, STEP)
    piece = tables._chosen(tables._piece(linear_part(chain), 4, tables.ELEMENTS, 4), 2, 1, 0.0)
    count, width = contact.PHASES, 6
    whole = np.zeros((2, count * width, count * width))
    for k in range(count):
        behind = (k + 1) % count * width
        own = np.r_[k * width : k * width + 3, behind : behind + 3, k * width + 3 : k * width + 6]
        sign = np.ones(9)
        sign[3:6] = -1.0 if behind == 0 else 1.0  # phases lie half-way between those of a plain ring
        for target, matrix in zip(whole, (piece.mass, piece.stiffness), strict=True):
            target[np.ix_(own, own)] += sign[:, None] * matrix * sign
    M, K = whole
    K += np.diag(np.where(np.arange(len(M)) % width < 2, 1e5, 0.0))
    A = np.linalg.inv(M + theta * STEP * tau * K)
    omega, force = 2.0 * np.pi * 679.0, np.zeros(len(M))
    force[1] = 1.0
    d, p = np.zeros((2, len(M)), dtype=complex)
    for n in range(2000):
        p = p + STEP * force * np.exp(1j * omega * n * STEP)
        v = A @ (p - theta * STEP * (K @ d))
        p, d = p - STEP * (K @ (d + tau * v)), d + STEP * v
    answer = d[1] * np.exp(-1j * omega * 2000 * STEP)
    endless = contact.PeriodicRow(piece)
    endless.stiffness[:, [0, 1], [0, 1]] += 1e5
    own = endless.stepped_compliance(omega, chain.damping_time, STEP)
    assert abs(answer / own - 1.0) < 1e-6  # the start is gone: the slowest motion decays by 230 a second


def test_contact_is_fitted_where_the_step_shows():
    """On table 2: seven hundredths less at 2e-4 s, and less of it as the step shrinks, down to what the modes lack."""
    chain = build_chain(Scene(), 4)
    fraction = [tables.tables(chain, 4, step).stiffness / 1e5 for step in (2e-4, 1e-4, 5e-5, 2e-5)]
    assert_allclose(fraction, [0.927, 0.977, 0.988, 0.991], atol=2e-3)
    pieces = (tables._piece(linear_part(chain), 4, 16, 4).select_modes(range(m)) for m in (14, 12))
    more = contact.fitted_stiffness(*pieces, 1e5, 5e-5, 1e-6)
    assert more == pytest.approx(1e5, rel=2e-3)


def test_modes_are_chosen_by_the_contact():
    """Three on table 2; stiffer contact asks for more, and a probe of a longer pitch too."""
    chains = [build_chain(Scene(contact={"stiffness": k}), 4) for k in (1e4, 1e5, 4e5)]
    soft, usual, stiff = ((own.even, own.odd) for own in (tables.tables(chain, 4, 1e-4) for chain in chains))
    assert soft == usual == (2, 1)
    assert stiff[0] > 2
    assert stiff[1] > 1


@pytest.mark.parametrize(
    ("nodes", "change", "message"),
    [
        (3, {}, "nodes_per_pitch = 3 does not divide 16"),
        (8, {}, "nodes_per_pitch = 8: .*give fewer nodes a pitch"),
        (4, {"contact": {"stiffness": 1.1e6}}, "nodes_per_pitch = 4: .* fewer than the 5 even and 5 odd modes"),
        (4, {"contact": {"stiffness": 1e7}}, "contact.stiffness asks for modes up to .* room for 5 and 5"),
        (4, {"contact": {"cable": True}}, r"contact\.cable = true: superelement has no nodes between floats; imex"),
    ],
)
def test_unsupported_scenes_are_refused(nodes, change, message):
    with pytest.raises(ValueError, match=message):
        Simulator(Scene.model_validate(change), "superelement", 5e-5, nodes)


@pytest.mark.slow  # compiles the kernel with room for more modes
def test_lengths_modes_and_calls_change_no_bit():
    """Probes of all fractions of a pitch at the root, growing over it, two with more modes: in a batch as alone."""
    scenes = [Scene(carrier_length=length, probe={"guide_length": 0.5}) for length in (0.5, 1.3, 0.8, 2.0, 0.4)]
    scenes += [scene.model_copy(update={"contact": {"stiffness": 2.5e5}}) for scene in scenes[:2]]
    method = "superelement"
    options = {"growing": True, "time_lapse": 30.0, "perturbation": 1e-6}
    batch = SimulatorBatch(scenes, method, 1e-4, threads=1, **options)
    assert len({METHODS[method].kind(s.constants) for s in batch.simulators}) == 2
    for speed in (0.2, 0.13):
        batch.advance(speed, None, 0.05)
    for k, own in enumerate(batch.simulators):
        alone = Simulator(scenes[k], method, 1e-4, seed=k, **options)
        for speed, duration in ((0.2, 0.03), (0.2, 0.02), (0.13, 0.05)):
            alone.advance(speed, None, duration)
        assert alone.root == own.root > alone._start_root + 10
        assert all(map(np.array_equal, alone.state, own.state))


def test_the_hardest_designs_hold_at_the_environments_step():
    """Lightest and softest probes on the stiffest contact of the contexts: 2e-4 s is known to hold, and it does."""
    scenes, contact = [], {"stiffness": 1.4e5, "friction": 0.25}
    for design in HARDEST:
        probe = design.built.probe()
        length = round(round(5.0 / probe.float_pitch) * probe.float_pitch, 9)
        scenes.append(Scene(carrier_length=length, probe=probe, contact=contact))
        assert METHODS["superelement32"].stable_step(scenes[-1], 4) >= STEP
    batch = SimulatorBatch(scenes, "superelement32", STEP, perturbation=1e-7)
    assert not batch.advance(None, None, 1.0).diverged.any()


def test_a_growing_probe_follows_the_mesh():
    """Without friction a probe of 1 m that grows by half hangs in the air stream: tip and tension as with 16 nodes.

    The mesh's own error at 4 nodes is shown with it.
    """
    scene = Scene(contact={"friction": 0.0}, probe={"guide_length": 0.5}, carrier_length=0.5)
    ended = {}
    for name, method, nodes in (("mesh", "imex", 16), ("own", "superelement", 4)):
        simulator = Simulator(scene, method, 1e-4, nodes, growing=True, time_lapse=10.0)
        run = simulator.advance(0.2, None, 0.3, points=("tip", "root"))
        half = len(run.time) // 2
        ended[name] = np.array([run.axial[half:, 0].mean(), run.tension[half:, 1].mean()])
        assert simulator.inserted_length == pytest.approx(1.6)
        assert simulator.feed_speed == 0.2  # the true speed
    assert_allclose(ended["own"], ended["mesh"], rtol=0.02)


def test_single_precision_keeps_a_long_free_probe():
    """Along the tube nothing but the root holds it: no rounding may be a spring to the frame (see imex32's factors).

    60 m without friction, pulled for a tenth of a second; 1e-4 of the displacement is 250 roundings of it.
    """
    scene = Scene(contact={"friction": 0.0}, carrier_length=57.5)
    runs = (Simulator(scene, method, STEP).run(0.1, points=("tip",)) for method in ("superelement", "superelement32"))
    double, single = (run.axial for run in runs)
    assert_allclose(single, double, atol=1e-4 * np.abs(double).max())
