"""Forces and moments in joints, what prescribed motions take, outputs of the multipliers of constraints, and what
controllers put on joints.

With the equations of motion

    M q'' + g_int + C^T lambda = g_ext,     c(q) = 0,

a joint that holds statements s_i of two frames acts on the second one with ``-lambda_i ds_i/dp`` at its point, and with
the moment ``-sum_k d_k x lambda_i ds_i/dd_k``, p and d_k being position and directors there. What a joint releases that
gives way is held by laws of its own, ``F(s, s')`` in place of ``-lambda``: springs and dampers of an elastic joint,
contact and friction of one with a clearance (`effects.clearance`), nothing where its parts do not touch.

**Point and sign.** Force and moment are those on the body of the joint's second point, at that point; with
``of = "first"`` they are the opposite ones on the first body, at the same point of space. They are what the joint
itself transmits: effects of the scene that act on it and prescribed motions are not in it. A coupling acts on the
motion of its first or second joint by ``-mu df/ds``. What a prescribed motion takes is ``-lambda`` of its coordinate,
above zero where it drives on; its power is that times the rate of the coordinate.

Where constraints follow from others (`mechanism.constraint_set`), forces that hang on how they are shared out are
refused, with a combination that is determined. Multipliers are the models' own: of full-order and component models
those of their equations (`full.systems`), of a reduced model those that `reduction` finds from static answers to gaps.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, ClassVar, Self

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.declare.ideas import OUTPUTS
from pgmp_petsc.effects import springs_of_joints
from pgmp_petsc.effects.action import Action, turning_freely
from pgmp_petsc.mechanism.joints import Attached, Attachment, Connection, Coupling
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism, Unknowns
from pgmp_petsc.mechanism.space import SPATIAL, Space
from pgmp_petsc.mechanism.statements import MEET, Combination, Function, Statement
from pgmp_petsc.outputs.readings import AXES, Frames, Rate, Reading, Seen
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.joints import CouplingEntry
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.outputs import OutputEntry, after_start

SIZES = ("magnitude", "radial")  # components that are the size of a vector
UNDETERMINED = 1e-8  # share of a combination of multipliers that is round-off


def joints_of(scene: Scene) -> dict[str, str]:
    """Return the joint of every output of what acts in one, by the outputs' names."""
    return {name: output.joint for name, output in scene.outputs.items() if output.in_joint}


