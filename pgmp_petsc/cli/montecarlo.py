"""``pgmp montecarlo``: many samples, and their distributions."""

from __future__ import annotations

import re
from pathlib import Path

import click
import numpy as np

from pgmp_petsc.cli.ensemble_table import report
from pgmp_petsc.cli.models import model_options, one_model, read_model
from pgmp_petsc.cli.options import output_option, scene_options
from pgmp_petsc.cli.output_form import output_form, say_figures
from pgmp_petsc.cli.report import save, say
from pgmp_petsc.ensemble.batch import Plan, SampleFile, Shard
from pgmp_petsc.ensemble.checkpoint import remove_checkpoint
from pgmp_petsc.ensemble.runner import run_ensemble
from pgmp_petsc.ensemble.sample_file import read_samples
from pgmp_petsc.results.shard import KIND, ShardSamples
from pgmp_petsc.results.summary import origin_of, summary_of
from pgmp_petsc.runtime.agreement import on_root
from pgmp_petsc.runtime.claims import claimed
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.scene import Scene

SAMPLERS = ("random", "latin_hypercube", "sobol", "saltelli")
MOST_SAMPLES = 10**9  # the pieces of a checkpoint are in order by nine digits
LARGEST_SEED = 2**63 - 1  # the largest whole number that every reader of the file knows


@click.command()
@click.argument("source", metavar="ROM.h5|SCENE", type=click.Path(path_type=Path))
@output_option
@click.option(
    "-n", "n_samples", metavar="N", type=click.IntRange(1, MOST_SAMPLES),
    help="Number of samples; with --samples all that the file has, if not given.",
)  # fmt: skip
@click.option(
    "--seed", default=0, show_default=True, metavar="S", type=click.IntRange(0, LARGEST_SEED), help="Random seed."
)
@click.option(
    "--sampler", type=click.Choice(SAMPLERS), help="How samples are chosen; otherwise as ensemble.sampler says."
)
@click.option(
    "--samples", "table", metavar="TABLE", type=click.Path(path_type=Path),
    help="Take the samples of a CSV or HDF5 file, columns named as parameters, SI units.",
)  # fmt: skip
@model_options
@click.option(
    "--ranks-per-sample", default=1, show_default=True, metavar="N", type=click.IntRange(1),
    help="With --full: ranks that share one sample, for large meshes; groups of ranks have samples of their own.",
)  # fmt: skip
@click.option(
    "--shard", metavar="I/K", help="Integrate part I of K parts alone; pgmp merge joins their files to the whole."
)
@click.option("--resume", is_flag=True, help="Take up the checkpoint that a killed run left beside FILE.")
@output_form
@scene_options
@click.pass_context
def montecarlo(
    context: click.Context,
    source: Path,
    output: Path,
    n_samples: int | None,
    seed: int,
    sampler: str | None,
    table: Path | None,
    full: bool,
    components: bool,
    ranks_per_sample: int,
    shard: str | None,
    resume: bool,
    settings: tuple[str, ...],
    overrides: tuple[str, ...],
) -> None:
    """Integrate N samples of ROM.h5 (or with --full or --components of a SCENE) and describe their distributions.

    Exit status 1 if some samples failed; they are recorded with their reason and the others go on.
    """
    comm = context.obj.comm
    one_model(full, components)
    _one_source(n_samples, sampler, table)
    if sampler is not None:
        overrides = (*overrides, f'ensemble.sampler="{sampler}"')
    if ranks_per_sample > 1 and not full:
        what = "component modes" if components else "a reduced model"
        raise InputError(f"--ranks-per-sample = {ranks_per_sample}: samples of {what} are small; leave it out")
    group = context.with_resource(RankGroup.split(comm, ranks_per_sample, "--ranks-per-sample"))
    part = None if shard is None else _part(shard)
    context.with_resource(claimed(comm, output, "ensemble" if part is None else KIND, (source,)))
    model = read_model(
        context, source, overrides, settings, full, components, lambda scene: _refuse_drawn(scene, settings)
    )
    loaded = model.scene
    if loaded.simulation.tolerance is not None:
        if part is not None:
            raise InputError(
                f"--shard {shard}: with simulation.tolerance every shard would measure a step of its own; build with "
                "the tolerance, or give simulation.step"
            )
        from pgmp_petsc.studies.settled_step import settle_step  # its many modules take a noticeable time

        model, remark = settle_step(model, comm, ensemble=True)
        say(context, remark)
    file = None if table is None else on_root(comm, _table, table, model.scene, n_samples, settings)
    if file is not None:
        n_samples = len(next(iter(file.values.values())))
    if part is not None and part.count > n_samples:
        raise InputError(
            f"--shard {shard}: {part.count} shards of {n_samples} samples; take no more shards than samples"
        )
    plan = Plan(n_samples, seed, output, resume, file, part)
    result = run_ensemble(model, plan, group)
    save(context, result, output)
    failed = 0
    if result is not None:
        failed = int(np.sum(result.status != 0))
        is_part = isinstance(result, ShardSamples)
        say(context, _report_shard(result, plan, failed) if is_part else report(result, output, loaded.remarks))
        say_figures(context, {"file": output, **(_figures_of_shard(result, plan) if is_part else summary_of(result))})
        remove_checkpoint(plan)
    if comm.bcast(failed):
        context.exit(1)


def _part(shard: str) -> Shard:
    """Return which part of the samples is wanted; the same on all ranks."""
    found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", shard)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise InputError(f"--shard {shard}: allowed are I/K with I from 1 to K, such as 2/8")
    return Shard(int(found[1]), int(found[2]))


def _report_shard(shard: ShardSamples, plan: Plan, failed: int) -> str:
    """Return which samples are there, and what is left to do."""
    (first, last), place = plan.samples, shard.place
    which = f"shard {plan.shard}, samples {first} to {last - 1} of {place.n_samples}"
    lines = [f"{plan.output}: {shard.model} model, {which}", *(f"  {remark}" for remark in shard.found)]
    if failed:
        lines.append(f"  {failed} of {last - first} samples failed; pgmp merge says why")
    lines.append(f"  pgmp merge joins the files of all {place.count} shards and describes the samples")
    lines += [f"  {phase:24s}{seconds:14.2f} s" for phase, seconds in shard.record.timings.items()]
    return "\n".join(lines)


def _figures_of_shard(shard: ShardSamples, plan: Plan) -> dict[str, object]:
    """Return which samples are there."""
    first, last = plan.samples
    place = {"shard": str(plan.shard), "first": first, "last": last - 1, "of": shard.place.n_samples}
    return {"kind": KIND, "model": shard.model, **place, **origin_of(shard.record)}


def _one_source(n_samples: int | None, sampler: str | None, table: Path | None) -> None:
    """Refuse samples both drawn and from a file, and none at all; the same on all ranks."""
    if table is None and n_samples is None:
        raise InputError("-n: missing; give the number of samples, or a file of samples with --samples")
    if table is not None and sampler is not None:
        raise InputError(f"--sampler {sampler}: the samples are those of --samples {table}; give one of them")


def _table(table: Path, scene: Scene, n_samples: int | None, settings: tuple[str, ...]) -> SampleFile:
    """Read a file of samples, and refuse values for parameters that it gives."""
    file = read_samples(table, scene, n_samples)
    for setting in settings:
        name = setting.partition("=")[0].strip()
        if name in file.values:
            raise InputError(
                f"--set {setting}: every sample takes '{name}' from --samples {table}; leave one of them out"
            )
    return file


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
