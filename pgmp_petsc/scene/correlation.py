"""Correlation between uncertain parameters: a Gaussian copula or Student's, whatever their own distributions are.

A coefficient r is that of the normal variables ``Phi^-1(F(x))`` behind two parameters. Between values themselves it is
the same for normal distributions, and about as large for others; their rank correlation (Spearman's) is
``6 / pi asin(r / 2)`` (Kruskal, Journal of the American Statistical Association 53 (1958) 814-861).

With ``ensemble.copula = "student"`` these variables have a common multivariate t distribution with the matrix of r
(Demarta and McNeil, International Statistical Review 73 (2005) 111-129): Kendall's coefficient is ``2 / pi asin(r)`` as
before, and extremes of two come together with the probability ``2 t_(f + 1)(-sqrt((f + 1) (1 - r) / (1 + r)))``, of
normal ones 0.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.runtime.errors import nearest_name
from pgmp_petsc.scene.messages import problem

if TYPE_CHECKING:
    from pgmp_petsc.scene.schema import Scene

SMALLEST_EIGENVALUE = 1e-10  # below, round-off decides whether the matrix has a factor


def correlation_matrix(scene: Scene, names: Sequence[str]) -> np.ndarray | None:
    """Return the matrix for parameters of some names, shape (d, d); None where none of them is correlated."""
    matrix = np.eye(len(names))
    for one, others in scene.correlation.items():
        for other, coefficient in others.items():
            if one in names and other in names:
                j, k = names.index(one), names.index(other)
                matrix[j, k] = matrix[k, j] = coefficient
    return matrix if np.any(matrix != np.eye(len(names))) else None


def correlation_problems(scene: Scene) -> Iterator[str]:
    """Yield one line for each coefficient that cannot be, or for a matrix that is none of correlations."""
    seen: dict[frozenset[str], str] = {}
    lines = [
        line
        for one, others in scene.correlation.items()
        for other, coefficient in others.items()
        for line in _of_pair(scene, one, other, coefficient, seen)
    ]
    yield from lines
    if not seen and scene.ensemble.copula != "gaussian":
        yield problem("ensemble.copula", "[correlation] names no parameters that it could join", scene.ensemble.copula)
    names = sorted({name for pair in seen for name in pair})
    matrix = None if lines else correlation_matrix(scene, names)
    if matrix is None:
        return
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    if smallest < SMALLEST_EIGENVALUE:
        yield problem(
            "correlation",
            f"no parameters have all these coefficients together: the matrix of {', '.join(names)} must be positive "
            f"definite, and its smallest eigenvalue is {smallest:.4g}; make some coefficients smaller",
        )
    if scene.ensemble.sampler == "saltelli":
        what = "Sobol indices are of independent parameters; leave the correlation out, or take another sampler"
        yield problem("correlation", f'ensemble.sampler = "saltelli" has no part for it: {what}')


def _of_pair(scene: Scene, one: str, other: str, coefficient: float, seen: dict[frozenset[str], str]) -> Iterator[str]:
    """Yield what is wrong with one coefficient, and remember its pair."""
    entry = f"correlation.{one}.{other}"
    for name, where in ((one, f"correlation.{one}"), (other, entry)):
        if name not in scene.parameters:
            yield problem(where, f"there is no such parameter{nearest_name(name, scene.parameters)}")
        elif scene.parameters[name].distribution is None:
            yield problem(where, f"parameters.{name} has no distribution, so it does not vary; give it one")
    if one == other:
        yield problem(entry, "a parameter is fully correlated with itself; name two", coefficient)
    elif not -1.0 < coefficient < 1.0:
        yield problem(entry, "must lie between -1 and 1, both excluded", coefficient)
    pair = frozenset((one, other))
    if pair in seen and one != other:
        yield problem(entry, f"{seen[pair]} is the same coefficient; give one of them", coefficient)
    seen[pair] = entry
