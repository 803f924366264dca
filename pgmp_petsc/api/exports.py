"""Results for ParaView and as tables, and models for other programs."""

from __future__ import annotations

import shlex
import tomllib
from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from pgmp_petsc.api.arguments import Range
from pgmp_petsc.api.declared import Argument, command, interface
from pgmp_petsc.api.files import kind_in, stopped_runs
from pgmp_petsc.api.ranks import ranks_of, tell, tell_remarks
from pgmp_petsc.api.result import Result, Rom, file_of
from pgmp_petsc.api.scenes import Overrides, Parameters
from pgmp_petsc.api.sources import Origin, kind_of
from pgmp_petsc.base.errors import InputError, counted
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.c_export import constants
from pgmp_petsc.c_export.fmu import VERSIONS, write_fmu
from pgmp_petsc.c_export.source import write_sources
from pgmp_petsc.c_export.tree import tree_constants_of
from pgmp_petsc.files.claims import TABLE, TABULAR, check_output, is_table, named
from pgmp_petsc.files.hdf5 import open_file
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.results.summary import columns_of, write_result
from pgmp_petsc.results.trajectory import GROUP, truncated, write_xdmf
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.units import values_text

FMU, XDMF = ".fmu", (".xdmf", ".xmf")
LEFT_OUT = "note: elastic strain, change of stiffness, error estimates and energies are not in it; see pgmp simulate"


OUTPUT = Argument(
    "File or folder to write; it replaces an older one when it is complete.", "-o --output", "FILE", required=True
)


@interface(
    rom=Argument("Reduced or component model, or its file.", word="MODEL.h5"),
    output=OUTPUT,
    fmi=Argument("Version of FMI of an FMU, 2 (default) or 3.", word="N", allowed=Range(min(VERSIONS), max(VERSIONS))),
)
def export_model(
    rom: Rom | str | PathLike[str],
    output: str | PathLike[str],
    *,
    fmi: int | None = None,
    parameters: Parameters | None = None,
    overrides: Overrides = (),
    comm: Comm | None = None,
) -> Path:
    """Write the reduced or component model `rom` for other programs, and return where.

    `output` is a folder of C99, whose name has no ending, or ``NAME.fmu``.
    """
    comm = ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        _check(output, fmi)
    origin = Origin.of(comm, rom, None, overrides, parameters)
    kind = "tree" if origin.model == "components" else "reduced"
    target = Path(output)
    notes: list[str] = []

    def without_what_is_left_out(scene: Scene) -> Scene:
        notes.append(constants.left_out(scene))
        return constants.checked_scene(scene, str(target))

    model = origin.prepared(comm, without_what_is_left_out, told=False)

    def writing_the_model() -> str:
        made = (tree_constants_of if kind == "tree" else constants.constants_of)(model, str(target))
        if target.suffix.lower() != FMU:
            return f"{target}: C99, {write_sources(made, target) / 1e6:.1f} MB"
        version = fmi or VERSIONS[0]
        kinds = "co-simulation and model exchange" if made.exchanges else "co-simulation"
        platform, what = write_fmu(made, target, version), f"FMI {version}.0, {kinds}"
        if platform:
            return f"{target}: {what}, sources and a library for {platform}"
        why = "no C compiler (cc, gcc), or no x86-64 Linux"
        return f"{target}: {what}, sources only: {why}; compile sources/ where it is to run"

    tell(comm, on_root(comm, writing_the_model))
    most = f"at most {constants.MOST_CORRECTIONS}"
    corrections = f"{constants.CORRECTIONS} Newton corrections each, {most} where that is not enough"
    if kind == "tree":
        corrections = f"as many Newton corrections as pgmp simulate does, {most}"
    steps = f"steps of {model.scene.simulation.step:g} s, {corrections}"
    scene, variable = model.scene, constants.tunable(model.scene)
    tell(comm, f"  {steps}; tunable: {', '.join(variable) or 'no parameters'}")
    fixed = values_text(scene, {name: value for name, value in scene.values.items() if name not in variable})
    if fixed:
        tell(comm, f"  note: {fixed}: the model is made with it; export once more with another --set")
    for note in (*filter(None, (*notes, constants.started(model))), LEFT_OUT):
        tell(comm, f"  {note}")
    tell_remarks(comm, scene.remarks)
    return target


