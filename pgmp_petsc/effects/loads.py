"""Loads: forces, torques, gravity, and what belongs to a point of a body.

A force acts on a point along a direction of the ground, of the body, or towards another point. With a direction of the
ground on a node it is a load; one that turns with its body, one that pulls towards a point, and any force on a rigid
body away from its centre of mass depend on the state, and are actions: on the place of the point along the direction,
or on its distance from the other one. A torque in a joint that turns is a couple on the second body and its reaction on
the first. Gravity is the mass matrix times a constant acceleration, one load term for each affine mass term. A point's
mass is a part of the mass matrix from the start (`mechanism.composition`), and Coulomb friction of a point that rubs
along a line of the ground is ``-limit tanh(s' / speed)`` on its place s.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from pgmp_petsc.base.units import STANDARD_GRAVITY
from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects.action import FRICTION, SOURCE, Action, joint_measure
from pgmp_petsc.effects.effect import ActionEffect, Effect, Load, couples
from pgmp_petsc.effects.formula import load_over_joint, load_over_problems
from pgmp_petsc.effects.time_function import TimeFunction, amplitude_of
from pgmp_petsc.mechanism.joints import Attachment, share_position
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.statements import along, distance, following
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import AddedMass, EffectEntry, OverMotion, OverTime
from pgmp_petsc.scene.fields import (
    GROUND_ORIGIN,
    Direction,
    NotNegativeOrParameter,
    NumberOrParameter,
    Point,
    PositiveOrParameter,
    Unit,
    exactly_one,
    refusal,
)
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.references import apart_problems

OVER = (
    "name of a joint that turns or slides, where the table is not over time, but over the motion of that joint: rows "
    "[rad or m, value], linear between them and constant beyond; one over whole turns goes on for ever"
)


class Torque(OverTime):
    """A torque (Nm) over time on a joint that turns: it acts on the second body, and its reaction on the first."""

    type: Literal["torque"]
    joints = ("turning",)
    strength_unit = "N m"
    joint: str = Field(description="name of a joint that turns")
    over: str | None = Field(None, description=OVER)
    over_motion: OverMotion = None

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        return load_over_problems(scene, name, self)

    def forces(self, name: str, mechanism: Mechanism) -> Effect:
        if self.over is not None:
            return load_over_joint(name, self, mechanism, joint_measure(mechanism, self), Quantity.of(self.scale))
        return Couples(name, self, mechanism)


class Force(OverTime):
    """A force (N) over time on a point of a body: along a direction of the ground or of the body, or towards a point;
    or along a joint that slides.

    A force towards a point pulls that point as well, like a rope between the two. That along a joint acts on the second
    body, and its reaction on the first.
    """

    type: Literal["force"]
    one_of = ("point", "joint")
    joints = ("sliding",)
    strength_unit = "N"
    point: Point | None = Field(None, description='where it acts, "body:point"')
    joint: str | None = Field(None, description="in place of a point: name of a joint that slides")
    over: str | None = Field(None, description=OVER)
    over_motion: OverMotion = None
    direction: Direction | None = Field(
        None, description="direction (x, y), in space (x, y, z); its length does not matter"
    )
    follows: bool = Field(False, strict=True, description="whether the direction turns with the body at this point")
    towards: Point | None = Field(None, description='the point that it pulls towards, "body:point" or "ground:point"')

    def check_entries(self) -> None:
        given = [key for key in ("direction", "towards", "follows") if getattr(self, key)]
        if self.joint is not None and given:
            raise refusal("a force along a joint has its direction; leave it out", given[0])
        if self.joint is not None:
            return
        exactly_one(self, "direction", "towards")
        if self.follows and self.direction is None:
            raise refusal("a direction that turns with the body needs `direction`", "follows")

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        """Yield a line if the distance that it makes shorter cannot change, or steps do not resolve it."""
        if self.towards is not None:
            yield from apart_problems(scene, f"effects.{name}.towards", (self.point, self.towards))
        yield from load_over_problems(scene, name, self)

    def forces(self, name: str, mechanism: Mechanism) -> Effect:
        """Return the effect that fits the force's direction; see the module."""
        scale = Quantity.of(self.scale)
        if self.joint is not None:
            place = joint_measure(mechanism, self)
        else:
            point = mechanism.attachment(self.point, f"effects.{name}.point")
            other = mechanism.attachment(self.towards or GROUND_ORIGIN, f"effects.{name}.towards")
            if self.towards is not None:
                # it makes the distance shorter
                statement, scale = distance(mechanism.space.dimension), -1.0 * scale
            elif self.follows:
                statement = following(np.array(self.direction))
            else:
                statement = along(np.array(self.direction))
                if point.at_node and self.over is None:
                    at_point = (c for c in mechanism.connections if c.b.node == point.node)
                    return FixedForce(name, self, other, point, any(not share_position(c.statements) for c in at_point))
            place = {"statement": statement, "a": other, "b": point}
        if self.over is not None:
            return load_over_joint(name, self, mechanism, place, scale)
        action = Action(name, law=SOURCE, parameters=(scale,), amplitude=amplitude_of(self), **place)
        return ActionEffect(name, [action], mechanism)


