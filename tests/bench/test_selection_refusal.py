"""The choice on errors that are known, and what stands in the way of a tolerance that cannot be met."""

from dataclasses import replace

import numpy as np
import pytest
from refusals import refusal

from pgmp_petsc.base.errors import RunError
from pgmp_petsc.bench.choice import ReductionChoice
from pgmp_petsc.bench.history import Errors, Load, Setting, Training, Trial
from pgmp_petsc.bench.prices import Limits
from pgmp_petsc.bench.step_choice import Ledger, StepChoice, fine_enough
from pgmp_petsc.scene.numerics import Reduction
from scenes import slider_crank

LOADS = (Load("own", "", {}, True), Load("quick", "", {}, False))
PAPER = Limits(n_modes=30, n_static=1, n_terms=3, n_unknowns=36)


def training() -> Training:
    return Training(slider_crank(), {"r1": np.array([1.0])}, 1, LOADS, ())


def errors_of(values: tuple[float, ...], round_off: float = 0.0) -> Errors:
    """Return errors of one output and sample, by load."""
    shape = (len(values), 1, 1)
    names = tuple(load.name for load in LOADS[: len(values)])
    return Errors(np.reshape(values, shape), np.full(shape, round_off), names, ("x",), training())


class Known:
    """A bench that knows the errors of every candidate: of the basis under the quick load, of the angles under all."""

    def __init__(
        self, basis, round_off: float = 0.0, builds: bool = True, given: str = "", budget: float = np.inf
    ) -> None:
        self.scene = slider_crank(f"reduction={{tolerance=1e-2{given}}}")
        self.outputs, self.training = ("x",), training()
        self._basis, self._round_off, self._builds = basis, round_off, builds
        self.budget, self.remarks, self.spent = budget, [], 0.0
        self.tried: list[Reduction] = []

    def _grid(self, reduction: Reduction) -> float:
        return 1e-3 * (32.0 / reduction.angles) ** (4.0 if reduction.interpolation == "spline" else 6.0)

    def try_out(self, reduction: Reduction, n_steps: int, loads: tuple[str, ...] | None = None) -> Trial:
        self.tried.append(reduction)
        values = [self._grid(reduction) + share * self._basis(reduction) for share in (0.5, 1.0)]
        if not self._builds:
            values = [np.inf, np.inf]
        errors = errors_of(tuple(values), self._round_off)
        if loads is not None:
            errors = replace(errors, values=errors.values[1:], round_off=errors.round_off[1:], loads=loads)
        return Trial(reduction, n_steps, errors, "" if self._builds else "no convergence", 0.0, self._builds)

    def go_on(self, trial: Trial, loads: tuple[str, ...] | None = None) -> Trial:
        return trial if len(trial.errors.loads) == 2 else self.try_out(trial.reduction, trial.n_steps)

    def apart(self, one: Trial, other: Trial) -> Errors:
        if not self._builds:
            return errors_of((np.inf,))
        return errors_of((abs(self._grid(one.reduction) - self._grid(other.reduction)),))

    def weakened(self, reduction: Reduction, largest: float) -> float:
        return 0.25 * largest

    def softened(self, largest: float) -> float:
        return largest

    def errors(self, names, found: Setting, exact: Setting, of=None, factor: float = 1.0) -> Errors:
        """Return those of half the load, of softer stops, or of another step."""
        largest = self._grid(found.reduction) + self._basis(found.reduction)
        largest = largest if factor == 1.0 else self.weakened(found.reduction, largest)
        return errors_of((largest if of is None else self.softened(largest),))

    def from_rest(self, trial: Trial, load: str, sample: int) -> tuple[np.ndarray, np.ndarray]:
        return np.array([1e-9]), np.array([2e-3])

    def moved(self, coarse: int, fine: int, loads: tuple[str, ...]) -> Errors:
        return errors_of((1e-9,))

    def finer_meshes(self, n_steps: int) -> Errors:
        return errors_of((2e-2,))


def choice(bench: Known) -> ReductionChoice:
    return ReductionChoice(bench, Ledger(), PAPER, 100, {})


def refused(bench: Known, *words: str) -> str:
    """Return the message with which a choice is refused; the words are in it."""
    message = refusal(choice(bench).run)
    for expected in words:
        assert expected in message, message
    return message


