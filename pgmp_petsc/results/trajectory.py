"""One run over time: outputs, states and frames of the mechanism's shape, in a file and for ParaView.

A run that stopped before its end has a `status` other than 0, the number of the reason (`stepping.status`); the file
then holds the run up to there, and a remark says why.

Fields are of every body whose mesh the model knows. Where a node has several values, of materials or of beams that meet
there, it has what an output with `at` reports there. Where the rigid mechanism does not exist, deformation is not a
number.

In a file every frame has its own arrays of three components, so that XDMF can refer to them as they are.

Eigenfrequencies rise along the last axis. Rigid motion is left out, but for what linear springs resist anywhere: that
vibrates, and is 0 at dead centres. Frequencies f below zero are motions that grow as ``exp(2 pi |f| t)``. With more
than one coordinate the configurations are a grid over all of them, the last running fastest.

For ParaView, an XDMF file (version 3, https://www.xdmf.org) keeps the description in XML and points into the
trajectory's own HDF5 file, so nothing is copied: each array is named as ``<file>:<dataset>``, with the file relative to
the XDMF file. Meshio's writer of time series would overwrite the trajectory. The two files have to stay together.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self
from xml.etree import ElementTree

import h5py
import numpy as np

from pgmp_petsc.base import __version__
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.declare.records import (
    JSON,
    Record,
    Result,
    array,
    attribute,
    check_shape,
    columns_of,
    derived,
    number_name,
    run_record,
    units_of,
)
from pgmp_petsc.files.claims import check_output, replacing
from pgmp_petsc.files.hdf5 import MODELS, RunRecord, open_file, shapes_of, take
from pgmp_petsc.results.estimates import ANSWERS, VALIDITY, Balance, EstimatedErrors

GROUP = "fields"
PLACES = ("at_nodes", "at_cells")
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
    rigid: bool = attribute("cells@rigid", default=False, about="whether the body does not deform")
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


def truncated(scene: Mapping[str, Any]) -> str:
    """Return what the stresses of a reduced model lack, by the tables of its scene; empty where that is nothing."""
    reduction = scene.get("reduction", {})
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
    def take(cls, group: h5py.Group, *how: Any) -> Self:
        """Read the frames and take the bodies apart again."""
        table = FrameTable.take(group, *how)
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


RESTS = "the mechanism rests: "  # a remark of a run begins so


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
        keys=VALIDITY,
    )  # fmt: skip
    status: int = attribute("@status", absent=0, about="0 where the run reached its end, else the number of the reason")
    steps_divided: int = attribute("@steps_divided", absent=1, about="by what simulation.step was divided")

    @property
    def rests(self) -> bool:
        """Whether its mechanism rests, so that all changes are round-off."""
        return any(remark.text.startswith(RESTS) for remark in self.record.remarks)

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
    record: RunRecord  # of the reduced model that it is of
    number: int  # from 1, rigid motion left out
    frequency_hz: float
    configuration: str  # in words: ``theta = 0 rad``
    #: one frame: ``positions`` are those of the undeformed body, ``deformation`` is the displacement of the mode, 1 m
    #: at its largest, and quantities are those of that displacement
    fields: dict[str, BodyField]
    notes: tuple[str, ...] = ()  # what is left out


#: XDMF's topologies by meshio's names of cells, whose order of nodes it shares.
TOPOLOGY = {
    "line": {"TopologyType": "Polyline", "NodesPerElement": "2"},
    "triangle": {"TopologyType": "Triangle"},
    "triangle6": {"TopologyType": "Tri_6"},
    "quad": {"TopologyType": "Quadrilateral"},
    "quad8": {"TopologyType": "Quad_8"},
    "quad9": {"TopologyType": "Quad_9"},
    "tetra": {"TopologyType": "Tetrahedron"},
    "tetra10": {"TopologyType": "Tet_10"},
    "hexahedron": {"TopologyType": "Hexahedron"},
    "hexahedron20": {"TopologyType": "Hex_20"},
    "hexahedron27": {"TopologyType": "Hex_27"},
}


def write_xdmf(trajectory_path: str | os.PathLike[str], xdmf_path: str | os.PathLike[str]) -> int:
    """Write the XDMF description of a trajectory's frames and return their number; by one process only.

    Every frame holds the positions of all nodes at that instant, the line cells, and on the nodes the displacement from
    the first frame (m), the rotation (rad) and the number of the body. A body whose field is stored has a series of its
    own beside this one, with its cells, displacements, and stresses at nodes and in cells. Raises `InputError` if the
    trajectory cannot be read, has no frames, or `xdmf_path` cannot be written or is the trajectory; `RunError` if the
    system fails to write.
    """
    xdmf_path = check_output(xdmf_path, "xdmf", [trajectory_path])
    with open_file(trajectory_path, "trajectory") as file:
        if "frames" not in file:
            cure = "run the simulation again with --override simulation.frames=100"
            raise InputError(f"file '{trajectory_path}' has no frames to export; {cure}")
        heavy = os.path.relpath(Path(trajectory_path).resolve(), xdmf_path.resolve().parent)
        # readers split references at these, and cut spaces off their ends
        if set(heavy) & set(":|") or not heavy.isprintable() or heavy != heavy.strip():
            why = "a colon, a bar, a space at its ends or a character that cannot be printed"
            raise InputError(f"file '{trajectory_path}': XDMF cannot refer to the path {heavy!r} ({why}); rename it")
        with shapes_of(file):
            tree, n_frames = _tree(file, heavy)
    ElementTree.indent(tree)
    with replacing(xdmf_path) as partial:
        tree.write(partial, encoding="utf-8", xml_declaration=True)
    return n_frames


def _tree(file: h5py.File, heavy: str) -> tuple[ElementTree.ElementTree, int]:
    """Build the XML: temporal collections with one uniform grid a frame, of the mechanism and of each body's cells."""
    root = ElementTree.Element("Xdmf", Version="3.0")
    domain = ElementTree.SubElement(root, "Domain")
    # tells `check_output` that the file is ours to replace
    root.append(ElementTree.Comment(f" written by pgmp_petsc {__version__} "))
    time, frames = take(file, "frames/time", 1), file["frames"]
    parts = [(name, "Node", frames[name]) for name in ("displacement", "rotation")]
    parts.append(("body", "Node", file["mesh/body"]))
    _add_series(domain, "mechanism", "frame", time, file["mesh/cells"], frames["points"], parts, heavy)
    for body, group in file.get(GROUP, {}).items():
        parts = [(name, "Node", group[name]) for name in ("displacement", "deformation")]
        for place, centre in zip(PLACES, ("Node", "Cell")):
            parts += [(quantity, centre, values) for quantity, values in group.get(place, {}).items()]
        _add_series(domain, body, body, time, group["cells"], group["points"], parts, heavy)
    return ElementTree.ElementTree(root), len(time)


