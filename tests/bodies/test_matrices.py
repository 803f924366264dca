"""Affine matrices of all bodies: rows of ranks, one pattern, rigid motions, masses."""

import numpy as np
import pytest
import scipy.sparse as sp

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.body import DOFS_PER_NODE
from pgmp_petsc.bodies.matrices import AffineMatrices, assemble, owned_rows, weighted_sum
from pgmp_petsc.mechanism.mechanism import Mechanism
from scenes import CRANK, RADIUS, ROD, STEEL, mechanism_of, slider_crank

ONE, R2, R4 = Monomial(), Monomial((("r1", 2),)), Monomial((("r1", 4),))
VALUES = {"r1": RADIUS}


@pytest.fixture(scope="module")
def mechanism() -> Mechanism:
    return mechanism_of(slider_crank())


@pytest.fixture(scope="module")
def matrices(mechanism: Mechanism) -> AffineMatrices:
    return assemble(mechanism.bodies, range(mechanism.n_dofs))


def test_all_terms_share_one_pattern(matrices: AffineMatrices) -> None:
    first = matrices.mass[ONE]
    for term in (*matrices.mass.values(), *matrices.stiffness.values()):
        np.testing.assert_array_equal(term.indptr, first.indptr)
        np.testing.assert_array_equal(term.indices, first.indices)
    assert weighted_sum(matrices.stiffness, VALUES).nnz == first.nnz


def test_matrices_are_the_sums_of_element_matrices(mechanism: Mechanism, matrices: AffineMatrices) -> None:
    for terms, kind in ((matrices.mass, "mass"), (matrices.stiffness, "stiffness")):
        dense = {monomial: np.zeros((mechanism.n_dofs,) * 2) for monomial in terms}
        for body in mechanism.bodies:
            for monomial, elements in body.of_elements(kind, np.arange(body.mesh.n_cells)).items():
                for (i, j), element in zip(body.elements, elements):
                    dofs = np.r_[DOFS_PER_NODE * i + np.arange(3), DOFS_PER_NODE * j + np.arange(3)]
                    dense[monomial][np.ix_(dofs, dofs)] += element
        for monomial, matrix in terms.items():
            np.testing.assert_allclose(matrix.toarray(), dense[monomial], rtol=1e-14)


def test_the_weighted_sum_is_the_matrix_of_a_scene_of_numbers(matrices: AffineMatrices) -> None:
    numbers = mechanism_of(slider_crank(f"bodies.crank.section.radius={RADIUS}"))
    plain = assemble(numbers.bodies, range(numbers.n_dofs))
    for affine, single in ((matrices.mass, plain.mass), (matrices.stiffness, plain.stiffness)):
        assert set(single) == {ONE}
        np.testing.assert_allclose(weighted_sum(affine, VALUES).toarray(), single[ONE].toarray(), rtol=1e-13, atol=0)


@pytest.mark.parametrize("size", [1, 2, 3, 5, 17])
def test_rows_of_all_ranks_make_the_whole(mechanism: Mechanism, matrices: AffineMatrices, size: int) -> None:
    shares = [owned_rows(mechanism.n_dofs, rank, size) for rank in range(size)]
    assert [row for share in shares for row in share] == list(range(mechanism.n_dofs))
    assert all(share.start % DOFS_PER_NODE == 0 for share in shares)
    parts = [assemble(mechanism.bodies, share) for share in shares]
    for monomial, whole in matrices.stiffness.items():
        stacked = sp.vstack([part.stiffness[monomial] for part in parts])
        np.testing.assert_array_equal(stacked.toarray(), whole.toarray())
        np.testing.assert_array_equal(
            sp.vstack([part.mass[monomial] for part in parts]).toarray(), matrices.mass[monomial].toarray()
        )


def test_total_mass_and_moment_of_inertia(mechanism: Mechanism, matrices: AffineMatrices) -> None:
    mass = weighted_sum(matrices.mass, VALUES)
    area, inertia = np.pi * RADIUS**2, np.pi * RADIUS**4 / 4
    for body, length in zip(mechanism.bodies, (CRANK, ROD)):
        fields = np.zeros((mechanism.n_nodes, DOFS_PER_NODE, 2))
        fields[body.nodes, 0, 0] = 1.0
        centred = body.mesh.nodes[:, 0] - body.mesh.nodes[:, 0].mean()
        fields[body.nodes, 1, 1], fields[body.nodes, 2, 1] = centred, 1.0
        fields = fields.reshape(-1, 2)
        expected = STEEL["rho"] * np.array([area * length, area * length**3 / 12 + inertia * length])
        np.testing.assert_allclose(np.diagonal(fields.T @ mass @ fields), expected, rtol=1e-13)
