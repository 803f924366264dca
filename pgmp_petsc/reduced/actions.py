"""What acts on reduced models: local effects with rigid kinematics and mode shapes of the nodes where they hold, as
interpolants; and over time amplitudes of loads and of local effects, and prescribed motions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.effects.action import NOTHING, Action, amplitudes_over, compile_actions, counted_from, first_terms
from pgmp_petsc.effects.effect import Effect
from pgmp_petsc.effects.time_function import Motion, TimeFunction, joined
from pgmp_petsc.lanes.vectors import same_in_all_lanes
from pgmp_petsc.mechanism.joints import Attachment
from pgmp_petsc.mechanism.kinematics import RigidKinematics, measured, turns_counted
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.statements import ANGLE, FOLLOWING, Statement
from pgmp_petsc.reduced.action_frames import Places
from pgmp_petsc.reduced.action_kernel import Chosen, LocalEffects
from pgmp_petsc.reduced.arrays import Strengths
from pgmp_petsc.reduced.carried_forces import CarriedForces
from pgmp_petsc.reduced.cells import Cells, Grid
from pgmp_petsc.reduced.terms import grid_of
from pgmp_petsc.reduction.interpolation import Interpolant, interpolant
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.sample_grid import LengthGrid, SampleGrid
from pgmp_petsc.stepping.second_order_system import State


@dataclass(frozen=True)
class ReducedActions:
    """The actions of a scene in the reduced model."""

    actions: tuple[Action, ...]  # actions of all effects
    places: Places  # where they hold; without actions all of its arrays are empty
    dimension: int = 2  # 2 in the plane, 3 in space
    #: what the rigid part of `places` was made from, `rigid_places`; None without actions
    rigid: Interpolant | None = None
    weights: tuple[Monomial, ...] = (Monomial(),)  # of the terms of `places`
    carried: CarriedForces | None = None  # joints whose forces friction hangs on; None where there are none

    @classmethod
    def of(
        cls,
        actions: Sequence[Action],
        kinematics: RigidKinematics,
        rom: ReducedOrderModel,
        scheme: str,
        start: np.ndarray,
        parts: int,
        fine: SampleGrid,
    ) -> ReducedActions:
        """Prepare the tables of the nodes that actions hold at: of the rigid mechanism on a `fine` grid, and of the
        mode shapes by a scheme of interpolation over the samples, in so many parts of a cell between them.

        Angles that are no coordinates count their turns from the coordinates at the start, shape (n_theta,).
        """
        if not actions:
            return cls.none(kinematics.n_coordinates)
        sides = [side for action in actions for side in action.sides]
        nodes = nodes_of(actions)
        rows = np.concatenate([kinematics.mechanism.node_dofs(node) for node in nodes])
        shapes = rom.projection[:, rows]
        if rom.curvature is not None:
            shapes = np.concatenate([shapes, rom.curvature[:, rows]], axis=2)
        rigid, winding = rigid_places(actions, kinematics, fine, start)
        bent = interpolant(rom.tables.samples, shapes.reshape(len(shapes), 1, -1), scheme)
        places = Places(
            fine=grid_of(rigid),
            rigid=Cells.of(rigid, grid_of(rigid)),
            shapes=Cells.of(bent, grid_of(bent, parts)),
            together=np.zeros(1, dtype=np.int64),
            winding=winding,
            sides=np.array([-1 if s.on_ground else nodes.index(s.node) for s in sides], dtype=np.int64).reshape(-1, 2),
            n_nodes=len(nodes),
            felt=felt_by(actions, kinematics.mechanism.space.dimension),
        )
        return cls(tuple(actions), places, kinematics.mechanism.space.dimension, rigid)

    @classmethod
    def joined(cls, grid: LengthGrid, members: Sequence[ReducedActions]) -> ReducedActions:
        """Return the actions of any lengths from those at the points of a grid; see `reduction.length_family`.

        Points of the ground that are at other places there are nodes that do not move, behind the others.
        """
        first = members[0]
        if not first.actions:
            return first
        places = first.places
        grounded = [
            np.array([side.point * side.on_ground for one in member.actions for side in one.sides])
            for member in members
        ]
        moved, axes = np.flatnonzero(np.ptp(grounded, axis=0).any(axis=1)), np.eye(grounded[0].shape[1]).ravel()
        frames = [np.array([[*at[k], *axes] for k in moved]).ravel() for at in grounded]
        n_frames = places.n_nodes * places.felt.shape[1] * 2
        n_bent = moved.size * (places.shapes.rows.shape[2] // places.n_nodes)
        rigid = [_same_turns(member.places.rigid, places.rigid, places.winding) for member in members]
        rigid = [np.insert(rows, [n_frames] * at.size, at, axis=2) for rows, at in zip(rigid, frames)]
        shapes = [np.pad(member.places.shapes.rows, ((0, 0), (0, 0), (0, n_bent))) for member in members]
        sides = places.sides.copy()
        sides.ravel()[moved] = places.n_nodes + np.arange(moved.size)
        places = places._replace(
            rigid=places.rigid.with_rows(grid.coefficients(rigid)),
            shapes=places.shapes.with_rows(grid.coefficients(shapes)),
            together=np.zeros(len(members), dtype=np.int64),
            sides=sides,
            n_nodes=places.n_nodes + moved.size,
            felt=np.pad(places.felt, ((0, moved.size), (0, 0))),
        )
        carried = first.carried and CarriedForces.joined(grid, [member.carried for member in members])
        return cls(first.actions, places, first.dimension, None, grid.weights(first.weights), carried)

    @classmethod
    def none(cls, n_theta: int) -> ReducedActions:
        """Return no actions."""
        nowhere, whole = (Grid.even(0.0, 1.0, 1, False),) * n_theta, np.zeros(1, dtype=np.int64)
        empty, sides = Cells.none(n_theta), np.zeros((0, 2), dtype=np.int64)
        return cls(
            (), Places(nowhere, empty, empty, whole, np.zeros((0, n_theta)), sides, 0, np.zeros((0, 3), dtype=bool))
        )

    def of_joints(self, mechanism: Mechanism) -> ReducedActions:
        """Return the springs of elastic joints and couplings alone, where others act nowhere; none without them."""
        own = {part.statement for one in mechanism.connections for part in one.released}
        own |= {one.combination for one in mechanism.couplings if one.elastic}
        if not any(action.statement in own for action in self.actions):
            return self.none(self.places.winding.shape[1])
        nothing = {"law": NOTHING, "parameters": (), "amplitude": None, "led": False}
        return replace(
            self, actions=tuple(one if one.statement in own else replace(one, **nothing) for one in self.actions)
        )

    @property
    def edges(self) -> list[tuple[int, int]]:
        """Edges of laws: number of the action, and of the edge among those of its law."""
        return [(k, number) for k, action in enumerate(self.actions) for number in range(len(action.law.edges))]

    def of_samples(self, values: Mapping[str, np.ndarray], n_samples: int) -> LocalEffects:
        """Return what the kernel takes, for samples with values of shape (n_samples,)."""
        compiled = compile_actions(self.actions, values, n_samples, self.dimension)
        with_edges = [k for k, action in enumerate(self.actions) if action.law.edges]
        return LocalEffects(self.places, compiled, self.chosen(range(len(self.actions))), self.chosen(with_edges))

    def chosen(self, numbers: Sequence[int]) -> Chosen:
        """Return some actions with their nodes."""
        firsts = first_terms(self.actions)
        parts = [part for k in numbers for part in range(firsts[k], firsts[k + 1])]
        nodes = np.unique(self.places.sides[parts])
        return Chosen(np.array(numbers, dtype=np.int64), nodes[nodes >= 0])


def nodes_of(actions: Sequence[Action]) -> list[int]:
    """Return the nodes that actions hold at, increasing."""
    return sorted({side.node for action in actions for side in action.sides if not side.on_ground})


def felt_by(actions: Sequence[Action], dimension: int) -> np.ndarray:
    """Return which displacements and rotations of `nodes_of` actions these are of, shape (n_nodes, n_dofs): a statement
    is of those of points and directors with which it changes, a point beside the node of its rotation too."""
    nodes, d, n = nodes_of(actions), dimension, dimension * (dimension + 1)
    found, frames = np.zeros((len(nodes), n // 2), dtype=bool), np.random.default_rng(1).normal(size=(2, n))
    for action in actions:
        for (part, _), pair in zip(action.statement.terms, action.pairs):
            slopes = np.ones(2 * n) if part.kind == FOLLOWING else part.generic.gradient(*frames)
            for side, own in zip(pair, slopes.reshape(2, n) != 0.0):
                if not side.on_ground:
                    moves, turns = own[:d].any(), own[d:].any() or (own[:d].any() and np.any(side.arm))
                    found[nodes.index(side.node)] |= np.repeat([moves, turns], [d, n // 2 - d])
    return found


def rigid_places(
    actions: Sequence[Action], kinematics: RigidKinematics, fine: SampleGrid, start: np.ndarray
) -> tuple[Interpolant, np.ndarray]:
    """Return the frames of `nodes_of` actions on the rigid mechanism, and behind them the angles that actions measure
    less their winding, 0 for what is no angle, as one interpolant; and the winding, shape (n_parts, n_theta)."""
    space, poses, frames = kinematics.mechanism.space, kinematics.poses(fine.theta), []
    rates = cache(lambda: kinematics.rates(poses))  # few actions measure angles that need them
    for body, point in map(kinematics.mechanism.body_of, nodes_of(actions)):
        frames.append(space.natural(space.place(poses[body], point[None])[0]).T)
    found = []
    for action in actions:
        near = counted_from(action, kinematics, start[:, None])[:, 0]
        for (part, _), sides, at in zip(action.statement.terms, action.pairs, near):
            found.append(_counted(part, sides, kinematics, poses, rates, fine, start, at))
    angles, winding = map(np.array, zip(*found))
    return interpolant(fine, np.concatenate([*frames, angles.T], axis=1)[:, None], "spline"), winding


def _same_turns(rigid: Cells, other: Cells, winding: np.ndarray) -> np.ndarray:
    """Return the rows of `Places.rigid` with the turns of their angles, the last entries, counted as of others."""
    found, angles = rigid.rows.copy(), slice(rigid.rows.shape[2] - len(winding), None)
    away = found[0, 0, angles] - other.rows[0, 0, angles]
    found[:, 0, angles] -= 2 * np.pi * np.rint(away / (2 * np.pi))  # a constant is in every row
    return found


def _counted(
    part: Statement, sides: Sequence[Attachment], kinematics: RigidKinematics, poses: np.ndarray,
    rates: Callable[[], np.ndarray], fine: SampleGrid, start: np.ndarray, near: float,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return an angle on the rigid mechanism less its winding (n,), and the winding (n_theta,), with turns counted; 0
    for what is no angle.

    A coordinate is its own angle. In the plane bodies count their turns; in space those of another joint's angle are
    counted over the grid, and it is nearest to `near` at the start.
    """
    winding = np.zeros(fine.n_coordinates)
    if part.kind != ANGLE:
        return np.zeros(fine.n), winding
    for k, coordinate in enumerate(kinematics.coordinates):
        if coordinate.statement is part:
            return np.zeros(fine.n), np.eye(fine.n_coordinates)[k]
    space = kinematics.mechanism.space
    if space.dimension == 3:
        angles = turns_counted(part, sides, poses, rates(), [axis.theta for axis in fine])
    else:
        angles = measured(space, part, sides, poses).reshape(fine.shape)
    for k, axis in enumerate(fine.axes):
        if axis.periodic:
            line = np.moveaxis(angles, k, 0).reshape(axis.n, -1)[:, 0]
            winding[k] = 2 * np.pi * np.rint((line[-1] - line[0]) / (2 * np.pi)) / (axis.upper - axis.lower)
    angles = angles.ravel() - fine.theta @ winding
    if space.dimension == 3:
        first = measured(space, part, sides, kinematics.poses(start[None]), near)[0]
        away = first - interpolant(fine, angles, "spline")(start[None])[0] - winding @ start
        angles += 2 * np.pi * np.rint(away / (2 * np.pi))
    return angles, winding


