"""Pictures of a mechanism: its shape at several instants, as a fan of positions coloured by time, and assembled, with
the names of its bodies, joints and points (`pgmp check --plot`). Beams are lines, rigid bodies hollow bars, point
masses squares, what acts between two points is dotted; a triangle marks pins and ends that the ground holds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import Stroke
from matplotlib.text import Annotation

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.figures import style
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.results import Frames, Trajectory
from pgmp_petsc.results.selection import Assembly, spans_in

PATH_COLOUR = "#D8D8D8"
BAR, HOLLOW = 1.6, 0.5  # width of a rigid body's bar over that of a beam, and of the line inside it over the bar's
KEY_WIDTH = 3.0  # points
DOTTED = (0, (1.0, 1.2))
AT_REST = 1e-6  # a pin that moves by less than this share of the mechanism's extent is held by the ground
# of the size of a path, the distance of most pairs of frames: nine in a turn; frames that are no turn
COARSE, MOST, FEW = 0.35, 0.9, 9
# A motion that leaves the plane by less than this share of its extent is shown along z, another one obliquely.
FLAT = 1e-3
RECEDING = (0.45, 0.35)  # how far to the right and up a metre of depth is there
_GROUND = ((0.0, 0.0), (-0.65, -1.0), (0.65, -1.0), (0.0, 0.0))  # a triangle below the pin, as a marker's vertices


@dataclass(frozen=True)
class TimeColours:
    """Colours of instants, or of their order, from yellow to dark violet."""

    scale: Normalize  # from time (s) to 0 ... 1
    colours: Colormap  # from there to a colour

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

    def add_bar(self, axes: Axes) -> None:
        bar = axes.figure.colorbar(ScalarMappable(self.scale, self.colours), ax=axes, pad=0.01, aspect=32)
        bar.outline.set_visible(False)
        bar.set_label("time (s)")


@dataclass(frozen=True)
class Shapes:
    """The shapes of a run as they are shown."""

    frames: Frames  # where they come from
    positions: dict[str, np.ndarray]  # of each body's nodes, shape (n_f, n_nodes, 2), in the unit of the picture
    #: what projects places onto the picture, (d, 2): along z, or obliquely where the motion leaves the plane
    view: np.ndarray
    #: of what acts between two points both at the frames, (2, n_f, 2), in the unit of the picture
    spans: list[np.ndarray] = field(default_factory=list)
    pins: dict[str, np.ndarray] = field(default_factory=dict)  # nodes of each body that are ends, or in a joint

    @classmethod
    def of(
        cls, frames: Frames, exaggeration: float = 1.0, factor: float = 1.0, record: RunRecord | None = None
    ) -> Shapes:
        """Return the shapes with their deformation enlarged, in the unit of which a metre has `factor`; joints and what
        acts between two points are those of the scene of a record."""
        scene = {} if record is None else style.scene_of(record)
        shown = {body: shown_positions(frames, body, exaggeration) for body in frames.nodes}
        view = _view(shown.values())
        projected = {body: factor * positions @ view for body, positions in shown.items()}
        pins = {body: set(map(int, ends(cells))) for body, cells in frames.cells.items()}
        for address in (one for joint in scene.get("joints", {}).values() for one in joint.get("connect", ())):
            node = node_of(frames, scene, address)
            if node is not None:
                pins[address.partition(":")[0]].add(node)
        spans = [factor * np.moveaxis(span, 1, 0) @ view for span in spans_of(frames, record, shown).values()]
        return cls(frames, projected, view, spans, {body: np.array(sorted(own), int) for body, own in pins.items()})

    @property
    def axis_names(self) -> tuple[str, str]:
        names = []
        for shares in self.view.T:
            parts = [(name, share) for name, share in zip("xyz", shares) if share]
            parts.sort(key=lambda part: part[1] != 1.0)  # the axis itself, then depth
            names.append("".join(_term(name, share) for name, share in parts))
        return names[0], names[1]

    @property
    def not_enlarged(self) -> list[str]:
        """The deformable bodies whose deformation cannot be enlarged."""
        bodies = (body for body in self.frames.nodes if body not in self.frames.rigid and len(self.frames.cells[body]))
        return [body for body in bodies if not _can_be_enlarged(self.frames, body)]

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper limits of a picture of all frames, with a margin, shape (2,) each."""
        points = np.concatenate([part.reshape(-1, 2) for part in (*self.positions.values(), *self.spans)])
        low, high = points.min(axis=0), points.max(axis=0)
        margin = 0.05 * max(high - low)
        return low - margin, high + margin

    def draw_paths(self, axes: Axes) -> None:
        for body, cells in self.frames.cells.items():
            for node in filter(lambda node: is_followed(self.positions[body][:, node]), ends(cells)):
                axes.plot(*self.positions[body][:, node].T, color=PATH_COLOUR, linewidth=0.8, zorder=1)

    def scale(self, axes: Axes, low: np.ndarray, high: np.ndarray, unit: str) -> None:
        """Let axes go from one corner (2,) to the other, in a unit."""
        x, y = (style.axis_label(name, unit) for name in self.axis_names)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel=x, ylabel=y)

    def draw_ground(self, axes: Axes, size: float = 24.0) -> None:
        """Draw a triangle below every pin or end of a body, and what acts between points, that stays where it is; where
        all do, none tells what the ground holds."""
        low, high = self.limits
        paths = [self.positions[body][:, node] for body, nodes in self.pins.items() for node in nodes]
        paths += [path for span in self.spans for path in span]
        resting = [path for path in paths if np.ptp(path, axis=0).max() < AT_REST * max(high - low)]
        for path in resting if len(resting) < len(paths) else ():
            axes.plot(*path[0], marker=_GROUND, color=style.QUIET, markersize=size, zorder=1.5, clip_on=False)

    def draw(self, axes: Axes, number: int, colour: Sequence[float], width: float, pin: float, zorder: float) -> None:
        """Draw all bodies at the frame of that number, with lines and markers of pins so many points wide."""
        for body, cells in self.frames.cells.items():
            points = self.draw_body(axes, body, number, colour, width, 1.6 * pin, zorder)
            if len(cells):
                axes.plot(*points[self.pins[body]].T, "o", color=colour, markersize=pin, zorder=zorder + 1)
        self.draw_spans(axes, number, colour, 0.6 * width, zorder)

    def draw_spans(self, axes: Axes, number: int, colour: Any, width: float, zorder: float) -> None:
        """Draw what acts between two points at one frame."""
        for span in self.spans:
            axes.plot(*span[:, number].T, color=colour, linewidth=width, linestyle=DOTTED, zorder=zorder)

    def draw_body(
        self, axes: Axes, body: str, number: int, colour: Any, width: float, square: float, zorder: float
    ) -> np.ndarray:
        """Draw a body at one frame without its ends, a point mass as a square of so many points; return its nodes."""
        points, cells = self.positions[body][number], self.frames.cells[body]
        if not len(cells):
            axes.plot(*points.T, "s", color=colour, markersize=square, zorder=zorder + 1)
            return points
        strokes = [(colour, width, zorder)]
        if body in self.frames.rigid:
            strokes = [(colour, BAR * width, zorder), ("white", HOLLOW * BAR * width, zorder + 0.1)]
        for ink, thick, order in strokes:
            lines = LineCollection(points[cells], colors=[ink], linewidths=thick, capstyle="round", zorder=order)
            axes.add_collection(lines)
        return points

    def keys(self) -> list[Line2D]:
        """Return what tells rigid bodies from flexible ones, where there are both, and what acts between points."""
        kinds = {body in self.frames.rigid for body, cells in self.frames.cells.items() if len(cells)}
        spans = Line2D([], [], color=style.QUIET, linewidth=1.6, linestyle=DOTTED, label="acts between two points")
        if len(kinds) < 2:
            return [spans] if self.spans else []
        bar = BAR * KEY_WIDTH
        hollow = [Stroke(linewidth=bar, foreground=style.QUIET), Stroke(linewidth=HOLLOW * bar, foreground="white")]
        return [
            Line2D([], [], color=style.QUIET, linewidth=KEY_WIDTH, label="flexible"),
            Line2D([], [], path_effects=hollow, label="rigid"),
            *([spans] if self.spans else []),
        ]


