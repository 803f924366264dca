"""Entries of controllers in a scene, and what all else has to know of one. The controllers are in `controllers`.

A controller measures an output and acts on the motion in a joint. It has states of its own beside the mechanics,
z' = g(z, measure, reference, t), in the same steps.
"""

from collections.abc import Iterator
from fractions import Fraction
from math import lcm
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from pgmp_petsc.declare.ideas import CONTROLLERS, Found, blaming, refuse
from pgmp_petsc.scene.fields import (
    AnyScene,
    LoadHarmonic,
    LoadTable,
    NumberOrParameter,
    Table,
    Time,
    Unit,
    Use,
    jumps_within,
    refusal,
)
from pgmp_petsc.scene.messages import problem, unknown
from pgmp_petsc.scene.outputs import circle_of, models_alone
from pgmp_petsc.scene.references import joint_problems, motion_problems

OWN = "of_"  # before names of a scene, in a law
WHOLE = 1e-6  # of a step, that a sample time may be off a whole number of them
MOST_SAMPLED = 2**14  # steps of the coarsest run that a tolerance tries


class Setpoint(Table):
    """The wanted value of a measure: a number, or over time."""

    one_of = ("constant", "table", "harmonic")
    constant: NumberOrParameter | None = Field(
        None, description="the same all the time; a number for the table says it"
    )
    table: LoadTable | None = Field(None, description="rows [time (s), value], linear between rows; or a CSV file")
    harmonic: LoadHarmonic | None = Field(None, description="{ amplitude, frequency_hz, phase = 0, mean = 0 }")

    @model_validator(mode="before")
    @classmethod
    def _number(cls, given: Any) -> Any:
        if isinstance(given, list):
            raise refusal("a number, the name of a parameter, or { table = [[time, value], ...] } is needed")
        return given if isinstance(given, (dict, Setpoint)) else {"constant": given}

    def check_entries(self) -> None:
        values = [value for _, value in self.table or ()]
        values += [self.harmonic.amplitude, self.harmonic.mean] if self.harmonic else []
        named = [value for value in values if isinstance(value, str)]
        if named:
            words = f"{named[0]}: over time numbers are needed; a reference that is always the same may be a parameter"
            raise refusal(words)


class ControllerEntry(Table):
    """A table ``[controllers.NAME]``. A controller is a subclass with ``type: Literal["..."]``, its entries, and what
    it does (`law`, `parameters`)."""

    measures: str = Field(description="name of the output that it measures")
    reference: Setpoint = Field(
        Setpoint(constant=0.0),
        description="what the measure is to be: a number, a parameter's name, or { table } or { harmonic } over time",
    )
    joint: str = Field(description="name of the joint that its torque or force acts on")
    motion: Literal["turning", "sliding"] | None = Field(None, description="which motion of a joint that has both")
    limits: tuple[NumberOrParameter, ...] | None = Field(
        None,
        min_length=2,
        max_length=2,
        description="lowest and highest torque (N m) or force (N), each a number or a parameter's name",
    )
    sample_time: Time = Field(
        0.0,
        ge=0.0,
        description="0 is continuous; else it measures at 0, sample_time, ... and holds what it found until the next "
        "time; a whole number of steps",
    )
    #: Motions of which the joint that it acts on leaves one free.
    joints: ClassVar[tuple[str, ...]] = ("turning", "sliding")

    @field_validator("limits", mode="before")
    @classmethod
    def _with_units(cls, limits: object, info: ValidationInfo) -> object:
        return Unit("N m", "N").numbers(limits, info)  # no note: the law has its numbers in the scene's units

    @classmethod
    def __pydantic_init_subclass__(cls, **arguments: Any) -> None:
        made = ("law", "parameters", "forces")
        if CONTROLLERS.take(cls) and any(getattr(cls, one) is getattr(ControllerEntry, one) for one in made):
            words = "a controller has the methods law(self) and parameters(self), and forces(self, name, mechanism)"
            raise refuse(cls, f"{words}, as a JointController has")

    def law(self) -> Any:
        """Return the law of its states and of its force, a `controllers.law.ControlLaw`."""
        raise NotImplementedError

    def parameters(self) -> dict[str, float | str]:
        """Return the parameters of its law by name, numbers or names of parameters."""
        raise NotImplementedError

    def forces(self, name: str, mechanism: Any) -> Any:
        """Return what acts in the models, an `effects.effect.Effect`, on a `mechanism.mechanism.Mechanism`."""
        raise NotImplementedError

    @property
    def needs_rate(self) -> bool:
        """Whether it takes the rate of its measure."""
        with blaming(type(self)):
            return self.law().reads("rate")

    @property
    def measured(self) -> dict[str, str]:
        """The outputs that it measures, by their names in the law."""
        return {"y": self.measures}

    def jumps_within(self, step: float) -> bool:
        """Return whether its force may jump within a step of that length, s, at other instants than its samplings."""
        return not self.sample_time and jumps_within(self.reference.table or (), step)

    @property
    def cornered(self) -> bool:
        """Whether its force may follow corners of its reference at once."""
        return not self.sample_time and self.reference.table is not None

    def problems(self, scene: AnyScene, name: str) -> Iterator[str]:
        """Yield a line for each entry that does not fit the rest of the scene; names of tables are looked at."""
        yield from ()

    def uses(self, entry: str) -> Iterator[Use]:
        """Yield the entries that may name a parameter; a controller's may be of any unit."""
        if self.reference.constant is not None:
            yield Use(f"{entry}.reference", self.reference.constant)
        for k, limit in enumerate(self.limits or ()):
            yield Use(f"{entry}.limits[{k}]", limit)

    def references(self, scene: AnyScene, entry: str) -> Iterator[Use]:
        """Yield in which unit a value of its reference is, where that is not any."""
        yield from ()


