"""One job a result: a lock beside the file that a job is going to write, which names its owner.

The lock is the kernel's, on ``.<output>.lock``: it ends with the process that holds it, however that dies, and whoever
asks first has it then, so that nothing is ever left to be cleaned up and no two successors can both have it. What the
file says of its owner is for people only. The file is removed with the lock, and by the signals that end a run; one
that a killed job left is no lock.

It holds between hosts where their shared file system hands locks on (docs/files.md). Where locks stay on a host
(Lustre mounted with ``localflock``) it keeps apart the jobs of one host alone. Where there are none, what pieces of a
run carry of their run (`checkpoint_folder`) still keeps those of two runs apart.

What a command is going to write: checked before long work, and kept from other jobs until it is written.

A result replaces an older result of the same kind and nothing else: no file that the command reads, no scene, mesh or
other file that is not of this program, no device, pipe or directory.
"""

from __future__ import annotations

import errno
import fcntl
import json
import mmap
import os
import socket
import stat
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from datetime import datetime
from pathlib import Path

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.files.seal import MAGIC, SIGNATURE, BrokenSeal, seal_of
from pgmp_petsc.ranks.agreement import on_root
from pgmp_petsc.ranks.ending import keep_no_longer, remove_at_end

PATIENCE = 5.0  # s; the ranks of a job that was just killed need a moment to end
_JOB_VARIABLES = ("SLURM_JOB_ID", "PBS_JOBID")
_TAKEN = (errno.EAGAIN, errno.EACCES)
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)


@contextmanager
def locked(output: Path, named: str = "") -> Iterator[None]:
    """Keep an output, in a directory that exists, from other jobs within the block; by one process of a job.

    To the user it may be something else, such as ``folder 'x_results'``. Raises `InputError` if another process has it,
    or it cannot be locked.
    """
    named, path, until = named or f"output file '{output}'", lock_path(output), time.monotonic() + PATIENCE
    try:
        while (descriptor := _taken(path, output, named)) is None:
            if time.monotonic() > until:
                cure = "wait for its end, or give another name with -o"
                raise InputError(f"{named} is being written by {_owner(path)}; {cure}")
            time.sleep(0.05)
    except OSError as error:
        raise InputError(f"{named} cannot be locked: {_reason(error, path)}") from error
    remove_at_end(path)
    try:
        yield
    finally:
        # The name goes before the lock: another job that opened it meanwhile sees that it is nobody's name any more.
        with suppress(OSError):
            path.unlink()
        keep_no_longer(path)
        os.close(descriptor)


def _taken(path: Path, output: Path, named: str) -> int | None:
    """Return the descriptor of a lock that was free, None where it was not; a warning says if there are no locks."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # its last owner may have removed the name since: others see another file then
        if not os.path.samestat(os.fstat(descriptor), os.stat(path)):
            raise FileNotFoundError
        with suppress(OSError, ValueError, KeyError, TypeError):  # what an owner that was killed had begun to write
            partial_path(output, int(json.loads(os.pread(descriptor, os.fstat(descriptor).st_size, 0))["pid"])).unlink()
        _sign(descriptor)
    except OSError as error:
        if error.errno in _NO_LOCKS:
            text = f"the file system of {named} has no locks: no other job may write the same output meanwhile"
            print(f"pgmp: warning: {text}", file=sys.stderr, flush=True)
            return descriptor
        os.close(descriptor)
        if isinstance(error, FileNotFoundError) or error.errno in _TAKEN:
            return None
        raise
    return descriptor


def lock_path(output: Path) -> Path:
    return output.with_name(f".{output.name}.lock")


def pieces_path(output: Path) -> Path:
    """Return the folder that keeps finished pieces of a run until its output is written."""
    target = Path(os.path.realpath(output))
    return target.with_name(f"{target.name}.partial")


def partial_path(output: Path, process: int) -> Path:
    """Return the file that a process writes before it takes the output's place."""
    return output.with_name(f".{output.name}.{process}.partial")


