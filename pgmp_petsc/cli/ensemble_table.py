"""What a command says of an ensemble's figures: statistics, quantiles and probabilities with their intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from pgmp_petsc.cli import estimates
from pgmp_petsc.cli.report import remark_lines
from pgmp_petsc.results import Ensemble
from pgmp_petsc.results.numbers import (
    axis_unit,
    interval_text as _interval,
    number_text as _number,
    percent as _percent,
)
from pgmp_petsc.runtime.errors import Remark


def report(ensemble: Ensemble, path: Path, said: Sequence[Remark] = ()) -> str:
    """Return what is known of the outputs and parameters, what is not, and the estimated errors."""
    lines = [f"{path}: {ensemble.model} model, {len(ensemble.status)} samples", *lines_of(ensemble)]
    lines += remark_lines(ensemble.record, said)
    lines += estimates.of_ensemble(ensemble)
    lines += estimates.of_balance(ensemble)
    lines += [f"  {phase:24s}{seconds:14.2f} s" for phase, seconds in ensemble.record.timings.items()]
    return "\n".join(lines)


def lines_of(ensemble: Ensemble) -> list[str]:
    """Return the tables of an ensemble."""
    lines = list(_moments(ensemble))
    if ensemble.outputs:
        lines += _quantiles(ensemble)
    if ensemble.probabilities:
        level = next(iter(ensemble.probabilities.values())).confidence
        lines.append(f"  probabilities, {_percent(level)} intervals")
        for label, chance in ensemble.probabilities.items():
            shown = f"{'unknown':>14s}" if np.isnan(chance.estimate) else f"{chance.estimate:14.4g}"
            what = f"{chance.event}, {chance.count} of {chance.of}"
            lines.append(f"  {label:24s}{shown} {_interval(chance.interval):26s}{what}")
            if not (np.isnan(chance.estimate) or chance.is_decided()):
                lines.append(f"  {'':24s}{chance.doubt()}")
    lines += _corrected(ensemble)
    if ensemble.stopping is not None:
        lines += ensemble.stopping.lines()
    lines += _sobol(ensemble)
    if ensemble.bands:
        band = next(iter(ensemble.bands.values()))
        samples = f"{band.count} samples at {band.time.size} instants"
        lines.append(f"  outputs over time: mean, deviation and quantiles of {samples}, in /bands")
    return lines


def _moments(ensemble: Ensemble) -> Iterator[str]:
    """Yield the table of means and deviations."""
    if not ensemble.statistics:
        return
    interval = f"{_percent(next(iter(ensemble.statistics.values())).confidence)} interval"
    yield f"  {'':24s}{'mean':>14s} {interval:26s}{'deviation':>12s} {interval:26s}{'samples':>9s}"
    for name, s in ensemble.statistics.items():
        title = f"{name}: first passage" if name in ensemble.first_passages else name
        factor, unit = _unit(ensemble, name)
        mean = f"{_number(factor * s.mean, factor * s.mean_interval, 7):>14s} {_interval(factor * s.mean_interval):26s}"
        std = f"{_number(factor * s.std, factor * s.std_interval, 6):>12s} {_interval(factor * s.std_interval):26s}"
        if s.constant:
            mean, std = f"{factor * s.mean:14.7g} {'':26s}", f"{'constant':>12s} {'':26s}"
        yield f"  {title:24s}{mean}{std}{s.count:9d} {unit}".rstrip()


def _quantiles(ensemble: Ensemble) -> Iterator[str]:
    """Yield the table of the outputs' quantiles, and between what they lie whatever failed samples would have been."""
    failed = bool(np.any(ensemble.status != 0))
    known = [(name, ensemble.statistics[name]) for name in ensemble.outputs]
    known = [(name, s) for name, s in known if s.count and not (s.constant and not failed)]
    if known:
        yield f"  quantiles at the end, {_percent(known[0][1].confidence)} intervals of sampling"
    for name, s in known:
        factor, unit = _unit(ensemble, name)
        for k, (probability, quantile, ends) in enumerate(zip(s.probabilities, s.quantiles, s.quantile_intervals)):
            quantile, ends = factor * quantile, factor * ends
            shown = f"{_number(quantile, ends, 6):>14s} {_interval(ends, quantile):26s} {unit}"
            whatever = _bounds(factor * s.quantile_bounds[k])
            bounds = f"; whatever the failed ones would have been {whatever}" if failed else ""
            yield f"  {name if k == 0 else '':24s}{f'{100 * probability:g} %':>9s}{shown}{bounds}".rstrip()


