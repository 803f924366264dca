"""MPI, PETSc and SLEPc: their start, the options that reach them and what they say when they refuse one, named events
for PETSc's own log, and matrices from the rows that each rank holds.

PETSc and SLEPc start together, on all ranks: starting SLEPc registers one more collective clean-up for the end of
Python, so a rank that never solves an eigenproblem would leave the others waiting there.

An event (``pgmp ... -- -log_view`` shows what an effect takes of a run) exists from its first use on: what a scene does
not name never appears.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache
from itertools import takewhile
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.base.surroundings import (
    Comm,
    alone,
    check_working_folder,
    has_mpi,
    has_petsc,
    held_back_stderr,
    needs_petsc,
    open_standard_streams,
    refuse_ranks,
)

if TYPE_CHECKING:
    from petsc4py import PETSc

#: Which options reach what; each is in the module that makes the solver. docs/petsc_options.md explains them.
PREFIXES = {
    "pgmp_modes_": "eigenproblems of the mechanism",
    "pgmp_scale_": "the first eigenproblem of a mechanism, which finds the shift of the others",
    "pgmp_body_": "factors of continuum bodies that are condensed",
    "pgmp_full_": "linear systems of one full-order run",
    "pgmp_ts_": "time integration",
    "pgmp_error_ts_": "time integration of the reference that error estimates compare with",
}
# read by PETSc itself, most of them only when it ends
OF_PETSC = (
    "citations", "get_total_flops", "info", "log", "malloc", "memory", "mpidump", "objects", "on_error", "options",
    "petsc_sleep", "saws", "version", "help",
)  # fmt: skip
# given to processes that belong to a run of several ranks, or may do so
OF_RANKS = ("OMPI_COMM_WORLD_SIZE", "PMIX_RANK", "PMI_RANK", "SLURM_JOB_ID", "PBS_JOBID", "LSB_JOBID")
# Open MPI's settings for a process that is alone: no daemon, no networks, and no folder for messages through memory.
# Open MPI gives all such processes of a user one and the same folder, and one that ends removes it from under those
# that start just then
ALONE = {
    "OMPI_MCA_ess_singleton_isolated": "1",
    "OMPI_MCA_orte_create_session_dirs": "0",
    "OMPI_MCA_pml": "ob1",
    "OMPI_MCA_btl": "self",
}
# Also where scripts/mpi_env.sh has set it for ranks: MUMPS looks for messages some hundred times a solution, and a
# process that is alone would give its turn away each time, to whatever else runs
TURNS = {"OMPI_MCA_mpi_yield_when_idle": "0"}
ABOUT_VALUES = (56, 60, 62, 63, 64, 65, 67, 83, 86, 89, 92)  # PETSc's errors of an option's value


def start_mpi() -> Comm:
    """Start MPI and return COMM_WORLD; without mpi4py the communicator of this process alone.

    Open MPI starts a daemon and looks for networks, a third of a second, also for a process that nobody started
    together with others; it needs neither. Processes that it starts later are not told so. Raises `InputError` if
    several processes were started together, and there is no mpi4py, or the working directory is gone.
    """
    open_standard_streams()
    if "mpi4py.MPI" not in sys.modules:
        check_working_folder()
    if not has_mpi():
        refuse_ranks()
        return alone()
    on_its_own = not any(name in os.environ for name in OF_RANKS)
    given = {name: value for name, value in ALONE.items() if on_its_own and name not in os.environ}
    given |= TURNS if on_its_own else {}
    before = {name: os.environ[name] for name in given if name in os.environ}
    os.environ.update(given)
    from mpi4py import MPI

    for name in given:
        del os.environ[name]
    os.environ.update(before)
    return MPI.COMM_WORLD


def petsc_runs() -> bool:
    """Return whether PETSc runs in this process, whoever started it."""
    started = getattr(sys.modules.get("petsc4py.PETSc"), "Sys", None)
    return started is not None and started.isInitialized()


def start_petsc(arguments: Sequence[str] = (), comm: Comm | None = None) -> None:
    """Start PETSc with a user's options, and SLEPc; nothing where they are not installed. Collective on `comm`.

    PETSc that runs already has had its own options. The communicator, COMM_WORLD if not given, is what it takes for its
    world, and is used until the program ends. Raises `InputError` if a word is no option, PETSc refuses one, or there
    is no PETSc that would take them.
    """
    option_names(arguments)
    if not has_petsc():
        if arguments:
            needs_petsc(f"options after '--' ({' '.join(arguments)})")
        return
    # what nothing used is named in one line at the end; PETSc has warnings of its own, by its version. A user's word is
    # last
    words = ["pgmp", "-options_left", "no", *arguments]
    import petsc4py

    said = ""
    try:
        with held_back_stderr() as printed:
            try:
                petsc4py.init(words, comm=comm)
            except RuntimeError:
                said = printed()
                raise
    except (RuntimeError, UnicodeError) as error:
        reason = _printed_reason(said) or reason_of(error)
        raise InputError(f"options after '--': PETSc does not start with {' '.join(arguments)}: {reason}") from error
    import slepc4py

    slepc4py.init(words)
    if threading.current_thread() is threading.main_thread():
        # PETSc ends the process with a page when a reader of its output has gone (`pgmp ... | head`); Python says so
        # where it writes, and what the run was for goes on
        signal.signal(signal.SIGPIPE, signal.SIG_IGN)


def _printed_reason(text: str) -> str:
    """Return the text between the heading of PETSc's page and its advice."""
    lines = [line.partition("PETSC ERROR: ")[2].strip() for line in text.splitlines()]
    for number, line in enumerate(lines):
        if "Error Message" in line:
            return ": ".join(takewhile(lambda part: not part.startswith(("See ", "WARNING!")), lines[number + 1 :]))
    return ""


