"""Masses of frames in space, in natural coordinates: rigid bodies, and point masses on flexible ones.

With the moments ``J = int rho X X^T dV`` about a frame's position, the kinetic energy of what moves with it is
``1/2 m p'.p' + 1/2 sum J_kl d_k'.d_l'``: the mass matrix is constant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.dynamics.body_damping import BodyDampings
from pgmp_petsc.dynamics.rank_solids import SolidState
from pgmp_petsc.mechanism.unknowns import N_POSE, Unknowns


class SpatialMasses:
    """The masses of frames that touch one rank's unknowns; the interface is that of `RankSolid`, for frames of one
    body.

    Parameters
    ----------
    dofs
        Unknowns of the frames, shape (n_e, 12).
    mass
        Shape (n_e, 12, 12), kg and kg m2.
    body
        Number of the body.
    rows
        The unknowns that this rank owns.
    braking
        Damping by mass, 1/s.
    """

    def __init__(self, dofs: np.ndarray, mass: np.ndarray, body: int, rows: range, braking: float) -> None:
        here = ((dofs >= rows.start) & (dofs < rows.stop)).any(axis=1)
        self.dofs, self.mass, self.body, self._braking = dofs[here], mass[here], body, braking
        self.owned = (self.dofs[:, 0] >= rows.start) & (self.dofs[:, 0] < rows.stop)

    @property
    def damped(self) -> bool:
        """Whether any velocity is needed."""
        return self._braking != 0.0

    def evaluate(self, q: np.ndarray, v: np.ndarray, gain_v: float, fresh: bool = True) -> SolidState:
        """Return the damping forces for unknowns and velocities (n_dofs,); masses have no others."""
        n, m = self.dofs.shape
        local = v[self.dofs]
        forces = self._braking * np.einsum("eij,ej->ei", self.mass, local)
        return SolidState(forces, np.zeros((n, m, m)), -np.sum(forces * local, axis=1))

    def strain_energy(self, q: np.ndarray) -> float:
        """Return 0."""
        return 0.0

    def matrices(self, gains: tuple[float, float, float], tangents: np.ndarray) -> np.ndarray:
        """Return the parts of the iteration matrix, shape (n_e, 12, 12)."""
        gain_v, gain_a, _ = gains
        return (gain_a + gain_v * self._braking) * self.mass


def spatial_masses(
    unknowns: Unknowns, rows: range, values: Mapping[str, float], damping: BodyDampings
) -> Sequence[SpatialMasses]:
    """Return the masses of all frames, body by body."""
    found = []
    for number, body in enumerate(unknowns.bodies):
        nodes, masses = _of_body(body, values)
        if nodes:
            dofs = np.array([unknowns.frame(body.first_node + node) for node in nodes])
            found.append(SpatialMasses(dofs, np.array(masses), number, rows, damping.rayleigh_of(number)[1]))
    return found


def _of_body(body: Body, values: Mapping[str, float]) -> tuple[list[int], list[np.ndarray]]:
    """Return nodes of a body with masses of their own, and their mass matrices (12, 12)."""
    nodes, masses = [], []
    for node, lumps in body.lumps.items():
        weights = [(float(weight.evaluate(values)), lump) for weight, lump in lumps.items()]
        inertia = sum(weight * lump.inertia for weight, lump in weights)
        nodes.append(node)
        masses.append(_natural(sum(weight * lump.mass for weight, lump in weights), inertia * np.eye(3)))
    if body.component is not None and body.component.rigid:
        matrix = sum(float(weight.evaluate(values)) * mass for weight, mass in body.component.mass.items())
        nodes.append(0)
        masses.append(_natural(float(np.trace(matrix[:3, :3])) / 3.0, matrix[3:, 3:]))
    return nodes, masses


def _natural(mass: float, inertia: np.ndarray) -> np.ndarray:
    """Return the mass matrix of a frame with a mass (kg) and a tensor of inertia (3, 3), kg m2, about its position."""
    moments = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    matrix = np.zeros((N_POSE, N_POSE))
    matrix[:3, :3] = mass * np.eye(3)
    matrix[3:, 3:] = np.kron(moments, np.eye(3))
    return matrix
