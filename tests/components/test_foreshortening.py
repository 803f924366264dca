"""The foreshortening of bodies that bend: a straight beam's length, what it leaves of the energy, and its moments."""

from collections.abc import Callable

import numpy as np
import pytest
from cantilevers import BAR, BEAM_IN_SPACE, IN_SPACE, PLATE, bar_mesh, cantilever, plate_mesh
from conftest import run_mpi
from effect_scenes import CANTILEVER, scene_of
from mpi4py import MPI

from pgmp_petsc.bodies.floating import FloatingBody, first_moments
from pgmp_petsc.components.condensing import floating_shapes
from pgmp_petsc.components.large_deformation import contraction_of, foreshortening
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mesh.line_mesh import straight_beam
from scenes import meshes_of

STIFFENING = ('effects.stiffening={type="geometric_stiffening"}', 'effects.shapes={type="mode_inertia"}')
TIP = 'outputs.tip={type="position", point="beam:tip", axis="x"}'
FEW = ("reduction.modes=3", *STIFFENING, TIP)


def floating(scene, meshes) -> FloatingBody:
    bodies = Mechanism.from_scene(scene, meshes).bodies
    return floating_shapes(scene, meshes, bodies, MPI.COMM_SELF)["beam"]


def planar() -> FloatingBody:
    scene = scene_of(CANTILEVER, "", "bodies.beam.line.elements=16", *FEW)
    return floating(scene, meshes_of(scene))


def spatial() -> FloatingBody:
    return floating(cantilever(BEAM_IN_SPACE, "", IN_SPACE, *FEW), {"beam": straight_beam(1.0, 16, 0.0, 3)})


def plate() -> FloatingBody:
    return floating(cantilever(PLATE, "", *FEW), {"beam": plate_mesh()})


def bar() -> FloatingBody:
    return floating(cantilever(BAR, "", IN_SPACE, *FEW), {"beam": bar_mesh()})


FORCE, COUPLE = 1.0, 0.3
KINDS = [planar, spatial, plate, bar]


def bending(body: FloatingBody) -> np.ndarray:
    """Return the amplitudes of a body that a force and a couple at its tip bend, about the last axis, shape (n,)."""
    stiffness = sum(body.stiffness.values())
    tip = body.shapes[body.frames["tip"]]
    return np.linalg.solve(stiffness, FORCE * tip[1] + COUPLE * tip[-1])


def integrals(values: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the integral from the first place to every one."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(x))])


def slopes(x: np.ndarray) -> np.ndarray:
    """Return the slopes of a free beam, E I = rho A = L = 1, under this load and the inertia forces that balance it."""
    # int q = -F and int q x = -F L - C with q = a + b x
    a, b = np.linalg.solve([[1.0, 0.5], [0.5, 1.0 / 3.0]], [-FORCE, -FORCE - COUPLE])
    slope = integrals(a * x**2 / 2 + b * x**3 / 6, x)
    # the rotation without moment of momentum
    deflection = integrals(slope, x)
    turn = integrals((x - 0.5) * deflection, x)[-1] / integrals((x - 0.5) ** 2, x)[-1]
    return slope - turn


@pytest.mark.parametrize("make", KINDS)
def test_a_straight_body_is_as_long_as_before(make: Callable[[], FloatingBody]) -> None:
    """Its ends come closer by the integral of the squares of its slopes."""
    body, x = make(), np.linspace(0.0, 1.0, 2001)
    xi, squares = bending(body), integrals(slopes(x) ** 2, x)[-1]
    moved = np.einsum("fkij,i,j->fk", body.bent, xi, xi)
    closer = moved[body.frames["tip"]] - moved[body.frames["hinge"]]
    # sections have a height, and cells of 12 along the plate: less than a hundredth
    assert closer[0] == pytest.approx(-squares, rel=0.02)
    assert np.abs(closer[1:]).max() < 1e-3 * squares


@pytest.mark.parametrize("make", KINDS)
def test_its_moment_is_that_of_the_shortened_line(make: Callable[[], FloatingBody]) -> None:
    """``int rho x chi_x`` with ``chi_x' = -w'^2`` and chi without a mean: what centrifugal forces do work on."""
    body, x = make(), np.linspace(0.0, 1.0, 2001)
    xi, chi = bending(body), -integrals(slopes(x) ** 2, x)
    expected = integrals((chi - integrals(chi, x)[-1]) * x, x)[-1]
    assert np.einsum("ij,i,j", sum(body.curved.values())[0, 0], xi, xi) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("make", KINDS)
def test_it_moves_no_centre_of_mass(make: Callable[[], FloatingBody]) -> None:
    body = make()
    d = body.centres.shape[1]
    mass, fields = first_moments(sum(body.moments.values()), d)
    assert np.abs(fields).max() < 1e-9 * mass[0]  # and chi is a sum of the fields


def test_it_is_none_of_what_only_stretches() -> None:
    """Amplitudes that stretch a body have no part in it, and what bends is not moved by it."""
    n = 4
    random = np.random.default_rng(0).normal(size=(n, n, n))
    third = sum(random.transpose(order) for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)))
    stiffness = np.diag([1.0, 2.0, 3.0, 4.0])
    found = foreshortening(contraction_of(third), stiffness, np.diag([0.0, 0.0, 3.0, 4.0]), np.eye(n))
    expected = np.zeros((n, n, n))
    expected[2:, :2, :2] = -third[2:, :2, :2] / np.array([3.0, 4.0])[:, None, None]
    np.testing.assert_allclose(found, expected, atol=1e-14)
    found = foreshortening(contraction_of(third), stiffness, np.diag([0.0, 0.0, 3.0, 4.0]), np.eye(n)[:, :1])
    np.testing.assert_allclose(found, expected[:, :1, :1], atol=1e-14)


def test_amplitudes_may_be_turned() -> None:
    """Other coordinates of the same fields give the same displacements."""
    rng, n = np.random.default_rng(1), 3
    random, turn = rng.normal(size=(n, n, n)), rng.normal(size=(n, n))
    third = sum(random.transpose(order) for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)))
    half = rng.normal(size=(n, n))
    stiffness, stretching = half @ half.T + np.eye(n), 0.5 * half @ half.T
    found = foreshortening(contraction_of(third), stiffness, stretching, np.eye(n))
    turned = np.einsum("abc,ai,bj,ck->ijk", third, turn, turn, turn)
    other = foreshortening(contraction_of(turned), turn.T @ stiffness @ turn, turn.T @ stretching @ turn, np.eye(n))
    np.testing.assert_allclose(np.einsum("ak,kij->aij", turn, other), np.einsum("aij,ik,jl->akl", found, turn, turn))


FETCHED = """
import traceback
import numpy as np
from mpi4py import MPI
from pgmp_petsc.components.component_modes import own_nodes
from pgmp_petsc.components.large_deformation import _fetched

comm = MPI.COMM_WORLD
try:
    for n_nodes in (2, 11):
        nodes, wanted = own_nodes(n_nodes, comm), np.arange(comm.rank, n_nodes)
        rows = _fetched(wanted, nodes, np.array(nodes)[:, None] * [1.0, 10.0], comm)
        assert rows.tolist() == (wanted[:, None] * [1.0, 10.0]).tolist(), (comm.rank, rows)
except Exception:
    traceback.print_exc()
    comm.Abort(1)  # or the others would wait
"""


def test_rows_of_nodes_come_from_the_ranks_that_have_them() -> None:
    """On three ranks, of which one has none of two nodes."""
    run_mpi(3, "-c", FETCHED)
