"""What acts in a scene: its effects, controllers and elastic joints, its motions, and the start that they ask for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.declare.ideas import blaming, refuse
from pgmp_petsc.effects.action import SOURCE, Action
from pgmp_petsc.effects.effect import Effect, Load, Patterns, couples
from pgmp_petsc.effects.time_function import Motion, TimeFunction
from pgmp_petsc.mechanism.mechanism import Coordinate, Mechanism
from pgmp_petsc.scene.effects import Driving, OverTime
from pgmp_petsc.scene.schema import Scene

AT_REST = 1e-12  # rad over a run: less is round-off of sines


def effects_of(scene: Scene, mechanism: Mechanism) -> tuple[Effect, ...]:
    """Return the effects that a scene names and that act by forces, in its order, the controllers, the springs of
    elastic joints, and what holds coordinates at first.

    Raises `InputError` if an effect names a point that its body's mesh does not have.
    """
    named = []
    for name, entry in scene.plain_effects.items():
        if entry.acts == "forces":
            with blaming(type(entry)):
                named.append(entry.forces(name, mechanism))
            if not isinstance(named[-1], Effect):
                found = type(named[-1]).__name__
                raise refuse(type(entry), f"forces returns an Effect, such as an ActionEffect, and not a {found}")
            if not named[-1].acts:
                raise refuse(type(entry), "forces returns an Effect without loads, actions, dampings or a field")
            n_loaded = sum(action.law.loaded for action in named[-1].actions())
            if n_loaded != entry.by_load:
                words = f"{n_loaded} of its actions have a law that is loaded; by_load says whether one has"
                raise refuse(type(entry), words)
            _check_loads(named[-1], mechanism)
            try:
                [one.at(scene.values) for action in named[-1].actions() for one in action.parameters]
            except KeyError as error:
                raise refuse(type(entry), f"its law is given the parameter {error}, which the scene has not") from None
    named += [entry.forces(name, mechanism) for name, entry in scene.controllers.items()]
    named += springs_of_joints(scene, mechanism)
    held = scene.initial.equilibrium and scene.initial.coordinates == "held"
    return (*named, *(HoldingTorque(c) for c in mechanism.coordinates if held and not c.prescribed))


class HoldingTorque(Effect):
    """The torque or force that holds a coordinate until a run starts: no load in the run, but the static basis answers
    it."""

    def __init__(self, coordinate: Coordinate) -> None:
        super().__init__(f"hold {coordinate.name}")
        self._coordinate = coordinate

    def patterns(self, matrices: AffineMatrices) -> list[np.ndarray]:
        return [couples(self._coordinate.connection, matrices)] if self._coordinate.turns else []

    def turning_patterns(self) -> list[Action]:
        held = self._coordinate
        return [] if held.turns else [Action(self.name, held.statement, *held.sides, SOURCE, (Quantity(1.0),))]


def _check_loads(effect: Effect, mechanism: Mechanism) -> None:
    """Raise `InputError` if the loads of an effect do not fit the unknowns, or one that turns with its body is another
    one than a couple: a force that does is an action."""
    if effect.field is not None:
        return  # of the masses, which are dear to assemble
    rows, space = np.arange(mechanism.n_dofs), mechanism.space
    turning = (rows < space.n_dofs * mechanism.n_nodes) & (rows % space.n_dofs >= space.dimension)
    for load in effect.loads(AffineMatrices(mechanism.bodies, range(rows.size))):
        why, given = "", np.shape(load.vector)
        if given != rows.shape:
            why = f"a load has a number for each row of the matrices, {rows.shape}, and not {given}"
        elif load.in_bodies and np.any(load.vector[~turning]):
            why = "a load with in_bodies is of couples alone; a force that turns with its body is an action (following)"
        elif load.in_bodies and space.dimension == 3 and type(effect).natural_actions is Effect.natural_actions:
            why = "couples with in_bodies are no loads in space; natural_actions returns them there"
        if why:
            raise refuse(type(effect), why)


def springs_of_joints(scene: Scene, mechanism: Mechanism) -> list[Effect]:
    """Return what holds a mechanism together beside its constraints: the springs of elastic joints and couplings, and
    what acts in those with a clearance."""
    joints = [c for c in mechanism.connections if c.released]
    couplings = [c for c in mechanism.couplings if c.elastic]
    if not (joints or couplings):
        return []
    # most scenes have none, and do not wait for them
    from pgmp_petsc.effects.clearance import loose_coupling, loose_joint
    from pgmp_petsc.effects.springs import elastic_coupling, elastic_joint

    of_joints = {"elastic": elastic_joint, "clearance": loose_joint}
    of_couplings = {"elastic": elastic_coupling, "clearance": loose_coupling}
    return [
        *(of_joints[scene.joints[c.name].gives_way](c.name, scene, mechanism) for c in joints),
        *(of_couplings[scene.joints[c.name].gives_way](c, scene, mechanism) for c in couplings),
    ]


def motions_of(scene: Scene, mechanism: Mechanism) -> dict[int, Motion]:
    """Return the prescribed motions by the number of their coordinate."""
    motions = [entry.motion(name) for name, entry in scene.effects.items() if isinstance(entry, Driving)]
    numbers = {coordinate.name: k for k, coordinate in enumerate(mechanism.coordinates)}
    return {numbers[motion.coordinate]: motion for motion in sorted(motions, key=lambda m: numbers[m.coordinate])}


def start_of(scene: Scene, mechanism: Mechanism) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (rad) and velocities (rad/s) of the coordinates at the start, each of shape (n_theta,).

    Raises `InputError` if the run is to start at rest, and a prescribed motion does not.
    """
    motions = motions_of(scene, mechanism)
    start = []
    for number, coordinate in enumerate(mechanism.coordinates):
        if number in motions:
            start.append(motions[number].at(0.0)[:2])
        else:
            state = scene.initial_state(coordinate.name)
            start.append((state.position, scene.number(state.velocity)))
    positions, velocities = np.array(start).T
    for number, motion in motions.items():
        if scene.initial.equilibrium and abs(velocities[number]) * scene.simulation.duration > AT_REST:
            raise InputError(
                f"effects.{motion.name}: it moves {motion.coordinate} at "
                f"{mechanism.coordinates[number].text(velocities[number])}/s at time zero, "
                "but with initial.equilibrium = true the run starts at rest; take a motion that begins at rest "
                "(spin_up, a table, or a harmonic with phase = 1.5707963267948966), or leave initial.equilibrium out"
            )
    return positions, velocities


