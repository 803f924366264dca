"""The plan of an ensemble: its samples, which of them are checked, the pieces that they are dealt out in, and samples
from a file.

A piece is neighbouring samples that one rank, or a group, integrates together. Pieces get smaller as fewer samples are
left (guided self-scheduling, Polychronopoulos and Kuck 1987). Samples whose errors are estimated are in pieces of their
own, which are dealt out first, as few as there are ranks: an estimate takes ten times as long as a run, and a piece
costs as much as fifteen samples before there is any in it. A sample's numbers depend on none of this.

Which samples are checked is chosen by their numbers, the same on any ranks. Where the scene gives no share, it is
`SHARE`, or less where estimates would take more than `PRICE` of the time of the runs, which is counted, not measured
(docs/method.md, error indicator).

A file of samples is a table with a column for every uncertain parameter, as CSV or HDF5, in the scene's units. CSV has
the names in its first line, with or without the parameters' units, and commas between numbers. HDF5 has a data set (N,)
for each parameter, at the top or in a group ``parameters``: any ensemble of this program is such a file, whose samples
another model can so repeat.
"""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import h5py
import numpy as np

from pgmp_petsc.base.errors import InputError, Remark, nearest_name, note, shortened
from pgmp_petsc.base.units import Units, behind
from pgmp_petsc.estimates.own_error import is_estimated
from pgmp_petsc.estimates.reference_motion import FINER, price_of_evaluation, schedules_of
from pgmp_petsc.files.hdf5 import csv_table, without_unit
from pgmp_petsc.lanes.vectors import LANES
from pgmp_petsc.models import LengthLanes, Model, Reduced, ReducedModel
from pgmp_petsc.results.numbers import Arrays
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.messages import MAX_LINES, input_error
from pgmp_petsc.scene.parameters import uncertain_names
from pgmp_petsc.scene.units import in_own_units, own_units, si_values
from pgmp_petsc.scene.uses import length_names, ordered_ends

SAMPLERS = ("random", "latin_hypercube", "sobol", "saltelli")
MOST_SAMPLES = 10**9  # the pieces of a checkpoint are in order by nine digits
LARGEST_SEED = 2**63 - 1  # the largest whole number that every reader of the file knows


@dataclass(frozen=True)
class Shard:
    """One of `count` parts of an ensemble, numbered from 1, which are runs of their own."""

    number: int
    count: int

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"