def options_of(prefix: str) -> dict[str, str | None]:
    """Return the options that a user gave with a prefix, by their names without it; none where there is no PETSc."""
    if not has_petsc():
        return {}
    from petsc4py import PETSc

    return PETSc.Options(prefix).getAll()


def option_names(arguments: Sequence[str]) -> list[str]:
    """Return the names of options as PETSc stores them, without the dash and with pushed prefixes. Raises `InputError`,
    at a word that is neither an option nor the value of one; PETSc would pass over it in silence."""
    names: list[str] = []
    pushed, words = [], iter(arguments)
    previous: str | None = None
    for word in words:
        if _is_name(word):
            name = word.lstrip("-")
            if name == "prefix_push":
                pushed.append(next(words, ""))
            elif name == "prefix_pop":
                pushed = pushed[:-1]
            else:
                names.append("".join(pushed) + name)
            previous = name
        elif previous is None:
            raise InputError(f"after '--': '{word}' is no option of PETSc; they begin with '-' and take one value")
        else:
            previous = None
    return names


def _is_name(word: str) -> bool:
    """Return whether PETSc takes a word for an option and not for a value, such as -1e-3 or -inf."""
    bare = word[1:].removeprefix("-")
    if not word.startswith("-") or not bare[:1].isalpha():
        return False
    try:
        float(bare)
    except ValueError:
        return True
    return False


def unused_options(arguments: Sequence[str], comm: Comm) -> list[str]:
    """Return which of a user's options nothing has used on any rank. Collective on `comm`.

    Options of PETSc itself, some of which it reads only when it ends, do not count.
    """
    names = [name for name in option_names(arguments) if not name.startswith(OF_PETSC)]
    if not names:
        return []
    from petsc4py import PETSc

    # petsc4py has no PetscOptionsUsed; its library has
    library = ctypes.CDLL(PETSc.__file__)
    used = []
    for name in names:
        answer = ctypes.c_int(0)
        library.PetscOptionsUsed(None, name.encode(), ctypes.byref(answer))
        used.append(bool(answer.value & 0xFF))  # an int or a C bool, by PETSc's version
    somewhere = [any(ranks) for ranks in zip(*comm.allgather(used))] if comm.size > 1 else used
    return [name for name, found in zip(names, somewhere) if not found]


@contextmanager
def petsc_solver(prefix: str, activity: str) -> Iterator[None]:
    """Turn what PETSc raises in a block into an error of ours, which says what the block does, with the configuration.
    Raises `InputError` if PETSc refuses the value of one of the options with the prefix of the object that the block
    works on; `RunError` if anything else fails in PETSc."""
    from petsc4py import PETSc

    try:
        yield
    except (PETSc.Error, SystemError) as raised:
        # slepc4py 3.26.1 takes another number than PETSc for an exception: Python notices what is pending only on
        # return
        error = raised.__cause__ if isinstance(raised, SystemError) else raised
        if not isinstance(error, PETSc.Error):
            raise
        stored = PETSc.Options().getAll().items()
        given = [f"-{name} {value}".rstrip() for name, value in stored if name.startswith(prefix)]
        if given and error.ierr in ABOUT_VALUES:
            raise InputError(f"PETSc options {', '.join(given)}: {reason_of(error)}") from error
        raise RunError(f"{activity}: PETSc failed: {reason_of(error)}") from error


