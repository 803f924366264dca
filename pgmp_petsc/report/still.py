"""A picture of surfaces with stress in colour: what a page shows where no script runs."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.collections import LineCollection, TriMesh
from matplotlib.colors import to_rgb
from matplotlib.tri import Triangulation

from pgmp_petsc.figures.stage import COLOURS, EDGE, PLAIN, RIGID
from pgmp_petsc.figures.style import QUIET, new_figure
from pgmp_petsc.report.bodies import FilmBody

WIDTH = 1400  # pixels
DARKEST = 0.5  # of a face along the line of sight; the page's script has the same


def still_of(
    bodies: Sequence[FilmBody],
    places: Sequence[np.ndarray],
    shares: Sequence[np.ndarray | None],
    number: int,
    size: tuple[int, int],
) -> str:
    """Return the address of a picture of a frame as PNG, empty where there is no surface.

    Parameters
    ----------
    places
        Of the bodies' nodes in the picture, and towards the eye, shape (n, 3) each.
    shares
        Of the largest stress, shape (n_f, n); None where none is known.
    number
        Of the frame.
    size
        Width and height of the picture in its own unit.
    """
    corners, colours = [], []
    for body, at, share in zip(bodies, places, shares):
        if not len(body.triangles):
            continue
        corners.append(at[body.triangles])
        plain = np.array(to_rgb(RIGID if body.kind == "rigid" else PLAIN))
        own = np.tile(plain, (len(at), 1)) if share is None else matplotlib.colormaps[COLOURS](share[number])[:, :3]
        if share is not None:
            own[~np.isfinite(share[number])] = to_rgb(QUIET)
        colours.append(own[body.triangles])
    if not corners:
        return ""
    triangles, shown = np.concatenate(corners), np.concatenate(colours)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    towards = np.abs(normals[:, 2]) / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    shown = shown * (DARKEST + (1.0 - DARKEST) * towards)[:, None, None]
    order = np.argsort(triangles[..., 2].mean(axis=1), kind="stable")
    x, y = triangles[order].reshape(-1, 3)[:, :2].T
    figure = new_figure(1.0, size[1] / size[0])
    figure.set_layout_engine("none")
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0, size[0]), ylim=(size[1], 0))
    axes.set_axis_off()
    mesh = Triangulation(x, y, np.arange(len(x)).reshape(-1, 3))
    axes.add_collection(TriMesh(mesh, facecolors=np.column_stack([shown[order].reshape(-1, 3), np.ones(len(x))])))
    if not np.ptp(triangles[..., 2]) > 0.0:
        pieces = [at[body.edges][..., :2] for body, at in zip(bodies, places) if len(body.edges)]
        axes.add_collection(LineCollection(np.concatenate(pieces), colors=EDGE, linewidths=72.0 / WIDTH, alpha=0.6))
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=WIDTH, transparent=True, metadata={"Software": None})
    return f"data:image/png;base64,{base64.b64encode(stream.getvalue()).decode('ascii')}"
