"""What is strange about materials, and about sizes, proportions and first frequencies of bodies; about loads, springs,
dampers and masses: what never acts, acts twice, or would make a mechanism faster than can be; end stops that the
mechanism starts in; and how fast coordinates start and are driven."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.base.errors import PgmpError
from pgmp_petsc.base.surroundings import alone
from pgmp_petsc.base.units import DENSITIES, DENSITY, SI, STRESS, WAVE_SPEEDS, UnitSystem, exists
from pgmp_petsc.bodies.assembled import Assembled
from pgmp_petsc.bodies.sections.section import BeamSection
from pgmp_petsc.bodies.shape import BodyShape, Shapes, given_properties, shape_in_scene
from pgmp_petsc.declare.ideas import PACKAGE
from pgmp_petsc.effects import effects_of, start_of
from pgmp_petsc.effects.action import Action, joint_measure, jump_of
from pgmp_petsc.effects.formula import FormulaEffect, not_finite
from pgmp_petsc.mechanism.joints import Attachment
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism, Unknowns
from pgmp_petsc.mechanism.statements import Statement
from pgmp_petsc.mesh.meshes import LineMesh, SolidMesh
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.bodies import Body, Material, Rigid
from pgmp_petsc.scene.effects import AddedMass, Driving, EffectEntry, OverTime
from pgmp_petsc.scene.joints import CouplingEntry
from pgmp_petsc.scene.messages import Finding, doubt, named, refusal
from pgmp_petsc.scene.outputs import models_alone
from pgmp_petsc.scene.parameters import spanning_values, uncertain_names
from pgmp_petsc.scene.references import impulse_of, parts_of
from pgmp_petsc.scene.units import own_values
from pgmp_petsc.scene.uses import slides, slides_over

SLENDERNESS = 5.0  # length over thickness, below which a beam is none
NEARLY_INCOMPRESSIBLE = 0.49
LONGEST_MESH = 150.0  # m
MANY_ELEMENTS = 1000  # of one straight beam
FEW_ELEMENTS, ENOUGH_ELEMENTS = 3, 8  # of a flexible one: with three its first frequency is 15 % too high


@dataclass(frozen=True)
class Size:
    """Proportions of a body."""

    # length, thickness: largest extent, and the one across it that bends, m
    length: float
    thickness: float
    mass: float  # kg
    # first bending frequency as a beam with hinged ends, ``pi / 2 i c / length^2`` with the radius of gyration i of the
    # section and the speed c of waves, Hz; 0 for rigid bodies. What is held otherwise, carries a mass or hangs on
    # another body may have a quarter of it: a finding asks `first_frequency`
    frequency_hz: float


def sizes_of(scene: Scene, meshes: Shapes) -> dict[str, Size]:
    """Return the proportions of bodies whose mesh is given, or in the scene."""
    of = {LineMesh: _beam, SolidMesh: _solid, Assembled: _solid}
    return {
        name: (of[type(mesh)] if scene.bodies[name].rigid is None else _rigid)(scene, name, mesh)
        for name, mesh in _with_lines(scene, meshes).items()
    }


def _with_lines(scene: Scene, meshes: Shapes) -> dict[str, BodyShape]:
    """Return meshes that are given, with those that the scene has."""
    written = {name: shape_in_scene(scene, name) for name in scene.bodies if name not in meshes}
    return dict(meshes) | {name: shape for name, shape in written.items() if shape is not None}


def first_frequency(scene: Scene, meshes: Shapes) -> float | None:
    """Return the first frequency of the mechanism of beams where it starts, its coordinates free as they are, Hz.

    None where it takes more than a moment (bodies of cells, meshes that are not at hand), or cannot be had.
    """
    from pgmp_petsc.modes.problem import ModalProblem

    meshes = _with_lines(scene, meshes)
    if set(meshes) != set(scene.bodies) or any(body.continuum for body in scene.bodies.values()):
        return None
    try:
        kinematics = RigidKinematics(Mechanism.from_scene(scene, meshes))
        with ModalProblem(kinematics, scene.values, 1, alone()) as problem:
            modes = problem.solve(start_of(scene, kinematics.mechanism)[0])
    except PgmpError:
        return None
    return math.sqrt(max(float(modes.eigenvalues[0]), 0.0)) / (2.0 * math.pi) or None


def material_findings(scene: Scene, system: UnitSystem) -> Iterator[Finding]:
    """Yield materials that do not exist, each by its numbers, which are in the units of a system."""
    shown = scene.system
    of_density, of_speed = shown.unit("kg/m3"), shown.unit("m/s")
    lightest, heaviest = (limit / system.size(DENSITY) for limit in DENSITIES)
    slowest, fastest = (limit / system.speed for limit in WAVE_SPEEDS)

    def density_text(value: float) -> str:
        return limit_text(shown.shown(value, "kg/m3"))

    for name, material in scene.materials.items():
        entry = f"materials.{name}"
        yield from _poisson(scene, name, material)
        if exists(scene.number(material.rho), scene.number(material.E), system):
            continue
        density_entry, density = named(scene, f"{entry}.rho", material.rho)
        modulus_entry, modulus = named(scene, f"{entry}.E", material.E)
        if not lightest <= density <= heaviest:
            ends = f"{density_text(lightest)} to {density_text(heaviest)} {of_density}"
            steel = density_text(7800.0 / system.size(DENSITY))
            yield doubt(density_entry, f"a density outside {ends}, which solids have; steel has {steel}", density)
        speed = math.sqrt(modulus / density)
        if not slowest <= speed <= fastest:
            rho, speed = shown.text(density, "kg/m3", "g"), shown.text(speed, "m/s")
            waves = f"with rho = {rho} waves run through {name} at sqrt(E / rho) = {speed}"
            ends = " to ".join(limit_text(shown.shown(limit, "m/s")) for limit in (slowest, fastest))
            steel = limit_text(shown.shown(210e9 / system.size(STRESS), "Pa"))
            steel = f"E is in {shown.unit('Pa')}: steel has {steel}"
            yield doubt(modulus_entry, f"{waves}, outside {ends} {of_speed}; {steel}", modulus)


def limit_text(value: float) -> str:
    """Return a limit as people write it: ``25,000`` and ``210e9``, ``2.5e-08``."""
    if 1.0 <= value < 1e6:
        return f"{value:,.0f}" if value >= 1e4 else f"{value:.0f}"
    return f"{value / 1e9:.0f}e9" if 1e9 <= value < 1e12 else f"{value:g}"


def _poisson(scene: Scene, name: str, material: Material) -> Iterator[Finding]:
    entry = f"materials.{name}.nu"
    if material.nu < 0.0:
        yield doubt(entry, "negative, which few materials are", material.nu)
    elif material.nu > NEARLY_INCOMPRESSIBLE and any(
        body.continuum and name in (body.material, *body.regions.values()) for body in scene.bodies.values()
    ):
        yield doubt(entry, "nearly incompressible; continuum elements are far too stiff then", material.nu)


def body_findings(scene: Scene, sizes: Mapping[str, Size], system: UnitSystem) -> Iterator[Finding]:
    """Yield bodies with strange proportions, and meshes in another unit than the scene's."""
    for name, size in sizes.items():
        body = scene.bodies[name]
        entry = f"bodies.{name}"
        if body.mesh is not None and size.length * system.length > LONGEST_MESH:
            cure = 'scale it, or give the whole scene in mm (scene.units = "mm")'
            long = f"{name} is {scene.system.text(size.length, 'm')} long"
            yield doubt(f"{entry}.mesh", f"{long}; if this mesh is in mm, {cure}", body.mesh)
        if body.continuum:
            if body.thickness is not None:
                thickness_entry, thickness = named(scene, f"{entry}.thickness", body.thickness)
                if thickness > size.length:
                    words = f"{name} is thicker than its length of {scene.system.text(size.length, 'm')}"
                    yield doubt(thickness_entry, f"{words}; solid2d is for plates (plane stress)", thickness)
            continue
        if body.rigid is not None:
            yield from _drawn_inertia(scene, f"{entry}.rigid.inertia", body.rigid)
            continue
        if body.flexible or body.section.sizes:  # coefficients of a rigid body say its mass only
            yield from _slenderness(scene, name, size)
        n, where = ENOUGH_ELEMENTS if body.line is None else body.line.elements, f"{entry}.line.elements"
        if n > MANY_ELEMENTS:
            why = "errors of elements fall with the square of their length; so many only lose digits and time"
            yield doubt(where, why, n)
        if body.flexible and n < FEW_ELEMENTS:
            excess, enough = (100.0 * (bending_excess(number) - 1.0) for number in (n, ENOUGH_ELEMENTS))
            high = f"its first bending frequency is {excess:.0f} % too high"
            what = f"{high if math.isfinite(excess) else 'it does not bend'} between hinged ends"
            cure = f"take more elements ({ENOUGH_ELEMENTS}: {enough:.0f} %), or make the body rigid"
            yield doubt(where, f"{what}; {cure}", n)


