"""What a body is made from: a mesh, matrices, or what was made of one already, condensed or in a floating frame."""

from __future__ import annotations

from pgmp_petsc.bodies.assembled import Assembled, MassProperties
from pgmp_petsc.bodies.component import Component
from pgmp_petsc.bodies.floating import FloatingBody
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.mesh.solid_mesh import SolidMesh

#: What is condensed.
ContinuumShape = SolidMesh | Assembled
BodyShape = LineMesh | ContinuumShape | Component | FloatingBody


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
    """Whether static stretching of a body is told from its bending."""
    return not isinstance(shape, Component) or shape.large is None or shape.large.slender


def given_properties(shape: BodyShape | None) -> MassProperties | None:
    """Return the mass properties of matrices at factors of 1; None of other shapes."""
    return shape.properties if isinstance(shape, Assembled) else None
