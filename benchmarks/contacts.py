"""What contacts cost an ensemble of reduced models: batches as they are, and with their stops out of reach.

    python -m benchmarks.contacts rom.h5 --samples 64 512

An instant is one at which a sample enters or leaves a stop; here only those are counted that the ends of two steps tell
apart.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from time import process_time

import numpy as np

from benchmarks.called import Called
from benchmarks.programs import end, guarded, reduced_model
from benchmarks.tables import Table, number
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.ranks.petsc import start_petsc
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.second_order_system import State

REPEATS = 3
FAR = 1e6  # m or rad


def out_of_reach(path: Path) -> list[str]:
    """Return the overrides that put the stops of a ROM's scene where nothing comes to.

    Raises
    ------
    InputError
        If it has none.
    """
    effects = reduced_model(path).scene.effects
    stops = {name: entry for name, entry in effects.items() if entry.type == "end_stop"}
    if not stops:
        raise InputError(f"{path}: the scene has no end_stop; give a ROM of one that has")
    ends = (("lower", -FAR), ("upper", FAR))
    return [
        f"effects.{name}.{key}={far}"
        for name, stop in stops.items()
        for key, far in ends
        if getattr(stop, key) is not None
    ]


def seconds_of(model: ReducedModel, n: int) -> tuple[float, int]:
    """Return the processor time (s) of a batch of n samples, the least of some, and the number of its steps."""
    values, times = draw(model.scene, 0, 0, n), []
    for _ in range(REPEATS):
        system = model.batch(values, n)
        start = process_time()
        run = integrate(system, model.scene.simulation)
        times.append(process_time() - start)
    return min(times), run.n_steps


def instants_of(model: ReducedModel, n: int) -> int:
    """Return at how many instants the samples of a batch enter or leave stops."""
    system, seen = model.batch(draw(model.scene, 0, 0, n), n), []

    def look(number: int, time: float, state: State) -> None:
        seen.append(system.depths(np.array([time]), state.alone, np.ones(n, dtype=bool))[0] > 0.0)

    integrate(system, model.scene.simulation, observer=Called(look))
    return int(np.count_nonzero(np.diff(np.array(seen), axis=0)))


def measure(path: Path, sizes: Sequence[int]) -> Table:
    """Return the costs of batches of some sizes."""
    model, free = reduced_model(path), reduced_model(path, out_of_reach(path))
    rows = []
    for n in sizes:
        (seconds, n_steps), without, instants = seconds_of(model, n), seconds_of(free, n)[0], instants_of(model, n)
        a_step = number(1e6 * seconds / (n * n_steps), 3)
        figures = [number(seconds, 3), a_step, number(without, 3), str(instants)]
        rows.append([str(n), *figures])
    heads = ["samples", "s", "us a step and sample", "stops out of reach, s", "instants"]
    return Table(
        "Contacts in ensembles", heads, rows, f"Batches of the reduced model, processor time, least of {REPEATS}."
    )


def run(path: Path, sizes: Sequence[int]) -> None:
    """Print the table."""
    print(measure(path, sizes).markdown())


def main() -> int:
    """Measure what the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.contacts", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("rom", type=Path)
    parser.add_argument("--samples", type=int, nargs="+", default=[64, 512], metavar="N")
    given = parser.parse_args()
    start_petsc()
    return guarded(lambda: run(given.rom, given.samples))


if __name__ == "__main__":
    end(main())
