"""Child processes: what they return, their limits, and that none outlives its parent."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import ROOT, TIMEOUT_SECONDS

from pgmp_petsc.ranks.ending import TIME_IS_OVER, child, run_child

# what a mesh reader of meshio does with a file cut short, and a compiler with children of its own
SPINS = "while True: pass"
SPINS_BELOW = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {SPINS!r}, sys.argv[1]])"


def living(mark: str) -> list[int]:
    """Return the processes whose command line holds a mark."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            words, state = (place / "cmdline").read_bytes(), (place / "stat").read_text().rsplit(")", 1)[1].split()[0]
        except OSError:
            continue
        if mark.encode() in words and state != "Z":
            found.append(int(place.name))
    return found


def waited(condition: Callable[[], bool]) -> bool:
    """Wait until a condition holds; return whether it did."""
    until = time.monotonic() + TIMEOUT_SECONDS
    while not condition() and time.monotonic() < until:
        time.sleep(0.05)
    return condition()


def test_what_a_child_returns(tmp_path: Path) -> None:
    done = run_child(["sh", "-c", "pwd; echo wrong >&2; exit 3"], 60.0, tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (3, f"{tmp_path}\n".encode(), b"wrong\n")
    assert run_child(["sh", "-c", "kill -SEGV $$"], 60.0).returncode == 128 + signal.SIGSEGV
    lacking = run_child(["/nowhere/cc"], 60.0)
    assert (lacking.returncode, lacking.stderr) == (127, b"/nowhere/cc: No such file or directory")


@pytest.mark.parametrize("program", [SPINS, SPINS_BELOW, "import time; time.sleep(1e4)"])
def test_a_child_ends_at_its_time(program: str, tmp_path: Path) -> None:
    """One that works, one whose own child does, and one that waits."""
    assert run_child([sys.executable, "-c", program, str(tmp_path)], 1.0).returncode == TIME_IS_OVER
    assert waited(lambda: not living(str(tmp_path)))


def test_a_child_has_its_limits_itself() -> None:
    done = run_child([sys.executable, "-c", "import resource as r; print(r.getrlimit(r.RLIMIT_CPU))"], 7.0)
    assert done.stdout == b"(7, 8)\n"


def test_what_is_left_at_the_end_of_the_block_is_ended(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), child([sys.executable, "-c", SPINS_BELOW, str(tmp_path)]):
        assert waited(lambda: len(living(str(tmp_path))) == 3)
        raise KeyboardInterrupt
    assert waited(lambda: not living(str(tmp_path)))


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
@pytest.mark.parametrize("program", [SPINS, SPINS_BELOW])
def test_no_child_outlives_its_parent(program: str, number: int, tmp_path: Path) -> None:
    own = f"import sys; from pgmp_petsc.ranks.ending import run_child; run_child({[program]} and sys.argv[1:], 600)"
    command = [sys.executable, "-c", own, sys.executable, "-c", program, str(tmp_path)]
    with subprocess.Popen(command, cwd=ROOT) as parent:
        many = 3 if program == SPINS else 4  # itself, the guard, and the program with its children
        assert waited(lambda: len(living(str(tmp_path))) == many)
        parent.send_signal(number)
        parent.wait(TIMEOUT_SECONDS)
    assert waited(lambda: not living(str(tmp_path)))


def test_no_mesh_reader_outlives_a_command(tmp_path: Path) -> None:
    """Its reader looks for the next line of a file that has no more."""
    mesh = tmp_path / "endless.off"
    mesh.write_text("OFF\n")
    scene = (ROOT / "scenes" / "slider_crank.toml").read_text().replace("../meshes/crank_5.msh", str(mesh))
    (tmp_path / "scene.toml").write_text(scene)
    assert str(mesh) in scene
    command = [sys.executable, "-m", "pgmp_petsc.cli.main", "check", str(tmp_path / "scene.toml")]
    with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL) as parent:
        assert waited(lambda: len(living(str(mesh))) == 2)
        os.kill(parent.pid, signal.SIGKILL)
        parent.wait(TIMEOUT_SECONDS)
    assert waited(lambda: not living(str(mesh)))


def test_every_child_is_started_in_one_place() -> None:
    """Whoever starts one elsewhere has to see to its end."""
    starts = ("import subprocess", "from subprocess", "multiprocessing", "os.fork", "os.spawn", "os.system", "popen(")
    texts = {path: path.read_text(encoding="utf-8") for path in (ROOT / "pgmp_petsc").rglob("*.py")}
    found = {path.name for path, text in texts.items() if any(start in text for start in starts)}
    assert found == {"ending.py", "solids.py"}, found  # the latter has the name of a pipe
