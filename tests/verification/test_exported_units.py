"""FMUs of versions 2 and 3, for co-simulation and model exchange, give what the program gives."""

import json
import os
import shutil
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import ROOT, TIMEOUT_SECONDS
from exported import COMPILER, FMPY, Unit, assert_equal, needs_compiler, scene_of, with_scene
from runs import components_model, motion, reduced_model
from scipy.integrate import solve_ivp

from pgmp_petsc.c_export.constants import constants_of
from pgmp_petsc.c_export.fmu import (
    CORRECTION,
    FOLLOWS,
    OUTPUTS,
    STRENGTHS,
    TIME,
    VALID,
    VALIDITY,
    VERSIONS,
    _define_units,
    write_fmu,
)
from pgmp_petsc.c_export.tree import tree_constants_of
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.scene import load_scene
from pgmp_petsc.stepping.second_order_system import State

pytestmark = [needs_compiler, pytest.mark.usefixtures("quickly_compiled")]
SIMULATE = """
import sys, json
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu
path, step, starts, *kinds = sys.argv[1], float(sys.argv[2]), json.loads(sys.argv[3]), *sys.argv[4:]
assert validate_fmu(path) == [], validate_fmu(path)
for kind in kinds:
    more = dict(solver="CVode", relative_tolerance=1e-10) if kind == "ModelExchange" else {}
    found = simulate_fmu(path, fmi_type=kind, output_interval=step, start_values=starts, **more)
    print(json.dumps({name: found[name].tolist() for name in found.dtype.names}))
"""
STEP = 5e-4
THREADS = Path(__file__).with_name("instances_in_threads.c")
OF_THE_FILE = "reduction.parameter_modes=0", "reduction.modes=3"


@pytest.fixture(scope="module")
def slider_crank() -> ReducedModel:
    """Return a model with terms of second order, and the force in a pin among its outputs."""
    pin = 'outputs.pin={type="joint_force", joint="elbow", component="y"}'
    return reduced_model(scene_of("slider_crank", *OF_THE_FILE, pin))


@pytest.fixture(scope="module")
def fmus(slider_crank, tmp_path_factory) -> dict[int, Path]:
    """Return FMUs of both versions, all names of which have hyphens."""
    folder, found = tmp_path_factory.mktemp("fmus"), constants_of(slider_crank, "it")
    renamed = {
        key: {f"{name}-1": value for name, value in getattr(found, key).items()}
        for key in ("parameters", "served", "output_units", "strength_units", "parameter_units")
    }
    hyphened = replace(found, name="slider-crank", coordinate_units={"theta-1": "rad"}, **renamed)
    named = {version: write_fmu(hyphened, folder / f"{version}.fmu", version) for version in VERSIONS}
    assert named == {2: "linux64", 3: "x86_64-linux"}
    return {version: folder / f"{version}.fmu" for version in VERSIONS}


@pytest.fixture(params=VERSIONS)
def fresh(request, fmus, tmp_path) -> Unit:
    """Return the library of an FMU, without an instance."""
    return Unit(fmus[request.param], tmp_path)


@pytest.fixture
def loaded(fresh) -> Unit:
    """Return the library with one instance for co-simulation."""
    assert fresh.instantiate()
    return fresh


@pytest.fixture
def exchanged(fresh) -> Unit:
    """Return the library with one instance for model exchange, at the start of its run."""
    assert fresh.instantiate(exchange=True)
    assert fresh.begin() == 0
    return fresh


