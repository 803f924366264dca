"""Masses of nodes for a batch of full-order samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.matrices import lumped_entries


@dataclass(frozen=True, eq=False)
class LumpedMasses:
    """Masses (kg) and moments of inertia (kg m2) on single unknowns.

    Attributes
    ----------
    dofs, body
        Unknown and number of its body, shape (n_lumped,); three a node.
    mass
        Shape (n_lumped, n_samples).
    """

    dofs: np.ndarray
    body: np.ndarray
    mass: np.ndarray


def lumped_masses(bodies: Sequence[Body], values: Mapping[str, np.ndarray], n_samples: int) -> LumpedMasses:
    """Evaluate the masses of all nodes that have their own for samples with parameter values of shape (n_samples,)."""
    dofs, owners, masses = [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)], [np.zeros((0, n_samples))]
    for number, body in enumerate(bodies):
        if body.lumps:
            unknowns, entries = lumped_entries(body)
            weighted = [
                np.outer(part, weight.evaluate(values) * np.ones(n_samples)) for weight, part in entries.items()
            ]
            dofs.append(unknowns)
            owners.append(np.full(unknowns.size, number))
            masses.append(sum(weighted))
    return LumpedMasses(np.concatenate(dofs), np.concatenate(owners), np.concatenate(masses))
