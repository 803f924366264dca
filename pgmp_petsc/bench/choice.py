"""The choice of what a scene leaves open, one part of the error after the other (docs/method.md, tolerances instead of
knobs): the step (`step_choice`), the reduction at equal steps (`ReductionChoice`), and the reduction once more where
the step became finer than that.

Errors are the largest of any output, sample and load of the training (`history.Training`). Each part may take its
share of the tolerance (`step_choice.Ledger`). Of scenes whose lengths, places or ratios are parameters
(`choose_over_lengths`) what is open is chosen with the nominal lengths, and checked with nothing left open at the ends
of every length.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import ceil
from typing import Any, NoReturn

import numpy as np

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.base.progress import progress
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.bench import prices, step_choice
from pgmp_petsc.bench.bench import Bench
from pgmp_petsc.bench.history import Errors, Training, Trial
from pgmp_petsc.bench.reference import MORE_MODES, Demand, Said, Subject, choose_reference, distance_from_mesh
from pgmp_petsc.bench.step_choice import BASIS_ALONE, REDUCTION, Ledger, refuse, refuse_basis, shares_of
from pgmp_petsc.bodies.shape import Shapes, at_lengths
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.reduction.checkpoint import Finished
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.results.selection import Selection
from pgmp_petsc.scene import Scene, scene_to_toml
from pgmp_petsc.scene.numerics import Reduction, Simulation
from pgmp_petsc.scene.units import own_values, values_text
from pgmp_petsc.scene.uses import extremes, length_names, with_numbers

OF_BASIS = ("modes", "static_modes", "inertia_modes", "parameter_modes", "second_order", "stretching")
OF_GRID = ("angles", "interpolation")
KNOBS = OF_BASIS + OF_GRID
COUNTS = 0.25  # of an error: where twice the angles change no more, it is the basis's own
MUCH_BETTER = 0.7  # a family that leaves less than this share of another's error is climbed in its place
NEAREST = 4  # rungs to the middle that are tried where it cannot be built
FAR = 3.0  # times the allowed error: where one scheme leaves more, another is not tried
STALLED, NEAR = 0.6, 1.5  # more modes are no use where they leave more than this of the error, and of what is allowed


class ReductionChoice:
    """Choice of what a scene leaves open of its reduction. Collective on the bench's ranks.

    The ledger takes what was tried; all runs have `n_steps`, and `others` are what the other parts of the error may be.
    """

    def __init__(
        self, bench: Bench, ledger: Ledger, limits: prices.Limits, n_steps: int, others: dict[str, float]
    ) -> None:
        self._bench, self._ledger, self._n_steps = bench, ledger, n_steps
        reduction = bench.scene.reduction
        self._reduction, self.tolerance = reduction, reduction.tolerance
        self.given = {key: getattr(reduction, key) for key in KNOBS if key in reduction.model_fields_set}
        # with given angles, or those that a build adds by itself, what they leave is part of the basis's error
        self._fixed_grid = "angles" in self.given or reduction.sampling_tolerance is not None
        self._limits = limits
        self._angles = prices.ANGLES[limits.n_coordinates]
        given = self.given.get("interpolation")
        self._schemes = prices.SCHEMES[limits.n_coordinates] if given is None else (given,)
        first = reduction.angles if self._fixed_grid else prices.FIRST_ANGLES[limits.n_coordinates]
        self._grid: dict[str, Any] = {"angles": first, "interpolation": self._schemes[0]}
        self._all_families = prices.families_of(self.given, limits)
        self._take_affordable()
        self._trials: dict[tuple[Any, ...], Trial] = {}
        self._looked_at: list[prices.Rung] = []  # with the present angles
        self._worst_load, self._cut_short = "", ""
        shares = shares_of(self._fixed_grid)
        self.allowed = {part: share * self.tolerance for part, share in shares.items()} | others
        if not self._families[0]:
            raise InputError(
                f"reduction.static_modes = true: the mesh has only {limits.n_modes} flexible modes, the scene "
                f"{limits.n_static} loads; take a finer mesh"
            )

    @property
    def price(self) -> str:
        return self._prices.text(self._families)

    def _take_affordable(self) -> None:
        """Leave out candidates that cost too much at twice the present angles, which show whether these suffice."""
        n_runs = self._n_steps * self._bench.training.n_cases
        most = self._grid["angles"] * (1 if self._fixed_grid else 2)
        self._prices = prices.CandidatePrices(self._limits, n_runs, most)
        self._families, self._too_dear = self._prices.affordable(self._all_families, self._bench.budget)

    def run(self) -> Trial:
        """Choose; the trial that is returned is the reduced model itself.

        The search begins with few angles. They are doubled where that betters the best basis of medium size, and where
        none does it, for as long as that changes the best of all. Raises `InputError` if the tolerance cannot be met.
        """
        while (found := self._cheapest_basis()) is None:
            if self._angles_count(best := self._best_looked_at()):
                self._refine()
                continue
            if not self._shift_to_basis(best):
                self._refuse(best)
            found = self._cheapest_basis() or best
            break
        self._explain(found)
        self._bench.remarks += self._left_out
        return self._trial(found) if self._fixed_grid else self._fewest_angles(found)

    @property
    def _left_out(self) -> list[str]:
        return [text for text in (self._too_dear, self._cut_short) if text]

    def _is_affordable(self, rung: prices.Rung, grid: dict[str, Any]) -> bool:
        """Return whether a candidate was tried, or all of them together stay within the budget with it.

        The first one is tried whatever it takes, and a rung at fewer angles than the present ones, with which it was
        found to be good.
        """
        if not self._trials or _key(rung.entries | grid) in self._trials or grid["angles"] < self._grid["angles"]:
            return True
        if self._bench.spent + self._prices.seconds(rung, grid["angles"]) <= self._bench.budget:
            return True
        self._cut_short = (
            f"the search ended early: candidates that were tried are predicted to take {self._bench.spent:.2g} s of "
            f"processor time, and with the next one more than reference.budget = {self._bench.budget:g} s; raise the "
            "budget, shorten simulation.duration, or give some of the entries of reduction"
        )
        return False

    def _try(self, rung: prices.Rung, grid: dict[str, Any]) -> Trial:
        """Return the trial of a candidate; one that the worst load tells to be bad is not run under the others."""
        entries = rung.entries | grid
        key = _key(entries)
        if key not in self._trials:
            self._bench.spent += self._prices.seconds(rung, grid["angles"])
            reduction = self._reduction.model_copy(update=entries)
            loads = (self._worst_load,) if self._worst_load else None
            trial = self._bench.try_out(reduction, self._n_steps, loads)
            if not self._worst_load:
                # of what cannot be built nothing is known
                self._worst_load = trial.errors.loads[trial.errors.place[0]] if trial.built else ""
            elif trial.errors.largest <= REDUCTION * self.tolerance:
                trial = self._bench.go_on(trial)
            self._trials[key] = trial
        return self._trials[key]

    def _trial(self, rung: prices.Rung) -> Trial:
        return self._try(rung, self._grid)

    def _error(self, rung: prices.Rung) -> float:
        """Return what a rung leaves at the present angles, and note it; infinite where it cannot be afforded."""
        if not self._is_affordable(rung, self._grid):
            return np.inf
        trial = self._trial(rung)
        if rung not in self._looked_at:
            self._looked_at.append(rung)
            self._ledger.add_trial("basis", OF_BASIS, trial, trial.errors, rung.cost)
        return trial.errors.largest

    def _best_looked_at(self) -> prices.Rung:
        return min(self._looked_at, key=self._error)

    @property
    def _finer(self) -> dict[str, Any]:
        return self._grid | {"angles": 2 * self._grid["angles"]}

    @property
    def _is_finest(self) -> bool:
        """Whether twice the angles are more than are tried."""
        return self._finer["angles"] > self._angles[-1]

    def _angles_count(self, rung: prices.Rung) -> bool:
        """Return whether twice the angles may be tried, and change a good part of what a rung leaves."""
        free = not self._fixed_grid and not self._is_finest and self._prices.within(rung, self._bench.budget)
        if not (free and self._is_affordable(rung, self._finer)):
            return False
        changed = self._apart(rung, self._grid, self._finer).largest
        return changed > max(self.allowed["interpolation"], COUNTS * self._error(rung))

    def _refine(self) -> None:
        self._grid, self._looked_at = self._finer, []
        self._take_affordable()

    def _shift_to_basis(self, best: prices.Rung) -> bool:
        """Let the basis have most of what is kept for interpolation; return whether the best rung is then good enough.

        What the present angles leave is in a rung's error already, and the fewest angles are sought for what remains.
        """
        if self._fixed_grid:
            return False
        self.allowed["basis"] = BASIS_ALONE * self.tolerance
        self.allowed["interpolation"] = (REDUCTION - BASIS_ALONE) * self.tolerance
        return self._error(best) <= self.allowed["basis"]

    def _apart(self, rung: prices.Rung, grid: dict[str, Any], finer: dict[str, Any]) -> Errors:
        """Return how far a grid is from a finer one."""
        trial = self._try(rung, grid)
        errors = self._bench.apart(trial, self._try(rung, finer))
        self._ledger.add_trial("interpolation", (*OF_BASIS, *OF_GRID), trial, errors)
        return errors

    def _cheapest_basis(self) -> prices.Rung | None:
        """Return the cheapest rung of all families that is good enough; None if there is none at the present angles."""
        allowed = self.allowed["basis"]
        for family in self._promising():
            found = self._climb(family, family.index(self._middle(family)))
            if found is not None:
                break
        else:
            return None
        for family in self._families:
            cheaper = [rung for rung in family if rung.cost < found.cost]
            if found in family or not cheaper or self._last_resort(family):
                continue
            if self._error(cheaper[-1]) <= allowed:
                found = self._climb(cheaper, len(cheaper) - 1)
        return found

    def _promising(self) -> list[list[prices.Rung]]:
        """Return the families to climb, at angles of which twice as many do not better the best middle rung: the first
        one whose middle rung is good enough, else those that are not much worse than the best, the cheapest first."""
        while True:
            middles = []
            for family in self._families:
                middles.append(self._error(self._middle(family)))
                if middles[-1] <= self.allowed["basis"]:
                    return [family]
            best, least = self._best_looked_at(), min(middles)
            if not self._angles_count(best) or self._try(best, self._finer).errors.largest >= least:
                return [family for family, middle in zip(self._families, middles) if MUCH_BETTER * middle <= least]
            self._refine()

    def _middle(self, family: list[prices.Rung]) -> prices.Rung:
        """Return the rung of medium size, or one near it that can be built: the last mode of some meets the next one,
        whatever the angles."""
        near = prices.by_distance_from_middle(family)[:NEAREST]
        tried = (rung for rung in near if self._is_affordable(rung, self._grid))
        return next((rung for rung in tried if self._trial(rung).built), near[0])

    def _climb(self, family: list[prices.Rung], start: int) -> prices.Rung | None:
        allowed = self.allowed["basis"]

        def stalls(before: int, now: int) -> bool:
            return self._error(family[now]) > max(STALLED * self._error(family[before]), NEAR * allowed)

        found = prices.first_passing(len(family), lambda k: self._error(family[k]) <= allowed, start, stalls)
        return None if found is None else family[found]

    def _explain(self, found: prices.Rung) -> None:
        family = next(family for family in self._families if found in family)
        fewer = family[: family.index(found)]
        cheaper = [rung for rung in fewer if rung in self._looked_at and np.isfinite(self._error(rung))]
        reason = f"leave {self._error(found):.2g}, allowed {self.allowed['basis']:.2g}"
        if cheaper:
            reason += f"; {cheaper[-1].entries['modes']} leave {self._error(cheaper[-1]):.2g}"
        self._ledger.reasons["reduction.modes"] = reason
        self._ledger.reasons["reduction.static_modes"] = (
            "the static answer to a load does the work of many modes" if self._limits.n_static else "no load acts"
        )
        for key in OF_BASIS[1:]:
            others = [rung for rung in self._looked_at if rung.entries[key] != found.entries[key]]
            if others:
                best = min(others, key=self._error)
                left = self._error(best)
                modes = f"{best.entries['modes']} modes leave {left:.2g}" if np.isfinite(left) else "none could be run"
                self._ledger.reasons[f"reduction.{key}"] = f"with {json.dumps(best.entries[key])}, {modes}"

    def _last_resort(self, family: list[prices.Rung]) -> bool:
        """Return whether a family is tried only where others fail: dynamic stretching, where there is static."""
        entries = family[0].entries
        static = self._limits.slender and "stretching" not in self.given
        return static and entries["second_order"] and entries["stretching"] == "dynamic"

    def _refuse(self, best: prices.Rung) -> NoReturn:
        if not self._trial(best).built:
            raise RunError(self._trial(best).reason)
        while (trial := self._bench.go_on(self._trial(best))) is not self._trial(best):
            # it was looked at under one load only, and another may be better
            self._trials[_key(best.entries | self._grid)] = trial
            self._ledger.add_trial("basis", OF_BASIS, trial, trial.errors, best.cost)
            best = self._best_looked_at()
        if self._is_finest and not self._fixed_grid:
            most = self._grid["angles"]
            if self._apart(best, self._grid | {"angles": most // 2}, self._grid).largest > COUNTS * self._error(best):
                hints = [f"the tables change too fast over the range for {most} angles: take more reduction.angles"]
                refuse("reduction.tolerance", self.tolerance, "interpolation", self.allowed, self._ledger, hints)
        kept = {name: value for name, value in self.given.items() if name in OF_BASIS or self._fixed_grid}
        given = ", ".join(f"reduction.{name} = {json.dumps(value)}" for name, value in kept.items())
        last = [f"kept as given: {given}; leave them out to have them chosen"] if kept else []
        more_known = self._reduction.sampling_tolerance is None and not self._is_finest
        if more_known and self._is_affordable(best, self._finer) and self._fixed_grid:  # noted where it is not
            self._apart(best, self._grid, self._finer)  # noted: what twice the angles that are given would change
        rival = self._rival_of(trial)
        last += self._left_out
        if not (self._fixed_grid or self._is_finest or self._prices.within(best, self._bench.budget)):
            last.append(f"{self._finer['angles']} angles were not tried: {self._prices.dear(best, self._bench.budget)}")
        n_static = self._limits.n_static if trial.reduction.static_modes else 0
        if trial.reduction.modes >= self._limits.most_modes(n_static):
            last.append(self._limits.last_mode)
        refuse_basis(self._bench, trial, self.allowed, self._ledger, last, rival)

    def _rival_of(self, trial: Trial) -> Trial | None:
        """Return the largest basis that follows stretching in another way than one of second order does."""
        kind = trial.reduction
        others = [
            family[-1]
            for family in self._families
            if family[-1].entries["second_order"] and family[-1].entries["stretching"] != kind.stretching
        ]
        if not (kind.second_order and others):
            return None
        return self._trial(others[0]) if np.isfinite(self._error(others[0])) else None

    def _fewest_angles(self, rung: prices.Rung) -> Trial:
        """Return the trial with the fewest angles, of any scheme, that are not far from those of the search; what these
        leave themselves is part of the basis's error."""
        allowed, left, schemes = self.allowed["interpolation"], {}, self._schemes

        def passes(count: int, scheme: str) -> bool:
            if left.get((count, schemes[0]), 0.0) > FAR * allowed:
                return False  # schemes do not differ that much
            left[count, scheme] = self._apart(rung, {"angles": count, "interpolation": scheme}, self._grid).largest
            return left[count, scheme] <= allowed

        chosen, counts = self._grid, [n for n in self._angles if n < self._grid["angles"]]
        for scheme in schemes:
            found = prices.first_passing(len(counts), lambda k: passes(counts[k], scheme), len(counts) - 1)
            if found is not None:
                chosen = {"angles": counts[found], "interpolation": scheme}
                counts = counts[:found]
        for count, scheme in left:
            if scheme != chosen["interpolation"]:
                reason = f"{scheme} leaves {left[count, scheme]:.2g} with {count} angles"
                self._ledger.reasons["reduction.interpolation"] = reason
        self._ledger.reasons["reduction.angles"] = (
            f"leave {left.get(tuple(chosen.values()), 0.0):.2g}, allowed {allowed:.2g}, against "
            f"{self._grid['angles']}, with which the basis was judged"
        )
        return self._try(rung, chosen)


