"""The reference: the model that errors are measured against, chosen by what its runs are predicted to take.

The mesh is the truth of a scene. Where its runs take longer than ``reference.budget`` allows, the component model takes
its place, with more modes than any basis that is tried; how far that model is from the mesh is then measured at as many
points as a tenth of the budget pays for, and over as much of the run. What is predicted follows from sizes alone
(`price`): the choice is the same for any number of ranks.

What experiments are about: a scene, its bodies as they come and condensed, and their rigid kinematics, made once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np

from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.components.condensing import angle_group, condensed
from pgmp_petsc.components.floating_frames import floating_shapes
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.experiments.finished import Price, duration_text, step_seconds
from pgmp_petsc.experiments.history import errors_between, floors_of, run_history
from pgmp_petsc.experiments.period import first_period
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities, why_no_full_model
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models import ComponentModel, FullModel
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.runtime.errors import InputError, RunError
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.scene import Scene

if TYPE_CHECKING:
    from mpi4py import MPI


@dataclass(frozen=True)
class Subject:
    """A scene and its bodies.

    Attributes
    ----------
    scene
        As the user gave it.
    meshes
        The mesh of every body.
    shapes
        The same, bodies of continuum cells condensed.
    kinematics
        Of the mechanism of `shapes`.
    n_modes
        Modes that bodies are condensed for.
    """

    scene: Scene
    meshes: Mapping[str, BodyShape]
    shapes: Mapping[str, BodyShape]
    kinematics: RigidKinematics
    n_modes: int

    @classmethod
    def of(cls, scene: Scene, meshes: Mapping[str, BodyShape], group: RankGroup, n_modes: int) -> Self:
        """Condense the bodies for so many modes, and follow the rigid motion. Collective on ``group.world``."""
        serving = scene.model_copy(
            update={"reduction": scene.reduction.model_copy(update={"modes": n_modes, "tolerance": None})}
        )
        shapes = condensed(serving, meshes, group, large=takes_second_order(scene))
        with agreed(group.world, "rigid kinematics"):
            kinematics = RigidKinematics(Mechanism.from_scene(scene, shapes))
        return cls(scene, meshes, shapes, kinematics, n_modes)

    def first_period(self, group: RankGroup) -> float:
        """Return the period of the first flexible mode at the start (s). Collective on ``group.world``."""
        with angle_group(self.shapes, group) as angles:
            return first_period(self.scene, self.kinematics, angles.world, angles.comm)


def takes_second_order(scene: Scene) -> bool:
    """Return whether a reduced model of the scene may have terms of second order."""
    asked = scene.reduction.model_copy(update={"second_order": True, "tolerance": None})
    try:
        check_capabilities(scene.model_copy(update={"reduction": asked}), Purpose.BUILD)
    except InputError:
        return False
    return True


CHECK_SHARE = 0.1  # of the budget, for the distance of the component model from the mesh
FEWEST_STEPS = 16  # of the mesh that tell anything about that distance
MOST_POINTS = 3


@dataclass(frozen=True)
class Reference:
    """A model to measure errors against.

    Attributes
    ----------
    model
        The full-order model on the scene's meshes, or the component model.
    price
        What its runs are predicted to take.
    why
        Which it is and why, in a sentence.
    from_mesh
        Largest difference from the mesh of every output, a share of its largest value over time, by name; empty for the
        mesh itself, and where the mesh was too dear for any run.
    """

    model: FullModel
    price: Price
    why: str
    from_mesh: Mapping[str, float]

    @property
    def is_mesh(self) -> bool:
        """Whether it is the mesh itself."""
        return not isinstance(self.model, ComponentModel)

    @property
    def about(self) -> dict[str, object]:
        """What files keep of it."""
        return {
            "model": self.model.name,
            "predicted_seconds": self.price.seconds,
            "why": self.why,
            "from_mesh": dict(self.from_mesh),
        }


def component_model(
    scene: Scene,
    meshes: Mapping[str, BodyShape],
    comm: MPI.Comm,
    n_modes: int | None = None,
    kinematics: RigidKinematics | None = None,
) -> ComponentModel:
    """Return the component model of a scene. Collective on `comm`.

    Parameters
    ----------
    n_modes
        Modes of the mechanism that its bodies' fields serve; ``reduction.modes`` by default.
    kinematics
        Of the same mechanism, where they are at hand.

    Raises
    ------
    InputError
        If a body cannot be put into a floating frame, or the scene has what such bodies do not take.
    """
    modes = scene.reduction.model_copy(update={} if n_modes is None else {"modes": n_modes})
    serving = scene.model_copy(update={"reduction": modes})
    with agreed(comm, "preparing the component model"):
        bodies = Mechanism.from_scene(scene, meshes).bodies
    shapes = floating_shapes(serving, meshes, bodies, comm)
    with agreed(comm, "preparing the component model"):
        return ComponentModel(scene, shapes, kinematics, comm.size)


@dataclass(frozen=True)
class Demand:
    """What a reference is wanted for.

    Attributes
    ----------
    entry
        Entry of the scene, or command, that needs it.
    steps
        Steps of all samples and loads together.
    cases
        What they are of, in words.
    cure
        What makes it cheaper.
    n_modes
        Modes that the component model's bodies serve.
    """

    entry: str
    steps: float
    cases: str
    cure: str
    n_modes: int


def choose_reference(
    scene: Scene, meshes: Mapping[str, BodyShape], kinematics: RigidKinematics, demand: Demand, comm: MPI.Comm
) -> Reference:
    """Choose the mesh where it is within the budget, or named, else the component model. Collective on `comm`.

    Raises
    ------
    InputError
        If neither is within the budget and none is named; or if the component model is named and there is none.
    """
    wanted, budget, missing = scene.reference.model, scene.reference.budget, why_no_full_model(scene)
    without = missing  # why it is not the mesh
    if not missing:
        with agreed(comm, "preparing the full-order model"):
            mesh = FullModel(scene, meshes, kinematics)
            of_mesh = Price(step_seconds(mesh.kinematics.mechanism), demand.steps)
        if wanted == "mesh" or wanted == "auto" and of_mesh.seconds <= budget:
            named = "as reference.model says" if wanted == "mesh" else f"within reference.budget = {budget:g} s"
            why = f"reference: the mesh; its runs are predicted to take {of_mesh} of processor time, {named}"
            return Reference(mesh, of_mesh, why, {})
        without = f"runs of the mesh would take {of_mesh}, and reference.budget = {budget:g} s"
    elif wanted == "mesh":
        raise InputError(f'reference.model = "mesh": {missing}; take "components"')
    refused = (
        f"{demand.entry}: no reference is within reference.budget = {budget:g} s of processor time: {demand.cases} "
        f"take {demand.steps:.2g} steps, {missing or f'predicted for the mesh {of_mesh}'}"
    )
    try:
        components = component_model(scene, meshes, comm, demand.n_modes, kinematics)
    except InputError as error:
        if wanted == "components":
            raise InputError(f'reference.model = "components": {error}') from error
        raise InputError(f"{refused}; there is no component model in its place: {error}") from error
    price = Price(step_seconds(components.kinematics.mechanism), demand.steps)
    if wanted == "auto" and price.seconds > budget:
        raise InputError(f"{refused}, of the component model {price}; {_cure(demand)}")
    modes = ", ".join(f"{body} {n}" for body, n in components.n_amplitudes.items())
    named = "as reference.model says" if wanted == "components" else without
    why = (
        f"reference: the component model (modes: {modes}); its runs are predicted to take {price} of processor time; "
        f"{named}"
    )
    return Reference(components, price, why, {})


def _cure(demand: Demand) -> str:
    named = 'name reference.model ("mesh" or "components") to take it at its price'
    return f"raise reference.budget, {named}, {demand.cure}"


def distance_from_mesh(
    reference: Reference,
    meshes: Mapping[str, BodyShape],
    values: Mapping[str, np.ndarray],
    n_samples: int,
    n_steps: int,
    comm: MPI.Comm,
) -> Reference:
    """Return a reference that says how far it is from the mesh. Collective on `comm`.

    Parameters
    ----------
    values
        Points to try, each of shape (n_samples,), the nominal ones first.
    n_steps
        Steps of both models over the whole run; few will do, both make the same errors with them.
    """
    if reference.is_mesh:
        return reference
    model, scene = reference.model, reference.model.scene
    if why_no_full_model(scene):
        return replace(reference, why=f"{reference.why}, and how far it is from one is not known")
    with agreed(comm, "preparing the full-order model"):
        mesh = FullModel(scene, meshes, model.kinematics)
        per_step = step_seconds(mesh.kinematics.mechanism)
    affordable = int(CHECK_SHARE * scene.reference.budget / per_step)
    if affordable < FEWEST_STEPS:
        unknown = (
            f"how far it is from the mesh is not known: {FEWEST_STEPS} steps of the mesh would take "
            f"{duration_text(FEWEST_STEPS * per_step)}; raise reference.budget, or compare pgmp simulate --components "
            "with pgmp simulate --full"
        )
        return replace(reference, why=f"{reference.why}; {unknown}")
    n_points = max(1, min(MOST_POINTS, n_samples, affordable // n_steps))
    taken = min(n_steps, affordable)
    window = scene.simulation.duration * taken / n_steps
    shorter = scene.model_copy(
        update={"simulation": scene.simulation.model_copy(update={"duration": window, "step": window / taken})}
    )
    chosen = [0, *_outermost(values, n_samples)][:n_points]
    own, found = chosen[comm.rank :: comm.size], {}
    with agreed(comm, "comparing the component model with the mesh"):
        for point in own:
            at = {name: column[point : point + 1] for name, column in values.items()}
            runs = [run_history(one.with_loads(shorter), at, 1, taken) for one in (model, mesh)]
            if any(run.status[0] != Status.FINE for run in runs):
                failed, status = (model, runs[0].status[0]) if runs[0].status[0] else (mesh, runs[1].status[0])
                raise RunError(
                    f"comparing the component model with the mesh: the {failed.title} run at {_named(at)} fails: "
                    f"{Status(status).meaning}"
                )
            found[point] = errors_between(*runs, floors_of(mesh))[:, 0]
    every = {point: errors for part in comm.allgather(found) for point, errors in part.items()}
    worst = np.nanmax([every[point] for point in chosen], axis=0)
    names = list(model.outputs.functions)
    apart = ", ".join(f"{name} {error:.2g}" for name, error in zip(names, worst))
    points = " and ".join(_named({name: column[[k]] for name, column in values.items()}) for k in chosen)
    over = "" if taken == n_steps else f" over the first {window:.3g} s of {scene.simulation.duration:g} s"
    measured = f"it is {apart} of the largest values away from the mesh at {points}{over}, {taken} steps"
    return replace(reference, why=f"{reference.why}; {measured}", from_mesh={n: float(e) for n, e in zip(names, worst)})


def _outermost(values: Mapping[str, np.ndarray], n_samples: int) -> Sequence[int]:
    """Return the points that are furthest from the first one, by the parameters' own spread, furthest first."""
    columns = [column for column in values.values() if np.ptp(column) > 0.0]
    if not columns:
        return []
    away = sum(((column - column[0]) / np.ptp(column)) ** 2 for column in columns)
    return [int(k) for k in np.argsort(-away, kind="stable")[: n_samples - 1]]


def _named(at: Mapping[str, np.ndarray]) -> str:
    return ", ".join(f"{name} = {float(column[0]):.4g}" for name, column in at.items()) or "the scene's values"
