"""Surroundings of a process before it works: standard streams that are closed, and environment variables that
libraries read when they are imported, of which a wrong one ends in a traceback or in minutes of compiling.

Reduced models run without MPI, PETSc and SLEPc: this process alone is then the communicator (`OneRank`), and a plain
loop drives the integration (`stepping.generalised_alpha`). docs/without_petsc.md says what works so.
"""

from __future__ import annotations

import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, NoReturn

from pgmp_petsc.base import PLAIN_NUMBA
from pgmp_petsc.base.errors import InputError, shortened

if TYPE_CHECKING:
    from mpi4py import MPI
    from mpi4py.MPI import Comm as Comm
else:
    Comm = Any  # of mpi4py, or `OneRank`, in annotations: neither is imported for them

STREAMS = ("stdin", "stdout", "stderr")
COMPILED_FOR = {"NUMBA_CPU_NAME": "processor", "NUMBA_CPU_FEATURES": "feature"}


def open_standard_streams() -> None:
    """Open those of the three standard streams that are closed on nothing: the next file that the process opens would
    get their numbers, and messages would be written into a result."""
    for number, name in enumerate(STREAMS):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, "w" if number else "r", closefd=False))


def check_working_folder() -> None:
    """Refuse to start in a folder that was removed, where neither MPI nor PETSc starts; raises `InputError`."""
    try:
        os.getcwd()
    except OSError as error:
        raise InputError("the working directory was removed; go to one that exists (cd)") from error


@contextmanager
def held_back_stderr() -> Iterator[Callable[[], str]]:
    """Hold back what C prints to standard error in the block, and print it at its end unless it was read by calling
    what the block is given."""
    open_standard_streams()
    sys.stderr.flush()
    kept, read = os.dup(2), False
    with tempfile.TemporaryFile() as file:

        def printed() -> str:
            nonlocal read
            read = True
            file.seek(0)
            return file.read().decode(errors="replace")

        os.dup2(file.fileno(), 2)
        try:
            yield printed
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            if not read:
                os.write(2, printed().encode())


@cache
def check_variables() -> None:
    """Refuse environment variables that numba cannot work with, and do without a backend that matplotlib does not have;
    once a process, before it imports either. Raises `InputError`, naming the variable."""
    if os.environ.get("MPLBACKEND") and "matplotlib" not in sys.modules:
        _take_backend()
    given = {name: value for name, value in os.environ.items() if name.startswith("NUMBA_") and name != PLAIN_NUMBA}
    if given and "numba" not in sys.modules:
        _check_numba(given)


def _take_backend() -> None:
    """Import matplotlib, which ends where it has no backend of the variable's name; pictures here need none."""
    name = os.environ.pop("MPLBACKEND")
    try:
        import matplotlib

        matplotlib.rcParams["backend"] = name
    except ImportError:
        pass  # whoever draws says that it is missing
    except ValueError:
        return
    os.environ["MPLBACKEND"] = name


def _check_numba(given: dict[str, str]) -> None:
    """Import numba, which warns of values that it cannot parse, and ends with a traceback where one is out of range."""
    listed = ", ".join(f"{name} = {shortened(value)!r}" for name, value in given.items())
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            import numba
        except ValueError as error:
            why = f"environment variables {listed}: numba, which compiles, cannot be loaded ({error})"
            raise InputError(f"{why}; leave out the wrong one") from error
    for warning in said:
        for name in given:
            if f"'{name}'" in str(warning.message):
                raise _refused(name, "this is no value of this setting of numba")
    if numba.config.DISABLE_JIT:
        raise _refused("NUMBA_DISABLE_JIT", "runs are of compiled functions alone")
    from llvmlite import binding

    binding.initialize_native_target()
    # with these it would compile anew, for minutes, what it keeps, and LLVM's warning would be lost among its others
    for name, what in COMPILED_FOR.items():
        if given.get(name, "").strip() not in ("", "generic", "host"):
            target = binding.Target.from_default_triple()
            with held_back_stderr() as printed:
                options = {"cpu": given[name]} if what == "processor" else {"features": given[name]}
                target.create_target_machine(**options)
                lines = printed()
            if f"is not a recognized {what}" in lines:
                raise _refused(name, f"LLVM knows no {what} of this name for this machine")


