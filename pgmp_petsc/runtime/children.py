"""Child processes that end with this one, however it ends, and at their limits of time.

A child is a program under a guard: a small Python process that sets the limits before the program begins, and ends it
with all of its process group (a compiler has children too) when its own parent dies, it is asked to (SIGTERM), or the
time is over. The kernel tells it of its parent's death (prctl(2), PR_SET_PDEATHSIG), and the program
of the guard's. Nothing is done between fork and exec in this process, whose threads may hold any lock then.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

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

    Parameters
    ----------
    command
        The program with its arguments.
    seconds
        Time that it may take, by the clock and of the processor; None where its work has no bound of its own.
    cwd
        Its working folder.
    **streams
        ``stdin``, ``stdout`` and ``stderr``, as of `subprocess.Popen`; nothing is read, and nothing kept, where one is
        not given.
    """
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
    with child(command, seconds, cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        out, err = process.communicate()
    return subprocess.CompletedProcess(command, process.returncode, out, err)
