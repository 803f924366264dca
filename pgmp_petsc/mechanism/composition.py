"""From a scene to bodies and connections: numbering, attachments, and where the assembly begins.

What a joint holds in the motion, and what it releases there.

The statements s of a joint are zero in the configuration: the rigid mechanism closes with them, and they count its
coordinates. In the motion an elastic joint holds some of these directions, and releases others: their rows are no
constraints, and springs act on them (`effects.springs`).

Along an axis e_k of its reference frame, fixed in the first body, the statement is ``e_k . (p_b - p_a)``. About it, it
is a cosine that turning about e_k alone changes at first order, and turning about the axes that the joint leaves free
never does. With f the axes of the second body that are those of the first as the bodies are placed:

- all turning held: ``e_(k+2) . f_(k+1)``, the sine of a rotation about e_k; in the plane the rotation itself,
- turning about e_j free: ``e_l . f_j``, l the third axis,
- turning about two axes free: the joint's own statement.

Where the joint is off by an offset (place, turn), what it holds is about the moved point and the turned axes. What it
releases is measured where the joint should be, and its spring is at rest where the joint is: its length is the measure
of place and turn, ``e_k . place`` along an axis. Both are the same to first order, and the offset is a factor of
nothing: it is a parameter of the springs.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import AffineSum, Monomial, Quantity
from pgmp_petsc.bodies.body import Body, LumpedMass, body_of, joined
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.mechanism.joints import (
    Attachment,
    Connection,
    Coupling,
    Release,
    about,
    ridden,
    share_position,
    triad,
    weld,
)
from pgmp_petsc.mechanism.space import SPATIAL, space_of
from pgmp_petsc.mechanism.statement_rows import StatementRows
from pgmp_petsc.mechanism.statements import ANGLE, Combination, Function, Line, Statement, along, angle, perpendicular
from pgmp_petsc.scene.bodies import Placement
from pgmp_petsc.scene.effects import AddedMass
from pgmp_petsc.scene.fields import GROUND
from pgmp_petsc.scene.joints import DAMPED_BY, PARALLEL, TURNS, CouplingEntry, Elastic, JointEntry, Offset, followed
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.references import point_problems
from pgmp_petsc.scene.schema import Scene
from pgmp_petsc.scene.uses import slides

ROUNDED = 1e-9  # of the length of a run of nodes, by which a range may be longer


def bodies_of(scene: Scene, meshes: Mapping[str, BodyShape]) -> tuple[Body, ...]:
    """Return the bodies of a scene with the point masses that they carry, numbered one after the other.

    A point mass away from the centre of a rigid body is a body of its own, welded to it (`connections_of`): the mass
    matrices then stay constant, and affine in the parameters. Raises `InputError` if a point mass is at a point that
    its body's mesh does not have.
    """
    bodies = {name: body_of(scene, name, meshes[name]) for name in scene.bodies}
    for name, effect in scene.effects.items():
        if isinstance(effect, AddedMass):
            owner, _, point = effect.point.partition(":")
            node = bodies[owner].shape.point(point, f"effects.{name}.point")
            bodies[owner], particle = bodies[owner].carrying(node, _lumps(effect), _welded(name))
            if particle is not None:
                bodies[particle.name] = particle
    numbered, first_node = [], 0
    first_internal = sum(body.node_dofs * body.n_nodes for body in bodies.values())
    for body in bodies.values():
        numbered.append(body.numbered(first_node, first_internal))
        first_node += body.n_nodes
        first_internal += body.n_internal
    return tuple(numbered)


def attachment_at(scene: Scene, bodies: Sequence[Body], address: str, entry: str) -> Attachment:
    """Return the attachment at ``"body:point"`` or ``"ground:point"``.

    Raises `InputError` if there is no such point, on the ground or on a body; `entry` is the scene entry to blame.
    """
    for line in point_problems(scene, entry, address, ground_allowed=True):
        raise InputError(line)
    name, _, point = address.partition(":")
    if name == GROUND:
        return Attachment.on_ground_at(np.asarray(scene.ground_position(point), dtype=float))
    index = next(i for i, body in enumerate(bodies) if body.name == name)
    body = bodies[index]
    number = body.shape.point(point, entry)
    place = body.shape.nodes[number]
    if body.flexible:
        return Attachment(index, body.first_node + number, place, np.zeros_like(place))
    return Attachment(index, body.first_node, place, place - body.mesh.nodes[0])


def connections_of(scene: Scene, bodies: Sequence[Body], poses: np.ndarray) -> tuple[Connection, ...]:
    """Return the joints of a scene, and the welds of point masses to rigid bodies.

    A joint's axes in the second body are those of the first at poses (n_bodies, n_pose); in the plane angles are those
    between the bodies' axes. Raises `InputError` if a joint names a point that its body's mesh does not have, or is
    elastic where it is free (`parted`).
    """
    space, d = space_of(scene.dimension), scene.dimension
    connections, row = [], 0
    for name, holds, axes, sides in _held(scene, bodies):
        in_a = triad(*(np.asarray(axis, dtype=float) for axis in axes)) if axes else np.eye(d)
        one, other = (space.natural(s.frame_of_pose(poses))[d:].reshape(d, d) for s in sides)  # directors
        turn = other @ one.T
        in_b = turn @ in_a
        statements = tuple(holds(in_a, in_b))
        rows = slice(row, row + len(statements))
        turning = in_a, in_b if space is SPATIAL else in_a
        entry = scene.joints.get(name)  # none of welds
        elastic, offset, loose = (None,) * 3 if entry is None else (entry.elastic, entry.offset, entry.clearance)
        held, straight, released, moved, turned = statements, statements, (), sides[0], np.eye(d)
        riding = entry is not None and entry.rides and not sides[0].on_ground and bodies[sides[0].body].flexible
        if loose is not None:
            _refuse_room(scene, bodies, name, sides)
            held, released = loosened(statements, in_a, entry.loose)
        if offset is not None:
            place, turned = _off(scene, offset)
            moved = replace(moved, point=moved.point + place, arm=moved.arm + (0.0 if moved.on_ground else place))
            held = tuple(holds(turned @ in_a, in_b))
        if elastic is not None and any(isinstance(part, Combination) for part in statements):
            words = "this joint has no axes that are the same everywhere along its curve; let a body between be elastic"
            raise InputError(problem(f"joints.{name}.elastic", words))
        if elastic is not None:
            first, second = (0.0 if s.on_ground else poses[s.body, -1] for s in sides)
            rest = second - first if space is not SPATIAL else 0.0
            both = list(zip(statements, held))
            straight, held, released = parted(both, (in_a, in_b), turn, rest, entry, f"joints.{name}", turned)
        level = None if offset is None else about(straight, *sides)
        held = about(held, moved, sides[1])
        if riding:
            held = tuple(ridden(in_a, in_b, _run(scene, bodies, name, sides[0], in_a[:, 0]), sides[1]))
        connections.append(Connection(name, statements, *sides, rows, turning, held, released, level))
        row = rows.stop
    return tuple(connections)


def couplings_of(
    scene: Scene, connections: Sequence[Connection], poses: np.ndarray, known: Sequence[Statement]
) -> tuple[Coupling, ...]:
    """Return the joints of a scene that couple motions of its connections, with what holds at poses (n_bodies, n_pose).

    Their statements stand in the order of the scene, but for an angle that is none of those known, which is the last:
    in space its turn follows from the others.
    """
    by_name, row = {one.name: one for one in connections}, sum(len(one.statements) for one in connections)
    entries = {name: one for name, one in scene.joints.items() if isinstance(one, CouplingEntry)}
    follows = {name: by_name[joint].measure(motion) for (joint, motion), name in followed(scene).items()}
    lines: dict[Statement, Line] = {}
    found = {}
    for name in (*follows, *(name for name in entries if name not in follows)):
        entry = entries[name]
        terms, shares = [], entry.shares_in(scene)
        factors = np.array([share.times * scene.number(share.factor) for share in shares])
        # of the first motion itself: radii of millimetres are no weaker constraints
        for share, factor in zip(shares, factors / factors[0]):
            joint = by_name[share.joint]
            function = Function.through(factor, share.table) if share.table else Function(factor)
            terms.append((joint.measure(share.motion), function, joint.sides))
        own = {term[0]: lines[term[0]] for term in terms if term[0] in lines}
        terms.sort(key=lambda term: term[0].kind == ANGLE and term[0] not in {*known, *own} and not term[1].breaks.size)
        combination = Combination(tuple(term[:2] for term in terms), own)
        sides = tuple(side for term in terms for side in term[2])
        # each motion by itself: an angle is the one nearest to zero, and not to what the others leave of nothing
        alone = [(Combination((term[:2],)), term[2]) for term in terms if entry.from_placements]
        value = float(StatementRows.on_poses(alone, space_of(scene.dimension)).values(poses.ravel()).sum())
        if name in follows:
            lines[follows[name]] = _rest(combination, follows[name], value)
        found[name] = combination, sides, value
    return tuple(
        Coupling(name, *found[name], slice(row + k, row + k + 1), bool(entry.gives_way))
        for k, (name, entry) in enumerate(entries.items())
    )


def _rest(combination: Combination, last: Statement, value: float) -> Line:
    """Return what coordinates, and lines over them, leave of a combination's value for one of its statements."""
    factors = {statement: function.factor for statement, function in combination.terms}
    own, slopes = factors.pop(last), defaultdict[Statement, float](float)
    for statement, factor in factors.items():
        line = combination.lines.get(statement, Line(0.0, {statement: 1.0}))
        value -= factor * line.offset
        for one, slope in line.slopes.items():
            slopes[one] -= factor * slope / own
    return Line(value / own, slopes)


