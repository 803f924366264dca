"""``pgmp tradeoff``: what accuracy costs in time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from pgmp_petsc.api.tradeoffs import tradeoff as measured
from pgmp_petsc.cli.calls import Call
from pgmp_petsc.cli.options import PathName, Whole, output_option, scene_options
from pgmp_petsc.cli.report import output_form, remark_lines
from pgmp_petsc.cli.tradeoff_table import summary
from pgmp_petsc.results.tradeoff import Tradeoff
from pgmp_petsc.runtime.errors import Remark


@click.command()
@click.argument("scene", metavar="SCENE", type=PathName())
@output_option
@click.option("--quick", is_flag=True, help="Measure fewer settings: within a minute for a small scene.")
@click.option("--resume", is_flag=True, help="Take up a study of the same file that was stopped.")
@click.option(
    "-n",
    "n_samples",
    default=10_000,
    show_default=True,
    metavar="N",
    type=Whole(min=1),
    help="Number of samples that the advice is for.",
)
@output_form
@scene_options
@click.pass_context
def tradeoff(
    context: click.Context,
    scene: Path,
    output: Path,
    quick: bool,
    resume: bool,
    n_samples: int,
    settings: tuple[str, ...],
    overrides: tuple[str, ...],
) -> None:
    """Measure what accuracy costs in time for SCENE, and say which setting to take.

    Settings of the reduced model (modes, static modes, angles, interpolation, second-order terms, time step), of the
    component model, the full-order model and response surfaces are compared with a converged reference at quantiles of
    the uncertain parameters: the full-order model, or the component model where that is too dear (reference.budget).
    Refined meshes of lines tell the discretisation error. A setting that fails is listed with its reason.

    Finished settings are kept in FILE.partial until the file is written; --resume takes them up, with any number of
    ranks.
    """
    call = Call(context, output, settings, overrides)
    found = measured(scene, quick=quick, n=n_samples, resume=resume, **call.arguments)
    call.say(found, report)


def report(study: Tradeoff, path: Path, said: Sequence[Remark] = ()) -> str:
    """Return what was measured, the advice, and all remarks but those that were said before."""
    n_values = len(next(iter(study.test_values.values()), (0,)))
    where = f"{n_values} values of {', '.join(study.varied)}" if study.varied else "the scene's values"
    lines = [f"{path}: {len(study.families)} settings, errors at {where}, {study.record.ranks} rank(s)", summary(study)]
    lines += remark_lines(study.record, said)
    lines += [f"  {phase:24s}{seconds:14.2f} s" for phase, seconds in study.record.timings.items()]
    return "\n".join(lines)
