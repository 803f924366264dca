"""Clearance in joints: closed forms, other integrators, published histories, all models, samples, C."""

from functools import cache

import exported
import numpy as np
import pytest
from alike import assert_alike, assert_samples_are_those_alone, balances, residuals
from coupled_scenes import RACK, SCREW
from differences import compare
from loose_scenes import ball, follower, gears, worn
from machine_scenes import run
from numba import njit
from runs import assert_close, components_model, motion, reduced_model, trajectory
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.design.derivatives import contact_remarks
from pgmp_petsc.effects.clearance import LAWS, hysteresis_at, restitution_at
from pgmp_petsc.gradients.differentiated import differentiate
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.mechanism.composition import loosened
from pgmp_petsc.mechanism.joints import meeting
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.studies.check import describe_scene
from scenes import kinematics_of, meshes_of, of_text, tables

LAW = LAWS["hunt_crossley"]


IMPACTS = [(e, 1.5, ratio) for e in (0.05, 0.6, 0.99, 1.0) for ratio in (0.1, 1.0, 10.0)]


@pytest.mark.parametrize(("restitution", "exponent", "ratio"), [*IMPACTS, (0.3, 1.0, 1.0), (0.9, 2.2, 10.0)])
@pytest.mark.parametrize("damping", ["hunt_crossley", "hysteresis"])
def test_an_impact_has_the_restitution_that_was_asked_for(restitution, exponent, ratio, damping):
    """To 1e-3, whatever mass, stiffness and exponent, and at other speeds that of the closed form; Lankarani and
    Nikravesh's formula leaves 0.756 of 0.6. Of a hysteresis the closed form is an integral, and faster impacts have
    what was asked for."""
    speed, radius, mass = 0.3, 1e-3, 0.7
    p = [1e9 * 30.0 ** (exponent - 1.5), radius, exponent, restitution, speed]

    def rates(_, state):
        found = LAWS[damping].touching.evaluate(p, state[0] ** 2, 2.0 * state[0] * state[1])
        return [state[1], 2.0 * state[0] * found.force / mass]

    def left(_, state):
        return state[0] - radius * (1.0 - 1e-9)

    left.terminal, left.direction = True, -1.0
    hit = solve_ivp(rates, (0.0, 1.0), [radius, ratio * speed], events=left, rtol=1e-9, atol=1e-13, max_step=1e-5)
    assert hit.status == 1
    if damping == "hysteresis":
        expected = hysteresis_at(restitution, ratio)
        assert ratio < 10.0 or expected == pytest.approx(restitution, abs=3e-3)
    else:
        expected = restitution if ratio == 1.0 else restitution_at(restitution, ratio)
    assert -hit.y[1, -1] / (ratio * speed) == pytest.approx(expected, abs=1e-3)


def test_the_closed_form_goes_to_its_limits():
    """At other speeds: 1 - 2 a / 3 of slow impacts, whose next term is of the order of a^2, and 1 / a of fast ones."""
    assert restitution_at(0.5, 1.0) == pytest.approx(0.5, abs=6e-5) and restitution_at(1.0, 7.0) == 1.0
    a = 1.0 / (1e4 * restitution_at(0.5, 1e4))  # at the speed of 0.5
    for ratio in (1e-2 / a, 0.999e-3 / a, 1.001e-3 / a):
        assert restitution_at(0.5, ratio) == pytest.approx(1.0 - 2.0 * ratio * a / 3.0, abs=(ratio * a) ** 2)
    assert restitution_at(0.5, 29.9 / a) == pytest.approx(1.0 / 29.9, rel=1e-9)


def test_slower_impacts_lose_less_and_nothing_pulls():
    p = [1e8, 1e-3, 1.5, 0.5, 1.0]
    assert LAW.touching.evaluate(p, 1.1e-3**2, -1.0).force == 0.0  # leaves faster than the contact gives way
    for s in (0.0, 1e-9, 0.99e-6):
        found = LAW.touching.evaluate(p, s, 3.0)
        assert found.force == found.stored == 0.0 and found.damping == found.stiffness == 0.0
    assert LAW.touching.depths(p, 1.1e-3**2)[0] == pytest.approx(0.105e-3) and LAW.touching.depths(p, 0.0)[0] < 0.0


RUB = "joints.bore.clearance.friction=0.2", "joints.bore.clearance.friction_speed=0.01"
ALONG = np.array([0.4, -1.0])


@cache
def bounced(friction: float, end: float, n: int) -> np.ndarray:
    """Return the places of the ball by scipy's integrator at n instants, shape (2, n)."""
    p, mass = [1e8, 1e-3, 1.5, 0.7, 0.2], 0.5

    def rates(t, state):
        x, v = state[:2], state[2:]
        s, rate, area = float(x @ x), float(2.0 * x @ v), float(x[0] * v[1] - x[1] * v[0])
        normal = LAW.touching.evaluate(p, s, rate).force * 2.0 * x
        force = 10.0 * ALONG / np.hypot(0.4, 1.0) + normal + np.array([500.0 * t, 0.0])
        if friction:
            force += LAW.rubbing.evaluate([*p, friction, 0.01], s, area, rate).force * np.array([-x[1], x[0]])
        return [*v, *(force / mass)]

    time = np.linspace(0.0, end, n)
    # no step leaps over a contact; with steps of a fifth places are the same to 3e-13 m
    return solve_ivp(rates, (0.0, end), np.zeros(4), t_eval=time, rtol=1e-11, atol=1e-15, max_step=5e-5).y[:2]


