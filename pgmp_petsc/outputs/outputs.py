"""Outputs: what a user sees of a motion.

All outputs but stresses are read of the frames of some nodes and of their rates, whichever model moved them
(`readings`). Stresses depend on what else a model knows of a body, and on parameters; each model evaluates them in its
own way (`models.stresses`), and they follow the frames and rates in what it observes. So do forces in joints, which
depend on the model's multipliers (`joint_forces`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.outputs.readings import Frames, Reading, RigidReference
from pgmp_petsc.scene import Scene

if TYPE_CHECKING:
    from pgmp_petsc.outputs.joint_forces import ForceOutput
    from pgmp_petsc.outputs.stress import StressOutput


@dataclass(frozen=True)
class OutputSet:
    """The outputs of a scene."""

    nodes: tuple[int, ...]  # global node numbers whose frames are needed, increasing
    units: dict[str, str]  # unit of every output
    n_frame: int  # numbers of a frame: 3 in the plane, in space 12 and the coordinates
    functions: dict[str, Reading | None]  # what is read of frames; None of a stress or force
    stresses: tuple[StressOutput, ...] = ()  # stress outputs, in the order in which models observe them
    forces: tuple[ForceOutput, ...] = ()  # outputs of multipliers, which follow them in this order
    #: from frames to where the coordinates are within their ranges, shape (n,); None where all outputs are known
    #: everywhere: none is a deformation, or every coordinate is periodic
    reached: Callable[[Frames], np.ndarray] | None = None
    #: the rigid mechanism that deformations are taken from; None where there are none
    rigid: RigidReference | None = None
    n_rates: int = 0  # how many numbers of a frame have rates that outputs read, 0 where none does

    def observed(self, frames: np.ndarray, stresses: np.ndarray, rates: np.ndarray | None = None) -> np.ndarray:
        """Return what `evaluate` takes, shape (n_observed, n), of frames of `nodes` (n_nodes, n_frame, n), stresses
        with forces behind them (n_stresses + n_forces, n) and, where outputs read them, rates of the frames (n_nodes,
        n_rates, n)."""
        parts = [frames, rates] if self.n_rates else [frames]
        return np.concatenate([*(part.reshape(-1, stresses.shape[1]) for part in parts), stresses])

    def evaluate(self, observed: np.ndarray) -> dict[str, np.ndarray]:
        """Return the outputs, each of shape (n,), for what a model observes, shape (n_observed, n)."""
        return self._evaluated(observed, self.rigid and self.rigid.poses)

    def near(self, observed: np.ndarray) -> Callable[[np.ndarray], dict[str, np.ndarray]]:
        """Return `evaluate` for what is observed there and next to it, for central differences; see
        `RigidKinematics.near`."""
        poses = self.rigid and self.rigid.near(self._by_node(observed))
        return lambda beside: self._evaluated(beside, poses)

    def _evaluated(self, observed: np.ndarray, poses: Callable[[Frames], np.ndarray] | None) -> dict[str, np.ndarray]:
        by_node, n_nodes = self._by_node(observed), len(self.nodes)
        rigid = poses and poses(by_node)
        behind = observed[n_nodes * self.n_frame :]
        moving = behind[: n_nodes * self.n_rates].reshape(n_nodes, self.n_rates, observed.shape[1])
        rates = dict(zip(self.nodes, moving))
        names = (*(stress.name for stress in self.stresses), *(force.name for force in self.forces))
        of_stresses = dict(zip(names, behind[n_nodes * self.n_rates :]))
        return {
            name: of_stresses[name] if reading is None else reading.value(by_node, rigid, rates)
            for name, reading in self.functions.items()
        }

    def forces_of(
        self, frames: np.ndarray, rates: np.ndarray | None, multipliers: np.ndarray, values: Mapping[str, Any]
    ) -> np.ndarray:
        """Return the forces (n_forces, n) for frames of `nodes` and their rates, as of `observed`, multipliers of
        joints and prescribed coordinates (n_held + n_driven, n), and parameter values, numbers or of shape (n,)."""
        by_node = dict(zip(self.nodes, frames))
        moving = {} if rates is None else dict(zip(self.nodes, rates))
        return np.array([force.value(by_node, moving, multipliers, values) for force in self.forces])

    def left_range(self, observed: np.ndarray) -> np.ndarray:
        """Return where a coordinate is outside the range that a deformation is known in, shape (n,), for what a model
        observes, shape (n_observed, n)."""
        if self.reached is None:
            return np.zeros(observed.shape[1], dtype=bool)
        return ~self.reached(self._by_node(observed))

    def _by_node(self, observed: np.ndarray) -> Frames:
        n_rows = len(self.nodes) * self.n_frame
        return dict(zip(self.nodes, observed[:n_rows].reshape(len(self.nodes), self.n_frame, observed.shape[1])))

    @classmethod
    def of(cls, scene: Scene, kinematics: RigidKinematics, start: np.ndarray | None = None) -> OutputSet:
        """Prepare the outputs of a scene.

        Raises `InputError` if an output names a point that the mesh does not have, or a stress that is not known there.

        Parameters
        ----------
        start
            Coordinates at the start, shape (n_theta,), rad; by default what the scene says of those that are not
            prescribed.
        """
        if start is None:
            start = np.array([scene.initial_state(c.name).position for c in kinematics.mechanism.coordinates])
        nodes: set[int] = set()
        functions, units, stresses = {}, {}, []
        for name, entry in scene.outputs.items():
            if entry.reads == "stresses":
                stresses.append(_stress(name, scene, kinematics))
                functions[name], units[name] = None, entry.unit_in(scene)
                nodes |= _nodes_of_beams(kinematics.mechanism.bodies[stresses[-1].body])
                continue
            if entry.reads == "multipliers":
                functions[name], units[name] = None, entry.unit_in(scene)
                continue
            reading = replace(entry.reading(f"outputs.{name}", start, kinematics), rate=entry.reads == "rates")
            if reading.rate and reading.of_coordinates:
                raise InputError(f"outputs.{name}: a deformation is read, and has no rate; read that of a position")
            functions[name], units[name] = reading, entry.unit_in(scene)
            nodes |= reading.nodes
        mechanism = kinematics.mechanism
        n_frame = mechanism.space.n_pose + (len(mechanism.coordinates) if mechanism.space is SPATIAL else 0)
        rigid = reached = None
        if any(reading is not None and reading.of_coordinates for reading in functions.values()):
            rigid = RigidReference(kinematics)
            if not all(coordinate.periodic for coordinate in mechanism.coordinates):
                reached = rigid.reached
        system = scene.system
        units = {name: system.unit(unit) for name, unit in units.items()}
        reads_rates = any(reading is not None and reading.rate for reading in functions.values())
        forces = _forces(scene, kinematics, start)
        nodes = nodes.union(*(force.nodes for force in forces))
        n_rates = mechanism.space.n_pose if reads_rates or any(force.reads_rates for force in forces) else 0
        return cls(tuple(sorted(nodes)), units, n_frame, functions, tuple(stresses), forces, reached, rigid, n_rates)


def _stress(name: str, scene: Scene, kinematics: RigidKinematics) -> StressOutput:
    from pgmp_petsc.outputs.stress import StressOutput  # few scenes have them

    bodies = kinematics.mechanism.bodies
    number = next(k for k, body in enumerate(bodies) if body.name == scene.outputs[name].body)
    return StressOutput.of(name, scene, number, bodies[number])


def _forces(scene: Scene, kinematics: RigidKinematics, start: np.ndarray) -> tuple[ForceOutput, ...]:
    if not any(entry.reads == "multipliers" for entry in scene.outputs.values()):
        return ()
    from pgmp_petsc.outputs.joint_forces import force_outputs  # few scenes have them

    return force_outputs(scene, kinematics, start)


def _nodes_of_beams(body: Body) -> set[int]:
    """Return the nodes of a body of beams, whose frames say all of its strains."""
    return set(range(body.nodes.start, body.nodes.stop)) if body.fibred else set()
