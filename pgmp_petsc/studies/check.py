"""Summary of a scene, in words: bodies, unknowns, effects, memory. Solves no eigenproblem.

Contents of a scene as plain data, for `pgmp check --json`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from pgmp_petsc.base.errors import InputError, Remark, counted, gathered, warning
from pgmp_petsc.base.units import behind
from pgmp_petsc.bench.prices import Prospect, choice, prospects
from pgmp_petsc.bodies.assembled import MassProperties
from pgmp_petsc.bodies.component import directors
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.bodies.shape import Shapes, at_lengths, given_properties
from pgmp_petsc.effects import AT_REST, Effect, Load, Patterns, actions_of, effects_of, loads_of, patterns_of, start_of
from pgmp_petsc.effects.clearance import impacts
from pgmp_petsc.effects.damping import check_ratios
from pgmp_petsc.effects.springs import spring_force
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities, foretold, why_no_grid
from pgmp_petsc.mechanism.closure import size_of
from pgmp_petsc.mechanism.constraint_set import null_space
from pgmp_petsc.mechanism.kinematics import MOST_FOLLOWED, RigidKinematics
from pgmp_petsc.mechanism.mechanism import Coordinate, Mechanism, constraint_jacobian
from pgmp_petsc.models import FullModel
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.bodies import IN_ORDER, MOMENTS
from pgmp_petsc.scene.references import parts_of, points_used
from pgmp_petsc.scene.units import in_own_units, own_units, to_own
from pgmp_petsc.scene.uses import length_names

if TYPE_CHECKING:
    from pgmp_petsc.components.condensing import Trial

BYTES = 8
ROUND_OFF = 1e-12  # of the largest moment of inertia
RELAXED = 1e-9  # rad, m or mm, that a spring without force is off by round-off
QUANTILES = np.array([0.2, 0.8])  # of what is drawn, at which a mechanism is put together
AWAY = 1e-3  # rad, or of the mechanism's size, from which on a start is elsewhere than bodies are placed


def describe_scene(scene: Scene, meshes: Shapes) -> str:
    """Return the report of ``pgmp check``; raises `InputError` if the mechanism cannot be closed or controlled, or
    points are missing."""
    check_capabilities(scene, Purpose.CHECK, meshes)
    mechanism = Mechanism.from_scene(scene, meshes)
    for framed in (framed for body in mechanism.bodies for framed in body.to_condense):
        from pgmp_petsc.components.condensing import check_slender  # few scenes have such bodies

        check_slender(scene, framed)
    kinematics = RigidKinematics(mechanism)
    if any(joint.offset is not None for joint in scene.joints.values()):
        FullModel(scene, meshes).require_taken()
    outputs = OutputSet.of(scene, kinematics)
    large = any(body.to_condense for body in mechanism.bodies)
    # how many loads there are takes no rows of large matrices
    matrices = AffineMatrices(mechanism.bodies, range(0 if large else mechanism.n_dofs))
    effects = effects_of(scene, mechanism)
    if not large:
        check_ratios(effects, mechanism.bodies, scene.nominal)
    loads, patterns = loads_of(effects, matrices), patterns_of(effects, matrices)
    n_patterns = patterns.wanted(scene.reduction).n
    coordinates = kinematics.coordinates
    pose = kinematics.poses([coordinate.lower for coordinate in coordinates])[..., 0]
    clamped = [coordinate for coordinate in coordinates if coordinate.prescribed]
    null = null_space(constraint_jacobian(mechanism, pose, clamped))
    released = kinematics.motion([coordinate.lower for coordinate in coordinates]).released.shape[-1]
    n_flexible = null.independent.size - (len(coordinates) - len(clamped)) - released
    left_open = scene.reduction.tolerance is not None and "modes" not in scene.reduction.model_fields_set
    flexible_bodies, no_grid = any(body.flexible for body in mechanism.bodies), ""
    if flexible_bodies and len(coordinates) > MOST_FOLLOWED:
        no_grid = why_no_grid(scene, mechanism)
    reducible = flexible_bodies and not no_grid
    if reducible and not left_open:
        scene = scene.with_entries(reduction=scene.reduction.fitting(n_flexible))
    lines = [
        f"scene {scene.name}",
        *_bodies(mechanism),
        *_matrices(scene, meshes),
        *_joints(mechanism, null.n_redundant, kinematics.n_redundant),
    ]
    for coordinate in coordinates:
        kind = ("periodic" if coordinate.periodic else "limited") + (", prescribed" if coordinate.prescribed else "")
        ends = f"{coordinate.shown(coordinate.lower):.6g} to {coordinate.text(coordinate.upper)}"
        lines.append(f"  coordinate    {coordinate.name}: {ends}, {kind}{_placed(scene, mechanism, coordinate)}")
    lines += _start(scene, effects, loads, kinematics)
    flexible = _flexible(scene, mechanism, n_patterns)
    if scene.reduction.modes == n_flexible:  # they answer every load
        flexible = {"modes": n_flexible}
    reduced = f"{len(coordinates)} rigid + {sum(flexible.values())} flexible reduced"
    if left_open:
        reduced = f"reduced as reduction.tolerance = {scene.reduction.tolerance:g} needs them (pgmp build)"
    if not flexible_bodies:
        reduced = "nothing to reduce: all bodies are rigid (pgmp simulate --full)"
    elif no_grid:
        reduced = f"not to be reduced over {len(coordinates)} coordinates (pgmp simulate --components or --full)"
    lines.append(f"  unknowns      {mechanism.n_dofs} nodal, {null.independent.size} without constraints, {reduced}")
    if len(flexible) > 1 and not left_open and reducible:
        lines.append(f"  basis         {', '.join(f'{count} {kind}' for kind, count in flexible.items())}")
    lines += _parameters(scene, mechanism)
    lines += _effects(scene, effects, loads)
    lines += [f"  clearance     {name}: {words}" for name, words in impacts(scene, mechanism)]
    lines += [f"  refused       {text}" for text in foretold(scene)]
    if flexible_bodies:
        models = _models(scene, meshes, mechanism, patterns)
        lines += [f"  model         {one.text}" for one in models]
        lines.append(f"  take          {choice(scene, meshes, models, scene.simulation.n_steps)}")
    lines += [f"  {remark}" for remark in (*kinematics.remarks, *_drawn(scene, meshes))]
    lines.append(
        f"  outputs       {', '.join(f'{n} ({scene.system.unit(u)})' for n, u in outputs.units.items()) or 'none'}"
    )
    if large:
        lines += _condensing(mechanism)
    elif not left_open and reducible:
        lines += _memory(scene, mechanism, matrices, len(loads), sum(flexible.values()))
    return "\n".join(lines)


@gathered
def _drawn(scene: Scene, meshes: Shapes) -> Iterator[Remark]:
    """Return a warning where a mechanism of drawn lengths, places or ratios cannot be put together."""
    given = ((name, scene.parameters[name]) for name in length_names(scene))
    drawn = {name: parameter.quantiles(QUANTILES) for name, parameter in given if parameter.distribution is not None}
    for values in zip(*drawn.values()):
        other = scene.with_values({name: float(value) for name, value in zip(drawn, values)})
        try:
            RigidKinematics(Mechanism.from_scene(other, at_lengths(other, meshes)))
        except InputError as error:
            at = ", ".join(f"{name} = {to_own(scene, name) * other.values[name]:.6g}" for name in drawn)
            yield warning(f"samples fail whose mechanism cannot be put together, as with {at}: {error}")
            return


def _models(scene: Scene, meshes: Shapes, mechanism: Mechanism, patterns: Patterns) -> list[Prospect]:
    flexible = _flexible(scene, mechanism, patterns.wanted(scene.reduction).n)
    return prospects(scene, meshes, mechanism, sum(flexible.values()), patterns.n)


def _bodies(mechanism: Mechanism) -> list[str]:
    lines, system = [], mechanism.scene.system
    for body in mechanism.bodies:
        if not body.flexible:
            weights = ", ".join(map(str, sorted(body.weights("mass"))))
            given = _given(mechanism.scene, body.name)
            said = "" if given is None else f", {_properties_text(given, mechanism.scene)}"
            lines.append(f"  body          {body.name}: rigid{said}, weights of its mass {weights}")
            continue
        stiffness = ", ".join(map(str, sorted(body.condensed_weights("stiffness"))))
        frames = ", ".join(f"{name} ({frame.nodes.size} nodes)" for name, frame in body.face_frames.items())
        frames = frames and f"; frames {frames}"
        lines.append(f"  body          {body.name}: {body.described(system)}, weights {stiffness}{frames}")
    return lines


def _matrices(scene: Scene, meshes: Shapes) -> list[str]:
    """Return the mass properties of bodies from matrices at factors of 1, and what their stiffness looks like."""
    lines = []
    for name, body in meshes.items():
        found = given_properties(body)
        if found is not None:
            lines += [
                f"  matrices      {name}: {_properties_text(found, scene)}",
                f"                {body.n_rigid} rigid-body motions without stiffness, waves along x at "
                f"{scene.system.text(body.wave_speed, 'm/s', '.4g')}; whether nothing else is free, and K positive, a "
                "build finds out",
            ]
            alike: dict[bool, list[str]] = {}
            for point, entry in points_used(scene, name).items():
                faces, _ = body.faces_of(scene.bodies[name].matrices.faces.get(point, point), entry)
                alike.setdefault(not len(faces), []).append(point)
            means = {False: "areas of faces", True: "nodes that count alike, as their faces are not known"}
            over = "; ".join(f"{', '.join(points)}: means over {means[key]}" for key, points in sorted(alike.items()))
            lines.append(f"                {over}")
    return lines


def _given(scene: Scene, name: str) -> MassProperties | None:
    """Return what a scene says of a rigid body with the parameters' values; None of other bodies."""
    rigid = scene.bodies[name].rigid if name in scene.bodies else None
    if rigid is None:
        return None
    tensor, d = rigid.tensor(scene.number), rigid.dimension
    second = directors(tensor) if d == 3 else 0.5 * tensor[0, 0] * np.eye(d)
    return MassProperties(scene.number(rigid.mass), rigid.places["centre"], second)


