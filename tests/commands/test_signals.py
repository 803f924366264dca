"""A run that a scheduler ends: one line says what is kept, the exit status is the signal's, no rank is left behind."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
import warm_start
from conftest import MPI_ENVIRONMENT, ROOT, SCRIPTS, TIMEOUT_SECONDS

from pgmp_petsc.ranks.ending import ENDING, ending_on_signals, keep, keep_no_longer, search_at, what_is_kept

KEPT = "what was finished is kept in '{}'; the same command with --resume goes on from there"
# s from mpirun's SIGTERM to its SIGKILL, usually one: too little for a message where the machine is busy
UNHURRIED = {"OMPI_MCA_odls_base_sigkill_timeout": "5"}
NOTHING = "this run kept no part of its result; repeat the command"


@contextmanager
def waiting(n: int, *arguments: object) -> Iterator[subprocess.Popen[str]]:
    """Start the command that waits on n ranks, and give it when it does. Of several each is forked by a server, whose
    process is told what mpirun tells; one alone has signals of its own from the start on."""
    launch = ("mpirun", "-n", str(n), *warm_start.python()) if n > 1 else (sys.executable,)
    paths = os.pathsep.join(filter(None, [str(ROOT), str(ROOT / "tests"), os.environ.get("PYTHONPATH")]))
    job = subprocess.Popen(
        [*launch, SCRIPTS / "commands.py", "waiting", *map(str, arguments)],
        env=os.environ | MPI_ENVIRONMENT | UNHURRIED | {"PYTHONPATH": paths},
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        # a suite that runs in the background ignores SIGINT, and what it starts would
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    try:
        assert job.stdout.readline() == "waiting\n", job.communicate()
        yield job
    finally:
        if job.poll() is None:
            os.killpg(job.pid, signal.SIGKILL)
            job.wait()


def ended(job: subprocess.Popen[str], number: signal.Signals | None = None) -> tuple[int, list[str]]:
    """Send a signal, if any; return the exit status and the program's own lines."""
    if number is not None:
        job.send_signal(number)
    _, err = job.communicate(timeout=TIMEOUT_SECONDS)
    assert "Traceback" not in err
    said = [line for line in err.splitlines() if line.startswith("pgmp: ")]
    return job.returncode, [line for line in said if not line.startswith("pgmp: working")]  # of logs, every 5 s


@pytest.mark.parametrize("number", ENDING)
def test_a_run_that_is_ended_says_so(number: signal.Signals) -> None:
    with waiting(1) as job:
        assert ended(job, number) == (128 + number, [f"pgmp: stopped by {number.name}: {NOTHING}"])


def test_a_run_ends_whoever_read_its_messages_is_gone() -> None:
    with waiting(1) as job:
        job.stderr.close()  # as of `pgmp ... | tail`, both of which are ended
        job.send_signal(signal.SIGTERM)
        assert job.wait(TIMEOUT_SECONDS) == 128 + signal.SIGTERM


@pytest.fixture(scope="module")
def of_ranks(folder: Path) -> dict[object, tuple[int, list[str]]]:
    """Return how jobs of three ranks end, by the signal that mpirun is sent, or of "one" by that of one rank; mpirun
    takes some seconds for each, so that all end at the same time."""
    with ExitStack() as stack:
        jobs = {what: stack.enter_context(waiting(3, folder / f"{what}.h5")) for what in (*ENDING, "one")}
        for number in ENDING:
            jobs[number].send_signal(number)
        ranks = Path(f"/proc/{jobs['one'].pid}/task/{jobs['one'].pid}/children").read_text().split()
        os.kill(int(ranks[-1]), signal.SIGTERM)
        return {what: ended(job) for what, job in jobs.items()}


