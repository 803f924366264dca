"""Joints that couple motions: in every model, against closed forms, an independent integration, and each other; ratios,
radii and leads as parameters."""

from pathlib import Path

import numpy as np
import pytest
from alike import assert_alike
from coupled_scenes import CAM, CAM_TABLE, GEARED, RACK, ROTORS, ROTORS_IN_SPACE, SCREW, SHAFTS
from differences import differences
from exported import assert_equal, assert_same_in_c, compiled, needs_compiler, outputs_of, simulated
from machine_scenes import MODELS, run
from mpi4py import MPI
from runs import assert_close, history, motion, reduced_model, rom_of, samples
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import eigh
from scipy.optimize import brentq

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bench.reference import component_model
from pgmp_petsc.estimates.own_error import why_not_of_full_order
from pgmp_petsc.gradients.differentiated import differentiate
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import ReducedModel, SeparateLengths, of_samples
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.studies.inputs import with_meshes
from scenes import kinematics_of

RATIO = -0.37


@pytest.mark.parametrize("model", ["full", "components"])
@pytest.mark.parametrize("text", [ROTORS, ROTORS_IN_SPACE], ids=["plane", "space"])
def test_two_geared_rotors_are_one_with_both_inertias(text: str, model: str) -> None:
    """T = (I_1 + r^2 I_2) phi'', over several turns of the first one, from the placements on."""
    errors = []
    for step in (4e-3, 2e-3):
        times, found = run(scene_from_toml(text, ".", [f"simulation.step={step}"]), model)
        exact = 0.5 * 0.7 / (0.02 + RATIO**2 * 0.5) * times**2
        assert exact[-1] > 4.0 * np.pi
        errors.append(np.abs(found["one"] - exact).max() / exact[-1])
        # what Newton's method leaves
        placed = 0.4 if text is ROTORS else 0.0
        np.testing.assert_allclose(found["two"] - placed, RATIO * found["one"], rtol=0, atol=1e-8)
    # the scheme is exact for a constant acceleration of an angle, and of no director
    if text is ROTORS or model == "components":
        assert max(errors) < 1e-7
    else:
        assert errors[0] / errors[1] == pytest.approx(4.0, abs=0.3)
        assert errors[1] < 1e-4


@pytest.mark.parametrize("model", ["full", "components"])
@pytest.mark.parametrize("crossed", [False, True])
@pytest.mark.parametrize("text", [ROTORS, ROTORS_IN_SPACE], ids=["plane", "space"])
def test_a_belt_makes_one_of_two_rotors_with_both_inertias(text: str, crossed: bool, model: str) -> None:
    """``T = (I_1 + (r_1 / r_2)^2 I_2) phi''``, of rotors that turn the same way or against one another."""
    belt = f"joints.mesh={{type='belt',joints=['input','output'],radii=[0.02,0.05],crossed={str(crossed).lower()}}}"
    across = ("joints.output.axis=[0.0,0.0,1.0]",) if text is ROTORS_IN_SPACE else ()
    inertia = 0.7 if across else 0.5  # of the second rotor about the axis
    times, found = run(scene_from_toml(text, ".", (belt, *across, "simulation.duration=1.0")), model)
    exact = 0.5 * 0.7 / (0.02 + 0.4**2 * inertia) * times**2
    # what steps of 2 ms leave of directors in space (the test above has the order), and nothing in the plane
    np.testing.assert_allclose(found["one"], exact, rtol=0, atol=(1e-4 if across else 1e-7) * exact[-1])
    placed = 0.4 if text is ROTORS else 0.0
    np.testing.assert_allclose(found["two"] - placed, (-0.4 if crossed else 0.4) * found["one"], rtol=0, atol=1e-8)


CROSSED = "radii=[0.003,0.003],crossed=true"


