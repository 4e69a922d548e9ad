"""Condensed pieces against the mesh that they come from, against beams in closed form, and by what must hold."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.chains import matrices, row_of_pieces, uniform_chain
from scipy.linalg import eigh, eigvals

from probe_env import Scene
from probe_env.physics.methods.superelement.pitch import condensed
from probe_env.physics.model.chain import build_chain

SCENE = Scene()
PITCH = SCENE.probe.float_pitch
CLAMPED = (4.730040745, 7.853204624, 10.99560784)
"""Roots of cos(x) cosh(x) = 1: bending of a bar with both ends held."""


def piece(elements, scene=SCENE, fraction=1.0):
    return build_chain(scene, round(elements / fraction), length=fraction * scene.probe.float_pitch)


def assembled(pitch, count):
    """Dense mass and stiffness of some pieces in a row."""
    return [row_of_pieces(pitch.modes, [matrix] * count) for matrix in (pitch.mass, pitch.stiffness)]


def hertz(mass, stiffness):
    """Natural frequencies, ascending; M is symmetric but for -J / r, which is left out here."""
    symmetric = 0.5 * (mass + mass.T)
    return np.sqrt(np.abs(eigh(stiffness, symmetric, eigvals_only=True))) / (2.0 * np.pi)


def of_mesh(nodes, pitches):
    """Frequencies of some pitches with so many nodes each, the tip as in a piece: half a node."""
    mass, stiffness = matrices(build_chain(SCENE, nodes, length=pitches * PITCH))
    mass[:3, :3] *= 0.5
    return hertz(mass, stiffness)


def test_with_all_modes_nothing_is_lost():
    """A change of coordinates: all frequencies of a chain of 4 nodes a pitch, to the rounding of the solver.

    An eigenvalue is lost below the largest one's rounding: eps * (2e5 Hz)^2 is (3e-3 Hz)^2.
    """
    chain = piece(4)._replace(frame_inertia=0.0)
    own, mesh = hertz(*assembled(condensed(chain, 9), 12)), of_mesh(4, 12)
    assert_allclose(own**2, mesh**2, rtol=1e-9, atol=100.0 * np.finfo(float).eps * mesh[-1] ** 2)


def test_the_frame_s_inertia_is_in_the_mass():
    """-J / r of (15), the one entry that is not symmetric: all eigenvalues of M^-1 K with it."""
    chain = piece(4)
    mass, stiffness = assembled(condensed(chain, 9), 6)
    fine_mass, fine_stiffness = matrices(build_chain(SCENE, 4, length=6 * PITCH))
    for i in range(len(fine_mass) // 3):
        fine_mass[3 * i + 2, 3 * i] = -chain.frame_inertia
    fine_mass[:3, :3] *= 0.5
    own, mesh = (np.sort(eigvals(k, m).real) for k, m in ((stiffness, mass), (fine_stiffness, fine_mass)))
    assert_allclose(own, mesh, rtol=1e-7, atol=1e3 * np.finfo(float).eps * mesh[-1])
    without = np.sort(eigvals(fine_stiffness, np.diag(np.diag(fine_mass))).real)
    assert np.abs(without / mesh - 1.0).max() > 1e-6  # it shows


@pytest.mark.parametrize(("modes", "reach"), [(2, 319.0), (3, 634.0), (4, 1223.0)])
def test_modes_below_the_last_are_within_one_percent(modes, reach):
    """The usual rule: frequencies up to that of the last mode that is kept are good; here up to the one before it."""
    chain, count = piece(16)._replace(frame_inertia=0.0), 10
    pitch = condensed(chain, modes)
    assert pitch.frequencies[modes - 2] == pytest.approx(reach, rel=2e-3)
    own, mesh = hertz(*assembled(pitch, count)), of_mesh(16, count)
    inside = np.flatnonzero((mesh[: len(own)] > 1.0) & (mesh[: len(own)] < reach))
    assert len(inside) > 8
    assert (own[inside] / mesh[inside]).max() < 1.01


def test_modes_of_a_straight_piece_are_a_clamped_bar_s():
    """Lumped masses on a bar that is exact between them: order 4, and low by (k h)^4 / 1440 to first order.

    The higher modes of the coarse mesh fall a little faster, as the next order shows.
    """
    probe = SCENE.probe
    exact = np.array(CLAMPED) ** 2 * np.sqrt(probe.flexural_rigidity / probe.line_density) / PITCH**2 / (2.0 * np.pi)
    error = {}
    for elements in (16, 32):
        h = PITCH / elements
        unit = build_chain(SCENE, elements, length=PITCH)
        no_turning = {"frame_inertia": 0.0, "inertia": 1e-6 * unit.mass * h * h}
        straight = unit._replace(sin_phi=0.0, cos_phi=1.0, **no_turning)
        error[elements] = condensed(straight, 0).frequencies[:3] / exact - 1.0
    assert_allclose(error[16], -((np.array(CLAMPED) / 16) ** 4) / 1440.0, rtol=0.3)
    assert_allclose(np.log2(error[16] / error[32])[1:], 4.0, atol=0.3)  # the first is near the solver's rounding


def test_free_motion_strains_nothing_and_a_pull_is_the_tension():
    """Sliding along the tube and the rigid turn of a straight piece cost no energy; the mean axial force is zero."""
    for chain in (piece(16), piece(12, fraction=0.75), piece(4, fraction=0.25)):
        pitch = condensed(chain, 3)
        free = np.array([1.0, 0.0, -2.0 * chain.sin_phi / chain.element_length])
        z = np.r_[free, free, np.zeros(3)]
        scale = np.abs(pitch.stiffness).max()
        assert np.abs(pitch.stiffness @ z).max() < 1e-9 * scale
        assert abs(pitch.tension @ z) < 1e-9 * np.abs(pitch.tension).max()
    straight = condensed(uniform_chain(8), 2)
    length = 8 * uniform_chain(8).element_length
    turn = np.r_[0.0, length, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0]  # about the root-side end
    assert np.abs(straight.stiffness @ turn).max() < 1e-9 * np.abs(straight.stiffness).max() * length
    # ends pulled apart: the force on each end is EA / p times the distance, and so are mean and last axial force
    for row in (straight.tension, straight.root_tension, straight.stiffness[0]):
        assert row[0] == pytest.approx(SCENE.probe.tensile_rigidity / length)


@pytest.mark.parametrize("modes", [-1, 46])
def test_as_many_modes_as_the_mesh_has(modes):
    with pytest.raises(ValueError, match=rf"modes = {modes} is outside the accepted range 0 to 45 of 16 elements"):
        condensed(piece(16), modes)
