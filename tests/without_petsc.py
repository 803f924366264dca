"""Runs ``pgmp``, or another module, as in a Python without PETSc, SLEPc and MPI: the packages are refused.

python tests/without_petsc.py pgmp simulate ROM.h5 -o FILE.h5
python tests/without_petsc.py script.py ARGUMENTS
"""

from __future__ import annotations

import runpy
import sys
from collections.abc import Sequence

REFUSED = ("petsc4py", "slepc4py", "mpi4py")


class Refusing:
    """A finder of modules, the first that is asked."""

    def find_spec(self, name: str, path: Sequence[str] | None = None, target: object = None) -> None:
        """Refuse what is not to be found; let the next finder look for the rest."""
        if name.partition(".")[0] in REFUSED:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


if __name__ == "__main__":
    sys.meta_path.insert(0, Refusing())
    del sys.argv[0]
    if sys.argv[0] == "pgmp":
        from pgmp_petsc.cli.main import main

        main()
    runpy.run_path(sys.argv[0], run_name="__main__")
