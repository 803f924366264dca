"""Entries of a scene that hold a number or the name of a parameter: which sign and which unit they must have, and
whether they act on a rotation or along a line.

Parameters that are lengths of straight bodies, places of joints on the ground, or factors of couplings change the rigid
motion, and nothing is affine in them: a reduced model is built at some of their values and interpolates between these
(`reduction.length_family`), so that each needs a range: its bounds, within what its distribution gives.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from pgmp_petsc.base.errors import shortened
from pgmp_petsc.scene.fields import AnyScene, Use, named_numbers
from pgmp_petsc.scene.joints import MEASURED, CouplingEntry
from pgmp_petsc.scene.messages import problem

SomeScene = TypeVar("SomeScene")


def length_uses(scene: AnyScene) -> Iterator[Use]:
    """Yield the entries of lengths, places and ratios: of straight lines, of points of the ground, and of couplings."""
    for name, body in scene.bodies.items():
        if body.line is not None:
            yield Use(f"bodies.{name}.line.length", body.line.length, "positive", ("m",))
    for name, place in scene.ground.points.items():
        for axis, value in zip("xyz", place):
            yield Use(f"ground.points.{name}.{axis}", value, "any", ("m",))
    for name, joint in scene.joints.items():
        if isinstance(joint, CouplingEntry):
            yield from named_numbers(f"joints.{name}", joint)


def velocity_names(scene: AnyScene) -> dict[str, str]:
    """Return the parameters that are velocities at the start, by the names of the coordinates."""
    starts = scene.simulation.initial.items()
    return {coordinate: state.velocity for coordinate, state in starts if isinstance(state.velocity, str)}


def uses_of(scene: AnyScene) -> Iterator[Use]:
    """Yield every entry that may name a parameter."""
    yield from length_uses(scene)
    for name, material in scene.materials.items():
        yield from named_numbers(f"materials.{name}", material)
    for name, field in scene.fields.items():
        for parameter in field.names(name):
            yield Use(f"fields.{name}", parameter, "any", ("1",))
    for name, body in scene.bodies.items():
        yield from _of_body(f"bodies.{name}", body)
    for coordinate, name in velocity_names(scene).items():
        of = scene.coordinates.get(coordinate)
        unit = "m/s" if of is not None and slides(scene, of) else "rad/s"
        yield Use(f"simulation.initial.{coordinate}.velocity", name, "any", (unit,))
    for name, joint in scene.joints.items():
        slid = isinstance(joint, CouplingEntry) and joint.shares_in(scene)[0].motion == "sliding"
        for table in ("elastic", "offset", "clearance"):
            yield from named_numbers(f"joints.{name}.{table}", getattr(joint, table), slid)
    for name, effect in scene.effects.items():
        yield from effect.uses(f"effects.{name}", not slides(scene, effect))
    for name, controller in scene.controllers.items():
        yield from controller.uses(f"controllers.{name}")
    for name, output in scene.outputs.items():
        yield from output.uses(scene, f"outputs.{name}")


def _of_body(entry: str, body: Any) -> Iterator[Use]:
    yield from named_numbers(entry, body)
    if body.rigid is not None:
        yield Use(f"{entry}.rigid.mass", body.rigid.mass, "positive", ("kg",))
        for key, moment in body.rigid.moments.items():
            yield Use(f"{entry}.rigid.inertia.{key}", moment, "positive" if key[1] == key[2] else "any", ("kg m2",))
    yield from named_numbers(f"{entry}.matrices", body.matrices)
    for use in named_numbers(f"{entry}.section", body.section):
        yield replace(use, sign="positive") if body.flexible else use


def measured_uses(scene: AnyScene) -> Iterator[Use]:
    """Yield entries whose unit hangs on what the rest of the scene says, most of which no parameter can be."""
    of = {name: slides(scene, coordinate) for name, coordinate in scene.coordinates.items()}
    for name, slid in of.items():
        yield Use(f"coordinates.{name}.range", units=("m" if slid else "rad",))
    for name in scene.simulation.initial:
        slid = of.get(name, False)
        yield Use(f"simulation.initial.{name}.position", units=("m" if slid else "rad",))
        yield Use(f"simulation.initial.{name}.velocity", units=("m/s" if slid else "rad/s",))
    for name, effect in scene.effects.items():
        yield from effect.measured(scene, f"effects.{name}")
    for name, joint in scene.joints.items():
        yield from joint.measured(scene, f"joints.{name}")
    for name, output in scene.outputs.items():
        yield from output.measured(f"outputs.{name}")
    for label, event in scene.ensemble.probabilities.items():
        output = scene.outputs.get(event.output)
        for key in ("above", "below") if output is not None else ():
            yield Use(f"ensemble.probabilities.{label}.{key}", units=(output.unit_in(scene),))


def controller_uses(scene: AnyScene) -> Iterator[Use]:
    """Yield entries of controllers that have a unit. Their numbers stay those of the scene's units in SI too."""
    for name, controller in scene.controllers.items():
        yield Use(f"controllers.{name}.limits", units=("N" if slides(scene, controller) else "N m",))
        for row in range(len(controller.reference.table or ())):
            yield Use(f"controllers.{name}.reference.table[{row}][0]", units=("s",))
            yield from controller.references(scene, f"controllers.{name}.reference.table[{row}]")


