"""A continuum body condensed to the frames of its face groups and internal coordinates (a superelement).

The displacements of the mesh's nodes in the body's frame are ``u = T y``, with ``y`` the small displacements and
rotations of the frames, one after the other, and after them the internal coordinates. Frames and internal coordinates
span the free motion of the body, its interface's answers over the frequencies asked for, and its elastic modes
(`component_modes`); so whatever the frames are joined to, at any configuration, mass and stiffness are ``T^T M T`` and
``T^T K T``, constant and small.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.bodies.affine import Monomial

if TYPE_CHECKING:
    from pgmp_petsc.bodies.floating import FloatingBody
    from pgmp_petsc.bodies.large_deformation import LargeDeformation
    from pgmp_petsc.bodies.recovery import Recovery

MASSLESS = 1e-9  # over the largest translational mass of a term: round-off of none


@dataclass(frozen=True, eq=False)
class Component:
    """A condensed body.

    Attributes
    ----------
    frames
        Name and number (from 0) of every frame.
    centres
        Of the frames in the body's frame, shape (n_frames, d), m.
    mass, stiffness
        ``T^T M_i T`` and ``T^T K_i T`` by weight, shape (n, n).
    moments
        ``int rho u_i v_j dV`` of unit unknowns by weight, shape (d, d, n, n), i and u first; their trace is the mass.
        Empty of rigid bodies, and of those read back from a reduced model, whose tables hold it.
    fields
        What of y makes the linear displacement fields of the body, shape (n, d (d + 1)): first the translations, then
        ``x_j`` in direction i as number ``d (1 + i) + j``. They hold rigid motion and the directions of inertia forces.
    probes
        ``T^T M w`` for fixed fields w of the mesh, shape (n, n_probes): what tells modes apart whatever T is.
    n_mesh_dofs
        Number of unknowns of the mesh.
    error
        Estimated relative error of the interface's answers over the frequencies asked for.
    centre_of_mass
        Of a rigid body, whose unknowns are its displacement and rotation there, shape (d,), m; None of a flexible one.
    recovery
        T and the mesh, where stresses are asked for or where they are small; of a rigid body the rigid motions of its
        mesh. None where they are not known.
    large
        What is of second order in y; None where it is not known: of rigid bodies, of scaled cross-sections, and of
        bodies read back from a reduced model, whose tables hold it.
    foreshortening
        Second derivatives of the amplitudes of the elastic free modes, shape (n_modes, n_modes, n_modes), 1/m; None
        where the body does not follow it, and of bodies read back, whose floating frames hold it.
    floating
        The same body in a floating frame; None of rigid bodies.
    """

    frames: dict[str, int]
    centres: np.ndarray
    mass: dict[Monomial, np.ndarray]
    stiffness: dict[Monomial, np.ndarray]
    moments: dict[Monomial, np.ndarray] = field(compare=False)  # a model that is read back is the same without them
    fields: np.ndarray
    probes: np.ndarray
    n_mesh_dofs: int
    error: float
    centre_of_mass: np.ndarray | None = None
    recovery: Recovery | None = None
    large: LargeDeformation | None = None
    foreshortening: np.ndarray | None = field(default=None, compare=False)
    floating: FloatingBody | None = None

    def terms(self, kind: str) -> dict[Monomial, np.ndarray]:
        """Return the matrices (n, n) of ``"mass"``, ``"stiffness"`` or ``"stretching"`` by weight; none of the last
        where `large` is None."""
        if kind == "stretching":
            return {} if self.large is None else self.large.stretching
        return {"mass": self.mass, "stiffness": self.stiffness}[kind]

    @property
    def spreading(self) -> np.ndarray:
        """What of y makes the displacement ``u = x`` of every place x, shape (n,): the direction of centripetal
        forces."""
        d = self.centres.shape[1]
        return sum(self.fields[:, d * (1 + i) + i] for i in range(d))

    @property
    def rigid(self) -> bool:
        """Whether the body does not deform."""
        return self.centre_of_mass is not None

    @property
    def extent(self) -> float:
        """Length of the straight bar that has the body's largest radius of gyration along an axis of its frame, m."""
        d = self.centres.shape[1]
        if self.rigid:
            return max(float(np.sqrt(12.0 * np.max(np.diag(m)[d:]) / m[0, 0])) for m in self.mass.values())
        moved = self.fields[:, [0, *range(d, 2 * d)]]  # by one and by every coordinate, all in the first direction
        all_moments = [moved.T @ matrix @ moved for matrix in self.mass.values()]
        most, variances = max(moments[0, 0] for moments in all_moments), []
        for moments in all_moments:
            if moments[0, 0] < MASSLESS * most:
                continue  # what scaling a cross-section adds to moments of inertia alone
            variances.append(np.diag(moments)[1:] / moments[0, 0] - (moments[0, 1:] / moments[0, 0]) ** 2)
        return float(np.sqrt(12.0 * np.max(variances)))

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return len(self.fields)

    @property
    def n_frame_dofs(self) -> int:
        """Number of unknowns of all frames, or of a rigid body."""
        n_nodes = 1 if self.rigid else len(self.frames)
        return n_nodes * (3 if self.centres.shape[1] == 2 else 6)

    @property
    def n_internal(self) -> int:
        """Number of internal coordinates."""
        return self.n - self.n_frame_dofs
