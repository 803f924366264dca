"""Bodies of cells: condensed and on their meshes, beside beams and alone; frequencies, tables and runs."""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from alike import assert_alike, assert_order, shares_left
from pencils import modal_problem
from runs import ONE_RANK, assert_close, full_model, motion, rom_of
from solid_scenes import GRAVITY, HEIGHT, THICKNESS, solid_meshes, solid_slider_crank
from solids import rectangle_mesh

from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.components.condensing import condensed
from pgmp_petsc.effects import effects_of, loads_of, patterns_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.reduction.sampler import Sampler, StaticLoads, TurnedLoads
from pgmp_petsc.results import Trajectory
from pgmp_petsc.scene import Scene, scene_from_toml
from scenes import HEADER, kinematics_of, slider_crank, straight, tables

N_MODES = 6
DAMPING = 'effects.friction={type="structural_damping", stiffness=2e-5, mass=0.5}'
MOVING = ("simulation.initial.theta.position=0.3", "simulation.initial.theta.velocity=4.0")


@lru_cache
def scene_and_shapes(small: bool) -> tuple[Scene, Mapping[str, BodyShape]]:
    """Return the scene with gravity and its bodies, condensed or on their meshes."""
    scene, meshes = solid_slider_crank(GRAVITY, f"reduction.modes={N_MODES}"), solid_meshes("quad8", 40)
    return scene, condensed(scene, meshes, ONE_RANK) if small else meshes


def problem_of(scene: Scene, shapes: Mapping[str, BodyShape], n_modes: int = N_MODES) -> ModalProblem:
    kinematics = RigidKinematics(Mechanism.from_scene(scene, shapes))
    return modal_problem(kinematics, scene.nominal, n_modes)


def tables_of(small: bool, theta: float) -> dict[str, np.ndarray]:
    """Return reduced matrices at an angle, with their vectors' signs taken out, and static answers at the frames."""
    scene, shapes = scene_and_shapes(small)
    with problem_of(scene, shapes) as problem:
        mechanism, at = problem.mechanism, np.array([theta])
        effects = effects_of(scene, mechanism)
        loads = loads_of(effects, problem.matrices)
        static_loads = StaticLoads.of(problem, patterns_of(effects, problem.matrices), scene.reduction)
        sample = Sampler(problem, loads, static_loads).sample(at, lambda modes: modes)
        modes = problem.solve(at)
        answers = problem.static_answers(modes.eigenvectors[:, :1], TurnedLoads(problem, loads).at(at))
        assert [load.effect for load in loads] == ["motor", "weight"]
        (mass,), (stiffness,) = sample.mass, sample.stiffness
        signs = np.sign(np.concatenate([[1.0], sample.load[0, 1:]]))
        return {
            "eigenvalues": sample.eigenvalues, "mass": signs[:, None] * mass * signs,
            "stiffness": signs[1:, None] * stiffness * signs[1:], "inertia": sample.inertia.ravel() * signs[1:],
            "load": sample.load * signs, "answer to the motor": mechanism.by_node(answers)[..., 0],
            "answer to the weight": mechanism.by_node(answers)[..., 1],
        }  # fmt: skip


def test_tables_of_the_condensed_mechanism_are_those_of_the_meshes(theta: float = 0.7) -> None:
    """Modes and static answers to the motor, the weight and the inertia forces, and what they make of the loads."""
    found, expected = tables_of(True, theta), tables_of(False, theta)
    # the bodies' answers are condensed to 1e-10, static ones refined until they move by 1e-13 or round-off
    assert_alike(expected, found, 1e-8)
    # the rigid motion's part of the weight's load: the power of both bodies' weights per crank speed
    density, (crank, rod) = 7800.0 * 9.80665 * np.pi * 5.6e-3**2, (0.3, 0.7)
    turn = crank * np.cos(theta)
    power = -density * (crank * 0.5 * turn + rod * 0.5 * turn)
    for own in (found, expected):
        # answers to body forces are condensed to 1e-10 as well
        assert own["load"][1, 0] == pytest.approx(power, rel=1e-9)


# half of the crank is of another material, whose modulus is uncertain
TWO_MATERIALS = ('materials.alloy={E="E", nu=0.33, rho=2700.0}', 'bodies.crank.regions={half="alloy"}')


