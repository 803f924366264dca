"""``pgmp montecarlo``: many samples, and their distributions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click
import numpy as np

from pgmp_petsc.cli import estimates
from pgmp_petsc.cli.models import model_options, one_model, read_model
from pgmp_petsc.cli.options import output_option, scene_options
from pgmp_petsc.cli.report import remark_lines, save, say
from pgmp_petsc.ensemble.batch import Plan
from pgmp_petsc.ensemble.checkpoint import remove_checkpoint
from pgmp_petsc.ensemble.runner import run_ensemble
from pgmp_petsc.results.ensemble import Ensemble
from pgmp_petsc.runtime.claims import claimed
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.runtime.remarks import Remark
from pgmp_petsc.scene import Scene

MOST_SAMPLES = 10**9  # the pieces of a checkpoint are in order by nine digits
LARGEST_SEED = 2**63 - 1  # the largest whole number that every reader of the file knows


@click.command()
@click.argument("source", metavar="ROM.h5|SCENE", type=click.Path(path_type=Path))
@output_option
@click.option(
    "-n", "n_samples", required=True, metavar="N", type=click.IntRange(1, MOST_SAMPLES), help="Number of samples."
)
@click.option(
    "--seed", default=0, show_default=True, metavar="S", type=click.IntRange(0, LARGEST_SEED), help="Random seed."
)
@model_options
@click.option(
    "--ranks-per-sample", default=1, show_default=True, metavar="N", type=click.IntRange(1),
    help="With --full: ranks that share one sample, for large meshes; groups of ranks have samples of their own.",
)  # fmt: skip
@click.option("--resume", is_flag=True, help="Take up the checkpoint that a killed run left beside FILE.")
@scene_options
@click.pass_context
def montecarlo(
    context: click.Context,
    source: Path,
    output: Path,
    n_samples: int,
    seed: int,
    full: bool,
    components: bool,
    ranks_per_sample: int,
    resume: bool,
    settings: tuple[str, ...],
    overrides: tuple[str, ...],
) -> None:
    """Integrate N samples of ROM.h5 (or with --full or --components of a SCENE) and describe their distributions.

    Exit status 1 if some samples failed; they are recorded with their reason and the others go on.
    """
    comm = context.obj.comm
    one_model(full, components)
    if ranks_per_sample > 1 and not full:
        what = "component modes" if components else "a reduced model"
        raise InputError(f"--ranks-per-sample = {ranks_per_sample}: samples of {what} are small; leave it out")
    group = context.with_resource(RankGroup.split(comm, ranks_per_sample, "--ranks-per-sample"))
    context.with_resource(claimed(comm, output, "ensemble", (source,)))
    model = read_model(
        context, source, overrides, settings, full, components, lambda scene: _refuse_drawn(scene, settings)
    )
    loaded = model.scene
    if loaded.simulation.tolerance is not None:
        from pgmp_petsc.studies.settled_step import settle_step  # its many modules take a noticeable time

        model, remark = settle_step(model, comm, ensemble=True)
        say(context, remark)
    plan = Plan(n_samples, seed, output, resume)
    ensemble = run_ensemble(model, plan, group)
    save(context, ensemble, output)
    failed = 0
    if ensemble is not None:
        failed = int(np.sum(ensemble.status != 0))
        say(context, report(ensemble, output, loaded.remarks))
        remove_checkpoint(plan)
    if comm.bcast(failed):
        context.exit(1)


def _refuse_drawn(scene: Scene, settings: tuple[str, ...]) -> None:
    """Refuse a value for a parameter that every sample draws anew; the same on all ranks."""
    for setting in settings:
        name = setting.partition("=")[0].strip()
        parameter = scene.parameters[name]
        if parameter.distribution is not None:
            held = f"{{nominal={parameter.nominal:g}, value={parameter.current:g}}}"
            raise InputError(
                f"--set {setting}: every sample draws '{name}' from parameters.{name}.distribution, so a value has no "
                f"part in an ensemble; to move the distribution, --override parameters.{name}.distribution.loc=...; to "
                f"hold the parameter, replace it: --override 'parameters.{name}={held}'"
            )


def report(ensemble: Ensemble, path: Path, said: Sequence[Remark] = ()) -> str:
    """Return what is known of the outputs and parameters, what is not, and the estimated errors."""
    n = len(ensemble.status)
    heading = f"  {'':24s}{'mean':>14s}{'std. error':>12s}{'deviation':>14s}{'std. error':>12s}{'samples':>9s}"
    lines = [f"{path}: {ensemble.model} model, {n} samples", heading]
    for name, s in ensemble.statistics.items():
        unit = ensemble.units[name]
        moments = "".join(
            f"{'unknown':>{width}s}" if np.isnan(value) else f"{value:{width}.{digits}g}"
            for value, width, digits in (
                (s.mean, 14, 7), (s.mean_standard_error, 12, 2), (s.std, 14, 6), (s.std_standard_error, 12, 2),
            )
        )  # fmt: skip
        lines.append(f"  {name:24s}{moments}{s.count:9d} {'' if unit == '1' else unit}".rstrip())
    lines += remark_lines(ensemble.record, said)
    if np.any(ensemble.status != 0):
        lines += _bounds_of_quantiles(ensemble)
    if ensemble.validity:
        lines += estimates.of_ensemble(ensemble)
    lines += estimates.of_balance(ensemble)
    lines += [f"  {phase:24s}{seconds:14.2f} s" for phase, seconds in ensemble.record.timings.items()]
    return "\n".join(lines)


def _bounds_of_quantiles(ensemble: Ensemble) -> list[str]:
    """Return between what the outputs' quantiles lie, whatever the failed samples would have been."""
    lines = [f"  quantiles of all {len(ensemble.status)} samples, whatever the failed ones would have been"]
    for name in ensemble.outputs:
        s, unit = ensemble.statistics[name], ensemble.units[name]
        for probability, (low, high) in zip(s.probabilities, s.quantile_bounds):
            lower = "no bound below" if np.isinf(low) else f"at least {low:.6g}"
            upper = "no bound above" if np.isinf(high) else f"at most {high:.6g}"
            lines.append(
                f"  {name:24s}{f'{100 * probability:g} %':>9s}  {lower}, {upper} {'' if unit == '1' else unit}".rstrip()
            )
    return lines
