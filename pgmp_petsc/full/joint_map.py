"""From joint coordinates y to the unknowns q of all frames, and forces back, compiled.

    q = q(y),    q' = N y',    q'' = N y'' + g(y, y');    r_y = N^T r_q

A frame is its position and directors, ``z = (p, d_1 .. d_d)``. On the way outward each frame follows from the one
before it: a joint's from that which it is on, ``p + D c``, ``D A``; what it holds from its own motion; the floating
frame of a body from that which holds it, and all others of the body from the floating one, with the ties of
`mechanism.constraint_set` solved for them:

    P = p + sum_k d_k w_k,    D_k = sum_l d_l R_lk(s),    w = X + (A + 1/2 a xi) xi,    s = Theta xi,
    R = c + s x + s s^T / (1 + c),    c^2 = 1 - s.s,    in the plane the rotation by s.

All are bilinear but for R, so that rates and accelerations are of the same form, and forces go the way back by the
transposed steps: nothing is solved for. Samples lie side by side in the last axis (lanes).
"""

from typing import NamedTuple

import numpy as np

from pgmp_petsc.full.joint_tree import BALL, BY_AXES, FREE
from pgmp_petsc.full.layout import by_dimension
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import items, sine_cosine, square_root

N_TURNED = 6  # rotation matrices that are kept of a face: its own, its rate and acceleration, derivatives in s


class Room(NamedTuple):
    """Work space of a block, each of shape (n, n_lanes)."""

    #: q, v, a: unknowns of all frames and amplitudes, and their rates
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    #: z, z1, z2, f: frames, their rates, and forces on them; in space the beginnings of the unknowns and of `x`
    z: np.ndarray
    z1: np.ndarray
    z2: np.ndarray
    f: np.ndarray
    x: np.ndarray  # residual of the unknowns, and of the constraints that are left
    local: np.ndarray  # frames of a joint
    ways: np.ndarray  # places of each face, rates, accelerations, and how amplitudes move and turn it
    turned: np.ndarray  # matrices of each face, `N_TURNED`
    entries: np.ndarray  # packed tangents of floating bodies, and behind them the slopes of constraints
    one: np.ndarray  # forces of one constraint or action, by unknown
    row: np.ndarray  # the same by coordinate
    all: np.ndarray  # residual by coordinate, and of the constraints that are left
    #: spare, inertia, columns, moves, forces: see `joint_matrix`: inertia of all nodes, (1 + d, 1 + d) each, columns of
    #: all coordinates, and what the amplitudes of a body do
    spare: np.ndarray
    inertia: np.ndarray
    columns: np.ndarray
    moves: np.ndarray
    forces: np.ndarray


@njit(error_model="numpy")
def _frame(z, at, place, turn, axes, out, to):
    """Fill the frame at a place and a turn in another: ``p + D c``, ``D A``."""
    d = len(axes)
    for c in range(d):
        total = z[at + c]
        for k in range(d):
            total += place[k] * z[at + d + d * k + c]
        out[to + c] = total
    for j in range(d):
        for c in range(d):
            total = turn[0, j] * z[at + d + c]
            for k in range(1, d):
                total += turn[k, j] * z[at + d + d * k + c]
            out[to + d + d * j + c] = total


@njit(error_model="numpy")
def _held(z, at, arm, turn, axes, out, to):
    """Fill the frame that a joint holds from the joint's: ``D B^T``, ``p - D B^T c``."""
    d = len(axes)
    for k in range(d):
        for c in range(d):
            total = turn[k, 0] * z[at + d + c]
            for j in range(1, d):
                total += turn[k, j] * z[at + d + d * j + c]
            out[to + d + d * k + c] = total
    for c in range(d):
        total = z[at + c]
        for k in range(d):
            total -= arm[k] * out[to + d + d * k + c]
        out[to + c] = total


