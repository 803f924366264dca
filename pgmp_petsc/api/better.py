"""Better models of an ensemble's scene, and how many samples of each (``pgmp montecarlo --correct``)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Self

from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.models import FullModel, Model, ReducedModel
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.inputs import read_scene, with_meshes

if TYPE_CHECKING:
    from mpi4py import MPI

    from pgmp_petsc.bodies.shape import BodyShape
    from pgmp_petsc.ensemble.correction import Better

MODELS = ("reduced", "components", "full")  # from worse to better
PURPOSES = {"components": Purpose.COMPONENTS, "full": Purpose.FULL}
MOST_DIVISOR = 1000
FORM = re.compile(r"(?:(?P<scene>.+):)?(?P<model>[a-z]+)(?:/(?P<divisor>\d{1,4}))?=(?P<count>\d{1,9}|auto)")
ALLOWED = "[SCENE:]MODEL[/D]=K with full, components or reduced, steps D times as short, and K samples or auto"
# what has to be the same in a scene that gives meshes
OF_MESHES = ("ground", "materials", "bodies", "joints", "coordinates")


@dataclass(frozen=True)
class Correction:
    """A better model, which runs the first samples of an ensemble too.

    Attributes
    ----------
    model
        ``full``, ``components`` or ``reduced``.
    n
        Number of samples; None where measured costs and correlations are to decide, within a budget.
    divisor
        By what its step is divided.
    scene
        Scene file that its meshes are from; None for those of the ensemble's own model.
    """

    model: str
    n: int | None
    divisor: int = 1
    scene: str | PathLike[str] | None = None

    @classmethod
    def read(cls, text: str) -> Self:
        """Return what a text like ``full/2=100`` asks for; raises `InputError` where it is none of the kind."""
        parts = FORM.fullmatch(text.strip())
        if parts is None or parts["model"] not in MODELS or not 1 <= int(parts["divisor"] or 1) <= MOST_DIVISOR:
            raise InputError(f"--correct {text}: allowed are {ALLOWED}, such as full=200, components=500 or full/4=50")
        count = None if parts["count"] == "auto" else int(parts["count"])
        return cls(parts["model"], count, int(parts["divisor"] or 1), parts["scene"])

    @property
    def name(self) -> str:
        """What results call it."""
        return self.model if self.divisor == 1 else f"{self.model}/{self.divisor}"

    @property
    def text(self) -> str:
        """What asks for it on a command line."""
        ahead = "" if self.scene is None else f"{fspath(self.scene)}:"
        return f"{ahead}{self.name}={'auto' if self.n is None else self.n}"

    @property
    def rank(self) -> tuple[int, int]:
        """Better models have larger ones."""
        return MODELS.index(self.model), self.divisor


def in_order(wanted: Sequence[Correction], own: str, n_samples: int | None) -> list[Correction]:
    """Return better models, the best first; the same on all ranks.

    Parameters
    ----------
    wanted
        In any order.
    own
        Name of the ensemble's own model.
    n_samples
        Number of its samples, None where it is to be chosen.

    Raises
    ------
    InputError
        If models or numbers are in no order that makes sense.
    """
    if not wanted:
        return []
    from pgmp_petsc.ensemble.joined import FEWEST as fewest  # most ensembles are of one model

    for one in wanted:
        Correction.read(one.text)  # of a program's own making
    found = sorted(wanted, key=lambda one: one.rank, reverse=True)
    for one, other in zip(found, found[1:]):
        if one.rank == other.rank:
            raise InputError(f"--correct {other.text}: {one.name} is there twice; give it once")
    for one in found:
        if one.rank <= (MODELS.index(own), 1):
            raise InputError(
                f"--correct {one.text}: {one.name} is no better than the ensemble's own model, {own}; give a better "
                f"one, or {own}/2 for steps half as long"
            )
        if one.n is not None and one.n < fewest:
            raise InputError(f"--correct {one.text}: at least {fewest} samples, or the interval would rest on nothing")
    known = [(one.name, one.n) for one in found if one.n is not None]
    known += [(own, n_samples)] if n_samples is not None else []
    for (better, few), (worse, many) in zip(known, known[1:]):
        if few > many:
            raise InputError(
                f"--correct {better}={few}: {few} samples of {better} and {many} of {worse}, which is worse; a worse "
                "model needs as many samples at least, since those of a better one are the first of its own"
            )
    return found


def better_models(wanted: Sequence[Correction], own: Model, source: object, comm: MPI.Comm) -> list[Better]:
    """Return the models that are asked for. Collective on `comm`.

    Parameters
    ----------
    own
        The ensemble's own model.
    source
        What messages call that which it is from.

    Raises
    ------
    InputError
        If meshes are not at hand, or a model cannot have what the scene has.
    """
    if not wanted:
        return []
    from pgmp_petsc.ensemble.correction import Better  # as above

    return [Better(one.name, _model(one, own, source, comm), one.n) for one in wanted]


def _model(one: Correction, own: Model, source: object, comm: MPI.Comm) -> Model:
    scene = _scene_of(own.scene, one.divisor)
    if one.model == "reduced":
        with agreed(comm, "preparing the reduced model"):
            return ReducedModel(scene, own.rom, own.kinematics)
    meshes = _meshes(one, own, source, comm)
    from pgmp_petsc.outputs.stress import check_stresses  # as above

    with agreed(comm, f"preparing {one.name}"):
        check_capabilities(scene, PURPOSES[one.model], meshes)
        check_stresses(scene, meshes)
    if one.model == "components":
        from pgmp_petsc.bench.reference import component_model  # eigensolvers take a noticeable time

        return component_model(scene, meshes, comm)
    with agreed(comm, "preparing the full-order model"):
        return FullModel(scene, meshes)


def _scene_of(scene: Scene, divisor: int) -> Scene:
    """Return the scene with shorter steps, and without what is described of the ensemble's own model alone."""
    simulation = scene.simulation.model_copy(update={"step": scene.simulation.step / divisor})
    ensemble = scene.ensemble.model_copy(update={"checked_share": 0.0, "bands": 0, "balance": False})
    return scene.model_copy(update={"simulation": simulation, "ensemble": ensemble})


def _meshes(one: Correction, own: Model, source: object, comm: MPI.Comm) -> Mapping[str, BodyShape]:
    """Return the meshes of a model: those of its scene, or that the ensemble's model came with."""
    purpose = PURPOSES[one.model]
    if one.scene is not None:
        scene, meshes = read_scene(Path(one.scene), (), (), comm, purpose)
        for table in OF_MESHES:
            if getattr(scene, table) != getattr(own.scene, table):
                raise InputError(
                    f"--correct {one.text}: [{table}] of '{one.scene}' differs from that of '{source}'; give the scene "
                    "that it was built from"
                )
        return meshes
    if not isinstance(own, ReducedModel):
        return on_root(comm, with_meshes, own.scene, purpose)[1]
    condensed = [name for name, mesh in own.rom.meshes.items() if not isinstance(mesh, LineMesh)]
    if condensed:
        raise InputError(
            f"--correct {one.text}: '{source}' has no mesh of {', '.join(condensed)}, only what was condensed of it; "
            f"give the scene too, --correct SCENE.toml:{one.text}"
        )
    return own.rom.meshes
