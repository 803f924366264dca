"""Foreshortening: the displacements of second order of a slender body that bends or twists.

A body that bends becomes shorter. Left to the amplitudes that stretch the body, this would stiffen the bending, and a
model of second order would need these amplitudes with all their inertia and a cubic strain energy that has no lower
bound. Instead the body follows it at once (`stretching = "static"`): amplitudes xi stand for displacements
``Psi (xi + 1/2 xi^T c xi)``, and

    c_ij = -S K^-1 W3[B e_i, B e_j, .],    S = s^2 (3 - 2 s),    s = K^-1 K_s,    B = 1 - S,

with the stiffness K, the part K_s of it that resists stretching, and the third derivative W3 of the strain energy at
rest. S picks of amplitudes what stretches the body, as in the reduced model (`modes.curvature`), and B what bends or
twists it. The energy of third order in bending and stretching, ``1/2 W3[B xi, B xi, S xi]``, is taken away by that: a
straight beam is as long as before. Forces at its ends and inertia forces do work on c, which is what stiffens a
spinning or stretched body. It is ``-W3`` contracted with the body's stretching by these forces.

It is the same for beams, whose W3 follows from strains (`bodies.third_derivative`), and for bodies of cells
(`bodies.large_deformation`). The fields answer forces at frames and inertia forces of rigid motion statically, so that
these do all of their work on c.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Contraction = Callable[[np.ndarray], np.ndarray]


def contraction_of(third: np.ndarray) -> Contraction:
    """Return what makes ``W3[., V e_i, V e_j]``, (n, m, m), of vectors V (n, m), from W3, symmetric, (n, n, n)."""
    return lambda vectors: np.einsum("kab,ai,bj->kij", third, vectors, vectors, optimize=True)


def foreshortening(
    third: Contraction, stiffness: np.ndarray, stretching: np.ndarray, n_followed: int | None = None
) -> np.ndarray:
    """Return c, the amplitudes' second derivatives, shape (n, n, n), 1/m, the amplitude that is moved first.

    Parameters
    ----------
    third
        W3 of the amplitudes times pairs of vectors (see `contraction_of`), N/m2.
    stiffness, stretching
        K, positive definite, and K_s, each of shape (n, n), N/m.
    n_followed
        Amplitudes that are followed, the first ones; c is zero in all others. None for all.
    """
    n = len(stiffness)
    share = np.linalg.solve(stiffness, stretching)
    stretched = share @ share @ (3.0 * np.eye(n) - 2.0 * share)
    bending = (np.eye(n) - stretched)[:, :n_followed]
    m = bending.shape[1]
    forces = third(bending).reshape(n, m * m)
    found = -(stretched @ np.linalg.solve(stiffness, forces)).reshape(n, m, m)
    curvature = np.zeros((n, n, n))
    curvature[:, :m, :m] = 0.5 * (found + found.swapaxes(1, 2))
    return curvature
