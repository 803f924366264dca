"""Checks across tables: names that entries refer to exist and are of the right kind, and values fit the others and
where the mechanism moves: the plane, or space where bodies are beam3d or solid3d. Places on a mesh are checked where
there is a mesh.

Loads whose values over time name parameters are several loads. A function of time whose values are numbers or
parameters is affine in the parameters,

    f(t, p) = f_0(t) + sum_k p_k f_k(t),

where f_0 has the numbers with zeros in place of the names, and f_k ones where p_k is named and zeros elsewhere. Each
is a load of its own with a function that holds numbers alone, and p_k for its `scale`: what models, samples and
derivatives know of loads holds for it as it is.

Of the impulse of a table over time the integrator sees the trapezoidal rule on its steps. A table is linear between its
rows, so that the rule is exact in every step without a row inside: whatever the number of steps, only those with rows
are looked at.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pgmp_petsc.base.errors import nearest_name, shortened
from pgmp_petsc.declare.ideas import JOINTS
from pgmp_petsc.scene.effects import Driving, EffectEntry, OverTime
from pgmp_petsc.scene.fields import GROUND, AnyScene, Table, points_of, split_point, with_values
from pgmp_petsc.scene.joints import MEASURED, WHERE, CouplingEntry, JointEntry
from pgmp_petsc.scene.messages import COMPONENTS, MAX_RECEIVED, problem, unknown
from pgmp_petsc.scene.outputs import OF_FIBRES, STRESSES, OutputEntry, circle_of
from pgmp_petsc.scene.uses import motion_over, ordered_ends, slides, uses_of

if TYPE_CHECKING:
    from pgmp_petsc.scene.bodies import Rigid
    from pgmp_petsc.scene.joints import Coordinate


LOST_IMPULSE = 0.01  # share of an impulse that steps may miss
STEPS_A_PERIOD = 8  # fewest steps in a period of a harmonic


def _effects(scene: AnyScene) -> Iterator[str]:
    """Yield one line for each entry of an effect that does not fit."""
    for name, effect in scene.effects.items():
        yield from _place_problems(scene, f"effects.{name}", effect)
        yield from effect.problems(scene, name)
        if effect.single:
            others = [other for other, rival in scene.effects.items() if type(rival) is type(effect)]
            if name != others[0]:
                yield problem(f"effects.{name}", f"effects.{others[0]} is of the same type; a scene has one at most")


def _ordered(scene: AnyScene) -> Iterator[str]:
    """Yield one line for each entry that is not below the one that it has to be below."""
    for ends in ordered_ends(scene):
        if any(isinstance(end, str) and end not in scene.parameters for end in (ends.lower, ends.upper)):
            continue  # said elsewhere
        for values in (scene.nominal, scene.values):
            low, high = ends.at(scene, values)
            if not low < high:
                behind = f", not {low:g}" if isinstance(ends.lower, str) else ""
                yield problem(ends.entry, f"must be below {ends.other} = {high:g}{behind}", ends.lower)
                break


def _place_problems(scene: AnyScene, entry: str, table: EffectEntry | OutputEntry) -> Iterator[str]:
    """Yield a line for each joint and point that an effect or an output is at, and its axis, that there is not."""
    if table.joints and table.joint is not None:
        yield from joint_problems(scene, f"{entry}.joint", table.joint, table.joints)
        yield from motion_problems(scene, entry, table, table.joints)
    elif table.joints and getattr(table, "motion", None) is not None:
        yield problem(f"{entry}.motion", "without effect, as no joint is named; leave it out", table.motion)
    for key in points_of(type(table)):
        where, given = f"{entry}.{key}", points_in(table, key)
        if key == "points" and given:
            yield from points_problems(scene, where, given)
            continue
        for point in given:
            yield from point_problems(scene, where, point, ground_allowed=key != "point")
    if scene.dimension == 2 and getattr(table, "axis", None) == "z":
        yield problem(f"{entry}.axis", "x or y is needed in the plane", "z")


def joint_problems(scene: AnyScene, entry: str, joint: str, motions: tuple[str, ...] = MEASURED) -> Iterator[str]:
    """Yield a line if there is no such joint, or it is of a kind that leaves none of these motions free."""

    def leaves(kind: Any) -> bool:
        return scene.dimension in kind.dimensions and not {*motions}.isdisjoint(kind.motions_in(scene.dimension))

    if joint in scene.joints and leaves(scene.joints[joint]):
        return
    allowed = tuple(filter(leaves, JOINTS.found()))
    fitting = [name for name, candidate in scene.joints.items() if leaves(candidate)]
    *others, last = (kind.model_fields["type"].annotation.__args__[0] for kind in allowed)
    named = f"{', '.join(others)} or {last}" if others else last
    if joint not in scene.joints:
        yield unknown(entry, f"{named} joint", joint, fitting)
    elif joint not in fitting:
        allowed_ones = f"(allowed: {', '.join(fitting) or 'none is defined'})"
        found = f"a {named} joint is needed, this one is a {scene.joints[joint].type} {allowed_ones}"
        yield problem(entry, found, joint)


def over_problems(scene: AnyScene, entry: str, effect: Any) -> Iterator[str]:
    """Yield a line if there is no such joint as an effect hangs on, or its motion is none of it or not said."""
    if effect.over is None:
        if effect.over_motion is not None:
            yield problem(f"{entry}.over_motion", "needs over, the joint that has it", effect.over_motion)
        return
    known = list(joint_problems(scene, f"{entry}.over", effect.over))
    motion = motion_over(scene, effect)
    yield from known or _not_free(scene, f"{entry}.over_motion", effect.over, MEASURED, motion, motion is None)


def _not_free(
    scene: AnyScene, entry: str, name: str, allowed: Sequence[str], motion: str | None, is_missing: bool
) -> Iterator[str]:
    """Yield a line if a motion is missing, or none of the allowed ones that a joint leaves free."""
    joint = scene.joints[name]
    free = [one for one in joint.motions_in(scene.dimension) if one in allowed]
    needed = " or ".join(f'"{one}"' for one in free)
    if is_missing:
        yield problem(entry, f"missing; {name} is {joint.type}: {needed} is needed")
    elif motion is not None and free and motion not in free:
        yield problem(entry, f"{name} is {joint.type}: allowed is {needed}", motion)


def motion_problems(
    scene: AnyScene, entry: str, on_joint: Any, allowed: tuple[str, ...] = MEASURED, all_said: bool = False
) -> Iterator[str]:
    """Yield a line if the motion of a joint with several is not said, or one that it has not is.

    With `all_said` that of a joint is to be said too that has another one in the plane alone.
    """
    joint, motion = scene.joints.get(on_joint.joint), getattr(on_joint, "motion", None)
    if joint is None or "motion" not in type(on_joint).model_fields:
        return
    several = sum(one in allowed for one in joint.motions_in(scene.dimension)) > 1
    is_missing = motion is None and several and (all_said or joint.motion_of(None, allowed, scene.dimension) is None)
    yield from _not_free(scene, f"{entry}.motion", on_joint.joint, allowed, motion, is_missing)


def point_problems(scene: AnyScene, entry: str, point: str, ground_allowed: bool) -> Iterator[str]:
    """Check the owner of a point, and the point if on the ground; only its mesh knows a body's points."""
    owner, name = split_point(point)
    if owner == GROUND and not ground_allowed:
        yield problem(entry, "a point of a body is needed; the ground does not move", point)
    elif owner == GROUND:
        if name not in scene.ground.positions:
            yield unknown(entry, "ground point", point, [f"ground:{known}" for known in scene.ground.positions])
    elif owner not in scene.bodies:
        known = [*scene.bodies, GROUND] if ground_allowed else scene.bodies
        yield problem(entry, f"there is no body '{shortened(owner, MAX_RECEIVED)}'{nearest_name(owner, known)}", point)
    elif (rigid := scene.bodies[owner].rigid) is not None and name not in rigid.places:
        yield unknown(entry, "point", point, [f"{owner}:{known}" for known in rigid.places])


