"""Python processes that begin with their libraries loaded: commands in tests start in less than half the time.

A server loads what commands need and what starts neither MPI nor PETSc. For every command it forks a child, which takes
over the files, the folder and the environment of whoever asked and ends as an interpreter ends: nothing that one
command does is left for the next. Under mpirun a small stand-in waits for it and passes signals on.

    python warm_start.py SOCKET                              the server; it leaves when its stdin is closed
    python -I -S warm_start.py SOCKET -m MODULE ARGUMENTS     the stand-in; -c TEXT and FILE as with python
"""

import array
import atexit
import ctypes
import gc
import json
import os
import selectors
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import types
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr, suppress
from functools import cache
from pathlib import Path
from typing import NoReturn

STANDARD_FILES = (0, 1, 2)
# what mpirun, a scheduler or a user sends to a process
PASSED_ON = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2)
# variables that are read when an interpreter or a library starts: with others than the server's, a process starts cold
READ_AT_START = ("PYTHON", "NUMBA", "LD_", "OMP_NUM", "OPENBLAS", "MPL")
NUMBER = 8  # bytes of a number on the connection
SHARED = "PGMP_TEST_WARM_START"  # the variable with the socket of a server that another process started
PATIENCE = 600.0  # s, for a server that begins
#: The environment before a test changed it: a server that started in that of a test would serve no other one.
BEFORE_TESTS: dict[str, str] = {}
_ended_with: list[int] = []  # the status of a process that somebody wanted


def python(environment: Mapping[str, str] | None = None) -> list[str]:
    """Return the words that run Python: the stand-in, or the interpreter where an environment starts it otherwise."""
    path, started = _server()
    environment = started if environment is None else environment
    names = {name for name in {*environment, *started} if name.startswith(READ_AT_START)} - {"PYTHONPATH"}
    if any(environment.get(name) != started.get(name) for name in names):
        return [sys.executable]
    return [sys.executable, "-I", "-S", __file__, path]


def stand_in(path: str, arguments: Sequence[str]) -> NoReturn:
    """Be a process of the server's for whoever waits for this one: pass signals on, and end as it ends."""
    wanted = {"arguments": list(arguments), "environment": dict(os.environ), "folder": os.getcwd()}
    text = json.dumps(wanted).encode()
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.connect(path)
    rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", STANDARD_FILES))]
    connection.sendmsg([len(text).to_bytes(NUMBER, "little")], rights)
    connection.sendall(text)
    child = _number(connection)

    def pass_on(number: int, _frame: object) -> None:
        with suppress(ProcessLookupError):  # it may have ended just now
            os.kill(child, number)

    for number in PASSED_ON:
        signal.signal(number, pass_on)
    status = _number(connection)
    if status < 0:
        if -status in PASSED_ON:
            signal.signal(-status, signal.SIG_DFL)
        os.kill(os.getpid(), -status)
    sys.exit(status)


def serve(path: str) -> None:
    """Fork a process for every connection to a socket, until stdin is closed."""
    atexit.register(_leave)  # before what libraries register, so that it runs after that
    os.fsync = os.fstat  # as in `conftest`
    _preload()
    gc.freeze()  # Python looks through what it will collect when a process ends, and would copy all of it for that
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    listener.bind(f"{path}.new")
    listener.listen()
    os.rename(f"{path}.new", path)  # whoever finds it is heard
    woken, wake = os.pipe()
    os.set_blocking(woken, False)
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    events = selectors.DefaultSelector()
    for file in (listener, woken, sys.stdin):
        events.register(file, selectors.EVENT_READ)
    children: dict[socket.socket, int] = {}
    while True:
        for key, _ in events.select():
            if key.fileobj is sys.stdin:
                for child in children.values():
                    os.kill(child, signal.SIGKILL)
                return
            if key.fileobj is listener:
                connection, _ = listener.accept()
                child = _forked(connection, [listener, *children])
                children[connection] = child
                events.register(connection, selectors.EVENT_READ)
                connection.sendall(child.to_bytes(NUMBER, "little", signed=True))
            elif key.fileobj == woken:
                os.read(woken, 4096)
            elif key.fileobj in children:  # whoever asked was killed: so is the process
                events.unregister(key.fileobj)
                os.kill(children[key.fileobj], signal.SIGKILL)
        for connection, child in list(children.items()):
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                del children[connection]
                if connection in events.get_map():
                    events.unregister(connection)
                with suppress(OSError):  # whoever asked may have left just now
                    connection.sendall(os.waitstatus_to_exitcode(status).to_bytes(NUMBER, "little", signed=True))
                connection.close()