@njit(error_model="numpy")
def _move(tree, k, axes, y, y1, y2, e):
    """Move the frames e of a joint, its own, their rates and accelerations, by what it turns and slides."""
    d = len(axes)
    n, turning, sliding = d * (d + 1), tree.firsts[k, 0], tree.firsts[k, 1]
    if sliding >= 0:
        s, s1, s2 = y[sliding], y1[sliding], y2[sliding]
        for c in range(d):
            way, way1, way2 = e[d + c], e[n + d + c], e[2 * n + d + c]
            e[c] += way * s
            e[n + c] += way1 * s + way * s1
            e[2 * n + c] += way2 * s + 2.0 * way1 * s1 + way * s2
    if turning >= 0:
        sin, cos = sine_cosine(y[turning])
        rate, more = y1[turning], y2[turning]
        one, other = d + d * (d - 2), d + d * (d - 1)
        for c in range(d):
            x, x1, x2 = e[one + c], e[n + one + c], e[2 * n + one + c]
            w, w1, w2 = e[other + c], e[n + other + c], e[2 * n + other + c]
            first, second = cos * x + sin * w, cos * w - sin * x
            first1, second1 = cos * x1 + sin * w1, cos * w1 - sin * x1  # as it would be carried along
            e[one + c], e[other + c] = first, second
            e[n + one + c], e[n + other + c] = first1 + rate * second, second1 - rate * first
            e[2 * n + one + c] = cos * x2 + sin * w2 + 2.0 * rate * second1 + more * second - rate * rate * first
            e[2 * n + other + c] = cos * w2 - sin * x2 - 2.0 * rate * first1 - more * first - rate * rate * second


@njit(error_model="numpy")
def _deform(tree, face, axes, n, x, x1, x2, first, ways, turned):
    """Fill how a face is displaced and turned in its body, amplitudes x (n,) from `first` on."""
    d = len(axes)
    n_turns, m = 1 if d == 2 else 3, d * d
    own, to = ways[face], turned[face]
    at, bent = tree.at[face, 0], tree.at[face, 1]
    zero = x[first] * 0.0
    for l in range(d):
        w, w1, w2 = zero + tree.centres[face, l], zero, zero
        for i in range(n):
            plain = zero + tree.shapes[at + l * n + i]
            way = plain
            if bent >= 0:
                row, moving = bent + l * n + i, zero
                for entry in range(tree.rows[row], tree.rows[row + 1]):
                    way += tree.bent[entry] * x[first + tree.columns[entry]]
                    moving += tree.bent[entry] * x1[first + tree.columns[entry]]
                w2 += moving * x1[first + i]
            own[3 * d + l * n + i] = way
            w += 0.5 * (plain + way) * x[first + i]
            w1 += way * x1[first + i]
            w2 += way * x2[first + i]
        own[l], own[d + l], own[2 * d + l] = w, w1, w2
    for t in range(n_turns):
        s, s1, s2 = zero, zero, zero
        for i in range(n):
            turn = tree.shapes[at + (d + t) * n + i]
            own[3 * d + (d + t) * n + i] = zero + turn
            s += turn * x[first + i]
            s1 += turn * x1[first + i]
            s2 += turn * x2[first + i]
        to[3 * m + t], to[4 * m + t], to[5 * m + t] = s, s1, s2  # until they are overwritten below
    if d == 2:
        s, s1, s2 = to[3 * m], to[4 * m], to[5 * m]
        sin, cos = sine_cosine(s)
        to[0], to[1], to[2], to[3] = cos, -sin, sin, cos
        to[3 * m], to[3 * m + 1], to[3 * m + 2], to[3 * m + 3] = -sin, -cos, cos, -sin
        for i in range(m):
            to[m + i] = s1 * to[3 * m + i]
            to[2 * m + i] = s2 * to[3 * m + i] - s1 * s1 * to[i]
    else:
        _rotate(to)


