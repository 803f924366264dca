"""A trajectory for ParaView: an XDMF file that points into the trajectory's own HDF5 file.

XDMF (version 3, https://www.xdmf.org) keeps the description in XML and the arrays in HDF5. The trajectory's
arrays are stored frame by frame and with three components (:mod:`pgmp_petsc.results.trajectory`), so nothing
is copied: each array is named as ``<file>:<dataset>``, with the file relative to the XDMF file. The XML is
written here because meshio's writer of time series stores its arrays in ``F.h5`` beside ``F.xdmf``, which
would overwrite the trajectory. The two files have to stay together.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import h5py
import numpy as np

from pgmp_petsc.base import __version__
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.declare.records import number_name
from pgmp_petsc.files.claims import check_output, replacing
from pgmp_petsc.files.hdf5 import open_file, shapes_of, take
from pgmp_petsc.results.trajectory import GROUP, PLACES

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
        heavy = _reference(Path(trajectory_path), xdmf_path)
        with shapes_of(file):
            tree, n_frames = _tree(file, heavy)
    ElementTree.indent(tree)
    with replacing(xdmf_path) as partial:
        tree.write(partial, encoding="utf-8", xml_declaration=True)
    return n_frames


def _reference(trajectory_path: Path, xdmf_path: Path) -> str:
    """Return the trajectory's path from the XDMF file, which XML and XDMF can hold."""
    heavy = os.path.relpath(trajectory_path.resolve(), xdmf_path.resolve().parent)
    # readers split references at these, and cut spaces off their ends
    if set(heavy) & set(":|") or not heavy.isprintable() or heavy != heavy.strip():
        why = "a colon, a bar, a space at its ends or a character that cannot be printed"
        raise InputError(f"file '{trajectory_path}': XDMF cannot refer to the path {heavy!r} ({why}); rename it")
    return heavy


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
