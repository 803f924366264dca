"""Local effects in the reduced model, sample by sample, compiled.

The frame ``zeta = (x, y, phi)`` of a node is that of the reconstruction (`reduction.reconstruction`),

    zeta = z(theta) + R(Phi(theta)) u,     u = Psi(theta) delta + 1/2 chi(theta) delta delta,

with z and the body's angle Phi from the rigid kinematics on a fine grid, and Psi, chi in the body's frame; J is the
exact derivative of what is interpolated. An action (`effects.action`) with the measure s, its gradient g and second
derivative h in the frames then adds to the equations of motion

    r -= J^T F g,     dr/d eta = J^T ((k + gain_v c) g g^T - F h) J,     k = -dF/ds,  c = -dF/ds'

without the change of J with eta.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.dynamics.cells import evaluate_row, locate_all
from pgmp_petsc.dynamics.lanes import LANES, aligned_zeros
from pgmp_petsc.effects.action import Actions
from pgmp_petsc.effects.laws import depth, law
from pgmp_petsc.effects.measures import ROTATION, measure
from pgmp_petsc.runtime.compiled import njit

N_FRAME, N_PAIR = 3, 6
POWER, STORED, DEPTH, FORCE = range(4)  # what is known of an action beside its force


class Places(NamedTuple):
    """Where actions hold.

    Attributes
    ----------
    rigid
        Polynomials of z on the fine grid, angles less their winding, shape (n_cells, 4**n_theta, n_nodes * 3).
    shapes
        Polynomials of Psi and chi, shape (n_cells, 4**n_theta, n_nodes * 3 * n_shapes).
    winding
        Turns of the node's body for each turn of a coordinate, shape (n_nodes, n_theta).
    sides
        Node of both sides of each action, -1 on the ground, shape (n_actions, 2).
    arms
        From the node to the point, in the body's frame, shape (n_actions, 2, 2), m.
    ground
        Frames of sides on the ground, shape (n_actions, 6).
    """

    rigid: np.ndarray
    shapes: np.ndarray
    winding: np.ndarray
    sides: np.ndarray
    arms: np.ndarray
    ground: np.ndarray


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
        In the cells, shape (n_theta, 1).
    rigid, rigid_slopes, shapes, shape_slopes
        Tables at one theta, and their derivatives.
    frames, jacobians
        Of the nodes, shapes (n_nodes, 3) and (n_nodes, 3, n_eta).
    z, rates, gradient
        Of one action's two frames, shape (6,).
    hessian
        Of its measure, shape (6, 6).
    jacobian, bent
        Of its frames, J and h J, shape (6, n_eta).
    projected
        ``J^T g``, shape (n_eta,).
    """

    place: np.ndarray
    rigid: np.ndarray
    rigid_slopes: np.ndarray
    shapes: np.ndarray
    shape_slopes: np.ndarray
    frames: np.ndarray
    jacobians: np.ndarray
    z: np.ndarray
    rates: np.ndarray
    gradient: np.ndarray
    hessian: np.ndarray
    jacobian: np.ndarray
    bent: np.ndarray
    projected: np.ndarray


@njit(cache=True, error_model="numpy")
def allocate_local(places, r, n_eta):
    """Return work arrays."""
    n_nodes, n_entries = places.winding.shape[0], places.shapes.shape[2]
    return LocalWork(
        np.zeros((r, 1)),
        np.zeros(N_FRAME * n_nodes),
        np.zeros((r, N_FRAME * n_nodes)),
        np.zeros(n_entries),
        np.zeros((r, n_entries)),
        np.zeros((n_nodes, N_FRAME)),
        np.zeros((n_nodes, N_FRAME, n_eta)),
        np.zeros(N_PAIR),
        np.zeros(N_PAIR),
        np.zeros(N_PAIR),
        np.zeros((N_PAIR, N_PAIR)),
        np.zeros((N_PAIR, n_eta)),
        np.zeros((N_PAIR, n_eta)),
        np.zeros(n_eta),
    )


