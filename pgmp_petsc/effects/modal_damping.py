"""Modal damping of free bodies: a constant matrix in each body's frame, which turns with the body.

    D = sum_i 2 zeta_i omega_i (M phi_i) (M phi_i)^T = P P^T,     forces  -R P P^T R^T q'

with the elastic modes of the free body at the nominal parameters. Rigid motions are M-orthogonal to them and not
damped. The rotation R of a beam is the mass-weighted mean of those of its nodes; that of a body on a mesh is the one
that brings the places of its points closest to where they are, ``int rho x X'^T dV = R U`` (polar decomposition, with
X' the places less their centre of mass).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.free_modes import free_modes, own_unknowns
from pgmp_petsc.effects.effect import Effect
from pgmp_petsc.effects.structural_damping import StructuralDamping


@dataclass(frozen=True)
class ModalDamping:
    """Modal damping of one body.

    Attributes
    ----------
    effect
        Name of the effect.
    body
        Number of the body.
    dofs
        Its unknowns that are damped, node after node, shape (n_own,).
    factor
        P in the body's frame, shape (n_own, n_modes).
    levers
        What R is measured by: where nodes have a rotation of their own their shares in the body's mass, shape (n_nodes,
        1), and on a mesh ``M X'``, shape (n_nodes, d), kg m.
    """

    effect: str
    body: int
    dofs: np.ndarray
    factor: np.ndarray
    levers: np.ndarray

    def forces(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the forces on `dofs`, shape (n_own, n), and their power, shape (n,), W, at q and v (n_dofs, n)."""
        nodes = self._by_node(q[self.dofs])
        turn = self._rotation(nodes)
        d = turn.shape[0]
        rates = self._by_node(v[self.dofs]).copy()
        rates[:, :d] = np.einsum("jin,ajn->ain", turn, rates[:, :d])
        along = self.factor.T @ rates.reshape(self.dofs.size, -1)
        forces = -self._by_node(self.factor @ along)
        forces[:, :d] = np.einsum("ijn,ajn->ain", turn, forces[:, :d])
        return forces.reshape(self.dofs.size, -1), -np.sum(along**2, axis=0)

    def _by_node(self, vectors: np.ndarray) -> np.ndarray:
        return vectors.reshape(len(self.levers), -1, vectors.shape[-1])

    def _rotation(self, nodes: np.ndarray) -> np.ndarray:
        """Return R, shape (d, d, n), from the unknowns of the nodes, shape (n_nodes, n_per_node, n)."""
        if self.levers.shape[1] == 1:
            angle = self.levers[:, 0] @ nodes[:, 2]
            cos, sin = np.cos(angle), np.sin(angle)
            return np.array([[cos, -sin], [sin, cos]])
        moment = np.einsum("ain,aj->nij", nodes, self.levers)
        left, _, right = np.linalg.svd(moment)
        left[..., -1] *= np.linalg.det(left @ right)[:, None]
        return np.moveaxis(left @ right, 0, 2)


def modal_damping(
    effects: Sequence[Effect], bodies: Sequence[Body], nominal: Mapping[str, float]
) -> tuple[ModalDamping, ...]:
    """Return the modal damping of all bodies that have one, for bodies as the unknowns are numbered.

    Raises
    ------
    InputError
        If a body's mesh has fewer modes than ratios are given.
    """
    found = []
    for effect in effects:
        if isinstance(effect, StructuralDamping):
            for number, damping in effect.of_body.items():
                if any(damping.ratios):
                    found.append(_of_body(effect.name, number, bodies[number], damping.ratios, nominal))
    return tuple(found)


def _of_body(
    effect: str, number: int, body: Body, ratios: Sequence[float], nominal: Mapping[str, float]
) -> ModalDamping:
    omega, phi, mass = free_modes(body, nominal, len(ratios), f"effects.{effect}.ratios")
    factor = mass @ phi * np.sqrt(2.0 * np.array(ratios) * omega)
    if body.meshed is None:
        of_nodes = mass.diagonal()[: body.node_dofs * body.n_nodes : body.node_dofs, None]
        levers = of_nodes / of_nodes.sum()
    else:
        places = body.meshed.solid.mesh.nodes
        d = places.shape[1]
        along = mass[::d, ::d]
        centre = np.asarray(along.sum(axis=0)) @ places / along.sum()
        levers = along @ (places - centre)
    return ModalDamping(effect, number, own_unknowns(body), factor, levers)
