"""What the basis of the nominal parameters misses at other parameter values: modes and static modes there.

Few vectors in place of many snapshots, continuous over the configurations.

The snapshots X(theta) of other parameter values, M-orthogonal to the kept vectors, are compressed by one constant
matrix C for all configurations: the vectors ``E(theta) = X(theta) C`` are as continuous as the snapshots are, whatever
happens to their order of importance along theta. C holds the leading eigenvectors of the mean Gram matrix
``mean_k X_k^T M X_k`` (a proper orthogonal decomposition in the M-norm over all samples).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType

import numpy as np
from scipy.linalg import block_diag

from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.modes.static_modes import static_modes
from pgmp_petsc.reduction.static_loads import StaticLoads
from pgmp_petsc.runtime.errors import InputError


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


# Smallest eigenvalue of ``E^T M E`` at any configuration; its mean is 1. Tables of vectors that nearly vanish somewhere
# are interpolated badly there: with 1e-4 the slider-crank's deformation errs by percents, with 1e-2 no more than
# elsewhere.
INDEPENDENT = 1e-3
ROUND_OFF = 1e-10  # mean squares below this share of the largest one


@dataclass(frozen=True, eq=False)
class Compression:
    """The vectors that a basis takes from the snapshots.

    Attributes
    ----------
    matrix
        C, shape (n_snapshots, n_parameter).
    flips
        Whether a vector changes its sign after a revolution of each coordinate, shape (n_theta, n_parameter).
    """

    matrix: np.ndarray
    flips: np.ndarray

    @classmethod
    def of(cls, grams: np.ndarray, flipped: np.ndarray, n_parameter: int) -> Compression:
        """Find the leading vectors.

        Parameters
        ----------
        grams
            Gram matrices of the snapshots in the continuous basis, shape (n, n_snapshots, n_snapshots).
        flipped
            Whether a snapshot changes its sign after a revolution of each coordinate, shape (n_theta, n_snapshots):
            over two of them, those that do are orthogonal to those that do not.
        n_parameter
            Number of vectors wanted.

        Raises
        ------
        InputError
            If they are not independent at every configuration: where one vanishes, the reduced mass would be singular.
        """
        mean = np.where((flipped[:, :, None] == flipped[:, None, :]).all(axis=0), grams.mean(axis=0), 0.0)
        squares, vectors = np.linalg.eigh(mean)
        squares, vectors = squares[::-1], vectors[:, ::-1]
        rank = _independent(grams, squares, vectors)
        if rank < n_parameter:
            raise InputError(
                f"reduction.parameter_modes = {n_parameter}: modes and static modes at other parameter values give no "
                f"more than {rank} vectors that are independent at every configuration; take fewer"
            )
        vectors = vectors[:, :n_parameter]
        largest = np.argmax(np.abs(vectors), axis=0)
        signs = np.sign(vectors[largest, range(n_parameter)])
        return cls(signs * vectors / np.sqrt(squares[:n_parameter]), flipped[:, largest])

    def beside(self, n_kept: int) -> np.ndarray:
        """Return the matrix leaving kept vectors as they are, shape (n_kept + n_snapshots, n_kept + n_parameter)."""
        return block_diag(np.eye(n_kept), self.matrix)


def _independent(grams: np.ndarray, squares: np.ndarray, vectors: np.ndarray) -> int:
    """Return how many of the leading vectors are independent at every configuration."""
    n = int(np.sum(squares > ROUND_OFF * squares[:1]))
    scaled = vectors[:, :n] / np.sqrt(squares[:n])
    everywhere = scaled.T @ grams @ scaled
    while n and np.linalg.eigvalsh(everywhere[:, :n, :n])[:, 0].min() < INDEPENDENT:
        n -= 1
    return n
