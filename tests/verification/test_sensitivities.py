"""Derivatives of runs against central differences: effects and starts of every kind, and contacts."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from combinations import meshes_for, scene_of
from conftest import ROOT
from differences import compare, differences
from length_scenes import BRIEF, GUIDE, long_crank
from mpi4py import MPI
from runs import FEW_MODES, reduced_model, rom_of, samples
from solid_scenes import solid_meshes, solid_slider_crank
from two_coordinates import double_pendulum, five_bar

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.design.derivatives import _moved, read_constraint, read_goal, sensitivities
from pgmp_petsc.design.fitting import MeasuredHistory, fit
from pgmp_petsc.design.optimization import Question, optimize
from pgmp_petsc.gradients.differentiated import DifferentiatedRun, ObservedChanges, differentiate
from pgmp_petsc.gradients.linearisation import Linearisation
from pgmp_petsc.gradients.local_effects import LocalDerivatives
from pgmp_petsc.mechanism.closure import LoopClosure
from pgmp_petsc.models import ReducedModel, of_samples
from pgmp_petsc.reduction import tables as tables_of_reduction
from pgmp_petsc.results import Design, Fit
from pgmp_petsc.scene import load_scene, scene_from_toml, scene_to_toml
from pgmp_petsc.stepping.edge_search import EventLocation
from pgmp_petsc.stepping.generalised_alpha import StateRecord, integrate
from pgmp_petsc.stepping.second_order_system import State
from scenes import HEADER, PENDULUM, slider_crank, tables

OUTPUTS = (
    'outputs.angle={type="angle",joint="crank_hinge"}',
    'outputs.x={type="position",point="rod:tip",axis="x"}',
    'outputs.bend={type="deformation",point="rod:tip",axis="x"}',
)
RUN = ("simulation.duration=0.025", "simulation.step=1e-3")
MOVING = ("simulation.initial.theta={position=0.4,velocity=3.0}", *RUN)
WEIGHT = ("parameters.g={nominal=9.81}", 'effects.weight={type="gravity",acceleration="g"}')
SPRING = (
    'parameters.k={nominal=300.0}', 'parameters.c={nominal=20.0}',
    'effects.spring={type="spring_damper",points=["ground:origin","rod:1"],stiffness="k",damping="c",rest=0.43}',
)  # fmt: skip
ELBOW = (
    'parameters.limit={nominal=0.2}', 'parameters.rate={nominal=0.02}',
    'effects.friction={type="joint_friction",joint="elbow",limit="limit",speed=0.5}',
    'effects.bearing={type="joint_damping",joint="elbow",coefficient="rate"}',
)  # fmt: skip
BUSHING = (
    'parameters.k={nominal=200.0}',
    'effects.bush={type="bushing",points=["ground:origin","crank:tip"],reference=[[1.0,0.0]],stiffness=["k",0.0],damping=[0.5,0.0]}',
)  # fmt: skip
PUSH = (
    'parameters.push={nominal=1.0}', "reduction.static_modes=false",
    'effects.jet={type="force",point="rod:tip",direction=[0.0,1.0],follows=true,table=[[0.0,0.0],[0.02,8.0]],scale="push"}',
)  # fmt: skip
DRIVE = ('effects={drive={type="prescribed_motion",coordinate="theta",spin_up={speed=8.0,time=0.1}}}', *RUN)
DAMPING = 'effects.material={type="structural_damping",stiffness=2e-4,mass=2.0}'
SCENES = {
    "beams": slider_crank(*FEW_MODES, *OUTPUTS, *MOVING, *WEIGHT),
    "beams of second order": slider_crank(*FEW_MODES, "reduction.second_order=true", *OUTPUTS, *MOVING, DAMPING),
    "spring and damper": slider_crank(*FEW_MODES, *OUTPUTS, *MOVING, *SPRING),
    "friction and damping of a joint": slider_crank(*FEW_MODES, *OUTPUTS, *MOVING, *ELBOW),
    "bushing that pulls at the start": slider_crank(*FEW_MODES, *OUTPUTS, *MOVING, *BUSHING),
    "following force": slider_crank(*FEW_MODES, *OUTPUTS, *MOVING, *PUSH),
    "driven": slider_crank(*FEW_MODES, *OUTPUTS, *DRIVE),
    "driven, of second order": slider_crank(*FEW_MODES, "reduction.second_order=true", *OUTPUTS, *DRIVE),
    "shaken": slider_crank(
        *FEW_MODES, *OUTPUTS, *MOVING, "parameters.a={nominal=0.5}", "parameters.b={nominal=2.0}",
        'effects.base={type="base_motion",direction=[3.0,4.0],of="displacement",harmonic={amplitude="a",mean="b",frequency_hz=4.0}}',
        'outputs.place={type="position",point="rod:tip",axis="x",absolute=true}',
        'outputs.moved={type="displacement",point="rod:tip",axis="x",absolute=true}',
        'outputs.v={type="speed",point="rod:1",axis="y",absolute=true}', 'outputs.turning={type="speed",joint="elbow"}',
    ),
    "overhauser": slider_crank(*FEW_MODES, 'reduction.interpolation="overhauser"', *OUTPUTS, *MOVING),
    "two coordinates": double_pendulum(
        *RUN, "reduction.second_order=true", *WEIGHT, 'parameters.r={nominal=5e-3}', 'bodies.upper.section.radius="r"',
        "simulation.initial={theta1={position=0.4,velocity=2.0},theta2={position=-0.3,velocity=-1.0}}",
        'outputs.elbow={type="angle",joint="elbow"}', 'outputs.x={type="position",point="lower:tip",axis="x"}',),
    "a loop with two coordinates": five_bar(
        *RUN, "reduction.angles=6", "reduction.second_order=true", *WEIGHT, 'parameters.r={nominal=4e-3}',
        'bodies.first.section.radius="r"', 'coordinates.theta1={joint="left_hinge",range=[1.6,2.6]}',
        'coordinates.theta2={joint="right_hinge",range=[0.6,1.6]}',
        "simulation.initial={theta1={position=2.0,velocity=3.0},theta2={position=1.0,velocity=-2.0}}",
        'outputs.pin={type="angle",joint="pin"}', 'outputs.x={type="position",point="first:tip",axis="x"}',
        'outputs.bend={type="deformation",point="first:tip",axis="y"}',
        'outputs.bend_of_body={type="deformation",point="second:2",axis="y",frame="body"}',),
}  # fmt: skip


@pytest.mark.parametrize("name", list(SCENES))
def test_derivatives_are_central_differences(name: str) -> None:
    compare(reduced_model(SCENES[name]))


def test_derivatives_close_no_loops_but_those_of_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once for frames and once for the rigid mechanism of all deformations, however many parameters there are."""
    model = reduced_model(SCENES["a loop with two coordinates"])
    eta = np.tile(model.batch({name: np.ones(1) for name in model.scene.parameters}, 1).start().q, (20, 1))
    eta[:, :2] += np.linspace(0.0, 0.5, 20)[:, None]
    closed, newton = [], LoopClosure.newton
    monkeypatch.setattr(LoopClosure, "newton", lambda self, *given: closed.append(1) or newton(self, *given))
    states = State(eta, np.zeros_like(eta), np.zeros_like(eta), np.zeros(0))
    observed = ObservedChanges(model, model.scene.values, np.arange(20.0), states)
    once = len(closed)  # none where polynomials that are there already place what deformations are taken from
    assert once <= 2
    found = observed.outputs
    for name in model.scene.parameters:
        observed.of(name, np.ones((3, *eta.shape)))
    assert len(closed) == once
    np.testing.assert_equal(found, model.outputs.evaluate(model.observed_of(0.0, states, model.scene.values)))


