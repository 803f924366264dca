"""Following one assembly branch of the rigid mechanism over the whole range of its coordinates.

The range is covered by a tensor grid of configurations. From the assembled one the branch is continued along the first
coordinate, from each of these configurations along the second, and so on, always from neighbour to neighbour with a
linear prediction. Several steps are taken at once: they are guessed from one configuration to second order, and count
as far as Newton's method comes to each of them from its neighbour too. On the way the Jacobian J of closure and
coordinates is watched: where it is singular, loops change their branch or coordinates lose control of the mechanism,
and the range is refused. A change of orientation tells a curve of singular configurations between two neighbours:
``det(J_1^T J_2)`` of their two J is negative. Without redundant constraints that is a change of sign of det J. With
them it is one too, seen in the space of the columns of J, which turns smoothly, through singular configurations as
well; a determinant of chosen rows would not do, as it may change its sign together with the dependence of the rows that
are left out. Around an isolated singular configuration, neighbours on different lines of the continuation come to
different branches.

The assembly branch of a rigid mechanism as a table: poses and their derivatives over the coordinates' range.

Of one coordinate, poses in between come from quintic Hermite polynomials, in steps so small that they close the loops
as well as Newton's method would: the table is then all that is needed to place the mechanism, and a reduced model keeps
it. Of two, and where steps cannot be small enough, it is where Newton's method starts.

Poses of a rigid mechanism with many coordinates: Newton's method along straight lines from where it is assembled.

A grid over four coordinates or more would have too many configurations to follow the assembly branch on, and one over
three has many: a run visits only a line of them. Each configuration is reached over places of a lattice on its line,
which are kept. A place follows from its numbers alone, so that no other configuration has a part in the digits of one.
Poses of an open chain follow from its coordinates along the tree, and nothing is iterated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.declare.records import Record, array, attribute
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.mechanism.closure import CLOSURE_TOLERANCE, SINGULAR_TOLERANCE, LoopClosure
from pgmp_petsc.mechanism.joints import Connection
from pgmp_petsc.mechanism.mechanism import Coordinate
from pgmp_petsc.mechanism.space import PLANE, SPATIAL, cross_matrix

POSES = "m of positions, rad of angles, 1 of directors"
MOST_HALVINGS = 3
MOST_PLACES = 40_000  # of a table over one coordinate; over more each place has more derivatives
PROBES = (0.25, 0.5, 0.75)  # of a cell; polynomials are furthest from the solution in the middle
SHARE = 0.5  # of the closure's tolerance that is left between them
ROUND_OFF = 1e-14  # of the range, by which angles that are taken to the first turn may be outside it
SHARE_OF_GAP = 1e-2  # that poses between them may be open by, where redundant constraints leave a gap


@dataclass(frozen=True, eq=False)
class PoseBranch(Record):
    """Poses and their derivatives on a grid over the coordinates, the last of which runs fastest.

    It is exact where `guess` is as close as a solution everywhere inside the range; `winding` is zero of coordinates
    that are not periodic.
    """

    lower: np.ndarray = attribute("@lower", "coordinate", about="first value of each coordinate, rad or m")
    upper: np.ndarray = attribute("@upper", "coordinate", about="last value of each coordinate, rad or m")
    shape: np.ndarray = attribute("@shape", "coordinate", about="number of values of each, at equal distances")
    is_exact: bool = attribute("@is_exact", about="whether interpolated poses close the mechanism")
    n_redundant: int = attribute("@n_redundant", about="constraints that follow from the others")
    poses: np.ndarray = array("place", "body", "pose", unit=POSES, about="poses of the undeformed bodies")
    rates: np.ndarray = array(
        "place", "body", "pose", "coordinate", unit=f"{POSES}; per rad or m", about="their derivatives with theta"
    )
    curvatures: np.ndarray = array(
        "place", "body", "pose", "coordinate", "coordinate", unit=f"{POSES}; per rad^2 or m^2",
        about="their second derivatives",
    )  # fmt: skip
    winding: np.ndarray = array("coordinate", "body", about="turns of bodies in a turn of a coordinate")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.shape.dtype.kind not in "iu" or np.any(self.shape < 2) or np.prod(self.shape) != len(self.poses):
            raise ValueError(f"kinematics has {len(self.poses)} poses on a grid of {self.shape.tolist()}")
        if not np.isfinite([self.lower, self.upper]).all():
            raise ValueError("kinematics: its range is not finite")

    @cached_property
    def axes(self) -> tuple[np.ndarray, ...]:
        """Values of every coordinate, at equal distances, rad or m."""
        return tuple(np.linspace(lower, upper, n) for lower, upper, n in zip(self.lower, self.upper, self.shape))

    @property
    def steps(self) -> np.ndarray:
        """Distance of the values of every coordinate: of neighbours it would have the round-off of a whole range."""
        return (self.upper - self.lower) / (self.shape - 1)

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
        while (
            not (closes := found._closes(closure)) and n_halved < MOST_HALVINGS and 2 * len(found.poses) < MOST_PLACES
        ):
            n_halved += 1
            theta = np.linspace(axes[0][0], axes[0][-1], 2 * found.axes[0].size - 1)
            poses = closure.close(found.guess(theta[:, None]), theta[:, None])
            found = cls._tabulated(closure, (theta,), poses, winding, n_redundant)
        return replace(found, is_exact=closes)

    @property
    def everywhere(self) -> tuple[np.ndarray, np.ndarray]:
        """Configurations of the table (n, n_theta) and the poses there (n_bodies, n_pose, n)."""
        return tensor_grid(self.axes), np.moveaxis(self.poses, 0, -1)

    @classmethod
    def _tabulated(
        cls, closure: LoopClosure, axes: Sequence[np.ndarray], poses: np.ndarray, winding: np.ndarray, n_redundant: int
    ) -> PoseBranch:
        """Tabulate poses (n_bodies, n_pose, n)."""
        theta, found = tensor_grid(axes), []
        for k in closure.pieces(len(theta)):
            # one step more, to the last digit: all later poses are interpolated between these
            own = closure.corrected(poses[..., k], theta[k])
            rates = closure.rates(own)
            found.append([np.moveaxis(part, -1, 0) for part in (own, rates, closure.curvatures(own, rates))])
        parts = (np.concatenate(part) for part in zip(*found))
        ends, shape = np.array([(axis[0], axis[-1]) for axis in axes]).T, np.array([axis.size for axis in axes])
        return cls(*ends, shape, False, n_redundant, *parts, winding)

    def _closes(self, closure: LoopClosure) -> bool:
        """Return whether the polynomials close the loops everywhere."""
        cells = np.diff(self.axes[0])
        theta = np.concatenate([self.axes[0][:-1] + share * cells for share in PROBES])[:, None]
        return bool(near_enough(*closure.open_and_gap(self.guess(theta), theta)))

    def covers(self, theta: np.ndarray) -> np.ndarray:
        """Return which of theta (n, n_theta) are within the range, but for round-off, shape (n,)."""
        beyond = ROUND_OFF * (self.upper - self.lower)
        return np.all((theta >= self.lower - beyond) & (theta <= self.upper + beyond), axis=1)

    def guess(self, theta: np.ndarray) -> np.ndarray:
        """Return poses (n_bodies, n_pose, n) near the solution at theta (n, n_theta)."""
        guess = self._between(theta[:, 0]) if len(self.axes) == 1 else self._near(theta)
        return np.ascontiguousarray(guess.T).reshape(*self.poses.shape[1:], len(theta))

    @cached_property
    def _quintic(self) -> np.ndarray:
        """Values, first derivatives times the step and second ones times half its square, shape (3, n, n_p)."""
        n, step = len(self.poses), self.steps[0]
        parts = self.poses, self.rates * step, self.curvatures * (0.5 * step**2)
        return np.array([part.reshape(n, -1) for part in parts])

    def _between(self, theta: np.ndarray) -> np.ndarray:
        quintic = self._quintic
        result = np.empty((theta.size, quintic.shape[2]))
        _hermite(np.ascontiguousarray(theta), self.lower[0], self.steps[0], quintic, result)
        return result

    def _near(self, theta: np.ndarray) -> np.ndarray:
        """Continue from the nearest configuration to second order."""
        places = [
            np.clip(np.rint((part - axis[0]) / step), 0, axis.size - 1).astype(int)
            for part, axis, step in zip(theta.T, self.axes, self.steps)
        ]
        away = theta - np.stack([axis[place] for axis, place in zip(self.axes, places)], axis=1)
        rows = np.ravel_multi_index(places, [axis.size for axis in self.axes])
        first = np.einsum("nbpk,nk->bpn", self.rates[rows], away)
        second = np.einsum("nbpkl,nk,nl->bpn", self.curvatures[rows], away, away)
        space = SPATIAL if self.poses.shape[2] == SPATIAL.n_pose else PLANE
        return space.moved(np.moveaxis(self.poses[rows], 0, -1), first + 0.5 * second).reshape(-1, len(theta)).T


def near_enough(apart: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """Return whether polynomials close the loops at the probes in the last axis, from `LoopClosure.open_and_gap`."""
    # with a gap no poses close the loops, and those that come nearest are known to a part of it
    return np.max(apart, axis=-1) < SHARE * (CLOSURE_TOLERANCE + SHARE_OF_GAP * np.max(gap, axis=-1))


def tensor_grid(axes: Sequence[np.ndarray | Sequence[float]]) -> np.ndarray:
    """Return the configurations (n, n_theta) of a tensor grid, the last coordinate fastest."""
    return np.stack([part.ravel() for part in np.meshgrid(*axes, indexing="ij")], axis=1)


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


NEARLY_SINGULAR = 1e-2  # the same, where a bisection ended that may not come closer
SAME_BRANCH = 1e-6  # difference of poses that neighbours agree to
MOST_AT_ONCE = 32  # steps that are guessed from one configuration


class Continuation:
    """Poses of one branch over a tensor grid, first axis first.

    It begins at the assembled configuration, by its numbers along the axes, equidistant values of each coordinate (rad)
    with the ends of its range, and its poses, shape (n_bodies, n_pose, 1). It has configurations `theta`, shape (n,
    n_theta), the last coordinate fastest, `poses` there, shape (n_bodies, n_pose, n), and the number of configurations
    along each axis as `shape`. Raises `InputError` where the mechanism cannot close, or J is singular.
    """

    def __init__(
        self, closure: LoopClosure, axes: Sequence[np.ndarray], start: Sequence[int], poses: np.ndarray
    ) -> None:
        self._closure = closure
        self._axes = tuple(axes)
        self.shape = tuple(axis.size for axis in axes)
        self._steps = np.array([axis[1] - axis[0] for axis in axes])
        first = np.array([[axis[k] for axis, k in zip(axes, start)]])
        front = _Front.begun(closure, first, closure.close(poses, first))
        for axis, place in enumerate(start):
            front = self._along(axis, int(place), front)
        self.theta, self.poses = front.theta, front.poses
        if len(axes) > 1:
            self._check_neighbours()

    def winding(self, axis: int) -> np.ndarray:
        """Return how often every body has turned when a coordinate has made a turn, shape (n_bodies,).

        Raises `InputError` if the mechanism is not back where it began.
        """
        everywhere = self.poses.reshape(*self.poses.shape[:2], *self.shape)
        change = np.take(everywhere, -1, axis + 2) - np.take(everywhere, 0, axis + 2)
        change = change.reshape(*change.shape[:2], -1)
        space = self._closure.mechanism.space
        winding = space.winding(change[..., 0])
        change = space.turned(change, -winding[:, None])
        if np.max(np.abs(change / space.units(self._closure.size)[:, None])) > 1e-8:
            mechanism = self._closure.mechanism
            why, cure = "it moved to another assembly branch", ""
            if mechanism.couplings:
                names = ", ".join(f"joints.{coupling.name}" for coupling in mechanism.couplings)
                why += f", or by {names} a body moved by a part of a turn"
                cure = ", or as coordinate a joint that turns all bodies by whole turns, as the slowest may"
            raise InputError(
                f"coordinates.{mechanism.coordinates[axis].name}.periodic = true: after one turn the mechanism does "
                f"not come back to where it began ({why}); give a range that is not periodic{cure}"
            )
        return winding

    def _along(self, axis: int, place: int, front: _Front) -> _Front:
        """Continue a front in both directions along an axis; return all configurations reached."""
        values, reached = self._axes[axis], {place: front}
        for numbers, way in ((range(place + 1, values.size), 1), (range(place - 1, -1, -1), -1)):
            ahead = 1
            while numbers:
                before = reached[numbers[0] - way]
                fronts = before.continued(values[numbers[:ahead]], axis, self._steps[axis] * way)
                reached.update(zip(numbers, fronts))
                # as many as went well, and as many again
                numbers, ahead = numbers[len(fronts) :], min(2 * len(fronts), MOST_AT_ONCE)
        return _Front.stacked([reached[k] for k in range(values.size)])

    def _check_neighbours(self) -> None:
        """Check that neighbours on different lines of the continuation are on one branch too."""
        closure, n = self._closure, len(self.theta)
        rates = closure.rates(self.poses)
        numbers = np.arange(n).reshape(self.shape)
        for axis in range(len(self.shape) - 1):
            before = np.take(numbers, range(self.shape[axis] - 1), axis).ravel()
            after = np.take(numbers, range(1, self.shape[axis]), axis).ravel()
            change = rates[:, :, axis, before] * self._steps[axis]
            guess = closure.mechanism.space.moved(self.poses[..., before], change)
            found = closure.close(guess, self.theta[after])
            gap = np.abs(found - self.poses[..., after]) / closure.mechanism.space.units(closure.size)[:, None]
            worst = int(np.argmax(gap.max(axis=(0, 1))))
            if gap[..., worst].max() > SAME_BRANCH:
                jacobian = closure.jacobian(self.poses[..., after[[worst]]])
                _refuse_control(closure, self.theta[after[worst]], closure.singular_values(jacobian)[0])


@dataclass(frozen=True, eq=False)
class _Front:
    """Configurations on the branch, none of them singular."""

    closure: LoopClosure
    theta: np.ndarray  # shape (n, n_theta)
    poses: np.ndarray  # shape (n_bodies, n_pose, n)
    jacobian: np.ndarray  # j there, shape (n, n_rows, n_dofs n_bodies)

    @classmethod
    def begun(cls, closure: LoopClosure, theta: np.ndarray, poses: np.ndarray) -> _Front:
        """Return a front at the assembled configuration."""
        jacobian = closure.jacobian(poses)
        values = closure.singular_values(jacobian)
        if values[0, -1] < SINGULAR_TOLERANCE * values[0, 0]:
            _refuse_control(closure, theta[0], values[0])
        return cls(closure, theta, poses, jacobian)

    @classmethod
    def stacked(cls, fronts: Sequence[_Front]) -> _Front:
        """Join fronts along a new axis, which runs fastest."""
        n_theta = fronts[0].theta.shape[1]
        poses = np.stack([front.poses for front in fronts], axis=-1)
        theta = np.stack([front.theta for front in fronts], axis=1).reshape(-1, n_theta)
        jacobian = np.stack([front.jacobian for front in fronts], axis=1)
        jacobian = jacobian.reshape(-1, *jacobian.shape[2:])
        return cls(fronts[0].closure, theta, poses.reshape(*poses.shape[:2], -1), jacobian)

    def continued(self, values: np.ndarray, axis: int, step: float) -> list[_Front]:
        """Return the fronts at the first of the next values (m,) along an axis, `step` apart; one of them at least."""
        closure, n = self.closure, len(self.theta)
        theta = np.tile(self.theta, (1 + len(values), 1))
        theta[n:, axis] = np.repeat(values, n)
        poses, jacobian = self.poses, self.jacobian
        if len(values) > 1:
            rates, space = closure.rates(poses, jacobian), closure.mechanism.space
            bends = closure.curvatures(poses, rates)[:, :, axis, axis]
            away = step * np.arange(1, len(values))
            changes = [rates[:, :, axis] * x + bends * (0.5 * x * x) for x in away]  # to second order
            guesses = np.concatenate([space.moved(poses, one) for one in changes], axis=-1)
            guessed, gap = closure.newton(guesses, theta[n:-n])
            poses = np.concatenate([poses, guessed[..., : n * _leading(gap, n)]], axis=-1)
            jacobian = closure.jacobian(poses)
        guess = closure.mechanism.space.moved(poses, closure.rates(poses, jacobian)[:, :, axis] * step)
        theta = theta[: n + len(jacobian)]
        following, gap = closure.newton(guess, theta[n:])
        closure.require_closed(guess[..., :n], theta[n : 2 * n], gap[:n])
        # what follows from a configuration off the branch does not count
        apart = np.abs(following[..., :-n] - poses[..., n:]) / closure.mechanism.space.units(closure.size)[:, None]
        off_branch = np.concatenate([np.zeros(n), np.max(apart, axis=(0, 1)) > SAME_BRANCH])
        kept = n * _leading(np.where(off_branch, np.inf, gap), n)
        following, theta = following[..., :kept], theta[: n + kept]
        jacobian = np.concatenate([self.jacobian, closure.jacobian(following)])
        poses = np.concatenate([self.poses, following], axis=-1)
        _Front(closure, theta, poses, jacobian)._check(n)
        parts = [slice(k, k + n) for k in range(n, n + kept, n)]
        return [_Front(closure, theta[part], poses[..., part], jacobian[part]) for part in parts]

    def _check(self, n: int) -> None:
        """Refuse singular configurations among all but the first n, and between each and the one n before it."""
        closure, values = self.closure, self.closure.singular_values(self.jacobian[n:])
        lost = values[:, -1] < SINGULAR_TOLERANCE * values[:, 0]
        turned = ~_keeps_orientation(closure, self.jacobian[n:], self.jacobian[:-n])
        for k in np.flatnonzero(lost | turned):
            if lost[k]:
                _refuse_control(closure, self.theta[n + k], values[k])
            self._check_change(k, self.theta[n + k])

    def _check_change(self, k: int, after: np.ndarray) -> None:
        """Bisect for the place on the way to a neighbour where the orientation of J changes.

        It is refused if J is singular there; with redundant constraints its columns may have turned far.
        """
        closure, before, poses, jacobian = self.closure, self.theta[k], self.poses[..., [k]], self.jacobian[[k]]
        # beside a singular configuration orientations are those of round-off: the most singular one met is the place
        place, values = before, closure.singular_values(jacobian)[0]
        for _ in range(30):
            middle = 0.5 * (before + after)
            there = closure.close(poses, middle[None])
            now = closure.jacobian(there)
            met = closure.singular_values(now)[0]
            if met[-1] * values[0] < values[-1] * met[0]:
                place, values = middle, met
            if _keeps_orientation(closure, now, jacobian)[0]:
                before, poses = middle, there
            else:
                after = middle
        n_rows, n_poses = jacobian.shape[1:]
        if n_rows == n_poses or values[-1] < NEARLY_SINGULAR * values[0]:
            _refuse_control(closure, place, values)


def _refuse_control(closure: LoopClosure, theta: np.ndarray, values: np.ndarray) -> None:
    """Refuse a singular configuration (n_theta,) with these singular values, descending."""
    coordinates = closure.mechanism.coordinates
    names = ", ".join(coordinate.name for coordinate in coordinates)
    one = len(coordinates) == 1
    raise InputError(
        f"coordinates.{names}: {'it does' if one else 'they do'} not control the mechanism at "
        f"{closure.describe(theta).partition(' = ')[2] if one else closure.describe(theta)} (smallest "
        f"singular value of the closure {values[-1]:.3g}, largest {values[0]:.3g}); choose another joint or a "
        "range without this configuration"
    )


def _leading(gap: np.ndarray, n: int) -> int:
    """Return how many steps of n configurations each are closed, up to the first that is not; gap has shape (m n,)."""
    closed = np.all(gap.reshape(-1, n) < CLOSURE_TOLERANCE, axis=1)
    return int(np.logical_and.accumulate(closed).sum())


def _keeps_orientation(closure: LoopClosure, jacobian: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return where J has the orientation of another one, both (n, n_rows, n_dofs n_bodies), shape (n,)."""
    product = np.swapaxes(closure.scaled(other), 1, 2) @ closure.scaled(jacobian)
    return np.linalg.slogdet(product)[0] > 0


