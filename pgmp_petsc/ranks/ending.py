"""The end of a program: its exit status, and what PETSc still holds.

A run may outlive standard output: where that cannot be written, the run goes on and the failure is reported at its end.
A full disk under ``pgmp ... > log`` must not cost the results of hours, and a reader that has gone (``pgmp info F |
head``) is no error to report at all.

Child processes end with this one, however it ends, and at their limits of time. A child is a program under a guard: a
small Python process that sets the limits before the program begins, and ends it with all of its process group (a
compiler has children too) when its own parent dies, it is asked to (SIGTERM), or the time is over. The kernel tells it
of its parent's death (prctl(2), PR_SET_PDEATHSIG), and the program of the guard's. Nothing is done between fork and
exec in this process, whose threads may hold any lock then.

A scheduler asks for the end of a run by SIGTERM or SIGUSR1. A scheduler ends a job with SIGTERM and kills it seconds
later; SIGUSR1 is what it is usually told to send before the time is up. Rank 0 then says what is kept and how to go on,
and every rank ends with 128 and the number of the signal (143 and 138). Finished pieces are whole at any moment
(:mod:`pgmp_petsc.files.checkpoint_folder`).

Python runs a handler between two of its own instructions only, and a rank that waits for others in MPI comes to none. A
thread waits for the signal instead; MPI lets it run.
"""

from __future__ import annotations

import gc
import io
import os
import re
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, NoReturn, TextIO

from pgmp_petsc.base.progress import clear_beat
from pgmp_petsc.base.surroundings import Comm

if TYPE_CHECKING:
    import subprocess

ENDING = (signal.SIGTERM, signal.SIGUSR1)
FLUSH_SECONDS = 0.5  # mpirun kills a second after SIGTERM

_kept: dict[Path, str] = {}  # the folders of finished pieces, with the pattern of these pieces' names
_passing: list[Path] = []
_again: list[str] = []  # how a search that is on its way is begun again where it is


def keep(folder: Path, pieces: str) -> None:
    """From now on finished pieces of the run are in a folder; their names fit a pattern."""
    _kept[folder] = pieces


def search_at(values: Mapping[str, float]) -> None:
    """From now on a search is at values of parameters, in the units of the scene."""
    _again[:] = ["where the search was, with", *(f"--set {name}={value:.10g}" for name, value in values.items())]


def remove_at_end(path: Path) -> None:
    """From now on a signal that ends the run removes a file, or a folder with all that is in it."""
    _passing.append(path)


def keep_no_longer(path: Path) -> None:
    """The file or folder is gone."""
    _kept.pop(path, None)
    if path in _passing:
        _passing.remove(path)


def what_is_kept() -> str:
    """Return what a run that ends now leaves, and the cure, as a clause."""
    folders = [f"'{folder}'" for folder, pieces in _kept.items() if any(folder.glob(pieces))]
    if not folders:
        return f"this run kept no part of its result; {' '.join(['repeat the command', *_again])}"
    return f"what was finished is kept in {', '.join(folders)}; {taken_up()}"


def taken_up() -> str:
    """Return how what is finished is taken up, as a clause; `pgmp run` does so by itself, in a folder of its own."""
    option = "with --resume " if all(folder.suffix == ".partial" for folder in _kept) else ""
    return f"the same command {option}goes on from there"


@contextmanager
def ending_on_signals(rank: int) -> Iterator[None]:
    """End the process when one of the signals comes within the block; rank 0 says so.

    A signal that the process was started to ignore stays ignored. Outside of the main thread nothing is done. What an
    earlier run of the process kept is not this one's.
    """
    _kept.clear()
    _again.clear()
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in ENDING}
    arrived, send = os.pipe()
    os.set_blocking(send, False)
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            # what the handler does does not matter; with it the signal's number is written to the pipe
            signal.signal(number, lambda *_: None)
    waker = signal.set_wakeup_fd(send, warn_on_full_buffer=False)
    watcher = threading.Thread(target=_watch, args=(arrived, rank), daemon=True)
    watcher.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(waker)
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        os.close(send)
        watcher.join()
        os.close(arrived)


def _watch(arrived: int, rank: int) -> None:
    """Wait for a signal; return when the pipe is closed."""
    while received := os.read(arrived, 1):
        # those of other handlers, such as an interrupt's, come here too
        if received[0] in ENDING:
            _end(signal.Signals(received[0]), rank)


def _end(number: signal.Signals, rank: int) -> NoReturn:
    """End this process at once: its other thread may be anywhere."""
    if rank == 0:
        # not through sys.stderr, which the other thread may hold; a bar's line is left standing
        start = "\n" if os.isatty(2) else ""
        with suppress(OSError):  # whoever read it may have been ended first
            os.write(2, f"{start}pgmp: stopped by {number.name}: {what_is_kept()}\n".encode())
    flush = threading.Thread(target=sys.stdout.flush, daemon=True)
    flush.start()
    for path in tuple(_passing):
        shutil.rmtree(path, ignore_errors=True)
        with suppress(OSError):  # a folder that is gone
            path.unlink()
    flush.join(FLUSH_SECONDS)
    os._exit(128 + number)


