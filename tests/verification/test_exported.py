"""Models in C and FMUs give what the program's own equations give."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from conftest import TIMEOUT_SECONDS
from exported import COMPILER, OPTIONS, Unit, assert_equal, compiled, converged, needs_compiler, outputs_of, scene_of
from mpi4py import MPI
from runs import QUICK_RETURN, accurate_scene, reduced_model

from pgmp_petsc.code.constants import constants_of
from pgmp_petsc.code.fmu import OUTPUTS, STRENGTHS, write_fmu
from pgmp_petsc.code.source import write_sources
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduction.stencil import OVERHAUSER
from pgmp_petsc.scene import scene_from_toml
from pgmp_petsc.studies.simulate import simulate_reduced

pytestmark = needs_compiler
# an interpreter that has FMPy, which takes a newer numpy than this program
FMPY = os.environ.get("PGMP_FMPY_PYTHON", sys.executable)
SIMULATE = """
import sys, json
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu
path, step, starts = sys.argv[1], float(sys.argv[2]), json.loads(sys.argv[3])
problems = validate_fmu(path)
found = simulate_fmu(path, output_interval=step, start_values=starts)
print(json.dumps([problems, {name: found[name].tolist() for name in found.dtype.names}]))
"""
# a rigid crank on a rocker that bends: arms, limited ranges, mass-proportional damping, harmonics, a table with jumps
KINDS = (
    QUICK_RETURN.replace('element = "beam2d"', 'element = "beam2d"\nflexible = false', 1)
    .replace("range = [0.0, 6.283185307179586]\nperiodic = true", "range = [0.0, 2.0]\nperiodic = false")
    .replace("table = [[0.0, 0.0], [0.05, 2.0], [1.0, 2.0]]", "harmonic = { amplitude = 2.0, frequency_hz = 9.0 }")
    .replace("angles = 24", 'angles = 24\ninterpolation = "overhauser"\nsecond_order = true')
    .replace("duration = 0.2", "duration = 0.1")
    + """
[effects.internal]
type = "structural_damping"
stiffness = 1e-5
mass = 0.3
[effects.bearing]
type = "joint_damping"
joint = "rocker_hinge"
coefficient = 0.01
[effects.push]
type = "force"
point = "rocker:tip"
direction = [1.0, 0.5]
table = [[0.0, 0.0], [0.03, 4.0], [0.06, -4.0]]
[outputs.angle]
type = "angle"
joint = "rocker_hinge"
[outputs.sliding]
type = "sliding"
joint = "pin"
[outputs.distance]
type = "distance"
points = ["ground:pivot", "crank:tip"]
[outputs.rotation]
type = "rotation"
point = "rocker:tip"
[outputs.place]
type = "position"
point = "crank:tip"
axis = "y"
[outputs.moved]
type = "displacement"
point = "rocker:tip"
axis = "x"
[outputs.bent]
type = "deformation"
point = "rocker:tip"
axis = "y"
[outputs.bent_across]
type = "deformation"
point = "rocker:tip"
axis = "y"
frame = "body"
"""
)


@pytest.fixture(scope="module")
def slider_crank() -> ReducedModel:
    """Return a model with terms of second order."""
    return reduced_model(scene_of("slider_crank", "reduction.parameter_modes=0"))


@pytest.fixture(scope="module")
def slider_crank_program(slider_crank, tmp_path_factory) -> Path:
    return compiled(slider_crank, tmp_path_factory.mktemp("slider_crank"))


@pytest.fixture(scope="module")
def unit(slider_crank, tmp_path_factory) -> Path:
    """Return an FMU."""
    path = tmp_path_factory.mktemp("unit") / "slider_crank.fmu"
    assert write_fmu(constants_of(slider_crank, "it"), path) == "linux64"
    return path


@pytest.fixture
def loaded(unit, tmp_path) -> Unit:
    """Return the FMU's library with one instance."""
    with zipfile.ZipFile(unit) as archive:
        archive.extractall(tmp_path)
    guid = re.search(r'guid="(\w+)"', (tmp_path / "modelDescription.xml").read_text())[1]
    found = Unit(tmp_path / "binaries/linux64/slider_crank.so", guid)
    assert found.instantiate()
    return found


def test_second_order(slider_crank, slider_crank_program) -> None:
    assert_equal(outputs_of(slider_crank_program), converged(slider_crank))


def test_what_a_run_of_the_program_gives(slider_crank, slider_crank_program) -> None:
    """Where it is: its iterations stop at 1e-11 of the mechanism's size, which is 1e-7 of so small a deformation."""
    found, run = outputs_of(slider_crank_program), simulate_reduced(slider_crank, MPI.COMM_SELF)
    assert_equal(found, {name: run.outputs[name] for name in ("crank_angle", "slider_position")})
    assert_equal(found, run.outputs, 1e-6)


