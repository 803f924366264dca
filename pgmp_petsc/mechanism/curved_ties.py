"""What ties of frames to floating bodies have of second order in the deformation: ``-1/2 sum_k d_k xi^T a_k xi``.

A frame of a body that follows its foreshortening (`components.foreshortening`) is displaced by ``A xi + 1/2 xi^T a xi``
in the floating frame. These are products ``f d x y`` of a component of a director and two amplitudes, in rows that
`FrameTies` has; in the plane ``d d_k / d phi = J d_k``, with J a right angle's rotation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

PHI = 2  # a frame's rotation in the plane


class Quadratics(NamedTuple):
    """Products ``f d x y``.

    Attributes
    ----------
    rows
        Of each product, shape (n,).
    frames
        First unknown of its frame.
    directors
        Number of its component of a director among the frame's d d.
    first, second
        The unknowns x and y, the same or not.
    factors
        f.
    """

    rows: np.ndarray
    frames: np.ndarray
    directors: np.ndarray
    first: np.ndarray
    second: np.ndarray
    factors: np.ndarray

    @classmethod
    def of(
        cls, first_row: int, frame: int, amplitudes: np.ndarray, bent: np.ndarray, least: float = 1e-8
    ) -> Quadratics:
        """Return those of one frame.

        Parameters
        ----------
        first_row
            The row of the tie's first component.
        frame, amplitudes
            The first unknown of the floating frame, and the unknowns xi, shape (n,).
        bent
            ``a``, shape (d, n, n), 1/m.
        least
            Of the largest entry, below which there is none: symmetric meshes leave round-off there.
        """
        d, n = len(bent), amplitudes.size
        i, j = np.tril_indices(n)
        of_pairs = np.where(i == j, 0.5, 1.0) * bent[:, i, j]
        k, pair = np.nonzero(np.abs(of_pairs) > least * np.max(np.abs(of_pairs), initial=0.0))
        component = np.repeat(np.arange(d), k.size)
        k, pair = np.tile(k, d), np.tile(pair, d)
        return cls(
            first_row + component, np.full(k.size, frame), d * k + component, amplitudes[i[pair]],
            amplitudes[j[pair]], -of_pairs[k, pair],
        )  # fmt: skip


class CurvedTies:
    """The products of all frames, to be added to `FrameTies`.

    Parameters
    ----------
    parts
        Of each frame.
    dimension
        2 or 3.
    n_rows
        Number of rows of all ties.

    Attributes
    ----------
    products
        All of them.
    turning
        The unknown of its frame that every product depends on, shape (n_products,).
    jacobian_pattern, curvature_pattern
        Rows and unknowns of the first derivatives, pairs of unknowns of the second ones; entries may repeat.
    """

    def __init__(self, parts: list[Quadratics], dimension: int, n_rows: int) -> None:
        none = np.zeros(0, dtype=np.int64)
        parts = [Quadratics(*(none,) * 5, np.zeros(0)), *parts]
        p = self.products = Quadratics(*(np.concatenate(column) for column in zip(*parts)))
        self._d, self._n_rows = dimension, n_rows
        turning = self.turning = p.frames + (PHI if dimension == 2 else dimension + p.directors)
        self.jacobian_pattern = np.tile(p.rows, 3), np.concatenate([p.first, p.second, turning])
        pairs = [(p.first, p.second), (turning, p.first), (turning, p.second)]
        pairs += [(turning, turning)] if dimension == 2 else []
        one, other = (np.concatenate(column) for column in zip(*pairs))
        self.curvature_pattern = np.maximum(one, other), np.minimum(one, other)

    def values(self, q: np.ndarray) -> np.ndarray:
        """Return what they add to the ties, shape (n_rows, ...), for unknowns (n_dofs, ...)."""
        if not self.products.rows.size:
            return np.zeros((self._n_rows, *q.shape[1:]))
        along, _, x, y = self._at(q)
        return self._summed(along * x * y, q)

    def jacobian_values(self, q: np.ndarray) -> np.ndarray:
        """Return the first derivatives on `jacobian_pattern`, shape (n_entries, ...)."""
        along, slope, x, y = self._at(q)
        return np.concatenate([along * y, along * x, slope * x * y])

    def curvature_values(self, q: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Return multipliers (n_rows, ...) times second derivatives on `curvature_pattern`."""
        p, (along, slope, x, y) = self.products, self._at(q)
        force = multipliers[p.rows]
        twice = np.where(p.first == p.second, 2.0, 1.0).reshape(-1, *(1,) * (q.ndim - 1))
        parts = [force * along * twice, force * slope * y, force * slope * x]
        parts += [-force * along * x * y] if self._d == 2 else []  # d2 d_k / d phi2 = -d_k
        return np.concatenate(parts)

    def drift(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return what the velocities do to the rates of the ties, shape (n_rows, ...)."""
        if not self.products.rows.size:
            return np.zeros((self._n_rows, *q.shape[1:]))
        p, (along, slope, x, y) = self.products, self._at(q)
        vx, vy, spin = v[p.first], v[p.second], v[self.turning]
        change = 2.0 * along * vx * vy + 2.0 * slope * spin * (vx * y + x * vy)
        if self._d == 2:
            change -= along * spin**2 * x * y
        return self._summed(change, q)

    def _summed(self, values: np.ndarray, q: np.ndarray) -> np.ndarray:
        found = np.zeros((self._n_rows, *q.shape[1:]))
        np.add.at(found, self.products.rows, values)
        return found

    def _at(self, q: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return ``f d``, its derivative with what it turns with, and both amplitudes, each (n_products, ...)."""
        p = self.products
        factors = p.factors.reshape(-1, *(1,) * (q.ndim - 1))
        turned = q[self.turning]
        if self._d == 3:
            along, slope = turned, np.ones_like(turned)
        else:
            parts = np.array([np.cos(turned), np.sin(turned), -np.sin(turned), np.cos(turned)])
            slopes = np.array([-np.sin(turned), np.cos(turned), -np.cos(turned), -np.sin(turned)])
            number = np.arange(p.directors.size)
            along, slope = parts[p.directors, number], slopes[p.directors, number]
        return factors * along, factors * slope, q[p.first], q[p.second]