@pytest.mark.parametrize(
    "known", ['distribution={name="norm", loc=7e10, scale=5e9}', "bounds=[5.5e10, 8.5e10]"], ids=["law", "bounds"]
)
def test_frequencies_of_two_materials_at_other_values_of_a_parameter(known: str) -> None:
    modulus = f"parameters={{E={{nominal=7e10, {known}}}}}"
    scene = solid_slider_crank(modulus, *TWO_MATERIALS, f"reduction.modes={N_MODES}")
    meshes = solid_meshes("quad8", 20)
    crank = meshes["crank"]
    half = np.flatnonzero(crank.nodes[crank.cells].mean(axis=1)[:, 0] > 0.15)
    meshes["crank"] = replace(crank, regions={"half": half})
    found = []
    for shapes in (condensed(scene, meshes, ONE_RANK), meshes):
        kinematics = RigidKinematics(Mechanism.from_scene(scene, shapes))
        # the subspace was made at 5.5, 6.25, 7, 7.75 and 8.5e10 Pa
        for modulus in (5.9e10, 7e10, 8.2e10):
            with modal_problem(kinematics, {"E": modulus}, N_MODES) as problem:
                found.append(problem.solve(0.7).frequencies_hz)
    np.testing.assert_allclose(found[:3], found[3:], rtol=1e-8)
    # the parameter is felt
    assert np.abs(found[0] / found[1] - 1).max() > 1e-3


HINGED = HEADER + tables("""
bodies.arm: mesh = "none"; element = "solid2d"; material = "steel"; thickness = 0.01
joints.hinge: type = "revolute"; connect = ["ground:origin", "arm:left"]
coordinates.phi: joint = "hinge"; range = [0.0, 6.283185307179586]; periodic = true
effects.weight: type = "gravity"
simulation: duration = 0.1; step = 2e-3
""")


def test_a_bar_that_a_single_frame_holds() -> None:
    """Its first frequencies are those of a hinged beam, and it swings as one falls."""
    scene, mesh = scene_from_toml(HINGED, "."), rectangle_mesh("quad8", (20, 1), (1.0, 0.02))
    meshes = {"arm": replace(mesh, nodes=mesh.nodes - np.array([0.0, 0.01]))}
    found = []
    for shapes in (condensed(scene, meshes, ONE_RANK), meshes):
        with problem_of(scene, shapes, 2) as problem:
            found.append(problem.solve(0.3).frequencies_hz)
    np.testing.assert_allclose(found[0], found[1], rtol=1e-8)
    # tan b = tanh b, Euler and Bernoulli; shear and rotary inertia take 1e-3 of the second, the mesh adds some of it
    exact = np.array([3.92660231, 7.06858275]) ** 2 / (2 * np.pi) * np.sqrt(210e9 / 7800.0 * 0.02**2 / 12)
    np.testing.assert_allclose(found[1], exact, rtol=3e-3)
    run = motion("full", scene, meshes)
    # a rigid bar falls by 3 g / (4 L) t^2 (1 - 0.025 (3 g / (2 L) t^2)^2 ...); its bending adds 1e-3 rad at most
    fall = 0.75 * 9.80665 * 0.1**2
    assert run.coordinates[-1, 0] == pytest.approx(-fall, abs=2e-3)
    assert np.abs(run.balance.residual).max() < 1e-2 * run.balance.exchanged


def timed(duration: float, step: float, *overrides: str) -> Scene:
    return solid_slider_crank(f"simulation.duration={duration}", f"simulation.step={step}", *overrides)


def both(scene: Scene) -> list[Trajectory]:
    return [motion(kind, scene, solid_meshes("quad8", 20)) for kind in ("full", "reduced")]


def test_the_reduced_run_is_that_of_the_full_order_model() -> None:
    full, reduced = both(timed(0.2, 1e-3))
    # three modes and static answers; what is of second order in the deformation, a ten-thousandth here, is left out
    assert_close(full.outputs, reduced.outputs, crank_angle=1e-5, slider_position=1e-6, slider_deformation=1e-2)
    # the beams' published run (test_full_order), 5 elements a body: 1 % in deformation is their mesh
    assert full.outputs["crank_angle"][-1] == pytest.approx(0.115185039442, rel=1e-4)
    assert full.outputs["slider_deformation"][-1] == pytest.approx(1.14673349999e-05, rel=0.02)