def _forked(connection: socket.socket, others: Sequence[socket.socket]) -> int:
    """Fork the process that a connection asks for; return its number, in the server alone."""
    size, rights, _, _ = connection.recvmsg(NUMBER, socket.CMSG_SPACE(4 * len(STANDARD_FILES)))
    files = array.array("i", rights[0][2])
    wanted = json.loads(_received(connection, int.from_bytes(size, "little")))
    child = os.fork()
    if child == 0:
        for other in (connection, *others):
            other.close()
        _become(wanted, files)
    for file in files:
        os.close(file)
    return child


def _become(wanted: Mapping, files: Sequence[int]) -> NoReturn:
    """Be the process that somebody wants, from here to its end."""
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    for place, file in zip(STANDARD_FILES, files, strict=True):
        os.dup2(file, place)
        os.close(file)
    os.environ.clear()
    os.environ.update(wanted["environment"])
    os.chdir(wanted["folder"])
    own = {os.path.dirname(os.path.abspath(__file__)), os.path.dirname(os.path.dirname(os.path.abspath(__file__)))}
    given = wanted["environment"].get("PYTHONPATH", "").split(os.pathsep)
    sys.path[:] = ["", *filter(None, given), *(path for path in sys.path if path not in own)]
    try:
        _run(*wanted["arguments"])
    except SystemExit as end:
        _ended_with.append(end.code & 255 if isinstance(end.code, int) else int(end.code is not None))
        raise
    except Exception:
        _ended_with.append(1)
        raise
    _ended_with.append(0)
    sys.exit(0)


def _run(first: str, *others: str) -> None:
    """Run what Python runs with such arguments."""
    import runpy

    if first == "-m":
        sys.modules.pop(others[0], None)
        sys.path[0], sys.argv = os.getcwd(), list(others)
        runpy.run_module(others[0], run_name="__main__", alter_sys=True)
    elif first == "-c":
        sys.path[0], sys.argv = "", ["-c", *others[1:]]
        main = sys.modules["__main__"] = types.ModuleType("__main__")
        exec(compile(others[0], "<string>", "exec"), main.__dict__)
    else:
        sys.path[0], sys.argv = os.path.dirname(os.path.abspath(first)), [first, *others]
        runpy.run_path(first, run_name="__main__")


def _leave() -> None:
    """Destroy what a command left behind, end PETSc and MPI, and leave memory to the system, which frees it at once.

    An interpreter that ends does the same, but empties all modules, one by one. That takes a tenth of a second of
    processor time, most of that of a command that does little.
    """
    if _ended_with:
        sys.modules.pop("__main__")
        gc.collect()
        if "petsc4py.PETSc" in sys.modules:
            sys.modules["petsc4py.PETSc"]._finalize()
        if "mpi4py.MPI" in sys.modules:
            mpi = sys.modules["mpi4py.MPI"]
            if mpi.Is_initialized() and not mpi.Is_finalized():
                mpi.Finalize()
        with suppress(OSError, ValueError):  # what cannot be written is told by the interpreter
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(_ended_with[0])


