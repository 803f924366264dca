"""Affine matrices of bodies: rows of ranks, sums of elements, third derivatives; assembled and rigid bodies."""

from dataclasses import replace

import combinations
import numpy as np
import pytest
import scipy.sparse as sp
from effect_scenes import BAR, scene_of
from refusals import assert_refused
from runs import ONE_RANK
from scipy.sparse.linalg import ArpackNoConvergence
from solids import body_of, box_mesh, matrices_of, mesh_of, rectangle_mesh
from static_equilibrium import StaticEquilibrium

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.units import SI
from pgmp_petsc.bodies import assembled_reading
from pgmp_petsc.bodies.affine import Monomial, Quantity
from pgmp_petsc.bodies.assembled import Assembled, MassProperties
from pgmp_petsc.bodies.assembled_reading import check_free, check_mass, check_places, check_stated, made_symmetric
from pgmp_petsc.bodies.body import DOFS_PER_NODE, Body
from pgmp_petsc.bodies.component import rigid_component
from pgmp_petsc.bodies.framed_solid import FramedSolid
from pgmp_petsc.bodies.kinds.beam import Beam
from pgmp_petsc.bodies.kinds.rigid import RigidBody
from pgmp_petsc.bodies.matrices import AffineMatrices, ThirdDerivative, owned_rows, weighted_sum
from pgmp_petsc.bodies.sections.section import Coefficients
from pgmp_petsc.bodies.solid import FaceFrame, Region, Solid
from pgmp_petsc.components.condensing import condensed
from pgmp_petsc.mechanism.mechanism import Mechanism, Unknowns
from pgmp_petsc.mesh.meshes import LineMesh, reference_element
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.bodies import Stated
from scenes import RADIUS, four_bar, kinematics_of, mechanism_of, slider_crank, tables

ONE = Monomial()
VALUES = {"r1": RADIUS}


@pytest.fixture(scope="module")
def mechanism() -> Mechanism:
    return mechanism_of(slider_crank())


@pytest.fixture(scope="module")
def matrices(mechanism: Mechanism) -> AffineMatrices:
    return AffineMatrices(mechanism.bodies, range(mechanism.n_dofs))


def test_matrices_are_the_sums_of_element_matrices(mechanism: Mechanism, matrices: AffineMatrices) -> None:
    first = matrices.mass[ONE]
    for terms, kind in ((matrices.mass, "mass"), (matrices.stiffness, "stiffness")):
        dense = {monomial: np.zeros((mechanism.n_dofs,) * 2) for monomial in terms}
        for body in mechanism.bodies:
            for monomial, elements in body.of_elements(kind, np.arange(body.mesh.n_cells)).items():
                for (i, j), element in zip(body.elements, elements):
                    dofs = np.r_[DOFS_PER_NODE * i + np.arange(3), DOFS_PER_NODE * j + np.arange(3)]
                    dense[monomial][np.ix_(dofs, dofs)] += element
        for monomial, matrix in terms.items():
            np.testing.assert_allclose(matrix.toarray(), dense[monomial], rtol=1e-14)
            np.testing.assert_array_equal(matrix.indptr, first.indptr)
            np.testing.assert_array_equal(matrix.indices, first.indices)
    assert weighted_sum(matrices.stiffness, VALUES).nnz == first.nnz


@pytest.mark.parametrize("size", [1, 2, 3, 5, 17])
def test_rows_of_all_ranks_make_the_whole(mechanism: Mechanism, matrices: AffineMatrices, size: int) -> None:
    shares = [owned_rows(mechanism.n_dofs, rank, size) for rank in range(size)]
    assert [row for share in shares for row in share] == list(range(mechanism.n_dofs))
    assert all(share.start % DOFS_PER_NODE == 0 for share in shares)
    parts = [AffineMatrices(mechanism.bodies, share) for share in shares]
    for monomial, whole in matrices.stiffness.items():
        stacked = sp.vstack([part.stiffness[monomial] for part in parts])
        np.testing.assert_array_equal(stacked.toarray(), whole.toarray())
        np.testing.assert_array_equal(
            sp.vstack([part.mass[monomial] for part in parts]).toarray(), matrices.mass[monomial].toarray()
        )


