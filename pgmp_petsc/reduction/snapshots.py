"""What the basis of the nominal parameters misses at other parameter values: modes and static modes there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import TracebackType

import numpy as np

from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.modes.static_modes import static_modes
from pgmp_petsc.reduction.static_loads import StaticLoads


class ParameterSnapshots:
    """Bases at several parameter points. Collective on the problem's communicator.

    Parameters
    ----------
    problem
        Eigenproblem at the nominal parameters.
    loads
        What static modes answer.
    points
        Values of all parameters at every point.
    """

    def __init__(self, problem: ModalProblem, loads: StaticLoads, points: Sequence[Mapping[str, float]]) -> None:
        self._problem, self._loads = problem, loads
        self.problems = [problem.at_values(values) for values in points]

    def __enter__(self) -> ParameterSnapshots:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for problem in self.problems:
            problem.close()

    def at(self, theta: np.ndarray, kept: np.ndarray) -> list[np.ndarray]:
        """Return the snapshots of every point at a configuration.

        They are the projections, in the point's own mass norm, of the nominal vectors onto the space of the point's
        modes and static modes. So signs, order and rotations at the point have no part in them, and where the nominal
        vectors are turned to be continuous, these turn with them.

        Parameters
        ----------
        theta
            The configuration, shape (n_theta,), rad.
        kept
            Nominal modes and static modes there, local rows, shape (n_local, n_kept).

        Returns
        -------
        list of ndarray
            One of the same shape for every point.
        """
        return [self._of_point(problem, theta, kept) for problem in self.problems]

    def _of_point(self, problem: ModalProblem, theta: np.ndarray, kept: np.ndarray) -> np.ndarray:
        modes = problem.solve(theta)
        static = static_modes(problem, modes, self._loads.at)
        own = np.hstack([modes.flexible, static])
        return own @ problem.inner(own, problem.times_mass(kept))

    def missed(self, snapshots: Sequence[np.ndarray], kept: np.ndarray) -> np.ndarray:
        """Return what vectors leave of the snapshots, side by side, M-orthogonal to them at the nominal parameters.

        Parameters
        ----------
        snapshots
            As from `at`.
        kept
            Free rigid and flexible vectors that the basis has, shape (n_local, n_kept).
        """
        if not snapshots:
            return np.empty((len(kept), 0))
        rest = np.hstack(snapshots)
        for _ in range(2):
            rest = rest - self._problem.onto(kept, rest)
        return rest