def _sign(descriptor: int) -> None:
    owner = {
        "host": socket.gethostname(),
        "pid": os.getpid(),
        "job": next((os.environ[name] for name in _JOB_VARIABLES if os.environ.get(name)), ""),
        "since": datetime.now().astimezone().isoformat(timespec="seconds"),
    }
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, json.dumps(owner).encode(), 0)


def _owner(path: Path) -> str:
    try:
        owner = json.loads(path.read_text())
        job = f"job {owner['job']}, " if owner["job"] else ""
        return f"another job ({job}process {owner['pid']} on {owner['host']}, since {owner['since']})"
    except (OSError, ValueError, KeyError, TypeError):
        return f"another job (see '{path}')"


KINDS = {
    "rom": "reduced model",
    "components": "component model",
    "trajectory": "trajectory",
    "ensemble": "ensemble",
    "shard": "shard of an ensemble",
    "rare_event": "rare event",
    "modes": "table of modes",
    "tradeoff": "trade-off study",
    "sensitivities": "table of sensitivities",
    "fit": "fit of parameters",
    "design": "optimized design",
}
# those with rows and columns, which are a table where the file's name says so
TABULAR = ("trajectory", "ensemble", "modes", "tradeoff", "sensitivities")
TABLE = "table"
# kinds that are no HDF5 files: what they are, their own endings (the first is proposed), and a text that they contain;
# a table holds nothing but its numbers
_OTHERS: dict[str, tuple[str, tuple[str, ...], bytes | None]] = {
    TABLE: ("table", (".csv",), None),
    "xdmf": ("XDMF description", (".xdmf", ".xmf"), b"pgmp_petsc"),
    "picture": ("picture", (".png",), b"pgmp_petsc"),
    "film": ("film", (".mp4", ".gif"), b"pgmp_petsc"),
    "report": ("report", (".html", ".htm"), b'name="generator" content="pgmp_petsc'),
    "fmu": ("functional mock-up unit", (".fmu",), b"written by pgmp_petsc"),
    "code": ("model in C", (".c", ".h"), b"written by pgmp_petsc"),
    "schema": ("JSON schema of scenes", (".json",), b'"title": "Scene of pgmp"'),
    "reference": ("page of all entries of scenes", (".md", ".markdown"), b"made by `pgmp schema`"),
    "scaling": ("record of a scaling study", (".json",), b'"factorisations"'),
    "beams": ("record of fine beams", (".json",), b'"differences"'),
}
_HDF5_ENDINGS = (".h5", ".hdf5", ".hdf")
# endings that say what a file is; others (none, or a job's number) say nothing
_ENDINGS = frozenset(
    """.bz2 .c .cfg .cgns .csv .dat .e .exo .fmu .gif .gz .html .ini .inp .jpeg .jpg .json .key .log .mat .md .med .mesh
    .mp4 .msh .npy .npz .obj .off .out .partial .pbs .pdf .pickle .pkl .ply .png .py .sh .slurm .stl .su2 .svg .tar
    .toml .tsv .txt .unv .vtk .vtu .webm .xdmf .xlsx .xmf .xml .yaml .yml .zip""".split()
) | {*_HDF5_ENDINGS}  # fmt: skip
_LONGEST_ADDITION = len("..partial") + len(str(2**22))  # of the names beside the output: a dot, a process number
_OLD_RESULT = (SIGNATURE, b"format_version", b"program_version")


@contextmanager
def claimed(
    comm: Comm, output: str | os.PathLike[str], kind: str, inputs: Iterable[str | os.PathLike[str] | None] = ()
) -> Iterator[Path]:
    """Check an output as `check_output` and keep it from other jobs within the block. Collective on ``comm``.

    Yields the output's full path, the same on all ranks wherever they work; a symbolic link is followed. The first rank
    holds the lock; inputs that are None do not count. Raises `InputError`, as `check_output`, and if another job is
    writing the output.
    """
    with ExitStack() as held:

        def claim_the_output() -> Path:
            target = check_output(output, kind, inputs)
            held.enter_context(locked(target, f"output file '{output}'"))
            return target

        yield on_root(comm, claim_the_output)


