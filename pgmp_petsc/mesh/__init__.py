"""Meshes of the bodies: reading through meshio, named points. No PETSc, no MPI."""

from pgmp_petsc.mesh.line_mesh import LineMesh, read_line_mesh

__all__ = ["LineMesh", "read_line_mesh"]
