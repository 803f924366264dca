"""Structural damping in the full-order model; see `effects.structural_damping` for the equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.effects import Effect
from pgmp_petsc.effects.modal_damping import ModalDamping, amplitude_damping, modal_damping
from pgmp_petsc.effects.structural_damping import BodyDamping, StructuralDamping
from pgmp_petsc.mechanism.mechanism import Mechanism


@dataclass(frozen=True, eq=False)
class BodyDampings:
    """The damping of all bodies.

    Attributes
    ----------
    rayleigh
        Damping of each body that has Rayleigh's, by the body's number.
    effects
        Name of the effect that each of these belongs to, and each of those with amplitudes.
    modal
        Modal damping of bodies on their meshes.
    amplitudes
        Modal damping of bodies in floating frames, N s/m of each amplitude, by the body's number.
    """

    rayleigh: dict[int, BodyDamping]
    effects: dict[int, str]
    modal: tuple[ModalDamping, ...]
    amplitudes: dict[int, np.ndarray]

    @classmethod
    def of(cls, effects: Sequence[Effect], mechanism: Mechanism, bodies: Sequence[Body] | None = None) -> BodyDampings:
        """Collect the structural damping of all effects.

        `bodies` are the mechanism's with another numbering of their unknowns, where it is not the mechanism's own.

        Raises
        ------
        InputError
            If a body has fewer modes than ratios are given.
        """
        rayleigh, names = {}, {}
        for effect in effects:
            if isinstance(effect, StructuralDamping):
                for number, damping in effect.of_body.items():
                    if damping.stiffness or damping.mass:
                        rayleigh[number], names[number] = damping, effect.name
        bodies, nominal = mechanism.bodies if bodies is None else bodies, mechanism.scene.nominal
        braked = amplitude_damping(effects, bodies, nominal)
        names |= {number: effect for number, (effect, _) in braked.items()}
        amplitudes = {number: coefficients for number, (_, coefficients) in braked.items()}
        return cls(rayleigh, names, modal_damping(effects, bodies, nominal), amplitudes)

    @property
    def any_rayleigh(self) -> bool:
        """Whether any body has Rayleigh's damping."""
        return bool(self.rayleigh)

    def of_amplitudes(self, number: int, n: int) -> np.ndarray:
        """Return the modal damping of a body's n amplitudes, shape (n,), N s/m."""
        return self.amplitudes.get(number, np.zeros(n))

    def rayleigh_of(self, number: int) -> tuple[float, float]:
        """Return beta (s) and alpha (1/s) of a body."""
        damping = self.rayleigh.get(number, BodyDamping())
        return damping.stiffness, damping.mass
