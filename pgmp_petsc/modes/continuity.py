"""A basis that is continuous over the configurations: groups of modes, each turned to its neighbour's by the M-weighted
orthogonal Procrustes problem (docs/method.md, one continuous basis).

After a whole revolution a group returns turned by an orthogonal matrix H (its holonomy), which is taken back evenly
over the revolution, over two where H contains a reflection. Over several coordinates H of one of them changes
continuously with the others. From the first sample of a tensor grid the basis is carried along the first axis, from
each sample found there along the second, and so on. What the first line of a periodic axis is closed like, the others
follow, with the same coordinate reflected and the turn taken back the same way round, so that neighbouring lines stay
neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import schur
from scipy.sparse.csgraph import connected_components

from pgmp_petsc.base.errors import NotFollowed, RunError
from pgmp_petsc.solvers.shift_invert import EQUAL_TOLERANCE

CLOSE_TOLERANCE = 1e-2  # relative gap of neighbouring eigenvalues that makes one group of them
VEERING = 0.1  # overlap of different modes from one sample to the next that makes one group of them ...
FAR_APART = 0.5  # ... where their eigenvalues come closer than this; others drift into each other as the angle grows
EXCHANGE = 0.5  # overlap that makes one group of any vectors: one turns into the other between two samples
LOST = (
    "cannot be followed over the configurations: a mode that is kept meets one that is not, or the configurations are "
    "too few; take another number of reduction.modes or more reduction.angles"
)


def procrustes(overlaps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solve the orthogonal Procrustes problem, of many pairs of bases together: return Q such that ``V Q`` is closest
    to B, shape (..., m, m), and the cosine of the largest angle between the two subspaces, shape (...), 1 where they
    agree.

    Overlaps ``V^T M B``, shape (..., m, m), are of the new vectors V with the neighbour's basis B.
    """
    if overlaps.shape[-1] == 1:  # a sign
        return np.where(overlaps < 0.0, -1.0, 1.0), np.abs(overlaps[..., 0, 0])
    left, cosines, right = np.linalg.svd(overlaps)
    return left @ right, cosines[..., -1]


def canonical_rotation(eigenvalues: np.ndarray, probe: np.ndarray) -> np.ndarray:
    """Fix signs and rotations among equal eigenvalues, ascending, shape (m,), whatever the solver made of them.

    Returns an orthogonal matrix (m, m) with a block for equal eigenvalues. The probe is ``V^T W`` with fixed vectors W,
    shape (m, m).
    """
    splits = np.flatnonzero(np.diff(eigenvalues) > EQUAL_TOLERANCE * eigenvalues[1:]) + 1
    bounds = [0, *splits, eigenvalues.size]
    return by_groups(probe, [np.arange(*pair) for pair in zip(bounds, bounds[1:])])[0]


def group_modes(eigenvalues: np.ndarray, overlaps: np.ndarray, strained: np.ndarray | bool = True) -> list[np.ndarray]:
    """Find groups of modes that stay apart from all others over the whole range; return the increasing numbers of each.

    Eigenvalues are of the first n_modes vectors, ascending at every sample, shape (n, n_modes); further vectors (static
    modes) have none. Overlaps ``V_k^T M V_{k-1}`` go from each sample to the next, shape (n', m, m). Vectors that are
    not `strained`, (m,), make groups of their own: one with others would have stiffness between samples.
    """
    n_modes = eigenvalues.shape[1]
    mixing = np.max(np.abs(overlaps), axis=0, initial=0.0)
    linked = mixing > EXCHANGE
    larger = np.maximum(eigenvalues[:, :, None], eigenvalues[:, None, :])
    gaps = np.min(np.abs(eigenvalues[:, :, None] - eigenvalues[:, None, :]) / larger, axis=0)
    among = mixing[:n_modes, :n_modes]
    veering = (among > VEERING) & (gaps < FAR_APART)
    # static modes have no eigenvalues: their loads tell them apart, and drift as the modes beside them do
    linked[:n_modes, :n_modes] |= (gaps < CLOSE_TOLERANCE) | veering
    n_groups, label = connected_components(linked & np.equal.outer(strained, strained), directed=False)
    return [np.flatnonzero(label == group) for group in range(n_groups)]


def transport(overlaps: np.ndarray, groups: Sequence[np.ndarray], start: np.ndarray) -> np.ndarray:
    """Carry a basis from each sample to the next; return Q of every sample, shape (n, m, m).

    Overlaps are ``V_k^T M V_{k-1}`` for samples 1 to n - 1, shape (n - 1, m, m); `start` is the rotation of the first
    sample, block-diagonal in the `groups` of `group_modes`, shape (m, m).
    """
    # the polar factor of O Q with an orthogonal Q is that of O, times Q
    rotations = [start]
    for turn in by_groups(overlaps, groups)[0]:
        rotations.append(turn @ rotations[-1])
    return np.array(rotations)


