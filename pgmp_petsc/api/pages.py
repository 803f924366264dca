"""Results of a program as one page."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from pgmp_petsc.api.arguments import checked, wrong
from pgmp_petsc.api.ranks import ranks_of, tell
from pgmp_petsc.api.result import Result
from pgmp_petsc.runtime.agreement import agreed, on_root

if TYPE_CHECKING:
    from mpi4py import MPI


@checked
def write_report(
    results: Sequence[Result | str | PathLike[str]], path: str | PathLike[str], *, comm: MPI.Comm | None = None
) -> Path:
    """Write results as one page that needs no network, as ``pgmp report``, and return its path. Collective on `comm`.

    Parameters
    ----------
    results
        Results, or names of their files: trajectories, ensembles, trade-off studies and reduced models. A page names
        the files that it is of: results that were not written are written beside it, as
        ``<page>_<kind>_<number>.h5``.
    path
        The page.

    Raises
    ------
    InputError
        If one of them is none that a page shows, or the page cannot be made there.
    RunError
        If the system fails to write.
    """
    comm = ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        if not results:
            raise wrong("results", results, "a list of results or of names of files, and not an empty one")
    path, files = Path(path), []
    for number, result in enumerate(results, 1):
        if not isinstance(result, Result):
            files.append(Path(result))
        else:
            files.append(result.path or result.write(path.with_name(f"{path.stem}_{result.kind}_{number}.h5")))

    def writing_the_page() -> list[str]:
        from pgmp_petsc.report.page import write_report as write

        return write(files, path)

    for line in on_root(comm, writing_the_page):
        tell(comm, line)
    return path