def test_co_simulation(loaded, slider_crank) -> None:
    assert loaded.begin() == 0
    wanted, names = motion(slider_crank).outputs, list(slider_crank.scene.outputs)
    found = [[loaded.get("Real", OUTPUTS + k) for k in range(len(names))]]
    for number in range(0, 100, 4):
        assert loaded.step(number * STEP, 4 * STEP) == 0
        found.append([loaded.get("Real", OUTPUTS + k) for k in range(len(names))])
    own = {name: values for name, values in zip(names, np.transpose(found)) if name in ("crank_angle", "pin")}
    assert_equal(own, {name: wanted[name][:101:4] for name in own})
    assert loaded.get("Real", TIME) == pytest.approx(100 * STEP, rel=1e-14)
    assert (loaded.get("Whole", VALIDITY), loaded.get("Boolean", VALID), loaded.said) == (0, 1, [])


def test_accelerations_leave_no_residual_of_the_program(exchanged, slider_crank) -> None:
    """At any state and time; the program's residual is of another implementation."""
    rng, system = np.random.default_rng(3), slider_crank.batch({"r1": np.full(1, 5.6e-3)}, 1)
    assert exchanged.set("Real", 0, 5.6e-3) == 0
    n = system.n_eta
    for time in (0.0, 0.04, 0.3):
        q = np.concatenate([rng.uniform(-7.0, 7.0, 1), 1e-4 * rng.standard_normal(n - 1)])
        v = np.concatenate([rng.uniform(-9.0, 9.0, 1), 1e-2 * rng.standard_normal(n - 1)])
        exchanged.derivatives(time, np.concatenate([q, v]))
        exchanged.event()
        found = exchanged.derivatives(time, np.concatenate([q, v]))
        np.testing.assert_array_equal(found[:n], v)
        at = [np.array([part]) for part in (q, v, found[n:])]
        left = system.residual(time, State(*at, np.zeros(0)))
        without = system.residual(time, State(*at[:2], 0.0 * at[2], np.zeros(0)))
        np.testing.assert_allclose(left, 0.0, atol=1e-11 * np.max(np.abs(without)))


def test_model_exchange(exchanged, slider_crank) -> None:
    """An integrator of others comes to where the program comes, whose own error goes with the square of its step."""
    duration, n = 0.02, len(slider_crank.terms.scale)
    assert exchanged.event() == slider_crank.effects[0].strength.pieces[2].begin
    done = solve_ivp(
        exchanged.derivatives, (0.0, duration), exchanged.states(2 * n), "Radau", rtol=1e-9, atol=1e-12, max_step=1e-3
    )
    exchanged.derivatives(duration, done.y[:, -1])
    exchanged.end_step()
    found, errors = exchanged.get("Real", OUTPUTS), []
    for step in (1e-4, 5e-5):
        over = f"simulation.duration={duration}", f"simulation.step={step}"
        scene = scene_of("slider_crank", *OF_THE_FILE, *over)
        errors.append(abs(motion(with_scene(slider_crank, scene)).outputs["crank_angle"][-1] - found))
    assert done.success
    assert errors[1] < min(0.3 * errors[0], 1e-5 * found)


def test_states_that_were_only_tried_leave_no_flags(exchanged, slider_crank) -> None:
    n = len(slider_crank.terms.scale)
    start = exchanged.states(2 * n)
    bent = start.copy()
    bent[1:n] = 10.0
    exchanged.derivatives(0.0, bent)
    assert exchanged.get("Whole", VALIDITY) & 1
    exchanged.derivatives(0.0, start)
    assert exchanged.get("Whole", VALIDITY) == 0
    exchanged.derivatives(0.0, bent)
    exchanged.end_step()
    exchanged.derivatives(0.0, start)
    assert exchanged.get("Whole", VALIDITY) & 1


def test_a_jump_is_an_event(exchanged, slider_crank) -> None:
    """A piece of a strength over time holds until the event, however far the integrator looks ahead."""
    n, pieces = len(slider_crank.terms.scale), slider_crank.effects[0].strength.pieces
    jump, end = pieces[2].begin, pieces[-1].begin
    assert exchanged.event() == jump
    start = exchanged.states(2 * n)
    beyond = exchanged.derivatives(jump + 0.1, start)
    assert exchanged.event() == (None if end <= jump + 0.1 else end)
    assert not np.array_equal(beyond, exchanged.derivatives(jump + 0.1, start))


