"""``pgmp fit``: parameters of a scene from a measured history."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from pgmp_petsc.api.designs import fit as fitted
from pgmp_petsc.cli.calls import Call
from pgmp_petsc.cli.gradient_tables import fit_lines
from pgmp_petsc.cli.options import PathName, scene_options
from pgmp_petsc.cli.report import output_form, remark_lines
from pgmp_petsc.cli.sensitivities import check_plot, draw, file_option, parameter_option, plot_option
from pgmp_petsc.results.fit import Fit
from pgmp_petsc.runtime.errors import InputError, Remark, RunError


@click.command()
@click.argument("source", metavar="ROM.h5", type=PathName())
@click.argument("measured", metavar="MEASURED.csv", type=PathName())
@file_option
@plot_option
@parameter_option("Fit parameter NAME, instead of all with a distribution")
@click.option(
    "--noise",
    multiple=True,
    metavar="OUTPUT=NUMBER",
    help="Standard deviation of an output's noise; found from what is left where it is not given. Repeatable.",
)
@output_form
@scene_options
@click.pass_context
def fit(
    context: click.Context,
    source: Path,
    measured: Path,
    output: Path | None,
    plot: Path | None,
    parameters: tuple[str, ...],
    noise: tuple[str, ...],
    settings: tuple[str, ...],
    overrides: tuple[str, ...],
) -> None:
    """Fit parameters of the reduced model ROM.h5 to the history in MEASURED.csv by least squares.

    The table's first line names its columns: time (s), and outputs of the scene in SI units. The fit begins with the
    values of a run (--set), and keeps to the bounds of the parameters.

    Exit status 1 if it does not converge.
    """
    deviations = _deviations(noise)
    check_plot(context, plot, output)
    call = Call(context, output, settings, overrides)
    found = fitted(source, measured, parameters, noise=deviations, **call.arguments)
    draw(context, found, plot)
    call.say(found, report, measured)
    if not context.obj.comm.bcast(found.data is None or found.converged):
        raise RunError("the fit did not converge")


def _deviations(given: Sequence[str]) -> dict[str, float]:
    """Return the deviations of noise by output."""
    found = {}
    for text in given:
        name, _, number = text.partition("=")
        try:
            found[name.strip()] = float(number)
        except ValueError:
            found[name.strip()] = 0.0
        if not 0.0 < found[name.strip()] < float("inf"):
            raise InputError(
                f"--noise {text}: OUTPUT=NUMBER with a positive number is needed, such as crank_angle=1e-3"
            )
    return found


def report(found: Fit, path: Path, said: Sequence[Remark] = ()) -> str:
    """Return the table of a fit, and all remarks."""
    lines = [f"{path}: {len(found.time)} instants of {', '.join(found.outputs)}, {found.n_runs} runs"]
    lines += [*fit_lines(found), *remark_lines(found.record, said)]
    lines += [f"  {phase:24s}{seconds:16.2f} s" for phase, seconds in found.record.timings.items()]
    return "\n".join(lines)
