"""Adaptive sampling: interpolated tables meet the tolerance at angles that took no part, with no more than needed."""

import numpy as np
import pytest
from alike import assert_alike
from length_scenes import HIGH, LOW, SMALL, long_crank, numbered
from mpi4py import MPI
from runs import history, reduced_model, rom_of, samples

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.reduction.angles import interpolation_errors, midpoints
from pgmp_petsc.reduction.continuous_basis import ContinuousBasis
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.sample_grid import Samples
from pgmp_petsc.studies.modes_table import reduced_frequencies
from scenes import RADIUS, kinematics_of, slider_crank

SPLINE = 'reduction.interpolation="spline"'


def adaptive(tolerance: float, *more: str) -> ReducedOrderModel:
    return rom_of(slider_crank("reduction.angles=12", SPLINE, f"reduction.sampling_tolerance={tolerance}", *more))


@pytest.mark.parametrize("periodic", [True, False])
def test_midpoints(periodic: bool) -> None:
    samples = Samples(np.array([0.0, 1.0, 4.0]), 0.0, 4.0 if not periodic else 5.0, periodic)
    expected = [0.5, 2.5, 4.5] if periodic else [0.5, 2.5]
    np.testing.assert_array_equal(midpoints(samples), expected)
    chosen = np.zeros(len(expected), dtype=bool)
    chosen[1] = True
    np.testing.assert_array_equal(midpoints(samples, chosen), [2.5])


def test_tables_meet_the_tolerance_at_angles_that_took_no_part() -> None:
    counts, errors = [], []
    elsewhere = np.random.default_rng(0).uniform(0.0, 2 * np.pi, 20)
    with ModalProblem(kinematics_of(slider_crank()), {"r1": RADIUS}, 5, MPI.COMM_SELF) as problem:
        exact = np.array([problem.solve(theta).frequencies_hz for theta in elsewhere])
    for tolerance in (1e-1, 1e-2, 1e-3):
        rom = adaptive(tolerance)
        found = reduced_frequencies(rom.tables, "spline", {"r1": RADIUS}, elsewhere[:, None])
        counts.append(rom.tables.samples.n)
        errors.append(np.max(np.abs(found / exact - 1)))
        # an eigenvalue is the square of a frequency, and the tables' entries add up; the check is at middles only
        assert errors[-1] < 3 * tolerance
    assert counts[0] < counts[1] < counts[2] and errors[2] < 0.1 * errors[0]


def test_angles_come_where_the_modes_change_fast() -> None:
    theta = adaptive(1e-2).tables.samples.axes[0].theta
    gaps = np.diff(np.append(theta, 2 * np.pi))
    # the frequencies of the slider-crank change fastest beside the dead centre at 0
    assert gaps[0] < 1.01 * gaps.min() and gaps[0] < 0.6 * gaps.max()


def test_models_of_all_lengths_have_the_angles_that_the_extreme_ones_ask_for() -> None:
    more = (*SMALL, "reduction.sampling_tolerance=0.05", "reduction.max_angles=192")
    scene = long_crank(*more)
    rom = rom_of(scene)
    common = rom.tables.samples.axes[0].theta
    own = [rom_of(numbered(length, *more)).tables.samples.axes[0].theta for length in (0.7, LOW, HIGH)]
    np.testing.assert_array_equal(common, np.unique(np.concatenate(own)))
    assert common.size > 12
    for member in rom.family.members:
        np.testing.assert_array_equal(member.tables.samples.axes[0].theta, common)
    (said,) = [remark.text for remark in rom.record.remarks if "sampling_tolerance" in remark.text]
    counts = ", ".join(str(theta.size) for theta in own)
    assert f"{common.size} angles, all that the nominal lengths and the ends of their ranges ask for ({counts})" in said
    # a run at an end, with the angles of all, is that of the model of this length with its own ones
    at_end, number = (ReducedModel(scene.with_values({"rod_length": HIGH}), rom), reduced_model(numbered(HIGH, *more)))
    (_, found), (_, expected) = (history(model, samples(model.scene, 1), 1) for model in (at_end, number))
    assert_alike(expected, found, 0.05)


def test_a_sample_that_was_interpolated_exactly_has_no_error() -> None:
    rom = rom_of(slider_crank("reduction.angles=48", SPLINE))
    groups = [np.array([k]) for k in range(rom.tables.n_modes)]
    own = np.broadcast_to(np.eye(rom.tables.n_modes), (48, rom.tables.n_modes, rom.tables.n_modes))
    basis = ContinuousBasis(rom.tables, rom.projection, groups, own, np.zeros((1, rom.tables.n_modes), dtype=bool))
    some = rom.tables.samples.axes[0].theta[[3, 17]]
    errors = interpolation_errors(basis, basis, some[:, None], {"r1": RADIUS})
    np.testing.assert_allclose(errors, 0.0, atol=1e-9)


def test_a_tolerance_that_needs_too_many_angles_is_said() -> None:
    with pytest.raises(RunError, match="reduction.sampling_tolerance = 1e-06: with 2[0-9] angles .* raise"):
        adaptive(1e-6, "reduction.max_angles=20")


@pytest.mark.parametrize("scheme", ["overhauser", "spectral"])
def test_only_splines_take_samples_anywhere(scheme: str) -> None:
    with pytest.raises(InputError, match='reduction.sampling_tolerance = 0.01: needs interpolation = "spline"'):
        slider_crank(f'reduction.interpolation="{scheme}"', "reduction.sampling_tolerance=0.01")
