"""Commands that choose and measure: tolerances and what cannot meet them, trade-offs, trials, settled starts."""

import re
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, run_mpi
from refusals import cases
from runs import PAPER_SCENE, PGMP, besides_progress, overridden, pgmp, refused, said

from pgmp_petsc.components.condensing import FACTORS
from pgmp_petsc.results import Ensemble, Tradeoff, Trajectory
from pgmp_petsc.scene.loading import write_template

RIGID = 'outputs={crank_angle={type="angle", joint="crank_hinge"}}'
NO_MORE = "inertia_modes=false, parameter_modes=0"
PLAIN = f'modes=4, static_modes=true, {NO_MORE}, second_order=false, angles=48, interpolation="spectral"'
SHORT = "simulation={duration=0.1, step=1e-3}"
WORDS = {"NO_MORE": NO_MORE, "PLAIN": PLAIN, "SHORT": SHORT, "RIGID": RIGID}
# Overrides, and words of the message; * also on three ranks. What stands in the way: the basis, all modes of the mesh,
# angles, different errors of time integration, round-off, the step, gravity at once and impacts, nothing.
REFUSED = cases("""
* reduction={tolerance=6e-3, modes=2, static_modes=false, NO_MORE, second_order=false} & SHORT ->
    reduction.tolerance = 0.006: cannot be met, the basis stands in the way | basis: at best 0. | allowed 0.0027 |
    the mesh itself leaves more than the tolerance: cells cut in two would move slider_deformation by 0.0 |
    slider_deformation, load ' | half the load leaves | can be met by this part | kept as given: reduction.modes = 2,
    reduction.static_modes = false, reduction.inertia_modes = false, reduction.parameter_modes = 0, reduction.second
reduction={tolerance=1e-4, modes=30, static_modes=false, second_order=false, angles=24, interpolation="spectral"} &
    simulation={duration=0.05, step=1e-3} ->
    cannot be met, the basis stands in the way | these are all flexible modes that the meshes have
reduction={tolerance=1e-3, modes=7, static_modes=true, NO_MORE, second_order=false, angles=16, interpolation="spline"} &
    simulation={duration=0.4, step=2e-3} ->
    the basis stands in the way | interpolation: at best 0. | part of the basis's error | reduction.angles = 16
reduction={tolerance=1e-4, PLAIN} & simulation={duration=0.3, step=5e-3} & RIGID ->
    reduction.tolerance = 0.0001: cannot be met, the time step stands in the way | with 60 steps |
    take a smaller simulation.step, or let simulation.tolerance choose it
reduction={tolerance=1e-8, PLAIN} & SHORT & RIGID & effects.motor.table=[[0.0, 0.0], [0.05, 1e-7]] ->
    reduction.tolerance = 1e-08: cannot be met, round-off stands in the way | 1e-10 rad
simulation={tolerance=1e-3, duration=0.1, step=1e-3} ->
    simulation.tolerance = 0.001: cannot be met, the time step stands in the way | step: at best 0.00 |
    allowed 0.0005 | simulation.step = 0.001 is kept as given; leave it out to have it chosen
reduction={tolerance=1e-4, PLAIN} & simulation={duration=0.15, step=1e-3, initial={theta={position=1.0}}} &
    effects.weight={type='gravity'} & effects.wall={type='end_stop', joint='slider', upper=0.86, stiffness=1e5} ->
    effects.weight acts at once at the start | starts where they are, halving the step then moves 0.00 |
    and the same basis leaves 0.00
* reduction={tolerance=1e-3} & outputs={} -> reduction.tolerance: errors are those of outputs, and the scene has none
""")


def arguments(asked: str, folder: Path) -> list[str]:
    for word, meaning in WORDS.items():
        asked = asked.replace(word, meaning)
    return ["build", str(PAPER_SCENE), "-o", str(folder / "rom.h5"), *overridden(*asked.lstrip("* ").split(" & "))]


