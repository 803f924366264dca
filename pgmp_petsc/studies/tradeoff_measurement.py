"""Measuring one setting on one rank: build or prepare, run at the test values, take times.

Times are taken by the wall and by the processor, of this process alone. *Offline* is what comes before the first
sample: condensing bodies of cells, the build of a reduced model and its preparation, the preparation of another model,
the runs at a response surface's nodes and the interpolation. *Online* is what a sample costs after that, as an ensemble
does it: integration to the end time and the outputs there; of a response surface the outputs over time. A sample alone
is a batch of one. A run that is predicted to take longer than `TIMED` is timed with fewer samples, and then by its
first steps: a step costs what the others do.

Parameter values of the trade-off study: where errors are measured, and where a response surface has its nodes.

Test values are quantiles of the distributions, spread over all of them by a Latin hypercube with a fixed seed; the
nodes lie elsewhere. Where bounds cut a distribution off, so do they here: an ensemble would not integrate a
sample beyond them.

The reference with a step that is halved until it no longer matters.

The reference is fine enough where its last halving moved every output by less than a tenth of the smallest error
that any setting has against it. For an integrator of order two, what remains is then a third of that move.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from time import perf_counter, process_time
from typing import Protocol

import numpy as np
from scipy.stats import qmc

from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.dynamics.alpha_step import n_first_steps
from pgmp_petsc.dynamics.generalised_alpha import integrate
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.experiments.finished import duration_text, step_seconds
from pgmp_petsc.experiments.history import AnyModel, History, largest_errors, run_history, spacing, with_steps
from pgmp_petsc.experiments.reference import Reference, Subject, component_model
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.mesh.refinement import refined
from pgmp_petsc.models import ComponentModel, FullModel, ReducedModel
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.runtime.errors import PgmpError
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.runtime.installed import alone
from pgmp_petsc.runtime.vectors import LANES
from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml
from pgmp_petsc.scene.spanning_values import uncertain_names
from pgmp_petsc.studies.tradeoff_settings import ResponseSurface, Setting

# What one setting may fail with while the others go on: errors meant for the user, and those of numerical libraries
# (PETSc's and MPI's are RuntimeErrors); a mistake of the program ends the study.
FAILURES = (PgmpError, RuntimeError, ArithmeticError, np.linalg.LinAlgError, MemoryError)
MOST_TIMED_TOGETHER = 128
TIMED = 2.0  # s of processor time of one run that is timed, predicted
FEWEST_STEPS = 8  # that a longer run is timed by
OF_BUDGET = 0.1  # of reference.budget, for runs of the mesh where it is not the reference
LONG_BUILD = 2.0  # s; a build that takes longer is timed once
WARM_UP_STEPS = 2
WARM_UP_ANGLES = 6


class Candidate(Protocol):
    """A setting that is prepared."""

    def history(self) -> History:
        """Return the outputs at the test values."""

    def seconds(self, n_samples: int) -> np.ndarray:
        """Return wall and processor time of a sample in a batch of n, shape (2,), s."""


@dataclass(frozen=True)
class Prepared:
    """What was done before the first sample.

    Attributes
    ----------
    model
        A model, or a response surface.
    n_coordinates
        Unknowns: reduced, nodal or component coordinates, or nodes of the surface.
    cosine
        Smallest cosine between neighbouring spaces of modes; 1 where there are none.
    seconds
        Wall time and processor time, shape (2,), s.
    """

    model: AnyModel | ResponseSurface
    n_coordinates: int
    cosine: float
    seconds: np.ndarray


@dataclass(frozen=True)
class Measured:
    """What was found out about a setting when it was made ready; it is sent to the first rank, and kept.

    Attributes
    ----------
    history
        Outputs at the test values; None where the setting failed, or its runs were too dear.
    n_coordinates, cosine
        See `Prepared`.
    reason
        Why there is no history; empty where there is one.
    offline
        Wall and processor time of what comes before the first sample, shape (2,), s; NaN where it failed.
    """

    history: History | None
    n_coordinates: int = 0
    cosine: float = 1.0
    reason: str = ""
    offline: tuple[float, float] = (np.nan, np.nan)


class Simulated:
    """A model with a step; see `Candidate`."""

    def __init__(self, model: AnyModel, n_steps: int, values: Mapping[str, np.ndarray], n_values: int) -> None:
        self._model, self._n_steps, self._values, self._n_values = model, n_steps, values, n_values
        reduced = isinstance(model, ReducedModel)
        self._step = 0.0 if reduced else step_seconds(model.kinematics.mechanism)

    def history(self) -> History:
        """Return the outputs at the test values; raises `RunError` where one fails."""
        return run_history(self._model, self._values, self._n_values, self._n_steps).require_fine(self._values)

    @property
    def price(self) -> float:
        """Predicted processor time of the history, s."""
        return self._n_values * self._n_steps * self._step

    def seconds(self, n_samples: int) -> np.ndarray:
        """Integrate the test values, repeated until there are n, and evaluate the outputs at the end."""
        each = self._n_steps * self._step
        n, taken = min(n_samples, self._model.largest_batch), self._n_steps
        if n * each > TIMED:
            n = min(n, max(LANES, int(TIMED / each)))
        if n * each > TIMED:
            taken = min(taken, max(FEWEST_STEPS, int(TIMED / (n * self._step))))
        simulation = with_steps(self._model.scene, self._n_steps).simulation
        if taken < self._n_steps:
            duration = simulation.duration * taken / self._n_steps
            simulation = simulation.model_copy(update={"duration": duration, "step": duration / taken})
        values = {name: np.resize(column, n) for name, column in self._values.items()}
        start = _now()
        with closing(self._model.batch(values, n)) as system:
            begun = _now()
            run = integrate(system, simulation)
            self._model.outputs.evaluate(self._model.observed(system, run.state))
            first = n_first_steps(system)  # of the few that are timed they are no small share
            return (begun - start + (_now() - begun) * (first + self._n_steps) / (first + taken)) / n


class Evaluated:
    """A response surface; see `Candidate`."""

    def __init__(self, surface: ResponseSurface, points: np.ndarray, names: tuple[str, ...], n_steps: int) -> None:
        self._surface, self._points, self._names, self._n_steps = surface, points, names, n_steps

    def history(self) -> History:
        """Return the outputs at the test values."""
        found, n = self._surface.evaluate(self._points), len(self._points)
        outputs = np.array([found[name] for name in self._names])
        fine = np.full(n, Status.FINE)
        inside, never = np.ones(n, dtype=bool), np.full(n, np.nan)
        return History(self._n_steps, spacing(self._n_steps), outputs, fine, inside, never)

    def seconds(self, n_samples: int) -> np.ndarray:
        """Evaluate the test values, repeated until there are n."""
        start = _now()
        self._surface.evaluate(np.resize(self._points, (n_samples, self._points.shape[1])))
        return (_now() - start) / n_samples


class Bench:
    """Makes settings ready and keeps them for the times; everything on this rank alone.

    Parameters
    ----------
    subject
        The scene and its bodies, condensed for all settings.
    reference
        What errors are measured against.
    few_repeats
        How often single samples are timed, and builds, unless they are long.
    shared
        Processor times, s, of what was done once for all settings, of families by name: condensing the bodies for
        ``reduced`` ones, preparing the reference for a ``surface``.
    """

    def __init__(self, subject: Subject, reference: Reference, few_repeats: int, shared: Mapping[str, float]) -> None:
        self.scene, self.reference = subject.scene, reference
        self._subject, self._few_repeats, self._shared_seconds = subject, few_repeats, dict(shared)
        self.values = held_out(self.scene)
        self.batch = min(self.scene.ensemble.batch, MOST_TIMED_TOGETHER)
        self._toml = scene_to_toml(self.scene)
        self._prepared: dict[tuple, Prepared] = {}
        self._offline: dict[tuple, list[np.ndarray]] = {}
        self._ready: dict[Setting, Candidate | None] = {}
        self._online: dict[tuple[Setting, int], np.ndarray] = {}
        self._spent: dict[Setting, np.ndarray] = {}

    @property
    def ready(self) -> list[Setting]:
        """Settings that were made ready here and did not fail."""
        return list(self._ready)

    def warm_up(self, setting: Setting, second_order: bool) -> None:
        """Load and compile what the first measurement would otherwise pay for."""
        few = setting.with_reduction(
            modes=1,
            parameter_modes=0,
            angles=WARM_UP_ANGLES,
            second_order=second_order,
            interpolation="spline",
            sampling_tolerance=None,
        )
        for warm in (few, Setting("full", setting.n_steps)):
            try:
                model = self._prepare(warm).model
                simulation = self.scene.simulation
                duration = simulation.duration * WARM_UP_STEPS / setting.n_steps
                short = simulation.model_copy(update={"duration": duration, "step": duration / WARM_UP_STEPS})
                for n in {min(self._n_values, model.largest_batch), 1}:
                    values = {name: column[:n] for name, column in self.values.items()}
                    with closing(model.batch(values, n)) as system:
                        integrate(system, short)
            except FAILURES:
                continue  # whatever is wrong will be met again, with its reason

    def make_ready(self, setting: Setting) -> Measured:
        """Prepare a setting and run it at the test values; a failure is returned, not raised."""
        history, reason = None, ""
        try:
            prepared = self._shared(setting)
            candidate = self._candidate(setting, prepared.model)
            reason = self._too_dear(setting, candidate)
            history = None if reason else candidate.history()
            self._ready[setting] = candidate
        except FAILURES as error:
            reason = str(error) if isinstance(error, PgmpError) else f"{type(error).__name__}: {error}"
            return Measured(None, reason=" ".join(reason.split()))
        offline = tuple(float(value) for value in self._offline[setting.build][0])
        return Measured(history, prepared.n_coordinates, prepared.cosine, reason, offline)

    def take_up(self, setting: Setting, measured: Measured) -> None:
        """Take up what an earlier run found out about a setting; it is prepared again only for its times."""
        if np.isfinite(measured.offline[0]):
            self._ready.setdefault(setting, None)
            self._offline.setdefault(setting.build, [np.array(measured.offline)])

    def run_reference(self, refinement: int, n_steps: int) -> History:
        """Return the reference's outputs at the test values with so many steps.

        Raises
        ------
        RunError
            If a sample fails.
        """
        model = self._shared(Setting("full", n_steps, refinement)).model if refinement > 1 else self.reference.model
        return run_history(model, self.values, self._n_values, n_steps).require_fine(self.values)

    def take_times(self, setting: Setting, turn: int) -> None:
        """Take the times of a setting that is ready, for the `turn`-th time; the least of all turns counts."""
        if self._ready[setting] is None:
            self._ready[setting] = self._candidate(setting, self._shared(setting).model)
        for n in (self.batch, 1) if turn <= self._few_repeats else (self.batch,):
            seconds = self._ready[setting].seconds(n)
            self._spent[setting] = self._spent.get(setting, 0.0) + n * seconds
            self._online[setting, n] = np.minimum(seconds, self._online.get((setting, n), np.inf))
        taken = self._offline[setting.build]
        if len(taken) < min(turn, self._few_repeats) and taken[0][0] < LONG_BUILD:
            taken.append(self._prepare(setting).seconds)

    def times(self, setting: Setting) -> np.ndarray:
        """Return the times of a setting: offline, of a sample in a batch, of one alone; shape (3, 2), wall first, s."""
        offline = np.min(self._offline[setting.build], axis=0)
        return np.array([offline, self._online[setting, self.batch], self._online[setting, 1]])

    def spent(self, setting: Setting) -> np.ndarray:
        """Return wall and processor time of a setting's timed runs, shape (2,), s."""
        return self._spent[setting]

    def n_cells(self, refinement: int) -> int:
        """Return the number of cells of all bodies."""
        return refinement * sum(mesh.n_cells for mesh in self._subject.meshes.values())

    @property
    def _n_values(self) -> int:
        return next((len(column) for column in self.values.values()), 1)

    def _too_dear(self, setting: Setting, candidate: Candidate) -> str:
        """Return why a setting is not run at the test values; empty where it is."""
        of_mesh = setting.family == "full" and not self.reference.is_mesh
        allowed = OF_BUDGET * self.scene.reference.budget
        if not of_mesh or candidate.price <= allowed:
            return ""
        return (
            f"too dear to be run at the test values: {duration_text(candidate.price)} of processor time are predicted, "
            f"{duration_text(allowed)} are a tenth of reference.budget; its times are those of its first steps"
        )

    def _candidate(self, setting: Setting, model: AnyModel | ResponseSurface) -> Candidate:
        if isinstance(model, ResponseSurface):
            points = np.column_stack([self.values[name] for name in uncertain_names(self.scene)])
            return Evaluated(model, points, self._outputs, setting.n_steps)
        return Simulated(model, setting.n_steps, self.values, self._n_values)

    @property
    def _outputs(self) -> tuple[str, ...]:
        return tuple(self.reference.model.outputs.functions)

    def _shared(self, setting: Setting) -> Prepared:
        """Prepare a setting, or return what was prepared for one with the same build."""
        if setting.build not in self._prepared:
            prepared = self._prepared[setting.build] = self._prepare(setting)
            self._offline.setdefault(setting.build, [prepared.seconds])
        return self._prepared[setting.build]

    def _prepare(self, setting: Setting) -> Prepared:
        """Do what comes before the first sample, and take its time."""
        families = {
            "reduced": self._build, "full": self._full, "components": self._components, "surface": self._surface
        }  # fmt: skip
        start = _now()
        model, n_coordinates, cosine = families[setting.family](setting)
        shared = self._shared_seconds.get(setting.family, 0.0) if setting.refinement == 1 else 0.0
        return Prepared(model, n_coordinates, cosine, shared + _now() - start)

    def _build(self, setting: Setting) -> tuple[ReducedModel, int, float]:
        scene = scene_from_toml(self._toml, self.scene.directory, setting.overrides(self.scene))
        shapes = self._subject.shapes if setting.refinement == 1 else self._refined(setting.refinement)
        with RankGroup.split(alone(), 1) as group:
            rom = build_rom(scene, shapes, group)
        n_coordinates = rom.tables.n_coordinates + rom.tables.n_modes
        return ReducedModel(scene, rom), n_coordinates, float(rom.cosines.min())

    def _full(self, setting: Setting) -> tuple[FullModel, int, float]:
        meshes = self._subject.meshes if setting.refinement == 1 else self._refined(setting.refinement)
        model = FullModel(self.scene, meshes)
        return model, model.kinematics.mechanism.n_dofs, 1.0

    def _components(self, setting: Setting) -> tuple[ComponentModel, int, float]:
        model = component_model(self.scene, self._subject.meshes, alone(), setting.component_modes)
        return model, sum(model.n_amplitudes.values()), 1.0

    def _surface(self, setting: Setting) -> tuple[ResponseSurface, int, float]:
        nodes = node_values(self.scene, setting.nodes)
        values = at_values(self.scene, nodes)
        runs = run_history(self.reference.model, values, setting.nodes, setting.n_steps).require_fine(values)
        return ResponseSurface(nodes, dict(zip(self._outputs, runs.outputs))), setting.nodes, 1.0

    def _refined(self, parts: int) -> dict[str, BodyShape]:
        lines = {name: mesh for name, mesh in self._subject.meshes.items() if isinstance(mesh, LineMesh)}
        return {name: refined(mesh, parts) for name, mesh in lines.items()}


