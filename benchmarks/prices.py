"""What steps of the models take: measured, beside what `bench.prices` predicts from sizes.

python -m benchmarks.prices SCENE ... [-n 512] [--set ENTRY=VALUE] [--outputs]
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from time import process_time

from mpi4py import MPI

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bench.prices import prospects, reduced_step, step_seconds
from pgmp_petsc.bench.reference import component_model
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.ensemble.integration import run_batch
from pgmp_petsc.ensemble.plan import Piece
from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.ensemble.watchers import Watching
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import FullModel, ReducedModel
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.numerics import count_steps
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.studies.inputs import read_scene

N_SAMPLES = 8  # as many as fill the lanes
SECONDS = 3.0  # of a measurement
WITH_OUTPUTS = "ensemble.extremes=true", "ensemble.checked_share=0.0", "ensemble.bands=0"


def reduced(scene: Scene, meshes: Mapping[str, BodyShape]) -> ReducedModel:
    return ReducedModel(scene, build_rom(scene, meshes, RankGroup.split(MPI.COMM_SELF, 1)))


def predicted(model: FullModel | ReducedModel) -> float:
    """Return what a step of a sample is predicted to take, s."""
    if not isinstance(model, ReducedModel):
        return step_seconds(model.kinematics.mechanism)
    n_local = sum(effect.local for effect in model.scene.effects.values())
    tables = model.rom.tables
    return reduced_step(tables.n_modes, tables.n_coordinates, model.scene.second_order, n_local)


def measured(model: FullModel | ReducedModel, n_samples: int) -> float:
    """Return the processor time of a step of a sample, in a batch of as many, s."""
    scene, n = model.scene, min(n_samples, model.largest_batch)
    values = draw(scene, 0, 0, n)
    step = scene.simulation.step
    # no longer than the scene's own run: beyond, it may go faster than its step can follow
    most = count_steps(scene.simulation.duration, step)
    affordable = int(SECONDS / (n * predicted(model)))
    for n_steps in (4, min(max(8, affordable), most)):
        simulation = scene.simulation.model_copy(update={"duration": n_steps * step})
        with closing(model.batch(values, n)) as system:
            begin = process_time()
            integrate(system, simulation)
            seconds = (process_time() - begin) / (n * n_steps)
    return seconds


def with_outputs(scene: Scene, meshes: Mapping[str, BodyShape], n: int) -> tuple[float, float]:
    """Return what a step of a sample of the reduced model, whose outputs are found after every step, is predicted to
    take and takes, s: whole runs, the quicker of two, as the first may compile."""
    model, seconds = reduced(scene, meshes), []
    for _ in range(2):
        begin = process_time()
        run_batch(model, draw(scene, 0, 0, n), watchers=Watching(model).of(Piece(0, n)))
        seconds.append((process_time() - begin) / (n * scene.simulation.n_steps))
    found = prospects(scene, meshes, model.kinematics.mechanism, model.rom.tables.n_modes, 0)
    return next(one.step for one in found if one.model == model.name), min(seconds)


def main() -> None:
    """Print a line for every model of every scene."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.prices", description=__doc__.splitlines()[0])
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("-n", type=int, default=N_SAMPLES, help="number of samples in the batch")
    parser.add_argument("--set", action="append", default=[], help="ENTRY=VALUE of the scenes")
    parser.add_argument("--outputs", action="store_true", help="of reduced models alone, with outputs at every step")
    given = parser.parse_args()
    settings = (*given.set, *(WITH_OUTPUTS if given.outputs else ()))
    print(f"{'scene':24s}{'model':12s}{'unknowns':>9s}{'predicted us':>14s}{'measured us':>14s}")
    for path in given.scenes:
        scene, meshes = read_scene(path, settings, (), MPI.COMM_SELF, Purpose.FULL)
        if given.outputs:
            expected, taken = with_outputs(scene, meshes, given.n)
            print(f"{scene.name:24s}{'reduced':21s}{1e6 * expected:14.3g}{1e6 * taken:14.3g}", flush=True)
            continue
        for make in (FullModel, lambda scene, meshes: component_model(scene, meshes, MPI.COMM_SELF), reduced):
            try:
                model = make(scene, meshes)
            except InputError as error:
                print(f"{scene.name:24s}{error}")
                continue
            tables = model.rom.tables if isinstance(model, ReducedModel) else None
            n = tables.n_modes + tables.n_coordinates if tables else model.kinematics.mechanism.n_dofs
            times = 1e6 * predicted(model), 1e6 * measured(model, given.n)
            print(f"{scene.name:24s}{model.name:12s}{n:9d}{times[0]:14.3g}{times[1]:14.3g}", flush=True)


if __name__ == "__main__":
    main()