def offset_names(scene: AnyScene) -> set[str]:
    """Return the parameters that are offsets of joints."""
    offsets = (joint.offset for joint in scene.joints.values() if joint.offset is not None)
    return {use.parameter for offset in offsets for use in named_numbers("", offset)} - {None}


def offset_directions(scene: AnyScene) -> tuple[str | None, ...]:
    """Return what joints are off by, each by its own amount: the parameters, sorted, and None for numbers if any is
    not zero."""
    offsets = (joint.offset for joint in scene.joints.values() if joint.offset is not None)
    numbers = any(use.value for offset in offsets for use in named_numbers("", offset) if use.parameter is None)
    return (*sorted(offset_names(scene)), *((None,) if numbers else ()))


def offset_values(scene: AnyScene, values: Mapping[str, Any], n_samples: int | None = None) -> np.ndarray:
    """Return how far joints are off by each of `offset_directions`, (n_offsets,), or of samples (n_offsets, n_samples);
    numbers are once what they are."""
    each = [1.0 if name is None else values[name] for name in offset_directions(scene)]
    shape = () if n_samples is None else (n_samples,)
    return np.array([np.broadcast_to(value, shape) for value in each]).reshape(len(each), *shape)


class OrderedEnds(NamedTuple):
    """Two entries of which the first is below the second, or a share of it."""

    entry: str  # dotted name of the first
    other: str  # the second, in words
    #: lower, upper: both values, numbers or names of parameters
    lower: float | str
    upper: float | str
    share: float = 1.0

    def at(self, scene: AnyScene, values: Mapping[str, Any]) -> tuple[Any, Any]:
        """Return both ends at values of the parameters, of which the first is to be below the second."""
        return scene.number(self.lower, values), self.share * scene.number(self.upper, values)


def ordered_ends(scene: AnyScene) -> Iterator[OrderedEnds]:
    """Yield what a scene has of ends that have an order."""
    sections = {f"bodies.{name}.section": body.section for name, body in scene.bodies.items() if body.section}
    effects = {f"effects.{name}": effect for name, effect in scene.effects.items()}
    for name, entry in (sections | effects).items():
        for low, high, *rest in entry.ordered:
            share = rest[0] if rest else 1.0
            if None not in (ends := (getattr(entry, low), getattr(entry, high))):
                yield OrderedEnds(f"{name}.{low}", high if share == 1.0 else f"{share:g} {high}", *ends, share)
    for name, controller in scene.controllers.items():
        if controller.limits is not None:
            yield OrderedEnds(f"controllers.{name}.limits[0]", "limits[1]", *controller.limits)


def slides(scene: AnyScene, entry: Any) -> bool:
    """Whether an effect or output acts along a line: at points, between two of them, or on a joint that slides."""
    if getattr(entry, "points", None) is not None or getattr(entry, "point", None) is not None:
        return True
    joint = scene.joints.get(getattr(entry, "joint", None))
    if joint is None:
        return False
    allowed = getattr(entry, "joints", MEASURED)
    return joint.motion_of(getattr(entry, "motion", None), allowed, scene.dimension) == "sliding"


def motion_over(scene: AnyScene, entry: Any) -> str | None:
    """Return the motion of a joint that an effect is over, ``turning`` or ``sliding``.

    None where the joint has both and none is said; of the joint that it acts on it is then the one that it acts on.
    """
    if entry.over == entry.joint and entry.over_motion is None:
        return "sliding" if slides(scene, entry) else "turning"
    joint = scene.joints.get(entry.over)
    return None if joint is None else joint.motion_of(entry.over_motion, MEASURED, scene.dimension)


def slides_over(scene: AnyScene, entry: Any) -> bool:
    """Return whether what a law is of slides: the motion that it is over, or the one that it acts on."""
    return slides(scene, entry) if entry.over is None else motion_over(scene, entry) == "sliding"


MOST_BUILDS = 64  # of all lengths together: each has the price of a build, and as much in the file


def length_names(scene: AnyScene) -> tuple[str, ...]:
    """Return the parameters that are lengths, places or ratios, sorted."""
    return tuple(sorted({use.parameter for use in length_uses(scene) if use.parameter is not None}))


