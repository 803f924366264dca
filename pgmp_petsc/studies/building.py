"""The build of a reduced model: effects chosen by size, tolerances met, and what is kept beside the tables."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Self

from pgmp_petsc.base.errors import InputError, note
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bench.choice import choose_over_lengths, leaves_open
from pgmp_petsc.bench.prices import prospects, quicker
from pgmp_petsc.bench.reference import Said, condensed_bodies
from pgmp_petsc.bodies.shape import Shapes
from pgmp_petsc.components.condensing import condensed
from pgmp_petsc.effects import start_of
from pgmp_petsc.estimates.own_error import condensed_alone
from pgmp_petsc.files.hdf5 import BUILD_AGAIN, RunRecord, open_file, shapes_of
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models.component_file import ComponentsFile, model_of
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.reduction.checkpoint import BuildCheckpoint, Finished, SceneCheckpoint
from pgmp_petsc.reduction.length_family import why_no_family
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.results import EffectSizes, Selection
from pgmp_petsc.scene import Scene, scene_to_toml
from pgmp_petsc.scene.units import own_values
from pgmp_petsc.scene.uses import count_builds, extremes, length_names
from pgmp_petsc.stepping.static_equilibrium import require_balance
from pgmp_petsc.studies.effect_sizes import choose_effects, remarks_on_sizes


@dataclass(frozen=True)
class Built:
    """A reduced model and what its file keeps beside it."""

    kind: ClassVar[str] = "rom"
    rom: ReducedOrderModel | None  # on the first rank, None elsewhere
    selection: Selection | None = None  # what was chosen for tolerances; None where nothing was
    sizes: EffectSizes | None = None  # of effects, where they were chosen by size
    # what is to be removed once the file is written; None where nothing was kept on the way
    checkpoint: SceneCheckpoint | None = None

    def write(self, path: Path) -> None:
        parts = [] if self.selection is None else [self.selection.put]
        parts += [] if self.sizes is None else [self.sizes.put]
        self.rom.write(path, *parts)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read ROM.h5; by one process. Raises as `ReducedOrderModel.read`."""
        rom = ReducedOrderModel.read(path)
        with open_file(path, "rom") as file, shapes_of(file, BUILD_AGAIN):
            return cls(rom, Selection.found_in(file), EffectSizes.found_in(file))

    def figures(self) -> dict[str, object]:
        """Return the figures of the model as plain data."""
        rom = self.rom
        tables, frequencies = rom.tables, rom.frequencies_hz
        terms = {name: getattr(tables, name).shape[1] for name in ("mass", "stiffness", "load")}
        return {
            "kind": "rom",
            "configurations": len(frequencies),
            "modes": frequencies.shape[1],
            "parameter_modes": rom.points.n_vectors,
            "other_modes": tables.n_modes - frequencies.shape[1] - rom.points.n_vectors,
            "frequencies_hz": {"min": frequencies.min(axis=0), "max": frequencies.max(axis=0)},
            "terms": terms,
            "least_cosine": rom.cosines.min(),
            "chosen": None if self.selection is None else self.selection.chosen,
        }