def test_a_strength_from_outside(loaded) -> None:
    """A strength of zero holds what starts at rest; one that is not looked at is said."""
    assert loaded.set("Real", STRENGTHS, 1.0) == 1
    assert "effects.motor-1_follows_scene is true" in loaded.said[0]
    assert (loaded.set("Boolean", FOLLOWS, 0), loaded.set("Real", STRENGTHS, 0.0)) == (0, 0)
    assert loaded.begin() == 0
    assert loaded.step(0.0, 0.01) == 0
    assert loaded.get("Real", OUTPUTS) == 0.0
    assert loaded.set("Real", STRENGTHS, 0.5) == 0
    assert loaded.step(0.01, 0.01) == 0
    assert loaded.get("Real", OUTPUTS) > 0.0
    assert loaded.call("Reset") == 0
    assert loaded.get("Boolean", FOLLOWS) == 1


def test_a_step_that_fails_is_not_taken(loaded) -> None:
    """It is an error, with the model where it was; from there another strength takes it on."""
    assert loaded.set("Boolean", FOLLOWS, 0) == 0
    assert loaded.set("Real", STRENGTHS, 0.5) == 0
    assert loaded.begin() == 0
    assert loaded.step(0.0, 4 * STEP) == 0
    before = [loaded.get("Real", reference) for reference in (TIME, OUTPUTS, CORRECTION)]
    assert loaded.set("Real", STRENGTHS, 1e6) == 0
    assert loaded.step(4 * STEP, 4 * STEP) == 3
    assert "the iteration of the step of 0.0005 s from 0.002 s failed, and the model stays there" in loaded.said[-1]
    assert (loaded.get("Whole", VALIDITY), loaded.get("Boolean", VALID)) == (4, 0)
    assert [loaded.get("Real", reference) for reference in (TIME, OUTPUTS, CORRECTION)] == before
    assert loaded.version == 2 or loaded.reached.value == 4 * STEP
    assert loaded.set("Real", STRENGTHS, 0.5) == 0
    assert loaded.step(4 * STEP, 4 * STEP) == 0
    assert (loaded.get("Whole", VALIDITY), loaded.get("Real", TIME)) == (0, 8 * STEP)


def test_a_strength_from_outside_in_model_exchange(exchanged, slider_crank) -> None:
    n = len(slider_crank.terms.scale)
    assert exchanged.set("Boolean", FOLLOWS, 0) == 0
    start = exchanged.states(2 * n)
    np.testing.assert_allclose(exchanged.derivatives(0.0, start), 0.0, atol=1e-12)
    assert exchanged.set("Real", STRENGTHS, 1.0) == 0
    assert exchanged.derivatives(0.0, start)[n] > 0.0
    assert exchanged.event() is None


def test_a_parameter_that_is_tuned_within_a_run(loaded) -> None:
    assert loaded.begin() == 0
    assert loaded.step(0.0, 0.05) == 0
    before = loaded.get("Real", OUTPUTS)
    assert loaded.set("Real", 0, 8.5e-3) == 0
    assert loaded.get("Real", OUTPUTS) == before
    assert (loaded.get("Whole", VALIDITY), loaded.get("Boolean", VALID)) == (16, 0)
    assert loaded.step(0.05, 0.05) == 0
    assert loaded.get("Real", OUTPUTS) > before


