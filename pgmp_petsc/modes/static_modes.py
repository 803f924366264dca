"""Static modes: what modes miss of the static answers to loads, orthonormal beside them."""

from __future__ import annotations

import numpy as np

from pgmp_petsc.modes.mode_set import ModeSet
from pgmp_petsc.modes.problem import DEPENDENT_TOLERANCE, ModalProblem
from pgmp_petsc.runtime.errors import RunError


def static_modes(problem: ModalProblem, modes: ModeSet, loads: np.ndarray) -> np.ndarray:
    """Return what the modes miss of the static answers to loads (`ModalProblem.static_answers`).

    Collective on the problem's communicator.

    Parameters
    ----------
    problem
        At a configuration.
    modes
        Modes there.
    loads
        In body frames, local rows, shape (n_local, n_loads).

    Returns
    -------
    ndarray, shape (n_local, n_static)
        M-orthonormal, and M-orthogonal to `modes`.

    Raises
    ------
    RunError
        If an answer vanishes beside the others: the basis would not be continuous there.
    """
    basis, dependent = _with_answers(problem, modes.eigenvectors, loads)
    if dependent.any():
        raise RunError(
            f"reduction.static_modes at {problem.kinematics.describe(modes.theta)}: a load's static "
            "answer is a combination of the modes and the other answers; take fewer modes, or no static ones "
            "(reduction.static_modes, reduction.spring_modes)"
        )
    return basis[:, modes.eigenvectors.shape[1] :]


def dependent_loads(problem: ModalProblem, modes: ModeSet, loads: np.ndarray) -> np.ndarray:
    """Return whose static answers are combinations of the modes and of the answers before, shape (n_loads,).

    Parameters are those of `static_modes`.
    """
    return _with_answers(problem, modes.eigenvectors, loads)[1]


def _with_answers(problem: ModalProblem, kept: np.ndarray, loads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return vectors extended by orthonormal answers, and which answers depend on those before and are left out."""
    if not len(loads.T):
        return kept, np.zeros(0, dtype=bool)
    answers = problem.static_answers(kept, loads)
    before = problem.norms(answers)
    basis, m_basis, dependent = kept, problem.times_mass(kept), np.zeros(len(loads.T), dtype=bool)
    for number, answer in enumerate(answers.T[..., None]):
        gram = problem.inner(basis, m_basis)
        for _ in range(2):  # twice is enough (Kahan): the second pass removes what round-off left
            answer = answer - basis @ np.linalg.solve(gram, problem.inner(m_basis, answer))
        m_answer = problem.times_mass(answer)
        after = np.sqrt(problem.inner(answer, m_answer)[0, 0])
        dependent[number] = not after > DEPENDENT_TOLERANCE * before[number]
        if not dependent[number]:
            basis, m_basis = np.hstack([basis, answer / after]), np.hstack([m_basis, m_answer / after])
    return basis, dependent