def test_derivatives_of_solids_are_central_differences() -> None:
    scene = solid_slider_crank(
        "parameters={E={nominal=210e9}, t={nominal=10e-3}}", 'materials.steel.E="E"', 'bodies.crank.thickness="t"',
        "reduction.modes=3", "reduction.angles=16", *MOVING,
    )  # fmt: skip
    compare(reduced_model(scene, solid_meshes(n_per_metre=20)))


def test_derivatives_in_space_and_of_stresses_are_central_differences() -> None:
    """Beams in space, whose rotations are no sums; stresses depend on the radius by themselves too. Poses are those of
    a table, and found numerically."""
    drawn = scene_of("beams in space", "stress")
    start = ("simulation.initial.theta={position=0.1,velocity=5.0}", 'reduction.interpolation="spline"')
    scene = scene_from_toml(scene_to_toml(drawn), ".", (*start, *RUN))
    rom = rom_of(scene, meshes=meshes_for(scene))
    assert rom.branch.is_exact
    for found in (rom, replace(rom, branch=replace(rom.branch, is_exact=False))):
        model = ReducedModel(scene, found)
        assert model.stresses is not None
        compare(model)


BAR = PENDULUM.replace("radius = 2e-4", 'radius = "r"').replace(
    "modes = 2\nangles = 6", 'modes = 3\nangles = 16\nstatic_modes = true\ninterpolation = "spline"'
) + tables("""
parameters.r: nominal = 5e-3
parameters.g: nominal = 9.81
parameters.k: nominal = 40.0
effects.weight: type = "gravity"; acceleration = "g"
effects.spring: type = "spring_damper"; joint = "hinge"; stiffness = "k"; damping = 0.1; rest = 0.3
outputs.tip: type = "position"; point = "arm:tip"; axis = "y"
outputs.hinge: type = "angle"; joint = "hinge"
""")


