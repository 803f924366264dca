"""What a process finds around it before it works: standard streams that are closed, and environment variables that
libraries read when they are imported, of which a wrong one ends in a traceback or in minutes of compiling.
"""

from __future__ import annotations

import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache

from pgmp_petsc.runtime.errors import InputError, shortened

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
    """Refuse to start in a folder that was removed: neither MPI nor PETSc starts there.

    Raises
    ------
    InputError
        If it was.
    """
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
    once a process, before it imports either.

    Raises
    ------
    InputError
        Naming the variable.
    """
    if os.environ.get("MPLBACKEND") and "matplotlib" not in sys.modules:
        _take_backend()
    given = {name: value for name, value in os.environ.items() if name.startswith("NUMBA_")}
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
            raise InputError(
                f"environment variables {listed}: numba, which compiles, cannot be loaded ({error}); leave out the "
                "wrong one"
            ) from error
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