def _drawn_inertia(scene: Scene, entry: str, rigid: Rigid) -> Iterator[Finding]:
    """Yield an inertia that samples may have and no body has: moments that are drawn one by one need not fit."""
    drawn = {moment for moment in rigid.moments.values() if isinstance(moment, str)} & {*uncertain_names(scene)}
    if not drawn or rigid.dimension == 2:
        return
    spanned, n = spanning_values(scene)
    for sample in range(n):
        values = {name: float(own[sample]) for name, own in spanned.items()}
        why = rigid.unlike_mass(lambda moment, values=values: scene.number(moment, values))
        if why:
            own = own_values(scene, values)
            where = ", ".join(f"{name} = {own[name]:.3g}" for name in sorted(drawn))
            yield doubt(entry, f"at {where}, which samples may have, {why}", list(rigid.inertia))
            return


def bending_excess(n_elements: int) -> float:
    """Return the first bending frequency of a slender hinged beam of equal elements over the exact one.

    Nodes move as ``sin(pi j / n)`` and turn as ``cos(pi j / n)``; that elements have no shear in their middle ties the
    amplitudes, and the elements' energies are sums of squares of these: with t = pi / 2 n the squared frequency is
    ``16 n^4 tan(t)^2 sin(t)^2 * 3 / (2 + cos(2 t)) EI / (rho A L^4)``, beside ``pi^4``. Infinite for a single element.
    """
    if n_elements == 1:
        return math.inf
    t = math.pi / (2 * n_elements)
    squared = 16 * n_elements**4 * (math.tan(t) * math.sin(t)) ** 2 * 3 / (2 + math.cos(2 * t))
    return math.sqrt(squared) / math.pi**2