def reason_of(error: Exception) -> str:
    """Return the last line of what PETSc says, which tells what it got."""
    lines = [line.removeprefix("[0]").strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1] if lines else type(error).__name__


@cache
def log_event(name: str) -> AbstractContextManager:
    """Return the event ``pgmp_<name>``, to be entered with ``with``; without PETSc nobody takes note of it."""
    if not has_petsc():
        return nullcontext()
    from petsc4py import PETSc

    return PETSc.Log.Event(f"pgmp_{name}")


FEW = 8  # columns that are multiplied one by one: the set-up for all at once takes longer


def aij_matrix(local: sp.csr_matrix, comm: Comm, n_local_columns: int) -> PETSc.Mat:
    """Make a distributed AIJ matrix of this rank's rows (global column numbers)."""
    needs_petsc("eigenproblems of many unknowns or on several ranks, and bodies of continuum elements")
    from petsc4py import PETSc

    local.sort_indices()
    matrix = PETSc.Mat().createAIJ(
        size=((local.shape[0], None), (n_local_columns, local.shape[1])),
        csr=(local.indptr.astype(PETSc.IntType), local.indices.astype(PETSc.IntType), local.data),
        comm=comm,
    )
    matrix.assemble()
    return matrix


def times(matrix: PETSc.Mat, columns: np.ndarray) -> np.ndarray:
    """Return matrix times local columns (n_local, k)."""
    if columns.shape[1] < FEW:
        x, y = matrix.createVecs()
        return _apply(matrix.mult, x, y, columns)
    right = _dense(columns, matrix.getSize()[1], matrix.getComm())
    product = matrix.matMult(right)
    result = np.array(product.getDenseArray())
    product.destroy()
    right.destroy()
    return result


def transposed_times(matrix: PETSc.Mat, columns: np.ndarray) -> np.ndarray:
    """Return the transposed matrix times local columns (n_local, k)."""
    y, x = matrix.createVecs()
    return _apply(matrix.multTranspose, x, y, columns)


def use_cholesky(ksp: PETSc.KSP) -> None:
    """Let MUMPS solve; options may choose otherwise."""
    ksp.setType("preonly")
    pc = ksp.getPC()
    pc.setType("cholesky")
    pc.setFactorSolverType("mumps")


def mumps_factor(ksp: PETSc.KSP) -> PETSc.Mat | None:
    """Return MUMPS' matrix, which need not be factorised; None where the user has chosen another solver."""
    pc = ksp.getPC()
    if pc.getType() not in ("cholesky", "lu") or pc.getFactorSolverType() != "mumps":
        return None
    pc.setFactorSetUpSolverType()
    return pc.getFactorMatrix()


def solve_columns(factor: PETSc.Mat, columns: np.ndarray) -> np.ndarray:
    """Return the inverse of a factorised matrix times local columns (n_local, k)."""
    right = _dense(columns, factor.getSize()[0], factor.getComm())
    left = right.duplicate()
    left.assemble()
    factor.matSolve(right, left)
    result = np.array(left.getDenseArray())
    right.destroy()
    left.destroy()
    return result


def _dense(columns: np.ndarray, n_rows: int, comm: PETSc.Comm) -> PETSc.Mat:
    """Return local columns (n_local, k) as a distributed dense matrix with n_rows rows."""
    from petsc4py import PETSc

    size = ((columns.shape[0], n_rows), (None, columns.shape[1]))
    matrix = PETSc.Mat().createDense(size, array=np.asfortranarray(columns), comm=comm)
    matrix.setUp()
    matrix.assemble()
    return matrix


def _apply(product: Callable, x: PETSc.Vec, y: PETSc.Vec, columns: np.ndarray) -> np.ndarray:
    result = np.empty((y.getLocalSize(), columns.shape[1]))
    for i in range(columns.shape[1]):
        x.setArray(columns[:, i])
        product(x, y)
        result[:, i] = y.getArray(readonly=True)
    x.destroy()
    y.destroy()
    return result
