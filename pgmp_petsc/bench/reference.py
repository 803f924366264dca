"""The reference: the model that errors are measured against, chosen by what its runs are predicted to take
(docs/method.md, the reference; what accuracy costs).

A subject is a scene, its bodies as they come and condensed, and their rigid kinematics, made once. Numbers of steps are
counted by the period of the first flexible mode at the start. Its frequency is the lowest one of the mechanism at rest,
without springs, at nominal parameters; prescribed coordinates are held. Of a mesh, or of condensed bodies, it comes
from the eigenproblem of the modes; of a reduced model from its tables; of bodies in floating frames, which move by
``u = R r + S xi`` under constraints ``C u = 0``, from

    (N^T K N - omega^2 N^T M N) y = 0,     N a basis of the null space of C [R S].
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.linalg import block_diag, eigh, null_space

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bench.history import History, errors_between, floors_of, largest_errors, run_history
from pgmp_petsc.bench.prices import Price, duration_text, step_seconds, takes_second_order
from pgmp_petsc.bodies.affine import total_at
from pgmp_petsc.bodies.component import rigid_motions
from pgmp_petsc.bodies.floating import FloatingBody
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.bodies.shape import Shapes
from pgmp_petsc.components.condensing import angle_group, condensed, floating_shapes
from pgmp_petsc.effects import start_of
from pgmp_petsc.mechanism.capabilities import why_no_full_model
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism, constraint_jacobian
from pgmp_petsc.models import ComponentModel, FullModel, Model, ReducedModel
from pgmp_petsc.models.component_file import ModelBodyFile, bodies_of, model_of
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.units import values_text
from pgmp_petsc.stepping.status import Status


@dataclass(frozen=True)
class Subject:
    """A scene and its bodies."""

    scene: Scene  # as the user gave it
    meshes: Shapes  # the mesh of every body
    shapes: Shapes  # the same, bodies of continuum cells condensed
    kinematics: RigidKinematics  # of the mechanism of `shapes`
    n_modes: int  # modes that bodies are condensed for

    @classmethod
    def of(cls, scene: Scene, meshes: Shapes, group: RankGroup, n_modes: int) -> Self:
        """Condense the bodies for so many modes, and follow the rigid motion. Collective on ``group.world``."""
        serving = scene.with_entries(reduction={"modes": n_modes, "tolerance": None})
        shapes = condensed(serving, meshes, group, large=takes_second_order(scene))
        with agreed(group.world, "rigid kinematics"):
            kinematics = RigidKinematics(Mechanism.from_scene(scene, shapes))
        return cls(scene, meshes, shapes, kinematics, n_modes)

    def first_period(self, group: RankGroup) -> float:
        """Return the period of the first flexible mode at the start (s). Collective on ``group.world``."""
        with angle_group(self.shapes, group) as angles:
            return first_period(self.scene, self.kinematics, angles.world, angles.comm)


Said = Callable[[str], None]  # what takes lines for whoever waits
CHECK_SHARE = 0.1  # of the budget, for the distance of the component model from the mesh
FEWEST_STEPS = 16  # of the mesh that tell anything about that distance
MOST_POINTS = 3
MORE_MODES = 1.5  # of the component model as a reference, for each of what is compared with it


@dataclass(frozen=True)
class Reference:
    """A model to measure errors against."""

    model: FullModel  # the full-order model on the scene's meshes, or the component model
    price: Price  # what its runs are predicted to take
    why: str  # which it is and why, in a sentence
    # largest difference from the mesh of every output, a share of its largest value over time, by name; empty for the
    # mesh itself, and where the mesh cost too much for any run
    from_mesh: Mapping[str, float]

    @property
    def is_mesh(self) -> bool:
        return not isinstance(self.model, ComponentModel)

    @property
    def about(self) -> dict[str, object]:
        """Entries of it that files keep."""
        price, apart = self.price.seconds, dict(self.from_mesh)
        return {"model": self.model.name, "predicted_seconds": price, "why": self.why, "from_mesh": apart}


def condensed_bodies(scene: Scene, meshes: Shapes, comm: Comm, n_modes: int | None = None) -> dict[str, ModelBodyFile]:
    """Return the bodies of a scene as component models have them. Collective on `comm`; parameters and errors as of
    `component_model`."""
    serving = scene if n_modes is None else scene.with_entries(reduction={"modes": n_modes})
    with agreed(comm, "preparing the component model"):
        bodies = Mechanism.from_scene(scene, meshes).bodies
    shapes = floating_shapes(serving, meshes, bodies, comm)
    with agreed(comm, "preparing the component model"):
        return bodies_of(scene, shapes)


def component_model(
    scene: Scene, meshes: Shapes, comm: Comm, n_modes: int | None = None, kinematics: RigidKinematics | None = None
) -> ComponentModel:
    """Return the component model of a scene, whose fields serve so many modes, ``reduction.modes`` by default.
    Collective on `comm`.

    Kinematics are of the same mechanism, where they are at hand. Raises `InputError` if a body cannot be put into a
    floating frame, or the scene has what such bodies do not take.
    """
    bodies = condensed_bodies(scene, meshes, comm, n_modes)
    with agreed(comm, "preparing the component model"):
        return model_of(scene, bodies, kinematics, comm.size)


@dataclass(frozen=True)
class Demand:
    """Purpose of a reference."""

    entry: str  # entry of the scene, or command, that needs it
    steps: float  # steps of all samples and loads together
    cases: str  # what they are of, in words
    cure: str  # what makes it cheaper
    n_modes: int  # modes that the component model's bodies serve
    by_itself: bool = False  # whether one run takes all the steps


def choose_reference(
    scene: Scene, meshes: Shapes, kinematics: RigidKinematics, demand: Demand, comm: Comm
) -> Reference:
    """Choose the mesh where it is within the budget, or named, else the component model. Collective on `comm`. Raises
    `InputError` if neither is within the budget and none is named; or if the component model is named and there is
    none."""
    wanted, budget, missing = scene.reference.model, scene.reference.budget, why_no_full_model(scene)
    without = missing  # why it is not the mesh
    if not missing:
        with agreed(comm, "preparing the full-order model"):
            mesh = FullModel(scene, meshes, kinematics)
            of_mesh = Price.of(mesh.kinematics.mechanism, demand.steps, demand.by_itself)
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
    price = Price.of(components.kinematics.mechanism, demand.steps, demand.by_itself)
    if wanted == "auto" and price.seconds > budget:
        named = 'name reference.model ("mesh" or "components") to take it at its price'
        raise InputError(f"{refused}, of the component model {price}; raise reference.budget, {named}, {demand.cure}")
    modes = ", ".join(f"{body} {n}" for body, n in components.n_amplitudes.items())
    named = "as reference.model says" if wanted == "components" else without
    why = (
        f"reference: the component model (modes: {modes}); its runs are predicted to take {price} of processor time; "
        f"{named}"
    )
    return Reference(components, price, why, {})


def distance_from_mesh(
    reference: Reference, meshes: Shapes, values: Mapping[str, np.ndarray], n_samples: int, n_steps: int, comm: Comm
) -> Reference:
    """Return a reference that says how far it is from the mesh. Collective on `comm`.

    Points to try are values of shape (n_samples,) each, the nominal ones first. Of steps over the whole run few will
    do: both models make the same errors with them.
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
    shorter = scene.with_entries(simulation=scene.simulation.in_steps(taken, window))
    chosen = [0, *_outermost(values, n_samples)][:n_points]
    own, found = chosen[comm.rank :: comm.size], {}
    with agreed(comm, "comparing the component model with the mesh"):
        for point in own:
            at = {name: column[point : point + 1] for name, column in values.items()}
            runs = [run_history(one.with_loads(shorter), at, 1, taken) for one in (model, mesh)]
            if any(run.status[0] != Status.FINE for run in runs):
                failed, status = (model, runs[0].status[0]) if runs[0].status[0] else (mesh, runs[1].status[0])
                raise RunError(
                    f"comparing the component model with the mesh: the {failed.title} run at {_named(scene, at)} "
                    f"fails: {Status(status).meaning}"
                )
            found[point] = errors_between(*runs, floors_of(mesh))[:, 0]
    every = {point: errors for part in comm.allgather(found) for point, errors in part.items()}
    worst = np.nanmax([every[point] for point in chosen], axis=0)
    names = list(model.outputs.functions)
    apart = ", ".join(f"{name} {error:.2g}" for name, error in zip(names, worst))
    points = " and ".join(_named(scene, {name: column[[k]] for name, column in values.items()}) for k in chosen)
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


