"""Products of matrices with many columns, compiled: a column is the same to the last bit whatever stands beside it.

A sample's stress then depends neither on the batch that it is in nor on the number of ranks; a library's products
choose their order of summation by the number of columns.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.runtime.compiled import njit


def products(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the products of matrices (n, m, k) and (n, k, n_columns), shape (n, m, n_columns)."""
    result = np.zeros((*left.shape[:2], right.shape[2]))
    _add_products(np.ascontiguousarray(left), np.ascontiguousarray(right), result)
    return result


@njit(cache=True, error_model="numpy")
def _add_products(left, right, result):
    """Add all products; terms are added in the order of the rows of the right matrices."""
    n, m, n_terms = left.shape
    for e in range(n):
        for i in range(m):
            for term in range(n_terms):
                factor = left[e, i, term]
                for column in range(right.shape[2]):
                    result[e, i, column] += factor * right[e, term, column]
