"""What a tolerance that cannot be met is answered: which part of the error stands in the way, with the figures."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, NoReturn

import numpy as np

from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.selection.bench import Bench, Trial
from pgmp_petsc.selection.ledger import Ledger

FELL = 0.4  # an error that falls below this share of itself has found its cause
UNRESOLVED = 5.0  # times the error, moved by halving the step: no basis can be judged with it
PARTS = {
    "basis": "the basis",
    "interpolation": "the interpolation between angles",
    "step": "the time step",
}


def refuse(
    entry: str, tolerance: float, part: str, allowed: Mapping[str, float], ledger: Ledger, hints: Sequence[str]
) -> NoReturn:
    """Raise an `InputError` with the best that every part reached.

    Parameters
    ----------
    entry, tolerance
        The tolerance that cannot be met.
    part
        What stands in the way.
    allowed
        Allowed error of every part.
    ledger
        What was tried.
    hints
        Further lines.
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
            lines.append(f"  {name}: {tried[-1] if tried else f'not looked at any more, allowed {limit:.2g}'}")
    raise InputError("\n".join([*lines, *(f"  {hint}" for hint in hints)]))


def basis_hints(bench: Bench, trial: Trial, share: float, kept: Mapping[str, Any]) -> list[str]:
    """Find out what is wrong with the best basis: the load's size, the parameters' distance, or the step.

    Parameters
    ----------
    bench
        Where it was tried.
    trial
        The best that was found.
    share
        Of the tolerance that its error may take.
    kept
        Entries of the scene that did not stand for choice.
    """
    errors, hints = trial.errors, []
    if not np.isfinite(errors.largest):
        return [_kept_text(kept)] if kept else []
    load, output, sample = errors.place
    name, what = errors.loads[load], errors.outputs[output]
    half = bench.weakened(trial, name, 0.5).values[0, output, sample]
    nominal = np.nanmax(errors.values[:, :, 0])
    unresolved = bench.moved(trial.n_steps, 2 * trial.n_steps, (name,)).values[0, output, sample]
    hints.append(
        f"of this, half the load leaves {half:.2g}; at nominal parameters it is {nominal:.2g}; halving the step moves "
        f"the full-order {what} itself by {unresolved:.2g}"
    )
    causes = []
    if half <= FELL * errors.largest:
        causes.append("the deformation is too large for the terms of first and second order that a reduced model has")
    if nominal <= FELL * errors.largest:
        causes.append("the modes are those of nominal parameters, and these values are too far from them")
    if unresolved > UNRESOLVED * errors.largest:
        causes.append("the loads set off vibrations that the step does not resolve and a small basis does not have")
    if causes:
        hints.append("; ".join(causes))
    hints.append(f"a tolerance of {1.05 * errors.largest / share:.1e} can be met by this part")
    return hints + ([_kept_text(kept)] if kept else [])


def _kept_text(kept: Mapping[str, Any]) -> str:
    given = ", ".join(f"reduction.{name} = {json.dumps(value)}" for name, value in kept.items())
    return f"kept as given: {given}; leave them out to have them chosen"
