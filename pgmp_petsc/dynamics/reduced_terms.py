"""The terms of the reduced equations of motion as interpolants, shared by all samples of an ensemble.

What belongs to the rigid motion alone, ``(d rho/d theta)^T M_i (d rho/d theta)``, follows from the exact rigid
kinematics without an eigenproblem, on a grid as fine as wanted; only what involves flexible modes is interpolated
between the samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.matrices import assemble
from pgmp_petsc.dynamics.cells import Grid
from pgmp_petsc.dynamics.reduced_kernel import Layout, Tables
from pgmp_petsc.mechanism.body_frames import rigid_velocities
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.reduction.interpolation import Interpolant, interpolant
from pgmp_petsc.reduction.samples import Samples
from pgmp_petsc.reduction.tables import ReducedTables

N_RIGID = 1024  # cubic spline: an error of (2 pi / 1024)^4 / 384 = 4e-12 of the fourth derivative


@dataclass(frozen=True, eq=False)
class ReducedTerms:
    """Interpolated terms of a reduced model with one rigid coordinate.

    Attributes
    ----------
    tables
        The tables they were made from.
    weights
        Monomials of the terms of mass and stiffness together.
    rigid
        Rigid inertia of every term, rows of shape (n_terms, 1).
    terms
        Packed mass, ``b_i = (d rho/d theta)^T M_i (d Psi/d theta)`` and packed stiffness of every term side by side,
        and what there is of second order, rows of shape (n_terms, n_entries); zero where a term has no mass or no
        stiffness. The first entry, the rigid inertia, is not used.
    layout
        Where these parts begin.
    load
        Load terms, rows of shape (n_load_terms, layout.load_end).
    scale
        Displacement (in units of the mechanism's size or 1 rad) per unit of each coordinate, shape (n_eta,).
    """

    tables: ReducedTables
    weights: tuple[Monomial, ...]
    rigid: Interpolant
    terms: Interpolant
    layout: Layout
    load: Interpolant
    scale: np.ndarray

    @classmethod
    def of(
        cls, tables: ReducedTables, kinematics: RigidKinematics, projection: np.ndarray, scheme: str
    ) -> ReducedTerms:
        """Prepare the terms.

        Parameters
        ----------
        projection
            Flexible vectors, shape (n, n_dofs, n_delta); gives the scale of the flexible coordinates.
        scheme
            Interpolation over the samples.
        """
        samples = tables.samples
        weights = tuple(sorted({*tables.mass_weights, *tables.stiffness_weights}))
        parts = [
            _spread(pack(tables.mass), tables.mass_weights, weights),
            _spread(coupling_of(tables, scheme), tables.mass_weights, weights),
            _spread(pack(tables.stiffness), tables.stiffness_weights, weights),
        ]
        load = tables.load
        if tables.second_order is not None:
            bent, changes = tables.second_order, tables.changes
            parts.append(_spread(pack_cubic(bent.cubic), tables.stiffness_weights, weights))
            parts.append(_spread(pack(bent.curved_inertia - changes.spread), tables.mass_weights, weights))
            parts.append(_spread(pack_skew(changes.gyroscopic), tables.mass_weights, weights))
            load = np.concatenate([load, pack(bent.curved_load)], axis=2)
        ends = [int(end) for end in np.cumsum([part.shape[2] for part in parts])]
        # without terms of second order these parts are empty and stand at the end
        swing, gyroscopic, end = ends[3:] or [ends[2]] * 3
        n_eta = tables.n_coordinates + tables.n_modes
        return cls(
            tables=tables,
            weights=weights,
            rigid=rigid_inertia(tables, weights, kinematics),
            terms=interpolant(samples, np.concatenate(parts, axis=2), scheme),
            layout=Layout(n_eta, *ends[:3], swing, gyroscopic, end, load.shape[2]),
            load=interpolant(samples, load, scheme),
            scale=np.concatenate([np.ones(tables.n_coordinates), displacement_scale(projection, kinematics.size)]),
        )

    @property
    def grids(self) -> tuple[Grid, Grid]:
        """Cells of the rigid inertia, and of all other terms."""
        axes = (self.rigid.axes[0], self.terms.axes[0])
        return tuple(Grid(axis.lower, axis.step, axis.n_cells, axis.periodic) for axis in axes)

    @cached_property
    def polynomials(self) -> Tables:
        """All terms as the kernel takes them."""
        parts = (self.rigid, self.terms, self.load)
        return Tables(*(np.ascontiguousarray(np.swapaxes(part.polynomials(), 1, 2)) for part in parts))


def rigid_inertia(
    tables: ReducedTables, weights: tuple[Monomial, ...], kinematics: RigidKinematics
) -> Interpolant:
    """Return ``(d rho/d theta)^T M_i (d rho/d theta)`` of every term, from the kinematics alone."""
    at = tables.samples
    fine = Samples.uniform(at.lower, at.upper, N_RIGID, at.periodic)
    mechanism = kinematics.mechanism
    terms = assemble(mechanism.bodies, range(mechanism.n_dofs)).mass
    poses = kinematics.poses(fine.theta)
    rates = kinematics.rates(poses)
    velocities = np.array(
        [rigid_velocities(mechanism, poses[..., k], rates[..., k])[:, 0] for k in range(fine.n)]
    ).T
    values = np.array([np.sum(velocities * (terms[w] @ velocities), axis=0) for w in tables.mass_weights])
    spread = _spread(np.ascontiguousarray(values.T[:, :, None]), tables.mass_weights, weights)
    return interpolant(fine, spread, "spline")


def coupling_of(tables: ReducedTables, scheme: str) -> np.ndarray:
    """Return b_i at the samples, shape (n, n_mass_terms, n_delta).

    By the product rule it is the derivative of the mass table's coupling block, taken from the interpolant, less the
    inertia table.
    """
    block = interpolant(tables.samples, tables.mass[:, :, 0, 1:], scheme)
    return block.slope(tables.samples.theta) - tables.inertia[:, :, 0, 0]


def _spread(table: np.ndarray, own: tuple[Monomial, ...], weights: tuple[Monomial, ...]) -> np.ndarray:
    """Put the terms (axis 1) of a table where their weights stand among all weights, zeros elsewhere."""
    result = np.zeros((len(table), len(weights), table.shape[2]))
    result[:, [weights.index(weight) for weight in own]] = table
    return result


def pack(matrices: np.ndarray) -> np.ndarray:
    """Pack symmetric matrices (..., n, n) as lower triangles row by row."""
    rows, columns = np.tril_indices(matrices.shape[-1])
    return np.ascontiguousarray(matrices[..., rows, columns])


def pack_skew(matrices: np.ndarray) -> np.ndarray:
    """Pack skew matrices (..., n, n) as strict lower triangles row by row."""
    rows, columns = np.tril_indices(matrices.shape[-1], -1)
    return np.ascontiguousarray(matrices[..., rows, columns])


def pack_cubic(tensors: np.ndarray) -> np.ndarray:
    """Pack symmetric tensors (..., n, n, n) over ``i >= j >= k``, k fastest."""
    i, j, k = np.indices(tensors.shape[-3:]).reshape(3, -1)
    chosen = (i >= j) & (j >= k)
    return np.ascontiguousarray(tensors[..., i[chosen], j[chosen], k[chosen]])


def displacement_scale(projection: np.ndarray, size: float) -> np.ndarray:
    """Return the largest displacement per unit of each flexible coordinate.

    Parameters
    ----------
    projection
        Flexible vectors, shape (n, n_dofs, n_delta).
    size
        Length that translations are measured in, m.

    Returns
    -------
    ndarray, shape (n_delta,)
    """
    units = np.tile([1.0 / size, 1.0 / size, 1.0], projection.shape[1] // 3)
    return np.max(np.abs(projection) * units[:, None], axis=(0, 1))
