"""Models in C give what `pgmp simulate` gives."""

import re
import subprocess
from pathlib import Path

import exported
import numpy as np
import pytest
from conftest import ROOT, TIMEOUT_SECONDS
from mpi4py import MPI
from runs import QUICK_RETURN, accurate_scene, built_rom, components_model, motion, reduced_model
from spatial_beams import slider_crank_of_beams
from two_coordinates import five_bar

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.c_export.constants import constants_of, left_out
from pgmp_petsc.c_export.fmu import OUTPUTS, VERSIONS, write_fmu
from pgmp_petsc.c_export.source import compiled_of, write_sources
from pgmp_petsc.c_export.tree import tree_constants_of
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.outputs.rainflow import counted_after
from pgmp_petsc.reduction.cell_products import OVERHAUSER
from pgmp_petsc.scene import load_scene, scene_from_toml
from pgmp_petsc.studies.inputs import read_scene
from scenes import tables

pytestmark = [exported.needs_compiler, pytest.mark.usefixtures("short_tables", "quickly_compiled")]
# a rigid crank on a rocker that bends: arms, limited ranges, mass-proportional damping, harmonics, a table with jumps,
# all laws but stops, and all outputs
KINDS = QUICK_RETURN.replace('element = "beam2d"', 'element = "beam2d"\nflexible = false', 1).replace(
    "range = [0.0, 6.283185307179586]\nperiodic = true", "range = [0.0, 2.0]\nperiodic = false"
).replace(
    "table = [[0.0, 0.0], [0.05, 2.0], [1.0, 2.0]]", "harmonic = { amplitude = 2.0, frequency_hz = 9.0 }"
).replace("angles = 24", 'angles = 24\ninterpolation = "overhauser"\nsecond_order = true').replace(
    "duration = 0.2", "duration = 0.1"
).replace("step = 1e-3", "step = 2.5e-4") + tables("""
parameters.limit: nominal = 0.5
parameters.slow: nominal = 0.2
effects.internal: type = "structural_damping"; stiffness = 1e-5; mass = 0.3
effects.rubbing: type = "joint_friction"; joint = "pin"; limit = "limit"; speed = "slow"
effects.spring: type = "spring_damper"; points = ["ground:pivot", "crank:tip"]; stiffness = 30.0; damping = 0.1;
    rest = 0.48
effects.jet: type = "force"; point = "rocker:tip"; direction = [0.0, 1.0]; follows = true; table = [[0.0, 0.5]]
effects.rope: type = "force"; point = "crank:1"; towards = "ground:pivot"; table = [[0.0, 0.7]]
effects.push: type = "force"; point = "rocker:tip"; direction = [1.0, 0.5];
    table = [[0.0, 0.0], [0.03, 4.0], [0.06, -4.0]]
outputs.angle: type = "angle"; joint = "rocker_hinge"
outputs.sliding: type = "sliding"; joint = "pin"
outputs.distance: type = "distance"; points = ["ground:pivot", "crank:tip"]
outputs.rotation: type = "rotation"; point = "rocker:tip"
outputs.place: type = "position"; point = "crank:tip"; axis = "y"
outputs.moved: type = "displacement"; point = "rocker:tip"; axis = "x"
outputs.bent: type = "deformation"; point = "rocker:tip"; axis = "y"
outputs.bent_across: type = "deformation"; point = "rocker:tip"; axis = "y"; frame = "body"
""")
IN_FIVE_BAR = (
    'effects.motor={type="torque",joint="left_hinge",table=[[0.0,0.3]]}',
    'effects.drag={type="joint_damping",joint="pin",coefficient=0.01}', "coordinates.theta1.range=[1.6,2.4]",
    "coordinates.theta1.periodic=false", "coordinates.theta2.range=[0.7,1.4]", "coordinates.theta2.periodic=false",
    "simulation={duration=0.1,step=1e-3,initial={theta1={position=2.0},theta2={position=1.0}}}",
    'outputs.x={type="position",point="first:tip",axis="x"}',
    'outputs.bent={type="deformation",point="first:tip",axis="y"}', 'outputs.pin={type="angle",joint="pin"}',
    'outputs.carried={type="joint_force",joint="pin",component="x"}',
    'outputs.hinge={type="joint_force",joint="left_hinge",component="magnitude"}',
)  # fmt: skip
IN_SPACE = (
    "reduction.second_order=true",
    'effects.jet={type="force",point="rod:2",direction=[0.0,1.0,0.5],follows=true,table=[[0.0,0.2]]}',
    'outputs.reach={type="distance",points=["ground:origin","rod:2"]}',
    'outputs.across={type="deformation",point="rod:2",axis="z",frame="body"}',
)  # fmt: skip
# an oscillating cylinder whose motor, spring and weight set in at once on light nodes
CYLINDER = tables("""
scene.name = "cylinder"
materials.steel = { E = 210e9, nu = 0.3, rho = 7800.0 }
ground.points.pivot = [0.3, 0.02]
bodies.crank: line = { length = 0.08, elements = 3 }; element = "beam2d"; material = "steel";
    section = { shape = "circle", radius = 0.008 }; placement = { origin = [0.0, 0.0], angle = 0.5 }
bodies.rod: line = { length = 0.4, elements = 8 }; element = "beam2d"; material = "steel";
    section = { shape = "circle", radius = 0.006 }; placement = { origin = [0.07, 0.038], angle = -0.1 }
joints: shaft = { type = "revolute", connect = ["ground:origin", "crank:hinge"] };
    pin = { type = "revolute", connect = ["crank:tip", "rod:hinge"] };
    guide = { type = "point_on_line", connect = ["rod:hinge", "ground:pivot"], direction = [1.0, 0.0] }
coordinates.theta: joint = "shaft"; range = [0.0, 6.283185307179586]; periodic = true
effects: motor = { type = "torque", joint = "shaft", table = [[0.0, TORQUE]] };
    brake = { type = "joint_damping", joint = "shaft", coefficient = 0.15 };
    spring = { type = "spring_damper", joint = "guide", stiffness = 400.0, damping = 2.0, rest = 0.3 };
    rubbing = { type = "joint_friction", joint = "guide", limit = 1.0, speed = 0.02 }; weight = { type = "gravity" }
reduction: modes = 6; static_modes = true; inertia_modes = true; angles = 48; interpolation = "spline"
simulation: duration = 0.1; step = STEP
outputs.crank: type = "angle"; joint = "shaft"
outputs.bent: type = "deformation"; point = "rod:tip"; axis = "y"; frame = "body"
""")


