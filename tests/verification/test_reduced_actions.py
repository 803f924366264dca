"""Local effects, damping and drives in the reduced model: virtual work, full-order model, and power."""

import numpy as np
import pytest
from runs import assert_forces_do_the_work, full_model, history, reduced_model, samples

from pgmp_petsc.models import ReducedModel
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.second_order_system import Scheme, State
from scenes import slider_crank

MODES = (
    "reduction.modes=4", "reduction.static_modes=true", "reduction.inertia_modes=true", "reduction.angles=32",
    'reduction.interpolation="spline"',
)  # fmt: skip
OUTPUTS = (
    'outputs.angle={type="angle",joint="crank_hinge"}',
    'outputs.bend={type="deformation",point="rod:tip",axis="x"}',
)
# from rest: the torque and all that follows set in gently
MOVING = ("simulation.initial.theta.position=0.4", "effects.motor.table=[[0.0,0.0],[0.1,1.5],[1.0,1.5]]")
RUN = ("simulation.duration=0.15", "simulation.step=5e-4")
EFFECTS = {
    "spring in a joint": 'effects.extra={type="spring_damper",joint="elbow",stiffness=2.0,damping=0.02,rest=-0.5677}',
    "spring between points": (
        'effects.extra={type="spring_damper",points=["ground:origin","rod:1"],stiffness=300.0,damping=1.0,rest=0.43}'
    ),
    "damper of the slider": 'effects.extra={type="joint_damping",joint="slider",coefficient=3.0}',
    "friction": 'effects.extra={type="joint_friction",joint="elbow",limit=0.2,speed=0.5}',
    "end stop": 'effects.extra={type="end_stop",joint="crank_hinge",upper=0.5,stiffness=400.0,damping=0.05}',
    "following force": (
        'effects.extra={type="force",point="rod:tip",direction=[0.0,1.0],follows=true,table=[[0.0,0.0],[0.05,8.0]]}'
    ),
    "pulling force": (
        'effects.extra={type="force",point="rod:hinge",towards="ground:origin",table=[[0.0,0.0],[0.05,8.0]]}'
    ),
    "rayleigh": 'effects.extra={type="structural_damping",stiffness=2e-4,mass=2.0}',
    "rayleigh of one body": 'effects.extra={type="structural_damping",bodies=["rod"],stiffness=2e-4,mass=2.0}',
    "modal": 'effects.extra={type="structural_damping",ratios=[0.05,0.05]}',
    "drive": 'effects={extra={type="prescribed_motion",coordinate="theta",spin_up={speed=8.0,time=0.1}}}',
}


def scene_with(effect: str, *overrides: str) -> Scene:
    start = () if effect == "drive" else MOVING
    # what acts along the normal of a guide has no static answer: it is left out where a force turns with a body there
    plain = ("reduction.static_modes=false", "reduction.modes=8") if effect == "following force" else ()
    return slider_crank(EFFECTS[effect], *MODES, *plain, *OUTPUTS, *start, *RUN, *overrides)


@pytest.fixture(scope="module")
def models() -> dict[str, ReducedModel]:
    """Return the reduced models; made once."""
    return {}


def model_of(models: dict[str, ReducedModel], effect: str, *overrides: str) -> ReducedModel:
    key = " ".join((effect, *overrides))
    if key not in models:
        models[key] = reduced_model(scene_with(effect, *overrides))
    return models[key]


def anywhere(model: ReducedModel, n: int) -> State:
    random = np.random.default_rng(7)
    n_eta = model.terms.layout.n_eta
    q, v, a = random.normal(size=(3, n, n_eta)) * [1.0, *[1e-3] * (n_eta - 1)]
    q[:, 0] = random.uniform(-3.0, 9.0, n)
    return State(q, 5.0 * v, 50.0 * a, np.zeros(0))


LOCAL = [name for name in EFFECTS if name not in ("rayleigh", "rayleigh of one body", "modal", "drive")]


