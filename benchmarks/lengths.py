"""Lengths as parameters: one reduced model over a range against models built at held-out lengths, and what it costs.

    python -m benchmarks.lengths accuracy [--points 4 5]
    python -m benchmarks.lengths cost

`accuracy` draws the rod of the slider-crank within 5 % of 0.7 m and compares frequencies of the modes at all angles and
a run of the scene's own duration with models that were built with held-out lengths. `cost` runs samples of an ensemble
with and without the drawn length in turn, with local effects and without, and gives the least processor time of each;
and that of making the model of one length, with exact kinematics, which a sample alone would take besides.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from mpi4py import MPI

from benchmarks.called import Called
from benchmarks.programs import end, guarded
from benchmarks.tables import Table
from pgmp_petsc.ensemble.integration import run_batch
from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import Model, ReducedModel, of_samples
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.ranks.petsc import start_petsc
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.second_order_system import State
from pgmp_petsc.studies.inputs import read_scene

SCENE = Path(__file__).parents[1] / "scenes" / "slider_crank.toml"
HELD_OUT = (0.668, 0.69, 0.711, 0.7293)
ROUNDS, N = 4, 256  # of runs of each model, and samples of a run
SPRING = '{type="spring_damper", points=["ground:origin", "rod:tip"], stiffness=50.0, damping=0.5, rest=0.9}'
ACTING = (
    f"effects.spring={SPRING}",
    'effects.brake={type="joint_friction", joint="elbow", limit=0.01, speed=0.1}',
)
LAW = '{name="uniform", loc=0.665, scale=0.07}'
DRAWN = f"parameters.rod_length={{nominal=0.7, distribution={LAW}}}"


def rod(length: str) -> str:
    """Return the override that makes the rod a straight line of a length, a number or a parameter's name."""
    section = '{shape="circle", radius=5.6e-3}'
    return f'bodies.rod={{line={{length={length}, elements=5}}, element="beam2d", material="steel", section={section}}}'


def accuracy(points: Sequence[int]) -> Table:
    """Compare frequencies and motion with those of models that were built with the lengths."""
    rows = []
    built = {length: _reduced((rod(repr(length)),)) for length in HELD_OUT}
    for n in points:
        start = time.process_time()
        model = _reduced((DRAWN, rod('"rod_length"'), f"reduction.length_points={n}"))
        seconds = time.process_time() - start
        for length, other in built.items():
            own = model.at_lengths(model.scene.with_values({"rod_length": length}))
            off = np.max(np.abs(_frequencies(own) / _frequencies(other) - 1.0))
            found, exact = _history(own), _history(other)
            motion = [np.abs(found[name] - exact[name]).max() / np.abs(exact[name]).max() for name in exact]
            rows.append([f"{n}", f"{length:g} m", f"{off:.1e}", *(f"{100 * share:.1e} %" for share in motion)])
        check = model.rom.family.check
        at = f"{check.values['rod_length']:.4g} m"
        rows.append([f"{n}", f"the build's own, {at}", f"{check.frequencies:.1e}", f"build: {seconds:.0f} s", "", ""])
    head = ["points", "length", "frequencies", *built[HELD_OUT[0]].outputs.units]
    return Table("Lengths of the rod", head, rows, "Largest differences from models built with the length.")


def cost() -> Table:
    """Compare the processor time of a sample with that of an ensemble without the length."""
    rows = []
    for what, entries in {"as it is": (), "with a spring and friction": ACTING}.items():
        models: list[Model] = [_reduced((rod("0.7"), *entries)), _reduced((DRAWN, rod('"rod_length"'), *entries))]
        start = time.process_time()
        models[1].at_lengths(models[1].scene.with_values({"rod_length": HELD_OUT[0]}))
        placed = time.process_time() - start
        models[1] = of_samples(models[1], ["rod_length"])
        times = np.empty((ROUNDS, 2))
        for number in range(ROUNDS):
            for k, model in enumerate(models):
                values = draw(model.scene, number, 0, N)
                start = time.process_time()
                run_batch(model, values)
                times[number, k] = (time.process_time() - start) / N
        least = times[1:].min(axis=0)
        rows.append([what, *(f"{1e3 * seconds:.3g} ms" for seconds in (*least, placed)), f"{least[1] / least[0]:.2f}"])
    head = ["slider-crank", "r1", "r1 and the rod's length", "to make a model of one length", "ratio of samples"]
    return Table("Cost of a sample", head, rows, f"Least of {ROUNDS - 1} runs of {N} samples.")


def _frequencies(model: ReducedModel) -> np.ndarray:
    return model.rom.tables.frequencies_hz(model.scene.nominal)[:, : model.rom.frequencies_hz.shape[1]]


def _history(model: ReducedModel) -> dict[str, np.ndarray]:
    system = model.batch({name: np.array([value]) for name, value in model.scene.values.items()}, 1)
    rows = []

    def record(step: int, at: float, state: State) -> None:
        rows.append(model.outputs.evaluate(model.observed(system, state)))

    integrate(system, model.scene.simulation, observer=Called(record))
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _reduced(overrides: Sequence[str]) -> ReducedModel:
    with RankGroup.split(MPI.COMM_SELF, 1) as group:
        scene, meshes = read_scene(SCENE, overrides, (), MPI.COMM_SELF, Purpose.BUILD)
        return ReducedModel(scene, build_rom(scene, meshes, group))


def main(arguments: argparse.Namespace) -> None:
    """Measure what is asked for, and print it."""
    print((cost() if arguments.what == "cost" else accuracy(arguments.points)).markdown())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("accuracy", "cost"))
    parser.add_argument("--points", type=int, nargs="+", default=[4, 5], help="Chebyshev points")
    parsed = parser.parse_args()
    start_petsc()
    end(guarded(lambda: main(parsed)))
