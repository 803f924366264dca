"""The foreshortening of beams that bend, against the third derivative of their energy and the slopes' squares."""

from __future__ import annotations

import numpy as np
import pytest
from effect_scenes import CANTILEVER, line_meshes, scene_of
from scipy.linalg import eigh
from spatial_beams import SLIDER_CRANK, lines_of

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.matrices import assemble
from pgmp_petsc.bodies.third_derivative import ThirdDerivative
from pgmp_petsc.components.component_modes import weighted_sum_dense
from pgmp_petsc.components.foreshortening import foreshortening
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene import scene_from_toml

N_MODES = 3


def planar() -> Body:
    """Return a slender beam in the plane."""
    scene = scene_of(CANTILEVER)
    return Mechanism.from_scene(scene, line_meshes(scene)).bodies[0].alone()


def spatial() -> Body:
    """Return a slender beam in space."""
    scene = scene_from_toml(SLIDER_CRANK.replace('"r1"', "5.6e-3"), ".", ("parameters={}",))
    return Mechanism.from_scene(scene, lines_of(scene)).bodies[1].alone()


def solved(body: Body) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return eigenvalues and modes of the free body without its rigid motions, and its mass."""
    matrices = assemble([body], range(body.dofs.size))
    mass, stiffness = (
        weighted_sum_dense({weight: part.toarray() for weight, part in terms.items()}, {})
        for terms in (matrices.mass, matrices.stiffness)
    )
    values, vectors = eigh(stiffness, mass)
    n_rigid = body.node_dofs
    return values[n_rigid:], vectors[:, n_rigid:], mass


def second_order(body: Body) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return chi of the first modes, these, and the elastic eigenvalues and modes."""
    values, vectors, _ = solved(body)
    modes = vectors[:, :N_MODES]
    axial = body.section.axial.at({})
    return foreshortening(body, modes, np.diag(values[:N_MODES]), axial, (values, vectors)), modes, values, vectors


def test_in_the_plane_it_is_the_static_modal_derivative() -> None:
    """``K chi = -K3[psi, psi]``, but for what shear forces of the modes do when they turn: 2e-3 of it here."""
    body = planar()
    chi, modes, values, vectors = second_order(body)
    rows, columns = np.tril_indices(N_MODES)
    forces = ThirdDerivative([body], range(body.dofs.size)).weighted(modes, (rows, columns), {})
    expected = -vectors @ ((vectors.T @ forces) / values[:, None])
    np.testing.assert_allclose(chi[:, rows, columns], expected, rtol=0, atol=4e-3 * np.abs(expected).max())


@pytest.mark.parametrize("make", [planar, spatial])
def test_a_straight_beam_is_as_long_as_before(make) -> None:
    """Its ends come closer by the integral of the squares of its slopes, but for its shear."""
    body = make()
    chi, modes, _, _ = second_order(body)
    by_node, d = modes.reshape(body.n_nodes, body.node_dofs, -1), body.mesh.nodes.shape[1]
    slopes = np.diff(by_node[:, 1:d], axis=0) / body.mesh.lengths[:, None, None]
    squares = np.einsum("eci,ecj,e->ij", slopes, slopes, body.mesh.lengths)
    ends = chi.reshape(body.n_nodes, body.node_dofs, N_MODES, N_MODES)[[0, -1], 0]
    closer = ends[1] - ends[0]
    # psi w + w psi - psi psi with psi the rotation is w w less the square of the shear
    np.testing.assert_allclose(closer, -squares, rtol=0, atol=0.02 * np.abs(squares).max())


@pytest.mark.parametrize("make", [planar, spatial])
def test_it_moves_no_centre_of_mass_and_has_no_spin(make) -> None:
    body = make()
    chi, _, _, _ = second_order(body)
    _, _, mass = solved(body)
    nodal = np.zeros((body.n_nodes, body.node_dofs, body.mesh.nodes.shape[1]))
    nodal[:, range(nodal.shape[2]), range(nodal.shape[2])] = 1.0
    momentum = np.einsum("nk,nm,mij->kij", nodal.reshape(body.dofs.size, -1), mass, chi)
    total = mass[0 :: body.node_dofs, 0 :: body.node_dofs].sum()
    assert np.abs(momentum).max() < 1e-10 * total * np.abs(chi).max()


def test_modes_along_a_beam_have_none() -> None:
    body = planar()
    values, vectors, _ = solved(body)
    along = np.abs(vectors[1::3]).max(axis=0) < 1e-8 * np.abs(vectors[0::3]).max(axis=0)
    chosen = np.flatnonzero(along)[:2]
    stiffness = np.diag(values[chosen])
    chi = foreshortening(body, vectors[:, chosen], stiffness, body.section.axial.at({}), (values, vectors))
    bending = second_order(body)[0]
    assert np.abs(chi).max() < 1e-8 * np.abs(bending).max()
