"""What intervals are worth, and samplers: how often intervals hold, and with how few samples a mean is known.

    python -m benchmarks.uncertainty coverage [ensemble.h5] [--values 100 --repetitions 2000]
    python -m benchmarks.uncertainty coverage --sobol --values 512
    python -m benchmarks.uncertainty indices
    python -m benchmarks.uncertainty samplers rom.h5

`coverage` describes 400 samples of 400 values from laws that are known, as an ensemble is described, and counts how
often its intervals hold the true figures; 400 repetitions know a count of 95 % to 1.1 %. With an ensemble the laws are
those of its outputs, whose figures over all samples count as true: 1,000,000 are split into 400 times 400 and more that
have no part in each other. With `--sobol` values are those of eight scrambled Sobol sequences in turn, through a sum
of two normal variables, and it is said how wide intervals are beside those of independent values. `samplers` runs
ensembles of
scrambled Sobol points, 16 of each of six sizes with seeds of their own, and compares their means with that of a large
one. independent samples need ``(deviation / error)^2`` samples for the same error, which needs no run. `indices`
repeats Sobol indices of Ishigami's function, which are known.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import stats

from benchmarks.programs import end, guarded, reduced_model
from benchmarks.tables import Table
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.ensemble.integration import run_batch
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.ensemble.sampling import Sampler, saltelli, sobol
from pgmp_petsc.ensemble.statistics import describe, of_blocks, of_event, of_given
from pgmp_petsc.ranks.petsc import start_petsc
from pgmp_petsc.results import Ensemble

LEVEL = 0.95
LAWS = {
    "normal": stats.norm(3.0, 0.5),
    "uniform": stats.uniform(),
    "exponential": stats.expon(),
    "lognormal, s = 0.3": stats.lognorm(0.3),
    "beta(2, 5)": stats.beta(2.0, 5.0),
}
HEAVY = {
    "lognormal, s = 0.6": stats.lognorm(0.6),
    "lognormal, s = 1": stats.lognorm(1.0),
    "Student's t, 5": stats.t(5.0),
    "Student's t, 3.2": stats.t(3.2),
}
QUANTILES = (0.025, 0.25, 0.5, 0.75, 0.975)
RARE = 0.05  # probability of the event
INDEX_SEEDS, N_REPLICATES = range(400), 8
SIZES, SEEDS, REFERENCE = (64, 128, 256, 512, 1024, 2048), range(16), 16_384


class Law(NamedTuple):
    """A law whose figures are known: samples of its values, mean, deviation and quantiles, and the value that it
    exceeds with the probability `RARE`."""

    name: str
    samples: Iterable[np.ndarray]
    true: np.ndarray
    limit: float


def known_laws(n_values: int, repetitions: int, sobol: bool = False) -> Iterator[Law]:
    """Yield laws in closed form."""
    for number, (name, law) in enumerate((LAWS | HEAVY).items()):
        random = np.random.default_rng(number)
        samples = (law.rvs(n_values, random_state=random) for _ in range(repetitions))
        if sobol:
            points = (sobol(seed, 2, N_REPLICATES)(0, n_values) for seed in range(repetitions))
            samples = (law.ppf(stats.norm.cdf(stats.norm.ppf(one).sum(axis=1) / np.sqrt(2.0))) for one in points)
        yield Law(name, samples, np.array([law.mean(), law.std(), *law.ppf(QUANTILES)]), law.isf(RARE))


def laws_of(path: Path, n_values: int, repetitions: int) -> Iterator[Law]:
    """Yield those of the outputs of a large ensemble of independent samples."""
    ensemble = Ensemble.read(path)
    if len(ensemble.status) < 2 * n_values * repetitions or np.any(ensemble.status != 0):
        raise InputError(
            f"'{path}' has {len(ensemble.status)} samples, {np.sum(ensemble.status != 0)} of them failed; "
            f"{repetitions} samples of {n_values} values take {2 * n_values * repetitions} without a failed one"
        )
    for name, values in ensemble.outputs.items():
        samples = values[: n_values * repetitions].reshape(repetitions, n_values)
        true = np.array([values.mean(), values.std(), *np.quantile(values, QUANTILES)])
        yield Law(name, samples, true, float(np.quantile(values, 1.0 - RARE)))


def coverage(laws: Iterable[Law], n_values: int, repetitions: int, sobol: bool = False) -> Table:
    """Return how often intervals hold, in percent, and of Sobol points how wide they are."""
    rows, known = [], np.ones(n_values, dtype=bool)
    replicates = np.arange(n_values) % N_REPLICATES if sobol else None

    def ends_of(values: np.ndarray, limit: float, numbers: np.ndarray | None) -> np.ndarray:
        found = describe(values, 10, QUANTILES, confidence=LEVEL, replicates=numbers)
        chance = of_event(values > limit, known, ~known, numbers, LEVEL)[2]
        return np.array([found.mean_interval, found.std_interval, *found.quantile_intervals, chance])

    for law in laws:
        true, held, wide = np.append(law.true, RARE), np.zeros(law.true.size + 1), []
        for values in law.samples:
            ends = ends_of(values, law.limit, replicates)
            held += (ends[:, 0] <= true) & (true <= ends[:, 1])
            if sobol:
                wide.append(np.ptp(ends, axis=1) / np.ptp(ends_of(values, law.limit, None), axis=1))
        beside = [f", {share:.2g}" for share in np.median(wide, axis=0)] if sobol else [""] * held.size
        rows.append([law.name, *(f"{100 * share:.1f}{width}" for share, width in zip(held / repetitions, beside))])
    quantiles = (f"{100 * p:g} % quantile" for p in QUANTILES)
    header = ["law", "mean", "deviation", *quantiles, f"probability {RARE:g}"]
    words = f"Intervals at {100 * LEVEL:g} % that hold the true figure, in % of {repetitions} samples of {n_values}"
    words += ", and how wide they are beside those of independent values." if sobol else "."
    return Table("Intervals", header, rows, words)


def indices() -> Table:
    """Return how far Sobol indices of Ishigami's function are off, and how many of their intervals hold."""
    a, b, names = 7.0, 0.1, ["x1", "x2", "x3"]
    one, two, both = 0.5 * (1.0 + b * np.pi**4 / 5.0) ** 2, a**2 / 8.0, b**2 * np.pi**8 * 8.0 / 225.0
    first = np.array([one, two, 0.0]) / (one + two + both)
    total = np.array([one + both, two, both]) / (one + two + both)

    def function(uniform: np.ndarray) -> np.ndarray:
        x = np.pi * (2.0 * uniform.T - 1.0)
        return np.sin(x[0]) + a * np.sin(x[1]) ** 2 + b * x[2] ** 4 * np.sin(x[0])

    def row(name: str, n: int, found: list[tuple[np.ndarray, np.ndarray]], true: np.ndarray) -> list[str]:
        errors = np.array([values - true for values, _ in found])
        ends = np.array([ends for _, ends in found])
        held = np.mean((ends[..., 0] <= true) & (true <= ends[..., 1]), axis=0)
        figures = np.sqrt(np.mean(errors**2, axis=0)), np.median(0.5 * np.ptp(ends, axis=-1), axis=0)
        shown = [", ".join(f"{value:.2g}" for value in of_each) for of_each in figures]
        return [name, str(n), *shown, ", ".join(f"{100 * share:.1f}" for share in held)]

    rows = []
    for n in (64, 128, 256, 2048):
        drawn = [saltelli(seed, 3, N_REPLICATES)(0, 5 * n) for seed in INDEX_SEEDS]
        found = [of_blocks(function(uniform), names, LEVEL, N_REPLICATES) for uniform in drawn]
        rows.append(row("S1 of blocks", n, [(one.first, one.first_interval) for one in found], first))
        rows.append(row("ST of blocks", n, [(one.total, one.total_interval) for one in found], total))
    for n in (100, 200, 400, 2000):
        drawn = [np.random.default_rng(seed).random((n, 3)) for seed in INDEX_SEEDS]
        found = [of_given(function(uniform), dict(zip(names, uniform.T)), LEVEL) for uniform in drawn]
        rows.append(row("S1 of random samples", n, [(one.first, one.first_interval) for one in found], first))
    for n in (128, 512, 2000, 4096):
        drawn = [sobol(seed, 3, N_REPLICATES)(0, n) for seed in INDEX_SEEDS]
        numbers = np.arange(n) % N_REPLICATES
        found = [of_given(function(uniform), dict(zip(names, uniform.T)), LEVEL, numbers) for uniform in drawn]
        rows.append(row("S1 of Sobol samples", n, [(one.first, one.first_interval) for one in found], first))
    header = ["index", "blocks or samples", "root mean square error", "half an interval", "intervals that hold, %"]
    words = f"{len(INDEX_SEEDS)} repetitions; of x1, x2, x3. Half an interval is the median."
    return Table("Sobol indices of Ishigami's function", header, rows, words)


