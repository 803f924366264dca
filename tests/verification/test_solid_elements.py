"""Continuum elements against closed forms: patches, observed order, and the bending frequency of a beam."""

from dataclasses import replace

import compiled_elements
import numpy as np
import pytest
import scipy.sparse as sp
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.sparse.linalg import eigsh, spsolve
from solids import body_of, matrices_of, mesh_of, rule_of, straightened

from pgmp_petsc.bodies import elasticity
from pgmp_petsc.bodies.elasticity import Geometry, Lame
from pgmp_petsc.mesh import SolidMesh
from pgmp_petsc.mesh.meshes import PLANE_KINDS, SOLID_KINDS, reference_element
from pgmp_petsc.mesh.solid_mesh_reading import check_cells

KINDS = (*PLANE_KINDS, *SOLID_KINDS)
QUADRATIC = ("triangle6", "quad8", "quad9", "tetra10", "hexahedron20", "hexahedron27")
# A patch of curved cells needs quadrature that is exact for cofactors of the Jacobian times gradients. In a curved
# tetra10 these are of the third degree, but its rule of the stiffness is of the second: it passes with flat faces only.
PATCHES = [(kind, False) for kind in KINDS] + [(kind, True) for kind in QUADRATIC if kind != "tetra10"]
E, NU = 3.0, 0.3


def on_boundary(mesh: SolidMesh) -> np.ndarray:
    """Return which nodes of a box are on one of its sides, shape (n_nodes,)."""
    held = np.zeros(mesh.n_nodes, dtype=bool)
    for faces in mesh.groups.values():
        held[faces] = True
    return held


def patch(kind: str, curved: bool) -> SolidMesh:
    """Return an irregular mesh of the unit square or cube: straight edges, or every node inside moved by itself."""
    mesh = mesh_of(kind, (3, 3, 3), (1.0, 1.0, 1.0))
    moves = np.random.default_rng(1).uniform(-1.0, 1.0, mesh.nodes.shape)
    moves[on_boundary(mesh)] = 0.0
    moved = straightened(replace(mesh, nodes=mesh.nodes + 0.06 * moves))
    if curved:
        moved = replace(moved, nodes=moved.nodes + 0.015 * moves)
    check_cells(kind, moved.nodes, moved.cells, "patch")
    return moved


def hooke(strain: np.ndarray) -> np.ndarray:
    """Return the stress of strains (..., d, d): in the plane that of plane stress."""
    d = strain.shape[-1]
    trace = np.trace(strain, axis1=-2, axis2=-1)[..., None, None] * np.eye(d)
    return E / (1 + NU) * (strain + NU / (1 - NU if d == 2 else 1 - 2 * NU) * trace)


@pytest.mark.parametrize(("kind", "curved"), PATCHES)
def test_a_patch_keeps_a_uniform_stress(kind: str, curved: bool) -> None:
    mesh = patch(kind, curved)
    d, held = mesh.dimension, np.repeat(on_boundary(mesh), mesh.dimension)
    gradient = np.random.default_rng(2).normal(size=(d, d))
    expected = (mesh.nodes @ gradient.T + 0.4).ravel()
    stiffness, _ = matrices_of(body_of(mesh, E, nu=NU))
    u = np.where(held, expected, 0.0)
    assert np.count_nonzero(~held) >= 4 * d
    u[~held] = spsolve(stiffness[~held][:, ~held].tocsc(), -(stiffness[~held] @ u))
    # round-off times the condition of a few hundred unknowns
    np.testing.assert_allclose(u, expected, rtol=0, atol=1e-12)
    geometry = Geometry.of(mesh.nodes[mesh.cells], reference_element(kind).stiffness)
    slopes = np.einsum("eai,eqja->eqij", u.reshape(-1, d)[mesh.cells], geometry.gradients)
    lame = Lame.of(NU, d == 2)
    strain = 0.5 * (slopes + slopes.swapaxes(2, 3))
    trace = np.trace(strain, axis1=2, axis2=3)[..., None, None]
    stress = E * (lame.first * trace * np.eye(d) + 2 * lame.shear * strain)
    uniform = hooke(0.5 * (gradient + gradient.T))
    np.testing.assert_allclose(stress, np.broadcast_to(uniform, stress.shape), rtol=0, atol=1e-11)
    # the energy of two linear fields in a unit volume
    other = np.random.default_rng(3).normal(size=(d, d))
    energy = (mesh.nodes @ other.T).ravel() @ (stiffness @ u)
    assert energy == pytest.approx(np.sum(other * uniform), rel=1e-12)


