"""Cost: wall times of the main job, and the processor time a sample takes on a coarse and on a fine mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time

from mpi4py import MPI

from benchmarks.paper.results import MODELS, PaperResults
from benchmarks.programs import reduced_model
from benchmarks.tables import Table, number
from pgmp_petsc.ensemble.integration import run_batch
from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import FullModel, Model
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.studies.inputs import read_scene

FINE = ('bodies.crank.mesh="../meshes/crank_40.msh"', 'bodies.rod.mesh="../meshes/rod_40.msh"')
ROMS = {5: "rom.h5", 40: "rom_40_elements.h5"}
N_SAMPLES, N_REPEATS, SEED = 128, 2, 1


@dataclass(frozen=True)
class Cost:
    """Processor time of one sample of 1 s, in s, by model, on a mesh of n_elements a body."""

    n_elements: int
    n_unknowns: int
    n_modes: int
    full: float
    reduced: float

    @property
    def speed_up(self) -> float:
        """How many times cheaper the reduced model is."""
        return self.full / self.reduced

    @property
    def in_words(self) -> str:
        """What the reduction gains."""
        where = f"With the same step and {self.n_elements} elements a body"
        if self.speed_up > 1.25:
            return f"{where} the paper's 15 modes are {number(self.speed_up, 2)} times as fast as the full-order model."
        if self.speed_up > 0.8:
            return (
                f"{where} the full-order model is about as fast as the reduced one: the reduction does not pay there."
            )
        return f"{where} the full-order model is {number(1 / self.speed_up, 2)} times as fast as the reduced one."


def measure(scene: Path, directory: Path) -> list[Cost]:
    """Measure both models on both meshes, in this process alone."""
    costs = []
    for n_elements, overrides in ((5, ()), (40, FINE)):
        loaded, meshes = read_scene(scene, overrides, (), MPI.COMM_SELF, Purpose.FULL)
        full = FullModel(loaded, meshes)
        reduced = reduced_model(directory / ROMS[n_elements])
        mechanism = full.kinematics.mechanism
        n_unknowns = mechanism.n_dofs + mechanism.n_constraints
        costs.append(
            Cost(
                n_elements,
                n_unknowns,
                reduced.rom.tables.n_modes,
                seconds_a_sample(full),
                seconds_a_sample(reduced),
            )
        )
    return costs


def seconds_a_sample(model: Model) -> float:
    """Return the processor time of a sample, the least of some batches; compiling is left out."""
    run_batch(model, draw(model.scene, SEED, 0, 1))
    values, times = draw(model.scene, SEED, 0, N_SAMPLES), []
    for _ in range(N_REPEATS):
        start = process_time()
        run_batch(model, values)
        times.append((process_time() - start) / N_SAMPLES)
    return min(times)


def wall_table(results: PaperResults) -> Table:
    """Show the wall times that the result files carry."""
    rows = []
    for n_elements, name in ROMS.items():
        record = ReducedOrderModel.read(results.directory / name).record
        seconds = sum(record.timings.values())
        rows.append([f"offline build, {n_elements} elements a body", f"{seconds:.2f} s", str(record.ranks), ""])
    for model in MODELS:
        ensemble = results.ensembles[model]
        record, n = ensemble.record, len(ensemble.status)
        seconds = record.timings["integration"]
        rows.append(
            [
                f"Monte Carlo, {'full order' if model == 'full' else model}, {n} samples",
                f"{seconds:.2f} s",
                str(record.ranks),
                f"{1e3 * seconds * record.ranks / n:.3g} ms",
            ]
        )
    return Table("Wall times of this run", ("job", "wall time", "ranks", "a sample and rank"), rows)


def cost_table(costs: Sequence[Cost]) -> Table:
    """Show the cost of a sample, and say what the reduction saves."""
    rows = [
        [
            f"{cost.n_elements} elements a body",
            f"{cost.n_unknowns}, {1 + cost.n_modes}",
            f"{1e3 * cost.full:.3g} ms",
            f"{1e3 * cost.reduced:.3g} ms",
            number(cost.speed_up, 2),
        ]
        for cost in costs
    ]
    header = ("mesh", "unknowns, full and reduced", "full order", "reduced", "full / reduced")
    before = (
        f"Processor time of one sample (1 s of motion), one process, batches of {N_SAMPLES}, least of {N_REPEATS}. The "
        "baseline is this program's own batched full-order code, the fastest one at hand."
    )
    return Table(
        "Cost of a sample, and what the reduction saves",
        header,
        rows,
        before,
        " ".join(cost.in_words for cost in costs),
    )
