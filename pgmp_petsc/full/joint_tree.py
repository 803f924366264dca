"""The tree of a mechanism's bodies that joint coordinates go along, from the ground outward.

Every body is moved by one joint, that on its way to the ground: a frame on the body before it, the joint's own motion,
and the frame of the body that the joint holds. What joints hold in the motion says how:

    turning and sliding    about and along one of the joint's axes, in one coordinate each, or welded, in none
    ball                   the points meet: the nine directors of the held frame are coordinates
    free                   anything else: all coordinates of the body's own frame are

Directors that are coordinates keep the constraints that make them a rotation; what a ball or a free body's joint holds
besides, joints that close loops, couplings and driven statements stay constraints, all others are gone. Coordinates are
numbered body by body, a body's motion before its amplitudes, and what it carries right behind it.
"""

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from pgmp_petsc.mechanism.joints import Attachment, Connection
from pgmp_petsc.mechanism.mechanism import Mechanism, Unknowns
from pgmp_petsc.mechanism.space import leibniz, rotate
from pgmp_petsc.mechanism.statement_rows import StatementRows
from pgmp_petsc.mechanism.statements import ALONG, MEET, PERPENDICULAR, Statement, U, W

#: coordinates of directors and frames, in the plane and in space
_OWN = {(2, 2): 3, (3, 1): 9, (3, 2): 12}
SQUARE = 1e-9  # cosine of axes at right angles, and what is left to 1 of parallel ones
BY_AXES, BALL, FREE = range(3)  # what moves a body
#: what joints hold in the motion, in the plane and in space, and whether they turn and slide
_MOTIONS = {
    (2, 2, 0, 0): (True, False), (2, 2, 1, 0): (False, False), (2, 0, 1, 1): (False, True),
    (3, 3, 2, 0): (True, False), (3, 3, 3, 0): (False, False), (3, 0, 3, 2): (False, True),
    (3, 0, 2, 2): (True, True),
}  # fmt: skip


class Tree(NamedTuple):
    """Bodies, each behind the one that it moves on, as compiled functions take them."""

    #: nodes: of the frame that a joint is on, -1 on the ground, that it holds, and that moves with the body: the same
    #: of a rigid one, else the floating frame, shape (n, 3)
    nodes: np.ndarray
    kinds: np.ndarray  # `BY_AXES`, `BALL` or `FREE`, shape (n,)
    #: first coordinate of the joint's turning and sliding, -1 where it does not, that of directors or frames, that of
    #: the amplitudes, the one behind all that the body carries, and the first of all, shape (n, 6)
    firsts: np.ndarray
    n_amplitudes: np.ndarray  # shape (n,)
    internal: np.ndarray  # first unknown of the amplitudes, shape (n,)
    before: np.ndarray  # place and triad of the joint in the frame that it is on, shape (n, 1 + d, d), triad[k, j]
    after: np.ndarray  # place and triad of the joint in the frame that it holds
    rest: np.ndarray  # in the plane how far the held frame is turned where the joint is not, shape (n,), rad
    faces: np.ndarray  # first of the frames of each body, and their number: of flexible ones, shape (n + 1,)
    face_nodes: np.ndarray  # shape (n_faces,)
    centres: np.ndarray  # shape (n_faces, d)
    #: first of a face's `shapes`, of frame and amplitude one after the other (`FloatingBody`), and of its rows of
    #: `bent`, -1 where there is none, shape (n_faces, 2)
    at: np.ndarray
    shapes: np.ndarray
    bent: np.ndarray  # what is not zero of ``a``, rows (k, i) over the amplitudes j
    rows: np.ndarray  # where each row begins, and the end
    columns: np.ndarray  # j of each entry
    floating: np.ndarray  # number among the floating bodies, -1 of rigid ones, shape (n,)
    carries: np.ndarray  # whether a node has a mass of its own or a joint to a body further out, shape (n_nodes,)
    tensors: bool  # whether any directors are coordinates


class Held(NamedTuple):
    """What the tree's joints hold of frames, and what drives them, body after body."""

    rows: StatementRows  # n statements
    places: np.ndarray  # of their multipliers among those of joints and driven angles, shape (n,)
    #: bodies, nodes: number in the tree of the body that each joint moves, and the node that it holds, shape (n,)
    bodies: np.ndarray
    nodes: np.ndarray


