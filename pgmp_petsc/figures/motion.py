"""What is drawn of bodies at some instants: where their surfaces are, in which colours, and what has to be said of it.

Surfaces are the outer faces of meshes as triangles between the meshes' own nodes: what is known at nodes is drawn as it
is. A face of a quadratic cell has nodes between its corners: its edges are drawn as two straight pieces each. A
deformation is enlarged by ``x + (scale - 1) u`` with the deformation u that a result keeps (`results.trajectory`):
bodies stay joined, rigid ones included, which go where those that deform take them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.figures.mechanism import spans_of, without_span
from pgmp_petsc.figures.style import MODELS, axis_label, axis_unit, heading, notes_of_runs, round_below
from pgmp_petsc.figures.trajectories import Arrow, arrows_of
from pgmp_petsc.mesh.meshes import PLANE_KINDS, outer_faces
from pgmp_petsc.results import Trajectory
from pgmp_petsc.results.trajectory import BodyField, ModeShape, truncated

# of a face by its number of nodes, one after the other around it
_TRIANGLES = {
    3: ((0, 1, 2),),
    4: ((0, 1, 2), (0, 2, 3)),
    6: ((0, 1, 5), (1, 2, 3), (3, 4, 5), (1, 3, 5)),
    8: ((0, 1, 7), (1, 2, 3), (3, 4, 5), (5, 6, 7), (1, 3, 7), (3, 5, 7)),
}


def drawn_faces(kind: str, cells: np.ndarray) -> np.ndarray:
    """Return the faces that one cell alone has, in the plane all cells, by the nodes around them, shape (n_faces, k).

    Cells, nodes of shape (n_cells, n_a), are of the `kind` that meshio calls so.
    """
    faces = cells if kind in PLANE_KINDS else outer_faces(kind, cells)
    n_nodes = faces.shape[1]
    if n_nodes < 6:
        return faces
    n_corners = 3 if n_nodes == 6 else 4  # then the middles of the edges between them, perhaps that of the face
    return faces[:, np.arange(2 * n_corners).reshape(2, n_corners).T.ravel()]


def triangles(faces: np.ndarray) -> np.ndarray:
    """Return the triangles of faces (n_faces, k), shape (n_triangles, 3)."""
    return faces[:, np.array(_TRIANGLES[faces.shape[1]])].reshape(-1, 3)


SHARP = 0.5  # rad


def outlines(faces: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Return the pieces of edges that show a body's shape, shape (n, 2), from faces, shape (n_faces, k), of nodes,
    shape (n_nodes, d): edges of one face, and those between faces whose normals are more than `SHARP` radians apart."""
    n_faces, k = faces.shape
    pieces = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    owner = np.repeat(np.arange(n_faces), k)
    keys, which, counts = np.unique(np.sort(pieces, axis=1), axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(which.reshape(-1), kind="stable")
    starts = np.cumsum(counts) - counts
    shown = counts == 1
    if nodes.shape[1] == 3:
        twice = np.flatnonzero(counts == 2)
        first, second = (normals(faces, nodes)[owner[order[starts[twice] + j]]] for j in (0, 1))
        shown[twice] = np.sum(first * second, axis=1) < np.cos(SHARP)
    return keys[shown]


def normals(faces: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Return unit normals of faces (n_faces, k) in space, shape (n_faces, 3): those of the vector areas."""
    around = nodes[faces] - nodes[faces[:, :1]]
    areas = np.cross(around, np.roll(around, -1, axis=1)).sum(axis=1)
    return areas / np.maximum(np.linalg.norm(areas, axis=1, keepdims=True), 1e-300)


def coarsened(
    nodes: np.ndarray, triangles: np.ndarray, weights: np.ndarray, most: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes that represent all others of a surface, `most` at most, and its triangles between these.

    Nodes, shape (n_nodes, d), in the same cube become one, that of the largest weight among them (Rossignac and Borrel,
    Multi-resolution 3D approximations for rendering complex scenes, 1993).
    """
    corners = nodes[triangles]
    sides = np.zeros((len(triangles), 2, 3))
    sides[..., : nodes.shape[1]] = corners[:, 1:] - corners[:, :1]
    area = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum()
    size = np.sqrt(area / most)
    while True:
        cubes = np.floor((nodes - nodes.min(axis=0)) / size).astype(np.int64)
        _, cube = np.unique(cubes, axis=0, return_inverse=True)
        cube = cube.reshape(-1)
        if cube.max() < most:
            break
        size *= 1.2
    order = np.lexsort((weights, cube))
    kept = order[np.append(np.diff(cube[order]) > 0, True)]
    found = cube[triangles]
    alive = (found[:, 0] != found[:, 1]) & (found[:, 1] != found[:, 2]) & (found[:, 2] != found[:, 0])
    _, first = np.unique(np.sort(found[alive], axis=1), axis=0, return_index=True)
    return kept, found[alive][np.sort(first)]


# An enlarged deformation reaches this share of the mechanism's size at most, where nobody says how far.
LARGEST_SHOWN = 0.05
LONGEST_ARROW = 0.25  # of a force in a joint, as a share of the mechanism's size
N_PHASES = 24  # of a period of a mode
WORDS = {"mises": "von Mises stress", "deformation": "deformation", "displacement": "displacement", "none": ""}


@dataclass(frozen=True, eq=False)
class Skin:
    """Surface or lines drawn of a body."""

    name: str  # of the body
    nodes: np.ndarray  # undeformed, in the body's frame, shape (n_nodes, d), m
    #: points, deformation: where the nodes are, and what of it may be enlarged, not a number where that is not known;
    #: shape (n_f, n_nodes, 3), m
    points: np.ndarray
    deformation: np.ndarray
    #: edges, triangles: what shows its shape, and its surface, shapes (n, 2) and (n, 3); of beams edges are their
    #: lines, without triangles. A point mass has neither.
    edges: np.ndarray
    rigid: bool  # whether it does not deform
    values: np.ndarray | None = None  # what colours it, shape (n_f, n_nodes); None where that is not known
    triangles: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), dtype=int))
    radius: float = 0.0  # of beams, m; 0 where it is not known
    is_span: bool = False  # whether it is no body but what acts between two points

    @property
    def moved(self) -> np.ndarray:
        """The deformation, zero where it is not known."""
        return np.nan_to_num(self.deformation)

    def enlarged(self, factor: float) -> Skin:
        return replace(self, points=self.points + (factor - 1.0) * self.moved)

    def part(self, frames: Any = slice(None), nodes: Any = slice(None)) -> Skin:
        """Return it at some frames, with some nodes; edges and triangles are left as they are."""
        over_time = {name: getattr(self, name) for name in ("points", "deformation", "values")}
        chosen = {name: own[frames][:, nodes] for name, own in over_time.items() if own is not None}
        return replace(self, nodes=self.nodes[nodes], **chosen)


