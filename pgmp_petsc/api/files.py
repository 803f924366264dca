"""Result files that a program reads, and what they hold, in words and without reading their arrays."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import h5py

from pgmp_petsc.api.declared import Argument, command, interface
from pgmp_petsc.api.ranks import ranks_of, solving_ranks_of
from pgmp_petsc.api.result import Result, Rom, in_memory
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.files.hdf5 import KINDS, RunRecord, open_file, shapes_of
from pgmp_petsc.ranks.agreement import on_root
from pgmp_petsc.results import EffectSizes, Selection
from pgmp_petsc.results.summary import origin_of, plain, summary_of


@interface(path=Argument("File of a result of any kind but a shard."))
def read(path: str | PathLike[str], *, comm: Comm | None = None) -> Result:
    """Read a result file: a `Rom`, or a `Result`; raises `InputError` if it is no whole result of this program."""
    comm, path = ranks_of(comm), Path(path)
    kind = on_root(comm, _kind_of, path)
    if kind == "rom":
        # its modules need PETSc, which all ranks start together
        solving_ranks_of(comm)
    data = on_root(comm, _read, path, kind)
    return (Rom if kind == "rom" else Result)(kind, data, comm, path.parent, path)


def stopped_runs(*paths: Path) -> list[str]:
    """Return a line for every file that holds only a part of a run, saying why; by one process."""
    lines = []
    for path in paths:
        with open_file(path, KINDS) as file:
            if file.attrs.get("status", 0):
                lines += [f"{path}: {remark}" for remark in RunRecord.read(file).remarks[:1]]
    return lines


def _kind_of(path: Path) -> str:
    from pgmp_petsc.results import READERS  # all kinds of results

    with open_file(path, ("rom", *READERS)) as file:
        return str(file.attrs["kind"])


def _read(path: Path, kind: str) -> Any:
    if kind != "rom":
        from pgmp_petsc.results import READERS

        return in_memory(READERS[kind].read(path))
    from pgmp_petsc.studies.building import Built

    return Built.read(path)


class DataSet(NamedTuple):
    """A data set: its shape, unit ("" where none is given), and what it is."""

    shape: tuple[int, ...]
    unit: str
    description: str


@dataclass(frozen=True)
class Contents:
    """Contents of a result file."""

    #: path, kind: the file, and one of `files.claims.KINDS`
    path: Path
    kind: str
    model: str  # of runs; empty where the file is of none
    #: program_version, format_version: what wrote it
    program_version: str
    format_version: int
    record: RunRecord  # where it comes from: scene, parameters, seed, ranks, timings, remarks
    #: selection, sizes: what was chosen for tolerances, and effects by their size; None where nothing was
    selection: Selection | None
    sizes: EffectSizes | None
    datasets: dict[str, DataSet]  # by their names, in the file's order

    def summary(self) -> dict[str, Any]:
        """Return its figures as plain data, those of ``pgmp info --json``; reads the result's own.

        Raises `InputError` if it is no whole result of this program.
        """
        from pgmp_petsc.results import READERS

        about = {"file": self.path, "kind": self.kind, "program_version": self.program_version}
        about |= origin_of(self.record)
        about["chosen"] = None if self.selection is None else self.selection.chosen
        about["datasets"] = {name: one._asdict() for name, one in self.datasets.items()}
        if self.kind in READERS:
            about |= summary_of(READERS[self.kind].read(self.path))
        return plain(about)

    @property
    def scene(self) -> dict[str, Any]:
        """The tables of the scene that it was made from."""
        return tomllib.loads(self.record.scene_toml)


def _contents(path: Path) -> Contents:
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
            _all_datasets(file),
        )


def _all_datasets(file: h5py.File) -> dict[str, DataSet]:
    found = {}

    def visit(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset):
            found[f"/{name}"] = DataSet(item.shape, *(str(item.attrs.get(key, "")) for key in DataSet._fields[1:]))

    file.visititems(visit)
    return found


def describe(found: Contents, path: Path | None = None, said: object = (), scene: bool = False) -> str:
    """Return the description of a result file of any kind; by one process.

    Raises `InputError` if what it holds does not fit together.
    """
    if scene:
        return found.record.scene_toml.rstrip()
    record, path = found.record, found.path
    parameters = ", ".join(f"{name} = {value:g}" for name, value in record.parameters.items())
    lines = [
        f"{path}: {KINDS[found.kind]}" + (f" of the {found.model} model" if found.model else ""),
        f"written    {datetime.fromtimestamp(os.path.getmtime(path)):%Y-%m-%d %H:%M}"
        f" by pgmp {found.program_version}, format {found.format_version}",
        f"scene      {origin_of(record)['scene'] or 'without a name'}",
        f"parameters {parameters or 'none'}",
        f"seed       {'none' if record.seed is None else record.seed}",
        f"ranks      {record.ranks}",
    ]
    with shapes_of(path):
        parts = [
            [f"  {remark}" for remark in record.remarks],
            [] if found.selection is None else found.selection.lines(),
            [] if found.sizes is None else ["effects, chosen by their size", *found.sizes.lines()],
            ["timings", _indented(Timings(record.timings).table())] if record.timings else [],
            ["datasets", _indented(_datasets(found))],
            _estimates(found),
        ]
    return "\n".join([*lines, *(line for part in parts if part for line in ("", *part))])


def _estimates(found: Contents) -> list[str]:
    """Return the figures of an ensemble, estimated errors, validity, and its balance of energy; a remark says what is
    not there."""
    from pgmp_petsc.results import Ensemble, RareEvent, Tradeoff, Trajectory
    from pgmp_petsc.texts import ensemble_table, models, studies

    path = found.path
    if found.kind == "ensemble":
        ensemble = Ensemble.read(path)
        of_errors = models.of_ensemble(ensemble)
        return [*ensemble_table.lines_of(ensemble), *of_errors, *models.of_balance(ensemble)]
    if found.kind == "rare_event":
        return ensemble_table.lines_of_rare_event(RareEvent.read(path))
    if found.kind in ("sensitivities", "fit", "design"):
        return studies.lines_of_file(path, found.kind)
    if found.kind == "tradeoff":
        return ["summary", _indented(studies.summary(Tradeoff.read(path)))]
    known = ("/validity/", "/errors/")
    if found.kind != "trajectory" or not any(name.startswith(known) for name in found.datasets):
        return []
    return models.of_run(Trajectory.read(path))


def _datasets(found: Contents) -> str:
    """Return one line a dataset: name, shape, unit, description; a numbered series (frames) is one line."""
    rows: list[tuple[str, str, str, str]] = []
    for full_name, data in found.datasets.items():
        name = full_name.removeprefix("/")
        if name.startswith("timings/"):
            continue
        series, number, rest = _of_lengths(name)
        if number:
            continue
        name = f"{series}/<models of all lengths>/{rest}" if series else name
        group, _, last = name.rpartition("/")
        description = data.description
        if last.isdigit():
            if int(last) > 0:
                continue
            n_frames = sum(other.rpartition("/")[0] == full_name.rpartition("/")[0] for other in found.datasets)
            name, description = f"{group}/<{n_frames} frames>", description.replace(" at 0 s", "")
        shape = " x ".join(str(length) for length in data.shape) or "scalar"
        rows.append((f"/{name}", shape, data.unit, description))
    widths = [max((len(row[column]) for row in rows), default=0) for column in range(3)]
    padded = [[f"{text:<{width}}" for text, width in zip(row, [*widths, 0])] for row in rows]
    return "\n".join("  ".join(row).rstrip() for row in padded)


def _of_lengths(name: str) -> tuple[str, int, str]:
    """Return the group of models of several lengths that a data set is in, the number of its model, and its name there;
    nothing where it is in none."""
    group, _, inside = name.partition("/")
    number, _, rest = inside.partition("/")
    return (group, int(number), rest) if group == "lengths" and number.isdigit() else ("", 0, "")


def _indented(text: str) -> str:
    return "\n".join(f"  {line}" for line in text.splitlines())


def _figures(found: Contents, scene: bool) -> Mapping[str, object]:
    return found.scene if scene else found.summary()


@command(
    "info", "Say what a result file holds.", 170, petsc=False, report=describe, figures=_figures,
    path=Argument("Result file of any kind.", word="FILE"),
    shell={"scene": Argument("Print the scene that the file was made from, as TOML.")},
)  # fmt: skip
def contents(path: str | PathLike[str], *, comm: Comm | None = None) -> Contents:
    """Say what `path` holds: its origin, parameters, timings and datasets."""
    return on_root(ranks_of(comm), _contents, Path(path))
