"""Structural damping in the full-order model; see `effects.structural_damping` for the equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.body import DOFS_PER_NODE
from pgmp_petsc.effects import Effect
from pgmp_petsc.effects.modal_damping import ModalDamping, modal_damping
from pgmp_petsc.effects.structural_damping import BodyDamping, StructuralDamping
from pgmp_petsc.mechanism.attachment import rotate
from pgmp_petsc.mechanism.mechanism import Mechanism


@dataclass(frozen=True, eq=False)
class BodyDampings:
    """The damping of all bodies.

    Attributes
    ----------
    rayleigh
        Damping of each body that has Rayleigh's, by the body's number.
    effects
        Name of the effect that each of these belongs to.
    modal
        Modal damping of bodies.
    mechanism
        The mechanism.
    """

    rayleigh: dict[int, BodyDamping]
    effects: dict[int, str]
    modal: tuple[ModalDamping, ...]
    mechanism: Mechanism

    @classmethod
    def of(cls, effects: Sequence[Effect], mechanism: Mechanism) -> BodyDampings:
        """Collect the structural damping of all effects.

        Raises
        ------
        InputError
            If a body's mesh has fewer modes than ratios are given.
        """
        rayleigh, names = {}, {}
        for effect in effects:
            if isinstance(effect, StructuralDamping):
                for number, damping in effect.of_body.items():
                    if damping.stiffness or damping.mass:
                        rayleigh[number], names[number] = damping, effect.name
        return cls(rayleigh, names, modal_damping(effects, mechanism, mechanism.scene.nominal), mechanism)

    @property
    def any_rayleigh(self) -> bool:
        """Whether any body has Rayleigh's damping."""
        return bool(self.rayleigh)

    def rayleigh_of(self, number: int) -> tuple[float, float]:
        """Return beta (s) and alpha (1/s) of a body."""
        damping = self.rayleigh.get(number, BodyDamping())
        return damping.stiffness, damping.mass

    def add_modal_forces(self, q: np.ndarray, v: np.ndarray, total: np.ndarray) -> dict[str, np.ndarray]:
        """Add the forces of modal damping, for q, v and the total of shape (n_dofs, n).

        Returns
        -------
        dict
            Power by effect, shape (n,), W.
        """
        powers: dict[str, np.ndarray] = {}
        for modal in self.modal:
            body = self.mechanism.bodies[modal.body]
            own = slice(DOFS_PER_NODE * body.nodes.start, DOFS_PER_NODE * body.nodes.stop)
            angle = modal.weights @ q[own][2::DOFS_PER_NODE]
            rates = modal.factor.T @ _turned(-angle, v[own])
            total[own] -= _turned(angle, modal.factor @ rates)
            powers[modal.effect] = powers.get(modal.effect, 0.0) - np.sum(rates**2, axis=0)
        return powers


def _turned(angle: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Turn nodal vectors (n_dofs, n) by angles (n,)."""
    turned = vectors.copy()
    turned[0::DOFS_PER_NODE], turned[1::DOFS_PER_NODE] = rotate(
        angle, np.array([vectors[0::DOFS_PER_NODE], vectors[1::DOFS_PER_NODE]])
    )
    return turned
