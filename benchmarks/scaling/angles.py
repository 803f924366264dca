"""Time of an eigenproblem and its static answers at one angle, with LAPACK and with SLEPc, over the size of the mesh.

    python -m benchmarks.scaling.angles scenes/slider_crank.toml

Every beam of the scene becomes a line of as many elements. Both pencils of `pgmp_petsc.modes` take the same angles in
turns; the medians are compared. Where LAPACK's becomes the slower one is `modes.pencils.MOST_UNKNOWNS`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter

import numpy as np
from mpi4py import MPI

from benchmarks.programs import end, guarded
from benchmarks.scaling.fine_beams import refined
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.modes import problem as problems
from pgmp_petsc.modes.pencils import MOST_UNKNOWNS
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.ranks.petsc import start_petsc
from pgmp_petsc.scene.schema import Scene

ELEMENTS = (5, 10, 20, 30, 40, 60)
N_ANGLES = 24


@contextmanager
def dense_up_to(n_unknowns: int) -> Iterator[None]:
    """Let LAPACK take the problems of as many unknowns."""
    problems.MOST_UNKNOWNS = n_unknowns
    try:
        yield
    finally:
        problems.MOST_UNKNOWNS = MOST_UNKNOWNS


def times(scene: Scene, kinematics: RigidKinematics) -> tuple[int, np.ndarray]:
    """Return the number of unknowns and the medians of both pencils, LAPACK's first, shape (2,), s an angle."""
    opened = []
    for most in (np.inf, 0):
        with dense_up_to(most):
            opened.append(ModalProblem(kinematics, scene.nominal, scene.reduction.modes, MPI.COMM_SELF))
    coordinate = kinematics.coordinate
    loads = np.random.default_rng(1).normal(size=(kinematics.mechanism.n_dofs, scene.reduction.modes))
    found = np.empty((N_ANGLES, 2))
    for row, share in enumerate((np.arange(N_ANGLES) + 0.3) / N_ANGLES):
        theta = coordinate.lower + share * (coordinate.upper - coordinate.lower)
        for column, problem in enumerate(opened):
            start = perf_counter()
            problem.static_answers(problem.solve(theta).eigenvectors, loads)
            found[row, column] = perf_counter() - start
    for problem in opened:
        problem.close()
    return kinematics.mechanism.n_dofs, np.median(found, axis=0)


def run(path: Path) -> None:
    """Measure a scene of one coordinate and print one line a mesh."""
    for n_elements in ELEMENTS:
        n_dofs, (dense, sparse) = times(*refined(path, n_elements, MPI.COMM_SELF))
        print(
            f"{n_elements:3d} elements a body, {n_dofs:4d} unknowns: LAPACK {1e3 * dense:6.2f} ms an angle, "
            f"SLEPc {1e3 * sparse:6.2f} ms, ratio {sparse / dense:.2f}",
            flush=True,
        )


def main() -> int:
    """Measure the scene on the command line."""
    parser = argparse.ArgumentParser(prog="benchmarks.scaling.angles", description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path)
    arguments = parser.parse_args()
    start_petsc()
    return guarded(lambda: run(arguments.scene))


if __name__ == "__main__":
    end(main())
