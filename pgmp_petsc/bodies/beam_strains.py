"""Strains of beams, and the forces and moments in their sections that follow from them.

The elements' one-point rule knows strains in their middles, where they are one order better than elsewhere: there
extension, shear and curvature are taken. Normal and transverse forces are constant in an element. A bending moment is
not: it changes as the transverse forces say,

    M' = -Q    in the plane,      M_2' = Q_3,  M_3' = -Q_2    in space,

so that moments at the nodes are those of the equilibrium of the element, exact where loads act on nodes, and nothing is
taken across a node where a load or another direction begins. At a node every element has a value of its own.

Strains are those of `beam2d` and `beam3d`, in space in the axes of the element, (gamma_1, gamma_2, gamma_3, kappa_1,
kappa_2, kappa_3); in the plane (eps, gamma, kappa). Rigid motion does not change them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.beam2d import strains
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.section import BeamSection

ON_LINE = 1e-6  # of the body's extent: how far from an element a place may be that counts as on it


@dataclass(frozen=True, eq=False)
class BeamStrains:
    """Points of a body of beams, each in an element.

    Attributes
    ----------
    body
        Of flexible beams.
    elements
        Their elements, shape (n_points,).
    along
        Places in these, 0 at the first node and 1 at the second, shape (n_points,).
    """

    body: Body
    elements: np.ndarray
    along: np.ndarray

    @property
    def n_points(self) -> int:
        """Number of points."""
        return self.elements.size

    @property
    def n_strains(self) -> int:
        """Number of strains of an element."""
        return 6 if self.body.node_dofs == 6 else 3

    def of_places(self, frames: np.ndarray) -> np.ndarray:
        """Return the strains of the points' elements, shape (n_points, n_strains, n), for frames of the nodes.

        Frames are (n_nodes, 3, n) in the plane, and in space (n_nodes, 12, n): positions and directors.
        """
        mesh, cells = self.body.mesh, self.body.mesh.cells[self.elements]
        first, second, lengths = frames[cells[:, 0]], frames[cells[:, 1]], mesh.lengths[self.elements][:, None]
        if self.n_strains == 6:
            return _in_space(first[:, :12], second[:, :12], lengths, self.body.axes[self.elements])
        psi = 0.5 * (first[:, 2] + second[:, 2]) + self.body.directions[self.elements][:, None]
        both = np.moveaxis(np.concatenate([first, second], axis=1), 1, 0)
        stretch, gamma, kappa = strains.py_func(both, np.cos(psi), np.sin(psi), lengths)
        return np.stack([stretch - 1.0, gamma, kappa], axis=1)

    def of_displacements(self, displacements: np.ndarray) -> np.ndarray:
        """Return linear strains, shape (n_points, n_strains, n), for small displacements and rotations in the body's
        frame, shape (n_nodes, 3, n), in space (n_nodes, 6, n)."""
        cells, lengths = self.body.mesh.cells[self.elements], self.body.mesh.lengths[self.elements][:, None]
        first, second = displacements[cells[:, 0]], displacements[cells[:, 1]]
        apart, turned = (second - first) / lengths[:, None], 0.5 * (first + second)
        if self.n_strains == 6:
            axes = self.body.axes[self.elements]
            tilted = np.cross(turned[:, 3:], axes[:, :, 0, None], axis=1)
            gamma = np.einsum("eij,ein->ejn", axes, apart[:, :3] - tilted)
            return np.concatenate([gamma, np.einsum("eij,ein->ejn", axes, apart[:, 3:])], axis=1)
        angle = self.body.directions[self.elements][:, None]
        cos, sin = np.cos(angle), np.sin(angle)
        eps, across = cos * apart[:, 0] + sin * apart[:, 1], cos * apart[:, 1] - sin * apart[:, 0]
        return np.stack([eps, across - turned[:, 2], apart[:, 2]], axis=1)

    def forces(self, found: np.ndarray, values: Mapping[str, np.ndarray | float]) -> np.ndarray:
        """Return forces and moments in the sections of the points, (N, Q, M), in space (N, Q_2, Q_3, T, M_2, M_3).

        Parameters
        ----------
        found
            Strains, shape (n_points, n_strains, n).
        values
            Parameter values, numbers or of shape (n,).
        """
        resultants = found * stiffnesses(self.body, values, found.shape[2])
        arms = ((self.along - 0.5) * self.body.mesh.lengths[self.elements])[:, None]
        if self.n_strains == 6:
            resultants[:, 4] += arms * resultants[:, 2]  # M_2' = Q_3
            resultants[:, 5] -= arms * resultants[:, 1]  # M_3' = -Q_2
        else:
            resultants[:, 2] -= arms * resultants[:, 1]  # M' = -Q
        return resultants

    @classmethod
    def at_ends(cls, body: Body, nodes: np.ndarray | None = None) -> BeamStrains:
        """Take both ends of all elements, or those that are at some nodes."""
        elements, ends = np.nonzero(
            np.ones(body.mesh.cells.shape) if nodes is None else np.isin(body.mesh.cells, nodes)
        )
        return cls(body, elements, ends.astype(float))

    @classmethod
    def at_place(cls, body: Body, place: np.ndarray) -> BeamStrains | None:
        """Take a place on a body, shape (d,), m, in every element that it is in; None where it is in none."""
        mesh = body.mesh
        starts, edges = mesh.nodes[mesh.cells[:, 0]], np.diff(mesh.nodes[mesh.cells], axis=1)[:, 0]
        along = np.clip(np.sum((place - starts) * edges, axis=1) / mesh.lengths**2, 0.0, 1.0)
        away = np.linalg.norm(place - starts - along[:, None] * edges, axis=1)
        near = np.flatnonzero(away <= ON_LINE * float(np.ptp(mesh.nodes, axis=0).max()))
        return cls(body, near, along[near]) if near.size else None


def stiffnesses(body: Body, values: Mapping[str, np.ndarray | float], n: int) -> np.ndarray:
    """Return what makes forces and moments of strains, shape (n_strains, n)."""
    section = body.section
    if isinstance(section, BeamSection):
        parts = ((section.axial,), (section.shear,), (section.bending,))
    else:
        parts = ((section.axial,), *((q,) for q in section.shear), section.torsion, *((q,) for q in section.bending))
    return np.array([np.broadcast_to(sum(term.at(values) for term in terms), n) for terms in parts])


def _in_space(first: np.ndarray, second: np.ndarray, lengths: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return the strains of elements in space between frames (n_e, 12, n); see `beam3d`."""
    n_e, _, n = first.shape
    one, other = (part[:, 3:].reshape(n_e, 3, 3, n) for part in (first, second))  # directors: (element, k, component)
    turn = np.einsum("eicn,ejcn->eijn", one, other)  # R_1^T R_2
    trace = np.einsum("eiin->en", turn)
    w = 0.5 * np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1
    )
    c = 0.5 * np.sqrt(1.0 + trace)
    g = np.einsum("ekcn,ecn->ekn", 0.5 * (one + other), (second - first)[:, :3] / lengths[:, None])
    along = np.sum(w * g, axis=1)
    gamma = g / c[:, None] - w * (along / (4.0 * c**3 * (1.0 + c)))[:, None]
    size = np.linalg.norm(w, axis=1)  # sin |Theta|
    small = size < 1e-4  # of |Theta| / sin |Theta| = 1 + s^2 / 6 + 3 s^4 / 40 the next term is below 1e-25
    angle = np.arctan2(size, 0.5 * (trace - 1.0))
    ratio = np.where(small, 1.0 + size**2 / 6.0 + 0.075 * size**4, angle / np.where(small, 1.0, size))
    strained = np.einsum("eij,ein->ejn", axes, gamma)
    strained[:, 0] -= 1.0
    return np.concatenate([strained, np.einsum("eij,ein->ejn", axes, ratio[:, None] * w) / lengths[:, None]], axis=1)
