"""The shape of the mechanism at several instants, as a fan of positions coloured by time."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure

from pgmp_petsc.figures.style import axis_label, axis_unit, new_figure, scene_name, styled, top_legend
from pgmp_petsc.results import Frames, Trajectory
from pgmp_petsc.runtime.errors import InputError

N_INSTANTS = 14
WIDTH = 8.6


@styled
def mechanism(trajectory: Trajectory, n_instants: int = N_INSTANTS, exaggeration: float = 1.0) -> Figure:
    """Draw the mechanism's shape at instants that divide the run equally.

    Parameters
    ----------
    trajectory : Trajectory
        With frames.
    n_instants : int
        Number of shapes; fewer where there are fewer frames.
    exaggeration : float
        Factor on each body's deformation: its nodes' distances from the undeformed body laid through the
        body's two ends, so that the bodies stay joined. Stated in the picture if it is not 1.

    Raises
    ------
    InputError
        If the trajectory has no frames.
    """
    frames = trajectory.frames
    if frames is None or not len(frames.time):
        raise InputError("the trajectory has no frames to draw; use --override simulation.frames=100")
    shapes = {body: shown_positions(frames, body, exaggeration) for body in frames.nodes}
    factor, unit = axis_unit("m", *shapes.values())
    chosen = np.unique(np.linspace(0, len(frames.time) - 1, n_instants).round().astype(int))

    low, high = _limits(shapes, factor)
    # The width that labels and the colour bar leave sets the height: equal scales then fill the picture.
    height = (WIDTH - 1.6) * (high - low)[1] / (high - low)[0]
    figure = new_figure(WIDTH, float(np.clip(height, 2.0, 8.0)) + 1.2)
    axes = figure.subplots()
    # The palest third of viridis vanishes on white.
    strong = matplotlib.colormaps["viridis_r"](np.linspace(0.12, 1.0, 256))
    colours = LinearSegmentedColormap.from_list("time", strong)
    scale = Normalize(frames.time[0], max(frames.time[-1], frames.time[0] + 1e-12))
    for body, cells in frames.cells.items():
        for node in _ends(cells):
            axes.plot(*(shapes[body][:, node].T * factor), color="#D8D8D8", linewidth=0.8, zorder=1)
    for number in chosen:
        last = number == chosen[-1]
        # Mixed with white instead of transparent: overlapping ends of cells would show as dots.
        colour = np.array(colours(scale(frames.time[number]))[:3])
        colour = colour if last else 1.0 - 0.75 * (1.0 - colour)
        for body, cells in frames.cells.items():
            points = shapes[body][number] * factor
            style = {"linewidths": 3.0 if last else 1.6, "zorder": 4 if last else 2}
            axes.add_collection(LineCollection(points[cells], colors=[colour], capstyle="round", **style))
            ends = points[_ends(cells)]
            axes.plot(*ends.T, "o", color=colour, markersize=5.5 if last else 3.0, zorder=5 if last else 3)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.set_xlabel(axis_label("x", unit))
    axes.set_ylabel(axis_label("y", unit))
    bar = figure.colorbar(ScalarMappable(scale, colours), ax=axes, pad=0.01, aspect=32)
    bar.outline.set_visible(False)
    bar.set_label("time (s)")
    model = "full-order" if trajectory.model == "full" else "reduced"
    enlarged = f", deformation enlarged {exaggeration:g} times" if exaggeration != 1.0 else ""
    name = scene_name(trajectory.record) or "mechanism"
    top_legend(figure, [], f"{name[0].upper()}{name[1:]}: {model} model at {len(chosen)} instants{enlarged}")
    return figure


def shown_positions(frames: Frames, body: str, exaggeration: float) -> np.ndarray:
    """Return a body's positions (n_f, n_nodes, 2), in m, with its deformation enlarged.

    The undeformed body is turned, moved and (by the tiny change of the chord) scaled so that its two ends
    meet the deformed ones; what is then left is the deformation. A body that has not exactly two ends is left
    as it is.
    """
    positions, ends = frames.positions[body], _ends(frames.cells[body])
    if exaggeration == 1.0 or len(ends) != 2:
        return positions
    # In the plane as complex numbers, turning and scaling is one multiplication.
    deformed = positions[..., 0] + 1j * positions[..., 1]
    plain = frames.nodes[body][:, 0] + 1j * frames.nodes[body][:, 1]
    first, second = ends
    turn = (deformed[:, second] - deformed[:, first]) / (plain[second] - plain[first])
    rigid = deformed[:, [first]] + turn[:, None] * (plain - plain[first])[None, :]
    shown = rigid + exaggeration * (deformed - rigid)
    return np.stack([shown.real, shown.imag], axis=-1)


def _ends(cells: np.ndarray) -> np.ndarray:
    """Return the nodes that belong to one line cell only."""
    nodes, counts = np.unique(cells, return_counts=True)
    return nodes[counts == 1]


def _limits(shapes: dict[str, np.ndarray], factor: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper limits of the picture, with a margin."""
    points = np.concatenate([positions.reshape(-1, 2) for positions in shapes.values()]) * factor
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.05 * max(high - low)
    return low - margin, high + margin
