"""Shapes of a mechanism on axes: beams as lines, rigid bodies as hollow bars, point masses as squares.

A triangle stands below the ends of bodies that the ground holds.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
from matplotlib.lines import Line2D
from matplotlib.patheffects import Stroke

from pgmp_petsc.figures.style import QUIET
from pgmp_petsc.results import Frames

PATH_COLOUR = "#D8D8D8"
# Width of a rigid body's bar over that of a beam, and of the line inside it over the bar's.
BAR, HOLLOW = 1.6, 0.5
KEY_WIDTH = 3.0  # points
# A pin that moves by less than this share of the mechanism's extent is held by the ground.
AT_REST = 1e-6
# A motion that leaves the plane by less than this share of its extent is shown along z, another one obliquely.
FLAT = 1e-3
OBLIQUE = np.array([[1.0, 0.0], [0.0, 1.0], [-0.45, -0.35]])
# A triangle below the pin, as a marker's vertices.
_GROUND = ((0.0, 0.0), (-0.65, -1.0), (0.65, -1.0), (0.0, 0.0))


@dataclass(frozen=True)
class TimeColours:
    """Colours of instants, or of their order, from yellow to dark violet.

    Attributes
    ----------
    scale
        From time (s) to 0 ... 1.
    colours
        From there to a colour.
    """

    scale: Normalize
    colours: Colormap

    @classmethod
    def over(cls, time: np.ndarray) -> TimeColours:
        """Return the colours for the whole of a run."""
        # The palest third of viridis vanishes on white.
        strong = matplotlib.colormaps["viridis_r"](np.linspace(0.12, 1.0, 256))
        scale = Normalize(time[0], max(time[-1], time[0] + 1e-12))
        return cls(scale, LinearSegmentedColormap.from_list("time", strong))

    def at(self, instant: float, strength: float = 1.0) -> np.ndarray:
        """Return the colour of an instant, shape (3,), mixed with white where the strength is below one."""
        # Mixed with white instead of transparent: overlapping ends of cells would show as dots.
        return 1.0 - strength * (1.0 - np.array(self.colours(self.scale(instant))[:3]))


@dataclass(frozen=True)
class Shapes:
    """The shapes of a run as they are shown.

    Attributes
    ----------
    frames
        Where they come from.
    positions
        Of each body's nodes, shape (n_f, n_nodes, 2), in the unit of the picture.
    oblique
        Whether they are seen obliquely, because the motion leaves the plane.
    """

    frames: Frames
    positions: dict[str, np.ndarray]
    oblique: bool = False

    @classmethod
    def of(cls, frames: Frames, exaggeration: float = 1.0, factor: float = 1.0) -> Shapes:
        """Return the shapes with their deformation enlarged, in the unit of which a metre has `factor`."""
        shown = {body: shown_positions(frames, body, exaggeration) for body in frames.nodes}
        view = _view(shown.values())
        projected = {body: factor * positions @ view for body, positions in shown.items()}
        return cls(frames, projected, view is OBLIQUE)

    @property
    def axis_names(self) -> tuple[str, str]:
        """What the axes of the picture show."""
        if not self.oblique:
            return "x", "y"
        x, y = (f"{name} \N{MINUS SIGN} {abs(share):g} z" for name, share in zip("xy", OBLIQUE[2]))
        return x, y

    @property
    def not_enlarged(self) -> list[str]:
        """The deformable bodies whose deformation cannot be enlarged."""
        bodies = (body for body in self.frames.nodes if body not in self.frames.rigid and len(self.frames.cells[body]))
        return [body for body in bodies if not _can_be_enlarged(self.frames, body)]

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper limits of a picture of all frames, with a margin, shape (2,) each."""
        points = np.concatenate([positions.reshape(-1, 2) for positions in self.positions.values()])
        low, high = points.min(axis=0), points.max(axis=0)
        margin = 0.05 * max(high - low)
        return low - margin, high + margin

    def draw_paths(self, axes: Axes, linewidth: float = 0.8) -> None:
        """Draw the paths of the bodies' ends."""
        for body, cells in self.frames.cells.items():
            for node in ends(cells):
                axes.plot(*self.positions[body][:, node].T, color=PATH_COLOUR, linewidth=linewidth, zorder=1)

    def draw_ground(self, axes: Axes, size: float = 24.0) -> None:
        """Draw a triangle below every end of a body that stays where it is."""
        low, high = self.limits
        for body, cells in self.frames.cells.items():
            for node in ends(cells):
                path = self.positions[body][:, node]
                if len(path) > 1 and np.ptp(path, axis=0).max() < AT_REST * max(high - low):
                    axes.plot(*path[0], marker=_GROUND, color=QUIET, markersize=size, zorder=1.5, clip_on=False)

    def draw(self, axes: Axes, number: int, colour: Sequence[float], width: float, pin: float, zorder: float) -> None:
        """Draw all bodies at one frame.

        Parameters
        ----------
        number
            Of the frame.
        width, pin
            Width of the lines and size of the markers on the bodies' ends, points.
        """
        for body, cells in self.frames.cells.items():
            points = self.positions[body][number]
            if not len(cells):
                axes.plot(*points.T, "s", color=colour, markersize=1.6 * pin, zorder=zorder + 1)
                continue
            lines = {"capstyle": "round", "zorder": zorder}
            if body in self.frames.rigid:
                bar = BAR * width
                axes.add_collection(LineCollection(points[cells], colors=[colour], linewidths=bar, **lines))
                lines["zorder"] += 0.1
                axes.add_collection(LineCollection(points[cells], colors=["white"], linewidths=HOLLOW * bar, **lines))
            else:
                axes.add_collection(LineCollection(points[cells], colors=[colour], linewidths=width, **lines))
            axes.plot(*points[ends(cells)].T, "o", color=colour, markersize=pin, zorder=zorder + 1)

    def keys(self) -> list[Line2D]:
        """Return what tells rigid bodies from flexible ones, where there are both."""
        kinds = {body in self.frames.rigid for body, cells in self.frames.cells.items() if len(cells)}
        if len(kinds) < 2:
            return []
        bar = BAR * KEY_WIDTH
        hollow = [Stroke(linewidth=bar, foreground=QUIET), Stroke(linewidth=HOLLOW * bar, foreground="white")]
        return [
            Line2D([], [], color=QUIET, linewidth=KEY_WIDTH, label="flexible"),
            Line2D([], [], path_effects=hollow, label="rigid"),
        ]