def _properties_text(found: MassProperties, scene: Scene) -> str:
    system = scene.system
    centre = ", ".join(f"{x:.6g}" for x in system.shown(found.centre, "m"))
    moments = system.shown(found.inertia[IN_ORDER] if len(found.inertia) > 1 else found.inertia[0], "kg m2")
    kept = np.where(np.abs(moments) > ROUND_OFF * np.abs(moments).max(), moments, 0.0)
    inertia = ", ".join(f"{x:.6g}" for x in kept)
    which = "" if len(found.inertia) == 1 else f" ({', '.join(MOMENTS)})"
    mass, metre, of_inertia = system.text(found.mass, "kg", ".6g"), system.unit("m"), system.unit("kg m2")
    return f"{mass}, centre of mass ({centre}) {metre}, inertia about it{which} {inertia} {of_inertia}"


def _joints(mechanism: Mechanism, n_redundant: int, n_rigid: int) -> list[str]:
    """Say how many constraints follow from the others; rigid bodies may not need some that flexible ones feel."""
    redundant = f", {n_redundant} of them redundant" if n_redundant else ""
    if n_rigid != n_redundant:
        redundant += f", {n_rigid} redundant for rigid bodies"
    names = ", ".join(one.name for one in mechanism.holders)
    lines = [f"  joints        {names}: {mechanism.n_constraints} constraints{redundant}"]
    for connection in mechanism.connections:
        if connection.released:
            n, how = counted(len(connection.released), "direction"), mechanism.scene.joints[connection.name].gives_way
            lines.append(
                f"  {how:12}  {connection.name}: gives way in {n} of {len(connection.statements)}, in the motion"
            )
    loose = [(one.name, mechanism.scene.joints[one.name].gives_way) for one in mechanism.couplings if one.elastic]
    lines += [f"  {how:12}  {name}: gives way in the motion" for name, how in loose]
    return lines


