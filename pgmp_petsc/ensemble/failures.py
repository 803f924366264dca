"""Samples that failed: what they do to the figures of an ensemble, and the file in which they are tried again.

Samples rarely fail at random. Where they fail mostly at large torques, mean, deviation and density of the others are
those of small torques: biased, by an amount that nobody knows. Rank statistics, which assume no distribution, ask which
parameters tell failed samples from fine ones: the test of Mann and Whitney (1947) for a side, and the same test on the
distance from the median for both ends or the middle. What a second try takes over and repeats is in docs/uncertainty.md
(failed samples).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from pgmp_petsc.base.errors import InputError, Remark, gathered, note, warning
from pgmp_petsc.base.units import Units
from pgmp_petsc.ensemble.plan import Batch, Piece, Plan, checked
from pgmp_petsc.ensemble.sample_file import SampleFile, read_samples
from pgmp_petsc.ensemble.sampling import Sampler
from pgmp_petsc.models import Model
from pgmp_petsc.results.ensemble import UNSTABLE, Ensemble
from pgmp_petsc.results.numbers import Arrays, behind
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.scene.border import to_own
from pgmp_petsc.stepping.generalised_alpha import DIVISORS, RETRIED
from pgmp_petsc.stepping.status import Status

SIGNIFICANT = 0.01  # for all parameters and sides together
NAMED = 3  # parameters, the clearest first


@gathered
def failure_remarks(
    status: np.ndarray,
    parameters: Arrays,
    units: Units,
    model: str,
    hidden: float = 1.0,
    may_be_retried: bool = True,
    lengths: Sequence[str] = (),
    rubbing: Sequence[str] = (),
) -> Iterator[Remark]:
    """Return what is to be said of failed samples of a model by status (N,) and drawn values (N,) with their units;
    nothing where all are fine.

    `hidden` is the largest share of failed samples that the others are described without; `may_be_retried` says whether
    a further try takes any of them with steps that were not tried; `lengths` are parameters with which a mechanism may
    not close; `rubbing` are effects that joints may jam with.
    """
    failed = status != Status.FINE
    n, n_failed = failed.size, int(failed.sum())
    if not n_failed:
        return
    for code in np.unique(status[failed]):
        reason, count = Status(code), int(np.sum(status == code))
        meaning = reason.meaning
        if reason == Status.UNPHYSICAL and lengths:
            meaning += (
                f"; or a mechanism of its {', '.join(lengths)} cannot be put together over its range, as pgmp check "
                f"SCENE --set {lengths[0]}=VALUE says"
            )
        yield warning(
            f"{count} of {n} samples failed (status {int(code)}): {meaning}; cure: {reason.cure(model, rubbing)}"
        )
    if n_failed == n:
        yield warning("no sample is fine, so the outputs have no statistics")
        return
    where = _where(failed, parameters, units)
    if n_failed > hidden * n:
        retry = "--retry-failed with this file tries them with smaller steps"
        cure = retry if may_be_retried else "that of the reason above"
        yield warning(
            f"{n_failed} of {n} samples failed, more than ensemble.failed_share = {hidden:g} of them: outputs have "
            f"no mean, deviation, density, probability, band or index, which would hide that"
            f"{''.join(f'; {words}' for words in where)}. Their quantile_bounds hold, and "
            f"intervals of probabilities. Cure: {cure}; "
            "--override ensemble.failed_share=1.0 describes the others"
        )
        return
    bias = "and may be biased: no parameter alone tells failed samples from fine ones, which does not rule it out"
    bias = f"and are biased: {'; '.join(where)}" if where else bias
    yield warning(
        f"mean, deviation and density of the outputs are those of the {n - n_failed} samples that are fine {bias}; "
        f"no bounds hold for them. Quantiles of all {n} samples lie between their quantile_bounds, "
        f"whatever the failed ones would have been, and intervals of probabilities count these both ways. "
        f"Parameters are described over all {n} samples"
    )


@gathered
def step_remarks(status: np.ndarray, divisors: np.ndarray, step: float) -> Iterator[Remark]:
    """Return which samples needed smaller steps (s), and that failed ones were tried with them; shapes (N,)."""
    saved = (status == Status.FINE) & (divisors > 1)
    if saved.any():
        counts = [f"{int(np.sum(saved & (divisors == d)))} with 1/{d} of it" for d in np.unique(divisors[saved])]
        yield note(
            f"{int(saved.sum())} of {status.size} samples failed with simulation.step = {step:g} s and were "
            f"integrated again with smaller ones: {', '.join(counts)} (/steps_divided); they are fine, but the "
            "step is large for this ensemble"
        )
    given_up = (status != Status.FINE) & (divisors > 1)
    if given_up.any():
        smallest = int(divisors[given_up].max())
        yield note(
            f"{int(given_up.sum())} of the samples that failed were tried with steps down to 1/{smallest} of "
            f"simulation.step = {step:g} s before they were given up (/steps_divided)"
        )


def _where(failed: np.ndarray, parameters: Arrays, units: Units) -> list[str]:
    """Return in words which parameters tell failed samples from fine ones, the clearest first."""
    found = []
    for name, values in parameters.items():
        known = np.isfinite(values)
        lost, fine = values[known & failed], values[known & ~failed]
        if not lost.size or not fine.size or np.ptp(values[known]) == 0.0:
            continue
        unit = behind(units.get(name, "1"))
        middle = float(np.median(values[known]))
        medians = f"median {np.median(lost):.4g} against {np.median(fine):.4g}{unit}"
        aside = _significance(lost, fine)
        apart = _significance(np.abs(lost - middle), np.abs(fine - middle))
        if aside[0] <= apart[0]:
            found.append((aside[0], f"failures are mostly at {'high' if aside[1] else 'low'} {name} ({medians}, "))
        else:
            place = "at both ends of" if apart[1] else "in the middle of"
            found.append((apart[0], f"failures are mostly {place} {name} ({medians}, "))
    limit = SIGNIFICANT / max(2 * len(parameters), 1)
    clear = sorted(item for item in found if item[0] < limit)
    return [f"{words}p = {p:.1g})" for p, words in clear[:NAMED]]


def _significance(lost: np.ndarray, fine: np.ndarray) -> tuple[float, bool]:
    """Return the probability of such ranks by chance, and whether those of `lost` are the larger ones."""
    test = scipy.stats.mannwhitneyu(lost, fine, alternative="two-sided")
    return float(test.pvalue), bool(test.statistic > 0.5 * lost.size * fine.size)


OPTION = "--retry-failed"
FURTHER = (*DIVISORS, 16, 32, 64)  # of the scene's step
FREE = {"ensemble": {"batch", "failed_share"}, "scene": {"name", "description"}}  # entries that no sample depends on
SAME_DRAW = 1e-9  # of a value: machines differ in the last digits of distributions, other designs in the first


@dataclass(frozen=True)
class Earlier:
    """An ensemble whose failed samples are tried again."""

    path: Path  # its file
    n_samples: int
    n_failed: int
    seed: int  # where its samples are from, or the file
    file: SampleFile | None

    @property
    def remark(self) -> Remark:
        """Remarks on it."""
        return note(
            f"{self.n_failed} samples that had failed in '{self.path}' were tried again with steps down to "
            f"1/{FURTHER[-1]} of simulation.step; the others are those of that file"
        )


def has_steps_left(status: np.ndarray, divisors: np.ndarray) -> bool:
    """Return whether a further try takes any failed sample with smaller steps than were tried; shapes (N,)."""
    return bool(np.any(np.isin(status, RETRIED) & (divisors < FURTHER[-1])))


def read_earlier(path: Path, model: Model) -> Earlier:
    """Return what a file says, without its samples. By one process. Raises `InputError` if it is no ensemble of this
    scene and model, or nothing in it can be tried again."""
    found = Ensemble.read(path).in_si_units()
    n_failed = int(np.sum(found.status != Status.FINE))
    if not n_failed:
        raise InputError(f"{OPTION} {path}: all of its {len(found.status)} samples are fine; nothing is left to do")
    for what, present in (("--correct", found.joined), ("--until or --budget", found.stopping)):
        if present is not None:
            raise InputError(
                f"{OPTION} {path}: an ensemble with {what}, whose figures are of more than its own samples; repeat it "
                "with a smaller simulation.step"
            )
    if found.model != model.name:
        raise InputError(f"{OPTION} {path}: samples of the {found.model} model; here it is the {model.name} one")
    if UNSTABLE not in found.kept:
        raise InputError(f"{OPTION} {path}: written by another version, which kept less of its samples; run it again")
    _check_scene(path, scene_from_toml(found.record.scene_toml, path.parent), model.scene)
    n, seed = len(found.status), found.record.seed
    file = None if seed is not None else read_samples(path, model.scene, None)
    if file is None:
        _check_draws(path, found, model.scene, Sampler(model.scene, Plan(n, seed)))
    return Earlier(path, n, n_failed, seed or 0, file)


def _check_scene(path: Path, there: Scene, here: Scene) -> None:
    """Refuse another scene: its fine samples would be others."""
    one, two = there.model_dump(), here.model_dump()
    for table in one:
        a, b = one[table], two[table]
        if isinstance(a, dict) and isinstance(b, dict):
            free = FREE.get(table, set())
            differing = [key for key in {**a, **b} if key not in free and a.get(key) != b.get(key)]
            if differing:
                raise InputError(
                    f"{OPTION} {path}: {table}.{differing[0]} is not that of the file, and the samples that are fine "
                    f"would be others; leave it as it was. Smaller steps, down to 1/{FURTHER[-1]}, are tried anyway"
                )
        elif a != b:
            raise InputError(f"{OPTION} {path}: [{table}] is not that of the file; leave it as it was")


def _check_draws(path: Path, found: Ensemble, scene: Scene, sampler: Sampler) -> None:
    """Refuse samples that are not those of the sampler: failed ones would be drawn anew among fine ones of another
    design, as another version of the program had it."""
    drawn = sampler.draw(0, len(found.status))
    for name in sampler.names:
        there, here = found.parameters[name], drawn[name]
        differing = np.flatnonzero(~np.isclose(there, here, rtol=SAME_DRAW, atol=0.0, equal_nan=True))
        if differing.size:
            k, own = differing[0], to_own(scene, name)
            raise InputError(
                f"{OPTION} {path}: sample {k} has {name} = {own * there[k]:.9g} there and {own * here[k]:.9g} here: it "
                f"is of another version, whose sampler {sampler.kind} drew other samples; run the ensemble again"
            )


def fine_pieces(earlier: Earlier, share: float, block: int) -> Iterator[tuple[Piece, Batch]]:
    """Yield neighbouring samples that are fine, and those of them whose errors were estimated: a share, in blocks."""
    found = Ensemble.read(earlier.path).in_si_units()
    ends = found.status, found.failure_time
    samples = Batch(
        0, found.parameters, found.outputs, *ends, validity=found.validity, balance=found.balance,
        numerics={"steps_divided": found.steps_divided, "unstable_start": found.kept[UNSTABLE]},
        extremes=found.extremes, first_passages=found.first_passages,
        bands={name.partition(".")[2]: values for name, values in found.kept.items() if name != UNSTABLE},
    )  # fmt: skip
    estimates = Batch(0, found.parameters, {}, *ends, errors=found.errors, errors_at_end=found.errors_at_end)
    fine = found.status == Status.FINE
    for first, last in _runs(fine, 0, fine.size):
        yield Piece(first, last), samples.part(first, last)
    for begin, end in checked(share, fine.size, block):
        for first, last in _runs(fine, begin, end):
            yield Piece(first, last, True), estimates.part(first, last)


def _runs(fine: np.ndarray, begin: int, end: int) -> Iterator[tuple[int, int]]:
    """Yield the ranges of neighbours that are fine."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], fine[begin:end].astype(int), [0]])))
    yield from ((begin + int(first), begin + int(last)) for first, last in zip(edges[::2], edges[1::2]))
