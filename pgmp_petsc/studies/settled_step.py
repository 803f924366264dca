"""The step of a run, or of an ensemble, for ``simulation.tolerance``: from runs of the model itself.

The runs are those to come: the scene's own loads; for an ensemble with the training values of its parameters.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from mpi4py import MPI

from pgmp_petsc.models import ComponentModel, FullModel, ReducedModel
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.groups import first_ranks
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.scene.spanning_values import spanning_values
from pgmp_petsc.selection.history import History, errors_between, floors_of, round_off_of, run_history
from pgmp_petsc.selection.ledger import Ledger
from pgmp_petsc.selection.step_choice import StepChoice, first_period
from pgmp_petsc.selection.training import Training, training_loads
from pgmp_petsc.selection.trial import Errors, Trial
from pgmp_petsc.studies.simulate import UNKNOWNS_PER_RANK

AnyModel = TypeVar("AnyModel", FullModel, ReducedModel)


def settle_step(model: AnyModel, comm: MPI.Comm, ensemble: bool = False) -> tuple[AnyModel, str]:
    """Return a model with the step that its scene's tolerance allows, and what was chosen. Collective on `comm`.

    Without a tolerance the model is returned as it is, and nothing is to be said. A step that the scene gives is kept.

    Raises
    ------
    InputError
        If no step, or not the given one, keeps the tolerance.
    """
    simulation = model.scene.simulation
    if simulation.tolerance is None:
        return model, ""
    values, n_samples = {name: np.array([value]) for name, value in model.scene.values.items()}, 1
    if ensemble:
        values, n_samples = spanning_values(model.scene)
    bench = _Runs(model, comm, Training(values, n_samples, training_loads(model.scene)[:1], ()))
    ledger = Ledger()
    kinematics = model.kinematics_on_meshes if isinstance(model, ComponentModel) else model.kinematics
    period = first_period(model.scene, kinematics, comm, comm)
    step = StepChoice(bench, ledger, period, "reduced" if isinstance(model, ReducedModel) else "full")
    step.begin()
    step.finish({})
    entries = simulation.model_dump() | {"tolerance": None, "step": simulation.step if step.kept else step.step}
    settled = model.with_loads(model.scene.model_copy(update={"simulation": Simulation(**entries)}))
    tolerance = f"simulation.tolerance = {simulation.tolerance:g}"
    if step.kept:
        best = ledger.best("step")
        given = f"simulation.step = {simulation.step:g}"
        return settled, f"{tolerance}: {given} is kept as given; it leaves {best.largest:.2g}"
    return settled, f"{tolerance}: simulation.step = {step.step:g} was chosen; {ledger.reasons['simulation.step']}"


class _Runs:
    """Runs of one model with several steps: a large full-order one on all ranks, else on the first."""

    def __init__(self, model: FullModel | ReducedModel, comm: MPI.Comm, training: Training) -> None:
        self.scene, self.training = model.scene, training
        self.outputs = tuple(model.outputs.functions)
        if not self.outputs:
            raise InputError(
                "simulation.tolerance: errors are those of outputs, and the scene has none; name some in [outputs]"
            )
        self._model, self._comm, self._floors = model, comm, floors_of(model)
        n_unknowns = model.kinematics.mechanism.n_dofs
        alone = isinstance(model, ReducedModel) or training.n_samples > 1 or n_unknowns < 2 * UNKNOWNS_PER_RANK
        self._run = self._on_one_rank if alone else self._on_all_ranks
        self._histories: dict[int, History | None] = {}

    def moved(self, coarse: int, fine: int, loads: tuple[str, ...]) -> Errors:
        """Return how far runs with two numbers of steps are apart."""
        for n_steps in (coarse, fine):
            if n_steps not in self._histories:
                self._histories[n_steps] = self._run(n_steps)

        def comparing_runs() -> Errors:
            found, exact = self._histories[coarse], self._histories[fine]
            values, round_off = errors_between(found, exact, self._floors), round_off_of(exact, self._floors)
            return Errors(values[None], round_off[None], loads, self.outputs, self.training)

        return on_root(self._comm, comparing_runs)

    def moved_reduced(self, trial: Trial, coarse: int, fine: int, loads: tuple[str, ...]) -> Errors:
        """Nothing is reduced here."""
        raise NotImplementedError

    def _on_one_rank(self, n_steps: int) -> History | None:
        history = None
        with agreed(self._comm, "runs for the step"):
            if self._comm.rank == 0:
                history = run_history(self._model, self.training.values, self.training.n_samples, n_steps)
        return history

    def _on_all_ranks(self, n_steps: int) -> History:
        history = None
        with first_ranks(self._comm, self._comm.size) as workers, agreed(self._comm, "runs for the step"):
            with self._model.distributed(self._model.scene.values, workers) as system:
                history = run_history(self._model, self.training.values, 1, n_steps, system)
        return history