@pytest.mark.parametrize(("kind", "curved"), PATCHES)
def test_a_patch_is_in_equilibrium_after_a_large_uniform_deformation(kind: str, curved: bool) -> None:
    mesh = patch(kind, curved)
    d = mesh.dimension
    stretch = np.eye(d) + np.random.default_rng(4).normal(0.0, 0.4, (d, d))
    geometry = Geometry.of(mesh.nodes[mesh.cells], reference_element(kind).stiffness)
    found = compiled_elements.forces((mesh.nodes @ stretch.T)[mesh.cells], geometry, Lame.of(NU, d == 2))
    forces = np.zeros_like(mesh.nodes)
    np.add.at(forces, mesh.cells, found)
    np.testing.assert_allclose(forces[~on_boundary(mesh)], 0.0, rtol=0, atol=1e-13)
    assert np.abs(forces[on_boundary(mesh)]).max() > 1e-2


class PlaneWaves:
    """Displacements ``u_i = sin(k_i x + i)``, and the body force that holds them, in an elastic body with E = 1."""

    def __init__(self, d: int) -> None:
        self._k = np.array([[1.1, 1.7, -0.9], [-1.4, 0.8, 1.2], [0.7, -1.3, 1.5]])[:d, :d]
        self._lame = Lame.of(NU, d == 2)

    def at(self, places: np.ndarray) -> np.ndarray:
        """Return displacements at places (..., d)."""
        return np.sin(places @ self._k.T + np.arange(len(self._k)))

    def force(self, places: np.ndarray) -> np.ndarray:
        """Return ``-div sigma`` at places (..., d): ``-(lambda + mu) grad div u - mu laplace u``."""
        first, shear, k = self._lame.first, self._lame.shear, self._k
        matrix = (first + shear) * (k * np.diag(k)[:, None]).T + shear * np.diag(np.sum(k**2, axis=1))
        return self.at(places) @ matrix.T


def wavy(mesh: SolidMesh) -> SolidMesh:
    """Return a mesh of the unit square or cube with its inside moved smoothly, so that cells are crooked and curved."""
    bump = np.prod(np.sin(np.pi * mesh.nodes), axis=1)
    return replace(mesh, nodes=mesh.nodes + 0.08 * bump[:, None] * np.array([1.0, -0.7, 0.5])[: mesh.dimension])


def conjugate_gradients(matrix: sp.csr_matrix, right: np.ndarray) -> np.ndarray:
    """Solve to 1e-9 of the right side, scaled with the diagonal: in space faster than by factors."""
    scale = 1.0 / matrix.diagonal()
    x, residual = np.zeros_like(right), right.copy()
    direction = scale * residual
    square = residual @ direction
    for _ in range(2000):
        product = matrix @ direction
        step = square / (direction @ product)
        x += step * direction
        residual -= step * product
        if np.linalg.norm(residual) < 1e-9 * np.linalg.norm(right):
            return x
        scaled = scale * residual
        square, before = residual @ scaled, square
        direction = scaled + square / before * direction
    pytest.fail("conjugate gradients do not converge")