def _preload() -> None:
    """Import the package's modules, which start neither MPI nor PETSc when they are imported, and what is slow to; load
    the libraries of MPI and PETSc, which a process starts."""
    import importlib.util
    import pkgutil

    import pgmp_petsc

    slow = ("scipy.interpolate", "scipy.linalg", "scipy.optimize", "scipy.sparse.csgraph", "scipy.sparse.linalg")
    modules = (module.name for module in pkgutil.walk_packages(pgmp_petsc.__path__, "pgmp_petsc."))
    for name in (*slow, "scipy.stats", *modules):
        importlib.import_module(name)
    for package, name in (("mpi4py", "MPI"), ("petsc4py", "PETSc"), ("slepc4py", "SLEPc")):
        found = list(Path(importlib.util.find_spec(package).origin).parent.rglob(f"{name}.*.so"))
        if len(found) == 1:  # of several a process chooses
            ctypes.CDLL(str(found[0]))
    _rehearse()
    assert not {"mpi4py.MPI", "petsc4py.PETSc"} & set(sys.modules), "a module starts MPI or PETSc when it is imported"


def _rehearse() -> None:
    """Do small runs as where there is no PETSc: what first runs make ready, compiled functions above all, every process
    then has."""
    import pgmp_petsc as interface
    from pgmp_petsc.base import surroundings
    from pgmp_petsc.ranks import petsc

    scene = Path(__file__).resolve().parent.parent / "scenes" / "slider_crank_effects.toml"
    short = ("reduction.angles=12", "reduction.modes=2", "simulation.duration=3e-3", "simulation.step=1e-3")
    is_there, surroundings._is_there = surroundings._is_there, lambda name: False
    with tempfile.TemporaryDirectory() as folder, open(os.devnull, "w") as nowhere, redirect_stderr(nowhere):
        model = interface.build(scene, overrides=short)
        interface.simulate(model, output=Path(folder, "run.h5"))
        interface.montecarlo(model, 3)
        for kind in ("full", "components"):
            interface.simulate(scene, model=kind, overrides=short)
    surroundings._is_there = is_there
    petsc.log_event.cache_clear()


def share() -> None:
    """Start a server for this process and those that it starts, and do not wait for it."""
    os.environ[SHARED] = _started(_environment())


@cache
def _server() -> tuple[str, Mapping[str, str]]:
    """Return the socket of the server, once it is there, and its environment; start it unless another process did."""
    environment = _environment()
    path = environment.get(SHARED) or _started(environment)
    until = time.monotonic() + PATIENCE
    while not os.path.exists(path):
        assert time.monotonic() < until, "the server of warm starts did not start"
        time.sleep(0.02)
    return path, environment


def _environment() -> dict[str, str]:
    from conftest import MPI_ENVIRONMENT, ROOT

    return dict(BEFORE_TESTS or os.environ) | MPI_ENVIRONMENT | {"PYTHONPATH": str(ROOT)}


def _started(environment: Mapping[str, str]) -> str:
    """Start the server, which ends with this process; return where its socket will be."""
    folder = Path(tempfile.mkdtemp(prefix="pgmp_warm_"))
    path = str(folder / "socket")
    process = subprocess.Popen([sys.executable, __file__, path], stdin=subprocess.PIPE, env=environment)

    def leave() -> None:
        process.stdin.close()
        process.wait()
        shutil.rmtree(folder, ignore_errors=True)

    atexit.register(leave)
    return path


def _number(connection: socket.socket) -> int:
    return int.from_bytes(_received(connection, NUMBER), "little", signed=True)


def _received(connection: socket.socket, size: int) -> bytes:
    """Return so many bytes of a connection."""
    data = b""
    while len(data) < size:
        part = connection.recv(size - len(data))
        if not part:
            raise SystemExit("the server of warm starts has left")
        data += part
    return data


if __name__ == "__main__":
    if sys.argv[2:]:
        stand_in(sys.argv[1], sys.argv[2:])
    serve(sys.argv[1])
