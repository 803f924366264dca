"""Results as CSV where a name ends so: the numbers of the HDF5 files, units in the first line; others are refused."""

import csv
import os
import re
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import synthetic
import warm_start
from conftest import MPI_ENVIRONMENT, ROOT, TIMEOUT_SECONDS
from runs import PGMP, SMALL, paper_scene, rom_of, said

import pgmp_petsc as pgmp
from pgmp_petsc.cli.declared import painter
from pgmp_petsc.cli.main import main
from pgmp_petsc.results.summary import columns_of

TEMPLATE = ROOT / "pgmp_petsc" / "scene" / "templates" / "slider_crank.toml"


@pytest.fixture(scope="module")
def rom(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tables") / "rom.h5"
    rom_of(paper_scene(*SMALL, "ensemble.extremes=true")).write(path)
    return path


def table(path: Path) -> dict[str, list[str]]:
    """Return the columns of a CSV file by the words of its first line."""
    with open(path, encoding="utf-8", newline="") as stream:
        head, *rows = csv.reader(stream)
    return dict(zip(head, map(list, zip(*rows))))


def test_a_run_as_a_table(rom: Path, tmp_path: Path) -> None:
    out, _ = said("simulate", rom, "-o", tmp_path / "run.csv")
    assert "rows and columns alone; a file *.h5 has the scene" in out
    said("simulate", rom, "-o", tmp_path / "run.h5", "--quiet")
    found = table(tmp_path / "run.csv")
    assert list(found) == ["time (s)", "crank_angle (rad)", "slider_position (m)", "slider_deformation (m)"]
    with h5py.File(tmp_path / "run.h5") as file:
        np.testing.assert_array_equal(np.array(found["time (s)"], float), file["time"][()])
        for name in ("crank_angle (rad)", "slider_deformation (m)"):
            stored = file[f"outputs/{name.partition(' ')[0]}"][()]
            np.testing.assert_array_equal(np.array(found[name], float), stored)
    # a file that is there gives the same table
    out, _ = said("export", tmp_path / "run.h5", "-o", tmp_path / "again.csv")
    assert out.startswith(f"{tmp_path / 'again.csv'}: 51 rows, 4 columns")
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "run.csv").read_bytes()


def test_samples_and_derivatives_as_tables(rom: Path, tmp_path: Path) -> None:
    said("montecarlo", rom, "-n", 6, "-o", tmp_path / "many.csv", "--quiet")
    said("montecarlo", rom, "-n", 6, "-o", tmp_path / "many.h5", "--quiet")
    found = table(tmp_path / "many.csv")
    assert {"sample", "status", "r1 (m)", "crank_angle (rad)", "slider_deformation.time_of_max (s)"} <= found.keys()
    with h5py.File(tmp_path / "many.h5") as file:
        np.testing.assert_array_equal(np.array(found["r1 (m)"], float), file["parameters/r1"][()])
        np.testing.assert_array_equal(np.array(found["crank_angle (rad)"], float), file["outputs/crank_angle"][()])
        largest = np.array(found["slider_deformation.max (m)"], float)
        np.testing.assert_array_equal(largest, file["extremes/slider_deformation/max"][()])
    assert not list(tmp_path.glob("*.partial"))
    said("sensitivities", rom, "-o", tmp_path / "slopes.csv", "--quiet")
    found = table(tmp_path / "slopes.csv")
    assert "d crank_angle / d r1 (rad/m)" in found and len(found["time (s)"]) == 51


def test_frequencies_and_settings_as_tables(tmp_path: Path) -> None:
    modes, study = synthetic.modes_table(n_theta=5), synthetic.tradeoff()
    modes.write(tmp_path / "modes.h5")
    study.write(tmp_path / "study.h5")
    for name in ("modes", "study"):
        said("export", tmp_path / f"{name}.h5", "-o", tmp_path / f"{name}.csv")
    found = table(tmp_path / "modes.csv")
    assert list(found)[:2] == ["theta (rad)", "full.1 (Hz)"] and "reduced.6 (Hz)" in found
    np.testing.assert_array_equal(np.array(found["full.2 (Hz)"], float), modes.full_hz[:, 1])
    assert table(tmp_path / "study.csv")["setting"] == [study.name(row) for row in range(len(study.families))]


