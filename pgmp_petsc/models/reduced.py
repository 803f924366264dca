"""The reduced model of a scene, from its ROM file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Self

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Values
from pgmp_petsc.controllers.running import AFTER, BEFORE, Controls
from pgmp_petsc.controllers.running import rows_of as rows_of_beside
from pgmp_petsc.effects import actions_of, effects_of, motions_of, start_of
from pgmp_petsc.effects.effect import Effect
from pgmp_petsc.effects.time_function import TimeFunction
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models.model import TITLES, Measures, Model, require_lengths, search_of, velocities_of
from pgmp_petsc.models.reduced_statics import JointAngles, ReducedStatics
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.outputs.readings import AnyReading, Seen, jet_of
from pgmp_petsc.reduced.actions import ReducedActions, nodes_of
from pgmp_petsc.reduced.carried_forces import CarriedForces
from pgmp_petsc.reduced.gap_forces import GapForces
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.reduced.terms import ReducedDamping, ReducedTerms
from pgmp_petsc.reduction.joint_gaps import rows_of
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

AT_ONCE = 4096  # states whose local effects are evaluated together
MOST_KEPT = 3  # systems that are used again: of all samples, of many states, and of those that are left
MOST_TURNS, SETTLED = 100, 1e-12  # of forces carried and friction, found in turn


class Observing(Model):
    """Models that observe what outputs are made of in states of reduced coordinates.

    `formulas` are outputs that are made once others are found, or what forces in joints are made of.
    """

    on_ranks = False
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
            found[name] = jet_of(formula, seen, 0)[0]
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
    title = TITLES[name]

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
        self.terms = ReducedTerms.of(rom, self.kinematics, scene, ReducedDamping.of(self.effects, self.kinematics, rom))
        actions = actions_of(self.effects)
        self.places = places or grid_of_places(rom.tables.samples, self.kinematics, actions)[0]
        self.actions = ReducedActions.of(
            actions, self.kinematics, rom, scheme, self.start[0], self.terms.parts, self.places
        )
        self.reconstruction = Reconstruction(self.kinematics, rom, scheme, self.outputs.nodes)
        self.stresses = None
        if self.outputs.stresses:
            from pgmp_petsc.models.body_fields import ReducedStresses  # few scenes have them

            self.stresses = ReducedStresses(scene, self.outputs, self.kinematics, rom)
        self.multipliers = None
        carried = self.measures is not None and self.measures.carried
        if self.outputs.forces or carried:
            self.multipliers = ReducedMultipliers(self)
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
        # of single runs
        from pgmp_petsc.models.body_fields import FieldSet, ReducedFields

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


class ReducedMultipliers:
    """The multipliers of what joints hold and of prescribed coordinates, from states of a reduced model: rows of unit
    gaps in its equations (`reduced.gap_forces`).

    Friction that hangs on the force that a joint carries is in these equations, and that force of them: at given
    accelerations the two are found in turn, which contracts by about the coefficient times a lever over a length.
    Forces of controllers are known with the states; where they jump, accelerations are those before.

    Raises `InputError` if the model was built without the gaps of an output, or of an effect.
    """

    def __init__(self, model: ReducedModel) -> None:
        forces, carried = model.outputs.forces, () if model.measures is None else model.measures.carried
        rom, kinematics, scheme = model.rom, model.kinematics, model.scene.interpolation
        n_held, gaps = kinematics.mechanism.n_held, rom.gaps
        known = np.zeros(0, dtype=int) if gaps is None else gaps.rows
        for entry, force in ((table, one) for table, of in (("outputs", forces), ("effects", carried)) for one in of):
            if not np.isin(rows_of([force], n_held), known).all():
                raise InputError(
                    f"{entry}.{force.name}: the reduced model was built without what forces in this joint need; name "
                    "it in the scene and run pgmp build again"
                )
        self._n_held, self._effects, self._motions = n_held, model.effects, model.motions
        self._drives = any((force.rows >= n_held).any() for force in forces)
        self.gaps, self._terms, self._actions = None, model.terms, model.actions
        self._carried, self._rows_of_control = carried, rows_of_beside(model.scene)[len(carried) :]
        self._nodes = sorted({node for one in carried for node in one.nodes})
        self._frames = Reconstruction(kinematics, rom, scheme, self._nodes) if self._nodes else None
        self._kept: dict[int, tuple[ReducedSystem, Mapping[str, np.ndarray]]] = {}  # by numbers of samples
        self.rows = rows_of((*forces, *carried), n_held)
        if self.rows.size:
            gaps = gaps.of_rows(self.rows)
            wider = replace(rom, projection=np.concatenate([rom.projection, gaps.shapes], axis=2))
            damping = ReducedDamping.of(model.effects, kinematics, wider)
            loaded = [kinematics.mechanism.node_dofs(node) for node in nodes_of(self._actions.actions)]
            self.gaps = GapForces.of(gaps, rom.tables, scheme, damping, model.scene.gyroscopic, loaded)

    def under(self, effects: Sequence[Effect]) -> Self:
        """Return the multipliers under effects that differ in what acts over time alone."""
        other = copy(self)
        other._effects, other._kept = effects, {}
        other._actions = replace(self._actions, actions=actions_of(effects))
        return other

    def of(self, times: np.ndarray | float, states: State, values: Values) -> np.ndarray:
        """Return the multipliers, shape (n_held + n_driven, n), NaN where they are not known, in states (n, n_eta);
        times (s) and parameter values are numbers or of shape (n,). Under control they take ``states.forces``, as of
        `ReducedModel.observed_of`."""
        n = len(states.q)
        times, values = np.broadcast_to(times, n), {name: np.broadcast_to(one, n) for name, one in values.items()}
        if self._carried or self._rows_of_control or not n:
            return self._turn_by_turn(times, states, values)
        n_samples, found = _side_by_side(times, values), self._nothing(n)
        together = n_samples * max(1, AT_ONCE // n_samples)  # states with the values of those before: a system is kept
        if self.rows.size:
            own = {name: one[:n_samples] for name, one in values.items()}
            system, loads = self._system_of(n_samples, own), []
            for first in range(0, n, together):
                some = slice(first, first + together)
                loads.append(self._node_loads(system, times[some], _part(states, some)))
            found[self.rows] = -self.gaps.at(times, states, own, self._effects, np.concatenate(loads), n_samples)
        together = min(together, AT_ONCE)  # of what is not side by side too
        for first in range(0, n if self._drives else 0, together):
            some = slice(first, min(first + together, n))
            alike = slice(first, first + min(n_samples, some.stop - first))
            system = self._system_of(alike.stop - first, {name: one[alike] for name, one in values.items()})
            found[self._n_held :, some] = self._of_drives(system, times[some], _part(states, some))
        return found

    def _turn_by_turn(self, times: np.ndarray, states: State, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the multipliers where forces that joints carry, or of controllers, are in the equations."""
        found = self._nothing(times.size)
        for first in range(0, times.size, AT_ONCE):
            some = slice(first, min(first + AT_ONCE, times.size))
            own, state = {name: one[some] for name, one in values.items()}, _part(states, some)
            system = self._system_of(some.stop - first, own)
            loads = np.zeros((len(self._carried), some.stop - first))
            acting = [np.zeros((rows, some.stop - first, 3)) for rows in self._rows_of_control]
            for part, force in zip(acting, states.forces[some, BEFORE, len(loads) :].T if acting else ()):
                part[0, :, 0] = force
            for _ in range(MOST_TURNS):
                found[:, some], before = self._with(system, loads, times[some], state, own, acting), loads
                loads = self._loads(state, found[:, some], own)
                if not np.any(np.abs(loads - before) > SETTLED * np.abs(loads)):
                    break
        return found

    def in_steps(
        self, values: Mapping[str, np.ndarray], n_samples: int, acting: Callable[[State], np.ndarray]
    ) -> Callable[[float, State, np.ndarray], np.ndarray]:
        """Return what finds the multipliers (n_held + n_driven, n_samples) at a time (s), for a state and forces
        (n_carried, n_samples) that joints were taken to carry, as an iteration goes on, under what controllers give
        then (`Controls.acting`); a sample that does not move keeps what it had, so that what is beside it changes no
        more than round-off."""
        every = {name: np.broadcast_to(one, n_samples) for name, one in values.items()}
        system, n_own = self._system(n_samples, every), self._terms.layout.n_eta
        kept: list[np.ndarray | None] = [np.full((n_samples, n_own), np.nan), None]

        def multipliers(time: float, state: State, loads: np.ndarray) -> np.ndarray:
            found = self._with(system, loads, np.full(n_samples, time), state, every, [acting(state)])
            same = (kept[0] == state.a).all(axis=1)
            if same.any():
                found[:, same] = kept[1][:, same]
            kept[:] = state.a.copy(), found
            return found

        return multipliers

    def take_actions(self, actions: ReducedActions) -> None:
        """Take local effects of samples with any lengths in place of the model's own: a law that bends, of a stop or of
        friction, has the force that it has at the sample's places, not at those of the model's lengths."""
        self._actions = actions

    def in_lanes(self) -> CarriedForces | None:
        """Return what steps in lanes take of the forces that joints carry; see `CarriedForces.of`."""
        actions = self._actions.actions
        rubbing = [k for k, action in enumerate(actions) if action.law.loaded]
        return CarriedForces.of(
            self.gaps, self.rows.tolist(), self._terms.terms, self._terms.grid, self._carried, rubbing, actions
        )

    def _nothing(self, n: int) -> np.ndarray:
        return np.full((self._n_held + len(self._motions), n), np.nan)

    def _with(
        self, system: ReducedSystem, loads: np.ndarray, times: np.ndarray, state: State,
        values: Mapping[str, np.ndarray], acting: Iterable[np.ndarray] = (),
    ) -> np.ndarray:  # fmt: skip
        """Return the multipliers where joints carry forces (n_carried, n), and controllers act, as of `Controls`."""
        found = self._nothing(times.size)
        system.put_forces([*loads[..., None], *(row for part in acting for row in part)])
        if self._drives:
            found[self._n_held :] = self._of_drives(system, times, state)
        if self.rows.size:
            of_nodes = self._node_loads(system, times, state)
            found[self.rows] = -self.gaps.at(times, state, values, self._effects, of_nodes, system.n_samples)
        return found

    def _of_drives(self, system: ReducedSystem, times: np.ndarray, state: State) -> np.ndarray:
        trail = _over_instants(system, state.q, state.v, state.a)
        found = system.residuals_over(times.reshape(len(trail), -1), trail)
        return -found.reshape(times.size, -1)[:, sorted(self._motions)].T

    def _node_loads(self, system: ReducedSystem, times: np.ndarray, state: State) -> np.ndarray:
        """Return what local effects do to their nodes in states of a system's samples, at one instant after the other,
        (n, n_dofs)."""
        if not self._actions.actions:
            return np.empty((times.size, 0))
        trail = _over_instants(system, state.q, state.v)
        found = system.node_loads(times.reshape(len(trail), -1), trail)
        # behind the nodes of bodies there may be points of the ground: `ReducedActions.joined`
        nodes = found.reshape(times.size, self._actions.places.n_nodes, -1)[:, : len(nodes_of(self._actions.actions))]
        return nodes.reshape(times.size, -1)

    def _loads(self, state: State, multipliers: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the forces that joints carry, (n_carried, n)."""
        if not self._carried:
            return np.zeros((0, len(state.q)))
        jets = () if self._frames is None else self._frames.jets((state.q, state.v), 1)
        at = tuple(dict(zip(self._nodes, part)) for part in jets) or ({},)
        seen = Seen(at, values=values, multipliers=multipliers)
        return np.array([one.made(one.parts(seen)) for one in self._carried])

    def _system_of(self, n: int, values: Mapping[str, np.ndarray]) -> ReducedSystem:
        """Return n samples of the model; the last ones again where they are the same."""
        if n not in self._kept or not _same(self._kept[n][1], values):
            values = {name: np.array(one) for name, one in values.items()}
            if len(self._kept) > MOST_KEPT:
                self._kept.clear()
            self._kept[n] = self._system(n, values), values
        return self._kept[n][0]

    def _system(self, n: int, values: Mapping[str, np.ndarray]) -> ReducedSystem:
        given = np.zeros((self._terms.tables.n_given, n))
        return ReducedSystem(self._terms, self._effects, values, (0.0, 0.0), n, self._motions, self._actions, given)


def _over_instants(system: ReducedSystem, *parts: np.ndarray) -> np.ndarray:
    """Return k parts of states of a system's samples at one instant after the other, (n, n_eta) each, as (n_t, k,
    n_samples, n_eta)."""
    return np.stack([part.reshape(-1, system.n_samples, part.shape[1]) for part in parts], axis=1)


def _part(states: State, some: slice) -> State:
    return State(states.q[some], states.v[some], states.a[some], np.zeros(0))


def _side_by_side(times: np.ndarray, values: Mapping[str, np.ndarray]) -> int:
    """Return how many samples are at one instant after the other, of their times and values (n,); n where they are not
    the same samples."""
    n = times.size
    found = int(np.argmin(times == times[0]))  # states at the first instant, 0 where all are
    if not found or n % found or (times.reshape(-1, found) != times[::found, None]).any():
        return n
    return found if all((one.reshape(-1, found) == one[:found]).all() for one in values.values()) else n


def _same(values: Mapping[str, np.ndarray], others: Mapping[str, np.ndarray]) -> bool:
    """Return whether samples have the same values: what is interpolated for them is kept from call to call."""
    return values.keys() == others.keys() and all(np.array_equal(values[name], one) for name, one in others.items())


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
    return Controls(model.scene, values, n_samples, chosen, system.put_forces, carried), origins if of_lanes else None


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
        return self._measures.pulls(self._jets(state), self._multipliers(time, state, before), self._values)

    def _jets(self, state: State) -> list[np.ndarray]:
        # an iterate that is no number is lost with its correction, and closes no mechanism
        fine = np.isfinite(state.q).all(axis=1)[:, None]
        return self._frames.jets([np.where(fine, part, 0.0) for part in (state.q, state.v)], self._measures.order)
