"""Monomials of parameters: products, powers, text, and weights of many samples."""

import numpy as np
import pytest

from pgmp_petsc.bodies.affine import Monomial, Quantity, evaluate_weights

R1, E = Monomial((("r1", 1),)), Monomial((("E", 1),))


def test_products_are_sorted_and_cancel() -> None:
    assert R1 * E == E * R1 == Monomial((("E", 1), ("r1", 1)))
    assert R1**2 * R1 == R1**3 and Monomial() * R1 == R1
    assert R1 * R1**-1 == R1**0 == Monomial() and Quantity(3.0, R1) ** 0 == Quantity(1.0)


@pytest.mark.parametrize("monomial", [Monomial(), R1, R1**4, E * R1**2, E**-1 * R1**3])
def test_text_is_read_back(monomial: Monomial) -> None:
    assert Monomial.parse(str(monomial)) == monomial


def test_text_is_readable() -> None:
    assert [str(m) for m in (Monomial(), E * R1**2, R1**-1)] == ["1", "E r1^2", "r1^-1"]


def test_quantities_multiply_coefficients_and_monomials() -> None:
    area = np.pi * Quantity.of("r1") ** 2
    assert area.monomial == R1**2 and area.coefficient == np.pi
    product = Quantity.of("E") * area * 0.5
    assert product == Quantity(0.5 * np.pi, E * R1**2)
    assert Quantity.of(3) == Quantity(3.0)


def test_evaluation_takes_scalars_and_samples() -> None:
    monomial, many = E * R1**2, {"r1": np.array([1.0, 2.0])}
    assert monomial.evaluate({"E": 2.0, "r1": 3.0, "unused": 9.0}) == 18.0
    np.testing.assert_array_equal(monomial.evaluate({"E": 2.0, "r1": np.array([1.0, 3.0])}), [2.0, 18.0])
    # weights have a row a term
    weights = evaluate_weights([Monomial(), R1**2, R1**4], many)
    np.testing.assert_array_equal(weights, [[1.0, 1.0], [1.0, 4.0], [1.0, 16.0]])
    np.testing.assert_array_equal(evaluate_weights([Monomial(), R1**2], {"r1": 2.0}), [1.0, 4.0])
    np.testing.assert_array_equal(evaluate_weights([Monomial()], {}), [1.0])
