"""Structural damping in the full-order model; see `effects.structural_damping` for the equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.effects import Effect
from pgmp_petsc.effects.modal_damping import ModalDamping, modal_damping
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
        Name of the effect that each of these belongs to.
    modal
        Modal damping of bodies.
    """

    rayleigh: dict[int, BodyDamping]
    effects: dict[int, str]
    modal: tuple[ModalDamping, ...]

    @classmethod
    def of(cls, effects: Sequence[Effect], mechanism: Mechanism, bodies: Sequence[Body] | None = None) -> BodyDampings:
        """Collect the structural damping of all effects.

        `bodies` are the mechanism's with another numbering of their unknowns, where it is not the mechanism's own.

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
        bodies = mechanism.bodies if bodies is None else bodies
        return cls(rayleigh, names, modal_damping(effects, bodies, mechanism.scene.nominal))

    @property
    def any_rayleigh(self) -> bool:
        """Whether any body has Rayleigh's damping."""
        return bool(self.rayleigh)

    def rayleigh_of(self, number: int) -> tuple[float, float]:
        """Return beta (s) and alpha (1/s) of a body."""
        damping = self.rayleigh.get(number, BodyDamping())
        return damping.stiffness, damping.mass
