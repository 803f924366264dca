"""The frame of a group of faces: where a joint or an effect holds a continuum body.

The faces A of a group move as one frame with their mean position and their mean rotation,

    x_c = 1/A int x dA,    phi = H^-1 int X' x u dA,    H = int (X'.X') 1 - X' X'^T dA,    X' = X - X_c,

for small displacements u in the body's frame. A force or torque on the frame does the same work as the traction that
these means are dual to, so that it acts as an energetically consistent distribution; the faces stay free to deform
(an interpolation constraint, not a rigid one).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.mesh.solid_mesh import reference_element

SMALLEST_RADIUS = 1e-6  # of gyration, over the extent of the mesh: below, a rotation would be round-off


@dataclass(frozen=True, eq=False)
class FaceFrame:
    """A frame that follows a group of faces."""

    centre: np.ndarray  # X_c in the body's frame, shape (d,), m
    nodes: np.ndarray  # nodes of the faces, shape (n,)
    weights: np.ndarray  # ``1/A int N_i dA``, shape (n,); their sum is 1
    arms: np.ndarray  # ``1/A int N_i X' dA``, shape (n, d), m
    inertia: np.ndarray  # ``H / A``, shape (3, 3), or the scalar of the plane as (1, 1), m2

    @classmethod
    def of(cls, places: np.ndarray, faces: np.ndarray, kind: str) -> FaceFrame:
        """Make the frame of faces, shape (n_faces, n_face_nodes) in the order of their type `kind`, on nodes at places
        in the body's frame, shape (n_nodes, d), m."""
        nodes, local = np.unique(faces, return_inverse=True)
        local = local.reshape(faces.shape)
        rule = reference_element(kind).mass
        corners = places[faces]
        tangents = np.einsum("qja,eai->eqij", rule.gradients, corners)
        areas = np.sqrt(np.linalg.det(np.einsum("eqik,eqil->eqkl", tangents, tangents))) * rule.weights
        points = np.einsum("qa,eai->eqi", rule.values, corners)
        area = areas.sum()
        centre = np.einsum("eq,eqi->i", areas, points) / area
        shares = np.einsum("eq,qa->ea", areas, rule.values) / area
        moments = np.einsum("eq,qa,eqi->eai", areas, rule.values, points - centre, optimize=True) / area
        weights, arms = np.zeros(nodes.size), np.zeros((nodes.size, places.shape[1]))
        np.add.at(weights, local, shares)
        np.add.at(arms, local, moments)
        return cls(centre, nodes, weights, arms, _inertia(arms.T @ places[nodes]))

    @classmethod
    def of_nodes(cls, places: np.ndarray, nodes: np.ndarray) -> FaceFrame:
        """Make the frame of nodes (n,) that count alike, where faces are not known: means over nodes in place of areas.

        Places are those of all nodes in the body's frame, shape (n_nodes, d), m.
        """
        weights, centre = np.full(nodes.size, 1.0 / nodes.size), places[nodes].mean(axis=0)
        arms = (places[nodes] - centre) / nodes.size
        return cls(centre, nodes, weights, arms, _inertia(arms.T @ places[nodes]))

    @property
    def radius(self) -> float:
        """Smallest radius of gyration of the faces, m: how well the group carries a rotation."""
        return float(np.sqrt(max(np.linalg.eigvalsh(self.inertia)[0], 0.0)))

    def functionals(self, n_nodes: int) -> sp.csr_matrix:
        """Return what maps nodal displacements to those of the frame, its rotation at the end.

        Shape (3, 2 n_nodes) in the plane, ``(x, y, phi)``, and (6, 3 n_nodes) in space.
        """
        d = self.arms.shape[1]
        position = np.einsum("n,ij->inj", self.weights, np.eye(d))
        turning = np.einsum("ki,inj->knj", np.linalg.inv(self.inertia), _crossing(self.arms))
        values = np.concatenate([position, turning])
        columns = np.broadcast_to(d * self.nodes[:, None] + np.arange(d), values.shape)
        rows = np.broadcast_to(np.arange(len(values))[:, None, None], values.shape)
        return sp.coo_matrix((values.ravel(), (rows.ravel(), columns.ravel())), (len(values), d * n_nodes)).tocsr()


def _inertia(second: np.ndarray) -> np.ndarray:
    """Return H / A from the mean of ``X' X^T``."""
    return np.trace(second) * np.eye(3) - second if len(second) == 3 else np.array([[np.trace(second)]])


def _crossing(arms: np.ndarray) -> np.ndarray:
    """Return the matrix of ``u -> arms x u``, shape (3, n, 3), or (1, n, 2) in the plane."""
    if arms.shape[1] == 2:
        return np.stack([-arms[:, 1], arms[:, 0]], axis=1)[None]
    x, y, z = arms.T
    zero = np.zeros_like(x)
    return np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(0, 2, 1)