def bases_of(scene: Scene) -> Iterator[tuple[OverTime, TimeFunction]]:
    """Yield the motions of a scene's base, those whose values name parameters as several with a scale each."""
    for entry in scene.plain_effects.values():
        course = entry.course()
        if course is not None:
            yield entry, course


def loads_of(effects: Sequence[Effect], matrices: AffineMatrices) -> tuple[Load, ...]:
    """Return the load terms of all effects, effect after effect."""
    return tuple(load for effect in effects for load in effect.loads(matrices))


def actions_of(effects: Sequence[Effect], dimension: int = 2) -> tuple[Action, ...]:
    """Return the local effects of all effects, effect after effect; in space those on natural coordinates."""
    return tuple(
        action for effect in effects for action in (effect.actions() if dimension == 2 else effect.natural_actions())
    )


def patterns_of(effects: Sequence[Effect], matrices: AffineMatrices) -> Patterns:
    """Return the forces that all effects are made of, for static answers to them."""
    vectors, elastic = [], []
    for effect in effects:
        elastic += [len(vectors) + number for number in effect.elastic_patterns()]
        vectors += effect.patterns(matrices)
    turning = tuple(action for effect in effects for action in effect.turning_patterns())
    fixed = np.array(vectors).reshape(len(vectors), len(matrices.rows)).T
    return Patterns(fixed, turning, np.array(elastic, dtype=int))
