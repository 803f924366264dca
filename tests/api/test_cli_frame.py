"""The frame of the commands: exit status, who prints what, options for PETSc; on one rank and on three."""

import json
import os
import re
import subprocess
import sys
from importlib import metadata

import pytest
import synthetic
from conftest import PGMP, ROOT, SCRIPTS, run_mpi

from pgmp_petsc.cli.main import split_arguments
from pgmp_petsc.ranks.petsc import ALONE, OF_RANKS, PREFIXES, option_names

RANKS = (1, 3)


def run(n: int, *arguments: object, check_status: int = 0) -> subprocess.CompletedProcess[str]:
    """Run the test's commands on n ranks."""
    return run_mpi(n, SCRIPTS / "commands.py", *arguments, check_status=check_status)


def messages(done: subprocess.CompletedProcess[str]) -> list[str]:
    """Return the lines of stderr that pgmp wrote, not mpirun."""
    return [line for line in done.stderr.splitlines() if "pgmp: " in line]


def test_arguments_are_split_at_the_first_bare_dashes():
    assert split_arguments(["a", "--b", "--", "-c", "--", "d"]) == (["a", "--b"], ["-c", "--", "d"])
    assert split_arguments(["a"]) == (["a"], [])


# commands in one start, their status and how their only message begins; None where there is none
HELPS = ("", "--help", "info --help", "--version")
ENDINGS = {
    "some_failed": (1, None),
    "agreeing": (2, "bodies.rod.mesh: not found"),
    "failing": (1, "no convergence"),
    "inof": (2, "no command 'inof'; did you mean 'info'? (see 'pgmp --help')"),
    "xyzzy": (2, "no command 'xyzzy'; known: agreeing, alone, "),
    "--quiet info f.h5": (
        2,
        "no option '--quiet'; known: --help, --version; options of a command go behind its name (see 'pgmp --help')",
    ),
    "info --scen f.h5": (2, "no option '--scen'; did you mean '--scene'? (see 'pgmp info --help')"),
    "info": (2, "Missing argument 'FILE' (see 'pgmp info --help')"),
    "modes s.toml -o m.h5 --angles 1e3": (2, "Invalid value for '--angles': '1e3' is not a whole number"),
    "animate f.h5 -o f.gif --fps fast": (2, "Invalid value for '--fps': 'fast' is not a number in the range"),
    "plot f.h5 -o d --exaggerate nan": (2, "Invalid value for '--exaggerate': 'nan' is not a number in the range"),
    "info no.h5": (2, ""),
    "export rom.h5 --output=": (2, "Invalid value for '-o' / '--output': it is empty; a name is needed, or . for"),
    "montecarlo rom.h5 -o e.h5 --samples=": (2, "Invalid value for '--samples': it is empty; a name is needed"),
    "fine -- -options_left": (2, ""),
    "fine -- -log_view": (2, "'fine' does not use PETSc, but was given PETSc options after '--': -log_view"),
    "solving -- eps_tol 1": (2, "after '--': 'eps_tol' is no option of PETSc; they begin with '-' and take one value"),
    "solving -- -eps_tol 1 2": (2, "after '--': '2' is no option of PETSc; they begin with '-' and take one value"),
    "options": (2, "Missing option '-o' / '--output' (see 'pgmp options --help')"),
}
# what is no error of this program's, on a rank alone
OF_SYSTEM = {
    "refused memory": (1, "not enough memory: 16 GiB; take a smaller problem or more ranks on more nodes"),
    "refused permission": (1, "/data/x: Permission denied"),
    "refused nesting": (1, "something is nested too deeply to be worked on"),
    "refused text": (1, "a text or a name is not valid in its encoding: "),
}
OPTIONS = "options -o f.h5 --set r1=5e-3 --set a=1 --override scene.name=a=b"


@pytest.fixture(scope="module", params=RANKS)
def told(request):
    """Return what every command came to on all ranks, in one start: status, standard output, standard error."""
    commands = [*HELPS, "fine", *ENDINGS, *(OF_SYSTEM if request.param == 1 else ()), OPTIONS]
    words = json.dumps([command.split() for command in commands])
    lines = run_mpi(request.param, SCRIPTS / "commands.py", "each", words).stdout.splitlines()
    return {command: json.loads(line) for command, line in zip(commands, lines, strict=True)}


