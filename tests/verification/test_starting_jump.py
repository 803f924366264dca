"""What sets off vibrations at once: what is said, with closed forms of beams; steps that do not resolve light nodes."""

from pathlib import Path

import numpy as np
import pytest
from runs import MODELS, ONE_RANK, full_model, motion, reduced_model, samples, trajectory

from pgmp_petsc.base.errors import Remark
from pgmp_petsc.ensemble.integration import run_ensemble
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.results import Balance
from pgmp_petsc.scene import scene_from_toml
from pgmp_petsc.studies.check import describe_scene
from pgmp_petsc.studies.reduced_run import jump_remarks
from pgmp_petsc.studies.single_run import balance_remarks
from scenes import HEADER, meshes_of, slider_crank, tables

LENGTH, RADIUS, RHO, YOUNG, G = 0.8, 4e-3, 7800.0, 210e9, 9.80665
AREA, SECOND_MOMENT = np.pi * RADIUS**2, np.pi * RADIUS**4 / 4
BAR = tables(f"""
scene: name = "bar"
materials.steel: E = {YOUNG}; nu = 0.3; rho = {RHO}
bodies.bar: mesh = "0.0:{LENGTH}:24"; element = "beam2d"; material = "steel";
    section = {{ shape = "circle", radius = {RADIUS} }}
joints.hinge: type = "revolute"; connect = ["ground:origin", "bar:hinge"]
coordinates.theta: joint = "hinge"; range = [-1.0, 1.0]
reduction: modes = 6; angles = 8; static_modes = true; interpolation = "spline"
simulation: duration = 0.05; step = 5e-4; spectral_radius = 0.99; error_indicator = false; frames = 0
""")
WEIGHT = '\n[effects.weight]\ntype = "gravity"\n'
HELD = '\n[effects.drive]\ntype = "prescribed_motion"\ncoordinate = "theta"\ntable = [[0.0, 0.0], [1.0, 0.0]]\n'
DAMPED = '\n[effects.damping]\ntype = "structural_damping"\nstiffness = 1e-3\n'
PULLED = tables("""
ground.points: hook = [0.8, 0.3]
effects.cord: type = "spring_damper"; points = ["ground:hook", "bar:tip"]; stiffness = 100.0; rest = 0.1
""")
#: Strain energy of the bar, clamped at one end, under its weight: int M^2 / (2 E I) with M = w (L - x)^2 / 2.
CLAMPED = (RHO * AREA * G) ** 2 * LENGTH**5 / (40 * YOUNG * SECOND_MOMENT)
#: The same of the bar that is let go about its hinge and falls as a chimney does: M = w x (L - x)^2 / (4 L).
FALLING = (RHO * AREA * G) ** 2 * LENGTH**5 / (3360 * YOUNG * SECOND_MOMENT)


def reduced(text: str) -> ReducedModel:
    scene = scene_from_toml(BAR + text, ".")
    return reduced_model(scene)


@pytest.mark.parametrize(("rest", "loaded"), [(0.1, True), (0.3 + 1e-15, False)])
def test_a_check_names_springs_that_act_at_the_start(rest: float, loaded: bool) -> None:
    """A spring at rest but for round-off acts on nothing, nor do elastic joints, which are placed so."""
    gives = "\n[joints.hinge.elastic]\nreference = [[1.0, 0.0]]\nstiffness = [1e6, 1e6]\nturning_stiffness = [0.0]\n"
    scene = scene_from_toml(BAR + PULLED.replace("rest = 0.1", f"rest = {rest}") + gives, ".")
    lines = [line for line in describe_scene(scene, meshes_of(scene)).splitlines() if line.startswith("  start")]
    assert [line[16:47] for line in lines] == ["undeformed, with cord acting at"] * loaded


@pytest.mark.parametrize(
    ("motion", "cure"),
    [("spin_up = { speed = 5.0, time = 0.1 }", "initial.equilibrium = true starts with it"),
     ("constant_speed = { speed = 5.0 }", "let loads grow from zero, or begin at rest, in equilibrium")],
)  # fmt: skip
def test_a_check_names_a_cure_that_is_taken(motion: str, cure: str) -> None:
    """A start in equilibrium is refused of a motion that does not begin at rest."""
    turned = HELD.replace("table = [[0.0, 0.0], [1.0, 0.0]]", motion)
    scene = scene_from_toml(BAR + PULLED + turned, ".")
    (line,) = [one for one in describe_scene(scene, meshes_of(scene)).splitlines() if one.startswith("  start")]
    assert cure in line


