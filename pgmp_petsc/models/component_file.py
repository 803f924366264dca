"""The component model's file, declared, and the one way to the model: from bodies as the file has them.

A run needs the scene, flexible bodies in floating frames, and shapes of rigid ones; all else follows from these. A
model of a scene goes through the same records as one of a file, so that both are the same to the last bit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, Self

import numpy as np

from pgmp_petsc.base.errors import InputError, Remark
from pgmp_petsc.bodies.body import body_of
from pgmp_petsc.bodies.component import Component, on_cells, rigid_about, rigid_component
from pgmp_petsc.bodies.floating import FloatingBody, Recovery
from pgmp_petsc.bodies.framed_solid import framed_solid
from pgmp_petsc.bodies.shape import BodyShape, at_lengths, to_condense
from pgmp_petsc.declare.records import Record, Result, array, attribute, check_finite, run_record
from pgmp_petsc.files.hdf5 import BUILD_AGAIN, RunRecord, open_file, shapes_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mesh.meshes import LineMesh, SolidMesh
from pgmp_petsc.models.full import ComponentModel
from pgmp_petsc.reduction.rom import Served, check_served, ranges_of
from pgmp_petsc.reduction.rom_file import AMPLITUDES, BodyFile, CellsFile, FloatingFile, LineFile, MeshFile
from pgmp_petsc.reduction.tables import WEIGHT_FREE, Weights, weights_of
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.loading import scene_from_tables
from pgmp_petsc.scene.references import points_used, stressed_bodies


@dataclass(frozen=True)
class RigidFile(Record):
    """A rigid body of cells or matrices."""

    centres: np.ndarray = array("frame", "dimension", unit="m", about="of the frames, in the body's frame")
    mass: np.ndarray = array(
        "term of mass", "rigid motion", "rigid motion", unit=WEIGHT_FREE,
        about="mass of the displacement and the rotation of the centre of mass",
    )  # fmt: skip
    mass_weights: Weights = weights_of("mass", "term of mass")
    fields: np.ndarray = array(
        "rigid motion", "linear field", unit="m, 1", about="what has the momenta of the linear displacement fields"
    )
    centre_of_mass: np.ndarray = array("dimension", unit="m", about="in the body's frame")
    n_mesh_dofs: int = attribute("@n_mesh_dofs", about="unknowns of the mesh")
    mesh: MeshFile | None = array(absent=None)

    @classmethod
    def of(cls, component: Component) -> Self:
        kept, weights = component.recovery, tuple(component.mass)
        return cls(
            component.centres, np.array(list(component.mass.values())), weights, component.fields,
            component.centre_of_mass, component.n_mesh_dofs, None if kept is None else MeshFile.of_mesh(kept.carrier),
        )  # fmt: skip

    def component(self, frames: dict[str, int]) -> Component:
        mass = dict(zip(self.mass_weights, self.mass))
        found = rigid_about(frames, self.centres, mass, self.fields, self.centre_of_mass, n_mesh_dofs=self.n_mesh_dofs)
        return found if self.mesh is None else on_cells(found, self.mesh.mesh)


@dataclass(frozen=True)
class BeamsFile(LineFile):
    """The mesh of a body of beams, and its nodes' displacements and rotations per unit of the amplitudes."""

    answered: bool = attribute("@answered", about="whether the shapes answer the body's own inertia forces")
    points: tuple[str, ...] = attribute("@point_names", "point of the mesh", about="names of points")
    numbers: np.ndarray = attribute("@point_nodes", "point of the mesh", about="their nodes")
    shapes: np.ndarray = array(
        "unknown of the mesh", "amplitude", unit="m, 1",
        about=f"displacements and rotations of the nodes per unit of {AMPLITUDES}",
    )  # fmt: skip


@dataclass(frozen=True)
class CondensedFile(Record):
    """A flexible body in a floating frame."""

    centres: np.ndarray = array("frame", "dimension", unit="m", about="of the frames, in the body's frame")
    frame: FloatingFile = array(at="")
    cells: CellsFile | None = array(absent=None)
    beams: BeamsFile | None = array(absent=None)

    @property
    def tried(self) -> set[str]:
        """Parameters whose values it was condensed for: none of beams, nor where one factor is all that changes."""
        weights = self.frame.moments_weights, self.frame.stiffness_weights
        if self.beams is not None or max(map(len, weights)) == 1:
            return set()
        return {name for weight in (*weights[0], *weights[1]) for name, _ in weight.powers}

    @classmethod
    def of(cls, body: FloatingBody) -> Self:
        kept, cells, beams = body.recovery, None, None
        if kept is not None and isinstance(kept.carrier, SolidMesh):
            cells = CellsFile.of(kept)
        elif kept is not None:
            mesh, shapes = kept.mesh, np.ascontiguousarray(kept.shapes)
            names, nodes = tuple(mesh.points), np.array(list(mesh.points.values()), dtype=int)
            beams = BeamsFile(np.ascontiguousarray(mesh.nodes), mesh.cells, kept.answered, names, nodes, shapes)
        return cls(np.ascontiguousarray(body.centres), FloatingFile.of(body), cells, beams)

    def body(self, scene: Scene, name: str, frames: dict[str, int]) -> FloatingBody:
        kept = None if self.cells is None else self.cells.recovery
        if self.beams is not None:
            points = {point: int(node) for point, node in zip(self.beams.points, self.beams.numbers)}
            mesh = LineMesh(self.beams.nodes, self.beams.cells, points)
            carrier = replace(body_of(scene, name, mesh).alone(), lumps={})
            kept = Recovery(carrier, self.beams.shapes, self.beams.answered)
        return self.frame.body(frames, self.centres, kept)


