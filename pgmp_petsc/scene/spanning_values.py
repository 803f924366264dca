"""Parameter values that span a scene's distributions: what bases and steps are tried on before the samples come.

Parameters take their nominal value, their quantiles at three standard deviations of a normal distribution (bounds
applied as an ensemble does), and the values half-way: alone, the others nominal (a star), and the outermost ones
together (corners).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from pgmp_petsc.scene.schema import Scene

OUTERMOST = 1.35e-3  # probability beyond three standard deviations of a normal distribution
LEAST_SHARE = 0.1  # of the nominal value, of a parameter that must be positive and may be as small as 0
BESIDE = 1.25  # a value that is given with --set over the nominal one, or under it
MOST_CORNERS = 3  # parameters whose corners are all taken; of more, only all low and all high


def uncertain_names(scene: Scene) -> list[str]:
    """Return the parameters with a distribution, sorted."""
    return sorted(name for name, parameter in scene.parameters.items() if parameter.distribution is not None)


def spanning_values(scene: Scene, names: Sequence[str] | None = None) -> tuple[dict[str, np.ndarray], int]:
    """Return the values of every parameter, shape (n_samples,), the nominal ones first, and n_samples.

    Parameters
    ----------
    names
        Parameters that vary, each with a distribution or with bounds; by default those with a distribution.
    """
    names = uncertain_names(scene) if names is None else names
    levels = {name: _levels(scene, name) for name in names}
    samples = [dict(scene.nominal)]
    for name, (low, high) in levels.items():
        nominal = scene.nominal[name]
        for value in (low, 0.5 * (low + nominal), 0.5 * (nominal + high), high):
            samples.append(scene.nominal | {name: value})
    if 1 < len(names) <= MOST_CORNERS:
        samples += [scene.nominal | dict(zip(names, corner)) for corner in product(*levels.values())]
    elif len(names) > MOST_CORNERS:
        samples += [scene.nominal | {name: levels[name][side] for name in names} for side in (0, 1)]
    samples.append(scene.values)
    once = [sample for k, sample in enumerate(samples) if sample not in samples[:k]]
    return {name: np.array([sample[name] for sample in once]) for name in scene.parameters}, len(once)


def outermost_values(scene: Scene, share: float) -> dict[str, tuple[float, float]]:
    """Return what samples of each parameter lie between, but for a share of them on either side, its nominal value with
    them; of a parameter that is not drawn `BESIDE` it."""
    spans = {}
    for name, parameter in scene.parameters.items():
        varies = parameter.distribution is not None or parameter.bounds is not None
        ends = _levels(scene, name, share) if varies else (parameter.nominal / BESIDE, parameter.nominal * BESIDE)
        spans[name] = (min(*ends, parameter.nominal), max(*ends, parameter.nominal))
    return spans


def _levels(scene: Scene, name: str, share: float = OUTERMOST) -> tuple[float, float]:
    """Return the outermost values of a parameter, bounds applied as an ensemble applies them."""
    parameter = scene.parameters[name]
    if parameter.distribution is None:
        low, high = parameter.bounds
        return (LEAST_SHARE * parameter.nominal if name in scene.positive_parameters and low <= 0.0 else low), high
    least = 0.0 if name in scene.parameters_not_negative else -np.inf
    low, high = parameter.quantiles(np.array([share, 1.0 - share]), least)
    return float(low), float(high)
