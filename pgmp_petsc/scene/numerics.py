"""How a scene is computed: the reduction, a simulation, and an ensemble, many runs with drawn parameters, with the
figures of them that are asked for."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import ceil
from typing import Annotated, Literal, Self

from pydantic import Field

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.scene.fields import (
    AngleOrPlace,
    AnyScene,
    Integer,
    Name,
    Number,
    NumberOrParameter,
    PositiveNumber,
    Table,
    Time,
    Unit,
    at_most,
    no_parameter,
    refusal,
)
from pgmp_petsc.scene.messages import problem, unknown


def count_steps(duration: float, step: float) -> int:
    """Return the number of equal steps, none longer than `step`, that end at `duration`."""
    return max(1, ceil(duration / step * (1 - 1e-12)))


Share = Annotated[Number, Field(gt=0.0, lt=1.0)]

MOST_STEPS = 1e8

Angles = Annotated[Integer, at_most(1_000_000, "each has its own eigenproblem and tables, of 10 kB and more")]
Vectors = Annotated[Integer, at_most(10_000, "tables grow by the square of it, to 0.8 GB at every angle")]
Frames = Annotated[Integer, at_most(1_000_000, "each holds the whole mechanism, 10 kB and more")]


class Reduction(Table):
    """The reduced model."""

    tolerance: Share | None = Field(
        None,
        description="largest error of any output by the reduction, as a share of its largest value over time; pgmp "
        "build chooses what is not given of modes, static_modes, second_order, angles and interpolation",
    )
    modes: Vectors = Field(
        15,
        ge=1,
        description="number of flexible modes kept at every configuration; by default no more than the mesh has "
        "and than can be followed from one to the next",
    )
    angles: Angles = Field(
        629,
        ge=4,
        description="number of sampled configurations along each coordinate; 24 with two, 16 with three, up to 22 where"
        " one of three turns by more than half a turn",
    )
    length_points: Annotated[Integer, at_most(8, "polynomials of degree 7 are as good as the eigensolvers")] = Field(
        5,
        ge=2,
        description="Chebyshev points of every parameter that is a length, a place or a ratio, over its bounds; the "
        "modes of all angles are built at each, and once more at the nominal lengths",
    )
    sampling_tolerance: Number | None = Field(
        None,
        gt=0.0,
        description="add angles until interpolated tables differ from fresh ones by no more than this share; `angles` "
        "is then the number to begin with; needs interpolation = spline",
    )
    max_angles: Angles = Field(
        2000,
        ge=4,
        description="most angles, of several coordinates most configurations, that a build takes by itself; with "
        "sampling_tolerance 10000 with two coordinates and 100000 with three",
    )
    static_modes: bool = Field(False, description="extend the basis by the static answers to the scene's loads")
    spring_modes: bool = Field(
        True,
        strict=True,
        description="extend the basis by the static answers to the forces of linear springs, whatever static_modes is; "
        "with them it holds for any stiffness of the springs",
    )
    preload: bool = Field(
        False,
        strict=True,
        description="pgmp modes: vibrations about the state that springs and weights load, instead of the unloaded one",
    )
    inertia_modes: bool = Field(
        False, description="extend the basis by the static answer to the inertia forces of the mechanism's rigid motion"
    )
    parameter_modes: Vectors = Field(
        0,
        ge=0,
        description="number of further vectors for parameters far from nominal: modes and static answers at parameter "
        "points that are chosen by the error there, compressed",
    )
    second_order: bool = Field(
        False,
        description="add what is of second order in the deformation: the curvature of the mode shapes (static modal "
        "derivatives) and the cubic strain energy",
    )
    stretching: Literal["static", "dynamic"] = Field(
        "static",
        description="with second_order, how bodies follow their shortening by bending: at once, which holds for large "
        "deflections, or by the coordinates that stretch them, with their inertia, which bodies without a long axis "
        "need",
    )
    effects: Literal["named", "auto"] = Field(
        "named",
        description='"auto" lets pgmp build leave out effects too small to matter, and add terms of the reduced model '
        "that do",
    )
    interpolation: Literal["overhauser", "spline", "spectral"] = Field(
        "overhauser",
        description="interpolation between samples: cubic Hermite with central-difference tangents (the paper's; where "
        "joints are elastic, and by default over three coordinates, a spline), cubic spline, or trigonometric "
        "(periodic) and Chebyshev (limited range)",
    )

    def check_entries(self) -> None:
        if self.sampling_tolerance is not None and self.interpolation != "spline":
            raise refusal('needs interpolation = "spline", which takes samples at any angles', "sampling_tolerance")

    def fitting(self, n_available: int, n_static: int = 0) -> Self:
        """Return these settings with as many modes as a mesh has, where the scene says no number and the mesh has no
        more than they and static ones are: all of them answer every load; raises `InputError` if the scene says a
        number, and they are too many."""
        if self.modes + n_static + self.parameter_modes <= n_available:
            return self
        if "modes" not in self.model_fields_set:
            return self.model_copy(update={"modes": n_available})
        kinds = {"static": n_static, "parameter": self.parameter_modes}
        beside = " and ".join(f"{count} {kind} modes" for kind, count in kinds.items() if count)
        raise InputError(
            f"reduction.modes = {self.modes}: {beside and f'with {beside}, '}the mesh has only {n_available} "
            "flexible modes; take fewer modes or a finer mesh"
        )


class InitialState(Table):
    """Position and velocity of a coordinate at the start."""

    position: Annotated[
        AngleOrPlace,
        no_parameter(
            "displacements, and the turns of angles, count from one place for all samples; run once for each position "
            "(--override), or start from one place with a velocity, which may be a parameter"
        ),
        Unit("rad", "m"),
    ] = Field(0.0, description="angle (rad) or displacement (m) at the start")
    velocity: Annotated[NumberOrParameter, Unit("rad/s", "m/s")] = Field(
        0.0, description="velocity at the start (rad/s or m/s)"
    )


class Initial(Table):
    """Whether runs start at rest in a static equilibrium, with the loads at time zero."""

    equilibrium: bool = Field(
        False,
        strict=True,
        description="start at rest in static equilibrium under the loads at time zero, instead of undeformed",
    )
    coordinates: Literal["held", "free"] = Field(
        "held",
        description='"held": coordinates start at simulation.initial, and are let go there; "free": they too go to '
        "the equilibrium that the loads pull them to from there",
    )

    def check_entries(self) -> None:
        if self.coordinates == "free" and not self.equilibrium:
            raise refusal("needs initial.equilibrium = true", "coordinates")


class Simulation(Table):
    """One run over time."""

    duration: Time = Field(1.0, gt=0.0, description="end time (s)")
    tolerance: Share | None = Field(
        None,
        description="largest error of any output by the time step, as a share of its largest value over time; the step "
        "is chosen where it is not given",
    )
    step: Time = Field(1.0e-3, gt=0.0, description="time step (s)")
    spectral_radius: Number = Field(
        0.8,
        ge=0.0,
        le=1.0,
        description="of generalised-alpha at infinite frequency; 1 is without numerical damping; above 0.99 "
        "constraints that turn or move have their velocities projected after every step. Full-order runs of "
        "bodies that turn freely are stable up to about 0.8 (1 - spectral_radius) rad a step",
    )
    frames: Frames = Field(101, ge=0, description="number of stored snapshots of the whole mechanism")
    error_indicator: bool = Field(
        True,
        strict=True,
        description="estimate the errors of reduced runs, from their residual in the full-order equations, and those "
        "of the time step of other runs, from a run with a coarser step",
    )
    initial: dict[str, InitialState] = Field({}, description="start of each coordinate; 0 at rest where not given")

    @property
    def is_chosen(self) -> bool:
        """Whether the step is found by its tolerance."""
        return self.tolerance is not None and "step" not in self.model_fields_set

    @property
    def n_steps(self) -> int:
        """Number of equal steps of a run, none longer than `step`."""
        return count_steps(self.duration, self.step)

    def in_steps(self, n_steps: int, duration: float | None = None) -> Self:
        """Return the same run, or another time of it (s), in so many steps."""
        whole = self.duration if duration is None else duration
        return self.model_copy(update={"duration": whole, "step": whole / n_steps})

    def check_entries(self) -> None:
        if self.step > self.duration and not self.is_chosen:
            raise refusal(f"must not exceed the duration, {self.duration} s", "step")
        if self.duration / self.step > MOST_STEPS and not self.is_chosen:
            raise refusal(
                f"makes {self.duration / self.step:.3g} steps of simulation.duration = {self.duration:g} s; at most "
                f"{MOST_STEPS:.0e} are taken, with which each output has 0.8 GB",
                "step",
            )


class Reference(Table):
    """The model that tolerances and the trade-off measure errors against."""

    model: Literal["auto", "mesh", "components"] = Field(
        "auto",
        description='"mesh": the full-order model; "components": the component model with more modes than any basis '
        'that is tried; "auto": the mesh where its runs are within the budget, else the component model. One that is '
        "named is taken at any price, which is said first",
    )
    loads: Literal["varied", "own"] = Field(
        "varied",
        description='"varied": tolerances are tried under larger and quicker loads than the scene\'s too; "own": under '
        "its own alone, and hold for no others",
    )
    budget: Annotated[PositiveNumber, Unit("s")] = Field(
        600.0,
        description="processor time that the runs of the reference may be predicted to take, all ranks, and five times "
        "what a candidate basis may, built and run (s)",
    )


Bins = Annotated[Integer, at_most(1_000_000, "every instant of every output has as many, of 8 bytes each")]
Batch = Annotated[Integer, at_most(1_000_000, "a rank holds the states and tables of so many samples at once")]
Instants = Annotated[Integer, at_most(100_000, "every sample of the bands has as many numbers of each output")]
OfBands = Annotated[Integer, at_most(10_000_000, "rank 0 holds all outputs of as many samples at every instant")]
Replicates = Annotated[Integer, Field(ge=2), at_most(1000, "each has a sequence of its own, of too few points then")]


class Event(Table):
    """An output above or below a level, at the end of a run or at any time in it."""

    one_of = ("above", "below")
    output: str = Field(description="name of an output")
    above: Annotated[Number, Unit()] | None = Field(
        None, description="the event is an output above this level, in the output's unit"
    )
    below: Annotated[Number, Unit()] | None = Field(
        None, description="the event is an output below this level, in the output's unit"
    )
    when: Literal["end", "ever"] = Field(
        "end",
        description='"end": at the end time; "ever": at the end of any step, the start included; the instant of the '
        "first passage is then kept of every sample",
    )

    @property
    def level(self) -> float:
        """The level that is exceeded, or fallen below."""
        return self.below if self.above is None else self.above

    @property
    def sign(self) -> float:
        """1 of an output above the level, -1 below: ``sign (output - level)`` is positive in the event."""
        return -1.0 if self.above is None else 1.0

    @property
    def extreme(self) -> str:
        """The extreme over time that is nearest to the event, or farthest in it: ``max`` or ``min``."""
        return "min" if self.above is None else "max"


class Ensemble(Table):
    """Many runs with parameters drawn from their distributions."""

    sampler: Literal["random", "latin_hypercube", "sobol", "saltelli"] = Field(
        "random",
        description='"random": independent samples; "latin_hypercube": one in each of N equally probable slices of '
        'every parameter; "sobol": scrambled Sobol sequences, independent replicates of them; "saltelli": base points '
        "and what differs from them in one parameter, for Sobol indices",
    )
    copula: Literal["gaussian", "student", "clayton", "gumbel", "frank"] = Field(
        "gaussian",
        description='how parameters of [correlation] depend on each other: "gaussian": extremes of two are independent '
        'in the end; "student": they come together, the more so the less `copula_freedom` is; '
        '"clayton": low values come together; "gumbel": high values do; "frank": neither do in the end',
    )
    copula_freedom: Number = Field(
        4.0, ge=1.0, le=1000.0, description="degrees of freedom of Student's copula; many are the Gaussian one"
    )
    replicates: Replicates = Field(
        8, description="scrambled Sobol sequences that take turns; intervals follow from their differences"
    )
    confidence: Share = Field(0.95, description="level of all confidence intervals")
    bins: Bins | None = Field(
        None, ge=1, description="number of bins of the estimated densities; as many as the samples tell if not given"
    )
    quantiles: tuple[Share, ...] = Field(
        (0.025, 0.25, 0.5, 0.75, 0.975), description="probabilities of the reported quantiles"
    )
    probabilities: dict[Name, Event] = Field({}, description="probabilities of events, by label")
    extremes: bool = Field(
        False,
        strict=True,
        description="keep the largest and the smallest value of every output over time, and when they are reached; "
        "outputs are then evaluated after every step; of outputs of events at any time they are always kept",
    )
    bands: Instants = Field(
        51, ge=0, description="most instants at which outputs are described over time, start and end included; 0 = none"
    )
    band_samples: OfBands = Field(
        10_000, ge=2, description="most samples that the bands are of, the first ones; the pieces keep their outputs"
    )
    batch: Batch = Field(512, ge=1, description="most samples that a rank integrates together")
    checked_share: Number | None = Field(
        None,
        ge=0.0,
        le=1.0,
        description="share of the samples whose errors are estimated: the first of every ten thousand samples; "
        "of less than a thousand, the share of a thousand; 0 = none, 1 = all; by default 0.02, or less where that "
        "would take more than a quarter of the time of the runs, but always one sample, and more than one in blocks of "
        "eight",
    )
    failed_share: Number = Field(
        0.5,
        ge=0.0,
        le=1.0,
        description="largest share of failed samples of which the outputs are described without them; beyond it they "
        "have bounds of quantiles alone, and a warning",
    )
    balance: bool = Field(
        False, description="draw up the balance of energy of every sample, which needs its energies after every step"
    )

    def check_entries(self) -> None:
        if self.bands == 1:
            raise refusal("must be 0, or at least 2: the start and the end", "bands")

    def with_extremes(self, outputs: Iterable[str]) -> list[str]:
        """Return the outputs whose extremes are kept: all, or those of events at any time, which extremes judge."""
        of_events = {event.output for event in self.probabilities.values() if event.when == "ever"}
        return [name for name in outputs if self.extremes or name in of_events]


def ensemble_problems(scene: AnyScene) -> Iterator[str]:
    """Yield one line for each event that does not fit the scene's outputs."""
    for label, event in scene.ensemble.probabilities.items():
        entry = f"ensemble.probabilities.{label}"
        if event.output not in scene.outputs:
            yield unknown(f"{entry}.output", "output", event.output, scene.outputs)
        for kind in ("outputs", "parameters"):
            if label in getattr(scene, kind):
                yield problem(entry, f"{kind}.{label} has the same name; give the event another one")
