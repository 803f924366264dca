"""What a body is made from: a mesh, matrices, or what was made of one already, condensed or in a floating frame."""

from __future__ import annotations

from pgmp_petsc.bodies.assembled import Assembled
from pgmp_petsc.bodies.component import Component
from pgmp_petsc.bodies.floating import FloatingBody
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.mesh.solid_mesh import SolidMesh

#: What is condensed.
ContinuumShape = SolidMesh | Assembled
BodyShape = LineMesh | ContinuumShape | Component | FloatingBody