def said(model: ReducedModel) -> list[Remark]:
    found = trajectory(model).record.remarks
    return [remark for remark in found if "starts undeformed" in remark.text]


@pytest.mark.parametrize(("text", "energy"), [(WEIGHT + HELD, CLAMPED), (WEIGHT, FALLING)], ids=["held", "falling"])
def test_shares_are_those_of_the_quasi_static_deformation(text: str, energy: float) -> None:
    """Six modes of 24 elements leave 0.5 % of the energies: elements 1 / n^2 and the modes beyond."""
    model = reduced(text)
    system = model.batch(samples(model.scene, 1), 1)
    start = system.start()
    for share in (0.6, 0.8):
        (remark,) = jump_remarks(model, system, start, np.array([0.0, energy * (2.0 / share) ** 2]))
        assert f"makes {100 * share:.0f} % of its largest deformation" in remark.text
    assert jump_remarks(model, system, start, np.array([0.0, energy * (2.0 / 0.49) ** 2])) == ()
    assert jump_remarks(model, system, start, np.zeros(2)) == ()


def test_a_bar_that_is_held_is_warned_of_and_cured() -> None:
    model = reduced(WEIGHT + HELD)
    (remark,) = said(model)
    assert remark.kind == "warning" and "with effects.weight at once" in remark.text
    # a mass on a spring swings to twice its static deformation, the modes of a bar nearly together
    assert "makes 100 % of" in remark.text or "makes 9" in remark.text
    assert "nothing in the bodies damps it" in remark.text
    assert "; initial.equilibrium = true starts with the static one" in remark.text
    start = scene_from_toml(BAR + WEIGHT + HELD + "\n[initial]\nequilibrium = true\n", ".")
    settled = ReducedModel(start, model.rom)
    run = motion(settled)
    np.testing.assert_allclose(run.balance.strain, CLAMPED, rtol=1e-2)  # it rests
    assert said(settled) == []


def test_a_bar_that_is_let_go_has_another_cure() -> None:
    """Held at first it would bend as a cantilever does, ten times as far as it bends when it falls."""
    (remark,) = said(reduced(WEIGHT + DAMPED))
    assert remark.kind == "note" and "does not help here" in remark.text
    assert "nothing in the bodies damps it" not in remark.text


def test_springs_count_and_loads_that_grow_do_not() -> None:
    (remark,) = said(reduced(PULLED + HELD))
    assert remark.kind == "warning" and "with effects.cord at once" in remark.text
    torque = '\n[effects.motor]\ntype = "torque"\njoint = "hinge"\ntable = [[0.0, {}], [0.05, 1.0]]\n'
    assert said(reduced(torque.format(0.0))) == []
    # a controller counts, and the tail of a smooth law does not
    near = '\n[effects.near]\ntype = "law"\njoint = "hinge"\nforce = "-exp((s - 1) / 0.02)"\n'
    servo = (
        '\n[controllers.servo]\ntype = "pid"\njoint = "hinge"\nmeasures = "angle"\nreference = 0.5\n'
        'gains = { p = 2.0 }\n\n[outputs.angle]\ntype = "angle"\njoint = "hinge"\n'
    )
    for once, entry in ((torque.format(1.0), "effects.motor"), (servo + near, "controllers.servo")):
        (remark,) = said(reduced(once))
        assert f"with {entry} at once" in remark.text


def test_a_spinning_start_has_no_static_deformation() -> None:
    (remark,) = said(reduced("[simulation.initial.theta]\nvelocity = 10.0\n"))
    assert remark.kind == "note" and "with inertia forces of its speed at once" in remark.text


def test_large_estimated_errors_are_warned_of() -> None:
    """Eleven steps in the lowest period (9.1 Hz) turn the swing of a bar by (omega h)^2 / 12 of its 28 rad, 0.8 rad."""
    output = '\n[outputs.bend]\ntype = "deformation"\npoint = "bar:tip"\naxis = "y"\n'
    model = reduced(WEIGHT + HELD + output)
    for step, n_warnings in ((1e-2, 1), (5e-4, 0)):
        changed = {"step": step, "duration": 0.5, "error_indicator": True}
        simulation = model.scene.simulation.model_copy(update=changed)
        other = model.with_loads(model.scene.model_copy(update={"simulation": simulation}))
        run = trajectory(other)
        found = [remark for remark in run.record.remarks if "large estimated errors" in remark.text]
        assert len(found) == n_warnings
        if found:
            assert found[0].kind == "warning" and f"bend {100 * run.errors.share('bend'):.2g} %" in found[0].text