def _placed(scene: Scene, mechanism: Mechanism, coordinate: Coordinate) -> str:
    """Say where bodies are placed, if runs begin elsewhere and the scene does not say where."""
    if coordinate.name in scene.simulation.initial or coordinate.prescribed or scene.initial.equilibrium:
        return ""
    frames = (side.frame_of_pose(mechanism.first_guess) for side in coordinate.sides)
    placed = mechanism.space.measure(coordinate.statement, *frames)
    start = start_of(scene, mechanism)[0][mechanism.coordinates.index(coordinate)]
    away = placed - start
    away -= 2.0 * np.pi * np.rint(away / (2.0 * np.pi)) if coordinate.turns else 0.0
    if abs(away) < AWAY * coordinate.scale(size_of(mechanism)):
        return ""
    placed, start = coordinate.text(placed), coordinate.shown(start)
    return f"; placed at {placed}, runs start at {start:.6g} (simulation.initial.{coordinate.name}.position)"


def _parameters(scene: Scene, mechanism: Mechanism) -> list[str]:
    lines, units = [], own_units(scene)
    for name, parameter in in_own_units(scene).parameters.items():
        drawn = f", drawn from {parameter.distribution.text}" if parameter.distribution else ""
        lines.append(f"  parameter     {name} = {parameter.current:g}{behind(units[name])}{drawn}")
    mass, stiffness = (
        sorted({weight for body in mechanism.bodies for weight in body.condensed_weights(kind)})
        for kind in ("mass", "stiffness")
    )
    of_mass = f"{len(mass)} of mass ({', '.join(map(str, mass))})"
    lines.append(f"  affine terms  {of_mass}, {len(stiffness)} of stiffness ({', '.join(map(str, stiffness))})")
    return lines