def _named(scene: Scene, at: Mapping[str, np.ndarray]) -> str:
    return values_text(scene, {name: float(column[0]) for name, column in at.items()}, ".4g") or "the scene's values"


DEPENDENT = 1e-9  # of the largest singular value of the constraints: those below follow from others


def first_period(scene: Scene, kinematics: RigidKinematics, comm: Comm, group: Comm) -> float:
    """Return the period of meshes, beams and condensed bodies (s). Collective on `comm`; the ranks of `group` share an
    eigenproblem."""
    frequency = 0.0
    with agreed(comm, "first mode"), ModalProblem(kinematics, scene.nominal, 1, group) as problem:
        frequency = float(problem.solve(start_of(scene, kinematics.mechanism)[0]).frequencies_hz[0])
    # the first rank's: numbers of steps follow from it on all of them
    return 1.0 / comm.bcast(frequency)


def period_of(model: Model, comm: Comm) -> float:
    """Return the period of any model (s). Collective on `comm`."""
    if isinstance(model, ReducedModel):
        return on_root(comm, _of_tables, model)
    if isinstance(model, ComponentModel):
        return on_root(comm, _of_floating_bodies, model)
    return first_period(model.scene, model.kinematics, comm, comm)


def _of_tables(model: ReducedModel) -> float:
    """Return the period of a reduced model, from its tables at the sample nearest to the start."""
    tables, nominal = model.terms.tables, model.scene.nominal
    at = tables.samples.nearest(np.asarray(model.start[0])[None])
    return 1.0 / float(tables.frequencies_hz(nominal, model.kinematics.mechanism.free, lambda table: table[at])[0, 0])


