"""Entries of effects in a scene, and what all else has to know of one. The effects themselves are in `effects`.

An effect is one class: its entries, and what is declared of it here. An effect that a scene does not name is never
evaluated.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from pydantic import Field

from pgmp_petsc.base.errors import InputError, shortened
from pgmp_petsc.base.units import UNITS, UnknownUnit, take_unit
from pgmp_petsc.declare.ideas import EFFECTS, PACKAGE, Found, refuse
from pgmp_petsc.scene.fields import (
    AnyScene,
    LoadHarmonic,
    LoadTable,
    NotNegativeOrParameter,
    NumberOrParameter,
    Point,
    PositiveOrParameter,
    Table,
    Unit,
    Use,
    jumps_within,
    named_numbers,
    quantities_of,
    refusal,
    tried,
)
from pgmp_petsc.scene.uses import motion_over

if TYPE_CHECKING:
    from pgmp_petsc.scene.messages import Finding

TABLE = (
    "rows [time (s), value]; linear between rows, constant before and after them; each value a number or a parameter's "
    "name; or a CSV file of such rows of numbers: its name, or { file, x, y } with the names of two columns"
)


class EffectEntry(Table):
    """A table ``[effects.NAME]``. An effect is a subclass with ``type: Literal["..."]``, its entries, and `acts`.

    An entry that may name a parameter says its `Unit`. What two entries ask of each other says `check_entries`, what
    the rest of the scene has to have are `problems`.
    """

    #: What it is: ``forces`` that `forces` makes, a part of the ``mechanism``, or of its ``reduction`` alone.
    acts: ClassVar[Literal["forces", "mechanism", "reduction"]]
    #: Motions of which the joint that it is on leaves one free: ``turning``, ``sliding``.
    joints: ClassVar[tuple[str, ...]] = ()
    #: Entries that may be changed with a model that is built.
    changeable: ClassVar[tuple[str, ...]] = ()
    #: Whether its law is evaluated in every step, on the frames of two nodes; loads cost nothing to speak of.
    local: ClassVar[bool] = False
    #: Whether it is what a scene is about, and never left out for being small.
    cause: ClassVar[bool] = False
    #: Whether a scene has one at most.
    single: ClassVar[bool] = False
    #: Whether its force turns within a step, so that the error of a step does not fall as its square.
    edged: ClassVar[bool] = False
    #: Names of its formula with which its force jumps.
    jumps_with: ClassVar[frozenset[str]] = frozenset()
    #: Whether it is a load whose table or harmonic is over time.
    is_over_time: ClassVar[bool] = False
    #: How bodies follow their shortening by bending, ``static`` or ``dynamic``; None if that is not said.
    is_stretching: ClassVar[str | None] = None
    #: Whether the inertia forces that are quadratic in velocities stay.
    keeps_velocity_forces: ClassVar[bool] = True
    #: Terms that it adds to a model besides loads and local forces, in words.
    adds: ClassVar[str] = ""
    #: Whether it acts on vibrations alone: the rigid mechanism does not feel it.
    on_vibrations: ClassVar[bool] = False
    #: Whether it is a uniform field of acceleration.
    uniform: ClassVar[bool] = False
    #: Whether it is a part of what is of second order in deformation.
    second_order: ClassVar[bool] = False
    #: Unit of its strength, where that changes over time.
    strength_unit: ClassVar[str] = ""
    #: Entry without which it is nothing.
    nothing_without: ClassVar[str] = ""
    #: Whether its force hangs on the one that its joint carries, so that it is found between corrections of a step.
    by_load: ClassVar[bool] = False
    #: Entry of the stiffness that bodies meet.
    stiff_by: ClassVar[str] = ""
    #: Entries of the places where the stiffness sets in, and on which side of them: 1 is above, -1 below.
    sets_in: ClassVar[dict[str, float]] = {}
    #: Pairs of entries of which the first is below the second, in every sample.
    ordered: ClassVar[tuple[tuple[str, str], ...]] = ()

    @classmethod
    def __pydantic_init_subclass__(cls, **arguments: Any) -> None:
        if EFFECTS.take(cls):
            _check(cls)

    def forces(self, name: str, mechanism: Any) -> Any:
        """Return what acts in the models, an `effects.effect.Effect`, on a `mechanism.mechanism.Mechanism`; raises
        `InputError` if a body's mesh does not have a point that it is at."""
        raise NotImplementedError

    def course(self) -> Any:
        """Return how far the base goes along its `direction` over time, m, without its `scale`, an
        `effects.time_function.TimeFunction`; None if it does not move the base."""
        return None

    def jumps_within(self, step: float) -> bool:
        """Return whether its force may jump within a step of that length, s."""
        return bool(self.jumps_with)

    def problems(self, scene: AnyScene, name: str) -> Iterator[str]:
        """Yield a line for each entry that does not fit the rest of the scene; joints and points are looked at."""
        yield from ()

    def doubts(
        self, scene: AnyScene, entry: str, frequencies: Mapping[str, float], first: Callable[[], float | None]
    ) -> "Iterator[Finding]":
        """Yield what probably is not meant, or cannot be, beyond what holds for all effects of its kind.

        Frequencies are the first ones of flexible bodies between hinges, Hz, as far as they are known, and `first`
        returns that of the mechanism, Hz, if it can be had.
        """
        yield from ()

    @classmethod
    def if_added(cls, scene: AnyScene, run: Any, exchanged: float, tolerance: float) -> tuple[float, str] | None:
        """Return how much it would matter in a scene that has none, as a share and in words; None if nobody can say.

        `run` is a `studies.building.RigidRun` of the rigid mechanism, in which so much energy is moved around (J);
        from the tolerance on something matters. The share is NaN where only the words are known.
        """
        return None

    def uses(self, entry: str, turns: bool) -> Iterator[Use]:
        """Yield the entries that may name a parameter; `entry` is the effect's own, `turns` what it acts on."""
        yield from named_numbers(entry, self, not turns)

    def measured(self, scene: AnyScene, entry: str) -> Iterator[Use]:
        """Yield the entries that no parameter can be, and whose unit hangs on the scene; `entry` is the effect's."""
        yield from ()


