"""Meshes of plane and solid bodies: cells of one kind, with named groups of faces and named regions of cells."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pgmp_petsc.runtime.errors import InputError, nearest_name


@dataclass(frozen=True, eq=False)
class SolidMesh:
    """Continuum cells of one kind, in the plane or in space.

    Parameters
    ----------
    kind : str
        meshio's name of the cell type, one of ``PLANE_KINDS`` or ``SOLID_KINDS`` of the reference elements.
    nodes : ndarray of float, shape (n_nodes, d)
        Coordinates in the mesh's own frame (m), d = 2 or 3.
    cells : ndarray of int, shape (n_cells, n_cell_nodes)
        The nodes of each cell in meshio's order.
    groups : dict of str to ndarray of int, shape (n_faces, n_face_nodes)
        The faces of each named group (edges in the plane); the nodes of a face are in the order of the reference
        element's faces.
    regions : dict of str to ndarray of int, shape (n,)
        The cells of each named region, increasing.
    small_groups : dict of str to int
        Names that hold no face and no cell of the mesh, with the number of nodes they hold; kept to explain the
        refusal.
    """

    kind: str
    nodes: np.ndarray
    cells: np.ndarray
    groups: dict[str, np.ndarray] = field(default_factory=dict)
    regions: dict[str, np.ndarray] = field(default_factory=dict)
    small_groups: dict[str, int] = field(default_factory=dict)

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return len(self.cells)

    @property
    def dimension(self) -> int:
        """Dimension of the cells and of the space, 2 or 3."""
        return self.nodes.shape[1]

    def faces(self, name: str, entry: str) -> np.ndarray:
        """Return the faces of the group `name`, shape (n_faces, n_face_nodes).

        Parameters
        ----------
        name : str
            A named group of faces.
        entry : str
            Dotted name of the scene's entry that asks, for the message.

        Raises
        ------
        InputError
            If the name is unknown or holds no face.
        """
        if name in self.groups:
            return self.groups[name]
        if name in self.regions:
            raise InputError(
                f'{entry} = "{name}": this is a region of {len(self.regions[name])} cells; a group of faces is needed'
                f"{_known(self.groups)}"
            )
        raise self._without(name, entry, "group of faces", self.groups)

    def region(self, name: str, entry: str) -> np.ndarray:
        """Return the cells of the region `name`, increasing, shape (n,).

        Parameters
        ----------
        name : str
            A named region of cells.
        entry : str
            Dotted name of the scene's entry that asks, for the message.

        Raises
        ------
        InputError
            If the name is unknown or holds no cell.
        """
        if name in self.regions:
            return self.regions[name]
        if name in self.groups:
            raise InputError(
                f'{entry} = "{name}": this is a group of {len(self.groups[name])} faces; a region of cells is needed'
                f"{_known(self.regions)}"
            )
        raise self._without(name, entry, "region of cells", self.regions)

    def _without(self, name: str, entry: str, needed: str, known: dict[str, np.ndarray]) -> InputError:
        """Return the error for a name that holds neither faces nor cells."""
        if name not in self.small_groups:
            return InputError(f'{entry} = "{name}": the mesh has no {needed} of this name{nearest_name(name, known)}')
        count = self.small_groups[name]
        held = f"holds {count} nodes but no whole face on the surface of the mesh" if count else "holds nothing"
        return InputError(f'{entry} = "{name}": this name {held}; a {needed} is needed{_known(known)}')


def _known(names: dict[str, np.ndarray]) -> str:
    return f"; known: {', '.join(sorted(names))}" if names else "; none is defined"