def _of_floating_bodies(model: ComponentModel) -> float:
    """Return the period of bodies in floating frames."""
    kinematics, nominal = model.kinematics, model.scene.nominal
    mechanism, start = kinematics.mechanism, start_of(model.scene, kinematics.mechanism)[0]
    pose = kinematics.poses(start[None])[..., 0]
    clamped = [coordinate for coordinate in kinematics.coordinates if coordinate.prescribed]
    moved, masses, stiffnesses = [], [], []
    for body in mechanism.bodies:
        rigid = body.linear_fields()[: body.node_dofs * body.n_nodes] @ rigid_motions(np.zeros(body.dimension))
        columns = np.zeros((mechanism.n_dofs, rigid.shape[1] + body.n_amplitudes))
        columns[body.dofs[: len(rigid)], : rigid.shape[1]] = rigid
        mass, stiffness = np.zeros((2, columns.shape[1], columns.shape[1]))
        for floating in body.blocks("floating"):
            shapes = floating.shapes.reshape(-1, floating.n)
            columns[body.dofs[: len(shapes)], rigid.shape[1] :] = shapes
            mass = _inertia(floating, nominal)
            own = slice(rigid.shape[1], None)
            stiffness[own, own] = total_at(floating.stiffness, nominal)
        moved.append(columns)
        masses.append(mass)
        stiffnesses.append(stiffness)
    motion = np.hstack(moved)
    # what is not in floating frames: rigid bodies, and masses at frames
    others = AffineMatrices(mechanism.bodies, range(mechanism.n_dofs)).mass
    mass = block_diag(*masses) + sum(
        float(weight.evaluate(nominal)) * (motion.T @ (matrix @ motion)) for weight, matrix in others.items()
    )
    held = constraint_jacobian(mechanism, pose, clamped) @ motion
    free = null_space(held, rcond=DEPENDENT)
    n_rigid = len(kinematics.coordinates) - len(clamped) + kinematics.motion(start).released.shape[-1]
    stiffness = free.T @ block_diag(*stiffnesses) @ free
    values = eigh(stiffness, free.T @ mass @ free, eigvals_only=True, subset_by_index=(n_rigid, n_rigid))
    return float(2.0 * np.pi / np.sqrt(values[0]))