@pytest.mark.parametrize("coordinates", ["held", "free"])
def test_derivatives_of_settled_starts_are_central_differences(coordinates: str) -> None:
    scene = scene_from_toml(BAR, ".", (f'initial={{equilibrium=true,coordinates="{coordinates}"}}', *RUN))
    # the search for the equilibrium ends where its own rounding is met, which larger changes stand out from
    compare(reduced_model(scene), (1e-2, 2e-3))


def test_halving_the_step_quarters_the_error_of_derivatives() -> None:
    """Second order, as of the scheme itself: one mode, of 64 Hz, and a smooth load; three levels against a fine one."""
    steps, found = (1e-3, 5e-4, 2.5e-4, 3.125e-5), []
    few = ("reduction.modes=1", "reduction.angles=32", 'reduction.interpolation="spline"')
    wave = "{mean=0.25,amplitude=0.25,frequency_hz=4.0,phase=-1.5707963267948966}"
    smooth = f'effects.motor={{type="torque",joint="crank_hinge",harmonic={wave}}}'
    for step in steps:
        scene = slider_crank(*few, *OUTPUTS, smooth, "simulation.duration=0.08", f"simulation.step={step}")
        run = differentiate(reduced_model(scene), scene.values, ["r1"])
        found.append(run.derivatives["angle"]["r1"][:: round(steps[0] / step)])
    errors = np.abs(np.array(found[:-1]) - found[-1]).max(axis=1)
    assert np.all(np.log2(errors[:-1] / errors[1:]) > 1.8)


def test_a_scene_without_outputs_is_refused() -> None:
    model = reduced_model(slider_crank(*FEW_MODES, *MOVING))
    with pytest.raises(InputError, match="outputs: none is given, so there is nothing to differentiate"):
        differentiate(model, model.scene.values, ["r1"])


@pytest.mark.parametrize(
    ("low", "high", "moved"),
    [(5e-3, 6e-3, 5.656e-3), (5e-3, 5.61e-3, 5.544e-3), (5.57e-3, 5.61e-3, 5.57e-3), (5.6e-3, 5.61e-3, 5.61e-3)],
)
def test_effects_are_of_values_within_bounds(low: float, high: float, moved: float) -> None:
    """A hundredth on or back, or else to the further end of the bounds."""
    scene = slider_crank(f'parameters.r1={{nominal=5.6e-3, unit="m", bounds=[{low}, {high}]}}')
    assert _moved(scene, "r1") == pytest.approx(moved, rel=1e-12)


def test_a_run_that_fails_is_an_error_with_its_reason() -> None:
    far = (
        'coordinates.theta={joint="crank_hinge",range=[0.0,1.5]}',
        "simulation.initial.theta={position=1.4,velocity=9.0}",
    )
    model = reduced_model(slider_crank(*FEW_MODES, *OUTPUTS, *RUN, *far))
    with pytest.raises(RunError, match="the run stopped at .* s: a coordinate left the range"):
        differentiate(model, model.scene.values, ["r1"])


def test_one_run_and_all_parameters_take_steps_together() -> None:
    """Derivatives with one parameter are the same whichever others are asked for."""
    model = reduced_model(SCENES["spring and damper"])
    alone = differentiate(model, model.scene.values, ["k"]).derivatives
    together = differentiate(model, model.scene.values, ["r1", "k", "c"]).derivatives
    for output, found in alone.items():
        # sums over parameters are of another order
        np.testing.assert_allclose(found["k"], together[output]["k"], rtol=0, atol=1e-9 * np.abs(found["k"]).max())


