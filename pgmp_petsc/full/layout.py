"""Where what belongs to a body in a floating frame lies: in its table, and in the work space of compiled functions.

For each body and sample the table has, one after the other: mass and ``int rho X``; ``int rho X_k X_l``; ``int rho
Psi_k``; ``int rho X_k Psi_l``; what damps each amplitude by itself; ``int rho Psi_k Psi_l``; the mass of the
amplitudes; their stiffness; and, of a body that follows its foreshortening, ``int rho X_k chi_l``. Of the last four
those entries alone are there that are not zero for all samples (`entries_of`): of a straight beam, whose fields
stretch, twist or bend it in one of two planes, a fifth. Work space is made once a call, for the body with most
amplitudes, and viewed anew for each body.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.floating import NOISE, first_moments, second_moments
from pgmp_petsc.lanes.compiled import njit

PLANE, SPACE = (0.0, 0.0), (0.0, 0.0, 0.0)


def by_dimension(function: Callable) -> Callable:
    """Return a compiled function that takes the dimension, 2 or 3, in place of the first argument of one `apart`, a
    tuple of as many numbers: its loops over dimensions are of known length, and its callers are compiled once for both.
    """

    @njit(error_model="numpy", forceinline=True)
    def call(dimension, *arguments):
        if dimension == 2:
            function(PLANE, *arguments)
        else:
            function(SPACE, *arguments)

    return call


class FloatingBodies(NamedTuple):
    """Flexible bodies in floating frames."""

    dofs: np.ndarray  # unknowns of all bodies, body after body: of the floating frame, then the amplitudes
    #: where the unknowns, the words of the table, the positions, the rows, the columns and the common numbers of each
    #: body begin, and their ends, shape (n + 1, 6)
    firsts: np.ndarray
    body: np.ndarray  # number of the body, shape (n,)
    table: np.ndarray  # moments and stiffness, shape (n_blocks, n_words, n_lanes)
    gravity: np.ndarray  # acceleration of every gravity effect, shape (n_blocks, n_gravity, d, n_lanes), m/s2
    gravity_loads: np.ndarray  # the load whose amplitude each of them has, shape (n_gravity,)
    positions: np.ndarray  # where the matrix stores the packed lower triangle of each body
    counted: np.ndarray  # whether a body is counted here, in sums over all ranks, shape (n,)
    #: rows, columns: see `entries_of`
    rows: np.ndarray
    columns: np.ndarray
    #: ``int rho Psi_k Psi_l`` once more, of bodies of which all entries are there and the same in all samples: the
    #: table has eight numbers for each of them, and does not stay in the cache
    common: np.ndarray


def entries_of(
    moments: Mapping[Monomial, np.ndarray],
    stiffness: Mapping[Monomial, np.ndarray],
    curved: Mapping[Monomial, np.ndarray],
    d: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return which entries of a body's matrices are not zero whatever the parameters: where each row begins, of ``int
    rho Psi_k Psi_l``, (l, k, j) over i, all of them where most are, behind them of mass and stiffness, and of ``int rho
    X_l chi_k``, (l, k, i) over j, if there is any, (d d n + n + d d n + 1,), all columns, and the three as masks (d, d,
    n, n), (n, n), (d, d, n, n) or (0, n)."""
    parts = [second_moments(part, d)[2].swapaxes(2, 3) for part in moments.values()]
    both = np.any([part != 0.0 for part in parts], axis=0)
    squares = [np.einsum("kkij->kij", part) for part in parts]
    own = np.any([np.abs(part.sum(axis=0)) > NOISE * np.abs(part).sum(axis=0) for part in squares], axis=0)
    own |= np.any([part != 0.0 for part in stiffness.values()], axis=0) | np.eye(len(own), dtype=bool)
    bends = np.any([part != 0.0 for part in curved.values()], axis=0) if curved else np.zeros((0, len(own)), dtype=bool)
    if 2 * np.count_nonzero(both) > both.size:  # with few gaps all are added as vectors
        both = np.ones_like(both)
    every = np.concatenate([mask.reshape(-1, len(own)) for mask in (both, own | own.T, bends)])
    return np.concatenate([[0], np.cumsum(every.sum(axis=1))]), np.nonzero(every)[1], both, own | own.T, bends