@njit(error_model="numpy")
def _rotate(to):
    """Fill R, its rate and acceleration, and its derivatives in s, from s, s' and s'' where the latter go."""
    m = 9
    a, b, c = to[27], to[28], to[29]
    a1, b1, c1 = to[36], to[37], to[38]
    a2, b2, c2 = to[45], to[46], to[47]
    cos = square_root(1.0 - (a * a + b * b + c * c))
    k = 1.0 / (1.0 + cos)
    cos1 = -(a * a1 + b * b1 + c * c1) / cos
    k1 = -k * k * cos1
    cos2 = -((a1 * a1 + b1 * b1 + c1 * c1) + (a * a2 + b * b2 + c * c2) + cos1 * cos1) / cos
    k2 = -k * k * cos2 + 2.0 * k * k * k * cos1 * cos1
    s, s1, s2 = (a, b, c), (a1, b1, c1), (a2, b2, c2)
    for i in range(3):
        for j in range(3):
            both = s[i] * s[j]
            both1 = s1[i] * s[j] + s[i] * s1[j]
            both2 = s2[i] * s[j] + 2.0 * s1[i] * s1[j] + s[i] * s2[j]
            to[3 * i + j] = k * both
            to[m + 3 * i + j] = k1 * both + k * both1
            to[2 * m + 3 * i + j] = k2 * both + 2.0 * k1 * both1 + k * both2
            for t in range(3):
                slope = s[t] / cos
                value = k * k * slope * both
                if t == i:
                    value += k * s[j]
                if t == j:
                    value += k * s[i]
                to[(3 + t) * m + 3 * i + j] = value
        to[4 * i] += cos
        to[m + 4 * i] += cos1
        to[2 * m + 4 * i] += cos2
        for t in range(3):
            to[(3 + t) * m + 4 * i] -= s[t] / cos
    for t in range(3):
        i, j = (t + 1) % 3, (t + 2) % 3  # (e_t x)_ji = 1, e_t x e_i = e_j
        to[3 * j + i] += s[t]
        to[3 * i + j] -= s[t]
        to[m + 3 * j + i] += s1[t]
        to[m + 3 * i + j] -= s1[t]
        to[2 * m + 3 * j + i] += s2[t]
        to[2 * m + 3 * i + j] -= s2[t]
        to[(3 + t) * m + 3 * j + i] += 1.0
        to[(3 + t) * m + 3 * i + j] -= 1.0