@pytest.mark.parametrize("number", ENDING)
def test_a_rank_that_waits_in_mpi_says_what_is_kept(of_ranks: dict, folder: Path, number: signal.Signals) -> None:
    status, lines = of_ranks[number]
    # mpirun passes the second one on; of the first it makes a status of its own
    assert status == (138 if number == signal.SIGUSR1 else 1)
    assert lines == [f"pgmp: stopped by {number.name}: {KEPT.format(folder / f'{number}.h5.partial')}"]
    assert (folder / f"{number}.h5.partial" / "piece.npz").exists()


def test_one_rank_that_is_ended_ends_all(of_ranks: dict) -> None:
    status, lines = of_ranks["one"]
    # mpirun ends the others; a second SIGTERM of its does not make a second message
    assert status == 143 and sum("stopped by" in line for line in lines) <= 1


def test_an_interrupted_run_says_what_is_kept(tmp_path: Path) -> None:
    with waiting(1, tmp_path / "many.h5") as job:
        status, lines = ended(job, signal.SIGINT)
    assert (status, lines) == (130, [f"pgmp: interrupted: {KEPT.format(tmp_path / 'many.h5.partial')}"])


WRITING = """
import os, signal, sys, time
from pathlib import Path
from pgmp_petsc.files.claims import locked, replacing
from pgmp_petsc.ranks.ending import ending_on_signals

with ending_on_signals(0), locked(Path(sys.argv[1])), replacing(sys.argv[1]) as partial:
    partial.write_text("half")
    assert len(os.listdir()) == 2
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(60.0)
"""


def test_a_signal_leaves_no_lock_and_no_half_written_file(tmp_path: Path) -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", WRITING, tmp_path / "run.h5"]
    assert subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True).returncode == 143
    assert os.listdir(tmp_path) == []


def test_handlers_are_put_back() -> None:
    before = [signal.getsignal(number) for number in ENDING]
    threads = threading.active_count()
    with ending_on_signals(0):
        assert [signal.getsignal(number) for number in ENDING] != before
        # other handlers work as before, and their signals end nothing
        came: list[int] = []
        usual = signal.signal(signal.SIGUSR2, lambda number, _: came.append(number))
        os.kill(os.getpid(), signal.SIGUSR2)
        time.sleep(0.05)
        signal.signal(signal.SIGUSR2, usual)
        assert came == [signal.SIGUSR2]
    assert [signal.getsignal(number) for number in ENDING] == before and threading.active_count() == threads


def test_a_signal_that_is_ignored_stays_so() -> None:
    before = signal.signal(signal.SIGUSR1, signal.SIG_IGN)
    try:
        with ending_on_signals(0):
            os.kill(os.getpid(), signal.SIGUSR1)
            time.sleep(0.05)
    finally:
        signal.signal(signal.SIGUSR1, before)


def test_other_threads_leave_handlers_alone() -> None:
    seen: list[object] = []

    def work() -> None:
        with ending_on_signals(0):
            seen.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [signal.getsignal(signal.SIGTERM)]


def test_what_is_kept_is_what_is_there(tmp_path: Path) -> None:
    (tmp_path / "piece.npz").touch()
    keep(tmp_path, "*.npz")  # by an earlier run
    with ending_on_signals(0):
        assert what_is_kept() == NOTHING
        pieces = tmp_path / "e.h5.partial"
        pieces.mkdir()
        keep(pieces, "*.npz")
        assert what_is_kept() == NOTHING
        (pieces / "piece.npz").touch()
        assert what_is_kept() == KEPT.format(pieces)
        keep(tmp_path, "*.npz")  # the folder of `pgmp run`, which has no --resume
        assert what_is_kept() == KEPT.format(f"{pieces}', '{tmp_path}").replace("with --resume ", "")
        for folder in (pieces, tmp_path):
            keep_no_longer(folder)
        assert what_is_kept() == NOTHING
        search_at({"r1": 5.6e-3, "k": 2e4})
        assert what_is_kept() == f"{NOTHING} where the search was, with --set r1=0.0056 --set k=20000"
