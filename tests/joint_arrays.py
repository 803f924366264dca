"""All statements of a joint at once: residual and derivatives in two frames of natural coordinates."""

from __future__ import annotations

import numpy as np

from pgmp_petsc.mechanism.joints import Joint


def residual(joint: Joint, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return c, shape (n_constraints, ...)."""
    return np.array([part.value(a, b) for part in joint.statements])


def jacobian(joint: Joint, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return dc/d(a, b), shape (n_constraints, 2 d (d + 1), ...)."""
    return np.array([part.gradient(a, b) for part in joint.statements])


def hessian(joint: Joint, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the second derivatives, shape (n_constraints, 2 d (d + 1), 2 d (d + 1), ...)."""
    return np.array([part.hessian(a, b) for part in joint.statements])


def lengths(joint: Joint) -> np.ndarray:
    """Return which constraints are measured in m, shape (n_constraints,)."""
    return np.array([part.is_length for part in joint.statements])