@pytest.fixture(scope="module")
def slider_crank() -> ReducedModel:
    """Return a model with terms of second order."""
    return reduced_model(exported.scene_of("slider_crank", "reduction.parameter_modes=0"))


@pytest.fixture(scope="module")
def slider_crank_program(slider_crank, tmp_path_factory) -> Path:
    """Return its program, beside the objects of its files."""
    folder = tmp_path_factory.mktemp("slider_crank")
    write_sources(constants_of(slider_crank, "it"), folder)
    exported.compile_in(folder, "-O2", "-c", *compiled_of("reduced"))
    return exported.compile_in(folder, "-o", "run", "main.c", *objects_of("reduced"), "-lm")


def objects_of(kind: str) -> list[str]:
    return [name.replace(".c", ".o") for name in compiled_of(kind)]


def test_terms_of_second_order_and_other_parameters(slider_crank, slider_crank_program) -> None:
    """Newton's iteration stops where the program's stops: it leaves 2e-7 of the deformation. A parameter of the program
    in C gives what ``--set`` gives."""
    nominal = exported.outputs_of(slider_crank_program)
    exported.assert_equal(nominal, motion(slider_crank).outputs)
    other = exported.scene_of("slider_crank", "reduction.parameter_modes=0", settings=("r1=6e-3",))
    found = exported.outputs_of(slider_crank_program, "r1=6e-3")
    exported.assert_equal(found, motion(exported.with_scene(slider_crank, other)).outputs)
    assert np.max(np.abs(found["crank_angle"] - nominal["crank_angle"])) > 1e-3 * np.max(np.abs(nominal["crank_angle"]))
    far = exported.outputs_of(slider_crank_program, "r1=8.5e-3")
    assert not nominal["validity"].any() and (far["validity"].astype(int) & 16).all()


