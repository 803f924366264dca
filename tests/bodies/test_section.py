"""Sectional coefficients: closed forms, and which parameters enter which term."""

import math
import re
from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Monomial, Quantity
from pgmp_petsc.bodies.beam3d import section_axes
from pgmp_petsc.bodies.beam_strains import BeamStrains
from pgmp_petsc.bodies.kinds.beam import Beam
from pgmp_petsc.bodies.sections.hollow_shapes import HollowCircle, HollowRectangle
from pgmp_petsc.bodies.sections.section import BeamSection
from pgmp_petsc.bodies.sections.solid_shapes import Circle, Rectangle
from pgmp_petsc.bodies.stresses import BeamLaw
from pgmp_petsc.mesh.meshes import straight_beam
from pgmp_petsc.scene.bodies import Material, SectionEntry
from scenes import SHEAR_FACTOR, STEEL, slider_crank

YOUNG, NU, RHO = STEEL["E"], STEEL["nu"], STEEL["rho"]
SHEAR_MODULUS = YOUNG / (2 * (1 + NU))
R2, R4 = Monomial((("r1", 2),)), Monomial((("r1", 4),))


def in_plane(section: SectionEntry, material: Material) -> BeamSection:
    return section.coefficients(2, material, {}, dict)


def test_circle_of_numbers_is_one_term() -> None:
    r = 5.6e-3
    section = in_plane(Circle(shape="circle", radius=r), Material(**STEEL))
    area, inertia = math.pi * r**2, math.pi * r**4 / 4
    expected = (YOUNG * area, SHEAR_FACTOR * SHEAR_MODULUS * area, YOUNG * inertia)
    assert section.terms("stiffness")[Monomial()] == pytest.approx(expected, rel=1e-14)
    assert section.terms("mass")[Monomial()] == pytest.approx((RHO * area, RHO * inertia), rel=1e-14)
    assert len(section.terms("stiffness")) == len(section.terms("mass")) == 1


def test_the_shear_factor_of_the_circle_is_the_papers() -> None:
    # the reference data give the factor as 0.8863636363636364
    section = in_plane(Circle(shape="circle", radius=1.0), Material(**STEEL))
    factor = float(section.stiffness[1].at({})) / (SHEAR_MODULUS * math.pi)
    assert factor == pytest.approx(0.8863636363636364, rel=1e-14)


def test_a_radius_that_is_a_parameter_gives_two_terms() -> None:
    section = in_plane(Circle(shape="circle", radius="r1"), Material(**STEEL))
    shear = SHEAR_FACTOR * SHEAR_MODULUS * math.pi
    assert set(section.terms("stiffness")) == set(section.terms("mass")) == {R2, R4}
    assert section.terms("stiffness")[R2] == pytest.approx((YOUNG * math.pi, shear, 0.0), rel=1e-14)
    assert section.terms("stiffness")[R4] == pytest.approx((0.0, 0.0, YOUNG * math.pi / 4), rel=1e-14)
    assert section.terms("mass")[R2] == pytest.approx((RHO * math.pi, 0.0), rel=1e-14)
    assert section.terms("mass")[R4] == pytest.approx((0.0, RHO * math.pi / 4), rel=1e-14)


def test_rectangle_bends_about_its_width() -> None:
    b, h = 2e-2, 5e-3
    section = in_plane(Rectangle(shape="rectangle", width=b, height=h), Material(**STEEL))
    cowper = 10 * (1 + NU) / (12 + 11 * NU)
    expected = (YOUNG * b * h, cowper * SHEAR_MODULUS * b * h, YOUNG * b * h**3 / 12)
    assert section.terms("stiffness")[Monomial()] == pytest.approx(expected, rel=1e-14)
    assert section.terms("mass")[Monomial()] == pytest.approx((RHO * b * h, RHO * b * h**3 / 12), rel=1e-14)


def test_parameters_of_material_and_section_multiply() -> None:
    material = Material(E="E", nu=NU, rho="density")
    section = in_plane(Rectangle(shape="rectangle", width="b", height=5e-3), material)
    assert set(section.terms("stiffness")) == {Monomial((("E", 1), ("b", 1)))}
    assert set(section.terms("mass")) == {Monomial((("b", 1), ("density", 1)))}


B, H, T = 0.04, 0.06, 0.004
AREA = B * H - (B - 2 * T) * (H - 2 * T)
I_2, I_3 = ((b * h**3 - (b - 2 * T) * (h - 2 * T) ** 3) / 12 for b, h in ((H, B), (B, H)))