@pytest.mark.parametrize("model", ["full", "components"])
@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_a_ball_that_bounces_in_a_bore_is_that_of_another_integrator(model, friction):
    """The error falls as the square of the step, as instants of contact are found. A growing force
    from aside lets the ball slide along the bore, too."""
    rubs = RUB if friction else ()
    scene = ball(*rubs)
    runs = [run(ball(*rubs, ASIDE, f"simulation.step={step}"), model) for step in ("1e-4", "5e-5", "2.5e-5")]
    exact = bounced(friction, runs[-1][0][-1], runs[-1][0].size)
    errors = [
        max(np.max(np.abs(found[name] - own[::every])) for name, own in zip("xy", exact))
        for (_, found), every in zip(runs, (4, 2, 1))
    ]
    assert scene.joints["bore"].gives_way == "clearance"
    depth = np.hypot(*exact).max() - 1e-3
    assert depth > 1e-5 and errors[2] < 0.02 * depth, (depth, errors)
    assert 3.2 < errors[0] / errors[1] < 5.0 and 3.2 < errors[1] / errors[2] < 5.0, errors


IN_SPACE = (
    "bodies.ball.rigid={mass=0.5,centre=[0,0,0],inertia=[2e-4,2e-4,2e-4,0,0,0],points={far=[0.1,0,0]}}",
    "joints.bore.axis=[0.0,0.0,1.0]", "effects.weight.direction=[0.4,-1.0,0.0]", *RUB,
)  # fmt: skip


def test_a_pin_in_space_is_the_one_in_the_plane_and_a_ball_has_room_in_all_directions():
    """With its force; along its axis the pin stays in its place, and holds the weight. The middle of a ball in its
    socket is free in three directions."""
    plane, space = (run(ball(*own), "full")[1] for own in ((*RUB, *_forces("bore")), (*IN_SPACE, *_forces("bore", 3))))
    assert_alike(plane, space, 1e-6)
    tilted = "effects.weight.direction=[0.4,-1.0,0.5]"
    _, held = run(ball(*IN_SPACE, tilted, *_forces("bore", 3)), "full")
    np.testing.assert_allclose(held["fz"], -10.0 * 0.5 / np.sqrt(0.16 + 1.0 + 0.25), rtol=1e-9)
    scene = ball(*IN_SPACE[:3])
    kinematics = kinematics_of(scene)
    assert kinematics.motion(np.zeros(1)).released.shape[-1] == 2
    (bore,) = kinematics.mechanism.connections
    held, released = loosened(meeting(3), np.eye(3), "everywhere")
    assert len(bore.held) == 3 and not held and len(released) == 3


DRIVEN = ('effects.motor={{type="torque",joint="{}",table=[[0.0,0.5],[0.2,-0.5]]}}', "simulation.duration=0.2")
PLAY = "clearance={radius=1e-4,stiffness=4e8,restitution=0.8,restitution_speed=0.02}"
RACKED = *(one.format("axle") for one in DRIVEN), "simulation.initial.phi.velocity=0.0"
THREADED = *(one.format("shaft") for one in DRIVEN), "effects.push.table=[[0.0,0.0],[1.0,0.0]]"
SUM = f"joints.teeth={{type='coupling',terms={{rail=2.0,axle=-0.1}},{PLAY}}}"
SLIDING = (0.02, 3.0), ("phi", "x"), [4e8, 1e-4, 1.5, 0.8, 0.02, 0.0]
#: Scenes, what the second motion is of the first, the spring of the second; inertia of both, and the law's parameters.
MESHES = {
    "gear": (gears, -0.5, 0.0, (0.01, 0.03), ("one", "two"), [1e5, 2e-3, 1.5, 0.8, 0.2, 0.0]),
    "rack": (of_text(RACK, *RACKED, f"joints.teeth.{PLAY}"), 0.05, 200.0, *SLIDING),
    "screw": (of_text(SCREW, *THREADED, f"joints.thread.{PLAY}"), 0.25 / np.pi, 0.0, *SLIDING),
    "sum": (of_text(RACK, *RACKED, SUM), 0.05, 200.0, *SLIDING),
}


@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize("model", ["full", "components"])
def test_what_is_in_mesh_with_backlash_is_that_of_another_integrator(mesh, model):
    """Of second order in the step, by which impacts are resolved; the second motion stays behind by the backlash."""
    scene, ratio, spring, inertia, names, p = MESHES[mesh]

    def rates(t, state):
        one, two, v_one, v_two = state
        force = LAW.backlash.evaluate(p, two - ratio * one, v_two - ratio * v_one).force
        return [v_one, v_two, (0.5 - 5.0 * t - ratio * force) / inertia[0], (force - spring * two) / inertia[1]]

    runs = [run(scene(f"simulation.step={step}"), model) for step in ("4e-4", "2e-4", "1e-4")]
    time = runs[-1][0]
    exact = solve_ivp(rates, (0.0, time[-1]), np.zeros(4), t_eval=time, rtol=1e-11, atol=1e-14, max_step=1e-4).y
    sizes = np.array([1.0, abs(ratio)])
    errors = [
        max(np.max(np.abs(found[name] - own[::every])) / size for name, own, size in zip(names, exact, sizes))
        for (_, found), every in zip(runs, (4, 2, 1))
    ]
    assert np.max(np.abs(exact[1] - ratio * exact[0])) > 1.1 * p[1]
    assert 3.2 < errors[0] / errors[1] < 5.0 and 3.2 < errors[1] / errors[2] < 5.0, errors


