"""A wheel in a bare environment: what works without PETSc and MPI, whether its numbers are the same, and what it takes.

    scripts/wheel_check [--newest] [--folder FOLDER]

Each command of `COMMANDS` is run with .venv's pgmp and with that of the wheel, on the same files. Of what they write
every number but wall times is compared: how many datasets agree in every bit, and the largest difference of the others
as a share of the dataset's largest value.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import numpy as np

from benchmarks.tables import Table

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ("setup.cfg", "pyproject.toml", "README.md", "LICENSE")
#: What is made with .venv alone, then what both do; the scenes are of beams, but for one of solids.
MODELS = {
    "beams.h5": ("build", "scenes/slider_crank.toml"),
    "solids.h5": ("build", "scenes/slider_crank_solid2d.toml"),
}
COMMANDS = {
    "run.h5": ("simulate", "{made}/beams.h5"),
    "run_of_solids.h5": ("simulate", "{made}/solids.h5"),
    "ensemble.h5": ("montecarlo", "{made}/beams.h5", "-n", "256", "--seed", "7"),
    "derivatives.h5": ("sensitivities", "{made}/beams.h5"),
    "full.h5": ("simulate", "{root}/scenes/slider_crank.toml", "--full"),
    "rebuilt.h5": ("build", "{root}/scenes/slider_crank.toml"),
}
PAGES = {
    "report.html": ("report", "{made}/beams.h5", "{made}/run.h5", "{made}/ensemble.h5"),
    "pictures": ("plot", "{made}/run.h5", "{made}/ensemble.h5"),
}
REFUSED = ("build", "{root}/scenes/slider_crank_solid2d.toml")
STARTS = {
    "python -c pass": ("-c", "pass"),
    "import pgmp_petsc": ("-c", "import pgmp_petsc"),
    "pgmp --help": ("-m", "pgmp_petsc.cli.main", "--help"),
    "import pgmp_petsc; pgmp_petsc.simulate": ("-c", "import pgmp_petsc; pgmp_petsc.simulate"),
}
REPEATS = 5
#: Packages that numbers and pictures depend on.
OF_NUMBERS = ("numpy", "scipy", "numba", "llvmlite", "matplotlib")


def make_environment(folder: Path, newest: bool) -> Path:
    """Make a wheel of the package and an environment with nothing but it and what it requires; return its Python."""
    python = folder / "bare" / "bin" / "python"
    if python.exists():
        return python
    source = folder / "source"
    shutil.copytree(ROOT / "pgmp_petsc", source / "pgmp_petsc", ignore=shutil.ignore_patterns("__pycache__"))
    for name in SOURCES:
        shutil.copy(ROOT / name, source)
    base = os.environ.get("WHEEL_PYTHON", sys.executable)
    pip = ("-m", "pip", "--disable-pip-version-check", "--quiet")
    run(sys.executable, *pip, "wheel", source, "--no-deps", "--wheel-dir", folder)
    run(base, "-m", "venv", folder / "bare")
    versions = [] if newest else [f"{name}=={metadata.version(name)}" for name in OF_NUMBERS]
    (folder / "versions.txt").write_text("\n".join(versions))
    wheel = next(folder.glob("*.whl"))
    run(python, *pip, "install", "--constraint", folder / "versions.txt", f"{wheel}[all]")
    return python


def run(*words: object, check: bool = True) -> subprocess.CompletedProcess[str]:
    """Run a program away from the checkout; show what it says if it fails."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    if words[0] == sys.executable:
        environment["PYTHONPATH"] = str(ROOT)
    done = subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, env=environment, cwd="/", check=False
    )
    if check and done.returncode:
        raise SystemExit(f"{' '.join(map(str, words))}\n{done.stdout}{done.stderr}")
    return done


def timed(*words: object) -> float:
    """Run a program; return how long it took, s."""
    start = time.perf_counter()
    run(*words)
    return time.perf_counter() - start


def call(python: Path | str, folder: Path, output: str, words: Sequence[str], made: Path) -> float:
    """Run a command of pgmp; return how long it took, s."""
    filled = [word.format(made=made, root=ROOT) for word in words]
    return timed(python, "-m", "pgmp_petsc.cli.main", *filled, "-o", folder / output)


def datasets(path: Path) -> dict[str, np.ndarray]:
    """Return the datasets of a result but wall times."""
    found = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return {name: np.asarray(value) for name, value in found.items() if not name.startswith("timings/")}


