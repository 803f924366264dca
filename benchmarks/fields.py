"""Random fields and rare events: expansions, probabilities that are known, and what many parameters cost.

    python -m benchmarks.fields eigenvalues
    python -m benchmarks.fields rare [--samples 5000 --repetitions 400 --at 1e-3 1e-4 1e-5 --of ball "plane, 20"]
    python -m benchmarks.fields cost

`eigenvalues` compares those of the exponential kernel on an interval with the closed form (Ghanem and Spanos 1991,
section 2.3.3). `rare` finds probabilities of `limit_states`, whose true ones are known, with seeds of their own, and
counts which of the runs whose intervals miss have warned. `cost`
builds reduced models of the slider-crank with a spring and friction in its elbow, with one uncertain parameter (a
radius) and with twelve (both radii, modulus, density, the spring's stiffness, the friction's limit and a field of six
terms), runs samples of both in turn and gives the least processor time of each.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy.optimize import brentq

from benchmarks.limit_states import limit_states
from benchmarks.programs import end, guarded
from benchmarks.tables import Table
from pgmp_petsc.bodies.random_fields import expansion
from pgmp_petsc.ensemble.integration import run_batch
from pgmp_petsc.ensemble.plan import Piece
from pgmp_petsc.ensemble.rare_events import RareSamples, find
from pgmp_petsc.ensemble.rare_run import rare_remarks
from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.ensemble.watchers import Watching
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.ranks.petsc import start_petsc
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.studies.inputs import read_scene

LENGTH, N_TERMS = 0.4, 6  # correlation length over that of the interval
CELLS = (20, 40, 80, 160)
LEVEL = 0.95
OF_RUNS = ("probability", "by_levels")
NO_FAILURE = np.zeros(1)  # status of samples that are all fine
ROUNDS, N = 6, 512  # of runs of each model, and samples of a run
SCENE = Path(__file__).parents[1] / "scenes" / "slider_crank.toml"
ONE = (
    'bodies.crank.mesh="../meshes/crank_10.msh"',
    'bodies.rod.mesh="../meshes/rod_10.msh"',
    'effects.spring={type="spring_damper", joint="elbow", stiffness=0.5, damping=1e-3}',
    'effects.rub={type="joint_friction", joint="elbow", limit=1e-3, speed=0.1}',
    "reduction.angles=96",
)


def drawn(name: str, nominal: float, variation: float) -> str:
    """Return the override that makes an uncertain parameter."""
    scale, bounds = variation * nominal, [nominal * (1 - 5 * variation), nominal * (1 + 5 * variation)]
    law = f'{{name="norm", loc={nominal!r}, scale={scale!r}}}'
    return f"parameters.{name}={{nominal={nominal!r}, bounds={bounds!r}, distribution={law}}}"


TWELVE = (
    *ONE,
    drawn("r2", 5.6e-3, 0.05),
    drawn("young", 210e9, 0.03),
    drawn("density", 7800.0, 0.02),
    drawn("spring", 0.5, 0.1),
    drawn("rubbing", 1e-3, 0.15),
    'bodies.rod.section.radius="r2"',
    'materials.steel.E="young"',
    'materials.steel.rho="density"',
    'effects.spring.stiffness="spring"',
    'effects.rub.limit="rubbing"',
    'fields.soft={body="rod", quantity="E", variation=0.1, length=0.3, terms=6}',
)


def eigenvalues() -> Table:
    """Return how far eigenvalues on meshes are from the closed form."""
    exact = closed_form(1.0, LENGTH, N_TERMS)
    rows = []
    for n in CELLS:
        ends = np.linspace(0.0, 1.0, n + 1)
        middles = 0.5 * (ends[1:] + ends[:-1])[:, None]
        found = expansion(middles, np.diff(ends), "exponential", LENGTH, 0.5, N_TERMS).shares
        rows.append([str(n), *(f"{off:.1e}" for off in found / exact - 1.0)])
    rows.append(["closed form", *(f"{value:.5f}" for value in exact)])
    words = (
        f"Relative errors of the eigenvalues of the exponential kernel, correlation length {LENGTH} of the interval."
    )
    return Table("Karhunen-Loeve", ["cells", *(f"term {k}" for k in range(1, N_TERMS + 1))], rows, words)


def closed_form(extent: float, length: float, n: int) -> np.ndarray:
    """Return the first eigenvalues of the exponential kernel on an interval."""
    a, c = 0.5 * extent, 1.0 / length
    found = []
    for k in range(n):

        def equation(x: float, even: bool = k % 2 == 0) -> float:
            return c * a * np.cos(x) - x * np.sin(x) if even else x * np.cos(x) + c * a * np.sin(x)

        w = brentq(equation, k * np.pi / 2 + 1e-12, (k + 1) * np.pi / 2) / a
        found.append(2.0 * c / (w**2 + c**2))
    return np.array(found)


def rare(n_samples: int, repetitions: int, at: Sequence[float], of: Sequence[str]) -> Table:
    """Return errors of probabilities and how often their intervals hold, of limit states whose names begin so."""
    rows = []
    for exact, (name, d, limit_state) in ((exact, one) for exact in at for one in limit_states(exact)):
        if f"{name}, {d}".startswith(tuple(of)):
            found = [find(limit_state, d, n_samples, seed) for seed in range(repetitions)]
            reached = [one for one in found if one.reached]
            figures = _figures(reached, exact) if reached else [""] * 8
            rows.append([f"{name}, {d}", f"{exact:.0e}", *figures, str(len(found) - len(reached))])
    header = [
        "limit state, parameters", "probability", "bias, %", "error, %", "said, %", "intervals that hold, %",
        "width, %", "of those that miss warn", "weighted samples", "error of the levels alone, %", "not reached",
    ]  # fmt: skip
    words = (
        f"Root-mean-square errors of {repetitions} runs of {n_samples} samples each; intervals of {100 * LEVEL:g} %, "
        "with their median width."
    )
    return Table("Rare events", header, rows, words)


def _figures(found: Sequence[RareSamples], exact: float) -> list[str]:
    """Return a row's figures of runs that have reached an event, in the order of the header of `rare`."""
    estimates, by_levels = (np.array([getattr(one, name) for one in found]) / exact for name in OF_RUNS)
    ends = np.array([one.interval(LEVEL) for one in found]) / exact
    hold = (ends[:, 0] <= 1.0) & (1.0 <= ends[:, 1])
    missing = [one for one, holds in zip(found, hold) if not holds]
    warned = [any(said.kind == "warning" for said in rare_remarks(one, NO_FAILURE, True)) for one in missing]
    off, levels = (np.sqrt(np.mean((values - 1.0) ** 2)) for values in (estimates, by_levels))
    said, weighted = np.mean([(one.variation, one.weights.size) for one in found], axis=0)
    shares = estimates.mean() - 1.0, off, said, hold.mean(), np.median(ends[:, 1] - ends[:, 0])
    return [
        *(f"{100 * share:.1f}" for share in shares),
        f"{sum(warned)} of {len(missing)}", f"{weighted:.0f}", f"{100 * levels:.0f}",
    ]  # fmt: skip


