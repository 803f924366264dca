"""``effects = "auto"``: the effects of a scene that matter, by the estimate of `effect_sizes`.

Left out are named effects whose share is below the tolerance, other than those that a scene is about (loads that drive
it, masses, stops). Of the reduced model's own terms, forces by velocities and what is of second order in the
deformation come and go by their size. No load is ever added that the scene does not name: the report warns of those.
"""

from __future__ import annotations

from collections.abc import Mapping

from pgmp_petsc.bodies.component import Component
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.results.effect_sizes import EffectSizes
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import GeometricStiffening, Gyroscopic, ModeInertia
from pgmp_petsc.studies.effect_sizes import TERMS, estimate_effects


def choose_effects(
    scene: Scene, meshes: Mapping[str, BodyShape], shapes: Mapping[str, BodyShape]
) -> tuple[Scene, EffectSizes]:
    """Return the scene with the effects that matter, and the estimate that chose them; on one rank.

    Parameters are those of `estimate_effects`.

    Raises
    ------
    InputError, RunError
        As `estimate_effects`.
    """
    sizes = estimate_effects(scene, meshes, shapes=shapes)
    keeps = {kind: False for kind in TERMS} | {size.kind: size.keeps for size in sizes.sizes if size.kind in TERMS}
    kept = {size.name for size in sizes.sizes if size.name and size.keeps and size.kind not in TERMS}
    effects = {name: effect for name, effect in scene.effects.items() if name in kept}
    given = {effect.type: (name, effect) for name, effect in scene.effects.items() if effect.type in TERMS}
    wanted = []
    if not keeps["gyroscopic"]:
        wanted.append(Gyroscopic(type="gyroscopic", keep=False))
    second_order = scene.reduction.second_order
    if not second_order and keeps["geometric_stiffening"]:
        stretching = "static" if all(_has_long_axis(shape) for shape in shapes.values()) else "dynamic"
        stiffening = GeometricStiffening(type="geometric_stiffening", stretching=stretching)
        wanted += [stiffening, ModeInertia(type="mode_inertia")]
    for term in wanted:
        name, effect = given.get(term.type, (_free_name(term.type, effects), term))
        effects[name] = term if term.type == "gyroscopic" else effect
    reduction = scene.reduction.model_copy(
        update={"effects": "named", "second_order": second_order and keeps["geometric_stiffening"]}
    )
    return scene.model_copy(update={"effects": effects, "reduction": reduction}), sizes


def _has_long_axis(shape: BodyShape) -> bool:
    """Return whether static stretching of a body is told from its bending."""
    return not isinstance(shape, Component) or shape.large is None or shape.large.slender


def _free_name(wanted: str, taken: Mapping[str, object]) -> str:
    while wanted in taken:
        wanted += "_"
    return wanted
