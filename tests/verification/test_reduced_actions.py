"""Local effects, damping and drives in the reduced model, in the plane and on solids in space: virtual work,
full-order model, and power."""

from functools import lru_cache

import numpy as np
import pytest
from runs import (
    FEW_MODES,
    assert_forces_do_the_work,
    full_model,
    history,
    motion,
    reduced_model,
    rom_of,
    samples,
    still,
)
from spatial import arm, part_of_arm, slider_crank_in_space

from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduction import tables as of_reduction
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.generalised_alpha import StateRecord, integrate
from pgmp_petsc.stepping.second_order_system import Scheme, State
from scenes import slider_crank

MODES = *FEW_MODES, "reduction.modes=4"
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
    "spring of the slider": 'effects.extra={type="spring_damper",joint="slider",stiffness=200.0,damping=2.0,rest=0.95}',
    "damper of the slider": 'effects.extra={type="joint_damping",joint="slider",coefficient=3.0}',
    "friction": 'effects.extra={type="joint_friction",joint="elbow",limit=0.2,speed=0.5}',
    "friction of the slider": 'effects.extra={type="joint_friction",joint="slider",limit=2.0,speed=0.05}',
    "end stop": 'effects.extra={type="end_stop",joint="crank_hinge",upper=0.5,stiffness=400.0,damping=0.05}',
    "stop of the slider": 'effects.extra={type="end_stop",joint="slider",lower=0.955,stiffness=5000.0,damping=0.2}',
    "following force": (
        'effects.extra={type="force",point="rod:tip",direction=[0.0,1.0],follows=true,table=[[0.0,0.0],[0.05,8.0]]}'
    ),
    "pulling force": (
        'effects.extra={type="force",point="rod:1",towards="ground:origin",table=[[0.0,0.0],[0.05,8.0]]}'
    ),
    "rayleigh": 'effects.extra={type="structural_damping",stiffness=2e-4,mass=2.0}',
    "rayleigh of one body": 'effects.extra={type="structural_damping",bodies=["rod"],stiffness=2e-4,mass=2.0}',
    "modal": 'effects.extra={type="structural_damping",ratios=[0.05,0.05]}',
    "drive": 'effects={extra={type="prescribed_motion",coordinate="theta",spin_up={speed=8.0,time=0.1}}}',
}


@lru_cache
def model_of(effect: str, *overrides: str) -> ReducedModel:
    start = () if effect == "drive" else MOVING
    # what acts along the normal of a guide has no static answer: it is left out where a force turns with a body there
    plain = ("reduction.static_modes=false", "reduction.modes=8") if effect == "following force" else ()
    return reduced_model(slider_crank(EFFECTS[effect], *MODES, *plain, *OUTPUTS, *start, *RUN, *overrides))


def anywhere(model: ReducedModel, n: int, bent: float = 1e-3, turned: float = 1.0) -> State:
    """Return states with deformations of such a size, in rotations of nodes so many times as much."""
    random = np.random.default_rng(7)
    r, n_eta = model.terms.tables.n_coordinates, model.terms.layout.n_eta
    q, v, a = random.normal(size=(3, n, n_eta)) * [*[1.0] * r, *[bent] * (n_eta - r)]
    q[:, r:] *= turned
    q[:, :r] = random.uniform(-3.0, 9.0, (n, r)) if r == 1 else random.uniform(-1.0, 1.0, (n, r))
    return State(q, 5.0 * v, 50.0 * a, np.zeros(0))


def assert_newton_converges(model: ReducedModel, time: float, state: State) -> None:
    system, scheme = model.batch(samples(model.scene, 6), 6), Scheme.of(0.8, 5e-4)
    sizes = [system.correct(time, state, scheme, np.ones(6, dtype=bool), True).max() for _ in range(4)]
    assert sizes[3] < 1e-4 * sizes[0], sizes


LOCAL = [name for name in EFFECTS if name not in ("rayleigh", "rayleigh of one body", "modal", "drive")]


