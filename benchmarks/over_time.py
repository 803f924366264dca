"""What outputs over time cost an ensemble, and the memory that describing many samples takes.

    python -m benchmarks.over_time cost rom.h5
    python -m benchmarks.over_time memory rom.h5 -n 1000000

`cost` integrates a batch of samples without looking at it, with the bands of the scene, with extremes, and with both.
`memory` puts made-up samples into pieces, as ranks do, and describes them: the largest memory of the process before and
after.
"""

from __future__ import annotations

import argparse
import resource
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import numpy as np

from benchmarks.programs import end, guarded, reduced_model
from benchmarks.tables import Table
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.ensemble.checkpoint import Checkpoint
from pgmp_petsc.ensemble.description import describe_ensemble
from pgmp_petsc.ensemble.integration import run_batch
from pgmp_petsc.ensemble.plan import Batch, Piece, Plan
from pgmp_petsc.ensemble.sampling import Sampler, draw
from pgmp_petsc.ensemble.watchers import Watching, watch_over_time
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.ranks.petsc import start_petsc
from pgmp_petsc.results.estimates import VALIDITY
from pgmp_petsc.scene import scene_to_toml

N_BATCH, REPEATS, SIZE = 512, 4, 500
UNCHECKED = "ensemble.checked_share=0.0"
ASKED = {
    "nothing": ("ensemble.bands=0",),
    "bands": (),
    "extremes": ("ensemble.bands=0", "ensemble.extremes=true"),
    "both": ("ensemble.extremes=true",),
}


def model_of(path: Path, overrides: Sequence[str]) -> ReducedModel:
    """Return the reduced model with other figures asked for."""
    return reduced_model(path, (UNCHECKED, *overrides))


def cost(path: Path) -> Table:
    """Return the processor time of a batch, the least of some."""
    rows = []
    for name, overrides in ASKED.items():
        model, times = model_of(path, overrides), []
        values, watchers = draw(model.scene, 0, 0, N_BATCH), Watching(model).of(Piece(0, N_BATCH))
        for _ in range(REPEATS):
            start = process_time()
            run_batch(model, values, watchers=watchers)
            times.append(process_time() - start)
        rows.append([name, f"{min(times):.2f}"])
    words = f"{N_BATCH} samples, processor time, least of {REPEATS}."
    return Table("Outputs over time", ["asked for", "s"], rows, words)


def memory(path: Path, n: int) -> str:
    """Return the largest memory of the process before and after it describes n samples."""
    model = model_of(path, ['ensemble.sampler="sobol"', "ensemble.extremes=true"])
    scene, random = model.scene, np.random.default_rng(0)
    with TemporaryDirectory() as folder:
        plan = Plan(n, 0, Path(folder) / "many.h5")
        sampler, checkpoint = Sampler(scene, plan), Checkpoint(plan, scene_to_toml(scene), model.name, model.identity)
        checkpoint.open()
        for first in range(0, n, SIZE):
            size = min(SIZE, n - first)
            values = random.normal(size=size)
            empty = watch_over_time(model, first < scene.ensemble.band_samples).empty(size)
            found = {
                kind: {
                    name: np.ascontiguousarray(np.broadcast_to(values.reshape(-1, *[1] * (one.ndim - 1)), one.shape))
                    for name, one in arrays.items()
                }
                for kind, arrays in empty.items()
            }
            numerics = {"steps_divided": np.ones(size), "unstable_start": np.zeros(size)}
            outputs = dict.fromkeys(model.outputs.functions, values)
            validity = dict.fromkeys(VALIDITY, np.abs(values) * 1e-6)
            drawn = sampler.draw(first, first + size)
            status = np.zeros(size, dtype=int)
            batch = Batch(first, drawn, outputs, status, np.full(size, np.nan), numerics, validity=validity, **found)
            checkpoint.add(Piece(first, first + size), batch)
        before, start = _megabytes(), process_time()
        described = describe_ensemble(model, plan, sampler, checkpoint, 1, Timings())
        seconds = process_time() - start
        described.write(plan.output)
    return f"{n} samples: {before:.0f} MB before, {_megabytes():.0f} MB after {seconds:.0f} s of describing and writing"


def _megabytes() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def main(arguments: argparse.Namespace) -> None:
    """Measure what is asked for, and print it."""
    print(cost(arguments.rom).markdown() if arguments.what == "cost" else memory(arguments.rom, arguments.n))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("cost", "memory"))
    parser.add_argument("rom", type=Path, help="reduced model of a scene with uncertain parameters")
    parser.add_argument("-n", type=int, default=1_000_000, help="number of samples")
    arguments = parser.parse_args()
    start_petsc()
    end(guarded(lambda: main(arguments)))
