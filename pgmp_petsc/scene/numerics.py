"""How a scene is computed: the reduction and a simulation."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from pgmp_petsc.scene.fields import (
    Angle,
    Integer,
    Number,
    NumberOrParameter,
    PositiveNumber,
    Table,
    at_most,
    no_parameter,
    refusal,
)

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
    modes: Vectors = Field(15, ge=1, description="number of flexible modes kept at every configuration")
    angles: Angles = Field(
        629, ge=4, description="number of sampled configurations along each coordinate; 24 with several"
    )
    length_points: Annotated[Integer, at_most(8, "polynomials of degree 7 are as good as the eigensolvers")] = Field(
        5,
        ge=2,
        description="Chebyshev points of every parameter that is a length or a place, over its bounds; the modes of "
        "all angles are built at each, and once more at the nominal lengths",
    )
    sampling_tolerance: Number | None = Field(
        None,
        gt=0.0,
        description="add angles until interpolated tables differ from fresh ones by no more than this share; `angles` "
        "is then the number to begin with; needs interpolation = spline",
    )
    max_angles: Angles = Field(2000, ge=4, description="where adaptive sampling gives up")
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
    stretching: Literal["dynamic", "static"] = Field(
        "dynamic",
        description='with second_order, how bodies that bend follow their shortening: "dynamic" by coordinates that '
        'stretch them, with their inertia; "static" at once, which larger deflections of slender bodies need',
    )
    effects: Literal["named", "auto"] = Field(
        "named",
        description='"auto" lets pgmp build leave out effects too small to matter, and add terms of the reduced model '
        "that do",
    )
    interpolation: Literal["overhauser", "spline", "spectral"] = Field(
        "overhauser",
        description="interpolation between samples: cubic Hermite with central-difference tangents (the paper's), "
        "cubic spline, or trigonometric (periodic) and Chebyshev (limited range)",
    )

    @model_validator(mode="after")
    def _splines_for_adaptive_sampling(self) -> Self:
        if self.sampling_tolerance is not None and self.interpolation != "spline":
            raise refusal('needs interpolation = "spline", which takes samples at any angles', "sampling_tolerance")
        return self


class InitialState(Table):
    """Where a coordinate starts."""

    position: Annotated[
        Angle,
        no_parameter(
            "displacements, and the turns of angles, count from one place for all samples; run once for each position "
            "(--override), or start from one place with a velocity, which may be a parameter"
        ),
    ] = Field(0.0, description="angle at the start (rad)")
    velocity: NumberOrParameter = Field(
        0.0, description="angular velocity at the start (rad/s), a number or a parameter's name"
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

    @model_validator(mode="after")
    def _free_in_equilibrium(self) -> Self:
        if self.coordinates == "free" and not self.equilibrium:
            raise refusal("needs initial.equilibrium = true", "coordinates")
        return self


class Simulation(Table):
    """One run over time."""

    duration: Number = Field(1.0, gt=0.0, description="end time (s)")
    tolerance: Share | None = Field(
        None,
        description="largest error of any output by the time step, as a share of its largest value over time; the step "
        "is chosen where it is not given",
    )
    step: Number = Field(1.0e-3, gt=0.0, description="time step (s)")
    spectral_radius: Number = Field(
        0.8,
        ge=0.0,
        le=1.0,
        description="of generalised-alpha at infinite frequency; 1 is without numerical damping; above 0.99 "
        "constraints that turn or move have their velocities projected after every step",
    )
    frames: Frames = Field(101, ge=0, description="number of stored snapshots of the whole mechanism")
    error_indicator: bool = Field(
        True,
        strict=True,
        description="estimate the errors of reduced runs, from their residual in the full-order equations, and those of "
        "the time step of other runs, from a run with a coarser step",
    )
    initial: dict[str, InitialState] = Field({}, description="start of each coordinate; 0 at rest where not given")

    @model_validator(mode="after")
    def _step_fits(self) -> Self:
        chosen_later = self.tolerance is not None and "step" not in self.model_fields_set
        if self.step > self.duration and not chosen_later:
            raise refusal(f"must not exceed the duration, {self.duration} s", "step")
        if self.duration / self.step > MOST_STEPS and not chosen_later:
            raise refusal(
                f"makes {self.duration / self.step:.3g} steps of simulation.duration = {self.duration:g} s; at most "
                f"{MOST_STEPS:.0e} are taken, with which each output has 0.8 GB",
                "step",
            )
        return self


class Reference(Table):
    """What tolerances and the trade-off measure errors against."""

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
    budget: PositiveNumber = Field(
        600.0,
        description="processor time that the runs of the reference may be predicted to take, all ranks, and five times "
        "what a candidate basis may, built and run (s)",
    )