def release_petsc(comm: Comm) -> None:
    """Let go of what PETSc still holds on `comm` and on this rank, while Python lives. Collective on `comm`.

    A PETSc object that a cycle of Python references kept is only marked when the cycle is collected, and is
    destroyed with PETSc itself. Python has ended by then, and a time stepper written in Python crashes there.
    That is so with PETSc 3.18, and was not seen with 3.26.
    """
    # a rank whose work failed early may never have loaded PETSc
    if all(comm.allgather("petsc4py.PETSc" in sys.modules)):
        from petsc4py import PETSc

        gc.collect()
        for where in (comm, PETSc.COMM_SELF):
            PETSc.garbage_cleanup(where)


_OBEYED = re.compile(rb"[\x00-\x08\x0b-\x1f\x7f]|\xc2[\x80-\x9f]")  # by terminals, in UTF-8


class LastingOutput(io.RawIOBase):
    """Writes to a file descriptor, which stays open, until that fails, and swallows what comes after.

    `paint` colours whole lines; `failure` is the first one, or None.
    """

    def __init__(self, descriptor: int, paint: Callable[[bytes], bytes] | None) -> None:
        self._descriptor, self._paint = descriptor, paint
        self.failure: OSError | None = None

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._descriptor

    def isatty(self) -> bool:
        return os.isatty(self._descriptor)

    def write(self, data: bytes) -> int:
        """Write what can be written; what terminals obey is shown instead, as of `errors.visible`."""
        rest = _OBEYED.sub(lambda found: b"\\x%02x" % found[0][-1], bytes(data))
        rest = rest if self._paint is None else self._paint(rest)
        if self.failure is None:
            clear_beat()
        while rest and self.failure is None:
            try:
                rest = rest[os.write(self._descriptor, rest) :]
            except OSError as error:
                self.failure = error
        return len(data)

    def text(self, encoding: str) -> TextIO:
        """Return a text stream on it that is written line by line; what the encoding lacks is escaped."""
        return io.TextIOWrapper(io.BufferedWriter(self), encoding, errors="backslashreplace", line_buffering=True)


def descriptor_of(stream: TextIO | None) -> int | None:
    """Return the descriptor under a text stream, None where there is none."""
    try:
        return None if stream is None else stream.fileno()
    except (OSError, ValueError):
        return None


#: Exit status of a child that was ended at its limit of time, by the clock or of the processor.
TIME_IS_OVER = 124
_GUARD = f"""
import ctypes, os, resource, signal, sys
parent, seconds, command = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]
prctl = getattr(ctypes.CDLL(None), "prctl", lambda *_: 0)
program, over = 0, False
def end(number, _):
    global over
    over = number == signal.SIGALRM
    if program:
        os.killpg(program, signal.SIGKILL)
    if not over:
        os._exit(128 + number)
def follow(number, parent):
    os.setpgid(0, 0)
    prctl(1, number, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(1)
signal.signal(signal.SIGTERM, end)
signal.signal(signal.SIGALRM, end)
follow(signal.SIGTERM, parent)
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
if seconds:
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
guard, program = os.getpid(), os.fork()
if program == 0:
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    follow(signal.SIGKILL, guard)
    try:
        os.execvp(command[0], command)
    except OSError as error:
        os.write(2, (command[0] + ": " + error.strerror).encode())
    os._exit(127)
signal.alarm(seconds)
status = os.waitpid(program, 0)[1]
signal.alarm(0)
try:
    os.killpg(program, signal.SIGKILL)
except OSError:
    pass
number = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
over = over or number == signal.SIGXCPU
os._exit({TIME_IS_OVER} if over else 128 + number if number else os.WEXITSTATUS(status))
"""


@contextmanager
def child(
    command: Sequence[str | os.PathLike[str]],
    seconds: float | None = None,
    cwd: Path | None = None,
    **streams: int | IO,
) -> Iterator[subprocess.Popen]:
    """Run a program that ends with this process; what is left of it at the end of the block is ended.

    `seconds` it may take, by the clock and of the processor; None where its work has no bound of its own. Streams are
    as of `subprocess.Popen`; nothing is read, and nothing kept, where one is not given.
    """
    import subprocess  # a noticeable time, and few commands have children

    given = {name: streams.get(name, subprocess.DEVNULL) for name in ("stdin", "stdout", "stderr")}
    limit = "0" if seconds is None else str(max(1, round(seconds)))
    guarded = [sys.executable, "-I", "-S", "-c", _GUARD, str(os.getpid()), limit, *map(os.fspath, command)]
    with subprocess.Popen(guarded, cwd=cwd, **given) as process:
        try:
            yield process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)


def run_child(
    command: Sequence[str | os.PathLike[str]], seconds: float, cwd: Path | None = None
) -> subprocess.CompletedProcess[bytes]:
    """Run a program to its end and return its status and what it printed; `TIME_IS_OVER` where it was ended."""
    import subprocess  # as above

    with child(command, seconds, cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        out, err = process.communicate()
    return subprocess.CompletedProcess(command, process.returncode, out, err)