def test_a_limited_range_overhauser_every_law_and_every_kind_of_output(tmp_path) -> None:
    model = reduced_model(scene_from_toml(KINDS, "."))
    (axis,) = model.terms.terms.axes
    assert (axis.periodic, axis.basis) == (False, OVERHAUSER)
    found = exported.assert_same_in_c(model, tmp_path)
    # friction that sticks, with which Newton's method jumps over zero in every other step
    sticking = exported.with_scene(model, model.scene.with_values({"limit": 30.0, "slow": 1e-4}))
    exported.assert_equal(exported.outputs_of(tmp_path / "run", "limit=30", "slow=1e-4"), motion(sticking).outputs)
    # one of its vectors, left of a spring's static answer, bends at 140 kHz: no mode follows that at once
    bent = motion("full", model.scene).outputs["bent"]
    assert np.abs(found["bent"] - bent).max() < 3e-3 * np.abs(bent).max()
    # a longer run leaves the range, and a narrow limit is crossed: that is flagged from there on, and stays so
    longer = exported.with_scene(model, scene_from_toml(KINDS.replace("duration = 0.1", "duration = 1.0"), "."))
    write_sources(constants_of(longer, "it"), tmp_path)
    _compiled_again(tmp_path, "reduced", "sizes.h", r"#define ROTATION_LIMIT \S+", "#define ROTATION_LIMIT 1e-9")
    flags = exported.outputs_of(tmp_path / "run", check=False)["validity"].astype(int)
    assert flags[0] == 0 and flags[-1] & (1 + 2) == 1 + 2 and (np.diff(flags) >= 0).all()


IN_JOINTS = {"joint_force": ("x", "z", "axial", "radial", "magnitude"), "joint_torque": ("x", "y", "magnitude")}


def forces_in(joint: str, **components: tuple[str, ...]) -> list[str]:
    """Return outputs of components, of forces on the second body and of moments on the first in its axes."""
    more = {"joint_force": "", "joint_torque": ', frame="body", of="first"'}
    return [
        f'outputs.{kind}_{joint}_{one}={{type="{kind}", joint="{joint}", component="{one}"{more[kind]}}}'
        for kind, names in components.items() for one in names
    ]  # fmt: skip


DRIVE = [f'outputs.{kind}={{type="{kind}", coordinate="theta"}}' for kind in ("drive_torque", "power")]
DAMPED = 'effects.damping={type="structural_damping", stiffness=1e-4, mass=0.3}'
#: What is compared as it is: ways in which forces in joints come about, tables in three directions with deformations
#: beside closed poses, and poses and tables that are periodic where angles count turns, backwards and through more than
#: one revolution. Elastic joints, clearance, couplings, controllers and carried friction are in their own files.
IN_C = {
    "several turns": lambda: accurate_scene("simulation.initial.theta.velocity=-100.0", "simulation.duration=0.2",
                                            "simulation.step=2.5e-4", "reduction.modes=2"),
    "space": lambda: slider_crank_of_beams("reduction.modes=4", "reduction.angles=24",
                                           'reduction.interpolation="spline"', "simulation.duration=0.12",
                                           "simulation.step=2.5e-4", "simulation.initial.theta.velocity=100.0", DAMPED,
                                           *IN_SPACE,
                                           'outputs.elbow={type="angle", joint="elbow"}',
                                           *forces_in("crank_hinge", **IN_JOINTS)),
    "given motion and friction": lambda: exported.scene_of("quick_return", "simulation.duration=0.1", *DRIVE,
                                                           *forces_in("rocker_hinge", joint_force=("x", "magnitude"))),
    "three coordinates": lambda: exported.scene_of("platform_3rrr", "reduction.angles=4", "reduction.modes=3",
                                                   "simulation.duration=0.05",
                                                   *forces_in("first_elbow", joint_force=("x",))),
}  # fmt: skip
#: Of angles, one of which is no coordinate.
TURNED = {"several turns": ("crank_angle", 4 * np.pi), "space": ("elbow", 1.5 * np.pi)}


@pytest.mark.parametrize("name", IN_C)
def test_it_runs_as_the_program(name, tmp_path) -> None:
    found = exported.assert_same_in_c(reduced_model(IN_C[name]()), tmp_path)
    if name in TURNED:
        output, angle = TURNED[name]
        assert found[output][-1] < -angle


