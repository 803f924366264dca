"""Run cases of agreement between ranks and print what each saw. Used by test_groups.py."""

import sys

from mpi4py import MPI

from pgmp_petsc.base.errors import InputError, PgmpError, RunError
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.ranks.agreement import agreed, on_root


class LocatedError(RunError):
    """Needs two arguments, so it does not survive pickling."""

    def __init__(self, message: str, place: float) -> None:
        super().__init__(f"{message} at {place}")


def fail_with(error: Exception) -> None:
    raise error


def run(case: str, comm: MPI.Comm) -> object:
    last = comm.size - 1
    if case == "fine":
        with agreed(comm, "nothing"):
            pass
        return "fine"
    if case == "one":
        with agreed(comm, "reading"):
            if comm.rank == last:
                raise InputError("bodies.rod.mesh: no such file")
    if case == "several":
        with agreed(comm, "reading"):
            if comm.rank >= min(1, last):
                raise RunError(f"failed on {comm.rank}")
    if case == "unexpected":
        with agreed(comm, "eigenproblem 7"):
            if comm.rank == last:
                fail_with(ZeroDivisionError("oops"))
    if case == "unpicklable":
        with agreed(comm, "stepping"):
            if comm.rank == last:
                raise LocatedError("diverged", 0.5)
    if case == "root":
        return on_root(comm, sorted, [3, 1, 2])
    if case == "root_fails":
        return on_root(comm, fail_with, InputError("missing"))
    if case == "root_unpicklable":
        return type(on_root(comm, lambda: lambda: None)).__name__
    if case == "timings":
        timings = Timings({"all": 1.0 + comm.rank, f"only {comm.rank}": 0.5})
        return sorted(timings.maximum(comm).as_dict().items())
    return "no such case"


def main(case: str) -> None:
    """Print one line a rank: what the case returned or raised there."""
    comm = MPI.COMM_WORLD
    try:
        outcome = f"returned {run(case, comm)}"
    except PgmpError as error:
        outcome = f"raised {type(error).__name__} {error.exit_status}: {error}"
    for line in comm.gather(outcome, root=0) or ():
        print(case, line)


if __name__ == "__main__":
    for asked in sys.argv[1:]:
        main(asked)