@pytest.mark.parametrize(
    ("effect", "second_order"),
    [*((effect, False) for effect in LOCAL), ("spring between points", True), ("following force", True)],
)
def test_forces_do_the_work_that_frames_do(effect: str, second_order: bool) -> None:
    model = model_of(effect, f"reduction.second_order={str(second_order).lower()}")
    state = anywhere(model, 6)
    if effect == "end stop":
        state.q[:, 0] = 0.95
    assert_forces_do_the_work(model, state, samples(model.scene, 6), 0.03)


@pytest.mark.parametrize("effect", list(EFFECTS))
def test_energies_at_several_instants_are_those_of_each(effect: str) -> None:
    """Bit for bit: an ensemble's balance must not depend on how many states are looked at together."""
    model, n = model_of(effect), 3
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
def test_newton_converges_with_every_effect(effect: str) -> None:
    model = model_of(effect)
    assert_newton_converges(model, 0.03, anywhere(model, 6))


#: Radii of the rod in two samples.
RADII = np.array([5.6e-3, 5.0e-3])


@lru_cache
def without_effects() -> np.ndarray:
    """Return the crank's angle over time that follows without any effect, by the full-order model."""
    scene = slider_crank(*MODES, *OUTPUTS, *MOVING, *RUN)
    return history(full_model(scene), samples(scene, 2, r1=RADII), 2)[1]["angle"]


@pytest.mark.parametrize("effect", list(EFFECTS))
def test_the_motion_is_that_of_the_full_order_model(effect: str) -> None:
    model = model_of(effect)
    scene = model.scene
    values = samples(scene, 2, r1=RADII)
    _, reduced = history(model, values, 2)
    _, full = history(full_model(scene), values, 2)
    moved = np.ptp(full["angle"])
    assert moved > 0.08
    if effect in LOCAL:
        assert np.abs(full["angle"] - without_effects()).max() > 0.05 * moved, "the effect takes part"
    largest = np.abs(full["bend"]).max()
    # a blow excites more than 4 modes
    of_angle, of_bend = {
        "end stop": (5e-4, 0.05), "stop of the slider": (2e-4, 0.01), "following force": (1e-3, 0.15),
    }.get(effect, (5e-5, 3e-3))  # fmt: skip
    if effect == "drive":
        # the angle is given; clamped modes change faster with it than 32 angles follow, 96 leave a third of the error
        of_angle, of_bend = 1e-12, 0.1
    np.testing.assert_allclose(reduced["angle"], full["angle"], rtol=0, atol=of_angle * moved)
    np.testing.assert_allclose(reduced["bend"], full["bend"], rtol=0, atol=of_bend * largest)


@pytest.mark.parametrize("effect", list(EFFECTS))
def test_energy_is_what_powers_bring(effect: str) -> None:
    model = model_of(effect)
    scene = model.scene
    system, record = model.batch(samples(scene, 1), 1), StateRecord(lambda n_steps: None)
    simulation = scene.simulation.model_copy(update={"step": 1e-4, "spectral_radius": 1.0})
    integrate(system, simulation, observer=record)
    times, states = record.of_batch()
    now = system.energies_over(times, states, scene.values)
    totals, powers = now.kinetic + now.strain + sum(now.potential.values()), sum(now.powers.values())
    # the work of loads on the deformation is not potential energy: it is in the powers, as the rate of what is
    # interpolated
    work = np.concatenate([[0.0], np.cumsum(0.5 * (powers[1:] + powers[:-1]) * np.diff(times))])
    gained = totals - totals[0]
    np.testing.assert_allclose(gained, work, rtol=0, atol=2e-3 * max(np.ptp(totals), np.ptp(work)))


TABLE = "table=[[0.0, 0.0], [0.03, 6.0], [1.0, 6.0]]"