def l2_error(kind: str, n: int) -> float:
    """Return the error of the displacements in a unit square or cube with n cells along each side."""
    mesh = wavy(mesh_of(kind, (n, n, n), (1.0, 1.0, 1.0)))
    d, waves, held = mesh.dimension, PlaneWaves(mesh.dimension), np.repeat(on_boundary(mesh), mesh.dimension)
    stiffness, _ = matrices_of(body_of(mesh, nu=NU))
    # more points than the element has: its own are where interpolation errors are smallest
    rule = rule_of(kind, 6)
    places = mesh.nodes[mesh.cells]
    volumes = elasticity.volumes_of(places, rule)
    points = rule.values @ places
    load = np.zeros_like(mesh.nodes)
    np.add.at(load, mesh.cells, np.einsum("eq,qa,eqi->eai", volumes, rule.values, waves.force(points), optimize=True))
    u = np.where(held, waves.at(mesh.nodes).ravel(), 0.0)
    right, inner = (load.ravel() - stiffness @ u)[~held], stiffness[~held][:, ~held]
    u[~held] = conjugate_gradients(inner, right)
    errors = rule.values @ u.reshape(-1, d)[mesh.cells] - waves.at(points)
    return float(np.sqrt(np.einsum("eq,eqi->", volumes, errors**2)))


@pytest.mark.parametrize("kind", KINDS)
def test_the_observed_order_against_a_manufactured_solution(kind: str) -> None:
    order = 3 if kind in QUADRATIC else 2
    counts = (4, 8, 16) if order == 2 else (2, 4, 8)
    errors = np.array([l2_error(kind, n) for n in counts])
    # the L2 error of a smooth solution falls with one order more than the degree; the rest is the coarse meshes' own
    orders = np.log2(errors[:-1] / errors[1:])
    assert orders[-1] == pytest.approx(order, abs=0.05)
    assert orders[0] > order - 0.15


def timoshenko_frequency(length: float, height: float, shear_factor: float) -> float:
    """Return the first bending frequency (rad/s) of a free beam of unit width, E = rho = 1, by its transfer matrix.

    ``w' = psi + Q / (k G A), psi' = M / (E I), M' = -Q - rho I omega^2 psi, Q' = -rho A omega^2 w``, M and Q being 0
    at the ends.
    """
    area, inertia = height, height**3 / 12
    shear = shear_factor * area / (2 * (1 + NU))

    def ends(omega: float) -> float:
        matrix = np.zeros((4, 4))  # of w, psi, M, Q
        matrix[0, 1], matrix[0, 3], matrix[1, 2] = 1.0, 1.0 / shear, 1.0 / inertia
        matrix[2, 1], matrix[2, 3], matrix[3, 0] = -inertia * omega**2, -1.0, -area * omega**2
        return float(np.linalg.det(expm(matrix * length)[2:, :2]))

    slender = 4.730041**2 / length**2 * np.sqrt(inertia / area)  # Euler and Bernoulli, above it
    return brentq(ends, 0.9 * slender, slender, xtol=1e-14)


def beam_frequency(kind: str, n: int, length: float, height: float) -> float:
    """Return the first elastic eigenfrequency (rad/s) of a free bar with n by n / 8 cells."""
    mesh = mesh_of(kind, (n, n // 8, 1), (length, height, 0.08))
    stiffness, mass = matrices_of(body_of(mesh, nu=NU))
    n_rigid = mesh.dimension * (mesh.dimension + 1) // 2
    values = eigsh(stiffness, n_rigid + 1, mass, sigma=-0.01, return_eigenvectors=False)
    return float(np.sqrt(values.max()))


@pytest.mark.parametrize("kind", QUADRATIC)
def test_the_first_bending_frequency_of_a_free_beam(kind: str) -> None:
    """Against Timoshenko's beam with the shear factor of plane stress, 5 (1 + nu) / (6 + 5 nu)."""
    length, height = 1.0, 0.05
    expected = timoshenko_frequency(length, height, 5 * (1 + NU) / (6 + 5 * NU))
    errors = np.array([beam_frequency(kind, n, length, height) for n in (16, 32)]) / expected - 1.0
    if kind in PLANE_KINDS:
        # finer meshes come within 2e-6 of the beam; eigenvalues converge with twice the order of the strains
        assert np.log2(errors[0] / errors[1]) > 3.5
        assert 0.0 < errors[1] < 6e-5
    else:
        # a bar in space bends across as well, which the beam does not know: finer meshes stay 1.5e-4 above it
        assert 0.0 < errors[1] < errors[0] / 2
        assert errors[1] < 3.5e-4