def test_rank_0_alone_prints(told):
    (first, *others) = told["fine"]
    assert first == [0, "said\nprinted\n", ""] and all(other == [0, "", ""] for other in others)


def test_commands_that_do_not_need_petsc_do_not_import_it():
    assert run(1, "modules").stdout.strip() == "petsc4py imported: False"


@pytest.mark.parametrize("command", HELPS)
def test_help_is_printed_once(told, command):
    out = "".join(out for _, out, _ in told[command])
    assert out.count("Usage: pgmp") + out.count("pgmp, version") == 1
    assert all((status, err) == (0, "") for status, _, err in told[command])


@pytest.mark.parametrize("command", [*ENDINGS, *OF_SYSTEM])
def test_an_error_is_one_message_and_a_status(told, command):
    if command not in told:
        return
    status, message = (ENDINGS | OF_SYSTEM)[command]
    assert all(ended == status and out == "" for ended, out, _ in told[command])
    lines = [line for _, _, err in told[command] for line in err.splitlines()]
    assert len(lines) == (message is not None) and all(line.startswith(f"pgmp: error: {message}") for line in lines)


def test_shared_options(told):
    assert told[OPTIONS][0] == [0, "('r1=5e-3', 'a=1') ('scene.name=a=b',) f.h5\n", ""]


@pytest.mark.parametrize("n", RANKS)
def test_an_unexpected_exception_shows_its_traceback_and_ends_all_ranks(n):
    done = run(n, "crashing", check_status=1)
    assert done.stderr.count("Traceback") == 1
    assert "ZeroDivisionError: a mistake" in done.stderr


def test_open_mpi_can_be_told_to_add_nothing_to_the_message(monkeypatch):
    """What docs/hpc.md says of mpirun's own lines."""
    loud = run(3, "agreeing", check_status=2).stderr
    assert loud.index("pgmp: error: bodies.rod.mesh") < loud.index("mpirun detected that one or more processes exited")
    monkeypatch.setenv("OMPI_MCA_orte_execute_quiet", "1")
    assert run(3, "agreeing", check_status=2).stderr == "pgmp: error: bodies.rod.mesh: not found\n"


def test_a_failure_that_was_not_agreed_on_does_not_hang():
    done = run(3, "alone", check_status=2)
    first, *others = messages(done)
    # mpirun writes a line of dashes, which may come before the end of this one
    assert first.rstrip("-") == "pgmp: error: rank 2 failed alone: known to one rank"
    # mpirun then ends the others with SIGTERM, and the first rank may still have the time to say what is kept
    assert all(line.startswith("pgmp: stopped by SIGTERM: ") for line in others)


@pytest.mark.parametrize("n", RANKS)
def test_an_interrupted_run(n):
    done = run(n, "interrupted", check_status=130)
    assert "pgmp: interrupted" in done.stderr


def test_options_after_the_dashes_reach_petsc():
    done = run(3, "petsc", "--", "-pgmp_modes_eps_tol", "1e-9", "-flag", "1")
    assert done.stdout.strip() == "[('flag', '1'), ('options_left', 'no'), ('pgmp_modes_eps_tol', '1e-9')]"


@pytest.mark.parametrize("n", RANKS)
def test_options_that_nothing_used_are_named(n):
    """Those of PETSc itself, which it reads when it ends (several ranks then time their messages, for 15 s), and those
    that one rank alone used are not."""
    given = ("-eps_tol", "1e-3", "-pgmp_ts_used", "-2", "-pgmp_modes_x")
    done = run(n, "using", "--", *given, *(("-log_view", ":/dev/null") if n == 1 else ()))
    line = "pgmp: warning: PETSc options that nothing used: -eps_tol -pgmp_modes_x; prefixes here: pgmp_modes_, "
    assert [message[: len(line)] for message in messages(done)] == [line]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("-malloc_debug", "maybe"), "options after '--': PETSc does not start with -malloc_debug maybe: Invalid"),
        (("-pgmp_ts_ksp_type", "x"), "PETSc options -pgmp_ts_ksp_type x: Unable to find requested KSP type x"),
        (("-pgmp_ts_ksp_rtol", "x"), "PETSc options -pgmp_ts_ksp_rtol x: Input string x has no numeric value"),
    ],
)
def test_a_wrong_option_for_petsc_is_one_message(given, message):
    done = run(3, "solving", "--", *given, check_status=2)
    (line,) = messages(done)
    assert line.startswith(f"pgmp: error: {message}")
    assert "PETSC ERROR" not in done.stderr and "Traceback" not in done.stderr