def _slenderness(scene: Scene, name: str, size: Size) -> Iterator[Finding]:
    body, system, metre = scene.bodies[name], scene.system, scene.system.unit("m")
    entry, received = _thickness_entry(scene, body, f"bodies.{name}.section")
    if size.thickness > size.length:
        words = f"{name} is {system.text(size.thickness, 'm')} thick and {system.text(size.length, 'm')} long"
        words += "; a beam is longer than thick" if body.flexible else ""
        yield (refusal if body.flexible else doubt)(entry, f"{words} (sizes are in {metre})", *received)
    elif size.length < SLENDERNESS * size.thickness and body.flexible:
        words = f"{name} is only {size.length / size.thickness:.2g} times as long as thick; below {SLENDERNESS:g}"
        cure = "take continuum elements (solid2d, solid3d), or make it rigid"
        yield doubt(entry, f"{words} a beam does not describe it; {cure}", *received)


def _thickness_entry(scene: Scene, body: Body, entry: str) -> tuple[str, tuple[object, ...]]:
    """Return the entry that says how thick a beam is, and its value if that is one number."""
    section = body.section
    if not section.sizes:
        return entry, ()
    key = max(section.sizes[: scene.dimension - 1], key=lambda size: scene.number(getattr(section, size)))
    name, value = named(scene, f"{entry}.{key}", getattr(section, key))
    return name, (value,)


def _beam(scene: Scene, name: str, mesh: LineMesh) -> Size:
    body, section = scene.bodies[name], BeamSection.of(scene, name)
    length = float(np.max(np.ptp(mesh.nodes, axis=0)))
    axial, line_density = (float(part.at(scene.values)) for part in (section.axial, section.mass[0]))
    bending = min(float(part.at(scene.values)) for part in section.bending)
    gyration, speed = math.sqrt(bending / axial), math.sqrt(axial / line_density)
    if body.section.reach is None:
        thickness = math.sqrt(12.0) * gyration
    else:
        across = body.section.reach[: scene.dimension - 1]
        thickness = max(2.0 * float(reach.at(scene.values)) for reach in across)
    frequency = 0.5 * math.pi * (gyration / length) * (speed / length) if body.flexible else 0.0
    return Size(length, thickness, line_density * float(mesh.lengths.sum()), frequency)


def _rigid(scene: Scene, name: str, _: LineMesh) -> Size:
    given = scene.bodies[name].rigid
    return Size(given.extent(scene.number), 0.0, scene.number(given.mass), 0.0)


