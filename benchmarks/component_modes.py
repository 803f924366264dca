"""What component modes leave of a run's error, mode by mode: component runs of a scene against its full-order run.

    .venv/bin/python -m benchmarks.component_modes scenes/slider_crank.toml --modes 2 4 8 --override reduction.modes=15

Errors are the largest differences of an output over time, as shares of its largest value. Both models take the same
steps: the error of the step is in both. Times are those of the integration, compiled beforehand.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from mpi4py import MPI

from pgmp_petsc.bench.reference import component_model
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import FullModel
from pgmp_petsc.results.trajectory import Trajectory
from pgmp_petsc.studies.inputs import read_scene
from pgmp_petsc.studies.simulate import simulate


def arguments() -> argparse.Namespace:
    """Return what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--modes", type=int, nargs="+", default=[2, 4, 8, 16], help="reduction.modes to try")
    parser.add_argument("--override", action="append", default=[], help="entry of the scene")
    return parser.parse_args()


def run(model: FullModel) -> Trajectory:
    """Run a model, once before over two steps so that all is compiled."""
    simulation = model.scene.simulation
    short = simulation.model_copy(update={"duration": 2.0 * simulation.step})
    simulate(model.with_loads(model.scene.model_copy(update={"simulation": short})), MPI.COMM_SELF)
    return simulate(model, MPI.COMM_SELF)


def shares(found: Trajectory, exact: Trajectory) -> dict[str, float]:
    """Return the largest difference of every output over its largest value."""
    return {
        name: float(np.max(np.abs(found.outputs[name] - values)) / np.max(np.abs(values)))
        for name, values in exact.outputs.items()
    }


def main() -> None:
    """Run the full-order model, then component models with more and more modes."""
    given = arguments()
    scene, meshes = read_scene(given.scene, given.override, (), MPI.COMM_SELF, Purpose.FULL)
    exact = run(FullModel(scene, meshes))
    names = list(exact.outputs)
    print(f"full order: {exact.record.timings['integration']:.2f} s")
    print("| modes | amplitudes | " + " | ".join(names) + " | integration, s |")
    print("|---|---|" + "---|" * (len(names) + 1))
    for n_modes in given.modes:
        overrides = (*given.override, f"reduction.modes={n_modes}")
        scene, meshes = read_scene(given.scene, overrides, (), MPI.COMM_SELF, Purpose.COMPONENTS)
        model = component_model(scene, meshes, MPI.COMM_SELF)
        found = run(model)
        errors = " | ".join(f"{error:.2g}" for error in shares(found, exact).values())
        seconds = found.record.timings["integration"]
        print(f"| {n_modes} | {sum(model.n_amplitudes.values())} | {errors} | {seconds:.2f} |", flush=True)


if __name__ == "__main__":
    main()
