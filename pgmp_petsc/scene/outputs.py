"""Entries of outputs in a scene, and what all else has to know of one. The outputs themselves are in `outputs`.

An output is one class: its entries, what it reads of a motion, and what is declared of it here.
"""

import re
from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Annotated, Any, ClassVar, Literal

from pgmp_petsc.base.units import UnknownUnit, take_unit
from pgmp_petsc.declare.ideas import OUTPUTS, Found, refuse
from pgmp_petsc.scene.fields import AnyScene, Table, Use, named_numbers
from pgmp_petsc.scene.messages import Finding

Axis = Literal["x", "y", "z"]
#: Quantities of beams that need the shape of the section.
OF_FIBRES = ("stress_max", "stress_min")
_OF_FIBRES = dict.fromkeys(OF_FIBRES, "Pa")
_OF_SOLIDS = dict.fromkeys(("von_mises", "principal_max", "principal_min"), "Pa")
#: Quantities of a stress output by the kind of element, with their units.
STRESSES = {
    "solid2d": _OF_SOLIDS,
    "solid3d": _OF_SOLIDS,
    "beam2d": {"axial_force": "N", "shear_force": "N", "bending_moment": "N m"} | _OF_FIBRES,
    "beam3d": dict.fromkeys(("axial_force", "shear_force_2", "shear_force_3"), "N")
    | dict.fromkeys(("torsion_moment", "bending_moment_2", "bending_moment_3"), "N m")
    | _OF_FIBRES,
}
#: All of them, each once.
QUANTITIES = tuple(dict.fromkeys(chain(*STRESSES.values())))
#: What outputs may read.
READS = ("frames", "outputs", "time", "parameters", "stresses", "multipliers", "beside", "history")
#: Entries that say of what, where others than the output itself read it.
NAMING = {"stresses": ("body", "quantity", "at", "group", "region"), "beside": ("controller",)}


