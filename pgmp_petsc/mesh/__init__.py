"""Meshes of the bodies: reading through meshio, named points, faces and regions. No PETSc, no MPI.

Solid meshes are read by `pgmp_petsc.mesh.solid_mesh_reading`, which takes scikit-fem along; runs of beams do without.
"""

from pgmp_petsc.mesh.meshes import LineMesh, SolidMesh, read_line_mesh

__all__ = ["LineMesh", "SolidMesh", "read_line_mesh"]
