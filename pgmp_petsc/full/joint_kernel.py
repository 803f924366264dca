"""Newton's correction in joint coordinates, compiled: the equations of `kernel` behind the map of `joint_map`.

    r_y = N^T (M q'' + g_int(q) - g_ext(t) + C^T lambda),    c(q(y)) = 0

with the constraints alone that the tree leaves (`joint_tree`). Bodies, actions, loads and constraints are evaluated in
the unknowns q, as those of full-order models are. A driven angle that is a coordinate takes no statement: it has its
value.
"""

from typing import NamedTuple, Self

import numpy as np

from pgmp_petsc.full.damping import add_modal_damping
from pgmp_petsc.full.elements import add_masses
from pgmp_petsc.full.floating import add_floating
from pgmp_petsc.full.forces import act, add_loads
from pgmp_petsc.full.joint_map import Room, gather_forces, place
from pgmp_petsc.full.joint_matrix import factorise_dense, fill_matrix, first_of, substitute_dense
from pgmp_petsc.full.joint_tree import Held, Tree
from pgmp_petsc.full.kernel import add_lumps, count_turns, take_correction
from pgmp_petsc.full.node_constraints import add_constraints, gather
from pgmp_petsc.full.part_reference import loaded
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import borrowed, eliminate, empty_lanes, fill, items, keep, nearest_whole
from pgmp_petsc.lanes.vectors import aligned_zeros
from pgmp_petsc.mechanism.mechanism import Unknowns
from pgmp_petsc.mechanism.statement_rows import NodeStatements, scratch_of
from pgmp_petsc.mechanism.statement_rows import state as statement


class Joints(NamedTuple):
    """A mechanism in joint coordinates, beside the equations in its unknowns."""

    tree: Tree
    room: Room
    units: np.ndarray  # 1/size for lengths, 1 for rotations and directors, shape (n_y,)
    turn: np.ndarray  # 0, 1 .. of all unknowns and constraints, which stay where they are, shape (n,)
    starts: np.ndarray  # first of the slopes of each constraint with a statement, and their number, shape (n + 1,)
    unknowns: np.ndarray  # unknown of each slope
    first_slope: int  # place of the first one in the room's `entries`
    #: weights: m2, or 1 for lengths, by constraint; see `joint_matrix`
    weights: np.ndarray
    #: of each driven coordinate its number, that of its motion and 1 or -1 as it grows with it, shape (n, 3)
    driven: np.ndarray
    #: of each statement whose turns are counted the coordinate that it is, and 1 or -1 as it grows with it; -1 where an
    #: angle is none, -2 where it is no angle, shape (n_turns, 2)
    counted: np.ndarray