@dataclass(frozen=True)
class ReducedStrengths:
    """Strengths that are the same for all samples of a batch."""

    load_effects: Sequence[Effect]  # effects with loads, in the order of the tables
    actions: Sequence[Action]  # local effects
    motions: Mapping[int, Motion]  # of prescribed coordinates, by their numbers
    n_coordinates: int

    @property
    def functions(self) -> Strengths:
        """What gives them at any time: `TimeFunctions` in place of their values."""
        nothing, moved = TimeFunction.constant(0.0), self.motions
        return Strengths(
            joined([effect.strength for effect in self.load_effects]),
            joined([nothing if action.amplitude is None else action.amplitude for action in self.actions]),
            joined([moved[k].angle if k in moved else nothing for k in range(self.n_coordinates)]),
        )

    def at(self, time: float) -> Strengths:
        """Return what acts on every lane at an instant (s)."""
        return Strengths(*(same_in_all_lanes(part[0]) for part in self.over(np.array([time]))))

    def over(self, times: np.ndarray) -> Strengths:
        """Return what acts at several instants (n_t,), s, one a row."""
        loads = np.empty((times.size, len(self.load_effects)))
        for column, effect in zip(loads.T, self.load_effects):
            column[:] = effect.amplitude(times)
        motions = np.zeros((times.size, 3 * self.n_coordinates if self.motions else 0))
        for k, motion in self.motions.items():
            motions[:, 3 * k : 3 * k + 3] = np.transpose(motion.at(times))
        return Strengths(loads, amplitudes_over(self.actions, times), motions)

    def prescribe(self, time: float, state: State, samples: np.ndarray) -> None:
        """Put the prescribed coordinates of some samples (a mask) where they are at a time (s)."""
        for k, motion in self.motions.items():
            state.q[samples, k], state.v[samples, k], state.a[samples, k] = motion.at(time)
