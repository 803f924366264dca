"""Rigid bodies: the mass of lines of any shape, and the masses that they carry."""

from dataclasses import replace

import numpy as np
import pytest
from effect_scenes import BAR, mechanism_with_lines, scene_of
from solids import box_mesh, rectangle_mesh

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Monomial, Quantity
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.component import rigid_component
from pgmp_petsc.bodies.framed_solid import FramedSolid
from pgmp_petsc.bodies.kinds.beam import Beam
from pgmp_petsc.bodies.kinds.rigid import RigidBody
from pgmp_petsc.bodies.matrices import assemble, weighted_sum
from pgmp_petsc.bodies.sections.section import Coefficients
from pgmp_petsc.bodies.solid import FaceFrame, Region, Solid
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.mesh.solid_mesh import reference_element
from scenes import tables

LINE, ROTARY = 2.5, 0.07
SECTION = Coefficients(
    shape="coefficients", axial=1.0, shear=1.0, bending=1.0, line_density=LINE, rotary_density=ROTARY
)
# a bent line with a branch, cells of different lengths
BENT = LineMesh(
    np.array([[0.0, 0.0], [0.5, 0.0], [0.8, 0.6], [0.8, 1.5], [0.9, -0.4]]),
    np.array([[0, 1], [1, 2], [3, 2], [1, 4]]),
    {"hinge": 0, "tip": 3, "foot": 4},
)


def mass_matrix(body: Body) -> np.ndarray:
    """Return the mass matrix of a body alone."""
    return weighted_sum(assemble([body], range(3 * body.n_nodes)).mass, {}).toarray()


def test_a_rigid_body_has_the_mass_of_the_flexible_one_in_rigid_motions() -> None:
    section = SECTION.coefficients(2, None, {}, dict)
    flexible, rigid = Beam("bent", BENT, BENT, section=section), RigidBody.of_lines("bent", BENT, section)
    arms = BENT.nodes - rigid.mesh.nodes[0]
    motions = np.zeros((len(arms), 3, 3))
    motions[:, 0, 0] = motions[:, 1, 1] = motions[:, 2, 2] = 1.0
    motions[:, 0, 2], motions[:, 1, 2] = -arms[:, 1], arms[:, 0]
    motions = motions.reshape(-1, 3)
    np.testing.assert_allclose(motions.T @ mass_matrix(flexible) @ motions, mass_matrix(rigid), atol=1e-14)


def test_a_mass_on_a_rigid_body_away_from_its_centre_is_a_particle_with_a_weld() -> None:
    scene = scene_of(
        BAR,
        tables("""
parameters.m: nominal = 2.0
effects.bob: type = "point_mass"; point = "bar:tip"; mass = "m"; inertia = 0.3
effects.second: type = "point_mass"; point = "bar:middle"; mass = 0.5
"""),
    )
    mechanism = mechanism_with_lines(scene)
    matrices = assemble(mechanism.bodies, range(mechanism.n_dofs))
    mass = weighted_sum(matrices.mass, {"m": 3.0}).toarray()
    # the bar and each of its masses, numbered after it; the bar lends them half of the inertia that it has left
    inertias = [1 / 48, 0.3 + 1 / 24, 1 / 48]
    np.testing.assert_allclose(
        np.diag(mass), [1.0, 1.0, inertias[0], 3.0, 3.0, inertias[1], 0.5, 0.5, inertias[2]], rtol=1e-14
    )
    # along the mechanism's motion about the hinge all of them together
    poses = mechanism.first_guess
    rates = np.zeros((3, 3, 1))
    place = np.array([body.mesh.nodes[0] for body in mechanism.bodies])
    rates[:, 2, 0] = 1.0
    motion = mechanism.place_rates(poses, rates)[:, 0]
    np.testing.assert_allclose(place[:, 0], [0.5, 1.0, 0.5])
    assert motion @ mass @ motion == pytest.approx(1 / 3 + 3.0 + 0.3 + 0.5 * 0.25, rel=1e-14), "nothing is lost"


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