def test_what_has_no_columns_is_no_table() -> None:
    with pytest.raises(TypeError, match="list has no table"):
        columns_of([])


def test_results_of_a_program(tmp_path: Path) -> None:
    synthetic.trajectory(n_times=4, n_frames=0).write(tmp_path / "run.h5")
    result = pgmp.read(tmp_path / "run.h5")
    result.write(tmp_path / "run.csv")
    assert len(table(tmp_path / "run.csv")["time (s)"]) == 4
    assert result.path == tmp_path / "run.h5"  # of a table nothing can be read again


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("build", "SCENE", "-o", "x.csv"), "the ending .csv is that of another format; a reduced model is written as"),
        (("montecarlo", "ROM", "-n", 4, "--shard", "1/2", "-o", "x.csv"), "a shard of an ensemble is written as HDF5"),
        (("montecarlo", "ROM", "-n", 500, "--rare", "crank_angle < 1", "-o", "x.csv"), "a rare event is written as"),
        (("simulate", "ROM", "-o", "mine.csv"), "exists, and nothing in a CSV file says whose it is; give another"),
        (("export", "ROM", "-o", "x.csv"), "has no rows and columns; a table can be made of a trajectory, an"),
        (("export", "run.h5", "-o", "mine.csv"), "exists, and nothing in a CSV file says whose it is"),
        (("export", "run.h5", "-o", "x.csv", "--set", "r1=5e-3"), "are for the export of a model"),
        (("export", "none.h5", "-o", "x.csv"), "does not exist"),
        (("schema", "-o", "x.toml"), "a schema is JSON for editors or a page in Markdown; name it"),
        (("schema", "-o", "."), "output '.' is a directory; give the name of a file in it, FILE.json or FILE.md"),
        (("schema", "-o", "/"), "output '/' is a directory"),
        (("new", "arm", "."), "scene file '.' is a directory; give the name of a file in it, FILE.toml"),
        (("schema", "-o", "mine.json"), "exists and is not a JSON schema of scenes of this program"),
        (("schema", "-o", "mine.md"), "exists and is not a page of all entries of scenes of this program"),
    ],
)
def test_refusals(rom: Path, tmp_path: Path, arguments: tuple, message: str, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("mine.csv", "mine.json", "mine.md"):
        Path(name).write_text("time (s)\n0.0\n")
    synthetic.trajectory(n_times=4, n_frames=0).write("run.h5")
    places = {"ROM": rom, "SCENE": Path(__file__).resolve().parents[2] / "scenes" / "slider_crank.toml"}
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    out, err = said(*(places.get(word, word) for word in arguments), status=2)
    assert message in err and err.count("\n") == 1
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_the_schema_is_written(tmp_path: Path) -> None:
    for _ in range(2):  # an older one is replaced
        out, _ = said("schema", "-o", tmp_path / "scene.schema.json")
        assert '"#:schema scene.schema.json"' in out
    said("schema", "-o", tmp_path / "entries.md")
    assert (tmp_path / "entries.md").read_text(encoding="utf-8").startswith("# All entries of a scene")
    out, _ = said("schema")
    assert out == (tmp_path / "scene.schema.json").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("words", "number", "wanted", "unwanted"),
    [
        ("pgmp s", 1, {"simulate", "sensitivities", "schema"}, {"build", "new"}),
        ("pgmp simulate --c", 2, {"--components"}, {"--full"}),
        ("pgmp new s", 2, {"slider_crank", "solid_link", "spatial"}, {"four_bar"}),
        (f"pgmp check {TEMPLATE} --set r", 4, {"radius="}, {"motor="}),
        (f"pgmp check {__file__} --set r", 4, set(), {"radius="}),
        ("pgmp check odd.toml --set r", 4, set(), {"r="}),
    ],
)
def test_the_shell_completes(words: str, number: int, wanted: set, unwanted: set, monkeypatch, capfd, tmp_path) -> None:
    """What bash asks (docs/first_steps.md), and what it is told; nothing is run for it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "odd.toml").write_text("[parameters]\nr = 1.0\n")
    monkeypatch.setenv("_PGMP_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(number))
    with pytest.raises(SystemExit, match="0"):
        main([])
    out, err = capfd.readouterr()  # click writes bytes
    told = {line.partition(",")[2] for line in out.splitlines()}
    assert wanted <= told and not unwanted & told and err == ""


TERMINAL = """
import fcntl, os, pty, struct, sys, termios
child, terminal = pty.fork()
if not child:
    fcntl.ioctl(1, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 80, 0, 0))
    os.execv(sys.argv[1], sys.argv[1:])