def _solid(scene: Scene, name: str, mesh: SolidMesh | Assembled) -> Size:
    body, extents = scene.bodies[name], np.sort(np.ptp(mesh.nodes, axis=0))[::-1]
    length, thickness = float(extents[0]), float(extents[-1])
    if isinstance(mesh, Assembled):
        mass, speed = scene.number(body.matrices.mass_scale) * mesh.properties.mass, _wave_speed(scene, body, mesh)
    else:
        density = scene.number(scene.materials[body.material].rho)
        speed = math.sqrt(scene.number(scene.materials[body.material].E) / density)
        # of the box around it, which it fills in part
        mass = density * (float(np.prod(extents)) * (scene.number(body.thickness) if body.thickness else 1.0))
    frequency = 0.5 * math.pi * thickness / math.sqrt(12.0) * speed / length**2 if body.flexible else 0.0
    return Size(length, thickness, mass, frequency)


def _wave_speed(scene: Scene, body: Body, mesh: Assembled) -> float:
    """Return the speed of waves along x, m/s."""
    given = body.matrices
    return mesh.wave_speed * math.sqrt(scene.number(given.stiffness_scale) / scene.number(given.mass_scale))


def matrix_findings(scene: Scene, meshes: Shapes, system: UnitSystem) -> Iterator[Finding]:
    """Yield matrices of materials that do not exist: as a rule of other units than the scene says."""
    shown = scene.system
    speeds = " to ".join(limit_text(shown.shown(limit / system.speed, "m/s")) for limit in WAVE_SPEEDS)
    for name, mesh in meshes.items():
        if given_properties(mesh) is None:
            continue
        body, entry = scene.bodies[name], f"bodies.{name}.matrices.units"
        units = body.matrices.units.model_dump(exclude_none=True)
        speed, box = _wave_speed(scene, body, mesh), float(np.prod(np.ptp(mesh.nodes, axis=0)))
        mass = scene.number(body.matrices.mass_scale) * mesh.properties.mass
        cure = "programs that take mm and N have mass in t"
        if not WAVE_SPEEDS[0] <= speed * system.speed <= WAVE_SPEEDS[1]:
            waves = f"with these, waves run through {name} at {shown.text(speed, 'm/s')}"
            waves += f", outside {speeds} {shown.unit('m/s')}"
            yield doubt(entry, f"{waves}, which solids have; {cure}", units)
        densest = DENSITIES[1] / system.size(DENSITY)
        if mesh.dimension == 3 and mass / box > densest:
            heavy = f"with these, {name} has {shown.text(mass, 'kg')} in a box of {shown.text(box, 'm3')}"
            most = f"more than solids have (up to {limit_text(shown.shown(densest, 'kg/m3'))} {shown.unit('kg/m3')})"
            yield doubt(entry, f"{heavy}, {most}; {cure}", units)


FORCES = ("N", "N m")  # units of loads that accelerate a mass, or turn it
FAST = 1_000.0  # m/s, several times the speed at which steel rings burst
LIGHT = 3e8  # m/s
STRONG_GRAVITY, WEAK_GRAVITY = 10.0, 20.0  # of the Earth's, and in other units than SI the Earth's of it
HEAVY = 1_000.0  # times the mass of all bodies
FAR = 0.2  # rad, or of the mechanism's size, that a first guess of a place by eye is not off
SHORTEST_STEPS = 1e-3  # steps that a stiff spring's or damper's time lasts


def load_findings(
    scene: Scene, sizes: Mapping[str, Size], system: UnitSystem, first: Callable[[], float | None]
) -> Iterator[Finding]:
    """Yield what is strange about effects; `first` returns the first frequency of the mechanism, Hz, if it can be
    had."""
    mass = sum(size.mass for size in sizes.values())
    added = [effect for effect in scene.effects.values() if isinstance(effect, AddedMass)]
    moved = mass + sum(scene.number(effect.mass) for effect in added)
    length = max((size.length for size in sizes.values()), default=0.0)
    whole = len(sizes) == len(scene.bodies)  # otherwise masses and lengths are not known
    for name, effect in scene.effects.items():
        entry = f"effects.{name}"
        yield from effect.doubts(scene, entry, {body: size.frequency_hz for body, size in sizes.items()}, first)
        if effect.is_over_time:
            for part in parts_of(name, effect).values():
                yield from _nothing(scene, entry, part)
                yield from _over_time(scene, entry, part)
                if whole and part.strength_unit in FORCES:
                    yield from _speed(scene, entry, part, moved, length, system)
            continue
        yield from _nothing(scene, entry, effect)
        if effect.uniform:
            yield from _gravity(scene, entry, effect, system)
        if isinstance(effect, AddedMass) and whole:
            where, value = named(scene, f"{entry}.mass", effect.mass)
            if value > HEAVY * mass:
                of_all, kg = scene.system.text(mass, "kg"), scene.system.unit("kg")
                words = f"more than {HEAVY:,.0f} times the {of_all} of all bodies (it is in {kg})"
                yield doubt(where, words, value)
        if effect.stiff_by:
            yield from _spring(scene, entry, effect, moved, length, whole)
    yield from _twice(scene)


