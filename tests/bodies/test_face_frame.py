"""The frame of a group of faces: means of rigid motions, work, centre and inertia, on flat and curved faces."""

import math

import numpy as np
import pytest
from solids import box_mesh, rectangle_mesh

from pgmp_petsc.bodies.solid import FaceFrame
from pgmp_petsc.mesh import SolidMesh
from pgmp_petsc.mesh.meshes import PLANE_KINDS, SOLID_KINDS, reference_element

KINDS = (*PLANE_KINDS, *SOLID_KINDS)
QUADRATIC = ("triangle6", "quad8", "quad9", "tetra10", "hexahedron20", "hexahedron27")
LENGTHS = (0.8, 0.5, 0.3)


def box(kind: str, counts: tuple[int, ...] = (2, 3, 2), lengths: tuple[float, ...] = LENGTHS) -> SolidMesh:
    d = reference_element(kind).dimension
    return (rectangle_mesh if d == 2 else box_mesh)(kind, counts[:d], lengths[:d])


def bent(places: np.ndarray) -> np.ndarray:
    """Return places after a smooth map that bends every side of a box."""
    d = places.shape[1]
    x, y, z = np.column_stack([places, np.zeros((len(places), 3 - d))]).T
    moved = np.column_stack([x + 0.4 * y * (0.5 - y) - 0.5 * z**2, y + 0.3 * x**2 + 0.6 * y * z, z - 0.3 * x * y])
    return moved[:, :d] + 0.2


def crooked(kind: str) -> tuple[np.ndarray, np.ndarray, FaceFrame]:
    """Return nodes, faces and frame of two bent sides of a box that meet in an edge."""
    mesh = box(kind)
    places, faces = bent(mesh.nodes), np.vstack([mesh.groups["right"], mesh.groups["top"]])
    return places, faces, FaceFrame.of(places, faces, reference_element(kind).face_kind)


def turns(d: int) -> np.ndarray:
    """Return the matrices of ``phi x`` for rotations about the axes, shape (n, d, d)."""
    spin = np.zeros((3, 3, 3))
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        spin[k, j, i], spin[k, i, j] = 1.0, -1.0
    return spin if d == 3 else spin[2:, :2, :2]


def circle(kind: str, n: int, radius: float, length: float) -> FaceFrame:
    """Return the frame of a bore: n faces around, and two along its axis in space."""
    mesh = box(kind, (n, 2, 1) if kind in SOLID_KINDS else (n, 1), (2 * np.pi, length, 1.0))
    angle, *rest = mesh.nodes.T
    if kind in SOLID_KINDS:
        r, along = radius + rest[1], [rest[0]]
    else:
        r, along = radius + rest[0], []
    places = np.column_stack([r * np.cos(angle) + 3.0, r * np.sin(angle) - 1.0, *along])
    return FaceFrame.of(places, mesh.groups["bottom"], reference_element(kind).face_kind)


