"""The continuum elements that touch one rank's unknowns, for one full-order sample."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies import elasticity
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.elasticity import Geometry, Lame
from pgmp_petsc.bodies.solid import Region
from pgmp_petsc.dynamics.body_damping import BodyDampings
from pgmp_petsc.mesh.reference_element import reference_element


@dataclass(frozen=True, eq=False)
class SolidState:
    """Elements evaluated in one state.

    Attributes
    ----------
    forces
        Internal and damping forces, shape (n_e, m).
    tangents
        Their derivatives, shape (n_e, m, m); None where they were not asked for.
    powers
        Power of the structural damping, shape (n_e,), W.
    """

    forces: np.ndarray
    tangents: np.ndarray | None
    powers: np.ndarray


class RankSolid:
    """Elements of one material of one body.

    Parameters
    ----------
    body, number
        The body and its number.
    region
        The material's cells.
    rows
        The unknowns that this rank owns.
    values
        Parameter values of the sample.
    damping
        Structural damping.

    Attributes
    ----------
    dofs
        Unknowns of the elements, shape (n_e, m).
    body
        Number of the body.
    owned
        Whether the element is counted here, in sums over all ranks, shape (n_e,).
    """

    def __init__(
        self,
        body: Body,
        number: int,
        region: Region,
        rows: range,
        values: Mapping[str, float],
        damping: BodyDampings,
    ) -> None:
        mesh = body.meshed.solid.mesh
        d, element = mesh.dimension, reference_element(mesh.kind)
        cells = mesh.cells[region.cells]
        dofs = (body.first_internal + d * cells[:, :, None] + np.arange(d)).reshape(len(cells), -1)
        here = ((dofs >= rows.start) & (dofs < rows.stop)).any(axis=1)
        self.dofs, self.body, self._d = dofs[here], number, d
        self.owned = (self.dofs[:, 0] >= rows.start) & (self.dofs[:, 0] < rows.stop)
        places = mesh.nodes[cells[here]]
        self._geometry = Geometry.of(places, element.stiffness)
        self._lame = Lame.of(region.nu, d == 2)
        self._modulus = float(region.modulus.at(values))
        density = float(region.density.at(values))
        scalar = density * elasticity.mass(elasticity.volumes_of(places, element.mass), element.mass)
        n, m = self.dofs.shape
        self._mass = np.einsum("eab,ij->eaibj", scalar, np.eye(d)).reshape(n, m, m)
        self._beta, self._alpha = damping.rayleigh_of(number)

    @property
    def damped(self) -> bool:
        """Whether any velocity is needed."""
        return bool(self._beta or self._alpha)

    def evaluate(self, q: np.ndarray, v: np.ndarray, gain_v: float, fresh: bool = True) -> SolidState:
        """Evaluate all elements for unknowns and velocities (n_dofs,), valid where the elements are.

        `fresh` asks for tangents, which take several times as long as forces.
        """
        n, m = self.dofs.shape
        places = self._by_node(q)
        forces = self._modulus * elasticity.forces(places, self._geometry, self._lame).reshape(n, m)
        tangents = None
        if fresh:
            tangents = self._modulus * elasticity.tangents(places, self._geometry, self._lame).reshape(n, m, m)
        powers = np.zeros(n)
        if self.damped:
            local = v[self.dofs]
            braking = self._alpha * np.einsum("eij,ej->ei", self._mass, local)
            if self._beta:
                rates = self._by_node(v)
                factor = self._beta * self._modulus
                viscous = elasticity.viscous_forces(places, rates, self._geometry, self._lame)
                braking += factor * viscous.reshape(n, m)
                if fresh:
                    resisting = elasticity.viscous_tangents(places, self._geometry, self._lame)
                    tangents += gain_v * factor * resisting.reshape(n, m, m)
            forces += braking
            powers -= np.sum(braking * local, axis=1)
        return SolidState(forces, tangents, powers)

    def strain_energy(self, q: np.ndarray) -> float:
        """Return the strain energy of the elements that are counted here, J, for unknowns q (n_dofs,)."""
        places = self._by_node(q)
        return self._modulus * float(elasticity.strain_energy(places, self._geometry, self._lame)[self.owned].sum())

    def _by_node(self, vector: np.ndarray) -> np.ndarray:
        """Return what a vector (n_dofs,) has at the elements' nodes, shape (n_e, n_a, d); n_e may be 0."""
        n, m = self.dofs.shape
        return vector[self.dofs].reshape(n, m // self._d, self._d)

    def matrices(self, gains: tuple[float, float, float], tangents: np.ndarray) -> np.ndarray:
        """Return the elements' parts of the iteration matrix, shape (n_e, m, m)."""
        gain_v, gain_a, gain_k = gains
        return (gain_a + gain_v * self._alpha) * self._mass + gain_k * tangents


def rank_solids(
    bodies: Sequence[Body], rows: range, values: Mapping[str, float], damping: BodyDampings
) -> Iterator[RankSolid]:
    """Yield the continuum elements of all bodies, material by material."""
    for number, body in enumerate(bodies):
        if body.meshed is not None:
            for region in body.meshed.solid.regions:
                yield RankSolid(body, number, region, rows, values, damping)