def _nothing(scene: Scene, entry: str, effect: EffectEntry) -> Iterator[Finding]:
    if effect.nothing_without:
        given = getattr(effect, effect.nothing_without)
        where, value = named(scene, f"{entry}.{effect.nothing_without}", given)
        if value == 0.0 and given not in uncertain_names(scene):
            yield doubt(where, f"makes {entry} zero; leave it out", value)


def _over_time(scene: Scene, entry: str, effect: OverTime) -> Iterator[Finding]:
    duration = scene.simulation.duration
    if effect.harmonic is not None:
        if effect.harmonic.amplitude == 0.0 and effect.harmonic.mean == 0.0:
            yield doubt(f"{entry}.harmonic.amplitude", "makes it zero; leave it out", 0.0)
        return
    first, last, why = effect.table[0][0], effect.table[-1][0], ""
    if first > duration or len(effect.table) > 1 and last < 0.0:
        when = "after the run's end" if first > duration else "before the run's start"
        value = scene.system.shown(effect.table[0 if first > duration else -1][1], effect.unit_of_values)
        rows = f"all its rows, from {first:g} to {last:g} s, are {when} (simulation.duration = {duration:g} s)"
        why = f"{rows}; it is {value:g} all the time"
    elif not any(value for _, value in effect.table):
        why = "is zero in all its rows; leave it out"
    elif impulse_of(effect.table, duration, 1).whole == 0.0:
        why = f"is zero from 0 s to the run's end (simulation.duration = {duration:g} s); it never acts"
    if why:
        yield doubt(f"{entry}.table", why)


def _speed(
    scene: Scene, entry: str, effect: OverTime, mass: float, length: float, system: UnitSystem
) -> Iterator[Finding]:
    """Estimate how fast a load would make the mechanism, as one rod of all its mass, with what points carry, that
    nothing else holds."""
    duration = scene.simulation.duration
    _, scale = named(scene, f"{entry}.scale", effect.scale)
    if effect.harmonic is not None:  # of one half-wave, and of the mean
        harmonic = effect.harmonic
        impulse = abs(harmonic.amplitude) * min(duration, 1.0 / (math.pi * harmonic.frequency_hz))
        impulse += abs(harmonic.mean) * duration
        place = f"{entry}.harmonic"
    else:
        impulse, place = abs(impulse_of(effect.table, duration, 1).exact), f"{entry}.table"
    turns = not slides(scene, effect)
    inertia = mass * length / 3.0 if turns else mass
    speed = abs(scale) * impulse / inertia
    metres = speed * system.speed
    si, what = ("N m s", "torque") if turns else ("N s", "force")
    shown, unit = scene.system.text, scene.system.unit(si)
    whole = f"the mechanism, {shown(mass, 'kg')} and {shown(length, 'm')}, as fast as {shown(speed, 'm/s')}"
    words = f"its impulse of {shown(abs(scale) * impulse, si)} would make {whole}"
    if metres > LIGHT:
        yield refusal(place, f"{words}, faster than light")
    elif metres > FAST:
        yield doubt(place, f"{words}, if nothing holds it; is the {what} in {unit.removesuffix(' s')}?")


def _gravity(scene: Scene, entry: str, effect: EffectEntry, system: UnitSystem) -> Iterator[Finding]:
    where, value = named(scene, f"{entry}.acceleration", effect.acceleration)
    if value < 0.0:
        yield doubt(where, "negative: it acts against its direction; turn `direction` round instead", value)
    earth = system.gravity
    if abs(value) > STRONG_GRAVITY * earth or 0.0 < abs(value) < earth / WEAK_GRAVITY and system != SI:
        less = "more than ten times" if abs(value) > earth else f"less than 1/{WEAK_GRAVITY:g} of"
        yield doubt(where, f"{less} the Earth's {scene.system.text(earth, 'm/s2', 'g')}", value)


