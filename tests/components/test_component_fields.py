"""Bodies in floating frames: their shortening, Block Lanczos where modes stay missing, and the fields they keep."""

from collections.abc import Callable, Iterator

import numpy as np
import petsc4py
import pytest
import scipy.linalg
from cantilevers import BAR, BEAM_IN_SPACE, IN_SPACE, PLATE, bar_mesh, cantilever, plate_mesh
from conftest import run_mpi
from effect_scenes import CANTILEVER, scene_of
from mpi4py import MPI

from pgmp_petsc.bodies.floating import FloatingBody, first_moments
from pgmp_petsc.components.condensing import _answering, floating_shapes
from pgmp_petsc.components.large_deformation import contraction_of, foreshortening
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mesh.meshes import straight_beam
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


petsc4py.init([])

from petsc4py import PETSc  # noqa: E402

from pgmp_petsc.base.errors import RunError  # noqa: E402
from pgmp_petsc.components import body_problem  # noqa: E402
from pgmp_petsc.components.body_problem import BlockLanczos  # noqa: E402

HALF, SHIFT, N_MODES = 60, -0.5, 5


@pytest.fixture
def twins() -> Iterator[tuple[PETSc.Mat, PETSc.Mat, np.ndarray, np.ndarray]]:
    """Return mass, stiffness and eigenvalues of two equal free chains side by side, and one's rigid motion and
    stretch."""
    ends = np.r_[1.0, np.full(HALF - 2, 2.0), 1.0]
    chain = np.diag(ends) - np.eye(HALF, k=1) - np.eye(HALF, k=-1)
    stiffness = 1e3 * np.kron(np.eye(2), chain)
    matrices = [
        PETSc.Mat().createDense(stiffness.shape, array=a, comm=PETSc.COMM_SELF) for a in (np.eye(2 * HALF), stiffness)
    ]
    matrices = [matrix.convert("aij") for matrix in matrices]
    one = np.r_[np.ones(HALF), np.zeros(HALF)]
    yield *matrices, scipy.linalg.eigvalsh(stiffness), np.column_stack([one, one * np.arange(2 * HALF)])
    for matrix in matrices:
        matrix.destroy()


def lanczos(mass: PETSc.Mat, stiffness: PETSc.Mat, start: np.ndarray) -> BlockLanczos:
    n = mass.getSize()[0]
    shifted = stiffness[:, :] - SHIFT * np.eye(n)
    return BlockLanczos(mass, stiffness, lambda b: np.linalg.solve(shifted, b), SHIFT, start, MPI.COMM_SELF)


def test_equal_modes_are_all_found(twins: tuple) -> None:
    mass, stiffness, exact, start = twins
    values, modes = lanczos(mass, stiffness, start).solve(2, N_MODES, lambda tau: int((exact < tau).sum()), "here")
    np.testing.assert_allclose(values, exact[: 2 + N_MODES], rtol=1e-10, atol=1e-10 * exact[2])
    np.testing.assert_allclose(modes.T @ modes, np.eye(2 + N_MODES), atol=1e-9)


def test_modes_that_the_first_block_does_not_see_are_missed_and_then_found(
    twins: tuple, monkeypatch: pytest.MonkeyPatch
) -> None:
    mass, stiffness, exact, start = twins
    true, counts = BlockLanczos._waves, []
    monkeypatch.setattr(BlockLanczos, "_waves", lambda self, attempt: true(self, attempt) * (attempt > 0))

    def count(tau: float) -> int:
        counts.append(tau)
        return int((exact < tau).sum())

    solver = lanczos(mass, stiffness, start)
    values, _ = solver.solve(2, N_MODES, count, "here")
    assert len(counts) == 2, "the second chain was not hidden"
    np.testing.assert_allclose(values, exact[: 2 + N_MODES], rtol=1e-10, atol=1e-10 * exact[2])


def test_modes_that_stay_missing_are_an_error(twins: tuple) -> None:
    mass, stiffness, exact, start = twins
    with pytest.raises(RunError, match="^eigenproblem at here: 99 eigenvalues lie below .* but [789] were found$"):
        lanczos(mass, stiffness, start).solve(2, N_MODES, lambda tau: 99, "here")


def test_too_few_rounds_are_an_error(twins: tuple, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(body_problem, "MAX_ROUNDS", 1)
    mass, stiffness, _, start = twins
    with pytest.raises(RunError, match="^eigenproblem at here: . of 27 eigenpairs converged in 1 rounds with the tol"):
        lanczos(mass, stiffness, start).solve(2, 25, lambda tau: 0, "here")


@pytest.mark.parametrize("n_modes", [2, 3, 5])
def test_modes_of_one_frequency_are_kept_whichever_way_the_solver_turned_them(n_modes: int) -> None:
    """A round bar bends about two axes alike; a basis that ended between them moved runs by 8e-5 from processor to
    processor."""
    random = np.random.default_rng(4)
    values = np.array([0.0, 0.0, 0.0, 1.0, 2.0, 2.0, 3.0, 4.0, 4.0, 5.0, 6.0])
    vectors, loads = np.linalg.qr(random.normal(size=(11, 11)))[0], random.normal(size=(11, 2))
    turned = vectors.copy()
    cos, sin = np.cos(0.7), np.sin(0.7)
    for pair in ([4, 5], [7, 8]):
        turned[:, pair] = vectors[:, pair] @ [[cos, -sin], [sin, cos]]
    spans = []
    for modes in (vectors, turned):
        fields = _answering(values, modes, loads, 3, n_modes, by_energy=False)
        spans.append(fields @ np.linalg.pinv(fields))
    np.testing.assert_allclose(spans[1], spans[0], atol=1e-12)
