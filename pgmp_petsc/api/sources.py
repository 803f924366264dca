"""Sources of a call: a reduced model or a scene that a program holds, or the file of one.

The file of a result, which is claimed before long work and written after it, and the ranks that get the result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from pgmp_petsc.api.declared import Argument
from pgmp_petsc.api.ranks import RESULT, tell, tell_remarks
from pgmp_petsc.api.result import Result, Rom, in_memory
from pgmp_petsc.api.scenes import changed
from pgmp_petsc.base.errors import InputError, Remark
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.files.claims import check_folder, claimed, form_of, is_table
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import Model
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.inputs import (
    PURPOSES,
    mesh_model,
    read_rom,
    read_scene,
    reduced_model,
    scene_of_rom,
    settled,
    with_meshes,
)

Named = str | PathLike[str]
AnySource = Rom | Scene | str | PathLike[str]
REDUCED = "reduced"
SOURCE = Argument("Reduced model, or its file; with `model` a scene, or its file.", word="ROM.h5|SCENE")
SCENE = Argument("Scene, or its file.", word="SCENE")


@dataclass(frozen=True)
class Origin:
    """Where a model comes from."""

    source: AnySource  # a reduced model, a scene, or the file of one
    model: str  # ``reduced``, ``full`` or ``components``
    #: overrides, settings: changes of the scene, as a command takes them
    overrides: tuple[str, ...]
    settings: tuple[str, ...]

    @classmethod
    def of(cls, source: AnySource, model: str | None, overrides: Sequence[str], settings: Sequence[str]) -> Origin:
        """Return what the arguments of a call say. Raises `InputError`; by every rank alike."""
        _check_model(source, model)
        return cls(source, model or REDUCED, overrides, settings)

    @property
    def path(self) -> Path | None:
        """The file, where it is one."""
        return Path(self.source) if isinstance(self.source, (str, PathLike)) else getattr(self.source, "path", None)

    @property
    def name(self) -> str:
        """Name of the source in messages."""
        if isinstance(self.source, (str, PathLike)):
            return str(self.source)
        return "the reduced model" if isinstance(self.source, Rom) else "the scene"

    @property
    def directory(self) -> Path:
        """Folder that paths of the scene are relative to."""
        return directory_of(self.source)

    def prepared(
        self, comm: Comm, check: Callable[[Scene], Scene | None] = lambda scene: None, told: bool = True
    ) -> Model:
        """Return the model, with the step of its scene. Collective on `comm`.

        `check` refuses scenes for reasons of the caller's own, who tells their remarks where they are not `told` here;
        it may return another scene to take. Raises `InputError` if it cannot be read, or has what its kind of model
        cannot have.
        """
        rom, meshes = None, {}
        if self.model == REDUCED and isinstance(self.source, Rom):
            rom = self.source.data.rom
            scene = on_root(comm, self._scene_of, rom)
        elif self.model == REDUCED:
            scene, rom = read_rom(Path(self.source), self.overrides, self.settings, comm)
        else:
            scene, meshes = scene_and_meshes(self.source, PURPOSES[self.model], self.overrides, self.settings, comm)
        with agreed(comm, "looking at the scene"):
            scene = check(scene) or scene
        tell_remarks(comm, scene.remarks if told else ())
        return reduced_model(scene, rom, comm) if rom is not None else mesh_model(scene, meshes, self.model, comm)

    def settled(self, comm: Comm, check: Callable[[Scene], None] = lambda scene: None, many: bool = False) -> Model:
        """Return the model with the step that its tolerance asks for, of one run or of many. Collective on `comm`."""
        model, remark = settled(self.prepared(comm, check), comm, many)
        tell(comm, remark)
        return model

    def _scene_of(self, rom: object) -> Scene:
        return scene_of_rom(rom, self.directory, self.overrides, self.settings, self.name)


def scene_and_meshes(
    source: Scene | Named, purpose: Purpose, overrides: Sequence[str], settings: Sequence[str], comm: Comm
) -> tuple[Scene, dict[str, BodyShape]]:
    """Return a scene, of a file or of a program, with other entries, and its meshes. Collective on `comm`.

    Raises `InputError` if it is none, or has what the purpose cannot do with it.
    """
    if isinstance(source, (str, PathLike)):
        return read_scene(Path(source), overrides, settings, comm, purpose)

    def preparing_the_scene() -> tuple[Scene, dict[str, BodyShape]]:
        return with_meshes(changed(source, overrides, settings), purpose)

    return on_root(comm, preparing_the_scene)


def model_of_rom(rom: Rom | Named, comm: Comm) -> ReducedOrderModel:
    """Return the tables of a reduced model, or of its file. Collective on `comm`."""
    return rom.data.rom if isinstance(rom, Rom) else read_rom(Path(rom), (), (), comm)[1]


def directory_of(source: AnySource) -> Path:
    """Return the folder that paths of a scene are relative to."""
    return source.directory if isinstance(source, (Rom, Scene)) else Path(source).parent


def _check_model(source: object, name: str | None) -> None:
    """Refuse models that a source does not have."""
    if isinstance(source, Rom):
        if name not in (None, REDUCED):
            raise InputError(
                f"model = {name!r}: a reduced model is given; give its scene, such as pgmp.simulate(rom.scene, "
                "model='full')"
            )
        return
    known = " and ".join(f"'{model}'" for model in PURPOSES)
    if isinstance(source, (str, PathLike)):
        if name not in (None, REDUCED, *PURPOSES):
            raise InputError(f"model = {name!r}: allowed are 'reduced' of the file of one, {known} of a scene's")
    elif name not in PURPOSES:
        raise InputError(
            f"model = {name!r}: of a scene there are {known}; for the reduced one give what pgmp.build(scene) returns"
        )


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

    def result(self, data: Any, directory: Path, said: Sequence[Remark] = ()) -> Result:
        """Return the result of what the first rank has, written where that is asked for. Collective on `comm`.

        Its remarks are printed, except those in `said`, which were printed before. Raises `RunError` if the system
        fails to write.
        """

        def writing_the_result() -> None:
            from pgmp_petsc.results.summary import write_result  # loads h5py, which without a file nobody needs

            write_result(data, self.output)

        def handing_out_the_result() -> Any:
            return in_memory(data)

        def drawing_the_result() -> str:
            from pgmp_petsc.figures.collection import draw_result  # matplotlib takes a noticeable time

            return draw_result(data, self.plot)

        if self.output is not None:
            on_root(self.comm, writing_the_result)
        if self.plot is not None:
            tell(self.comm, on_root(self.comm, drawing_the_result))
        if self.on_all_ranks:
            data = on_root(self.comm, handing_out_the_result)
        elif self.comm.rank > 0:
            data = None
        # of a table nothing can be read again
        path = None if self.target is None or is_table(self.target) else self.target
        found = (Rom if self.kind == "rom" else Result)(self.kind, data, self.comm, directory, path)
        if data is not None:
            tell_remarks(self.comm, (remark for remark in found.remarks if remark not in said), RESULT)
        return found


@contextmanager
def keeping(
    kind: str,
    comm: Comm,
    output: str | PathLike[str] | None,
    on_all_ranks: bool,
    inputs: Iterable[str | PathLike[str] | None] = (),
    plot: str | PathLike[str] | None = None,
) -> Iterator[Keeper]:
    """Claim the file of a result, and yield what keeps it. Collective on `comm`.

    Raises
    ------
    InputError
        If the file cannot be written, may not be replaced, or is one of the `inputs`; or the folder for the picture
        cannot be made.
    """
    own, folder = (None if path is None else Path(path) for path in (output, plot))
    if folder is not None:
        on_root(comm, check_folder, folder, own)
    if own is None:
        yield Keeper(kind, comm, None, None, on_all_ranks, folder)
        return
    with claimed(comm, own, form_of(own, kind), inputs) as target:
        yield Keeper(kind, comm, own, target, on_all_ranks, folder)
