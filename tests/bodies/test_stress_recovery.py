"""Strains at the nodes of cells and in beams, and what is made of them, against fields and formulas known before."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from solids import mesh_of

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.bodies.beam3d import beam_work, section_axes, stretch
from pgmp_petsc.bodies.beam_strains import BeamStrains
from pgmp_petsc.bodies.elasticity import Lame
from pgmp_petsc.bodies.kinds.beam import Beam
from pgmp_petsc.bodies.sections.solid_shapes import Circle, Rectangle
from pgmp_petsc.bodies.solid_strains import COMPONENTS, SolidStrains
from pgmp_petsc.bodies.stresses import FURTHEST, LARGEST, SMALLEST, BeamLaw, SolidLaw, principal, von_mises
from pgmp_petsc.mesh.meshes import PLANE_KINDS, SOLID_KINDS, straight_beam
from pgmp_petsc.scene.bodies import Material

KINDS = [*PLANE_KINDS, *SOLID_KINDS]
LINEAR = ("triangle", "quad", "tetra", "hexahedron")
STEEL = Material(E=210e9, nu=0.3, rho=7800.0)
RNG = np.random.default_rng(11)


def everything(mesh) -> SolidStrains:
    return SolidStrains.at_nodes(mesh, [np.arange(mesh.n_cells)], np.arange(mesh.n_nodes))


def ends_of(body, held=()) -> BeamStrains:
    return BeamStrains.at_nodes(body, held, np.arange(body.n_nodes))


def field_of(mesh, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Return displacements (n_nodes, d, 1) of a random polynomial and its gradients (n_nodes, d, d)."""
    d, x = mesh.dimension, mesh.nodes
    linear, square = RNG.normal(size=(d, d)), RNG.normal(size=(d, d, d)) * (degree == 2)
    square = 0.5 * (square + square.swapaxes(1, 2))
    u = x @ linear.T + np.einsum("ijk,nj,nk->ni", square, x, x)
    return u[..., None], linear + 2.0 * np.einsum("ijk,nk->nij", square, x)


