"""Tables over one coordinate and two: order of their interpolation, gauge, clamped coordinates, the file, commands; and
angles that are added until tables meet a tolerance."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from alike import assert_alike
from length_scenes import HIGH, LOW, SMALL, long_crank, numbered
from pencils import modal_problem
from refusals import refusal
from runs import ONE_RANK, history, reduced_model, rom_of, samples
from two_coordinates import THIRD, double_pendulum, five_bar, over

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.bodies.matrices import AffineMatrices, weighted_sum
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduction.angles import _beyond_tolerance, interpolation_errors
from pgmp_petsc.reduction.continuous_basis import ContinuousBasis
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.sample_grid import SampleGrid, Samples
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.modes_table import tabulate_modes
from scenes import RADIUS, kinematics_of, mechanism_of, meshes_of, slider_crank

# one number of angles for all coordinates is what the scene's schema knows; the build takes one for each
pytestmark = pytest.mark.filterwarnings("ignore:Pydantic serializer warnings")
SPLINE = 'reduction.interpolation="spline"'
STATIC = ("reduction.static_modes=true", "reduction.inertia_modes=true")
GRAVITY = 'effects.weight={type="gravity"}'
PART = tuple(
    entry for name, lower, upper in (("theta1", 1.2, 2.4), ("theta2", 0.4, 1.6))
    for entry in (f"coordinates.{name}.range=[{lower},{upper}]", f"coordinates.{name}.periodic=false",
                  f"simulation.initial.{name}.position={lower}")
)  # fmt: skip


def elsewhere(samples: SampleGrid, n: int = 20) -> np.ndarray:
    """Return n random configurations."""
    random = np.random.default_rng(3)
    return np.column_stack([random.uniform(axis.lower, axis.upper, n) for axis in samples])


def exact_hz(scene: Scene, values: dict[str, float], n: int, theta: np.ndarray) -> np.ndarray:
    with modal_problem(kinematics_of(scene), values, n) as problem:
        return np.array([problem.solve(at).frequencies_hz for at in theta])


@pytest.fixture(scope="module")
def pendulum_rom() -> ReducedOrderModel:
    return rom_of(over(double_pendulum(*STATIC, GRAVITY, SPLINE), (6, 10)))


def test_the_order_of_interpolation_over_both_coordinates() -> None:
    """The tables of modes that cross, within their groups: frequencies at configurations that took no part."""
    part, errors = (*PART, SPLINE, "reduction.modes=4"), []
    scene = five_bar(*part)
    for n in (6, 21):
        rom = rom_of(five_bar(*part, f"reduction.angles={n}"))
        if not errors:
            wanted = elsewhere(rom.tables.samples)
            exact = exact_hz(scene, scene.nominal, 4, wanted)
        found = rom.tables.frequencies_hz(scene.nominal, at=rom.tables.over("spline", wanted))
        errors.append(np.abs(found / exact - 1).max())
    # cubic splines: fourth order
    assert np.log2(errors[0] / errors[1]) / 2 > 3.7 and errors[1] < 2e-5


def test_adaptive_sampling_adds_angles_along_the_coordinate_that_needs_them() -> None:
    """Modes of an open chain do not hang on the first coordinate, of which distances are halved once, to see that."""
    part = (*PART, SPLINE, "reduction.modes=4", "reduction.angles=4")
    shapes, errors = [], []
    for tolerance in (1e-1, 1e-2, 1e-3):
        scene = double_pendulum(*part, f"reduction.sampling_tolerance={tolerance}")
        rom = rom_of(scene)
        wanted = elsewhere(rom.tables.samples)
        exact = exact_hz(scene, scene.nominal, 4, wanted)
        shapes.append(rom.tables.samples.shape)
        errors.append(
            np.abs(rom.tables.frequencies_hz(scene.nominal, at=rom.tables.over("spline", wanted)) / exact - 1).max()
        )
        assert errors[-1] < tolerance
    assert {shape[0] for shape in shapes} == {7} and shapes[0][1] < shapes[1][1] < shapes[2][1]
    for most, why in {
        20: "16 .* it is not known how much they miss, and .* 49",
        60: "49 .* by .* near theta2 = ",
    }.items():
        with pytest.raises(RunError, match=f"with {why}.*; raise"):
            rom_of(double_pendulum(*part, "reduction.sampling_tolerance=1e-6", f"reduction.max_angles={most}"))


def test_a_basis_over_full_turns_is_continuous_everywhere() -> None:
    scene = five_bar(SPLINE, "reduction.modes=4", "reduction.angles=24")
    rom = rom_of(scene)
    samples, mechanism = rom.tables.samples, mechanism_of(scene)
    mass = weighted_sum(AffineMatrices(mechanism.bodies, range(mechanism.n_dofs)).mass, {})
    assert samples.shape == (24, 24)
    for axis in range(2):
        products = np.einsum("kdi,kdj->kij", rom.projection, [mass @ p for p in rom.projection[samples.before(axis)]])
        # spaces turn by 34 degrees at most from sample to sample (rom.cosines), and no basis by much more in its space
        assert np.einsum("kii->ki", products).min() > 0.7
    assert rom.cosines.min() > 0.8 and not rom.indefinite


def test_modes_of_an_open_chain_do_not_depend_on_the_first_coordinate(pendulum_rom: ReducedOrderModel) -> None:
    tables = pendulum_rom.tables
    for name in ("mass", "stiffness", "inertia"):
        grid = getattr(tables, name).reshape(6, 10, -1)
        np.testing.assert_allclose(grid, np.broadcast_to(grid[:1], grid.shape), rtol=0, atol=1e-7 * np.abs(grid).max())


DRIVE = 'effects.drive={type="prescribed_motion", coordinate="theta1", constant_speed={speed=1.0}}'


def test_a_prescribed_coordinate_stays_in_the_tables() -> None:
    scene = over(double_pendulum(*STATIC, GRAVITY, SPLINE, DRIVE), (5, 8))
    rom = rom_of(scene)
    tables = rom.tables
    # one more static mode than without: the answer to the driven acceleration
    assert (tables.n_coordinates, tables.n_modes) == (2, 3 + 5 + 3)
    scale = np.sqrt(np.abs(np.einsum("ntii->nti", tables.mass)))
    coupling = np.abs(tables.mass / (scale[..., :, None] * scale[..., None, :]))[:, 0, :2, 2:]
    assert coupling[:, 0].max() > 0.1 and coupling[:, 1].max() < 1e-9
    hinge = mechanism_of(scene).attachment("upper:hinge", "test").node
    np.testing.assert_allclose(rom.projection[:, 3 * hinge + 2], 0.0, rtol=0, atol=1e-12)
    found = tables.frequencies_hz({}, free=[1])
    np.testing.assert_allclose(found[:, :3], rom.frequencies_hz, rtol=1e-6)


@pytest.mark.parametrize("drive", [(), (DRIVE,)])
def test_full_order_and_reduced_frequencies_side_by_side(drive: tuple[str, ...]) -> None:
    scene = double_pendulum(SPLINE, "reduction.angles=12", *drive)
    table = tabulate_modes(scene, meshes_of(scene), rom_of(scene), 6, ONE_RANK)
    assert table.theta.shape == (2, 36) and list(table.coordinate_units) == ["theta1", "theta2"]
    assert table.full_hz.shape == table.reduced_hz.shape == (36, 3)
    # every second sample: nothing is interpolated there
    np.testing.assert_allclose(table.reduced_hz, table.full_hz, rtol=1e-8)


def test_modes_at_other_parameters_extend_a_basis_over_two_coordinates() -> None:
    uncertain = (
        'parameters.r={nominal=5e-3, distribution={name="uniform", loc=4e-3, scale=2e-3}}',
        'bodies.upper.section={shape="circle", radius="r"}', "reduction.modes=5", SPLINE,
    )  # fmt: skip
    errors, values = [], {"r": 5.99e-3}  # near the point that is chosen
    for more in ((), ("reduction.parameter_modes=1",)):
        scene = double_pendulum(*uncertain, *more)
        rom = rom_of(scene)
        exact = exact_hz(scene, values, 5, rom.tables.samples.theta[:8])
        errors.append(np.abs(rom.tables.frequencies_hz(values)[:8, :5] / exact - 1).max())
    assert rom.points.n_vectors == 1 and errors[1] < 0.3 * errors[0]


FOURTH = (
    'bodies.finger={mesh="0.0:0.1:2",element="beam2d",material="steel",section={shape="circle",radius=4e-3}}',
    'joints.knuckle={type="revolute",connect=["hand:tip","finger:hinge"]}',
    'coordinates.theta4={joint="knuckle",range=[0.0,1.0]}',
)


@pytest.mark.parametrize(("overrides", "message"), [
    (THIRD + FOURTH, "theta1, theta2, theta3, theta4: 4 independent coordinates were given; at most 3 are taken. "
     "reduction.angles = 8 along each would make 8^4 = 4.1e+03 configurations: about 0.0"),
    ((*THIRD, "reduction.angles=200"),
     "theta1, theta2, theta3: reduction.angles = 200 along each would make 200^3 = 8e+06 configurations: about "),
    ((*THIRD, SPLINE, "reduction.angles=100", "reduction.sampling_tolerance=0.1"),
     "theta1, theta2, theta3: reduction.angles = 100 along each, doubled by reduction.sampling_tolerance, would make "
     "200^3 = 8e+06 configurations: about "),
])  # fmt: skip
def test_what_is_for_fewer_coordinates_is_refused(overrides: tuple[str, ...], message: str) -> None:
    assert refusal(rom_of, double_pendulum(*overrides)).startswith(f"coordinates: {message}")


BASIS = ("reduction.modes=3", "reduction.static_modes=true", "reduction.inertia_modes=true")
TABLES = ("mass", "stiffness", "inertia")
FINE = 384  # twice 192: places in the middle of cells, where the spectral error is largest
SOME = (
    "coordinates.theta.range=[0.5,2.0]", "coordinates.theta.periodic=false", "simulation.initial.theta.position=1.0",
)  # fmt: skip


@lru_cache
def built(n: int, *part: str) -> ReducedOrderModel:
    """Return the reduced model at n angles; even samples are the same for all schemes of a revolution."""
    return rom_of(slider_crank(*BASIS, f"reduction.angles={n}", 'reduction.interpolation="spline"', *part))


def errors(scheme: str, n: int, fine: int, *part: str) -> np.ndarray:
    """Return the largest error of every table, each entry over its own largest value, between fine angles."""
    between, found = built(fine, *part).tables, []
    theta = between.samples.axes[0].theta[1::2]
    for name in TABLES:
        exact = getattr(between, name)[1::2]
        size = np.abs(exact).max(axis=0)
        size = np.where(size > 1e-8 * size.max(), size, np.inf)  # entries that are zero but for round-off
        tables = built(n, *part).tables
        found.append(
            (np.abs(interpolant(tables.samples.axes[0], getattr(tables, name), scheme)(theta) - exact) / size).max()
        )
    return np.array(found)


@pytest.mark.parametrize(("scheme", "order"), [("overhauser", 3.0), ("spline", 4.0)])
def test_the_order_in_the_angle_spacing(scheme: str, order: float) -> None:
    """Measured from 37 to 74 cells of a part of the revolution: 3.01 to 3.04, and 3.88 to 4.11."""
    few, many, fine = 38, 75, 371  # five times as many cells: places all over these, as Overhauser's error vanishes
    orders = np.log2(errors(scheme, few, fine, *SOME) / errors(scheme, many, fine, *SOME))
    assert np.all(np.abs(orders - order) < 0.4), orders


def test_spectral_errors_fall_faster_than_any_power() -> None:
    """From 48 to 96 to 192 angles: observed orders of 6.1 and 10.9."""
    n = np.array([48, 96, 192])
    worst = np.array([errors("spectral", k, FINE).max() for k in n])
    orders = -np.diff(np.log(worst)) / np.diff(np.log(n))
    assert np.all(orders > 4.0) and orders[-1] > 10.0, orders
    assert worst[-1] < 1e-5


def adaptive(tolerance: float, *more: str) -> ReducedOrderModel:
    return rom_of(slider_crank("reduction.angles=12", SPLINE, f"reduction.sampling_tolerance={tolerance}", *more))


@pytest.mark.parametrize("periodic", [True, False])
def test_midpoints(periodic: bool) -> None:
    samples = Samples(np.array([0.0, 1.0, 4.0]), 0.0, 4.0 if not periodic else 5.0, periodic)
    expected = [0.5, 2.5, 4.5] if periodic else [0.5, 2.5]
    np.testing.assert_array_equal(samples.between(0.5), expected)


def test_tables_meet_the_tolerance_at_angles_that_took_no_part() -> None:
    counts, errors = [], []
    elsewhere = np.random.default_rng(0).uniform(0.0, 2 * np.pi, 20)
    with modal_problem(kinematics_of(slider_crank()), {"r1": RADIUS}, 5) as problem:
        exact = np.array([problem.solve(theta).frequencies_hz for theta in elsewhere])
    for tolerance in (1e-1, 1e-2, 1e-3):
        rom = adaptive(tolerance)
        found = rom.tables.frequencies_hz({"r1": RADIUS}, at=rom.tables.over("spline", elsewhere[:, None]))
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
    more = (*SMALL, "reduction.sampling_tolerance=0.1", "reduction.max_angles=192")
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


def test_rounds_are_compared_where_vectors_no_longer_change_their_sign_after_a_turn() -> None:
    scene = double_pendulum(SPLINE, "reduction.sampling_tolerance=1e-3")
    rom = rom_of(double_pendulum(SPLINE))
    m, samples = rom.tables.n_modes, rom.tables.samples
    few = np.flatnonzero([theta in samples.axes[1].theta[::2] for theta in samples.theta[:, 1]])
    groups, own, flipped = [np.array([k]) for k in range(m)], np.zeros((1, m, m)), np.zeros((2, m), dtype=bool)
    now, before = (
        ContinuousBasis(tables, projection, groups, own, flipped)
        for tables, projection in ((rom.tables, rom.projection), (rom.tables.at(few), rom.projection[few]))
    )
    grid, plain = before.tables.samples, replace(before.tables, changes=None)
    tables = grid.doubled(0, plain, np.ones(m), samples=grid.over_two_turns(0))
    turned = replace(before, tables=tables, projection=grid.twice(0, before.projection, before.projection))
    wanted = _beyond_tolerance(scene, samples, before, now)
    assert wanted[1].size and not wanted[0].size
    for found, expected in zip(_beyond_tolerance(scene, samples, turned, now), wanted):
        np.testing.assert_array_equal(found, expected)


def test_a_tolerance_that_needs_too_many_angles_is_said() -> None:
    with pytest.raises(RunError, match="reduction.sampling_tolerance = 1e-06: with 2[0-9] angles .* raise"):
        adaptive(1e-6, "reduction.max_angles=30")


@pytest.mark.parametrize("scheme", ["overhauser", "spectral"])
def test_only_splines_take_samples_anywhere(scheme: str) -> None:
    with pytest.raises(InputError, match='reduction.sampling_tolerance = 0.01: needs interpolation = "spline"'):
        slider_crank(f'reduction.interpolation="{scheme}"', "reduction.sampling_tolerance=0.01")
