"""The first hour of an engineer: a part from CAD, and the same from a deck, to a report with a probability; timed.

    python -m benchmarks.first_hour [--folder FOLDER]

gmsh makes a connecting rod with two bores as a STEP file. What a user types then is run as it is, with default
settings: `pgmp new --from`, `pgmp check --plot`, `pgmp run`. The deck is an Abaqus file of the same part, with its
bores as sets of nodes, in the scene that `pgmp new` wrote. Printed are wall and processor times of every command and
what it starts, and the probability with its interval.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import meshio
import numpy as np

from benchmarks.tables import Table
from pgmp_petsc.mesh.solid_mesh_reading import read_part

MM = 1e-3
#: A program of its own, since gmsh brings libraries along: eyes at both ends, a shank of an H between them, in mm.
ROD = """
import sys, gmsh
gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
occ = gmsh.model.occ
eyes = [(3, occ.addCylinder(x, 0, -10, 0, 0, 20, r)) for x, r in ((0, 25), (150, 16))]
shank = occ.addBox(15, -9, -7, 130, 18, 14)
whole, _ = occ.fuse(eyes, [(3, shank)])
bores = [(3, occ.addCylinder(x, 0, -11, 0, 0, 22, r)) for x, r in ((0, 17), (150, 9))]
pockets = [(3, occ.addBox(30, -5, z, 100, 10, 6)) for z in (3, -9)]
occ.cut(whole, [*bores, *pockets])
occ.synchronize()
gmsh.write(sys.argv[1])
"""


class Typed:
    """Commands with their times."""

    def __init__(self, folder: Path) -> None:
        self._folder, self.rows = folder, list[list[str]]()

    def __call__(self, *words: str) -> None:
        """Run a command of the program; raises `subprocess.CalledProcessError` where it fails."""
        began, before = time.perf_counter(), os.times()
        print(f"$ pgmp {' '.join(words)}", flush=True)
        subprocess.run([sys.executable, "-m", "pgmp_petsc.cli.main", *words], cwd=self._folder, check=True)
        after = os.times()
        spent = after.children_user + after.children_system - before.children_user - before.children_system
        self.rows.append([f"pgmp {' '.join(words)}", f"{time.perf_counter() - began:.0f}", f"{spent:.0f}"])


def write_deck(part: Path, deck: Path) -> None:
    """Write an Abaqus file of a part's mesh in mm, with its whole cylinders as sets of nodes."""
    found = read_part(part, str(part), MM)
    sets = {one.name: np.unique(found.mesh.groups[one.name]) for one in found.cylinders}
    mesh = meshio.Mesh(found.mesh.nodes, [(found.mesh.kind, found.mesh.cells)], point_sets=sets)
    meshio.write(deck, mesh, float_fmt=".17e")


def probability(samples: Path) -> str:
    """Return the probabilities of an ensemble in words."""
    with h5py.File(samples) as file:
        found = {
            label: (event["estimate"][()], *event["interval"][()]) for label, event in file["probabilities"].items()
        }
    return ", ".join(f"P({label}) = {p:.3g} [{low:.3g}, {high:.3g}]" for label, (p, low, high) in found.items())


def first_hour(folder: Path) -> None:
    """Play it in a folder, and print the times."""
    subprocess.run([sys.executable, "-c", ROD, folder / "rod.step"], check=True, stdout=subprocess.DEVNULL)
    typed, rows = Typed(folder), []
    typed("new", "rod", "--from", "rod.step")
    typed("check", "rod.toml", "--plot", "mechanism.png")
    typed("run", "rod.toml")
    rows.append(["STEP file", probability(folder / "rod_results" / "samples.h5")])
    write_deck(folder / "rod.step", folder / "rod.inp")
    text = (folder / "rod.toml").read_text().replace('mesh = "rod.step"', 'mesh = "rod.inp"')
    (folder / "deck.toml").write_text(text)
    typed("check", "deck.toml")
    typed("run", "deck.toml")
    rows.append(["Abaqus deck", probability(folder / "deck_results" / "samples.h5")])
    for name in ("rod", "deck"):
        assert (folder / f"{name}_results" / "report.html").stat().st_size
    total = [str(sum(int(row[k]) for row in typed.rows)) for k in (1, 2)]
    times = Table("The first hour", ["command", "wall s", "processor s"], [*typed.rows, ["all", *total]])
    print(times.markdown(), Table("What it says", ["from", "probability"], rows).markdown(), sep="\n\n")


def parse() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, help="a folder that stays; one that is removed if not given")
    return parser.parse_args()


def main() -> None:
    """Run the benchmark."""
    folder = parse().folder
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        first_hour(folder)
        return
    with TemporaryDirectory(prefix="pgmp_first_hour_") as own:
        first_hour(Path(own))


if __name__ == "__main__":
    main()
