"""How good the error indicator is: estimated over true errors of many samples, for several reductions and torques.

    python -m pgmp_petsc.studies.effectivity scenes/slider_crank.toml [--samples 200] [--refinement 8]

The true error of a reduced run is its largest distance over time from a full-order run whose step is `refinement` times
smaller. The effectivity is the largest estimated error over that; the table shows its spread over the samples. They
are drawn from the scene's distributions, and none of them has a part in building the reduced model.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI

from pgmp_petsc.dynamics.generalised_alpha import State, integrate
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.indicator.error_indicator import ErrorIndicator
from pgmp_petsc.models import FullModel, Model, ReducedModel
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.runtime.errors import PgmpError
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.studies.inputs import read_scene
from pgmp_petsc.studies.paper_tables import Table

# whole tables, so that nothing is left of the scene's own
SMALL = 'reduction={modes=7, static_modes=true, angles=48, interpolation="spline"}'
SETTINGS = {
    "7 modes and a static one, 48 angles, splines": (SMALL,),
    "the same, and terms of second order": (SMALL, "reduction.second_order=true"),
    "15 modes, 629 angles, Overhauser": ('reduction={modes=15, angles=629, interpolation="overhauser"}',),
}
HALF_SINE = [[float(t), float(0.8 * np.sin(np.pi * t))] for t in np.linspace(0.0, 1.0, 201)]
TORQUES = {
    "ramp": "[[0.0, 0.0], [0.25, 0.5], [1.0, 0.5]]",
    "half sine": str(HALF_SINE),
    "reversal": "[[0.0, 0.0], [0.25, 0.5], [0.5, 0.5], [0.75, -0.5], [1.0, -0.5]]",
    "reversed ramp": "[[0.0, 0.5], [0.75, 0.5], [1.0, 0.0]]",
    "sudden step": "[[0.0, 0.5], [1.0, 0.5]]",
    "step between two steps": "[[0.0, 0.0], [0.2, 0.0], [0.2005, 0.5], [1.0, 0.5]]",
}
FACTOR = 3.0
SEED = 123
MOTOR = "motor"

Histories = dict[str, np.ndarray]  # output over time, shape (n_t, n)


@dataclass(frozen=True)
class Effectivity:
    """Estimated over true errors of one output.

    Attributes
    ----------
    setting, torque, output
        What was run, and what was looked at.
    error
        Median of the largest true errors as a share of the output's largest value.
    ratios
        Largest estimated over largest true error, shape (n,); NaN without an estimate.
    """

    setting: str
    torque: str
    output: str
    error: float
    ratios: np.ndarray

    @property
    def within(self) -> float:
        """Share of the samples whose estimate is within a factor `FACTOR` of the true error."""
        return float(np.mean((self.ratios >= 1.0 / FACTOR) & (self.ratios <= FACTOR)))


def history(model: Model, values: Mapping[str, np.ndarray], every: int = 1) -> Histories:
    """Integrate samples and return their outputs at every n-th step; NaN where a sample failed."""
    n = len(next(iter(values.values())))
    system, rows = model.batch(values, n), []

    def record(number: int, time: float, state: State) -> None:
        if number % every == 0:
            rows.append(model.outputs.evaluate(model.output_frames(system, state)))

    run = integrate(system, model.scene.simulation, observer=record)
    fine = run.status == Status.FINE
    return {name: np.where(fine, [row[name] for row in rows], np.nan) for name in model.outputs.functions}


def compare(model: ReducedModel, exact: Histories, values: Mapping[str, np.ndarray]) -> dict[str, tuple[float, np.ndarray]]:
    """Return median relative error and effectivities of every output of a reduced model."""
    n = len(next(iter(values.values())))
    found = history(model, values)
    watched = ErrorIndicator(model).watch(values, np.arange(n))
    run = integrate(model.batch(values, n), model.scene.simulation, observer=watched.observe)
    largest = watched.estimate(run.status).largest
    result = {}
    for name, reference in exact.items():
        true = np.max(np.abs(found[name] - reference), axis=0)
        result[name] = float(np.median(true / np.max(np.abs(reference), axis=0))), largest[name] / true
    return result


def measure(
    path: Path, n_samples: int, refinement: int, settings: Sequence[str] = (), torques: Sequence[str] = ()
) -> list[Effectivity]:
    """Measure the effectivity of settings and torques, all of them by default."""
    comm, results = MPI.COMM_SELF, []
    roms = {}
    for torque in torques or TORQUES:
        load = f"effects.{MOTOR}.table={TORQUES[torque]}"
        scene, meshes = read_scene(path, (load,), (), comm)
        values = draw(scene, SEED, 0, n_samples)
        fine, _ = read_scene(path, (load, f"simulation.step={scene.simulation.step / refinement!r}"), (), comm)
        exact = history(FullModel(fine, meshes), values, refinement)
        for setting in settings or SETTINGS:
            reduced, _ = read_scene(path, (*SETTINGS[setting], load), (), comm)
            if setting not in roms:
                roms[setting] = build_rom(reduced, meshes, RankGroup.split(comm, 1))
            for output, (error, ratios) in compare(ReducedModel(reduced, roms[setting]), exact, values).items():
                results.append(Effectivity(setting, torque, output, error, ratios))
    return results


def table(results: Sequence[Effectivity], n_samples: int, refinement: int) -> Table:
    """Show the spread of the effectivities."""
    rows = []
    for item in results:
        spread = np.nanquantile(item.ratios, [0.0, 0.05, 0.5, 0.95, 1.0])
        cells = (f"{value:.2f}" for value in spread)
        rows.append(
            [item.setting, item.torque, item.output, f"{100 * item.error:.2g} %", *cells, f"{100 * item.within:.1f} %"]
        )
    header = (
        "reduction", "torque", "output", "true error", "least", "5 %", "median", "95 %", "largest", f"within {FACTOR:g}"
    )
    words = (
        f"Largest estimated over largest true error of {n_samples} samples; the true one against full-order runs of steps "
        f"{refinement} times smaller. The true error is a median, as a share of the output's largest value."
    )
    return Table("Effectivity of the error indicator", header, rows, words)


def main() -> int:
    """Print the table as Markdown."""
    parser = argparse.ArgumentParser(prog="python -m pgmp_petsc.studies.effectivity", description=__doc__.split("\n")[0])
    parser.add_argument("scene", type=Path, help="a scene with a torque called 'motor'")
    parser.add_argument("--samples", type=int, default=200, metavar="N")
    parser.add_argument("--refinement", type=int, default=8, metavar="K", help="steps of the reference in one of the scene")
    parser.add_argument("--torque", action="append", choices=TORQUES, default=[])
    given = parser.parse_args()
    import petsc4py

    petsc4py.init([])
    try:
        results = measure(given.scene, given.samples, given.refinement, (), given.torque)
        print(table(results, given.samples, given.refinement).markdown())
    except PgmpError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main())
