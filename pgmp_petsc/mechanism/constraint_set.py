"""All constraints of a mechanism in its unknowns: residual, Jacobian and curvature on fixed patterns.

They are the statements of the joints but for those that elastic ones release, in space those that make directors a
rotation, the ties of frames to their faces, and the angles that prescribed coordinates hold. Trailing axes of q
(samples) are kept.

The null space N of the constraint Jacobian, ``C N = 0``, is sparse (docs/method.md, rigid motion and modes): of each
connected group of joints a QR factorisation with column pivoting, ``C_block P = Q [R11 R12]``, gives as many unknowns
as the block has rank, ``dependent = -R11^-1 R12 independent``. Every unknown that no joint touches is its own column.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.linalg import lapack
from scipy.sparse.csgraph import connected_components

from pgmp_petsc.mechanism.frame_ties import FrameTies
from pgmp_petsc.mechanism.joints import Attached, Attachment
from pgmp_petsc.mechanism.mechanism import Unknowns
from pgmp_petsc.mechanism.statement_rows import ROUND_OFF, Near, StatementRows, near_to

RANK_TOLERANCE = 1e-10  # of the largest pivot of a block; joint Jacobians have entries of order 1


@dataclass(frozen=True, eq=False)
class Elimination:
    """Unknowns of one block expressed by others: ``u[dependent] = weights @ u[by]``."""

    #: dependent, by: numbers of unknowns, shapes (rank,) and (k,)
    dependent: np.ndarray
    by: np.ndarray
    weights: np.ndarray  # shape (rank, k)


@dataclass(frozen=True, eq=False)
class NullSpace:
    """A basis of the null space in terms of independent unknowns."""

    n_dofs: int  # number of unknowns
    eliminations: tuple[Elimination, ...]  # one a block
    n_redundant: int  # number of constraints that followed from the others
    rows: np.ndarray  # as many constraints as the rank, from which the others follow, shape (rank,), increasing

    @cached_property
    def independent(self) -> np.ndarray:
        """The unknowns that stay, shape (n_independent,), increasing."""
        stays = np.ones(self.n_dofs, dtype=bool)
        for elimination in self.eliminations:
            stays[elimination.dependent] = False
        return np.flatnonzero(stays)

    @cached_property
    def _column(self) -> np.ndarray:
        column = np.full(self.n_dofs, -1)
        column[self.independent] = np.arange(self.independent.size)
        return column

    @cached_property
    def matrix(self) -> sp.csr_matrix:
        """N, shape (n_dofs, n_independent); row ``independent[j]`` is the j-th unit vector."""
        rows, columns, values = [self.independent], [self.independent], [np.ones(self.independent.size)]
        for part in self.eliminations:
            rows.append(np.repeat(part.dependent, part.by.size))
            columns.append(np.tile(part.by, part.dependent.size))
            values.append(part.weights.ravel())
        entries = np.concatenate(values), (np.concatenate(rows), self._column[np.concatenate(columns)])
        return sp.coo_matrix(entries, shape=(self.n_dofs, self.independent.size)).tocsr()

    @cached_property
    def touched(self) -> np.ndarray:
        """The unknowns that constraints touch, shape (n_touched,), increasing."""
        touches = np.zeros(self.n_dofs, dtype=bool)
        for elimination in self.eliminations:
            touches[elimination.dependent] = touches[elimination.by] = True
        return np.flatnonzero(touches)

    @cached_property
    def dependent(self) -> np.ndarray:
        """The unknowns that the others determine, block by block, shape (rank,)."""
        return np.concatenate([np.zeros(0, dtype=int), *(part.dependent for part in self.eliminations)])

    @cached_property
    def weights(self) -> np.ndarray:
        """Rows of N of `dependent`, dense, shape (rank, n_independent)."""
        found, first = np.zeros((self.dependent.size, self.independent.size)), 0
        for part in self.eliminations:
            found[first : first + part.dependent.size, self._column[part.by]] = part.weights
            first += part.dependent.size
        return found


class NullSpaces:
    """Null spaces of Jacobians on one nonzero pattern, a matrix (n_constraints, n_dofs) with no entry twice: which
    constraints share unknowns is found once."""

    def __init__(self, pattern: sp.csr_matrix) -> None:
        self._n_dofs = pattern.shape[1]
        # the pattern, not the values: orthogonal rows that share unknowns belong together. Constraints, and behind them
        # unknowns, are the nodes of a graph; unknowns that no constraint touches are groups of their own, behind others
        n, n_rows = sum(pattern.shape), pattern.shape[0]
        starts = np.append(pattern.indptr, np.full(pattern.shape[1], pattern.nnz))
        graph = sp.csr_matrix((np.ones(pattern.nnz), pattern.indices + n_rows, starts), (n, n))
        group_of = connected_components(graph, directed=False)[1][:n_rows]
        n_groups = int(group_of.max(initial=-1)) + 1
        row_of = np.repeat(np.arange(pattern.shape[0]), np.diff(pattern.indptr))
        # of every block: its constraints, its unknowns, its entries among those of the pattern, and their places in it
        self._blocks: list[tuple[np.ndarray, np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]] = []
        for group in range(n_groups):
            rows, entries = np.flatnonzero(group_of == group), np.flatnonzero(group_of[row_of] == group)
            touched, column = np.unique(pattern.indices[entries], return_inverse=True)
            self._blocks.append((rows, touched, entries, (np.searchsorted(rows, row_of[entries]), column)))

    def of(self, values: np.ndarray) -> NullSpace:
        """Return the null space for values (n_entries,) on the pattern."""
        n_redundant, eliminations, chosen = 0, [], [np.zeros(0, dtype=int)]
        for rows, touched, entries, places in self._blocks:
            matrix = np.zeros((rows.size, touched.size), order="F")
            matrix[places] = values[entries]
            r, order, rank = _pivoted(matrix)
            n_redundant += rows.size - rank
            if rank == 0:
                continue
            chosen.append(rows if rank == rows.size else rows[_pivoted(matrix.T)[1][:rank]])
            weights = -lapack.dtrtrs(r[:rank, :rank], r[:rank, rank:])[0]
            eliminations.append(Elimination(touched[order[:rank]], touched[order[rank:]], weights))
        return NullSpace(self._n_dofs, tuple(eliminations), n_redundant, np.sort(np.concatenate(chosen)))


def null_space(constraints: sp.csr_matrix) -> NullSpace:
    """Return the null space of a constraint Jacobian of shape (n_constraints, n_dofs)."""
    constraints = constraints.tocsr()
    constraints.sum_duplicates()
    return NullSpaces(constraints).of(constraints.data)


def _pivoted(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Return R in its upper triangle (what is below it is not zero), the order of columns, and the rank.

    LAPACK itself: what SciPy checks and allocates takes ten times as long as a joint's few rows.
    """
    if not matrix.shape[1]:
        return matrix, np.zeros(0, dtype=int), 0
    r, order, *_ = lapack.dgeqp3(matrix)
    pivots = np.abs(np.diagonal(r))
    return r, order - 1, int(np.count_nonzero(pivots > RANK_TOLERANCE * max(pivots[0], 1e-300)))


