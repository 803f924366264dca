"""The film of a run: shapes of the mechanism at its frames, as numbers for the page's script.

Fields of the run (`results.trajectory`) are drawn as they are, surfaces of meshed bodies and lines of the others, with
how far they deform and their stress; a body without a field has the line between its joints. The picture is `SIZE`
units wide. A body is where a rigid motion takes its undeformed nodes X, and bends from there: ``x = p + D X + factor *
u``, with the rows to the right, down and towards the eye. The page enlarges u alone, and turns all of it about the
picture's middle where the motion is in space. Where no script runs it shows a picture of surfaces in colour.
"""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass, replace
from typing import Any

import matplotlib
import numpy as np
from matplotlib.collections import LineCollection, TriMesh
from matplotlib.colors import to_hex, to_rgb
from matplotlib.tri import Triangulation

from pgmp_petsc.base.errors import counted
from pgmp_petsc.declare.records import number_name
from pgmp_petsc.figures import motion
from pgmp_petsc.figures.mechanism import AT_REST, FLAT, ends, is_followed, shown_positions, without_span
from pgmp_petsc.figures.solids import COLOURS, EDGE, PLAIN, RIGID, colours_of, view_of
from pgmp_petsc.figures.style import PALETTE, axis_unit, new_figure, round_below, scene_of
from pgmp_petsc.report.sources import Datum
from pgmp_petsc.results import Trajectory
from pgmp_petsc.results.trajectory import truncated

MOST_NODES = 6000  # nodes of all surfaces of a film: what a phone draws 25 times a second
MESHED = ("solid2d", "solid3d")


