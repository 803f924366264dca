"""Frames of the nodes of local effects in the reduced model, LANES samples at a time, compiled.

The natural frame ``(p, d_1 .. d_d)`` of a node is that of the reconstruction (`reduction.reconstruction`),

    p = z(theta) + sum_j u_j D_j(theta),   d_k = sum_j exp(phi)_jk D_j,
    (u, phi) = Psi(theta) delta + 1/2 chi(theta) delta delta,

with z and the body's directors D from the rigid kinematics on a fine grid, and Psi, chi in the body's frame. The
Jacobian with eta is the exact derivative of what is interpolated. z, D, Psi and chi are sums of terms with weights that
a sample's parameters give, as all tables are: one term of weight 1 where the mechanism has no parameters.

Rotations by a vector phi, compiled: ``exp(phi)``, and its change ``exp(phi) (spin x .)`` with phi.

exp(phi) = 1 + a P + b P^2,    spin = (1 - b P + c P^2) phi',    P = phi x,  t = |phi|,
a = sin(t) / t,    b = (1 - cos(t)) / t^2,    c = (t - sin(t)) / t^3

All take numbers or vectors (`lane_items`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import WIDE, beyond, items, select, sine_cosine, square_root
from pgmp_petsc.lanes.vectors import (
    N_POWERS,
    add,
    add_product,
    dot,
    load,
    load_rows,
    polynomial,
    spread,
    store,
    zeros,
)
from pgmp_petsc.reduced.cells import Cells, Grid, enter_cells, refill

SMALL = 1e-2  # of t^2, below which the first terms of the series are exact to round-off


@njit(cache=True, error_model="numpy")
def factors_of(phi):
    """Return a, b and c of a vector phi (3,), rad."""
    square = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    a = 1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0)))
    b = 0.5 * (1.0 - square / 12.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0 * (1.0 - square / 90.0))))
    c = (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0 * (1.0 - square / 110.0)))) / 6.0
    large, t = beyond(square, SMALL), square_root(square)
    sine, cosine = sine_cosine(t)
    return (
        select(large, sine / t, a),
        select(large, (1.0 - cosine) / square, b),
        select(large, (t - sine) / (t * square), c),
    )


@njit(cache=True, error_model="numpy")
def rotation_of(phi, factors, turn):
    """Fill the rotation (3, 3) of a vector phi (3,), rad, with `factors_of` it."""
    x, y, z = phi[0], phi[1], phi[2]
    a, b, _ = factors
    turn[0, 0], turn[0, 1], turn[0, 2] = 1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    turn[1, 0], turn[1, 1], turn[1, 2] = b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x
    turn[2, 0], turn[2, 1], turn[2, 2] = b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)


@njit(cache=True, error_model="numpy")
def spin_of(phi, factors, rate, spin):
    """Fill the spin (3,) in the turned frame for a rate (3,) of phi (3,), rad/s, with `factors_of` phi."""
    x, y, z = phi[0], phi[1], phi[2]
    _, b, c = factors
    # phi x phi', and phi x that
    e, f, g = y * rate[2] - z * rate[1], z * rate[0] - x * rate[2], x * rate[1] - y * rate[0]
    spin[0] = rate[0] - b * e + c * (y * g - z * f)
    spin[1] = rate[1] - b * f + c * (z * e - x * g)
    spin[2] = rate[2] - b * g + c * (x * f - y * e)


class Places(NamedTuple):
    """Where actions hold."""

    fine: tuple[Grid, ...]  # cells of `rigid` along every coordinate
    #: on this grid: the nodes' frames on the rigid mechanism, and the angles that actions measure less their winding, 0
    #: for what is no angle, n_nodes * n_frame + n_parts entries
    rigid: Cells
    shapes: Cells  # of Psi and chi, n_nodes * n_dofs * n_shapes entries
    together: np.ndarray  # as many zeros as there are terms: all of them add to one polynomial
    #: what these angles turn with each coordinate on the whole, shape (n_parts, n_theta)
    winding: np.ndarray
    #: node of both sides of each statement that the actions measure, -1 on the ground, shape (n_parts, 2)
    sides: np.ndarray
    n_nodes: int  # number of nodes
    felt: np.ndarray  # which displacements and rotations of theirs actions are of, bool, shape (n_nodes, n_dofs)


class KeptPlaces(NamedTuple):
    """Polynomials of the cells that the samples of a block are in."""

    cells: np.ndarray  # numbers of the cells of `shapes` and `rigid`, -1 before the first, vectors (2, LANES)
    weights: np.ndarray  # of the terms of the places, vectors (n_terms, LANES)
    #: rigid, shapes: see `Places`; vectors (n_coefficients, LANES)
    rigid: np.ndarray
    shapes: np.ndarray


class Frames(NamedTuple):
    """Frames of the nodes of a block of samples, with what they are made of; arrays of vectors (..., LANES)."""

    place: np.ndarray  # in the cells, (n_theta), rad
    #: rigid, rigid_slopes: tables at theta, and their derivatives, coordinate after coordinate, or how fast they change
    rigid: np.ndarray
    rigid_slopes: np.ndarray
    #: moved, moving: displacements and rotations of the nodes in their bodies' frames, (n_nodes, n_dofs), and
    #: derivatives of one node's, (n_dofs, n_eta), or how fast they change, (n_dofs, 1); see `place_nodes`
    moved: np.ndarray
    moving: np.ndarray
    #: turn, spin: ``exp(phi)`` in space and its change with a coordinate, (3, 3) and (3)
    turn: np.ndarray
    spin: np.ndarray
    #: frames, jacobians: of the nodes, (n_nodes, n_frame) and (n_nodes, n_frame, n_eta or 1)
    frames: np.ndarray
    jacobians: np.ndarray


@njit(error_model="numpy", forceinline=True, counted=False)
def place_nodes(places, nodes, grid, d, q, v, kept, work):
    """Fill some nodes' frames in d dimensions, and their derivatives with eta, for vectors q (n_eta, LANES); or, where
    `work` has room for one column of these, how fast frames change at velocities v, in a part of the time.

    `grid` are the cells of the shapes.
    """
    along, velocity = work.jacobians.shape[2] < q.shape[0], load_rows(v, 0, 1, grid)
    _come_to_cells(places.rigid, places.together, places.fine, q, 1, kept, kept.rigid, work.place)
    place = load_rows(work.place, 0, 1, grid)
    n_rigid = work.rigid.shape[0]
    for entry in range(n_rigid):
        value, slopes = polynomial(kept.rigid, entry, place)
        store(work.rigid, entry, value)
        if along:
            store(work.rigid_slopes, entry, dot(slopes, velocity))
        for k in range(0 if along else len(grid)):
            store(work.rigid_slopes, k * n_rigid + entry, slopes[k])
    _come_to_cells(places.shapes, places.together, grid, q, 0, kept, kept.shapes, work.place)
    for number in range(nodes.size):
        place_node(places, nodes[number], grid, d, q, v, kept, work)


@njit(error_model="numpy", forceinline=True, counted=False)
def place_node(places, node, grid, d, q, v, kept, work):
    """Fill a node's frame and its derivatives, of which what is rigid is there; see `place_nodes`."""
    n_dofs, place, n_columns = d * (d + 1) // 2, load_rows(work.place, 0, 1, grid), work.jacobians.shape[2]
    n_theta, along = len(grid), n_columns < q.shape[0]
    n_shapes = kept.shapes.shape[0] // (N_POWERS**n_theta * n_dofs * places.n_nodes)
    for dof in range(n_dofs):
        at = (n_dofs * node + dof) * n_shapes
        if not places.felt[node, dof]:
            store(work.moved, node * n_dofs + dof, 0.0)
            for i in range(n_columns):
                store(work.moving, dof * n_columns + i, 0.0)
        elif along:
            _displace_along(kept.shapes, at, n_shapes, place, q, v, node, dof, work)
        else:
            _displace(kept.shapes, at, n_shapes, place, q, node, dof, work)
    if d == 2:
        _turn_in_plane(node, 1 if along else n_theta, work)
    else:
        _turn_in_space(node, 1 if along else n_theta, work)