def test_other_parameters(slider_crank, slider_crank_program) -> None:
    found = outputs_of(slider_crank_program, "r1=6e-3")
    assert_equal(found, converged(slider_crank, r1=6e-3))
    nominal = outputs_of(slider_crank_program)["crank_angle"]
    assert np.max(np.abs(found["crank_angle"] - nominal)) > 1e-3 * np.max(np.abs(nominal))


def test_dampers_structural_damping_and_terms_of_second_order(tmp_path) -> None:
    model = reduced_model(scene_of("four_bar"))
    found, run = outputs_of(compiled(model, tmp_path)), simulate_reduced(model, MPI.COMM_SELF)
    assert_equal(found, converged(model))
    assert_equal(found, run.outputs)
    # the program looks at some states, of which this is one or more
    assert run.validity["elastic_rotation"] <= np.max(found["elastic_rotation"]) * (1 + 1e-6)


def test_a_limited_range_overhauser_gravity_and_every_kind_of_output(tmp_path) -> None:
    model = reduced_model(scene_from_toml(KINDS, "."))
    (axis,) = model.terms.terms.axes
    assert (axis.periodic, axis.basis) == (False, OVERHAUSER)
    program = compiled(model, tmp_path)
    assert_equal(outputs_of(program), converged(model))
    # narrower limits than the model's own: what crosses them is flagged from there on, and stays so
    sizes = (tmp_path / "sizes.h").read_text()
    for name, value in (("BRANCH_UPPER", "0.35"), ("ROTATION_LIMIT", "1e-9")):
        sizes, n = re.subn(rf"#define {name} \S+", f"#define {name} {value}", sizes)
        assert n == 1
    (tmp_path / "sizes.h").write_text(sizes)
    command = [COMPILER, *OPTIONS, "-o", "run", "main.c", "model.c", "tables.c", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=TIMEOUT_SECONDS)
    flags = outputs_of(program)["validity"].astype(int)
    assert (flags[0], flags[-1]) == (0, 1 + 2)
    assert (np.diff(flags) >= 0).all()


def test_several_turns(tmp_path) -> None:
    """Backwards and through more than one revolution: poses and tables are periodic, angles count turns."""
    start = "simulation.initial.theta.velocity=-100.0", "simulation.duration=0.2", "reduction.modes=2"
    model = reduced_model(accurate_scene(*start, "simulation.step=2.5e-4"))
    found = outputs_of(compiled(model, tmp_path))
    assert found["crank_angle"][-1] < -4 * np.pi
    assert_equal(found, converged(model))


def test_nothing_but_libm_and_no_allocation(slider_crank_program) -> None:
    folder = slider_crank_program.parent
    subprocess.run([COMPILER, *OPTIONS, "-c", "model.c", "tables.c"], cwd=folder, check=True, timeout=TIMEOUT_SECONDS)
    listed = subprocess.run(["nm", "-u", "model.o"], cwd=folder, capture_output=True, text=True).stdout.split()
    defined = subprocess.run(["nm", "--defined-only", "tables.o"], cwd=folder, capture_output=True, text=True).stdout
    wanted = {name for name in listed if name != "U"} - set(defined.split())
    compilers = {"_GLOBAL_OFFSET_TABLE_", "__stack_chk_fail"}
    assert wanted - compilers <= {"sin", "cos", "sincos", "sqrt", "floor", "hypot", "fabs", "memset"}


def test_flags(slider_crank_program) -> None:
    assert not outputs_of(slider_crank_program)["validity"].any()
    far = outputs_of(slider_crank_program, "r1=8.5e-3")
    assert (far["validity"].astype(int) & 16).all()


def test_a_run_that_breaks_down_ends_with_its_flags(slider_crank_program) -> None:
    """A crank of 1.1 mm cannot carry the torque: not converged, then no finite number."""
    done = subprocess.run([slider_crank_program, "r1=1.1e-3"], capture_output=True, text=True, timeout=TIMEOUT_SECONDS)
    assert done.returncode == 1
    assert int(done.stdout.splitlines()[-1].split(",")[-1]) == 4 + 8 + 16


def test_a_parameter_that_is_none(slider_crank_program) -> None:
    for text in ("r2=1", "r1=x", "r1"):
        done = subprocess.run([slider_crank_program, text], capture_output=True, text=True, timeout=TIMEOUT_SECONDS)
        assert (done.returncode, done.stderr) == (2, f"{text}: not NAME=VALUE of a parameter; parameters: r1\n")


