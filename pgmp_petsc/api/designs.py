"""What derivatives of runs are for: what parameters do to a run, those that fit a measured history, and those that meet
a goal best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from pgmp_petsc.api.arguments import Range
from pgmp_petsc.api.declared import DIFFERENTIABLE, OPTIONAL_OUTPUT, Argument, command, numbers_by_name
from pgmp_petsc.api.ranks import solving_ranks_of
from pgmp_petsc.api.result import Result
from pgmp_petsc.api.scenes import Overrides, Parameters
from pgmp_petsc.api.sources import SOURCE, AnySource, Origin, keeping
from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.design.derivatives import read_constraint, read_goal
from pgmp_petsc.design.derivatives import sensitivities as differentiated
from pgmp_petsc.design.fitting import fit as fitted
from pgmp_petsc.design.fitting import read_history
from pgmp_petsc.design.optimization import Question, designed_parameters
from pgmp_petsc.design.optimization import optimize as designed
from pgmp_petsc.ensemble.plan import LARGEST_SEED, MOST_SAMPLES
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.results.gradients import Design, Fit
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.units import parameter_units
from pgmp_petsc.texts.studies import report_of_derivatives, report_of_design, report_of_fit


@dataclass(frozen=True)
class Robust:
    """Figures of a design over samples, in place of nominal runs: their mean and some of their standard deviations."""

    deviations: float  # how many standard deviations are added to the mean, 0 or more
    #: n, seed: number of samples, 2 or more, and the seed that they are drawn with
    n: int = 64
    seed: int = 1


NAMES = "a list of parameters' names, such as ['r1']"


@command(
    "sensitivities", "What parameters do to the outputs of a run.", 100, report=report_of_derivatives,
    about="rom", output=OPTIONAL_OUTPUT, rom=SOURCE, model=DIFFERENTIABLE,
    names=Argument("Differentiate with parameter NAME, instead of all of the scene.", "--parameter", "NAME", NAMES),
    gives="With the attributes of `results.Derivatives`.",
)  # fmt: skip
def sensitivities(
    rom: AnySource,
    names: Sequence[str] = (),
    *,
    model: str | None = None,
    parameters: Parameters | None = None,
    overrides: Overrides = (),
    output: str | PathLike[str] | None = None,
    plot: str | PathLike[str] | None = None,
    on_all_ranks: bool = True,
    comm: Comm | None = None,
) -> Result:
    """Say what a change of each parameter does to the outputs of a run of the model `rom`.

    Derivatives of the outputs over time, of their largest and smallest values and of the values at the end come from
    one run; of component models, and with controllers, from differences of runs. Printed are the effects of one
    standard deviation of each parameter, the largest first.
    """
    comm = solving_ranks_of(comm)
    origin = Origin.of(comm, rom, model, overrides, parameters, differentiated=True)
    with keeping("sensitivities", comm, output, on_all_ranks, (origin.path,), plot) as keeper:
        prepared = origin.settled(comm)
        return keeper.result(differentiated(prepared, tuple(names), comm), prepared.scene)


def _status_of_fit(found: Fit) -> None:
    if not found.converged:
        raise RunError("the fit did not converge")


@command(
    "fit", "Fit parameters to a measured history.", 110, report=report_of_fit, status=_status_of_fit, about="measured",
    rom=SOURCE, model=DIFFERENTIABLE, output=OPTIONAL_OUTPUT,
    measured=Argument(
        "CSV file whose first line names its columns: time (s), and outputs of the scene in its units.",
        word="MEASURED.csv", allowed="the name of a CSV file",
    ),
    names=Argument("Fit parameter NAME, instead of all with a distribution.", "--parameter", "NAME", NAMES),
    noise=Argument(
        "Standard deviation of an output's noise, in its unit; found from what is left where it is not given.",
        word="OUTPUT=NUMBER", allowed=Range(0.0, above=True),
        read=numbers_by_name(
            "--noise", "OUTPUT=NUMBER with a positive number is needed, such as crank_angle=1e-3", 0.0
        ),
    ),
    gives="With the attributes of `results.gradients.Fit`; ``converged`` says whether it did.",
)  # fmt: skip
def fit(
    rom: AnySource,
    measured: str | PathLike[str],
    names: Sequence[str] = (),
    *,
    model: str | None = None,
    noise: Mapping[str, float] | None = None,
    parameters: Parameters | None = None,
    overrides: Overrides = (),
    output: str | PathLike[str] | None = None,
    plot: str | PathLike[str] | None = None,
    on_all_ranks: bool = True,
    comm: Comm | None = None,
) -> Result:
    """Fit parameters of the model `rom` to the history in `measured` by least squares.

    The fit begins with the values of a run (`parameters`), and keeps to the bounds of the parameters.

    Exit status 1 if it does not converge.
    """
    comm = solving_ranks_of(comm)
    origin = Origin.of(comm, rom, model, overrides, parameters, differentiated=True)
    with keeping("fit", comm, output, on_all_ranks, (origin.path, measured), plot) as keeper:
        prepared = origin.settled(comm)
        scene, units = prepared.scene, prepared.outputs.units
        history = on_root(comm, read_history, Path(measured), prepared.outputs, scene.simulation.duration, scene.system)
        deviations = {name: scene.system.size_of(units.get(name, "1")) * one for name, one in (noise or {}).items()}
        return keeper.result(fitted(prepared, history, tuple(names), deviations, comm), prepared.scene)


def _status_of_design(found: Design) -> None:
    if not found.converged:  # the first warning says why
        raise RunError(next(remark.text for remark in found.record.remarks if remark.kind == "warning"))


@command(
    "optimize", "Find the parameters that meet a goal best.", 120, report=report_of_design, status=_status_of_design,
    about="rom", rom=SOURCE, model=DIFFERENTIABLE, output=OPTIONAL_OUTPUT,
    goal=Argument(
        "What the design is for, such as 'minimise max(abs(OUTPUT))'.",
        allowed="a text such as 'minimise max(abs(angle))'",
    ),
    names=Argument(
        "Design parameter NAME, instead of all with bounds or a distribution.", "--parameter", "NAME", NAMES
    ),
    subject_to=Argument(
        "What the design must keep, such as 'end(OUTPUT) >= 4.5'.",
        word="CONSTRAINT",
        allowed="a list of constraints, such as ['r1 <= 6e-3']",
    ),
    robust=Argument(
        "Figures over samples.", made=Robust,
        parts={
            "deviations": Argument(
                "Take the mean and K standard deviations of every figure over samples, instead of nominal runs.",
                "--robust", "K", Range(0.0), required=True,
            ),
            "n": Argument(f"Samples of --robust; {Robust.n} if not given.", "--samples", "N", Range(2, MOST_SAMPLES)),
            "seed": Argument(f"Of the samples of --robust; {Robust.seed} if not given.", word="S",
                             allowed=Range(0, LARGEST_SEED)),
        },
    ),
    gives="With the attributes of `results.gradients.Design`; ``converged`` says whether a design was found "
    "that meets all constraints.",
)  # fmt: skip
def optimize(
    rom: AnySource,
    goal: str,
    names: Sequence[str] = (),
    *,
    model: str | None = None,
    subject_to: Sequence[str] = (),
    robust: Robust | None = None,
    parameters: Parameters | None = None,
    overrides: Overrides = (),
    output: str | PathLike[str] | None = None,
    plot: str | PathLike[str] | None = None,
    on_all_ranks: bool = True,
    comm: Comm | None = None,
) -> Result:
    """Find the parameters of the model `rom` that meet `goal` best.

    `goal` is "minimise ..." or "maximise ...", a CONSTRAINT is "... <= ..." or "... >= ...": sums, products and powers
    of numbers (60, or 60 MPa), parameters, and figures of outputs: max, min, mean, rms, start and end of an output or
    of its abs.

    \b
    pgmp optimize rom.h5 "minimise max(abs(slider_deformation))" --subject-to "r1 <= 6e-3" -o design.h5

    Exit status 1 if no design is found that meets all constraints.
    """
    comm = solving_ranks_of(comm)
    origin = Origin.of(comm, rom, model, overrides, parameters, differentiated=True)
    with keeping("design", comm, output, on_all_ranks, (origin.path,), plot) as keeper:
        prepared = origin.settled(comm)
        with agreed(comm, "reading the goal"):
            question = _question(prepared.scene, prepared.outputs.units, goal, subject_to, names, robust)
        return keeper.result(designed(prepared, question, comm), prepared.scene)


def _question(
    scene: Scene, outputs: Mapping[str, str], goal: str, subject_to: Sequence[str], names: Sequence[str],
    robust: Robust | None,
) -> Question:  # fmt: skip
    """Return what is to be designed; raises `InputError` where a text is no goal or constraint of the scene."""
    if not outputs:
        raise InputError("outputs: none is given, so there is nothing to design for; add a table [outputs.NAME]")
    units = {**outputs, **{f"parameters.{name}": unit for name, unit in parameter_units(scene).items()}}
    known = outputs, scene.parameters, units, scene.system
    constraints = tuple(read_constraint(text, *known) for text in subject_to)
    figures = () if robust is None else (robust.deviations, robust.n, robust.seed)
    return Question(read_goal(goal, *known), constraints, designed_parameters(scene, names), *figures)
