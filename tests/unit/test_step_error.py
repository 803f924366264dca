"""The error of the time step: exact for oscillators and rigid motions whose solution is known, whatever the step."""

from __future__ import annotations

import numpy as np
import pytest
from runs import paper_scene, rom_of
from scenes import RADIUS

from pgmp_petsc.dynamics.generalised_alpha import GeneralisedAlpha
from pgmp_petsc.dynamics.second_order_system import Scheme, State
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.indicator.edge_crossings import NONE, EdgeCrossings
from pgmp_petsc.indicator.flexible_modes import LEAST, FlexibleModes, Modes, _factors
from pgmp_petsc.indicator.step_error import StepError, Turns, find_turns
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduction.rom import ReducedOrderModel

STEP = 1e-3


def no_edge(n_steps: int, n: int = 1) -> np.ndarray:
    """Return that steps of n samples cross no edge."""
    return np.full((n_steps, n), NONE)


class Oscillators:
    """Oscillators ``x'' + 2 z x' + omega^2 x = force (1 + t)`` beside an angle with ``theta'' = 6 t``.

    In reduced coordinates, ``delta = shapes x`` and ``theta = t^3 - follow.delta``.
    """

    comm = None
    n_samples = 1
    n_events, settled = 0, None

    def __init__(self, modes: Modes, force: np.ndarray) -> None:
        self.modes, self.force = modes, force

    def start(self) -> State:
        rest = np.zeros((1, 1 + self.force.size))
        return State(rest, rest.copy(), np.concatenate([[0.0], self.force])[None], np.zeros(0))

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        x, x_2 = state.q[0, 1:], state.a[0, 1:]
        omega, brake = self.modes.omega[0], 2.0 * self.modes.decay[0]
        residual = x_2 + brake * state.v[0, 1:] + omega**2 * x - self.force * (1.0 + time)
        change = -residual / (scheme.gain_a + brake * scheme.gain_v + omega**2)
        turn = np.array([-(state.a[0, 0] - 6.0 * time) / scheme.gain_a])
        step = np.concatenate([turn, change])
        state.q[0] += step
        state.v[0] += scheme.gain_v * step
        state.a[0] += scheme.gain_a * step
        return np.array([np.abs(step).max()])

    def outside(self, state: State) -> np.ndarray:
        return np.zeros(1, dtype=bool)

    def reasons(self, time: float, state: State, samples: np.ndarray) -> np.ndarray:
        return np.array([Status.NOT_CONVERGED])

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        if samples.any():
            state.q, state.v, state.a = previous.q, previous.v, previous.a

    def reduced(self, state: State) -> list[np.ndarray]:
        """Return q, v, a in reduced coordinates."""
        delta = [part[:, 1:] @ self.modes.shapes[0].T for part in (state.q, state.v, state.a)]
        whole = [part[:, :1] - d @ self.modes.follow[0].T for part, d in zip((state.q, state.v, state.a), delta)]
        return [np.hstack([w, d]) for w, d in zip(whole, delta)]


def made_up_modes(frequencies: list[float], ratios: tuple[float, ...] = (0.0,)) -> Modes:
    """Return modes with shapes that are not orthogonal, damping ratios, and a rigid coordinate that follows."""
    random = np.random.default_rng(3)
    n = len(frequencies)
    shapes = random.normal(size=(1, n, n))
    omega = 2 * np.pi * np.array([frequencies])
    follow = random.normal(size=(1, 1, n))
    return Modes(omega, omega * ratios, shapes, np.linalg.inv(shapes), follow, np.zeros_like(follow))