def _key(entries: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(entries[name] for name in KNOBS)


PAYS = 0.8  # of the processor time of a reference sample, from which on a reduced one is no cheaper to speak of
SPARE = 1.0 - REDUCTION  # of the tolerance, for what took no part in the training, and for what the reference is off
FINER = 4  # by how much the step is refined where the reduction has to be looked at again


@dataclass(frozen=True)
class Choice:
    """The settings that were chosen."""

    scene: Scene  # the scene with everything given and without tolerances
    rom: ReducedOrderModel | None  # the reduced model, on the first rank; None elsewhere
    selection: Selection  # for the file


def leaves_open(scene: Scene) -> bool:
    return scene.reduction.tolerance is not None or scene.simulation.tolerance is not None


def choose(
    scene: Scene, meshes: Shapes, group: RankGroup, say: Said = lambda text: None, finished: Finished | None = None
) -> Choice:
    """Choose what the tolerances of a scene leave open. Collective on ``group.world``; its groups share an
    eigenproblem.

    What errors are measured against, and what that is predicted to take, goes to `say` before it is run; runs of the
    reference that an earlier run of the program left are in `finished`, where others are kept. Raises `InputError` if a
    tolerance cannot be met, or there is no reference within the budget.
    """
    timings, ledger, training = Timings(), Ledger(), Training.of(scene)
    entry = "reduction.tolerance" if scene.reduction.tolerance is not None else "simulation.tolerance"
    if not scene.outputs:
        raise InputError(f"{entry}: errors are those of outputs, and the scene has none; name some in [outputs]")
    with timings.phase("components"):
        # as many as the scene gives, or as are tried
        given = scene.reduction.tolerance is None or "modes" in scene.reduction.model_fields_set
        n_modes = scene.reduction.modes if given else prices.MOST_CONDENSED
        subject = Subject.of(scene, meshes, group, n_modes)
    with timings.phase("selection"), progress(None, "choosing, tried so far", group.world) as bar:
        period = subject.first_period(group)
        reference = choose_reference(
            scene, meshes, subject.kinematics, _demand(scene, training, period, n_modes, entry), group.world
        )
        say(reference.why)
        coarse = min(step_choice.first_steps(scene, period)[1], _given_steps(scene) or step_choice.MOST_ANYWAY)
        reference = distance_from_mesh(reference, meshes, training.values, training.n_samples, coarse, group.world)
        bench = Bench(reference, training, group.world, subject, group, bar, finished)
        step = step_choice.StepChoice(bench, ledger, period, reference.model.name)
        step.begin()
        allowed, trial = _tried(bench, ledger, step, subject, say)
        if not trial.built:
            raise RunError(trial.reason)
        step.fit_reduced(trial)
        rom = bench.rom_of(trial)
        chosen = _chosen_scene(scene, step, trial, rom)
        n_full = step.search.chosen
        times = bench.processor_times(trial, step.n_steps, n_full)
        cost = cost_text(times[0], step.n_steps, times[1], n_full, bench.full_model.title)
        found = [*mesh_remark(bench, trial.n_steps), cost]
        if not step.kept:
            loads = " and ".join(f"'{name}'" for name in step.loads)
            sharper = "for loads with sharper corners, give simulation.tolerance with the run"
            found.insert(0, f"the step was found with {loads}: {sharper}")
    asked = {name: getattr(scene, name).tolerance for name in ("reduction", "simulation")}
    used = step.loads if scene.reduction.tolerance is None else [load.name for load in bench.training.loads]
    selection = Selection(
        tolerances={name: value for name, value in asked.items() if value is not None},
        allowed=allowed,
        chosen=_entries(scene, chosen, kept=False),
        reasons=ledger.reasons,
        kept=_entries(scene, chosen, kept=True),
        attempts=tuple(ledger.attempts),
        outputs=bench.outputs,
        values=own_values(scene, bench.training.values),
        loads={load.name: load.description for load in bench.training.loads if load.name in used},
        remarks=(reference.why, *bench.remarks, *found, *(() if finished is None else map(str, finished.remarks))),
        reference=reference.about,
    )
    if group.world.rank > 0:
        return Choice(chosen, None, selection)
    record = rom.record
    record = replace(record, scene_toml=scene_to_toml(chosen), timings=timings.as_dict() | record.timings)
    return Choice(chosen, replace(rom, record=record), selection)


def _tried(
    bench: Bench, ledger: Ledger, step: step_choice.StepChoice, subject: Subject, say: Said
) -> tuple[Mapping[str, float], Trial]:
    """Return the errors that are allowed, and the reduced model that is given or chosen, with the step it has."""
    scene = subject.scene
    if scene.reduction.tolerance is None:
        bench.check_references(step.n_basis, step.loads)
        step.finish({})
        return step.allowed, bench.try_out(scene.reduction, step.n_basis, step.loads)
    bench.check_references(step.n_basis)
    limits = prices.Limits.of(scene, subject.kinematics, subject.n_modes)
    reduction = ReductionChoice(bench, ledger, limits, step.n_basis, step.allowed)
    say(reduction.price)
    allowed, trial = reduction.allowed, reduction.run()
    step.finish(allowed)
    # also good enough with a step that was found later and is finer than the trial's
    tolerance = bench.scene.reduction.tolerance
    while trial.n_steps < step.n_steps:
        finest = step.search.finest
        again = replace(trial, n_steps=finest)
        errors = bench.errors(step.loads, again.setting, again.exact)
        ledger.add_trial("basis", KNOBS, again, errors)
        if errors.largest <= REDUCTION * tolerance:
            break
        n_steps = min(FINER * trial.n_steps, finest)
        if n_steps == trial.n_steps:
            parts = {"basis": REDUCTION * tolerance} | step.allowed
            refuse("reduction.tolerance", tolerance, "basis", parts, ledger, [])
        trial = ReductionChoice(bench, ledger, limits, n_steps, step.allowed).run()
    return allowed, trial


def _given_steps(scene: Scene) -> int:
    """Return the number of steps of a scene that gives its step; 0 where it is to be chosen."""
    simulation = scene.simulation
    return 0 if simulation.is_chosen else simulation.n_steps


def _demand(scene: Scene, training: Training, period: float, n_modes: int, entry: str) -> Demand:
    """Return what the reference has to run, at least: for the step, and under all loads for the reduction."""
    of_step = sum(load.for_step for load in training.loads)
    n_loads, given = (len(training.loads) if scene.reduction.tolerance is not None else of_step), _given_steps(scene)
    if given:
        steps = n_loads * given + (step_choice.AHEAD * of_step * given if scene.simulation.tolerance is not None else 0)
    else:
        # runs with halved steps, up to the smallest that are tried before the reduction, are together two of these
        early = step_choice.EARLY_PER_PERIOD // step_choice.FIRST_PER_PERIOD
        steps = (n_loads * step_choice.SEEN + 2 * of_step * early) * step_choice.first_steps(scene, period)[1]
    cases = f"{training.n_samples} samples under {n_loads} loads"
    cure = "shorten simulation.duration, or let fewer parameters vary"
    tolerance = scene.reduction.tolerance or scene.simulation.tolerance
    n_modes = ceil(MORE_MODES * n_modes)
    return Demand(f"{entry} = {tolerance:g}", float(steps * training.n_samples), cases, cure, n_modes)


def _chosen_scene(scene: Scene, step: step_choice.StepChoice, trial: Trial, rom: ReducedOrderModel) -> Scene:
    """Return the scene with the chosen entries; its tables are validated anew.

    Where a build took more angles than a candidate had, these are what was chosen: the model was judged with them.
    """
    time = {"tolerance": None} | ({} if step.kept else {"step": step.step})
    kept = {"tolerance": None}
    if scene.reduction.sampling_tolerance is None and rom.tables.n_coordinates == 1:
        kept["angles"] = len(rom.frequencies_hz)
    return scene.with_entries(
        reduction=Reduction(**trial.reduction.model_dump() | kept),
        simulation=Simulation(**scene.simulation.model_dump() | time),
    )


def _entries(scene: Scene, chosen: Scene, kept: bool) -> dict[str, object]:
    """Return the entries that the scene gave (`kept`), or that were chosen, by dotted name."""
    entries = {}
    for table, knobs in (("reduction", KNOBS), ("simulation", ("step",))):
        before = getattr(scene, table)
        if before.tolerance is not None:
            for knob in knobs:
                if (knob in before.model_fields_set) == kept:
                    entries[f"{table}.{knob}"] = getattr(getattr(chosen, table), knob)
    return entries


def mesh_remark(bench: Bench, n_steps: int) -> list[str]:
    """Say what the meshes themselves leave, no part of the tolerance, or how far the reference is from them."""
    errors, apart = bench.finer_meshes(n_steps), bench.reference.from_mesh
    given = (bench.scene.reduction.tolerance, bench.scene.simulation.tolerance)
    tolerance = min(value for value in given if value is not None)
    worst = max(apart, key=apart.__getitem__, default="")
    if apart and apart[worst] > SPARE * tolerance:
        return [
            f"the tolerance holds against the reference, which is itself {apart[worst]:.2g} away from the mesh in "
            f"{worst}, more than {SPARE:g} of the tolerance: against the mesh it may not hold "
            '(reference.model = "mesh")'
        ]
    if errors is None:
        return ["what finer meshes would change is no part of the tolerance, and was not measured"]
    if not np.isfinite(errors.values).any():
        return []
    moved = ", ".join(f"{name} by {error:.2g}" for name, error in zip(bench.outputs, errors.by_output))
    more = "; the meshes leave more than the tolerance" if errors.largest > tolerance else ""
    return [f"no part of the tolerance: cells cut in two would move {moved}{more}"]


def cost_text(reduced: float, n_reduced: int, full: float, n_full: int, title: str) -> str:
    """Say what a sample of both models costs (s) with so many steps, and where reducing does not pay."""
    said = (
        f"processor time of a sample: {1e3 * reduced:.2g} ms with {n_reduced} steps; of the {title} model "
        f"{1e3 * full:.2g} ms with {n_full} steps"
    )
    if reduced < PAYS * full:
        return said
    return (
        f"{said}: the reduction does not pay here, for that model is small; run samples with it (--full), or take a "
        "larger reduction.tolerance or fewer outputs"
    )


def choose_over_lengths(
    scene: Scene, meshes: Shapes, group: RankGroup, say: Said, finished: Finished | None = None
) -> Choice:
    """Choose what the tolerances of a scene leave open, with any lengths; see `choose`. Collective on ``group.world``.
    Raises `InputError` or `RunError`, as `choose`; with the lengths at which what was chosen does not keep the
    tolerance."""
    names = length_names(scene)
    if not names:
        return choose(scene, meshes, group, say, finished)
    nominal = {name: scene.nominal[name] for name in names}
    at = values_text(scene, nominal)
    say(f"tolerances: what they leave open is chosen at {at}, and checked at the ends of the range")
    found = _chosen_at(scene, nominal, meshes, group, say=say, finished=finished)
    chosen = scene.with_entries(reduction=found.scene.reduction, simulation=found.scene.simulation)
    # with its tolerances, and with everything given that was chosen
    update: dict[str, Reduction | Simulation] = {"simulation": chosen.simulation}
    of_reduction, of_step = ({"tolerance": table.tolerance} for table in (scene.reduction, scene.simulation))
    if scene.reduction.tolerance is not None:
        update["reduction"] = Reduction(**chosen.reduction.model_dump(exclude_none=True) | of_reduction)
    if scene.simulation.tolerance is not None:
        update["simulation"] = Simulation(**chosen.simulation.model_dump() | of_step)
    asked, remarks = scene.with_entries(**update), []
    for lengths in extremes(scene):
        check = _chosen_at(asked, lengths, meshes, group)
        parts = {attempt.part: attempt.largest for attempt in check.selection.attempts}
        left = ", ".join(f"{part} leaves {size:.2g}" for part, size in parts.items()) or "nothing was left to look at"
        remarks.append(f"at {values_text(scene, lengths)}: {left}")
    selection = replace(found.selection, remarks=(*found.selection.remarks, *remarks))
    return Choice(chosen, build_rom(chosen, meshes, group), selection)


def _chosen_at(scene: Scene, lengths: Mapping[str, float], meshes: Shapes, group: RankGroup, **how: Any) -> Choice:
    """Choose with some lengths, m; `how` is as of `choose`."""
    shapes = at_lengths(scene.with_values(lengths), meshes)
    try:
        return choose(with_numbers(scene, lengths), shapes, group, **how)
    except (InputError, RunError) as error:
        raise type(error)(f"at {values_text(scene, lengths)}: {error}") from error