def points_problems(scene: AnyScene, entry: str, points: tuple[str, str]) -> Iterator[str]:
    """Yield a line for each of two points that there is not, and if their distance cannot change."""
    for point in points:
        yield from point_problems(scene, entry, point, True)
    yield from apart_problems(scene, entry, points)


def apart_problems(scene: AnyScene, entry: str, points: tuple[str, str]) -> Iterator[str]:
    """Check that the distance of two points can change."""
    owners = [split_point(point)[0] for point in points]
    body = scene.bodies.get(owners[0])
    if points[0] == points[1]:
        yield problem(entry, "two different points are needed", list(points))
    elif owners == [GROUND, GROUND]:
        yield problem(entry, "a point of a body is needed; the ground does not move", list(points))
    elif owners[0] == owners[1] and body is not None and not body.flexible:
        yield problem(entry, f"{owners[0]} is rigid; the distance of its points does not change", list(points))


def load_problems(scene: AnyScene, name: str, effect: OverTime) -> Iterator[str]:
    """Yield a line for each part of a load that steps do not resolve; harmonics have one frequency, told once."""
    check = _impulse_problems if effect.harmonic is None else harmonic_problems
    parts = parts_of(name, effect).values()
    yield from dict.fromkeys(line for part in parts for line in check(scene, f"effects.{name}", part))