@pytest.mark.parametrize(("act", "said"), [
    (lambda u: u.step(0.0, 7e-4), "must be a whole number of steps"),
    (lambda u: u.step(0.1, 5e-4), "but the model is at 0 s"),
    (lambda u: u.set("Real", 77, 1.0), "no real number with value reference 77 can be set"),
    (lambda u: u.set("Real", 0, float("nan")), "is no finite number"),
    (lambda u: u.set("Boolean", 0, 1), "no Boolean with value reference 0 can be set"),
    (lambda u: u.set("Whole", 0, 1), "can be set"),
    (lambda u: u.get("Real", 77) is None and 3, "there is no real number with value reference 77"),
    (lambda u: u.get("Whole", 77) is None and 3, "there is no whole number with value reference 77"),
    (lambda u: u.get("Boolean", 77) is None and 3, "there is no Boolean with value reference 77"),
    (lambda u: u.instantiate(token="other") is None and 3, "modelDescription.xml is of another model"),
    (lambda u: u.call("GetFMUstate" if u.version == 2 else "GetFMUState", None), "states are not kept"),
    (lambda u: u.begin(1.0), "the start time is 1 s"),
    (lambda u: u.call("GetContinuousStates", None, 3), "3 states; this model has"),
    (lambda u: u.call("GetEventIndicators", None, 1), "there are no event indicators"),
    (lambda u: u.call("GetString", None, 1, None, 1), "there are no"),
])  # fmt: skip
def test_what_is_refused_is_said(loaded, act, said) -> None:
    assert loaded.begin() == 0
    assert act(loaded) == 3
    assert said in loaded.said[-1]


def test_every_instance_has_memory_of_its_own(loaded) -> None:
    more = [loaded.instantiate() for _ in range(8)]
    assert None not in more and len(set(more)) == 8
    for one in more:
        loaded.free(one)
    loaded.free(None)


@pytest.mark.parametrize(("version", "sanitizer"), zip(VERSIONS, ["thread", "address,undefined"]))
def test_instances_in_threads(fmus, tmp_path, version, sanitizer) -> None:
    """Instances that threads make, run and free at once give what one gives alone, and write nothing they share."""
    with zipfile.ZipFile(fmus[version]) as archive:
        archive.extractall(tmp_path)
    sources = sorted((tmp_path / "sources").glob("*.c"))
    options = [f"-fsanitize={sanitizer}", "-fno-sanitize-recover=all", "-O0", f"-DVERSION={version}", "-pthread"]
    command = [COMPILER, *options, "-I", tmp_path / "sources", THREADS, *sources, "-lm", "-o", tmp_path / "run"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_SECONDS)
    if "cannot find" in done.stderr:
        pytest.skip(f"no library for -fsanitize={sanitizer}")
    assert done.returncode == 0, done.stderr
    # its memory has to be where it expects it
    fixed = ["setarch", "-R"] if shutil.which("setarch") else []
    done = subprocess.run([*fixed, tmp_path / "run"], capture_output=True, text=True, timeout=TIMEOUT_SECONDS)
    assert (done.returncode, done.stdout, done.stderr) == (0, "the same\n", "")


def described(unit: Path) -> dict[str, dict[str, str]]:
    """Return unit, range and start of the variables of an FMU by name."""
    with zipfile.ZipFile(unit) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    found = root.find("ModelVariables")
    entries = {entry.get("name"): entry.attrib | (entry[0].attrib if len(entry) else {}) for entry in found}
    keys = ("unit", "min", "max", "start")
    return {name: {key: entry[key] for key in keys if key in entry} for name, entry in entries.items()}


@pytest.mark.parametrize("version", VERSIONS)
def test_units_and_ranges(fmus, slider_crank, version) -> None:
    served, found = slider_crank.served["r1"], described(fmus[version])
    ends = {"min": str(served.low), "max": str(served.high)}
    assert found["parameters.'r1-1'"] == {"unit": "m", **ends, "start": "0.0056"}
    assert found["effects.'motor-1'"] == {"unit": "N m", "start": "0.0"}
    assert found["outputs.'crank_angle-1'"] == {"unit": "rad"} and found["outputs.'slider_position-1'"] == {"unit": "m"}
    assert found["validity"] == {"min": "0", "max": "63"} and found["elastic_rotation"]["unit"] == "rad"
    assert (found["rates.'theta-1'"]["unit"], found["der(rates.'theta-1')"]["unit"]) == ("rad/s", "rad/s2")
    assert found["states.mode[1]"] == {} and {"effects.'motor-1_follows_scene'", "states.'theta-1'"} < set(found)


