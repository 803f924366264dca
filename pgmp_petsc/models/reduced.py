"""The reduced model of a scene, from its ROM file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Self

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Values
from pgmp_petsc.controllers.running import AFTER, Controls
from pgmp_petsc.effects import actions_of, effects_of, motions_of, start_of
from pgmp_petsc.effects.effect import Effect
from pgmp_petsc.effects.time_function import TimeFunction
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models.model import Measures, Model, require_lengths, search_of, velocities_of
from pgmp_petsc.models.reduced_statics import JointAngles, ReducedStatics
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.outputs.readings import AnyReading, Seen
from pgmp_petsc.reduced.actions import ReducedActions
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.reduced.terms import ReducedDamping, ReducedTerms
from pgmp_petsc.reduction.reconstruction import Reconstruction
from pgmp_petsc.reduction.rom import ReducedOrderModel, Served, served_ranges
from pgmp_petsc.reduction.sample_grid import SampleGrid
from pgmp_petsc.reduction.tables import grid_of_places
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.scene.uses import offset_values
from pgmp_petsc.stepping.second_order_system import State
from pgmp_petsc.stepping.static_equilibrium import UNBALANCED, moved_along, require_balance, settle

if TYPE_CHECKING:
    from pgmp_petsc.models.body_fields import ReducedFields


class Observing(Model):
    """Models that observe what outputs are made of in states of reduced coordinates.

    `formulas` are outputs that are made once others are found, or what forces in joints are made of.
    """

    formulas: Mapping[str, AnyReading] = MappingProxyType({})

    def stressed(self, states: State, values: Values) -> dict[str, np.ndarray]:
        """Return stress outputs that are no part of what is observed, each (n,), in states of reduced coordinates (n,
        n_eta)."""
        return {}

    def composed(
        self, outputs: Mapping[str, np.ndarray], time: np.ndarray | float, values: Values, n: int
    ) -> dict[str, np.ndarray]:
        """Return outputs, each (n,), with the formulas evaluated of the others and of parts of forces (n_parts, n)."""
        found = dict(outputs)
        seen = Seen(({},), of_model=found, time=np.broadcast_to(time, n), values=values, n=n)
        for name, formula in self.formulas.items():
            found[name] = formula.jet(seen, 0)[0]
        return found

    def observed_over(self, system: ReducedSystem, states: State, times: Sequence[float]) -> np.ndarray:
        values = {name: np.tile(value, len(times)) for name, value in system.values.items()}
        return self.observed_of(np.repeat(times, system.n_samples), states.merged(), values)


class ReducedModel(Observing):
    """Rigid coordinates and flexible modes over interpolated tables; see `Model`.

    The scene may differ from the reduced model's in what its tables do not depend on; the kinematics are made from it
    where they are not at hand. `places` is the grid on which it is known where actions hold. `effects` act by forces,
    `actions` are local ones and where they hold; `motions` are prescribed, by the numbers of their coordinates; `start`
    has positions (rad) and velocities (rad/s) of the coordinates at the start, (n_theta,) each. `reconstruction` and
    `stresses` lead from reduced coordinates to the frames of `outputs.nodes` and to stress outputs, None where there
    are none; `joint_angles` to the angles of the joints that are coordinates.

    Raises `InputError` if the start lies outside the sampled range.
    """

    name = "reduced"
    title = "reduced"

    def __init__(
        self,
        scene: Scene,
        rom: ReducedOrderModel,
        kinematics: RigidKinematics | None = None,
        places: SampleGrid | None = None,
    ) -> None:
        rom = rom.at_lengths(scene)
        self.scene, self.rom = scene, rom
        self.largest_batch = scene.ensemble.batch
        self.identity = rom.identity
        self.meshes = rom.meshes
        self.kinematics = kinematics or RigidKinematics(Mechanism.from_scene(scene, rom.meshes), rom.branch)
        mechanism = self.kinematics.mechanism
        scheme = scene.interpolation
        self.effects, self.motions = effects_of(scene, mechanism), motions_of(scene, mechanism)
        self.start = start_of(scene, mechanism)
        self._check_start(rom.tables.samples)
        self.outputs = OutputSet.of(scene, self.kinematics, self.start[0])
        self.measures = Measures(scene, self.kinematics, self.start[0]) if scene.beside else None
        damping = ReducedDamping.of(self.effects, self.kinematics, rom)
        self.terms = ReducedTerms.of(rom, self.kinematics, scene, damping)
        actions = actions_of(self.effects)
        self.places = places or grid_of_places(rom.tables.samples, self.kinematics, actions)[0]
        self.actions = ReducedActions.of(
            actions, self.kinematics, rom, scheme, self.start[0], self.terms.parts, self.places
        )
        self.reconstruction = Reconstruction(self.kinematics, rom, scheme, self.outputs.nodes)
        self.stresses = None
        if self.outputs.stresses:
            from pgmp_petsc.models.stresses import ReducedStresses  # few scenes have them

            self.stresses = ReducedStresses(scene, self.outputs, self.kinematics, rom)
        self.multipliers = None
        carried = () if self.measures is None else self.measures.carried
        if self.outputs.forces or carried:
            from pgmp_petsc.models.joint_forces import ReducedMultipliers  # few scenes have them

            self.multipliers = ReducedMultipliers(
                scene, rom, self.kinematics, self.outputs.forces, carried, self.effects, self.motions,
                (self.terms, self.actions),
            )  # fmt: skip
        if carried:
            self.actions = replace(self.actions, carried=self.multipliers.in_lanes())
        self.joint_angles = JointAngles(self.kinematics, rom, scheme, self.terms.scale)
        self.stiffness_changes = rom.stiffness_changes
        self._of_all = Reconstruction(self.kinematics, rom, scheme, range(mechanism.n_nodes))

    def _check_start(self, grid: SampleGrid) -> None:
        for axis, position, coordinate in zip(grid.axes, self.start[0], self.kinematics.mechanism.coordinates):
            if not axis.contains(position):
                raise InputError(
                    f"simulation.initial.{coordinate.name}.position = {coordinate.shown(position):g}: outside the "
                    f"sampled range [{coordinate.shown(axis.lower):g}, {coordinate.shown(axis.upper):g}] "
                    f"{coordinate.system.unit(coordinate.unit)}"
                )

    @property
    def served(self) -> dict[str, Served]:
        """The ranges of parameters that the reduced model was built for."""
        return served_ranges(scene_from_toml(self.rom.record.scene_toml, self.scene.directory), self.rom)

    def in_scene(self, scene: Scene) -> Self:
        """Return the model of a scene that differs in what is no part of its tables."""
        return type(self)(scene, self.rom, self.kinematics)

    def at_lengths(self, scene: Scene) -> Self:
        """Return the model of a scene that differs in the lengths of its run alone."""
        return type(self)(scene, self.rom)

    def with_loads(self, scene: Scene) -> Self:
        """Return the model under the loads of a scene that differs in torques and forces over time, and in the
        simulation, alone."""
        other = copy(self)
        other.scene, other.effects = scene, effects_of(scene, self.kinematics.mechanism)
        other.actions = replace(self.actions, actions=actions_of(other.effects))
        other.outputs = self.outputs.under(scene)
        other.multipliers = self.multipliers and self.multipliers.under(other.effects)
        return other

    def batch(self, values: Mapping[str, np.ndarray], n_samples: int) -> ReducedSystem:
        """Return a batch of samples on this rank, all with the lengths of the scene's run."""
        require_lengths(self.scene, values)
        return begun(self, self.joint_angles, values, n_samples)

    @property
    def members(self) -> tuple[ReducedModel, ...]:
        """The models whose outputs, each with its share, make the model's own: itself."""
        return (self,)

    def shares(self, values: Values, by: str = "") -> np.ndarray:
        """Return the share of every member, shape (n_members,), or its derivative by a parameter."""
        return np.zeros(1) if by else np.ones(1)

    def observed_of(
        self, time: np.ndarray | float, states: State, values: Values, cells_of: np.ndarray | None = None
    ) -> np.ndarray:
        """Return what the outputs are made of, shape (n_observed, n), in states of reduced coordinates (n, n_eta).

        Outputs of controllers, and multipliers under control, take ``states.forces`` of all that is beside, (n, 2,
        n_names), before and after they jump. Times (s) and parameter values are numbers, or of shape (n,).
        Where `cells_of` are other reduced coordinates (n, n_eta), next to these, tables are continued from their cells.
        """
        frames = self.reconstruction.jets((states.q, states.v, states.a), self.outputs.order, cells_of)
        return self.observed_at(frames, time, states, values)

    def observed_at(
        self, frames: Sequence[np.ndarray], time: np.ndarray | float, states: State, values: Values
    ) -> np.ndarray:
        """Return what `observed_of` does, for frames of the outputs' nodes that are at hand, with their derivatives."""
        stresses = np.empty((0, len(states.q))) if self.stresses is None else self.stresses.of(states.q, values)
        if self.outputs.forces:
            multipliers = self.multipliers.of(time, states, values)
            stresses = np.concatenate([stresses, self.outputs.forces_of(frames, multipliers, values)])
        if self.outputs.beside:
            stresses = np.concatenate([stresses, states.forces[:, AFTER].T[list(self.outputs.beside.values())]])
        return self.outputs.observed(frames, stresses, time, values)

    def fields(self, n_frames: int | None = None) -> ReducedFields:
        """Return what makes the fields of bodies from reduced coordinates, for so many frames; for those that the scene
        asks for by default."""
        from pgmp_petsc.models.body_fields import FieldSet, ReducedFields  # of single runs

        frames = self.scene.simulation.frames if n_frames is None else n_frames
        seen = FieldSet.of(self.scene, self.kinematics.mechanism.bodies, frames)
        return ReducedFields(seen, self.kinematics, self.rom, self.scene.interpolation)

    def frames_of(self, eta: np.ndarray) -> np.ndarray:
        """Return the frames of all nodes, shape (n_nodes, 3, n), for reduced coordinates (n, n_eta)."""
        return self._of_all.frames(eta)

    def local_displacements(self, eta: np.ndarray, values: Values) -> np.ndarray:
        """Return displacements and rotations of all nodes in body frames, (n, n_nodes, 3), in space (n, n_nodes, 6).

        For reduced coordinates (n, n_eta), whatever the parameter values.
        """
        return self._of_all.local(eta)