def _run(scene: Scene, bodies: Sequence[Body], joint: str, first: Attachment, way: np.ndarray) -> list[Attachment]:
    """Return the nodes of a beam along a direction (d,) through a point, which a joint rides on.

    Raises `InputError` if there are none but the point, or a coordinate has the joint beyond them.
    """
    body = bodies[first.body]
    nodes, along = body.mesh.run(first.node - body.first_node, way)
    if nodes.size == 1:
        words = f"no nodes of beams are beside this point of {body.name} along direction, so that nothing bends there; "
        raise InputError(problem(f"joints.{joint}", words + "the joint point_on_line has a line fixed to the point"))
    spare = ROUNDED * (along[-1] - along[0])
    for name, entry in scene.coordinates.items():
        within = along[0] - spare <= entry.range[0] and entry.range[1] <= along[-1] + spare
        if entry.joint == joint and slides(scene, entry) and not within:
            (low, high), unit = scene.system.named(along[[0, -1]], "m")
            words = f"must be within the run of nodes, {low:.6g} to {high:.6g} {unit} from the first point"
            received = [scene.system.shown(end, "m") for end in entry.range]
            raise InputError(problem(f"coordinates.{name}.range", words, received))
    places = body.mesh.nodes
    return [Attachment(first.body, body.first_node + k, places[k], np.zeros_like(way)) for k in nodes]


