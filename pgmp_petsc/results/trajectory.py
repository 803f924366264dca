"""Bodies as they can be seen at the instants of a trajectory's frames: displacements and stresses over all of them.

Of every body whose mesh the model knows. Where a node has several values, of materials or of beams that meet there, it
has what an output with `at` reports there. Where the rigid mechanism does not exist, deformation is not a number.

One run over time: outputs, states and frames of the mechanism's shape.

A run that stopped before its end has a `status` other than 0, the number of the reason (`stepping.status`); the file
then holds the run up to there, and a remark says why.

The nodes of all bodies are numbered one body after the other, and every frame has its own arrays of three components:
XDMF can then refer to them as they are (:mod:`pgmp_petsc.results.xdmf`). In memory, :class:`Frames` keeps them body by
body.

Eigenfrequencies over the configurations, of the full-order model and of the reduced one beside it.

Frequencies rise along the last axis. Rigid motion is left out, but for what linear springs resist anywhere: that
vibrates, and is 0 at dead centres. Frequencies f below zero are motions that grow as ``exp(2 pi |f| t)``. With more
than one coordinate the configurations are a grid over all of them, the last running fastest.

One mode of vibration of a mechanism at a configuration, as it can be seen.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Self

import h5py
import numpy as np

from pgmp_petsc.declare.records import (
    JSON,
    Record,
    Result,
    array,
    attribute,
    check_shape,
    columns_of,
    derived,
    run_record,
    units_of,
)
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.results.estimates import VALIDITY_WORDS, Balance, EstimatedErrors
from pgmp_petsc.results.statistics import MODELS

GROUP = "fields"
PLACES = ("at_nodes", "at_cells")
ANSWERS = {"static_modes": "loads", "inertia_modes": "inertia forces"}
_LENGTHS = ("positions", "nodes")  # of frames
_VECTOR = ("frame", "node", "dimension")


def _quantities(size: str, words: str) -> dict[str, np.ndarray]:
    return array(
        "frame", size, unit="{unit}", about=f"{{quantity}} {words}", each="frame", gaps=True, absent={},
        words=lambda own, name, _: {"quantity": name.replace("_", " ")},
    )  # fmt: skip


@dataclass(frozen=True)
class BodyField(Record):
    """One body over the frames."""

    kind: str = attribute("cells@kind", about="meshio's name of the cells; line of beams")
    nodes: np.ndarray = array("node", "dimension", unit="m", about="undeformed nodes in the frame of the body")
    cells: np.ndarray = array("cell", "corner", about="nodes of the cells", stored=np.int32)
    positions: np.ndarray = array(
        *_VECTOR, at="points", unit="m", about="positions of the nodes, ground frame", each="frame", padded=3, gaps=True
    )
    deformation: np.ndarray = array(
        *_VECTOR, unit="m", about="positions minus those of the rigid mechanism, ground frame", each="frame", padded=3,
        gaps=True,
    )  # fmt: skip
    at_nodes: dict[str, np.ndarray] = _quantities("node", "at the nodes")
    at_cells: dict[str, np.ndarray] = _quantities("cell", "in the middles of the cells")
    units: dict[str, str] = units_of("at_nodes", default={})
    rigid: bool = attribute("cells@rigid", default=False)
    radius: float | None = attribute(
        "cells@radius", absent=None, unit="m", about="of beams: of the circle with the section's radius of gyration"
    )
    FURTHER = (
        derived(
            np.ndarray, lambda own, _: own.displacement, "displacement", *_VECTOR, unit="m", each="frame", padded=3,
            gaps=True, about="positions minus those of frame 00000",
        ),
    )  # fmt: skip

    def __post_init__(self) -> None:
        if not self.units.keys() == self.at_nodes.keys() == self.at_cells.keys():
            raise ValueError("quantities at nodes, in cells and units of a body are not the same")
        super().__post_init__()

    @property
    def displacement(self) -> np.ndarray:
        """Positions minus those of the first frame, shape (n_f, n_nodes, d), m."""
        return self.positions - self.positions[:1]


def truncated(scene_toml: str) -> str:
    """Return what the stresses of a reduced model of a scene lack, empty where that is nothing."""
    reduction = tomllib.loads(scene_toml).get("reduction", {})
    lacking = [name for name in ANSWERS if not reduction.get(name, False)]
    if not lacking:
        return ""
    return (
        f"stresses of the modes alone, without the static answers to {' and '.join(ANSWERS[name] for name in lacking)} "
        f"(reduction.{', reduction.'.join(lacking)}): they may be far off"
    )


def _frame(at: str, about: str, *sizes: str | int, unit: str = "m") -> Any:
    return array("frame", "node", *sizes, at=f"frames/{at}", unit=unit, about=about, each="frame", gaps=True)


@dataclass(frozen=True)
class FrameTable(Record):
    """Shapes of the mechanism at some instants, with the nodes of all bodies in one numbering."""

    time: np.ndarray = array("frame", at="frames/time", unit="s", about="instants of the frames")
    points: np.ndarray = _frame("points", "positions at {instant} s, ground frame", 3)
    rotation: np.ndarray = _frame("rotation", "rotation of the nodes at {instant} s", "axis?", unit="rad")
    nodes: np.ndarray = array(
        "node", "dimension", at="mesh/nodes", unit="m", about="undeformed nodes in the frame of their body"
    )
    cells: np.ndarray = array("line", 2, at="mesh/cells", about="node numbers of the line cells", stored=np.int32)
    body: np.ndarray = array("node", at="mesh/body", about="body of each node", stored=np.int32)
    bodies: list[str] = attribute("mesh/body@names", code=JSON, about="names of the bodies, in that order (JSON)")
    rigid: list[str] = attribute(
        "mesh/body@rigid", code=JSON, absent=None, about="names of those that do not deform (JSON)"
    )
    FURTHER = (
        derived(
            np.ndarray, lambda own, _: own.points - own.points[:1], "frames/displacement", "frame", "node", 3, unit="m",
            about="positions at {instant} s minus those of frame 00000", each="frame", gaps=True,
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class Frames(Record):
    """Shapes of the mechanism at some instants, body by body."""

    time: np.ndarray  # instants, s
    positions: dict[str, np.ndarray]  # deformed positions of each body's nodes in the ground frame, m
    rotations: dict[str, np.ndarray]  # rotation of each body's nodes, rad; in space axis times angle
    #: undeformed nodes in the body's frame, m; of rigid bodies those of the mesh that gives their shape
    nodes: dict[str, np.ndarray]
    cells: dict[str, np.ndarray]  # line cells, numbered within the body
    rigid: frozenset[str] = frozenset()  # the bodies that do not deform
    STORED = FrameTable

    def converted(self, convert: Callable[[Any, str], Any], outer: Any = None) -> Self:
        """Return the frames in other units."""
        found = {key: {name: convert(part, "m") for name, part in getattr(self, key).items()} for key in _LENGTHS}
        return replace(self, **found)

    @property
    def extent(self) -> float:
        """Largest extent of a body along an axis of its frame, m."""
        return max(float(np.ptp(nodes, axis=0).max()) for nodes in self.nodes.values())

    def __post_init__(self) -> None:
        if not (self.positions.keys() == self.rotations.keys() == self.nodes.keys() == self.cells.keys()):
            raise ValueError("positions, rotations, nodes and cells of frames name different bodies")
        if not self.rigid <= self.nodes.keys():
            unknown = ", ".join(sorted(self.rigid - self.nodes.keys()))
            raise ValueError(f"rigid bodies of frames are none of theirs: {unknown}")
        for body, nodes in self.nodes.items():
            d = 3 if nodes.shape[-1] == 3 else 2
            known = {"frame": len(self.time)}
            check_shape(f"nodes of '{body}'", nodes.shape, ("node", d), known)
            check_shape(f"cells of '{body}'", self.cells[body].shape, ("line", 2), known)
            check_shape(f"positions of '{body}'", self.positions[body].shape, ("frame", "node", d), known)
            axes = () if d == 2 else (3,)
            check_shape(f"rotations of '{body}'", self.rotations[body].shape, ("frame", "node", *axes), known)

    def stored(self) -> FrameTable:
        """Return the frames with the nodes of all bodies in one numbering."""
        counts = [len(nodes) for nodes in self.nodes.values()]
        offsets = np.cumsum([0, *counts[:-1]])
        points = np.concatenate([self.positions[body] for body in self.nodes], axis=1)
        return FrameTable(
            self.time,
            np.pad(points, ((0, 0), (0, 0), (0, 3 - points.shape[-1]))),
            np.concatenate([self.rotations[body] for body in self.nodes], axis=1),
            np.concatenate(list(self.nodes.values())),
            np.concatenate([self.cells[body] + offset for body, offset in zip(self.nodes, offsets)]),
            np.repeat(np.arange(len(counts)), counts),
            list(self.nodes),
            sorted(self.rigid),
        )

    @classmethod
    def take(cls, group: h5py.Group, words: Any = None) -> Self:
        """Read the frames and take the bodies apart again."""
        table = FrameTable.take(group, words)
        points, d = table.points, table.nodes.shape[1]
        of_body = {body: np.flatnonzero(table.body == number) for number, body in enumerate(table.bodies)}
        of_cell = table.body[table.cells[:, 0]]
        return cls(
            time=table.time,
            positions={body: points[:, chosen, :d] for body, chosen in of_body.items()},
            rotations={body: table.rotation[:, chosen] for body, chosen in of_body.items()},
            nodes={body: table.nodes[chosen] for body, chosen in of_body.items()},
            cells={body: table.cells[of_cell == number] - of_body[body][0] for number, body in enumerate(table.bodies)},
            rigid=frozenset(table.rigid or ()),
        )


@dataclass(frozen=True)
class Trajectory(Result):
    """One run of the full-order or the reduced model; `fields` are of the bodies whose meshes the model knows."""

    kind = "trajectory"
    model: str = attribute("@model", allowed=MODELS, about="full, components or reduced")
    record: RunRecord = run_record()
    time: np.ndarray = array("time", unit="s", about="time", label="time", is_axis=True)
    outputs: dict[str, np.ndarray] = array(
        "time", unit="{unit}", about="output '{name}' over time", ordered=True, gaps=True, label="{name}"
    )
    units: dict[str, str] = units_of("outputs")
    coordinates: np.ndarray = array(
        "time", "coordinate", at="state/coordinates", columns="coordinate_units", about="rigid coordinates theta",
        gaps=True, label="state.{column}",
    )  # fmt: skip
    coordinate_units: dict[str, str] = columns_of("state/coordinates", "coordinate")
    modal: np.ndarray | None = array(
        "time", "mode", at="state/modal", about="flexible coordinates delta", gaps=True, absent=None,
        label="state.modal",
    )  # fmt: skip
    frames: Frames | None = array(at="", absent=None)
    errors: EstimatedErrors | None = array(ordered=True, absent=None)
    balance: Balance | None = array(at="", absent=None)
    fields: dict[str, BodyField] = array(absent={})
    validity: dict[str, float] = array(
        unit="{unit}", about="{about}", gaps=True, absent={}, label="validity.{name}",
        keys=VALIDITY_WORDS,
    )  # fmt: skip
    status: int = attribute("@status", absent=0, about="0 where the run reached its end, else the number of the reason")
    steps_divided: int = attribute("@steps_divided", absent=1, about="by what simulation.step was divided")

    @property
    def why_stopped(self) -> str:
        """Why the run stopped before its end, empty where it did not: the first of its remarks."""
        return self.record.remarks[0].text if self.status else ""


ABOUT = "flexible eigenfrequencies, rising; rigid motion left out"


@dataclass(frozen=True)
class ModesTable(Result):
    """Eigenfrequencies over the configurations; the reduced model may have another number of them."""

    kind = "modes"
    record: RunRecord = run_record()
    theta: np.ndarray = array(
        "coordinate?", "configuration", columns="coordinate_units", about="configurations",
        label="theta.{column}", is_axis=True,
    )  # fmt: skip
    full_hz: np.ndarray = array(
        "configuration", "full_mode", at="full/frequencies_hz", unit="Hz", about=f"full-order {ABOUT}", gaps=True,
        label="frequency.full",
    )  # fmt: skip
    reduced_hz: np.ndarray | None = array(
        "configuration", "reduced_mode", at="reduced/frequencies_hz", unit="Hz", about=f"reduced {ABOUT}", gaps=True,
        absent=None, label="frequency.reduced",
    )  # fmt: skip
    coordinate_units: dict[str, str] = columns_of("theta", "coordinate")


@dataclass(frozen=True)
class ModeShape:
    """A mode."""

    record: RunRecord  # of the reduced model that it is of
    number: int  # from 1, rigid motion left out
    frequency_hz: float
    configuration: str  # in words: ``theta = 0 rad``
    #: one frame: ``positions`` are those of the undeformed body, ``deformation`` is the displacement of the mode, 1 m
    #: at its largest, and quantities are those of that displacement
    fields: dict[str, BodyField]
    notes: tuple[str, ...] = ()  # what is left out
