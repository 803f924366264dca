"""``pgmp montecarlo``: many samples, and their distributions."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import click
import numpy as np

from pgmp_petsc.cli.better import Wanted, better_models, read_wanted
from pgmp_petsc.cli.ensemble_table import report
from pgmp_petsc.cli.models import model_options, one_model, read_model
from pgmp_petsc.cli.options import output_option, scene_options
from pgmp_petsc.cli.output_form import output_form, say_figures
from pgmp_petsc.cli.rare import alone, event_of, run_rare
from pgmp_petsc.cli.report import save, say
from pgmp_petsc.ensemble.batch import LARGEST_SEED, MOST_SAMPLES, SAMPLERS, Plan, SampleFile, Shard
from pgmp_petsc.ensemble.checkpoint import remove_checkpoint
from pgmp_petsc.ensemble.retry import read_earlier
from pgmp_petsc.ensemble.rules import read_rule
from pgmp_petsc.ensemble.runner import run_ensemble
from pgmp_petsc.ensemble.sample_file import read_samples
from pgmp_petsc.ensemble.sampling import refuse_drawn
from pgmp_petsc.ensemble.stopping import Stop
from pgmp_petsc.models import Model, ReducedModel
from pgmp_petsc.reduction.served_range import outside_of, refuse_beyond
from pgmp_petsc.results.ensemble import Ensemble
from pgmp_petsc.results.rare_event import KIND as RARE_EVENT
from pgmp_petsc.results.shard import KIND, ShardSamples
from pgmp_petsc.results.summary import origin_of, summary_of
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.claims import claimed, form_of
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.prepared import settled

FEW = 4  # samples of a better model to each Sobol sequence


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
@click.option(
    "--rare", "rare", metavar="EVENT",
    help='Find the probability of a rare event with at most N samples: "slider_deformation < -2e-4", "ever" before it '
    "for any time in the run, or the label of one of ensemble.probabilities.",
)  # fmt: skip
@click.option(
    "--correct", "corrections", multiple=True, metavar="[SCENE:]MODEL[/D]=K",
    help="Run the first K samples with a better MODEL too (full or components; /D: steps D times as short), and give "
    "its mean, deviation and probabilities; K may be auto with --budget; repeatable.",
)  # fmt: skip
@click.option(
    "--until", "rules", multiple=True, metavar="RULE",
    help="Stop when a figure is known well enough, such as 'std(angle) < 1 %' or 'P(angle > 3) +- 0.002'; repeatable.",
)  # fmt: skip
@click.option("--budget", metavar="TIME", help="Stop in time: 60s, 10min or 2h from the start of the command.")
@click.option(
    "--retry-failed", "failed", metavar="FILE", type=click.Path(path_type=Path),
    help="Try the failed samples of an ensemble's FILE further, with smaller steps; take the others from it.",
)  # fmt: skip
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
    rare: str | None,
    corrections: tuple[str, ...],
    rules: tuple[str, ...],
    budget: str | None,
    failed: Path | None,
    resume: bool,
    settings: tuple[str, ...],
    overrides: tuple[str, ...],
) -> None:
    """Integrate N samples of ROM.h5 (or with --full or --components of a SCENE) and describe their distributions.

    Exit status 1 if some samples failed, which are recorded with their reason while the others go on, or if a rule of
    --until is not met.
    """
    comm, start = context.obj.comm, time.monotonic()
    one_model(full, components)
    if rare is not None:
        alone(
            sampler=sampler, samples=table, shard=shard, resume=resume or None, ranks_per_sample=ranks_per_sample,
            correct=next(iter(corrections), None), until=next(iter(rules), None), budget=budget, retry_failed=failed,
        )  # fmt: skip
    seconds = None if budget is None else read_duration(budget)
    if failed is None:
        _one_source(n_samples, sampler, table, budget)
    else:
        _refuse_beside_retry(context, failed)
    wanted = read_wanted(corrections, "full" if full else "components" if components else "reduced", n_samples)
    _fits_together(wanted, rules, seconds, shard)
    if sampler is not None:
        overrides = (*overrides, f'ensemble.sampler="{sampler}"')
    if ranks_per_sample > 1 and not full:
        what = "component modes" if components else "a reduced model"
        raise InputError(f"--ranks-per-sample = {ranks_per_sample}: samples of {what} are small; leave it out")
    group = context.with_resource(RankGroup.split(comm, ranks_per_sample, "--ranks-per-sample"))
    part = None if shard is None else _part(shard)
    kind = RARE_EVENT if rare is not None else "ensemble" if part is None else KIND
    context.with_resource(claimed(comm, output, form_of(output, kind), (source, failed)))

    def refuse(scene: Scene) -> None:
        refuse_drawn(scene, settings)
        if rare is not None:
            event_of(rare, scene)

    model = read_model(context, source, overrides, settings, full, components, refuse)
    loaded = model.scene
    if loaded.simulation.tolerance is not None and part is not None:
        raise InputError(
            f"--shard {shard}: with simulation.tolerance every shard would measure a step of its own; build with the "
            "tolerance, or give simulation.step"
        )
    model, remark = settled(model, comm, ensemble=True)
    if remark:
        say(context, remark)
    if rare is not None:
        context.exit(run_rare(context, model, rare, n_samples, seed, output))
    file = None if table is None else on_root(comm, _table, table, model, n_samples, settings)
    if file is not None:
        n_samples = len(next(iter(file.values.values())))
        wanted = read_wanted(corrections, model.name, n_samples)
    earlier = None if failed is None else on_root(comm, read_earlier, failed, model)
    if earlier is not None:
        n_samples, seed, file = earlier.n_samples, earlier.seed, earlier.file
    if part is not None and part.count > n_samples:
        raise InputError(
            f"--shard {shard}: {part.count} shards of {n_samples} samples; take no more shards than samples"
        )
    is_limited = n_samples is not None
    plan = Plan(n_samples if is_limited else MOST_SAMPLES, seed, output, resume, file, part, is_limited)
    _suits_design(model.scene, file, wanted, bool(rules) or seconds is not None)
    stop = None
    if rules or seconds is not None:
        with agreed(comm, "reading the rules"):
            stop = Stop(tuple(read_rule(rule, model.scene) for rule in rules), seconds, start)
    better = better_models(wanted, model, source, (overrides, settings), comm)
    result = run_ensemble(model, plan, group, stop, better, earlier)
    save(context, result, output)
    status = 0
    if result is not None:
        failed = int(np.sum(result.status != 0))
        is_part = isinstance(result, ShardSamples)
        status = int(failed > 0) if is_part else exit_status(result)
        say(context, _report_shard(result, plan, failed) if is_part else report(result, output, loaded.remarks))
        say_figures(context, {"file": output, **(_figures_of_shard(result, plan) if is_part else summary_of(result))})
        remove_checkpoint(plan)
    if comm.bcast(status):
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


def exit_status(ensemble: Ensemble) -> int:
    """Return 1 where samples failed, or a rule is not met."""
    failed = bool(np.any(ensemble.status != 0)) or ensemble.joined is not None and ensemble.joined.n_failed > 0
    return int(failed or ensemble.stopping is not None and not ensemble.stopping.is_met)


def _fits_together(wanted: Sequence[Wanted], rules: Sequence[str], seconds: float | None, shard: str | None) -> None:
    """Refuse what cannot decide on the same samples; the same on all ranks."""
    if shard is not None and (wanted or rules or seconds is not None):
        option = "--correct" if wanted else "--until" if rules else "--budget"
        raise InputError(f"--shard {shard}: {option} goes by all samples, and a shard has some; leave one of them out")
    if wanted and rules:
        raise InputError(
            f'--until "{rules[0]}" and --correct: rules go by the figures of one model; give numbers of samples, or '
            "--correct MODEL=auto with --budget, which gets most out of a time"
        )
    free = [one for one in wanted if one.count is None]
    if free and seconds is None:
        raise InputError(f"--correct {free[0].text}: what decides on the number is missing; give --budget, such as 60s")
    if wanted and seconds is not None and not free:
        raise InputError(
            f"--budget: --correct {wanted[0].text} gives the number of samples, and nothing is left to choose; take "
            f"{wanted[0].name}=auto, or leave --budget out"
        )


def _refuse_beside_retry(context: click.Context, failed: Path) -> None:
    """Refuse options that say what the samples are, which the file does; the same on all ranks."""
    options = {option.name: option.opts[0] for option in context.command.params}
    for name in ("n_samples", "seed", "table", "shard", "corrections", "rules", "budget"):
        if context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            raise InputError(
                f"{options[name]}: --retry-failed {failed} takes samples and their number from the file; leave one of "
                "them out"
            )


def _suits_design(scene: Scene, file: SampleFile | None, wanted: Sequence[Wanted], is_open: bool) -> None:
    """Refuse designs whose samples are no parts of each other; the same on all ranks."""
    sampler = "random" if file is not None else scene.ensemble.sampler
    if is_open and sampler == "latin_hypercube":
        raise InputError(
            "--until and --budget with the sampler latin_hypercube: each of its samples depends on how many there are; "
            "take random or sobol"
        )
    if wanted and sampler not in ("random", "sobol"):
        raise InputError(
            f"--correct with the sampler {sampler}: intervals of several models are those of independent samples, or "
            "of replicates of Sobol sequences; take random or sobol"
        )
    replicates = scene.ensemble.replicates
    for one in wanted if sampler == "sobol" else ():
        if one.count is None or one.count % (FEW * replicates):
            raise InputError(
                f"--correct {one.text}: with the sampler sobol every one of {replicates} sequences "
                f"(ensemble.replicates) needs as many samples, and {FEW} at least; give a multiple of "
                f"{FEW * replicates}"
            )


def read_duration(text: str) -> float:
    """Return a time in seconds; raises `InputError` unless it is a positive number with s, min or h."""
    found = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*(s|min|h)?\s*", text)
    seconds = float(found[1]) * {"s": 1.0, None: 1.0, "min": 60.0, "h": 3600.0}[found[2]] if found else 0.0
    if not 0.0 < seconds < 1e8:
        raise InputError(f"--budget {text}: allowed is a time such as 60s, 10min or 2h, of less than three years")
    return seconds


def _one_source(n_samples: int | None, sampler: str | None, table: Path | None, budget: str | None) -> None:
    """Refuse samples both drawn and from a file, and none at all; the same on all ranks."""
    if table is None and n_samples is None and budget is None:
        raise InputError(
            "-n: missing; give the number of samples, a file of samples with --samples, or a time with --budget"
        )
    if table is not None and sampler is not None:
        raise InputError(f"--sampler {sampler}: the samples are those of --samples {table}; give one of them")


def _table(table: Path, model: Model, n_samples: int | None, settings: tuple[str, ...]) -> SampleFile:
    """Read a file of samples, and refuse values for parameters that it gives."""
    file = read_samples(table, model.scene, n_samples)
    for setting in settings:
        name = setting.partition("=")[0].strip()
        if name in file.values:
            raise InputError(
                f"--set {setting}: every sample takes '{name}' from --samples {table}; leave one of them out"
            )
    if isinstance(model, ReducedModel):
        refuse_beyond(model.served, file.values, f"--samples {table}")
        said = outside_of(model.served, file.values, f"--samples {table}")
        file = replace(file, remarks=(*file.remarks, *said))
    return file
