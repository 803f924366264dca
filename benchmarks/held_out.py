"""Errors of a reduced model against the mesh with equal steps, at parameter values and loads that built nothing.

    python -m benchmarks.held_out rom.h5 scenes/slider_crank_solid2d.toml t1 0.00925 0.0113
    python -m benchmarks.held_out rom.h5 scenes/slider_crank_solid3d.toml E1 1.93e11 2.24e11 --reference components

prints the largest error of every output over time and values, shares of their largest values: under the scene's own
loads, and under others. These have a table of three slopes, up to 1.3 times its last value, in the place of every
torque and force over time, and harmonics 1.3 times as large and 1.3 times as fast. Where a mesh is dear, the component
model with half as many modes again may take its place.
"""

from __future__ import annotations

import argparse
from math import ceil
from pathlib import Path

import numpy as np
from mpi4py import MPI

from benchmarks.programs import end, guarded, reduced_model
from pgmp_petsc.bench.history import errors_between, floors_of, run_history
from pgmp_petsc.bench.reference import component_model
from pgmp_petsc.effects.loads import Force, Torque
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import FullModel, ReducedModel
from pgmp_petsc.ranks.petsc import start_petsc
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.fields import Harmonic
from pgmp_petsc.studies.inputs import read_scene

SHAPE = ((0.0, 0.0), (0.4, 0.7), (0.7, 1.3), (1.0, 0.4))  # of the duration, and of the last value
LARGER = 1.3  # harmonics
MORE_MODES = 1.5  # of the component model


def with_other_loads(scene: Scene) -> Scene:
    """Return the scene with other torques and forces over time."""
    duration, effects = scene.simulation.duration, dict(scene.effects)
    for name, effect in scene.effects.items():
        if not isinstance(effect, (Torque, Force)):
            continue
        if effect.table is not None:
            last = effect.table[-1][1]
            changed = {"table": tuple((duration * time, last * share) for time, share in SHAPE)}
        else:
            changed = {"harmonic": _larger(effect.harmonic)}
        effects[name] = effect.model_copy(update=changed)
    return scene.model_copy(update={"effects": effects})


def _larger(harmonic: Harmonic) -> Harmonic:
    changed = {name: LARGER * getattr(harmonic, name) for name in ("amplitude", "frequency_hz")}
    return harmonic.model_copy(update=changed)


def main() -> int:
    """Read both models and compare them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rom", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("parameter")
    parser.add_argument("values", type=float, nargs="+")
    parser.add_argument("--reference", choices=("full", "components"), default="full")
    given = parser.parse_args()
    start_petsc()
    return guarded(lambda: print_errors(given))


def print_errors(given: argparse.Namespace) -> None:
    """Run both models under all loads and print how far they are apart."""
    model = reduced_model(given.rom)
    scene, rom = model.scene, model.rom
    _, meshes = read_scene(given.scene, [], [], MPI.COMM_SELF, Purpose.FULL)
    values, n_samples = {given.parameter: np.array(given.values)}, len(given.values)
    n_steps = scene.simulation.n_steps
    if given.reference == "full":
        reference = FullModel(scene, meshes)
    else:
        reference = component_model(scene, meshes, MPI.COMM_SELF, ceil(MORE_MODES * rom.tables.n_modes))
    for words, one in (("own loads", scene), ("other loads", with_other_loads(scene))):
        exact = run_history(reference.with_loads(one), values, n_samples, n_steps)
        found = run_history(ReducedModel(one, rom), values, n_samples, n_steps)
        errors = errors_between(found, exact, floors_of(reference)).max(axis=1)
        print(f"{words}: " + ", ".join(f"{name} {error:.2g}" for name, error in zip(scene.outputs, errors)), flush=True)


if __name__ == "__main__":
    end(main())
