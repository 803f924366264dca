"""What the reduction saves at equal error: processor time of a sample, full order against reduced, step by step.

Errors are the largest over time and over samples that span the parameters, as shares of the outputs' largest values,
against the full-order model of the same mesh with a far smaller step. Both models may take any step: for every error
that is asked for, the cheapest run counts that leaves no more of it in any output. A basis that leaves more than any of
these is compared at the least error that it leaves. Processor times are those of whole batches, with all that a sample
takes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from time import process_time

import numpy as np
from mpi4py import MPI

from benchmarks.paper.cost import FINE, ROMS
from benchmarks.programs import reduced_model
from benchmarks.tables import Table, number
from pgmp_petsc.bench.history import errors_between, floors_of, run_history
from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import FullModel, ReducedModel
from pgmp_petsc.scene.parameters import spanning_values
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.studies.inputs import read_scene

SMALL_ROMS = {5: "rom_small.h5", 40: "rom_small_40_elements.h5"}
# of 1 s: 31 ms to 2 ms; all have an instant where the torque's curve bends
STEPS = (32, 40, 48, 56, 64, 72, 80, 96, 112, 128, 144, 160, 192, 256, 512)
EXACT_STEPS = 32 * STEPS[-1]
WANTED = (0.1, 0.02, 0.01)  # what the paper's modes leave first; vibrations that no such step resolves leave 0.6 %
N_FULL, N_REDUCED, N_REPEATS, SEED = 512, 2048, 2, 1  # larger batches cost no less a sample


@dataclass(frozen=True)
class Run:
    """One model with one number of steps: its largest error, a share, and processor seconds of a sample."""

    n_steps: int
    error: float
    seconds: float


@dataclass(frozen=True)
class Comparison:
    """Runs of the full-order model of a mesh, and of its reduced models by name."""

    n_elements: int
    full: Sequence[Run]
    reduced: Mapping[str, Sequence[Run]]


def measure(scene: Path, directory: Path) -> list[Comparison]:
    """Measure the models of both meshes, in this process alone."""
    comparisons = []
    for n_elements, overrides in ((5, ()), (40, FINE)):
        roms = {"the paper's 15 modes": ROMS[n_elements], "scenes/slider_crank.toml": SMALL_ROMS[n_elements]}
        found = {name: directory / file for name, file in roms.items()}
        comparisons.append(compare(scene, overrides, n_elements, found))
    return comparisons


def compare(scene: Path, overrides: Sequence[str], n_elements: int, roms: Mapping[str, Path]) -> Comparison:
    """Measure the models of one mesh."""
    loaded, meshes = read_scene(scene, overrides, (), MPI.COMM_SELF, Purpose.FULL)
    full = FullModel(loaded, meshes)
    values, n_samples = spanning_values(loaded)
    exact = {n: run_history(full, values, n_samples, n) for n in {exact_steps(n_steps) for n_steps in STEPS}}

    def runs(model: FullModel | ReducedModel, n_batch: int) -> list[Run]:
        found = []
        for n_steps in STEPS:
            history = run_history(model, values, n_samples, n_steps)
            error = float(np.max(errors_between(history, exact[exact_steps(n_steps)], floors_of(full))))
            found.append(Run(n_steps, error, seconds_a_sample(model, n_steps, n_batch)))
        return found

    reduced = {name: reduced_model(path) for name, path in roms.items()}
    return Comparison(n_elements, runs(full, N_FULL), {name: runs(model, N_REDUCED) for name, model in reduced.items()})


def exact_steps(n_steps: int) -> int:
    """Return the steps of the run that one with `n_steps` is compared with: doubled, so that it has its instants."""
    while n_steps < EXACT_STEPS:
        n_steps *= 2
    return n_steps


def seconds_a_sample(model: FullModel | ReducedModel, n_steps: int, n_batch: int) -> float:
    """Return the processor time of a sample in a batch of random ones, the least of some batches."""
    values, simulation, times = draw(model.scene, SEED, 0, n_batch), model.scene.simulation.in_steps(n_steps), []
    for _ in range(N_REPEATS):
        start = process_time()
        integrate(model.batch(values, n_batch), simulation)
        times.append((process_time() - start) / n_batch)
    return min(times)


def cheapest(runs: Sequence[Run], error: float) -> Run | None:
    """Return the cheapest run that leaves no more than an error; None where all leave more."""
    return min((run for run in runs if run.error <= error), key=lambda run: run.seconds, default=None)


def least_error(runs: Sequence[Run]) -> float:
    """Return the least error that a model leaves with any step, rounded up to a whole per cent."""
    return ceil(100.0 * min(run.error for run in runs)) / 100.0


def savings(comparison: Comparison, name: str) -> dict[float, float]:
    """Return how many times less a sample of a reduced model costs than a full-order one, by the error of both.

    A model that leaves more than all that are wanted is compared at the least error that it leaves.
    """
    runs, saved = comparison.reduced[name], {}
    for error in WANTED if least_error(runs) <= max(WANTED) else (least_error(runs),):
        full, reduced = cheapest(comparison.full, error), cheapest(runs, error)
        if full and reduced:
            saved[error] = full.seconds / reduced.seconds
    return saved


def equal_error_table(comparisons: Sequence[Comparison]) -> Table:
    """Show for every mesh, reduced model and error what a sample costs, and how many times less it is than full."""
    rows = []
    for one in comparisons:
        for name, runs in one.reduced.items():
            saved = savings(one, name)
            for error in sorted({*WANTED, *saved}, reverse=True):
                cells = [_cell(cheapest(found, error)) for found in (one.full, runs)]
                ratio = number(saved[error], 2) if error in saved else "not reached"
                rows.append([f"{one.n_elements} elements a body", name, f"{100 * error:g} %", *cells, ratio])
    header = ("mesh", "reduced model", "largest error", "full order", "reduced", "full / reduced")
    before = (
        "Processor time of a sample with the cheapest step that leaves no more than an error, of the largest value of "
        f"any output at any instant and over the parameters, against {EXACT_STEPS} or more steps of the full-order "
        "model. In brackets the steps of 1 s, and the error. A basis that leaves more than all of these is compared at "
        f"the least error that it leaves. One process, batches of {N_FULL} full-order and {N_REDUCED} reduced samples "
        f"(`ensemble.batch`), least of {N_REPEATS}."
    )
    return Table("What the reduction saves at equal error", header, rows, before)


def in_words(comparison: Comparison) -> str:
    """Return what each reduced model saves at the errors that it reaches."""
    parts = []
    for name in comparison.reduced:
        saved = savings(comparison, name)
        if saved:
            times = [number(ratio, 2) for ratio in sorted(saved.values())]
            errors = [number(100.0 * error, 2) for error in sorted(saved)]
            parts.append(f"with {name} a reduced sample costs {_span(times)} times less ({_span(errors)} %)")
        else:
            parts.append(f"with {name} no step of the full-order model is as good")
    where = f"At the same error, with {comparison.n_elements} elements a body and each model with its best step,"
    return f"{where} {', '.join(parts)}."


def _span(in_order: Sequence[str]) -> str:
    """Return the first and the last of some values, or the only one."""
    return " to ".join(dict.fromkeys((in_order[0], in_order[-1])))


def _cell(run: Run | None) -> str:
    if run is None:
        return "not reached"
    return f"{1e3 * run.seconds:.3g} ms ({run.n_steps}, {100 * run.error:.2g} %)"
