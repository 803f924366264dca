"""Shares of a tolerance, what was tried to meet it, and refusals where it cannot be met: which part of the error is too
large, with the figures."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NoReturn

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bench.bench import Bench
from pgmp_petsc.bench.cases import stops_of
from pgmp_petsc.bench.history import Errors, Trial
from pgmp_petsc.effects.time_function import amplitude_of
from pgmp_petsc.results.selection import Attempt

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
    looks, (_, output, _) = _Looks.at(bench, trial), errors.place
    what, n_steps = errors.outputs[output], trial.n_steps
    part, causes = _causes(bench, trial, rival, looks)
    if not causes and looks.unresolved > tolerance:
        causes.append(
            f"{n_steps} steps themselves leave more than the tolerance: take a smaller simulation.step, or let "
            "simulation.tolerance choose it"
        )
    hints = [
        f"of the basis's error, half the load leaves {looks.half:.2g}, half the step {looks.finer:.2g}; at nominal "
        f"parameters it is {looks.nominal:.2g}; halving the step moves the full-order {what} itself by "
        f"{looks.unresolved:.2g}"
    ]
    if causes:
        hints.append("; ".join(causes))
    hints += _of_own_loads(bench, trial, rival, allowed["basis"])
    mesh = bench.finer_meshes(n_steps)
    if mesh is not None and mesh.by_output[output] > tolerance:
        hints.append(
            f"the mesh itself leaves more than the tolerance: cells cut in two would move {what} by "
            f"{mesh.by_output[output]:.2g}"
        )
    refuse(entry, tolerance, part, allowed, ledger, [*hints, possible, *last])


@dataclass(frozen=True)
class _Looks:
    """What runs beside that with the largest error of a basis tell of its cause."""

    half: float  # half, finer: the error with half the load, and with half the step
    finer: float
    nominal: float  # the largest error at nominal parameters
    unresolved: float  # by what half the step moves the full-order output

    @classmethod
    def at(cls, bench: Bench, trial: Trial) -> _Looks:
        """Look around the largest error."""
        errors, n_steps = trial.errors, trial.n_steps
        load, output, sample = errors.place
        name, again = (errors.loads[load],), replace(trial, n_steps=2 * n_steps)
        half = bench.errors(name, trial.setting, trial.exact, factor=0.5)
        finer = bench.errors(name, again.setting, again.exact)
        moved = bench.moved(n_steps, 2 * n_steps, name)
        at, nominal = (0, output, sample), np.nanmax(errors.values[:, :, 0])
        return cls(half.values[at], finer.values[at], nominal, moved.values[at])


def _causes(bench: Bench, trial: Trial, rival: Trial | None, looks: _Looks) -> tuple[str, list[str]]:
    """Return which part of the error stands in the way of a basis, and why."""
    largest, causes = trial.errors.largest, []
    if looks.finer <= FELL * largest:
        return "step", [
            f"with {trial.n_steps} steps, errors of time integration are not the same in the two models: take a "
            "smaller simulation.step, or let simulation.tolerance choose it"
        ]
    impacts = _of_stops(bench, trial)
    causes += impacts
    # half the load may not reach a stop, and then tells nothing of the deformation
    if looks.half <= FELL * largest and not impacts:
        causes.append("the deformation is too large for the terms of first and second order that a reduced model has")
    other = [] if rival is None or impacts else _of_rival(bench, rival, looks.half)
    causes += other
    # where a larger basis fails by the deformation, it is not the modes that miss these values
    if looks.nominal <= FELL * largest and not other:
        causes.append("the modes are those of nominal parameters, and these values are too far from them")
    if looks.unresolved > UNRESOLVED * largest:
        causes.append("the loads set off vibrations that the step does not resolve and a small basis does not have")
        causes += _cure_of_sudden_loads(bench, trial, looks.unresolved)
    return "basis", causes


def _of_rival(bench: Bench, rival: Trial, half: float) -> list[str]:
    """Return what the basis that follows stretching in the other way tells of the cause, if half the load leaves so
    much of the best basis's error."""
    load, output, sample = rival.errors.place
    weak = bench.errors((rival.errors.loads[load],), rival.setting, rival.exact, factor=0.5).values[0, output, sample]
    kind, causes = rival.reduction.stretching, []
    if weak <= FELL * rival.errors.largest:
        causes.append(
            f'with stretching = "{kind}", {rival.reduction.modes} modes leave {rival.errors.largest:.2g}, but '
            f"{weak:.2g} under half the load: the deformation is too large for terms of second order; take smaller "
            "loads, stiffer bodies, or parameters that vary less"
        )
    if kind == "dynamic" and weak <= FELL * half:
        causes.append(
            'stretching = "static" leaves out the vibrations that stretch bodies, under any load: where loads are '
            "smaller, dynamic stretching keeps smaller tolerances"
        )
    return causes