def _spring(
    scene: Scene, entry: str, effect: EffectEntry, mass: float, length: float, whole: bool
) -> Iterator[Finding]:
    where, stiffness = named(scene, f"{entry}.{effect.stiff_by}", getattr(effect, effect.stiff_by))
    if stiffness < 0.0:
        words = "negative: it drives the mechanism away from its rest, as a magnet or a toggle does"
        yield doubt(where, words, stiffness)
    step, step_given = scene.simulation.step, not scene.simulation.is_chosen
    inertia = mass if slides(scene, effect) else mass * length**2 / 3.0
    if whole and step_given and stiffness > 0.0 and math.sqrt(inertia / stiffness) < SHORTEST_STEPS * step:
        fast = f"so stiff that the mechanism would swing on it {1 / math.sqrt(inertia / stiffness):.3g} rad/s fast"
        cure = f"far beyond simulation.step = {step:g} s; take a joint for what does not give way"
        yield doubt(where, f"{fast}, {cure}", stiffness)


def _twice(scene: Scene) -> Iterator[Finding]:
    """Yield gravity that acts twice, and effects that are the same."""
    seen: list[tuple[str, EffectEntry]] = []
    for name, effect in scene.effects.items():
        for other, rival in seen:
            if effect.uniform and rival.uniform:
                yield doubt(f"effects.{name}", f"a second gravity; effects.{other} acts too, and both add up")
                break
            if effect == rival:
                yield doubt(f"effects.{name}", f"the same as effects.{other}; both act")
                break
        seen.append((name, effect))


DEEPEST = 1.0  # rad, or the size of the mechanism: a stop beyond is no stop


def stop_findings(scene: Scene, assembled: Callable[[], RigidKinematics] | None, size: float) -> Iterator[Finding]:
    """Yield stops that are violated at the start.

    Where a stop is on another joint than that of a coordinate, the mechanism is assembled, where its meshes are known.
    Raises `InputError` if it cannot be. The `size` is the length of the longest body, m.
    """
    coordinates = {(c.joint, slides(scene, c)): name for name, c in scene.coordinates.items() if c.joint is not None}
    system = scene.system
    for name, effect in scene.effects.items():
        if not effect.sets_in or effect.joint is None:
            continue
        slid = slides(scene, effect)
        unit, length = ("m", size) if slid else ("rad", 1.0)
        if (effect.joint, slid) in coordinates:
            start = scene.initial_state(coordinates[effect.joint, slid]).position
        elif assembled is None or scene.driven:
            continue
        else:
            kinematics = assembled()
            length, place = kinematics.size if slid else 1.0, joint_measure(kinematics.mechanism, effect)
            theta = [scene.initial_state(coordinate.name).position for coordinate in kinematics.coordinates]
            start = _value(kinematics, place["statement"], (place["a"], place["b"]), _placed(kinematics, theta))
        for key, side in effect.sets_in.items():
            if getattr(effect, key) is None:
                continue
            where, end = named(scene, f"effects.{name}.{key}", getattr(effect, key))
            depth, deepest = side * (start - end), DEEPEST * length
            if depth > 1e-9 * deepest:
                place = system.text(start, unit, ".4g")
                words = f"{effect.joint} starts at {place}, {system.text(depth, unit)} beyond this stop"
                cure = "which throws it back; move the stop or the start (simulation.initial)"
                yield (refusal if depth > deepest else doubt)(where, f"{words}, {cure}", end)


def coupling_findings(scene: Scene, assembled: Callable[[], RigidKinematics]) -> Iterator[Finding]:
    """Yield couplings whose sum counts from placements at which the mechanism does not close."""
    counting = [name for name, one in scene.joints.items() if isinstance(one, CouplingEntry) and one.from_placements]
    if not counting:
        return
    kinematics = assembled()
    guess = kinematics.mechanism.first_guess
    placed = [_value(kinematics, one.statement, one.sides, guess) for one in kinematics.coordinates]
    bounds = zip(*((-np.inf, np.inf) if one.periodic else (one.lower, one.upper) for one in kinematics.coordinates))
    closed = _placed(kinematics, np.clip(placed, *bounds))
    for coupling in (one for one in kinematics.mechanism.couplings if one.name in counting):
        for (statement, _), *sides in zip(coupling.combination.terms, coupling.sides[::2], coupling.sides[1::2]):
            away = _value(kinematics, statement, sides, closed) - _value(kinematics, statement, sides, guess)
            if not statement.is_length:
                away -= 2.0 * np.pi * np.rint(away / (2.0 * np.pi))
            if abs(away) > FAR * (kinematics.size if statement.is_length else 1.0):
                far = scene.system.text(abs(away), "m" if statement.is_length else "rad")
                words = (
                    f"counts from where bodies are placed, and as they close a joint that it names is {far} from there"
                )
                yield doubt(f"joints.{coupling.name}", f"{words}; give placements at which the mechanism closes")
                break