@njit(cache=True, error_model="numpy")
def place_nodes(places, grids, q, sample, work):
    """Fill the nodes' frames and their derivatives with eta, for a sample's q (n_samples, n_eta)."""
    fine, grid = grids
    r, n = len(grid), q.shape[1]
    m = n - r
    cell = locate_all(q, sample, fine, 0, work.place)
    evaluate_row(places.rigid[cell], fine, work.place[0, 0], work.place[-1, 0], work.rigid, work.rigid_slopes)
    cell = locate_all(q, sample, grid, 0, work.place)
    evaluate_row(places.shapes[cell], grid, work.place[0, 0], work.place[-1, 0], work.shapes, work.shape_slopes)
    n_nodes = places.winding.shape[0]
    n_shapes = work.shapes.size // max(1, N_FRAME * n_nodes)
    for node in range(n_nodes):
        frame, jacobian = work.frames[node], work.jacobians[node]
        for d in range(N_FRAME):
            at = (N_FRAME * node + d) * n_shapes
            frame[d] = _displace(work.shapes, at, q, sample, r, m, n_shapes)
            for k in range(r):
                jacobian[d, k] = _displace(work.shape_slopes[k], at, q, sample, r, m, n_shapes)
            for i in range(m):
                jacobian[d, r + i] = work.shapes[at + i]
            _add_curvature(work.shapes, at, q, sample, r, m, n_shapes, jacobian[d])
        _turn(places, node, q, sample, r, work)


@njit(inline="always")
def _displace(shapes, at, q, sample, r, m, n_shapes):
    """Return ``Psi delta + 1/2 chi delta delta`` for one component, whose shapes begin at `at`."""
    total = 0.0
    for i in range(m):
        total += shapes[at + i] * q[sample, r + i]
    if n_shapes > m:
        pair = at + m
        for i in range(m):
            for j in range(i + 1):
                total += (0.5 if i == j else 1.0) * shapes[pair] * q[sample, r + i] * q[sample, r + j]
                pair += 1
    return total


@njit(inline="always")
def _add_curvature(shapes, at, q, sample, r, m, n_shapes, row):
    """Add ``chi delta`` to a row of the Jacobian (n_eta,)."""
    if n_shapes > m:
        pair = at + m
        for i in range(m):
            for j in range(i + 1):
                row[r + i] += shapes[pair] * q[sample, r + j]
                if i != j:
                    row[r + j] += shapes[pair] * q[sample, r + i]
                pair += 1


@njit(inline="always")
def _turn(places, node, q, sample, r, work):
    """Turn a node's displacement and its derivatives from the body's frame, and add the rigid motion."""
    frame, jacobian, first = work.frames[node], work.jacobians[node], N_FRAME * node
    angle = work.rigid[first + 2]
    for k in range(r):
        angle += places.winding[node, k] * q[sample, k]
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = cos * frame[0] - sin * frame[1], sin * frame[0] + cos * frame[1]
    for i in range(jacobian.shape[1]):
        along, across = jacobian[0, i], jacobian[1, i]
        jacobian[0, i], jacobian[1, i] = cos * along - sin * across, sin * along + cos * across
    for k in range(r):
        spin = work.rigid_slopes[k, first + 2] + places.winding[node, k]
        jacobian[0, k] += work.rigid_slopes[k, first] - spin * y
        jacobian[1, k] += work.rigid_slopes[k, first + 1] + spin * x
        jacobian[2, k] += spin
    frame[0], frame[1] = work.rigid[first] + x, work.rigid[first + 1] + y
    frame[2] += angle


@njit(cache=True, error_model="numpy")
def _attach(places, action, work):
    """Fill an action's two frames and their Jacobian."""
    for side in range(2):
        first, node = N_FRAME * side, places.sides[action, side]
        if node < 0:
            for c in range(first, first + N_FRAME):
                work.z[c] = places.ground[action, c]
                for i in range(work.projected.size):
                    work.jacobian[c, i] = 0.0
            continue
        frame, jacobian, arm = work.frames[node], work.jacobians[node], places.arms[action, side]
        cos, sin = np.cos(frame[2]), np.sin(frame[2])
        x, y = cos * arm[0] - sin * arm[1], sin * arm[0] + cos * arm[1]
        work.z[first], work.z[first + 1], work.z[first + 2] = frame[0] + x, frame[1] + y, frame[2]
        for i in range(jacobian.shape[1]):
            work.jacobian[first, i] = jacobian[0, i] - y * jacobian[2, i]
            work.jacobian[first + 1, i] = jacobian[1, i] + x * jacobian[2, i]
            work.jacobian[first + 2, i] = jacobian[2, i]