#: A table of ``[controllers]``.
Controller = Annotated[ControllerEntry, Found(CONTROLLERS)]


def controller_problems(scene: AnyScene) -> Iterator[str]:
    """Yield one line for each entry of a controller that does not fit."""
    for name, one in scene.controllers.items():
        entry = f"controllers.{name}"
        if name in scene.effects:
            yield problem(entry, f"effects.{name} has this name; give the controller another one")
        yield from joint_problems(scene, f"{entry}.joint", one.joint)
        yield from motion_problems(scene, entry, one, one.joints)
        for key, output in one.measured.items():
            where = "measures" if isinstance(one.measures, str) else f"measures.{key.removeprefix(OWN)}"
            yield from _measure(scene, f"{entry}.{where}", output, one)
        yield from _sampling(scene, entry, one)
        yield from one.problems(scene, name)
        if scene.initial.coordinates == "free":
            words = "controllers begin with a run, and its equilibrium does not know them; leave it out to hold joints"
            yield problem("initial.coordinates", f"with {entry}: {words}", "free")


def _measure(scene: AnyScene, entry: str, measured: str, controller: ControllerEntry) -> Iterator[str]:
    if measured not in scene.outputs:
        yield unknown(entry, "output", measured, scene.outputs)
    elif circle_of(scene, measured):
        return  # said elsewhere
    else:
        order, alone = scene.outputs[measured].derivatives_in(scene), models_alone(scene, measured)
        what = "stresses or forces" if alone else "accelerations" if order > 1 else "speeds, and its rate accelerations"
        cure = "measure a place, an angle or a speed"
        if order == 1:
            cure = "measure a place or an angle, or do without its rate (give a gain d a filter)"
        if alone or order > 1 or order == 1 and controller.needs_rate:
            why = f"reads {what}, which hang on the controller's own force at the same instant"
            yield problem(entry, f"outputs.{measured} {why}; {cure}", measured)


def steps_of_samplings(scene: AnyScene) -> int:
    """Return the fewest steps of a run at whose ends all samplings of controllers are; those of other such runs are
    multiples."""
    return lcm(*(_share(scene, one).denominator for one in scene.controllers.values() if one.sample_time))


def _share(scene: AnyScene, one: ControllerEntry) -> Fraction:
    """Return a sample time as a share of the run."""
    return Fraction(one.sample_time / scene.simulation.duration).limit_denominator(MOST_SAMPLED)


def _sampling(scene: AnyScene, entry: str, one: ControllerEntry) -> Iterator[str]:
    run = scene.simulation
    if not one.sample_time:
        return
    if run.is_chosen:
        if abs(_share(scene, one) * run.duration - one.sample_time) > WHOLE * one.sample_time:
            words = f"no step that simulation.tolerance finds divides it and simulation.duration = {run.duration:g} s"
            yield problem(f"{entry}.sample_time", f"{words}: let one be a multiple of the other", one.sample_time)
        return
    step = run.duration / run.n_steps
    ratio = one.sample_time / step
    if round(ratio) < 1:
        words = f"is shorter than simulation.step = {run.step:g} s; take smaller steps, or 0 for a continuous one"
        yield problem(f"{entry}.sample_time", words, one.sample_time)
    elif abs(ratio - round(ratio)) > WHOLE * ratio:
        words = f"must be a whole number of steps of {step:.6g} s, and is {ratio:.6g} of them; take one that divides it"
        yield problem(f"{entry}.sample_time", words, one.sample_time)