def _refused(name: str, why: str) -> InputError:
    value = shortened(os.environ.get(name, ""))
    return InputError(f"environment variable {name} = {value!r}: {why}; leave it out (unset {name})")


OF_PETSC = ("petsc4py", "slepc4py", "mpi4py")  # PETSc is handed communicators of mpi4py
CURE = "a ROM.h5 built where they are runs here; scripts/setup of the sources installs them (docs/without_petsc.md)"
#: What programs that start several processes tell each of how many there are, and which it is.
SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "MPI_LOCALNRANKS")
NUMBERS = ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK", "MPI_LOCALRANKID")


def missing() -> tuple[str, ...]:
    """Return which packages of `OF_PETSC` this Python does not have."""
    return tuple(name for name in OF_PETSC if not _is_there(name))


def has_petsc() -> bool:
    """Return whether PETSc and SLEPc are there, with MPI."""
    return not missing()


def has_mpi() -> bool:
    return _is_there("mpi4py")


def needs_petsc(what: str) -> None:
    """Refuse what cannot be done without PETSc, where it is absent: the subject of the message, in the plural. Raises
    `InputError`, naming the packages that are missing; the same on all ranks."""
    absent = missing()
    if absent:
        raise InputError(f"{what} need PETSc and SLEPc, and this Python has no {', '.join(absent)}; {CURE}")


def alone() -> MPI.Comm:
    """Return the communicator of this process alone."""
    if not has_mpi():
        return OneRank()
    from mpi4py import MPI

    return MPI.COMM_SELF


def is_communicator(value: object) -> bool:
    """Return whether a value is what a call may run on."""
    if not has_mpi():
        return isinstance(value, OneRank)
    from mpi4py import MPI

    return isinstance(value, MPI.Intracomm) and value != MPI.COMM_NULL


def refuse_ranks() -> None:
    """Refuse to be one of several processes without mpi4py: each would do the whole work, and write the same files;
    raises `InputError`, whose message is empty but on the first of them."""
    started = next((int(os.environ[name]) for name in SIZES if os.environ.get(name, "").isdecimal()), 1)
    if started > 1:
        first = next((os.environ[name] for name in NUMBERS if name in os.environ), "0") == "0"
        said = f"{started} processes were started together, and this Python has no mpi4py, so that none knows of the "
        raise InputError(said + "others; start one, or install mpi4py" if first else "")


@cache
def _is_there(name: str) -> bool:
    """Return whether a package can be found, without importing it: MPI and PETSc start when they are imported."""
    try:
        return find_spec(name) is not None
    except (ImportError, ValueError):
        return False


class OneRank:
    """The part of mpi4py's communicator that is used here, with one rank; nothing is sent, and nothing waits.

    What several ranks alone do (messages between ranks, reductions with an operation of MPI) is not here: it is asked
    for where ``size`` is larger than 1.
    """

    rank, size = 0, 1

    def Dup(self) -> OneRank:  # noqa: N802 (MPI's name, as are the others)
        return OneRank()

    def Split(self, color: int = 0, key: int = 0) -> OneRank:  # noqa: N802
        return OneRank()

    def Free(self) -> None:  # noqa: N802
        """Give nothing back: nothing is held."""

    def Abort(self, errorcode: int = 0) -> NoReturn:  # noqa: N802
        sys.exit(errorcode)

    def bcast(self, obj: Any, root: int = 0) -> Any:
        return obj

    def gather(self, sendobj: Any, root: int = 0) -> list[Any]:
        return [sendobj]

    def allgather(self, sendobj: Any) -> list[Any]:
        return [sendobj]

    def allreduce(self, sendobj: Any, op: object = None) -> Any:
        return sendobj
