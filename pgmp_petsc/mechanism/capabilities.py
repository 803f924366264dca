"""Needs of each feature: of the bodies, of the number of coordinates, and of the command; compared in one place.

A feature is declared once, in `FEATURES`: the entries of a scene that ask for it, the commands that it is made for, and
the kinds of mechanism that it takes. Every command passes `check_capabilities` where it gets its scene
(`studies.inputs`), and so does every build. What does not fit a scene whatever is done with it, effects of the plane
in space for one, is refused with the scene (`scene.references`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import Enum

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.sections.section import BeamSection
from pgmp_petsc.bodies.shape import Shapes
from pgmp_petsc.mechanism.kinematics import MOST_COORDINATES, MOST_FOLLOWED
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.schema import ANGLES_OF_SEVERAL
from pgmp_petsc.scene.uses import length_uses

BYTES = 8
# of an eigenproblem with 15 modes on one core, measured from 36 to 3006 unknowns
SECONDS, SECONDS_PER_UNKNOWN = 6e-3, 1.6e-5
MOST_HOURS, MOST_BYTES = 10.0, 16e9  # of the build over a grid of three coordinates


class Purpose(Enum):
    """Purpose for which a scene is read; the value is its name in messages."""

    CHECK = "pgmp check"
    SIZES = "pgmp check --effects"
    BUILD = "pgmp build"
    MODES = "pgmp modes"
    REDUCED = "a reduced run"
    FULL = "a full-order run"
    COMPONENTS = "a component run"
    TRADEOFF = "pgmp tradeoff"
    EXPORT = "pgmp export"


#: What prepares or uses a reduced model; ``check`` foretells it.
OF_THE_REDUCTION = frozenset({Purpose.CHECK, Purpose.SIZES, Purpose.BUILD, Purpose.REDUCED, Purpose.TRADEOFF})
EVERYWHERE = frozenset(Purpose) - {Purpose.EXPORT}  # where models in Python run
#: What goes over all configurations of the coordinates.
OVER_CONFIGURATIONS = EVERYWHERE - {Purpose.CHECK, Purpose.FULL, Purpose.COMPONENTS, Purpose.TRADEOFF}


@dataclass(frozen=True)
class Feature:
    """A feature and what it needs."""

    #: yields what in a scene asks for it, in the words of the scene; nothing where it is not asked for
    entries: Callable[[Scene], Iterable[str]]
    purposes: frozenset[Purpose]  # what it is used for; for others it is without effect, and allowed
    #: whether it takes the third derivative of the strain energy, which bodies with a scaled cross-section and those
    #: from matrices have not
    third_derivative: bool = False
    elements: bool = False  # whether it takes the elements of all bodies: flexible ones from matrices are refused
    flexible_body: bool = False  # whether mechanisms without any flexible body are refused
    why_not: str = ""  # why it is refused for every mechanism; empty where it is not
    cure: str = "leave it out"  # what to do where it is refused


def _reduction(key: str) -> Callable[[Scene], Iterator[str]]:
    return lambda scene: _given(f"reduction.{key}", getattr(scene.reduction, key))


def _given(entry: str, value: float | bool | None) -> Iterator[str]:
    if value:
        yield f"{entry} = {'true' if value is True else format(value, 'g')}"


def _stretching_by_itself(scene: Scene) -> Iterator[str]:
    for name, effect in scene.effects.items():
        if effect.is_stretching not in (None, "static"):
            yield f'effects.{name}.stretching = "{effect.is_stretching}"'


def _automatic(scene: Scene) -> Iterator[str]:
    if scene.reduction.effects == "auto":
        yield 'reduction.effects = "auto"'


def _lengths(scene: Scene) -> Iterator[str]:
    for use in length_uses(scene):
        if use.parameter is not None:
            yield f'{use.entry} = "{use.parameter}"'


def _elastic(scene: Scene) -> Iterator[str]:
    return (f"joints.{name}.{joint.gives_way}" for name, joint in scene.joints.items() if joint.gives_way)


def _loose(scene: Scene) -> Iterator[str]:
    return iter(scene.loose)


def _off(scene: Scene) -> Iterator[str]:
    at_rest = scene.initial.equilibrium
    return (f"joints.{name}.offset" for name, one in scene.joints.items() if one.offset is not None and not at_rest)


def _rigid_of_several_factors(scene: Scene) -> Iterator[str]:
    for name, body in scene.bodies.items():
        if not body.flexible and body.rigid is None and body.element == "beam3d":
            factors = sorted(BeamSection.of(scene, name).terms("mass"))
            if len(factors) > 1:
                yield f"bodies.{name}.flexible = false, of a mass with the factors {', '.join(map(str, factors))}"


def _with(
    joints: Callable[[Scene], Iterable[str]], which: Callable[[Scene], Iterable[str]]
) -> Callable[[Scene], Iterator[str]]:
    """Return what finds entries of a scene beside its elastic joints."""
    return lambda scene: (f"{one} with {entry}" for one in which(scene) for entry in joints(scene))


def _of_second_order(scene: Scene) -> Iterator[str]:
    return (f"effects.{name}" for name, effect in scene.effects.items() if effect.second_order)


FEATURES = (
    Feature(
        lambda scene: (entry for entry in _lengths(scene) if scene.simulation.tolerance is not None),
        EVERYWHERE - {Purpose.CHECK, Purpose.BUILD},
        why_not="simulation.tolerance finds the step of one mechanism",
        cure="give it a number (--override), or simulation.step; pgmp build finds one for the extreme lengths too",
    ),
    Feature(
        lambda scene: (entry for entry in _lengths(scene) if scene.reduction.effects == "auto"),
        OF_THE_REDUCTION,
        why_not="effects are chosen for one mechanism",
        cure='give it a number (--override), or leave reduction.effects = "auto" out',
    ),
    Feature(_reduction("second_order"), OF_THE_REDUCTION, third_derivative=True),
    Feature(
        lambda scene: _given("simulation.tolerance", scene.simulation.tolerance),
        EVERYWHERE - {Purpose.MODES},
        flexible_body=True,
        cure="leave it out, and give simulation.step",
    ),
    Feature(_automatic, OF_THE_REDUCTION, third_derivative=True),
    Feature(_of_second_order, OF_THE_REDUCTION | {Purpose.COMPONENTS}, third_derivative=True),
    Feature(
        _stretching_by_itself,
        frozenset({Purpose.COMPONENTS}),
        why_not="bodies in floating frames follow their shortening at once",
        cure='take "static", or pgmp simulate --full',
    ),
    Feature(
        _loose,
        frozenset({Purpose.SIZES}),
        why_not="sizes of effects are those on joints without room",
        cure="take pgmp check without --effects",
    ),
    Feature(
        _with(_loose, _automatic),
        OF_THE_REDUCTION,
        why_not="effects are chosen for joints without room",
        cure="name them in [effects]",
    ),
    Feature(
        _with(_loose, lambda scene: _given("initial.equilibrium", scene.initial.equilibrium)),
        EVERYWHERE - {Purpose.MODES},
        why_not="in the middle of its room nothing holds a pin, and statics do not find where it comes to rest",
        cure="leave it out, and let damping bring the run to rest",
    ),
    Feature(
        _with(_loose, _off),
        EVERYWHERE - {Purpose.MODES},
        why_not="runs begin with what is built in without loads, and parts with room around them rest nowhere then",
        cure="leave it out",
    ),
    Feature(
        _rigid_of_several_factors,
        EVERYWHERE,
        why_not="a rigid body in space has a mass with one factor",
        cure="give the section without parameters, or make it flexible",
    ),
    Feature(
        _with(_elastic, _reduction("preload")),
        frozenset({Purpose.MODES}),
        why_not="the work of loads on motions of second order is not known of what elastic joints release",
    ),
    Feature(
        lambda scene: (Purpose.FULL.value,),
        frozenset({Purpose.FULL}),
        elements=True,
        cure="take pgmp simulate SCENE --components, or a reduced model",
    ),
    Feature(
        lambda scene: (Purpose.TRADEOFF.value,),
        frozenset({Purpose.TRADEOFF}),
        elements=True,
        cure="compare reduced runs with pgmp simulate SCENE --components",
    ),
    Feature(
        lambda scene: (Purpose.SIZES.value,),
        frozenset({Purpose.SIZES}),
        third_derivative=True,
        cure="take pgmp check without --effects",
    ),
)


def check_capabilities(scene: Scene, purpose: Purpose, meshes: Shapes | None = None) -> None:
    """Refuse what a command cannot do with a scene that is read for a purpose.

    Raises `InputError`, as `why_refused` says.
    """
    refused = why_refused(scene, purpose, meshes)
    if refused:
        raise InputError(refused)


def why_refused(scene: Scene, purpose: Purpose, meshes: Shapes | None = None) -> str:
    """Return why a command refuses a scene, naming the entry, the bodies or coordinates that it does not take, and the
    cure; empty where it takes it.

    Meshes of the bodies are given where they are at hand: what too many coordinates would cost depends on them.
    """
    n, names = len(scene.coordinates), ", ".join(scene.coordinates)
    if n > MOST_COORDINATES and purpose is Purpose.SIZES:
        return (
            f"pgmp check --effects: {n} independent coordinates were given, {names}; at most {MOST_COORDINATES} are "
            "taken; take pgmp check without --effects"
        )
    if n > MOST_FOLLOWED and purpose in OVER_CONFIGURATIONS and meshes is not None:
        refused = why_no_grid(scene, Mechanism.from_scene(scene, meshes))
        if refused:
            return refused
    flexible = any(body.flexible for body in scene.bodies.values())
    if not flexible and purpose in (Purpose.BUILD, Purpose.MODES, Purpose.REDUCED, Purpose.TRADEOFF):
        return "bodies: all are rigid, so there is nothing to reduce; run pgmp simulate SCENE --full instead"
    for feature in FEATURES:
        for entry in feature.entries(scene) if purpose in feature.purposes else ():
            why_not = feature.why_not or _why_not_bodies(scene, feature, flexible)
            if why_not:
                return f"{entry}: {why_not}; {feature.cure}"
    return ""


def foretold(scene: Scene) -> Iterator[str]:
    """Yield the commands and runs that refuse a scene as such, with the reason and the cure."""
    told: dict[str, list[str]] = {}
    for feature in FEATURES:
        if feature.why_not:
            reason = next((f"{entry}: {feature.why_not}; {feature.cure}" for entry in feature.entries(scene)), None)
            for purpose in Purpose if reason else ():
                if purpose in feature.purposes:
                    told.setdefault(reason, []).append(purpose.value)
    return (f"{', '.join(purposes)}: {reason}" for reason, purposes in told.items())


def _why_not_bodies(scene: Scene, feature: Feature, flexible: bool) -> str:
    """Say which bodies do not have what a feature takes; empty where all have it."""
    if feature.flexible_body and not flexible:
        return "for mechanisms with a flexible body, but all are rigid"
    scaled = [f"bodies.{name}.section_scale" for name, body in scene.bodies.items() if body.section_scale is not None]
    given, energy, third = _from_matrices(scene), feature.third_derivative, "the third derivative of the strain energy"
    taken = (
        (feature.elements, "takes the elements of bodies, of which large displacements have other matrices", given),
        (energy, f"not known of scaled cross-sections, of which {third} has other powers of the scale", scaled),
        (energy, f"takes {third}, which matrices do not tell", given),
    )
    for is_taken, why, found in taken:
        if is_taken and found:
            return f"{why}, but there is {', '.join(found)}"
    return ""


def _from_matrices(scene: Scene) -> list[str]:
    """Return the entries of flexible bodies from matrices."""
    return [
        f"bodies.{name}.matrices" for name, body in scene.bodies.items() if body.matrices is not None and body.flexible
    ]


def comparing(scene: Scene) -> str:
    """Return what to do for a comparison with the full-order model, which bodies from matrices have none of."""
    if why_no_full_model(scene):
        return f"give {', '.join(_from_matrices(scene))} a mesh, and compare with the full-order model of that"
    return "compare with the full-order model (pgmp simulate SCENE --full)"


def why_no_full_model(scene: Scene) -> str:
    """Return why a scene has no full-order model; empty where it has one."""
    given = _from_matrices(scene)
    return f"there is no full-order model with {', '.join(given)}" if given else ""


def why_no_grid(scene: Scene, mechanism: Mechanism) -> str:
    """Return why the coordinates of a scene are not sampled on a grid, with the price and the cure; empty where they
    can be."""
    reduction, n, names = scene.reduction, len(scene.coordinates), ", ".join(scene.coordinates)
    # a choice by a tolerance finds them, and is priced as a scene that says nothing; adaptive sampling halves their
    # distances at least once
    is_open = reduction.tolerance is not None and "angles" not in reduction.model_fields_set
    angles = ANGLES_OF_SEVERAL.get(n, reduction.angles) if is_open else reduction.angles
    angles *= 1 if reduction.sampling_tolerance is None else 2
    n_modes, count = reduction.modes, float(angles) ** n
    tables = len(mechanism.mass_weights) * ((n + n_modes) ** 2 + n * n * n_modes)
    tables += len(mechanism.stiffness_weights) * n_modes**2
    n_bytes = count * (tables + mechanism.n_dofs * n_modes) * BYTES
    hours = count * (SECONDS + SECONDS_PER_UNKNOWN * mechanism.n_dofs) / 3600
    before, doubled = angles, ""
    if scene.reduction.sampling_tolerance is not None:
        before, doubled = angles // 2, ", doubled by reduction.sampling_tolerance,"
    dear = (
        f"reduction.angles = {before} along each{doubled} would make {angles}^{n} = {count:.3g} "
        f"configurations: about {hours:.3g} hours of eigenproblems on one rank, and {n_bytes / 1e9:.3g} GB of tables "
        "and modes"
    )
    cure = "pgmp simulate SCENE --components or --full"
    if n > MOST_COORDINATES:
        return (
            f"coordinates: {names}: {n} independent coordinates were given; at most {MOST_COORDINATES} are taken. "
            f"{dear}. Take {cure}, or join bodies until {MOST_COORDINATES} coordinates are left"
        )
    if n > MOST_FOLLOWED and (hours > MOST_HOURS or n_bytes > MOST_BYTES):
        return (
            f"coordinates: {names}: {dear}; {MOST_HOURS:g} hours and {MOST_BYTES / 1e9:g} GB are the most for a grid. "
            f"Take fewer reduction.angles or reduction.modes, or {cure}"
        )
    return ""