def _placed(kinematics: RigidKinematics, theta: Sequence[float]) -> np.ndarray:
    """Return the poses of all bodies at a configuration (n_theta,)."""
    return kinematics.poses(np.array(theta)[None])[..., 0]


def _value(kinematics: RigidKinematics, statement: Statement, sides: Sequence[Attachment], poses: np.ndarray) -> float:
    return float(kinematics.mechanism.space.measure(statement, *(side.frame_of_pose(poses) for side in sides)))


MOMENT = 1e-6  # s, or less where coordinates are fast: over it the rate of a measure is a difference


def formula_findings(scene: Scene, assembled: Callable[[], RigidKinematics]) -> Iterator[Finding]:
    """Yield formulas that have no value at the start. Raises `InputError` if the mechanism cannot be assembled."""
    named = {name: effect for name, effect in scene.effects.items() if isinstance(effect, FormulaEffect)}
    of_outputs = [name for name, entry in scene.outputs.items() if "outputs" in entry.reads]
    if not (named or of_outputs):
        return
    kinematics = assembled()
    theta, rates = start_of(scene, kinematics.mechanism)
    moment = MOMENT / max(1.0, np.max(np.abs(rates)))
    for name, effect in named.items():
        actions = effect.forces(name, kinematics.mechanism).actions()  # of one law, perhaps led by another action
        measured, acting = actions[0], actions[-1]

        def at(time: float, measured: Action = measured) -> float:
            return _value(kinematics, measured.statement, measured.sides, _placed(kinematics, theta + time * rates))

        # of a coordinate with its turns
        own = next((k for k, c in enumerate(kinematics.coordinates) if c.statement is measured.statement), None)
        s = at(0.0) if own is None else float(theta[own])
        v = (at(moment) - at(-moment)) / (2.0 * moment) if np.any(rates) else 0.0
        why = not_finite(acting, s, v, scene.values)
        if why:
            slid = slides_over(scene, effect)
            s, v = (scene.system.shown(x, unit if slid else "rad") for x, unit in ((s, "m"), (v, "m/s")))
            where = f"at the start, where s = {s:.6g}, v = {v:.6g} and t = 0; write where(...) around such places"
            yield refusal(f"effects.{name}.force", f"{why} {where}", effect.force)
    if of_outputs:
        yield from _outputs_at_start(scene, kinematics, of_outputs, theta, rates, moment)


def edge_findings(scene: Scene, assembled: Callable[[], RigidKinematics]) -> Iterator[Finding]:
    """Yield effects of plugins whose forces or potentials jump where steps end. Raises `InputError` as `effects_of`."""
    own = {name for name, effect in scene.effects.items() if not type(effect).__module__.startswith(PACKAGE)}
    if not own:
        return
    for effect in (effect for effect in effects_of(scene, assembled().mechanism) if effect.name in own):
        for action in effect.actions():
            if jump := jump_of(action, [float(one.at(scene.values)) for one in action.parameters]):
                yield doubt(f"effects.{effect.name}", jump)


