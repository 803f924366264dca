"""Strains of beams, and the forces and moments in their sections that follow from them (docs/solids.md, stresses).

Moments change as the transverse forces say, ``M' = -Q`` in the plane, ``M_2' = Q_3,  M_3' = -Q_2`` in space. At a node
every element has a value of its own.

Strains are those of `beam2d` and `beam3d`, in space in the axes of the element, (gamma_1, gamma_2, gamma_3, kappa_1,
kappa_2, kappa_3), in the plane (eps, gamma, kappa); then follows the shear in the middle of the element. Rigid
motion does not change them.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.affine import Values
from pgmp_petsc.bodies.beam2d import strains
from pgmp_petsc.bodies.floating import Beams, products
from pgmp_petsc.mesh.meshes import LineMesh

STRAIGHT = 1e-9  # 1 - cosine of the angle between elements in one direction: half of 4e-5 rad squared
ON_LINE = 1e-6  # of the body's extent: how far from an element a place may be that counts as on it


@dataclass(frozen=True, eq=False)
class BeamStrains:
    """Points of a body of beams, each in an element."""

    body: Beams  # of flexible beams
    elements: np.ndarray  # their elements, shape (n_points,)
    along: np.ndarray  # places in these, 0 at the first node and 1 at the second, shape (n_points,)
    #: what continues extension and shear from the middle of a point's element to the point: its distance over that of
    #: the middles of two elements, shape (n_points,), and the numbers of these, before and after, each (n_points,)
    continued: tuple[np.ndarray, np.ndarray, np.ndarray]

    @property
    def n_points(self) -> int:
        """Number of points."""
        return self.elements.size

    @property
    def width(self) -> int:
        """Numbers that an instant takes while strains are evaluated."""
        return self.n_points

    @property
    def nodes(self) -> np.ndarray:
        """The nodes that the points are at, of ends of elements, shape (n_points,)."""
        return self.body.mesh.cells[self.elements, self.along.astype(int)]

    def of_places(self, frames: np.ndarray) -> np.ndarray:
        """Return the strains of the points, shape (n_points, n_strains, n), for frames of the nodes.

        Frames are (n_nodes, 3, n) in the plane, and in space (n_nodes, 12, n): positions and directors.
        """
        mesh, cells = self.body.mesh, self.body.mesh.cells
        first, second, lengths = frames[cells[:, 0]], frames[cells[:, 1]], mesh.lengths[:, None]
        if not self.body.planar:
            return self._at_points(_in_space(first[:, :12], second[:, :12], lengths, self.body.axes))
        psi = 0.5 * (first[:, 2] + second[:, 2]) + self.body.directions[:, None]
        both = np.moveaxis(np.concatenate([first, second], axis=1), 1, 0)
        stretch, gamma, kappa = strains.py_func(both, np.cos(psi), np.sin(psi), lengths)
        return self._at_points(np.stack([stretch - 1.0, gamma, kappa], axis=1))

    def of_displacements(self, displacements: np.ndarray) -> np.ndarray:
        """Return linear strains, shape (n_points, n_strains, n), for small displacements and rotations in the body's
        frame, shape (n_nodes, 3, n), in space (n_nodes, 6, n)."""
        ends = displacements[self.body.mesh.cells]
        return self._at_points(products(self.body.strain_gradients, ends.reshape(len(ends), -1, ends.shape[-1])))

    def _at_points(self, middles: np.ndarray) -> np.ndarray:
        """Return the strains of the points from those in the middles of all elements, (n_elements, 3 or 6, n)."""
        n_forces, own, (far, before, after) = (2 if self.body.planar else 3), middles[self.elements], self.continued
        rise = middles[after, :n_forces] - middles[before, :n_forces]
        at_points = own[:, :n_forces] + far[:, None, None] * rise
        return np.concatenate([at_points, own[:, n_forces:], own[:, 1:n_forces]], axis=1)

    def forces(self, found: np.ndarray, resists: np.ndarray) -> np.ndarray:
        """Return forces and moments in the sections of the points, (N, Q, M), in space (N, Q_2, Q_3, T, M_2, M_3), from
        strains (n_points, n_strains, n) and the `stiffnesses` of the points."""
        n = resists.shape[1]
        resultants, middle = found[:, :n] * resists, found[:, n:] * resists[:, 1 : 1 + found.shape[1] - n]
        arms = ((self.along - 0.5) * self.body.mesh.lengths[self.elements])[:, None]
        if not self.body.planar:
            resultants[:, 4] += arms * middle[:, 1]  # M_2' = Q_3
            resultants[:, 5] -= arms * middle[:, 0]  # M_3' = -Q_2
        else:
            resultants[:, 2] -= arms * middle[:, 0]  # M' = -Q
        return resultants

    def of_cells(self, values: np.ndarray) -> np.ndarray:
        """Return the values at the points, shape (n_points,), of what is constant in every element."""
        return values[self.elements]

    def stiffnesses(self, values: Values) -> np.ndarray:
        """Return what makes forces and moments of strains at the points, shape (n_points, n_strains, 1 or n)."""
        terms = self.body.sections("stiffness").items()
        return sum(np.multiply.outer(c[self.elements], np.atleast_1d(weight.evaluate(values))) for weight, c in terms)

    @classmethod
    def of(cls, body: Beams, elements: np.ndarray, along: np.ndarray, held: Collection[int] = ()) -> BeamStrains:
        """Take points of elements; `held` are the nodes at which a load or a joint may be."""
        mesh = body.mesh
        before, after = (others[elements] for others in _neighbours(mesh, held))
        # from the middle of the element before to that of the one after, or its own where there is none
        low, high = np.where(before >= 0, before, elements), np.where(after >= 0, after, elements)
        own, apart = mesh.lengths[elements], low != high
        behind = np.where(before >= 0, 0.5 * (own + mesh.lengths[low]), 0.0)
        ahead = np.where(after >= 0, 0.5 * (own + mesh.lengths[high]), 0.0)
        share = np.where(apart, (along - 0.5) * own / np.where(apart, behind + ahead, 1.0), 0.0)
        return cls(body, elements, along, (share, low, high))

    @classmethod
    def at_nodes(cls, body: Beams, held: Collection[int], nodes: np.ndarray) -> BeamStrains:
        """Take the ends of elements that are at some nodes; `held` as for `of`."""
        elements, ends = np.nonzero(np.isin(body.mesh.cells, nodes))
        return cls.of(body, elements, ends.astype(float), held)

    @classmethod
    def in_middles(cls, body: Beams, held: Collection[int]) -> BeamStrains:
        """Take the middles of all elements, whatever is held."""
        n = len(body.mesh.cells)
        elements = np.arange(n)
        return cls(body, elements, np.full(n, 0.5), (np.zeros(n), elements, elements))

    @classmethod
    def at_place(cls, body: Beams, held: Collection[int], place: np.ndarray) -> BeamStrains | None:
        """Take a place on a body, shape (d,), m, in every element that it is in; None where it is in none."""
        mesh = body.mesh
        starts, edges = mesh.nodes[mesh.cells[:, 0]], np.diff(mesh.nodes[mesh.cells], axis=1)[:, 0]
        along = np.clip(np.sum((place - starts) * edges, axis=1) / mesh.lengths**2, 0.0, 1.0)
        away = np.linalg.norm(place - starts - along[:, None] * edges, axis=1)
        near = np.flatnonzero(away <= ON_LINE * float(np.ptp(mesh.nodes, axis=0).max()))
        return cls.of(body, near, along[near], held) if near.size else None


def _neighbours(mesh: LineMesh, held: Collection[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the elements that end where an element begins, and that begin where it ends, in its direction: -1 where
    there is none, or something may jump there; each of shape (n_elements,)."""
    directions = np.diff(mesh.nodes[mesh.cells], axis=1)[:, 0] / mesh.lengths[:, None]
    counts = np.bincount(mesh.cells.ravel(), minlength=mesh.n_nodes)
    ends_at = {int(node): element for element, node in enumerate(mesh.cells[:, 1])}
    before, after = np.full((2, mesh.n_cells), -1)
    for element, node in enumerate(mesh.cells[:, 0]):
        other = ends_at.get(int(node), -1)
        if other >= 0 and counts[node] == 2 and node not in held:
            if directions[element] @ directions[other] > 1.0 - STRAIGHT:
                before[element], after[other] = other, element
    return before, after


