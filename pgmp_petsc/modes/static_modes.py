"""Static modes: what modes miss of the static answers to loads, orthonormal beside them.

At single configurations an answer r(theta) may be a combination of the modes and of the answers before it: where a
rod's motion is a translation, its weight along the motion is its inertia force. The space that the answers span has a
limit there: what is left of r beside the others vanishes with a power of the distance, odd or even, and the basis
continues with the direction of ``r(theta + h) - r(theta - h)`` or ``r(theta + h) + r(theta - h)``, the larger one.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pgmp_petsc.modes.mode_set import ModeSet
from pgmp_petsc.modes.problem import DEPENDENT_TOLERANCE, ModalProblem
from pgmp_petsc.runtime.errors import RunError

# h of a limit, as a share of a coordinate's range: the direction is off by the square of this, and where what is left
# of an answer vanishes with the square, 7 of its 13 digits are left
LIMIT_STEP = 1e-3

LoadsAt = Callable[[ModalProblem, ModeSet], np.ndarray]


def static_modes(problem: ModalProblem, modes: ModeSet, loads_at: LoadsAt) -> np.ndarray:
    """Return what the modes miss of the static answers to loads (`ModalProblem.static_answers`).

    Collective on the problem's communicator.

    Parameters
    ----------
    problem
        At a configuration.
    modes
        Modes there.
    loads_at
        Gives the loads where the problem is, in body frames, local rows, shape (n_local, n_loads).

    Returns
    -------
    ndarray, shape (n_local, n_static)
        M-orthonormal, and M-orthogonal to `modes`.

    Raises
    ------
    RunError
        If an answer is a combination of the modes and the others at neighbouring configurations too.
    """
    kept, loads = modes.eigenvectors, loads_at(problem, modes)
    if not len(loads.T):
        return np.empty((len(kept), 0))
    answers = problem.static_answers(kept, loads)
    sizes = problem.norms(answers)
    basis, dependent = _extended(problem, kept, answers, sizes)
    if dependent.any():
        basis, dependent = _extended(problem, kept, _limits(problem, modes, loads_at), sizes)
    if dependent.any():
        raise RunError(
            f"reduction.static_modes at {problem.kinematics.describe(modes.theta)}: a load's static "
            "answer is a combination of the modes and the other answers, and so it is beside; take fewer modes, or no "
            "static ones (reduction.static_modes, reduction.spring_modes)"
        )
    return basis[:, kept.shape[1] :]


def dependent_loads(problem: ModalProblem, modes: ModeSet, loads: np.ndarray) -> np.ndarray:
    """Return whose static answers are combinations of the modes and of the answers before, shape (n_loads,).

    Parameters
    ----------
    problem, modes
        As those of `static_modes`.
    loads
        In body frames, local rows, shape (n_local, n_loads).
    """
    answers = problem.static_answers(modes.eigenvectors, loads)
    return _extended(problem, modes.eigenvectors, answers, problem.norms(answers))[1]


def _extended(
    problem: ModalProblem, kept: np.ndarray, answers: np.ndarray, sizes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return vectors extended by orthonormal answers, and which answers depend on those before and are left out.

    Sizes (n_loads,) are those of which round-off leaves a share of `DEPENDENT_TOLERANCE`.
    """
    basis, m_basis, dependent = kept, problem.times_mass(kept), np.zeros(len(sizes), dtype=bool)
    inverse = np.linalg.inv(problem.inner(kept, m_basis))
    for number, (rest, size) in enumerate(zip(answers.T[..., None], sizes)):
        for _ in range(2):  # twice is enough (Kahan): the second pass removes what round-off left
            rest = rest - basis @ (inverse @ problem.inner(m_basis, rest))
        m_rest = problem.times_mass(rest)
        left = np.sqrt(problem.inner(rest, m_rest)[0, 0])
        dependent[number] = not left > DEPENDENT_TOLERANCE * size
        if not dependent[number]:
            basis, m_basis = np.hstack([basis, rest / left]), np.hstack([m_basis, m_rest / left])
            inverse = np.pad(inverse, (0, 1))
            inverse[-1, -1] = 1.0
    return basis, dependent


def _beside(problem: ModalProblem, basis: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return what a basis misses of vectors."""
    for _ in range(2):
        vectors = vectors - problem.onto(basis, vectors)
    return vectors


def _limits(problem: ModalProblem, modes: ModeSet, loads_at: LoadsAt) -> np.ndarray:
    """Return the directions of what is left of each answer in the limit of the configuration of the modes.

    Along the coordinate that leaves most; shape (n_local, n_loads). All of them come from the neighbours: what is left
    beside a limit vanishes with it only then. The problem returns to the configuration.
    """
    found = []
    for k, coordinate in enumerate(problem.kinematics.coordinates):
        step = LIMIT_STEP * (coordinate.upper - coordinate.lower)
        ends = modes.theta[k] + np.array([-step, step])
        if not coordinate.periodic:  # at an end of the range of one side alone
            ends = np.clip(ends, coordinate.lower, coordinate.upper)
        before, after = (_left_at(problem, modes, k, end, loads_at) for end in ends)
        found += [after - before, after + before]
    problem.resume(modes.theta, modes.eigenvalues, modes.flexible)
    largest = np.argmax([problem.norms(vectors) for vectors in found], axis=0)
    return np.array(found)[largest, :, np.arange(len(largest))].T


def _left_at(problem: ModalProblem, modes: ModeSet, k: int, value: float, loads_at: LoadsAt) -> np.ndarray:
    """Return what is left of each answer beside those before it, with coordinate k at a value, (n_local, n_loads)."""
    theta = modes.theta.copy()
    theta[k] = value
    there = problem.solve(theta)
    basis = there.eigenvectors
    answers = problem.static_answers(basis, loads_at(problem, there))
    for number in range(answers.shape[1]):
        one = slice(number, number + 1)
        answers[:, one] = _beside(problem, basis, answers[:, one])
        size = problem.norms(answers[:, one])
        if size > 0.0:
            basis = np.hstack([basis, answers[:, one] / size])
    return answers
