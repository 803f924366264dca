"""Checks of effects against the rest of a scene: joints and points of the right kind, mutually exclusive effects.

Loads whose values over time name parameters, as several loads: numbers, and one for each parameter.

A function of time whose values are numbers or parameters is affine in the parameters,

    f(t, p) = f_0(t) + sum_k p_k f_k(t),

where f_0 has the numbers with zeros in place of the names, and f_k ones where p_k is named and zeros elsewhere. Each
is a load of its own with a function that holds numbers alone, and p_k for its `scale`: what models, samples and
derivatives know of loads holds for it as it is.

The impulse of a table over time, and what the integrator sees of it: the trapezoidal rule on its steps.

A table is linear between its rows, so that the rule is exact in every step without a row inside: whatever the number of
steps, only those with rows are looked at.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

import pgmp_petsc.scene.effects as kinds
from pgmp_petsc.runtime.errors import nearest_name
from pgmp_petsc.scene.effects import Effect, Force, Torque
from pgmp_petsc.scene.fields import GROUND, split_point
from pgmp_petsc.scene.joints import Cylindrical, are_parallel, joints_with
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.uses import stop_ends

if TYPE_CHECKING:
    from pgmp_petsc.scene.schema import Scene


LOST_IMPULSE = 0.01  # share of an impulse that steps may miss
STEPS_A_PERIOD = 8  # fewest steps in a period of a harmonic
#: Joints that rotate, and those that rotate or slide, in the plane and in space.
TURNING = {d: joints_with("turning", dimension=d) for d in (2, 3)}
SLIDING = joints_with("sliding")
MOVING = {d: joints_with("turning", "sliding", dimension=d) for d in (2, 3)}
#: Joints that an effect may be on.
ON_JOINTS = {
    kinds.Torque: TURNING,
    kinds.JointDamping: MOVING,
    kinds.JointFriction: MOVING,
    kinds.SpringDamper: MOVING,
    kinds.EndStop: MOVING,
}
#: Rotations that a bushing resists, and what a scene moves in.
TURNS = {2: 1, 3: 3}
WHERE = {2: "in the plane", 3: "in space"}
#: Effects that a scene may have once.
SINGLE = (kinds.Gyroscopic, kinds.GeometricStiffening, kinds.ModeInertia)

PointCheck = Callable[["Scene", str, str, bool], Iterator[str]]


def effect_problems(scene: Scene, check_point: PointCheck) -> Iterator[str]:
    """Yield one line for each entry of an effect that does not fit; `check_point` checks ``"body:point"``."""
    for name, effect in scene.effects.items():
        entry = f"effects.{name}"
        allowed = ON_JOINTS.get(type(effect))
        if allowed and effect.joint is not None:
            yield from joint_problems(scene, f"{entry}.joint", effect.joint, allowed[scene.dimension])
            yield from motion_problems(scene, entry, effect)
        for key, ground_allowed in (("point", False), ("towards", True)):
            point = getattr(effect, key, None)
            if point is not None:
                yield from check_point(scene, f"{entry}.{key}", point, ground_allowed)
        if isinstance(effect, (kinds.SpringDamper, kinds.Bushing)) and effect.points is not None:
            yield from points_problems(scene, f"{entry}.points", effect.points, check_point)
        if isinstance(effect, kinds.Bushing):
            yield from _bushing(scene, entry, effect)
        if isinstance(effect, kinds.Force) and effect.towards is not None:
            yield from _apart(scene, f"{entry}.towards", (effect.point, effect.towards))
        if isinstance(effect, (kinds.Torque, kinds.Force, kinds.PrescribedMotion)):
            # all parts of a harmonic have its frequency: what is wrong with it is said once
            parts = parts_of(name, effect).values()
            yield from dict.fromkeys(line for part in parts for line in _resolved_in_time(scene, entry, part))
        if isinstance(effect, kinds.StructuralDamping):
            yield from _damped_bodies(scene, entry, effect)
        if isinstance(effect, kinds.PrescribedMotion):
            yield from _prescribed(scene, name, effect)
    yield from _ends_apart(scene)
    yield from _damped_once(scene)
    yield from _alone(scene)
    yield from _halves(scene)


def joint_problems(scene: Scene, entry: str, joint: str, allowed: tuple[type, ...]) -> Iterator[str]:
    """Yield a line if there is no such joint, or it is of a kind that is not allowed."""
    fitting = [name for name, candidate in scene.joints.items() if isinstance(candidate, allowed)]
    named = " or ".join(kind.model_fields["type"].annotation.__args__[0] for kind in allowed)
    if joint not in scene.joints:
        yield problem(entry, f"there is no such {named} joint{nearest_name(joint, fitting)}", joint)
    elif joint not in fitting:
        yield problem(
            entry,
            f"a {named} joint is needed, this one is a {scene.joints[joint].type}"
            f" (allowed: {', '.join(fitting) or 'none is defined'})",
            joint,
        )


def motion_problems(scene: Scene, entry: str, on_joint: Any) -> Iterator[str]:
    """Yield a line if the motion of a cylindrical joint is not said, or that of another one is."""
    cylindrical = isinstance(scene.joints.get(on_joint.joint), Cylindrical)
    motion = getattr(on_joint, "motion", None)
    if cylindrical and motion is None and "motion" in type(on_joint).model_fields:
        yield problem(f"{entry}.motion", f'missing; {on_joint.joint} is cylindrical: "turning" or "sliding" is needed')
    elif motion is not None and not cylindrical:
        yield problem(f"{entry}.motion", "for cylindrical joints; others have one motion; leave it out", motion)


def _bushing(scene: Scene, entry: str, effect: kinds.Bushing) -> Iterator[str]:
    """Check that a bushing has axes that make a frame, and as many numbers as axes."""
    n = scene.dimension
    wanted = "two axes of three numbers, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]" if n == 3 else "one axis, [[1.0, 0.0]]"
    given = [list(axis) for axis in effect.reference]
    if len(given) != n - 1 or any(len(axis) != n for axis in given):
        yield problem(f"{entry}.reference", f"{wanted} for example, is needed {WHERE[n]}", given)
    elif n == 3 and are_parallel(*given):
        yield problem(f"{entry}.reference", "the axes must not be parallel; the second one is at a right angle", given)
    for key, count in (
        ("stiffness", n),
        ("damping", n),
        ("turning_stiffness", TURNS[n]),
        ("turning_damping", TURNS[n]),
    ):
        numbers = getattr(effect, key)
        if numbers and len(numbers) != count:
            what = "one number is" if count == 1 else f"{count} numbers, one for each axis, are"
            yield problem(f"{entry}.{key}", f"{what} needed {WHERE[n]}", list(numbers))


def points_problems(scene: Scene, entry: str, points: tuple[str, str], check_point: PointCheck) -> Iterator[str]:
    """Yield a line for each of two points that there is not, and if their distance cannot change."""
    for point in points:
        yield from check_point(scene, entry, point, True)
    yield from _apart(scene, entry, points)


def _apart(scene: Scene, entry: str, points: tuple[str, str]) -> Iterator[str]:
    """Check that the distance of two points can change."""
    owners = [split_point(point)[0] for point in points]
    body = scene.bodies.get(owners[0])
    if points[0] == points[1]:
        yield problem(entry, "two different points are needed", list(points))
    elif owners == [GROUND, GROUND]:
        yield problem(entry, "a point of a body is needed; the ground does not move", list(points))
    elif owners[0] == owners[1] and body is not None and not body.flexible:
        yield problem(entry, f"{owners[0]} is rigid; the distance of its points does not change", list(points))


def _resolved_in_time(
    scene: Scene, entry: str, effect: kinds.Torque | kinds.Force | kinds.PrescribedMotion
) -> Iterator[str]:
    """Check that what the integrator sees, values at the ends of steps, is what the scene says."""
    run = scene.simulation
    if run.tolerance is not None:  # the step is not known yet
        return
    if effect.harmonic is None:
        if effect.table is not None and not isinstance(effect, kinds.PrescribedMotion):
            yield from _impulse(scene, f"{entry}.table", effect)
    elif run.step * effect.harmonic.frequency_hz * STEPS_A_PERIOD > 1.0:
        yield problem(
            f"{entry}.harmonic.frequency_hz",
            f"needs a simulation.step of at most {1.0 / (STEPS_A_PERIOD * effect.harmonic.frequency_hz):.3g} s, "
            f"{STEPS_A_PERIOD} a period; it is {run.step:g} s",
            effect.harmonic.frequency_hz,
        )


def _impulse(scene: Scene, entry: str, effect: kinds.Torque | kinds.Force) -> Iterator[str]:
    run = scene.simulation
    n_steps = max(1, math.ceil(run.duration / run.step * (1 - 1e-12)))
    found = impulse_of(effect.table, run.duration, n_steps)
    # what sets in within a step is seen half a step early or late; that is as it should be
    tolerated = max(LOST_IMPULSE * found.whole, 0.5 * run.step * found.largest)
    if abs(found.seen - found.exact) > tolerated:
        unit = "N m s" if isinstance(effect, kinds.Torque) else "N s"
        yield problem(
            entry,
            f"has an impulse of {found.exact:.4g} {unit}, but {found.seen:.4g} with a {effect.type} read every "
            f"{run.step:g} s; take a smaller simulation.step, or a pulse that lasts several steps",
        )


def _damped_bodies(scene: Scene, entry: str, effect: kinds.StructuralDamping) -> Iterator[str]:
    flexible = [name for name, body in scene.bodies.items() if body.flexible]
    for body in effect.bodies or ():
        if body not in scene.bodies:
            yield problem(
                f"{entry}.bodies", f"there is no body '{body}'{nearest_name(body, flexible)}", list(effect.bodies)
            )
        elif body not in flexible:
            yield problem(
                f"{entry}.bodies", f"{body} is rigid; only flexible bodies have structural damping", list(effect.bodies)
            )
    if effect.bodies is None and not flexible:
        yield problem(entry, "all bodies are rigid; only flexible bodies have structural damping")


def _ends_apart(scene: Scene) -> Iterator[str]:
    """Check that the lower end of a stop is below the upper one, nominally and in a single run."""
    for name, lower, upper in stop_ends(scene):
        if any(isinstance(end, str) and end not in scene.parameters for end in (lower, upper)):
            continue  # said elsewhere
        for values in (scene.nominal, scene.values):
            low, high = (scene.number(end, values) for end in (lower, upper))
            if not low < high:
                behind = f", not {low:g}" if isinstance(lower, str) else ""
                yield problem(f"effects.{name}.lower", f"must be below upper = {high:g}{behind}", lower)
                break


def _damped_once(scene: Scene) -> Iterator[str]:
    taken: dict[str, str] = {}
    for name, effect in scene.effects.items():
        if isinstance(effect, kinds.StructuralDamping):
            for body in dict.fromkeys(effect.bodies or scene.bodies):
                if body in taken:
                    yield problem(
                        f"effects.{name}",
                        f"effects.{taken[body]} damps {body} too; give all the damping of a body in one effect",
                    )
                taken.setdefault(body, name)


def _prescribed(scene: Scene, name: str, effect: kinds.PrescribedMotion) -> Iterator[str]:
    entry = f"effects.{name}.coordinate"
    if effect.coordinate not in scene.coordinates:
        yield problem(
            entry, f"there is no such coordinate{nearest_name(effect.coordinate, scene.coordinates)}", effect.coordinate
        )
        return
    joint = scene.coordinates[effect.coordinate].joint
    for other, rival in scene.effects.items():
        if isinstance(rival, (kinds.Torque, kinds.EndStop)) and rival.joint == joint:
            yield problem(
                entry,
                f"contradicts effects.{other}, of type {rival.type} on the same joint {joint}: a prescribed motion "
                "takes whatever torque it needs; leave one of them out",
                effect.coordinate,
            )
        if other < name and isinstance(rival, kinds.PrescribedMotion) and rival.coordinate == effect.coordinate:
            yield problem(entry, f"effects.{other} prescribes the same coordinate", effect.coordinate)
    if effect.coordinate in scene.simulation.initial:
        yield problem(
            f"simulation.initial.{effect.coordinate}",
            f"effects.{name} prescribes this coordinate from the start on; leave one of them out",
        )


def _alone(scene: Scene) -> Iterator[str]:
    for kind in SINGLE:
        names = [name for name, effect in scene.effects.items() if isinstance(effect, kind)]
        for name in names[1:]:
            yield problem(f"effects.{name}", f"effects.{names[0]} is of the same type; a scene has one at most")


def _halves(scene: Scene) -> Iterator[str]:
    """Refuse half of what is of second order in the deformation: each half alone is wrong where bodies spin.

    Without the stiffness by inertia forces a spinning beam softens and buckles at a speed where it does not (Kane, Ryan
    and Banerjee 1987); without the inertia of the turning shapes it is stiffer in the plane than it is.
    """
    found = {type(effect): name for name, effect in scene.effects.items()}
    halves = (kinds.GeometricStiffening, kinds.ModeInertia)
    present = [kind for kind in halves if kind in found]
    if len(present) == 1:
        (missing,) = set(halves) - set(present)
        yield problem(
            f"effects.{found[present[0]]}",
            "is half of what is of second order in the deformation, and wrong by itself where bodies spin; name an "
            f'effect of type "{missing.model_fields["type"].annotation.__args__[0]}" too, or neither',
        )
    second_order = scene.reduction.second_order or bool(present)
    left_out = kinds.Gyroscopic in found and not scene.effects[found[kinds.Gyroscopic]].keep
    if left_out and second_order:
        reason = f"effects.{found[present[0]]}" if present else "reduction.second_order"
        yield problem(
            f"effects.{found[kinds.Gyroscopic]}.keep",
            f"leaves out the forces by velocities whose stiffening {reason} asks for; keep them, or leave out both",
            False,
        )


HARMONIC = ("amplitude", "mean")


def parts_of(name: str, effect: Effect) -> dict[str, Effect]:
    """Return the loads that an effect is made of; any other effect as it is.

    Several are named after the effect and their parameters, ``NAME_PARAMETER``; the one of numbers has the effect's
    name, and so has one that is alone.
    """
    if not isinstance(effect, (Torque, Force)):
        return {name: effect}
    parameters = effect.parameters_over_time
    if not parameters:
        return {name: effect}
    parts: dict[str, Effect] = {} if _is_zero(effect) else {name: _part(effect, None)}
    for parameter in parameters:
        parts[_own_name(name, parameter)] = _part(effect, parameter)
    return parts if len(parts) > 1 else {name: next(iter(parts.values()))}


def part_problems(scene: Scene) -> Iterator[str]:
    """Yield a line for each effect that has the name of a part of another one."""
    for name, effect in scene.effects.items():
        for part in parts_of(name, effect):
            if part != name and part in scene.effects:
                yield problem(f"effects.{part}", f"a part of effects.{name} has this name; give it another one")


def _own_name(name: str, parameter: str) -> str:
    return f"{name}_{parameter}"


def _is_zero(effect: Torque | Force) -> bool:
    """Return whether all values that are numbers are zero."""
    return not any(value for _, value in effect.values_over_time if not isinstance(value, str))


def _part(effect: Torque | Force, parameter: str | None) -> Torque | Force:
    """Return the load of one parameter, or of the numbers."""

    def value_of(value: float | str) -> float:
        if parameter is None:
            return 0.0 if isinstance(value, str) else value
        return effect.scale if value == parameter else 0.0

    if effect.harmonic is not None:
        values = {key: value_of(getattr(effect.harmonic, key)) for key in HARMONIC}
        changed = {"harmonic": effect.harmonic.model_copy(update=values)}
    else:
        changed = {"table": tuple((time, value_of(value)) for time, value in effect.table)}
    return effect.model_copy(update=changed | ({} if parameter is None else {"scale": parameter}))


@dataclass(frozen=True)
class Impulse:
    """Integrals of a table over a run, in its unit times s.

    Attributes
    ----------
    exact, seen
        Of the table, and of its values at the ends of steps by the trapezoidal rule.
    whole
        Of its magnitude.
    largest
        Largest magnitude at the end of a step, in the table's unit.
    """

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
    return Impulse(
        exact=float(_trapezoid(at_knots, knots)),
        seen=float(_trapezoid(at_ends, ends)),
        whole=float(_magnitude(at_knots, knots)),
        largest=float(np.max(np.abs(at_ends))),
    )


def _trapezoid(values: np.ndarray, at: np.ndarray) -> float:
    return 0.5 * np.sum((values[1:] + values[:-1]) * np.diff(at))


def _magnitude(values: np.ndarray, at: np.ndarray) -> float:
    """Integrate the magnitude of what is linear between `at`, changes of sign included."""
    a, b = values[:-1], values[1:]
    turns = a * b < 0.0
    total = np.abs(a) + np.abs(b)
    # two triangles where the sign changes
    share = np.where(turns, (a * a + b * b) / np.where(turns, total, 1.0), total)
    return 0.5 * np.sum(share * np.diff(at))