def body_tables(
    moments: np.ndarray,
    stiffness: np.ndarray,
    viscous: np.ndarray,
    curved: np.ndarray,
    d: int,
    masks: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> np.ndarray:
    """Lay out a body's table, shape (n_words, n_samples).

    Arguments are moments and stiffness, shapes (r, r, n_samples) and (n, n, n_samples), modal damping of each
    amplitude, shape (n, n_samples), ``int rho X_k chi_l``, shape (d, d, n, n, n_samples) or (0, n, n_samples), the
    dimension, and the masks of `entries_of`.
    """
    places, of_fields = first_moments(moments, d)
    squares, mixed, both = second_moments(moments, d)
    own = np.einsum("kkij...->ij...", both)[masks[1]]
    parts = (
        places,
        squares,
        of_fields,
        mixed,
        viscous,
        both.swapaxes(2, 3)[masks[0]],
        own,
        stiffness[masks[1]],
        curved[masks[2]],
    )
    return np.concatenate([part.reshape(-1, moments.shape[2]) for part in parts])


class Places(NamedTuple):
    """Where the parts of a body's table begin; mass and ``int rho X`` are its first 1 + d words.

    Entries of matrices are counted as in `entries_of`: those of the mass follow those of `both`, `stiffness` has the
    same ones, and those of ``int rho X_k chi_l`` follow it.
    """

    squares: int
    fields: int
    mixed: int
    viscous: int
    both: int
    stiffness: int


@njit(inline="always")
def places_of(d, n, rows):
    """Return where the parts of the table of a body with n amplitudes begin, as `body_tables` lays them out."""
    squares = 1 + d
    fields = squares + d * d
    mixed = fields + d * n
    viscous = mixed + d * d * n
    both = viscous + n
    stiffness = both + rows[d * d * n + n] - rows[d * d * n]
    return Places(squares, fields, mixed, viscous, both, stiffness)


class Moving(NamedTuple):
    """A body in motion, items of shape (d,), (d, d) and (n,): directors are rows of `d`, with the components of their
    velocities in the body's frame, ``spin[l, k] = d_l.d_k'``."""

    p: np.ndarray
    d: np.ndarray
    d1: np.ndarray
    d2: np.ndarray
    spin: np.ndarray
    x: np.ndarray
    x1: np.ndarray
    x2: np.ndarray


class Shaped(NamedTuple):
    """Moments of the deformed body: ``s_k = int rho w_k``, its rate and acceleration (d,); ``J_kl = int rho w_k w_l``,
    ``int rho w_k w_l'`` and ``int rho w_k w_l''`` (d, d); ``int rho w_k dw_l / dxi`` (d, d, n); ``sum_kl spin_kl int
    rho Psi_k Psi_l xi'`` (n,); and ``xi^T int rho X_k chi_l xi`` and the same of the rates (d, d)."""

    s: np.ndarray
    s1: np.ndarray
    s2: np.ndarray
    j: np.ndarray
    j1: np.ndarray
    j2: np.ndarray
    g: np.ndarray
    h: np.ndarray
    bent: np.ndarray
    bending: np.ndarray


class View(NamedTuple):
    """A body in work space: number n of its amplitudes, its unknowns, its table (n_words,) with the rows and columns of
    entries, what samples have in common, what it does, and room for the forces on p, d_l and xi, one after the other,
    and for ``d_l.p''`` (d,)."""

    n: int
    dofs: np.ndarray
    table: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    common: np.ndarray
    one: Moving
    shaped: Shaped
    force: np.ndarray
    pull: np.ndarray


@njit(inline="always")
def n_pose_of(d):
    """Return the number of unknowns of a frame."""
    return 3 if d == 2 else 12


@njit(inline="always")
def n_words(floating, d):
    """Return the words of work space that the body with most amplitudes takes."""
    n = 0
    for k in range(floating.body.size):
        n = max(n, floating.firsts[k + 1, 0] - floating.firsts[k, 0] - n_pose_of(d))
    return d + 4 * d * d + 3 * n + 3 * d + 3 * d * d + d * d * n + n + 2 * d * d + d + d * d + n + d


@njit(inline="always")
def view_of(work, floating, k, tables, d):
    """View work space (n_words,) as a body, given by its number; `tables` are those of all bodies (n_all_words,)."""
    firsts, m = floating.firsts, d * d
    dofs = floating.dofs[firsts[k, 0] : firsts[k + 1, 0]]
    n = dofs.size - n_pose_of(d)
    x = d + 4 * m  # amplitudes, behind position and directors
    s = x + 3 * n  # moments, behind the amplitudes' rates
    j, g = s + 3 * d, s + 3 * d + 3 * m
    bent = g + (m + 1) * n
    force = bent + 2 * m
    pull = force + d + m + n
    one = Moving(
        work[:d], work[d : d + m].reshape((d, d)), work[d + m : d + 2 * m].reshape((d, d)),
        work[d + 2 * m : d + 3 * m].reshape((d, d)), work[d + 3 * m : x].reshape((d, d)), work[x : x + n],
        work[x + n : x + 2 * n], work[x + 2 * n : s],
    )  # fmt: skip
    shaped = Shaped(
        work[s : s + d], work[s + d : s + 2 * d], work[s + 2 * d : j], work[j : j + m].reshape((d, d)),
        work[j + m : j + 2 * m].reshape((d, d)), work[j + 2 * m : g].reshape((d, d)),
        work[g : g + m * n].reshape((d, d, n)), work[g + m * n : bent],
        work[bent : bent + m].reshape((d, d)), work[bent + m : force].reshape((d, d)),
    )  # fmt: skip
    return View(
        n, dofs, tables[firsts[k, 1] : firsts[k + 1, 1]], floating.rows[firsts[k, 3] : firsts[k + 1, 3]],
        floating.columns[firsts[k, 4] : firsts[k + 1, 4]], floating.common[firsts[k, 5] : firsts[k + 1, 5]], one,
        shaped, work[force:pull], work[pull : pull + d],
    )  # fmt: skip
