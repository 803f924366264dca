"""The frame of the commands: exit status, who prints what, options for PETSc; on one rank and on three."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest
import synthetic
from conftest import TIMEOUT_SECONDS

from pgmp_petsc.cli.main import split_arguments

RANKS = (1, 3)
PGMP = ("-m", "pgmp_petsc.cli.main")


@pytest.fixture
def run(mpirun, parallel_scripts):
    """Return a function that runs the test's commands on n ranks."""

    def run_command(n: int, *arguments: object, check_status: int = 0) -> subprocess.CompletedProcess[str]:
        return mpirun(n, parallel_scripts / "commands.py", *arguments, check_status=check_status)

    return run_command


def messages(done: subprocess.CompletedProcess[str]) -> list[str]:
    """Return the lines of stderr that pgmp wrote, not mpirun."""
    return [line for line in done.stderr.splitlines() if "pgmp: " in line]


def test_arguments_are_split_at_the_first_bare_dashes():
    assert split_arguments(["a", "--b", "--", "-c", "--", "d"]) == (["a", "--b"], ["-c", "--", "d"])
    assert split_arguments(["a"]) == (["a"], [])


@pytest.mark.parametrize("n", RANKS)
def test_rank_0_alone_prints(run, n):
    done = run(n, "fine")
    assert done.stdout.splitlines() == ["said", "printed"]
    assert done.stderr == ""


@pytest.mark.parametrize("n", RANKS)
@pytest.mark.parametrize("arguments", [(), ("--help",), ("info", "--help"), ("--version",)])
def test_help_is_printed_once(run, n, arguments):
    done = run(n, *arguments)
    assert done.stdout.count("Usage: pgmp") + done.stdout.count("pgmp, version") == 1
    assert done.stderr == ""


@pytest.mark.parametrize("n", RANKS)
@pytest.mark.parametrize(
    ("command", "status", "message"),
    [
        ("agreeing", 2, "bodies.rod.mesh: not found"),
        ("failing", 1, "no convergence"),
        ("inof", 2, "no command 'inof'; did you mean 'info'? (see 'pgmp --help')"),
        ("xyzzy", 2, None),
        ("info --scen f.h5", 2, "no option '--scen'; did you mean '--scene'? (see 'pgmp info --help')"),
        ("info", 2, "Missing argument 'FILE' (see 'pgmp info --help')"),
        ("info no.h5", 2, None),
        ("fine -- -options_left", 2, None),
        ("options", 2, "Missing option '-o' / '--output' (see 'pgmp options --help')"),
    ],
)
def test_an_error_is_one_message_and_a_status(run, n, command, status, message):
    done = run(n, *command.split(), check_status=status)
    lines = messages(done)
    assert len(lines) == 1 and lines[0].startswith("pgmp: error: ")
    assert message is None or lines[0] == f"pgmp: error: {message}"
    assert done.stdout == "" and "Traceback" not in done.stderr


def test_unknown_names_list_the_known_ones(run):
    assert "; known: agreeing, alone, " in messages(run(1, "xyzzy", check_status=2))[0]


@pytest.mark.parametrize("n", RANKS)
def test_a_status_without_message(run, n):
    assert messages(run(n, "some_failed", check_status=1)) == []


@pytest.mark.parametrize("n", RANKS)
def test_an_unexpected_exception_shows_its_traceback_and_ends_all_ranks(run, n):
    done = run(n, "crashing", check_status=1)
    assert done.stderr.count("Traceback") == 1
    assert "ZeroDivisionError: a mistake" in done.stderr


def test_a_failure_that_was_not_agreed_on_does_not_hang(run):
    done = run(3, "alone", check_status=2)
    assert messages(done) == ["pgmp: error: rank 2 failed alone: known to one rank"]


@pytest.mark.parametrize("n", RANKS)
def test_an_interrupted_run(run, n):
    done = run(n, "interrupted", check_status=130)
    assert "pgmp: interrupted" in done.stderr


@pytest.mark.parametrize("n", RANKS)
def test_options_after_the_dashes_reach_petsc(run, n):
    done = run(n, "petsc", "--", "-pgmp_modes_eps_tol", "1e-9", "-flag", "1")
    assert done.stdout.strip() == "[('flag', '1'), ('pgmp_modes_eps_tol', '1e-9')]"


