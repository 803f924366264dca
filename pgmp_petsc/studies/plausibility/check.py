"""All checks of a scene's sense, in the order of its tables; those of its settings, parameters and units are here.

Limits are orders of magnitude: what is a hundred times beyond the usual is worth a question. Refused is only what no
mechanism can have, such as a beam thicker than long or a motion faster than light.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache

import numpy as np

from pgmp_petsc.base.errors import Remark, warning
from pgmp_petsc.base.units import MM, SI, STANDARD_GRAVITY
from pgmp_petsc.bodies.shape import Shapes
from pgmp_petsc.mechanism.capabilities import BYTES
from pgmp_petsc.mechanism.kinematics import MOST_COORDINATES, RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.fields import GROUND
from pgmp_petsc.scene.joints import ORIGIN, CouplingEntry
from pgmp_petsc.scene.messages import Finding, doubt, input_error, refusal
from pgmp_petsc.scene.parameters import Parameter, share_below
from pgmp_petsc.scene.references import DEGREES, points_used, stressed_bodies
from pgmp_petsc.scene.units import own_values, shown_in
from pgmp_petsc.scene.uses import length_names, slides, uses_of
from pgmp_petsc.studies.plausibility import bodies

SEVERAL, SHOWN = 3, 6  # findings that are reported as one, and entries of them that are named
NUMBER = re.compile(r"(?<![A-Za-z_])[-+]?\d[\d.,]*(e[-+]?\d+)?")


def plausibility(scene: Scene, meshes: Shapes | None = None) -> tuple[Remark, ...]:
    """Return a warning for each entry that probably is not meant.

    Without the mesh of every body only straight beams are looked at, and stops of coordinates. Raises `InputError` if
    entries cannot be meant, one line for each.
    """
    first = cache(lambda: bodies.first_frequency(scene, meshes or {}))
    assembled = None if meshes is None else cache(lambda: RigidKinematics(Mechanism.from_scene(scene, meshes)))
    sizes, system = bodies.sizes_of(scene, meshes or {}), scene.number_units
    findings = [
        *parameter_findings(scene),
        *bodies.material_findings(scene, system),
        *system_findings(scene),
        *bodies.body_findings(scene, sizes, system),
        *bodies.matrix_findings(scene, meshes or {}, system),
        *bodies.load_findings(scene, sizes, system, first),
        *bodies.motion_findings(scene, sizes, system),
        *setting_findings(scene, sizes, first),
        *riding_findings(scene),
        *unused_findings(scene),
    ]
    if not any(finding.refused for finding in findings):  # the mechanism of a scene with sense can be put together
        findings += bodies.stop_findings(scene, assembled, max((size.length for size in sizes.values()), default=1.0))
        if assembled is not None:
            for found_by in (bodies.coupling_findings, bodies.formula_findings, bodies.edge_findings):
                findings += found_by(scene, assembled)
    shown = shown_in(scene)
    refused = [finding.text(shown) for finding in findings if finding.refused]
    if refused:
        raise input_error(refused)
    return tuple(warning(text) for text in _each_once(scene, [finding.text(shown) for finding in findings]))


def _each_once(scene: Scene, texts: Sequence[str]) -> list[str]:
    """Return texts that say the same of several names as the first of them, with how many others there are."""
    names = {*scene.bodies, *scene.materials, *scene.parameters, *scene.joints, *scene.effects, *scene.ground.points}
    name = re.compile("|".join(rf"\b{re.escape(one)}\b" for one in sorted(names, key=len, reverse=True)) or "$^")
    alike: dict[str, list[str]] = {}
    for text in texts:
        alike.setdefault(NUMBER.sub("#", name.sub("*", text)), []).append(text)
    said: list[str] = []
    for own in alike.values():
        others = ", ".join(re.split(r" = |: ", text, maxsplit=1)[0] for text in own[1 : 1 + SHOWN])
        more = f". The same of {len(own) - 1} others: {others}{', ...' if len(own) > 1 + SHOWN else ''}"
        said += [own[0] + more] if len(own) >= SEVERAL else own
    return said


FEW_STEPS = 10  # of a run
MANY_STEPS = 1e7
STEPS_A_PERIOD = 3  # of a body's first bending; with fewer a motion cannot be told from its alias
SMALL_RANGE = 1e-3  # rad
WHOLE_TURN = 2 * math.pi + 1e-3  # rad
IN_RAD = "Angles are in rad: 90 degrees are 1.5708"
FEW_ANGLES = 128  # of a turn of a cam
LARGE_TABLES, LARGEST_TABLES = 16e9, 1e12  # bytes
Frequency = Callable[[], float | None]


def setting_findings(scene: Scene, sizes: Mapping[str, bodies.Size], first: Frequency) -> Iterator[Finding]:
    """Yield settings that do not go together; `first` returns the first frequency of the mechanism, Hz, if it can be
    had."""
    if not scene.simulation.is_chosen:
        yield from _steps(scene, sizes, first)
    couplings = (joint.shares_in(scene) for joint in scene.joints.values() if isinstance(joint, CouplingEntry))
    geared = {share.joint for shares in couplings for share in shares}  # these turn often
    for name, coordinate in scene.coordinates.items():
        low, high = coordinate.range
        if slides(scene, coordinate):
            continue
        entry = f"coordinates.{name}.range"
        if high - low < SMALL_RANGE:
            yield doubt(entry, "hardly a range; it is in rad, and a run ends where it leaves it", [low, high])
        elif _like_degrees(low, high) and coordinate.joint not in geared:
            yield doubt(entry, _in_turns(high - low), [low, high])
    for name, body in scene.bodies.items():
        if (given := body.placement) is None:
            continue
        turn = abs(given.angle) if given.rotation is None else math.hypot(*given.rotation)
        if turn > WHOLE_TURN:
            key = "angle" if given.rotation is None else "rotation"
            value = given.angle if given.rotation is None else list(given.rotation)
            yield doubt(f"bodies.{name}.placement.{key}", f"more than a turn; is it in degrees? {IN_RAD}", value)
    for name, state in scene.simulation.initial.items():
        position = state.position
        if isinstance(position, float) and position % DEGREES == 0.0 and abs(position) > WHOLE_TURN:
            yield doubt(f"simulation.initial.{name}.position", _in_turns(position), position)
    yield from _tables(scene)
    yield from _breaks(scene)
    yield from _without_effect(scene)
    for name, output in scene.outputs.items():
        yield from output.doubts(scene, name)
    if not scene.outputs:
        yield doubt("outputs", "none: a run reports nothing, and an ensemble has no statistics; add [outputs.NAME]")


def _in_turns(angle: float) -> str:
    return f"{angle / (2 * math.pi):.3g} turns; is it in degrees? {IN_RAD}"


def _like_degrees(low: float, high: float) -> bool:
    """Whether a range of an angle is one of degrees: both ends are multiples of 5, or of 1/2 and two turns apart."""
    length = high - low
    fives, halves = (low % part == 0.0 == high % part for part in (DEGREES, 0.5))
    return fives and length > WHOLE_TURN or halves and length > 2.0 * WHOLE_TURN


def _steps(scene: Scene, sizes: Mapping[str, bodies.Size], first: Frequency) -> Iterator[Finding]:
    simulation = scene.simulation
    step, n_steps = simulation.step, simulation.duration / simulation.step
    if n_steps <= 1.0:
        whole = f"one step for the whole run of {simulation.duration:g} s"
        yield refusal("simulation.step", f"{whole}; take a smaller one", step)
    elif n_steps < FEW_STEPS:
        yield doubt("simulation.step", f"only {n_steps:.2g} steps for the whole run of {simulation.duration:g} s", step)
    elif n_steps > MANY_STEPS:
        yield doubt("simulation.step", f"{n_steps:.2g} steps to simulation.duration = {simulation.duration:g} s", step)
    bending = {name: size.frequency_hz for name, size in sizes.items() if size.frequency_hz > 0.0}
    if bending:
        softest = min(bending, key=bending.__getitem__)
        if step * bending[softest] * STEPS_A_PERIOD > 1.0:
            frequency, what = first(), "the first mode of the mechanism has"
            if frequency is None:
                frequency, what = bending[softest], f"between hinged ends {softest} bends with about"
            if step * frequency * STEPS_A_PERIOD > 1.0:
                few = f"{what} {frequency:.3g} Hz, of which a period has {1 / (step * frequency):.2g} steps"
                cure = f"at least {STEPS_A_PERIOD} are needed to see it: take {0.05 / frequency:.1g} s"
                yield doubt("simulation.step", f"{few}; {cure}", step)


def _tables(scene: Scene) -> Iterator[Finding]:
    reduction = scene.reduction
    if reduction.tolerance is not None and not {"modes", "angles"} <= reduction.model_fields_set:
        return
    n_vectors, n = reduction.modes + reduction.parameter_modes, len(scene.coordinates)
    if n > MOST_COORDINATES:
        return  # a build is refused, and nothing else has tables
    count = float(reduction.angles) ** n
    n_bytes = BYTES * count * n_vectors**2 * (n_vectors if scene.second_order else 1)
    if n_bytes > LARGE_TABLES:
        size = f"make tables of at least {n_bytes / 1e9:.3g} GB; take fewer angles or modes"
        words = f"{count:.3g} configurations with {n_vectors} vectors each {size}"
        yield (refusal if n_bytes > LARGEST_TABLES else doubt)("reduction.angles", words, reduction.angles)


def _breaks(scene: Scene) -> Iterator[Finding]:
    """Yield too few angles beside what follows a table.

    Where its cubic spline breaks, accelerations of the follower have kinks, which interpolated tables round off: a
    follower's arm was 9e-3 of its bending off with 64 angles a turn, 2e-3 with 128 and 6e-4 with 256 (a cam of 6
    points; 2e-3, 5e-4 and 1e-4 with 12).
    """
    reduction = scene.reduction
    if reduction.tolerance is not None or reduction.sampling_tolerance is not None or len(scene.coordinates) != 1:
        return
    (coordinate,) = scene.coordinates.values()
    low, high = coordinate.range
    turns = 1.0 if slides(scene, coordinate) else (high - low) / (2 * math.pi)
    couplings = {name: one.shares_in(scene) for name, one in scene.joints.items() if isinstance(one, CouplingEntry)}
    # what another joint turns for each rad of the coordinate's, where two are geared
    geared = {
        (one.joint, other.joint): abs(scene.number(one.factor) * one.times / (scene.number(other.factor) * other.times))
        for pair in couplings.values() if len(pair) == 2 and not any(share.table for share in pair)
        for one, other in (pair, pair[::-1])
    }  # fmt: skip
    for name, shares in couplings.items():
        for cam in (share.joint for share in shares if share.table):
            if reduction.angles / (turns * geared.get((coordinate.joint, cam), 1.0)) < FEW_ANGLES:
                off = f"few beside joints.{name}, as the spline of its table breaks at every point"
                cure = f"take {2 * FEW_ANGLES} a turn, or a reduction.sampling_tolerance"
                yield doubt("reduction.angles", f"{off}; {cure}", reduction.angles)


def _without_effect(scene: Scene) -> Iterator[Finding]:
    """Yield settings other than the defaults that work with another one, which the scene does not have."""
    reduction, ensemble = scene.reduction, scene.ensemble
    chosen = reduction.tolerance is not None or reduction.effects == "auto"  # then second_order may be
    adds_angles = reduction.sampling_tolerance is not None or reduction.parameter_modes or stressed_bodies(scene)
    without_angles = "there is no reduction.sampling_tolerance, no parameter_modes and no stress output"
    sampler = f'ensemble.sampler = "{ensemble.sampler}"; it is for "sobol" and "saltelli" (--sampler)'
    copula = f'ensemble.copula = "{ensemble.copula}"; it is for "student"'
    for table, name, works, why in (
        ("reduction", "stretching", reduction.second_order or chosen, "reduction.second_order is false"),
        ("reduction", "max_angles", adds_angles, without_angles),
        ("reduction", "length_points", length_names(scene), "no parameter is a length, a place or a ratio"),
        ("ensemble", "replicates", ensemble.sampler in ("sobol", "saltelli"), sampler),
        ("ensemble", "copula_freedom", ensemble.copula == "student", copula),
        ("ensemble", "band_samples", ensemble.bands, "ensemble.bands = 0"),
    ):
        settings = getattr(scene, table)
        if not works and (given := getattr(settings, name)) != type(settings).model_fields[name].default:
            yield doubt(f"{table}.{name}", f"without effect, as {why}", given)
    if "interpolation" in reduction.model_fields_set and scene.interpolation != reduction.interpolation:
        joint = next(name for name, one in scene.joints.items() if one.elastic is not None)
        why = f"splines take its place, as joints.{joint} is elastic: rigid motion and what it carries share inertia"
        yield doubt("reduction.interpolation", f'{why}; take "spline"', reduction.interpolation)


def riding_findings(scene: Scene) -> Iterator[Finding]:
    """Yield what rides freely on a beam, whose slope drives it, in a scene without terms of second order."""
    riding = [name for name, joint in scene.joints.items() if joint.rides]
    driven = any(scene.coordinates[name].joint in riding for name in scene.driven)
    if riding and not driven and not scene.second_order:
        words = (
            "moves freely, and the slope of the bent beam drives it, which reduced models have with terms of second "
            "order alone; name effects of type geometric_stiffening and mode_inertia, or take pgmp simulate --full"
        )
        yield doubt(f"joints.{riding[0]}.type", words, scene.joints[riding[0]].type)


def unused_findings(scene: Scene) -> Iterator[Finding]:
    """Yield parameters, materials and ground points that nothing uses."""
    parameters = {use.parameter for use in uses_of(scene)}
    materials = {material for body in scene.bodies.values() for material in (body.material, *body.regions.values())}
    for entry, given, used, why in (
        ("parameters", scene.parameters, parameters, "nothing uses it: no entry holds its name"),
        ("materials", scene.materials, materials, "no body is made of it"),
        ("ground.points", scene.ground.points, {ORIGIN, *points_used(scene, GROUND)}, "nothing is attached to it"),
    ):
        for name in given:
            if name not in used:
                yield doubt(f"{entry}.{name}", f"{why}; leave it out")


CUT_OFF = 0.01  # share of a distribution beyond its bounds
NOT_POSITIVE = 1e-3  # share of a distribution where a parameter makes no sense
FAR = 1e-6  # share of a distribution beyond the nominal value
AT_END = 1e-3  # of what lies between such shares at both ends, within which samples are beside a value
OTHER_UNIT = 300.0  # ratio of median and nominal value, from which on one of them is in another unit


def parameter_findings(scene: Scene) -> Iterator[Finding]:
    """Yield what is strange about parameters."""
    for name, parameter in scene.parameters.items():
        if parameter.distribution is not None:
            with np.errstate(all="ignore"):  # distributions with arguments at the ends of what floats hold
                yield from _distribution(scene, name, parameter)


def _distribution(scene: Scene, name: str, parameter: Parameter) -> Iterator[Finding]:
    entry = f"parameters.{name}"
    drawn, nominal = parameter.distribution.frozen, parameter.nominal
    median = float(drawn.median())
    unit = f" {scene.system.unit(parameter.unit)}" if parameter.unit else ""
    shown = own_values(scene, {name: median})[name]

    first, last = float(drawn.ppf(FAR)), float(drawn.ppf(1.0 - FAR))  # of single shares: scipy.special takes a while
    beside = AT_END * (last - first)  # the end of a uniform distribution is beside samples

    def beyond(value: float) -> bool:
        return value < first - beside or value > last + beside

    def of_other_unit(value: float) -> bool:
        return beyond(value) and value * median > 0 and not 1 / OTHER_UNIT < median / value < OTHER_UNIT

    if not np.isfinite(median):
        yield refusal(f"{entry}.distribution", "has no median that is a number; other arguments are needed")
    elif of_other_unit(nominal):
        much = f"the median of its distribution is {shown:.4g}{unit}, {median / nominal:.3g} times as much"
        yield refusal(f"{entry}.nominal", f"{much}; is one of them in another unit? `unit` holds for both", nominal)
    elif beyond(nominal):
        half = f"half of its samples below {shown:.4g}{unit} and less than {FAR:g} of them beyond this"
        words = f"lies outside its distribution, which has {half}; the reduced basis is built where no sample is"
        yield doubt(f"{entry}.nominal", words, nominal)
    if parameter.value is not None and of_other_unit(parameter.value):
        much = f"{parameter.value / median:.3g} times the median of its distribution, {shown:.4g}{unit}"
        yield doubt(
            f"{entry}.value", f"{much}; it is in the scene's units, or says its own, as in 5mm", parameter.value
        )
    low, high = (-np.inf, np.inf) if parameter.bounds is None else parameter.bounds
    if (lost := sum(parameter.cut_off)) > CUT_OFF:
        cure = "widen them, or give a narrower distribution"
        yield doubt(f"{entry}.bounds", f"{100 * lost:.3g} % of its distribution lies beyond them; {cure}", [low, high])
    positive = name in scene.positive_parameters
    below = float((drawn.cdf if positive else share_below(drawn))(0.0))
    if name in scene.parameters_not_negative and low < 0.0 and below > NOT_POSITIVE:
        zero = "at or " if positive else ""
        words = f"{100 * below:.3g} % of it is {zero}below 0, where this parameter makes no sense"
        cure = "give bounds, or a distribution of positive numbers such as lognorm"
        yield doubt(f"{entry}.distribution", f"{words}; {cure}")


def system_findings(scene: Scene) -> Iterator[Finding]:
    """Yield what is wrong with a scene whose materials are in other units than SI, which it does not say: gravity that
    is not said, units of parameters."""
    system = scene.material_units
    if scene.scene.units or system in (None, SI):
        return
    say = 'say scene.units = "mm"' if system == MM else ""
    name, material = next(iter(scene.materials.items()))
    shown = f"{name} has rho = {scene.number(material.rho):g} and E = {scene.number(material.E):g}"
    unsaid = (name for name, one in scene.effects.items() if one.uniform and "acceleration" not in one.model_fields_set)
    for effect in unsaid if system.gravity != STANDARD_GRAVITY else ():
        why = f"missing, and {STANDARD_GRAVITY:g} m/s2 does not fit: the materials are in {system} ({shown})"
        cure = (
            f"say acceleration = {system.gravity:g} ({system.unit('m/s2')}), or give materials and lengths in SI units"
        )
        yield refusal(f"effects.{effect}.acceleration", f"{why}; {say and say + ', or '}{cure}")
    what = f"they are in {system} ({shown}), and all numbers are computed with as they are: outputs are in these units"
    but = f"but files and messages that say m, kg, N or Pa mean {system}, {system.force} and {system.pressure}"
    yield doubt("materials", f"{what}, {but}{say and '; ' + say}")
    for name, parameter in scene.parameters.items():
        if parameter.unit not in ("", "-", "1", "rad"):
            why = f"numbers with a unit are converted to SI, but the materials are in {system}"
            cure = f"leave the unit out and give the number in these{say and ', or ' + say}"
            yield doubt(f"parameters.{name}.unit", f"{why}; {cure}", parameter.unit)