def samplers(path: Path) -> Iterator[Table]:
    """Yield, for every output, the errors of means of scrambled Sobol points, and what independent samples need."""
    model = reduced_model(path, ['ensemble.sampler="sobol"'])
    scene = model.scene

    def outputs(seed: int, n: int) -> dict[str, np.ndarray]:
        sampler, parts = Sampler(scene, Plan(n, seed)), []
        for first in range(0, n, model.largest_batch):
            parts.append(run_batch(model, sampler.draw(first, min(first + model.largest_batch, n)), first).outputs)
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    exact = outputs(len(SEEDS), REFERENCE)
    found = {n: [outputs(seed, n) for seed in SEEDS] for n in SIZES}
    for name, values in exact.items():
        mean, deviation, rows = values.mean(), values.std(), []
        for n in SIZES:
            means = np.array([one[name].mean() for one in found[n]])
            ends = np.array([_interval(one[name], scene.ensemble.replicates) for one in found[n]])
            error = np.sqrt(np.mean((means - mean) ** 2)) / deviation
            held = int(np.sum((ends[:, 0] <= mean) & (mean <= ends[:, 1])))
            needed = 1.0 / error**2
            rows.append(
                [str(n), f"{error:.2g}", f"{1 / np.sqrt(n):.2g}", f"{needed:.3g}", f"{needed / n:.0f}", str(held)]
            )
        header = ["samples", "error", "of independent samples", "independent samples for it", "ratio", "intervals"]
        words = (
            f"Root-mean-square error of the mean over {len(SEEDS)} seeds, as a share of the deviation {deviation:.4g}; "
            f"and how many of {len(SEEDS)} intervals hold the mean of {REFERENCE} samples."
        )
        yield Table(name, header, rows, words)