@pytest.mark.parametrize("n_ranks", [1, 3])
def test_the_message_says_what_stands_in_the_way(tmp_path: Path, n_ranks: int) -> None:
    """Exit status 2 on every rank, one message, no file, and no rank waits for another."""
    chosen = [case for case in REFUSED if n_ranks == 1 or case[0].startswith("* ")]
    for (asked, said), message in zip(chosen, refused(n_ranks, [arguments(asked, tmp_path) for asked, _ in chosen])):
        assert all(words in message for words in said.split(" | ")), (asked, message)
    assert not list(tmp_path.iterdir())


def test_what_was_chosen_is_said_and_kept(tmp_path: Path) -> None:
    """A build says it, `info` shows the attempts, a run takes the chosen step or another for a tolerance of its own."""
    rom, run = tmp_path / "rom.h5", tmp_path / "run.h5"
    given = f"reduction={{tolerance=1e-2, {PLAIN}}}"
    asked = overridden(given, "simulation={tolerance=1e-2, duration=0.1, frames=3}", RIGID)
    said = pgmp("build", PAPER_SCENE, "-o", rom, *asked).stdout
    assert "reference: the mesh" in said
    for words in (
        "chosen for reduction.tolerance = 0.01 and simulation.tolerance = 0.01", "kept as given: reduction.modes = 4",
        "the step was found with 'own'", "simulation.step = 0.00156", "trained on r1 = 0.0056",
        "no part of the tolerance: cells cut in two", "processor time of a sample",
    ):  # fmt: skip
        assert words in said, said
    told = pgmp("info", rom).stdout
    for words in ("  basis, allowed 0.005", "  step, allowed 0.005", "modes = 4, static_modes = true, inertia_modes"):
        assert words in told, told
    assert "reduced model, 65 steps to 0.1 s" in pgmp("simulate", rom, "-o", run).stdout
    again = pgmp("simulate", rom, "-o", run, *overridden("simulation={tolerance=1e-3, duration=0.1, frames=3}")).stdout
    assert "simulation.tolerance = 0.001: simulation.step = " in again
    too_long = overridden("simulation={tolerance=1e-4, duration=0.1, step=4e-3}")
    refused = pgmp("simulate", rom, "-o", run, *too_long, status=2)
    assert "the time step stands in the way\n  step: at best" in refused.stderr
    assert 'model = "reduced"' in refused.stderr


def test_training_runs_that_leave_the_range_do_not_count(tmp_path: Path) -> None:
    """Stronger motors drive the crank beyond where the nominal one does, which has to stay."""
    scene = write_template("slider_crank", tmp_path / "mine.toml")[0]
    few = f"reduction={{tolerance=0.3, modes=2, static_modes=true, {NO_MORE}, second_order=false, angles=12}}"
    short = "simulation.duration=0.03", "simulation.step=1e-3", "coordinates.theta.periodic=false"
    motor = "effects.motor.table=[[0.0, 0.0], [0.005, 5.0], [1.0, 5.0]]"

    def build(upper: float, status: int) -> str:
        changed = overridden(few, *short, motor, f"coordinates.theta.range=[-0.2, {upper}]")
        return "".join(said("build", scene, "-o", tmp_path / "rom.h5", *changed, status=status))

    alone = "training run of the full-order model at nominal parameters, own loads: the coordinate leaves its range"
    assert alone in build(0.02, 1) and not (tmp_path / "rom.h5").exists()
    told = re.findall("load '(.*)': the full-order model leaves the range .* in (.*) of 13 .*; they do", build(0.1, 0))
    assert {load for load, _ in told} >= {"own"} and all(0 < int(n) < 13 for _, n in told)


def test_one_rank_and_two_choose_the_same(tmp_path: Path) -> None:
    given = "reduction={tolerance=1e-2, %s}" % PLAIN.replace("modes=4, ", "").replace("48", "24")
    command = ["build", str(PAPER_SCENE), *overridden(given, SHORT, RIGID, 'reference.model="components"')]
    one = pgmp(*command, "-o", tmp_path / "one.h5").stdout
    two = run_mpi(2, *PGMP, *command, "-o", tmp_path / "two.h5").stdout

    def chosen(text: str) -> list[str]:
        lines = text[text.index("chosen for") :].splitlines()
        return [line for line in lines if "processor time" not in line]

    assert chosen(one) == chosen(two)
    assert "away from the mesh" in one


