"""Samples of an ensemble's file that failed, tried again; those that are fine are taken over as they are.

Failed samples are integrated with the scene's step and, where they fail, with 1/2, 1/4 and so on of it, down to 1/64
where an ensemble ends at 1/8 (`dynamics.generalised_alpha`): the file is what one run with so many attempts gives.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pgmp_petsc.dynamics.generalised_alpha import DIVISORS, RETRIED
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.ensemble.allotment import Batch, Plan, SampleFile
from pgmp_petsc.ensemble.columns import checked
from pgmp_petsc.ensemble.pieces import Piece
from pgmp_petsc.ensemble.sample_file import read_samples
from pgmp_petsc.ensemble.sampling import Sampler
from pgmp_petsc.models import Model
from pgmp_petsc.results.ensemble import UNSTABLE, Ensemble
from pgmp_petsc.runtime.errors import InputError, Remark, note
from pgmp_petsc.scene import Scene, scene_from_toml

OPTION = "--retry-failed"
FURTHER = (*DIVISORS, 16, 32, 64)  # of the scene's step
FREE = {"ensemble": {"batch", "failed_share"}, "scene": {"name", "description"}}  # entries that no sample depends on
SAME_DRAW = 1e-9  # of a value: machines differ in the last digits of distributions, other designs in the first


@dataclass(frozen=True)
class Earlier:
    """An ensemble whose failed samples are tried again.

    Attributes
    ----------
    path
        Its file.
    n_samples, n_failed
        Of it.
    seed, file
        Where its samples are from: one of the two.
    """

    path: Path
    n_samples: int
    n_failed: int
    seed: int
    file: SampleFile | None

    @property
    def remark(self) -> Remark:
        """What is to be said of it."""
        return note(
            f"{self.n_failed} samples that had failed in '{self.path}' were tried again with steps down to "
            f"1/{FURTHER[-1]} of simulation.step; the others are those of that file"
        )


def has_steps_left(status: np.ndarray, divisors: np.ndarray) -> bool:
    """Return whether a further try takes any failed sample with smaller steps than were tried; shapes (N,)."""
    return bool(np.any(np.isin(status, RETRIED) & (divisors < FURTHER[-1])))


def read_earlier(path: Path, model: Model) -> Earlier:
    """Return what a file says, without its samples. By one process.

    Raises
    ------
    InputError
        If it is no ensemble of this scene and model, or nothing in it can be tried again.
    """
    found = Ensemble.read(path)
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
        _check_draws(path, found, Sampler(model.scene, Plan(n, seed)))
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


def _check_draws(path: Path, found: Ensemble, sampler: Sampler) -> None:
    """Refuse samples that are not those of the sampler: failed ones would be drawn anew among fine ones of another
    design, as another version of the program had it."""
    drawn = sampler.draw(0, len(found.status))
    for name in sampler.names:
        there, here = found.parameters[name], drawn[name]
        differing = np.flatnonzero(~np.isclose(there, here, rtol=SAME_DRAW, atol=0.0, equal_nan=True))
        if differing.size:
            k = differing[0]
            raise InputError(
                f"{OPTION} {path}: sample {k} has {name} = {there[k]:.9g} there and {here[k]:.9g} here: it is of "
                f"another version, whose sampler {sampler.kind} drew other samples; run the ensemble again"
            )


def fine_pieces(earlier: Earlier, share: float, block: int) -> Iterator[tuple[Piece, Batch]]:
    """Yield neighbouring samples that are fine, and those of them whose errors were estimated.

    Parameters
    ----------
    share, block
        Of the samples whose errors are estimated, and in what numbers.
    """
    found = Ensemble.read(earlier.path)
    fine = found.status == Status.FINE
    for first, last in _runs(fine, 0, fine.size):
        yield Piece(first, last), _batch(found, first, last)
    for begin, end in checked(share, fine.size, block):
        for first, last in _runs(fine, begin, end):
            yield Piece(first, last, True), _checked_batch(found, first, last)


def _runs(fine: np.ndarray, begin: int, end: int) -> Iterator[tuple[int, int]]:
    """Yield the ranges of neighbours that are fine."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], fine[begin:end].astype(int), [0]])))
    yield from ((begin + int(first), begin + int(last)) for first, last in zip(edges[::2], edges[1::2]))


def _batch(found: Ensemble, first: int, last: int) -> Batch:
    some = slice(first, last)
    named = {
        kind: {name: values[some] for name, values in getattr(found, kind).items()}
        for kind in ("parameters", "outputs", "validity", "balance", "extremes", "first_passages")
    }
    bands = {name.partition(".")[2]: values for name, values in found.kept.items() if name != UNSTABLE}
    numerics = {"steps_divided": found.steps_divided[some], "unstable_start": found.kept[UNSTABLE][some]}
    return Batch(
        first,
        status=found.status[some],
        failure_time=found.failure_time[some],
        numerics=numerics,
        bands={name: values[some] for name, values in bands.items()},
        **named,
    )


def _checked_batch(found: Ensemble, first: int, last: int) -> Batch:
    some = slice(first, last)
    parameters = {name: values[some] for name, values in found.parameters.items()}
    errors = {kind: {name: values[some] for name, values in getattr(found, kind).items()} for kind in
              ("errors", "errors_at_end")}  # fmt: skip
    return Batch(first, parameters, {}, found.status[some], found.failure_time[some], **errors)
