"""The reduction for a tolerance: the cheapest basis at few angles, at more of them where few do not suffice, and the
fewest angles for it."""

from __future__ import annotations

import json
from enum import Enum, auto
from typing import Any, NoReturn

import numpy as np

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.bench import candidates
from pgmp_petsc.bench.bench import Bench
from pgmp_petsc.bench.history import BASIS_ALONE, REDUCTION, Errors, Ledger, Trial, shares_of
from pgmp_petsc.bench.refusal import kept_text, refuse, refuse_basis

OF_BASIS = ("modes", "static_modes", "inertia_modes", "parameter_modes", "second_order", "stretching")
OF_GRID = ("angles", "interpolation")
KNOBS = OF_BASIS + OF_GRID
COUNTS = 0.25  # of an error: where twice the angles change no more, it is the basis's own
MUCH_BETTER = 0.7  # a family that leaves less than this share of another's error is climbed in its place
NEAREST = 4  # rungs to the middle that are tried where it cannot be built
FAR = 3.0  # times the allowed error: where one scheme leaves more, another is not tried
STALLED, NEAR = 0.6, 1.5  # more modes are no use where they leave more than this of the error, and of what is allowed


class MoreAngles(Enum):
    """Whether a rung may be tried at twice the angles, or what forbids it."""

    FREE = auto()
    GIVEN = auto()
    LAST = auto()
    DEAR = auto()