EFFECTS_IN_SPACE = {
    "damping": 'type="joint_damping", joint="elbow", coefficient=0.05',
    "friction": 'type="joint_friction", joint="elbow", limit=0.05, speed=0.5',
    "coil": 'type="spring_damper", joint="elbow", stiffness=2.0, damping=0.01, rest=-0.4975',
    "spring": 'type="spring_damper", points=["ground:post", "rod:tip"], stiffness=200.0, damping=1.0, rest=0.982',
    "stop": 'type="end_stop", joint="crank_hinge", upper=0.4, stiffness=300.0, damping=0.05',
    "following": f'type="force", point="crank:tip", direction=[0.1, 1.0, 0.2], follows=true, {TABLE}',
    "pulling": f'type="force", point="crank:tip", towards="ground:post", {TABLE}',
    "bushing": 'type="bushing", points=["ground:seat", "rod:tip"], reference=[[1.0, 0.5, 0.0], [-0.5, 1.0, 0.3]], '
               'stiffness=[80.0, 30.0, 10.0], damping=[0.5, 0.2, 3.0], turning_stiffness=[2.0, 3.0, 1.0]',
}  # fmt: skip
ON_SLIDER = {
    "sliding damper": 'type="joint_damping", joint="slider", coefficient=3.0',
    "sliding spring": 'type="spring_damper", joint="slider", stiffness=200.0, damping=1.0, rest=0.974',
}
ON_ARM = {
    name: text.replace("rod:tip", "lower:tip").replace("crank:tip", "upper:tip").replace("crank_hinge", "shoulder")
    for name, text in EFFECTS_IN_SPACE.items()
}
POST = "ground.points={post=[0.1, 0.4, -0.2], seat=[0.974, 0.0, 0.0]}"
PART = part_of_arm(1.2)
TIP = 'outputs.tip={type="position", point="lower:tip", axis="x"}'  # a point that a body has in every scene
# from rest, near where the springs have no force: what sets in at once makes light nodes vibrate
START = ("simulation.initial.theta.position=0.35", "effects.motor={type=\"torque\", joint=\"crank_hinge\", "
         "table=[[0.0, 0.0], [0.05, 2.0], [1.0, 2.0]]}")  # fmt: skip

RUN_IN_SPACE = ("simulation.duration=0.08", "simulation.step=1e-3")

ACCURATE = ("reduction.angles=32", "reduction.static_modes=true", "reduction.inertia_modes=true",
            'reduction.interpolation="spline"')  # fmt: skip

OUTPUTS_IN_SPACE = (
    'outputs.angle={type="angle", joint="crank_hinge"}',
    'outputs.elbow={type="angle", joint="elbow"}',
    'outputs.bend={type="deformation", point="rod:tip", axis="x"}',
    'outputs.length={type="distance", points=["ground:post", "rod:tip"]}',
)


def only(text: str) -> str:
    return f"effects={{extra={{{text}}}}}"


def in_space(name: str, *more: str) -> Scene:
    text = {**EFFECTS_IN_SPACE, **ON_SLIDER}[name]
    return slider_crank_in_space(POST, only(text), *RUN_IN_SPACE, *OUTPUTS_IN_SPACE, *more)


@lru_cache
def reduced(kind: str, name: str) -> ReducedModel:
    """Return a reduced model whose basis does not depend on the effect, so that it is built once."""
    scene = arm(POST, only(ON_ARM[name]), *PART, *RUN_IN_SPACE, TIP) if kind == "arm" else in_space(name)
    with pytest.MonkeyPatch.context() as patch:  # splines over 2.4 rad leave 3e-8 of its fourth derivatives
        patch.setattr(of_reduction, "N_FINE_OF_MORE", 40)
        return ReducedModel(scene, _rom(kind))


@lru_cache
def _rom(kind: str) -> ReducedOrderModel:
    return rom_of(arm(POST, TIP, *PART) if kind == "arm" else slider_crank_in_space(POST))


CASES = [("slider_crank", name) for name in (*EFFECTS_IN_SPACE, *ON_SLIDER)] + [
    ("arm", name) for name in EFFECTS_IN_SPACE
]