def _inertia(floating: FloatingBody, nominal: dict[str, float]) -> np.ndarray:
    """Return the mass of rigid motions and amplitudes of a body in a floating frame, in its own frame."""
    d = floating.centres.shape[1]
    moments, n_rigid = total_at(floating.moments, nominal), d * (d + 1) // 2
    # every component of the displacement by the scalar fields (1, X, Psi_1, .. Psi_d)
    rigid, fields = rigid_motions(np.zeros(d)), np.zeros((d, len(moments), n_rigid + floating.n))
    fields[:, 0, :n_rigid], fields[:, 1 : 1 + d, :n_rigid] = rigid[:d], rigid[d:].reshape(d, d, n_rigid)
    fields[:, 1 + d :, n_rigid:] = np.eye(d * floating.n).reshape(d, floating.n, -1).swapaxes(1, 2)
    return np.sum(fields.swapaxes(1, 2) @ moments @ fields, axis=0)


OF_SMALLEST = 0.1  # error of any setting: what the last halving may move
ORDER = 2
ROUND_OFF = 1e-12  # a move that small is none
MOST_AT_ONCE = 3  # halvings that are asked for together: a prediction by the order is no more than that


class ReferenceSequence:
    """Runs of a reference on one mesh, with steps that are halved, from a `first` number on to the most allowed; below
    `floors`, shape (n_outputs,), outputs count as zero."""

    def __init__(self, first: int, most: int, floors: np.ndarray) -> None:
        self._first, self._most, self._floors = first, max(most, 2 * first), floors
        self._runs: dict[int, History] = {}
        self.failure = ""  # why it was given up

    def add(self, n_steps: int, run: History) -> None:
        """Take in a run; the one with twice its steps comes next."""
        self._runs[n_steps] = run

    @property
    def usable(self) -> bool:
        """Whether there are two runs, so that one can tell how fine the finest is."""
        return len(self._runs) > 1

    @property
    def n_steps(self) -> int:
        return max(self._runs)

    @property
    def history(self) -> History:
        return self._runs[self.n_steps]

    @property
    def moved(self) -> np.ndarray:
        """By how much the last halving moved each output, as `largest_errors`, shape (n_outputs,)."""
        return largest_errors(self._runs[self.n_steps // 2], self.history, self._floors)

    def wanted(self, smallest: np.ndarray) -> list[int]:
        """Return the numbers of steps that are missing until the reference is fine enough, as far as one can tell from
        the smallest error of any setting in each output, shape (n_outputs,), infinite or NaN where there is none."""
        if self.failure:
            return []
        if not self.usable:
            return [self._first, 2 * self._first]
        if self.settled(smallest):
            return []
        halvings = np.ceil(np.log(self._excess(smallest)) / np.log(2**ORDER))
        finer = [self.n_steps * 2**k for k in range(1, int(np.clip(halvings, 1, MOST_AT_ONCE)) + 1)]
        return [n for n in finer if n <= self._most]

    def settled(self, smallest: np.ndarray) -> bool:
        """Whether the last halving moved every output by less than a tenth of its smallest error."""
        return not self._excess(smallest) >= 1.0

    def reason(self, smallest: np.ndarray) -> str:
        if self.failure:
            return f"a finer run failed: {self.failure}"
        if self.settled(smallest):
            return f"the last halving moved no output by {OF_SMALLEST:g} of its smallest error"
        return "the finest step that is allowed"

    def _excess(self, smallest: np.ndarray) -> float:
        """Return the move over the allowed one, the largest of any output."""
        wanted = OF_SMALLEST * np.where(np.isnan(smallest), np.inf, smallest)
        known = np.isfinite(self.moved) & (self.moved > ROUND_OFF)
        with np.errstate(divide="ignore"):
            return float(np.max(self.moved[known] / wanted[known], initial=0.0))