class OutputEntry(Table):
    """A table ``[outputs.NAME]``. An output is a subclass with ``type: Literal["..."]``, its entries, and `reads`."""

    #: What it reads of a motion, of `READS`: ``frames`` of nodes with their rates and accelerations, the ``time`` and
    #: values of ``parameters``, of which it is what `reading` returns; or ``stresses`` or ``multipliers`` of
    #: constraints, or forces ``beside`` the mechanics, which models observe; or the ``history`` of others, which is
    #: counted.
    reads: ClassVar[tuple[str, ...]]
    #: Motions of which the joint that it is of leaves one free: ``turning``, ``sliding``.
    joints: ClassVar[tuple[str, ...]] = ()
    #: Unit of what is read of frames, or of its rate.
    unit: ClassVar[str]
    #: Which derivative over time it takes of what it reads: 1 if that is a speed of it.
    derivative: ClassVar[int] = 0
    #: Whether it may be of what deforms bodies alone, so that a model's error of deformations is one of it.
    of_deformation: ClassVar[bool] = False
    #: Whether it is of what acts in the joint that it names.
    in_joint: ClassVar[bool] = False
    #: The other outputs that it is made of, each with the entry that names it.
    made_of: ClassVar[Mapping[str, str]] = {}

    @classmethod
    def __pydantic_init_subclass__(cls, **arguments: Any) -> None:
        if not OUTPUTS.take(cls):
            return
        reads = getattr(cls, "reads", ())
        cls.reads = (reads,) if isinstance(reads, str) else tuple(reads)
        if not cls.reads or not set(cls.reads) <= set(READS):
            raise refuse(cls, f'an output says what it reads: reads = ("frames",), of {", ".join(READS)}')
        of_frames = cls.of_frames() and "outputs" not in cls.reads
        if (cls.combined is not OutputEntry.combined) != ("outputs" in cls.reads):
            raise refuse(cls, "an output has the method combined(self, name, parts, scene) if it reads outputs")
        if (cls.multiplied is not OutputEntry.multiplied) != ("multipliers" in cls.reads):
            raise refuse(cls, "an output has the method multiplied(self, name, kinematics) if it reads multipliers")
        for what, keys in NAMING.items():
            lacking = ", ".join(key for key in keys if key not in cls.model_fields)
            if what in cls.reads and lacking:
                raise refuse(cls, f"an output that reads {what} has the entries {', '.join(keys)}; missing: {lacking}")
        if (cls.reading is not OutputEntry.reading) != of_frames:
            raise refuse(cls, "an output has the method reading(self, name, start, kinematics) if it reads frames")
        if of_frames and not getattr(cls, "unit", ""):
            raise refuse(cls, 'an output of frames says its unit: unit = "m"')
        if isinstance(getattr(cls, "unit", None), str):
            try:
                take_unit(cls.unit)
            except UnknownUnit as error:
                raise refuse(cls, f"unit = '{cls.unit}' is no SI unit: {error}") from None
        if bool(cls.joints) != ("joint" in cls.model_fields) and (of_frames or cls.joints):
            raise refuse(cls, 'an output with the entry joint says what of it is free: joints = ("turning",)')

    def stated(self, name: str, mechanism: Any) -> dict[str, Any]:
        """Return the statement about two frames that it reads, or the derivative of, with their attachments, as
        `effects.action.Action` takes them: controllers that measure it have slopes by that."""
        raise NotImplementedError

    @property
    def is_stated(self) -> bool:
        """Whether it reads such a statement."""
        return type(self).stated is not OutputEntry.stated

    def expression(self, scene: AnyScene, seen: Any) -> Any:
        """Return what it is of other outputs for a controller, one of those in `outputs.readings`, of what `seen`
        returns for their names; None if controllers take it as a motion of its own."""
        return None

    def made_in(self, scene: AnyScene) -> Mapping[str, str]:
        """Return `made_of`, where that hangs on the scene. Raises `InputError` if it names no entries."""
        made = self.made_of
        if not isinstance(made, Mapping) or not all(key in type(self).model_fields for key in made.values()):
            raise refuse(type(self), 'made_of gives the entry of every output, as {self.output: "output"}')
        return made

    def combined(self, name: str, parts: Mapping[str, Any], scene: AnyScene) -> Any:
        """Return what is read, if it reads other outputs, of readings of these."""
        raise NotImplementedError

    def multiplied(self, name: str, kinematics: Any) -> Any:
        """Return what makes it of multipliers, an `outputs.multipliers.ForceOutput`, if it reads these; raises
        `InputError` where they do not determine it."""
        raise NotImplementedError

    @classmethod
    def of_frames(cls) -> bool:
        """Whether frames and their rates are all that it reads."""
        return {"stresses", "multipliers", "beside", "history"}.isdisjoint(cls.reads)

    def unit_in(self, scene: AnyScene) -> str:
        """Return its unit, where that is not the same for all."""
        return self.unit

    def reading(self, name: str, start: Any, kinematics: Any) -> Any:
        """Return what is read, a `Reading` of frames or another of `outputs.readings`, from coordinates at the start,
        shape (n_theta,), rad, and a `mechanism.kinematics.RigidKinematics`; raises `InputError`, with the output's
        dotted name, if a body's mesh does not have a point that it is at."""
        raise NotImplementedError

    @property
    def is_counted(self) -> bool:
        """Whether it is counted over a run: a figure of the whole of it, as a damage."""
        return "history" in self.reads

    def of_springs(self, scene: AnyScene) -> bool:
        """Whether it is of what a joint's springs carry, none of which is a multiplier."""
        return False

    def kinked_in(self, scene: AnyScene) -> bool:
        """Whether it is the largest at many points: its history has kinks where another point takes over."""
        return any(scene.outputs[one].kinked_in(scene) for one in self.made_in(scene))

    def deforms_in(self, scene: AnyScene) -> bool:
        """Whether it, or one that it is made of, may be of what deforms bodies alone."""
        return self.of_deformation or any(scene.outputs[one].deforms_in(scene) for one in self.made_in(scene))

    def derivatives_in(self, scene: AnyScene) -> int:
        """Return which derivative of places it takes: 0 of places, 1 of speeds, 2 of accelerations."""
        others = (scene.outputs[one].derivatives_in(scene) for one in self.made_in(scene))
        return self.derivative + max(others, default=0)

    def jumps_in(self, scene: AnyScene) -> bool:
        """Whether it jumps with the forces of controllers that are sampled."""
        of_forces = self.derivatives_in(scene) > 1 or not {"beside", "multipliers"}.isdisjoint(self.reads)
        jumps = of_forces or any(scene.outputs[one].jumps_in(scene) for one in self.made_in(scene))
        return jumps and any(one.sample_time for one in scene.controllers.values())

    def uses(self, scene: AnyScene, entry: str) -> Iterator[Use]:
        """Yield the entries that may name a parameter; `entry` is the output's own."""
        yield from named_numbers(entry, self)

    def measured(self, entry: str) -> Iterator[Use]:
        """Yield the entries that no parameter can be, and whose unit is not that of their field."""
        yield from ()

    def doubts(self, scene: AnyScene, name: str) -> Iterator[Finding]:
        """Yield what probably is not meant."""
        yield from ()

    def problems(self, scene: AnyScene, name: str) -> Iterator[str]:
        """Yield a line for each entry that does not fit the rest of the scene; joints and points are looked at."""
        yield from ()