def _check(output: str | PathLike[str], fmi: int | None) -> None:
    """Refuse names that are neither of a folder nor of an FMU."""
    target = Path(output)
    is_fmu = target.suffix.lower() == FMU
    if target.suffix and not is_fmu:
        folder = f"a folder of C99, whose name has no ending (-o {target.with_suffix('')}/)"
        fmu = f"an FMU (-o {target.with_suffix(FMU)})"
        raise InputError(f"output '{target}': a model is exported as {folder}, or as {fmu}")
    if fmi is not None and not is_fmu:
        raise InputError(f"--fmi {fmi} is for FMUs, and '{target}' is none; name an FMU, -o NAME{FMU}, or leave it out")


def _chosen(given: Mapping[str, Any], comm: Comm) -> Callable[..., Path]:
    """Return which of the two functions writes; refuse options of the other. Collective on `comm`."""
    output = given["output"]
    suffix = output.suffix.lower()
    if suffix == FMU or (suffix not in XDMF and not is_table(output) and on_root(comm, kind_of, given["result"])):
        return export_model
    if "fmi" in given:
        raise InputError(f"--fmi {given['fmi']} is for FMUs of models, and '{output}' is none; leave it out")
    if "parameters" in given or "overrides" in given:
        raise InputError("--set and --override are for the export of a model; a result is what it is")
    return export_result


@command(
    "export", "A trajectory for ParaView, a built model as C99 or FMU.", 160, petsc=False, choose=_chosen,
    others=(export_model,), result=Argument("Result, or its file.", word="FILE"), output=OUTPUT,
    gives="What was written.",
)  # fmt: skip
def export_result(
    result: Result | str | PathLike[str], output: str | PathLike[str], *, comm: Comm | None = None
) -> Path:
    """Write the frames of trajectory `result` as XDMF, which ParaView opens; a result's columns as CSV (-o FILE.csv);
    or a reduced or component model `result` for other programs.

    The XDMF file refers to `result` and copies nothing: keep the two together. CSV has units in its first line.

    A model becomes a folder of C99 (-o model/), or an FMU (-o model.fmu), for co-simulation and, where it is a reduced
    one, for model exchange.
    """
    comm = ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        file = file_of(result)
    target = Path(output)
    if is_table(target):
        rows, columns = on_root(comm, _write_table, file, target)
        written = f"{counted(rows, 'row')}, {columns} columns, with their units in the first line"
    else:
        written = f"{on_root(comm, _write_frames, file, target)} frames, stored in {file}"
    for line in (f"{target}: {written}", *on_root(comm, stopped_runs if is_table(target) else _what_lacks, file)):
        tell(comm, line)
    return target


def _write_frames(file: Path, output: Path) -> int:
    kind = kind_in(file)
    if kind != "trajectory":
        name = output.with_suffix(".csv") if output.name else "NAME.csv"
        table = f"; a table of it is written as -o {name}" if kind in TABULAR else ""
        raise InputError(f"output '{output}': {named(kind)} ('{file}') has no frames, a trajectory has{table}")
    return write_xdmf(file, output)


def _write_table(file: Path, output: Path) -> tuple[int, int]:
    from pgmp_petsc.results import READERS  # all kinds of results

    kind = kind_in(file)
    if kind not in TABULAR:
        known = f"a table can be made of {', '.join(map(named, TABULAR))}"
        cure = f"'pgmp info {shlex.quote(str(file))} --json' has its figures"
        raise InputError(f"output '{output}': {named(kind)} ('{file}') has no rows and columns; {known}; {cure}")
    result = READERS[kind].read(file)
    check_output(output, TABLE, (file,))
    write_result(result, output)
    columns = columns_of(result)
    return len(next(iter(columns.values()))[1]), len(columns)


def _what_lacks(file: Path) -> list[str]:
    """Return what the stresses of a reduced run lack, and why a run stopped early; by one process."""
    with open_file(file, "trajectory") as opened:
        reduced, scene = str(opened.attrs["model"]) == "reduced", str(opened.attrs["scene"])
        lacking = truncated(tomllib.loads(scene)) if reduced and GROUP in opened else ""
    return [f"  note: {lacking}"] * bool(lacking) + stopped_runs(file)