def test_forces_that_are_left_out_are_said() -> None:
    force = 'outputs.f={type="joint_force", joint="knee"}'
    servo = exported.scene_of("servo_arm", force.replace("knee", "hinge"))
    assert "outputs.f (joint_force) left out: " in left_out(servo)
    assert left_out(exported.scene_of("four_bar", force)) == ""


STRESSED = (
    "simulation.duration=0.1", 'outputs.force={type="joint_force",joint="slider",component="y"}',
    *forces_in("crank_hinge", joint_force=("x", "y")),
    "parameters.k={nominal=5.0}", 'parameters.area={nominal=1e-4,unit="m2"}',
    'outputs.stress={type="formula",formula="force / area",unit="Pa"}',
    'outputs.damage={type="rainflow",of="stress",curve={exponent="k",reference=1e3,cycles=1e4}}',
    'outputs.life={type="rainflow",of="stress",curve={table=[[1e2,1e6],[1e3,1e4],[1e4,10]]},quantity="life",'
    'run_out=1e9,mean_stress="goodman",ultimate=1e7}',
)  # fmt: skip


@pytest.mark.parametrize("make", [reduced_model, components_model])
def test_damages_are_counted_as_the_program_counts(make, tmp_path) -> None:
    """Bit for bit of the history that the model in C has, whose exponents make of 1e-10 some more; with room for four
    turning points the smallest cycles count as closed, which is flagged and no less."""
    model = make(exported.scene_of("slider_crank", *STRESSED))
    found = exported.assert_same_in_c(model, tmp_path, 1e-8)
    history = {name: found["stress"] for name in ("damage", "life")}
    counts, values = model.outputs.counts, model.scene.values
    for name, counted in counted_after(counts, found["time"], history, values).items():
        np.testing.assert_array_equal(found[name], counted, err_msg=name)
    assert found["damage"][-1] > 0.0 and found["life"][-1] < 1e9 and not found["validity"].any()
    other = exported.outputs_of(tmp_path / "run", "k=4.0")
    counted = counted_after(counts, found["time"], history | {"damage": other["stress"]}, values | {"k": 4.0})
    np.testing.assert_array_equal(other["damage"], counted["damage"])
    if make is reduced_model:  # both count by the same code
        _compiled_again(tmp_path, "reduced", "sizes.h", r"#define N_WAITING \S+", "#define N_WAITING 4")
        short = exported.outputs_of(tmp_path / "run")
        assert short["validity"][-1] == 32 and 0.999 < short["damage"][-1] / found["damage"][-1] < 1.01


def test_damages_of_units(tmp_path) -> None:
    """They are counted of the stress that they have; an integrator of others, which tries states, has none."""
    model, n = reduced_model(exported.scene_of("slider_crank", *STRESSED)), 200
    write_fmu(constants_of(model, "it"), tmp_path / "m.fmu", VERSIONS[-1])
    unit = exported.Unit(tmp_path / "m.fmu", tmp_path / "there")
    assert unit.instantiate(exchange=True) is None and "damages, is for co-simulation alone" in unit.said[-1]
    assert unit.instantiate() and unit.begin() == 0
    places = {name: OUTPUTS + k for k, name in enumerate(model.outputs.functions)}
    stress = [unit.get("Real", places["stress"])]
    for k in range(n):
        assert unit.step(k * 5e-4, 5e-4) == 0
        stress.append(unit.get("Real", places["stress"]))
    history = dict.fromkeys(("damage", "life"), np.array(stress))
    counted = counted_after(model.outputs.counts, 5e-4 * np.arange(n + 1), history, model.scene.values)
    for name, values in counted.items():
        assert unit.get("Real", places[name]) == values[n] and np.ptp(values) > 0.0


def test_two_coordinates_of_a_closed_loop(tmp_path) -> None:
    """Poses of outputs are closed by Newton's method; the program's polynomials add the round-off of their sums."""
    scene = five_bar(*IN_FIVE_BAR, "reduction.angles=5", "reduction.modes=2")
    model = ReducedModel(scene, built_rom(scene))
    found, wanted = exported.outputs_of(exported.compiled(model, tmp_path)), motion(model).outputs
    bent = wanted.pop("bent")
    exported.assert_equal(found, wanted)
    # so small a deformation is the difference of places known to round-off
    least = 64 * np.finfo(float).eps * model.kinematics.size
    np.testing.assert_allclose(found["bent"], bent, rtol=0.0, atol=max(least, 1e-9 * np.max(np.abs(bent))))


