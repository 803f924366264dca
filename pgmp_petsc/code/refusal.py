"""What a model in C does not have, named by its entry in the scene."""

from __future__ import annotations

from collections.abc import Iterator

from pgmp_petsc.effects.laws import SPRING_DAMPER
from pgmp_petsc.mechanism.statements import ANGLE
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.lengths import length_names

OUTPUTS = ("angle", "rotation", "position", "displacement", "deformation", "distance", "sliding")
HAS = "has torques, forces of constant direction, gravity, viscous damping in turning joints and structural damping"


def check_scene(scene: Scene, what: str) -> None:
    """Raise `InputError` if a scene asks for what a model in C does not have.

    Parameters
    ----------
    what
        What is to be written, for the message.
    """
    for entry, text in _of_scene(scene):
        raise InputError(f"{entry}: {text}; {what} cannot be written. Take pgmp simulate for this model")


def check_model(model: ReducedModel, what: str) -> None:
    """Raise `InputError` if a model has local effects or poses that a model in C does not have."""
    for action in model.actions.actions:
        plain = action.law == SPRING_DAMPER and not action.is_spring and action.statement.kind == ANGLE
        if not plain:
            kind = model.scene.effects[action.effect].type
            raise InputError(
                f"effects.{action.effect}: a {kind} that depends on where the mechanism is; a model in C {HAS}, so "
                f"{what} cannot be written. Build without it"
            )
    if not model.rom.branch.is_exact:
        raise InputError(
            f"coordinates: the table of rigid poses does not close the loops to the last digit near a dead centre, and "
            f"a model in C has nothing else; {what} cannot be written"
        )


def _of_scene(scene: Scene) -> Iterator[tuple[str, str]]:
    if scene.dimension != 2:
        yield "scene.dimension = 3", "a model in C is one of the plane"
    if len(scene.coordinates) != 1:
        yield "coordinates", f"a model in C has one rigid coordinate, not {len(scene.coordinates)}"
    for name in length_names(scene):
        yield f"parameters.{name}", "a length or a place; a model in C has one mechanism: build with its number"
    if scene.fields:
        yield f"fields.{next(iter(scene.fields))}", "a model in C has no random fields"
    for name, effect in scene.effects.items():
        if effect.type == "prescribed_motion":
            yield f"effects.{name}", f"a prescribed_motion; a model in C {HAS}"
    if not scene.gyroscopic:
        name = next(name for name, effect in scene.effects.items() if effect.type == "gyroscopic")
        yield f"effects.{name}", "a model in C always has the inertia forces quadratic in velocities"
    if scene.initial.equilibrium:
        yield "initial.equilibrium", "a model in C starts undeformed"
    for name, output in scene.outputs.items():
        if output.type not in OUTPUTS:
            yield f"outputs.{name}", f"an output of type {output.type}; a model in C has {', '.join(OUTPUTS)}"
    if scene.simulation.tolerance is not None:
        yield "simulation.tolerance", "the step of a model in C is a constant; give simulation.step in the build"