def _outputs_at_start(
    scene: Scene, kinematics: RigidKinematics, names: Sequence[str], theta: np.ndarray, speed: np.ndarray, moment: float
) -> Iterator[Finding]:
    """Yield outputs of other outputs that have no finite value where the rigid mechanism starts; of accelerations,
    stresses and forces it does not know, nor of deformations of a settled start."""
    outputs, unknowns = OutputSet.of(scene, kinematics, theta), Unknowns(kinematics.mechanism)

    def frames(at: np.ndarray) -> np.ndarray:
        return unknowns.frames(unknowns.place(kinematics.poses(at[None])))[list(outputs.nodes)]

    here = frames(theta)
    rows = np.broadcast_to(theta[None, :, None], (len(here), theta.size, 1))
    whole = np.concatenate([here, rows[:, : outputs.n_frame - outputs.n_pose]], axis=1)
    rates = np.zeros_like(here)
    if np.any(speed):
        rates = (frames(theta + moment * speed) - frames(theta - moment * speed)) / (2.0 * moment)
    n = len(outputs.stresses) + outputs.n_forces
    observed = outputs.observed([whole, rates, np.zeros_like(here)], np.zeros((n, 1)), 0.0, scene.values)
    with np.errstate(all="ignore"):
        found = outputs.evaluate(observed)
    for name in names:
        reading = outputs.functions[name]
        settled = scene.initial.equilibrium and reading.needs.of_coordinates
        if models_alone(scene, name) or reading.depth(0) > 1 or settled or np.isfinite(found[name]).all():
            continue
        entry = scene.outputs[name]
        key = next(iter(entry.made_in(scene).values()), entry.type)
        own = {one: scene.system.shown(found[one][0], outputs.units[one]) for one in entry.made_in(scene)}
        parts = ", ".join(f"{one} = {value:.6g}" for one, value in own.items())
        why = "it has no finite value at the start (a division by zero, or a function where it has none)"
        yield refusal(f"outputs.{name}.{key}", f"{why}, with {parts}; write where(...) around such places")


MANY_TURNS = 1e3 * 2 * math.pi  # rad
N_LOOKED_AT = 2001  # instants of a run


def motion_findings(scene: Scene, sizes: Mapping[str, Size], system: UnitSystem) -> Iterator[Finding]:
    """Yield starts and motions that are too fast."""
    length = max((size.length for size in sizes.values()), default=0.0)
    for name, state in scene.simulation.initial.items():
        entry = f"simulation.initial.{name}"
        where, velocity = named(scene, f"{entry}.velocity", state.velocity)
        slid = name in scene.coordinates and slides(scene, scene.coordinates[name])
        yield from _fast(scene, where, velocity, None if slid else length, system, velocity)
        if abs(state.position) > MANY_TURNS and not slid:
            yield doubt(f"{entry}.position", "more than 1,000 turns; angles are in rad", state.position)
    for name, effect in scene.effects.items():
        if isinstance(effect, Driving):
            key, speed, received = effect.fastest
            moved = scene.coordinates.get(effect.coordinate)
            slid = moved is not None and slides(scene, moved)
            yield from _fast(scene, f"effects.{name}.{key}", speed, None if slid else length, system, *received)
            yield from _out_of_range(scene, name, effect)


def _out_of_range(scene: Scene, name: str, effect: Driving) -> Iterator[Finding]:
    """Yield a finding if a motion leaves the range of its coordinate, which a periodic one does not."""
    coordinate = scene.coordinates.get(effect.coordinate)
    if coordinate is None or coordinate.periodic:
        return
    angles = effect.motion(name).at(np.linspace(0.0, scene.simulation.duration, N_LOOKED_AT)).angle
    low, high = coordinate.range
    furthest = angles.min() if low - angles.min() > angles.max() - high else angles.max()
    if not low <= furthest <= high:
        unit = "m" if slides(scene, coordinate) else "rad"
        low, high = (scene.system.shown(end, unit) for end in (low, high))
        limits = f"coordinates.{effect.coordinate}.range = [{low:g}, {high:g}], where reduced runs end"
        reached = scene.system.text(furthest, unit, ".6g")
        words = f"moves {effect.coordinate} to {reached}, beyond {limits}; widen the range, or move less"
        yield doubt(f"effects.{name}", words)


def _fast(
    scene: Scene, entry: str, speed: float, length: float | None, system: UnitSystem, *received: float
) -> Iterator[Finding]:
    """Yield a finding if a body of this length, turned at this speed, is too fast at its tip; without a length it
    slides."""
    shown = scene.system
    tip = abs(speed) * (1.0 if length is None else length)
    words = f"it slides at {shown.text(tip, 'm/s')}"
    if length is not None:
        rate, of_tip = shown.text(abs(speed), "rad/s"), shown.text(tip, "m/s")
        words = f"{rate} move the tip of a body of {shown.text(length, 'm')} at {of_tip}"
    if tip * system.speed > LIGHT:
        yield refusal(entry, f"{words}, faster than light", *received)
    elif tip * system.speed > FAST:
        yield doubt(entry, f"{words}; speeds are in {shown.unit('m/s' if length is None else 'rad/s')}", *received)
