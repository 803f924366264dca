"""``pgmp montecarlo``: many samples, and their distributions."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

from pgmp_petsc.cli import estimates
from pgmp_petsc.cli.options import output_option, scene_options
from pgmp_petsc.cli.report import save, say
from pgmp_petsc.ensemble.batch import Plan
from pgmp_petsc.ensemble.checkpoint import Checkpoint
from pgmp_petsc.ensemble.runner import run_ensemble
from pgmp_petsc.models import FullModel, Model, ReducedModel
from pgmp_petsc.results.ensemble import Ensemble
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.files import check_writable
from pgmp_petsc.scene import scene_to_toml
from pgmp_petsc.studies.inputs import read_rom, read_scene
from pgmp_petsc.studies.settled_step import settle_step


@click.command()
@click.argument("source", metavar="ROM.h5|SCENE", type=click.Path(path_type=Path))
@output_option
@click.option("-n", "n_samples", required=True, metavar="N", type=click.IntRange(min=1), help="Number of samples.")
@click.option("--seed", default=0, show_default=True, metavar="S", type=click.IntRange(min=0), help="Random seed.")
@click.option("--full", is_flag=True, help="Take the full-order model of a SCENE instead of a ROM.h5.")
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
    resume: bool,
    settings: tuple[str, ...],
    overrides: tuple[str, ...],
) -> None:
    """Integrate N samples of ROM.h5 (or with --full of a SCENE) and describe their distributions.

    Exit status 1 if some samples failed; they are recorded with their reason and the others go on.
    """
    comm = context.obj.comm
    on_root(comm, check_writable, output)
    model: Model
    if full:
        loaded, meshes = read_scene(source, overrides, settings, comm)
        with agreed(comm, "preparing the full-order model"):
            model = FullModel(loaded, meshes)
    else:
        loaded, rom = read_rom(source, overrides, settings, comm)
        with agreed(comm, "preparing the reduced model"):
            model = ReducedModel(loaded, rom)
    model, remark = settle_step(model, comm, ensemble=True)
    if remark:
        say(context, remark)
    plan = Plan(n_samples, seed, output, resume)
    ensemble = run_ensemble(model, plan, comm)
    save(context, ensemble, output)
    failed = 0
    if ensemble is not None:
        Checkpoint(plan, scene_to_toml(model.scene), model.name).remove()
        failed = int(np.sum(ensemble.status != 0))
        say(context, report(ensemble, output))
    if comm.bcast(failed):
        context.exit(1)


def report(ensemble: Ensemble, path: Path) -> str:
    """Return mean and standard deviation with their standard errors, failures by reason, and estimated errors."""
    n = len(ensemble.status)
    heading = f"  {'':24s}{'mean':>14s}  +- {'error':9s}{'std':>13s}  +- error"
    lines = [f"{path}: {ensemble.model} model, {n} samples", heading]
    for name, s in ensemble.statistics.items():
        lines.append(
            f"  {name:24s}{s.mean:14.7g}  +- {s.mean_standard_error:<9.2g}{s.std:13.6g}  +- {s.std_standard_error:.2g} "
            f"{ensemble.units[name]}"
        )
    for code in np.unique(ensemble.status[ensemble.status != 0]):
        count = int(np.sum(ensemble.status == code))
        lines.append(f"  {count} of {n} samples failed (status {code}): {ensemble.meanings[int(code)]}")
    if ensemble.validity:
        lines += estimates.of_ensemble(ensemble)
    lines += [f"  {remark}" for remark in ensemble.record.remarks]
    lines += [f"  {phase:24s}{seconds:14.2f} s" for phase, seconds in ensemble.record.timings.items()]
    return "\n".join(lines)
