"""What a command finds around it: closed streams, environment variables, a folder that is gone, names of anyone."""

import subprocess
import sys
from pathlib import Path

import pytest
import warm_start
from conftest import ROOT, TIMEOUT_SECONDS, run_mpi
from runs import PGMP, pgmp

SCENE = ROOT / "scenes" / "slider_crank.toml"
CHECK = f"{sys.executable} {' '.join(PGMP)} check {SCENE}"
TABLE = f"{sys.executable} {' '.join(PGMP)} new slider_crank"


def shell(words: str, folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["env", *(f"{name}={value}" for name, value in variables.items()), "sh", "-c", words], cwd=folder,
        capture_output=True, text=True, timeout=TIMEOUT_SECONDS,
    )  # fmt: skip


@pytest.mark.parametrize("closed", ["2>&-", ">&-", "<&-", "<&- >&- 2>&-"])
def test_closed_streams(closed: str, tmp_path: Path) -> None:
    """Files that are opened do not get their numbers: nothing that is printed is in a result."""
    words = [f"{TABLE} mine.toml", *[CHECK] * (closed.count("&-") > 1)]
    done = shell("; ".join(f"{each} {closed}; echo status $? >>there" for each in words), tmp_path)
    assert (tmp_path / "there").read_text() == "status 0\n" * len(words), done
    assert (tmp_path / "mine.toml").read_text().startswith("#") and "Traceback" not in done.stdout + done.stderr


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("NUMBA_CPU_NAME", "no-such-processor", "LLVM knows no processor of this name"),
        ("NUMBA_CPU_FEATURES", "+nothing", "LLVM knows no feature of this name"),
        ("NUMBA_OPT", "fast", "this is no value of this setting of numba"),
        ("NUMBA_NUM_THREADS", "0", "numba, which compiles, cannot be loaded"),
        ("NUMBA_DISABLE_JIT", "1", "runs are of compiled functions alone"),
    ],
)
def test_variables_that_numba_cannot_work_with(name: str, value: str, said: str, tmp_path: Path) -> None:
    done = shell(CHECK, tmp_path, **{name: value})
    assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
    assert done.stderr.startswith("pgmp: error: environment variable") and f"{name} = '{value}'" in done.stderr
    assert said in done.stderr


def test_programs_are_told_of_these_variables() -> None:
    program = "import pgmp_petsc as pgmp\ntry: pgmp.simulate\nexcept pgmp.InputError as error: print(error)"
    done = shell(f"{sys.executable} -c '{program}'", ROOT, NUMBA_OPT="fast")
    assert "this is no value of this setting of numba" in done.stdout


def test_variables_are_refused_on_all_ranks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(warm_start, "python", lambda environment: [sys.executable])  # which has numba already
    monkeypatch.setenv("NUMBA_OPT", "fast")
    done = run_mpi(2, *PGMP, "check", SCENE, check_status=2)
    assert done.stderr.count("pgmp: error: environment variable NUMBA_OPT = 'fast'") == 1


def test_an_unknown_backend_of_matplotlib_is_done_without(tmp_path: Path) -> None:
    picture = f"{CHECK} --plot {tmp_path}/one.png"
    assert shell(picture, tmp_path, MPLBACKEND="nothing").returncode == 0
    assert (tmp_path / "one.png").read_bytes().startswith(b"\x89PNG")
    program = 'import pgmp_petsc as pgmp; pgmp.check; import matplotlib; print(matplotlib.rcParams["backend"])'
    done = shell(f"{sys.executable} -c '{program}'", ROOT, MPLBACKEND="svg")
    assert done.stdout == "svg\n", done


@pytest.mark.parametrize("command", ["check", "new"])
def test_a_working_folder_that_was_removed(command: str, tmp_path: Path) -> None:
    words = f"mkdir gone && cd gone && rmdir ../gone && {sys.executable} {' '.join(PGMP)} {command} {SCENE}"
    done = shell(words, tmp_path, PYTHONPATH=str(ROOT))
    assert done.returncode == 2
    assert done.stderr == "pgmp: error: the working directory was removed; go to one that exists (cd)\n"


def test_control_characters_are_shown(tmp_path: Path) -> None:
    text = SCENE.read_text().replace("../meshes", str(ROOT / "meshes"))
    assert 'name = "slider_crank"' in text
    named = tmp_path / "\x1b[31mred.toml"
    named.write_text(text.replace('name = "slider_crank"', 'name = "a\\u001b[2Jb"'))
    for words in (["check", named], ["check", f"{named}\x07"], ["check", named, "--set", "\x1b[2J=1"], ["\x1b[2J"]):
        done = pgmp(*words, status=2)
        assert not set(done.stdout + done.stderr) & set("\x1b\x07"), done.stderr
    named.write_text(text)
    for words in (["check", named], ["run", named, "--report", "page.pdf", "-o", tmp_path / "\x9bx"]):
        done = pgmp(*words, status=None)
        assert not set(done.stdout + done.stderr) & set("\x1b\x9b"), done