def falling(reduction: Reduction) -> float:
    """More modes help, terms of second order help four times."""
    return 0.05 / reduction.modes**2 / (4.0 if reduction.second_order else 1.0)


@pytest.mark.parametrize(
    ("basis", "given", "modes", "second_order"),
    [
        # 0.05 / 16 is less than 0.35 of a hundredth, 0.05 / 9 is not; three coordinates with terms of second order
        # cost less than five without
        (falling, "", 2, True),
        (falling, ", second_order=false", 4, False),
        # modes alone do not help
        (lambda reduction: falling(reduction) + (0.0 if reduction.second_order else 5e-3), "", 2, True),
        # the middle basis misses by little: the dearer family is not taken for that
        (lambda reduction: 0.2 / reduction.modes**2 / (1.3 if reduction.second_order else 1.0), "", 10, False),
    ],
)
def test_the_cheapest_basis_with_the_fewest_angles(basis, given: str, modes: int, second_order: bool) -> None:
    run = choice(Known(basis, given=given))
    assert run.price.startswith("candidates: ") and "of processor time each, built and run" in run.price
    found = run.run().reduction
    assert (found.modes, bool(found.second_order), found.angles) == (modes, second_order, 32)
    assert not second_order or "with false" in run._ledger.reasons["reduction.second_order"]


def test_a_basis_may_have_what_the_angles_do_not_need() -> None:
    """No basis leaves less than 4e-3 where 3.5e-3 are allowed; 48 angles leave 1e-4 of the 5e-3 for both together."""
    bench = Known(lambda reduction: 4e-3 if reduction.modes >= 5 else 2e-2)
    chosen = choice(bench)
    found = chosen.run().reduction
    assert found.modes == 5 and chosen.allowed == pytest.approx({"basis": 4.5e-3, "interpolation": 5e-4})
    assert bench._basis(found) + bench._grid(found) <= 5e-3


@pytest.mark.parametrize(
    ("left", "round_off", "patches", "words"),
    [
        (0.03, 0.0, {}, (
            "reduction.tolerance = 0.01: cannot be met, the basis stands in the way", "x, load 'quick'",
            "basis: at best 0.03, allowed 0.0045", "half the load leaves 0.0075",
            "too large for the terms of first and second order", "a tolerance of 7.0e-02",
            "the mesh itself leaves more than the tolerance: cells cut in two would move x by 0.02",
            "the scene's own loads alone leave 0.015 too")),
        # the own loads leave half: 3.6e-3 of the best basis, and 4.5e-3 are allowed
        (7e-3, 0.0, {}, ('own loads leave 0.0036: reference.loads = "own" tries no others',)),
        (0.03, 0.1, {}, ("round-off stands in the way",)),
        (0.03, 0.0, {"moved": lambda *_: errors_of((0.1,)), "weakened": lambda reduction, largest: largest},
         ("100 steps themselves leave more than the tolerance",)),
        (falling, 0.0, {"_grid": lambda reduction: 500.0 / reduction.angles},
         ("interpolation between angles stands in the way",
          "the tables change too fast over the range for 768 angles")),
    ],
)  # fmt: skip
def test_what_stands_in_the_way_is_said_with_its_figures(monkeypatch, left, round_off, patches, words) -> None:
    bench = Known(left if callable(left) else lambda reduction: left, round_off=round_off)
    for name, function in patches.items():
        monkeypatch.setattr(bench, name, function)
    refused(bench, *words)
    if left == 0.03 and not patches:
        assert len(bench.tried) < 25, "a search without progress ends"
        assert max(reduction.angles for reduction in bench.tried) <= 96, "no more angles where a basis leaves it"


def test_the_own_loads_are_offered_with_the_other_kind_of_stretching_where_that_does(monkeypatch) -> None:
    bench = Known(beyond_second_order)

    def go_on(trial: Trial, loads: tuple[str, ...] | None = None) -> Trial:
        if len(trial.errors.loads) == 2:
            return trial
        found = bench.try_out(trial.reduction, trial.n_steps)
        own = 4e-3 if trial.reduction.stretching == "dynamic" else 9e-3
        return replace(found, errors=errors_of((own, found.errors.values[1, 0, 0])))

    monkeypatch.setattr(bench, "go_on", go_on)
    refused(bench, 'own loads leave 0.004 with 29 modes and stretching = "dynamic": reference.loads = "own"')


