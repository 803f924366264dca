"""One run over time: outputs, states and frames of the mechanism's shape.

Layout of the file (kind ``trajectory``; root attributes ``model``: ``full`` or ``reduced``, and ``status``: 0 where the
run reached its end, else the number of the reason (`dynamics.status`) for which it stopped. The file then holds the run
up to there, and a remark says why; ``steps_divided``: by what the scene's step was divided, as a run that fails is
integrated again with smaller steps):

============================= ==================== ========================================================
dataset                       shape                content
============================= ==================== ========================================================
``/time``                     (n_t)                s
``/outputs/<name>``           (n_t)                the scene's outputs
``/state/coordinates``        (n_t, n_theta)       rigid coordinates; attribute ``names`` (JSON)
``/state/modal``              (n_t, n_delta)       flexible coordinates delta of (4); reduced model only
``/frames/time``              (n_f)                s; this and all below only where frames were stored
``/frames/points/<k>``        (n_nodes, 3)         positions at frame k = 00000, 00001, ..., ground frame, m
``/frames/displacement/<k>``  (n_nodes, 3)         positions minus those of frame 00000, m
``/frames/rotation/<k>``      (n_nodes)            rotation of the nodes, rad; in space (n_nodes, 3), axis times angle
``/mesh/nodes``               (n_nodes, d)         undeformed nodes in their body's frame, m; of rigid bodies those of
                                                   the mesh that gives their shape
``/mesh/cells``               (n_cells, 2)         node numbers of the line cells
``/mesh/body``                (n_nodes)            body number; attributes ``names`` (JSON, in that order) and
                                                   ``rigid`` (JSON, the names of those that do not deform)
``/fields/<body>``            see `body_fields`    displacements and stresses over whole bodies at the instants of the
                                                   frames
``/energy``, ``/work``        see `balance`        energies, work of each effect, and what is left of their balance
``/errors``                   see `errors`         estimated errors; of a reduced model where they can be
                                                   estimated, else a remark says why not
``/validity/<name>``          ()                   how far the run left small deformations (`errors.VALIDITY`), NaN
                                                   where not known; reduced model only
============================= ==================== ========================================================

The nodes of all bodies are numbered one body after the other, and every frame has its own arrays of three
components: XDMF can then refer to them as they stand (:mod:`pgmp_petsc.export.xdmf`). In memory,
:class:`Frames` keeps them body by body.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field

import h5py
import numpy as np

from pgmp_petsc.results.balance import Balance
from pgmp_petsc.results.body_fields import BodyField, read_fields, write_fields
from pgmp_petsc.results.errors import VALIDITY, EstimatedErrors
from pgmp_petsc.results.layout import check_model, check_shape, frame_name, put_named, take_named, units_of
from pgmp_petsc.runtime.files import RunRecord, open_file, put, shapes_of, take, write_file


@dataclass(frozen=True)
class Frames:
    """Shapes of the mechanism at some instants, body by body.

    Parameters
    ----------
    time : ndarray, shape (n_f,)
        Instants, s.
    positions : dict of str to ndarray, shape (n_f, n_nodes, 2)
        Deformed positions of each body's nodes in the ground frame, m.
    rotations : dict of str to ndarray, shape (n_f, n_nodes)
        Rotation of each body's nodes, rad.
    nodes : dict of str to ndarray, shape (n_nodes, 2)
        Undeformed nodes in the body's frame, m.
    cells : dict of str to ndarray of int, shape (n_cells, 2)
        Line cells, numbered within the body.
    rigid : frozenset of str
        The bodies that do not deform.
    """

    time: np.ndarray
    positions: dict[str, np.ndarray]
    rotations: dict[str, np.ndarray]
    nodes: dict[str, np.ndarray]
    cells: dict[str, np.ndarray]
    rigid: frozenset[str] = frozenset()

    @property
    def extent(self) -> float:
        """Largest extent of a body along an axis of its frame, m."""
        return max(float(np.ptp(nodes, axis=0).max()) for nodes in self.nodes.values())

    def __post_init__(self) -> None:
        n_frames = len(self.time)
        if not (self.positions.keys() == self.rotations.keys() == self.nodes.keys() == self.cells.keys()):
            raise ValueError("positions, rotations, nodes and cells of frames name different bodies")
        if not self.rigid <= self.nodes.keys():
            unknown = ", ".join(sorted(self.rigid - self.nodes.keys()))
            raise ValueError(f"rigid bodies of frames are none of theirs: {unknown}")
        for body, nodes in self.nodes.items():
            d = 3 if nodes.shape[-1] == 3 else 2
            check_shape(f"nodes of '{body}'", nodes, (None, d))
            check_shape(f"cells of '{body}'", self.cells[body], (None, 2))
            check_shape(f"positions of '{body}'", self.positions[body], (n_frames, len(nodes), d))
            angles = (n_frames, len(nodes)) if d == 2 else (n_frames, len(nodes), 3)
            check_shape(f"rotations of '{body}'", self.rotations[body], angles)


@dataclass(frozen=True)
class Trajectory:
    """One run of the full-order or the reduced model.

    Parameters
    ----------
    model : {"full", "components", "reduced"}
    record : RunRecord
    time : ndarray, shape (n_t,)
        s.
    outputs : dict of str to ndarray, shape (n_t,)
    units : dict of str to str
        Unit of each output.
    coordinates : ndarray, shape (n_t, n_theta)
        Rigid coordinates theta.
    coordinate_units : dict of str to str
        Name and unit of each rigid coordinate, in the order of the columns.
    modal : ndarray, shape (n_t, n_delta), optional
        Flexible coordinates delta of (4), of the reduced model.
    frames : Frames, optional
    errors : EstimatedErrors, optional
        Of the reduced model.
    validity : dict of str to float
        By the names of `VALIDITY`; of the reduced model.
    status : int
        0 where the run reached its end; see the module.
    steps_divided : int
        By what the scene's step was divided.
    balance : Balance, optional
        Balance of energy.
    fields : dict of str to BodyField
        By body, at the instants of the frames; of the bodies whose meshes the model knows.
    """

    model: str
    record: RunRecord
    time: np.ndarray
    outputs: dict[str, np.ndarray]
    units: dict[str, str]
    coordinates: np.ndarray
    coordinate_units: dict[str, str] = field(default_factory=lambda: {"theta": "rad"})
    modal: np.ndarray | None = None
    frames: Frames | None = None
    errors: EstimatedErrors | None = None
    balance: Balance | None = None
    fields: dict[str, BodyField] = field(default_factory=dict)
    validity: dict[str, float] = field(default_factory=dict)
    status: int = 0
    steps_divided: int = 1

    def __post_init__(self) -> None:
        n_times = len(self.time)
        check_model(self.model)
        check_shape("time", self.time, (None,))
        for name, values in self.outputs.items():
            check_shape(f"output '{name}'", values, (n_times,))
        check_shape("coordinates", self.coordinates, (n_times, len(self.coordinate_units)))
        if self.modal is not None:
            check_shape("modal", self.modal, (n_times, None))

    @property
    def why_stopped(self) -> str:
        """Why the run stopped before its end, empty where it did not: the first of its remarks."""
        return self.record.remarks[0].text if self.status else ""

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file; by one process only. Raises as :func:`~pgmp_petsc.runtime.files.write_file`."""
        with write_file(path, "trajectory", self._attributes()) as file:
            self.record.write(file)
            put(file, "time", self.time, "s", "time")
            put_named(file, "outputs", self.outputs, self.units, "output '{name}' over time")
            unit = ", ".join(self.coordinate_units.values())
            data = put(file, "state/coordinates", self.coordinates, unit, "rigid coordinates theta")
            data.attrs["names"] = json.dumps(list(self.coordinate_units))
            if self.modal is not None:
                put(file, "state/modal", self.modal, "1", "flexible coordinates delta")
            if self.frames is not None:
                _write_frames(file, self.frames)
            if self.errors is not None:
                self.errors.write(file, self.units)
            for name, value in self.validity.items():
                put(file, f"validity/{name}", float(value), *VALIDITY[name])
            if self.balance is not None:
                self.balance.write(file)
            write_fields(file, self.fields)

    def _attributes(self) -> dict[str, str | int]:
        return {"model": self.model, "status": self.status, "steps_divided": self.steps_divided}

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Read a file; raises `InputError` where it is not a whole trajectory."""
        with open_file(path, "trajectory") as file, shapes_of(file):
            coordinates = take(file, "state/coordinates", 2)
            attributes = file["state/coordinates"].attrs
            return cls(
                model=str(file.attrs["model"]),
                record=RunRecord.read(file),
                time=take(file, "time", 1),
                outputs=take_named(file, "outputs", 1),
                units=units_of(file, "outputs"),
                coordinates=coordinates,
                coordinate_units=dict(zip(json.loads(attributes["names"]), attributes["unit"].split(", "))),
                modal=take(file, "state/modal", 2) if "state/modal" in file else None,
                frames=_read_frames(file) if "frames" in file else None,
                errors=EstimatedErrors.read(file),
                balance=Balance.read(file),
                fields=read_fields(file),
                validity={name: float(take(file["validity"], name, 0)) for name in file.get("validity", {})},
                status=int(file.attrs.get("status", 0)),
                steps_divided=int(file.attrs.get("steps_divided", 1)),
            )


def _write_frames(file: h5py.File, frames: Frames) -> None:
    """Write the frames with the nodes of all bodies in one numbering."""
    bodies = list(frames.nodes)
    counts = [len(frames.nodes[body]) for body in bodies]
    offsets = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(int)
    mesh = file.create_group("mesh")
    nodes = np.concatenate([frames.nodes[body] for body in bodies])
    put(mesh, "nodes", nodes, "m", "undeformed nodes in the frame of their body")
    cells = np.concatenate([frames.cells[body] + offset for body, offset in zip(bodies, offsets)])
    put(mesh, "cells", cells.astype(np.int32), "1", "node numbers of the line cells")
    number = np.repeat(np.arange(len(bodies), dtype=np.int32), counts)
    body = put(mesh, "body", number, "1", "body of each node")
    body.attrs["names"] = json.dumps(bodies)
    body.attrs["rigid"] = json.dumps(sorted(frames.rigid))

    group = file.create_group("frames")
    put(group, "time", frames.time, "s", "instants of the frames")
    first = None
    for number, instant in enumerate(frames.time):
        points = np.zeros((len(nodes), 3))
        points[:, : nodes.shape[1]] = np.concatenate([frames.positions[body][number] for body in bodies])
        first = points if first is None else first
        rotation = np.concatenate([frames.rotations[body][number] for body in bodies])
        name, at = frame_name(number), f"at {instant:g} s"
        put(group, f"points/{name}", points, "m", f"positions {at}, ground frame")
        put(group, f"displacement/{name}", points - first, "m", f"positions {at} minus those of frame 00000")
        put(group, f"rotation/{name}", rotation, "rad", f"rotation of the nodes {at}")


def _read_frames(file: h5py.File) -> Frames:
    """Read the frames and take the bodies apart again."""
    time, number_of_body = take(file, "frames/time", 1), take(file, "mesh/body", 1)
    nodes, cells = take(file, "mesh/nodes", 2), take(file, "mesh/cells", 2)
    names = [frame_name(number) for number in range(len(time))]
    d = nodes.shape[1]
    points = np.array([take(file["frames/points"], name, 2)[:, :d] for name in names])
    rotation = np.array([take(file["frames/rotation"], name, 1 if d == 2 else 2) for name in names])
    bodies = json.loads(file["mesh/body"].attrs["names"])
    of_body = {body: np.flatnonzero(number_of_body == number) for number, body in enumerate(bodies)}
    return Frames(
        time=time,
        positions={body: points[:, chosen] for body, chosen in of_body.items()},
        rotations={body: rotation[:, chosen] for body, chosen in of_body.items()},
        nodes={body: nodes[chosen] for body, chosen in of_body.items()},
        cells={
            body: cells[number_of_body[cells[:, 0]] == number] - of_body[body][0] for number, body in enumerate(bodies)
        },
        rigid=frozenset(json.loads(file["mesh/body"].attrs.get("rigid", "[]"))),
    )
