"""Block Lanczos of a free body: modes that the first block cannot see, and what is said where some stay missing."""

from collections.abc import Iterator

import numpy as np
import petsc4py
import pytest
import scipy.linalg

petsc4py.init([])

from mpi4py import MPI  # noqa: E402
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