@dataclass(frozen=True)
class Plan:
    """How many samples, from which seed or file, where the result goes, whether to take up a checkpoint, and which part
    of the samples is wanted where it is not all of them. `is_limited` is false where nobody asked for a number of
    samples, and `n_samples` is one that no run comes to."""

    n_samples: int
    seed: int
    output: Path = Path()
    resume: bool = False
    file: SampleFile | None = None
    shard: Shard | None = None
    is_limited: bool = True

    @property
    def samples(self) -> tuple[int, int]:
        """First of the samples that are wanted, and the one behind the last."""
        if self.shard is None:
            return 0, self.n_samples
        return tuple(self.n_samples * k // self.shard.count for k in (self.shard.number - 1, self.shard.number))


@dataclass(frozen=True)
class Batch:
    """Samples ``first`` to ``first + n - 1``: parameters, outputs at the end, status and time of failure, each (n,).

    ``numerics`` says how each was integrated: ``steps_divided`` is by what the scene's step was divided,
    ``unstable_start`` whether it began on an unstable static equilibrium. The largest estimated errors of the outputs,
    those at the end, whether they are unsure, and the validity of small deformations, which the reduced model adds, are
    each (n,) and NaN where they were not estimated. ``balance`` is that of energy, where it was asked for, as are
    ``extremes`` of the outputs over time and ``first_passages`` of events; ``bands`` are outputs at some instants, each
    (n, n_t).
    """

    first: int
    parameters: dict[str, np.ndarray]
    outputs: dict[str, np.ndarray]
    status: np.ndarray
    failure_time: np.ndarray
    numerics: dict[str, np.ndarray] = field(default_factory=dict)
    errors: dict[str, np.ndarray] = field(default_factory=dict)
    errors_at_end: dict[str, np.ndarray] = field(default_factory=dict)
    errors_unsure: dict[str, np.ndarray] = field(default_factory=dict)
    validity: dict[str, np.ndarray] = field(default_factory=dict)
    balance: dict[str, np.ndarray] = field(default_factory=dict)
    extremes: dict[str, np.ndarray] = field(default_factory=dict)
    first_passages: dict[str, np.ndarray] = field(default_factory=dict)
    bands: dict[str, np.ndarray] = field(default_factory=dict)

    def part(self, first: int, last: int) -> Batch:
        """Return the samples first to last - 1 of those that it has."""
        some = slice(first, last)
        named = {kind: {name: values[some] for name, values in getattr(self, kind).items()} for kind in NAMED}
        ends = {"status": self.status[some], "failure_time": self.failure_time[some]}
        return replace(self, first=self.first + first, **ends, **named)


# of a batch: arrays by name
IN_CHECKED = ("errors", "errors_at_end", "errors_unsure")  # known of the samples whose errors were estimated only
IN_ALL = ("parameters", "outputs", "numerics", "validity", "balance", "extremes", "first_passages")
NAMED = (*IN_ALL, *IN_CHECKED, "bands")  # bands are known of the first samples only, at several instants


PERIOD = 10_000
SHARE = 0.02
PRICE = 0.25
OF_STEP, OF_PLACE = 0.09, 200.0  # us of one core: a reduced coordinate in a step, a body that is placed
FEWEST = 1_000  # samples of which a share is taken, where there are less: already a small ensemble has some


def share_of(model: Model) -> float:
    """Return the share of a model's samples that are checked."""
    given, is_reduced = model.scene.ensemble.checked_share, isinstance(model, Reduced)
    if not is_estimated(model.scene, of_step=not is_reduced):
        return 0.0
    if given is not None:
        return given
    return min(SHARE, PRICE / price_of(model)) if is_reduced else SHARE  # a fifth of a run's price there, rarely more


def price_of(model: Reduced) -> float:
    """Return about how many runs of a sample cost as much as an estimate of its errors."""
    mechanism, simulation, tables = model.kinematics.mechanism, model.scene.simulation, model.terms.tables
    n_steps = simulation.n_steps
    sets = schedules_of(mechanism, simulation)[:2]  # by these most samples are settled
    evaluations = sum(one.steps.size for one in sets)
    estimate = evaluations * price_of_evaluation(mechanism)
    if isinstance(model, LengthLanes):
        estimate = LANES * estimate + OF_PLACE * model.n_places
    return FINER + estimate / (n_steps * OF_STEP * (tables.n_coordinates + tables.n_modes))


def block_of(scene: Scene, model: str) -> int:
    """Return in what numbers the samples of a model are checked where they are more than one.

    Two samples side by side cost nearly as much as a block of lanes, which also tells of deviations. A share that the
    scene gives is kept; other models, those of any lengths and with controllers check one after the other.
    """
    is_given = scene.ensemble.checked_share is not None
    return 1 if is_given or model != ReducedModel.name or length_names(scene) or scene.beside else LANES


def checked(share: float, n_samples: int, block: int = 1) -> list[tuple[int, int]]:
    """Return the ranges (first, last) of the samples 0 to n_samples - 1 that are checked, last - 1 the last of each.

    The first ``share`` of every ten thousand, in whole blocks (`block_of`) where that is more than one. As samples are
    independent, these are as good as any others.
    """
    found = []
    for first in range(0, n_samples if share > 0.0 else 0, PERIOD):
        together = min(max(n_samples - first, FEWEST), PERIOD)
        n = max(1, round(share * together))
        found.append((first, min(first + (n if n == 1 else -(-n // block) * block), n_samples)))
    return found


SHARES = 2  # pieces that a rank would have of what is left, if all were equal
LEAST = 32
LEAST_CHECKED, MOST_CHECKED = 8, 128

Ranges = Sequence[tuple[int, int]]


@dataclass(frozen=True)
class Piece:
    """Samples first to last - 1, whether it is their errors that are estimated, and then whether the samples themselves
    are wanted too, or are there already."""

    first: int
    last: int
    is_checked: bool = False
    is_both: bool = False

    @property
    def parts(self) -> tuple[Piece, ...]:
        """The parts it has: samples, their errors, or both."""
        if not self.is_both:
            return (self,)
        return Piece(self.first, self.last, True), Piece(self.first, self.last)


def pieces(samples: Ranges, to_check: Ranges, n_groups: int, largest: int) -> list[Piece]:
    """Return the pieces of an ensemble, or of what is left of it, in the order in which they are dealt out to ranks, or
    groups of ranks that share a sample.

    Ranges (first, last) are of the samples to be integrated, and of those whose errors are to be estimated; a piece has
    so many samples as the `largest` at most.
    """
    a_rank = -(-sum(last - first for first, last in to_check) // n_groups)
    even = min(max(_whole_lanes(a_rank), LEAST_CHECKED), MOST_CHECKED, largest)
    both = [ends for wanted in to_check for ends in within(samples, *wanted)]
    found = [Piece(*ends, True, True) for ends in _cut(both, n_groups, even, even)]
    found += [Piece(*ends, True) for ends in _cut(missing(to_check, both), n_groups, even, even)]
    others = missing(samples, both)
    return found + [Piece(*ends) for ends in _cut(others, n_groups, min(LEAST, largest), largest)]


def _cut(ranges: Ranges, n_groups: int, least: int, most: int) -> Iterator[tuple[int, int]]:
    """Yield parts of ranges, shrinking with what is left."""
    left = sum(last - first for first, last in ranges)
    for first, last in ranges:
        while first < last:
            share = _whole_lanes(-(-left // (SHARES * n_groups)))
            size = min(max(share, least), most, last - first)
            yield first, first + size
            first, left = first + size, left - size


def _whole_lanes(n: int) -> int:
    """Return a number of samples that fills lanes, at least n."""
    return -(-n // LANES) * LANES


def within(ranges: Ranges, first: int, last: int) -> list[tuple[int, int]]:
    """Return what of some ranges lies between two numbers, first to last - 1."""
    cut = [(max(begin, first), min(end, last)) for begin, end in ranges]
    return [(begin, end) for begin, end in cut if begin < end]


def missing(wanted: Ranges, there: Ranges) -> list[tuple[int, int]]:
    """Return what of some ranges is not there; both are sorted and do not overlap."""
    found = []
    for first, last in wanted:
        for begin, end in there:
            if begin < last and first < end:
                found.append((first, begin))
                first = end
        found.append((first, last))
    return [(first, last) for first, last in found if first < last]


OPTION = "--samples"


@dataclass(frozen=True)
class SampleFile:
    """Samples that a file gives: values (N,) by parameter, the identity of its content, and what is said of it."""

    path: Path
    values: dict[str, np.ndarray]
    identity: str
    remarks: tuple[Remark, ...] = ()


def called(samples: Path | Arrays | None) -> str:
    """Return what messages call samples: the option with its file, or a program's argument."""
    return f"{OPTION} {samples}" if isinstance(samples, Path) else "samples"


def read_samples(path: Path | Arrays, scene: Scene, n_samples: int | None) -> SampleFile:
    """Read the first `n_samples` samples of a file, or of columns, or all. By one process. Raises `InputError` if the
    file cannot be read, lacks the column of an uncertain parameter, has fewer samples, or one that is no finite number
    within the parameter's bounds, with its line."""
    where = called(path)
    if not isinstance(path, Path):
        columns = {name: np.asarray(path[name], dtype=float) for name in _used(where, list(path), scene)}
        return of_columns(columns, scene, where, n_samples, [name for name in path if name not in columns])
    try:
        if not path.is_file():
            raise InputError(f"{where}: there is no such file; a CSV or HDF5 file of samples is needed")
        is_hdf5 = h5py.is_hdf5(path)
        columns, lines, others = _of_hdf5(path, scene) if is_hdf5 else _of_csv(path, scene)
        with open(path, "rb") as stream:
            content = hashlib.file_digest(stream, "sha256").hexdigest()
    except (OSError, UnicodeDecodeError, csv.Error, RuntimeError) as error:
        raise InputError(f"{where}: it cannot be read as CSV or HDF5: {error}") from error
    return _checked(path, columns, lines, others, content, scene, n_samples, where, "sample" if is_hdf5 else "line")


def of_columns(
    columns: Arrays,
    scene: Scene,
    where: str,
    n_samples: int | None = None,
    others: Sequence[str] = (),
    place: str = "sample",
) -> SampleFile:
    """Return the first `n_samples`, or all, of columns of parameters of a scene as samples; raises `InputError` where
    one is wrong.

    Messages call the columns `where`, and a row of them `place`; `others` are names of columns that have no part.
    """
    _check_lengths(columns, where)
    content, lines = hashlib.sha256(), np.arange(len(next(iter(columns.values()))))
    for name, values in columns.items():
        content.update(name.encode() + b"\0" + values.tobytes())
    return _checked(Path(where), columns, lines, others, content.hexdigest(), scene, n_samples, where, place)


def _checked(
    path: Path, columns: Arrays, lines: np.ndarray, others: Sequence[str], content: str, scene: Scene,
    n_samples: int | None, where: str, place: str,
) -> SampleFile:  # fmt: skip
    """Return the samples that are wanted; raises `InputError` where there are too few, or one is wrong."""
    n = min(map(len, columns.values()))
    if n_samples is not None and n_samples > n:
        raise InputError(f"-n {n_samples}: {where} has {n} samples; give at most so many, or leave -n out")
    n = n if n_samples is None else n_samples
    columns, lines = {name: values[:n] for name, values in columns.items()}, lines[:n]
    problems = []
    for problem in _problems(columns, lines, in_own_units(scene), own_units(scene), place):
        problems.append(f"{where}: {problem}")
        if len(problems) > MAX_LINES:
            break
    if problems:
        raise input_error(problems)
    text = f"columns of '{path}' that are no parameters have no part: {', '.join(others)}"
    return SampleFile(path, si_values(scene, columns), content, (note(text),) if others else ())


def _of_csv(path: Path, scene: Scene) -> tuple[dict[str, np.ndarray], np.ndarray, list[str]]:
    """Return the columns of parameters, the number of each sample's line, and the names of columns without a part."""
    with open(path, encoding="utf-8-sig", newline="") as stream:
        names, rows = csv_table(stream, f"{OPTION} {path}", own_units(scene))
        used = _used(f"{OPTION} {path}", names, scene)
        places = [names.index(name) for name in used]
        values: list[list[float]] = []
        lines = []
        for line, row in rows:
            where = f"{OPTION} {path}: line {line}"
            values.append([_number(row[place], where, name) for place, name in zip(places, used)])
            lines.append(line)
    if not lines:
        raise InputError(f"{OPTION} {path}: there are no samples in it, only a first line of names")
    return dict(zip(used, np.array(values).T)), np.array(lines), [name for name in names if name not in used]


def _number(text: str, where: str, name: str) -> float:
    try:
        return float(text)
    except ValueError:
        shown = f"'{shortened(text.strip(), 40)}'" if text.strip() else "nothing"
        raise InputError(f"{where}: {name} = {shown}; a number is needed") from None


def _of_hdf5(path: Path, scene: Scene) -> tuple[dict[str, np.ndarray], np.ndarray, list[str]]:
    """Return the columns of parameters and the number of each sample; data sets that have no part are not named."""
    with h5py.File(path, "r") as file:
        group = file["parameters"] if isinstance(file.get("parameters"), h5py.Group) else file
        names = [name for name, item in group.items() if isinstance(item, h5py.Dataset)]
        used = _used(f"{OPTION} {path}", names, scene)
        columns = {}
        for name in used:
            data = group[name]
            if data.ndim != 1 or data.dtype.kind not in "iuf" or not data.size:
                what = f"has shape {data.shape} and type {data.dtype}; numbers of shape (N,) are needed"
                raise InputError(f"{OPTION} {path}: data set '{data.name}' {what}")
            if (unit := str(data.attrs.get("unit", "1"))) != "1":
                without_unit(f"{name} ({unit})", f"{OPTION} {path}", own_units(scene))
            columns[name] = np.asarray(data[()], dtype=float)
    _check_lengths(columns, f"{OPTION} {path}")
    return columns, np.arange(len(columns[used[0]])), []


def _check_lengths(columns: Arrays, where: str) -> None:
    """Refuse columns of several lengths, and without numbers."""
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1 or 0 in lengths.values():
        found = ", ".join(f"{name} {length}" for name, length in lengths.items())
        what = "differ in length" if len(set(lengths.values())) > 1 else "are empty"
        raise InputError(f"{where}: columns {what}: {found}")


def _used(where: str, names: list[str], scene: Scene) -> list[str]:
    """Return the columns that are parameters of the scene; all uncertain ones must be there."""
    for name in uncertain_names(scene):
        if name not in names:
            hint = nearest_name(name, names) if names else "; it has none at all"
            raise InputError(f"{where}: there is no column '{name}', an uncertain parameter{hint}")
    used = [name for name in dict.fromkeys(names) if name in scene.parameters]
    if not used:
        known = nearest_name("", scene.parameters)
        raise InputError(f"{where}: none of its columns is a parameter of the scene{known}")
    return used


def _problems(columns: Arrays, lines: np.ndarray, scene: Scene, units: Units, place: str) -> Iterator[str]:
    """Yield what is wrong with values, the first lines first within a column; all in these units."""
    for name, values in columns.items():
        bounds, wrong = scene.parameters[name].bounds, {"a finite number is needed": ~np.isfinite(values)}
        if bounds is not None:
            limits = f"parameters.{name}.bounds, [{bounds[0]:g}, {bounds[1]:g}]{behind(units[name])}"
            wrong[f"must lie in {limits}"] = (values < bounds[0]) | (values > bounds[1])
        if name in scene.positive_parameters:
            wrong["must be positive for what uses it"] = values <= 0.0
        elif name in scene.parameters_not_negative:
            wrong["must not be negative for what uses it"] = values < 0.0
        for words, which in wrong.items():
            for number in np.flatnonzero(which):
                yield f"{place} {lines[number]}: {name} = {values[number]:g}; {words}"
    for ends in ordered_ends(scene):
        low, high = (np.broadcast_to(end, lines.shape) for end in ends.at(scene, {**scene.values, **columns}))
        for number in np.flatnonzero(low >= high):
            where = f"{ends.entry} = {low[number]:g}; must be below {ends.other}, {high[number]:g}"
            yield f"{place} {lines[number]}: {where}"