def extremes(scene: AnyScene) -> Iterator[dict[str, float]]:
    """Yield the ends of every length with nominal others, and those of all together, where there are several."""
    ranges = {name: scene.parameters[name].range for name in length_names(scene)}
    nominal = {name: scene.nominal[name] for name in ranges}
    for name, ends in ranges.items():
        for end in ends:
            yield nominal | {name: end}
    for side in (0, 1) if len(ranges) > 1 else ():
        yield {name: ends[side] for name, ends in ranges.items()}


def held(scene: SomeScene, values: Mapping[str, float]) -> SomeScene:
    """Return a scene whose lengths are numbers, but for their names: nothing is drawn, and there is no other value."""
    fixed = {"distribution": None, "bounds": None}
    changed = {
        name: scene.parameters[name].model_copy(update={"nominal": value, "value": value, **fixed})
        for name, value in values.items()
    }
    return scene.model_copy(update={"parameters": {**scene.parameters, **changed}})


def with_numbers(scene: SomeScene, values: Mapping[str, float]) -> SomeScene:
    """Return a scene in which lengths, places and ratios are numbers, by the name of the parameter that each was."""
    bodies = dict(scene.bodies)
    for name, body in bodies.items():
        if body.line is not None and body.line.length in values:
            line = body.line.model_copy(update={"length": values[body.line.length]})
            bodies[name] = body.model_copy(update={"line": line})
    points = {
        name: tuple(values.get(x, x) if isinstance(x, str) else x for x in place)
        for name, place in scene.ground.points.items()
    }
    ground = scene.ground.model_copy(update={"points": points})
    joints = {
        name: joint.with_numbers(values) if isinstance(joint, CouplingEntry) else joint
        for name, joint in scene.joints.items()
    }
    return held(scene, values).model_copy(update={"bodies": bodies, "ground": ground, "joints": joints})


def count_builds(scene: AnyScene) -> int:
    """Return how many models a build makes: one, or those at all points of its lengths, and one to compare with."""
    names = length_names(scene)
    return scene.reduction.length_points ** len(names) + 1 if names else 1


def length_problems(scene: AnyScene) -> Iterator[str]:
    """Yield one line for each length, place or ratio that a parameter cannot be as it is given."""
    names = [name for name in length_names(scene) if name in scene.parameters]
    lengths = list(length_uses(scene))
    first, entries = {use.parameter: use for use in reversed(lengths)}, {use.entry for use in lengths}
    others = {use.parameter: use for use in uses_of(scene) if use.entry not in entries}
    for name in names:
        yield from _of_parameter(scene, name, first[name], others.get(name))
    count = scene.reduction.length_points ** len(names)
    if count > MOST_BUILDS:
        words = f"of {len(names)} lengths, places and ratios ({', '.join(names)}) make {count} builds; at most"
        cure = "Take fewer points, or numbers in place of some parameters"
        n_points = scene.reduction.length_points
        yield problem("reduction.length_points", f"{words} {MOST_BUILDS} are made. {cure}", n_points)
    for name, field in scene.fields.items():
        body = scene.bodies.get(field.body)
        if body is not None and body.line is not None and isinstance(body.line.length, str):
            words = f"its length is the parameter {shortened(str(body.line.length), 40)}, and a field is over one mesh"
            cure = f"give a number to bodies.{field.body}.line.length"
            yield problem(f"fields.{name}.body", f"{words}; {cure}", field.body)


def _of_parameter(scene: AnyScene, name: str, use: Use, other: Use | None) -> Iterator[str]:
    entry, parameter = f"parameters.{name}", scene.parameters[name]
    if other is not None:
        words = f"{use.entry} and {other.entry} use it; what is a length, a place or a ratio cannot be anything else"
        yield problem(entry, f"{words}, so take a parameter for each")
    low, high = parameter.range
    if not (math.isfinite(low) and math.isfinite(high)):
        in_unit = f" ({scene.system.unit('m')})" if use.units == ("m",) else ""
        why = f"missing; {use.entry} uses it, and the reduced model is built between its ends"
        cure = f"give bounds = [low, high]{in_unit}, or a distribution that has both, such as uniform"
        yield problem(f"{entry}.bounds", f"{why}: {cure}")
    elif use.sign == "positive" and low <= 0.0:
        yield problem(f"{entry}.bounds", f"must be positive, because {use.entry} uses it", [low, high])
    elif use.sign == "not zero" and low <= 0.0 <= high:
        words = f"must be on one side of 0, because {use.entry} uses it, and with 0 nothing is coupled"
        yield problem(f"{entry}.bounds", words, [low, high])
    else:
        for key in ("nominal", "value"):
            number = getattr(parameter, key)
            if number is not None and not low <= number <= high:
                words = f"must lie inside [{low:g}, {high:g}], between which {use.entry} is"
                yield problem(f"{entry}.{key}", words, number)
