"""How far a batch of the full-order model is from the speed of the machine: operations of a step over its time.

    python -m benchmarks.full_floor scenes/slider_crank.toml -n 256
    python -m benchmarks.full_floor scenes/slider_crank.toml -n 64 \
        --override 'bodies.crank.mesh="../meshes/crank_40.msh"' --override 'bodies.rod.mesh="../meshes/rod_40.msh"'

For a mechanism of beams in the plane. Additions and multiplications that a step of one sample needs are counted: those
of an element by calling its functions with numbers that count, those of the factorisation from its pattern. Each is one
operation, and the largest number of them in a second is measured with products that are added up in registers, by the
same vectors. What samples wait for each other within vectors, because one needs another correction, is not needed; nor
is what is read and written, whose time at the speed of a copy is given beside it.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from time import process_time

import numpy as np
from mpi4py import MPI

from benchmarks.programs import end, guarded
from pgmp_petsc.bodies import beam2d
from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.full.systems import FullBatch
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import aligned, fused, items, width_of
from pgmp_petsc.lanes.vectors import LANES
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import FullModel
from pgmp_petsc.ranks.petsc import start_petsc
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.studies.inputs import read_scene

REPEATS, TURNS = 5, 1_000_000
CHAINS = 6  # as many sums at once as hide the time that one takes, and fit the registers
SINE_AND_COSINE = 50
PREDICTED, FOLLOWED, CORRECTED = 20, 6, 8  # of every unknown


class Counting:
    """A number that counts the operations of all such numbers."""

    done = 0

    def _count(self, _: object = None) -> Counting:
        Counting.done += 1
        return self

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __rtruediv__ = _count

    def __neg__(self) -> Counting:
        return self


def of_element(fresh: bool) -> int:
    """Return the operations of an element: its forces and inertia, and what it adds to the matrix where `fresh`."""
    Counting.done, one = 0, Counting()
    six, three = (one,) * 6, (one,) * 3
    beam2d.strains.py_func(six, one, one, one)
    beam2d.stresses.py_func(three, three)
    beam2d.forces.py_func(three, three, one, one, one)
    inertia = 6 * 4 + 2  # rho (a_i + a_j / 2) added to every force, and that to the residual
    found = Counting.done + SINE_AND_COSINE + inertia
    if fresh:
        Counting.done = 0
        beam2d.fill_tangent.py_func(three, three, three, one, one, one, [one] * beam2d.N_PACKED)
        found += Counting.done + 2 * 3 + 2 + 3 + 6 + beam2d.N_PACKED  # gains, masses, and adding up
    return found


def of_step(system: FullBatch, corrections: float) -> float:
    """Return the operations of a step of one sample, with a number of corrections on the mean."""
    problem = system._equations.problem
    entries_below = np.diff(problem.pattern.starts)
    n, n_elements = entries_below.size, problem.elements.length.size
    factorisation = float(np.sum(entries_below * (entries_below + 1) + entries_below + 1))
    bound = 4 * problem.constraints.rows.slopes.size + 4 * problem.lumps.dofs.size
    correction = n_elements * of_element(False) + bound + 4 * entries_below.sum() + 2 * n + CORRECTED * system.n_dofs
    fresh = n_elements * (of_element(True) - of_element(False)) + bound + factorisation
    return fresh + corrections * correction + (PREDICTED + FOLLOWED) * system.n_dofs


@njit(error_model="numpy")
def _multiply(turns, width, numbers):
    x = items(numbers, width)
    a, b, c, d, e, f = x[0], x[1], x[2], x[3], x[4], x[5]
    for _ in range(turns):
        a, b, c = fused(a, 0.5, 1.0), fused(b, 0.5, 1.0), fused(c, 0.5, 1.0)
        d, e, f = fused(d, 0.5, 1.0), fused(e, 0.5, 1.0), fused(f, 0.5, 1.0)
    x[0] = a + b + c + d + e + f


def largest_rate() -> float:
    """Return the most operations in a second, by vectors in registers."""
    numbers, width, times = aligned((CHAINS, LANES)), width_of(LANES), []
    numbers[:] = 1.0
    _multiply(1, width, numbers)
    for _ in range(REPEATS):
        start = process_time()
        _multiply(TURNS, width, numbers)
        times.append(process_time() - start)
    return 2 * CHAINS * LANES * TURNS / min(times)


def bandwidth() -> float:
    """Return the bytes that a copy of large arrays reads and writes in a second."""
    source, times = np.ones(2**23), []
    target = source.copy()
    for _ in range(REPEATS):
        start = process_time()
        np.copyto(target, source)
        times.append(process_time() - start)
    return 2 * source.nbytes / min(times)


def run(path: Path, n_samples: int, overrides: Sequence[str]) -> None:
    """Measure a scene, and print what was found."""
    scene, meshes = read_scene(path, overrides, [], MPI.COMM_SELF, Purpose.FULL)
    model, values = FullModel(scene, meshes), draw(scene, 0, 0, n_samples)
    times = []
    for _ in range(REPEATS):
        with model.batch(values, n_samples) as system:
            start = process_time()
            done = integrate(system, scene.simulation)
            times.append((process_time() - start) / (done.n_steps * n_samples))
    corrections = done.counted[0] / (done.n_steps * n_samples)
    operations, rate = of_step(system, corrections), largest_rate()
    kept = 8 * (4 * system.n_dofs + system.n_constraints + 1)
    print(f"{path.stem}, {system.n_dofs} unknowns, {n_samples} samples, {corrections:.2f} corrections a step")
    print(f"  time of a step and sample       {min(times) * 1e6:8.3f} us")
    print(f"  operations of it                {operations:8.0f}")
    print(f"  rate, largest measured          {operations / min(times) / 1e9:8.1f} of {rate / 1e9:.1f} Gflop/s")
    print(f"  time at the largest rate        {operations / rate * 1e6:8.3f} us")
    print(f"  share of it                     {operations / rate / min(times) * 100:8.1f} %")
    print(f"  time to write {kept:5d} bytes       {kept / bandwidth() * 1e6:8.3f} us, at the speed of a copy")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.full_floor", description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("-n", type=int, default=256, help="number of samples")
    parser.add_argument("--override", action="append", default=[], help="entry of the scene, as for pgmp")
    arguments = parser.parse_args()
    start_petsc()
    return guarded(lambda: run(arguments.scene, arguments.n, arguments.override))


if __name__ == "__main__":
    end(main())
