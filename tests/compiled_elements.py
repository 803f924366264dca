"""The compiled elements, called with many elements at once as the formulas of tests are written."""

import numpy as np

from pgmp_petsc.bodies.beam2d import N_PACKED, strain_rates, strains, stresses, viscous_stresses, work_of
from pgmp_petsc.bodies.beam2d import fill_tangent as fill_planar_tangent
from pgmp_petsc.bodies.beam2d import forces as planar_forces
from pgmp_petsc.bodies.beam3d import N_ELEMENT, add_force, beam_work, fill_tangent, stretch, viscous_stress
from pgmp_petsc.bodies.elasticity import (
    Cells,
    CellWork,
    Geometry,
    Lame,
    cell_work,
    evaluate_cells,
    n_work,
    strain_energies,
)


def forces(places: np.ndarray, geometry: Geometry, lame: Lame) -> np.ndarray:
    """Return the internal forces of cells with E = 1, shape (n_e, n_a, d)."""
    return _evaluated(places, np.zeros_like(places), geometry, lame, 0.0)[0]


def tangents(places: np.ndarray, geometry: Geometry, lame: Lame) -> np.ndarray:
    """Return their derivatives, shape (n_e, n_a, d, n_a, d)."""
    return _evaluated(places, np.zeros_like(places), geometry, lame, 0.0)[1]


def viscous_forces(places: np.ndarray, rates: np.ndarray, geometry: Geometry, lame: Lame) -> np.ndarray:
    """Return the damping forces for beta = 1."""
    return _evaluated(places, rates, geometry, lame, 1.0)[0] - forces(places, geometry, lame)


def viscous_tangents(places: np.ndarray, geometry: Geometry, lame: Lame) -> np.ndarray:
    """Return their derivatives in the rates."""
    return _evaluated(places, np.zeros_like(places), geometry, lame, 1.0)[1] - tangents(places, geometry, lame)


def strain_energy(places: np.ndarray, geometry: Geometry, lame: Lame) -> np.ndarray:
    """Return the strain energies, shape (n_e,)."""
    constants, work = (lame.first, lame.shear), _work(places)
    return np.array([strain_energies(cell, constants, 1.0, own, work) for cell, own in zip(_cells(geometry), places)])


def _evaluated(
    places: np.ndarray, rates: np.ndarray, geometry: Geometry, lame: Lame, beta: float
) -> tuple[np.ndarray, np.ndarray]:
    n, n_nodes, d = places.shape
    m, work = n_nodes * d, _work(places)
    found, packed = np.empty((n, n_nodes, d)), np.empty((n, m * (m + 1) // 2))
    for cell, own, rate, force, tangent in zip(_cells(geometry), places, rates, found, packed):
        evaluate_cells(
            cell, (lame.first, lame.shear), 1.0, beta, 1.0, own, rate, beta != 0.0, True, work, force, tangent
        )
    return found, _unpacked(packed, m).reshape(n, n_nodes, d, n_nodes, d)


def _work(places: np.ndarray) -> CellWork:
    n_nodes, d = places.shape[1:]
    return cell_work(n_nodes, d, np.empty(n_work(n_nodes, d)))


def _cells(geometry: Geometry) -> list[Cells]:
    gradients = np.ascontiguousarray(geometry.gradients.swapaxes(2, 3))
    return [Cells(*cell) for cell in zip(gradients, geometry.volumes)]


def _unpacked(packed: np.ndarray, m: int) -> np.ndarray:
    """Return symmetric matrices (n, m, m) from their lower triangles (n, m (m + 1) / 2)."""
    matrices = np.empty((len(packed), m, m))
    rows, columns = np.tril_indices(m)
    matrices[:, rows, columns] = matrices[:, columns, rows] = packed
    return matrices


class Beams3d:
    """Beam elements in space with lengths (n,), axes (n, 3, 3) and a section (6,)."""

    def __init__(self, lengths: np.ndarray, axes: np.ndarray, section: np.ndarray) -> None:
        self._elements, self._section = list(zip(lengths, axes)), section

    def forces(self, u: np.ndarray) -> np.ndarray:
        """Return the internal forces for unknowns of shape (n, 24)."""
        found, work = np.zeros(u.shape), beam_work()
        for own, (length, axes), force in zip(u, self._elements, found):
            stretch(own, length, axes, self._section, work)
            add_force(work, work.stress, force)
        return found

    def tangents(self, u: np.ndarray, viscosity: float = 0.0) -> np.ndarray:
        """Return their derivatives, and those of damping forces in the rates, shape (n, 24, 24)."""
        packed, work = np.empty((len(u), N_ELEMENT * (N_ELEMENT + 1) // 2)), beam_work()
        for own, (length, axes), result in zip(u, self._elements, packed):
            stretch(own, length, axes, self._section, work)
            fill_tangent(work, length, viscosity, result)
        return _unpacked(packed, N_ELEMENT)

    def strain_energy(self, u: np.ndarray) -> np.ndarray:
        """Return the strain energies, shape (n,)."""
        work = beam_work()
        return np.array([stretch(own, *element, self._section, work) for own, element in zip(u, self._elements)])

    def viscosity(self, u: np.ndarray) -> np.ndarray:
        """Return what gives the forces of unit viscosity from the rates, shape (n, 24, 24)."""
        return self.tangents(u, 1.0) - self.tangents(u)

    def viscous_forces(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the forces of unit viscosity, shape (n, 24), and the work that they take, shape (n,)."""
        found, powers, work, stress = np.zeros(u.shape), np.zeros(len(u)), beam_work(), np.empty(6)
        for k, (length, axes) in enumerate(self._elements):
            stretch(u[k], length, axes, self._section, work)
            powers[k] = viscous_stress(work, v[k], stress)
            add_force(work, stress, found[k])
        return found, powers


def beam2d(u: np.ndarray, length: float, direction: float, section: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return force (6,) and tangent (6, 6) of a beam element in the plane."""
    cos, sin, strain = _strained(u, length, direction)
    stress, packed = stresses(strain, tuple(section)), np.empty(N_PACKED)
    fill_planar_tangent(strain, stress, tuple(section), cos, sin, length, packed)
    return np.array(planar_forces(strain, stress, cos, sin, length)), _unpacked(packed[None], 6)[0]


def damped_beam2d(
    u: np.ndarray, v: np.ndarray, length: float, direction: float, section: np.ndarray, beta: float, gain_v: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return force (6,), tangent (6, 6) and power of the damping of a beam element in the plane."""
    cos, sin, strain = _strained(u, length, direction)
    rates = strain_rates(tuple(v), strain, cos, sin, length)
    stress, packed = viscous_stresses(rates, tuple(section), beta), np.empty(N_PACKED)
    fill_planar_tangent(strain, (0.0, 0.0, 0.0), tuple(gain_v * beta * section), cos, sin, length, packed)
    force = np.array(planar_forces(strain, stress, cos, sin, length))
    return force, _unpacked(packed[None], 6)[0], -work_of(rates, stress, length)


def _strained(u: np.ndarray, length: float, direction: float) -> tuple[float, float, tuple[float, float, float]]:
    psi = 0.5 * (u[2] + u[5]) + direction
    cos, sin = np.cos(psi), np.sin(psi)
    return cos, sin, strains(tuple(u), cos, sin, length)