# a part of the revolution in a fiftieth of the time: enough for everything but accuracy
SMALL = overridden(
    "reduction.modes=4", "reduction.angles=24", "simulation.duration=0.02", "ensemble.batch=8",
    'coordinates.theta={joint="crank_hinge", range=[-0.5, 1.0]}',
)  # fmt: skip
OUTPUTS = ["crank_angle", "slider_position", "slider_deformation"]


@pytest.fixture(scope="module")
def printed(folder: Path) -> str:
    """Return what the short study prints; its file is ``f.h5``."""
    done = pgmp("tradeoff", PAPER_SCENE, "--quick", "-n", 500, "-o", folder / "f.h5", *SMALL)
    assert besides_progress(done.stderr) == "", "no bar without a terminal"
    return done.stdout


def test_what_is_printed(printed: str, folder: Path) -> None:
    said, *lines = printed.splitlines()
    study = Tradeoff.read(folder / "f.h5")
    assert said == study.reference and said.startswith("reference: the mesh; its runs are predicted to take")
    assert study.reference_model == "full" and not (folder / "f.h5.partial").exists()
    assert lines[0] == f"{folder / 'f.h5'}: {len(study.families)} settings, errors at 8 values of r1, 1 rank(s)"
    assert "crank_angle" in lines[1] and "500 in s" in lines[1]
    for words in ("reference, the scene's meshes", "mesh error, 10 cells", "in every output", "times"):
        assert words in printed
    assert sum(line.startswith(">") for line in lines) >= 1, "the scene as it is"


def test_the_file_holds_the_study(printed: str, folder: Path) -> None:
    study = Tradeoff.read(folder / "f.h5")
    assert (study.outputs, study.samples, study.record.parameters) == (OUTPUTS, 500, {"r1": 5.6e-3})
    assert len(study.families) > 15 and len(study.record.timings) == 3 and np.isfinite(study.errors[0]).all()


def test_info_shows_the_table_and_the_advice(printed: str, folder: Path) -> None:
    shown = pgmp("info", folder / "f.h5").stdout
    assert "trade-off study" in shown and "/settings/modes" in shown
    without_times = [line.strip() for line in printed.splitlines()[2:] if not line.endswith(" s")]
    assert set(without_times) <= {line.strip() for line in shown.splitlines()}


def test_plot_draws_three_pictures(printed: str, folder: Path, undrawn: None) -> None:
    done = pgmp("plot", folder / "f.h5", "-o", folder / "out")
    names = ("tradeoff.png", "tradeoff_total.png", "tradeoff_mesh.png")
    assert done.stdout.splitlines() == [str(folder / "out" / name) for name in names]


def test_pasting_the_advice_gives_the_setting(printed: str, folder: Path) -> None:
    study = Tradeoff.read(folder / "f.h5")
    row = study.families.index("reduced", 3)
    flags = study.flags[row].replace("'", "").split()
    done = pgmp("build", PAPER_SCENE, "-o", folder / "rom.h5", *SMALL, *flags)
    assert f"{study.columns['angles'][row]} angles, {study.columns['coordinates'][row] - 1} modes" in done.stdout


SOLID = ROOT / "scenes" / "slider_crank_solid2d.toml"
TRIAL = re.compile(
    r"trial +rod, 1130 unknowns: assembly (\S+) s, factorisation (\S+) s, solve (\S+) s\n"
    r" +build +about (\S+) s for condensing the bodies, (\S+) ([MG])B on all ranks"
)


def test_the_largest_body_is_tried() -> None:
    found = TRIAL.search(run_mpi(2, *PGMP, "check", SOLID, "--trial").stdout)
    assembly, factorisation, solve, build, memory = map(float, found.groups()[:5])
    assert min(assembly, factorisation, solve) > 0.0
    # more than the steps that it is made of, each taken once
    assert assembly + FACTORS * factorisation + solve < build < 60.0
    assert memory > (50.0 if found[6] == "M" else 0.05) * 2


