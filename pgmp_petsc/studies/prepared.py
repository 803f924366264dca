"""Models of a scene that are ready to run: of what was read, with the step that a tolerance asks for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeVar


from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import FullModel, Model, ReducedModel
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.scene import Scene

if TYPE_CHECKING:
    from mpi4py import MPI

#: What a scene is read for, by the name of the model.
PURPOSES = {"full": Purpose.FULL, "components": Purpose.COMPONENTS}
AnyModel = TypeVar("AnyModel", bound=Model)


def reduced_model(scene: Scene, rom: ReducedOrderModel, comm: MPI.Comm) -> ReducedModel:
    """Return the reduced model of a scene. Collective on `comm`."""
    with agreed(comm, "preparing the reduced model"):
        return ReducedModel(scene, rom)


def mesh_model(scene: Scene, meshes: Mapping[str, BodyShape], name: str, comm: MPI.Comm) -> Model:
    """Return the full-order or the component model (`PURPOSES`) of a scene. Collective on `comm`."""
    if name == "components":
        from pgmp_petsc.experiments.reference import component_model  # eigensolvers take a noticeable time

        return component_model(scene, meshes, comm)
    with agreed(comm, "preparing the full-order model"):
        return FullModel(scene, meshes)


def settled(model: AnyModel, comm: MPI.Comm, ensemble: bool = False) -> tuple[AnyModel, str]:
    """Return a model with the step that ``simulation.tolerance`` asks for, and what is to be said of it.

    As it is, and nothing to say, where there is no tolerance. Collective on `comm`; raises as `settle_step`.
    """
    if model.scene.simulation.tolerance is None:
        return model, ""
    from pgmp_petsc.studies.settled_step import settle_step  # its many modules take a noticeable time

    return settle_step(model, comm, ensemble)
