"""The continuum elements of one rank: derivatives, damping, and sums over ranks."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from solid_scenes import solid_meshes, solid_slider_crank

from pgmp_petsc.bodies.matrices import assemble, owned_rows, weighted_sum
from pgmp_petsc.dynamics.body_damping import BodyDampings
from pgmp_petsc.dynamics.rank_solids import RankSolid, rank_solids
from pgmp_petsc.effects import effects_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism

# the crank is braked more than the rod, and the rod's material damps
DAMPING = (
    'effects.crank={type="structural_damping", bodies=["crank"], mass=3.0}',
    'effects.rod={type="structural_damping", bodies=["rod"], mass=0.7, stiffness=2e-5}',
)
GAINS = (1.8e3, 2.5e6, 1.0)


@lru_cache(maxsize=1)
def mechanism() -> Mechanism:
    return Mechanism.from_scene(solid_slider_crank(*DAMPING), solid_meshes("quad8", 10))


@lru_cache(maxsize=1)
def state() -> tuple[np.ndarray, np.ndarray]:
    """Return unknowns of a turned and deformed mechanism, and velocities."""
    meshed, random = mechanism(), np.random.default_rng(1)
    q = meshed.place(RigidKinematics(meshed).poses(np.array([0.9]))[..., 0])
    return q + random.normal(0.0, 1e-4, q.size), random.normal(0.0, 1.0, q.size)


def solids_of(rank: int = 0, size: int = 1) -> list[RankSolid]:
    meshed = mechanism()
    damping = BodyDampings.of(effects_of(meshed.scene, meshed), meshed)
    return list(rank_solids(meshed.bodies, owned_rows(meshed.n_dofs, rank, size), {}, damping))


def total(solids: list[RankSolid], q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the forces of elements on all unknowns."""
    forces = np.zeros(q.size)
    for solid in solids:
        np.add.at(forces, solid.dofs, solid.evaluate(q, v, 0.0).forces)
    return forces


def matrix(solids: list[RankSolid], gains: tuple[float, float, float]) -> np.ndarray:
    """Return the iteration matrix of elements, (n_dofs, n_dofs)."""
    q, v = state()
    result = np.zeros((q.size, q.size))
    for solid in solids:
        entries = solid.matrices(gains, solid.evaluate(q, v, gains[0]).tangents)
        np.add.at(result, (solid.dofs[:, :, None], solid.dofs[:, None, :]), entries)
    return result


def test_the_iteration_matrix_has_the_derivatives_of_forces_and_damping_and_the_mass() -> None:
    """But for what a change of places makes of the damping forces, which is small beside the rest and left out."""
    (q, v), solids = state(), solids_of()
    direction = np.random.default_rng(2).normal(size=q.size)
    still = np.zeros(q.size)
    mass = matrix(solids, (0.0, 1.0, 0.0))
    by_place = matrix(solids, (0.0, 0.0, 1.0)) @ direction
    # cubic in the places: the step's square is 1e-8 of the shortest edge, round-off of the forces over the step
    step = 1e-7
    slope = (total(solids, q + step * direction, still) - total(solids, q - step * direction, still)) / (2 * step)
    np.testing.assert_allclose(by_place, slope, rtol=0, atol=1e-6 * np.abs(slope).max())
    # linear in the rates
    by_rate = (matrix(solids, (1.0, 0.0, 1.0)) - matrix(solids, (0.0, 0.0, 1.0))) @ direction
    change = total(solids, q, v + direction) - total(solids, q, v)
    np.testing.assert_allclose(by_rate, change, rtol=0, atol=1e-9 * np.abs(change).max())
    expected = GAINS[0] * by_rate + GAINS[1] * mass @ direction + GAINS[2] * by_place
    np.testing.assert_allclose(matrix(solids, GAINS) @ direction, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    meshed = mechanism()
    assembled = weighted_sum(assemble(meshed.bodies, range(meshed.n_dofs)).mass, {}).toarray()
    np.testing.assert_allclose(mass, assembled, rtol=0, atol=1e-15 * np.abs(assembled).max())


def test_powers_are_those_of_the_damping_forces() -> None:
    (q, v), solids = state(), solids_of()
    for solid in solids:
        now = solid.evaluate(q, v, 0.0)
        braking = now.forces - solid.evaluate(q, np.zeros(q.size), 0.0).forces
        np.testing.assert_allclose(now.powers, -np.sum(braking * v[solid.dofs], axis=1), rtol=1e-6)
        assert solid.damped
        assert now.powers.max() < 0.0


def test_the_strain_energy_gives_the_forces() -> None:
    (q, _), solids = state(), solids_of()
    direction, step = np.random.default_rng(3).normal(size=q.size), 1e-7
    ahead, behind = (sum(solid.strain_energy(q + s * direction) for solid in solids) for s in (step, -step))
    expected = total(solids, q, np.zeros(q.size)) @ direction
    assert (ahead - behind) / (2 * step) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("size", [2, 3, 7])
def test_ranks_together_have_every_element_once_and_every_row_complete(size: int) -> None:
    (q, v), alone = state(), solids_of()
    forces, whole = total(alone, q, v), matrix(alone, GAINS)
    energy, n_owned = 0.0, 0
    for rank in range(size):
        own, solids = owned_rows(q.size, rank, size), solids_of(rank, size)
        rows = slice(own.start, own.stop)
        # sums in another order
        np.testing.assert_allclose(total(solids, q, v)[rows], forces[rows], rtol=0, atol=1e-12 * np.abs(forces).max())
        np.testing.assert_allclose(matrix(solids, GAINS)[rows], whole[rows], rtol=0, atol=1e-12 * np.abs(whole).max())
        energy += sum(solid.strain_energy(q) for solid in solids)
        n_owned += sum(int(solid.owned.sum()) for solid in solids)
    assert n_owned == sum(body.meshed.solid.mesh.n_cells for body in mechanism().bodies)
    assert energy == pytest.approx(sum(solid.strain_energy(q) for solid in alone), rel=1e-12)
