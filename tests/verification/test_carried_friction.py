"""Friction under the force that a joint carries: against scipy's integrators and closed forms, in every model."""

from dataclasses import replace
from functools import cache
from math import cos, hypot, sin, tanh

import numpy as np
import pytest
from alike import assert_alike, assert_order, assert_samples_are_those_alone
from conftest import ROOT
from exported import assert_same_in_c
from machine_scenes import cart, run
from refusals import cases, check_said, refusal
from runs import components_model, full_model, history, motion, reduced_model, samples
from scipy.integrate import solve_ivp
from spatial_beams import slider_crank_of_beams
from test_sliding_coordinates import moving

from pgmp_petsc.base.surroundings import alone
from pgmp_petsc.bench.history import run_history
from pgmp_petsc.bench.prices import step_seconds
from pgmp_petsc.controllers.running import N_FOLLOWED, follow_carried
from pgmp_petsc.ensemble.description import failure_remarks
from pgmp_petsc.gradients.differentiated import differentiate
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.mechanism.mechanism import Unknowns
from pgmp_petsc.models.lengths import of_samples
from pgmp_petsc.scene import load_scene, scene_from_toml
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.second_order_system import State
from pgmp_petsc.studies.building import estimate_effects
from pgmp_petsc.studies.single_run import why_stopped
from scenes import HEADER, mechanism_of, meshes_of, of_text, tables

MASS, LEVER, INERTIA, G = 2.0, 0.3, 0.05, 9.80665
MU, RADIUS, SLOW = 0.2, 0.05, 0.2  # it sets in within 8 ms, which the steps below resolve
# a rigid pendulum that falls from level and rubs in its bearing
PENDULUM = HEADER + tables("""
bodies.rod: rigid = { mass = 2.0, centre = [0.3, 0.0], inertia = 0.05, points = { hub = [0.0, 0.0] } }
joints.hinge: type = "revolute"; connect = ["ground:origin", "rod:hub"]
coordinates.theta: joint = "hinge"; range = [0.0, 6.283185307179586]; periodic = true
parameters.mu: nominal = 0.2
effects.weight: type = "gravity"
effects.rub: type = "joint_friction"; joint = "hinge"; coefficient = "mu"; radius = 0.05; speed = 0.2
outputs.angle: type = "angle"; joint = "hinge"
outputs.carried: type = "joint_force"; joint = "hinge"
simulation: duration = 0.5; step = 1e-3
""")
pendulum = of_text(PENDULUM)
IN_SPACE = (
    "bodies.rod.rigid={mass=2.0,centre=[0.3,0,0],inertia=[0.05,0.05,0.05,0,0,0],points={hub=[0,0,0]}}",
    "joints.hinge.axis=[0.0,0.0,1.0]", "effects.weight.direction=[0.0,-1.0,0.0]",
)  # fmt: skip


def falling(angle: float, speed: float, mu: float = MU) -> tuple[float, float]:
    """Return the acceleration of the pendulum and the force in its bearing, found in turn."""
    along, across, rubs = G * cos(angle), G * sin(angle) - LEVER * speed**2, mu * RADIUS * tanh(speed / SLOW)
    load, last = 0.0, -1.0
    while abs(load - last) > 1e-15 * load:  # a step leaves a hundredth of the error
        last = load
        rate = -(MASS * LEVER * along + rubs * load) / (INERTIA + MASS * LEVER**2)
        load = MASS * hypot(LEVER * rate + along, across)
    return rate, load


@cache
def exactly() -> np.ndarray:
    """Return angle and force over half a second every 10 ms, (2, 51)."""
    found = solve_ivp(
        lambda t, y: [y[1], falling(*y)[0]], (0, 0.5), [0, 0], "DOP853", np.arange(51) / 100, rtol=1e-11, atol=1e-12
    ).y
    return np.array([found[0], [falling(*y)[1] for y in found.T]])


