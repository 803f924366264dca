"""Interpolation: order, exactness, continuity, slopes, ends of the range, and the samples that a scheme wants."""

import numpy as np
import pytest
from frames import pair_products
from refusals import refusal
from scipy.interpolate import CubicSpline

from pgmp_petsc.reduction import interpolation as module
from pgmp_petsc.reduction.cell_products import B_SPLINE, N_ROWS, Axis, stencil
from pgmp_petsc.reduction.interpolation import FINE, Interpolant, interpolant, samples_for
from pgmp_petsc.reduction.sample_grid import Samples

PERIODIC = [True, False]
SCHEMES = ["overhauser", "spline", "spectral"]
LOWER, UPPER = 0.4, 0.4 + 2 * np.pi
THETA = np.linspace(LOWER, UPPER, 2003)


def smooth(theta: np.ndarray) -> np.ndarray:
    """Return a function of period 2 pi, with trailing axes, shape (n, 2)."""
    return np.stack([np.exp(np.sin(theta)), np.cos(2 * theta + 0.3)], axis=-1)


def smooth_slope(theta: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(theta) * np.exp(np.sin(theta)), -2 * np.sin(2 * theta + 0.3)], axis=-1)


def analytic(theta: np.ndarray) -> np.ndarray:
    """Return a function with poles 0.69 beside the real axis: its Fourier coefficients halve one by one."""
    return 1.0 / (1.25 - np.cos(theta))


def analytic_slope(theta: np.ndarray) -> np.ndarray:
    return -np.sin(theta) / (1.25 - np.cos(theta)) ** 2


def uniform(n: int, periodic: bool) -> Samples:
    """Return samples of one revolution, n cells."""
    return Samples.uniform(LOWER, UPPER, n if periodic else n + 1, periodic)


def uneven(n: int, periodic: bool) -> Samples:
    """Return samples of one revolution at smoothly varying distances, n cells."""
    even = uniform(n, periodic).theta
    return Samples(even + 0.4 * np.sin(even - LOWER), LOWER, UPPER, periodic)


def random_table(n: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(n, *shape))


def errors(samples: Samples, scheme: str, exact=smooth, slope=smooth_slope, theta: np.ndarray = THETA) -> np.ndarray:
    found = interpolant(samples, exact(samples.theta), scheme)
    return np.array([np.abs(found(theta) - exact(theta)).max(), np.abs(found(theta, 0) - slope(theta)).max()])


def values_and_slopes(interpolated: Interpolant, theta: np.ndarray) -> np.ndarray:
    return np.stack([interpolated(theta), interpolated(theta, 0)])


@pytest.mark.parametrize("periodic", PERIODIC)
@pytest.mark.parametrize(
    ("scheme", "sampled", "order"), [("overhauser", uniform, 3), ("spline", uniform, 4), ("spline", uneven, 4)]
)
def test_the_order_of_value_and_slope(periodic: bool, scheme: str, sampled, order: int) -> None:
    found = np.array([errors(sampled(n, periodic), scheme) for n in (80, 160, 320)])
    observed = np.log2(found[:-1] / found[1:])
    # the next term of the error is a step smaller, so 0.2 is left at these samples
    np.testing.assert_allclose(observed, np.tile([order, order - 1], (2, 1)), rtol=0, atol=0.25)


@pytest.mark.parametrize("periodic", PERIODIC)
def test_the_spectral_error_falls_faster_than_any_power(periodic: bool) -> None:
    coarse, medium, fine, finest = (
        errors(samples_for("spectral", LOWER, UPPER, n, periodic), "spectral", analytic, analytic_slope)
        for n in (24, 48, 96, 192)
    )
    # a scheme of fourth order would give 16
    assert coarse[0] / medium[0] > 1e3
    # the floor: fourth and third order in the fine step, h^4 / 384 and h^3 / 24 times derivatives of 500, more at ends
    step = 2 * np.pi / FINE
    floor = np.array([step**4 / 384, step**3 / 24]) * 500 * (1 if periodic else 5)
    assert np.all(fine < floor) and np.all(finest < floor)
    assert medium[1] < coarse[1] / 1e2


def test_the_fine_grid_stands_back_where_samples_are_more() -> None:
    samples = uniform(2 * FINE, periodic=True)
    assert interpolant(samples, smooth(samples.theta), "spectral").axes[0].n == 2 * FINE
    # the first multiple beyond FINE
    assert interpolant(uniform(24, True), random_table(24), "spectral").axes[0].n == 43 * 24
    assert interpolant(uniform(24, True), random_table(24), "spline").axes[0].n == 24