STOP = "effects.wall={type='end_stop', joint='slider', upper=0.99, stiffness=2e4}"


@pytest.mark.parametrize(
    ("soft", "words"),
    [
        (1e-3, "stops 0.1 times as stiff leave 0.001 of x under load 'quick', and 0.001 of all outputs"),
        (2e-2, "too large for the terms of first and second order"),
    ],
)
def test_impacts_are_told_from_a_deformation_that_is_too_large(monkeypatch, soft: float, words: str) -> None:
    """Half the load leaves a quarter in all cases: it may not reach the stop."""
    bench = Known(lambda reduction: 0.03)
    bench.scene = slider_crank("reduction={tolerance=1e-2}", STOP)
    monkeypatch.setattr(bench, "softened", lambda largest: soft)
    message, impacts = refused(bench, words), "impacts on effects.wall set off vibrations that no larger basis follows"
    assert (impacts in message) != ("too large for the terms" in message)


def beyond_second_order(reduction: Reduction) -> float:
    """With static stretching a floor, with dynamic stretching more."""
    if not reduction.second_order:
        return 0.1
    return 0.01 + 0.001 / reduction.modes if reduction.stretching == "static" else 0.03


def test_a_deformation_beyond_second_order_is_told_by_the_other_kind_of_stretching(monkeypatch) -> None:
    """Under half the load static stretching leaves what it left, dynamic stretching a tenth."""
    bench = Known(beyond_second_order)

    def weakened(reduction: Reduction, largest: float) -> float:
        return (0.9 if reduction.stretching == "static" else 0.1) * largest

    monkeypatch.setattr(bench, "weakened", weakened)
    message = refused(
        bench,
        'with stretching = "dynamic", 29 modes leave 0.03, but 0.003 under half the load: the deformation is too large',
        'stretching = "static" leaves out the vibrations that stretch bodies, under any load',
    )
    assert "modes are those of nominal parameters" not in message


def test_what_is_too_dear_is_not_tried_and_is_said() -> None:
    bench, free = (Known(lambda reduction: 0.03 / reduction.modes**0.5, budget=budget) for budget in (10.0, np.inf))
    left_out = "flexible coordinates with terms of second order and what is dearer were not"
    assert left_out in refused(bench) and left_out not in refused(free)
    good = Known(falling, budget=10.0)
    choice(good).run()
    given = Known(lambda reduction: 1e-5, budget=1e-3, given=", modes=20, second_order=true, stretching='static'")
    assert choice(given).run().reduction.modes == 20 and not given.remarks, "what is given is tried"
    (remark,) = good.remarks
    assert left_out in remark and "reference.budget = 10 s" in remark and "MB" in remark


@pytest.mark.parametrize("budget", [0.1, 1.0, 2.0, 4.0])
def test_candidates_together_are_within_the_budget(budget: float) -> None:
    """All but the first, which is tried in any case; what was not tried is said."""
    bench = Known(lambda reduction: 0.03 / reduction.modes**0.5, budget=budget)
    refused(bench, "the search ended early: candidates", f"more than reference.budget = {budget:g} s; raise the budget")
    assert bench.spent <= budget or len(bench.tried) == 1


def test_a_basis_that_was_found_before_the_budget_ended_is_taken_and_that_is_said() -> None:
    bench, free = (Known(falling, budget=budget) for budget in (10.0, np.inf))
    bench.spent = 9.9
    few, all_of_them = (choice(each).run().reduction for each in (bench, free))
    assert few.modes > all_of_them.modes and few.angles < 48, "fewer angles are cheap"
    assert any(remark.startswith("the search ended early") for remark in bench.remarks)
    assert not free.remarks


AT_REST = "initial={equilibrium=true, coordinates='free'}"
GRAVITY, MOTOR = "effects.weight={type='gravity'}", "effects.motor.table=[[0.0, 0.5], [1.0, 0.5]]"