def tube(width: float | str = B, height: float | str = H, wall: float | str = T) -> HollowRectangle:
    return HollowRectangle(shape="hollow_rectangle", width=width, height=height, wall=wall)


def test_closed_forms_of_a_hollow_rectangle() -> None:
    section = tube().coefficients(3, Material(**STEEL), {}, dict)
    axial, *sheared, _, about_2, about_3 = (float(part.at({})) for part in section.stiffness)
    np.testing.assert_allclose([axial, about_2, about_3], np.array([AREA, I_2, I_3]) * YOUNG, rtol=1e-14)
    np.testing.assert_allclose([float(part.at({})) for part in section.mass], np.array([AREA, I_2, I_3]) * RHO)
    assert 0.3 < sheared[1] / (SHEAR_MODULUS * AREA) < sheared[0] / (SHEAR_MODULUS * AREA) < 0.7
    flat = tube().coefficients(2, Material(**STEEL), {}, dict)
    np.testing.assert_allclose([float(part.at({})) for part in flat.stiffness], [axial, sheared[0], about_3])
    webs = tube(width=2.01e-6, height=0.06, wall=1e-6).sheared(NU, {}, dict)[0]  # two webs and hardly a flange
    assert float(webs.at({})) == pytest.approx(10 * (1 + NU) / (12 + 11 * NU) * 2.01e-6 * 0.06, rel=1e-2)


@pytest.mark.parametrize(("width", "height", "wall"), [(0.04, 0.04, 0.01), (0.04, 0.06, 0.004), (0.02, 0.08, 0.005)])
def test_torsion_is_that_of_prandtls_function(width: float, height: float, wall: float) -> None:
    found = float(tube(width, height, wall).torsion({}, dict).at({}))
    assert found == pytest.approx(by_differences(width, height, wall, 16), rel=3e-3)


def by_differences(width: float, height: float, wall: float, n: int) -> float:
    """Return the torsion constant: twice the integral of f, ``-laplace f = 2`` in the walls, 0 outside, of zero
    gradient in the hole; on a quarter, with n steps over a wall."""
    step = wall / n
    shape = round(0.5 * width / step) + 1, round(0.5 * height / step) + 1
    x, y = step * np.indices(shape)
    hole = (x < 0.5 * width - wall + 0.1 * step) & (y < 0.5 * height - wall + 0.1 * step)
    numbers, inner = np.arange(x.size).reshape(shape), np.ones(shape)
    inner[0], inner[:, 0] = 0.5 * inner[0], 0.5 * inner[:, 0]  # edges on the axes belong to two quarters
    pairs = [(numbers[:-1], numbers[1:], inner[-1]), (numbers[:, :-1], numbers[:, 1:], inner[:, -1:])]
    stiffness = sp.csr_matrix((x.size, x.size))
    for one, other, weights in pairs:
        one, other, weights = one.ravel(), other.ravel(), np.broadcast_to(weights, one.shape).ravel()
        entries = np.concatenate([weights, weights, -weights, -weights])
        rows, columns = np.concatenate([one, other, one, other]), np.concatenate([one, other, other, one])
        stiffness = stiffness + sp.csr_matrix((entries, (rows, columns)), shape=stiffness.shape)
    inside = np.ones(shape, dtype=bool)
    inside[-1], inside[:, -1] = False, False
    walls = (inside & ~hole).ravel()
    place = np.full(x.size, -1)
    place[walls], place[hole.ravel()] = np.arange(walls.sum()), walls.sum()
    kept = place >= 0
    tied = sp.csr_matrix((np.ones(kept.sum()), (np.flatnonzero(kept), place[kept])), shape=(x.size, walls.sum() + 1))
    areas = step**2 * inner.ravel()
    f = tied @ splu((tied.T @ stiffness @ tied).tocsc()).solve(tied.T @ (2.0 * areas))
    return float(4.0 * 2.0 * areas @ f)


def pipe(radius: float | str, wall: float | str) -> HollowCircle:
    return HollowCircle(shape="hollow_circle", radius=radius, wall=wall)


