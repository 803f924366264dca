"""A linear solve of the distributed model that fails is a record of its sample, and the sample is tried again."""

from collections.abc import Iterator

import numpy as np
import pytest
from petsc4py import PETSc

from pgmp_petsc.ensemble.integration import run_batch
from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.full.distributed import FullDistributed
from pgmp_petsc.full.rank_solver import RankLayout, RankSolver
from pgmp_petsc.models import FullModel
from pgmp_petsc.stepping.status import Status
from scenes import meshes_of, slider_crank

SHORT = ("simulation.duration=0.003", "simulation.step=1e-3")
DRAWN = 'parameters.r1.distribution={name="norm", loc=5.6e-3, scale=1e-4}'


class OneByOne(FullModel):
    """Samples one by one in the distributed model, as those of large meshes are."""

    largest_batch = 1

    def batch(self, values: dict[str, np.ndarray], n_samples: int) -> FullDistributed:
        return self.distributed({name: float(value[0]) for name, value in values.items()}, PETSc.COMM_SELF.tompi4py())


@pytest.fixture
def model() -> FullModel:
    scene = slider_crank(*SHORT, DRAWN)
    return OneByOne(scene, meshes_of(scene))


@pytest.fixture
def weak_solver() -> Iterator[None]:
    """Let GMRES have one iteration without a preconditioner."""
    entries = {"ksp_type": "gmres", "pc_type": "none", "ksp_max_it": "1"}
    options = PETSc.Options("pgmp_full_")
    for name, value in entries.items():
        options.setValue(name, value)
    yield
    for name in (*entries, "ksp_error_if_not_converged"):
        options.delValue(name)


@pytest.mark.parametrize("raises", [False, True])
def test_a_solver_that_fails_is_a_status(model: FullModel, weak_solver: None, raises: bool) -> None:
    """By a negative reason of PETSc, or by an error of PETSc."""
    if raises:
        PETSc.Options("pgmp_full_").setValue("ksp_error_if_not_converged", "1")
    batch = run_batch(model, draw(model.scene, 0, 0, 1))
    assert batch.status[0] == Status.SOLVER_FAILED
    assert batch.failure_time[0] > 0.0 and batch.numerics["steps_divided"][0] == 8
    assert all(np.isnan(values).all() for values in batch.outputs.values())


def test_a_sample_whose_solver_failed_is_tried_again(model: FullModel, monkeypatch: pytest.MonkeyPatch) -> None:
    solve, calls = RankSolver.solve, []

    def fails_at_first(self: RankSolver, rhs: np.ndarray) -> np.ndarray | None:
        calls.append(0)
        # the first is for the start; then one for each of the three ways to take two steps to begin with, and the first
        found = solve(self, rhs)
        return None if 1 < len(calls) <= 10 else found

    monkeypatch.setattr(RankSolver, "solve", fails_at_first)
    batch = run_batch(model, draw(model.scene, 0, 0, 1))
    assert batch.status[0] == Status.FINE and batch.numerics["steps_divided"][0] == 2
    assert all(np.isfinite(values).all() for values in batch.outputs.values())


def test_a_matrix_after_one_that_cannot_be_factorised_is_solved() -> None:
    """PETSc passes over every matrix after an error of MUMPS until its factors are forgotten."""
    places, none = np.arange(2), np.zeros(1)
    layout = RankLayout(2, 2, (np.array([0, 1, 1]), np.array([0, 0, 1])))
    solver = RankSolver(layout, places, places, PETSc.COMM_SELF.tompi4py())
    rhs = np.array([2.0, 1.0])
    for diagonal in (np.zeros(2), np.array([2.0, 4.0]), np.array([np.nan, 1.0]), np.zeros(2), np.array([2.0, 4.0])):
        solver.assemble(diagonal, none)
        found = solver.solve(rhs)
        if diagonal[0] == 2.0:
            np.testing.assert_array_equal(found, rhs / diagonal)
        else:
            assert found is None
    solver.close()
