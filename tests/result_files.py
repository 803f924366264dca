"""What commands write for one scene, and whether two result files hold the same."""

import json
import os
import subprocess
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np
import warm_start
from conftest import ALONE, MPI_ENVIRONMENT, ROOT, TIMEOUT_SECONDS
from runs import PAPER_SCENE, SMALL, overridden

QUICK = (*SMALL, "ensemble.bands=10")
KINDS = ("rom", "run", "ensemble", "derivatives")
# runs several commands one after the other and prints the exit status of each
ONE_BY_ONE = """
import json, sys
from pgmp_petsc.cli.main import main
for argv in json.loads(sys.argv[1]):
    try:
        main(argv)
    except SystemExit as end:
        print(json.dumps([end.code]), flush=True)
"""


def written_by_commands(folder: Path, *launcher: object, further: Sequence[list[str]] = ()) -> Path:
    """Let commands write a file of every one of `KINDS`, and "full", into a folder; return it.

    `launcher` is what runs Python's ``-c`` in place of the interpreter of the tests, `further` are more commands.
    """
    rom, run, ensemble, derivatives, full = (str(folder / f"{name}.h5") for name in (*KINDS, "full"))
    calls = [
        ["build", str(PAPER_SCENE), "-o", rom, *overridden(*QUICK)], ["simulate", rom, "-o", run, "--set", "r1=5e-3"],
        ["montecarlo", rom, "-n", "12", "--seed", "7", "-o", ensemble], ["sensitivities", rom, "-o", derivatives],
        ["simulate", str(PAPER_SCENE), "--full", "-o", full, "--set", "r1=5e-3", *overridden(*QUICK)], *further,
    ]  # fmt: skip
    done = in_turn(calls, *launcher)
    assert statuses(done) == [0] * len(calls), done.stdout + done.stderr
    return folder


def in_turn(calls: list[list[str]], *launcher: object, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run commands one after the other in one process, with further variables of the environment."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **MPI_ENVIRONMENT, **ALONE, **variables}
    command = [*warm_start.python(environment), *map(str, launcher), "-c", ONE_BY_ONE, json.dumps(calls)]
    return subprocess.run(command, capture_output=True, text=True, env=environment, timeout=TIMEOUT_SECONDS)


def statuses(done: subprocess.CompletedProcess[str]) -> list[int]:
    """Return the exit statuses of the commands that `in_turn` ran."""
    return [json.loads(line)[0] for line in done.stdout.splitlines() if line.startswith("[")]


def bits(value: object) -> bytes:
    """Return all of a value; of texts, whose arrays hold references, what they say."""
    array = np.asarray(value)
    return repr(array.tolist()).encode() if array.dtype.kind == "O" else array.tobytes()


def contents(path: Path) -> dict[str, bytes]:
    """Return every dataset and attribute of a file but those that say how it was made."""
    found = {}

    def visit(name: str, item: h5py.Dataset | h5py.Group) -> None:
        if not name.startswith("timings"):
            found.update({f"{name}@{key}": bits(value) for key, value in item.attrs.items()})
            if isinstance(item, h5py.Dataset):
                found[name] = bits(item[()])

    with h5py.File(path) as file:
        file.visititems(visit)
        found["scene"] = file.attrs["scene"].encode()
        found["parameters"] = file.attrs["parameters"].encode()
        found["remarks"] = file.attrs["remarks"].encode()
    return found


def assert_same(one: Path, other: Path) -> None:
    first, second = contents(one), contents(other)
    assert first.keys() == second.keys()
    assert [name for name in first if first[name] != second[name]] == []
