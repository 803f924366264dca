"""The step that a tolerance allows, from runs with steps that are halved: of a full-order and a reduced model under the
training loads, or of a run to come.

A run with n steps is compared with one of `AHEAD` n steps, and of `SEEN` times the first number at least: where it is
coarse for a vibration, the scheme damps it and the finer run has it; where it resolves it, the finer run has a
sixty-fourth of the error (docs/method.md, order, says why not with half the step). What is chosen may be coarser than
any run that is halved; longer steps are tried after the first ones were good enough, never instead.

Where runs of `RESOLVED` times the first number of steps are at hand and the differences of halvings fall by `FALLS` at
least, the error of the finest run follows from the last two as the rest of a geometric series (for an error of order
two, Richardson's third of the last difference), and no runs `AHEAD` times as fine are needed. With fewer steps they may
fall so before a vibration is seen at all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bench.bench import Bench, step_price
from pgmp_petsc.bench.cases import Training, step_of
from pgmp_petsc.bench.history import Errors, Trial
from pgmp_petsc.bench.ledger import STEP, ZERO, Ledger, refuse
from pgmp_petsc.bench.prices import Price
from pgmp_petsc.bench.reference import Reference, period_of
from pgmp_petsc.models import Model
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.controllers import steps_of_samplings
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.scene.parameters import spanning_values

AHEAD = 8
SEEN = 16  # 64 steps a period of the first flexible mode: ten times its frequency is not damped within some periods
RESOLVED = 32
FALLS = (1.5, 2.0)
ORDER = 2
FIRST_PER_PERIOD = 4  # steps of the first run that is halved, a period of the first flexible mode
COARSEST_PER_PERIOD = 1  # steps of the coarsest run that may be chosen
MOST_PER_PERIOD = 1024
MOST_ANYWAY = 65536  # steps that are tried however few periods a run has
FEWEST = 64  # steps of a run: its largest values over time are known at so many instants


@dataclass
class StepSearch:
    """Search for the fewest steps that keep an error."""

    #: returns how far runs with two numbers of steps are apart, shape (n_outputs,)
    compare: Callable[[int, int], np.ndarray]
    first: int  # steps of the coarsest run that is halved
    allowed: float  # largest error that is allowed
    coarsest: int  # steps of the coarsest run that may be chosen; `first` is a power of two times it
    multiple: int = 1  # of which numbers of steps are multiples
    chosen: int | None = None
    error: float = np.inf
    finest: int = 0
    _next: int = 0
    _moved: list[np.ndarray] = field(default_factory=list)

    def advance(self, most: int) -> None:
        """Halve the step until it is found or the next run would have more than `most` steps."""
        if self.finest == 0:
            self.finest = self._next = self.first
        while self.chosen is None and 2 * self.finest <= most:
            self.finest *= 2
            self._moved.append(self.compare(self.finest // 2, self.finest))
            while self.chosen is None and self.finest >= fine_enough(self._next, self.first):
                self._look_ahead()
            if self.chosen is None and self.finest >= RESOLVED * self.first:
                self._extrapolate()

    def settle_for_finest(self) -> None:
        """Take the finest run, at the end, where its halving moved little and less than half of the one before.

        What further halvings would move is then no more than that, in all.
        """
        if self.chosen is None and self.finest >= RESOLVED * self.first:
            before, last = self._moved[-2:]
            if np.isfinite(before).all() and np.all((last <= 0.01 * self.allowed) | (before >= FALLS[1] * last)):
                error = float(last.max())
                if error <= self.allowed:
                    self.chosen, self.error = self.finest, error

    def _look_ahead(self) -> None:
        error = float(self.compare(self._next, self.finest).max())
        if error <= self.allowed:
            self.chosen, self.error = self._next, error
            # longer steps than the first ones, as long as they are good enough
            while self._next == self.first and self.chosen > self.coarsest:
                error = float(self.compare(self.chosen // 2, self.finest).max())
                if not error <= self.allowed:
                    break
                self.chosen, self.error = self.chosen // 2, error
        self._next *= 2

    def _extrapolate(self) -> None:
        first, before, last = self._moved[-3:]
        # what is far below the tolerance need not fall any more
        small = last <= 0.01 * self.allowed
        fall = (first >= FALLS[0] * before) & (before >= FALLS[1] * last)
        if not np.isfinite(first).all() or not np.all(small | fall):
            return
        falls = np.divide(before, last, out=np.full(last.shape, 2.0**ORDER), where=last > 0.0)
        error = float(np.max(last / (np.clip(falls, FALLS[1], 2.0**ORDER) - 1.0)))
        wanted = int(np.ceil(self.finest * np.sqrt(error / self.allowed)))
        # not beyond what was seen to be of this order
        if wanted <= 2 * self.finest:
            self.chosen = _at_least(max(wanted, self.finest // 4), self.multiple)
            self.error = error * (self.finest / self.chosen) ** ORDER


def fine_enough(n_steps: int, first: int) -> int:
    """Return the steps of a run that shows the error of one with `n_steps` steps."""
    return max(AHEAD * n_steps, SEEN * first)


def first_steps(scene: Scene, period: float) -> tuple[int, int]:
    """Return the steps of the coarsest run that may be chosen, and of the first one that is halved, from the period of
    the first flexible mode, s."""
    periods = scene.simulation.duration / period
    coarsest = _at_least(max(int(np.ceil(COARSEST_PER_PERIOD * periods)), FEWEST), steps_of_samplings(scene))
    first = coarsest
    while first < FIRST_PER_PERIOD * periods:
        first *= 2
    return coarsest, first


def _at_least(n_steps: int, multiple: int) -> int:
    """Return the first multiple that is no smaller than a number of steps."""
    return -(-n_steps // multiple) * multiple


def rounded_step(duration: float, n_steps: int) -> float:
    """Return a step of three digits (s) that makes n_steps steps or a little more."""
    step = duration / n_steps
    digits = 10.0 ** (np.floor(np.log10(step)) - 2)
    return float(f"{np.floor(step / digits * (1 + 1e-9)) * digits:.3g}")


EARLY_PER_PERIOD = 128  # steps a period of the first flexible mode that are tried before anything is reduced
UNKNOWN_PER_PERIOD = 64  # that a reduction is looked at with where the step is not known yet
# A step that is chosen is as large as its tolerance allows, and the integrator's error is not the same in the
# coordinates of the two models: a reduction is looked at with smaller steps then, where it is a sixteenth. With a step
# that is given, the two models have to agree: that is where they will be compared.
FINER_THAN_CHOSEN = 4


class StepChoice:
    """The step of a scene: given, or as the tolerance wants it. Collective on the bench's ranks.

    The ledger takes what was tried; the period is that of the first flexible mode, s, and `model` says whose runs these
    are. The `search` knows how many steps the full-order model needs, and those of its finest run that is at hand.
    """

    def __init__(self, bench: Bench, ledger: Ledger, period: float, model: str = "full") -> None:
        self._bench, self._ledger, self._model = bench, ledger, model
        simulation = bench.scene.simulation
        self.tolerance = simulation.tolerance
        self.kept = not simulation.is_chosen
        self.n_given = simulation.n_steps
        self._duration = simulation.duration
        self._multiple = steps_of_samplings(bench.scene)
        self._coarsest, self._first = first_steps(bench.scene, period)
        self._periods = self._first / FIRST_PER_PERIOD
        self.loads = tuple(load.name for load in bench.training.loads if load.for_step)
        of_step = STEP * (np.inf if self.tolerance is None else self.tolerance)
        self.search = StepSearch(self._compare, self._first, of_step, self._coarsest, self._multiple)
        if self.kept:
            self.search.chosen = self.search.finest = self.n_given
        self._last: Errors | None = None
        self._n_reduced = 0

    @property
    def allowed(self) -> dict[str, float]:
        """Largest error of the step that is allowed; empty without a tolerance."""
        return {} if self.tolerance is None else {"step": STEP * self.tolerance}

    @property
    def n_steps(self) -> int:
        return self._n_reduced or self.search.chosen

    @property
    def n_basis(self) -> int:
        """Number of steps that the reduction is looked at with."""
        if self.kept:
            return self.n_given
        most = UNKNOWN_PER_PERIOD // FIRST_PER_PERIOD * self._first
        if self.search.chosen is None:
            return most
        # whatever longer step is chosen: with it both models damp the vibrations that tell bases apart
        resolving = max(self.search.chosen, self._first)
        return min(FINER_THAN_CHOSEN * resolving, max(most, self.search.chosen))

    @property
    def step(self) -> float:
        """The chosen step, s."""
        return self._step_of(self.n_steps)

    def begin(self) -> None:
        """Check a given step, or look for one as far as that is quick."""
        if self.tolerance is None:
            return
        if not self.kept:
            self.search.advance(min(round(EARLY_PER_PERIOD * self._periods), self._most))
            return
        n = self.n_given
        ahead = AHEAD if AHEAD * n <= self._most else 2
        errors = self._bench.moved(n, ahead * n, self.loads)
        self._note(n, errors)
        if errors.largest > STEP * self.tolerance:
            given = f"simulation.step = {self._bench.scene.simulation.step:g}"
            hints = [f"{given} is kept as given; leave it out to have it chosen"]
            part = "round-off" if errors.is_round_off else "step"
            refuse("simulation.tolerance", self.tolerance, part, self.allowed, self._ledger, hints)

    def finish(self, others: Mapping[str, float]) -> None:
        """Look further, if the step is not known. Raises `InputError` if the smallest step that is tried is not small
        enough, with what the other parts of the error may be."""
        if self.kept:
            return
        search = self.search
        search.advance(self._most)
        search.settle_for_finest()
        if search.chosen is None:
            last = self._last
            self._note(search.finest, last)
            worst = last.outputs[last.place[1]]
            still = f"the last halving, to {search.finest} steps, still moves {worst} by {last.largest:.2g}"
            part, hints = (
                "step",
                [
                    f"{still}: the loads or the start set off vibrations that nothing damps, and their phase has to be "
                    f"kept over the run; more than {search.finest} steps are not tried",
                    "a torque without corners sets off less; simulation.step takes any step as given",
                ],
            )
            if 2 * search.finest <= self._most_anyway and search.finest > self._bench.most_steps / 2:
                hints.append(
                    f"more are beyond reference.budget = {self._bench.scene.reference.budget:g} s: raise it, or name "
                    "reference.model to take them at their price"
                )
            if last.is_round_off:
                part, hints = "round-off", [f"{still}: {ZERO}"]
            refuse("simulation.tolerance", self.tolerance, part, others | self.allowed, self._ledger, hints)
        self._ledger.reasons["simulation.step"] = (
            f"{search.chosen} steps leave {search.error:.2g}, allowed {search.allowed:.2g}, against "
            f"{search.finest} steps"
        )

    def fit_reduced(self, trial: Trial) -> None:
        """Take the fewest steps with which the reduced model keeps the tolerance.

        Where both models need more than the reduction was looked at with, it is the vibrations that do.
        """
        if self.kept or self.n_steps > trial.n_steps:
            return
        n_steps = self._first
        while n_steps < trial.n_steps and not self._good_for_reduced(trial, n_steps):
            n_steps = min(2 * n_steps, trial.n_steps)
        if n_steps == self._first:  # longer ones only where these are good enough, as in the search
            while n_steps > self._coarsest and self._good_for_reduced(trial, n_steps // 2):
                n_steps //= 2
        self._n_reduced = n_steps
        if n_steps == trial.n_steps:
            self._ledger.reasons["simulation.step"] += (
                f"; the reduced model takes the {n_steps} that it was judged with"
            )

    def _good_for_reduced(self, trial: Trial, n_steps: int) -> bool:
        """Return whether so many steps of the reduced model keep the tolerance, and note it."""
        errors = self._bench.errors(self.loads, trial.at(n_steps), trial.at(fine_enough(n_steps, self._first)))
        self._note(n_steps, errors, "reduced")
        good = errors.largest <= STEP * self.tolerance
        if good or n_steps >= self._first:
            self._ledger.reasons["simulation.step"] = (
                f"{n_steps} steps leave {errors.largest:.2g}, allowed {STEP * self.tolerance:.2g}, of the reduced "
                f"model itself; the full-order one needs {self.search.chosen}"
            )
        return good

    @property
    def _most(self) -> int:
        most = self._first * 2 ** round(np.log2(self._most_anyway / self._first))
        while most > max(self._bench.most_steps, SEEN * self._first):
            most //= 2
        return most

    @property
    def _most_anyway(self) -> float:
        """Steps beyond which none are tried, whatever they would take."""
        return max(MOST_ANYWAY, MOST_PER_PERIOD * self._periods)

    def _compare(self, coarse: int, fine: int) -> np.ndarray:
        errors = self._bench.moved(coarse, fine, self.loads)
        if fine >= AHEAD * coarse:
            self._note(coarse, errors)
        else:
            self._last = errors
        return errors.by_output

    def _step_of(self, n_steps: int) -> float:
        # samplings are at ends of steps
        return (rounded_step if self._multiple == 1 else step_of)(self._duration, n_steps)

    def _note(self, n_steps: int, errors: Errors, model: str = "") -> None:
        step = self._bench.scene.simulation.step if self.kept else self._step_of(n_steps)
        self._ledger.add("step", {"step": step, "model": model or self._model}, n_steps, errors)


def settle_step(model: Model, comm: Comm, ensemble: bool) -> tuple[Model, str]:
    """Return a model with the step that its scene's tolerance allows, and what was chosen. Collective on `comm`.

    The step follows from runs of the model itself, those to come: the scene's own loads; for an ensemble with the
    training values of its parameters. Without a tolerance the model is returned as it is, and nothing is to be said. A
    step that the scene gives is kept. Raises `InputError` if no step, or not the given one, keeps the tolerance.
    """
    simulation = model.scene.simulation
    if simulation.tolerance is None:
        return model, ""
    if not model.scene.outputs:
        raise InputError(
            "simulation.tolerance: errors are those of outputs, and the scene has none; name some in [outputs]"
        )
    values, n_samples = {name: np.array([value]) for name, value in model.scene.values.items()}, 1
    if ensemble:
        values, n_samples = spanning_values(model.scene)
    period, ledger, per_step = period_of(model, comm), Ledger(), step_price(model)
    reference = Reference(model, Price(per_step, 0.0), "", {})
    step = StepChoice(
        Bench(reference, Training.of_own_loads(model.scene, values, n_samples), comm), ledger, period, model.name
    )
    fewest = (1 + AHEAD) * step.n_given if step.kept else 2 * SEEN * first_steps(model.scene, period)[1]
    price, limit = Price(per_step, float(fewest * n_samples)), model.scene.reference
    if limit.model == "auto" and price.seconds > limit.budget:
        raise InputError(
            f"simulation.tolerance = {simulation.tolerance:g}: to find the step, the {model.title} model has to run "
            f"{price.steps:.2g} steps, which are predicted to take {price} of processor time; reference.budget = "
            f"{limit.budget:g} s: raise it, name reference.model to run them at their price, or give simulation.step "
            "and leave simulation.tolerance out"
        )
    step.begin()
    step.finish({})
    entries = simulation.model_dump() | {"tolerance": None, "step": simulation.step if step.kept else step.step}
    settled = model.with_loads(model.scene.with_entries(simulation=Simulation(**entries)))
    tolerance = f"simulation.tolerance = {simulation.tolerance:g}"
    if step.kept:
        best = ledger.best("step")
        given = f"simulation.step = {simulation.step:g}"
        return settled, f"{tolerance}: {given} is kept as given; it leaves {best.largest:.2g}"
    return settled, f"{tolerance}: simulation.step = {step.step:g} was chosen; {ledger.reasons['simulation.step']}"
