"""What the build of a mechanism of continuum bodies takes, phase by phase, on one mesh and any number of ranks.

    mpirun -n 2 python -m benchmarks.scaling.build scenes/slider_crank_solid3d.toml -o case.json

`scripts/bench_scaling` calls it once a mesh and number of ranks, each time in processes of its own: the peak of the
memory is that of a whole process. :mod:`~benchmarks.scaling.report` puts the records together.

On a machine that others use too, wall times are theirs as well. Phases therefore have processor times beside, and where
only the wall time of a part is known (PETSc's log of factorisations, the timings of a build), its processor time is the
share that it has of the whole's.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from mpi4py import MPI

from benchmarks.programs import end, guarded
from benchmarks.scaling import case as phases
from benchmarks.scaling.case import ScalingCase
from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.components.condensing import condensed
from pgmp_petsc.files.claims import check_output
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mesh.meshes import SolidMesh
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.ranks.agreement import on_root
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.ranks.petsc import start_petsc
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.inputs import read_scene

FACTORISATIONS = ("MatCholFctrSym", "MatCholFctrNum")  # PETSc's events
OF_BUILD = {phases.KINEMATICS: "kinematics", phases.ANGLES: "eigenproblems", phases.TABLES: "continuity"}
PLACE = 0.11  # of the fresh solve in the coordinates' ranges: no special configuration


class Clocks(Timings):
    """Wall times, and beside them this process's processor times of the same phases."""

    def __init__(self) -> None:
        super().__init__()
        self.processor = Timings(clock=time.process_time)

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Add the times of the block to phase ``name``."""
        with super().phase(name), self.processor.phase(name):
            yield


def measure(
    path: Path, overrides: Sequence[str], group: RankGroup, rom_path: Path, fresh_up_to: int = 0
) -> ScalingCase | None:
    """Build a scene's reduced model phase by phase, and write it. Collective on ``group.world``.

    Parameters
    ----------
    path, overrides
        The scene; at least one of its bodies has a mesh of continuum elements.
    group
        Ranks that share a body and an eigenproblem.
    rom_path
        Where the reduced model goes.
    fresh_up_to
        Largest number of unknowns for which one angle is solved on the full meshes too (`fresh_solve`).

    Returns
    -------
    ScalingCase or None
        On the first rank, None elsewhere.
    """
    world, clocks = group.world, Clocks()
    read_scene(path, overrides, (), world, Purpose.BUILD)  # once for the imports
    idle, load = world.gather(peak_memory()), os.getloadavg()[0]
    with clocks.phase(phases.READING):
        scene, meshes = read_scene(path, overrides, (), world, Purpose.BUILD)
    solids = [mesh for mesh in meshes.values() if isinstance(mesh, SolidMesh)]
    if not solids:
        raise InputError(f"'{path}' has no body of continuum elements; the study needs one")
    before = factorised()
    with clocks.phase(phases.CONDENSING):
        components = condensed(scene, meshes, group, timings=clocks)
    seconds, count = np.subtract(factorised(), before)
    with clocks.phase(phases.BUILDING):
        rom = build_rom(scene, components, group)
    with clocks.phase(phases.WRITING):
        on_root(world, lambda: None if rom is None else rom.write(rom_path))
    peak = world.gather(peak_memory())
    unknowns = sum(mesh.dimension * mesh.n_nodes for mesh in solids)
    refusal = ""
    if unknowns <= fresh_up_to:
        try:
            fresh_solve(scene, meshes, world, clocks)
        except RunError as error:
            refusal = str(error)
    seconds, count = world.allreduce(float(seconds), op=MPI.MAX), world.allreduce(int(count), op=MPI.MAX)
    wall, processor = (timings.maximum(world).as_dict() for timings in (clocks, clocks.processor))
    if rom is None:
        return None
    if refusal:
        del wall[phases.FRESH], processor[phases.FRESH]
    _split(wall, processor, phases.MODES, {phases.FACTORISATION: seconds})
    wall[phases.EIGENSOLVER] = wall[phases.MODES] - seconds
    processor[phases.EIGENSOLVER] = processor[phases.MODES] - processor[phases.FACTORISATION]
    _split(wall, processor, phases.BUILDING, {part: rom.record.timings[name] for part, name in OF_BUILD.items()})
    return ScalingCase(
        scene=scene.scene.name,
        dimension=solids[0].dimension,
        unknowns=unknowns,
        bodies=len(solids),
        modes=scene.reduction.modes,
        angles=len(rom.frequencies_hz),
        ranks=world.size,
        ranks_per_angle=group.comm.size,
        wall=wall,
        processor=processor,
        factorisations=count,
        idle=idle,
        peak=peak,
        load=load,
        blas=loaded_blas(),
        refusal=refusal,
    )


def fresh_solve(
    scene: Scene, meshes: Mapping[str, BodyShape], comm: MPI.Comm, timings: Timings | None = None
) -> np.ndarray:
    """Solve the mechanism's eigenproblem at one angle on the full meshes: assembly, factorisation, eigensolver.

    What the build does once a body is done here for the coupled bodies, with the constraints eliminated. Phase `FRESH`
    of the timings leaves out the rigid kinematics. Collective on `comm`.

    Returns
    -------
    ndarray, shape (n_modes,)
        Frequencies, Hz.
    """
    kinematics = RigidKinematics(Mechanism.from_scene(scene, meshes))
    theta = np.array([c.lower + PLACE * (c.upper - c.lower) for c in kinematics.coordinates])
    timings = timings or Timings()
    with timings.phase(phases.FRESH):
        with ModalProblem(kinematics, scene.nominal, scene.reduction.modes, comm) as problem:
            return problem.solve(theta).frequencies_hz


def factorised() -> tuple[float, int]:
    """Return wall time and number of the factorisations that this process has done since PETSc's log began."""
    from petsc4py import PETSc

    if not PETSc.Log.isActive():
        PETSc.Log.begin()
    found = [PETSc.Log.Event(name).getPerfInfo() for name in FACTORISATIONS]
    return sum(event["time"] for event in found), found[-1]["count"]


