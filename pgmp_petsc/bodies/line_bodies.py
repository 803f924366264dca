"""Meshes of bodies that are straight lines, whose length may be a parameter."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import numpy as np

from pgmp_petsc.mesh.line_mesh import straight_beam
from pgmp_petsc.scene import Scene

AnyShape = TypeVar("AnyShape")


def at_lengths(scene: Scene, meshes: Mapping[str, AnyShape]) -> dict[str, AnyShape]:
    """Return the meshes of a scene's bodies with the lengths of its run (``scene.values``); as many cells, all equal.

    Bodies whose length is a number keep their mesh, whatever it is.
    """
    found = dict(meshes)
    for name, body in scene.bodies.items():
        if body.line is not None and isinstance(body.line.length, str):
            length, n_cells = scene.number(body.line.length), len(meshes[name].cells)
            found[name] = straight_beam(length, n_cells, body.line.start, body.dimension)
    return found


def length_share(scene: Scene, name: str, values: Mapping[str, np.ndarray | float]) -> np.ndarray | float:
    """Return how often its length in the scene's run a body has with parameter values, numbers or of shape (n,)."""
    line = scene.bodies[name].line
    if line is None or not isinstance(line.length, str):
        return 1.0
    return scene.number(line.length, values) / scene.number(line.length)
