"""The assembled mechanism with the names of its bodies, joints and points, for `pgmp check --plot`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox

from pgmp_petsc.figures.shapes import Shapes
from pgmp_petsc.figures.style import PALETTE, QUIET, axis_label, axis_unit, new_figure, styled, top_legend
from pgmp_petsc.results.effect_sizes import Assembly

WIDTH = 9.0
# Names within this share of the mechanism's size are of one place.
TOGETHER = 1e-3
# Where a label may stand, points from its place: in rings around it.
RINGS, DIRECTIONS = (14.0, 30.0, 50.0, 75.0, 105.0, 140.0, 180.0), 16
MARGIN = 0.22  # of the mechanism's size, around it, for labels
MOST_POINTS = 60  # names beyond are left out, which is said
ON_LABEL, ON_LINE = 1000.0, 40.0  # what a place costs that hides another label, or a body


@dataclass
class _Label:
    """What is written at a place: its coordinates, names of joints, names of points."""

    place: np.ndarray
    joints: list[str]
    points: list[str]


@dataclass
class _Hidden:
    """What labels should not hide: points (n, 2) along bodies and leaders, boxes of labels; all in pixels."""

    lines: np.ndarray
    labels: list[Bbox]
    inside: Bbox

    def cost(self, box: Bbox, leader: np.ndarray) -> float:
        """Return what a label at a place hides, together with the line that leads to it."""
        outside = (
            box.x0 < self.inside.x0 or box.x1 > self.inside.x1 or box.y0 < self.inside.y0 or box.y1 > self.inside.y1
        )
        cost = 1e6 * outside + ON_LABEL * sum(_overlap(box, other) for other in self.labels)
        cost += ON_LINE * _n_within(box.padded(2), self.lines)
        return cost + ON_LINE * sum(_n_within(other, leader) for other in self.labels)

    def add(self, box: Bbox, leader: np.ndarray) -> None:
        """Take in a label that is written."""
        self.labels.append(box.padded(3))
        self.lines = np.concatenate([self.lines, leader])


@styled
def assembly(shown: Assembly) -> Figure:
    """Draw the bodies, each in its colour with its name, joints as rings with theirs, and named points.

    Names at one place are in one label: the joint above, the points below it. Labels are placed so that none hides
    another.
    """
    frames = shown.frames
    factor, unit = axis_unit("m", *frames.positions.values())
    shapes = Shapes.of(frames, 1.0, factor)
    low, high = shapes.limits
    view = _projection(shapes)
    labels, left_out = _labels(shown, lambda place: factor * view(place), float(max(high - low)))
    every = np.array([label.place for label in labels] or [low])
    low, high = np.minimum(low, every.min(axis=0)), np.maximum(high, every.max(axis=0))
    room = MARGIN * max(high - low)
    low, high = low - room, high + room
    height = float(np.clip((WIDTH - 1.2) * (high - low)[1] / (high - low)[0], 3.4, 8.5))
    figure = new_figure(WIDTH, height + 0.9)
    axes = figure.subplots()
    names = _draw_bodies(axes, shapes)
    for label in labels:
        style = {"color": "#333333", "markeredgecolor": "white", "markersize": 5}
        if label.joints:
            style = {"color": "white", "markeredgecolor": "#222222", "markeredgewidth": 1.6, "markersize": 9}
        ground = any(point.startswith("ground:") for point in label.points)
        if ground:
            axes.plot(*label.place, marker="^", color="#C9CED3", markersize=17, zorder=3)
        axes.plot(*label.place, marker="o", zorder=6, **style)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.set_xlabel(axis_label(shapes.axis_names[0], unit))
    axes.set_ylabel(axis_label(shapes.axis_names[1], unit))
    keys = [
        Line2D([], [], marker="o", linestyle="none", color="white", markeredgecolor="#222222", markeredgewidth=1.6,
               markersize=8, label="joint"),
        Line2D([], [], marker="o", linestyle="none", color="#333333", markersize=5, label="named point"),
        Line2D([], [], marker="^", linestyle="none", color="#C9CED3", markersize=11, label="on the ground"),
        *shapes.keys(),
    ]  # fmt: skip
    notes = [f"{left_out} more names of points are left out"] if left_out else []
    top_legend(figure, keys, f"{shown.scene.replace('_', ' ')}: assembled at {shown.configuration}", notes)
    figure.canvas.draw()
    _place_labels(axes, names, labels, shapes)
    return figure


def _projection(shapes: Shapes):
    """Return what takes a place in space or in the plane onto the picture."""
    from pgmp_petsc.figures.shapes import OBLIQUE

    return (lambda place: place @ OBLIQUE) if shapes.oblique else (lambda place: place[:2])


def _labels(shown: Assembly, placed, size: float) -> tuple[list[_Label], int]:
    """Return a label for every place that has names, and how many names of points are left out."""
    labels: list[_Label] = []
    named = [(name, placed(place), True) for name, place in shown.joints.items()]
    named += [(name, placed(place), False) for name, place in shown.points.items()]
    left_out = 0
    for number, (name, place, is_joint) in enumerate(named):
        near = next((label for label in labels if np.abs(label.place - place).max() < TOGETHER * size), None)
        if near is None and number - len(shown.joints) >= MOST_POINTS:
            left_out += 1
            continue
        if near is None:
            near = _Label(place, [], [])
            labels.append(near)
        (near.joints if is_joint else near.points).append(name)
    return labels, left_out


def _draw_bodies(axes: Axes, shapes: Shapes) -> list[tuple[str, np.ndarray, str]]:
    """Draw the bodies; return name, middle and colour of each."""
    found = []
    for number, (body, cells) in enumerate(shapes.frames.cells.items()):
        points, colour = shapes.positions[body][0], PALETTE[number % len(PALETTE)]
        if len(cells):
            width = 7.0 if body in shapes.frames.rigid else 4.0
            lines = LineCollection(points[cells], colors=[colour], linewidths=width, capstyle="round", zorder=4)
            axes.add_collection(lines)
            if body in shapes.frames.rigid:
                inner = LineCollection(points[cells], colors=["white"], linewidths=3.0, capstyle="round", zorder=4.1)
                axes.add_collection(inner)
            middles = points[cells].mean(axis=1)
            middle = middles[np.argmin(np.linalg.norm(middles - points.mean(axis=0), axis=1))]
        else:
            middle = points[0]
            axes.plot(*middle, "s", color=colour, markersize=10, zorder=4)
        found.append((body, middle, colour))
    return found


def _place_labels(
    axes: Axes, names: Sequence[tuple[str, np.ndarray, str]], labels: Sequence[_Label], shapes: Shapes
) -> None:
    """Write every label at the place, of those around its point, where it hides least."""
    hidden = _Hidden(_pixels(axes, shapes), [], axes.get_window_extent())
    for name, place, colour in names:
        _write(axes, place, name, {"color": colour, "weight": "bold", "fontsize": 10.0}, hidden)
    for label in sorted(labels, key=lambda label: not label.joints):
        points = [point for point in label.points if not (label.joints and point.startswith("ground:origin"))]
        style = {"color": "#222222", "fontsize": 9.0} if label.joints else {"color": QUIET, "fontsize": 8.0}
        text = "\n".join(filter(None, (", ".join(label.joints), "\n".join(points or label.points))))
        _write(axes, label.place, text, style, hidden)


def _write(axes: Axes, place: np.ndarray, text: str, style: dict, hidden: _Hidden) -> None:
    """Write a text beside its place, and note what it takes."""
    note = axes.annotate(
        text, place, xytext=(0, 0), textcoords="offset points", ha="center", va="center", zorder=8, linespacing=1.15,
        arrowprops={"arrowstyle": "-", "color": "#B5BAC0", "linewidth": 0.7, "shrinkA": 0, "shrinkB": 5}, **style,
    )  # fmt: skip
    best, cost = (0.0, 0.0), np.inf
    for offset in _offsets(_extent(note)):
        found = hidden.cost(_box_at(note, offset), _leader(note, offset)) + np.hypot(*offset)
        if found < cost:
            best, cost = offset, found
    note.set_position(best)
    note.set_anncoords("offset points")
    hidden.add(_box_at(note, best), _leader(note, best))


def _offsets(size: tuple[float, float]) -> Iterator[tuple[float, float]]:
    """Yield where the middle of a label of a size (points) may stand, points from its place."""
    for ring in RINGS:
        for angle in 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
            x, y = np.cos(angle), np.sin(angle)
            yield x * (ring + 0.5 * size[0]), y * (ring + 0.5 * size[1])


def _extent(note: Annotation) -> tuple[float, float]:
    """Return width and height of a text, points."""
    figure = note.figure
    box = super(Annotation, note).get_window_extent(figure.canvas.get_renderer())
    return 72.0 * box.width / figure.dpi, 72.0 * box.height / figure.dpi


def _box_at(note: Annotation, offset: tuple[float, float]) -> Bbox:
    """Return the box of a text, pixels, whose middle stands at an offset (points) from its place."""
    scale = note.figure.dpi / 72.0
    x, y = note.axes.transData.transform(note.xy)
    width, height = (scale * length for length in _extent(note))
    x, y = x + scale * offset[0], y + scale * offset[1]
    return Bbox.from_extents(x - 0.5 * width, y - 0.5 * height, x + 0.5 * width, y + 0.5 * height)


def _leader(note: Annotation, offset: tuple[float, float]) -> np.ndarray:
    """Return points along the line from a label's place to its middle, but for both ends, (n, 2), pixels."""
    start = note.axes.transData.transform(note.xy)
    return start + np.linspace(0.15, 0.7, 8)[:, None] * np.array(offset) * note.figure.dpi / 72.0


def _n_within(box: Bbox, points: np.ndarray) -> int:
    """Return how many points are in a box."""
    return int(np.count_nonzero(((points > box.min) & (points < box.max)).all(axis=1)))


def _overlap(one: Bbox, other: Bbox) -> float:
    """Return the area, in pixels, that two boxes share."""
    width = min(one.x1, other.x1) - max(one.x0, other.x0)
    height = min(one.y1, other.y1) - max(one.y0, other.y0)
    return max(width, 0.0) * max(height, 0.0)


def _pixels(axes: Axes, shapes: Shapes) -> np.ndarray:
    """Return points along all bodies, (n, 2), pixels."""
    shares = np.linspace(0.0, 1.0, 7)[:, None]
    found = [np.zeros((0, 2))]
    for body, cells in shapes.frames.cells.items():
        points = shapes.positions[body][0]
        found += [(1.0 - shares) * points[a] + shares * points[b] for a, b in cells]
        found += [points] if not len(cells) else []
    return axes.transData.transform(np.concatenate(found))
