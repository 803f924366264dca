"""Whether beams of very many elements still have the frequencies that coarser ones converge to.

    python -m benchmarks.scaling.fine_beams scenes/slider_crank.toml -o beams.json

Every beam of the scene becomes a straight line of as many elements. Frequencies converge with the second power of the
elements' length h, so those of two coarse lines extrapolate to h = 0 (Richardson),

    f = f_2n + (f_2n - f_n) / 3,

and the next pair says what the extrapolation itself is worth. Round-off grows the other way, with the ratio of the
stiffest elements to the softest motion, h^-4: the program has to have the extrapolated frequencies or to say why not.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI

from benchmarks.programs import end, guarded
from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.files.claims import check_output, replacing
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.ranks.petsc import start_petsc
from pgmp_petsc.scene.schema import Scene
from pgmp_petsc.studies.inputs import read_scene

COARSE = (40, 80, 160)
FINE = (1000, 2000, 5000, 10000)
PLACE = 0.11  # of the angle in the coordinates' ranges: no special configuration
TOLERANCE = 1e-5


@dataclass(frozen=True)
class FineBeams:
    """Frequencies of lines of many elements.

    Attributes
    ----------
    theta
        Configuration, rad.
    extrapolated
        From the two coarsest lines, Hz.
    uncertain
        Relative difference of the extrapolation from the next pair, largest of all frequencies.
    elements
        Elements a body, one a line.
    differences
        Relative to the extrapolated frequencies, one list a line; empty where the program refused.
    messages
        What the program said where it refused, else empty.
    """

    theta: list[float]
    extrapolated: list[float]
    uncertain: float
    elements: list[int]
    differences: list[list[float]]
    messages: list[str]

    def verdict(self, row: int) -> str:
        """Return whether a line meets the requirement: `TOLERANCE`, or a reason."""
        if self.messages[row]:
            return f"refused: {self.messages[row]}"
        largest = max(map(abs, self.differences[row]))
        return "ok" if largest <= TOLERANCE else f"off by {largest:.1e} and not a word of it"


def measure(path: Path, fine: Sequence[int], coarse: Sequence[int], comm: MPI.Comm) -> FineBeams:
    """Compare fine lines with the extrapolation of three coarse ones, each of twice as many elements as the last.

    Collective on `comm`.
    """
    found = [frequencies(path, n, comm) for n in coarse]
    (theta, _), values = found[0], [hz for _, hz in found]
    one, two = ((4.0 * after - before) / 3.0 for before, after in zip(values, values[1:]))
    differences, messages = [], []
    for n in fine:
        try:
            differences.append((frequencies(path, n, comm)[1] / one - 1.0).tolist())
            messages.append("")
        except RunError as error:
            differences.append([])
            messages.append(str(error))
    uncertain = float(np.max(np.abs(two / one - 1.0)))
    return FineBeams(theta.tolist(), one.tolist(), uncertain, list(fine), differences, messages)


def frequencies(path: Path, n_elements: int, comm: MPI.Comm) -> tuple[np.ndarray, np.ndarray]:
    """Return a configuration (n_theta,), rad, and the frequencies there (n_modes,), Hz. Collective on `comm`.

    Raises
    ------
    InputError
        If a body is no straight beam along the x axis.
    RunError
        If the eigenproblem fails.
    """
    scene, kinematics = refined(path, n_elements, comm)
    theta = np.array([c.lower + PLACE * (c.upper - c.lower) for c in kinematics.coordinates])
    with ModalProblem(kinematics, scene.nominal, scene.reduction.modes, comm) as problem:
        return theta, problem.solve(theta).frequencies_hz


def refined(path: Path, n_elements: int, comm: MPI.Comm) -> tuple[Scene, RigidKinematics]:
    """Return a scene whose beams are lines of as many elements, and its kinematics. Collective on `comm`.

    Raises
    ------
    InputError
        If a body is no straight beam along the x axis.
    """
    scene, meshes = read_scene(path, (), (), comm, Purpose.MODES)
    overrides = []
    for name, body in scene.bodies.items():
        x, *others = np.asarray(meshes[name].nodes).T
        if body.continuum or np.ptp(others) > 0.0:
            raise InputError(f"bodies.{name}: a beam along the x axis is needed to make a line of many elements of it")
        entries = body.model_dump(exclude_unset=True, exclude={"mesh", "line"})
        entries["line"] = {"length": float(np.ptp(x)), "elements": n_elements, "start": float(x.min())}
        overrides.append(f"bodies.{name}={toml(entries)}")
    scene, meshes = read_scene(path, overrides, (), comm, Purpose.MODES)
    return scene, RigidKinematics(Mechanism.from_scene(scene, meshes))


def toml(value: object) -> str:
    """Write a value on one line of TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(entry)}" for key, entry in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value)


def parse_arguments() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(prog="benchmarks.scaling.fine_beams", description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="BEAMS.json", help="record to write")
    parser.add_argument("--elements", type=int, nargs="+", default=FINE, metavar="N", help="elements a body")
    return parser.parse_args()


def run(arguments: argparse.Namespace) -> None:
    """Measure, write the record and print one line each."""
    check_output(arguments.output, "beams", (arguments.scene,))
    beams = measure(arguments.scene, arguments.elements, COARSE, MPI.COMM_SELF)
    with replacing(arguments.output) as waiting:
        waiting.write_text(json.dumps(asdict(beams), indent=1) + "\n", encoding="utf-8")
    for row, n in enumerate(beams.elements):
        largest = max(map(abs, beams.differences[row]), default=math.nan)
        print(f"{n} elements a body: {largest:.1e}, {beams.verdict(row)}", flush=True)


def main() -> int:
    """Measure the scene on the command line."""
    arguments = parse_arguments()
    start_petsc()
    return guarded(lambda: run(arguments))


if __name__ == "__main__":
    end(main())