def harmonic_problems(scene: AnyScene, entry: str, effect: OverTime | Driving) -> Iterator[str]:
    """Yield a line if steps are too few in a period: the integrator sees values at the ends of steps."""
    run = scene.simulation
    if run.tolerance is None and run.step * effect.harmonic.frequency_hz * STEPS_A_PERIOD > 1.0:
        yield problem(
            f"{entry}.harmonic.frequency_hz",
            f"needs a simulation.step of at most {1.0 / (STEPS_A_PERIOD * effect.harmonic.frequency_hz):.3g} s, "
            f"{STEPS_A_PERIOD} a period; it is {run.step:g} s",
            effect.harmonic.frequency_hz,
        )


def _impulse_problems(scene: AnyScene, entry: str, effect: OverTime) -> Iterator[str]:
    run = scene.simulation
    if run.tolerance is not None:
        return  # the step is not known yet
    found = impulse_of(effect.table, run.duration, run.n_steps)
    # what sets in within a step is seen half a step early or late; that is as it should be
    tolerated = max(LOST_IMPULSE * found.whole, 0.5 * run.step * found.largest)
    if abs(found.seen - found.exact) > tolerated:
        yield problem(
            f"{entry}.table",
            f"has an impulse of {found.exact:.4g} {effect.strength_unit} s, but {found.seen:.4g} with a {effect.type} "
            f"read every {run.step:g} s; take a smaller simulation.step, or a pulse that lasts several steps",
        )


def parts_of(name: str, effect: EffectEntry) -> dict[str, EffectEntry]:
    """Return the loads that an effect is made of; any other effect as it is.

    Several are named after the effect and their parameters, ``NAME_PARAMETER``; the one of numbers has the effect's
    name, and so has one that is alone.
    """
    if not isinstance(effect, OverTime) or not effect.parameters_over_time:
        return {name: effect}
    has_numbers = any(value for _, value in effect.values_over_time if not isinstance(value, str))
    parts: dict[str, EffectEntry] = {name: _part(effect, None)} if has_numbers else {}
    parts |= {f"{name}_{parameter}": _part(effect, parameter) for parameter in effect.parameters_over_time}
    return parts if len(parts) > 1 else {name: next(iter(parts.values()))}


def part_problems(scene: AnyScene) -> Iterator[str]:
    """Yield a line for each effect that has the name of a part of another one."""
    for name, effect in scene.effects.items():
        for part in parts_of(name, effect):
            if part != name and part in scene.effects:
                yield problem(f"effects.{part}", f"a part of effects.{name} has this name; give it another one")


def _part(effect: OverTime, parameter: str | None) -> OverTime:
    def value_of(value: float | str) -> float:
        if parameter is None:
            return 0.0 if isinstance(value, str) else value
        return effect.scale if value == parameter else 0.0

    changed = with_values(effect, value_of)
    return changed if parameter is None else changed.model_copy(update={"scale": parameter})


@dataclass(frozen=True)
class Impulse:
    """Integrals of a table over a run, in its unit times s: of itself, of its values at the ends of steps by the
    trapezoidal rule, and of its magnitude; the largest magnitude at the end of a step, in the table's unit."""

    exact: float
    seen: float
    whole: float
    largest: float


