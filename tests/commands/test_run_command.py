"""`pgmp run`: every step, what a later run takes, what it leaves out, and the figures as JSON."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from conftest import ROOT, run_mpi
from length_scenes import long_crank
from machine_scenes import cart
from mpi4py import MPI
from runs import PGMP, one_message, overridden, pgmp, said

from pgmp_petsc.api import jobs
from pgmp_petsc.base.errors import warning
from pgmp_petsc.cli.declared import Session
from pgmp_petsc.cli.main import COMMANDS, load
from pgmp_petsc.results import Ensemble, Trajectory
from pgmp_petsc.scene import scene_to_toml
from pgmp_petsc.scene.loading import write_template
from pgmp_petsc.stepping.status import Status
from scenes import HEADER, tables

pytestmark = pytest.mark.usefixtures("undrawn")
# without extremes: fewer pictures on the page
SHORT = overridden(
    "simulation.duration=0.03", "simulation.step=1e-3", "reduction.modes=2", "reduction.angles=12", "ensemble.bins=10",
    "ensemble.extremes=false", "simulation.frames=5",
)  # fmt: skip
STEPS = ("check", "build", "simulate", "compare", "mesh", "ensemble", "report")

JIB = HEADER + tables("""
bodies.jib: line = { length = 10.0, elements = 10 }; element = "beam2d"; material = "steel";
    section = { shape = "hollow_rectangle", width = 0.25, height = 0.4, wall = 0.01 }
bodies.load: rigid = { mass = 2000.0, inertia = 300.0, points = { eye = [0.0, 4.0] } }
ground.points: mast = [-2.0, 6.0]
joints.heel: type = "revolute"; connect = ["ground:origin", "jib:hinge"]
joints.tip: type = "revolute"; connect = ["jib:tip", "load:eye"]
coordinates.luff: joint = "heel"; range = [0.2, 1.2]
coordinates.sway: joint = "tip"; range = [-2.2, 0.6]
effects.weight: type = "gravity"; direction = [0.0, -1.0]
effects.rope: type = "spring_damper"; points = ["ground:mast", "jib:tip"]; stiffness = 6e6; damping = 2e4; rest = 10.25
outputs.luff: type = "angle"; joint = "heel"
simulation: duration = 0.02; step = 2e-3; initial = { luff = { position = 0.6 }, sway = { position = -0.5 } }
reduction: angles = 9
""")


def told(out: str) -> dict[str, list[str]]:
    lines: dict[str, list[str]] = {}
    for line in out.splitlines():
        name, _, text = line.partition(" ")
        if name in STEPS:
            lines.setdefault(name, []).append(text.strip())
    return lines


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_template("slider_crank", tmp_path_factory.mktemp("run") / "mine.toml")[0]


@pytest.fixture(scope="module")
def first(scene: Path) -> str:
    """Return what the first run says; its trajectory is kept as first.h5."""
    out = pgmp("run", scene, "-n", 32, *SHORT).stdout
    shutil.copy(scene.with_name("mine_results") / "run.h5", scene.with_name("first.h5"))
    return out


@pytest.fixture
def no_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave pages empty, which take as long as all other steps."""
    monkeypatch.setattr("pgmp_petsc.report.page.write_report", lambda files, page: Path(page).touch() or [])


def test_every_step_says_a_line_and_leaves_a_file(scene: Path, first: str) -> None:
    lines, folder = told(first), scene.with_name("mine_results")
    assert list(lines) == list(STEPS)
    assert lines["check"][0].startswith("slider_crank: 2 bodies, 3 joints, 2 effects, ")
    assert lines["simulate"][0].startswith("reduced, 30 steps to 0.03 s; estimated error at most ")
    predicted, measured = lines["compare"]
    assert "is predicted to take" in predicted or "are predicted to take" in predicted
    assert measured.startswith("differs from full order, with the same time step, by at most ")
    assert re.match(
        r"another mesh differs by at most [\d.]+ % of the largest .* \(15 nodes against 28, full order\), an error of about",
        lines["mesh"][-1],
    )
    assert lines["ensemble"][-1].startswith("32 samples, 0 failed; P(slider_deformation above ")
    assert lines["report"][0].startswith(f"{folder / 'report.html'}: 5 files, ")
    names = {path.name for path in folder.iterdir() if not path.name.startswith(".")}
    assert names == {"rom.h5", "run.h5", "better.h5", "finer.h5", "samples.h5", "report.html", "steps.json"}