@dataclass(frozen=True, eq=False)
class Motion:
    """Bodies at some instants."""

    skins: tuple[Skin, ...]  # of the bodies
    captions: list[str]  # what is written beside each instant
    title: str  # title, notes: above all of them
    notes: list[str] = field(default_factory=list)
    quantity: str = ""  # what colours bodies, with its unit; empty where nothing does
    largest: float = 0.0  # the largest value of the colours, in the unit
    scale: float = 1.0  # of the deformation
    #: number of the instant at which the largest value is reached, the last one where there are no colours
    peak: int = -1
    metre: str = "m"  # unit of places
    arrows: tuple[Arrow, ...] = ()  # forces in joints
    per_metre: float = 1.0  # force (N) that an arrow of a metre is
    forces: str = ""  # what arrows are, in words

    @property
    def points(self) -> np.ndarray:
        """All places that anything is at, shape (n, 3), m."""
        ends = [np.concatenate([arrow.place, self.end(arrow)]) for arrow in self.arrows]
        return np.concatenate([*(skin.points.reshape(-1, 3) for skin in self.skins), *ends])

    def end(self, arrow: Arrow) -> np.ndarray:
        """Return where the point of an arrow is at the instants, shape (n_f, 3), m."""
        return arrow.place + arrow.force / self.per_metre

    def only(self, number: int) -> Motion:
        one = [number]
        skins = (skin.part(one) for skin in self.skins)
        arrows = (replace(arrow, place=arrow.place[one], force=arrow.force[one]) for arrow in self.arrows)
        return replace(self, skins=tuple(skins), arrows=tuple(arrows), captions=[self.captions[number]], peak=0)

    @property
    def flat(self) -> bool:
        """Whether all of it stays in the plane."""
        return not np.ptp(self.points[:, 2]) > 0.0