class Gravity(EffectEntry):
    """A uniform field of acceleration on every body and every point mass."""

    type: Literal["gravity"]
    acts = "forces"
    nothing_without = "acceleration"
    uniform = True
    strength_unit = "1"
    direction: Direction = Field(
        (0.0, -1.0), description="direction (x, y), in space (x, y, z); its length does not matter"
    )
    acceleration: Annotated[NumberOrParameter, Unit("m/s2")] = Field(
        STANDARD_GRAVITY, description="acceleration (m/s2); that of the Earth where it is not given"
    )

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        if scene.dimension == 3 and "direction" not in self.model_fields_set:
            yield problem(f"effects.{name}.direction", "missing; needed in space: direction (x, y, z)")

    @classmethod
    def if_added(cls, scene: Scene, run: Any, exchanged: float, tolerance: float) -> tuple[float, str] | None:
        """Return the work of the weights along the axis in which they move most: no axis of space is the vertical."""
        if not exchanged:
            return np.nan, "not known: the mechanism rests, so that no energy is moved around"
        risen = np.max(np.abs(run.heights - run.heights[0]), axis=0)
        axis = 1 if risen.size == 2 else int(np.argmax(risen))
        share = scene.number_units.gravity * float(risen[axis]) / exchanged
        return share, f"work of weights along -{'xyz'[axis]}, of the energy moved around"

    def forces(self, name: str, mechanism: Mechanism) -> Effect:
        return Weights(name, self.direction, Quantity.of(self.acceleration), mechanism)


class FixedForce(Effect):
    """A force on a node that keeps its direction in space, from the ground's origin.

    Where the node is guided along a line or a plane, which takes up a part of the force, there is no answer to both
    axes of the body, but to the force as it is.
    """

    def __init__(self, name: str, entry: Force, ground: Attachment, point: Attachment, guided: bool) -> None:
        super().__init__(name)
        self.strength = amplitude_of(entry)
        self._scale = Quantity.of(entry.scale)
        self._direction = np.asarray(entry.direction, dtype=float) / np.linalg.norm(entry.direction)
        self._ground, self._point, self._guided = ground, point, guided

    def loads(self, matrices: AffineMatrices) -> list[Load]:
        """Return one term: a unit force at the node."""
        vector = self._vector(matrices, self._scale.coefficient * self._direction)
        return [Load(self.name, self._scale.monomial, vector)]

    def patterns(self, matrices: AffineMatrices) -> list[np.ndarray]:
        """Return unit forces along all axes of the body in whose frame the direction turns; none of a guided point."""
        return [] if self._guided else [self._vector(matrices, axis) for axis in np.eye(self._direction.size)]

    def turning_patterns(self) -> list[Action]:
        if not self._guided:
            return []
        return [Action(self.name, along(self._direction), self._ground, self._point, SOURCE, (self._scale,))]

    def _vector(self, matrices: AffineMatrices, components: np.ndarray) -> np.ndarray:
        vector = np.zeros(len(matrices.rows))
        for dof, component in zip(self._point.dofs, components):
            if dof in matrices.rows:
                vector[dof - matrices.rows.start] = component
        return vector