@pytest.mark.parametrize(("model", "more"), [("full", ()), ("components", IN_SPACE)])
def test_a_pendulum_rubs_by_what_its_bearing_carries(model, more):
    """The order of the step is kept, of the angle and of the force; in space over the first swing down."""
    errors, end = [], 31 if more else 51
    exact = exactly()[:, :end]
    assert exact[1].max() > 40.0
    for step in (5e-3, 2.5e-3, 1.25e-3):
        scene = pendulum(*more, f"simulation.step={step}", f"simulation.duration={(end - 1) / 100}")
        _, found = run(scene, model, round(1e-2 / step))
        assert found["angle"][0] == 0.0
        errors.append([np.abs(found[name] - own).max() for name, own in zip(("angle", "carried"), exact)])
    assert_order(errors, 2.05, within=0.25)
    assert errors[-1][0] < 2e-5 * np.ptp(exact[0]), errors


BLOCK = HEADER + tables("""
bodies.block: rigid = { mass = 3.0, centre = [0.0, 0.0], inertia = 0.1, points = { far = [0.1, 0.0] } }
joints.incline: type = "prismatic"; connect = ["ground:origin", "block:centre"]; axis = [1.0, 0.0]
coordinates.x: joint = "incline"; range = [-1.0, 9.0]
parameters.mu: nominal = 0.3
effects.weight: type = "gravity"; direction = [0.6, -0.8]
effects.rub: type = "joint_friction"; joint = "incline"; coefficient = "mu"; speed = 1e-4
outputs.x: type = "sliding"; joint = "incline"
simulation: duration = 0.5; step = 1e-3
""")


def test_a_block_on_an_incline_slides_by_the_closed_form_and_another_one_creeps():
    """Once it moves much faster than the law's speed its acceleration is ``g (sin - mu cos)``; below the angle of
    friction it creeps at ``speed artanh(tan / mu)``."""
    moving = "simulation.initial.x.velocity=0.01"
    times, found = run(scene_from_toml(BLOCK, ".", (moving,)), "full")
    exact = 0.01 * times + 0.5 * G * (0.6 - 0.3 * 0.8) * times**2
    np.testing.assert_allclose(found["x"], exact, atol=1e-9)
    times, found = run(scene_from_toml(BLOCK, ".", ("parameters.mu.nominal=0.9",)), "full")
    later = times > 0.25
    assert np.ptp(found["x"][later]) / np.ptp(times[later]) == pytest.approx(1e-4 * np.arctanh(0.75 / 0.9), rel=1e-3)


# a flexible slider-crank that rubs in all of its joints
SLIDER = HEADER + tables("""
parameters.mu: nominal = 0.2; bounds = [0.0, 0.5]
bodies.crank: line = { length = 0.1, elements = 2 }; element = "beam2d"; material = "steel";
    section = { shape = "circle", radius = 0.01 }
bodies.rod: line = { length = 0.3, elements = 4 }; element = "beam2d"; material = "steel";
    section = { shape = "circle", radius = 0.006 }
joints.main: type = "revolute"; connect = ["ground:origin", "crank:hinge"]
joints.pin: type = "revolute"; connect = ["crank:tip", "rod:hinge"]
joints.guide: type = "point_on_line"; connect = ["ground:origin", "rod:tip"]; direction = [1.0, 0.0]
coordinates.theta: joint = "main"; range = [0.0, 6.283185307179586]; periodic = true
effects.slider: type = "point_mass"; point = "rod:tip"; mass = 0.5
effects.in_main: type = "joint_friction"; joint = "main"; coefficient = "mu"; radius = 0.02; speed = 1.0
effects.in_pin: type = "joint_friction"; joint = "pin"; coefficient = "mu"; radius = 0.02; speed = 1.0
effects.in_guide: type = "joint_friction"; joint = "guide"; coefficient = "mu"; speed = 0.1
reduction: modes = 6; angles = 24; static_modes = true; second_order = true
simulation: duration = 0.04; step = 1e-4; initial = { theta = { position = 0.5, velocity = 30.0 } }
outputs.theta: type = "angle"; joint = "main"
outputs.pin: type = "joint_force"; joint = "pin"
""")
slider = of_text(SLIDER)
JOINTS = ("in_main", "main"), ("in_pin", "pin"), ("in_guide", "guide")


