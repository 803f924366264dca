"""Modes and static modes at other parameter values that the basis of the nominal parameters misses.

The snapshots X(theta) of other parameter values, M-orthogonal to the kept vectors, are compressed by one constant
matrix C, the leading eigenvectors of the mean Gram matrix ``mean_k X_k^T M X_k``; the values are a greedy choice among
those that span the distributions (docs/method.md, parameters far from nominal).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.mechanism.continuation import tensor_grid
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.modes.static_modes import static_modes
from pgmp_petsc.ranks.agreement import agreed
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.sample_grid import ParameterPoints
from pgmp_petsc.reduction.static_loads import StaticLoads
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.parameters import spanning_values


class ParameterSnapshots(AbstractContextManager):
    """Bases at points of given values of all parameters. Collective on the problem's communicator.

    The problem is at the nominal parameters; loads are what static modes answer.
    """

    def __init__(self, problem: ModalProblem, loads: StaticLoads, points: Sequence[Mapping[str, float]]) -> None:
        self.problem, self.loads = problem, loads
        self.problems = [problem.at_values(values) for values in points]

    def __exit__(self, *error: object) -> None:
        for problem in self.problems:
            problem.close()

    def at(self, theta: np.ndarray, kept: np.ndarray) -> list[np.ndarray]:
        """Return the snapshots of every point at a configuration, shape (n_theta,), rad, each of the shape of `kept`,
        nominal modes and static modes there, local rows, shape (n_local, n_kept).

        They are the projections, in the point's own mass norm, of the nominal vectors onto the space of the point's
        modes and static modes.
        """
        found = []
        for problem in self.problems:
            modes = problem.solve(theta)
            own = np.hstack([modes.flexible, static_modes(problem, modes, self.loads.at)])
            found.append(own @ problem.inner(own, problem.times_mass(kept)))
        return found

    def missed(self, snapshots: Sequence[np.ndarray], kept: np.ndarray) -> np.ndarray:
        """Return what vectors leave of the snapshots of `at`, side by side, M-orthogonal to them at the nominal
        parameters.

        `kept` are free rigid and flexible vectors that the basis has, shape (n_local, n_kept).
        """
        if not snapshots:
            return np.empty((len(kept), 0))
        rest = np.hstack(snapshots)
        for _ in range(2):
            rest = rest - self.problem.onto(kept, rest)
        return rest


# Smallest eigenvalue of ``E^T M E`` at any configuration; its mean is 1. Tables of vectors that nearly vanish somewhere
# are interpolated badly there: with 1e-4 the slider-crank's deformation errs by percents, with 1e-2 no more than
# elsewhere; with 1e-3 made orthonormal they turn within 0.03 rad over the size's own rate.
INDEPENDENT = 1e-2
ROUND_OFF = 1e-10  # mean squares below this share of the largest one


@dataclass(frozen=True, eq=False)
class Compression:
    """The vectors that a basis takes from the snapshots."""

    matrix: np.ndarray  # c, shape (n_snapshots, n_parameter)
    #: whether a vector changes its sign after a revolution of each coordinate, shape (n_theta, n_parameter)
    flips: np.ndarray

    @classmethod
    def of(cls, grams: np.ndarray, flipped: np.ndarray, n_parameter: int) -> Compression:
        """Find the leading `n_parameter` vectors that are independent at every configuration, or as many as there are:
        where one vanishes, the reduced mass would be singular. Gram matrices are those of the snapshots in the
        continuous basis, shape (n, n_snapshots, n_snapshots).

        `flipped` tells whether a snapshot changes its sign after a revolution of each coordinate, shape (n_theta,
        n_snapshots): over two of them, those that do are orthogonal to those that do not.
        """
        mean = np.where((flipped[:, :, None] == flipped[:, None, :]).all(axis=0), grams.mean(axis=0), 0.0)
        squares, vectors = np.linalg.eigh(mean)
        squares, vectors = squares[::-1], vectors[:, ::-1]
        # the leading ones that are independent everywhere of those before them; one that vanishes somewhere, as the
        # answer to a spring does where that lies along a bar, is passed over
        n = int(np.sum(squares > ROUND_OFF * squares[:1]))
        scaled = vectors[:, :n] / np.sqrt(squares[:n])
        everywhere, chosen = scaled.T @ grams @ scaled, []
        for k in range(n):
            tried = [*chosen, k]
            of = everywhere[:, tried][:, :, tried]
            if len(chosen) < n_parameter and np.linalg.eigvalsh(of)[:, 0].min() >= INDEPENDENT:
                chosen = tried
        squares, vectors = squares[chosen], vectors[:, chosen]
        largest = np.argmax(np.abs(vectors), axis=0)
        signs = np.sign(vectors[largest, range(len(chosen))])
        return cls(signs * vectors / np.sqrt(squares), flipped[:, largest])

    def holds(self, grams: np.ndarray) -> bool:
        """Return whether the vectors are independent at every configuration of Gram matrices (n, n_snapshots,
        n_snapshots), which may be other ones than they were found at."""
        return bool(np.linalg.eigvalsh(self.matrix.T @ grams @ self.matrix).min(initial=np.inf) >= INDEPENDENT)

    def beside(self, n_kept: int, n_given: int) -> np.ndarray:
        """Return the matrix leaving kept vectors before, and given ones after these, as they are, shape (n_kept +
        n_snapshots + n_given, n_kept + n_parameter + n_given)."""
        return block_diag(np.eye(n_kept), self.matrix, np.eye(n_given))


N_CONFIGURATIONS = 8  # at least, over the middles of a grid
MOST_POINTS = 4
GAIN = 0.9  # a further point leaves less than this of the largest share, or is not worth its eigenproblems
DIGITS = 6  # of the shares that are compared: round-off must not choose


def choose_points(scene: Scene, problem: ModalProblem, loads: StaticLoads, group: RankGroup) -> ParameterPoints:
    """Choose the points for ``reduction.parameter_modes``. Collective on ``group.world``; the same on all ranks.

    The problem is at the nominal parameters; loads are what static modes answer. Raises `InputError` if no parameter
    has a distribution: there is nowhere to take modes; `RunError` if an eigenproblem fails.
    """
    if not scene.reduction.parameter_modes:
        return ParameterPoints.none()
    spanned, n_samples = spanning_values(scene)
    candidates = [{name: float(column[k]) for name, column in spanned.items()} for k in range(1, n_samples)]
    if not candidates:
        raise InputError(
            f"reduction.parameter_modes = {scene.reduction.parameter_modes}: no parameter has a distribution (or a "
            "value beside the nominal one) to take modes at; give one, or leave parameter_modes out"
        )
    # configurations spread over the range, shape (n, n_theta)
    coordinates = problem.kinematics.coordinates
    n = int(np.ceil(N_CONFIGURATIONS ** (1.0 / len(coordinates))))
    axes = [c.lower + (c.upper - c.lower) * (np.arange(n) + 0.5) / n for c in coordinates]
    middles = tensor_grid(axes)
    own = middles[list(group.arc(len(middles)))]

    def shares(chosen: Sequence[int]) -> np.ndarray:
        """Return the largest missed share of every candidate over the configurations, shape (n_candidates,)."""
        worst = np.zeros(len(candidates))
        for configuration in configurations:
            worst = np.maximum(worst, configuration.shares(snapshots, chosen, scene.reduction.parameter_modes))
        return np.round(np.max(group.world.allgather(worst), axis=0), DIGITS)

    with ExitStack() as stack:
        with agreed(group.world, "choice of parameter points"):
            snapshots = stack.enter_context(ParameterSnapshots(problem, loads, candidates if own.size else ()))
            configurations = [_Configuration.of(snapshots, theta) for theta in own]
        chosen: list[int] = []
        current = shares(chosen)
        missed = [current.max()]
        # where nothing is missed, as with parameters of forces alone, a point gives vectors of round-off
        while current.max() > 0.0 and len(chosen) < min(MOST_POINTS, len(candidates)):
            trial = [*chosen, int(np.argmax(current))]
            found = shares(trial)
            if trial[-1] in chosen or (chosen and found.max() > GAIN * current.max()):
                break
            chosen, current = trial, found
            missed.append(current.max())
    values = {name: np.array([candidates[k][name] for k in chosen]) for name in spanned}
    return ParameterPoints(scene.reduction.parameter_modes, np.array(missed), values)


@dataclass(frozen=True, eq=False)
class _Configuration:
    """The kept flexible vectors V, and X, what they leave of all snapshots, at one configuration; local rows."""

    kept: np.ndarray  # shape (n_local, n_kept)
    rest: np.ndarray  # shape (n_candidates, n_local, q)
    #: ``V^T M`` times the whole snapshots, which are V times these plus X (plus a rigid motion, which strains nothing),
    #: shape (n_candidates, n_kept, q)
    coefficients: np.ndarray

    @classmethod
    def of(cls, snapshots: ParameterSnapshots, theta: np.ndarray) -> _Configuration:
        """Compute the vectors."""
        problem = snapshots.problem
        modes = problem.solve(theta)
        kept = np.hstack([modes.flexible, static_modes(problem, modes, snapshots.loads.at)])
        found = snapshots.at(theta, kept)
        rest = snapshots.missed(found, np.hstack([modes.unstrained, kept]))
        along = problem.inner(kept, problem.times_mass(np.hstack(found)))
        return cls(kept, *(np.stack(np.hsplit(part, len(found))) for part in (rest, along)))

    def shares(self, snapshots: ParameterSnapshots, chosen: Sequence[int], n_vectors: int) -> np.ndarray:
        """Return the missed share of the energy norm of every candidate, shape (n_candidates,)."""
        problem, basis = snapshots.problem, self.kept
        if chosen:
            own = np.hstack(self.rest[list(chosen)])
            squares, vectors = np.linalg.eigh(problem.inner(own, problem.times_mass(own)))
            leading = vectors[:, squares > ROUND_OFF * squares[-1]][:, ::-1][:, :n_vectors]
            basis = np.hstack([basis, own @ leading])
        worst = np.empty(len(snapshots.problems))
        for candidate, other in enumerate(snapshots.problems):
            snapshot = self.kept @ self.coefficients[candidate] + self.rest[candidate]
            forces = other.times_stiffness(basis)
            inner = problem.inner(forces, basis)
            scale = 1.0 / np.sqrt(np.diag(inner))
            missed = scale[:, None] * problem.inner(forces, snapshot)
            projected = np.linalg.solve(inner * scale * scale[:, None], missed)
            rest = snapshot - basis @ (scale[:, None] * projected)
            both = np.hstack([rest, snapshot])
            energies = np.maximum(np.diag(problem.inner(both, other.times_stiffness(both))), 0.0)
            worst[candidate] = np.sqrt(np.max(energies[: rest.shape[1]] / energies[rest.shape[1] :]))
        return worst