def impulse_of(table: Sequence[tuple[float, float]], duration: float, n_steps: int) -> Impulse:
    """Return the impulse of a table of rows (time, value) over a run of `n_steps` equal steps.

    Takes time and memory by the number of rows, not of steps.
    """
    times, values = np.array(table, dtype=float).T
    step = duration / n_steps
    inside = times[(times > 0.0) & (times < duration)]
    first = np.clip(np.floor(inside / step), 0, n_steps - 1)  # the step that a row is in
    ends = np.unique(np.concatenate([[0.0, duration], first * step, np.minimum((first + 1) * step, duration)]))
    knots = np.union1d(ends, inside)

    at_knots, at_ends = np.interp(knots, times, values), np.interp(ends, times, values)
    exact, seen = _trapezoid(at_knots, knots), _trapezoid(at_ends, ends)
    # the magnitude of what is linear between knots: two triangles where the sign changes
    a, b = at_knots[:-1], at_knots[1:]
    turns, total = a * b < 0.0, np.abs(a) + np.abs(b)
    share = np.where(turns, (a * a + b * b) / np.where(turns, total, 1.0), total)
    return Impulse(exact, seen, float(0.5 * np.sum(share * np.diff(knots))), float(np.max(np.abs(at_ends))))


def _trapezoid(values: np.ndarray, at: np.ndarray) -> float:
    return float(0.5 * np.sum((values[1:] + values[:-1]) * np.diff(at)))


PLACES = ("at", "group", "region")


def stressed_bodies(scene: AnyScene) -> set[str]:
    """Return the names of the bodies that stress outputs name."""
    return {output.body for output in scene.outputs.values() if "stresses" in output.reads}


def stress_problems(scene: AnyScene, name: str, output: OutputEntry) -> Iterator[str]:
    """Yield one line for each entry of a stress output that does not fit the body it names."""
    entry = f"outputs.{name}"
    if output.body not in scene.bodies:
        yield unknown(f"{entry}.body", "body", output.body, scene.bodies)
        return
    body = scene.bodies[output.body]
    if not body.flexible:
        why = "this body is rigid, so nothing is known of its stresses; take a flexible body, or make it flexible"
        yield problem(f"{entry}.body", why, output.body)
        return
    if body.section_scale is not None:
        why = f"a body with section_scale has no stress outputs; leave bodies.{output.body}.section_scale out"
        yield problem(f"{entry}.body", why, output.body)
    if body.matrices is not None:
        why = f"matrices do not tell stresses from displacements; give bodies.{output.body} a mesh, or leave it out"
        yield problem(f"{entry}.body", why, output.body)
        return
    allowed = STRESSES[body.element]
    if output.quantity not in allowed:
        why = f"a {body.element} has no such quantity; allowed: {', '.join(allowed)}"
        yield problem(f"{entry}.quantity", why, output.quantity)
    elif output.quantity in OF_FIBRES and body.material is None:
        forces = ", ".join(name for name in allowed if name not in OF_FIBRES)
        why = f"a section given by coefficients has no outermost fibre; allowed: {forces}"
        yield problem(f"{entry}.quantity", why, output.quantity)
    given = [key for key in PLACES if getattr(output, key) is not None]
    if len(given) > 1:
        why = f"at most one of {', '.join(PLACES)} is needed; {' and '.join(given)} are given"
        yield problem(f"{entry}.{given[-1]}", why)
    if output.at is not None and len(output.at) != body.dimension:
        words = "two numbers (x, y)" if body.dimension == 2 else "three numbers (x, y, z)"
        yield problem(f"{entry}.at", f"{words} are needed for a {body.element}", list(output.at))
    if output.region is not None and not body.continuum:
        why = f"a {body.element} has no regions; take at or group, or leave it out for the whole body"
        yield problem(f"{entry}.region", why, output.region)


def points_in(table: Table, key: str) -> tuple[str, ...]:
    """Return the points of an entry that is a point, or several; empty where it is left out."""
    value = getattr(table, key)
    return (value,) if isinstance(value, str) else tuple(value or ())


def points_used(scene: AnyScene, body: str) -> dict[str, str]:
    """Return the points of a body that the scene names, each with the entry that names it first."""
    found: dict[str, str] = {}
    for table in ("joints", "coordinates", "effects", "outputs"):
        for name, entry in getattr(scene, table).items():
            for key in points_of(type(entry)):
                for address in points_in(entry, key):
                    owner, point = split_point(address)
                    if owner == body:
                        found.setdefault(point, f"{table}.{name}.{key}")
    return found


MOST_RADIANS_OF_RANGE = 100.0  # 5,000 configurations to be assembled one after the other: some seconds
DEGREES, FEW_TURNS = 5.0, 25.0  # angles in degrees are multiples of 5 as a rule; rad that nobody gives as such a range


