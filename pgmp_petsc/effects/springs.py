"""Springs and dampers, and the stiffness of linear ones about the rigid mechanism, in body frames.

A spring-damper is ``-k (s - rest) - c s'`` on a joint's rotation or displacement, or on the distance of two points. A
spring on the statement s has the potential ``1/2 k (s - rest)^2``. Its second derivatives in the small displacements of
the nodes that carry its ends are

    k g g^T + k (s - rest) h,

with the gradient g of s and its second derivatives h, of which a node's rotation vector has a part too: a director
turns as ``d + phi x d + 1/2 phi x (phi x d)``. The first term is the stiffness of the spring; the second one is the
force that it has already (its preload) times the change of direction.

A bushing is a spring and a damper along and about every axis of a reference frame that turns with the first body. Along
the axis e_k the statement is ``e_k . (p_b - p_a)``, about it ``e_(k+2) . f_(k+1)`` with the axes f of the second body
that are those of the first as the bodies are placed: the sine of a rotation about e_k alone. In the plane it is the
rotation itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from pgmp_petsc.base.errors import Remark, gathered, note
from pgmp_petsc.bodies.affine import AffineSum, Quantity
from pgmp_petsc.effects.action import SPRING_DAMPER, Action, place_of
from pgmp_petsc.effects.effect import ActionEffect, Effect
from pgmp_petsc.mechanism.composition import sines
from pgmp_petsc.mechanism.joints import Coupling, triad
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.space import directors
from pgmp_petsc.mechanism.statements import Statement, along, angle
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import EffectEntry, OnJoint
from pgmp_petsc.scene.fields import Connection, Direction, NotNegativeOrParameter, NumberOrParameter, Unit, refusal
from pgmp_petsc.scene.joints import DAMPED_BY, frame_problems
from pgmp_petsc.scene.messages import Finding, doubt, named
from pgmp_petsc.scene.messages import refusal as impossible
from pgmp_petsc.scene.numerics import Reduction


@dataclass(frozen=True, eq=False)
class Block:
    """Stiffness between a few unknowns."""

    dofs: np.ndarray  # their numbers, shape (n,)
    matrix: np.ndarray  # symmetric, shape (n, n), N/m, N, N m


def linear_springs(actions: Sequence[Action]) -> tuple[Action, ...]:
    """Return the actions that are linear springs, with or without damping, between bodies or to the ground."""
    return tuple(action for action in actions if action.stiffness and moving_dofs(action).size)


def left_out(actions: Sequence[Action]) -> dict[str, str]:
    """Return why actions are not in the stiffness, by the name of their effect; sources are loads, and not named."""
    springs = {action.effect for action in actions if action.stiffness}
    return {
        action.effect: action.law.left_out for action in actions if action.law.left_out and action.effect not in springs
    }


@gathered
def spring_remarks(effects: Sequence[Effect], reduction: Reduction | None = None) -> Iterator[Remark]:
    """Say which effects are in the stiffness of vibrations, and which are not, and why.

    With `reduction` it is said of the basis of a reduced model, whose runs have all effects. Nothing is said where no
    effect is local.
    """
    actions = [action for effect in effects for action in effect.actions()]
    springs = ", ".join(dict.fromkeys(action.effect for action in linear_springs(actions)))
    what = "stiffness" if reduction is None else "basis"
    if springs and reduction is None:
        yield note(f"linear springs in the stiffness: {springs}")
    elif springs and (reduction.spring_modes or reduction.static_modes):
        yield note(f"linear springs whose static answers are in the basis, for any stiffness: {springs}")
    elif springs:
        yield note(f"reduction.spring_modes = false: the basis has no static answers to springs: {springs}")
    entries = {effect.name: effect.entry for effect in effects}
    yield from (note(f"{entries[name]} is not in the {what}: {reason}") for name, reason in left_out(actions).items())


def moving_dofs(action: Action) -> np.ndarray:
    """Return the unknowns of the nodes that an action holds at, increasing, none of them twice, shape (n,)."""
    return np.unique([side.dofs for side in action.sides if not side.on_ground]).astype(int)


def spring_force(
    spring: Action, mechanism: Mechanism, poses: np.ndarray, theta: np.ndarray, values: Mapping[str, float]
) -> float:
    """Return the force ``-k (s - rest)`` of a spring on the rigid mechanism, N or N m: none in a coupling, which that
    keeps.

    Poses, shape (n_bodies, n_pose), and theta, shape (n_theta,), rad, are of one configuration. Angles that are no
    coordinates are in (-pi, pi] in space, and as the bodies are turned in the plane.
    """
    if len(spring.statement.terms) > 1:
        return 0.0
    frames = [side.frame_of_pose(poses) for side in spring.sides]
    number = [k for k, c in enumerate(mechanism.coordinates) if c.statement is spring.statement]
    measure = theta[number[0]] if number else mechanism.space.measure(spring.statement, *frames)
    return float(spring.law.evaluate([quantity.at(values) for quantity in spring.parameters], measure).elastic)


def spring_block(
    spring: Action, gradient: np.ndarray, values: Mapping[str, float], preload: np.ndarray | float = 0.0
) -> Block:
    """Return the stiffness of a spring on the rigid mechanism at a configuration, in body frames.

    The gradient is that of its statement in the unknowns of `moving_dofs` there, shape (n,). The preload is the force
    that it has already (`spring_force`) times the statement's second derivatives in these (`BodyStatements`), shape (n,
    n); 0 leaves the second term of the module's equation out.
    """
    matrix = spring.stiffness.at(values) * np.outer(gradient, gradient) - preload
    return Block(moving_dofs(spring), 0.5 * (matrix + matrix.T))


def _springs(
    statements: list[Statement],
    stiffness: tuple[float | str, ...],
    damping: tuple[float | str, ...],
    rest: Quantity | AffineSum,
) -> Iterator[tuple[Statement, tuple[Quantity | AffineSum, ...]]]:
    """Yield the statements that have a spring or a damper, and the parameters of the law."""
    nothing = (0.0,) * len(statements)
    for statement, k, c in zip(statements, stiffness or nothing, damping or nothing):
        if k or c:
            yield statement, (Quantity.of(k), Quantity.of(c), rest)


class SpringDamper(OnJoint):
    """A linear spring and damper: between the bodies of a joint, or between two points."""

    type: Literal["spring_damper"]
    one_of = ("joint", "points")
    changeable = ("stiffness", "damping", "rest")
    stiff_by = strength = "stiffness"
    joint: str | None = Field(None, description="name of a joint that turns or slides")
    points: Connection | None = Field(None, description='two points, "body:point" or "ground:point"')
    stiffness: Annotated[NumberOrParameter, Unit("N m/rad", "N/m")] = Field(0.0, description="(Nm/rad or N/m)")
    damping: Annotated[NotNegativeOrParameter, Unit("N m s/rad", "N s/m")] = Field(
        0.0, description="(Nm s/rad or N s/m)"
    )
    rest: Annotated[NumberOrParameter | None, Unit("rad", "m")] = Field(
        None,
        description="angle (rad), displacement or distance (m) without force; 0 if not given, but a spring between "
        "points needs it",
    )

    def check_entries(self) -> None:
        if self.points is not None and self.stiffness and self.rest is None:
            raise refusal("a spring between points needs the distance without force (m)", "rest")
        if not (self.stiffness or self.damping):
            raise refusal("at least one of stiffness and damping is needed")

    def doubts(
        self, scene: Scene, entry: str, frequencies: Mapping[str, float], first: Callable[[], float | None]
    ) -> Iterator[Finding]:
        """Yield a rest that cannot be, or is without effect."""
        where, rest = named(scene, f"{entry}.rest", self.rest)
        if self.points is not None and rest and rest < 0.0:
            yield impossible(where, "a distance between points is not negative", rest)
        if self.joint is not None and rest and named(scene, entry, self.stiffness)[1] == 0.0:
            yield doubt(where, "without effect, as there is no stiffness; leave it out", rest)

    @classmethod
    def work(cls, rate: np.ndarray, time: np.ndarray, turns_freely: bool) -> float:
        """Return the energy ``s^2 / 2`` of the path; none is known where a joint turns about several axes."""
        from scipy.integrate import cumulative_trapezoid  # a noticeable time, and only sizes of effects need it

        return 0.0 if turns_freely else 0.5 * float(np.ptp(cumulative_trapezoid(rate, time, initial=0.0))) ** 2

    def forces(self, name: str, mechanism: Mechanism) -> ActionEffect:
        parameters = self.stiffness, self.damping, self.rest or 0.0
        return ActionEffect.of_laws(name, mechanism, place_of(mechanism, name, self), SPRING_DAMPER, parameters)


class Bushing(EffectEntry):
    """An elastic mount between two points: a spring and a damper along every axis of a reference frame, which turns
    with the owner of the first point, and about every axis.

    Along an axis the force is ``-k s - c s'`` on the displacement s; about it the couple is that of ``-k s - c s'`` on
    the sine s of the rotation from the way in which the bodies are placed, in the plane on the rotation.
    """

    type: Literal["bushing"]
    acts = "forces"
    changeable = ("stiffness", "damping", "turning_stiffness", "turning_damping")
    local = True
    points: Connection = Field(description='two points, "body:point" or "ground:point"')
    reference: tuple[Direction, ...] = Field(
        description="first axis, and in space a second one, of the frame in which it is stiff, "
        "in the frame of the first point's owner; their lengths do not matter"
    )
    stiffness: Annotated[tuple[NotNegativeOrParameter, ...], Unit("N/m")] = Field(
        (), description="along each axis, the last completes the frame (N/m), numbers or parameters' names"
    )
    damping: Annotated[tuple[NotNegativeOrParameter, ...], Unit("N s/m")] = Field(
        (), description="along each axis (N s/m)"
    )
    turning_stiffness: Annotated[tuple[NotNegativeOrParameter, ...], Unit("N m/rad")] = Field(
        (), description="about each axis (Nm/rad)"
    )
    turning_damping: Annotated[tuple[NotNegativeOrParameter, ...], Unit("N m s/rad")] = Field(
        (), description="about each axis (Nm s/rad)"
    )

    def check_entries(self) -> None:
        keys = ("stiffness", "damping", "turning_stiffness", "turning_damping")
        if not any(value for key in keys for value in getattr(self, key)):
            raise refusal(f"at least one of {', '.join(keys)} must be above zero")

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        """Yield a line if its axes make no frame, or it has not as many numbers as axes."""
        yield from frame_problems(self, scene.dimension, f"effects.{name}")

    def forces(self, name: str, mechanism: Mechanism) -> ActionEffect:
        a, b = (mechanism.attachment(point, f"effects.{name}.points") for point in self.points)
        poses, space = mechanism.first_guess, mechanism.space
        frames = [side.frame_of_pose(poses) for side in (a, b)]
        in_a = triad(*(np.array(axis, dtype=float) for axis in self.reference))
        sliding = [along(axis) for axis in in_a.T]
        if space.dimension == 3:
            in_b, rest = directors(frames[1]).T @ directors(frames[0]) @ in_a, 0.0
            turning = sines(in_a, in_b)
        else:
            turning, rest = [angle(np.eye(2), np.eye(2))], frames[1][2] - frames[0][2]
        parts = [(sliding, self.stiffness, self.damping, Quantity(0.0))]
        parts.append((turning, self.turning_stiffness, self.turning_damping, Quantity(rest)))
        found = (one for part in parts for one in _springs(*part))
        return ActionEffect(name, [Action(name, one, a, b, SPRING_DAMPER, given) for one, given in found], mechanism)


def elastic_coupling(coupling: Coupling, scene: Scene, mechanism: Mechanism) -> ActionEffect:
    """Return the spring and damper on what an elastic coupling is off."""
    elastic, (a, b, *further) = scene.joints[coupling.name].elastic, coupling.sides
    parameters = Quantity.of(elastic.stiffness), Quantity.of(elastic.damping), Quantity(coupling.value)
    action = Action(coupling.name, coupling.combination, a, b, SPRING_DAMPER, parameters, further=tuple(further))
    return ActionEffect(coupling.name, [action], mechanism)


def elastic_joint(name: str, scene: Scene, mechanism: Mechanism) -> ActionEffect:
    """Return the springs and dampers of the directions that a joint by a name releases."""
    connection, elastic, actions = mechanism.connection(name), scene.joints[name].elastic, []
    for part in connection.released:
        k, c = getattr(elastic, part.key), getattr(elastic, DAMPED_BY[part.key])
        own = (k[part.axis],), c[part.axis : part.axis + 1]
        actions += [
            Action(name, statement, *connection.sides, SPRING_DAMPER, parameters)
            for statement, parameters in _springs([part.statement], *own, part.rest)
        ]
    return ActionEffect(name, actions, mechanism)