@njit(cache=True, error_model="numpy")
def evaluate_local(local, grids, amplitudes, state, gain_v, active, with_tangent, acting, known):
    """Evaluate all actions on the active samples.

    Parameters
    ----------
    grids
        Cells of the rigid kinematics and of the tables.
    amplitudes
        Of the actions now, shape (n_actions,).
    state
        ``(q, v)``, each of shape (n_samples, n_eta).
    active
        Shape (n_samples,).
    with_tangent
        Whether `acting.tangent` is wanted.
    acting
        Result.
    known
        Result: power of what is not elastic (W), potential energy (J), depth in a stop, NaN for other laws, and force
        (N or N m); shape (n_samples, 4, n_actions).
    """
    work = allocate_local(local.places, len(grids[0]), state[0].shape[1])
    for sample in range(active.size):
        if active[sample]:
            block, lane = divmod(sample, LANES)
            acting.balance[block, :, lane] = 0.0
            if with_tangent:
                acting.tangent[block, :, :, lane] = 0.0
            _act(
                local, grids, amplitudes, state, sample, gain_v, with_tangent, work,
                acting.balance[block], acting.tangent[block], known[sample],
            )  # fmt: skip


@njit(inline="always")
def _act(local, grids, amplitudes, state, sample, gain_v, with_tangent, work, balance, tangent, known):
    """Add all actions on one sample to its lane of balance (n_eta, LANES) and tangent (n_eta, n_eta, LANES)."""
    places, actions = local
    q, v = state
    n, lane = q.shape[1], sample % LANES
    place_nodes(places, grids, q, sample, work)
    for action in range(places.sides.shape[0]):
        _attach(places, action, work)
        kind, p = actions.measures[action], actions.parameters[action, sample]
        s = measure(kind, actions.directions[action], work.z, work.gradient, work.hessian)
        rate = 0.0
        for i in range(n):
            projected = 0.0
            for c in range(N_PAIR):
                projected += work.gradient[c] * work.jacobian[c, i]
            work.projected[i] = projected
            rate += projected * v[sample, i]
        force, stiffness, damping, elastic, potential = law(actions.laws[action], p, amplitudes[action], s, rate)
        known[POWER, action], known[STORED, action] = (force - elastic) * rate, potential
        known[DEPTH, action], known[FORCE, action] = depth(actions.laws[action], p, s), force
        for i in range(n):
            balance[i, lane] -= force * work.projected[i]
        if with_tangent:
            _add_tangent(kind, stiffness + gain_v * damping, force, lane, work, tangent)


@njit(cache=True, error_model="numpy")
def _add_tangent(kind, stiffness, force, lane, work, tangent):
    """Add ``J^T (stiffness g g^T - F h) J`` to one lane of the tangent (n_eta, n_eta, LANES)."""
    n = work.projected.size
    for i in range(n):
        for j in range(n):
            tangent[i, j, lane] += stiffness * work.projected[i] * work.projected[j]
    if kind == ROTATION:
        return
    for c in range(N_PAIR):
        for j in range(n):
            total = 0.0
            for d in range(N_PAIR):
                total += work.hessian[c, d] * work.jacobian[d, j]
            work.bent[c, j] = force * total
    for i in range(n):
        for c in range(N_PAIR):
            for j in range(n):
                tangent[i, j, lane] -= work.jacobian[c, i] * work.bent[c, j]


@njit(cache=True, error_model="numpy")
def add_tangents(tangent, r, factor, border):
    """Add the actions' tangents (n_eta, n_eta, LANES) to the iteration matrix.

    A force that turns with its body has no symmetric tangent; its mean serves the symmetric flexible block.
    """
    m, n_lanes = tangent.shape[0] - r, tangent.shape[2]
    into = 0
    for i in range(m):
        for j in range(i + 1):
            for lane in range(n_lanes):
                factor[into, lane] += 0.5 * (tangent[r + i, r + j, lane] + tangent[r + j, r + i, lane])
            into += 1
        for k in range(r):
            for lane in range(n_lanes):
                border[r * r + k * m + i, lane] += tangent[r + i, k, lane]
                border[r * r + (r + k) * m + i, lane] += tangent[k, r + i, lane]
    for k in range(r):
        for j in range(r):
            for lane in range(n_lanes):
                border[k * r + j, lane] += tangent[k, j, lane]
