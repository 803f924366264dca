"""Bodies as they can be seen at the instants of a trajectory's frames: displacements and stresses over all of them.

Layout, of every body whose mesh the model knows (``/fields/<body>``); k = 00000, 00001, ... numbers the frames:

============================= ==================== ========================================================
dataset                       shape                content
============================= ==================== ========================================================
``nodes``                     (n_nodes, d)         undeformed nodes of the body's mesh in its own frame, m
``cells``                     (n_cells, n_a)       nodes of the cells; attributes ``kind``, meshio's name of them,
                                                   ``rigid``, and of beams ``radius``, that of the circle with the
                                                   section's radius of gyration, m
``points/<k>``                (n_nodes, 3)         positions, ground frame, m
``displacement/<k>``          (n_nodes, 3)         positions minus those of frame 00000, m
``deformation/<k>``           (n_nodes, 3)         positions minus those in the rigid mechanism at the same measured
                                                   coordinates, ground frame, m; not a number where that does not exist
``at_nodes/<quantity>/<k>``   (n_nodes)            at the nodes; the quantities are those of stress outputs. Where
                                                   a node has several values, of materials or of beams that meet
                                                   there, it is what an output with `at` reports there
``at_cells/<quantity>/<k>``   (n_cells)            in the middles of the cells
============================= ==================== ========================================================
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field

import h5py
import numpy as np

from pgmp_petsc.results.layout import check_shape, frame_name
from pgmp_petsc.runtime.files import put, take

GROUP = "fields"
PLACES = ("at_nodes", "at_cells")
ANSWERS = {"static_modes": "loads", "inertia_modes": "inertia forces"}


@dataclass(frozen=True)
class BodyField:
    """One body over the frames.

    Parameters
    ----------
    kind : str
        meshio's name of the cells; ``line`` of beams.
    nodes : ndarray, shape (n_nodes, d)
        Undeformed nodes in the body's frame, m.
    cells : ndarray of int, shape (n_cells, n_a)
    positions : ndarray, shape (n_f, n_nodes, d)
        In the ground frame, m.
    deformation : ndarray, shape (n_f, n_nodes, d)
        Positions minus those in the rigid mechanism at the same measured coordinates, ground frame, m.
    at_nodes, at_cells : dict of str to ndarray, shape (n_f, n_nodes) and (n_f, n_cells)
        Quantities at the nodes and in the middles of the cells.
    units : dict of str to str
        Of every quantity.
    rigid : bool
    radius : float, optional
        Of beams: that of the circle with the section's radius of gyration, m.
    """

    kind: str
    nodes: np.ndarray
    cells: np.ndarray
    positions: np.ndarray
    deformation: np.ndarray
    at_nodes: dict[str, np.ndarray] = field(default_factory=dict)
    at_cells: dict[str, np.ndarray] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    rigid: bool = False
    radius: float | None = None

    def __post_init__(self) -> None:
        n_frames, (n_nodes, d), n_cells = len(self.positions), self.nodes.shape, len(self.cells)
        check_shape("positions of a body", self.positions, (n_frames, n_nodes, d))
        check_shape("deformation of a body", self.deformation, (n_frames, n_nodes, d))
        if not self.units.keys() == self.at_nodes.keys() == self.at_cells.keys():
            raise ValueError("quantities at nodes, in cells and units of a body are not the same")
        for name in self.units:
            check_shape(f"'{name}' at nodes of a body", self.at_nodes[name], (n_frames, n_nodes))
            check_shape(f"'{name}' in cells of a body", self.at_cells[name], (n_frames, n_cells))

    @property
    def displacement(self) -> np.ndarray:
        """Positions minus those of the first frame, shape (n_f, n_nodes, d), m."""
        return self.positions - self.positions[:1]

    def write(self, group: h5py.Group) -> None:
        """Write into the body's group."""
        put(group, "nodes", self.nodes, "m", "undeformed nodes in the frame of the body")
        cells = put(group, "cells", self.cells.astype(np.int32), "1", "nodes of the cells")
        cells.attrs.update(kind=self.kind, rigid=self.rigid)
        if self.radius is not None:
            cells.attrs["radius"] = self.radius
        vectors = {
            "points": (self.positions, "positions of the nodes, ground frame"),
            "displacement": (self.displacement, "positions minus those of frame 00000"),
            "deformation": (self.deformation, "positions minus those of the rigid mechanism, ground frame"),
        }
        for name, (values, about) in vectors.items():
            for number, own in enumerate(values):
                in_space = np.zeros((len(own), 3))
                in_space[:, : own.shape[1]] = own
                put(group, f"{name}/{frame_name(number)}", in_space, "m", about)
        for place, words in zip(PLACES, ("at the nodes", "in the middles of the cells")):
            for name, values in getattr(self, place).items():
                for number, own in enumerate(values):
                    about = f"{name.replace('_', ' ')} {words}"
                    put(group, f"{place}/{name}/{frame_name(number)}", own, self.units[name], about)

    @classmethod
    def read(cls, group: h5py.Group) -> BodyField:
        """Read back what `write` wrote."""
        nodes, frames, about = take(group, "nodes", 2), sorted(group["points"]), group["cells"].attrs

        def over(name: str) -> np.ndarray:
            return np.array([take(group[name], frame, 2)[:, : nodes.shape[1]] for frame in frames])

        def quantities(place: str) -> dict[str, np.ndarray]:
            own = group.get(place, {})
            return {name: np.array([take(own[name], frame, 1) for frame in frames]) for name in own}

        units = {name: str(own[frames[0]].attrs["unit"]) for name, own in group.get(PLACES[0], {}).items()}
        return cls(
            kind=str(about["kind"]),
            nodes=nodes,
            cells=take(group, "cells", 2),
            positions=over("points"),
            deformation=over("deformation"),
            at_nodes=quantities("at_nodes"),
            at_cells=quantities("at_cells"),
            units=units,
            rigid=bool(about["rigid"]),
            radius=float(about["radius"]) if "radius" in about else None,
        )


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


def write_fields(file: h5py.File, fields: dict[str, BodyField]) -> None:
    """Write the fields of all bodies."""
    for body, own in fields.items():
        own.write(file.create_group(f"{GROUP}/{body}"))


def read_fields(file: h5py.File) -> dict[str, BodyField]:
    """Read the fields of all bodies; empty where there are none."""
    return {body: BodyField.read(group) for body, group in file.get(GROUP, {}).items()}