def motion_of(run: Trajectory, colour: str = "mises", scale: float | None = None, label: str = "") -> Motion:
    """Return what is drawn of a run, which `label` tells from others, in one of the colours of `WORDS`. Raises
    `InputError` if the run has no frames, or nothing of it is known in the colour. `scale` is the factor on the
    deformation; None is one that shows it."""
    frames = run.frames
    if frames is None:
        raise InputError("the trajectory has no frames to draw; use --override simulation.frames=100")
    notes = [*notes_of_runs([run]), *without_span(frames, run.record)]
    factor = scale_of(run.fields) if scale is None else scale
    skins = skins_of(run, VALUES[colour])
    bare = [skin.name for skin in skins if len(skin.edges) and not skin.rigid and skin.name not in run.fields]
    skins = [skin.enlarged(factor) for skin in with_spans(skins, run)]
    if bare:
        notes.append(f"{', '.join(bare)}: drawn as lines between joints, their fields are not stored (see pgmp info)")
    notes += uncoloured(run.fields, colour)
    if colour == "mises" and run.model == "reduced":
        notes += filter(None, [truncated(run.record.tables)])
    skins, quantity, largest, peak = in_unit(skins, colour, run.record.system.unit("Pa" if colour == "mises" else "m"))
    if colour != "none" and not quantity:
        raise InputError(
            f"nothing of this run is known in {WORDS[colour]}: no body has it stored; take --field none, or simulate "
            "it again with frames"
        )
    unknown = [name for name, own in run.fields.items() if not np.isfinite(own.deformation).all()]
    if unknown and factor != 1.0:
        notes.append(f"{', '.join(unknown)}: drawn as it is where the rigid mechanism does not exist")
    enlarged = "" if factor == 1.0 else f", deformation enlarged {factor:g} times"
    seen = WORDS[colour][:1].upper() + WORDS[colour][1:] or "Motion"
    title = heading(f"{seen}, {MODELS[run.model]}{enlarged}", run.record, label)
    captions = [f"t = {instant:.4g} s" for instant in frames.time]
    arrows, without = arrows_of(run)
    metre = run.record.system.unit("m")
    per_metre, forces = _scaled(arrows, skins, run.record.system.unit("N"), metre)
    return Motion(
        tuple(skins), captions, title, [*notes, *without], quantity, largest, factor, peak, metre, tuple(arrows),
        per_metre, forces,
    )  # fmt: skip


def _scaled(arrows: Sequence[Arrow], skins: Sequence[Skin], newton: str, metre: str) -> tuple[float, str]:
    """Return the force that an arrow of a metre is, such that the largest one is seen, and what arrows are in words."""
    largest = max((float(np.linalg.norm(arrow.force, axis=1).max()) for arrow in arrows), default=0.0)
    if not largest > 0.0:
        return 1.0, ""
    extent = float(np.ptp(np.concatenate([skin.points.reshape(-1, 3) for skin in skins]), axis=0).max())
    length = round_below(LONGEST_ARROW * extent)
    force = 1.0 / round_below(1.0 / largest)
    factors = [axis_unit(unit, np.array([size])) for unit, size in ((newton, force), (metre, length))]
    of, at = (f"{size * factor:.6g} {unit}" for (factor, unit), size in zip(factors, (force, length)))
    named = ", ".join(f"{arrow.joint} on {arrow.body}" for arrow in arrows)
    return force / length, f"forces in joints ({named}): an arrow of {at} is {of}"


