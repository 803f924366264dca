"""Generalised-alpha: coefficients, order, steps, observers, and samples that fail."""

import re
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from alike import assert_order, orders
from mpi4py import MPI
from refusals import assert_refused

from benchmarks.called import Called
from pgmp_petsc.base.errors import RunError
from pgmp_petsc.reduced import system as reduced_system
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.scene.numerics import Simulation, count_steps
from pgmp_petsc.stepping import generalised_alpha
from pgmp_petsc.stepping.alpha_step import CAREFUL_ITERATIONS, MAX_ITERATIONS, first_accelerations
from pgmp_petsc.stepping.generalised_alpha import Run, drive_by_petsc, drive_in_a_loop, integrate
from pgmp_petsc.stepping.second_order_system import AT_ONCE, Scheme, SecondOrderSystem, State
from pgmp_petsc.stepping.status import Status

RADII = (0.0, 0.5, 0.8, 1.0)
OF_PETSC = pytest.mark.parametrize("driver", [drive_by_petsc], indirect=True)


@pytest.fixture(params=[drive_by_petsc, drive_in_a_loop], autouse=True)
def driver(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both drivers pass the same tests, but those of PETSc's options."""
    monkeypatch.setattr(generalised_alpha, "driver_here", lambda: request.param)


@dataclass
class LinearSystem(SecondOrderSystem):
    """``M q'' + D q' + K q = f(t)``, n_samples times side by side; arrays of shape (n_samples, n).

    `spoil` is called with time, state and sizes after every correction.
    """

    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    force: object
    q: np.ndarray
    v: np.ndarray
    spoil: object = None
    beyond: float = np.inf
    n_corrections: int = 0
    comm: MPI.Comm = field(default_factory=lambda: MPI.COMM_SELF)
    has_range: bool = True

    @property
    def n_samples(self) -> int:
        return len(self.q)

    def _balance(self, time: float, state: State) -> np.ndarray:
        inertia = state.a @ self.mass.T + state.v @ self.damping.T + state.q @ self.stiffness.T
        return inertia - self.force(time)

    def start(self) -> State:
        state = State(self.q.copy(), self.v.copy(), np.zeros_like(self.q), np.zeros(0))
        state.a = -np.linalg.solve(self.mass, self._balance(0.0, state).T).T
        return state

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        self.n_corrections += 1
        matrix = scheme.gain_a * self.mass + scheme.gain_v * self.damping + self.stiffness
        step = np.linalg.solve(matrix, self._balance(time, state)[..., None])[..., 0]
        step[~active] = 0.0
        state.q -= step
        state.v -= scheme.gain_v * step
        state.a -= scheme.gain_a * step
        size = np.abs(step).max(axis=1)
        if self.spoil is not None:
            self.spoil(time, state, size)
        return size

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        for now, before in ((state.q, previous.q), (state.v, previous.v), (state.a, previous.a)):
            now[samples] = before[samples]

    def outside(self, state: State) -> np.ndarray:
        return np.abs(state.q).max(axis=1) > self.beyond

    def reasons(self, time: float, state: State, samples: np.ndarray) -> np.ndarray:
        return np.full(samples.sum(), Status.NOT_CONVERGED)


def two_masses(n_samples: int = 1, **options: object) -> LinearSystem:
    """Return two damped masses under a constant force that start out of equilibrium, each sample from elsewhere."""
    share = 1.0 + 0.1 * np.arange(n_samples)[:, None]
    return LinearSystem(
        mass=np.diag([1.0, 2.0]), damping=np.array([[0.3, -0.1], [-0.1, 0.1]]),
        stiffness=np.array([[30.0, -10.0], [-10.0, 10.0]]), force=lambda time: np.array([1.0, -2.0]),
        q=share * [0.4, -0.3], v=share * [1.0, 2.0], **options,
    )  # fmt: skip


def exact(system: LinearSystem, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return q, v, a of a system under a constant force, each of shape (n_samples, n)."""
    n = system.q.shape[1]
    inverse = np.linalg.inv(system.mass)
    rate = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ system.stiffness, -inverse @ system.damping]])
    rest = np.concatenate([np.linalg.solve(system.stiffness, system.force(0.0)), np.zeros(n)])
    state = rest + (np.hstack([system.q, system.v]) - rest) @ scipy.linalg.expm(time * rate).T
    return state[:, :n], state[:, n:], ((state - rest) @ rate.T)[:, n:]


class Pendulum(SecondOrderSystem):
    """A unit mass on a massless rod of 1 m: index 3, one multiplier; it starts with a velocity away from rest."""

    comm, n_samples = MPI.COMM_SELF, 1
    ANGLE, SPEED, GRAVITY = 0.8, 2.0, 9.81

    def start(self) -> State:
        q = np.array([np.sin(self.ANGLE), -np.cos(self.ANGLE)])
        v = self.SPEED * np.array([np.cos(self.ANGLE), np.sin(self.ANGLE)])
        pull = self.multiplier(self.ANGLE, self.SPEED)
        return State(q, v, np.array([0.0, -self.GRAVITY]) - pull * q, np.array([pull]))

    @classmethod
    def multiplier(cls, angle: float, speed: float) -> float:
        """Return lambda of ``q'' + q lambda = g``, ``(q.q - 1) / 2 = 0``."""
        return speed**2 + cls.GRAVITY * np.cos(angle)

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        matrix = np.zeros((3, 3))
        matrix[:2, :2] = (scheme.gain_a + state.multipliers[0]) * np.eye(2)
        matrix[:2, 2] = matrix[2, :2] = state.q
        residual = state.a + state.q * state.multipliers[0] - [0.0, -self.GRAVITY]
        step = np.linalg.solve(matrix, np.append(residual, 0.5 * (state.q @ state.q - 1.0)))
        state.q -= step[:2]
        state.v -= scheme.gain_v * step[:2]
        state.a -= scheme.gain_a * step[:2]
        state.multipliers -= step[2]
        return np.array([np.abs(step[:2]).max()])

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        if samples[0]:
            state.q[:], state.v[:], state.a[:] = previous.q, previous.v, previous.a
            state.multipliers[:] = previous.multipliers

    def reasons(self, time: float, state: State, samples: np.ndarray) -> np.ndarray:
        return np.array([Status.NOT_CONVERGED])


def run(system: object, radius: float, step: float, duration: float = 1.0, **options: object) -> Run:
    return integrate(system, Simulation(duration=duration, step=step, spectral_radius=radius), **options)


def amplification(scheme: Scheme, omega_h: float) -> np.ndarray:
    """Return the matrix of a step of ``q'' = -omega^2 q`` on (q, h q', h^2 q'', h^2 A), from the scheme's equations."""
    s = scheme
    left = np.array(
        [
            [1.0, 0.0, 0.0, -s.beta],
            [0.0, 1.0, 0.0, -s.gamma],
            [0.0, 0.0, -(1 - s.alpha_f), 1 - s.alpha_m],
            [omega_h**2, 0.0, 1.0, 0.0],
        ]
    )
    right = np.array(
        [[1.0, 1.0, 0.0, 0.5 - s.beta], [0.0, 1.0, 0.0, 1 - s.gamma], [0.0, 0.0, s.alpha_f, -s.alpha_m], [0.0] * 4]
    )
    return np.linalg.solve(left, right)


@pytest.mark.parametrize("radius", RADII)
def test_the_spectral_radius_at_infinity_is_the_one_asked_for(radius: float) -> None:
    values = np.abs(np.linalg.eigvals(amplification(Scheme.of(radius, 1.0), 1e5)))
    # three eigenvalues meet there: a perturbation of 1e-10 moves them by its cube root at most
    assert values.max() == pytest.approx(radius, abs=2e-3)


@pytest.mark.parametrize("radius", RADII)
def test_it_is_stable_for_every_step_and_damps_high_frequencies_most(radius: float) -> None:
    values = [np.abs(np.linalg.eigvals(amplification(Scheme.of(radius, 1.0), w))).max() for w in np.logspace(-2, 5, 60)]
    assert max(values) <= 1.0 + 1e-6
    assert np.all(np.diff(values) <= 1e-4)


def test_the_extremes_are_known_schemes() -> None:
    trapezoidal = Scheme.of(1.0, 1.0)
    assert (trapezoidal.alpha_m, trapezoidal.alpha_f, trapezoidal.beta, trapezoidal.gamma) == (0.5, 0.5, 0.25, 0.5)
    annihilating = Scheme.of(0.0, 1.0)
    assert (annihilating.alpha_m, annihilating.alpha_f, annihilating.beta, annihilating.gamma) == (-1, 0, 1, 1.5)


@pytest.mark.parametrize("radius", RADII[1:])
def test_second_order_on_a_linear_oscillator(radius: float) -> None:
    errors = []
    for n_steps in (100, 200, 400):
        system = two_masses()
        state = run(system, radius, 1.0 / n_steps).state
        found = zip((state.q, state.v, state.a), exact(system, 1.0))
        errors.append([np.abs(one - other).max() for one, other in found])
    assert_order(errors, within=0.15)


@pytest.mark.parametrize("radius", RADII[1:])
def test_second_order_in_positions_and_velocities_with_a_constraint(radius: float) -> None:
    def rate(_: float, y: np.ndarray) -> list[float]:
        return [y[1], -Pendulum.GRAVITY * np.sin(y[0])]

    start = [Pendulum.ANGLE, Pendulum.SPEED]
    angle, speed = scipy.integrate.solve_ivp(rate, (0, 1), start, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    q, v = np.array([np.sin(angle), -np.cos(angle)]), speed * np.array([np.cos(angle), np.sin(angle)])
    errors = []
    for n_steps in (200, 400, 800):
        state = run(Pendulum(), radius, 1.0 / n_steps).state
        wrong = (state.q - q, state.v - v, state.multipliers - Pendulum.multiplier(angle, speed))
        errors.append([np.abs(one).max() for one in wrong])
    # Without numerical damping the multiplier's error is not damped either: it alternates from step to step and grows
    # with time (Cardona and Geradin 1989), while positions and velocities do not feel it.
    kept = slice(0, 2 if radius == 1.0 else 3)
    observed = orders(errors)[:, kept]
    assert np.all(np.abs(observed - 2.0) < 0.15), observed


@pytest.mark.parametrize("radius", RADII)
def test_the_constraint_holds_at_the_end_of_every_step(radius: float) -> None:
    gaps: list[float] = []
    run(Pendulum(), radius, 0.01, observer=Called(lambda _, __, state: gaps.append(abs(state.q @ state.q - 1.0))))
    assert len(gaps) == 101
    assert max(gaps) < 1e-12  # the tolerance of Newton's iteration


@pytest.mark.parametrize("radius", RADII)
def test_a_constant_acceleration_is_integrated_exactly(radius: float) -> None:
    force = np.array([2.0])
    one, none = np.ones((1, 1)), np.zeros((1, 1))
    system = LinearSystem(one, none, none, lambda _: force, one, -one)
    state = run(system, radius, 0.02).state
    np.testing.assert_allclose([state.q[0, 0], state.v[0, 0], state.a[0, 0]], [1.0, 1.0, 2.0], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("duration", "step", "expected"),
    [
        (1.0, 1e-3, 1000), (1.0, 0.3, 4), (0.3, 0.1, 3), (0.05, 1e-3, 50), (1e-3, 1e-3, 1), (0.7, 0.1, 7),
        (1.0, 0.9999, 2),
    ],
)  # fmt: skip
def test_the_steps_are_equal_and_none_is_longer_than_asked_for(duration: float, step: float, expected: int) -> None:
    n_steps = count_steps(duration, step)
    assert n_steps == expected
    assert duration / n_steps <= step * (1 + 1e-12)
    seen: list[tuple[int, float]] = []
    done = run(two_masses(), 0.8, step, duration, observer=Called(lambda number, time, _: seen.append((number, time))))
    numbers, times = zip(*seen)
    assert done.n_steps == expected
    assert numbers == tuple(range(n_steps + 1))
    # PETSc adds up the steps; the observer's times are without the round-off of that: two operations each, the end
    # exact
    np.testing.assert_allclose(times, np.linspace(0.0, duration, n_steps + 1), rtol=4e-16, atol=0)
    assert times[-1] == duration
    if (duration, step) == (1.0, 1e-3):  # written as they are read
        assert [f"{time!r}" for time in times] == [f"{number / 1000!r}" for number in range(1001)]


@OF_PETSC
def test_drivers_make_the_same_calls_in_the_same_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """State, failures and what is seen agree in every bit, also where samples fail and stops are many steps apart."""
    found = []
    for driver in (drive_by_petsc, drive_in_a_loop):
        monkeypatch.setattr(generalised_alpha, "driver_here", lambda driver=driver: driver)
        seen: list[object] = []
        done = run(
            two_masses(4, beyond=1.05), 0.8, 7e-3, pulse=lambda share: seen.append(("pulse", share)),
            observer=Called(lambda number, time, state: seen.append((number, time, state.q.tobytes()))),
        )  # fmt: skip
        parts = (done.state.q, done.state.v, done.state.a, done.status, done.failure_time)
        found.append((seen, [part.tobytes() for part in parts], done.counted[0]))
    assert found[0] == found[1] and done.status.any() and not done.status.all()
    assert sum(entry[0] == "pulse" for entry in seen) > 1


@pytest.mark.parametrize(
    ("n_samples", "every", "expected"),
    [
        (1, 1, reduced_system.LARGEST // 24), (1000, 1, reduced_system.LARGEST // 24_000), (10**6, 1, 1),
        (1000, 2, 2 * reduced_system.LARGEST // 24_000), (1000, 10**6, reduced_system.FURTHEST // 24_000),
        (1000, None, reduced_system.FURTHEST // 24_000),
    ],
)  # fmt: skip
def test_few_samples_and_what_is_seldom_seen_go_further_at_once(
    n_samples: int, every: int | None, expected: int
) -> None:
    """A step of PETSc's TS is many of a system in compiled code, as many as the cache holds; few of one in Python."""
    system = SimpleNamespace(n_samples=n_samples, n_eta=8)
    assert ReducedSystem.steps_between_looks(system, every) == expected
    assert two_masses(n_samples=2).steps_between_looks(every) == AT_ONCE


def test_stops_are_as_far_apart_as_asked() -> None:
    for at_once in (1, 7, 400, 4000):
        stops = generalised_alpha.stops_of(400, at_once, "pgmp_ts_")
        assert stops[0] == 0 and stops[-1] == 400 and 0 < np.diff(stops).min() <= np.diff(stops).max() <= at_once


def test_the_observer_sees_the_start_and_every_step_as_it_is() -> None:
    system = two_masses()
    seen: list[State] = []
    done = run(system, 0.8, 0.1, observer=Called(lambda _, __, state: seen.append(state.copy())))
    np.testing.assert_array_equal(seen[0].q, system.q)
    np.testing.assert_array_equal(seen[0].v, system.v)
    np.testing.assert_array_equal(seen[-1].q, done.state.q)
    assert len(seen) == 11
    assert done.counted[0] == system.n_corrections


def test_what_an_observer_or_a_system_raises_ends_the_run_as_it_is() -> None:
    def refuse(number: int, time: float, state: State) -> None:
        if number == 3:
            raise RunError("seen enough")

    def fail(time: float, state: State, size: np.ndarray) -> None:
        raise RunError("the linear solver failed")

    assert_refused("seen enough", run, two_masses(), 0.8, 0.1, observer=Called(refuse), error=RunError)
    assert_refused("the linear solver failed", run, two_masses(spoil=fail), 0.8, 0.1, error=RunError)


def assert_same(state: State, other: State, samples: np.ndarray) -> None:
    """Check that some samples of two states agree in every bit."""
    for one, two in ((state.q, other.q), (state.v, other.v), (state.a, other.a)):
        np.testing.assert_array_equal(one[samples], two[samples])


def poison(time: float, state: State, size: np.ndarray) -> None:
    """Let sample 1 become NaN after 0.45 s."""
    if time > 0.45:
        state.q[1], state.v[1], state.a[1], size[1] = np.nan, np.nan, np.nan, np.nan


def stall(time: float, state: State, size: np.ndarray) -> None:
    """Let sample 1 move by 1 for ever after 0.45 s."""
    if time > 0.45:
        size[1] = 1.0


@pytest.mark.parametrize("spoil", [poison, stall])
def test_a_sample_that_fails_stays_where_it_was_and_the_others_go_on(spoil: object) -> None:
    done = run(two_masses(3, spoil=spoil), 0.8, 0.1)
    fine = run(two_masses(3), 0.8, 0.1)
    before = run(two_masses(3), 0.8, 0.1, duration=0.4)
    np.testing.assert_array_equal(done.status, [Status.FINE, Status.NOT_CONVERGED, Status.FINE])
    np.testing.assert_allclose(done.failure_time, [np.nan, 0.5, np.nan], rtol=1e-13)
    assert_same(done.state, fine.state, np.array([0, 2]))
    np.testing.assert_allclose(done.state.q[1], before.state.q[1], rtol=1e-13)
    np.testing.assert_allclose(done.state.v[1], before.state.v[1], rtol=1e-13)
    np.testing.assert_array_equal(fine.status, 0)


def test_a_sample_that_does_not_converge_is_tried_three_times_and_then_given_up() -> None:
    system = two_masses(2, spoil=stall)
    done = run(system, 0.8, 0.1, duration=0.5)
    # four fine steps, then one with both predictions, and with short corrections
    easy = run(two_masses(2), 0.8, 0.1, duration=0.4)
    stalled = done.counted[0] - easy.counted[0]
    first = first_accelerations(two_masses(2), two_masses(2).start(), 0.1, np.ones(2, dtype=bool), 0.8).n_iterations
    assert stalled == 2 * MAX_ITERATIONS + CAREFUL_ITERATIONS + (easy.counted[0] - first) // 8


@pytest.mark.parametrize("radius", [0.0, 0.5, 0.8, 0.99])
def test_a_load_that_sets_in_at_once_on_a_light_mass_throws_it_no_further_than_it_would_swing(radius: float) -> None:
    """The light mass swings between 0 and twice its static displacement; steps are a hundred of its periods long.

    With A_0 = q''_0 it got 13 to 160 times the largest speed of that vibration.
    """
    frequency, step, seen = 2.0 * np.pi * 1e3, 0.1, []
    light = LinearSystem(
        mass=np.diag([1.0, 1.0 / frequency**2]), damping=np.zeros((2, 2)), stiffness=np.diag([1.0, 1.0]),
        force=lambda time: np.array([1.0, 1.0]), q=np.zeros((1, 2)), v=np.zeros((1, 2)),
    )  # fmt: skip
    run(light, radius, step, observer=Called(lambda _, __, state: seen.append(state.copy())))
    assert max(abs(state.q[0, 1]) for state in seen) < 3.0
    assert max(abs(state.v[0, 1]) for state in seen) < frequency
    # the other mass: 1 - cos(t), of second order
    np.testing.assert_allclose(seen[-1].q[0, 0], 1.0 - np.cos(1.0), rtol=0, atol=step**2)


def test_a_sample_that_a_step_to_begin_with_is_too_much_for_begins_with_its_accelerations() -> None:
    def refuse(time: float, state: State, size: np.ndarray) -> None:
        if time < 0.1:  # the half step
            size[1] = np.nan

    asked = np.array([True, True, False])
    found = first_accelerations(two_masses(3, spoil=refuse), two_masses(3).start(), 0.1, asked, 0.8).a
    start = two_masses(3).start().a
    assert not np.array_equal(found[0], start[0])
    np.testing.assert_array_equal(found[1:], start[1:])


def test_the_second_prediction_may_save_a_step() -> None:
    def refuse_first(time: float, state: State, size: np.ndarray) -> None:
        nonlocal attempts
        if 0.45 < time < 0.55 and attempts == 0:
            attempts += 1
            state.q[1], state.v[1], state.a[1], size[1] = np.nan, np.nan, np.nan, np.nan

    attempts = 0
    done = run(two_masses(3, spoil=refuse_first), 0.8, 0.1)
    fine = run(two_masses(3), 0.8, 0.1)
    np.testing.assert_array_equal(done.status, 0)
    assert attempts == 1
    np.testing.assert_allclose(done.state.q, fine.state.q, rtol=0, atol=1e-12)
    assert_same(done.state, fine.state, np.array([0, 2]))


def test_a_sample_that_leaves_the_range_stays_inside_it() -> None:
    done = run(two_masses(4, beyond=1.05), 0.8, 0.01)
    fine = run(two_masses(4), 0.8, 0.01)
    left = done.status == Status.LEFT_RANGE
    assert left.any() and not left.all()
    assert np.all(np.abs(done.state.q[left]).max(axis=1) <= 1.05)
    assert np.all((done.failure_time[left] > 0.0) & (done.failure_time[left] <= 1.0))
    assert np.isnan(done.failure_time[~left]).all()
    assert_same(done.state, fine.state, ~left)


def test_samples_that_are_not_alive_are_never_advanced() -> None:
    alive = np.array([True, False, True])
    system = two_masses(3)
    done = run(system, 0.8, 0.1, alive=alive)
    fine = run(two_masses(3), 0.8, 0.1)
    np.testing.assert_array_equal(done.status, [0, Status.UNPHYSICAL, 0])
    np.testing.assert_array_equal(done.failure_time, [np.nan, 0.0, np.nan])
    np.testing.assert_array_equal(done.state.q[1], system.q[1])
    assert_same(done.state, fine.state, alive)


def test_a_batch_without_a_living_sample_takes_no_corrections() -> None:
    system = two_masses(2)
    seen: list[int] = []
    done = run(system, 0.8, 0.1, alive=np.zeros(2, dtype=bool), observer=Called(lambda number, *_: seen.append(number)))
    assert (system.n_corrections, done.counted[0]) == (0, 0)
    assert seen == list(range(11))
    np.testing.assert_array_equal(done.state.q, system.q)
    np.testing.assert_array_equal(done.failure_time, 0.0)


def test_every_status_has_its_words() -> None:
    assert [int(status) for status in Status] == list(range(9))
    assert len({status.meaning for status in Status}) == 9
    assert all(bool(status.cure("full")) == (status is not Status.FINE) for status in Status)


@pytest.fixture
def options():
    """Return PETSc's options; what a test sets is taken back."""
    from petsc4py import PETSc

    found, names = PETSc.Options(), []

    def put(name: str, value: str | None) -> None:
        names.append(name)
        found.setValue(name, value)

    yield put
    for name in names:
        found.delValue(name)


@pytest.mark.parametrize(
    ("name", "value", "cure"),
    [
        ("ts_max_time", "0.1", "simulation.duration"), ("ts_max_steps", "1", "simulation.duration"),
        ("ts_time_span", "0,0.1", "simulation.duration"), ("ts_dt", "2e-3", "simulation.step"),
        ("ts_type", "euler", "the program's own"), ("ts_exact_final_time", "matchstep", "simulation.duration"),
        ("ts_adapt_type", "basic", "[simulation]"), ("ts_adapt_dt_max", "1e-4", "[simulation]"),
        ("ts_max_snes_failures", "1", "[simulation]"), ("ts_max_reject", "0", "[simulation]"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("prefix", ["pgmp_ts_", "pgmp_error_ts_"])
@OF_PETSC
def test_options_that_would_change_a_run_are_refused(
    options: object, prefix: str, name: str, value: str, cure: str
) -> None:
    options(prefix + name, value)
    system = two_masses()
    assert_refused(rf"option -{prefix}{name} {value}: .*{re.escape(cure)}", run, system, 0.8, 0.1)
    assert system.n_corrections == 0


@OF_PETSC
def test_a_run_that_ends_early_is_an_error_with_petscs_reason(options: object, monkeypatch: pytest.MonkeyPatch) -> None:
    """What no option may do, something else may: the end is looked at, not trusted."""
    monkeypatch.setattr(generalised_alpha, "check_ts_options", lambda: None)
    options("pgmp_ts_ts_view", ":/dev/null")
    assert run(two_masses(), 0.8, 0.1).status[0] == Status.FINE, "what looks on is taken"
    options("pgmp_ts_ts_max_time", "0.3")
    with pytest.raises(RunError, match=r"ended at 0\.3 s of 1 s after 3 of 10 steps: .* reason 1 \(CONVERGED_TIME\)"):
        run(two_masses(), 0.8, 0.1)
