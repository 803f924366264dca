"""The basis that is continuous over all samples, and the tables in it."""

from __future__ import annotations

from collections.abc import Sequence
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
    """

    tables: ReducedTables
    projection: np.ndarray
    groups: list[np.ndarray]
    combinations: np.ndarray
    flipped: np.ndarray
    curvature: np.ndarray | None = None

    @classmethod
    def of(
        cls,
        mechanism: Mechanism,
        samples: SampleGrid,
        loads: Sequence[Load],
        joined: JoinedSamples,
        compression: Compression,
    ) -> ContinuousBasis:
        """Express the samples' tables and vectors in the continuous basis."""
        n_kept, n_parameter = joined.n_kept, compression.matrix.shape[1]
        combinations = joined.rotations @ compression.beside(n_kept)
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
        return cls(tables, projection, groups, combinations, flipped)

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
    mechanism: Mechanism, nominal: dict[str, float], joined: JoinedSamples, n_parameter: int
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
    mass = np.einsum("t,ntij->nij", evaluate_weights(mechanism.mass_weights, nominal), joined.tables["mass"])
    turned = joined.rotations[:, joined.n_kept :, joined.n_kept :]
    own = mass[:, -n_snapshots:, -n_snapshots:]
    return Compression.of(np.swapaxes(turned, 1, 2) @ own @ turned, joined.flipped[:, joined.n_kept :], n_parameter)
