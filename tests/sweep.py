"""Every scene with every command, as a new user runs them: exit status, tracebacks, warnings, word of errors.

    .venv/bin/python tests/sweep.py [SCENE ...] [--ranks 1 2] [--whole]

prints a line a command. By default runs are cut to a few steps and angles, as in the suite
(tests/parallel/test_sweep.py); ``--whole`` takes the scenes as they stand, which needs hours.
"""

import argparse
import io
import json
import re
import sys
import tempfile
import time
import tomllib
import warnings
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass
from pathlib import Path

from conftest import ROOT, run_mpi

SCENES = sorted((ROOT / "scenes").glob("*.toml"))
# what makes a run short: as many steps, angles and samples as every path needs
STEPS = 2
ANGLES = {1: 12, 3: 4}  # along each of so many coordinates; with two, modes are followed over no fewer than the scene's
MOST_COORDINATES = 3  # of reduced models
TRACE = ("Traceback", "Warning:", "Segmentation", "PETSC ERROR")
OUTPUT = re.compile(r"estimated errors over the run|errors? (was|were|is|are) not estimated|not estimated")


def refusal(scene: Path, command: str) -> str | None:
    """Return part of the message with which a command refuses a scene, and must; None where it is to work."""
    tables = tomllib.loads(scene.read_text())
    bodies, parameters = tables["bodies"].values(), tables.get("parameters", {}).values()
    if command in ("build", "modes") and not any(body.get("flexible", True) for body in bodies):
        return "rigid"
    if command.startswith("montecarlo") and not any("distribution" in parameter for parameter in parameters):
        return "none has a distribution"
    if command in ("check --effects", "build", "modes") and len(tables["coordinates"]) > MOST_COORDINATES:
        return f"at most {MOST_COORDINATES} are taken"
    joints = tables["joints"].values()
    if command == "check --effects" and any("clearance" in joint for joint in joints):
        return "sizes of effects are those on joints without room"
    return None


@dataclass(frozen=True)
class Ending:
    """How one command ended."""

    scene: str  # its name
    command: str  # the first words
    status: tuple[int, ...]  # of all ranks
    out: str  # what rank 0 printed
    err: str
    seconds: float  # wall time
    refused: str | None = None  # words of the message with which it must end (see `refusal`); None where it is to work

    @property
    def faults(self) -> list[str]:
        found = [f"'{word}' on stderr" for word in TRACE if word in self.err]
        if len(set(self.status)) > 1:
            found.append(f"ranks end with {self.status}")
        if self.refused is not None and not (self.status[0] == 2 and self.refused in self.err):
            found.append(f"status {self.status[0]} instead of a refusal with '{self.refused}'")
        if self.refused is None and self.status[0] != 0:
            found.append(f"status {self.status[0]}: {self.err.strip()[-300:]}")
        if self.refused is None and self.wants_estimate and not OUTPUT.search(self.out):
            found.append("no word on errors")
        return found

    @property
    def wants_estimate(self) -> bool:
        """Whether the command's result is one whose errors a user asks for."""
        return self.command.split()[0] in ("simulate", "montecarlo")

    @property
    def estimate(self) -> str:
        """Return the line that speaks of estimated errors, without what came before it."""
        lines = [line.strip() for line in self.out.splitlines() if OUTPUT.search(line)]
        return lines[0] if lines else ""


def commands(scene: Path, folder: Path, whole: bool, alone: bool) -> Iterator[tuple[str, list[str]]]:
    """Yield name and arguments of every command; later ones read what earlier ones wrote, where they did.

    In short on several ranks, those alone on which there is work for these.
    """
    name, short = scene.stem, [] if whole else overrides(scene)
    files = {kind: str(folder / f"{name}_{kind}.h5") for kind in ("rom", "modes", "run", "full", "many", "manyfull")}
    can_be_reduced = refusal(scene, "build") is None
    yield "check", ["check", str(scene)]
    yield "check --effects", ["check", str(scene), "--effects", *short]
    yield "build", ["build", str(scene), "-o", files["rom"], *short]
    if whole or not can_be_reduced:  # with a model it does the same, and compares
        yield "modes", ["modes", str(scene), "-o", files["modes"], *short]
    if can_be_reduced:
        yield "modes --rom", ["modes", str(scene), "--rom", files["rom"], "-o", files["modes"], *short]
        yield "simulate", ["simulate", files["rom"], "-o", files["run"]]
        yield "montecarlo", ["montecarlo", files["rom"], "-n", "3", "--seed", "1", "-o", files["many"]]
    yield "simulate --full", ["simulate", str(scene), "--full", "-o", files["full"], *short]
    # that errors of samples are estimated as those of runs are is tested elsewhere
    unchecked = [] if whole else ["--override", "ensemble.checked_share=0.0"]
    many = ["montecarlo", str(scene), "--full", "-n", "2", "-o", files["manyfull"], *short, *unchecked]
    yield "montecarlo --full", many
    if not (whole or alone):  # the first rank does the rest
        return
    made = [file for kind, file in files.items() if kind != "rom" and Path(file).exists()]
    runs = [files[kind] for kind in ("run", "full") if files[kind] in made]
    yield "plot", ["plot", *(made if whole else runs[:1]), "-o", str(folder / "pictures")]
    for kind in ("run", "full"):
        if files[kind] in made:
            yield f"export {kind}", ["export", files[kind], "-o", str(folder / f"{name}_{kind}.xdmf")]
    for kind, file in files.items():
        if kind == "rom" and can_be_reduced or file in made:
            yield f"info {kind}", ["info", file]


