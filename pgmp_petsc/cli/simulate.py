"""``pgmp simulate``: one run over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from pgmp_petsc.api.result import StoppedRun
from pgmp_petsc.api.runs import simulate as simulated
from pgmp_petsc.cli import estimates
from pgmp_petsc.cli.calls import Call
from pgmp_petsc.cli.options import PathName, model_of, model_options, one_model, output_option, scene_options
from pgmp_petsc.cli.report import output_form, remark_lines
from pgmp_petsc.results.numbers import axis_unit
from pgmp_petsc.results.trajectory import Trajectory
from pgmp_petsc.runtime.errors import Remark


@click.command()
@click.argument("source", metavar="ROM.h5|SCENE", type=PathName())
@output_option
@model_options
@output_form
@scene_options
@click.pass_context
def simulate(
    context: click.Context,
    source: Path,
    output: Path,
    full: bool,
    components: bool,
    settings: tuple[str, ...],
    overrides: tuple[str, ...],
) -> None:
    """Run the reduced model ROM.h5, with --full the full-order or with --components the component model of a SCENE.

    Exit status 1 if the run stops before its end; FILE then holds what was computed.
    """
    one_model(full, components)
    call = Call(context, output, settings, overrides)
    try:
        run = simulated(source, model=model_of(full, components), **call.arguments)
    except StoppedRun as stopped:
        call.say(stopped.result, report)
        raise
    call.say(run, report)


def report(trajectory: Trajectory, path: Path, said: Sequence[Remark] = ()) -> str:
    """Return the outputs at the end, estimated errors and validity of a reduced run, and all remarks."""
    lines = [f"{path}: {trajectory.model} model, {len(trajectory.time) - 1} steps to {trajectory.time[-1]:g} s"]
    for name, values in trajectory.outputs.items():
        factor, unit = axis_unit(trajectory.units[name], values)
        lines.append(f"  {name:24s}{factor * values[-1]:16.8g} {unit}")
    if trajectory.errors is not None:
        lines += estimates.of_trajectory(trajectory.errors, trajectory.units, trajectory.time[-1])
    if trajectory.validity:
        lines.append(estimates.of_validity(trajectory.validity))
    # why it stopped is the error that ends the command
    stopped = trajectory.why_stopped
    lines += [line for line in remark_lines(trajectory.record, said) if not (stopped and line.endswith(stopped))]
    lines += [f"  {phase:24s}{seconds:16.2f} s" for phase, seconds in trajectory.record.timings.items()]
    return "\n".join(lines)