@pytest.mark.parametrize("periodic", PERIODIC)
def test_a_spline_of_halved_intervals_is_exact_on_few_points(periodic: bool) -> None:
    """Of 24 intervals some are halved, and one of these once more."""
    even, step = uniform(24, periodic), (UPPER - LOWER) / 24.0
    more = even.theta[[0, 7, 8, 22]] + 0.5 * step
    samples = Samples(np.union1d(even.theta, [*more, even.theta[7] + 0.25 * step]), LOWER, UPPER, periodic)
    table = random_table(samples.n)
    found = interpolant(samples, table, "spline")
    assert found.axes[0].n == 96 + (not periodic)
    begins = np.round((samples.theta - LOWER) / (0.25 * step))
    np.testing.assert_array_equal(found.begins[0], begins if periodic else begins[:-1])
    closed = (np.append(samples.theta, UPPER), np.append(table, table[0])) if periodic else (samples.theta, table)
    expected = CubicSpline(*closed, bc_type="periodic" if periodic else "not-a-knot")
    np.testing.assert_allclose(found(THETA), expected(THETA), rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("periodic", PERIODIC)
@pytest.mark.parametrize("n", [4, 5, 12, 200])
def test_a_spline_of_uniform_samples_is_exact(periodic: bool, n: int) -> None:
    samples = uniform(n, periodic)
    table = random_table(samples.n, 3, 2)
    if periodic:
        knots = np.append(samples.theta, UPPER)
        expected = CubicSpline(knots, np.concatenate([table, table[:1]]), bc_type="periodic")
    else:
        expected = CubicSpline(samples.theta, table)
    found = interpolant(samples, table, "spline")
    # to 1e-13 of values and slopes, but for the round-off of scipy's own
    np.testing.assert_allclose(found(THETA), expected(THETA), rtol=0, atol=1e-13 * np.abs(expected(THETA)).max())
    slopes = expected(THETA, 1)
    np.testing.assert_allclose(found(THETA, 0), slopes, rtol=0, atol=1e-13 * max(1.0, np.abs(slopes).max()))


@pytest.mark.parametrize("periodic", PERIODIC)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_slope_is_the_derivative_of_the_interpolant(periodic: bool, scheme: str) -> None:
    samples = samples_for(scheme, LOWER, UPPER, 9, periodic)
    found = interpolant(samples, random_table(samples.n, 2), scheme)
    (axis,) = found.axes
    cells, step = np.arange(axis.n_cells), 1e-3 * axis.step
    theta = axis.lower + axis.step * (cells[:, None] + np.array([0.01, 0.3, 0.5, 0.9, 0.99])).ravel()
    difference = (found(theta + step) - found(theta - step)) / (2 * step)
    # a cubic's central difference errs by step^2 times its third derivative over 6; round-off by 1e-16 over the step
    np.testing.assert_allclose(found(theta, 0), difference, rtol=0, atol=1e-5 if axis.n < 10 else 1e-7)


@pytest.mark.parametrize("n", [3, 4, 7])
def test_quadratics_are_exact_up_to_the_ends_of_a_range(n: int) -> None:
    samples = Samples.uniform(-1.0, 2.0, n, periodic=False)
    theta = np.linspace(-1.0, 2.0, 61)
    found = interpolant(samples, 2.0 - 3.0 * samples.theta + 0.5 * samples.theta**2, "overhauser")
    np.testing.assert_allclose(found(theta), 2.0 - 3.0 * theta + 0.5 * theta**2, atol=1e-13)
    np.testing.assert_allclose(found(theta, 0), -3.0 + theta, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("scheme", "samples"),
    [
        ("spline", Samples.uniform(-1.0, 2.0, 4, periodic=False)),
        ("spline", Samples.uniform(-1.0, 2.0, 9, periodic=False)),
        ("spline", Samples(np.array([-1.0, -0.8, 0.3, 0.9, 1.1, 2.0]), -1.0, 2.0, False)),
        ("spectral", Samples.chebyshev(-1.0, 2.0, 4)),
        ("spectral", Samples.chebyshev(-1.0, 2.0, 9)),
    ],
)
def test_cubics_are_exact_up_to_the_ends_of_a_range(scheme: str, samples: Samples) -> None:
    cubic = np.polynomial.Polynomial([2.0, -3.0, 0.5, 1.5])
    theta = np.linspace(-1.0, 2.0, 61)
    found = interpolant(samples, cubic(samples.theta), scheme)
    np.testing.assert_allclose(found(theta), cubic(theta), rtol=0, atol=1e-12)
    # of the fine grid, round-off over its step
    np.testing.assert_allclose(found(theta, 0), cubic.deriv()(theta), rtol=0, atol=1e-10)


@pytest.mark.parametrize("n", [7, 8])
def test_waves_that_the_samples_resolve_are_exact(n: int) -> None:
    samples = uniform(n, periodic=True)
    for k in range(4):
        found = errors(samples, "spectral", lambda t, k=k: np.cos(k * t + 0.2), lambda t, k=k: -k * np.sin(k * t + 0.2))
        if 2 * k < n:
            # the fine grid's own: k^4 h^4 / 384 and k^4 h^3 / 24
            assert np.all(found < 3e-8 * np.array([1e-2, 1e1])), k


def test_the_tangent_at_a_sample_is_the_central_difference() -> None:
    # (20) of the paper is misprinted: its tangent would scale with the step
    samples, table = uniform(10, periodic=True), random_table(10)
    central = (np.roll(table, -1) - np.roll(table, 1)) / (2 * (samples.theta[1] - samples.theta[0]))
    slope = interpolant(samples, table, "overhauser")(samples.theta, 0)
    np.testing.assert_allclose(slope, central, rtol=0, atol=1e-11)


@pytest.mark.parametrize("turns", [-3, -1, 1, 40])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_periodic_table_goes_on_for_ever(scheme: str, turns: int) -> None:
    found = interpolant(uniform(11, periodic=True), random_table(11, 2), scheme)
    theta = np.linspace(LOWER, UPPER, 50)
    again = values_and_slopes(found, theta + 2 * np.pi * turns)
    np.testing.assert_allclose(again, values_and_slopes(found, theta), rtol=0, atol=1e-10)


@pytest.mark.parametrize("periodic", PERIODIC)
def test_the_b_splines_are_those_of_de_boor(periodic: bool) -> None:
    from scipy.interpolate import BSpline

    n, lower, step = 6, 0.3, 0.25
    rows = np.empty(N_ROWS, dtype=np.int64)
    weights, slopes = np.empty(N_ROWS), np.empty(N_ROWS)
    coefficients = random_table(n if periodic else n + 2)
    # the spline that begins at `lower` has its first coefficient a step before
    around = np.concatenate([coefficients[-1:], coefficients, coefficients[:2]]) if periodic else coefficients
    expected = BSpline(lower + step * np.arange(-3, len(around) + 1), around, 3)
    for theta in np.linspace(lower, lower + step * (n if periodic else n - 1), 50, endpoint=False):
        stencil(theta, Axis(lower, step, n, periodic, B_SPLINE), rows, weights, slopes)
        assert weights @ coefficients[rows] == pytest.approx(float(expected(theta)), abs=1e-13)
        assert slopes @ coefficients[rows] == pytest.approx(float(expected(theta, 1)), abs=1e-12)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("periodic", PERIODIC)
def test_the_samples_that_a_scheme_wants(scheme: str, periodic: bool) -> None:
    samples = samples_for(scheme, -0.5, 1.5, 9, periodic)
    assert (samples.n, samples.lower, samples.upper, samples.periodic) == (9, -0.5, 1.5, periodic)
    if scheme == "spectral" and not periodic:
        np.testing.assert_allclose(samples.theta, 0.5 - np.cos(np.pi * np.arange(9) / 8), rtol=0, atol=1e-15)
        assert not samples.is_uniform
    else:
        np.testing.assert_array_equal(samples.theta, np.linspace(-0.5, 1.5, 9, endpoint=not periodic))
        assert samples.is_uniform
    interpolant(samples, random_table(9), scheme)


@pytest.mark.parametrize(
    ("scheme", "periodic", "message"),
    [
        ("overhauser", True, "Overhauser interpolation needs uniform samples"),
        ("overhauser", False, "Overhauser interpolation needs uniform samples"),
        ("spectral", True, "trigonometric interpolation needs uniform samples"),
        ("linear", True, "interpolation 'linear'; known: overhauser, spline, spectral"),
    ],
)
def test_samples_and_schemes_that_do_not_fit_are_refused(scheme: str, periodic: bool, message: str) -> None:
    samples = uneven(12, periodic)
    assert refusal(interpolant, samples, smooth(samples.theta), scheme, error=ValueError) == message


@pytest.mark.parametrize("periodic", PERIODIC)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_products_are_of_the_values(scheme: str, periodic: bool) -> None:
    """With all factors given, and with products of pairs behind the vectors; also beyond the ends of a range."""
    samples = samples_for(scheme, LOWER, UPPER, 12, periodic)
    found = interpolant(samples, random_table(12, 9, 4), scheme)
    theta = np.linspace(LOWER - 0.1, UPPER + 0.1, 157)
    vectors = np.random.default_rng(1).normal(size=(theta.size, 3))
    factors = np.hstack([vectors, pair_products(vectors)])
    expected = np.einsum("ki,kij->kj", factors, found(theta))
    # sums of 36 numbers, up to 1e4 of a polynomial beyond its ends
    tolerance = 1e-13 * (1.0 + np.abs(expected).max())
    np.testing.assert_allclose(found.product(theta, factors), expected, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(found.product(theta, vectors), found.product(theta, factors))
    expected = np.einsum("ki,kij->kj", factors, found(theta, 0))
    tolerance = 1e-13 * (1.0 + np.abs(expected).max())
    np.testing.assert_allclose(found.product(theta, vectors, 0), expected, rtol=0, atol=tolerance)


@pytest.mark.parametrize("periodic", PERIODIC)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_columns_are_fitted_in_blocks(scheme: str, periodic: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    samples = samples_for(scheme, LOWER, UPPER, 12, periodic)
    table = np.random.default_rng(3).normal(size=(12, 3, 5))
    whole = interpolant(samples, table, scheme).rows
    monkeypatch.setattr(module, "COLUMNS", 4)  # four blocks, the last one not full
    # round-off of transforms of some columns or others
    np.testing.assert_allclose(interpolant(samples, table, scheme).rows, whole, rtol=0, atol=1e-12)
    assert interpolant(samples, table[:, :, :0], scheme).rows.shape[1:] == (3, 0)
