"""Rigid continuum bodies: mass, centre of mass and inertia of the mesh, and the momenta of linear fields."""

from dataclasses import replace

import numpy as np
import pytest
from solids import box_mesh, rectangle_mesh

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Monomial, Quantity
from pgmp_petsc.bodies.component import rigid_component
from pgmp_petsc.bodies.framed_solid import FramedSolid
from pgmp_petsc.bodies.kinds.rigid import RigidBody
from pgmp_petsc.bodies.solid import FaceFrame, Region, Solid
from pgmp_petsc.mesh.solid_mesh import reference_element

RHO, LENGTHS = 7800.0, (0.3, 0.02, 0.05)
DENSITY = Quantity(RHO, Monomial((("m", 1),)))


def framed(kind: str) -> FramedSolid:
    d = reference_element(kind).dimension
    mesh = (rectangle_mesh if d == 2 else box_mesh)(kind, (4, 2, 2)[:d], LENGTHS[:d])
    solid = Solid("bar", mesh, (Region(np.arange(mesh.n_cells), Quantity.of(1.0), DENSITY, 0.3),))
    frames = {
        name: FaceFrame.of(mesh.nodes, mesh.faces(name, ""), reference_element(kind).face_kind)
        for name in ("left", "right")
    }
    return FramedSolid(solid, frames)


@pytest.mark.parametrize("kind", ["quad8", "hexahedron20", "tetra10"])
def test_mass_and_inertia_are_those_of_a_box(kind: str) -> None:
    component = rigid_component(framed(kind))
    d = component.centres.shape[1]
    lengths = np.array(LENGTHS[:d])
    m = RHO * lengths.prod()
    squares = m * lengths**2 / 12.0
    turns = [squares.sum()] if d == 2 else squares.sum() - squares
    (matrix,) = component.mass.values()
    # quadrature is exact for straight cells
    np.testing.assert_allclose(matrix, np.diag([*[m] * d, *turns]), rtol=0, atol=1e-12 * m)
    np.testing.assert_allclose(component.centre_of_mass, 0.5 * lengths, rtol=1e-12)


@pytest.mark.parametrize("kind", ["quad8", "hexahedron20"])
def test_linear_fields_have_the_momenta_of_the_mesh(kind: str) -> None:
    meshed = framed(kind)
    component, d = rigid_component(meshed), meshed.solid.mesh.dimension
    mass = meshed.solid.mass(range(meshed.solid.mesh.n_nodes))[DENSITY.monomial]
    x = meshed.solid.mesh.nodes
    arms = x - component.centre_of_mass
    rigid = [np.tile(axis, (len(x), 1)) for axis in np.eye(d)]
    if d == 2:
        rigid.append(np.column_stack([-arms[:, 1], arms[:, 0]]))
    else:
        rigid += [np.cross(axis, arms) for axis in np.eye(3)]
    (matrix,) = component.mass.values()
    for number in range(d + d * d):
        field = np.zeros_like(x)
        if number < d:
            field[:, number] = 1.0
        else:
            i, j = divmod(number - d, d)
            field[:, i] = x[:, j]
        expected = [motion.ravel() @ mass @ field.ravel() for motion in rigid]
        found = matrix @ component.fields[:, number]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(matrix).max())


def test_a_body_in_the_plane_is_a_mass_on_a_node() -> None:
    body = RigidBody.of_component("bar", rigid_component(framed("quad8")))
    assert not body.flexible and body.n_nodes == 1 and body.n_internal == 0
    assert body.mass_weights == {DENSITY.monomial} and body.stiffness_weights == set()
    assert body.shape.points == {"left": 0, "right": 1}


def test_densities_that_vary_apart_are_refused() -> None:
    meshed = framed("quad8")
    (region,) = meshed.solid.regions
    halves = (
        replace(region, cells=region.cells[:4]),
        replace(region, cells=region.cells[4:], density=Quantity.of(RHO)),
    )
    mixed = FramedSolid(replace(meshed.solid, regions=halves), meshed.frames)
    with pytest.raises(InputError, match="bodies.bar.flexible = false: a rigid body's density has one factor"):
        rigid_component(mixed)
