"""Reduced models whose samples have lengths, places and ratios of their own: polynomials through the models at the
points of a grid.

What these models observe of a sample are its outputs: a deformation is against the rigid mechanism of its own lengths.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Values
from pgmp_petsc.bodies.shape import at_lengths
from pgmp_petsc.effects.action import Action
from pgmp_petsc.mechanism.statements import ANGLE
from pgmp_petsc.models.full import ComponentModel, EvaluatedOutputs, FullModel, SeparateLengths, stacked
from pgmp_petsc.models.model import Model
from pgmp_petsc.models.reduced import Observing, ReducedModel, begun
from pgmp_petsc.outputs.outputs import in_order
from pgmp_petsc.outputs.readings import ModelReading, Needs, Rate
from pgmp_petsc.reduced.actions import ReducedActions
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.reduced.terms import ReducedTerms
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.units import values_text
from pgmp_petsc.scene.uses import length_names
from pgmp_petsc.stepping.second_order_system import State


def of_samples(model: Model, drawn: Iterable[str]) -> Model:
    """Return the model of samples that differ in some parameters, which need no distribution.

    Raises `InputError` if the model is of components, whose modes are those of one mesh, and a body's length is drawn.
    """
    drawn = set(drawn)
    if drawn.isdisjoint(length_names(model.scene)):
        return model.varying(drawn) if isinstance(model, FullModel) else model
    if isinstance(model, ComponentModel) and (why := why_of_one_mesh(model.scene, drawn)):
        raise InputError(why)
    return LengthLanes(model) if isinstance(model, ReducedModel) else SeparateLengths(model)


def why_of_one_mesh(scene: Scene, drawn: Iterable[str]) -> str:
    """Return why component models have no samples with some parameters drawn; empty where they have."""
    lines = (body.line for body in scene.bodies.values() if body.line is not None)
    meshed = next((line.length for line in lines if line.length in drawn), None)
    if meshed is None:
        return ""
    return (
        f"parameters.{meshed}: a body's length that is drawn; component modes are of one mesh, so take the "
        "reduced model (pgmp build) or --full, or give the length with --set or a number"
    )


class LengthLanes(Observing):
    """Reduced samples side by side: terms are affine in monomials of the lengths, as in other parameters; see `Model`.

    What outputs are made of, displacements and angles of joints are interpolated as the tables are
    (`reduction.sample_grid`): they are evaluated in the model of each point of the grid, its `members`. What has
    corners or jumps is made behind: magnitudes, stresses of the forces in their laws, formulas; and laws of local
    effects, which are parts of forces in joints, are those of the samples in all members. Effects, start and so
    on are as of `ReducedModel`; rigid motions and shapes of the scene's own lengths have no part in them.
    """

    name, title = ReducedModel.name, ReducedModel.title

    def __init__(self, model: ReducedModel) -> None:
        self._model, self.scene, self.kinematics = model, model.scene, model.kinematics
        self.identity, self.meshes, self.largest_batch = model.identity, model.meshes, model.largest_batch
        self.effects, self.start, self.motions = model.effects, model.start, model.motions
        self.outputs = EvaluatedOutputs(model.outputs.units, model.outputs.counts, model.outputs.takes_beside)
        functions = model.outputs.functions
        # each behind those that it is made of
        of_others = [
            name for name in in_order(self.scene)
            if "outputs" in self.scene.outputs[name].reads and not isinstance(functions[name], Rate)
        ]  # fmt: skip
        self.formulas = {one.name: functions[one.name] for one in model.outputs.forces}
        for name in of_others:
            entry = self.scene.outputs[name]
            found = {one: ModelReading(one, Needs()) for one in entry.made_in(self.scene)}
            self.formulas[name] = entry.combined(f"outputs.{name}", found, self.scene)
        self.lengths = length_names(model.scene)
        family = model.rom.family
        self.grid, self.check, self.checked = family.grid, family.check, family.checked
        self.members = tuple(self._member(number) for number in range(len(family.members)))
        self.stresses = None
        if model.stresses is not None:
            from pgmp_petsc.models.body_fields import LengthStresses  # few scenes have them

            self.stresses = LengthStresses([member.stresses for member in self.members], self._shares_of)
        for member in self.members:
            member.outputs, member.stresses = member.outputs.smooth(of_others), None
        merged, dampings = family.merged(model.rom), [member.terms.damping for member in self.members]
        damping = dampings[0]
        if damping is not None:
            tables = self.grid.coefficients([one.table for one in dampings])
            damping = replace(damping, weights=self.grid.weights(damping.weights), table=tables)
        self.terms = ReducedTerms.of(merged, model.kinematics, model.scene, damping)
        self.stiffness_changes = merged.stiffness_changes
        for each in zip(*(member.actions.actions for member in self.members)):
            self._require_alike(each)
        self.actions = ReducedActions.joined(self.grid, [member.actions for member in self.members])
        for member in self.members:
            if member.multipliers is not None:
                member.multipliers.take_actions(self.actions)
        self.measures = model.measures  # what is beside, of which each member has its own reading

    def _member(self, number: int) -> ReducedModel:
        family, scene = self._model.rom.family, self.scene.with_values(self.grid.points[number])
        rom = replace(family.members[number], meshes=at_lengths(scene, self._model.rom.meshes))
        try:
            return ReducedModel(scene, rom, places=self._model.places)
        except InputError as error:
            at = values_text(scene, self.grid.points[number])
            raise InputError(f"at {at}, where the models of all lengths begin: {error}") from error

    def _require_alike(self, actions: Sequence[Action]) -> None:
        """Raise `InputError` where one action at the points of the grid differs in what no table has."""
        own = []
        for action in actions:
            numbers = [np.ravel([parameter.at(self.scene.nominal) for parameter in action.parameters])]
            for (part, function), pair in zip(action.statement.terms, action.pairs):
                arms = [] if part.kind == ANGLE else [side.arm for side in pair]
                numbers += [[function.factor], part.axes.ravel(), *arms]
            own.append(np.concatenate(numbers))
        if np.ptp(own, axis=0).any():
            name, tables = actions[0].effect, ("effects", "joints", "controllers")
            table = next(table for table in tables if name in getattr(self.scene, table))
            raise InputError(
                f"{table}.{name}: acts on a ratio or a point of a rigid body, or by a number, that "
                f"{', '.join(self.lengths)} change; reduced samples that differ in these have no such force; give "
                "numbers (--override) or values (--set), make the body flexible, or take --full"
            )

    @property
    def n_places(self) -> int:
        """Number of bodies times that of the angles at which the mechanism of a sample would be placed."""
        return int(np.prod(self._model.rom.branch.poses.shape[:2]))

    def at_lengths(self, scene: Scene) -> ReducedModel:
        """Return the model of a scene that differs in the lengths of its run alone, with exact kinematics."""
        return self._model.at_lengths(scene)

    def batch(self, values: Mapping[str, np.ndarray], n_samples: int) -> ReducedSystem:
        return begun(self, _JointAngles(self, values), values, n_samples)

    def shares(self, values: Values, by: str = "") -> np.ndarray:
        """Return the share of every member at values of shape (n,), (n_members, n); their derivatives by a length."""
        return self.grid.shares(values, by)

    def observed_of(self, time: np.ndarray | float, states: State, values: Values) -> np.ndarray:
        """Return the outputs in states of reduced coordinates (n, n_eta), at parameters (n,), shape (n_outputs, n); see
        `ReducedModel`."""
        n = len(states.q)
        each = [member.outputs.evaluate(member.observed_of(time, states, values)) for member in self.members]
        found = blended(self._shares_of(values, n), each) | self.stressed(states, values)
        found = self.composed(found, time, values, n)
        return stacked({name: found[name] for name in self.outputs.units}, n)

    def stressed(self, states: State, values: Values) -> dict[str, np.ndarray]:
        """Return stress outputs, which need no other, each (n,); see `Observing`."""
        if self.stresses is None:
            return {}
        return dict(zip((one.name for one in self.stresses.stresses), self.stresses.of(states.q, values)))

    def local_displacements(self, eta: np.ndarray, values: Values) -> np.ndarray:
        """Return displacements and rotations of all nodes in body frames; see `ReducedModel.local_displacements`."""
        found = self._sum(lambda member: np.moveaxis(member.local_displacements(eta, values), 0, -1), len(eta), values)
        return np.moveaxis(found, -1, 0)

    def _sum(self, of: Callable[[ReducedModel], np.ndarray], n: int, values: Values) -> np.ndarray:
        """Return the polynomial through what members have at n states, arrays (..., n)."""
        return sum(share * of(member) for share, member in zip(self._shares_of(values, n), self.members))

    def _shares_of(self, values: Values, n: int) -> np.ndarray:
        return self.shares({name: np.broadcast_to(values[name], n) for name in self.lengths})


class _JointAngles:
    """Angles of joints of samples with lengths of their own; see `JointAngles`."""

    def __init__(self, lanes: LengthLanes, values: Values) -> None:
        self._lanes, self._values = lanes, values
        first = lanes.members[0].joint_angles
        self.scales, self.unit = first.scales, first.unit

    def of(self, eta: np.ndarray) -> np.ndarray:
        """Return the angles, shape (n, n_theta)."""
        return self._sum("of", eta)

    def gradient(self, eta: np.ndarray) -> np.ndarray:
        """Return their derivatives, shape (n, n_theta, n_eta)."""
        return self._sum("gradient", eta)

    def _sum(self, what: str, eta: np.ndarray) -> np.ndarray:
        return self._lanes._sum(lambda one: getattr(one.joint_angles, what)(eta).T, len(eta), self._values).T


def blended(shares: Iterable[np.ndarray | float], each: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Return the sums of what several models have by the same names, each with its share."""
    return {name: sum(share * one[name] for share, one in zip(shares, each)) for name in each[0]}


#: Models over interpolated tables: terms, outputs and displacements follow from reduced coordinates and parameters.
Reduced = ReducedModel | LengthLanes