class ReductionChoice:
    """Choice of what a scene leaves open of its reduction. Collective on the bench's ranks.

    The ledger takes what was tried; all runs have `n_steps`, and `others` are what the other parts of the error may be.
    """

    def __init__(
        self, bench: Bench, ledger: Ledger, limits: candidates.Limits, n_steps: int, others: dict[str, float]
    ) -> None:
        self._bench, self._ledger, self._n_steps = bench, ledger, n_steps
        reduction = bench.scene.reduction
        self._reduction, self.tolerance = reduction, reduction.tolerance
        self.given = {key: getattr(reduction, key) for key in KNOBS if key in reduction.model_fields_set}
        # with given angles, or those that a build adds by itself, what they leave is part of the basis's error
        self._fixed_grid = "angles" in self.given or reduction.sampling_tolerance is not None
        self._limits = limits
        self._angles = candidates.ANGLES[limits.n_coordinates]
        given = self.given.get("interpolation")
        self._schemes = candidates.SCHEMES[limits.n_coordinates] if given is None else (given,)
        first = reduction.angles if self._fixed_grid else candidates.FIRST_ANGLES[limits.n_coordinates]
        self._grid: dict[str, Any] = {"angles": first, "interpolation": self._schemes[0]}
        self._all_families = candidates.families_of(self.given, limits)
        self._take_affordable()
        self._trials: dict[tuple[Any, ...], Trial] = {}
        self._looked_at: list[candidates.Rung] = []  # with the present angles
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
        """Predicted time of the candidates, in words."""
        return self._prices.text(self._families)

    def _take_affordable(self) -> None:
        """Leave out candidates that cost too much at twice the present angles, which show whether these suffice."""
        n_runs = self._n_steps * self._bench.training.n_cases
        most = self._grid["angles"] * (1 if self._fixed_grid else 2)
        self._prices = candidates.CandidatePrices.of(self._bench.mechanism, self._limits, n_runs, most)
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
        """Candidates that were not tried because of their price, in words."""
        return [text for text in (self._too_dear, self._cut_short) if text]

    def _is_affordable(self, rung: candidates.Rung, grid: dict[str, Any]) -> bool:
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

    def _try(self, rung: candidates.Rung, grid: dict[str, Any]) -> Trial:
        """Return the trial of a candidate; one that the worst load tells to be bad is not run under the others."""
        entries = rung.entries | grid
        key = _key(entries)
        if key not in self._trials:
            self._bench.spent += self._prices.seconds(rung, grid["angles"])
            reduction = self._reduction.model_copy(update=entries)
            loads = (self._worst_load,) if self._worst_load else None
            trial = self._bench.try_out(reduction, self._n_steps, loads)
            if trial.reason.startswith("reduction.parameter_modes") and "parameter_modes" not in self.given:
                # beside many modes there may be no independent ones from other parameter values: they have them all
                reduction = reduction.model_copy(update={"parameter_modes": 0})
                trial = self._bench.try_out(reduction, self._n_steps, loads)
            if not self._worst_load:
                # of what cannot be built nothing is known
                self._worst_load = trial.errors.loads[trial.errors.place[0]] if trial.built else ""
            elif trial.errors.largest <= REDUCTION * self.tolerance:
                trial = self._bench.go_on(trial)
            self._trials[key] = trial
        return self._trials[key]

    def _trial(self, rung: candidates.Rung) -> Trial:
        return self._try(rung, self._grid)

    def _error(self, rung: candidates.Rung) -> float:
        """Return what a rung leaves at the present angles, and note it; infinite where it cannot be afforded."""
        if not self._is_affordable(rung, self._grid):
            return np.inf
        trial = self._trial(rung)
        if rung not in self._looked_at:
            self._looked_at.append(rung)
            self._ledger.add_trial("basis", OF_BASIS, trial, trial.errors, rung.cost)
        return trial.errors.largest

    def _best_looked_at(self) -> candidates.Rung:
        return min(self._looked_at, key=self._error)

    @property
    def _finer(self) -> dict[str, Any]:
        return self._grid | {"angles": 2 * self._grid["angles"]}

    def _more_angles(self, rung: candidates.Rung) -> MoreAngles:
        """Return whether a rung may be tried at twice the angles."""
        if self._fixed_grid:
            return MoreAngles.GIVEN
        if self._finer["angles"] > self._angles[-1]:
            return MoreAngles.LAST
        alone = self._prices.within(rung, self._bench.budget)
        return MoreAngles.FREE if alone and self._is_affordable(rung, self._finer) else MoreAngles.DEAR

    def _angles_count(self, rung: candidates.Rung) -> bool:
        """Return whether twice the angles may be tried, and change a good part of what a rung leaves."""
        if self._more_angles(rung) is not MoreAngles.FREE:
            return False
        changed = self._apart(rung, self._grid, self._finer).largest
        return changed > max(self.allowed["interpolation"], COUNTS * self._error(rung))

    def _refine(self) -> None:
        """Double the angles and begin anew."""
        self._grid, self._looked_at = self._finer, []
        self._take_affordable()

    def _shift_to_basis(self, best: candidates.Rung) -> bool:
        """Let the basis have most of what is kept for interpolation; return whether the best rung is then good enough.

        What the present angles leave is in a rung's error already, and the fewest angles are sought for what remains.
        """
        if self._fixed_grid:
            return False
        self.allowed["basis"] = BASIS_ALONE * self.tolerance
        self.allowed["interpolation"] = (REDUCTION - BASIS_ALONE) * self.tolerance
        return self._error(best) <= self.allowed["basis"]

    def _apart(self, rung: candidates.Rung, grid: dict[str, Any], finer: dict[str, Any]) -> Errors:
        """Return how far a grid is from a finer one."""
        trial = self._try(rung, grid)
        errors = self._bench.apart(trial, self._try(rung, finer))
        self._ledger.add_trial("interpolation", (*OF_BASIS, *OF_GRID), trial, errors)
        return errors

    def _cheapest_basis(self) -> candidates.Rung | None:
        """Return the cheapest rung of all families that is good enough; None if there is none at the present angles.

        The middle rungs tell where it is to be sought: in the first family whose one is good enough; else in those
        that are not much worse than the best, the cheapest first. What more modes cannot do in one family they can
        still do in a richer one.
        """
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

    def _promising(self) -> list[list[candidates.Rung]]:
        """Return the families to climb, at angles of which twice as many do not better the best middle rung."""
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

    def _middle(self, family: list[candidates.Rung]) -> candidates.Rung:
        """Return the rung of medium size, or one near it that can be built: the last mode of some meets the next one,
        whatever the angles."""
        near = candidates.by_distance_from_middle(family)[:NEAREST]
        tried = (rung for rung in near if self._is_affordable(rung, self._grid))
        return next((rung for rung in tried if self._trial(rung).built), near[0])

    def _climb(self, family: list[candidates.Rung], start: int) -> candidates.Rung | None:
        """Return the rung of a family with the fewest modes that is good enough."""
        allowed = self.allowed["basis"]

        def stalls(before: int, now: int) -> bool:
            return self._error(family[now]) > max(STALLED * self._error(family[before]), NEAR * allowed)

        found = candidates.first_passing(len(family), lambda k: self._error(family[k]) <= allowed, start, stalls)
        return None if found is None else family[found]

    def _explain(self, found: candidates.Rung) -> None:
        """Say why it is this basis."""
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

    def _last_resort(self, family: list[candidates.Rung]) -> bool:
        """Return whether a family is tried only where others fail: dynamic stretching, where there is static."""
        entries = family[0].entries
        static = self._limits.slender and "stretching" not in self.given
        return static and entries["second_order"] and entries["stretching"] == "dynamic"

    def _refuse(self, best: candidates.Rung) -> NoReturn:
        """Raise an error that says why the best rung that was tried is not good enough."""
        if not self._trial(best).built:
            raise RunError(self._trial(best).reason)
        while (trial := self._bench.go_on(self._trial(best))) is not self._trial(best):
            # it was looked at under one load only, and another may be better
            self._trials[_key(best.entries | self._grid)] = trial
            self._ledger.add_trial("basis", OF_BASIS, trial, trial.errors, best.cost)
            best = self._best_looked_at()
        more = self._more_angles(best)
        if more is MoreAngles.LAST:
            most = self._grid["angles"]
            if self._apart(best, self._grid | {"angles": most // 2}, self._grid).largest > COUNTS * self._error(best):
                hints = [f"the tables change too fast over the range for {most} angles: take more reduction.angles"]
                refuse("reduction.tolerance", self.tolerance, "interpolation", self.allowed, self._ledger, hints)
        kept = {name: value for name, value in self.given.items() if name in OF_BASIS or self._fixed_grid}
        last = [kept_text(kept)] if kept else []
        more_known = self._reduction.sampling_tolerance is None and self._finer["angles"] <= self._angles[-1]
        if more is MoreAngles.GIVEN and more_known and self._is_affordable(best, self._finer):
            self._apart(best, self._grid, self._finer)  # noted: what twice the angles that are given would change
        rival = self._rival_of(trial)
        last += self._left_out
        if more is MoreAngles.DEAR and not self._prices.within(best, self._bench.budget):
            last.append(f"{self._finer['angles']} angles were not tried: {self._prices.dear(best, self._bench.budget)}")
        n_static = self._limits.n_static if trial.reduction.static_modes else 0
        if trial.reduction.modes >= self._limits.most_modes(n_static):
            last.append(self._limits.last_mode)
        refuse_basis(self._bench, trial, self.tolerance, self.allowed, self._ledger, last, rival)

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

    def _fewest_angles(self, rung: candidates.Rung) -> Trial:
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
            found = (
                candidates.first_passing(len(counts), lambda k: passes(counts[k], scheme), len(counts) - 1)
                if counts
                else None
            )
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
