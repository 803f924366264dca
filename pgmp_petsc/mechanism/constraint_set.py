"""All constraints of a mechanism in its unknowns: residual, Jacobian and curvature on fixed patterns.

They are the statements of the joints but for those that elastic ones release, in space those that make directors a
rotation, the ties of frames to their faces, and the angles that prescribed coordinates hold. Trailing axes of q
(samples) are kept.

The null space N of the constraint Jacobian, ``C N = 0``, is sparse (docs/method.md, rigid motion and modes): of each
connected group of joints a QR factorisation with column pivoting, ``C_block P = Q [R11 R12]``, gives as many unknowns
as the block has rank, ``dependent = -R11^-1 R12 independent``. Every unknown that no joint touches is its own column.

Ties are between a body and the frames that hold it: faces of its mesh, or a floating frame and its deformation. The
frame of a group of faces has their mean position and mean rotation, see `bodies.solid`.

With a frame (p, d_1 .. d_d), the nodes' positions x_i, their weights w_i and arms a_i,

    p - sum_i w_i x_i = 0,    1/h sum_k (sum_i a_ik x_i) x d_k = 0,    h = int X'.X' dA / A,

the second of which is the frame's rotation less the faces' mean rotation to first order, and holds for any rotation.

With a floating frame (p, d_1 .. d_d) and the displacement A xi and the small rotation Theta xi of a frame (P, D_1 ..
D_d) at X in it (`bodies.floating`),

    P - p - sum_k d_k (X + A xi + 1/2 xi^T a xi)_k = 0,    1/2 (D_k.d_l - D_l.d_k) - (Theta xi)_m = 0,

with k, l, m in cyclic order, in the plane ``Phi - phi - Theta xi = 0``; a is zero but for bodies that follow their
foreshortening (`components.component_modes`).

Every row is a sum of terms ``f d x y``, of a component d of a director and two unknowns x and y, each of which may be
1; in the plane ``(x, y, phi)`` give the directors, with ``d d_k / d phi = J d_k``, J a right angle's rotation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.linalg import lapack
from scipy.sparse.csgraph import connected_components

from pgmp_petsc.bodies.component import TURNS
from pgmp_petsc.bodies.solid import FaceFrame
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import select, sine_cosine
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
        found = self._by_row(self.jacobian_values(q) * v[self.jacobian_pattern[1]])
        if self.n_driven:
            found[-self.n_driven :] -= _against(driven, q)
        return found

    def strayed(self, q: np.ndarray, v: np.ndarray, units: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the largest velocity across what is held, of those that are not driven, and the fastest of all, in
        `units` (n_unknowns,) in which unknowns are comparable; for velocities (n_unknowns, n), each of shape (n,)."""
        columns, values = self.jacobian_pattern[1], self.jacobian_values(q)
        rates, weights = self._by_row(values * v[columns]), self._by_row(np.abs(values) / units[columns, None])
        held = slice(self.n_constraints - self.n_driven)
        across = np.max(np.abs(rates[held]) / np.maximum(weights[held], np.finfo(float).tiny), axis=0, initial=0.0)
        return across, np.abs(units[:, None] * v).max(axis=0)

    def _by_row(self, entries: np.ndarray) -> np.ndarray:
        """Add up what stands at the entries of the Jacobian, (n_entries, ...), row by row: (n_constraints, ...)."""
        found = np.zeros((self.n_constraints, *entries.shape[1:]))
        np.add.at(found, self.jacobian_pattern[0], entries)
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


PHI = 2  # a frame's rotation in the plane
Derivative = tuple[np.ndarray, np.ndarray, np.ndarray]


