"""The beams in space that touch one rank's unknowns, for one full-order sample, in natural coordinates."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from pgmp_petsc.bodies.beam3d import Beams3d, natural_mass
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.matrices import element_dofs
from pgmp_petsc.dynamics.body_damping import BodyDampings
from pgmp_petsc.dynamics.rank_solids import SolidState
from pgmp_petsc.mechanism.unknowns import N_POSE, Unknowns


class RankBeams:
    """Elements of one body; the interface is that of `RankSolid`.

    Parameters
    ----------
    body, number
        The body and its number.
    rows
        The unknowns that this rank owns.
    values
        Parameter values of the sample.
    damping
        Structural damping.

    Attributes
    ----------
    dofs
        Unknowns of the elements, shape (n_e, 24).
    mass
        Of the elements, shape (n_e, 24, 24).
    body
        Number of the body.
    owned
        Whether the element is counted here, in sums over all ranks, shape (n_e,).
    """

    def __init__(
        self, body: Body, number: int, rows: range, values: Mapping[str, float], damping: BodyDampings
    ) -> None:
        dofs = element_dofs(body.elements, N_POSE)
        here = ((dofs >= rows.start) & (dofs < rows.stop)).any(axis=1)
        self.dofs, self.body = dofs[here], number
        self.owned = (self.dofs[:, 0] >= rows.start) & (self.dofs[:, 0] < rows.stop)
        lengths, axes = body.mesh.lengths[here], body.axes[here]
        stiffness, inertia = (
            sum(float(weight.evaluate(values)) * np.array(coefficients) for weight, coefficients in terms.items())
            for terms in (body.section.stiffness_terms(), body.section.mass_terms())
        )
        self._beams = Beams3d(lengths, axes, stiffness)
        self.mass = natural_mass(lengths, axes, inertia)
        self._beta, self._alpha = damping.rayleigh_of(number)

    @property
    def damped(self) -> bool:
        """Whether any velocity is needed."""
        return bool(self._beta or self._alpha)

    def evaluate(self, q: np.ndarray, v: np.ndarray, gain_v: float, fresh: bool = True) -> SolidState:
        """Evaluate all elements for unknowns and velocities (n_dofs,), valid where the elements are.

        `fresh` asks for tangents.
        """
        now = self._beams.at(q[self.dofs])
        forces, powers = self._beams.forces(now), np.zeros(len(self.dofs))
        tangents = self._beams.tangents(now) if fresh else None
        if self.damped:
            local = v[self.dofs]
            braking = self._alpha * np.einsum("eij,ej->ei", self.mass, local)
            if self._beta:
                viscosity = self._beta * self._beams.viscosity(now)
                braking += np.einsum("eij,ej->ei", viscosity, local)
                if fresh:
                    tangents += gain_v * viscosity
            forces += braking
            powers -= np.sum(braking * local, axis=1)
        return SolidState(forces, tangents, powers)

    def strain_energy(self, q: np.ndarray) -> float:
        """Return the strain energy of the elements that are counted here, J, for unknowns q (n_dofs,)."""
        return float(self._beams.strain_energy(self._beams.at(q[self.dofs]))[self.owned].sum())

    def matrices(self, gains: tuple[float, float, float], tangents: np.ndarray) -> np.ndarray:
        """Return the elements' parts of the iteration matrix, shape (n_e, 24, 24)."""
        gain_v, gain_a, gain_k = gains
        return (gain_a + gain_v * self._alpha) * self.mass + gain_k * tangents


def rank_beams(
    unknowns: Unknowns, rows: range, values: Mapping[str, float], damping: BodyDampings
) -> Iterator[RankBeams]:
    """Yield the beams of all bodies."""
    for number, body in enumerate(unknowns.bodies):
        if body.is_beam:
            yield RankBeams(body, number, rows, values, damping)