SEEN = *FEW_MODES, *OUTPUTS[1:]
K = ("parameters.k={nominal=400.0}",)
STOP = 'effects.stop={type="end_stop",joint="crank_hinge",upper=0.45,stiffness="k",damping=0.05}'
# to and fro between two ends, under loads that change with time and follow the body, and friction
BOUNCING = (
    "parameters.push={nominal=1.0}", "simulation.initial.theta={position=0.4,velocity=6.0}", "simulation.step=1e-3",
    "simulation.duration=0.05",
    'effects.stop={type="end_stop",joint="crank_hinge",lower=0.35,upper=0.45,stiffness=2000.0,damping=0.05}',
    'effects.jet={type="force",point="rod:1",direction=[0.0,1.0],follows=true,scale="push",harmonic={amplitude=4.0,frequency_hz=30.0}}',
    'effects.push={type="force",point="rod:tip",direction=[1.0,0.0],harmonic={amplitude=9.0,frequency_hz=11.0}}',
    'effects.rub={type="joint_friction",joint="slider",limit=1.0,speed=0.05}',
    "effects.motor.table=[[0.0,0.0],[0.0512,1.5],[0.1024,-1.5],[1.0,-1.5]]",
)  # fmt: skip
WAVE = "{amplitude=0.12,frequency_hz=10.0,mean=0.5}"
DRIVEN_INTO = (
    f'effects.drive={{type="prescribed_motion",coordinate="theta",harmonic={WAVE}}}', "simulation.initial={}", *RUN,
)  # fmt: skip
NO_MOTOR = 'effects={weight={type="gravity"}}'
SLIDER = 'effects.stop={type="end_stop",joint="slider",lower=0.94,upper=0.97,stiffness="k",damping=0.2}'
ELBOW_STOP = 'effects.stop={type="end_stop",joint="elbow",lower=-0.33,stiffness="k",damping=0.1}'
CONTACTS = {
    "a contact": slider_crank(*SEEN, *MOVING, *K, STOP),
    "a drive": slider_crank(*SEEN, NO_MOTOR, *DRIVEN_INTO, "parameters.k={nominal=3e3}", SLIDER),
    "two coordinates": double_pendulum(
        *RUN, "reduction.modes=2", "reduction.angles=4", "parameters.k={nominal=40.0}", ELBOW_STOP,
        'coordinates.theta1={joint="shoulder",range=[0.2,0.8]}', 'coordinates.theta2={joint="elbow",range=[-0.6,0.0]}',
        'parameters.r={nominal=5e-3}', 'bodies.upper.section.radius="r"',
        "simulation.initial={theta1={position=0.4,velocity=2.0},theta2={position=-0.3,velocity=-2.0}}",
        'outputs.elbow={type="angle",joint="elbow"}',),
}  # fmt: skip


@pytest.fixture(scope="module", params=list(CONTACTS))
def model(request) -> ReducedModel:
    with pytest.MonkeyPatch.context() as patch:  # runs and their derivatives are of one table, over 0.6 rad
        patch.setattr(tables_of_reduction, "N_FINE_OF_MORE", 24)
        return reduced_model(CONTACTS[request.param])


def test_derivatives_over_contacts_are_central_differences(model: ReducedModel) -> None:
    assert differentiate(model, model.scene.values, ()).contacts
    compare(model, (1e-4,))


