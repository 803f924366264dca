"""A part of CAD with the names of its whole cylinders."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from pgmp_petsc.figures import style
from pgmp_petsc.mesh.solid_mesh import SolidMesh, bounds_one_cell, cell_faces

STEEL, LIGHT = np.array([0.72, 0.74, 0.77]), np.array([0.35, -0.5, 0.79])
FRAME, LABEL = 0.9, 0.14  # shares of half the extent: what the axes show, and the height of a name


@style.styled
def part_picture(mesh: SolidMesh, places: Mapping[str, np.ndarray], title: str, unit: str) -> Figure:
    """Return the surface of a mesh, with named groups coloured and named at their places (3,)."""
    figure = style.new_figure(8.0, 6.0)
    axes = figure.add_subplot(projection="3d", computed_zorder=False)
    faces = cell_faces(mesh.kind, mesh.cells)
    bare = faces[bounds_one_cell(faces)][:, :3]
    owned = {frozenset(face[:3].tolist()): name for name in places for face in mesh.groups[name]}
    colours = dict(zip(places, style.distinct_colours(len(places))))
    corners = mesh.nodes[bare]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    shade = 0.55 + 0.45 * np.clip(normals @ LIGHT, 0.0, 1.0)
    own = [owned.get(frozenset(face.tolist())) for face in bare]
    base = np.array([STEEL if name is None else _rgb(colours[name]) for name in own])
    axes.add_collection3d(Poly3DCollection(corners, facecolors=shade[:, None] * base, edgecolors="none"))
    middle, half = 0.5 * (mesh.nodes.max(axis=0) + mesh.nodes.min(axis=0)), 0.5 * np.ptp(mesh.nodes, axis=0)
    across, seen = int(np.argmin(half)), list[np.ndarray]()
    for name, place in places.items():
        text = place.copy()
        beside = sum(float(np.abs(np.delete(place - one, across)).max()) < LABEL * half.max() for one in seen)
        text[across] += (0.3 + LABEL * beside) * half.max()  # one above the other on one axis
        seen.append(place)
        axes.plot(*np.array([place, text]).T, color=colours[name], linewidth=1.0, zorder=5)
        axes.text(*text, name, color=colours[name], ha="center", va="bottom", zorder=6, fontweight="bold")
    limits = [
        (m - max(FRAME * h, 0.2 * half.max()), m + max(FRAME * h, 0.2 * half.max())) for m, h in zip(middle, half)
    ]
    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    axes.set_title(title, loc="left", weight="bold")
    axes.set_box_aspect([high - low for low, high in limits])
    for name in "xyz":
        getattr(axes, f"set_{name}label")(f"{name} ({unit})")
    return figure


def _rgb(colour: str) -> np.ndarray:
    from matplotlib.colors import to_rgb

    return np.array(to_rgb(colour))
