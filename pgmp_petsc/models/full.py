"""The models of a scene that have its unknowns: the full-order one, and the component one, whose flexible bodies are in
floating frames, joined by constraints; and samples of both whose lengths differ, a mechanism each."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import lsqr

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.surroundings import Comm, alone
from pgmp_petsc.bodies.shape import BodyShape, at_lengths
from pgmp_petsc.controllers.running import AFTER, Controls
from pgmp_petsc.effects import Effect, effects_of, motions_of, springs_of_joints, start_of
from pgmp_petsc.files.seal import identity
from pgmp_petsc.full.distributed import FullDistributed, FullStatics
from pgmp_petsc.full.joint_systems import JointBatch
from pgmp_petsc.full.problem import FullEquations
from pgmp_petsc.full.rank_solver import PREFIX
from pgmp_petsc.full.systems import FullBatch
from pgmp_petsc.lanes.lane_items import SampleBlocks
from pgmp_petsc.mechanism.closure import LARGEST_GAP
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism, Unknowns
from pgmp_petsc.mesh.meshes import LineMesh
from pgmp_petsc.models.model import TITLES, Measures, Model, require_lengths, search_of, velocities_of
from pgmp_petsc.outputs.outputs import OutputSet, OverRuns
from pgmp_petsc.ranks.petsc import options_of
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.parameters import uncertain_names
from pgmp_petsc.scene.uses import length_names, offset_names
from pgmp_petsc.stepping.second_order_system import SecondOrderSystem, Settled, State
from pgmp_petsc.stepping.static_equilibrium import UNBALANCED, moved_along, require_balance, settle

if TYPE_CHECKING:
    from pgmp_petsc.models.body_fields import FullFields
    from pgmp_petsc.outputs.rainflow import Counted
    from pgmp_petsc.reduction.rom import Served


SomeSystem = TypeVar("SomeSystem", FullBatch, FullDistributed)
CLOSED = 1e-12  # of what is off, that least squares may leave
MOST_IN_LANES = 3500  # unknowns; beyond, the fill-in of bulky meshes outgrows the caches, and PETSc's solvers win


class FullModel(Model):
    """All nodal unknowns, index-3 equations with Lagrange multipliers; see `Model`.

    Kinematics are those of the mechanism, where they are at hand, whichever of its bodies deform there.
    """

    name = "full"
    title = TITLES[name]
    on_ranks = True
    served: Mapping[str, Served] = {}  # any values of parameters
    in_joints = False  # whether samples in lanes are stepped in joint coordinates
    _varied: Collection[str] = ()  # parameters that samples differ in, besides those that the scene draws

    def __init__(self, scene: Scene, meshes: Mapping[str, LineMesh], kinematics: RigidKinematics | None = None) -> None:
        self.scene = scene
        self.meshes = meshes
        if kinematics is None or not kinematics.mechanism.made_of(scene, meshes):
            mechanism = Mechanism.from_scene(scene, meshes)
            kinematics = RigidKinematics(mechanism) if kinematics is None else kinematics.of_bodies(mechanism)
        self.kinematics, mechanism = kinematics, kinematics.mechanism
        self._effects, self._motions = effects_of(scene, mechanism), motions_of(scene, mechanism)
        self._start = start_of(scene, mechanism)
        self.outputs = OutputSet.of(scene, self.kinematics, self._start[0])
        self.measures = Measures(scene, self.kinematics, self._start[0]) if scene.beside else None
        self._stresses = None
        if self.outputs.stresses:
            from pgmp_petsc.models.body_fields import FullStresses  # few scenes have them

            self._stresses = FullStresses(self.outputs, Unknowns(mechanism))

    def in_scene(self, scene: Scene) -> Self:
        """Return the model of a scene that differs in what is no part of its bodies."""
        if not self.scene.moves_as(scene):
            return self._anew(scene)
        other = copy(self)
        other.scene = scene
        return other

    def _anew(self, scene: Scene) -> Self:
        return type(self)(scene, self.meshes, self.kinematics)

    def varying(self, names: Collection[str]) -> Self:
        """Return the model of samples that differ in these parameters too."""
        other = copy(self)
        other._varied = names
        return other

    def at_lengths(self, scene: Scene) -> Self:
        """Return the model of a scene that differs in the lengths of its run alone."""
        return type(self)(scene, at_lengths(scene, self.meshes))

    def with_loads(self, scene: Scene) -> Self:
        """Return the model under the loads of a scene that differs in torques and forces over time, and in the
        simulation, alone."""
        other = copy(self)
        other.scene, other._effects = scene, effects_of(scene, self.kinematics.mechanism)
        other.outputs = self.outputs.under(scene)
        return other

    @property
    def largest_batch(self) -> int:
        """Most samples that a batch may have; of large meshes, or where meshes differ, it is one."""
        own_meshes = {*uncertain_names(self.scene), *self._varied} & self._scaling
        alone = own_meshes or self.scene.beside  # whose forces are of one sample
        return self.scene.ensemble.batch if self._in_lanes and not alone else 1

    @property
    def identity(self) -> str:
        return identity(self.meshes)

    def batch(self, values: Mapping[str, np.ndarray], n_samples: int) -> FullBatch | FullDistributed:
        """Return a batch of samples on this rank, at most `largest_batch`."""
        if not self._in_lanes:
            return self.distributed({name: float(value[0]) for name, value in values.items()}, alone())
        sized = self._sized({name: float(value[0]) for name, value in values.items()})
        settled = sized.settled(values, n_samples) if self.scene.initial.equilibrium else None
        start = sized.start_of_samples(values, n_samples)
        built_in = sized.built_in(values, start, n_samples) if settled is None else None
        system = FullBatch(sized.kinematics, sized._effects, values, start, n_samples, sized._motions, self.in_joints)
        system.settled, system.built_in = settled, built_in
        return sized.controlled(JointBatch(system) if self.in_joints else system, values)

    def controlled(
        self, system: SomeSystem, values: Mapping[str, np.ndarray],
        whole: Callable[[float, State], State] = lambda time, state: state,
    ) -> SomeSystem:  # fmt: skip
        """Return a system of one sample with its controllers; `whole` makes states of the model of its own at a time
        (s)."""
        if self.measures is not None:
            measures, unknowns = self.measures, Unknowns(self.kinematics.mechanism)
            nodes, in_lanes = list(measures.nodes), isinstance(system, FullBatch)  # which has all actions

            def frames(state: State) -> list[np.ndarray]:
                states = state.alone
                return [system.frames_over(states)[nodes], unknowns.frames(system.unknowns_over(states)[1])[nodes]]

            def measure(time: float, state: State) -> tuple[np.ndarray, np.ndarray]:
                return measures.motions(frames(whole(time, state)), time, values)

            def moved(time: float, state: State) -> tuple[np.ndarray, np.ndarray]:
                return measures.noted(system.measured(whole(time, state)), measures.origins[:, None])

            def carry(time: float, state: State, before: np.ndarray) -> np.ndarray:
                state = whole(time, state)
                if in_lanes:
                    return system.carried(time, state)
                multipliers = system.multipliers_of_joints([time], state.alone)
                return np.linalg.norm(measures.pulls(frames(state), multipliers, values), axis=1)

            carried = carry if measures.carried else None
            chosen = moved if measures.known and in_lanes else measure
            controls = Controls(self.scene, values, 1, chosen, system.put_forces, carried)
            own = (measures.carried, measures.origins if measures.known else None) if in_lanes else ()
            system.control(controls, *own)
        return system

    def built_in(
        self, values: Mapping[str, np.ndarray], start: tuple[np.ndarray, np.ndarray], n_samples: int
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return unknowns and velocities (n_dofs, n_samples) that samples start with where joints are off, each found
        by itself, from `start_of_samples`; None where none is."""
        if not self.is_off:
            return None
        rates = np.broadcast_to(start[1].reshape(start[0].size, -1), (start[0].size, n_samples))
        each = [
            self._built_in({name: float(value[k]) for name, value in values.items()}, rates[:, k], alone())
            for k in range(n_samples)
        ]
        return tuple(np.concatenate(parts, axis=1) for parts in zip(*each))

    def start_of_samples(self, values: Mapping[str, np.ndarray], n_samples: int) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (n_theta,), rad, and velocities of the coordinates at the start, rad/s; see
        `velocities_of`."""
        positions, of_run = self._start
        return positions, velocities_of(self.scene, self.kinematics.mechanism, of_run, values, n_samples)

    @property
    def _in_lanes(self) -> bool:
        """Whether samples may lie side by side: not where options of PETSc's linear solver are given."""
        return self.kinematics.mechanism.n_dofs <= MOST_IN_LANES and not options_of(PREFIX)

    def single(self, values: Mapping[str, float], comm: Comm) -> FullBatch | FullDistributed:
        """Return one sample on all ranks of `comm`; to be closed. Collective on `comm`.

        On one rank small mechanisms are a batch of one, unless options of PETSc's linear solver are given.
        """
        if comm.size > 1 or not self._in_lanes:
            return self.distributed(values, comm)
        return self.batch({name: np.array([value]) for name, value in values.items()}, 1)

    def distributed(self, values: Mapping[str, float], comm: Comm) -> FullDistributed:
        """Return one sample on all ranks of `comm`; to be closed. Collective on `comm`."""
        sized = self._sized(values)
        settled = sized._settled(values, comm) if self.scene.initial.equilibrium else None
        positions, rates = sized.start_of_samples(values, 1)
        start = (positions, rates.reshape(-1)) if settled is None else (settled.theta[0], np.zeros(len(positions)))
        built_in = sized._built_in(values, start[1], comm) if settled is None and sized.is_off else None
        system = FullDistributed(sized._equations(sized.kinematics, values, start, comm), comm, sized._motions)
        system.settled, system.built_in = settled, built_in
        return sized.controlled(system, {name: np.array([value]) for name, value in values.items()})

    def _equations(
        self,
        kinematics: RigidKinematics,
        values: Mapping[str, float],
        start: tuple[np.ndarray, np.ndarray],
        comm: Comm,
        effects: Sequence[Effect] | None = None,
    ) -> FullEquations:
        """Return this rank's share of the equations of one sample, under some effects or all."""
        owned = Unknowns(kinematics.mechanism).share(comm.rank, comm.size)
        of_sample = {name: np.array([value]) for name, value in values.items()}
        effects = self._effects if effects is None else effects
        return FullEquations(kinematics, effects, of_sample, SampleBlocks(1, 1, 1), start, owned)

    def _settled(self, values: Mapping[str, float], comm: Comm) -> Settled:
        """Return the static equilibrium of one sample. Collective on `comm`."""
        theta = self._start[0]
        equations = self._equations(self.kinematics.held(), values, (theta, np.zeros_like(theta)), comm)
        with FullStatics(equations, comm) as statics:
            settled = settle(statics, theta[None], search_of(self.scene, self.kinematics.mechanism))
        if self.is_off and not settled.reasons:
            self._require_held(settled.unknowns, theta)
        return settled

    @property
    def is_off(self) -> bool:
        """Whether joints do not agree with the rigid mechanism: bodies deform before anything acts."""
        return bool(self.kinematics.remarks) or any(joint.offset for joint in self.scene.joints.values())

    def _built_in(self, values: Mapping[str, float], rates: np.ndarray, comm: Comm) -> tuple[np.ndarray, np.ndarray]:
        """Return unknowns and velocities (n_dofs, 1) of the static answer to joints that are off, without loads but on
        the springs of elastic joints, at the start with rates (n_theta,). Collective on `comm`.

        Raises `InputError` where there is none: rigid bodies do not give way.
        """
        theta = self._start[0]
        require_balance(self.scene, self.kinematics, theta, self.scene.values | dict(values))
        held = self.kinematics.held()
        springs = springs_of_joints(self.scene, held.mechanism)
        equations = self._equations(held, values, (theta, np.zeros_like(theta)), comm, springs)
        with FullStatics(equations, comm) as statics:

            def deformed(at: np.ndarray) -> np.ndarray:
                _, lost = statics.hold(at[None], np.ones(1, dtype=bool))
                if lost[0]:
                    residual = self._residual(equations.start[0][:, None])
                    if self._furthest(residual)[2] == 0.0:
                        raise InputError(UNBALANCED.format(statics.cause(0)))
                    self._refuse(residual, theta)
                return statics.unknowns()

            q = deformed(theta)
            self._require_held(q, theta)
            scales = np.array([c.scale(self.kinematics.size) for c in self.kinematics.coordinates])
            return q, moved_along(deformed, q, theta, rates, scales)

    def require_taken(self) -> None:
        """Refuse joints that are off by more than bodies can give way, as far as the first order tells."""
        if not self.is_off:
            return
        theta, held = self._start[0], self.kinematics.held()
        if not self.scene.initial.equilibrium:
            require_balance(self.scene, self.kinematics, theta, self.scene.values)
        q = Unknowns(held.mechanism).place(held.poses(theta)[..., 0])[:, None]
        constraints = held.constraints
        residual = constraints.residual(q, theta)[:, 0]
        values, at = constraints.jacobian_values(q)[:, 0], constraints.jacobian_pattern
        jacobian = sp.csr_matrix((values, at), shape=(residual.size, q.size))
        given = lsqr(jacobian, residual, atol=CLOSED, btol=CLOSED, iter_lim=20 * residual.size)[0]
        if self._furthest(residual - jacobian @ given)[2] > LARGEST_GAP:
            self._refuse(residual, theta)

    def _require_held(self, q: np.ndarray, theta: np.ndarray) -> None:
        """Refuse joints that are off by more than bodies at unknowns (n_dofs, 1) give way."""
        if self._furthest(self._residual(q))[2] > LARGEST_GAP:
            self._refuse(self._residual(q), theta)

    def _refuse(self, residual: np.ndarray, theta: np.ndarray) -> None:
        name, gap, _ = self._furthest(residual)
        raise InputError(
            f"joints.{name}: {gap} remains at {self.kinematics.describe(theta)}: joints are off by what no redundancy "
            "explains and no elasticity takes. Let bodies that they hold be flexible, take a smaller offset (turn in "
            "rad), or joints that hold less; placements, the first guess of how it is assembled, may be the reason too"
        )

    def _residual(self, q: np.ndarray) -> np.ndarray:
        """Return what the constraints are off at unknowns (n_dofs, 1), those of joints first."""
        constraints = self.kinematics.constraints
        return constraints.residual(q, np.zeros(constraints.n_driven))[:, 0]

    def _furthest(self, residual: np.ndarray) -> tuple[str, str, float]:
        """Return the joint that is furthest from holding where the constraints are off by a residual, by how much, and
        that in units of the mechanism's size or of 1 rad."""
        mechanism, found, row, system = self.kinematics.mechanism, [], 0, self.scene.system
        residual = np.abs(residual)
        for connection in mechanism.connections:
            for part, _ in connection.held:
                unit = self.kinematics.size if part.is_length else 1.0
                what = "a gap of" if part.is_length else "an angle of"
                text = f"{what} {system.text(residual[row], 'm' if part.is_length else 'rad')}"
                found.append((residual[row] / unit, connection.name, text))
                row += 1
        far, name, gap = max(found, default=(0.0, "", ""))
        return name, gap, far

    def settled(self, values: Mapping[str, np.ndarray], n_samples: int) -> Settled:
        """Return the static equilibria of samples, each found by itself."""
        each = [
            self._settled({name: float(value[k]) for name, value in values.items()}, alone()) for k in range(n_samples)
        ]
        return Settled(
            np.concatenate([one.theta for one in each]),
            np.concatenate([one.unknowns for one in each], axis=1),
            {k: one.reasons[0] for k, one in enumerate(each) if one.reasons},
            np.concatenate([one.unstable for one in each]),
            each[0].coordinates,
            each[0].free,
        )

    @property
    def _scaling(self) -> set[str | None]:
        """Parameters that scale cross-sections or are offsets of joints, each value with a mechanism of its own."""
        return {body.section_scale for body in self.scene.bodies.values()} | offset_names(self.scene)

    def _sized(self, values: Mapping[str, float]) -> Self:
        """Return the model whose meshes have the cross-sections that parameter values give, and its own lengths."""
        require_lengths(self.scene, values)
        scaling = self._scaling & set(values)
        if all(values[name] == self.scene.values[name] for name in scaling):
            return self
        return type(self)(self.scene.with_values({name: values[name] for name in scaling}), self.meshes)

    @property
    def limited(self) -> bool:
        """Whether an output is known within the coordinates' ranges alone."""
        return self.outputs.reached is not None

    def left_range(self, system: FullBatch | FullDistributed, state: State) -> np.ndarray:
        """Return the samples with a coordinate outside the range of such an output, shape (n_samples,).

        Collective on the system's communicator.
        """
        frames = system.frames(state)[list(self.outputs.nodes)]
        with np.errstate(all="ignore"):  # samples that have failed do not move, whatever they are
            return ~self.outputs.reached(dict(zip(self.outputs.nodes, frames)))

    def observed_over(
        self,
        system: FullBatch | FullDistributed,
        states: State,
        times: Sequence[float],
        frames: np.ndarray | None = None,
    ) -> np.ndarray:
        """See `Model`; frames are those of `FullSystem.frames_over`, where they are at hand."""
        frames = system.frames_over(states) if frames is None else frames
        q = v = a = None
        if self._stresses is not None or self.outputs.order:
            q, v, a = system.unknowns_over(states)
        multipliers = system.joint_multipliers(times, states) if self.outputs.forces else None
        beside = system.beside.forces(np.array(times), AFTER)[:, 0].T if self.outputs.beside else None
        time, values = np.repeat(times, system.n_samples), system.values
        if system.n_samples > 1:
            values = {name: np.tile(value, len(times)) for name, value in values.items()}
        return self.observed_of(time, frames, values, q, v, a, multipliers, beside)

    def observed_of(
        self, time: np.ndarray, frames: np.ndarray, values: Mapping[str, np.ndarray | float],
        q: np.ndarray | None, v: np.ndarray | None, a: np.ndarray | None, multipliers: np.ndarray | None = None,
        beside: np.ndarray | None = None,
    ) -> np.ndarray:  # fmt: skip
        """Return what the outputs are made of, (n_observed, n), for the frames of all nodes (n_nodes, n_frame, n).

        Stresses alone need the unknowns (n_dofs, n), outputs that read rates or accelerations those, and forces in
        joints their multipliers (`FullSystem.joint_multipliers`), those of controllers all that is beside (n_names, n).
        Times and parameter values are numbers, or of shape (n,).
        """
        stresses = np.empty((0, frames.shape[2])) if self._stresses is None else self._stresses.of(q, values)
        nodes, unknowns = list(self.outputs.nodes), Unknowns(self.kinematics.mechanism)
        moving = [frames[nodes], *(unknowns.frames(part)[nodes] for part in (v, a)[: self.outputs.order])]
        if self.outputs.forces:
            stresses = np.concatenate([stresses, self.outputs.forces_of(moving, multipliers, values)])
        if self.outputs.beside:
            stresses = np.concatenate([stresses, beside[list(self.outputs.beside.values())]])
        return self.outputs.observed(moving, stresses, time, values)

    def fields(self) -> FullFields:
        """Return what makes the fields of bodies from unknowns: of those that frames are kept of."""
        from pgmp_petsc.models.body_fields import FieldSet, FullFields  # of single runs

        unknowns = Unknowns(self.kinematics.mechanism)
        return FullFields(FieldSet.of(self.scene, unknowns.bodies, self.scene.simulation.frames), unknowns)


