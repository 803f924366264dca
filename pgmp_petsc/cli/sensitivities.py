"""``pgmp sensitivities``: what parameters do to the outputs of a reduced run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click

from pgmp_petsc.api.result import Result
from pgmp_petsc.api.runs import sensitivities as differentiated
from pgmp_petsc.cli.calls import Call
from pgmp_petsc.cli.gradient_tables import report
from pgmp_petsc.cli.options import Command, PathName, scene_options
from pgmp_petsc.cli.report import output_form, say
from pgmp_petsc.runtime.agreement import on_root
from pgmp_petsc.runtime.claims import check_folder


def parameter_option(what: str) -> Callable[[Command], Command]:
    """Add the repeatable ``--parameter NAME``; the function receives ``parameters`` (tuple of str)."""
    return click.option("--parameter", "parameters", multiple=True, metavar="NAME", help=f"{what}; repeatable.")


def file_option(command: Command) -> Command:
    """Add ``-o/--output FILE``, which may be left out; the function receives ``output`` (Path or None)."""
    text = "File to keep the result in; it replaces an older one when it is complete."
    return click.option("-o", "--output", metavar="FILE", type=PathName(), help=text)(command)


def plot_option(command: Command) -> Command:
    """Add ``--plot DIR``; the function receives ``plot`` (Path or None)."""
    text = "Directory for the picture; made if it does not exist."
    return click.option("--plot", metavar="DIR", type=PathName(), help=text)(command)


@click.command()
@click.argument("source", metavar="ROM.h5", type=PathName())
@file_option
@plot_option
@parameter_option("Differentiate with parameter NAME, instead of all of the scene")
@output_form
@scene_options
@click.pass_context
def sensitivities(
    context: click.Context,
    source: Path,
    output: Path | None,
    plot: Path | None,
    parameters: tuple[str, ...],
    settings: tuple[str, ...],
    overrides: tuple[str, ...],
) -> None:
    """Say what a change of each parameter does to the outputs of a run of the reduced model ROM.h5.

    Derivatives of the outputs over time, of their largest and smallest values and of the values at the end come from
    one run. Told are the effects of one standard deviation of each parameter, the largest first.
    """
    check_plot(context, plot, output)
    call = Call(context, output, settings, overrides)
    found = differentiated(source, parameters, **call.arguments)
    draw(context, found, plot)
    call.say(found, report, source)


def check_plot(context: click.Context, plot: Path | None, output: Path | None) -> None:
    """Refuse a directory that the picture cannot be in, before anything is computed. Collective on all ranks."""
    if plot is not None:
        on_root(context.obj.comm, check_folder, plot, output)


def draw(context: click.Context, result: Result, plot: Path | None) -> None:
    """Draw a result that the first rank has, where that is asked for. Collective on all ranks."""
    if plot is not None:

        def drawing() -> str:
            from pgmp_petsc.figures.collection import draw_result  # matplotlib takes a noticeable time

            return draw_result(result.data, plot)

        say(context, on_root(context.obj.comm, drawing))
