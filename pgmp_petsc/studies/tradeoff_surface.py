"""Response surfaces: outputs over time as functions of the parameters, interpolated between full-order runs.

With one uncertain parameter a cubic spline (not-a-knot; a polynomial where there are fewer than four nodes), with
several a cubic radial basis function with a polynomial, every instant of every output by itself. This is
what one would do without a reduced model: it knows nothing of the mechanism, and holds for the loads, the start and the
outputs of its runs only.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.interpolate import CubicSpline, RBFInterpolator

# of the polynomial beside a cubic radial basis function, which needs at least the first
DEGREES = (2, 1)


class ResponseSurface:
    """Interpolates outputs over time between nodes in the space of the parameters.

    Parameters
    ----------
    nodes
        Parameter values, shape (n_nodes, n_parameters).
    outputs
        Outputs at the nodes, each of shape (n_t, n_nodes).

    Raises
    ------
    ValueError
        If there are too few nodes for any interpolation.
    """

    def __init__(self, nodes: np.ndarray, outputs: Mapping[str, np.ndarray]) -> None:
        self._names = list(outputs)
        every = np.concatenate(list(outputs.values())).T  # (n_nodes, n_outputs * n_t)
        # a deformation may be no number at some instants of a run that leaves a limited range
        self._known = np.isfinite(every).all(axis=0)
        data = every[:, self._known]
        self._low, self._width = nodes.min(axis=0), np.ptp(nodes, axis=0)
        scaled = self._scaled(nodes)
        if nodes.shape[1] == 1:
            self._interpolate = CubicSpline(scaled[:, 0], data)
        else:
            self._interpolate = RBFInterpolator(scaled, data, kernel="cubic", degree=_degree(*nodes.shape))

    def evaluate(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """Return the outputs over time, each of shape (n_t, n), at parameter values of shape (n, n_parameters).

        Where a run of the surface has no number, neither has the surface.
        """
        scaled = self._scaled(points)
        rows = np.full((len(points), self._known.size), np.nan)
        rows[:, self._known] = self._interpolate(scaled[:, 0] if scaled.shape[1] == 1 else scaled)
        return dict(zip(self._names, np.split(rows.T, len(self._names))))

    def _scaled(self, points: np.ndarray) -> np.ndarray:
        return (points - self._low) / self._width


def node_counts(n_uncertain: int, steps: int) -> list[int]:
    """Return numbers of nodes that are worth a try, the fewest first: 3, 5, 9, ... or multiples of 2 n + 1."""
    if n_uncertain == 0:
        return []
    if n_uncertain == 1:
        return [2**k + 1 for k in range(1, steps + 1)]
    return [(2 * n_uncertain + 1) * 2**k for k in range(steps)]


def _degree(n_nodes: int, n_parameters: int) -> int:
    """Return the largest degree whose polynomials the nodes determine, with one node to spare."""
    terms = {1: n_parameters + 1, 2: (n_parameters + 1) * (n_parameters + 2) // 2}
    for degree in DEGREES:
        if n_nodes > terms[degree]:
            return degree
    raise ValueError(f"{n_nodes} nodes for {n_parameters} parameters; at least {terms[1] + 1} are needed")