def by_groups(overlaps: np.ndarray, groups: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the Procrustes rotations of overlaps (..., m, m), block-diagonal, and the least cosines of a group."""
    rotations, smallest = np.zeros_like(overlaps), np.ones(overlaps.shape[:-2])
    alone = np.array([group[0] for group in groups if group.size == 1], dtype=int)  # most are single vectors
    signs, cosines = procrustes(overlaps[..., alone, alone][..., None, None])
    rotations[..., alone, alone] = signs[..., 0, 0]
    np.minimum(smallest, cosines.min(axis=-1, initial=1.0), out=smallest)
    for group in (group for group in groups if group.size > 1):
        block = (..., *np.ix_(group, group))
        rotations[block], cosines = procrustes(overlaps[block])
        np.minimum(smallest, cosines, out=smallest)
    return rotations, smallest


@dataclass(frozen=True, eq=False)
class Revolution:
    """A closed revolution."""

    #: such that the basis is continuous from the last sample to the first, but for the flipped coordinates, shape (n,
    #: m, m)
    rotations: np.ndarray
    closures: list[Closure]  # how each group was closed
    flipped: np.ndarray  # coordinates with the opposite sign after a revolution, shape (n_flipped,)


def close_revolution(
    rotations: np.ndarray, last_overlap: np.ndarray, groups: Sequence[np.ndarray], beside: Revolution | None = None
) -> Revolution:
    """Take the holonomy back over the revolution.

    Rotations are as from `transport`, groups as from `group_modes`, and the last overlap is ``V_0^T M V_{n-1}``, shape
    (m, m). `beside` is the closed revolution at a neighbouring value of another coordinate, if this one must go with
    it.
    """
    back, _ = by_groups(last_overlap @ rotations[-1], groups)
    holonomy = rotations[0].T @ back
    closed, closures, flipped = rotations.copy(), [], []
    for number, group in enumerate(groups):
        own = holonomy[np.ix_(group, group)]
        closure = Closure.of(own) if beside is None else Closure.beside(own, beside.closures[number])
        closed[..., group] = rotations[..., group] @ closure.rotations(np.arange(len(rotations)) / len(rotations))
        if closure.flipped >= 0:
            flipped.append(group[closure.flipped])
        closures.append(closure)
    return Revolution(closed, closures, np.array(flipped, dtype=int))


@dataclass(frozen=True)
class Closure:
    """How the transported basis of one group is closed over a revolution."""

    #: what the basis is multiplied with where the revolution begins, shape (m, m): the identity, or with a reflection a
    #: frame in which the reflected direction is a coordinate
    start: np.ndarray
    #: orthogonal matrix whose columns span the planes that turn, in the basis after `start`, shape (m, m)
    frame: np.ndarray
    planes: np.ndarray  # pairs of columns, shape (n_planes, 2)
    angles: np.ndarray  # angle that each plane has turned over the revolution, shape (n_planes,), rad
    flipped: int  # coordinate that comes back reflected, or -1

    @classmethod
    def of(cls, holonomy: np.ndarray) -> Closure:
        """Split an orthogonal holonomy into plane rotations and at most one reflection."""
        frame, planes, angles, flipped = _planes(holonomy)
        eye = np.eye(len(frame))
        return cls(eye, frame, planes, angles, -1) if flipped < 0 else cls(frame, eye, planes, angles, flipped)

    @classmethod
    def beside(cls, holonomy: np.ndarray, other: Closure) -> Closure:
        """Split a holonomy close to that of another closure, so that both take their turn back alike.

        Raises `RunError` if one of them contains a reflection and the other does not.
        """
        signs = np.ones(len(holonomy))
        signs[other.flipped if other.flipped >= 0 else slice(0)] = -1.0
        frame, planes, angles, flipped = _planes(signs[:, None] * (other.start.T @ holonomy @ other.start))
        if flipped >= 0:
            raise RunError(f"the modes' signs {LOST}")
        # half a turn forwards or back: the way that the other one goes
        expected = np.array([frame[:, i] @ other.generator @ frame[:, j] for i, j in planes]).reshape(angles.shape)
        return cls(
            other.start, frame, planes, angles + 2 * np.pi * np.rint((expected - angles) / (2 * np.pi)), other.flipped
        )

    @property
    def generator(self) -> np.ndarray:
        """Skew matrix whose exponential turns the planes by their angles, shape (m, m)."""
        result = np.zeros_like(self.frame)
        for (i, j), angle in zip(self.planes, self.angles):
            plane = np.outer(self.frame[:, i], self.frame[:, j])
            result += angle * (plane - plane.T)
        return result

    def rotations(self, fractions: np.ndarray) -> np.ndarray:
        """Return what the transported basis is multiplied with, fractions (n,) of the way round, shape (n, m, m)."""
        turns = np.tile(np.eye(len(self.frame)), (fractions.size, 1, 1))
        for (i, j), angle in zip(self.planes, self.angles):
            cos, sin = np.cos(fractions * angle), np.sin(fractions * angle)
            turns[:, i, i], turns[:, i, j], turns[:, j, i], turns[:, j, j] = cos, sin, -sin, cos
        return self.start @ (self.frame @ turns @ self.frame.T)


def _planes(holonomy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Split an orthogonal matrix: frame, planes and angles as in `Closure`, and the frame's reflected column or -1."""
    form, frame = schur(holonomy, output="real")
    planes, angles, reflected = [], [], []
    column, size = 0, len(form)
    while column < size:
        if column + 1 < size and abs(form[column + 1, column]) > 1e-12:
            planes.append((column, column + 1))
            angles.append(np.arctan2(form[column + 1, column], form[column, column]))
            column += 2
        else:
            if form[column, column] < 0:
                reflected.append(column)
            column += 1
    # two reflections are one half turn
    while len(reflected) > 1:
        planes.append((reflected.pop(), reflected.pop()))
        angles.append(np.pi)
    flipped = reflected[0] if reflected else -1
    return frame, np.array(planes, dtype=int).reshape(-1, 2), np.array(angles), flipped


LARGEST_TURN = 1.0  # spectral norm of the difference of neighbouring bases within their group; 2 is half a turn
POOR_COSINE = 0.5  # between spaces of modes of neighbouring angles or lengths; tables between them are then of neither


@dataclass(frozen=True, eq=False)
class GridNeighbours:
    """The vectors of samples on a tensor grid, as their neighbours see them."""

    shape: tuple[int, ...]  # number of samples along each axis; n samples in all, the last axis running fastest
    periodic: tuple[bool, ...]  # whether the first sample follows the last, for each axis
    eigenvalues: np.ndarray  # ascending, shape (n, n_modes)
    #: ``V_k^T M V_before`` with the sample before along each axis, shape (n_axes, n, m, m); of the first sample of an
    #: axis that is not periodic it has no meaning
    overlaps: np.ndarray
    strained: np.ndarray  # whether a vector has stiffness, shape (m,): what elastic joints allow has none

    def along(self, axis: int) -> np.ndarray:
        """Return the overlaps along an axis on the grid, shape (*shape, m, m)."""
        return self.overlaps[axis].reshape(*self.shape, *self.overlaps.shape[2:])

    def meaningful(self, axis: int) -> np.ndarray:
        """Return whether each sample has one before it along an axis, shape (*shape)."""
        mask = np.ones(self.shape, dtype=bool)
        if not self.periodic[axis]:
            mask[(slice(None),) * axis + (0,)] = False
        return mask

    def of_first(self, n_vectors: int) -> GridNeighbours:
        """Return what is known of the first vectors alone."""
        first = slice(n_vectors)
        few = {"overlaps": self.overlaps[..., first, first], "strained": self.strained[first]}
        return replace(self, eigenvalues=self.eigenvalues[:, first], **few)


@dataclass(frozen=True, eq=False)
class GridBasis:
    """Rotations that make the vectors continuous."""

    groups: list[np.ndarray]  # as from `group_modes`
    rotations: np.ndarray  # ``V_continuous = V Q``, shape (n, m, m)
    flipped: np.ndarray  # whether a vector changes its sign after a revolution of each axis, shape (n_axes, m)
    #: cosine of the largest angle of any group to a sample before, shape (n,); 1 where there is none
    cosines: np.ndarray

    @classmethod
    def of(cls, samples: GridNeighbours, start: np.ndarray) -> GridBasis:
        """Carry a basis over the grid from the rotation (m, m) of the first sample.

        Over two coordinates two modes may meet at a single configuration (a conical intersection) that no sample is
        near enough to tell; carried around it, each of them comes back with the opposite sign. Where neighbouring lines
        turn away from each other, the group is joined with the one that it mixes with most: their common space is
        continuous. Raises `RunError` if neighbouring lines do not stay together even so; told is whether the modes
        alone would, or how many of the first ones, closely if any number is.
        """
        try:
            return cls._followed(samples, start)
        except RunError as error:
            n_modes = samples.eigenvalues.shape[1]
            followed = _followed_modes(samples, start)
            n_followed = max(followed, default=0)
            if n_modes < len(start) and n_followed == n_modes:
                told = (
                    "the static answers in the basis cannot be followed over the configurations, though its "
                    f"{n_modes} mode(s) alone can: at some configurations an answer is nearly a combination of the "
                    "modes and of the other answers; leave some out, or all (reduction.static_modes, "
                    "reduction.inertia_modes, reduction.spring_modes = false), and keep more reduction.modes instead"
                )
                raise NotFollowed(told, 0) from None
            closely = max((n for n, cosine in followed.items() if cosine >= POOR_COSINE), default=n_followed)
            told = f"; with reduction.modes = {closely} they can" if closely else ""
            if closely and n_modes < len(start):
                told += (
                    ", where no static answers are beside them (reduction.static_modes, reduction.inertia_modes, "
                    "reduction.spring_modes = false); with these it has to be tried"
                )
            raise NotFollowed(f"{error}{told}", closely) from None

    @classmethod
    def _followed(cls, samples: GridNeighbours, start: np.ndarray) -> GridBasis:
        """Carry a basis as `of` does; the error blames the modes."""
        n_axes = len(samples.shape)
        met = np.concatenate([samples.along(axis)[samples.meaningful(axis)] for axis in range(n_axes)])
        groups = group_modes(samples.eigenvalues, met, samples.strained)
        while True:
            rotations, flipped = _carry(samples, groups, start)
            torn = _torn_groups(samples, groups, rotations, flipped)
            if not torn.size:
                break
            groups = _joined(groups, int(torn[0]), met, samples.strained)
        cosines = np.ones((n_axes, *samples.shape))
        for axis in range(n_axes):
            mask = samples.meaningful(axis)
            cosines[axis][mask] = by_groups(samples.along(axis)[mask], groups)[1]
        m = start.shape[0]
        return cls(groups, rotations.reshape(-1, m, m), flipped, cosines.min(axis=0).ravel())


def _followed_modes(samples: GridNeighbours, start: np.ndarray) -> dict[int, float]:
    """Return how many of the first modes can be followed, and the least cosine between neighbours of each number."""
    found = {}
    for n in range(samples.eigenvalues.shape[1], 0, -1):
        with suppress(RunError):
            found[n] = float(GridBasis._followed(samples.of_first(n), start[:n, :n]).cosines.min())
    return found


def _carry(samples: GridNeighbours, groups: Sequence[np.ndarray], start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations (*shape, m, m) and which vectors flip, shape (n_axes, m), for given groups."""
    shape, m, n_axes = samples.shape, start.shape[0], len(samples.shape)
    rotations = np.zeros((*shape, m, m))
    rotations[(0,) * n_axes] = start
    flipped = np.zeros((n_axes, m), dtype=bool)
    for axis in range(n_axes):
        overlaps, rest, beside = samples.along(axis), (0,) * (n_axes - axis - 1), None
        for line in np.ndindex(*shape[:axis]):
            whole = (*line, slice(None), *rest)
            carried = transport(overlaps[whole][1:], groups, rotations[(*line, 0, *rest)])
            if samples.periodic[axis]:
                beside = close_revolution(carried, overlaps[whole][0], groups, beside)
                carried = beside.rotations
                flipped[axis, beside.flipped] = True
            rotations[whole] = carried
    return rotations, flipped


def _torn_groups(
    samples: GridNeighbours, groups: Sequence[np.ndarray], rotations: np.ndarray, flipped: np.ndarray
) -> np.ndarray:
    """Return the numbers of the groups in which lines that were carried side by side are no neighbours all along."""
    torn = np.zeros(len(groups), dtype=bool)
    for axis in range(len(samples.shape) - 1):
        before = np.roll(rotations, 1, axis=axis)
        before[(slice(None),) * axis + (0,)] *= np.where(flipped[axis], -1.0, 1.0)
        turns = np.swapaxes(rotations, -1, -2) @ samples.along(axis) @ before
        for number, group in enumerate(groups):
            turned = procrustes(turns[samples.meaningful(axis)][(..., *np.ix_(group, group))])[0]
            torn[number] |= np.any(np.linalg.norm(turned - np.eye(group.size), 2, axis=(-2, -1)) > LARGEST_TURN)
    return np.flatnonzero(torn)


def _joined(groups: Sequence[np.ndarray], torn: int, met: np.ndarray, strained: np.ndarray) -> list[np.ndarray]:
    """Join a group with the one that it mixes with most among the overlaps (n, m, m) of all neighbours, and that is
    `strained`, (m,), as it is.

    Raises `RunError` if there is no other group.
    """
    kind = strained[groups[torn][0]]
    others = [number for number, group in enumerate(groups) if number != torn and strained[group[0]] == kind]
    if not others:
        raise RunError(f"the modes {LOST}")
    mixing = np.max(np.abs(met), axis=0)
    mixing = np.maximum(mixing, mixing.T)
    partner = max(others, key=lambda number: mixing[np.ix_(groups[torn], groups[number])].max())
    kept = [group for number, group in enumerate(groups) if number not in (torn, partner)]
    return [*kept, np.union1d(groups[torn], groups[partner])]