def check_output(
    output: str | os.PathLike[str], kind: str, inputs: Iterable[str | os.PathLike[str] | None] = ()
) -> Path:
    """Check that a result may be written, and return its full path; symbolic links are followed.

    The kind is one of :data:`KINDS`, or of those that are no HDF5 files (``xdmf``, ``picture``, ``film``, ``report``,
    ``fmu``, ``code``, ``table``, ``schema``, ``reference``, ``scaling``, ``beams``). Raises `InputError` if the output
    is one of the inputs that are read for it, exists and is no result of this program or one of another kind, is a
    directory, device or pipe, has an ending of another format, or cannot be made where it is to be.
    """
    try:
        target = Path(os.path.realpath(output))
        found = _status(target)
        for source in inputs:
            if source is not None and found is not None and _is_same(found, source):
                raise InputError(f"output file '{output}' is what the command reads ('{source}'); give another name")
        _check_place(output, target, found)
        _check_ending(output, kind)
        if found is not None:
            _check_replaceable(output, target, kind)
        return target
    except OSError as error:
        raise InputError(f"output file '{output}' cannot be written: {_reason(error, Path(output))}") from error


def check_folder(folder: str | os.PathLike[str], output: str | os.PathLike[str] | None = None) -> None:
    """Check that a folder for pictures is there, or can be made with those above it, before a run; make nothing. Raises
    `InputError` if it is the output of the same command or something that is no folder, has a file's ending, lies in
    such, or may not be written in."""
    if output is not None and os.path.realpath(folder) == os.path.realpath(output):
        raise InputError(f"output directory '{folder}' is the output file too; give another name")
    target = Path(os.path.abspath(folder))
    nearest = next(path for path in (target, *target.parents) if os.path.lexists(path))
    if target.suffix.lower() in _ENDINGS and nearest != target:
        what = f"output directory '{folder}' has the ending of a file"
        raise InputError(f"{what}; give a directory, in which pictures have names of their own")
    if not nearest.is_dir():
        raise InputError(f"output directory '{folder}' cannot be made: '{nearest}' is no directory; give another name")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError(f"output directory '{folder}': no permission to write in '{nearest}'")


def is_table(output: str | os.PathLike[str]) -> bool:
    """Return whether the name of an output asks for a table (CSV)."""
    return Path(output).suffix.lower() == ".csv"


def form_of(output: str | os.PathLike[str], kind: str) -> str:
    """Return the kind that a result takes in an output of this name: its own, or `TABLE`."""
    return TABLE if kind in TABULAR and is_table(output) else kind


def named(kind: str) -> str:
    """Return a kind of output with its article: ``a trajectory``."""
    what = KINDS.get(kind) or _OTHERS.get(kind, (kind,))[0]
    return f"{'an' if what[0].lower() in 'aeiou' or what.startswith('XDMF') else 'a'} {what}"


def _status(path: Path) -> os.stat_result | None:
    try:
        return os.stat(path)
    except FileNotFoundError:
        return None


def _is_same(found: os.stat_result, source: str | os.PathLike[str]) -> bool:
    try:
        return os.path.samestat(found, os.stat(source))
    except (OSError, ValueError):
        return False  # the reader of the input says what is wrong with it


def _check_place(output: str | os.PathLike[str], target: Path, found: os.stat_result | None) -> None:
    """Raise `InputError` unless a regular file can be made at ``target``."""
    directory, mode = target.parent, stat.S_IFREG if found is None else found.st_mode
    if stat.S_ISDIR(mode):
        raise InputError(f"output file '{output}' is a directory; give the name of a file in it")
    if not stat.S_ISREG(mode):
        raise InputError(f"output file '{output}' is a device, a pipe or a socket; give the name of a file")
    if not directory.is_dir():
        raise InputError(f"output file '{output}': directory '{directory}' does not exist; create it first")
    if not os.access(directory, os.W_OK | os.X_OK):
        raise InputError(f"output file '{output}': no permission to write in directory '{directory}'")
    longest, n = os.pathconf(directory, "PC_NAME_MAX") - _LONGEST_ADDITION, len(os.fsencode(target.name))
    if n > longest:
        why = f"allowed: {longest}, because files beside it have longer names"
        raise InputError(f"output file '{output}': its name has {n} bytes; {why}")


