"""Effects in space in the reduced model: virtual work, frames of the reconstruction, Newton, the full-order model."""

from functools import lru_cache

import numpy as np
import pytest
from runs import assert_forces_do_the_work, motion, rom_of, still
from spatial import arm, slider_crank_in_space

from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduction import tables as of_reduction
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.second_order_system import Scheme, State

TABLE = "table=[[0.0, 0.0], [0.03, 6.0], [1.0, 6.0]]"
EFFECTS = {
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
    for name, text in EFFECTS.items()
}
POST = "ground.points={post=[0.1, 0.4, -0.2], seat=[0.974, 0.0, 0.0]}"
PART = tuple(f"coordinates.theta{k}.{entry}" for k in (1, 2) for entry in ("range=[-1.2,1.2]", "periodic=false"))
TIP = 'outputs.tip={type="position", point="lower:tip", axis="x"}'  # a point that a body has in every scene
# from rest, near where the springs have no force: what sets in at once makes light nodes vibrate
START = ("simulation.initial.theta.position=0.35", "effects.motor={type=\"torque\", joint=\"crank_hinge\", "
         "table=[[0.0, 0.0], [0.05, 2.0], [1.0, 2.0]]}")  # fmt: skip
RUN = ("simulation.duration=0.08", "simulation.step=1e-3")
ACCURATE = ("reduction.angles=32", "reduction.static_modes=true", "reduction.inertia_modes=true",
            'reduction.interpolation="spline"')  # fmt: skip
OUTPUTS = (
    'outputs.angle={type="angle", joint="crank_hinge"}',
    'outputs.elbow={type="angle", joint="elbow"}',
    'outputs.bend={type="deformation", point="rod:tip", axis="x"}',
    'outputs.length={type="distance", points=["ground:post", "rod:tip"]}',
)


def effects(text: str) -> str:
    return f"effects={{extra={{{text}}}}}"


def slider_crank(name: str, *more: str) -> Scene:
    text = {**EFFECTS, **ON_SLIDER}[name]
    return slider_crank_in_space(POST, effects(text), *RUN, *OUTPUTS, *more)


@lru_cache
def reduced(kind: str, name: str) -> ReducedModel:
    """Return a reduced model whose basis does not depend on the effect, so that it is built once."""
    scene = arm(POST, effects(ON_ARM[name]), *PART, *RUN, TIP) if kind == "arm" else slider_crank(name)
    with pytest.MonkeyPatch.context() as patch:  # splines over 2.4 rad leave 3e-8 of its fourth derivatives
        patch.setattr(of_reduction, "N_FINE_OF_MORE", 40)
        return ReducedModel(scene, _rom(kind))


@lru_cache
def _rom(kind: str) -> ReducedOrderModel:
    return rom_of(arm(POST, TIP, *PART) if kind == "arm" else slider_crank_in_space(POST))


def anywhere(model: ReducedModel, n: int, turned: float) -> State:
    random = np.random.default_rng(7)
    r, n_eta = model.terms.tables.n_coordinates, model.terms.layout.n_eta
    q, v, a = random.normal(size=(3, n, n_eta))
    for part in (q, v, a):
        part[:, r:] *= 3e-4
    # rotations of nodes of some degrees, where exp(phi) is more than 1 + phi
    q[:, r:] *= turned
    q[:, :r] = random.uniform(-3.0, 9.0, (n, r)) if r == 1 else random.uniform(-1.0, 1.0, (n, r))
    return State(q, 5.0 * v, 50.0 * a, np.zeros(0))


CASES = [("slider_crank", name) for name in (*EFFECTS, *ON_SLIDER)] + [("arm", name) for name in EFFECTS]


@pytest.mark.parametrize(("kind", "name"), CASES)
def test_forces_do_the_work_that_frames_do(kind: str, name: str) -> None:
    model = reduced(kind, name)
    state = anywhere(model, 5, 3.0)
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
        model = ReducedModel(slider_crank("coil", at_start), _rom("slider_crank"))
        eta = np.zeros((theta.size, model.terms.layout.n_eta))
        eta[:, 0] = theta
        elbow = model.outputs.evaluate(model.observed_of(0.0, still(eta), {}))["elbow"]
        np.testing.assert_allclose(elbow, exact + 2.0 * np.pi * turns, rtol=0, atol=1e-6)
    scene = slider_crank(
        "coil", "simulation.initial.theta.velocity=200.0", "simulation.step=5e-4", "simulation.duration=0.06"
    )
    full = motion("full", scene)
    assert full.outputs["angle"][-1] > 5.0 and np.abs(np.diff(full.outputs["elbow"])).max() < 1.0
    assert full.outputs["elbow"][-1] == pytest.approx(-full.outputs["angle"][-1], abs=0.6)


@pytest.mark.parametrize(("kind", "name"), CASES)
def test_newton_converges_with_every_effect(kind: str, name: str) -> None:
    model = reduced(kind, name)
    state, system = anywhere(model, 6, 1.0), model.batch({}, 6)
    sizes = [system.correct(0.05, state, Scheme.of(0.8, 5e-4), np.ones(6, dtype=bool), True).max() for _ in range(4)]
    assert sizes[3] < 1e-4 * sizes[0], sizes


@pytest.mark.parametrize("name", ["friction", "coil", "spring", "stop", "following", "bushing", "sliding spring"])
def test_the_motion_is_that_of_the_full_order_model(name: str) -> None:
    scene = slider_crank(name, *ACCURATE, *START)
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