@pytest.mark.parametrize(("model", "over"), [*((model, CROSSED) for model in MODELS), ("full", "ratio=-1")])
def test_a_crossed_belt_over_equal_pulleys_is_a_gear(model: str, over: str) -> None:
    """On flexible cranks, in every model."""
    short = ("simulation.duration=0.05", "reduction.angles=24", "reduction.second_order=false")
    belt = f"joints.mesh={{type='belt',joints=['input','output'],{over}}}"
    gear, found = (run(scene_from_toml(GEARED, ".", own), model)[1] for own in (short, (*short, belt)))
    assert_alike(gear, found, 1e-9)


@pytest.mark.parametrize("model", ["full", "components"])
def test_a_rack_and_its_pinion_on_a_spring_are_an_oscillator(model: str) -> None:
    errors = []
    for step in (2e-3, 1e-3):
        times, found = run(scene_from_toml(RACK, ".", [f"simulation.step={step}"]), model)
        exact = swing(times, 0.05)
        assert np.abs(exact).max() > 2.0 * np.pi
        np.testing.assert_allclose(found["x"], 0.05 * found["phi"], rtol=0, atol=1e-9)
        errors.append(np.abs(found["phi"] - exact).max())
    assert errors[0] / errors[1] == pytest.approx(4.0, abs=0.3)
    assert errors[1] < 1e-4  # (rate step)^2 / 12 of rate times duration, of 9 rad


@pytest.mark.parametrize("model", ["full", "components"])
def test_a_screw_moves_its_mass_and_its_inertia(model: str) -> None:
    """F = (m + I (2 pi / lead)^2) x''."""
    turns, errors = 2.0 * np.pi / 0.5, []
    for step in (4e-3, 2e-3):
        times, found = run(scene_from_toml(SCREW, ".", [f"simulation.step={step}"]), model)
        exact = 0.5 * 4.0 / (3.0 + 0.02 * turns**2) * times**2
        assert turns * exact[-1] > 4.0 * np.pi
        errors.append(np.abs(found["x"] - exact).max() / exact[-1])
        np.testing.assert_allclose(found["phi"], turns * found["x"], rtol=0, atol=1e-8)
    if model == "components":  # its coordinates turn and slide evenly: the scheme is exact
        assert max(errors) < 1e-7
        return
    assert errors[0] / errors[1] == pytest.approx(4.0, abs=0.3)
    assert errors[1] < 2e-4


@pytest.mark.parametrize("model", ["full", "components"])
def test_a_cam_lifts_its_follower(model: str) -> None:
    """(I + m f'^2) phi'' + m f' f'' phi'^2 + k f f' = 0."""
    lift = CubicSpline(*np.array(CAM_TABLE).T, bc_type="periodic")

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        f, slope, bend = (lift(y[0], k) for k in range(3))
        return np.array([y[1], -(2.0 * slope * bend * y[1] ** 2 + 300.0 * f * slope) / (0.02 + 2.0 * slope**2)])

    errors = []
    for step in (2e-3, 1e-3):
        times, found = run(scene_from_toml(CAM, ".", [f"simulation.step={step}"]), model)
        exact = solve_ivp(rates, (0.0, times[-1]), (0.3, 20.0), "DOP853", times, rtol=1e-11, atol=1e-12).y[0]
        errors.append([np.abs(found["phi"] - exact).max(), np.abs(found["x"] - lift(exact)).max()])
    assert np.ptp(exact) > 2.0 * np.pi
    # where pieces of the spline meet, accelerations have a kink
    np.testing.assert_allclose(np.array(errors[0]) / errors[1], 4.0, atol=0.6)
    assert np.all(np.array(errors[1]) < [1e-3, 5e-5])


def test_a_sum_of_motions_is_a_gear() -> None:
    _, gear = run(scene_from_toml(ROTORS, "."), "full")
    terms = "joints.mesh={type='coupling',terms={output=2.0,input=0.74}}"
    _, summed = run(scene_from_toml(ROTORS, ".", [terms]), "full")
    for name in gear:
        np.testing.assert_allclose(summed[name], gear[name], rtol=1e-9, atol=1e-9)


