"""Poses of a rigid mechanism over two coordinates: polynomials over patches, made where they are asked for.

A table over the range of two coordinates that closes the loops to the last digit would be large, and a run visits a
line of it. On a patch poses are polynomials through their values at the Chebyshev points of both coordinates, where
Newton's method closes the loops (Trefethen 2013, chapters 2 to 4, in each of them). Poses are analytic away from
singular configurations, so that the error falls by a factor with every point. A patch whose polynomials do not close
the loops in between is parted in four, up to `DEEPEST` times; where they do not then, Newton's method closes the loops
at each configuration. A patch follows from its place alone: no other configuration has a part in the digits of one.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.vectors import LANES, aligned_zeros, load, spread, store
from pgmp_petsc.mechanism.closure import CLOSURE_TOLERANCE, LoopClosure
from pgmp_petsc.mechanism.continuation import PoseBranch, near_enough, tensor_grid

POINTS = 12  # of a patch along a coordinate
WIDEST = 4  # cells of the branch's table that a patch covers along a coordinate
DEEPEST = 3  # times that a patch is parted
PROBES = (-1.0, -0.6, 0.0, 0.6, 1.0)  # of half a patch; polynomials through Chebyshev points are furthest off at ends
LARGEST = 2**23  # coefficients that are kept, 64 MB
UNKNOWN, WHOLE, SINGULAR = -1, -2, -3  # patches that were not made yet, that close the loops, that do not at any size


class PosePatches:
    """Poses over the range of two coordinates; Newton's method starts from the table of the assembly branch."""

    def __init__(self, branch: PoseBranch) -> None:
        self._branch = branch
        self._n_poses = int(np.prod(branch.poses.shape[1:]))
        self._shape = tuple(-(-(n - 1) // WIDEST) for n in branch.shape.tolist())
        half = 0.5 * (branch.upper - branch.lower) / self._shape
        numbers = np.ascontiguousarray(np.indices(self._shape).reshape(2, -1).T)
        self._widest = branch.lower + (2 * numbers + 1) * half, np.tile(half, (len(numbers), 1))
        turns = np.pi * (np.arange(POINTS) + 0.5) / POINTS
        self._points = tensor_grid([np.cos(turns)] * 2)
        self._probes = tensor_grid([PROBES] * 2)
        self._to_coefficients = 2.0 / POINTS * np.cos(np.outer(np.arange(POINTS), turns))
        self._to_coefficients[0] *= 0.5
        self._forget()

    def at(self, closure: LoopClosure, theta: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
        """Return poses and derivatives at configurations (n_configurations, 2) inside the range, and where they are
        known to close the loops, shape (n_configurations,); the others are not.

        The closure closes the loops at the points of patches. With n = 6 found are P, dP/dtheta_1, dP/dtheta_2, and d2P
        of 11, 12 and 22, with n = 1 P alone, shape (n, n_bodies, n_pose, n_configurations).
        """
        theta, patches = np.ascontiguousarray(theta), np.empty(len(theta), dtype=np.int64)
        if self._coefficients.size > LARGEST:
            self._forget()
        while True:
            _find(theta, self._widest[0][0] - self._widest[1][0], self._shape, self._middles, self._halves,
                  self._state, patches)  # fmt: skip
            unknown = np.unique(patches[self._state[patches] == UNKNOWN])
            if not unknown.size:
                break
            self._make(closure, unknown)
        found = np.empty((n, self._n_poses, len(theta)))
        self._evaluate(theta, patches, found)
        return found.reshape(n, *self._branch.poses.shape[1:], -1), self._state[patches] == WHOLE

    def _forget(self) -> None:
        self._middles, self._halves = self._widest
        n = len(self._middles)
        # the first of the four parts of a patch, or what is known of it
        self._state, self._depth = np.full(n, UNKNOWN), np.zeros(n, dtype=np.int64)
        self._number = np.full(n, -1)  # of its coefficients
        # numbers of poses side by side, in whole vectors
        self._coefficients = aligned_zeros((0, POINTS, POINTS, -(-self._n_poses // LANES) * LANES))

    def _make(self, closure: LoopClosure, patches: np.ndarray) -> None:
        """Make patches, given by their numbers, or part them."""
        middles, halves = self._middles[patches, None], self._halves[patches, None]
        theta = (middles + halves * self._points).reshape(-1, 2)
        poses, gap = closure.newton(self._branch.guess(theta), theta)
        # one step more, to the last digit, as all others are interpolated between these
        poses = closure.corrected(poses, theta)
        values = np.moveaxis(poses, -1, 0).reshape(len(patches), POINTS, POINTS, self._n_poses)
        # one by one: sums over many at once may be in another order
        to = self._to_coefficients
        made = [np.einsum("jk,lm,kmp->jlp", to, to, own, optimize=True) for own in values]
        before = self._coefficients
        self._number[patches] = len(before) + np.arange(patches.size)
        self._coefficients = aligned_zeros((len(before) + patches.size, *before.shape[1:]))
        self._coefficients[: len(before)], self._coefficients[len(before) :, ..., : self._n_poses] = before, made
        probes = (middles + halves * self._probes).reshape(-1, 2)
        found = np.empty((1, self._n_poses, len(probes)))
        self._evaluate(probes, np.repeat(patches, len(self._probes)), found)
        missed = closure.open_and_gap(found.reshape(*poses.shape[:2], -1), probes)
        closes = near_enough(*(part.reshape(patches.size, -1) for part in missed))
        closes &= (gap < CLOSURE_TOLERANCE).reshape(patches.size, -1).all(axis=1)
        deepest = self._depth[patches] >= DEEPEST
        self._state[patches] = np.where(closes, WHOLE, SINGULAR)
        parted = patches[~closes & ~deepest]
        self._state[parted] = len(self._state) + 4 * np.arange(parted.size)
        half, ways = 0.5 * np.repeat(self._halves[parted], 4, axis=0), tensor_grid([(-1.0, 1.0)] * 2)
        corners = np.repeat(self._middles[parted], 4, axis=0) + half * np.tile(ways, (parted.size, 1))
        self._middles, self._halves = np.concatenate([self._middles, corners]), np.concatenate([self._halves, half])
        self._state = np.append(self._state, np.full(len(half), UNKNOWN))
        self._number = np.append(self._number, np.full(len(half), -1))
        self._depth = np.append(self._depth, np.repeat(self._depth[parted] + 1, 4))

    def _evaluate(self, theta: np.ndarray, patches: np.ndarray, found: np.ndarray) -> None:
        parts = self._middles[patches], self._halves[patches], self._number[patches]
        _evaluate(theta, *parts, self._coefficients, aligned_zeros((len(found), LANES)), found)


@njit(cache=True, entry=True, error_model="numpy", counted=False)
def _find(theta, first, shape, middles, halves, state, patches):
    """Fill the number of the smallest patch that every configuration (n, 2) is in, from the first corner of all on."""
    for k in range(theta.shape[0]):
        patch = 0
        for c in range(2):
            place = int((theta[k, c] - first[c]) / (2.0 * halves[0, c]))
            patch = shape[c] * patch + min(max(place, 0), shape[c] - 1)
        while state[patch] >= 0:
            upper = 2 * int(theta[k, 0] > middles[patch, 0]) + int(theta[k, 1] > middles[patch, 1])
            patch = state[patch] + upper
        patches[k] = patch


@njit(cache=True, entry=True, error_model="numpy", fastmath={"contract"})
def _evaluate(theta, middles, halves, numbers, coefficients, sums, found):
    """Fill poses and derivatives, (1 or 6, n_p, n), by Chebyshev polynomials (n_patches, N, N, whole vectors of n_p),
    for configurations with the middle, half the widths and the number of the patch of each; `sums` has room for
    vectors, (1 or 6, LANES)."""
    n, n_vectors = coefficients.shape[1], coefficients.shape[3] // LANES
    polynomials = np.zeros((2, 3, n))
    across, along = polynomials
    for k in range(theta.shape[0]):
        for c in range(2):
            x, scale, t = (theta[k, c] - middles[k, c]) / halves[k, c], 1.0 / halves[k, c], polynomials[c]
            t[0, 0], t[0, 1], t[1, 1] = 1.0, x, scale
            for j in range(2, n):
                t[0, j] = 2.0 * x * t[0, j - 1] - t[0, j - 2]
                t[1, j] = 2.0 * x * t[1, j - 1] - t[1, j - 2] + 2.0 * scale * t[0, j - 1]
                t[2, j] = 2.0 * x * t[2, j - 1] - t[2, j - 2] + 4.0 * scale * t[1, j - 1]
        for b in range(n_vectors):
            first = numbers[k] * n * n * n_vectors + b
            if found.shape[0] == 1:
                value = spread(0.0)
                for i in range(n):
                    row = spread(0.0)
                    for j in range(n):
                        row += along[0, j] * load(coefficients, first + (n * i + j) * n_vectors)
                    value += across[0, i] * row
                store(sums, 0, value)
            else:
                value, by_1, by_2 = spread(0.0), spread(0.0), spread(0.0)
                by_11, by_12, by_22 = spread(0.0), spread(0.0), spread(0.0)
                for i in range(n):
                    row, slope, bend = spread(0.0), spread(0.0), spread(0.0)
                    for j in range(n):
                        entry = load(coefficients, first + (n * i + j) * n_vectors)
                        row += along[0, j] * entry
                        slope += along[1, j] * entry
                        bend += along[2, j] * entry
                    value += across[0, i] * row
                    by_1 += across[1, i] * row
                    by_2 += across[0, i] * slope
                    by_11 += across[2, i] * row
                    by_12 += across[1, i] * slope
                    by_22 += across[0, i] * bend
                store(sums, 0, value)
                store(sums, 1, by_1)
                store(sums, 2, by_2)
                store(sums, 3, by_11)
                store(sums, 4, by_12)
                store(sums, 5, by_22)
            for part in range(found.shape[0]):
                for lane in range(min(LANES, found.shape[1] - LANES * b)):
                    found[part, LANES * b + lane, k] = sums[part, lane]