SCENES = {"slider_crank": slider_crank(), "four_bar": four_bar()}
# a section other than the nominal one: every weight counts
OTHER = {"r1": 7.0e-3}
PAIRS = np.tril_indices(3)
every_scene = pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)


def vectors_of(n_dofs: int) -> np.ndarray:
    """Return three vectors that bend and stretch everything, shape (n_dofs, 3)."""
    return np.random.default_rng(5).normal(size=(n_dofs, 3))


@every_scene
def test_the_third_derivative_is_the_slope_of_the_tangent_at_rest(scene: Scene) -> None:
    kinematics = kinematics_of(scene)
    mechanism = kinematics.mechanism
    energy = StaticEquilibrium(kinematics, OTHER, 0.7)
    vectors, step = vectors_of(mechanism.n_dofs), 1e-4
    terms = ThirdDerivative(mechanism.bodies, range(mechanism.n_dofs)).times(vectors, PAIRS)
    assert set(terms) == set(mechanism.stiffness_weights)
    found = sum(weight.evaluate(OTHER) * term for weight, term in terms.items())
    slopes = [
        (energy.forces(step * vector)[1] - energy.forces(-step * vector)[1]) / (2 * step) @ vectors
        for vector in vectors.T
    ]
    expected = np.array([slopes[i][:, j] for i, j in zip(*PAIRS)]).T
    # central differences: the square of the step times the ratio of vectors to elements' lengths
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5 * np.abs(found).max())


@every_scene
def test_the_third_derivative_at_parameter_values_is_the_weighted_sum(scene: Scene) -> None:
    mechanism = kinematics_of(scene).mechanism
    third, vectors = ThirdDerivative(mechanism.bodies, range(mechanism.n_dofs)), vectors_of(mechanism.n_dofs)
    expected = sum(weight.evaluate(OTHER) * term for weight, term in third.times(vectors, PAIRS).items())
    found = third.weighted(vectors, PAIRS, OTHER)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14 * np.abs(expected).max())
    none = third.times(np.empty((mechanism.n_dofs, 0)), np.tril_indices(0))
    assert all(term.shape == (mechanism.n_dofs, 0) for term in none.values())


@pytest.mark.parametrize("kind", ["mixture", "beam and solid in space"])
@pytest.mark.parametrize("size", [2, 3])
def test_rows_of_all_ranks_make_the_whole_third_derivative_of_condensed_bodies(kind: str, size: int) -> None:
    """Ranks may share the rows of a condensed body."""
    scene = combinations.scene_of(kind, "nothing")
    shapes = condensed(scene, combinations.meshes_for(scene), ONE_RANK, large=True)
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
    shapes = condensed(scene, combinations.meshes_for(scene), ONE_RANK)
    mechanism = Mechanism.from_scene(scene, shapes)
    assert [body.third_derivative_known for body in mechanism.bodies] == [True, False]
    with pytest.raises(ValueError, match="the third derivative of the strain energy of rod is not known"):
        ThirdDerivative(mechanism.bodies, range(mechanism.n_dofs))


MESH = mesh_of("hexahedron", (40, 2, 2), (1.0, 0.02, 0.02))


def body(stiffness: sp.spmatrix | None = None, mass: sp.spmatrix | None = None) -> Assembled:
    k, m = matrices_of(body_of(MESH, 210e9, 7800.0))
    labels = np.arange(1, MESH.n_nodes + 1)
    return Assembled.of(
        MESH.nodes, labels, {}, None, k if stiffness is None else stiffness, m if mass is None else mass
    )


def test_a_slender_body_with_round_off_in_every_entry_is_free() -> None:
    stiffness = matrices_of(body_of(MESH, 210e9, 7800.0))[0]
    rough = stiffness.copy()
    rough.data *= 1.0 + 1e-15 * np.random.default_rng(1).standard_normal(rough.nnz)
    whole = made_symmetric(rough.tocoo(), np.arange(MESH.n_nodes), 3, "stiffness")
    check_free(body(whole), "stiffness")
    assert abs(whole - whole.T).max() == 0.0