ALL_TERMS = ("reduction.static_modes=true", "reduction.inertia_modes=true", "reduction.second_order=true",
             "reduction.angles=24", "simulation={duration=0.02, step=1e-3}")  # fmt: skip


def test_a_load_without_static_answer_is_no_failure_of_the_remark() -> None:
    """The static deformation of a reduced slider-crank under so much has no end, and is no cure."""
    scene = slider_crank("effects.motor.table=[[0.0, 64.0]]", *ALL_TERMS)
    (remark,) = said(reduced_model(scene))
    assert remark.kind == "note" and "initial.equilibrium = true does not help here" in remark.text


# the rotation of a node vibrates with some 200 kHz (GA l / 4 over rho I l / 3), 200 periods a step
ARM = HEADER + tables("""
bodies.arm: mesh = "0.0:0.5:5"; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.02, height = 0.006 }
joints.hinge: type = "revolute"; connect = ["ground:origin", "arm:hinge"]
coordinates.theta: joint = "hinge"; range = [0.0, 6.283185307179586]; periodic = true
effects.motor: type = "torque"; joint = "hinge"; table = [[0.0, 1.0], [1.0, 1.0]]
effects.loss: type = "structural_damping"; stiffness = 3e-5
reduction: modes = 4; static_modes = true; angles = 12
simulation: duration = 0.1; step = 1e-3
outputs.angle: type = "angle"; joint = "hinge"
outputs.moment: type = "stress"; body = "arm"; quantity = "bending_moment"; at = [0.05, 0.0]
""")


@pytest.mark.parametrize("model", MODELS)
def test_a_motor_that_is_switched_on_bends_the_arm_no_more_than_it_can(model: str) -> None:
    """Of the bending moment beside a torque of 1 Nm 1.14 Nm are reached with steps of 10 us; it was 6.3 with 1 ms."""
    scene = scene_from_toml(ARM, ".")
    run = motion(model, scene)
    assert np.abs(run.outputs["moment"]).max() == pytest.approx(1.14, rel=0.15)
    assert run.outputs["angle"][-1] == pytest.approx(0.12999, rel=1e-2)
    assert np.abs(run.balance.residual).max() < 3e-3 * run.balance.exchanged  # 1.3e-3
    assert not [remark for remark in run.record.remarks if "out of balance" in remark.text]


FREE = (
    HEADER
    + """
[bodies.crank]
rigid = { mass = "m", inertia = 0.005, points = { a = [0.0, 0.0], b = [0.2, 0.0] } }
[parameters.m]
nominal = 2.0
distribution = { name = "uniform", loc = 2.0, scale = 2e-9 }
[bodies.rod]
rigid = { mass = 1.0, inertia = 0.03, centre = [0.25, 0.0], points = { a = [0.0, 0.0], b = [0.5, 0.0] } }
placement = { origin = [0.2, 0.0], angle = 0.0 }
[joints]
hinge = { type = "revolute", connect = ["ground:origin", "crank:a"] }
pin = { type = "revolute", connect = ["crank:b", "rod:a"] }
slide = { type = "point_on_line", connect = ["ground:origin", "rod:b"], direction = [1.0, 0.0] }
[coordinates.theta]
joint = "hinge"
range = [0.0, 6.283185307179586]
periodic = true
[simulation]
duration = 0.5
step = 2e-3
initial.theta.velocity = 10.0
"""
)


def balance(work: float, *, stored: float = 0.0) -> Balance:
    """Return a balance of 1 J that comes to be, and work done by a motor, beside much energy that stays."""
    rising = np.linspace(0.0, 1.0, 5)
    return Balance(stored + rising, 0.0 * rising, 0.0 * rising, {"motor": work * rising})


def test_energies_out_of_balance_are_warned_of() -> None:
    (remark,) = balance_remarks(balance(0.8), 1e-3)
    assert remark.kind == "warning"
    assert "out of balance by up to 0.2 J, of 0.9 J" in remark.text and "steps of 0.001 s" in remark.text
    assert "smaller simulation.step" in remark.text