LONGEST = 0.1  # rad, or of the size, of a step: Newton's method goes from one place to the next in a correction or two
ON_THE_WAY = 1e-2  # of the mechanism's size or of 1 rad: from so near it follows the branch to the next place
MOST_KEPT = 100_000  # places


class Walk:
    """Where a mechanism is assembled, and the way to other configurations, over places of a lattice about it.

    It is assembled at theta (n_theta,), rad, with poses (n_bodies, n_pose, 1); `chain` is the mechanism, where it is an
    open chain.
    """

    def __init__(self, closure: LoopClosure, theta: np.ndarray, poses: np.ndarray) -> None:
        self._closure, self._theta, self._assembled = closure, theta, poses[..., 0]
        self.chain = Chain.of(closure, theta, self._assembled)
        self._steps = LONGEST * closure.scales
        self._kept: dict[tuple[int, ...], np.ndarray] = {}  # poses by the numbers of a place

    @property
    def assembled(self) -> tuple[np.ndarray, np.ndarray]:
        """The configuration where it is assembled, (1, n_theta), and its poses (n_bodies, n_pose, 1)."""
        return self._theta[None], self._assembled[..., None]

    def poses(self, theta: np.ndarray, missing: bool = False) -> np.ndarray:
        """Return the poses (n_bodies, n_pose, n) at configurations (n, n_theta).

        Raises `InputError` if the mechanism cannot be closed somewhere on the way; poses may be `missing` instead, and
        are not a number then.
        """
        if self.chain is not None:
            return self.chain.poses(theta)
        numbers = np.nan_to_num((theta - self._theta) / self._steps, nan=0.0, posinf=0.0, neginf=0.0)
        places = [tuple(place) for place in numbers.astype(int).tolist()]
        self._go_to(places, missing)
        begun = np.array([self._at(place) for place in places]).reshape(len(places), *self._assembled.shape)
        return self._closure.close(np.moveaxis(begun, 0, -1), theta, missing=missing)

    def _at(self, place: tuple[int, ...]) -> np.ndarray:
        """Return the poses at a place that was reached, (n_bodies, n_pose)."""
        return self._kept[place] if any(place) else self._assembled

    def _go_to(self, places: list[tuple[int, ...]], missing: bool) -> None:
        """Reach places, but for those that may be `missing`, each from the one before it on the straight line from the
        assembled configuration."""
        if len(self._kept) > MOST_KEPT:
            self._kept.clear()
        before: dict[int, dict[tuple[int, ...], tuple[int, ...]]] = {}  # of places to be reached, by their distance
        for place in places:
            while any(place) and not (place in self._kept and (missing or np.isfinite(self._kept[place]).all())):
                far = max(map(abs, place))
                if place in before.setdefault(far, {}):
                    break
                before[far][place] = place = tuple(round(k * (far - 1) / far) for k in place)
        for far in sorted(before):
            theta = self._theta + self._steps * np.array(list(before[far]))
            begun = np.stack([self._at(one) for one in before[far].values()], axis=-1)
            reached = self._closure.close(begun, theta, tolerance=ON_THE_WAY, missing=missing)
            self._kept.update(zip(before[far], np.moveaxis(reached, -1, 0)))