def test_a_flexible_shaft_with_a_disc_and_a_geared_wheel_twists_at_the_rate_of_its_closed_form() -> None:
    """A rod in torsion, phi = cos b x + A sin b x, with r^2 I of the wheel at its beginning and I of the disc at its
    end."""
    shear, area_moment = 210e9 / 2.6, 0.5 * np.pi * 0.005**4
    wave, stiffness = np.sqrt(shear / 7800.0), shear * area_moment

    def gap(rate: float) -> float:
        b = rate / wave
        a = -(rate**2) * 0.08 / (stiffness * b)
        end, slope = np.cos(0.5 * b) + a * np.sin(0.5 * b), b * (a * np.cos(0.5 * b) - np.sin(0.5 * b))
        return stiffness * slope - rate**2 * 0.01 * end

    exact = brentq(gap, 100.0, 200.0) / (2.0 * np.pi)
    scene = scene_from_toml(SHAFTS, ".")
    kinematics = kinematics_of(scene)
    with ModalProblem(kinematics, scene.nominal, 8, MPI.COMM_SELF) as problem:
        found = problem.solve(0.7).frequencies_hz
    # eight elements of a mode that is almost linear
    assert np.abs(found - exact).min() < 1e-6 * exact


GENTLY = ("effects.motor.table=[[0.0,0.0],[0.2,0.3],[1.0,0.3]]",)


# what a component run leaves out: forces in the legs that stiffen them, and their foreshortening
OF_SECOND_ORDER = ("effects.stiff={type='geometric_stiffening'}", "effects.inertia={type='mode_inertia'}")


@pytest.mark.parametrize(("model", "overrides"), [("reduced", ()), ("components", GENTLY)])
def test_models_of_a_geared_five_bar_agree(model: str, overrides: tuple[str, ...]) -> None:
    """To 1 % of the deformation, over a turn under the larger torque; both cranks keep their ratio."""
    scene = scene_from_toml(GEARED, ".", overrides)
    (_, full), (_, found) = (run(scene, one) for one in ("full", model))
    assert full["input"][-1] > (1.0 if overrides is GENTLY else 2.0 * np.pi)
    for one, allowed in ((full, 1e-8), (found, 1e-3)):  # that of flexible cranks is their joints'
        np.testing.assert_allclose(one["output"] - one["output"][0], -one["input"], rtol=0, atol=allowed)
    # the place follows the angle, which is of 7 rad
    assert_close(full, found, input=1e-4, output=1e-4, x=3e-4, bending=0.01)


def test_what_component_runs_of_a_geared_five_bar_leave_out_is_of_second_order() -> None:
    """3.4 % of the bending: four times as stiff, a quarter of it, as of the forces in the legs over those that buckle
    them; with these terms a fiftieth is left."""

    def share(*overrides: str) -> float:
        scene = scene_from_toml(GEARED, ".", ("simulation.step=5e-4", *overrides))
        (_, found), (_, full) = (run(scene, model) for model in ("components", "full"))
        return float(np.abs(found["bending"] - full["bending"]).max() / np.abs(full["bending"]).max())

    off, stiffer, with_it = share(), share("materials.steel.E=840e9"), share(*OF_SECOND_ORDER)
    assert off == pytest.approx(0.034, rel=0.1)
    assert off / stiffer == pytest.approx(4.0, rel=0.2)
    assert with_it < 0.03 * off


@needs_compiler
def test_a_model_in_c_keeps_the_gear(tmp_path: Path) -> None:
    assert_same_in_c(reduced_model(scene_from_toml(GEARED, ".", ("simulation.duration=0.2",))), tmp_path)


