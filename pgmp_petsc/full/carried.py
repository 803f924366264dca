"""Forces that joints carry in the steps of full-order and component samples, compiled: friction hangs on them.

With multipliers lambda_i of what a joint holds, statements s_i, and forces F_t of what acts in the directions that it
releases, along s_t, the force is the size of

    -sum_i lambda_i ds_i/dp  +  sum_t F_t ds_t/dp,

p being the place of either of its points: a statement does not change where both move alike. Multipliers are those of
the equations at the iterate. Those of a joint in the tree of joint coordinates (`joint_tree`) balance what the bodies
behind it ask of the frame that it holds. From correction to correction forces go on as `controllers.running` says.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np

from pgmp_petsc.controllers.running import N_FOLLOWED
from pgmp_petsc.effects.action import first_terms
from pgmp_petsc.full.forces import act
from pgmp_petsc.full.joint_kernel import evaluate_in_joints
from pgmp_petsc.full.joint_tree import Held
from pgmp_petsc.full.node_constraints import gather
from pgmp_petsc.full.part_reference import loaded
from pgmp_petsc.full.parts import contiguous
from pgmp_petsc.full.problem import FullEquations
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import borrowed, eliminate, empty_lanes, fill, items, keep, square_root
from pgmp_petsc.lanes.vectors import aligned_zeros
from pgmp_petsc.mechanism.joints import Attached
from pgmp_petsc.mechanism.node_statements import NodeStatements, scratch_of
from pgmp_petsc.mechanism.node_statements import state as statement
from pgmp_petsc.mechanism.statement_rows import StatementRows
from pgmp_petsc.outputs.joint_forces import OfConnection

JOINT, NUMBER, PLACE, HELD = range(4)  # of a term: its joint and its multiplier, -1 of none; first unknowns of points
TERM = 1  # of what acts: its term, behind its joint
FIRST, BEHIND, NODE, BODY = range(4)  # of a joint in the tree: its terms, the node that it holds, its number there


class Room(NamedTuple):
    """Room for a block: slopes of the terms (n_terms, 2 m, n_lanes), force vectors (n d, n_lanes), equations of a joint
    in the tree, with what each of its terms does to the frame that it holds, and the forces; and of each lane what
    `controllers.running.take_carried` takes on."""

    slopes: np.ndarray
    vectors: np.ndarray
    matrix: np.ndarray
    right: np.ndarray
    ways: np.ndarray
    forces: np.ndarray
    given: np.ndarray
    found: np.ndarray
    followed: np.ndarray


class Carried(NamedTuple):
    """Joints whose forces friction hangs on, as compiled functions take them."""

    actions: np.ndarray  # that rub, one for each joint, (n,)
    statements: NodeStatements  # terms of what the joints hold
    dofs: np.ndarray  # unknowns of both nodes of each term, -1 on the ground, (n_terms, 2 m)
    terms: np.ndarray  # `JOINT`, ... of each, (n_terms, 4)
    pulls: np.ndarray  # `JOINT` and `TERM` of terms of actions in these joints, (n_pulls, 2)
    in_tree: np.ndarray  # `FIRST`, ... of those in the tree, (n_in_tree, 4)
    room: Room

    @classmethod
    def of(
        cls, forces: Sequence[OfConnection], equations: FullEquations, numbers: np.ndarray, tree: Held | None = None
    ) -> Self:  # fmt: skip
        """Prepare the forces; `numbers` are those of the multipliers, among the ones here, of what all joints hold, -1
        of none."""
        unknowns, d, actions = equations.unknowns, equations.problem.dimension, equations.actions
        parts: list[Attached] = []
        rows: list[tuple[int, int]] = []
        for joint, force in enumerate(forces):
            chosen = [k for k, row in enumerate(force.rows) if numbers[row] >= 0]
            parts += [force.held[k] for k in chosen]
            rows += [(joint, int(numbers[force.rows[k]])) for k in chosen]
        in_tree: list[list[int]] = []
        for body in [] if tree is None else np.unique(tree.bodies).tolist():
            own = np.flatnonzero(tree.bodies == body)
            joints = [[k for k, force in enumerate(forces) if tree.places[row] in force.rows] for row in own]
            if any(joints):
                in_tree.append([len(parts), len(parts) + own.size, int(tree.nodes[own[0]]), body])
                parts += [tree.rows.parts[row] for row in own]
                rows += [(each[0] if each else -1, -1) for each in joints]
        held = StatementRows(parts, unknowns.frame, d)
        m, terms = held.dofs.shape[1] // 2, np.zeros((len(held.dofs), 4), dtype=np.int64)
        terms[:, :PLACE] = np.array(rows, dtype=np.int64).reshape(-1, 2)[held.row_of]
        terms[:, PLACE] = np.where(held.dofs[:, m] >= 0, m, 0)
        for first, behind, node, _ in in_tree:
            terms[first:behind, HELD] = np.where(held.dofs[first:behind, m] == unknowns.frame(node)[0], m, 0)
        firsts, pulls = first_terms(actions).tolist(), []
        for joint, force in enumerate(forces):
            own = {pull.action.effect for pull in force.pulls}
            among = (k for k, one in enumerate(actions) if one.effect in own)
            pulls += [(joint, term) for k in among for term in range(firsts[k], firsts[k + 1])]
        rubbing = {one.effect: k for k, one in enumerate(actions) if one.law.loaded}
        n, most = len(forces), max((behind - first for first, behind, _, _ in in_tree), default=0)
        lanes = len(equations.problem.width)
        sizes = (len(terms), 2 * m), (n * d,), (most, most), (most, 1), (most + 1, d * (d + 1) // 2), (n,)
        followed = (np.zeros((lanes, *shape)) for shape in ((n,), (n,), (N_FOLLOWED + n, n)))
        return contiguous(cls(
            np.array([rubbing[force.name] for force in forces]), held.statements, held.dofs, terms,
            np.array(pulls, dtype=np.int64).reshape(-1, 2), np.array(in_tree, dtype=np.int64).reshape(-1, 4),
            Room(*(aligned_zeros((*shape, lanes)) for shape in sizes), *followed),
        ))  # fmt: skip


@njit(cache=True, apart=True, error_model="numpy")
def find_carried(problem, joints, matrix, carried, block, amplitudes, angles, state, typical_mass):
    """Fill ``carried.room.forces`` with those that joints carry in a state of a block; arguments are as of
    `kernel.correct_block` and `joint_kernel.correct_joints`."""
    width, d, room = problem.width, problem.dimension, carried.room
    if joints is None:
        _fill_slopes(carried, width, state[0])
    else:
        itself = np.empty((0, len(width)))
        evaluate_in_joints(
            problem, joints, block, amplitudes, angles, itself, state, (0.0, 1.0, 0.0), typical_mass, False, matrix
        )
        _fill_slopes(carried, width, joints.room.q)
    slopes, vectors, forces = items(room.slopes, width), items(room.vectors, width), items(room.forces, width)
    multipliers = items(state[3], width)
    fill(room.vectors, 0.0, width)
    for k in range(carried.terms.shape[0]):
        if carried.terms[k, NUMBER] >= 0:
            _pull(d, carried.terms[k], multipliers[carried.terms[k, NUMBER]], slopes[k], vectors)
    if joints is not None:
        for number in range(carried.in_tree.shape[0]):
            _pull_in_tree(d, joints, carried, width, number)
    if carried.pulls.shape[0]:
        turns = state[4][problem.angles.dofs.shape[0] :]
        if joints is None:
            _pull_by_actions(problem, carried, width, block, amplitudes[1], state[0], state[1], turns)
        else:
            _pull_by_actions(problem, carried, width, block, amplitudes[1], joints.room.q, joints.room.v, turns)
    for joint in range(forces.size):
        total = vectors[joint * d] * vectors[joint * d]
        for c in range(1, d):
            total += vectors[joint * d + c] * vectors[joint * d + c]
        forces[joint] = square_root(total)


@njit(error_model="numpy")
def _fill_slopes(carried, width, q):
    """Fill the derivatives of the terms in the unknowns of their nodes."""
    statements, m, n_lanes = loaded(carried.statements), carried.dofs.shape[1], len(width)
    scratch, y, near = scratch_of(statements, m // 2, width), empty_lanes(m, n_lanes), np.zeros(n_lanes)
    h = empty_lanes(1, n_lanes).reshape((1, 1, n_lanes))
    for k in range(carried.dofs.shape[0]):
        gather(carried.dofs[k], width, q, y)
        statement(statements, k, y, near, np.bool_(False), scratch, width, carried.room.slopes[k], h)
    keep(y)


@njit(error_model="numpy", forceinline=True)
def _pull(d, term, multiplier, slopes, vectors):
    """Add what a term with a multiplier does to the second body of its joint."""
    factor = -multiplier if term[PLACE] > 0 else multiplier
    for c in range(d):
        vectors[term[JOINT] * d + c] += factor * slopes[term[PLACE] + c]


@njit(error_model="numpy")
def _pull_in_tree(d, joints, carried, width, number):
    """Add what a joint in the tree holds: with the ways W_i that its terms push the frame which it holds, and turn it,
    ``sum_j W_i W_j lambda_j = -W_i f`` for the force f that is asked of the frame."""
    first, n = carried.in_tree[number, FIRST], carried.in_tree[number, BEHIND] - carried.in_tree[number, FIRST]
    node, body, room = carried.in_tree[number, NODE], carried.in_tree[number, BODY], carried.room
    slopes, ways, vectors = items(room.slopes, width), items(room.ways, width), items(room.vectors, width)
    matrix, right = items(room.matrix, width), items(room.right, width)
    z, f, arm = items(joints.room.z, width), items(joints.room.f, width), joints.tree.after[body]
    at, size = d * (d + 1) * node, ways.shape[1]
    for c in range(d):
        ways[n, c] = f[at + c]
    for turn in range(size - d):
        one, other = (0, 1) if d == 2 else ((turn + 1) % 3, (turn + 2) % 3)
        moment = 0.0 * f[at]
        for k in range(d):
            director = at + d + d * k
            moment += z[director + one] * (f[director + other] + arm[0, k] * f[at + other])
            moment -= z[director + other] * (f[director + one] + arm[0, k] * f[at + one])
        ways[n, d + turn] = moment
    for i in range(n):
        own, held = slopes[first + i], carried.terms[first + i, HELD]
        for c in range(d if d == 3 else size):
            ways[i, c] = own[held + c]
        for turn in range(3 if d == 3 else 0):
            one, other = (turn + 1) % 3, (turn + 2) % 3
            moment = 0.0 * f[at]
            for k in range(d):
                director, slope = at + d + d * k, held + d + d * k
                moment += z[director + one] * own[slope + other] - z[director + other] * own[slope + one]
            ways[i, d + turn] = moment
    for i in range(n):
        for j in range(n + 1):
            total = 0.0 * f[at]
            for c in range(size):
                total += ways[i, c] * ways[j, c]
            if j < n:
                matrix[i, j] = total
            else:
                right[i, 0] = -total
    eliminate(n, 1, matrix, right)
    for i in range(n):
        if carried.terms[first + i, JOINT] >= 0:
            _pull(d, carried.terms[first + i], right[i, 0], slopes[first + i], vectors)


@njit(error_model="numpy")
def _pull_by_actions(problem, carried, width, block, amplitudes, q, v, turns):
    """Add what acts in the directions that joints release."""
    actions, d = problem.actions, problem.dimension
    now = act(actions, width, block, amplitudes, q, v, turns, 0.0, False)
    forces, vectors, m = items(now.forces, width), items(carried.room.vectors, width), actions.dofs.shape[1] // 2
    for pull in range(carried.pulls.shape[0]):
        joint, term = carried.pulls[pull, JOINT], carried.pulls[pull, TERM]
        place = m if actions.dofs[term, m] >= 0 else 0
        for c in range(d):
            vectors[joint * d + c] += forces[term, place + c] if place > 0 else -forces[term, place + c]
    keep(now)


@njit(cache=True, entry=True, error_model="numpy")
def find_all_carried(problem, joints, factors, carried, amplitudes, angles, state, typical_mass, found):
    """Fill the forces that joints carry in a state of all blocks, (n_blocks, n, n_lanes)."""
    for block in range(found.shape[0]):
        own = state[0][block], state[1][block], state[2][block], state[3][block], state[4][block]
        find_carried(
            problem, joints, borrowed(factors.matrix)[block], carried, block, amplitudes, angles, own,
            typical_mass[block],
        )  # fmt: skip
        for k in range(found.shape[1]):
            for lane in range(found.shape[2]):
                found[block, k, lane] = carried.room.forces[k, lane]
