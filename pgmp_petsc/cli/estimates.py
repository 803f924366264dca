"""What a command says of estimated errors, of how far runs left small deformations, and of their balance of energy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from pgmp_petsc.results import Ensemble, EstimatedErrors
from pgmp_petsc.results.errors import OF_STEP

#: How the values of `VALIDITY` are written; those that are not known are left out.
WRITTEN = {
    "elastic_rotation": "largest elastic rotation {} rad",
    "elastic_strain": "elastic strain {}",
    "stiffness_gained": "stiffness of a mode gained {}",
    "stiffness_lost": "lost {} by forces in the bodies",
}


def of_trajectory(errors: EstimatedErrors, units: dict[str, str]) -> list[str]:
    """Return a line an output."""
    what = "the time step" if errors.what == OF_STEP else "the reduction and the time step"
    lines = [f"  estimated errors over the run, of {what}"]
    for name in errors.outputs:
        lines.append(f"  {name:24s}{_error(errors.maximum(name), errors.share(name), units.get(name, '1'))}")
    return lines


def of_ensemble(ensemble: Ensemble) -> list[str]:
    """Return the same for the samples that were checked: median and largest; and the validity of all."""
    lines = []
    found = dict(_known(ensemble.errors))
    if found:
        n_checked = max(known.size for known in found.values())
        what = "the reduction and the time step" if ensemble.model == "reduced" else "the time step"
        lines.append(f"  estimated errors over the run, of {what}; {n_checked} samples: median, largest")
        for name, known in found.items():
            lines.append(f"  {name:24s}{np.median(known):14.2g}{np.max(known):14.2g} {ensemble.units[name]}")
    worst = {name: float(known[np.argmax(np.abs(known))]) for name, known in _known(ensemble.validity)}
    return [*lines, of_validity(worst)] if worst else lines


def _known(columns: Mapping[str, np.ndarray]) -> Iterator[tuple[str, np.ndarray]]:
    """Yield what is known of each column, where anything is; one column at a time."""
    for name, values in columns.items():
        known = values[np.isfinite(values)]
        if known.size:
            yield name, known


def of_balance(ensemble: Ensemble) -> list[str]:
    """Return one line of the samples' balance of energy; none where it was not drawn up."""
    if not ensemble.balance:
        return []
    residual, exchanged = (ensemble.balance[name] for name in ("residual", "exchanged"))
    known = np.flatnonzero(np.isfinite(residual) & (exchanged > 0.0))
    if not known.size:
        return ["  balance of energy: no sample is fine and moves any energy"]
    shares = 100.0 * residual[known] / exchanged[known]
    worst = int(known[np.argmax(shares)])
    return [
        f"  balance of energy: residual {np.median(shares):.2g} % of what is moved around in the median, "
        f"{shares.max():.2g} % at most (sample {worst})"
    ]


def of_validity(validity: Mapping[str, float]) -> str:
    """Return one line of how far a run, or the worst of several, left small deformations."""
    known = {name: value for name, value in validity.items() if np.isfinite(value)}
    return "  " + ", ".join(text.format(f"{known[name]:.2g}") for name, text in WRITTEN.items() if name in known)


def _error(maximum: float, share: float, unit: str) -> str:
    if not np.isfinite(maximum):
        return "          no estimate: the full-order equations could not be solved about this motion"
    relative = f" ({100 * share:.2g} % of its largest value)" if share <= 1.0 else ""
    if share > 1.0:  # an output that is zero but for round-off, or one that is not computed at all
        relative = f" (its largest value is {maximum / share:.2g} {unit})"
    return f"{maximum:16.2g} {unit}{relative}"