def overrides(scene: Path) -> list[str]:
    """Return the overrides that make a scene's runs short: few steps of the scene's own size, few angles."""
    tables = tomllib.loads(scene.read_text())
    step = tables.get("simulation", {}).get("step", 1e-3)
    entries = [f"simulation.duration={STEPS * step!r}", "simulation.frames=3"]
    if len(tables["coordinates"]) in ANGLES:
        entries.append(f"reduction.angles={ANGLES[len(tables['coordinates'])]}")
    return [word for entry in entries for word in ("--override", entry)]


def sweep(scene: Path, ranks: int, folder: Path, whole: bool = False) -> list[Ending]:
    """Run every command on a scene, in this process or in one for each of several ranks; return how each ended."""
    report = folder / f"{scene.stem}.json"
    if ranks == 1:
        with warnings.catch_warnings():
            work(scene, folder, report, whole)
        return _endings(report)
    done = run_mpi(ranks, __file__, "--worker", scene, folder, report, int(whole), check_status=None)
    if not report.exists():
        return [Ending(scene.stem, "all", (done.returncode,), done.stdout, done.stderr, 0.0)]
    endings = _endings(report)
    if done.returncode != 0 or done.stderr.strip():
        endings.append(Ending(scene.stem, "end", (done.returncode,), done.stdout, done.stderr, 0.0))
    return endings


def _endings(report: Path) -> list[Ending]:
    return [Ending(**entry | {"status": tuple(entry["status"])}) for entry in json.loads(report.read_text())]


def work(scene: Path, folder: Path, report: Path, whole: bool) -> None:
    """Run the commands one after the other on all ranks; rank 0 writes the report after each."""
    from mpi4py import MPI

    from pgmp_petsc.cli.main import main

    warnings.simplefilter("always")
    comm = MPI.COMM_WORLD
    endings: list[Ending] = []
    for name, arguments in commands(scene, folder, whole, comm.size == 1):
        out, err, start = io.StringIO(), io.StringIO(), time.perf_counter()
        status = 0
        with redirect_stdout(out), redirect_stderr(err):
            try:
                main(arguments)
            except SystemExit as end:
                status = end.code or 0
        statuses = comm.gather(int(status))
        if comm.rank == 0:
            taken = time.perf_counter() - start
            printed = out.getvalue(), err.getvalue()
            endings.append(Ending(scene.stem, name, tuple(statuses), *printed, taken, refusal(scene, name)))
            report.write_text(json.dumps([asdict(ending) for ending in endings]))


def table(endings: Sequence[Ending], ranks: int) -> list[str]:
    """Return a line a command: scene, ranks, command, status, time, faults or what is said of errors."""
    return [
        f"{e.scene:22s} {ranks} {e.command:18s} {e.status[0]:3d} {e.seconds:7.1f} s  "
        f"{'FAULT ' + '; '.join(e.faults) if e.faults else e.estimate}"
        for e in endings
    ]


def run_as_script() -> int:
    """Sweep the scenes that are named, or all; return how many commands ended with a fault."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", type=Path)
    parser.add_argument("--ranks", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--whole", action="store_true")
    given = parser.parse_args()
    faults = 0
    for scene in given.scenes or SCENES:
        for ranks in given.ranks:
            with tempfile.TemporaryDirectory() as folder:
                endings = sweep(scene.resolve(), ranks, Path(folder), given.whole)
            print("\n".join(table(endings, ranks)), flush=True)
            faults += sum(bool(ending.faults) for ending in endings)
    print(f"{faults} faults")
    return faults


if __name__ == "__main__":
    if "--worker" in sys.argv:
        scene, folder, report, whole = sys.argv[-4:]
        work(Path(scene), Path(folder), Path(report), whole == "1")
    else:
        sys.exit(run_as_script() > 0)