def test_names_of_options_are_those_that_petsc_stores():
    given = "-a 1 --b -1e-3 -c -prefix_push x_ -d 2 -prefix_pop -e -inf".split()
    assert option_names(given) == ["a", "b", "c", "x_d", "e"]


def test_every_prefix_is_listed():
    """In the table of the messages, and in the document."""
    found = set()
    for path in (ROOT / "pgmp_petsc").rglob("*.py"):
        found |= set(re.findall(r'^\w*PREFIX = "(.*)"', path.read_text(encoding="utf-8"), re.MULTILINE))
    assert found == set(PREFIXES)
    text = (ROOT / "docs" / "petsc_options.md").read_text(encoding="utf-8")
    assert all(f"| `{prefix}` |" in text for prefix in PREFIXES)


@pytest.mark.parametrize(("given", "daemons", "turns"), [({}, 0, 0), ({"SLURM_JOB_ID": "1"}, 1, 1)])
def test_a_process_alone_starts_no_daemon(tmp_path, given, daemons, turns):
    """In a batch job it may be one of several; what it starts itself is not told that it is alone.

    Nor does it make a folder: processes that are alone would share it, and one that ends would take it from others. It
    gives no turns away while it looks for messages, also where that is set for ranks.
    """
    script = (
        "import os, sys; from pgmp_petsc.ranks.petsc import ALONE, TURNS, start_mpi; (turns,), seen = TURNS, set()\n"
        "sys.addaudithook(lambda what, of: (what, of[0]) == ('import', 'mpi4py.MPI') and seen.add(os.environ[turns]))\n"
        "size = start_mpi().size\n"
        "children = open(f'/proc/self/task/{os.getpid()}/children').read().split()\n"
        "made = os.listdir(os.environ['TMPDIR'])\n"
        "left = [name for name in ALONE if name in os.environ]\n"
        "print(size, len(children), len(made), *seen, os.environ[turns], left)"
    )
    given = given | {"TMPDIR": str(tmp_path), "OMPI_MCA_mpi_yield_when_idle": "1"}
    # a test process that itself started MPI passes names on
    environment = {name: value for name, value in os.environ.items() if name not in (*OF_RANKS, *ALONE)} | given
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment, check=True)
    assert done.stdout == f"1 {daemons} {daemons} {turns} 1 []\n"


def test_info_describes_a_file(tmp_path):
    synthetic.trajectory("reduced", n_frames=4).write(tmp_path / "t.h5")
    lines = run_mpi(3, *PGMP, "info", tmp_path / "t.h5").stdout.splitlines()
    text = "\n".join(lines)
    assert lines[0].endswith("t.h5: trajectory of the reduced model")
    for expected in ("by pgmp", "slider_crank", "r1 = 0.0056", "seed       none", "ranks      2", "1.250 s"):
        assert text.count(expected) == 1
    assert "/frames/points/<4 frames>" in text and "00001" not in text
    assert any(line.split()[:5] == ["/state/coordinates", "1001", "x", "1", "rad"] for line in lines)


@pytest.fixture
def cold(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let processes end as an interpreter does; warm starts leave memory to the system (`warm_start`)."""
    monkeypatch.setenv("PYTHONHASHSEED", "1")  # is read at a start, so that the server serves no such process


@pytest.mark.parametrize("n", RANKS)
def test_what_petsc_still_holds_is_let_go_while_python_lives(cold, n):
    run_mpi(n, SCRIPTS / "left_behind.py", "closed")


@pytest.mark.skipif(not metadata.version("petsc4py").startswith("3.18."), reason="3.26 was seen to do it itself")
def test_without_that_the_end_of_petsc_may_crash(cold):
    """Once this is skipped with Debian's PETSc too, `release_petsc` has no use any more."""
    assert run_mpi(1, SCRIPTS / "left_behind.py", "open", check_status=None).returncode != 0
