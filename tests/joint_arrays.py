"""All statements of a joint at once: residual and derivatives in two frames of natural coordinates."""

from collections.abc import Sequence

import numpy as np

from pgmp_petsc.declare.ideas import JOINTS
from pgmp_petsc.mechanism.statements import Statement


def joint(kind: str, in_a: np.ndarray, in_b: np.ndarray) -> tuple[Statement, ...]:
    """Return what a joint of some kind holds."""
    JOINTS.found()
    return tuple(JOINTS.classes[kind].model_construct().statements(in_a, in_b))


def residual(joint: Sequence[Statement], a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return c, shape (n_constraints, ...)."""
    return np.array([part.value(a, b) for part in joint])


def jacobian(joint: Sequence[Statement], a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return dc/d(a, b), shape (n_constraints, 2 d (d + 1), ...)."""
    return np.array([part.gradient(a, b) for part in joint])


def lengths(joint: Sequence[Statement]) -> np.ndarray:
    """Return which constraints are measured in m, shape (n_constraints,)."""
    return np.array([part.is_length for part in joint])
