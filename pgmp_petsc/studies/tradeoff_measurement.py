"""Measuring one setting on one rank: build or prepare, run at the test values, take times.

Times are taken by the wall and by the processor, of this process alone. *Offline* is what comes before the first
sample: the build of a reduced model and its preparation, the preparation of a full-order model, the runs at a response
surface's nodes and the interpolation. *Online* is what a sample costs after that, as an ensemble does it: integration
to the end time and the outputs there; of a response surface the outputs over time. A sample alone is a batch of one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter, process_time
from typing import Protocol

import numpy as np
from mpi4py import MPI

from pgmp_petsc.dynamics.generalised_alpha import integrate
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.mesh.refinement import refined
from pgmp_petsc.models import FullModel, Model, ReducedModel
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.runtime.errors import PgmpError
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.scene.spanning_values import uncertain_names
from pgmp_petsc.studies.tradeoff_history import History, history_of, n_instants, with_steps
from pgmp_petsc.studies.tradeoff_settings import Setting
from pgmp_petsc.studies.tradeoff_surface import ResponseSurface
from pgmp_petsc.studies.tradeoff_values import at_values, held_out, node_values

# What one setting may fail with while the others go on: errors meant for the user, and those of numerical libraries
# (PETSc's and MPI's are RuntimeErrors); a mistake of the program ends the study.
FAILURES = (PgmpError, RuntimeError, ArithmeticError, np.linalg.LinAlgError, MemoryError)
MOST_TIMED_TOGETHER = 128
LONG_BUILD = 2.0  # s; a build that takes longer is timed once
WARM_UP_STEPS = 2
WARM_UP_ANGLES = 6


class Candidate(Protocol):
    """A setting that is ready to run.

    Attributes
    ----------
    history
        Outputs at the test values.
    """

    history: History

    def run(self, n_samples: int) -> None:
        """Do n samples as one batch."""


@dataclass(frozen=True)
class Prepared:
    """What was done before the first sample.

    Attributes
    ----------
    model
        A model, or a response surface.
    n_coordinates
        Unknowns: reduced or nodal coordinates, or nodes of the surface.
    cosine
        Smallest cosine between neighbouring spaces of modes; 1 where there are none.
    seconds
        Wall time and processor time, shape (2,), s.
    """

    model: Model | ResponseSurface
    n_coordinates: int
    cosine: float
    seconds: np.ndarray


@dataclass(frozen=True)
class Measured:
    """What was found out about a setting when it was made ready; it is sent to the first rank.

    Attributes
    ----------
    history
        Outputs at the test values; None where the setting failed.
    n_coordinates, cosine
        See `Prepared`.
    reason
        Why it failed; empty where it did not.
    """

    history: History | None
    n_coordinates: int = 0
    cosine: float = 1.0
    reason: str = ""


class Simulated:
    """One of the two models with a step; see `Candidate`."""

    def __init__(self, model: Model, simulation: Simulation, values: Mapping[str, np.ndarray], kept: int) -> None:
        self._model, self._simulation, self._values = model, simulation, values
        self.history = history_of(model, values, simulation, kept)

    def run(self, n_samples: int) -> None:
        """Integrate the test values, repeated until there are n, and evaluate the outputs at the end."""
        values = {name: np.resize(column, n_samples) for name, column in self._values.items()}
        system = self._model.batch(values, n_samples)
        run = integrate(system, self._simulation)
        self._model.outputs.evaluate(self._model.observed(system, run.state))


class Evaluated:
    """A response surface; see `Candidate`."""

    def __init__(self, surface: ResponseSurface, points: np.ndarray) -> None:
        self._surface, self._points = surface, points
        self.history = surface.evaluate(points)

    def run(self, n_samples: int) -> None:
        """Evaluate the test values, repeated until there are n."""
        self._surface.evaluate(np.resize(self._points, (n_samples, self._points.shape[1])))


class Bench:
    """Makes settings ready and keeps them for the times; everything on this rank alone.

    Parameters
    ----------
    scene, meshes
        As they were read.
    few_repeats
        How often single samples are timed, and builds, unless they are long.
    """

    def __init__(self, scene: Scene, meshes: Mapping[str, LineMesh], few_repeats: int) -> None:
        self.scene = scene
        self._few_repeats = few_repeats
        self.values = held_out(scene)
        self.batch = min(scene.ensemble.batch, MOST_TIMED_TOGETHER)
        self._meshes = meshes
        self._kept = n_instants(scene.simulation)
        self._toml = scene_to_toml(scene)
        self._prepared: dict[tuple, Prepared] = {}
        self._offline: dict[tuple, list[np.ndarray]] = {}
        self._ready: dict[Setting, Candidate] = {}
        self._online: dict[tuple[Setting, int], np.ndarray] = {}
        self._spent = np.zeros(2)

    @property
    def ready(self) -> list[Setting]:
        """Settings that were made ready here and did not fail."""
        return list(self._ready)

    def warm_up(self, setting: Setting) -> None:
        """Load and compile what the first measurement would otherwise pay for."""
        few = setting.with_reduction(
            modes=1,
            parameter_modes=0,
            angles=WARM_UP_ANGLES,
            second_order=True,
            interpolation="spline",
            sampling_tolerance=None,
        )
        try:
            for warm in (few, Setting("full", setting.n_steps)):
                model = self._prepare(warm).model
                integrate(model.batch(self.values, self._n_values), with_steps(self.scene.simulation, WARM_UP_STEPS))
        except FAILURES:
            return  # whatever is wrong will be met again, with its reason

    def make_ready(self, setting: Setting) -> Measured:
        """Prepare a setting and run it at the test values; a failure is returned, not raised."""
        try:
            prepared = self._shared(setting)
            self._ready[setting] = candidate = self._candidate(setting, prepared.model)
        except FAILURES as error:
            reason = str(error) if isinstance(error, PgmpError) else f"{type(error).__name__}: {error}"
            return Measured(None, reason=" ".join(reason.split()))
        return Measured(candidate.history, prepared.n_coordinates, prepared.cosine)

    def reference(self, refinement: int, n_steps: int) -> History:
        """Return the full-order outputs at the test values with so many steps.

        Raises
        ------
        RunError
            If a sample fails.
        """
        model = self._shared(Setting("full", n_steps, refinement)).model
        return history_of(model, self.values, with_steps(self.scene.simulation, n_steps), self._kept)

    def take_times(self, setting: Setting, turn: int) -> None:
        """Take the times of a setting that is ready, for the `turn`-th time; the least of all turns counts."""
        candidate = self._ready[setting]
        for n in (self.batch, 1) if turn <= self._few_repeats else (self.batch,):
            start = _now()
            candidate.run(n)
            seconds = _now() - start
            self._spent += seconds
            self._online[setting, n] = np.minimum(seconds / n, self._online.get((setting, n), np.inf))
        taken = self._offline[setting.build]
        if len(taken) < min(turn, self._few_repeats) and taken[0][0] < LONG_BUILD:
            taken.append(self._prepare(setting).seconds)

    def times(self, setting: Setting) -> np.ndarray:
        """Return the times of a setting: offline, of a sample in a batch, of one alone; shape (3, 2), wall first, s."""
        offline = np.min(self._offline[setting.build], axis=0)
        return np.array([offline, self._online[setting, self.batch], self._online[setting, 1]])

    @property
    def waiting(self) -> float:
        """Wall time over processor time of all timed runs: 1 on a quiet machine, 0 where nothing was timed."""
        wall, processor = self._spent
        return float(wall / processor) if processor else 0.0

    def n_cells(self, refinement: int) -> int:
        """Return the number of cells of all bodies."""
        return refinement * sum(mesh.n_cells for mesh in self._meshes.values())

    @property
    def _n_values(self) -> int:
        return next((len(column) for column in self.values.values()), 1)

    def _candidate(self, setting: Setting, model: Model | ResponseSurface) -> Candidate:
        if isinstance(model, ResponseSurface):
            points = np.column_stack([self.values[name] for name in uncertain_names(self.scene)])
            return Evaluated(model, points)
        simulation = with_steps(self.scene.simulation, setting.n_steps)
        return Simulated(model, simulation, self.values, self._kept)

    def _shared(self, setting: Setting) -> Prepared:
        """Prepare a setting, or return what was prepared for one with the same build."""
        if setting.build not in self._prepared:
            prepared = self._prepared[setting.build] = self._prepare(setting)
            self._offline[setting.build] = [prepared.seconds]
        return self._prepared[setting.build]

    def _prepare(self, setting: Setting) -> Prepared:
        """Do what comes before the first sample, and take its time."""
        prepare = {"reduced": self._build, "full": self._full, "surface": self._surface}[setting.family]
        # the full-order model that a surface needs first is shared, and so is its time
        before = self._shared(Setting("full", setting.n_steps)).seconds if setting.family == "surface" else np.zeros(2)
        start = _now()
        model, n_coordinates, cosine = prepare(setting)
        return Prepared(model, n_coordinates, cosine, before + _now() - start)

    def _build(self, setting: Setting) -> tuple[ReducedModel, int, float]:
        scene = scene_from_toml(self._toml, self.scene.directory, setting.overrides(self.scene))
        with RankGroup.split(MPI.COMM_SELF, 1) as group:
            rom = build_rom(scene, self._refined(setting.refinement), group)
        n_coordinates = rom.tables.n_coordinates + rom.tables.n_modes
        return ReducedModel(scene, rom), n_coordinates, float(rom.cosines.min())

    def _full(self, setting: Setting) -> tuple[FullModel, int, float]:
        model = FullModel(self.scene, self._refined(setting.refinement))
        return model, model.kinematics.mechanism.n_dofs, 1.0

    def _surface(self, setting: Setting) -> tuple[ResponseSurface, int, float]:
        nodes = node_values(self.scene, setting.nodes)
        model = self._shared(Setting("full", setting.n_steps)).model
        simulation = with_steps(self.scene.simulation, setting.n_steps)
        runs = history_of(model, at_values(self.scene, nodes), simulation, self._kept)
        return ResponseSurface(nodes, runs), setting.nodes, 1.0

    def _refined(self, parts: int) -> dict[str, LineMesh]:
        return {name: refined(mesh, parts) for name, mesh in self._meshes.items()}


def _now() -> np.ndarray:
    """Return the clocks: wall and processor, s."""
    return np.array([perf_counter(), process_time()])
