"""Extremes of histories, and what parameters do to them, against closed forms and differences."""

import numpy as np
import pytest

from pgmp_petsc.results.gradients import Vertex, vertex

SIZE, DECAY, OMEGA, LATE = 2.0, 0.5, 9.0, 0.3


def history(time: np.ndarray, size: float = SIZE, late: float = LATE) -> np.ndarray:
    """Return a vibration that dies away."""
    return size * np.exp(-DECAY * time) * np.cos(OMEGA * (time - late))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_extremes_of_a_vibration_and_their_derivatives(sign: float) -> None:
    """``tan(omega (t - late)) = - decay / omega`` at both: later they are smaller, and nothing else.

    The closed form is met with order 2, where an instant next to the extreme has order 1.
    """
    turn = (0.0 if sign > 0.0 else np.pi) - np.arctan(DECAY / OMEGA)
    exact = LATE + turn / OMEGA
    largest = history(np.array([exact]))[0]
    expected = np.array([largest / SIZE, -DECAY * largest])  # with the size, and with how late it is
    errors = []
    for step in (0.02, 0.01, 0.005):
        time = np.arange(0.2, 0.9, step) + 0.003
        size = history(time) / SIZE
        late = SIZE * np.exp(-DECAY * time) * OMEGA * np.sin(OMEGA * (time - LATE))
        values, slopes = history(time), np.array([size, late])
        place = vertex(values, sign)
        assert abs(place.offset) <= 0.5 and time[place.at] == pytest.approx(exact, abs=0.5 * step)
        assert place.of(values) == pytest.approx(largest, rel=0.1 * (OMEGA * step) ** 4 + 1e-12)
        errors.append(np.abs(place.of(slopes) - expected).max())
        # an instant has besides its distance from the extreme times the second derivative
        at_instant = slopes[1, place.at] - expected[1]
        assert at_instant == pytest.approx((time[place.at] - exact) * OMEGA**2 * largest, rel=0.1)
    # order 2: a quarter, and measured 8e-3 at the first
    assert errors[0] < 0.02 and errors[1] < 0.35 * errors[0] and errors[2] < 0.35 * errors[1]


def test_the_derivative_is_that_of_the_vertex() -> None:
    """Of values without any smoothness, to round-off of central differences."""
    random = np.random.default_rng(1)
    values, slopes, h = random.normal(size=9), random.normal(size=(3, 9)), 1e-5
    values[4] += 5.0
    for row in slopes:
        ahead, behind = (vertex(v, 1.0).of(v) for v in (values + h * row, values - h * row))
        assert vertex(values, 1.0).of(row) == pytest.approx((ahead - behind) / (2.0 * h), rel=1e-7, abs=1e-8)


@pytest.mark.parametrize(
    ("values", "sign", "expected"),
    [
        ([3.0, 1.0, 0.0], 1.0, Vertex(0, 0.0)),
        ([3.0, 1.0, 0.0], -1.0, Vertex(2, 0.0)),
        ([1.0, 1.0, 1.0], 1.0, Vertex(0, 0.0)),
        ([0.0, 1.0, 1.0, 0.0], 1.0, Vertex(1, 0.5)),
        ([2.0], -1.0, Vertex(0, 0.0)),
        ([0.0, 1.0, 0.0], 1.0, Vertex(1, 0.0)),
    ],
)
def test_ends_and_plateaus(values: list[float], sign: float, expected: Vertex) -> None:
    assert vertex(np.array(values), sign) == expected
