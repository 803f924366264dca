"""What joined models and stopped ensembles are worth: how often their intervals hold, and how narrow they are.

    python -m benchmarks.joined coverage [--kinds skew quadratic]
    python -m benchmarks.joined stopped
    python -m benchmarks.joined models rom.h5 [--best 200 --cheap 10000 | --best 64 --cheap 1024 --sobol]

`coverage` repeats the figures of two and three models whose truth is known, `stopped` ensembles that end by a rule, 400
times each; 400 repetitions know a count of 95 % to 1.1 %. `models` integrates the reduced and the full-order model at
Chebyshev points of the one uncertain parameter, between its 1e-9 and 1 - 1e-9 quantiles, and puts a polynomial through
them: the true mean and deviation follow from quadrature, and 400 joined ensembles take no time. How far the polynomials
are off is measured between the points, and printed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.polynomial import chebyshev
from scipy import stats

from benchmarks.programs import end, guarded, reduced_model
from benchmarks.tables import Table
from pgmp_petsc.ensemble import intervals, joined, sampling
from pgmp_petsc.ensemble.integration import run_batch
from pgmp_petsc.ensemble.joined import corrected
from pgmp_petsc.ensemble.statistics import describe
from pgmp_petsc.ensemble.stopping import Rule, Seen, Stop, level_of_each, stages
from pgmp_petsc.models import FullModel, Model
from pgmp_petsc.ranks.petsc import start_petsc
from pgmp_petsc.scene.parameters import uncertain_names

LEVEL, REPETITIONS = 0.95, 400
SIZES = ((10, 2000), (20, 2000), (50, 2000), (200, 10_000), (20, 200, 2000))
LAWS = {
    "linear": (lambda x, e: x + 0.1 * e, lambda x: x),
    "quadratic": (lambda x, e: x + 0.1 * x**2, lambda x: x),
    "exponential": (lambda x, e: np.exp(0.3 * x), lambda x: np.exp(0.28 * x) + 0.05 * np.sin(3.0 * x)),
    "loose": (lambda x, e: x + 2.0 * e, lambda x: x),
    "lognormal": (lambda x, e: np.exp(0.6 * x + 0.05 * e), lambda x: np.exp(0.55 * x)),
    "bounded": (lambda x, e: stats.norm.cdf(x) ** 1.3, lambda x: stats.norm.cdf(x)),
    "skew": (lambda x, e: _exponential(x) + 0.05 * _exponential(x) ** 2, lambda x: _exponential(x)),
    "noisy": (lambda x, e: x + 0.1 * x**2 + 0.03 * e, lambda x: x),
}
RARE = 0.05
MOST = 1 << 20
STOPS = {
    "normal": (stats.norm(3.0, 0.5), ("mean", 0.004, True), ("std", 0.03, True), ("P", 0.01, False)),
    "uniform": (stats.uniform(), ("mean", 0.02, True), ("std", 0.02, True), ("P", 0.01, False)),
    "exponential": (stats.expon(), ("mean", 0.05, True), ("std", 0.05, True), ("P", 0.2, True)),
    "lognormal, s = 0.3": (stats.lognorm(0.3), ("mean", 0.01, True), ("std", 0.04, True), ("P", 0.2, True)),
    "exponential, coarse": (stats.expon(), ("mean", 0.2, True), ("std", 0.2, True), ("P", 0.5, True)),
}
N_POINTS = 65
N_REPLICATES = 8  # of Sobol sequences
N_NODES = 800  # of quadratures, a direction


def _exponential(x: np.ndarray) -> np.ndarray:
    """Return an exponential variable for a standard normal one."""
    return -np.log(stats.norm.sf(x))


def _models(kind: str, random: np.random.Generator, sizes: tuple[int, ...]) -> list[np.ndarray]:
    """Return values of the best model, and of the cheap one; of three, one in the middle is nearer to the best."""
    best, cheap = LAWS[kind]
    x, e = random.normal(size=(2, sizes[-1]))
    values = [best(x, e), cheap(x)]
    if len(sizes) == 3:
        values.insert(1, 0.7 * values[0] + 0.3 * values[1])
    return [value[:n] for value, n in zip(values, sizes)]


def coverage(kinds: Sequence[str]) -> Table:
    """Return how often intervals of joined models hold, and how much narrower they are."""
    rows = []
    for number, kind in ((number, kind) for number, kind in enumerate(LAWS) if kind in kinds):
        random = np.random.default_rng(number)
        # Gauss-Legendre points of the probability of x, and of e: what is known to all digits that matter here
        nodes, weights = np.polynomial.legendre.leggauss(N_NODES)
        x, e = (grid.ravel() for grid in np.meshgrid(*[stats.norm.ppf(0.5 + 0.5 * nodes)] * 2))
        weight = 0.25 * np.outer(weights, weights).ravel()
        large = LAWS[kind][0](x, e)
        mean = float(weight @ large)
        order = np.argsort(large)
        limit = np.interp(1.0 - RARE, np.cumsum(weight[order]), large[order])
        true = (mean, float(np.sqrt(weight @ (large - mean) ** 2)), RARE)
        for sizes in SIZES:
            held, narrower = np.zeros(3), []
            for _ in range(REPETITIONS):
                values = _models(kind, random, sizes)
                figures = corrected(values, LEVEL).figures
                ends = [figures[name].interval for name in ("mean", "std")]
                ends.append(joined.probability_of([value > limit for value in values], LEVEL)[1])
                held += [low <= figure <= high for (low, high), figure in zip(ends, true)]
                narrower.append(np.ptp(intervals.of_mean(values[0], LEVEL)) / np.ptp(ends[0]))
            shares = [f"{100 * share:.1f}" for share in held / REPETITIONS]
            shares[1] = shares[1] if sizes[0] >= joined.FEWEST_OF_DEVIATION else "none"
            rows.append([kind, ", ".join(map(str, sizes)), *shares, f"{np.median(narrower):.2g}"])
    header = ["models", "samples", "mean", "deviation", f"probability {RARE:g}", "narrower"]
    words = f"Intervals at {100 * LEVEL:g} % that hold, in % of {REPETITIONS}; how much narrower that of the mean is."
    return Table("Joined models", header, rows, words)


def stopped() -> Table:
    """Return how often intervals at the stop hold, with the samples that it took."""
    rows, level = [], level_of_each(LEVEL)
    for number, (name, (law, *rules)) in enumerate(STOPS.items()):
        limit = law.isf(RARE)
        for kind, wanted, relative in rules:
            rule = Rule("", kind, "", None, wanted, relative)
            true = {"mean": law.mean(), "std": law.std(), "P": RARE}[kind]
            random, held, nominal, ends = np.random.default_rng(number), 0, 0, []
            for _ in range(REPETITIONS):
                values = np.zeros(0)

                def run(n: int) -> int:
                    nonlocal values
                    more = n - values.size
                    values = np.concatenate([values, law.rvs(more, random_state=random)])
                    return more

                def see(n: int, at: float = level) -> Seen:
                    if kind == "P":
                        count = int(np.sum(values > limit))
                        return Seen(n, np.array([count / n]), intervals.of_probability(count, n, at)[None])
                    found = describe(values, 1, (), confidence=at)
                    return Seen(n, np.array([getattr(found, kind)]), getattr(found, f"{kind}_interval")[None])

                last = stages(Stop((rule,)), 1, MOST, run, see, MPI.COMM_SELF)[-1]
                plain = see(last.n, LEVEL).intervals[0]
                held += last.intervals[0, 0] <= true <= last.intervals[0, 1]
                nominal += plain[0] <= true <= plain[1]
                ends.append(last.n)
            shown = f"{kind} {'<' if relative else '+-'} {f'{100 * wanted:g} %' if relative else f'{wanted:g}'}"
            spread = f"{min(ends)} to {max(ends)}" if min(ends) < max(ends) else f"{ends[0]}"
            rows.append([name, shown, spread, f"{100 * held / REPETITIONS:.1f}", f"{100 * nominal / REPETITIONS:.1f}"])
    header = ["law", "rule", "samples", "hold", "would hold at the plain level"]
    words = f"Intervals at {100 * LEVEL:g} % that hold at the stop, in % of {REPETITIONS}; P of what is {RARE:g}."
    return Table("Stopped ensembles", header, rows, words)


class Curve:
    """The outputs of a model over its one uncertain parameter: polynomials through Chebyshev points."""

    def __init__(self, model: Model, low: float, high: float) -> None:
        self._centre, self._half = 0.5 * (low + high), 0.5 * (high - low)
        points = chebyshev.chebpts1(N_POINTS)
        between = np.cos(np.linspace(0.1, 3.0, 17))
        name = uncertain_names(model.scene)[0]
        drawn = self._centre + self._half * np.concatenate([points, between])
        parts = []
        for first in range(0, drawn.size, model.largest_batch):
            some = drawn[first : first + model.largest_batch]
            values = {key: np.full(some.size, value) for key, value in model.scene.values.items()} | {name: some}
            parts.append(run_batch(model, values).outputs)
        outputs = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
        self._series = {key: chebyshev.chebfit(points, v[:N_POINTS], N_POINTS - 1) for key, v in outputs.items()}
        self.error = {
            key: np.abs(chebyshev.chebval(between, self._series[key]) - v[N_POINTS:]).max()
            for key, v in outputs.items()
        }

    def __call__(self, name: str, values: np.ndarray) -> np.ndarray:
        return chebyshev.chebval((values - self._centre) / self._half, self._series[name])


def models(path: Path, n_best: int, n_cheap: int, sobol: bool) -> Iterator[Table]:
    """Yield how often corrected figures of a reduced model hold the full-order ones, and how narrow they are."""
    model = reduced_model(path, ("ensemble.bands=0",))
    scene = model.scene
    name, *others = uncertain_names(scene)
    if others:
        raise SystemExit("models: a reduced model of a scene with one uncertain parameter is needed")
    quantiles = scene.parameters[name].quantiles
    low, high = quantiles(np.array([1e-9, 1.0 - 1e-9]))
    full, reduced = (Curve(model, low, high) for model in (FullModel(scene, model.meshes), model))
    nodes = (np.arange(200_000) + 0.5) / 200_000  # the mean over the probability, to 1e-7 of the deviation
    for output in scene.outputs:
        exact, random = full(output, quantiles(nodes)), np.random.default_rng(1)
        held, narrower, plain = np.zeros(2), np.zeros((REPETITIONS, 2)), 0
        for k in range(REPETITIONS):
            uniform = sampling.sobol(k, 1, N_REPLICATES)(0, n_cheap)[:, 0] if sobol else random.random(n_cheap)
            drawn = quantiles(uniform)
            values = [full(output, drawn[:n_best]), reduced(output, drawn)]
            figures = corrected(values, LEVEL, np.arange(n_cheap) % N_REPLICATES if sobol else None).figures
            ends, alone = (
                np.array([getattr(figures[name], part) for name in ("mean", "std")])
                for part in ("interval", "alone_interval")
            )
            held += (ends[:, 0] <= [exact.mean(), exact.std()]) & ([exact.mean(), exact.std()] <= ends[:, 1])
            narrower[k] = np.ptp(alone, axis=1) / np.ptp(ends, axis=1)
            cheap = intervals.of_mean(values[1], LEVEL)  # as of independent samples
            plain += cheap[0] <= exact.mean() <= cheap[1]
        bias = reduced(output, quantiles(nodes)).mean() - exact.mean()
        rows = [
            [figure, f"{100 * share / REPETITIONS:.1f}", f"{np.median(times):.3g}"]
            for figure, share, times in zip(("mean", "deviation"), held, narrower.T)
        ]
        rows.append([f"mean of {n_cheap} reduced samples alone", f"{100 * plain / REPETITIONS:.1f}", ""])
        words = (
            f"Intervals at {100 * LEVEL:g} % from {n_best} full-order and {n_cheap} reduced samples that hold the "
            f"full-order figure, in % of {REPETITIONS}, and how many times narrower they are than those of the "
            f"full-order samples alone. The reduced mean is off by {100 * bias / exact.mean():.3g} %, "
            f"{bias / exact.std():.3g} deviations; the polynomials by {full.error[output] / exact.std():.1g} and "
            f"{reduced.error[output] / exact.std():.1g} deviations at most."
        )
        yield Table(output, ["figure", "hold", "narrower"], rows, words)


def main(arguments: argparse.Namespace) -> None:
    """Measure what is asked for, and print it."""
    if arguments.what == "models":
        for table in models(arguments.rom, arguments.best, arguments.cheap, arguments.sobol):
            print(table.markdown(), end="\n\n", flush=True)
    else:
        print((coverage(arguments.kinds) if arguments.what == "coverage" else stopped()).markdown())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("coverage", "stopped", "models"))
    parser.add_argument("rom", nargs="?", type=Path, help="reduced model of a scene with one uncertain parameter")
    parser.add_argument("--kinds", nargs="+", choices=LAWS, default=tuple(LAWS), help="of models; all")
    parser.add_argument("--best", type=int, default=200, help="full-order samples")
    parser.add_argument("--cheap", type=int, default=10_000, help="reduced samples")
    parser.add_argument("--sobol", action="store_true", help="scrambled Sobol sequences in place of random samples")
    arguments = parser.parse_args()
    if arguments.what == "models" and arguments.rom is None:
        parser.error("models: a reduced model is needed")
    start_petsc()
    end(guarded(lambda: main(arguments)))