try:
    while seen := os.read(terminal, 65536):
        sys.stdout.buffer.write(seen)
except OSError:
    pass
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


def at_terminal(folder: Path, *words: object, status: int = 0, **variables: str) -> str:
    """Return what a person sees in a folder at a terminal of 80 columns."""
    surroundings = {"TERM": "xterm"} | os.environ | MPI_ENVIRONMENT | {"PYTHONPATH": str(ROOT)} | variables
    if not variables:
        surroundings.pop("NO_COLOR", None)
    command = [sys.executable, "-c", TERMINAL, *warm_start.python(surroundings), *PGMP, *map(str, words)]
    done = subprocess.run(command, capture_output=True, env=surroundings, cwd=folder, timeout=TIMEOUT_SECONDS)
    assert done.returncode == status, done
    return done.stdout.decode().replace("\r\n", "\n")


def test_a_terminal_shows_the_answer_and_what_to_do_next(rom: Path, tmp_path: Path) -> None:
    """In colour and within its width; a pipe has all figures, without colours and without advice."""
    words = ("montecarlo", rom, "-n", 8, "-o", "m.h5")
    seen = at_terminal(tmp_path, *words)
    lines = re.split(r"[\n\r]+", re.sub(r"\x1b\[\d*\w", "", seen.rstrip()))
    answer = next(k for k, line in enumerate(lines) if line.startswith("m.h5: reduced model, 8 samples; mean "))
    assert lines[-1] == "next: pgmp report m.h5 -o report.html"
    assert "more lines of figures and notes: --verbose" in lines[-2] and len(lines) - answer < 20
    assert "  quantiles at the end" not in seen
    assert "  quantiles at the end" in at_terminal(tmp_path, *words, "--verbose")
    assert max(len(line) for line in lines[answer:]) <= 80
    out, _ = said(*words[:-1], tmp_path / "m.h5")
    assert "quantiles at the end" in out and "next:" not in out and "\x1b" not in out
    refused = ("simulate", rom, "--set", "r1=1000")
    assert "\x1b[31m\x1b[1mpgmp: error:\x1b[0m " in at_terminal(tmp_path, *refused, status=2)
    assert "\x1b[31m" not in at_terminal(tmp_path, *refused, status=2, NO_COLOR="1")


@pytest.mark.parametrize(
    ("text", "look"),
    [
        ("  warning: far off", "\x1b[33m  warning:\x1b[0m far off"),
        ("m.h5: P(x above 1) = 5 % [4, 6], more", "m.h5: \x1b[32mP(x above 1) = 5 % [4, 6]\x1b[0m, more"),
        ("P(x) is not decided by this model: no", "P(x) is \x1b[33mnot decided by this model\x1b[0m: no"),
        ("8 samples, 0 failed", "8 samples, 0 failed"),
        ("8 samples, 10 failed", "8 samples, \x1b[33m10 failed\x1b[0m"),
    ],
)
def test_warnings_and_verdicts_have_colours(text: str, look: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    assert painter(True)(text.encode()).decode() == look and painter(False) is None
