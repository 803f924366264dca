"""What rotations in space add to inertia at second order: sections and rigid bodies turn by ``exp(phi)``.

A node's directors are ``d_k = R exp(phi) e_k``. Their second derivative in two vectors a and b of displacements and
rotations, ``1/2 (a x (b x e_k) + b x (a x e_k))``, stands beside chi wherever chi meets the mass (`modes.curvature`).
With the inertia J of the directors at a node (`bodies.inertia_moments`) its momentum on a rotation phi is

    phi . 1/2 ((J a) x b + (J b) x a),

and accelerations ``A e_k`` of the directors do the work ``a . (sym(A J) - tr(A J) 1) b`` on it. In the plane there is
nothing of the kind: angles add up.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.inertia_moments import director_inertia
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.space import SPATIAL, turning_of_second_order

Pairs = tuple[np.ndarray, np.ndarray]


class RotaryCurvature:
    """The directors of all nodes.

    Parameters
    ----------
    mechanism
        The mechanism; bodies on meshes and condensed ones have no directors with mass.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self._n_dofs = mechanism.n_dofs
        self._parts: list[tuple[int, Monomial, np.ndarray, np.ndarray]] = []  # body, weight, rotations, J
        if mechanism.space is not SPATIAL:
            return
        for number, body in enumerate(mechanism.bodies):
            turns = 6 * np.arange(body.nodes.start, body.nodes.stop)[:, None] + np.arange(3, 6)
            self._parts += [(number, weight, turns, inertia) for weight, inertia in director_inertia(body).items()]

    def momenta(self, vectors: np.ndarray, pairs: Pairs, values: Mapping[str, float]) -> np.ndarray:
        """Return the momenta on all unknowns for pairs of vectors (n_dofs, m), shape (n_dofs, n_pairs)."""
        result = np.zeros((self._n_dofs, pairs[0].size))
        for _, weight, turns, inertia in self._parts:
            a, b = vectors[turns][:, :, pairs[0]], vectors[turns][:, :, pairs[1]]
            held_a, held_b = inertia @ a, inertia @ b
            crossed = np.cross(held_a, b, axis=1) + np.cross(held_b, a, axis=1)
            result[turns] += 0.5 * float(weight.evaluate(values)) * crossed
        return result

    def work(self, accelerations: np.ndarray, vectors: np.ndarray, pairs: Pairs, weight: Monomial) -> np.ndarray:
        """Return the work of accelerations on pairs of vectors in one term of the mass, shape (k, n_pairs).

        Parameters
        ----------
        accelerations
            Linear fields of every body, shape (n_bodies, 12, k): `Space.acceleration_field`.
        vectors
            Shape (n_dofs, m).
        """
        result = np.zeros((accelerations.shape[2], pairs[0].size))
        for number, own, turns, inertia in self._parts:
            if own != weight:
                continue
            gradients = np.moveaxis(accelerations[number, 3:].reshape(3, 3, -1), -1, 0)
            curved = turning_of_second_order(gradients[:, None] @ inertia)
            a, b = vectors[turns][:, :, pairs[0]], vectors[turns][:, :, pairs[1]]
            result += np.einsum("knij,nip,njp->kp", curved, a, b, optimize=True)
        return result
