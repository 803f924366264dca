"""The matrix of Newton's iteration in joint coordinates, compiled, and its factorisation: dense, by samples in lanes.

    A = N^T S N,    S = gain_a M + gain_v C + gain_k K

is made along the tree from its ends inward. What a body carries is a rigid mass for whatever moves it. Motions and
forces are those of the ground's frame, so that nothing is carried from frame to frame: a motion is the velocity of what
moves where the origin is and its rotation, ``v(r) = b + omega x r``, a force its sum and its moment about the origin.
Every coordinate has a motion of what is behind it, and a column, the force that its acceleration makes there; entries
of A are ``motion . column`` (the composite rigid body algorithm in the coordinates of the base; Featherstone 2008, 6.2,
here with the amplitudes of flexible bodies). With face 0 held, an amplitude moves the body's frame by ``-phi_0`` and
what is on its face n by ``phi_n - phi_0``.

Directors that are coordinates move bodies by any linear field, ``v(r) = b + B r``, and feel the tensor ``sum f r^T`` of
forces too.

What forces on frames do with the curvature of the map is left to Newton's method. Constraints that are left border A.
To it is added ``w C^T C``, and what that does to the multipliers is taken off again: bodies without mass need it.
"""

from __future__ import annotations

from pgmp_petsc.full.joint_tree import BALL, BY_AXES, FREE
from pgmp_petsc.full.layout import by_dimension
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import fill, fused, items

WIDE_COLUMN = 15  # force, moment and tensor of a column in space; force and moment in the plane
N_SPARE = 128
STEP, SPOT, BASIS, WHOLE = 0, 16, 32, 80  # places in the spare room


@njit(inline="always")
def first_of(column, n):
    """Return where the entry of row 0 of a column would be, of the packed lower triangle of n rows."""
    return column * (2 * n - column - 1) // 2


@njit(inline="always")
def column_size(d):
    """Return how many numbers a column has."""
    return WIDE_COLUMN if d == 3 else 3


@njit(error_model="numpy")
def _add_inertia(axes, z, at, inertia, first, to, spare):
    """Add an inertia of a frame, of 1 and its axes, to one of 1 and the ground's, ``E P E^T``."""
    d = len(axes)
    n = 1 + d
    for i in range(n):
        for j in range(n):
            if i == 0:
                total = inertia[first + j]
            else:
                total = z[at + i - 1] * inertia[first + j]
                for k in range(d):
                    total = fused(z[at + d + d * k + i - 1], inertia[first + n * (1 + k) + j], total)
            spare[SPOT + n * i + j] = total
    for i in range(n):
        for j in range(n):
            if j == 0:
                total = spare[SPOT + n * i]
            else:
                total = spare[SPOT + n * i] * z[at + j - 1]
                for k in range(d):
                    total = fused(spare[SPOT + n * i + 1 + k], z[at + d + d * k + j - 1], total)
            inertia[to + n * i + j] += total


