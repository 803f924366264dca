"""A rigid body's mass about its centre of mass, from a continuum mesh, or from the lines of beams in space.

Its unknowns are the displacement and rotation of the centre of mass, y. With the body's mass matrix M, its rigid
motions R and its linear displacement fields F, the mass is ``R^T M R``, and ``(R^T M R)^-1 R^T M F`` is the rigid
motion that has the momenta of the fields: the inertia forces of any motion are exact.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.component import Component
from pgmp_petsc.bodies.framed_solid import FramedSolid
from pgmp_petsc.bodies.linear_fields import TURNS, linear_fields, rigid_motions
from pgmp_petsc.bodies.recovery import Recovery
from pgmp_petsc.bodies.section import SpatialSection
from pgmp_petsc.bodies.solid import Solid
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.runtime.errors import InputError


def rigid_component(meshed: FramedSolid) -> Component:
    """Return the component of a rigid body.

    Raises
    ------
    InputError
        If its parts have densities that vary apart: its centre of mass would move with the parameters.
    """
    solid = meshed.solid
    moments = solid.second_moments()
    if len(moments) > 1:
        raise InputError(
            f"bodies.{solid.name}.flexible = false: a rigid body's density has one factor, but its regions have "
            f"{', '.join(map(str, sorted(moments)))}; its centre of mass would move with the parameters"
        )
    frames = {name: number for number, name in enumerate(meshed.frames)}
    centres = np.array([frame.centre for frame in meshed.frames.values()])
    ((weight, second),) = moments.items()
    component = _component(frames, centres, weight, second, solid.n_dofs)
    if not isinstance(solid, Solid):  # matrices have no cells to be drawn
        return component
    shapes = linear_fields(solid.mesh.nodes) @ rigid_motions(component.centre_of_mass)
    return replace(component, recovery=Recovery(solid.mesh, shapes))


def rigid_line(name: str, mesh: LineMesh, section: SpatialSection, axes: np.ndarray) -> Component:
    """Return the component of a rigid body with the mass of beams in space, their axes of shape (n_cells, 3, 3).

    A line of length L with its middle at m and the axes e has ``int rho X X^T dV = rho A L (m m^T + L^2 / 12 e_1
    e_1^T) + L (rho I_3 e_2 e_2^T + rho I_2 e_3 e_3^T)``.

    Raises
    ------
    InputError
        If lengths and sections have densities that vary apart: inertia forces would not be affine in them.
    """
    weights = {quantity.monomial for quantity in (section.line_density, *section.rotary)}
    if len(weights) > 1:
        raise InputError(
            f"bodies.{name}.flexible = false: a rigid body in space has a section of numbers, but its mass has the "
            f"factors {', '.join(map(str, sorted(weights)))}; give the section without parameters, or make it flexible"
        )
    lengths, middles = mesh.lengths, mesh.nodes[mesh.cells].mean(axis=1)
    line, rotary = section.line_density.coefficient, [part.coefficient for part in section.rotary]
    points = np.column_stack([middles, np.ones(len(middles))])
    second = line * np.einsum("e,ei,ej->ij", lengths, points, points)
    within = np.array([line * lengths**2 / 12.0, np.full(len(lengths), rotary[1]), np.full(len(lengths), rotary[0])])
    second[:3, :3] += np.einsum("e,se,eis,ejs->ij", lengths, within, axes, axes)
    (weight,) = weights
    return _component(dict(mesh.points), mesh.nodes, weight, second, 6 * mesh.n_nodes)


def _component(
    frames: dict[str, int], centres: np.ndarray, weight: Monomial, second: np.ndarray, n_mesh_dofs: int
) -> Component:
    """Return the component of a body with moments ``int rho (x, 1) (x, 1)^T dV``."""
    d = centres.shape[1]
    mass, centre = second[d, d], second[:d, d] / second[d, d]
    about = second[:d, :d] - mass * np.outer(centre, centre)  # int rho x x^T about the centre of mass
    momenta = _momenta(mass, centre, about)
    matrix = momenta @ rigid_motions(centre)
    return Component(
        frames=frames,
        centres=centres,
        mass={weight: 0.5 * (matrix + matrix.T)},
        stiffness={},
        moments={},
        fields=np.linalg.solve(matrix, momenta),
        probes=np.zeros((len(matrix), 1)),
        n_mesh_dofs=n_mesh_dofs,
        error=0.0,
        centre_of_mass=centre,
    )


def _momenta(mass: float, centre: np.ndarray, about: np.ndarray) -> np.ndarray:
    """Return the momentum and the angular momentum about the centre of every linear field, (n_rigid, d (d + 1))."""
    d = centre.size
    found = np.zeros((d + len(TURNS[d]), d + d * d))
    found[:d, :d] = mass * np.eye(d)
    for i in range(d):
        found[i, d + d * i : d + d * (i + 1)] = mass * centre
    for row, (i, j) in enumerate(TURNS[d], d):
        found[row, d + d * j : d + d * (j + 1)] += about[i]
        found[row, d + d * i : d + d * (i + 1)] -= about[j]
    return found
