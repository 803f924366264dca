"""Rigid kinematics: poses of the undeformed bodies over the independent coordinates.

``rho(theta)`` of Naets et al. 2015, eq. (4): the poses solve the equations of `closure`; their assembly branch is
followed over the whole range once (`continuation`), and every later call starts Newton's method from there.

Whole turns of a joint's angle in space, where directors alone tell an angle up to turns.

The angle of a coordinate is the one that is nearest to the coordinate. That of another joint depends on where the
mechanism stands: it is the one nearest to a line over the coordinates,

    offset + sum_k slope_k theta_k,

which stays as close as can be to the joint's angle on the rigid mechanism, followed over the range. The slope of a
periodic coordinate is the number of turns in one of its own, so that the angle counts for as long as the mechanism
turns. No state has to remember turns.
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import scipy

from pgmp_petsc.base.errors import InputError, Remark, note
from pgmp_petsc.mechanism.closure import SINGULAR_TOLERANCE, LoopClosure, ReleasedClosure, size_of
from pgmp_petsc.mechanism.constraint_set import ConstraintSet
from pgmp_petsc.mechanism.continuation import MOST_PLACES, Continuation, PoseBranch, Walk
from pgmp_petsc.mechanism.joints import Attachment, Connection, triad
from pgmp_petsc.mechanism.mechanism import Coordinate, Mechanism, Unknowns, words_of
from pgmp_petsc.mechanism.pose_patches import PosePatches
from pgmp_petsc.mechanism.space import SPATIAL, Space
from pgmp_petsc.mechanism.statements import Statement
from pgmp_petsc.scene.joints import MEASURED

# rad, or of the mechanism's size; Newton's method converges from a linear prediction over far larger steps
FINE_STEP = 0.02
STEPS = (FINE_STEP, 0.1, 0.2)  # by the number of coordinates: of a tensor grid in wider ones
LEAST_STEPS, MOST_STEPS = 8, 5000
FURTHEST_TURN = 0.3  # rad of a body in space, from one place of the table to the next
MOST_COORDINATES = len(STEPS)  # whose range can be covered by a grid
MOST_FOLLOWED = 2  # coordinates that are followed over their range whatever the model
FURTHEST = 1e6  # rad that a coordinate turns; beyond, round-off shows in where it stands, and runs have run away
MOST_KEPT = 16  # branches that were followed
COUNTING_STEP = 1e-4  # rad or m of a coordinate, with which rates of angles are found: within half a turn at 30,000 : 1
REACH = 0.05  # rad, or of the mechanism's size, beyond a limited range: the bending of a joint's node at its end


_KEPT: dict[bytes, PoseBranch] = {}  # the branches that were followed last, by all that decides about them


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """The rigid mechanism at one configuration."""

    poses: np.ndarray  # shape (n_bodies, n_pose)
    rates: np.ndarray  # ``dP/dtheta_k``, shape (n_bodies, n_pose, n_theta)
    curvatures: np.ndarray  # ``d2P/dtheta_k dtheta_l``, shape (n_bodies, n_pose, n_theta, n_theta)
    #: velocities, accelerations: coefficients of the linear fields ``d rho/d theta_k`` and ``d2 rho/d theta_k d
    #: theta_l`` (`Space`), shapes (n_bodies, d + d^2, n_theta) and (n_bodies, d + d^2, n_theta, n_theta)
    velocities: np.ndarray
    accelerations: np.ndarray
    #: as the velocities, of what elastic joints allow with theta held, shape (n_bodies, d + d^2, n_released)
    released: np.ndarray


class RigidKinematics:
    """Rigid motion of a mechanism over the range of its independent coordinates.

    Configurations theta have the shape (n, n_theta); (n,) will do for one coordinate. The branch of one or two
    coordinates, and of three where a model is built on their grid (`over_range`), is followed over their whole range,
    unless it is given, as a reduced model keeps it; otherwise configurations are reached from the first one (`Walk`).

    The mechanism is assembled near its first guess: at the lower end of one coordinate, of two at the configuration
    nearest to the first guess, or else at their lower ends or the middle of their range; of more where the bodies meet
    next to the first guess. `size` is a typical length, m; `n_redundant` counts constraints that follow from the
    others; `branch` is None where none was followed.

    Raises `InputError` if the mechanism cannot be closed somewhere in the range, if the number of coordinates is not
    its number of degrees of freedom, or if the coordinates lose control of it (singular J).
    """

    def __init__(self, mechanism: Mechanism, branch: PoseBranch | None = None, over_range: bool = False) -> None:
        self.mechanism = mechanism
        self.coordinates = mechanism.coordinates
        self.size = size_of(mechanism)
        self.branch, self._walk = branch, None
        if branch is None and (over_range or self.n_coordinates <= MOST_FOLLOWED):
            self.branch = self._continued()
        if self.branch is None:
            near = self._closure.closed_freely(self.mechanism.first_guess[:, :, None])
            theta = self._closure.measured(near).T
            assembled = self._closure.close(near, theta)
            self._walk = Walk(self._closure, theta[0], assembled)
            self.n_redundant = self._check_count(assembled)
        else:
            self.n_redundant = self.branch.n_redundant
        self._patches = PosePatches(self.branch) if self._is_smooth() else None
        self._followed: dict[bytes, RigidMotion] = {}

    @property
    def n_coordinates(self) -> int:
        """Number of independent rigid coordinates n_theta."""
        return len(self.mechanism.coordinates)

    def held(self) -> RigidKinematics:
        """Return the kinematics of the same mechanism with every coordinate prescribed."""
        other = copy(self)
        coordinates = tuple(replace(coordinate, prescribed=True) for coordinate in self.coordinates)
        other.mechanism = replace(self.mechanism, coordinates=coordinates)
        other.__dict__.pop("constraints", None)
        return other

    def of_bodies(self, mechanism: Mechanism) -> RigidKinematics:
        """Return the kinematics of the same mechanism with bodies that deform where these are rigid, or the reverse."""
        if [body.name for body in mechanism.bodies] != [body.name for body in self.mechanism.bodies]:
            return RigidKinematics(mechanism)  # masses on rigid bodies are bodies of their own: nothing can be shared
        other = copy(self)
        other.mechanism, other.coordinates = mechanism, mechanism.coordinates
        for made in ("_closure", "_released", "constraints"):
            other.__dict__.pop(made, None)
        return other

    @cached_property
    def remarks(self) -> tuple[Remark, ...]:
        """What redundant constraints miss each other by, where they do not agree to the last digit."""
        theta, poses = self._walk.assembled if self.branch is None else self.branch.everywhere
        missed = self._closure.missed(poses, theta)
        said = f"{missed}: redundant constraints do not agree, and loops are closed in least squares"
        return (note(said),) if missed else ()

    @cached_property
    def constraints(self) -> ConstraintSet:
        return ConstraintSet(Unknowns(self.mechanism))

    @cached_property
    def _closure(self) -> LoopClosure:
        return LoopClosure(self.mechanism)

    @cached_property
    def _released(self) -> ReleasedClosure:
        return ReleasedClosure(self._closure)

    def _continued(self) -> PoseBranch:
        """Follow the assembly branch over the range; models of one scene, and of scenes that move alike, share it."""
        axes = [self._axis(coordinate) for coordinate in self.coordinates]
        key = pickle.dumps((self._closure.equations, self.mechanism.first_guess, axes))
        if key not in _KEPT:
            start, assembled = self._assemble(axes)
            n_redundant = self._check_count(assembled)
            start, axes = self._finer(start, axes, assembled)
            continued = Continuation(self._closure, axes, start, assembled)
            _KEPT[key] = PoseBranch.of(self._closure, continued, axes, n_redundant)
            if len(_KEPT) > MOST_KEPT:
                del _KEPT[next(iter(_KEPT))]
        return _KEPT[key]

    def follow(self, theta: np.ndarray) -> None:
        """Compute the motion at configurations (n, n_theta) together, for `motion` to be asked one by one."""
        theta = self.configurations(theta)
        poses = self.poses(theta)
        rates = self.rates(poses)
        curvatures = self.curvatures(poses, rates)
        space = self.mechanism.space
        velocities = np.array([space.velocity_field(*own) for own in zip(poses, rates)])
        released = np.array([space.velocity_field(*own) for own in zip(poses, self._released.rates(poses))])
        accelerations = np.array([space.acceleration_field(*own) for own in zip(poses, rates, curvatures)])
        everything = (poses, rates, curvatures, velocities, accelerations, released)
        parts = zip(*(np.ascontiguousarray(np.moveaxis(part, -1, 0)) for part in everything))
        self._followed.update((one.tobytes(), RigidMotion(*part)) for one, part in zip(theta, parts))

    @property
    def carries(self) -> np.ndarray:
        """Whether released motions carry along what is on their joints, (n_released,), once a motion was asked for."""
        return self._released.carries

    def unheld(self, theta: np.ndarray, stiff: Sequence[bool]) -> int | None:
        """Return the number of a released direction that nothing stiff holds at a configuration (n_theta,), in the
        order of `Connection.released` and elastic couplings; None where there is none."""
        return self._released.unheld(self.poses(self.configurations(theta)), np.array(stiff, dtype=bool))

    def motion(self, theta: np.ndarray) -> RigidMotion:
        """Return the motion at one configuration (n_theta,)."""
        key = np.asarray(theta, dtype=float).tobytes()
        if key not in self._followed:
            self.follow(theta)
        return self._followed[key]

    def configurations(self, theta: np.ndarray | Sequence[float]) -> np.ndarray:
        """Return configurations as an array (n, n_theta)."""
        return np.asarray(theta, dtype=float).reshape(-1, self.n_coordinates)

    def describe(self, theta: np.ndarray) -> str:
        """Name a configuration (n_theta,), for messages: ``theta = 0.1 rad``."""
        return words_of(self.coordinates, np.atleast_1d(theta))

    def poses(self, theta: np.ndarray, missing: bool = False) -> np.ndarray:
        """Solve the rigid closure: return the poses of all bodies, shape (n_bodies, n_pose, n), at coordinates (n,
        n_theta), rad or m, inside the range where a coordinate is not periodic.

        Raises `InputError` where loops cannot close; poses may be `missing` instead, and are not a number there. Over
        more than two coordinates nobody has followed the range, and a flexible mechanism goes where the rigid one
        cannot.
        """
        theta = self.configurations(theta)
        if self._walk is not None:
            return self._walk.poses(theta, missing)
        turns = self._turns(theta)
        inside = theta - 2 * np.pi * turns
        poses, closed = self._interpolated(inside, 1)
        poses = poses[0]
        if not closed.all():
            poses[..., ~closed] = self._closure.close(poses[..., ~closed], inside[~closed], missing=missing)
        return self.mechanism.space.turned(poses, np.einsum("kb,nk->bn", self.branch.winding, turns))

    def near(
        self, theta: np.ndarray, poses: np.ndarray, order: Literal[1, 2] = 1
    ) -> Callable[[np.ndarray], np.ndarray]:
        """Return what gives poses next to known ones, for central differences of what is made of poses: from
        configurations (n, n_theta), one next to each, to poses (n_bodies, n_pose, n).

        Where a table closes the loops these are `poses`; otherwise they lie on the tangents, and no loop is closed
        again: both sides then miss the same, of second order, which first differences do not see. Of second `order`
        they lie on parabolas, of which first and second differences are those of the poses.

        Known are configurations (n, n_theta), rad, with poses from `poses`, shape (n_bodies, n_pose, n); not a number
        where they are not known, and then next to them neither.
        """
        theta = self.configurations(theta)
        if (
            self._patches is None
            and self.branch is not None
            and self._is_tabulated(theta - 2 * np.pi * self._turns(theta))
        ):
            return self.poses
        known = np.isfinite(poses).all(axis=(0, 1))
        r = self.n_coordinates
        rates, bends = (np.full((*poses.shape[:2], *own, len(theta)), np.nan) for own in ((r,), (r, r)))
        rates[..., known], bends[..., known] = self._changes(theta[known], poses[..., known], order)

        def beside(there: np.ndarray) -> np.ndarray:
            away = self.configurations(there) - theta
            slopes = rates if order == 1 else rates + 0.5 * np.einsum("bpkln,nl->bpkn", bends, away)
            return poses + np.einsum("bpkn,nk->bpn", slopes, away)

        return beside

    def _changes(self, theta: np.ndarray, poses: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
        """Return `rates` and, of second order, `curvatures` at configurations (n, n_theta) and their poses."""
        if self._patches is None:
            rates = self.rates(poses)
            return rates, self.curvatures(poses, rates) if order == 2 else np.nan
        found, closed = self._interpolated(theta - 2 * np.pi * self._turns(theta), 6)
        rates, bends = np.moveaxis(found[1:3], 0, 2), np.moveaxis(found[[[3, 4], [4, 5]]], (0, 1), (2, 3))
        if not closed.all():
            rates[..., ~closed] = self.rates(poses[..., ~closed])
            bends[..., ~closed] = self.curvatures(poses[..., ~closed], rates[..., ~closed])
        return rates, bends

    def _interpolated(self, inside: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
        """Return poses at configurations taken to the first turn, with derivatives if n is 6, and where they close the
        loops; see `PosePatches.at`."""
        if self._patches is None:
            return self.branch.guess(inside)[None], np.full(len(inside), self._is_tabulated(inside))
        covered, closed = self.branch.covers(inside), np.zeros(len(inside), dtype=bool)
        found = np.empty((n, *self.branch.poses.shape[1:], len(inside)))
        found[..., covered], closed[covered] = self._patches.at(self._closure, inside[covered], n)
        if not closed.all():
            found[0][..., ~closed] = self.branch.guess(inside[~closed])
        return found, closed

    def _turns(self, theta: np.ndarray) -> np.ndarray:
        """Return how often periodic coordinates have turned at theta, both (n, n_theta)."""
        lower, periodic = np.array([(c.lower, c.periodic) for c in self.coordinates]).T
        return np.where(periodic, np.floor((theta - lower) / (2 * np.pi)), 0.0)

    def _is_tabulated(self, inside: np.ndarray) -> bool:
        """Return whether the branch closes the loops at all configurations, taken to the first turn."""
        return self.branch.is_exact and bool(self.branch.covers(inside).all())

    def rates(self, poses: np.ndarray) -> np.ndarray:
        """Return ``dP/dtheta_k`` at poses (n_bodies, n_pose, n), shape (n_bodies, n_pose, n_theta, n)."""
        return self._closure.rates(poses)

    def jets(self, poses: np.ndarray, motion: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return the derivatives over time of poses, as of `LoopClosure.jets`."""
        return self._closure.jets(poses, motion)

    def turning(self, poses: np.ndarray) -> np.ndarray:
        """Return by how much bodies turn with each coordinate, at that of poses (n_bodies, n_pose, n) where they turn
        most, shape (n_bodies, n_theta), rad per rad or m."""
        return self._turns_of(self.rates(poses)).max(axis=-1)

    def _turns_of(self, rates: np.ndarray) -> np.ndarray:
        """Return how far bodies turn with each coordinate, shape (n_bodies, n_theta, n), rad per rad or m."""
        return np.stack([self.mechanism.space.turns(rates[:, :, k]) for k in range(self.n_coordinates)], axis=1)

    def curvatures(self, poses: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return ``d2P/dtheta_k dtheta_l``, (n_bodies, n_pose, n_theta, n_theta, n), from poses and their rates."""
        return self._closure.curvatures(poses, rates)

    def within_reach(self, theta: np.ndarray) -> np.ndarray:
        """Return where the rigid mechanism can be placed, shape (...): at theta (..., n_theta) in the range, or a
        little (`REACH`) outside it, of periodic coordinates up to `FURTHEST`."""
        reach = [FURTHEST if c.periodic else REACH * c.scale(self.size) for c in self.coordinates]
        ends = [(0.0, 0.0) if c.periodic else (c.lower, c.upper) for c in self.coordinates]
        lower, upper = np.array(ends).T + [np.negative(reach), reach]
        return np.all((theta >= lower) & (theta <= upper), axis=-1)

    def _axis(self, coordinate: Coordinate) -> np.ndarray:
        step = STEPS[self.n_coordinates - 1] * coordinate.scale(self.size)
        n = max(LEAST_STEPS, int(np.ceil((coordinate.upper - coordinate.lower) / step)))
        # an angle's range is looked at with the scene; a rail may be long, and on it little changes
        n = n if coordinate.turns else min(n, MOST_STEPS)
        return np.linspace(coordinate.lower, coordinate.upper, n + 1)

    def _finer(
        self, start: list[int], axes: list[np.ndarray], assembled: np.ndarray
    ) -> tuple[list[int], list[np.ndarray]]:
        """Return numbers of the first configuration and axes on which no body in space turns far from one value of a
        coordinate to the next, as a spindle does: in between the table has polynomials of directors. A table over more
        than two coordinates would be large, and is where Newton's method starts."""
        if self.mechanism.space is not SPATIAL or len(axes) > 2:
            return start, axes
        turns = self.turning(assembled).max(axis=0) * [axis[1] - axis[0] for axis in axes]
        parts = [max(int(np.ceil(turn / FURTHEST_TURN)), 1) for turn in turns]
        while max(parts) > 1 and math.prod(a.size * n for a, n in zip(axes, parts)) > MOST_PLACES / len(axes) ** 2:
            parts = [-(-n // 2) if n == max(parts) else n for n in parts]
        fine = [np.linspace(axis[0], axis[-1], (axis.size - 1) * n + 1) for axis, n in zip(axes, parts)]
        return [number * n for number, n in zip(start, parts)], fine

    def _is_smooth(self) -> bool:
        """Return whether over two coordinates polynomials over several places of the table come to the poses in
        between: where two motors turn quickly more of them are needed than anyone asks poses for. Bodies that do near
        singular configurations alone leave them where they are."""
        if self.branch is None or self.n_coordinates != 2:
            return False
        if self.mechanism.space is not SPATIAL:
            return True
        turns = np.median(self._turns_of(np.moveaxis(self.branch.rates, 0, -1)), axis=-1) * self.branch.steps
        return bool(np.all(turns <= 2.0 * FURTHEST_TURN))

    def _assemble(self, axes: Sequence[np.ndarray]) -> tuple[list[int], np.ndarray]:
        """Return the numbers of the first configuration along the axes, and the poses there."""
        guess, failure = self.mechanism.first_guess[:, :, None], None
        for place in self._places(axes):
            theta = np.array([[axis[k] for axis, k in zip(axes, place)]])
            try:
                return place, self._closure.close(guess, theta, placed=True)
            except InputError as error:
                failure = failure or error
        # two coordinates of a mechanism with one degree of freedom close nowhere: the count says why
        self._check_count(self._closure.closed_freely(guess))
        raise failure

    def _places(self, axes: Sequence[np.ndarray]) -> list[list[int]]:
        """Return the configurations at which to try the assembly, by their numbers along the axes."""
        lowest, nearest = [0] * len(axes), []
        for coordinate, axis, value in zip(
            self.coordinates, axes, self._closure.measured(self.mechanism.first_guess[:, :, None])[:, 0]
        ):
            if coordinate.periodic:
                value = coordinate.lower + (value - coordinate.lower) % (2 * np.pi)
            nearest.append(int(np.argmin(np.abs(axis - value))))
        if len(axes) == 1 and not self.mechanism.couplings:
            return [lowest, nearest]
        # what is coupled may be many turns away at the end of the range
        return [nearest, lowest, [axis.size // 2 for axis in axes]]

    def _check_count(self, poses: np.ndarray) -> int:
        """Compare the number of coordinates with the degrees of freedom at the assembled configuration.

        Returns the number of constraints that follow from the others.
        """
        space, n_bodies = self.mechanism.space, len(self.mechanism.bodies)
        n_poses = space.n_dofs * n_bodies
        rank = self._rank(poses)
        if n_poses - rank != self.n_coordinates:
            moved = np.random.default_rng(0).normal(scale=0.1, size=poses.shape)
            moved[:, : space.dimension] *= self.size
            # whether near these there are other poses, at which the mechanism is closed and may go on; best effort
            if rank < n_poses - self.n_coordinates == self._rank(self._closure.closed_freely(poses + moved)):
                where = np.round(self._closure.measured(poses)[:, 0], 9) + 0.0  # assembled to less
                raise InputError(
                    f"joints: at {self.describe(where)} the rigid mechanism is in a "
                    f"singular position, where it has {n_poses - rank} degrees of freedom and may go on in several "
                    f"ways; elsewhere it has {self.n_coordinates}, as many as coordinates were named. Let the range of "
                    "the coordinate leave it out, or choose lengths that do not let links fall into one line"
                )
            crooked = self._closure.crooked(poses, n_poses - self.n_coordinates)
            if crooked:
                raise InputError(crooked)
            names = ", ".join(coordinate.name for coordinate in self.coordinates)
            free = f"{n_poses - rank} degree{'' if n_poses - rank == 1 else 's'} of freedom"
            named = "1 coordinate was" if self.n_coordinates == 1 else f"{self.n_coordinates} coordinates were"
            more = self._left_loose(poses) if n_poses - rank > self.n_coordinates else ""
            if n_poses - self.mechanism.n_constraints == self.n_coordinates:
                why = "some follow from others, as where links fall into one line: choose other lengths or placements"
                more = f". All {self.mechanism.n_constraints} would leave as many as were named, but {why}{more}"
            if n_poses == rank:
                more = ". What bends alone, as a stage on leaf springs, takes a rigid body beside it, on a joint whose "
                more += "motion is the coordinate and prescribed"
            raise InputError(
                f"joints: they leave the rigid mechanism {free} ({n_poses} of its {n_bodies} bodies less "
                f"{rank} independent constraints), but {named} named: {names}. Both numbers must be equal{more}"
            )
        return self.mechanism.n_constraints - rank

    def _left_loose(self, poses: np.ndarray) -> str:
        """Say which bodies can move while all others, and the coordinates, rest, and what holds them; empty if none."""
        jacobian, n_dofs = self._closure.scaled(self._closure.jacobian(poses))[0], self.mechanism.space.n_dofs
        texts = []
        for number, body in enumerate(self.mechanism.bodies):
            values = np.linalg.svd(jacobian[:, number * n_dofs : (number + 1) * n_dofs], compute_uv=False)
            if values[-1] > SINGULAR_TOLERANCE * values[0]:
                continue
            own = [c for c in self.mechanism.connections if number in (c.a.body, c.b.body)]
            names = " and ".join(c.name for c in own)
            cures = self._without_spin(own, poses) if len(own) == 2 else [""]
            if all(cures):
                texts.append(
                    f"{body.name} can spin idly about the line through its joints {names}: make one of them a joint "
                    f"that holds the spin: joints.{own[1].name}: {cures[1]}"
                )
            else:
                where = f"in {names}" if names else "as no joint is on it"
                texts.append(f"{body.name} can move by itself {where}: name a coordinate for it, or join it otherwise")
        return "".join(f". {text}" for text in texts or self._on_no_ground() or self._unnamed(poses))

    def _unnamed(self, poses: np.ndarray) -> list[str]:
        """Say which motions of joints go on while the coordinates rest: each could be a coordinate."""
        joints, dimension = self.mechanism.scene.joints, self.mechanism.space.dimension
        of_scene = [one for one in self.mechanism.connections if one.name in joints]  # others hold masses
        found = [
            (one, motion) for one in of_scene for motion in joints[one.name].motions_in(dimension)
            if motion in MEASURED
        ]  # fmt: skip
        moves = self._closure.moving([(one.measure(motion), one.sides) for one, motion in found], poses)
        names = ", ".join(f"{one.name} ({motion})" for (one, motion), moved in zip(found, moves) if moved)
        return [f"Motions that go on while these rest: {names}"] if names else []

    def _on_no_ground(self) -> list[str]:
        """Say which bodies are joined to others, and none of them to the ground."""
        n = len(self.mechanism.bodies)
        one, other = np.array([[side.body % (n + 1) for side in c.sides] for c in self.mechanism.connections]).T
        graph = scipy.sparse.coo_array((np.ones(one.size), (one, other)), shape=(n + 1, n + 1))
        _, groups = scipy.sparse.csgraph.connected_components(graph)
        texts = []
        for group in np.setdiff1d(groups, groups[n:]):
            names = [self.mechanism.bodies[k].name for k in np.flatnonzero(groups[:n] == group)]
            texts.append(
                f"{' and '.join(names)} are joined to each other alone: what stands on springs has a joint that is "
                'elastic, such as type = "fixed" with elastic.stiffness, and is locked there for the count'
            )
        return texts

    def _without_spin(self, own: Sequence[Connection], poses: np.ndarray) -> list[str]:
        """Return the entries of joints in the places of two, empty where they hold the spin of their body about the
        line through both as assembled."""
        entries = [self.mechanism.scene.joints.get(c.name) for c in own]
        if None in entries or self.mechanism.space is not SPATIAL:
            return [""]
        one, other = (c.b.frame_of_pose(poses)[:3, 0] for c in own)
        if not np.any(other - one):
            return [""]
        across = triad(other - one)[:, 1:]
        frames = (c.a.frame_of_pose(poses)[3:12, 0].reshape(3, 3) for c in own)  # one director a row
        return [entry.without_spin(frame @ across) for entry, frame in zip(entries, frames)]

    def _rank(self, poses: np.ndarray) -> int:
        """Return the number of independent constraints by joints at poses (n_bodies, n_pose, 1)."""
        rows = slice(self._closure.n_constraints)
        values = self._closure.singular_values(self._closure.jacobian(poses)[:, rows])[0]
        return int(np.sum(values > SINGULAR_TOLERANCE * values[0])) if values.size else 0


def measured(
    space: Space, statement: Statement, sides: Sequence[Attachment], poses: np.ndarray, turned: np.ndarray | float = 0.0
) -> np.ndarray:
    """Return a statement between two sides at poses (n_bodies, n_pose, n), shape (n,); see `Space.measure`."""
    return space.measure(statement, *(side.frame_of_pose(poses) for side in sides), turned)


def turns_counted(
    angle: Statement, sides: Sequence[Attachment], poses: np.ndarray, rates: np.ndarray, axes: Sequence[np.ndarray]
) -> np.ndarray:
    """Return an angle in space over a grid of configurations, of the grid's shape, with its turns counted: from one to
    the next it changes about as its rates there say, behind a gear by many turns.

    It is that between two sides at poses (n_bodies, n_pose, n) with rates (n_bodies, n_pose, n_theta, n).
    """
    found = measured(SPATIAL, angle, sides, poses)
    moved = (SPATIAL.moved(poses, COUNTING_STEP * rates[:, :, k]) for k in range(len(axes)))
    slopes = [(measured(SPATIAL, angle, sides, one, found) - found) / COUNTING_STEP for one in moved]
    found = found.reshape([axis.size for axis in axes])
    for k, (axis, slope) in enumerate(zip(axes, slopes)):
        along, slope = np.moveaxis(found, k, -1), np.moveaxis(slope.reshape(found.shape), k, -1)
        expected = 0.5 * (slope[..., 1:] + slope[..., :-1]) * np.diff(axis)
        turns = np.rint((np.diff(along) - expected) / (2.0 * np.pi))
        along = np.concatenate([along[..., :1], along[..., 1:] - 2.0 * np.pi * np.cumsum(turns, axis=-1)], axis=-1)
        found = np.moveaxis(along, -1, k)
    return found


@dataclass(frozen=True, eq=False)
class JointTurns:
    """The line that a joint's angle in space is near to: offset, rad, and slopes (n_theta,)."""

    offset: float
    slopes: np.ndarray

    @classmethod
    def of(cls, connection: Connection, kinematics: RigidKinematics, start: np.ndarray) -> JointTurns:
        """Return that of a joint, whose angle is in (-pi, pi] where the mechanism starts, theta (n_theta,).

        Where no branch was followed, the angle of a joint that is no coordinate stays in (-pi, pi].
        """
        n = kinematics.n_coordinates
        for k, coordinate in enumerate(kinematics.coordinates):
            if coordinate.statement is connection.angle:
                return cls(0.0, np.eye(n)[k])
        if kinematics.branch is None:
            return cls(0.0, np.zeros(n))
        branch = kinematics.branch
        axes, poses, rates = branch.axes, np.moveaxis(branch.poses, 0, -1), np.moveaxis(branch.rates, 0, -1)
        angles = turns_counted(connection.angle, connection.sides, poses, rates, axes)
        theta = np.meshgrid(*axes, indexing="ij")
        slopes = np.zeros(n)
        for k, (axis, coordinate) in enumerate(zip(axes, kinematics.coordinates)):
            rise = np.mean(np.take(angles, -1, axis=k) - np.take(angles, 0, axis=k))
            turns = np.rint(rise / (2.0 * np.pi)) * 2.0 * np.pi if coordinate.periodic else rise
            slopes[k] = turns / (axis[-1] - axis[0])
        rest = angles - sum(slope * part for slope, part in zip(slopes, theta))
        offset = 0.5 * (rest.max() + rest.min())
        first = measured(SPATIAL, connection.angle, connection.sides, kinematics.poses(start[None]))[0]
        whole = np.rint((offset + slopes @ start - first) / (2.0 * np.pi))
        return cls(float(offset - 2.0 * np.pi * whole), slopes)

    def near(self, theta: np.ndarray) -> np.ndarray:
        """Return what the angle is near to, shape (...), at coordinates (n_theta, ...), rad."""
        return self.offset + np.tensordot(self.slopes, theta, axes=1)