def spans_of(frames: Frames, record: RunRecord | None, shown: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return both points of what acts between two, (n_f, 2, d), m, of bodies whose nodes are shown in places (n_f,
    n_nodes, d); without those whose place a run does not say (`without_span`)."""
    pairs = spans_in({} if record is None else style.scene_of(record))
    paths = {name: [paths_of(frames, record, one, shown) for one in pair] for name, pair in pairs.items()}
    return {name: np.concatenate(own, axis=1) for name, own in paths.items() if own[0].shape[1] == own[1].shape[1] == 1}


def without_span(frames: Frames, record: RunRecord) -> list[str]:
    """Say what acts between two points and is not drawn."""
    pairs, drawn = spans_in(style.scene_of(record)), spans_of(frames, record, frames.positions)
    names = ", ".join(name for name in pairs if name not in drawn)
    return [f"{names}: not drawn, as a run does not say where points of meshes are"] if names else []


def paths_of(frames: Frames, record: RunRecord, address: str, shown: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return where a named point may be at the frames, (n_f, n, d): one place where it is known, else all nodes of its
    body, as of meshes a run keeps no names. Points of the ground are those at the run's parameters."""
    (owner, _, point), scene = address.partition(":"), style.scene_of(record)
    if owner == "ground":
        d = next(iter(shown.values())).shape[2]
        at = scene.get("ground", {}).get("points", {}).get(point, [0.0] * d)
        place = np.array([record.parameters.get(value, value) for value in at], dtype=float)
        return np.tile(place, (len(frames.time), 1, 1))
    node = node_of(frames, scene, address)
    return shown[owner] if node is None else shown[owner][:, [node]]


def node_of(frames: Frames, scene: Mapping[str, Any], address: str) -> int | None:
    """Return which of its body's nodes a point ``"body:point"`` is; None of the ground's, and where a run does not say
    it: of meshes it keeps no names."""
    body, _, point = address.partition(":")
    entry = scene.get("bodies", {}).get(body) or {}
    if body not in frames.nodes or not (entry.get("line") or entry.get("rigid")):
        return None
    nodes = frames.nodes[body]
    if entry.get("line"):
        along = np.argsort(nodes[:, 0], kind="stable")
        return int(along[int({"hinge": 0, "tip": -1, "middle": len(nodes) // 2}.get(point, point))])
    centre = entry["rigid"].get("centre") or [0.0] * nodes.shape[1]
    place = {"centre": centre, **entry["rigid"].get("points", {})}[point]
    if not all(isinstance(value, (int, float)) for value in place):  # a parameter's name
        return None
    return int(np.argmin(np.linalg.norm(nodes - place, axis=1)))


def shown_positions(frames: Frames, body: str, exaggeration: float) -> np.ndarray:
    """Return a body's positions (n_f, n_nodes, d), in m, with its deformation enlarged in the plane.

    The undeformed body is turned, moved and (by the tiny change of the chord) scaled so that its two ends meet the
    deformed ones; what is then left is the deformation. A body that has not exactly two ends is left as it is.
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
    plane, with y or z upwards (`style.upward`) and the third axis into depth."""
    points = np.concatenate([part.reshape(-1, part.shape[-1]) for part in positions])
    extents = np.ptp(points, axis=0)
    view = np.eye(extents.size)[:, :2]
    if extents.size == 3 and extents[2] >= FLAT * extents.max():
        up = style.upward(points)
        view = np.eye(3)[:, [0, up]]
        # a right-handed picture: z comes out of it where y is upwards, y goes into it where z is
        view[3 - up] = np.array(RECEDING) * (1.0 if up == 2 else -1.0)
    return view


def _term(name: str, share: float) -> str:
    sign = "+" if share > 0.0 else "\N{MINUS SIGN}"
    return name if share == 1.0 else f" {sign} {abs(share):g} {name}"


def is_followed(path: np.ndarray) -> bool:
    """Return whether frames follow the path (n_f, d) of a point: with few of them in a turn, chords are a tangle."""
    chords = np.linalg.norm(np.diff(path, axis=0), axis=1)
    return len(chords) < FEW or bool(np.quantile(chords, MOST) <= COARSE * np.ptp(path, axis=0).max())


def ends(cells: np.ndarray) -> np.ndarray:
    """Return the nodes that belong to one line cell only."""
    nodes, counts = np.unique(cells, return_counts=True)
    return nodes[counts == 1]


N_INSTANTS = 14
WIDTH, LEAST_WIDTH = 8.6, 5.0


@style.styled
def mechanism(
    trajectory: Trajectory, n_instants: int = N_INSTANTS, exaggeration: float = 1.0, label: str = ""
) -> Figure:
    """Draw the mechanism's shape at instants that divide the run, which `label` tells from others, equally; fewer where
    there are fewer frames.

    The exaggeration is a factor on each body's deformation: its nodes' distances from the undeformed body laid through
    the body's two ends, so that the bodies stay joined. It is stated in the picture if it is not 1. Raises `InputError`
    if the trajectory has no frames.
    """
    frames = trajectory.frames
    if frames is None:
        raise InputError("the trajectory has no frames to draw; use --override simulation.frames=100")
    factor, unit = style.axis_unit(trajectory.record.system.unit("m"), *frames.positions.values())
    shapes = Shapes.of(frames, exaggeration, factor, trajectory.record)
    chosen = np.unique(np.linspace(0, len(frames.time) - 1, n_instants).round().astype(int))

    low, high = shapes.limits
    # Width beside labels and the colour bar, and height, have the ratio of the shapes: equal scales fill the picture.
    ratio = (high - low)[1] / (high - low)[0]
    width, height = np.clip(8.0 / ratio + 1.6, LEAST_WIDTH, WIDTH), np.clip((WIDTH - 1.6) * ratio, 2.0, 8.0)
    keys = shapes.keys()
    figure = style.new_figure(float(width), float(height) + 1.2 + (0.24 if keys else 0.0))
    axes = figure.subplots()
    colours = TimeColours.over(frames.time)
    shapes.draw_paths(axes)
    shapes.draw_ground(axes)
    for number in chosen[:-1]:
        shapes.draw(axes, number, colours.at(frames.time[number], strength=0.75), width=1.6, pin=3.0, zorder=2)
    shapes.draw(axes, chosen[-1], colours.at(frames.time[chosen[-1]]), width=3.0, pin=5.5, zorder=4)
    shapes.scale(axes, low, high, unit)
    colours.add_bar(axes)
    notes = [*style.notes_of_runs([trajectory]), *without_span(frames, trajectory.record)]
    plain, enlarged = shapes.not_enlarged, ""
    if exaggeration != 1.0:
        deformable = len(frames.nodes) - len(frames.rigid)
        if plain:
            why = "only bodies in a plane, with two ends, can be"
            notes.append(f"deformation of {', '.join(plain)} as it is, not enlarged: {why}")
        if len(plain) < deformable:
            enlarged = f", deformation enlarged {exaggeration:g} times"
    instants = f"at {len(chosen)} instants" if len(chosen) > 1 else "at one instant"
    what = f"Shape {instants}, {style.MODELS[trajectory.model]}{enlarged}"
    return style.top_legend(figure, keys, style.heading(what, trajectory.record, label), notes)


ASSEMBLY_WIDTH = 9.0
TOGETHER = 1e-3  # names within this share of the mechanism's size are of one place
# Where a label may stand, points from its place: in rings around it.
RINGS, DIRECTIONS = (14.0, 30.0, 50.0, 75.0, 105.0, 140.0, 180.0), 16
MARGIN = 0.22  # of the mechanism's size, around it, for labels
MOST_POINTS = 60  # names beyond are left out, which is said
ON_LABEL, ON_LINE = 1000.0, 40.0  # what a place costs that hides another label, or a body
MARK = 5.0  # half the size of a mark, points


@dataclass
class _Label:
    """Label of a place: its coordinates, names of joints, names of points."""

    place: np.ndarray
    joints: list[str]
    points: list[str]


@dataclass
class _Hidden:
    """Things that labels should not hide: points (n, 2) along bodies and leaders, and of marks, lower and upper corners
    (n, 2, 2) of labels, and those of the picture (2, 2); all in pixels."""

    lines: np.ndarray
    labels: np.ndarray
    inside: np.ndarray

    def costs(self, boxes: np.ndarray, leaders: np.ndarray) -> np.ndarray:
        """Return what labels with such corners (m, 2, 2) hide, each with the line (n, 2) of points that leads to it."""
        low, high = boxes[:, None, 0], boxes[:, None, 1]
        outside = np.any((boxes[:, 0] < self.inside[0]) | (boxes[:, 1] > self.inside[1]), axis=1)
        shared = np.minimum(high, self.labels[:, 1]) - np.maximum(low, self.labels[:, 0])
        hidden = _within(self.lines, low - 6.0, high + 6.0).sum(axis=1)
        crossed = _within(leaders[:, None], self.labels[:, None, 0], self.labels[:, None, 1]).sum(axis=(1, 2))
        return 1e6 * outside + ON_LABEL * shared.clip(0.0).prod(axis=2).sum(axis=1) + ON_LINE * (hidden + crossed)

    def add(self, box: np.ndarray, leader: np.ndarray) -> None:
        """Take in a label that is written."""
        self.labels = np.concatenate([self.labels, [box + [[-3.0], [3.0]]]])
        self.lines = np.concatenate([self.lines, leader])


def _within(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.all((low < points) & (points < high), axis=-1)


@style.styled
def assembly(shown: Assembly) -> Figure:
    """Draw the bodies, each in its colour with its name, joints as rings with theirs, and named points.

    Names at one place are in one label: the joint above, the points below it. Labels are placed so that none hides
    another.
    """
    frames = shown.frames
    factor, unit = style.axis_unit(shown.metre, *frames.positions.values())
    shapes = Shapes.of(frames, 1.0, factor)
    shapes.spans.extend(factor * span[:, None] @ shapes.view for span in shown.spans.values())
    low, high = shapes.limits
    labels, left_out = _labels(shown, lambda place: factor * place @ shapes.view, float(max(high - low)))
    every = np.array([label.place for label in labels] or [low])
    low, high = np.minimum(low, every.min(axis=0)), np.maximum(high, every.max(axis=0))
    room = MARGIN * max(high - low)
    low, high = low - room, high + room
    height = float(np.clip((ASSEMBLY_WIDTH - 1.2) * (high - low)[1] / (high - low)[0], 3.4, 8.5))
    figure = style.new_figure(ASSEMBLY_WIDTH, height + 0.9)
    axes = figure.subplots()
    names = _draw_bodies(axes, shapes)
    shapes.draw_spans(axes, 0, style.QUIET, 1.6, 3.5)
    names += [(name, span[:, 0].mean(axis=0), style.QUIET) for name, span in zip(shown.spans, shapes.spans)]
    for label in labels:
        look = {"color": "#333333", "markeredgecolor": "white", "markersize": 5}
        if label.joints:
            look = {"color": "white", "markeredgecolor": "#222222", "markeredgewidth": 1.6, "markersize": 9}
        if any(point.startswith("ground:") for point in label.points):
            axes.plot(*label.place, marker="^", color="#C9CED3", markersize=17, zorder=3)
        axes.plot(*label.place, marker="o", zorder=6, **look)
    shapes.scale(axes, low, high, unit)
    keys = [
        Line2D([], [], marker="o", linestyle="none", color="white", markeredgecolor="#222222", markeredgewidth=1.6,
               markersize=8, label="joint"),
        Line2D([], [], marker="o", linestyle="none", color="#333333", markersize=5, label="named point"),
        Line2D([], [], marker="^", linestyle="none", color="#C9CED3", markersize=11, label="on the ground"),
        *shapes.keys(),
    ]  # fmt: skip
    notes = [f"{left_out} more names of points are left out"] if left_out else []
    style.top_legend(figure, keys, f"{shown.scene}: assembled at {shown.configuration}", notes)
    figure.canvas.draw()
    _place_labels(axes, names, labels, shapes)
    return figure


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
    found = []
    for number, (body, cells) in enumerate(shapes.frames.cells.items()):
        colour = style.PALETTE[number % len(style.PALETTE)]
        points = shapes.draw_body(axes, body, 0, colour, width=4.0, square=10.0, zorder=4)
        middles = points[cells].mean(axis=1) if len(cells) else points
        middle = middles[np.argmin(np.linalg.norm(middles - points.mean(axis=0), axis=1))]
        found.append((body, middle, colour))
    return found


def _place_labels(
    axes: Axes, names: Sequence[tuple[str, np.ndarray, str]], labels: Sequence[_Label], shapes: Shapes
) -> None:
    """Write every label at the place, of those around its point, where it hides least."""
    across = np.indices((3, 3)).reshape(2, -1).T - 1.0
    marks = [axes.transData.transform(label.place) + MARK * axes.figure.dpi / 72.0 * across for label in labels]
    lines, inside = np.concatenate([_pixels(axes, shapes), *marks]), axes.get_window_extent().get_points()
    hidden = _Hidden(lines, np.zeros((0, 2, 2)), inside)
    for name, place, colour in names:
        _write(axes, place, name, {"color": colour, "weight": "bold", "fontsize": 10.0}, hidden)
    for label in sorted(labels, key=lambda label: not label.joints):
        points = [point for point in label.points if not (label.joints and point.startswith("ground:origin"))]
        look = {"color": "#222222", "fontsize": 9.0} if label.joints else {"color": style.QUIET, "fontsize": 8.0}
        text = "\n".join(filter(None, (", ".join(label.joints), "\n".join(points or label.points))))
        _write(axes, label.place, text, look, hidden)


def _write(axes: Axes, place: np.ndarray, text: str, look: dict, hidden: _Hidden) -> None:
    """Write a text beside its place, and note what it takes."""
    note = axes.annotate(
        text, place, xytext=(0, 0), textcoords="offset points", ha="center", va="center", zorder=8, linespacing=1.15,
        arrowprops={"arrowstyle": "-", "color": "#B5BAC0", "linewidth": 0.7, "shrinkA": 0, "shrinkB": 5}, **look,
    )  # fmt: skip
    figure, at = axes.figure, axes.transData.transform(place)
    scale, box = figure.dpi / 72.0, super(Annotation, note).get_window_extent(figure.canvas.get_renderer())
    half, shares = 0.5 * np.array([box.width, box.height]), np.linspace(0.15, 0.7, 8)[:, None]

    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    ways = np.column_stack([np.cos(angles), np.sin(angles)])
    offsets = np.concatenate([ways * (scale * ring + half) for ring in RINGS])
    boxes = (at + offsets)[:, None] + [-half, half]
    leaders = at + shares * offsets[:, None]  # points on the lines, but for their ends
    best = np.argmin(hidden.costs(boxes, leaders) + np.hypot(*offsets.T) / scale)
    note.set(position=offsets[best] / scale, anncoords="offset points")
    hidden.add(boxes[best], leaders[best])


def _pixels(axes: Axes, shapes: Shapes) -> np.ndarray:
    """Return points along all bodies, and what acts between points, (n, 2), pixels."""
    shares = np.linspace(0.0, 1.0, 13)[:, None]
    found = [np.zeros((0, 2)), *((1.0 - shares) * a + shares * b for a, b in (span[:, 0] for span in shapes.spans))]
    for body, cells in shapes.frames.cells.items():
        points = shapes.positions[body][0]
        found += [(1.0 - shares) * points[a] + shares * points[b] for a, b in cells]
        found += [points] if not len(cells) else []
    return axes.transData.transform(np.concatenate(found))