@njit(cache=True, apart=True, error_model="numpy")
def _place(axes, tree, width, y, y1, y2, room):
    """Fill the unknowns of all frames and amplitudes, their rates and accelerations from coordinates (n_y, n_lanes)."""
    d = len(axes)
    n = d * (d + 1)
    y, y1, y2 = items(y, width), items(y1, width), items(y2, width)
    q, v, a = items(room.q, width), items(room.v, width), items(room.a, width)
    z, z1, z2 = items(room.z, width), items(room.z1, width), items(room.z2, width)
    e, ways, turned = items(room.local, width), items(room.ways, width), items(room.turned, width)
    zero = y[0] * 0.0
    for k in range(tree.kinds.size):
        on, held, base = tree.nodes[k, 0], tree.nodes[k, 1], tree.nodes[k, 2]
        natural, first, n_own = tree.firsts[k, 2], tree.firsts[k, 3], tree.n_amplitudes[k]
        angle, angle1, angle2 = zero, zero, zero
        for i in range(n_own):
            at = tree.internal[k] + i
            q[at], v[at], a[at] = y[first + i], y1[first + i], y2[first + i]
        for face in range(tree.faces[k], tree.faces[k + 1]):
            _deform(tree, face, axes, n_own, y, y1, y2, first, ways, turned)
        if tree.kinds[k] == FREE:
            if d == 3:
                for c in range(n):
                    z[n * base + c], z1[n * base + c] = y[natural + c], y1[natural + c]
                    z2[n * base + c] = y2[natural + c]
            else:
                angle, angle1, angle2 = y[natural + 2], y1[natural + 2], y2[natural + 2]
                sin, cos = sine_cosine(angle)
                at = n * base
                for c in range(2):
                    z[at + c], z1[at + c], z2[at + c] = y[natural + c], y1[natural + c], y2[natural + c]
                z[at + 2], z[at + 3], z[at + 4], z[at + 5] = cos, sin, -sin, cos
                for c in range(2):
                    one, other, sign = at + 2 + c, at + 4 + c, angle1 * angle1
                    z1[one], z1[other] = angle1 * z[other], -angle1 * z[one]
                    z2[one], z2[other] = angle2 * z[other] - sign * z[one], -angle2 * z[one] - sign * z[other]
        else:
            if on < 0:
                for c in range(3 * n):
                    e[c] = zero
                for c in range(d):
                    e[c] = zero + tree.before[k, 0, c]
                    for j in range(d):
                        e[d + d * j + c] = zero + tree.before[k, 1 + c, j]
            else:
                spot, triad = tree.before[k, 0], tree.before[k, 1:]
                _frame(z, n * on, spot, triad, axes, e, 0)
                _frame(z1, n * on, spot, triad, axes, e, n)
                _frame(z2, n * on, spot, triad, axes, e, 2 * n)
                if d == 2:
                    angle, angle1, angle2 = q[3 * on + 2], v[3 * on + 2], a[3 * on + 2]
            to = n * held
            if tree.kinds[k] == BALL:
                arm = tree.after[k, 0]
                for c in range(d * d):
                    z[to + d + c], z1[to + d + c] = y[natural + c], y1[natural + c]
                    z2[to + d + c] = y2[natural + c]
                for c in range(d):
                    p, p1, p2 = e[c], e[n + c], e[2 * n + c]
                    for j in range(d):
                        at = to + d + d * j + c
                        p, p1, p2 = p - arm[j] * z[at], p1 - arm[j] * z1[at], p2 - arm[j] * z2[at]
                    z[to + c], z1[to + c], z2[to + c] = p, p1, p2
            else:
                _move(tree, k, axes, y, y1, y2, e)
                arm, triad = tree.after[k, 0], tree.after[k, 1:]
                _held(e, 0, arm, triad, axes, z, to)
                _held(e, n, arm, triad, axes, z1, to)
                _held(e, 2 * n, arm, triad, axes, z2, to)
                angle = angle + tree.rest[k]
                if tree.firsts[k, 0] >= 0:
                    turning = tree.firsts[k, 0]
                    angle, angle1, angle2 = angle + y[turning], angle1 + y1[turning], angle2 + y2[turning]
            if d == 2:
                q[3 * held + 2], v[3 * held + 2], a[3 * held + 2] = angle, angle1, angle2
            for face in range(tree.faces[k], tree.faces[k + 1]):
                if tree.face_nodes[face] == held:
                    _frame_beyond(ways[face], turned[face], True, axes, n * held, n * base, z, z1, z2)
                    if d == 2:
                        for i in range(n_own):
                            slope = ways[face][3 * d + d * n_own + i]
                            angle, angle1 = angle - slope * y[first + i], angle1 - slope * y1[first + i]
                            angle2 = angle2 - slope * y2[first + i]
        if d == 2:
            q[3 * base + 2], v[3 * base + 2], a[3 * base + 2] = angle, angle1, angle2
        for face in range(tree.faces[k], tree.faces[k + 1]):
            node = tree.face_nodes[face]
            if node == held and tree.kinds[k] != FREE:
                continue
            _frame_beyond(ways[face], turned[face], False, axes, n * base, n * node, z, z1, z2)
            if d == 2:
                turn, turn1, turn2 = angle, angle1, angle2
                for i in range(n_own):
                    slope = ways[face][3 * d + d * n_own + i]
                    turn, turn1 = turn + slope * y[first + i], turn1 + slope * y1[first + i]
                    turn2 = turn2 + slope * y2[first + i]
                q[3 * node + 2], v[3 * node + 2], a[3 * node + 2] = turn, turn1, turn2
    if d == 2:
        for node in range(z.size // n):
            for c in range(2):
                q[3 * node + c], v[3 * node + c], a[3 * node + c] = z[n * node + c], z1[n * node + c], z2[n * node + c]


@njit(error_model="numpy")
def _frame_beyond(own, turn, inward, axes, at, to, z, z1, z2):
    """Fill a face's frame from the floating one; where it is `inward` the floating one from that of a face."""
    d = len(axes)
    m, floating, sign = d * d, to if inward else at, -1.0 if inward else 1.0
    for c in range(d):
        for k in range(d):
            p = p1 = p2 = 0.0 * z[at + c]
            for l in range(d):
                x, x1, x2 = z[at + d + d * l + c], z1[at + d + d * l + c], z2[at + d + d * l + c]
                entry = d * k + l if inward else d * l + k
                r, r1, r2 = turn[entry], turn[m + entry], turn[2 * m + entry]
                p, p1 = p + x * r, p1 + (x1 * r + x * r1)
                p2 = p2 + (x2 * r + 2.0 * x1 * r1 + x * r2)
            z[to + d + d * k + c], z1[to + d + d * k + c], z2[to + d + d * k + c] = p, p1, p2
        p, p1, p2 = z[at + c], z1[at + c], z2[at + c]
        for l in range(d):
            director = floating + d + d * l + c
            x, x1, x2 = z[director], z1[director], z2[director]
            w, w1, w2 = sign * own[l], sign * own[d + l], sign * own[2 * d + l]
            p, p1 = p + x * w, p1 + (x1 * w + x * w1)
            p2 = p2 + (x2 * w + 2.0 * x1 * w1 + x * w2)
        z[to + c], z1[to + c], z2[to + c] = p, p1, p2


@njit(error_model="numpy")
def natural_forces(x, f, z, n_nodes):
    """Turn forces on ``(x, y, phi)`` of nodes in the plane into those on frames."""
    for node in range(n_nodes):
        f[6 * node], f[6 * node + 1], moment = x[3 * node], x[3 * node + 1], x[3 * node + 2]
        f[6 * node + 2], f[6 * node + 3] = moment * z[6 * node + 4], moment * z[6 * node + 5]
        f[6 * node + 4] = f[6 * node + 5] = 0.0 * moment


@njit(error_model="numpy")
def to_floating(own, turn, axes, f, at, out, to):
    """Add forces on a face's frame to those on the floating one, amplitudes held."""
    d = len(axes)
    for c in range(d):
        push = f[at + c]
        out[to + c] += push
        for l in range(d):
            total = push * own[l]
            for k in range(d):
                total += f[at + d + d * k + c] * turn[d * l + k]
            out[to + d + d * l + c] += total


@njit(error_model="numpy")
def to_face(own, turn, axes, f, at, out, to):
    """Add forces on the floating frame to those on the face's that holds it, amplitudes held."""
    d = len(axes)
    for c in range(d):
        push = f[at + c]
        out[to + c] += push
        for l in range(d):
            left = f[at + d + d * l + c] - push * own[l]
            for k in range(d):
                out[to + d + d * k + c] += turn[d * l + k] * left


@njit(error_model="numpy")
def on_face(own, turn, inward, axes, z, base, held, f, at, g):
    """Fill what forces on a face's frame do on its ways and turns in the body, g (d + n_turns,), with the floating
    frame held; where it is `inward` what those on the floating frame do, with that of the face held."""
    d = len(axes)
    for l in range(d):
        total = z[base + d + d * l] * f[at]
        for c in range(1, d):
            total += z[base + d + d * l + c] * f[at + c]
        g[l] = -total if inward else total
    for t in range(1 if d == 2 else 3):
        g[d + t] = 0.0 * g[0]
    for l in range(d):
        for k in range(d):
            along = 0.0 * g[0]
            for c in range(d):
                if inward:
                    along += z[held + d + d * k + c] * (f[at + d + d * l + c] - f[at + c] * own[l])
                else:
                    along += z[base + d + d * l + c] * f[at + d + d * k + c]
            for t in range(1 if d == 2 else 3):
                g[d + t] += along * turn[(3 + t) * d * d + d * l + k]


@njit(error_model="numpy")
def to_joint(tree, k, axes, cos, sin, s, z, f, at, to):
    """Add forces on the frame that a joint holds to those on the frame that it is on; return what they do along and
    about the joint. Those on the held frame are left as about the joint's point.

    `s`, `cos` and `sin` are of the joint's motion, `at` and `to` where both frames begin, the latter -1 on the ground.
    """
    d = len(axes)
    zero = 0.0 * f[at]
    arm, triad, spot, frame = tree.after[k, 0], tree.after[k, 1:], tree.before[k, 0], tree.before[k, 1:]
    by_axes, turns, slides = tree.kinds[k] == BY_AXES, tree.firsts[k, 0] >= 0, tree.firsts[k, 1] >= 0
    about = along = zero
    for c in range(d):
        push = f[at + c]
        first = x = y = way = ahead = across = zero
        for j in range(d):
            part, director = f[at + d + d * j + c] - push * arm[j], z[at + d + d * j + c]
            f[at + d + d * j + c] = part
            first, way = first + triad[j, 0] * part, way + triad[j, 0] * director
            x, ahead = x + triad[j, d - 2] * part, ahead + triad[j, d - 2] * director
            y, across = y + triad[j, d - 1] * part, across + triad[j, d - 1] * director
        about += across * x - ahead * y
        along += way * push
        if turns:
            x, y = cos * x - sin * y, sin * x + cos * y
        if slides and d == 2:
            x += push * s
        elif slides:
            first += push * s
        if to >= 0:
            f[to + c] += push
            for j in range(d):
                total = spot[j] * push
                if by_axes:
                    total += frame[j, d - 2] * x + frame[j, d - 1] * y
                    if d == 3:
                        total += frame[j, 0] * first
                f[to + d + d * j + c] += total
    return about, along


@njit(cache=True, apart=True, error_model="numpy")
def _gather_forces(axes, tree, width, y, x, room, into):
    """Fill forces on coordinates, (n_y, n_lanes), from those on unknowns, x (n_dofs or more, n_lanes), which are used
    up; frames and faces are as `place` left them."""
    d = len(axes)
    n, n_turns = d * (d + 1), 1 if d == 2 else 3
    z, ways, turned, x = items(room.z, width), items(room.ways, width), items(room.turned, width), items(x, width)
    f, g, into, y = items(room.f, width), items(room.local, width), items(into, width), items(y, width)
    zero = 0.0 * y[0]
    if d == 2:
        natural_forces(x, f, z, f.size // n)
    else:
        f = x
    for k in range(tree.kinds.size - 1, -1, -1):
        on, held, base = tree.nodes[k, 0], tree.nodes[k, 1], tree.nodes[k, 2]
        first, n_own, internal = tree.firsts[k, 3], tree.n_amplitudes[k], tree.internal[k]
        at = n * base
        for i in range(n_own):
            into[first + i] = x[internal + i]
        for face in range(tree.faces[k], tree.faces[k + 1]):
            node = tree.face_nodes[face]
            if node != held or tree.kinds[k] == FREE:
                on_face(ways[face], turned[face], False, axes, z, at, n * held, f, n * node, g)
                to_floating(ways[face], turned[face], axes, f, n * node, f, at)
                for t in range(d + n_turns):
                    for i in range(n_own):
                        into[first + i] += g[t] * ways[face][3 * d + t * n_own + i]
        for face in range(tree.faces[k], tree.faces[k + 1] if tree.kinds[k] != FREE else 0):
            if tree.face_nodes[face] == held:
                on_face(ways[face], turned[face], True, axes, z, at, n * held, f, at, g)
                to_face(ways[face], turned[face], axes, f, at, f, n * held)
                for t in range(d + n_turns):
                    for i in range(n_own):
                        into[first + i] += g[t] * ways[face][3 * d + t * n_own + i]
        natural = tree.firsts[k, 2]
        if tree.kinds[k] == FREE:
            if d == 3:
                for c in range(n):
                    into[natural + c] = f[at + c]
            else:
                into[natural], into[natural + 1] = f[at], f[at + 1]
                into[natural + 2] = turning_of(z, f, at)
            continue
        turning, sliding = tree.firsts[k, 0], tree.firsts[k, 1]
        sin, cos = sine_cosine(y[turning] if turning >= 0 else zero)
        s = y[sliding] if sliding >= 0 else zero
        about, along = to_joint(tree, k, axes, cos, sin, s, z, f, n * held, n * on if on >= 0 else -1)
        if turning >= 0:
            into[turning] = about
        if sliding >= 0:
            into[sliding] = along
        if tree.kinds[k] == BALL:
            for c in range(d * d):
                into[natural + c] = f[n * held + d + c]


@njit(error_model="numpy", forceinline=True)
def turning_of(z, f, at):
    """Return what forces on a frame in the plane do on its rotation."""
    ahead = z[at + 4] * f[at + 2] + z[at + 5] * f[at + 3]
    return ahead - z[at + 2] * f[at + 4] - z[at + 3] * f[at + 5]


place, gather_forces = map(by_dimension, (_place, _gather_forces))