def _sobol(ensemble: Ensemble) -> Iterator[str]:
    """Yield the table of Sobol indices, the largest first."""
    for number, (name, found) in enumerate(ensemble.sobol.items()):
        interval = f"{_percent(found.confidence)} interval"
        if not number:
            total = "" if found.total is None else f"{'total':>9s} {interval}"
            yield f"  {'Sobol indices':24s}{'':24s}{'first':>9s} {interval:26s}{total}".rstrip()
        for k, place in enumerate(np.argsort(-(found.first if found.total is None else found.total))):
            total = ""
            if found.total is not None:
                total = f"{found.total[place]:9.3f} {_fixed(found.total_interval[place])}"
            first = f"{found.first[place]:9.3f} {_fixed(found.first_interval[place]):26s}"
            yield f"  {name if k == 0 else '':24s}{found.parameters[place]:24s}{first}{total}".rstrip()


def _corrected(ensemble: Ensemble) -> Iterator[str]:
    """Yield the table of a better model's figures."""
    joined = ensemble.joined
    if joined is None or not joined.corrected:
        return
    best, interval = joined.models[0], f"{_percent(joined.confidence)} interval"
    for key, title in (("mean", "mean"), ("std", "deviation"), ("bias", f"{joined.models[-1]} less {best}"),
                       ("estimate", "probability")):  # fmt: skip
        having = {name: one for name, one in joined.corrected.items() if key in one.figures}
        if not having:
            continue
        n = int(next(iter(having.values())).counts[0])
        beside = "" if key == "bias" else f"against {n} samples of {best} alone"
        yield f"  {f'{best}: {title}':32s}{'':>6s} {interval:32s}{beside}".rstrip()
        for name, one in having.items():
            figure = one.figures[key]
            factor, unit = (1.0, "") if key == "estimate" else _unit(ensemble, name)
            estimate, ends = factor * figure.estimate, factor * figure.interval
            shown = f"{_number(estimate, ends, 7):>14s} {_interval(ends):26s}"
            times = "" if np.isnan(figure.narrower) else _times(figure.narrower)
            yield f"  {name:24s}{shown}{unit:6s}{times}".rstrip()


def _times(narrower: float) -> str:
    """Return how much narrower an interval is, or wider."""
    return f"{narrower:.2g} times narrower" if narrower >= 1.0 else f"{1 / narrower:.2g} times wider"


def _fixed(ends: np.ndarray) -> str:
    return f"[{ends[0]:.3f}, {ends[1]:.3f}]"


def _bounds(ends: np.ndarray) -> str:
    """Return between what a quantile of all samples lies."""
    low, high = ends
    lower = "no bound below" if np.isinf(low) else f"at least {low:.6g}"
    upper = "no bound above" if np.isinf(high) else f"at most {high:.6g}"
    return f"{lower}, {upper}"


def _unit(ensemble: Ensemble, name: str) -> tuple[float, str]:
    """Return the unit that a quantity is read in, and how many of it the file's is; the same in all tables."""
    s = ensemble.statistics.get(name)
    factor, unit = axis_unit(ensemble.units.get(name, "1"), *(() if s is None or not s.count else (s.quantiles,)))
    return factor, "" if unit == "1" else unit