@pytest.mark.parametrize(("kind", "name"), CASES)
def test_forces_in_space_do_the_work(kind: str, name: str) -> None:
    model = reduced(kind, name)
    state = anywhere(model, 5, 3e-4, 3.0)  # by some degrees, where exp(phi) is more than 1 + phi
    if name == "stop":
        state.q[:, 0] = 0.9
    assert_forces_do_the_work(model, state, {}, 0.05)


def test_a_coil_in_the_elbow_counts_the_turns_of_the_crank() -> None:
    """The elbow turns back once with every turn of the crank, wherever the angle jumps from -pi to pi."""
    model = reduced("slider_crank", "coil")
    theta = np.linspace(0.0, 6 * np.pi, 61)
    q = np.zeros((theta.size, model.terms.layout.n_eta))
    q[:, 0] = theta
    state = State(q, np.zeros_like(q), np.zeros_like(q), np.zeros(0))
    stored = model.batch({}, theta.size).energies(0.0, state).potential["extra"]
    rod = np.arcsin(-0.3 * np.sin(theta) / 0.7)
    np.testing.assert_allclose(stored, (rod - theta + 0.4975) ** 2, rtol=1e-6, atol=1e-9)


def test_the_angle_of_the_elbow_counts_the_turns_of_the_crank() -> None:
    """In both models alike, and within (-pi, pi] where the run starts, wherever that is."""
    theta = np.linspace(-4.0 * np.pi, 6.0 * np.pi, 301)
    exact = np.arcsin(-0.3 * np.sin(theta) / 0.7) - theta
    for start, turns in ((0.0, 0), (2.9, 0), (3.4, 1), (12.0, 2)):
        at_start = f"simulation.initial.theta.position={start}"
        model = ReducedModel(in_space("coil", at_start), _rom("slider_crank"))
        eta = np.zeros((theta.size, model.terms.layout.n_eta))
        eta[:, 0] = theta
        elbow = model.outputs.evaluate(model.observed_of(0.0, still(eta), {}))["elbow"]
        np.testing.assert_allclose(elbow, exact + 2.0 * np.pi * turns, rtol=0, atol=1e-6)
    scene = in_space(
        "coil", "simulation.initial.theta.velocity=200.0", "simulation.step=1e-3", "simulation.duration=0.06"
    )
    full = motion("full", scene)
    assert full.outputs["angle"][-1] > 5.0 and np.abs(np.diff(full.outputs["elbow"])).max() < 1.0
    assert full.outputs["elbow"][-1] == pytest.approx(-full.outputs["angle"][-1], abs=0.6)


@pytest.mark.parametrize(("kind", "name"), CASES)
def test_newton_in_space(kind: str, name: str) -> None:
    model = reduced(kind, name)
    assert_newton_converges(model, 0.05, anywhere(model, 6, 3e-4))


@pytest.mark.parametrize("name", ["friction", "coil", "spring", "stop", "following", "bushing", "sliding spring"])
def test_the_motion_in_space_is_that_of_the_full_order_model(name: str) -> None:
    scene = in_space(name, *ACCURATE, *START)
    full = motion("full", scene)
    found = motion("reduced", scene)
    moved = np.ptp(full.outputs["angle"])
    assert moved > 0.05
    # of the stop's work an instant within it is 2.0e-3 off
    of_angle, of_bend, of_work = {"stop": (1e-3, 0.2, 3e-3)}.get(name, (3e-4, 0.02, 2e-3))
    for output in ("angle", "elbow", "length"):
        np.testing.assert_allclose(found.outputs[output], full.outputs[output], rtol=0, atol=of_angle * moved)
    bend = full.outputs["bend"]
    np.testing.assert_allclose(found.outputs["bend"], bend, rtol=0, atol=of_bend * np.abs(bend).max())
    work = full.balance.work["extra"]
    np.testing.assert_allclose(found.balance.work["extra"], work, rtol=0, atol=of_work * max(np.abs(work).max(), 1e-2))
