"""Shapes, the sources of bodies: a mesh, matrices, or a body made already, condensed or in a floating frame.

Those of straight lines, whose length may be a parameter, and of rigid bodies by their points are made here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Values
from pgmp_petsc.bodies.assembled import Assembled, MassProperties
from pgmp_petsc.bodies.component import SLENDER, Component
from pgmp_petsc.bodies.floating import FloatingBody
from pgmp_petsc.mesh.meshes import LineMesh, SolidMesh, straight_beam
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.messages import problem

#: What is condensed.
ContinuumShape = SolidMesh | Assembled
BodyShape = LineMesh | ContinuumShape | Component | FloatingBody
Shapes = Mapping[str, BodyShape]  # of bodies, by name
NO_LENGTH = 1e-9  # share of its hinge's place that an element is longer than, so that seven digits of it are left


def shape_in_scene(scene: Scene, name: str) -> LineMesh | None:
    """Return the shape of a body that a scene has without a file; None of others.

    Of a body that is given by its mass properties nodes are its points, each once, the centre of mass first, and lines
    go from there to the others.
    """
    body = scene.bodies[name]
    if body.line is not None:
        return _line(scene, name)
    if body.rigid is None:
        return None
    names, places = zip(*body.rigid.places.items())
    nodes, first, numbers = np.unique(np.array(places), axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    points = {point: int(node) for point, node in zip(names, np.argsort(order)[numbers.ravel()])}
    ends = np.arange(1, len(nodes))
    return LineMesh(nodes[order], np.column_stack([np.zeros_like(ends), ends]), points)


def to_condense(shape: BodyShape) -> bool:
    """Whether a shape is condensed before it is reduced."""
    return isinstance(shape, ContinuumShape)


def is_condensed(shape: BodyShape, *, flexible: bool = False) -> bool:
    """Whether a shape is of matrices of a few unknowns; of a flexible body, if that is asked."""
    return isinstance(shape, Component) and not (flexible and shape.rigid)


def in_floating_frame(shape: BodyShape) -> BodyShape:
    """Return what a shape is in a floating frame; the shape itself where it is no condensed flexible body."""
    return shape.floating if is_condensed(shape, flexible=True) else shape


def lacks_foreshortening(shape: BodyShape) -> bool:
    """Whether a shape is a condensed body that in its floating frame does not become shorter where it bends."""
    return isinstance(shape, Component) and shape.floating is not None and not shape.floating.curved


def has_long_axis(shape: BodyShape) -> bool:
    """Return whether static stretching of a body is distinguished from its bending."""
    return not isinstance(shape, Component) or shape.large is None or shape.large.slenderness >= SLENDER


def given_properties(shape: BodyShape | None) -> MassProperties | None:
    """Return the mass properties of matrices at factors of 1; None of other shapes."""
    return shape.properties if isinstance(shape, Assembled) else None


AnyShape = TypeVar("AnyShape")


def at_lengths(scene: Scene, meshes: Mapping[str, AnyShape]) -> dict[str, AnyShape]:
    """Return the meshes of a scene's bodies with the lengths of its run (``scene.values``); as many cells, all equal.

    Bodies whose length is a number keep their mesh, whatever it is, and those in floating frames are what they are.
    """
    found = dict(meshes)
    for name, body in scene.bodies.items():
        is_line = body.line is not None and not isinstance(meshes[name], FloatingBody)
        if is_line and isinstance(body.line.length, str):
            found[name] = _line(scene, name, len(meshes[name].cells))
    return found


def _line(scene: Scene, name: str, n_cells: int | None = None) -> LineMesh:
    """Return the line of a body in the scene's run, of other than its own number of cells where one is given.

    Raises `InputError` where its elements vanish beside the place of its hinge.
    """
    line = scene.bodies[name].line
    length, n_cells = scene.number(line.length), line.elements if n_cells is None else n_cells
    if not length / n_cells > NO_LENGTH * abs(line.start):
        reason = f"the element's length of {length / n_cells:g} is lost in round-off there; start nearer to 0"
        raise InputError(problem(f"bodies.{name}.line.start", reason, line.start))
    return straight_beam(length, n_cells, line.start, scene.bodies[name].dimension)


def length_share(scene: Scene, name: str, values: Values) -> np.ndarray | float:
    """Return how often its length in the scene's run a body has with parameter values, numbers or of shape (n,)."""
    line = scene.bodies[name].line
    if line is None or not isinstance(line.length, str):
        return 1.0
    return scene.number(line.length, values) / scene.number(line.length)
