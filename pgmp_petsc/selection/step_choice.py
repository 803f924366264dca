"""The step for a tolerance, from runs of the full-order model under the training loads, and of the reduced one."""

from __future__ import annotations

import numpy as np

from pgmp_petsc.dynamics.generalised_alpha import count_steps
from pgmp_petsc.selection.bench import Bench, Errors, Trial
from pgmp_petsc.selection.ledger import STEP, Ledger
from pgmp_petsc.selection.refusal import refuse
from pgmp_petsc.selection.step import AHEAD, FEWEST, FIRST_PER_PERIOD, MOST_PER_PERIOD, StepSearch, step_of

EARLY_PER_PERIOD = 128  # steps a period of the first flexible mode that are tried before anything is reduced
UNKNOWN_PER_PERIOD = 64  # that a reduction is looked at with where the step is not known yet
# A reduction is looked at with smaller steps than it will run with: the integrator's error is not the same in the coordinates
# of the two models, and is a quarter or less of itself then. A step that was chosen is as large as its tolerance allows.
FINER_THAN_GIVEN, FINER_THAN_CHOSEN = 2, 4
LOADS = ("own", "pulse")  # quicker loads set off more vibrations; a step for all of them would be one for none


class StepChoice:
    """The step of a scene: given, or as the tolerance wants it. Collective on the bench's ranks.

    Parameters
    ----------
    bench
        Full-order runs.
    ledger
        Takes what was tried.
    period
        Of the first flexible mode, s.
    """

    def __init__(self, bench: Bench, ledger: Ledger, period: float) -> None:
        self._bench, self._ledger = bench, ledger
        simulation = bench.scene.simulation
        self.tolerance = simulation.tolerance
        self.kept = "step" in simulation.model_fields_set or self.tolerance is None
        self.n_given = count_steps(simulation.duration, simulation.step)
        self._duration = simulation.duration
        self._periods = max(simulation.duration / period, FEWEST / FIRST_PER_PERIOD)
        self.loads = tuple(load.name for load in bench.training.loads if load.name in LOADS)
        self._search: StepSearch | None = None
        self._n_reduced = 0

    @property
    def allowed(self) -> dict[str, float]:
        """What the step's error may be; empty without a tolerance."""
        return {} if self.tolerance is None else {"step": STEP * self.tolerance}

    @property
    def settled(self) -> bool:
        """Whether the step is known."""
        return self.kept or self._search.chosen is not None

    @property
    def n_steps(self) -> int:
        """Number of steps, where it is settled."""
        return self.n_given if self.kept else max(self._search.chosen, self._n_reduced)

    @property
    def n_basis(self) -> int:
        """Number of steps that the reduction is looked at with."""
        if self.kept:
            return FINER_THAN_GIVEN * self.n_given
        unknown = UNKNOWN_PER_PERIOD // FIRST_PER_PERIOD * self._first
        return min(FINER_THAN_CHOSEN * self._search.chosen, max(unknown, self._search.chosen)) if self.settled else unknown

    @property
    def n_finest(self) -> int:
        """Steps of the finest full-order run that is at hand."""
        return self.n_given if self.kept else self._search.finest

    @property
    def step(self) -> float:
        """The chosen step, s."""
        return step_of(self._duration, self.n_steps)

    def begin(self) -> None:
        """Check a given step, or look for one as far as that is quick."""
        if self.tolerance is None:
            return
        if self.kept:
            self._check_given()
            return
        self._search = StepSearch(self._compare, self._first, STEP * self.tolerance)
        self._search.advance(round(EARLY_PER_PERIOD * self._periods))

    def finish(self) -> None:
        """Look further, if the step is not known; refuse a tolerance that no step keeps.

        Raises
        ------
        InputError
            If the smallest step that is tried is not small enough.
        """
        if self.kept:
            return
        search = self._search
        search.advance(round(MOST_PER_PERIOD * self._periods))
        if search.chosen is None:
            worst = self._bench.outputs[int(np.argmax(search.last_move))]
            hints = [
                f"the last halving, to {search.finest} steps, still moves {worst} by {search.last_move.max():.2g}: the loads "
                "set off vibrations that nothing damps, and their phase has to be kept over the whole run",
                "a torque without corners sets off less; simulation.step takes any step as given",
            ]
            refuse("simulation.tolerance", self.tolerance, "step", self.allowed, self._ledger, hints)
        self._ledger.reasons["simulation.step"] = (
            f"{search.chosen} steps leave {search.error:.2g}, allowed {search.allowed:.2g}, against "
            f"{search.finest} steps of the full-order model"
        )

    def fit_reduced(self, trial: Trial) -> None:
        """Take more steps if the reduced model needs more than the full-order one.

        With large steps the two differ: an integrator's error is not the same in their coordinates. From the steps that
        the reduction was looked at with they are known to agree.
        """
        if self.kept:
            return
        n_steps = self.n_steps
        while n_steps < trial.n_steps:
            errors = self._bench.moved_reduced(trial, n_steps, AHEAD * n_steps, self.loads)
            self._note(n_steps, errors)
            if errors.largest <= STEP * self.tolerance:
                break
            n_steps = min(2 * n_steps, trial.n_steps)
            self._ledger.reasons["simulation.step"] += f"; the reduced model needs {n_steps}"
        self._n_reduced = n_steps

    @property
    def _first(self) -> int:
        return int(np.ceil(FIRST_PER_PERIOD * self._periods))

    def _compare(self, coarse: int, fine: int) -> np.ndarray:
        errors = self._bench.moved(coarse, fine, self.loads)
        if fine == AHEAD * coarse:
            self._note(coarse, errors)
        return errors.by_output

    def _check_given(self) -> None:
        n = self.n_given
        ahead = AHEAD if AHEAD * n <= MOST_PER_PERIOD * self._periods else 2
        errors = self._bench.moved(n, ahead * n, self.loads)
        self._note(n, errors)
        if errors.largest > STEP * self.tolerance:
            hint = f"simulation.step = {self._bench.scene.simulation.step:g} is kept as given; leave it out to have it chosen"
            refuse("simulation.tolerance", self.tolerance, "step", self.allowed, self._ledger, [hint])

    def _note(self, n_steps: int, errors: Errors) -> None:
        step = self._bench.scene.simulation.step if self.kept else step_of(self._duration, n_steps)
        self._ledger.add_step({"step": step}, n_steps, errors)
