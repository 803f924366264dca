"""The film of a run: shapes of the mechanism at its frames, as whole numbers for the page's script.

The picture is `SIZE` units wide. A body's deformation is kept apart from its rigid shape where it can be enlarged: the
page then shows ``rigid + factor * deformation``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pgmp_petsc.figures.shapes import AT_REST, Shapes, ends
from pgmp_petsc.figures.style import PALETTE, axis_unit
from pgmp_petsc.results import Trajectory

SIZE = 10_000
MOST_FRAMES = 241
# What is left of 16 MB for shapes on a page: more nodes mean fewer frames.
MOST_NUMBERS = 1_500_000
TALLEST, FLATTEST = 1.1, 0.28  # of the picture over its width
FOOT = 600  # below the mechanism, for the bar of the scale
# An enlarged deformation may reach this share of the mechanism's size.
LARGEST_SHOWN = 0.3
FACTORS = (1, 3, 10, 30, 100, 300, 1000)


@dataclass(frozen=True)
class Film:
    """What the page needs to draw the mechanism.

    Attributes
    ----------
    width, height
        Of the picture, in its own unit.
    first
        Lines, marks and colours of every body at the first frame: name, kind (``flexible``, ``rigid``, ``mass``),
        colour, ``d`` of its path, and its ends.
    paths
        ``d`` of the paths that ends of bodies take.
    ground
        Places (x, y) of ends that do not move.
    scale
        Length of the bar of the scale in the picture's unit, and in words.
    data
        For the script: instants, bodies, factors, outputs.
    note
        What is left out, empty where nothing is.
    """

    width: int
    height: int
    first: list[dict[str, Any]]
    paths: list[str]
    ground: list[tuple[int, int]]
    scale: tuple[int, str]
    data: dict[str, Any]
    note: str


def film_of(run: Trajectory) -> Film | None:
    """Return the film of a run; None where it has no frames."""
    frames = run.frames
    if frames is None or not len(frames.time):
        return None
    shapes = Shapes.of(frames)
    low, high = shapes.limits
    extent = high - low
    unit = SIZE / extent[0] if extent[1] <= TALLEST * extent[0] else SIZE * TALLEST / extent[1]
    height = int(np.clip(unit * extent[1], FLATTEST * SIZE, TALLEST * SIZE))
    shift = np.array([0.5 * (SIZE - unit * extent[0]), 0.5 * (height - unit * extent[1])])

    def placed(points: np.ndarray) -> np.ndarray:
        x, y = np.moveaxis(unit * (points - low) + shift, -1, 0)
        return np.stack([x, height - y], axis=-1)

    numbers = sum(points.shape[1] for points in shapes.positions.values()) * 4
    most = max(2, min(MOST_FRAMES, MOST_NUMBERS // max(numbers, 1), len(frames.time)))
    chosen = np.unique(np.linspace(0, len(frames.time) - 1, min(most, len(frames.time))).round().astype(int))
    twice = Shapes.of(frames, 2.0).positions
    bodies, first, largest = [], [], 0.0
    for number, (body, cells) in enumerate(frames.cells.items()):
        at = placed(shapes.positions[body][chosen])
        extra = placed(twice[body][chosen]) - at
        reach = float(np.abs(extra).max(initial=0.0))
        largest = max(largest, reach)
        step = reach / SIZE
        entry: dict[str, Any] = {"cells": cells.ravel().tolist(), "at": _whole(at), "ends": ends(cells).tolist()}
        if step > 1e-12:
            entry |= {"extra": _whole(extra / step), "step": step}
        bodies.append(entry)
        kind = "mass" if not len(cells) else "rigid" if body in frames.rigid else "flexible"
        colour = PALETTE[number % len(PALETTE)]
        marks = at[0].round().astype(int)[ends(cells) if len(cells) else slice(None)].tolist()
        first.append({"name": body, "kind": kind, "colour": colour, "d": _path(at[0], cells), "marks": marks})
    size = max(SIZE, height)
    factors = [factor for factor in FACTORS if factor == 1 or 0.0 < factor * largest <= LARGEST_SHOWN * size]
    time = frames.time[chosen]
    outputs = {name: [_finite(v) for v in np.interp(time, run.time, values)] for name, values in run.outputs.items()}
    data = {"time": time.tolist(), "bodies": bodies, "factors": factors, "outputs": outputs}
    note = "" if len(chosen) == len(frames.time) else f"{len(chosen)} of {len(frames.time)} frames"
    still = _still(shapes, high - low)
    paths = [
        "M" + "L".join(f"{x} {y}" for x, y in placed(shapes.positions[body][:, node]).round().astype(int))
        for body, node in _moving(shapes, high - low)
    ]
    ground = [tuple(placed(point).round().astype(int).tolist()) for point in still]
    return Film(SIZE, height + FOOT, first, paths, ground, _scale(unit), data, note)


def _whole(points: np.ndarray) -> list[list[int]]:
    """Return a row of whole numbers for every frame."""
    return points.reshape(len(points), -1).round().astype(int).tolist()


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _path(points: np.ndarray, cells: np.ndarray) -> str:
    """Return what a path of a body's cells is drawn by, as the page's script makes it."""
    whole = points.round().astype(int)
    return "".join(f"M{whole[a][0]} {whole[a][1]}L{whole[b][0]} {whole[b][1]}" for a, b in cells)


def _rests(path: np.ndarray, extent: np.ndarray) -> bool:
    return len(path) > 1 and bool(np.ptp(path, axis=0).max() < AT_REST * max(extent))


def _still(shapes: Shapes, extent: np.ndarray) -> list[np.ndarray]:
    """Return where ends of bodies stay where they are."""
    paths = (shapes.positions[body][:, node] for body, cells in shapes.frames.cells.items() for node in ends(cells))
    return [path[0] for path in paths if _rests(path, extent)]


def _moving(shapes: Shapes, extent: np.ndarray) -> list[tuple[str, int]]:
    """Return the ends of bodies that move."""
    every = ((body, node) for body, cells in shapes.frames.cells.items() for node in ends(cells))
    return [(body, node) for body, node in every if not _rests(shapes.positions[body][:, node], extent)]


def _scale(unit: float) -> tuple[int, str]:
    """Return a bar of about a sixth of the picture: its length in the picture's unit and in words."""
    metres = SIZE / 6.0 / unit
    power = 10.0 ** np.floor(np.log10(metres))
    nice = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= metres)
    factor, shown = axis_unit("m", np.array([nice]))
    return round(nice * unit), f"{nice * factor:g} {shown}"