def _now() -> np.ndarray:
    """Return the clocks: wall and processor, s."""
    return np.array([perf_counter(), process_time()])


N_TEST = 8  # both models take so few in one batch at little more than the price of one
TEST_RANGE = (0.01, 0.99)  # probabilities of the outermost test values
NODE_RANGE = (0.001, 0.999)
SEED = 1


def held_out(scene: Scene, n: int = N_TEST) -> dict[str, np.ndarray]:
    """Return n test values of every parameter, shape (n,); one, that of the scene, where nothing is uncertain.

    Every uncertain parameter takes n quantiles with probabilities at equal distances over `TEST_RANGE`, one: in
    order, several: in the random order of a Latin hypercube.
    """
    names = uncertain_names(scene)
    if not names:
        return at_values(scene, np.empty((1, 0)))
    centred = qmc.LatinHypercube(len(names), scramble=False, seed=SEED).random(n)
    if len(names) == 1:
        centred = np.sort(centred, axis=0)
    low, high = TEST_RANGE
    # the centres of n strata reach from 1/(2n) to 1 - 1/(2n)
    probabilities = 0.5 * (low + high) + (centred - 0.5) * (high - low) * n / max(n - 1, 1)
    return at_values(scene, quantiles(scene, probabilities))


def node_values(scene: Scene, n: int) -> np.ndarray:
    """Return n nodes of a response surface, shape (n, n_uncertain): equal distances, or Halton points in a box."""
    low, high = box(scene)
    if len(low) == 1:
        return np.linspace(low, high, n)
    return low + (high - low) * qmc.Halton(len(low), scramble=True, seed=SEED).random(n)