def judged(scene: Scene, found: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return outputs of a scene over whole runs, or their errors, each (n_t, ...), as they are judged.

    Those that are counted are what they are at the end at every instant: a damage and a life are figures of a run as a
    whole. Those of `after_start` are at the start what they are at the next instant.
    """
    result, late = dict(found), after_start(scene)
    for name, values in found.items():
        if name in scene.counted:
            result[name] = np.full_like(values, values[-1])
        elif name in late and len(values) > 1:
            result[name] = np.concatenate([values[1:2], values[1:]])
    return result


def share_of(joint: CouplingEntry, shares: Sequence, of: str):
    """Return the share of the first or second joint that a coupling names."""
    names = list(dict.fromkeys([*getattr(joint, "joints", ()), *(share.joint for share in shares)]))
    own = [share for name in names for share in shares if share.joint == name]
    return own[0 if of == "first" else 1]


@dataclass(frozen=True, eq=False)
class ForceOutput:
    """One output of multipliers.

    Multipliers are those of what joints hold in the motion, in the order of `Mechanism.holders`, and behind them those
    of prescribed coordinates: shape (n_held + n_driven, n).
    """

    name: str  # in the scene
    rows: np.ndarray  # numbers of the multipliers that it takes
    nodes: frozenset[int]  # nodes whose frames it takes
    reads_rates: bool  # whether it takes their rates
    entry: OutputEntry
    n_parts: ClassVar[int] = 1  # numbers that it is made of, which are smooth in the motion

    @property
    def is_size(self) -> bool:
        """Whether it is the magnitude of what it is made of, else that itself."""
        return getattr(self.entry, "component", "") in SIZES

    def parts(self, seen: Seen) -> np.ndarray:
        """Return what the output is made of, shape (n_parts, n)."""
        raise NotImplementedError

    def made(self, parts: np.ndarray) -> np.ndarray:
        """Return the output, shape (n,), of its parts."""
        return np.linalg.norm(parts, axis=0) if self.is_size else parts[0]


@dataclass(frozen=True, eq=False)
class OfConnection(ForceOutput):
    """A component of what a joint does to a body."""

    entry: Any  # of `joint_forces`
    space: Space  # of the mechanism
    connection: Connection
    held: tuple[Attached, ...]  # what the rows hold, and of which points
    pulls: tuple[Pull, ...]  # what acts in the directions that it releases
    #: force for a unit of each multiplier, shape (d, n_rows), where that is the same everywhere
    shares: np.ndarray | None = None

    @property
    def n_parts(self) -> int:
        d = self.space.dimension
        return (d if d == 3 or not self.entry.turning else 1) if self.is_size else 1

    @classmethod
    def of(cls, name: str, entry: Any, connection: Connection, mechanism: Mechanism) -> Self:
        """Prepare the output of a joint that holds two points. Raises `InputError` if it holds nothing there."""
        pulls = ()
        if connection.released:
            pulls = tuple(Pull.of(action, mechanism.space) for action in _actions_in(connection.name, mechanism))
        statements = [part for part, _ in connection.held]
        statements += [part for pull in pulls for part, _ in pull.action.statement.terms]
        if entry.turning and all(part.is_length for part in statements):
            joint = mechanism.scene.joints[connection.name]
            raise InputError(
                problem(
                    f"outputs.{name}.joint",
                    f"this one is {joint.type}, which holds no turning: no moment is in it. The torque of a prescribed "
                    "motion is drive_torque, and that of an effect is its own",
                    connection.name,
                )
            )
        d, first = mechanism.space.dimension, _rows_of(mechanism, connection.name).start
        chosen = [k for k, (part, _) in enumerate(connection.held) if _acts(part, entry.turning, d)]
        rows, held = first + np.array(chosen, dtype=int), tuple(connection.held[k] for k in chosen)
        sides = [*connection.sides, *(side for _, own in held for side in own)]
        nodes = frozenset(side.node for side in sides if not side.on_ground)
        reads_rates = any(pull.action.reads_rate for pull in pulls)
        made = cls(name, rows, nodes, reads_rates, entry, mechanism.space, connection, held, pulls)
        along_ground = entry.frame == "ground" and entry.component not in ("axial", "radial")
        meet = all(isinstance(part, Statement) and part.kind == MEET for part, _ in held)
        if entry.turning or pulls or not along_ground or not meet:
            return made
        nowhere = {node: np.zeros((mechanism.space.n_pose, 1)) for node in nodes}
        return replace(made, nodes=frozenset(), shares=_map_of(made, nowhere, mechanism)[:, rows])

    def parts(self, seen: Seen) -> np.ndarray:
        if self.shares is not None:
            # sums of numbers alone: those of matrices hang on what is side by side
            force = sum(share[:, None] * seen.multipliers[row] for share, row in zip(self.shares.T, self.rows))
        else:
            known = self.connection.name, self.entry.turning
            if known not in seen.wrenches:
                seen.wrenches[known] = self.wrench(seen)
            force = seen.wrenches[known][int(self.entry.turning)]
        return self.component(-force if self.entry.of == "first" else force, seen.frames[0])

    def wrench(self, seen: Seen) -> tuple[np.ndarray, np.ndarray]:
        """Return force (d, n) and moment (1 or 3, n) on the second body at the second point, in the ground's axes."""
        n, d = seen.multipliers.shape[1], self.space.dimension
        b = self._natural(self.connection.b, seen.frames[0], n)
        slopes, firsts = np.zeros_like(b), {side for _, own in self.held for side in own[::2]}
        natural = {side: self._natural(side, seen.frames[0], n) for side in firsts}
        for row, (part, own) in zip(self.rows, self.held):
            for (statement, function), first in zip(part.terms, own[::2]):
                # that points meet has the same slopes everywhere
                some = slice(0, 1) if statement.kind == MEET and not function.breaks.size else slice(None)
                sides = natural[first][:, some], b[:, some]
                gradient = statement.gradient(*sides)[len(b) :]
                slopes -= seen.multipliers[row] * function.at(statement.value(*sides))[1] * gradient
        if self.pulls:
            a = self._natural(self.connection.a, seen.frames[0], n)
            for pull, force, factors in acting(self.pulls, seen):
                for (statement, _), factor in zip(pull.action.statement.terms, factors):
                    slopes += force * factor * statement.gradient(a, b)[len(a) :]
        return slopes[:d], _moment(b, slopes, d)

    def component(self, acting: np.ndarray, frames: Frames) -> np.ndarray:
        """Return the component of a force or moment (n_components, n) in the ground's axes, (1, n), or the vector whose
        magnitude it is."""
        wanted, n = self.entry.component, acting.shape[1]
        if wanted == "magnitude" or len(acting) == 1:  # about z
            return acting
        if wanted in ("axial", "radial"):
            along = self.axis(frames, n)
            axial = np.einsum("cn,cn->n", along, acting)
            return axial[None] if wanted == "axial" else acting - axial * along
        if self.entry.frame == "ground":
            return acting[AXES[wanted]][None]
        side = self.connection.a if self.entry.of == "first" else self.connection.b
        d, natural = self.space.dimension, self._natural(side, frames, n)
        return np.einsum("cn,cn->n", natural[d:].reshape(d, d, n)[AXES[wanted]], acting)[None]

    def axis(self, frames: Frames, n: int) -> np.ndarray:
        """Return the direction of the joint's first axis, shape (d, n)."""
        d, a = self.space.dimension, self._natural(self.connection.a, frames, n)
        return np.einsum("k,kcn->cn", self.connection.axes[0][:, 0], a[d:].reshape(d, d, n))

    def _natural(self, side: Attachment, frames: Frames, n: int) -> np.ndarray:
        return self.space.natural(side.ground_frame((n,)) if side.on_ground else side.frame_of(frames[side.node]))


@dataclass(frozen=True, eq=False)
class Pull:
    """A force in a direction that a joint releases, by a law."""

    action: Action
    readings: tuple[Reading, ...]  # of the terms of what the law is of
    #: what their sum is near to, and by how much each turn of an angle changes it of which only the others tell turns
    value: float = 0.0
    turns: tuple[float, ...] = ()

    @classmethod
    def of(cls, action: Action, space: Space) -> Self:
        """Return that of an action on statements about two frames."""
        parts = (part for part, _ in action.statement.terms)
        return cls(action, tuple(Reading("MEASURE", own, part, space) for own, part in zip(action.pairs, parts)))

    def measured(self, seen: Seen) -> tuple[np.ndarray, np.ndarray, list[np.ndarray | float]]:
        """Return what the law is of and its rate, (n,) each, and the derivatives with the terms' statements."""
        read = [reading.value(seen.frames[0]) for reading in self.readings]
        found = [function.at(s) for s, (_, function) in zip(read, self.action.statement.terms)]
        factors, speed = [slope for _, slope in found], np.zeros(read[0].shape)
        if self.action.reads_rate:
            speed = sum(slope * Rate(reading).jet(seen, 0)[0] for slope, reading in zip(factors, self.readings))
        s = sum(value for value, _ in found)
        for turn in self.turns:
            s = s + turn * np.round((self.value - s) / turn)
        return s, speed, factors


def acting(pulls: Sequence[Pull], seen: Seen) -> Iterator[tuple[Pull, np.ndarray, list[np.ndarray | float]]]:
    """Yield what acts in a joint, with the force of its law, (n,), and the derivatives with the terms' statements."""
    s = speed = np.zeros(0)
    for pull in pulls:
        own, rate, factors = pull.measured(seen)
        by_load = pull.action.by_load  # of the measure and the rate of the one before
        amplitude = speed if by_load else 0.0
        if not by_load:
            s, speed = own, rate
        p = [np.broadcast_to(quantity.at(seen.values), own.shape) for quantity in pull.action.parameters]
        yield pull, pull.action.law.forces(np.stack(p, axis=1), s, rate, amplitude), factors


@dataclass(frozen=True, eq=False)
class OfCoupling(ForceOutput):
    """Force or torque of a coupling on the motion of one of its joints."""

    reading: Reading  # of the motion
    function: Function  # of the motion, in the coupling
    pull: Pull | None  # in place of a multiplier

    @classmethod
    def of(cls, name: str, entry: Any, coupling: Coupling, kinematics: RigidKinematics) -> Self:
        """Prepare the output of a joint that couples motions."""
        mechanism = kinematics.mechanism
        joint = mechanism.scene.joints[coupling.name]
        share = share_of(joint, joint.shares_in(mechanism.scene), entry.of)
        terms = coupling.combination.terms
        pairs = list(zip(coupling.sides[::2], coupling.sides[1::2]))
        readings = [_motion(part, pair, mechanism, kinematics) for (part, _), pair in zip(terms, pairs)]
        wanted = mechanism.connection(share.joint).sides
        number = next(
            k for k, ((part, _), pair) in enumerate(zip(terms, pairs))
            if pair == wanted and part.is_length == (share.motion == "sliding")
        )  # fmt: skip
        pull, nodes = None, set(readings[number].nodes)
        rows = np.array([_rows_of(mechanism, coupling.name).start])
        if joint.gives_way:
            (action,) = _actions_in(coupling.name, mechanism)
            loose = [] if mechanism.space is not SPATIAL else turning_freely(coupling.combination, mechanism)
            turns = tuple(2.0 * np.pi * abs(terms[k][1].factor) for k in loose)
            pull = Pull(action, tuple(readings), coupling.value, turns)
            rows, nodes = rows[:0], set().union(*(reading.nodes for reading in readings))
        return cls(
            name, rows, frozenset(nodes), pull is not None and pull.action.reads_rate, entry, readings[number],
            terms[number][1], pull,
        )  # fmt: skip

    def parts(self, seen: Seen) -> np.ndarray:
        """Return ``-mu df/ds``."""
        if self.pull is None:
            force = -seen.multipliers[self.rows[0]]
        else:
            ((_, force, _),) = acting((self.pull,), seen)
        return np.reshape(force * self.function.at(self.reading.value(seen.frames[0]))[1], (1, -1))


def _motion(part: Statement, pair: tuple[Attachment, Attachment], mechanism: Mechanism, kinematics: RigidKinematics):
    for connection in mechanism.connections:
        if connection.sides == pair and connection.angle is part:
            return Reading.of_angle(connection, kinematics)
    return Reading("MEASURE", pair, part, mechanism.space)


@dataclass(frozen=True, eq=False)
class OfPrescribed(ForceOutput):
    """Force or torque of a prescribed motion, or its power."""

    speed: Reading | None  # of the coordinate, for the power
    coordinate: int  # its number

    def parts(self, seen: Seen) -> np.ndarray:
        """Return ``-lambda``, or that times the rate of the coordinate."""
        torque = -seen.multipliers[self.rows]
        return torque if self.speed is None else torque * Rate(self.speed).jet(seen, 0)[0]


def _acts(part: Statement | Combination, turning: bool, d: int) -> bool:
    """Whether what holds a part is in a joint's force, or, of what is turning, in its moment: whether it changes with
    the place or with the directors of the second point."""
    frames = np.random.default_rng(1).normal(size=(2, d * (d + 1)))
    slopes = [own.generic.gradient(*frames)[d * (d + 1) :] for own, _ in part.terms]
    return any(np.any(one[d:] if turning else one[:d]) for one in slopes)


def _moment(z: np.ndarray, slopes: np.ndarray, d: int) -> np.ndarray:
    """Return ``sum_k d_k x g_k``, shape (1 or 3, n), for position and directors z and slopes g, (d (d + 1), n)."""
    axes, pulls = (part[d:].reshape(d, d, -1) for part in (z, slopes))
    if d == 2:
        return np.sum(axes[:, 0] * pulls[:, 1] - axes[:, 1] * pulls[:, 0], axis=0)[None]
    return np.cross(axes, pulls, axis=1).sum(axis=0)


def _actions_in(name: str, mechanism: Mechanism) -> list[Action]:
    """Return what acts in a joint or coupling that gives way."""
    every = springs_of_joints(mechanism.scene, mechanism)
    return next(effect.actions() for effect in every if effect.name == name)


def _rows_of(mechanism: Mechanism, name: str) -> slice:
    """Return the numbers of the multipliers of a joint or coupling."""
    row = 0
    for one in mechanism.holders:
        rows = slice(row, row := row + len(one.holding(moving=True)))
        if one.name == name:
            return rows
    raise KeyError(name)


def force_outputs(scene: Scene, kinematics: RigidKinematics, start: np.ndarray) -> tuple[ForceOutput, ...]:
    """Return the outputs of multipliers of a scene, in its order.

    Raises `InputError` where the constraints at the start, coordinates (n_theta,), do not determine one.
    """
    found = tuple(
        entry.multiplied(name, kinematics) for name, entry in scene.outputs.items() if "multipliers" in entry.reads
    )
    if any(output.rows.size for output in found if not isinstance(output, OfPrescribed)):
        _refuse_undetermined(found, kinematics, start)
    return found


def carried_forces(scene: Scene, kinematics: RigidKinematics, start: np.ndarray) -> tuple[ForceOutput, ...]:
    """Return the sizes of the forces in joints that effects of a scene hang on, in the order of `Scene.carried`.

    Raises `InputError` where the constraints at the start, coordinates (n_theta,), do not determine one.
    """
    joint_force = OUTPUTS.named("joint_force")
    found = tuple(
        joint_force(type="joint_force", joint=entry.joint).multiplied(name, kinematics)
        for name, entry in scene.carried.items()
    )
    if found:
        _refuse_undetermined(found, kinematics, start, "effects")
    return found


def _refuse_undetermined(
    outputs: Sequence[ForceOutput], kinematics: RigidKinematics, start: np.ndarray, table: str = "outputs"
) -> None:
    """Refuse forces that hang on how dependent constraints share them out, of entries in a table of the scene."""
    mechanism = kinematics.mechanism
    unknowns = Unknowns(mechanism)
    q = unknowns.place(kinematics.poses(start)[..., 0])
    shares = kinematics.constraints.undetermined(q)
    if not shares.shape[1]:
        return
    shares = shares[: mechanism.n_held]
    frames = {node: frame[:, None] for node, frame in enumerate(unknowns.frames(q))}
    touched = np.abs(shares).max(axis=1) > UNDETERMINED
    sharing = [one.name for one in mechanism.holders if touched[_rows_of(mechanism, one.name)].any()]
    for output in outputs:
        if isinstance(output, OfPrescribed) or not touched[output.rows].any():
            continue
        if isinstance(output, OfCoupling):
            _refuse(f"{table}.{output.name}", sharing, "")
        of = _map_of(output, frames, mechanism)
        units = np.eye(1 if output.entry.turning and output.space.dimension == 2 else output.space.dimension)
        axes = np.concatenate([output.component(unit[:, None], frames) for unit in units], axis=1)
        for axis, row in zip(axes, axes @ of):
            if np.abs(row @ shares).max() > UNDETERMINED * max(1.0, np.abs(row).max()):
                words = _combination(output, axis, shares, sharing, frames, mechanism)
                _refuse(f"{table}.{output.name}", sharing, words)


def _map_of(output: OfConnection, frames: Frames, mechanism: Mechanism) -> np.ndarray:
    """Return the force or moment of a joint for a unit of each multiplier, shape (n_components, n_held)."""
    columns, nothing = [], replace(output, pulls=())
    for unit in np.eye(mechanism.n_held):
        force, moment = nothing.wrench(Seen((frames,), multipliers=unit[:, None]))
        columns.append((moment if output.entry.turning else force)[:, 0])
    return np.array(columns).T


def _combination(
    output: OfConnection, axis: np.ndarray, shares: np.ndarray, sharing: Sequence[str], frames: Frames,
    mechanism: Mechanism,
) -> str:  # fmt: skip
    """Return a combination of the same component of other joints that is determined, in words; empty if none is."""
    own = axis @ _map_of(output, frames, mechanism)
    others = {}
    for connection in mechanism.connections:
        if connection.name in sharing and connection.name != output.connection.name:
            rows = np.arange(mechanism.n_held)[_rows_of(mechanism, connection.name)]
            other = replace(output, rows=rows, connection=connection, held=tuple(connection.held), pulls=())
            others[connection.name] = axis @ _map_of(other, frames, mechanism)
    for n in range(1, len(others) + 1):
        for chosen in combinations(others, n):
            matrix = np.array([others[name] for name in chosen]) @ shares
            factors = np.linalg.lstsq(matrix.T, -(own @ shares), rcond=None)[0]
            if np.abs(own @ shares + factors @ matrix).max() < UNDETERMINED * max(1.0, np.abs(factors).max()):
                return " ".join([output.connection.name, *map(_term, factors, chosen)])
    return ""


def _term(factor: float, name: str) -> str:
    size = "" if abs(abs(factor) - 1.0) < UNDETERMINED else f"{abs(factor):.4g} "
    return f"{'-' if factor < 0.0 else '+'} {size}{name}"


def _refuse(entry: str, sharing: Sequence[str], combination: str) -> None:
    together = ", ".join(sharing)
    determined = f"; that of {combination} is" if combination else ""
    raise InputError(
        f"{entry}.joint: constraints of {together} hold the same, so that how much each carries is not "
        f"determined{determined}. Let a body between them be flexible or a joint elastic, take joints that hold less, "
        "or another component"
    )