def compare(one: Path, other: Path) -> tuple[int, int, float, str]:
    """Return of two results how many datasets they have, how many agree, the largest difference and where it is."""
    a, b = datasets(one), datasets(other)
    if a.keys() != b.keys():
        raise SystemExit(f"{one} and {other} have other datasets: {', '.join(sorted(a.keys() ^ b.keys()))}")
    equal, largest, where = 0, 0.0, ""
    for name, value in a.items():
        if bits(value) == bits(b[name]):
            equal += 1
        elif (share := difference(value, b[name])) >= largest:
            largest, where = share, name
    return len(a), equal, largest, where


def bits(value: np.ndarray) -> bytes:
    """Return all of a dataset; of texts what they say."""
    return repr(value.tolist()).encode() if value.dtype.kind == "O" else repr(value.shape).encode() + value.tobytes()


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Return the largest difference as a share of the largest value; infinite where they are not of a kind."""
    if a.dtype.kind not in "fiu" or a.shape != b.shape or np.any(np.isfinite(a) != np.isfinite(b)):
        return np.inf
    finite = np.isfinite(a)
    return float(np.max(np.abs(a[finite] - b[finite]), initial=0.0) / np.max(np.abs(a[finite]), initial=1e-300))


def numbers(folder: Path, python: Path) -> Iterator[Table]:
    """Run all commands in both environments; yield what agrees, and how long they took."""
    made, bare = folder / "made", folder / "by_wheel"
    for path in (made, bare):
        path.mkdir(exist_ok=True)
    for output, (command, scene) in MODELS.items():
        call(sys.executable, made, output, (command, str(ROOT / scene)), made)
    rows = []
    for output, words in COMMANDS.items():
        own = call(sys.executable, made, output, words, made)
        first, again = (call(python, bare, output, words, made) for _ in range(2))
        n, equal, largest, where = compare(made / output, bare / output)
        shown = "" if equal == n else f"{largest:.1e} ({where})"
        rows.append([output, f"{equal} of {n}", shown, f"{own:.1f}", f"{first:.1f}", f"{again:.1f}"])
    header = ("file", "equal datasets", "largest difference", ".venv, s", "wheel, first, s", "again, s")
    yield Table("Results", header, rows)
    pages = []
    for output, words in PAGES.items():
        for environment, place in ((sys.executable, made), (python, bare)):
            call(environment, place, output, words, made)
        ours, theirs = (contents(place / output) for place in (made, bare))
        same = sum(theirs.get(name) == text for name, text in ours.items())
        pages.append([output, f"{same} of {len(ours)}"])
    yield Table("Pages and pictures of the same results", ("", "equal files"), pages)


def contents(path: Path) -> dict[str, bytes]:
    """Return the bytes of a file, or of all in a folder."""
    return {each.name: each.read_bytes() for each in (sorted(path.iterdir()) if path.is_dir() else [path])}


def starts(python: Path) -> Table:
    """Return how long it takes to start, the least of some."""
    rows = [
        [name, *(f"{min(timed(one, *words) for _ in range(REPEATS)):.2f}" for one in (sys.executable, python))]
        for name, words in STARTS.items()
    ]
    return Table("Starts", ("", ".venv, s", "wheel, s"), rows)


def main() -> None:
    """Make the environment in a folder, and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--newest", action="store_true", help="Take what pip chooses, not the versions of .venv.")
    parser.add_argument("--folder", type=Path, help="Where environment and files are kept; temporary otherwise.")
    arguments = parser.parse_args()
    with TemporaryDirectory(prefix="pgmp_wheel_") as temporary:
        folder = (arguments.folder or Path(temporary)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        python = make_environment(folder, arguments.newest)
        absent = run(python, "-c", "from pgmp_petsc.base.surroundings import missing; print(*missing())").stdout.split()
        print(f"without {', '.join(absent)}")
        print(f"\n{starts(python).markdown()}", flush=True)
        for table in numbers(folder, python):
            print(f"\n{table.markdown()}", flush=True)
        words = [word.format(root=ROOT) for word in REFUSED]
        done = run(python, "-m", "pgmp_petsc.cli.main", *words, "-o", folder / "refused.h5", check=False)
        print(f"\npgmp {' '.join(words)}: status {done.returncode}\n{done.stderr}")


if __name__ == "__main__":
    main()
