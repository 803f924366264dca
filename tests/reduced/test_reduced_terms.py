"""The interpolated terms of the reduced equations of motion: rigid inertia, coupling b, and where they stand."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from runs import place_in, quick_return, rom_of

from pgmp_petsc.bodies.matrices import assemble
from pgmp_petsc.mechanism.body_frames import rigid_velocities
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduced.lagrangian_terms import least_stiffness
from pgmp_petsc.reduced.terms import WIDEST, ReducedTerms, coupling_of, displacement_scale, pack
from pgmp_petsc.reduction.interpolation import Interpolant, interpolant
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.tables import fine_grid
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.simulate import lost_definiteness
from scenes import four_bar, kinematics_of, slider_crank, trammel

PART = (
    "coordinates.theta.range=[0.2,1.4]",
    "coordinates.theta.periodic=false",
    "simulation.initial.theta.position=0.2",
)
SCHEMES = ["overhauser", "spline", "spectral"]


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


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_coupling_is_that_of_the_changing_modes(rom: ReducedOrderModel, scheme: str) -> None:
    """Against ``(d rho/d theta)^T M_i (d Psi/d theta)`` with the modes' own slope in frames that turn."""
    kinematics, tables = kinematics_of(slider_crank()), rom.tables
    matrices = assemble(kinematics.mechanism.bodies, range(kinematics.mechanism.n_dofs)).mass
    fine = replace(
        rom, projection=interpolant(tables.samples.axes[0], rom.projection, scheme).slope(tables.samples.axes[0].theta)
    )
    found = coupling_of(tables, scheme)
    assert found.shape == (24, len(tables.mass_weights), 5)
    poses = kinematics.poses(tables.samples.axes[0].theta)
    rates = kinematics.rates(poses)
    for k in range(0, 24, 5):
        pose, rate = poses[..., k], rates[..., k]
        velocity = rigid_velocities(kinematics.mechanism, pose, rate)[:, 0]
        # body frames turn with the bodies: d(R psi)/d theta = R (psi' + omega x psi)
        slope = fine.projection[k].reshape(-1, 3, 5).copy()
        psi = rom.projection[k].reshape(-1, 3, 5)
        for number, body in enumerate(kinematics.mechanism.bodies):
            inside = slice(body.nodes.start, body.nodes.stop)
            slope[inside, 0] -= rate[number, 2] * psi[inside, 1]
            slope[inside, 1] += rate[number, 2] * psi[inside, 0]
        for i, weight in enumerate(tables.mass_weights):
            expected = velocity @ (matrices[weight] @ slope.reshape(-1, 5))
            size = np.abs(found[:, i]).max()
            # the same derivative but for the error of interpolating 24 samples, which modes 4 and 5 feel most
            np.testing.assert_allclose(found[k, i, :3], expected[:3], rtol=0, atol=0.05 * size)


def test_terms_stand_where_the_layout_says(rom: ReducedOrderModel) -> None:
    tables = rom.tables
    terms = terms_of(rom, slider_crank(), "overhauser")
    assert set(terms.weights) == {*tables.mass_weights, *tables.stiffness_weights}
    layout = terms.layout
    assert layout == ((0,), 6, 21, 26, *6 * (41,), 6, True) and not layout.second_order
    assert terms.terms.rows.shape == (24, len(terms.weights), 41)
    for t, weight in enumerate(terms.weights):
        parts = np.split(terms.terms.rows[:, t], [21, 26], axis=1)
        if weight in tables.mass_weights:
            i = tables.mass_weights.index(weight)
            np.testing.assert_array_equal(parts[0], pack(tables.mass[:, i]))
            np.testing.assert_array_equal(parts[1], coupling_of(tables, "overhauser")[:, i])
        else:
            assert not parts[0].any() and not parts[1].any()
        if weight in tables.stiffness_weights:
            np.testing.assert_array_equal(parts[2], pack(tables.stiffness[:, tables.stiffness_weights.index(weight)]))
        else:
            assert not parts[2].any()
    np.testing.assert_array_equal(terms.load.rows, tables.load)
    assert terms.scale[0] == 1.0
    np.testing.assert_array_equal(
        terms.scale[1:], displacement_scale(rom.projection, kinematics_of(slider_crank()).size)
    )


@pytest.mark.parametrize("scheme", SCHEMES)
def test_loads_are_absent_where_the_scene_has_none(scheme: str) -> None:
    scene = slider_crank("effects={}", "reduction.angles=8", "reduction.modes=2")
    rom = rom_of(scene)
    terms = terms_of(rom, scene, scheme)
    assert terms.load(np.array([0.1, 0.2])).shape == (2, 0, 3)


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