def test_edges_are_differentiated(model: ReducedModel) -> None:
    """Against differences of how far they are crossed, at the end of the run and along its motion."""
    trail = StateRecord(lambda n_steps: None)
    integrate(model.batch(samples(model.scene, 1), 1), model.scene.simulation, observer=trail)
    before, q = np.split(trail.states()[1].q[-2:], 2)
    linearisation, step = Linearisation(model, model.scene.values, ["r1"][: "r1" in model.scene.values]), 1e-3
    v, a = (q - before) / step, 30.0 * np.ones(q.shape)

    def depths(at: np.ndarray) -> np.ndarray:
        still = np.zeros_like(at)
        return linearisation.local.depths(np.zeros(len(at)), State(at, still, still, np.zeros(0)))

    h = np.diag(1e-4 / model.terms.scale)
    slopes = (depths(q + h) - depths(q - h)) / (2.0 * np.diag(h)[:, None])
    t = 1e-4
    path = np.concatenate([q + s * v + 0.5 * s * s * a for s in (-t, 0.0, t)])
    behind, here, ahead = depths(path)
    for event in range(depths(q).shape[1]):
        edge = linearisation.local.edge(event, 0.0, State(q, v, a, np.zeros(0)))
        assert edge.effect == "stop" and not edge.by_parameters.any()
        # truncation of the differences leaves 1e-8 of an angle's arc, rounding 1e-12 of them
        np.testing.assert_allclose(edge.gradient, slopes[:, event], rtol=0, atol=1e-7 * np.abs(slopes).max())
        assert edge.rate == pytest.approx((ahead - behind)[event] / (2.0 * t), rel=1e-5)
        curved = (ahead - 2.0 * here + behind)[event] / t**2
        assert edge.acceleration == pytest.approx(curved, rel=1e-4, abs=1e-12 / t**2)


def test_derivatives_through_many_contacts_are_central_differences() -> None:
    """What iterations leave grows from contact to contact: with the 1e-11 a step that `simulate` leaves derivatives
    would be 2.7e-7 off, and 1.2e-7 with 1e-12."""
    model = reduced_model(slider_crank(*SEEN, *BOUNCING))
    assert len(differentiate(model, model.scene.values, ["push"]).contacts) == 3
    compare(model, (2e-5,), "push")


HARD_STOP = HEADER + tables("""
parameters.F: nominal = 2e3; unit = "N"
parameters.high: nominal = 0.3; unit = "rad"
bodies.arm: line = { length = 0.4, elements = 4 }; element = "beam2d"; material = "steel";
    section = { shape = "circle", radius = 0.01 }
joints.hinge: type = "revolute"; connect = ["ground:origin", "arm:hinge"]
coordinates.theta: joint = "hinge"; range = [-0.9, 1.3]
effects.load: type = "force"; point = "arm:tip"; direction = [0.0, 1.0]; table = [[0.0, 0.0], [0.1, 1.0]]; scale = "F"
effects.spring: type = "spring_damper"; joint = "hinge"; stiffness = 300.0; damping = 5.0
effects.stop: type = "end_stop"; joint = "hinge"; upper = "high"; stiffness = 5e5; damping = 2.0
outputs.angle: type = "angle"; joint = "hinge"
outputs.bend: type = "deformation"; point = "arm:tip"; axis = "y"
reduction: modes = 3; static_modes = true; angles = 20
simulation: duration = 0.06; step = 1e-3
""")


def test_steps_with_a_hard_stop_are_retraced() -> None:
    """Its iteration leaves 1e-8 where 1e-12 is seen: the run and what retraces its steps take the same corrections."""
    model = reduced_model(scene_from_toml(HARD_STOP, "."))
    run = differentiate(model, model.scene.values, ["high"])
    assert len(run.contacts) == 5
    # edges are found to 1e-9 of a step, of which a stop of 5e5 N m/rad makes 1e-4
    wanted = differences(model, "high", 1e-5)["angle"]
    np.testing.assert_allclose(run.derivatives["angle"]["high"], wanted, rtol=0, atol=1e-3 * np.abs(wanted).max())


def test_derivatives_of_vibrations_from_a_dead_centre_are_central_differences() -> None:
    """Of a deformation of micrometres they were 8e-6 off with what iterations to 1e-12 leave."""
    spring = 'type="spring_damper",points=["ground:origin","rod:tip"],stiffness=200.0,rest=0.9'
    undamped = "simulation.duration=0.3", "reduction.angles=24", f"effects.spring={{{spring}}}"
    compare(reduced_model(load_scene(ROOT / "scenes" / "slider_crank.toml", undamped)), (1e-3, 1e-4), "r1")


