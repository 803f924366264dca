"""Forces that joints carry in the steps of full-order and component samples, compiled: friction hangs on them.

With multipliers lambda_i of what a joint holds, statements s_i, and forces F_t of what acts in the directions that it
releases, along s_t, the force is the size of

    -sum_i lambda_i ds_i/dp  +  sum_t F_t ds_t/dp,

p being the place of either of its points: a statement does not change where both move alike. Multipliers are those of
the equations at the iterate. Those of a joint in the tree of joint coordinates (`joint_tree`) balance what the bodies
behind it ask of the frame that it holds. From correction to correction forces go on as `controllers.running` says.
"""

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np

from pgmp_petsc.controllers.running import N_FOLLOWED
from pgmp_petsc.effects.action import first_terms
from pgmp_petsc.full.forces import act
from pgmp_petsc.full.joint_kernel import TreeHolds, fill_slopes, hold_in_tree
from pgmp_petsc.full.joint_tree import Held
from pgmp_petsc.full.parts import contiguous
from pgmp_petsc.full.problem import FullEquations
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import borrowed, fill, items, keep, square_root
from pgmp_petsc.lanes.vectors import aligned_zeros
from pgmp_petsc.mechanism.statement_rows import NodeStatements, StatementRows
from pgmp_petsc.outputs.multipliers import OfConnection

# of a term: its joint, -1 of none, the first unknown of one of its points, and its multiplier; of what acts: its term
JOINT, PLACE, NUMBER = range(3)
TERM = 1


class Room(NamedTuple):
    """Room for a block: slopes of the terms (n_terms, 2 m, n_lanes), vectors of joints (n_joints d, n_lanes) and
    forces, (n, n_lanes); and of each lane what `controllers.running.take_carried` takes on."""

    slopes: np.ndarray
    vectors: np.ndarray
    forces: np.ndarray
    given: np.ndarray
    found: np.ndarray
    followed: np.ndarray


class Carried(NamedTuple):
    """Joints whose forces friction hangs on, as compiled functions take them."""

    #: actions, joints: actions that rub, and the joint of each, in which there may be several, (n,)
    actions: np.ndarray
    joints: np.ndarray
    #: statements, dofs, terms: terms of what is not held in the tree, unknowns of both nodes, -1 on the ground,
    #: (n_terms, 2 m), and `JOINT`, ..., (n_terms, 3)
    statements: NodeStatements
    dofs: np.ndarray
    terms: np.ndarray
    #: tree, held: what joints in the tree hold, None without a tree, and `JOINT` and `PLACE` of it, (n_held, 2)
    tree: TreeHolds | None
    held: np.ndarray
    pulls: np.ndarray  # `JOINT` and `TERM` of terms of actions in these joints, (n_pulls, 2)
    room: Room

    @classmethod
    def of(
        cls, forces: Sequence[OfConnection], equations: FullEquations, numbers: np.ndarray, held: Held | None = None,
        tree: TreeHolds | None = None,
    ) -> Self:  # fmt: skip
        """Prepare the forces; `numbers` are those of the multipliers, among the ones here, of what all joints hold, -1
        of none; with a tree, `held` is what its joints hold."""
        unknowns, d, actions = equations.unknowns, equations.problem.dimension, equations.actions
        lanes, each = len(equations.problem.width), {force.connection.name: force for force in forces}
        joint_of = {row: k for k, force in enumerate(each.values()) for row in force.rows.tolist()}
        parts = [pair for one in each.values() for pair in zip(one.rows.tolist(), one.held) if numbers[pair[0]] >= 0]
        rows = StatementRows([part for _, part in parts], unknowns.frame, d)
        held_by = [parts[row][0] for row in rows.row_of]
        terms = [(joint_of[row], place, numbers[row]) for row, place in zip(held_by, _places(rows))]
        of_tree = np.zeros((0, 2), dtype=np.int64)
        if held is not None:
            joints = [joint_of.get(place, -1) for place in held.places.tolist()]
            of_tree = np.stack([np.array(joints, dtype=np.int64), _places(held.rows)], axis=1)
        firsts, pulls = first_terms(actions).tolist(), []
        for joint, force in enumerate(each.values()):
            own = {pull.action.effect for pull in force.pulls}
            among = (k for k, one in enumerate(actions) if one.effect in own)
            pulls += [(joint, term) for k in among for term in range(firsts[k], firsts[k + 1])]
        rubbing, n = {one.effect: k for k, one in enumerate(actions) if one.law.loaded}, len(forces)
        room = (aligned_zeros((*shape, lanes)) for shape in (rows.dofs.shape, (len(each) * d,), (n,)))
        followed = (np.zeros((lanes, *shape)) for shape in ((n,), (n,), (N_FOLLOWED + n, n)))
        return contiguous(cls(
            np.array([rubbing[force.name] for force in forces], dtype=np.int64),
            np.array([list(each).index(force.connection.name) for force in forces], dtype=np.int64), rows.statements,
            rows.dofs, np.array(terms, dtype=np.int64).reshape(-1, 3), tree, of_tree,
            np.array(pulls, dtype=np.int64).reshape(-1, 2), Room(*room, *followed),
        ))  # fmt: skip


def _places(rows: StatementRows) -> np.ndarray:
    """Return the first unknown of each term's second point, or of its first one where that is on the ground."""
    m = rows.dofs.shape[1] // 2
    return np.where(rows.dofs[:, m] >= 0, m, 0)


@njit(cache=True, apart=True, error_model="numpy")
def find_carried(problem, joints, matrix, carried, block, amplitudes, angles, state, typical_mass):
    """Fill ``carried.room.forces`` with those that joints carry in a state of a block; arguments are as of
    `kernel.correct_block` and `joint_kernel.correct_joints`."""
    width, d, room = problem.width, problem.dimension, carried.room
    if joints is None:
        fill_slopes(carried.statements, carried.dofs, room.slopes, width, state[0])
    else:
        hold_in_tree(problem, joints, matrix, carried.tree, block, amplitudes, angles, state, typical_mass)
        fill_slopes(carried.statements, carried.dofs, room.slopes, width, joints.room.q)
    slopes, vectors, forces = items(room.slopes, width), items(room.vectors, width), items(room.forces, width)
    multipliers = items(state[3], width)
    fill(room.vectors, 0.0, width)
    for k in range(carried.terms.shape[0]):
        _pull(d, carried.terms[k], multipliers[carried.terms[k, NUMBER]], slopes[k], vectors)
    if joints is not None:
        found, ways = items(carried.tree.multipliers, width), items(carried.tree.slopes, width)
        for k in range(carried.held.shape[0]):
            _pull(d, carried.held[k], found[k], ways[k], vectors)
    if carried.pulls.shape[0]:
        turns = state[4][problem.angles.dofs.shape[0] :]
        if joints is None:
            _pull_by_actions(problem, carried, width, block, amplitudes[1], state[0], state[1], turns)
        else:
            _pull_by_actions(problem, carried, width, block, amplitudes[1], joints.room.q, joints.room.v, turns)
    for k in range(forces.size):
        first = carried.joints[k] * d
        total = vectors[first] * vectors[first]
        for c in range(first + 1, first + d):
            total += vectors[c] * vectors[c]
        forces[k] = square_root(total)


@njit(error_model="numpy", forceinline=True)
def _pull(d, term, multiplier, slopes, vectors):
    """Add what a term with a multiplier does to the second body of its joint, if it is of any."""
    factor = -multiplier if term[PLACE] > 0 else multiplier
    for c in range(d if term[JOINT] >= 0 else 0):
        vectors[term[JOINT] * d + c] += factor * slopes[term[PLACE] + c]


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
