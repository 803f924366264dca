"""The step of a run, or of an ensemble, for ``simulation.tolerance``: from runs of the model itself.

The runs are those to come: the scene's own loads; for an ensemble with the training values of its parameters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np

from pgmp_petsc.experiments.finished import Price, step_seconds
from pgmp_petsc.experiments.history import History, errors_between, floors_of, round_off_of, run_history
from pgmp_petsc.experiments.period import period_of
from pgmp_petsc.models import FullModel, ReducedModel
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.groups import first_ranks
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.scene.spanning_values import spanning_values
from pgmp_petsc.selection.step_choice import AHEAD, SEEN, StepChoice, first_steps
from pgmp_petsc.selection.training import Training, training_loads
from pgmp_petsc.selection.trial import Errors, Ledger, Trial
from pgmp_petsc.studies.simulate import UNKNOWNS_PER_RANK

if TYPE_CHECKING:
    from mpi4py import MPI

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
    period = period_of(model, comm)
    step = StepChoice(bench, ledger, period, model.name)
    fewest = (1 + AHEAD) * step.n_given if step.kept else 2 * SEEN * first_steps(simulation.duration, period)[1]
    bench.check_price(fewest)
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
        self._step = 0.0 if isinstance(model, ReducedModel) else step_seconds(model.kinematics.mechanism)
        alone = isinstance(model, ReducedModel) or training.n_samples > 1 or n_unknowns < 2 * UNKNOWNS_PER_RANK
        self._run = self._on_one_rank if alone else self._on_all_ranks
        self._histories: dict[int, History | None] = {}

    @property
    def most_steps(self) -> float:
        """Steps of a run up to which all runs with halved steps are within ``reference.budget``; no limit of a reduced
        model, and where the reference was named."""
        reference = self.scene.reference
        if self._step == 0.0 or reference.model != "auto":
            return np.inf
        return reference.budget / (2.0 * self.training.n_samples * self._step)

    def check_price(self, fewest: int) -> None:
        """Refuse runs of so many steps where they are beyond the budget.

        Raises
        ------
        InputError
            With what they would take.
        """
        price = Price(self._step, float(fewest * self.training.n_samples))
        if self.scene.reference.model == "auto" and price.seconds > self.scene.reference.budget:
            raise InputError(
                f"simulation.tolerance = {self.scene.simulation.tolerance:g}: to find the step, the "
                f"{self._model.title} model has to run {price.steps:.2g} steps, which are predicted to take {price} of "
                f"processor time; reference.budget = {self.scene.reference.budget:g} s: raise it, name reference.model "
                "to run them at their price, or give simulation.step and leave simulation.tolerance out"
            )

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
