"""The reduction for a tolerance: angles that are enough, the cheapest basis, the fewest angles for it."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, NoReturn

import numpy as np

from pgmp_petsc.runtime.errors import InputError, RunError
from pgmp_petsc.selection.bench import Bench
from pgmp_petsc.selection.candidates import CandidatePrices
from pgmp_petsc.selection.ladder import (
    ANGLES,
    FIRST_ANGLES,
    SCHEMES,
    Limits,
    Rung,
    families_of,
    first_passing,
    middle_of,
)
from pgmp_petsc.selection.ledger import REDUCTION, Ledger, shares_of
from pgmp_petsc.selection.refusal import kept_text, refuse, refuse_basis
from pgmp_petsc.selection.trial import Errors, Trial

OF_BASIS = ("modes", "static_modes", "inertia_modes", "parameter_modes", "second_order", "stretching")
OF_GRID = ("angles", "interpolation")
KNOBS = OF_BASIS + OF_GRID
MUCH_BETTER = 0.7  # a family that leaves less than this share of another's error is climbed in its place
FAR = 3.0  # times the allowed error: where one scheme leaves more, another is not tried
STALLED, NEAR = 0.6, 1.5  # more modes are no use where they leave more than this of the error, and of what is allowed


class ReductionChoice:
    """Choice of what a scene leaves open of its reduction. Collective on the bench's ranks.

    Parameters
    ----------
    bench
        Where candidates are tried.
    ledger
        Takes what was tried.
    limits
        What the scene allows.
    n_steps
        Steps of all runs.
    others
        What the other parts of the error may be, for messages.
    """

    def __init__(self, bench: Bench, ledger: Ledger, limits: Limits, n_steps: int, others: dict[str, float]) -> None:
        self._bench, self._ledger, self._n_steps = bench, ledger, n_steps
        reduction = bench.scene.reduction
        self._reduction, self.tolerance = reduction, reduction.tolerance
        self.given = {key: getattr(reduction, key) for key in KNOBS if key in reduction.model_fields_set}
        # with given angles, or those that a build adds by itself, what they leave is part of the basis's error
        self._fixed_grid = "angles" in self.given or reduction.sampling_tolerance is not None
        self._limits = limits
        self._angles, self._first_angles = ANGLES[limits.n_coordinates], FIRST_ANGLES[limits.n_coordinates]
        # what twice the angles change tells whether they are enough
        most = reduction.angles if self._fixed_grid else 2 * self._first_angles
        self._prices = CandidatePrices.of(bench.mechanism, limits, n_steps * bench.training.n_cases, most)
        self._families, self._too_dear = self._prices.affordable(families_of(self.given, limits), bench.budget)
        if self._too_dear and self._too_dear not in bench.remarks:
            bench.remarks.append(self._too_dear)
        given = self.given.get("interpolation")
        self._schemes = SCHEMES[limits.n_coordinates] if given is None else (given,)
        self._trials: dict[tuple[Any, ...], Trial] = {}
        self._worst_load = ""
        self._left = 0.0  # by the interpolation with the angles that were enough
        shares = shares_of(self._fixed_grid)
        self.allowed = {part: share * self.tolerance for part, share in shares.items()} | others
        if not self._families[0]:
            raise InputError(
                f"reduction.static_modes = true: the mesh has only {limits.n_modes} flexible modes, the scene "
                f"{limits.n_static} loads; take a finer mesh"
            )

    @property
    def price(self) -> str:
        """What candidates are predicted to take, in words."""
        return self._prices.text(self._families)

    def run(self) -> Trial:
        """Choose; the trial that is returned is the reduced model itself.

        Raises
        ------
        InputError
            If the tolerance cannot be met.
        """
        grid = {"angles": self._reduction.angles, "interpolation": self._schemes[0]}
        if not self._fixed_grid:
            grid = self._enough_angles()
        rung = self._cheapest_basis(grid)
        trial = self._try(rung.entries | grid)
        return trial if self._fixed_grid else self._fewest_angles(rung, grid)

    def _try(self, entries: dict[str, Any]) -> Trial:
        """Return the trial of a candidate; one that the worst load tells to be bad is not run under the others."""
        key = tuple(entries[name] for name in KNOBS)
        if key not in self._trials:
            reduction = self._reduction.model_copy(update=entries)
            loads = (self._worst_load,) if self._worst_load else None
            trial = self._bench.try_out(reduction, self._n_steps, loads)
            if not trial.built and reduction.parameter_modes and "parameter_modes" not in self.given:
                # beside many modes there may be no independent ones from other parameter values: they have them all
                reduction = reduction.model_copy(update={"parameter_modes": 0})
                trial = self._bench.try_out(reduction, self._n_steps, loads)
            if not self._worst_load:
                self._worst_load = trial.errors.loads[trial.errors.place[0]]
            elif trial.errors.largest <= REDUCTION * self.tolerance:
                trial = self._bench.go_on(trial)
            self._trials[key] = trial
        return self._trials[key]

    def _enough_angles(self) -> dict[str, Any]:
        """Return angles and scheme with which interpolation does not count for a basis of medium size."""
        grid = {"angles": self._first_angles, "interpolation": self._schemes[0]}
        while not self._settles(middle_of(self._families[0]), grid) and 4 * grid["angles"] <= self._angles[-1]:
            grid = grid | {"angles": 2 * grid["angles"]}
        return grid

    def _settles(self, rung: Rung, grid: dict[str, Any]) -> bool:
        """Return whether twice the angles would change little, and remember how much."""
        errors = self._apart(rung, grid, grid | {"angles": 2 * grid["angles"]})
        self._left = errors.largest
        return errors.largest <= self.allowed["interpolation"]

    def _apart(self, rung: Rung, grid: dict[str, Any], finer: dict[str, Any]) -> Errors:
        """Return how far a grid is from a finer one."""
        trial = self._try(rung.entries | grid)
        errors = self._bench.apart(trial, self._try(rung.entries | finer))
        self._ledger.add_trial("interpolation", (*OF_BASIS, *OF_GRID), trial, errors)
        return errors

    def _cheapest_basis(self, grid: dict[str, Any]) -> Rung:
        """Return the cheapest rung of all families that is good enough."""
        tried: dict[int, float] = {}

        def error(rung: Rung) -> float:
            if id(rung) not in tried:
                trial = self._try(rung.entries | grid)
                self._ledger.add_trial("basis", OF_BASIS, trial, trial.errors, rung.cost)
                tried[id(rung)] = trial.errors.largest
            return tried[id(rung)]

        def climb(family: list[Rung], start: int) -> Rung | None:
            def stalls(before: int, now: int) -> bool:
                return error(family[now]) > max(STALLED * error(family[before]), NEAR * self.allowed["basis"])

            found = first_passing(len(family), lambda k: error(family[k]) <= self.allowed["basis"], start, stalls)
            return None if found is None else family[found]

        found = self._search(error, climb)
        if found is None:
            self._refuse(grid, [rung for family in self._families for rung in family if id(rung) in tried])
        family = next(family for family in self._families if found in family)
        fewer = family[: family.index(found)]
        cheaper = [rung for rung in fewer if id(rung) in tried and np.isfinite(error(rung))]
        reason = f"leave {error(found):.2g}, allowed {self.allowed['basis']:.2g}"
        if cheaper:
            reason += f"; {cheaper[-1].entries['modes']} leave {error(cheaper[-1]):.2g}"
        self._ledger.reasons["reduction.modes"] = reason
        self._ledger.reasons["reduction.static_modes"] = (
            "the static answer to a load does the work of many modes" if self._limits.n_static else "no load acts"
        )
        for key in OF_BASIS[1:]:
            others = [
                rung
                for family in self._families
                for rung in family
                if id(rung) in tried and rung.entries[key] != found.entries[key]
            ]
            if others:
                best = min(others, key=error)
                other = json.dumps(best.entries[key])
                self._ledger.reasons[f"reduction.{key}"] = (
                    f"with {other}, {best.entries['modes']} modes leave {error(best):.2g}"
                )
        return found

    def _search(self, error: Callable[[Rung], float], climb: Callable[[list[Rung], int], Rung | None]) -> Rung | None:
        """Return the cheapest rung that is good enough.

        The middle rungs tell where it is to be sought: in the first family whose one is good enough; else in those
        that are not much worse than the best, the cheapest first. What more modes cannot do in one family they can
        still do in a richer one.
        """
        allowed, middles = self.allowed["basis"], []
        for family in self._families:
            middles.append(error(middle_of(family)))
            if middles[-1] <= allowed:
                break
        order = [k for k, middle in enumerate(middles) if MUCH_BETTER * middle <= min(middles)]
        if middles[-1] <= allowed:
            order = [len(middles) - 1]
        for k in order:
            family = self._families[k]
            found = climb(family, family.index(middle_of(family)))
            if found is not None:
                break
        else:
            return None
        for family in self._families:
            cheaper = [rung for rung in family if rung.cost < found.cost]
            if found in family or not cheaper or self._last_resort(family):
                continue
            if error(cheaper[-1]) <= allowed:
                found = climb(cheaper, len(cheaper) - 1)
        return found

    def _last_resort(self, family: list[Rung]) -> bool:
        """Return whether a family is tried only where others fail: dynamic stretching, where there is static."""
        entries = family[0].entries
        static = self._limits.slender and "stretching" not in self.given
        return static and entries["second_order"] and entries["stretching"] == "dynamic"

    def _refuse(self, grid: dict[str, Any], rungs: list[Rung]) -> NoReturn:
        """Say what stands in the way of the best of some rungs, none of which is good enough."""
        trials = [self._try(rung.entries | grid) for rung in rungs]
        if not any(trial.built for trial in trials):
            raise RunError(trials[0].reason)
        while True:
            # some were looked at under one load only
            best = min(range(len(rungs)), key=lambda k: trials[k].errors.largest)
            complete = self._bench.go_on(trials[best])
            if complete is trials[best]:
                break
            trials[best] = complete
            self._ledger.add_trial("basis", OF_BASIS, complete, complete.errors, rungs[best].cost)
        if self._fixed_grid and self._reduction.sampling_tolerance is None and 2 * grid["angles"] <= self._angles[-1]:
            self._apart(rungs[best], grid, grid | {"angles": 2 * grid["angles"]})
        kept = {name: value for name, value in self.given.items() if name in OF_BASIS or self._fixed_grid}
        last = [text for text in (kept_text(kept) if kept else "", self._too_dear) if text]
        n_static = self._limits.n_static if complete.reduction.static_modes else 0
        if complete.reduction.modes >= self._limits.most_modes(n_static):
            last.append(self._limits.last_mode)
        rival = self._rival_of(complete, grid)
        refuse_basis(self._bench, complete, self.tolerance, self.allowed, self._ledger, last, rival)

    def _rival_of(self, trial: Trial, grid: dict[str, Any]) -> Trial | None:
        """Return the largest basis that follows stretching in another way than one of second order does."""
        kind = trial.reduction
        others = [
            family[-1]
            for family in self._families
            if family[-1].entries["second_order"] and family[-1].entries["stretching"] != kind.stretching
        ]
        if not (kind.second_order and others):
            return None
        rival = self._try(others[0].entries | grid)
        self._ledger.add_trial("basis", OF_BASIS, rival, rival.errors, others[0].cost)
        return rival if np.isfinite(rival.errors.largest) else None

    def _fewest_angles(self, rung: Rung, grid: dict[str, Any]) -> Trial:
        """Return the trial with the fewest angles, of any scheme, with which interpolation does not count."""
        first = self._families[0]
        small = rung in first and rung.n_flexible <= middle_of(first).n_flexible
        settled = small and self._left <= self.allowed["interpolation"]
        while not settled and not self._settles(rung, grid):
            if 4 * grid["angles"] > self._angles[-1]:
                hints = [f"the tables change too fast over the range for {grid['angles']} angles"]
                refuse("reduction.tolerance", self.tolerance, "interpolation", self.allowed, self._ledger, hints)
            grid = grid | {"angles": 2 * grid["angles"]}
        # what the finest grid leaves is no candidate's to leave again
        allowed, left, schemes = self.allowed["interpolation"] - self._left, {}, self._schemes

        def passes(count: int, scheme: str) -> bool:
            if left.get((count, schemes[0]), 0.0) > FAR * allowed:
                return False  # schemes do not differ that much
            left[count, scheme] = self._apart(rung, {"angles": count, "interpolation": scheme}, grid).largest
            return left[count, scheme] <= allowed

        chosen, counts = grid, [n for n in self._angles if n < grid["angles"]]
        for scheme in schemes:
            found = first_passing(len(counts), lambda k: passes(counts[k], scheme), len(counts) - 1) if counts else None
            if found is not None:
                chosen = {"angles": counts[found], "interpolation": scheme}
                counts = counts[:found]
        for count, scheme in left:
            if scheme != chosen["interpolation"]:
                reason = f"{scheme} leaves {left[count, scheme]:.2g} with {count} angles"
                self._ledger.reasons["reduction.interpolation"] = reason
        error = left.get(tuple(chosen.values()), 0.0) + self._left
        self._ledger.reasons["reduction.angles"] = f"leave {error:.2g}, allowed {self.allowed['interpolation']:.2g}"
        return self._try(rung.entries | chosen)
