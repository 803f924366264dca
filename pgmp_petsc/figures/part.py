"""A meshed part with its named faces, or a part of CAD with those of its whole cylinders."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from pgmp_petsc.figures import style
from pgmp_petsc.figures.motion import normals, outer_faces
from pgmp_petsc.mesh.solid_mesh import SolidMesh

STEEL, LIGHT = np.array([0.72, 0.74, 0.77]), np.array([0.35, -0.5, 0.79])
FRAME, LABEL = 0.9, 0.14  # shares of half the extent: what the axes show, and the height of a name
MESH = {"edgecolors": (0.2, 0.2, 0.2, 0.35), "linewidths": 0.25}
MOST_FACES = 16  # that have a name in a picture


def meshed_part(mesh: SolidMesh, body: str, unit: str) -> Figure:
    """Return the picture of a meshed part with its named groups of faces, those of most faces where there are many."""
    named = sorted(mesh.groups, key=lambda name: -len(mesh.groups[name]))
    shown = {name: mesh.nodes[np.unique(mesh.groups[name])].mean(axis=0) for name in sorted(named[:MOST_FACES])}
    more = f", {len(named) - MOST_FACES} more have names" if len(named) > MOST_FACES else ""
    title = f"{body}: {len(mesh.cells)} cells, {'named faces' if named else 'no face has a name'}{more}"
    return (plane_part if mesh.dimension == 2 else part_picture)(mesh, shown, title, unit)


@style.styled
def plane_part(mesh: SolidMesh, places: Mapping[str, np.ndarray], title: str, unit: str) -> Figure:
    """Return the cells of a plane mesh, with named groups of edges coloured and named at their places (2,)."""
    middle, half = 0.5 * (mesh.nodes.max(axis=0) + mesh.nodes.min(axis=0)), 0.5 * np.ptp(mesh.nodes, axis=0)
    half = np.maximum(1.2 * half, LABEL * half.max())
    figure = style.new_figure(8.0, float(np.clip(8.0 * half[1] / half[0], 1.2, 7.0)) + 0.8)
    axes = figure.subplots()
    cells = mesh.nodes[outer_faces(mesh.kind, mesh.cells)]
    axes.add_collection(PolyCollection(cells, facecolors="#E8EAED", edgecolors="#B5BBC2", linewidths=0.5))
    for (name, place), colour in zip(places.items(), style.distinct_colours(len(places))):
        edges = mesh.nodes[mesh.groups[name][:, :2]]
        axes.add_collection(LineCollection(edges, colors=colour, linewidths=3.0, zorder=3))
        axes.annotate(name, place, xytext=(6, 6), textcoords="offset points", color=colour, fontweight="bold", zorder=4)
    axes.set_aspect("equal")
    limits = [(m - h, m + h) for m, h in zip(middle, half)]
    axes.set(xlim=limits[0], ylim=limits[1], xlabel=f"x ({unit})", ylabel=f"y ({unit})")
    axes.yaxis.set_major_locator(MaxNLocator(3))
    axes.set_title(title, loc="left", weight="bold")
    return figure


@style.styled
def part_picture(mesh: SolidMesh, places: Mapping[str, np.ndarray], title: str, unit: str) -> Figure:
    """Return the surface of a mesh, with named groups coloured and named at their places (3,)."""
    figure = style.new_figure(8.0, 6.0)
    axes = figure.add_subplot(projection="3d", computed_zorder=False)
    bare = outer_faces(mesh.kind, mesh.cells)
    owned = {frozenset(face[: bare.shape[1]].tolist()): name for name in places for face in mesh.groups[name]}
    colours = dict(zip(places, style.distinct_colours(len(places))))
    shade = 0.55 + 0.45 * np.clip(normals(bare, mesh.nodes) @ LIGHT, 0.0, 1.0)
    own = [owned.get(frozenset(face.tolist())) for face in bare]
    base = np.array([STEEL if name is None else to_rgb(colours[name]) for name in own])
    axes.add_collection3d(Poly3DCollection(mesh.nodes[bare], facecolors=shade[:, None] * base, **MESH))
    middle, half = 0.5 * (mesh.nodes.max(axis=0) + mesh.nodes.min(axis=0)), 0.5 * np.ptp(mesh.nodes, axis=0)
    across, seen = int(np.argmin(half)), list[np.ndarray]()
    for name, place in places.items():
        text = place.copy()
        beside = sum(float(np.abs(np.delete(place - one, across)).max()) < LABEL * half.max() for one in seen)
        text[across] += (0.3 + LABEL * beside) * half.max()  # one above the other on one axis
        seen.append(place)
        axes.plot(*np.array([place, text]).T, color=colours[name], linewidth=1.0, zorder=5, clip_on=False)
        axes.text(*text, name, color=colours[name], ha="center", va="bottom", zorder=6, fontweight="bold")
    limits = [
        (m - max(FRAME * h, 0.2 * half.max()), m + max(FRAME * h, 0.2 * half.max())) for m, h in zip(middle, half)
    ]
    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    axes.set_title(title, loc="left", weight="bold")
    axes.set_box_aspect([high - low for low, high in limits])
    for name, (low, high) in zip("xyz", limits):
        getattr(axes, f"{name}axis").set_major_locator(MaxNLocator(5 if high - low > half.max() else 2))
        getattr(axes, f"set_{name}label")(f"{name} ({unit})")
    return figure
