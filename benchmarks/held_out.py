"""Errors of a reduced model against the mesh with equal steps, at parameter values and a torque that built nothing.

    python -m benchmarks.held_out rom.h5 scenes/slider_crank_solid2d.toml t1 0.00925 0.0113

prints the largest error of every output over time and values, shares of their largest values: under the scene's own
loads, and with every torque over time in the place of a table of three slopes, up to 1.3 times its last value.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from mpi4py import MPI

from pgmp_petsc.dynamics.generalised_alpha import count_steps
from pgmp_petsc.experiments.history import errors_between, floors_of, run_history
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import FullModel, ReducedModel
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import Torque
from pgmp_petsc.studies.inputs import read_rom, read_scene

SHAPE = ((0.0, 0.0), (0.4, 0.7), (0.7, 1.3), (1.0, 0.4))  # of the duration, and of the last value


def with_other_torques(scene: Scene) -> Scene:
    """Return the scene with other tables of its torques."""
    duration, effects = scene.simulation.duration, dict(scene.effects)
    for name, effect in scene.effects.items():
        if isinstance(effect, Torque) and effect.table is not None:
            last = effect.table[-1][1]
            table = tuple((duration * time, last * share) for time, share in SHAPE)
            effects[name] = effect.model_copy(update={"table": table})
    return scene.model_copy(update={"effects": effects})


def main() -> None:
    """Read both models and compare them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rom", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("parameter")
    parser.add_argument("values", type=float, nargs="+")
    given = parser.parse_args()
    scene, rom = read_rom(given.rom, [], [], MPI.COMM_SELF)
    _, meshes = read_scene(given.scene, [], [], MPI.COMM_SELF, Purpose.FULL)
    values, n_samples = {given.parameter: np.array(given.values)}, len(given.values)
    n_steps = count_steps(scene.simulation.duration, scene.simulation.step)
    for words, one in (("own loads", scene), ("other torques", with_other_torques(scene))):
        full = FullModel(one, meshes)
        exact = run_history(full, values, n_samples, n_steps)
        found = run_history(ReducedModel(one, rom), values, n_samples, n_steps)
        errors = errors_between(found, exact, floors_of(full)).max(axis=1)
        print(f"{words}: " + ", ".join(f"{name} {error:.2g}" for name, error in zip(scene.outputs, errors)), flush=True)


if __name__ == "__main__":
    main()
