"""Matrices that are singular, badly scaled or nearly too large for double precision."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from elimination import circle
from mechanisms import accurate, both, dense_eigenvalues, run_for, start
from pencils import constraints_at, dense_of, matrices_of, modal_problem
from refusals import refusal
from runs import assert_close, built_rom, full_model, history, samples

from pgmp_petsc.base.errors import RunError
from pgmp_petsc.bodies.sections.section import BeamSection
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.solvers import shift_invert
from scenes import RADIUS, kinematics_of, mechanism_of, slider_crank

VALUES = {"r1": RADIUS}
N_FINITE = 18  # 12 nodes of 2 translations, less 5 constraints and the rigid motion
THETA = 0.7  # nothing is special there


def with_rotary_inertia(share: float) -> RigidKinematics:
    """Return the slider-crank with the given share of its sections' rotary inertia; no scene can say 0."""
    mechanism = mechanism_of(slider_crank())
    bodies = tuple(
        replace(body, section=replace(body.section, mass=(body.section.mass[0], share * body.section.mass[1])))
        for body in mechanism.bodies
    )
    return RigidKinematics(replace(mechanism, bodies=bodies))


def condensed_eigenvalues(kinematics: RigidKinematics, theta: float) -> np.ndarray:
    """Return the finite eigenvalues of the pencil without rotary inertia: rotations are condensed statically."""
    mechanism = kinematics.mechanism
    stiffness, mass = dense_of(mechanism, VALUES)
    constraints = constraints_at(kinematics, theta)
    turns = np.arange(mechanism.n_dofs) % 3 == 2
    assert not constraints[:, turns].any()  # revolute joints and a fixed line hold translations alone
    coupling = stiffness[np.ix_(turns, ~turns)]
    schur = coupling.T @ np.linalg.solve(stiffness[np.ix_(turns, turns)], coupling)
    null = scipy.linalg.null_space(constraints[:, ~turns])
    mass = null.T @ mass[np.ix_(~turns, ~turns)] @ null
    condensed = null.T @ (stiffness[np.ix_(~turns, ~turns)] - schur) @ null
    return 1 / scipy.linalg.eigvalsh(mass, condensed + 1e4 * mass)[::-1][1:] - 1e4


def test_massless_rotations() -> None:
    """The mass matrix is singular: 12 of 31 eigenvalues are infinite, and none of them comes into the basis."""
    kinematics = with_rotary_inertia(0.0)
    exact = condensed_eigenvalues(kinematics, THETA)
    assert exact.size == N_FINITE
    for n_modes in (6, N_FINITE):
        with modal_problem(kinematics, VALUES, n_modes) as problem:
            modes = problem.solve(THETA)
            # measured 1e-11 and 6e-10: the highest is 8e5 times the lowest
            np.testing.assert_allclose(modes.eigenvalues, exact[:n_modes], rtol=1e-8)
            product = modes.flexible.T @ problem.times_mass(modes.flexible)
            np.testing.assert_allclose(product, np.eye(n_modes), rtol=0, atol=1e-9)


@pytest.mark.parametrize("share", [1e-6, 1e-12])
def test_nearly_massless_rotations(share: float) -> None:
    kinematics = with_rotary_inertia(share)
    exact = condensed_eigenvalues(kinematics, THETA)
    with modal_problem(kinematics, VALUES, N_FINITE) as problem:
        found = problem.solve(THETA).eigenvalues
    # the highest mode kept has (k_s G A + ...) / rho I at 1e6 of itself above it, which shifts it by that share
    np.testing.assert_allclose(found, exact, rtol=10 * share + 1e-8)


def test_more_modes_than_are_finite_are_refused() -> None:
    with modal_problem(with_rotary_inertia(0.0), VALUES, N_FINITE + 2) as problem:
        with pytest.raises(RunError, match=r"at theta = 0.7 rad: 19 of 21 eigenvalues are finite"):
            problem.solve(THETA)