def test_a_later_run_takes_what_is_finished(scene: Path, first: str, no_page: None) -> None:
    folder = scene.with_name("mine_results")
    before = {path.name: path.stat().st_mtime_ns for path in folder.glob("*.h5")}
    lines = told(said("run", scene, "-n", 32, *SHORT)[0])
    for name in ("build", "simulate", "compare", "mesh", "ensemble"):
        assert lines[name][-1].endswith("(finished before; --force does it again)"), lines
    assert {path.name: path.stat().st_mtime_ns for path in folder.glob("*.h5")} == before
    # another number of samples is another ensemble, of the same reduced model
    page = folder / "other.html"
    lines = told(said("run", scene, "-n", 24, "--report", page, *SHORT)[0])
    again = [name for name in lines if "(finished before" in lines[name][-1]]
    assert again == ["build", "simulate", "compare", "mesh"] and "24 samples" in lines["ensemble"][-1] and page.exists()


def test_samples_are_of_a_model_with_quicker_steps(scene: Path, first: str, no_page: None, monkeypatch) -> None:
    monkeypatch.setattr(jobs, "quicker", lambda found, model: ("full", "12 us for 3 us"))
    lines = told(said("run", scene, "-n", 4, *SHORT)[0])
    assert (
        "of the model with the quicker steps: 12 us for 3 us" in lines["ensemble"]
        and "4 samples" in lines["ensemble"][-1]
    )
    assert Ensemble.read(scene.with_name("mine_results") / "samples.h5").model == "full"


def test_samples_of_an_event_are_of_a_model_that_decides_it(
    scene: Path, first: str, no_page: None, monkeypatch
) -> None:
    """Of component modes no error is estimated: an arm's probability was not decided, for some seconds less."""
    monkeypatch.setattr(jobs, "quicker", lambda found, model: ("components", "12 us for 3 us"))
    said("run", scene, "-n", 6, *SHORT)
    assert Ensemble.read(scene.with_name("mine_results") / "samples.h5").model == "reduced"


def test_another_scene_is_done_anew(scene: Path, first: str, no_page: None) -> None:
    other = overridden("materials.steel.rho=7900.0")
    out, _ = said("run", scene, "-n", 8, *SHORT, *other)
    assert "(finished before" not in out
    replaced = {name: [text for text in texts if "replaces" in text] for name, texts in told(out).items()}
    assert all(replaced[name] for name in ("build", "simulate", "compare", "mesh", "ensemble"))
    mine = scene.with_name("mine_results") / "run.h5"
    assert replaced["simulate"] == [f"replaces {mine} of {' '.join(SHORT)}; -o FOLDER keeps both"]


def test_a_refused_job_leaves_the_folder_as_it_was(scene: Path, tmp_path: Path) -> None:
    folder, steps = tmp_path / "out", tmp_path / "out" / "steps.json"
    folder.mkdir()
    (folder / "mine.txt").write_text("mine")
    foreign = "holds files and is none of pgmp run (steps.json is missing); give another with -o"
    assert foreign in one_message("run", scene, "-o", folder)
    (folder / "mine.txt").rename(steps)
    steps.write_text('{"mine": 1}')
    assert "its steps.json is none of pgmp run" in one_message("run", scene, "-o", folder)
    steps.write_text('{"format": 1, "files": {"rom.h5": {"key": "k"}}}')
    for place in (folder, tmp_path / "new"):
        message = one_message("run", scene, "-o", place, "--report", "page.pdf")
        assert "a report is written as HTML: name it" in message
    assert [path.name for path in folder.iterdir()] == ["steps.json"] and not (tmp_path / "new").exists()
    assert steps.read_text() == '{"format": 1, "files": {"rom.h5": {"key": "k"}}}'


RIGID = overridden(
    "bodies.crank.flexible=false", "bodies.rod.flexible=false", "bodies.crank.section.radius=5e-3", "parameters={}",
    'effects={motor={type="torque", joint="bearing", table=[[0.0, 0.0], [1.0, 1.0]]}}',
)  # fmt: skip


