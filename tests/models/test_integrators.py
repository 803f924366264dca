"""The benchmark of integrators: the prototype on oscillators whose motion is known, its orders, and the reference."""

import numpy as np
import pytest
from runs import paper_scene, rom_of

from benchmarks import integrators
from benchmarks.exact_oscillators import Course, Motion, Oscillators, Variant, modes_at, sinc
from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.models import ReducedModel
from scenes import RADIUS

STEP = 1e-2
OMEGA = np.array(
    [[0.0, 1e-3, 0.5, 1.9, 2.1, 30.0, 100.0 * np.pi, 640.0]]
)  # xi from 0 to 6.4, 1.9e-2 and 2.1e-2 among them
N = 2
VALUES = {"r1": np.array([RADIUS, 0.8 * RADIUS])}


def parabola(size: float, rise: float, bend: float) -> Course:
    """Return the force ``size + rise x + 1/2 bend (x^2 - x)`` with x from 0 to 1 over a step."""
    ones = np.ones_like(OMEGA)
    return Course(size * ones, (size + rise) * ones, bend * ones)


@pytest.mark.parametrize("force", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (2.0, -1.0, 3.0)])
def test_an_oscillator_under_a_force_is_exact_with_any_step(force: tuple[float, float, float]) -> None:
    """Its motion is a polynomial, and a free vibration about it; where nothing swings, two integrations."""
    oscillators, course = Oscillators(OMEGA, STEP), parabola(*force)
    start = Motion(0.3 * np.ones_like(OMEGA), -2.0 * np.ones_like(OMEGA), np.zeros_like(OMEGA))
    end = oscillators.flight(start, course)
    size, rise, bend = force
    h, free = STEP, OMEGA[0] * STEP < 0.1
    z = 0.3 - 2.0 * h + h**2 * (size / 2.0 + rise / 6.0 - bend / 24.0)
    v = -2.0 + h * (size + rise / 2.0 - bend / 12.0)
    # the softest have swung by no more than (omega h)^2 of it
    np.testing.assert_allclose(end.z[0, free], z, rtol=5e-4)
    np.testing.assert_allclose(end.v[0, free], v - 0.3 * h * OMEGA[0, free] ** 2, rtol=5e-4)
    first, last = oscillators.still(course, False), oscillators.still(course, True)
    xi = OMEGA[0] * h
    stiff = xi > 0.1
    about, rate = (start.z - first.z)[0], (start.v - first.v)[0]
    with np.errstate(all="ignore"):
        z = last.z[0] + about * np.cos(xi) + rate * np.sin(xi) / OMEGA[0]
        v = last.v[0] - about * OMEGA[0] * np.sin(xi) + rate * np.cos(xi)
    np.testing.assert_allclose(end.z[0, stiff], z[stiff], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(end.v[0, stiff], v[stiff], rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(end.a, course.ahead - OMEGA**2 * end.z, rtol=0, atol=0)


def test_series_and_quotients_meet() -> None:
    below, above = (Oscillators(np.array([[xi / STEP]]), STEP) for xi in (0.02 * (1 - 1e-9), 0.02 * (1 + 1e-9)))
    rest = Motion(*np.zeros((3, 1, 1)))
    for force in np.eye(3):
        course = Course(*(np.array([[value]]) for value in (force[0], force[0] + force[1], force[2])))
        one, other = below.flight(rest, course), above.flight(rest, course)
        np.testing.assert_allclose(one.z, other.z, rtol=1e-6)
        np.testing.assert_allclose(one.v, other.v, rtol=1e-6)


@pytest.fixture(scope="module")
def model() -> ReducedModel:
    """Return a model of few modes that turns at 20 rad/s under a rising torque without corners."""
    run = ("simulation.duration=0.02", "simulation.step=1e-4", "simulation.initial.theta.velocity=20.0")
    scene = paper_scene("reduction.modes=4", "reduction.angles=24", "reduction.second_order=true", *run)
    return ReducedModel(scene, rom_of(scene))


def test_modes_are_those_of_the_tables(model: ReducedModel) -> None:
    weights = np.broadcast_to(evaluate_weights(model.terms.weights, VALUES).T, (N, len(model.terms.weights)))
    theta = np.array([0.3, 1.0])
    modes = modes_at(model.terms, weights, theta)
    system = model.batch({"r1": np.repeat(VALUES["r1"], 6)}, 6 * N)
    q = np.concatenate([theta[:, None], np.zeros((N, 4))], axis=1)
    # M a = - K q for the shape of a vibration: a = - omega^2 q
    for k in range(1, 5):
        shape = 1e-9 * modes.shapes[:, :, k]
        found = integrators.accelerations(system, 0.0, q + shape, np.zeros_like(q)) - integrators.accelerations(
            system, 0.0, q, np.zeros_like(q)
        )
        np.testing.assert_allclose(
            found, -(modes.omega[:, k : k + 1] ** 2) * shape, rtol=0, atol=2e-5 * np.abs(found).max()
        )


@pytest.fixture(scope="module")
def exact(model: ReducedModel) -> dict[str, np.ndarray]:
    return integrators.reference(model, VALUES, N, 25, 1e-10)


def angle_errors(model: ReducedModel, exact: dict[str, np.ndarray], variant: Variant) -> np.ndarray:
    """Return errors of the crank's angle with steps of 0.8, 0.4 and 0.2 ms."""
    runs = (integrators.by_prototype(model, VALUES, N, n_steps, variant)[0] for n_steps in (25, 50, 100))
    return np.array([integrators.errors_of(found, exact)["crank_angle"].max() for found in runs])


def test_the_observed_order(model: ReducedModel, exact: dict[str, np.ndarray]) -> None:
    """Two; with a bend the force of slow parts is better by an order, until vibrations are what is left."""
    linear = angle_errors(model, exact, Variant("linear", 50))
    for errors in (linear, angle_errors(model, exact, Variant("filtered", 50, sinc))):
        np.testing.assert_allclose(np.log2(errors[:-1] / errors[1:]), 2.0, atol=0.2)
    for corrections in (3, 50):
        curved = angle_errors(model, exact, Variant("curved", corrections, curved=True))
        assert np.all(curved < [0.3, 0.1, 0.1] * linear)


def test_the_reference_is_where_the_programs_steps_lead(model: ReducedModel, exact: dict[str, np.ndarray]) -> None:
    errors = [integrators.errors_of(integrators.by_alpha(model, VALUES, N, n)[0], exact) for n in (6400, 12800)]
    for name in exact:
        coarse, fine = (item[name].max() for item in errors)
        assert fine < 1e-3 and coarse == pytest.approx(4.0 * fine, rel=0.2), name


def test_the_cheapest_of_equal_errors() -> None:
    def item(scheme: str, step: float, worst: float) -> integrators.Result:
        return integrators.Result("ramp", scheme, step, {"x": np.array([0.1 * worst, worst])}, 2.0)

    cost = integrators.Prices(1.0, 0.25)
    results = [item(integrators.ALPHA, 1e-3, 1e-4), item(integrators.ALPHA, 5e-3, 1e-3), item("held", 5e-3, 1e-4)]
    assert integrators.cheapest(results, "x", 2e-3, cost) == (pytest.approx(300.0), results[2])
    assert integrators.cheapest(results[:2], "x", 2e-3, cost) == (pytest.approx(400.0), results[1])
    assert integrators.cheapest(results[:2], "x", 5e-4, cost) == (pytest.approx(2000.0), results[0])
    assert integrators.cheapest(results, "x", 1e-5, cost) is None