@pytest.mark.parametrize(
    ("overrides", "weight", "motor"),
    [((), False, False), ((GRAVITY,), True, False), ((GRAVITY, AT_REST), False, False), ((MOTOR,), False, True)],
)
def test_what_sets_in_at_once_is_named_where_vibrations_are_the_cause(
    monkeypatch: pytest.MonkeyPatch, overrides: tuple[str, ...], weight: bool, motor: bool
) -> None:
    bench = Known(lambda reduction: 0.03)
    bench.scene = slider_crank("reduction={tolerance=1e-2}", *overrides)
    monkeypatch.setattr(bench, "moved", lambda *_: errors_of((0.7,)))
    message = refused(bench, "vibrations that the step does not resolve")
    assert ("effects.weight acts at once at the start" in message) == weight
    assert ("halving the step then moves 1e-09, and the same basis leaves 0.002" in message) == weight
    assert ("effects.motor acts at once at the start: let what acts over time begin" in message) == motor
    # a start at rest is not proposed where the step misses as much from there
    monkeypatch.setattr(bench, "from_rest", lambda *_: (np.array([0.5]), np.array([2e-3])))
    assert "initial = {" not in refused(bench, "vibrations that the step does not resolve")


def test_parameter_modes_that_many_modes_leave_no_room_for_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside four modes and more none is independent: larger bases go without, and are good enough."""
    bench = Known(lambda reduction: 0.1 / reduction.modes**2)
    plain = bench.try_out

    def try_out(reduction: Reduction, n_steps: int, loads: tuple[str, ...] | None = None) -> Trial:
        trial = plain(reduction, n_steps, loads)
        fits = reduction.parameter_modes == 0 or reduction.modes < 4
        return trial if fits else replace(trial, built=False, reason="reduction.parameter_modes = 2: take fewer")

    monkeypatch.setattr(bench, "try_out", try_out)
    uncertain = replace(PAPER, uncertain=True)
    found = ReductionChoice(bench, Ledger(), uncertain, 100, {"static_modes": 0.0}).run().reduction
    assert found.modes >= 5 and found.parameter_modes == 0
    asked = {(reduction.modes, reduction.parameter_modes) for reduction in bench.tried}
    for modes, parameter_modes in asked:
        assert parameter_modes == 0 or modes < 4 or (modes, 0) in asked


class Partly(Known):
    """Some candidates cannot be built."""

    def __init__(self, basis, builds, **known) -> None:
        super().__init__(basis, **known)
        self._can = builds

    def try_out(self, reduction: Reduction, n_steps: int, loads: tuple[str, ...] | None = None) -> Trial:
        self._builds = self._can(reduction)
        return super().try_out(reduction, n_steps, loads)

    def apart(self, one: Trial, other: Trial) -> Errors:
        self._builds = one.built and other.built
        return super().apart(one, other)


@pytest.mark.parametrize("missing", [{7}, {5, 7}, {4, 5, 7}])
def test_where_the_middle_cannot_be_built_its_neighbours_are_tried_before_more_angles(missing: set[int]) -> None:
    """The last mode of some bases meets the next one, however many angles there are."""
    bench = Partly(lambda r: 0.1 / r.modes**2, lambda r: r.modes not in missing and not r.second_order)
    found = choice(bench).run().reduction
    assert (found.modes, found.second_order, found.angles) == (10, False, 32)
    assert max(reduction.angles for reduction in bench.tried) <= 96


def test_angles_are_doubled_where_they_and_not_the_basis_leave_what_is_left() -> None:
    bench = Known(lambda reduction: 1e-4 / reduction.modes)
    bench._grid = lambda reduction: 2.0 * (32.0 / reduction.angles) ** 4
    found = choice(bench).run().reduction
    assert found.angles == 192, "2 (32 / 192)^4 is 1.5e-3, and a tenth of it with twice as many"


def test_angles_that_are_too_dear_are_not_tried_and_are_said() -> None:
    """A basis that is given is tried with the first angles, whatever it takes, and not with more."""
    bench = Known(lambda reduction: 1e-4, budget=10.0, given=", modes=28, second_order=true, stretching='static'")
    bench._grid = lambda reduction: 2.0 * (32.0 / reduction.angles) ** 4
    refused(bench, "96 angles were not tried: to build and run such a basis", "reference.budget = 10 s")
    assert {r.angles for r in bench.tried} == {48}


def test_where_nothing_can_be_built_the_run_has_failed() -> None:
    """That is no question of tolerances: exit status 1."""
    with pytest.raises(RunError, match="no convergence"):
        choice(Known(falling, builds=False)).run()


class Steps:
    """Full-order runs of which it is known how far they are apart."""

    def __init__(self, moved: float, round_off: float = 0.0) -> None:
        self.scene = slider_crank("simulation={tolerance=1e-3, duration=1.0}")
        self.outputs, self.training, self.most_steps = ("x",), training(), np.inf
        self._errors = errors_of((moved,), round_off)

    def moved(self, coarse: int, fine: int, loads: tuple[str, ...]) -> Errors:
        return self._errors


@pytest.mark.parametrize(
    ("round_off", "part", "words"),
    [(0.0, "the time step", "vibrations that nothing damps"), (1e-2, "round-off", "1e-10 rad")],
)
def test_the_limit_of_the_step(round_off: float, part: str, words: str) -> None:
    """1024 steps a period are not passed: 65536 where there are fewer than 64 periods."""
    step = StepChoice(Steps(2e-3, round_off), Ledger(), 1.0 / 50.0, "reduced")
    step.begin()
    message = refusal(step.finish, {"basis": 1e-4})
    for expected in (
        f"simulation.tolerance = 0.001: cannot be met, {part} stands in the way", "step: at best 0.002, allowed 0.0005",
        'model = "reduced"', "basis: not looked at any more", words, "to 65536 steps, still moves x by 0.002",
    ):  # fmt: skip
        assert expected in message, message


def test_a_second_look_takes_the_place_of_the_first() -> None:
    """The first was under one load only; errors with other steps are told apart."""
    ledger, bench = Ledger(), Known(falling)
    reduction = bench.scene.reduction
    for values, n_steps in (((1e-4,), 100), ((1e-4, 3e-4), 100), ((9e-5,), 50), ((2e-3,), 100)):
        trial = Trial(reduction, n_steps, errors_of(values), "", 0.0, True)
        ledger.add_trial("basis", ("modes",), replace(trial, reduction=reduction), trial.errors)
    assert [attempt.largest for attempt in ledger.attempts] == [9e-5, 2e-3]
    assert ledger.best("basis").largest == 2e-3
    assert ledger.best("step") is None


class Reduced(Steps):
    """Runs of a full-order model that moves by nothing, and of a reduced one with an error of second order."""

    def __init__(self, per_step: float) -> None:
        super().__init__(0.0, 0.0)
        self.per_step, self.compared = per_step, []

    def errors(self, names: tuple[str, ...], found: Setting, exact: Setting) -> Errors:
        self.compared.append((found.n_steps, exact.n_steps))
        return errors_of((self.per_step / found.n_steps**2,), 0.0)


@pytest.mark.parametrize(("per_step", "n_steps"), [(1.0, 64), (5.0, 128), (20.0, 256), (1e2, 512), (1e4, 1024)])
def test_the_reduced_model_takes_the_longest_step_of_its_own(per_step: float, n_steps: int) -> None:
    """It is compared with runs that see the vibrations, whatever its own step; the trial's is the shortest."""
    bench = Reduced(per_step)
    ledger = Ledger()
    step = StepChoice(bench, ledger, 1.0 / 50.0)
    step.begin()
    step.finish({})
    assert step.search.chosen == 64, "an error of nothing allows the coarsest run"
    assert step.n_basis == 4 * 256, "a basis is judged with steps that see the vibrations"
    step.fit_reduced(Trial(bench.scene.reduction, step.n_basis, errors_of((0.0,), 0.0), "", 0.0, True))
    assert step.n_steps == n_steps
    judged = "the reduced model takes the 1024 that it was judged with"
    assert (judged in ledger.reasons["simulation.step"]) == (n_steps == 1024), "and not what fewer steps leave"
    assert all(fine == fine_enough(coarse, 256) for coarse, fine in bench.compared)
    assert bench.compared[0][0] == 256, "those that see the vibrations come first"