class ComponentModel(FullModel):
    """The equations of the full-order model with another kind of flexible body; see `Model` and `bodies.floating`.

    Flexible shapes are as `components.condensing` makes them, on `n_ranks`, each body on one; kinematics are those of
    the same mechanism, where they are at hand. `served` has the ranges of the parameters that the bodies were condensed
    for, where they are not of all values alike.
    """

    name = "components"
    title = TITLES[name]
    in_joints = True

    def __init__(
        self,
        scene: Scene,
        shapes: Mapping[str, BodyShape],
        kinematics: RigidKinematics | None = None,
        n_ranks: int = 1,
        served: Mapping[str, Served] | None = None,
    ) -> None:
        super().__init__(scene, shapes, kinematics)
        self.n_ranks, self.served = n_ranks, served or {}

    def _anew(self, scene: Scene) -> Self:
        return type(self)(scene, self.meshes, self.kinematics, self.n_ranks, self.served)

    def single(self, values: Mapping[str, float], comm: Comm) -> FullBatch | FullDistributed:
        """Return one sample, which every rank has by itself; see `FullModel`."""
        return super().single(values, alone())

    @property
    def _scaling(self) -> set[str | None]:
        """Offsets of joints: cross-sections that scale are weights of moments and stiffness as all parameters are."""
        return offset_names(self.scene)

    @property
    def n_amplitudes(self) -> dict[str, int]:
        """Number of component modes of every flexible body."""
        return {body.name: body.n_amplitudes for body in self.kinematics.mechanism.bodies if body.n_amplitudes}