def test_the_reduced_run_with_weight_and_damping_is_that_of_the_full_order_model() -> None:
    full, reduced = both(timed(0.1, 1e-3, GRAVITY, DAMPING, *MOVING))
    assert_close(full.outputs, reduced.outputs, crank_angle=1e-5, slider_deformation=1e-2)
    assert full.balance.work.keys() == reduced.balance.work.keys() == {"motor", "weight", "friction"}
    for name, done in full.balance.work.items():
        assert reduced.balance.work[name][-1] == pytest.approx(done[-1], rel=2e-3), name
    # all of them are felt
    assert full.balance.work["weight"][-1] < -0.2 < 10 * full.balance.work["friction"][-1] < -0.05


def test_the_energy_of_the_full_order_model_is_balanced_with_second_order() -> None:
    scenes = (timed(0.05, step, GRAVITY, DAMPING, *MOVING) for step in (1e-3, 5e-4))
    runs = [motion("full", scene, solid_meshes("quad8", 10)).balance for scene in scenes]
    wrong = shares_left(runs)
    # the trapezoidal rule of the works and the scheme's own damping; the highest modes are not resolved in either run
    assert_order(wrong, within=0.3)
    assert wrong[1] < 5e-5
    # what damping took is a thousand times as much as what is left
    assert -runs[1].work["friction"][-1] > 1e3 * wrong[1] * runs[1].exchanged


# the crank's cross-section is uncertain, height and thickness together
SCALED = (
    'parameters={s={nominal=1.0, distribution={name="norm", loc=1.0, scale=0.1}}}',
    'bodies.crank.section_scale="s"',
)


def test_frequencies_with_a_scaled_cross_section() -> None:
    """Of the condensed mechanism at any scale, of the meshes that have it, and of beams with the same section."""
    scene = solid_slider_crank(*SCALED, f"reduction.modes={N_MODES}")
    meshes = solid_meshes("quad8", 40)
    small = RigidKinematics(Mechanism.from_scene(scene, condensed(scene, meshes, ONE_RANK)))
    for scale in (0.75, 1.0, 1.22):
        with modal_problem(small, {"s": scale}, N_MODES) as problem:
            found = problem.solve(0.7).frequencies_hz
        other = solid_slider_crank(*SCALED, f"parameters.s.value={scale}")
        with problem_of(other, meshes) as problem:
            np.testing.assert_allclose(found, problem.solve(0.7).frequencies_hz, rtol=1e-8)
        beams = slider_crank('bodies.crank.mesh="0.0:0.3:40"', 'bodies.rod.mesh="0.3:1.0:40"')
        with modal_problem(kinematics_of(beams), {"r1": 5.6e-3 * scale}, 4) as problem:
            np.testing.assert_allclose(found[:4], problem.solve(0.7).frequencies_hz, rtol=1e-2)


@pytest.mark.parametrize("scale", [0.85, 1.2])
def test_the_reduced_run_with_a_scaled_cross_section_is_that_of_the_full_order_model(scale: float) -> None:
    """The basis is that of the nominal section; the full-order model takes the scale of the run or of the sample."""
    scene, meshes = timed(0.1, 1e-3, *SCALED), solid_meshes("quad8", 20)
    run_of = scene.model_copy(update={"parameters": {"s": scene.parameters["s"].model_copy(update={"value": scale})}})
    full = motion("full", run_of, meshes)
    reduced = motion(ReducedModel(run_of, rom_of(scene, meshes=meshes)))
    # a basis of the other section is 1.1e-4 and 1.2 % off, that of the nominal one for itself 3e-6 and 0.8 %
    assert_close(full.outputs, reduced.outputs, crank_angle=2e-4, slider_position=1e-6, slider_deformation=0.02)
    with full_model(scene, meshes).batch({"s": np.array([scale])}, 1) as sample:
        np.testing.assert_array_equal(sample.start().q, full_model(run_of, meshes).batch({}, 1).start().q)


SOLID = f'element="solid2d", material="steel", thickness={THICKNESS}'