def build(
    scene: Scene, meshes: Shapes, group: RankGroup, say: Said, output: Path | None = None, resume: bool = False
) -> Built:
    """Build the reduced model of a scene with the mesh of every body; groups share an eigenproblem. Collective on
    ``group.world``.

    The sizes of effects, and what errors are measured against, go to `say` before it is run. Finished parts are kept
    beside the output until `Built.checkpoint` is removed, none without one; `resume` takes up what is there. Raises
    `InputError` or `RunError` on all ranks, whichever rank met it.
    """
    comm = group.world
    on_root(comm, _check_ahead, scene, meshes)
    sizes, shapes, choice, checkpoint = None, meshes, None, None
    if scene.reduction.effects == "auto":
        shapes = condensed(scene, meshes, group, large=True)
        scene, sizes = on_root(comm, choose_effects, scene, meshes, shapes)
        say("\n".join(sizes.lines()))
    is_open = leaves_open(scene)
    if length_names(scene):
        say(_price(scene))
    if output is not None and is_open:
        checkpoint = Finished(output, {"command": "build"}, scene, meshes, comm, resume)
    elif output is not None:
        checkpoint = BuildCheckpoint(output, scene, meshes, group, resume)
    try:
        if is_open:
            choice = choose_over_lengths(scene, meshes, group, say, checkpoint)
            rom = choice.rom
        else:
            rom = build_rom(scene, shapes, group, checkpoint=checkpoint)
    except InputError:
        if checkpoint is not None:
            checkpoint.forget()
        raise
    with agreed(comm, "estimating the sizes of effects"):
        if rom is not None and sizes is None:
            # with a tolerance for the step it is the chosen scene that runs
            rom = _with_remarks(rom, scene if choice is None else choice.scene, meshes)
    return Built(rom, None if choice is None else choice.selection, sizes, checkpoint)


def build_components(scene: Scene, meshes: Shapes, comm: Comm) -> ComponentsFile | None:
    """Condense the bodies of a scene to its component model: on the first rank, None elsewhere. Collective on `comm`.
    Raises `InputError`, `RunError`; on all ranks, whichever rank met it."""
    timings = Timings()
    with timings.phase("components"):
        bodies = condensed_bodies(scene, meshes, comm)
    with agreed(comm, "preparing the component model"), timings.phase("assembly"):
        model = model_of(scene, bodies, n_ranks=comm.size)  # refuses what no run of it could have
        model.require_taken()
        remarks = (*condensed_alone(model), *model.kinematics.remarks, *scene.remarks)
    timings = timings.maximum(comm)
    record = RunRecord(scene_to_toml(scene), own_values(scene), None, comm.size, timings.as_dict(), remarks)
    return ComponentsFile(bodies=bodies, record=record) if comm.rank == 0 else None


def _check_ahead(scene: Scene, meshes: Shapes) -> None:
    """Refuse outputs and starts that no run of the model could have, before anything long is done for it."""
    check_capabilities(scene, Purpose.BUILD, meshes)
    kinematics = RigidKinematics(Mechanism.from_scene(scene, meshes))
    OutputSet.of(scene, kinematics)
    if why := why_no_family(scene, meshes):
        raise InputError(why)
    if not scene.initial.equilibrium and any(joint.offset is not None for joint in scene.joints.values()):
        require_balance(scene, kinematics, start_of(scene, kinematics.mechanism)[0], scene.values)


def _price(scene: Scene) -> str:
    """Say what lengths as parameters make of the build."""
    names, reduction = length_names(scene), scene.reduction
    n_builds, n = count_builds(scene), reduction.angles ** len(scene.coordinates)
    first = ""
    if reduction.sampling_tolerance is not None:
        count = len(list(extremes(scene))) + 1
        first = f"; reduction.sampling_tolerance takes {count} builds before, to find angles, and may add some to all"
    points = f"models at {n_builds - 1} points, {reduction.length_points} along each, and one more to compare with"
    what = f"lengths, places and ratios ({', '.join(names)}): {points}, times {n} configurations"
    return f"{what} are {n_builds * n} eigenproblems{first}"


def _with_remarks(rom: ReducedOrderModel, scene: Scene, meshes: Shapes) -> ReducedOrderModel:
    """Add to a reduced model's remarks which effects its scene leaves out although they matter, and which model is much
    quicker; on one rank."""
    timings = Timings()
    with timings.phase("effect sizes"):
        found = remarks_on_sizes(scene, meshes, rom.branch)
    better, why = quicker(prospects(scene, meshes, Mechanism.from_scene(scene, meshes), rom.tables.n_modes, 0))
    record, more = rom.record, ()
    if better:
        more = (note(f"{why}: runs and ensembles of the scene with --{better} are quicker"),)
    remarks, seconds = (*record.remarks, *found, *more), {**record.timings, **timings.as_dict()}
    return replace(rom, record=replace(record, remarks=remarks, timings=seconds))