def _check(cls: type[EffectEntry]) -> None:
    """Refuse an effect that is not whole. Raises `InputError`, with the file and line of the class."""
    made = cls.forces is not EffectEntry.forces
    if getattr(cls, "acts", None) not in ("forces", "mechanism", "reduction"):
        raise refuse(cls, 'an effect says what it is: acts = "forces" (or "mechanism", "reduction")')
    if made != (cls.acts == "forces"):
        needed = "needs the method forces(self, name, mechanism), which makes them" if not made else "has no forces"
        raise refuse(cls, f'an effect with acts = "{cls.acts}" {needed}')
    if cls.acts == "mechanism" and not issubclass(cls, (AddedMass, Driving)):
        raise refuse(cls, "what is a part of the mechanism is an AddedMass, or a Driving that moves a coordinate")
    if issubclass(cls, Driving) and (cls.motion is Driving.motion or cls.fastest is Driving.fastest):
        raise refuse(cls, "what drives has the method motion(self, name) and the property fastest")
    terms = ("second_order", "is_stretching", "keeps_velocity_forces")
    if cls.acts == "reduction" and all(getattr(cls, term) is getattr(EffectEntry, term) for term in terms):
        raise refuse(cls, f"what is a part of the reduction says of which: {', '.join(terms)}")
    without = cls.nothing_without if isinstance(cls.nothing_without, str) else ""  # or it hangs on other entries
    named = (*cls.changeable, *filter(None, [without, cls.stiff_by]), *cls.sets_in, *chain(*cls.ordered))
    strange = [key for key in named if key not in cls.model_fields]
    if strange:
        raise refuse(cls, f"there is no entry {strange[0]}; its entries: {', '.join(cls.model_fields)}")
    if bool(cls.joints) != ("joint" in cls.model_fields):
        raise refuse(cls, 'an effect with the entry joint says what of it is free: joints = ("turning", "sliding")')
    if cls.by_load is not False and "joint" not in cls.model_fields:
        raise refuse(cls, "what hangs on the force that its joint carries (by_load) has the entry joint")
    if issubclass(cls, OverTime) and not cls.strength_unit:
        raise refuse(cls, 'an effect over time says the unit of its values: strength_unit = "N m"')
    for key, (_, unit) in quantities_of(cls).items():
        for one in filter(None, (unit.on_turning, unit.on_sliding)):
            try:
                take_unit(one)
            except UnknownUnit:
                such = ", ".join(UNITS)
                raise refuse(cls, f"{key} is in '{one}', which is no SI unit of a scene; such units: {such}") from None
    if made and not cls.__module__.startswith(PACKAGE):
        _try_forces(cls)


class ActionMismatch(InputError):
    """An action does not fit its law, or its points."""


def _try_forces(cls: type[EffectEntry]) -> None:
    """Let an effect make its forces in a mechanism that agrees to all; raises `ActionMismatch`.

    What else goes wrong in it says nothing of the effect in a scene.
    """
    from unittest.mock import MagicMock  # takes a noticeable time, and few commands have plugins

    try:
        tried(cls).forces(get_args(cls.model_fields["type"].annotation)[0], MagicMock())
    except ActionMismatch:
        raise
    except Exception:
        return