@pytest.fixture(scope="module")
def full_run() -> dict[str, np.ndarray]:
    return run(slider(), "full", 10)[1]


@pytest.mark.parametrize("model", ["components", "reduced"])
def test_all_models_rub_alike(model, full_run) -> None:
    """Much of the speed is lost; models differ by less than a hundredth of what friction changes."""
    _, found = run(slider(), model, 10)
    lost = 0.5 + 30.0 * 0.04 - full_run["theta"][-1]
    assert lost > 0.1
    assert np.abs(found["theta"] - full_run["theta"]).max() < 0.01 * lost
    assert np.abs(found["pin"] - full_run["pin"]).max() < 0.03 * full_run["pin"].max()


def test_samples_side_by_side_are_those_alone() -> None:
    """To round-off: products of matrices hang on how many are side by side."""
    model = reduced_model(slider("simulation.duration=0.01"))
    assert_samples_are_those_alone(model, [7], 1e-12, mu=np.linspace(0.05, 0.45, 11))


def test_derivatives_are_those_of_differences_of_runs():
    scene = slider("simulation.duration=0.02")
    model = reduced_model(scene)
    found = differentiate(model, scene.values, ["mu"])
    ends = [history(model, samples(scene, 1, mu=0.2 + d), 1)[1]["theta"][-1, 0] for d in (-1e-3, 1e-3)]
    assert found.derivatives["theta"]["mu"][-1] == pytest.approx((ends[1] - ends[0]) / 2e-3, rel=1e-5)


def test_a_start_that_vibrates_says_that_friction_hangs_on_it() -> None:
    """Its error is 0.013 rad from a sixteenth of the step, and stated as 0.0034; without friction by the load it is not
    said."""
    said = "friction hangs on the forces that it makes in joints"
    assert said in str(motion("reduced", slider("simulation.duration=4e-3")).record.remarks)
    limits = [f'effects.{name}={{type="joint_friction", joint="{at}", limit=1.0, speed=1.0}}' for name, at in JOINTS]
    assert said not in str(motion("reduced", slider("simulation.duration=4e-3", *limits)).record.remarks)


DRIVEN = (
    'effects.drive={type="prescribed_motion",coordinate="theta",table=[[0.0,0.5],[0.04,1.7]]}',
    "simulation.initial={}",
)


@pytest.mark.parametrize(("model", "more"), [("full", ()), ("reduced", DRIVEN)], ids=["free", "a drive overcomes it"])
def test_what_friction_takes_is_in_the_balance(model: str, more: tuple[str, ...]) -> None:
    balance = motion(model, slider("simulation.duration=0.02", *more)).balance
    works = [balance.work[name] for name in ("in_main", "in_pin", "in_guide")]
    assert all(work[-1] < 0.0 for work in works)
    assert np.abs(balance.residual).max() < 2e-3 * abs(sum(work[-1] for work in works))


REFUSED = """
effects.rub={type="joint_friction",joint="hinge",coefficient=0.2,speed=1} -> effects.rub.radius: missing; what turns
effects.rub={type="joint_friction",joint="hinge",radius=0.1,limit=1,speed=1} -> effects.rub.radius = 0.1: without effect
effects.rub={type="joint_friction",joint="hinge",speed=1} -> effects.rub.limit: exactly one of limit, coefficient is
effects.rub={type="joint_friction",joint="hinge",limit=1,coefficient=0.1,speed=1} -> effects.rub.coefficient = 0.1
effects.rub.coefficient=-0.1 -> effects.rub.coefficient = -0.1
effects.rub.radius=0.0 -> effects.rub.radius = 0
effects.rub.radius=0.1 -> effects.rub.radius = 0.1: what slides rubs at no radius
"""


@pytest.mark.parametrize(("entries", "said"), cases(REFUSED))
def test_bad_input_is_named(entries, said) -> None:
    text = BLOCK if "what slides" in said else PENDULUM
    check_said(refusal(scene_from_toml, text, ".", (entries,)), said, entries)


