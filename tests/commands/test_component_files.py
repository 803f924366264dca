"""Component models in files of their own: the same runs as from the scene, without it, its meshes and PETSc."""

import pickle
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, run_mpi
from result_files import assert_same, contents, in_turn, statuses
from runs import PGMP, overridden, pgmp
from test_without_petsc import LAUNCHER

import pgmp_petsc as interface
from pgmp_petsc.results import Ensemble

SCENES = ROOT / "scenes"
SHORT = "simulation.duration=0.02"
SECOND_ORDER = ("geometric_stiffening", "mode_inertia")
STRESS = 'outputs.stress={type="stress", body="rod", quantity="von_mises"}'
#: Rigid bodies of lines, of cells and of neither; flexible ones of beams and cells, in the plane and in space.
CASES = {
    "beams in space": ("six_joint_arm",), "closed, in the plane": ("platform_3rrr", "initial={equilibrium=true}"),
    "mass properties and controllers": ("servo_arm",), "cells with stresses": ("slider_crank_solid2d", STRESS),
    "a rigid body of cells": ("slider_crank_solid2d", "bodies.crank.flexible=false"),
    "foreshortening": ("slider_crank_paper", *(f'effects.{t}={{type="{t}"}}' for t in SECOND_ORDER)),
    "a beam that something rides on": ("bridge_crane",), "mixture": ("spatial_mixed",),
}  # fmt: skip


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the model of an arm in a folder without anything else."""
    path = tmp_path_factory.mktemp("alone") / "arm.h5"
    said = pgmp("build", SCENES / "six_joint_arm.toml", "--components", *overridden(SHORT), "-o", path).stdout
    assert "arm.h5: component model; amplitudes: upper 14, fore 14" in said
    return path


@pytest.mark.parametrize("case", CASES)
def test_a_run_is_that_of_the_scene(case: str, tmp_path: Path) -> None:
    """To the last bit, with its energies and estimates; places of frames and fields to round-off, as what
    LAPACK finds of a loop hangs on where numbers lie in memory."""
    name, *changes = CASES[case]
    source, changes = SCENES / f"{name}.toml", ("simulation.duration=6e-3", "simulation.frames=4", *changes)
    model = interface.build(source, components=True, overrides=changes, output=tmp_path / "model.h5")
    runs = {
        "file": interface.simulate(tmp_path / "model.h5", output=tmp_path / "file.h5"),
        "object": interface.simulate(pickle.loads(pickle.dumps(model)), output=tmp_path / "object.h5"),
        "scene": interface.simulate(source, model="components", overrides=changes, output=tmp_path / "scene.h5"),
    }
    assert {run.data.model for run in runs.values()} == {"components"} and runs["file"].time.size > 2
    found = {name: contents(tmp_path / f"{name}.h5") for name in runs}
    assert_alike(found["file"], found["object"])
    for one in found.values():
        one.pop("remarks")  # a scene with its meshes says more of these
    assert_alike(found["file"], found["scene"])


def assert_alike(found: dict[str, bytes], expected: dict[str, bytes]) -> None:
    assert found.keys() == expected.keys()
    for name in [name for name in found if found[name] != expected[name]]:
        assert name.startswith(("fields/", "frames/")), name
        one, other = (np.frombuffer(values) for values in (found[name], expected[name]))
        np.testing.assert_allclose(one, other, rtol=0, atol=4e-15, err_msg=name)


def test_what_a_file_keeps_from_call_to_call_changes_no_number(arm: Path) -> None:
    """A call with another run has the mechanism of the one before, one with other parameters or outputs, or that begins
    elsewhere, its own."""
    kept, calls = interface.read(arm), ({}, {"simulation.duration": 0.01}, {"outputs.deflection.axis": "y"}, {})
    calls += ({"simulation.initial.hand.position": 0.3},)
    for overrides, radius in zip(2 * calls, len(calls) * (12e-3,) + len(calls) * (11e-3,)):
        runs = [
            interface.simulate(model, {"radius": radius}, overrides=overrides) for model in (kept, interface.read(arm))
        ]
        np.testing.assert_equal(runs[1].outputs, runs[0].outputs)
    assert len(pickle.dumps(kept)) == len(pickle.dumps(interface.read(arm)))  # what was made stays here


def test_ensembles_of_file_and_scene_are_the_same_on_any_ranks(arm: Path, tmp_path: Path) -> None:
    words = ("-n", 6, *overridden("ensemble.batch=2"), "-o")
    scene = ("montecarlo", SCENES / "six_joint_arm.toml", "--components", *overridden(SHORT), *words)
    pgmp(*scene, tmp_path / "one.h5")
    run_mpi(2, *PGMP, "montecarlo", arm, *words, tmp_path / "file.h5")
    run_mpi(3, *PGMP, *scene, tmp_path / "scene.h5")
    one, *others = (Ensemble.read(tmp_path / f"{name}.h5") for name in ("one", "file", "scene"))
    for other in others:
        assert one.model == other.model == "components"
        np.testing.assert_equal(other.outputs, one.outputs)


def test_commands_without_petsc(arm: Path, tmp_path: Path) -> None:
    """Runs, ensembles, shards, better models, rare events and pages."""
    here = tmp_path / "arm.h5"
    shutil.copy(arm, here)
    calls = """
        simulate arm.h5 --set radius=0.011 -o run.h5
        montecarlo arm.h5 -n 16 --correct components/2=8 -o joined.h5
        montecarlo arm.h5 -n 16 --until "mean(deflection) < 50 %" -o until.h5
        montecarlo arm.h5 -n 8 -o many.h5
        montecarlo arm.h5 -n 8 --shard 1/2 -o first.h5
        montecarlo arm.h5 -n 8 --shard 2/2 -o second.h5
        merge first.h5 second.h5 -o merged.h5
        montecarlo arm.h5 -n 500 --rare "deflection < -4.05e-5" --override simulation.duration=4e-3 -o rare.h5
        info arm.h5
        report arm.h5 run.h5 many.h5 -o page.html
        export run.h5 -o run.xdmf
    """
    lines = [shlex.split(line) for line in calls.strip().splitlines()]
    is_file = re.compile(r"\w+\.(h5|html|xdmf)").fullmatch
    done = in_turn([[str(tmp_path / word) if is_file(word) else word for word in line] for line in lines], LAUNCHER)
    assert statuses(done) == [0] * len(lines), done.stdout + done.stderr
    assert_same(tmp_path / "many.h5", tmp_path / "merged.h5")
    pgmp("simulate", arm, "--set", "radius=0.011", "-o", tmp_path / "ours.h5")
    assert_same(tmp_path / "run.h5", tmp_path / "ours.h5")
    page = (tmp_path / "page.html").read_text()
    assert "pgmp build scene.toml --components -o arm.h5" in page and "pgmp simulate arm.h5" in page


def test_points_of_a_grid_and_samples_over_time(arm: Path) -> None:
    model, many = interface.read(arm), interface.montecarlo(arm, 3, seed=1)
    grid = interface.simulate(model, {"radius": [11e-3, 13e-3]})
    np.testing.assert_array_equal(grid.deflection[1], interface.simulate(arm, {"radius": 13e-3}).outputs["deflection"])
    again = interface.histories(model, many, [2])
    np.testing.assert_array_equal(again.deflection[0, -1], many.outputs["deflection"][2])


def test_a_component_model_is_a_better_model_of_a_reduced_one(tmp_path: Path) -> None:
    """Without meshes; and what is of another mechanism is refused."""
    scene, quick = SCENES / "slider_crank_solid2d.toml", overridden(SHORT, "reduction.angles=6", "reduction.modes=2")
    paths = {name: tmp_path / f"{name}.h5" for name in ("rom", "model", "arm", "joined", "scene")}
    pgmp("build", scene, "-o", paths["rom"], *quick)
    pgmp("build", scene, "--components", "-o", paths["model"], *quick)
    pgmp("build", SCENES / "six_joint_arm.toml", "--components", "-o", paths["arm"])
    ensemble = ("montecarlo", paths["rom"], "-n", 8, "-o")
    pgmp(*ensemble, paths["joined"], "--correct", f"{paths['model']}:components=8")
    copy = tmp_path / "scenes" / "copy.toml"
    copy.parent.mkdir()
    (tmp_path / "meshes").symlink_to(ROOT / "meshes")
    copy.write_text(pgmp("info", paths["rom"], "--scene").stdout)
    pgmp(*ensemble, paths["scene"], "--correct", f"{copy}:components=8")
    one, other = (Ensemble.read(paths[name]).joined for name in ("joined", "scene"))
    assert one.models == ("components", "reduced")
    for name, found in other.corrected.items():
        assert one.corrected[name].figures["mean"].estimate == found.figures["mean"].estimate
    said = pgmp(*ensemble, paths["scene"], "--correct", f"{paths['arm']}:components=8", status=2).stderr
    assert f"--correct {paths['arm']}:components=8: [" in said and f"differs from that of '{paths['rom']}'" in said


NO_FRAME = 'outputs.z.point = "upper:3": no frame of the condensed body; it has hinge, tip'
NO_STRESS = "outputs: stresses of upper, which was condensed without what they need"
BUILT = "was built from this entry; override it in pgmp build instead"
AGAIN = "pgmp build SCENE --components makes a model for it, in place of '{arm}'"
POINT = 'outputs.z={type="position", point="upper:3", axis="z"}'
AXIAL = 'outputs.s={type="stress", body="upper", quantity="axial_force", at=[0.0, 0.0, 0.0]}'
REFUSED = {
    "simulate {arm} --full": "--full: '{arm}' is a component model; give its scene, SCENE.toml",
    "montecarlo {arm} -n 8 --full": "--full: '{arm}' is a component model",
    "simulate {arm} --override reduction.modes=3": f"--override reduction: '{{arm}}' {BUILT}",
    "simulate {arm} --override materials.aluminium.E=7e9": f"--override materials: '{{arm}}' {BUILT}",
    "simulate {arm} --override effects.tool.mass=1.0": f"--override effects.tool: '{{arm}}' {BUILT}",
    f"simulate {{arm}} --override '{POINT}'": f"{NO_FRAME}; {AGAIN}",
    f"simulate {{arm}} --override '{AXIAL}'": f"{NO_STRESS}; {AGAIN}",
    "simulate {arm} --override parameters.radius.nominal=0.01": f" parameters.radius.nominal: '{{arm}}' {BUILT}",
    "montecarlo {arm} -n 8 --ranks-per-sample 2": "samples of component modes are small; leave it out",
    "montecarlo {arm} -n 8 --correct full=8": "has no mesh of upper, fore, only what was condensed of it; give",
    "modes {double} --rom {arm}": "holds a component model; needed: a reduced model, with tables over configurations",
    "animate {arm} --mode 1": "'{arm}' is a component model, which has no modes of the mechanism",
    "report {arm}": "'{arm}' holds a component model, and no results of its scene are here",
    "build {double} --components --resume": "--resume with --components: bodies are condensed one a rank",
    "build {double} --components --ranks-per-angle 2": "--ranks-per-angle with --components",
    "tradeoff {arm}": "an HDF5 file (pgmp info and pgmp.read read the program's own); a scene is a TOML file",
}  # fmt: skip
OUTPUTS = {"export": "model", "animate": "film.gif", "report": "page.html"}


@pytest.mark.parametrize("call", REFUSED)
def test_what_is_refused(call: str, arm: Path, tmp_path: Path) -> None:
    names = {"arm": str(arm), "double": str(SCENES / "double_pendulum.toml")}
    words = [word.format(**names) if word[0] == "{" else word for word in shlex.split(call)]
    output = tmp_path / OUTPUTS.get(words[0], "out.h5")
    done = pgmp(*words, "-o", output, status=2)
    assert REFUSED[call].format(**names) in done.stderr
    assert "Traceback" not in done.stderr and not output.exists()


def test_values_that_bodies_of_cells_were_condensed_for(capsys: pytest.CaptureFixture) -> None:
    """Those of parameters that terms hang on by several factors have ranges, as of reduced models; others have none."""
    law = 'parameters.{}={{nominal={}, distribution={{name="norm", loc={}, scale={}}}, unit="{}"}}'.format
    scaled = (law("s", 1.0, 1.0, 0.02, "1"), 'bodies.rod.section_scale="s"', SHORT)
    model = interface.build(SCENES / "slider_crank_solid2d.toml", components=True, overrides=scaled)
    run = interface.simulate(model, {"s": 1.05, "t1": 0.012}).outputs["slider_deformation"]
    scene = interface.simulate(model.scene, {"s": 1.05, "t1": 0.012}, model="components").outputs["slider_deformation"]
    np.testing.assert_allclose(run, scene, rtol=0, atol=1e-4 * np.max(np.abs(scene)))  # which serves this value too
    interface.montecarlo(model, 2, overrides=('parameters.s.distribution={name="norm", loc=1.0, scale=0.04}',))
    assert "0.019 % of it lie outside" not in capsys.readouterr().err
    said = "parameters.s.value = 1.5: beyond what the model serves"
    with pytest.raises(interface.InputError, match=said):
        interface.simulate(model, {"s": 1.5})
    with pytest.raises(interface.InputError, match="samples are beyond what the model serves, number 1 with s = 1.5"):
        interface.montecarlo(model, samples={"s": [1.0, 1.5], "t1": [0.01, 0.01]})


def test_lengths_of_condensed_bodies(tmp_path: Path) -> None:
    """Those of flexible bodies are what they were condensed with; those of rigid ones may be any."""
    law = "{{nominal={}, bounds=[0.01, 0.6]}}".format
    lengths = (f"parameters.long={law(0.45)}", 'bodies.fore.line.length="long"', SHORT)
    lengths += (f"parameters.short={law(0.1)}", 'bodies.hand.line.length="short"')
    scene = SCENES / "six_joint_arm.toml"
    model = interface.build(scene, components=True, overrides=lengths)
    run = interface.simulate(model, {"short": 0.12})
    other = interface.simulate(scene, {"short": 0.12}, model="components", overrides=lengths)
    assert run.outputs["hand_x"][0] == pytest.approx(1.23)
    np.testing.assert_array_equal(run.outputs["deflection"], other.outputs["deflection"])
    said = "parameters.long.value = 0.5, but its body fore was condensed with 0.45; pgmp build SCENE --components"
    with pytest.raises(interface.InputError, match=said):
        interface.simulate(model, {"long": 0.5})


def test_derivatives_are_differences_of_runs_with_their_error(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """Those of a reduced run are exact: as near as the models are, 0.04 % of the angle and 0.5 % of the deformation."""
    quick = ("simulation.duration=0.05", "reduction.modes=6")
    scene = SCENES / "slider_crank.toml"
    begun = 'coordinates.theta={joint="crank_hinge", range=[-0.2, 0.5]}', "reduction.angles=16"
    exact = interface.sensitivities(interface.build(scene, overrides=(*quick, *begun)))
    model = interface.build(scene, components=True, overrides=quick)
    found = interface.sensitivities(model)
    for output, near in {"crank_angle": 1e-3, "slider_position": 2e-3, "slider_deformation": 1e-2}.items():
        one, other = (run.derivatives[output]["r1"] for run in (found, exact))
        np.testing.assert_allclose(one, other, rtol=0, atol=near * np.max(np.abs(other)))
    (said,) = (one.text for one in found.remarks if "differences" in one.text)
    assert "because of the component model; they are estimated to be off by up to 0.00" in said
    same = interface.sensitivities(scene, model="components", overrides=quick)
    np.testing.assert_array_equal(same.derivatives["crank_angle"]["r1"], found.derivatives["crank_angle"]["r1"])


def test_derivatives_of_what_a_drive_gives_are_no_doubt() -> None:
    """An angle that is prescribed hangs on no parameter: differences of its round-off were five times the largest."""
    turned = 'outputs.turned={type="angle", joint="main_bearing"}'
    scene = SCENES / "machine_on_mounts.toml"
    found = interface.sensitivities(scene, model="components", overrides=("simulation.duration=0.2", turned))
    (said,) = (one.text for one in found.remarks if "differences" in one.text)
    assert "turned" not in said


def test_derivatives_with_controllers(capsys: pytest.CaptureFixture) -> None:
    """Run by run, as forces beside are of one sample, which is said first; against differences of single runs."""
    model = interface.build(SCENES / "servo_arm.toml", components=True, overrides=("simulation.duration=0.1",))
    capsys.readouterr()
    found = interface.sensitivities(model, ["kp"])
    assert "its derivatives takes 5 to 15 runs, one after the other: derivatives are diff" in capsys.readouterr().err
    value, step = model.scene.parameters["kp"].nominal, 1e-3 * model.scene.parameters["kp"].nominal
    up, down = (interface.simulate(model, {"kp": value + sign * step}).outputs for sign in (1, -1))
    for output in ("tip_x", "hinge_angle"):
        slope = (up[output] - down[output]) / (2.0 * step)
        np.testing.assert_allclose(found.derivatives[output]["kp"], slope, rtol=0, atol=1e-4 * np.max(np.abs(slope)))


def test_fits_and_designs(arm: Path, tmp_path: Path) -> None:
    """A radius is found again from a run with it; a design ends at its constraint."""
    pgmp("simulate", arm, "--set", "radius=0.0113", "-o", tmp_path / "measured.csv")
    table = (tmp_path / "measured.csv").read_text().splitlines()
    pgmp("fit", arm, tmp_path / "measured.csv", "-o", tmp_path / "fit.h5")
    (parameter,) = interface.read(tmp_path / "fit.h5").parameters
    assert len(table) == 22 and parameter.estimate == pytest.approx(0.0113, rel=1e-6)
    goal = ("minimise max(abs(deflection))", "--subject-to", "radius <= 0.0125")
    said = pgmp("optimize", arm, *goal, "-o", tmp_path / "design.h5").stdout
    (parameter,) = interface.read(tmp_path / "design.h5").parameters
    assert parameter.value == pytest.approx(0.0125, rel=1e-9) and "because of the component model" in said
    said = pgmp("sensitivities", SCENES / "six_joint_arm.toml", "-o", tmp_path / "s.h5", status=2).stderr
    assert "is not an HDF5 file" in said and "--components" in said