@njit(inline="always")
def _come_to_cells(table, together, grid, q, row, kept, into, place):
    """Bring kept polynomials to the cells that vectors q are in, and fill the places in them."""
    moved = enter_cells(q, grid, place, kept.cells, row)
    if moved != 0:
        refill(table, kept.cells[row], moved, kept.weights, together, 0, into)


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _displace(shapes, at, n_shapes, place, q, node, dof, work):
    """Fill ``Psi delta + 1/2 chi delta delta`` of one component and its derivatives; its shapes begin at `at`."""
    r, n = len(place), q.shape[0]
    m, first = n - r, dof * n
    total, slopes = spread(0.0), zeros(place)
    for i in range(m):
        shape, bends = polynomial(shapes, at + i, place)
        delta = load(q, r + i)
        total += shape * delta  # Psi_i delta_i
        slopes = add_product(slopes, bends, delta)  # (d Psi_i) delta_i
        store(work.moving, first + r + i, shape)
    pair = at + m
    for i in range(m if n_shapes > m else 0):
        delta = load(q, r + i)
        for j in range(i):
            shape, bends = polynomial(shapes, pair + j, place)
            other = load(q, r + j)
            total += shape * (delta * other)  # chi_ij delta_i delta_j
            slopes = add_product(slopes, bends, delta * other)
            add(work.moving, first + r + i, shape * other)
            add(work.moving, first + r + j, shape * delta)
        shape, bends = polynomial(shapes, pair + i, place)
        total += shape * (0.5 * delta * delta)  # 1/2 chi_ii delta_i^2
        slopes = add_product(slopes, bends, 0.5 * delta * delta)
        add(work.moving, first + r + i, shape * delta)
        pair += i + 1
    store(work.moved, node * work.moved.shape[1] + dof, total)
    for k in range(r):
        store(work.moving, first + k, slopes[k])


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _displace_along(shapes, at, n_shapes, place, q, v, node, dof, work):
    """Fill ``Psi delta + 1/2 chi delta delta`` of one component and how fast it changes; see `_displace`."""
    r, n = len(place), q.shape[0]
    m, pair = n - r, at + n - r
    total, rate, slopes = spread(0.0), spread(0.0), zeros(place)
    for i in range(m):
        shape, bends = polynomial(shapes, at + i, place)
        delta, speed = load(q, r + i), load(v, r + i)
        total += shape * delta
        rate += shape * speed
        slopes = add_product(slopes, bends, delta)
        for j in range(i + 1 if n_shapes > m else 0):
            shape, bends = polynomial(shapes, pair + j, place)
            share = 0.5 if i == j else 1.0
            product = share * delta * load(q, r + j)
            total += shape * product
            rate += shape * (share * (delta * load(v, r + j) + speed * load(q, r + j)))
            slopes = add_product(slopes, bends, product)
        pair += i + 1
    rate += dot(slopes, load_rows(v, 0, 1, place))
    store(work.moved, node * work.moved.shape[1] + dof, total)
    store(work.moving, dof, rate)


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _turn_in_plane(node, r, work):
    """Turn a node's displacement and rotation from the body's frame, and add the rigid motion."""
    n_frame = 6
    frame, jacobian = items(work.frames, WIDE)[node], items(work.jacobians, WIDE)[node]
    moved, moving = items(work.moved, WIDE)[node], items(work.moving, WIDE)
    rigid, slopes = items(work.rigid, WIDE), items(work.rigid_slopes, WIDE)
    first = n_frame * node
    sine, cosine = sine_cosine(moved[2])
    for c in range(2):
        one, other = rigid[first + 2 + c], rigid[first + 4 + c]  # D_1, D_2
        ahead, across = cosine * one + sine * other, cosine * other - sine * one
        frame[c] = rigid[first + c] + moved[0] * one + moved[1] * other
        frame[2 + c], frame[4 + c] = ahead, across
        for i in range(jacobian.shape[1]):
            jacobian[c, i] = moving[0, i] * one + moving[1, i] * other  # u_j' D_j
            jacobian[2 + c, i] = moving[2, i] * across  # phi' d_2
            jacobian[4 + c, i] = -moving[2, i] * ahead  # -phi' d_1
        for k in range(r):
            at = k * (rigid.size) + first
            one, other = slopes[at + 2 + c], slopes[at + 4 + c]
            jacobian[c, k] += slopes[at + c] + moved[0] * one + moved[1] * other  # z' + u_j D_j'
            jacobian[2 + c, k] += cosine * one + sine * other
            jacobian[4 + c, k] += cosine * other - sine * one


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _turn_in_space(node, r, work):
    """Turn a node's displacement and rotation from the body's frame, and add the rigid motion."""
    n_frame = 12
    frame, jacobian = items(work.frames, WIDE)[node], items(work.jacobians, WIDE)[node]
    moved, moving = items(work.moved, WIDE)[node], items(work.moving, WIDE)
    rigid, slopes = items(work.rigid, WIDE), items(work.rigid_slopes, WIDE)
    turn, spin = items(work.turn, WIDE), items(work.spin, WIDE)
    first = n_frame * node
    factors = factors_of(moved[3:])
    rotation_of(moved[3:], factors, turn)
    for c in range(3):
        frame[c] = rigid[first + c]
        for j in range(3):
            frame[c] += moved[j] * rigid[first + 3 + 3 * j + c]
            total = turn[0, j] * rigid[first + 3 + c]
            for k in range(1, 3):
                total += turn[k, j] * rigid[first + 3 + 3 * k + c]
            frame[3 + 3 * j + c] = total
    for i in range(jacobian.shape[1]):
        spin_of(moved[3:], factors, moving[3:, i], spin)
        for c in range(3):
            total = moving[0, i] * rigid[first + 3 + c]
            for j in range(1, 3):
                total += moving[j, i] * rigid[first + 3 + 3 * j + c]  # u_j' D_j
            jacobian[c, i] = total
            for j in range(3):
                # d_k' = spin x d_k, in the turned frame
                after, before = (j + 1) % 3, (j + 2) % 3
                jacobian[3 + 3 * j + c, i] = (
                    spin[before] * frame[3 + 3 * after + c] - spin[after] * frame[3 + 3 * before + c]
                )
    for i in range(r):
        at = i * rigid.size + first
        for c in range(3):
            total = slopes[at + c]
            for j in range(3):
                total += moved[j] * slopes[at + 3 + 3 * j + c]  # u_j D_j'
                turned = turn[0, j] * slopes[at + 3 + c]
                for k in range(1, 3):
                    turned += turn[k, j] * slopes[at + 3 + 3 * k + c]
                jacobian[3 + 3 * j + c, i] += turned  # exp(phi)_kj D_k'
            jacobian[c, i] += total


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def pull_displacements(node, d, felt, work, loads):
    """Fill what a node's frame feels (n_frame,) as forces on its displacement and rotation in the body's frame,
    (n_dofs,), items; the node has been placed."""
    rigid, frame, moved = items(work.rigid, WIDE), items(work.frames, WIDE)[node], items(work.moved, WIDE)[node]
    first = d * (d + 1) * node
    for j in range(d):
        total = spread(0.0)
        for c in range(d):
            total += felt[c] * rigid[first + d + d * j + c]  # u_j D_j
        loads[j] = total
    if d == 2:
        total = spread(0.0)
        for c in range(2):
            total += felt[2 + c] * frame[4 + c] - felt[4 + c] * frame[2 + c]
        loads[2] = total
        return
    spin, rate, factors = items(work.spin, WIDE), items(work.turn, WIDE)[0], factors_of(moved[3:])
    for i in range(3):
        for j in range(3):
            rate[j] = spread(1.0 if i == j else 0.0)
        spin_of(moved[3:], factors, rate, spin)
        total = spread(0.0)
        for k in range(3):
            after, before = (k + 1) % 3, (k + 2) % 3
            for c in range(3):
                change = spin[before] * frame[3 + 3 * after + c] - spin[after] * frame[3 + 3 * before + c]
                total += felt[3 + 3 * k + c] * change
        loads[3 + i] = total