@dataclass(frozen=True, eq=False)
class ChosenRows:
    """Some constraints that are statements."""

    rows: StatementRows  # the statements, and combinations of them, of n terms
    #: places of the terms among the chosen constraints, shape (n,)
    places: np.ndarray
    wanted: np.ndarray  # the constraints' values, at the first of their terms, zero at others, shape (n,), m or 1
    motions: np.ndarray  # number of the prescribed motion that gives the value instead, or -1, shape (n,)
    of_directors: np.ndarray  # which of them make directors a rotation, shape (n,)
    near: Near  # of the coordinates


class ConstraintSet:
    """Constraints ``c(q) = 0`` in the numbering of `unknowns`.

    Of all constraints those with the numbers `kept` are taken, increasing; all by default. Those that follow from the
    others, such as a joint that is there twice, make the equations of motion singular. Driven angles are always taken,
    `n_driven` at the end of the `n_constraints`.

    `jacobian_pattern` has rows (constraints) and columns (unknowns) of the entries of C, each (n_entries,);
    `curvature_pattern` those of ``sum lambda d2c/dq2``, one of each symmetric pair, each (n_curved,). `linear` says
    whether all are linear in q.
    """

    def __init__(self, unknowns: Unknowns, kept: np.ndarray | None = None) -> None:
        mechanism, d = unknowns.mechanism, unknowns.dimension
        self._unknowns, self.n_dofs = unknowns, unknowns.n_dofs
        frames = [Attachment(0, node, np.zeros(d), np.zeros(d)) for node in range(mechanism.n_nodes)]
        parts, self._wanted = mechanism.holding(frames, moving=True)
        driven = [(c.statement, c.sides) for c in mechanism.coordinates if c.prescribed]
        self._joints, self._drives = (StatementRows(rows, unknowns.frame, d) for rows in (parts, driven))
        self._statements = [*parts, *driven]
        self._n_directors = len(parts) - mechanism.n_held
        self._ties = FrameTies.of(unknowns)
        self._parts = (self._joints, self._ties, self._drives)
        self._first = np.cumsum([0, *(part.n for part in self._parts)])
        self.n_driven, n_own = self._drives.n, int(self._first[2])
        kept = np.arange(n_own) if kept is None else kept
        self._kept = np.concatenate([kept, n_own + np.arange(self.n_driven)])
        self.n_constraints = self._kept.size
        rows = np.concatenate([first + part.jacobian_pattern[0] for first, part in zip(self._first, self._parts)])
        columns = np.concatenate([part.jacobian_pattern[1] for part in self._parts])
        place = np.full(self._first[-1], -1)
        place[self._kept] = np.arange(self._kept.size)
        self._kept_entries = np.flatnonzero(place[rows] >= 0)
        self.jacobian_pattern = place[rows[self._kept_entries]], columns[self._kept_entries]
        self.curvature_pattern = tuple(
            np.concatenate([part.curvature_pattern[k] for part in self._parts]) for k in range(2)
        )
        self.linear = not self.curvature_pattern[0].size

    def residual(self, q: np.ndarray, driven: np.ndarray | None = None) -> np.ndarray:
        """Return c, shape (n_constraints, ...), m, 1 or rad, for unknowns (n_dofs, ...) and the angles that the driven
        joints are to have, shape (n_driven,), rad; none needed where nothing is driven."""
        joints = self._joints.values(q) - _against(self._wanted, q)
        angles = np.zeros((0, *q.shape[1:]))
        if self.n_driven:
            held = _against(driven, q)
            angles = self._drives.values(q, held) - held
        return np.concatenate([joints, self._ties.values(q), angles])[self._kept]

    def jacobian_values(self, q: np.ndarray) -> np.ndarray:
        """Return the entries of C on `jacobian_pattern`, shape (n_entries, ...)."""
        return np.concatenate([part.jacobian_values(q) for part in self._parts])[self._kept_entries]

    def rates(self, q: np.ndarray, v: np.ndarray, driven: np.ndarray | None = None) -> np.ndarray:
        """Return ``dc/dt = C v``, shape (n_constraints, ...); `driven` are the angular velocities of the driven joints,
        shape (n_driven,), rad/s."""
        (rows, columns), found = self.jacobian_pattern, np.zeros((self.n_constraints, *q.shape[1:]))
        np.add.at(found, rows, self.jacobian_values(q) * v[columns])
        if self.n_driven:
            found[-self.n_driven :] -= _against(driven, q)
        return found

    def drift(self, q: np.ndarray, v: np.ndarray, driven: np.ndarray | None = None) -> np.ndarray:
        """Return ``(dC/dt) v``, shape (n_constraints, ...): what is left of c'' at zero acceleration.

        `driven` are the angular accelerations of the driven joints, shape (n_driven,) or (n_driven, ...), rad/s2.
        """
        parts = [part.drift(q, v) for part in self._parts]
        if self.n_driven:
            parts[-1] = parts[-1] - _against(driven, q)
        return np.concatenate(parts)[self._kept]

    def rows_among(self, chosen: np.ndarray) -> ChosenRows:
        """Return the joints' and the driven statements among constraints with given numbers, increasing, shape (n,)."""
        own, parts, wanted, motions = self.statements_among(chosen)
        if own.size == self._joints.n and (motions < 0).all():
            rows = self._joints
        elif own.size == self.n_driven and (motions >= 0).all():
            rows = self._drives
        else:
            rows = StatementRows(parts, self._unknowns.frame, self._unknowns.dimension)
        of, first = rows.row_of, np.diff(rows.row_of, prepend=-1) > 0
        near = near_to(parts, {c.statement: k for k, c in enumerate(self._unknowns.mechanism.coordinates)})
        return ChosenRows(
            rows, own[of], np.where(first, wanted[of], 0.0), motions[of], self.of_directors[chosen][own][of], near
        )

    def statements_among(self, chosen: np.ndarray) -> tuple[np.ndarray, list[Attached], np.ndarray, np.ndarray]:
        """Return which of constraints with given numbers are statements, (n,), these with their sides, and their values
        and motions as of `ChosenRows`, each (n,)."""
        original = self._kept[chosen]
        n_joints, first_driven = self._joints.n, int(self._first[2])
        own = np.flatnonzero((original < n_joints) | (original >= first_driven))
        of_motion = original[own] >= n_joints
        motions = np.where(of_motion, original[own] - first_driven, -1)
        wanted = np.array([0.0 if moves else self._wanted[k] for k, moves in zip(original[own], of_motion)])
        parts = [self._statements[k if k < n_joints else n_joints + k - first_driven] for k in original[own]]
        return own, parts, wanted, motions

    def lengths_among(self, chosen: np.ndarray) -> np.ndarray:
        """Return which of constraints with given numbers, of no ties, are measured in m."""
        return np.array([part.is_length for part, _ in self.statements_among(chosen)[1]], dtype=bool)

    def ties_among(self, chosen: np.ndarray) -> tuple[np.ndarray, FrameTies]:
        """Return the place of every tie among chosen constraints, -1 where it is not, shape (n_ties,), and the ties."""
        place = np.full(self._first[-1], -1)
        place[self._kept[chosen]] = np.arange(chosen.size)
        return place[self._first[1] : self._first[2]], self._ties

    @property
    def of_directors(self) -> np.ndarray:
        """Which constraints make directors a rotation, shape (n_constraints,)."""
        return (self._kept >= self._joints.n - self._n_directors) & (self._kept < self._joints.n)

    @property
    def of_ties(self) -> np.ndarray:
        """Which constraints tie frames to faces, shape (n_constraints,)."""
        return (self._kept >= self._first[1]) & (self._kept < self._first[2])

    def independent(self, q: np.ndarray) -> ConstraintSet:
        """Return the constraints without those that follow from the others, as found at unknowns (n_dofs,)."""
        kept = null_space(self._jacobian_at(q)).rows
        return self if kept.size == self.n_constraints - self.n_driven else ConstraintSet(self._unknowns, kept)

    def undetermined(self, q: np.ndarray) -> np.ndarray:
        """Return multipliers of all constraints that do nothing at unknowns (n_dofs,): an orthonormal basis Z of
        ``C^T Z = 0``, shape (n_constraints, n_redundant), without driven angles."""
        jacobian = self._jacobian_at(q)
        n_redundant = null_space(jacobian).n_redundant
        if not n_redundant:
            return np.zeros((jacobian.shape[0], 0))
        return np.linalg.eigh((jacobian @ jacobian.T).toarray())[1][:, :n_redundant]

    def of_joints(self, multipliers: np.ndarray) -> np.ndarray:
        """Return the multipliers of what joints hold, zero where it follows from others, and those of the driven
        angles behind them, shape (n_held + n_driven, ...), of those of the constraints (n_constraints, ...)."""
        every = np.zeros((self._first[-1], *multipliers.shape[1:]))
        every[self._kept] = multipliers
        return np.concatenate([every[: self._unknowns.mechanism.n_held], every[self._first[2] :]])

    def _jacobian_at(self, q: np.ndarray) -> sp.csr_matrix:
        """Return C without driven angles at unknowns (n_dofs,), of a set that takes all constraints."""
        n_own = int(self._first[2])
        rows, columns = self.jacobian_pattern
        values = self.jacobian_values(q[:, None])[:, 0]
        own = (rows < n_own) & (np.abs(values) > ROUND_OFF)  # what no constraint feels must not become dependent
        return sp.csr_matrix((values[own], (rows[own], columns[own])), shape=(n_own, self._unknowns.n_dofs))


def _against(values: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Shape values (n,) or (n, ...) so that they broadcast against rows (n, ...) of unknowns."""
    return np.reshape(values, (*values.shape, *(1,) * (q.ndim - values.ndim)))
