"""``pgmp optimize``: parameters that meet a goal best under constraints."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from pgmp_petsc.api.designs import Robust, optimize as designed
from pgmp_petsc.cli.calls import Call
from pgmp_petsc.cli.gradient_tables import design_lines
from pgmp_petsc.cli.options import Number, PathName, Whole, scene_options
from pgmp_petsc.cli.report import output_form, remark_lines
from pgmp_petsc.cli.sensitivities import check_plot, draw, file_option, parameter_option, plot_option
from pgmp_petsc.results.designs import Design
from pgmp_petsc.runtime.errors import InputError, Remark, RunError, counted


@click.command()
@click.argument("source", metavar="ROM.h5", type=PathName())
@click.argument("goal", metavar="GOAL")
@click.option(
    "--subject-to", "constraints", multiple=True, metavar="CONSTRAINT", help="What the design must keep; repeatable."
)
@file_option
@plot_option
@parameter_option("Design parameter NAME, instead of all with bounds or a distribution")
@click.option(
    "--robust",
    "deviations",
    metavar="K",
    type=Number(min=0.0),
    help="Take the mean and K standard deviations of every figure over samples, instead of nominal runs.",
)
@click.option(
    "--samples", "n_samples", metavar="N", type=Whole(min=2), help=f"Samples of --robust; {Robust.n} if not given."
)
@click.option("--seed", metavar="S", type=Whole(min=0), help=f"Of the samples of --robust; {Robust.seed} if not given.")
@output_form
@scene_options
@click.pass_context
def optimize(
    context: click.Context,
    source: Path,
    goal: str,
    constraints: tuple[str, ...],
    output: Path | None,
    plot: Path | None,
    parameters: tuple[str, ...],
    deviations: float | None,
    n_samples: int | None,
    seed: int | None,
    settings: tuple[str, ...],
    overrides: tuple[str, ...],
) -> None:
    """Find the parameters of the reduced model ROM.h5 that meet GOAL best.

    GOAL is "minimise ..." or "maximise ...", a CONSTRAINT is "... <= ..." or "... >= ...": sums, products and powers of
    numbers, parameters, and figures of outputs: max, min, mean, rms, start and end of an output or of its abs.

    \b
    pgmp optimize rom.h5 "minimise max(abs(slider_deformation))" --subject-to "r1 <= 6e-3" -o design.h5

    Exit status 1 if no design is found that meets all constraints.
    """
    check_plot(context, plot, output)
    call = Call(context, output, settings, overrides)
    given = {name: value for name, value in (("n", n_samples), ("seed", seed)) if value is not None}
    if deviations is None and given:
        words = " and ".join({"n": f"--samples {n_samples}", "seed": f"--seed {seed}"}[name] for name in given)
        raise InputError(f"{words}: for figures over samples; give --robust K too, or leave it out")
    robust = None if deviations is None else Robust(deviations, **given)
    found = designed(source, goal, parameters, subject_to=constraints, robust=robust, **call.arguments)
    draw(context, found, plot)
    call.say(found, report, source)
    why = context.obj.comm.bcast("" if found.data is None or found.converged else _reason(found.data))
    if why:
        raise RunError(f"no design was found that meets all that was asked for: {why}")


def _reason(found: Design) -> str:
    return next((remark.text for remark in found.record.remarks if remark.kind == "warning"), "see the remarks")


def report(found: Design, path: Path, said: Sequence[Remark] = ()) -> str:
    """Return the table of a design, and all remarks."""
    lines = [f"{path}: {counted(len(found.tried), 'design')} of {counted(found.n_samples, 'run')} each"]
    lines += [*design_lines(found), *remark_lines(found.record, said)]
    lines += [f"  {phase:24s}{seconds:16.2f} s" for phase, seconds in found.record.timings.items()]
    return "\n".join(lines)
