"""Local effects in the reduced model, sample by sample, compiled, in the plane and in space.

The frame ``zeta = (p, d_1 .. d_d)`` of a node is that of the reconstruction (`reduction.reconstruction`),

    p = z(theta) + sum_j u_j D_j(theta),   d_k = sum_j exp(phi)_jk D_j,
    (u, phi) = Psi(theta) delta + 1/2 chi(theta) delta delta,

with z and the body's directors D from the rigid kinematics on a fine grid, and Psi, chi in the body's frame; J is the
exact derivative of what is interpolated. An action (`effects.action`) with the statement s, its gradient g and second
derivative h in the frames then adds to the equations of motion

    r -= J^T F g,     dr/d eta = J^T ((k + gain_v c) g g^T - F h) J,     k = -dF/ds,  c = -dF/ds'

without the change of J with eta. An angle is that turn of its joint which is nearest to the rigid mechanism's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.dynamics.cells import Grid, evaluate_row, locate_lane
from pgmp_petsc.dynamics.rotations import rotation_of, spin_of
from pgmp_petsc.runtime.vectors import LANES, aligned_zeros
from pgmp_petsc.effects.action import Actions
from pgmp_petsc.effects.laws import depth, law
from pgmp_petsc.mechanism.statements import evaluate
from pgmp_petsc.runtime.compiled import njit

POWER, STORED, DEPTH, FORCE = range(4)  # what is known of an action beside its force


class Places(NamedTuple):
    """Where actions hold.

    Attributes
    ----------
    fine
        Cells of `rigid` along every coordinate.
    rigid
        Polynomials on this grid: the nodes' frames on the rigid mechanism, and the angles of the actions less their
        winding, 0 where they have none, shape (n_cells, 4**n_theta, n_nodes * n_frame + n_actions).
    shapes
        Polynomials of Psi and chi, shape (n_cells, 4**n_theta, n_nodes * n_dofs * n_shapes).
    winding
        What the angles of the actions turn with each coordinate on the whole, shape (n_actions, n_theta).
    sides
        Node of both sides of each action, -1 on the ground, shape (n_actions, 2).
    """

    fine: tuple[Grid, ...]
    rigid: np.ndarray
    shapes: np.ndarray
    winding: np.ndarray
    sides: np.ndarray


class LocalEffects(NamedTuple):
    """The actions of a batch, and where they hold."""

    places: Places
    actions: Actions


class Acting(NamedTuple):
    """What the actions on a batch add to its equations of motion; empty where there are none.

    Attributes
    ----------
    balance
        ``- J^T F g`` of all actions, shape (n_blocks, n_eta, LANES).
    tangent
        Its derivative with eta, shape (n_blocks, n_eta, n_eta, LANES).
    """

    balance: np.ndarray
    tangent: np.ndarray

    @classmethod
    def empty(cls, n_blocks: int, n_eta: int) -> Acting:
        """Return what is zero so far."""
        return cls(aligned_zeros((n_blocks, n_eta, LANES)), aligned_zeros((n_blocks, n_eta, n_eta, LANES)))


class LocalWork(NamedTuple):
    """Work arrays of local effects, for one sample.

    Attributes
    ----------
    place
        In the cells, shape (n_theta, LANES).
    rigid, rigid_slopes, shapes, shape_slopes
        Tables at one theta, and their derivatives.
    moved, moving
        Displacement and rotation of a node in its body's frame, always in space, shape (6,), and derivatives (6,
        n_eta).
    turn, spin
        ``exp(phi)`` and its change with a coordinate, shapes (3, 3) and (3,).
    frames, jacobians
        Of the nodes, shapes (n_nodes, n_frame) and (n_nodes, n_frame, n_eta).
    z, gradient
        Of one action's two frames, shape (2 n_frame,).
    hessian
        Of its statement, shape (2 n_frame, 2 n_frame).
    jacobian
        Of its frames, shape (2 n_frame, n_eta).
    bent, projected
        A row of h J, and ``J^T g``, shape (n_eta,).
    """

    place: np.ndarray
    rigid: np.ndarray
    rigid_slopes: np.ndarray
    shapes: np.ndarray
    shape_slopes: np.ndarray
    moved: np.ndarray
    moving: np.ndarray
    turn: np.ndarray
    spin: np.ndarray
    frames: np.ndarray
    jacobians: np.ndarray
    z: np.ndarray
    gradient: np.ndarray
    hessian: np.ndarray
    jacobian: np.ndarray
    bent: np.ndarray
    projected: np.ndarray


@njit(cache=True, error_model="numpy")
def allocate_local(local, r, n_eta):
    """Return work arrays."""
    n_rigid, n_entries = local.places.rigid.shape[2], local.places.shapes.shape[2]
    n_frame = local.actions.statements.ground.shape[1] // 2
    n_nodes = (n_rigid - local.places.sides.shape[0]) // n_frame
    return LocalWork(
        np.zeros((r, LANES)),
        np.zeros(n_rigid),
        np.zeros((r, n_rigid)),
        np.zeros(n_entries),
        np.zeros((r, n_entries)),
        np.zeros(6),
        np.zeros((6, n_eta)),
        np.zeros((3, 3)),
        np.zeros(3),
        np.zeros((n_nodes, n_frame)),
        np.zeros((n_nodes, n_frame, n_eta)),
        np.zeros(2 * n_frame),
        np.zeros(2 * n_frame),
        np.zeros((2 * n_frame, 2 * n_frame)),
        np.zeros((2 * n_frame, n_eta)),
        np.zeros(n_eta),
        np.zeros(n_eta),
    )


@njit(cache=True, error_model="numpy", counted=False)
def place_nodes(local, grid, q, lane, work):
    """Fill the nodes' frames and their derivatives with eta, for one lane of q (n_eta, LANES)."""
    places, fine = local.places, local.places.fine
    r, n, d = len(grid), q.shape[0], local.actions.statements.axes.shape[2]
    m = n - r
    cell = locate_lane(q, fine, lane, work.place)
    evaluate_row(places.rigid[cell], fine, work.place[0, lane], work.place[-1, lane], work.rigid, work.rigid_slopes)
    cell = locate_lane(q, grid, lane, work.place)
    evaluate_row(places.shapes[cell], grid, work.place[0, lane], work.place[-1, lane], work.shapes, work.shape_slopes)
    n_nodes, n_dofs = work.frames.shape[0], d * (d + 1) // 2
    n_shapes = work.shapes.size // max(1, n_dofs * n_nodes)
    for node in range(n_nodes):
        for dof in range(n_dofs):
            at = (n_dofs * node + dof) * n_shapes
            into = dof if dof < d else 6 - n_dofs + dof  # in the plane phi turns about the third axis
            work.moved[into] = _displace(work.shapes, at, q, lane, r, m, n_shapes)
            row = work.moving[into]
            for k in range(r):
                row[k] = _displace(work.shape_slopes[k], at, q, lane, r, m, n_shapes)
            for i in range(m):
                row[r + i] = work.shapes[at + i]
            _add_curvature(work.shapes, at, q, lane, r, m, n_shapes, row)
        _turn(d, node, r, work)


