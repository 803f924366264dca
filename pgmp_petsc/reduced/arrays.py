"""Arrays that the compiled reduced equations take, keep of every block of samples, and work with.

Arrays of vectors have the shape (n, LANES); see `vectors`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import aligned
from pgmp_petsc.lanes.vectors import LANES
from pgmp_petsc.reduced.action_frames import KeptPlaces
from pgmp_petsc.reduced.action_kernel import Acting, LocalEffects, LocalWork
from pgmp_petsc.reduced.carried import Carried, CarriedRoom, KeptGaps
from pgmp_petsc.reduced.cells import Cells, Grid


class Layout(NamedTuple):
    """Where the parts of a table row begin.

    Packed mass; couplings b_kl, k >= l, one after the other; packed stiffness; with terms of second order packed V,
    c_kl, k >= l, A_k and, where coordinates are prescribed, P_k; packed structural damping, if there is any; and the
    end. A load row has n_eta entries, and with terms of second order packed B after them. Symmetric matrices are packed
    as lower triangles row by row, skew ones as strict lower triangles, V over ``i >= j >= k``, k fastest.
    """

    rigid: tuple[int, ...]  # numbers of the rigid coordinates: a tuple, so that the compiler knows how many there are
    n_eta: int  # number of coordinates
    coupling: int
    stiffness: int
    cubic: int
    swing: int
    gyroscopic: int
    driven: int
    damping: int
    end: int
    load_end: int
    quadratic: bool  # whether inertia forces quadratic in the velocities act; in slow motion they may be left out

    @property
    def second_order(self) -> bool:
        """Whether there are terms of second order."""
        return self.cubic < self.damping

    @property
    def n_rigid(self) -> int:
        """Number of entries of the packed rigid inertia, with which a row begins."""
        return len(self.rigid) * (len(self.rigid) + 1) // 2


class Work(NamedTuple):
    """State of one block of samples, and what is evaluated there: arrays of vectors (n, LANES)."""

    #: q, rate, acceleration: coordinates of the iterate and their derivatives, n_eta each
    q: np.ndarray
    rate: np.ndarray
    acceleration: np.ndarray
    #: v, a: velocities and accelerations as the inertia forces see them (see `lagrangian` and
    #: ``Layout.quadratic``), n_eta each
    v: np.ndarray
    a: np.ndarray
    balance: np.ndarray  # the residual, n_eta
    #: rigid, rigid_slope: packed rigid inertia, and its derivatives, coordinate after coordinate
    rigid: np.ndarray
    rigid_slope: np.ndarray
    #: load, load_slope: ``a Q`` and ``a B`` (layout.load_end), and derivatives, coordinate after coordinate
    load: np.ndarray
    load_slope: np.ndarray
    right: np.ndarray  # a right-hand side of the rigid coordinates, n_theta
    place: np.ndarray  # in the cells, n_theta, rad

    @classmethod
    def of(cls, layout: Layout) -> Work:
        """Return arrays for a layout, of any numbers."""
        r, n, n_load = len(layout.rigid), layout.n_eta, layout.load_end
        sizes = n, n, n, n, n, n, layout.n_rigid, r * layout.n_rigid, n_load, r * n_load, r, r
        return cls(*(aligned((size, LANES)) for size in sizes))


class Matrix(NamedTuple):
    """Iteration matrix ``[[corner, row], [column, factor]]`` of one block of samples, arrays of vectors (n, LANES)."""

    factor: np.ndarray  # symmetric part of the flexible block, packed, or the lower one of its factors
    corner: np.ndarray  # ``d r_k / d theta_j``, row by row; n_theta^2 entries
    #: column, row: ``d r_delta / d theta_k`` and ``d r_k / d delta``, n_delta entries of each k
    column: np.ndarray
    row: np.ndarray
    #: skew part of the flexible block, packed, with a diagonal that is not used, or the upper one of its factors; no
    #: entries without terms of second order
    skew: np.ndarray


@njit(inline="always")
def pair(k, j):
    """Return the place of entry (k, j) of a packed symmetric matrix."""
    return k * (k + 1) // 2 + j if k >= j else j * (j + 1) // 2 + k


@njit(inline="always")
def layout_n_rigid(r):
    """Return the number of entries of the packed rigid inertia."""
    return r * (r + 1) // 2


class Tables(NamedTuple):
    """Polynomials: of degree 7 in each coordinate for the rigid inertia, cubic for all other terms and the loads."""

    rigid: Cells
    terms: Cells
    loads: Cells


class Weights(NamedTuple):
    """Of the terms and of the load terms, (n_blocks, n, LANES); and the number of the effect of each load term.

    `together` are as many zeros as there are terms: all of them add to one polynomial.
    """

    terms: np.ndarray
    loads: np.ndarray
    effects: np.ndarray
    together: np.ndarray


class Equations(NamedTuple):
    """Parts of the equations of motion of a batch."""

    layout: Layout  # parts of a table row
    grid: tuple[Grid, ...]  # `Grid` of every coordinate
    #: tables, weights: see `Tables`, `Weights`
    tables: Tables
    weights: Weights
    local: LocalEffects  # local effects
    mass_damping: float  # factor alpha of the damping proportional to the mass, 1/s
    prescribed: np.ndarray  # whether a coordinate's motion is given, shape (n_eta,)
    #: displacement (in units of the mechanism's size or 1 rad) per unit of each coordinate, shape (n_eta,)
    scale: np.ndarray
    carried: Carried  # joints whose forces friction hangs on


class Memory(NamedTuple):
    """Values kept of every block from one evaluation to the next."""

    samples: np.ndarray  # number of the sample in each lane, (n_blocks, LANES); where none is left the last one again
    cells: np.ndarray  # numbers of the cells that the samples are in, -1 before the first, vectors (n_blocks, LANES)
    #: rigid, terms, loads: polynomials there, (n_blocks, n_entries * n_powers, LANES): of the rigid inertia, of the
    #: other terms, and of a unit of every effect's amplitude, effect after effect
    rigid: np.ndarray
    terms: np.ndarray
    loads: np.ndarray
    matrix: Matrix  # iteration matrices, each array with an axis of blocks in front
    places: KeptPlaces  # `KeptPlaces` of the local effects, each array with an axis of blocks in front
    acting: Acting  # what local effects add; see `action_kernel.Acting`
    #: known, depths: see `action_kernel.act`
    known: np.ndarray
    depths: np.ndarray
    carried: KeptGaps


class Strengths(NamedTuple):
    """Strengths at the ends of several steps, arrays (n_t, n), or on each lane now, arrays of vectors (n, LANES)."""

    #: loads, actions: amplitudes of the effects with loads, n_effects, and of the actions, n_actions
    loads: np.ndarray
    actions: np.ndarray
    #: position, velocity and acceleration of every coordinate, where they are given, 3 n_theta; none if none are
    motions: np.ndarray


class Room(NamedTuple):
    """What the kernels work with, one block of samples at a time."""

    work: Work
    #: local, rates: of local effects, and of their rates alone
    local: LocalWork
    rates: LocalWork
    carried: CarriedRoom

    @classmethod
    def of(cls, equations: Equations) -> Room:
        """Return room for equations."""
        layout, local = equations.layout, equations.local
        r = len(equations.grid)
        every = Work.of(layout), LocalWork.of(local, r, layout.n_eta), LocalWork.of(local, r, 1)
        return cls(*every, CarriedRoom.of(equations.carried, local))


@njit(inline="always")
def matrix_of(memory, block):
    """Return the iteration matrix of a block."""
    whole = memory.matrix
    return Matrix(whole.factor[block], whole.corner[block], whole.column[block], whole.row[block], whole.skew[block])


@njit(inline="always")
def upper_of(matrix):
    """Return the upper factor, transposed: the lower one where there is no skew part."""
    return matrix.skew if matrix.skew.shape[0] > 0 else matrix.factor


@njit(inline="always")
def places_of(memory, block):
    """Return the polynomials of local effects in the cells of a block."""
    whole = memory.places
    return KeptPlaces(whole.cells[block], whole.weights[block], whole.rigid[block], whole.shapes[block])


@njit(inline="always")
def acting_of(memory, block):
    """Return what local effects add to a block."""
    return Acting(memory.acting.balance[block], memory.acting.tangent[block])