UNITS_OF_FMI = {
    "N m/(rad s)": {"kg": "1", "m": "2", "s": "-3", "rad": "-1"}, "rad2/s2": {"s": "-2", "rad": "2"},
    "mm": {"m": "1", "factor": "0.001"}, "m0.5": None,
}  # fmt: skip


@pytest.mark.parametrize(("unit", "known"), UNITS_OF_FMI.items())
def test_units_are_whole_powers_of_base_units_or_names_alone(unit: str, known: dict[str, str] | None) -> None:
    root = ElementTree.Element("description")
    _define_units(root, [unit])
    found = root.find("UnitDefinitions/Unit/BaseUnit")
    assert (None if found is None else found.attrib) == known


def elsewhere(program: str, *arguments: object) -> str:
    """Return what another program with FMPy prints."""
    if shutil.which(FMPY) is None:
        pytest.skip(f"no {FMPY}: scripts/setup --tests makes it, or name an interpreter with FMPy in PGMP_FMPY_PYTHON")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    command = [FMPY, "-c", program, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_SECONDS, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout


def elsewhere_run(unit: Path, step: float, starts: dict[str, float], *kinds: str) -> list[dict[str, list[float]]]:
    """Return what runs of an FMU that is valid have there, for co-simulation or model exchange."""
    return [json.loads(line) for line in elsewhere(SIMULATE, unit, step, json.dumps(starts), *kinds).splitlines()]


def test_an_arm_of_six_joints_elsewhere(tmp_path) -> None:
    """A component model has no states for integrators of others, whose steps its vibrations would have to follow."""
    asked = {
        "pull": 'force", joint="shoulder", component="radial',
        "twist": 'torque", joint="shoulder", component="magnitude',
    }
    forces = [f'outputs.{name}={{type="joint_{entries}"}}' for name, entries in asked.items()]
    forces += [f'outputs.{kind}={{type="{kind}", coordinate="elbow"}}' for kind in ("drive_torque", "power")]
    model = components_model(load_scene(ROOT / "scenes/six_joint_arm.toml", ("simulation.duration=0.04", *forces), ()))
    write_fmu(tree_constants_of(model, "it"), tmp_path / "arm.fmu", VERSIONS[-1])
    unit = Unit(tmp_path / "arm.fmu", tmp_path / "there")
    assert unit.instantiate(exchange=True) is None and "is for co-simulation alone" in unit.said[-1]
    scene = model.scene.with_values({"radius": 0.015})
    wanted, starts = motion(model.in_scene(scene)).outputs, {"parameters.radius": 0.015}
    (found,) = elsewhere_run(tmp_path / "arm.fmu", scene.simulation.step, starts, "CoSimulation")
    assert_equal({name: np.array(found[f"outputs.{name}"]) for name in wanted}, wanted)


@pytest.mark.parametrize("version", VERSIONS)
def test_an_importer_that_others_wrote(fmus, slider_crank, version) -> None:
    scene = scene_of("slider_crank", "reduction.parameter_modes=0", settings=("r1=6e-3",))
    wanted = motion(with_scene(slider_crank, scene)).outputs
    runs = elsewhere_run(fmus[version], STEP, {"parameters.'r1-1'": 6e-3}, "CoSimulation", "ModelExchange")
    for found, share in zip(runs, (1e-9, 1e-3)):
        named = {name: np.interp(STEP * np.arange(401), found["time"], found[f"outputs.'{name}-1'"]) for name in wanted}
        assert_equal(named, wanted, share)
        wanted.pop("slider_deformation", None)  # in model exchange the step's own error is that of its vibrations