def test_nothing_but_libm_and_no_allocation(slider_crank_program) -> None:
    def listed(option: str) -> set[str]:
        command = ["nm", option, *objects_of("reduced")]
        found = subprocess.run(command, cwd=slider_crank_program.parent, capture_output=True, text=True).stdout
        return {line.split()[-1] for line in found.splitlines() if line.strip() and not line.endswith(":")}

    wanted, compilers = listed("-u") - listed("--defined-only"), {"_GLOBAL_OFFSET_TABLE_", "__stack_chk_fail"}
    libm = {"sin", "pow", "cos", "sincos", "sqrt", "floor", "fabs", "tanh", "atan2", "fmax", "fmin"}
    assert wanted - compilers <= libm | {"memset", "memcpy"}


@pytest.mark.parametrize(("step", "torque", "n_attempts"), [(5e-4, 2.0, 2), (5e-3, 20.0, 3)])
def test_loads_that_set_in_at_once(tmp_path, step, torque, n_attempts) -> None:
    """Steps that fail are tried as the program tries them; with an attempt less a step fails, and is not taken."""
    model = reduced_model(scene_from_toml(CYLINDER.replace("STEP", str(step)).replace("TORQUE", str(torque)), "."))
    exported.assert_same_in_c(model, tmp_path)
    _compiled_again(tmp_path, "reduced", "steps.c", "attempt < N_ATTEMPTS", f"attempt < {n_attempts - 1}")
    _assert_stopped(tmp_path / "run")


def test_a_step_that_fails_behind_an_edge_leaves_its_correction(tmp_path) -> None:
    stop = 'effects.stop={type="end_stop",joint="crank_hinge",stiffness=100.0,upper=0.02}'
    exported.compiled(reduced_model(exported.scene_of("slider_crank", stop)), tmp_path)
    main = tmp_path / "main.c"
    main.write_text(main.read_text().replace("model.elastic_rotation, model", "model.correction, model"))
    _compiled_again(
        tmp_path, "reduced", "steps.c", r"!try_step\(m, rest, end", "m->number > 1 || !try_step(m, rest, end"
    )
    _assert_stopped(tmp_path / "run")


def _compiled_again(folder: Path, kind: str, file: str, old: str, new: str) -> None:
    """Compile code of a folder in which a file is changed at one place."""
    text, n = re.subn(old, new, (folder / file).read_text())
    assert n == 1
    (folder / file).write_text(text)
    exported.as_one(folder, kind)


def _assert_stopped(program: Path, *settings: str) -> None:
    """Check that a run ends with a step that is not taken: the last row repeats the state before it, with a flag."""
    done = subprocess.run([program, *settings], capture_output=True, text=True, timeout=TIMEOUT_SECONDS)
    rows = [line.split(",") for line in done.stdout.splitlines()[1:]]
    assert done.returncode == 1 and rows[-1][:-1] == rows[-2][:-1] and int(rows[-1][-1]) == int(rows[-2][-1]) + 4
    assert np.isfinite(np.array(rows, dtype=float)).all()
    for said in ("the iteration of the next step", "export again with a smaller simulation.step"):
        assert said in done.stderr


def test_a_run_that_breaks_down_ends_before_it(slider_crank_program) -> None:
    """A crank of 0.8 mm cannot carry the torque."""
    _assert_stopped(slider_crank_program, "r1=0.8e-3")


def test_a_start_that_is_no_finite_number_and_parameters_that_are_none(slider_crank_program) -> None:
    none = "{}: not NAME=VALUE of a parameter; parameters: r1\n"
    wanted = {"r1=nan": (1, "stopped at 0 s: a state is no finite number\n")}
    wanted |= {text: (2, none.format(text)) for text in ("r2=1", "r1=x", "r1")}
    for text, (status, said) in wanted.items():
        done = subprocess.run([slider_crank_program, text], capture_output=True, text=True, timeout=TIMEOUT_SECONDS)
        assert (done.returncode, done.stderr) == (status, said)
        assert text != "r1=nan" or [int(row.split(",")[-1]) for row in done.stdout.splitlines()[1:]] == [8 + 16]