def _of_stops(bench: Bench, trial: Trial) -> list[str]:
    """Return what softer end stops tell of the cause: impacts shake bodies faster than bases follow."""
    stops = stops_of(bench.scene)
    if not stops:
        return []
    load, output, sample = trial.errors.place
    name = trial.errors.loads[load]
    soft = bench.errors((name,), trial.setting, trial.exact, lambda case: case.softer(SOFTER))
    left = soft.values[0, output, sample]
    if not left <= FELL * trial.errors.largest:
        return []
    return [
        f"impacts on {' and '.join(f'effects.{name}' for name in stops)} set off vibrations that no larger basis "
        f"follows: stops {SOFTER:g} times as stiff leave {left:.2g} of {trial.errors.outputs[output]} "
        f"under load '{name}', and {soft.largest:.2g} of all outputs"
    ]


def _of_own_loads(bench: Bench, trial: Trial, rival: Trial | None, allowed: float) -> list[str]:
    """Return what the scene's own loads leave where others are worse, and whether it helps to try no others."""
    own = bench.training.loads[0].name
    if trial.errors.loads[trial.errors.place[0]] == own or own not in trial.errors.loads:
        return []
    tried = [trial] if rival is None else [trial, bench.go_on(rival, (own,))]
    left, k = min((np.nanmax(each.errors.values[each.errors.loads.index(own)]), k) for k, each in enumerate(tried))
    if not left <= allowed:
        return [f"the scene's own loads alone leave {left:.2g} too"]
    kind = tried[k].reduction
    which = "" if k == 0 else f' with {kind.modes} modes and stretching = "{kind.stretching}"'
    return [f"the scene's own loads leave {left:.2g}{which}: {OWN_LOADS}"]


def _cure_of_sudden_loads(bench: Bench, trial: Trial, unresolved: float) -> list[str]:
    """Return what sets in at once at the start, and what spares the bodies that jolt.

    A start at rest is proposed where halving the step moves much less with that than the `unresolved` without.
    """
    scene, (load, output, sample) = bench.scene, trial.errors.place
    moving = any(state.velocity != 0.0 for state in scene.simulation.initial.values())
    rests = moving or scene.initial.equilibrium and scene.initial.coordinates == "free"
    weights = [] if rests else [name for name, effect in scene.effects.items() if effect.uniform]
    acting = {name: effect for name, effect in scene.plain_effects.items() if effect.is_over_time}
    sudden = [name for name, effect in acting.items() if amplitude_of(effect).at_start != 0.0]
    cures = []
    if weights:
        moved, left = (of[output] for of in bench.from_rest(trial, trial.errors.loads[load], sample))
        if moved <= FELL * unresolved:
            cures.append(
                f"{_effects(weights)} at once at the start, on bodies that are not at rest under it: "
                'initial = { equilibrium = true, coordinates = "free" } starts where they are, halving the step then '
                f"moves {moved:.2g}, and the same basis leaves {left:.2g}"
            )
    if sudden:
        cures.append(f"{_effects(sudden)} at once at the start: let what acts over time begin at zero")
    return cures


def _effects(names: Sequence[str]) -> str:
    return " and ".join(f"effects.{name}" for name in names) + (" acts" if len(names) == 1 else " act")
