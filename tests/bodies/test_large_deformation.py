"""What is of second order in the deformation of continuum bodies: against a Green-Lagrange energy written here."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from green_lagrange import energy_of
from mpi4py import MPI
from runs import ONE_RANK
from scipy.linalg import eigh
from solid_scenes import solid_meshes, solid_slider_crank
from solids import body_of, fields_on, matrices_of, mesh_of, rod, third_of

from pgmp_petsc.bodies.affine import Monomial, Quantity, evaluate_weights
from pgmp_petsc.bodies.component import Component, linear_fields
from pgmp_petsc.bodies.profile import SectionScale
from pgmp_petsc.bodies.solid import Solid
from pgmp_petsc.components.component_modes import condense
from pgmp_petsc.components.condensing import condensed
from pgmp_petsc.components.large_deformation import FieldsOnRanks, LongAxis, contraction_of, with_second_order
from pgmp_petsc.reduction.checkpoint import BuildCheckpoint

KINDS = ("triangle6", "quad8", "tetra10", "hexahedron20")
COUNTS, LENGTHS, NU = (3, 2, 2), (0.6, 0.06, 0.04), 0.3


def of_second_order(solid: Solid, frames: dict, points: list, n_modes: int) -> tuple[Component, np.ndarray]:
    """Return a condensed body with what is of second order in it, and its displacement fields."""
    component, recovery = condense(solid, frames, points, n_modes, MPI.COMM_SELF, large=True)
    return with_second_order(component, solid, recovery, MPI.COMM_SELF, points[0]), recovery


@lru_cache
def of_rod(kind: str, two_materials: bool = False) -> tuple[Component, np.ndarray]:
    solid, frames, points = rod(kind, two_materials)
    return of_second_order(solid, frames, points, 3)


def third_along(energy: Callable[[np.ndarray], float], u: np.ndarray) -> float:
    """Return the third derivative at rest along u, exact: the energy is a polynomial of fourth degree."""
    one, two = (energy(h * u) - energy(-h * u) for h in (1.0, 2.0))
    return 0.5 * (two - 2.0 * one)  # of c_1 h + c_3 h^3: 6 c_3


@pytest.mark.parametrize("kind", KINDS)
def test_the_third_derivative_is_that_of_the_green_lagrange_energy(kind: str) -> None:
    solid = body_of(mesh_of(kind, COUNTS, LENGTHS), 2.0, nu=NU)
    rng = np.random.default_rng(3)
    fields = rng.normal(size=(solid.mesh.n_nodes, solid.mesh.dimension, 4))
    (third,) = third_of(solid, fields).values()
    energy = energy_of(solid, {})
    for y in rng.normal(size=(5, 4)):
        expected = third_along(energy, fields @ y)
        assert np.einsum("ijk,i,j,k", third, y, y, y) == pytest.approx(
            expected, rel=1e-10, abs=1e-12 * abs(third).max()
        )
    for order in ((0, 2, 1), (1, 0, 2), (2, 1, 0)):
        np.testing.assert_array_equal(third.transpose(order), third)


@pytest.mark.parametrize("kind", ["quad8", "hexahedron20"])
def test_of_few_vectors_it_is_what_it_is_of_all_fields(kind: str) -> None:
    two = kind == "quad8"
    solid, _, points = rod(kind, two)
    _, recovery = of_rod(kind, two)
    terms = third_of(solid, recovery)
    whole = np.tensordot(evaluate_weights(terms, points[0]), np.array(list(terms.values())), 1)
    vectors = np.random.default_rng(4).normal(size=(recovery.shape[1], 3))
    found = FieldsOnRanks(solid, recovery, MPI.COMM_SELF).third_with(vectors, points[0])
    np.testing.assert_array_equal(found, found.swapaxes(1, 2))
    np.testing.assert_allclose(found, contraction_of(whole)(vectors), rtol=0, atol=1e-12 * np.abs(found).max())


def test_terms_of_two_materials_are_affine() -> None:
    solid, frames, points = rod("quad8", two_materials=True)
    component, recovery = of_second_order(solid, frames, points, 6)
    assert set(component.large.third) == set(component.stiffness)
    assert set(component.moments) == set(component.mass)
    for values in ({"E": 1.3e11}, {"E": 2.6e11}):
        energy = energy_of(solid, values)
        third = np.tensordot(
            evaluate_weights(component.large.third, values), np.array(list(component.large.third.values())), 1
        )
        y = np.random.default_rng(1).normal(size=component.n)
        y *= 1e-2 / np.abs(recovery @ y).max()
        expected = third_along(energy, (recovery @ y).reshape(-1, 2))
        # round-off of the energies, beside a third of a hundredth of which the cubic part is
        assert np.einsum("ijk,i,j,k", third, y, y, y) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("kind", ["quad8", "hexahedron20"])
def test_the_moments_make_the_mass_and_turn_with_the_body(kind: str) -> None:
    solid, frames, points = rod(kind)
    component, recovery = condense(solid, frames, points, 3, MPI.COMM_SELF)
    (moments,), (own,), d = component.moments.values(), component.mass.values(), solid.mesh.dimension
    np.testing.assert_allclose(np.trace(moments), own, rtol=0, atol=1e-12 * np.abs(own).max())
    mass, n = matrices_of(solid)[1], component.n
    turn = np.random.default_rng(5).normal(size=(d, d))
    turned = np.einsum("ij,njk->nik", turn, recovery.reshape(-1, d, n)).reshape(recovery.shape)
    expected, weight = recovery.T @ (mass @ turned), next(iter(component.mass)).evaluate(points[0])
    found = weight * np.einsum("ij,ijkl->kl", turn, moments)
    # of unlike sizes, displacements of frames and amplitudes: by those of the mass
    scale = np.sqrt(np.outer(np.diag(own), np.diag(own))) * weight
    assert np.abs((found - expected) / scale).max() < 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_stretching_is_told_from_bending_and_torsion(kind: str) -> None:
    """A bar along an oblique axis: all of the energy of a pull, none of bending's, and never more than there is."""
    mesh = mesh_of(kind, (12, 2, 2), (1.0, 0.05, 0.05))
    x, *across = mesh.nodes.T
    y, d = across[0] - 0.025, mesh.dimension
    pulled = np.column_stack([x, *(-NU * (c - 0.025) for c in across)])
    bent = np.column_stack([-x * y, 0.5 * x**2, *[0.0 * x] * (d - 2)])
    fields = [pulled, bent]
    if d == 3:
        z = across[1] - 0.025
        fields.append(np.column_stack([0.0 * x, -x * z, x * y]))
    turn = np.linalg.qr(np.random.default_rng(6).normal(size=(d, d)))[0]
    turn[:, 0] *= np.sign(np.linalg.det(turn))
    solid = body_of(replace(mesh, nodes=mesh.nodes @ turn.T), 1.0, nu=NU)
    moved = np.stack([field @ turn.T for field in fields], axis=2)
    axis = LongAxis(solid)
    assert abs(axis.direction @ turn[:, 0]) == pytest.approx(1.0, abs=1e-3) and axis.slenderness > 10
    # of the width, whatever axes across a square round-off chooses; other cells than columns tilt the axis a little
    assert axis.n_pieces == 20 or axis.n_pieces == 19 and kind in ("triangle6", "tetra10")
    (stretching,) = fields_on(solid, moved).stretching().values()
    flat = moved.reshape(-1, len(fields))
    share = np.diag(stretching) / np.diag(flat.T @ (matrices_of(solid)[0] @ flat))
    assert share[0] == pytest.approx(1.0, abs=1e-3)
    # pieces of cells that are not columns (tetrahedra, triangles) have a little of it
    assert share[1:].max() < 0.02
    noise = np.random.default_rng(7).normal(size=(*mesh.nodes.shape, 5))
    (stretching,), flat = fields_on(solid, noise).stretching().values(), noise.reshape(-1, 5)
    left = flat.T @ (matrices_of(solid)[0] @ flat) - stretching
    assert np.linalg.eigvalsh(left)[0] > 0.0