STOP = 'effects.stop={type="end_stop", joint="main", upper=0.7, stiffness=1e4}'
WORN = "joints.pin.clearance={radius=1e-4,stiffness=1e8,restitution=0.9,restitution_speed=0.1}"
FEW = "reduction.angles=12"
IN_C = {
    "plane": lambda: slider(FEW, "simulation.duration=0.02"),
    "a clearance": lambda: slider(FEW, WORN, "simulation.duration=0.005", "simulation.step=2e-5"),
    "space": lambda: slider_crank_of_beams(
        "reduction.modes=4", FEW, 'reduction.interpolation="spline"', "simulation.duration=0.05",
        'effects.rub={type="joint_friction",joint="crank_hinge",coefficient=0.3,radius=0.01,speed=0.1}',
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("make", "name", "share"),
    [(components_model, "plane", 3e-6), *((reduced_model, name, 1e-9) for name in ("a clearance", "space"))],
)
def test_models_in_c_rub_alike(make, name, share, tmp_path) -> None:
    """What iterations leave of the first steps, 1e-12 of the size, is 8 / h^2 times as much of accelerations, and 1e-6
    of the force in the pin of components."""
    assert_same_in_c(make(IN_C[name]()), tmp_path, share)


def rubbing(joint: str, entries: str = "radius=0.01,") -> str:
    return f'effects.rub_{joint}={{type="joint_friction",joint="{joint}",coefficient=0.3,{entries}speed=0.1}}'


IN_LANES = {
    "damped": lambda: slider(
        FEW, "effects.w={type='gravity'}", "effects.d={type='structural_damping',stiffness=1e-5,mass=0.3}",
    ),
    "twice in a joint": lambda: slider(FEW, rubbing("pin")),
    "of first order": lambda: slider(FEW, "reduction.second_order=false"),
    "elastic": lambda: slider(FEW, "joints.pin.elastic={reference=[[1.0,0.0]],stiffness=[1e7,inf],damping=[3.0,0.0]}"),
    "clearance": lambda: slider(FEW, WORN),
    "held by nothing": lambda: slider(FEW, WORN, f"effects={{{rubbing('pin').removeprefix('effects.')}}}"),
    "space": lambda: slider_crank_of_beams("reduction.modes=4", FEW, rubbing("crank_hinge")),
    "two coordinates": lambda: cart(rubbing("rail", ""), rubbing("pivot"), "reduction.angles=6"),
    "prescribed": lambda: load_scene(
        ROOT / "scenes/quick_return.toml", (rubbing("ram", ""), rubbing("rocker_hinge"), FEW)
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", IN_LANES)
def test_forces_in_lanes_are_the_sizes_of_forces_in_joints(name):
    """Of states that are no motion, where all terms count, to round-off of their sums."""
    scene, n = IN_LANES[name](), 5
    model, random = reduced_model(scene), np.random.default_rng(0)
    values, r = samples(scene, n), model.terms.tables.n_coordinates
    system, carried = model.batch(values, n), model.multipliers
    q, v, a = (size * random.normal(size=(n, system.n_eta)) for size in (1e-4, 1.0, 100.0))
    q[:, :r] = model.start[0] + 0.1 * random.uniform(size=(n, r))
    state, given = State(q, v, a, np.zeros(0)), random.uniform(1.0, 10.0, (len(scene.carried), n))
    every = {key: np.broadcast_to(one, n) for key, one in {**scene.values, **values}.items()}
    found = carried.in_steps(every, n, lambda state: np.zeros((0, n, 3)))(0.01, state, given)
    wanted = carried._loads(state, found, every)
    assert system.carries and wanted.max() > 1.0
    np.testing.assert_allclose(system.carried(0.01, state, given), wanted, rtol=0.0, atol=1e-10 * wanted.max())


@pytest.mark.parametrize("make", [full_model, components_model])
@pytest.mark.parametrize("name", [name for name in IN_LANES if name not in ("of first order", "held by nothing")])
def test_forces_in_compiled_steps_are_the_sizes_of_forces_in_joints(name, make):
    """Of states that are no motion, to round-off of their sums."""
    model = make(IN_LANES[name]())
    scene, measures, unknowns = model.scene, model.measures, Unknowns(model.kinematics.mechanism)
    system, random = model.batch(samples(scene, 1), 1), np.random.default_rng(0)
    state = system.start()
    for part, size in zip(state.parts(), (1e-4, 1.0, 100.0, 10.0)):
        part += size * random.normal(size=part.shape)
    system.put_forces(random.uniform(1.0, 10.0, (len(scene.carried), 1, 1)))
    system.beside.iterates = True
    nodes, states = list(measures.nodes), state.alone
    frames = [system.frames_over(states)[nodes], unknowns.frames(system.unknowns_over(states)[1])[nodes]]
    pulls = measures.pulls(frames, system.multipliers_of_joints([0.01], states), system.values)
    wanted = np.linalg.norm(pulls, axis=1)
    assert system.carries and wanted.max() > 1.0
    np.testing.assert_allclose(system.carried(0.01, state), wanted, rtol=0.0, atol=1e-10 * wanted.max())


#: How long runs are: at 30 rad/s the stop is hit after 6.7 ms.
REACHED = {(): "simulation.duration=0.004", (STOP,): "simulation.duration=0.008"}


@pytest.mark.parametrize("make", [full_model, components_model])
@pytest.mark.parametrize("entries", REACHED, ids=["", "over an edge"])
def test_compiled_steps_are_those_of_corrections_in_python(entries, make):
    """Of the mesh those of a sample that ranks share too, with forces from frames. A correction of 1e-12 m is one of
    8e-12 / h^2 of accelerations, and of the force that they make."""
    scene = slider(REACHED[entries], "outputs.carried={type='joint_force',joint='main'}", *entries)
    model, given = make(scene), samples(scene, 1)
    found, system = history(model, given, 1)[1], model.batch(given, 1)
    assert system.carries
    system.carries = False
    others = [system]
    if make is full_model:
        others.append(model.distributed({name: float(value[0]) for name, value in given.items()}, alone()))
    for system in others:
        assert_alike(history(model, given, 1, system=system)[1], found, 1e-8)


def test_a_change_of_forces_that_was_misread_is_forgotten():
    """Of forces that contract by 0.1 to 1, once said to do so by 0.7: believed, they would go away from it by 2 in each
    correction, and what contradicts this much would not be."""
    kept, carried = np.zeros((N_FOLLOWED + 1, 1)), np.array([1.5])
    for number in range(12):
        found = 0.9 + 0.1 * carried
        if number == 2:
            found = carried + kept[1] - 0.3 * (carried - kept[0])
        follow_carried(number, found, kept, carried)
    assert carried[0] == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("entries", REACHED, ids=["", "over an edge"])
def test_steps_in_lanes_are_those_of_forces_found_in_python(entries):
    """Samples that rub little and much; over a stop those that rub more than these do not converge."""
    scene = slider(REACHED[entries], "reduction.angles=32", *entries)
    model, given = reduced_model(scene), samples(scene, 9, mu=np.linspace(0.05, 0.3 if entries else 0.45, 9))
    found = history(model, given, 9)[1]
    model.actions = replace(model.actions, carried=None)
    assert not model.batch(given, 9).carries
    assert_alike(history(model, given, 9)[1], found, 1e-8)


ON_BEAM = (
    "simulation.initial.x={position=0.1,velocity=5.0}", "simulation.duration=0.01", "reduction.angles=14",
    rubbing("rear", ""),
)  # fmt: skip


def test_where_joints_jam_no_step_is_said_to_help():
    """Of what rubs by more than the force that it makes its joint carry, some forces have no solution."""
    model = reduced_model(slider("parameters.mu={nominal=1.5}", "simulation.duration=0.01"))
    run = integrate(model.batch(samples(model.scene, 1), 1), model.scene.simulation)
    [stopped] = why_stopped(model, run, "", np.zeros((1, 1)))
    [failed, _] = failure_remarks(
        run.status, {"mu": np.array([1.5])}, {}, "reduced", beyond_steps=model.scene.beyond_steps
    )
    for remark in (stopped, failed):
        assert "where none helps less coefficient or radius of in_main, in_pin, in_guide" in remark.text


def test_on_a_beam_that_bends_forces_are_found_in_python():
    """The directions in which its nodes pull turn against each other; a run differs from the mesh by its modes."""
    model = reduced_model(moving(*ON_BEAM))
    assert model.actions.carried is None
    found, wanted = (run(model.scene, kind, 1)[1]["way"] for kind in ("reduced", "full"))
    slower = 0.1 + 5.0 * 0.01 - wanted[-1]
    assert slower > 1e-5 and np.abs(found - wanted).max() < 0.05 * slower
    length = 'parameters.l={nominal=2.0,unit="m",bounds=[1.995,2.005]}', 'bodies.beam.line.length="l"'
    longer = moving(*ON_BEAM, *length, "reduction.length_points=2")
    of_any = of_samples(reduced_model(longer), ["l"])
    assert of_any.actions.carried is None
    assert np.abs(history(of_any, samples(longer, 1), 1)[1]["way"][:, 0] - found).max() < 1e-4 * slower


def test_models_of_several_lengths_rub_alike():
    """Polynomials through three lengths are a thousandth of what friction takes away from models of each."""
    short = "simulation.duration=0.02", "outputs={theta={type='angle',joint='main'}}", "reduction.angles=12"
    scene = slider(*short, 'parameters.l={nominal=0.3,unit="m",bounds=[0.25,0.35]}', 'bodies.rod.line.length="l"')
    model, lengths = reduced_model(scene), np.array([0.26, 0.3])
    lanes = of_samples(model, ["l"])
    found = history(lanes, samples(scene, 2, l=lengths), 2, 10)[1]["theta"]
    for k, length in enumerate(lengths):
        alone = slider(*short, f"bodies.rod.line.length={length}")
        wanted = history(reduced_model(alone), samples(alone, 1), 1, 10)[1]["theta"][:, 0]
        lost = 0.5 + 30.0 * 0.02 - wanted[-1]
        at = history(model.at_lengths(scene.with_values({"l": length})), samples(scene, 1, l=length), 1, 10)[1]["theta"]
        share = 1e-9 if length == 0.3 else 1e-4
        assert lost > 0.1 and np.abs(found[:, k] - wanted).max() < share * lost
        assert np.abs(found[:, k] - at[:, 0]).max() < share * lost


@pytest.mark.parametrize("make", [full_model, reduced_model])
def test_runs_of_a_trade_off_have_it(make):
    scene = slider("simulation.duration=0.01")
    check_capabilities(scene, Purpose.TRADEOFF)
    model = make(scene)
    found = run_history(model, samples(scene, 2, mu=np.array([0.0, 0.2])), 2, 100).outputs[0]
    alone = motion(model).outputs["theta"]
    assert found[-1, 1] == pytest.approx(alone[-1], rel=1e-12) and abs(found[-1, 0] - alone[-1]) > 1e-4


def test_its_size_among_effects_is_its_work():
    """Of a rigid pendulum, whose run it is."""
    sizes, balance = estimate_effects(pendulum(), meshes_of(pendulum())), motion("full", pendulum()).balance
    (rub,) = (size for size in sizes.sizes if size.name == "rub")
    assert rub.share == pytest.approx(np.abs(balance.work["rub"]).max() / balance.exchanged, rel=1e-3)


def test_predicted_times_count_it():
    """A step of the mesh takes 140 us with friction in three joints, and is one of a sample alone; with limits it takes
    75 us, and 4 us in a batch."""
    limits = [f'effects.{name}={{type="joint_friction",joint="{at}",limit=1.0,speed=1.0}}' for name, at in JOINTS]
    rubbing, limited = (mechanism_of(scene) for scene in (slider(), slider(*limits)))
    assert step_seconds(rubbing) > step_seconds(limited, True) > 1e-4 > 10 * step_seconds(limited)
    assert step_seconds(rubbing) < 3e-4