def test_a_reduced_model_with_massless_rotations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without any rotary inertia, against the full-order model with 1e-9 of it, which cannot start with none."""
    of = BeamSection.of.__func__
    scene = accurate(*run_for(0.1, 1e-3), *start(0.5), angles=48)
    found = {}
    for share in (0.0, 1e-9):

        def scaled(cls: type, *arguments: object, share: float = share) -> BeamSection:
            section = of(cls, *arguments)
            return replace(section, mass=(section.mass[0], share * section.mass[1]))

        monkeypatch.setattr(BeamSection, "of", classmethod(scaled))
        model = ReducedModel(scene, built_rom(scene))
        found[share] = history(model, samples(scene, 1), 1)[1]
    full = history(full_model(scene), samples(scene, 1), 1)[1]
    # as with rotary inertia
    assert_close(full, found[1e-9], angle=1e-5, bent=2e-3, slider=1e-6)
    # the tables differ by 1e-9 of the share that rotary inertia has in them
    assert_close(found[1e-9], found[0.0], angle=1e-10, bent=1e-7, slider=1e-10)


@pytest.mark.parametrize("ratio", [0.1, 10.0])
def test_radii_that_differ_by_a_factor_of_ten(ratio: float) -> None:
    """Stiffnesses differ by 1e4. Loads and times fit the thinner body, so that it bends by a thousandth."""
    radius = ratio * RADIUS
    scene = accurate(f"parameters.r1.nominal={radius}", angles=48)
    kinematics = kinematics_of(scene)
    with modal_problem(kinematics, scene.nominal, 8) as problem:
        for theta in (0.0, THETA, np.pi / 2):
            modes = problem.solve(theta)
            exact = dense_eigenvalues(kinematics, theta, scene.nominal, 8)
            # round-off of both; measured 2e-11, though the highest eigenvalue is up to 4e9 times the lowest
            np.testing.assert_allclose(modes.eigenvalues, exact, rtol=2e-10)
    duration = 4 / modes.frequencies_hz[0]
    bending = circle(min(radius, RADIUS), 210e9, 7800.0)[2]
    table = f"effects.motor.table=[[0.0, 0.0], [{duration / 2}, {1e-3 * 3 * bending / 0.3}]]"
    moving = (table, *start(0.6), *run_for(duration, duration / 400))
    full, reduced = both(accurate(f"parameters.r1.nominal={radius}", *moving, angles=48))
    # shares of what has moved: measured up to 5e-4 and 9e-4
    assert np.abs(reduced["angle"] - full["angle"]).max() < 1e-3 * np.ptp(full["angle"])
    assert np.abs(reduced["bent"] - full["bent"]).max() < 2e-3 * np.abs(full["bent"]).max()


def fine(n: int, of_rod: int | None = None) -> RigidKinematics:
    """Return the slider-crank with so many elements in the crank, and in the rod, as many unless told."""
    meshes = f'bodies.crank.mesh="0.0:0.3:{n}"', f'bodies.rod.mesh="0.3:1.0:{of_rod or n}"'
    return kinematics_of(slider_crank(*meshes))


def frequencies(*elements: int) -> np.ndarray:
    with modal_problem(fine(*elements), VALUES, 3) as problem:
        return problem.solve(THETA).frequencies_hz


@pytest.fixture(scope="module")
def extrapolated() -> tuple[np.ndarray, np.ndarray]:
    """Return the frequencies of infinitely many elements, by Richardson from 20, 40 and 80, and of 80."""
    coarse, middle, last = (frequencies(n) for n in (20, 40, 80))
    first, second = (4 * middle - coarse) / 3, (4 * last - middle) / 3
    return (16 * second - first) / 15, last


def test_a_thousand_elements_a_body(extrapolated: tuple[np.ndarray, np.ndarray]) -> None:
    limit, last = extrapolated
    # n elements err by 1/n^2; the extrapolation itself errs by 2e-7 at the second frequency, by less at the others
    expected = limit + (last - limit) * (80 / 1000) ** 2
    np.testing.assert_allclose(frequencies(1000), expected, rtol=5e-7)


@pytest.mark.parametrize(("n", "allowed"), [(400, 1e-12), pytest.param(12_000, 1e-6, marks=pytest.mark.thorough)])
def test_too_many_elements_of_a_short_body_are_refused_with_the_reason(
    n: int, allowed: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Twelve thousand are too many; fewer, where less is allowed."""
    monkeypatch.setattr(shift_invert, "RESIDUAL_TOLERANCE", allowed)
    words = refusal(frequencies, n, 100, error=RunError)
    assert words.startswith("eigenproblem at theta = 0")
    assert "has the relative residual" in words
    assert words.endswith(f"above {allowed:g}; the mesh may be too fine for double precision")


@pytest.mark.thorough
def test_where_round_off_enters_with_ten_thousand_elements(
    extrapolated: tuple[np.ndarray, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The vectors are good; the stiffness matrix, whose entries k_s G A / h were rounded, is not quite the beam's."""
    monkeypatch.setattr(shift_invert, "RESIDUAL_TOLERANCE", 1e-3)
    kinematics = fine(10_000)
    stiffness, _ = matrices_of(kinematics.mechanism, VALUES)
    with modal_problem(kinematics, VALUES, 3) as problem:
        modes = problem.solve(THETA)
    weights = np.abs(modes.flexible)
    bound = np.finfo(float).eps * np.sum(weights * (abs(stiffness) @ weights), axis=0) / modes.eigenvalues
    assert 1e-6 < bound[0] < 1e-4
    wrong = modes.frequencies_hz / extrapolated[0] - 1
    assert np.all(np.abs(wrong) < 0.5 * bound + 5e-7)
    assert np.all(np.abs(wrong) < 1e-5)
