"""Stress outputs: strains at points of a body, what a quantity makes of them, and the largest of the points.

Every model knows the strains in its own way (`models.body_fields`): of the positions of a mesh, or as a constant linear
map of the coordinates that a body is condensed to. From there on all is the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Values
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.stresses import EXTREMES, FURTHEST, LARGEST, BeamLaw, BodyStresses, SolidLaw, Strains
from pgmp_petsc.mechanism.composition import bodies_of
from pgmp_petsc.mesh.meshes import LineMesh, SolidMesh
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.fields import FixedPlace
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.outputs import QUANTITIES, STRESSES, OutputEntry
from pgmp_petsc.scene.references import stress_problems, stressed_bodies


class Stress(OutputEntry):
    """Stress of a flexible body, or the force or moment in a section of a beam, largest of what it is asked of."""

    type: Literal["stress"]
    reads, of_deformation = ("stresses",), True
    body: str = Field(description="name of a flexible body")
    quantity: Literal[QUANTITIES] = Field(
        description="von_mises, principal_max, principal_min (Pa) of solids; of beams axial_force, shear_force (N), "
        "bending_moment (N m), stress_max, stress_min of the outermost fibres (Pa), in space shear_force_2 and _3, "
        "bending_moment_2 and _3, torsion_moment"
    )
    at: FixedPlace | None = Field(None, description="place in the body's own frame, that of its mesh (m)")
    group: str | None = Field(
        None, description="group of faces of a solid, or named point of a beam: the largest value there"
    )
    region: str | None = Field(None, description="region of cells of a solid: the largest value there")

    def unit_in(self, scene: Scene) -> str:
        return self.unit_of_quantity

    @property
    def unit_of_quantity(self) -> str:
        """SI unit of its quantity."""
        return next(table[self.quantity] for table in STRESSES.values() if self.quantity in table)

    def kinked_in(self, scene: Scene) -> bool:
        return self.at is None

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        return stress_problems(scene, name, self)


@dataclass(frozen=True, eq=False)
class StressOutput:
    """One stress output."""

    #: name, entry: in the scene
    name: str
    entry: Stress
    body: int  # number of the body
    points: Strains  # where strains are taken
    law: SolidLaw | BeamLaw  # what makes the quantity of them
    size: float  # the quantity for a strain of 1: what is small beside it by the round-off of strains is nothing

    def value(self, forces: np.ndarray, parameters: Values) -> np.ndarray:
        """Return the output, shape (n,), for what the law makes of strains of the points, (n_points, n_forces, n).

        Forces and moments have their sign at a place. Of many sections the magnitude is reported: the largest ones of
        either sign may be equal, and an output that jumped from one to the other would have no error to speak of.
        Parameter values are numbers, or of shape (n,).
        """
        values = self.law.values([self.entry.quantity], self.points, forces, parameters)[self.entry.quantity]
        if self.entry.quantity in EXTREMES:
            return EXTREMES[self.entry.quantity](values)
        return LARGEST(np.abs(values)) if self.entry.at is None else FURTHEST(values)

    @classmethod
    def of(cls, name: str, scene: Scene, number: int, body: Body) -> StressOutput:
        """Prepare an output of a scene, of the body with that number.

        Raises `InputError` if the place is not on the body's mesh, or the body was condensed without what stresses
        need.
        """
        entry, stresses = scene.outputs[name], body.stresses(scene)
        if stresses is None or not body.answered:
            raise InputError(
                f'outputs.{name}.body = "{entry.body}": the reduced model was built without what its stresses need; '
                "name the output in the scene and run pgmp build again"
            )
        law, points = stresses.law, points_of(scene, name, stresses)
        return cls(name, entry, number, points, law, law.size(entry.quantity, points, scene.nominal))


def check_stresses(scene: Scene, meshes: Mapping[str, LineMesh | SolidMesh]) -> None:
    """Refuse stress outputs at places that their body's mesh has not, before anything is computed.

    Raises `InputError`, naming the entry, what came, and what is there.
    """
    if stressed_bodies(scene):
        bodies = {body.name: body for body in bodies_of(scene, meshes)}
        for name, entry in scene.outputs.items():
            if "stresses" in entry.reads:
                points_of(scene, name, bodies[entry.body].stresses(scene))


def points_of(scene: Scene, name: str, stresses: BodyStresses) -> Strains:
    """Return where the strains of an output of a scene are taken; raises as `StressOutput.of`."""
    entry = scene.outputs[name]
    if entry.region is not None:
        return stresses.in_region(entry.region, f"outputs.{name}.region")
    if entry.group is not None:
        return stresses.in_group(entry.group, f"outputs.{name}.group")
    if entry.at is None:
        return stresses.everywhere()
    place, nodes = np.array(entry.at), stresses.mesh.nodes
    points = stresses.at_place(place)
    if points is None:
        nearest = nodes[np.argmin(np.linalg.norm(nodes - place, axis=1))]
        shown, unit = scene.system.named(np.array([nodes.min(axis=0), nodes.max(axis=0), nearest]), "m")
        low, high, nearest = (f"({', '.join(f'{x:.6g}' for x in place)})" for place in shown)
        at = [scene.system.shown(x, "m") for x in entry.at]
        words = f"outside the mesh of {entry.body}, which reaches from {low} to {high} {unit}; its nearest node is at"
        raise InputError(problem(f"outputs.{name}.at", f"{words} {nearest}", at))
    return points
