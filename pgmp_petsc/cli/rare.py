"""``pgmp montecarlo --rare``: which event is meant, and what is said of its probability."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from pgmp_petsc.cli.output_form import say_figures
from pgmp_petsc.cli.report import remark_lines, save, say
from pgmp_petsc.results.summary import summary_of
from pgmp_petsc.runtime.errors import InputError, nearest_name, shortened

if TYPE_CHECKING:
    from pgmp_petsc.models import Model
    from pgmp_petsc.results.rare_event import RareEvent
    from pgmp_petsc.scene import Scene
    from pgmp_petsc.scene.ensemble import Event

WHY_ALONE = {
    "sampler": "samples follow from those before them",
    "samples": "samples follow from those before them",
    "shard": "samples follow from those before them",
    "resume": "its samples are not kept on the way, so that a killed run begins anew",
    "ranks_per_sample": "ranks take samples of their own",
    "correct": "better models would have rare events of their own",
    "until": "its own rule says when enough is known",
    "budget": "it takes the samples that it is given",
    "retry_failed": "it has no samples to be tried again",
}
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"


def alone(**options: object) -> None:
    """Refuse options of ensembles that --rare has no part for; None, and one rank a sample, are not given."""
    for name, value in options.items():
        if value is not None and (name, value) != ("ranks_per_sample", 1):
            flag = f"--{name.replace('_', '-')}"
            shown = flag if value is True else f"{flag} {value}"
            raise InputError(f"{shown} with --rare: {WHY_ALONE[name]}; leave it out")


def event_of(text: str, scene: Scene) -> Event:
    """Return the event that is meant.

    Raises
    ------
    InputError
        If it is none.
    """
    from pgmp_petsc.scene.ensemble import Event

    labels = scene.ensemble.probabilities
    if text.strip() in labels:
        return labels[text.strip()]
    found = re.fullmatch(rf"\s*(ever\s+)?([A-Za-z_][\w-]*)\s*([<>])\s*({NUMBER})\s*", text)
    if found is None:
        known = f"; labels are {', '.join(labels)}" if labels else ""
        raise InputError(
            f'--rare "{shortened(text)}": allowed are an output, < or >, and a number, such as "slider_deformation < '
            '-2e-4", with "ever" before it for any time in the run, or the label of one of ensemble.probabilities'
            f"{known}"
        )
    ever, output, side, level = found.groups()
    if output not in scene.outputs:
        raise InputError(
            f'--rare "{shortened(text)}": there is no output {output}{nearest_name(output, scene.outputs)}'
        )
    if not np.isfinite(float(level)):
        raise InputError(f'--rare "{shortened(text)}": {level} is no finite number')
    return Event(output=output, when="ever" if ever else "end", **{"above" if side == ">" else "below": float(level)})


def run_rare(context: click.Context, model: Model, text: str, n_samples: int, seed: int, output: Path) -> int:
    """Find the probability of an event, write and report it; return the exit status. Collective on all ranks."""
    from pgmp_petsc.ensemble.rare_run import run_rare_event

    comm, said = context.obj.comm, model.scene.remarks
    result = run_rare_event(model, event_of(text, model.scene), n_samples, seed, comm)
    save(context, result, output)
    if result is not None:
        lines = [f"{output}: {result.model} model, {len(result.value)} samples", *lines_of(result)]
        lines += remark_lines(result.record, said)
        lines += [f"  {phase:24s}{seconds:14.2f} s" for phase, seconds in result.record.timings.items()]
        say(context, "\n".join(lines))
        say_figures(context, {"file": output, **summary_of(result)})
    return int(comm.bcast(None if result is None else not result.reached or result.n_failed > 0))


def lines_of(result: RareEvent) -> list[str]:
    """Return the levels and the probability of a rare event."""
    unit = "" if result.unit == "1" else f" {result.unit}"
    return [f"  rare event              {result.event}", *_levels(result, unit), *_probability(result)]


def _levels(result: RareEvent, unit: str) -> Iterator[str]:
    if len(result.threshold):
        yield f"  {'level':>7s}{'of ' + result.output + unit:>32s}{'share':>10s}{'so far':>12s}{'accepted':>10s}"
    reached = np.cumprod(result.share)
    for k, (threshold, share, accepted) in enumerate(zip(result.threshold, result.share, result.accepted), 1):
        yield f"  {k:7d}{threshold:32.6g}{share:10.3f}{reached[k - 1]:12.3g}{accepted:10.2f}"


def _probability(result: RareEvent) -> Iterator[str]:
    if not result.reached:
        yield "  probability             unknown: not reached"
        return
    low, high = result.interval
    n_weighted = int(np.count_nonzero(result.weight))
    yield (
        f"  probability             {result.estimate:.4g} [{low:.4g}, {high:.4g}], a {100 * result.confidence:g} % "
        f"interval; coefficient of variation {100 * result.variation:.2g} %"
    )
    plain = (1.0 / result.estimate - 1.0) / result.variation**2 if result.variation > 0.0 else np.inf
    yield (
        f"  {n_weighted} weighted samples, worth {result.n_effective:.0f} equally weighted ones in the event; as many "
        f"random samples as are as good: {plain:.2g}"
    )