class Unloaded(Effect):
    """An effect whose loads have no strength."""

    strength = TimeFunction.constant(0.0)


def _in_balance(
    statics: ReducedStatics, scales: np.ndarray, start: tuple[np.ndarray, np.ndarray], n_samples: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return reduced coordinates and velocities (n_samples, n_eta) at the start, positions and rates of the joints'
    coordinates, of a deformation that is in balance there and as the coordinates move.

    Raises `InputError` where there is none.
    """
    theta, rates = (np.broadcast_to(part, (n_samples, scales.size)).astype(float) for part in start)

    def deformed(at: np.ndarray) -> np.ndarray:
        _, lost = statics.hold(at, np.ones(n_samples, dtype=bool))
        if lost.any():
            raise InputError(UNBALANCED.format(statics.cause(int(np.argmax(lost)))))
        return statics.unknowns().T

    q = deformed(theta)
    return q, moved_along(deformed, q, theta, rates, scales)


def begun(model: ReducedModel, angles: JointAngles, values: Mapping[str, np.ndarray], n_samples: int) -> ReducedSystem:
    """Return samples of a model, settled where runs start in static equilibrium.

    Terms, effects and actions of the model are as of `ReducedModel`; the angles are those of its coordinates.
    """
    positions, of_run = model.start
    start = positions, velocities_of(model.scene, model.kinematics.mechanism, of_run, values, n_samples).T
    own = model.scene.values | dict(values)
    given = offset_values(model.scene, own, n_samples)
    system = ReducedSystem(model.terms, model.effects, values, start, n_samples, model.motions, model.actions, given)
    springs = model.actions.of_joints(model.kinematics.mechanism)
    if springs.actions and system.built_in is not None and not model.scene.initial.equilibrium:
        require_balance(model.scene, model.kinematics, positions, own)
        unloaded = [Unloaded(effect.name) for effect in model.effects]
        alone = ReducedSystem(model.terms, unloaded, values, start, n_samples, actions=springs, given=given)
        system.begun = _in_balance(ReducedStatics(alone, angles), angles.scales, start, n_samples)
    if model.scene.initial.equilibrium:
        free = model.scene.initial.coordinates == "free"
        statics = ReducedStatics(system, None if free else angles)
        theta = np.tile(model.start[0], (n_samples, 1))
        found = settle(statics, theta, search_of(model.scene, model.kinematics.mechanism))
        # a start is said as joints measure it, which modes turn too
        system.settled = replace(found, theta=angles.of(found.unknowns.T)) if free else found
    if model.measures is not None:
        system.control(*_controls(model, system, own))
    return system


def _controls(
    model: ReducedModel, system: ReducedSystem, values: Mapping[str, np.ndarray]
) -> tuple[Controls, np.ndarray | None]:
    """Return what is beside some samples of a model, and what `ReducedSystem.control` takes with it."""
    measures, n_samples = model.measures, system.n_samples
    members, shares = model.members, [np.broadcast_to(share, n_samples) for share in model.shares(values)]
    of_lanes = measures.known and (not measures.carried or model.actions.carried is not None)
    origins = sum(np.outer(one.measures.origins, share) for share, one in zip(shares, members))
    readers = [] if of_lanes else [_Reader(one, system, values) for one in members]

    def moved(time: float, state: State) -> tuple[np.ndarray, np.ndarray]:
        return measures.noted(system.measured(state), origins)

    def measure(time: float, state: State) -> np.ndarray:
        return sum(share * one.motions(time, state) for share, one in zip(shares, readers))

    def carry(time: float, state: State, before: np.ndarray) -> np.ndarray:
        pulls = sum(share * one.pulls(time, state, before) for share, one in zip(shares, readers))
        return np.linalg.norm(pulls, axis=1)

    carried = (system.carried if of_lanes else carry) if measures.carried else None
    chosen = moved if measures.known else measure
    controls = Controls(model.scene, values, n_samples, chosen, system.put_forces, carried)
    return controls, origins if of_lanes else None


class _Reader:
    """What controllers measure and joints carry, as a model reads it of states of a system."""

    def __init__(self, model: ReducedModel, system: ReducedSystem, values: Mapping[str, np.ndarray]) -> None:
        self._measures, self._values = model.measures, values
        self._frames = Reconstruction(model.kinematics, model.rom, model.scene.interpolation, model.measures.nodes)
        if self._measures.carried:
            n = system.n_samples
            self._multipliers = model.multipliers.in_steps(values, n, lambda state: system.beside.acting(state))

    def motions(self, time: float, state: State) -> np.ndarray:
        """See `Measures.motions`; both in an array."""
        return np.array(self._measures.motions(self._jets(state), time, self._values))

    def pulls(self, time: float, state: State, before: np.ndarray) -> np.ndarray:
        """See `Measures.pulls`; joints were taken to carry what was found before, (n_carried, n_samples)."""
        multipliers = self._multipliers(time, state, before)
        return self._measures.pulls(self._jets(state), multipliers, self._values)

    def _jets(self, state: State) -> list[np.ndarray]:
        # an iterate that is no number is lost with its correction, and closes no mechanism
        fine = np.isfinite(state.q).all(axis=1)[:, None]
        return self._frames.jets([np.where(fine, part, 0.0) for part in (state.q, state.v)], self._measures.order)