def vibration_of(shape: ModeShape, colour: str, scale: float | None) -> Motion:
    """Return what is drawn of one period of a mode, whose size means nothing; its colours are shares of the largest.
    Raises `InputError` if nothing of it is known in the colour. `scale` is its largest displacement over that of a
    picture nobody asks another one of."""
    places = np.concatenate([own.positions.reshape(-1, own.positions.shape[2]) for own in shape.fields.values()])
    reach = LARGEST_SHOWN * float(np.ptp(places, axis=0).max()) * (1.0 if scale is None else scale)
    swing = np.sin(2.0 * np.pi * np.arange(N_PHASES) / N_PHASES) / shape.record.system.shown(1.0, "m")  # of 1 m
    skins = []
    for name, own in shape.fields.items():
        # the deformation of a mode is all of its displacement
        still = _size(own.deformation) if colour in ("deformation", "displacement") else VALUES[colour](own)
        values = None if own.rigid or still is None else np.repeat(still, N_PHASES, axis=0)
        skin = skin_of(name, own, VALUES["none"])
        points = skin.points + reach * swing[:, None, None] * skin.deformation
        skins.append(replace(skin, points=points, values=values))
    largest = max((float(np.nanmax(skin.values)) for skin in skins if skin.values is not None), default=0.0)
    if colour != "none" and not largest > 0.0:
        raise InputError(f"nothing of this mode is known in {WORDS[colour]}; take --field displacement or none")
    skins = [skin if skin.values is None else replace(skin, values=skin.values / largest) for skin in skins]
    notes = [*shape.notes, *uncoloured(shape.fields, colour)]
    title = heading(f"Mode {shape.number}, {shape.frequency_hz:.4g} Hz at {shape.configuration}", shape.record)
    quantity = "" if colour == "none" else f"{WORDS[colour]} over the largest"
    captions, metre = ["size arbitrary"] * N_PHASES, shape.record.system.unit("m")
    return Motion(tuple(skins), captions, title, notes, quantity, 1.0, 1.0, N_PHASES // 4, metre)


Values = Callable[[BodyField], np.ndarray | None]  # what colours a body, at its nodes


def skins_of(run: Trajectory, values: Values) -> list[Skin]:
    """Return the bodies of a run with frames, as they are; those without a field between their joints."""
    frames, found = run.frames, []
    for name, positions in frames.positions.items():
        if name in run.fields:
            found.append(skin_of(name, run.fields[name], values))
            continue
        points = in_space(positions)
        unknown, rigid = np.full(points.shape, np.nan), name in frames.rigid
        found.append(Skin(name, frames.nodes[name], points, unknown, frames.cells[name], rigid))
    return found


def skin_of(name: str, own: BodyField, values: Values) -> Skin:
    """Return what is drawn of a body whose field is known."""
    shown, colours = (in_space(own.positions), in_space(own.deformation)), None if own.rigid else values(own)
    if own.kind == "line":
        return Skin(name, own.nodes, *shown, own.cells, own.rigid, colours, radius=own.radius or 0.0)
    faces = drawn_faces(own.kind, own.cells)
    return Skin(name, own.nodes, *shown, outlines(faces, own.nodes), own.rigid, colours, triangles(faces))


def with_spans(skins: Sequence[Skin], run: Trajectory) -> list[Skin]:
    """Return the bodies of a run, and what acts between two points as lines whose ends are moved with them."""
    d = skins[0].nodes.shape[1]
    at, moved = (
        spans_of(run.frames, run.record, {skin.name: skin.enlarged(factor).points[..., :d] for skin in skins})
        for factor in (1.0, 2.0)
    )
    line = np.array([[0, 1]])
    spans = ((name, own, moved[name] - own) for name, own in at.items())
    drawn = (Skin(name, own[0], in_space(own), in_space(by), line, False, is_span=True) for name, own, by in spans)
    return [*skins, *drawn]


def in_unit(skins: list[Skin], colour: str, unit: str) -> tuple[list[Skin], str, float, int]:
    """Return skins with values in the unit of a picture, the words of these, the largest one, and the instant that has
    it."""
    known = [skin.values for skin in skins if skin.values is not None]
    if not known:
        return skins, "", 0.0, -1
    factor, shown = axis_unit(unit, *known)
    found = [skin if skin.values is None else replace(skin, values=factor * skin.values) for skin in skins]
    over_time = np.max([np.nanmax(values, axis=1, initial=0.0) for values in known], axis=0)
    return found, axis_label(WORDS[colour], shown), factor * float(over_time.max()), int(np.argmax(over_time))


def scale_of(fields: Mapping[str, BodyField]) -> float:
    """Return a round factor that makes deformations visible, 1 where they are as they are."""
    places = [own.positions.reshape(-1, own.positions.shape[2]) for own in fields.values()]
    if not places:
        return 1.0
    extent = float(np.ptp(np.concatenate(places), axis=0).max())
    largest = max(float(np.nanmax(_size(own.deformation), initial=0.0)) for own in fields.values())
    wanted = LARGEST_SHOWN * extent / largest if largest > 1e-9 * extent else 1.0
    return 1.0 if wanted <= 1.0 else round_below(wanted)


def _size(vectors: np.ndarray) -> np.ndarray:
    return np.linalg.norm(vectors, axis=-1)


def _mises(own: BodyField) -> np.ndarray | None:
    """Return von Mises' stress at the nodes: of beams in their outermost fibres, without shear and torsion."""
    if "von_mises" in own.at_nodes:
        return own.at_nodes["von_mises"]
    if "stress_max" not in own.at_nodes:
        return None
    return np.maximum(np.abs(own.at_nodes["stress_max"]), np.abs(own.at_nodes["stress_min"]))


#: What colours bodies.
VALUES: dict[str, Values] = {
    "mises": _mises,
    "deformation": lambda own: _size(own.deformation),
    "displacement": lambda own: _size(own.displacement),
    "none": lambda own: None,
}


def uncoloured(fields: Mapping[str, BodyField], colour: str = "mises") -> list[str]:
    """Say what the colours leave out."""
    if colour != "mises":
        return []
    unknown = [name for name, own in fields.items() if not own.rigid and _mises(own) is None]
    beams = any(own.kind == "line" and "stress_max" in own.at_nodes for own in fields.values())
    said = [f"{', '.join(unknown)}: sections given by coefficients have no stresses"] if unknown else []
    return [*said, "stress of beams: in the outermost fibres, without shear and torsion"] if beams else said


def in_space(points: np.ndarray) -> np.ndarray:
    return np.pad(points, [(0, 0)] * (points.ndim - 1) + [(0, 3 - points.shape[-1])])
