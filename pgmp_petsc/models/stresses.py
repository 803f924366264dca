"""Stresses as the models know them: what they share, and those of full-order and component models.

The full-order model has the strains of its meshes themselves. A body that is condensed has strains ``S y`` linear in
its coordinates y, with a constant matrix S: those of the displacements T y. In the component model y are the
amplitudes of its fields; `reduced_fields` has those of the reduced model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.bodies.affine import Values
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.floating import products
from pgmp_petsc.bodies.stresses import Strains
from pgmp_petsc.mechanism.mechanism import Unknowns
from pgmp_petsc.outputs.outputs import OutputSet

if TYPE_CHECKING:
    from pgmp_petsc.outputs.stress import StressOutput

AT_ONCE = 2**22  # strains that are evaluated together: 32 MB


def full_strains(
    unknowns: Unknowns, number: int, points: Strains, q: np.ndarray, linear: np.ndarray | None = None
) -> np.ndarray:
    """Return the strains of points of a body, shape (n_points, n_strains, n), from the unknowns (n_dofs, n) of a
    full-order or a component model; `linear` is the matrix S of a body that is condensed, where it is at hand."""
    body = unknowns.bodies[number]
    if body.n_amplitudes:
        return of_coordinates(body, points, q[body.internal], linear)
    return points.of_places(body.moving_nodes(q, unknowns.frames(q)))


class FullStresses:
    """Stresses, outputs of the scene, from the unknowns of a full-order or a component model."""

    def __init__(self, outputs: OutputSet, unknowns: Unknowns) -> None:
        self._stresses, self._unknowns = outputs.stresses, unknowns
        self._linear = linear_maps(
            [s for s in outputs.stresses if unknowns.bodies[s.body].n_amplitudes], unknowns.bodies
        )

    def of(self, q: np.ndarray, values: Values) -> np.ndarray:
        """Return the stresses, shape (n_stresses, n), for unknowns (n_dofs, n); values are numbers or of shape (n,)."""

        def forces(number: int, part: slice) -> np.ndarray:
            stress = self._stresses[number]
            linear = self._linear.get(stress.name)
            strains = full_strains(self._unknowns, stress.body, stress.points, q[:, part], linear)
            return stress.law.forces(stress.points, strains, values_of(values, part))

        return in_blocks(self._stresses, forces, q.shape[1], values)


def of_coordinates(body: Body, points: Strains, y: np.ndarray, linear: np.ndarray | None) -> np.ndarray:
    """Return strains that are linear in a body's coordinates y (n_dofs, n), by the matrix S where it is at hand."""
    if linear is None:
        return points.of_displacements(body.displacements(y))
    return products(linear.reshape(1, -1, linear.shape[2]), y[None]).reshape(*linear.shape[:2], y.shape[1])


def linear_maps(stresses: Iterable[StressOutput], bodies: Sequence[Body]) -> dict[str, np.ndarray]:
    """Return S of each stress, shape (n_points, n_strains, n_dofs), by its name."""
    found = {}
    for stress in stresses:
        by_node = bodies[stress.body].by_node
        parts = (stress.points.of_displacements(by_node[..., part]) for part in _blocks(stress, by_node.shape[2]))
        found[stress.name] = np.concatenate(list(parts), axis=2)
    return found


def in_blocks(
    stresses: Sequence[StressOutput], forces: Callable[[int, slice], np.ndarray], n: int, values: Values
) -> np.ndarray:
    """Return stress outputs of n instants, shape (n_stresses, n), from the forces of some at a time."""
    found = np.empty((len(stresses), n))
    for number, (row, stress) in enumerate(zip(found, stresses)):
        for part in _blocks(stress, n):
            row[part] = stress.value(forces(number, part), values_of(values, part))
    return found


def _blocks(stress: StressOutput, n: int) -> Iterator[slice]:
    """Yield parts of n columns that are evaluated together."""
    step = max(1, AT_ONCE // max(1, stress.points.width))
    for first in range(0, n, step):
        yield slice(first, min(first + step, n))


def values_of(values: Values, part: slice) -> dict[str, np.ndarray | float]:
    """Return the parameter values of some samples; numbers are those of all."""
    return {name: value[part] if np.ndim(value) and np.size(value) > 1 else value for name, value in values.items()}
