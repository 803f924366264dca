"""Third derivative of the strain energy of all bodies: against the tangent, affine terms, rows of ranks."""

import combinations
import numpy as np
import pytest
from mpi4py import MPI
from static_equilibrium import StaticEquilibrium

from pgmp_petsc.bodies.matrices import ThirdDerivative, owned_rows
from pgmp_petsc.components.condensing import condensed
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.scene import Scene
from scenes import four_bar, kinematics_of, slider_crank

SCENES = {"slider_crank": slider_crank(), "four_bar": four_bar()}
# a section other than the nominal one: every weight counts
VALUES = {"r1": 7.0e-3}
PAIRS = np.tril_indices(3)
every_scene = pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)


def vectors_of(n_dofs: int) -> np.ndarray:
    """Return three vectors that bend and stretch everything, shape (n_dofs, 3)."""
    return np.random.default_rng(5).normal(size=(n_dofs, 3))


@every_scene
def test_it_is_the_slope_of_the_tangent_at_rest(scene: Scene) -> None:
    kinematics = kinematics_of(scene)
    mechanism = kinematics.mechanism
    energy = StaticEquilibrium(kinematics, VALUES, 0.7)
    vectors, step = vectors_of(mechanism.n_dofs), 1e-4
    terms = ThirdDerivative(mechanism.bodies, range(mechanism.n_dofs)).times(vectors, PAIRS)
    assert set(terms) == set(mechanism.stiffness_weights)
    found = sum(weight.evaluate(VALUES) * term for weight, term in terms.items())
    slopes = [
        (energy.forces(step * vector)[1] - energy.forces(-step * vector)[1]) / (2 * step) @ vectors
        for vector in vectors.T
    ]
    expected = np.array([slopes[i][:, j] for i, j in zip(*PAIRS)]).T
    # central differences: the square of the step times the ratio of vectors to elements' lengths
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5 * np.abs(found).max())


@every_scene
def test_at_parameter_values_it_is_the_weighted_sum(scene: Scene) -> None:
    mechanism = kinematics_of(scene).mechanism
    third, vectors = ThirdDerivative(mechanism.bodies, range(mechanism.n_dofs)), vectors_of(mechanism.n_dofs)
    expected = sum(weight.evaluate(VALUES) * term for weight, term in third.times(vectors, PAIRS).items())
    found = third.weighted(vectors, PAIRS, VALUES)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14 * np.abs(expected).max())


@every_scene
@pytest.mark.parametrize("size", [2, 3, 17])
def test_rows_of_all_ranks_make_the_whole(scene: Scene, size: int) -> None:
    mechanism = kinematics_of(scene).mechanism
    vectors = vectors_of(mechanism.n_dofs)
    whole = ThirdDerivative(mechanism.bodies, range(mechanism.n_dofs)).times(vectors, PAIRS)
    shares = [
        ThirdDerivative(mechanism.bodies, owned_rows(mechanism.n_dofs, rank, size)).times(vectors, PAIRS)
        for rank in range(size)
    ]
    for weight, expected in whole.items():
        stacked = np.concatenate([share[weight] for share in shares])
        np.testing.assert_allclose(stacked, expected, rtol=0, atol=1e-15 * np.abs(expected).max())


def test_without_vectors_there_are_no_pairs() -> None:
    mechanism = kinematics_of(slider_crank()).mechanism
    none = np.tril_indices(0)
    terms = ThirdDerivative(mechanism.bodies, range(mechanism.n_dofs)).times(np.empty((mechanism.n_dofs, 0)), none)
    assert all(term.shape == (mechanism.n_dofs, 0) for term in terms.values())


@pytest.mark.parametrize("kind", ["mixture", "beam and solid in space"])
@pytest.mark.parametrize("size", [2, 3])
def test_rows_of_all_ranks_make_the_whole_with_condensed_bodies(kind: str, size: int) -> None:
    """Ranks may share the rows of a condensed body."""
    scene = combinations.scene_of(kind, "nothing")
    with RankGroup.split(MPI.COMM_SELF, 1) as alone:
        shapes = condensed(scene, combinations.meshes_for(scene), alone, large=True)
    mechanism = Mechanism.from_scene(scene, shapes)
    vectors, values = vectors_of(mechanism.n_dofs), scene.nominal
    whole = ThirdDerivative(mechanism.bodies, range(mechanism.n_dofs)).weighted(vectors, PAIRS, values)
    edges = [mechanism.n_dofs * k // size for k in range(size + 1)]
    shares = [
        ThirdDerivative(mechanism.bodies, range(first, last)).weighted(vectors, PAIRS, values)
        for first, last in zip(edges, edges[1:])
    ]
    np.testing.assert_allclose(np.concatenate(shares), whole, rtol=0, atol=1e-14 * np.abs(whole).max())
    # symmetric in all three vectors
    i, j = PAIRS
    third = np.empty((3, 3, 3))
    third[:, i, j] = third[:, j, i] = vectors.T @ whole
    np.testing.assert_allclose(third.transpose(1, 0, 2), third, rtol=0, atol=1e-12 * np.abs(third).max())


def test_bodies_without_terms_of_second_order_are_named() -> None:
    scene = combinations.scene_of("mixture", "nothing")
    with RankGroup.split(MPI.COMM_SELF, 1) as alone:
        shapes = condensed(scene, combinations.meshes_for(scene), alone)
    mechanism = Mechanism.from_scene(scene, shapes)
    assert [body.third_derivative_known for body in mechanism.bodies] == [True, False]
    with pytest.raises(ValueError, match="the third derivative of the strain energy of rod is not known"):
        ThirdDerivative(mechanism.bodies, range(mechanism.n_dofs))
