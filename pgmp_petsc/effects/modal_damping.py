"""Modal damping of free bodies: a constant matrix in each body's frame, which turns with the body.

    D = sum_i 2 zeta_i omega_i (M phi_i) (M phi_i)^T = P P^T,     forces  -R P P^T R^T q'

with the elastic modes of the free body at the nominal parameters. Rigid motions are M-orthogonal to them and not
damped. The rotation R of a beam is the mass-weighted mean of those of its nodes, in space the rotation closest to the
mean of their directors. That of a body on a mesh is the one that brings the places of its points closest to where they
are, ``int rho x X'^T dV = R U`` (polar decomposition, with X' the places less their centre of mass).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.free_modes import free_modes, own_unknowns
from pgmp_petsc.effects.effect import Effect
from pgmp_petsc.effects.structural_damping import StructuralDamping
from pgmp_petsc.mechanism.space import SPATIAL


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
        What R is measured by: where nodes have rotations of their own their shares in the body's mass, shape (n_nodes,
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
        return _closest_rotation(np.einsum("ain,aj->nij", nodes, self.levers))


class ModalDampingInSpace(ModalDamping):
    """Modal damping of a beam in space, whose nodes have a position and three directors each.

    The angular velocity of a node is ``1/2 sum_k d_k x d_k'``, so that a couple m acts on its director d_k with the
    force ``1/2 m x d_k``.
    """

    def forces(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the forces on `dofs` and their power; see `ModalDamping.forces`."""
        nodes, rates = self._by_node(q[self.dofs]), self._by_node(v[self.dofs])
        n_nodes, _, n = nodes.shape
        # component c of director k: [node, k, c, sample]
        directors, turning = (part[:, 3:].reshape(n_nodes, 3, 3, n) for part in (nodes, rates))
        turn = _closest_rotation(np.einsum("a,akcn->nck", self.levers[:, 0], directors))
        spins = 0.5 * np.cross(directors, turning, axis=2).sum(axis=1)
        moving = np.stack([rates[:, :3], spins], axis=1)  # velocity and spin: [node, which, c, sample]
        local = np.einsum("cin,aucn->auin", turn, moving)
        along = self.factor.T @ local.reshape(-1, n)
        acting = -(self.factor @ along).reshape(n_nodes, 2, 3, n)
        force, couple = np.moveaxis(np.einsum("cin,auin->aucn", turn, acting), 1, 0)
        on_directors = 0.5 * np.cross(couple[:, None], directors, axis=2)
        found = np.concatenate([force, on_directors.reshape(n_nodes, 9, n)], axis=1)
        return found.reshape(-1, n), -np.sum(along**2, axis=0)


def _closest_rotation(matrices: np.ndarray) -> np.ndarray:
    """Return the rotations closest to matrices (n, d, d), shape (d, d, n)."""
    left, _, right = np.linalg.svd(matrices)
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
    if body.meshed is not None:
        places = body.meshed.solid.mesh.nodes
        d = places.shape[1]
        along = mass[::d, ::d]
        centre = np.asarray(along.sum(axis=0)) @ places / along.sum()
        return ModalDamping(effect, number, own_unknowns(body), factor, along @ (places - centre))
    of_nodes = mass.diagonal()[: body.node_dofs * body.n_nodes : body.node_dofs, None]
    shares = of_nodes / of_nodes.sum()
    if body.node_dofs == SPATIAL.n_dofs:
        first, last = (SPATIAL.n_pose * node for node in (body.nodes.start, body.nodes.stop))
        return ModalDampingInSpace(effect, number, np.arange(first, last), factor, shares)
    return ModalDamping(effect, number, own_unknowns(body), factor, shares)
