"""Derivatives of runs against central differences: bodies, coordinates, effects and starts of every kind."""

from dataclasses import replace

import numpy as np
import pytest
from combinations import meshes_for, scene_of
from differences import compare
from mpi4py import MPI
from runs import reduced_model
from solid_scenes import solid_meshes, solid_slider_crank
from two_coordinates import double_pendulum, five_bar

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.gradients.differentiated import ObservedChanges, differentiate
from pgmp_petsc.mechanism.closure import LoopClosure
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.scene import scene_from_toml, scene_to_toml
from pgmp_petsc.stepping.second_order_system import State
from scenes import PENDULUM, slider_crank

MODES = (
    "reduction.modes=3", "reduction.static_modes=true", "reduction.inertia_modes=true", "reduction.angles=32",
    'reduction.interpolation="spline"',
)  # fmt: skip
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
    "beams": slider_crank(*MODES, *OUTPUTS, *MOVING, *WEIGHT),
    "beams of second order": slider_crank(*MODES, "reduction.second_order=true", *OUTPUTS, *MOVING, DAMPING),
    "spring and damper": slider_crank(*MODES, *OUTPUTS, *MOVING, *SPRING),
    "friction and damping of a joint": slider_crank(*MODES, *OUTPUTS, *MOVING, *ELBOW),
    "bushing that pulls at the start": slider_crank(*MODES, *OUTPUTS, *MOVING, *BUSHING),
    "following force": slider_crank(*MODES, *OUTPUTS, *MOVING, *PUSH),
    "driven": slider_crank(*MODES, *OUTPUTS, *DRIVE),
    "driven, of second order": slider_crank(*MODES, "reduction.second_order=true", *OUTPUTS, *DRIVE),
    "shaken": slider_crank(
        *MODES, *OUTPUTS, *MOVING, "parameters.a={nominal=0.5}", "parameters.b={nominal=2.0}",
        'effects.base={type="base_motion",direction=[3.0,4.0],of="displacement",harmonic={amplitude="a",mean="b",frequency_hz=4.0}}',
        'outputs.place={type="position",point="rod:tip",axis="x",absolute=true}',
        'outputs.moved={type="displacement",point="rod:tip",axis="x",absolute=true}',
        'outputs.v={type="speed",point="rod:1",axis="y",absolute=true}', 'outputs.turning={type="speed",joint="elbow"}',
    ),
    "overhauser": slider_crank(*MODES, 'reduction.interpolation="overhauser"', *OUTPUTS, *MOVING),
    "two coordinates": double_pendulum(
        *RUN, "reduction.second_order=true", *WEIGHT, 'parameters.r={nominal=5e-3}', 'bodies.upper.section.radius="r"',
        "simulation.initial={theta1={position=0.4,velocity=2.0},theta2={position=-0.3,velocity=-1.0}}",
        'outputs.elbow={type="angle",joint="elbow"}', 'outputs.x={type="position",point="lower:tip",axis="x"}',),
    "a loop with two coordinates": five_bar(
        *RUN, "reduction.second_order=true", *WEIGHT, 'parameters.r={nominal=4e-3}', 'bodies.first.section.radius="r"',
        'coordinates.theta1={joint="left_hinge",range=[1.6,2.6]}',
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
    for output, values in model.outputs.evaluate(model.observed_of(0.0, states, model.scene.values)).items():
        np.testing.assert_array_equal(found[output], values)


def test_derivatives_of_solids_are_central_differences() -> None:
    scene = solid_slider_crank(
        "parameters={E={nominal=210e9}, t={nominal=10e-3}}", 'materials.steel.E="E"', 'bodies.crank.thickness="t"',
        "reduction.modes=3", "reduction.angles=16", *MOVING,
    )  # fmt: skip
    with RankGroup.split(MPI.COMM_SELF, 1) as group:
        compare(ReducedModel(scene, build_rom(scene, solid_meshes(n_per_metre=20), group)))


def test_derivatives_in_space_and_of_stresses_are_central_differences() -> None:
    """Beams in space, whose rotations are no sums; stresses depend on the radius by themselves too. Poses are those of
    a table, and found numerically."""
    drawn = scene_of("beams in space", "stress")
    start = ("simulation.initial.theta={position=0.1,velocity=5.0}", 'reduction.interpolation="spline"')
    scene = scene_from_toml(scene_to_toml(drawn), ".", (*start, *RUN))
    with RankGroup.split(MPI.COMM_SELF, 1) as group:
        rom = build_rom(scene, meshes_for(scene), group)
    assert rom.branch.is_exact
    for found in (rom, replace(rom, branch=replace(rom.branch, is_exact=False))):
        model = ReducedModel(scene, found)
        assert model.stresses is not None
        compare(model)


BAR = (
    PENDULUM.replace("radius = 2e-4", 'radius = "r"').replace("modes = 2", "modes = 3").replace(
        "angles = 6", 'angles = 16\nstatic_modes = true\ninterpolation = "spline"'
    )
    + '[parameters.r]\nnominal = 5e-3\n[parameters.g]\nnominal = 9.81\n[parameters.k]\nnominal = 40.0\n'
    + '[effects.weight]\ntype = "gravity"\nacceleration = "g"\n'
    + '[effects.spring]\ntype = "spring_damper"\njoint = "hinge"\nstiffness = "k"\ndamping = 0.1\nrest = 0.3\n'
    + '[outputs.tip]\ntype = "position"\npoint = "arm:tip"\naxis = "y"\n'
    + '[outputs.hinge]\ntype = "angle"\njoint = "hinge"\n'
)  # fmt: skip


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
    model = reduced_model(slider_crank(*MODES, *MOVING))
    with pytest.raises(InputError, match="outputs: none is given, so there is nothing to differentiate"):
        differentiate(model, model.scene.values, ["r1"])


def test_a_run_that_fails_is_an_error_with_its_reason() -> None:
    far = (
        'coordinates.theta={joint="crank_hinge",range=[0.0,1.5]}',
        "simulation.initial.theta={position=1.4,velocity=9.0}",
    )
    model = reduced_model(slider_crank(*MODES, *OUTPUTS, *RUN, *far))
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