def mixed_slider_crank(*overrides: str) -> tuple[Scene, dict[str, BodyShape]]:
    """Return a crank of beams and a rod of plane cells, which have the section of the beams' circle."""
    scene = slider_crank(
        f'bodies.rod={{mesh="none", {SOLID}}}', 'joints.elbow.connect=["crank:tip", "rod:left"]',
        'joints.slider.connect=["ground:origin", "rod:right"]',
        'outputs.x={type="position", point="rod:right", axis="x"}',
        'outputs.bent={type="deformation", point="rod:right", axis="x"}', *overrides,
    )  # fmt: skip
    return scene, {"crank": straight(0.0, 0.3, 20), "rod": solid_meshes("quad8", 40)["rod"]}


def frequencies(scene: Scene, shapes: Mapping[str, BodyShape], n: int) -> np.ndarray:
    kinematics = RigidKinematics(Mechanism.from_scene(scene, shapes))
    with modal_problem(kinematics, scene.nominal, n) as problem:
        return np.array([problem.solve(theta).frequencies_hz for theta in (0.0, 0.7, 2.5)])


def test_a_rod_of_cells_on_a_crank_of_beams_has_the_frequencies_of_beams() -> None:
    scene, meshes = mixed_slider_crank()
    small = frequencies(scene, condensed(scene, meshes, ONE_RANK), 4)
    np.testing.assert_allclose(small, frequencies(scene, meshes, 4), rtol=1e-8)
    beams = frequencies(slider_crank(), {"crank": straight(0.0, 0.3, 20), "rod": straight(0.3, 1.0, 40)}, 4)
    np.testing.assert_allclose(small, beams, rtol=1e-2)


ACCURATE = ("reduction.static_modes=true", "reduction.inertia_modes=true", 'reduction.interpolation="spline"')


@pytest.mark.parametrize("crank", ["flexible", "rigid"])
def test_a_reduced_run_is_that_of_the_full_order_model(crank: str) -> None:
    scene, meshes = mixed_slider_crank(
        f"bodies.crank.flexible={str(crank == 'flexible').lower()}", "reduction.angles=48", *ACCURATE,
        "simulation.duration=0.2", "simulation.step=1e-3",
    )  # fmt: skip
    full, reduced = (motion(kind, scene, meshes) for kind in ("full", "reduced"))
    # behind a rigid crank the slider hardly deforms: what is of second order in the rod's bending
    assert_close(full.outputs, reduced.outputs, x=1e-6, **({} if crank == "rigid" else {"bent": 0.02}))


PENDULUM = HEADER + tables(f"""
bodies.upper: mesh = "none"; element = "beam2d"; material = "steel";
    section = {{ shape = "rectangle", width = {THICKNESS}, height = {HEIGHT} }}
bodies.lower: mesh = "none"
{SOLID.replace(", ", chr(10))}
joints.shoulder: type = "revolute"; connect = ["ground:origin", "upper:hinge"]
joints.elbow: type = "revolute"; connect = ["upper:tip", "lower:left"]
coordinates.shoulder_angle: joint = "shoulder"; range = [-1.0, 1.0]
coordinates.elbow_angle: joint = "elbow"; range = [-1.0, 1.0]
effects.weight: type = "gravity"
reduction: modes = 3; angles = 9; static_modes = true; interpolation = "spline"
simulation: duration = 0.15; step = 1e-3
outputs.swing: type = "angle"; joint = "elbow"
outputs.y: type = "position"; point = "lower:right"; axis = "y"
outputs.bent: type = "deformation"; point = "lower:right"; axis = "y"
""")


def test_a_double_pendulum_of_a_beam_and_a_bar_of_cells() -> None:
    """Two coordinates, released at rest with both bars along the x axis."""
    lower = rectangle_mesh("quad8", (12, 1), (0.4, HEIGHT))
    shapes = {
        "upper": straight(0.0, 0.5, 10),
        "lower": replace(lower, nodes=lower.nodes - np.array([0.0, 0.5 * HEIGHT])),
    }
    full, reduced = (motion(kind, scene_from_toml(PENDULUM, "."), shapes) for kind in ("full", "reduced"))
    assert np.abs(full.outputs["swing"]).max() > 0.05
    # measured: 2e-5, 5e-6, 1.6 %
    assert_close(full.outputs, reduced.outputs, swing=1e-4, y=5e-5, bent=0.05)
