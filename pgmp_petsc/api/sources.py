"""Sources of a call: a built model or a scene that a program holds, or the file of one, and models of these, whose
scenes are changed where a change leaves a built model valid; and the file of a result, which is claimed before long
work and written after it, with the ranks that get the result.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

from pgmp_petsc import models
from pgmp_petsc.api.declared import Argument
from pgmp_petsc.api.ranks import RESULT, tell, tell_remarks
from pgmp_petsc.api.result import MODELS, Result, Rom, in_memory
from pgmp_petsc.base.errors import InputError, Remark
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.declare.records import Result as RunResult
from pgmp_petsc.files import seal
from pgmp_petsc.files.claims import check_folder, claimed, form_of, is_table, named
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.mechanism.mechanism import TABLES
from pgmp_petsc.models import FullModel, Model
from pgmp_petsc.models.component_file import ComponentsFile
from pgmp_petsc.models.model import TITLES
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.reduction.rom import ReducedOrderModel, check_served, served_ranges
from pgmp_petsc.results.summary import write_result
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.loading import scene_from_tables
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.studies.inputs import read_scene
from pgmp_petsc.studies.plausibility import plausibility

AnySource = Rom | Scene | str | PathLike[str]
REDUCED = "reduced"
SOURCE = Argument(
    "Reduced or component model that was built, or its file; with `model` a scene, or its file.", word="MODEL.h5|SCENE"
)
#: Names of models by the kinds of their files.
NAME_OF = {"rom": REDUCED, "components": "components"}

#: What a scene is read for, by the name of the model.
PURPOSES = {"full": Purpose.FULL, "components": Purpose.COMPONENTS}
AnyModel = TypeVar("AnyModel", bound=Model)


@dataclass(frozen=True)
class Origin:
    """Where a model comes from."""

    source: AnySource  # a built model, a scene, or the file of one
    model: str  # ``reduced``, ``full`` or ``components``
    #: overrides, settings: changes of the scene, as a command takes them
    overrides: tuple[str, ...]
    settings: tuple[str, ...]
    is_built: bool  # whether the source is a model that stands alone, not a scene

    @classmethod
    def of(
        cls, comm: Comm, source: AnySource, model: str | None, overrides: Sequence[str], settings: Sequence[str],
        differentiated: bool = False,
    ) -> Origin:  # fmt: skip
        """Return what the arguments of a call say; runs of full-order models are not `differentiated`. Collective on
        `comm`; raises `InputError`."""
        with agreed(comm, "looking at the arguments"):
            kind = kind_of(source)
            _check_model(source, kind, model)
            if differentiated and model == "full":
                raise InputError(
                    "model = 'full': derivatives are of reduced and of component models; take 'components'"
                )
            is_built = kind is not None or model in (None, REDUCED)
            return cls(source, NAME_OF.get(kind) or model or REDUCED, overrides, settings, is_built)

    @property
    def path(self) -> Path | None:
        """The file, where it is one."""
        return Path(self.source) if isinstance(self.source, (str, PathLike)) else getattr(self.source, "path", None)

    @property
    def name(self) -> str:
        """Name of the source in messages."""
        if isinstance(self.source, (str, PathLike)):
            return str(self.source)
        return f"the {TITLES[self.model]} model" if isinstance(self.source, Rom) else "the scene"

    @property
    def directory(self) -> Path:
        """Folder that paths of the scene are relative to."""
        return self.source.directory if isinstance(self.source, (Rom, Scene)) else Path(self.source).parent

    def prepared(
        self, comm: Comm, check: Callable[[Scene], Scene | None] = lambda scene: None, told: bool = True
    ) -> Model:
        """Return the model, with the step of its scene. Collective on `comm`.

        `check` refuses scenes for reasons of the caller's own, who tells their remarks where they are not `told` here;
        it may return another scene to take. Raises `InputError` if it cannot be read, or has what its kind of model
        cannot have.
        """
        if self.is_built:
            scene, built = on_root(comm, self._read)
        else:
            scene, meshes = read_scene(self.source, self.overrides, self.settings, comm, PURPOSES[self.model])
        with agreed(comm, "looking at the scene"):
            scene = check(scene) or scene
        tell_remarks(comm, scene.remarks if told else ())
        if not self.is_built:
            return mesh_model(scene, meshes, self.model, comm)
        with agreed(comm, f"preparing the {TITLES[self.model]} model"):
            return models.ReducedModel(scene, built) if self.model == REDUCED else built.model(scene)

    def _read(self) -> tuple[Scene, Any]:
        """Return the scene of a built model with the changes, and what its file has; by one process."""
        if isinstance(self.source, Rom):
            built = self.source.data.rom if self.model == REDUCED else self.source.data
        else:
            built = (ReducedOrderModel if self.model == REDUCED else ComponentsFile).read(Path(self.source))
        return scene_of_built(built, self.directory, self.overrides, self.settings, self.name), built

    def settled(self, comm: Comm, check: Callable[[Scene], None] = lambda scene: None, many: bool = False) -> Model:
        """Return the model with the step that its tolerance asks for, of one run or of many. Collective on `comm`."""
        model, remark = settled(self.prepared(comm, check), comm, many)
        tell(comm, remark)
        return model


def kind_of(source: AnySource) -> str | None:
    """Return the kind of a built model, or of the file of one; None of others."""
    if isinstance(source, Rom):
        return source.kind
    if isinstance(source, Scene):
        return None
    kind = seal.kind_of(Path(source))
    return kind if kind in NAME_OF else None


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


def _check_model(source: object, kind: str | None, name: str | None) -> None:
    """Refuse models that a source does not have."""
    known = " and ".join(f"'{model}'" for model in PURPOSES)
    allowed, why = PURPOSES, f"of a scene there are {known}; for the reduced one give what pgmp.build(scene) returns"
    if kind is not None:
        allowed = (None, NAME_OF[kind])
        why = f"'{source}' is {named(kind)}; give its scene, SCENE.toml, for another one"
        if isinstance(source, Rom):
            what = f"the {TITLES[NAME_OF[kind]]} model is built already"
            why = f"{what}; give its scene, such as pgmp.simulate(model.scene, model='full'), for another one"
    elif isinstance(source, (str, PathLike)):
        allowed, why = (None, REDUCED, *PURPOSES), f"allowed are 'reduced' of the file of one, {known} of a scene's"
    if name not in allowed:
        called = f"--{name}" if name in PURPOSES else f"model = {name!r}"
        raise InputError(f"{called}: {why}")


@dataclass(frozen=True)
class Keeper:
    """Destination of a result: its file, its picture, and the ranks that get it."""

    kind: str  # of the result
    comm: Comm  # the ranks that make it
    #: output, target: its file as it was named, and with its full path; None where there is none
    output: Path | None
    target: Path | None
    on_all_ranks: bool  # whether all ranks get it; else the first alone, whose columns may stay in a file
    plot: Path | None = None  # folder for its picture; None where there is none

    def result(self, data: Any, scene: Scene, said: Sequence[Remark] = ()) -> Result:
        """Return the result of what the first rank has, in the units of its scene, written where that is asked for.

        Collective on `comm`. Its remarks are printed, except the scene's and those in `said`, which were printed
        before. Raises `RunError` if the system fails to write.
        """
        data = data.in_own_units() if isinstance(data, RunResult) else data

        def drawing_the_result() -> str:
            from pgmp_petsc.figures.collection import draw_result  # matplotlib takes a noticeable time

            return draw_result(data, self.plot)

        if self.output is not None:
            on_root(self.comm, write_result, data, self.output, doing="writing the result")
        if self.plot is not None:
            tell(self.comm, on_root(self.comm, drawing_the_result))
        if self.on_all_ranks:
            data = on_root(self.comm, in_memory, data, doing="handing out the result")
        elif self.comm.rank > 0:
            data = None
        # of a table nothing can be read again
        path = None if self.target is None or is_table(self.target) else self.target
        found = (Rom if self.kind in MODELS else Result)(self.kind, data, self.comm, scene.directory, path)
        if data is not None:
            known = (*scene.remarks, *said)
            tell_remarks(self.comm, (remark for remark in found.remarks if remark not in known), RESULT)
        return found


@contextmanager
def keeping(
    kind: str,
    comm: Comm,
    output: str | PathLike[str] | None,
    on_all_ranks: bool,
    inputs: Iterable[AnySource | None] = (),
    plot: str | PathLike[str] | None = None,
) -> Iterator[Keeper]:
    """Claim the file of a result, and yield what keeps it. Collective on `comm`; raises `InputError` if it cannot be
    written, may not be replaced, or is one of the `inputs` that are files; or the folder for the picture cannot be
    made."""
    own, folder = (None if path is None else Path(path) for path in (output, plot))
    if folder is not None:
        on_root(comm, check_folder, folder, own)
    if own is None:
        yield Keeper(kind, comm, None, None, on_all_ranks, folder)
        return
    files = [one for one in inputs if isinstance(one, (str, PathLike))]
    with claimed(comm, own, form_of(own, kind), files) as target:
        yield Keeper(kind, comm, own, target, on_all_ranks, folder)


@contextmanager
def place_on_the_way(comm: Comm, output: Path | None = None) -> Iterator[Path]:
    """Yield where samples are kept on the way: beside their file, or in a folder of their own, which goes at the end.

    Collective on `comm`; what is kept is the first rank's.
    """
    if output is not None:
        yield output
        return
    folder = on_root(comm, tempfile.mkdtemp, None, "pgmp_ensemble_")
    try:
        yield Path(folder) / "ensemble.h5"
    finally:
        if comm.rank == 0:
            shutil.rmtree(folder, ignore_errors=True)


Built = ReducedOrderModel | ComponentsFile
# what tables and condensed bodies depend on; all else may be changed when they are used
BUILT = (*TABLES, "fields", "reduction")


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