def test_the_library_gives_the_same(loaded, slider_crank_program) -> None:
    loaded.begin()
    wanted, h = outputs_of(slider_crank_program)["crank_angle"], 5e-4
    found = [loaded.get("Real", OUTPUTS)]
    for number in range(0, 100, 4):
        assert loaded.step(number * h, 4 * h) == 0
        found.append(loaded.get("Real", OUTPUTS))
    np.testing.assert_array_equal(found, wanted[:101:4])
    assert (loaded.get("Integer", 0), loaded.get("Boolean", 0), loaded.said) == (0, 1, [])


def test_a_strength_from_outside(loaded) -> None:
    """A strength of zero holds what starts at rest; one that is not looked at is said."""
    assert loaded.set("Real", STRENGTHS, 1.0) == 1
    assert "effects.motor_follows_scene is true" in loaded.said[0]
    assert (loaded.set("Boolean", STRENGTHS, 0), loaded.set("Real", STRENGTHS, 0.0)) == (0, 0)
    loaded.begin()
    assert loaded.step(0.0, 0.01) == 0
    assert loaded.get("Real", OUTPUTS) == 0.0
    assert loaded.set("Real", STRENGTHS, 0.5) == 0
    assert loaded.step(0.01, 0.01) == 0
    assert loaded.get("Real", OUTPUTS) > 0.0
    assert loaded.call("Reset") == 0
    assert loaded.get("Boolean", STRENGTHS) == 1


def test_a_parameter_that_is_tuned_within_a_run(loaded) -> None:
    loaded.begin()
    assert loaded.step(0.0, 0.05) == 0
    before = loaded.get("Real", OUTPUTS)
    assert loaded.set("Real", 0, 8.5e-3) == 0
    assert loaded.get("Real", OUTPUTS) == before
    assert (loaded.get("Integer", 0), loaded.get("Boolean", 0)) == (16, 0)
    assert loaded.step(0.05, 0.05) == 0
    assert loaded.get("Real", OUTPUTS) > before


@pytest.mark.parametrize(
    ("act", "said"),
    [
        (lambda u: u.step(0.0, 7e-4), "must be a whole number of steps"),
        (lambda u: u.step(0.1, 5e-4), "but the model is at 0 s"),
        (lambda u: u.set("Real", 77, 1.0), "no Real with value reference 77 can be set"),
        (lambda u: u.set("Real", 0, float("nan")), "is no finite number"),
        (lambda u: u.set("Boolean", 0, 1), "no Boolean with value reference 0 can be set"),
        (lambda u: u.set("Integer", 0, 1), "no Integer can be set"),
        (lambda u: u.get("Real", 77) is None and 3, "there is no Real with value reference 77"),
        (lambda u: u.get("Integer", 77) is None and 3, "there is no Integer with value reference 77"),
        (lambda u: u.get("Boolean", 77) is None and 3, "there is no Boolean with value reference 77"),
        (lambda u: u.instantiate(guid="other") is None and 3, "the GUID is not"),
        (lambda u: u.instantiate(kind=0) is None and 3, "not for model exchange"),
        (lambda u: u.call("GetFMUstate", None), "states are not kept"),
    ],
)
def test_what_is_refused_is_said(loaded, act, said) -> None:
    loaded.begin()
    assert act(loaded) == 3
    assert said in loaded.said[-1]


def test_a_fifth_instance(loaded) -> None:
    more = [loaded.instantiate() for _ in range(4)]
    assert [one is None for one in more] == [False, False, False, True]
    assert "at most so many" in loaded.said[-1]
    loaded.free(more[0])
    assert loaded.instantiate() == more[0]


def test_an_importer_that_others_wrote(unit, slider_crank) -> None:
    if subprocess.run([FMPY, "-c", "import fmpy"], capture_output=True, timeout=TIMEOUT_SECONDS).returncode:
        pytest.skip(f"no FMPy in {FMPY}; name an interpreter that has it in PGMP_FMPY_PYTHON")
    for starts, given in (({}, {}), ({"parameters.r1": 6e-3}, {"r1": 6e-3})):
        command = [FMPY, "-c", SIMULATE, unit, "5e-4", json.dumps(starts)]
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_SECONDS, env=environment)
        assert done.returncode == 0, done.stderr
        problems, found = json.loads(done.stdout)
        assert problems == []
        wanted = converged(slider_crank, **given)
        assert_equal({name: np.array(found[f"outputs.{name}"]) for name in wanted}, wanted)


def test_it_runs_without_the_sources_of_this_program(slider_crank, tmp_path) -> None:
    """Nothing in the folder names a path, and nothing outside it is included."""
    write_sources(constants_of(slider_crank, "it"), tmp_path)
    included = {
        line.split()[1] for path in tmp_path.iterdir() for line in path.read_text().splitlines() if "#include" in line
    }
    own = {f'"{path.name}"' for path in tmp_path.iterdir()}
    assert included <= own | {f"<{name}.h>" for name in ("math", "string", "stdio", "stdlib")}
