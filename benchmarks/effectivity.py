"""How good the error indicator is: estimated over true errors of many samples, for several reductions and torques.

    python -m benchmarks.effectivity scenes/slider_crank.toml [--samples 200] [--refinement 128]
    python -m benchmarks.effectivity SCENE --as-it-is [--reference components] [--override KEY=VALUE ...]

The second form takes any scene with its own reduction and loads. The reference is the mesh, or the component model
where the mesh is dear, with the smallest steps that are predicted to stay within the scene's ``reference.budget``;
which it is, and how far the component model is from the mesh, is said before anything runs. ``--reference`` takes the
model that it names at any price.

The true error of a reduced run is its largest distance over time from a run of the reference, the full-order model,
whose step is `refinement` times smaller. The effectivity is the largest estimated error over that; the table shows its
spread over the samples. They are drawn from the scene's distributions, and none of them has a part in building the
reduced model or the indicator.

The reference has an error of its own. How much the last halving of its step moved it, as a share of the true
error, stands beside (`doubt`): it must be small, or it is the reference that is measured. Fast vibrations, which lag
behind with every step, want a hundred steps where the run has one; with 8, the reference of a sudden torque is as wrong
as the run. `surely` counts the samples within the factor for any true error that the doubt leaves open.

With ``--keep FOLDER`` runs of the reference are kept there, some samples at a time: the same command goes on where it
was stopped.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from benchmarks.called import Called
from benchmarks.programs import end, guarded
from benchmarks.tables import Table
from pgmp_petsc.bench.reference import Demand, Subject, choose_reference, component_model, distance_from_mesh
from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.estimates.error_indicator import ErrorIndicator
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import FullModel, Model, ReducedModel
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.ranks.petsc import start_petsc
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.scene import Scene, scene_to_toml
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.second_order_system import SecondOrderSystem, State
from pgmp_petsc.stepping.status import Status
from pgmp_petsc.studies.inputs import read_scene

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
REFINEMENT, LEAST_REFINEMENT = 128, 4
ALL_RUNS = 1.5  # times those with the smallest steps: as many have twice the step
N_TIMED = 3
COSTED = 32  # samples, at most, that costs are taken of
AT_ONCE = 20  # samples of the reference that are run, and kept, together
MOTOR = "motor"
AS_IT_IS = "as it is"  # of the scene's own reduction or loads

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
    doubts
        What the last halving of the reference's step moved, over the largest true error, shape (n,).
    """

    setting: str
    torque: str
    output: str
    error: float
    ratios: np.ndarray
    doubts: np.ndarray

    @property
    def within(self) -> float:
        """Share of the samples whose estimate is within a factor `FACTOR` of the true error, doubts or not."""
        return self._share(np.zeros_like(self.doubts))

    @property
    def surely_within(self) -> float:
        """Share of those that are within even if the true error is larger or smaller by its doubt."""
        return self._share(self.doubts)

    def _share(self, doubts: np.ndarray) -> float:
        least, most = (1.0 + doubts) / FACTOR, (1.0 - doubts) * FACTOR
        return float(np.mean((self.ratios >= least) & (self.ratios <= most)))


@dataclass(frozen=True)
class Cost:
    """Processor times of a batch of all samples, s; each the least of some.

    Attributes
    ----------
    setting
        What was run.
    run, watched, full
        The reduced run without and with the indicator, and a full-order run with the same step.
    """

    setting: str
    run: float
    watched: float
    full: float


@dataclass(frozen=True)
class Reference:
    """Full-order runs with small steps.

    Attributes
    ----------
    exact
        Outputs at the steps of the scene; NaN where a sample failed.
    moved
        Largest change of every output by the last halving of the step, shape (n,).
    """

    exact: Histories
    moved: dict[str, np.ndarray]