def _in_space(first: np.ndarray, second: np.ndarray, lengths: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return the strains of elements in space between frames (n_e, 12, n); see `beam3d`."""
    n_e, _, n = first.shape
    one, other = (part[:, 3:].reshape(n_e, 3, 3, n) for part in (first, second))  # directors: (element, k, component)
    turn = np.sum(one[:, :, None] * other[:, None], axis=3)  # R_1^T R_2
    trace = turn[:, 0, 0] + turn[:, 1, 1] + turn[:, 2, 2]
    w = 0.5 * np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1
    )
    c = 0.5 * np.sqrt(1.0 + trace)
    g = np.sum(0.5 * (one + other) * ((second - first)[:, :3] / lengths[:, None])[:, None], axis=2)
    along = np.sum(w * g, axis=1)
    gamma = g / c[:, None] - w * (along / (4.0 * c**3 * (1.0 + c)))[:, None]
    size = np.linalg.norm(w, axis=1)  # sin |Theta|
    small = size < 1e-4  # of |Theta| / sin |Theta| = 1 + s^2 / 6 + 3 s^4 / 40 the next term is below 1e-25
    angle = np.arctan2(size, 0.5 * (trace - 1.0))
    ratio = np.where(small, 1.0 + size**2 / 6.0 + 0.075 * size**4, angle / np.where(small, 1.0, size))
    strained, curved = (products(axes.swapaxes(1, 2), part) for part in (gamma, ratio[:, None] * w))
    strained[:, 0] -= 1.0
    return np.concatenate([strained, curved / lengths[:, None]], axis=1)
