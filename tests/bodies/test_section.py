"""Sectional coefficients: closed forms, and which parameters enter which term."""

import math

import pytest

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.sections.section import BeamSection
from pgmp_petsc.bodies.sections.solid_shapes import Circle, Rectangle
from pgmp_petsc.scene.bodies import Material, SectionEntry
from scenes import SHEAR_FACTOR, STEEL

YOUNG, NU, RHO = STEEL["E"], STEEL["nu"], STEEL["rho"]
SHEAR_MODULUS = YOUNG / (2 * (1 + NU))
R2, R4 = Monomial((("r1", 2),)), Monomial((("r1", 4),))


def in_plane(section: SectionEntry, material: Material) -> BeamSection:
    """Return the coefficients of a planar beam."""
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
