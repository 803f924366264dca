"""The beam element in space: rigid motion, objectivity, derivatives, patches, and its sections and axes."""

import math
from itertools import product

import numpy as np
import pytest
from compiled_elements import Beams3d
from scipy.spatial.transform import Rotation

from pgmp_petsc.bodies import beam2d, beam3d
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.beam2d import undeformed_stiffness
from pgmp_petsc.bodies.beam3d import (
    at_rest,
    consistent_mass,
    natural_mass,
    section_axes,
    strain_gradients,
)
from pgmp_petsc.bodies.sections.section import BeamSection, Coefficients3d
from pgmp_petsc.bodies.sections.shapes import Circle, Rectangle
from pgmp_petsc.scene.bodies import Material, SectionEntry

N = 6
SECTION = np.array([3.0, 1.2, 1.5, 0.7, 0.4, 0.9])
INERTIA = np.array([2.0, 0.03, 0.05])
RNG = np.random.default_rng(1)
EDGES = RNG.standard_normal((N, 3))
LENGTHS = np.linalg.norm(EDGES, axis=1)
AXES = section_axes(EDGES, np.array([0.3, 0.5, 1.0]))
PLACES = RNG.standard_normal((N, 3))
BEAMS = Beams3d(LENGTHS, AXES, SECTION)
UPRIGHT = np.broadcast_to(np.eye(3), (N, 3, 3))


