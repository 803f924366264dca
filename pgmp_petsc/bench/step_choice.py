"""What is tried for tolerances: shares of a tolerance, what was tried to meet it, and refusals where it cannot be met,
which say what part of the error is too large, with the figures; and the step that a tolerance allows, from runs with
steps that are halved: of a full-order and a reduced model under the training loads, or of a run to come.

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

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NoReturn

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bench.bench import Bench, step_price
from pgmp_petsc.bench.history import Errors, Training, Trial, step_of, stops_of
from pgmp_petsc.bench.prices import Price
from pgmp_petsc.bench.reference import Reference, period_of
from pgmp_petsc.effects.time_function import amplitude_of
from pgmp_petsc.models import Model
from pgmp_petsc.results.selection import Attempt
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.controllers import steps_of_samplings
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.scene.parameters import spanning_values

FELL = 0.4  # an error that falls below this share of itself has found its cause
SOFTER = 0.1  # times the stiffness of end stops, that tells whether impacts are the cause
UNRESOLVED = 5.0  # times the error, moved by halving the step: no basis can be judged with it
PARTS = {
    "basis": "the basis",
    "interpolation": "the interpolation between angles",
    "step": "the time step",
    "round-off": "round-off",
}
OWN_LOADS = 'reference.loads = "own" tries no others, and the tolerance then holds for no others'
ZERO = "it is below 1e-10 rad, or 1e-10 of the mechanism's size, and what is as small counts as zero"

# Of the tolerance. Those of the reduction, and the step's, are half of it each: a factor of two to spare for what took
# no part in the training; with equal tolerances the parts together are within it even where all are largest at once.
BASIS, INTERPOLATION, STEP = 0.35, 0.15, 0.5
REDUCTION = BASIS + INTERPOLATION
BASIS_ALONE = 0.45  # of the tolerance, where no basis does with its share: nearly all that both have together


def shares_of(fixed_grid: bool) -> dict[str, float]:
    """Return the shares of the reduction's tolerance; with fixed angles, interpolation is part of the basis's error."""
    return {"basis": REDUCTION} if fixed_grid else {"basis": BASIS, "interpolation": INTERPOLATION}


@dataclass
class Ledger:
    """Attempts in their order, and reasons of what was chosen, by dotted name."""

    attempts: list[Attempt] = field(default_factory=list)
    reasons: dict[str, str] = field(default_factory=dict)

    def add_trial(self, part: str, keys: tuple[str, ...], trial: Trial, errors: Errors, cost: float = 0.0) -> None:
        """Note a candidate; `errors` are those that count for the part."""
        entries = {key: getattr(trial.reduction, key) for key in keys}
        self.add(part, entries, trial.n_steps, errors, cost, trial.seconds, trial.reason)

    def add(
        self, part: str, entries: Mapping[str, Any], n_steps: int, errors: Errors, cost: float = 0.0,
        seconds: float = 0.0, reason: str = "",
    ) -> None:  # fmt: skip
        """Note an attempt; one that is looked at again, under more loads, takes the place of the first look."""
        self.attempts = [a for a in self.attempts if (a.part, a.entries, a.n_steps) != (part, entries, n_steps)]
        self.attempts.append(
            Attempt(part, entries, n_steps, errors.by_output, errors.largest, errors.where, cost, seconds, reason)
        )

    def best(self, part: str) -> Attempt | None:
        """Return the attempt with the smallest error; of candidates, among those with the step of the last one."""
        of_part = [attempt for attempt in self.attempts if attempt.part == part]
        tried = [attempt for attempt in of_part if np.isfinite(attempt.largest)]
        if part != "step":
            tried = [attempt for attempt in tried if attempt.n_steps == of_part[-1].n_steps]
        return min(tried, key=lambda attempt: attempt.largest) if tried else None


def refuse(
    entry: str, tolerance: float, part: str, allowed: Mapping[str, float], ledger: Ledger, hints: Sequence[str]
) -> NoReturn:
    """Raise an `InputError` with the best that every part reached, its allowed error, and further lines.

    `part` is the part of the error that exceeds its share of the tolerance, which is that of an entry.
    """
    lines = [f"{entry} = {tolerance:g}: cannot be met, {PARTS[part]} stands in the way"]
    extra = {attempt.part: None for attempt in ledger.attempts if attempt.part not in allowed}
    for name, limit in (allowed | extra).items():
        best = ledger.best(name)
        if best is not None:
            what = ", ".join(f"{key} = {json.dumps(value)}" for key, value in best.entries.items())
            of_it = "part of the basis's error" if limit is None else f"allowed {limit:.2g}"
            lines.append(f"  {name}: at best {best.largest:.2g}, {of_it} ({what}; {best.where})")
        else:
            tried = [attempt.reason for attempt in ledger.attempts if attempt.part == name and attempt.reason]
            untold = "not known" if limit is None else f"not looked at any more, allowed {limit:.2g}"
            lines.append(f"  {name}: {tried[-1] if tried else untold}")
    raise InputError("\n".join([*lines, *(f"  {hint}" for hint in hints)]))


def refuse_basis(
    bench: Bench, trial: Trial, allowed: Mapping[str, float], ledger: Ledger, last: Sequence[str], rival: Trial | None
) -> NoReturn:
    """Find out what is wrong with the best basis and raise an `InputError` that says so.

    It may be the load's size, the parameters' distance, the step, how bodies stretch, or round-off. `trial` is the best
    that was found, `rival` the largest basis that follows stretching in the other way, `last` are further lines.
    """
    entry, tolerance, errors = "reduction.tolerance", bench.scene.reduction.tolerance, trial.errors
    if not np.isfinite(errors.largest):
        refuse(entry, tolerance, "basis", allowed, ledger, last)
    possible = f"a tolerance of {1.05 * errors.largest * tolerance / allowed['basis']:.1e} can be met by this part"
    if errors.is_round_off:
        refuse(entry, tolerance, "round-off", allowed, ledger, [f"of the basis's error: {ZERO}", possible, *last])
    looks, (_, output, _), n_steps = _Looks(bench, trial, rival), errors.place, trial.n_steps
    part, causes = looks.causes()
    if not causes and looks.unresolved > tolerance:
        causes.append(
            f"{n_steps} steps themselves leave more than the tolerance: take a smaller simulation.step, or let "
            "simulation.tolerance choose it"
        )
    hints = [
        f"of the basis's error, half the load leaves {looks.half:.2g}, half the step {looks.finer:.2g}; at nominal "
        f"parameters it is {looks.nominal:.2g}; halving the step moves the full-order {errors.outputs[output]} itself "
        f"by {looks.unresolved:.2g}"
    ]
    if causes:
        hints.append("; ".join(causes))
    hints += looks.of_own_loads(allowed["basis"])
    mesh = bench.finer_meshes(n_steps)
    if mesh is not None and mesh.by_output[output] > tolerance:
        hints.append(
            "the mesh itself leaves more than the tolerance: cells cut in two would move "
            f"{errors.outputs[output]} by {mesh.by_output[output]:.2g}"
        )
    refuse(entry, tolerance, part, allowed, ledger, [*hints, possible, *last])


class _Looks:
    """What runs beside that with the largest error of a basis tell of its cause; see `refuse_basis`.

    `half` and `finer` are the error with half the load, and with half the step, `nominal` is the largest error at
    nominal parameters, `unresolved` by what half the step moves the full-order output.
    """

    def __init__(self, bench: Bench, trial: Trial, rival: Trial | None) -> None:
        self._bench, self._trial, self._rival, self._errors = bench, trial, rival, trial.errors
        load, *place = self._errors.place
        self._load = self._errors.loads[load]
        name, at, again = (self._load,), (0, *place), replace(trial, n_steps=2 * trial.n_steps)
        self.half = bench.errors(name, trial.setting, trial.exact, factor=0.5).values[at]
        self.finer = bench.errors(name, again.setting, again.exact).values[at]
        self.unresolved = bench.moved(trial.n_steps, again.n_steps, name).values[at]
        self.nominal = np.nanmax(self._errors.values[:, :, 0])

    def causes(self) -> tuple[str, list[str]]:
        """Return which part of the error stands in the way of a basis, and why."""
        largest = self._errors.largest
        if self.finer <= FELL * largest:
            return "step", [
                f"with {self._trial.n_steps} steps, errors of time integration are not the same in the two models: "
                "take a smaller simulation.step, or let simulation.tolerance choose it"
            ]
        impacts = self._of_stops()
        causes = [*impacts]
        # half the load may not reach a stop, and then tells nothing of the deformation
        if self.half <= FELL * largest and not impacts:
            too_large = "the deformation is too large for the terms of first and second order that a reduced model has"
            causes.append(too_large)
        other = [] if impacts else self._of_rival()
        causes += other
        # where a larger basis fails by the deformation, it is not the modes that miss these values
        if self.nominal <= FELL * largest and not other:
            causes.append("the modes are those of nominal parameters, and these values are too far from them")
        if self.unresolved > UNRESOLVED * largest:
            causes.append("the loads set off vibrations that the step does not resolve and a small basis does not have")
            causes += self._cure_of_sudden_loads()
        return "basis", causes

    def _of_rival(self) -> list[str]:
        """Return what the basis that follows stretching in the other way tells of the cause."""
        rival = self._rival
        if rival is None:
            return []
        load, output, sample = rival.errors.place
        weak = self._bench.errors((rival.errors.loads[load],), rival.setting, rival.exact, factor=0.5)
        weak, kind, causes = weak.values[0, output, sample], rival.reduction.stretching, []
        if weak <= FELL * rival.errors.largest:
            causes.append(
                f'with stretching = "{kind}", {rival.reduction.modes} modes leave {rival.errors.largest:.2g}, but '
                f"{weak:.2g} under half the load: the deformation is too large for terms of second order; take smaller "
                "loads, stiffer bodies, or parameters that vary less"
            )
        if kind == "dynamic" and weak <= FELL * self.half:
            causes.append(
                'stretching = "static" leaves out the vibrations that stretch bodies, under any load: where loads are '
                "smaller, dynamic stretching keeps smaller tolerances"
            )
        return causes

    def _of_stops(self) -> list[str]:
        """Return what softer end stops tell of the cause: impacts shake bodies faster than bases follow."""
        stops, trial, (_, output, sample) = stops_of(self._bench.scene), self._trial, self._errors.place
        if not stops:
            return []
        soft = self._bench.errors((self._load,), trial.setting, trial.exact, lambda case: case.softer(SOFTER))
        left = soft.values[0, output, sample]
        if not left <= FELL * self._errors.largest:
            return []
        return [
            f"impacts on {' and '.join(f'effects.{name}' for name in stops)} set off vibrations that no larger basis "
            f"follows: stops {SOFTER:g} times as stiff leave {left:.2g} of {self._errors.outputs[output]} "
            f"under load '{self._load}', and {soft.largest:.2g} of all outputs"
        ]

    def of_own_loads(self, allowed: float) -> list[str]:
        """Return what the scene's own loads leave where others are worse, and whether it helps to try no others."""
        own = self._bench.training.loads[0].name
        if self._load == own or own not in self._errors.loads:
            return []
        tried = [self._trial] if self._rival is None else [self._trial, self._bench.go_on(self._rival, (own,))]
        left, k = min((np.nanmax(each.errors.values[each.errors.loads.index(own)]), k) for k, each in enumerate(tried))
        if not left <= allowed:
            return [f"the scene's own loads alone leave {left:.2g} too"]
        kind = tried[k].reduction
        which = "" if k == 0 else f' with {kind.modes} modes and stretching = "{kind.stretching}"'
        return [f"the scene's own loads leave {left:.2g}{which}: {OWN_LOADS}"]

    def _cure_of_sudden_loads(self) -> list[str]:
        """Return what sets in at once at the start, and what spares the bodies that jolt.

        A start at rest is proposed where halving the step moves much less with that than without.
        """
        scene, (_, output, sample) = self._bench.scene, self._errors.place
        moving = any(state.velocity != 0.0 for state in scene.simulation.initial.values())
        rests = moving or scene.initial.equilibrium and scene.initial.coordinates == "free"
        weights = [] if rests else [name for name, effect in scene.effects.items() if effect.uniform]
        acting = {name: effect for name, effect in scene.plain_effects.items() if effect.is_over_time}
        sudden = [name for name, effect in acting.items() if amplitude_of(effect).at_start != 0.0]
        cures = []
        if weights:
            moved, left = (of[output] for of in self._bench.from_rest(self._trial, self._load, sample))
            if moved <= FELL * self.unresolved:
                cures.append(
                    f"{_effects(weights)} at once at the start, on bodies that are not at rest under it: "
                    'initial = { equilibrium = true, coordinates = "free" } starts where they are, halving the step '
                    f"then moves {moved:.2g}, and the same basis leaves {left:.2g}"
                )
        if sudden:
            cures.append(f"{_effects(sudden)} at once at the start: let what acts over time begin at zero")
        return cures


def _effects(names: Sequence[str]) -> str:
    return " and ".join(f"effects.{name}" for name in names) + (" acts" if len(names) == 1 else " act")


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