def _check_ending(output: str | os.PathLike[str], kind: str) -> None:
    """Raise `InputError` where the name says that the file has another format."""
    what, own, _ = _OTHERS.get(kind, ("HDF5", _HDF5_ENDINGS, b""))
    path = Path(output)
    if path.suffix.lower() in _ENDINGS - {*own}:
        cure = f"is written as {own[0][1:].upper() if kind in _OTHERS else what}: name it '{path.with_suffix(own[0])}'"
        ending = f"the ending {path.suffix} is that of another format"
        raise InputError(f"output file '{output}': {ending}; {named(kind)} {cure}")


def _check_replaceable(output: str | os.PathLike[str], target: Path, kind: str) -> None:
    """Raise `InputError` unless an existing file is a result of the same kind."""
    why = ""
    if kind == TABLE and target.stat().st_size:
        why = "exists, and nothing in a CSV file says whose it is; give another name, or remove it"
    elif (found := _kind_of(target, kind)) is None:
        why = f"exists and is not {named(kind)} of this program; give another name, or move it away"
    elif found != kind:
        why = f"exists and holds {named(found)}, not {named(kind)}; give another name, or remove it"
    if why:
        raise InputError(f"output file '{output}' {why}")


def _kind_of(path: Path, wanted: str) -> str | None:
    """Return what an existing file holds; None where it is not of this program."""
    if path.stat().st_size == 0:
        return wanted  # nothing is lost
    if wanted in _OTHERS:
        return wanted if _contains(path, _OTHERS[wanted][2]) else None
    try:
        return seal_of(path).kind
    except BrokenSeal:
        # Results of older versions have no seal, and a damaged one names no kind: both have to be written again.
        return wanted if _begins(path, MAGIC) or _contains(path, *_OLD_RESULT) else None


def _begins(path: Path, text: bytes) -> bool:
    with open(path, "rb") as stream:
        return stream.read(len(text)) == text


def _contains(path: Path, *parts: bytes) -> bool:
    with open(path, "rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        return all(data.find(part) >= 0 for part in parts)


def _reason(error: OSError, path: Path) -> str:
    """Return what the system says of a file that cannot be made, with the cure where there is one."""
    if isinstance(error, FileNotFoundError) and path.is_absolute() and path.parent.is_dir():
        return f"no file can be made in the folder '{path.parent}'; give another one"
    if isinstance(error, FileNotFoundError):
        return "the working directory, or that of the output, was removed; go to one that exists"
    return error.strerror or str(error)


def synchronise_file(path: Path) -> None:
    """Push a file to the disk; raises `OSError` if the system fails to write it."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def first_line(error: OSError) -> str:
    """Return what the system says ("No space left on device"), or else the first line of the message."""
    if error.errno:
        return os.strerror(error.errno)
    return (str(error).splitlines() or [type(error).__name__])[0]


@contextmanager
def replacing(path: str | os.PathLike[str], what: str = "output file", pushed: bool = True) -> Iterator[Path]:
    """Yield another name to write to; the file takes the place of ``path`` when the block ends without an error.

    It is pushed to the disk before that; what is not `pushed` outlives its process, but perhaps not its machine. To be
    called by one process only. Raises `RunError`, saying what it is, if the system fails to write (a full disk, say);
    an older file under ``path`` is left as it was.
    """
    path = Path(path)
    partial = partial_path(path, os.getpid())
    remove_at_end(partial)
    try:
        yield partial
        if pushed:
            synchronise_file(partial)
        os.replace(partial, path)
        if pushed:
            with suppress(OSError):  # some file systems refuse to push names to the disk
                synchronise_file(path.parent)
    except OSError as error:
        raise RunError(f"{what} '{path}' could not be written: {first_line(error)}") from error
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        keep_no_longer(partial)
