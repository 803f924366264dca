"""Equal, nearly equal, crossing and veering frequencies."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import mechanisms
import numpy as np
import pytest
import scipy.linalg
from pencils import modal_problem
from runs import ONE_RANK, assert_close, history, rom_of, samples
from scrambling import clusters, turned

from pgmp_petsc.bodies.matrices import AffineMatrices, weighted_sum
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.modes.problem import ModeSet
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene
from scenes import RADIUS, kinematics_of, slider_crank

# Where the 2nd and the 3rd flexible frequency of the slider-crank meet: a point in the plane of r1 and theta, found by
# minimising their gap; the gap is 1e-10 there and opens linearly all around.
MEETING_R1, MEETING_THETA = 0.83277688 * RADIUS, 1.58734249
DIFFERENCES = (0.0, 1e-9, 1e-6)  # of the blades' lengths
APART = 1e-4  # eigenvalues of one cluster agree to this share


def build(
    scene: Scene, length: float = 0.25, differ: float = 0.0, scramble: Callable[[ModeSet], ModeSet] = lambda m: m
) -> ReducedOrderModel:
    return build_rom(scene, mechanisms.flywheel_meshes(scene, length, differ), ONE_RANK, scramble)


@lru_cache(maxsize=3)
def plain(differ: float) -> ReducedOrderModel:
    return build(mechanisms.with_flywheel(), differ=differ)


def mass_of(rom: ReducedOrderModel, scene: Scene) -> object:
    """Return the sparse mass matrix in body frames at the nominal parameters."""
    mechanism = Mechanism.from_scene(scene, rom.meshes)
    return weighted_sum(AffineMatrices(mechanism.bodies, range(mechanism.n_dofs)).mass, scene.nominal)


def largest_jump(rom: ReducedOrderModel, scene: Scene) -> float:
    """Return the largest change of a basis vector from one sampled angle to the next, in the mass norm (each is 1)."""
    mass, jump = mass_of(rom, scene), np.diff(rom.projection, axis=0)
    return max(float(np.sqrt(np.max(np.sum(step * (mass @ step), axis=0)))) for step in jump)


@pytest.mark.parametrize("differ", DIFFERENCES)
def test_the_pairs_of_equal_blades_are_found_at_all_angles(differ: float) -> None:
    scene = mechanisms.with_flywheel()
    kinematics = RigidKinematics(Mechanism.from_scene(scene, mechanisms.flywheel_meshes(scene, differ=differ)))
    with modal_problem(kinematics, scene.nominal, 9) as problem:
        for theta in (0.0, 0.8, np.pi / 2, 2.4, np.pi):
            found = problem.solve(theta).eigenvalues
            exact = mechanisms.dense_eigenvalues(kinematics, theta, scene.nominal, 9)
            np.testing.assert_allclose(found, exact, rtol=1e-9)
            pairs = [c for c in clusters(found, APART) if c.size == 2]
            assert len(pairs) == 2
            for low, high in pairs:
                # lambda goes with length^-4: three lengths L, L (1 + e), L (1 + 2 e) spread it by less than 8 e
                assert found[high] / found[low] - 1 < 8 * differ + 1e-10


@pytest.mark.parametrize("differ", DIFFERENCES)
def test_the_space_of_a_pair_is_the_same_at_all_angles(differ: float) -> None:
    """The pairs move the blades alone, so that their space does not change in the body's frame."""
    scene, rom = mechanisms.with_flywheel(), plain(differ)
    mass = mass_of(rom, scene)
    pairs = [c for c in clusters((2 * np.pi * rom.frequencies_hz[0]) ** 2, APART) if c.size == 2]
    assert len(pairs) == 2
    for pair in pairs:
        first = rom.projection[0][:, pair]
        for basis in rom.projection:
            cosines = scipy.linalg.svdvals(first.T @ (mass @ basis[:, pair]))
            # an eigenvector errs by the solver's tolerance over the gap to the other modes
            np.testing.assert_allclose(cosines, 1.0, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("differ", "seed"), [(0.0, 1), (1e-9, 2)])
def test_rotations_among_equal_modes_do_not_change_the_motion(differ: float, seed: int) -> None:
    scene = mechanisms.with_flywheel(*mechanisms.run_for(0.15, 1e-3))
    spoilt = build(scene, differ=differ, scramble=lambda modes: turned(seed, modes, APART))
    one, other = (history(ReducedModel(scene, rom), samples(scene, 1), 1)[1] for rom in (plain(differ), spoilt))
    # round-off of the tables, 1e-13 or so, over a few hundred steps; measured 2e-12
    assert_close(one, other, angle=1e-8, bent=1e-8, slider=1e-8, blade=1e-8)


def test_blades_that_bend_by_their_weight_do_so_in_both_models() -> None:
    """Gravity turns in the crank's frame and bends the blades against each other: only the pairs can show it."""
    scene = mechanisms.with_flywheel()
    full, reduced = mechanisms.both(scene, rom=plain(0.0))
    assert_close(full, reduced, angle=1e-4, slider=1e-4)
    bent, found = (outputs["blade"] - outputs["angle"] for outputs in (full, reduced))
    assert np.abs(found - bent).max() < 0.1 * np.abs(bent).max()  # measured 5 %: no static modes


