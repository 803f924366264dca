"""Doing the tasks of a trade-off study on all ranks, but for those that an earlier run has finished."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.experiments.finished import Arrays, Finished
from pgmp_petsc.experiments.history import History
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.runtime.progress import progress, without_progress
from pgmp_petsc.studies.tradeoff_dealing import ReferenceRun, Task
from pgmp_petsc.studies.tradeoff_measurement import FAILURES, Bench, Measured
from pgmp_petsc.studies.tradeoff_settings import Setting

if TYPE_CHECKING:
    from mpi4py import MPI


OF_HISTORY = "history."  # names of arrays that are parts of a history


@dataclass(frozen=True)
class Runner:
    """Does tasks, and takes times.

    Attributes
    ----------
    bench
        This rank's.
    comm
        All ranks.
    finished
        What is kept; None where nothing is.
    """

    bench: Bench
    comm: MPI.Comm
    finished: Finished | None

    def work(self, dealt: Sequence[Sequence[Task]], title: str) -> dict[Setting | ReferenceRun, Measured] | None:
        """Do this rank's tasks; return what came of all tasks on the first rank. Collective on the ranks."""
        own: dict[Setting | ReferenceRun, Measured] = {}
        works = [work for task in dealt[self.comm.rank] for work in task.work]
        with agreed(self.comm, title), progress(len(works), title, self.comm) as bar, without_progress():
            for work in works:
                own[work] = self._done(work)
                bar.update()
        gathered = self.comm.gather(own)
        return None if gathered is None else {work: found for part in gathered for work, found in part.items()}

    def times(self, repeats: int) -> tuple[dict[Setting, np.ndarray], float]:
        """Take the times of all settings in turns; on the first rank return those of all ranks, and their wall time
        over their processor time: 1 on a quiet machine, 0 where nothing was timed. Collective."""
        known: dict[Setting, Arrays] = {}
        if self.finished is not None:
            kept = {setting: self.finished.get("times", setting) for setting in self.bench.ready}
            known = {setting: arrays for setting, arrays in kept.items() if arrays is not None}
        todo = [setting for setting in self.bench.ready if setting not in known]
        with agreed(self.comm, "taking times"), progress(repeats * len(todo), "times", self.comm) as bar:
            with without_progress():
                for turn in range(1, repeats + 1):
                    for setting in todo:
                        self.bench.take_times(setting, turn)
                        bar.update()
            for setting in todo:
                known[setting] = {"times": self.bench.times(setting), "spent": self.bench.spent(setting)}
                if self.finished is not None:
                    self.finished.put("times", setting, known[setting])
        every = {setting: arrays for part in self.comm.gather(known) or () for setting, arrays in part.items()}
        wall, processor = sum((arrays["spent"] for arrays in every.values()), np.zeros(2))
        times = {setting: arrays["times"] for setting, arrays in every.items()}
        return times, float(wall / processor) if processor else 0.0

    def _done(self, work: Setting | ReferenceRun) -> Measured:
        """Return what came of a task, done now or before."""
        kept = None if self.finished is None else self.finished.get("task", work)
        if kept is not None:
            measured = _measured(kept)
            if isinstance(work, Setting):
                self.bench.take_up(work, measured)
            return measured
        measured = self.bench.make_ready(work) if isinstance(work, Setting) else _reference(self.bench, work)
        if self.finished is not None:
            self.finished.put("task", work, _arrays(measured))
        return measured


def _reference(bench: Bench, run: ReferenceRun) -> Measured:
    """Do a run of the reference; a failure is returned, not raised."""
    try:
        return Measured(bench.run_reference(run.refinement, run.n_steps))
    except FAILURES as error:
        return Measured(None, reason=str(error))


def _arrays(measured: Measured) -> Arrays:
    """Return what was measured as arrays, to be kept."""
    arrays = {
        "n_coordinates": np.array(measured.n_coordinates),
        "cosine": np.array(measured.cosine),
        "reason": np.array(measured.reason),
        "offline": np.array(measured.offline),
    }
    if measured.history is not None:
        arrays |= {f"{OF_HISTORY}{name}": value for name, value in measured.history.arrays.items()}
    return arrays


def _measured(arrays: Arrays) -> Measured:
    """Return what was kept by `_arrays`."""
    whole = {name.removeprefix(OF_HISTORY): value for name, value in arrays.items() if name.startswith(OF_HISTORY)}
    history = History.of_arrays(whole) if whole else None
    wall, processor = arrays["offline"]
    return Measured(
        history,
        int(arrays["n_coordinates"]),
        float(arrays["cosine"]),
        str(arrays["reason"]),
        (float(wall), float(processor)),
    )