def cost() -> Table:
    """Return the least processor time a sample with one and with twelve uncertain parameters, run in turn."""
    models = [_reduced(overrides) for overrides in (ONE, TWELVE)]
    rows = []
    for words, watched in (("runs alone", False), ("as an ensemble watches them", True)):
        times = np.empty((ROUNDS, len(models)))
        for number in range(ROUNDS):
            for k, model in enumerate(models):
                watchers = Watching(model).of(Piece(0, N)) if watched else []
                values, start = draw(model.scene, number, 0, N), time.process_time()
                run_batch(model, values, 0, watchers)
                times[number, k] = (time.process_time() - start) / N
        least = times[1:].min(axis=0)
        rows.append([words, *(f"{1e3 * t:.3g} ms" for t in least), f"{least[1] / least[0]:.2f}"])
    names = [f"{len(model.scene.parameters)} parameters, {len(model.terms.weights)} terms" for model in models]
    return Table("Cost of a sample", ["", *names, "ratio"], rows, f"Least of {ROUNDS - 1} runs of {N} samples.")


def _reduced(overrides: Sequence[str]) -> ReducedModel:
    with RankGroup.split(MPI.COMM_SELF, 1) as group:
        scene, meshes = read_scene(SCENE, overrides, (), MPI.COMM_SELF, Purpose.BUILD)
        return ReducedModel(scene, build_rom(scene, meshes, group))


def main(arguments: argparse.Namespace) -> None:
    """Measure what is asked for, and print it."""
    if arguments.what == "cost":
        table = cost()
    else:
        of_events = arguments.samples, arguments.repetitions, arguments.at, arguments.of
        table = eigenvalues() if arguments.what == "eigenvalues" else rare(*of_events)
    print(table.markdown())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("eigenvalues", "rare", "cost"))
    parser.add_argument("--samples", type=int, default=5000, help="of a rare event")
    parser.add_argument("--repetitions", type=int, default=400, help="of every limit state")
    parser.add_argument("--at", type=float, nargs="+", default=(1e-3, 1e-4, 1e-5), help="probabilities")
    parser.add_argument("--of", nargs="+", default=("",), help="limit states whose names, and variables, begin so")
    arguments = parser.parse_args()
    start_petsc()
    end(guarded(lambda: main(arguments)))