def _effects(scene: Scene, effects: Sequence[Effect], loads: Sequence[Load]) -> list[str]:
    lines = [
        f"  controller    {name}: {one.type}, measures {', '.join(one.measured.values())}, acts in {one.joint}, "
        + (f"sampled every {one.sample_time:g} s" if one.sample_time else "continuous")
        for name, one in scene.controllers.items()
    ]
    if not scene.effects:
        return ["  effects       none", *lines]
    actions = actions_of(effects)
    for name, effect in scene.effects.items():
        counts = {
            "load term": sum(load.effect in parts_of(name, effect) for load in loads),
            "local force": sum(not one.leads and one.effect in parts_of(name, effect) for one in actions),
        }
        adds = [counted(n, what) for what, n in counts.items() if n]
        adds += [f"under the force that {effect.joint} carries, solved with each step"] if effect.by_load else []
        lines.append(f"  effect        {name}: {effect.type}, {', '.join(adds) or effect.adds}")
    return lines


def _start(scene: Scene, effects: Sequence[Effect], loads: Sequence[Load], kinematics: RigidKinematics) -> list[str]:
    """Say in which state runs start, where loads act on it; empty where bodies start undeformed and without loads."""
    mechanism = kinematics.mechanism
    theta, rates = start_of(scene, mechanism)
    if scene.initial.equilibrium:
        how = scene.initial.coordinates
        return [f"  start         static equilibrium under the loads at time zero, coordinates {how}"]
    if not any(body.flexible for body in mechanism.bodies):
        return []
    loaded, poses = {load.effect for load in loads}, kinematics.poses(theta)[..., 0]
    acting = {effect.name for effect in effects if effect.name in loaded and np.any(effect.amplitude(np.zeros(1)))}
    for action in actions_of(effects):
        if action.amplitude is not None:
            acts = np.any(action.amplitude(np.zeros(1)))
        else:
            force = spring_force(action, mechanism, poses, theta, scene.values) if action.stiffness else 0.0
            acts = force and abs(force) > RELAXED * action.stiffness.at(scene.values)
        acting |= {action.effect} if acts else set()
    names = ", ".join(name for name, effect in scene.effects.items() if not acting.isdisjoint(parts_of(name, effect)))
    if not names:
        return []
    cure = "where the mechanism is held or driven, initial.equilibrium = true starts with it"
    if scene.loose or np.abs(rates).max(initial=0.0) * scene.simulation.duration > AT_REST:
        cure = "let loads grow from zero" + ", or begin at rest, in equilibrium" * (not scene.loose)
    return [
        f"  start         undeformed, with {names} acting at once: bodies swing about their static deformation, up to "
        f"twice as far; {cure}"
    ]


def _flexible(scene: Scene, mechanism: Mechanism, n_patterns: int) -> dict[str, int]:
    """Return the vectors of the basis by their kind; loads that depend on others are not told apart."""
    reduction, n_theta = scene.reduction, len(mechanism.coordinates)
    n_accelerations = n_theta * (n_theta + 1) // 2 + sum(coordinate.prescribed for coordinate in mechanism.coordinates)
    counts = {
        "modes": reduction.modes,
        "static": n_patterns,
        "inertia": n_accelerations if reduction.inertia_modes else 0,
        "of other parameter values": reduction.parameter_modes,
    }
    return {kind: count for kind, count in counts.items() if count}


def _memory(scene: Scene, mechanism: Mechanism, matrices, n_loads: int, n_flexible: int) -> list[str]:
    n_theta = len(mechanism.coordinates)
    n_modes, n_angles = n_flexible, scene.reduction.angles**n_theta
    n_eta = n_modes + n_theta
    terms = [*matrices.mass.values(), *matrices.stiffness.values()]
    sparse = sum(term.data.nbytes + term.indices.nbytes + term.indptr.nbytes for term in terms)
    n_mass, n_stiffness = len(mechanism.mass_weights), len(mechanism.stiffness_weights)
    tables = (
        n_angles * (n_mass * (n_eta**2 + n_theta**2 * n_modes) + n_stiffness * n_modes**2 + n_loads * n_eta) * BYTES
    )
    projection = n_angles * mechanism.n_dofs * n_modes * BYTES
    if scene.second_order:
        tables += n_angles * (n_stiffness * n_modes**3 + (3 * n_mass + n_loads) * n_modes**2) * BYTES
        projection += n_angles * mechanism.n_dofs * n_modes * (n_modes + 1) // 2 * BYTES
    return [
        f"  memory        sparse matrices {_size(sparse)}, reduced tables {_size(tables)}, "
        f"modes at {n_angles} {'angles' if n_theta == 1 else 'configurations'} {_size(projection)}"
    ]


