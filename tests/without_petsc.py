"""Runs a program as in a Python without PETSc, SLEPc and MPI: these packages are refused.

python tests/without_petsc.py -m pgmp_petsc.cli.main simulate ROM.h5 -o FILE.h5
python tests/without_petsc.py -c CODE ARGUMENTS
REFUSED=petsc4py,slepc4py mpirun -n 2 python tests/without_petsc.py -m ...      MPI is there
"""

import os
import runpy
import sys
from collections.abc import Sequence

REFUSED = os.environ.get("REFUSED", "petsc4py,slepc4py,mpi4py").split(",")


class Refusing:
    """A finder of modules, the first that is asked."""

    def find_spec(self, name: str, path: Sequence[str] | None = None, target: object = None) -> None:
        """Refuse what is not to be found; let the next finder look for the rest."""
        if name.partition(".")[0] in REFUSED:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


if __name__ == "__main__":
    sys.meta_path.insert(0, Refusing())
    kind, program = sys.argv[1:3]
    sys.path[0], sys.argv = "", [kind, *sys.argv[3:]]
    if kind == "-m":
        runpy.run_module(program, run_name="__main__", alter_sys=True)
    else:
        exec(program, {"__name__": "__main__"})  # as the interpreter does
