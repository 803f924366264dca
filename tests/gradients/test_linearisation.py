"""Residual and exact derivatives of the reduced equations against the engine's residual and differences of it."""

import numpy as np
import pytest
from runs import FEW_MODES, reduced_model
from two_coordinates import double_pendulum

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.gradients.linearisation import Linearisation, Linearised
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.stepping.second_order_system import State
from scenes import slider_crank

LOADS = ("parameters.g={nominal=9.81}", 'effects.weight={type="gravity",acceleration="g"}')
DAMPING = ('effects.material={type="structural_damping",stiffness=2e-4,mass=2.0}',)
SPRING = (
    'parameters.k={nominal=300.0}', 'parameters.c={nominal=2.0}',
    'effects.spring={type="spring_damper",points=["ground:origin","rod:1"],stiffness="k",damping="c",rest=0.43}',
)  # fmt: skip
FRICTION_IN_JOINT = (
    "parameters.limit={nominal=0.2}",
    'effects.friction={type="joint_friction",joint="elbow",limit="limit",speed=0.5}',
)
SLOW = ('effects.velocities={type="gyroscopic",keep=false}',)
SECOND = ("reduction.second_order=true",)
SCENES = {
    "first order": slider_crank(*FEW_MODES, *LOADS),
    "second order": slider_crank(*FEW_MODES, *LOADS, *SECOND, *DAMPING),
    "without inertia of velocities": slider_crank(*FEW_MODES, *LOADS, *SLOW, *DAMPING),
    "spring and damper": slider_crank(*FEW_MODES, *LOADS, *SPRING),
    "friction": slider_crank(*FEW_MODES, *FRICTION_IN_JOINT),
    "two coordinates": double_pendulum(*SECOND, "parameters.g={nominal=9.81}", LOADS[1]),
}
N_TIMES = 3


@pytest.fixture(scope="module", params=list(SCENES))
def model(request) -> ReducedModel:
    return reduced_model(SCENES[request.param])


def somewhere(model: ReducedModel) -> tuple[np.ndarray, State]:
    """Return instants and states in the middle of cells, with all terms of a size that counts."""
    random, layout = np.random.default_rng(3), model.terms.layout
    r, n = len(layout.rigid), layout.n_eta
    q, v, a = random.normal(size=(3, N_TIMES, n)) * [*[1.0] * r, *[1e-2] * (n - r)]
    for k, axis in enumerate(model.terms.grid):
        q[:, k] = axis.lower + axis.step * (random.integers(axis.n_cells, size=N_TIMES) + 0.4)
    return np.linspace(0.01, 0.2, N_TIMES), State(q, 3.0 * v, 30.0 * a, np.zeros(0))


def engine_residual(model: ReducedModel, times: np.ndarray, states: State, **changed: float) -> np.ndarray:
    values = {name: np.array([changed.get(name, value)]) for name, value in model.scene.values.items()}
    system, rows = model.batch(values, 1), []
    for k, time in enumerate(times):
        one = (np.array(part[k : k + 1]) for part in (states.q, states.v, states.a))
        rows.append(system.residual(float(time), State(*one, np.zeros(0)))[0])
    return np.array(rows)


def slopes(residual, step: float) -> np.ndarray:
    """Return the derivative by differences of fourth order."""
    return (residual(-2 * step) - 8 * residual(-step) + 8 * residual(step) - residual(2 * step)) / (12 * step)


def near(found: np.ndarray, expected: np.ndarray, residual: np.ndarray, step: float, relative: float = 1e-9) -> None:
    """Compare, with what rounding of the residual leaves of its differences."""
    rounding = 1e-14 * np.abs(residual).max() / step
    np.testing.assert_allclose(found, expected, rtol=0, atol=relative * np.abs(expected).max() + rounding)


def linearised(model: ReducedModel, times: np.ndarray, states: State) -> Linearised:
    return Linearisation(model, model.scene.values, list(model.scene.parameters)).at(times, states)


def test_the_residual_is_that_of_the_engine(model: ReducedModel) -> None:
    times, states = somewhere(model)
    expected = engine_residual(model, times, states)
    found = linearised(model, times, states).residual
    # two orders of summation
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(expected).max())