def test_what_is_left_out_is_said(tmp_path: Path, no_page: None) -> None:
    scene = write_template("slider_crank", tmp_path / "rigid.toml")[0]
    lines = told(said("run", scene, "-o", tmp_path / "out", *SHORT, *RIGID)[0])
    assert lines["build"] == ["left out: no reduced model (all bodies are rigid); runs are of the full-order model"]
    assert lines["compare"] == ["left out: the run is full-order; there is no better model"]
    assert lines["ensemble"] == ["left out: no parameter has a distribution"]
    assert (tmp_path / "out" / "report.html").exists()
    again = ("run", scene, "-o", tmp_path / "out", *SHORT, *RIGID)
    assert said(*again)[0].count("(finished before") == 1
    forced = said(*again, "--force")[0]
    assert "(finished before" not in forced and "replaces" not in forced


def test_what_fails_is_in_the_report(scene: Path, tmp_path: Path) -> None:
    """A strong motor drives the crank out of its range: the run stops, samples fail, the job ends with status 1."""
    narrow = overridden(
        "coordinates.theta.range=[-0.2, 0.02]", "coordinates.theta.periodic=false",
        "effects.motor.table=[[0.0, 0.0], [0.005, 20.0], [1.0, 20.0]]", "reference.budget=1e-9",
    )  # fmt: skip
    out, err = said("run", scene, "-o", tmp_path / "out", "-n", 8, *SHORT, *narrow, status=1)
    assert "simulation stopped at" in err and "some samples failed" in err and err.count("pgmp: error") == 1
    assert told(out)["compare"][0].startswith("left out: no reference is within reference.budget = 1e-09 s")
    assert told(out)["mesh"] == ["left out: no run of the mesh to compare with"]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Samples that failed" in page and "run.h5: the run stopped at" in page
    # what failed counts as done: it would fail again
    again, err = said("run", scene, "-o", tmp_path / "out", "-n", 8, *SHORT, *narrow, status=1)
    assert again.count("(finished before") == 3


