"""What derivatives of reduced runs cost, in runs a parameter.

    python -m benchmarks.gradients rom.h5 [-n REPETITIONS]

A run is what ``pgmp simulate`` computes of outputs: integration and outputs at every step, without estimates of errors.
Its derivatives are taken with the first parameter of the scene, then with all of them. Processor times, the least of
several taken in turns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from time import process_time

import numpy as np

from benchmarks.on_model import main
from benchmarks.programs import reduced_model
from pgmp_petsc.gradients.differentiated import differentiate
from pgmp_petsc.stepping.generalised_alpha import StateRecord, integrate


def run(rom: Path, n: int) -> None:
    """Print the table."""
    model = reduced_model(rom)
    scene = model.scene
    values = {name: np.array([value]) for name, value in scene.values.items()}

    def plain() -> None:
        record = StateRecord(lambda n_steps: None)
        integrate(model.batch(values, 1), scene.simulation, observer=record)
        times, states = record.states()
        model.outputs.evaluate(model.observed_of(times, states, scene.values))

    names = list(scene.parameters)
    chosen = [names[:1], names] if len(names) > 1 else [names]
    works = [plain, *(lambda own=own: differentiate(model, scene.values, own) for own in chosen)]
    of_run, *spent = least(works, n)
    n_steps = round(scene.simulation.duration / scene.simulation.step)
    print(f"{rom}: {model.terms.layout.n_eta} coordinates, {n_steps} steps, a run takes {1e3 * of_run:.2f} ms")
    print("| parameters | run and derivatives, ms | runs a parameter, beside the run itself |")
    print("| --- | --- | --- |")
    for own, seconds in zip(chosen, spent):
        print(f"| {len(own)} | {1e3 * seconds:.2f} | {(seconds - of_run) / of_run / len(own):.2f} |")


def least(works: Sequence[Callable[[], object]], n: int) -> list[float]:
    """Return the least processor times, taken in turns after one that compiles, s."""
    times = np.zeros((n + 1, len(works)))
    for row in times:
        for k, work in enumerate(works):
            start = process_time()
            work()
            row[k] = process_time() - start
    return times[1:].min(axis=0).tolist()


if __name__ == "__main__":
    main(__doc__, run, 20)
