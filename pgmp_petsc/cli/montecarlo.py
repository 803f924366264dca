"""``pgmp montecarlo``: many samples, and their distributions."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import click
import numpy as np

from pgmp_petsc.api.better import Correction
from pgmp_petsc.api.ensembles import montecarlo as integrated, rare_event, retry_failed
from pgmp_petsc.api.requests import LARGEST_SEED, MOST_SAMPLES, SAMPLERS, Shard, Stopping
from pgmp_petsc.cli.calls import Call
from pgmp_petsc.cli.ensemble_table import report
from pgmp_petsc.cli.options import PathName, Whole, model_of, model_options, one_model, output_option, scene_options
from pgmp_petsc.cli.rare import alone, report as report_rare
from pgmp_petsc.cli.report import output_form
from pgmp_petsc.results.ensemble import Ensemble
from pgmp_petsc.results.rare_event import KIND as RARE_EVENT, RareEvent
from pgmp_petsc.results.shard import KIND as SHARD, ShardSamples
from pgmp_petsc.runtime.errors import InputError, Remark


@click.command()
@click.argument("source", metavar="ROM.h5|SCENE", type=PathName())
@output_option
@click.option(
    "-n", "n_samples", metavar="N", type=Whole(1, MOST_SAMPLES),
    help="Number of samples; with --samples all that the file has, if not given.",
)  # fmt: skip
@click.option("--seed", default=0, show_default=True, metavar="S", type=Whole(0, LARGEST_SEED), help="Random seed.")
@click.option(
    "--sampler", type=click.Choice(SAMPLERS), help="How samples are chosen; otherwise as ensemble.sampler says."
)
@click.option(
    "--samples", "table", metavar="TABLE", type=PathName(),
    help="Take the samples of a CSV or HDF5 file, columns named as parameters, SI units.",
)  # fmt: skip
@model_options
@click.option(
    "--ranks-per-sample", default=1, show_default=True, metavar="N", type=Whole(1),
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
    "--retry-failed", "failed", metavar="FILE", type=PathName(),
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
    one_model(full, components)
    model = {"model": model_of(full, components)}
    if rare is not None:
        alone(
            sampler=sampler, samples=table, shard=shard, resume=resume or None, ranks_per_sample=ranks_per_sample,
            correct=next(iter(corrections), None), until=next(iter(rules), None), budget=budget, retry_failed=failed,
        )  # fmt: skip
    if failed is not None:
        _refuse_beside_retry(context, failed)
        overrides += () if sampler is None else (f'ensemble.sampler="{sampler}"',)
    stopping = Stopping(rules, None if budget is None else read_duration(budget))
    wanted = [Correction.read(text) for text in corrections]
    part = None if shard is None else read_part(shard)
    call = Call(context, output, settings, overrides)
    grouped = {**model, **call.arguments, "ranks_per_sample": ranks_per_sample, "resume": resume}
    if rare is not None:
        found = rare_event(source, rare, _number(n_samples), seed, **model, **call.arguments)
    elif failed is not None:
        found = retry_failed(source, failed, **grouped)
    else:
        found = integrated(
            source, n_samples, seed, sampler=sampler, samples=table, shard=part, correct=wanted, stopping=stopping,
            **grouped,
        )  # fmt: skip
    call.say(found, {RARE_EVENT: report_rare, SHARD: report_shard}.get(found.kind, report))
    if context.obj.comm.bcast(0 if found.data is None else exit_status(found.data)):
        context.exit(1)


def read_part(shard: str) -> Shard:
    """Return which part of the samples is wanted; the same on all ranks."""
    found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", shard)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise InputError(f"--shard {shard}: allowed are I/K with I from 1 to K, such as 2/8")
    return Shard(int(found[1]), int(found[2]))


def report_shard(shard: ShardSamples, path: Path, said: Sequence[Remark] = ()) -> str:
    """Return which samples are there, and what is left to do."""
    place, failed = shard.place, int(np.sum(shard.status != 0))
    first, last = place.first, place.first + len(shard.status)
    which = f"shard {place.number}/{place.count}, samples {first} to {last - 1} of {place.n_samples}"
    lines = [f"{path}: {shard.model} model, {which}", *(f"  {remark}" for remark in shard.found)]
    if failed:
        lines.append(f"  {failed} of {last - first} samples failed; pgmp merge says why")
    lines.append(f"  pgmp merge joins the files of all {place.count} shards and describes the samples")
    lines += [f"  {phase:24s}{seconds:14.2f} s" for phase, seconds in shard.record.timings.items()]
    return "\n".join(lines)


def exit_status(found: Ensemble | ShardSamples | RareEvent) -> int:
    """Return 1 where samples failed, a rule is not met, or a rare event is not reached."""
    failed = bool(np.any(found.status != 0))
    if isinstance(found, RareEvent):
        return int(failed or not found.reached)
    if isinstance(found, ShardSamples):
        return int(failed)
    failed = failed or found.joined is not None and found.joined.n_failed > 0
    return int(failed or found.stopping is not None and not found.stopping.is_met)


def _number(n_samples: int | None) -> int:
    if n_samples is None:
        raise InputError("-n: missing; give the number of samples that --rare may take at most")
    return n_samples


def _refuse_beside_retry(context: click.Context, failed: Path) -> None:
    """Refuse options that say what the samples are, which the file does; the same on all ranks."""
    options = {option.name: option.opts[0] for option in context.command.params}
    for name in ("n_samples", "seed", "table", "shard", "corrections", "rules", "budget"):
        if context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            raise InputError(
                f"{options[name]}: --retry-failed {failed} takes samples and their number from the file; leave one of "
                "them out"
            )


def read_duration(text: str) -> float:
    """Return a time in seconds; raises `InputError` unless it is a positive number with s, min or h."""
    found = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*(s|min|h)?\s*", text)
    seconds = float(found[1]) * {"s": 1.0, None: 1.0, "min": 60.0, "h": 3600.0}[found[2]] if found else 0.0
    if not 0.0 < seconds < 1e8:
        raise InputError(f"--budget {text}: allowed is a time such as 60s, 10min or 2h, of less than three years")
    return seconds