def test_energies_in_balance_and_the_round_off_of_what_rests_are_not() -> None:
    assert not balance_remarks(balance(0.99), 1e-3)
    assert not balance_remarks(balance(0.0, stored=1e10), 1e-3)


def test_where_nothing_works_or_deforms_energy_is_that_of_the_motion(tmp_path: Path) -> None:
    """Two rigid bars that turn freely: all changes of energy are the residual, which was out of balance by itself."""
    text = FREE + "[ensemble]\nbalance = true\n"  # its parameter is drawn within 1e-9 of its nominal value
    model = full_model(scene_from_toml(text, "."))
    run = trajectory("full", model.scene)
    kinetic = run.balance.kinetic.max()
    assert 0.0 < np.abs(run.balance.residual).max() < 1e-3 * kinetic and run.balance.exchanged == kinetic
    assert not [remark for remark in run.record.remarks if "out of balance" in remark.text]
    found = run_ensemble(model, Plan(1, 2, tmp_path / "e.h5", False), ONE_RANK).balance
    np.testing.assert_allclose(found["exchanged"], kinetic, rtol=1e-8)
    np.testing.assert_allclose(found["residual"], np.abs(run.balance.residual).max(), atol=1e-8 * kinetic)
    # steps that do not resolve the motion lose much of its energy
    coarse = trajectory("full", scene_from_toml(text, ".", ["simulation.step=0.05"]))
    assert [remark.kind for remark in coarse.record.remarks if "out of balance" in remark.text] == ["warning"]


@pytest.mark.parametrize("model", MODELS)
def test_a_mechanism_that_rests_is_said_to_rest(model: str) -> None:
    """Its energies, of 1e-24 J, and its bending were far out of balance and wrong by a third."""
    bent = '[outputs.bent]\ntype = "deformation"\npoint = "arm:tip"\naxis = "y"\n'
    still = ("effects.motor.table=[[0.0, 0.0], [1.0, 0.0]]", "simulation.initial.theta.position=0.4")
    run = trajectory(model, scene_from_toml(ARM + bent, ".", still))
    assert run.balance.exchanged < 1e-20 and run.errors.largest["bent"] == 0.0
    found = [remark.text for remark in run.record.remarks]
    assert sum("the mechanism rests" in text for text in found) == 1
    assert not [text for text in found if "balance" in text or "large" in text or "vibration" in text], found
    # what moves by nanometres moves
    moving = trajectory(model, scene_from_toml(ARM + bent, ".", ("effects.motor.table=[[0.0, 0.0], [1.0, 1e-6]]",)))
    assert not [remark for remark in moving.record.remarks if "rests" in remark.text]


def vibration(loss: float, *, steps: int, turns: int = 100) -> Balance:
    """Return a free vibration of 1 J with so many steps a turn, in all of which together a share of it is lost."""
    time = np.linspace(0.0, float(turns), turns * steps + 1)
    left = 1.0 - loss * time / turns
    return Balance(left * np.cos(np.pi * time) ** 2, left * np.sin(np.pi * time) ** 2, 0.0 * time, {})


def test_what_is_left_over_of_a_long_run_may_add_up() -> None:
    """A tenth of a percent a turn is no alarm; most of the energy is, and a vibration that steps do not resolve."""
    assert not balance_remarks(vibration(0.1, steps=40), 1e-3)
    assert balance_remarks(vibration(0.8, steps=40), 1e-3)
    assert balance_remarks(vibration(0.1, steps=3), 1e-3)
    # what is lost at once is no less wrong where the run goes on for long
    free = vibration(0.0, steps=40)
    kept = np.where(np.arange(free.kinetic.size) > 20, 0.8, 1.0)
    assert balance_remarks(Balance(kept * free.kinetic, kept * free.strain, free.potential, {}), 1e-3)


def test_a_run_whose_steps_are_far_too_long_says_so() -> None:
    """A stiff spring that is let go swings the arm and bends it, in steps of 5 ms."""
    stop = '[effects.stop]\ntype = "spring_damper"\njoint = "hinge"\nstiffness = 2e3\nrest = 0.3\n'
    scene = scene_from_toml(ARM + stop, ".", ["simulation.step=5e-3"])
    run = trajectory("full", scene)
    assert [remark.kind for remark in run.record.remarks if "out of balance" in remark.text] == ["warning"]