def reference_problems(scene: AnyScene) -> Iterator[str]:
    """Yield one line for each entry that does not fit the others."""
    checks = (_bodies, _joints, _coordinates, _effects, _ordered, _outputs, _names_of_results, _initial_states)
    for check in (*checks, _parameter_uses, _vectors, _of_one_space):
        yield from check(scene)


def _bodies(scene: AnyScene) -> Iterator[str]:
    connected = {split_point(point)[0] for joint in scene.joints.values() for point in joint.connect}
    for name, body in scene.bodies.items():
        if name not in connected:
            yield problem(f"bodies.{name}", "no joint connects it with the mechanism; add one, or leave the body out")
        if name == GROUND:
            yield problem("bodies.ground", "this name means the points fixed in space; give the body another one")
        if body.rigid is not None:
            yield from _mass_properties(scene, f"bodies.{name}.rigid", body.rigid)
        if body.material is not None and body.material not in scene.materials:
            yield unknown(f"bodies.{name}.material", "material", body.material, scene.materials)
        for region, material in body.regions.items():
            if material not in scene.materials:
                yield unknown(f"bodies.{name}.regions.{region}", "material", material, scene.materials)


def _mass_properties(scene: AnyScene, entry: str, rigid: Rigid) -> Iterator[str]:
    """Yield a line if no body has such an inertia, nominally or in a single run, or its centre is said twice."""
    if "centre" in rigid.points:
        words = f"this point is the centre of mass; give its place as {entry}.centre"
        yield problem(f"{entry}.points.centre", words, list(rigid.points["centre"]))
    moments = rigid.moments.values()
    if rigid.dimension == 2 or any(isinstance(moment, str) and moment not in scene.parameters for moment in moments):
        return  # said elsewhere
    for values in (scene.nominal, scene.values):
        why = rigid.unlike_mass(lambda moment, values=values: scene.number(moment, values))
        if why:
            yield problem(f"{entry}.inertia", why, list(rigid.inertia))
            break


def _joints(scene: AnyScene) -> Iterator[str]:
    for name, joint in scene.joints.items():
        entry = f"joints.{name}.connect"
        owners = [split_point(point)[0] for point in joint.connect]
        for point in joint.connect:
            yield from point_problems(scene, entry, point, ground_allowed=True)
        if owners and owners[0] == owners[1]:
            words = "a joint connects two different bodies, or a body and the ground; both points are on"
            yield problem(entry, f"{words} {owners[0]}", joint.connect)
        if scene.dimension not in joint.dimensions:
            alike = JointEntry if isinstance(joint, JointEntry) else CouplingEntry
            found = {one: kind for one, kind in zip(JOINTS.names, JOINTS.found()) if issubclass(kind, alike)}
            kinds = ", ".join(one for one, kind in found.items() if scene.dimension in kind.dimensions)
            words = f"for mechanisms {WHERE[5 - scene.dimension]} (allowed {WHERE[scene.dimension]}: {kinds})"
            yield problem(f"joints.{name}.type", words, joint.type)
        else:
            yield from joint.problems(scene, name)
            if joint.offset is not None:
                yield from joint.offset.problems(scene.dimension, f"joints.{name}.offset")
            if joint.elastic is not None and isinstance(joint, JointEntry):
                yield from joint.elastic.problems(scene.dimension, f"joints.{name}.elastic")
            if joint.clearance is not None:
                yield from _loose(scene, name, joint)
            for kind in ("effects", "controllers") if joint.gives_way else ():
                if name in getattr(scene, kind):
                    words = f"joints.{name} has {joint.gives_way}, and its forces have this name; take another one"
                    yield problem(f"{kind}.{name}", words)


def _loose(scene: AnyScene, name: str, joint: JointEntry) -> Iterator[str]:
    """Yield a line for what does not fit a joint with a clearance."""
    entry = f"joints.{name}.clearance"
    if not joint.loose:
        able = (
            one for one, kind in zip(JOINTS.names, JOINTS.found()) if kind.loose and scene.dimension in kind.dimensions
        )
        yield problem(entry, f"a joint of type {joint.type} has none; those that have are {', '.join(able)}")
        return
    for other in ("elastic", "offset"):
        if getattr(joint, other) is not None:
            words = f"a joint has {other} or clearance, not both: let a body between two joints have the other one"
            yield problem(f"joints.{name}.{other}", words)
    yield from joint.clearance.problems(scene, entry)
    if joint.loose == "everywhere" and joint.clearance.friction:
        words = f"made for pins and guides, and this joint is {joint.type}, of which it hangs on how large the ball is"
        yield problem(f"{entry}.friction", f"{words}; leave it out", joint.clearance.friction)