class Motion(NamedTuple):
    """How a body moves on the one before it."""

    body: int
    kind: int
    on: Attachment | None  # where the joint is; None of a free body
    held: Attachment | None
    axis: int  # of the joint, that it turns about and slides along; -1 of balls and free bodies
    turns: bool
    slides: bool
    number: int  # of the connection, -1 of a free body
    backwards: bool  # whether the body is the connection's first: its coordinates are minus what the joint measures


def rows_of(connection: Connection, dimension: int) -> tuple[int, int, bool, bool]:
    """Return what moves a body that a joint holds, about which of its axes, -1 of none, and whether it turns and
    slides."""
    held = connection.held
    if any(not isinstance(part, Statement) or len(sides) != 2 for part, sides in held):
        return FREE, -1, False, False
    kinds = [part.kind for part, _ in held]
    counts = tuple(kinds.count(kind) for kind in (MEET, PERPENDICULAR, ALONG))
    plain = connection.level is None and len(kinds) == sum(counts)
    motion = _MOTIONS.get((dimension, *counts)) if plain else None
    if motion is not None:
        # what is measured is about the first axis; what turns by giving way may do so about any one
        about_any = dimension == 3 and motion == (True, False) and connection.released
        for axis in range(3 if about_any else 1):
            if _by_axis(connection, axis, *motion):
                return BY_AXES, axis, *motion
    return BALL if dimension == 3 and counts[0] == 3 else FREE, -1, False, False


def _by_axis(connection: Connection, number: int, turns: bool, slides: bool) -> bool:
    """Return whether one of a joint's axes is what it turns about and slides along."""
    axis, of_held = (sides[:, number] for sides in connection.axes) if turns or slides else (None, None)
    for part, _ in connection.held:
        if slides and part.kind == ALONG and abs(part.axes[U] @ axis) > SQUARE:
            return False
        if turns and part.kind == PERPENDICULAR:
            if max(abs(part.axes[U] @ axis), abs(part.axes[W] @ of_held)) < 1.0 - SQUARE:
                return False
    return True


def motions_of(unknowns: Unknowns) -> list[Motion]:
    """Return how every body moves on the one before it, from the ground outward, bodies that one carries right behind
    it."""
    mechanism, d = unknowns.mechanism, unknowns.dimension
    kinds = [rows_of(connection, d) for connection in mechanism.connections]
    depth, found = {-1: 0}, {}
    while len(depth) <= len(mechanism.bodies):
        best = None
        for number, (connection, (kind, *motion)) in enumerate(zip(mechanism.connections, kinds)):
            if kind == FREE:
                continue
            a, b = connection.held[0][1]
            reached = a.body in depth, b.body in depth
            if reached[0] == reached[1]:
                continue
            on, held = (a, b) if reached[0] else (b, a)
            price = kind, depth[on.body], number
            if best is None or price < best[0]:
                best = price, Motion(held.body, kind, on, held, *motion, number, not reached[0])
        if best is None:
            body = next(k for k in range(len(mechanism.bodies)) if k not in depth)
            motion = Motion(body, FREE, None, None, -1, False, False, -1, False)
        else:
            motion = best[1]
        depth[motion.body] = 1 + (depth[motion.on.body] if motion.on is not None else 0)
        found[motion.body] = motion
    return list(_outward(found, -1))


def held_by(mechanism: Mechanism, motions: list[Motion]) -> np.ndarray:
    """Return which of what joints and couplings hold the tree's joints hold, shape (n_held,)."""
    by_number, found = {motion.number: motion for motion in motions if motion.number >= 0}, []
    for number, holder in enumerate(mechanism.holders):
        motion = by_number.get(number) if number < len(mechanism.connections) else None
        for part, _ in holder.holding(moving=True):
            found.append(motion is not None and (motion.kind != BALL or part.kind == MEET))
    return np.array(found, dtype=bool)


def count_of(mechanism: Mechanism) -> tuple[int, int]:
    """Return how many coordinates there are beside amplitudes, and how many constraints are left, those included that
    follow from others."""
    d, motions = mechanism.space.dimension, motions_of(Unknowns(mechanism))
    natural = [motion.kind for motion in motions if motion.kind != BY_AXES]
    own = sum(motion.turns + motion.slides for motion in motions) + sum(_OWN[d, kind] for kind in natural)
    n_driven = sum(coordinate.prescribed for coordinate in mechanism.coordinates)
    return own, int(np.sum(~held_by(mechanism, motions))) + (6 * len(natural) if d == 3 else 0) + n_driven


