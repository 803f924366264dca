"""The interpolated terms of the reduced equations of motion: rigid inertia, coupling b, and where they stand."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from runs import place_in, quick_return, rom_of

from pgmp_petsc.bodies.matrices import assemble
from pgmp_petsc.mechanism.body_frames import rigid_velocities
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduced import cells as cells_module
from pgmp_petsc.reduced.cells import FEWEST_HELD, Cells
from pgmp_petsc.reduced.lagrangian import least_stiffness
from pgmp_petsc.reduced.terms import WIDEST, ReducedTerms, grid_of
from pgmp_petsc.reduction.interpolation import Interpolant, interpolant
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.sample_grid import SampleGrid, Samples
from pgmp_petsc.reduction.tables import fine_grid
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.simulate import lost_definiteness
from scenes import four_bar, kinematics_of, slider_crank, trammel

PART = (
    "coordinates.theta.range=[0.2,1.4]",
    "coordinates.theta.periodic=false",
    "simulation.initial.theta.position=0.2",
)


@pytest.fixture(scope="module")
def rom() -> ReducedOrderModel:
    return rom_of(slider_crank())


def terms_of(rom: ReducedOrderModel, scene: Scene, scheme: str) -> ReducedTerms:
    return ReducedTerms.of(rom.tables, rom.rigid_inertia, kinematics_of(scene), rom.projection, scheme)


def rigid_of(rom: ReducedOrderModel) -> Interpolant:
    return interpolant(fine_grid(rom.tables.samples), rom.rigid_inertia, "spline")


def direct_inertia(scene: Scene, theta: float) -> dict:
    """Return ``(d rho/d theta)^T M_i (d rho/d theta)`` of every term, from matrices and velocities."""
    kinematics = kinematics_of(scene)
    mechanism = kinematics.mechanism
    poses = kinematics.poses(np.array([theta]))
    velocity = rigid_velocities(mechanism, poses[..., 0], kinematics.rates(poses)[..., 0])[:, 0]
    mass = assemble(mechanism.bodies, range(mechanism.n_dofs)).mass
    return {weight: float(velocity @ (mass[weight] @ velocity)) for weight in mechanism.mass_weights}


@pytest.mark.parametrize(
    "scene",
    [slider_crank, quick_return, lambda: four_bar(), lambda: trammel(*PART)],
    ids=["slider-crank", "quick return", "two turns", "limited"],
)
def test_the_rigid_inertia_is_that_of_the_kinematics(scene: Callable[..., Scene]) -> None:
    scene = scene()
    tables, inertia = rom_of(scene).tables, rigid_of(rom_of(scene))
    samples = tables.samples.axes[0]
    # neither samples nor points of the fine grid
    for theta in samples.lower + (samples.upper - samples.lower) * np.array([0.0, 0.1234567, 0.5, 0.7654321, 0.9998]):
        expected = direct_inertia(scene, theta)
        size = max(expected.values())
        found = inertia(np.array([theta]))[0, :, 0]
        for weight, value in zip(tables.mass_weights, found):
            assert value == pytest.approx(expected[weight], abs=1e-9 * size), (theta, weight)
    # at the samples it is the table's own, which knows it from the modes' basis; over two turns the step is double
    of_tables = tables.mass[:, :, 0, 0]
    np.testing.assert_allclose(inertia(samples.theta)[:, :, 0], of_tables, rtol=0, atol=4e-9 * of_tables.max())


def test_loads_are_absent_where_the_scene_has_none() -> None:
    bare = slider_crank("effects={}", "reduction.angles=8", "reduction.modes=2")
    assert terms_of(rom_of(bare), bare, "spline").load(np.array([0.1, 0.2])).shape == (2, 0, 3)


def test_the_slope_of_the_rigid_inertia_is_twice_velocity_times_acceleration(rom: ReducedOrderModel) -> None:
    scene, step = slider_crank(), 1e-4
    weights, slope = rom.tables.mass_weights, rigid_of(rom).slope
    for theta in (0.3, 2.0, 4.4):
        ahead, behind = direct_inertia(scene, theta + step), direct_inertia(scene, theta - step)
        expected = np.array([(ahead[w] - behind[w]) / (2 * step) for w in weights])
        np.testing.assert_allclose(slope(np.array([theta]))[0, :, 0], expected, rtol=0, atol=1e-7 * max(ahead.values()))


@pytest.mark.parametrize("angles", [9, 24, 60])
def test_the_polynomials_of_the_rigid_inertia_are_as_good_as_its_spline(angles: int) -> None:
    """The coefficients, in rad from the lower end of a cell, against the spline at any theta."""
    scene = slider_crank(f"reduction.angles={angles}")
    terms = terms_of(rom_of(scene), scene, "spline")
    (grid,) = terms.grid
    assert grid.step <= WIDEST * (1 + 1e-9) and grid.n_cells % angles == 0
    for theta in np.linspace(0.0, 2 * np.pi, 77, endpoint=False):
        cell, place = divmod(theta - grid.lower, grid.step)
        # one packed entry, its eight coefficients
        found = terms.cells.rigid.polynomials[place_in(terms.cells.rigid, int(cell))] @ place ** np.arange(8.0)
        expected = terms.rigid(np.array([theta]))[0, :, 0]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("second_order", ["true", "false"])
def test_stiffness_that_interpolation_made_indefinite_has_no_share(second_order: str) -> None:
    """There it is said where, in place of an error of the factors; before the end of a run as well as there."""
    scene = slider_crank(f"reduction.second_order={second_order}")
    rom = rom_of(scene)
    model = ReducedModel(scene, rom)
    q = np.zeros((3, model.terms.layout.n_eta))
    q[:, 0] = 0.2, 0.4, 0.6
    np.testing.assert_allclose(least_stiffness(model.terms, scene.values, q), 1.0, rtol=1e-12)
    time = np.arange(3.0)
    assert lost_definiteness(model, scene.values, time, q) == ""
    # tables that change their sign in the second half of a turn
    stiffness = rom.tables.stiffness.copy()
    stiffness[rom.tables.samples.theta.ravel() > np.pi] *= -1.0
    negated = replace(rom.tables, stiffness=stiffness)
    model = ReducedModel(scene, replace(rom, tables=negated))
    q[2, 0] = 4.0
    share = least_stiffness(model.terms, scene.values, q)
    np.testing.assert_array_equal(np.isnan(share), [False, False, True])
    why = lost_definiteness(model, scene.values, time, q)
    assert "is not positive definite at theta = 4 rad; build with more reduction.angles" in why
    assert lost_definiteness(model, scene.values, time, q[[0, 2, 1]]) == why


LOWER, UPPER, PERIODIC = (0.0, -0.3, 0.2), (2 * np.pi, 0.9, 1.7), (True, False, False)


def sampled(n: tuple[int, ...]) -> SampleGrid:
    """Return a grid with so many samples along the coordinates."""
    return SampleGrid(tuple(Samples.uniform(*ends, k, turns) for *ends, k, turns in zip(LOWER, UPPER, n, PERIODIC)))


@pytest.mark.parametrize("scheme", ["overhauser", "spline"])
@pytest.mark.parametrize("n", [(9,), (9, 7), (9, 7, 6)])
@pytest.mark.parametrize("n_powers", [4, 8])
@pytest.mark.parametrize("most_held", [0, 2**22])
def test_the_polynomials_of_cells_are_the_interpolant(
    scheme: str, n: tuple[int, ...], n_powers: int, most_held: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All cells are held, or more are asked for than are held, some of them again."""
    monkeypatch.setattr(cells_module, "MOST_HELD", most_held)
    grid, r = sampled(n), len(n)
    found = interpolant(grid, np.random.default_rng(0).normal(size=(grid.n, 2, 3)), scheme)
    axes = grid_of(found)
    cells = Cells.of(found, axes, n_powers)
    for theta in np.random.default_rng(1).uniform(LOWER[:r], UPPER[:r], size=(4 * FEWEST_HELD, r)).repeat(2, axis=0):
        number, powers = 0, np.ones(1)
        for x, axis in zip(theta, axes):
            cell = int((x - axis.lower) / axis.step)
            place = x - axis.lower - cell * axis.step
            number, powers = (
                number * axis.n_cells + cell,
                np.multiply.outer(powers, place ** np.arange(n_powers)).ravel(),
            )
        of_cell = cells.polynomials[place_in(cells, number)].reshape(2, 3, -1)
        np.testing.assert_allclose(of_cell @ powers, found(theta[None])[0], rtol=0, atol=1e-10)


@pytest.mark.parametrize(("scheme", "order"), [("overhauser", 3), ("spline", 4)])
def test_the_order_over_three_coordinates(scheme: str, order: int) -> None:
    def exact(theta: np.ndarray) -> np.ndarray:
        return np.sin(theta[:, 0] + 2.0 * theta[:, 1]) * np.exp(theta[:, 2] - theta[:, 1])

    theta, errors = np.random.default_rng(2).uniform(LOWER, UPPER, size=(400, 3)), []
    for n in (12, 24):
        grid = sampled((2 * n, n + 1, n + 1))
        errors.append(np.abs(interpolant(grid, exact(grid.theta), scheme)(theta) - exact(theta)).max())
    assert np.log2(errors[0] / errors[1]) > order - 0.4