def test_a_basis_that_cuts_a_pair_in_two_is_noticed() -> None:
    """8 modes hold half of the second pair, and which half is chance; ``pgmp build`` warns of such a cosine."""

    def cut(modes: ModeSet) -> ModeSet:
        spoilt = turned(1, modes, APART)
        return replace(spoilt, eigenvalues=spoilt.eigenvalues[:8], flexible=spoilt.flexible[:, :8])

    rom = build(mechanisms.with_flywheel(), scramble=cut)
    said = " ".join(remark.text for remark in rom.record.remarks)
    assert rom.cosines.min() < 0.1 and "take one more of reduction.modes, or one less, until" in said
    assert plain(0.0).cosines.min() > 0.9


def test_a_mode_that_crosses_a_pair() -> None:
    """Blades of 0.3 m: their pair at 90.9 Hz is crossed by a mode that runs from 70 to 106 Hz with the angle."""
    jumps = []
    for angles in (48, 96):
        scene = mechanisms.with_flywheel(f"reduction.angles={angles}")
        rom = build(scene, length=0.3)
        jumps.append(largest_jump(rom, scene))
    low, high = rom.frequencies_hz[:, 1:4].min(axis=0), rom.frequencies_hz[:, 1:4].max(axis=0)
    np.testing.assert_allclose([low[0], high[0], high[2]], [69.9, 90.9, 106.1], rtol=2e-3)
    # a continuous basis changes half as much from sample to sample when these are twice as close
    assert jumps[1] < 0.6 * jumps[0]
    full, reduced = mechanisms.both(scene, rom=rom)
    assert_close(full, reduced, angle=1e-4, bent=0.06, slider=1e-4)  # bent: 4 % without the crossing too


@lru_cache(maxsize=None)
def built_at(r1: float, angles: int = 96) -> ReducedOrderModel:
    return rom_of(mechanisms.accurate(f"parameters.r1.nominal={r1}", angles=angles))


def test_two_modes_of_the_slider_crank_meet() -> None:
    exact = mechanisms.dense_eigenvalues(kinematics_of(slider_crank()), MEETING_THETA, {"r1": MEETING_R1}, 4)
    assert exact[2] / exact[1] - 1 < 1e-8
    assert np.sqrt(exact[1]) / (2 * np.pi) == pytest.approx(229.1129, rel=1e-6)


# at the meeting, beside it (where modes veer within a tenth of the distance of two samples), and far away
@pytest.mark.parametrize("r1", [MEETING_R1, 1.0005 * MEETING_R1, RADIUS], ids=["meeting", "veering", "apart"])
def test_the_reduced_model_where_modes_meet_is_as_good_as_elsewhere(r1: float) -> None:
    moving = (*mechanisms.run_for(0.5, 1e-3), *mechanisms.start(0.5, 4.0))
    scene = mechanisms.accurate(f"parameters.r1.nominal={r1}", *moving)
    rom, kinematics = built_at(r1), kinematics_of(scene)
    assert rom.cosines.min() > 0.9
    # half-way between samples: cubic splines leave 1.7e-4, 1.7e-4 and 1.2e-4, and a 16th of it at 192 angles
    for theta in (MEETING_THETA, *(rom.tables.samples.axes[0].theta[:48:3] + np.pi / 96)):
        exact = mechanisms.dense_eigenvalues(kinematics, theta, scene.nominal, 4)
        np.testing.assert_allclose(mechanisms.interpolated_eigenvalues(rom, scene, theta)[:4], exact, rtol=3e-4)
    full, reduced = mechanisms.both(scene, rom=rom)
    # measured 1.7e-5 to 1.9e-5 and 0.9e-3 to 1.1e-3 at all three
    assert_close(full, reduced, angle=3e-5, bent=2e-3, slider=1e-5)


def test_the_basis_is_continuous_where_modes_meet() -> None:
    scene = mechanisms.accurate(f"parameters.r1.nominal={MEETING_R1}")
    jumps = [largest_jump(rom, scene) for rom in (built_at(MEETING_R1), built_at(MEETING_R1, 192))]
    assert jumps[1] == pytest.approx(0.5 * jumps[0], rel=0.1)


def test_half_as_many_angles_are_enough_for_the_lowest_mode() -> None:
    """It changes slowly with the angle; at the nominal radius 48 angles leave 6e-4."""
    scene, kinematics = mechanisms.accurate(f"parameters.r1.nominal={MEETING_R1}"), kinematics_of(slider_crank())
    rom = built_at(MEETING_R1, 48)
    for theta in rom.tables.samples.axes[0].theta[:24:3] + np.pi / 48:
        exact = mechanisms.dense_eigenvalues(kinematics, theta, scene.nominal, 1)
        np.testing.assert_allclose(mechanisms.interpolated_eigenvalues(rom, scene, theta)[:1], exact, rtol=1e-2)


def test_adaptive_sampling_finds_the_angles_that_close_modes_need() -> None:
    scene = mechanisms.accurate(
        f"parameters.r1.nominal={MEETING_R1}", "reduction.sampling_tolerance=1e-2", *mechanisms.run_for(0.5, 1e-3),
        *mechanisms.start(0.5, 4.0), angles=24,
    )  # fmt: skip
    rom = rom_of(scene)
    assert 48 < rom.tables.samples.n < 192
    assert_close(*mechanisms.both(scene, rom=rom), angle=3e-5, bent=2e-3, slider=1e-5)