@pytest.mark.parametrize("digits", [5, 8])
def test_digits_that_are_cut_off_are_told(digits: int) -> None:
    stiffness = matrices_of(body_of(MESH, 210e9, 7800.0))[0]
    stiffness.data = np.array([float(f"{value:.{digits - 1}e}") for value in stiffness.data])
    assert_refused("^stiffness: .*, (and )?with all (its|their) digits", check_free, body(stiffness), "stiffness")


@pytest.mark.parametrize("away", [0.0, 1e3])
@pytest.mark.parametrize(
    ("axes", "words"), [((), "in one place"), ((0,), "on a line"), ((0, 1), "in a plane"), ((0, 1, 2), None)]
)
def test_nodes_have_to_span_space(axes: tuple[int, ...], words: str | None, away: float) -> None:
    nodes = np.zeros((20, 3))
    nodes[:, axes] = np.random.default_rng(1).standard_normal((20, len(axes)))
    turned = away + nodes @ np.linalg.qr(np.arange(9.0).reshape(3, 3) ** 2 + np.eye(3))[0]
    if words is None:
        check_places(turned, "nodes")
        return
    with pytest.raises(InputError, match=f"^nodes: all 20 nodes lie {words}; those of a solid3d body span space"):
        check_places(turned, "nodes")


def test_lumped_masses_are_positive() -> None:
    mass = matrices_of(body_of(MESH, 210e9, 7800.0))[1]
    lumped = sp.diags(np.asarray(mass.sum(axis=1)).ravel())
    assert MESH.n_nodes > assembled_reading.DENSE
    check_mass(body(mass=lumped), "mass")


def test_a_mass_that_lanczos_cannot_tell_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*arguments: object, **options: object) -> None:
        raise ArpackNoConvergence("none", np.zeros(0), np.zeros((0, 0)))

    monkeypatch.setattr(assembled_reading, "eigsh", never)
    assert_refused("^mass: whether it is positive definite cannot be told", check_mass, body(), "mass")


def test_stated_properties_may_differ_by_their_share() -> None:
    found = MassProperties(2.0, np.array([0.5, 0.0, 0.0]), np.diag([0.3, 0.2, 0.1]))
    near = Stated(mass=2.001, centre=(0.5001, 0.0, 0.0), inertia=(0.3001, 0.4, 0.5), within=1e-3)
    check_stated(found, near, "stated", SI)
    for key, value in (("mass", 2.01), ("centre", (0.51, 0.0, 0.0)), ("inertia", (0.31, 0.4, 0.5))):
        with pytest.raises(InputError, match=rf"^stated\.{key} = .* differs by more than stated\.within = 0\.001"):
            check_stated(found, near.model_copy(update={key: value}), "stated", SI)


LINE, ROTARY = 2.5, 0.07
SECTION = Coefficients(
    shape="coefficients", axial=1.0, shear=1.0, bending=1.0, line_density=LINE, rotary_density=ROTARY
)
# a bent line with a branch, cells of different lengths
BENT = LineMesh(
    np.array([[0.0, 0.0], [0.5, 0.0], [0.8, 0.6], [0.8, 1.5], [0.9, -0.4]]),
    np.array([[0, 1], [1, 2], [3, 2], [1, 4]]),
    {"hinge": 0, "tip": 3, "foot": 4},
)


def mass_matrix(body: Body) -> np.ndarray:
    return weighted_sum(AffineMatrices([body], range(3 * body.n_nodes)).mass, {}).toarray()


def test_a_rigid_body_has_the_mass_of_the_flexible_one_in_rigid_motions() -> None:
    section = SECTION.coefficients(2, None, {}, dict)
    flexible, rigid = Beam("bent", BENT, BENT, section=section), RigidBody.of_lines("bent", BENT, section)
    arms = BENT.nodes - rigid.mesh.nodes[0]
    motions = np.zeros((len(arms), 3, 3))
    motions[:, 0, 0] = motions[:, 1, 1] = motions[:, 2, 2] = 1.0
    motions[:, 0, 2], motions[:, 1, 2] = -arms[:, 1], arms[:, 0]
    motions = motions.reshape(-1, 3)
    np.testing.assert_allclose(motions.T @ mass_matrix(flexible) @ motions, mass_matrix(rigid), atol=1e-14)