def peak_memory() -> int:
    """Return the largest resident memory that this process has had, bytes."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def loaded_blas() -> str:
    """Return the names of the loaded libraries of basic linear algebra, empty where the system does not tell."""
    try:
        text = Path("/proc/self/maps").read_text(encoding="utf-8")
    except OSError:
        return ""
    paths = re.findall(r"/\S*lib(?:\w*blas|mkl|blis)\S*\.so\S*", text)
    return ", ".join(sorted({str(Path(path).resolve()) for path in paths if "site-packages" not in path}))


def _split(wall: dict[str, float], processor: dict[str, float], whole: str, parts: Mapping[str, float]) -> None:
    """Add wall times of parts, and processor times in the proportion of the whole's."""
    for name, seconds in parts.items():
        wall[name], processor[name] = seconds, seconds * processor[whole] / wall[whole]


def parse_arguments() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(prog="benchmarks.scaling.build", description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="CASE.json", help="record to write")
    parser.add_argument("--override", action="append", default=[], metavar="KEY=VALUE", help="as of pgmp; repeatable")
    parser.add_argument("--ranks-per-angle", type=int, default=1, metavar="N", help="ranks that share a body")
    parser.add_argument("--fresh-up-to", type=int, default=0, metavar="N", help="unknowns for one full solve besides")
    return parser.parse_args()


def run(arguments: argparse.Namespace) -> None:
    """Measure, and write the reduced model and the record beside each other."""
    comm = MPI.COMM_WORLD
    on_root(comm, check_output, arguments.output, "scaling", (arguments.scene,))
    rom_path = arguments.output.with_suffix(".h5")
    with RankGroup.split(comm, arguments.ranks_per_angle) as group:
        case = measure(arguments.scene, arguments.override, group, rom_path, arguments.fresh_up_to)
    if case is not None:
        case.write(arguments.output)
        print(
            f"{arguments.output}: {case.unknowns} unknowns, {case.ranks} ranks: {case.wall[phases.CONDENSING]:.2f} s "
            f"({case.processor[phases.CONDENSING]:.2f} s of a processor) to condense, {1e3 * case.angle:.1f} ms an "
            f"angle, {sum(case.peak) / 1e6:.0f} MB",
            flush=True,
        )


def main() -> int:
    """Measure the scene on the command line."""
    arguments = parse_arguments()
    start_petsc()
    return guarded(lambda: run(arguments))


if __name__ == "__main__":
    end(main())
