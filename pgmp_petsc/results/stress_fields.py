"""Stresses over whole bodies at the instants of a trajectory's frames.

Layout, of every body that a stress output names (``/stress/<body>``):

============================= ==================== ========================================================
dataset                       shape                content
============================= ==================== ========================================================
``nodes``                     (n_nodes, d)         undeformed nodes of the body's mesh in its own frame, m
``cells``                     (n_cells, n_a)       nodes of the cells; attribute ``kind``, meshio's name of them
``points/<k>``                (n_nodes, 3)         positions at frame k = 00000, 00001, ..., ground frame, m
``<quantity>/<k>``            (n_nodes)            at the nodes; the quantities are those of stress outputs. Where
                                                   a node has several values, of materials or of beams that meet
                                                   there, it is what an output with `at` reports there
============================= ==================== ========================================================
"""

from __future__ import annotations

from dataclasses import dataclass

import h5py
import numpy as np

from pgmp_petsc.results.layout import check_shape, frame_name
from pgmp_petsc.runtime.files import put, take

GROUP = "stress"
SHAPE = ("nodes", "cells", "points")  # what in a body's group is no quantity


@dataclass(frozen=True)
class StressField:
    """Stresses over one body.

    Parameters
    ----------
    kind : str
        meshio's name of the cells.
    nodes : ndarray, shape (n_nodes, d)
        Undeformed nodes in the body's frame, m.
    cells : ndarray of int, shape (n_cells, n_a)
    positions : ndarray, shape (n_f, n_nodes, d)
        In the ground frame, m.
    quantities : dict of str to ndarray, shape (n_f, n_nodes)
    units : dict of str to str
        Of every quantity.
    """

    kind: str
    nodes: np.ndarray
    cells: np.ndarray
    positions: np.ndarray
    quantities: dict[str, np.ndarray]
    units: dict[str, str]

    def __post_init__(self) -> None:
        n_frames, n_nodes = len(self.positions), len(self.nodes)
        check_shape("positions of a stress field", self.positions, (n_frames, n_nodes, self.nodes.shape[1]))
        for name, values in self.quantities.items():
            check_shape(f"'{name}' of a stress field", values, (n_frames, n_nodes))

    def write(self, group: h5py.Group) -> None:
        """Write into the body's group."""
        put(group, "nodes", self.nodes, "m", "undeformed nodes in the frame of the body")
        cells = put(group, "cells", self.cells.astype(np.int32), "1", "nodes of the cells")
        cells.attrs["kind"] = self.kind
        for number, places in enumerate(self.positions):
            points = np.zeros((len(places), 3))
            points[:, : places.shape[1]] = places
            put(group, f"points/{frame_name(number)}", points, "m", "positions of the nodes, ground frame")
        for name, values in self.quantities.items():
            for number, own in enumerate(values):
                put(group, f"{name}/{frame_name(number)}", own, self.units[name], f"{name.replace('_', ' ')} at nodes")

    @classmethod
    def read(cls, group: h5py.Group) -> StressField:
        """Read back what `write` wrote."""
        nodes, names = take(group, "nodes", 2), [name for name in group if name not in SHAPE]
        frames = sorted(group["points"])
        return cls(
            str(group["cells"].attrs["kind"]),
            nodes,
            take(group, "cells", 2),
            np.array([take(group["points"], frame, 2)[:, : nodes.shape[1]] for frame in frames]),
            {name: np.array([take(group[name], frame, 1) for frame in frames]) for name in names},
            {name: str(group[name][frames[0]].attrs["unit"]) for name in names},
        )


def write_fields(file: h5py.File, fields: dict[str, StressField]) -> None:
    """Write the fields of all bodies."""
    for body, field in fields.items():
        field.write(file.create_group(f"{GROUP}/{body}"))


def read_fields(file: h5py.File) -> dict[str, StressField]:
    """Read the fields of all bodies; empty where there are none."""
    return {body: StressField.read(group) for body, group in file.get(GROUP, {}).items()}
