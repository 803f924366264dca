"""Points away from their node: derivatives turned into the node's unknowns, joints of rigid bodies, welds."""

import numpy as np
import pytest
from effect_scenes import BAR, mechanism_with_lines, scene_of

from pgmp_petsc.mechanism.constraint_set import ConstraintSet
from pgmp_petsc.mechanism.joints import Attachment, triad
from pgmp_petsc.mechanism.mechanism import Unknowns
from pgmp_petsc.mechanism.statement_rows import StatementRows
from pgmp_petsc.mechanism.statements import angle
from scenes import tables

STEP, ATOL = 1e-6, 1e-8  # central differences: round-off of values of order 1 over the step
# a rigid bar welded at its tip to a second one, which carries a mass at its middle; a flexible one beyond
WELDED = BAR + tables("""
bodies.arm: line = { length = 0.5, elements = 2 }; element = "beam2d"; flexible = false;
    section = { shape = "coefficients", axial = 1.0, shear = 1.0, bending = 1.0, line_density = 2.0, \
rotary_density = 0.1 };
    placement = { origin = [1.0, 0.0], angle = 0.7 }
joints.weld: type = "fixed"; connect = ["bar:tip", "arm:hinge"]
effects.bob: type = "point_mass"; point = "arm:tip"; mass = 0.3
""")


@pytest.mark.parametrize("offset", [0.0, 0.4, -2.0])
def test_an_angle_in_the_plane_counts_turns_with_its_bodies(offset: float) -> None:
    axes = triad(np.array([np.cos(offset), np.sin(offset)]))
    rows = StatementRows(
        [angle(axes, np.eye(2))],
        [tuple(Attachment(k, k, np.zeros(2), np.zeros(2)) for k in (0, 1))],
        lambda node: 3 * node + np.arange(3),
        2,
    )
    q = np.array([0.1, -0.3, 0.6, 0.9, 0.4, 7.6])
    assert rows.values(q)[0] == pytest.approx(7.0 - offset, abs=1e-15 * 7)
    # its first derivative is the same everywhere
    assert rows.curvature_pattern[0].size == 0


def test_welds_hold_the_angle_of_the_placements_and_masses_ride_along() -> None:
    mechanism = mechanism_with_lines(scene_of(WELDED))
    assert [body.name for body in mechanism.bodies] == ["bar", "arm", "bob:mass"]
    assert [connection.name for connection in mechanism.connections] == ["hinge", "weld", "bob:mass"]
    constraints = ConstraintSet(Unknowns(mechanism))
    q = mechanism.place(mechanism.first_guess)
    np.testing.assert_allclose(constraints.residual(q), 0.0, atol=1e-15)
    angle = 0.7
    np.testing.assert_allclose(q[6:8], [1.0 + 0.5 * np.cos(angle), 0.5 * np.sin(angle)], rtol=1e-14)
    # pattern and values together are the derivative of the residual
    rows, columns = constraints.jacobian_pattern
    dense = np.zeros((constraints.n_constraints, mechanism.n_dofs))
    q = q + np.random.default_rng(2).normal(0.0, 0.3, q.size)
    np.add.at(dense, (rows, columns), constraints.jacobian_values(q))
    curved = np.zeros((mechanism.n_dofs, mechanism.n_dofs))
    weights = np.arange(1.0, 1.0 + constraints.n_constraints)
    at = constraints.curvature_pattern
    np.add.at(curved, at, constraints.curvature_values(q, weights))
    curved += np.tril(curved, -1).T + np.triu(curved, 1).T
    for j in range(mechanism.n_dofs):
        d = STEP * np.eye(mechanism.n_dofs)[j]
        slope = (constraints.residual(q + d) - constraints.residual(q - d)) / (2 * STEP)
        np.testing.assert_allclose(dense[:, j], slope, rtol=0, atol=ATOL)

    def forces(q: np.ndarray) -> np.ndarray:
        total = np.zeros(mechanism.n_dofs)
        np.add.at(total, columns, constraints.jacobian_values(q) * weights[rows])
        return total

    for j in range(mechanism.n_dofs):
        d = STEP * np.eye(mechanism.n_dofs)[j]
        np.testing.assert_allclose(curved[:, j], (forces(q + d) - forces(q - d)) / (2 * STEP), rtol=0, atol=100 * ATOL)
    v = np.random.default_rng(3).normal(size=q.size)
    ahead, behind = (np.zeros(constraints.n_constraints) for _ in range(2))
    np.add.at(ahead, rows, constraints.jacobian_values(q + STEP * v) * v[columns])
    np.add.at(behind, rows, constraints.jacobian_values(q - STEP * v) * v[columns])
    np.testing.assert_allclose(constraints.drift(q, v), (ahead - behind) / (2 * STEP), rtol=0, atol=10 * ATOL)
