"""Materials, and sizes, proportions and first frequencies of bodies."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.base.errors import PgmpError
from pgmp_petsc.base.surroundings import alone
from pgmp_petsc.base.units import DENSITIES, DENSITY, STRESS, WAVE_SPEEDS, UnitSystem, exists
from pgmp_petsc.bodies.assembled import Assembled
from pgmp_petsc.bodies.sections.section import BeamSection
from pgmp_petsc.bodies.shape import BodyShape, Shapes, given_properties, shape_in_scene
from pgmp_petsc.effects import start_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mesh.meshes import LineMesh, SolidMesh
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.bodies import Body, Material, Rigid
from pgmp_petsc.scene.messages import Finding, doubt, named, refusal
from pgmp_petsc.scene.parameters import spanning_values, uncertain_names
from pgmp_petsc.scene.units import own_values

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
        return plain(shown.shown(value, "kg/m3"))

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
            ends = " to ".join(plain(shown.shown(limit, "m/s")) for limit in (slowest, fastest))
            steel = plain(shown.shown(210e9 / system.size(STRESS), "Pa"))
            steel = f"E is in {shown.unit('Pa')}: steel has {steel}"
            yield doubt(modulus_entry, f"{waves}, outside {ends} {of_speed}; {steel}", modulus)


def plain(value: float) -> str:
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
        mass, speed = scene.number(body.matrices.mass_scale) * mesh.properties.mass, _speed(scene, body, mesh)
    else:
        density = scene.number(scene.materials[body.material].rho)
        speed = math.sqrt(scene.number(scene.materials[body.material].E) / density)
        # of the box around it, which it fills in part
        mass = density * (float(np.prod(extents)) * (scene.number(body.thickness) if body.thickness else 1.0))
    frequency = 0.5 * math.pi * thickness / math.sqrt(12.0) * speed / length**2 if body.flexible else 0.0
    return Size(length, thickness, mass, frequency)


def _speed(scene: Scene, body: Body, mesh: Assembled) -> float:
    """Return the speed of waves along x, m/s."""
    given = body.matrices
    return mesh.wave_speed * math.sqrt(scene.number(given.stiffness_scale) / scene.number(given.mass_scale))


def matrix_findings(scene: Scene, meshes: Shapes, system: UnitSystem) -> Iterator[Finding]:
    """Yield matrices of materials that do not exist: as a rule of other units than the scene says."""
    shown = scene.system
    speeds = " to ".join(plain(shown.shown(limit / system.speed, "m/s")) for limit in WAVE_SPEEDS)
    for name, mesh in meshes.items():
        if given_properties(mesh) is None:
            continue
        body, entry = scene.bodies[name], f"bodies.{name}.matrices.units"
        units = body.matrices.units.model_dump(exclude_none=True)
        speed, box = _speed(scene, body, mesh), float(np.prod(np.ptp(mesh.nodes, axis=0)))
        mass = scene.number(body.matrices.mass_scale) * mesh.properties.mass
        cure = "programs that take mm and N have mass in t"
        if not WAVE_SPEEDS[0] <= speed * system.speed <= WAVE_SPEEDS[1]:
            waves = f"with these, waves run through {name} at {shown.text(speed, 'm/s')}"
            waves += f", outside {speeds} {shown.unit('m/s')}"
            yield doubt(entry, f"{waves}, which solids have; {cure}", units)
        densest = DENSITIES[1] / system.size(DENSITY)
        if mesh.dimension == 3 and mass / box > densest:
            heavy = f"with these, {name} has {shown.text(mass, 'kg')} in a box of {shown.text(box, 'm3')}"
            most = f"more than solids have (up to {plain(shown.shown(densest, 'kg/m3'))} {shown.unit('kg/m3')})"
            yield doubt(entry, f"{heavy}, {most}; {cure}", units)
