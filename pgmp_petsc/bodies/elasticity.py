"""Continuum elements with the positions of their nodes as unknowns: St. Venant-Kirchhoff strain energy, constant mass.

    W = int  lambda/2 (tr E)^2 + mu E:E  dV,    E = (F^T F - 1) / 2,    F = dx/dX

in the reference volume V. In plane stress the normal stress across the plane vanishes; the same energy with
``lambda* = 2 lambda mu / (lambda + 2 mu)`` then holds for E in the plane. All functions take many elements at once, for
a Young's modulus, a density and a thickness of 1: these are factors (`Quantity`), taken out as weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgmp_petsc.mesh.solid_mesh import Quadrature


@dataclass(frozen=True)
class Lame:
    """Lame's constants over Young's modulus."""

    first: float
    shear: float

    @classmethod
    def of(cls, nu: float, plane_stress: bool) -> Lame:
        """Return the constants for Poisson's ratio nu."""
        if plane_stress:
            return cls(nu / (1.0 - nu**2), 0.5 / (1.0 + nu))
        return cls(nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), 0.5 / (1.0 + nu))


@dataclass(frozen=True, eq=False)
class Geometry:
    """Elements at their quadrature points."""

    gradients: np.ndarray  # ``dN_a/dX_j``, shape (n_e, n_q, d, n_a), 1/m
    volumes: np.ndarray  # determinant of the Jacobian times weight, shape (n_e, n_q), m^d

    @classmethod
    def of(cls, places: np.ndarray, quadrature: Quadrature) -> Geometry:
        """Map elements whose nodes are at places (n_e, n_a, d), m."""
        jacobians = np.einsum("qja,eai->eqij", quadrature.gradients, places, optimize=True)
        # dX_i/dxi_j; its inverse turns reference gradients into those in X
        inverse, determinants = np.linalg.inv(jacobians), np.linalg.det(jacobians)
        return cls(
            np.einsum("eqji,qja->eqia", inverse, quadrature.gradients, optimize=True), determinants * quadrature.weights
        )


def volumes_of(places: np.ndarray, quadrature: Quadrature) -> np.ndarray:
    """Return ``Geometry.volumes`` alone, shape (n_e, n_q)."""
    jacobians = np.einsum("qja,eai->eqij", quadrature.gradients, places, optimize=True)
    return np.linalg.det(jacobians) * quadrature.weights


def stiffness(geometry: Geometry, lame: Lame, pairs: np.ndarray | None = None) -> np.ndarray:
    """Return tangents at rest, shape (n_e, n_a, d, n_b, d): ``d2W / dx_ai dx_bj``.

    With `pairs`, shape (d, d), only what pairs ``dN_a/dX_k dN_b/dX_l`` of derivatives give for which ``pairs[k, l]`` is
    true (`SectionScale`).
    """
    g, volumes = geometry.gradients, geometry.volumes
    n_e, n_q, d, n_a = g.shape
    # one product over quadrature points and no larger arrays: (n_e, d n_a, d n_a)
    weighted = (g * volumes[:, :, None, None]).reshape(n_e, n_q, d * n_a)
    outer = np.matmul(weighted.transpose(0, 2, 1), g.reshape(n_e, n_q, d * n_a)).reshape(n_e, d, n_a, d, n_a)
    if pairs is not None:
        outer *= pairs[:, None, :, None]
    result = lame.first * outer.transpose(0, 2, 1, 4, 3)  # G_ai G_bj
    result += lame.shear * outer.transpose(0, 2, 3, 4, 1)  # G_aj G_bi
    dot = lame.shear * np.einsum("eiaib->eab", outer)
    for i in range(d):
        result[:, :, i, :, i] += dot
    return result


def mass(volumes: np.ndarray, quadrature: Quadrature) -> np.ndarray:
    """Return ``int N_a N_b dV``, shape (n_e, n_a, n_b): the same for every direction."""
    return np.einsum("eq,qa,qb->eab", volumes, quadrature.values, quadrature.values, optimize=True)
