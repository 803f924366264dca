"""What is said of runs whose start sets off vibrations, against closed forms of beams."""

import numpy as np
import pytest
from runs import motion, reduced_model, trajectory

from pgmp_petsc.base.errors import Remark
from pgmp_petsc.estimates.starts import jump_remarks
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.scene import scene_from_toml
from scenes import slider_crank, tables

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
simulation: duration = 0.05; step = 5e-4; spectral_radius = 1.0; error_indicator = false; frames = 0
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


def said(model: ReducedModel) -> list[Remark]:
    """Return what a run says of its start."""
    found = trajectory(model).record.remarks
    return [remark for remark in found if "starts undeformed" in remark.text]


@pytest.mark.parametrize(("text", "energy"), [(WEIGHT + HELD, CLAMPED), (WEIGHT, FALLING)], ids=["held", "falling"])
def test_shares_are_those_of_the_quasi_static_deformation(text: str, energy: float) -> None:
    """Six modes of 24 elements leave 0.5 % of the energies: elements 1 / n^2 and the modes beyond."""
    model = reduced(text)
    system = model.batch({name: np.array([value]) for name, value in model.scene.values.items()}, 1)
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
    (remark,) = said(reduced(torque.format(1.0)))
    assert "with effects.motor at once" in remark.text


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
