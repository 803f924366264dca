"""Points away from their node: derivatives turned into the node's unknowns, joints of rigid bodies, welds."""

from __future__ import annotations

import numpy as np
import pytest
from effect_scenes import BAR, mechanism_with_lines, scene_of

from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.connection import Connection
from pgmp_petsc.mechanism.connections import ConstraintSet
from pgmp_petsc.mechanism.joints import Driver, Fixed, Joint, PointOnLine, Revolute

STEP, ATOL = 1e-6, 1e-8  # central differences: round-off of values of order 1 over the step
SIDES = {
    "both away": (
        Attachment(0, 0, np.zeros(2), np.array([0.3, -0.2])),
        Attachment(1, 1, np.zeros(2), np.array([-0.5, 0.1])),
    ),
    "one away": (Attachment(0, 0, np.zeros(2)), Attachment(1, 1, np.zeros(2), np.array([-0.5, 0.1]))),
    "from the ground": (Attachment(-1, -1, np.array([0.7, 0.4])), Attachment(1, 1, np.zeros(2), np.array([-0.5, 0.1]))),
}
JOINTS = {
    "revolute": Revolute(), "fixed": Fixed(0.4), "line": PointOnLine((3.0, 4.0), turning=False),
    "turning line": PointOnLine((-1.0, 2.0), turning=True), "driver": Driver(),
}
# a rigid bar welded at its tip to a second one, which carries a mass at its middle; a flexible one beyond
WELDED = BAR + """
[bodies.arm]
line = { length = 0.5, elements = 2 }
element = "beam2d"
flexible = false
section = { shape = "coefficients", axial = 1.0, shear = 1.0, bending = 1.0, line_density = 2.0, rotary_density = 0.1 }
placement = { origin = [1.0, 0.0], angle = 0.7 }
[joints.weld]
type = "fixed"
connect = ["bar:tip", "arm:hinge"]
[effects.bob]
type = "point_mass"
point = "arm:tip"
mass = 0.3
"""


def unknowns() -> np.ndarray:
    """Return unknowns of two nodes in general position."""
    return np.array([0.1, -0.3, 0.6, 0.9, 0.4, -1.1])


@pytest.mark.parametrize("sides", SIDES.values(), ids=list(SIDES))
@pytest.mark.parametrize("joint", JOINTS.values(), ids=list(JOINTS))
def test_derivatives_of_connections(joint: Joint, sides: tuple[Attachment, Attachment]) -> None:
    connection = Connection("j", joint, *sides, slice(0, joint.n_constraints))
    q = unknowns()
    # the unknowns of a ground side are none of the nodes'
    columns = connection.moving_columns
    np.testing.assert_array_equal(columns, connection.dofs)
    for j in columns:
        d = STEP * np.eye(6)[j]
        slope = (connection.residual(q + d) - connection.residual(q - d)) / (2 * STEP)
        np.testing.assert_allclose(connection.jacobian(q)[:, j], slope, rtol=0, atol=ATOL)
        slope = (connection.jacobian(q + d) - connection.jacobian(q - d)) / (2 * STEP)
        np.testing.assert_allclose(connection.hessian(q)[:, columns, j], slope[:, columns], rtol=0, atol=ATOL)
    assert connection.linear == (
        not np.any(connection.hessian(q)[np.ix_(range(joint.n_constraints), columns, columns)])
    ) or (isinstance(joint, Driver))


def test_welds_hold_the_angle_of_the_placements_and_masses_ride_along() -> None:
    mechanism = mechanism_with_lines(scene_of(WELDED))
    assert [body.name for body in mechanism.bodies] == ["bar", "arm", "bob:mass"]
    assert [connection.name for connection in mechanism.connections] == ["hinge", "weld", "bob:mass"]
    constraints = ConstraintSet(mechanism)
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
