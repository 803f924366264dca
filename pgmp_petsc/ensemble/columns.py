"""Columns of an ensemble, one number a sample, in a file: memory holds one of them at a time, however many samples.

Which samples of an ensemble are checked: chosen by their numbers, so that ranks and batches have no part in it.

Where the scene gives no share, it is `SHARE`, or less where estimates would take more than `PRICE` of the time that
runs take. The price is counted, not measured, as the samples must be the same whenever and wherever an ensemble is run:
an estimate has a run with smaller steps, and evaluations at two sets of instants with the unknowns of beams, each with
its neighbours, and of condensed bodies, each with all others of its body; a run has its steps with the reduced
coordinates. A sample with lengths of its own is alone in the lanes of its estimate, and its mechanism is placed anew at
every angle.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from weakref import finalize

import numpy as np

from pgmp_petsc.dynamics.generalised_alpha import count_steps
from pgmp_petsc.indicator.coverage import is_estimated
from pgmp_petsc.indicator.schedule import FINER, most_evaluations, price_of_evaluation, schedules
from pgmp_petsc.models import REDUCED, LengthLanes, Model, ReducedModel
from pgmp_petsc.runtime.errors import RunError
from pgmp_petsc.runtime.vectors import LANES
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.lengths import length_names

_NUMBER = np.dtype(np.float64)
_AT_ONCE = 1 << 16  # numbers


class Columns(Mapping[str, np.ndarray]):
    """Columns (n_samples,) by name, read when they are asked for; NaN where nothing was put.

    The file has no name: it is gone with the last reference to it, however the run ends.

    Parameters
    ----------
    folder
        Where there is space for it.
    n_samples
        Length of every column.

    Raises
    ------
    RunError
        If the system fails to make it.
    """

    def __init__(self, folder: Path, n_samples: int) -> None:
        self._folder, self._n_samples = folder, n_samples
        self._places: dict[str, int] = {}
        with self._written():
            self._file = TemporaryFile(dir=folder, buffering=0)
        finalize(self, self._file.close)

    def put(self, first: int, columns: Mapping[str, np.ndarray]) -> None:
        """Put in what is known of samples first, first + 1, and so on.

        Raises
        ------
        RunError
            If the system fails to write.
        """
        with self._written():
            for name, values in columns.items():
                if name not in self._places:
                    self._add(name)
                self._write(self._offset(name) + first * _NUMBER.itemsize, values)

    def of(self, kind: str) -> Mapping[str, np.ndarray]:
        """Return the columns whose names begin with ``<kind>.``, by what follows."""
        return _Part(self, kind)

    @contextmanager
    def _written(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            what = f"samples could not be put together in '{self._folder}'"
            raise RunError(f"{what}: {error.strerror}; what is finished is kept, and --resume takes it up") from error

    def _add(self, name: str) -> None:
        """Add a column of NaN."""
        self._places[name] = len(self._places)
        for begin in range(0, self._n_samples, _AT_ONCE):
            n = min(_AT_ONCE, self._n_samples - begin)
            self._write(self._offset(name) + begin * _NUMBER.itemsize, np.full(n, np.nan))

    def _write(self, offset: int, values: np.ndarray) -> None:
        """Write numbers at an offset (bytes); the system may take them in parts."""
        left = memoryview(np.ascontiguousarray(values, dtype=_NUMBER)).cast("B")
        self._file.seek(offset)
        while left:
            left = left[self._file.write(left) :]

    def _offset(self, name: str) -> int:
        return self._places[name] * self._n_samples * _NUMBER.itemsize

    def __getitem__(self, name: str) -> np.ndarray:
        self._file.seek(self._offset(name))
        values = np.empty(self._n_samples, dtype=_NUMBER)
        left = memoryview(values).cast("B")
        while left:
            left = left[self._file.readinto(left) :]
        return values

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


class _Part(Mapping[str, np.ndarray]):
    """The columns of one kind."""

    def __init__(self, columns: Columns, kind: str) -> None:
        self._columns, self._kind = columns, f"{kind}."

    def __getitem__(self, name: str) -> np.ndarray:
        return self._columns[self._kind + name]

    def __iter__(self) -> Iterator[str]:
        return (name.removeprefix(self._kind) for name in self._columns if name.startswith(self._kind))

    def __len__(self) -> int:
        return sum(1 for _ in self)


PERIOD = 10_000
SHARE = 0.02
PRICE = 0.25
OF_STEP, OF_PLACE = 0.09, 200.0  # us of one core: a reduced coordinate in a step, a body that is placed
FEWEST = 1_000  # samples of which a share is taken, where there are less: already a small ensemble has some


def share_of(model: Model) -> float:
    """Return the share of a model's samples that are checked."""
    if not is_estimated(model.scene):
        return 0.0
    given = model.scene.ensemble.checked_share
    if not isinstance(model, REDUCED):  # a fifth of the price of a run
        return SHARE if given is None else given
    return min(SHARE, PRICE / price_of(model)) if given is None else given


def price_of(model: ReducedModel | LengthLanes) -> float:
    """Return about how many runs of a sample cost as much as an estimate of its errors."""
    mechanism, simulation, tables = model.kinematics.mechanism, model.scene.simulation, model.terms.tables
    n_steps = count_steps(simulation.duration, simulation.step)
    sets = schedules(n_steps, simulation.duration, most_evaluations(mechanism))[:2]  # by these most samples are settled
    evaluations = sum(one.steps.size for one in sets)
    estimate = evaluations * price_of_evaluation(mechanism)
    if isinstance(model, LengthLanes):
        estimate = LANES * estimate + OF_PLACE * model.n_places
    return FINER + estimate / (n_steps * OF_STEP * (tables.n_coordinates + tables.n_modes))


def block_of(scene: Scene, model: str) -> int:
    """Return in what numbers the samples of a model are checked where they are more than one.

    Two samples side by side cost nearly as much as a block of lanes, which also tells of deviations. A share that the
    scene gives is kept; other models, and those of any lengths, check one after the other.
    """
    is_given = scene.ensemble.checked_share is not None
    return 1 if is_given or model != ReducedModel.name or length_names(scene) else LANES


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