def _add_series(
    domain: ElementTree.Element,
    name: str,
    of_frame: str,
    time: np.ndarray,
    cells: h5py.Dataset,
    points: h5py.Group,
    parts: Sequence[tuple[str, str, h5py.Dataset | h5py.Group]],
    heavy: str,
) -> None:
    """Add a series with `parts` at nodes or in cells: one for all frames, or one for each."""
    series = ElementTree.SubElement(domain, "Grid", Name=name, GridType="Collection", CollectionType="Temporal")
    topology = {"NumberOfElements": str(len(cells)), **TOPOLOGY[str(cells.attrs.get("kind", "line"))]}
    for number, instant in enumerate(time):
        frame = number_name(number)
        grid = ElementTree.SubElement(series, "Grid", Name=f"{of_frame} {frame}", GridType="Uniform")
        ElementTree.SubElement(grid, "Time", Value=repr(float(instant)))
        _refer(ElementTree.SubElement(grid, "Topology", topology), cells, heavy)
        _refer(ElementTree.SubElement(grid, "Geometry", GeometryType="XYZ"), points[frame], heavy)
        for title, centre, values in parts:
            data = values if isinstance(values, h5py.Dataset) else values[frame]
            what = {"Name": title, "AttributeType": "Scalar" if data.ndim == 1 else "Vector", "Center": centre}
            _refer(ElementTree.SubElement(grid, "Attribute", what), data, heavy)


def _refer(parent: ElementTree.Element, dataset: h5py.Dataset, heavy: str) -> None:
    item = ElementTree.SubElement(
        parent,
        "DataItem",
        Dimensions=" ".join(str(length) for length in dataset.shape),
        NumberType="Int" if np.issubdtype(dataset.dtype, np.integer) else "Float",
        Precision=str(dataset.dtype.itemsize),
        Format="HDF",
    )
    item.text = f"{heavy}:{dataset.name}"
