"""Settings of the computation: steps against durations and frequencies, sizes of tables, and entries that serve
nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from pydantic import BaseModel

from pgmp_petsc.mechanism.kinematics import MOST_COORDINATES
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.fields import GROUND, split_point
from pgmp_petsc.scene.joints import ORIGIN
from pgmp_petsc.scene.lengths import length_names
from pgmp_petsc.scene.uses import uses_of
from pgmp_petsc.studies.plausibility.bodies import Size
from pgmp_petsc.studies.plausibility.finding import Finding, doubt, refusal

FEW_STEPS = 10  # of a run
MANY_STEPS = 1e7
STEPS_A_PERIOD = 3  # of a body's first bending; with fewer a motion cannot be told from its alias
SMALL_RANGE = 1e-3  # rad
LARGE_TABLES, LARGEST_TABLES = 16e9, 1e12  # bytes
BYTES = 8
Frequency = Callable[[], float | None]


def setting_findings(scene: Scene, sizes: Mapping[str, Size], first: Frequency) -> Iterator[Finding]:
    """Yield settings that do not go together; `first` returns the first frequency of the mechanism, Hz, if it can be
    had."""
    simulation = scene.simulation
    if simulation.tolerance is None or "step" in simulation.model_fields_set:
        yield from _steps(scene, sizes, first)
    for name, coordinate in scene.coordinates.items():
        low, high = coordinate.range
        if high - low < SMALL_RANGE:
            yield doubt(
                f"coordinates.{name}.range",
                "hardly a range; it is in rad, and a run ends where it leaves it",
                list(coordinate.range),
            )
    yield from _tables(scene)
    yield from _without_effect(scene)
    if not scene.outputs:
        yield doubt("outputs", "none: a run reports nothing, and an ensemble has no statistics; add [outputs.NAME]")


def _steps(scene: Scene, sizes: Mapping[str, Size], first: Frequency) -> Iterator[Finding]:
    simulation = scene.simulation
    step, n_steps = simulation.step, simulation.duration / simulation.step
    if n_steps <= 1.0:
        yield refusal(
            "simulation.step", f"one step for the whole run of {simulation.duration:g} s; take a smaller one", step
        )
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
                yield doubt(
                    "simulation.step",
                    f"{what} {frequency:.3g} Hz, of which a period has {1 / (step * frequency):.2g} steps; at least "
                    f"{STEPS_A_PERIOD} are needed to see it: take {0.05 / frequency:.1g} s",
                    step,
                )


def _tables(scene: Scene) -> Iterator[Finding]:
    reduction = scene.reduction
    if reduction.tolerance is not None and not {"modes", "angles"} <= reduction.model_fields_set:
        return
    n_vectors, n = reduction.modes + reduction.parameter_modes, len(scene.coordinates)
    if n > MOST_COORDINATES:
        return  # a build is refused, and nothing else has tables
    count = float(reduction.angles) ** n
    n_bytes = BYTES * count * n_vectors**2 * (n_vectors if scene.second_order else 1)
    words = (
        f"{count:.3g} configurations with {n_vectors} vectors each make tables of at least {n_bytes / 1e9:.3g} GB; "
        "take fewer angles or modes"
    )
    if n_bytes > LARGEST_TABLES:
        yield refusal("reduction.angles", words, reduction.angles)
    elif n_bytes > LARGE_TABLES:
        yield doubt("reduction.angles", words, reduction.angles)


def _without_effect(scene: Scene) -> Iterator[Finding]:
    """Yield settings other than the defaults that work with another one, which the scene does not have."""
    reduction = scene.reduction
    chosen = reduction.tolerance is not None or reduction.effects == "auto"  # then second_order may be
    if reduction.stretching == "static" and not reduction.second_order and not chosen:
        yield doubt("reduction.stretching", "without effect, as reduction.second_order is false", reduction.stretching)
    if _is_set(reduction, "max_angles") and reduction.sampling_tolerance is None:
        yield doubt(
            "reduction.max_angles", "without effect, as there is no reduction.sampling_tolerance", reduction.max_angles
        )
    if _is_set(reduction, "length_points") and not length_names(scene):
        why = "without effect, as no parameter is a length or a place"
        yield doubt("reduction.length_points", why, reduction.length_points)
    ensemble = scene.ensemble
    if _is_set(ensemble, "replicates") and ensemble.sampler not in ("sobol", "saltelli"):
        own = f'without effect, as ensemble.sampler = "{ensemble.sampler}"'
        why = f'{own}; it is for "sobol" and "saltelli" (--sampler)'
        yield doubt("ensemble.replicates", why, ensemble.replicates)
    if _is_set(ensemble, "band_samples") and not ensemble.bands:
        yield doubt("ensemble.band_samples", "without effect, as ensemble.bands = 0", ensemble.band_samples)


def _is_set(settings: BaseModel, name: str) -> bool:
    """Return whether an entry differs from its default."""
    return getattr(settings, name) != type(settings).model_fields[name].default


def unused_findings(scene: Scene) -> Iterator[Finding]:
    """Yield parameters, materials and ground points that nothing uses."""
    parameters = {use.parameter for use in uses_of(scene)}
    for name in scene.parameters:
        if name not in parameters:
            yield doubt(f"parameters.{name}", "nothing uses it: no entry holds its name; leave it out")
    materials = {material for body in scene.bodies.values() for material in (body.material, *body.regions.values())}
    for name in scene.materials:
        if name not in materials:
            yield doubt(f"materials.{name}", "no body is made of it; leave it out")
    ground = {point for owner, point in map(split_point, _addresses(scene)) if owner == GROUND}
    for name in scene.ground.points:
        if name not in ground and name != ORIGIN:
            yield doubt(f"ground.points.{name}", "nothing is attached to it; leave it out")


def _addresses(scene: Scene) -> Iterator[str]:
    for joint in scene.joints.values():
        yield from joint.connect
    for effect in scene.effects.values():
        yield from getattr(effect, "points", None) or ()
        for key in ("point", "towards"):
            if getattr(effect, key, None) is not None:
                yield getattr(effect, key)