def shown_positions(frames: Frames, body: str, exaggeration: float) -> np.ndarray:
    """Return a body's positions (n_f, n_nodes, d), in m, with its deformation enlarged in the plane.

    The undeformed body is turned, moved and (by the tiny change of the chord) scaled so that its two ends
    meet the deformed ones; what is then left is the deformation. A body that has not exactly two ends is left
    as it is.
    """
    positions = frames.positions[body]
    if exaggeration == 1.0 or not _can_be_enlarged(frames, body):
        return positions
    # In the plane as complex numbers, turning and scaling is one multiplication.
    deformed = positions[..., 0] + 1j * positions[..., 1]
    plain = frames.nodes[body][:, 0] + 1j * frames.nodes[body][:, 1]
    first, second = ends(frames.cells[body])
    turn = (deformed[:, second] - deformed[:, first]) / (plain[second] - plain[first])
    rigid = deformed[:, [first]] + turn[:, None] * (plain - plain[first])[None, :]
    shown = rigid + exaggeration * (deformed - rigid)
    return np.stack([shown.real, shown.imag], axis=-1)


def _can_be_enlarged(frames: Frames, body: str) -> bool:
    """Tell whether a body lies in the plane and has two ends, through which its undeformed shape can be laid."""
    return frames.positions[body].shape[-1] == 2 and len(ends(frames.cells[body])) == 2


def _view(positions: Iterable[np.ndarray]) -> np.ndarray:
    """Return what projects positions onto the paper, shape (d, 2): along z, or obliquely where a motion leaves the
    plane."""
    points = np.concatenate([part.reshape(-1, part.shape[-1]) for part in positions])
    extents = np.ptp(points, axis=0)
    if extents.size == 2 or extents[2] < FLAT * extents.max():
        return np.eye(extents.size)[:, :2]
    return OBLIQUE


def ends(cells: np.ndarray) -> np.ndarray:
    """Return the nodes that belong to one line cell only."""
    nodes, counts = np.unique(cells, return_counts=True)
    return nodes[counts == 1]