@pytest.mark.parametrize("kind", KINDS)
def test_strains_that_elements_hold_exactly_are_recovered_exactly(kind: str) -> None:
    """Quadratic elements have linear strains at all nodes, linear ones constant strains."""
    mesh = mesh_of(kind, (3, 2, 2), (0.7, 0.4, 0.5))
    u, gradient = field_of(mesh, 1 if kind in LINEAR else 2)
    found = everything(mesh).of_displacements(u)[..., 0]
    expected = [0.5 * (gradient[:, i, j] + gradient[:, j, i]) for i, j in COMPONENTS[mesh.dimension]]
    np.testing.assert_allclose(found, np.transpose(expected), rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("kind", KINDS)
def test_strains_of_positions_do_not_feel_rigid_motion_and_begin_as_the_linear_ones(kind: str) -> None:
    mesh = mesh_of(kind, (2, 2, 2), (0.7, 0.4, 0.5))
    d, points = mesh.dimension, everything(mesh)
    u, _ = field_of(mesh, 1 if kind in LINEAR else 2)
    turn = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix() if d == 3 else Rotation.from_rotvec([0, 0, 2]).as_matrix()
    turn, rest = turn[:d, :d], mesh.nodes[..., None]
    moved = np.einsum("ij,njk->nik", turn, rest + 0.1 * u) + 3.0
    np.testing.assert_allclose(points.of_places(moved), points.of_places(rest + 0.1 * u), rtol=0, atol=1e-12)
    small = 1e-6
    slope = (points.of_places(rest + small * u) - points.of_places(rest - small * u)) / (2 * small)
    np.testing.assert_allclose(slope, points.of_displacements(u), rtol=0, atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_a_place_between_nodes_has_what_the_shape_functions_make_of_them(kind: str) -> None:
    mesh = mesh_of(kind, (3, 2, 2), (0.7, 0.4, 0.5))
    cells, place = [np.arange(mesh.n_cells)], np.array([0.31, 0.17, 0.29][: mesh.dimension])
    u, gradient = field_of(mesh, 1 if kind in LINEAR else 2)
    point = SolidStrains.at_place(mesh, cells, place)
    slope = np.linalg.lstsq(
        np.column_stack([np.ones(mesh.n_nodes), mesh.nodes]), gradient.reshape(mesh.n_nodes, -1), rcond=None
    )[0]
    here = (np.array([1.0, *place]) @ slope).reshape(mesh.dimension, mesh.dimension)
    expected = [0.5 * (here[i, j] + here[j, i]) for i, j in COMPONENTS[mesh.dimension]]
    np.testing.assert_allclose(point.of_displacements(u)[0, :, 0], expected, rtol=0, atol=1e-11)
    corner = SolidStrains.at_place(mesh, cells, mesh.nodes[0])
    at_node = SolidStrains.at_nodes(mesh, cells, np.array([0]))
    np.testing.assert_allclose(corner.of_displacements(u), at_node.of_displacements(u), rtol=0, atol=1e-11)
    for outside in (place - 5.0, np.array([0.7 + 1e-4, 0.17, 0.29][: mesh.dimension])):
        assert SolidStrains.at_place(mesh, cells, outside) is None


def test_strains_jump_between_materials_and_nowhere_else() -> None:
    mesh = mesh_of("quad8", (4, 2), (0.4, 0.2))
    left = np.flatnonzero(mesh.nodes[mesh.cells].mean(axis=1)[:, 0] < 0.2)
    materials = [left, np.setdiff1d(np.arange(mesh.n_cells), left)]
    points = SolidStrains.at_nodes(mesh, materials, np.arange(mesh.n_nodes))
    border = np.isclose(mesh.nodes[:, 0], 0.2)
    assert points.n_points == mesh.n_nodes + border.sum()
    u = np.zeros((mesh.n_nodes, 2, 1))
    u[:, 0, 0] = np.where(mesh.nodes[:, 0] < 0.2, mesh.nodes[:, 0], 0.2 + 3.0 * (mesh.nodes[:, 0] - 0.2))
    found = points.of_displacements(u)[:, 0, 0]
    np.testing.assert_allclose(found, np.where(points.material == 0, 1.0, 3.0), rtol=0, atol=1e-12)
    one = points.within(materials, materials[1])
    assert (one.material == 1).all() and one.n_points == np.sum(points.material == 1)


def test_von_mises_and_principal_stresses_of_known_tensors() -> None:
    """Uniaxial s: s; pure shear t: sqrt(3) t and +-t; hydrostatic: 0; in the plane as with nothing across it."""
    uniaxial, shear, pressure = [5.0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 2.0, 0], [3.0, 3.0, 3.0, 0, 0, 0]
    tensors = np.array([uniaxial, shear, pressure])[..., None]
    np.testing.assert_allclose(von_mises(tensors)[:, 0], [5.0, 2.0 * np.sqrt(3.0), 0.0], atol=1e-14)
    np.testing.assert_allclose(principal(tensors, True)[:, 0], [5.0, 2.0, 3.0], atol=1e-7)
    np.testing.assert_allclose(principal(tensors, False)[:, 0], [0.0, -2.0, 3.0], atol=1e-7)
    plane = RNG.normal(size=(4, 3, 5))
    space = np.zeros((4, 6, 5))
    space[:, [0, 1, 3]] = plane
    np.testing.assert_allclose(von_mises(plane), von_mises(space), rtol=1e-13)
    largest, smallest = principal(plane, True), principal(plane, False)
    np.testing.assert_allclose(von_mises(plane) ** 2, largest**2 + smallest**2 - largest * smallest, rtol=1e-12)
    full = RNG.normal(size=(50, 6, 4))
    matrices = np.empty((50, 4, 3, 3))
    for number, (i, j) in enumerate(COMPONENTS[3]):
        matrices[..., i, j] = matrices[..., j, i] = full[:, number]
    values = np.linalg.eigvalsh(matrices)
    np.testing.assert_allclose(principal(full, True), values[..., 2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(principal(full, False), values[..., 0], rtol=0, atol=1e-12)
    tensors[0, 0, 0] = np.nan
    assert np.isnan(principal(tensors, True)[:, 0]).tolist() == [True, False, False]
    assert np.isnan(von_mises(tensors)[:, 0]).tolist() == [True, False, False]


def test_hooke_gives_what_pulls_a_bar() -> None:
    wanted = ("von_mises", "principal_max", "principal_min")
    for plane in (True, False):
        across = -0.3
        strain = np.array([1.0, across, 0.0] if plane else [1.0, across, across, 0, 0, 0])[None, :, None]
        law = SolidLaw(((Quantity(2.0), Lame.of(0.3, plane)),))
        points = SimpleNamespace(material=np.zeros(1, dtype=int))
        found = law.values(wanted, points, law.forces(points, strain, {}), {})
        # the angle of the principal ones is that of two equal stresses across: round-off has its root there
        np.testing.assert_allclose([found[name][0, 0] for name in wanted], [2.0, 2.0, 0.0], atol=1e-7)


def test_which_of_several_values_is_reported() -> None:
    values = np.array([[1.0, -2.0, np.nan], [-3.0, 1.0, 0.0]])
    np.testing.assert_array_equal(LARGEST(values), [1.0, 1.0, np.nan])
    np.testing.assert_array_equal(SMALLEST(values), [-3.0, -2.0, np.nan])
    np.testing.assert_array_equal(FURTHEST(values), [-3.0, -2.0, np.nan])


def spatial_beam(n: int = 4) -> Beam:
    mesh = straight_beam(1.2, n, 0.0, 3)
    axes = section_axes(np.diff(mesh.nodes[mesh.cells], axis=1)[:, 0], np.array([0.2, 0.5, 0.8]))
    section = Rectangle(shape="rectangle", width=0.02, height=0.03).coefficients(3, STEEL, {}, dict)
    return Beam("beam", mesh, mesh, section=section, axes=axes)


def test_strains_of_beams_in_space_have_the_elements_energy() -> None:
    """Against `beam3d.stretch`, which the full-order model integrates, at rotations of some tenths of a radian."""
    body = spatial_beam()
    n_nodes = body.n_nodes
    frames = np.zeros((n_nodes, 12, 1))
    frames[:, :3, 0] = body.mesh.nodes + RNG.normal(size=(n_nodes, 3)) * 0.05
    turns = Rotation.from_rotvec(RNG.normal(size=(n_nodes, 3)) * 0.4).as_matrix()
    frames[:, 3:, 0] = turns.swapaxes(1, 2).reshape(n_nodes, 9)
    points = BeamStrains.of(body, np.arange(4), np.full(4, 0.5))
    strains, resists = points.of_places(frames)[..., 0], points.stiffnesses({})[..., 0]
    lengths, work = body.mesh.lengths, beam_work()
    for e, (one, other) in enumerate(body.mesh.cells):
        u = np.concatenate([frames[one, :, 0], frames[other, :, 0]])
        energy = stretch(u, lengths[e], body.axes[e], resists[e], work)
        np.testing.assert_allclose(0.5 * lengths[e] * resists[e] @ strains[e, :6] ** 2, energy, rtol=1e-12)
    forces = points.forces(strains[..., None], points.stiffnesses({}))[..., 0]
    np.testing.assert_allclose(forces, strains[:, :6] * resists, rtol=1e-14)


@pytest.mark.parametrize("space", [False, True])
def test_strains_of_beams_begin_as_the_linear_ones(space: bool) -> None:
    body = spatial_beam() if space else planar_beam()
    points = ends_of(body)
    u, small = RNG.normal(size=(body.n_nodes, body.node_dofs, 2)), 1e-6

    def strained(size: float) -> np.ndarray:
        if not space:
            frames = size * u
            frames[:, :2] += body.mesh.nodes[..., None]
            return points.of_places(frames)
        frames = np.zeros((body.n_nodes, 12, 2))
        frames[:, :3] = body.mesh.nodes[..., None] + size * u[:, :3]
        for k in range(2):
            turns = Rotation.from_rotvec(size * u[:, 3:, k]).as_matrix()
            frames[:, 3:, k] = turns.swapaxes(1, 2).reshape(-1, 9)
        return points.of_places(frames)

    slope = (strained(small) - strained(-small)) / (2 * small)
    np.testing.assert_allclose(slope, points.of_displacements(u), rtol=0, atol=1e-8 * np.abs(slope).max())


def planar_beam(n: int = 5) -> Beam:
    section = Circle(shape="circle", radius=0.01).coefficients(2, STEEL, {}, dict)
    mesh = straight_beam(0.8, n, 0.0, 2)
    return Beam("beam", mesh, mesh, section=section)


@pytest.mark.parametrize("space", [False, True])
def test_a_cantilever_has_the_forces_and_moments_of_statics_at_every_section(space: bool) -> None:
    """Clamped at x = 0, forces and moments at the tip: what equilibrium says, at all ends of elements, and between."""
    body, length = (spatial_beam(3), 1.2) if space else (planar_beam(3), 0.8)
    per_node, n = body.node_dofs, body.dofs.size
    stiffness = np.zeros((n, n))
    for entries in body.of_elements("stiffness", np.arange(3)).values():
        for cell, entry in zip(body.mesh.cells, entries):
            own = (per_node * cell[:, None] + np.arange(per_node)).ravel()
            stiffness[np.ix_(own, own)] += entry
    load = np.zeros(n)
    load[-per_node:] = RNG.normal(size=per_node)
    u = np.zeros(n)
    u[per_node:] = np.linalg.solve(stiffness[per_node:, per_node:], load[per_node:])
    force, moment = load[-per_node:][: 3 if space else 2], load[-per_node:][3:] if space else load[-1:]
    for points in (ends_of(body), BeamStrains.at_place(body, (), np.array([0.55, 0, 0][: 3 if space else 2]))):
        cells = body.mesh.cells[points.elements]
        ends = body.mesh.nodes[cells][..., 0]
        x = ends[:, 0] + points.along * (ends[:, 1] - ends[:, 0])
        strains = points.of_displacements(u.reshape(body.n_nodes, per_node, 1))
        found = points.forces(strains, points.stiffnesses({}))[..., 0]
        for values, arm in zip(found, length - x):
            if space:
                turned = moment + np.cross([arm, 0.0, 0.0], force)
                expected = np.concatenate([body.axes[0].T @ force, body.axes[0].T @ turned])
            else:
                expected = np.array([*force, moment[0] + arm * force[1]])
            np.testing.assert_allclose(values, expected, rtol=0, atol=1e-7 * np.abs(load).max())


def test_axial_forces_that_change_along_a_beam_are_continued_but_not_across_loads() -> None:
    """A bar with the extension of its own weight, linear; held in its middle, both parts for themselves."""
    body = planar_beam(6)
    x = body.mesh.nodes[:, 0]
    u = np.zeros((body.n_nodes, 3, 1))
    u[:, 0, 0] = 0.8 * x - 0.5 * x**2  # eps = 0.8 - x
    points = ends_of(body)
    places = x[body.mesh.cells[points.elements, points.along.astype(int)]]
    np.testing.assert_allclose(points.of_displacements(u)[:, 0, 0], 0.8 - places, rtol=0, atol=1e-13)
    u[3:, 0, 0] += 0.3 * (x[3:] - x[3])  # a jump of the force at node 3
    points = ends_of(body, {3})
    jump = 0.3 * (points.elements >= 3)
    np.testing.assert_allclose(points.of_displacements(u)[:, 0, 0], 0.8 - places + jump, rtol=0, atol=1e-13)


def test_a_place_beside_a_beam_is_on_none_of_its_elements() -> None:
    body = planar_beam()
    assert BeamStrains.at_place(body, (), np.array([0.3, 1e-3])) is None
    assert BeamStrains.at_place(body, (), np.array([0.32, 0.0])).n_points == 2  # a node: both elements
    assert BeamStrains.at_place(body, (), np.array([0.3, 0.0])).n_points == 1


@pytest.mark.parametrize("shape", ["rectangle", "circle"])
def test_outermost_fibres_of_beams_in_space_are_those_of_all_their_fibres(shape: str) -> None:
    """E (gamma_1 + kappa_2 z - kappa_3 y) of every fibre (y, z) of the section: the largest and the smallest."""
    width, height, radius, modulus = 0.02, 0.03, 0.015, 210e9
    half = (0.5 * height, 0.5 * width) if shape == "rectangle" else (radius, radius)
    law = BeamLaw(Quantity.of(modulus), tuple(map(Quantity.of, half)), shape == "circle")
    points = BeamStrains.of(spatial_beam(1), np.array([0]), np.array([0.5]))  # of another section: strains are given
    strains = RNG.normal(size=(1, 8, 5)) * 1e-3 / np.array([1, 1, 1, 0.01, 0.01, 0.01, 1, 1])[:, None]
    if shape == "rectangle":
        fibres = np.array([[y, z] for y in (-half[0], half[0]) for z in (-half[1], half[1])])
    else:
        angle = np.linspace(0.0, 2.0 * np.pi, 20001)
        fibres = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    axial, about_2, about_3 = strains[0, 0], strains[0, 4], strains[0, 5]
    every = modulus * (axial + np.outer(fibres[:, 1], about_2) - np.outer(fibres[:, 0], about_3))
    for quantity, expected in (("stress_max", every.max(axis=0)), ("stress_min", every.min(axis=0))):
        found = law.values([quantity], points, law.forces(points, strains, {}), {})[quantity][0]
        np.testing.assert_allclose(found, expected, rtol=1e-7, err_msg=quantity)


@pytest.mark.parametrize("kind", ["quad8", "hexahedron20", "beam2d", "beam3d"])
def test_a_column_is_the_same_to_the_last_bit_whatever_stands_beside_it(kind: str) -> None:
    """Samples do not depend on the batch, and so on the number of ranks, that they are in."""
    n = 21
    if kind.startswith("beam"):
        body = spatial_beam() if kind == "beam3d" else planar_beam()
        points, u = ends_of(body), RNG.normal(size=(body.n_nodes, body.node_dofs, n))
        turned = np.tile(np.eye(3).ravel(), (body.n_nodes, 1))[..., None] + 0.1 * RNG.normal(size=(body.n_nodes, 9, n))
        places = np.concatenate([u[:, :3], turned], axis=1) if kind == "beam3d" else u
        law, quantities = BeamLaw(Quantity.of(210e9), (Quantity.of(0.01),) * 2, True), ("axial_force", "stress_max")
    else:
        mesh = mesh_of(kind, (2, 2, 1), (0.7, 0.4, 0.5))
        points, u = everything(mesh), RNG.normal(size=(mesh.n_nodes, mesh.dimension, n))
        places = mesh.nodes[..., None] + u
        law = SolidLaw(((Quantity.of(210e9), Lame.of(0.3, mesh.dimension == 2)),))
        quantities = ("von_mises", "principal_max", "principal_min")
    for strains, motion in ((points.of_displacements, u), (points.of_places, places)):
        whole = strains(motion)
        for size in (1, 2, 3, 7, 16):
            parts = [strains(motion[..., k : k + size]) for k in range(0, n, size)]
            np.testing.assert_array_equal(np.concatenate(parts, axis=-1), whole)
            every = (law.forces(points, part, {}) for part in (whole, *parts))
            values, *of_parts = (law.values(quantities, points, forces, {}) for forces in every)
            for quantity, expected in values.items():
                found = np.concatenate([part[quantity] for part in of_parts], axis=-1)
                np.testing.assert_array_equal(found, expected, err_msg=quantity)