@njit(inline="always")
def _displace(shapes, at, q, lane, r, m, n_shapes):
    """Return ``Psi delta + 1/2 chi delta delta`` for one component, whose shapes begin at `at`."""
    total = 0.0
    for i in range(m):
        total += shapes[at + i] * q[r + i, lane]
    if n_shapes > m:
        pair = at + m
        for i in range(m):
            for j in range(i + 1):
                total += (0.5 if i == j else 1.0) * shapes[pair] * q[r + i, lane] * q[r + j, lane]
                pair += 1
    return total


@njit(inline="always")
def _add_curvature(shapes, at, q, lane, r, m, n_shapes, row):
    """Add ``chi delta`` to a row of the Jacobian (n_eta,)."""
    if n_shapes > m:
        pair = at + m
        for i in range(m):
            for j in range(i + 1):
                row[r + i] += shapes[pair] * q[r + j, lane]
                if i != j:
                    row[r + j] += shapes[pair] * q[r + i, lane]
                pair += 1


@njit(cache=True, error_model="numpy", counted=False)
def _turn(d, node, r, work):
    """Turn a node's displacement and rotation from the body's frame, and add the rigid motion."""
    n_frame = d * (d + 1)
    frame, jacobian, rigid = work.frames[node], work.jacobians[node], work.rigid[n_frame * node : n_frame * (node + 1)]
    turn, spin = work.turn, work.spin
    rotation_of(work.moved[3:], turn)
    for c in range(d):
        frame[c] = rigid[c]
        for j in range(d):
            frame[c] += work.moved[j] * rigid[d + d * j + c]
            frame[d + d * j + c] = 0.0
            for k in range(d):
                frame[d + d * j + c] += turn[k, j] * rigid[d + d * k + c]
    for i in range(jacobian.shape[1]):
        spin_of(work.moved[3:], work.moving[3:, i], spin)
        for c in range(d):
            jacobian[c, i] = 0.0
            for j in range(d):
                jacobian[c, i] += work.moving[j, i] * rigid[d + d * j + c]  # u_j' D_j
                total = 0.0
                for k in range(d):
                    # exp(phi) (spin x e_j)
                    after, before = (j + 1) % 3, (j + 2) % 3
                    total += (turn[k, after] * spin[before] - turn[k, before] * spin[after]) * rigid[d + d * k + c]
                jacobian[d + d * j + c, i] = total
    for i in range(r):
        slope = work.rigid_slopes[i, n_frame * node : n_frame * (node + 1)]
        for c in range(d):
            jacobian[c, i] += slope[c]
            for j in range(d):
                jacobian[c, i] += work.moved[j] * slope[d + d * j + c]  # u_j D_j'
                for k in range(d):
                    jacobian[d + d * j + c, i] += turn[k, j] * slope[d + d * k + c]