@dataclass(frozen=True, eq=False)
class Link:
    """A body of an open chain, and the joint that moves it on the one before."""

    body: int
    on: int  # the body before it, -1 for the ground
    columns: tuple[int, int]  # of the coordinates that it turns and slides by, -1 where it does not
    sign: float  # -1 where coordinates measure how the body before it moves
    axis: np.ndarray  # in the frame of the body before it, shape (d,)
    spin: np.ndarray  # the cross product with it, in the plane a right angle's rotation, shape (d, d)
    rest: np.ndarray  # directors in the frame of the body before it, as assembled, one a column, shape (d, d)
    at: np.ndarray  # from that frame to the joint, as assembled, shape (d,), m
    arm: np.ndarray  # from the body's own frame to there, shape (d,), m


class Chain:
    """Poses of an open chain as a function of its coordinates, along the tree of its joints, without an iteration.

    A body turns about the axis of its joint, and slides along it, from where it is assembled.
    """

    def __init__(self, closure: LoopClosure, theta: np.ndarray, assembled: np.ndarray) -> None:
        self._space, self._theta, self._assembled = closure.mechanism.space, theta, assembled
        reached, links = {-1}, []
        waiting = list(closure.mechanism.connections)
        while waiting:
            one = next((c for c in waiting if (c.a.body in reached) != (c.b.body in reached)), None)
            if one is None:
                break
            waiting.remove(one)
            links.append(self._link(one, closure.mechanism.coordinates, one.b.body in reached))
            reached.add(links[-1].body)
        self._links = links
        used = [column for link in links for column in link.columns if column >= 0]
        self.whole = len(links) == len(assembled) and sorted(used) == list(range(theta.size))

    @classmethod
    def of(cls, closure: LoopClosure, theta: np.ndarray, assembled: np.ndarray) -> Chain | None:
        """Return the chain that a mechanism is; None where poses of other coordinates do not close it."""
        chain = cls(closure, theta, assembled)
        if not chain.whole:
            return None
        other = theta[None] + np.random.default_rng(0).uniform(0.1, 0.5, (1, theta.size)) * closure.scales
        return chain if closure.open_and_gap(chain.poses(other), other)[0][0] < CLOSURE_TOLERANCE else None

    def _link(self, joint: Connection, coordinates: Sequence[Coordinate], backwards: bool) -> Link:
        sides = (joint.b, joint.a) if backwards else (joint.a, joint.b)
        columns = [-1, -1]
        for column, coordinate in enumerate(coordinates):
            if coordinate.connection is joint:
                columns[0 if coordinate.turns else 1] = column
        (place, before), (own, after) = (self._frame(side.body, self._assembled) for side in sides)
        axis = joint.axes[int(backwards)][:, 0]
        spin = np.array([[0.0, -1.0], [1.0, 0.0]]) if axis.size == 2 else cross_matrix(axis)
        at = before @ (own + sides[1].point @ after - place)
        sign = -1.0 if backwards else 1.0
        return Link(
            sides[1].body, sides[0].body, tuple(columns), sign, axis, spin, before @ after.T, at, sides[1].point
        )

    def _frame(self, body: int, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return position (d, ...) and directors (d, d, ...) of a body or the ground at poses (n_bodies, n_pose,
        ...)."""
        d, pose = self._space.dimension, self._space.identity if body < 0 else poses[body]
        natural = self._space.natural(pose)
        natural = natural.reshape(len(natural), *(1,) * (poses.ndim - natural.ndim - 1), *natural.shape[1:])
        return natural[:d], natural[d:].reshape(d, d, *natural.shape[1:])

    def poses(self, theta: np.ndarray) -> np.ndarray:
        """Return the poses (n_bodies, n_pose, n) at configurations (n, n_theta)."""
        moved, found = (theta - self._theta).T, np.empty((*self._assembled.shape, len(theta)))
        for link in self._links:
            turn, way = (link.sign * moved[column] if column >= 0 else np.zeros(len(theta)) for column in link.columns)
            place, axes = self._frame(link.on, found)
            spun = np.multiply.outer(link.spin, np.sin(turn)) + np.multiply.outer(
                link.spin @ link.spin, 1 - np.cos(turn)
            )
            turned = np.einsum("ijn,jk->ikn", np.eye(len(link.axis))[..., None] + spun, link.rest)
            directors = (turned[:, :, None] * axes[:, None]).sum(axis=0)
            at = link.at[:, None] + np.multiply.outer(link.axis, way)
            place = place + (at[:, None] * axes).sum(axis=0) - np.einsum("k,kcn->cn", link.arm, directors)
            if len(place) == 3:
                found[link.body] = np.concatenate([place, directors.reshape(9, -1)])
            else:
                before = 0.0 if link.on < 0 else found[link.on, 2] - self._assembled[link.on, 2]
                found[link.body] = np.concatenate([place, [self._assembled[link.body, 2] + before + turn]])
        return found