# thrown against the slider's stop, with all that acts on joints and points
THROWN = (
    "simulation.duration=0.03",
    'effects.stop={type="end_stop",joint="slider",upper=0.9895,stiffness=2e3,damping=0.2}',
    'effects.brake={type="joint_friction",joint="elbow",limit=0.05,speed=20.0}',
    'effects.bearing={type="joint_damping",joint="crank_hinge",coefficient=0.02}',
    'effects.spring={type="spring_damper",points=["ground:guide","rod:tip"],stiffness=50.0,damping=0.5,rest=0.9}',
    'effects.jet={type="force",point="rod:tip",direction=[0.0,1.0],follows=true,'
    "harmonic={amplitude=4.0,frequency_hz=30.0}}",
    'effects.push={type="force",point="crank:tip",direction=[1.0,0.0],harmonic={amplitude=9.0,frequency_hz=11.0}}',
)
LENGTHS = {
    "rod_length": ((), "simulation.initial.theta={position=-0.25,velocity=20.0}", "parameters.rod_length.value=0.698",
        'effects.pull={type="force",point="rod:tip",towards="ground:guide",table=[[0.0,0.0],[0.02,3.0]]}',),
    "height": (("reduction.angles=24", *GUIDE), "simulation.initial.theta={position=0.4,velocity=-20.0}",
        "parameters.height.value=0.015",),
}  # fmt: skip


@pytest.mark.parametrize("name", list(LENGTHS))
def test_derivatives_with_a_length_or_place_through_contacts_are_central_differences(name: str) -> None:
    """Where a stop is met its force has a corner, at which the length and the coordinates take the same side."""

    where, *acting = LENGTHS[name]
    scene = long_crank(*BRIEF, *where, *THROWN, *acting)
    # the modes of a scene without them: accuracy has no part in it
    lanes = of_samples(ReducedModel(scene, rom_of(long_crank(*BRIEF, *where))), [name])
    assert [contact.met for contact in differentiate(lanes, scene.values, [name]).contacts] == [True, False]
    compare(lanes, (1e-3, 1e-5), name)


# a bar that is too stiff to bend meets a soft stop: a free motion, half a period of the stop's spring, and back
SPEED, PLACE = 2.0, 0.0507
FALLING_BAR = PENDULUM.replace("radius = 2e-4", 'radius = "r"').replace(
    "modes = 2\nangles = 6", "modes = 1\nangles = 8"
) + tables(f"""
parameters.r: nominal = 5e-3
parameters.k: nominal = 2000.0; bounds = [200.0, 20000.0]
effects.stop: type = "end_stop"; joint = "hinge"; upper = {PLACE}; stiffness = "k"
outputs.angle: type = "angle"; joint = "hinge"
simulation: duration = 0.12; step = 1e-3
simulation.initial.phi: velocity = {SPEED}
""")
STIFF = "materials.steel.E=2.1e17"


def bar(step: float = 1e-3) -> ReducedModel:
    return reduced_model(scene_from_toml(FALLING_BAR, ".", (STIFF, f"simulation.step={step}")))


@pytest.fixture(scope="module")
def bouncing() -> ReducedModel:
    return bar()


def inertia(model: ReducedModel) -> float:
    """Return that of the bar about its hinge, kg m2."""
    rho, r = model.scene.materials["steel"].rho, model.scene.values["r"]
    return rho * np.pi * r**2 * (1.0 / 3.0 + r**2 / 4.0)


