"""Bodies of a film: surfaces of meshed ones and lines of the others, with how far they deform and their stress.

Fields of a run (`results.body_fields`) are drawn as they are; a body without one has the line between its joints.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pgmp_petsc.declare.records import number_name
from pgmp_petsc.figures.motion import VALUES, skin_of
from pgmp_petsc.figures.shapes import shown_positions
from pgmp_petsc.figures.style import scene_of
from pgmp_petsc.figures.surfaces import coarsened, outlines
from pgmp_petsc.results import Trajectory
from pgmp_petsc.results.body_fields import BodyField

# Nodes of all surfaces of a film: what a phone draws 25 times a second.
MOST_NODES = 6000
MESHED = ("solid2d", "solid3d")


@dataclass(frozen=True, eq=False)
class FilmBody:
    """What is drawn of a body.

    Attributes
    ----------
    name
        Of the body.
    kind
        ``flexible``, ``rigid`` or ``mass``.
    nodes
        Undeformed, in the body's frame, shape (n, d), m.
    points
        Where they are, ground frame, shape (n_f, n, 3), m.
    deformation
        What of it may be enlarged, shape (n_f, n, 3), m.
    known
        The frames at which there is a deformation, shape (n_f,).
    lines, triangles, edges
        Cells of beams; of surfaces their triangles, and the edges that show their shape; shapes (., 2), (., 3), (., 2).
    values
        Von Mises' stress at the nodes, shape (n_f, n), Pa; None where it is not known.
    note
        What of the body is left out, empty where nothing is.
    """

    name: str
    kind: str
    nodes: np.ndarray
    points: np.ndarray
    deformation: np.ndarray
    known: np.ndarray
    lines: np.ndarray
    triangles: np.ndarray
    edges: np.ndarray
    values: np.ndarray | None
    note: str = ""

    def at(self, frames: np.ndarray) -> FilmBody:
        """Return the body at some of the frames."""
        values = None if self.values is None else self.values[frames]
        return replace(
            self,
            points=self.points[frames],
            deformation=self.deformation[frames],
            known=self.known[frames],
            values=values,
        )


def bodies_of(run: Trajectory) -> list[FilmBody]:
    """Return the bodies of a run with frames, those with fields as these are."""
    meshed = [own for own in run.fields.values() if own.kind != "line"]
    most = max(1, MOST_NODES // max(1, len(meshed)))
    return [
        _with_field(name, run.fields[name], most) if name in run.fields else _of_frames(run, name)
        for name in run.frames.nodes
    ]


def _with_field(name: str, own: BodyField, most: int) -> FilmBody:
    """Return a body whose field is known; of a meshed one the surface, with as many nodes as may be drawn."""
    skin = skin_of(name, own, 1.0, VALUES["mises"])
    known = np.isfinite(own.deformation).all(axis=(1, 2))
    kind = "rigid" if own.rigid else "flexible"
    nothing, moved = np.zeros((0, 2), dtype=int), _in_space(np.nan_to_num(own.deformation))
    if own.kind == "line":
        none = np.zeros((0, 3), dtype=int)
        return FilmBody(name, kind, own.nodes, skin.points, moved, known, own.cells, none, nothing, skin.values)
    used, triangles = np.unique(skin.triangles, return_inverse=True)
    triangles, edges, note = triangles.reshape(-1, 3), np.searchsorted(used, skin.edges), ""
    if len(used) > most:
        peaks = np.zeros(len(used)) if skin.values is None else np.nan_to_num(skin.values[:, used]).max(axis=0)
        kept, triangles = coarsened(own.nodes[used], triangles, peaks, most)
        note = f"the surface of {name} has {len(kept)} of its {len(used)} nodes, those of largest stress among them"
        used = used[kept]
        edges = outlines(triangles, own.nodes[used])
    values = None if skin.values is None else skin.values[:, used]
    return FilmBody(
        name,
        kind,
        own.nodes[used],
        skin.points[:, used],
        moved[:, used],
        known,
        nothing,
        triangles,
        edges,
        values,
        note,
    )


def _of_frames(run: Trajectory, name: str) -> FilmBody:
    """Return a body whose nodes at the frames alone are known."""
    frames, cells = run.frames, run.frames.cells[name]
    places, twice = (shown_positions(frames, name, factor) for factor in (1.0, 2.0))
    moved = twice - places
    kind = "mass" if not len(cells) else "rigid" if name in frames.rigid else "flexible"
    known = np.full(len(places), bool(np.abs(moved).max(initial=0.0) > 0.0))
    none = np.zeros((0, 3), dtype=int)
    points, moved = _in_space(places), _in_space(moved)
    return FilmBody(name, kind, frames.nodes[name], points, moved, known, cells, none, none[:, :2], None)


def _in_space(points: np.ndarray) -> np.ndarray:
    """Return points (..., 2 or 3) in space."""
    return np.concatenate([points, np.zeros((*points.shape[:-1], 3 - points.shape[-1]))], axis=-1)


@dataclass(frozen=True, eq=False)
class Stress:
    """The largest von Mises' stress of a run, in surfaces and within.

    Attributes
    ----------
    over_time
        Of all bodies at the frames, shape (n_f,), Pa.
    largest
        Of all frames, and of the outputs of this stress at all steps, Pa.
    body, frame
        Where it is, and the frame at which that of the frames is largest.
    when
        Its instant, and of what it is the largest.
    path, index
        Dataset and place in the file; empty of beams at frames, where it is worked out of two.
    """

    over_time: np.ndarray
    largest: float
    body: str
    frame: int
    when: str
    path: str
    index: str


def stress_of(run: Trajectory) -> Stress | None:
    """Return the largest stress; None where none is known.

    Outputs know of all steps, frames of some: a peak between two frames is that of an output, where one has it.
    """
    known = {name: VALUES["mises"](own) for name, own in run.fields.items() if not own.rigid}
    known = {name: values for name, values in known.items() if values is not None and np.isfinite(values).any()}
    if not known:
        return None
    over_time = np.max([np.nanmax(values, axis=1, initial=0.0) for values in known.values()], axis=0)
    body = max(known, key=lambda name: np.nanmax(known[name]))
    frame, node = map(int, np.unravel_index(np.nanargmax(known[body]), known[body].shape))
    largest, plain = float(known[body][frame, node]), "von_mises" in run.fields[body].at_nodes
    path = f"/fields/{body}/at_nodes/von_mises/{number_name(frame)}" if plain else ""
    when = f"at {run.frames.time[frame]:.4g} s, of the {len(run.frames.time)} frames kept"
    found = Stress(over_time, largest, body, frame, when, path, str(node) if plain else "")
    for output, of_body in _mises_outputs(run).items():
        values = np.nan_to_num(run.outputs[output])
        step = int(np.argmax(np.abs(values)))
        size = abs(float(values[step]))
        if of_body in known and size > found.largest:
            when = f"at {run.time[step]:.4g} s, of all steps ({output})"
            path = f"/outputs/{output}" if values[step] > 0.0 else ""
            found = replace(found, largest=size, body=of_body, when=when, path=path, index=str(step) if path else "")
    return found


def _mises_outputs(run: Trajectory) -> dict[str, str]:
    """Return the bodies of the outputs that are of this stress; of beams it is that of their outermost fibres."""
    entries = scene_of(run.record).get("outputs", {})
    return {
        name: str(entry.get("body"))
        for name, entry in entries.items()
        if name in run.outputs and entry.get("quantity") in ("von_mises", "stress_max", "stress_min")
    }


def meshed_bodies(run: Trajectory) -> list[str]:
    """Return the bodies of a run's scene that have a mesh of cells."""
    entries = scene_of(run.record).get("bodies", {})
    return [name for name, entry in entries.items() if entry.get("element") in MESHED]