def _outward(found: dict[int, Motion], body: int) -> Iterator[Motion]:
    """Yield the motions of the bodies that one carries."""
    for motion in found.values():
        if (-1 if motion.on is None else motion.on.body) == body:
            yield motion
            yield from _outward(found, motion.body)


def tree_of(unknowns: Unknowns, motions: list[Motion], q: np.ndarray, heavy: np.ndarray) -> Tree:
    """Return the tree; `q` are unknowns (n_dofs,) of the mechanism as it is assembled, `heavy` the nodes with a mass of
    their own."""
    d, bodies, frames = unknowns.dimension, unknowns.bodies, unknowns.frames(q)
    n = len(motions)
    nodes, firsts = np.full((n, 3), -1), np.full((n, 6), -1)
    before, after = np.zeros((n, 1 + d, d)), np.zeros((n, 1 + d, d))
    rest, faces, next_one = np.zeros(n), [0], 0
    n_amplitudes, internal, floating = np.zeros(n, dtype=int), np.zeros(n, dtype=int), np.full(n, -1)
    flexible = [number for number, body in enumerate(bodies) if body.blocks("floating")]
    face_nodes, centres, at, shapes = [], [], [], [np.zeros(0)]
    bent, rows, columns = [np.zeros(0)], [np.zeros(1, dtype=int)], [np.zeros(0, dtype=int)]
    for k, motion in enumerate(motions):
        body = bodies[motion.body]
        nodes[k, 2] = body.first_node + body.n_nodes - 1
        nodes[k, 1] = nodes[k, 2] if motion.held is None else motion.held.node
        before[k, 1:] = after[k, 1:] = np.eye(d)
        if motion.on is not None:
            nodes[k, 0] = -1 if motion.on.on_ground else motion.on.node
            before[k, 0] = motion.on.point if motion.on.on_ground else motion.on.arm
            after[k, 0] = motion.held.arm
        if motion.kind == BY_AXES:
            connection = unknowns.mechanism.connections[motion.number]
            on, of = (1, 0) if motion.backwards else (0, 1)
            if d == 3:
                before[k, 1:], after[k, 1:] = (
                    np.roll(connection.axes[side], -motion.axis, axis=1) for side in (on, of)
                )
            else:
                turned = 0.0 if nodes[k, 0] < 0 else frames[nodes[k, 0], 2]
                rest[k] = frames[nodes[k, 1], 2] - turned
                if not motion.turns:
                    rest[k] = _kept_angle(connection, motion.backwards, rest[k])
                    before[k, 1:] = connection.axes[0]
                    if motion.backwards:  # the axis is in the first body's frame, as that stands in the second one
                        before[k, 1:] = rotate(rest[k], before[k, 1:])
                    after[k, 1:] = rotate(-rest[k], before[k, 1:])
                else:
                    rest[k] = 0.0
        firsts[k, 5] = next_one
        for column, has in enumerate((motion.turns, motion.slides)):
            if has:
                firsts[k, column], next_one = next_one, next_one + 1
        firsts[k, 2] = next_one
        if motion.kind != BY_AXES:
            next_one += _OWN[d, motion.kind]
        firsts[k, 3] = next_one
        for block in body.blocks("floating"):
            n_amplitudes[k], internal[k], floating[k] = block.n, body.first_internal, flexible.index(motion.body)
            for number, (centre, shape, curve) in enumerate(zip(block.centres, block.shapes, block.bent)):
                face_nodes.append(body.first_node + number)
                centres.append(centre)
                at.append((sum(map(len, shapes)), sum(map(len, rows)) - 1 if curve.any() else -1))
                shapes.append(shape.ravel())
                if curve.any():
                    flat = curve.reshape(-1, block.n)
                    rows.append(rows[-1][-1] + np.cumsum(np.count_nonzero(flat, axis=1)))
                    columns.append(np.nonzero(flat)[1])
                    bent.append(flat[flat != 0.0])
        next_one += n_amplitudes[k]
        faces.append(len(face_nodes))
        firsts[k, 4] = next_one
    order = {motion.body: k for k, motion in enumerate(motions)}
    for k in range(n - 1, -1, -1):
        if motions[k].on is not None and not motions[k].on.on_ground:
            parent = order[motions[k].on.body]
            firsts[parent, 4] = max(firsts[parent, 4], firsts[k, 4])
    return Tree(
        nodes, np.array([motion.kind for motion in motions]), firsts, n_amplitudes, internal, before, after,
        rest, np.array(faces), np.array(face_nodes, dtype=int), np.array(centres).reshape(-1, d),
        np.array(at, dtype=int).reshape(-1, 2), np.concatenate(shapes), np.concatenate(bent), np.concatenate(rows),
        np.concatenate(columns), floating,
        np.isin(np.arange(unknowns.mechanism.n_nodes), [*nodes[:, 0], *heavy]),
        d == 3 and any(motion.kind != BY_AXES for motion in motions),
    )  # fmt: skip