def test_closed_forms_of_a_hollow_circle() -> None:
    """Two circles, one less the other; of a thin wall Cowper's factor is ``2 (1 + nu) / (4 + 3 nu)``."""
    outer, inner = (Circle(shape="circle", radius=r) for r in (B, B - T))
    of_all, *of_parts = (one.coefficients(3, Material(**STEEL), {}, dict) for one in (pipe(B, T), outer, inner))
    for name, known in (("stiffness", [0, 3, 4, 5]), ("mass", [0, 1, 2])):
        found, whole, hole = ([float(getattr(one, name)[k].at({})) for k in known] for one in (of_all, *of_parts))
        np.testing.assert_allclose(found, np.subtract(whole, hole), rtol=1e-13)
    for wall, factor in ((1e-7 * B, 2 * (1 + NU) / (4 + 3 * NU)), ((1.0 - 1e-7) * B, SHEAR_FACTOR)):
        made = pipe(B, wall)
        assert float(made.sheared(NU, {}, dict)[0].at({}) / made.area().at({})) == pytest.approx(factor, rel=1e-6)
    assert in_plane(pipe(B, T), Material(**STEEL)).stiffness[2].at({}) == of_all.stiffness[5].at({})


@pytest.mark.parametrize(
    ("made", "entries"),
    [(tube, (B, H, "t")), (tube, ("b", H, "t")), (tube, ("b", "b", "t")), (tube, ("b", "h", "t")), (pipe, ("b", "t"))],
)
def test_hollow_sections_of_parameters(made: Callable[..., SectionEntry], entries: tuple[float | str, ...]) -> None:
    """Area and second moments are exact at all values, torsion and shear at the nominal ones, and near it elsewhere."""
    nominal = {"b": B, "h": H, "t": T}
    spans = {name: (0.9 * value, 1.1 * value) for name, value in nominal.items()}
    affine = made(*entries).coefficients(3, Material(**STEEL), nominal, lambda: spans)
    for factors in product((0.9, 1.0, 1.07), repeat=3):
        values = {name: factor * value for factor, (name, value) in zip(factors, nominal.items())}
        numbers = made(*(values.get(entry, entry) for entry in entries)).coefficients(3, Material(**STEEL), {}, dict)
        found, exact = (
            np.array([float(part.at(values)) for part in (*section.stiffness, *section.mass)])
            for section in (affine, numbers)
        )
        fitted = [1, 2, 3]
        np.testing.assert_allclose(np.delete(found, fitted), np.delete(exact, fitted), rtol=1e-11)
        np.testing.assert_allclose(found[fitted], exact[fitted], rtol=1e-11 if set(factors) == {1.0} else 6e-3)


def test_a_cantilever_has_the_deflection_and_the_stress_of_beam_theory() -> None:
    """``F L^3 / 3 E I + F L / k G A`` along the height at the tip, but for 1 / 4 n^2; ``F (L - x) h / 2 I``."""
    n, length, force = 40, 1.2, 100.0
    mesh, section = straight_beam(length, n, 0.0, 3), tube().coefficients(3, Material(**STEEL), {}, dict)
    axes = section_axes(np.diff(mesh.nodes[mesh.cells], axis=1)[:, 0], np.array([0.0, 1.0, 0.0]))
    body = Beam("beam", mesh, mesh, section=section, axes=axes)
    size = 6 * (n + 1)
    stiffness, loads, u = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    for entries in body.of_elements("stiffness", np.arange(n)).values():
        for (one, _), entry in zip(mesh.cells, entries):
            stiffness[6 * one : 6 * one + 12, 6 * one : 6 * one + 12] += entry
    loads[-5] = force
    u[6:] = np.linalg.solve(stiffness[6:, 6:], loads[6:])
    expected = force * length**3 / (3 * YOUNG * I_3) + force * length / float(section.stiffness[1].at({}))
    assert u[-5] == pytest.approx(expected, rel=1.0 / (4 * n**2))
    points = BeamStrains.at_nodes(body, (), np.array([0]))
    law = BeamLaw(Quantity(YOUNG), tube().reach, tube().round)
    found = law.values(["stress_max"], points, law.forces(points, points.of_displacements(u.reshape(-1, 6, 1)), {}), {})
    assert float(found["stress_max"].max()) == pytest.approx(force * length * 0.5 * H / I_3, rel=1e-9)


@pytest.mark.parametrize(
    ("sizes", "said"),
    [('"hollow_rectangle", width=0.01, height=0.02', "0.5 width = 0.005"), ('"hollow_circle", radius=0.005', "radius")],
)
def test_walls_that_leave_no_hole_are_refused(sizes: str, said: str) -> None:
    with pytest.raises(InputError, match=rf"bodies\.rod\.section\.wall = 0\.005: must be below {re.escape(said)}"):
        slider_crank(f"bodies.rod.section={{shape={sizes}, wall=0.005}}")