def _refuse_room(scene: Scene, bodies: Sequence[Body], name: str, sides: Sequence[Attachment]) -> None:
    """Refuse a joint whose pin has more room than one of its bodies is long."""
    radius = scene.number(scene.joints[name].clearance.radius)
    for body in (bodies[side.body] for side in sides if not side.on_ground):
        size = float(np.linalg.norm(np.ptp(body.shape.nodes, axis=0)))
        if 0.0 < size <= radius:
            words = f"is larger than {body.name}, which is {scene.system.text(size, 'm', '.4g')} long"
            raise InputError(problem(f"joints.{name}.clearance.radius", words, scene.system.shown(radius, "m")))


def _off(scene: Scene, offset: Offset) -> tuple[np.ndarray, np.ndarray]:
    """Return by how much an offset moves a point (d,), m, and what turns its axes, shape (d, d)."""
    place = np.array([scene.number(x) for x in offset.place or (0.0,) * scene.dimension])
    turn = [scene.number(x) for x in offset.turn]
    if not any(turn):
        return place, np.eye(scene.dimension)
    return place, _rotation(np.array(turn))


def _rotation(turn: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of an angle (1,) in the plane, (2, 2), or of axis times angle (3,), (3, 3), rad."""
    if turn.size == 1:
        cos, sin = np.cos(turn[0]), np.sin(turn[0])
        return np.array([[cos, -sin], [sin, cos]])
    return scipy.spatial.transform.Rotation.from_rotvec(turn).as_matrix()


def _held(
    scene: Scene, bodies: Sequence[Body]
) -> Iterator[tuple[str, Callable, tuple[tuple[float, ...], ...], tuple[Attachment, Attachment]]]:
    """Yield name, what makes the statements, axes and attachments of the joints, and of the welds of point masses to
    rigid bodies."""
    for name, entry in scene.joints.items():
        if isinstance(entry, CouplingEntry):
            continue
        yield (
            name,
            entry.statements,
            entry.axes,
            tuple(attachment_at(scene, bodies, address, f"joints.{name}.connect") for address in entry.connect),
        )
    numbers = {body.name: number for number, body in enumerate(bodies)}
    for name, effect in scene.effects.items():
        index = numbers.get(_welded(name)) if isinstance(effect, AddedMass) else None
        if index is None:
            continue
        carrier = attachment_at(scene, bodies, effect.point, f"effects.{name}.point")
        place = bodies[index].mesh.nodes[0]
        particle = Attachment(index, bodies[index].first_node, place, np.zeros_like(place))
        yield _welded(name), weld, (), (carrier, particle)


def first_guess(scene: Scene, bodies: Sequence[Body]) -> np.ndarray:
    """Return poses to start the assembly from, shape (n_bodies, n_pose); they choose the assembly branch.

    A body with a `placement` takes that; the others are moved, joint by joint from the ground, so that their joint
    point meets the one already placed, with the direction that they have in their mesh.
    """
    space = space_of(scene.dimension)
    d = space.dimension
    poses = np.tile(space.identity, (len(bodies), 1))
    placed = np.zeros(len(bodies), dtype=bool)
    for number, body in enumerate(bodies):
        placement = scene.bodies[body.name].placement if body.name in scene.bodies else None
        if placement is not None:
            poses[number] = _placed(placement, d)
            placed[number] = True
    waiting = [sides for _, holds, _, sides in _held(scene, bodies) if share_position(holds(np.eye(d), np.eye(d)))]
    while True:
        ready = [(a, b) for a, b in waiting if (a.on_ground or placed[a.body]) != (b.on_ground or placed[b.body])]
        if not ready:
            return poses
        a, b = ready[0]
        anchor, loose = (a, b) if a.on_ground or placed[a.body] else (b, a)
        if bodies[loose.body].name not in scene.bodies:
            poses[loose.body, d:] = poses[anchor.body, d:]
        poses[loose.body, :d] += anchor.frame_of_pose(poses)[:d] - loose.frame_of_pose(poses)[:d]
        placed[loose.body] = True
        waiting.remove((a, b))


def _placed(placement: Placement, dimension: int) -> np.ndarray:
    """Return the pose of a placed body."""
    origin = np.array((*placement.origin, 0.0)[:dimension])
    if dimension == 2:
        return np.array([*origin, placement.angle])
    turn = _rotation(np.array(placement.rotation or (0.0, 0.0, 0.0)))
    return np.concatenate([origin, turn.T.ravel()])


def _lumps(effect: AddedMass) -> dict[Monomial, LumpedMass]:
    mass = Quantity.of(effect.mass)
    lumps = {mass.monomial: LumpedMass(mass.coefficient, 0.0)}
    if effect.inertia:
        inertia = Quantity.of(effect.inertia)
        return joined(lumps, {inertia.monomial: LumpedMass(0.0, inertia.coefficient)})
    return lumps


def _welded(effect: str) -> str:
    """Return the name of the body that a point mass on a rigid body is; no scene's name has a colon."""
    return f"{effect}:mass"


AXES = ("first", "second", "third")


def parted(
    statements: Sequence[tuple[Statement, Statement]],
    joint: tuple[np.ndarray, np.ndarray],
    turn: np.ndarray,
    rest: float,
    given: JointEntry,
    entry: str,
    turned: np.ndarray,
) -> tuple[tuple[Statement, ...], tuple[Statement, ...], tuple[Release, ...]]:
    """Return what an elastic joint holds in the motion, were it where it should be and where it is, and what it
    releases.

    Its statements are what it holds in the configuration, each with that about its axes where it is: `turned` by its
    offset, shape (d, d). Its axes in the frames of a and b, shape (d, d) each, are as
    `scene.joints.JointEntry.statements` takes them. As placed, `turn`, shape (d, d), turns vectors of the frame of a
    into that of b, and b is turned by `rest` (rad) against a in the plane. What is `given` in the scene has the name
    `entry`.

    Raises `InputError` if it has a stiffness or damping where the joint is free, its axes are oblique to those of the
    joint, or the joint is turned by an offset, so that what it releases is off by more the further it has moved.
    """
    elastic, offset = given.elastic, given.offset
    in_a = triad(*(np.array(axis, dtype=float) for axis in elastic.reference))
    in_b, d = turn @ in_a, len(in_a)
    held, released = [], []
    for key, damped_by in DAMPED_BY.items():
        own = [pair for pair in statements if pair[0].is_length == (key == "stiffness")]
        parts, moved = ([pair[k] for pair in own] for k in (0, 1))
        stiffness = getattr(elastic, key)
        if not stiffness:
            held += own
            continue
        axes = in_a if d == 3 or key == "stiffness" else np.ones((1, 1))
        slopes = _slopes(parts, *joint)[key == "turning_stiffness"]
        is_held = _is_held(slopes, axes, key, elastic, f"{entry}.elastic.{key}")
        for name in (key, damped_by):
            _refuse_free(name, getattr(elastic, name), is_held, f"{entry}.elastic")
        if all(k == np.inf for k, of in zip(stiffness, is_held) if of):
            held += own
            continue
        if offset is not None and any(offset.turn):
            _refuse_turned(key, is_held, f"{entry}.offset.turn", offset)

        def measures(axes: np.ndarray, parts: list[Statement]) -> list[Statement | None]:
            if key == "stiffness":
                return [along(axis) for axis in axes.T]
            return _about(axes, in_b, is_held, parts)

        exact, moving = measures(in_a, parts), measures(turned @ in_a, moved)
        for axis in np.flatnonzero(is_held):
            part = exact[axis]
            if stiffness[axis] == np.inf:
                held.append((part, moving[axis]))
            else:
                at_rest = [Quantity(rest if part.kind == ANGLE else 0.0)]
                if offset is not None:
                    slope = np.concatenate(_slopes([part], *joint), axis=1)[0]
                    given = (*(offset.place or (0.0,) * d), *(offset.turn or (0.0,) * TURNS[d]))
                    at_rest += [Quantity.of(x) * float(s) for x, s in zip(given, slope) if abs(s) > PARALLEL]
                released.append(Release(part, key, int(axis), AffineSum.total(*at_rest)))
    return tuple(part for part, _ in held), tuple(part for _, part in held), tuple(released)


def _refuse_turned(key: str, is_held: np.ndarray, entry: str, offset: Offset) -> None:
    """Refuse axes that are turned by an offset where the joint moves on along them, or about several axes."""
    if key == "stiffness" and not is_held.all():
        words = "turns what the joint slides along, which it releases across that by more the further it slides"
    elif np.count_nonzero(~is_held) > 1:
        words = "turns what the joint turns about, and it turns about several axes"
    else:
        return
    words += ": not made for a joint with elastic in these directions; take place, or inf for them"
    raise InputError(problem(entry, words, list(offset.turn)))


def loosened(
    statements: Sequence[Statement], in_a: np.ndarray, loose: str
) -> tuple[tuple[Statement, ...], tuple[Release, ...]]:
    """Return what a joint with a clearance holds in the motion, and what it releases there.

    Its axes in the frame of a are columns, shape (d, d), the identity of one without; `loose` is as of
    `scene.joints.JointTable`.
    """
    held, lengths = ([part for part in statements if part.is_length == of] for of in (False, True))
    axes = list(in_a.T)
    meets = len(lengths) == len(axes)
    if loose == "across" and not (meets and len(axes) == 2):  # in the plane a pin's axis is across it
        held = [*([along(axes[0])] if meets else []), *held]
        axes = axes[1:]
    return tuple(held), tuple(Release(along(axis), "clearance", number) for number, axis in enumerate(axes))


def sines(in_a: np.ndarray, in_b: np.ndarray) -> list[Statement]:
    """Return the sines of rotations about the axes of a triad (3, 3) in a, whose directions in b are others (3, 3)."""
    return [perpendicular(in_a[:, k - 1], in_b[:, k - 2]) for k in range(3)]


def _about(in_a: np.ndarray, in_b: np.ndarray, is_held: np.ndarray, own: Sequence[Statement]) -> list[Statement | None]:
    """Return what measures the rotation about each axis that is held (`parted`)."""
    free = np.flatnonzero(~is_held)
    if len(in_a) == 2:
        return [angle(np.eye(2), np.eye(2))]
    if not free.size:
        return sines(in_a, in_b)
    if free.size == 1:
        j = int(free[0])
        return [None if k == j else perpendicular(in_a[:, 3 - j - k], in_b[:, j]) for k in range(3)]
    return [own[0] if of else None for of in is_held]


def _slopes(parts: Sequence[Statement], in_a: np.ndarray, in_b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the changes of statements with displacements (n, d) and rotations (n, 1 or 3) of b, in the frame of a, as
    assembled: where the axes of a joint in both frames are the same."""
    d = len(in_a)
    turned = in_a @ in_b.T  # the directors of b in a, one a column
    a, b = (np.concatenate([np.zeros(d), directors.T.ravel()])[:, None] for directors in (np.eye(d), turned))
    moved, turning = np.zeros((len(parts), d)), np.zeros((len(parts), TURNS[d]))
    for row, part in enumerate(parts):
        slopes = part.gradient(a, b)[d * (d + 1) :, 0].reshape(d + 1, d)
        moved[row] = slopes[0]
        # a rotation w changes the director d_k by w x d_k
        pulls = turned @ slopes[1:]
        turning[row] = (pulls - pulls.T)[[0] if d == 2 else [1, 2, 0], [1] if d == 2 else [2, 0, 1]]
    return moved, turning


def _is_held(slopes: np.ndarray, axes: np.ndarray, key: str, elastic: Elastic, entry: str) -> np.ndarray:
    """Return which axes, one a column, are held where statements have such slopes (n, n_axes); the others are free."""
    part = np.linalg.pinv(slopes) @ slopes @ axes
    held, free = (np.linalg.norm(of, axis=0) < PARALLEL for of in (axes - part, part))
    if not np.all(held | free):
        words = "an axis that is oblique to what the joint leaves free is neither held nor free; take axes along and "
        words += f"across it in {entry.removesuffix(key)}reference"
        raise InputError(problem(entry, words, list(getattr(elastic, key))))
    return held


def _refuse_free(name: str, numbers: Sequence[float | str], is_held: np.ndarray, entry: str) -> None:
    """Refuse what acts along or about an axis that the joint leaves free."""
    for axis, (number, of) in enumerate(zip(numbers, is_held)):
        if not of and number != 0.0:
            turning = name.startswith("turning")
            which = "turning" if turning and is_held.size == 1 else f"the {AXES[axis]} axis of reference"
            what = which if which == "turning" else f"turning about {which}" if turning else f"sliding along {which}"
            words = f"the joint leaves {what} free: 0 is needed there, and springs are effects of their own"
            raise InputError(problem(f"{entry}.{name}", words, list(numbers)))