class Couples(Effect):
    """A torque in the models; see the module."""

    def __init__(self, name: str, entry: Torque, mechanism: Mechanism) -> None:
        super().__init__(name)
        self.strength = amplitude_of(entry)
        self._scale = Quantity.of(entry.scale)
        self._connection = mechanism.connection(entry.joint)

    def loads(self, matrices: AffineMatrices) -> list[Load]:
        """Return one term: unit couples about the joint's axis at its nodes; the axis is fixed in both bodies."""
        vector = self._scale.coefficient * couples(self._connection, matrices)
        return [Load(self.name, self._scale.monomial, vector, in_bodies=True)]

    def natural_actions(self) -> list[Action]:
        joint = self._connection
        return [Action(self.name, joint.angle, joint.a, joint.b, SOURCE, (self._scale,), self.strength)]

    def patterns(self, matrices: AffineMatrices) -> list[np.ndarray]:
        """Return the couples, which are constant in the bodies."""
        return [load.vector for load in self.loads(matrices)]


class Weights(Effect):
    """A uniform field of acceleration (m/s2) in the models, along a unit vector of shape (d,), constant or over time;
    see the module."""

    def __init__(
        self, name: str, direction: Sequence[float], acceleration: Quantity, mechanism: Mechanism,
        over_time: TimeFunction | None = None,
    ) -> None:  # fmt: skip
        super().__init__(name)
        self.conservative = over_time is None
        if over_time is not None:
            self.strength = over_time
        direction = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
        self.field, self._monomial = (direction, acceleration), acceleration.monomial
        self._translational = {weight for body in mechanism.bodies for weight in body.translational_weights}
        self._bodies = mechanism.bodies
        self._mechanism = mechanism
        self._field = np.zeros(mechanism.n_dofs)
        mechanism.by_node(self._field)[:, : direction.size] = direction * acceleration.coefficient
        for body in mechanism.bodies:
            body.at_points(self._field)[:] = direction * acceleration.coefficient

    def loads(self, matrices: AffineMatrices) -> list[Load]:
        """Return ``M_i a``; the translational mass is isotropic, so body frames and the inertial one agree."""
        # a purely rotary mass term takes no part in a uniform field, on any rank, whatever its rows
        return [
            Load(self.name, weight * self._monomial, mass @ self._field, (weight, self._field))
            for weight, mass in matrices.mass.items()
            if weight in self._translational
        ]

    def patterns(self, matrices: AffineMatrices) -> list[np.ndarray]:
        """Return the weight of every body along the two axes of its own frame: gravity turns in it."""
        vectors = []
        for body in self._bodies:
            for weight, axis in product(sorted(body.translational_weights), range(self._mechanism.space.dimension)):
                field = np.zeros_like(self._field)
                self._mechanism.by_node(field)[body.nodes, axis] = 1.0
                body.at_points(field)[:, axis] = 1.0
                vectors.append(matrices.mass[weight] @ field)
        return vectors


class PointMass(AddedMass):
    """A mass and a moment of inertia at a point of a body."""

    type: Literal["point_mass"]
    cause = True

    @classmethod
    def if_added(cls, scene: Scene, run: Any, exchanged: float, tolerance: float) -> tuple[float, str] | None:
        return np.nan, f"would matter from {scene.system.text(tolerance * run.mass, 'kg', '.2g')} on"

    @property
    def adds(self) -> str:
        return f"part of the mass matrix at {self.point}"


class PointFriction(EffectEntry):
    """Coulomb friction of a point of a body along a direction of the ground under a constant load, regularised:
    ``-limit tanh(rate / speed)``."""

    type: Literal["point_friction"]
    acts = "forces"
    local = edged = True
    changeable = ("limit", "speed")
    nothing_without = "limit"
    point: Point = Field(description='where it rubs, "body:point"')
    direction: Direction = Field(description="direction (x, y), in space (x, y, z); its length does not matter")
    limit: Annotated[NotNegativeOrParameter, Unit("N")] = Field(description="friction force (N) while it slides")
    speed: Annotated[PositiveOrParameter, Unit("m/s")] = Field(
        description="rate at which 76 % of the limit are reached (m/s)"
    )

    def forces(self, name: str, mechanism: Mechanism) -> ActionEffect:
        ends, entry = (GROUND_ORIGIN, self.point), f"effects.{name}.point"
        place = mechanism.between(along(np.array(self.direction)), ends, entry)
        return ActionEffect.of_laws(name, mechanism, place, FRICTION, (self.limit, self.speed))