@njit(cache=True, error_model="numpy", counted=False)
def _attach(places, actions, action, work):
    """Fill an action's two frames and their Jacobian."""
    statements = actions.statements
    d, n = statements.axes.shape[2], statements.ground.shape[1] // 2
    for side in range(2):
        first, node = n * side, places.sides[action, side]
        if node < 0:
            for c in range(first, first + n):
                work.z[c] = statements.ground[action, c]
                work.jacobian[c] = 0.0
            continue
        for c in range(n):
            work.z[first + c] = work.frames[node, c]
            for i in range(work.projected.size):
                work.jacobian[first + c, i] = work.jacobians[node, c, i]
        for j in range(d):
            arm = statements.arms[action, side, j]
            if arm != 0.0:
                for c in range(d):
                    at = first + d + d * j + c
                    work.z[first + c] += arm * work.z[at]
                    for i in range(work.projected.size):
                        work.jacobian[first + c, i] += arm * work.jacobian[at, i]


@njit(cache=True, error_model="numpy", counted=False)
def act(local, grid, amplitudes, q, v, samples, lanes, gain_v, with_tangent, work, acting, known):
    """Evaluate all actions on some lanes of a block.

    Parameters
    ----------
    grid
        Cells of the tables.
    amplitudes
        Of the actions now, shape (n_actions,).
    q, v
        Vectors (n_eta, LANES).
    samples
        Number of the sample in each lane, shape (LANES,).
    lanes
        A set of them.
    with_tangent
        Whether `acting.tangent` is wanted.
    work
        See `LocalWork`.
    acting
        Result, of this block.
    known
        Result: power of what is not elastic (W), potential energy (J), depth in a stop, NaN for other laws, and force
        (N or N m); shape (n_samples, 4, n_actions).
    """
    for lane in range(LANES):
        if lanes & (1 << lane):
            for i in range(q.shape[0]):
                acting.balance[i, lane] = 0.0
                if with_tangent:
                    for j in range(q.shape[0]):
                        acting.tangent[i, j, lane] = 0.0
            _act(
                local, grid, amplitudes, q, v, samples[lane], lane, gain_v, with_tangent, work, acting.balance,
                acting.tangent, known[samples[lane]],
            )  # fmt: skip


