"""The models of a scene that commands can take in place of a reduced one."""

from __future__ import annotations

from collections.abc import Mapping

from mpi4py import MPI

from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.models import ComponentModel, FullModel
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import Scene


def one_model(full: bool, components: bool) -> None:
    """Refuse two models at once."""
    if full and components:
        raise InputError("--full and --components: two models; give one of them, or run the command twice")


def full_of(scene: Scene, meshes: Mapping[str, BodyShape], comm: MPI.Comm) -> FullModel:
    """Return the full-order model. Collective on `comm`."""
    with agreed(comm, "preparing the full-order model"):
        return FullModel(scene, meshes)


def components_of(scene: Scene, meshes: Mapping[str, BodyShape], comm: MPI.Comm) -> ComponentModel:
    """Return the component model. Collective on `comm`."""
    from pgmp_petsc.experiments.reference import component_model  # eigensolvers take a noticeable time

    return component_model(scene, meshes, comm)
