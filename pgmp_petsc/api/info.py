"""What a result file holds, in words."""

from __future__ import annotations

import os
from collections.abc import Mapping
from datetime import datetime
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from pgmp_petsc.api.contents import Contents, contents as read_contents
from pgmp_petsc.api.declared import Argument, command
from pgmp_petsc.runtime.files import KINDS, shapes_of

if TYPE_CHECKING:
    from mpi4py import MPI


def describe(found: Contents, path: Path | None = None, said: object = (), scene: bool = False) -> str:
    """Return the description of a result file of any kind; by one process.

    Raises
    ------
    InputError
        If what it holds does not fit together.
    """
    if scene:
        return found.record.scene_toml.rstrip()
    from pgmp_petsc.results.summary import origin_of
    from pgmp_petsc.runtime.timings import Timings

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
        if record.remarks:
            lines += ["", *(f"  {remark}" for remark in record.remarks)]
        if found.selection is not None:
            lines += ["", *found.selection.lines()]
        if found.sizes is not None:
            lines += ["", "effects, chosen by their size", *found.sizes.lines()]
        if record.timings:
            lines += ["", "timings", _indented(Timings(record.timings).table())]
        lines += ["", "datasets", _indented(_datasets(found))]
        known = _estimates(found)
        if known:
            lines += ["", *known]
        if found.kind == "tradeoff":
            lines += ["", "summary", _indented(_tradeoff(path))]
    return "\n".join(lines)


def _estimates(found: Contents) -> list[str]:
    """Return the figures of an ensemble, estimated errors, validity, and its balance of energy; a remark says what is
    not there."""
    from pgmp_petsc.texts import ensemble_table, estimates
    from pgmp_petsc.results import Ensemble, Trajectory

    path = found.path
    if found.kind == "ensemble":
        ensemble = Ensemble.read(path)
        of_errors = estimates.of_ensemble(ensemble)
        return [*ensemble_table.lines_of(ensemble), *of_errors, *estimates.of_balance(ensemble)]
    if found.kind == "rare_event":
        from pgmp_petsc.results.rare_event import RareEvent

        return ensemble_table.lines_of_rare_event(RareEvent.read(path))
    if found.kind in ("sensitivities", "fit", "design"):
        from pgmp_petsc.texts.gradient_tables import lines_of_file

        return lines_of_file(path, found.kind)
    known = ("/validity/", "/errors/")
    if found.kind != "trajectory" or not any(name.startswith(known) for name in found.datasets):
        return []
    return estimates.of_run(Trajectory.read(path))


def _tradeoff(path: Path) -> str:
    """Return the table and the advice of a trade-off study."""
    from pgmp_petsc.texts.tradeoff_table import summary
    from pgmp_petsc.results.tradeoff import Tradeoff

    return summary(Tradeoff.read(path))


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
    """Indent every line by two spaces."""
    return "\n".join(f"  {line}" for line in text.splitlines())


def _figures(found: Contents, scene: bool) -> Mapping[str, object]:
    return found.scene if scene else found.summary()


@command(
    "info", "Say what a result file holds.", 170, petsc=False, report=describe, figures=_figures,
    path=Argument("Result file of any kind.", word="FILE"),
    shell={"scene": Argument("Print the scene that the file was made from, as TOML.")},
)  # fmt: skip
def contents(path: str | PathLike[str], *, comm: MPI.Comm | None = None) -> Contents:
    """Say what `path` holds: its origin, parameters, timings and datasets."""
    return read_contents(path, comm=comm)