def closed_form(model: ReducedModel, time: np.ndarray, k: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the angle of a bar that does not bend, and its derivative with the stiffness k of the stop."""
    rate, t = np.sqrt(k / inertia(model)), time - PLACE / SPEED
    phase = rate * t
    within, after = (t > 0.0) & (phase < np.pi), phase >= np.pi
    angle = PLACE + np.where(within, SPEED / rate * np.sin(phase), SPEED * t)
    slope = np.where(within, SPEED / (2.0 * rate * k) * (phase * np.cos(phase) - np.sin(phase)), 0.0)
    angle[after], slope[after] = PLACE - SPEED * (t[after] - np.pi / rate), -np.pi * SPEED / (2.0 * rate * k)
    return angle, slope


def test_a_bouncing_bar_has_the_derivatives_of_its_closed_form() -> None:
    off, steps = [], (1e-3, 5e-4, 2.5e-4)
    for step in steps:
        model = bar(step)
        run, k = differentiate(model, model.scene.values, ["k"]), model.scene.values["k"]
        omega, slope = np.sqrt(k / inertia(model)), closed_form(model, run.time, k)[1]
        assert [contact.met for contact in run.contacts] == [True, False]
        met, left = (contact.derivatives[0] for contact in run.contacts)
        error, within = np.abs(run.derivatives["angle"]["k"] / slope.min() - slope / slope.min()), run.time < 0.057
        # it is met whenever it is met; half a period later it is left
        assert abs(met) < 1e-12 * abs(left)
        off.append([error[within].max(), abs(left / (-np.pi / (2.0 * omega * k)) - 1.0)])
        # the speed with which it is left has an error that depends on where in a step that is
        assert error.max() < 3.0 * (omega * step) ** 2
    # the scheme's phase is late by (omega h)^2 / 12 of itself, and with it what follows from it
    assert max(off[-1]) < (omega * steps[-1]) ** 2
    np.testing.assert_allclose(np.log2(np.array(off[:-1]) / off[1:]), 2.0, atol=0.3)


def test_a_stop_that_moves_has_the_derivatives_of_its_closed_form() -> None:
    """A stop that is farther away is met later by 1 / v for every radian."""
    moving = f"parameters.place={{nominal={PLACE}}}", 'effects.stop.upper="place"'
    model = reduced_model(scene_from_toml(FALLING_BAR, ".", (STIFF, *moving)))
    run = differentiate(model, model.scene.values, ["place"])
    met, left = run.contacts
    assert met.derivatives[0] == pytest.approx(1.0 / SPEED, rel=1e-9)
    # half a period is as long wherever it is, and the way to the stop and back is longer; (omega h)^2 for the scheme
    error = model.scene.values["k"] / inertia(model) * 1e-6
    assert left.derivatives[0] == pytest.approx(1.0 / SPEED, rel=error)
    np.testing.assert_allclose(run.derivatives["angle"]["place"][run.time > left.time], 2.0, rtol=error)
    compare(model, (1e-4,), "place")


def test_a_path_that_grazes_a_stop_is_refused_with_its_name_and_instant(bouncing: ReducedModel) -> None:
    """The bar is thrown against a constant torque, so fast that it is farthest at the end of a step; or it starts at
    rest on the stop, which the torque presses it on."""

    def of(velocity: float, place: float, load: float = -4.0) -> ReducedModel:
        torque = f'effects.motor={{type="torque",joint="hinge",table=[[0.0,{load}],[1.0,{load}]]}}'
        more = f"effects.stop.upper={place!r}", f"simulation.initial.phi.velocity={velocity!r}"
        return reduced_model(scene_from_toml(FALLING_BAR, ".", (STIFF, torque, "simulation.duration=0.06", *more)))

    def run_of(model: ReducedModel) -> DifferentiatedRun:
        return differentiate(model, model.scene.values, ["r", "k"])

    slowing = 4.0 / inertia(bouncing)
    velocity = 0.05 * slowing
    for _ in range(2):  # until it is
        angle = run_of(of(velocity, 10.0)).outputs["angle"]
        velocity -= (angle[51] - angle[49]) / 2e-3
    farthest = float(angle[50])
    with pytest.raises(InputError, match=r"effects\.stop: at 0\.0499997 s the run grazes this stop"):
        run_of(of(velocity, farthest - 1e-12))
    with pytest.raises(InputError, match="or as deep in it as what rests on it"):
        run_of(of(0.0, 1e-14, 4.0))
    beyond = 1e-6
    run = run_of(of(velocity, farthest - beyond))
    assert [contact.met for contact in run.contacts] == [True, False]
    # the stop takes 1 % of the acceleration
    assert run.contacts[0].turning == pytest.approx(np.sqrt(2.0 * beyond / slowing), rel=2e-2)


def test_contacts_that_no_end_of_a_step_shows_are_found(
    bouncing: ReducedModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such as one that vibrations take back within a step: the scheme's equations do not hold over it."""
    expected, depths = differentiate(bouncing, bouncing.scene.values, ["k"]), LocalDerivatives.depths
    monkeypatch.setattr(LocalDerivatives, "depths", lambda *arguments: -np.abs(depths(*arguments)))
    found = differentiate(bouncing, bouncing.scene.values, ["k"])
    assert [contact.time for contact in found.contacts] == pytest.approx([one.time for one in expected.contacts])
    slope = expected.derivatives["angle"]["k"]
    # a step that is retraced is iterated to 1e-11, not to round-off
    np.testing.assert_allclose(found.derivatives["angle"]["k"], slope, rtol=0, atol=1e-8 * np.abs(slope).max())


def test_a_step_that_cannot_be_retraced_is_said(bouncing: ReducedModel, monkeypatch: pytest.MonkeyPatch) -> None:
    parts = EventLocation.parts

    def elsewhere(*arguments: Any) -> list:
        found = parts(*arguments)
        found[-1].state.q[:, 0] += 1e-6
        return found

    for instead, off in ((elsewhere, "1e-06"), (lambda *arguments: None, "inf")):
        monkeypatch.setattr(EventLocation, "parts", instead)
        with pytest.raises(RunError, match=f"contact that ends at 0.026 s could not be retraced: it ends {off}"):
            differentiate(bouncing, bouncing.scene.values, ["k"])


def test_contacts_are_in_results_and_remarks(bouncing: ReducedModel) -> None:
    found = sensitivities(bouncing, ["k", "r"], MPI.COMM_SELF)
    contacts = found.contacts
    assert contacts.effects == ("stop", "stop") and contacts.met.tolist() == [True, False]
    assert np.all(np.diff(contacts.time) > 0.0) and np.all(contacts.turning > 0.0)
    said = [remark.text for remark in found.record.remarks]
    assert any("effects.stop is met or left 2 times, first at 0.02" in text for text in said)


def test_a_fit_finds_the_stiffness_of_a_stop(bouncing: ReducedModel) -> None:
    """Of the closed form of a bar that does not bend, with noise; the model's own error is far below it."""
    true, noise, random = 2600.0, 1e-4, np.random.default_rng(3)
    time = np.linspace(0.01, 0.115, 36)
    exact = closed_form(bouncing, time, true)[0]
    history = MeasuredHistory(time, {"angle": exact + noise * random.normal(size=time.size)})
    found = fit(bouncing, history, ["k"], {"angle": noise}, MPI.COMM_SELF)
    assert isinstance(found, Fit)
    (stiffness,) = found.parameters
    # the scheme is late by (omega h)^2 / 12 of half a period, which is as much of a stiffness
    late = 2.0 * (np.sqrt(true / inertia(bouncing)) * 1e-3) ** 2 / 12.0
    assert abs(stiffness.estimate - true) < 4.0 * stiffness.error + late * true
    assert any("effects.stop is met or left 2 times" in remark.text for remark in found.record.remarks)


def test_the_softest_stop_that_is_entered_no_deeper(bouncing: ReducedModel) -> None:
    """``k d^2 = J v^2`` for the depth d."""
    known = bouncing.outputs.functions, bouncing.scene.parameters
    deepest = 0.015
    limit = read_constraint(f"max(angle) <= {PLACE + deepest}", *known)
    found = optimize(bouncing, Question(read_goal("minimise k", *known), (limit,), ("k",)), MPI.COMM_SELF)
    assert isinstance(found, Design)
    expected = inertia(bouncing) * SPEED**2 / deepest**2
    # the largest angle is taken at instants, of which one is within half a step of it
    share = (np.sqrt(expected / inertia(bouncing)) * 1e-3) ** 2
    assert found.converged and found.parameters[0].value == pytest.approx(expected, rel=share)
    assert any("effects.stop is met or left" in remark.text for remark in found.record.remarks)


def test_the_largest_speed_before_a_stop_is_at_a_corner_and_said_to_be_unsure() -> None:
    """From ``I v^2 / 2 = I v0^2 / 2 + M theta``: the speed at the stop rises by ``theta / (I v)`` with the torque. A
    parabola through the corner said 3.3 times that."""
    torque = "parameters.m={nominal=10.0}", 'effects.push={type="torque",joint="hinge",table=[[0.0,"m"],[1.0,"m"]]}'
    stop = "parameters.k={nominal=1e6}", 'outputs.speed={type="speed",joint="hinge"}', "simulation.step=1e-3"
    model = reduced_model(scene_from_toml(FALLING_BAR, ".", (STIFF, *torque, *stop)))
    found = sensitivities(model, ["m"], MPI.COMM_SELF)
    largest = found.extremes["speed"]
    # of first order in the step, which is a twentieth of the way
    assert largest.max_derivatives[0] == pytest.approx(PLACE / (inertia(model) * largest.max), rel=0.25)
    assert any("the largest speed at 0.02 s" in remark.text for remark in found.record.remarks)