def test_options_for_petsc_where_it_is_not_used(run):
    done = run(1, "fine", "--", "-log_view", check_status=2)
    assert "'fine' does not use PETSc, but was given PETSc options after '--': -log_view" in done.stderr


def test_commands_that_do_not_need_petsc_do_not_import_it(run):
    assert run(1, "modules").stdout.strip() == "petsc4py imported: False"


def test_shared_options(run):
    settings = ("--set", "r1=5e-3", "--set", "a=1", "--override", 'scene.name="a=b"')
    done = run(1, "options", "-o", "f.h5", *settings)
    assert done.stdout.strip() == "('r1=5e-3', 'a=1') ('scene.name=\"a=b\"',) f.h5"


@pytest.mark.parametrize("n", RANKS)
def test_info_describes_a_file(mpirun, n, tmp_path):
    synthetic.trajectory("reduced", n_frames=4).write(tmp_path / "t.h5")
    lines = mpirun(n, *PGMP, "info", tmp_path / "t.h5").stdout.splitlines()
    text = "\n".join(lines)
    assert lines[0].endswith("t.h5: trajectory of the reduced model")
    for expected in ("by pgmp", "slider_crank", "r1 = 0.0056", "seed       none", "ranks      2", "1.250 s"):
        assert text.count(expected) == 1
    assert "/frames/points/<4 frames>" in text and "00001" not in text
    assert any(line.split()[:5] == ["/state/coordinates", "1001", "x", "1", "rad"] for line in lines)


def test_info_prints_the_scene(mpirun, tmp_path):
    synthetic.ensemble("full", 20).write(tmp_path / "e.h5")
    assert mpirun(1, *PGMP, "info", "--scene", tmp_path / "e.h5").stdout == synthetic.SCENE.rstrip() + "\n"
    described = mpirun(1, *PGMP, "info", tmp_path / "e.h5").stdout
    assert "seed       1\n" in described and "/statistics/crank_angle/mean" in described


@pytest.mark.parametrize("n", RANKS)
def test_plot_and_export(mpirun, n, tmp_path):
    synthetic.trajectory(n_frames=4).write(tmp_path / "t.h5")
    done = mpirun(n, *PGMP, "plot", tmp_path / "t.h5", "-o", tmp_path / "out", "--exaggerate", "5")
    pictures = [str(tmp_path / "out" / name) for name in ("trajectories.png", "mechanism.png")]
    assert done.stdout.splitlines() == pictures
    done = mpirun(n, *PGMP, "export", tmp_path / "t.h5", "-o", tmp_path / "t.xdmf")
    assert done.stdout.strip().endswith(f"4 frames, stored in {tmp_path / 't.h5'}")
    assert (tmp_path / "t.xdmf").exists()


def test_a_reader_that_has_gone_is_no_traceback(tmp_path):
    synthetic.ensemble("full", 20).write(tmp_path / "e.h5")
    process = subprocess.Popen(
        [sys.executable, *PGMP, "info", str(tmp_path / "e.h5")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    process.stdout.close()
    stderr = process.stderr.read()
    process.stderr.close()
    process.wait(timeout=TIMEOUT_SECONDS)
    assert b"Traceback" not in stderr


def test_without_mpirun_an_interrupt_is_status_130(parallel_scripts):
    code = (
        "import os, signal, time\n"
        "from pgmp_petsc.cli import main, info\n"
        # a shell that runs the tests in the background lets its children ignore interrupts
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "info.describe = lambda path: (os.kill(os.getpid(), signal.SIGINT), time.sleep(60))\n"
        "main.main(['info', 'f.h5'])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=TIMEOUT_SECONDS)
    assert done.returncode == 130 != -signal.SIGINT
    assert done.stderr.strip() == "pgmp: interrupted"


@pytest.mark.parametrize("n", RANKS)
def test_what_petsc_still_holds_is_let_go_while_python_lives(mpirun, parallel_scripts, n):
    mpirun(n, parallel_scripts / "left_behind.py", "closed")


def test_without_that_the_end_of_petsc_may_crash(mpirun, parallel_scripts):
    """Once this fails, PETSc does it itself, and `release_petsc` has no use any more."""
    assert mpirun(1, parallel_scripts / "left_behind.py", "open", check_status=None).returncode != 0