def _kept_angle(connection: Connection, backwards: bool, near: float) -> float:
    """Return how far a joint in the plane that does not turn keeps the second body turned, to the last digit."""
    part = next(part for part, _ in connection.held if part.kind == PERPENDICULAR)
    (x, y), (u, v) = part.axes[U], part.axes[W]
    kept = np.arctan2(x, -y) - np.arctan2(v, u)
    kept = -kept if backwards else kept
    return kept + 2.0 * np.pi * np.rint((near - kept) / (2.0 * np.pi))


def coordinates_of(unknowns: Unknowns, tree: Tree, motions: list[Motion], q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return coordinates and their rates, shape (2, n_y, n), of unknowns and velocities (n_dofs, n) that obey what the
    tree's joints hold. Angles in space are those within half a turn."""
    d, found = unknowns.dimension, np.zeros((2, tree.firsts[:, 4].max(), q.shape[1]))
    rows, dot = np.stack([q, v]), partial(np.einsum, "cn,cn->n")
    for k, motion in enumerate(motions):
        turning, sliding, natural, amplitudes = tree.firsts[k, :4]
        n = tree.n_amplitudes[k]
        found[:, amplitudes : amplitudes + n] = rows[:, tree.internal[k] + np.arange(n)]
        if motion.kind != BY_AXES:
            own = unknowns.frame(tree.nodes[k, 1])[3:] if motion.kind == BALL else unknowns.frame(tree.nodes[k, 2])
            found[:, natural : natural + own.size] = rows[:, own]
            continue
        on, held = (_jet(unknowns, rows, node) for node in tree.nodes[k, :2])
        joint, frame = (
            np.concatenate([part[:, :1] + np.einsum("k,ok...->o...", own[0], part[:, 1:])[:, None],
                            np.einsum("kj,okcn->ojcn", own[1:], part[:, 1:])], axis=1)
            for part, own in ((on, tree.before[k]), (held, tree.after[k]))
        )  # fmt: skip
        if turning >= 0 and d == 2:
            at = [3 * node + 2 for node in tree.nodes[k, :2]]
            found[:, turning] = rows[:, at[1]] - (rows[:, at[0]] if tree.nodes[k, 0] >= 0 else 0.0)
        elif turning >= 0:
            (cos, cos1), (sin, sin1) = (leibniz(dot, joint[:, axis], frame[:, 2]) for axis in (2, 3))
            found[:, turning] = np.arctan2(sin, cos), cos * sin1 - sin * cos1
        if sliding >= 0:
            found[:, sliding] = leibniz(dot, joint[:, 1], frame[:, 0] - joint[:, 0])
    return found


def _jet(unknowns: Unknowns, rows: np.ndarray, node: int) -> np.ndarray:
    """Return position and directors of a node and their rates, shape (2, 1 + d, d, n)."""
    d = unknowns.dimension
    if node < 0:
        ground = np.zeros((2, 1 + d, d, rows.shape[2]))
        ground[0, 1:] = np.eye(d)[..., None]
        return ground
    own = rows[:, unknowns.frame(node)]
    if d == 3:
        return own.reshape(2, 4, 3, -1)
    cos, sin = np.cos(own[0, 2]), np.sin(own[0, 2])
    first = np.array([[own[0, :2], [cos, sin], [-sin, cos]]])
    rates = np.array([[own[1, :2], own[1, 2] * np.array([-sin, cos]), own[1, 2] * np.array([-cos, -sin])]])
    return np.concatenate([first, rates])