@pytest.mark.parametrize("kind", ["quad8", "hexahedron20"])
def test_condensed_bodies_answer_the_inertia_forces_of_rigid_motion(kind: str) -> None:
    """Forces as of linear fields, balanced by those of rigid accelerations, against the whole mesh."""
    solid, frames, points = rod(kind)
    component, recovery = of_rod(kind)
    bare, _ = condense(solid, frames, points, 3, MPI.COMM_SELF)
    assert component.n > bare.n
    stiffness, mass = (matrix.toarray() for matrix in matrices_of(solid))
    fields = linear_fields(solid.mesh.nodes)
    values, vectors = eigh(stiffness, mass)
    elastic = slice(solid.mesh.dimension * (solid.mesh.dimension + 1) // 2, None)
    forces = mass @ fields
    exact = vectors[:, elastic] @ ((vectors[:, elastic].T @ forces) / values[elastic, None])
    reduced, own = recovery.T @ stiffness @ recovery, recovery.T @ forces
    values, vectors = eigh(reduced, recovery.T @ mass @ recovery)
    found = recovery @ (vectors[:, elastic] @ ((vectors[:, elastic].T @ own) / values[elastic, None]))
    work = np.einsum("ik,ik->k", forces, exact)
    left = np.einsum("ik,ij,jk->k", found - exact, stiffness, found - exact)
    # the answers are those with the small shift of the factor
    assert np.all(left < 1e-9 * np.max(work))


def test_a_checkpoint_keeps_it(tmp_path: Path) -> None:
    scene, meshes = solid_slider_crank("reduction.second_order=true", "reduction.modes=3"), solid_meshes(n_per_metre=10)
    first = BuildCheckpoint(tmp_path / "rom.h5", scene, meshes, ONE_RANK, resume=False)
    made = condensed(scene, meshes, ONE_RANK, first)
    kept = BuildCheckpoint(tmp_path / "rom.h5", scene, meshes, ONE_RANK, resume=True).components
    for name, component in made.items():
        other = kept[name].large
        assert other.slenderness == component.large.slenderness
        for kind in ("third", "stretching", "moments"):
            terms, found = (getattr(one if kind == "moments" else one.large, kind) for one in (component, kept[name]))
            np.testing.assert_equal(found, terms)


def test_of_a_scaled_cross_section_it_is_not_known() -> None:
    solid, frames, points = rod("quad8")
    scaled = replace(solid, section_scale=SectionScale(Quantity(1.0, Monomial((("s", 1),)))))
    component, _ = of_second_order(scaled, frames, [{"s": 1.0}], 3)
    assert component.large is None and component.foreshortening is None