def test_derivatives_are_those_of_the_engine_s_residual(model: ReducedModel) -> None:
    times, states = somewhere(model)
    found, residual = linearised(model, times, states), engine_residual(model, times, states)
    n, r = model.terms.layout.n_eta, len(model.terms.layout.rigid)
    for part, by in (("q", found.by_q), ("v", found.by_v), ("a", found.by_a)):
        for j in range(n):
            # tables are polynomials within a cell; velocities enter at most squared, but in a friction law
            step = 1.0 if j < r else 1e-2
            if part == "v" and "friction" in model.scene.effects:
                step = 1e-3 if j < r else 1e-3 / model.terms.scale[j]
            if part == "q":
                step = 1e-4 if j < r else 1e-3 / model.terms.scale[j]

            def moved(h: float) -> np.ndarray:
                other = states.copy()
                getattr(other, part)[:, j] += h
                return engine_residual(model, times, other)

            # differences of local effects' gradients leave 1e-8; truncation is left of a friction law, no polynomial
            relative = 1e-5 if "friction" in model.scene.effects else 1e-7 if model.actions.actions else 1e-9
            near(by[:, :, j], slopes(moved, step), residual, step, relative)


def test_derivatives_with_parameters_are_those_of_the_engine_s_residual(model: ReducedModel) -> None:
    times, states = somewhere(model)
    found, residual = linearised(model, times, states), engine_residual(model, times, states)
    for number, (name, value) in enumerate(model.scene.values.items()):
        expected = slopes(lambda h: engine_residual(model, times, states, **{name: value + h}), 1e-3 * value)
        near(found.by_parameters[:, number], expected, residual, 1e-3 * value)
        assert np.abs(expected).max() > 0.0


def test_an_instant_is_linearised_alone_as_among_others(model: ReducedModel) -> None:
    """To the last bit: whatever cells the others are in, and with one parameter or all."""
    times, states = somewhere(model)
    turns = np.array([0, 1, 1, 2, 0, 1, 1, 1, 1, 1, 1, 1, 1, 2])  # more of one cell than there are lanes
    many = State(states.q[turns], states.v[turns], states.a[turns], states.multipliers)
    many.q[:, -1] *= np.linspace(1.0, 2.0, turns.size)
    names = list(model.scene.parameters)
    together = Linearisation(model, model.scene.values, names).at(times[turns], many)
    for k in range(turns.size):
        one = State(many.q[k : k + 1], many.v[k : k + 1], many.a[k : k + 1], many.multipliers)
        alone = Linearisation(model, model.scene.values, names[-1:]).at(times[turns[k : k + 1]], one)
        for part in ("by_q", "by_v", "by_a", "residual"):
            np.testing.assert_array_equal(getattr(alone, part)[0], getattr(together, part)[k])
        np.testing.assert_array_equal(alone.by_parameters[0, 0], together.by_parameters[k, -1])


def test_the_derivative_with_time_is_that_of_the_engine_s_residual() -> None:
    """Loads that set in over a table and a wave, and a force that follows its body, which is none."""
    jet = 'type="force",point="rod:1",direction=[0.0,1.0],follows=true,harmonic={amplitude=4.0,frequency_hz=3.0}'
    push = 'type="force",point="rod:tip",direction=[1.0,0.0],harmonic={amplitude=9.0,frequency_hz=2.0}'
    model = reduced_model(slider_crank(*FEW_MODES, f"effects.jet={{{jet}}}", f"effects.push={{{push}}}"))
    times, states = somewhere(model)
    found = Linearisation(model, model.scene.values, ["r1"]).at(times, states, by_time=True)
    expected = slopes(lambda h: engine_residual(model, times + h, states), 1e-4)
    near(found.by_parameters[:, -1], expected, engine_residual(model, times, states), 1e-4)
    alone = Linearisation(model, model.scene.values, ["r1"]).at(times, states)
    np.testing.assert_array_equal(found.by_parameters[:, :1], alone.by_parameters)


def test_monomials_are_differentiated() -> None:
    monomial, values = Monomial((("E", 1), ("r", 4))), {"E": 2.0, "r": 3.0, "other": 1.0}
    assert monomial.derivative("E", values) == 81.0
    assert monomial.derivative("r", values) == 2.0 * 4.0 * 27.0
    assert monomial.derivative("other", values) == 0.0
    assert Monomial((("r", -1),)).derivative("r", values) == pytest.approx(-1.0 / 9.0, rel=1e-15)