def _interval(values: np.ndarray, n_replicates: int) -> np.ndarray:
    return describe(values, 1, (0.5,), replicates=np.arange(values.size) % n_replicates).mean_interval


def main(arguments: argparse.Namespace) -> None:
    """Measure what is asked for, and print it."""
    if arguments.what == "samplers":
        for table in samplers(arguments.file):
            print(table.markdown(), end="\n\n", flush=True)
    elif arguments.what == "indices":
        print(indices().markdown())
    else:
        size = arguments.values, arguments.repetitions
        sobol = arguments.sobol
        laws = known_laws(*size, sobol) if arguments.file is None else laws_of(arguments.file, *size)
        print(coverage(laws, *size, sobol).markdown())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("coverage", "indices", "samplers"))
    words = "reduced model of a scene with uncertain parameters (samplers), or a large ensemble (coverage)"
    parser.add_argument("file", nargs="?", type=Path, help=words)
    parser.add_argument("--values", type=int, default=400, help="of a sample")
    parser.add_argument("--repetitions", type=int, default=400, help="samples of every law")
    parser.add_argument("--sobol", action="store_true", help="values of Sobol sequences (coverage of known laws)")
    arguments = parser.parse_args()
    if arguments.sobol and (arguments.what, arguments.file) != ("coverage", None):
        parser.error("--sobol: for coverage of known laws")
    if arguments.what == "samplers" and arguments.file is None:
        parser.error("samplers: a reduced model is needed")
    start_petsc()
    end(guarded(lambda: main(arguments)))
