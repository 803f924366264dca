"""The strain energy of St. Venant-Kirchhoff's material on a mesh, written from its definition alone."""

from collections.abc import Callable, Mapping

import numpy as np

from pgmp_petsc.bodies.solid import Solid
from pgmp_petsc.mesh.meshes import reference_element


def energy_of(solid: Solid, values: Mapping[str, float]) -> Callable[[np.ndarray], float]:
    """Return the strain energy ``1/2 int E : C : E`` with ``E = (F^T F - 1) / 2`` of displacements (n_nodes, d)."""
    mesh, rule = solid.mesh, reference_element(solid.mesh.kind).stiffness
    d, corners = mesh.dimension, mesh.nodes[mesh.cells]
    jacobians = np.einsum("qja,eai->eqij", rule.gradients, corners)
    gradients = np.einsum("eqji,qja->eqia", np.linalg.inv(jacobians), rule.gradients)
    volumes = np.linalg.det(jacobians) * rule.weights
    moduli, tensors = np.zeros(mesh.n_cells), np.zeros((mesh.n_cells, *[d] * 4))
    same = np.eye(d)
    for region in solid.regions:
        nu = region.nu
        # Hooke's law in space, and in plane stress
        first = nu / (1 - nu**2) if d == 2 else nu / ((1 + nu) * (1 - 2 * nu))
        shear = 1 / (2 * (1 + nu))
        hooke = first * np.einsum("ij,kl->ijkl", same, same)
        hooke += shear * (np.einsum("ik,jl->ijkl", same, same) + np.einsum("il,jk->ijkl", same, same))
        moduli[region.cells], tensors[region.cells] = region.modulus.at(values), hooke

    def energy(u: np.ndarray) -> float:
        deformation = same + np.einsum("eqla,eak->eqkl", gradients, u[mesh.cells])
        strain = 0.5 * (np.einsum("eqki,eqkj->eqij", deformation, deformation) - same)
        density = np.einsum("eqij,eijkl,eqkl->eq", strain, tensors, strain, optimize=True)
        return float(0.5 * np.sum(moduli[:, None] * volumes * density))

    return energy