@pytest.mark.parametrize("model", ["full", "reduced"])
def test_nothing_is_lost_between_coupled_joints(model: str) -> None:
    """The energies of a geared five-bar that runs freely."""
    free = "simulation={spectral_radius=1.0,duration=0.2,step=2.5e-4,initial={phi={velocity=8.0}}}"
    balance = motion(model, scene_from_toml(GEARED, ".", ("effects={}", free))).balance
    # the square of the step, of the shortest vibrations that the run begins with
    assert np.abs(balance.residual).max() < 1e-3 * balance.kinetic[0]


def test_a_turn_that_does_not_bring_a_geared_body_back_says_so() -> None:
    turn = ("coordinates.phi.range=[0.0, 6.283185307179586]", "coordinates.phi.periodic=true")
    with pytest.raises(InputError, match="joints.mesh a body moved by a part of a turn: the slowest joint"):
        scene = scene_from_toml(ROTORS, ".", turn)
        kinematics_of(scene)


COUPLED = "joints.mesh={type='coupling',terms={output=2.0,input=0.74}}"


def swing(t: np.ndarray, r: float) -> np.ndarray:
    """Return the angle of the pinion on a rack that a spring holds."""
    rate = np.sqrt(200.0 * r**2 / (0.02 + 3.0 * r**2))
    return 40.0 / rate * np.sin(rate * t)


RIGID = {
    # scene and entry, values, the coordinate's motion
    "gear": (ROTORS, "joints.mesh.ratio", (-0.41, 0.6), lambda t, r: 0.35 / (0.02 + r**2 * 0.5) * t**2, "one"),
    "coupling": (
        ROTORS, "joints.mesh.terms.input", (0.5, -2.0), lambda t, r: 0.35 / (0.02 + r**2 / 8.0) * t**2, "one"),
    "screw": (
        SCREW, "joints.thread.lead", (0.3, -0.7), lambda t, r: 2.0 / (3.0 + 0.02 * (2.0 * np.pi / r) ** 2) * t**2, "x"),
    "rack": (RACK, "joints.teeth.radius", (0.05,), swing, "phi"),
}  # fmt: skip


@pytest.mark.parametrize("model", ["full", "components"])
@pytest.mark.parametrize("kind", list(RIGID))
def test_each_sample_has_its_own_ratio(kind: str, model: str) -> None:
    """From rest under a constant force, or against a spring: motions whose factors hang on the ratio or the radius."""
    text, entry, values, motion_of, output = RIGID[kind]
    for value in values:
        span = sorted((0.8 * value, 1.2 * value))
        given = (f"{entry}='r'", f"parameters.r={{nominal={value},bounds={span}}}", "simulation.duration=0.4")
        scene = scene_from_toml(text, ".", (*((COUPLED,) if kind == "coupling" else ()), *given))
        of_each = of_samples(MODELS[model](scene), ["r"])
        assert isinstance(of_each, SeparateLengths)
        for own in (value, 1.07 * value, 1.16 * value)[: 3 if kind == "rack" else 2]:
            times, found = history(of_each, samples(scene, 1, r=own), 1)
            exact = {output: motion_of(times, own)[:, None]}
            if kind == "rack":
                exact["x"] = own * exact["phi"]
            # steps over 0.4 s, of directors in space: to (rate step)^2 / 12, of the rack's rate times duration too
            assert_close(exact, found, **dict.fromkeys(exact, 1e-4 if kind == "rack" else 1e-3))


OF_RATIO = (
    "joints.mesh.ratio='ratio'", "parameters.ratio={nominal=-1.0,bounds=[-1.03,-0.96]}",
    "coordinates.phi.range=[0.0,1.2]", "coordinates.phi.periodic=false", "reduction.angles=20", "reduction.modes=4",
    "reduction.second_order=false", "reduction.length_points=6", "simulation.duration=0.15", "simulation.step=1e-3",
)  # fmt: skip
OTHER = -0.973


def geared(*overrides: str) -> Scene:
    """Return a geared five-bar whose ratio is a parameter, over a part of a turn."""
    return scene_from_toml(GEARED, ".", (*OF_RATIO, *overrides))


