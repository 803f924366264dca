"""A folder for factors that do not fit into memory, one a rank; MUMPS writes and reads them there.

It is made where MUMPS' own variable ``MUMPS_OOC_TMPDIR`` says, else where temporary files go (``TMPDIR``), and is gone
when the factor is, also after a failure and after the signals that end a run.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pgmp_petsc.runtime import signals
from pgmp_petsc.runtime.errors import InputError

VARIABLE = "MUMPS_OOC_TMPDIR"
LONGEST = 200  # characters of a path that MUMPS takes, and its names besides


class FactorFiles:
    """A new folder. Of one rank; who makes it closes it.

    Raises
    ------
    InputError
        If it cannot be made.
    """

    def __init__(self) -> None:
        given = os.environ.get(VARIABLE)
        try:
            self.path = Path(tempfile.mkdtemp(prefix="pgmp_factor_", dir=given))
        except OSError as error:
            where = f"{VARIABLE} = '{given}'" if given else "the folder of temporary files"
            raise InputError(
                f"{where}: no file can be made there ({error.strerror}), and a factor is to go there that does not fit "
                f"into memory; let {VARIABLE} name a folder of a local disk, or give the run more memory or ranks"
            ) from error
        signals.remove_at_end(self.path)
        if len(str(self.path)) > LONGEST:
            self.close()
            raise InputError(
                f"{VARIABLE} or TMPDIR: '{self.path.parent}' is longer than the {LONGEST} characters that MUMPS takes"
            )

    @contextmanager
    def used(self) -> Iterator[None]:
        """Let MUMPS make its files in the folder, within the block."""
        before = os.environ.get(VARIABLE)
        os.environ[VARIABLE] = str(self.path)
        try:
            yield
        finally:
            if before is None:
                del os.environ[VARIABLE]
            else:
                os.environ[VARIABLE] = before

    @property
    def free(self) -> float:
        """Space that is left on the disk, bytes."""
        return float(shutil.disk_usage(self.path).free)

    def close(self) -> None:
        """Remove the folder with all that is in it."""
        shutil.rmtree(self.path, ignore_errors=True)
        signals.keep_no_longer(self.path)