def _coordinates(scene: AnyScene) -> Iterator[str]:
    taken: dict[tuple[str, bool], str] = {}
    for name, coordinate in scene.coordinates.items():
        low, high = coordinate.range
        if coordinate.points is not None:
            found = list(points_problems(scene, f"coordinates.{name}.points", coordinate.points))
        else:
            found = list(_joint_of_coordinate(scene, name, coordinate, taken))
        yield from found
        if slides(scene, coordinate):
            if coordinate.periodic and not found:
                yield problem(f"coordinates.{name}.periodic", "for angles; what slides has two ends", True)
            elif coordinate.points is not None and low <= 0.0:
                words = "a distance is positive, and has no direction where it is zero"
                yield problem(f"coordinates.{name}.range", words, list(coordinate.range))
            continue
        turns, why = f"{(high - low) / (2 * math.pi):.4g} turns", ""
        if high - low >= FEW_TURNS and low % DEGREES == 0.0 == high % DEGREES:
            inside = ", ".join(f"{math.radians(end):.5g}" for end in (low, high))
            least = high - low - 0.1  # rad, of a range that ends a tenth beside; it may start at its lower end
            meant = f"if these are meant, end it beside a multiple of {DEGREES:g}: [{low:g}, {high - 0.1:g}]"
            other = meant if least <= MOST_RADIANS_OF_RANGE else f"take {MOST_RADIANS_OF_RANGE:g} rad at most"
            why = f"looks like degrees: it is in rad, and {turns} long; write [{inside}], or {other}"
        elif high - low > MOST_RADIANS_OF_RANGE:
            most = f"at most {MOST_RADIANS_OF_RANGE:g} rad are taken"
            why = f"is {turns} long, and each is followed in small steps; {most}"
        if why:
            cure = f"What turns for ever has range = [0.0, {2 * math.pi!r}] and periodic = true"
            yield problem(f"coordinates.{name}.range", f"{why}. {cure}", list(coordinate.range))


def _joint_of_coordinate(
    scene: AnyScene, name: str, coordinate: Coordinate, taken: dict[tuple[str, bool], str]
) -> Iterator[str]:
    """Yield a line if a coordinate's joint does not have its motion, or another one has the same."""
    entry, key = f"coordinates.{name}", (coordinate.joint, slides(scene, coordinate))
    yield from joint_problems(scene, f"{entry}.joint", coordinate.joint)
    yield from motion_problems(scene, entry, coordinate, all_said=True)
    if key in taken:
        words = f"coordinates.{taken[key]} has the same joint and motion; each motion may serve one coordinate"
        yield problem(f"{entry}.joint", words, coordinate.joint)
    taken.setdefault(key, name)


#: What tables and datasets of results have under names of their own.
_OWN = {"time": "instants", "sample": "the numbers of samples", "status": "what became of samples"}


def _names_of_results(scene: AnyScene) -> Iterator[str]:
    tables = {"outputs": scene.outputs, "parameters": scene.parameters}
    for kind, table in (tables | {"ensemble.probabilities": scene.ensemble.probabilities}).items():
        for name in [one for one in _OWN if one in table]:
            yield problem(f"{kind}.{name}", f"results keep {_OWN[name]} under this name; take another one")


def _outputs(scene: AnyScene) -> Iterator[str]:
    for name, output in scene.outputs.items():
        if name in scene.parameters:
            yield problem(f"outputs.{name}", "a parameter has the same name; give the output another one")
        yield from _place_problems(scene, f"outputs.{name}", output)
        for other, key in output.made_in(scene).items():
            if other not in scene.outputs:
                yield unknown(f"outputs.{name}.{key}", "output", other, [one for one in scene.outputs if one != name])
            elif scene.outputs[other].is_counted:
                words = f"{other} is counted over the run, and an output is made of what is known at an instant"
                yield problem(f"outputs.{name}.{key}", f"{words}; name what {other} is of", getattr(output, key))
        circle = circle_of(scene, name)
        if circle:
            key, *_ = output.made_in(scene).values()
            words = f"a circle: {' is made of '.join(circle)}; let one of them be of something else"
            yield problem(f"outputs.{name}.{key}", words, getattr(output, key))
        yield from output.problems(scene, name) if not circle else ()