class Terms(NamedTuple):
    """Terms ``f d x y`` of rows, each array of shape (n,)."""

    rows: np.ndarray
    turning: np.ndarray  # the unknown of its frame that d depends on, -1 where d is 1
    directors: np.ndarray  # number of d among the components of its frame's directors
    #: first, second: the unknowns x and y, the same or not, -1 where one is 1
    first: np.ndarray
    second: np.ndarray
    factors: np.ndarray  # f

    @classmethod
    def of(
        cls, d: int, rows: np.ndarray, factors: np.ndarray, first: np.ndarray | int = -1,
        second: np.ndarray | int = -1, frame: int = -1, directors: np.ndarray | int = 0,
    ) -> Terms:  # fmt: skip
        """Return terms in d dimensions; `frame` is the first unknown of that whose director they have."""
        turning = -1 if frame < 0 else frame + (PHI if d == 2 else d + directors)
        numbers = (np.broadcast_to(part, rows.shape) for part in (rows, turning, directors, first, second))
        return cls(*(part.astype(np.int64) for part in numbers), np.broadcast_to(factors, rows.shape).astype(float))

    @classmethod
    def joined(cls, parts: list[Terms]) -> Terms:
        """Return all terms of some parts."""
        empty = cls(*(np.zeros(0, dtype=np.int64),) * 5, np.zeros(0))
        return cls(*(np.concatenate(column) for column in zip(empty, *parts)))

    def derivatives(self, d: int) -> tuple[list[Derivative], list[Derivative]]:
        """Return which terms have first derivatives in x, y and the director's unknown, with rows and unknowns, and
        which have second ones in x and y, in that unknown and x or y, and in the plane in it twice, with both."""
        rows, turning, _, x, y, _ = self
        has_x, has_y, turns = (part >= 0 for part in (x, y, turning))
        twice = turns & (d == 2)
        first = [(has_x, rows, x), (has_y, rows, y), (turns, rows, turning)]
        second = [(has_x & has_y, x, y), (turns & has_x, turning, x), (turns & has_y, turning, y)]
        return first, [*second, (twice, turning, turning)]