class OverTime(EffectEntry):
    """An effect with a given strength over time."""

    acts = "forces"
    one_of = ("table", "harmonic")
    table: LoadTable | None = Field(None, description=TABLE)
    harmonic: LoadHarmonic | None = Field(None, description="{ amplitude, frequency_hz, phase = 0, mean = 0 }")
    scale: Annotated[NumberOrParameter, Unit("1")] = Field(1.0, description="factor on it")
    changeable: ClassVar[tuple[str, ...]] = ("table", "harmonic")
    nothing_without: ClassVar[str] = "scale"
    cause: ClassVar[bool] = True

    @property
    def is_over_time(self) -> bool:
        """Whether its table is not over the motion of a joint."""
        return getattr(self, "over", None) is None

    @property
    def unit_of_values(self) -> str:
        """Unit of the values over time."""
        return self.strength_unit

    @property
    def parameters_over_time(self) -> tuple[str, ...]:
        """The parameters that values of its function of time name, each once."""
        return tuple(dict.fromkeys(value for _, value in self.values_over_time if isinstance(value, str)))

    @property
    def values_over_time(self) -> tuple[tuple[str, float | str], ...]:
        """The values of its function of time with the entries that they are in, under the effect's."""
        if self.harmonic is not None:
            return tuple((f"harmonic.{key}", getattr(self.harmonic, key)) for key in ("amplitude", "mean"))
        return tuple((f"table[{row}]", value) for row, (_, value) in enumerate(self.table or ()))

    def uses(self, entry: str, turns: bool) -> Iterator[Use]:
        """Yield the entries that may name a parameter; the factor of a table is a number, or has the table's unit."""
        for use in super().uses(entry, turns):
            yield replace(use, units=("1", self.unit_of_values)) if use.entry == f"{entry}.scale" else use
        for key, value in self.values_over_time:
            yield Use(f"{entry}.{key}", value, "any", (self.unit_of_values,))

    def jumps_within(self, step: float) -> bool:
        return self.is_over_time and jumps_within(self.table or (), step)

    def measured(self, scene: AnyScene, entry: str) -> Iterator[Use]:
        """Yield the times of a table, or where its rows are along the motion of a joint."""
        unit = "s" if self.is_over_time else "m" if motion_over(scene, self) == "sliding" else "rad"
        return Use.of_rows(f"{entry}.table", self.table, unit)

    def check_entries(self) -> None:
        if isinstance(self.scale, str) and self.parameters_over_time:
            named = shortened(", ".join(self.parameters_over_time))
            words = f"a number is needed: values over time name {named}, and loads are affine in their parameters"
            raise refusal(f"{words}; give these values numbers, or leave the scale out", "scale")


#: Of what hangs on the motion of a joint.
OverMotion = Annotated[
    Literal["turning", "sliding"] | None, Field(description="which motion of the joint `over`, where it has both")
]


class OnJoint(EffectEntry):
    """An effect on the motion in a joint."""

    acts = "forces"
    joints = ("turning", "sliding")
    local = True
    joint: str = Field(description="name of a joint that turns or slides")
    motion: Literal["turning", "sliding"] | None = Field(None, description="which motion of a joint that has both")

    #: Entry that its work grows with.
    strength: ClassVar[str] = ""

    @classmethod
    def work(cls, rate: np.ndarray, time: np.ndarray, turns_freely: bool) -> float:
        """Return the work (J) of one unit of its strength on a joint that moves at rates (n,) at times (n,).

        `turns_freely` is whether the joint turns about several axes, where rates have no sign.
        """
        raise NotImplementedError

    @classmethod
    def if_added(cls, scene: AnyScene, run: Any, exchanged: float, tolerance: float) -> tuple[float, str] | None:
        """Return from which strength on it would matter: the smallest of joints that turn, of those that slide, and of
        those that turn about several axes."""
        texts, note = [], ""
        if not cls.strength or not exchanged:
            return None
        _, of = quantities_of(cls)[cls.strength]
        for motion in ("turning", "sliding", "spin"):
            spins, own = motion == "spin", [(joint, rate) for (joint, its), rate in run.joints.items() if its == motion]
            works = {joint: cls.work(rate, run.time, spins) for joint, rate in own}
            if not any(works.values()):
                continue
            joint, unit = max(works, key=works.get), of.where(motion == "sliding")
            kind = scene.joints[joint]
            about = f", {motion}" if len(kind.motions) > 1 else f", {kind.type}" if spins else ""
            least = scene.system.text(tolerance * exchanged / works[joint], unit, ".2g")
            texts.append(f"{least} on ({joint}{about})")
            note = "; none can be on joints that turn about several axes" if spins else ""
        return (np.nan, f"would matter from {', '.join(texts)}{note}") if texts else None


class AddedMass(EffectEntry):
    """A mass at a point of a body, a part of the mechanism."""

    acts: ClassVar[str] = "mechanism"
    point: Point = Field(description='where it is, "body:point"')
    mass: Annotated[PositiveOrParameter, Unit("kg")] = Field(description="mass (kg)")
    inertia: Annotated[NotNegativeOrParameter, Unit("kg m2")] = Field(
        0.0, description="moment of inertia about the point (kg m2)"
    )


class Driving(EffectEntry):
    """An effect that moves a coordinate as given, whatever force it takes."""

    coordinate: str

    @property
    def fastest(self) -> tuple[str, float, tuple[float, ...]]:
        """The entry that says how fast it becomes, how fast, and the entry's value if that is the speed."""
        raise NotImplementedError

    def motion(self, name: str) -> Any:
        """Return the motion over time, an `effects.motion.Motion`."""
        raise NotImplementedError


#: A table of ``[effects]``.
Effect = Annotated[EffectEntry, Found(EFFECTS)]
