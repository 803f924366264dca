"""A bushing: a spring and a damper along and about every axis of a reference frame that turns with the first body.

Along the axis e_k the statement is ``e_k . (p_b - p_a)``, about it ``e_(k+2) . f_(k+1)`` with the axes f of the second
body that are those of the first as the bodies are placed: the sine of a rotation about e_k alone. In the plane it is
the rotation itself.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.effects.action import Action
from pgmp_petsc.effects.effect import ActionEffect
from pgmp_petsc.effects.laws import SPRING_DAMPER
from pgmp_petsc.mechanism.joints import triad
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.space import directors
from pgmp_petsc.mechanism.statements import Statement, along, angle, perpendicular
from pgmp_petsc.scene import effects as schema


def bushing(name: str, entry: schema.Bushing, mechanism: Mechanism) -> ActionEffect:
    """Return the effect; see the module."""
    a, b = (mechanism.attachment(point, f"effects.{name}.points") for point in entry.points)
    poses, space = mechanism.first_guess, mechanism.space
    frames = [side.frame_of_pose(poses) for side in (a, b)]
    in_a = triad(*(np.array(axis, dtype=float) for axis in entry.reference))
    sliding = [along(axis) for axis in in_a.T]
    if space.dimension == 3:
        in_b, rest = directors(frames[1]).T @ directors(frames[0]) @ in_a, 0.0
        turning = [perpendicular(in_a[:, k - 1], in_b[:, k - 2]) for k in range(3)]
    else:
        turning, rest = [angle(np.eye(2), np.eye(2))], frames[1][2] - frames[0][2]
    parts = [(sliding, entry.stiffness, entry.damping, 0.0)]
    parts.append((turning, entry.turning_stiffness, entry.turning_damping, rest))
    return ActionEffect(
        name,
        [
            Action(name, statement, a, b, SPRING_DAMPER, parameters)
            for part in parts
            for statement, parameters in _springs(*part)
        ],
        mechanism,
    )


def _springs(
    statements: list[Statement], stiffness: tuple[float | str, ...], damping: tuple[float | str, ...], rest: float
) -> Iterator[tuple[Statement, tuple[Quantity, ...]]]:
    """Yield the statements that have a spring or a damper, and the parameters of the law."""
    nothing = (0.0,) * len(statements)
    for statement, k, c in zip(statements, stiffness or nothing, damping or nothing):
        if k or c:
            yield statement, (Quantity.of(k), Quantity.of(c), Quantity(rest))
