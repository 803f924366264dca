"""How far derivatives by differences are off, and what they say of that.

    .venv/bin/python -m benchmarks.differences scenes/servo_arm.toml [--components] [--parameter NAME] [--override ...]

They are compared with differences of fourth order of runs at other distances. For every output and parameter that one
counts which agrees best with its neighbours: what iterations leave grows as runs come nearer, and corners, jumps and
curvature as they go apart. Errors are shares of the largest effect that any of the parameters has on the output.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from mpi4py import MPI

from pgmp_petsc.bench.reference import component_model
from pgmp_petsc.gradients.differences import Differences
from pgmp_petsc.gradients.differentiated import _runs_beside, differentiate
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import Model, ReducedModel
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.studies.inputs import read_scene

SHARES = (1e-3, 3e-4, 1e-4, 6e-5, 1.5e-5, 8e-6, 4e-6)  # of a parameter's size, beside the two that are in use


def arguments() -> argparse.Namespace:
    """Return what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--components", action="store_true", help="of the component model, not the reduced one")
    parser.add_argument("--parameter", action="append", default=[], help="name of a parameter; all if not given")
    parser.add_argument("--override", action="append", default=[], help="entry of the scene")
    return parser.parse_args()


def model_of(given: argparse.Namespace) -> Model:
    """Return the model that the command line names."""
    purpose = Purpose.COMPONENTS if given.components else Purpose.REDUCED
    scene, meshes = read_scene(given.scene, given.override, (), MPI.COMM_SELF, purpose)
    if given.components:
        return component_model(scene, meshes, MPI.COMM_SELF)
    return ReducedModel(scene, build_rom(scene, meshes, RankGroup.split(MPI.COMM_SELF, 1)))


def best(effects: np.ndarray) -> np.ndarray:
    """Return of effects (n_shares, n_t) those that agree best with the ones beside them, at the next distances."""
    gaps = np.abs(np.diff(effects, axis=0)).max(axis=1)
    return effects[1 + np.argmin(gaps[:-1] + gaps[1:])]


def main() -> None:
    """Print the table."""
    given = arguments()
    model = model_of(given)
    names = given.parameter or list(model.scene.parameters)
    found = differentiate(model, model.scene.values, names)
    beside = [Differences.of(model, model.scene.values, names, share) for share in SHARES]
    runs = [_runs_beside(model, one)[2] for one in beside]
    print(f"{given.scene.name}, {model.title} model: said to be off by up to {found.off.share:.1e} (", end="")
    print(f"d {found.off.output} / d {found.off.parameter})\n| output | parameter | off |\n| --- | --- | --- |")
    for output, derivatives in found.derivatives.items():
        each = [one.slopes(values[output]).effects for one, values in zip(beside, runs)]
        true = {name: best(np.array([effects[name] for effects in each])) for name in names}
        largest = max(float(np.abs(effect).max()) for effect in true.values())
        for name, size in zip(names, beside[0].sizes):
            off = np.abs(size * derivatives[name] - true[name]).max()
            print(f"| {output} | {name} | {off / largest if largest else 0.0:.1e} |", flush=True)


if __name__ == "__main__":
    main()