def describe_trial(trial: Trial) -> str:
    """Return what a trial solve says of a build."""
    return (
        f"  trial         {trial.body}, {trial.n_dofs} unknowns: assembly {trial.assembly:.3g} s, factorisation "
        f"{trial.factorisation:.3g} s, solve {trial.solve:.3g} s\n"
        f"  build         about {trial.seconds:.2g} s for condensing the bodies, {_size(trial.memory)} on all ranks; "
        "configurations and tables take little more"
    )


def _condensing(mechanism: Mechanism) -> list[str]:
    solids = [framed.solid for body in mechanism.bodies for framed in body.to_condense]
    entries = sum(solid.n_entries for solid in solids)
    largest = max(solids, key=lambda solid: solid.n_dofs)
    return [
        f"  memory        sparse matrices about {_size(entries * (BYTES + 4) * 2)}, factors more (--trial "
        f"measures them); {largest.name} has {largest.n_dofs} unknowns"
    ]


def _size(n_bytes: float) -> str:
    for unit in ("B", "kB", "MB"):
        if n_bytes < 1000:
            return f"{n_bytes:.3g} {unit}"
        n_bytes /= 1000
    return f"{n_bytes:.3g} GB"


def summary_of_scene(scene: Scene, meshes: Shapes) -> dict[str, Any]:
    """Return bodies, joints, coordinates, parameters, effects, outputs and remarks by their names, counts, and which
    model to take."""
    mechanism = Mechanism.from_scene(scene, meshes)
    kinematics, large = RigidKinematics(mechanism), any(body.to_condense for body in mechanism.bodies)
    matrices = AffineMatrices(mechanism.bodies, range(0 if large else mechanism.n_dofs))
    models, effects = [], effects_of(scene, mechanism)
    if any(body.flexible for body in mechanism.bodies):
        models = _models(scene, meshes, mechanism, patterns_of(effects, matrices))
    return {
        "scene": scene.name,
        "dimension": scene.dimension,
        "bodies": {body.name: _body(scene, body, meshes) for body in mechanism.bodies},
        "joints": {name: {"type": joint.type, "connect": list(joint.connect)} for name, joint in scene.joints.items()},
        "coordinates": {
            coordinate.name: {
                "unit": scene.system.unit(coordinate.unit),
                "range": [coordinate.shown(coordinate.lower), coordinate.shown(coordinate.upper)],
                "periodic": coordinate.periodic,
                "prescribed": coordinate.prescribed,
            }
            for coordinate in mechanism.coordinates
        },
        "parameters": {
            name: {
                "value": parameter.current,
                "unit": parameter.unit,
                "distribution": None if parameter.distribution is None else parameter.distribution.name,
            }
            for name, parameter in in_own_units(scene).parameters.items()
        },
        "effects": {name: effect.type for name, effect in scene.effects.items()},
        "controllers": {name: one.type for name, one in scene.controllers.items()},
        "outputs": {
            name: {"unit": scene.system.unit(unit)} for name, unit in OutputSet.of(scene, kinematics).units.items()
        },
        "unknowns": mechanism.n_dofs,
        "constraints": mechanism.n_constraints,
        "models": {one.model: asdict(one) for one in models},
        "take": choice(scene, meshes, models, scene.simulation.n_steps) if models else "",
        "remarks": [asdict(remark) for remark in (*scene.remarks, *_drawn(scene, meshes))],
    }


def _body(scene: Scene, body, meshes: Shapes) -> dict[str, Any]:
    """Return what kind of body it is and how large; mass (kg), centre of mass (m) and inertia about it (kg m2) of one
    that is given by them, or from matrices, at factors of 1."""
    kind = scene.bodies[body.name].kind if body.name in scene.bodies else "point mass"
    own = {"element": kind, "flexible": body.flexible, **dict(zip(("nodes", "cells"), body.size))}
    found = _given(scene, body.name) or given_properties(meshes.get(body.name))
    given = () if found is None else ((found.mass, "kg"), (found.centre, "m"), (found.inertia, "kg m2"))
    shown = (np.asarray(scene.system.shown(value, unit)).tolist() for value, unit in given)
    return own | dict(zip(("mass", "centre", "inertia"), shown))
