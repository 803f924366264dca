"""Models that were built: their scenes, changed where a change leaves the model valid."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from pathlib import Path

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.mechanism.mechanism import TABLES
from pgmp_petsc.models.component_file import ComponentsFile
from pgmp_petsc.reduction.rom import ReducedOrderModel, check_served, served_ranges
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.loading import scene_from_tables
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.studies.plausibility import plausibility

Built = ReducedOrderModel | ComponentsFile
#: Kinds of built models by their names.
KINDS = {"reduced": ReducedOrderModel, "components": ComponentsFile}
# what tables and condensed bodies depend on; all else may be changed when they are used
BUILT = (*TABLES, "fields", "reduction")


def read_built(
    held: Built | Path, model: str, directory: Path, overrides: Sequence[str], settings: Sequence[str], name: str
) -> tuple[Scene, Built]:
    """Return the scene of a built model that a program holds, or of its file, as `scene_of_built`; and the model."""
    built = KINDS[model].read(held) if isinstance(held, Path) else held
    return scene_of_built(built, directory, overrides, settings, name), built


def scene_of_built(
    made: Built, directory: Path, overrides: Sequence[str], settings: Sequence[str], name: object
) -> Scene:
    """Return the scene of a built model, changed where a change leaves it valid, with its remarks; by one process.

    Paths are relative to `directory`; `name` is what messages call the model. Raises `InputError` if an entry is
    overridden that it was built from.
    """
    of_components = isinstance(made, ComponentsFile)
    tables = made.record.tables
    built = made.scene(directory) if of_components else scene_from_tables(deepcopy(tables), directory)
    scene = built
    if overrides or settings:
        scene = scene_from_tables(deepcopy(tables), directory, overrides, settings)
    _check_tables_hold(built, scene, name)
    if of_components:
        check_capabilities(scene, Purpose.COMPONENTS)
        said = made.check_bodies(built, scene, name)
    else:
        check_capabilities(scene, Purpose.REDUCED)
        said = check_served(served_ranges(built, made), scene)
    remarks, simulation = (*plausibility(scene), *said), scene.simulation
    if simulation.tolerance is not None and simulation.step == built.simulation.step:
        # no step but the file's is given beside the tolerance for one
        scene = scene.with_entries(simulation=Simulation(**simulation.model_dump(exclude={"step"})))
    return scene.with_remarks(remarks)


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
    acting = [{k: (c.joint, c.motion) for k, c in one.controllers.items()} for one in (built, scene)]
    if acting[0] != acting[1]:
        _refuse("controllers", name)
    if built.parameters.keys() != scene.parameters.keys():
        _refuse("parameters", name)
    for key, parameter in scene.parameters.items():
        if built.parameters[key].nominal != parameter.nominal:
            _refuse(f"parameters.{key}.nominal", name)


def _same_joints(built: Scene, scene: Scene) -> bool:
    """Return whether joints differ in nothing but numbers of their springs and dampers."""

    def structure(one: Scene) -> list[tuple]:
        keys = {name: joint.gives_way for name, joint in one.joints.items()}
        rigid = [
            (name, joint.model_copy(update={keys[name]: None} if keys[name] else {}))
            for name, joint in one.joints.items()
        ]
        return [*rigid, *(getattr(one.joints[name], key).structure for name, key in keys.items() if key)]

    return structure(built) == structure(scene)


def _refuse(entry: str, name: object) -> None:
    raise InputError(
        f"--override {entry}: '{name}' was built from this entry; override it in pgmp build instead. "
        "With a built model, simulation, initial, ensemble, outputs, distributions and bounds of parameters, their "
        "correlation, the numbers of loads, joints' forces, elastic joints and motions, and controllers but for their "
        "joints may be changed"
    )