def test_a_radius_to_zero_gives_the_rigid_joint():
    """What the slider is off falls as the radius does, at a stiffness at which contact gives way by less."""
    rigid = run(worn("joints.pin={type='revolute',connect=['crank:tip','rod:hinge']}", *SHORT), "full")[1]["x"]
    off = []
    for radius in (4e-4, 1e-4, 2.5e-5):
        found = run(worn(*SHORT, "parameters.K.nominal=1e12"), "full", radius=radius)[1]["x"]
        off.append(np.max(np.abs(found - rigid)))
    assert off[0] > 1e-4
    assert 2.5 < off[0] / off[1] < 6.0 and 2.5 < off[1] / off[2] < 6.0, off


SECOND = ("reduction.second_order=true", "reduction.inertia_modes=true")
SHORT = ("simulation.duration=0.01", "simulation.step=1e-5")


def test_reduced_and_component_runs_are_those_of_full_order():
    """A few impacts; later ones hang on every one before. Terms of second order are worth it: without them the reduced
    run is off by six times as much."""
    scene = worn(*SHORT, *RUBS, *SECOND)
    full, components, reduced = (run(scene, name)[1] for name in ("full", "components", "reduced"))
    rigid = run(worn("joints.pin={type='revolute',connect=['crank:tip','rod:hinge']}", *SHORT), "full")[1]
    room = np.max(np.abs(full["x"] - rigid["x"]))
    for other in (components, reduced):
        assert np.max(np.abs(other["x"] - full["x"])) < 0.03 * room


@pytest.mark.parametrize(("model", "duration"), [("reduced", 0.006), ("components", 0.012)])
def test_a_follower_that_comes_back_to_its_contact_in_every_model(model, duration):
    """A step in which the contact would pull is linear, and tells nothing of the next one. Measured: 9e-5 of the force,
    and 19 times the force where one correction was taken for enough. Of components a light link sways on its pin: steps
    of 0.2 ms, with 1.9 N/um across where it is pressed at 0.2 kN."""
    assert all(law.bends for laws in LAWS.values() for law in laws)
    full, found = (run(follower(f"simulation.duration={duration}"), name)[1] for name in ("full", model))
    assert_close(full, found, force=1e-3, y=1e-5)


FORCES = [f'outputs.f{axis}={{{{type="joint_force",joint="{{0}}",component="{axis}"}}}}' for axis in "xyz"]
MOVED = [f'outputs.{name}{axis}={{type="rate",of="{axis}",order={order}}}'
         for order, name in ((1, "v"), (2, "a")) for axis in "xy"]  # fmt: skip


def _forces(joint: str, dimension: int = 2) -> list[str]:
    return [text.format(joint) for text in FORCES[:dimension]]


ASIDE = "effects.aside={type='force',point='ball:centre',direction=[1.0,0.0],table=[[0.0,0.0],[1.0,500.0]]}"


@pytest.mark.parametrize("model", ["full", "components"])
@pytest.mark.parametrize("rubs", [(), RUB], ids=["smooth", "rough"])
def test_the_force_in_a_bore_is_that_of_newton_and_of_hunt_and_crossley(model, rubs):
    """Mass times acceleration less the loads; and ``K d^n (1 + c d')`` of the depth, with c by a root."""
    time, found = run(ball(*_forces("bore"), *MOVED, ASIDE, *rubs), model)
    load = 10.0 * np.array([[0.4], [-1.0]]) / np.hypot(0.4, 1.0) + [500.0 * time, 0.0 * time]
    x, v, a, force = (np.array([found[name + axis] for axis in "xy"]) for name in ("", "v", "a", "f"))
    largest = np.abs(force).max()
    assert largest > 50.0
    # to what Newton's iteration leaves, whose matrix has no part of how the normal force under friction is damped
    assert np.abs(0.5 * a - load - force).max() < (1e-6 if rubs else 1e-7) * largest
    way = np.maximum(np.hypot(*x), 1e-9)
    depth, sinking = np.maximum(way - 1e-3, 0.0), np.sum(x * v, axis=0) / way
    c = brentq(lambda a: 1.7 * a - np.log1p(a) + np.log1p(-0.7 * a), 1e-3, 1.4) / 0.2
    normal = 1e8 * depth**1.5 * np.maximum(1.0 + c * sinking, 0.0)
    across = np.array([-x[1], x[0]]) / way
    friction = 0.2 * normal * np.tanh(np.sum(across * v, axis=0) / 0.01) if rubs else 0.0
    # c by its polynomial is within 6e-5, which is divided by 1 - restitution
    assert np.abs(force + normal * x / way + friction * across).max() < 3e-4 * largest
    assert bool(rubs) == (np.abs(friction).max() > 0.02 * largest)


