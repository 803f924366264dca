"""``pgmp export``: a trajectory for ParaView, or a reduced model for other programs."""

from __future__ import annotations

from pathlib import Path

import click

from pgmp_petsc.cli.options import output_option, scene_options
from pgmp_petsc.cli.report import say, say_remarks, stopped_runs
from pgmp_petsc.runtime.agreement import on_root
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.seal import BrokenSeal, seal_of

FMU = ".fmu"
XDMF = (".xdmf", ".xmf")


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@output_option
@scene_options
@click.pass_context
def export(
    context: click.Context, file: Path, output: Path, settings: tuple[str, ...], overrides: tuple[str, ...]
) -> None:
    """Write the frames of trajectory FILE as XDMF, which ParaView opens; or a reduced model FILE for other programs.

    The XDMF file refers to FILE and copies nothing: keep the two together.

    A reduced model becomes a folder of C99 (-o model/) or an FMU for co-simulation, FMI 2.0 (-o model.fmu).
    """
    suffix = output.suffix.lower()
    if suffix == FMU or (suffix not in XDMF and on_root(context.obj.comm, _is_rom, file)):
        _export_model(context, file, output, settings, overrides)
        return
    if settings or overrides:
        raise InputError("--set and --override are for the export of a reduced model; a trajectory is what it is")
    from pgmp_petsc.export.xdmf import write_xdmf

    n_frames = on_root(context.obj.comm, write_xdmf, file, output)
    say(context, f"{output}: {n_frames} frames, stored in {file}")
    for line in (*on_root(context.obj.comm, _truncated, file), *on_root(context.obj.comm, stopped_runs, file)):
        say(context, line)


def _truncated(file: Path) -> list[str]:
    """Return what the stresses of a reduced run lack; by one process."""
    from pgmp_petsc.results.body_fields import GROUP, truncated
    from pgmp_petsc.runtime.files import open_file

    with open_file(file, "trajectory") as opened:
        reduced, scene = str(opened.attrs["model"]) == "reduced", str(opened.attrs["scene"])
        lacking = truncated(scene) if reduced and GROUP in opened else ""
    return [f"  note: {lacking}"] if lacking else []


def _is_rom(file: Path) -> bool:
    try:
        return seal_of(file).kind == "rom"
    except (OSError, BrokenSeal):
        return False  # the reader of trajectories says what is wrong with it


def _export_model(
    context: click.Context, file: Path, output: Path, settings: tuple[str, ...], overrides: tuple[str, ...]
) -> None:
    """Write a reduced model as C99 or as an FMU, and say what it does not have."""
    from pgmp_petsc.code.constants import CORRECTIONS, constants_of
    from pgmp_petsc.code.fmu import write_fmu
    from pgmp_petsc.code.refusal import check_scene
    from pgmp_petsc.code.source import write_sources
    from pgmp_petsc.models import ReducedModel
    from pgmp_petsc.studies.inputs import read_rom

    is_fmu = output.suffix.lower() == FMU
    if output.suffix and not is_fmu:
        raise InputError(
            f"output '{output}': a reduced model is exported as a folder of C99, whose name has no ending (-o "
            f"{output.with_suffix('')}/), or as an FMU (-o {output.with_suffix(FMU)})"
        )
    scene, rom = read_rom(file, overrides, settings, context.obj.comm)

    def write() -> str:
        check_scene(scene, str(output))
        constants = constants_of(ReducedModel(scene, rom), str(output))
        if not is_fmu:
            return f"{output}: C99, {write_sources(constants, output) / 1e6:.1f} MB"
        target = write_fmu(constants, output)
        if target:
            return f"{output}: FMI 2.0, co-simulation, sources and a library for {target}"
        why = "no C compiler (cc, gcc) for a platform that FMI 2.0 names"
        return f"{output}: FMI 2.0, co-simulation, sources only: {why}; compile sources/ where it is to run"

    say(context, on_root(context.obj.comm, write))
    steps = f"steps of {scene.simulation.step:g} s, {CORRECTIONS} Newton corrections each"
    say(context, f"  {steps}; tunable: {', '.join(scene.values) or 'no parameters'}")
    left_out = "elastic strain, change of stiffness, error estimates and energies are not in it; see pgmp simulate"
    say(context, f"  note: {left_out}")
    say_remarks(context, scene)