def test_a_mass_on_a_rigid_body_away_from_its_centre_is_a_particle_with_a_weld() -> None:
    scene = scene_of(
        BAR,
        tables("""
parameters.m: nominal = 2.0
effects.bob: type = "point_mass"; point = "bar:tip"; mass = "m"; inertia = 0.3
effects.second: type = "point_mass"; point = "bar:middle"; mass = 0.5
"""),
    )
    mechanism = mechanism_of(scene)
    matrices = AffineMatrices(mechanism.bodies, range(mechanism.n_dofs))
    mass = weighted_sum(matrices.mass, {"m": 3.0}).toarray()
    # the bar and each of its masses, numbered after it; the bar lends them half of the inertia that it has left
    inertias = [1 / 48, 0.3 + 1 / 24, 1 / 48]
    np.testing.assert_allclose(
        np.diag(mass), [1.0, 1.0, inertias[0], 3.0, 3.0, inertias[1], 0.5, 0.5, inertias[2]], rtol=1e-14
    )
    # along the mechanism's motion about the hinge all of them together
    poses = mechanism.first_guess
    rates = np.zeros((3, 3, 1))
    place = np.array([body.mesh.nodes[0] for body in mechanism.bodies])
    rates[:, 2, 0] = 1.0
    motion = Unknowns(mechanism).place(poses, rates)[:, 0]
    np.testing.assert_allclose(place[:, 0], [0.5, 1.0, 0.5])
    assert motion @ mass @ motion == pytest.approx(1 / 3 + 3.0 + 0.3 + 0.5 * 0.25, rel=1e-14), "nothing is lost"


RHO, LENGTHS = 7800.0, (0.3, 0.02, 0.05)
DENSITY = Quantity(RHO, Monomial((("m", 1),)))


def framed(kind: str) -> FramedSolid:
    d = reference_element(kind).dimension
    mesh = (rectangle_mesh if d == 2 else box_mesh)(kind, (4, 2, 2)[:d], LENGTHS[:d])
    solid = Solid("bar", mesh, (Region(np.arange(mesh.n_cells), Quantity.of(1.0), DENSITY, 0.3),))
    frames = {
        name: FaceFrame.of(mesh.nodes, mesh.faces(name, ""), reference_element(kind).face_kind)
        for name in ("left", "right")
    }
    return FramedSolid(solid, frames)


@pytest.mark.parametrize("kind", ["quad8", "hexahedron20", "tetra10"])
def test_mass_and_inertia_are_those_of_a_box(kind: str) -> None:
    component = rigid_component(framed(kind))
    d = component.centres.shape[1]
    lengths = np.array(LENGTHS[:d])
    m = RHO * lengths.prod()
    squares = m * lengths**2 / 12.0
    turns = [squares.sum()] if d == 2 else squares.sum() - squares
    (matrix,) = component.mass.values()
    # quadrature is exact for straight cells
    np.testing.assert_allclose(matrix, np.diag([*[m] * d, *turns]), rtol=0, atol=1e-12 * m)
    np.testing.assert_allclose(component.centre_of_mass, 0.5 * lengths, rtol=1e-12)


def test_a_body_in_the_plane_is_a_mass_on_a_node() -> None:
    body = RigidBody.of_component("bar", rigid_component(framed("quad8")))
    assert not body.flexible and body.n_nodes == 1 and body.n_internal == 0
    assert body.weights("mass") == {DENSITY.monomial} and body.weights("stiffness") == set()
    assert body.shape.points == {"left": 0, "right": 1}


def test_densities_that_vary_apart_are_refused() -> None:
    meshed = framed("quad8")
    (region,) = meshed.solid.regions
    halves = (
        replace(region, cells=region.cells[:4]),
        replace(region, cells=region.cells[4:], density=Quantity.of(RHO)),
    )
    mixed = FramedSolid(replace(meshed.solid, regions=halves), meshed.frames)
    assert_refused("bodies.bar.flexible = false: a rigid body's density has one factor", rigid_component, mixed)