@pytest.mark.parametrize(("held", "ratios"), [(1, (0.0,)), (7, (0.0,)), (400, (0.0,)), (7, (0.02, 0.3, 1.5))])
def test_the_motion_and_its_error_are_the_exact_motion(held: int, ratios: tuple[float, ...]) -> None:
    """Frequencies from a twentieth of the step's to one that it cannot see at all; modes taken anew, or not; damping
    beyond the critical one."""
    modes = made_up_modes([50.0, 240.0, 900.0], ratios)
    force = np.array([1.0, 50.0, 3000.0])
    system = Oscillators(modes, force)
    stepper = GeneralisedAlpha(system, 0.8, 400 * STEP, 400, np.ones(1, dtype=bool), np.arange(401), None, None)
    error = StepError(STEP, np.array(system.reduced(stepper.state)), modes)
    motion = []
    for number in range(1, 401):
        stepper.advance()
        motion.append(system.reduced(stepper.state))
        if number % held and number < 400:
            continue
        exact, missing = error.advance(np.array(motion), no_edge(len(motion)))
        error.hold(np.array([0]), modes)
        time = STEP * np.arange(number - len(motion) + 1, number + 1)[:, None]
        omega, follow = modes.omega[0], modes.follow[0]
        z = modes.decay[0]
        turning = np.sqrt(omega**2 - z**2 + 0j)
        roots = -z + 1j * turning, -z - 1j * turning
        behind, rate = 1.0 - 2.0 * z / omega**2, np.ones(3)  # of the steady motion at the start, over force / omega^2
        parts = (rate - roots[1] * behind) / (2j * turning), (roots[0] * behind - rate) / (2j * turning)
        free = np.real(sum(part * np.exp(root * time) for part, root in zip(parts, roots)))
        x = force / omega**2 * (time + behind - free)
        delta = x @ modes.shapes[0].T
        found = np.array(motion)[:, 0, 0, 1:] + missing[:, 0, 1:]
        np.testing.assert_allclose(found, delta, rtol=0, atol=1e-9 * np.abs(delta).max())
        # the rigid sum has accelerations linear in time, which every rule integrates exactly
        for part, expected in enumerate((time**3, 3 * time**2)):
            rigid = exact[:, part, 0, 0] + exact[:, part, 0, 1:] @ follow[0]
            np.testing.assert_allclose(rigid, expected[:, 0], rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(missing[:, 0, 0], -missing[:, 0, 1:] @ follow[0], rtol=1e-9, atol=1e-18)
        motion.clear()
    if not any(ratios):
        assert np.abs(missing).max() > 0.1 * np.abs(delta).max(), "there was something to correct"


def test_modes_are_taken_on_the_way_as_between_two_calls() -> None:
    """Bit for bit, of two samples whose modes change after different steps, all samples or one at once."""
    random = np.random.default_rng(5)
    start, motion = random.normal(size=(3, 2, 4)), random.normal(size=(9, 3, 2, 4))

    def modes(n: int) -> Modes:
        shapes, omega = random.normal(size=(n, 3, 3)), random.uniform(50.0, 900.0, (n, 3))
        follow = random.normal(size=(n, 1, 3))
        return Modes(omega, 0.02 * omega, shapes, np.linalg.inv(shapes), follow, np.zeros_like(follow))

    first, others = modes(2), modes(4)
    turns = ((3, [0, 1]), (5, [1]), (9, [0]))
    at_once, in_parts = StepError(STEP, start, first), StepError(STEP, start, first)
    places = np.repeat([place for place, _ in turns], [len(samples) for _, samples in turns])
    who = np.concatenate([samples for _, samples in turns])
    edges = no_edge(9, 2)
    edges[4] = 0.3, 0.8
    found = [at_once.advance(motion, edges, Turns(places, who, others)), at_once.advance(motion, edges)]
    expected, done, taken = [], 0, 0
    for place, samples in turns:
        expected.append(in_parts.advance(motion[done:place], edges[done:place]))
        chosen = slice(taken, taken + len(samples))
        in_parts.hold(np.array(samples), Modes(*(part[chosen] for part in vars(others).values())))
        done, taken = place, chosen.stop
    expected.append(in_parts.advance(motion, edges))
    for which in range(2):
        joined = np.concatenate([part[which] for part in expected])
        np.testing.assert_array_equal(np.concatenate([part[which] for part in found]), joined)


def test_samples_turn_where_they_leave_the_range_of_their_modes() -> None:
    """Against the definition, look by look; a coordinate that is no number has left any range."""
    rng, hold = np.random.default_rng(5), 0.03
    motion = rng.normal(size=(40, 2, 3, 4))
    motion[:, 0, :, :2] = np.cumsum(0.1 * hold * motion[:, 1, :, :2], axis=0)
    motion[30:, 0, 2, 1] = np.nan
    looks, middles = np.arange(3, 40, 4), 0.3 * hold * rng.normal(size=(3, 2))
    expected, here = [], middles.copy()
    for look in looks:
        for sample in range(3):
            theta, rate = motion[look, :, sample, :2]
            if not (np.abs(theta - here[sample]) <= 0.5 * hold).all():
                here[sample] = theta + 0.5 * np.copysign(hold, rate)
                expected.append((look + 1, sample, *here[sample]))
    room = np.empty(30, dtype=np.int64), np.empty(30, dtype=np.int64), np.empty((30, 2))
    n = find_turns(motion, looks, hold, middles, *room)
    assert 5 < n < 30
    np.testing.assert_array_equal(np.column_stack([part[:n] for part in room]), expected)
    np.testing.assert_array_equal(middles, here)


def test_a_prescribed_coordinate_whose_acceleration_jumps_gives_the_impulse_of_its_speed() -> None:
    """From rest into a steady acceleration, of which the first step sees the end alone: what a mode lacks is half a
    step of it as an impulse at the start, and what is left after it is of second order."""
    omega, drag, rate, n = 2 * np.pi * 40.0, 0.7, 900.0, 50
    one = np.ones((1, 1, 1))
    modes = Modes(np.full((1, 1), omega), np.zeros((1, 1)), one, one, 0.0 * one, drag * one)
    left = []
    for step in (STEP, STEP / 4):
        time = step * np.arange(n * round(STEP / step) + 1)
        # the run: exact under a force that rises over the first step
        ramp, steady = -drag * rate / step, -drag * rate
        swing = (np.sin(omega * np.minimum(time, step)) / omega, np.sin(omega * (time - step)) / omega)
        x = ramp / omega**2 * (np.minimum(time, step) - swing[0])
        v = ramp / omega**2 * (1.0 - np.cos(omega * np.minimum(time, step)))
        later, turn = time > step, omega * (time - step)
        free = (x - steady / omega**2) * np.cos(turn) + v * np.sin(turn) / omega + steady / omega**2
        x, v = (
            np.where(later, free, x),
            np.where(later, v * np.cos(turn) - omega * (x - steady / omega**2) * np.sin(turn), v),
        )
        a = np.where(time >= step, steady, 0.0) - omega**2 * x
        theta = np.array([0.5 * rate * time**2, rate * time, np.where(time > 0.0, rate, 0.0)])
        states = np.stack([theta.T, np.array([x, v, a]).T], axis=2)[:, :, None, :]
        error = StepError(step, states[0], modes, driven=(0,))
        _, missing = error.advance(states[1:], no_edge(time.size - 1))
        exact = steady / omega**2 * (1.0 - np.cos(omega * time[1:]))
        lacked, found = exact - x[1:], missing[:, 0, 1]
        left.append(np.abs(found - lacked).max() / np.abs(lacked).max())
        assert np.abs(lacked).max() == pytest.approx(0.5 * step * drag * rate / omega, rel=0.05)
    # an impulse at the start stands for one that acts a third of the step later
    assert left[0] < 1.1 * omega * STEP / 3.0 and left[1] < 0.3 * left[0]


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_accelerations_that_bend_at_an_edge_are_integrated_up_to_it_and_on(share: float) -> None:
    """Of two straight pieces nothing is left; a polynomial across the edge leaves ``share (1 - share) / 2 - 1 / 12`` of
    the change of slope times the squared step, by hand from the weights of fourth order."""
    none = np.zeros((1, 0))
    modes = Modes(none, none, np.zeros((1, 0, 0)), np.zeros((1, 0, 0)), np.zeros((1, 1, 0)), np.zeros((1, 1, 0)))
    before, after, n, at = 3.0, -200.0, 40, 17
    time = STEP * np.arange(n + 1)
    beyond = np.maximum(time - STEP * (at + share), 0.0)
    bent = after - before
    a, v = before * time + bent * beyond, before * time**2 / 2 + bent * beyond**2 / 2
    states = np.array([np.zeros(n + 1), v, a]).T[:, :, None, None]
    crossed = no_edge(n)
    crossed[at] = share
    found = []
    for edges in (crossed, no_edge(n)):
        exact, _ = StepError(STEP, states[0], modes).advance(states[1:], edges)
        found.append(exact[-1, 1, 0, 0] - v[-1])
    kick = bent * STEP**2
    assert abs(found[0]) < 1e-9 * abs(kick)
    assert found[1] == pytest.approx((share * (1.0 - share) / 2.0 - 1.0 / 12.0) * kick, rel=1e-8)


def test_edges_are_found_between_the_ends_of_steps_call_by_call(stop_model: ReducedModel) -> None:
    """Of an angle that is given: two samples, one of which enters a stop, leaves it and enters it again."""
    n_eta = 1 + stop_model.terms.tables.n_modes
    motion = np.zeros((8, 3, 2, n_eta))
    motion[:, 0, 0, 0] = [0.0, 0.3, 0.7, 0.9, 0.8, 0.4, 0.2, 0.6]
    motion[:, 0, 1, 0] = 0.1
    time = STEP * np.arange(8)
    crossings = EdgeCrossings(stop_model, {"r1": np.full(2, RADIUS)}, motion[0])
    shares = np.concatenate([crossings.over(time[part], motion[part]) for part in (slice(1, 4), slice(4, 8))])
    expected = no_edge(7, 2)
    expected[[1, 4, 6], 0] = 0.5, 0.75, 0.75
    np.testing.assert_allclose(shares, expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(crossings.shortest, [3.25 * STEP, np.inf], rtol=1e-9)


@pytest.fixture(scope="module")
def stop_model() -> ReducedModel:
    stop = 'effects.limit={type="end_stop", joint="crank_hinge", upper=0.5, stiffness=100.0}'
    scene = paper_scene("reduction.modes=4", "reduction.angles=24", stop)
    return ReducedModel(scene, rom_of(scene))


@pytest.fixture(scope="module")
def small_rom() -> ReducedOrderModel:
    return rom_of(paper_scene("reduction.modes=4", "reduction.angles=24"))


def test_modes_are_those_of_the_tables(small_rom: ReducedOrderModel) -> None:
    tables = small_rom.tables
    modes_at = FlexibleModes(tables, "overhauser")
    theta = tables.samples.axes[0].theta
    for radius in (RADIUS, 0.8 * RADIUS):
        weights = modes_at.weights({"r1": np.full(theta.size, radius)}, theta.size)
        found = modes_at.at(theta[:, None], weights)
        expected = tables.frequencies_hz(weights[0][0], weights[1][0])
        np.testing.assert_allclose(found.omega / (2 * np.pi), expected, rtol=1e-9)
        np.testing.assert_allclose(
            found.inverse @ found.shapes, np.broadcast_to(np.eye(4), (theta.size, 4, 4)), atol=1e-9
        )
        mass = np.einsum("ntij,nt->nij", tables.mass, weights[0])
        # a vibration has no momentum of the rigid motion
        momentum = mass[:, 0, 1:] - mass[:, :1, 0] * found.follow[:, 0]
        np.testing.assert_allclose(momentum, 0.0, atol=1e-15)


def test_modes_where_there_are_none(small_rom: ReducedOrderModel) -> None:
    """Beyond a limited range those of its end; a matrix that lost its definiteness spoils no other sample's."""
    modes_at = FlexibleModes(small_rom.tables, "overhauser")
    weights = modes_at.weights({"r1": np.full(3, RADIUS)}, 3)
    found = modes_at.at(np.array([[np.nan], [1e30], [0.0]]), weights)
    np.testing.assert_allclose(found.omega, np.broadcast_to(found.omega[2], (3, 4)), rtol=1e-9)
    matrices = np.array([np.diag([4.0, 9.0]), np.diag([4.0, -1e-9])])
    factors = _factors(matrices)
    np.testing.assert_allclose(factors[0], np.diag([2.0, 3.0]), rtol=1e-12)
    assert np.isfinite(factors).all() and (np.diagonal(factors[1]) > 0).all()


@pytest.mark.parametrize("least", [-0.2, 0.0, 1e-9, 1e-5])
def test_inertia_that_comes_to_nothing_between_samples_is_taken_for_a_small_one(least: float) -> None:
    """And what is definite enough stays what it is, to the last bit."""
    sound = np.array([[2.0, 0.3], [0.3, 1.0]])
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    spoilt = turn @ np.diag([least, 2.0]) @ turn.T
    factors = _factors(np.array([sound, spoilt]))
    np.testing.assert_array_equal(factors[0], np.linalg.cholesky(sound))
    found = np.linalg.eigvalsh(factors[1] @ factors[1].T)
    np.testing.assert_allclose(found, [2.0 * LEAST, 2.0], rtol=1e-9)
