"""The beam elements and masses that touch one rank's nodes, for one full-order sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.beam2d import (
    N_PACKED,
    PACKED_COLUMNS,
    PACKED_ROWS,
    add_damping,
    force_and_tangent,
    strain_energy,
)
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.matrices import element_dofs, touching
from pgmp_petsc.dynamics.body_damping import BodyDampings
from pgmp_petsc.dynamics.lumped_masses import lumped_masses
from pgmp_petsc.runtime.compiled import njit


@dataclass(frozen=True, eq=False)
class ElementState:
    """Elements evaluated in one state.

    Attributes
    ----------
    forces
        Internal and damping forces, shape (n_e, 6).
    tangents
        Their packed derivatives, shape (n_e, 21).
    powers
        Power of the structural damping, shape (n_e,), W.
    """

    forces: np.ndarray
    tangents: np.ndarray
    powers: np.ndarray


class RankElements:
    """Elements and masses of nodes on one rank.

    Parameters
    ----------
    bodies
        Bodies of the mechanism.
    rows
        The unknowns that this rank owns.
    values
        Parameter values of the sample.
    damping
        Structural damping.

    Attributes
    ----------
    dofs
        Unknowns of the elements, shape (n_e, 6).
    body
        Number of each element's body, shape (n_e,).
    owned
        Whether the element is counted here, in sums over all ranks, shape (n_e,).
    lumped
        Unknowns with masses of their own, shape (n_lumped,), and `lumped_mass` beside them.
    """

    def __init__(
        self, bodies: Sequence[Body], rows: range, values: Mapping[str, float], damping: BodyDampings
    ) -> None:
        dofs, lengths, directions, sections, masses, owners = [], [], [], [], [], []
        for number, body in enumerate(bodies):
            if not body.is_beam:
                continue
            chosen = touching(body, rows)
            section = body.section
            quantities = (section.axial, section.shear, section.bending)
            numbers = [float(q.at(values)) for q in quantities]
            dofs.append(element_dofs(body.elements[chosen]))
            lengths.append(body.mesh.lengths[chosen])
            directions.append(body.directions[chosen])
            sections.append(np.tile([*numbers, *damping.rayleigh_of(number)], (chosen.size, 1)))
            masses.append(sum(float(w.evaluate(values)) * matrix for w, matrix in body.mass_entries(chosen).items()))
            owners.append(np.full(chosen.size, number))
        self.dofs = np.concatenate([np.zeros((0, 6), dtype=int), *dofs])
        self.body = np.concatenate([np.zeros(0, dtype=int), *owners])
        self._lengths, self._directions = np.concatenate([[], *lengths]), np.concatenate([[], *directions])
        self._sections = np.concatenate([np.zeros((0, 5)), *sections])
        self._mass = np.concatenate([np.zeros((0, 6, 6)), *masses])
        self._damped = damping.any_rayleigh
        self.owned = (self.dofs[:, 0] >= rows.start) & (self.dofs[:, 0] < rows.stop)
        lumps = lumped_masses(bodies, {name: np.array([value]) for name, value in values.items()}, 1)
        here = (lumps.dofs >= rows.start) & (lumps.dofs < rows.stop)
        self.lumped, self.lumped_body, self.lumped_mass = lumps.dofs[here], lumps.body[here], lumps.mass[here, 0]
        self._braking = np.array([damping.rayleigh_of(number)[1] for number in self.lumped_body]).reshape(here.sum())

    @property
    def damped(self) -> bool:
        """Whether any velocity is needed."""
        return self._damped

    def evaluate(self, q: np.ndarray, v: np.ndarray, gain_v: float) -> ElementState:
        """Evaluate all elements for unknowns and velocities (n_dofs,), valid where the elements are."""
        n = len(self.dofs)
        state = ElementState(np.empty((n, 6)), np.empty((n, N_PACKED)), np.zeros(n))
        _evaluate(
            self.dofs, self._lengths, self._directions, self._sections, q, v, gain_v, self._damped,
            state.forces, state.tangents, state.powers,
        )  # fmt: skip
        if self._damped:
            local = v[self.dofs]
            braking = self._sections[:, 4, None] * np.einsum("eij,ej->ei", self._mass, local)
            state.forces[:] += braking
            state.powers[:] -= np.sum(braking * local, axis=1)
        return state

    def strain_energy(self, q: np.ndarray) -> float:
        """Return the strain energy of the elements that are counted here, J, for unknowns q (n_dofs,)."""
        return sum(
            strain_energy(q[self.dofs[e]], self._lengths[e], self._directions[e], self._sections[e])
            for e in np.flatnonzero(self.owned)
        )

    def lumped_forces(self, v: np.ndarray) -> np.ndarray:
        """Return the braking forces on the masses of nodes, shape (n_lumped,)."""
        return self._braking * self.lumped_mass * v[self.lumped]

    def lumped_tangents(self, gain_v: float, gain_a: float) -> np.ndarray:
        """Return the entries of the masses of nodes on the diagonal of the iteration matrix, shape (n_lumped,)."""
        return (gain_a + gain_v * self._braking) * self.lumped_mass

    def matrices(self, gains: tuple[float, float, float], tangents: np.ndarray) -> np.ndarray:
        """Return the elements' parts of the iteration matrix, shape (n_e, 6, 6)."""
        gain_v, gain_a, gain_k = gains
        matrices = (gain_a + gain_v * self._sections[:, 4])[:, None, None] * self._mass
        packed = gain_k * tangents
        matrices[:, PACKED_ROWS, PACKED_COLUMNS] += packed
        below = PACKED_ROWS != PACKED_COLUMNS
        matrices[:, PACKED_COLUMNS[below], PACKED_ROWS[below]] += packed[:, below]
        return matrices


@njit(cache=True, error_model="numpy")
def _evaluate(dofs, lengths, directions, sections, q, v, gain_v, damped, forces, tangents, powers):
    """Evaluate force (n_e, 6), packed tangent (n_e, 21) and damping power (n_e,) of every element."""
    u, rate, force, power = np.empty((6, 1)), np.empty((6, 1)), np.empty((6, 1)), np.empty(1)
    section, tangent = np.empty((3, 1)), np.empty((N_PACKED, 1))
    for e in range(len(lengths)):
        for i in range(6):
            u[i, 0] = q[dofs[e, i]]
        for i in range(3):
            section[i, 0] = sections[e, i]
        force_and_tangent(u, lengths[e], directions[e], section, force, tangent)
        if damped:
            for i in range(6):
                rate[i, 0] = v[dofs[e, i]]
            beta = sections[e, 3:4]
            add_damping(u, rate, lengths[e], directions[e], section, beta, gain_v, force, tangent, power)
            powers[e] = power[0]
        forces[e] = force[:, 0]
        tangents[e] = tangent[:, 0]
