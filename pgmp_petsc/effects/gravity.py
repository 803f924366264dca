"""Gravity: the mass matrix times a constant acceleration, one load term for each affine mass term."""

from __future__ import annotations

from itertools import product

import numpy as np

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects.effect import Effect
from pgmp_petsc.effects.load import Load
from pgmp_petsc.mechanism.mechanism import Mechanism, on_mesh
from pgmp_petsc.scene import effects as schema


class Gravity(Effect):
    """Gravity effect; see the module.

    Attributes
    ----------
    direction
        Of the acceleration, a unit vector of shape (d,).
    acceleration
        Its size, m/s2.
    """

    conservative = True

    def __init__(self, name: str, entry: schema.Gravity, mechanism: Mechanism) -> None:
        super().__init__(name)
        direction = self.direction = np.asarray(entry.direction, dtype=float) / np.linalg.norm(entry.direction)
        self.acceleration = Quantity.of(entry.acceleration)
        self._translational = {weight for body in mechanism.bodies for weight in body.translational_weights}
        self._bodies = mechanism.bodies
        self._mechanism = mechanism
        self._field = np.zeros(mechanism.n_dofs)
        mechanism.by_node(self._field)[:, : direction.size] = direction * self.acceleration.coefficient
        for body in mechanism.bodies:
            if body.meshed is not None:
                on_mesh(body, self._field)[:] = direction * self.acceleration.coefficient

    def loads(self, matrices: AffineMatrices) -> list[Load]:
        """Return ``M_i a``; the translational mass is isotropic, so body frames and the inertial one agree."""
        # a purely rotary mass term takes no part in a uniform field, on any rank, whatever its rows
        return [
            Load(self.name, weight * self.acceleration.monomial, mass @ self._field, (weight, self._field))
            for weight, mass in matrices.mass.items()
            if weight in self._translational
        ]

    def patterns(self, matrices: AffineMatrices) -> list[np.ndarray]:
        """Return the weight of every body along the two axes of its own frame: gravity turns in it."""
        vectors = []
        for body in self._bodies:
            for weight, axis in product(sorted(body.translational_weights), range(self._mechanism.space.dimension)):
                field = np.zeros_like(self._field)
                self._mechanism.by_node(field)[body.nodes, axis] = 1.0
                if body.meshed is not None:
                    on_mesh(body, field)[:, axis] = 1.0
                vectors.append(matrices.mass[weight] @ field)
        return vectors
