"""The basis that is continuous over all samples, and the tables in it.

Kept vectors are M-orthonormal at the nominal parameters, those compressed from snapshots of other parameter values are
not: their inertia ``G = E^T M E`` changes with theta. Where the kinetic energy of changing modes is kept, they are made
so by the symmetric root, ``E G^(-1/2)``: smooth where G is not singular (`compression.INDEPENDENT`), and of all
orthonormal bases of the span the nearest one (Lowdin 1950). The symmetric part of ``D^T M Psi`` then vanishes
(`mode_changes`), and the motion is the same in every smooth basis of the space. Where E is small, what it spans turns
quickly: such a basis needs more angles (`uneven`). Without that energy, as in eq. (7) of the paper, no basis of the
space is better than another, and E is taken as it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.effects import Load
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.reduction.compression import Compression
from pgmp_petsc.reduction.joining import JoinedSamples
from pgmp_petsc.reduction.sample_grid import SampleGrid
from pgmp_petsc.reduction.second_order import SecondOrderTables, pair_rotations
from pgmp_petsc.reduction.tables import ReducedTables, flipping_signs


@dataclass(frozen=True, eq=False)
class ContinuousBasis:
    """Tables and vectors over all samples; over two turns of a rigid coordinate where a vector changes sign after one.

    Attributes
    ----------
    tables
        In the continuous basis.
    projection
        The basis, shape (n, n_dofs, n_delta).
    groups
        Numbers of the vectors that turn among themselves.
    combinations
        The basis in terms of each sample's own vectors, one turn, shape (n_sampled, n_vectors, n_delta).
    flipped
        Whether a vector changes its sign after a turn of each rigid coordinate, shape (n_theta, n_delta).
    curvature
        Second derivatives of the displacement, pairs packed, shape (n, n_dofs, n_pairs); None where not wanted.
    uneven
        Factor by which the size of a vector that was made orthonormal changes from one angle to the next, the largest.
    """

    tables: ReducedTables
    projection: np.ndarray
    groups: list[np.ndarray]
    combinations: np.ndarray
    flipped: np.ndarray
    curvature: np.ndarray | None = None
    uneven: float = 1.0

    @classmethod
    def of(
        cls,
        mechanism: Mechanism,
        samples: SampleGrid,
        loads: Sequence[Load],
        joined: JoinedSamples,
        compression: Compression,
        nominal: Mapping[str, float] | None,
    ) -> ContinuousBasis:
        """Express the samples' tables and vectors in the continuous basis, orthonormal at `nominal` parameters."""
        n_kept, n_parameter = joined.n_kept, compression.matrix.shape[1]
        combinations, uneven = joined.rotations @ compression.beside(n_kept), 1.0
        if n_parameter and nominal is not None:
            c = compression.matrix
            squares, directions = np.linalg.eigh(c.T @ _grams(mechanism, nominal, joined) @ c)
            sizes, turned = np.sqrt(squares)[:, None], np.swapaxes(directions, 1, 2)
            inverse = (directions / sizes) @ turned
            combinations[:, :, n_kept:] = combinations[:, :, n_kept:] @ inverse
            uneven = _unevenness((directions * sizes) @ turned, inverse, samples)
        tables = ReducedTables(
            samples=samples,
            mass_weights=mechanism.mass_weights,
            stiffness_weights=mechanism.stiffness_weights,
            load_weights=tuple(load.weight for load in loads),
            load_effects=tuple(load.effect for load in loads),
            **{name: joined.tables[name] for name in ("mass", "inertia", "stiffness", "load")},
        ).turned(combinations)
        projection = joined.shapes @ combinations
        flipped = np.hstack([joined.flipped[:, :n_kept], compression.flips])
        groups = [*joined.groups, *np.arange(n_kept, n_kept + n_parameter)[:, None]]
        for axis in np.flatnonzero(flipped.any(axis=1)):
            signs = flipping_signs(tables.n_modes, flipped[axis])
            projection = tables.samples.twice(axis, projection, projection * signs)
            tables = tables.over_two_turns(flipped[axis], axis)
        return cls(tables, projection, groups, combinations, flipped, uneven=uneven)

    def curved(self, samples: SampleGrid, curvature: np.ndarray, tables: SecondOrderTables) -> ContinuousBasis:
        """Add what is of second order at the samples of one turn of the rigid coordinates.

        Parameters
        ----------
        samples
            These, n_sampled of them.
        curvature
            chi, pairs packed, shape (n_sampled, n_dofs, n_pairs).
        tables
            At n_sampled samples.
        """
        for axis in np.flatnonzero(self.flipped.any(axis=1)):
            signs = flipping_signs(self.tables.n_modes, self.flipped[axis])
            tables = tables.over_two_turns(samples, axis, signs)
            curvature = samples.twice(axis, curvature, curvature @ pair_rotations(np.diag(signs)[None]))
            samples = samples.over_two_turns(axis)
        return replace(self, curvature=curvature, tables=replace(self.tables, second_order=tables))


def compression_of(
    mechanism: Mechanism, nominal: Mapping[str, float], joined: JoinedSamples, n_parameter: int
) -> Compression:
    """Return the compression of all samples' snapshots, at the nominal parameters.

    Raises
    ------
    InputError
        If the snapshots do not span so many vectors.
    """
    n_snapshots = joined.shapes.shape[2] - joined.n_kept
    if not n_parameter:
        return Compression(np.empty((n_snapshots, 0)), np.empty((len(joined.flipped), 0), dtype=bool))
    return Compression.of(_grams(mechanism, nominal, joined), joined.flipped[:, joined.n_kept :], n_parameter)


def _unevenness(roots: np.ndarray, inverse: np.ndarray, samples: SampleGrid) -> float:
    """Return the largest factor between roots (n, p, p) at neighbouring samples of a turn, and their inverses there."""
    largest = 1.0
    for axis in range(samples.n_coordinates):
        before = samples.before(axis)
        here = np.flatnonzero((before >= 0) & (before < np.arange(before.size)))
        factors = np.linalg.svd(inverse[here] @ roots[before[here]], compute_uv=False)
        largest = max(largest, float(factors.max(initial=1.0)), 1.0 / float(factors.min(initial=1.0)))
    return largest


def _grams(mechanism: Mechanism, nominal: Mapping[str, float], joined: JoinedSamples) -> np.ndarray:
    """Return the Gram matrices of the snapshots in the continuous basis, shape (n, n_snapshots, n_snapshots)."""
    turned = joined.rotations[:, joined.n_kept :, joined.n_kept :]
    own = joined.tables["mass"][..., -turned.shape[1] :, -turned.shape[1] :]
    mass = np.einsum("t,ntij->nij", evaluate_weights(mechanism.mass_weights, nominal), own)
    return np.swapaxes(turned, 1, 2) @ mass @ turned