def unknowns(*nodes: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return unknowns (N, 24) from places (N, 3) and rotations (N, 3, 3) of both nodes."""
    parts = [part for place, turn in nodes for part in (place, np.swapaxes(turn, 1, 2).reshape(N, 9))]
    return np.concatenate(parts, axis=1)


def deformed(turn: float = 0.8) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Return both nodes of elements in large deformations, relative rotations of the size `turn`."""
    rng = np.random.default_rng(2)
    first = Rotation.from_rotvec(rng.standard_normal((N, 3))).as_matrix()
    second = first @ Rotation.from_rotvec(turn * rng.standard_normal((N, 3))).as_matrix()
    away = 1.2 * np.einsum("eij,ej->ei", first, EDGES) + 0.1 * rng.standard_normal((N, 3))
    return (PLACES, first), (PLACES + away, second)


def moved(node: tuple[np.ndarray, np.ndarray], turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a node after a rotation of everything and a translation."""
    return node[0] @ turn.T + np.array([3.0, -2.0, 5.0]), turn @ node[1]


def energy(u: np.ndarray) -> np.ndarray:
    return BEAMS.strain_energy(u)


def test_strains_do_not_see_rigid_motion() -> None:
    """Energy and forces of deformed elements follow a rotation of everything, to round-off."""
    turn = Rotation.from_rotvec([1.0, 2.0, -0.7]).as_matrix()
    nodes = deformed()
    one, two = (unknowns(*some) for some in (nodes, [moved(node, turn) for node in nodes]))
    np.testing.assert_allclose(BEAMS.strain_energy(two), BEAMS.strain_energy(one), rtol=1e-14)
    forces = BEAMS.forces(one).reshape(N, 8, 3) @ turn.T
    np.testing.assert_allclose(BEAMS.forces(two).reshape(N, 8, 3), forces, atol=1e-14 * np.abs(forces).max())


@pytest.mark.parametrize("turn", [1e-6, 0.3, 0.8])
def test_the_energy_is_that_of_the_rotation_between_the_nodes(turn: float) -> None:
    """With the rotation vector and the half rotation themselves, in place of the forms that give them."""
    (x_1, r_1), (x_2, r_2) = nodes = deformed(turn)
    vector = Rotation.from_matrix(np.swapaxes(r_1, 1, 2) @ r_2).as_rotvec()
    middle = r_1 @ Rotation.from_rotvec(0.5 * vector).as_matrix()
    gamma = np.einsum("eai,eba,eb->ei", AXES, middle, (x_2 - x_1) / LENGTHS[:, None]) - np.array([1.0, 0.0, 0.0])
    kappa = np.einsum("eai,ea->ei", AXES, vector) / LENGTHS[:, None]
    wanted = 0.5 * LENGTHS * (gamma**2 @ SECTION[:3] + kappa**2 @ SECTION[3:])
    np.testing.assert_allclose(energy(unknowns(*nodes)), wanted, rtol=1e-9 if turn < 1e-5 else 1e-13)


@pytest.mark.parametrize("turn", [1e-3, 0.4, 0.8])
@pytest.mark.parametrize("off", [0.0, 0.05])
def test_derivatives(turn: float, off: float) -> None:
    """Central differences, also where directors are not orthonormal, as in the midst of an iteration."""
    rng, h = np.random.default_rng(3), 1e-5
    u = unknowns(*deformed(turn))
    u = u + off * rng.standard_normal(u.shape)
    step = rng.standard_normal(u.shape)
    slope = (energy(u + h * step) - energy(u - h * step)) / (2 * h)
    np.testing.assert_allclose(np.sum(BEAMS.forces(u) * step, axis=1), slope, atol=2e-8 * np.abs(slope).max())
    tangents = BEAMS.tangents(u)
    np.testing.assert_allclose(tangents, np.swapaxes(tangents, 1, 2), atol=1e-14 * np.abs(tangents).max())
    change = (BEAMS.forces(u + h * step) - BEAMS.forces(u - h * step)) / (2 * h)
    np.testing.assert_allclose(np.einsum("eij,ej->ei", tangents, step), change, atol=2e-8 * np.abs(change).max())


@pytest.mark.parametrize("stretch", [0.9, 1.05, 1.2])
def test_the_angle_between_directors_of_any_length_has_smooth_derivatives(stretch: float) -> None:
    """Beyond cosines of 1 too, where an iteration may lead before it is back on rotations."""
    u = unknowns(*deformed(0.05))
    u.reshape(N, 2, 4, 3)[:, :, 1:] *= stretch
    step, h = np.random.default_rng(3).standard_normal(u.shape), 1e-5
    change = (BEAMS.forces(u + h * step) - BEAMS.forces(u - h * step)) / (2 * h)
    found = np.einsum("eij,ej->ei", BEAMS.tangents(u), step)
    np.testing.assert_allclose(found, change, atol=2e-8 * np.abs(change).max())


def test_stiffness_and_mass_at_rest_are_those_of_the_element() -> None:
    u, gradient = unknowns((PLACES, UPRIGHT), (PLACES + EDGES, UPRIGHT)), at_rest()
    tangents = gradient.T @ BEAMS.tangents(u) @ gradient
    np.testing.assert_allclose(
        undeformed_stiffness(LENGTHS, strain_gradients(LENGTHS, AXES), SECTION), tangents, atol=1e-14 * tangents.max()
    )
    mass = gradient.T @ natural_mass(LENGTHS, AXES, INERTIA) @ gradient
    np.testing.assert_allclose(consistent_mass(LENGTHS, AXES, INERTIA), mass, atol=1e-15)
    viscosity = gradient.T @ BEAMS.viscosity(u) @ gradient
    np.testing.assert_allclose(viscosity, tangents, atol=1e-14 * tangents.max())


def test_viscosity_does_not_resist_rigid_motion_of_deformed_elements() -> None:
    nodes = deformed()
    u = unknowns(*nodes)
    spin = np.array([[0.0, -0.3, 0.2], [0.3, 0.0, -0.5], [-0.2, 0.5, 0.0]])
    rates = (u.reshape(N, 8, 3) @ spin.T).reshape(N, 24)
    viscosity = BEAMS.viscosity(u)
    assert np.abs(np.einsum("eij,ej->ei", viscosity, rates)).max() < 1e-13 * np.abs(viscosity).max()


def test_mass_of_rigid_motion() -> None:
    """Momentum and moment of inertia of a straight element about its middle."""
    mass, motion = consistent_mass(LENGTHS, AXES, INERTIA), np.zeros((N, 12, 6))
    motion[:, 0:3, :3] = motion[:, 6:9, :3] = motion[:, 3:6, 3:] = motion[:, 9:12, 3:] = np.eye(3)
    for e, edge in enumerate(EDGES):
        across = np.cross(np.eye(3), 0.5 * edge).T
        motion[e, 6:9, 3:], motion[e, 0:3, 3:] = across, -across
    found = np.swapaxes(motion, 1, 2) @ mass @ motion
    rho, about_2, about_3 = INERTIA
    for e, length in enumerate(LENGTHS):
        # the consistent mass of two nodes has L^2 / 12 from the middle as the line has
        local = np.diag([about_2 + about_3, about_2 + rho * length**2 / 12, about_3 + rho * length**2 / 12])
        np.testing.assert_allclose(found[e, :3, :3], rho * length * np.eye(3), atol=1e-13)
        np.testing.assert_allclose(found[e, 3:, 3:], length * AXES[e] @ local @ AXES[e].T, atol=1e-13)
        np.testing.assert_allclose(found[e, 3:, :3], 0.0, atol=1e-13)


@pytest.mark.parametrize("strain", range(6))
def test_patches(strain: int) -> None:
    """Elements of different lengths on a line have one strain each where their nodes follow a field with it."""
    x = np.array([0.0, 0.3, 0.5, 1.1])
    lengths, axes = np.diff(x), section_axes(np.diff(x)[:, None] * np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    nodes, size = np.zeros((4, 6)), 1e-3
    if strain < 3:
        nodes[:, strain] = size * x  # shear turns the line against its sections
    else:
        nodes[:, strain] = size * x
        if strain == 4:
            nodes[:, 2] = -0.5 * size * x**2
        if strain == 5:
            nodes[:, 1] = 0.5 * size * x**2
    pairs = np.concatenate([nodes[:-1], nodes[1:]], axis=1)
    found = np.einsum("esi,ei->es", strain_gradients(lengths, axes), pairs)
    np.testing.assert_allclose(found, np.tile(size * np.eye(6)[strain], (3, 1)), atol=1e-16)


def test_in_the_plane_it_is_the_planar_element() -> None:
    """Energy, stiffness and mass of elements that stay in the plane of their height."""
    rng = np.random.default_rng(4)
    lengths = rng.uniform(0.5, 1.0, N)
    alphas = rng.uniform(-3.0, 3.0, N)
    flat = np.array([SECTION[0], SECTION[1], SECTION[5]])
    edges = lengths[:, None] * np.stack([np.cos(alphas), np.sin(alphas), 0.0 * alphas], axis=1)
    axes = section_axes(edges, np.array([-0.3, 1.0, 0.0]))
    phi, places = rng.uniform(-1.0, 1.0, (2, N)), [rng.standard_normal((N, 3)) for _ in range(2)]
    for place in places:
        place[:, 2] = 0.0
    u = unknowns(*((x, Rotation.from_rotvec(p[:, None] * [0.0, 0.0, 1.0]).as_matrix()) for x, p in zip(places, phi)))
    beams = Beams3d(lengths, axes, SECTION)
    planar = []
    for e in range(N):
        moved = np.array([*places[0][e, :2], phi[0, e], *places[1][e, :2], phi[1, e]])
        angle = alphas[e] + 0.5 * (phi[0, e] + phi[1, e])
        strain = beam2d.strains.py_func(moved, np.cos(angle), np.sin(angle), lengths[e])
        stress, strain = beam2d.stresses.py_func(strain, flat), (strain[0] - 1.0, *strain[1:])
        planar.append(0.5 * beam2d.work_of.py_func(strain, stress, lengths[e]))
    np.testing.assert_allclose(beams.strain_energy(u), planar, rtol=1e-13)
    kept = [0, 1, 5, 6, 7, 11]
    stiffness = undeformed_stiffness(lengths, strain_gradients(lengths, axes), SECTION)[:, kept][:, :, kept]
    np.testing.assert_allclose(
        stiffness, undeformed_stiffness(lengths, beam2d.strain_gradients(lengths, alphas), flat), atol=1e-13
    )
    mass = consistent_mass(lengths, axes, INERTIA)[:, kept][:, :, kept]
    in_plane = beam2d.consistent_mass(lengths, np.zeros(lengths.size), INERTIA[[0, 2]])
    np.testing.assert_allclose(mass, in_plane, atol=1e-14)


def test_axes() -> None:
    np.testing.assert_allclose(np.swapaxes(AXES, 1, 2) @ AXES, UPRIGHT, atol=1e-15)
    np.testing.assert_allclose(np.linalg.det(AXES), 1.0, rtol=1e-14)
    np.testing.assert_allclose(AXES[:, :, 0] * LENGTHS[:, None], EDGES, atol=1e-14)
    assert np.all(AXES[:, :, 1] @ np.array([0.3, 0.5, 1.0]) > 0.0)
    assert np.isnan(section_axes(np.array([[1.0, 0.0, 0.0]]), np.array([-2.0, 0.0, 0.0]))).any()
    free = section_axes(np.array([[1.0, 0.0, 0.0]]), None)
    np.testing.assert_allclose(free[0], np.eye(3), atol=1e-15)


STEEL = Material(E=2e11, nu=0.3, rho=7800.0)
SHEAR = 2e11 / 2.6


def in_space(
    section: SectionEntry, material: Material | None, nominal: dict[str, float] = {}, spans: dict = {}
) -> BeamSection:
    return section.coefficients(3, material, nominal, lambda: spans)


def totals(section: BeamSection, values: dict[str, float] = {}) -> tuple[np.ndarray, np.ndarray]:
    """Return stiffness and inertia at parameter values."""
    return tuple(
        sum(weight.evaluate(values) * np.array(terms) for weight, terms in kind.items())
        for kind in map(section.terms, ("stiffness", "mass"))
    )


def test_circle() -> None:
    stiffness, inertia = totals(in_space(Circle(shape="circle", radius=0.01), STEEL))
    area, second = math.pi * 1e-4, math.pi / 4 * 1e-8
    shear = SHEAR * area * 7.8 / 8.8
    np.testing.assert_allclose(stiffness, [2e11 * area, shear, shear, SHEAR * 2 * second, 2e11 * second, 2e11 * second])
    np.testing.assert_allclose(inertia, [7800 * area, 7800 * second, 7800 * second])


def test_rectangle() -> None:
    """Torsion constants from Timoshenko and Goodier 1951, art. 94: 0.1406 a^4 of a square, 0.229 a b^3 of 2 : 1."""
    section = in_space(Rectangle(shape="rectangle", width=0.01, height=0.02), STEEL)
    stiffness, inertia = totals(section)
    in_width, in_height = 0.02 * 1e-6 / 12, 0.01 * 8e-6 / 12
    np.testing.assert_allclose(stiffness[4:], [2e11 * in_width, 2e11 * in_height])
    np.testing.assert_allclose(inertia, [7800 * 2e-4, 7800 * in_width, 7800 * in_height])
    assert stiffness[3] == pytest.approx(SHEAR * 0.228682 * 0.02 * 1e-6, rel=1e-5)
    assert section.lever({}) == pytest.approx(0.6)
    square = in_space(Rectangle(shape="rectangle", width=0.01, height=0.01), STEEL)
    assert totals(square)[0][3] == pytest.approx(SHEAR * 0.140577 * 1e-8, rel=1e-6)
    assert square.lever({}) == 0.0


@pytest.mark.parametrize(("width", "height"), [("b", 0.02), (0.02, "b"), ("b", "b"), ("b", "h")])
def test_a_rectangle_is_affine_in_its_sides(width: float | str, height: float | str) -> None:
    """Torsion is exact at the nominal values, and 0.1 % off at most beside them."""
    nominal = {"b": 0.01, "h": 0.03}
    spans = {"b": (0.005, 0.02)}
    affine = in_space(Rectangle(shape="rectangle", width=width, height=height), STEEL, nominal, spans)
    for factor, limit in ((1.0, 1e-12), (0.5, 1e-3), (0.75, 1e-3), (1.6, 1e-3)):
        values = {"b": 0.01 * factor, "h": 0.03}
        numbers = Rectangle(shape="rectangle", width=values.get(width, width), height=values.get(height, height))
        exact = totals(in_space(numbers, STEEL))
        stiffness, inertia = totals(affine, values)
        np.testing.assert_allclose(np.delete(stiffness, 3), np.delete(exact[0], 3), rtol=1e-12)
        assert stiffness[3] == pytest.approx(exact[0][3], rel=1e-12 if width == height else limit)
        np.testing.assert_allclose(inertia, exact[1], rtol=1e-12)


@pytest.mark.parametrize("nominal", [(0.01, 0.012), (0.012, 0.01), (0.01, 0.02), (0.01, 0.01)])
@pytest.mark.parametrize("half", [0.1, 0.3, 0.5])
def test_torsion_of_a_rectangle_whose_sides_exchange_their_order(nominal: tuple[float, float], half: float) -> None:
    """The constant is that of the sides whichever is longer, over all values of both; with either name for either."""
    values = dict(zip("bh", nominal))
    spans = {name: (value * (1 - half), value * (1 + half)) for name, value in values.items()}
    affine = in_space(Rectangle(shape="rectangle", width="b", height="h"), STEEL, values, spans)
    other = in_space(Rectangle(shape="rectangle", width="h", height="b"), STEEL, values, spans)
    for b, h in product(np.linspace(*spans["b"], 9), np.linspace(*spans["h"], 9)):
        numbers = in_space(Rectangle(shape="rectangle", width=b, height=h), STEEL)
        exact = totals(numbers)[0][3]
        found = totals(affine, {"b": b, "h": h})[0][3]
        assert found == pytest.approx(exact, rel=1e-3)  # NEAR, and what ratios between those fitted add
        assert totals(other, {"b": b, "h": h})[0][3] == pytest.approx(found, rel=1e-9)


def test_coefficients() -> None:
    given = Coefficients3d(
        shape="coefficients3d", axial=1.0, shear_2=2.0, shear_3="k", torsion=4.0, bending_2=5.0, bending_3=6.0,
        line_density=7.0, rotary_2=8.0, rotary_3=24.0,
    )  # fmt: skip
    section = in_space(given, None, {"k": 3.0})
    np.testing.assert_allclose(totals(section, {"k": 3.0})[0], [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    np.testing.assert_allclose(section.terms("mass")[Monomial()], [7.0, 8.0, 24.0])
    assert section.lever({"k": 3.0}) == 0.5
    assert set(section.terms("stiffness")) == {Monomial(), Monomial((("k", 1),))}


def from_rest(u: np.ndarray) -> np.ndarray:
    """Return the unknowns (N, 24) for displacements and rotation vectors (N, 12) of both nodes."""
    parts = [u[:, 6 * node : 6 * node + 6] for node in range(2)]
    places = (PLACES, PLACES + EDGES)
    turns = (Rotation.from_rotvec(part[:, 3:]).as_matrix() for part in parts)
    return unknowns(*((place + part[:, :3], turn) for place, part, turn in zip(places, parts, turns)))


def test_the_third_derivative_at_rest_is_that_of_the_energy() -> None:
    """Along any direction, by differences of the energy in rotation vectors, extrapolated to fourth order."""
    vectors, pairs = RNG.standard_normal((N, 12, 3)), np.tril_indices(3)
    rows = beam3d.rest_strains(LENGTHS, AXES)
    strains = rows @ vectors
    third = beam3d.third_derivative(strains[..., pairs[0]], strains[..., pairs[1]], SECTION)
    forces = LENGTHS[:, None, None] * (np.swapaxes(rows, 1, 2) @ third)
    tensor = np.empty((N, 3, 3, 3))
    for number, (i, j) in enumerate(zip(*pairs)):
        tensor[:, :, i, j] = tensor[:, :, j, i] = np.einsum("ndk,nd->nk", vectors, forces[..., number])
    for order in ((0, 2, 1, 3), (0, 3, 2, 1)):
        np.testing.assert_allclose(tensor.transpose(order), tensor, rtol=0, atol=1e-13 * np.abs(tensor).max())

    def slope(u: np.ndarray, h: float) -> np.ndarray:
        one, two = (energy(from_rest(k * h * u)) - energy(from_rest(-k * h * u)) for k in (1, 2))
        return (two - 2.0 * one) / (2.0 * h**3)

    for y in RNG.standard_normal((3, 3)):
        u = vectors @ y
        expected = (4.0 * slope(u, 4e-3) - slope(u, 8e-3)) / 3.0
        found = np.einsum("nijk,i,j,k->n", tensor, y, y, y)
        # the fourth power of steps of up to 0.03 rad, and round-off over their cube
        np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5 * np.abs(found).max())


def test_strains_at_rest_are_those_of_the_element_to_second_order() -> None:
    direction = RNG.standard_normal((N, 12))
    rest = np.einsum("esi,ei->se", beam3d.rest_strains(LENGTHS, AXES), direction)
    linear = beam3d.strains_of(rest, curved=False)
    exact = np.einsum("esi,ei->se", strain_gradients(LENGTHS, AXES), direction)
    np.testing.assert_allclose(linear, exact, rtol=0, atol=1e-13)
    errors = []
    for size in (1e-2, 5e-3):
        curved = beam3d.strains_of(size * rest, curved=True)
        found = 0.5 * LENGTHS * (SECTION @ curved**2)
        errors.append(np.abs(found - energy(from_rest(size * direction))).max())
    # strains wrong by third order, so that the energy is by fourth
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.2)