def test_a_ball_at_rest_carries_its_weight_and_a_small_room_has_the_force_of_the_rigid_joint():
    """A damper brings it to rest. Then a force turns what it carries, and dampers take what moves with the radius."""
    damped = "effects.damper={type='spring_damper',points=['ground:up','ball:centre'],damping=300.0,rest=0.5}"
    table = "[[0.0,0.0],[0.06,0.0],[0.1,8.0],[0.12,8.0]]"
    slow = ("ground.points.up=[0.3,0.4]", damped, f"{ASIDE.split('[[')[0]}{table}}}",
            "effects.damper2={type='spring_damper',points=['ground:left','ball:centre'],damping=300.0,rest=0.5}",
            "ground.points.left=[-0.4,0.3]", "parameters.K.nominal=1e10", "simulation.duration=0.12",
            "effects.weight.direction=[0.0,-1.0]", *_forces("bore"))  # fmt: skip
    rigid = run(ball(*slow, "joints.bore={type='revolute',connect=['ground:origin','ball:centre']}"), "full")[1]
    off = []
    for radius in (2e-4, 1e-4):
        time, found = run(ball(*slow, f"joints.bore.clearance.radius={radius}"), "full")
        settled = time > 0.055
        at_rest, fx, fy = np.argmax(settled), found["fx"], found["fy"]
        assert abs(fx[at_rest]) < 1e-3 and fy[at_rest] == pytest.approx(10.0, rel=1e-4)
        off.append(max(np.abs(found[name] - rigid[name])[settled].max() for name in ("fx", "fy")))
    assert off[1] < 0.2 * 8.0 and 1.6 < off[0] / off[1] < 2.4, off


@pytest.mark.parametrize("purpose", [Purpose.FULL, Purpose.COMPONENTS, Purpose.BUILD, Purpose.REDUCED])
def test_static_equilibrium_is_refused(purpose):
    """From the middle of the room, where nothing holds the pin, statics found places without balance."""
    with pytest.raises(InputError, match="initial.equilibrium = true with joints.pin.clearance.*nothing holds a pin"):
        check_capabilities(worn("initial.equilibrium=true", "simulation.initial.theta.velocity=0.0"), purpose)
    said = describe_scene(follower(), meshes_of(follower()))
    assert "up to twice as far; let loads grow from zero" in said and "initial.equilibrium" not in said


def test_torques_of_wheels_with_backlash():
    """What turns the second wheel, and its share on the first one; nothing while the teeth do not touch."""
    of = [
        f'outputs.t_{of}={{type="joint_torque",joint="mesh",of="{of}",component="axial"}}' for of in ("first", "second")
    ]
    _, found = run(gears(*of, "outputs.turning={type='rate',of='two',order=2}"), "full")
    largest = np.abs(found["t_second"]).max()
    assert np.abs(found["t_second"] - 0.03 * found["turning"]).max() < 1e-7 * largest and largest > 1.0
    # each is a sum of its own, whose parts the library of matrices adds in an order of its own
    np.testing.assert_allclose(found["t_first"], 0.5 * found["t_second"], rtol=0.0, atol=1e-14 * largest)
    assert np.count_nonzero(found["t_second"] == 0.0) > 10


IN_CRANK = (*_forces("pin"), 'outputs.main={type="joint_force",joint="main",component="x"}')


def test_forces_of_reduced_and_component_runs_with_estimates():
    """Of the pin and of a joint beside it, as a contact is steep; and estimates within a factor 1.5 of the error."""
    scene = worn("simulation.duration=4e-3", *RUBS, *IN_CRANK, *SECOND)
    fine = worn("simulation.duration=4e-3", "simulation.step=5e-6", *RUBS, *IN_CRANK)
    exact, components = (run(fine, model)[1] for model in ("full", "components"))
    found = trajectory("reduced", scene)
    for name in ("fx", "fy", "main"):
        largest = np.abs(exact[name]).max()
        assert np.abs(components[name] - exact[name]).max() < 0.02 * largest, name
        true = np.abs(found.outputs[name] - exact[name][::4]).max()
        assert true < 0.02 * np.abs(exact["fx"]).max() or name == "main"
        assert true / 1.5 < np.abs(found.errors.outputs[name]).max() < 1.5 * true, (name, true)


def test_samples_side_by_side_have_the_forces_that_each_has_alone():
    model = reduced_model(worn("simulation.duration=2e-3", *RUBS, *IN_CRANK, *SECOND))
    assert_samples_are_those_alone(model, [7], 1e-9, radius=np.linspace(8e-5, 1.4e-4, 11))


def test_radius_and_stiffness_of_a_built_model_are_those_of_a_new_build():
    other = worn("parameters.radius.nominal=1.3e-4", "parameters.K.nominal=3e8", *SHORT)
    changed = run(worn(*SHORT), "reduced", radius=1.3e-4, K=3e8)[1]
    assert_alike(run(other, "reduced")[1], changed, 1e-7)


HELD = "joints.pin.clearance.damping='hysteresis'", "joints.pin.clearance.restitution_speed=2.0"
GUIDE = (
    "joints.guide.clearance={radius=1e-4,stiffness='K',restitution=0.9,restitution_speed=0.1,friction='mu',"
    "friction_speed=0.5}",
)
RUBS = "joints.pin.clearance.friction='mu'", "joints.pin.clearance.friction_speed=0.01", "parameters.mu={nominal=0.1}"


@pytest.mark.parametrize(
    ("more", "share"),
    [((), 1e-6), (IN_CRANK, 6e-4), ((*RUBS, *HELD), 2e-5), ((*GUIDE, RUBS[2]), 2e-5)],
    ids=["smooth", "forces", "rough hysteresis", "guide"],
)
def test_derivatives_are_central_differences(more, share, monkeypatch):
    """Of friction to what the run's own iteration leaves: its matrix has no part of how the normal force is damped, and
    every impact makes what is left larger. Forces are as good as accelerations, which have more of it."""
    monkeypatch.setattr("differences.RELATIVE", share)
    compare(reduced_model(worn("simulation.duration=4e-3", *more)))