@dataclass(frozen=True)
class ModelBodyFile(BodyFile):
    """Source of a body: points or lines of a rigid one, a rigid one of cells or matrices, or a flexible one."""

    component: RigidFile | None = array(at="", absent=None)
    floating: CondensedFile | None = array(absent=None)

    @classmethod
    def of(cls, shape: LineMesh | Component | FloatingBody) -> Self:
        if isinstance(shape, FloatingBody):
            return cls._named(shape.frames, floating=CondensedFile.of(shape))
        if isinstance(shape, Component):
            return cls._named(shape.frames, component=RigidFile.of(shape))
        return super().of(shape)

    @property
    def _sources(self) -> tuple[Record | None, ...]:
        return (*super()._sources, self.floating)


def bodies_of(scene: Scene, shapes: Mapping[str, BodyShape]) -> dict[str, ModelBodyFile]:
    """Return the bodies of a scene as a file has them, from shapes of which the flexible ones are in floating frames.

    Raises `InputError` as `rigid_component`.
    """
    made = {
        name: rigid_component(framed_solid(scene, name, shape)) if to_condense(shape) else shape
        for name, shape in shapes.items()
    }
    return {name: ModelBodyFile.of(shape) for name, shape in made.items()}


def model_of(
    scene: Scene,
    bodies: Mapping[str, ModelBodyFile],
    kinematics: RigidKinematics | None = None,
    n_ranks: int = 1,
    built: Scene | None = None,
) -> ComponentModel:
    """Return the component model of a scene; parameters as of `ComponentModel`, `built` the scene that its bodies were
    condensed for where that is another one."""
    shapes = {
        name: body.shape if body.floating is None else body.floating.body(scene, name, body.named)
        for name, body in bodies.items()
    }
    return ComponentModel(
        scene, at_lengths(scene, shapes), kinematics, n_ranks, served_by(bodies, scene if built is None else built)
    )


def served_by(bodies: Mapping[str, ModelBodyFile], built: Scene) -> dict[str, Served]:
    """Return the ranges of the parameters that bodies were condensed for."""
    flexible = (body.floating for body in bodies.values())
    return ranges_of(built, {name for one in flexible if one is not None for name in one.tried})


@dataclass(frozen=True, kw_only=True)
class ComponentsFile(Result):
    kind, internal = "components", True
    bodies: dict[str, ModelBodyFile] = array(ordered=True)
    record: RunRecord = run_record()

    @classmethod
    def read(cls, path: str | PathLike[str]) -> Self:
        """Read the file (one process); raises `InputError` where it is not a whole one."""
        with open_file(path, cls.kind) as file, shapes_of(file, BUILD_AGAIN):
            found = cls.take(file)
            check_finite(found)
            found.record.check_bodies(found.bodies, "bodies")
            return found

    @property
    def n_amplitudes(self) -> dict[str, int]:
        """Number of component modes of every flexible body."""
        flexible = {name: body.floating for name, body in self.bodies.items()}
        return {name: one.frame.shapes.shape[2] for name, one in flexible.items() if one is not None}

    def figures(self) -> dict[str, Any]:
        """Return the figures of the model as plain data."""
        return {"kind": self.kind, "amplitudes": self.n_amplitudes}

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: all but what was made of it."""
        return {one.name: getattr(self, one.name) for one in fields(self)}

    @cached_property
    def _scenes(self) -> dict[Path, Scene]:
        return {}

    @cached_property
    def _models(self) -> dict[Path, ComponentModel]:
        return {}  # the last ones

    def scene(self, directory: Path) -> Scene:
        """Return the scene that the bodies were condensed for, with paths relative to a folder."""
        if directory not in self._scenes:
            self._scenes[directory] = scene_from_tables(deepcopy(self.record.tables), directory)
        return self._scenes[directory]

    def model(self, scene: Scene) -> ComponentModel:
        """Return the model with a scene that differs from that of the build where `check_bodies` allows it; one that
        moves as that of the call before has its mechanism."""
        last = self._models.get(scene.directory)
        if last is not None and last.scene.moves_as(scene):
            return last.in_scene(scene)
        made = self._models[scene.directory] = model_of(scene, self.bodies, built=self.scene(scene.directory))
        return made

    def check_bodies(self, built: Scene, scene: Scene, name: object) -> tuple[Remark, ...]:
        """Refuse changes of a scene that would have its bodies condensed otherwise than those of the one they were
        built for; those of entries as such are refused before. Return warnings of values outside what the bodies were
        condensed for.

        Raises `InputError`, naming the entry and the cure, and the model so.
        """
        for problem in self._problems(built, scene):
            raise InputError(f"{problem}; pgmp build SCENE --components makes a model for it, in place of '{name}'")
        return check_served(served_by(self.bodies, built), scene)

    def _problems(self, built: Scene, scene: Scene) -> Iterator[str]:
        for body, one in self.bodies.items():
            if one.floating is None:
                continue
            line = scene.bodies[body].line
            if line is not None and scene.number(line.length) != built.number(line.length):
                what = f"{scene.number(line.length):.6g}, but its body {body} was condensed with"
                yield f"parameters.{line.length}.value = {what} {built.number(line.length):.6g}"
            for point, entry in points_used(scene, body).items():
                if point not in one.points:
                    known = ", ".join(point for point in one.points if not point.isdigit())
                    yield f'{entry} = "{body}:{point}": no frame of the condensed body; it has {known}'
            if body in set(stressed_bodies(scene)) - set(stressed_bodies(built)):
                yield f"outputs: stresses of {body}, which was condensed without what they need"
