"""Reading what a computation starts from, on one rank for all.

Models of a scene that are ready to run: of what was read, with the step that a tolerance asks for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.random_fields import field_remarks
from pgmp_petsc.bodies.shape import BodyShape, shape_in_scene
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.mesh.line_mesh import read_line_mesh
from pgmp_petsc.models import FullModel, Model, ReducedModel
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.reduction.rom import ReducedOrderModel, check_served, served_ranges
from pgmp_petsc.scene import Scene, load_scene, scene_from_toml
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.scene.references import stressed_bodies
from pgmp_petsc.studies.plausibility import plausibility

# what a ROM's tables depend on; all else may be changed when it is used
BUILT = ("ground", "materials", "bodies", "fields", "joints", "coordinates", "reduction")


def read_scene(
    path: Path,
    overrides: Sequence[str],
    settings: Sequence[str],
    comm: Comm,
    purpose: Purpose,
) -> tuple[Scene, dict[str, BodyShape]]:
    """Read a scene, with remarks on what it says that probably is not meant, and its meshes. Collective on `comm`.

    Raises `InputError` if the scene or a mesh cannot be read, says what cannot be meant, or has what the purpose cannot
    do with it.
    """

    def read() -> tuple[Scene, dict[str, BodyShape]]:
        return with_meshes(load_scene(path, overrides, settings), purpose)

    return on_root(comm, read)


def with_meshes(scene: Scene, purpose: Purpose) -> tuple[Scene, dict[str, BodyShape]]:
    """Return a scene with its remarks, and its meshes; by one process. Raises as `read_scene`."""
    meshes = {name: _mesh_of(scene, name) for name in scene.bodies}
    check_capabilities(scene, purpose, meshes)
    if stressed_bodies(scene):
        from pgmp_petsc.outputs.stress import check_stresses  # few scenes have stress outputs

        check_stresses(scene, meshes)
    return scene.with_remarks((*plausibility(scene, meshes), *field_remarks(scene, meshes))), meshes


def _mesh_of(scene: Scene, name: str) -> BodyShape:
    body = scene.bodies[name]
    written = shape_in_scene(scene, name)
    if written is not None:
        return written
    if body.matrices is not None:
        # takes a noticeable time, and only such bodies need it
        from pgmp_petsc.bodies.assembled_reading import read_assembled

        return read_assembled(scene, name)
    path, entry = scene.path_of(body.mesh), f"bodies.{name}.mesh"
    if not body.continuum:
        return read_line_mesh(path, entry, body.dimension)
    # takes a noticeable time, and only runs with continuum bodies need it
    from pgmp_petsc.mesh.solid_mesh_reading import read_solid_mesh

    return read_solid_mesh(path, body.dimension, entry)


def read_rom(
    path: Path, overrides: Sequence[str], settings: Sequence[str], comm: Comm
) -> tuple[Scene, ReducedOrderModel]:
    """Read a ROM and its scene, changed where a change leaves the tables valid. Collective on `comm`.

    Raises `InputError` if the file is not a whole ROM, or an entry is overridden that the tables were built from.
    """

    def read() -> tuple[Scene, ReducedOrderModel]:
        rom = ReducedOrderModel.read(path)
        return scene_of_rom(rom, path.parent, overrides, settings, path), rom

    return on_root(comm, read)


def scene_of_rom(
    rom: ReducedOrderModel, directory: Path, overrides: Sequence[str], settings: Sequence[str], name: object
) -> Scene:
    """Return the scene of a ROM, changed where a change leaves the tables valid, with its remarks; by one process.

    Paths are relative to `directory`; `name` is what messages call the ROM. Raises as `read_rom`.
    """
    built = scene_from_toml(rom.record.scene_toml, directory)
    scene = scene_from_toml(rom.record.scene_toml, directory, overrides, settings)
    _check_tables_hold(built, scene, name)
    check_capabilities(scene, Purpose.REDUCED)
    said = check_served(served_ranges(built, rom), scene)
    return _step_left_open(built, scene).with_remarks((*plausibility(scene), *said))


def _step_left_open(built: Scene, scene: Scene) -> Scene:
    """Forget the step that a file carries where a tolerance for the step is given, but no other step."""
    simulation = scene.simulation
    if simulation.tolerance is None or simulation.step != built.simulation.step:
        return scene
    return scene.model_copy(update={"simulation": Simulation(**simulation.model_dump(exclude={"step"}))})


def _check_tables_hold(built: Scene, scene: Scene, name: object) -> None:
    for table in BUILT:
        if getattr(built, table) != getattr(scene, table) and not (table == "joints" and _same_joints(built, scene)):
            _refuse(table, name)
    then, now = built.plain_effects, scene.plain_effects
    if then.keys() != now.keys():
        _refuse("effects", name)
    for key, effect in now.items():
        free = {entry: getattr(effect, entry) for entry in effect.changeable}
        if type(then[key]) is not type(effect) or then[key].model_copy(update=free) != effect:
            _refuse(f"effects.{key}", name)
    if built.parameters.keys() != scene.parameters.keys():
        _refuse("parameters", name)
    for key, parameter in scene.parameters.items():
        if built.parameters[key].nominal != parameter.nominal:
            _refuse(f"parameters.{key}.nominal", name)


def _same_joints(built: Scene, scene: Scene) -> bool:
    """Return whether joints differ in nothing but numbers of their springs and dampers."""

    def structure(one: Scene) -> list[tuple]:
        rigid = [(name, joint.model_copy(update={"elastic": None})) for name, joint in one.joints.items()]
        return [*rigid, *(joint.elastic.structure for joint in one.joints.values() if joint.elastic is not None)]

    return structure(built) == structure(scene)


def _refuse(entry: str, name: object) -> None:
    raise InputError(
        f"--override {entry}: the tables of '{name}' were built from this entry; override it in pgmp build instead. "
        "With a reduced model, simulation, initial, ensemble, outputs, distributions and bounds of parameters, their "
        "correlation, and the numbers of loads, joints' forces, elastic joints and motions may be changed"
    )


#: What a scene is read for, by the name of the model.
PURPOSES = {"full": Purpose.FULL, "components": Purpose.COMPONENTS}
AnyModel = TypeVar("AnyModel", bound=Model)


def reduced_model(scene: Scene, rom: ReducedOrderModel, comm: Comm) -> ReducedModel:
    """Return the reduced model of a scene. Collective on `comm`."""
    with agreed(comm, "preparing the reduced model"):
        return ReducedModel(scene, rom)


def mesh_model(scene: Scene, meshes: Mapping[str, BodyShape], name: str, comm: Comm) -> Model:
    """Return the full-order or the component model (`PURPOSES`) of a scene. Collective on `comm`."""
    if name == "components":
        from pgmp_petsc.bench.reference import component_model  # eigensolvers take a noticeable time

        return component_model(scene, meshes, comm)
    with agreed(comm, "preparing the full-order model"):
        return FullModel(scene, meshes)


def settled(model: AnyModel, comm: Comm, ensemble: bool = False) -> tuple[AnyModel, str]:
    """Return a model with the step that ``simulation.tolerance`` asks for, and what is to be said of it.

    As it is, and nothing to say, where there is no tolerance. Collective on `comm`; raises as `settle_step`.
    """
    if model.scene.simulation.tolerance is None:
        return model, ""
    from pgmp_petsc.bench.step_choice import settle_step  # its many modules take a noticeable time

    return settle_step(model, comm, ensemble)
