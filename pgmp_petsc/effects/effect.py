"""Effects as the models see them.

An effect contributes what its kind calls for, and nothing else:

- loads ``g_ext = amplitude(t) sum_j w_j(p) f_j`` with constant nodal vectors (`Load`),
- actions: force laws on a statement about two frames (`action`),
- patterns: nodal vectors that its forces are made of, whose static answers extend the reduced basis.

The full-order model adds them to its nodes; the reduced model projects them. Point masses are parts of the mass matrix
from the start (`mechanism.composition`), prescribed motions constraints (`motion`), structural damping a property of
bodies (`damping`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from pgmp_petsc.bodies.affine import Monomial, Quantity
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects.action import Action
from pgmp_petsc.effects.law import Law
from pgmp_petsc.effects.time_function import TimeFunction
from pgmp_petsc.mechanism.joints import Connection
from pgmp_petsc.mechanism.mechanism import BodyStatements, Mechanism
from pgmp_petsc.scene.numerics import Reduction


@dataclass(frozen=True, eq=False)
class Patterns:
    """The forces that some effects are made of."""

    fixed: np.ndarray  # vectors that do not change with the configuration, local rows, shape (n_local, n_fixed)
    #: actions whose forces turn in body frames with the configuration; one vector each (`UnitForces`)
    turning: tuple[Action, ...] = ()
    #: numbers of the vectors among `fixed` that are forces of linear springs, shape (n_elastic,)
    elastic: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))

    @property
    def n(self) -> int:
        """Number of vectors at a configuration."""
        return self.fixed.shape[1] + len(self.turning)

    def wanted(self, reduction: Reduction) -> Patterns:
        """Return those whose static answers a basis takes: all, those of linear springs, or none."""
        if reduction.static_modes:
            return self
        if reduction.spring_modes:
            springs = tuple(action for action in self.turning if action.stiffness)
            return Patterns(self.fixed[:, self.elastic], springs, np.arange(self.elastic.size))
        return Patterns(self.fixed[:, :0])


class UnitForces:
    """Unit forces of actions on the rigid mechanism, in body frames, at any configuration."""

    def __init__(self, actions: Sequence[Action], mechanism: Mechanism) -> None:
        self.actions, self._mechanism = tuple(actions), mechanism
        self._gradients = BodyStatements(mechanism, [(action.statement, action.sides) for action in actions])

    def chosen(self, numbers: np.ndarray) -> UnitForces:
        """Return those of some of the actions, by their numbers or a mask."""
        numbers = np.arange(len(self.actions))[numbers]
        return UnitForces([self.actions[k] for k in numbers], self._mechanism)

    def at(self, poses: np.ndarray) -> np.ndarray:
        """Return the forces at poses (n_bodies, n_pose), all rows, shape (n_dofs, n_actions)."""
        return self._gradients.dense(poses).T


@dataclass(frozen=True)
class Load:
    """One affine load term."""

    effect: str  # name of the effect it belongs to
    weight: Monomial  # its parameter dependence
    vector: np.ndarray  # nodal forces (N) and couples (N m), for the rows of the matrices it was made with
    #: of a uniform body force the mass term and the field of accelerations, all rows, inertial frame: ``vector`` is
    #: their product where nodes are all there is, and a condensed body takes their product in its own frame. None of
    #: others.
    body_force: tuple[Monomial, np.ndarray] | None = None
    #: whether the vector, which is of couples alone, is constant in the frames of the bodies; otherwise in the inertial
    #: frame
    in_bodies: bool = False


class Effect:
    """An effect of a scene, by its name there, without any contribution; kinds of effects override what they
    contribute."""

    #: Whether its loads derive from a potential energy, as weights do.
    conservative = False
    #: Common factor of its load terms over time; kinds that change with time have their own.
    strength = TimeFunction.constant(1.0)
    #: Unit direction (d,) and size (m/s2) of a uniform field of acceleration, None of others.
    field: tuple[np.ndarray, Quantity] | None = None
    #: Structural damping of bodies by their number, with `stiffness`, `mass` and `ratios` as of `damping`.
    dampings: Mapping[int, Any] = MappingProxyType({})

    def __init__(self, name: str) -> None:
        self.name = name

    @property
    def acts(self) -> bool:
        """Whether it has anything to act with."""
        makes = any(getattr(type(self), one) is not getattr(Effect, one) for one in ("loads", "actions"))
        return makes or bool(self.dampings) or self.field is not None

    @property
    def entry(self) -> str:
        """The entry of the scene that it is of."""
        return f"effects.{self.name}"

    def loads(self, matrices: AffineMatrices) -> list[Load]:
        """Return the load terms for the rows of `matrices`."""
        return []

    def amplitude(self, time: float | np.ndarray) -> float | np.ndarray:
        """Return the common factor of the load terms at a time (s), or at each of several."""
        return self.strength(time)

    def actions(self) -> list[Action]:
        """Return the local effects."""
        return []

    def natural_actions(self) -> list[Action]:
        """Return what acts in natural coordinates, where a couple that is constant in body frames is no load."""
        return self.actions()

    def patterns(self, matrices: AffineMatrices) -> list[np.ndarray]:
        """Return nodal vectors in body frames, for the rows of `matrices`, that span the forces in any configuration.

        None of forces that `turning_patterns` returns.
        """
        return []

    def elastic_patterns(self) -> list[int]:
        """Return the numbers of the patterns that are forces of linear springs."""
        return []

    def turning_patterns(self) -> list[Action]:
        """Return the unit forces that are to be answered in the direction that they have in each configuration."""
        return []


class ActionEffect(Effect):
    """An effect of a scene, by its name there, that is nothing but one action on the mechanism, or several."""

    def __init__(self, name: str, actions: list[Action], mechanism: Mechanism) -> None:
        super().__init__(name)
        self._actions, self._mechanism = actions, mechanism

    @classmethod
    def of_laws(
        cls, name: str, mechanism: Mechanism, place: Mapping[str, Any], law: Law, *parameters: Sequence[float | str]
    ) -> ActionEffect:
        """Return an effect of a law at a place, as `Action` takes it: an action for each of some parameters, which are
        numbers or the names of those of the scene."""
        given = (tuple(map(Quantity.of, own)) for own in parameters)
        return cls(name, [Action(name, law=law, parameters=own, **place) for own in given], mechanism)

    def actions(self) -> list[Action]:
        return self._actions

    def patterns(self, matrices: AffineMatrices) -> list[np.ndarray]:
        """Return the unit forces of the actions whose direction is constant in body frames, as in any configuration."""
        rows, anywhere = slice(matrices.rows.start, matrices.rows.stop), self._mechanism.first_guess
        return list(UnitForces(self._fixed(), self._mechanism).at(anywhere)[rows].T)

    def elastic_patterns(self) -> list[int]:
        """Return the numbers of the patterns that are forces of linear springs."""
        return [number for number, action in enumerate(self._fixed()) if action.stiffness]

    def turning_patterns(self) -> list[Action]:
        return [one for one in self._actions if not one.leads and not one.statement.fixed_in_bodies]

    def _fixed(self) -> list[Action]:
        """Return the actions whose forces keep their direction in body frames."""
        return [one for one in self._actions if not one.leads and one.statement.fixed_in_bodies]


def couples(connection: Connection, matrices: AffineMatrices) -> np.ndarray:
    """Return unit couples about a joint's axis at its nodes, on the rows of `matrices`."""
    vector = np.zeros(len(matrices.rows))
    for sign, side, axes in zip((-1.0, 1.0), connection.sides, connection.axes):
        axis = axes[:, 0] if len(axes) == 3 else np.ones(1)  # in the plane rotations have one component
        for dof, component in zip(side.dofs[-axis.size :], axis):
            if not side.on_ground and dof in matrices.rows:
                vector[dof - matrices.rows.start] += sign * component
    return vector