def bodies_of(run: Trajectory) -> tuple[list[motion.Skin], list[str]]:
    """Return the bodies of a run with frames, and what is left out of them; surfaces with as many nodes as may be
    drawn, and of bodies without a field what of their deformation lies between their ends."""
    most = max(1, MOST_NODES // max(1, sum(own.kind != "line" for own in run.fields.values())))
    found, notes = motion.skins_of(run, motion.VALUES["mises"]), list[str]()
    for k, skin in enumerate(found):
        if len(skin.triangles):
            found[k] = _surface(skin, most, notes)
        elif skin.name not in run.fields:
            bent = motion.in_space(shown_positions(run.frames, skin.name, 2.0)) - skin.points
            found[k] = replace(skin, deformation=bent) if bent.any() else skin
    return motion.with_spans(found, run), notes


def _surface(skin: motion.Skin, most: int, notes: list[str]) -> motion.Skin:
    """Return a surface with its own nodes alone, as many as may be drawn, and note where they are fewer."""
    used, triangles = np.unique(skin.triangles, return_inverse=True)
    triangles, edges = triangles.reshape(-1, 3), np.searchsorted(used, skin.edges)
    if len(used) > most:
        peaks = np.zeros(len(used)) if skin.values is None else np.nan_to_num(skin.values[:, used]).max(axis=0)
        kept, triangles = motion.coarsened(skin.nodes[used], triangles, peaks, most)
        left = f"has {len(kept)} of its {len(used)} nodes, those of largest stress among them"
        notes.append(f"the surface of {skin.name} {left}")
        used = used[kept]
        edges = motion.outlines(triangles, skin.nodes[used])
    return replace(skin.part(nodes=used), triangles=triangles, edges=edges)


def _kind(skin: motion.Skin) -> str:
    """Return ``flexible``, ``rigid`` or ``mass``."""
    return "rigid" if skin.rigid and len(skin.edges) else "flexible" if len(skin.edges) else "mass"


def _known(skin: motion.Skin) -> np.ndarray:
    """Return the frames at which the deformation is known, shape (n_f,)."""
    return np.isfinite(skin.deformation).all(axis=(1, 2))


@dataclass(frozen=True, eq=False)
class Stress:
    """The largest von Mises' stress of a run, in surfaces and within."""

    over_time: np.ndarray  # of all bodies at the frames, shape (n_f,), Pa
    largest: float  # of all frames, and of the outputs of this stress at all steps, Pa
    body: str  # body, frame: where it is, and the frame at which that of the frames is largest
    frame: int
    when: str  # its instant, and of what it is the largest
    path: str  # path, index: dataset and place in the file; empty of beams at frames, where it is worked out of two
    index: str

    def shown(self, file: str, pascal: str) -> tuple[Datum, str]:
        """Return the largest one, of a file, and its unit, of which the file's is `pascal`."""
        factor, unit = axis_unit(pascal, np.array([self.largest]))
        text = f"{factor * self.largest:.4g}"
        return Datum(self.largest, text, file if self.path else "", self.path, self.index), unit


def stress_of(run: Trajectory) -> Stress | None:
    """Return the largest stress; None where none is known.

    Outputs know of all steps, frames of some: a peak between two frames is that of an output, where one has it.
    """
    known = {name: motion.VALUES["mises"](own) for name, own in run.fields.items() if not own.rigid}
    known = {name: values for name, values in known.items() if values is not None and np.isfinite(values).any()}
    if not known:
        return None
    over_time = np.max([np.nanmax(values, axis=1, initial=0.0) for values in known.values()], axis=0)
    body = max(known, key=lambda name: np.nanmax(known[name]))
    frame, node = map(int, np.unravel_index(np.nanargmax(known[body]), known[body].shape))
    largest, plain = float(known[body][frame, node]), "von_mises" in run.fields[body].at_nodes
    path = f"/fields/{body}/at_nodes/von_mises/{number_name(frame)}" if plain else ""
    when = f"at {run.frames.time[frame]:.4g} s, of the {counted(len(run.frames.time), 'frame')} kept"
    found = Stress(over_time, largest, body, frame, when, path, str(node) if plain else "")
    for output, entry in scene_of(run.record).get("outputs", {}).items():
        if output not in run.outputs or entry.get("quantity") not in ("von_mises", "stress_max", "stress_min"):
            continue  # stresses of beams are this one of their outermost fibres
        values, of_body = np.nan_to_num(run.outputs[output]), str(entry.get("body"))
        step = int(np.argmax(np.abs(values)))
        size = abs(float(values[step]))
        if of_body in known and size > found.largest:
            when = f"at {run.time[step]:.4g} s, of all steps ({output})"
            path = f"/outputs/{output}" if values[step] > 0.0 else ""
            found = replace(found, largest=size, body=of_body, when=when, path=path, index=str(step) if path else "")
    return found


SIZE = 10_000
MOST_FRAMES = 241
MOST_BYTES = 1_500_000  # of the shapes on a page, which base64 makes 4/3 of: more nodes mean fewer frames
TALLEST, FLATTEST = 1.1, 0.28  # of the picture over its width
FOOT = 600  # below the mechanism, for the bar of the scale
LARGEST_SHOWN = 0.3  # an enlarged deformation may reach this share of the picture's height
FACTORS = (1, 3, 10, 30, 100, 300, 1000)
N_STOPS = 33  # colours that the page interpolates between
STOPS = [to_hex(colour) for colour in matplotlib.colormaps[COLOURS](np.linspace(0.0, 1.0, N_STOPS))]
WIDTH = 1400  # pixels of the picture that is there without a script
DARKEST = 0.5  # of a face along the line of sight; the page's script has the same
SHADES = 254  # of stress from zero to the largest one; one more number says that it is not known


@dataclass(frozen=True)
class Legend:
    """Meaning of the colours."""

    words: str  # words, unit: of the quantity
    unit: str
    stops: list[str]  # colours from zero to the largest value
    largest: Datum  # of the whole run, as far as it is known
    where: str  # body and instant of it


@dataclass(frozen=True)
class _Picture:
    """Where places are in the picture: `view` (3, 3) and `unit` of a metre, then moved by `shift` (3,)."""

    view: np.ndarray
    unit: float
    shift: np.ndarray
    flat: bool  # whether all motion is in one plane, seen from in front

    def directions(self, vectors: np.ndarray) -> np.ndarray:
        """Return vectors (..., 3) to the right, down and towards the eye."""
        return self.unit * (vectors @ self.view.T) * [1.0, -1.0, 1.0]

    def places(self, points: np.ndarray) -> np.ndarray:
        return self.directions(points) + self.shift


class Film:
    """Data that the page needs to draw the mechanism of a run with frames, whose file has a name."""

    def __init__(self, run: Trajectory, name: str) -> None:
        frames, stress = run.frames, stress_of(run)
        self._bodies, left_out = bodies_of(run)
        self._stress, peak = stress, 0 if stress is None else stress.frame
        self._picture, tall = _picture(self._bodies)
        #: of the picture, in its own unit
        self.width, self.height = SIZE, tall + FOOT
        size = sum(b.points.shape[1] * (4 * bool(b.moved.any()) + (b.values is not None)) for b in self._bodies)
        n = len(frames.time)
        most = max(2, min(MOST_FRAMES, MOST_BYTES // max(size, 1), n))
        chosen = np.union1d(np.linspace(0, n - 1, most).round().astype(int), peak)
        #: number of the frame that is shown first and printed: that of the largest stress
        self.start = int(np.searchsorted(chosen, peak))
        self._shown = [body.part(chosen) for body in self._bodies]
        self._flat = [self._picture.places(body.points[self.start]) for body in self._shown]
        colours = [
            PALETTE[number % len(PALETTE)] if not len(body.triangles) else RIGID if body.rigid else PLAIN
            for number, body in enumerate(self._shown)
        ]
        #: bodies without a surface at that frame: kind (``flexible``, ``rigid``, ``mass``), colour, paths with their
        #: colours, and marks at the ends
        self.lines = [
            _line(body, at, colour, stress, self.start)
            for body, at, colour in zip(self._shown, self._flat, colours)
            if not len(body.triangles)
        ]
        joints = {body: self._picture.places(motion.in_space(at)) for body, at in frames.positions.items()}
        moving, resting = (_paths(run, joints, moves) for moves in (True, False))
        #: paths, ground: ``d`` of the paths that ends of bodies take; places (x, y) of ends that do not move
        self.paths = ["M" + "L".join(_pair(at) for at in path) for path in moving]
        self.ground = [tuple(path[0, :2].round().astype(int).tolist()) for path in resting]
        bar = round_below(SIZE / 6.0 / self._picture.unit)  # in the run's unit, about a sixth of the picture
        length, metre = axis_unit(run.record.system.unit("m"), np.array([bar]))
        #: length of the bar of the scale in the picture's unit, and in words
        self.scale = round(bar * self._picture.unit), f"{bar * length:g} {metre}"
        #: kind, colour and name of bodies that are not coloured by stress
        self.keys = [
            ("surface" if len(body.triangles) else kind, colour, body.name + ", rigid" * (kind == "rigid"))
            for body, kind, colour in zip(self._shown, map(_kind, self._shown), colours)
            if body.values is None or stress is None
        ]
        #: for the script: instants, bodies, factors, outputs
        self.data = self._data(run, frames.time[chosen], bar, colours)
        if not self._picture.flat:
            everywhere = self._picture.places(np.concatenate([body.points.reshape(-1, 3) for body in self._shown]))
            middle = 0.5 * (everywhere.min(axis=0) + everywhere.max(axis=0))
            self.data["turns"] = {"middle": middle.tolist(), "paths": [path.round().tolist() for path in moving],
                                  "ground": [path[0].round().tolist() for path in resting]}  # fmt: skip
        self.legend: Legend | None = None  # none where no stress is known
        if stress is not None:
            pascal = run.record.system.unit("Pa")
            factor, unit = axis_unit(pascal, np.array([stress.largest]))
            where = f"{stress.body} {stress.when}"
            self.legend = Legend(motion.WORDS["mises"], unit, STOPS, stress.shown(name, pascal)[0], where)
            self.data |= {"stops": STOPS, "stress": (factor * stress.over_time[chosen]).tolist(), "unit": unit}
        self.still = self._still()
        #: notes, left_out: what has to be known of the picture; what it does not show and the file has
        self.notes = _notes(run, self._bodies, len(self.data["factors"]) > 1)
        self.left_out = [*left_out, *_left_out(run, len(chosen), name)]

    def _data(self, run: Trajectory, time: np.ndarray, bar: float, colours: list[str]) -> dict[str, Any]:
        packed = [_packed(body, self._picture, self._stress) for body in self._shown]
        reach = max((entry["step"] * np.iinfo(np.int16).max for entry in packed if "step" in entry), default=0.0)
        largest = LARGEST_SHOWN * (self.height - FOOT)
        # digits behind the point that tell frames apart
        decimals = int(np.clip(1 - np.floor(np.log10(np.diff(time).min()) + 1e-9), 0, 12)) if len(time) > 1 else 3
        return {
            "time": time.tolist(),
            "decimals": decimals,
            "width": self.width,
            "height": self.height,
            "start": self.start,
            "bar": bar,
            "metre": run.record.system.unit("m"),
            "bodies": [entry | {"colour": colour} for entry, colour in zip(packed, colours)],
            "factors": [factor for factor in FACTORS if factor == 1 or 0.0 < factor * reach <= largest],
            "outputs": {
                key: [float(value) if np.isfinite(value) else None for value in np.interp(time, run.time, own)]
                for key, own in run.outputs.items()
            },
        }

    def _still(self) -> str:
        """Return the address of a picture of the surfaces at the first frame as PNG, empty where there is none."""
        corners, colours = [], []
        for body, at in zip(self._shown, self._flat):
            if not len(body.triangles):
                continue
            corners.append(at[body.triangles])
            own = np.tile(to_rgb(RIGID if body.rigid else PLAIN), (len(at), 1))
            if body.values is not None:
                own = colours_of(body.values[self.start], 1.0 if self._stress is None else self._stress.largest)
            colours.append(own[body.triangles])
        if not corners:
            return ""
        triangles, shown = np.concatenate(corners), np.concatenate(colours)
        numbers = np.arange(3 * len(triangles)).reshape(-1, 3)
        towards = np.abs(motion.normals(numbers, triangles.reshape(-1, 3))[:, 2])
        shown = shown * (DARKEST + (1.0 - DARKEST) * towards)[:, None, None]
        order = np.argsort(triangles[..., 2].mean(axis=1), kind="stable")
        x, y = triangles[order].reshape(-1, 3)[:, :2].T
        figure = new_figure(1.0, self.height / SIZE)
        figure.set_layout_engine("none")
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0, SIZE), ylim=(self.height, 0))
        axes.set_axis_off()
        mesh = Triangulation(x, y, numbers)
        axes.add_collection(TriMesh(mesh, facecolors=np.column_stack([shown[order].reshape(-1, 3), np.ones(len(x))])))
        if not np.ptp(triangles[..., 2]) > 0.0:
            pieces = [at[body.edges][..., :2] for body, at in zip(self._shown, self._flat) if len(body.edges)]
            axes.add_collection(LineCollection(np.concatenate(pieces), colors=EDGE, linewidths=72.0 / WIDTH, alpha=0.6))
        stream = io.BytesIO()
        figure.savefig(stream, format="png", dpi=WIDTH, transparent=True, metadata={"Software": None})
        return f"data:image/png;base64,{base64.b64encode(stream.getvalue()).decode('ascii')}"


def _picture(bodies: list[motion.Skin]) -> tuple[_Picture, int]:
    points = np.concatenate([body.points.reshape(-1, 3) for body in bodies])
    extents = np.ptp(points, axis=0)
    flat = bool(extents[2] < FLAT * extents.max())
    view = view_of(points, flat)
    across = points @ view[:2].T
    low, high = across.min(axis=0), across.max(axis=0)
    margin = 0.05 * (max(high - low) or 1.0)
    low, extent = low - margin, high - low + 2.0 * margin
    unit = SIZE / extent[0] if extent[1] <= TALLEST * extent[0] else SIZE * TALLEST / extent[1]
    height = int(np.clip(unit * extent[1], FLATTEST * SIZE, TALLEST * SIZE))
    left, above = 0.5 * (SIZE - unit * extent[0]), 0.5 * (height - unit * extent[1])
    shift = np.array([left - unit * low[0], height - above + unit * low[1], 0.0])
    return _Picture(view, float(unit), shift, flat), height


def _packed(body: motion.Skin, picture: _Picture, stress: Stress | None) -> dict[str, Any]:
    """Return a body for the script: motions (n_f, 3, 1 + d), bending in steps, and stress in shades."""
    n_frames, n = body.points.shape[:2]
    places = picture.places(body.points)
    undeformed = np.column_stack([np.ones(n), body.nodes])
    rigid = (places - picture.directions(body.moved)).transpose(1, 0, 2).reshape(n, -1)
    # rigid where a deformation is known; else the nearest one, and what is left is not enlarged
    moved = np.linalg.lstsq(undeformed, rigid, rcond=None)[0]
    bend = places - (undeformed @ moved).reshape(n, n_frames, 3).transpose(1, 0, 2)
    lines = body.edges[: 0 if len(body.triangles) else None]
    entry: dict[str, Any] = {
        "n": n,
        "kind": _kind(body),
        "lines": lines.ravel().tolist(),
        "ends": ends(lines).tolist(),
        "nodes": _text(body.nodes, "<f4"),
        "motion": _text(moved.reshape(-1, n_frames, 3).transpose(1, 2, 0), "<f4"),
    }
    bend = bend[..., : 2 if picture.flat else 3]
    if (reach := float(np.abs(bend).max(initial=0.0))) > 0.5 / FACTORS[-1]:
        step = reach / np.iinfo(np.int16).max
        as_it_is = np.flatnonzero(~_known(body)).tolist()
        entry |= {"step": step, "bend": _text((bend / step).round(), "<i2"), "as_it_is": as_it_is}
    if len(body.triangles):
        entry |= {"triangles": _text(body.triangles, "<u4"), "edges": _text(body.edges, "<u4")}
    if body.values is not None and stress is not None:
        shades = np.where(np.isfinite(body.values), SHADES * body.values / max(stress.largest, 1e-300), SHADES + 1)
        entry["shades"] = _text(shades.round().clip(0, SHADES + 1), "<u1")
    return entry


def _text(numbers: np.ndarray, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(numbers, dtype=kind).tobytes()).decode("ascii")


def _line(body: motion.Skin, at: np.ndarray, colour: str, stress: Stress | None, number: int) -> dict[str, Any]:
    """Return a body without a surface as SVG has it, as the page's script draws it at other frames."""
    if body.values is None or stress is None:
        paths = [("hollow" if hollow else "", colour, "".join(f"M{_pair(at[a])}L{_pair(at[b])}" for a, b in body.edges))
                 for hollow in ([False, True] if _kind(body) == "rigid" else [False])]  # fmt: skip
    else:
        own = np.nan_to_num(body.values[number]) / max(stress.largest, 1e-300)
        whole = "".join(f"M{_pair(at[a])}L{_pair(at[b])}" for a, b in body.edges)
        paths = [("casing", "#3a3a3a", whole)]
        paths += [
            ("", STOPS[round((N_STOPS - 1) * float(max(own[a], own[b])))], f"M{_pair(at[a])}L{_pair(at[b])}")
            for a, b in body.edges
        ]
    nodes = ends(body.edges) if len(body.edges) else range(len(at))
    marks = [at[node, :2].round().astype(int).tolist() for node in nodes]
    dots = colour if body.values is None else "#3a3a3a"
    return {"name": body.name, "kind": _kind(body), "colour": dots, "paths": paths, "marks": marks}


def _pair(place: np.ndarray) -> str:
    x, y = place[:2].round().astype(int)
    return f"{x} {y}"


def _paths(run: Trajectory, joints: dict[str, np.ndarray], moving: bool) -> list[np.ndarray]:
    """Return the paths (n_f, 3) of the ends of bodies that move, as far as frames follow them, or of those at rest;
    where all are, none tells what the ground holds."""
    extent = max(np.ptp(np.concatenate([at.reshape(-1, 3) for at in joints.values()]), axis=0)[:2])
    every = [joints[body][:, node] for body, cells in run.frames.cells.items() for node in ends(cells)]
    moved = [path for path in every if len(path) > 1 and (np.ptp(path, axis=0).max() >= AT_REST * extent) == moving]
    return [path for path in moved if is_followed(path)] if moving else moved * (len(moved) < len(every))


def _notes(run: Trajectory, bodies: list[motion.Skin], enlarged: bool) -> list[str]:
    said = without_span(run.frames, run.record) + (motion.uncoloured(run.fields) if run.fields else [])
    if run.fields and run.model == "reduced":
        said += filter(None, [truncated(run.record.tables)])
    unknown = [body.name for body in bodies if _kind(body) == "flexible" and not _known(body).all()]
    if unknown and enlarged:
        said.append(f"{', '.join(unknown)}: not enlarged where the deformation is not known")
    return said


def _left_out(run: Trajectory, n_shown: int, name: str) -> list[str]:
    """Return what the file has and the film has not, and what neither has, with the cure."""
    found = []
    if n_shown < len(run.frames.time):
        found.append(f"the film shows {n_shown} of {len(run.frames.time)} frames; the file has all")
    entries = scene_of(run.record).get("bodies", {})
    bare = [body for body, one in entries.items() if one.get("element") in MESHED and body not in run.fields]
    if bare:
        found.append(
            f"the film draws {', '.join(bare)} as lines: {name or 'the run'} has no displacements and stresses of "
            f"{'it' if len(bare) == 1 else 'them'}; simulate it again with frames; its notes say what else keeps them "
            "out"
        )
    return found
