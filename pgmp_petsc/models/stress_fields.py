"""Stresses over the whole of the bodies that stress outputs name, at one instant of one sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.beam_strains import BeamStrains
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.solid_strains import SolidStrains
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.outputs.stress import BeamLaw, SolidLaw, all_points, carrier_of, law_of, quantities_of
from pgmp_petsc.outputs.stress_quantities import EXTREMES, FURTHEST
from pgmp_petsc.scene import Scene

#: Positions of a body's nodes (n_nodes, d), m, and by quantity what is at them (n_nodes,); by body.
Fields = dict[str, tuple[np.ndarray, dict[str, np.ndarray]]]


@dataclass(frozen=True, eq=False)
class FieldPoints:
    """All points of one body.

    Attributes
    ----------
    number
        Of the body.
    carrier
        Its mesh, or itself, of beams.
    points, law
        As those of an output.
    quantities
        With their units.
    """

    number: int
    carrier: SolidMesh | Body
    points: SolidStrains | BeamStrains
    law: SolidLaw | BeamLaw
    quantities: dict[str, str]

    @property
    def mesh(self):
        """The mesh of cells or lines."""
        return self.carrier if isinstance(self.carrier, SolidMesh) else self.carrier.mesh

    @property
    def kind(self) -> str:
        """meshio's name of the cells."""
        return self.carrier.kind if isinstance(self.carrier, SolidMesh) else "line"

    def at_nodes(self, strains: np.ndarray, values: Mapping[str, float]) -> dict[str, np.ndarray]:
        """Return all quantities at the nodes, each of shape (n_nodes,), for strains (n_points, n_strains, 1)."""
        found = {}
        for quantity in self.quantities:
            own = self.law.values(quantity, self.points, strains, values)[:, 0]
            reported = EXTREMES.get(quantity, FURTHEST)
            found[quantity] = reported(own[self._by_node()])
        return found

    def _by_node(self) -> np.ndarray:
        """Return the points of every node, the first of them again where there are fewer, shape (k, n_nodes)."""
        points, n_nodes = self.points, self.mesh.n_nodes
        if isinstance(points, BeamStrains):
            nodes = self.mesh.cells[points.elements, points.along.astype(int)]
        else:
            nodes = points.nodes
        order, counts = np.argsort(nodes, kind="stable"), np.bincount(nodes, minlength=n_nodes)
        starts = np.cumsum(counts) - counts
        each = np.minimum(np.arange(counts.max())[:, None], counts - 1)
        return order[starts + each]


def field_points(scene: Scene, bodies: tuple[Body, ...], outputs: OutputSet) -> dict[str, FieldPoints]:
    """Return the points of the bodies that stress outputs name, by name."""
    found = {}
    for number in sorted({stress.body for stress in outputs.stresses}):
        name, carrier = bodies[number].name, carrier_of(bodies[number])
        found[name] = FieldPoints(
            number, carrier, all_points(scene, name, carrier), law_of(scene, name, carrier), quantities_of(scene, name)
        )
    return found