class TreeHolds(NamedTuple):
    """What the tree's joints hold (`joint_tree.Held`), with room for a block."""

    #: statements, dofs, felt: what is held, unknowns of both nodes, -1 on the ground, (n, 2 m), and which of them are
    #: the first of the frame that the joint holds, (n,)
    statements: NodeStatements
    dofs: np.ndarray
    felt: np.ndarray
    joints: np.ndarray  # first and number of what each joint holds, the node, and the body in the tree, (n_joints, 4)
    #: slopes, multipliers: first derivatives (n, 2 m, n_lanes), and the multipliers, (n, n_lanes)
    slopes: np.ndarray
    multipliers: np.ndarray
    #: ways, matrix, right: of what one joint holds the forces and moments on the frame, and its equations
    ways: np.ndarray
    matrix: np.ndarray
    right: np.ndarray

    @classmethod
    def of(cls, held: Held, unknowns: Unknowns, n_lanes: int) -> Self:
        """Prepare it for blocks of so many lanes."""
        d, dofs = unknowns.dimension, held.rows.dofs
        m, firsts = dofs.shape[1] // 2, np.array([unknowns.frame(node)[0] for node in held.nodes], dtype=np.int64)
        _, begins, numbers = np.unique(held.bodies, return_index=True, return_counts=True)
        joints = np.stack([begins, numbers, held.nodes[begins], held.bodies[begins]], axis=1).astype(np.int64)
        most = int(numbers.max(initial=0))
        shapes = dofs.shape, (len(dofs),), (most + 1, d * (d + 1) // 2), (most, most), (most, 1)
        room = (aligned_zeros((*shape, n_lanes)) for shape in shapes)
        return cls(held.rows.statements, dofs, np.where(dofs[:, m] == firsts, m, 0), joints, *room)


@njit(cache=True, apart=True, error_model="numpy")
def evaluate_in_joints(problem, joints, block, amplitudes, angles, residual, state, gains, scale, fresh, matrix):
    """Evaluate the residual of a block by coordinate and by constraint into ``room.all``, and the matrix; as
    `kernel.evaluate`."""
    width, tree, room = problem.width, joints.tree, joints.room
    y, y1, y2, multipliers, turns = state
    n, n_left = y.shape[0], multipliers.shape[0]
    n_dofs, d = room.q.shape[0], problem.dimension
    place(d, tree, width, y, y1, y2, room)
    q, v, a, x, entries = room.q, room.v, room.a, room.x, room.entries
    of_rows = entries[joints.first_slope :]
    fill(x, 0.0, width)
    if fresh:
        fill(entries, 0.0, width)
    if problem.lumps.dofs.size:
        add_lumps(problem.lumps, width, problem.section, block, v, a, gains, False, x, joints.turn, entries, entries)
    if problem.masses.body.size:
        add_masses(
            problem.masses, width, problem.rayleigh, block, v, a, gains, np.bool_(False), x, joints.turn, entries,
            entries,
        )  # fmt: skip
    if problem.floating.body.size:
        add_floating(
            d, problem.floating, width, problem.rayleigh, block, amplitudes[0], 1.0, q, v, a, gains, fresh, x,
            joints.turn, entries, entries,
        )  # fmt: skip
    if problem.modal.kinds.size:
        powers = np.empty((problem.modal.kinds.size, x.shape[1]))
        add_modal_damping(problem.modal, d, q, v, x, joints.turn, powers)
    add_loads(problem.loads, width, block, amplitudes[0], 1.0, x, joints.turn)
    if fresh:
        fill_matrix(d, problem, tree, width, block, gains, room, matrix, n + n_left)
    if problem.actions.counted.size:
        _add_actions(problem, joints, block, amplitudes[1], y, turns, gains, fresh, matrix, n + n_left)
    add_constraints(
        problem.constraints, width, d, angles, turns, residual, q, multipliers, scale, 0.0, fresh, x, joints.turn,
        entries, of_rows,
    )  # fmt: skip
    every, of_x, scales = items(room.all, width), items(x, width), items(scale, width)[()]
    for row in range(n_left):
        every[n + row] = of_x[n_dofs + row]
    gather_forces(d, tree, width, y, x, room, room.all)
    of_y, forces = items(y, width), items(multipliers, width)
    first = n_left - joints.driven.shape[0]
    for k in range(joints.driven.shape[0]):
        number, motion, sign = joints.driven[k, 0], joints.driven[k, 1], joints.driven[k, 2]
        every[number] += sign * forces[first + k]
        if residual.shape[0] == 0:
            every[n + first + k] = scales * (sign * of_y[number] - angles[motion])
    if fresh:
        _add_borders(d, joints, width, y, scale, matrix)


@njit(error_model="numpy")
def _add_actions(problem, joints, block, amplitudes, y, turns, gains, fresh, matrix, n_all):
    """Take the forces of all actions from those on unknowns, and add what they do along their own measures to the
    matrix, of functions of statements what their curvature does too: a contact pushes across what is between its parts.
    """
    width, room, actions = problem.width, joints.room, problem.actions
    of_actions = turns[problem.angles.dofs.shape[0] :]
    now = act(actions, width, block, amplitudes, room.q, room.v, of_actions, gains[0], fresh, gains[0] != 0.0)
    forces, slopes, stiffness = items(now.forces, width), items(now.slopes, width), items(now.stiffness, width)
    x, one, row, matrix = items(room.x, width), items(room.one, width), items(room.row, width), items(matrix, width)
    n_terms, m = actions.dofs.shape
    for k in range(n_terms):
        for i in range(m):
            if actions.dofs[k, i] >= 0:
                x[actions.dofs[k, i]] -= forces[k, i]
    for action in range(now.stiffness.shape[0] if fresh else 0):
        stiff = False
        for lane in range(now.stiffness.shape[1]):
            stiff |= now.stiffness[action, lane] != 0.0
        if not stiff:
            continue
        if actions.entries[0][action + 1] > actions.entries[0][action]:
            _add_curved(problem, joints, action, y, items(now.tangents, width), gains[2], matrix, n_all)
            continue
        fill(room.one, 0.0, width)
        for k in range(actions.firsts[action], actions.firsts[action + 1]):
            for i in range(m):
                if actions.dofs[k, i] >= 0:
                    one[actions.dofs[k, i]] += slopes[k, i]
        gather_forces(problem.dimension, joints.tree, width, y, room.one, room, room.row)
        for j in range(y.shape[0]):
            scaled, to = gains[2] * stiffness[action] * row[j], first_of(j, n_all)
            for i in range(j, y.shape[0]):
                matrix[to + i] += scaled * row[i]
    keep(now)


@njit(error_model="numpy")
def _add_curved(problem, joints, action, y, tangents, gain, matrix, n_all):
    """Add a gain times the whole tangent T of an action in unknowns, ``N^T T N``; `tangents` are items."""
    width, room, actions = problem.width, joints.room, problem.actions
    starts, rows, columns = actions.entries
    one, row, turned = items(room.one, width), items(room.row, width), items(room.all, width)
    m, begin, end = actions.dofs.shape[1], starts[action], starts[action + 1]
    dofs = actions.dofs.ravel()[m * actions.firsts[action] :]
    for j in range(m * (actions.firsts[action + 1] - actions.firsts[action])):
        dof, again = dofs[j], False
        for other in range(j):
            again |= dofs[other] == dof
        if dof < 0 or again:
            continue
        fill(room.one, 0.0, width)
        one[dof] += 1.0
        gather_forces(problem.dimension, joints.tree, width, y, room.one, room, room.all)
        fill(room.one, 0.0, width)
        for entry in range(begin, end):
            to, of = rows[entry], columns[entry]
            if to >= of and dofs[of] == dof:
                one[dofs[to]] += tangents[entry]
            if to > of and dofs[to] == dof:
                one[dofs[of]] += tangents[entry]
        gather_forces(problem.dimension, joints.tree, width, y, room.one, room, room.row)
        for k in range(y.shape[0]):
            scaled, to = gain * turned[k], first_of(k, n_all)
            for i in range(k, y.shape[0]):
                matrix[to + i] += scaled * row[i]


@njit(error_model="numpy")
def _add_borders(d, joints, width, y, scale, matrix):
    """Add the slopes of the constraints that are left, and ``w C^T C``."""
    room, n, n_left = joints.room, y.shape[0], joints.weights.size
    one, row, entries = items(room.one, width), items(room.row, width), items(room.entries, width)
    matrix, scales = items(matrix, width), items(scale, width)[()]
    n_rows, n_all, inverse = joints.starts.size - 1, n + n_left, 1.0 / scales
    for k in range(n_rows):
        fill(room.one, 0.0, width)
        for entry in range(joints.starts[k], joints.starts[k + 1]):
            one[joints.unknowns[entry]] += entries[joints.first_slope + entry]
        gather_forces(d, joints.tree, width, y, room.one, room, room.row)
        for j in range(n):
            scaled, to = joints.weights[k] * inverse * row[j], first_of(j, n_all)
            for i in range(j, n):
                matrix[to + i] += scaled * row[i]
            matrix[to + n + k] = row[j]
    for k in range(joints.driven.shape[0]):
        to = first_of(joints.driven[k, 0], n_all)
        matrix[to + joints.driven[k, 0]] += joints.weights[n_rows + k] * scales
        matrix[to + n + n_rows + k] = joints.driven[k, 2] * scales


@njit(cache=True, apart=True, error_model="numpy")
def correct_joints(
    problem, joints, matrix, block, amplitudes, angles, residual, state, gains, typical_mass, lanes, fresh, scale, size
):  # fmt: skip
    """Correct some lanes of a block; `scale` is a work array (n_lanes,), `matrix` the block's (n, n_lanes)."""
    width, every = problem.width, joints.room.all
    n, n_left = state[0].shape[0], joints.weights.size
    for lane in range(scale.size):
        scale[lane] = gains[1] * typical_mass[lane]
    evaluate_in_joints(problem, joints, block, amplitudes, angles, residual, state, gains, scale, fresh, matrix)
    if fresh:
        factorise_dense(width, n + n_left, matrix)
    x, row, inverse = items(every, width), items(joints.room.row, width), 1.0 / items(scale, width)[()]
    for k in range(n_left):
        row[k] = joints.weights[k] * inverse * x[n + k]
    substitute_dense(width, n + n_left, matrix, every)
    for k in range(n_left):
        x[n + k] += row[k]
    take_correction(joints.units, width, joints.turn, every, scale, gains, lanes, state, size)


@njit(cache=True, apart=True, error_model="numpy")
def count_turns_in_joints(problem, joints, y, turns):
    """Put the angles that unknowns do not count to those at coordinates y nearest to them: the tree's own to what these
    are, where there are others all as `kernel.count_turns` does."""
    others, known, of_y = False, items(turns, problem.width), items(y, problem.width)
    for k in range(turns.shape[0]):
        number = joints.counted[k, 0]
        others |= number == -1
        if number >= 0:
            angle = joints.counted[k, 1] * of_y[number]
            known[k] = angle + 2.0 * np.pi * nearest_whole((known[k] - angle) / (2.0 * np.pi))
    if others:
        place(problem.dimension, joints.tree, problem.width, y, y, y, joints.room)
        count_turns(problem, joints.room.q, turns)


@njit(cache=True, entry=True, error_model="numpy")
def unknowns_of(problem, joints, y, y1, y2, q, v, a):
    """Fill unknowns, velocities and accelerations (n_blocks, n_dofs, n_lanes) from coordinates and their rates."""
    for block in range(y.shape[0]):
        place(problem.dimension, joints.tree, problem.width, y[block], y1[block], y2[block], joints.room)
        q[block], v[block], a[block] = joints.room.q, joints.room.v, joints.room.a


@njit(error_model="numpy")
def fill_slopes(statements, dofs, slopes, width, q):
    """Fill the derivatives (n, 2 m, n_lanes) of statements in the unknowns of their nodes, `dofs`, (n, 2 m)."""
    statements, m, n_lanes = loaded(statements), dofs.shape[1], len(width)
    scratch, y, near = scratch_of(statements, m // 2, width), empty_lanes(m, n_lanes), np.zeros(n_lanes)
    h = empty_lanes(1, n_lanes).reshape((1, 1, n_lanes))
    for k in range(dofs.shape[0]):
        gather(dofs[k], width, q, y)
        statement(statements, k, y, near, np.bool_(False), scratch, width, slopes[k], h)
    keep(y)


@njit(cache=True, apart=True, error_model="numpy")
def hold_in_tree(problem, joints, matrix, holds, block, amplitudes, angles, state, typical_mass):
    """Fill the multipliers of what the tree's joints hold at the accelerations of a state of a block: with the ways W_i
    in which statements push the frame that a joint holds, and turn it, ``sum_j W_i W_j lambda_j = -W_i f`` for what the
    bodies behind it ask of the frame, a force f with a moment."""
    width, d, itself = problem.width, problem.dimension, np.empty((0, len(problem.width)))
    evaluate_in_joints(
        problem, joints, block, amplitudes, angles, itself, state, (0.0, 1.0, 0.0), typical_mass, False, matrix
    )
    fill_slopes(holds.statements, holds.dofs, holds.slopes, width, joints.room.q)
    slopes, ways, multipliers = items(holds.slopes, width), items(holds.ways, width), items(holds.multipliers, width)
    system, right = items(holds.matrix, width), items(holds.right, width)
    z, f = items(joints.room.z, width), items(joints.room.f, width)
    for joint in range(holds.joints.shape[0]):
        of_joint = holds.joints[joint]
        first, n, at, arm = of_joint[0], of_joint[1], d * (d + 1) * of_joint[2], joints.tree.after[of_joint[3], 0]
        for c in range(d):
            ways[n, c] = f[at + c]
        for turn in range(ways.shape[1] - d):
            one, other = (0, 1) if d == 2 else ((turn + 1) % 3, (turn + 2) % 3)
            ways[n, d + turn] = 0.0 * f[at]
            for k in range(d):
                director = at + d + d * k
                ways[n, d + turn] += z[director + one] * (f[director + other] + arm[k] * f[at + other])
                ways[n, d + turn] -= z[director + other] * (f[director + one] + arm[k] * f[at + one])
        for i in range(n):
            own, of = slopes[first + i], holds.felt[first + i]
            for c in range(3):
                ways[i, c] = own[of + c]
            for turn in range(3 if d == 3 else 0):
                one, other = (turn + 1) % 3, (turn + 2) % 3
                ways[i, d + turn] = 0.0 * f[at]
                for k in range(d):
                    director, slope = at + d + d * k, of + d + d * k
                    ways[i, d + turn] += z[director + one] * own[slope + other] - z[director + other] * own[slope + one]
        for i in range(n):
            for j in range(n + 1):
                total = 0.0 * f[at]
                for c in range(ways.shape[1]):
                    total += ways[i, c] * ways[j, c]
                if j < n:
                    system[i, j] = total
                else:
                    right[i, 0] = -total
        eliminate(n, 1, system, right)
        for i in range(n):
            multipliers[first + i] = right[i, 0]


@njit(cache=True, entry=True, error_model="numpy")
def hold_all_in_tree(problem, joints, factors, holds, amplitudes, angles, state, typical_mass, found):
    """Fill the multipliers of what the tree's joints hold in all blocks, (n_blocks, n, n_lanes); see `hold_in_tree`."""
    for block in range(found.shape[0]):
        own = state[0][block], state[1][block], state[2][block], state[3][block], state[4][block]
        hold_in_tree(
            problem, joints, borrowed(factors.matrix)[block], holds, block, amplitudes, angles, own, typical_mass[block]
        )
        for k in range(found.shape[1]):
            for lane in range(found.shape[2]):
                found[block, k, lane] = holds.multipliers[k, lane]