@njit(inline="always")
def _act(local, grid, amplitudes, q, v, sample, lane, gain_v, with_tangent, work, balance, tangent, known):
    """Add all actions on one sample to its lane of balance (n_eta, LANES) and tangent (n_eta, n_eta, LANES)."""
    places, actions = local
    n, n_actions, r = q.shape[0], places.sides.shape[0], len(grid)
    place_nodes(local, grid, q, lane, work)
    for action in range(n_actions):
        _attach(places, actions, action, work)
        p = actions.parameters[action, sample]
        turned = work.rigid[work.rigid.size - n_actions + action]
        for k in range(r):
            turned += places.winding[action, k] * q[k, lane]
        kind, axes = actions.statements.kinds[action], actions.statements.axes[action]
        s = evaluate(kind, axes, work.z, turned, with_tangent, work.gradient, work.hessian)
        rate = 0.0
        work.projected[:] = 0.0
        for c in range(work.gradient.size):
            if work.gradient[c] != 0.0:
                for i in range(n):
                    work.projected[i] += work.gradient[c] * work.jacobian[c, i]
        for i in range(n):
            rate += work.projected[i] * v[i, lane]
        force, stiffness, damping, elastic, potential = law(actions.laws[action], p, amplitudes[action], s, rate)
        known[POWER, action], known[STORED, action] = (force - elastic) * rate, potential
        known[DEPTH, action], known[FORCE, action] = depth(actions.laws[action], p, s), force
        for i in range(n):
            balance[i, lane] -= force * work.projected[i]
        if with_tangent:
            _add_tangent(stiffness + gain_v * damping, force, lane, work, tangent)


@njit(cache=True, error_model="numpy", counted=False)
def _add_tangent(stiffness, force, lane, work, tangent):
    """Add ``J^T (stiffness g g^T - F h) J`` to one lane of the tangent (n_eta, n_eta, LANES)."""
    n = work.projected.size
    for i in range(n):
        for j in range(n):
            tangent[i, j, lane] += stiffness * work.projected[i] * work.projected[j]
    if force == 0.0:
        return
    for c in range(work.z.size):
        work.bent[:] = 0.0
        for d in range(work.z.size):
            if work.hessian[c, d] != 0.0:  # few of them are not
                for j in range(n):
                    work.bent[j] += force * work.hessian[c, d] * work.jacobian[d, j]
        for i in range(n):
            if work.jacobian[c, i] != 0.0:
                for j in range(n):
                    tangent[i, j, lane] -= work.jacobian[c, i] * work.bent[j]


@njit(cache=True, error_model="numpy", counted=False)
def add_tangents(tangent, r, matrix):
    """Add the actions' tangents (n_eta, n_eta, LANES) to the iteration matrix.

    A force that turns with its body has no symmetric tangent; its mean serves the symmetric flexible block.
    """
    m = tangent.shape[0] - r
    into = 0
    for i in range(m):
        for j in range(i + 1):
            for lane in range(LANES):
                matrix.factor[into, lane] += 0.5 * (tangent[r + i, r + j, lane] + tangent[r + j, r + i, lane])
            into += 1
        for k in range(r):
            for lane in range(LANES):
                matrix.column[k * m + i, lane] += tangent[r + i, k, lane]
                matrix.row[k * m + i, lane] += tangent[k, r + i, lane]
    for k in range(r):
        for j in range(r):
            for lane in range(LANES):
                matrix.corner[k * r + j, lane] += tangent[k, j, lane]
