"""Local effects in the reduced model, LANES samples at a time, compiled, in the plane and in space.

With the frames of its two nodes and their Jacobian J (`action_frames`), an action (`effects.action`) with the statement
s, its gradient g and second derivative h in the frames adds to the equations of motion

    r -= J^T F g,     dr/d eta = J^T ((k + gain_v c) g g^T - F h) J,     k = -dF/ds,  c = -dF/ds'

without the change of J with eta. A measure that is the sum of functions f_i of several statements has ``g = sum_i f_i'
g_i`` and ``h = sum_i (f_i' h_i + f_i'' g_i g_i^T)``, each in the frames of its own two nodes. Of a law that is led by
the action before it (`effects.action`) ``k + gain_v c`` is with the product of its own g and of g there, of one that
rubs k alone, without what follows from the other rate. An angle is that turn of its joint which is nearest to the rigid
mechanism's. Laws are evaluated lane by lane: they have cases.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types

from pgmp_petsc.effects.action import BY_LOAD, LEADS, LED, Actions
from pgmp_petsc.effects.law import obey
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import WIDE, aligned, items
from pgmp_petsc.lanes.vectors import LANES, N_POWERS, add, aligned_zeros, differing, load, spread, store
from pgmp_petsc.mechanism.statement_rows import is_itself, through_function
from pgmp_petsc.mechanism.statements import evaluate
from pgmp_petsc.reduced.action_frames import Frames, Places, place_nodes, pull_displacements

POWER, STORED, FORCE = range(3)  # what is known of an action
UNBALANCED = 1e-7  # of a law's force: what a step may leave of it out of balance
ABOUT = 3  # of an iteration, the rate at which its law was evaluated last; NaN before that, infinite where limited


class Chosen(NamedTuple):
    """Some of the actions, and the nodes that they hold at: increasing numbers, each of shape (n,)."""

    actions: np.ndarray
    nodes: np.ndarray


class LocalEffects(NamedTuple):
    """The actions of a batch, where they hold, and which there are: all of them, and those whose law has an edge."""

    places: Places
    actions: Actions
    all: Chosen
    with_edges: Chosen


class Acting(NamedTuple):
    """Terms that actions add to the equations of motion of a batch; empty where there are none."""

    balance: np.ndarray  # ``- J^T F g`` of all actions, shape (n_blocks, n_eta, LANES)
    tangent: np.ndarray  # its derivative with eta, shape (n_blocks, n_eta, n_eta, LANES)

    @classmethod
    def empty(cls, n_blocks: int, n_eta: int) -> Acting:
        """Return what is zero so far."""
        return cls(aligned_zeros((n_blocks, n_eta, LANES)), aligned_zeros((n_blocks, n_eta, n_eta, LANES)))


class LocalWork(NamedTuple):
    """Work arrays of local effects, for one block of samples; arrays of vectors (..., LANES)."""

    frames: Frames  # of the nodes
    #: z, gradient, spare: of the two frames of a term, (2 n_frame)
    z: np.ndarray
    gradient: np.ndarray
    spare: np.ndarray
    hessian: np.ndarray  # of its function, (2 n_frame, 2 n_frame)
    jacobian: np.ndarray  # of its frames, (2 n_frame, n_eta)
    function: np.ndarray  # its value, slope and second derivative in the statement, (3)
    #: bent, projected: a row of h J, and ``J^T g`` of an action, (n_eta); leading: that of the action that leads
    bent: np.ndarray
    projected: np.ndarray
    leading: np.ndarray
    measured: np.ndarray  # see below, (7)
    #: of each law that bends what its rate follows from, measure, rate, force, stiffness, damping and the rate of the
    #: action that leads, (n, n_eta + 6)
    bending: np.ndarray
    felt: np.ndarray  # by the nodes' frames, (n_nodes, n_frame)

    @classmethod
    def of(cls, local: LocalEffects, r: int, n_eta: int) -> LocalWork:
        """Return arrays of any numbers; with one in place of n_eta those for rates in place of Jacobians
        (`place_nodes`)."""
        d, n_nodes = local.actions.statements.axes.shape[2], local.places.n_nodes
        n_frame, n_dofs = d * (d + 1), d * (d + 1) // 2
        n_rigid = local.places.rigid.polynomials.shape[2] // N_POWERS**r
        n, n_bending = 2 * n_frame, int(np.sum(local.actions.laws.bend))
        of_frames = (
            (r,), (n_rigid,), (r * n_rigid,), (n_nodes, n_dofs), (n_dofs, n_eta), (3, 3), (3,), (n_nodes, n_frame),
            (n_nodes, n_frame, n_eta),
        )  # fmt: skip
        own = (
            (n,), (n,), (n,), (n, n), (n, n_eta), (3,), (n_eta,), (n_eta,), (n_eta,), (LEADING + 1,),
            (n_bending, n_eta + 6), (n_nodes, n_frame),
        )  # fmt: skip
        frames = Frames(*(aligned((*shape, LANES)) for shape in of_frames))
        return cls(frames, *(aligned((*shape, LANES)) for shape in own))


#: Rows of `LocalWork.measured`: the measure that the law is of and its rate, the force and its derivatives, and the
#: rate of what it acts along, and of what the last action measured that is of its own.
MEASURE, RATE, STRENGTH, STIFFNESS, DAMPING, ALONG, LEADING = range(7)


@njit(cache=True, apart=True, error_model="numpy", counted=False)
def act(
    local, chosen, grid, amplitudes, q, v, samples, lanes, gain_v, with_tangent, limiting, work, kept, acting, known,
    depths
):  # fmt: skip
    """Evaluate the `chosen` actions on a block, with amplitudes now, vectors (n_actions, LANES), at q and v, (n_eta,
    LANES).

    The samples in its lanes have the numbers `samples`, (LANES,); laws are evaluated in a set of `lanes`, others have
    no forces, and limited (`Law.about_zero`) where `limiting`. gain_v is the derivative of eta' with eta within a step,
    a vector; `acting.tangent` is filled where it is wanted (`with_tangent`). `work` and `kept` are those of the block,
    `LocalWork` and `KeptPlaces`.

    Filled are `acting`, of this block; `known`, power of what is not elastic (W), potential energy (J) and force (N or
    N m), (n_samples, 3, n_actions), in whose fourth row rates are kept for the next iterate; and how far each edge of a
    law is crossed, negative where it is not, `depths`, (n_samples, n_edges).
    """
    places, actions = local.places, local.actions
    n, r = q.shape[0], len(grid)
    for i in range(n):
        store(acting.balance, i, 0.0)
        for j in range(n if with_tangent else 0):
            store(acting.tangent, i * n + j, 0.0)
    place_nodes(places, chosen.nodes, grid, actions.statements.axes.shape[2], q, v, kept, work.frames)
    n_bending = 0
    for number in range(chosen.actions.size):
        action = chosen.actions[number]
        first, last, role = actions.firsts[action], actions.firsts[action + 1], actions.roles[action]
        single = last - first == 1
        _find_force(
            local, action, r, amplitudes, q, v, samples, lanes, with_tangent and single, limiting, work, known, depths
        )
        if limiting and actions.laws.bend[action]:
            _keep(work.leading if role == LED else work.projected, work.measured, n_bending, work.bending)
            n_bending += 1
        if role == LEADS or (action + 1 < actions.roles.size and actions.roles[action + 1] == BY_LOAD):
            for i in range(n):
                store(work.leading, i, load(work.projected, i))
        if role == LEADS:
            continue
        force = load(work.measured, STRENGTH)
        for i in range(n):
            add(acting.balance, i, -force * load(work.projected, i))
        if with_tangent:
            stiffness, damping = load(work.measured, STIFFNESS), gain_v * load(work.measured, DAMPING)
            if role == BY_LOAD:
                _stiffen(stiffness, work, work.leading, acting.tangent)
                stiffness = spread(0.0)
            _stiffen(stiffness + damping, work, work.leading if role == LED else work.projected, acting.tangent)
            for term in range(first, last if differing(force, spread(0.0)) != 0 else first):
                if not single:
                    measure_term(local, term, r, q, True, True, work)
                _turn(force, work, acting.tangent)


@njit(error_model="numpy", counted=False)
def _find_force(local, action, r, amplitudes, q, v, samples, lanes, second, limiting, work, known, depths):
    """Fill what an action measures and the force of its law, with its nodes placed; see `act` and `measure`."""
    role = local.actions.roles[action]
    s, rate = measure(local, action, r, q, v, second, work)
    store(work.measured, ALONG, rate)
    if role != LED:
        store(work.measured, RATE, rate)
        if role != BY_LOAD:
            store(work.measured, MEASURE, s)
            store(work.measured, LEADING, rate)
    _obey(local.actions, action, amplitudes, samples, lanes, limiting, work.measured, known, depths)


@njit(error_model="numpy", counted=False)
def _keep(along, measured, number, bending):
    """Keep what a law was evaluated at."""
    n = along.shape[0]
    first = number * (n + 6)
    for i in range(n):
        store(bending, first + i, load(along, i))
    store(bending, first + n, load(measured, MEASURE))
    store(bending, first + n + 1, load(measured, RATE))
    store(bending, first + n + 2, load(measured, STRENGTH))
    store(bending, first + n + 3, load(measured, STIFFNESS))
    store(bending, first + n + 4, load(measured, DAMPING))
    store(bending, first + n + 5, load(measured, LEADING))


@njit(cache=True, apart=types.int64, error_model="numpy", counted=False)
def bent_lanes(local, amplitudes, v, gain_v, samples, lanes, work, depths):
    """Return those of some lanes in which a law that bends is not linear from where it was evaluated last to the rates
    v (n_eta, LANES), which change by gain_v with what it measures: how the iteration contracted before says nothing
    there; see `act`."""
    laws, n, number, found = local.actions.laws, v.shape[0], 0, 0
    for action in range(laws.addresses.size):
        if not laws.bend[action]:
            continue
        rate, kept, first = spread(0.0), work.bending[number], number * (n + 6)
        for i in range(n):
            rate += load(work.bending, first + i) * load(v, i)
        store(work.measured, ALONG, rate)
        store(work.measured, MEASURE, (rate - load(work.bending, first + n + 1)) / gain_v)
        number += 1
        for lane in range(LANES):
            if lanes & (1 << lane):
                p, edges = local.actions.parameters[action, samples[lane]], depths[samples[lane], laws.edges[action] :]
                s, before, force = kept[n, lane], kept[n + 1, lane], kept[n + 2, lane]
                after, way = work.measured[ALONG, lane], work.measured[MEASURE, lane]
                amplitude = amplitudes[action, lane]
                if local.actions.roles[action] == BY_LOAD:  # its measure is that of the action that leads
                    amplitude, way = kept[n + 5, lane], 0.0
                now = obey(laws.addresses[action], p, amplitude, s + way, after, np.nan, edges).force
                off = abs(now - force + kept[n + 3, lane] * way + kept[n + 4, lane] * (after - before))
                found |= np.int64(not off <= UNBALANCED * (abs(now) + abs(force))) << lane
    return found


@njit(error_model="numpy", counted=False)
def forget_rates(known, samples, lanes):
    """Begin an iteration of some lanes: no law is known to have been evaluated."""
    for lane in range(LANES):
        if lanes & (1 << lane):
            for action in range(known.shape[2]):
                known[samples[lane], ABOUT, action] = np.nan


@njit(error_model="numpy", counted=False)
def limited_lanes(known, samples, lanes):
    """Return those of some lanes of which a law was limited."""
    found = 0
    for lane in range(LANES):
        if lanes & (1 << lane):
            for action in range(known.shape[2]):
                found |= np.int64(np.isinf(known[samples[lane], ABOUT, action])) << lane
    return found


@njit(error_model="numpy", counted=False)
def measure(local, action, n_theta, q, v, second, work):
    """Return what an action measures and its rate, and fill ``J^T g``, or that rate, with its nodes placed.

    `second` asks for the second derivatives of its last term.
    """
    firsts, n_columns, s, rate = local.actions.firsts, work.projected.shape[0], spread(0.0), spread(0.0)
    for i in range(n_columns):
        store(work.projected, i, 0.0)
    for term in range(firsts[action], firsts[action + 1]):
        s += measure_term(local, term, n_theta, q, True, second, work)
        _project(work)
    if n_columns < q.shape[0]:
        return s, load(work.projected, 0)
    for i in range(n_columns):
        rate += load(work.projected, i) * load(v, i)
    return s, rate


@njit(error_model="numpy", counted=False)
def measure_term(local, term, n_theta, q, moving, second, work):
    """Return a term of a measure, and fill its two frames, where they are `moving` their Jacobian, and its derivatives
    in them."""
    places, statements = local.places, local.actions.statements
    _attach(places, statements, term, moving, work)
    turned = load(work.frames.rigid, work.frames.rigid.shape[0] - places.sides.shape[0] + term)
    for k in range(n_theta):
        turned += places.winding[term, k] * load(q, k)
    s = evaluate(
        statements.kinds[term], statements.axes[term], items(work.z, WIDE), turned, second, items(work.gradient, WIDE),
        items(work.hessian, WIDE), items(work.spare, WIDE),
    )  # fmt: skip
    if is_itself(statements, term):
        return s
    return through_function(
        statements, term, s, second, work.function, WIDE, items(work.gradient, WIDE), items(work.hessian, WIDE)
    )


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _attach(places, statements, term, moving, work):
    """Fill the two frames of a term and, where they are `moving`, their Jacobian."""
    d, n = statements.axes.shape[2], statements.ground.shape[1] // 2
    z, jacobian = items(work.z, WIDE), items(work.jacobian, WIDE)
    frames, jacobians = items(work.frames.frames, WIDE), items(work.frames.jacobians, WIDE)
    n_eta = jacobian.shape[1] if moving else 0
    for side in range(2):
        first, node = n * side, places.sides[term, side]
        if node < 0:
            for c in range(n):
                z[first + c] = statements.ground[term, first + c]
                for i in range(n_eta):
                    jacobian[first + c, i] = 0.0
            continue
        for c in range(n):
            z[first + c] = frames[node, c]
            for i in range(n_eta):
                jacobian[first + c, i] = jacobians[node, c, i]
        for j in range(d):
            arm = statements.arms[term, side, j]
            if arm != 0.0:
                for c in range(d):
                    at = first + d + d * j + c
                    z[first + c] += arm * z[at]
                    for i in range(n_eta):
                        jacobian[first + c, i] += arm * jacobian[at, i]


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _project(work):
    """Add ``J^T g`` of a term."""
    n_eta = work.projected.shape[0]
    for c in range(work.gradient.shape[0]):
        slope = load(work.gradient, c)
        if differing(slope, spread(0.0)) != 0:  # few are not
            for i in range(n_eta):
                add(work.projected, i, slope * load(work.jacobian, c * n_eta + i))


@njit(cache=True, apart=True, error_model="numpy", counted=False)
def load_nodes(local, grid, amplitudes, q, v, samples, lanes, work, kept, known, depths, loads):
    """Fill what the actions do to displacements and rotations of their nodes in body frames, (n_nodes, n_dofs, LANES):
    ``F g`` in these. Other arguments are as of `act`, `work` with room for rates alone."""
    places, actions, d, r = local.places, local.actions, local.actions.statements.axes.shape[2], len(grid)
    n_frame, nodes = d * (d + 1), local.all.nodes
    gradients, felt = items(work.gradient, WIDE), items(work.felt, WIDE)
    place_nodes(places, nodes, grid, d, q, v, kept, work.frames)
    for entry in range(places.n_nodes * n_frame):
        store(work.felt, entry, 0.0)
    for action in range(actions.roles.size):
        first, last = actions.firsts[action], actions.firsts[action + 1]
        _find_force(
            local, action, r, amplitudes, q, v, samples, lanes, np.bool_(False), np.bool_(False), work, known, depths
        )
        for term in range(last if actions.roles[action] == LEADS else first, last):
            if last - first > 1:
                measure_term(local, term, r, q, False, False, work)
            for side in range(2):
                node, arms = places.sides[term, side], actions.statements.arms[term, side]
                for c in range(n_frame if node >= 0 else 0):
                    pull = load(work.measured, STRENGTH) * gradients[n_frame * side + c]
                    felt[node, c] += pull
                    for j in range(d if c < d else 0):  # a point at an arm moves with the directors
                        felt[node, d + d * j + c] += arms[j] * pull
    for number in range(nodes.size):
        pull_displacements(nodes[number], d, felt[nodes[number]], work.frames, items(loads, WIDE)[nodes[number]])


@njit(error_model="numpy", counted=False)
def _obey(actions, action, amplitudes, samples, lanes, limiting, measured, known, depths):
    """Evaluate an action's law in some lanes, no force in others, and note what is `known`, and `depths`."""
    address, edge = actions.laws.addresses[action], actions.laws.edges[action]
    for lane in range(LANES):
        if not lanes & (1 << lane):
            measured[STRENGTH, lane] = measured[STIFFNESS, lane] = measured[DAMPING, lane] = 0.0
            continue
        p, of_sample = actions.parameters[action, samples[lane]], known[samples[lane]]
        s, rate, led = measured[MEASURE, lane], measured[RATE, lane], actions.roles[action] == LED
        about = of_sample[ABOUT, action] if limiting else np.nan
        amplitude = measured[LEADING, lane] if actions.roles[action] == BY_LOAD else amplitudes[action, lane]
        found = obey(address, p, amplitude, s, rate, about, depths[samples[lane], edge:])
        measured[STRENGTH, lane], measured[STIFFNESS, lane] = found.force, found.stiffness
        measured[DAMPING, lane] = found.damping
        elastic, stored = (0.0, 0.0) if led else (found.elastic, found.stored)
        of_sample[POWER, action], of_sample[STORED, action] = (found.force - elastic) * measured[ALONG, lane], stored
        of_sample[FORCE, action], of_sample[ABOUT, action] = found.force, found.about


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _stiffen(stiffness, work, leading, tangent):
    """Add ``J^T (stiffness g l^T) J`` to the tangent (n_eta, n_eta, LANES), with ``leading = J^T l``."""
    n = work.projected.shape[0]
    for i in range(n):
        across = stiffness * load(work.projected, i)
        for j in range(n):
            add(tangent, i * n + j, across * load(leading, j))


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _turn(force, work, tangent):
    """Take ``J^T F h J`` of a term off the tangent (n_eta, n_eta, LANES)."""
    n, n_pair = work.projected.shape[0], work.z.shape[0]
    for c in range(n_pair):
        touched = False
        for d in range(n_pair):
            bent = load(work.hessian, c * n_pair + d)
            if differing(bent, spread(0.0)) != 0:  # few are not
                bent = bent * force
                for j in range(n):
                    part = bent * load(work.jacobian, d * n + j)
                    store(work.bent, j, load(work.bent, j) + part if touched else part)
                touched = True
        if touched:
            for i in range(n):
                turn = load(work.jacobian, c * n + i)
                for j in range(n):
                    add(tangent, i * n + j, -turn * load(work.bent, j))


@njit(error_model="numpy", forceinline=True, counted=False)
def add_tangents(tangent, r, matrix):
    """Add the actions' tangents (n_eta, n_eta, LANES) to the iteration matrix.

    A force that turns with its body has no symmetric tangent; its mean serves the symmetric flexible block.
    """
    n = tangent.shape[0]
    m = n - r
    into = 0
    for i in range(m):
        for j in range(i + 1):
            both = load(tangent, (r + i) * n + r + j) + load(tangent, (r + j) * n + r + i)
            add(matrix.factor, into, 0.5 * both)
            into += 1
        for k in range(r):
            add(matrix.column, k * m + i, load(tangent, (r + i) * n + k))
            add(matrix.row, k * m + i, load(tangent, k * n + r + i))
    for k in range(r):
        for j in range(r):
            add(matrix.corner, k * r + j, load(tangent, k * n + j))