def history(model: Model, values: Mapping[str, np.ndarray], every: int = 1) -> Histories:
    """Integrate samples and return their outputs at every n-th step; NaN where a sample failed."""
    n, parts = len(next(iter(values.values()))), []
    for first in range(0, n, model.largest_batch):
        some = {name: value[first : first + model.largest_batch] for name, value in values.items()}
        with closing(model.batch(some, len(next(iter(some.values()))))) as system:
            parts.append(_history_of(model, system, every))
    return {name: np.concatenate([part[name] for part in parts], axis=1) for name in model.outputs.functions}


def _history_of(model: Model, system: SecondOrderSystem, every: int) -> Histories:
    rows = []

    def record(number: int, time: float, state: State) -> None:
        if number % every == 0:
            rows.append(model.outputs.evaluate(model.observed(system, state)))

    run = integrate(system, model.scene.simulation, observer=Called(record))
    fine = run.status == Status.FINE
    return {name: np.where(fine, [row[name] for row in rows], np.nan) for name in model.outputs.functions}


def refer(case: Case, overrides: tuple[str, ...], values: Mapping[str, np.ndarray], refinement: int) -> Reference:
    """Integrate the samples of the reference with a step that is `refinement` times smaller, and with twice that."""
    runs, n = [], len(next(iter(values.values())))
    for finer in (refinement // 2, refinement):
        scene, _ = case.read(overrides)
        fine, meshes = case.read((*overrides, f"simulation.step={scene.simulation.step / finer!r}"))
        model, parts = case.model(fine, meshes), []
        for first in range(0, n, AT_ONCE):
            some = {name: value[first : first + AT_ONCE] for name, value in values.items()}
            task = (scene_to_toml(fine), model.name, finer, {name: value.tolist() for name, value in some.items()})
            parts.append(kept(case.folder, task, lambda: history(model, some, finer)))
        runs.append({name: np.concatenate([part[name] for part in parts], axis=1) for name in parts[0]})
    before, exact = runs
    return Reference(exact, {name: np.max(np.abs(exact[name] - before[name]), axis=0) for name in exact})


def kept(folder: Path | None, task: object, run: Callable[[], Histories]) -> Histories:
    """Return what a run leaves, or left in a folder; a file there is whole or missing, however a run ended."""
    if folder is None:
        return run()
    path = folder / f"{hashlib.sha256(repr(task).encode()).hexdigest()[:32]}.npz"
    if path.exists():
        with np.load(path) as file:
            return dict(file)
    found = run()
    folder.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{os.getpid()}.npz")
    np.savez(part, **found)
    part.replace(path)
    return found


def watched(model: ReducedModel, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Integrate samples and return the largest estimated error of every output, shape (n,)."""
    n = len(next(iter(values.values())))
    system = model.batch(values, n)
    run_of_all = ErrorIndicator(model).watch(system, np.arange(n))
    run = integrate(system, model.scene.simulation, observer=run_of_all)
    return run_of_all.estimate(run.status).largest


def compare(
    model: ReducedModel, reference: Reference, values: Mapping[str, np.ndarray]
) -> dict[str, tuple[float, np.ndarray, np.ndarray]]:
    """Return median relative error, effectivities and doubts of every output of a reduced model."""
    found, largest = history(model, values), watched(model, values)
    result = {}
    for name, exact in reference.exact.items():
        true = np.max(np.abs(found[name] - exact), axis=0)
        share = float(np.median(true / np.max(np.abs(exact), axis=0)))
        result[name] = share, largest[name] / true, reference.moved[name] / true
    return result


def costs(setting: str, model: ReducedModel, full: FullModel, values: Mapping[str, np.ndarray]) -> Cost:
    """Measure what the indicator costs; runs are taken in turns, so that a busy machine slows all of them."""
    n = len(next(iter(values.values())))
    tasks = (
        lambda: integrate(model.batch(values, n), model.scene.simulation),
        lambda: watched(model, values),
        lambda: history(full, values),
    )
    times = []
    for _ in range(N_TIMED):
        for task in tasks:
            start = time.process_time()
            task()
            times.append(time.process_time() - start)
    return Cost(setting, *np.min(np.reshape(times, (N_TIMED, len(tasks))), axis=0))


@dataclass(frozen=True)
class Case:
    """A scene, and what its reduced runs are compared with.

    Attributes
    ----------
    path, overrides
        Of the scene.
    components
        Whether that is the component model; the full-order model otherwise.
    settings, torques
        Reductions and torques to be measured.
    folder
        Where runs of the reference are kept; None where they are not.
    """

    path: Path
    overrides: tuple[str, ...] = ()
    components: bool = False
    settings: tuple[str, ...] = tuple(SETTINGS)
    torques: tuple[str, ...] = tuple(TORQUES)
    folder: Path | None = None

    def read(self, overrides: tuple[str, ...], purpose: Purpose | None = None) -> tuple[Scene, dict]:
        """Read the scene with more overrides, by default for the reference."""
        purpose = purpose or (Purpose.COMPONENTS if self.components else Purpose.FULL)
        return read_scene(self.path, (*self.overrides, *overrides), (), MPI.COMM_SELF, purpose)

    def model(self, scene: Scene, meshes: dict) -> Model:
        """Return the reference's model."""
        return component_model(scene, meshes, MPI.COMM_SELF) if self.components else FullModel(scene, meshes)


def within_budget(case: Case, n_samples: int, refinement: int | None) -> tuple[Case, int, str]:
    """Choose the mesh or the component model, and how small its steps are; return why, too.

    Parameters
    ----------
    n_samples
        Samples of every torque.
    refinement
        What is given; by default as fine as the budget allows, `REFINEMENT` at most.

    Raises
    ------
    InputError
        If no reference is within ``reference.budget`` with the least refinement.
    """
    scene, meshes = case.read((), Purpose.BUILD)
    n_steps = scene.simulation.n_steps
    runs = ALL_RUNS * n_samples * len(case.torques) * n_steps
    least = LEAST_REFINEMENT if refinement is None else refinement
    cases = f"{n_samples} samples with steps {least} times smaller"
    cure = "shorten simulation.duration, or take fewer --samples"
    demand = Demand("--samples", runs * least, cases, cure, scene.reduction.modes)
    with RankGroup.split(MPI.COMM_SELF, 1) as group:
        kinematics = Subject.of(scene, meshes, group, scene.reduction.modes).kinematics
    found = choose_reference(scene, meshes, kinematics, demand, MPI.COMM_SELF)
    values = draw(scene, SEED, 0, 1)
    found = distance_from_mesh(found, meshes, values, 1, n_steps, MPI.COMM_SELF)
    if refinement is None:
        refinement, budget = REFINEMENT, scene.reference.budget
        while refinement > LEAST_REFINEMENT and runs * refinement * found.price.step > budget:
            refinement //= 2
    return replace(case, components=not found.is_mesh), refinement, f"{found.why}; steps {refinement} times smaller"


def measure(case: Case, n_samples: int, refinement: int, seed: int = SEED) -> tuple[list[Effectivity], list[Cost]]:
    """Measure the effectivity of settings and torques, and costs with the first torque."""
    comm, results, times = MPI.COMM_SELF, [], []
    roms = {}
    for torque in case.torques:
        load = () if torque == AS_IT_IS else (f"effects.{MOTOR}.table={TORQUES[torque]}",)
        scene, meshes = case.read(load)
        values = draw(scene, seed, 0, n_samples) or {"none": np.zeros(n_samples)}  # of scenes without parameters
        reference = refer(case, load, values, refinement)
        for setting in case.settings:
            own = () if setting == AS_IT_IS else SETTINGS[setting]
            reduced, _ = case.read((*own, *load), Purpose.BUILD)
            first = setting not in roms
            if first:
                with RankGroup.split(comm, 1) as group:
                    roms[setting] = build_rom(reduced, meshes, group)
            model = ReducedModel(reduced, roms[setting])
            for output, found in compare(model, reference, values).items():
                results.append(Effectivity(setting, torque, output, *found))
            if first:
                few = {name: value[:COSTED] for name, value in values.items()}
                times.append(costs(setting, model, case.model(scene, meshes), few))
    return results, times


def table(results: Sequence[Effectivity], n_samples: int, refinement: int) -> Table:
    """Show the spread of the effectivities."""
    rows = []
    for item in results:
        spread = np.nanquantile(item.ratios, [0.0, 0.05, 0.5, 0.95, 1.0])
        cells = (f"{value:.2f}" for value in spread)
        shares = (f"{100 * share:.1f} %" for share in (item.within, item.surely_within))
        error, doubt = f"{100 * item.error:.2g} %", f"{np.nanquantile(item.doubts, 0.95):.2g}"
        rows.append([item.setting, item.torque, item.output, error, doubt, *cells, *shares])
    header = (
        "reduction",
        "torque",
        "output",
        "true error",
        "doubt",
        "least",
        "5 %",
        "median",
        "95 %",
        "largest",
        f"within {FACTOR:g}",
        "surely",
    )
    words = (
        f"Largest estimated over largest true error of {n_samples} samples; the true one against runs of the reference "
        f"with steps {refinement} times smaller. The true error is a median, as a share of the largest value; the "
        "doubt is what the last halving of the reference's step moved, over the true error, 95 % of the samples being "
        "below; surely: even if the true error is larger or smaller by that."
    )
    return Table("Effectivity of the error indicator", header, rows, words)


def cost_table(times: Sequence[Cost], n_samples: int) -> Table:
    """Show what the indicator costs."""
    rows = [
        [item.setting, f"{1e3 * item.run / n_samples:.2g} ms"]
        + [f"{ratio:.2f}" for ratio in (item.watched / item.run - 1.0, (item.watched - item.run) / item.full)]
        for item in times
    ]
    header = ("reduction", "a reduced run", "indicator over reduced run", "indicator over full-order run")
    words = f"Processor times, all of {n_samples} samples in one batch and all of them checked."
    return Table("Cost of the error indicator", header, rows, words)


def print_tables(given: argparse.Namespace) -> None:
    """Measure what is asked for on the command line, and print both tables."""
    case = Case(given.scene, tuple(given.override), given.reference == "components", folder=given.keep)
    if given.as_it_is:
        case = replace(case, settings=(AS_IT_IS,), torques=(AS_IT_IS,))
    elif given.torque:
        case = replace(case, torques=tuple(given.torque))
    refinement = given.refinement
    if given.reference == "auto":
        case, refinement, why = within_budget(case, given.samples, refinement)
        print(why, end="\n\n", flush=True)
    refinement = refinement or REFINEMENT
    results, times = measure(case, given.samples, refinement, given.seed)
    print(table(results, given.samples, refinement).markdown(), end="\n\n")
    print(cost_table(times, min(given.samples, COSTED)).markdown())


def main() -> int:
    """Print the tables as Markdown."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.effectivity", description=__doc__.split("\n")[0])
    words = "a scene; with a torque called 'motor' unless it is taken as it is"
    parser.add_argument("scene", type=Path, help=words)
    parser.add_argument("--as-it-is", action="store_true", help="with its own reduction and loads")
    words = "model that true errors are measured against; by default the mesh where it is within reference.budget"
    parser.add_argument("--reference", choices=("auto", "full", "components"), default="auto", help=words)
    parser.add_argument("--override", action="append", default=[], metavar="KEY=VALUE", help="of the scene")
    parser.add_argument("--samples", type=int, default=200, metavar="N")
    words = f"steps of the reference in one of the scene; even; by default what the budget allows, up to {REFINEMENT}"
    parser.add_argument("--refinement", type=int, metavar="K", help=words)
    parser.add_argument("--seed", type=int, default=SEED, metavar="S", help="of the samples")
    parser.add_argument("--torque", action="append", choices=TORQUES, default=[])
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="for runs of the reference; taken up from there")
    given = parser.parse_args()
    if given.refinement is not None and (given.refinement < 2 or given.refinement % 2):
        parser.error(f"--refinement {given.refinement}: must be even, because runs with half of it are compared")
    start_petsc()
    return guarded(lambda: print_tables(given))


if __name__ == "__main__":
    end(main())