@njit(error_model="numpy")
def _add_masses(problem, width, block, gains, inertia, axes, z, spare):
    """Add the inertia of all nodes' own masses."""
    d = len(axes)
    n, (gain_v, gain_a, _), zero = (1 + d) * (1 + d), gains, 0.0 * z[0]
    if d == 3:
        densities = items(problem.masses.density, width)
        for k in range(problem.masses.body.size):
            gain = gain_a + problem.rayleigh[problem.masses.body[k], 1] * gain_v
            node = problem.masses.dofs[k, 0] // 12
            for i in range(16):
                spare[STEP + i] = gain * densities[block, k, i // 4, i % 4]
            _spread(axes, z, 12 * node, spare, inertia, n * node)
    else:
        masses, sections = items(problem.lumps.mass, width), items(problem.section, width)
        for k in range(problem.lumps.dofs.size):
            gain = gain_a + sections[block, problem.lumps.body[k], 6] * gain_v
            node, part = problem.lumps.dofs[k] // 3, problem.lumps.dofs[k] % 3
            for i in range(9):
                spare[STEP + i] = zero
            if part == 0:
                spare[STEP] = gain * masses[block, k]
            elif part == 2:
                spare[STEP + 4] = spare[STEP + 8] = 0.5 * gain * masses[block, k]
            _spread(axes, z, 6 * node, spare, inertia, n * node)


@njit(error_model="numpy")
def _spread(axes, z, at, spare, inertia, to):
    """Add the inertia of a frame that is in the spare room to one of the ground's frame."""
    d = len(axes)
    _add_inertia(axes, z, at, spare, STEP, WHOLE, spare)
    for i in range((1 + d) * (1 + d)):
        inertia[to + i] += spare[WHOLE + i]
        spare[WHOLE + i] = 0.0 * z[0]


@njit(error_model="numpy")
def _own_inertia(packed, axes, z, at, spare, inertia, to):
    """Add a flexible body's own inertia from its packed tangents."""
    d = len(axes)
    if d == 3:
        spare[STEP] = packed[0]
        for i in range(3):
            row = 3 + 3 * i
            line = row * (row + 1) // 2
            spare[STEP + 1 + i] = spare[STEP + 4 * (1 + i)] = packed[line]
            for j in range(i + 1):
                value = packed[line + 3 + 3 * j]
                spare[STEP + 4 * (1 + i) + 1 + j] = value
                spare[STEP + 4 * (1 + j) + 1 + i] = value
    else:
        x, y, turning = packed[3], packed[4], packed[5]
        one, other = x * z[at + 4] + y * z[at + 5], -(x * z[at + 2] + y * z[at + 3])
        spare[STEP] = packed[0]
        spare[STEP + 1] = spare[STEP + 3] = one
        spare[STEP + 2] = spare[STEP + 6] = other
        spare[STEP + 4] = spare[STEP + 8] = 0.5 * turning
        spare[STEP + 5] = spare[STEP + 7] = 0.0 * turning
    _spread(axes, z, at, spare, inertia, to)


@njit(error_model="numpy")
def _own_column(packed, line, axes, z, at, columns, to):
    """Fill the column of an amplitude, its frame held, from the packed tangents."""
    d = len(axes)
    if d == 2:
        x, y = packed[line], packed[line + 1]
        columns[to], columns[to + 1] = x, y
        columns[to + 2] = packed[line + 2] + (z[at] * y - z[at + 1] * x)
        return
    for c in range(3):
        columns[to + c] = packed[line + c]
    for a in range(3):
        for b in range(3):
            total = packed[line + a] * z[at + b]
            for k in range(3):
                total = fused(packed[line + 3 + 3 * k + a], z[at + 3 + 3 * k + b], total)
            columns[to + 6 + 3 * a + b] = total
    _moment(columns, to)


@njit(error_model="numpy", forceinline=True)
def _moment(columns, to):
    """Fill the moment of a column from its tensor."""
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        columns[to + 3 + a] = columns[to + 6 + 3 * c + b] - columns[to + 6 + 3 * b + c]


@njit(error_model="numpy")
def _forces(inertia, at, axes, way, first, out, to, tensors):
    """Fill the force of a rigid motion: its sum and moment, and its tensor where that is wanted."""
    d = len(axes)
    if d == 2:
        x, y, turn = way[first], way[first + 1], way[first + 2]
        m, s, t = inertia[at], inertia[at + 1], inertia[at + 2]
        out[to] = m * x - turn * t
        out[to + 1] = m * y + turn * s
        out[to + 2] = s * y - t * x + turn * (inertia[at + 4] + inertia[at + 8])
        return
    trace = inertia[at + 5] + inertia[at + 10] + inertia[at + 15]
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        one, other = way[first + 3 + b], way[first + 3 + c]
        s, t = inertia[at + 1 + b], inertia[at + 1 + c]
        out[to + a] = fused(inertia[at], way[first + a], one * t - other * s)
        moment = fused(trace, way[first + 3 + a], s * way[first + c] - t * way[first + b])
        for k in range(3):
            moment = fused(-inertia[at + 4 * (1 + a) + 1 + k], way[first + 3 + k], moment)
        out[to + 3 + a] = moment
        if tensors:
            for k in range(3):
                turned = one * inertia[at + 4 * (1 + c) + 1 + k] - other * inertia[at + 4 * (1 + b) + 1 + k]
                out[to + 6 + 3 * a + k] = fused(way[first + a], inertia[at + 1 + k], turned)


@njit(error_model="numpy", forceinline=True)
def _dot(axes, one, first, other, second):
    d = len(axes)
    total = one[first] * other[second]
    for i in range(1, 3 if d == 2 else 6):
        total = fused(one[first + i], other[second + i], total)
    return total


@njit(error_model="numpy")
def _face_motions(own, turn, axes, n_own, z, base, node, spare, moves):
    """Fill the motion of what is on a face for every amplitude, the floating frame held, moves (n_own, n_s)."""
    d = len(axes)
    n_turns = 1 if d == 2 else 3
    n_ways = d + n_turns
    for t in range(n_turns):
        at = BASIS + n_ways * t
        if d == 2:
            spare[at], spare[at + 1], spare[at + 2] = z[node + 1], -z[node], 0.0 * z[node] + 1.0
            continue
        for c in range(3):
            spare[at + 3 + c] = 0.0 * z[node]
        for m in range(3):
            i, j = (m + 2) % 3, (m + 1) % 3
            axial = 0.0 * z[node]
            for k in range(3):
                axial = fused(turn[(3 + t) * 9 + 3 * i + k], turn[3 * j + k], axial)  # of dR/ds R^T
            for c in range(3):
                spare[at + 3 + c] = fused(axial, z[base + 3 + 3 * m + c], spare[at + 3 + c])
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            spare[at + a] = spare[at + 3 + c] * z[node + b] - spare[at + 3 + b] * z[node + c]  # p x omega
    for i in range(n_own):
        to = n_ways * i
        for c in range(d):
            total = own[3 * d + i] * z[base + d + c]
            for l in range(1, d):
                total = fused(own[3 * d + l * n_own + i], z[base + d + d * l + c], total)
            for t in range(n_turns):
                total = fused(own[3 * d + (d + t) * n_own + i], spare[BASIS + n_ways * t + c], total)
            moves[to + c] = total
        for c in range(d, n_ways):
            total = own[3 * d + d * n_own + i] * spare[BASIS + c]
            for t in range(1, n_turns):
                total = fused(own[3 * d + (d + t) * n_own + i], spare[BASIS + n_ways * t + c], total)
            moves[to + c] = total


@njit(error_model="numpy")
def _flexible(tree, k, axes, z, ways, turned, packed, inertia, columns, moves, forces, matrix, spare, n_all):
    """Fill columns and entries of a flexible body's amplitudes, and add its inertia and what its faces carry to that of
    the frame that holds it."""
    d = len(axes)
    n, m, n_ways, size = d * (d + 1), (1 + d) * (1 + d), d + (1 if d == 2 else 3), column_size(d)
    held, base, first, n_own = tree.nodes[k, 1], tree.nodes[k, 2], tree.firsts[k, 3], tree.n_amplitudes[k]
    tensors, n_pose, zero, free = tree.tensors, 3 if d == 2 else 12, 0.0 * z[0], tree.kinds[k] == FREE
    own = moves[0]
    for i in range(n_ways * n_own):
        own[i] = zero
    for face in range(tree.faces[k], tree.faces[k + 1] if not free else 0):
        if tree.face_nodes[face] == held:
            _face_motions(ways[face], turned[face], axes, n_own, z, n * base, n * held, spare, own)
            for i in range(n_ways * n_own):
                own[i] = -own[i]
    _own_inertia(packed, axes, z, n * base, spare, inertia, m * base)
    for i in range(n_own):
        line, to = (n_pose + i) * (n_pose + i + 1) // 2, size * (first + i)
        _own_column(packed, line, axes, z, n * base, columns, to)
        for t in range(n_ways):  # kept: what the amplitude does alone
            moves[1][n_ways * i + t] = columns[to + t]
        _forces(inertia, m * base, axes, own, n_ways * i, forces, size * i, tensors)
        for t in range(size if tensors or d == 2 else 6):
            columns[to + t] += forces[size * i + t]
    for i in range(n_own):
        line, alone = (n_pose + i) * (n_pose + i + 1) // 2, moves[1]
        for j in range(i + 1):
            total = packed[line + n_pose + j]
            for t in range(n_ways):
                total = fused(own[n_ways * j + t], columns[size * (first + i) + t], total)
                total = fused(own[n_ways * i + t], alone[n_ways * j + t], total)
            matrix[first_of(first + j, n_all) + first + i] = total
    for face in range(tree.faces[k], tree.faces[k + 1]):
        node = tree.face_nodes[face]
        if not tree.carries[node] or (node == held and not free):
            continue
        out = moves[1]
        _face_motions(ways[face], turned[face], axes, n_own, z, n * base, n * node, spare, out)
        for i in range(n_ways * n_own):
            out[i] += own[i]
        for i in range(n_own):
            _forces(inertia, m * node, axes, out, n_ways * i, forces, size * i, tensors)
            for t in range(size if tensors or d == 2 else 6):
                columns[size * (first + i) + t] += forces[size * i + t]
        for j in range(n_own):
            at = first_of(first + j, n_all) + first
            for i in range(j, n_own):
                matrix[at + i] += _dot(axes, out, n_ways * j, forces, size * i)
        for child in range(k + 1, tree.kinds.size):
            if tree.nodes[child, 0] == node:
                for i in range(n_own):
                    at = first_of(first + i, n_all)
                    for j in range(tree.firsts[child, 5], tree.firsts[child, 4]):
                        matrix[at + j] = _dot(axes, out, n_ways * i, columns, size * j)
        for i in range(m):
            inertia[m * base + i] += inertia[m * node + i]
    if not free:
        for i in range(m):
            inertia[m * held + i] += inertia[m * base + i]


@njit(error_model="numpy")
def _by_axes(tree, k, axes, z, inertia, columns, matrix, spare, n_all):
    """Fill columns and entries of what a joint turns and slides."""
    d = len(axes)
    n, m, size, zero = d * (d + 1), (1 + d) * (1 + d), column_size(d), 0.0 * z[0]
    at, start, end = n * tree.nodes[k, 1], tree.firsts[k, 5], tree.firsts[k, 4]
    arm, triad, n_own = tree.after[k, 0], tree.after[k, 1:], tree.firsts[k, 3] - tree.firsts[k, 5]
    for c in range(d):
        place, way = z[at + c], zero
        for j in range(d):
            place += arm[j] * z[at + d + d * j + c]
            way += triad[j, 0] * z[at + d + d * j + c]
        spare[STEP + c], spare[STEP + d + c] = place, way
    for u in range(n_own):
        own = BASIS + 6 * u
        for c in range(3 if d == 2 else 6):
            spare[own + c] = zero
        if u == 0 and tree.firsts[k, 0] >= 0:
            if d == 2:
                spare[own], spare[own + 1], spare[own + 2] = spare[STEP + 1], -spare[STEP], zero + 1.0
            else:
                for a in range(3):
                    b, c = (a + 1) % 3, (a + 2) % 3
                    spare[own + 3 + a] = spare[STEP + 3 + a]
                    spare[own + a] = spare[STEP + b] * spare[STEP + 3 + c] - spare[STEP + c] * spare[STEP + 3 + b]
        else:
            for c in range(d):
                spare[own + c] = spare[STEP + d + c]
        first = first_of(start + u, n_all)
        for j in range(start + n_own, end):
            matrix[first + j] = _dot(axes, spare, own, columns, size * j)
        _forces(inertia, m * tree.nodes[k, 1], axes, spare, own, columns, size * (start + u), tree.tensors)
        for j in range(u + 1):
            entry = first_of(start + j, n_all) + start + u
            matrix[entry] = _dot(axes, spare, BASIS + 6 * j, columns, size * (start + u))


@njit(error_model="numpy")
def _free_in_plane(tree, k, axes, z, inertia, columns, matrix, spare, n_all):
    """Fill columns and entries of the frame of a body in the plane that nothing holds."""
    at, start, end, zero = 6 * tree.nodes[k, 2], tree.firsts[k, 5], tree.firsts[k, 4], 0.0 * z[0]
    for u in range(3):
        own = BASIS + 6 * u
        for c in range(3):
            spare[own + c] = zero
        spare[own + u] = zero + 1.0
        if u == 2:
            spare[own], spare[own + 1] = z[at + 1], -z[at]
        for j in range(start + 3, end):
            matrix[first_of(start + u, n_all) + j] = _dot(axes, spare, own, columns, 3 * j)
        _forces(inertia, 9 * tree.nodes[k, 2], axes, spare, own, columns, 3 * (start + u), False)
        for j in range(u + 1):
            entry = first_of(start + j, n_all) + start + u
            matrix[entry] = _dot(axes, spare, BASIS + 6 * j, columns, 3 * (start + u))


@njit(error_model="numpy")
def _directors(tree, k, axes, z, inertia, columns, matrix, spare, n_all):
    """Fill columns and entries of directors that are coordinates, and of the place of a free frame."""
    ball, zero = tree.kinds[k] == BALL, 0.0 * z[0]
    node, first, end = tree.nodes[k, 1], tree.firsts[k, 2], tree.firsts[k, 4]
    at, mass = 12 * node, 16 * node
    begin = first if ball else first + 3
    behind = tree.firsts[k, 3]
    for c in range(3):
        place = z[at + c]
        for j in range(3):
            place += tree.after[k, 0, j] * z[at + 3 + 3 * j + c]
        spare[STEP + c] = place
    for c in range(0 if ball else 3):
        entry = first_of(first + c, n_all)
        for j in range(behind, end):
            matrix[entry + j] = columns[WIDE_COLUMN * j + c]
        for i in range(6):
            spare[BASIS + i] = zero
        spare[BASIS + c] = zero + 1.0
        _forces(inertia, mass, axes, spare, BASIS, columns, WIDE_COLUMN * (first + c), True)
        matrix[entry + first + c] = inertia[mass]
        for other in range(c):
            matrix[first_of(first + other, n_all) + first + c] = zero
    for k_one in range(3):
        lever = zero
        for c in range(3):
            lever += z[at + 3 + 3 * k_one + c] * spare[STEP + c]
        for c in range(3):
            own = begin + 3 * k_one + c
            to = WIDE_COLUMN * own
            for i in range(WIDE_COLUMN):
                columns[to + i] = zero
            force = -lever * inertia[mass]
            for b in range(3):
                force += z[at + 3 + 3 * k_one + b] * inertia[mass + 1 + b]
                tensor = -lever * inertia[mass + 1 + b]
                for a in range(3):
                    tensor += z[at + 3 + 3 * k_one + a] * inertia[mass + 4 * (1 + a) + 1 + b]
                columns[to + 6 + 3 * c + b] = tensor
            columns[to + c] = force
            _moment(columns, to)
            for j in range(behind, end):
                matrix[first_of(own, n_all) + j] = _on_director(z, at, k_one, c, lever, columns, WIDE_COLUMN * j)
            for other in range(first, own + 1):
                if other < begin:
                    entry = columns[to + other - first]
                else:
                    k_other, c_other = (other - begin) // 3, (other - begin) % 3
                    there = zero
                    for b in range(3):
                        there += z[at + 3 + 3 * k_other + b] * spare[STEP + b]
                    entry = _on_director(z, at, k_other, c_other, there, columns, to)
                matrix[first_of(other, n_all) + own] = entry
    if ball:  # of what it carries the force alone is felt further in, at the joint's point
        for j in range(first, end):
            to = WIDE_COLUMN * j
            for a in range(3):
                for b in range(3):
                    columns[to + 6 + 3 * a + b] = columns[to + a] * spare[STEP + b]
            _moment(columns, to)
        for a in range(3):
            moved = inertia[mass] * spare[STEP + a]
            inertia[mass + 1 + a] = inertia[mass + 4 * (1 + a)] = moved
            for b in range(3):
                inertia[mass + 4 * (1 + a) + 1 + b] = moved * spare[STEP + b]


@njit(error_model="numpy", forceinline=True)
def _on_director(z, at, k, c, lever, columns, to):
    """Return what a column does on a component of a director."""
    total = -lever * columns[to + c]
    for b in range(3):
        total += columns[to + 6 + 3 * c + b] * z[at + 3 + 3 * k + b]
    return total


@njit(cache=True, apart=True, error_model="numpy")
def _fill_matrix(axes, problem, tree, width, block, gains, room, matrix, n_all):
    """Fill the packed lower triangle of the matrix, (n, n_lanes), of n_all rows; frames, faces and packed tangents of
    floating bodies are in the room."""
    d = len(axes)
    m = (1 + d) * (1 + d)
    fill(room.inertia, 0.0, width)
    fill(room.spare, 0.0, width)
    fill(matrix, 0.0, width)
    z, ways, turned, packed = (
        items(room.z, width), items(room.ways, width), items(room.turned, width), items(room.entries, width)
    )  # fmt: skip
    inertia, columns, spare, matrix = (
        items(room.inertia, width), items(room.columns, width), items(room.spare, width), items(matrix, width)
    )  # fmt: skip
    moves, forces = items(room.moves, width), items(room.forces, width)
    _add_masses(problem, width, block, gains, inertia, axes, z, spare)
    for k in range(tree.kinds.size - 1, -1, -1):
        on, held, number = tree.nodes[k, 0], tree.nodes[k, 1], tree.floating[k]
        if number >= 0:
            own = packed[problem.floating.firsts[number, 2] :]
            _flexible(tree, k, axes, z, ways, turned, own, inertia, columns, moves, forces, matrix, spare, n_all)
        if tree.kinds[k] == BY_AXES:
            _by_axes(tree, k, axes, z, inertia, columns, matrix, spare, n_all)
        elif d == 2:
            _free_in_plane(tree, k, axes, z, inertia, columns, matrix, spare, n_all)
        else:
            _directors(tree, k, axes, z, inertia, columns, matrix, spare, n_all)
        for i in range(m if on >= 0 else 0):
            inertia[m * on + i] += inertia[m * held + i]


fill_matrix = by_dimension(_fill_matrix)


@njit(cache=True, apart=True, error_model="numpy")
def factorise_dense(width, n, matrix):
    """Factorise ``L D L^T`` in place, the packed lower triangle column by column: the diagonal becomes the inverse of
    D, and the rest ``L D``. Nothing is pivoted."""
    matrix = items(matrix, width)
    for j in range(n):
        size = n - j
        own = matrix[first_of(j, n) + j : first_of(j, n) + n]
        k = 0
        while k + 4 <= j:  # four columns at once: the target is read and written once for all of them
            at, at1, at2, at3 = first_of(k, n), first_of(k + 1, n), first_of(k + 2, n), first_of(k + 3, n)
            one, two, three, four = (
                matrix[at + j : at + n], matrix[at1 + j : at1 + n], matrix[at2 + j : at2 + n], matrix[at3 + j : at3 + n]
            )  # fmt: skip
            a, b = -(one[0] * matrix[at + k]), -(two[0] * matrix[at1 + k + 1])
            c, d = -(three[0] * matrix[at2 + k + 2]), -(four[0] * matrix[at3 + k + 3])
            for i in range(size):
                own[i] = fused(d, four[i], fused(c, three[i], fused(b, two[i], fused(a, one[i], own[i]))))
            k += 4
        while k < j:
            at = first_of(k, n)
            one = matrix[at + j : at + n]
            a = -(one[0] * matrix[at + k])
            for i in range(size):
                own[i] = fused(a, one[i], own[i])
            k += 1
        own[0] = 1.0 / own[0]


@njit(cache=True, apart=True, error_model="numpy")
def substitute_dense(width, n, matrix, x):
    """Solve ``L D L^T y = x`` in place."""
    matrix, x = items(matrix, width), items(x, width)
    for k in range(n):
        own, left = matrix[first_of(k, n) + k : first_of(k, n) + n], x[k:n]
        known = left[0] * own[0]
        left[0] = known
        for i in range(1, n - k):
            left[i] = fused(-known, own[i], left[i])
    for k in range(n - 1, -1, -1):
        own, left = matrix[first_of(k, n) + k : first_of(k, n) + n], x[k:n]
        total = left[0] * 0.0
        for i in range(1, n - k):
            total = fused(own[i], left[i], total)
        left[0] = fused(-total, own[0], left[0])
