"""Modal damping of free bodies as a constant matrix in each body's frame.

    D = sum_i 2 zeta_i omega_i (M phi_i) (M phi_i)^T = P P^T

with the elastic modes of the free body at the nominal parameters. Rigid motions are M-orthogonal to them and not
damped.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.free_modes import free_modes
from pgmp_petsc.bodies.matrices import assemble, weighted_sum
from pgmp_petsc.effects.effect import Effect
from pgmp_petsc.effects.structural_damping import StructuralDamping
from pgmp_petsc.mechanism.mechanism import Mechanism


@dataclass(frozen=True, eq=False)
class ModalDamping:
    """Modal damping of one body.

    Attributes
    ----------
    effect
        Name of the effect.
    body
        Number of the body.
    factor
        P in the body's frame, shape (n_body_dofs, n_modes).
    weights
        Share of each node's rotation in the body's, shape (n_body_nodes,).
    """

    effect: str
    body: int
    factor: np.ndarray
    weights: np.ndarray


def modal_damping(
    effects: Sequence[Effect], mechanism: Mechanism, nominal: Mapping[str, float]
) -> tuple[ModalDamping, ...]:
    """Return the modal damping of all bodies that have one; they are of beams (`mechanism.capabilities`).

    Raises
    ------
    InputError
        If a body's mesh has fewer modes than ratios are given.
    """
    found = []
    for effect in effects:
        if not isinstance(effect, StructuralDamping):
            continue
        for number, damping in effect.of_body.items():
            if not any(damping.ratios):
                continue
            body = mechanism.bodies[number]
            omega, phi = free_modes(body, nominal, len(damping.ratios), f"effects.{effect.name}.ratios")
            alone = body.alone()
            mass = weighted_sum(assemble([alone], range(len(phi))).mass, nominal)
            factor = mass @ phi * np.sqrt(2.0 * np.array(damping.ratios) * omega)
            translational = mass.diagonal()[: body.node_dofs * body.n_nodes : body.node_dofs]
            found.append(ModalDamping(effect.name, number, factor, translational / translational.sum()))
    return tuple(found)
