"""What a command says of the estimated errors of reduced runs."""

from __future__ import annotations

import numpy as np

from pgmp_petsc.results import Ensemble, EstimatedErrors
from pgmp_petsc.results.errors import ROTATION_LIMIT, beyond_limit


def of_trajectory(errors: EstimatedErrors, units: dict[str, str]) -> list[str]:
    """Return a line an output, one for the validity, and a warning where that is in doubt."""
    lines = ["  estimated errors over the run, of the reduction and the time step"]
    for name in errors.outputs:
        lines.append(f"  {name:24s}{_error(errors.maximum(name), errors.share(name), units.get(name, '1'))}")
    lines.append(_validity(*errors.validity.values()))
    if beyond_limit(errors.validity["elastic_rotation"]):
        lines.append(_warning(""))
    return lines


def of_ensemble(ensemble: Ensemble) -> list[str]:
    """Return the same for the samples that were checked: median and largest."""
    n_checked = int(np.sum(np.isfinite(ensemble.validity["elastic_rotation"])))
    if n_checked == 0:
        return ["  no sample's errors were estimated"]
    lines = [
        f"  estimated errors over the run, of the reduction and the time step; {n_checked} samples: median, largest"
    ]
    for name, found in ensemble.errors.items():
        known = found[np.isfinite(found)]
        if known.size:
            lines.append(f"  {name:24s}{np.median(known):14.2g}{np.max(known):14.2g} {ensemble.units[name]}")
    lines.append(_validity(*(np.nanmax(values) for values in ensemble.validity.values())))
    too_far = int(np.sum(beyond_limit(ensemble.validity["elastic_rotation"])))
    if too_far:
        lines.append(_warning(f"{too_far} of {n_checked} samples: "))
    return lines


def _error(maximum: float, share: float, unit: str) -> str:
    if not np.isfinite(maximum):
        return "          no estimate: the full-order equations could not be solved about this motion"
    relative = f" ({100 * share:.2g} % of its largest value)" if np.isfinite(share) else ""
    return f"{maximum:16.2g} {unit}{relative}"


def _validity(rotation: float, strain: float) -> str:
    return f"  largest elastic rotation {rotation:.2g} rad, elastic strain {strain:.2g}"


def _warning(whose: str) -> str:
    return (
        f"warning: {whose}elastic rotations beyond {ROTATION_LIMIT} rad: linear strains are wrong by more than 1 %; "
        "deformations of this size call for the full-order model"
    )
