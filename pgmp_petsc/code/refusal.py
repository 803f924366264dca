"""What a model in C does not have, named by its entry in the scene."""

from __future__ import annotations

from collections.abc import Iterator

from pgmp_petsc.mechanism.kinematics import MOST_COORDINATES
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import Scene

OUTPUTS = ("angle", "rotation", "position", "displacement", "deformation", "distance", "sliding")


def checked_scene(scene: Scene, what: str) -> Scene:
    """Return a scene without the outputs that a model in C does not have; raise `InputError` if it asks for more.

    Parameters
    ----------
    what
        What is to be written, for the message.
    """
    for entry, text in _of_scene(scene):
        raise InputError(f"{entry}: {text}; {what} cannot be written. Take pgmp simulate for this model")
    left = {name: output for name, output in scene.outputs.items() if output.type in OUTPUTS}
    return scene if len(left) == len(scene.outputs) else scene.model_copy(update={"outputs": left})


def left_out(scene: Scene) -> str:
    """Say which outputs of a scene a model in C leaves out; empty where it has them all."""
    lacking = [f"outputs.{name} ({entry.type})" for name, entry in scene.outputs.items() if entry.type not in OUTPUTS]
    if not lacking:
        return ""
    return f"note: {', '.join(lacking)} left out: a model in C has {', '.join(OUTPUTS)}; pgmp simulate has all outputs"


def check_model(model: ReducedModel, what: str) -> None:
    """Raise `InputError` if a model has local effects whose laws a model in C does not have."""
    for number in model.actions.edges:
        name = model.actions.actions[number].effect
        raise InputError(
            f"effects.{name}: an {model.scene.effects[name].type}, whose contact is searched within a step; a model in "
            f"C does the same work in every step, so {what} cannot be written. Build without it"
        )


def _of_scene(scene: Scene) -> Iterator[tuple[str, str]]:
    if len(scene.coordinates) > MOST_COORDINATES:
        yield "coordinates", f"a model in C has one or two rigid coordinates, not {len(scene.coordinates)}"
    if scene.fields:
        yield f"fields.{next(iter(scene.fields))}", "a model in C has no random fields"
    if scene.initial.equilibrium:
        yield "initial.equilibrium", "a model in C starts undeformed"
    if scene.simulation.tolerance is not None:
        yield "simulation.tolerance", "the step of a model in C is a constant; give simulation.step in the build"
