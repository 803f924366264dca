"""What a reduced basis and its samples leave of stresses: largest von Mises stress of every body against the mesh's.

    python -m benchmarks.stresses scenes/slider_crank_solid2d.toml

The scene's bodies are of cells. Every one gets a stress output, and the mechanism is run for `DURATION` on its meshes,
with component modes, and reduced: by modes alone, with the static answers to loads and to inertia forces, and with
fewer sampled angles. Printed are the largest differences over time, as shares of the largest stress on the mesh.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from mpi4py import MPI

from benchmarks.programs import end, guarded
from benchmarks.tables import Table
from pgmp_petsc.bench.reference import component_model
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import FullModel, ReducedModel
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.ranks.petsc import start_petsc
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.results.trajectory import Trajectory
from pgmp_petsc.scene import load_scene
from pgmp_petsc.studies.inputs import read_scene
from pgmp_petsc.studies.simulate import simulate

DURATION = 0.25  # s
MODES = (3, 6, 12)
ANSWERS = ((), ("inertia_modes",), ("static_modes",), ("static_modes", "inertia_modes"))
ANGLES = (12, 24, 48, 96)


def reduced(path: Path, overrides: list[str], modes: int, answers: tuple[str, ...], angles: int) -> Trajectory:
    """Return a run of the model with a reduction of its own."""
    own = [f"reduction.modes={modes}", f"reduction.angles={angles}"]
    own += [f"reduction.{key}={str(key in answers).lower()}" for key in ("static_modes", "inertia_modes")]
    scene, meshes = read_scene(path, [*overrides, *own], (), MPI.COMM_SELF, Purpose.BUILD)
    with RankGroup.split(MPI.COMM_SELF, 1) as group:
        return simulate(ReducedModel(scene, build_rom(scene, meshes, group)), MPI.COMM_SELF)


def run(path: Path) -> None:
    """Measure, and print the tables."""
    bodies = list(load_scene(path).bodies)
    overrides = [f'outputs.{name}={{type="stress", body="{name}", quantity="von_mises"}}' for name in bodies]
    overrides += [f"simulation.duration={DURATION}", "simulation.frames=2"]
    scene, meshes = read_scene(path, overrides, (), MPI.COMM_SELF, Purpose.FULL)
    exact = simulate(FullModel(scene, meshes), MPI.COMM_SELF).outputs

    def cells(found: Trajectory) -> list[str]:
        away = (np.max(np.abs(found.outputs[name] - exact[name])) / np.max(exact[name]) for name in bodies)
        return [f"{100 * share:.2g} %" for share in away]

    components = component_model(scene, meshes, MPI.COMM_SELF)
    rows = [["component modes", "", *cells(simulate(components, MPI.COMM_SELF))]]
    for answers in ANSWERS:
        rows += [
            [f"{n} modes", ", ".join(answers), *cells(reduced(path, overrides, n, answers, ANGLES[2]))] for n in MODES
        ]
    words = f"Largest von Mises stress of a body over {DURATION:g} s; {ANGLES[2]} angles."
    print(Table("What a basis leaves of stresses", ["model", "static answers", *bodies], rows, words).markdown())
    rows = [[str(n), *cells(reduced(path, overrides, MODES[1], ANSWERS[-1], n))] for n in ANGLES]
    words = f"The same with {MODES[1]} modes and both answers."
    print("\n" + Table("What sampled angles leave", ["angles", *bodies], rows, words).markdown())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    arguments = parser.parse_args()
    start_petsc()
    end(guarded(lambda: run(arguments.scene)))