def test_a_better_run_that_stops_is_said(
    scene: Path, first: str, tmp_path: Path, no_page: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its file holds what there is, and the job ends with status 1."""

    def stopped(*given: object) -> Trajectory:
        found = simulated(*given)
        record = replace(found.record, remarks=(warning("full-order simulation stopped"), *found.record.remarks))
        return replace(found, status=int(Status.NOT_CONVERGED), record=record)

    simulated = jobs.simulated
    monkeypatch.setattr(jobs, "simulated", stopped)
    own = shutil.copytree(scene.parent, tmp_path / "own") / scene.name
    (own.with_name("mine_results") / "better.h5").unlink()
    done = CliRunner().invoke(load(COMMANDS["run"]), [str(own), "-n", "32", *SHORT], obj=Session(MPI.COMM_SELF))
    told = r"^full-order simulation stopped; \S*better.h5, which the run is compared with, holds it up to there"
    assert re.search(told, str(done.exception)) and done.exit_code == 1


def test_another_model_runs_where_modes_cannot_be_followed(tmp_path: Path, no_page: None, monkeypatch) -> None:
    """A crane's jib, whose load swings: the rope that holds it up pulls as its modes do, and nobody asked for these. It
    is the mesh where the steps of component modes take much longer."""
    (tmp_path / "jib.toml").write_text(JIB)
    lines = told(said("run", tmp_path / "jib.toml", "-n", 3)[0])
    why = "left out: no reduced model (the static answers in the basis cannot be followed over the configurations"
    assert lines["build"][0].startswith(why) and "runs are of the component model" in lines["build"][0]
    assert lines["simulate"][0].startswith("component modes")
    monkeypatch.setattr(jobs, "quicker", lambda found, model: ("full", f"{model} are slow"))
    lines = told(said("run", tmp_path / "jib.toml", "-n", 3, "-o", tmp_path / "mesh")[0])
    assert lines["build"][0].endswith("runs are of the full-order model, as components are slow")
    assert lines["simulate"][0].startswith("full") and "full-order" in lines["compare"][0]


def test_runs_beyond_the_budget_are_left_out(tmp_path: Path, no_page: None) -> None:
    """Of a mechanism that closes at its nominal lengths alone, and of a robot: each has another model for its runs."""
    wide = 'parameters.rod_length={nominal=0.7, bounds=[0.25,0.9], distribution={name="uniform",loc=0.25,scale=0.65}}'
    scene = long_crank(wide, "simulation.duration=5e-3", "reference.budget=1e-9")
    (tmp_path / "long.toml").write_text(scene_to_toml(scene))
    lines = told(said("run", tmp_path / "long.toml", "-n", 3)[0])
    assert lines["build"][0].startswith("left out: no reduced model (at rod_length = 0.265")
    assert lines["mesh"][0].startswith("left out: it is predicted to take") and lines["simulate"][0].startswith("full")
    assert re.match("left out: 3 samples .* reference.budget = 1e-09 s; take fewer with -n", lines["ensemble"][0])
    short = overridden("simulation.duration=5e-3", "simulation.step=1e-3", "reference.budget=1e-9")
    lines = told(said("run", ROOT / "scenes" / "six_joint_arm.toml", "-o", tmp_path / "arm", *short)[0])
    assert re.match("left out: the mesh: its run is predicted to take .*, and reference.budget", lines["compare"][0])
    assert lines["mesh"] == ["left out: no run of the mesh to compare with"]


def test_two_ranks_give_the_same_figures(scene: Path, first: str, tmp_path: Path) -> None:
    done = run_mpi(2, *PGMP, "run", scene, "-o", tmp_path / "two", "-n", 8, *SHORT)
    assert told(done.stdout)["report"]
    with h5py.File(scene.with_name("first.h5")) as one, h5py.File(tmp_path / "two" / "run.h5") as two:
        for name, values in one["outputs"].items():
            # bases of several ranks differ in their last digits
            np.testing.assert_allclose(two["outputs"][name], values, rtol=1e-6, atol=1e-9 * np.abs(values).max())


def test_figures_as_json_are_those_of_the_files(scene: Path, first: str, tmp_path: Path) -> None:
    folder = scene.with_name("mine_results")
    out, err = said("simulate", folder / "rom.h5", "-o", tmp_path / "run.h5", "--json")
    figures = json.loads(out)
    with h5py.File(tmp_path / "run.h5") as file:
        assert figures["outputs"]["slider_position"]["at_end"] == file["outputs/slider_position"][-1]
        assert figures["errors"]["crank_angle"]["share"] == file["errors/crank_angle"].attrs["share"]
    out, err = said("montecarlo", folder / "rom.h5", "-n", 8, "-o", tmp_path / "many.h5", "--json")
    figures = json.loads(out)
    with h5py.File(tmp_path / "many.h5") as file:
        mean = figures["statistics"]["slider_deformation"]["mean"]
        assert mean == file["statistics/slider_deformation/mean"][()]
        interval = list(file["probabilities/bends_too_far/interval"][()])
        assert figures["probabilities"]["bends_too_far"]["interval"] == interval
    assert json.loads(said("info", tmp_path / "many.h5", "--json")[0])["statistics"] == figures["statistics"]
    checked = json.loads(said("check", scene, "--json")[0])
    assert set(checked["bodies"]) == {"crank", "rod"} and checked["outputs"]["slider_position"] == {"unit": "m"}
    assert said("info", tmp_path / "none.h5", "--json", status=2)[0] == ""  # bad input leaves none
    assert said("check", scene, "--quiet") == ("", "")
    unused = ("--override", "parameters.unused={nominal=1.0}")
    warned = "pgmp: warning: parameters.unused: nothing uses it: no entry holds its name; leave it out\n"
    assert said("check", scene, *unused, "--quiet") == ("", warned)
    assert said("check", scene, *unused, "--json")[1] == warned
    fast = ("--override", "simulation.initial.theta.velocity=1e6")
    many = ("montecarlo", folder / "rom.h5", "-n", 2, *fast, "-o", tmp_path / "fast.h5", "--quiet")
    out, err = said(*many, status=1)
    assert out == "" and err.startswith("pgmp: warning: ") and "2 of 2 samples failed" in err
    out, err = said("simulate", folder / "rom.h5", "-o", tmp_path / "run.h5", "--quiet")
    assert out == "" and err.startswith("pgmp: warning: large estimated errors") and err.count("\n") == 1
    sudden = ("--override", "effects.motor.table=[[0.0,0.0],[0.25,1e5]]")
    out, err = said("simulate", folder / "rom.h5", *sudden, "-o", tmp_path / "stop.h5", "--quiet", status=1)
    assert out == "" and err.count("stopped at") == 1, err


def test_commands_without_figures_can_be_quiet_too(
    scene: Path, first: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    folder = scene.with_name("mine_results")
    made = {
        ("new", "slider_crank"): tmp_path / "other.toml",
        ("schema", "-o"): tmp_path / "scene.json",
        ("export", folder / "run.h5", "-o"): tmp_path / "run.csv",
        ("plot", folder / "run.h5", "-o"): tmp_path / "pictures",
        ("report", folder / "run.h5", "-o"): tmp_path / "page.html",
        ("animate", folder / "run.h5", "--seconds", 0.2, "-o"): tmp_path / "run.gif",
    }
    for words, path in made.items():
        assert said(*words, path, "--quiet") == ("", "") and path.exists(), words
    request.getfixturevalue("no_page")
    assert said("run", scene, "-o", tmp_path / "out", "-n", 8, *SHORT, "--quiet") == ("", "")


@pytest.mark.parametrize(
    ("command", "kind", "figure"),
    [
        (("sensitivities", "rom.h5"), "sensitivities", "derivatives"),
        (("montecarlo", "rom.h5", "-n", 500, "--rare", "crank_angle < 1.0"), "rare_event", "estimate"),
        (("build", "scene", "--override", "reduction.angles=12"), "rom", "frequencies_hz"),
        (("modes", "scene", "--override", "reduction.angles=12"), "modes", "full_frequencies_hz"),
    ],
)
def test_every_command_has_figures(scene: Path, first, tmp_path: Path, command: tuple, kind: str, figure: str) -> None:
    places = {"rom.h5": scene.with_name("mine_results") / "rom.h5", "scene": scene}
    out, _ = said(*(places.get(word, word) for word in command), "-o", tmp_path / "one.h5", "--json")
    found = json.loads(out)
    assert found["kind"] == kind and found[figure] is not None and found["scene"]
    if kind != "rom":
        assert json.loads(said("info", tmp_path / "one.h5", "--json")[0])[figure] == found[figure]


def test_controlled_machines_of_drawn_lengths_have_reduced_models(tmp_path: Path, no_page: None) -> None:
    servo = 'controllers.hold={type="pid",measures="swing",joint="pivot",gains={p=10.0,d=0.3}}'
    drawn = 'parameters.long={nominal=0.5,bounds=[0.4,0.6],distribution={name="uniform",loc=0.495,scale=0.01}}'
    path = tmp_path / "cart.toml"
    near = "coordinates.x.range=[-0.1,0.2]", "coordinates.swing.range=[-0.9,0.3]", "reduction.angles=6"
    few = *near, "reduction.length_points=2", "simulation.duration=0.02"
    path.write_text(scene_to_toml(cart(servo, drawn, 'bodies.pole.line.length="long"', *few)))
    assert "refused       pgmp" not in said("check", path)[0]
    lines = told(said("run", path, "-o", tmp_path / "cart", "-n", 3)[0])
    assert lines["simulate"][0].startswith("reduced") and "3 samples, 0 failed" in lines["ensemble"][-1]


def test_scenes_of_many_coordinates_run_as_component_models(tmp_path: Path, no_page: None) -> None:
    short = overridden("simulation.duration=0.01", "simulation.step=1e-3", "simulation.frames=3")
    arm = ROOT / "scenes" / "six_joint_arm.toml"
    lines = told(said("run", arm, "-o", tmp_path / "arm", "-n", 4, *short)[0])
    assert lines["build"] == ["left out: no reduced model (6 coordinates); runs are of the component model"]
    assert "predicted to take" in lines["compare"][0] and lines["compare"][1].startswith("differs from full order")
    assert "predicted to take" in lines["ensemble"][0] and "4 samples, 0 failed" in lines["ensemble"][1]


def test_an_interrupted_run_says_that_the_same_command_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its files are kept, and there is no --resume."""
    own, *_ = write_template("slider_crank", tmp_path / "mine.toml")

    def interrupted(self: jobs._Job, n: int, seed: int) -> None:
        assert (own.with_name("mine_results") / "rom.h5").exists()
        raise KeyboardInterrupt

    for step in ("simulate", "compare", "refine"):
        monkeypatch.setattr(jobs._Job, step, lambda self: None)
    monkeypatch.setattr(jobs._Job, "sample", interrupted)
    last = pgmp("run", own, "-n", "32", *SHORT, status=130).stderr.splitlines()[-1]
    assert last.endswith(f"is kept in '{own.with_name('mine_results')}'; the same command goes on from there"), last