def test_a_factor_that_has_no_folder_is_bad_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUMPS_OOC_TMPDIR", str(tmp_path / "none"))
    options = ("--", "-pgmp_body_st_mat_mumps_icntl_22", "1")
    said = pgmp("check", SOLID, "--trial", *options, status=2).stderr
    assert said.startswith("pgmp: error: MUMPS_OOC_TMPDIR = ") and said.count("\n") == 1
    # and nothing is left where there is one
    monkeypatch.setenv("MUMPS_OOC_TMPDIR", str(tmp_path))
    pgmp("check", SOLID, "--trial", *options)
    assert not list(tmp_path.iterdir())


SCENE = ROOT / "scenes" / "slider_crank.toml"
SHORT_RUN = overridden(
    "reduction.modes=2", "reduction.angles=8", "reduction.parameter_modes=0", "simulation.duration=0.004",
    "coordinates.theta.range=[-0.3, 0.6]", "coordinates.theta.periodic=false", "ensemble.checked_share=1.0",
)  # fmt: skip
HELD = overridden("initial.equilibrium=true", "effects.motor.table=[[0.0, 0.5], [1.0, 0.5]]")
# nothing holds a torque on a mechanism without weight
LOST = [*HELD, *overridden('initial.coordinates="free"')]


@pytest.fixture(scope="module")
def rom(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("settled") / "rom.h5"
    pgmp("build", SCENE, *SHORT_RUN, "-o", path)
    return path


def test_a_built_model_takes_another_start(rom: Path, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    out = pgmp("simulate", rom, *HELD, "-o", path).stdout
    assert "note: the run starts from static deformation with coordinates held at theta = 0 rad" in out
    run = Trajectory.read(path)
    assert run.balance.strain[0] > 0.0 and run.errors is not None
    assert any("starts from static deformation" in remark.text for remark in run.record.remarks)
    # held, the crank turns by nothing
    assert abs(run.outputs["crank_angle"][0]) < 1e-9


@pytest.mark.parametrize("full", [False, True])
def test_a_run_without_equilibrium_is_refused(full: bool, rom: Path, tmp_path: Path) -> None:
    source = [SCENE, "--full", *SHORT_RUN] if full else [rom]
    message = pgmp("simulate", *source, *LOST, "-o", tmp_path / "run.h5", status=2).stderr
    for words in ('initial.coordinates = "free"', "no static equilibrium", "N m on theta", 'coordinates = "held"'):
        assert words in message
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("full", [False, True])
def test_samples_without_equilibrium_are_records(full: bool, rom: Path, tmp_path: Path) -> None:
    source, path = [SCENE, "--full", *SHORT_RUN] if full else [rom], tmp_path / "samples.h5"
    done = pgmp("montecarlo", *source, *LOST, "-n", 3, "-o", path, status=1)
    assert "Traceback" not in done.stderr
    warned = "3 of 3 samples failed (status 7): no static equilibrium was found to start from"
    assert done.stdout.count(warned) == 1, "said once"
    np.testing.assert_array_equal(Ensemble.read(path).status, 7)


def test_a_prescribed_coordinate_is_not_said_to_be_let_go(tmp_path: Path) -> None:
    """One of two coordinates is prescribed; then both, none of which is let go."""
    rest = "[[0.0, {0}], [0.05, {0}], [0.1, {1}]]"
    left, right = (
        f'effects.{name}_motor={{type="prescribed_motion",coordinate="{name}",table={rest.format(*ends)}}}'
        for name, ends in (("left", (2.0, 2.1)), ("right", (1.1, 1.2)))
    )
    short = ["initial.equilibrium=true", "simulation.duration=0.002", "reduction.static_modes=false"]
    held, started = "the run starts from static deformation with coordinates held at left = 2 rad, right = 1.", []
    scene, path = ROOT / "scenes" / "five_bar.toml", tmp_path / "run.h5"
    for drives, begun in (
        ([], "left={position=2.0},right={position=1.1}"), ([left], "right={position=1.1}"), ([left, right], ""),
    ):  # fmt: skip
        given = overridden(*short, *drives, f"simulation.initial={{{begun}}}")
        out = pgmp("simulate", scene, "--full", *given, "-o", path).stdout
        started += [line for line in out.splitlines() if held in line]
    assert [line.split(" rad")[-1] for line in started] == [", and lets them go", ", and lets right go", ""]
