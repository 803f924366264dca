"""Parameters that a program looks for: those that fit a measured history, and those that meet a goal best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from pgmp_petsc.api.arguments import checked
from pgmp_petsc.api.keeping import keeping
from pgmp_petsc.api.ranks import solving_ranks_of
from pgmp_petsc.api.requests import check_whole
from pgmp_petsc.api.result import Result, Rom
from pgmp_petsc.api.scenes import Overrides, Parameters
from pgmp_petsc.api.sources import Origin
from pgmp_petsc.ensemble.allotment import LARGEST_SEED, MOST_SAMPLES
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.design_figures import Question
from pgmp_petsc.studies.fitting import fit as fitted
from pgmp_petsc.studies.goals import read_constraint, read_goal
from pgmp_petsc.studies.measured_history import read_history
from pgmp_petsc.studies.optimization import designed_parameters, optimize as designed

if TYPE_CHECKING:
    from mpi4py import MPI


@dataclass(frozen=True)
class Robust:
    """Figures of a design over samples, in place of nominal runs: their mean and some of their standard deviations.

    Attributes
    ----------
    deviations
        How many standard deviations are added to the mean, 0 or more.
    n, seed
        Number of samples, 2 or more, and the seed that they are drawn with.
    """

    deviations: float
    n: int = 64
    seed: int = 1

    def check(self) -> None:
        """Refuse what are no numbers of the kind."""
        is_number = isinstance(self.deviations, (int, float)) and not isinstance(self.deviations, bool)
        if not is_number or not 0.0 <= self.deviations < float("inf"):
            raise InputError(f"robust.deviations = {self.deviations!r}: allowed are numbers from 0")
        check_whole("robust.n", self.n, 2, MOST_SAMPLES)
        check_whole("robust.seed", self.seed, 0, LARGEST_SEED)


@checked
def fit(
    rom: Rom | str | PathLike[str],
    measured: str | PathLike[str],
    names: Sequence[str] = (),
    *,
    noise: Mapping[str, float] | None = None,
    parameters: Parameters | None = None,
    overrides: Overrides = (),
    output: str | PathLike[str] | None = None,
    on_all_ranks: bool = True,
    comm: MPI.Comm | None = None,
) -> Result:
    """Fit parameters to a measured history by least squares, as ``pgmp fit``. Collective on `comm`.

    Parameters
    ----------
    rom, parameters, overrides, output, on_all_ranks
        As of `sensitivities`; the fit begins with the values of `parameters`.
    measured
        CSV file whose first line names its columns: time (s), and outputs of the scene in SI units.
    names
        Parameters to fit; where none is named all with a distribution.
    noise
        Standard deviations of outputs' noise, SI units; found from what is left where they are not given.

    Returns
    -------
    Result
        With the attributes of `results.fit.Fit`; ``converged`` says whether it did.

    Raises
    ------
    InputError, RunError
        As the command.
    """
    comm = solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        deviations = _deviations(noise or {})
        origin = Origin.of(rom, None, overrides, parameters)
    with keeping("fit", comm, output, on_all_ranks, (origin.path, measured)) as keeper:
        model = origin.settled(comm)
        history = on_root(comm, read_history, Path(measured), model.outputs, model.scene.simulation.duration)
        found = fitted(model, history, tuple(names), deviations, comm)
        return keeper.result(found, origin.directory, model.scene.remarks)


@checked
def optimize(
    rom: Rom | str | PathLike[str],
    goal: str,
    names: Sequence[str] = (),
    *,
    subject_to: Sequence[str] = (),
    robust: Robust | None = None,
    parameters: Parameters | None = None,
    overrides: Overrides = (),
    output: str | PathLike[str] | None = None,
    on_all_ranks: bool = True,
    comm: MPI.Comm | None = None,
) -> Result:
    """Find the parameters that meet a goal best, as ``pgmp optimize``. Collective on `comm`.

    Parameters
    ----------
    rom, parameters, overrides, output, on_all_ranks
        As of `sensitivities`.
    goal, subject_to
        Such as ``"minimise max(abs(angle))"``, and constraints such as ``"r1 <= 6e-3"`` (docs/gradients.md).
    names
        Parameters of the design; where none is named all with bounds or a distribution.
    robust
        Samples whose figures are taken; nominal runs where it is not given.

    Returns
    -------
    Result
        With the attributes of `results.design.Design`; ``converged`` says whether a design was found that meets all
        constraints.

    Raises
    ------
    InputError, RunError
        As the command.
    """
    comm = solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        if robust is not None:
            robust.check()
        origin = Origin.of(rom, None, overrides, parameters)
    with keeping("design", comm, output, on_all_ranks, (origin.path,)) as keeper:
        model = origin.settled(comm)
        with agreed(comm, "reading the goal"):
            question = _question(model.scene, tuple(model.outputs.functions), goal, subject_to, names, robust)
        return keeper.result(designed(model, question, comm), origin.directory, model.scene.remarks)


def _question(
    scene: Scene, outputs: Sequence[str], goal: str, subject_to: Sequence[str], names: Sequence[str],
    robust: Robust | None,
) -> Question:  # fmt: skip
    """Return what is to be designed; raises `InputError` where a text is no goal or constraint of the scene."""
    if not outputs:
        raise InputError("outputs: none is given, so there is nothing to design for; add a table [outputs.NAME]")
    known = (outputs, scene.parameters)
    constraints = tuple(read_constraint(text, *known) for text in subject_to)
    figures = () if robust is None else (robust.deviations, robust.n, robust.seed)
    return Question(read_goal(goal, *known), constraints, designed_parameters(scene, names), *figures)


def _deviations(noise: Mapping[str, float]) -> dict[str, float]:
    """Return deviations of noise by output; refuse what is no positive number."""
    for name, value in noise.items():
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not is_number or not 0.0 < value < float("inf"):
            raise InputError(f"noise of {name} = {value!r}: allowed are positive numbers, such as 1e-3")
    return dict(noise)
