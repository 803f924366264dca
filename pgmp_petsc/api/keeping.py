"""The file of a result, which is claimed before long work and written after it, and the ranks that get the result."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pgmp_petsc.api.ranks import RESULT, tell, tell_remarks
from pgmp_petsc.api.result import Result, Rom, in_memory
from pgmp_petsc.runtime.agreement import on_root
from pgmp_petsc.runtime.claims import check_folder, claimed, form_of, is_table
from pgmp_petsc.runtime.errors import Remark

if TYPE_CHECKING:
    from mpi4py import MPI


@dataclass(frozen=True)
class Keeper:
    """Destination of a result: its file, its picture, and the ranks that get it."""

    kind: str  # of the result
    comm: MPI.Comm  # the ranks that make it
    #: output, target: its file as it was named, and with its full path; None where there is none
    output: Path | None
    target: Path | None
    on_all_ranks: bool  # whether all ranks get it; else the first alone, whose columns may stay in a file
    plot: Path | None = None  # folder for its picture; None where there is none

    def result(self, data: Any, directory: Path, said: Sequence[Remark] = ()) -> Result:
        """Return the result of what the first rank has, written where that is asked for. Collective on `comm`.

        Its remarks are printed, except those in `said`, which were printed before.

        Raises
        ------
        RunError
            If the system fails to write.
        """

        def writing_the_result() -> None:
            from pgmp_petsc.results.summary import write_result  # loads h5py, which without a file nobody needs

            write_result(data, self.output)

        def handing_out_the_result() -> Any:
            return in_memory(data)

        def drawing_the_result() -> str:
            from pgmp_petsc.figures.collection import draw_result  # matplotlib takes a noticeable time

            return draw_result(data, self.plot)

        if self.output is not None:
            on_root(self.comm, writing_the_result)
        if self.plot is not None:
            tell(self.comm, on_root(self.comm, drawing_the_result))
        if self.on_all_ranks:
            data = on_root(self.comm, handing_out_the_result)
        elif self.comm.rank > 0:
            data = None
        # of a table nothing can be read again
        path = None if self.target is None or is_table(self.target) else self.target
        found = (Rom if self.kind == "rom" else Result)(self.kind, data, self.comm, directory, path)
        if data is not None:
            tell_remarks(self.comm, (remark for remark in found.remarks if remark not in said), RESULT)
        return found


@contextmanager
def keeping(
    kind: str,
    comm: MPI.Comm,
    output: str | PathLike[str] | None,
    on_all_ranks: bool,
    inputs: Iterable[str | PathLike[str] | None] = (),
    plot: str | PathLike[str] | None = None,
) -> Iterator[Keeper]:
    """Claim the file of a result, and yield what keeps it. Collective on `comm`.

    Raises
    ------
    InputError
        If the file cannot be written, may not be replaced, or is one of the `inputs`; or the folder for the picture
        cannot be made.
    """
    own, folder = (None if path is None else Path(path) for path in (output, plot))
    if folder is not None:
        on_root(comm, check_folder, folder, own)
    if own is None:
        yield Keeper(kind, comm, None, None, on_all_ranks, folder)
        return
    with claimed(comm, own, form_of(own, kind), inputs) as target:
        yield Keeper(kind, comm, own, target, on_all_ranks, folder)