@dataclass(frozen=True)
class EvaluatedOutputs(OverRuns):
    """Outputs that a model observes as they are; see `OutputSet`."""

    units: dict[str, str]  # unit of every output
    counts: Mapping[str, Counted]  # what is counted over a run, by the outputs' names
    takes_beside: bool = False  # whether states are to bring forces of what is beside along

    @property
    def functions(self) -> dict[str, None]:
        """The outputs' names: nothing is to be done for any."""
        return dict.fromkeys(self.units)

    def evaluate(self, observed: np.ndarray) -> dict[str, np.ndarray]:
        """Return the outputs, each of shape (n,), for what a model observes, shape (n_outputs, n)."""
        return dict(zip(self.units, observed))


class SeparateLengths(Model):
    """Full-order or component samples one by one, each with a `model` of its own lengths; see `Model`."""

    largest_batch, on_ranks = 1, True

    def __init__(self, model: FullModel) -> None:
        self.model = model
        self.name, self.title, self.identity = model.name, model.title, model.identity
        self.scene, self.kinematics, self.limited = model.scene, model.kinematics, model.limited
        self.outputs = EvaluatedOutputs(model.outputs.units, model.outputs.counts)
        self.lengths = length_names(model.scene)
        self._models: WeakKeyDictionary[SecondOrderSystem, FullModel] = WeakKeyDictionary()
        self._last: tuple[dict[str, float], FullModel] = {}, model

    def batch(self, values: Mapping[str, np.ndarray], n_samples: int) -> SecondOrderSystem:
        own = self._at({name: float(values[name][0]) for name in self.lengths})
        system = own.batch(values, n_samples)
        self._models[system] = own
        return system

    def single(self, values: Mapping[str, float], comm: Comm) -> SecondOrderSystem:
        """Return one full-order sample on all ranks of `comm`; to be closed. Collective on `comm`."""
        own = self._at({name: float(values[name]) for name in self.lengths})
        system = own.single(values, comm)
        self._models[system] = own
        return system

    def left_range(self, system: SecondOrderSystem, state: State) -> np.ndarray:
        """See `FullModel`. Collective on the system's communicator."""
        return self._models[system].left_range(system, state)

    def observed_over(
        self, system: SecondOrderSystem, states: State, times: Sequence[float], frames: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the outputs in states of the only sample, shape (n_outputs, n); see `FullModel.observed_over`."""
        own = self._models[system]
        return stacked(own.outputs.evaluate(own.observed_over(system, states, times, frames)), len(times))

    def closes(self, values: Mapping[str, np.ndarray], alive: np.ndarray) -> np.ndarray:
        """Return which samples, of those `alive`, shape (n,), have lengths of which a mechanism can be put together."""
        closed = alive.copy()
        for k in np.flatnonzero(alive):
            try:
                self._at({name: float(values[name][k]) for name in self.lengths})
            except InputError:
                closed[k] = False
        return closed

    def _at(self, lengths: dict[str, float]) -> FullModel:
        if lengths != self._last[0]:  # a sample is looked at first, and tried again with smaller steps
            self._last = lengths, self.model.at_lengths(self.scene.with_values(lengths))
        return self._last[1]


def stacked(outputs: Mapping[str, np.ndarray], n: int) -> np.ndarray:
    """Return outputs (n,) as rows."""
    return np.array(list(outputs.values())).reshape(len(outputs), n)