def _initial_states(scene: AnyScene) -> Iterator[str]:
    for name, state in scene.simulation.initial.items():
        if name not in scene.coordinates:
            what = f"there is no such coordinate{nearest_name(name, scene.coordinates)}"
            yield problem(f"simulation.initial.{name}", what)
        if scene.initial.equilibrium and state.velocity != 0.0:
            yield problem(
                f"simulation.initial.{name}.velocity",
                "with initial.equilibrium = true a run starts at rest, where nothing turns; leave the velocity out and "
                "run the coordinate up (effects of type prescribed_motion, spin_up), or leave the equilibrium out",
                state.velocity,
            )
    for name, coordinate in scene.coordinates.items():
        (low, high), position = coordinate.range, scene.initial_state(name).position
        if name not in scene.driven and not (coordinate.periodic or low <= position <= high):
            given = "" if name in scene.simulation.initial else "; a start that is not given is at zero"
            words = f"must lie in the coordinate's range [{low}, {high}]{given}"
            yield problem(f"simulation.initial.{name}.position", words, position)


#: What numbers must be, by their sign, and which ones are not.
SIGNS = {
    "positive": ("must be positive", lambda number: number <= 0.0),
    "not negative": ("must not be negative", lambda number: number < 0.0),
    "not zero": ("must not be 0", lambda number: number == 0.0),
    "any": ("", lambda number: False),
}


def _parameter_uses(scene: AnyScene) -> Iterator[str]:
    for use in uses_of(scene):
        parameter, (must, is_wrong) = scene.parameters.get(use.parameter), SIGNS[use.sign]
        if use.parameter is not None and parameter is None:
            yield unknown(use.entry, "parameter", use.parameter, scene.parameters)
        for key in ("nominal", "value") if parameter is not None else ():
            number = getattr(parameter, key)
            if number is not None and is_wrong(number):
                yield problem(f"parameters.{use.parameter}.{key}", f"{must}, because {use.entry} uses it", number)


def _vectors(scene: AnyScene) -> Iterator[str]:
    """Yield points and directions with the wrong number of components."""
    n = scene.dimension
    entries = {f"ground.points.{name}": point for name, point in scene.ground.points.items() if any(point)}
    for name, body in scene.bodies.items():
        if body.placement is not None and any(body.placement.origin):
            entries[f"bodies.{name}.placement.origin"] = body.placement.origin
        if body.rigid is not None:
            entries |= {f"bodies.{name}.rigid.points.{point}": place for point, place in body.rigid.points.items()}
            if body.rigid.centre is not None:
                entries[f"bodies.{name}.rigid.centre"] = body.rigid.centre
    for table in ("joints", "effects"):
        for name, entry in getattr(scene, table).items():
            direction = getattr(entry, "direction", None)
            if direction is not None and "direction" in entry.model_fields_set:
                entries[f"{table}.{name}.direction"] = direction
    for entry, value in entries.items():
        if len(value) != n:
            yield problem(entry, COMPONENTS[n], list(value))


def _of_one_space(scene: AnyScene) -> Iterator[str]:
    in_plane = scene.dimension == 2
    turned, cure = (
        ("rotation", "mechanisms in space; give angle") if in_plane else ("angle", "the plane; give rotation")
    )
    for name, body in scene.bodies.items():
        if body.dimension < scene.dimension:
            others = ", ".join(f"{one} ({entry.kind})" for one, entry in scene.bodies.items() if entry.dimension == 3)
            if body.rigid is not None:
                words = f"is one number, for the plane, but {others} in space; there it has six entries"
                yield problem(f"bodies.{name}.rigid.inertia", words, body.rigid.inertia)
                continue
            words = f"in the plane, but {others} in space; all bodies are beam2d and solid2d, or beam3d and solid3d"
            yield problem(f"bodies.{name}.element", words, body.element)
        if given := getattr(body.placement, turned, None):
            yield problem(f"bodies.{name}.placement.{turned}", f"for {cure}", given)
