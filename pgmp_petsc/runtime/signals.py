"""The end of a run that a scheduler asks for: SIGTERM or SIGUSR1.

A scheduler ends a job with SIGTERM and kills it seconds later; SIGUSR1 is what it is usually told to send before the
time is up. Rank 0 then says what is kept and how to go on, and every rank ends with 128 and the number of the signal
(143 and 138). Finished pieces are whole at any moment (:mod:`pgmp_petsc.runtime.checkpoint_folder`).

Python runs a handler between two of its own instructions only, and a rank that waits for others in MPI comes to none.
A thread waits for the signal instead; MPI lets it run.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

ENDING = (signal.SIGTERM, signal.SIGUSR1)
FLUSH_SECONDS = 0.5  # mpirun kills a second after SIGTERM

_kept: list[Path] = []
_passing: list[Path] = []


def keep(folder: Path) -> None:
    """From now on finished pieces of the run are in a folder."""
    if folder not in _kept:
        _kept.append(folder)


def remove_at_end(folder: Path) -> None:
    """From now on a signal that ends the run removes a folder with all that is in it."""
    _passing.append(folder)


def keep_no_longer(folder: Path) -> None:
    """The folder is gone."""
    for folders in (_kept, _passing):
        if folder in folders:
            folders.remove(folder)


def what_is_kept() -> str:
    """Return what a run that ends now leaves, and the cure, as a clause."""
    if not _kept:
        return "no part of an unfinished result is kept; start it again"
    folders = ", ".join(f"'{folder}'" for folder in _kept)
    return f"what was finished is kept in {folders}; the same command with --resume goes on from there"


@contextmanager
def ending_on_signals(rank: int) -> Iterator[None]:
    """End the process when one of the signals comes within the block; rank 0 says so.

    A signal that the process was started to ignore stays ignored. Outside of the main thread nothing is done. What an
    earlier run of the process kept is not this one's.
    """
    _kept.clear()
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
        os.write(2, f"{start}pgmp: stopped by {number.name}: {what_is_kept()}\n".encode())
    flush = threading.Thread(target=sys.stdout.flush, daemon=True)
    flush.start()
    for folder in tuple(_passing):
        shutil.rmtree(folder, ignore_errors=True)
    flush.join(FLUSH_SECONDS)
    os._exit(128 + number)