class FrameTies:
    """Rows of terms in d dimensions, n rows of n_dofs unknowns; the interface is that of `StatementRows`."""

    def __init__(self, terms: Terms, d: int, n: int, n_dofs: int) -> None:
        self.terms, self.d, self.n = terms, d, n
        first, second = terms.derivatives(d)
        second = [(has, np.maximum(one, other), np.minimum(one, other)) for has, one, other in second]
        self.jacobian_pattern, self._of_first = _numbered(first, n_dofs)
        self.curvature_pattern = _numbered(second, n_dofs)[0]

    @classmethod
    def of(cls, unknowns: Unknowns) -> FrameTies:
        """Return the ties of all frames that hold bodies on meshes and in floating frames."""
        parts, n, d = [], 0, unknowns.dimension
        for body in unknowns.bodies:
            for number, faces in enumerate(body.face_frames.values()):
                frame = unknowns.frame(body.first_node + number)
                positions = body.first_internal + d * faces.nodes[:, None] + np.arange(d)  # of the faces' nodes
                parts += [_means(n, frame, positions, faces), *_rotations(n + d, int(frame[0]), positions, faces)]
                n += d + len(TURNS[d])
        for body, floating in ((body, one) for body in unknowns.bodies for one in body.blocks("floating")):
            last = unknowns.frame(body.first_node + body.n_nodes - 1)
            amplitudes = body.first_internal + np.arange(floating.n)
            for number, of_frame in enumerate(zip(floating.centres, floating.shapes, floating.bent)):
                parts += _holding(n, unknowns.frame(body.first_node + number), last, amplitudes, *of_frame)
                n += d + len(TURNS[d])
        return cls(Terms.joined(parts), d, n, unknowns.n_dofs)

    def values(self, q: np.ndarray) -> np.ndarray:
        """Return what is to be zero, shape (n, ...), m and rad, for unknowns (n_dofs, ...)."""
        return self._filled(_values, self.n, [], q)

    def jacobian_values(self, q: np.ndarray) -> np.ndarray:
        """Return the first derivatives on `jacobian_pattern`, shape (n_entries, ...)."""
        return self._filled(_jacobian, self.jacobian_pattern[0].size, self._of_first, q)

    def drift(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return what the velocities do to the rates of the ties, shape (n, ...)."""
        return self._filled(_drift, self.n, [], q, v)

    def _filled(self, fill, size: int, places: list[np.ndarray], *arrays: np.ndarray) -> np.ndarray:
        trailing = arrays[0].shape[1:]
        n = math.prod(trailing)
        flat = [np.ascontiguousarray(array.reshape(len(array), n)) for array in arrays]
        result = np.zeros((size, n))
        fill(self.d, self.terms, *places, *flat, result)
        return result.reshape(size, *trailing)


def _numbered(entries: list[Derivative], n_dofs: int) -> tuple[tuple[np.ndarray, np.ndarray], list[np.ndarray]]:
    """Return the pairs of all derivatives, each once, and where each term has its own among them."""
    keys = [one[has] * n_dofs + other[has] for has, one, other in entries]
    unique, at = np.unique(np.concatenate(keys), return_inverse=True)
    places = [np.full(has.size, -1) for has, _, _ in entries]
    for place, (has, _, _), own in zip(places, entries, np.split(at, np.cumsum([key.size for key in keys])[:-1])):
        place[has] = own
    return np.divmod(unique, n_dofs), places


def _holding(
    first_row: int, frame: np.ndarray, floating: np.ndarray, amplitudes: np.ndarray, centre: np.ndarray,
    shape: np.ndarray, bent: np.ndarray,
) -> list[Terms]:  # fmt: skip
    """Return the terms of a frame that holds a body in a floating frame, rows from a first one on, of the unknowns of
    both, shape (m,), and xi, (n,); X, shape (d,), m; A and Theta, shape (3, n), in space (6, n); and a, (d, n, n)."""
    d, n, axes = centre.size, amplitudes.size, np.arange(centre.size)
    rotation, turned = shape[d:], first_row + d + np.arange(len(shape) - d)
    component, k = (part.ravel() for part in np.meshgrid(axes, axes, indexing="ij"))
    rows, directors = first_row + component, d * k + component  # sum_k d_k (...)_k
    of_floating = {"frame": int(floating[0])}
    found = [
        Terms.of(d, first_row + axes, 1.0, frame[:d]),
        Terms.of(d, first_row + axes, -1.0, floating[:d]),
        Terms.of(d, np.repeat(turned, n), -rotation.ravel(), np.tile(amplitudes, len(rotation))),
        Terms.of(
            d, np.repeat(rows, n), -shape[k].ravel(), np.tile(amplitudes, rows.size),
            directors=np.repeat(directors, n), **of_floating,
        ),
        Terms.of(d, rows, -centre[k], directors=directors, **of_floating),
        bent_terms(d, first_row, int(floating[0]), amplitudes, bent),
    ]  # fmt: skip
    if d == 2:
        return [*found, Terms.of(d, np.repeat(turned, 2), [1.0, -1.0], np.array([frame[2], floating[2]]))]
    for m, row in enumerate(turned):
        for factor, mine, its in ((0.5, m - 2, m - 1), (-0.5, m - 1, m - 2)):
            mine, its = d * (mine % d) + axes, floating[d + d * (its % d) + axes]
            found.append(Terms.of(d, np.full(d, row), factor, its, frame=int(frame[0]), directors=mine))
    return found


def bent_terms(d: int, first_row: int, frame: int, amplitudes: np.ndarray, bent: np.ndarray) -> Terms:
    """Return ``- 1/2 sum_k d_k xi^T a_k xi``, what ties have of second order in the deformation.

    Rows begin with that of the tie's first component; `frame` is the first unknown of the floating frame, the
    amplitudes are the unknowns xi, shape (n,), and `bent` is ``a``, shape (d, n, n), 1/m.
    """
    i, j = np.tril_indices(amplitudes.size)
    of_pairs = np.where(i == j, 0.5, 1.0) * bent[:, i, j]
    k, pair = np.nonzero(of_pairs)
    component = np.repeat(np.arange(d), k.size)
    k, pair = np.tile(k, d), np.tile(pair, d)
    first, second = amplitudes[i[pair]], amplitudes[j[pair]]
    return Terms.of(d, first_row + component, -of_pairs[k, pair], first, second, frame, d * k + component)


def _means(first_row: int, frame: np.ndarray, positions: np.ndarray, faces: FaceFrame) -> Terms:
    """Return ``p - sum w_i x_i``."""
    n, d = positions.shape
    axes = np.arange(d)
    rows = first_row + np.concatenate([axes, np.repeat(axes, n)])
    factors = np.concatenate([np.ones(d), -np.tile(faces.weights, d)])
    return Terms.of(d, rows, factors, np.concatenate([frame[:d], positions.T.ravel()]))


def _rotations(first_row: int, frame: int, positions: np.ndarray, faces: FaceFrame) -> Iterator[Terms]:
    """Yield ``1/h sum_k (sum_i a_ik x_i) x d_k``."""
    n, d = positions.shape
    second = faces.inertia[0, 0] if d == 2 else 0.5 * np.trace(faces.inertia)
    arms = faces.arms / second
    used = np.flatnonzero(np.abs(arms).max(axis=0) > 1e-12 * np.abs(arms).max())
    for row, plane in enumerate(TURNS[d], first_row):
        for sign, (one, other) in zip((-1.0, 1.0), permutations(plane)):
            for k in used:
                factors = sign * arms[:, k]
                yield Terms.of(d, np.full(n, row), factors, positions[:, other], frame=frame, directors=d * k + one)


@njit(error_model="numpy", forceinline=True)
def parts_of(d, terms, e, q):
    """Return of a term ``f d``, its first and second derivatives with what d turns with, x and y, for items q (n_dofs,)
    of `lane_items`."""
    turning, number, factor = terms.turning[e], terms.directors[e], terms.factors[e]
    first, second = terms.first[e], terms.second[e]
    zero, unit = select(0, q[0], 0.0), select(0, q[0], 1.0)
    x = q[first] if first >= 0 else unit
    y = q[second] if second >= 0 else unit
    if turning < 0:
        return zero + factor, zero, zero, x, y
    if d == 3:
        return factor * q[turning], zero + factor, zero, x, y
    sin, cos = sine_cosine(q[turning])
    sin, cos = factor * sin, factor * cos
    if number == 1:
        return sin, cos, -sin, x, y
    if number == 2:
        return -sin, -cos, sin, x, y
    return cos, -sin, -cos, x, y


@njit(cache=True, error_model="numpy")
def _values(d, terms, q, result):
    for sample in range(q.shape[1]):
        unknowns = q[:, sample]
        for e in range(terms.rows.size):
            along, _, _, x, y = parts_of(d, terms, e, unknowns)
            result[terms.rows[e], sample] += along * x * y


@njit(cache=True, error_model="numpy")
def _jacobian(d, terms, of_first, of_second, of_turning, q, result):
    for sample in range(q.shape[1]):
        unknowns = q[:, sample]
        for e in range(terms.rows.size):
            along, slope, _, x, y = parts_of(d, terms, e, unknowns)
            if of_first[e] >= 0:
                result[of_first[e], sample] += along * y
            if of_second[e] >= 0:
                result[of_second[e], sample] += along * x
            if of_turning[e] >= 0:
                result[of_turning[e], sample] += slope * x * y


@njit(cache=True, error_model="numpy")
def _drift(d, terms, q, v, result):
    for sample in range(q.shape[1]):
        unknowns = q[:, sample]
        for e in range(terms.rows.size):
            along, slope, bend, x, y = parts_of(d, terms, e, unknowns)
            of_x, of_y, spin = terms.first[e], terms.second[e], terms.turning[e]
            vx = v[of_x, sample] if of_x >= 0 else 0.0
            vy = v[of_y, sample] if of_y >= 0 else 0.0
            turned = v[spin, sample] if spin >= 0 else 0.0
            change = 2.0 * along * vx * vy + 2.0 * slope * turned * (vx * y + x * vy) + bend * turned**2 * x * y
            result[terms.rows[e], sample] += change