@pytest.mark.parametrize("kind", KINDS)
def test_a_flat_side_has_the_centre_and_the_inertia_of_a_rectangle(kind: str) -> None:
    mesh = box(kind)
    frame = FaceFrame.of(mesh.nodes, mesh.groups["right"], reference_element(kind).face_kind)
    d = mesh.dimension
    np.testing.assert_allclose(frame.centre, [LENGTHS[0], *(0.5 * np.array(LENGTHS[1:d]))], rtol=1e-14)
    np.testing.assert_array_equal(frame.nodes, np.flatnonzero(mesh.nodes[:, 0] == LENGTHS[0]))
    # means of squares over the side, L^2 / 12; round-off of a few sums
    second = np.array([0.0, LENGTHS[1] ** 2, LENGTHS[2] ** 2 * (d == 3)]) / 12.0
    inertia = np.diag(second.sum() - second) if d == 3 else [[second.sum()]]
    np.testing.assert_allclose(frame.inertia, inertia, rtol=0, atol=1e-15)
    assert frame.radius == pytest.approx(min(LENGTHS[1:d]) / math.sqrt(12.0), rel=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_rigid_motions_move_the_frame_exactly(kind: str) -> None:
    """Also that of bent faces, whatever the quadrature makes of their area."""
    places, faces, frame = crooked(kind)
    d = places.shape[1]
    functionals = frame.functionals(len(places))
    assert functionals.shape == (3 * (d - 1), d * len(places))
    np.testing.assert_array_equal(np.unique(functionals.indices // d), np.unique(faces))
    for i in range(d):
        moved = np.broadcast_to(np.eye(d)[i], places.shape)
        expected = np.concatenate([np.eye(d)[i], np.zeros(len(turns(d)))])
        # round-off of sums over a few dozen nodes, and of one inverse
        np.testing.assert_allclose(functionals @ moved.ravel(), expected, rtol=0, atol=1e-13)
    for k, turn in enumerate(turns(d)):
        expected = np.concatenate([turn @ frame.centre, np.eye(len(turns(d)))[k]])
        np.testing.assert_allclose(functionals @ (places @ turn.T).ravel(), expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("kind", KINDS)
def test_a_force_through_the_frame_does_the_work_of_its_traction(kind: str) -> None:
    """The traction is uniform for a force, and ``(H^-1 m) x X'`` for a torque, for any displacement of the nodes."""
    places, faces, frame = crooked(kind)
    d, rule = places.shape[1], reference_element(reference_element(kind).face_kind).mass
    tangents = np.einsum("qja,eai->eqij", rule.gradients, places[faces])
    if d == 2:
        sizes = np.hypot(tangents[..., 0, 0], tangents[..., 1, 0]) * rule.weights
    else:
        sizes = np.linalg.norm(np.cross(tangents[..., 0], tangents[..., 1]), axis=-1) * rule.weights
    moved = np.random.default_rng(1).normal(size=places.shape)
    at_points = np.einsum("qa,eai->eqi", rule.values, moved[faces])
    arms = np.einsum("qa,eai->eqi", rule.values, places[faces]) - frame.centre
    area = sizes.sum()
    inertia = np.einsum("eq,keqi,leqi->kl", sizes, *(np.einsum("kij,eqj->keqi", turns(d), arms),) * 2)
    load = np.random.default_rng(2).normal(size=3 * (d - 1))
    about = np.einsum("k,kij->ij", np.linalg.solve(inertia, load[d:]), turns(d))
    traction = load[:d] / area + np.einsum("ij,eqj->eqi", about, arms)
    nodal = frame.functionals(len(places)).T @ load
    assert nodal @ moved.ravel() == pytest.approx(np.einsum("eq,eqi,eqi->", sizes, traction, at_points), rel=1e-12)
    # in equilibrium with the load: the same force, and the same torque about the centre
    forces = nodal.reshape(-1, d)
    np.testing.assert_allclose(forces.sum(axis=0), load[:d], rtol=0, atol=1e-13)
    torque = np.einsum("ni,kij,nj->k", forces, turns(d), places - frame.centre)
    np.testing.assert_allclose(torque, load[d:], rtol=0, atol=1e-13)


@pytest.mark.parametrize("kind", KINDS)
def test_the_frame_of_a_bore(kind: str) -> None:
    """In the plane H / A = r^2; in space r^2 about the axis and r^2 / 2 + L^2 / 12 across it."""
    radius, length, n = 0.4, 0.7, 24
    frame = circle(kind, n, radius, length)
    half = np.pi / n
    # chords instead of arcs: their points are this much nearer to the axis in the mean square
    mean = radius**2 if kind in QUADRATIC else radius**2 * (np.cos(half) ** 2 + np.sin(half) ** 2 / 3)
    expected = np.array([[mean]])
    if kind in SOLID_KINDS:
        across = mean / 2 + length**2 / 12
        expected = np.diag([across, across, mean])
    # by symmetry, to round-off; parabolas through points of the arc miss r^2 by half^4 / 30 of it in the mean
    np.testing.assert_allclose(frame.centre, [3.0, -1.0, 0.5 * length][: len(frame.centre)], rtol=0, atol=1e-14)
    tolerance = half**4 / 25 * radius**2 if kind in QUADRATIC else 1e-14
    np.testing.assert_allclose(frame.inertia, expected, rtol=0, atol=tolerance)
    if kind in QUADRATIC:
        errors = [abs(circle(kind, n, radius, length).inertia[-1, -1] / radius**2 - 1) for n in (8, 16)]
        assert math.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.1)
