"""What one run of a reduced model takes in the processor, beyond reading the file and loading compiled code.

    python -m benchmarks.single_run ROM.h5 -n 8

The best of n runs after a first one: all of it; steps with what looks on (`integration`), outputs and energies
(`projection`), error estimates (`errors`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

from mpi4py import MPI

from benchmarks.on_model import main
from benchmarks.programs import reduced_model
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.studies import simulate


def run(path: Path, n: int) -> None:
    """Time a model's run, and print what its parts take."""
    model, best = reduced_model(path), {}
    scene = model.scene

    def once() -> dict[str, float]:
        start = time.process_time()
        found = simulate.simulate(model, MPI.COMM_SELF)
        return {"all": time.process_time() - start, **found.record.timings}

    with patch.object(simulate, "Timings", _of_processor):
        once()
        for _ in range(n):
            best = {part: min(seconds, best.get(part, seconds)) for part, seconds in once().items()}
    n_steps = scene.simulation.n_steps
    print(f"{n_steps} steps of {scene.name}, processor time, best of {n}:")
    for part, seconds in best.items():
        print(f"  {part:12s}{1e3 * seconds:8.1f} ms")


def _of_processor(clock: Callable[[], float] = time.process_time) -> Timings:
    return Timings(clock=clock)


if __name__ == "__main__":
    main(__doc__, run, 8)