def test_contacts_are_named_by_their_joint() -> None:
    model = reduced_model(worn("simulation.duration=4e-3"))
    (said,) = contact_remarks(differentiate(model, model.scene.values, ()))
    assert said.text.startswith("joints.pin.clearance is met or left ")
    assert "  clearance     pin: gives way in 2 directions of 2, in the motion" in describe_scene(
        model.scene, meshes_of(model.scene)
    )


@exported.needs_compiler
def test_c_code_runs_as_the_model(tmp_path):
    exported.assert_same_in_c(
        reduced_model(worn(*RUBS, *GUIDE, *HELD, *IN_CRANK, "simulation.duration=0.01")), tmp_path, share=1e-8
    )


PULLED = tables("""
scene: name = "pulled"
bodies.bar: rigid = { mass = 1.0, inertia = 0.01, centre = [0.2, 0.0], points = { pin = [0.0, 0.0] } }
joints.pin: type = "revolute"; connect = ["ground:origin", "bar:pin"];
    clearance = { radius = 5e-4, stiffness = 1e10, restitution = 0.1, restitution_speed = 0.02 }
coordinates.phi: joint = "pin"; range = [-2.0, 2.0]
effects.pull: type = "force"; point = "bar:centre"; direction = [1.0, 0.0]; table = [[0.0, 0.0], [0.04, 1e4]]
simulation: duration = 0.05; step = 2.5e-4
outputs.force: type = "joint_force"; joint = "pin"
""")


@exported.needs_compiler
def test_a_contact_under_a_large_force_is_stiff_across_in_c_too(tmp_path):
    """Force over radius, 2e7 N/m, is as stiff as the bar is heavy in a step: without it forces were 3e-6 off."""
    exported.assert_same_in_c(components_model(scene_from_toml(PULLED, tmp_path)), tmp_path, share=1e-8)


def test_the_balance_of_energy_holds_at_second_order():
    """What contacts take is in it, by the name of the joint."""
    off = residuals(balances("reduced", lambda step: worn(step, *RUBS), 2e-5, 1e-5))
    assert np.min(motion("reduced", worn("simulation.step=1e-5", *RUBS)).balance.work["pin"]) < -10.0 * off[-1]
    assert 2.5 < off[0] / off[1] < 6.0, off


NUMBERS = 'radius = 1e-3, stiffness = 1e10, restitution = "e", restitution_speed = 0.5, friction = 0.01'
LOOSE = f"clearance = {{ {NUMBERS}, friction_speed = 0.1 }}"
SCENE = tables(f"""
scene: name = "loose_guide"
parameters.e: nominal = 0.4
bodies.crank.rigid: mass = 0.038; centre = [0.0765, 0.0]; inertia = 7.4e-5
bodies.crank.rigid.points: hub = [0.0, 0.0]; tip = [0.153, 0.0]
bodies.rod: placement = {{ origin = [0.153, 0.0] }}
bodies.rod.rigid: mass = 0.038; centre = [0.153, 0.0]; inertia = 5.9e-4
bodies.rod.rigid.points: hub = [0.0, 0.0]; tip = [0.306, 0.0]
bodies.slider: placement = {{ origin = [0.459, 0.0] }}
bodies.slider.rigid: mass = 0.076; centre = [0.0, 0.0]; inertia = 2.7e-6
bodies.slider.rigid.points: pin = [0.0, 0.0]; left = [-0.05, 0.0]; right = [0.05, 0.0]
joints.main: type = "revolute"; connect = ["ground:origin", "crank:hub"]
joints.knee: type = "revolute"; connect = ["crank:tip", "rod:hub"]
joints.wrist: type = "revolute"; connect = ["rod:tip", "slider:pin"]
joints.left: type = "point_on_line"; connect = ["ground:origin", "slider:left"]; direction = [1.0, 0.0]; {LOOSE}
joints.right: type = "point_on_line"; connect = ["ground:origin", "slider:right"]; direction = [1.0, 0.0]; {LOOSE}
coordinates.theta: joint = "main"; range = [0.0, 6.283185307179586]; periodic = true
effects.weight: type = "gravity"; acceleration = 9.81
simulation: duration = 0.12; step = 5e-6; initial = {{ theta = {{ position = 0.0, velocity = 150.0 }} }}
outputs.speed: type = "speed"; joint = "main"
outputs.y: type = "position"; point = "slider:pin"; axis = "y"
outputs.left: type = "position"; point = "slider:left"; axis = "y"
""")
loose = of_text(SCENE)
ROOM = 1e-3
# time (s), height of the slider's middle over its room, speed of the crank (rad/s): until it is about to impact twice
PUBLISHED = np.array([
    (0.0, 0.0, 150.0), (0.0005, 0.0102, 146.89), (0.001, 0.0771, 139.23), (0.0015, 0.2337, 129.9),
    (0.002, 0.4871, 120.82), (0.0025, 0.8302, 112.79), (0.0027, 0.9901, 109.92), (0.0033, 0.8845, 101.19),
    (0.0043, 0.7606, 91.29), (0.0053, 0.8204, 84.21), (0.0062, 0.9919, 79.48),
])  # fmt: skip
L1, L2, M1, M2, M3, J1, J2, J3, G = 0.153, 0.306, 0.038, 0.038, 0.076, 7.4e-5, 5.9e-4, 2.7e-6, 9.81
COUPLED, LENGTH, HEIGHT = (M2 / 2 + M3) * L1 * L2, 0.05, 0.025


def inertia(q):
    """Return what couples the speeds of crank and rod, (first, both, second); the slider turns by itself."""
    first, second = J1 + (M1 / 4 + M2 + M3) * L1**2, J2 + (M2 / 4 + M3) * L2**2
    return first, COUPLED * np.cos(q[1] - q[0]), second


