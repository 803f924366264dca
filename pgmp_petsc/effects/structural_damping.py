"""Damping within the bodies.

Rayleigh's: stresses follow ``eps + beta eps'`` instead of the strains eps (Kelvin and Voigt), and the momentum is
braken at the rate alpha, forces ``-alpha M q'``. With eps' the rate of the beam's own strains, a rigid motion is not
damped by beta. Modal: ratios ``zeta_i`` of the elastic modes phi_i of each free body,

    -sum_i 2 zeta_i omega_i M phi_i phi_i^T M R^T q',

in the body's frame, which turns with its mean rotation R (`modal_damping`); the modes are M-orthogonal to rigid
motions, so these are not damped either. The iteration matrix of the full-order model leaves modal damping out, so
that each correction of a step leaves up to the largest ratio of the one before: ratios beyond 0.3 or so need small
steps.
"""

from __future__ import annotations

from dataclasses import dataclass

from pgmp_petsc.effects.effect import Effect
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene import effects as schema


@dataclass(frozen=True)
class BodyDamping:
    """Damping of one body.

    Attributes
    ----------
    stiffness, mass
        beta (s) and alpha (1/s).
    ratios
        ``zeta_i`` of its first elastic free modes.
    """

    stiffness: float = 0.0
    mass: float = 0.0
    ratios: tuple[float, ...] = ()


class StructuralDamping(Effect):
    """Structural damping; see the module.

    Attributes
    ----------
    of_body
        Damping of each of its bodies, by the body's number.
    """

    def __init__(self, name: str, entry: schema.StructuralDamping, mechanism: Mechanism) -> None:
        super().__init__(name)
        chosen = [
            i
            for i, body in enumerate(mechanism.bodies)
            if (body.flexible if entry.bodies is None else body.name in entry.bodies)
        ]
        self.of_body = {i: BodyDamping(entry.stiffness, entry.mass, entry.ratios) for i in chosen}
