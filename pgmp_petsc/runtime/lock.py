"""One job a result: a lock beside the file that a job is going to write, which names its owner.

The lock is the kernel's, on ``.<output>.lock``: it ends with the process that holds it, however that dies, and whoever
asks first has it then, so that nothing is ever left to be cleaned up and no two successors can both have it. What the
file says of its owner is for people only. The file is removed with the lock; one that a killed job left is no lock.

It holds between hosts where their shared file system hands locks on: NFS, GPFS, BeeGFS with global locks and Lustre
mounted with ``flock``. Where locks stay on a host (Lustre mounted with ``localflock``) it keeps apart the jobs of one
host alone. Where there are no locks (Lustre mounted with neither) there is nothing to hold, and `OutputLock.held` says
so; what pieces of a run carry of their run (`checkpoint_folder`) still keeps those of two runs apart.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
import time
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from pgmp_petsc.runtime.errors import InputError

PATIENCE = 5.0  # s; the ranks of a job that was just killed need a moment to end
_JOB_VARIABLES = ("SLURM_JOB_ID", "PBS_JOBID")
_TAKEN = (errno.EAGAIN, errno.EACCES)
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)


class OutputLock:
    """The lock on one output; to be taken by one process of a job, in a ``with`` block.

    Parameters
    ----------
    output
        The file that is going to be written; in a directory that exists.
    named
        What it is to the user, for the message; the output file where it is not given.

    Attributes
    ----------
    held
        False where the file system has no locks.

    Raises
    ------
    InputError
        From ``with``, if another process has the lock.
    OSError
        From ``with``, if the file of the lock cannot be written.
    """

    def __init__(self, output: Path, named: str = "") -> None:
        self._named, self._path = named or f"output file '{output}'", lock_path(output)
        self._descriptor: int | None = None
        self.held = False

    def __enter__(self) -> OutputLock:
        until = time.monotonic() + PATIENCE
        while not self._taken():
            if time.monotonic() > until:
                raise InputError(
                    f"{self._named} is being written by {_owner(self._path)}; wait for its end, or give another name "
                    "with -o"
                )
            time.sleep(0.05)
        return self

    def __exit__(self, *_: object) -> None:
        # The name goes before the lock: another job that opened it meanwhile sees that it is nobody's name any more.
        with suppress(OSError):
            self._path.unlink()
        os.close(self._descriptor)
        self.held = False

    def _taken(self) -> bool:
        """Try once to take the lock."""
        descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # its last owner may have removed the name since: others see another file then
            if not os.path.samestat(os.fstat(descriptor), os.stat(self._path)):
                raise FileNotFoundError
            self.held = True
            _sign(descriptor)
        except OSError as error:
            self.held = False
            if error.errno not in _NO_LOCKS:
                os.close(descriptor)
                if isinstance(error, FileNotFoundError) or error.errno in _TAKEN:
                    return False
                raise
        self._descriptor = descriptor
        return True


def lock_path(output: Path) -> Path:
    """Return the file of the lock on an output."""
    return output.with_name(f".{output.name}.lock")


def _sign(descriptor: int) -> None:
    """Write who has the lock."""
    owner = {
        "host": socket.gethostname(),
        "pid": os.getpid(),
        "job": next((os.environ[name] for name in _JOB_VARIABLES if os.environ.get(name)), ""),
        "since": datetime.now().astimezone().isoformat(timespec="seconds"),
    }
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, json.dumps(owner).encode(), 0)


def _owner(path: Path) -> str:
    """Say who has a lock."""
    try:
        owner = json.loads(path.read_text())
        job = f"job {owner['job']}, " if owner["job"] else ""
        return f"another job ({job}process {owner['pid']} on {owner['host']}, since {owner['since']})"
    except (OSError, ValueError, KeyError, TypeError):
        return f"another job (see '{path}')"
