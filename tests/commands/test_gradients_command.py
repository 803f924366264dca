"""pgmp sensitivities, fit and optimize: files, messages and pictures, the same on one rank and on two."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from runs import in_turn, paper_scene, pgmp, refused, rom_of

from pgmp_petsc.api.files import contents, describe
from pgmp_petsc.figures.collection import draw
from pgmp_petsc.results import Derivatives, Design, Fit
from pgmp_petsc.results.gradients import DEVIATION, PERCENT

SCENE = paper_scene(
    "reduction.modes=4", "reduction.angles=24", "simulation.duration=0.06", "simulation.step=1e-3",
    "parameters.push={nominal=1.0, bounds=[0.5, 2.0]}", 'effects.motor.scale="push"',
    "effects.motor.table=[[0.0, 0.0], [0.02, 2.0], [1.0, 2.0]]",
)  # fmt: skip
TRUE = {"r1": 6e-3, "push": 1.2}
GOAL, KEPT = "minimise max(abs(slider_deformation))", "end(crank_angle) >= 0.01"
ASKED = {
    "sensitivities": ["-o", "sensitivities.h5", "--plot", "pictures"],
    "fit": ["measured.csv", "--parameter", "r1", "--parameter", "push", "-o", "fit.h5", "--plot", "pictures"],
    "optimize": [
        GOAL, "--subject-to", KEPT, "--parameter", "r1", "--robust", "2", "--samples", "5", "-o", "design.h5",
        "--plot", "pictures",
    ],
}  # fmt: skip
BAD = {
    ("sensitivities", "--parameter", "r2"): "--parameter r2: there is no such parameter",
    ("fit", "empty.csv"): "there are no measurements in it",
    ("fit", "measured.csv", "--noise", "crank_angle"): "--noise crank_angle: OUTPUT=NUMBER with a positive number is",
    ("fit", "measured.csv", "--noise", "angle=1"): "--noise angle: it is no column of the history; did you mean",
    ("fit", "short.csv"): "the history has 1 measurements for 1 parameters (r1); more are needed than parameters",
    ("sensitivities", "--plot", "measured.csv"): "measured.csv' is no directory; give another name",
    ("sensitivities", "-o", "both.h5", "--plot", "both.h5"): "output directory 'both.h5' is the output file too; give",
    ("fit", "measured.csv", "--plot", "empty.csv/deeper/pictures"): "/empty.csv' is no directory; give another name",
    ("optimize", "minimise r1", "--plot", "/dev/null"): "directory '/dev/null' cannot be made: '/dev/null' is no",
    ("optimize", "minimise r1", "--plot", "fit.PNG"): "output directory 'fit.PNG' has the ending of a file; give a",
    ("optimize", "minimise r1", "--samples", "4"): "--samples 4: for figures over samples; give --robust K too",
    ("optimize", "minimise r1", "--seed", "3", "--samples", "5"): "--samples 5 and --seed 3: for figures over samples",
    ("optimize", "minimise r1", "--robust", "nan"): "'nan' is not a number in the range x>=0.0",
    ("optimize", "minimise r3"): "goal: there is no parameter, figure, function or unit of a number 'r3'",
    ("optimize", "minimise r1", "--subject-to", "r1"): "--subject-to: <= or >= is needed",
}


def folder_with(path: Path) -> Path:
    """Return a folder with a reduced model and measured histories."""
    rom_of(SCENE).write(path / "rom.h5")
    true = [word for name, value in TRUE.items() for word in ("--set", f"{name}={value}")]
    pgmp("simulate", path / "rom.h5", *true, "-o", path / "true.h5")
    with h5py.File(path / "true.h5") as file:
        time, angle, bend = (file[name][::3] for name in ("time", "outputs/crank_angle", "outputs/slider_deformation"))
    random = np.random.default_rng(1)
    angle = angle + 1e-4 * random.normal(size=angle.size)
    bend = bend + 1e-7 * random.normal(size=bend.size)
    lines = ["time,crank_angle,slider_deformation", *(f"{t},{a},{b}" for t, a, b in zip(time, angle, bend))]
    (path / "measured.csv").write_text("\n".join(lines), encoding="utf-8")
    (path / "empty.csv").write_text(lines[0], encoding="utf-8")
    (path / "short.csv").write_text("time,crank_angle\n0.01,0.0\n", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return folder_with(tmp_path_factory.mktemp("gradients"))


@pytest.fixture(scope="module")
def made(source: Path, tmp_path_factory) -> Callable[[int], tuple[Path, str]]:
    """Return a function that gives results and terminal output of all commands on a number of ranks."""
    known: dict[int, tuple[Path, str]] = {}

    def of(n: int) -> tuple[Path, str]:
        if n not in known:
            folder = tmp_path_factory.mktemp(f"ranks_{n}")
            places = {"measured.csv": source, "pictures": folder}
            wanted = []
            for command, options in ASKED.items():
                # pictures are rank 0's, whose libraries take their time
                options = options if n == 1 else options[: options.index("--plot")]
                files = {word for word in options if word.endswith((".h5", ".csv")) or word in places}
                own = [str(places.get(word, folder) / word) if word in files else word for word in options]
                wanted.append([command, str(source / "rom.h5"), *own])
            statuses, done = in_turn(n, wanted)
            assert statuses == [[0] * n] * len(ASKED), f"{done.stdout}\n{done.stderr}"
            known[n] = folder, done.stdout
        return known[n]

    return of


def test_sensitivities_are_in_file_terminal_and_picture(made: Callable) -> None:
    folder, said = made(1)
    found = Derivatives.read(folder / "sensitivities.h5")
    assert found.parameters == ("r1", "push")
    assert {name: what for name, (_, what) in found.changes.items()} == {"r1": DEVIATION, "push": PERCENT}
    # the bounds are eight deviations away
    assert found.changes["r1"][0] == pytest.approx(0.56e-3, rel=1e-9)
    assert found.unit("crank_angle", "r1") == "rad/m"
    assert "what a change of each parameter does" in said and "one standard deviation" in said
    first = next(line.split() for line in said.splitlines() if "at the end" in line)
    assert first[4] == f"{found.outputs['crank_angle'][-1]:.6g}" and first[5] == first[8] == "rad"
    with h5py.File(folder / "sensitivities.h5") as file:
        largest = file["extremes/crank_angle/max_derivatives"][()]
        at = np.argmax(file["outputs/crank_angle"])
        assert largest.tolist() == [file[f"derivatives/crank_angle/{name}"][at] for name in found.parameters]
    assert sorted(path.name for path in (folder / "pictures").iterdir()) == [
        "design.png", "fit.png", "sensitivities.png",
    ]  # fmt: skip


def test_a_fit_recovers_what_was_hidden(made: Callable) -> None:
    folder, said = made(1)
    found = Fit.read(folder / "fit.h5")
    for parameter in found.parameters:
        assert abs(parameter.estimate - TRUE[parameter.name]) < 4.0 * parameter.error
        assert found.record.parameters[parameter.name] == parameter.estimate
    assert "standard error" in said


def test_a_design_meets_its_constraint(made: Callable) -> None:
    folder, said = made(1)
    found = Design.read(folder / "design.h5")
    assert found.deviations == 2.0 and found.n_samples == 5 and found.record.seed == 1
    assert found.constraints[0].text == KEPT and found.constraints[0].value <= 1e-8
    assert found.goal_value < found.goal_start
    assert KEPT in said and GOAL in said


@pytest.mark.parametrize("name", ["sensitivities.h5", "fit.h5", "design.h5"])
def test_two_ranks_give_what_one_gives(made: Callable, name: str) -> None:
    one, two = (made(n)[0] / name for n in (1, 2))
    with h5py.File(one) as a, h5py.File(two) as b:
        names: list[str] = []
        a.visititems(lambda path, item: names.append(path) if isinstance(item, h5py.Dataset) else None)
        for path in names:
            if not path.startswith("timings"):
                np.testing.assert_array_equal(a[path][()], b[path][()], err_msg=path)


def test_what_a_file_holds_is_said_again_and_drawn_again(made: Callable, tmp_path: Path, undrawn: None) -> None:
    folder, said = made(1)
    told = [line.strip() for line in said.splitlines() if "crank_angle" in line and "left of" in line]
    assert told and told[0] in describe(contents(folder / "fit.h5"))
    assert KEPT in describe(contents(folder / "design.h5"))
    assert "what a change of each parameter does" in describe(contents(folder / "sensitivities.h5"))
    draw([folder / f"{name}.h5" for name in ("sensitivities", "fit", "design")], tmp_path)
    assert len(list(tmp_path.glob("*.png"))) == 3


def test_a_tolerance_chooses_the_step_first(source: Path) -> None:
    tolerance = "simulation.tolerance=0.2"
    said = pgmp("sensitivities", source / "rom.h5", "--parameter", "r1", "--override", tolerance).stdout
    first, table, *_ = said.splitlines()
    step = float(first.split("simulation.step = ")[1].split(" was chosen")[0])
    n_steps = int(table.split(" steps")[0].split()[-1])
    # the step is written with three digits
    assert step != SCENE.simulation.step and n_steps * step == pytest.approx(SCENE.simulation.duration, abs=step)


def test_bad_input_is_one_message(source: Path) -> None:
    wanted = []
    for command, *options in BAD:
        own = [source / word if ".csv" in word else word for word in options]
        wanted.append([command, source / "rom.h5", *own])
    for said, message in zip(BAD.values(), refused(1, wanted)):
        assert said in message