def numbered(*overrides: str) -> Scene:
    """Return it with the other ratio as a number."""
    return geared(f"joints.mesh.ratio={OTHER}", "parameters={}", *overrides)


@pytest.fixture(scope="module")
def rom() -> ReducedOrderModel:
    return rom_of(geared())


@pytest.mark.parametrize("model", ["full", "components"])
def test_a_sample_of_flexible_bodies_is_the_model_that_has_its_ratio(model: str) -> None:
    scene = geared()
    found = history(of_samples(MODELS[model](scene), ["ratio"]), samples(scene, 1, ratio=OTHER), 1)[1]
    exact = history(MODELS[model](numbered()), {}, 1)[1]
    assert_alike(exact, found, 1e-12)


def test_a_reduced_model_with_another_ratio_is_the_one_that_is_built_with_it(rom: ReducedOrderModel) -> None:
    scene, built = geared(), MODELS["reduced"](numbered())
    model = ReducedModel(scene, rom)
    own = model.at_lengths(scene.with_values({"ratio": OTHER}))
    tables, exact = own.rom.tables, built.rom.tables
    for place in range(0, 20, 4):
        found, wanted = (
            eigh(of.stiffness[place, 0], of.mass[place, 0][1:, 1:], eigvals_only=True) for of in (tables, exact)
        )
        np.testing.assert_allclose(found, wanted, rtol=1e-6)
    asked = (built, {}), (own, samples(own.scene, 1)), (of_samples(model, ["ratio"]), samples(scene, 1, ratio=OTHER))
    runs = [history(one, values, 1)[1] for one, values in asked]
    # stiffness between angles, in bases that are turned against each other, leaves 3e-5 of the deformation, as two
    # builds with other angles do
    for found in runs[1:]:
        assert_close(runs[0], found, input=1e-7, output=1e-7, x=1e-7, bending=1e-4)
    of_nominal = history(model, samples(scene, 1), 1)[1]
    assert np.abs(of_nominal["bending"] - runs[0]["bending"]).max() > 0.01 * np.abs(runs[0]["bending"]).max()


def test_derivatives_with_a_ratio_are_central_differences(rom: ReducedOrderModel) -> None:
    scene = geared("simulation.duration=0.05")
    lanes = of_samples(ReducedModel(scene, rom), ["ratio"])
    done = differentiate(lanes, scene.values, ["ratio"])
    for name, expected in differences(lanes, "ratio", 1e-3).items():
        size = max(np.abs(expected).max(), 1e-7 * np.abs(done.outputs[name]).max())
        assert np.abs(done.derivatives[name]["ratio"] - expected).max() < 1e-6 * size, name


@needs_compiler
def test_a_model_in_c_has_the_ratio_of_its_export(rom: ReducedOrderModel, tmp_path: Path) -> None:
    scene = geared()
    model = ReducedModel(scene.with_values({"ratio": OTHER}), rom)
    assert_equal(outputs_of(compiled(model, tmp_path)), simulated(model).outputs)
    assert '"ratio"' not in (tmp_path / "steps.c").read_text()


def test_a_ratio_that_does_not_bring_bodies_back_says_so() -> None:
    turn = ("coordinates.phi.range=[0.0,6.283185307179586]", "coordinates.phi.periodic=true")
    with pytest.raises(InputError, match="at ratio = .*joints.mesh a body moved by a part of a turn"):
        rom_of(geared(*turn, "reduction.angles=8", "reduction.length_points=2"))


def test_component_runs_of_samples_say_what_is_not_estimated() -> None:
    scene = geared()
    model = component_model(*with_meshes(scene, Purpose.COMPONENTS), MPI.COMM_SELF)
    said = [remark.text for remark in why_not_of_full_order(of_samples(model, ["ratio"]))]
    assert said[0].startswith("errors of the component modes")