@pytest.mark.parametrize(
    ("effect", "second_order"),
    [*((effect, False) for effect in LOCAL), ("spring between points", True), ("following force", True)],
)
def test_forces_do_the_work_that_frames_do(models, effect: str, second_order: bool) -> None:
    model = model_of(models, effect, f"reduction.second_order={str(second_order).lower()}")
    state = anywhere(model, 6)
    if effect == "end stop":
        state.q[:, 0] = 0.95
    assert_forces_do_the_work(model, state, samples(model.scene, 6), 0.03)


@pytest.mark.parametrize("effect", list(EFFECTS))
def test_energies_at_several_instants_are_those_of_each(models, effect: str) -> None:
    """Bit for bit: an ensemble's balance must not depend on how many states are looked at together."""
    model, n = model_of(models, effect), 3
    system, times = model.batch(samples(model.scene, n), n), np.array([0.01, 0.02, 0.03, 0.04])
    states = [anywhere(model, n), *(system.start() for _ in times[1:])]
    for k, state in enumerate(states[1:]):
        state.q[:] = states[0].q + 1e-3 * k
        state.v[:] = (1.0 + k) * states[0].v
    together = system.energies_over(times, State.along(states))
    for k, (time, state) in enumerate(zip(times, states)):
        here, there = system.energies(float(time), state), together[n * k : n * (k + 1)]
        parts = [(one.kinetic, one.strain, *one.potential.values(), *one.powers.values()) for one in (here, there)]
        assert here.potential.keys() == there.potential.keys() and here.powers.keys() == there.powers.keys()
        np.testing.assert_array_equal(*parts)


@pytest.mark.parametrize("effect", list(EFFECTS))
def test_newton_converges_with_every_effect(models, effect: str) -> None:
    model = model_of(models, effect)
    state = anywhere(model, 6)
    system = model.batch(samples(model.scene, 6), 6)
    everyone = np.ones(6, dtype=bool)
    scheme = Scheme.of(0.8, 5e-4)
    sizes = [system.correct(0.03, state, scheme, everyone, True).max() for _ in range(4)]
    assert sizes[3] < 1e-4 * sizes[0], sizes


@pytest.mark.parametrize("effect", list(EFFECTS))
def test_the_motion_is_that_of_the_full_order_model(models, effect: str) -> None:
    model = model_of(models, effect)
    scene = model.scene
    values = samples(scene, 2, r1=np.array([5.6e-3, 5.0e-3]))
    time, reduced = history(model, values, 2)
    _, full = history(full_model(scene), values, 2)
    moved = np.ptp(full["angle"])
    assert moved > 0.08
    largest = np.abs(full["bend"]).max()
    # a blow excites more than 4 modes
    of_angle, of_bend = {"end stop": (5e-4, 0.05), "following force": (1e-3, 0.15)}.get(effect, (5e-5, 3e-3))
    if effect == "drive":
        # the angle is given; clamped modes change faster with it than 32 angles follow, 96 leave a third of the error
        of_angle, of_bend = 1e-12, 0.1
    np.testing.assert_allclose(reduced["angle"], full["angle"], rtol=0, atol=of_angle * moved)
    np.testing.assert_allclose(reduced["bend"], full["bend"], rtol=0, atol=of_bend * largest)


@pytest.mark.parametrize("effect", list(EFFECTS))
def test_energy_is_what_powers_bring(models, effect: str) -> None:
    model = model_of(models, effect)
    scene = model.scene
    system = model.batch(samples(scene, 1), 1)
    simulation = scene.simulation.model_copy(update={"step": 1e-4, "spectral_radius": 1.0})
    times, totals, powers = [], [], []

    def record(_: int, time: float, state: State) -> None:
        now = system.energies(time, state)
        times.append(time)
        totals.append(now.kinetic[0] + now.strain[0] + sum(part[0] for part in now.potential.values()))
        powers.append(sum(part[0] for part in now.powers.values()))

    integrate(system, simulation, observer=record)
    totals, powers = np.array(totals), np.array(powers)
    # the work of loads on the deformation is not potential energy: it is in the powers, as the rate of what is
    # interpolated
    work = np.concatenate([[0.0], np.cumsum(0.5 * (powers[1:] + powers[:-1]) * np.diff(times))])
    gained = totals - totals[0]
    np.testing.assert_allclose(gained, work, rtol=0, atol=2e-3 * max(np.ptp(totals), np.ptp(work)))
