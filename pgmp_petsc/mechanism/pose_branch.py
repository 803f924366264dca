"""The assembly branch of a rigid mechanism as a table: poses and their derivatives over the coordinates' range.

Of one coordinate, poses in between come from quintic Hermite polynomials, in steps so small that they close the loops
as well as Newton's method would: the table is then all that is needed to place the mechanism, and a reduced model keeps
it. Of two, and where steps cannot be small enough, it is where Newton's method starts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pgmp_petsc.mechanism.closure import CLOSURE_TOLERANCE, LoopClosure
from pgmp_petsc.mechanism.continuation import Continuation
from pgmp_petsc.runtime.compiled import njit

MOST_HALVINGS = 3
PROBES = (0.25, 0.5, 0.75)  # of a cell; polynomials are furthest from the solution in the middle
SHARE = 0.5  # of the closure's tolerance that is left between them


@dataclass(frozen=True, eq=False)
class PoseBranch:
    """Poses on a grid over the coordinates, the last of which runs fastest.

    Attributes
    ----------
    axes
        Values of every coordinate, at equal distances, rad.
    poses
        Shape (n, n_bodies, n_pose).
    rates, curvatures
        Derivatives with the coordinates, shapes (n, n_bodies, n_pose, n_theta) and (..., n_theta, n_theta).
    winding
        How often every body has turned when a periodic coordinate has made a turn, shape (n_theta, n_bodies).
    is_exact
        Whether `guess` is as close as a solution inside the range.
    n_redundant
        Number of constraints that follow from the others.
    """

    axes: tuple[np.ndarray, ...]
    poses: np.ndarray
    rates: np.ndarray
    curvatures: np.ndarray
    winding: np.ndarray
    is_exact: bool
    n_redundant: int

    @classmethod
    def of(
        cls, closure: LoopClosure, continued: Continuation, axes: Sequence[np.ndarray], n_redundant: int
    ) -> PoseBranch:
        """Tabulate what a continuation over the axes has found."""
        coordinates, n_bodies = closure.mechanism.coordinates, len(closure.mechanism.bodies)
        winding = np.zeros((len(coordinates), n_bodies))
        for k, coordinate in enumerate(coordinates):
            if coordinate.periodic:
                winding[k] = continued.winding(k)
        found = cls._tabulated(closure, axes, continued.poses, winding, n_redundant)
        if len(axes) > 1:
            return found
        n_halved = 0
        while not (closes := found._closes(closure)) and n_halved < MOST_HALVINGS:
            n_halved += 1
            theta = np.linspace(axes[0][0], axes[0][-1], 2 * found.axes[0].size - 1)
            poses = closure.close(found.guess(theta[:, None]), theta[:, None])
            found = cls._tabulated(closure, (theta,), poses, winding, n_redundant)
        return replace(found, is_exact=closes)

    @classmethod
    def _tabulated(
        cls,
        closure: LoopClosure,
        axes: Sequence[np.ndarray],
        poses: np.ndarray,
        winding: np.ndarray,
        n_redundant: int,
    ) -> PoseBranch:
        """Tabulate poses (n_bodies, n_pose, n)."""
        theta = np.stack([part.ravel() for part in np.meshgrid(*axes, indexing="ij")], axis=1)
        # one step more, to the last digit: all later poses are interpolated between these
        poses = poses - closure.newton_step(poses, closure.residual(poses, theta))
        rates = closure.rates(poses)
        curvatures = closure.curvatures(poses, rates)
        parts = (np.ascontiguousarray(np.moveaxis(part, -1, 0)) for part in (poses, rates, curvatures))
        return cls(tuple(axes), *parts, winding, False, n_redundant)

    def _closes(self, closure: LoopClosure) -> bool:
        """Return whether the polynomials close the loops everywhere."""
        cells = np.diff(self.axes[0])
        theta = np.concatenate([self.axes[0][:-1] + share * cells for share in PROBES])[:, None]
        return bool(np.max(closure.gap(self.guess(theta), theta)) < SHARE * CLOSURE_TOLERANCE)

    def covers(self, theta: np.ndarray) -> bool:
        """Return whether theta (n, n_theta) are all within the range."""
        return all(np.all((part >= axis[0]) & (part <= axis[-1])) for part, axis in zip(theta.T, self.axes))

    def guess(self, theta: np.ndarray) -> np.ndarray:
        """Return poses (n_bodies, n_pose, n) near the solution at theta (n, n_theta)."""
        guess = self._between(theta[:, 0]) if len(self.axes) == 1 else self._near(theta)
        return np.ascontiguousarray(guess.T).reshape(*self.poses.shape[1:], len(theta))

    @cached_property
    def _quintic(self) -> np.ndarray:
        """Values, first derivatives times the step and second ones times half its square, shape (3, n, n_p)."""
        n, step = len(self.poses), self.axes[0][1] - self.axes[0][0]
        parts = self.poses, self.rates * step, self.curvatures * (0.5 * step**2)
        return np.array([part.reshape(n, -1) for part in parts])

    def _between(self, theta: np.ndarray) -> np.ndarray:
        axis, quintic = self.axes[0], self._quintic
        result = np.empty((theta.size, quintic.shape[2]))
        _hermite(np.ascontiguousarray(theta), axis[0], axis[1] - axis[0], quintic, result)
        return result

    def _near(self, theta: np.ndarray) -> np.ndarray:
        """Continue from the nearest configuration to second order."""
        places = [
            np.clip(np.rint((part - axis[0]) / (axis[1] - axis[0])), 0, axis.size - 1).astype(int)
            for part, axis in zip(theta.T, self.axes)
        ]
        away = theta - np.stack([axis[place] for axis, place in zip(self.axes, places)], axis=1)
        rows = np.ravel_multi_index(places, [axis.size for axis in self.axes])
        first = np.einsum("nbpk,nk->nbp", self.rates[rows], away)
        second = np.einsum("nbpkl,nk,nl->nbp", self.curvatures[rows], away, away)
        return (self.poses[rows] + first + 0.5 * second).reshape(len(theta), -1)


@njit(cache=True, error_model="numpy")
def _hermite(theta, first, step, continued, result):
    """Fill result (n, n_p) with quintic Hermite polynomials through values and derivatives at equal distances.

    `continued` holds values, first derivatives times the step and second ones times half its square, shape (3,
    n_points, n_p).
    """
    for k in range(theta.size):
        position = (theta[k] - first) / step
        cell = min(max(int(position), 0), continued.shape[1] - 2)
        x = position - cell
        y = 1.0 - x
        # seen from its far end, a cell is that of the near one in the mirror
        a, b = y * y * y, x * x * x
        for i in range(result.shape[1]):
            near = continued[0, cell, i] * (1.0 + x * (3.0 + 6.0 * x)) + x * (1.0 + 3.0 * x) * continued[1, cell, i]
            far = (
                continued[0, cell + 1, i] * (1.0 + y * (3.0 + 6.0 * y))
                - y * (1.0 + 3.0 * y) * continued[1, cell + 1, i]
            )
            near += x * x * continued[2, cell, i]
            far += y * y * continued[2, cell + 1, i]
            result[k, i] = a * near + b * far
