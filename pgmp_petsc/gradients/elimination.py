"""Small systems of linear equations; compiled."""

from __future__ import annotations

from pgmp_petsc.runtime.compiled import njit


@njit(error_model="numpy", counted=False)
def hold(prescribed, matrix, right):
    """Make the first rows of a system those of the identity where a coordinate is prescribed, shape (n_theta,)."""
    for k in range(prescribed.size):
        if prescribed[k]:
            matrix[k, :] = 0.0
            matrix[k, k] = 1.0
            right[k] = 0.0


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def factorise(matrix, order):
    """Factorise a matrix (n, n) in place by Gaussian elimination, pivots in the rows `order` (n,)."""
    n = matrix.shape[0]
    for k in range(n):
        largest = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[largest, k]):
                largest = i
        order[k] = largest
        if largest != k:
            for j in range(n):
                matrix[k, j], matrix[largest, j] = matrix[largest, j], matrix[k, j]
        for i in range(k + 1, n):
            matrix[i, k] /= matrix[k, k]
            for j in range(k + 1, n):
                matrix[i, j] -= matrix[i, k] * matrix[k, j]


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def substitute(matrix, order, right):
    """Solve with the factors of `factorise`, in place."""
    n = right.size
    for k in range(n):
        right[k], right[order[k]] = right[order[k]], right[k]
    for i in range(n):
        for j in range(i):
            right[i] -= matrix[i, j] * right[j]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            right[i] -= matrix[i, j] * right[j]
        right[i] /= matrix[i, i]


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def solve_lanes(matrix, right):
    """Solve systems of LANES states at once in place, items (n, n) and (n,); the matrices are lost.

    Without pivots, the last unknown first: so the flexible coordinates come before those of theta, an order in which
    the engine's iteration matrices have positive pivots.
    """
    n = right.size
    for k in range(n - 1, 0, -1):
        inverse = 1.0 / matrix[k, k]
        for i in range(k):
            factor = matrix[i, k] * inverse
            right[i] -= factor * right[k]
            for j in range(k):
                matrix[i, j] -= factor * matrix[k, j]
    for k in range(n):
        total = right[k]
        for j in range(k):
            total -= matrix[k, j] * right[j]
        right[k] = total / matrix[k, k]
