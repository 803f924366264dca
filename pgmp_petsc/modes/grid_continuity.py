"""A basis that is continuous over a tensor grid of configurations, one axis for each rigid coordinate.

From the first sample the basis is carried along the first axis, from each sample found there along the second, and so
on; a periodic axis is closed on every line (`continuity`). What the first line of an axis is closed like, the others
follow, so that neighbouring lines stay neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pgmp_petsc.modes.continuity import close_revolution, cosines_of, group_modes, procrustes, transport
from pgmp_petsc.runtime.errors import RunError

LARGEST_TURN = 1.0  # spectral norm of the difference of neighbouring bases within their group; 2 is half a turn


@dataclass(frozen=True, eq=False)
class GridNeighbours:
    """The vectors of samples on a tensor grid, as their neighbours see them.

    Attributes
    ----------
    shape
        Number of samples along each axis; n samples in all, the last axis running fastest.
    periodic
        Whether the first sample follows the last, for each axis.
    eigenvalues
        Ascending, shape (n, n_modes).
    overlaps
        ``V_k^T M V_before`` with the sample before along each axis, shape (n_axes, n, m, m); of the first sample of an
        axis that is not periodic it has no meaning.
    """

    shape: tuple[int, ...]
    periodic: tuple[bool, ...]
    eigenvalues: np.ndarray
    overlaps: np.ndarray

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
        return replace(self, eigenvalues=self.eigenvalues[:, first], overlaps=self.overlaps[..., first, first])


@dataclass(frozen=True, eq=False)
class GridBasis:
    """What makes the vectors continuous.

    Attributes
    ----------
    groups
        As from `group_modes`.
    rotations
        ``V_continuous = V Q``, shape (n, m, m).
    flipped
        Whether a vector changes its sign after a revolution of each axis, shape (n_axes, m).
    cosines
        Cosine of the largest angle of any group to a sample before, shape (n,); 1 where there is none.
    """

    groups: list[np.ndarray]
    rotations: np.ndarray
    flipped: np.ndarray
    cosines: np.ndarray

    @classmethod
    def of(cls, samples: GridNeighbours, start: np.ndarray) -> GridBasis:
        """Carry a basis over the grid from the rotation (m, m) of the first sample.

        Over two coordinates two modes may meet at a single configuration (a conical intersection) that no sample is
        near enough to tell; carried around it, each of them comes back with the opposite sign. Where neighbouring lines
        turn away from each other, the group is joined with the one that it mixes with most: their common space is
        continuous.

        Raises
        ------
        RunError
            If neighbouring lines do not stay together even so; told is whether the modes alone would.
        """
        try:
            return cls._followed(samples, start)
        except RunError:
            n_modes = samples.eigenvalues.shape[1]
            if n_modes < len(start) and _can_be_followed(samples.of_first(n_modes), start[:n_modes, :n_modes]):
                raise RunError(
                    "the static answers in the basis cannot be followed over the configurations, though its "
                    f"{n_modes} mode(s) alone can: at some configurations an answer is nearly a combination of the "
                    "modes and of the other answers; leave some out, or all (reduction.static_modes, "
                    "reduction.inertia_modes, reduction.spring_modes = false), and keep more reduction.modes instead"
                ) from None
            raise

    @classmethod
    def _followed(cls, samples: GridNeighbours, start: np.ndarray) -> GridBasis:
        """Carry a basis as `of` does; the error blames the modes."""
        n_axes = len(samples.shape)
        met = np.concatenate([samples.along(axis)[samples.meaningful(axis)] for axis in range(n_axes)])
        groups = group_modes(samples.eigenvalues, met)
        while True:
            rotations, flipped = _carry(samples, groups, start)
            torn = _torn_groups(samples, groups, rotations, flipped)
            if not torn.size:
                break
            groups = _joined(groups, int(torn[0]), met)
        cosines = np.ones((n_axes, *samples.shape))
        for axis in range(n_axes):
            mask = samples.meaningful(axis)
            cosines[axis][mask] = cosines_of(samples.along(axis)[mask], groups)
        m = start.shape[0]
        return cls(groups, rotations.reshape(-1, m, m), flipped, cosines.min(axis=0).ravel())


def _can_be_followed(samples: GridNeighbours, start: np.ndarray) -> bool:
    """Return whether a continuous basis is found."""
    try:
        GridBasis._followed(samples, start)
    except RunError:
        return False
    return True


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
        first = (slice(None),) * axis + (0,)
        before[first] *= np.where(flipped[axis], -1.0, 1.0)
        turns = np.swapaxes(rotations, -1, -2) @ samples.along(axis) @ before
        for number, group in enumerate(groups):
            turned = procrustes(turns[samples.meaningful(axis)][(..., *np.ix_(group, group))])[0]
            torn[number] |= np.any(np.linalg.norm(turned - np.eye(group.size), 2, axis=(-2, -1)) > LARGEST_TURN)
    return np.flatnonzero(torn)


def _joined(groups: Sequence[np.ndarray], torn: int, met: np.ndarray) -> list[np.ndarray]:
    """Join a group with the one that it mixes with most among the overlaps (n, m, m) of all neighbours.

    Raises
    ------
    RunError
        If there is no other group.
    """
    if len(groups) == 1:
        raise RunError(
            "the modes cannot be followed over the configurations: a mode that is kept meets one that is not, or the "
            "configurations are too few; take another number of reduction.modes or more reduction.angles"
        )
    mixing = np.max(np.abs(met), axis=0)
    mixing = np.maximum(mixing, mixing.T)
    others = [number for number in range(len(groups)) if number != torn]
    partner = max(others, key=lambda number: mixing[np.ix_(groups[torn], groups[number])].max())
    kept = [group for number, group in enumerate(groups) if number not in (torn, partner)]
    return [*kept, np.union1d(groups[torn], groups[partner])]