def test_it_runs_without_the_sources_of_this_program(slider_crank, tmp_path) -> None:
    """Nothing in the folder names a path, and nothing outside it is included."""
    write_sources(constants_of(slider_crank, "it"), tmp_path)
    included = {
        line.split()[1] for path in tmp_path.iterdir() for line in path.read_text().splitlines() if "#include" in line
    }
    own = {f'"{path.name}"' for path in tmp_path.iterdir()}
    assert included <= own | {f"<{name}.h>" for name in ("math", "stdbool", "stdio", "stdlib", "string")}


TREES = {
    "six_joint_arm": (
        "simulation.duration=0.15", 'outputs.power={type="power", coordinate="elbow"}',
        *forces_in("shoulder", joint_force=("axial", "radial"), joint_torque=("y", "magnitude")),
    ),
    "scara": ("simulation.duration=0.1",),
    "payload_arm": (
        "simulation.duration=0.08", *forces_in("shoulder_gearbox", joint_torque=("y",)),
        *forces_in("wrist_roll", joint_force=("magnitude",), joint_torque=("z",)),
    ),
    "palletizer": (
        "simulation.duration=0.05", 'outputs.torque={type="drive_torque", coordinate="drive"}',
        *forces_in("cross", joint_force=("x",)), *forces_in("elbow", joint_force=("y",)),
    ),
    "delta_robot": ("simulation.duration=0.02", "simulation.spectral_radius=1.0"),  # steps end with a projection
    "servo_arm": ("simulation.duration=0.1", 'outputs.held={type="control_force", controller="servo"}'),
    "crank_press": ("simulation.duration=0.1",),
    "worn_slider_crank": ("simulation.duration=0.02",),
    "slider_crank_solid2d": ("simulation.duration=0.05",),
}  # fmt: skip
OTHERS = {"crank_press": {"strength": 1.2}, "six_joint_arm": {"radius": 0.015}}


@pytest.mark.parametrize("name", TREES)
def test_component_models(name, tmp_path) -> None:
    """Along chains of joints and in loops, with what joints of the tree and others carry.

    A deformation is the difference of places, of round-off 2e-15 of the mechanism's size, of three coordinates 2e-13,
    as the program closes loops of which it has no table. The force in a joint that gives way is its stiffness times
    such a difference.
    """
    path = ROOT / "scenes" / f"{name}.toml"
    model = components_model(*read_scene(path, TREES[name], (), MPI.COMM_SELF, Purpose.COMPONENTS))
    faster = ("-O1",) if name in ("six_joint_arm", "payload_arm") else ()  # of 5 to 10 s without
    program = exported.compiled(model, tmp_path, *faster)
    closing = (2e-15 if len(model.kinematics.coordinates) < 3 else 2e-13) * model.kinematics.size
    for values in ({}, OTHERS.get(name)):  # of the scene, and others that the program takes
        if values is not None:
            found = exported.outputs_of(program, *(f"{key}={value}" for key, value in values.items()))
            wanted = motion(model.in_scene(model.scene.with_values(values))).outputs
            for output in (output for output in wanted if output in found):  # but for forces in sections
                # of crank_press the parameter is the stiffness of a joint, N/m
                stiffness = model.scene.nominal.get("frame", 0.0) if model.outputs.units[output] == "N" else 1.0
                off = np.max(np.abs(found[output] - wanted[output])) - closing * stiffness
                assert off <= 1e-9 * np.max(np.abs(wanted[output])), (output, off)


def test_a_projection_beside_controllers_is_refused() -> None:
    servo = 'controllers.servo={type="pid", measures="crank_angle", reference=0.1, gains={p=1.0}, joint="crank_hinge"}'
    scene = load_scene(ROOT / "scenes/slider_crank.toml", (servo, "simulation.spectral_radius=1.0"), ())
    with pytest.raises(InputError, match=r"spectral_radius = 1: .* beside controllers, .* Take at most 0\.99"):
        tree_constants_of(components_model(scene), "it")
