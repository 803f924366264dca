"""The equations of solids, whole and in shares of ranks: derivatives, damping, and sums over ranks."""

from functools import lru_cache

import numpy as np
import pytest
from equations import evaluated
from solid_scenes import solid_meshes, solid_slider_crank

from pgmp_petsc.bodies.matrices import AffineMatrices, weighted_sum
from pgmp_petsc.effects import effects_of
from pgmp_petsc.full.energy import EnergyNames, energies_of
from pgmp_petsc.full.part_reference import Reference
from pgmp_petsc.full.problem import FullEquations, Sources
from pgmp_petsc.lanes.lane_items import SampleBlocks
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism, Unknowns

# the crank is braked more than the rod, and the rod's material damps
DAMPING = (
    'effects.crank={type="structural_damping", bodies=["crank"], mass=3.0}',
    'effects.rod={type="structural_damping", bodies=["rod"], mass=0.7, stiffness=2e-5}',
)
GAINS = (1.8e3, 2.5e6, 1.0)


@lru_cache(maxsize=1)
def kinematics() -> RigidKinematics:
    return RigidKinematics(Mechanism.from_scene(solid_slider_crank(*DAMPING), solid_meshes("quad8", 10)))


@lru_cache(maxsize=1)
def state() -> tuple[np.ndarray, np.ndarray]:
    """Return unknowns of a turned and deformed mechanism, and velocities."""
    random = np.random.default_rng(1)
    q = Unknowns(kinematics().mechanism).place(kinematics().poses(np.array([0.9])))[:, 0]
    return q + random.normal(0.0, 1e-4, q.size), random.normal(0.0, 1.0, q.size)


@lru_cache(maxsize=None)
def share(rank: int = 0, size: int = 1) -> FullEquations:
    mechanism = kinematics().mechanism
    effects = effects_of(mechanism.scene, mechanism)
    damping = [effect for effect in effects if effect.name in ("crank", "rod")]
    owned = Unknowns(mechanism).share(rank, size)
    return FullEquations(kinematics(), damping, {}, SampleBlocks(1, 1, 1), (np.zeros(1), np.zeros(1)), owned)


def total(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    return evaluated(share(), q, v, GAINS)[0]


def matrix(gains: tuple[float, float, float]) -> np.ndarray:
    return evaluated(share(), *state(), gains)[1]


def energies(q: np.ndarray, v: np.ndarray, rank: int = 0, size: int = 1) -> dict[str, float]:
    """Return a rank's part of strain energy, kinetic energy, and powers of damping."""
    equations = share(rank, size)
    here = equations.layout.needed[: equations.layout.n_unknowns]
    n_bound = equations.layout.needed.size - here.size
    table = energies_of(
        Reference(equations.problem), np.zeros(0, dtype=bool), Sources((), (), ()).at(np.zeros(1)),
        np.zeros(1, dtype=np.int64), q[None, here, None], v[None, here, None], np.zeros((1, n_bound, 1)),
        np.zeros((1, 0, 1)),
    )  # fmt: skip
    names = EnergyNames.of(equations, ())
    found = names.energies(table[0])
    powers = {name: float(value[0]) for name, value in found.powers.items()}
    return {"strain": float(found.strain[0]), "kinetic": float(found.kinetic[0]), **powers}


def test_the_iteration_matrix_has_the_derivatives_of_forces_and_damping_and_the_mass() -> None:
    """But for what a change of places makes of the damping forces, which is small beside the rest and left out."""
    q, v = state()
    direction = np.random.default_rng(2).normal(size=q.size)
    still = np.zeros(q.size)
    mass = matrix((0.0, 1.0, 0.0))
    by_place = matrix((0.0, 0.0, 1.0)) @ direction
    # cubic in the places: the step's square is 1e-8 of the shortest edge, round-off of the forces over the step
    step = 1e-7
    slope = (total(q + step * direction, still) - total(q - step * direction, still)) / (2 * step)
    np.testing.assert_allclose(by_place, slope, rtol=0, atol=1e-6 * np.abs(slope).max())
    # linear in the rates
    by_rate = (matrix((1.0, 0.0, 1.0)) - matrix((0.0, 0.0, 1.0))) @ direction
    change = total(q, v + direction) - total(q, v)
    np.testing.assert_allclose(by_rate, change, rtol=0, atol=1e-9 * np.abs(change).max())
    expected = GAINS[0] * by_rate + GAINS[1] * mass @ direction + GAINS[2] * by_place
    np.testing.assert_allclose(matrix(GAINS) @ direction, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    mechanism = kinematics().mechanism
    assembled = weighted_sum(AffineMatrices(mechanism.bodies, range(mechanism.n_dofs)).mass, {}).toarray()
    np.testing.assert_allclose(mass, assembled, rtol=0, atol=1e-15 * np.abs(assembled).max())


def test_powers_are_those_of_the_damping_forces() -> None:
    q, v = state()
    braking = total(q, v) - total(q, np.zeros(q.size))
    found = energies(q, v)
    assert found["crank"] < 0.0 and found["rod"] < 0.0
    assert found["crank"] + found["rod"] == pytest.approx(-float(braking @ v), rel=1e-6)


def test_the_energies_give_the_forces_and_the_momenta() -> None:
    (q, v), still = state(), np.zeros_like(state()[0])
    direction, step = np.random.default_rng(3).normal(size=q.size), 1e-7
    ahead, behind = (energies(q + s * direction, still)["strain"] for s in (step, -step))
    assert (ahead - behind) / (2 * step) == pytest.approx(total(q, still) @ direction, rel=1e-5)
    assert energies(q, v)["kinetic"] == pytest.approx(0.5 * v @ matrix((0.0, 1.0, 0.0)) @ v, rel=1e-12)


@pytest.mark.parametrize("size", [2, 3, 7])
def test_ranks_together_have_every_element_once_and_every_row_complete(size: int) -> None:
    (q, v), names = state(), ("strain", "kinetic", "crank", "rod")
    forces, whole = evaluated(share(), q, v, GAINS)
    alone, summed, n_cells = energies(q, v), dict.fromkeys(names, 0.0), []
    for rank in range(size):
        rows = slice(share(rank, size).rows.start, share(rank, size).rows.stop)
        own, own_matrix = evaluated(share(rank, size), q, v, GAINS)
        # sums in another order
        np.testing.assert_allclose(own, forces[rows], rtol=0, atol=1e-12 * np.abs(forces).max())
        np.testing.assert_allclose(own_matrix, whole[rows], rtol=0, atol=1e-12 * np.abs(whole).max())
        part = energies(q, v, rank, size)
        summed = {name: summed[name] + part[name] for name in names}
        n_cells.append(share(rank, size).problem.solids.region.size)
    for name in names:
        assert summed[name] == pytest.approx(alone[name], rel=1e-12)
    all_cells = sum(body.size[1] for body in kinematics().mechanism.bodies)
    # a rank has its own cells and a layer of its neighbours', and no others
    assert sum(n_cells) < all_cells * (1.0 + 0.3 * size) and max(n_cells) < all_cells


def test_every_multiplier_belongs_to_one_rank() -> None:
    owned = np.concatenate([share(rank, 3).chosen[share(rank, 3).owned_constraints] for rank in range(3)])
    np.testing.assert_array_equal(np.sort(owned), np.arange(share().constraints.n_constraints))
