"""Component models in joint coordinates as a second-order system for the integrator: batches of samples.

The unknowns of a step are coordinates y of a tree of joints and the amplitudes of bodies (`joint_tree`); constraints
are those alone that close loops, and what joints hold that are in no tree. Outputs and energies are of the unknowns
q(y) of the full-order equations (`joint_map`), which this takes from a `FullBatch`. Joints of the tree have no
multipliers: theirs are those that balance what the bodies behind a joint ask of the frame that it holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.effects.time_function import driven
from pgmp_petsc.full.batched_ldl import Pattern
from pgmp_petsc.full.carried import Carried
from pgmp_petsc.full.joint_kernel import Joints, TreeHolds, count_turns_in_joints, hold_all_in_tree, unknowns_of
from pgmp_petsc.full.joint_map import N_TURNED, Room
from pgmp_petsc.full.joint_matrix import N_SPARE, column_size
from pgmp_petsc.full.joint_tree import BALL, FREE, Held, coordinates_of, held_by, motions_of, tree_of
from pgmp_petsc.full.kernel import Factors
from pgmp_petsc.full.node_constraints import ConstraintParts
from pgmp_petsc.full.part_reference import Reference
from pgmp_petsc.full.parts import contiguous
from pgmp_petsc.full.problem import FullEquations
from pgmp_petsc.full.systems import FullBatch
from pgmp_petsc.lanes.lane_items import SampleBlocks, aligned
from pgmp_petsc.lanes.vectors import aligned_zeros
from pgmp_petsc.mechanism.constraint_set import null_space
from pgmp_petsc.mechanism.statement_rows import StatementRows
from pgmp_petsc.mechanism.statements import ANGLE, Statement
from pgmp_petsc.outputs.multipliers import OfConnection
from pgmp_petsc.stepping.second_order_system import State

ROUND_OFF = 1e-9  # of the slopes of constraints, over the largest of a row


class JointEquations:
    """The equations of a mechanism in joint coordinates for some samples.

    There are n coordinates, which move the bodies by `motions`, in the order of the tree, and n_left constraints: those
    with statements, n_statements, which are `chosen` from the `set` of all, and behind them driven coordinates
    (`Joints.driven`). `equations` are all equations in the unknowns, and `problem` those with the constraints alone
    that are left; `joints` is what compiled functions take beside them, and `references` both, as these take them.
    """

    def __init__(self, equations: FullEquations, blocks: SampleBlocks) -> None:
        unknowns = self._unknowns = equations.unknowns
        self.equations, self._blocks = equations, blocks
        problem, d = equations.problem, unknowns.dimension
        q = equations.start[0]
        self.motions = motions_of(unknowns)
        dofs = problem.masses.dofs[:, 0] // 12 if d == 3 else problem.lumps.dofs // 3
        self._tree = tree_of(unknowns, self.motions, q, dofs)
        self.n = int(self._tree.firsts[:, 4].max())
        self.set = equations.constraints
        directors = self._directors() if d == 3 else np.zeros(0, dtype=int)
        self._in_tree = held_by(unknowns.mechanism, self.motions)
        held = np.flatnonzero(~self._in_tree)
        n_own = self.set.n_constraints - self.set.n_driven
        self._of_tree = self._coordinates_of_tree()
        prescribed = [one.statement for one in unknowns.mechanism.coordinates if one.prescribed]
        chosen = [(number, self._of_tree[one]) for number, one in enumerate(prescribed) if one in self._of_tree]
        #: driven coordinates of the tree's own joints, their motions, and how they grow, shape (n, 3)
        self.driven = np.array([(own, number, sign) for number, (own, sign) in chosen], dtype=int).reshape(-1, 3)
        drives = [n_own + k for k in range(self.set.n_driven) if k not in self.driven[:, 1]]
        every = np.sort(np.concatenate([held, directors, drives]).astype(int))
        self._take(every)
        if every.size:
            slopes, own = self.slopes_at(q)[every], every < n_own
            slopes[np.abs(slopes) < ROUND_OFF * np.abs(slopes).max()] = 0.0
            # those that do not follow from others in coordinates, and all driven ones
            kept = np.concatenate([every[own][null_space(sp.csr_matrix(slopes[own])).rows], every[~own]])
            if kept.size < every.size:
                self._take(kept)
        self.n_statements = self.chosen.size
        self.n_left = self.n_statements + len(self.driven)

    @cached_property
    def held(self) -> Held:
        """What the tree's joints hold, and its driven coordinates."""
        unknowns, order = self._unknowns, {motion.number: k for k, motion in enumerate(self.motions)}
        mechanism = unknowns.mechanism
        parts = [(i, part) for i, holder in enumerate(mechanism.holders) for part in holder.holding(moving=True)]
        found = [(place, order[parts[place][0]], parts[place][1]) for place in np.flatnonzero(self._in_tree)]
        prescribed = [(one.statement, one.sides) for one in mechanism.coordinates if one.prescribed]
        bodies = np.searchsorted(self._tree.firsts[:, 5], self.driven[:, 0], side="right") - 1
        found += [(len(parts) + k, body, prescribed[k]) for body, k in zip(bodies, self.driven[:, 1])]
        places, bodies, parts = zip(*sorted(found, key=lambda one: one[1])) if found else ((), (), ())
        rows, bodies = StatementRows(parts, unknowns.frame, unknowns.dimension), np.array(bodies, dtype=int)
        return Held(rows, np.array(places, dtype=int), bodies, self._tree.nodes[bodies, 1])

    @cached_property
    def holds(self) -> TreeHolds:
        """The same, as compiled functions take it."""
        return TreeHolds.of(self.held, self._unknowns, self._blocks.n_lanes)

    def multipliers_of_joints(self, left: np.ndarray, in_tree: np.ndarray) -> np.ndarray:
        """Return the multipliers of joints and driven angles, shape (n, n_samples), from those of the constraints that
        are left, (n_left, n_samples), and of what the tree's joints hold, (n_held, n_samples)."""
        every = np.zeros((self.set.n_constraints, left.shape[1]))
        every[self.chosen] = left[: self.n_statements]
        found = self.set.of_joints(every)
        found[self.held.places] = in_tree
        return found

    def _directors(self) -> np.ndarray:
        """Return the numbers of the constraints that make directors a rotation that are coordinates."""
        first = self._unknowns.mechanism.n_held
        nodes = [self._tree.nodes[k, 2 if motion.kind == FREE else 1]
                 for k, motion in enumerate(self.motions) if motion.kind in (BALL, FREE)]  # fmt: skip
        return np.array([first + 6 * node + k for node in nodes for k in range(6)], dtype=int)

    def _coordinates_of_tree(self) -> dict[Statement, tuple[int, int]]:
        """Return which of its own coordinates the tree has for those of the mechanism, and 1 or -1 as both grow, by
        their statements."""
        mechanism, found = self._unknowns.mechanism, {}
        for coordinate in mechanism.coordinates:
            for k, motion in enumerate(self.motions):
                own = self._tree.firsts[k, 0 if coordinate.turns else 1]
                if own >= 0 and motion.axis == 0 and coordinate.connection is mechanism.connections[motion.number]:
                    found[coordinate.statement] = own, -1 if motion.backwards else 1
        return found

    def _counted(self) -> np.ndarray:
        """Return `Joints.counted`, in the order of turns: coordinates of the mechanism, and terms of actions."""
        mechanism, actions = self._unknowns.mechanism, self.equations.actions
        every = [coordinate.statement for coordinate in mechanism.coordinates]
        every += [part for action in actions for part, _ in action.statement.terms]
        found = [self._of_tree.get(part, (-1, 0)) if part.kind == ANGLE else (-2, 0) for part in every]
        return np.array(found[: self.equations.n_turns], dtype=int).reshape(-1, 2)

    def _take(self, chosen: np.ndarray) -> None:
        """Make the equations, and what is beside them, with chosen constraints."""
        self.chosen = chosen
        equations, tree, d = self.equations, self._tree, self._unknowns.dimension
        problem, n_dofs, lanes = equations.problem, equations.n_dofs, self._blocks.n_lanes
        parts = ConstraintParts(self.set, chosen, equations.size)
        bound = parts.placed(equations.layout, np.ones(chosen.size, dtype=bool))
        curved, pairs = bound.rows.curved, bound.pairs
        bound = bound._replace(
            rows=bound.rows._replace(curved=(np.zeros_like(curved[0]), *curved[1:])),
            weights=np.zeros_like(bound.weights), pairs=(np.zeros_like(pairs[0]), *pairs[1:]),
        )  # fmt: skip
        starts, _, unknowns = bound.rows.entries
        row_starts = starts[np.searchsorted(bound.places, np.arange(chosen.size + 1))]
        n_own = self.set.n_constraints - self.set.n_driven
        _, statements, *_ = self.set.statements_among(np.concatenate([chosen, n_own + self.driven[:, 1]]))
        weights = np.array([1.0 if part.is_length else equations.size**2 for part, _ in statements])
        floating = problem.floating
        n_packed = int(floating.firsts[-1, 2]) if floating.body.size else 0
        n_all, n_frame, n_nodes = n_dofs + weights.size, d * (d + 1), self._unknowns.mechanism.n_nodes
        turn = np.arange(n_all)
        nothing = np.zeros(0, dtype=np.int64)
        n_most, n_faces = max(tree.n_amplitudes, default=0), len(tree.face_nodes)
        q, v, a, x = (aligned_zeros((n, lanes)) for n in (n_dofs, n_dofs, n_dofs, n_all))
        frames = [q, v, a, x] if d == 3 else [aligned_zeros((n_frame * n_nodes, lanes)) for _ in range(4)]
        n_rows = self.n + weights.size
        room = Room(
            q, v, a, *frames, x, aligned_zeros((3 * n_frame, lanes)),
            aligned_zeros((n_faces, 3 * d + 6 * n_most, lanes)), aligned_zeros((n_faces, N_TURNED * d * d, lanes)),
            aligned_zeros((n_packed + unknowns.size + 1, lanes)), aligned_zeros((n_dofs, lanes)),
            aligned_zeros((n_rows, lanes)), aligned_zeros((n_rows, lanes)),
            aligned_zeros((N_SPARE, lanes)), aligned_zeros(((1 + d) ** 2 * n_nodes, lanes)),
            aligned_zeros((column_size.py_func(d) * self.n, lanes)), aligned_zeros((2, 6 * n_most, lanes)),
            aligned_zeros((column_size.py_func(d) * n_most, lanes)),
        )  # fmt: skip
        actions = problem.actions
        actions = actions._replace(entries=self._curved_entries())
        floating = floating._replace(positions=np.arange(n_packed)) if n_packed else floating
        changed = problem._replace(
            constraints=bound, actions=actions, floating=floating,
            pattern=Pattern(turn, nothing, nothing, problem.pattern.products),
        )  # fmt: skip
        joints = Joints(tree, room, self._units(), turn, row_starts, unknowns, n_packed, weights, self.driven,
                        self._counted())  # fmt: skip
        self.problem, self.joints = contiguous(changed), contiguous(joints)
        self.references = Reference(self.problem), Reference(self.joints)

    def _curved_entries(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the entries of tangents of those actions alone that are of a function of a statement."""
        (starts, *every), actions = self.equations.problem.actions.entries, self.equations.actions
        bent = np.array([any(f.breaks.size for _, f in action.statement.terms) for action in actions], dtype=bool)
        counts = np.diff(starts)
        kept = np.repeat(bent, counts)
        return np.append(0, np.cumsum(bent * counts)), *(part[kept] for part in every)

    def _units(self) -> np.ndarray:
        """Return 1/size for lengths, 1 for rotations and directors, shape (n,)."""
        units, d = np.full(self.n, 1.0 / self.equations.size), self._unknowns.dimension
        for k, motion in enumerate(self.motions):
            turning, _, natural, _ = self._tree.firsts[k, :4]
            if turning >= 0:
                units[turning] = 1.0
            if motion.kind == BALL:
                units[natural : natural + 9] = 1.0
            elif motion.kind == FREE:
                units[natural + d : natural + (12 if d == 3 else 3)] = 1.0
        return units

    def slopes_at(self, q: np.ndarray) -> np.ndarray:
        """Return the slopes of all constraints in the coordinates at unknowns (n_dofs,), shape (n_constraints, n)."""
        y = np.repeat(self.coordinates(q[:, None], np.zeros_like(q)[:, None])[0], self.n, axis=1)
        ways = self.mapped_columns(y, np.zeros_like(y), np.eye(self.n))[2]
        rows, columns = self.set.jacobian_pattern
        jacobian = sp.csr_matrix((self.set.jacobian_values(q[:, None])[:, 0], (rows, columns)),
                                 shape=(self.set.n_constraints, q.size))  # fmt: skip
        return jacobian @ ways

    def mapped(self, y: np.ndarray, y1: np.ndarray, y2: np.ndarray) -> list[np.ndarray]:
        """Return unknowns, velocities and accelerations (n, n_dofs, n_lanes) of coordinates (n, n_y, n_lanes)."""
        found = [aligned((len(y), self.equations.n_dofs, y.shape[2])) for _ in range(3)]
        unknowns_of(*self.references, y, y1, y2, *found)
        return found

    def mapped_columns(self, *parts: np.ndarray) -> list[np.ndarray]:
        """Return unknowns, velocities and accelerations (n_dofs, n) of coordinates (n_y, n)."""
        n, lanes = parts[0].shape[1], self._blocks.n_lanes
        blocks = SampleBlocks(n, lanes, -(-n // lanes))
        return [blocks.unpack(part) for part in self.mapped(*map(blocks.pack, parts))]

    def coordinates(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return coordinates and rates, shape (2, n_y, n), of unknowns and velocities (n_dofs, n)."""
        return coordinates_of(self._unknowns, self._tree, self.motions, q, v)

    def count_from(self, y: np.ndarray, theta: np.ndarray) -> None:
        """Put the turns of coordinates (n_y, n) to those of the mechanism, (n_theta, 1 or n): driven ones are to have
        the angles of their motions."""
        for coordinate, angle in zip(self._unknowns.mechanism.coordinates, theta):
            if coordinate.turns and coordinate.statement in self._of_tree:
                own, sign = self._of_tree[coordinate.statement]
                y[own] += 2.0 * np.pi * np.rint((sign * angle - y[own]) / (2.0 * np.pi))

    def left(self, rows: np.ndarray, driven_rows: np.ndarray) -> np.ndarray:
        """Return what is of the constraints that are left, (n_left, n), of rows of all (n_constraints, n) and of what
        driven coordinates have (n_driven, n)."""
        return np.concatenate([rows[self.chosen], driven_rows])


class JointBatch(FullBatch):
    """A batch of samples of a component model, or a single one, on this rank, in joint coordinates.

    Arrays of states have coordinates in place of unknowns. Memory is shared with `full`, the same samples in their
    unknowns, which has no other use.
    """

    def __init__(self, full: FullBatch) -> None:
        vars(self).update(vars(full))
        own, blocks = JointEquations(self._equations, self._blocks), self._blocks
        self._shown: tuple[State | None, State | None] = None, None
        self.own, (self._reference, self._joints) = own, own.references
        self.n_dofs, self.n_constraints = own.n, own.n_left
        self.moving_constraints = own.n_left > 0 and full.moving_constraints
        self._bound_calls()
        n = own.n + own.n_left
        self._factors = Factors(
            aligned_zeros((blocks.n_blocks, n * (n + 1) // 2, blocks.n_lanes)), aligned_zeros((1, blocks.n_lanes))
        )

    def _carried_of(self, forces: Sequence[OfConnection]) -> Carried:
        own, nothing = self.own, np.zeros((self.own.held.places.size, 1))
        numbers = own.multipliers_of_joints(1.0 + np.arange(own.n_left)[:, None], nothing)[:, 0] - 1.0
        return Carried.of(forces, self._equations, numbers.astype(int), own.held, own.holds)

    def consistent(self, q: np.ndarray, v: np.ndarray, theta: np.ndarray) -> State:
        q, v = (part.reshape(self._equations.n_dofs, -1) for part in (q, v))
        found = self.own.coordinates(*np.broadcast_arrays(q, v))
        self.own.count_from(found[0], theta.reshape(len(theta), -1))
        return super().consistent(*found, theta)

    def _drift(self, times: Sequence[float], q: np.ndarray, v: np.ndarray) -> np.ndarray:
        own, accelerations = self.own, self._accelerations(times, q.shape[1])
        places, rates, more = own.mapped_columns(q, v, np.zeros_like(q))
        rows, (at, columns) = own.set.drift(places, rates, accelerations), own.set.jacobian_pattern
        np.add.at(rows, at, own.set.jacobian_values(places) * more[columns])
        return own.left(rows, -accelerations[own.driven[:, 1]])

    def _rates(self, time: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        own, speeds = self.own, driven(self._sources.motions, time).speed
        places, rates, _ = own.mapped_columns(q, v, np.zeros_like(q))
        number, motion, sign = own.driven.T
        return own.left(own.set.rates(places, rates, speeds), sign[:, None] * v[number] - speeds[motion, None])

    def strayed(self, state: State, step: float) -> np.ndarray:
        return np.zeros(self.n_samples, dtype=bool)  # what turns freely is a coordinate, and strays from nothing

    def _in_unknowns(self, states: State) -> State:
        """Return states in unknowns, with the multipliers of driven angles alone; frames, energies and outputs ask for
        the same ones."""
        if self._shown[0] is not states:
            shape, every, own = states.q.shape[:2], states.merged(), self.own
            n_own = own.set.n_constraints - own.set.n_driven
            rows = np.concatenate([own.chosen[own.chosen >= n_own] - n_own, own.driven[:, 1]])
            places = np.concatenate([np.flatnonzero(own.chosen >= n_own), np.arange(own.n_statements, own.n_left)])
            forces = np.zeros((len(every.q), own.set.n_driven, every.q.shape[-1]))
            forces[:, rows] = every.multipliers[:, places]
            found = *own.mapped(every.q, every.v, every.a), forces, every.turns
            self._shown = states, State(*(part.reshape(*shape, *part.shape[1:]) for part in found))
        return self._shown[1]

    def multipliers_of_joints(self, times: Sequence[float], states: State) -> np.ndarray:
        strengths, blocks = self._sources.at(np.array(times)), self._blocks
        holds = Reference(self.own.holds)
        found = aligned((len(times), blocks.n_blocks, self.own.held.places.size, blocks.n_lanes))
        for k, own in enumerate(found):
            hold_all_in_tree(
                self._reference, self._joints, self._factors, holds, (strengths.loads[k], strengths.actions[k]),
                strengths.angles[k], states.at(k).parts(), self._typical_mass, own,
            )  # fmt: skip
        return self.own.multipliers_of_joints(self._columns(states.multipliers), self._columns(found))

    def count_turns(self, state: State) -> None:
        for q, turns in zip(state.q, state.turns):
            count_turns_in_joints(self._reference, self._joints, q, turns)