def box(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of the box that nodes span, each of shape (n_uncertain,)."""
    n = len(uncertain_names(scene))
    low, high = (quantiles(scene, np.full((1, n), probability))[0] for probability in NODE_RANGE)
    return low, high


def at_values(scene: Scene, uncertain: np.ndarray) -> dict[str, np.ndarray]:
    """Return values of all parameters from those of the uncertain ones, shape (n, n_uncertain)."""
    values = {name: np.full(len(uncertain), value) for name, value in scene.values.items()}
    return values | dict(zip(uncertain_names(scene), uncertain.T))


def quantiles(scene: Scene, probabilities: np.ndarray) -> np.ndarray:
    """Return quantiles of the distributions, bounds applied, for probabilities of shape (n, n_uncertain)."""
    columns = []
    for name, column in zip(uncertain_names(scene), probabilities.T):
        parameter = scene.parameters[name]
        columns.append(parameter.quantiles(column, 0.0 if name in scene.parameters_not_negative else -np.inf))
    return np.column_stack(columns) if columns else np.empty((len(probabilities), 0))


SHARE = 0.1
ORDER = 2
ROUND_OFF = 1e-12  # a move that small is none
MOST_AT_ONCE = 3  # halvings that are asked for together: a prediction by the order is no more than that


class ReferenceSequence:
    """Runs of a reference on one mesh, with steps that are halved.

    Parameters
    ----------
    first
        Number of steps of the coarsest run.
    most
        Number of steps of the finest run that is allowed.
    floors
        Below which outputs count as zero, in their units, shape (n_outputs,).
    """

    def __init__(self, first: int, most: int, floors: np.ndarray) -> None:
        self._first, self._most, self._floors = first, max(most, 2 * first), floors
        self._runs: dict[int, History] = {}
        self._failure = ""

    def add(self, n_steps: int, run: History) -> None:
        """Take in a run; the one with twice its steps comes next."""
        self._runs[n_steps] = run

    def give_up(self, reason: str) -> None:
        """Refine no further: a finer run failed."""
        self._failure = reason

    @property
    def usable(self) -> bool:
        """Whether there are two runs, so that one can tell how fine the finest is."""
        return len(self._runs) > 1

    @property
    def failure(self) -> str:
        """Why it was given up; empty where it was not."""
        return self._failure

    @property
    def n_steps(self) -> int:
        """Steps of the finest run."""
        return max(self._runs)

    @property
    def history(self) -> History:
        """The finest run."""
        return self._runs[self.n_steps]

    @property
    def moved(self) -> np.ndarray:
        """By how much the last halving moved each output, as `largest_errors`, shape (n_outputs,)."""
        return largest_errors(self._runs[self.n_steps // 2], self.history, self._floors)

    def wanted(self, smallest: np.ndarray) -> list[int]:
        """Return the numbers of steps that are missing until the reference is fine enough, as far as one can tell.

        Parameters
        ----------
        smallest
            Smallest error of any setting in each output, shape (n_outputs,); infinite or NaN where there is none.
        """
        if self._failure:
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
        """Say why the step is not halved again."""
        if self._failure:
            return f"a finer run failed: {self._failure}"
        if self.settled(smallest):
            return f"the last halving moved no output by {SHARE:g} of its smallest error"
        return "the finest step that is allowed"

    def _excess(self, smallest: np.ndarray) -> float:
        """Return the move over the allowed one, the largest of any output."""
        wanted = SHARE * np.where(np.isnan(smallest), np.inf, smallest)
        known = np.isfinite(self.moved) & (self.moved > ROUND_OFF)
        with np.errstate(divide="ignore"):
            return float(np.max(self.moved[known] / wanted[known], initial=0.0))