def force(q, v):
    skew = COUPLED * np.sin(q[0] - q[1])
    first = -skew * v[1] ** 2 - (M1 / 2 + M2 + M3) * G * L1 * np.cos(q[0])
    return first, skew * v[0] ** 2 - (M2 / 2 + M3) * G * L2 * np.cos(q[1])


compiled_inertia, compiled_force = njit(cache=True)(inertia), njit(cache=True)(force)


@njit(cache=True)
def answer(masses, one, other, third):
    first, both, second = masses
    share = first * second - both**2
    return (second * one - both * other) / share, (first * other - both * one) / share, third / J3


@njit(cache=True)
def along(row, velocity):
    return row[0] * velocity[0] + row[1] * velocity[1] + row[2] * velocity[2]


@njit(cache=True)
def moreau(step, duration, restitution, friction, every):
    """Return angles of crank, rod and slider and their speeds, (n, 6), after every so many steps of the midpoint rule.

    In the middle of a step corners are closed or not; impulses of those that are closed follow by Gauss and Seidel's
    iteration of the inclusions. Numbers one by one: products of small matrices take seconds to compile."""
    n = int(round(duration / step))
    found = np.empty(((n - 1) // every + 1, 6))
    q, v = (0.0, 0.0, 0.0), (150.0, -75.0, 0.0)
    w, answers, delassus = np.zeros((8, 3)), np.zeros((8, 3)), np.zeros((8, 8))
    impulses, before, without = np.zeros(8), np.zeros(8), np.zeros(8)
    for number in range(n):
        if number % every == 0:
            row = found[number // every]
            row[0], row[1], row[2], row[3], row[4], row[5] = q[0], q[1], q[2], v[0], v[1], v[2]
        middle = q[0] + step / 2 * v[0], q[1] + step / 2 * v[1], q[2] + step / 2 * v[2]
        masses, free = compiled_inertia(middle), v
        for _ in range(4):  # forces at the mean of both velocities
            one, other = compiled_force(middle, ((v[0] + free[0]) / 2, (v[1] + free[1]) / 2))
            rate = answer(masses, one, other, 0.0)
            free = v[0] + step * rate[0], v[1] + step * rate[1], v[2]
        y, m = L1 * np.sin(middle[0]) + L2 * np.sin(middle[1]), 0
        s, c = np.sin(middle[2]), np.cos(middle[2])
        for corner in range(4):
            x, side = (-LENGTH, LENGTH)[corner % 2], 1.0 if corner < 2 else -1.0
            up = side * HEIGHT
            if ROOM + HEIGHT - side * (y + x * s + up * c) <= 0.0:
                across, rubs = w[2 * m], w[2 * m + 1]
                across[0], across[1] = -side * L1 * np.cos(middle[0]), -side * L2 * np.cos(middle[1])
                across[2] = -side * (x * c - up * s)
                rubs[0], rubs[1] = -L1 * np.sin(middle[0]), -L2 * np.sin(middle[1])
                rubs[2] = -x * s - up * c
                m += 1
        for i in range(2 * m):
            impulses[i], before[i], without[i] = 0.0, along(w[i], v), along(w[i], free)
            answers[i, 0], answers[i, 1], answers[i, 2] = answer(masses, w[i, 0], w[i, 1], w[i, 2])
            for j in range(2 * m):
                delassus[i, j] = along(w[j], answers[i])
        for _ in range(1000):
            changed, largest = 0.0, 0.0
            for i in range(2 * m):
                last, approach = impulses[i], without[i]
                for j in range(2 * m):
                    approach += delassus[i, j] * impulses[j]
                if i % 2 == 0:
                    impulses[i] = max(0.0, last - (approach + restitution * before[i]) / delassus[i, i])
                else:
                    most = friction * impulses[i - 1]
                    impulses[i] = min(max(last - approach / delassus[i, i], -most), most)
                changed, largest = changed + abs(impulses[i] - last), largest + abs(impulses[i])
            if changed <= 1e-12 * largest:
                break
        v = free
        for i in range(2 * m):
            own, of = impulses[i], answers[i]
            v = v[0] + own * of[0], v[1] + own * of[1], v[2] + own * of[2]
        q = middle[0] + step / 2 * v[0], middle[1] + step / 2 * v[1], middle[2] + step / 2 * v[2]
    return found


@cache
def moreaus_history(restitution: float) -> np.ndarray:
    """Return angles and their speeds, (6, n), every 0.1 ms."""
    return moreau(2e-6, 0.12, restitution, 0.01, 50).T


def height(q: np.ndarray) -> np.ndarray:
    """Return that of the slider's middle over its room."""
    return (L1 * np.sin(q[0]) + L2 * np.sin(q[1])) / ROOM


def energy(q: np.ndarray, v: np.ndarray) -> float:
    potential = (M1 / 2 + M2 + M3) * G * L1 * np.sin(q[0]) + (M2 / 2 + M3) * G * L2 * np.sin(q[1])
    first, both, second = inertia(q)
    return 0.5 * (first * v[0] ** 2 + second * v[1] ** 2 + J3 * v[2] ** 2) + both * v[0] * v[1] + potential


def test_before_the_first_impact_it_is_free():
    """Against scipy's integrator: the slider rises to its room in 2.7 ms."""
    times, found = run(loose("simulation.duration=2.7e-3"), "full")

    def rates(t, state):
        first, both, second = inertia(state)
        return [*state[2:], *np.linalg.solve([[first, both], [both, second]], force(state, state[2:]))]

    exact = solve_ivp(rates, (0, times[-1]), [0, 0, 150, -75], "DOP853", times, rtol=1e-11, atol=1e-13).y
    free = found["y"] / ROOM < 0.999
    assert np.abs(found["y"] / ROOM - height(exact[:2]))[free].max() < 1e-4
    assert np.abs(found["speed"] - exact[2])[free].max() < 1e-4 * 150.0 and 0.98 < found["y"].max() / ROOM


def test_the_history_of_siconos_up_to_the_second_impact():
    """Until the first impact within 0.02 of the room, by the energy that the published run gains. Then by when in a
    step of 0.1 ms its impact is, (0.86 + 0.34) m/s times that: 0.12 of the room. The crank's speed by that energy, of
    which 1.3 % are gained in the end, and by where the crank is then."""
    fast = [f"joints.{side}.clearance.restitution_speed=0.86" for side in ("left", "right")]  # that of the impact
    times, found = run(loose("simulation.duration=6.2e-3", *fast), "full")
    y, speed = (np.interp(PUBLISHED[:, 0], times, values) for values in (found["y"] / ROOM, found["speed"]))
    off, before = np.abs(y - PUBLISHED[:, 1]), PUBLISHED[:, 0] <= 2.7e-3
    assert off[before].max() < 0.02 and off.max() < 0.12
    np.testing.assert_allclose(speed, PUBLISHED[:, 2], rtol=0.02)


@pytest.mark.parametrize(("restitution", "damping", "most", "mean", "speed"), [
    (0.05, "hunt_crossley", 0.04, 0.015, 2.5),
    pytest.param(0.4, "hysteresis", 0.15, 0.04, 5.0, marks=pytest.mark.thorough),
    pytest.param(0.4, "hunt_crossley", 0.8, 0.2, 5.0, marks=pytest.mark.thorough),
])  # fmt: skip
def test_histories_of_moreaus_rule_over_revolutions(restitution, damping, most, mean, speed):
    """With a small restitution, whose rebounds nobody sees, heights are the same but for how deep contact is (0.02 of
    the room); with 0.4 rebounds of other speeds differ, by a part of their height, unless impacts of all speeds lose
    alike. The crank's speed is off by what a jump of some 0.1 ms is late, and by what rebounds lose."""
    exact = moreaus_history(restitution)
    step = 5e-6 if damping == "hunt_crossley" else 2e-6  # of which the turn of a hysteresis at 0.2 m/s takes some
    held = [f"joints.{side}.clearance.damping='hysteresis'" for side in ("left", "right")]
    held += [f"joints.{side}.clearance.restitution_speed=0.2" for side in ("left", "right")]
    more = held if damping == "hysteresis" else []
    every = int(round(1e-4 / step))  # both every 0.1 ms
    _, found = run(loose(f"parameters.e.nominal={restitution}", f"simulation.step={step}", *more), "full", every)
    off = np.abs(found["y"][:-1] / ROOM - height(exact[:2]))
    assert off.max() < most and np.sqrt(np.mean(off**2)) < mean, (off.max(), np.sqrt(np.mean(off**2)))
    assert np.abs(found["speed"][:-1] - exact[3]).max() < speed < 0.04 * 150.0
    np.testing.assert_array_equal(found["left"], found["y"])  # both corners touch at once, it does not tilt
    energies = [energy(row[:3], row[3:]) for row in exact[:, ::100].T]
    assert np.all(np.diff(energies) < 1e-6) and energies[-1] < 0.97 * energies[0]


# The four-bar of the tutorials of Siconos (`examples/mechanics/FourBarLinkageWith3clearance`, as it ships), with room
# of 5 mm in three pins, restitution 0 and friction 0.1: time (s), crank (rad) and its speed, coupler, rocker, and where
# the coupler's pin is in the crank's bore and the rocker's from that of the ground (m)
FOUR_BAR = np.array([
    (0.00, 1.570824, 0.000000, 0.353284, 1.26487, -0.00000, 0.00000, 0.00000, 0.00000),
    (0.05, 1.667922, 4.395042, 0.359791, 1.30537, 0.00490, 0.00102, 0.00012, -0.00500),
    (0.10, 1.985175, 7.926076, 0.400993, 1.45645, 0.00443, 0.00231, 0.00398, -0.00302),
    (0.15, 2.431353, 9.923161, 0.479953, 1.65737, -0.00489, 0.00103, -0.00110, 0.00488),
    (0.20, 2.944229, 10.490447, 0.589950, 1.83865, -0.00489, -0.00106, -0.00161, 0.00473),
    (0.25, 3.469429, 10.432475, 0.722471, 1.96019, -0.00436, -0.00245, -0.00376, 0.00330),
    (0.30, 3.979969, 9.922315, 0.855959, 2.00357, -0.00355, -0.00352, -0.00499, 0.00038),
    (0.35, 4.455763, 9.065955, 0.962198, 1.96826, -0.00283, -0.00412, -0.00487, 0.00115),
    (0.40, 4.882151, 7.953754, 1.013001, 1.86084, -0.00233, -0.00442, -0.00344, 0.00363),
    (0.45, 5.248881, 6.672115, 0.994595, 1.69551, -0.00117, -0.00486, -0.00181, 0.00466),
    (0.50, 5.545613, 5.285016, 0.915803, 1.49966, 0.00454, 0.00209, -0.00031, 0.00499),
    (0.55, 5.776244, 3.887876, 0.807024, 1.30865, 0.00469, 0.00173, -0.00231, -0.00444),
    (0.60, 5.928751, 2.187756, 0.724861, 1.18524, 0.00418, 0.00274, -0.00042, -0.00498),
    (0.65, 5.997105, 0.544061, 0.685947, 1.13147, 0.00425, 0.00263, -0.00101, -0.00490),
    (0.70, 5.982561, -1.115951, 0.693877, 1.14219, 0.00358, 0.00349, -0.00191, -0.00462),
    (0.75, 5.885876, -2.748911, 0.748229, 1.21907, 0.00363, 0.00343, -0.00140, -0.00480),
    (0.80, 5.707564, -4.378236, 0.839538, 1.36285, 0.00348, 0.00359, -0.00063, -0.00496),
    (0.85, 5.448762, -5.952993, 0.938970, 1.55559, 0.00394, 0.00308, 0.00114, -0.00487),
    (0.90, 5.116799, -7.324504, 1.006560, 1.76107, 0.00309, -0.00393, 0.00371, 0.00335),
    (0.95, 4.707143, -8.766845, 0.999644, 1.91413, -0.00168, -0.00471, -0.00472, 0.00165),
    (1.00, 4.238456, -9.985307, 0.918991, 1.99555, -0.00238, -0.00440, -0.00380, 0.00326),
])  # fmt: skip
PINS = "clearance = { radius = 5e-3, stiffness = 1e9, restitution = 0.05, restitution_speed = 0.05, friction = 0.1, "
PINS += "friction_speed = 0.01 }"
CRANK = CubicHermiteSpline(*FOUR_BAR[:, :3].T)
TABLE = [[float(t), float(CRANK(t))] for t in np.linspace(0.0, 1.0, 101)]


def four_bar(pins: str) -> Scene:
    """Return the four-bar, whose crank moves as published: there a controller drives it."""
    crank, coupler, rocker = FOUR_BAR[0, [1, 3, 4]]
    lines = [
        f"bodies.{name}: placement = {{ origin = [{x}, {y}], angle = {angle} }}; rigid = {{ mass = 1.0, centre = "
        f"[{length / 2}, 0.0], inertia = {length**2 / 12}, points = {{ hub = [0.0, 0.0], tip = [{length}, 0.0] }} }}"
        for name, x, y, angle, length in (
            ("crank", 0.0, 0.0, crank, 1.0),
            ("coupler", np.cos(crank), np.sin(crank), coupler, 4.0),
            ("rocker", 3.0, 0.0, rocker, 2.5),
        )
    ]
    ends = {"one": ("crank:tip", "coupler:hub"), "two": ("rocker:tip", "coupler:tip")}
    ends["three"] = ("ground:right", "rocker:hub")
    lines += [f'joints.{name}: type = "revolute"; connect = ["{a}", "{b}"]; {pins}' for name, (a, b) in ends.items()]
    lines += [
        f'outputs.{axis}_{name}: type = "position"; point = "{end.replace("_", ":")}"; axis = "{axis}"'
        for name, end in {"hub": "coupler_hub", "tip": "coupler_tip", "low": "rocker_hub", "top": "rocker_tip"}.items()
        for axis in "xy"
    ]
    text = """
scene: name = "four_bar"
ground.points: right = [3.0, 0.0]
joints.main: type = "revolute"; connect = ["ground:origin", "crank:hub"]
coordinates.theta: joint = "main"; range = [0.0, 6.283185307179586]; periodic = true
effects.weight: type = "gravity"; acceleration = 9.81
simulation: duration = 0.9; step = 5e-5
"""
    text += "\n".join([*lines, f'effects.drive: type = "prescribed_motion"; coordinate = "theta"; table = {TABLE}'])
    return scene_from_toml(tables(text), ".")


def test_the_history_of_a_four_bar_with_three_loose_pins():
    """Up to 0.9 s, when a pin is about to cross its bore: bars are off by a tenth of what room makes of them, and pins
    lean on their bores within a fifth of the room of where they do there, and within 30 degrees as they go round: by
    Coulomb's law for the pins' middles here and for their surfaces there, and by a crank that is known every 50 ms."""
    angles, pins = [], []
    for loose_pins in ("", PINS):
        times, found = run(four_bar(loose_pins), "full")
        at = {name: values[np.minimum(np.searchsorted(times, FOUR_BAR[:, 0] - 1e-9), times.size - 1)]
              for name, values in found.items()}  # fmt: skip
        hub, tip, low, top = (np.array([at[f"x_{name}"], at[f"y_{name}"]]) for name in ("hub", "tip", "low", "top"))
        crank = FOUR_BAR[:, 1]
        pins = [hub - [np.cos(crank), np.sin(crank)], low - [[3.0], [0.0]]]
        angles.append([np.arctan2(*(b - a)[::-1]) for a, b in ((hub, tip), (low, top))])
    known = FOUR_BAR[:, 0] < 0.92
    off = np.abs(np.array(angles) - FOUR_BAR[:, 3:5].T)[:, :, known].max(axis=2)
    assert np.all(off[1] < 0.15 * off[0]) and np.all(off[0] > 8e-3), off
    for pin, own in zip(pins, (FOUR_BAR[:, 5:7].T, FOUR_BAR[:, 7:9].T)):
        apart = np.hypot(*(pin - own))[known]
        assert apart.max() < 2.0 * 5e-3 * np.sin(np.radians(15.0)) and apart.mean() < 0.2 * 5e-3, apart
