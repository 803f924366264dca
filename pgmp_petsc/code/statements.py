"""Points, statements, local effects and outputs as a model in C takes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.effects.action import Action
from pgmp_petsc.effects.law import Law
from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.joint_turns import JointTurns
from pgmp_petsc.mechanism.joints import Connection
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.mechanism.statements import Statement, along, distance
from pgmp_petsc.models import ReducedModel

AXES = {"x": 0, "y": 1, "z": 2}
POSITIONS = ("position", "displacement")


@dataclass(frozen=True)
class Side:
    """A point of a body or of the ground: slot of its node, number of its body, and its place, `Attachment`."""

    slot: int
    body: int
    point: tuple[float, ...]
    arm: tuple[float, ...]

    @classmethod
    def of(cls, side: Attachment, slots: Mapping[int, int]) -> Side:
        """Return an attachment; `slots` are those of the nodes in the tables."""
        return cls(slots.get(side.node, -1), side.body, *(tuple(map(float, part)) for part in (side.point, side.arm)))


@dataclass(frozen=True, eq=False)
class StatementInC:
    """A statement about two points; `turns` is what an angle is near to: offset and slopes of `JointTurns`."""

    statement: Statement
    a: Side
    b: Side
    turns: tuple[float, ...] = (0.0,)

    @classmethod
    def of_angle(
        cls, connection: Connection, kinematics: RigidKinematics, start: np.ndarray, slots: Mapping[int, int]
    ) -> StatementInC:
        """Return the angle of a joint; see `outputs.outputs.joint_angle`."""
        turns = JointTurns.of(connection, kinematics, start) if kinematics.mechanism.space is SPATIAL else None
        near = (0.0,) if turns is None else (turns.offset, *map(float, turns.slopes))
        return cls(connection.angle, *(Side.of(side, slots) for side in connection.sides), near)


@dataclass(frozen=True, eq=False)
class ActionInC:
    """A local effect: numbers of its nodes among those of all effects, and of its strength, -1 where it has none."""

    statement: StatementInC
    nodes: tuple[int, int]
    law: Law
    strength: int
    winding: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Output:
    """An output: kind, statement or point (side b), axis, whether that is one of the body, and what counts as zero."""

    kind: str
    statement: StatementInC
    axis: int = 0
    in_body: bool = False
    origin: float = 0.0


def coordinates_of(kinematics: RigidKinematics, slots: Mapping[int, int]) -> list[StatementInC]:
    """Return what measures the coordinates."""
    start = np.zeros(kinematics.n_coordinates)  # of no account for coordinates
    return [StatementInC.of_angle(c.connection, kinematics, start, slots) for c in kinematics.coordinates]


def closure_of(kinematics: RigidKinematics) -> tuple[list[StatementInC], list[float]]:
    """Return what holds the rigid bodies together, and the values that these statements have."""
    mechanism = kinematics.mechanism
    origin = np.zeros(mechanism.space.dimension)
    parts, wanted = mechanism.holding([Attachment(k, -1, origin, origin) for k in range(len(mechanism.bodies))])
    found = [StatementInC(part, *(Side.of(side, {}) for side in sides)) for part, sides in parts]
    return found, [float(value) for value in wanted]


def action_in_c(
    action: Action, nodes: Sequence[int], slots: Mapping[int, int], strengths: Sequence[str], winding: np.ndarray
) -> ActionInC:
    """Return a local effect; `nodes` are those of all of them, `strengths` the names of what acts over time."""
    a, b = action.sides
    return ActionInC(
        StatementInC(action.statement, Side.of(a, slots), Side.of(b, slots)),
        tuple(-1 if side.on_ground else nodes.index(side.node) for side in (a, b)),
        action.law,
        -1 if action.amplitude is None else strengths.index(action.effect),
        tuple(float(turns) for turns in winding),
    )


def output_in_c(model: ReducedModel, name: str, slots: Mapping[int, int]) -> Output:
    """Return an output; see `outputs.outputs`."""
    entry, kinematics = model.scene.outputs[name], model.kinematics
    mechanism = kinematics.mechanism
    if entry.type == "angle":
        connection = mechanism.connection(entry.joint)
        return Output("MEASURE", StatementInC.of_angle(connection, kinematics, model.start[0], slots))
    if entry.type == "sliding":
        slides = along(np.array(mechanism.scene.joints[entry.joint].axes[0]))
        sides = mechanism.connection(entry.joint).sides
        return Output("MEASURE", StatementInC(slides, *(Side.of(side, slots) for side in sides)))
    nothing = distance(mechanism.space.dimension)
    if entry.type == "distance":
        sides = [mechanism.attachment(point, f"outputs.{name}.points") for point in entry.points]
        return Output("MEASURE", StatementInC(nothing, *(Side.of(side, slots) for side in sides)))
    point = mechanism.attachment(entry.point, f"outputs.{name}.point")
    statement = StatementInC(nothing, Side.of(point, slots), Side.of(point, slots))
    if entry.type == "rotation":
        return Output("ROTATION", statement)
    axis, origin = AXES[entry.axis], 0.0
    if entry.type == "displacement":
        origin = float(point.frame_of_pose(kinematics.poses(model.start[0][None]))[axis, 0])
    kind = "POSITION" if entry.type in POSITIONS else "DEFORMATION"
    return Output(kind, statement, axis, kind == "DEFORMATION" and entry.frame == "body", origin)
