"""What a program's result file holds, without reading its arrays."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pgmp_petsc.api.arguments import checked
from pgmp_petsc.api.ranks import ranks_of
from pgmp_petsc.runtime.agreement import on_root

if TYPE_CHECKING:
    import h5py
    from mpi4py import MPI

    from pgmp_petsc.results import EffectSizes, Selection
    from pgmp_petsc.runtime.files import RunRecord


class DataSet(NamedTuple):
    """A data set: its shape, unit ("" where none is given), and what it is."""

    shape: tuple[int, ...]
    unit: str
    description: str


@dataclass(frozen=True)
class Contents:
    """What is in a result file.

    Attributes
    ----------
    path, kind
        The file, and one of `runtime.claims.KINDS`.
    model
        Of runs; empty where the file is of none.
    program_version, format_version
        What wrote it.
    record
        Where it comes from: scene, parameters, seed, ranks, timings, remarks.
    selection, sizes
        What was chosen for tolerances, and effects by their size; None where nothing was.
    datasets
        By their names, in the file's order.
    """

    path: Path
    kind: str
    model: str
    program_version: str
    format_version: int
    record: RunRecord
    selection: Selection | None
    sizes: EffectSizes | None
    datasets: dict[str, DataSet]

    def summary(self) -> dict[str, Any]:
        """Return its figures as plain data, those of ``pgmp info --json``; reads the result's own.

        Raises
        ------
        InputError
            If it is no whole result of this program.
        """
        from pgmp_petsc.results.readers import READERS
        from pgmp_petsc.results.summary import origin_of, plain, summary_of

        about = {"file": self.path, "kind": self.kind, "program_version": self.program_version}
        about |= origin_of(self.record)
        about["chosen"] = None if self.selection is None else self.selection.chosen
        about["datasets"] = {
            name: {"shape": list(one.shape), "unit": one.unit, "description": one.description}
            for name, one in self.datasets.items()
        }
        if self.kind in READERS:
            about |= summary_of(READERS[self.kind].read(self.path))
        return plain(about)

    @property
    def scene(self) -> dict[str, Any]:
        """The tables of the scene that it was made from."""
        return tomllib.loads(self.record.scene_toml)


@checked
def contents(path: str | PathLike[str], *, comm: MPI.Comm | None = None) -> Contents:
    """Return what a result file of any kind holds, as ``pgmp info``. Collective on `comm`.

    Raises
    ------
    InputError
        If it is no whole result of this program.
    """
    comm = ranks_of(comm)
    return on_root(comm, _read, Path(path))


def _read(path: Path) -> Contents:
    from pgmp_petsc.results import EffectSizes, Selection
    from pgmp_petsc.runtime.files import KINDS, RunRecord, open_file, shapes_of

    with open_file(path, KINDS) as file, shapes_of(file):
        return Contents(
            path,
            str(file.attrs["kind"]),
            str(file.attrs.get("model", "")),
            str(file.attrs["program_version"]),
            int(file.attrs["format_version"]),
            RunRecord.read(file),
            Selection.found_in(file),
            EffectSizes.found_in(file),
            _datasets(file),
        )


def _datasets(file: h5py.File) -> dict[str, DataSet]:
    import h5py

    found = {}

    def visit(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset):
            unit, about = (str(item.attrs.get(key, "")) for key in ("unit", "description"))
            found[f"/{name}"] = DataSet(tuple(item.shape), unit, about)

    file.visititems(visit)
    return found
