"""Leave a stepper written in Python to a cycle of references, and end as a command does or at once: ``closed|open``."""

import sys

from mpi4py import MPI
from petsc4py import PETSc

from pgmp_petsc.ranks.ending import release_petsc


class Stepper:
    """Keeps what PETSc hands to it in a cycle, as the frames of an exception do."""

    def solveStep(self, *handed: PETSc.Object) -> None:  # noqa: N802 (called by PETSc)
        cycle = list(handed)
        cycle.append(cycle)


def integrate() -> None:
    """Take one step."""
    ts = PETSc.TS().create(comm=MPI.COMM_SELF)
    ts.setType(PETSc.TS.Type.PYTHON)
    ts.setPythonContext(Stepper())
    ts.setMaxSteps(1)
    ts.setExactFinalTime(PETSc.TS.ExactFinalTime.STEPOVER)
    ts.solve(PETSc.Vec().createSeq(1))
    ts.destroy()


def main(ending: str) -> None:
    integrate()
    if ending == "closed":
        release_petsc(MPI.COMM_WORLD)


if __name__ == "__main__":
    main(sys.argv[1])