def circle_of(scene: AnyScene, name: str) -> list[str]:
    """Return the outputs from one to the next that it is made of and back to it; none where there is no such circle."""
    waiting: list[list[str]] = [[name]]
    seen: set[str] = set()
    while waiting:
        way = waiting.pop()
        for other in scene.outputs[way[-1]].made_in(scene):
            if other == name:
                return [*way, name]
            if other in scene.outputs and other not in seen:
                seen.add(other)
                waiting.append([*way, other])
    return []


def unit_of(scene: AnyScene, name: str) -> str:
    """Return the unit of an output that another is made of; empty where there is none."""
    return scene.outputs[name].unit_in(scene) if name in scene.outputs and not circle_of(scene, name) else ""


def per_second(unit: str) -> str:
    """Return the unit of a rate."""
    found = re.search(r"/s(\d*)$", unit)
    return f"{unit[: found.start()]}/s{int(found[1] or 1) + 1}" if found else f"{unit or 1}/s"


def reads(scene: AnyScene, name: str, what: str, but_springs: bool = False) -> bool:
    """Whether an output, or one that it is made of, reads something of `READS`; or other than as a spring's force."""
    entry = scene.outputs[name]
    own = what in entry.reads and not (but_springs and entry.of_springs(scene))
    return own or any(reads(scene, one, what, but_springs) for one in entry.made_in(scene))


def after_start(scene: AnyScene) -> tuple[str, ...]:
    """Return the outputs that are judged from the first step on: what joints carry where bodies start undeformed.

    Loads have not reached the joints at time 0: what these carry then hangs on the mesh and on modes alone; but what
    springs of theirs carry is known from where they are.
    """
    if scene.initial.equilibrium or not any(body.flexible for body in scene.bodies.values()):
        return ()
    return tuple(name for name in scene.outputs if reads(scene, name, "multipliers", but_springs=True))


def models_alone(scene: AnyScene, name: str) -> bool:
    """Whether an output, or one that it is made of, is of what models alone know: stresses, multipliers, histories."""
    entry = scene.outputs[name]
    return not entry.of_frames() or any(models_alone(scene, one) for one in entry.made_in(scene))


#: A table of ``[outputs]``.
Output = Annotated[OutputEntry, Found(OUTPUTS)]
