"""Entries of outputs of what joints carry, of what prescribed motions take, and of what controllers put on joints.

What they are of the multipliers of constraints, with their points and signs, is in `multipliers`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.outputs.multipliers import SIZES, ForceOutput, OfConnection, OfCoupling, OfPrescribed, share_of
from pgmp_petsc.outputs.readings import Reading
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.joints import CouplingEntry
from pgmp_petsc.scene.messages import problem, unknown
from pgmp_petsc.scene.outputs import OutputEntry
from pgmp_petsc.scene.uses import slides

Component = Literal["x", "y", "z", "axial", "radial", "magnitude"]


class InJoint(OutputEntry):
    """A component of what acts in a joint."""

    reads, in_joint = ("multipliers",), True
    turning: ClassVar[bool]  # whether it is a moment
    joint: str = Field(description="name of a joint, or of one that couples the motions of others")
    component: Component = Field(
        "magnitude",
        description="x, y, z; axial, along the joint's first axis (of a moment in the plane z), and radial, across it; "
        "magnitude. Of a coupling it is along the motion: axial",
    )
    of: Literal["first", "second"] = Field(
        "second", description="on which body it acts; of a coupling the motion of which joint that it names"
    )
    frame: Literal["ground", "body"] = Field("ground", description="whose axes x, y and z are: those of that body")

    def kinked_in(self, scene: Scene) -> bool:
        """Whether it is a size, which has a kink where what it is of turns around."""
        return self.component in SIZES

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        """Yield a line if there is no such joint, or it has no such component."""
        entry, joint = f"outputs.{name}", scene.joints.get(self.joint)
        if joint is None:
            yield unknown(f"{entry}.joint", "joint", self.joint, scene.joints)
        elif isinstance(joint, CouplingEntry):
            yield from self._of_coupling(scene, entry, joint)
        elif scene.dimension == 2 and self.turning and self.component in ("x", "y", "radial"):
            yield problem(f"{entry}.component", "a moment in the plane is about z: take z", self.component)
        elif scene.dimension == 2 and not self.turning and self.component == "z":
            yield problem(f"{entry}.component", "a force in the plane has x and y", "z")
        elif not joint.axes and self.component in ("axial", "radial") and not (scene.dimension == 2 and self.turning):
            words = f"{self.joint} is {joint.type}, which has no axis; take x, y, magnitude"
            yield problem(f"{entry}.component", words, self.component)

    def _of_coupling(self, scene: Scene, entry: str, joint: CouplingEntry) -> Iterator[str]:
        if self.component not in ("axial", "magnitude"):
            words = f"{self.joint} is {joint.type}, which acts along motions: take axial or magnitude"
            yield problem(f"{entry}.component", words, self.component)
        share = share_of(joint, joint.shares_in(scene), self.of)
        if share.motion is not None and (share.motion == "turning") != self.turning:
            other = "joint_force" if self.turning else "joint_torque"
            words = f"what {self.joint} couples there is the {share.motion} of {share.joint}: take {other}"
            yield problem(f"{entry}.of", words, self.of)

    def of_springs(self, scene: Scene) -> bool:
        elastic = scene.joints[self.joint].elastic
        return elastic is not None and elastic.are_all(self.turning)

    def multiplied(self, name: str, kinematics: RigidKinematics) -> ForceOutput:
        mechanism = kinematics.mechanism
        coupling = next((one for one in mechanism.couplings if one.name == self.joint), None)
        if coupling is not None:
            return OfCoupling.of(name, self, coupling, kinematics)
        return OfConnection.of(name, self, mechanism.connection(self.joint), mechanism)


class JointForce(InJoint):
    """Force in a joint (N)."""

    type: Literal["joint_force"]
    unit, turning = "N", False


class JointTorque(InJoint):
    """Moment in a joint (N m), about the directions in which it holds."""

    type: Literal["joint_torque"]
    unit, turning = "N m", True


class OfDrive(OutputEntry):
    """Force, torque or power of a prescribed motion."""

    reads = ("multipliers",)
    one_of = ("joint", "coordinate")
    joint: str | None = Field(None, description="name of the joint whose motion is prescribed")
    coordinate: str | None = Field(None, description="in place of a joint: name of the coordinate")
    with_rate: ClassVar[bool] = False

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        """Yield a line if nothing prescribes such a motion, or several do."""
        entry, driven = f"outputs.{name}", scene.driven
        if not scene.coordinates.keys() >= {*driven}:
            return  # a motion is refused that names no coordinate
        if self.coordinate is not None:
            if self.coordinate not in scene.coordinates:
                yield unknown(f"{entry}.coordinate", "coordinate", self.coordinate, scene.coordinates)
            elif self.coordinate not in driven:
                yield problem(f"{entry}.coordinate", _not_driven(driven), self.coordinate)
        elif self.joint not in scene.joints:
            yield unknown(f"{entry}.joint", "joint", self.joint, scene.joints)
        else:
            own = [one for one in driven if scene.coordinates[one].joint == self.joint]
            if len(own) > 1:
                yield problem(f"{entry}.joint", f"two of its motions are prescribed, {', '.join(own)}: name the "
                              "coordinate in place of the joint", self.joint)  # fmt: skip
            elif not own:
                yield problem(f"{entry}.joint", _not_driven(driven), self.joint)

    def of_coordinate(self, scene: Scene) -> str:
        """Return the name of the coordinate that is prescribed."""
        if self.coordinate is not None:
            return self.coordinate
        return next(one for one in scene.driven if scene.coordinates[one].joint == self.joint)

    def multiplied(self, name: str, kinematics: RigidKinematics) -> ForceOutput:
        mechanism = kinematics.mechanism
        every, wanted = mechanism.coordinates, self.of_coordinate(mechanism.scene)
        row = mechanism.n_held + [one.name for one in every if one.prescribed].index(wanted)
        number = [one.name for one in every].index(wanted)
        reading = Reading.of_coordinate(every[number], kinematics) if self.with_rate else None
        nodes = reading.nodes if reading else frozenset()
        return OfPrescribed(name, np.array([row]), nodes, self.with_rate, self, reading, number)


class DriveTorque(OfDrive):
    """Torque (N m), or force (N) of what slides, that a prescribed motion takes."""

    type: Literal["drive_torque"]
    unit = "N m"

    def unit_in(self, scene: Scene) -> str:
        return "N" if slides(scene, scene.coordinates[self.of_coordinate(scene)]) else "N m"


class Power(OfDrive):
    """Power of a prescribed motion (W): its torque or force times the speed of the coordinate."""

    type: Literal["power"]
    unit, with_rate = "W", True


class ControlForce(OutputEntry):
    """Torque (N m), or force (N) on what slides, of a controller."""

    # of a sampled one, where the force jumps, what is held from there on
    type: Literal["control_force"]
    reads, unit = ("beside",), "N m"
    controller: str = Field(description="name of the controller")

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        if self.controller not in scene.controllers:
            yield unknown(f"outputs.{name}.controller", "controller", self.controller, scene.controllers)

    def unit_in(self, scene: Scene) -> str:
        found = scene.controllers.get(self.controller)
        return "N" if found is not None and slides(scene, found) else "N m"


def _not_driven(driven: Sequence[str]) -> str:
    if driven:
        return f"no prescribed motion moves it; one moves {', '.join(driven)}"
    return "no prescribed motion moves it; the scene has none, and what an effect takes is known already"
